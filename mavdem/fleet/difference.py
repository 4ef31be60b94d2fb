"""Comparison of two states of a vehicle, one flight or several each: which figures of motors, plant and loops changed.

The compared quantities and their estimates from a flight are in ``quantities``, the statistics of a difference in
``random_effects``. What other conditions of flight can do widens the interval of a difference (``flight_conditions``).
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Generic, NamedTuple, TypeVar

from mavdem.confidence import CONFIDENCE_LEVEL
from mavdem.containers import Names
from mavdem.experiments.paired_test import SIGNIFICANCE
from mavdem.facts import Fact
from mavdem.facts.fleet import Incomparable, QuantityOutcome
from mavdem.fleet.comparability import (
    MissingQuantity,
    has_other_frame,
    incomparability_reason,
    missing_quantities,
)
from mavdem.fleet.effort_difference import effort_difference
from mavdem.fleet.flight_conditions import Conditions, condition_allowance, mean_conditions
from mavdem.fleet.flights import Flights, group_by_vehicle, group_into_flights, log_row
from mavdem.fleet.parameter_changes import (
    ParameterChange,
    axes_with_other_attitude_gains,
    axes_with_other_gains,
)
from mavdem.fleet.quantities import (
    LOOP_KINDS,
    SHARE,
    Estimate,
    Quantity,
    flight_estimates,
    motor_log_estimates,
    relative_to_median_motor,
)
from mavdem.fleet.random_effects import (
    SD_BETWEEN_FLIGHTS,
    QuantityChange,
    family_of,
    follows_from_gains,
    quantity_change,
    with_outcomes,
)
from mavdem.fleet.row import SYSTEM_ID_BASIS, UNKNOWN, FlightRow, FlightRows
from mavdem.fleet.trims_without_lean import trims_without_lean
from mavdem.motors.effort import EffortChange

Value = TypeVar("Value")

FlightEstimates = Sequence[Mapping[Quantity, Estimate]]
"""Estimates of the compared quantities in each flight of a state."""


class BeforeAfter(NamedTuple, Generic[Value]):
    """The same thing in the two states of a vehicle that are compared."""

    before: Value
    """In the first state, A."""

    after: Value
    """In the second state, B."""


class VehicleDifference(NamedTuple):
    """What differs between two states of a vehicle."""

    vehicles: BeforeAfter[Names]
    """Names of the vehicles in each state."""

    shared: Names
    """Names in ``vehicles`` that other vehicles may have too, since they are made of the MAVLink system id alone."""

    motors: Names
    """Names of the motors; empty where not known."""

    flights: BeforeAfter[int]
    """Number of logs of each state."""

    changes: tuple[QuantityChange, ...]
    """Quantities that are known in both states, in the order of kinds, motors and axes."""

    incomparable: tuple[MissingQuantity, ...]
    """Quantities that cannot be compared, with the reason."""

    conditions: BeforeAfter[Conditions]
    """How each state was flown."""

    axes_with_other_gains: Names = ()
    """Axes whose rate loop is known to have other gains or filters, so that its figures are not tested."""

    axes_with_other_attitude_gains: Names = ()
    """Axes whose gain from attitude to rate is known to differ, so that figures of the attitude loop are not tested."""

    false_discovery_rate: float = SIGNIFICANCE
    """Bound of the expected fraction of false alarms among a family's tested changes, averaged over families with any.

    Where nothing changed, it is the largest probability that any quantity is called changed.
    """

    level: float = CONFIDENCE_LEVEL
    """Probability of the intervals."""

    spins: tuple[int, ...] = ()
    """Direction of each motor, +1 counter-clockwise seen from above; empty where not known, or not the same in both."""

    effort: EffortChange | None = None
    """Change of the mean motor output at equal voltage; None where not comparable, as of two vehicles."""

    has_other_frame: bool = False
    """Whether the states have other frames or autopilots, as far as their logs name them."""

    @property
    def is_of_two_vehicles(self) -> bool:
        """Whether the states are known to be of two vehicles, so that differences need not be changes.

        They are if their frames, autopilots or numbers of motors differ. They are also if their names differ, provided
        that each of the names belongs to a single vehicle. MAVLink system ids show neither that two logs are of one
        vehicle nor that they are of two.
        """
        reasons = {missing.reason.code for missing in self.incomparable}
        if self.has_other_frame or Incomparable.OTHER_VEHICLES in reasons:
            return True
        names_before = set(self.vehicles.before)
        names_after = set(self.vehicles.after)
        if not names_before or not names_after or UNKNOWN in names_before | names_after:
            return False
        if set(self.shared) & (names_before | names_after):
            return False
        return names_before != names_after

    @property
    def is_of_same_flight(self) -> bool:
        """Whether a state is compared with itself, as where a user names the same log twice.

        Then number of flights, conditions and all quantities are equal.
        """
        if self.flights.before != self.flights.after:
            return False
        conditions_before, conditions_after = self.conditions
        # Conditions that are not known are equal, too, which shows nothing.
        are_conditions_known = conditions_before.collective is not None
        has_same_conditions = are_conditions_known and conditions_before == conditions_after
        has_differences = any(change.difference != 0 for change in self.changes)
        return has_same_conditions and not has_differences

    def changes_with(self, outcome: QuantityOutcome) -> list[QuantityChange]:
        """Returns the changes with this outcome."""
        return [change for change in self.changes if change.outcome == outcome]

    def follows_from_gains(self, change: QuantityChange) -> bool:
        """Returns whether a change is one of a loop whose gains or filters are known to differ."""
        return follows_from_gains(
            change.quantity, self.axes_with_other_gains, self.axes_with_other_attitude_gains
        )

    @property
    def axes_with_changed_loops(self) -> set[str]:
        """Axes of which the rate or the attitude loop is known to have other gains or filters."""
        return {*self.axes_with_other_gains, *self.axes_with_other_attitude_gains}

    @property
    def tested(self) -> list[QuantityChange]:
        """The changes that are tested: all but those that follow from other gains."""
        return [change for change in self.changes if not self.follows_from_gains(change)]

    @property
    def tested_families(self) -> list[str]:
        """Names of the families, of ``FAMILIES``, that have a tested change, each once."""
        return [*dict.fromkeys(family_of(change.quantity.kind) for change in self.tested)]


class BaselineDifference(NamedTuple):
    """What differs between the latest flight of a vehicle and its baseline, flights that are known to be healthy."""

    latest_row: FlightRow
    """The first row of the latest flight in the fleet's table."""

    difference: VehicleDifference | None
    """What differs; None if the baseline has no flight of this vehicle."""


BaselineDifferences = dict[str, BaselineDifference]
"""Differences by the name of the vehicle."""


def vehicle_difference(
    before: FlightRows, after: FlightRows, parameters: Sequence[ParameterChange] = ()
) -> VehicleDifference:
    """Compares two states of a vehicle, for example before and after a repair, or two vehicles.

    Every quantity that is estimated in both states is compared: trim shares and control effectiveness of the motors,
    rate damping, motor time constant, margins and measured steps of the rate loops. Other conditions of flight, such as
    the battery's voltage, widen its interval by an allowance. All differences are then tested together, so that many
    quantities do not raise the number of false alarms, except those of loops whose gains are known to differ.

    Args:
        before: rows of the fleet's table for the first state, one for each axis of each flight.
        after: rows of the second state. Rows without figures are left out of both.
        parameters: parameters of the autopilot that changed; none where they are not known.

    Returns:
        The differences with their outcomes; what could not be compared, with the reason; and how both states were
        flown.
    """
    flights_before = group_into_flights(row for row in before if row.is_read)
    flights_after = group_into_flights(row for row in after if row.is_read)
    conditions_before = mean_conditions(flights_before)
    conditions_after = mean_conditions(flights_after)
    estimates_before = [flight_estimates(flight) for flight in flights_before]
    estimates_after = [flight_estimates(flight) for flight in flights_after]

    states = [flights_before, flights_after]
    incomparability = incomparability_reason(states)
    comparable_kinds = _comparable_kinds(incomparability)
    changes = _changes_of_known_quantities(
        BeforeAfter(estimates_before, estimates_after),
        BeforeAfter(conditions_before, conditions_after),
        comparable_kinds,
    )

    effort = None
    if _vehicle_names(flights_before) == _vehicle_names(flights_after):
        changes = _with_changes_without_lean(changes, flights_before, flights_after)
        if SHARE in comparable_kinds:
            effort = effort_difference(flights_before, flights_after, parameters)

    first_rows = [log_row(flight) for flights in states for flight in flights]
    motors = next((row.motors for row in first_rows if row.motors), ())
    shared_names = {row.vehicle for row in first_rows if row.vehicle_basis == SYSTEM_ID_BASIS}
    axes = axes_with_other_gains(parameters)
    attitude_axes = axes_with_other_attitude_gains(parameters)
    missing_estimates = missing_quantities(
        states, [estimates_before, estimates_after], incomparability
    )
    return VehicleDifference(
        vehicles=BeforeAfter(_vehicle_names(flights_before), _vehicle_names(flights_after)),
        shared=tuple(sorted(shared_names)),
        motors=motors,
        flights=BeforeAfter(len(flights_before), len(flights_after)),
        changes=tuple(with_outcomes(changes, axes, attitude_axes)),
        incomparable=tuple(missing_estimates),
        conditions=BeforeAfter(conditions_before, conditions_after),
        axes_with_other_gains=axes,
        axes_with_other_attitude_gains=attitude_axes,
        spins=_common_spins(first_rows),
        effort=effort,
        has_other_frame=has_other_frame(states),
    )


def _changes_of_known_quantities(
    estimates: BeforeAfter[list[dict[Quantity, Estimate]]],
    conditions: BeforeAfter[Conditions],
    kinds: Collection[str],
) -> list[QuantityChange]:
    """Estimates how each quantity that is known in both states of a vehicle changed.

    Args:
        estimates: estimates of each flight of a state, by quantity.
        conditions: how the flights of both states were flown; where this differs, intervals are wider.
        kinds: kinds of quantities, such as ``SHARE`` for trims, that mean the same in both states.
    """
    changes = []
    for quantity in set().union(*estimates.before):
        if quantity.kind in kinds:
            allowance = condition_allowance(quantity.kind, *conditions)
            change = _change_if_known(quantity, estimates.before, estimates.after, allowance)
            if change is not None:
                changes.append(change)
    return changes


def _change_if_known(
    quantity: Quantity,
    before: FlightEstimates,
    after: FlightEstimates,
    allowance: float,
) -> QuantityChange | None:
    """Estimates how a quantity changed between two states; None unless at least one flight of each state has it.

    Args:
        quantity: the quantity, such as the trim of motor 2. It may be missing in some flights of a state.
        before: estimates of each flight of the first state.
        after: estimates of each flight of the second state.
        allowance: standard deviation of what other conditions may do to the difference.
    """
    values_before = [flight.get(quantity) for flight in before]
    values_after = [flight.get(quantity) for flight in after]
    if any(values_before) and any(values_after):
        return quantity_change(quantity, values_before, values_after, allowance)
    return None


def _common_spins(rows: FlightRows) -> tuple[int, ...]:
    """Returns in which direction each motor turns (1 counterclockwise, -1 clockwise), if all flights agree; else empty.

    Args:
        rows: the first row of each flight of both states.
    """
    different_spins = {row.spins or () for row in rows}
    return different_spins.pop() if len(different_spins) == 1 else ()


def _with_changes_without_lean(
    changes: Sequence[QuantityChange], before: Flights, after: Flights
) -> list[QuantityChange]:
    """Adds to each change of a motor's trim (``without_lean``) what the vehicle's lean, as in wind, does not explain.

    The effect of lean is estimated from the flights of both states together, which must be of one vehicle.

    Args:
        changes: changes of all quantities.
        before: flights of the first state, each as the list of its rows.
        after: flights of the second state.

    Returns:
        The changes in their order. Those of other quantities, and of trims that are not known without lean, are as
        before.
    """
    estimates = _trim_estimates_without_lean([*before, *after])
    estimates_before = estimates[: len(before)]
    estimates_after = estimates[len(before) :]
    extended_changes = []
    for change in changes:
        without_lean = _change_if_known(
            change.quantity, estimates_before, estimates_after, allowance=0.0
        )
        extended_changes.append(change._replace(without_lean=without_lean))
    return extended_changes


def _trim_estimates_without_lean(flights: Flights) -> list[dict[Quantity, Estimate]]:
    """Returns the trim of each motor without lean as compared quantities: logarithms relative to the median motor.

    Args:
        flights: rows of the flights of one vehicle.

    Returns:
        Estimates by quantity for each flight; empty for a flight in which they are not known.
    """
    estimates: list[dict[Quantity, Estimate]] = [{} for _ in flights]
    trims = trims_without_lean(flights)
    if trims is None:
        return estimates
    for row, index in enumerate(trims.flight_indices):
        outputs = tuple(1 + trims.estimates[row])
        logarithms = motor_log_estimates(outputs, tuple(trims.half_widths[row]))
        estimates[index] = relative_to_median_motor(SHARE, logarithms)
    return estimates


def _comparable_kinds(incomparability: Fact | None) -> list[str]:
    """Returns the kinds of quantities, such as ``SHARE`` for trims, that mean the same in two states of a vehicle.

    Args:
        incomparability: reason why the two states cannot be compared, or only in part, from
            :func:`incomparability_reason`; None if everything can be compared.

    Returns:
        All kinds without such a reason. If the models of the two states have different inputs, such as motor outputs
        and demanded torque, the kinds that do not depend on these inputs. Empty for any other reason.
    """
    if incomparability is None:
        # The table of standard deviations has an entry for each kind of quantity.
        return list(SD_BETWEEN_FLIGHTS)
    if incomparability.code is Incomparable.OTHER_INPUTS:
        # Parameters of models, such as the control effectiveness, are relative to the inputs of the model. Trims are
        # means of the motors' outputs, and margins and step responses are figures of the loop as a whole.
        return [SHARE, *LOOP_KINDS]
    # Any other reason, such as another number of motors, concerns every quantity.
    return []


def _vehicle_names(flights: Flights) -> Names:
    """Returns the names of the vehicles that flew these flights, in alphabetical order."""
    return tuple(sorted({log_row(flight).vehicle for flight in flights}))


def baseline_differences(rows: FlightRows, baseline: FlightRows) -> BaselineDifferences:
    """Compares the latest flight of each vehicle with its own flights in a baseline of healthy flights.

    Only the latest flight is compared: flights with a fault and without one, taken together, would hide the fault.
    Flights of unknown vehicles are left out.

    Args:
        rows: rows of the fleet's table, one for each axis of each flight. They may contain the baseline.
        baseline: rows of the healthy flights.

    Returns:
        The differences by the name of the vehicle.
    """
    baseline_vehicles = group_by_vehicle(baseline)
    differences: BaselineDifferences = {}
    for name, latest_flight in latest_flights(rows, baseline).items():
        healthy_rows = []
        for healthy_flight in baseline_vehicles.get(name, ()):
            healthy_rows += healthy_flight
        difference = None
        if healthy_rows:
            difference = vehicle_difference(healthy_rows, latest_flight)
        differences[name] = BaselineDifference(log_row(latest_flight), difference)
    return differences


def latest_flights(rows: FlightRows, baseline: FlightRows) -> dict[str, FlightRows]:
    """Returns the latest flight of each known vehicle that is not part of a baseline of healthy flights.

    Args:
        rows: rows of the fleet's table, one for each axis of each flight. They may contain the baseline.
        baseline: rows of the healthy flights.

    Returns:
        The rows of the latest flight, by the vehicle's name.
    """
    # The key of a row is a digest of its log, so that a flight of the baseline is recognised under any file name.
    baseline_keys = {row.key for row in baseline if row.key}
    later_rows = [row for row in rows if row.key not in baseline_keys]
    latest_flight_by_vehicle = {}
    for name, flights in group_by_vehicle(later_rows).items():
        if name != UNKNOWN:
            # Flights are in the order of their dates.
            latest_flight_by_vehicle[name] = flights[-1]
    return latest_flight_by_vehicle
