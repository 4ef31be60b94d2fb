"""Line charts drawn as SVG without a library: small, many to a page, in the looks of the other pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import ceil, floor, isfinite, isnan, log10, nan
from typing import NamedTuple

from markupsafe import Markup

from mavdem.report.palette import BAD, BAND_OPACITY, BOUND, DISTINCT, LIMITED

WIDTH, HEIGHT = 360, 170
"""Units of the picture, about pixels."""
LEFT, RIGHT, TOP, BOTTOM = 46, 8, 16, 22
MAX_BEYOND = 0.6  # spans of the values, how far a band may widen the axis
MAX_POINTS = 150  # of a line: where there are more, neighbours are drawn as one
FEW_POINTS = 40  # up to so many each has a dot
MARKS = {"fault": BAD, "drift": LIMITED}
_STEPS = (1.0, 2.0, 5.0, 10.0)


class Line(NamedTuple):
    """One line: a value for each place, NaN where it is not known, and the half widths of its band, NaN likewise."""

    name: str
    values: Sequence[float]
    halves: Sequence[float]


class LineChart(NamedTuple):
    """Lines over the same places from left to right.

    Attributes:
        title: what is shown, with its unit.
        lines: at least one, of equal length.
        reference: value of a thin line to compare with; NaN: none.
    """

    title: str
    lines: Sequence[Line]
    reference: float = nan


class Mark(NamedTuple):
    """A flight marked above the lines: its place, "fault" or "drift", and what the mark says when pointed at."""

    place: int
    kind: str
    text: str


def line_chart(chart: LineChart, marks: Sequence[Mark], first: str, last: str) -> Markup:
    """The chart as an ``<svg>`` element; ``first`` and ``last`` stand below its ends. All text is escaped."""
    count = len(chart.lines[0].values)
    lines = [_merged(line) for line in chart.lines]
    frame = _Frame(count, *_limits(lines, chart.reference))
    drawn = [_grid(frame, tick) for tick in _ticks(frame.low, frame.high)]
    if frame.low <= chart.reference <= frame.high:
        level = _short(frame.y(chart.reference))
        drawn.append(Markup('<path d="M{} {}H{}" stroke="{}"/>').format(LEFT, level, WIDTH - RIGHT, BOUND))
    coloured = [(line, DISTINCT[number % len(DISTINCT)]) for number, line in enumerate(lines)]
    opacity = BAND_OPACITY if len(lines) == 1 else BAND_OPACITY / 2
    drawn += [part for line, colour in coloured for part in _band(frame, line, colour, opacity)]
    drawn += [part for line, colour in coloured for part in _line(frame, line, colour)]
    drawn += [_mark(mark, frame.x(mark.place)) for mark in marks]
    bottom, right = HEIGHT - BOTTOM, WIDTH - RIGHT
    drawn.append(Markup('<path class="axis" d="M{} {}V{}H{}"/>').format(LEFT, TOP, bottom, right))
    drawn.append(Markup('<text x="{}" y="{}">{}</text>').format(LEFT, HEIGHT - 6, first))
    if count > 1:
        drawn.append(Markup('<text x="{}" y="{}" class="end">{}</text>').format(right, HEIGHT - 6, last))
    label = f"{chart.title}, {count} flights in order of date"
    head = Markup('<svg viewBox="0 0 {} {}" class="chart" role="img" aria-label="{}">').format(WIDTH, HEIGHT, label)
    return head + Markup("").join(drawn) + Markup("</svg>")


class _Points(NamedTuple):
    """A line as it is drawn: places from left to right, values and half widths, NaN where not known."""

    places: list[float]
    values: list[float]
    halves: list[float]


class _Frame(NamedTuple):
    """Where a place and a value lie in the picture."""

    flights: int
    low: float
    high: float

    def x(self, place: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * (place + 0.5) / self.flights

    def y(self, value: float) -> float:
        inside = min(max(value, self.low), self.high)
        return HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (inside - self.low) / (self.high - self.low)

    def points(self, places: Sequence[float], values: Sequence[float]) -> str:
        pairs = zip(places, values, strict=True)
        return " ".join(f"{_short(self.x(place))},{_short(self.y(value))}" for place, value in pairs)


def _grid(frame: _Frame, tick: float) -> Markup:
    """The line and the number of a tick."""
    height = frame.y(tick)
    return Markup('<path class="grid" d="M{} {}H{}"/><text x="{}" y="{}" class="end">{}</text>').format(
        LEFT, _short(height), WIDTH - RIGHT, LEFT - 5, _short(height + 3), _tick_text(tick, frame)
    )


def _band(frame: _Frame, line: _Points, colour: str, opacity: float) -> Iterator[Markup]:
    """Where the values may be: an area, or a bar where the neighbours have none."""
    for begin, end in _runs([value + half for value, half in zip(line.values, line.halves, strict=True)]):
        places, values, halves = line.places[begin:end], line.values[begin:end], line.halves[begin:end]
        upper = [value + half for value, half in zip(values, halves, strict=True)]
        lower = [value - half for value, half in zip(values, halves, strict=True)]
        if len(places) == 1:
            x, high, low = (_short(number) for number in (frame.x(places[0]), frame.y(upper[0]), frame.y(lower[0])))
            bar = Markup('<path d="M{} {}V{}" stroke="{}" stroke-opacity="{}" stroke-width="6"/>')
            yield bar.format(x, high, low, colour, 2 * opacity)
        else:
            outline = f"{frame.points(places, upper)} {frame.points(places[::-1], lower[::-1])}"
            area = Markup('<polygon points="{}" fill="{}" fill-opacity="{}"/>')
            yield area.format(outline, colour, opacity)


def _line(frame: _Frame, line: _Points, colour: str) -> Iterator[Markup]:
    """The values, with a gap where one is not known, and dots where they are few."""
    for begin, end in _runs(line.values):
        places, values = line.places[begin:end], line.values[begin:end]
        if len(places) > 1:
            yield Markup('<polyline points="{}" stroke="{}"/>').format(frame.points(places, values), colour)
        if len(places) == 1 or frame.flights <= FEW_POINTS:
            pairs = zip(places, values, strict=True)
            dots = "".join(f"M{_short(frame.x(place))} {_short(frame.y(value))}h0" for place, value in pairs)
            yield Markup('<path class="dot" d="{}" stroke="{}"/>').format(dots, colour)


def _mark(mark: Mark, x: float) -> Markup:
    """A disc for a fault and a triangle for a drift, so that colour is not needed to know them apart."""
    top = TOP - 9
    if mark.kind == "fault":
        shape = Markup('<circle cx="{}" cy="{}" r="4.5" fill="{}">').format(_short(x), top + 1, MARKS["fault"])
        end = Markup("</circle>")
    else:
        corners = f"{_short(x)},{top - 4} {_short(x + 5)},{top + 5} {_short(x - 5)},{top + 5}"
        shape = Markup('<polygon points="{}" fill="{}">').format(corners, MARKS["drift"])
        end = Markup("</polygon>")
    return shape + Markup("<title>{}</title>").format(mark.text) + end


def _merged(line: Line) -> _Points:
    """The line as it is drawn: of more than ``MAX_POINTS`` neighbours are one: their mean and all their bands."""
    count = len(line.values)
    size = ceil(count / MAX_POINTS)
    if size == 1:
        return _Points([float(place) for place in range(count)], list(line.values), list(line.halves))
    merged = _Points([], [], [])
    for begin in range(0, count, size):
        part = range(begin, min(begin + size, count))
        known = [place for place in part if isfinite(line.values[place])]
        mean = sum(line.values[place] for place in known) / len(known) if known else nan
        reach = [
            abs(line.values[place] - mean) + (0.0 if isnan(line.halves[place]) else line.halves[place])
            for place in known
        ]
        merged.places.append((part[0] + part[-1]) / 2)
        merged.values.append(mean)
        merged.halves.append(max(reach, default=nan))
    return merged


def _runs(values: Sequence[float]) -> list[tuple[int, int]]:
    """First and end of each run of finite values."""
    runs: list[tuple[int, int]] = []
    for place, value in enumerate(values):
        if not isfinite(value):
            continue
        if runs and runs[-1][1] == place:
            runs[-1] = (runs[-1][0], place + 1)
        else:
            runs.append((place, place + 1))
    return runs


def _limits(lines: Sequence[_Points], reference: float) -> tuple[float, float]:
    """The lowest and the highest value shown: bands widen the axis only so far."""
    known = [value for line in lines for value in line.values if isfinite(value)]
    low, high = min(known), max(known)
    span = high - low or abs(high) or 1.0
    ends = [
        (value - half, value + half)
        for line in lines
        for value, half in zip(line.values, line.halves, strict=True)
        if isfinite(value) and isfinite(half)
    ]
    bottom = max(min([low, *(lower for lower, _ in ends)]), low - MAX_BEYOND * span)
    top = min(max([high, *(upper for _, upper in ends)]), high + MAX_BEYOND * span)
    if isfinite(reference) and bottom - span <= reference <= top + span:
        bottom, top = min(bottom, reference), max(top, reference)
    margin = 0.06 * (top - bottom) or 0.5 * span
    return bottom - margin, top + margin


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers between the limits, one to five of them."""
    rough = (high - low) / 4
    power = 10.0 ** floor(log10(rough))
    step = next(step for step in _STEPS if rough <= step * power * (1 + 1e-9)) * power
    first = ceil(low / step)
    return [number * step for number in range(first, floor(high / step) + 1)]


def _tick_text(tick: float, frame: _Frame) -> str:
    decimals = max(0, -floor(log10((frame.high - frame.low) / 4)))
    largest = max(abs(frame.low), abs(frame.high))
    if largest >= 1e5 or decimals > 4:
        return f"{tick:.1e}"
    return f"{tick:.{decimals}f}".replace("-", "−") if tick else "0"


def _short(number: float) -> str:
    """At most one decimal."""
    return f"{number:.1f}".removesuffix(".0")
