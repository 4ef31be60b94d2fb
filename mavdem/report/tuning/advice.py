"""What a tuning says about the gains of an axis: to load or to keep them, and why they are no others."""

from collections.abc import Collection, Iterable

from mavdem.assessment.axis.tuning import Tuning
from mavdem.containers import group_by
from mavdem.facts import Fact, Facts
from mavdem.facts.loops import LoopAction
from mavdem.facts.margins import MarginsLight
from mavdem.loops.advice import Advice
from mavdem.report.tuning.gains import REASONS_FOR_GAINS
from mavdem.report.tuning.slower import facts_on_slower_attitude, facts_on_slower_rate


def facts_on_new_gains(tuning: Tuning, axis: str) -> list[Fact]:
    """Returns facts (coded findings) on the gains of an axis. The first says whether to set or keep them.

    The others say why the gains are no higher or lower, that their basis is weak, or that they make a loop slower. Only
    the first is returned if a measured response contradicts the loop from which the gains were computed.

    Args:
        tuning: advice on the gains of each axis; its loop is identified.
        axis: "roll", "pitch" or "yaw".
    """
    advice = tuning.axes[axis]
    # An axis has a fact instead of advice only if its loop is not identified.
    assert isinstance(advice, Advice)
    decision = tuning.judgement.loop_decisions.get(axis)
    # States that gains are to be set or kept, or why no gains could be computed.
    advice_on_gains = conclusion_for_report(tuning, advice)
    action = None if decision is None else decision.action
    if action is not None and action.code is LoopAction.LOWER_BY_A_THIRD:
        # The gains of an oscillating axis are to be lowered by a third, even if no gains could be computed for it.
        advice_on_gains = advice_on_gains.replace(action=action)
    if axis in tuning.doubtful_axes:
        return [advice_on_gains]
    reasons = [note for note in advice.notes if note.code in REASONS_FOR_GAINS]
    weak_confirmation = advice.weak_confirmation
    if weak_confirmation is not None and advice.parameters and advice.is_sound:
        reasons.append(weak_confirmation)
    slower_loops = [*facts_on_slower_rate(advice), *facts_on_slower_attitude(advice)]
    return [advice_on_gains, *reasons, *slower_loops]


def conclusion_for_report(tuning: Tuning, advice: Advice) -> Fact:
    """Returns what to do with the gains of an axis, for example to load new ones, as a fact with a sentence.

    Four figures of the fact (a coded finding) fit its sentence to this report:

    - ``waits``: whether these gains are not to be loaded yet. Gains are loaded in stages, with a flight after each, and
      those of stage 2 wait while another axis has gains of stage 1.
    - ``is_goal_stated``: that the sentence need not state the goal of the margins, as :func:`goal_sentences` does so.
    - ``is_biased``: whether the margins are not sure, and wind biases the estimated control effectiveness.
    - ``is_log_slow``: whether they are not sure since the log hardly shows the frequencies that they are of.

    Args:
        tuning: advice for all axes, which shows whether one of them has gains of an earlier stage.
        advice: advice on the axis.
    """
    return advice.conclusion.replace(
        waits=tuning.waits(advice),
        is_goal_stated=True,
        is_biased=not advice.rating.is_good and advice.before.has_biased_effectiveness,
        is_log_slow=advice.rating.figures["is_log_slow"],
    )


def conclusion_on_gains(advice: Advice | Fact) -> Fact:
    """Returns the fact (coded finding) that sums up the advice on an axis: what to do with its gains, or why no loop.

    Args:
        advice: advice on the gains of the axis, or the fact that says why its loop is not known.
    """
    return advice if isinstance(advice, Fact) else advice.conclusion


def axes_with_same_conclusion(tuning: Tuning) -> list[list[str]]:
    """Returns the groups of two or more axes whose gains a report describes in the same words, such as that they stay.

    Roll and pitch of a symmetric vehicle mostly differ in their margins, and not in what is advised.

    Args:
        tuning: advice on the gains of each axis with an identified loop; for other axes a fact (coded finding) that
            says why there is no loop.
    """
    axes_with_loop = [axis for axis, advice in tuning.axes.items() if isinstance(advice, Advice)]

    def text_on_gains(axis: str) -> str:
        """Returns the sentences on the gains of an axis."""
        facts = facts_on_new_gains(tuning, axis)
        return " ".join(fact.sentence_and_remedy for fact in facts)

    groups = group_by(axes_with_loop, text_on_gains)
    return [axes for axes in groups.values() if len(axes) > 1]


def reasons_not_stated(conclusion: Fact, stated_facts: Collection[Fact]) -> Facts:
    """Returns why an axis gets no gains, without the reasons that the reader has already found above.

    For example, a log that is too slow remains, and the weak motor of the headline does not.

    Args:
        conclusion: the fact that there are no gains, whose figure ``reasons`` has the reasons; without that figure it
            is the only reason itself.
        stated_facts: the headline, and the faults of the flight below it, as facts (coded findings).
    """
    oscillation_is_stated = any(fact.code is MarginsLight.OSCILLATES for fact in stated_facts)
    reasons = []
    for reason in conclusion.figures.get("reasons", (conclusion,)):
        # One headline names all axes that oscillate, and so is not equal to the fact on a single axis.
        is_oscillation = reason.code is MarginsLight.OSCILLATES
        is_oscillation_above = is_oscillation and oscillation_is_stated
        if not is_oscillation_above and not is_stated(reason, stated_facts):
            reasons.append(reason)
    return tuple(reasons)


def is_stated(fact: Fact, stated_facts: Iterable[Fact]) -> bool:
    """Returns whether a fact is among those that a report has stated; as a headline it may have further figures.

    Args:
        fact: the fact (a coded finding), such as that the roll rate has a peak.
        stated_facts: the stated facts, such as that one with what to do about it as ``action``.
    """
    return any(stated.replace(**fact.figures) == stated for stated in _alike(fact, stated_facts))


def _alike(fact: Fact, others: Iterable[Fact]) -> list[Fact]:
    """Returns those facts that have code, subject and time of another one, whatever their figures are."""
    key = (fact.code, fact.subject, fact.time)
    return [other for other in others if (other.code, other.subject, other.time) == key]
