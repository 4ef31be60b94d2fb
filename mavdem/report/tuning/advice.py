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
    """Returns what a report states about the gains of an axis, as facts (coded findings, each with a sentence).

    Args:
        tuning: advice on the gains of each axis, and the decision on its loops.
        axis: "roll", "pitch" or "yaw"; its rate loop is identified.

    Returns:
        First the conclusion: to set or keep the gains, or why none could be computed. Then why they are no higher or
        lower, that the measured response barely confirms the loop, and which loop they make slower. The conclusion
        alone if a measured response contradicts the identified loop.
    """
    advice = tuning.axes[axis]
    # An axis has a fact instead of advice only if its loop is not identified.
    assert isinstance(advice, Advice)
    conclusion = _conclusion_with_lower_gains(tuning, axis, conclusion_for_report(tuning, advice))
    if axis in tuning.doubtful_axes:
        # The reasons are computed from the loop that the measured response contradicts.
        return [conclusion]
    reasons = [note for note in advice.notes if note.code in REASONS_FOR_GAINS]
    has_gains_to_load = advice.parameters and advice.is_sound
    if has_gains_to_load and advice.weak_confirmation is not None:
        reasons.append(advice.weak_confirmation)
    return [conclusion, *reasons, *facts_on_slower_rate(advice), *facts_on_slower_attitude(advice)]


def _conclusion_with_lower_gains(tuning: Tuning, axis: str, conclusion: Fact) -> Fact:
    """Returns the conclusion on an axis, with the remedy to lower its gains by a third if its loop oscillates.

    This remedy needs no identified loop, so that it holds even if no gains could be computed.

    Args:
        tuning: the decision on the loops of each axis; an axis may have none.
        axis: "roll", "pitch" or "yaw".
        conclusion: what the advice says about the gains of the axis.
    """
    decision = tuning.judgement.loop_decisions.get(axis)
    if decision is None or decision.action is None:
        return conclusion
    if decision.action.code is not LoopAction.LOWER_BY_A_THIRD:
        return conclusion
    return conclusion.replace(action=decision.action)


def conclusion_for_report(tuning: Tuning, advice: Advice) -> Fact:
    """Returns what to do with the gains of an axis, such as to load new ones, with the figures of a report's sentence.

    Args:
        tuning: advice for all axes, which shows whether one of them has gains to load before.
        advice: advice on the axis.

    Returns:
        The fact (coded finding) that concludes the advice, with figures that select the words of its sentence.
    """
    return advice.conclusion.replace(
        # Gains are loaded in stages, with a flight after each: those of stage 2 wait for stage 1 of another axis.
        waits=tuning.waits(advice),
        # The report states the goal of the margins once for all axes (goal_sentences).
        is_goal_stated=True,
        # Wind biases the estimated control effectiveness, which matters only if the margins are not surely good.
        is_biased=not advice.rating.is_good and advice.before.has_biased_effectiveness,
        # The log's sample rate is too low to show the frequencies at which the margins are read.
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
    """Returns the reasons why an axis gets no gains that the report has not stated above.

    For example, where the headline is a weak motor and the log is also too slow, the slow log is returned.

    Args:
        conclusion: the fact (coded finding) that the axis gets no gains. Its figure ``reasons`` has the reasons;
            without that figure, the fact is the only reason itself.
        stated_facts: facts that the report states above, such as its headline and the faults of the flight.
    """
    all_reasons = conclusion.figures.get("reasons", (conclusion,))
    return tuple(reason for reason in all_reasons if not _is_reason_stated(reason, stated_facts))


def _is_reason_stated(reason: Fact, stated_facts: Collection[Fact]) -> bool:
    """Returns whether a report has already stated a reason for no gains.

    Args:
        reason: the reason, a fact (coded finding) such as that the axis oscillates.
        stated_facts: facts that the report states above.
    """
    if reason.code is MarginsLight.OSCILLATES:
        # A headline names all axes that oscillate at once, so that it differs from the fact on a single axis.
        return any(fact.code is MarginsLight.OSCILLATES for fact in stated_facts)
    return is_stated(reason, stated_facts)


def is_stated(fact: Fact, stated_facts: Iterable[Fact]) -> bool:
    """Returns whether one of the stated facts has the code, subject, time and all figures of a fact.

    It may have more figures: a headline, for example, has the remedy as its figure ``action``.

    Args:
        fact: a coded finding, such as that the roll rate has a peak.
        stated_facts: the facts that a report has stated.
    """
    for stated in stated_facts:
        has_same_code = stated.code == fact.code
        is_same_event = stated.subject == fact.subject and stated.time == fact.time
        # To replace figures by equal ones changes nothing, so that further figures of the stated fact do not matter.
        if has_same_code and is_same_event and stated.replace(**fact.figures) == stated:
            return True
    return False
