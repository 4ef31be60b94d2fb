"""The sentences that begin the report and the page of a tuning: its result, and what to do next."""

from collections.abc import Iterable, Mapping

from mavdem.assessment.axis.lowered_gains import fact_and_contained_facts, lowered_gains
from mavdem.assessment.axis.tuning import Tuning
from mavdem.assessment.judgement import Judgement
from mavdem.containers import group_by
from mavdem.facts import Fact
from mavdem.facts.assessment import NextStep
from mavdem.facts.loops import LoopAction
from mavdem.facts.margins import MarginsLight
from mavdem.report.blocks import Sentence, headline_sentence
from mavdem.report.numbers import listed
from mavdem.report.templates import headline, render_section
from mavdem.report.tuning.outcomes import outcome_sentences
from mavdem.report.tuning.reasons import reason_in_headline
from mavdem.report.tuning.remedies import (
    STEPS_WITH_DOUBLETS,
    ground_steps_by_axis,
)
from mavdem.report.tuning.result import faults_of_flight, is_about_loops, is_headline_of_tuning


def tune_summary(tuning: Tuning, result: Fact) -> list[Sentence]:
    """Returns the sentences that begin the report and the page of ``mavdem tune``: the result, and what to do next.

    1. The headline: the most important result if it is about the control loops or bad, and otherwise what becomes of
       the gains of each axis.
    2. Whatever else the flight shows that is watch or bad, with its remedy, so that no gains are loaded on a vehicle
       that needs a repair.
    3. The cause of a missing margin, where the gyro's filter takes most of the phase.
    4. The next step.
    5. What axes that get no gains need: what to correct, and the flight with doublets from which gains follow.

    Args:
        tuning: the advice for each axis, with the judgement of the flight.
        result: the most important result (:func:`tuning_result`).
    """
    facts_on_flight = [
        fact for fact in faults_of_flight(tuning) if not _are_of_one_event(fact, result)
    ]
    if is_headline_of_tuning(tuning, result):
        heading = [headline_sentence(headline(result))]
    else:
        heading = reason_in_headline(tuning, result) or outcome_sentences(tuning)
        facts_on_flight.insert(0, result)
    next_step = Sentence(_text_of_next_step(tuning), "Next:")
    summary = [*heading, *_sentences_on_flight(facts_on_flight, tuning.judgement.next_step)]
    summary += _sentences_on_filter_lag(tuning)
    summary.append(next_step)
    if tuning.axes_also_to_lower:
        summary += render_section("tune_also_to_lower", axes=tuning.axes_also_to_lower)
    is_after_repair = not _has_next_step_on_loops(tuning.judgement)
    summary += _sentences_towards_gains(ground_steps_by_axis(tuning), is_after_repair)
    return [*summary, *_sentences_on_flight_for_gains(tuning, is_after_repair)]


def _text_of_next_step(tuning: Tuning) -> str:
    """Returns the next step in words; if it is a flight with doublets, also what to set for it and how fast to log.

    From a flight that is logged so, axes without margins get them too.

    Args:
        tuning: the judgement with the next step; and the advice on a flight for axes without margins, a coded finding
            (``Tuning.flight_for_gains``), which is None if all have them.

    Returns:
        What to set before the flight, the next step, and the log rates of the flight, as in "Fly it with rates …".
    """
    next_step = tuning.judgement.next_step
    flight = tuning.flight_for_gains
    is_flight_added = (
        next_step.code in STEPS_WITH_DOUBLETS and next_step.code is not NextStep.FLY_FOR_GAINS
    )
    if flight is None or not is_flight_added:
        return str(next_step)
    # The next step names the doublets already, so that only the settings and the log rates of the flight are added.
    flight = flight.replace(is_flight_stated=True)
    settings_and_log_rates = flight.sentence
    # Without rates as its figures, the fact has the sentences on the settings alone, which come first.
    settings = flight.replace(rates=(), least_rate=None).sentence
    log_rates = settings_and_log_rates.removeprefix(settings).strip()
    return " ".join(text for text in (settings, str(next_step), log_rates) if text)


def _are_of_one_event(first: Fact, second: Fact) -> bool:
    """Returns whether two facts (coded findings) state the same, such as a crash as the headline and in a light.

    Their figures may differ, since a headline may have further ones.
    """
    return (first.code, first.subject, first.time) == (second.code, second.subject, second.time)


def _sentences_on_filter_lag(tuning: Tuning) -> list[Sentence]:
    """Returns the sentence that names the gyro's filter as the cause of a missing margin, and what a higher one gives.

    Args:
        tuning: the finding on the filter (``Tuning.gyro_filter_lag``), and the advice on a higher cut-off. Where there
            is that advice, it says what to check first.

    Returns:
        A list with the sentence; empty if the filter is not the cause.
    """
    finding = tuning.gyro_filter_lag
    if finding is None:
        return []
    is_advised = tuning.gyro_cutoff is not None
    return [Sentence(finding.sentence if is_advised else finding.sentence_and_remedy, "Cause:")]


def _sentences_on_flight_for_gains(tuning: Tuning, is_after_repair: bool) -> list[Sentence]:
    """Returns the sentence on the next flight whose log leads to gains for more axes.

    This is a flight with doublets (short steps of the stick to both sides), which excite a control loop enough to
    identify it. A vehicle that oscillates only hovers, with lower gains.

    Args:
        tuning: both flights as coded findings (``Tuning.hover_to_tune`` and ``Tuning.flight_for_gains``), of which each
            is None if it is not advised, and the judgement with the next step.
        is_after_repair: whether the next step, such as a repair, comes before this flight.

    Returns:
        A list with the sentence; empty if no flight is needed, or if the next step states it completely.
    """
    hover = tuning.hover_to_tune
    if hover is not None:
        # The hover with the lower gains follows at once: it shows whether the oscillation has ended.
        return [Sentence(hover.sentence, "Then:")]
    flight = tuning.flight_for_gains
    if flight is None or tuning.judgement.next_step.code in STEPS_WITH_DOUBLETS:
        return []
    lead = (
        "To tune then:" if is_after_repair else f"For margins of {listed(flight.figures['axes'])}:"
    )
    return [Sentence(flight.sentence, lead)]


def _sentences_towards_gains(
    steps_by_axis: Mapping[str, list[str]], is_after_repair: bool
) -> list[Sentence]:
    """Returns the sentences on what leads to gains, such as "For gains of roll and pitch: fly doublets.".

    Args:
        steps_by_axis: what to do by axis, in sentences (:func:`ground_steps_by_axis`).
        is_after_repair: whether the next step, such as a repair, comes before these steps.

    Returns:
        A sentence for all axes with the same steps.
    """
    axes_by_text = group_by(steps_by_axis, lambda axis: " ".join(steps_by_axis[axis]))
    beginning = "Then, for gains of" if is_after_repair else "For gains of"
    return [Sentence(text, f"{beginning} {listed(axes)}:") for text, axes in axes_by_text.items()]


def _has_next_step_on_loops(judgement: Judgement) -> bool:
    """Returns whether the next step is about the control loops and leads to new gains, so that nothing comes before.

    A repair comes before, and so do gains to lower: the margins that they lead to are known only from a later flight.

    Args:
        judgement: judgement of the flight, with its headline and next step.
    """
    next_step = judgement.next_step
    if lowered_gains(next_step) or judgement.headline.code is MarginsLight.OSCILLATES:
        return False
    reason = next_step.figures.get("reason")
    is_action_on_loops = isinstance(reason, Fact) and isinstance(reason.code, LoopAction)
    return is_action_on_loops or is_about_loops(next_step, judgement)


def _sentences_on_flight(facts: Iterable[Fact], next_step: Fact) -> list[Sentence]:
    """Returns a sentence on what a flight shows besides its control loops, each finding with its remedy.

    Args:
        facts: the findings, the most important first; two of them may have the same remedy, which is stated once.
        next_step: the next step. It states the remedies of the findings that it has as figures.

    Returns:
        A list with the sentence; empty without findings.
    """
    facts_in_next_step = [*fact_and_contained_facts(next_step)]
    texts = []
    for fact in facts:
        texts.append(headline(fact))
        if fact.remedy and fact not in facts_in_next_step:
            texts.append(fact.remedy)
    if not texts:
        return []
    return [Sentence(" ".join(dict.fromkeys(texts)), "The flight:")]


def later_flight_sentences(tuning: Tuning) -> list[Sentence]:
    """Returns the advice to try a higher cut-off of the gyro's filter in a later flight, in place of lower gains.

    It stands below the gains, which are flown first.

    Args:
        tuning: the advice for each axis, and the cut-off frequency if one is advised.

    Returns:
        A list with the sentence; empty if no other cut-off is advised.
    """
    cutoff = tuning.gyro_cutoff
    if cutoff is None:
        return []
    is_cause_stated = tuning.gyro_filter_lag is not None
    text = cutoff.remedy if is_cause_stated else cutoff.sentence_and_remedy
    return [Sentence(text, "Later, instead of lower gains:")]
