"""One screen: what a vehicle does in wind, how sure that is, and what must be known before the model is used.

``analysis_blocks`` is the screen of a log, ``screen`` that of a model alone; ``vehicle_blocks`` has all axes of a
vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mavdem.analysis import AxisFigures, LogAnalysis, VehicleFigures
from mavdem.analysis.findings import ADVICE, HALF_WIDTH, Findings, findings_of, known_wind
from mavdem.condition.condition import HoverFigures
from mavdem.confidence import LEVEL
from mavdem.dem import Learned, Physical, WindTorque
from mavdem.evaluate.held_out import BASELINES, FORECAST, PREDICTION, HeldOut
from mavdem.flight import Flight
from mavdem.report.blocks import Block, Sentence, Table, text_of
from mavdem.report.condition import condition_sentences, identity_sentence, tier_sentences
from mavdem.report.numbers import TORQUE, Labels, listed, outputs_of, per, plus_minus, rounded, short

ROWS = {FORECAST: "forecast, motors recorded", PREDICTION: "prediction, motors unknown"}  # beside the baselines
PURPOSE_WORDS = {
    "motor effectiveness": "control effectiveness",
    "damping and lag": "damping and time constant",
    "wind": "wind torque",
    "prediction": "prediction",
    "residuals": "residuals",
}
PARAMETER_WORDS = {"effect": "control effectiveness", "damping": "rate damping", "lag": "motor time constant"}
MOTION = (
    ("damping", "rate damping", 1.0, "1/s"),
    ("lag", "motor time constant", 1e3, "ms"),
    ("delay", "delay", 1e3, "ms"),
)
INTERVAL = f"± is the half width of the {100 * LEVEL:.0f} % interval."


def screen(
    learned: Learned, held_out: HeldOut | None = None, hover: HoverFigures | None = None, found: Findings | None = None
) -> list[Block]:
    """Returns the headline, the findings, the vehicle, the wind torque, prediction and warnings of a ``learned`` model.

    ``held_out`` windows and the motors' ``hover`` figures are left out where there are none; the findings are those of
    the model unless ``found`` otherwise.
    """
    labels, found = Labels.of(learned), findings_of(learned, held_out) if found is None else found
    graded = [[PURPOSE_WORDS[purpose], grade, reason] for purpose, grade, reason in found.purposes]
    *first, following = conclusion(found)
    return [
        *first,
        Table(["purpose", "verdict", "because"], graded, words=True),
        *_vehicle(labels, learned.physical, hover),
        *_wind(learned.wind_torque, learned.physical),
        *_prediction(labels, held_out),
        *(Sentence(warning, "Warning:") for warning in found.warnings),
        following,
    ]


def conclusion(found: Findings) -> list[Block]:
    """Returns the headline, what overrides all grades, and last what to do next."""
    doubts = (Sentence(override.sentence, f"{override.kind.capitalize()}:") for override in found.overrides)
    return [*([Sentence("", found.headline)] if found.headline else []), *doubts, Sentence(found.next_step, "Next:")]


def verdict_blocks(found: Findings) -> list[Block]:
    """Returns all findings without a table, for a narrow column."""
    *blocks, following = conclusion(found)
    blocks += [
        Sentence(reason, f"{PURPOSE_WORDS[what].capitalize()}: {grade}.") for what, grade, reason in found.purposes
    ]
    return [*blocks, *(Sentence(warning, "Warning:") for warning in found.warnings), following]


def analysis_blocks(analysis: LogAnalysis) -> list[Block]:
    """Returns the screen of an ``analysis``: its model's, else what is known without one, and why there is none."""
    learned, found, hover = analysis.learned, analysis.findings, analysis.vehicle.hover
    if hover is not None and analysis.tier.name != "a":
        hover = replace(hover, roll=None, pitch=None)  # the condition says how the vehicle leans
    blocks = conclusion(found) if learned is None else screen(learned, analysis.held_out, hover, found)
    blocks += [Sentence(analysis.reason, "No model:")] if learned is None and found.overrides else []
    blocks += [Sentence(alarm.sentence, "Motors:") for alarm in analysis.alarms if not alarm.weak]
    if analysis.tier.name != "a" or learned is None:
        blocks += [*tier_sentences(analysis.tier.as_dict()), identity_sentence(analysis.identity.as_dict())]
        blocks += condition_sentences(analysis.condition.as_dict())
    return blocks


def title(flights: Sequence[Flight]) -> Sentence:
    """Returns which log and axis the ``flights`` are of, and how much there is of it."""
    first, seconds = flights[0], sum(flight.duration for flight in flights)
    parts = f" in {len(flights)} segments" if len(flights) > 1 else ""
    text = f"{first.output_names[0]}, {seconds:.0f} s of settled flight{parts} at {1 / first.dt:.0f} Hz."
    return Sentence(text, f"{Path(str(first.provenance.get('source') or 'Arrays')).name}:")


def summary(learned: Learned) -> str:
    """Returns the screen as text, of what the ``learned`` model alone knows: without windows that it has not seen."""
    return text_of([*screen(learned), *(Sentence(caution, "Caution:") for caution in learned.cautions)])


def _vehicle(labels: Labels, physical: Physical | None, hover: HoverFigures | None) -> list[Block]:
    """A row a motor: effectiveness, trim deviation, trim, headroom and saturation; and what is of all motors."""
    columns, blocks, rest = dict[str, list[str]](), list[Block](), list[str]()
    if physical is not None:
        half = physical.interval(LEVEL)
        effect = zip(TORQUE.scale * physical.effect, TORQUE.scale * half.effect, strict=True)
        columns[f"effectiveness ({per(TORQUE, labels.input_units[0])})"] = [plus_minus(*pair) for pair in effect]
        for name, words, scale, unit in MOTION:
            pair = scale * getattr(physical, name), scale * getattr(half, name)
            rest.append(f"{words} {f'{plus_minus(*pair)} {unit}' if np.isfinite(pair[1]) else 'not identifiable'}")
    if hover is not None and hover.motors == labels.input_names:
        columns |= _hover_columns(hover)
    if columns:
        rows = zip(labels.input_names, *columns.values(), strict=True)
        blocks.append(Table(["vehicle", *columns], [list(row) for row in rows]))
    if hover is not None and (leaning := _lean(hover)):
        rest.append(f"mean lean {leaning}")
    text = f"{'; '.join(rest)}.{f' {INTERVAL}' if '±' in f'{columns}{rest}' else ''}"
    return [*blocks, Sentence(text[:1].upper() + text[1:])] if rest else blocks


def _hover_columns(hover: HoverFigures) -> dict[str, list[str]]:
    """Columns of the table of the motors, by header."""
    limits = zip(hover.at_upper_limit, hover.at_lower_limit, strict=True)
    return {
        f"trim ({hover.unit})" if hover.unit else "trim": [f"{trim:.4g}" for trim in hover.trim],
        "trim deviation (%)": [f"{round(more, 1) + 0.0:+.1f}" for more in hover.imbalance],
        "headroom (%)": [f"{100 * left:.0f}" for left in hover.headroom],
        "saturated (% of time)": [f"{100 * (up + low):.1f}" for up, low in limits],
    }


def _lean(hover: HoverFigures) -> str:
    """The mean angles: "roll 13.3° and pitch 0.1°"; empty where they are not known."""
    angles = ("roll", hover.roll), ("pitch", hover.pitch)
    return listed(f"{name} {angle:.1f}°" for name, angle in angles if angle is not None)


def _wind(wind: WindTorque | None, physical: Physical | None) -> list[Block]:
    """The wind torque: its level, share and gusts; nothing where it is not known."""
    if physical is None or (wind := known_wind(wind, physical)) is None:
        return []
    unit, scale, count = TORQUE.name, TORQUE.scale, len(wind.gusts)
    text = (
        f"{rounded(scale * wind.sd)} {unit} (standard deviation), {100 * physical.wind_share:.0f} % of the variance of "
        f"all torque; steady part {plus_minus(scale * wind.mean, scale * wind.mean_band)} {unit}, if motors are equal "
        "and the load is centred."
    )
    if wind.scale_error > HALF_WIDTH["wind"]:
        text += f" The standard deviation is uncertain by {100 * wind.scale_error:.0f} %."
    text += f" {count or 'No'} gust{'' if count == 1 else 's'} beyond {rounded(scale * wind.gust_threshold)} {unit}"
    if wind.gusts:
        largest = max(wind.gusts, key=lambda gust: abs(gust.size))
        text += f"; the largest {rounded(scale * largest.size)} {unit}, {largest.length:.2g} s long, "
        text += f"{largest.start:.1f} s after the first sample"
    return [Sentence(f"{text} (by chance {wind.false_gusts_per_minute:.1g} a minute).", "Wind torque on this axis:")]


def _prediction(labels: Labels, held_out: HeldOut | None) -> list[Block]:
    """RMSE beside the baselines over all held-out windows, and how windows differ."""
    if held_out is None:
        return []
    (names, units), rows = outputs_of(labels), list[list[str]]()
    count = f"{len(held_out)} held-out windows" if len(held_out) > 1 else "one held-out window"
    for name in sorted(held_out.forecasts, key=held_out.error_ratio):
        rmse = (unit.scale * value for unit, value in zip(units, held_out.rmse(name), strict=True))
        rows.append([ROWS.get(name, name), *map(rounded, (*rmse, held_out.error_ratio(name)))])
    text = f"The 90 % band holds {100 * held_out.coverage:.0f} % of the samples."
    if len(held_out) > 1:
        low, median, high = (rounded(value) for value in np.percentile(held_out.error_ratios(), [25, 50, 75]))
        shares = ((name, float((held_out.error_ratios(baseline=name) > 1).mean())) for name in BASELINES)
        worse = ", ".join(f"{100 * share:.0f} % worse than “{name}”" for name, share in shares)
        text = f"Error ratio by window: median {median}, interquartile range {low} to {high}; {worse}. {text}"
    return [Table([f"RMSE, {held_out.seconds:.2g} s ahead, {count}", *names, "error ratio"], rows), Sentence(text)]


def vehicle_blocks(vehicle: VehicleFigures, doubted: bool = False) -> list[Block]:
    """Returns a row an axis of a ``vehicle``, the reasons for what is not reported, and a row a motor."""
    blocks: list[Block] = []
    if vehicle.axes:  # A table without rows says nothing.
        axes = vehicle.axes.items()
        unit = next((axis.flights[0].input_units[0] for _, axis in axes if axis.flights), "")
        words = ("rate damping (1/s)", "time constant (ms)", "wind torque, sd (°/s²)")
        header = ["axis", f"mean effectiveness ({per(TORQUE, unit)})", *words]
        reasons = [(name, one.reason or " ".join(parameter_reasons(one.physical, doubted))) for name, one in axes]
        blocks = [
            Sentence(f"all settled flight of the log; {INTERVAL}", "Vehicle:"),
            Table(header, [[name, *_axis_row(one)] for name, one in axes]),
            *(Sentence(reason, f"{name.capitalize()}:") for name, reason in reasons if reason),
        ]
    if (hover := vehicle.hover) is not None:
        columns = _hover_columns(hover)
        rows = zip(map(short, hover.motors), *columns.values(), strict=True)
        lean = f"{hover.seconds:.0f} s of settled flight; mean lean {_lean(hover) or 'not known'}."
        blocks += [Sentence(lean, "Motors:"), Table(["motor", *columns], [list(row) for row in rows])]
    return blocks


def _axis_row(axis: AxisFigures) -> list[str]:
    physical, wind = axis.physical, known_wind(axis.wind, axis.physical)
    if physical is None:
        return ["-"] * 4
    _, damping, lag, _ = physical.interval(LEVEL)
    mean, half = (TORQUE.scale * value for value in physical.mean_effect(LEVEL))
    estimates = {"effect": (mean, half), "damping": (physical.damping, damping), "lag": (1e3 * physical.lag, 1e3 * lag)}
    marks = {name: " (biased)" * (physical.status[name] == "biased") for name in estimates}
    shown = [f"{plus_minus(*pair)}{marks[name]}" for name, pair in estimates.items()]
    return [*shown, "-" if wind is None else rounded(TORQUE.scale * wind.sd)]


def parameter_reasons(physical: Physical | None, doubted: bool = False) -> list[str]:
    """Returns why ``physical`` parameters are not reported, each reason once; without advice if all is ``doubted``."""
    if physical is None:
        return []
    reasons = {name: ADVICE.sub("", reason) if doubted else reason for name, reason in physical.reasons.items()}
    status = physical.status["effect"]
    if status != "reported" and set(physical.status.values()) == {status}:
        # What is wrong with the effectiveness is enough to know.
        names = listed(PARAMETER_WORDS.values()).capitalize()
        return [f"{names} are {status}: {reasons['effect']}"]
    parameters: dict[str, list[str]] = {}
    for name, reason in reasons.items():
        parameters.setdefault(reason, []).append(f"{PARAMETER_WORDS[name]} {physical.status[name]}")
    return [f"{listed(names).capitalize()}: {reason}" for reason, names in parameters.items() if reason]
