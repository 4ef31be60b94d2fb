"""One screen: what a vehicle does in wind, how sure that is, and what must be known before the model is used.

``analysis_blocks`` is the screen of a log, ``screen`` that of a model alone; ``vehicle_blocks`` has all axes of a
vehicle. ``detail_blocks`` is what the screen leaves out: the model, its uncertainty and how it was learned.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, sqrt
from pathlib import Path

import numpy as np

from mavdem.analysis import AxisFigures, VehicleFigures
from mavdem.analysis.figures import one_step_errors
from mavdem.analysis.findings import HALF_WIDTH, Findings, findings_of, known_wind, next_step
from mavdem.assessment import Assessment
from mavdem.assessment.judgement import Judgement
from mavdem.condition.condition import HoverFigures
from mavdem.confidence import LEVEL
from mavdem.dem import Learned, Physical, WindTorque
from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import unpack
from mavdem.evaluate.held_out import BASELINES, FORECAST, PREDICTION, HeldOut
from mavdem.facts import Level
from mavdem.facts.identifiability import Status
from mavdem.flight import Flight
from mavdem.report.blocks import (
    Block,
    Rated,
    Sentence,
    Table,
    caution,
    text_of,
    warning,
)
from mavdem.report.condition import air_blocks
from mavdem.report.labels import Labels, outputs_of, state_names, states_are_outputs
from mavdem.report.numbers import (
    TORQUE,
    listed,
    per,
    plus_minus,
    readable,
    rounded,
    short,
    with_unit,
)
from mavdem.report.truth import truth_blocks
from mavdem.report.words import PARAMETERS, advised, headline, section

# beside the baselines
ROWS: dict[str, str] = {
    FORECAST: "forecast, motors recorded",
    PREDICTION: "prediction, motors unknown",
}
INTERVAL = "± is the half width of the 90 % interval."


def screen(
    learned: Learned,
    held_out: HeldOut | None = None,
    hover: HoverFigures | None = None,
    assessment: Assessment | None = None,
) -> list[Block]:
    """Returns the findings, the vehicle, the wind torque, prediction and warnings of a ``learned`` model.

    ``held_out`` windows and the motors' ``hover`` figures are left out where there are none; with the ``assessment`` of
    its log its headline and next step are first and last.
    """
    labels = Labels.of(learned)
    if assessment is None or assessment.analysis is None:
        found = findings_of(learned, held_out)
        blocks = list[Block]([Sentence(str(next_step(found.purposes)), "Next:")])
    else:
        found = assessment.analysis.findings
        blocks = conclusion(assessment.judgement)
    return [
        *blocks[:-1],
        *graded(found),
        *motor_blocks(learned, hover),
        *torque_blocks(learned.wind_torque, learned.physical),
        *prediction_blocks(labels, held_out),
        *map(warning, found.warnings),
        blocks[-1],
    ]


def graded(found: Findings) -> list[Block]:
    """Returns a row a purpose of the model, with its verdict; nothing without a model."""
    rows = [
        [str(purpose), Rated(grade, grade.level), advised(reason)]
        for purpose, grade, reason in found.purposes
    ]
    return [Table(["purpose", "grade", "because"], rows, words=True)] if rows else []


def conclusion(judgement: Judgement) -> list[Block]:
    """Returns the headline, each other light that is bad or to be watched, and last what to do next."""
    lights = [
        Sentence(str(fact), f"{name.capitalize()}:")
        for name, fact in judgement.lights.items()
        if fact.level in (Level.BAD, Level.WATCH) and fact != judgement.headline
    ]
    above = Sentence("", headline(judgement.headline))
    return [above, *lights, Sentence(str(judgement.next_step), "Next:")]


def verdict_blocks(found: Findings, judgement: Judgement | None) -> list[Block]:
    """Returns headline, lights and findings without a table, for a narrow column."""
    blocks = list[Block]() if judgement is None else conclusion(judgement)
    blocks[-1:-1] = [
        Sentence(advised(reason), f"{purpose.capitalize()}: {grade}.")
        for purpose, grade, reason in found.purposes
    ]
    return [*blocks, *map(warning, found.warnings)]


def analysis_blocks(assessment: Assessment) -> list[Block]:
    """Returns the screen of an ``assessment``: its model's, else what is known without one, and why there is none."""
    analysis = assessment.analysis
    if analysis is None:
        return conclusion(assessment.judgement)
    learned = analysis.learned
    if learned is None:
        *above, following = conclusion(assessment.judgement)
        above += [] if analysis.reason is None else [Sentence(str(analysis.reason), "No model:")]
    else:
        hover = analysis.vehicle.hover if analysis.tier.name == "a" else None
        *above, following = screen(learned, analysis.held_out, hover, assessment)
    above += [Sentence(str(alarm.fact), "Motors:") for alarm in analysis.alarms if not alarm.weak]
    if analysis.tier.name != "a" or learned is None:
        above += section("tier", **analysis.tier.as_dict())
        above += section("condition", analysis.condition)
    above += vehicle_blocks(analysis.vehicle, bool(analysis.findings.overrides))
    above += [] if analysis.truth is None else truth_blocks(analysis.truth)
    return [*above, *air_blocks(assessment), following]


def title(flights: Sequence[Flight]) -> Sentence:
    """Returns which log and axis the ``flights`` are of, and how much there is of it."""
    first = flights[0]
    seconds = sum(flight.duration for flight in flights)
    parts = f" in {len(flights)} segments" if len(flights) > 1 else ""
    text = f"{first.output_names[0]}, {seconds:.0f} s of settled flight{parts} at {1 / first.dt:.0f} Hz."
    return Sentence(text, f"{Path(str(first.provenance.get('source') or 'Arrays')).name}:")


def summary(learned: Learned) -> str:
    """Returns the screen as text, of what the ``learned`` model alone knows: without windows that it has not seen."""
    return text_of([*screen(learned), *map(caution, learned.cautions)])


def motor_blocks(learned: Learned | None, hover: HoverFigures | None) -> list[Block]:
    """Returns a row a motor, with its effectiveness, trim, headroom and saturation; and what is of all motors.

    Where the model ``learned`` has other inputs than motors, these have a table of their own.
    """
    blocks = list[Block]()
    columns = {} if hover is None else _hover_columns(hover)
    physical = None if learned is None else learned.physical
    half = None
    if learned is not None and physical is not None:
        labels = Labels.of(learned)
        half = physical.interval(LEVEL)
        effect = zip(TORQUE.scale * physical.effect, TORQUE.scale * half.effect, strict=True)
        cells = [plus_minus(*pair) for pair in effect]
        effects = {f"effectiveness ({per(TORQUE, labels.input_units[0])})": cells}
        if hover is not None and hover.motors == labels.input_names:
            columns = effects | columns
        else:
            blocks.append(_by_motor(labels.input_names, effects))
    lean = dict[str, float]()
    if hover is not None:
        blocks.append(_by_motor(hover.motors, columns))
        angles = {"roll": hover.roll, "pitch": hover.pitch}
        lean = {name: angle for name, angle in angles.items() if angle is not None}
    return [*blocks, *section("motion", physical=physical, half=half, lean=lean)]


def _by_motor(motors: Sequence[str], columns: dict[str, list[str]]) -> Table:
    rows = zip(motors, *columns.values(), strict=True)
    return Table(["vehicle", *columns], [list(row) for row in rows])


def _hover_columns(hover: HoverFigures) -> dict[str, list[str]]:
    """Columns of the table of the motors, by header."""
    limits = zip(hover.at_upper_limit, hover.at_lower_limit, strict=True)
    return {
        f"trim ({hover.unit})" if hover.unit else "trim": [f"{trim:.4g}" for trim in hover.trim],
        "trim deviation (%)": [f"{round(more, 1) + 0.0:+.1f}" for more in hover.imbalance],
        "headroom (%)": [f"{100 * left:.0f}" for left in hover.headroom],
        "saturated (% of time)": [f"{100 * (up + low):.1f}" for up, low in limits],
    }


def torque_blocks(wind: WindTorque | None, physical: Physical | None) -> list[Block]:
    """Returns the wind torque: its level, share and gusts; nothing where it is not known."""
    if physical is None or (wind := known_wind(wind, physical)) is None:
        return []
    largest = max(wind.gusts, key=lambda gust: abs(gust.size), default=None)
    is_uncertain = wind.scale_error > HALF_WIDTH["wind"]
    known = {"wind": wind, "largest": largest, "is_uncertain": is_uncertain}
    return [*section("torque", **known, share=physical.wind_share)]


def prediction_blocks(labels: Labels, held_out: HeldOut | None) -> list[Block]:
    """Returns the RMSE beside the baselines over all held-out windows, and how windows differ."""
    if held_out is None:
        return []
    (names, units) = outputs_of(labels)
    rows = list[list[str]]()
    count = f"{len(held_out)} held-out windows" if len(held_out) > 1 else "one held-out window"
    for name in sorted(held_out.forecasts, key=held_out.error_ratio):
        rmse = (unit.scale * value for unit, value in zip(units, held_out.rmse(name), strict=True))
        rows.append([ROWS.get(name, name), *map(rounded, (*rmse, held_out.error_ratio(name)))])
    worse = {name: (held_out.error_ratios(baseline=name) > 1).mean() for name in BASELINES}
    quartiles = np.percentile(held_out.error_ratios(), [25, 50, 75])
    windows = len(held_out)
    return [
        Table([f"RMSE, {held_out.seconds:.2g} s ahead, {count}", *names, "error ratio"], rows),
        *section(
            "prediction",
            windows=windows,
            quartiles=quartiles,
            worse=worse,
            coverage=held_out.coverage,
        ),
    ]


def vehicle_blocks(vehicle: VehicleFigures, doubted: bool = False) -> list[Block]:
    """Returns a row an axis of a ``vehicle``, and the reasons for what is not reported."""
    blocks: list[Block] = []
    if vehicle.axes:  # A table without rows says nothing.
        axes = vehicle.axes.items()
        unit = next((axis.flights[0].input_units[0] for _, axis in axes if axis.flights), "")
        words = ("rate damping (1/s)", "time constant (ms)", "wind torque, sd (°/s²)")
        header = ["axis", f"mean effectiveness ({per(TORQUE, unit)})", *words]
        reasons = [
            (
                name,
                (str if doubted else advised)(one.reason)
                if one.reason
                else " ".join(parameter_reasons(one.physical, doubted)),
            )
            for name, one in axes
        ]
        blocks = [
            Sentence(f"all settled flight of the log; {INTERVAL}", "Vehicle:"),
            Table(header, [[name, *_axis_row(one)] for name, one in axes]),
            *(Sentence(reason, f"{name.capitalize()}:") for name, reason in reasons if reason),
        ]
    return blocks


def _axis_row(axis: AxisFigures) -> list[str]:
    physical = axis.physical
    wind = known_wind(axis.wind, axis.physical)
    if physical is None:
        return ["-"] * 4
    _, damping, lag, _ = physical.interval(LEVEL)
    mean, half = (TORQUE.scale * value for value in physical.mean_effect(LEVEL))
    estimates = {
        "effect": (mean, half),
        "damping": (physical.damping, damping),
        "lag": (1e3 * physical.lag, 1e3 * lag),
    }
    marks = {name: " (biased)" * (physical.status[name] == "biased") for name in estimates}
    shown = [f"{plus_minus(*pair)}{marks[name]}" for name, pair in estimates.items()]
    return [*shown, "-" if wind is None else rounded(TORQUE.scale * wind.sd)]


def parameter_reasons(physical: Physical | None, doubted: bool = False) -> list[str]:
    """Returns why ``physical`` parameters are not reported, each reason once; without advice if all is ``doubted``."""
    if physical is None:
        return []
    says = str if doubted else advised
    reasons = {name: says(reason) for name, reason in physical.reasons.items() if reason}
    status = Status(physical.status["effect"])
    if status is not Status.REPORTED and set(map(Status, physical.status.values())) == {status}:
        # What is wrong with the effectiveness is enough to know.
        names = listed(PARAMETERS.values()).capitalize()
        return [f"{names} are {status}: {reasons['effect']}"]
    parameters: dict[str, list[str]] = {}
    for name, reason in reasons.items():
        parameters.setdefault(reason, []).append(f"{PARAMETERS[name]} {physical.status[name]}")
    return [f"{listed(names).capitalize()}: {reason}" for reason, names in parameters.items()]


def detail_blocks(learned: Learned, findings: Findings | None = None) -> list[Block]:
    """Returns cautions, the ``learned`` model and how it was learned; with ``findings`` also errors one step ahead."""
    labels = Labels.of(learned)
    energy = learned.free_energy
    fit = learned.simulation_fit
    start, end = (sum(term[i] for term in fit.terms.values()) if fit else 0.0 for i in (0, -1))
    return [
        *map(caution, learned.cautions),
        *([] if findings is None else _one_step(learned, labels)),
        *_model(labels, learned),
        *_physical(learned.physical),
        *section(
            "learning",
            learned=learned,
            gained=energy.gained,
            iterations=len(energy) - 1,
            end=energy[-1],
            fit=fit,
            fit_gained=end - start,
        ),
        *_joint(labels, learned),
    ]


def _one_step(learned: Learned, labels: Labels) -> list[Block]:
    """RMSE by output on the training data, and how far ahead predictions are worth something without the inputs."""
    names, units = outputs_of(labels)
    rows = []
    for name, error in one_step_errors(learned).items():
        squares = zip(units, error["per_output"], strict=True)
        rmse = (unit.scale * sqrt(square) for unit, square in squares)
        rows.append([name, *(f"{value:.3g}" for value in (*rmse, error["relative"]))])
    horizons = zip(labels.output_names, learned.useful_steps * learned.dt, strict=True)
    return [
        Table(["RMSE, one step ahead, training data", *names, "error ratio"], rows),
        *section("useful", horizons=horizons),
    ]


def _model(labels: Labels, learned: Learned) -> list[Block]:
    """The model with all it takes to use it elsewhere: a table a matrix, a row a derivative."""
    model = learned.model
    outputs = states_are_outputs(learned)
    states = state_names(labels.output_names, learned)
    (n, r) = model.B.shape
    m = len(model.C)
    half = learned.model_interval(LEVEL)
    known = unpack(learned.known, n, r, m)
    derivatives = [f"d/dt {state}" for state in states]
    inputs = [short(name) for name in labels.input_names]

    def table(which: int, columns: Sequence[str], rows: Sequence[str]) -> Table:
        cells = zip(rows, model[which], half[which], known[which], strict=True)
        return Table(["ABC"[which], *columns], [[head, *map(_entry, *row)] for head, *row in cells])

    A = table(0, states, derivatives)
    B = table(1, inputs, derivatives)
    C = table(2, states, labels.output_names)
    constant = learned.scaling.constant
    if constant:
        B.header.append("d")
        for row, value in zip(B.rows, model.offset, strict=True):
            row.append(f"{value:.3g}")
    units = (*labels.output_units, *labels.input_units)
    heading, *below = section(
        "model",
        constant=constant,
        outputs=outputs,
        units=", ".join(dict.fromkeys(filter(None, units))),
        has_lag=outputs and len(states) == len(labels.output_names) + 1,
        output_trim=_trim(labels.output_names, model.output_trim, labels.output_units),
        input_trim=_trim(labels.input_names, model.input_trim, labels.input_units),
    )
    return [heading, A, B, *([] if outputs else [C]), *below, *poles_of(model.A)]


def _entry(value: float, half: float, fixed: bool) -> str:
    """An estimate with its interval; alone where it is fixed or has none."""
    return f"{value:.3g}" if fixed or not isfinite(half) else plus_minus(value, half)


def _trim(names: Sequence[str], values: Array, units: Sequence[str]) -> str:
    """Each value in its own unit, and that of an angle in degrees too."""
    shown = []
    for name, value, unit in zip(names, values, units, strict=True):
        degrees = readable(unit)
        also = f" ({with_unit(value, degrees, 3)})" if degrees.name != unit else ""
        shown.append(f"{name} {value:.4g} {unit}{also}".rstrip())
    return ", ".join(shown)


def poles_of(A: Array) -> list[Sentence]:
    """Returns the eigenvalues of A, the slowest first, one of each complex pair, and whether the model is stable.

    With natural frequency |p|/2π and damping ratio −Re p/|p| if complex, else with the time constant 1/|p|.
    """
    upper = (value for value in np.linalg.eigvals(A) if value.imag >= 0)
    return section("poles", poles=sorted(upper, key=lambda value: -value.real))


def _physical(physical: Physical | None) -> list[Block]:
    """How the physical parameters were fitted."""
    if physical is None:
        return []
    return [
        *section(
            "physical",
            windows=physical.windows,
            refinements=physical.refinements,
        )
    ]


def _joint(labels: Labels, learned: Learned) -> list[Block]:
    """What F̄ chose of the joint model, and which motors it takes to turn the axis."""
    joint = learned.joint
    turning = joint.combinations[:, 0]
    limit = np.abs(joint.combinations).max() / 4
    names = [short(name) for name in labels.input_names]
    return [
        *section(
            "joint",
            joint=joint,
            seconds=joint.choice.lags * learned.dt,
            is_fewer=joint.combinations.shape[1] < len(names),
            up=[name for name, way in zip(names, turning, strict=True) if way > limit],
            down=[name for name, way in zip(names, turning, strict=True) if -way > limit],
            is_chosen=learned.record.effect_directions is None,
        )
    ]
