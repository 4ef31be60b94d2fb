"""Another yaw trim: all motors of one direction work harder in state B, and all of the other direction less."""

from mavdem.fleet.difference import VehicleDifference
from mavdem.fleet.quantities import SHARE
from mavdem.report.blocks import Sentence
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.templates import render_section


def yaw_trim_sentences(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the sentence that the motors of one direction work harder than before and the others less.

    This is a change of the yaw trim. The sentence names its possible causes, such as a twisted arm.

    Args:
        reviewed: comparison of two states.

    Returns:
        A list with the sentence; empty if the trims show no such change, or if the judgement of the motors says what
        differs.
    """
    direction = _direction_of_harder_working_motors(reviewed.difference)
    if reviewed.motors.differs or not direction:
        return []
    return render_section("difference_yaw_trim", direction=direction)


def _direction_of_harder_working_motors(difference: VehicleDifference) -> int:
    """Returns which motors work harder in B, by their direction, if all others work less hard: a change of yaw trim.

    The yaw controller compensates a twisted arm or motor in this way. The 90 % interval of each motor's change must
    exclude "no change".

    Args:
        difference: comparison of two states, with the directions of the motors.

    Returns:
        +1 for counterclockwise seen from above, -1 for clockwise; 0 without this pattern.
    """
    trims = [change for change in difference.changes if change.quantity.kind == SHARE]
    if not trims or len(trims) != len(difference.spins):
        return 0
    directions = set()
    for trim in trims:
        if trim.interval_contains_zero or trim.is_explained_by_lean:
            return 0
        spin = difference.spins[trim.quantity.motor - 1]
        directions.add(spin if trim.difference > 0 else -spin)
    # Motors of one direction alone, or an unknown direction, 0, show no yaw trim.
    has_both_directions = set(difference.spins) == {-1, 1}
    return directions.pop() if len(directions) == 1 and has_both_directions else 0
