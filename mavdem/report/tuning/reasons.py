"""The reasons behind a tuning: for each axis what to do with its gains and why, and how far to trust that."""

from collections.abc import Collection, Iterable, Sequence
from itertools import chain
from operator import attrgetter

from mavdem.assessment.axis.tuning import Tuning
from mavdem.containers import group_by
from mavdem.facts import Fact
from mavdem.facts.assessment import NextStep
from mavdem.facts.loops import GainFact
from mavdem.facts.margins import MarginsLight
from mavdem.loops.advice import Advice
from mavdem.report.blocks import Blocks, Sentence, headline_sentence
from mavdem.report.numbers import listed
from mavdem.report.templates import render_section, sentences_by_axes
from mavdem.report.tuning.advice import (
    axes_with_same_conclusion,
    facts_on_new_gains,
    is_stated,
    reasons_not_stated,
)
from mavdem.report.tuning.cautions import caution_sentences, shared_cautions
from mavdem.report.tuning.decisions import decision_sentences
from mavdem.report.tuning.details import axis_details
from mavdem.report.tuning.goal import warning_of_unchecked_effects
from mavdem.report.tuning.outcomes import (
    GainOutcome,
    gain_outcome,
    has_doubtful_margins,
    mixer_fault,
)
from mavdem.report.tuning.remedies import (
    remedies_besides_summary,
    remedies_besides_tuning,
    remedies_to_show,
    remedy_of_gains,
)
from mavdem.report.tuning.result import (
    faults_of_flight,
    is_headline_of_tuning,
    rating_unless_contradicted,
)


def tune_blocks(
    tuning: Tuning,
    *,
    is_full: bool = True,
    is_page: bool = False,
    headline_above: Fact | None = None,
) -> Blocks:
    """Returns the reasons behind a tuning: for each axis what to do with its gains and why, and how far to trust that.

    Axes of which the same is to be said share a sentence. Each remedy is stated once, and not at all if the next step,
    which is shown with the report, contains it.

    Args:
        tuning: advice for each axis, or the fact that says why there is none.
        is_full: whether all margins and everything about the gains are included.
        is_page: whether the report is part of a page, where each axis has its rating, and the cautions about gains to
            set stand beside these. A terminal has all margins above the report (:func:`tune_overview`).
        headline_above: the fact (coded finding) of the headline above the report; None without one. Neither it nor the
            faults of the flight, which stand below it, are repeated as the reason for no gains.
    """
    if tuning.judgement.headline.code is MarginsLight.OSCILLATES and not is_full:
        # How far the identified loops can be trusted matters only once the vehicle flies without an oscillation.
        axes_without_gains = [axis for axis in tuning.axes if not tuning.lowers_gains_of(axis)]
        return [*sentences_without_gains(tuning, axes_without_gains)]
    stated_facts = faults_of_flight(tuning)
    is_reason_in_headline = False
    if headline_above is not None:
        stated_facts.append(headline_above)
        is_reason_in_headline = bool(reason_in_headline(tuning, headline_above))
    blocks = Blocks()
    shared_conclusions = axes_with_same_conclusion(tuning)
    for axes in shared_conclusions:
        blocks += _sentences_on_gains(tuning, axes, stated_facts)
    axes_with_stated_conclusion = [*chain.from_iterable(shared_conclusions)]
    for axes in _axes_reported_together(tuning):
        if isinstance(tuning.axes[axes[0]], Fact):
            sentences = _sentences_without_loop(tuning, axes, stated_facts)
            # The headline repeats the first sentence, which is the reason; faults of these axes follow it.
            blocks += sentences[1:] if is_reason_in_headline else sentences
        else:
            # An axis with an identified loop is a group by itself.
            [axis] = axes
            blocks += _sentences_on_axis_with_loop(
                tuning,
                axis,
                stated_facts,
                is_conclusion_stated=axis in axes_with_stated_conclusion,
                is_page=is_page,
            )
            blocks += _blocks_on_loop(tuning, axis, is_full=is_full, is_page=is_page)
    blocks += _sentences_on_feedforward(tuning.feedforward)
    blocks += _sentences_on_other_axes(tuning.judgement.next_step)
    if any(gain_outcome(tuning, axis) is GainOutcome.REPAIR_FIRST for axis in tuning.axes):
        blocks += render_section("tune_as_flown")
    if is_full:
        blocks += warning_of_unchecked_effects(tuning)
    return blocks


def _sentences_on_axis_with_loop(
    tuning: Tuning,
    axis: str,
    stated_facts: Collection[Fact],
    *,
    is_conclusion_stated: bool,
    is_page: bool,
) -> list[Sentence]:
    """Returns the rating of an axis's margins, what to do with its gains and why, and what else to do about its loops.

    Args:
        tuning: advice on the gains of each axis; the loop of this one is identified.
        axis: "roll", "pitch" or "yaw".
        stated_facts: facts (coded findings) above the report, which are not repeated as the reason for no gains.
        is_conclusion_stated: whether a sentence on several axes has what to do with the gains, such as to load them.
        is_page: whether the report is part of a page, where each axis has its rating already.
    """
    facts = _rating_to_state(tuning, axis, is_page=is_page)
    if not is_conclusion_stated:
        facts += facts_on_new_gains(tuning, axis)
    report = _text_of_facts(tuning, axis, facts, stated_facts)
    remedies = _remedies_of_axis(tuning, axis, is_conclusion_stated=is_conclusion_stated)
    return _sentences_on_axes([axis], report, remedies)


def _remedies_of_axis(tuning: Tuning, axis: str, *, is_conclusion_stated: bool) -> list[str]:
    """Returns what to do about an axis, such as "Set LOG_BITMASK to 65535.", that the summary does not state.

    Args:
        tuning: advice on the gains of each axis; the loop of this one is identified.
        axis: "roll", "pitch" or "yaw".
        is_conclusion_stated: whether a sentence on several axes has what to do with the gains, such as to load them.
    """
    advice = tuning.axes[axis]
    # An axis has a fact instead of advice only if its loop is not identified.
    assert isinstance(advice, Advice)
    remedies = remedies_to_show(tuning, axis)
    if not is_conclusion_stated:
        return remedies
    return [remedy for remedy in remedies if remedy != remedy_of_gains(tuning, advice)]


def _blocks_on_loop(tuning: Tuning, axis: str, *, is_full: bool, is_page: bool) -> Blocks:
    """Returns how far the identified loop of an axis can be trusted, such as "Setpoints end below the crossover.".

    Args:
        tuning: advice on the gains of each axis; the loop of this one is identified.
        axis: "roll", "pitch" or "yaw".
        is_full: whether tables of its margins follow.
        is_page: whether a page has a table of the gains to set elsewhere, with the cautions about them.
    """
    advice = tuning.axes[axis]
    # An axis has a fact instead of advice only if its loop is not identified.
    assert isinstance(advice, Advice)
    cautions = shared_cautions(tuning.axes)
    blocks: Blocks = [*caution_sentences(cautions, advice, has_gains_elsewhere=is_page)]
    if is_full:
        blocks += axis_details(advice, is_doubtful=has_doubtful_margins(tuning, axis))
    return blocks


def _sentences_on_feedforward(findings: Iterable[Fact]) -> list[Sentence]:
    """Returns sentences on the axes that overshoot their setpoint because of feed-forward, with what to do.

    Args:
        findings: the fact (coded finding) for each such axis.
    """
    axes_and_findings = [(finding.figures["axis"], finding) for finding in findings]
    return sentences_by_axes(axes_and_findings, attrgetter("sentence_and_remedy"))


def _text_of_facts(
    tuning: Tuning, axis: str, facts: Iterable[Fact], stated_facts: Collection[Fact]
) -> str:
    """Returns the sentences of facts on the gains of an axis, such as "No gains, for the reason above.".

    Args:
        tuning: advice on the gains of each axis.
        axis: "roll", "pitch" or "yaw".
        facts: coded findings on the axis.
        stated_facts: what stands above the report, and is not repeated as the reason for no gains.
    """
    sentences = []
    for fact in facts:
        if fact.code is GainFact.NO_GAINS_ADVISED:
            reasons = reasons_not_stated(fact, stated_facts)
            if reasons:
                fact = fact.replace(reasons=reasons)
            elif gain_outcome(tuning, axis) is GainOutcome.REPAIR_FIRST:
                # The overview says "repair first" of this axis, and the headline what to repair.
                continue
            else:
                fact = fact.replace(is_reason_above=True)
        sentences.append(fact.sentence)
    return " ".join(sentences)


def _sentences_on_gains(
    tuning: Tuning, axes: list[str], stated_facts: Collection[Fact]
) -> list[Sentence]:
    """Returns the sentence on what to do with the gains of several axes, and why.

    Args:
        tuning: advice on the gains of each axis; the loops of these axes are identified.
        axes: axes with the same advice for the same reasons.
        stated_facts: what stands above the report, and is not repeated as the reason for no gains.
    """
    # The first axis stands for all of them.
    axis = axes[0]
    advice = tuning.axes[axis]
    assert isinstance(advice, Advice)
    report = _text_of_facts(tuning, axis, facts_on_new_gains(tuning, axis), stated_facts)
    remedies = remedies_besides_summary(tuning, [remedy_of_gains(tuning, advice)])
    return _sentences_on_axes(axes, report, remedies)


def _sentences_without_loop(
    tuning: Tuning, axes: list[str], stated_facts: Collection[Fact]
) -> list[Sentence]:
    """Returns why some axes get no gains, as their control loops could not be identified, and what went wrong in them.

    What to do to get gains is in another part of the report (:func:`tune_summary`).

    Args:
        tuning: has for each of these axes, in the place of advice, the fact (coded finding) that says why its loop is
            not known.
        axes: axes with the same reason, at least one.
        stated_facts: facts that the report states above, which are not repeated as the reason.

    Returns:
        First the sentence with the reason, if the report has not stated it; then the faults of these axes in flight,
        such as an overshoot. If all reasons are stated above, the sentence refers to them and no faults follow.
    """
    reason_of_axes = tuning.axes[axes[0]]
    # Only axes without an identified loop, which have a fact instead of advice, are passed.
    assert isinstance(reason_of_axes, Fact)
    unstated_reasons = reasons_not_stated(reason_of_axes, stated_facts)
    if not unstated_reasons:
        # Axes whose gains are lowered have these in the table above, and so are not called axes without gains.
        axes_without_gains = [axis for axis in axes if not tuning.lowers_gains_of(axis)]
        return sentences_without_gains(tuning, axes_without_gains)
    faults = _faults_in_flight(tuning, axes, [*stated_facts, *unstated_reasons])
    if mixer_fault(tuning) in unstated_reasons:
        # An unknown mixer concerns all axes, so that one sentence for all of them has it (:func:`outcome_sentences`).
        return faults
    if "reasons" in reason_of_axes.figures:
        # The fact sums up several reasons, of which those that the report has stated are left out.
        reason_of_axes = reason_of_axes.replace(reasons=unstated_reasons)
    if len(axes) > 1:
        reason_of_axes = _fact_on_axes(reason_of_axes, listed(axes))
    sentence_with_reason = render_section(
        "tune_no_gains",
        axes=axes,
        reason=reason_of_axes.sentence,
        lowers_gains=any(tuning.lowers_gains_of(axis) for axis in axes),
    )
    return [*sentence_with_reason, *faults]


def reason_in_headline(tuning: Tuning, result: Fact) -> list[Sentence]:
    """Returns the headline that no axis gets gains, with its reason, if all axes have the same one.

    Args:
        tuning: advice on the gains of each axis, or the fact that says why there is none.
        result: the most important result (:func:`tuning_result`).

    Returns:
        A list with the headline, such as "No gains, because ATTITUDE comes at 4 Hz.". It is empty if the loop of an
        axis is known, if axes have reasons of their own, and if the headline is about something else, or the reason
        stands with the faults of the flight.
    """
    if is_headline_of_tuning(tuning, result) or mixer_fault(tuning) is not None:
        return []
    outcomes = {gain_outcome(tuning, axis) for axis in tuning.axes}
    groups = _axes_reported_together(tuning)
    if outcomes != {GainOutcome.UNKNOWN} or len(groups) > 1:
        return []
    stated_facts = [*faults_of_flight(tuning), result]
    conclusion = tuning.axes[groups[0][0]]
    assert isinstance(conclusion, Fact)
    if not reasons_not_stated(conclusion, stated_facts):
        return []
    [sentence, *_] = _sentences_without_loop(tuning, groups[0], stated_facts)
    # All words of a headline stand out.
    return [headline_sentence(sentence.text)]


def sentences_without_gains(tuning: Tuning, axes: Sequence[str]) -> list[Sentence]:
    """Returns the sentence that some axes get no gains for the reason that the headline states.

    Args:
        tuning: the judgement of the flight with its headline, such as that the vehicle oscillates.
        axes: the axes; no sentence is needed if there are none.
    """
    if not axes:
        return []
    oscillates = tuning.judgement.headline.code is MarginsLight.OSCILLATES
    return render_section("tune_repair", axes=axes, oscillates=oscillates)


def _sentences_on_axes(axes: list[str], report: str, remedies: list[str]) -> list[Sentence]:
    """Returns the report on some axes with what to do, such as "Roll and pitch:" and then the report's sentences.

    Args:
        axes: the axes that the report is about.
        report: what was found, in sentences; may be empty.
        remedies: what to do, in sentences; may be empty.

    Returns:
        A list with the sentence; empty if there is nothing to say.
    """
    if not report and not remedies:
        return []
    lead = f"{listed(axes).capitalize()}:"
    return [Sentence(" ".join([report, *remedies]).strip(), lead)]


def _sentences_on_other_axes(next_step: Fact) -> list[Sentence]:
    """Returns a sentence on the axes that the user did not ask for, but whose gains are to change as well.

    Args:
        next_step: the next step, which is about the one axis that the user asked for.

    Returns:
        A list with the sentence, which also has the command that advises all axes; empty if there are no such axes.
    """
    if next_step.code is not NextStep.LOAD_GAINS or not next_step.figures["others"]:
        return []
    return render_section(
        "tune_others",
        others=next_step.figures["others"],
        arguments=next_step.figures["arguments"],
    )


def _axes_reported_together(tuning: Tuning) -> list[list[str]]:
    """Groups the axes of a tuning so that those with the same report share one sentence, as in "Roll and pitch: …".

    An axis with an identified loop has a table of its own, and is a group by itself. Axes without one form a group if
    the reason for that, and what to do about it, are the same.

    Args:
        tuning: advice on the gains of each axis, or the fact (coded finding) that says why there is none.

    Returns:
        The axes of each group, in the order of ``tuning.axes``.
    """
    groups = group_by(tuning.axes, lambda axis: _key_of_report(tuning, axis))
    return list(groups.values())


def _key_of_report(tuning: Tuning, axis: str) -> str:
    """Returns a text that is the same for two axes if one report on their gains can serve both.

    For example, roll and pitch share a report if no loop was identified for either, for the same reason and with the
    same remedies. An axis with an identified loop has gains, and so a report, of its own.

    Args:
        tuning: its ``axes`` have the advice on the gains of each axis or, without an identified loop, the fact (coded
            finding) that says why there is none.
        axis: "roll", "pitch" or "yaw".

    Returns:
        Why no loop was identified, without the name of the axis, and what to do about it. For an axis with an
        identified loop it is the name of the axis, which no other axis has.
    """
    advice_or_reason = tuning.axes[axis]
    if isinstance(advice_or_reason, Advice):
        return axis
    texts = [_text_without_axis(advice_or_reason, axis)]
    for remedy in remedies_besides_tuning(tuning, axis):
        is_stated_by_reason = remedy in advice_or_reason.sentence_and_remedy
        if not is_stated_by_reason:
            texts.append(remedy)
    return " ".join(texts)


def _text_without_axis(reason: Fact, axis: str) -> str:
    """Returns the sentence and remedy of a fact without the name of its axis, to be compared with those of other axes.

    Args:
        reason: a coded finding, which says why the loop of this axis is not known.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The text without the name. It keeps the name if the sentence of the fact on several axes would still name this
        axis alone, so that no sentence on several axes can stand for it.
    """
    text = reason.sentence_and_remedy
    text_without_axis_figure = _fact_on_axes(reason, "").sentence_and_remedy
    if axis in text_without_axis_figure:
        return text
    return text.replace(axis, "")


def _fact_on_axes(fact: Fact, axis_names: str) -> Fact:
    """Returns a fact on one axis as a fact on several axes.

    Args:
        fact: a coded finding. Its figure "axis" names the axis, and so does that of each fact in its figure "reasons".
        axis_names: names of all axes, such as "roll and pitch".

    Returns:
        The fact with these names; unchanged if it has no figure that names the axis.
    """
    if "axis" in fact.figures:
        fact = fact.replace(axis=axis_names)
    if "reasons" in fact.figures:
        reasons = fact.figures["reasons"]
        fact = fact.replace(reasons=tuple(_fact_on_axes(reason, axis_names) for reason in reasons))
    return fact


def _rating_to_state(tuning: Tuning, axis: str, *, is_page: bool) -> list[Fact]:
    """Returns the rating of the stability margins of an axis, a coded finding, for the report on the axis.

    The report does not state it in these cases:

    - A measured response contradicts the identified loop, so that its margins are doubtful.
    - The margins may be wrong for another reason, as the table beside the report says, and the rating is good.
    - The report is on a terminal, which has the margins in a table above, and the axis follows its setpoint.

    Args:
        tuning: advice on the gains of each axis; the loop of this one is identified.
        axis: "roll", "pitch" or "yaw".
        is_page: whether the report is on a page, and not on a terminal.

    Returns:
        A list with the rating; empty if it is left out, or if there is none (:func:`rating_unless_contradicted`).
    """
    advice = tuning.axes[axis]
    # An axis has a fact instead of advice only if its loop is not identified.
    assert isinstance(advice, Advice)
    if axis in tuning.doubtful_axes:
        return []
    ratings = rating_unless_contradicted(advice, tuning.judgement.loop_decisions.get(axis))
    if has_doubtful_margins(tuning, axis):
        ratings = [rating for rating in ratings if not rating.is_good]
    if not is_page:
        # Only a rating that the axis does not follow its setpoint has the figure "follows".
        ratings = [rating for rating in ratings if "follows" in rating.figures]
    return ratings


def _faults_in_flight(
    tuning: Tuning, axes: Iterable[str], stated_facts: Collection[Fact]
) -> list[Sentence]:
    """Returns what is wrong with axes whose loops are not known, such as that they swing, and what to do about it.

    Args:
        tuning: the judgement of the flight, with its next step and a decision on the loops of each axis.
        axes: axes that the report names together; none of their loops is known.
        stated_facts: what the headline and the report state already, such as why the loops are not known.
    """
    faults = {}
    for axis in axes:
        decision = tuning.judgement.loop_decisions.get(axis)
        if decision is None or not decision.reason.is_watch_or_bad:
            continue
        if not is_stated(decision.reason, stated_facts):
            faults[axis] = decision
    next_step = tuning.judgement.next_step.sentence
    return decision_sentences(faults, next_step, lead_end=" in flight:")
