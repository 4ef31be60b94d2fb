"""What becomes of the gains of each axis after a tuning: new, kept, lowered or unknown, and that in words."""

from enum import StrEnum

from mavdem.assessment.axis.tuning import Tuning
from mavdem.containers import group_by
from mavdem.facts import Fact
from mavdem.facts.loops import ControllerFact
from mavdem.loops.advice import Advice
from mavdem.report.blocks import Sentence
from mavdem.report.templates import render_section


class GainOutcome(StrEnum):
    """What becomes of the gains of an axis, as the headline of a tuning says it; in the order of the headline."""

    NEW = "new"
    """New gains are advised."""
    KEEP = "keep"
    """The loops have their margins, and the gains stay."""
    KEEP_UNSURE = "keep_unsure"
    """The gains stay, but too few models of the vehicle have the margins, or the log is too slow to show them."""
    FLY_FIRST = "fly_first"
    """Other gains were tried, and another flight is to confirm them before they are loaded."""
    LOWER = "lower"
    """Gains are lowered, since the axis oscillates or lacks margin by a measurement, and none can be computed."""
    LOWER_ON_TRIAL = "lower_on_trial"
    """Gains are lowered for one hover, which shows whether little margin is the cause of a peak of the rate."""
    REPAIR_FIRST = "repair_first"
    """The margins are known, and the vehicle must be repaired before any gains are advised."""
    DOUBTFUL = "doubtful"
    """The margins of the identified loop may be wrong, and no gains are advised."""
    UNKNOWN = "unknown"
    """No loop was identified."""


OUTCOMES_WITHOUT_MARGINS = (GainOutcome.DOUBTFUL, GainOutcome.UNKNOWN)
"""Outcomes of axes whose gains are neither set nor kept, since their margins are not known, or may be wrong."""


OUTCOMES_WITHOUT_GAINS = (GainOutcome.REPAIR_FIRST, *OUTCOMES_WITHOUT_MARGINS)
"""Outcomes of axes whose gains are neither set nor kept, for any reason."""


def outcome_sentences(tuning: Tuning) -> list[Sentence]:
    """Returns the sentence on what becomes of the gains of each axis, as "Roll: new gains. Yaw: keep the gains.".

    Args:
        tuning: advice on the gains of each axis, or the fact (coded finding) that says why its loop is not known.

    Returns:
        A list with the sentence. If the margins of no axis are known, it says only that, or names an unknown mixer.
    """
    axes_by_outcome = group_by(tuning.axes, lambda axis: gain_outcome(tuning, axis))
    outcomes_with_margins = axes_by_outcome.keys() - set(OUTCOMES_WITHOUT_MARGINS)
    return render_section(
        "tune_axes",
        axes=[*tuning.axes],
        axes_by_outcome=axes_by_outcome,
        outcomes=[*GainOutcome],
        has_outcomes=bool(outcomes_with_margins),
        sluggish_axes=_sluggish_axes(tuning),
        mixer_fault=mixer_fault(tuning),
    )


def mixer_fault(tuning: Tuning) -> Fact | None:
    """Returns the fact (coded finding) that the mixer of the vehicle's motors is not known; None if it is."""
    for fault in tuning.controller_faults.values():
        if fault.code is ControllerFact.MIXER_UNKNOWN:
            return fault
    return None


def _sluggish_axes(tuning: Tuning) -> list[str]:
    """Returns the axes, such as "yaw", whose rate loop is too slow with the logged gains to follow its setpoint."""
    axes = []
    for advice in tuning.advice:
        if advice.rate_sluggish is not None:
            axes.append(advice.before.axis)
    return axes


def axes_with_kept_gains(tuning: Tuning) -> list[str]:
    """Returns the axes whose loop is known and whose gains stay, whether their margins are sure or not.

    Args:
        tuning: advice on the gains of each axis, or the fact (coded finding) that says why its loop is not known.
    """
    keeps_gains = (GainOutcome.KEEP, GainOutcome.KEEP_UNSURE)
    return [axis for axis in tuning.axes if gain_outcome(tuning, axis) in keeps_gains]


def outcome_by_axis(tuning: Tuning) -> dict[str, str]:
    """Returns what becomes of the gains of each axis in words, such as "new gains" or "no gains, margins not known".

    Args:
        tuning: advice on the gains of each axis, or the fact (coded finding) that says why its loop is not known.
    """
    words = {}
    for axis in tuning.axes:
        outcome = gain_outcome(tuning, axis)
        [sentence] = render_section(
            "tune_axes",
            axes=[axis],
            axes_by_outcome={outcome: [axis]},
            outcomes=[outcome],
            has_outcomes=True,
            sluggish_axes=_sluggish_axes(tuning),
        )
        _, _, words_of_axis = sentence.lead.partition(": ")
        words[axis] = words_of_axis.removesuffix(".")
    return words


def gain_outcome(tuning: Tuning, axis: str) -> GainOutcome:
    """Returns what becomes of the gains of one axis: whether they are new, kept or lowered, or why none are known.

    Lower gains come before all else, since they are set against an oscillation or a measured lack of margin.

    Args:
        tuning: advice on the gains of each axis, or the fact that says why its loop is not known.
        axis: "roll", "pitch" or "yaw".
    """
    if tuning.lowers_gains_of(axis):
        return GainOutcome.LOWER
    if tuning.lowers_gains_on_trial(axis):
        return GainOutcome.LOWER_ON_TRIAL
    advice = tuning.axes[axis]
    if isinstance(advice, Fact):
        return GainOutcome.UNKNOWN
    if has_doubtful_margins(tuning, axis):
        return GainOutcome.DOUBTFUL
    if advice.refusals and not advice.refuses_only_higher_gains:
        return GainOutcome.REPAIR_FIRST
    if advice.parameters:
        return GainOutcome.NEW if advice.is_sound else GainOutcome.FLY_FIRST
    return GainOutcome.KEEP if advice.rating.is_good else GainOutcome.KEEP_UNSURE


def has_doubtful_margins(tuning: Tuning, axis: str) -> bool:
    """Returns whether the stability margins of an identified loop may be wrong.

    They may be wrong in two cases: a measured response contradicts the loop, or no gains are advised for a reason that
    concerns the loop itself. A repair, such as that of a weak motor, also stands against new gains, but does not count
    here: the margins are right for the vehicle as it flew.

    Args:
        tuning: advice for each axis, the axes whose loops a measured response contradicts, and the repairs by which the
            decisions on the loops put off gains.
        axis: "roll", "pitch" or "yaw"; its loop is identified.
    """
    advice = tuning.axes[axis]
    # An axis has a fact (a reason why there is no advice) instead of advice only if its loop is not identified.
    assert isinstance(advice, Advice)
    if axis in tuning.doubtful_axes:
        return True
    if advice.refuses_only_higher_gains:
        # The margins hold for the present gains: only higher ones are refused, as the log does not resolve the lag.
        return False
    decision = tuning.judgement.loop_decisions.get(axis)
    repairs = () if decision is None else decision.repairs
    return any(reason not in repairs for reason in advice.refusals)


def field_sentences(tuning: Tuning) -> list[Sentence]:
    """Returns what a pilot must know at the flying field: when to land with new gains, and when the tuning is done.

    Args:
        tuning: the advice for each axis, or the fact (coded finding) that says why there is none.

    Returns:
        The sentences; empty if gains neither change nor are known to be right.
    """
    axes_by_outcome = group_by(tuning.axes, lambda axis: gain_outcome(tuning, axis))
    sure_axes = axes_by_outcome.get(GainOutcome.KEEP, [])
    unsure_axes = axes_by_outcome.get(GainOutcome.KEEP_UNSURE, [])
    has_new_gains = any(advice.parameters and advice.is_sound for advice in tuning.advice)
    return render_section(
        "tune_field",
        has_new_gains=has_new_gains,
        axes=[*tuning.axes],
        unsure_axes=unsure_axes,
        are_all_kept=len(sure_axes) + len(unsure_axes) == len(tuning.axes),
    )
