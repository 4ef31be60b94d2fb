"""Charts of one vehicle: each quantity over its flights, in order of date, with its 90 % band and what was found."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from math import nan
from typing import NamedTuple

from markupsafe import Markup

from mavdem.fleet.row import FlightRow
from mavdem.page.line_chart import MARKS, Line, LineChart, Mark, line_chart
from mavdem.report.numbers import readable, short
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
    with_model = [row for flight in flights for row in flight if row.effect or row.damping is not None]
    kinds = sorted({input_unit(row) for row in with_model})
    angle = readable("rad/s²")
    yield from _if_known(
        "Motor shares (1: all alike)",
        [
            _line(short(name), flights, "", partial(_entry, "trim_share", place, len(motors)))
            for place, name in enumerate(motors)
        ],
        1.0,
    )
    for per in kinds:
        for axis in AXES:
            count = max((len(row.effect) for row in with_model if row.effect and input_unit(row) == per), default=0)
            names = map(short, motors if count == len(motors) else [f"input {i + 1}" for i in range(count)])
            reads = [partial(_effect, place, count, per) for place in range(count)]
            yield from _if_known(
                f"Effect on {axis} ({angle.name} per {per})",
                [_line(name, flights, axis, read, angle.scale) for name, read in zip(names, reads, strict=True)],
            )
        # Damping and lag are the model's: with the demand as its input the lag has the mixer's in it.
        beside = f", per {per}" if len(kinds) > 1 else ""
        for title, name, scale in (("Damping (1/s)", "damping", 1.0), ("Lag of the motors (ms)", "lag", 1e3)):
            lines = [_line(axis, flights, axis, partial(_of_kind, per, name), scale) for axis in AXES]
            yield from _if_known(f"{title}{beside}", lines)
    wind = [_line(axis, flights, axis, partial(_figure, "wind_torque_sd"), angle.scale) for axis in AXES]
    yield from _if_known(f"Wind's torque, sd ({angle.name})", wind)
    residuals = [_line(axis, flights, axis, partial(_figure, "residual_mean"), angle.scale) for axis in AXES]
    usual = [_line(f"usual on {axis}", flights, axis, _usual_residual, angle.scale) for axis in AXES]
    yield from _if_known(f"Residual mean ({angle.name})", [*residuals, *usual], 0.0)
    ratios = [_line(axis, flights, axis, partial(_figure, "error_ratio")) for axis in AXES]
    yield from _if_known("Error ratio (1: as the constant mean)", ratios, 1.0)


def input_unit(row: FlightRow) -> str:
    """The unit of the model's inputs in words: an effect is for one of them."""
    return "unit of demand" if row.inputs == "demand" else row.input_unit or "unit of input"


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


def _effect(place: int, count: int, per: str, row: FlightRow) -> tuple[float, float]:
    """The size of a motor's effect, whose sign is only where the motor is."""
    if row.effect_status == NOT_IDENTIFIABLE or input_unit(row) != per:
        return nan, nan
    value, half = _entry("effect", place, count, row)
    return abs(value), half


def _of_kind(per: str, name: str, row: FlightRow) -> tuple[float, float]:
    return _figure(name, row) if input_unit(row) == per else (nan, nan)


def _usual_residual(row: FlightRow) -> tuple[float, float]:
    """The residual mean of healthy flights: about 0, and how far from it."""
    return (nan, nan) if row.residual_mean_interval is None else (0.0, row.residual_mean_interval)


def _figure(name: str, row: FlightRow) -> tuple[float, float]:
    value = getattr(row, name)
    if value is None or getattr(row, f"{name}_status", None) == NOT_IDENTIFIABLE:
        return nan, nan
    half = None if name in ("wind_torque_sd", "residual_mean") else getattr(row, f"{name}_interval", None)
    return value, nan if half is None else half


NOT_IDENTIFIABLE = "not identifiable"
