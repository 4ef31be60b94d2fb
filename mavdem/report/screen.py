"""One screen: what a vehicle does in wind, how sure that is, and what must be known before the model is used.

The report of the vehicle and the wind: physical parameters, the wind's torque, and how hard each motor works.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import Path

import numpy as np

from mavdem.analysis import LogAnalysis
from mavdem.analysis.figures import AxisFigures, VehicleFigures
from mavdem.analysis.findings import HALF_WIDTH, Finding, findings, known_wind, next_step, warnings_of
from mavdem.condition.hover import HoverFigures
from mavdem.confidence import LEVEL
from mavdem.dem import Learned, Physical, WindTorque
from mavdem.dem.graybox.identifiability import CHANGED
from mavdem.evaluate.held_out import BASELINES, FORECAST, PREDICTION, HeldOut
from mavdem.flight import Flight
from mavdem.report.blocks import Block, Sentence, Table, text_of
from mavdem.report.condition import condition_sentences, identity_sentence, tier_sentences
from mavdem.report.numbers import Labels, listed, named, plus_minus, readable, rounded, short


def vehicle_blocks(found: VehicleFigures) -> list[Block]:
    """A row an axis, the reasons for what is not reported, and a row a motor."""
    if not found.axes:  # A table without rows says nothing.
        return hover_blocks(found.hover)
    rows = [[name, *_axis_row(own)] for name, own in found.axes.items()]
    unit = next((own.flights[0].input_units[0] for own in found.axes.values() if own.flights), "") or "unit of input"
    header = ["axis", f"mean effect (°/s² per {unit})", "damping (1/s)", "lag (ms)", "wind's torque, sd (°/s²)"]
    return [
        Sentence(
            f"all settled flight of the log; ± is the half width of the {100 * LEVEL:.0f} % interval.", "Vehicle:"
        ),
        Table(header, rows),
        *(Sentence(reason, f"{name.capitalize()}:") for name, own in found.axes.items() if (reason := _reason(own))),
        *hover_blocks(found.hover),
    ]


def _axis_row(own: AxisFigures) -> list[str]:
    read, unit = own.physical, readable("rad/s²").scale
    if read is None:
        return ["-"] * 4
    _, damping, lag, _ = read.interval(LEVEL)
    mean, half = (unit * value for value in read.mean_effect(LEVEL))
    cells = {
        "effect": plus_minus(mean, half),
        "damping": plus_minus(read.damping, damping),
        "lag": plus_minus(1e3 * read.lag, 1e3 * lag),
    }
    marked = [f"{cell}{' (biased)' if read.status[name] == 'biased' else ''}" for name, cell in cells.items()]
    wind = known_wind(own.wind, read)
    return [*marked, "-" if wind is None else rounded(unit * wind.sd)]


def _reason(own: AxisFigures) -> str:
    return own.reason if own.physical is None else " ".join(_reasons(own.physical))


def _reasons(read: Physical) -> list[str]:
    """Each reason once, with the parameters it is of."""
    status = read.status["effect"]
    if status != "reported" and set(read.status.values()) == {status}:
        # What is wrong with the effect is enough to know.
        return [f"Effect, damping and lag are {status}: {read.reasons['effect']}"]
    named: dict[str, list[str]] = {}
    for name, reason in read.reasons.items():
        named.setdefault(reason, []).append(f"{name} {read.status[name]}")
    return [f"{listed(names).capitalize()}: {reason}" for reason, names in named.items() if reason]


def hover_columns(found: HoverFigures | None, motors: Sequence[str]) -> dict[str, list[str]]:
    """Columns of the table of these motors, by header: trim, imbalance, headroom, and the time at a limit."""
    if found is None or found.motors != tuple(motors):
        return {}
    unit = f" ({found.unit})" if found.unit else ""
    return {
        f"trim{unit}": [f"{trim:.4g}" for trim in found.trim],
        "beyond the mean (%)": [f"{round(more, 1) + 0.0:+.1f}" for more in found.imbalance],
        "headroom (%)": [f"{100 * left:.0f}" for left in found.headroom],
        "saturated (% of time)": [
            f"{100 * (up + low):.1f}" for up, low in zip(found.at_upper_limit, found.at_lower_limit, strict=True)
        ],
    }


def lean(found: HoverFigures | None) -> str:
    """The mean angles: "roll 13.3° and pitch 0.1°"; empty where they are not known."""
    if found is None:
        return ""
    angles = (("roll", found.roll), ("pitch", found.pitch))
    return listed([f"{name} {angle:.1f}°" for name, angle in angles if angle is not None])


def hover_blocks(found: HoverFigures | None) -> list[Block]:
    """A row a motor."""
    if found is None:
        return []
    columns = hover_columns(found, found.motors)
    rows = [
        [short(name), *cells] for name, cells in zip(found.motors, zip(*columns.values(), strict=True), strict=True)
    ]
    return [
        Sentence(f"{found.seconds:.0f} s of settled flight; mean lean {lean(found) or 'not known'}.", "Motors:"),
        Table(["motor", *columns], rows),
    ]


def physical_blocks(read: Physical | None) -> list[Block]:
    """How the physical parameters were fitted, and each window's own, where they differ by more than chance."""
    if read is None:
        return []
    refined = (
        f" Unseen windows are predicted better with: {listed(list(read.refinements))}." if read.refinements else ""
    )
    return [
        Sentence(
            f"{_counted(len(read.windows.start))} by a model of these parameters and the wind only, beside DEM's."
            f"{refined} {' '.join(_reasons(read))}".rstrip(),
            "Physical parameters (gray-box model):",
        ),
        *(_over_time(read) if CHANGED in " ".join(read.reasons.values()) else []),
    ]


def _over_time(read: Physical) -> list[Block]:
    """Each window's own estimate, where they differ by more than chance."""
    windows = read.windows
    columns = zip(windows.start, windows.effect, windows.damping, windows.lag, windows.wind, strict=True)
    unit = readable("rad/s²").scale
    rows = [
        [f"{start:.0f} s", f"{unit * effect:.3g}", f"{damping:.2g}", f"{1e3 * lag:.2g}", f"{unit * wind:.3g}"]
        for start, effect, damping, lag, wind in columns
    ]
    return [Table(["window from", "mean effect", "damping (1/s)", "lag (ms)", "wind (°/s²)"], rows)]


def _counted(windows: int) -> str:
    return f"{windows} windows, fitted together," if windows > 1 else "one window"


def wind_blocks(found: WindTorque | None, read: Physical | None) -> list[Block]:
    """The wind's torque: its level, share and gusts, and what of it the motors had answered."""
    lead = "Wind on this axis:"
    found = known_wind(found, read)
    if found is None or read is None:
        return []
    unit = readable("rad/s²")
    text = (
        f"torque {rounded(unit.scale * found.sd)} {unit.name} (standard deviation), "
        f"{100 * read.wind_share:.0f} % of the variance of all torque; steady part "
        f"{plus_minus(unit.scale * found.mean, unit.scale * found.mean_band)} {unit.name}, if motors are equal and the "
        "load is centred."
    )
    if found.scale_error > HALF_WIDTH["wind"]:
        text += f" Both are uncertain by {100 * found.scale_error:.0f} %, as the motor effect is."
    count = len(found.gusts)
    text += (
        f" {count or 'No'} gust{'' if count == 1 else 's'} beyond {rounded(unit.scale * found.gust_threshold)} "
        f"{unit.name}"
    )
    if found.gusts:
        largest = max(found.gusts, key=lambda gust: abs(gust.size))
        text += (
            f"; the largest {rounded(unit.scale * largest.size)} {unit.name}, {largest.length:.2g} s long, "
            f"{largest.start:.1f} s after the first sample"
        )
    return [Sentence(f"{text} (by chance {found.false_gusts_per_minute:.1g} a minute).", lead)]


def answer_blocks(found: WindTorque | None) -> list[Block]:
    """How much of the wind's torque the motors had cancelled."""
    if found is None or found.reason is not None or not isfinite(found.cancelled_share + found.cancelled_share_slow):
        return []
    slow = 100 * max(found.cancelled_share_slow, 0.0)
    if found.cancelled_share >= 0:
        text = f"the motors had cancelled {100 * found.cancelled_share:.0f} % of its variance, {slow:.0f} % below 1 Hz."
    else:
        text = f"the motors had cancelled {slow:.0f} % of its variance below 1 Hz; to what is faster they added."
    return [Sentence(text, "Wind's torque:")]


ROWS = {FORECAST: "forecast, motors recorded", PREDICTION: "prediction, motors unknown"}
"""Of the table of errors, beside the baselines."""


def screen(
    learned: Learned,
    held_out: HeldOut | None = None,
    hover: HoverFigures | None = None,
    found: Sequence[Finding] | None = None,
) -> list[Block]:
    """The findings by purpose, the vehicle, the wind, prediction, and warnings.

    ``held_out`` windows and the motors' ``hover`` figures are left out where there are none; the findings are those of
    the model unless ``found`` otherwise.
    """
    labels, found = Labels.of(learned), findings(learned, held_out) if found is None else found
    return [
        *finding_blocks(found),
        *_vehicle(labels, learned.physical, hover),
        *wind_blocks(learned.wind, learned.physical),
        *_prediction(labels, held_out),
        *(Sentence(warning, "Warning:") for warning in warnings_of(learned, held_out)),
        Sentence(next_step(found), "Next:"),
    ]


def analysis_blocks(found: LogAnalysis) -> list[Block]:
    """What is reported of one vehicle and axis: the screen of its model, else what is known without one, and why."""
    model: list[Block] = []
    if found.learned is not None:
        model = screen(found.learned, found.held_out, found.vehicle.hover, found.findings)
    alarms: list[Block] = [Sentence(one.sentence.removeprefix("Alarm: "), "Motors:") for one in found.alarms]
    if suspect := next((one.name for one in found.alarms if one.motor is not None), ""):
        inspect = (
            f"Inspect {suspect}, its propeller, connector and controller before the next flight, then compare a hover "
            "with healthy flights: `mavdem track --baseline`."
        )
        alarms.append(Sentence(inspect, "Next:"))
        model = model[:-1] if found.tier.name == "a" else model
    if found.tier.name == "a" and model:
        return [*alarms, *model]
    tier = tier_sentences(found.tier.as_dict())
    # What to do next is to record faster, whatever the findings.
    why = [] if model else [Sentence(found.reason, "No model:")]
    remedy = [Sentence(found.remedy, "What to do:")] if found.remedy else []
    identity = identity_sentence(found.identity.as_dict())
    return [*alarms, *why, *remedy, *tier, *model[:-1], identity, *condition_sentences(found.condition.as_dict())]


def title(flights: Sequence[Flight]) -> Sentence:
    """Which log, axis and how much of it."""
    first = flights[0]
    seconds, source = sum(flight.duration for flight in flights), first.provenance.get("source")
    parts = f" in {len(flights)} segments" if len(flights) > 1 else ""
    return Sentence(
        f"{first.output_names[0]}, {seconds:.0f} s of settled flight{parts} at {1 / first.dt:.0f} Hz.",
        f"{Path(str(source)).name if source else 'Arrays'}:",
    )


def summary(learned: Learned) -> str:
    """The screen as text, of what the model alone knows: without windows that it has not seen."""
    blocks = screen(learned)
    cautions = [Sentence(caution, "Caution:") for caution in learned.cautions]
    return text_of([*blocks, *cautions])


def finding_blocks(found: Sequence[Finding]) -> list[Block]:
    """A row a purpose."""
    return [
        Table(
            ["purpose", "verdict", "because"],
            [[one.purpose, one.grade, one.reason] for one in found],
            words=True,
        )
    ]


def key_figures(learned: Learned, held_out: HeldOut | None = None) -> list[tuple[str, str]]:
    """The few figures to see at a glance, each with its label and unit, for a strip of a dashboard or a page."""
    labels, read, degrees = Labels.of(learned), learned.physical, readable("rad/s²")
    wind = known_wind(learned.wind, read)
    figures = []
    if read is not None:
        mean, half = read.mean_effect(LEVEL)
        figures = [
            ("motor effect", _known(degrees.scale * mean, degrees.scale * half, _per_input(labels))),
            ("damping", _known(read.damping, read.interval(LEVEL).damping, "1/s")),
            ("lag of the motors", _known(1e3 * read.lag, 1e3 * read.interval(LEVEL).lag, "ms")),
        ]
    if wind is not None:
        figures.append(("wind's torque, sd", f"{rounded(degrees.scale * wind.sd)} {degrees.name}"))
        figures.append(("gusts", str(len(wind.gusts))))
    if held_out is not None:
        unit = readable(labels.output_units[0])
        best = held_out.best_baseline
        ours, theirs = (unit.scale * held_out.rmse(name)[0] for name in (FORECAST, best))
        label = f"RMSE of {labels.output_names[0]}, {held_out.seconds:.2g} s ahead"
        figures.append((label, f"{rounded(ours)}{unit.name} ({best} {rounded(theirs)}{unit.name})"))
        figures.append(("90 % band holds", f"{100 * held_out.coverage:.0f} %"))
    return figures


def _known(value: float, half: float, unit: str) -> str:
    return f"{plus_minus(value, half)} {unit}" if np.isfinite(half) else "not identifiable"


def _per_input(labels: Labels) -> str:
    return f"{readable('rad/s²').name} per {labels.input_units[0] or 'unit of input'}"


def _vehicle(labels: Labels, read: Physical | None, hover: HoverFigures | None) -> list[Block]:
    """A row a motor: effect, imbalance, trim, headroom and saturation; and what is of all motors."""
    blocks: list[Block] = []
    columns = hover_columns(hover, labels.input_names)
    header, cells = ["vehicle"], [[name] for name in labels.input_names]
    if read is not None:
        unit, half = readable("rad/s²").scale, read.interval(LEVEL).effect
        header.append(f"effect ({_per_input(labels)})")
        for row, value, width in zip(cells, read.effect, half, strict=True):
            row.append(plus_minus(unit * value, unit * width))
    for head, column in columns.items():
        header.append(head)
        for row, cell in zip(cells, column, strict=True):
            row.append(cell)
    if len(header) > 1:
        blocks.append(Table(header, cells))
    rest = []
    if read is not None:
        interval = read.interval(LEVEL)
        rest += [
            f"{name} {_known(scale * value, scale * half, unit)}"
            for name, value, half, scale, unit in (
                ("damping", read.damping, interval.damping, 1.0, "1/s"),
                ("lag of the motors", read.lag, interval.lag, 1e3, "ms"),
                ("delay", read.delay, interval.delay, 1e3, "ms"),
            )
        ]
        rest[0] = rest[0].capitalize()
    if leaning := lean(hover):
        rest.append(f"mean lean {leaning}")
    if rest:
        blocks.append(Sentence(f"{'; '.join(rest)}. ± is the half width of the {100 * LEVEL:.0f} % interval."))
    return blocks


def _prediction(labels: Labels, held_out: HeldOut | None) -> list[Block]:
    """RMSE beside the baselines over all held-out windows, and how windows differ."""
    if held_out is None:
        return []
    units = [readable(unit) for unit in labels.output_units]
    names = [named(name, unit.name) for name, unit in zip(labels.output_names, units, strict=True)]
    ranked = sorted(held_out.forecasts, key=held_out.error_ratio)
    count = f"{len(held_out)} held-out windows" if len(held_out) > 1 else "one held-out window"
    rows = [
        [
            ROWS.get(name, name),
            *(rounded(unit.scale * rmse) for unit, rmse in zip(units, held_out.rmse(name), strict=True)),
            rounded(held_out.error_ratio(name)),
        ]
        for name in ranked
    ]
    blocks: list[Block] = [Table([f"RMSE, {held_out.seconds:.2g} s ahead, {count}", *names, "error ratio"], rows)]
    band = f"The 90 % band holds {100 * held_out.coverage:.0f} % of the samples."
    if len(held_out) > 1:
        ratios = held_out.error_ratios()
        low, median, high = np.percentile(ratios, [25, 50, 75])
        worse = ", ".join(
            f"{100 * float((held_out.error_ratios(baseline=name) > 1).mean()):.0f} % worse than “{name}”"
            for name in BASELINES
        )
        band = (
            f"Of single windows the forecast's error ratio is {rounded(median)} in the median, {rounded(low)} to "
            f"{rounded(high)} in the middle half; {worse}. {band}"
        )
    return [*blocks, Sentence(band)]
