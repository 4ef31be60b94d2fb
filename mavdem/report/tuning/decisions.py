"""Decisions on control loops in sentences: what is wrong with an axis, and what to do about it."""

from collections.abc import Collection, Iterable

from mavdem.assessment.axis.loop_decision import DecisionsByAxis, LoopDecision, LoopDiagnosis
from mavdem.assessment.axis.margins import AxisMargins
from mavdem.assessment.axis.tuning import Tuning
from mavdem.containers import group_by
from mavdem.facts import Fact
from mavdem.report.blocks import Sentence
from mavdem.report.numbers import listed
from mavdem.report.templates import sentences_by_axes


def decision_sentences(
    decisions: DecisionsByAxis, next_step: str = "", lead_end: str = ":"
) -> list[Sentence]:
    """Returns the decisions on control loops in sentences: for each axis what is wrong, and what to do.

    Axes with the same reason and action share a sentence. If several axes need the same action for different reasons,
    each reason has a sentence, and the action follows once in a sentence of its own.

    Args:
        decisions: decision on the loops by axis.
        next_step: the next step in words, which stands on the same page; actions that it contains are left out.
        lead_end: what follows the names of the axes at the beginning of each sentence.
    """

    def lead(axes: Collection[str]) -> str:
        """Returns the beginning of a sentence on some axes, such as "Roll and pitch:"."""
        return f"{listed(axes).capitalize()}{lead_end}"

    def action_text(axis: str) -> str:
        """Returns what to do about an axis; empty if the next step says so."""
        action = decisions[axis].fact.remedy
        return "" if action in next_step else action

    sentences = []
    for action, axes in group_by(decisions, action_text).items():
        axes_by_reason = group_by(axes, lambda axis: decisions[axis].reason.sentence)
        if len(axes_by_reason) == 1:
            # A single reason and its action make one sentence.
            (reason,) = axes_by_reason
            sentences.append(Sentence(f"{reason} {action}".strip(), lead(axes)))
            continue
        for reason, axes_of_reason in axes_by_reason.items():
            sentences.append(Sentence(reason, lead(axes_of_reason)))
        sentences.append(Sentence(action, lead(axes)))
    return [sentence for sentence in sentences if sentence.text]


def measured_margins(tuning: Tuning, margins: Iterable[AxisMargins]) -> list[Sentence]:
    """Returns sentences on the stability margins of the axes whose loops could not be identified.

    Some of these margins were measured without a model of the loop, for example from a resonance. Two kinds are left
    out: those that were measured by an injected test signal, which the report states as the reason why there is no
    loop; and a warning that decided on the axis, or that its oscillation explains, which stands above.

    Args:
        tuning: the advice for each axis; for an axis whose loop is not known, the fact (coded finding) that says why.
        margins: what was measured of the stability margins of each axis, as facts.

    Returns:
        The sentences; axes with the same text share one.
    """
    axes_and_facts: list[tuple[str, Fact]] = []
    for axis_margins in margins:
        is_loop_unknown = isinstance(tuning.axes.get(axis_margins.axis), Fact)
        was_signal_injected = axis_margins.injected is not None
        if not is_loop_unknown or was_signal_injected:
            continue
        decision = tuning.judgement.loop_decisions.get(axis_margins.axis)
        for fact in axis_margins.facts:
            if decision is None or not _is_stated_by_decision(fact, decision):
                axes_and_facts.append((axis_margins.axis, fact))
    return sentences_by_axes(axes_and_facts)


def _is_stated_by_decision(fact: Fact, decision: LoopDecision) -> bool:
    """Returns whether the decision on an axis already states a fact about its margins, so that it is not repeated.

    The report on the axis states the reason of the decision if that is a warning. If the axis oscillates, that also
    explains every fact about its margins.

    Args:
        fact: the fact about the margins, a coded finding.
        decision: the decision on the control loops of the axis, with its reason.
    """
    if not decision.reason.is_watch_or_bad:
        return False
    return decision.diagnosis is LoopDiagnosis.OSCILLATES or decision.reason.code is fact.code
