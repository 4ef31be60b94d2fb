"""The order of a model by its free energy: Algorithm ``extended_DEM``, over one or several flights.

F̄ᵒ rises with the number of states up to the order of the system that made the data, and saturates there: a further
state pays with the uncertainty it adds for what little it explains (the paper's Fig. ``model_nx``).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from math import e
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.black_box import BlackBox
from mavdem.dem.by_order import climbs
from mavdem.dem.many import answer_many
from mavdem.dem.one_thread import one_thread
from mavdem.dem.real import is_number, is_whole
from mavdem.dem.record import Record, Recorded

Array = NDArray[np.float64]

STRONG = 3.0
"""Nats: odds of 20 to 1, from which Kass and Raftery (1995) call evidence strong."""

STANDARD_ERRORS = 2.0
"""Of a gain over several flights, which it must exceed as well: one flight alone does not make an order."""

MOST_STATES = 6
"""That are tried unless told otherwise: two more than the paper's largest system."""

LARGEST = 8
"""Of one output's motion so many states can be told apart: its higher derivatives would be rounding."""

UNKNOWN_INPUT = e**2
"""P̃ᵛ of inputs that nobody recorded, as in the paper; in units of the data."""


class FlightOrders(NamedTuple):
    """F̄ᵒ of one flight by order.

    Attributes:
        free_energy: (N,) nats; NaN where the flight does not tell.
        width: of the kernel that the flight is read through, s: what is faster is not seen.
        smoothness: (N,) kernel width s of the noise, seconds, as it was given or learnt for each order.
        samples: how many of the flight's tell something new.
        remarks: why orders are missing, one sentence each.
    """

    free_energy: Array
    width: float
    smoothness: Array
    samples: float
    remarks: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class OrderChoice:
    """F̄ᵒ of flights by model order, and the order it speaks for.

    Attributes:
        flights: what each flight tells; all of as many orders.
    """

    flights: tuple[FlightOrders, ...]

    @property
    def orders(self) -> NDArray[np.intp]:
        """(N,) numbers of states that were tried, from 1."""
        return 1 + np.arange(len(self.flights[0].free_energy))

    @property
    def free_energy(self) -> Array:
        """(flights, N) F̄ᵒ, nats; NaN where a flight does not tell."""
        return np.stack([flight.free_energy for flight in self.flights])

    @property
    def mean(self) -> Array:
        """(N,) over the flights, of those orders that all of them tell."""
        return np.asarray(self.free_energy.mean(axis=0))

    @property
    def spread(self) -> Array:
        """(N,) standard deviation over the flights of F̄ᵒ; NaN for a single one."""
        several = len(self.flights) > 1
        return np.asarray(self.free_energy.std(axis=0, ddof=1)) if several else np.full(len(self.orders), np.nan)

    def gain(self, order: int, over: int) -> tuple[float, float]:
        """How much higher F̄ᵒ is with one order than with another, on average over the flights that tell both, nats.

        Args:
            order: the one.
            over: the other.

        Returns:
            the mean gain, and its standard error, which is 0 for a single flight; NaN and 0 if no flight tells both.
        """
        gains = self.free_energy[:, order - 1] - self.free_energy[:, over - 1]
        gains = gains[np.isfinite(gains)]
        if not len(gains):
            return np.nan, 0.0
        return float(gains.mean()), float(gains.std(ddof=1) / np.sqrt(len(gains))) if len(gains) > 1 else 0.0

    @property
    def chosen(self) -> int:
        """The lowest order over which no higher one gains more than ``STRONG`` nats and ``STANDARD_ERRORS``."""
        told = [int(order) for order in self.orders if np.isfinite(self.free_energy[:, order - 1]).any()]
        return next(order for order in told if not any(self._gains(higher, order) for higher in told if higher > order))

    @property
    def saturated(self) -> bool:
        """Whether a higher order than the chosen one was tried."""
        return bool(np.isfinite(self.free_energy[:, self.chosen :]).any())

    @property
    def reason(self) -> str:
        """Why this order, one sentence."""
        chosen = self.chosen
        higher = [self.gain(int(order), chosen) for order in self.orders[chosen:]]
        most = max((gain for gain, _ in higher if np.isfinite(gain)), default=None)
        if most is None:
            return f"F̄ still rises at {_states(chosen)}, the most that could be tried."
        beyond = f"no further state raises it by more than {STRONG:g} nats" + (
            f" and {STANDARD_ERRORS:g} standard errors" if len(self.flights) > 1 else ""
        )
        return f"F̄ saturates at {_states(chosen)}: {beyond} (the highest gain is {most:.1f})."

    @property
    def remarks(self) -> tuple[str, ...]:
        """Why orders are missing, one sentence each."""
        return tuple(dict.fromkeys(remark for flight in self.flights for remark in flight.remarks))

    def _gains(self, order: int, over: int) -> bool:
        gain, error = self.gain(order, over)
        return gain > max(STRONG, STANDARD_ERRORS * error)

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values by name."""
        return {
            "orders": self.orders.tolist(),
            "free_energy": self.free_energy.tolist(),
            "mean": self.mean.tolist(),
            "spread": self.spread.tolist(),
            "chosen": self.chosen,
            "saturated": self.saturated,
            "reason": self.reason,
            "remarks": list(self.remarks),
            "width": [flight.width for flight in self.flights],
            "smoothness": [flight.smoothness.tolist() for flight in self.flights],
            "samples": [flight.samples for flight in self.flights],
        }


def choose_order(
    flights: Recorded | Iterable[Recorded | Sequence[Recorded]],
    max_order: int = MOST_STATES,
    known_inputs: bool = True,
    input_precision: float = UNKNOWN_INPUT,
    smoothness: float | None = None,
    executor: Executor | None = None,
) -> OrderChoice:
    """Compares model orders by F̄ᵒ, and says at which it saturates.

    Every flight is learnt by itself with 1, 2, … states, with nothing given of A, B and C, from the same data, with
    priors of the same form, and as the outputs alone show them: a state that no output feels, or that nothing moves,
    is not counted, and what colours the wind is.

    Args:
        flights: one, or several of the same inputs and outputs, each a ``Flight`` or segments of one.
        max_order: the most states that are tried, up to ``LARGEST``.
        known_inputs: whether the recorded inputs are what drives the system; if not, as many unknown ones do, η̃ᵛ = 0.
        input_precision: P̃ᵛ of unknown inputs and of each derivative, in units of the data (``BlackBox``).
        smoothness: kernel width s of the noise, seconds; ``None``: that at which F̄ᵒ is highest, for each order.
        executor: does the work, one flight at a time, in place of this process.

    Raises:
        ValueError: an argument of the wrong kind; flights of other channels; or one that is too short, or of which no
            order can be learnt.
    """
    work = partial(
        orders_of,
        max_order=max_order,
        known_inputs=known_inputs,
        input_precision=input_precision,
        smoothness=smoothness,
    )
    records = [Record.of(flight) for flight in (flights if isinstance(flights, Iterable) else [flights])]
    if not records:
        raise ValueError("flights must be at least one")
    channels = {(record.inputs.shape[1], record.outputs.shape[1]) for record in records}
    if len(channels) > 1:
        raise ValueError(f"flights must have the same numbers of inputs and outputs, not {sorted(channels)}")
    return OrderChoice(tuple(answer_many(work, records, executor)))


def orders_of(
    flight: Recorded | Sequence[Recorded],
    max_order: int = MOST_STATES,
    known_inputs: bool = True,
    input_precision: float = UNKNOWN_INPUT,
    smoothness: float | None = None,
) -> FlightOrders:
    """F̄ᵒ of one flight by order.

    Args:
        flight: or its segments.
        max_order, known_inputs, input_precision, smoothness: as for :func:`choose_order`.

    Raises:
        ValueError: likewise.
    """
    if not (is_whole(max_order) and 1 <= max_order <= LARGEST):
        raise ValueError(f"max_order must be a whole number from 1 to {LARGEST}, not {max_order!r}")
    for name, value in (("input_precision", input_precision), ("smoothness", smoothness)):
        if not (value is None and name == "smoothness" or is_number(value) and 0 < value < np.inf):
            raise ValueError(f"{name} must be a positive number, not {value!r}")
    record = Record.of(flight)
    with one_thread():
        box = BlackBox.of(record, max_order, known_inputs, input_precision)
        allowed = min(max_order, _most_states(box))
        found = climbs(box, allowed, smoothness)
    heights, learnt = np.full((2, max_order), np.nan)
    heights[:allowed] = [np.nan if one is None else one.place.height for one in found]
    learnt[:allowed] = [np.nan if one is None else one.smoothness for one in found]
    if not np.isfinite(heights).any():
        raise ValueError("no order can be learnt: every climb of F̄ broke down")
    remarks = [f"With {_states(order)} every climb broke down." for order, one in enumerate(found, 1) if one is None]
    if allowed < max_order:
        remarks.append(
            f"{_states(allowed + 1).capitalize()} and more are not tried: they have more parameters than the samples "
            "that tell something new have numbers."
        )
    highest = learnt[np.nanargmax(heights)]
    return FlightOrders(heights, box.width, learnt, box.counted(highest).number, tuple(remarks))


def _most_states(box: BlackBox) -> int:
    """The most states whose parameters, without the n² that a choice of coordinates fixes, are no more than numbers."""
    return max(1, int(box.counted(box.dt).number * box.m / (box.r + box.m)))


def _states(number: int) -> str:
    return "1 state" if number == 1 else f"{number} states"
