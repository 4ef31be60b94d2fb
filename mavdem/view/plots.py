"""Plots of a recording in Rerun: lines, bands and marks over the boot clock, and where the recording is written."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import ceil
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mavdem.arrays import Array
from mavdem.confidence import Interval
from mavdem.containers import Names
from mavdem.facts import Level
from mavdem.files import atomic_write
from mavdem.fleet.row import utf8_text
from mavdem.report import palette
from mavdem.report.charts.chart import Chart, Line
from mavdem.view.axes import AXIS_MARGIN, WIDTH_PER_SPAN, range_with_ticks, tick_intervals

BOOT_CLOCK = "boot clock"
"""Timeline of flights, s: the vehicle's boot clock. A live flight continues the clock of its first boot."""

LOG_LEVELS = {Level.BAD: "ERROR", Level.WATCH: "WARN"}
"""Rerun's levels of the event log; facts of other levels are INFO."""

STROKE_WIDTH = 2.5
"""Width of the vertical strokes that fill an area, points.

The viewer cannot fill areas. Strokes of this width touch each other, so that they look like one.
"""

LINE_WIDTH = 1.2
"""Width of the lines of a chart, points."""

MARK_WIDTH = 2.0
"""Width of the vertical lines that mark events, points."""

MAX_STROKES = 20_000
"""Largest number of vertical strokes that fill an area: the viewer draws all of them at once. A choice."""

MIN_STROKES = 2_000
"""Smallest number of vertical strokes that fill an area: with fewer than the pixels across a plot there are gaps."""

LEGEND = rrb.PlotLegend(corner=rrb.Corner2D.RightTop)
"""Legend of a plot, where ``LEGEND_SHARE`` keeps lines out."""


@dataclass(frozen=True)
class Lines:
    """An entity of a recording with k lines over the same times. Entities are drawn in the order of their paths."""

    path: str
    """Path of the entity."""
    names: Names
    """(k,) names of the lines in the legend."""
    colours: Names
    """(k,) colours of the palette."""
    width: float = 1.5
    """Width of the lines, points."""
    is_filled: bool = False
    """Whether the values are the edges of an area, which is drawn as one line of vertical strokes."""

    def send_style(self, recording: rr.RecordingStream) -> None:
        """Sends names, colours and widths of the lines; it is called once, before the first samples.

        Args:
            recording: recording to draw into.
        """
        width = STROKE_WIDTH if self.is_filled else self.width
        style = rr.SeriesLines(
            names=self.names,
            colors=[palette.channels(colour) for colour in self.colours],
            widths=[width] * len(self.names),
            # The viewer's averaging within a pixel would hide gusts, and reduce a vertical stroke to a point.
            aggregation_policy=rr.components.AggregationPolicy.Off,
        )
        recording.log(self.path, style, static=True)

    def send(self, recording: rr.RecordingStream, time: Array, values: Array) -> None:
        """Sends samples of the lines.

        Args:
            recording: recording to draw into.
            time: (N,) times, s.
            values: (N, k) values of the lines, or the edges (N, 2) of an area; NaN breaks a line.
        """
        if not len(time):
            return
        if self.is_filled:
            # A vertical stroke consists of two points at the same time.
            time = np.repeat(time, 2)
            values = values.reshape(-1, 1)
        # Rerun takes the values of all samples one after the other, and how many of them belong to each sample: one for
        # each line.
        columns = rr.Scalars.columns(scalars=values.ravel())
        rows = columns.partition([len(self.names)] * len(time))
        recording.send_columns(self.path, [rr.TimeColumn(BOOT_CLOCK, duration=time)], rows)


class EventMarks(NamedTuple):
    """Vertical lines across a plot, at the times of events."""

    name: str
    """Name in the legend."""
    colour: str
    """Colour of the palette."""
    times: Sequence[float]
    """Times of the events, s."""


class _DrawnLine(NamedTuple):
    """A line or a band of a plot."""

    name: str
    """Name in the legend."""
    colour: str
    """Opaque colour."""
    width: float
    """Width of a line, points; it does not matter for a band."""
    time: Array
    """(N,) times, s."""
    values: Array
    """(N,) values of a line, or (N, 2) edges of a band."""

    @property
    def is_band(self) -> bool:
        """Whether it is a band."""
        return self.values.ndim == 2


def draw_chart(
    recording: rr.RecordingStream,
    origin: str,
    chart: Chart,
    span: Interval,
    height_share: float,
    marks: Sequence[EventMarks] = (),
) -> rrb.View:
    """Draws a chart over the boot clock: its bands first, then its lines, and over them vertical lines at events.

    Args:
        recording: recording to draw into.
        origin: path of the plot; each line is an entity below it.
        chart: the lines with their bands.
        span: the first and the last time of the lines, s; the axis ends later, where the legend is.
        height_share: height of the plot, as a share of the height of its tab.
        marks: events that are marked.

    Returns:
        The view of the chart, with a legend where there is more than one line.
    """
    intervals = tick_intervals(height_share)
    lowest, highest = finite_range(*_lines_and_edges(chart))
    value_range = range_with_ticks(lowest, highest, intervals)
    drawn_lines: list[_DrawnLine] = []
    for line in chart.lines:
        drawn_lines += _band_and_line(line, value_range)
    # Bands come first, so that they lie below all lines, and none hides the line of another.
    drawn_lines.sort(key=lambda drawn_line: not drawn_line.is_band)
    for mark in marks:
        if len(mark.times):
            drawn_lines.append(_vertical_lines(mark, value_range))
    for number, drawn_line in enumerate(drawn_lines):
        # Lines are drawn in the order of their paths. A slash, as in the unit 1/s, would begin a folder.
        name = f"{number} {drawn_line.name.replace('/', ' per ')}"
        _send_line(recording, f"{origin}/{rr.escape_entity_path_part(name)}", drawn_line)
    low, high = value_range
    margin = AXIS_MARGIN * (high - low)
    start_time, end_time = span
    start = rr.TimeRangeBoundary.absolute(seconds=start_time)
    end = rr.TimeRangeBoundary.absolute(
        seconds=start_time + WIDTH_PER_SPAN * (end_time - start_time)
    )
    return rrb.TimeSeriesView(
        name=chart.y.label,
        origin=origin,
        axis_x=rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=start, end=end)),
        axis_y=rrb.ScalarAxis(range=(low - margin, high + margin)),
        plot_legend=LEGEND if len(drawn_lines) > 1 else rrb.PlotLegend(visible=False),
    )


def _send_line(recording: rr.RecordingStream, path: str, drawn_line: _DrawnLine) -> None:
    """Sends one line of a chart, or one band, with its name, colour and width.

    Args:
        recording: recording to draw into.
        path: path of the entity.
        drawn_line: values (N,) of a line, or lower and upper edges (N, 2) of a band, over time.
    """
    lines = Lines(
        path,
        (drawn_line.name,),
        (drawn_line.colour,),
        drawn_line.width,
        is_filled=drawn_line.is_band,
    )
    lines.send_style(recording)
    lines.send(recording, drawn_line.time, drawn_line.values)


def _vertical_lines(mark: EventMarks, value_range: Interval) -> _DrawnLine:
    """Returns one line that consists of a vertical stroke at the time of each event, over the range of a plot.

    Args:
        mark: name, colour and times of the events, at least one.
        value_range: lower and upper end of the range.
    """
    low, high = value_range
    # Each stroke has two samples at the same time; a third one, NaN, separates it from the next stroke.
    strokes = np.tile([low, high, np.nan], len(mark.times))
    time = np.repeat(mark.times, 3)
    return _DrawnLine(mark.name, colour=mark.colour, width=MARK_WIDTH, time=time, values=strokes)


def _lines_and_edges(chart: Chart) -> Iterator[Array]:
    """Yields the values (N,) of each line of a chart and, where it has a band, the lower and the upper edge (N,)."""
    for line in chart.lines:
        yield line.y
        if line.lower_edge is not None:
            yield line.lower_edge
        if line.upper_edge is not None:
            yield line.upper_edge


def _band_and_line(line: Line, value_range: Interval) -> Iterator[_DrawnLine]:
    """Yields the band of a line, if it has one, and the line over it.

    Args:
        line: the line over the boot clock.
        value_range: smallest and largest value of the plot. Edges of the band are clipped to one span beyond either.
    """
    if line.lower_edge is not None and line.upper_edge is not None:
        low, high = value_range
        # The colour is opaque, since the opacities of strokes that overlap would add up.
        shade = colour_on_dark(line.colour, palette.BAND_OPACITY)
        band = line
        if len(line.x) < MIN_STROKES:
            # Strokes at few samples would leave gaps between them.
            band = line.resampled(np.linspace(line.x[0], line.x[-1], MIN_STROKES))
        assert band.lower_edge is not None and band.upper_edge is not None
        # Edges far beyond the values are clipped one span beyond the range, as far as the user may scroll.
        edges = np.clip([band.lower_edge, band.upper_edge], 2 * low - high, 2 * high - low).T
        # Only every ``step``-th sample of a longer band is drawn.
        step = ceil(len(band.x) / MAX_STROKES)
        yield _DrawnLine(
            "90 % band", colour=shade, width=0.0, time=band.x[::step], values=edges[::step]
        )
    yield _DrawnLine(line.name, colour=line.colour, width=LINE_WIDTH, time=line.x, values=line.y)


def colour_on_dark(colour: str, opacity: float) -> str:
    """Returns the opaque colour that a transparent one has on the viewer's dark background.

    Args:
        colour: colour of the palette.
        opacity: its opacity, 0 to 1.
    """
    foreground = np.array(palette.channels(colour))
    background = np.array(palette.channels(palette.PAPER_DARK))
    mixed_colour = np.round(opacity * foreground + (1 - opacity) * background)
    return "#" + bytes(mixed_colour.astype(np.uint8)).hex()


def blueprint(view: rrb.Container, **options: Any) -> rrb.Blueprint:
    """Returns the layout of a recording: one container, and all other panels collapsed.

    Args:
        view: container of all views of the recording.
        options: options of Rerun's time panel, such as ``play_state``.
    """
    time_panel = rrb.TimePanel(state="collapsed", timeline=BOOT_CLOCK, **options)
    left_panel = rrb.BlueprintPanel(state="collapsed")
    right_panel = rrb.SelectionPanel(state="collapsed")
    return rrb.Blueprint(
        view, time_panel, left_panel, right_panel, auto_views=False, auto_layout=False
    )


def log_event(recording: rr.RecordingStream, time: float, sentence: str, level: Level) -> None:
    """Writes a sentence into the event log of a recording.

    Args:
        recording: the recording.
        time: time of the event on the timeline, s.
        sentence: sentence about the event.
        level: level of the event, which decides the colour.
    """
    recording.set_time(BOOT_CLOCK, duration=time)
    recording.log("log", rr.TextLog(utf8_text(sentence), level=LOG_LEVELS.get(level, "INFO")))


def events_view() -> rrb.View:
    """Returns the view of the event log."""
    columns = rrb.archetypes.TextLogColumns(
        timeline_columns=[BOOT_CLOCK], text_log_columns=["LogLevel", "Body"]
    )
    return rrb.TextLogView(origin="log", name="Events", columns=columns)


Target: TypeAlias = str | os.PathLike[str] | rr.RecordingStream
"""Where a recording goes: a file, or a stream that :func:`streamed` yields."""


@contextmanager
def streamed(name: str, application: str) -> Iterator[rr.RecordingStream]:
    """Yields a recording that goes to standard output as it is made.

    Args:
        name: name of the recording.
        application: id of the application; the viewer keeps one layout for each.
    """
    with rr.RecordingStream(application) as recording:
        recording.stdout()
        recording.send_recording_name(utf8_text(name))
        yield recording


@contextmanager
def recording_to_file(target: Target, name: str) -> Iterator[rr.RecordingStream]:
    """Yields a recording that is then written to a file, completely or not at all.

    Args:
        target: the file; a stream is only flushed.
        name: name of the recording.

    Raises:
        OSError: the file cannot be written.
    """
    if isinstance(target, rr.RecordingStream):
        yield target
        target.flush()
        return
    recording = rr.RecordingStream("mavdem")
    memory = recording.memory_recording()
    recording.send_recording_name(utf8_text(name))
    yield recording
    # Rerun does not report that writing a file failed, as on a full disk; Python does.
    contents = memory.drain_as_bytes()
    with atomic_write(target) as file:
        file.write(contents)


def finite_range(*series: Array) -> Interval:
    """Returns the smallest and the largest finite value of several series; −1 and 1 if there is none."""
    finite = np.concatenate([values[np.isfinite(values)] for values in series])
    if not len(finite):
        return -1.0, 1.0
    return float(finite.min()), float(finite.max())
