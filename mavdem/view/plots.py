"""Plots: lines, bands and marks over the boot clock in Rerun, and where a recording goes."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mavdem.arrays import Array
from mavdem.confidence import Interval
from mavdem.containers import JsonValues, Names
from mavdem.facts import Level
from mavdem.files import atomic_write
from mavdem.fleet.row import utf8_text
from mavdem.report import palette
from mavdem.report.charts.chart import Chart
from mavdem.report.numbers import rounded

BOOT_CLOCK = "boot clock"
"""Timeline of flights, s: the vehicle's boot clock; live that of its first boot, which goes on where another begins."""

LOG_LEVELS = {Level.BAD: "ERROR", Level.WATCH: "WARN"}  # all others are INFO
# points: the viewer fills nothing, so an area is drawn as upright strokes that touch each other
FILL_WIDTH = 2.5
BEYOND = (
    0.5  # how far forecasts and their bands are drawn beyond the measured values, in spans of these
)
MAX_STROKES = 20_000  # of an area, which is drawn at once, or of a path: the viewer draws every one


@dataclass(frozen=True)
class Lines:
    """An entity of k lines over the same times, drawn in the order of the paths: one chunk a batch."""

    path: str  # of the entity
    names: Names  # of the lines, in the legend
    colours: Names  # of the palette
    width: float = 1.5  # points
    # whether the values are the edges of an area, drawn as one line of upright strokes
    filled: bool = False

    def send_style(self, recording: rr.RecordingStream) -> None:
        """Sends how the lines are drawn; once a recording."""
        look: JsonValues = {
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


Mark = tuple[str, str, Sequence[float]]
"""Upright lines: name, colour, and times, s."""


def drawn(
    recording: rr.RecordingStream,
    origin: str,
    chart: Chart,
    span: Interval,
    marks: Sequence[Mark] = (),
) -> rrb.View:
    """Draws a ``chart`` over the boot clock at the entity ``origin``, later lines over earlier ones.

    Returns:
        the view of it from the first to the last time of ``span``, s, with a legend where there is more than one line.
        The range of values is in its title, since the viewer numbers hardly an axis of a low plot.
    """
    ends = ((line.y, line.low, line.high) for line in chart.lines)
    low, high = range_of(*(bound for parts in ends for bound in parts if bound is not None))
    shown = []
    for line in chart.lines:
        if line.low is not None and line.high is not None:
            # As far as it is in sight; opaque, since strokes that overlap add up.
            edges = np.clip([line.low, line.high], 2 * low - high, 2 * high - low).T
            step = ceil(len(line.x) / MAX_STROKES)
            shade = faint(line.colour, palette.BAND_OPACITY)
            shown.append(("90 % band", shade, 0.0, line.x[::step], edges[::step]))
        shown.append((line.name, line.colour, 1.2, line.x, line.y))
    for name, colour, times in marks:
        upright = np.tile([low, high, np.nan], len(times))
        shown += [(name, colour, 2.0, np.repeat(times, 3), upright)] * (len(times) > 0)
    for number, (name, colour, width, time, values) in enumerate(shown):
        path = f"{origin}/{rr.escape_entity_path_part(f'{number} {name}')}"
        lines = Lines(path, (name,), (colour,), width, filled=values.ndim > 1)
        lines.send_style(recording)
        lines.send(recording, time, values)
    margin = 0.05 * max(high - low, 1e-9 * max(abs(low), abs(high), 1.0))
    start, end = (rr.TimeRangeBoundary.absolute(seconds=at) for at in span)
    return rrb.TimeSeriesView(
        name=f"{chart.y.label} ({rounded(low, 3)} to {rounded(high, 3)})",
        origin=origin,
        axis_x=rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=start, end=end)),
        axis_y=rrb.ScalarAxis(range=(low - margin, high + margin)),
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=len(shown) > 1),
    )


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
    recording.log("log", rr.TextLog(utf8_text(sentence), level=LOG_LEVELS.get(level, "INFO")))


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
        recording.send_recording_name(utf8_text(name))
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
    recording.send_recording_name(utf8_text(name))
    yield recording
    # Rerun does not report when a file it writes fails, as on a full disk; Python does.
    contents = memory.drain_as_bytes()
    with atomic_write(target) as file:
        file.write(contents)


def range_of(*values: Array) -> Interval:
    """Returns the least and the most of the finite ones of some values."""
    finite = np.concatenate([series[np.isfinite(series)] for series in values])
    return (float(finite.min()), float(finite.max())) if len(finite) else (-1.0, 1.0)
