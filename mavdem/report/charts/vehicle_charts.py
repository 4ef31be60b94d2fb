"""Charts of a vehicle over its flights."""

from collections.abc import Iterator, Sequence
from math import degrees

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.axes import TILT_AXES
from mavdem.fleet.flights import AxisRows, worst_health
from mavdem.report.charts.chart import Axis, Chart, Group, Kind, Line, Mark
from mavdem.report.numbers import TORQUE_UNIT, without_remark
from mavdem.report.palette import BAD, LIMITED, distinct

MARKS = {"fault": ("●", BAD), "drift": ("▲", LIMITED)}
"""How flights are marked in which they were found."""
COLUMNS = 3
QUANTITIES = (
    ("Phase margin (°)", "phase_margin", degrees(1)),
    ("Gain margin (dB)", "gain_margin", 1.0),
    ("Rate damping (1/s)", "damping", 1.0),
    ("Motor time constant (ms)", "lag", 1e3),
    (f"Wind torque, sd ({TORQUE_UNIT.name})", "wind_torque_sd", TORQUE_UNIT.scale),
    ("Error ratio (1: as the mean)", "error_ratio", 1.0),
)
"""Title, column and scale of what has a line an axis."""
Lines = dict[str, Array]
"""Values and half widths (flights, 2) by name, NaN where not known."""


def vehicle_group(flights: Sequence[AxisRows]) -> Group | None:
    """Returns what is known of the ``flights`` of one vehicle, with 90 % intervals; None if that is nothing."""
    days = [f"{flight[0].date:%Y-%m-%d}" if flight[0].date else "" for flight in flights]
    between = [""] * (len(flights) - 2)
    axis = Axis("flight", names=(days[0] or "first", *between, days[-1] or "last"))
    marks = tuple(
        Mark(float(number), *MARKS[health])
        for number, flight in enumerate(flights)
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


def _panels(flights: Sequence[AxisRows]) -> Iterator[tuple[str, Lines]]:
    """Yields the title, with the unit, and the lines of each quantity."""
    motors = next((row.motors for flight in reversed(flights) for row in flight if row.motors), ())
    shares = _estimates(flights, "trim_share", len(motors))
    yield ("Motor shares (mean 1)", dict(zip(map(without_remark, motors), shares, strict=True)))
    yield (
        "Vibration, first IMU (m/s²)",
        dict(zip("xyz", _estimates(flights, "vibration", 3), strict=True)),
    )
    yield (
        "Vibration level, first IMU (m/s²)",
        {"level": _estimates(flights, "vibration", 1)[0]},
    )
    inputs = sorted({row.per_input for flight in flights for row in flight if row.damping})
    for title, name, scale in QUANTITIES:
        # With the demand as its input the time constant has the mixer's in it.
        units = inputs if name in ("damping", "lag") and len(inputs) > 1 else [""]
        for unit in units:
            lines = {
                axis: scale * _estimates(flights, name, 1, axis, unit)[0] for axis in TILT_AXES
            }
            yield (f"{title}, per {unit}" if unit else title, lines)


def _estimates(
    flights: Sequence[AxisRows], name: str, count: int, axis: str = "", unit: str = ""
) -> Array:
    """So many values with half widths (count, flights, 2), of this axis and unit, or any."""
    estimates = np.full((len(flights), count, 2), np.nan)
    for number, flight in enumerate(flights):
        for row in flight:
            value = getattr(row, name)
            wanted = axis in ("", row.axis) and unit in ("", row.per_input)
            if value is not None and np.size(value) == count and wanted:
                estimates[number, :, 0] = value
                half = getattr(row, f"{name}_interval", None)
                estimates[number, :, 1] = np.nan if half is None else half
                break
    return estimates.swapaxes(0, 1)
