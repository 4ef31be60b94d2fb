"""Lines: the colours that have the same meaning in every view, how a line is written, and the ranges of axes."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor, log10
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike, NDArray

FLIGHT_TIME = "flight time"
"""Timeline, s from the first training sample. Iterations are on it too, because all views of a recording follow one
timeline."""
ITERATIONS_A_SECOND = 10  # on that timeline; the learning is then about as long as a flight of some seconds
ITERATION = "iteration"  # timeline, the iterations of the learning; 0 is the prior

MEASURED = (225, 228, 232)
PREDICTED = (255, 159, 28)
FORECAST = (64, 201, 162)
BAND = (40, 112, 94)
TRIVIAL = (133, 141, 153)
BOUNDARY = (150, 90, 200)
DISTINCT = (
    (92, 157, 255),
    (255, 107, 107),
    (250, 208, 44),
    (94, 214, 120),
    (198, 120, 255),
    (72, 219, 219),
    (255, 146, 196),
    (201, 160, 112),
    (158, 180, 60),
)
"""For lines without a fixed colour; used cyclically."""

AXIS_MARGIN = 0.05  # margin beyond the values, as a share of their span

LABELS, LABELS_IF_LOW, LABELS_ACROSS = 9, 6, 6
"""The viewer labels the multiples of a power of ten if at most about so many are visible: on the y axis of plots a
quarter of the window high, of lower ones, and on the x axis."""

Colour = tuple[int, int, int]


def distinct(index: int) -> Colour:
    """The ``index``-th of the distinct colours."""
    return DISTINCT[index % len(DISTINCT)]


@dataclass(frozen=True)
class Line:
    """One entity of a recording: a line, or the two edges of a band."""

    path: str  # of the entity
    name: str  # in the legend
    colour: Colour
    width: float = 1.5  # points

    def over_time(self, recording: rr.RecordingStream, time: ArrayLike, values: ArrayLike) -> None:
        """Draws values (N,), or band edges (N, 2), over flight time (N,), s."""
        self._draw(recording, [rr.TimeColumn(FLIGHT_TIME, duration=np.asarray(time, np.float64))], values)

    def over_iterations(self, recording: rr.RecordingStream, values: ArrayLike) -> None:
        """Draws values (I + 1,), or band edges (I + 1, 2), over the iterations from 0 on."""
        iteration = np.arange(len(np.asarray(values)))
        by_iteration = rr.TimeColumn(ITERATION, sequence=iteration)
        beside_flight = rr.TimeColumn(FLIGHT_TIME, duration=iteration / ITERATIONS_A_SECOND)
        self._draw(recording, [by_iteration, beside_flight], values)

    def _draw(self, recording: rr.RecordingStream, index: list[rr.TimeColumn], values: ArrayLike) -> None:
        table: NDArray[np.float64] = np.asarray(values, np.float64)
        edges = table.shape[1] if table.ndim == 2 else 1
        style = rr.SeriesLines(
            colors=[self.colour] * edges,
            names=[self.name] * edges,
            widths=[self.width] * edges,
            # Averaging within a pixel would cut peaks, and make a point of a vertical line.
            aggregation_policy=rr.components.AggregationPolicy.Off,
        )
        recording.log(self.path, style, static=True)
        columns = rr.Scalars.columns(scalars=table.ravel())
        recording.send_columns(self.path, index, columns.partition([edges] * len(table)) if edges > 1 else columns)


def collapsed_panels(**time: Any) -> tuple[rrb.TimePanel, rrb.BlueprintPanel, rrb.SelectionPanel]:
    """All panels beside the views, collapsed; ``time`` are options of the time panel."""
    return (
        rrb.TimePanel(state="collapsed", timeline=FLIGHT_TIME, **time),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def time_plot(
    name: str, origin: str, time: tuple[float, float], values: tuple[float, float], legend: bool = True
) -> rrb.TimeSeriesView:
    """A plot over ranges of flight time, s, and of values."""
    start, end = (rr.TimeRangeBoundary.absolute(seconds=second) for second in time)
    return rrb.TimeSeriesView(
        name=name,
        origin=origin,
        axis_x=rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=start, end=end)),
        axis_y=rrb.ScalarAxis(range=values),
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop, visible=legend),
    )


def utf8(text: str) -> str:
    """A file's name need not be UTF-8, and what Rerun is given must be."""
    return text.encode(errors="replace").decode()


def readable_range(low: float, high: float, labels: int = LABELS) -> tuple[float, float]:
    """A range with low, high, a margin, and two multiples of the power of ten that the viewer labels."""
    span = max(high - low, 1e-9 * max(abs(low), abs(high), 1.0))
    low, high = low - AXIS_MARGIN * span, high + AXIS_MARGIN * span
    step = 10.0 ** floor(log10(high - low))
    if (high - low) / step > labels:
        step *= 10
    while floor(high / step) - ceil(low / step) < 1:
        below, above = (ceil(low / step) - 1) * step, (floor(high / step) + 1) * step
        # The nearer label, with room for it.
        if low - below < above - high:
            low = below - AXIS_MARGIN * (high - below)
        else:
            high = above + AXIS_MARGIN * (above - low)
    return low, high
