"""Charts of a vehicle over its flights."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import degrees

import numpy as np

from mavdem.alignment.drive import TILT_AXES
from mavdem.dem.engine.linalg import Array
from mavdem.fleet.row import NOT_IDENTIFIABLE, Flight, worst_health
from mavdem.report.charts import Axis, Chart, Group, Kind, Line, Mark
from mavdem.report.numbers import TORQUE, short
from mavdem.report.palette import BAD, LIMITED, distinct

MARKS = {"fault": BAD, "drift": LIMITED}
"""Colours of the flights in which they were found."""
COLUMNS = 3
QUANTITIES = (
    ("Phase margin (°)", "phase_margin", degrees(1)),
    ("Gain margin (dB)", "gain_margin", 1.0),
    ("Rate damping (1/s)", "damping", 1.0),
    ("Motor time constant (ms)", "lag", 1e3),
    (f"Wind torque, sd ({TORQUE.name})", "wind_torque_sd", TORQUE.scale),
    ("Error ratio (1: as the mean)", "error_ratio", 1.0),
)
"""Title, column and scale of what has a line an axis."""
Lines = dict[str, Array]
"""Values and half widths (flights, 2) by name, NaN where not known."""


def vehicle_group(flights: Sequence[Flight]) -> Group | None:
    """Returns what is known of the ``flights`` of one vehicle, with 90 % intervals; None if that is nothing."""
    days = [f"{flight[0].date:%Y-%m-%d}" if flight[0].date else "" for flight in flights]
    between = [""] * (len(flights) - 2)
    axis = Axis("flight", names=(days[0] or "first", *between, days[-1] or "last"))
    marks = tuple(
        Mark(float(place), health, MARKS[health])
        for place, flight in enumerate(flights)
        if (health := worst_health(flight)) in MARKS
    )
    charts = [
        Chart(title, axis, Axis(""), drawn, marks=marks)
        for title, lines in _panels(flights)
        if (drawn := tuple(_drawn(lines)))
    ]
    columns = (tuple(charts[first::COLUMNS]) for first in range(COLUMNS))
    return Group(tuple(filter(None, columns))) if charts else None


def _drawn(lines: Lines) -> Iterator[Line]:
    for number, (name, line) in enumerate(lines.items()):
        values, halves = line.T
        if np.isfinite(values).any():
            around = np.nan_to_num(halves)
            flights = np.arange(len(values), dtype=np.float64)
            yield Line.around(name, distinct(number), flights, values, around, Kind.DOTS)


def _panels(flights: Sequence[Flight]) -> Iterator[tuple[str, Lines]]:
    """Yields the title, with the unit, and the lines of each quantity."""
    motors = next((row.motors for flight in reversed(flights) for row in flight if row.motors), ())
    shares = {
        short(name): _line(flights, "trim_share", entry=(i, len(motors)))
        for i, name in enumerate(motors)
    }
    yield ("Motor shares (1: all alike)", shares)
    sizes = {name: _line(flights, "vibration", entry=(i, 3)) for i, name in enumerate("xyz")}
    level = _line(flights, "vibration", entry=(0, 1))
    yield ("Vibration (m/s²)", sizes if np.isnan(level).all() else {"level": level})
    inputs = sorted({row.per_input for flight in flights for row in flight if row.damping})
    for title, name, scale in QUANTITIES:
        # With the demand as its input the time constant has the mixer's in it.
        units = inputs if name in ("damping", "lag") and len(inputs) > 1 else [""]
        for unit in units:
            lines = {axis: scale * _line(flights, name, axis, unit) for axis in TILT_AXES}
            yield (f"{title}, per {unit}" if unit else title, lines)


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
            half = getattr(row, f"{name}_interval", None) if name != "wind_torque_sd" else None
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
