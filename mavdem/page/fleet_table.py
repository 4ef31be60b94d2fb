"""The table of a fleet: a line a flight and axis, its cells rounded to what their intervals bear."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import PurePath
from typing import NamedTuple
from urllib.parse import quote

from mavdem.fleet.row import OK, UNKNOWN, FlightRow
from mavdem.page.fleet_charts import NOT_IDENTIFIABLE, input_unit
from mavdem.report.numbers import plus_minus, readable, rounded

HEADER = (
    ("flight", "text"),
    ("vehicle", "text"),
    ("date", "text"),
    ("axis", "text"),
    ("tier", "text"),
    ("health", "health"),
    ("motor", "text"),
    ("settled (s)", "number"),
    ("largest share", "number"),
    ("mean effect (°/s²)", "number"),
    ("damping (1/s)", "number"),
    ("lag (ms)", "number"),
    ("wind's torque (°/s²)", "number"),
    ("residual mean (°/s²)", "number"),
    ("error ratio", "number"),
    ("notes", "text"),
)
"""Names of the columns, and what they are sorted as."""
ALWAYS = 6  # columns that are there even if they are empty
NOT_USED = "not used"  # in the place of the health of a log without a flight
MAX_NOTE = 160  # letters of the notes of a line: the page of the flight has all
_ANGLE = readable("rad/s²").scale


class FlightLine(NamedTuple):
    """A line: the flight's page as a link relative to the index, or "", its name in full, and cells by ``HEADER``."""

    link: str
    file: str
    cells: Sequence[str]


def flight_table(rows: Sequence[FlightRow]) -> tuple[list[tuple[str, str]], list[FlightLine]]:
    """The header and the lines, without the columns of which no row knows anything."""
    lines = [flight_line(row) for row in rows]
    kept = [
        place
        for place in range(len(HEADER))
        if place < ALWAYS or place == len(HEADER) - 1 or any(line.cells[place] for line in lines)
    ]
    header = [HEADER[place] for place in kept]
    return header, [line._replace(cells=[line.cells[place] for place in kept]) for line in lines]


def flight_line(row: FlightRow) -> FlightLine:
    """The line of a row, all its cells; one is empty where a value is not known."""
    name = PurePath(row.file).name or row.file
    if row.status != OK:
        empty = [""] * (len(HEADER) - 8)
        when = "" if row.date is None else f"{row.date:%Y-%m-%d %H:%M}"
        vehicle = "" if row.vehicle == UNKNOWN else row.vehicle
        cells = [name, vehicle, when, row.axis or "", row.tier or "", NOT_USED, "", *empty, _cut(row.status)]
        return FlightLine(_link(row), row.file, cells)
    share = "" if not row.trim_share else f"{max(row.trim_share):.3f} (motor {_largest(row.trim_share) + 1})"
    cells = [
        name,
        row.vehicle,
        "" if row.date is None else f"{row.date:%Y-%m-%d %H:%M}",
        row.axis or "",
        row.tier or "",
        row.health,
        "" if row.suspect_motor is None else str(row.suspect_motor),
        _number(row.duration, digits=3),
        share,
        _mean_effect(row),
        _estimate(row.damping, row.damping_interval, row.damping_status),
        _estimate(row.lag, row.lag_interval, row.lag_status, 1e3),
        _number(row.wind_torque_sd, _ANGLE),
        _residual(row),
        _number(row.error_ratio),
        _cut(" ".join([*([row.health_reason] if row.health_reason and row.health != OK else []), *row.warnings])),
    ]
    return FlightLine(_link(row), row.file, cells)


def _link(row: FlightRow) -> str:
    # A colon would make what comes before it a scheme.
    return "" if row.page is None else quote(row.page, safe="/")


def _largest(shares: Sequence[float]) -> int:
    return max(range(len(shares)), key=lambda place: shares[place])


def _number(value: float | None, scale: float = 1.0, digits: int = 2) -> str:
    return "" if value is None else rounded(scale * value, digits)


def _estimate(value: float | None, half: float | None, status: str | None, scale: float = 1.0) -> str:
    if value is None or status == NOT_IDENTIFIABLE:
        return ""
    if half is None or not isfinite(half):
        return rounded(scale * value)
    return plus_minus(scale * value, scale * half)


def _residual(row: FlightRow) -> str:
    """The figure, and how large it is in healthy flights."""
    usual = "" if row.residual_mean_interval is None else f" (usual ±{rounded(_ANGLE * row.residual_mean_interval)})"
    return "" if row.residual_mean is None else f"{rounded(_ANGLE * row.residual_mean)}{usual}"


def _mean_effect(row: FlightRow) -> str:
    """The mean size over the motors, and the unit."""
    if not row.effect or row.effect_status == NOT_IDENTIFIABLE:
        return ""
    mean = _ANGLE * sum(map(abs, row.effect)) / len(row.effect)
    return f"{rounded(mean, 3)} per {input_unit(row)}"


def _cut(text: str) -> str:
    return text if len(text) <= MAX_NOTE else f"{text[: MAX_NOTE - 1]}…"
