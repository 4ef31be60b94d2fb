"""The chapters on one flight in the page of a log: control loops, motors, vibration, wind and learned models."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from mavdem.assessment import Assessment
from mavdem.assessment.axis import LogAnalysis
from mavdem.assessment.axis.lowered_gains import lowered_gains
from mavdem.assessment.axis.responses import advised_steps
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.flights import loss_onset
from mavdem.assessment.lights.motors import motor_figures_of_all_flight
from mavdem.assessment.motor_failure import failure_commands
from mavdem.dataset.speed_controllers import speed_controllers
from mavdem.dem import Learned
from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.assessment import Grade, Purpose
from mavdem.facts.ending import Ending
from mavdem.facts.lights import Light, Unjudged
from mavdem.loops.advice import AdviceByAxis
from mavdem.loops.resonance import controller_if_known
from mavdem.report.blocks import Blocks, Rated, Sentence, Table, warning
from mavdem.report.charts import model_charts
from mavdem.report.charts.chart import Charts, Group
from mavdem.report.charts.flight_charts import fastest_loop
from mavdem.report.charts.plans import frame_plan, rose_of_wind
from mavdem.report.charts.timeline import Timeline, rate_title
from mavdem.report.condition import air_blocks
from mavdem.report.instances import instance_table
from mavdem.report.labels import Labels
from mavdem.report.notch_trial import NotchTrial, notch_trial
from mavdem.report.numbers import display_unit, with_unit
from mavdem.report.pages.chapter_of_light import CHAPTER_LEVELS, INSTANCES_TITLE, lights_of_chapter
from mavdem.report.pages.hardware_chapters import hardware_chapters
from mavdem.report.pages.loop_chapters import loops_chapters, responses_chapter, tuning_chapter
from mavdem.report.pages.noise_chapters import controller_spectra_chapter, vibration_chapter
from mavdem.report.pages.page import Chapter, Section
from mavdem.report.pages.parameter_chapter import parameters_chapter
from mavdem.report.screen import (
    detail_blocks,
    motor_blocks,
    motor_table_of_all_flight,
    prediction_blocks,
    purpose_tables,
    torque_blocks,
    vehicle_blocks,
)
from mavdem.report.templates import render_section, without_full_stop
from mavdem.report.trust import trust_table
from mavdem.report.truth import truth_blocks
from mavdem.witnesses import SensorTrust

MOTOR_LEADS = ("Motors:", "Steady command:")
"""Leads of the sentences on the condition that are about the motors."""

SECONDS_PER_MINUTE = 60
"""Seconds of a minute."""

TRACKING_FIGURES = {
    "angle_error": "angle error (RMS)",
    "error_limit": "bad from",
    "delay": "delay",
    "rate_error": "rate error (RMS)",
}
"""Columns of the table of tracking: header by the figure of the axis's fact."""


def flight_chapters(
    name: str,
    assessment: Assessment,
    timeline: Timeline | None,
    advice: AdviceByAxis,
    *,
    is_full: bool,
) -> Iterator[Chapter]:
    """Yields the chapters of a flight's page that need no identified model, in the order of the page.

    A log without a flight has none of them.

    Args:
        name: title of the page.
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        timeline: charts over time; None if the attitude has too few samples.
        advice: advised gains by axis, or the reason why there are none; empty without advice.
        is_full: whether it is the full page of one log, with spectrograms, notch filters to try and hardware, and not a
            small page of a fleet.
    """
    evidence = assessment.evidence
    analysis = assessment.analysis
    if evidence is None or analysis is None:
        return
    yield tuning_chapter(assessment.responses, assessment.noise)
    if timeline is not None:
        yield _axes_chapter(assessment, timeline)
    steps = advised_steps(assessment.responses, advice)
    yield responses_chapter(assessment.responses, steps, assessment.lights[Light.MARGINS])
    has_advised_gains_above = not lowered_gains(assessment.next_step)
    yield from loops_chapters(assessment, evidence, advice, has_gains_above=has_advised_gains_above)
    vibration = vibration_chapter(assessment, timeline, has_spectrograms=is_full)
    if is_full:
        vibration = vibration._replace(notch_trial=_notch_trial(name, assessment, evidence))
    yield vibration
    yield controller_spectra_chapter(assessment.noise, timeline, has_spectrograms=is_full)
    yield _motors_chapter(analysis, evidence, assessment.lights["motors"])
    yield _condition_chapter(analysis)
    yield _wind_chapter(assessment, analysis)
    if evidence.trust:
        yield _trust_chapter(evidence.trust)
    if assessment.instances:
        yield _instances_chapter(assessment, has_flown=evidence.has_flown)
    if is_full:
        yield from hardware_chapters(evidence, assessment.lights, timeline)
    yield parameters_chapter(evidence.signals.telemetry, is_full=is_full)


def _instances_chapter(assessment: Assessment, *, has_flown: bool) -> Chapter:
    """Returns the chapter on what a vehicle may have several of, such as batteries and sensors: a table of each one.

    Args:
        assessment: all results on a vehicle of the log, with these instances and the status lights.
        has_flown: whether the vehicle flew; otherwise the ranges are taken from the whole log.
    """
    vibration_light = assessment.lights[Light.VIBRATION]
    table = instance_table(assessment.instances, vibration_light, has_flown=has_flown)
    # The table shows what was measured, and not always why a light warns, such as a disagreement of two sensors.
    for name in lights_of_chapter(INSTANCES_TITLE, assessment.lights):
        light = assessment.lights[name]
        if light.is_watch_or_bad:
            cause = Rated(without_full_stop(str(light)), light.level)
            table.rows.insert(0, [str(name), "", "judgement", "", cause])
    level_scope = scope_of_instances_level(assessment.lights)
    return Chapter(INSTANCES_TITLE, [table], level_scope=level_scope)


def scope_of_instances_level(lights: NamedFacts) -> str:
    """Returns which status lights the level of the chapter of batteries, sensors, estimators and outputs comes from.

    The chapter also has the vibration of the IMUs, which has a chapter of its own, and is not meant by the level.

    Args:
        lights: the judgement of each part of the vehicle by name, a fact (a coded finding) with a level.

    Returns:
        Text that follows the level, such as " (power)"; empty if no light is about the chapter.
    """
    names = lights_of_chapter(INSTANCES_TITLE, lights)
    if not names:
        return ""
    # The level of the chapter is the worst of these. The levels are listed from the worst to the best.
    worst_level = min([lights[name].level for name in names], key=CHAPTER_LEVELS.index)
    names_of_worst = [str(name) for name in names if lights[name].level is worst_level]
    return f" ({' and '.join(names_of_worst)})"


def _trust_chapter(trust_of_boots: Sequence[SensorTrust]) -> Chapter:
    """Returns the chapter with the checks of sensors against each other, which show whose values can be trusted.

    Args:
        trust_of_boots: the checks of each boot of the autopilot.

    Returns:
        The chapter, with the level "watch" if a check warns; otherwise without a level.
    """
    level = None
    for trust in trust_of_boots:
        if any(check.is_watch_or_bad for check in trust.checks):
            level = Level.WATCH
    return Chapter("Sensor checks", [trust_table(trust_of_boots)], level=level)


def _axes_chapter(assessment: Assessment, timeline: Timeline) -> Chapter:
    """Returns the chapter of angles and rates with their setpoints, a column for each axis, and how well they track.

    If the tracking is bad, the chapter is open when the page is loaded. Then only the rates are shown at first, by
    which an axis that was lost is recognised: the plots over the flight have roll and pitch already. The other charts
    are in a part to open, so that the page stays short.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        timeline: charts of the flight over time.
    """
    tracking_light = assessment.lights["tracking"]
    all_charts: dict[str, Charts] = {}
    rate_charts: dict[str, Charts] = {}
    other_charts: dict[str, Charts] = {}
    for axis, unmarked_charts in timeline.axis_charts.items():
        if not unmarked_charts:
            continue
        charts = tuple(timeline.marked(chart) for chart in unmarked_charts)
        all_charts[axis] = charts
        rate_charts[axis] = tuple(chart for chart in charts if chart.title == rate_title(axis))
        other_charts[axis] = tuple(chart for chart in charts if chart.title != rate_title(axis))
    blocks: Blocks = [*_tracking_sentences(tracking_light, assessment.headline)]
    error_tables = _tracking_tables(assessment.tracking)
    sections = []
    # The charts can be divided if each axis has a rate, and something else. A section is the part to open.
    can_be_divided = all(rate_charts.values()) and all(other_charts.values())
    if tracking_light.is_bad and can_be_divided:
        group = Group.of_axes(rate_charts, tracking_light)
        other_group = Group.of_axes(other_charts, tracking_light)
        sections.append(Section("Angles and errors", groups=[other_group], blocks=error_tables))
    else:
        group = Group.of_axes(all_charts, tracking_light)
        blocks += error_tables
    level_scope = _scope_of_tracking_level(assessment, tracking_light)
    return Chapter("Three axes", blocks, [group], level_scope=level_scope, sections=sections)


def _scope_of_tracking_level(assessment: Assessment, light: Fact) -> str:
    """Returns the words after the level in the title of the chapter on tracking, as in "good in settled flight, …".

    How well the attitude tracks its setpoint is judged in settled flight only, without take-off, landing and loss. But
    the charts of the chapter also show how a vehicle was lost. "Good" alone would be wrong of these, so that the words
    limit it to the time before the loss.

    Args:
        assessment: all results on a vehicle of the log, with the event by which the vehicle was lost, if it was.
        light: the judgement of how well all axes track, a fact (a coded finding) with a level.

    Returns:
        Words such as " in settled flight, until 47.2 s", a time on the boot clock. They are empty if the vehicle was
        not lost, if the tracking was not judged, and if it was judged by the loss itself.
    """
    if assessment.evidence is None:
        return ""
    loss = assessment.evidence.ending
    is_judged_before_loss = light.level is not Level.UNKNOWN and light.code not in Ending
    if loss is None or loss.time is None or not is_judged_before_loss:
        return ""
    return f" in settled flight, until {loss_onset(loss):.1f} s"


def _tracking_sentences(light: Fact, headline: Fact) -> list[Sentence]:
    """Returns the sentence on how well the attitude follows its setpoints, unless the page has it already.

    The page has it in the headline, which also says how a flight was lost, or beside the status lights, which say that
    only multirotors are judged.

    Args:
        light: the judgement of how well all axes track, a fact (a coded finding) with a level.
        headline: the headline of the page.

    Returns:
        A list with the sentence, or an empty one.
    """
    is_in_headline = light.code in Ending or light == headline
    if light.code is Unjudged.MULTIROTORS_ONLY or is_in_headline:
        return []
    return [Sentence(str(light), lead="Tracking:")]


def _tracking_tables(axes: NamedFacts) -> list[Table]:
    """Returns a table of how well each axis follows its setpoint in settled flight, without take-off and landing.

    Args:
        axes: a fact (coded finding) for each axis, whose figures are the errors and the delay, each with its unit.

    Returns:
        A list with the table, which has a row for each axis with a known figure; empty without such an axis.
    """
    rows = []
    for axis, fact in axes.items():
        cells = _tracking_cells(fact)
        if any(cells):
            rows.append([axis, *cells])
    if not rows:
        return []
    return [Table(["tracking", *TRACKING_FIGURES.values()], rows)]


def _tracking_cells(fact: Fact) -> list[str]:
    """Returns the row of one axis in the table of tracking errors: a cell for each of ``TRACKING_FIGURES``.

    Args:
        fact: how well the axis tracks its setpoint, as figures with units; a figure is None where it is not known.

    Returns:
        Values with their units. A cell is empty if its figure does not apply, and "not known" if the axis has other
        figures but not this one: a setpoint that moved too little shows no delay, for example.
    """
    cells: list[str] = []
    for key in TRACKING_FIGURES:
        value = fact.figures.get(key)
        if value is not None:
            cells.append(with_unit(value, display_unit(fact.units[key])))
        elif key in fact.figures and any(cells):
            cells.append("not known")
        else:
            cells.append("")
    return cells


def _notch_trial(name: str, assessment: Assessment, evidence: Evidence) -> NotchTrial | None:
    """Returns the notch filters whose settings a reader of the page can try, with their effect on spectrum and phase.

    Args:
        name: name of the log.
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The trial of the filters; None without a spectrum or a known controller.
    """
    signals = evidence.signals
    # The gyro's filters are the same for all axes, so that the controller of any one will do.
    controller = controller_if_known(signals.for_axis("roll"))
    return notch_trial(
        name,
        signals.telemetry,
        assessment.noise,
        controller,
        fastest_loop(assessment.identified_loops),
        _motor_frequencies(evidence),
    )


def _motor_frequencies(evidence: Evidence) -> tuple[float, ...]:
    """Returns how often each motor turns in a second (Hz), the median in flight, as their speed controllers report it.

    Args:
        evidence: signals and measurements of the vehicle, with the reported speeds in revolutions per minute.

    Returns:
        The frequencies, at which notch filters that follow the motors are shown; none of motors that did not turn, or
        whose speed was not reported.
    """
    frequencies = []
    for speed_controller in speed_controllers(evidence.signals):
        speeds = evidence.values_in_flight(speed_controller.speed)
        if len(speeds) == 0:
            continue
        median_speed = float(np.median(speeds))
        if median_speed > 0:
            frequencies.append(median_speed / SECONDS_PER_MINUTE)
    return tuple(frequencies)


def _motors_chapter(analysis: LogAnalysis, evidence: Evidence, light: Fact) -> Chapter:
    """Returns the chapter on the motors of a flight: a table of the motors, and the vehicle drawn from above.

    If a motor failed, the drawing shows what the motors were commanded at that time; otherwise it shows the means of
    the hover. If the log allows no full model, sentences on the motors' condition follow the table. Without a hover the
    table is of all flight.

    Args:
        analysis: what the log shows of the chosen axis: model, physical parameters and condition.
        evidence: signals, events and measurements of the vehicle.
        light: the status light of the motors, whose level colours the drawing.
    """
    hover = analysis.condition.hover
    blocks = motor_blocks(analysis.learned, hover)
    if hover is None:
        figures_of_all_flight = motor_figures_of_all_flight(evidence)
        if figures_of_all_flight is not None:
            blocks += motor_table_of_all_flight(figures_of_all_flight)
    has_full_model = analysis.learned is not None and analysis.tier.allows_full_model
    if not has_full_model:
        for sentence in render_section("condition", analysis.condition):
            # The table of the hover has what the sentence "Motors: …" says.
            is_in_table = hover is not None and sentence.lead == MOTOR_LEADS[0]
            if sentence.lead in MOTOR_LEADS and not is_in_table:
                blocks.append(sentence)
    failure = failure_commands(evidence.signals, light)
    drawing = frame_plan(evidence.signals.motors, analysis.condition, light, failure)
    groups = [] if drawing is None else [Group.side_by_side([drawing])]
    return Chapter("Motors", blocks, groups, is_side_by_side=True)


def _condition_chapter(analysis: LogAnalysis) -> Chapter:
    """Returns the chapter of the vehicle's condition in figures: lean, vibration, batteries, and how long it flew.

    Sentences on the motors are left out, since these have a chapter of their own.

    Args:
        analysis: what the log shows of the chosen axis, with the condition of the vehicle.
    """
    blocks: Blocks = []
    for sentence in render_section("condition", analysis.condition):
        if sentence.lead not in MOTOR_LEADS:
            blocks.append(sentence)
    return Chapter("Condition in figures", blocks)


def _wind_chapter(assessment: Assessment, analysis: LogAnalysis) -> Chapter:
    """Returns the chapter of a flight's page on the wind: its speed (m/s) and direction, and the torque that it causes.

    If both speed and direction are identifiable, a wind rose shows them. For a simulated flight the chapter compares
    the estimates with the true values of the simulator.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        analysis: analysis of the axis, with the wind torque.

    Returns:
        The chapter, with sentences, and the wind rose where it can be drawn.
    """
    blocks: Blocks = []
    # The wind is judged for multirotors alone. For other vehicles the page says so at its top, and not here again.
    if assessment.lights[Light.WIND].code is not Unjudged.MULTIROTORS_ONLY:
        blocks += air_blocks(assessment)
    if analysis.learned is not None:
        blocks += torque_blocks(analysis.learned)
    if analysis.truth:
        blocks += truth_blocks(analysis.truth)
    wind = assessment.wind
    groups = []
    if wind is not None and wind.direction_identifiable and wind.speed_identifiable:
        groups.append(Group.side_by_side([rose_of_wind(wind)]))
    return Chapter("Wind", blocks, groups, is_side_by_side=True)


def model_chapters(assessment: Assessment) -> Iterator[Chapter]:
    """Yields two chapters for each analysed axis: the learned model and, folded, how it was learned.

    Args:
        assessment: all results on a vehicle of the log. An axis without a model has only the first chapter, which says
            why.
    """
    for axis, analysis in assessment.analyses.items():
        yield _model_chapter(axis, analysis)
        if analysis.learned is not None:
            yield _learning_chapter(axis, analysis.learned)


def _model_chapter(axis: str, analysis: LogAnalysis) -> Chapter:
    """Returns the chapter of a page on the identified model of one axis, or on the reason why there is none.

    It has, in this order, grades of the model for each purpose with warnings, physical parameters, errors of forecasts,
    and charts of the frequency response and of the forecasts. The frequency response depends on the control
    effectiveness of the motors, so it is left out where that is not identifiable.

    Args:
        axis: name of the axis.
        analysis: what the log shows of that axis: model, physical parameters and condition.
    """
    learned = analysis.learned
    findings = analysis.findings
    blocks = Blocks()
    if learned is None and analysis.reason is not None:
        blocks.append(Sentence(str(analysis.reason), lead="No model:"))
    blocks += purpose_tables(findings)
    blocks += [warning(fact) for fact in findings.warnings]
    blocks += render_section("tier", analysis.tier)
    blocks += vehicle_blocks(analysis.axes, is_doubtful=bool(findings.overrides))
    groups = []
    if learned is not None:
        labels = Labels.of(learned)
        forecasts = analysis.held_out
        blocks += prediction_blocks(labels, forecasts)
        effectiveness_grade = findings.grade(Purpose.CONTROL_EFFECTIVENESS)
        if effectiveness_grade is not Grade.NOT_IDENTIFIABLE:
            caption = "Frequency response of the vehicle without its controller, with a 90 % band."
            groups.append(Group.side_by_side(model_charts.bode_charts(learned), caption))
        if forecasts is not None and len(forecasts):
            caption = "Held-out windows, by models that were not trained on them."
            forecast_charts = model_charts.forecast_charts(forecasts, labels)
            groups.append(Group.side_by_side(forecast_charts, caption))
    return Chapter(f"Model of {axis}", blocks, groups)


def _learning_chapter(axis: str, learned: Learned) -> Chapter:
    """Returns the folded chapter on how a model was learned: poles, free energy and residuals.

    Args:
        axis: "roll", "pitch" or "yaw".
        learned: the model of that axis.
    """
    caption = "Errors one step ahead; correlations between the lines may be chance (99 %)."
    groups = [Group.side_by_side(model_charts.residual_charts(learned), caption)]
    title = f"How the model of {axis} was learned"
    return Chapter(title, detail_blocks(learned), groups, folded=True)
