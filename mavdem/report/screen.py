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
from mavdem.assessment.judgement import Judgement
from mavdem.dem import Learned
from mavdem.experiments.held_out import FORECAST, PREDICTION, HeldOut
from mavdem.facts import Fact
from mavdem.facts.identifiability import Status
from mavdem.facts.lights import Light
from mavdem.facts.model import ModelName
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
from mavdem.report.condition import air_blocks
from mavdem.report.instances import instance_table
from mavdem.report.labels import Labels
from mavdem.report.numbers import (
    NO_ESTIMATE,
    TORQUE_UNIT,
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

UNKNOWN_FIGURE = "-"
"""What a table shows in the place of a figure that is not known."""


def model_screen(learned: Learned) -> Blocks:
    """Returns the report of a model alone, without its log and without windows held out from its training."""
    findings = model_findings(learned)
    next_step = Sentence(str(next_step_for_model(findings.purposes)), "Next:")
    return [*_model_blocks(findings, learned), next_step]


def summary(learned: Learned) -> str:
    """Returns the report of a model alone as text, with its cautions."""
    cautions = [caution(fact) for fact in learned.cautions]
    return plain_text([*model_screen(learned), *cautions])


def analysis_blocks(assessment: Assessment) -> Blocks:
    """Returns the report of a log: headline, findings, and next step.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.

    Returns:
        The report, with the headline first and the next step last.
    """
    judgement = judgement_sentences(assessment.judgement)
    if assessment.analysis is None:
        # No vehicle was analysed, so that there are no figures between the headline and the next step.
        return [judgement.headline, *judgement.lights, judgement.next_step]
    body = analysis_body(assessment.analysis, assessment)
    return [judgement.headline, *body, judgement.next_step]


def analysis_body(analysis: LogAnalysis, assessment: Assessment) -> Blocks:
    """Returns the findings of a log: lights that warn, the model or why there is none, condition, and wind.

    A light is the judgement of one subject, such as the motors. Without a full model, sentences take its place on the
    tier of the log, which is the kind of model that its message rates allow, and on the vehicle's condition.

    Args:
        analysis: the analysis of one axis of the vehicle, with the model if one was learned.
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.

    Returns:
        The report without its headline and next step.
    """
    has_full_model = analysis.learned is not None and analysis.tier.allows_full_model
    blocks = [*judgement_sentences(assessment.judgement).lights, *_learned_blocks(analysis)]
    for alarm in analysis.alarms:
        if not alarm.is_weak:
            blocks.append(Sentence(str(alarm.fact), "Motors:"))
    if not has_full_model:
        blocks += render_section("tier", analysis.tier)
        blocks += render_section("condition", analysis.condition)
    # Overrides are facts, such as an oscillation, that make all figures of the flight doubtful.
    is_flight_doubtful = bool(analysis.findings.overrides)
    blocks += vehicle_blocks(analysis.axes, is_doubtful=is_flight_doubtful)
    if analysis.truth is not None:
        blocks += truth_blocks(analysis.truth)
    return [*blocks, *air_blocks(assessment)]


def instance_blocks(assessment: Assessment) -> Blocks:
    """Returns the tables of what can be trusted, and of every instance, as far as a vehicle was judged.

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
        blocks.append(instance_table(assessment.instances, has_flown=evidence.has_flown))
    return blocks


def _learned_blocks(analysis: LogAnalysis) -> Blocks:
    """Returns the report of a log's model or, without one, the reason where there is one.

    Args:
        analysis: analysis of the axis, with the model or the reason why there is none.
    """
    if analysis.learned is None:
        if analysis.reason is None:
            return []
        return [Sentence(str(analysis.reason), "No model:")]
    hover = analysis.condition.hover if analysis.tier.allows_full_model else None
    return _model_blocks(analysis.findings, analysis.learned, analysis.held_out, hover)


def _model_blocks(
    findings: Findings,
    learned: Learned,
    held_out: HeldOut | None = None,
    hover: HoverFigures | None = None,
) -> Blocks:
    """Returns the report of a model: grades, motors, wind torque, errors of the prediction, and warnings.

    Args:
        findings: grades of the model by purpose, and warnings.
        learned: the linear model that was learned from a flight, with its training data.
        held_out: forecasts of windows that no model was trained on; None without.
        hover: command and headroom of each motor in hover; None if they are not known.
    """
    return [
        *purpose_tables(findings),
        *motor_blocks(learned, hover),
        *torque_blocks(learned),
        *prediction_blocks(Labels.of(learned), held_out),
        *[warning(fact) for fact in findings.warnings],
    ]


def purpose_tables(findings: Findings) -> Blocks:
    """Returns a table with the grade of a model for each purpose, and the reason.

    Args:
        findings: findings on the model, with its grade for each purpose.

    Returns:
        The table; empty without a model.
    """
    rows: list[list[str]] = [
        [str(purpose), Rated(grade, grade.level), reason.sentence_and_remedy]
        for purpose, grade, reason in findings.purposes
    ]
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
    """Returns the judgement of a flight in sentences: its headline, the lights that warn, and the next step.

    A light is the judgement of one subject, such as the motors: a fact whose level is good, watch, bad or unknown. It
    warns if the level is watch or bad.

    Args:
        judgement: headline, status lights and next step. A light that is the headline itself is not repeated.
    """
    lights = [
        Sentence(str(fact), f"{name.capitalize()}:")
        for name, fact in judgement.lights.items()
        if fact.warns and fact != judgement.headline
    ]
    heading = headline_sentence(headline(judgement.headline))
    return JudgementSentences(heading, lights, Sentence(str(judgement.next_step), "Next:"))


def warnings_of_lights(judgement: Judgement, names: Sequence[Light]) -> list[Sentence]:
    """Returns a sentence with advice on each of some lights, where the light is bad or to be watched.

    A light is the judgement of one subject, such as the wind: a fact with a level. A command that reports on one
    subject, such as ``mavdem wind``, ends with the lights that concern this subject instead of all eight.

    Args:
        judgement: headline, next step and all status lights of the flight.
        names: names of the lights to report, in the order to show them.
    """
    sentences = []
    for name in names:
        light = judgement.lights[name]
        if light.warns:
            sentences.append(Sentence(light.sentence_and_remedy, f"{name.capitalize()}:"))
    return sentences


def assessment_blocks(findings: Findings, judgement: Judgement | None) -> Blocks:
    """Returns the judgement of a flight as sentences without tables, for a narrow column of a dashboard.

    The most important comes first: headline and lights that need attention, the grade of the model for each purpose,
    the next step for the user, and warnings.

    Args:
        findings: grades of the model by purpose with their reasons, and warnings.
        judgement: headline, lights and next step; None if there is none, and then these are left out.

    Returns:
        The sentences.
    """
    grades = [
        Sentence(reason.sentence_and_remedy, f"{purpose.capitalize()}: {grade}.")
        for purpose, grade, reason in findings.purposes
    ]
    warnings = [warning(fact) for fact in findings.warnings]
    if judgement is None:
        return [*grades, *warnings]
    headline_of_flight, lights, next_step = judgement_sentences(judgement)
    return [headline_of_flight, *lights, *grades, next_step, *warnings]


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
    """Returns the report on the motors: tables of each motor, and of the motion that they cause as a sentence.

    There are two sources. A model gives the control effectiveness: the angular acceleration per unit of motor output.
    The hover figures tell how hard each motor works: its mean output as flown, the headroom up to the limit, and the
    time at a limit. They share one table where the inputs of the model are these motors. A model may have other inputs,
    such as the controller's demand; then each source has its own table.

    Args:
        learned: a model; None, or one without physical parameters, adds no column.
        hover: hover figures of the motors; None if they are not known.

    Returns:
        No, one or two tables, and then a sentence on rate damping, time constant, delay and mean lean.
    """
    hover_columns = {} if hover is None else _hover_columns(hover)
    physical = None if learned is None else learned.physical
    half_widths = None if physical is None else physical.interval()
    blocks = Blocks()
    if learned is not None and physical is not None:
        labels = Labels.of(learned)
        columns = _effectiveness_column(physical, labels)
        if hover is not None and hover.motors == labels.input_names:
            # The effectiveness becomes the first column of the table of hover figures, which is appended below.
            hover_columns = columns | hover_columns
        else:
            blocks += _motor_table("input", labels.input_names, columns)
    if hover is not None:
        blocks += _motor_table("motor in settled flight", hover.motors, hover_columns)
    return [*blocks, *render_section("motion", physical=physical, half=half_widths, hover=hover)]


def _hover_columns(hover: HoverFigures) -> dict[str, list[str]]:
    """Returns the columns of a table of motors: mean command, its share of the range, headroom, and time at the limits.

    The commands are as flown. The deviation of one from their mean is left out: it includes what lean and manoeuvres
    ask for, so that it would contradict the trim that the light of the motors judges.

    The lower limit has a column only if a motor reached it.

    Args:
        hover: command and headroom of each motor in settled flight.

    Returns:
        Cells of each column by its header, one for each motor.
    """
    # Commands of a bus, such as DShot, have no unit, so they are shown as shares of their range.
    if hover.unit:
        columns = {f"command ({hover.unit})": [f"{output:.4g}" for output in hover.trim]}
    else:
        columns = {}
    columns |= {
        "of range (%)": [f"{100 * share:.1f}" for share in hover.trim_of_range],
        "headroom (%)": [f"{100 * headroom:.0f}" for headroom in hover.headroom],
        "at upper limit (%)": [f"{100 * share:.1f}" for share in hover.at_upper_limit],
    }
    if any(hover.at_lower_limit):
        columns["at lower limit (%)"] = [f"{100 * share:.1f}" for share in hover.at_lower_limit]
    return columns


def _effectiveness_column(physical: Physical, labels: Labels) -> dict[str, list[str]]:
    """Returns the column of a table of motors, by its header, with each motor's control effectiveness.

    It is the angular acceleration per unit of the motor's output, °/s² per unit, with the half width of its 90 %
    interval.

    Args:
        physical: control effectiveness, damping, motor time constant and delay of the axis.
        labels: names and units of the motors.
    """
    half_widths = physical.interval().effect
    cells = [
        plus_minus(effect, half_width)
        for effect, half_width in zip(
            TORQUE_UNIT.scale * physical.effect, TORQUE_UNIT.scale * half_widths, strict=True
        )
    ]
    return {f"effectiveness ({unit_per_input(TORQUE_UNIT, labels.input_units[0])})": cells}


def _motor_table(
    kind: str, names: Sequence[str], columns: Mapping[str, list[str]]
) -> Iterator[Table]:
    """Yields a table with a row for each motor or other input, without columns in which nothing is identifiable.

    Args:
        kind: what the rows are, which heads the first column: motors, or inputs of a model.
        names: their names.
        columns: cells by the header of each column.
    """
    shown_columns = {}
    for header, cells in columns.items():
        if any(cell != NO_ESTIMATE for cell in cells):
            shown_columns[header] = cells
    if shown_columns:
        rows = zip(names, *shown_columns.values(), strict=True)
        yield Table([kind, *shown_columns], [list(row) for row in rows])


def torque_blocks(learned: Learned) -> Blocks:
    """Returns the wind torque of a model in a sentence: its standard deviation, its largest gust, and its share.

    The wind torque is the angular acceleration that the motors do not explain. It is scaled by the motors' control
    effectiveness, so that it is called uncertain if that has a wide interval.

    Args:
        learned: the linear model that was learned from a flight, with its training data.

    Returns:
        The sentence; empty if the effectiveness is not identifiable, or the wind torque is not larger than its error.
    """
    physical = learned.physical
    wind_torque = learned.resolved_wind_torque
    if physical is None or wind_torque is None:
        return []
    largest_gust = max(wind_torque.gusts, key=lambda gust: abs(gust.size), default=None)
    start = None if largest_gust is None else sample_times(learned.record)[largest_gust.sample]
    sentences = render_section(
        "torque",
        wind=wind_torque,
        largest=largest_gust,
        began=start,
        is_uncertain=wind_torque.scale_error > MAX_RELATIVE_HALF_WIDTHS["wind"],
        share=physical.wind_share,
    )
    return [*sentences]


def prediction_blocks(labels: Labels, held_out: HeldOut | None) -> Blocks:
    """Returns the errors of a model's forecasts and of the baselines over all held-out windows.

    Args:
        labels: names and units of the outputs.
        held_out: windows of the flight that the models of their forecasts were not trained on; None if there are none.

    Returns:
        A table of RMSE by output and error ratio, the best forecast first, and a sentence on how windows differ. Empty
        without windows.
    """
    if held_out is None:
        return []
    units = [display_unit(unit) for unit in labels.output_units]
    output_headers = [
        name_with_unit(name, unit.name)
        for name, unit in zip(labels.output_names, units, strict=True)
    ]
    rows = []
    for forecast in held_out.ranked_errors:
        # The name of the model's own forecast has a place for that of the model, which format() fills.
        cells = [FORECAST_NAMES.get(forecast.name, str(forecast.name)).format(held_out.model)]
        for unit, rmse in zip(units, forecast.rmse, strict=True):
            cells.append(rounded(unit.scale * rmse))
        cells.append(rounded(forecast.error_ratio))
        rows.append(cells)
    windows = counted(len(held_out), "held-out window")
    first_header = f"RMSE, {held_out.seconds:.2g} s ahead, {windows}"
    sentences = render_section(
        "prediction",
        windows=len(held_out),
        quartiles=held_out.error_ratio_quartiles,
        worse=held_out.worse_shares,
        coverage=held_out.coverage,
    )
    return [Table([first_header, *output_headers, "error ratio"], rows), *sentences]


def vehicle_blocks(axes: Mapping[str, AxisEstimates], *, is_doubtful: bool) -> Blocks:
    """Returns a table with a row for each axis of a vehicle, and the reasons why figures are missing in it.

    Args:
        axes: physical parameters and wind torque by axis; an axis without any figure has no row.
        is_doubtful: whether the flight itself is doubtful; then there is no advice to learn more from another flight.

    Returns:
        The table, and a sentence for each reason.
    """
    rows = []
    for axis, figures in axes.items():
        cells = _axis_cells(figures)
        if any(cell != UNKNOWN_FIGURE for cell in cells):
            model = UNKNOWN_FIGURE if figures.physical is None else figures.physical.model
            rows.append([axis, *cells, model])
    blocks = Blocks()
    if rows:
        blocks.append(Table(_axis_header(axes), rows))
    # Axes without physical parameters, each with the reason.
    axes_without_figures = []
    for axis, figures in axes.items():
        if figures.reason:
            axes_without_figures.append((axis, figures.reason))
            continue
        # Single parameters of the axis may be biased or not identifiable.
        reasons = parameter_reasons(figures.physical, is_doubtful=is_doubtful)
        if reasons:
            blocks.append(Sentence(" ".join(reasons), f"{axis.capitalize()}:"))
    text_of_reason = str if is_doubtful else attrgetter("sentence_and_remedy")
    return blocks + sentences_by_axes(axes_without_figures, text_of_reason)


def _axis_header(axes: Mapping[str, AxisEstimates]) -> list[str]:
    """Returns the header of the table of physical parameters, which has a row for each axis.

    Control effectiveness is an angular acceleration per unit of the model's inputs. All rows share this header, so that
    the first axis with a flight decides the unit.

    Args:
        axes: figures by axis; an axis whose data could not be used has no flights.
    """
    input_unit = ""
    for figures in axes.values():
        if figures.flights:
            input_unit = figures.flights[0].input_units[0]
            break
    return [
        "all settled flight",
        f"mean effectiveness ({unit_per_input(TORQUE_UNIT, input_unit)})",
        "rate damping (1/s)",
        "time constant (ms)",
        "wind torque, sd (°/s²)",
        "model",
    ]


def _axis_cells(figures: AxisEstimates) -> list[str]:
    """Returns the table cells of an axis: mean effectiveness, damping, motor time constant and wind torque.

    An estimate has the half width of its 90 % interval, and "(biased)" behind it where closed-loop control biases it.
    Of the wind torque the standard deviation is shown. Units are those of :func:`_axis_header`.

    Args:
        figures: physical parameters and wind torque of the axis.

    Returns:
        Four cells, with a dash for what is not known.
    """
    physical = figures.physical
    if physical is None:
        return [UNKNOWN_FIGURE] * 4
    half_widths = physical.interval()
    mean_effect, mean_effect_half_width = physical.mean_effect()
    # By the names of the parameters in ``physical.status``, where "lag" is the motor time constant.
    estimates = {
        "effect": plus_minus(
            TORQUE_UNIT.scale * mean_effect, TORQUE_UNIT.scale * mean_effect_half_width
        ),
        "damping": plus_minus(physical.damping, half_widths.damping),
        "lag": plus_minus(1e3 * physical.lag, 1e3 * half_widths.lag),
    }
    cells = []
    for name, estimate in estimates.items():
        is_biased = physical.status[name] is Status.BIASED
        cells.append(f"{estimate} (biased)" if is_biased else estimate)
    wind_torque = figures.resolved_wind
    if wind_torque is None:
        cells.append(UNKNOWN_FIGURE)
    else:
        cells.append(rounded(TORQUE_UNIT.scale * wind_torque.sd))
    return cells


def parameter_reasons(physical: Physical | None, *, is_doubtful: bool = False) -> list[str]:
    """Returns the reasons why physical parameters are biased or not identifiable, such as too little excitation.

    Args:
        physical: the parameters, each with its status and the reason for that; None gives nothing.
        is_doubtful: whether the flight itself is doubtful; then the reasons are without advice.

    Returns:
        One text for each reason, after the parameters to which it applies: "Rate damping biased: REASON".
    """
    if physical is None:
        return []
    reasons = physical.reasons
    has_same_status = len(set(physical.status.values())) == 1
    if has_same_status:
        # The other parameters follow from the effectiveness, whose reason is the cause of theirs.
        reasons = {"effect": reasons["effect"]}
    parameters_by_text = dict[str, list[str]]()
    for name, reason in reasons.items():
        if reason is not None:
            text = reason.sentence if is_doubtful else reason.sentence_and_remedy
            parameter = f"{PARAMETERS[name]} {physical.status[name]}"
            parameters_by_text.setdefault(text, []).append(parameter)
    return [
        f"{listed(parameters).capitalize()}: {text}"
        for text, parameters in parameters_by_text.items()
    ]


def detail_blocks(learned: Learned) -> Blocks:
    """Returns the details that the screen leaves out: cautions, poles, and how a model was learned, but no matrices.

    Learning is described by the gain of the free energy over its iterations, nats, both of DEM and, where there was
    one, of the fit by simulation that followed.

    Args:
        learned: the linear model that was learned from a flight, with its training data.
    """
    energy = learned.free_energy
    fit = learned.simulation_fit
    fit_gain = 0.0
    if fit is not None:
        # The objective of the fit is the sum of its terms, each of which has a value for every iteration.
        energy_at_start = sum(term[0] for term in fit.terms.values())
        energy_at_end = sum(term[-1] for term in fit.terms.values())
        fit_gain = energy_at_end - energy_at_start
    learning = render_section(
        "learning",
        learned=learned,
        gained=energy.gained,
        iterations=len(energy) - 1,
        end=energy[-1],
        fit=fit,
        fit_gained=fit_gain,
    )
    cautions = [caution(fact) for fact in learned.cautions]
    return [*cautions, *pole_sentences(learned.model.A), *learning]


def pole_sentences(A: Array) -> list[Sentence]:
    """Returns a sentence on the poles of a model, and on whether it is stable.

    A complex pair of poles p has the natural frequency |p|/2π, Hz, and the damping ratio −Re p/|p|. A real pole has the
    time constant 1/|p|, s.

    Args:
        A: state matrix (n, n), 1/s; its eigenvalues are the poles, of which the slowest come first.
    """
    # Of a complex pair, the pole with the positive imaginary part stands for both.
    poles = [pole for pole in np.linalg.eigvals(A) if pole.imag >= 0]
    return render_section("poles", poles=sorted(poles, key=lambda pole: -pole.real))
