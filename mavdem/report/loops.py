"""Control loops in sentences and tables, made of facts (coded findings): margins, decisions, gains to set."""

import re
from collections.abc import Collection, Container, Iterable, Iterator, Mapping, Sequence
from enum import StrEnum
from math import nan
from operator import attrgetter
from typing import NamedTuple

from mavdem.assessment.axis.flight_for_gains import is_removed_by_flight
from mavdem.assessment.axis.loop_decision import (
    ADVICE_TO_TUNE,
    REDUCTIONS_OF_RATE_GAINS,
    DecisionsByAxis,
    LoopDecision,
    LoopDiagnosis,
)
from mavdem.assessment.axis.lowered_gains import lowered_gains
from mavdem.assessment.axis.margins import AxisMargins
from mavdem.assessment.axis.tuning import Tuning
from mavdem.assessment.event_lights import LIGHT_OF_EVENT
from mavdem.assessment.faults_before_gains import faults_besides_loops
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.limits import worst_fact
from mavdem.confidence import IntervalEstimate
from mavdem.containers import Names, group_by
from mavdem.facts import Fact, Figure, Level
from mavdem.facts.assessment import NextStep
from mavdem.facts.lights import Light
from mavdem.facts.loops import ControllerFact, GainFact, LoopAction, LoopFact, StepResponseFact
from mavdem.facts.margins import MarginsLight
from mavdem.loops.advice import GAIN_REDUCTION, Advice, AdviceByAxis, Gain
from mavdem.loops.axis_loops import LOOP_NAMES, Loop, LoopsByAxis, MarginTarget, margin_rating
from mavdem.loops.filters import gyro_delay, gyro_filters
from mavdem.loops.gain_design import (
    EFFECTIVENESS_FACTORS,
    MAX_GAIN_STEP,
    MIN_GAIN_CHANGE,
    SURE_SHARE,
    round_gain,
)
from mavdem.loops.identified_step import STEP_SECONDS, PredictedStep, predicted_step
from mavdem.loops.margins import OpenLoop
from mavdem.report.blocks import Blocks, Detailed, Sentence, Table, headline_sentence
from mavdem.report.numbers import UNKNOWN_FIGURE, listed, rounded
from mavdem.report.templates import headline, model_share, render_section, sentences_by_axes


class LoopFigure(NamedTuple):
    """A figure of a loop as a table shows it."""

    header: str
    """Its name with the shown unit."""

    scale: float
    """Factor from its own unit to the shown one."""


LOOP_FIGURES = {
    "crossover": LoopFigure("crossover (Hz)", 1.0),
    "phase_margin": LoopFigure("phase margin (°)", 1.0),
    "gain_margin": LoopFigure("gain margin (dB)", 1.0),
    "delay_margin": LoopFigure("delay margin (ms)", 1e3),
    "ms": LoopFigure("maximum sensitivity Ms", 1.0),
    "bandwidth": LoopFigure("bandwidth, -3 dB (Hz)", 1.0),
    "rejection": LoopFigure("peak response to a disturbance of 100 °/s² (°/s, °)", 100.0),
}
"""Figures in the table of a loop, by the attribute of ``OpenLoop``."""

FIGURES_OF_STABLE_LOOPS = ("ms", "bandwidth", "rejection")
"""Figures of ``LOOP_FIGURES`` that are of a steady response, which an unstable loop never reaches."""

TUNED_FIGURES = ("phase_margin", "gain_margin", "ms", "crossover")
"""Figures of ``LOOP_FIGURES`` beside the gains to set: what the goal of tuning is made of, and the loop's speed.

The speed is the gain crossover, which follows the gains. The bandwidth jumps where the closed loop has long been flat
beside −3 dB: with two thirds of the gains it may fall to a fifth, though the step response rises as before.
"""

FIGURES_WITH_INTERVAL = ("phase_margin", "gain_margin")
"""Figures of ``TUNED_FIGURES`` whose 90 % interval the overview of a tuning shows; a terminal has no room for all."""

OVERVIEW_HEADERS = {
    "phase_margin": "phase margin (°)",
    "gain_margin": "gain margin (dB)",
    "ms": "Ms",
    "crossover": "crossover (Hz)",
}
"""Headers of ``TUNED_FIGURES`` in the overview of a tuning, whose columns are narrow."""

DOUBTFUL_HEADER = "doubtful"
"""What the overview calls loops whose margins may be wrong."""

INTERVAL_IN_CELL = re.compile(r"\([^()]+ to [^()]+\)")
"""An interval of a figure in a cell, such as "(23 to 35)"."""

TRIED_HEADER = "tried, not to be loaded"
"""What tables call gains that another flight is to confirm before they are loaded."""

PHONE_TITLE_OF_MARGINS = "All margins with intervals"
"""What a phone shows of the table of all margins until it is opened."""

REASONS_FOR_GAINS = (GainFact.STEP_BOUND, GainFact.INTEGRAL_FALLS)
"""Notes on gains that say why they are no others; they stand beside the gains. The remaining ones are details."""


STEPS_WITH_DOUBLETS = (
    NextStep.LOAD_GAINS,
    NextStep.KEEP_OR_CONFIRM_GAINS,
    NextStep.FLY_BEFORE_GAINS,
    NextStep.FLY_FOR_GAINS,
)
"""Next steps of a tuning that name a flight with doublets themselves."""


MAX_CROSSOVER_RATIO = 0.5
"""Largest crossover of an attitude loop whose margins are shown, as a fraction of the crossover of its rate loop.

Autopilots' default gains have 0.1 to 0.3.
"""


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
    facts_on_flight = [fact for fact in _faults_besides_loops(tuning) if fact != result]
    if is_headline_of_tuning(tuning, result):
        heading = [headline_sentence(headline(result))]
    else:
        heading = outcome_sentences(tuning)
        facts_on_flight.insert(0, result)
    next_step = Sentence(str(tuning.judgement.next_step), "Next:")
    # The remedies in the headline and in the next step are not repeated between them.
    texts_beside = [sentence.lead for sentence in heading]
    texts_beside += [next_step.text, *_texts_in_next_step(tuning)]
    summary = [*heading, *_sentences_on_flight(facts_on_flight, texts_beside)]
    summary += _sentences_on_filter_lag(tuning)
    summary.append(next_step)
    if tuning.axes_also_to_lower:
        summary += render_section("tune_also_to_lower", axes=tuning.axes_also_to_lower)
    is_after_repair = not _has_next_step_on_loops(tuning.judgement)
    summary += _sentences_towards_gains(_ground_steps_by_axis(tuning), is_after_repair)
    return [*summary, *_sentences_on_flight_for_gains(tuning, is_after_repair)]


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
    """Returns a sentence that advises a flight with doublets, whose log gives gains for more axes.

    A vehicle that oscillates hovers with lower gains first. Otherwise the sentence is needed only where the next step
    does not advise this flight already.

    Args:
        tuning: the advised flight (``Tuning.flight_for_gains``, a coded finding), and the judgement with the next step.
        is_after_repair: whether the next step, such as a repair, comes before this flight.

    Returns:
        A list with the sentence. It says only what to log if the next step is a flight with doublets. It is empty if
        nothing is left to say, or if no such flight is needed.
    """
    if tuning.hover_to_tune is not None:
        return [Sentence(tuning.hover_to_tune.sentence, "To tune then:")]
    flight = tuning.flight_for_gains
    next_step = tuning.judgement.next_step
    if flight is None or next_step.code is NextStep.FLY_FOR_GAINS:
        return []
    lead = f"For margins of {listed(flight.figures['axes'])}:"
    if is_after_repair:
        lead = "To tune then:"
    if next_step.code in STEPS_WITH_DOUBLETS:
        flight = flight.replace(is_flight_stated=True)
    return [Sentence(flight.sentence, lead)] if flight.sentence else []


def _ground_steps_by_axis(tuning: Tuning) -> dict[str, list[str]]:
    """Returns for each axis what to do on the ground so that the next log gives its gains, such as to set a parameter.

    Args:
        tuning: advice on the gains of each axis, and the judgement of the flight with the next step.

    Returns:
        Sentences by axis, without what the next step states. An axis that gets gains from this log, or for which there
        is nothing to do, is left out.
    """
    steps_by_axis = {}
    for axis in tuning.axes:
        gets_gains = _gain_outcome(tuning, axis) not in OUTCOMES_WITHOUT_GAINS
        if gets_gains or _is_advised_flight_useless(tuning, axis):
            continue
        steps = _remedies_not_stated_yet(tuning, _remedies_besides_flight(tuning, axis))
        if steps:
            steps_by_axis[axis] = steps
    return steps_by_axis


def _is_advised_flight_useless(tuning: Tuning, axis: str) -> bool:
    """Returns whether another flight is all that is advised for an axis, and cannot lead to its gains.

    No flight can if the log does not describe the controller, for example because it lacks parameters.

    Args:
        tuning: advice on the gains of each axis, and the axes whose controllers are not known (``controller_faults``).
        axis: "roll", "pitch" or "yaw".
    """
    is_controller_unknown = axis in tuning.controller_faults
    return is_controller_unknown and _conclusion_on_gains(tuning.axes[axis]).advises_only_flight


def _remedies_not_stated_yet(tuning: Tuning, remedies: Iterable[str]) -> list[str]:
    """Returns remedies without those that the next step or the report's sentence on the flight already states.

    Args:
        tuning: the judgement of the flight, with its next step and with faults that are not about loops.
        remedies: what to do, one or several sentences each.

    Returns:
        The remedies, each once; one that is part of another one is left out.
    """
    texts_in_next_step = _texts_in_next_step(tuning)
    next_step = str(tuning.judgement.next_step).lower()
    remedies_of_flight = [fault.remedy for fault in _faults_besides_loops(tuning)]
    new_remedies = []
    for remedy in _without_contained_texts([*dict.fromkeys(remedies)]):
        is_in_next_step = remedy.removesuffix(".").lower() in next_step
        if is_in_next_step or remedy in texts_in_next_step:
            continue
        new_part = _without_repetition(remedy, remedies_of_flight)
        if new_part:
            new_remedies.append(new_part)
    return new_remedies


def _remedies_besides_flight(tuning: Tuning, axis: str) -> list[str]:
    """Returns what to do about one axis, such as a parameter to set, without the flight that would give its gains.

    That flight (``Tuning.flight_for_gains``) serves several axes and is stated once. There may be remedies of two
    kinds: towards gains, and against another fault of the loops. If the vehicle must be repaired first, what leads to
    gains is only to complete the parameters of the controller, so that a later flight gives them.

    Args:
        tuning: for each axis the advice on its gains, or the finding that says why there is none.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The remedies, one or several sentences each; some may be empty.
    """
    advice = tuning.axes[axis]
    advice_on_gains = advice if isinstance(advice, Fact) else _advice_on_gains(tuning, advice)
    remedies = _remedies_besides_tuning(tuning, axis)
    if _next_step_has_priority(tuning, advice_on_gains):
        controller_fault = tuning.controller_faults.get(axis)
        if controller_fault is not None and controller_fault.remedy:
            remedies.append(controller_fault.sentence_and_remedy)
        return remedies
    if axis not in tuning.axes_to_fly_for_gains:
        return [advice_on_gains.remedy, *remedies]
    # An axis that keeps its gains has no reasons against other ones.
    reasons = advice_on_gains.figures.get("reasons", ())
    other_reasons = [reason for reason in reasons if not is_removed_by_flight(reason)]
    remedies_towards_gains = [reason.remedy for reason in other_reasons]
    return [*remedies_towards_gains, *remedies]


def _without_repetition(text: str, texts_beside: Iterable[str]) -> str:
    """Returns a text without the sentences that the reader finds beside it, such as "Fly doublets."; it may be empty.

    Args:
        text: one or several sentences.
        texts_beside: the sentences beside it. Each of them is removed where the text contains it as a whole.
    """
    for text_beside in texts_beside:
        text = text.replace(text_beside, "")
    return " ".join(text.split())


def _sentences_towards_gains(
    steps_by_axis: Mapping[str, list[str]], is_after_repair: bool
) -> list[Sentence]:
    """Returns the sentences on what leads to gains, such as "For gains of roll and pitch: fly doublets.".

    Args:
        steps_by_axis: what to do by axis, in sentences (:func:`_ground_steps_by_axis`).
        is_after_repair: whether the next step, such as a repair, comes before these steps.

    Returns:
        A sentence for all axes with the same steps, or with steps that those of another axis contain.
    """
    text_by_axis = {axis: " ".join(steps) for axis, steps in steps_by_axis.items()}
    all_texts = [*text_by_axis.values()]
    axes_by_text = group_by(
        text_by_axis, lambda axis: _most_complete(text_by_axis[axis], all_texts)
    )
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


def is_headline_of_tuning(tuning: Tuning, result: Fact) -> bool:
    """Returns whether the most important result is the headline of a tuning's report: if it is about loops, or bad.

    Args:
        tuning: the advice for each axis, with the judgement of the flight.
        result: the most important result. It is about the loops unless it is the headline of the flight, which may be
            about anything, such as the wind (:func:`tuning_result`).
    """
    is_of_whole_flight = result is tuning.judgement.headline
    if not is_of_whole_flight or result.is_bad:
        return True
    return is_about_loops(result, tuning.judgement)


def outcome_sentences(tuning: Tuning) -> list[Sentence]:
    """Returns the sentence on what becomes of the gains of each axis, as "Roll: new gains. Yaw: keep the gains.".

    Args:
        tuning: advice on the gains of each axis, or the fact (coded finding) that says why its loop is not known.

    Returns:
        A list with the sentence. If the margins of no axis are known, it says only that, or names an unknown mixer.
    """
    axes_by_outcome = group_by(tuning.axes, lambda axis: _gain_outcome(tuning, axis))
    outcomes_with_margins = axes_by_outcome.keys() - set(OUTCOMES_WITHOUT_MARGINS)
    return render_section(
        "tune_axes",
        axes=[*tuning.axes],
        axes_by_outcome=axes_by_outcome,
        outcomes=[*GainOutcome],
        has_outcomes=bool(outcomes_with_margins),
        sluggish_axes=_sluggish_axes(tuning),
        mixer_fault=_mixer_fault(tuning),
    )


def _mixer_fault(tuning: Tuning) -> Fact | None:
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
    return [axis for axis in tuning.axes if _gain_outcome(tuning, axis) in keeps_gains]


def outcome_by_axis(tuning: Tuning) -> dict[str, str]:
    """Returns what becomes of the gains of each axis in words, such as "new gains" or "no gains, margins not known".

    Args:
        tuning: advice on the gains of each axis, or the fact (coded finding) that says why its loop is not known.
    """
    words = {}
    for axis in tuning.axes:
        outcome = _gain_outcome(tuning, axis)
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


def margin_overview(tuning: Tuning, *, names_axis: bool) -> list[Table]:
    """Returns tables of the margins now and with new gains, such as "29 (23 to 35) → 44", below a row with their goal.

    Each loop of an axis has a row, with a second line for its intervals on a phone. Axes whose gains are treated alike,
    such as those with gains to load, share a table (:func:`_margins_header`); doubtful margins come last.

    Args:
        tuning: advice on the gains of each axis, or the fact (coded finding) that says why its loop is not known.
        names_axis: whether both rows of an axis name it, as on a page, whose rows may be read alone.

    Returns:
        The tables; empty if no loop is known.
    """
    advice_by_header = dict[str, list[Advice]]()
    for axis, advice in tuning.axes.items():
        if isinstance(advice, Advice):
            advice_by_header.setdefault(_margins_header(tuning, axis), []).append(advice)
    doubtful_advice = advice_by_header.pop(DOUBTFUL_HEADER, None)
    if doubtful_advice is not None:
        advice_by_header[DOUBTFUL_HEADER] = doubtful_advice
    tables = []
    for header, advice_of_axes in advice_by_header.items():
        tables.append(_margins_table(header, advice_of_axes, names_axis=names_axis))
    return tables


def _margins_table(
    first_header: str, advice_of_axes: Sequence[Advice], *, names_axis: bool
) -> Table:
    """Returns a table of the margins of some axes, with a row for each loop, and a narrower one for a phone.

    Args:
        first_header: header of the first column, such as "now → new".
        advice_of_axes: advice on each axis, with its identified loops; all have the same goal.
        names_axis: whether both rows of an axis name it.
    """
    goal = _goal_row(advice_of_axes[0].target)
    rows = [goal]
    # Without its space no goal breaks in the narrow columns of a phone.
    rows_on_phone = [[cell.replace(" ", "") for cell in goal]]
    for advice in advice_of_axes:
        rows_with_intervals = _overview_rows(advice, names_axis=names_axis)
        values = _overview_rows(advice, has_intervals=False, names_axis=True)
        rows += rows_with_intervals
        for row, row_of_values in zip(rows_with_intervals, values, strict=True):
            rows_on_phone.append(_cells_on_phone(row, row_of_values))
    headers = [first_header, *[OVERVIEW_HEADERS[figure_name] for figure_name in TUNED_FIGURES]]
    return Table(headers, rows, phone_tables=[Table(headers, rows_on_phone)])


def _goal_row(target: MarginTarget) -> list[str]:
    """Returns the first row of a table of margins: the goal of each of ``TUNED_FIGURES``; the crossover has none."""
    goals = {
        "phase_margin": f"≥ {target.phase_margin:g}",
        "gain_margin": f"≥ {target.gain_margin:g}",
        "ms": f"≤ {target.ms:g}",
    }
    return ["goal", *[goals.get(figure_name, "") for figure_name in TUNED_FIGURES]]


def _cells_on_phone(row: Iterable[str], row_of_values: Iterable[str]) -> list[str]:
    """Returns the cells of a row as a phone shows them: each figure, and its interval as a second line.

    Args:
        row: cells with intervals, such as "29 (23 to 35) → 44".
        row_of_values: the same cells without, such as "29 → 44".
    """
    cells = []
    for cell, value in zip(row, row_of_values, strict=True):
        # The spaces around an arrow are left out, so that all columns fit and no line breaks there.
        text = value.replace(" → ", "→")
        intervals = " → ".join(INTERVAL_IN_CELL.findall(cell))
        cells.append(Detailed(text, intervals) if intervals else text)
    return cells


def _sentences_on_flight(facts: Iterable[Fact], texts_beside: Collection[str]) -> list[Sentence]:
    """Returns a sentence on what a flight shows besides its control loops, each finding with its remedy.

    Args:
        facts: the findings, the most important first; two of them may have the same sentence.
        texts_beside: the headline and the next step, which stand beside the sentence and are not repeated.

    Returns:
        A list with the sentence; empty without findings.
    """
    texts: list[str] = []
    for fact in facts:
        for text in (headline(fact), fact.remedy):
            new_text = _unless_in((*texts_beside, *texts), text)
            if new_text:
                texts.append(new_text)
    if not texts:
        return []
    return [Sentence(" ".join(texts), "The flight:")]


def _faults_besides_loops(tuning: Tuning) -> list[Fact]:
    """Returns what the flight shows to be watch or bad about anything but its control loops, each finding once."""
    return faults_besides_loops(tuning.judgement.headline, tuning.judgement.lights)


def level_of_summary(tuning: Tuning, result: Fact) -> Level:
    """Returns the level of the worst finding in the summary of a tuning report, such as "bad".

    The summary states the result of the tuning, and faults of the flight that are not about control loops, such as a
    weak motor. A flight with such a fault is marked as bad even if its gains are good.

    Args:
        tuning: the advice on the gains of each axis, with the judgement of the whole flight.
        result: the most important result of the tuning (:func:`tuning_result`), a fact with a level.
    """
    findings = [result, *_faults_besides_loops(tuning)]
    return worst_fact(findings).level


def tune_overview(tuning: Tuning, result: Fact) -> Blocks:
    """Returns what becomes of each axis at a glance: in a sentence, and in tables (:func:`margin_overview`).

    Args:
        tuning: advice on the gains of each axis, or the fact (coded finding) that says why its loop is not known.
        result: the most important result (:func:`tuning_result`). If it is not the headline of the report, the sentence
            is, and is left out here.

    Returns:
        The sentence and the tables; empty if no loop is known.
    """
    tables = margin_overview(tuning, names_axis=False)
    if not tables or not is_headline_of_tuning(tuning, result):
        return [*tables]
    return [*outcome_sentences(tuning), *tables]


def _margins_header(tuning: Tuning, axis: str) -> str:
    """Returns the header above the margins of an axis, which says of which gains they are, such as "now → new".

    Axes with the same header share a table.

    Args:
        tuning: advice on the gains of each axis; the loop of this one is identified.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The first of these that applies:

        - ``DOUBTFUL_HEADER`` if the margins may be wrong.
        - "now → tried" if another flight is to confirm the new gains of this axis.
        - "as flown" if the vehicle must be repaired first, which changes the margins.
        - "now → stage 2" if the new gains wait for a flight with those of another axis.
        - "now → new", or "now" if no axis has gains to load.
    """
    advice = tuning.axes[axis]
    # An axis has a fact instead of advice only if its loop is not identified.
    assert isinstance(advice, Advice)
    if _has_doubtful_margins(tuning, axis):
        return DOUBTFUL_HEADER
    outcome = _gain_outcome(tuning, axis)
    if outcome is GainOutcome.FLY_FIRST:
        return "now → tried"
    if outcome is GainOutcome.REPAIR_FIRST:
        return "as flown"
    if tuning.waits(advice):
        return f"now → stage {advice.stage:d}"
    outcomes = [_gain_outcome(tuning, other_axis) for other_axis in tuning.axes]
    return "now → new" if GainOutcome.NEW in outcomes else "now"


def _overview_rows(
    advice: Advice, *, has_intervals: bool = True, names_axis: bool = False
) -> list[list[str]]:
    """Returns the rows of the overview's table for the rate loop and the attitude loop of one axis.

    Args:
        advice: advice on the axis: its identified loops with the gains that flew and with new ones, if there are any.
        has_intervals: whether ``FIGURES_WITH_INTERVAL`` have their intervals.
        names_axis: whether the row of the attitude names the axis, too, as on a page, whose rows may be read alone.

    Returns:
        For each loop its name and a cell for each of ``TUNED_FIGURES`` (:func:`_overview_cell`).
    """
    rows = []
    for loop_name in LOOP_NAMES:
        has_axis = names_axis or loop_name == "rate"
        first_cell = f"{advice.before.axis} {loop_name}" if has_axis else f"  {loop_name}"
        row = [first_cell]
        for figure_name in TUNED_FIGURES:
            has_interval = has_intervals and figure_name in FIGURES_WITH_INTERVAL
            cell = _overview_cell(
                advice,
                loop_name,
                figure_name,
                has_interval=has_interval,
                # A terminal of 80 columns has no room for these.
                has_new_interval=has_interval and names_axis,
            )
            row.append(cell)
        rows.append(row)
    return rows


def _overview_cell(
    advice: Advice, loop_name: str, figure_name: str, *, has_interval: bool, has_new_interval: bool
) -> str:
    """Returns a figure of a loop now and, if it changes, with new gains, such as "29 (23 to 35) → 44 (38 to 51)".

    Args:
        advice: advice on an axis: its identified loops with the gains that flew and with new ones, if there are any.
        loop_name: "rate" or "attitude".
        figure_name: one of ``TUNED_FIGURES``, such as "phase_margin".
        has_interval: whether the figure now has its 90 % interval.
        has_new_interval: whether the figure with new gains has one.
    """
    value_now = _value_text(advice.before, loop_name, figure_name)
    text_now = _figure_text(advice.before, loop_name, figure_name) if has_interval else value_now
    if not advice.parameters:
        return text_now
    new_text = _value_text(advice.after, loop_name, figure_name)
    if new_text == value_now:
        return text_now
    if has_new_interval:
        new_text = _figure_text(advice.after, loop_name, figure_name)
    return f"{text_now} → {new_text}"


def _gain_outcome(tuning: Tuning, axis: str) -> GainOutcome:
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
    if _has_doubtful_margins(tuning, axis):
        return GainOutcome.DOUBTFUL
    if advice.refusals:
        return GainOutcome.REPAIR_FIRST
    if advice.parameters:
        return GainOutcome.NEW if advice.is_sound else GainOutcome.FLY_FIRST
    return GainOutcome.KEEP if advice.rating.is_good else GainOutcome.KEEP_UNSURE


def tune_blocks(
    tuning: Tuning,
    *,
    is_full: bool = True,
    is_page: bool = False,
    headline_above: str = "",
) -> Blocks:
    """Returns the reasons behind a tuning: for each axis what to do with its gains and why, and how far to trust that.

    Axes of which the same is to be said share a sentence. Each remedy is stated once, and not at all if the next step,
    which is shown with the report, contains it.

    Args:
        tuning: advice for each axis, or the fact that says why there is none.
        is_full: whether all margins and everything about the gains are included.
        is_page: whether the report is part of a page, where each axis has its rating, and the cautions about gains to
            set stand beside these. A terminal has all margins above the report (:func:`tune_overview`).
        headline_above: headline that stands above the report, which is not repeated as the reason for no gains; empty
            without one.
    """
    if tuning.judgement.headline.code is MarginsLight.OSCILLATES and not is_full:
        # How far the identified loops can be trusted matters only once the vehicle flies without an oscillation.
        axes_without_gains = [axis for axis in tuning.axes if not tuning.lowers_gains_of(axis)]
        return [*sentences_without_gains(tuning, axes_without_gains)]
    blocks = Blocks()
    shown_remedies = _texts_in_next_step(tuning)
    for remedies_above in _ground_steps_by_axis(tuning).values():
        shown_remedies.update(remedies_above)
    axes_in_shared_sentences: list[str] = []
    for axes in _axes_with_same_conclusion(tuning):
        blocks += _sentences_on_gains(tuning, axes, shown_remedies, headline_above)
        axes_in_shared_sentences += axes
    cautions = _shared_cautions(tuning.axes)
    for axes in _axes_reported_together(tuning):
        # The report says the same of all these axes, so that the first one stands for them.
        axis = axes[0]
        advice = tuning.axes[axis]
        if isinstance(advice, Fact):
            blocks += _sentences_without_loop(tuning, axes, headline_above)
            continue
        facts = _rating_to_state(tuning, axis, is_page=is_page)
        # The gains of axes with the same advice were described together, above.
        if axis not in axes_in_shared_sentences:
            facts += _facts_on_new_gains(tuning, axis)
        facts = _without_reason_in_headline(tuning, axis, facts, headline_above)
        report = _joined_sentences(facts, headline_above)
        remedies = _remedies_to_show(tuning, axis, report, shown_remedies)
        shown_remedies.update(remedies)
        blocks += _sentences_on_axes(axes, report, remedies)
        blocks += _caution_sentences(cautions, advice, has_gains_elsewhere=is_page)
        if is_full:
            blocks += _axis_details(advice, is_doubtful=_has_doubtful_margins(tuning, axis))
    blocks += _sentences_on_feedforward(tuning.feedforward)
    blocks += _sentences_on_other_axes(tuning.judgement.next_step)
    if any(_gain_outcome(tuning, axis) is GainOutcome.REPAIR_FIRST for axis in tuning.axes):
        blocks += render_section("tune_as_flown")
    if is_full:
        blocks += _warning_of_unchecked_effects(tuning)
    return blocks


def _sentences_on_feedforward(findings: Iterable[Fact]) -> list[Sentence]:
    """Returns sentences on the axes that overshoot their setpoint because of feed-forward, with what to do.

    Args:
        findings: the fact (coded finding) for each such axis.
    """
    axes_and_findings = [(finding.figures["axis"], finding) for finding in findings]
    return sentences_by_axes(axes_and_findings, attrgetter("sentence_and_remedy"))


def _without_reason_in_headline(
    tuning: Tuning, axis: str, facts: Iterable[Fact], headline_above: str
) -> list[Fact]:
    """Returns facts on the gains of an axis so that their sentences do not repeat a reason from the headline.

    Only the fact that no gains are advised changes. Its sentence then states the other reasons, or, if there are none,
    says "for the reason above". It is left out if that reason is a repair: the overview above says so already.

    Args:
        tuning: advice on the gains of each axis.
        axis: "roll", "pitch" or "yaw".
        facts: coded findings on the axis.
        headline_above: sentence at the top of the page or of the terminal's report; empty without one.
    """
    stated_facts = []
    for fact in facts:
        if fact.code is GainFact.NO_GAINS_ADVISED:
            reasons = fact.figures["reasons"]
            other_reasons = [reason for reason in reasons if str(reason) not in headline_above]
            if not other_reasons and _gain_outcome(tuning, axis) is GainOutcome.REPAIR_FIRST:
                continue
            fact = fact.replace(
                reasons=tuple(other_reasons) or reasons, is_reason_above=not other_reasons
            )
        stated_facts.append(fact)
    return stated_facts


def _joined_sentences(facts: Iterable[Fact], headline_above: str) -> str:
    """Joins the sentences of a report on one axis to a text that does not begin by repeating the headline above it.

    Args:
        facts: coded findings, each with its sentence.
        headline_above: sentence at the top of the page or of the terminal's report; empty without one. The first of the
            facts may have the same sentence, which is then left out.
    """
    text = " ".join(str(fact) for fact in facts)
    return text.removeprefix(headline_above).strip()


def _sentences_on_gains(
    tuning: Tuning, axes: list[str], shown_remedies: set[str], headline_above: str
) -> list[Sentence]:
    """Returns the sentence on what to do with the gains of several axes, and why.

    Args:
        tuning: advice on the gains of each axis; the loops of these axes are identified.
        axes: axes with the same advice for the same reasons.
        shown_remedies: remedies that the report shows elsewhere, which are not repeated. The remedy of this sentence is
            added to the set.
        headline_above: headline that stands above the report, which is not repeated as the reason for no gains.
    """
    # The facts are the same for all axes.
    facts = _facts_on_new_gains(tuning, axes[0])
    conclusion = facts[0]
    remedies = []
    if conclusion.remedy not in shown_remedies:
        remedies.append(conclusion.remedy)
        shown_remedies.add(conclusion.remedy)
    stated_facts = _without_reason_in_headline(tuning, axes[0], facts, headline_above)
    report = " ".join(str(fact) for fact in stated_facts)
    return _sentences_on_axes(axes, report, remedies)


def _sentences_without_loop(tuning: Tuning, axes: list[str], headline_above: str) -> list[Sentence]:
    """Returns the sentence that says why some axes get no gains: their loops are not known.

    What to do to get gains stands in the summary (:func:`tune_summary`).

    Args:
        tuning: for these axes the fact (coded finding) that says why their loops are not known.
        axes: axes whose loops are not known for the same reason.
        headline_above: headline that stands above the report, which is not repeated as the reason; empty without one.
    """
    axis = axes[0]
    reason = tuning.axes[axis]
    # The axes were grouped by this reason, which is a fact.
    assert isinstance(reason, Fact)
    if len(axes) > 1:
        reason = _fact_on_axes(reason, listed(axes))
    report = _joined_sentences([reason], headline_above)
    findings_of_flight = [headline(fault) for fault in _faults_besides_loops(tuning)]
    # What the summary says of the flight is not repeated beside another reason.
    report = _without_repetition(report, findings_of_flight) or report
    if not report:
        # The headline above says why: a repair is needed. Axes whose gains are lowered have these above.
        axes_without_gains = [axis for axis in axes if not tuning.lowers_gains_of(axis)]
        return sentences_without_gains(tuning, axes_without_gains)
    lowers_gains = any(tuning.lowers_gains_of(axis) for axis in axes)
    sentences = render_section("tune_no_gains", axes=axes, reason=report, lowers_gains=lowers_gains)
    return [*sentences, *_faults_in_flight(tuning, axes, report, headline_above)]


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


def _caution_sentences(
    cautions: "Iterable[_SharedCaution]", advice: Advice, *, has_gains_elsewhere: bool
) -> list[Sentence]:
    """Returns the sentences on how far the identified loop of one axis can be trusted, as its report shows them.

    A sentence that several axes share is shown with the first of them only.

    Args:
        cautions: the cautions about the loops of all axes.
        advice: advice on the axis.
        has_gains_elsewhere: whether a page has a table of the gains to set elsewhere. Beside it stand the cautions
            about these gains.
    """
    are_gains_elsewhere = has_gains_elsewhere and bool(advice.parameters)
    sentences = []
    for caution in cautions:
        is_elsewhere = are_gains_elsewhere and caution.is_about_gains_to_set
        if caution.axes[0] == advice.before.axis and not is_elsewhere:
            sentences.append(caution.sentence)
    return sentences


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


def _remedies_to_show(
    tuning: Tuning, axis: str, report: str, shown_remedies: Collection[str]
) -> list[str]:
    """Returns what to do about one axis, such as "Fly doublets.", unless the reader finds it elsewhere.

    A remedy is left out if the text on the axis, or another part of the page, has it already, or if another one
    contains it.

    Args:
        tuning: for each axis the advice on its gains, or the finding that says why there is none.
        axis: "roll", "pitch" or "yaw".
        report: text on the axis, which the remedies will follow.
        shown_remedies: the remedies in the next step and in the text on other axes.

    Returns:
        The remedies, which may be several sentences each.
    """
    candidates = _remedies_besides_flight(tuning, axis)
    if axis in tuning.axes_to_fly_for_gains:
        candidates += _remedies_until_flight(tuning.axes[axis])
    new_remedies = []
    for remedy in dict.fromkeys(candidates):
        if remedy not in shown_remedies and remedy not in report:
            new_remedies.append(remedy)
    return _without_contained_texts(new_remedies)


def _remedies_until_flight(advice: Advice | Fact) -> list[str]:
    """Returns which measurement to trust until the next flight, if the response that a loop predicts is doubtful.

    Args:
        advice: the advice on the axis, or the fact (coded finding) that says why its loop is not known.

    Returns:
        The remedies against the doubt, without the advice to fly anew; empty if there is no such doubt.
    """
    if isinstance(advice, Fact):
        return []
    remedies = []
    for reason in advice.refusals:
        if reason.code is StepResponseFact.PREDICTION_DOUBTED:
            remedies.append(reason.replace(is_flight_stated=True).remedy)
    return remedies


def _without_contained_texts(texts: list[str]) -> list[str]:
    """Returns some different texts without those that another one contains, so that nothing is read twice."""
    return [text for text in texts if _most_complete(text, texts) == text]


def _most_complete(text: str, texts: Collection[str]) -> str:
    """Returns the longest of some texts that contains a text; the text itself if none does.

    "Fly doublets, with rates logged at 100 Hz." contains "Fly doublets." but for its full stop.

    Args:
        text: the text, one or several sentences.
        texts: texts to choose from.
    """
    text_without_stop = text.removesuffix(".")
    containing_texts = [other for other in texts if text_without_stop in other]
    return max([text, *containing_texts], key=len)


def _next_step_has_priority(tuning: Tuning, fact: Fact) -> bool:
    """Returns whether what a fact advises is left out, since the vehicle must first be repaired for another reason.

    That is so if the next step of the flight and the fact both ask for a repair before any flight. The report then
    states the repair of the next step only, which is the more urgent one.

    Args:
        tuning: the judgement of the flight, with its next step.
        fact: why there are no gains for an axis, or what to do about its loops; a coded finding with advice.
    """
    return forbids_flight(tuning.judgement.next_step) and forbids_flight(fact)


def forbids_flight(fact: Fact) -> bool:
    """Returns whether a fact, or any fact that it gives as a reason, forbids to fly before something is repaired.

    Args:
        fact: a coded finding. A next step has the fact that it follows from as its figure ``reason``; the fact that
            there are no gains has several as ``reasons``. These may have reasons of their own.
    """
    if fact.forbids_flight:
        return True
    reasons = [fact.figures.get("reason"), *fact.figures.get("reasons", ())]
    # A figure "reason" is None where it is missing, and a text in some facts.
    facts_given_as_reasons = [reason for reason in reasons if isinstance(reason, Fact)]
    return any(forbids_flight(reason) for reason in facts_given_as_reasons)


def needs_check_before_gains(next_step: Fact) -> bool:
    """Returns whether something is to be repaired or checked before gains are loaded, such as the order of the motors.

    A vehicle that oscillated but stayed upright needs no check: the gains to load are lower ones, which end that.

    Args:
        next_step: the next step, a coded finding, with the fact that it follows from as its figure ``reason``.
    """
    reason = next_step.figures.get("reason")
    if isinstance(reason, Fact) and reason.code is MarginsLight.OSCILLATES:
        return not reason.figures["was_upright"]
    return forbids_flight(next_step)


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
        if isinstance(advice, Advice) and not _has_doubtful_margins(tuning, axis):
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


def field_sentences(tuning: Tuning) -> list[Sentence]:
    """Returns what a pilot must know at the flying field: when to land with new gains, and when the tuning is done.

    Args:
        tuning: the advice for each axis, or the fact (coded finding) that says why there is none.

    Returns:
        The sentences; empty if gains neither change nor are known to be right.
    """
    axes_by_outcome = group_by(tuning.axes, lambda axis: _gain_outcome(tuning, axis))
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


def _largest_checked_thrust_change() -> float:
    """Returns how much more or less thrust than in flight gains are checked with, as a fraction: 0.2 for 20 %."""
    return max(EFFECTIVENESS_FACTORS) - 1


def tune_details(tuning: Tuning) -> Blocks:
    """Returns the details of a tuning: further figures of the loops, and what they and the gains are based on.

    Axes without an identified loop are left out, and figures that :func:`tuned_loops_table` has.

    Args:
        tuning: advice for each axis, or the fact (coded finding) that says why there is none.
    """
    compared = _loop_columns(tuning)
    blocks = Blocks()
    if compared.by_header:
        blocks += margin_tables(
            compared.by_header, compared.doubtful_headers, omitted_figures=TUNED_FIGURES
        )
    for axis, advice in tuning.axes.items():
        if isinstance(advice, Fact):
            continue
        is_doubtful = _has_doubtful_margins(tuning, axis)
        blocks.append(headline_sentence(axis.capitalize()))
        blocks += _gain_sentences(advice)
        blocks += _basis_sentences(advice.before, is_doubtful=is_doubtful)
    return [*blocks, *_warning_of_unchecked_effects(tuning)]


def _warning_of_unchecked_effects(tuning: Tuning) -> list[Sentence]:
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
    for remedy in _remedies_besides_tuning(tuning, axis):
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
        A list with the rating; empty if it is left out, or if there is none (:func:`_rating_unless_contradicted`).
    """
    advice = tuning.axes[axis]
    # An axis has a fact instead of advice only if its loop is not identified.
    assert isinstance(advice, Advice)
    if axis in tuning.doubtful_axes:
        return []
    ratings = _rating_unless_contradicted(advice, tuning.judgement.loop_decisions.get(axis))
    if _has_doubtful_margins(tuning, axis):
        ratings = [rating for rating in ratings if not rating.is_good]
    if not is_page:
        # Only a rating that the axis does not follow its setpoint has the figure "follows".
        ratings = [rating for rating in ratings if "follows" in rating.figures]
    return ratings


def _facts_on_slower_rate(advice: Advice) -> list[Fact]:
    """Returns the fact that with the new gains the rate follows its setpoint more slowly, and for which margin.

    Args:
        advice: advice on the gains of an axis.

    Returns:
        A list with the fact; empty if the rate does not become slower (:func:`_slower_response`). If the rate loop
        lacks margin with the present gains, the figure by the name of the margin that it lacks most, such as "ms", has
        its values with the present and with the new gains.
    """
    response = _slower_response(advice, "rate")
    if response is None:
        return []
    rating = margin_rating(advice.before, advice.target)
    margins: dict[str, Figure] = {}
    if not rating.is_good and rating.subject == "rate":
        margin = rating.figures["lacking"]
        margins[margin] = (getattr(advice.before.rate, margin), getattr(advice.after.rate, margin))
    return [Fact(GainFact.RATE_SLOWER, None, **response.figures, **margins)]


def _facts_on_slower_attitude(advice: Advice) -> list[Fact]:
    """Returns the fact that with the new gains the angle follows its setpoint more slowly, by the predicted steps.

    Higher gains of the rate may have that effect: with less of the integral term the angle overshoots less.

    Args:
        advice: advice on the gains of an axis.

    Returns:
        A list with the fact; empty if the angle does not become slower (:func:`_slower_response`).
    """
    response = _slower_response(advice, "attitude")
    if response is None:
        return []
    return [Fact(GainFact.ATTITUDE_SLOWER, None, **response.figures)]


class _SlowerResponse(NamedTuple):
    """Predicted steps of a loop that new gains make slower."""

    now: PredictedStep
    """With the gains that flew."""
    new: PredictedStep
    """With the new gains."""
    duration: float
    """Length of both, s, which is the rise time of a step that does not reach 90 % within it."""

    @property
    def figures(self) -> dict[str, Figure]:
        """Figures of a fact (coded finding): times to 63 % and from 10 to 90 %, with their intervals, now first.

        The loop may reach 63 % almost as soon as before and then take much longer to 90 %, so both are stated. By which
        factor a time grows is stated only if its intervals do not overlap (``is_factor_sure``, ``is_rise_factor_sure``)
        and the step reaches 90 % with the new gains.
        """
        response_now, response_new = self.now.response_time, self.new.response_time
        rise_now, rise_new = self.now.rise_time, self.new.rise_time
        return {
            "response_times": (response_now.value, response_new.value),
            "response_time_intervals": (response_now.interval, response_new.interval),
            "is_factor_sure": response_now.high < response_new.low,
            "rise_times": (rise_now.value, rise_new.value),
            "rise_time_intervals": (rise_now.interval, rise_new.interval),
            "is_rise_factor_sure": rise_now.high < rise_new.low,
            "duration": self.duration,
        }


def _slower_response(advice: Advice, loop_name: str) -> _SlowerResponse | None:
    """Returns the predicted steps of a loop now and with new gains, if these make it slower.

    It is slower if the step reaches 63 % later, or surely rises longer from 10 to 90 %.

    Args:
        advice: advice on the gains of an axis.
        loop_name: "rate" or "attitude".

    Returns:
        Both steps. None if no gains change, if a step cannot be predicted or does not reach 63 %, or if both times grow
        by less than ``MIN_GAIN_CHANGE``, a factor within what batteries and weather do to a loop.
    """
    if not advice.parameters:
        return None
    duration = STEP_SECONDS[loop_name]
    step_now = predicted_step(advice.before.open_loop(loop_name), duration)
    new_step = predicted_step(advice.after.open_loop(loop_name), duration)
    if step_now is None or new_step is None:
        return None
    if new_step.response_time.value >= duration:
        return None
    reaches_63_percent_later = (
        new_step.response_time.value >= MIN_GAIN_CHANGE * step_now.response_time.value
    )
    # The last tenth may take long by chance, so that the time to 90 % counts only beyond its interval.
    rises_longer = (
        new_step.rise_time.value >= MIN_GAIN_CHANGE * step_now.rise_time.value
        and new_step.rise_time.low > step_now.rise_time.high
    )
    if not (reaches_63_percent_later or rises_longer):
        return None
    return _SlowerResponse(step_now, new_step, duration)


def _facts_on_new_gains(tuning: Tuning, axis: str) -> list[Fact]:
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
    advice_on_gains = _advice_on_gains(tuning, advice)
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
    slower_loops = [*_facts_on_slower_rate(advice), *_facts_on_slower_attitude(advice)]
    return [advice_on_gains, *reasons, *slower_loops]


def _axes_with_same_conclusion(tuning: Tuning) -> list[list[str]]:
    """Returns the groups of two or more axes whose gains a report describes in the same words, such as that they stay.

    Roll and pitch of a symmetric vehicle mostly differ in their margins, and not in what is advised.

    Args:
        tuning: advice on the gains of each axis with an identified loop; for other axes a fact (coded finding) that
            says why there is no loop.
    """
    axes_with_loop = [axis for axis, advice in tuning.axes.items() if isinstance(advice, Advice)]

    def text_on_gains(axis: str) -> str:
        """Returns the sentences on the gains of an axis."""
        facts = _facts_on_new_gains(tuning, axis)
        return " ".join(fact.sentence_and_remedy for fact in facts)

    groups = group_by(axes_with_loop, text_on_gains)
    return [axes for axes in groups.values() if len(axes) > 1]


def _advice_on_gains(tuning: Tuning, advice: Advice) -> Fact:
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


def _faults_in_flight(
    tuning: Tuning, axes: Iterable[str], report: str, headline_above: str
) -> list[Sentence]:
    """Returns what is wrong with axes whose loops are not known, such as that they swing, and what to do about it.

    What stands in the report on these axes, in the headline, or in what to do by the summary is not repeated.

    Args:
        tuning: the judgement of the flight, with its next step and a decision on the loops of each axis.
        axes: axes that the report names together; none of their loops is known.
        report: text on these axes, which the sentences will follow.
        headline_above: headline that stands above the report; empty without one.
    """
    faults = {}
    for axis in axes:
        decision = tuning.judgement.loop_decisions.get(axis)
        if decision is not None and decision.reason.is_watch_or_bad:
            faults[axis] = decision
    texts_elsewhere = [headline_above, report, *_texts_in_next_step(tuning)]
    for steps in _ground_steps_by_axis(tuning).values():
        texts_elsewhere += steps
    return decision_sentences(faults, texts_elsewhere, lead_end=" in flight:")


def _remedies_besides_tuning(tuning: Tuning, axis: str) -> list[str]:
    """Returns what to do about the control loops of an axis besides changing gains, such as to fly doublets.

    The report of ``mavdem tune`` has its advice on gains in other sentences, and need not advise to run this command.

    Args:
        tuning: the advice on each axis, or the fact that its loop is not known; and the decision on its loops.
        axis: "roll", "pitch" or "yaw".

    Returns:
        A list with one sentence; empty if there is nothing else to do, or if the report says it in another place.
    """
    decision = tuning.judgement.loop_decisions.get(axis)
    if decision is None or decision.action is None:
        return []
    if decision.action.code in (*ADVICE_TO_TUNE, LoopAction.FLY_BEFORE_GAINS):
        return []
    is_loop_unknown = isinstance(tuning.axes[axis], Fact)
    if is_loop_unknown and decision.reason.is_watch_or_bad:
        # The remedy of a fault, such as that the axis swings, does not make the loop known. So it does not stand with
        # what leads to new gains, but in a sentence on the fault.
        return []
    conclusion = _conclusion_on_gains(tuning.axes[axis])
    if decision.action.code is LoopAction.FLY_DOUBLETS and conclusion.advises_only_flight:
        # One flight is enough: the reason why no gains are advised names it already.
        return []
    if _next_step_has_priority(tuning, decision.action):
        return []
    if axis in tuning.axes_to_fly_for_gains and is_removed_by_flight(decision.action):
        return []
    return [decision.action.sentence_and_remedy]


def _conclusion_on_gains(advice: Advice | Fact) -> Fact:
    """Returns the fact (coded finding) that sums up the advice on an axis: what to do with its gains, or why no loop.

    Args:
        advice: advice on the gains of the axis, or the fact that says why its loop is not known.
    """
    return advice if isinstance(advice, Fact) else advice.conclusion


def _rating_unless_contradicted(advice: Advice, decision: LoopDecision | None) -> list[Fact]:
    """Returns the rating of an axis' stability margins, such that it does not contradict the decision on the axis.

    The rating says only whether the margins are large enough. The decision also knows whether the axis oscillates, and
    whether it follows its setpoint in flight. A report with both must not call an axis good and bad.

    Args:
        advice: advice on the gains of the axis, with the rating of the margins of its identified loop.
        decision: decision on the loops of the axis; None if there is none.

    Returns:
        A list with the rating. If the axis does not follow its setpoint, the rating is "watch" at best, and its
        sentence says that the margins are not enough. The list is empty if the loop cannot be relied on, so that no
        gains are advised, and the decision was made for another reason than the margins.
    """
    rating = advice.rating
    if decision is None:
        return [rating]
    is_decided_by_margins = decision.reason.code is MarginsLight.LOOP_MARGINS
    if advice.refusals and not is_decided_by_margins:
        return []
    if decision.diagnosis is LoopDiagnosis.FOLLOWS_BADLY:
        level = Level.BAD if rating.is_bad else Level.WATCH
        # The figure ``follows`` = False adds to the sentence "but the axis does not follow its setpoint".
        return [rating.replace(level, follows=False)]
    return [rating]


def decision_sentences(
    decisions: DecisionsByAxis, texts_elsewhere: Collection[str] = (), lead_end: str = ":"
) -> list[Sentence]:
    """Returns the decisions on control loops in sentences: for each axis what is wrong, and what to do.

    Axes with the same reason and action share a sentence. If several axes need the same action for different reasons,
    each reason has a sentence, and the action follows once in a sentence of its own.

    Args:
        decisions: decision on the loops by axis.
        texts_elsewhere: other texts of the page, such as its next step; reasons and actions in them are not repeated.
        lead_end: what follows the names of the axes at the beginning of each sentence.
    """

    def lead(axes: Collection[str]) -> str:
        """Returns the beginning of a sentence on some axes, such as "Roll and pitch:"."""
        return f"{listed(axes).capitalize()}{lead_end}"

    axes_by_action = group_by(
        decisions, lambda axis: _unless_in(texts_elsewhere, decisions[axis].fact.remedy)
    )
    sentences = []
    for action, axes in axes_by_action.items():
        axes_by_reason = group_by(
            axes, lambda axis: _unless_in(texts_elsewhere, str(decisions[axis].reason))
        )
        if len(axes_by_reason) == 1:
            # A single reason and its action make one sentence.
            (reason,) = axes_by_reason
            sentences.append(Sentence(f"{reason} {action}".strip(), lead(axes)))
            continue
        for reason, axes_of_reason in axes_by_reason.items():
            sentences.append(Sentence(reason, lead(axes_of_reason)))
        sentences.append(Sentence(action, lead(axes)))
    return [sentence for sentence in sentences if sentence.text]


def _unless_in(texts: Collection[str], sentence: str) -> str:
    """Returns a sentence unless it would be read twice: an empty text if one of the other texts contains it.

    Args:
        texts: other texts of the page, such as the headline and the next step.
        sentence: the sentence.
    """
    is_contained = any(sentence in text for text in texts)
    return "" if is_contained else sentence


def _texts_in_next_step(tuning: Tuning) -> set[str]:
    """Returns the texts that the report of a tuning leaves out, since its next step states them.

    The next step follows from other facts (coded findings), such as low margins on roll: they are its figures "reason"
    and "also". It states what to do about them, which is their remedy.

    Args:
        tuning: advice on the gains of each axis, and the judgement of the flight with the next step.

    Returns:
        The sentence of the next step and the remedies of its reasons. The empty text is among them, as the remedy of a
        fact that has none, so that the report leaves that out, too.
    """
    next_step = tuning.judgement.next_step
    texts = {"", next_step.sentence}
    main_reason = next_step.figures.get("reason")
    further_reasons = next_step.figures.get("also", ())
    for reason in (main_reason, *further_reasons):
        if reason is not None:
            texts.add(reason.remedy)
    if next_step.code is NextStep.KEEP_OR_CONFIRM_GAINS:
        texts |= {_advice_on_gains(tuning, advice).remedy for advice in tuning.advice}
    # Gains that can wait until other axes are tuned are not to be loaded now.
    if next_step.code in (NextStep.LOAD_GAINS, NextStep.TUNE_OTHER_AXES):
        for advice in tuning.advice:
            if advice.parameters and advice.is_sound and not tuning.waits(advice):
                texts.add(_advice_on_gains(tuning, advice).remedy)
    for axis, decision in tuning.judgement.loop_decisions.items():
        # The gains to lower are among those to load, or are joined to those of another axis.
        is_lowered_now = next_step.code is NextStep.LOAD_GAINS and tuning.lowers_gains_of(axis)
        if is_lowered_now or axis in _axes_of_joined_reduction(next_step):
            texts.add(decision.fact.remedy)
        # One flight with doublets serves all axes.
        flies_doublets = (
            decision.action is not None and decision.action.code is LoopAction.FLY_DOUBLETS
        )
        is_flown_next = main_reason is not None and main_reason.advises_only_flight
        is_step_with_doublets = is_flown_next or next_step.code in STEPS_WITH_DOUBLETS
        if flies_doublets and (is_step_with_doublets or axis in tuning.axes_to_fly_for_gains):
            texts.add(decision.fact.remedy)
    return texts


def _axes_of_joined_reduction(next_step: Fact) -> Names:
    """Returns the axes whose gains a next step lowers together; empty if it lowers those of one axis, or none."""
    reason = next_step.figures.get("reason")
    action = reason.figures.get("action") if isinstance(reason, Fact) else None
    if isinstance(action, Fact) and action.code in REDUCTIONS_OF_RATE_GAINS:
        return action.figures.get("names", ())
    return ()


class _SharedCaution(NamedTuple):
    """A sentence on how far the margins and advised gains of some axes can be trusted."""

    axes: tuple[str, ...]
    """The axes that it is about."""

    sentence: Sentence

    is_about_gains_to_set: bool
    """Whether it limits the gains that are computed from the loop (:func:`is_about_gains_to_set`)."""


def is_about_loops(fact: Fact, judgement: Judgement) -> bool:
    """Returns whether a headline or a next step is about the control loops, and not about something else in the flight.

    Args:
        fact: headline or next step, a coded finding with figures.
        judgement: the judgement of the vehicle, with a status light (a judgement with a level) for each of its subjects
            such as tracking.
    """
    # A next step has a figure "reason", the finding that it follows from. A headline is its own reason.
    reason = fact.figures.get("reason") or fact
    # A loss of the vehicle or an impact is not about the loops, though it may also be the judgement of the tracking.
    is_loss_or_impact = reason.code in LIGHT_OF_EVENT
    if is_loss_or_impact:
        return False
    is_step_on_gains = fact.code in (
        NextStep.LOAD_GAINS,
        NextStep.FLY_BEFORE_GAINS,
        NextStep.FLY_FOR_GAINS,
        NextStep.KEEP_OR_CONFIRM_GAINS,
        NextStep.TUNE_OTHER_AXES,
    )
    # A finding on margins whose model a measured response contradicts has that as its figure "reason".
    is_finding_on_loops = isinstance(reason.code, GainFact | LoopFact) or isinstance(
        fact.code, MarginsLight
    )
    lights_on_loops = (judgement.lights[Light.TRACKING], judgement.lights[Light.MARGINS])
    return is_step_on_gains or is_finding_on_loops or reason in lights_on_loops


def tuning_result(tuning: Tuning) -> Fact:
    """Returns the most important result of a tuning, with which the report of ``mavdem tune`` begins.

    It is a fact (a coded finding), the first of these that applies:

    1. The headline of the flight's judgement, if it is bad or about control loops; with all axes that lack the same
       margin.
    2. That there is room for higher gains on axes whose margins are good, and for which other gains are advised.
    3. The worst rating of margins, if each axis has a rating that no measurement contradicts.
    4. The headline of the judgement, whatever it says.

    Args:
        tuning: advice for each axis, with the judgement of the flight.
    """
    flight_headline = _headline_by_decision(tuning.judgement)
    if flight_headline.is_bad or is_about_loops(flight_headline, tuning.judgement):
        result = _headline_on_all_axes(flight_headline, tuning.judgement.loop_decisions)
        return _headline_with_thrust_reserve(result, tuning)
    advice_with_room = _advice_with_room_for_gains(tuning)
    if advice_with_room:
        slower_axes = []
        for axis, advice in advice_with_room.items():
            if _facts_on_slower_attitude(advice):
                slower_axes.append(axis)
        return Fact(GainFact.ROOM_FOR_GAINS, names=[*advice_with_room], slower_axes=slower_axes)
    return _worst_rating(tuning) or flight_headline


def _headline_by_decision(judgement: Judgement) -> Fact:
    """Returns the headline of a flight or, where it is about margins by a model, the resonance that was measured.

    Where a resonance decides what to do about an axis, the model that the margins come from is doubtful.

    Args:
        judgement: the judgement of the flight, with the decision on the loops of each axis.

    Returns:
        The reason of the decision on the same axis, such as a resonance, with its action; the headline itself if it
        is about something else, or if no measurement decided on the axis.
    """
    flight_headline = judgement.headline
    if flight_headline.code is not MarginsLight.LOOP_MARGINS:
        return flight_headline
    decision = judgement.loop_decisions.get(flight_headline.figures["axis"])
    if decision is None or decision.reason.code is not MarginsLight.RESONATES:
        return flight_headline
    return decision.reason.replace(action=decision.action)


def _headline_on_all_axes(flight_headline: Fact, decisions: DecisionsByAxis) -> Fact:
    """Extends a headline on a too small margin of one axis to all axes on which the same margin is too small.

    The headline of a flight names only the axis with the smallest margin, such as roll. If pitch lacks the same margin,
    a pilot who reads of roll alone would take pitch for sound.

    Args:
        flight_headline: the headline of a flight, a coded finding.
        decisions: decision on the loops by axis, each with the fact on its margins as the reason.

    Returns:
        The headline with the facts on the other axes as its figure ``alike``; unchanged if there are none, or if it is
        about something else.
    """
    if flight_headline.code is MarginsLight.RESONATES:
        return _resonance_on_all_axes(flight_headline, decisions)
    missed_goal = _missed_goal(flight_headline)
    if missed_goal is None:
        return flight_headline
    facts_on_other_axes = []
    for axis, decision in decisions.items():
        is_other_axis = axis != flight_headline.figures["axis"]
        if is_other_axis and _missed_goal(decision.reason) == missed_goal:
            facts_on_other_axes.append(decision.reason)
    if not facts_on_other_axes:
        return flight_headline
    return flight_headline.replace(alike=tuple(facts_on_other_axes))


def states_max_sensitivity(result: Fact) -> bool:
    """Returns whether a result of a tuning is about the maximum sensitivity Ms, and not about another margin.

    Args:
        result: a fact (a coded finding). One on a measured resonance has the interval of Ms as a figure; one on an
            identified loop also has the name of the margin that is ``lacking``.
    """
    return "ms_interval" in result.figures and result.figures.get("lacking", "ms") == "ms"


def _resonance_on_all_axes(resonance: Fact, decisions: DecisionsByAxis) -> Fact:
    """Extends a headline on the measured resonance of one axis to other axes whose rate loops lack margin.

    Args:
        resonance: the headline, a coded finding.
        decisions: decision on the loops by axis, with the fact that it was made by as the reason.

    Returns:
        The headline with the facts on the margins of the other axes as its figure ``alike``.
    """
    facts_on_other_axes = []
    for axis, decision in decisions.items():
        lacks_margin = decision.diagnosis is LoopDiagnosis.BELOW_GOAL
        is_of_rate = decision.reason.subject != "attitude"
        if axis != resonance.figures["axis"] and lacks_margin and is_of_rate:
            facts_on_other_axes.append(decision.reason)
    return resonance.replace(alike=tuple(facts_on_other_axes))


def _headline_with_thrust_reserve(result: Fact, tuning: Tuning) -> Fact:
    """Extends a headline that the margins reach their goal if they probably miss it with more or less thrust.

    Args:
        result: the headline, a coded finding.
        tuning: advice on the gains of each axis.

    Returns:
        The headline with the smallest share of models that reach the goal at all thrusts as its figure
        ``share_at_all_thrusts``; unchanged if most models do, or if it is no headline on a goal that is met.
    """
    is_goal_met = result.code is MarginsLight.LOOP_MARGINS and not result.figures["reason"]
    if not is_goal_met or result.figures["rating"] == Level.BAD:
        return result
    shares = [advice.sure for advice in tuning.advice if not advice.parameters]
    smallest_share = min(shares, default=1.0)
    if smallest_share >= 1 / 2:
        return result
    return result.replace(share_at_all_thrusts=smallest_share)


class _MissedGoal(NamedTuple):
    """Which goal the margins of an identified loop miss, and how badly; the same for axes that share a sentence."""

    loop_name: str
    """"rate" or "attitude"."""
    margin_name: str
    """The margin that is too small: "phase_margin" or "gain_margin"; or "ms", the maximum sensitivity, if too large."""
    level: Level
    """How bad that is for the vehicle."""
    rating: Level
    """Whether the goal of the margins is probably missed (bad), or may be missed (watch)."""


def _missed_goal(fact: Fact) -> _MissedGoal | None:
    """Returns which goal the margins of a loop miss by a fact, such as the phase margin of the rate loop.

    Args:
        fact: a coded finding, such as the headline of a flight.

    Returns:
        The goal; None if the fact is about something else, if the margins are sufficient, and if a measured response
        contradicts the loop, so that its margins are in doubt.
    """
    if fact.code is not MarginsLight.LOOP_MARGINS or not fact.is_watch_or_bad:
        return None
    contradiction = fact.figures["reason"]
    if contradiction is not None:
        return None
    return _MissedGoal(
        loop_name=fact.subject,
        margin_name=fact.figures["lacking"],
        level=fact.level,
        rating=fact.figures["rating"],
    )


def _advice_with_room_for_gains(tuning: Tuning) -> dict[str, Advice]:
    """Selects the axes whose gains can be higher: their margins are good, and other gains are advised for them.

    Axes are left out whose margins a measurement contradicts.

    Args:
        tuning: advice for each axis, with the decisions on their loops.

    Returns:
        The advice on these axes, by their names.
    """
    advice_with_room = {}
    for axis, advice in tuning.axes.items():
        is_doubtful = axis in tuning.doubtful_axes
        if isinstance(advice, Fact) or is_doubtful:
            continue
        ratings = _rating_unless_contradicted(advice, tuning.judgement.loop_decisions.get(axis))
        has_good_margins = all(rating.is_good for rating in ratings)
        if advice.conclusion.code is GainFact.SET_GAINS and has_good_margins:
            advice_with_room[axis] = advice
    return advice_with_room


def _worst_rating(tuning: Tuning) -> Fact | None:
    """Returns the worst rating of the stability margins of all axes; of equal ones the first.

    Args:
        tuning: advice for each axis, with the decisions on their loops.

    Returns:
        The rating, with the axis in its subject; None if the margins of an axis are not known. They are unknown if no
        loop was identified, if the loop is too unreliable for advice on gains, or if a measured response contradicts
        it.
    """
    ratings = []
    for axis, advice in tuning.axes.items():
        if isinstance(advice, Fact) or _has_doubtful_margins(tuning, axis):
            return None
        decision = tuning.judgement.loop_decisions.get(axis)
        for rating in _rating_unless_contradicted(advice, decision):
            ratings.append(rating.replace(subject=f"{axis} {rating.subject}"))
    for level in (Level.BAD, Level.WATCH, Level.UNKNOWN, Level.GOOD):
        for rating in ratings:
            if rating.level is level:
                return rating
    return None


def loop_cautions(advice_by_axis: AdviceByAxis) -> Blocks:
    """Returns the cautions on how far the stability margins and the advised gains of each axis can be trusted.

    They are about the identified loops, from which both follow. Axes with the same caution share a sentence.

    Args:
        advice_by_axis: advice by axis, or the fact (coded finding) that says why there is none, for which no caution is
            returned.
    """
    return [caution.sentence for caution in _shared_cautions(advice_by_axis)]


def _shared_cautions(advice_by_axis: AdviceByAxis) -> list[_SharedCaution]:
    """Returns sentences on how far the margins of identified loops, and gains computed from them, can be trusted.

    Such a caution may hold for several axes. If their texts differ by the name of the axis only, and so agree in all
    figures as printed, one sentence names these axes.

    Args:
        advice_by_axis: advice for each axis, or the fact (coded finding) that says why there is none.

    Returns:
        The sentences with their axes, in the order of the first axis.
    """
    cautions_by_text: dict[str, list[tuple[str, Fact]]] = {}
    for axis, advice in advice_by_axis.items():
        if isinstance(advice, Fact):
            continue
        for caution in advice.before.cautions:
            text_without_axis = caution.replace(axis="").sentence_and_remedy
            cautions_by_text.setdefault(text_without_axis, []).append((axis, caution))
    shared_cautions = []
    for axes_and_cautions in cautions_by_text.values():
        # Cautions with the same text make one sentence, which names all their axes.
        (sentence,) = sentences_by_axes(axes_and_cautions, attrgetter("sentence_and_remedy"))
        axes = tuple(axis for axis, _ in axes_and_cautions)
        _, first_caution = axes_and_cautions[0]
        is_about_gains = is_about_gains_to_set(first_caution)
        shared_cautions.append(_SharedCaution(axes, sentence, is_about_gains))
    return shared_cautions


def is_about_gains_to_set(caution_of_loop: Fact) -> bool:
    """Returns whether a caution about an identified loop also holds for the gains that are computed from the loop.

    All do but one: that an AutoTune flight left these gains says something about the present gains only.

    Args:
        caution_of_loop: one of the loop's cautions.
    """
    return caution_of_loop.code is not LoopFact.AUTOTUNED


def compared_loops(advice: Advice) -> dict[str, Loop]:
    """Returns the loop of one axis with the gains that flew ("now") and, if gains change, with the new ones ("new").

    The new gains are advised or, if another flight is to confirm them first, only tried.

    Args:
        advice: advice on the axis, with both loops.
    """
    loops = {"now": advice.before}
    if advice.parameters:
        loops["new"] = advice.after
    return loops


def _gains_header(gains: str, advice: Advice, *, waits_for_stage_1: bool) -> str:
    """Returns the header of a column of a table of loops: with which gains of the axis its figures were computed.

    Args:
        gains: "now" for the gains that flew, "new" for those that are computed from the identified loop.
        advice: advice on the axis, with the new gains.
        waits_for_stage_1: whether the new gains are a second stage, to be loaded only after a flight with the gains of
            the first one.

    Returns:
        "now" or, for new gains, "advised", "advised, stage 2", or ``TRIED_HEADER`` if another flight is to confirm them
        before they are loaded.
    """
    if gains == "now":
        return "now"
    # Gains are sound if this flight is a sufficient basis for them.
    if not advice.is_sound:
        return TRIED_HEADER
    if waits_for_stage_1:
        return f"advised, stage {advice.stage:d}"
    return "advised"


def tuned_loops_table(tuning: Tuning, axes_with_feedforward: Collection[str]) -> list[Table]:
    """Returns a table of the loops of all axes: margins, predicted step responses, and errors of the angle by wind.

    Args:
        tuning: advice for each axis, or the fact (coded finding) that says why there is none.
        axes_with_feedforward: axes whose charts show attitude steps with feed-forward; the table's are without it.

    Returns:
        A list with the table, which has a column for the present gains of each axis and, if they change, one for its
        new gains; empty if no loop is identified.
    """
    loops, doubtful_headers = _loop_columns(tuning)
    if not loops:
        return []
    rows = []
    for loop_name in LOOP_NAMES:
        rows += _margin_rows(loops, loop_name)
        rows += _step_rows(loops, loop_name, axes_with_feedforward)
    if tuning.has_computed_gains:
        # The standard deviation of the angle in the wind of the flight, degrees.
        wind_errors = [rounded(loop.lean_in_wind) for loop in loops.values()]
        rows.append(["error by wind torque, sd (°)", *wind_errors])
    table = Table(["90 % interval", *_marked_headers(loops, doubtful_headers)], rows)
    narrow_tables = _tables_by_axis(table, [*loops])
    # The summary above has the margins that decide, so that a phone shows all of them only on demand.
    return [table._replace(phone_tables=narrow_tables, phone_title=PHONE_TITLE_OF_MARGINS)]


def _tables_by_axis(table: Table, headers: Iterable[str]) -> list[Table]:
    """Divides a table of the loops of several axes into one for each axis, since a phone has room for few columns.

    Args:
        table: the table, whose columns behind the first one are of one axis each.
        headers: headers of these columns without marks, such as "roll, now".

    Returns:
        The tables, one for each axis in the order of their columns.
    """
    columns_by_axis: dict[str, list[int]] = {}
    for column, header in enumerate(headers, start=1):
        axis, _, _ = header.partition(", ")
        columns_by_axis.setdefault(axis, []).append(column)
    tables = []
    for columns in columns_by_axis.values():
        rows = [[row[column] for column in (0, *columns)] for row in table.rows]
        tables.append(Table([table.header[column] for column in (0, *columns)], rows))
    return tables


class _ComparedLoops(NamedTuple):
    """The loops of several axes as the columns of a table that compares them."""

    by_header: dict[str, Loop]
    """The loops by the header of their column, such as "roll, now"."""
    doubtful_headers: set[str]
    """Headers of those whose margins may be wrong."""


def _loop_columns(tuning: Tuning) -> _ComparedLoops:
    """Returns the columns of a table of control loops, such as "roll, now" and, if gains change, one with new gains.

    Args:
        tuning: advice on the gains of each axis; an axis without an identified loop gets no column.
    """
    compared = _ComparedLoops(by_header={}, doubtful_headers=set())
    for axis, advice in tuning.axes.items():
        if isinstance(advice, Fact):
            continue
        for gains, loop in compared_loops(advice).items():
            gains_header = _gains_header(gains, advice, waits_for_stage_1=tuning.waits(advice))
            header = f"{axis}, {gains_header}"
            compared.by_header[header] = loop
            if _has_doubtful_margins(tuning, axis):
                compared.doubtful_headers.add(header)
    return compared


def _margin_rows(loops: Mapping[str, Loop], loop_name: str) -> list[list[str]]:
    """Returns table rows with the stability margins and the crossover of a control loop, each with its interval.

    Args:
        loops: the identified loops of an axis, by header of the table's column: with the present gains and, if gains
            change, with the new ones.
        loop_name: which loop of the axis the rows are about, "rate" or "attitude".

    Returns:
        A row for each figure, such as the phase margin: its name, and then its value in each column.
    """
    rows = []
    for figure_name in TUNED_FIGURES:
        figure = LOOP_FIGURES[figure_name]
        row = [f"{loop_name}: {figure.header}"]
        for loop in loops.values():
            row.append(_figure_text(loop, loop_name, figure_name))
        rows.append(row)
    return rows


def _has_doubtful_margins(tuning: Tuning, axis: str) -> bool:
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
    is_contradicted = axis in tuning.doubtful_axes
    decision = tuning.judgement.loop_decisions.get(axis)
    repairs = () if decision is None else decision.repairs
    reasons_on_loop = [reason for reason in advice.refusals if reason not in repairs]
    return is_contradicted or bool(reasons_on_loop)


def _step_rows(
    loops: Mapping[str, Loop], loop_name: str, axes_with_feedforward: Collection[str]
) -> list[list[str]]:
    """Returns the rows of a table with overshoot and rise time of a loop's predicted step responses.

    Args:
        loops: loops with the present and, if gains change, with the new gains, which have a cell each.
        loop_name: "rate" or "attitude".
        axes_with_feedforward: axes whose charts of the attitude have feed-forward of its setpoint, with which a step
            rises faster and overshoots. The rows say that their steps are without it.
    """
    condition = " of a step"
    remark_on_charts = ""
    if loop_name == "attitude":
        condition = " of a step without feed-forward"
        if axes_with_feedforward:
            remark_on_charts = f"; the chart of {listed(axes_with_feedforward)} has it"
    overshoot_row = [f"{loop_name}: overshoot{condition} (%{remark_on_charts})"]
    rise_time_row = [f"{loop_name}: 10 to 90 %{condition} (ms{remark_on_charts})"]
    for loop in loops.values():
        overshoot, rise_time = _step_texts(loop.open_loop(loop_name), STEP_SECONDS[loop_name])
        overshoot_row.append(overshoot)
        rise_time_row.append(rise_time)
    return [overshoot_row, rise_time_row]


def _step_texts(loop: OpenLoop, duration: float) -> tuple[str, str]:
    """Returns overshoot, %, and rise time, ms, of a loop's predicted step response, such as ("12 (8 to 17)", "45").

    Args:
        loop: rate or attitude loop, whose closed loop is computed.
        duration: length of the step response, s.

    Returns:
        Both as text, with their 90 % intervals unless these are narrower than the last digit; empty if the step cannot
        be predicted.
    """
    step = predicted_step(loop, duration)
    if step is None:
        return ("", "")
    overshoot, rise_time = step.overshoot, step.rise_time
    return (
        _text_with_interval(overshoot.value, overshoot.interval, scale=100),
        _rise_time_text(rise_time, duration),
    )


def _rise_time_text(rise_time: IntervalEstimate, duration: float) -> str:
    """Returns a rise time with its 90 % interval in ms, such as "87 (63 to 140)".

    Args:
        rise_time: the rise time, s; the duration where the step does not reach 90 %.
        duration: length of the step response, s.

    Returns:
        The text. A step that does not rise within its length has "> 500", and "87 (63 to > 500)" if that is so in more
        than 5 % of the vehicle models.
    """
    limit = f"> {1e3 * duration:.0f}"
    if rise_time.value >= duration:
        return limit
    if rise_time.high >= duration:
        return f"{rounded(1e3 * rise_time.value)} ({rounded(1e3 * rise_time.low)} to {limit})"
    return _text_with_interval(rise_time.value, rise_time.interval, scale=1e3)


def _axis_details(advice: Advice, *, is_doubtful: bool) -> Blocks:
    """Returns the details of a tuning on one axis: sentences on its gains, tables of its margins, what both rest on.

    The tables compare the loops as flown with those with the advised gains. The last sentences are about the filters of
    the gyro, and about how well the identified loop predicts the measured response of the rate.

    Args:
        advice: advice on the axis, with its loops.
        is_doubtful: whether a measured response contradicts the identified loop, and so all its margins.
    """
    # The loops as flown and with the advised gains, by the header of their column in the tables.
    loops = compared_loops(advice)
    # Both loops come from the same identified model, so that either all of them are doubtful or none.
    doubtful_loops: Container[str] = ()
    if is_doubtful:
        doubtful_loops = loops
    blocks: Blocks = list(_gain_sentences(advice))
    blocks += margin_tables(loops, doubtful_loops)
    blocks += _basis_sentences(advice.before, is_doubtful=is_doubtful)
    return blocks


def _basis_sentences(loop: Loop, *, is_doubtful: bool) -> list[Sentence]:
    """Returns sentences on the gyro's filters of a loop, and on how well its prediction fits the measured response.

    Args:
        loop: the loop of an axis as it flew. It may have been compared with a measured step response.
        is_doubtful: whether any measured response contradicts it.
    """
    sentences = filter_sentences(loop)
    # Without a comparison the template says that no response was measured. That would be wrong if the loop is doubtful,
    # since a response of another kind was measured then.
    was_compared = loop.agrees is not None
    if was_compared or not is_doubtful:
        sentences += render_section("loop_measured", loop=loop)
    return sentences


def filter_sentences(loop: Loop) -> list[Sentence]:
    """Returns the sentence on the gyro's filters of a loop, their delay and phase lag; none without filters.

    Args:
        loop: a rate loop, with the filters of its controller. The phase lag is stated at its crossover frequency.
    """
    return render_section(
        "loop_filters",
        filters=gyro_filters(loop.controller, loop.crossover),
        delay=gyro_delay(loop.controller),
        crossover=loop.crossover,
    )


def margin_tables(
    loops: LoopsByAxis,
    doubtful_headers: Container[str] = (),
    omitted_figures: Container[str] = (),
) -> Iterator[Table]:
    """Yields a table of the stability margins of rate loops, then one of the attitude loops around them.

    Args:
        loops: the loops to compare, by the header of their column, such as "now" and "new".
        doubtful_headers: headers of the loops that a measured response contradicts; "(doubtful)" is added to them.
        omitted_figures: names of ``LOOP_FIGURES``, such as "phase_margin", that the reader finds elsewhere.

    Yields:
        A table with a row for each of the other ``LOOP_FIGURES`` and a column for each of ``loops``.
    """
    models = [loop.model for loop in loops.values()]
    headers = _marked_headers(loops, doubtful_headers)
    for loop_name in LOOP_NAMES:
        rows = [["model of the plant", *models]]
        for figure_name, figure in LOOP_FIGURES.items():
            if figure_name in omitted_figures:
                continue
            row = [figure.header]
            for loop in loops.values():
                row.append(_figure_text(loop, loop_name, figure_name))
            rows.append(row)
        yield Table([f"{loop_name} loop (90 % interval)", *headers], rows)


def _marked_headers(headers: Iterable[str], doubtful: Container[str]) -> list[str]:
    """Returns the headers of columns of loops, with "(doubtful)" after those of loops that may be wrong."""
    return [f"{header} (doubtful)" if header in doubtful else header for header in headers]


def _figure_text(loop: Loop, loop_name: str, figure_name: str) -> str:
    """Returns a figure of a control loop with its 90 % interval as text, such as "57 (50 to 63)".

    Args:
        loop: the identified loops of an axis, for the estimated plant and draws from its posterior.
        loop_name: "rate" or "attitude".
        figure_name: name of the figure in ``LOOP_FIGURES``, such as "phase_margin"; an open loop has its interval as
            "phase_margin_interval".
    """
    if not _has_figure(loop, loop_name, figure_name):
        return rounded(nan)
    open_loop = loop.open_loop(loop_name)
    interval = getattr(open_loop, f"{figure_name}_interval")
    scale = LOOP_FIGURES[figure_name].scale
    return _text_with_interval(getattr(open_loop, figure_name), interval, scale)


def _value_text(loop: Loop, loop_name: str, figure_name: str) -> str:
    """Returns a figure of a control loop as text without its interval, such as "57".

    Args:
        loop: the identified loops of an axis.
        loop_name: "rate" or "attitude".
        figure_name: name of the figure in ``LOOP_FIGURES``.
    """
    if not _has_figure(loop, loop_name, figure_name):
        return rounded(nan)
    return rounded(
        LOOP_FIGURES[figure_name].scale * getattr(loop.open_loop(loop_name), figure_name)
    )


def _has_figure(loop: Loop, loop_name: str, figure_name: str) -> bool:
    """Returns whether a figure of a control loop means anything; where it does not, its formula may give a good number.

    Figures of a steady response, such as Ms, need a stable loop. All figures of the attitude loop need one that is
    slower than the rate loop inside it: a rate loop close to an oscillation has a peak where the gain of the attitude
    loop falls to 1 once more, and the margins there are none of the attitude.

    Args:
        loop: the identified loops of an axis.
        loop_name: "rate" or "attitude".
        figure_name: name of the figure in ``LOOP_FIGURES``.
    """
    max_attitude_crossover = MAX_CROSSOVER_RATIO * loop.rate.crossover
    if loop_name == "attitude" and loop.attitude.crossover > max_attitude_crossover:
        return False
    return loop.open_loop(loop_name).is_stable or figure_name not in FIGURES_OF_STABLE_LOOPS


def _text_with_interval(value: float, interval: tuple[float, float], scale: float) -> str:
    """Returns a figure with its interval as text, such as "57 (50 to 63)".

    The interval is left out if one of its ends is NaN, or if it is narrower than the last digit that is shown.

    Args:
        value: the figure, in its own unit.
        interval: lower and upper end of its interval, in the same unit.
        scale: factor from that unit to the shown one.
    """
    text = rounded(scale * value)
    low = rounded(scale * interval[0])
    high = rounded(scale * interval[1])
    is_unknown = UNKNOWN_FIGURE in (low, high)
    if is_unknown or text == low == high:
        return text
    return f"{text} ({low} to {high})"


def gain_table(advice: Advice) -> list[Table]:
    """Returns a table of the controller gains to change on one axis.

    The table has a row for each changed gain: its value now, the value to set, and the factor between them.

    Args:
        advice: gains ``now`` and to ``set`` by name of the parameter, and the control loop before and after.

    Returns:
        A list with the table; empty if no gain changes.
    """
    rows = []
    for name, gain in advice.gains.items():
        row = gain_row(name, gain)
        _, text_now, text_to_set, _ = row
        # Two values that look equal in the table, which shows four digits, are no change to a reader.
        if text_now != text_to_set:
            rows.append(row)
    if not rows:
        return []
    return [Table(["gain", "now", "set", "times"], rows)]


def gain_row(name: str, gain: Gain) -> list[str]:
    """Returns the row of a gain: its name, value now, value to set, and the factor between them (1 for a gain of 0)."""
    factor = gain.set / gain.now if gain.now else 1.0
    # Gains are rounded to three digits: 0.2 is lowered to 0.133, by the same factor as all others.
    is_lowered_by_rule = round_gain(gain.set) == round_gain(GAIN_REDUCTION * gain.now)
    if gain.now and is_lowered_by_rule:
        factor = GAIN_REDUCTION
    return [name, f"{gain.now:.4g}", f"{gain.set:.4g}", f"{factor:.2f}"]


def axes_by_gain_sentence(
    advice_by_axis: Mapping[str, Advice], *, has_gains_above: bool
) -> dict[Sentence, list[str]]:
    """Returns sentences on what the advised gains are expected to do, each with the axes of which it is said.

    Args:
        advice_by_axis: gains by name of the parameter, and the control loop before and after, by axis.
        has_gains_above: whether the page has the gains and how to try them at its top, which is not repeated.
    """
    axes_by_sentence = dict[Sentence, list[str]]()
    for axis, advice in advice_by_axis.items():
        for sentence in _gain_sentences(advice, has_gains_above=has_gains_above):
            axes_by_sentence.setdefault(sentence, []).append(axis)
    return axes_by_sentence


def _gain_sentences(advice: Advice, *, has_gains_above: bool = False) -> list[Sentence]:
    """Returns sentences on what to expect of the advised gains of one axis, such as how far wind will tilt the vehicle.

    Further ones state what comes after this step if it does not reach the margins, unusual ratios of the gains, and how
    much noise of the gyro heats the motors. The template "loop_gains" makes them.

    Args:
        advice: the gains that flew and the advised ones, with the control loop that has each of them, and notes.
        has_gains_above: whether the page begins with the gains to load and how to try them. That includes to check the
            motors' temperature, which is then not repeated here.
    """
    # Notes on why the gains are not others are shown with the gains themselves.
    unusual_notes = [note for note in advice.notes if note.code not in REASONS_FOR_GAINS]
    return render_section(
        "loop_gains",
        advice=advice,
        unusual_notes=unusual_notes,
        largest_step=MAX_GAIN_STEP,
        has_gains_above=has_gains_above,
    )
