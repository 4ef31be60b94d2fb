"""Whether all motors work harder in state B: mean output at equal voltage, which relative trims do not show."""

from mavdem.facts.motors import MotorsBetween
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.report_columns import value_at
from mavdem.motors.effort import EffortChange
from mavdem.motors.flight_evidence import MIN_REPORTED_PROBABILITY
from mavdem.motors.health import MIN_FAULT_PROBABILITY
from mavdem.report.blocks import Sentence
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.templates import render_section


def unexplained_effort_change(reviewed: ReviewedDifference) -> EffortChange | None:
    """Returns the change of the mean motor output at equal voltage, if it is significant and nothing else explains it.

    For example, all motors work 8 % harder in B than in A.

    Args:
        reviewed: comparison of two states.

    Returns:
        The change. None if its 90 % interval includes 0, if a motor that is named as weak explains it, if the status
        light of the motors (their judgement) warns of it already, and for two different vehicles.
    """
    effort = reviewed.difference.effort
    is_explained = bool(reviewed.motors.suspects) or _does_light_warn_of_effort(reviewed)
    if effort is None or is_explained or reviewed.are_two_vehicles:
        return None
    low, high = effort.interval
    return None if low <= 0 <= high else effort


def _does_light_warn_of_effort(reviewed: ReviewedDifference) -> bool:
    """Returns whether the judgement of the motors of A or B is that all of them work harder or less hard."""
    codes = {value_at(review, "motor_health.code") for review in reviewed.reviews.values()}
    return MotorsBetween.EFFORT_CHANGED in codes


def effort_steps(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the next step if all motors work harder, or less hard, in B than in A: what to check, or to fly again.

    Args:
        reviewed: comparison of two states of one vehicle.

    Returns:
        A list with the step; empty if the effort of the motors did not change.
    """
    effort = unexplained_effort_change(reviewed)
    if effort is not None and effort.probability < MIN_REPORTED_PROBABILITY:
        # It is probably no change: another flight costs less than to check the load and the propellers.
        return render_section("difference_doubt", motor="")
    if effort is not None or _does_light_warn_of_effort(reviewed):
        return render_section("effort_next")
    return []


def effort_sentences(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the sentence that says how much harder or less hard all motors work in B than in A.

    Args:
        reviewed: comparison of two states.

    Returns:
        A list with the sentence. It leaves open whether the effort changed at all if that is improbable (below
        ``MIN_REPORTED_PROBABILITY``). Empty without a significant change that nothing else explains.
    """
    effort = unexplained_effort_change(reviewed)
    if effort is None:
        return []
    _, later_name = STATE_NAMES
    return render_section(
        "difference_effort",
        side=later_name,
        effort=effort,
        is_unlikely=effort.probability < MIN_REPORTED_PROBABILITY,
        is_doubtful=effort.probability < MIN_FAULT_PROBABILITY,
    )
