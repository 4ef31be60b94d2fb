"""Charts: curves by iteration, and bars, drawn with their axes as two-dimensional scenes.

All plots over time of a recording follow one timeline, which is that of the flight: what is not over that has no other
picture in the viewer. Here lines are labelled where they end, with what they come to.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, floor, log10
from typing import NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike, NDArray

from mavdem.report import palette
from mavdem.view.time_plot import faint

Array = NDArray[np.float64]

ITERATION = "iteration"
"""Timeline, 0 is the prior: the values of the curves are on it too."""

HEIGHT = 100.0  # of a chart's frame; all lengths of a scene are in percent of it
LETTER, LINE = 1.65, 4.8  # about the width of a letter and the height of a line: the viewer has one size of text
BAR_STROKES = 40
SHARES = (0.0, 1 / 3, 2 / 3, 1.0)  # of all iterations, where they are numbered
FINAL = 1.12  # where final values stand, in lengths of the axis


class IterationCurve(NamedTuple):
    """Values (I + 1,) by iteration, the ``final`` one with the half width of its interval, and what that is called."""

    name: str
    colour: str
    values: Array
    final: float
    half: float
    label: str


class Chart:
    """A scene of lines and text at an entity."""

    def __init__(self, recording: rr.RecordingStream, origin: str) -> None:
        self._recording, self._origin = recording, origin

    def lines(self, name: str, strips: Sequence[ArrayLike], colour: str, width: float) -> None:
        """Lines of a ``width`` in points."""
        radius, colours = rr.Radius.ui_points(width / 2), [palette.channels(colour)]
        drawn = rr.LineStrips2D([np.asarray(strip) for strip in strips], radii=radius, colors=colours)
        self._recording.log(self._path(name), drawn, static=True)

    def text(self, name: str, places: Sequence[tuple[float, float]], words: Sequence[str], colour: str) -> None:
        """Words beginning to the right of their places."""
        centres = [(x + LETTER * len(text) / 2, y - LINE / 2) for (x, y), text in zip(places, words, strict=True)]
        invisible, colours = rr.Radius.ui_points(0.0), [palette.channels(colour)]
        points = rr.Points2D(centres, labels=words, radii=invisible, colors=colours, show_labels=True)
        self._recording.log(self._path(name), points, static=True)

    def values(self, name: str, values: Array) -> None:
        """Keeps values (I + 1,) on the timeline of iterations."""
        index = rr.TimeColumn(ITERATION, sequence=np.arange(len(values)))
        self._recording.send_columns(self._path(name), [index], rr.Scalars.columns(scalars=values))

    def _path(self, name: str) -> str:
        return f"{self._origin}/{rr.escape_entity_path_part(name)}"

    def view(self, title: str, width: float, left: float, below: float = 8.0) -> rrb.View:
        """A frame ``width`` wide, with room for text at its ``left`` and ``below`` it."""
        bounds = rrb.VisualBounds2D(x_range=(-left, width), y_range=(-6.0, HEIGHT + below))
        return rrb.Spatial2DView(name=title, origin=self._origin, visual_bounds=bounds)


def iteration_chart(
    recording: rr.RecordingStream, origin: str, title: str, curves: Sequence[IterationCurve], length: float = 130.0
) -> rrb.View:
    """Curves over the iterations, and after them the final values with their intervals."""
    chart, last = Chart(recording, origin), max(len(curves[0].values) - 1, 1)
    # The first iterations may be far from all others.
    ends = [edge for curve in curves for edge in _interval(curve)]
    everything = np.concatenate([*(curve.values[min(2, last) :] for curve in curves), ends])
    low, high = float(everything.min()), float(everything.max())
    span = max(high - low, 1e-9 * max(abs(low), abs(high), 1.0))
    high = low + span

    def height(values: ArrayLike) -> Array:
        return np.clip(HEIGHT * (1 - (np.asarray(values, np.float64) - low) / span), 0.0, HEIGHT)

    ticks = _ticks(low, high)
    final, heights = FINAL * length, height(ticks)
    chart.lines("0 grid", [[(0.0, row), (final, row)] for row in heights], faint(palette.BOUND, 0.35), 1.0)
    numbers = [f"{tick + 0.0:.6g}" for tick in ticks]
    left = LETTER * max(map(len, numbers)) + 6.0
    chart.text("0 numbers", [(-left, row + LINE / 4) for row in heights], numbers, palette.BOUND)
    steps = sorted({round(share * last) for share in SHARES})
    chart.text(
        "0 steps",
        [(x - 1.0, HEIGHT + LINE) for x in [*(length * step / last for step in steps), final - 4.0]],
        [*map(str, steps), "result"],
        palette.BOUND,
    )
    for place, curve in enumerate(curves, 1):
        x = np.append(length * np.arange(len(curve.values)) / last, final)
        path = np.stack([x, height(np.append(curve.values, curve.final))], axis=-1)
        interval = [(final, float(height(edge))) for edge in _interval(curve)]
        chart.lines(f"{place} {curve.name}", [path, interval], curve.colour, 1.8)
        chart.values(f"{place} {curve.name}", curve.values)
    rows = _apart(np.array([float(height(curve.final)) for curve in curves]))
    for place, (curve, row) in enumerate(zip(curves, rows, strict=True), 1):
        chart.text(f"{place} label", [(final + 5.0, row + LINE / 4)], [curve.label], curve.colour)
    return chart.view(title, final + 8.0 + LETTER * max(len(curve.label) for curve in curves), left + 2.0)


def _ticks(low: float, high: float) -> Array:
    """Three to six round numbers in a range."""
    size = 10.0 ** floor(log10(high - low))
    step = next(size * share for share in (0.2, 0.25, 0.5, 1.0, 2.0) if (high - low) / (size * share) < 6)
    return np.asarray(step * np.arange(ceil(low / step), floor(high / step) + 1))


def _interval(curve: IterationCurve) -> tuple[float, float]:
    half = curve.half if np.isfinite(curve.half) else 0.0
    return curve.final - half, curve.final + half


def _apart(heights: Array) -> Array:
    """Rows for labels near their heights, and no nearer to each other than text allows, where there is room."""
    gap = min(1.15 * LINE, HEIGHT / max(len(heights) - 1, 1))
    order = np.argsort(heights, kind="stable")
    rows = heights[order]
    for i in range(1, len(rows)):
        rows[i] = max(rows[i], rows[i - 1] + gap)
    rows[-1] = min(rows[-1], HEIGHT)
    for i in range(len(rows) - 2, -1, -1):
        rows[i] = min(rows[i], rows[i + 1] - gap)
    apart = np.empty_like(rows)
    apart[order] = rows
    return apart


def bar_chart(
    recording: rr.RecordingStream, origin: str, title: str, names: Sequence[str], values: Array, halves: Array
) -> rrb.View:
    """Bars across, each with its interval and its name above it."""
    chart, count = Chart(recording, origin), len(values)
    row, width = HEIGHT / count, 90.0
    halves = np.where(np.isfinite(halves), halves, 0.0)
    low, high = min(float((values - halves).min()), 0.0), max(float((values + halves).max()), 0.0)
    x = width * (np.stack([np.zeros(count), values, values - halves, values + halves]) - low) / max(high - low, 1e-12)
    y = row * (np.arange(count) + 0.68)
    chart.lines("0 zero", [[(x[0, 0], 0.0), (x[0, 0], HEIGHT)]], palette.BOUND, 1.0)
    for i, (zero, end, least, most) in enumerate(x.T):
        colour = palette.distinct(i)
        strokes = y[i] + np.linspace(-0.15, 0.15, BAR_STROKES) * row  # thick lines would have round ends
        chart.lines(f"{i + 1} bar", [[(zero, stroke), (end, stroke)] for stroke in strokes], colour, 2.5)
        ticks = [[(edge, y[i] - 0.1 * row), (edge, y[i] + 0.1 * row)] for edge in (least, most)]
        chart.lines(f"{i + 1} interval", [[(least, y[i]), (most, y[i])], *ticks], palette.INK_ON_DARK, 2.0)
        chart.text(f"{i + 1} name", [(0.0, y[i] - 0.34 * row)], [names[i]], colour)
    return chart.view(title, width + 4.0, 4.0, 4.0)
