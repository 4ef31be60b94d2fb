"""Time plots: pictures over the seconds of a flight, of lines and filled areas, and the ranges of their axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from mavdem.report import palette
from mavdem.report.numbers import rounded

Array = NDArray[np.float64]

FLIGHT_TIME = "flight time"
"""Timeline, seconds since the first sample that is shown."""

LEGEND_ROOM = 1.16
"""Length of a time axis, in lengths of its lines: the legend stands beside them."""

FILL_WIDTH, MAX_STROKES = 2.5, 20_000
"""The viewer fills nothing: an area is drawn as upright strokes so close to each other that they touch. Points, and how
many at most, which the viewer draws at once."""

SPAN_STROKES = 3000  # of all shaded times of a plot

AXIS_MARGIN = 0.05  # margin beyond the values, as a share of their span


@dataclass(frozen=True, eq=False)
class PlotLine:
    """A line of a plot: values (N,) at times (N,), s; NaN breaks it."""

    name: str  # in the legend
    colour: str  # of the palette
    time: Array
    values: Array
    width: float = 1.5  # points


def area(name: str, colour: str, time: Array, low: Array, high: Array) -> PlotLine:
    """The filled area between two lines (N,); opaque, since strokes that overlap would add up."""
    step = ceil(len(time) / MAX_STROKES)
    edges = np.stack([low[::step], high[::step]], axis=-1)
    return PlotLine(name, colour, np.repeat(time[::step], 2), edges.ravel(), FILL_WIDTH)


def spans(name: str, colour: str, times: Sequence[tuple[float, float]], values: tuple[float, float]) -> list[PlotLine]:
    """Filled spans of time, from start to end, s, over all of a range of values; nothing if there are none."""
    spacing = sum(end - start for start, end in times) / SPAN_STROKES
    parts = [np.linspace(*span, max(2, ceil((span[1] - span[0]) / spacing))) for span in times if spacing]
    if not parts:
        return []
    time = np.concatenate([np.append(part, part[-1]) for part in parts])
    inside = np.concatenate([np.append(np.ones(len(part)), np.nan) for part in parts])
    return [area(name, colour, time, values[0] * inside, values[1] * inside)]


def faint(colour: str, opacity: float) -> str:
    """The colour of the palette that one with this opacity has on the viewer's dark ground."""
    pairs = zip(palette.channels(colour), palette.channels(palette.PAPER_DARK), strict=True)
    mixed = (opacity * over + (1 - opacity) * under for over, under in pairs)
    return "#" + bytes(map(round, mixed)).hex()


@dataclass(frozen=True, eq=False)
class Plot:
    """A picture over flight time at the entity ``origin``; later lines are drawn over earlier ones.

    The ``range`` of values is in its title, since the viewer numbers hardly an axis of a low plot.
    """

    origin: str
    title: str
    range: tuple[float, float]
    lines: Sequence[PlotLine]

    def draw(self, recording: rr.RecordingStream) -> None:
        """Draws the lines."""
        for place, line in enumerate(self.lines):
            # Drawn in the order of their paths.
            path = f"{self.origin}/{rr.escape_entity_path_part(f'{place} {line.name}')}"
            style = rr.SeriesLines(
                colors=[palette.channels(line.colour)],
                names=[line.name],
                widths=[line.width],
                # Averaging within a pixel would cut peaks, and make a point of a vertical line.
                aggregation_policy=rr.components.AggregationPolicy.Off,
            )
            recording.log(path, style, static=True)
            index = rr.TimeColumn(FLIGHT_TIME, duration=line.time)
            recording.send_columns(path, [index], rr.Scalars.columns(scalars=line.values))

    def view(self, end: float) -> rrb.View:
        """Over a flight of ``end`` seconds, with a legend where there is more than one line."""
        low, high = self.range
        margin = AXIS_MARGIN * max(high - low, 1e-9 * max(abs(low), abs(high), 1.0))
        start, stop = (rr.TimeRangeBoundary.absolute(seconds=second) for second in (0.0, LEGEND_ROOM * end))
        return rrb.TimeSeriesView(
            name=f"{self.title} ({rounded(low, 3)} to {rounded(high, 3)})",
            origin=self.origin,
            axis_x=rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=start, end=stop)),
            axis_y=rrb.ScalarAxis(range=(low - margin, high + margin)),
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop, visible=len(self.lines) > 1),
        )


def collapsed_panels(**time: Any) -> tuple[rrb.TimePanel, rrb.BlueprintPanel, rrb.SelectionPanel]:
    """All panels beside the views, collapsed; ``time`` are options of the time panel."""
    return (
        rrb.TimePanel(state="collapsed", timeline=FLIGHT_TIME, **time),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def utf8(text: str) -> str:
    """A file's name need not be UTF-8, and what Rerun is given must be."""
    return text.encode(errors="replace").decode()


def range_of(*values: Array) -> tuple[float, float]:
    """From the least to the most of the finite ones of some values."""
    finite = np.concatenate([one[np.isfinite(one)] for one in values])
    return (float(finite.min()), float(finite.max())) if len(finite) else (-1.0, 1.0)
