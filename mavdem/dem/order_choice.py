"""Model-order selection by the free energy (extended DEM, Algorithm ``extended_DEM``), over one or several flights."""

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Indices
from mavdem.confidence import STRONG_EVIDENCE_NATS
from mavdem.dem.engine.linalg import one_thread
from mavdem.dem.order_search import BlackBoxData, fits_by_order
from mavdem.dem.parallel import parallel_map
from mavdem.dem.record import Record, TrainingData
from mavdem.dem.validation import is_integer
from mavdem.errors import NotLearnable, fact_from_error
from mavdem.facts import Fact, Facts
from mavdem.facts.model import ModelRefusal, OrderFact

STANDARD_ERRORS = 2.0
"""Number of standard errors that a mean gain over several flights must exceed, so that no single flight decides."""

DEFAULT_MAX_ORDER = 6
"""Highest order that is fitted unless the user sets another: two states more than the paper's largest system."""

LARGEST_ORDER = 8
"""Highest order that can be fitted: more states need higher derivatives of the outputs, which would be rounding."""


class FlightFreeEnergy(NamedTuple):
    """Free energy of one flight by model order."""

    free_energy: Array
    """(N,) F̄ᵒ of the orders 1 to N, nats; NaN where no fit converged."""

    kernel_width: float
    """Width σ of the Gaussian kernel that filters the flight, s: faster motion is not seen."""

    effective_samples: float
    """Effective sample size."""

    remarks: Facts
    """Why orders are missing."""


class FreeEnergyGain(NamedTuple):
    """By how much the free energy of one order exceeds the free energy of another, nats."""

    mean: float
    """Mean over the flights; NaN if no flight has both orders."""

    standard_error: float
    """Standard error of that mean; 0 for a single flight."""


@dataclass(frozen=True, eq=False)
class OrderChoice:
    """The model order that the free energy of one or several flights selects, with the evidence for it."""

    flights: tuple[FlightFreeEnergy, ...]
    """Free energy of each flight, all with the same orders."""

    @property
    def orders(self) -> Indices:
        """(N,) the orders that were fitted, from 1."""
        return 1 + np.arange(len(self.flights[0].free_energy))

    @property
    def free_energy(self) -> Array:
        """(flights, N) F̄ᵒ by flight and order, nats; NaN where no fit converged."""
        return np.stack([flight.free_energy for flight in self.flights])

    @property
    def mean(self) -> Array:
        """(N,) mean of F̄ᵒ over the flights, nats; NaN where a flight has no fit."""
        return self.free_energy.mean(axis=0)

    @property
    def spread(self) -> Array:
        """(N,) standard deviation of F̄ᵒ over the flights, nats; NaN for a single flight."""
        if len(self.flights) == 1:
            return np.full(len(self.orders), np.nan)
        return self.free_energy.std(axis=0, ddof=1)

    def gain(self, order: int, reference: int) -> FreeEnergyGain:
        """Compares the free energy of two orders.

        Args:
            order: an order that was fitted.
            reference: the order that it is compared with.

        Returns:
            F̄ᵒ at ``order`` minus F̄ᵒ at ``reference``, nats, as the mean over the flights that have fits of both
            orders, and the standard error of that mean, which is 0 for a single flight. NaN and 0 if no flight has
            both.
        """
        # Column i is for the order i + 1.
        gain_by_flight = self.free_energy[:, order - 1] - self.free_energy[:, reference - 1]
        known_gains = gain_by_flight[np.isfinite(gain_by_flight)]
        flight_count = len(known_gains)
        if flight_count == 0:
            return FreeEnergyGain(np.nan, standard_error=0.0)
        standard_error = 0.0
        if flight_count > 1:
            standard_error = known_gains.std(ddof=1) / np.sqrt(flight_count)
        return FreeEnergyGain(known_gains.mean(), standard_error)

    @property
    def chosen(self) -> int:
        """The lowest order for which no higher order is strongly better.

        An order is strongly better if its F̄ᵒ, averaged over the flights, is higher by strong evidence and, with several
        flights, by more than the standard errors of the mean (:meth:`_is_strong_gain`).
        """
        # Orders that were fitted to at least one flight.
        has_fit = np.isfinite(self.free_energy).any(axis=0)
        fitted_orders = self.orders[has_fit].tolist()
        for order in fitted_orders:
            higher_orders = [higher_order for higher_order in fitted_orders if higher_order > order]
            if not any(self._is_strong_gain(higher_order, order) for higher_order in higher_orders):
                return order
        raise ValueError("no order was fitted")

    def _is_strong_gain(self, order: int, reference: int) -> bool:
        """Returns whether ``order`` gains strong evidence over a lower one, ``reference``."""
        gain, standard_error = self.gain(order, reference)
        return gain > max(STRONG_EVIDENCE_NATS, STANDARD_ERRORS * standard_error)

    @property
    def saturated(self) -> bool:
        """Whether an order higher than the chosen one was fitted, so that F̄ is seen to saturate."""
        return bool(np.isfinite(self.free_energy[:, self.chosen :]).any())

    @property
    def reason(self) -> Fact:
        """Why this order is chosen: how much free energy a higher order would gain at most, and how much it would need.

        It is a fact, from which reports make a sentence. It contains the largest mean gain of a higher order over the
        chosen one, nats (``None`` if no higher one was fitted), and the two limits that the gain would have to exceed
        (:attr:`chosen`).
        """
        chosen = self.chosen
        finite_gains = []
        for order in self.orders.tolist():
            if order > chosen:
                gain, _ = self.gain(order, chosen)
                if np.isfinite(gain):
                    finite_gains.append(gain)
        largest_gain = max(finite_gains, default=None)
        return Fact(
            OrderFact.ORDER_CHOSEN,
            order=chosen,
            free_energy_gain=largest_gain,
            least_gain=STRONG_EVIDENCE_NATS,
            standard_errors=STANDARD_ERRORS if len(self.flights) > 1 else None,
        )

    @property
    def remarks(self) -> Facts:
        """Why orders are missing, each reason once."""
        remarks_of_all = [remark for flight in self.flights for remark in flight.remarks]
        return tuple(dict.fromkeys(remarks_of_all))


def free_energy_by_order(
    flight: TrainingData,
    max_order: int = DEFAULT_MAX_ORDER,
    known_inputs: bool = True,
) -> FlightFreeEnergy:
    """Fits models with 1, 2, … states to one flight, and returns the free energy F̄ᵒ of each.

    All models have A, B and C free, the same data and priors of the same form. So their free energies, which are
    approximate log evidences, can be compared: F̄ᵒ increases with the number of states and saturates. It saturates at
    the number of states that can be seen in the outputs. These include the states of coloured wind, but not a state
    that no output depends on or that nothing excites.

    Args:
        flight: a ``Flight`` or segments of one.
        max_order: the highest order that is fitted, up to ``LARGEST_ORDER``.
        known_inputs: whether the recorded inputs drive the system; if not, as many unknown inputs drive it (η̃ᵛ = 0).

    Returns:
        F̄ᵒ of the orders 1 to ``max_order``, and the reasons for those that are missing.

    Raises:
        ValueError: an argument is wrong, the flight is too short, or no order can be fitted to it.
    """
    if not (is_integer(max_order) and 1 <= max_order <= LARGEST_ORDER):
        raise ValueError(
            f"max_order must be a whole number from 1 to {LARGEST_ORDER}, not {max_order!r}"
        )
    record = Record.from_flights(flight)
    with one_thread():
        data = BlackBoxData.from_record(record, max_order, known_inputs)
        effective_samples = data.effective_statistics.sample_count
        # A model of n states has n (r + m) parameters, and n² more that only determine the coordinates of the states.
        # Their number n (r + m) must not exceed the number of effective values of the outputs.
        values_per_order = effective_samples * data.m / (data.r + data.m)
        highest_order = min(max_order, max(1, int(values_per_order)))
        fits = fits_by_order(data, highest_order)
    free_energy = np.full(max_order, np.nan)
    remarks = []
    for order, fit in enumerate(fits, 1):
        if fit is None:
            remarks.append(Fact(OrderFact.ORDER_BROKE_DOWN, order=order))
        else:
            free_energy[order - 1] = fit.free_energy
    if not np.isfinite(free_energy).any():
        raise NotLearnable(ModelRefusal.NO_ORDER_FITTED)
    if highest_order < max_order:
        remarks.append(Fact(OrderFact.ORDERS_NOT_FITTED, order=highest_order + 1))
    return FlightFreeEnergy(free_energy, data.kernel_width, effective_samples, tuple(remarks))


class FreeEnergyOfFlights(NamedTuple):
    """The free energy by order of several flights."""

    results: dict[str, FlightFreeEnergy]
    """Results of :func:`free_energy_by_order` by name of the flight."""

    refusals: dict[str, NotLearnable]
    """The reason why each other flight has none, by its name."""


def free_energy_of_flights(
    flights: Mapping[str, TrainingData],
    max_order: int = DEFAULT_MAX_ORDER,
    *,
    known_inputs: bool = True,
    progress: Callable[[float], None] = lambda fraction: None,
) -> FreeEnergyOfFlights:
    """Returns the free energy by order of several flights, computed on several cores.

    Args:
        flights: flights, or lists of the segments of a flight, by name.
        max_order: the highest order that is fitted.
        known_inputs: whether the recorded inputs drive the system.
        progress: function that is called after each flight with the completed fraction of the flights.

    Returns:
        The free energies of the flights, and the reasons for the flights that have none.
    """
    search_orders = partial(_free_energy_or_reason, max_order=max_order, known_inputs=known_inputs)
    free_energies: dict[str, FlightFreeEnergy] = {}
    refusals: dict[str, NotLearnable] = {}
    # If an exception ends the loop, closing the generator cancels the remaining jobs.
    with closing(parallel_map(search_orders, flights.values())) as outcomes:
        for completed_count, (name, outcome) in enumerate(zip(flights, outcomes, strict=True), 1):
            if isinstance(outcome, NotLearnable):
                refusals[name] = outcome
            else:
                free_energies[name] = outcome
            progress(completed_count / len(flights))
    return FreeEnergyOfFlights(free_energies, refusals)


def _free_energy_or_reason(
    flight: TrainingData, max_order: int, known_inputs: bool
) -> FlightFreeEnergy | NotLearnable:
    """Returns the result of :func:`free_energy_by_order`, or its error as a value.

    It runs in a worker process. If it raised the error, the work on all flights would end.

    Args:
        flight: a ``Flight`` or segments of one.
        max_order: the highest order that is fitted.
        known_inputs: whether the recorded inputs drive the system.

    Returns:
        The free energies, or the error with the reason why there are none.
    """
    try:
        return free_energy_by_order(flight, max_order, known_inputs)
    except ValueError as error:
        return NotLearnable(fact_from_error(error))
