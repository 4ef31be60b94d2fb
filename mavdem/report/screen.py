"""Reports on a flight and its model, made of facts (coded findings): status lights, grades, motors, wind.

``analysis_blocks`` is the report of a log, ``model_screen`` that of a model alone. Pages and dashboards use the same
parts: ``motor_blocks``, ``torque_blocks``, ``prediction_blocks``, and ``vehicle_blocks`` for all axes of a vehicle.
``detail_blocks`` is what the screen leaves out: the model's poles and how it was learned.
"""

from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment import Assessment
from mavdem.assessment.axis import AxisEstimates, LogAnalysis
from mavdem.assessment.axis.findings import (
    MAX_RELATIVE_HALF_WIDTHS,
    Findings,
    model_findings,
    next_step_for_model,
)
from mavdem.assessment.flight_verdict import FlightVerdict
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.vehicle_verdict import VehicleVerdict
from mavdem.containers import group_by
from mavdem.dem import Learned
from mavdem.experiments.held_out import FORECAST, PREDICTION, HeldOut
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import NextStep
from mavdem.facts.identifiability import Status
from mavdem.facts.lights import Light
from mavdem.facts.model import ModelName
from mavdem.facts.session import SessionFact
from mavdem.facts.wind import WindLight
from mavdem.flight import Flights
from mavdem.motors.hover import HoverFigures
from mavdem.plant import Physical
from mavdem.report.blocks import (
    Blocks,
    Rated,
    Sentence,
    Table,
    caution,
    headline_sentence,
    plain_text,
    warning,
)
from mavdem.report.charts.model_charts import sample_times
from mavdem.report.condition import WIND_LIGHTS, air_blocks
from mavdem.report.instances import instance_table
from mavdem.report.labels import Labels
from mavdem.report.numbers import (
    TORQUE_UNIT,
    UNKNOWN_FIGURE,
    counted,
    display_unit,
    listed,
    name_with_unit,
    plus_minus,
    rounded,
    unit_per_input,
)
from mavdem.report.templates import PARAMETERS, headline, render_section, sentences_by_axes
from mavdem.report.trust import trust_table
from mavdem.report.truth import truth_blocks

FORECAST_NAMES = {
    FORECAST: "{}, motors recorded",
    PREDICTION: f"{ModelName.JOINT_VAR}, motors unknown",
}
"""Names of forecasts in the table of errors, with {} for the model of forecasts; baselines have their own names."""


def model_screen(learned: Learned) -> Blocks:
    """Returns the report of a model alone, without its log and without windows held out from its training."""
    findings = model_findings(learned)
    next_step = Sentence(str(next_step_for_model(findings.purposes)), "Next:")
    return [*_model_blocks(findings, learned), next_step]


def next_step_of_learning(assessment: Assessment) -> Sentence:
    """Returns the next step for a reader who learns a model of a vehicle.

    It is that of the vehicle, such as a repair. If the vehicle needs nothing, it is how to use or improve the model.

    Args:
        assessment: all results on a vehicle of the log, with the analysis of at least one axis.
    """
    analysis = assessment.analysis
    assert analysis is not None
    next_step = assessment.judgement.next_step
    if next_step.code is NextStep.KEEP_MODEL and analysis.findings.purposes:
        next_step = next_step_for_model(analysis.findings.purposes)
    return Sentence(str(next_step), "Next:")


def summary(learned: Learned) -> str:
    """Returns what is printed about a learned model: its parameters and how well it predicts, then cautions on its use.

    Args:
        learned: the linear model that was learned from a flight.
    """
    blocks = model_screen(learned)
    for fact in learned.cautions:
        blocks.append(caution(fact))
    return plain_text(blocks)


def analysis_blocks(assessment: Assessment) -> Blocks:
    """Returns the report of a log for the terminal: first the headline, then the findings, and last the next step.

    If no vehicle was analysed, the status lights that warn take the place of the findings. A status light is the
    judgement of one subject, such as the motors, and the headline is the most important finding.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
    """
    judgement = judgement_sentences(assessment.judgement)
    if assessment.analysis is None:
        return [judgement.headline, *judgement.lights, judgement.next_step]
    body = analysis_body(assessment.analysis, assessment)
    return [judgement.headline, *body, judgement.next_step]


def analysis_body(analysis: LogAnalysis, assessment: Assessment) -> Blocks:
    """Returns the report of a log without its headline and next step, which ``analysis_blocks`` puts around it.

    In this order: subjects to be watched or bad, such as the motors; the model or why there is none; alarms about
    motors; the condition of the vehicle if there is no full model; the physical parameters of all axes; in a simulated
    log, how close they are to the truth; and the wind.

    Args:
        analysis: the analysis of one axis of the vehicle, with the model if one was learned.
        assessment: all results on a vehicle of the log: events, judgement, loops and wind.
    """
    blocks: Blocks = [*judgement_sentences(assessment.judgement).lights]
    blocks += _model_or_reason_blocks(analysis)
    blocks += _motor_alarm_sentences(analysis)
    has_full_model = analysis.learned is not None and analysis.tier.allows_full_model
    if not has_full_model:
        # The first section says which kind of model the message rates of the log allow.
        blocks += render_section("tier", analysis.tier)
        blocks += render_section("condition", analysis.condition)
    # Overrides are findings, such as an oscillation, that make all figures of the flight doubtful.
    is_flight_doubtful = bool(analysis.findings.overrides)
    blocks += vehicle_blocks(analysis.axes, is_doubtful=is_flight_doubtful)
    if analysis.truth is not None:
        blocks += truth_blocks(analysis.truth)
    blocks += air_blocks(assessment)
    return blocks


def _motor_alarm_sentences(analysis: LogAnalysis) -> list[Sentence]:
    """Returns a sentence for each time in flight at which a motor recovered, or the motors' steady torque changed.

    A motor that lost thrust raises an alarm as well, but has no sentence here: the status light of the motors, which
    stands above, reports it.

    Args:
        analysis: the analysis of one axis of the vehicle, with the alarms of motors in the order of time.
    """
    sentences = []
    for alarm in analysis.alarms:
        is_loss_of_thrust = alarm.is_weak
        if not is_loss_of_thrust:
            sentences.append(Sentence(str(alarm.fact), lead="Motors:"))
    return sentences


def instance_blocks(assessment: Assessment) -> Blocks:
    """Returns two tables on sensors and other parts that a vehicle has several of: how they agree, and each one.

    The first table says which sensors can be trusted, since they agree with others. The second has a row for every
    instance of a battery, sensor, estimator or motor output. A table is left out if the vehicle was not judged by it.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
    """
    blocks: Blocks = []
    evidence = assessment.evidence
    if evidence is None:
        return blocks
    if evidence.trust:
        blocks.append(trust_table(evidence.trust))
    if assessment.instances:
        vibration = assessment.lights[Light.VIBRATION]
        blocks.append(instance_table(assessment.instances, vibration, has_flown=evidence.has_flown))
    return blocks


def _model_or_reason_blocks(analysis: LogAnalysis) -> Blocks:
    """Returns the report on the model of an axis or, without a model, a sentence why there is none.

    Args:
        analysis: analysis of the axis.

    Returns:
        The report, or the sentence, such as "No model: the flight is too short"; empty if the reason is not known.
    """
    learned = analysis.learned
    if learned is not None:
        # Without a full model, the motors in hover are described with the vehicle's condition, after this report.
        describes_hover = analysis.tier.allows_full_model
        hover = analysis.condition.hover if describes_hover else None
        return _model_blocks(analysis.findings, learned, analysis.held_out, hover)
    if analysis.reason is not None:
        return [Sentence(str(analysis.reason), lead="No model:")]
    return []


def _model_blocks(
    findings: Findings,
    learned: Learned,
    held_out: HeldOut | None = None,
    hover: HoverFigures | None = None,
) -> Blocks:
    """Returns the report on a model: its grades, the motors, the wind torque, errors of its forecasts, and warnings.

    Args:
        findings: grades of the model by purpose, and warnings.
        learned: the linear model that was learned from a flight, with its training data.
        held_out: forecasts of windows of the flight that no model was trained on; None if there are none.
        hover: command and headroom of each motor in hover; None if they are not known.
    """
    blocks: Blocks = [*purpose_tables(findings)]
    blocks += motor_blocks(learned, hover)
    blocks += torque_blocks(learned)
    blocks += prediction_blocks(Labels.of(learned), held_out)
    blocks += [warning(fact) for fact in findings.warnings]
    return blocks


def purpose_tables(findings: Findings) -> Blocks:
    """Returns a table of what a model is good for: a row for each purpose, such as forecasts, with grade and reason.

    Args:
        findings: findings on the model, with its grade for each purpose.

    Returns:
        A list with the table; empty without a model.
    """
    rows: list[list[str]] = []
    for purpose, grade, reason in findings.purposes:
        grade_cell = Rated(grade, grade.level)
        rows.append([str(purpose), grade_cell, reason.sentence_and_remedy])
    if not rows:
        return []
    return [Table(["purpose", "grade", "reason"], rows, words=True)]


class JudgementSentences(NamedTuple):
    """The judgement of a flight in sentences."""

    headline: Sentence
    """The one sentence that matters most."""

    lights: list[Sentence]
    """Each light that is bad or to be watched, except one that is the headline."""

    next_step: Sentence
    """What to do next."""


def judgement_sentences(judgement: Judgement) -> JudgementSentences:
    """Returns the judgement of a flight in sentences: its headline, the status lights that warn, and the next step.

    A status light is the judgement of one subject, such as the motors, with a level; it warns if the level is "watch"
    or "bad". A light that is itself the headline is not repeated.

    Args:
        judgement: headline, status lights and next step of the flight.
    """
    light_sentences = []
    for name, light in judgement.lights.items():
        if light.is_watch_or_bad and light != judgement.headline:
            light_sentences.append(Sentence(str(light), lead=f"{name.capitalize()}:"))
    heading = headline_sentence(headline(judgement.headline))
    next_step = Sentence(str(judgement.next_step), lead="Next:")
    return JudgementSentences(heading, light_sentences, next_step)


def flight_sentences(assessment: Assessment, *, has_headline_above: bool) -> list[Sentence]:
    """Returns sentences that say which flight and vehicle of a recording is reported, and the verdicts on the others.

    A recording with several flights or vehicles is reported by its worst flight and its worst vehicle. A verdict is the
    headline of one flight or vehicle: its worst problem, or that none was found.

    Args:
        assessment: assessment of the worst flight of the worst vehicle. Flights that were not assessed one by one, and
            a single vehicle, have no verdicts.
        has_headline_above: whether the headline of the report stands above, so that the verdict on the worst flight,
            which says the same, is left out here.

    Returns:
        The sentences, verdicts with the worst first; empty for a single flight of a single vehicle.
    """
    facts = []
    if has_headline_above and assessment.flight_of_headline is not None:
        # Several flights were assessed together. This fact says in which of them the event in the headline was.
        facts.append(assessment.flight_of_headline)
    facts += _reported_flight_and_verdicts(
        assessment.flight_verdicts, has_headline_above=has_headline_above
    )
    facts += _reported_vehicle_and_verdicts(assessment.vehicle_verdicts)
    return [Sentence(fact.sentence) for fact in facts]


def _reported_flight_and_verdicts(
    verdicts: Sequence[FlightVerdict], *, has_headline_above: bool
) -> list[Fact]:
    """Returns facts that say which flight of a recording this report is about, and how its flights were judged.

    The report is about the worst flight.

    Args:
        verdicts: the judgement of each flight, the worst first; empty for a recording of a single flight.
        has_headline_above: whether the report shows the judgement of the worst flight above, as its headline. Then it
            is left out here.
    """
    if not verdicts:
        return []
    worst_flight, *other_flights = verdicts
    facts = [Fact(SessionFact.FLIGHT_OF_RECORDING, number=worst_flight.number)]
    if not has_headline_above:
        facts.append(worst_flight.fact)
    facts += [verdict.fact for verdict in other_flights]
    return facts


def _reported_vehicle_and_verdicts(verdicts: Sequence[VehicleVerdict]) -> list[Fact]:
    """Returns which vehicle of a recording is reported, and how the others were judged, as facts.

    Args:
        verdicts: the judgement of each vehicle, the worst first, which is reported; empty for a single vehicle.
    """
    if not verdicts:
        return []
    worst_vehicle, *other_vehicles = verdicts
    reported_vehicle = Fact(
        SessionFact.VEHICLE_OF_RECORDING,
        name=worst_vehicle.name,
        names=[verdict.name for verdict in other_vehicles],
        count=len(verdicts),
    )
    return [reported_vehicle, *(verdict.fact for verdict in other_vehicles)]


def warnings_of_lights(judgement: Judgement, light_names: Sequence[Light]) -> list[Sentence]:
    """Returns a sentence with advice for each of the named status lights that warns: its level is watch or bad.

    A status light is the judgement of one subject, such as the wind. A command that reports on one subject, such as
    ``mavdem wind``, ends with the lights that concern this subject instead of all eight.

    Args:
        judgement: headline, next step and all status lights of the flight.
        light_names: lights to report, in the order of the sentences.

    Returns:
        Sentences that begin with the name of the light, such as "Wind:"; none for lights that are good or unknown.
    """
    warnings = []
    for light_name in light_names:
        light = judgement.lights[light_name]
        if light.is_watch_or_bad:
            lead = f"{light_name.capitalize()}:"
            warnings.append(Sentence(light.sentence_and_remedy, lead))
    return warnings


def remarks_on_wind(judgement: Judgement) -> list[Sentence]:
    """Returns the sentence "Lean: the mean lean is 40 % of the lean allowed." and warnings that concern the wind.

    The lean against the wind shows a pilot whether the vehicle can fly in such a wind. It is known even if the drag of
    the vehicle, and with it the speed of the wind, is known only roughly.

    Args:
        judgement: headline, next step and all status lights of the flight.

    Returns:
        The sentence on the lean, which also states a warning of the wind light, and a warning of the estimator's light.
        Without a lean to report, only the warnings of the two lights (``WIND_LIGHTS``).
    """
    wind_light = judgement.lights[Light.WIND]
    if not _states_lean(wind_light):
        return warnings_of_lights(judgement, WIND_LIGHTS)
    (lean,) = render_section("wind_lean", light=wind_light)
    if wind_light.is_watch_or_bad:
        lean = lean._replace(level=Level.WATCH)
    return [lean, *warnings_of_lights(judgement, [Light.ESTIMATOR])]


def _states_lean(wind_light: Fact) -> bool:
    """Returns whether the status light of the wind states a lean against it that is worth a sentence.

    Args:
        wind_light: the fact of the light. If the wind is known, its figures are the mean lean as a fraction of the lean
            allowed (``share``), whether the air was still (``calm``), and why the wind is in doubt (``reason``).
    """
    if wind_light.code is not WindLight.WIND_BLEW:
        # The wind is unknown.
        return False
    leans = wind_light.figures["share"] > 0
    is_still_air = wind_light.figures["calm"]
    # The wind follows from the lean, so that a doubt of the wind is one of the lean, too.
    is_in_doubt = wind_light.figures["reason"] is not None
    return leans and not is_still_air and not is_in_doubt


def assessment_blocks(findings: Findings, judgement: Judgement | None) -> Blocks:
    """Returns the judgement of a flight as sentences without tables, for a narrow column of a dashboard.

    They come in this order: the headline, subjects to be watched or bad (such as the motors), the grade of the model
    for each purpose, the next step for the user, and warnings about the model.

    Args:
        findings: grades of the model by purpose with their reasons, and warnings.
        judgement: headline, status lights and next step; None if there is none, and then these are left out.
    """
    grades = []
    for purpose, grade, reason in findings.purposes:
        lead = f"{purpose.capitalize()}: {grade}."
        grades.append(Sentence(reason.sentence_and_remedy, lead))
    warnings = [warning(fact) for fact in findings.warnings]
    if judgement is None:
        return [*grades, *warnings]
    sentences = judgement_sentences(judgement)
    return [sentences.headline, *sentences.lights, *grades, sentences.next_step, *warnings]


def flight_title(flights: Flights, simulation_fact: Fact | None = None) -> Sentence:
    """Returns the title of a report: name of the log, axis, duration, number of segments and sampling rate.

    Args:
        flights: segments of settled flight of one log, with the data of one axis each; at least one.
        simulation_fact: the fact that the flight was simulated, which the title then states; None for a real flight.
    """
    # A flight that was made from arrays has no file.
    source = flights[0].provenance.get("source") or "Arrays"
    name = Path(str(source)).name
    (title,) = render_section("title", flights=flights, name=name, simulated=simulation_fact)
    return title


def motor_blocks(learned: Learned | None, hover: HoverFigures | None) -> Blocks:
    """Returns the report on the motors: their tables, and a sentence on the motion that they cause.

    Args:
        learned: a model of the motion; None for none. It may lack physical parameters.
        hover: figures of the motors in hover; None if they are not known.

    Returns:
        The tables (:func:`_motor_tables`), then a sentence on rate damping, time constant and delay of the motors, with
        90 % intervals, and on the mean lean in hover.
    """
    physical = None
    interval = None
    if learned is not None and learned.physical is not None:
        physical = learned.physical
        interval = physical.interval()
    sentences = render_section("motion", physical=physical, half=interval, hover=hover)
    return [*_motor_tables(learned, hover), *sentences]


def _motor_tables(learned: Learned | None, hover: HoverFigures | None) -> Blocks:
    """Returns the tables of the motors, with a row for each motor: none, one or two.

    The columns have two sources. A model gives the control effectiveness, the angular acceleration per unit of motor
    output. The hover shows how hard each motor works: its mean output, the headroom up to the limit, and the time at a
    limit. Both are in one table if the inputs of the model are these motors. If they are something else, such as the
    demand of the controller, each source has its own table.

    Args:
        learned: a model; None, or one without physical parameters, has no effectiveness.
        hover: figures of the motors in hover; None if they are not known.
    """
    tables = Blocks()
    hover_columns = {} if hover is None else _hover_columns(hover)
    if learned is not None and learned.physical is not None:
        labels = Labels.of(learned)
        effectiveness_column = _effectiveness_column(learned.physical, labels)
        if hover is not None and hover.motors == labels.input_names:
            hover_columns = effectiveness_column | hover_columns
        else:
            tables += _motor_table("input", labels.input_names, effectiveness_column)
    if hover is not None:
        tables += _motor_table("motor in settled flight", hover.motors, hover_columns)
    return tables


def motor_table_of_all_flight(figures: HoverFigures) -> Blocks:
    """Returns the table of the motors of a vehicle that hardly hovered.

    Args:
        figures: command and headroom of each motor over all flight, with manoeuvres.
    """
    return [*_motor_table("motor in all flight", figures.motors, _hover_columns(figures))]


def _hover_columns(hover: HoverFigures) -> dict[str, list[str]]:
    """Returns the columns of the table of motors that show how hard each motor works, usually in settled flight.

    They are the mean command in its unit (if it has one), the command and the headroom as percentages of the range, and
    the percentage of the time at a limit. The lower limit has a column only if a motor reached it. The deviation of a
    command from the mean of all motors is left out: it includes what lean and manoeuvres demand, and would contradict
    the trim by which the motors are judged.

    Args:
        hover: command and headroom of each motor in settled flight.

    Returns:
        Cells of each column by its header, one for each motor.
    """

    def percentages(fractions: Sequence[float], decimals: int = 1) -> list[str]:
        """Returns the cells of a column: fractions, one for each motor, in percent."""
        return [f"{100 * fraction:.{decimals}f}" for fraction in fractions]

    columns = {}
    # Commands of a bus, such as DShot, have no unit, and are shown as percentages of their range only.
    if hover.unit:
        columns[f"command ({hover.unit})"] = [f"{output:.4g}" for output in hover.trim]
    columns["of range (%)"] = percentages(hover.trim_of_range)
    columns["headroom (%)"] = percentages(hover.headroom, decimals=0)
    columns["at upper limit (%)"] = percentages(hover.at_upper_limit)
    if any(hover.at_lower_limit):
        columns["at lower limit (%)"] = percentages(hover.at_lower_limit)
    return columns


def _effectiveness_column(physical: Physical, labels: Labels) -> dict[str, list[str]]:
    """Returns the column of the table of motors with the control effectiveness of each.

    It is the angular acceleration per unit of the motor's output, °/s² per unit, with the half width of its 90 %
    interval.

    Args:
        physical: physical parameters of the axis, among them the effectiveness of each motor.
        labels: names and units of the motors.

    Returns:
        The cells, one for each motor, by the header of the column.
    """
    effects = TORQUE_UNIT.scale * physical.effect
    half_widths = TORQUE_UNIT.scale * physical.interval().effect
    cells = []
    for effect, half_width in zip(effects, half_widths, strict=True):
        cells.append(plus_minus(effect, half_width))
    unit = unit_per_input(TORQUE_UNIT, labels.input_units[0])
    return {f"effectiveness ({unit})": cells}


def _motor_table(
    kind: str, names: Sequence[str], columns: Mapping[str, list[str]]
) -> Iterator[Table]:
    """Yields a table with a row for each motor or other input, without columns in which nothing is identifiable.

    Args:
        kind: what the rows are, which heads the first column: motors, or inputs of a model.
        names: their names.
        columns: cells by the header of each column.
    """
    headers = [kind]
    rows = [[name] for name in names]
    for header, cells in columns.items():
        is_identifiable = any(cell != UNKNOWN_FIGURE for cell in cells)
        if is_identifiable:
            headers.append(header)
            for row, cell in zip(rows, cells, strict=True):
                row.append(cell)
    has_figures = len(headers) > 1
    if has_figures:
        yield Table(headers, rows)


def torque_blocks(learned: Learned) -> Blocks:
    """Returns the sentence on the wind torque of a model: its standard deviation, its largest gust, and its share.

    The wind torque is the angular acceleration, rad/s², that the motors do not explain; the share is relative to the
    whole angular acceleration. The torque is scaled by the control effectiveness of the motors, so that the sentence
    calls it uncertain if the interval of the effectiveness is wide.

    Args:
        learned: the linear model that was learned from a flight, with its training data.

    Returns:
        A list with the sentence; empty if the effectiveness is not identifiable, or the wind torque is not larger than
        its error.
    """
    physical = learned.physical
    wind_torque = learned.resolved_wind_torque
    if physical is None or wind_torque is None:
        return []
    largest_gust = max(wind_torque.gusts, key=lambda gust: abs(gust.size), default=None)
    start_time = None
    if largest_gust is not None:
        start_time = sample_times(learned.record)[largest_gust.sample]
    sentences = render_section(
        "torque",
        wind=wind_torque,
        largest=largest_gust,
        began=start_time,
        is_uncertain=wind_torque.scale_error > MAX_RELATIVE_HALF_WIDTHS["wind"],
        share=physical.wind_share,
    )
    return [*sentences]


def prediction_blocks(labels: Labels, held_out: HeldOut | None) -> Blocks:
    """Returns a table of forecast errors on held-out data, of a learned model and of the baselines, with a remark.

    Args:
        labels: names and units of the outputs.
        held_out: forecasts in windows of the flight on which no model was trained; None if there are none.

    Returns:
        A table with a row for each method, the best first: its RMSE of each output, and its error ratio (NMSE). After
        it a sentence on how much the windows differ. Empty without windows.
    """
    if held_out is None:
        return []
    sentences = render_section(
        "prediction",
        windows=len(held_out),
        quartiles=held_out.error_ratio_quartiles,
        worse=held_out.worse_shares,
        coverage=held_out.coverage,
    )
    return [_forecast_error_table(labels, held_out), *sentences]


def _forecast_error_table(labels: Labels, held_out: HeldOut) -> Table:
    """Returns the table of forecast errors: a row for each method, the best first, and a column for each output.

    Args:
        labels: names and units of the outputs, such as the roll angle in rad, which is shown in degrees.
        held_out: errors of the forecasts of each method, over windows that no model was trained on.
    """
    units = [display_unit(unit) for unit in labels.output_units]
    output_headers = []
    for name, unit in zip(labels.output_names, units, strict=True):
        output_headers.append(name_with_unit(name, unit.name))
    rows = []
    for forecast in held_out.ranked_errors:
        name_template = FORECAST_NAMES.get(forecast.name, str(forecast.name))
        # In the name of the model's own forecast, {} stands for the name of the model. Other names are not changed.
        name = name_template.format(held_out.model)
        errors = []
        for unit, rmse in zip(units, forecast.rmse, strict=True):
            errors.append(rounded(unit.scale * rmse))
        rows.append([name, *errors, rounded(forecast.error_ratio)])
    windows = counted(len(held_out), "held-out window")
    first_header = f"RMSE, {held_out.seconds:.2g} s ahead, {windows}"
    return Table([first_header, *output_headers, "error ratio"], rows)


def vehicle_blocks(axes: Mapping[str, AxisEstimates], *, is_doubtful: bool) -> Blocks:
    """Returns a table of the physical parameters of a vehicle, a row for each axis, and why figures are missing in it.

    Args:
        axes: physical parameters and wind torque by axis; an axis without any figure has no row.
        is_doubtful: whether the flight itself is doubtful, because of an oscillation for example. Then the reasons come
            without the advice to learn more from another flight.

    Returns:
        The table, and a sentence for each reason.
    """
    rows = _axis_rows(axes)
    blocks = Blocks()
    if rows:
        blocks.append(Table(_axis_header(axes), rows))
    # Axes without physical parameters, each with the reason.
    axes_without_parameters = []
    for axis, estimates in axes.items():
        if estimates.reason:
            axes_without_parameters.append((axis, estimates.reason))
            continue
        # Single parameters of the axis may be biased or not identifiable.
        reasons = parameter_reasons(estimates.physical, is_doubtful=is_doubtful)
        if reasons:
            blocks.append(Sentence(" ".join(reasons), lead=f"{axis.capitalize()}:"))
    if is_doubtful:
        return blocks + sentences_by_axes(axes_without_parameters)
    reasons_with_advice = sentences_by_axes(
        axes_without_parameters, attrgetter("sentence_and_remedy")
    )
    return blocks + reasons_with_advice


def _axis_rows(axes: Mapping[str, AxisEstimates]) -> list[list[str]]:
    """Returns the rows of the table of physical parameters: axis, figures (:func:`_axis_cells`), name of the model.

    Args:
        axes: physical parameters and wind torque by axis; an axis without any figure has no row.
    """
    rows = []
    for axis, estimates in axes.items():
        figures = _axis_cells(estimates)
        is_any_figure_known = any(figure != UNKNOWN_FIGURE for figure in figures)
        model = UNKNOWN_FIGURE if estimates.physical is None else estimates.physical.model
        if is_any_figure_known:
            rows.append([axis, *figures, model])
    return rows


def _axis_header(axes: Mapping[str, AxisEstimates]) -> list[str]:
    """Returns the header of the table of physical parameters, in which each axis has a row.

    The control effectiveness is an angular acceleration per unit of the model's inputs, such as motor outputs in
    percent, and the header names that unit. All axes of a vehicle have the same one.

    Args:
        axes: physical parameters by axis; an axis whose data could not be used has no flights.
    """
    input_unit = ""
    for estimates in axes.values():
        if estimates.flights:
            # All inputs of a model have the same unit, and so have those of all axes.
            input_unit = estimates.flights[0].input_units[0]
            break
    effectiveness_unit = unit_per_input(TORQUE_UNIT, input_unit)
    return [
        # Above the names of the axes stands which part of the flight the table is about.
        "all settled flight",
        f"mean effectiveness ({effectiveness_unit})",
        "rate damping (1/s)",
        "time constant (ms)",
        "wind torque, sd (°/s²)",
        "model",
    ]


def _axis_cells(estimates: AxisEstimates) -> list[str]:
    """Returns an axis' row in the table of physical parameters: effectiveness, damping, time constant, wind torque.

    A parameter has the half width of its 90 % interval and, if the closed loop biases its estimate, "(biased)". The
    wind torque is shown by its standard deviation. The units are in the header (:func:`_axis_header`).

    Args:
        estimates: estimates of the physical parameters and of the wind torque of the axis.

    Returns:
        Four cells, with a dash for what is not known.
    """
    physical = estimates.physical
    if physical is None:
        return [UNKNOWN_FIGURE] * 4
    wind_torque_cell = UNKNOWN_FIGURE
    if estimates.resolved_wind is not None:
        wind_torque_cell = rounded(TORQUE_UNIT.scale * estimates.resolved_wind.sd)
    return [*_parameter_cells(physical), wind_torque_cell]


def _parameter_cells(physical: Physical) -> list[str]:
    """Returns mean effectiveness, rate damping and motor time constant (ms) of an axis with their 90 % intervals.

    Args:
        physical: the estimated parameters of the axis, each with its status, such as biased.

    Returns:
        Three cells, such as "8.1 ± 0.4"; "(biased)" follows where the closed loop biases an estimate.
    """
    half_widths = physical.interval()
    effect, effect_half_width = physical.mean_effect()
    milliseconds_per_second = 1e3
    # The keys are the names of the parameters in ``physical.status``, where "lag" is the motor time constant.
    parameter_texts = {
        "effect": plus_minus(TORQUE_UNIT.scale * effect, TORQUE_UNIT.scale * effect_half_width),
        "damping": plus_minus(physical.damping, half_widths.damping),
        "lag": plus_minus(
            milliseconds_per_second * physical.lag, milliseconds_per_second * half_widths.lag
        ),
    }
    cells = []
    for name, text in parameter_texts.items():
        is_biased = physical.status[name] is Status.BIASED
        cells.append(f"{text} (biased)" if is_biased else text)
    return cells


def parameter_reasons(physical: Physical | None, *, is_doubtful: bool = False) -> list[str]:
    """Returns why physical parameters of an axis are biased or not identifiable, such as too little excitation.

    Args:
        physical: the parameters, each with its status and the reason for that; None without any.
        is_doubtful: whether the flight itself is doubtful; then the reasons come without advice.

    Returns:
        A text for each reason, which begins with the parameters that it applies to: "Rate damping biased: REASON".
    """
    if physical is None:
        return []
    # A parameter that is reported has no reason.
    reasons = {name: reason for name, reason in physical.reasons.items() if reason is not None}
    have_all_same_status = len(set(physical.status.values())) == 1
    if have_all_same_status and "effect" in reasons:
        # The other parameters follow from the effectiveness, so that its reason is the cause of theirs.
        reasons = {"effect": reasons["effect"]}

    def reason_text(name: str) -> str:
        """Returns the reason for the status of a parameter, with advice unless the flight is doubtful."""
        return reasons[name].sentence if is_doubtful else reasons[name].sentence_and_remedy

    texts = []
    for text, names in group_by(reasons, reason_text).items():
        parameters = listed([f"{PARAMETERS[name]} {physical.status[name]}" for name in names])
        texts.append(f"{parameters.capitalize()}: {text}")
    return texts


def detail_blocks(learned: Learned) -> Blocks:
    """Returns the details of a model that the terminal leaves out: cautions, poles, and how it was learned.

    Learning maximises the free energy F̄, nats. The sentences say by how much it increased, and by how much the
    objective of the output-error fit did, if such a fit followed.

    Args:
        learned: the linear model that was learned from a flight, with its training data.
    """
    free_energy = learned.free_energy
    simulation_fit = learned.simulation_fit
    objective_increase = 0.0
    if simulation_fit is not None:
        # Each term of the objective has a value for every iteration of the fit.
        terms = simulation_fit.terms.values()
        objective_increase = sum(term[-1] - term[0] for term in terms)
    learning = render_section(
        "learning",
        learned=learned,
        gained=free_energy.gained,
        iterations=len(free_energy) - 1,
        end=free_energy[-1],
        fit=simulation_fit,
        fit_gained=objective_increase,
    )
    cautions = [caution(fact) for fact in learned.cautions]
    return [*cautions, *pole_sentences(learned.model.A), *learning]


def pole_sentences(A: Array) -> list[Sentence]:
    """Returns a sentence on the poles of a model, the slowest first, and on whether it is stable.

    A complex pair of poles p has the natural frequency |p|/2π, Hz, and the damping ratio −Re p/|p|. A real pole has the
    time constant 1/|p|, s.

    Args:
        A: state matrix (n, n), 1/s, whose eigenvalues are the poles.
    """
    # A complex pair is represented by the pole with the positive imaginary part.
    poles = [pole for pole in np.linalg.eigvals(A) if pole.imag >= 0]
    poles.sort(key=lambda pole: pole.real, reverse=True)
    return render_section("poles", poles=poles)
