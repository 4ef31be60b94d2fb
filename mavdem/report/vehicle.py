"""The report of the vehicle and the wind: physical parameters, the wind's torque, and how hard each motor works."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from mavdem.analysis.figures import AxisFigures, VehicleFigures
from mavdem.analysis.findings import HALF_WIDTH, known_wind
from mavdem.condition.hover import HoverFigures
from mavdem.confidence import LEVEL
from mavdem.dem import Physical, WindTorque
from mavdem.dem.graybox.identifiability import CHANGED
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.names import listed, readable, short
from mavdem.report.rounding import plus_minus, rounded


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
    if found is None or found.reason is not None or not (isfinite(found.answered) and isfinite(found.answered_slow)):
        return []
    slow = 100 * max(found.answered_slow, 0.0)
    if found.answered >= 0:
        text = f"the motors had cancelled {100 * found.answered:.0f} % of its variance, {slow:.0f} % below 1 Hz."
    else:
        text = f"the motors had cancelled {slow:.0f} % of its variance below 1 Hz; to what is faster they added."
    return [Sentence(text, "Wind's torque:")]
