"""Figures of several: flights of one vehicle as small multiples, in order of date; methods; model orders."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import degrees
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from mavdem.alignment.drive import TILT_AXES
from mavdem.condition.wind_velocity import POINTS, WindVelocity, by_compass
from mavdem.dem.engine.linalg import Array
from mavdem.evaluate.comparison import Comparison
from mavdem.evaluate.scores import FROM_ZERO, KNOWN, ratio
from mavdem.fleet.row import NOT_IDENTIFIABLE, Flight, worst_health
from mavdem.report import palette
from mavdem.report.figures.style import HAIRLINE, WIDTH, Room, band, not_blown_up, picture, plain
from mavdem.report.numbers import TORQUE, short
from mavdem.report.timeline import Timeline

FEW = 25  # flights, up to which each has a dot and its own interval
COLUMNS = 3
MARKS = {"fault": ("o", palette.BAD), "drift": ("^", palette.LIMITED)}
"""Above the flights in which they were found; the shapes differ too, so that colour is not needed."""


class Panel(NamedTuple):
    """One quantity: its title with the unit, values and half widths (flights, 2) by line, NaN where not known."""

    title: str
    lines: dict[str, Array]
    reference: float = np.nan


def vehicle_figure(flights: Sequence[Flight]) -> Figure:
    """Draws what is known of the ``flights`` of one vehicle, with 90 % intervals; ``ValueError`` if that is nothing."""
    panels = [
        one
        for one in _panels(flights)
        if any(np.isfinite(line[:, 0]).any() for line in one.lines.values())
    ]
    if not panels:
        raise ValueError("no quantity of its flights is known")
    rows = -(-len(panels) // COLUMNS)
    days = [f"{flight[0].date:%Y-%m-%d}" if flight[0].date else "" for flight in flights]
    marks = [
        (place, health)
        for place, flight in enumerate(flights)
        if (health := worst_health(flight)) in MARKS
    ]
    room = Room(left=0.47, bottom=0.22, top=0.36, rows=0.7, columns=0.5)
    with picture(1.6 * rows, room, 1.8 * WIDTH) as figure:
        grid = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
        for axes, panel in zip(grid, panels, strict=False):
            _draw(axes, panel)
            axes.set_xticks(
                [0, len(flights) - 1], [days[0] or "first flight", days[-1] or "last flight"]
            )
            axes.get_xticklabels()[0].set_ha("left")
            axes.get_xticklabels()[1].set_ha("right")
            axes.set_xlim(-0.5, len(flights) - 0.5)
            for place, health in marks:
                shape, colour = MARKS[health]
                at = axes.get_xaxis_transform()
                axes.plot(
                    place, 1.0, shape, color=colour, markersize=4, clip_on=False, transform=at
                )
        for axes in grid[len(panels) :]:
            axes.set_visible(False)
    return figure


def wind_rose(flights: Sequence[Flight]) -> Figure:
    """Draws how many ``flights`` had wind from where, in classes of speed; ``ValueError`` if no direction is known."""
    winds = [
        known for row, *_ in flights if None not in (known := (row.wind_direction, row.wind_speed))
    ]
    angle, speed = np.array(winds).T
    return _rose(angle, speed, 1.0)


def rose_of_wind(wind: WindVelocity) -> Figure:
    """Draws what share of a flight the ``wind`` came from where, in classes of speed, %."""
    speed, origin, *_ = by_compass(wind.velocity, wind.band, wind.direction)
    return _rose(np.radians(origin), speed, 100 / len(speed))


def _rose(angle: Array, speed: Array, each: float) -> Figure:
    bottom = np.zeros(16)
    at = np.arange(16) * np.pi / 8
    with picture(2.8, width=4.4) as figure:
        axes: Any = figure.add_subplot(
            projection="polar", theta_offset=np.pi / 2, theta_direction=-1
        )
        for low, high in pairwise((0, 2, 4, 6, 8, 10, np.inf)):
            if (inside := (low <= speed) & (speed < high)).any():
                count = each * np.bincount(
                    np.rint(angle[inside] / at[1]).astype(int) % 16, minlength=16
                )
                label = f"{low:g} to {high:g} m/s" if high < np.inf else f"from {low:g} m/s"
                axes.bar(
                    at,
                    count,
                    0.35,
                    bottom,
                    color=palette.DISTURBANCE,
                    alpha=(low + 2) / 12,
                    label=label,
                )
                bottom = bottom + count
        axes.set_xticks(np.radians(np.arange(0, 360, 45)), POINTS[::2])
        axes.yaxis.set_major_locator(MaxNLocator(3, integer=True))
        axes.set_rlabel_position(22.5)
        axes.yaxis.set_major_formatter("{x:g}" if each == 1.0 else "{x:g} %")
        axes.legend(loc="center left", bbox_to_anchor=(1.12, 0.5))
    return figure


def flown_path(timeline: Timeline, wind: WindVelocity | None = None) -> Figure:
    """Draws the path over ground in a ``timeline`` with a position, north up, with a scale, and the mean ``wind``.

    Raises:
        ValueError: nothing was flown in that time.
    """
    place = timeline.position
    (first, last) = timeline.span
    if place is None or np.count_nonzero(rows := (place.time >= first) & (place.time <= last)) < 2:
        raise ValueError("there is no position in this flight")
    north, east = place.values[rows, :2].T
    size = max(float(np.ptp(north)), float(np.ptp(east)), 2.0)
    length = max(
        one
        for power in range(6)
        for one in (10**power, 2 * 10**power, 5 * 10**power)
        if one <= max(size / 2, 1)
    )
    with picture(3.4) as figure:
        axes = figure.subplots()
        axes.plot(east, north, color=palette.PREDICTED, linewidth=1.1)
        for end, mark, colour in ((0, "o", palette.GOOD), (-1, "s", palette.BAD)):
            axes.plot(east[end], north[end], mark, color=colour, markersize=5)
        middle = (east.min() + east.max()) / 2, (north.min() + north.max()) / 2
        left = middle[0] - 0.62 * size
        bottom = middle[1] - 0.62 * size
        axes.set(
            xlim=(left, left + 1.24 * size), ylim=(bottom, bottom + 1.24 * size), aspect="equal"
        )
        axes.set_axis_off()
        axes.plot(
            [left, left + length],
            [bottom, bottom],
            color=palette.INK_ON_LIGHT,
            linewidth=2,
            solid_capstyle="butt",
        )
        axes.annotate(
            f"{length} m",
            (left + length / 2, bottom),
            (0, 4),
            textcoords="offset points",
            ha="center",
        )
        _arrow(axes, (0.95, 0.98), (0.0, 1.0), "N", palette.INK_ON_LIGHT)
        if wind is not None and wind.directed and wind.boot == place.boot[0]:
            way = np.radians(wind.direction + 180)
            said = f"{wind.speed:.1f} m/s" if wind.sized else "wind"
            _arrow(axes, (0.15, 0.85), (np.sin(way), np.cos(way)), said, palette.DISTURBANCE)
    return figure


def _arrow(
    axes: Axes, tip: tuple[float, float], way: tuple[float, float], name: str, colour: str
) -> None:
    """An arrow of 30 points to a place of the axes, 0 to 1, with its name below."""
    place: dict[str, Any] = {
        "xycoords": "axes fraction",
        "textcoords": "offset points",
        "color": colour,
    }
    style = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.4, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tip, (-30 * way[0], -30 * way[1]), arrowprops=style, **place)
    axes.annotate(
        name, tip, (-15 * way[0], min(0, -30 * way[1]) - 11), ha="center", fontsize=7.5, **place
    )


def _draw(axes: Axes, panel: Panel) -> None:
    """Lines that break where a flight has no value, and their intervals, which widen the axis only so far."""
    if np.isfinite(panel.reference):
        axes.axhline(panel.reference, **HAIRLINE)
    for number, (name, line) in enumerate(panel.lines.items()):
        values, halves = line.T
        flights = np.arange(len(values), dtype=np.float64)
        colour = palette.distinct(number)
        few = len(values) <= FEW
        axes.plot(
            flights,
            values,
            "o-" if few else "-",
            color=colour,
            label=plain(name),
            markersize=3,
            linewidth=1,
        )
        if few:  # one path for all intervals
            ends = np.column_stack(
                [values - halves, values + halves, np.full_like(values, np.nan)]
            ).ravel()
            axes.plot(np.repeat(flights, 3), ends, color=colour, alpha=0.5, linewidth=0.8)
        else:
            band(axes, flights, values - halves, values + halves, colour)
    axes.set_title(plain(panel.title), fontsize=8, pad=12.0)
    not_blown_up(
        axes, [*(value for line in panel.lines.values() for value in line[:, 0]), panel.reference]
    )
    if len(panel.lines) > 1:
        above = (0.0, 0.99)
        axes.legend(
            fontsize=6.5,
            ncols=4,
            loc="lower left",
            bbox_to_anchor=above,
            handlelength=1,
            columnspacing=0.8,
        )


def _panels(flights: Sequence[Flight]) -> Iterator[Panel]:
    with_model = [
        row for flight in flights for row in flight if row.effect or row.damping is not None
    ]
    motors = next((row.motors for flight in reversed(flights) for row in flight if row.motors), ())
    shares = {
        short(name): _line(flights, "trim_share", entry=(i, len(motors)))
        for i, name in enumerate(motors)
    }
    yield Panel("Motor shares (1: all alike)", shares, 1.0)
    sizes = {name: _line(flights, "vibration", entry=(i, 3)) for i, name in enumerate("xyz")}
    level = _line(flights, "vibration", entry=(0, 1))
    yield Panel("Vibration (m/s²)", sizes if np.isnan(level).all() else {"level": level})
    for title, name, scale in (
        ("Phase margin (°)", "phase_margin", degrees(1)),
        ("Gain margin (dB)", "gain_margin", 1.0),
    ):
        yield Panel(title, {axis: scale * _line(flights, name, axis) for axis in TILT_AXES})
    kinds = sorted({row.per_input for row in with_model})
    for unit in kinds:
        for axis in TILT_AXES:
            count = max(
                (len(row.effect) for row in with_model if row.effect and row.per_input == unit),
                default=0,
            )
            names = (
                [*map(short, motors)]
                if count == len(motors)
                else [f"input {i + 1}" for i in range(count)]
            )
            # The size of an effectiveness, whose sign is only where the motor is.
            lines = {
                name: np.abs(TORQUE.scale * _line(flights, "effect", axis, unit, (i, count)))
                for i, name in enumerate(names)
            }
            yield Panel(f"Effectiveness on {axis} ({TORQUE.name} per {unit})", lines)
        # Both are the model's: with the demand as its input the time constant has the mixer's in it.
        beside = f", per {unit}" if len(kinds) > 1 else ""
        for title, name, scale in (
            ("Rate damping (1/s)", "damping", 1.0),
            ("Motor time constant (ms)", "lag", 1e3),
        ):
            yield Panel(
                f"{title}{beside}",
                {axis: scale * _line(flights, name, axis, unit) for axis in TILT_AXES},
            )
    torque = {axis: TORQUE.scale * _line(flights, "wind_torque_sd", axis) for axis in TILT_AXES}
    yield Panel(f"Wind torque, sd ({TORQUE.name})", torque)
    residual = {axis: TORQUE.scale * _line(flights, "residual_mean", axis) for axis in TILT_AXES}
    for axis in TILT_AXES:
        # That of healthy flights: about 0, and how far from it.
        usual = TORQUE.scale * _line(flights, "residual_mean_interval", axis)[:, 0]
        residual[f"usual on {axis}"] = np.column_stack([0.0 * usual, usual])
    yield Panel(f"Residual mean ({TORQUE.name})", residual, 0.0)
    yield Panel(
        "Error ratio (1: as the mean)",
        {axis: _line(flights, "error_ratio", axis) for axis in TILT_AXES},
        1.0,
    )


def _line(
    flights: Sequence[Flight],
    name: str,
    axis: str = "",
    unit: str = "",
    entry: tuple[int, int] | None = None,
) -> Array:
    """Value and half width of each flight (flights, 2), of this axis and unit, or any; ``entry``: which of how many."""
    line = np.full((len(flights), 2), np.nan)
    for place, flight in enumerate(flights):
        for row in flight:
            value = getattr(row, name)
            half = (
                getattr(row, f"{name}_interval", None)
                if name not in ("wind_torque_sd", "residual_mean")
                else None
            )
            if entry is not None:
                which, count = entry
                value, half = (
                    None if one is None or len(one) != count else one[which]
                    for one in (value, half)
                )
            refused = getattr(row, f"{name}_status", None) == NOT_IDENTIFIABLE
            wanted = axis in ("", row.axis) and unit in ("", row.per_input)
            if value is not None and wanted and not refused and np.isnan(line[place, 0]):
                line[place] = value, np.nan if half is None else half
    return line


SHOWN_RATIOS = 1e-3, 1e3  # error ratios beyond these are drawn at the edge


def error_ratios(comparison: Comparison, from_zero: bool = False) -> Figure:
    """Draws the error ratio of each method in each window over the whole test part, the lowest median first."""
    question = FROM_ZERO if from_zero else KNOWN
    columns = zip(comparison.methods, zip(*comparison.outcomes, strict=True), strict=True)
    ratios = {
        method: [float(ratio(one.of(question))[-1]) for one in column] for method, column in columns
    }
    medians = {method: float(np.median(values)) for method, values in ratios.items()}
    ranked = sorted(medians, key=medians.__getitem__)
    with picture(0.75 + 0.21 * len(ranked)) as figure:
        axes = figure.subplots()
        axes.axvline(1, **HAIRLINE)
        for place, method in enumerate(ranked):
            colour = palette.PREDICTED if method == comparison.methods[0] else palette.MEASURED
            values = np.clip(ratios[method], *SHOWN_RATIOS)
            median = np.clip(medians[method], *SHOWN_RATIOS)
            rows = np.full(len(values), place)
            axes.plot(values, rows, "o", color=colour, markersize=3.5, alpha=0.5, markeredgewidth=0)
            axes.plot(median, place, "|", color=colour, markersize=11, markeredgewidth=2.2)
        axes.set_xscale("log")
        axes.set_yticks(range(len(ranked)), ranked)
        axes.set_ylim(len(ranked) - 0.4, -0.6)
        axes.grid(axis="y", visible=False)
        axes.margins(x=0.03)
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set(xlabel="error ratio in each window, and the median (1: the constant mean)")
    return figure
