"""Chapters of a flight's page on its control loops: step responses, facts (coded findings) on margins, decisions."""

from collections.abc import Iterator, Mapping, Sequence
from math import inf
from typing import NamedTuple

from mavdem.assessment import Assessment
from mavdem.assessment.axis.loop_decision import DecisionsByAxis, LoopDiagnosis
from mavdem.assessment.axis.responses import NO_STEPS, Responses, StepsByLoop
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.noise_spectra import GYRO, MeasuredNoise
from mavdem.confidence import IntervalEstimate
from mavdem.containers import group_by
from mavdem.facts import Fact
from mavdem.facts.lights import Light
from mavdem.facts.loops import StepResponseFact
from mavdem.loops.advice import Advice, AdviceByAxis
from mavdem.loops.axis_loops import Loop
from mavdem.loops.step_response import StepResponse
from mavdem.report.blocks import Blocks, Sentence, Table, caution
from mavdem.report.charts.chart import Group
from mavdem.report.charts.flight_charts import loop_charts, spectrum_chart, step_charts
from mavdem.report.charts.gain_trial import gain_trial_groups
from mavdem.report.charts.step_overview import step_overview_charts
from mavdem.report.numbers import listed, rounded
from mavdem.report.pages.page import Chapter
from mavdem.report.templates import as_clause, sentences_by_axes
from mavdem.report.tuning.cautions import loop_cautions
from mavdem.report.tuning.decisions import decision_sentences
from mavdem.report.tuning.gains import axes_by_gain_sentence, gain_table
from mavdem.report.tuning.goal import sentences_on_goal, sentences_on_reached_goal
from mavdem.report.tuning.tables import compared_loops, margin_tables

TUNING_TITLE = "Tuning at a glance"
"""Title of the chapter with a row of pictures of the tuning."""


LOOP_CAPTION = "Open loops with 90 % bands. Vertical: where the gain is 1, with the phase margin."
"""What stands below the charts of the open loops."""


class StepFigure(NamedTuple):
    """A figure of a step response as a table shows it."""

    header: str
    """Header of its column, with the shown unit."""

    scale: float
    """Factor from the unit of the figure to the shown one."""

    is_duration: bool = False
    """Whether it is a time after the step, which may lie beyond the end of the measured response."""


STEP_FIGURES = {
    "overshoot": StepFigure("overshoot (%)", 100.0),
    "rise_time": StepFigure("rise (s)", 1.0, is_duration=True),
    "settling": StepFigure("settling (s)", 1.0, is_duration=True),
    "delay": StepFigure("delay (ms)", 1e3, is_duration=True),
    "peak": StepFigure("peak of |T|", 1.0),
    "peak_frequency": StepFigure("at (Hz)", 1.0),
}
"""Columns of the table of step responses, by the field of ``StepResponse``."""

PEAK_FIGURES = ("peak", "peak_frequency")
"""The columns about the largest gain."""


def tuning_chapter(responses: Responses, noise: MeasuredNoise) -> Chapter:
    """Returns the chapter that shows the tuning of a flight at a glance: one row of pictures.

    They are the measured step responses of rate and attitude, with a line for each axis, and the spectrum of the gyro.
    Bands, predictions and figures are in other chapters.

    Args:
        responses: by axis and loop, the measured response or the fact (coded finding) why there is none.
        noise: spectra of the sensors.

    Returns:
        The chapter; without content if no step response was measured.
    """
    step_charts = step_overview_charts(responses)
    if not step_charts:
        return Chapter(TUNING_TITLE)
    names = [*step_charts]
    charts = [*step_charts.values()]
    has_gyro_spectrum = f"{GYRO}_before" in noise.spectra or GYRO in noise.spectra
    if has_gyro_spectrum:
        names.append("gyro")
        charts.append(spectrum_chart(noise))
    columns = tuple((chart,) for chart in charts)
    groups = [Group(columns, names=tuple(names), is_flat=True)]
    return Chapter(TUNING_TITLE, groups=groups)


def responses_chapter(
    responses: Responses, advised_steps_by_loop: StepsByLoop = NO_STEPS, light: Fact | None = None
) -> Chapter:
    """Returns the chapter with a table and charts of the step responses, measured in flight and predicted by the model.

    A caution is added for each prediction that contradicts the measurement, and a sentence on the loops whose response
    could not be measured, with the reason.

    Args:
        responses: measured response, or the fact (coded finding) why there is none, and the prediction; by axis and
            loop.
        advised_steps_by_loop: predicted step responses with the advised gains, by axis and loop.
        light: judgement of the margins, whose axis is shown first on a phone; None if there is none.
    """
    blocks = Blocks()
    rows = _step_figure_rows(responses)
    if rows:
        headers = [figure.header for figure in STEP_FIGURES.values()]
        blocks.append(Table(["step response (90 % interval)", *headers], rows))
    for loops in responses.values():
        for response in loops.values():
            if response.contradiction is not None:
                blocks.append(caution(response.contradiction))
    blocks += sentences_without_response(responses)
    columns = step_charts(responses, advised_steps_by_loop)
    if not columns:
        return Chapter("Step response", blocks)
    caption = _responses_caption(responses, has_advised_steps=bool(advised_steps_by_loop))
    return Chapter("Step response", blocks, [Group.of_axes(columns, light, caption)])


def _step_figure_rows(responses: Responses) -> list[list[str]]:
    """Returns the rows of a table with the figures of each measured step response (``STEP_FIGURES``).

    Args:
        responses: by axis and loop, the measured response or the fact (coded finding) why there is none.
    """
    rows = []
    for axis, loops in responses.items():
        for loop_name, response in loops.items():
            step_response = response.measured
            if isinstance(step_response, StepResponse) and not step_response.is_doubtful:
                name = f"{axis} {loop_name}"
                if step_response.is_identified:
                    name += " (step: identified loop)"
                figures = [_step_figure_text(step_response, key) for key in STEP_FIGURES]
                rows.append([name, *figures])
    return rows


def sentences_without_response(responses: Responses) -> list[Sentence]:
    """Returns why steps could not be measured, or are doubtful; loops with the same reason share a sentence.

    Args:
        responses: by axis and loop, the measured response or the fact (coded finding) why there is none.
    """
    fact_by_loop = {}
    for axis, loops in responses.items():
        for loop_name, response in loops.items():
            measured = response.measured
            if isinstance(measured, Fact):
                fact_by_loop[f"{axis} {loop_name}"] = measured
            elif measured.is_doubtful:
                fact_by_loop[f"{axis} {loop_name}"] = measured.fact
    loops_by_reason = group_by(fact_by_loop, lambda loop: _reason_without_loop(fact_by_loop[loop]))
    sentences = []
    for loops_with_reason in loops_by_reason.values():
        fact = _common_reason([fact_by_loop[loop] for loop in loops_with_reason])
        sentences.append(Sentence(str(fact.replace(subject=listed(loops_with_reason)))))
    return sentences


def _reason_without_loop(fact: Fact) -> str:
    """Returns why the step of a loop is not known, as a text without the loop, which is equal for equal reasons.

    Args:
        fact: the reason, a coded finding whose subject is the loop, such as "roll rate".
    """
    if fact.code is StepResponseFact.STEP_UNCERTAIN:
        # Steps that are uncertain by different amounts have the same reason.
        return str(fact.code)
    return str(fact.replace(subject=""))


def _common_reason(facts: Sequence[Fact]) -> Fact:
    """Returns the fact that says for several loops why their steps are not known.

    Of uncertain steps it is the least uncertain one: all others are at least as uncertain.

    Args:
        facts: the reason for each loop, coded findings that differ only in the loop and in how uncertain its step is.
    """
    if len(facts) == 1 or facts[0].code is not StepResponseFact.STEP_UNCERTAIN:
        return facts[0]
    least_uncertain = min(facts, key=lambda fact: float(fact.figures["band_half_width"]))
    return least_uncertain.replace(is_least=True)


def _responses_caption(responses: Responses, *, has_advised_steps: bool) -> str:
    """Returns the caption of the charts of step responses: what their lines are, and remarks that apply.

    Args:
        responses: by axis and loop, the measured response or the fact (coded finding) why there is none.
        has_advised_steps: whether responses with advised gains are drawn.
    """
    caption = "Measured, with a 90 % band; where the loop is identified, also predicted."
    if _has_identified_step(responses):
        caption += " A rate that rises within few messages has the step of the identified loop, with its 90 % band; "
        caption += "its |T| is measured."
    if has_advised_steps:
        caption += " With the new gains a step is predicted."
    return caption + feedforward_remark(responses)


def _has_identified_step(responses: Responses) -> bool:
    """Returns whether a step is that of the identified loop, since messages were too slow to measure it.

    Args:
        responses: by axis and loop, the measured response or the fact (coded finding) why there is none.
    """
    for loops in responses.values():
        for response in loops.values():
            if isinstance(response.measured, StepResponse) and response.measured.is_identified:
                return True
    return False


def feedforward_remark(responses: Responses) -> str:
    """Returns a sentence, after a space, on the axes whose measured attitude has feed-forward of the setpoint's rate.

    With it a step of the attitude overshoots, since the step of the angle comes with a pulse of the rate.

    Args:
        responses: responses by axis and loop.

    Returns:
        The sentence; empty if there is no such axis.
    """
    axes = axes_with_feedforward(responses)
    if not axes:
        return ""
    return (
        f" Feed-forward: about {listed(axes)} the autopilot adds the slope of the angle's setpoint to the rate "
        "setpoint, so that a step of the attitude overshoots more than its margins suggest."
    )


def axes_with_feedforward(responses: Responses) -> list[str]:
    """Returns the axes whose chart of the attitude's step has feed-forward of the setpoint's rate.

    Args:
        responses: responses by axis and loop; a chart has feed-forward only if the response was measured.
    """
    axes = []
    for axis, loops in responses.items():
        attitude = loops.get("attitude")
        if attitude is None or not attitude.has_feedforward:
            continue
        if isinstance(attitude.measured, StepResponse):
            axes.append(axis)
    return axes


def _step_figure_text(response: StepResponse, key: str) -> str:
    """Returns a figure of a step response with its 90 % interval as text, such as "0.12 (0.10 to 0.15)".

    A duration, such as the settling time, cannot be measured beyond the end of the response. If it reaches that, it is
    shown as "over" the end. The interval is left out if even its lower end lies there, or if it is narrower than the
    last digit that is shown. A gain that never exceeds its value at 0 Hz has no peak.

    Args:
        response: response of rate or angle to its setpoint, measured in flight.
        key: key of ``STEP_FIGURES`` and attribute of ``response``.
    """
    estimate: IntervalEstimate = getattr(response, key)
    if key in PEAK_FIGURES and not response.has_peak:
        return "no peak" if key == "peak" else ""
    figure = STEP_FIGURES[key]
    end = float(response.time[-1]) if figure.is_duration else inf

    def text_of(value: float) -> str:
        """Returns a value in the shown unit; one that reaches the end of the response with "over" before it."""
        number = rounded(figure.scale * value)
        return f"over {number}" if value >= end else number

    value, low, high = estimate
    value_text, low_text, high_text = text_of(value), text_of(low), text_of(high)
    is_narrow = value_text == low_text == high_text
    if low >= end or is_narrow:
        return value_text
    return f"{value_text} ({low_text} to {high_text})"


def loops_chapters(
    assessment: Assessment,
    evidence: Evidence,
    advice: AdviceByAxis,
    *,
    has_gains_above: bool = False,
) -> Iterator[Chapter]:
    """Yields two chapters on control loops: the decision on each axis with charts, then margins and gains.

    Args:
        assessment: assessment of the log, with the decisions on the loops.
        evidence: identified loops of the axes, and their margins.
        advice: advised gains by axis, or the reason why there are none; empty without advice.
        has_gains_above: whether the top of the page has the table of advised gains and how to load them, so that the
            chapter has only how far they reach.
    """
    decisions = assessment.loop_decisions
    summary = decision_sentences(decisions, assessment.next_step.sentence)
    summary += _margin_sentences(evidence, decisions)
    loops = evidence.identified_loops
    if not loops:
        yield Chapter("Control loops", [*summary, *loop_cautions(advice)])
        return
    advice_with_gains = _advice_with_gains(advice)
    loops_by_axis: dict[str, dict[str, Loop]] = {}
    for axis, loop in loops.items():
        has_gains = axis in advice_with_gains
        loops_by_axis[axis] = (
            compared_loops(advice_with_gains[axis]) if has_gains else {"now": loop}
        )
    # Each axis has a column of charts, in which the loop now and the loop with advised gains are drawn together.
    columns = {axis: loop_charts(axis_loops) for axis, axis_loops in loops_by_axis.items()}
    group = Group.of_axes(columns, assessment.lights[Light.MARGINS], LOOP_CAPTION)
    yield Chapter("Control loops", summary, [group._replace(has_common_x=True)])
    figures: Blocks = [
        *margin_tables(_loops_by_header(loops_by_axis), evidence.axes_with_doubtful_loop)
    ]
    figures += _advised_gain_blocks(advice_with_gains, has_gains_above=has_gains_above)
    figures += loop_cautions(advice)
    groups = _twin_groups(assessment, evidence, advice)
    yield Chapter("Margins and new gains", figures, groups)


def _advice_with_gains(advice: AdviceByAxis) -> dict[str, Advice]:
    """Returns the advice on those axes that have gains; the decision on each other axis says why it has none.

    Args:
        advice: advised gains by axis, or the reason why there are none.
    """
    advice_with_gains = {}
    for axis, axis_advice in advice.items():
        if isinstance(axis_advice, Advice) and not axis_advice.refusals:
            advice_with_gains[axis] = axis_advice
    return advice_with_gains


def _loops_by_header(loops_by_axis: Mapping[str, Mapping[str, Loop]]) -> dict[str, Loop]:
    """Returns loops by the header of their column in a table: "roll" with the gains that flew, or "roll, new gains".

    Args:
        loops_by_axis: for each axis the loop "now" and, if its gains change, the "new" one.
    """
    loops_by_header = {}
    for axis, loops in loops_by_axis.items():
        loops_by_header[axis] = loops["now"]
        if "new" in loops:
            loops_by_header[f"{axis}, new gains"] = loops["new"]
    return loops_by_header


def _advised_gain_blocks(advice_by_axis: Mapping[str, Advice], *, has_gains_above: bool) -> Blocks:
    """Returns for each axis what to do with its gains, a table of those that change, and what to expect of them.

    Args:
        advice_by_axis: the advice on each axis that has gains.
        has_gains_above: whether the top of the page has the table and how to load the gains, which is not repeated.
    """
    blocks = Blocks()
    axes_by_sentence = axes_by_gain_sentence(advice_by_axis, has_gains_above=has_gains_above)
    if has_gains_above:
        blocks += _sentences_on_advised_gains(advice_by_axis)
    for axis, advice in advice_by_axis.items():
        if not has_gains_above:
            blocks.append(Sentence(advice.conclusion.sentence_and_remedy, f"Gains of {axis}:"))
            blocks += gain_table(advice)
        blocks += [sentence for sentence, axes in axes_by_sentence.items() if axes == [axis]]
    # A sentence that holds for several axes is said once, below the gains of all.
    for sentence, axes in axes_by_sentence.items():
        if len(axes) > 1:
            lead = f"{listed(axes).capitalize()}, {as_clause(sentence.lead)}"
            blocks.append(sentence._replace(lead=lead))
    return blocks


def _twin_groups(assessment: Assessment, evidence: Evidence, advice: AdviceByAxis) -> list[Group]:
    """Returns the charts of flights of the twin, a simulation of the vehicle, with present and with new gains.

    Args:
        assessment: assessment of the log, with the measured responses.
        evidence: identified loops of the axes.
        advice: advised gains by axis, or the reason why there are none; empty without advice.
    """
    flights_of_twin = assessment.gain_trial if advice else None
    # The page of a flight must be fast to make. That of `mavdem tune` also has the twin's hover in wind.
    groups_by_axis = gain_trial_groups(
        evidence, advice, assessment.responses, in_wind=False, trial=flights_of_twin
    )
    groups = list(groups_by_axis.values())
    # All axes have one caption, below the last.
    for index in range(len(groups) - 1):
        groups[index] = groups[index]._replace(caption="")
    return groups


def _sentences_on_advised_gains(advice_by_axis: Mapping[str, Advice]) -> list[Sentence]:
    """Returns what the advised gains reach, without their values and how to load them, which a page has at its top.

    Axes of which the same is to be said share a sentence, and the goal is stated once.

    Args:
        advice_by_axis: advice on the gains of each axis, which may be to keep them.
    """

    def conclusion_on_axis(axis: str) -> str:
        """Returns the sentence that says what to do with the gains of an axis, without the goal."""
        return advice_by_axis[axis].conclusion.replace(is_goal_stated=True).sentence

    sentences = []
    for conclusion_text, axes in group_by(advice_by_axis, conclusion_on_axis).items():
        sentences.append(Sentence(conclusion_text, f"Gains of {listed(axes)}:"))
    if advice_by_axis:
        # All axes have the same goal.
        first_advice = next(iter(advice_by_axis.values()))
        sentences += sentences_on_goal(first_advice.target)
        sentences += sentences_on_reached_goal(advice_by_axis)
    return sentences


def _margin_sentences(evidence: Evidence, decisions: DecisionsByAxis) -> list[Sentence]:
    """Returns the sentences about the stability margins of all axes, or about why they are not known.

    They stand on the page below the decision on each axis: the judgement by all that was measured of it, which is its
    margins, its oscillations, and how well it follows its setpoint. So what a decision states is left out here.

    Args:
        evidence: findings on the margins of each axis; for a loop that was not identified, the reason.
        decisions: decisions by axis; an axis may have none.

    Returns:
        The sentences. Axes with the same finding share one.
    """
    axes_and_findings = []
    for margins in evidence.margins:
        facts_on_margins = [*margins.facts]
        if margins.margins_by_slow_log is not None:
            facts_on_margins.append(margins.margins_by_slow_log)
        # The figure ``names`` makes the sentence speak of this axis alone.
        findings = [fact.replace(names=(margins.axis,)) for fact in facts_on_margins]
        if not findings and isinstance(margins.loop, Fact):
            # In the place of an identified loop there is the reason why it could not be identified.
            findings = [margins.loop]
        decision = decisions.get(margins.axis)
        for finding in findings:
            is_stated_above = decision is not None and finding.code is decision.reason.code
            if is_stated_above:
                continue
            follows_badly = (
                decision is not None and decision.diagnosis is LoopDiagnosis.FOLLOWS_BADLY
            )
            if finding.is_good and follows_badly:
                # Good margins are not enough then. This figure makes the sentence say so.
                finding = finding.replace(follows=False)
            axes_and_findings.append((margins.axis, finding))
    return sentences_by_axes(axes_and_findings)
