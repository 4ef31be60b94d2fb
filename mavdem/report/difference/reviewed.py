"""What the report on two states is made of: the compared figures, the reviews of both logs, and changed parameters."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from mavdem.containers import Names
from mavdem.fleet.comparability import STATE_NAMES, have_different_autopilots
from mavdem.fleet.difference import VehicleDifference, vehicle_difference
from mavdem.fleet.parameter_changes import (
    ParameterChange,
    RenamedGain,
    changed_parameters,
    parameters_changed_by_autopilot,
    renamed_gain,
    states_without_gains,
)
from mavdem.fleet.row import UNKNOWN, FlightRows
from mavdem.ingest.telemetry import Parameters
from mavdem.report.difference.lights import NO_REVIEWS, Review
from mavdem.report.difference.motors import NO_VERDICT, MotorVerdict, motor_verdict
from mavdem.report.difference.sure_trim import reviews_with_sure_trim
from mavdem.report.pages.motor_anomaly import review_with_compared_motors


class ComparedState(NamedTuple):
    """What is known of one of the two states that are compared: of a log, or of the flights of a fleet."""

    rows: FlightRows
    """Rows of the fleet's table, one for each axis of each flight."""

    review: Review
    """Document of the review of the log; empty of a fleet."""

    parameters: Parameters
    """Parameters of the autopilot, by its names; of a fleet those of control alone."""


class ReviewedDifference(NamedTuple):
    """The comparison of two states, A and B, with the reviews of their logs and the parameters that changed."""

    difference: VehicleDifference
    """The compared figures."""

    motors: MotorVerdict = NO_VERDICT
    """Whether a motor is weak, by the balance of all motors, which is more certain than each figure alone."""

    reviews: Mapping[str, Review] = NO_REVIEWS
    """Review documents of both logs, by side, "A" and "B"; of a fleet, empty."""

    parameters: Sequence[ParameterChange] = ()
    """Parameters of the autopilot that changed."""

    sides_without_parameters: Names = ()
    """Sides, "A" or "B", whose parameters are not known."""

    common_parameter_count: int = 0
    """Number of parameters that both sides have; 0 where they cannot be compared."""

    parameters_set_by_autopilot: Sequence[ParameterChange] = ()
    """Parameters that the autopilot itself set to other values, such as the learned throttle of hover."""

    renamed_gain: RenamedGain | None = None
    """A gain of the rate controllers that both sides name differently, so that none of them is compared."""

    tracked_sides: Names = ()
    """Sides, "A" or "B", of which a library has no parameters, since `mavdem track` read the log and stored none."""

    outdated_sides: Names = ()
    """Sides of which a library has only parameters of control, since an earlier version of mavdem read the log."""

    has_two_autopilots: bool = False
    """Whether A and B have different autopilots, whose parameters are not compared even where they share a name."""

    common_files: Names = ()
    """File names of flights that both sides have, before they were left out of one."""

    counting_side: str = ""
    """Side on which these flights count; empty if all flights of both sides are the same, of which none is left out."""

    is_since_baseline: bool = False
    """Whether A is the baseline of a vehicle and B its latest flight, which a report then calls so."""

    motors_by_pair: str = ""
    """What both flights show of the motors without the vehicle's other flights; empty where they were judged by no
    others, or if it is the same."""

    @property
    def has_only_control_parameters(self) -> bool:
        """Whether at most the parameters of control are compared, since a library stored no others of a side."""
        return bool(self.tracked_sides or self.outdated_sides)

    @property
    def fleet_sides(self) -> Names:
        """Sides that are flights of a fleet, whose logs are not read: their steps and spectra are not known."""
        return tuple(side for side in STATE_NAMES if "light_levels" in self.reviews.get(side, {}))

    @property
    def simulated_sides(self) -> Names:
        """Sides whose flight was simulated, as far as their logs show it."""
        return tuple(side for side in STATE_NAMES if self.reviews.get(side, {}).get("simulated"))

    @property
    def is_simulation_against_flight(self) -> bool:
        """Whether one log is of a simulated flight and the other is known to be of a real vehicle."""
        return len(self.simulated_sides) == 1 and not self.sides_of_unknown_origin

    @property
    def sides_of_unknown_origin(self) -> Names:
        """Sides of which it is not known whether a simulator or a real vehicle flew.

        A board's serial number or a sensor's own calibration names a real vehicle. A log without either shows no sign
        of a simulator, but may only lack the parameters and texts that would be one.
        """
        names_by_side = dict(zip(STATE_NAMES, self.difference.vehicles, strict=True))
        unknown_sides = []
        for side in STATE_NAMES:
            own_names = set(names_by_side[side]) - {UNKNOWN, *self.difference.shared}
            is_known = "simulated" in self.reviews.get(side, {}) and bool(own_names)
            if side not in self.simulated_sides and not is_known:
                unknown_sides.append(side)
        return tuple(unknown_sides)

    @property
    def are_two_vehicles(self) -> bool:
        """Whether the states are known to be of two vehicles, so that differences need not be changes."""
        return self.difference.is_of_two_vehicles or self.is_simulation_against_flight


def compared_states(before: ComparedState, after: ComparedState) -> ReviewedDifference:
    """Compares two states of a vehicle, such as before and after a repair, in all that a report on them shows.

    Args:
        before: the first state, called "A": a log or a group of flights, with its measured figures (rows), its review
            (the judgement of the log) and the autopilot's parameters.
        after: the second state, "B".

    Returns:
        The comparison: which figures changed from A to B, both reviews, and which parameters changed.
    """
    # Names that ArduPilot and PX4 have in common by chance, such as RC1_DZ, need not mean the same.
    has_two_autopilots = have_different_autopilots(before.rows, after.rows)
    parameter_changes: list[ParameterChange] = []
    common_parameter_count = 0
    parameters_set_by_autopilot: list[ParameterChange] = []
    if not has_two_autopilots:
        parameter_changes = changed_parameters(before.parameters, after.parameters)
        common_parameter_count = len(before.parameters.keys() & after.parameters.keys())
        parameters_set_by_autopilot = parameters_changed_by_autopilot(
            before.parameters, after.parameters
        )
    # Where gains changed, the figures of their loops are expected to change too, which is no sign of a fault.
    difference = vehicle_difference(before.rows, after.rows, parameter_changes)
    name_before, name_after = STATE_NAMES
    # A review judges the motors by one log alone. The rows add the comparison with the vehicle's other flights.
    reviews = {
        name_before: review_with_compared_motors(before.review, before.rows),
        name_after: review_with_compared_motors(after.review, after.rows),
    }
    reviewed = reviewed_difference(
        difference,
        reviews,
        parameters=parameter_changes,
        # The next ones say which parameters could be compared at all, since logs need not hold all of them.
        sides_without_parameters=states_without_gains(before.parameters, after.parameters),
        common_parameter_count=common_parameter_count,
        renamed_gain=renamed_gain(before.parameters, after.parameters),
        has_two_autopilots=has_two_autopilots,
    )
    return reviewed._replace(parameters_set_by_autopilot=parameters_set_by_autopilot)


def reviewed_difference(
    difference: VehicleDifference,
    reviews: Mapping[str, Review] = NO_REVIEWS,
    parameters: Sequence[ParameterChange] = (),
    sides_without_parameters: Names = (),
    common_parameter_count: int = 0,
    renamed_gain: RenamedGain | None = None,
    *,
    has_two_autopilots: bool = False,
) -> ReviewedDifference:
    """Combines the comparison of two states with the reviews of both logs, and judges the motors by both.

    Args:
        difference: comparison of the two states.
        reviews: review documents of both logs, by side, "A" and "B"; of a fleet, empty.
        parameters: parameters of the autopilot that changed.
        sides_without_parameters: sides, "A" or "B", whose parameters are not known.
        common_parameter_count: number of parameters that both sides have.
        renamed_gain: a gain of the rate controllers that both sides name differently; None if there is none.
        has_two_autopilots: whether both sides have different autopilots, whose parameters are not compared.
    """
    motors = motor_verdict(reviews, difference)
    return ReviewedDifference(
        difference,
        motors=motors,
        reviews=reviews_with_sure_trim(reviews, motors, difference),
        parameters=parameters,
        sides_without_parameters=sides_without_parameters,
        common_parameter_count=common_parameter_count,
        renamed_gain=renamed_gain,
        has_two_autopilots=has_two_autopilots,
    )
