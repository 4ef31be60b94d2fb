"""The order of a model by its free energy (Algorithm ``extended_DEM``), over one or several flights."""

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Indices
from mavdem.confidence import STRONG_EVIDENCE_NATS, Interval
from mavdem.dem.engine.linalg import one_thread
from mavdem.dem.order_search import BlackBox, fits_by_order
from mavdem.dem.parallel import parallel_map
from mavdem.dem.record import Record, TrainingData
from mavdem.dem.validation import is_integer
from mavdem.errors import NotLearnable, fact_from_error
from mavdem.facts import Fact, Facts
from mavdem.facts.model import ModelRefusal, OrderFact

# that a mean gain over several flights must exceed as well, so that no single flight decides
STANDARD_ERRORS = 2.0
DEFAULT_MAX_ORDER = 6  # two states more than the paper's largest system
LARGEST_ORDER = 8  # more states need higher derivatives of an output, which would be rounding


class FlightFreeEnergy(NamedTuple):
    """F̄ᵒ of one flight by order."""

    free_energy: Array  # (N,) nats; NaN where no fit converged
    width: float  # of the kernel that filters the flight, s: faster motion is not seen
    samples: float  # effective sample size
    remarks: Facts  # why orders are missing


@dataclass(frozen=True, eq=False)
class OrderChoice:
    """F̄ᵒ of ``flights`` by model order, as many orders for each, and the chosen order."""

    flights: tuple[FlightFreeEnergy, ...]

    @property
    def orders(self) -> Indices:
        """(N,) numbers of states that were tried, from 1."""
        return 1 + np.arange(len(self.flights[0].free_energy))

    @property
    def free_energy(self) -> Array:
        """(flights, N) F̄ᵒ, nats; NaN where no fit converged."""
        return np.stack([flight.free_energy for flight in self.flights])

    @property
    def mean(self) -> Array:
        """(N,) over the flights; NaN where a flight has none."""
        return self.free_energy.mean(axis=0)

    @property
    def spread(self) -> Array:
        """(N,) standard deviation over the flights of F̄ᵒ; NaN for a single one."""
        several = len(self.flights) > 1
        return (
            self.free_energy.std(axis=0, ddof=1) if several else np.full(len(self.orders), np.nan)
        )

    def gain(self, order: int, over: int) -> Interval:
        """Returns the increase of F̄ᵒ at ``order`` ``over`` another, averaged over the flights that have both, nats.

        Returns:
            the mean gain, and its standard error, which is 0 for a single flight; NaN and 0 if no flight has both.
        """
        gains = self.free_energy[:, order - 1] - self.free_energy[:, over - 1]
        gains = gains[np.isfinite(gains)]
        if not len(gains):
            return np.nan, 0.0
        return gains.mean(), gains.std(ddof=1) / np.sqrt(len(gains)) if len(gains) > 1 else 0.0

    @property
    def chosen(self) -> int:
        """The lowest order over which no higher one gains strong evidence (``STRONG_EVIDENCE_NATS``)."""

        def gains(order: int, over: int) -> bool:
            gain, error = self.gain(order, over)
            return gain > max(STRONG_EVIDENCE_NATS, STANDARD_ERRORS * error)

        fitted = [
            int(order) for order in self.orders if np.isfinite(self.free_energy[:, order - 1]).any()
        ]
        return next(
            order
            for order in fitted
            if not any(gains(higher, order) for higher in fitted if higher > order)
        )

    @property
    def saturated(self) -> bool:
        """Whether a higher order than the chosen one was tried."""
        return bool(np.isfinite(self.free_energy[:, self.chosen :]).any())

    @property
    def reason(self) -> Fact:
        """Why this order."""
        chosen = self.chosen
        higher = [self.gain(int(order), chosen) for order in self.orders[chosen:]]
        most = max((gain for gain, _ in higher if np.isfinite(gain)), default=None)
        return Fact(
            OrderFact.ORDER_CHOSEN,
            order=chosen,
            free_energy_gain=most,
            least_gain=STRONG_EVIDENCE_NATS,
            standard_errors=STANDARD_ERRORS if len(self.flights) > 1 else None,
        )

    @property
    def remarks(self) -> Facts:
        """Why orders are missing."""
        return tuple(dict.fromkeys(remark for flight in self.flights for remark in flight.remarks))


def free_energy_by_order(
    flight: TrainingData,
    max_order: int = DEFAULT_MAX_ORDER,
    known_inputs: bool = True,
) -> FlightFreeEnergy:
    """Returns F̄ᵒ of one ``flight``, or of its segments, by order.

    It increases with the number of states and saturates. Models with 1, 2, … states, with A, B and C free, are fitted
    to the same data under priors of the same form. Only states that the outputs show are counted: not a state that no
    output depends on, or that nothing excites; but states of coloured wind are.

    Args:
        flight: a ``Flight`` or segments of one.
        max_order: the highest order that is fitted, up to ``LARGEST_ORDER``.
        known_inputs: whether the recorded inputs drive the system; if not, as many unknown ones do, η̃ᵛ = 0.

    Raises:
        ValueError: an argument of the wrong kind; or a flight that is too short, or for which no order can be fitted.
    """
    if not (is_integer(max_order) and 1 <= max_order <= LARGEST_ORDER):
        raise ValueError(
            f"max_order must be a whole number from 1 to {LARGEST_ORDER}, not {max_order!r}"
        )
    record = Record.from_flights(flight)
    with one_thread():
        box = BlackBox.from_record(record, max_order, known_inputs)
        # No more parameters, less n² for the coordinates, than effective values.
        allowed = min(max_order, max(1, int(box.counted.sample_count * box.m / (box.r + box.m))))
        fits = fits_by_order(box, allowed)
    values = np.full(max_order, np.nan)
    values[:allowed] = [np.nan if fit is None else fit.free_energy for fit in fits]
    if not np.isfinite(values).any():
        raise NotLearnable(ModelRefusal.NO_ORDER_FITTED)
    remarks = [
        Fact(OrderFact.ORDER_BROKE_DOWN, order=order)
        for order, fit in enumerate(fits, 1)
        if fit is None
    ]
    if allowed < max_order:
        remarks.append(Fact(OrderFact.ORDERS_NOT_FITTED, order=allowed + 1))
    return FlightFreeEnergy(values, box.width, box.counted.sample_count, tuple(remarks))


def free_energy_of_flights(
    flights: Mapping[str, TrainingData],
    max_order: int = DEFAULT_MAX_ORDER,
    known_inputs: bool = True,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[dict[str, FlightFreeEnergy], dict[str, NotLearnable]]:
    """Returns :func:`free_energy_by_order` ``flights`` by name, on several cores, and why others have none."""
    work = partial(_orders_or_reason, max_order=max_order, known_inputs=known_inputs)
    orders = {}
    refused = {}
    with closing(parallel_map(work, flights.values())) as coming:
        for number, (name, result) in enumerate(zip(flights, coming, strict=True), 1):
            if isinstance(result, NotLearnable):
                refused[name] = result
            else:
                orders[name] = result
            progress(number / len(flights))
    return orders, refused


def _orders_or_reason(
    flight: TrainingData, max_order: int, known_inputs: bool
) -> FlightFreeEnergy | NotLearnable:
    try:
        return free_energy_by_order(flight, max_order, known_inputs)
    except ValueError as error:
        return NotLearnable(fact_from_error(error))
