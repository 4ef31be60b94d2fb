"""The goal of the stability margins in sentences: what it is, which axes reach it, and what was not checked."""

from collections.abc import Mapping
from enum import StrEnum
from typing import NamedTuple

from mavdem.assessment.axis.tuning import Tuning
from mavdem.containers import group_by
from mavdem.loops.advice import Advice
from mavdem.loops.axis_loops import MarginTarget, margin_rating
from mavdem.loops.gain_design import EFFECTIVENESS_FACTORS, SURE_SHARE
from mavdem.report.blocks import Sentence
from mavdem.report.templates import model_share, render_section
from mavdem.report.tuning.outcomes import has_doubtful_margins


def goal_sentences(tuning: Tuning) -> list[Sentence]:
    """Returns the goal of the margins, and at which thrust it is to hold; empty if no gains are advised or kept."""
    if tuning.refusal is not None:
        return []
    return sentences_on_goal(tuning.advice[0].target)


def sentences_on_goal(target: MarginTarget) -> list[Sentence]:
    """Returns the sentence on a goal of the margins, such as 45° of phase margin, and on the thrust it must hold at."""
    return render_section("tune_goal", target=target, deviation=_largest_checked_thrust_change())


def goal_reached_sentences(tuning: Tuning) -> list[Sentence]:
    """Returns the sentence on the goal of the margins for all axes whose margins are known and not doubtful.

    Args:
        tuning: the advice for each axis, or the fact (coded finding) that says why there is none.

    Returns:
        The sentence (:func:`sentences_on_reached_goal`); empty if no gains are advised or kept.
    """
    if tuning.refusal is not None:
        return []
    advice_by_axis = {}
    for axis, advice in tuning.axes.items():
        if isinstance(advice, Advice) and not has_doubtful_margins(tuning, axis):
            advice_by_axis[axis] = advice
    return sentences_on_reached_goal(advice_by_axis)


def sentences_on_reached_goal(advice_by_axis: Mapping[str, Advice]) -> list[Sentence]:
    """Returns sentences on whether the axes reach the goal of the margins, one for each kind of gains.

    The kinds are new gains, gains that were tried and are not to be loaded, and the present gains of the other axes. A
    sentence states what share of the vehicle models that agree with the flight reach the goal, such as 84 %.

    Args:
        advice_by_axis: advice on the gains of each axis whose margins are known.
    """
    axes_by_gains = group_by(advice_by_axis, lambda axis: _kind_of_gains(advice_by_axis[axis]))
    sentences: list[Sentence] = []
    for gains, axes in axes_by_gains.items():
        shares_by_axis = {axis: _shares_reaching_goal(advice_by_axis[axis]) for axis in axes}
        prospects = [shares.prospect for shares in shares_by_axis.values()]
        sentences += render_section(
            "tune_goal_reached",
            gains=gains,
            deviation=_largest_checked_thrust_change(),
            expects_another_step=_GoalProspect.IMPROBABLE in prospects,
            # Axes with the same shares have one clause of the sentence.
            axes_by_shares=group_by(shares_by_axis, shares_by_axis.__getitem__),
        )
    return sentences


def _kind_of_gains(advice: Advice) -> str:
    """Returns which gains an axis is judged with: "new", "tried" if none of them is to be loaded, or "present"."""
    if not advice.parameters:
        return "present"
    return "new" if advice.is_sound else "tried"


class _GoalProspect(StrEnum):
    """Whether an axis reaches the goal of the margins, by the vehicle models that agree with its flight."""

    SURE = "sure"
    """Nearly all models reach it, with more and with less thrust, too."""
    SURE_AT_FLOWN_THRUST = "sure_at_flown_thrust"
    """Nearly all models reach it with the thrust of the flight, but not with more or less, as of another battery."""
    PROBABLE = "probable"
    """Most models reach it with the thrust of the flight."""
    IMPROBABLE = "improbable"
    """Most models miss it even with the thrust of the flight."""


class _SharesReachingGoal(NamedTuple):
    """How many of the models of the vehicle reach the goal of the margins on an axis."""

    prospect: _GoalProspect
    """What these shares mean for the pilot."""
    at_flown_thrust: str
    """Share with the thrust of the flight, as a text such as "84 %"."""
    at_all_thrusts: str
    """Share with more and with less thrust, too, as a text."""
    with_present_gains: str
    """Share with the gains that flew, with the thrust of the flight, as a text."""


def _shares_reaching_goal(advice: Advice) -> _SharesReachingGoal:
    """Returns the shares of vehicle models that reach the goal of the margins with the gains to set or to keep.

    Args:
        advice: advice on an axis; without gains to set, its loop "after" is the one that flew.
    """
    share_at_flown_thrust = advice.after.share_meeting(advice.target)
    is_certain = margin_rating(advice.after, advice.target).is_good
    return _SharesReachingGoal(
        prospect=_goal_prospect(share_at_flown_thrust, advice.sure, is_certain=is_certain),
        at_flown_thrust=model_share(share_at_flown_thrust),
        at_all_thrusts=model_share(advice.sure),
        with_present_gains=model_share(1 - advice.fraction_without_margins_before),
    )


def _goal_prospect(
    share_at_flown_thrust: float, share_at_all_thrusts: float, *, is_certain: bool
) -> _GoalProspect:
    """Returns how probable it is that an axis reaches the goal of the margins.

    Args:
        share_at_flown_thrust: fraction of the models that reach it with the thrust of the flight.
        share_at_all_thrusts: fraction of those that also reach it with more and with less thrust.
        is_certain: whether the rating of the margins is good, which it is not by a log that is too slow for them.
    """
    if is_certain and share_at_all_thrusts >= SURE_SHARE:
        return _GoalProspect.SURE
    if is_certain and share_at_flown_thrust >= SURE_SHARE:
        return _GoalProspect.SURE_AT_FLOWN_THRUST
    if share_at_flown_thrust >= 1 / 2:
        return _GoalProspect.PROBABLE
    return _GoalProspect.IMPROBABLE


def _largest_checked_thrust_change() -> float:
    """Returns how much more or less thrust than in flight gains are checked with, as a fraction: 0.2 for 20 %."""
    return max(EFFECTIVENESS_FACTORS) - 1


def warning_of_unchecked_effects(tuning: Tuning) -> list[Sentence]:
    """Returns a sentence that warns the pilot of effects that may make the advised gains unstable and were not checked.

    One is the bending of the frame, which is not in the model of the vehicle. Another is a change of the thrust, by a
    fuller battery or less load, that is larger than the checked one.

    Args:
        tuning: advice on the gains of each axis, or the fact (coded finding) that says why there is none.

    Returns:
        A list with the one sentence; empty if no gains are advised on any axis.
    """
    for advice in tuning.axes.values():
        if isinstance(advice, Advice) and advice.gains:
            return render_section("loop_not_checked", deviation=_largest_checked_thrust_change())
    return []
