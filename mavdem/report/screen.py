"""One screen: what a vehicle does in wind, how sure that is, and what must be known before the model is used.

``analysis_blocks`` is the screen of a log, ``screen`` that of a model alone; ``vehicle_blocks`` has all axes of a
vehicle. ``detail_blocks`` is what the screen leaves out: the model, its uncertainty and how it was learned.
"""

from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment import Assessment
from mavdem.assessment.axis import AxisFigures
from mavdem.assessment.axis.findings import (
    MAX_RELATIVE_HALF_WIDTHS,
    Findings,
    findings_of,
    next_step_for_model,
    resolved_wind_torque,
)
from mavdem.assessment.judgement import Judgement
from mavdem.dem import Learned
from mavdem.experiments.held_out import BASELINES, FORECAST, PREDICTION, HeldOut
from mavdem.facts import Fact
from mavdem.facts.identifiability import Status
from mavdem.flight import Flights
from mavdem.motors.hover import HoverFigures
from mavdem.plant import Physical
from mavdem.report.blocks import (
    Blocks,
    Rated,
    Sentence,
    Table,
    caution,
    plain_text,
    warning,
)
from mavdem.report.charts.model_charts import sample_times
from mavdem.report.condition import air_blocks
from mavdem.report.labels import Labels
from mavdem.report.numbers import (
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
from mavdem.report.truth import truth_blocks

# beside the baselines
ROWS = {
    FORECAST: "forecast, motors recorded",
    PREDICTION: "prediction, motors unknown",
}


def model_screen(learned: Learned) -> Blocks:
    """Returns what a ``learned`` model says without the log and windows that it has not seen."""
    findings = findings_of(learned)
    step = Sentence(str(next_step_for_model(findings.purposes)), "Next:")
    return [*_model_blocks(findings, learned), step]


def _model_blocks(
    findings: Findings,
    learned: Learned,
    held_out: HeldOut | None = None,
    hover: HoverFigures | None = None,
) -> Blocks:
    """What was found, the vehicle, the wind torque, prediction and warnings."""
    return [
        *purpose_tables(findings),
        *motor_blocks(learned, hover),
        *torque_blocks(learned),
        *prediction_blocks(Labels.of(learned), held_out),
        *map(warning, findings.warnings),
    ]


def purpose_tables(findings: Findings) -> Blocks:
    """Returns a row a purpose of the model, with its grade; nothing without a model."""
    rows = [
        [str(purpose), Rated(grade, grade.level), reason.advised]
        for purpose, grade, reason in findings.purposes
    ]
    return [Table(["purpose", "grade", "because"], rows, words=True)] if rows else []


def conclusion(judgement: Judgement) -> Blocks:
    """Returns the headline, each other light that is bad or to be watched, and last what to do next."""
    lights = [
        Sentence(str(fact), f"{name.capitalize()}:")
        for name, fact in judgement.lights.items()
        if fact.warns and fact != judgement.headline
    ]
    above = Sentence("", headline(judgement.headline))
    return [above, *lights, Sentence(str(judgement.next_step), "Next:")]


def assessment_blocks(findings: Findings, judgement: Judgement | None) -> Blocks:
    """Returns headline, lights and findings without a table, for a narrow column."""
    blocks = Blocks() if judgement is None else conclusion(judgement)
    blocks[-1:-1] = [
        Sentence(reason.advised, f"{purpose.capitalize()}: {grade}.")
        for purpose, grade, reason in findings.purposes
    ]
    return [*blocks, *map(warning, findings.warnings)]


def analysis_blocks(assessment: Assessment) -> Blocks:
    """Returns the screen of an ``assessment``: its model's, else what is known without one, and why there is none."""
    analysis = assessment.analysis
    if analysis is None:
        return conclusion(assessment.judgement)
    learned = analysis.learned
    *above, following = conclusion(assessment.judgement)
    if learned is None:
        above += [] if analysis.reason is None else [Sentence(str(analysis.reason), "No model:")]
    else:
        hover = analysis.condition.hover if analysis.tier.tier == "a" else None
        above += _model_blocks(analysis.findings, learned, analysis.held_out, hover)
    above += [
        Sentence(str(alarm.fact), "Motors:") for alarm in analysis.alarms if not alarm.is_weak
    ]
    if analysis.tier.tier != "a" or learned is None:
        above += render_section("tier", analysis.tier)
        above += render_section("condition", analysis.condition)
    above += vehicle_blocks(analysis.axes, bool(analysis.findings.overrides))
    above += [] if analysis.truth is None else truth_blocks(analysis.truth)
    return [*above, *air_blocks(assessment), following]


def flight_title(flights: Flights, simulated: Fact | None = None) -> Sentence:
    """Returns which log and axis the ``flights`` are of, that they are ``simulated``, and how much there is of it."""
    path = flights[0].provenance.get("source") or "Arrays"
    (said,) = render_section(
        "title", flights=flights, name=Path(str(path)).name, simulated=simulated
    )
    return said


def summary(learned: Learned) -> str:
    """Returns the screen as text, of what the ``learned`` model alone knows: without windows that it has not seen."""
    return plain_text([*model_screen(learned), *map(caution, learned.cautions)])


def motor_blocks(learned: Learned | None, hover: HoverFigures | None) -> Blocks:
    """Returns a row a motor, with its effectiveness, trim, headroom and saturation; and what is of all motors.

    Where the model ``learned`` has other inputs than motors, these have a table of their own.
    """
    blocks = Blocks()
    columns = dict[str, list[str]]()
    if hover is not None:
        trim = f"trim ({hover.unit})" if hover.unit else "trim"
        columns = {
            trim: [f"{output:.4g}" for output in hover.trim],
            "trim deviation (% of mean)": [
                f"{round(more, 1) + 0.0:+.1f}" for more in hover.imbalance
            ],
            "headroom (%)": [f"{100 * left:.0f}" for left in hover.headroom],
        }
        limits = {"upper": hover.at_upper_limit, "lower": hover.at_lower_limit}
        for limit, shares in limits.items():
            if limit == "upper" or any(shares):
                columns[f"at {limit} limit (%)"] = [f"{100 * share:.1f}" for share in shares]
    physical = None if learned is None else learned.physical
    half = None
    if learned is not None and physical is not None:
        labels = Labels.of(learned)
        half = physical.interval()
        effect = zip(
            TORQUE_UNIT.scale * physical.effect, TORQUE_UNIT.scale * half.effect, strict=True
        )
        cells = [plus_minus(*pair) for pair in effect]
        effects = {f"effectiveness ({unit_per_input(TORQUE_UNIT, labels.input_units[0])})": cells}
        if hover is not None and hover.motors == labels.input_names:
            columns = effects | columns
        else:
            blocks.append(_by_motor(labels.input_names, effects))
    if hover is not None:
        blocks.append(_by_motor(hover.motors, columns))
    return [*blocks, *render_section("motion", physical=physical, half=half, hover=hover)]


def _by_motor(motors: Sequence[str], columns: dict[str, list[str]]) -> Table:
    rows = zip(motors, *columns.values(), strict=True)
    return Table(["vehicle", *columns], [list(row) for row in rows])


def torque_blocks(learned: Learned) -> Blocks:
    """Returns the wind torque: its level, share and gusts; nothing where it is not known."""
    physical = learned.physical
    wind = resolved_wind_torque(learned.wind_torque, physical)
    if physical is None or wind is None:
        return []
    largest = max(wind.gusts, key=lambda gust: abs(gust.size), default=None)
    is_uncertain = wind.scale_error > MAX_RELATIVE_HALF_WIDTHS["wind"]
    return [
        *render_section(
            "torque",
            wind=wind,
            largest=largest,
            began=largest and sample_times(learned.record)[largest.sample],
            is_uncertain=is_uncertain,
            share=physical.wind_share,
        )
    ]


def prediction_blocks(labels: Labels, held_out: HeldOut | None) -> Blocks:
    """Returns the RMSE beside the baselines over all held-out windows, and how windows differ."""
    if held_out is None:
        return []
    units = [display_unit(unit) for unit in labels.output_units]
    pairs = zip(labels.output_names, units, strict=True)
    names = [name_with_unit(name, unit.name) for name, unit in pairs]
    rows = []
    count = counted(len(held_out), "held-out window")
    for name in sorted(held_out.forecasts, key=held_out.error_ratio):
        rmse = (unit.scale * value for unit, value in zip(units, held_out.rmse(name), strict=True))
        rows.append([ROWS.get(name, name), *map(rounded, (*rmse, held_out.error_ratio(name)))])
    worse = {name: (held_out.error_ratios(name) > 1).mean() for name in BASELINES}
    quartiles = np.percentile(held_out.error_ratios(), [25, 50, 75])
    windows = len(held_out)
    return [
        Table([f"RMSE, {held_out.seconds:.2g} s ahead, {count}", *names, "error ratio"], rows),
        *render_section(
            "prediction",
            windows=windows,
            quartiles=quartiles,
            worse=worse,
            coverage=held_out.coverage,
        ),
    ]


def vehicle_blocks(axes: Mapping[str, AxisFigures], doubted: bool) -> Blocks:
    """Returns a row for each of the ``axes`` that anything is known of, and the reasons for what is not reported."""
    unit = next(
        (analysis.flights[0].input_units[0] for analysis in axes.values() if analysis.flights), ""
    )
    header = ["all settled flight", f"mean effectiveness ({unit_per_input(TORQUE_UNIT, unit)})"]
    header += ["rate damping (1/s)", "time constant (ms)", "wind torque, sd (°/s²)"]
    rows = {
        name: row for name, analysis in axes.items() if {*(row := _axis_row(analysis))} != {"-"}
    }
    blocks = Blocks()
    if rows:
        blocks.append(Table(header, [[name, *row] for name, row in rows.items()]))
    refused = [(name, analysis.reason) for name, analysis in axes.items() if analysis.reason]
    for name, analysis in axes.items():
        reasons = parameter_reasons(analysis.physical, doubted)
        if reasons and not analysis.reason:
            blocks.append(Sentence(" ".join(reasons), f"{name.capitalize()}:"))
    return blocks + sentences_by_axes(refused, str if doubted else attrgetter("advised"))


def _axis_row(axis: AxisFigures) -> list[str]:
    physical = axis.physical
    wind = resolved_wind_torque(axis.wind, axis.physical)
    if physical is None:
        return ["-"] * 4
    _, damping, lag, _ = physical.interval()
    mean, half = (TORQUE_UNIT.scale * value for value in physical.mean_effect())
    estimates = {
        "effect": (mean, half),
        "damping": (physical.damping, damping),
        "lag": (1e3 * physical.lag, 1e3 * lag),
    }
    shown = [
        plus_minus(*pair) + " (biased)" * (physical.status[name] is Status.BIASED)
        for name, pair in estimates.items()
    ]
    return [*shown, "-" if wind is None else rounded(TORQUE_UNIT.scale * wind.sd)]


def parameter_reasons(physical: Physical | None, doubted: bool = False) -> list[str]:
    """Returns why ``physical`` parameters are not reported, each reason once; without advice if all is ``doubted``."""
    if physical is None:
        return []
    says = str if doubted else attrgetter("advised")
    parameters = dict[str, list[str]]()
    reasons = physical.reasons
    if len({*physical.status.values()}) == 1:
        # What is wrong with the effectiveness is enough to know.
        reasons = {"effect": reasons["effect"]}
    for name, reason in reasons.items():
        if reason is not None:
            parameter = f"{PARAMETERS[name]} {physical.status[name]}"
            parameters.setdefault(says(reason), []).append(parameter)
    return [f"{listed(names).capitalize()}: {reason}" for reason, names in parameters.items()]


def detail_blocks(learned: Learned) -> Blocks:
    """Returns cautions, the poles of the ``learned`` model and how it was learned; ``model.json`` has its matrices."""
    energy = learned.free_energy
    fit = learned.simulation_fit
    start, end = (sum(term[i] for term in fit.terms.values()) if fit else 0.0 for i in (0, -1))
    learning = render_section(
        "learning",
        learned=learned,
        gained=energy.gained,
        iterations=len(energy) - 1,
        end=energy[-1],
        fit=fit,
        fit_gained=end - start,
    )
    return [*map(caution, learned.cautions), *pole_sentences(learned.model.A), *learning]


def pole_sentences(A: Array) -> list[Sentence]:
    """Returns the eigenvalues of A, the slowest first, one of each complex pair, and whether the model is stable.

    With natural frequency |p|/2π and damping ratio −Re p/|p| if complex, else with the time constant 1/|p|.
    """
    upper = (value for value in np.linalg.eigvals(A) if value.imag >= 0)
    return render_section("poles", poles=sorted(upper, key=lambda value: -value.real))
