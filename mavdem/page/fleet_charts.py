"""Charts of one vehicle: each quantity over its flights, in order of date, with its 90 % band and what was found."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from math import nan
from typing import NamedTuple

from markupsafe import Markup

from mavdem.fleet.row import FlightRow
from mavdem.page.line_chart import MARKS, Line, LineChart, Mark, line_chart
from mavdem.report.names import readable, short
from mavdem.report.palette import distinct

Flights = Sequence[Sequence[FlightRow]]
"""Flights in order of date, the rows of each: one an axis."""
AXES = ("roll", "pitch")


class FleetDrawing(NamedTuple):
    """A chart of the page: its title, its lines' names with their colours (none for one line), and the picture."""

    title: str
    legend: Sequence[tuple[str, str]]
    svg: Markup


def vehicle_drawings(flights: Flights) -> list[FleetDrawing]:
    """The charts of what is known of at least one flight."""
    marks = [mark for place, flight in enumerate(flights) for mark in _marks(place, flight)]
    first, last = (day(flight[0]) for flight in (flights[0], flights[-1]))
    return [
        FleetDrawing(
            chart.title,
            [(line.name, distinct(number)) for number, line in enumerate(chart.lines)] if len(chart.lines) > 1 else [],
            line_chart(chart, marks, first or "first flight", last or "last flight"),
        )
        for chart in _charts(flights)
    ]


def day(row: FlightRow) -> str:
    """The date of a flight; empty where it is not known."""
    return "" if row.date is None else f"{row.date:%Y-%m-%d}"


def _marks(place: int, flight: Sequence[FlightRow]) -> Iterator[Mark]:
    """The worst of what was found in a flight."""
    for kind in MARKS:
        found = next((row for row in flight if row.health == kind), None)
        if found is not None:
            words = [day(found), found.file, f"{kind}: {found.health_reason}" if found.health_reason else kind]
            yield Mark(place, kind, ", ".join(word for word in words if word))
            return


def _charts(flights: Flights) -> Iterator[LineChart]:
    named = [row for flight in flights for row in flight if row.motors]
    motors = named[-1].motors or () if named else ()
    units = {row.input_unit for row in named}
    angle = readable("rad/s²")
    yield from _if_known(
        "Motor shares (1: all alike)",
        [
            _line(short(name), flights, "", partial(_entry, "trim_share", place, len(motors)))
            for place, name in enumerate(motors)
        ],
        1.0,
    )
    if len(units) == 1:
        per = next(iter(units)) or "unit of input"
        for axis in AXES:
            count = max((len(row.effect) for flight in flights for row in flight if row.effect), default=0)
            names = map(short, motors if count == len(motors) else [f"input {i + 1}" for i in range(count)])
            reads = [partial(_effect, place, count) for place in range(count)]
            yield from _if_known(
                f"Effect on {axis} ({angle.name} per {per})",
                [_line(name, flights, axis, read, angle.scale) for name, read in zip(names, reads, strict=True)],
            )
    for title, name, scale, reference in (
        ("Damping (1/s)", "damping", 1.0, nan),
        ("Lag of the motors (ms)", "lag", 1e3, nan),
        (f"Wind's torque, sd ({angle.name})", "wind_torque_sd", angle.scale, nan),
        (f"Residual mean ({angle.name})", "residual_mean", angle.scale, 0.0),
        ("Error ratio (1: as without a model)", "error_ratio", 1.0, 1.0),
    ):
        lines = [_line(axis, flights, axis, partial(_figure, name), scale) for axis in AXES]
        yield from _if_known(title, lines, reference)


def _if_known(title: str, lines: Sequence[Line], reference: float = nan) -> Iterator[LineChart]:
    known = [line for line in lines if any(value == value for value in line.values)]
    if known:
        yield LineChart(title, known, reference)


def _line(
    name: str, flights: Flights, axis: str, read: Callable[[FlightRow], tuple[float, float]], scale: float = 1.0
) -> Line:
    """The value and half width of each flight, of its row of this axis or, for "", of any."""
    pairs = []
    for flight in flights:
        found = [read(row) for row in flight if axis in ("", row.axis)]
        pairs.append(next((pair for pair in found if pair[0] == pair[0]), (nan, nan)))
    return Line(name, [scale * value for value, _ in pairs], [scale * half for _, half in pairs])


def _entry(name: str, place: int, count: int, row: FlightRow) -> tuple[float, float]:
    """An entry of a list column and of its interval; NaN where the list has not ``count`` entries."""
    values, halves = getattr(row, name), getattr(row, f"{name}_interval")
    if values is None or len(values) != count:
        return nan, nan
    half = halves[place] if halves is not None and len(halves) == count else None
    return values[place], nan if half is None else half


def _effect(place: int, count: int, row: FlightRow) -> tuple[float, float]:
    """The size of a motor's effect, whose sign is only where the motor is."""
    if row.effect_status == NOT_IDENTIFIABLE:
        return nan, nan
    value, half = _entry("effect", place, count, row)
    return abs(value), half


def _figure(name: str, row: FlightRow) -> tuple[float, float]:
    value = getattr(row, name)
    if value is None or getattr(row, f"{name}_status", None) == NOT_IDENTIFIABLE:
        return nan, nan
    half = getattr(row, f"{name}_interval", None) if name != "wind_torque_sd" else None
    return value, nan if half is None else half


NOT_IDENTIFIABLE = "not identifiable"
