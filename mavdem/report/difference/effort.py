"""Whether all motors work harder in state B: mean output at equal voltage, which relative trims do not show."""

from mavdem.facts.motors import MotorsBetween
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.report_columns import value_at
from mavdem.motors.effort import EffortChange
from mavdem.motors.health import MIN_FAULT_PROBABILITY
from mavdem.report.blocks import Sentence
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.templates import render_section


def stated_effort_change(reviewed: ReviewedDifference) -> EffortChange | None:
    """Returns the change of the mean motor output at equal voltage, if a comparison states it as a difference.

    Args:
        reviewed: comparison of two states.

    Returns:
        The change, whose 90 % interval excludes "no change". None without one, of two vehicles, where a motor that is
        named as weak explains it, and where the light of the motors states it already.
    """
    effort = reviewed.difference.effort
    is_explained = bool(reviewed.motors.suspects) or _is_stated_by_light(reviewed)
    if effort is None or is_explained or reviewed.are_two_vehicles:
        return None
    low, high = effort.interval
    return None if low <= 0 <= high else effort


def _is_stated_by_light(reviewed: ReviewedDifference) -> bool:
    """Returns whether the motors of a side are judged by a changed effort, which the sentence on them then states."""
    codes = {value_at(review, "motor_health.code") for review in reviewed.reviews.values()}
    return MotorsBetween.EFFORT_CHANGED in codes


def effort_steps(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the next step where all motors work harder or less hard than in A or in earlier flights; else none.

    Args:
        reviewed: comparison of two states of one vehicle.
    """
    if stated_effort_change(reviewed) is None and not _is_stated_by_light(reviewed):
        return []
    return render_section("effort_next")


def effort_sentences(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the sentence on motors that all work harder or less hard in B; empty where none is stated.

    Args:
        reviewed: comparison of two states.
    """
    effort = stated_effort_change(reviewed)
    if effort is None:
        return []
    _, later_name = STATE_NAMES
    return render_section(
        "difference_effort",
        side=later_name,
        effort=effort,
        is_doubtful=effort.probability < MIN_FAULT_PROBABILITY,
    )
