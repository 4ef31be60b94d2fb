"""Timeline: what a flight did over time, as charts on one common time axis that a page zooms together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment import Assessment
from mavdem.confidence import Interval
from mavdem.dataset import phases
from mavdem.dataset.axes import AXES
from mavdem.dataset.batteries import battery_name
from mavdem.dataset.segments import Segment, Segments, in_segments
from mavdem.dataset.setpoints import Setpoint, held_setpoint
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts.event import Event
from mavdem.report.charts.chart import TIME, Axis, Chart, Charts, Line, Mark, Span, over_time
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
from mavdem.wind_velocity.compass import PolarWind, compass_text, speed_and_direction
from mavdem.wind_velocity.from_log import WindEvidence

if TYPE_CHECKING:
    from mavdem.live.history import LiveHistory

SECONDS_AROUND_FLIGHT = 5.0
"""Time shown before arming and after disarming, s: a choice."""

MIN_DEGREES_RATIO = 10.0
"""Logged rates are in °/s if they deviate so many times as much as the attitude's rates, which are in rad/s.

Some firmware sends degrees. The ratio is then 57, and near 1 where both are in rad/s.
"""

ANGLE_UNIT = display_unit("rad")
"""Unit in which angles and rates are shown: degrees."""


class Timeline(NamedTuple):
    """Charts of one flight on one clock, with what is marked in all of them."""

    flight_charts: Charts
    """Height, motors and battery; of a live flight all charts."""

    span: Interval
    """First and last time shown, s on the boot clock."""

    axis_charts: Mapping[str, Charts] = MappingProxyType({})
    """Angle, rate and rate error by axis, those that were recorded in this order."""

    training_intervals: tuple[Interval, ...] = ()
    """First and last time, s, of each part of the flight that the model was trained on."""

    modes: tuple[Span, ...] = ()
    """Flight modes in order of time."""

    events: tuple[Event, ...] = ()
    """What happened, in order of time."""

    position: TimeSeries | None = None
    """Flown path (N, 3), m north, east and down."""

    wind_charts: Charts = ()
    """Wind speed, wind direction and wind torque, those that are known."""

    @property
    def overview(self) -> Charts:
        """The strip of flight modes, then the charts of flight and wind, all with events and training intervals."""
        marked = tuple(self.marked(chart) for chart in self.flight_charts + self.wind_charts)
        if not self.modes:
            return marked
        strip = Chart("Modes", self._time_axis, Axis(""), spans=self.modes, group="flight")
        return (strip, *marked)

    @property
    def _time_axis(self) -> Axis:
        return TIME._replace(ends=self.span)

    def marked(self, chart: Chart) -> Chart:
        """Returns a chart of this flight over the span of the timeline, with its events and training intervals."""
        marks = tuple(
            Mark(event.seconds, colour=BAD if event.is_alarm else MEASURED)
            for event in self.events
            if np.isfinite(event.seconds)
        )
        spans = tuple(Span(start, end) for start, end in self.training_intervals)
        return chart._replace(x=self._time_axis, marks=marks, spans=spans)


def timeline_of(assessment: Assessment) -> Timeline | None:
    """Returns the charts and events of the boot that was analysed, all over one axis of time.

    A log may contain several boots: times between two starts of the autopilot, each with a clock that begins at 0.
    Times of different boots cannot share an axis, so only what belongs to the analysed boot is shown. An event that is
    of no certain boot is shown too.

    Args:
        assessment: all that was found out about the log.

    Returns:
        The timeline; None where nothing was analysed, or the boot has less than two samples of the attitude.
    """
    analysis = assessment.analysis
    evidence = assessment.evidence
    if analysis is None or evidence is None:
        return None
    signals = evidence.signals
    segment = _shown_segment(signals, analysis.learnability.segments)
    if segment is None:
        return None
    flight_charts = [chart for chart in _flight_charts(signals, segment) if chart.lines]
    axis_charts = {axis: tuple(_axis_charts(signals.for_axis(axis), segment)) for axis in AXES}
    wind_charts = [*wind_speed_and_direction_charts(evidence.wind, segment)]
    wind_charts.append(_wind_torque_chart(assessment))
    events = [
        Event(fact.time, fact)
        for fact in assessment.events
        if fact.time is not None and fact.figures.get("boot", segment.boot) == segment.boot
    ]
    position = signals.position
    return Timeline(
        flight_charts=tuple(flight_charts),
        span=(segment.start, segment.end),
        axis_charts=axis_charts,
        training_intervals=tuple((flight.time[0], flight.time[-1]) for flight in analysis.flights),
        modes=_mode_spans(signals, segment),
        events=tuple(events),
        position=None if position is None else _within(position, segment),
        wind_charts=tuple(chart for chart in wind_charts if chart.lines),
    )


def _shown_segment(signals: Signals, segments: Segments) -> Segment | None:
    """Returns the part of a log that a timeline shows: one boot, from shortly before arming to shortly after disarming.

    Args:
        signals: signals of the vehicle.
        segments: settled segments; the boot is that of the first one or, without any, the one with the most samples.

    Returns:
        The part, limited to the samples of the attitude; None with less than two of them. Without information on
        arming it is the whole boot.
    """
    if not signals.tilts:
        return None
    tilt = signals.tilts[0]
    if segments:
        boot = int(segments[0].boot)
    else:
        boot = int(np.bincount(tilt.boot, minlength=1).argmax())
    time = tilt.time[tilt.boot == boot]
    if len(time) < 2:
        return None
    armed = phases.armed_intervals(signals, boot) or [(-np.inf, np.inf)]
    first_armed = armed[0][0]
    last_armed = armed[-1][1]
    start = max(time[0], first_armed - SECONDS_AROUND_FLIGHT)
    end = min(time[-1], last_armed + SECONDS_AROUND_FLIGHT)
    return Segment(boot, start, end)


def _mode_spans(signals: Signals, segment: Segment) -> tuple[Span, ...]:
    """Returns the flight modes within a segment: each lasts until the next change, the last one to the end.

    The mode in which the segment begins may have been set before it, so that spans are cut at the segment's ends.
    """
    changes = signals.mode_changes(segment.boot)
    end_times = [time for time, _ in changes[1:]] + [segment.end]
    spans = []
    for (time, name), end_time in zip(changes, end_times, strict=False):
        span = Span(max(time, segment.start), min(end_time, segment.end), name)
        if span.start < span.end:
            spans.append(span)
    return tuple(spans)


def _flight_charts(signals: Signals, segment: Segment) -> Iterator[Chart]:
    """Yields charts of height, motors, and battery; one that was not recorded has no lines.

    Motors are shown as percent of their range, and again minus the mean of all motors at each time, which shows what
    steers the vehicle.
    """
    yield over_time("Height", "m", _lines(signals.height, segment, ["height"]))
    motors = signals.motors
    if motors is not None:
        percent = 100 * motors.scale.fraction(motors.outputs).clip(0.0)
        shares = TimeSeries(motors.time, motors.boot, percent)
        deviations = replace(shares, values=percent - percent.mean(axis=1, keepdims=True))
        names = [without_remark(name) for name in motors.geometry.names]
        yield over_time("Motors", "%", _lines(shares, segment, names))
        yield over_time("Motors minus their mean", "%", _lines(deviations, segment, names))
    batteries: list[Line] = []
    for row, battery in enumerate(signals.batteries):
        name = battery_name(battery.number) if len(signals.batteries) > 1 else "battery"
        batteries += _lines(battery.voltage, segment, [name], DISTINCT[row % len(DISTINCT) :])
    yield over_time("Battery", "V", batteries)


def _axis_charts(signals: Signals, segment: Segment) -> Iterator[Chart]:
    """Yields charts of one axis: angle and rate with their setpoints, and the rate error, as far as recorded.

    Args:
        signals: signals of the vehicle, for this axis.
        segment: part of the log to show.
    """
    attitude = signals.attitude
    if attitude is None:
        return
    rate, rate_setpoint = signals.rate_and_setpoint or (attitude.rate_series, None)
    # Rates that were logged apart from the attitude may be in degrees/s; the attitude's own are always in rad/s.
    is_in_degrees = np.nanstd(rate.values) > MIN_DEGREES_RATIO * np.nanstd(attitude.rate)
    rate_scale = 1.0 if is_in_degrees else ANGLE_UNIT.scale
    angle_lines = _lines_with_setpoint(
        signals.axis, ANGLE_UNIT.scale, attitude.angle_series, signals.angle_setpoint, segment
    )
    rate_lines = _lines_with_setpoint("rate", rate_scale, rate, rate_setpoint, segment)
    title = signals.axis.capitalize()
    if angle_lines:
        yield over_time(title, "°", angle_lines)
    if rate_lines:
        yield over_time(f"{title} rate", "°/s", rate_lines)
    if len(rate_lines) > 1:
        setpoint_line, rate_line = rate_lines
        error = Line("error", DISTURBANCE, rate_line.x, rate_line.y - setpoint_line.y)
        yield over_time(f"{title} rate error", "°/s", [error])


def _lines_with_setpoint(
    name: str, scale: float, signal: TimeSeries, setpoint: TimeSeries | None, segment: Segment
) -> list[Line]:
    """Returns the lines of a setpoint and of the measured signal that follows it, the setpoint first.

    Args:
        name: name of the signal's line.
        scale: factor from the logged unit to the shown one.
        signal: what was measured.
        setpoint: what was commanded; None where it was not logged.
        segment: part of the log to show.

    Returns:
        Two lines, one without a setpoint in the segment, or none without at least two samples of the signal.
    """
    measured = _within(signal, segment)
    if measured is None:
        return []
    lines = [Line(name, PREDICTED, measured.time, scale * measured.values)]
    if setpoint is not None:
        held = held_setpoint(Setpoint("", "", "", setpoint), segment.boot, measured.time)
        commanded = scale * held
        if np.isfinite(commanded).any():
            lines.insert(0, Line("setpoint", TRUTH, measured.time, commanded))
    return lines


def _lines(
    signal: TimeSeries | None,
    segment: Segment,
    names: Sequence[str],
    colours: Sequence[str] = DISTINCT,
) -> Iterator[Line]:
    """Yields a line for each column of a signal within a segment; nothing without at least two samples.

    Args:
        signal: samples (N,) or (N, k); None where it was not logged.
        segment: part of the log to show.
        names: names of the k lines.
        colours: colours that the lines get in turn.
    """
    part = None if signal is None else _within(signal, segment)
    if part is None:
        return
    columns = part.values.reshape(len(part.time), -1).T
    for name, colour, values in zip(names, cycle(colours), columns, strict=False):
        yield Line(name, colour, part.time, values)


def _within(signal: TimeSeries, segment: Segment) -> TimeSeries | None:
    """Returns the samples of a signal within a segment; None if these are less than two, which make no line."""
    is_inside = in_segments(signal, segment, slack=0)
    if np.count_nonzero(is_inside) < 2:
        return None
    return signal.select(is_inside)


def wind_speed_and_direction_charts(evidence: WindEvidence, segment: Segment) -> Iterator[Chart]:
    """Yields a chart of the wind speed (m/s) and one of its direction (°), each where the data determines it.

    The autopilot's own estimate is drawn with them, where it was logged. The wind is estimated as north and east
    components, and converted to speed and direction here.

    Args:
        evidence: what is known of the wind; there is no chart if it was estimated in another boot.
        segment: part of the log to show.
    """
    wind = evidence.estimate
    if wind is None or wind.boot != segment.boot:
        return
    # Directions are drawn within half a turn of the mean, so that their line does not jump at north.
    mean_direction = wind.direction if wind.direction_identifiable else 0.0
    polar = speed_and_direction(wind.velocity, wind.band, mean_direction)
    autopilot = evidence.autopilot_estimate
    autopilot_polar: PolarWind | None = None
    if autopilot is not None:
        autopilot_polar = speed_and_direction(
            autopilot.values, 0 * autopilot.values, mean_direction
        )

    def with_autopilot(line: Line, autopilot_values: Array | None) -> list[Line]:
        if autopilot is None or autopilot_values is None:
            return [line]
        series = TimeSeries(autopilot.time, autopilot.boot, autopilot_values)
        return [line, *_lines(series, segment, ["autopilot's own"], [BASELINE])]

    if wind.speed_identifiable:
        autopilot_speed = None if autopilot_polar is None else autopilot_polar.speed
        line = _speed_line("wind", wind.time, polar.speed, polar.speed_half_width)
        yield over_time("Wind", "m/s", with_autopilot(line, autopilot_speed))
    if wind.direction_identifiable:
        autopilot_direction = None if autopilot_polar is None else autopilot_polar.direction
        line = Line.with_band(
            "wind", DISTURBANCE, wind.time, polar.direction, polar.direction_half_width
        )
        title = f"Wind from {compass_text(mean_direction)}"
        yield over_time(title, "°", with_autopilot(line, autopilot_direction))


def _speed_line(name: str, time: Array, speed: Array, half_width: Array) -> Line:
    """Returns the line of a wind speed (T,), m/s, over time (T,), s, with its band, which does not go below zero."""
    low = np.maximum(speed - half_width, 0.0)
    return Line(name, DISTURBANCE, time, speed, low, speed + half_width)


def _wind_torque_chart(assessment: Assessment) -> Chart:
    """Returns a chart of the wind torque over time, °/s², with a line for each axis on which it is identifiable.

    It has no lines where no axis has such a model.
    """
    lines = []
    for axis, analysis in assessment.analyses.items():
        if analysis.learned is None:
            continue
        colour = DISTURBANCE if axis == AXES[0] else COMMAND
        line = torque_line(analysis.learned, f"on {axis}", colour)
        if line is not None:
            lines.append(line)
    return over_time("Wind torque", TORQUE_UNIT.name, lines)


def live_timeline(history: LiveHistory, axis: str) -> Timeline | None:
    """Returns the timeline of a live flight: what was measured, predicted and estimated while it flew.

    Args:
        history: history of the flight.
        axis: axis that was learned.

    Returns:
        The timeline, with those charts that have a finite value; None with less than two measured samples.
    """
    table = history.table
    segments = table[:, 0]
    times = table[:, 1]
    measured_angles = table[:, 2]
    if np.count_nonzero(np.isfinite(measured_angles)) < 2:
        return None
    # A row of NaN at the beginning of each segment breaks the lines there.
    starts = np.flatnonzero(np.diff(segments)) + 1
    columns = np.insert(table, starts, np.nan, axis=0).T
    time = np.insert(times, starts, times[starts])
    charts = _live_charts(history.motor_names, axis, time, columns)
    has_values = [
        chart for chart in charts if any(np.isfinite(line.y).any() for line in chart.lines)
    ]
    return Timeline(
        flight_charts=tuple(has_values),
        span=(time[0], time[-1]),
        training_intervals=tuple(history.learned_intervals),
        events=tuple(history.events),
    )


def _live_charts(
    motor_names: Iterable[str], axis: str, time: Array, columns: Array
) -> Iterator[Chart]:
    """Yields charts of angle, motors, wind torque and wind speed of a live flight.

    Args:
        motor_names: names of the motors.
        axis: axis that was learned.
        time: (N,) s of the timeline.
        columns: (k, N) the columns of ``LiveHistory.table``: segment, time, then measured and predicted angle, rad,
            wind torque, rad/s², and wind speed, m/s, the last three each followed by the half width of its band, then
            the outputs of the motors as a share of their range.
    """
    # Imported here: the timeline of a log needs nothing of live sessions.
    from mavdem.live.history import REPORTED_HORIZON

    measured, predicted, predicted_band, torque, torque_band, wind, wind_band = columns[2:9]
    motor_columns = columns[9:]
    measured_line = Line("measured", MEASURED, time, ANGLE_UNIT.scale * measured)
    predicted_line = Line.with_band(
        f"{REPORTED_HORIZON:g} s ahead",
        PREDICTED,
        time,
        ANGLE_UNIT.scale * predicted,
        ANGLE_UNIT.scale * predicted_band,
    )
    yield over_time(axis.capitalize(), ANGLE_UNIT.name, [measured_line, predicted_line])
    motor_lines = [
        Line(without_remark(name), colour, time, 100 * shares.clip(0.0))
        for name, colour, shares in zip(motor_names, cycle(DISTINCT), motor_columns, strict=False)
    ]
    yield over_time("Motors", "%", motor_lines)
    torque_band_line = Line.with_band(
        f"on {axis}",
        DISTURBANCE,
        time,
        TORQUE_UNIT.scale * torque,
        TORQUE_UNIT.scale * torque_band,
    )
    yield over_time("Wind torque", TORQUE_UNIT.name, [torque_band_line])
    yield over_time("Wind now", "m/s", [_speed_line("wind", time, wind, wind_band)])
