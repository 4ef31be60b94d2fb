"""The page of ``mavdem tune``: gains to load, step responses, margins, and the facts (coded findings) behind them."""

from collections.abc import Mapping, Sequence
from itertools import chain

from mavdem.assessment import Assessment
from mavdem.assessment.axis.responses import (
    LoopResponse,
    Responses,
    StepsByLoop,
    advised_steps,
)
from mavdem.assessment.axis.tuning import Tuning
from mavdem.assessment.axis.twin import GainTrial, try_gains
from mavdem.assessment.evidence import Evidence
from mavdem.facts import Fact
from mavdem.facts.lights import Light
from mavdem.facts.margins import MarginsLight
from mavdem.loops.advice import Advice
from mavdem.loops.axis_loops import LOOP_NAMES
from mavdem.loops.step_response import StepResponse
from mavdem.report.blocks import Blocks, Sentence
from mavdem.report.charts.chart import Chart, Group, Note, Panel
from mavdem.report.charts.flight_charts import attitude_gain_chart, loop_charts, step_charts
from mavdem.report.charts.gain_trial import CAPTION, predicted_step_chart, twin_charts
from mavdem.report.gain_changes import GainChanges, gain_changes, gains_in_tables
from mavdem.report.gain_overview import GainOverview, gain_overview
from mavdem.report.pages.loop_chapters import (
    LOOP_CAPTION,
    axes_with_feedforward,
    feedforward_remark,
    sentences_without_response,
)
from mavdem.report.pages.noise_chapters import gyro_chapter
from mavdem.report.pages.page import Chapter, Head, render_document
from mavdem.report.pages.step_captions import FIT_MEANING, gain_caption, has_fit, step_caption
from mavdem.report.palette import MEASURED, PHYSICAL, PREDICTED
from mavdem.report.screen import flight_sentences
from mavdem.report.templates import MEDIUM, render_section, sentences_for
from mavdem.report.tuning.decisions import measured_margins
from mavdem.report.tuning.details import tune_details
from mavdem.report.tuning.goal import goal_reached_sentences, goal_sentences
from mavdem.report.tuning.outcomes import field_sentences, outcome_by_axis, outcome_sentences
from mavdem.report.tuning.overview import margin_overview
from mavdem.report.tuning.reasons import sentences_without_gains, tune_blocks
from mavdem.report.tuning.repairs import needs_check_before_gains
from mavdem.report.tuning.result import (
    is_headline_of_tuning,
    level_of_summary,
    states_max_sensitivity,
    tuning_result,
)
from mavdem.report.tuning.summary import later_flight_sentences, tune_summary
from mavdem.report.tuning.tables import compared_loops, tuned_loops_table

SUBTITLE = "Margins of the loops, and the advice on their gains. Nothing was sent to the vehicle."
"""What stands below the title."""

STEP_CAPTION = "Response to a step of the setpoint."
"""What stands below the charts of the steps, before the meaning of the colours that are drawn."""

COLOUR_MEANINGS = {
    MEASURED: "“Measured” is of this flight, with its 90 % band; “doubtful” without one.",
    PREDICTED: "“Predicted”, “identified” and “now” are of the identified loop with the gains that flew; with a 90 % "
    "band where the rate rises too fast for its messages to show it.",
    PHYSICAL: "“New” is of the identified loop with new gains; “tried” with such that another flight is to confirm.",
}
"""What the lines of step responses are, by their colours, in the order of the caption."""

NAMES_OF_NEW_GAINS = ("new", "new gains")
"""Names of the lines of new gains in charts."""

GAIN_MEANING = "|T| is the gain of the closed loop over frequency."
"""What the caption adds if the gain of a loop is drawn, too."""

GAIN_PANEL = "gain"
"""Name of the chart of that gain among those of the loops, which have the names of these."""

ATTITUDE_GAIN_PANEL = "attitude gain"
"""Name of the chart of an attitude's gain over frequency, for an axis that moves further than its setpoint."""

MIN_STEP_DISAGREEMENT = 0.05
"""Difference of the ends of two steps that means nothing, relative to the setpoint: the usual band of settling, 5 %."""


def tune_page(name: str, tuning: Tuning, assessment: Assessment) -> str:
    """Renders the page of ``mavdem tune``.

    First comes what a pilot needs to decide: the result, the gains to load, the step responses and the margins with
    present and advised gains, and the gyro's noise. Further evidence is folded: flights of the twin, a simulation of
    the vehicle, and the open loops.

    Args:
        name: name of the log, the title of the page.
        tuning: the advice for each axis.
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.

    Returns:
        The page as HTML.
    """
    evidence = assessment.evidence
    # Loops are only sought in the flight of a vehicle that was judged, and so has evidence.
    assert evidence is not None
    changes = changes_to_load(name, tuning, evidence)
    # The gains of this table stand on the same page.
    medium = MEDIUM.get()._replace(table_gains=gains_in_tables(changes))
    with sentences_for(medium):
        return _render_tune_page(name, tuning, assessment, changes)


def _render_tune_page(
    name: str, tuning: Tuning, assessment: Assessment, changes: GainChanges | None
) -> str:
    """Renders the page of ``mavdem tune`` as HTML, within a medium whose sentences refer to the table of gains.

    Args:
        name: name of the log.
        tuning: the advice for each axis.
        assessment: all results on a vehicle of the log.
        changes: the gains to load, as a table; None if none change.
    """
    evidence = assessment.evidence
    # Loops are only sought in the flight of a vehicle that was judged, and so has evidence.
    assert evidence is not None
    result = tuning_result(tuning)
    gyro = gyro_chapter(assessment, timeline=None, has_spectrograms=True)
    chapters = [
        _step_chapter(tuning, assessment),
        Chapter("Margins", _margin_blocks(tuning, assessment, result)),
        gyro._replace(title="Gyro noise and filters"),
        _twin_chapter(tuning, assessment),
        _open_loops_chapter(
            tuning,
            assessment,
            is_headline_on_sensitivity=result.is_watch_or_bad and states_max_sensitivity(result),
        ),
        Chapter("More figures of the loops, and their basis", tune_details(tuning), folded=True),
    ]
    chapters = [chapter for chapter in chapters if not _repeats_headline(chapter, tuning)]
    summary: Blocks = [*tune_summary(tuning, result)]
    blocks_beside_gains: Blocks = [*margin_overview(tuning)]
    blocks_beside_gains += goal_reached_sentences(tuning)
    blocks_beside_gains += field_sentences(tuning)
    blocks_beside_gains += later_flight_sentences(tuning)
    blocks_beside_gains += flight_sentences(assessment, has_headline_above=False)
    gains = gains_of_tuning(tuning, evidence, changes)
    if gains is None:
        summary += blocks_beside_gains
        if is_headline_of_tuning(tuning, result):
            # Without the gains of the log, no table says what becomes of the gains of each axis.
            for sentence in outcome_sentences(tuning):
                summary.append(Sentence(sentence.lead, "By axis:"))
    # The row of status lights (judgements of motors, power and others) is left out: this page is about the loops only.
    level = level_of_summary(tuning, result)
    head = Head(
        level, lights={}, changes=changes, gains=gains, blocks_beside_gains=blocks_beside_gains
    )
    return render_document(name, SUBTITLE, summary, chapters, head=head)


def _repeats_headline(chapter: Chapter, tuning: Tuning) -> bool:
    """Returns whether a chapter says only that axes get no gains for the reason in the headline.

    Such a chapter is left out: the top of the page says the same beside each axis.

    Args:
        chapter: a chapter of the page.
        tuning: the advice for each axis, and the headline.
    """
    axes_without_gains = [axis for axis in tuning.axes if not tuning.lowers_gains_of(axis)]
    if not axes_without_gains:
        return False
    return [*chapter.blocks] == sentences_without_gains(tuning, axes_without_gains)


def changes_to_load(name: str, tuning: Tuning, evidence: Evidence) -> GainChanges | None:
    """Returns the parameters to load, as a table with files to download; None if no parameter is to be changed.

    Args:
        name: name of the log, by which the files are named.
        tuning: the advice for each axis.
        evidence: evidence of the log, with the parameters that the vehicle has now.
    """
    return gain_changes(
        name,
        evidence.signals.telemetry,
        tuning.axes,
        tuning.gains_to_lower,
        tuning.notch_parameters,
        is_after_check=needs_check_before_gains(tuning.judgement.next_step),
        oscillates=tuning.judgement.headline.code is MarginsLight.OSCILLATES,
    )


def gains_of_tuning(
    tuning: Tuning, evidence: Evidence, changes: GainChanges | None
) -> GainOverview | None:
    """Returns the gains of all axes: their values in the log, new values, and whether each axis is changed or kept.

    None if the log has no gains.

    Args:
        tuning: the advice for each axis.
        evidence: evidence of the log, with the parameters that the vehicle has now.
        changes: the parameters to load (:func:`changes_to_load`).
    """
    signals_by_axis = {axis: evidence.signals.for_axis(axis) for axis in tuning.axes}
    return gain_overview(signals_by_axis, changes, outcome_by_axis(tuning))


def _margin_blocks(tuning: Tuning, assessment: Assessment, result: Fact) -> Blocks:
    """Returns the chapter of the margins: sentences on each axis, and a table of the loops of all axes.

    Args:
        tuning: the advice for each axis.
        assessment: assessment of the log, with the margins that were measured.
        result: the result that stands at the top of the page, and is not repeated here.
    """
    # New gains have a table of their own on this page; details have a chapter at its end.
    blocks = tune_blocks(tuning, is_full=False, is_page=True, headline_above=result)
    blocks += measured_margins(tuning, assessment.margins)
    responses = {axis: assessment.responses.get(axis, {}) for axis in tuning.axes}
    blocks += tuned_loops_table(tuning, axes_with_feedforward(responses))
    return [*blocks, *goal_sentences(tuning)]


def _step_chapter(tuning: Tuning, assessment: Assessment) -> Chapter:
    """Returns the chapter with charts of step responses: as measured, predicted, and with advised gains.

    If no response of a loop was measured, its chart has only what the identified loop predicts. If no loop was
    identified either, the reason takes the place of the chart; without any chart it is all that the chapter has.

    Args:
        tuning: the advice for each axis.
        assessment: assessment of the log, with the measured responses.
    """
    responses = {axis: assessment.responses.get(axis, {}) for axis in tuning.axes}
    steps = advised_steps(responses, tuning.axes)
    charts = {axis: _step_panels(axis, tuning, assessment, steps) for axis in tuning.axes}
    charts_and_notes = _with_notes(charts, responses)
    sentences = sentences_without_response(_responses_without_note(responses, charts_and_notes))
    sentences += rate_disagreement_sentences(responses)
    caption = _caption_of_step_chapter(charts_and_notes, responses)
    groups = _groups_of_columns(charts_and_notes, assessment, caption)
    if not groups:
        # Why nothing was measured is for those who look for it.
        return Chapter("Step response: not measured", sentences, folded=True)
    return Chapter("Step response", sentences, groups)


def _responses_without_note(
    responses: Responses, panels: Mapping[str, Mapping[str, Sequence[Panel]]]
) -> dict[str, dict[str, LoopResponse]]:
    """Returns the responses without those that have a note in the place of their chart.

    Such a note says already why the response was not measured.

    Args:
        responses: by axis and loop, the measured response or the fact (coded finding) why there is none.
        panels: charts and notes by axis, and then by loop.
    """
    responses_without_note: dict[str, dict[str, LoopResponse]] = {}
    for axis, responses_of_axis in responses.items():
        responses_without_note[axis] = {}
        for loop_name, response in responses_of_axis.items():
            panels_of_loop = panels[axis].get(loop_name, ())
            has_note = any(isinstance(panel, Note) for panel in panels_of_loop)
            if not has_note:
                responses_without_note[axis][loop_name] = response
    return responses_without_note


def _caption_of_step_chapter(
    panels: Mapping[str, Mapping[str, Sequence[Panel]]], responses: Responses
) -> str:
    """Returns the caption below the charts of step responses: what their lines mean, and what limits them.

    Args:
        panels: charts by axis, and then by loop.
        responses: by axis and loop, the measured response or the fact (coded finding) why there is none.
    """
    caption = _step_caption(panels) + feedforward_remark(responses)
    drawn_names = {name for panels_by_name in panels.values() for name in panels_by_name}
    if not drawn_names.isdisjoint({GAIN_PANEL, ATTITUDE_GAIN_PANEL}):
        caption = f"{caption} {GAIN_MEANING}"
    if any(has_fit(response) for loops in responses.values() for response in loops.values()):
        caption = f"{caption} {FIT_MEANING}"
    return caption


def rate_disagreement_sentences(responses: Responses) -> list[Sentence]:
    """Returns a sentence on each axis whose predicted step of the rate ends outside of the band of the measured one.

    Ends that differ by at most ``MIN_STEP_DISAGREEMENT`` agree, however narrow the band is. An axis whose prediction is
    called doubtful has no sentence: its report says already that the two differ.

    Args:
        responses: by axis and loop, the measured response, with the predicted step of an axis whose loop is known.
    """
    sentences: list[Sentence] = []
    for axis, responses_of_axis in responses.items():
        response = responses_of_axis.get("rate")
        if response is None or response.predicted_step is None:
            continue
        step = response.measured
        if not isinstance(step, StepResponse) or step.is_identified or step.is_doubtful:
            continue
        if response.contradiction is not None:
            continue
        measured_end, half_width = step.step[-1], step.step_half[-1]
        predicted_end = response.predicted_step[-1]
        if abs(measured_end - predicted_end) > max(half_width, MIN_STEP_DISAGREEMENT):
            sentences += render_section(
                "step_disagreement",
                axis=axis,
                measured=measured_end,
                half=half_width,
                predicted=predicted_end,
            )
    return sentences


def _step_panels(
    axis: str,
    tuning: Tuning,
    assessment: Assessment,
    advised: StepsByLoop,
) -> dict[str, Sequence[Panel]]:
    """Returns the charts of the step responses of one axis, by loop: "rate" and "attitude"; gains under ``GAIN_PANEL``.

    Below each step a line says whether it was measured, and whether model and flight agree.

    A loop without a measured response and without an identified model has no chart. A measured rate loop also has the
    chart of its gain, measured and predicted. So has an attitude that moves further than its setpoint. Gains come last,
    so that the charts of several axes are aligned.

    Args:
        axis: "roll", "pitch" or "yaw".
        tuning: the advice for each axis, or the reason why there is none.
        assessment: assessment of the log, with the measured responses, and the messages that they were measured from.
        advised: the step responses that are predicted with the advised gains.
    """
    # Step responses are measured from the evidence, so that a log with a tuning has it.
    assert assessment.evidence is not None
    advice = tuning.axes[axis]
    responses = assessment.responses.get(axis, {})
    panels: dict[str, Sequence[Panel]] = {}
    for loop_name in LOOP_NAMES:
        chart = _step_chart_of_loop(axis, loop_name, advice, assessment, advised)
        if chart is not None:
            panels[loop_name] = [chart]
    rate_response = responses.get("rate")
    if rate_response is not None and isinstance(rate_response.measured, StepResponse):
        _, gain_chart = step_charts({axis: {"rate": rate_response}})[axis]
        caption = gain_caption(rate_response.compared)
        panels[GAIN_PANEL] = [gain_chart._replace(caption=caption)]
    measured_gain = assessment.evidence.amplifying_attitude_gain(axis)
    if measured_gain is not None:
        identified = advice.before if isinstance(advice, Advice) else None
        panels[ATTITUDE_GAIN_PANEL] = [attitude_gain_chart(axis, measured_gain, identified)]
    if isinstance(advice, Advice) and not advice.is_sound:
        return {name: _with_tried_gains(charts) for name, charts in panels.items()}
    return panels


def _step_chart_of_loop(
    axis: str,
    loop_name: str,
    advice: Advice | Fact,
    assessment: Assessment,
    advised: StepsByLoop,
) -> Panel | None:
    """Returns the chart of one loop's step response, with a caption; None if it was neither measured nor identified.

    Args:
        axis: "roll", "pitch" or "yaw".
        loop_name: "rate" or "attitude".
        advice: advice on the gains of the axis, or the fact (coded finding) that says why its loop is not known.
        assessment: assessment of the log, with the measured responses, and the messages that they were measured from.
        advised: the step responses that are predicted with the advised gains.
    """
    response = assessment.responses.get(axis, {}).get(loop_name)
    if response is not None and isinstance(response.measured, StepResponse):
        # The chart has the measured response, the predicted one, and that with the advised gains.
        response_of_loop = {axis: {loop_name: response}}
        chart, *_ = step_charts(response_of_loop, advised, has_gain=False)[axis]
        messages = None
        if loop_name == "rate" and assessment.evidence is not None:
            messages = assessment.evidence.signals.for_axis(axis).rate_and_setpoint
        last_time = chart.lines[0].x[-1]
        return chart._replace(caption=step_caption(response, last_time, messages))
    if isinstance(advice, Advice):
        # Without a measured response, the chart has what the identified loop predicts.
        predicted_chart = predicted_step_chart(compared_loops(advice), loop_name)
        return predicted_chart._replace(caption=step_caption(response))
    return None


def _with_tried_gains(panels: Sequence[Panel]) -> list[Panel]:
    """Returns charts whose lines of new gains are called "tried", as in the table of gains that are not to be loaded.

    Args:
        panels: charts and notes of one axis.
    """
    renamed: list[Panel] = []
    for panel in panels:
        if isinstance(panel, Chart):
            lines = []
            for line in panel.lines:
                is_new = line.name in NAMES_OF_NEW_GAINS
                lines.append(line._replace(name="tried") if is_new else line)
            panel = panel._replace(lines=tuple(lines))
        renamed.append(panel)
    return renamed


def _with_notes(
    charts: Mapping[str, Mapping[str, Sequence[Panel]]], responses: Responses
) -> dict[str, dict[str, Sequence[Panel]]]:
    """Returns the charts of step responses, with a note where one axis lacks a chart that another axis has.

    The note says why no response was measured. So the charts of all axes are aligned.

    Args:
        charts: charts by axis, and then by what they show: "rate", "attitude" or "gain".
        responses: by axis and loop, the measured response or the fact (coded finding) why there is none.

    Returns:
        Charts and notes, in the same order for all axes.
    """
    drawn_names = {name for charts_of_axis in charts.values() for name in charts_of_axis}
    panels: dict[str, dict[str, Sequence[Panel]]] = {}
    for axis, charts_of_axis in charts.items():
        panels[axis] = {}
        for name in (*LOOP_NAMES, GAIN_PANEL, ATTITUDE_GAIN_PANEL):
            response = responses[axis].get(name)
            if name in charts_of_axis:
                panels[axis][name] = charts_of_axis[name]
            elif name in drawn_names and response is not None:
                title = f"{axis.capitalize()} {name}: no step"
                panels[axis][name] = [Note(title, str(response.measured))]
    return panels


def _step_caption(panels: Mapping[str, Mapping[str, Sequence[Panel]]]) -> str:
    """Returns the caption of the charts of step responses, which says what the lines of each colour that they use are.

    Args:
        panels: charts by axis, and then by loop.
    """
    colours = set[str]()
    for panels_by_loop in panels.values():
        for panels_of_loop in panels_by_loop.values():
            colours |= _line_colours(panels_of_loop)
    caption = STEP_CAPTION
    for colour, meaning in COLOUR_MEANINGS.items():
        if colour in colours:
            caption += f" {meaning}"
    return caption


def _line_colours(panels: Sequence[Panel]) -> set[str]:
    """Returns the colours of the lines of all charts among some panels; a drawing has no lines."""
    colours = set[str]()
    for panel in panels:
        if isinstance(panel, Chart):
            colours.update([line.colour for line in panel.lines])
    return colours


def _groups_of_columns(
    charts: Mapping[str, Mapping[str, Sequence[Panel]]], assessment: Assessment, caption: str
) -> list[Group]:
    """Arranges charts in columns: one for each axis or, if only one axis has charts, one for each of its loops.

    Args:
        charts: charts by axis, and then by what they show, such as "rate" or "attitude"; an axis may have none.
        assessment: assessment of the log. Its judgement of the stability margins names the axis with the worst ones,
            whose column a phone shows first.
        caption: text below the charts.

    Returns:
        A list with one group of columns; empty without charts.
    """
    axes_with_charts = [axis for axis, charts_by_loop in charts.items() if charts_by_loop]
    if not axes_with_charts:
        return []
    columns: dict[str, Sequence[Panel]] = {}
    if len(axes_with_charts) == 1:
        (axis,) = axes_with_charts
        columns.update(charts[axis])
    else:
        for axis in axes_with_charts:
            columns[axis] = list(chain.from_iterable(charts[axis].values()))
    margins_light = assessment.lights[Light.MARGINS]
    return [Group.of_axes(columns, margins_light, caption)]


def _twin_chapter(tuning: Tuning, assessment: Assessment) -> Chapter:
    """Returns the folded chapter of simulated flights with the present and with the advised gains.

    The twin, a simulation of the vehicle by its identified parameters, flies the recorded setpoints and hovers in wind.

    Args:
        tuning: the advice for each axis.
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.

    Returns:
        The chapter, with charts of each axis whose gains change; without charts if none do, or if the twin could not be
        made.
    """
    charts_by_axis = _twin_charts_by_axis(tuning, assessment)
    groups = []
    if charts_by_axis:
        # The caption says "… flies the recorded setpoints, and hovers, both in wind …".
        caption = CAPTION.format(hovers=", and hovers, both")
        groups.append(Group.of_axes(charts_by_axis, caption=caption))
    return Chapter("The twin with both sets of gains", (), groups, folded=True)


def _twin_charts_by_axis(tuning: Tuning, assessment: Assessment) -> dict[str, list[Panel]]:
    """Flies the twin with both sets of gains, and returns its charts for each axis whose gains change.

    Args:
        tuning: the advice for each axis, or the reason why there is none.
        assessment: all results on the vehicle, by which the twin is made.

    Returns:
        Charts by axis; empty if no gains change, or if the twin could not be made.
    """
    # Gains are advised only of a vehicle that was judged, and so has evidence.
    assert assessment.evidence is not None
    charts_by_axis = dict[str, list[Panel]]()
    if not tuning.has_computed_gains:
        return charts_by_axis
    # Either the simulated flights, or a fact (coded finding) that says why there is no twin.
    trial = try_gains(assessment.evidence, {**tuning.tried_parameters, **tuning.parameters})
    if not isinstance(trial, GainTrial):
        return charts_by_axis
    for axis, advice in tuning.axes.items():
        if isinstance(advice, Advice) and advice.parameters:
            charts_by_axis[axis] = [*twin_charts(axis, trial)]
    return charts_by_axis


def _open_loops_chapter(
    tuning: Tuning, assessment: Assessment, *, is_headline_on_sensitivity: bool
) -> Chapter:
    """Returns the chapter that shows each control loop over frequency: gain and phase of the open loop, sensitivity.

    Each chart has the loop with the present gains and, where gains change, the loop with the advised ones. The chapter
    is folded, since few readers need it, unless the page's headline is about the sensitivity.

    Args:
        tuning: for each axis its advice, with the loops; or the fact why its loops are not known.
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        is_headline_on_sensitivity: whether the headline is that the maximum sensitivity is too large.
    """
    charts: dict[str, dict[str, Sequence[Panel]]] = {}
    for axis, advice in tuning.axes.items():
        if isinstance(advice, Advice):
            loops = compared_loops(advice)
            charts[axis] = {}
            for name in LOOP_NAMES:
                panels = loop_charts(loops, name, advice.target)
                charts[axis][name] = panels if advice.is_sound else _with_tried_gains(panels)
    groups = _groups_of_columns(charts, assessment, LOOP_CAPTION)
    return Chapter("Open loops", (), groups, folded=not is_headline_on_sensitivity)
