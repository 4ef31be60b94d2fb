"""Compares two states of a vehicle, each one flight or several: which motor and plant figures changed significantly.

The variance of a difference has two parts: that within the flights, by their
intervals, and that between flights, which several flights of a state show. ``SD_BETWEEN_FLIGHTS`` is assumed
beforehand (random effects, L. V. Hedges and I. Olkin, "Statistical Methods for Meta-Analysis", 1985). What other
conditions of flight can do widens the interval. All quantities are tested together: the probability that any is called
changed when none did is at most ``SIGNIFICANCE`` where the intervals hold (S. Holm, "A simple sequentially rejective
multiple test procedure", 1979).

The compared quantities belong to the vehicle and not to its wind. The trim share and the effect of a motor are relative
to the median of all motors: a change of one motor leaves the others unchanged, and a change of all, such as by the
battery's voltage or by the bias of the closed loop, leaves each unchanged.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import exp, hypot, isclose, log, sqrt
from statistics import fmean, median
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr

from mavdem.arrays import Array
from mavdem.confidence import CONFIDENCE_LEVEL, coverage_factor
from mavdem.containers import Names, Numbers
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dem.record import MIN_MOTORS
from mavdem.experiments.paired_test import SIGNIFICANCE
from mavdem.facts import Fact
from mavdem.facts.fleet import Compared, Incomparable, QuantityOutcome
from mavdem.facts.identifiability import Status
from mavdem.fleet.flights import AxisRows, flights_of, vehicles_of
from mavdem.fleet.row import SYSTEM_ID_BASIS, UNKNOWN, FlightRow, FlightRows
from mavdem.immutable import ReadOnlyDict
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import AUTOPILOT_SET_PARAMETERS, CONTROL_PARAMETERS, RATE_GAIN
from mavdem.motors.deviation import PRIOR_BALANCE_SD

SHARE = "share"
EFFECT = "effect"
MEAN_EFFECT = "mean effect"
DAMPING = "damping"
LAG = "lag"

SD_BETWEEN_FLIGHTS = {
    SHARE: float(np.linalg.norm(PRIOR_BALANCE_SD)),
    EFFECT: 0.02,
    MEAN_EFFECT: 0.1,
    DAMPING: 0.2,
    LAG: 0.004,
}
"""Assumed standard deviation of a quantity from flight to flight of the same vehicle: of shares and effects relative,
of the damping in 1/s, of the motor time constant in s. That of shares is what the health of motors assumes for the
three axes; docs/evidence/motors.md shows where the others come from."""

PRIOR_FREEDOM = 8
"""Degrees of freedom of that assumption: it counts as much as this many flights."""

INTERVAL_FREEDOM = 20
"""Degrees of freedom of the variance within a flight, whose interval is itself an estimate."""

SD_UNKNOWN_LEAN = 0.07
"""rad, standard deviation of the difference of roll or of pitch between two states where a lean is not known: 4°."""

SD_SHARE_PER_LEAN = 0.5
"""1/rad, standard deviation of the change of a trim share by lean: drag that acts half an arm's length above or below
the centre of mass."""

EQUIVALENCE_LIMITS = {SHARE: 0.06, EFFECT: 0.2, MEAN_EFFECT: 0.3, DAMPING: 0.8, LAG: 0.02}
"""Largest difference of a quantity that is called the same, in the units of ``SD_BETWEEN_FLIGHTS``, if its whole
interval lies within (an equivalence test)."""

MAX_RELATIVE_HALF_WIDTH = 0.5
"""Largest half width of the interval of a share or an effect, relative to it: with a wider one the error of its
logarithm is not nearly normal."""

STATE_NAMES = ("A", "B")
"""How the two states are called in messages."""

UNRELIABLE_STATUSES = {Status.BIASED, Status.NOT_IDENTIFIABLE}

HALF_WIDTH_PER_SD = coverage_factor()
"""Half width of the intervals of flights, in standard deviations."""

Flights = Sequence[AxisRows]
"""Flights of one vehicle in order of date, the rows of each."""


class Quantity(NamedTuple):
    """A quantity that is compared. Shares and effects are compared by their logarithm, the others as they are."""

    kind: str
    """``SHARE``, ``EFFECT``, ``MEAN_EFFECT`` (of all motors), ``DAMPING`` or ``LAG``"""
    motor: int = 0
    """number of the motor, from 1; 0 where it is of no motor"""
    axis: str = ""
    """"roll" or "pitch"; empty where it is of no axis"""


class Estimate(NamedTuple):
    """An estimate of a quantity from one flight."""

    value: float
    """the quantity, or its logarithm"""
    sd: float
    """standard deviation of its error within the flight"""


class QuantityChange(NamedTuple):
    """One quantity in both states."""

    quantity: Quantity
    """the quantity"""
    before: float | None
    """mean of the first state; None of shares and effects, which are relative"""
    after: float | None
    """mean of the second state, likewise"""
    difference: float
    """second state less first; relative for shares and effects"""
    half_width: float
    """half width of its 90 % interval"""
    p: float
    """probability of a difference as large if nothing changed"""
    allowance: float
    """standard deviation of what other conditions of flight may do to it, which is in the half width"""
    outcome: QuantityOutcome = QuantityOutcome.SAME
    """changed; the same; or uncertain, where the interval reaches beyond what is called the same"""


class Conditions(NamedTuple):
    """How a state was flown, means over its flights; None where not known."""

    voltage: float | None
    """V of the battery"""
    collective: float | None
    """mean of the motors, as a share of their range: it depends on payload and voltage"""
    lean_roll: float | None
    """rad"""
    lean_pitch: float | None
    """rad"""
    tilt_sd: float | None
    """rad, standard deviation of the angle from level"""
    wind_torque: dict[str, float]
    """standard deviation of the wind torque by axis, rad/s²"""


class MissingQuantity(NamedTuple):
    """What cannot be compared, and the reason."""

    quantity: Fact
    """names the quantity"""
    reason: Fact
    """why it is not known in both states"""


class ParameterChange(NamedTuple):
    """A parameter of the autopilot that was set to another value."""

    name: str
    before: float
    after: float


class VehicleDifference(NamedTuple):
    """What differs between two states of a vehicle."""

    vehicles: tuple[Names, Names]
    """names of the vehicles in each state"""
    shared: Names
    """those of the names that several vehicles may have"""
    motors: Names
    """names of the motors; empty where not known"""
    flights: tuple[int, int]
    """number of flights of each state"""
    changes: tuple[QuantityChange, ...]
    """quantities that are known in both states, in the order of kinds, motors and axes"""
    incomparable: tuple[MissingQuantity, ...]
    """what is not known in both states"""
    conditions: tuple[Conditions, Conditions]
    """how each state was flown"""
    family_error: float = SIGNIFICANCE
    """probability that any quantity is called changed when none did"""
    level: float = CONFIDENCE_LEVEL
    """probability of the intervals"""

    def of(self, outcome: QuantityOutcome) -> list[QuantityChange]:
        """Returns the changes with this outcome."""
        return [change for change in self.changes if change.outcome == outcome]


BaselineDifferences = dict[str, tuple[FlightRow, VehicleDifference | None]]
"""By vehicle, the first row of its latest flight, and what differs from its baseline, if it has one."""


def vehicle_difference(before: FlightRows, after: FlightRows) -> VehicleDifference:
    """Compares two states of a vehicle, for example before and after a repair, or two vehicles.

    Every quantity that is estimated in both states is compared: trim shares and control effectiveness of the motors,
    rate damping, and motor time constant. Other conditions of flight, such as the battery's voltage, widen its interval
    by an allowance. All differences are then tested together, so that many quantities do not raise the number of false
    alarms.

    Args:
        before: rows of the fleet's table for the first state, one for each axis of each flight.
        after: rows of the second state. Rows without figures are left out of both.

    Returns:
        The differences with their outcomes; what could not be compared, with the reason; and how both states were
        flown.
    """
    # Indices 0 and 1 are the first and the second state. Estimates are, by state and flight, a dictionary by quantity.
    states = [flights_of(row for row in rows if row.is_read) for rows in (before, after)]
    conditions = (conditions_of(states[0]), conditions_of(states[1]))
    estimates = [[estimates_of(flight) for flight in flights] for flights in states]
    obstacle = comparison_obstacle(states)
    if obstacle is None:
        comparable_kinds = list(SD_BETWEEN_FLIGHTS)
    elif obstacle.code is Incomparable.OTHER_INPUTS:
        # The trim does not depend on the inputs of models.
        comparable_kinds = [SHARE]
    else:
        comparable_kinds = []
    changes = []
    # A quantity may be missing in some flights of a state: those that have it are compared.
    for quantity in {quantity for flight in estimates[0] for quantity in flight}:
        estimates_before = [flight[quantity] for flight in estimates[0] if quantity in flight]
        estimates_after = [flight[quantity] for flight in estimates[1] if quantity in flight]
        if quantity.kind in comparable_kinds and estimates_before and estimates_after:
            allowance = condition_allowance(quantity.kind, conditions)
            changes.append(quantity_change(quantity, estimates_before, estimates_after, allowance))
    first_rows = [flight[0] for flights in states for flight in flights]
    motors = next((row.motors for row in first_rows if row.motors), ())
    shared_names = {row.vehicle for row in first_rows if row.vehicle_basis == SYSTEM_ID_BASIS}
    return VehicleDifference(
        vehicles=(_vehicle_names(states[0]), _vehicle_names(states[1])),
        shared=tuple(sorted(shared_names)),
        motors=motors,
        flights=(len(states[0]), len(states[1])),
        changes=tuple(with_outcomes(changes)),
        incomparable=tuple(missing_quantities(states, estimates, obstacle)),
        conditions=conditions,
    )


def _vehicle_names(flights: Flights) -> Names:
    """Returns the names of the vehicles that flew these flights."""
    return tuple(sorted({flight[0].vehicle for flight in flights}))


def changed_parameters(before: Parameters, after: Parameters) -> list[ParameterChange]:
    """Returns the autopilot parameters that somebody set to other values between two states.

    Parameters that the autopilot itself sets, such as statistics, are left out, and so are those that only one of the
    states has: logs need not hold all parameters.

    Args:
        before: values by the autopilot's name, in the first state.
        after: the same of the second state.

    Returns:
        The changes: parameters of control first, each part in the order of names.
    """
    changes = []
    for name in before.keys() & after.keys():
        is_set_by_autopilot = AUTOPILOT_SET_PARAMETERS.search(name)
        # Logs and parameter files round float32 differently.
        is_equal = isclose(before[name], after[name], rel_tol=1e-6)
        if not is_set_by_autopilot and not is_equal:
            changes.append(ParameterChange(name, before[name], after[name]))
    return sorted(
        changes, key=lambda change: (not CONTROL_PARAMETERS.match(change.name), change.name)
    )


def states_without_gains(before: Parameters, after: Parameters) -> Names:
    """Returns the names of the states without gains of rate control: whether these changed is not known."""
    states = zip(STATE_NAMES, (before, after), strict=True)
    return tuple(name for name, parameters in states if not any(map(RATE_GAIN.match, parameters)))


def baseline_differences(rows: FlightRows, baseline: FlightRows) -> BaselineDifferences:
    """Compares the latest flight of each vehicle with its own flights in a baseline of healthy flights.

    Only the latest flight is compared: flights with a fault and without one, taken together, would hide the fault.
    Flights of unknown vehicles are left out.

    Args:
        rows: rows of the fleet's table, one for each axis of each flight. They may contain the baseline.
        baseline: rows of the healthy flights.

    Returns:
        By vehicle, the first row of its latest flight and the difference, which is None if the baseline has no flight
        of this vehicle.
    """
    # The key of a row is a digest of its log, so that a flight of the baseline is known under any file name.
    baseline_keys = {row.key for row in baseline if row.key}
    baseline_vehicles = vehicles_of(baseline)
    later_rows = [row for row in rows if row.key not in baseline_keys]
    differences: BaselineDifferences = {}
    for name, flights in vehicles_of(later_rows).items():
        if name == UNKNOWN:
            continue
        latest_flight = flights[-1]
        healthy_rows = [row for flight in baseline_vehicles.get(name, ()) for row in flight]
        difference = None
        if healthy_rows:
            difference = vehicle_difference(healthy_rows, latest_flight)
        differences[name] = (latest_flight[0], difference)
    return differences


def estimates_of(flight: AxisRows) -> dict[Quantity, Estimate]:
    """Collects what one flight tells of the compared quantities, from the rows of its axes.

    Only physical parameters with the status "reported" are taken. The bias of the others depends on wind and steering,
    so that they would seem to change with the weather.

    Args:
        flight: the rows of roll, pitch and yaw. Half widths of 90 % intervals become standard deviations.

    Returns:
        By quantity: logarithms, relative to the median motor, of trim shares and effects; the logarithm of the mean
        effect by axis; the damping, 1/s, and the motor time constant, s, by axis.
    """
    estimates: dict[Quantity, Estimate] = {}
    effects_by_axis: dict[Quantity, list[Estimate]] = {}
    for row in flight:
        axis = row.axis or ""
        # The motors' trim is the same in the rows of all axes.
        shares = log_estimates(row.trim_share, row.trim_share_interval)
        estimates |= relative_to_median(SHARE, shares)
        if row.damping_status == Status.REPORTED:
            if row.damping is not None and row.damping_interval is not None:
                sd = row.damping_interval / HALF_WIDTH_PER_SD
                estimates[Quantity(DAMPING, axis=axis)] = Estimate(row.damping, sd)
        if row.lag_status == Status.REPORTED:
            if row.lag is not None and row.lag_interval is not None:
                sd = row.lag_interval / HALF_WIDTH_PER_SD
                estimates[Quantity(LAG, axis=axis)] = Estimate(row.lag, sd)
        effects = log_estimates(row.effect, row.effect_interval)
        if effects and row.effect_status == Status.REPORTED:
            estimates[Quantity(MEAN_EFFECT, axis=axis)] = mean_estimate(effects.values())
            # A model may have the controller's demand as its input in place of the motors.
            if len(row.motors or ()) == len(row.effect or ()):
                for quantity, estimate in relative_to_median(EFFECT, effects).items():
                    effects_by_axis.setdefault(quantity, []).append(estimate)
    # The effect of a motor on roll and on pitch changes by the same factor.
    for quantity, axis_estimates in effects_by_axis.items():
        estimates[quantity] = mean_estimate(axis_estimates)
    return estimates


def mean_estimate(estimates: Iterable[Estimate]) -> Estimate:
    """Returns the mean of estimates whose errors have much in common: it is known no better than the worst of them."""
    estimates = list(estimates)
    return Estimate(
        value=fmean(estimate.value for estimate in estimates),
        sd=max(estimate.sd for estimate in estimates),
    )


def log_estimates(values: Numbers | None, half_widths: Numbers | None) -> dict[int, Estimate]:
    """Returns the logarithm of a quantity of each motor, so that a change by a factor is a difference.

    The error of ln x is that of x divided by x, to first order. This holds for small errors only, so values with wider
    intervals are left out.

    Args:
        values: (r,) of the motors, in any unit. Their signs are ignored: an effect has the sign of the motor's side.
        half_widths: (r,) of their 90 % intervals, in the same unit.

    Returns:
        Estimates by the number of the motor, from 1.
    """
    estimates = {}
    pairs = zip(values or (), half_widths or (), strict=False)
    for motor, (value, half_width) in enumerate(pairs, 1):
        if half_width is not None and half_width < MAX_RELATIVE_HALF_WIDTH * abs(value):
            sd = half_width / abs(value) / HALF_WIDTH_PER_SD
            estimates[motor] = Estimate(log(abs(value)), sd)
    return estimates


def relative_to_median(kind: str, estimates: Mapping[int, Estimate]) -> dict[Quantity, Estimate]:
    """Returns each motor's logarithm less the median of all motors: how far the motor is from the typical one.

    What all motors have in common, such as the battery's voltage, drops out. The median does not move if a single motor
    changes, so the others stay unchanged. The error of the median is neglected.

    Args:
        kind: ``SHARE`` or ``EFFECT``.
        estimates: logarithms by the number of the motor.

    Returns:
        Estimates by quantity; nothing with fewer than ``MIN_MOTORS``, whose median is no typical motor.
    """
    if len(estimates) < MIN_MOTORS:
        return {}
    median_value = median(estimate.value for estimate in estimates.values())
    relative = {}
    for motor, estimate in estimates.items():
        relative[Quantity(kind, motor)] = Estimate(estimate.value - median_value, estimate.sd)
    return relative


class StateEstimates(NamedTuple):
    """The estimates of one quantity in the f flights of a state."""

    values: Array
    """(f,) the estimates"""
    variances: Array
    """(f,) of their errors within the flights"""

    @classmethod
    def of(cls, estimates: Sequence[Estimate]) -> "StateEstimates":
        """Returns the estimates as arrays."""
        values = np.array([estimate.value for estimate in estimates])
        variances = np.array([estimate.sd**2 for estimate in estimates])
        return cls(values, variances)

    @property
    def excess_squares(self) -> float:
        """What the squared deviations from the mean exceed their expectation by, if flights did not differ at all.

        Errors of variances v within f flights alone give Σ (x − x̄)² an expectation of Σ v (1 − 1/f). The rest comes
        from real differences between the flights. It is negative by chance where there are none.
        """
        squares = ((self.values - self.values.mean()) ** 2).sum()
        return float(squares - self.variances.sum() * (1 - 1 / self.values.size))


def quantity_change(
    quantity: Quantity,
    before: Sequence[Estimate],
    after: Sequence[Estimate],
    allowance: float,
) -> QuantityChange:
    """Estimates the difference of one quantity between two states by a random-effects model (Hedges and Olkin, 1985).

    The variance of a flight's estimate is that within the flight plus a common variance between flights, τ². The mean
    of a state weighs its flights by the inverse of that sum. τ² combines the assumed ``SD_BETWEEN_FLIGHTS``, which
    counts as ``PRIOR_FREEDOM`` flights, with the scatter that the flights show. The difference has a t distribution.

    Args:
        quantity: what is compared.
        before: estimates in the flights of the first state, at least one.
        after: estimates in the flights of the second state, at least one.
        allowance: standard deviation of what other conditions may do to the difference.

    Returns:
        The change, not yet tested together with others.
    """
    states = [StateEstimates.of(before), StateEstimates.of(after)]
    # τ²: squares of the assumption and of the flights, over the degrees of freedom of both.
    observed_freedom = sum(state.values.size - 1 for state in states)
    between_freedom = PRIOR_FREEDOM + observed_freedom
    excess = sum(state.excess_squares for state in states)
    prior_squares = PRIOR_FREEDOM * SD_BETWEEN_FLIGHTS[quantity.kind] ** 2
    variance_between = (prior_squares + max(excess, 0.0)) / between_freedom
    # The variance of the difference is the sum of those of both means. It is split into the two parts that come from τ²
    # and from within the flights, since these are known with different degrees of freedom.
    means = []
    variance = 0.0
    variance_from_between = 0.0
    for state in states:
        weights = 1 / (state.variances + variance_between)
        total_weight = weights.sum()
        means.append(float(weights @ state.values / total_weight))
        variance += float(1 / total_weight)
        variance_from_between += float(((weights / total_weight) ** 2).sum() * variance_between)
    variance_from_within = variance - variance_from_between
    # Degrees of freedom of the sum by Welch and Satterthwaite.
    freedom = variance**2 / (
        variance_from_between**2 / between_freedom + variance_from_within**2 / INTERVAL_FREEDOM
    )
    sd = hypot(sqrt(variance), allowance)
    half_width = coverage_factor(freedom=freedom) * sd
    mean_before, mean_after = means
    difference = mean_after - mean_before
    # Two-sided probability of such a difference if nothing changed.
    p = float(2 * stdtr(freedom, -abs(difference) / sd))
    if quantity.kind in (DAMPING, LAG):
        return QuantityChange(
            quantity, mean_before, mean_after, difference, half_width, p, allowance
        )
    # The difference of logarithms is the logarithm of the ratio; its interval is linearized at the estimate.
    ratio = exp(difference)
    return QuantityChange(quantity, None, None, ratio - 1, ratio * half_width, p, allowance)


def with_outcomes(changes: Sequence[QuantityChange]) -> list[QuantityChange]:
    """Decides for each quantity whether it changed, by a test of all together (Holm's step-down procedure, 1979).

    Each quantity that is tested by itself adds its own chance of a false alarm. Holm's procedure bounds the chance of
    any at ``SIGNIFICANCE``: from the smallest p-value on, quantities are called changed until the first one whose p
    exceeds ``SIGNIFICANCE`` divided by the number of those not yet tested. The others are the same if their interval
    lies within ``EQUIVALENCE_LIMITS``, else uncertain.

    Args:
        changes: the differences with their p-values.

    Returns:
        The changes with their outcomes, in the order of kinds, motors and axes.
    """
    tested = []
    # After the first quantity that is not called changed, none of larger p may be.
    may_reject = True
    for rank, change in enumerate(sorted(changes, key=lambda change: change.p)):
        may_reject = may_reject and change.p <= SIGNIFICANCE / (len(changes) - rank)
        limit = EQUIVALENCE_LIMITS[change.quantity.kind]
        if may_reject:
            outcome = QuantityOutcome.CHANGED
        elif abs(change.difference) + change.half_width <= limit:
            outcome = QuantityOutcome.SAME
        else:
            outcome = QuantityOutcome.UNCERTAIN
        tested.append(change._replace(outcome=outcome))
    kinds = list(SD_BETWEEN_FLIGHTS)
    return sorted(tested, key=lambda change: (kinds.index(change.quantity.kind), change.quantity))


def condition_allowance(kind: str, conditions: tuple[Conditions, Conditions]) -> float:
    """Returns how much other conditions of flight alone may change a quantity.

    The trim shares depend on the lean of the vehicle, since drag acts above or below the centre of mass. The mean
    effect of the motors depends on voltage and thrust. The other quantities get no allowance.

    Args:
        kind: kind of the quantity, such as ``SHARE``.
        conditions: how both states were flown.

    Returns:
        A standard deviation in the unit of the difference: relative for shares and effects.
    """
    before, after = conditions
    if kind == SHARE:
        roll_change = _lean_change(before.lean_roll, after.lean_roll)
        pitch_change = _lean_change(before.lean_pitch, after.lean_pitch)
        return SD_SHARE_PER_LEAN * hypot(roll_change, pitch_change)
    if kind == MEAN_EFFECT:
        # At the same thrust the effect is proportional to the voltage, and with more thrust to the output.
        log_changes = [
            abs(log(first / second))
            for first, second in (
                (before.voltage, after.voltage),
                (before.collective, after.collective),
            )
            if first and second
        ]
        return sum(log_changes)
    return 0.0


def _lean_change(before: float | None, after: float | None) -> float:
    """Returns the change of a lean angle, rad; ``SD_UNKNOWN_LEAN`` where one of the two is not known."""
    if before is None or after is None:
        return SD_UNKNOWN_LEAN
    return before - after


def conditions_of(flights: Flights) -> Conditions:
    """Returns how flights were flown: means over the flights that have a value, None where no flight has one.

    Args:
        flights: of one state, the rows of each by axis.
    """
    # The conditions are the same in the rows of all axes, but for the wind torque.
    first_rows = [flight[0] for flight in flights]
    wind_torques = {}
    for axis in AXES:
        torques = [row.wind_torque_sd for flight in flights for row in flight if row.axis == axis]
        mean_torque = _known_mean(torques)
        if mean_torque is not None:
            wind_torques[axis] = mean_torque
    return Conditions(
        voltage=_known_mean(row.voltage_mean for row in first_rows),
        collective=_known_mean(row.collective for row in first_rows),
        lean_roll=_known_mean(row.lean_roll for row in first_rows),
        lean_pitch=_known_mean(row.lean_pitch for row in first_rows),
        tilt_sd=_known_mean(row.tilt_sd for row in first_rows),
        wind_torque=ReadOnlyDict(wind_torques),
    )


def _known_mean(values: Iterable[float | None]) -> float | None:
    """Returns the mean of the values that are known; None if there are none."""
    known_values = [value for value in values if value is not None]
    return fmean(known_values) if known_values else None


def comparison_obstacle(states: Sequence[Flights]) -> Fact | None:
    """Returns why two states cannot be compared at all, or in part; None where all can be compared.

    Only states of the same number of motors, unit of trim, and inputs of the models have figures of the same meaning.
    After ``Incomparable.OTHER_INPUTS``, the last to be checked, the trim can still be compared: it needs no model.

    Args:
        states: the flights of the first and of the second state.
    """
    for name, flights in zip(STATE_NAMES, states, strict=True):
        if not flights:
            return Fact(Incomparable.NO_FLIGHT, subject=name)
    properties = {
        Incomparable.OTHER_VEHICLES: _motor_count,
        Incomparable.OTHER_UNITS: _trim_unit,
        Incomparable.OTHER_INPUTS: _inputs_of_model,
    }
    for code, property_of in properties.items():
        # Flights of one state may differ among themselves, so one value in common is enough.
        before, after = (
            {property_of(row) for flight in flights for row in flight} - {None, ""}
            for flights in states
        )
        if before and after and not before & after:
            return Fact(code, before=_sorted_texts(before), after=_sorted_texts(after))
    return None


def _motor_count(row: FlightRow) -> str | None:
    """Returns the number of motors in words; None where it is not known."""
    return f"{len(row.motors)} motors" if row.motors else None


def _trim_unit(row: FlightRow) -> str | None:
    """Returns the unit of the motors' trim; None where it is not known."""
    return row.trim_unit


def _inputs_of_model(row: FlightRow) -> str | None:
    """Returns the inputs of a flight's model and their unit; None where it has no model."""
    return f"{row.inputs} {row.input_unit}" if row.effect_status else None


def missing_quantities(
    states: Sequence[Flights],
    estimates: Sequence[Sequence[Iterable[Quantity]]],
    obstacle: Fact | None,
) -> Iterator[MissingQuantity]:
    """Yields what a reader would expect to be compared but is not, each with the reason.

    Expected are the trim shares, the effects of the motors, and damping and motor time constant of roll and pitch.

    Args:
        states: the flights of both states.
        estimates: by state and flight, the quantities that have an estimate.
        obstacle: why nothing, or nothing that needs a model, can be compared; from :func:`comparison_obstacle`.

    Yields:
        One entry for all quantities, or one for all of models, where there is an obstacle; else one for each quantity.
    """
    if obstacle is not None and obstacle.code is not Incomparable.OTHER_INPUTS:
        yield MissingQuantity(Fact(Compared.EVERYTHING), obstacle)
        return
    expected = [Quantity(SHARE)]
    if obstacle is None:
        expected.append(Quantity(EFFECT))
        for kind in (DAMPING, LAG):
            expected += [Quantity(kind, axis=axis) for axis in TILT_AXES]
    else:
        yield MissingQuantity(Fact(Compared.OF_MODELS), obstacle)
    for quantity in expected:
        reasons = []
        for name, flights, flight_estimates in zip(STATE_NAMES, states, estimates, strict=True):
            if not _has_estimate(quantity, flight_estimates):
                reasons.append(missing_reason(quantity, name, flights))
        if reasons:
            fact = Fact(Compared.QUANTITY, subject=quantity.axis, name=quantity.kind)
            yield MissingQuantity(fact, Fact(Incomparable.NOT_IN_BOTH, reasons=reasons))


def _has_estimate(quantity: Quantity, flight_estimates: Sequence[Iterable[Quantity]]) -> bool:
    """Returns whether any flight estimates a quantity of this kind, and of this axis if it has one."""
    for flight in flight_estimates:
        for estimated in flight:
            if estimated.kind == quantity.kind and quantity.axis in ("", estimated.axis):
                return True
    return False


def missing_reason(quantity: Quantity, state_name: str, flights: Flights) -> Fact:
    """Returns why a state has no estimate of a quantity.

    Either its models say that their value is biased or not identifiable, or no flight has a value at all.

    Args:
        quantity: what is missing.
        state_name: "A" or "B", for the message.
        flights: the flights of the state.
    """
    statuses = set()
    for flight in flights:
        for row in flight:
            if quantity.axis in ("", row.axis):
                statuses.add(getattr(row, f"{quantity.kind}_status", None))
    unreliable = statuses & UNRELIABLE_STATUSES
    if unreliable:
        names = _sorted_texts(unreliable)
        return Fact(Incomparable.NOT_REPORTED, subject=state_name, names=names)
    return Fact(Incomparable.NOT_ESTIMATED, subject=state_name)


def _sorted_texts(values: Iterable[object]) -> list[str]:
    """Returns values as text, in alphabetical order."""
    return sorted(str(value) for value in values)
