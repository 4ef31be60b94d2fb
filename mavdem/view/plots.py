"""Plots: lines, bands and marks over the boot clock in Rerun, and where a recording goes."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import ceil
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mavdem.dem.engine.linalg import Array
from mavdem.facts import Level
from mavdem.files import atomic_write
from mavdem.fleet.row import as_text
from mavdem.report import palette
from mavdem.report.charts import Chart
from mavdem.report.numbers import rounded

BOOT_CLOCK = "boot clock"
"""Timeline of flights, s: the vehicle's boot clock; live that of its first boot, which goes on where another begins."""

LOG_LEVELS = {Level.BAD: "ERROR", Level.WATCH: "WARN", Level.GOOD: "INFO", Level.UNKNOWN: "INFO"}
# points: the viewer fills nothing, so an area is drawn as upright strokes that touch each other
FILL_WIDTH = 2.5
MAX_STROKES = 20_000  # of an area, which is drawn at once


@dataclass(frozen=True)
class Lines:
    """An entity of k lines over the same times, drawn in the order of the paths: one chunk a batch."""

    path: str  # of the entity
    names: tuple[str, ...]  # of the lines, in the legend
    colours: tuple[str, ...]  # of the palette
    width: float = 1.5  # points
    # whether the values are the edges of an area, drawn as one line of upright strokes
    filled: bool = False

    def send_style(self, recording: rr.RecordingStream) -> None:
        """Sends how the lines are drawn; once a recording."""
        look: dict[str, Any] = {
            "names": self.names,
            "colors": [palette.channels(colour) for colour in self.colours],
        }
        widths = [FILL_WIDTH if self.filled else self.width] * len(self.names)
        # Averaging within a pixel would hide gusts, and make a point of a stroke.
        style = rr.SeriesLines(
            widths=widths, aggregation_policy=rr.components.AggregationPolicy.Off, **look
        )
        recording.log(self.path, style, static=True)

    def send(self, recording: rr.RecordingStream, time: Array, values: Array) -> None:
        """Sends values (N, k), or edges (N, 2), at times (N,), s; NaN breaks a line."""
        if not len(time):
            return
        if self.filled:
            time = np.repeat(time, 2)
            values = values.reshape(-1, 1)
        columns = rr.Scalars.columns(scalars=values.ravel()).partition(
            [len(self.names)] * len(time)
        )
        recording.send_columns(self.path, [rr.TimeColumn(BOOT_CLOCK, duration=time)], columns)


@dataclass(eq=False)
class Plot:
    """A picture over the boot clock at the entity ``origin``; later lines are drawn over earlier ones.

    The ``range`` of values is in its title, since the viewer numbers hardly an axis of a low plot.
    """

    origin: str
    title: str
    range: tuple[float, float]
    lines: list[tuple[Lines, Array, Array]] = field(default_factory=list)

    @classmethod
    def of(cls, origin: str, chart: Chart) -> Plot:
        """Returns the plot of a ``chart`` with its bands."""
        ends = ((line.y, line.low, line.high) for line in chart.lines)
        shown = [one for parts in ends for one in parts if one is not None]
        plot = cls(origin, chart.y.label, range_of(*shown))
        for line in chart.lines:
            if line.low is not None and line.high is not None:
                shade = faint(line.colour, palette.BAND_OPACITY)
                plot.area("90 % band", shade, line.x, line.low, line.high)
            plot.line(line.name, line.colour, line.x, line.y)
        return plot

    def line(self, name: str, colour: str, time: Array, values: Array, width: float = 1.2) -> None:
        """Adds a line: values (N,) at times (N,), s; NaN breaks it; of two columns the area between them."""
        path = f"{self.origin}/{rr.escape_entity_path_part(f'{len(self.lines)} {name}')}"
        self.lines.append(
            (Lines(path, (name,), (colour,), width, filled=values.ndim > 1), time, values)
        )

    def area(self, name: str, colour: str, time: Array, low: Array, high: Array) -> None:
        """Adds the area between two lines (N,), as far as it is in sight; opaque, since strokes that overlap add up."""
        least, most = self.range
        edges = np.clip([low, high], 2 * least - most, 2 * most - least)
        step = ceil(len(time) / MAX_STROKES)
        self.line(name, colour, time[::step], edges.T[::step])

    def marks(self, name: str, colour: str, times: Sequence[float]) -> None:
        """Adds an upright line at each time, s, over the whole range; nothing if there are none."""
        if len(times):
            ends = with_gaps([np.array(self.range) for _ in times])
            self.line(
                name, colour, with_gaps([np.full(2, at) for at in times], last=True), ends, 2.0
            )

    def draw(self, recording: rr.RecordingStream) -> None:
        """Draws the lines."""
        for lines, time, values in self.lines:
            lines.send_style(recording)
            lines.send(recording, time, values)

    def view(self, first: float, last: float) -> rrb.View:
        """Returns the view from ``first`` to ``last``, s, with a legend where there is more than one line."""
        low, high = self.range
        margin = 0.05 * max(high - low, 1e-9 * max(abs(low), abs(high), 1.0))
        x = time_axis(first, last)
        y = rrb.ScalarAxis(range=(low - margin, high + margin))
        legend = rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=len(self.lines) > 1)
        title = f"{self.title} ({rounded(low, 3)} to {rounded(high, 3)})"
        return rrb.TimeSeriesView(
            name=title, origin=self.origin, axis_x=x, axis_y=y, plot_legend=legend
        )


def time_axis(first: float, last: float) -> rrb.archetypes.TimeAxis:
    """Returns an axis from ``first`` to ``last``, s."""
    start = rr.TimeRangeBoundary.absolute(seconds=first)
    end = rr.TimeRangeBoundary.absolute(seconds=last)
    return rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=start, end=end))


def with_gaps(parts: Sequence[Array] | Array, last: bool = False) -> Array:
    """Returns parts (N, …) one after the other, after each a NaN, which draws no line, or its ``last`` value again."""
    ends = (part[-1:] if last else np.full_like(part[-1:], np.nan) for part in parts)
    return np.concatenate([piece for pair in zip(parts, ends, strict=True) for piece in pair])


def faint(colour: str, opacity: float) -> str:
    """Returns the colour of the palette that one with this opacity has on the viewer's dark ground."""
    over = np.array(palette.channels(colour))
    under = np.array(palette.channels(palette.PAPER_DARK))
    return "#" + bytes(np.round(opacity * over + (1 - opacity) * under).astype(np.uint8)).hex()


def blueprint(view: rrb.Container, **options: Any) -> rrb.Blueprint:
    """Returns a layout of one container with all panels beside it collapsed; ``options`` are of the time panel."""
    time = rrb.TimePanel(state="collapsed", timeline=BOOT_CLOCK, **options)
    left = rrb.BlueprintPanel(state="collapsed")
    right = rrb.SelectionPanel(state="collapsed")
    return rrb.Blueprint(view, time, left, right, auto_views=False, auto_layout=False)


def log(recording: rr.RecordingStream, time: float, sentence: str, level: Level) -> None:
    """Writes a sentence into the log at a ``time`` on the timeline, s."""
    recording.set_time(BOOT_CLOCK, duration=time)
    recording.log("log", rr.TextLog(as_text(sentence), level=LOG_LEVELS[level]))


def events_view() -> rrb.View:
    """Returns the view of that log."""
    columns = rrb.archetypes.TextLogColumns(
        timeline_columns=[BOOT_CLOCK], text_log_columns=["LogLevel", "Body"]
    )
    return rrb.TextLogView(origin="log", name="Events", columns=columns)


Target = str | os.PathLike[str] | rr.RecordingStream
"""Where a recording goes: a file, or one that is :func:`streamed`."""


@contextmanager
def streamed(name: str, application: str) -> Iterator[rr.RecordingStream]:
    """Yields a recording called ``name`` that goes to standard output as it is made.

    The viewer has one blueprint for each ``application``.
    """
    with rr.RecordingStream(application) as recording:
        recording.stdout()
        recording.send_recording_name(as_text(name))
        yield recording


@contextmanager
def recorded(target: Target, name: str) -> Iterator[rr.RecordingStream]:
    """Yields a recording called ``name`` that is then written to a file, whole or not at all; ``OSError`` if not."""
    if isinstance(target, rr.RecordingStream):
        yield target
        target.flush()
        return
    recording = rr.RecordingStream("mavdem")
    memory = recording.memory_recording()
    recording.send_recording_name(as_text(name))
    yield recording
    # Rerun does not report when a file it writes fails, as on a full disk; Python does.
    contents = memory.drain_as_bytes()
    with atomic_write(target) as file:
        file.write(contents)


def range_of(*values: Array) -> tuple[float, float]:
    """Returns the least and the most of the finite ones of some values."""
    finite = np.concatenate([series[np.isfinite(series)] for series in values])
    return (float(finite.min()), float(finite.max())) if len(finite) else (-1.0, 1.0)
