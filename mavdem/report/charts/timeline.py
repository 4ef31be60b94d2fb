"""Timeline: what a flight did over time, as charts on one common time axis that a page zooms together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import cycle
from math import ceil
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment import Assessment
from mavdem.assessment.axis import LogAnalysis
from mavdem.assessment.flights import settled_flight
from mavdem.assessment.time_history import (
    AxisHistory,
    FollowedSetpoint,
    TimeHistory,
    WindHistory,
)
from mavdem.containers import Names, Numbers
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dataset.batteries import battery_name
from mavdem.dataset.intervals import TimeInterval
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts.ending import Ending
from mavdem.facts.event import Event
from mavdem.report.charts.chart import (
    CLIP_SPANS,
    MAX_GAP_STEPS,
    TIME,
    Axis,
    Chart,
    Charts,
    Group,
    Line,
    LineStyle,
    Mark,
    Span,
    Tick,
    over_time,
)
from mavdem.report.charts.model_charts import torque_line
from mavdem.report.numbers import TORQUE_UNIT, display_unit, without_remark
from mavdem.report.palette import (
    BAD,
    BASELINE,
    COMMAND,
    DISTINCT,
    DISTURBANCE,
    MEASURED,
    PREDICTED,
    TRUTH,
)
from mavdem.wind_velocity.compass import COMPASS_POINTS, compass_text

if TYPE_CHECKING:
    from mavdem.live.history import LiveHistory

EIGHTH_TURN = 45.0
"""Angle between two of the eight points of the compass, degrees."""

MAX_NAMED_EIGHTHS = 4
"""Eighths of a turn on an axis up to which each point of the compass has a tick: a choice, by the height of charts."""

FULL_TURN = 360.0
"""Degrees of a full turn of the compass."""

BRIDGED_VOLTAGE_GAP = 10.0
"""Time between two voltages of a live flight, s, over which their line goes on.

A choice: a computer that is busy with late messages takes the voltage, which changes slowly, less than once a second.
"""

FULL_WIDTH_CHARTS = 4
"""Charts over time that a page has at its full width: a choice; mostly roll, pitch, height and motors."""

MAX_COLUMNS = 3
"""Columns of the other charts over time: as many as can be read on a screen of 1280 pixels, a choice."""

MAX_ESTIMATE_SPANS = 5.0
"""Range of the estimated height, in ranges of the measured ones, up to which it determines the axis.

A choice: beyond it the measured heights take less than a fifth of the plot.
"""

WHOLE_FLIGHT_GROUP = "whole flight"
"""Group of the charts that show the whole flight on paper while those of the group "flight" show a part of it."""

ANGLE_UNIT = display_unit("rad")
"""Unit in which angles and rates are shown: degrees."""


class Timeline(NamedTuple):
    """Charts of one flight on one clock, with what is marked in all of them."""

    flight_charts: Charts
    """Height, motors and battery; of a live flight all charts."""

    span: TimeInterval
    """First and last time shown, s on the boot clock."""

    axis_charts: Mapping[str, Charts] = MappingProxyType({})
    """Angle, rate and rate error by axis, those that were recorded in this order."""

    grey_intervals: tuple[TimeInterval, ...] = ()
    """First and last time, s, of each part that is grey."""

    grey_meaning: str = "settled flight"
    """What the parts that are grey have in common, for the line above the charts."""

    modes: tuple[Span, ...] = ()
    """Flight modes in order of time."""

    events: tuple[Event, ...] = ()
    """What happened, in order of time."""

    event_labels: Names = ()
    """What is written beside each event, such as its number; empty without labels."""

    position: TimeSeries | None = None
    """Flown path (N, 3), m north, east and down."""

    takeoff: Numbers | None = None
    """Place of the latest take-off in a live session, m north, east and down; None where it is not known."""

    heading: float | None = None
    """Latest heading, degrees clockwise from north, of a vehicle that is received; None of a log."""

    wind_charts: Charts = ()
    """Wind speed, wind direction and wind torque, those that are known."""

    boot: int = 0
    """The boot of the autopilot, from 0, on whose clock the times are."""

    time_axis: Axis = TIME
    """Label of the axis of time, which says since when the times are."""

    @property
    def overview(self) -> Charts:
        """The strip of flight modes, then the charts of flight and wind, all with events and training intervals."""
        return self._overview_of(self.flight_charts + self.wind_charts)

    @property
    def time_of_loss(self) -> float | None:
        """When the flight was lost, s on the boot clock; None if it was not, or at an unknown time."""
        for event in self.events:
            if event.has_time and event.fact.code in Ending:
                return event.seconds
        return None

    @property
    def overview_groups(self) -> tuple[Group, ...]:
        """The charts over time in the arrangement of a page: roll and pitch, then height, motors, battery and wind.

        The first ``FULL_WIDTH_CHARTS`` stand below each other over the whole width. The others stand in up to
        ``MAX_COLUMNS`` columns, so that the page is shorter.
        """
        charts = self._charts_by_importance()
        full_width_count = FULL_WIDTH_CHARTS
        if len(charts) == FULL_WIDTH_CHARTS + 1:
            # One chart in a column beside empty ones would not make the page shorter.
            full_width_count += 1
        full_width_group = Group((self._overview_of(charts[:full_width_count]),))
        other_charts = tuple(self.marked(chart) for chart in charts[full_width_count:])
        if not other_charts:
            return (full_width_group,)
        # Charts that follow each other share a column.
        charts_per_column = ceil(len(other_charts) / MAX_COLUMNS)
        columns = []
        for first in range(0, len(other_charts), charts_per_column):
            columns.append(other_charts[first : first + charts_per_column])
        return full_width_group, Group(tuple(columns), is_flat=True)

    def with_chart_first(self, title: str) -> Timeline:
        """Returns the timeline with one of its charts of the flight before all others.

        Args:
            title: title of that chart. Without a chart of this title, the order stays.
        """
        first_charts = [chart for chart in self.flight_charts if chart.title == title]
        other_charts = [chart for chart in self.flight_charts if chart.title != title]
        return self._replace(flight_charts=(*first_charts, *other_charts))

    def whole_flight_group(self, marked_span: TimeInterval) -> Group | None:
        """Returns the most important charts over the whole flight, for a page whose plots show a part of it.

        They are the charts that have the full width of the page above. They stand in two columns here, and are not
        zoomed with the others.

        Args:
            marked_span: first and last time, s, of that part, which is grey in these charts.

        Returns:
            The charts as a group; None where nothing is drawn.
        """
        charts = []
        for chart in self._charts_by_importance()[:FULL_WIDTH_CHARTS]:
            grey_spans = (Span(*marked_span),)
            charts.append(self.marked(chart)._replace(spans=grey_spans, group=WHOLE_FLIGHT_GROUP))
        if not charts:
            return None
        # A single chart leaves the second column empty, which is then left out.
        charts_per_column = ceil(len(charts) / 2)
        columns = [tuple(charts[:charts_per_column])]
        if len(charts) > charts_per_column:
            columns.append(tuple(charts[charts_per_column:]))
        return Group(
            tuple(columns),
            caption="The whole flight. Grey: the time of the plots above.",
            is_flat=True,
        )

    def _charts_by_importance(self) -> Charts:
        """Returns the charts over time in the order of a page: roll and pitch, height, motors, battery and wind."""
        # The first chart of an axis shows its angle, with a second line for the setpoint if that was recorded.
        tilt_charts = [
            self.axis_charts[axis][0] for axis in TILT_AXES if self.axis_charts.get(axis)
        ]
        return (*tilt_charts, *self.flight_charts, *self.wind_charts)

    def _overview_of(self, unmarked_charts: Charts) -> Charts:
        """Adds to charts of this flight what all its charts have in common: marks, time axis and the strip of modes.

        Args:
            unmarked_charts: charts over the time of the flight.

        Returns:
            The strip of flight modes, if modes are known, and below it the charts with marks at the events.
        """
        charts = tuple(self.marked(chart) for chart in unmarked_charts)
        if not self.modes:
            return charts
        mode_strip = Chart("Modes", self._time_axis, Axis(""), spans=self.modes, group="flight")
        return (mode_strip, *charts)

    @property
    def _time_axis(self) -> Axis:
        """The axis of time of all charts, which ends at the first and the last time shown."""
        return self.time_axis._replace(limits=self.span)

    def marked(self, chart: Chart) -> Chart:
        """Adds what all charts of this flight have in common: the time range, marks at events, and grey intervals.

        Where the labels of marks would overlap, a page draws only the label of the first one in the order of the marks.
        So how the flight was lost comes first, then alarms, then other events, the latest first in each.

        Args:
            chart: a chart over time. Marks and spans that it has already are replaced.
        """
        grey_spans = tuple(Span(start, end) for start, end in self.grey_intervals)
        return chart._replace(x=self._time_axis, marks=self._event_marks(), spans=grey_spans)

    def _event_marks(self) -> tuple[Mark, ...]:
        """Returns a mark for each event whose time is known, the most important event first."""
        labels = self.event_labels or ("",) * len(self.events)
        labelled_events = []
        for event, label in zip(self.events, labels, strict=True):
            if event.has_time:
                labelled_events.append(_LabelledEvent(event, label))
        # The sort is stable, so that within a rank the latest event stays first: the end of a flight matters more than
        # what led to it.
        labelled_events.reverse()
        labelled_events.sort(key=lambda labelled_event: _rank_of_mark(labelled_event.event))
        marks = []
        for event, label in labelled_events:
            colour = BAD if event.is_alarm else MEASURED
            marks.append(Mark(event.seconds, label, colour))
        return tuple(marks)


class _LabelledEvent(NamedTuple):
    """An event of a flight, with the label of its mark in charts."""

    event: Event
    """The event."""

    label: str
    """What is written beside its mark; empty for nothing."""


def _rank_of_mark(event: Event) -> int:
    """Returns the rank of an event among the marks: 0 for how the flight was lost, 1 for an alarm, 2 for any other."""
    if isinstance(event.fact.code, Ending):
        return 0
    if event.is_alarm:
        return 1
    return 2


def assessment_timeline(
    assessment: Assessment, *, has_all_flights: bool = False
) -> Timeline | None:
    """Returns the charts of a log over time, with its events, the wind torque, and the settled flight in grey.

    Settled flight is flight without take-off and landing, by which the vehicle is judged. A log may have several boots
    of the autopilot, whose clocks begin at 0 each.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.
        has_all_flights: whether the flights of other boots are drawn before and after the boot that was analysed, on
            one axis of time.

    Returns:
        The charts and events; None if nothing was analysed, or the boot has less than two samples of the attitude.
    """
    analysis = assessment.analysis
    evidence = assessment.evidence
    if analysis is None or evidence is None:
        return None
    history = evidence.history_of_all_flights if has_all_flights else evidence.time_history
    if history is None:
        return None
    timeline = history_timeline(history)
    wind_charts = list(timeline.wind_charts)
    torque_chart = _wind_torque_chart(assessment.analyses)
    if torque_chart.lines:
        wind_charts.append(torque_chart)
    settled_intervals = []
    for segment in settled_flight(evidence.signals):
        # The times of other boots are on other clocks.
        if segment.boot == history.segment.boot:
            settled_intervals.append((segment.start, segment.end))
    return timeline._replace(
        grey_intervals=tuple(settled_intervals), wind_charts=tuple(wind_charts)
    )


def history_timeline(history: TimeHistory) -> Timeline:
    """Returns the charts of a flight over time that need no identified model, with its events.

    They are charts of height, motors and battery; of angle, rate and setpoints of each axis; and of the wind, if it was
    estimated.

    Args:
        history: signals and events over time.
    """
    axis_charts = {}
    for axis, axis_history in history.axes.items():
        axis_charts[axis] = () if axis_history is None else axis_history_charts(axis, axis_history)
    wind_charts: Charts = ()
    if history.wind is not None:
        wind_charts = tuple(wind_speed_and_direction_charts(history.wind))
    flight_charts = [chart for chart in _flight_charts(history) if chart.lines]
    modes = [Span(mode.start, mode.end, mode.name) for mode in history.modes]
    return Timeline(
        flight_charts=tuple(flight_charts),
        span=(history.segment.start, history.segment.end),
        axis_charts=axis_charts,
        modes=tuple(modes),
        events=history.events,
        position=history.position,
        wind_charts=wind_charts,
        boot=history.segment.boot,
    )


def _flight_charts(history: TimeHistory) -> Iterator[Chart]:
    """Yields charts of height, motors, and battery over time; what was not recorded has a chart without lines.

    The motors have two charts, in percent of their range. In the second one the mean of all motors at each time is
    subtracted, so that it shows the differences by which the vehicle is steered.

    Args:
        history: signals of the flight over time.
    """
    yield height_chart(history)
    motors = history.motors
    if motors is not None:
        names = [without_remark(name) for name in motors.names]
        yield over_time("Motors", "%", _lines_of_columns(motors.outputs, names))
        yield over_time("Motors minus their mean", "%", _lines_of_columns(motors.deviations, names))
    yield over_time("Battery", "V", _voltage_lines(history))


def height_chart(history: TimeHistory) -> Chart:
    """Returns the chart of the height over time, by all sensors that measured it; without lines if none did.

    Args:
        history: signals of the flight over time.
    """
    # The barometer is drawn first, so that it lies behind the estimated height and shows where that diverged.
    measured_heights = list(_lines_of_columns(history.barometer_height, ["barometer"], [MEASURED]))
    measured_heights += _lines_of_columns(history.satellite_height, ["satellites"], [COMMAND])
    estimated_height = list(_lines_of_columns(history.height, ["estimate"]))
    # Without the autopilot's height, no zero at the take-off is known.
    title = "Height" if estimated_height else "Height above the first fix"
    chart = over_time(title, "m", [*measured_heights, *estimated_height])
    limits = _height_limits(measured_heights, estimated_height)
    return chart._replace(y=chart.y._replace(limits=limits))


def _voltage_lines(history: TimeHistory) -> list[Line]:
    """Returns a line over time for the voltage of each battery, and dashed ones at the limits of the autopilot.

    Args:
        history: signals of the flight over time, with the voltages, V, and their limits.

    Returns:
        The lines; none if no voltage was recorded.
    """
    lines: list[Line] = []
    for (name, voltage), colour in zip(history.voltages.items(), cycle(DISTINCT), strict=False):
        lines += _lines_of_columns(voltage, [name], [colour])
    if not lines:
        return []
    # A limit is a horizontal line from the start to the end of the flight.
    start_and_end = np.array([history.segment.start, history.segment.end])
    for name, limit in history.voltage_limits.items():
        colour = BAD if name.endswith("critical") else BASELINE
        limit_at_ends = np.array([limit, limit])
        lines.append(Line(name, colour, start_and_end, limit_at_ends, style=LineStyle.DASHES))
    return lines


def _height_limits(
    measured_lines: Sequence[Line], estimate_lines: Sequence[Line]
) -> tuple[float, float] | None:
    """Returns the limits, m, of the axis of heights where the autopilot's estimate diverged by far; otherwise None.

    A lost estimate may fall by kilometres, on whose axis the flight would be a flat line. Then the measured heights
    determine the axis, and the estimate leaves it.

    Args:
        measured_lines: heights by barometer and satellites, m.
        estimate_lines: the estimated height, m, if it was recorded.
    """
    if not measured_lines or not estimate_lines:
        return None
    measured_heights = np.concatenate([line.y for line in measured_lines])
    lowest = float(np.nanmin(measured_heights))
    highest = float(np.nanmax(measured_heights))
    measured_span = highest - lowest
    estimate_span = max(float(np.nanmax(line.y) - np.nanmin(line.y)) for line in estimate_lines)
    if measured_span == 0 or estimate_span <= MAX_ESTIMATE_SPANS * measured_span:
        return None
    margin = CLIP_SPANS * measured_span
    return (lowest - margin, highest + margin)


def axis_history_charts(axis: str, history: AxisHistory) -> Charts:
    """Returns the charts of one axis over time: angle, °, and body rate, °/s, with setpoints, and the rate error.

    What was not recorded has no chart or, within a chart, no line.

    Args:
        axis: name of the axis.
        history: its angle and rate over time.
    """
    charts = []
    if history.angle is not None:
        angle_lines = _lines_with_setpoint(axis, history.angle)
        if axis not in TILT_AXES:
            # After several turns the details of a heading would not show, so that it is drawn between -180° and 180°.
            angle_lines = [_wrapped_to_half_turns(line) for line in angle_lines]
        charts.append(over_time(axis.capitalize(), "°", angle_lines))
    if history.rate is None:
        return tuple(charts)
    rate_lines = _lines_with_setpoint("rate", history.rate)
    charts.append(over_time(rate_title(axis), "°/s", rate_lines))
    if len(rate_lines) > 1:
        setpoint_line, rate_line = rate_lines
        error_line = Line("error", DISTURBANCE, rate_line.x, rate_line.y - setpoint_line.y)
        charts.append(over_time(f"{rate_title(axis)} error", "°/s", [error_line]))
    return tuple(charts)


def rate_title(axis: str) -> str:
    """Returns the title of the chart of an axis's body rate over time, such as "Roll rate"."""
    return f"{axis.capitalize()} rate"


def _lines_with_setpoint(name: str, signal: FollowedSetpoint) -> list[Line]:
    """Returns the lines of a setpoint and of the measured angle or rate that follows it, in degrees over time.

    Args:
        name: name of the measured signal in the legend.
        signal: the measured signal with its setpoint, in radians.

    Returns:
        The line of the setpoint and that of the measured signal; only the latter if the setpoint was not recorded.
    """
    degrees_per_radian = display_unit(signal.unit).scale
    time = signal.measured.time
    measured_line = Line(name, PREDICTED, time, degrees_per_radian * signal.measured.values)
    if signal.setpoint is None:
        return [measured_line]
    setpoint_line = Line("setpoint", TRUTH, time, degrees_per_radian * signal.setpoint)
    return [setpoint_line, measured_line]


def _lines_of_columns(
    signal: TimeSeries | None, names: Sequence[str], colours: Sequence[str] = DISTINCT
) -> Iterator[Line]:
    """Yields a line for each column of a signal, such as one for each motor.

    Args:
        signal: samples, (N,) for one line or (N, k) for k lines; None if it was not recorded, which yields nothing.
        names: names of the lines.
        colours: colours that the lines get in turn.
    """
    if signal is None:
        return
    columns = signal.values.reshape(len(signal.time), -1).T
    for name, colour, values in zip(names, cycle(colours), columns, strict=False):
        yield Line(name, colour, signal.time, values)


def wind_speed_and_direction_charts(history: WindHistory) -> Iterator[Chart]:
    """Yields a chart of the wind speed over time, m/s, and one of the direction that the wind comes from, °.

    Each has the estimate with its 90 % band, and the autopilot's own estimate if that was logged. Of a speed that is
    not identifiable only the band is drawn, within which it lies; such a direction has no chart.

    Args:
        history: the wind over time, as estimated and as the autopilot has it.
    """
    wind = history.estimate
    # Speed and direction of each sample, from the velocity north and east.
    polar = wind.polar
    title = "Wind"
    speed_line = _speed_line("wind", wind.time, polar.speed, polar.speed_half_width)
    if not wind.speed_identifiable:
        title = "Wind (only its 90 % band is known)"
        speed_line = speed_line._replace(y=np.full(len(wind.time), np.nan))
    autopilot_lines = _lines_of_columns(history.autopilot_speed, ["autopilot's own"], [BASELINE])
    chart = over_time(title, "m/s", [speed_line, *autopilot_lines])
    # A speed is compared with still air, and so with those of other flights.
    yield chart._replace(y=chart.y._replace(limits=(0.0, None)))
    if wind.direction_identifiable:
        yield _direction_chart(history)


def _direction_chart(history: WindHistory) -> Chart:
    """Returns the chart of the direction that the wind comes from, as estimated and as the autopilot has it.

    The axis has the mean direction in its middle, and names of the compass as ticks. So a wind about north has an
    unbroken line, and only one that turns by more than half a turn from the mean has a gap.

    Args:
        history: the wind over time. Its direction is identifiable.
    """
    wind = history.estimate
    middle = wind.direction
    polar = wind.polar
    lines = [
        _direction_line(
            "wind", DISTURBANCE, wind.time, polar.direction, middle, polar.direction_half_width
        )
    ]
    autopilot_direction = history.autopilot_direction
    if autopilot_direction is not None:
        degrees = autopilot_direction.values.ravel()
        lines.append(
            _direction_line("autopilot's own", BASELINE, autopilot_direction.time, degrees, middle)
        )
    title = f"Wind from {compass_text(middle)}"
    return over_time(title, "°", lines)._replace(y=_compass_axis(lines))


def _direction_line(
    name: str,
    colour: str,
    time: Array,
    direction: Array,
    middle: float,
    half_width: Array | None = None,
) -> Line:
    """Returns the line of a wind direction on an axis of one turn, with a gap wherever it passes the end of the axis.

    Args:
        name: name in the legend.
        colour: colour from ``mavdem.report.palette``.
        time: (T,) s.
        direction: (T,) degrees, of any size.
        middle: direction in the middle of the axis, degrees.
        half_width: (T,) half widths of the band, degrees; None for no band. The band is cut off at the ends of the
            axis.
    """
    start = middle - FULL_TURN / 2
    wrapped_direction = start + np.mod(direction - start, FULL_TURN)
    lower_edge = upper_edge = None
    if half_width is not None:
        lower_edge = np.maximum(wrapped_direction - half_width, start)
        upper_edge = np.minimum(wrapped_direction + half_width, start + FULL_TURN)
    line = Line(name, colour, time, wrapped_direction, lower_edge, upper_edge)
    return _broken_where_it_wraps(line)


def _compass_axis(lines: Sequence[Line]) -> Axis:
    """Returns the axis of lines of directions, degrees, with names of the compass as ticks.

    It reaches from one of the eight points of the compass to another, and shows all between them or, if these are many,
    the four cardinal ones.

    Args:
        lines: lines of directions, with their bands.
    """
    drawn_directions = list[Array]()
    for line in lines:
        for directions in (line.y, line.lower_edge, line.upper_edge):
            # A line without a band has no edges.
            if directions is not None:
                drawn_directions.append(directions)
    all_directions = np.concatenate(drawn_directions)
    # Points of the compass are numbered clockwise from north, which is 0, and may be below 0 or beyond a whole turn.
    lowest = int(np.floor(np.nanmin(all_directions) / EIGHTH_TURN))
    highest = int(np.ceil(np.nanmax(all_directions) / EIGHTH_TURN))
    # Every other one of the sixteen points: N, NE, E and so on.
    names = COMPASS_POINTS[::2]
    are_all_named = highest - lowest <= MAX_NAMED_EIGHTHS
    ticks = []
    for number in range(lowest, highest + 1):
        is_cardinal = number % 2 == 0
        if is_cardinal or are_all_named:
            ticks.append(Tick(EIGHTH_TURN * number, names[number % len(names)]))
    limits = (EIGHTH_TURN * lowest, EIGHTH_TURN * highest)
    return Axis("direction (°)", limits=limits, ticks=tuple(ticks))


def _wrapped_to_half_turns(line: Line) -> Line:
    """Returns the line of an angle, degrees, wrapped to between -180° and 180°, and broken where it jumps from one end.

    Args:
        line: the line of an angle of any size.
    """
    wrapped_angle = (line.y + FULL_TURN / 2) % FULL_TURN - FULL_TURN / 2
    return _broken_where_it_wraps(line._replace(y=wrapped_angle))


def _broken_where_it_wraps(line: Line) -> Line:
    """Returns a line of angles with a gap wherever they jump by more than half a turn, as from 359° to 1°.

    Without a gap, each jump would be drawn as a vertical stroke over the whole chart. For example, the angles
    [358, 359, 1] become [358, 359, NaN, 1].

    Args:
        line: angles, degrees, in a range of one turn.

    Returns:
        The line, with a NaN between the samples of each jump.
    """
    # The index of the first sample after each jump.
    jumps = 1 + np.flatnonzero(abs(np.diff(line.y)) > FULL_TURN / 2)

    def with_gaps(values: Array | None) -> Array | None:
        """Returns an edge of the band with a NaN at each jump; None without a band."""
        return None if values is None else np.insert(values, jumps, np.nan)

    times_of_gaps = (line.x[jumps] + line.x[jumps - 1]) / 2
    return line._replace(
        x=np.insert(line.x, jumps, times_of_gaps),
        y=np.insert(line.y, jumps, np.nan),
        lower_edge=with_gaps(line.lower_edge),
        upper_edge=with_gaps(line.upper_edge),
    )


def _speed_line(name: str, time: Array, speed: Array, half_width: Array) -> Line:
    """Draws a wind speed with its band, which does not go below zero.

    Args:
        name: name in the legend.
        time: (T,) s.
        speed: (T,) m/s.
        half_width: (T,) half widths of the band, m/s.

    Returns:
        The line.
    """
    lower_edge = np.maximum(speed - half_width, 0.0)
    return Line(name, DISTURBANCE, time, speed, lower_edge, speed + half_width)


def _wind_torque_chart(analyses: Mapping[str, LogAnalysis]) -> Chart:
    """Returns a chart of the wind torque over time, °/s², with a line for each axis on which it is identifiable.

    Args:
        analyses: the analyses by axis. The chart has no lines where none of them has such a model.
    """
    lines = []
    for axis, analysis in analyses.items():
        if analysis.learned is None:
            continue
        colour = DISTURBANCE if axis == AXES[0] else COMMAND
        line_of_axis = torque_line(analysis.learned, f"on {axis}", colour)
        if line_of_axis is not None:
            lines.append(line_of_axis)
    return over_time("Wind torque", TORQUE_UNIT.name, lines)


class _LiveColumns(NamedTuple):
    """Columns (N,) of the rows of a live history, ``LiveHistory.table``; NaN where a row lacks a value."""

    segment: Array
    """Number of the segment between two gaps."""

    time: Array
    """Time, s of the timeline."""

    measured_angle: Array
    """Measured angle, rad."""

    predicted_angle: Array
    """Angle predicted ``REPORTED_HORIZON`` s before, rad."""

    predicted_half_width: Array
    """Half width of the band of the predicted angle, rad."""

    wind_torque: Array
    """Wind torque, rad/s²."""

    torque_half_width: Array
    """Half width of the band of the wind torque, rad/s²."""

    wind_speed: Array
    """Wind speed, m/s."""

    speed_half_width: Array
    """Half width of the band of the wind speed, m/s."""

    roll: Array
    """Roll, rad."""

    pitch: Array
    """Pitch, rad."""

    roll_setpoint: Array
    """Setpoint of roll, rad."""

    pitch_setpoint: Array
    """Setpoint of pitch, rad."""

    yaw: Array
    """Yaw, rad."""

    north: Array
    """Position north of the autopilot's origin, m."""

    east: Array
    """Position east of it, m."""

    height: Array
    """Height above it, m."""

    motors: Array
    """Outputs (k, N) of the k motors, as a share of their range."""

    @classmethod
    def from_table(cls, table: Array) -> _LiveColumns:
        """Names the columns of ``LiveHistory.table``, (N, 17 + k)."""
        # All fields but the motors are one column each.
        motor_column = len(cls._fields) - 1
        columns = table.T
        return cls._make([*columns[:motor_column], columns[motor_column:]])


def live_timeline(history: LiveHistory, axis: str) -> Timeline | None:
    """Returns the timeline of the latest flight of a live session: what was measured, predicted and estimated in it.

    Its times are on the clock of the boot in which the flight began, as in the sentences of its events.

    Args:
        history: signals of the latest flight, or of what was received before the first one.
        axis: axis that was learned.

    Returns:
        The timeline without events, with those charts that have a finite value; None with less than two measured
        samples.
    """
    columns = _LiveColumns.from_table(history.table)
    if np.count_nonzero(np.isfinite(columns.measured_angle)) < 2:
        return None
    offset = history.flight.timeline_offset
    columns = columns._replace(time=columns.time - offset)
    broken_columns = _columns_broken_at_segments(history.table)
    broken_columns = broken_columns._replace(time=broken_columns.time - offset)
    charts = _charts_with_values(_live_charts(history.motor_names, axis, broken_columns))
    charts = _charts_with_slow_lines(charts)
    voltage_lines = _live_voltage_lines(history)
    if voltage_lines:
        charts.append(over_time("Battery", "V", voltage_lines))
    headings = np.degrees(columns.yaw[np.isfinite(columns.yaw)]) % FULL_TURN
    learned_intervals = [(start - offset, end - offset) for start, end in history.learned_intervals]
    return Timeline(
        flight_charts=tuple(charts),
        span=(columns.time[0], columns.time[-1]),
        grey_intervals=tuple(learned_intervals),
        grey_meaning="what the model was learned from",
        position=_live_position(history, columns),
        heading=float(headings[-1]) if len(headings) else None,
        time_axis=_time_axis_of_boot(history),
    )


def _columns_broken_at_segments(table: Array) -> _LiveColumns:
    """Returns the columns of a live flight's table with a row more at each new segment, at which lines break.

    The table has one row after another although nothing was received between two segments. The additional row has
    the time of the first sample of the segment, and NaN in all other columns.

    Args:
        table: ``LiveHistory.table``, (N, 17 + k) with k motors.
    """
    columns = _LiveColumns.from_table(table)
    # The difference number i is the one between the rows i and i + 1, the later of which begins a segment.
    segment_starts = np.flatnonzero(np.diff(columns.segment)) + 1
    time = np.insert(columns.time, segment_starts, columns.time[segment_starts])
    broken_table = np.insert(table, segment_starts, np.nan, axis=0)
    return _LiveColumns.from_table(broken_table)._replace(time=time)


def _charts_with_values(charts: Iterable[Chart]) -> list[Chart]:
    """Returns the charts without lines that have no finite value, and without charts that have no other lines.

    A setpoint that is not received has no line then, and no entry in the legend.

    Args:
        charts: charts over time, with NaN where nothing is known.
    """
    charts_with_values = []
    for chart in charts:
        lines = tuple(line for line in chart.lines if np.isfinite(line.y).any())
        if lines:
            charts_with_values.append(chart._replace(lines=lines))
    return charts_with_values


def _charts_with_slow_lines(charts: Iterable[Chart]) -> list[Chart]:
    """Returns the charts of a live flight, whose lines are not interrupted where samples are ``SAMPLE_PERIOD`` apart.

    The history has a sample for each row of the learner, many a second. Where there are no rows, as after a landing, it
    has samples at this longer period, which would look like gaps otherwise.

    Args:
        charts: charts over time.
    """
    # Imported here: the timeline of a log needs nothing of live sessions.
    from mavdem.live.history import SAMPLE_PERIOD

    longest_bridged_gap = MAX_GAP_STEPS * SAMPLE_PERIOD
    slow_charts = []
    for chart in charts:
        lines = tuple(line._replace(bridged_gap=longest_bridged_gap) for line in chart.lines)
        slow_charts.append(chart._replace(lines=lines))
    return slow_charts


def _live_voltage_lines(history: LiveHistory) -> list[Line]:
    """Returns a line over time for the voltage, V, of each battery of a live vehicle.

    Args:
        history: signals of the live flight, with samples of time and voltage by the number of the battery.

    Returns:
        The lines, on the clock of the boot in which the flight began; a battery with a single sample has none.
    """
    lines = []
    for (number, samples), colour in zip(history.voltages.items(), cycle(DISTINCT), strict=False):
        if len(samples) < 2:
            continue
        # The number is shown only where there are several batteries, as for a log.
        name = battery_name(number) if len(history.voltages) > 1 else "battery"
        timeline_time, voltage = samples.T
        boot_time = timeline_time - history.flight.timeline_offset
        line = Line(name, colour, boot_time, voltage, bridged_gap=BRIDGED_VOLTAGE_GAP)
        lines.append(line)
    return lines


def _time_axis_of_boot(history: LiveHistory) -> Axis:
    """Returns the axis of time of a live flight; after a restart of the autopilot it names the boot, as events do."""
    if history.boot == 0:
        return TIME
    return TIME._replace(label=f"time since boot {history.flight.boot + 1} (s)")


def _live_position(history: LiveHistory, columns: _LiveColumns) -> TimeSeries | None:
    """Returns the flown path of a live vehicle since the latest boot of its autopilot, for the map of its page.

    Args:
        history: signals of the live flight on one timeline.
        columns: position of the history's rows, and time on the clock of the boot in which the flight began, by name.

    Returns:
        Positions (N, 3), m north, east and down; None if fewer than two are known.
    """
    positions = np.column_stack([columns.north, columns.east, -columns.height])
    # The start of the latest boot may be unknown (NaN). The comparison is then false, and no row is of an earlier boot.
    is_of_earlier_boot = columns.time < history.boot_start - history.flight.timeline_offset
    is_shown = np.isfinite(positions).all(axis=1) & ~is_of_earlier_boot
    count = np.count_nonzero(is_shown)
    if count < 2:
        return None
    boots = np.full(count, history.boot)
    return TimeSeries(columns.time[is_shown], boots, positions[is_shown])


def _live_charts(motor_names: Iterable[str], axis: str, columns: _LiveColumns) -> Iterator[Chart]:
    """Yields charts of roll, pitch, height, motors, wind torque and wind speed of a live flight.

    The axis that was learned comes first, with what was predicted of it.

    Args:
        motor_names: names of the motors.
        axis: axis that was learned.
        columns: values over time, with NaN where lines break.
    """
    time = columns.time
    yield from _live_angle_charts(axis, columns)
    yield over_time("Height", "m", [Line("height", MEASURED, time, columns.height)])

    motor_lines = []
    for name, colour, shares in zip(motor_names, cycle(DISTINCT), columns.motors, strict=False):
        percent = 100 * shares.clip(0.0)
        motor_lines.append(Line(without_remark(name), colour, time, percent))
    yield over_time("Motors", "%", motor_lines)

    wind_torque = TORQUE_UNIT.scale * columns.wind_torque
    torque_half_width = TORQUE_UNIT.scale * columns.torque_half_width
    torque_band_line = Line.with_band(
        f"on {axis}", DISTURBANCE, time, wind_torque, torque_half_width
    )
    yield over_time("Wind torque", TORQUE_UNIT.name, [torque_band_line])

    speed_line = _speed_line("wind", time, columns.wind_speed, columns.speed_half_width)
    yield over_time("Wind now", "m/s", [speed_line])


def _live_angle_charts(axis: str, columns: _LiveColumns) -> Iterator[Chart]:
    """Yields charts of roll and pitch of a live flight, degrees, each with its setpoint.

    The axis that was learned comes first, with what the model predicted of it.

    Args:
        axis: axis that was learned, "roll" or "pitch".
        columns: values over time, rad, with NaN where lines break.
    """
    # Imported here: the timeline of a log needs nothing of live sessions.
    from mavdem.live.history import REPORTED_HORIZON

    time = columns.time
    setpoints = {"roll": columns.roll_setpoint, "pitch": columns.pitch_setpoint}
    angles = {"roll": columns.roll, "pitch": columns.pitch, axis: columns.measured_angle}
    other_axis = "pitch" if axis == "roll" else "roll"
    for name in (axis, other_axis):
        setpoint = Line("setpoint", TRUTH, time, ANGLE_UNIT.scale * setpoints[name])
        measured = Line(
            "measured",
            MEASURED,
            time,
            ANGLE_UNIT.scale * angles[name],
            style=LineStyle.BOLD,
        )
        lines = [setpoint, measured]
        if name == axis:
            prediction = Line.with_band(
                f"predicted {REPORTED_HORIZON:g} s ahead",
                PREDICTED,
                time,
                ANGLE_UNIT.scale * columns.predicted_angle,
                ANGLE_UNIT.scale * columns.predicted_half_width,
                style=LineStyle.DASHES,
            )
            # A prediction that diverges must not determine the range of the chart.
            lines.insert(0, prediction.clipped_to(lines))
        yield over_time(name.capitalize(), ANGLE_UNIT.name, lines)
