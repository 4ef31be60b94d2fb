"""The report of the vehicle and the wind: physical parameters, the wind's torque, and how hard each motor works."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, isfinite, log10

from mavdem.alignment.trim import HoverFigures
from mavdem.dem import Physical, WindTorque
from mavdem.dem.graybox.identifiability import CHANGED
from mavdem.dem.validation import LEVEL
from mavdem.evaluate.vehicle_figures import AxisFigures, VehicleFigures
from mavdem.flight import Flight
from mavdem.report.blocks import Sentence, Table
from mavdem.report.names import readable, short

UNCERTAIN_SCALE = 0.15  # standard deviation of the wind's size, relative, from which on it is said


def vehicle_blocks(found: VehicleFigures) -> list[Sentence | Table]:
    """A row an axis, the reasons for what is not reported, and a row a motor."""
    if not found.axes:  # A table without rows says nothing.
        return hover_blocks(found.hover)
    rows = [[name, *_axis_row(own)] for name, own in found.axes.items()]
    unit = next((own.flights[0].input_units[0] for own in found.axes.values() if own.flights), "") or "unit of input"
    header = ["axis", f"mean effect (°/s² per {unit})", "damping (1/s)", "lag (ms)", "wind's torque, sd (°/s²)"]
    return [
        Sentence(f"all settled flight of the log; ± is the half width of the {LEVEL:.0%} interval.", "Vehicle:"),
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
        "effect": _plus_minus(mean, half),
        "damping": _plus_minus(read.damping, damping),
        "lag": _plus_minus(1e3 * read.lag, 1e3 * lag),
    }
    marked = [f"{cell}{' (biased)' if read.status[name] == 'biased' else ''}" for name, cell in cells.items()]
    wind = f"{unit * own.wind.sd:.3g}" if own.wind is not None and own.wind.reason is None else "-"
    return [*marked, wind]


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
    return [f"{_listed(names).capitalize()}: {reason}" for reason, names in named.items() if reason]


def hover_blocks(found: HoverFigures | None) -> list[Sentence | Table]:
    """A row a motor: trim, imbalance, headroom, and the time at a limit."""
    if found is None:
        return []
    unit = f" ({found.unit})" if found.unit else ""
    lean = [
        f"{name} {angle:.1f}°" for name, angle in (("roll", found.roll), ("pitch", found.pitch)) if angle is not None
    ]
    columns = zip(found.motors, found.trim, found.imbalance, found.headroom, found.at_upper_limit, strict=True)
    return [
        Sentence(f"{found.seconds:.0f} s of settled flight; mean lean {_listed(lean) or 'not known'}.", "Motors:"),
        Table(
            ["motor", f"trim{unit}", "beyond the mean (%)", "headroom (%)", "at full throttle (%)"],
            [
                [short(name), f"{trim:.4g}", f"{more:+.1f}", f"{100 * left:.0f}", f"{100 * limited:.1f}"]
                for name, trim, more, left, limited in columns
            ],
        ),
    ]


def physical_blocks(flight: Flight, read: Physical | None) -> list[Sentence | Table]:
    """Effect, damping and lag of a flight, each with its interval or the reason why there is none."""
    if read is None:
        return []
    effect, damping, lag, _ = read.interval(LEVEL)
    unit, status = readable("rad/s²"), read.status
    per_input = f"{unit.name} per {flight.input_units[0] or 'unit of input'}"
    rows = [
        [
            f"effect of {short(name)}",
            _plus_minus(unit.scale * value, unit.scale * half),
            per_input,
            status["effect"],
        ]
        for name, value, half in zip(flight.input_names, read.effect, effect, strict=True)
    ]
    rows.append(["damping", _plus_minus(read.damping, damping), "1/s", status["damping"]])
    rows.append(["lag of the motors", _plus_minus(1e3 * read.lag, 1e3 * lag), "ms", status["lag"]])
    told = _reasons(read)
    lead = "Physical parameters (gray-box model):"
    refined = (
        f" Unseen windows are predicted better with: {_listed(list(read.refinements))}." if read.refinements else ""
    )
    return [
        Sentence(
            f"{_counted(len(read.windows.start))} of the flight; ± is the half width of the "
            f"{LEVEL:.0%} interval. This model has these parameters and the wind only, and is fitted beside "
            f"DEM's.{refined} {' '.join(told)}".rstrip(),
            lead,
        ),
        Table(["parameter", "estimate", "unit", "status"], rows),
        *(_over_time(read) if CHANGED in " ".join(read.reasons.values()) else []),
    ]


def _over_time(read: Physical) -> list[Sentence | Table]:
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


def _plus_minus(value: float, half: float) -> str:
    """An estimate rounded to what its half width bears; a dash where there is none."""
    if not isfinite(half):
        return "-"
    digit = floor(log10(half)) - (half < 3 * 10 ** floor(log10(half)))
    decimals = max(-digit, 0)
    return f"{round(value, -digit):.{decimals}f} ± {round(half, -digit):.{decimals}f}"


def _listed(words: Sequence[str]) -> str:
    return ", ".join(words[:-1]) + f" and {words[-1]}" if len(words) > 1 else "".join(words)


def wind_blocks(found: WindTorque | None) -> list[Sentence | Table]:
    """The wind's torque: its level, size and gusts, and what of it the motors had answered."""
    lead = "Wind's torque:"
    if found is None:
        return []
    if found.reason is not None:
        return [Sentence(found.reason, lead)]
    unit = readable("rad/s²")
    mean, half, sd = (unit.scale * value for value in (found.mean, found.mean_band, found.sd))
    text = (
        f"mean {mean:.3g} ± {half:.2g} {unit.name}, of equal motors and a centred load; standard deviation {sd:.3g} "
        f"{unit.name}."
    )
    if found.scale_error > UNCERTAIN_SCALE:
        text += f" Both are uncertain by {100 * found.scale_error:.0f} %, as the motor effect is."
    if isfinite(found.answered) and isfinite(found.answered_slow):
        slow = 100 * max(found.answered_slow, 0.0)
        if found.answered >= 0:
            text += f" The motors had answered {100 * found.answered:.0f} % of its variance, and {slow:.0f} % of that"
            text += " below 1 Hz."
        else:
            text += f" The motors had answered {slow:.0f} % of its variance below 1 Hz; to what is faster they added."
    count = len(found.gusts)
    text += (
        f" {count or 'No'} gust{'' if count == 1 else 's'} beyond {unit.scale * found.gust_threshold:.3g} {unit.name}"
    )
    if found.gusts:
        largest = max(found.gusts, key=lambda gust: abs(gust.size))
        text += (
            f"; the largest {unit.scale * largest.size:.3g} {unit.name}, {largest.length:.2g} s long, "
            f"{largest.start:.1f} s after the first sample"
        )
    return [Sentence(f"{text} (by chance {found.false_gusts_per_minute:.1g} a minute).", lead)]
