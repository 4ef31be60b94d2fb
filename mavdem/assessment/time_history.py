"""Time history of a flight: the signals of the boot that was analysed, from shortly before arming to after disarming.

A log may contain several boots: times between two starts of the autopilot, each with a clock that begins at 0. Times of
different boots cannot share an axis, so a time history has one boot only. Page and dashboard draw it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import Names
from mavdem.dataset import flight_states
from mavdem.dataset.axes import AXES
from mavdem.dataset.batteries import battery_name
from mavdem.dataset.segments import Segment, Segments, in_segments
from mavdem.dataset.setpoints import Setpoint, held_setpoint
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Facts
from mavdem.facts.event import Event
from mavdem.wind_velocity.estimation import WindVelocity
from mavdem.wind_velocity.from_log import WindEvidence

SECONDS_AROUND_FLIGHT = 5.0
"""Time before arming and after disarming, s: a choice."""

MIN_DEGREES_RATIO = 10.0
"""Logged rates are in °/s if they deviate so many times as much as the attitude's rates, which are in rad/s.

Some firmware sends degrees. The ratio is then 57, and near 1 where both are in rad/s.
"""


@dataclass(frozen=True, eq=False)
class FollowedSetpoint:
    """A measured signal of one axis, with the setpoint that it follows."""

    measured: TimeSeries
    """The signal (N,), at least two samples."""
    setpoint: Array | None
    """The setpoint (N,) at the samples, NaN where none holds; None if none holds at any."""
    unit: str
    """Unit of both: "rad" of an angle, "rad/s" of a rate or, of firmware that logs degrees, "°/s"."""


@dataclass(frozen=True, eq=False)
class AxisHistory:
    """Angle and body rate of one axis."""

    angle: FollowedSetpoint | None
    """The Euler angle; None with less than two samples."""
    rate: FollowedSetpoint | None
    """The body rate; None with less than two samples."""


@dataclass(frozen=True, eq=False)
class MotorHistory:
    """Outputs of the M motors at N times, in percent of their range."""

    names: Names
    """Names of the motors."""
    outputs: TimeSeries | None
    """Outputs (N, M), at least 0; None with less than two samples."""
    deviations: TimeSeries | None
    """Outputs minus the mean of all motors at the same time (N, M), which steer the vehicle."""


@dataclass(frozen=True, eq=False)
class WindHistory:
    """The wind in m/s, with the autopilot's own estimate of it."""

    estimate: WindVelocity
    """The wind, with the times that it was estimated at."""
    autopilot_speed: TimeSeries | None
    """Wind speed by the autopilot, m/s; None if it was not logged."""
    autopilot_direction: TimeSeries | None
    """Direction that the wind comes from by the autopilot, degrees within half a turn of the mean direction."""


@dataclass(frozen=True)
class ModeInterval:
    """A time in one flight mode, s."""

    name: str
    start: float
    end: float


@dataclass(frozen=True, eq=False)
class TimeHistory:
    """The signals of one flight over time; all times are s on the clock of one boot.

    Signals are limited to the ``segment``. One that has less than two samples there, which make no line, is None.
    """

    segment: Segment
    """The boot, with the first and the last time."""
    height: TimeSeries | None
    """Height (N,), m."""
    motors: MotorHistory | None
    """Outputs of the motors; None if they were not recorded."""
    voltages: Mapping[str, TimeSeries | None]
    """Voltage (N,), V, by name of the battery; empty if none was recorded."""
    axes: Mapping[str, AxisHistory | None]
    """Angle and rate by axis; None if no attitude was recorded."""
    wind: WindHistory | None
    """The wind; None if it is not known, or was estimated in another boot."""
    modes: tuple[ModeInterval, ...]
    """Flight modes in the order of time."""
    events: tuple[Event, ...]
    """What happened in the boot, or in a boot that is not known, in the order of time."""
    position: TimeSeries | None
    """Flown path (N, 3), m north, east and down."""


def time_history(
    signals: Signals, settled_segments: Segments, wind: WindEvidence, events: Facts
) -> TimeHistory | None:
    """Returns the signals of the boot that was analysed, over time.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        settled_segments: segments of settled flight. The boot is the first one's or, without any segment, the boot
            with the most samples of the attitude.
        wind: evidence of the wind.
        events: events in the order of boot and time.

    Returns:
        The time history; None if the boot has less than two samples of the attitude.
    """
    segment = _segment_of_flight(signals, settled_segments)
    if segment is None:
        return None
    events_of_boot = []
    for fact in events:
        if fact.time is not None and fact.figures.get("boot", segment.boot) == segment.boot:
            events_of_boot.append(Event(fact.time, fact))
    return TimeHistory(
        segment=segment,
        height=_samples_within(signals.height, segment),
        motors=_motor_history(signals, segment),
        voltages=_battery_voltages(signals, segment),
        axes={axis: _axis_history(signals.for_axis(axis), segment) for axis in AXES},
        wind=wind_history(wind, segment),
        modes=_mode_intervals(signals, segment),
        events=tuple(events_of_boot),
        position=_samples_within(signals.position, segment),
    )


def _segment_of_flight(signals: Signals, settled_segments: Segments) -> Segment | None:
    """Returns the part of one boot from shortly before arming to shortly after disarming.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        settled_segments: segments of settled flight. The boot is the first one's or, without any segment, the boot
            with the most samples of the attitude.

    Returns:
        The part, limited to the samples of the attitude; None with less than two of them. Without information on
        arming it is the whole boot.
    """
    if not signals.tilts:
        return None
    tilt = signals.tilts[0]
    if settled_segments:
        boot = int(settled_segments[0].boot)
    else:
        boot = int(np.bincount(tilt.boot, minlength=1).argmax())
    time = tilt.time[tilt.boot == boot]
    if len(time) < 2:
        return None
    armed = flight_states.armed_intervals(signals, boot) or [(-np.inf, np.inf)]
    first_arming, _ = armed[0]
    _, last_disarming = armed[-1]
    start = max(time[0], first_arming - SECONDS_AROUND_FLIGHT)
    end = min(time[-1], last_disarming + SECONDS_AROUND_FLIGHT)
    return Segment(boot, start, end)


def _samples_within(signal: TimeSeries | None, segment: Segment) -> TimeSeries | None:
    """Returns the samples of a signal within a segment.

    Args:
        signal: samples of the whole log; None if the signal was not recorded.
        segment: boot, start and end.

    Returns:
        The samples; None if these are less than two, or it was not recorded.
    """
    if signal is None:
        return None
    is_inside = in_segments(signal, segment, slack=0)
    if np.count_nonzero(is_inside) < 2:
        return None
    return signal.select(is_inside)


def _motor_history(signals: Signals, segment: Segment) -> MotorHistory | None:
    """Returns the outputs of the motors within a segment, in percent of their range.

    The deviations from the mean of all motors show the commands about the axes, without the common thrust.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        segment: boot and time that are shown.

    Returns:
        The outputs; None if they were not recorded.
    """
    motors = signals.motors
    if motors is None:
        return None
    percent = 100 * motors.scale.fraction(motors.outputs).clip(0.0)
    outputs = TimeSeries(motors.time, motors.boot, percent)
    deviations = replace(outputs, values=percent - percent.mean(axis=1, keepdims=True))
    return MotorHistory(
        motors.geometry.names,
        _samples_within(outputs, segment),
        _samples_within(deviations, segment),
    )


def _battery_voltages(signals: Signals, segment: Segment) -> dict[str, TimeSeries | None]:
    """Collects the voltages of the batteries within a segment.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        segment: boot, start and end.

    Returns:
        Voltage, V, by the battery's name, "battery" if there is only one; None if it was not recorded in the segment.
    """
    batteries = signals.batteries
    if len(batteries) == 1:
        return {"battery": _samples_within(batteries[0].voltage, segment)}
    return {
        battery_name(battery.number): _samples_within(battery.voltage, segment)
        for battery in batteries
    }


def _axis_history(signals: Signals, segment: Segment) -> AxisHistory | None:
    """Returns angle and rate of one axis within a segment, with their setpoints.

    Args:
        signals: signals of the vehicle, for this axis.
        segment: boot and time that are shown.

    Returns:
        Angle and rate with their setpoints; None without an attitude.
    """
    attitude = signals.attitude
    if attitude is None:
        return None
    rate, rate_setpoint = signals.rate_and_setpoint or (attitude.rate_series, None)
    # Rates in separate messages may be in °/s, which the ratio of their scatter to that of the attitude's rates
    # shows: these are always in rad/s.
    is_in_degrees = np.nanstd(rate.values) > MIN_DEGREES_RATIO * np.nanstd(attitude.rate)
    rate_unit = "°/s" if is_in_degrees else "rad/s"
    return AxisHistory(
        _followed_setpoint(attitude.angle_series, signals.angle_setpoint, "rad", segment),
        _followed_setpoint(rate, rate_setpoint, rate_unit, segment),
    )


def _followed_setpoint(
    signal: TimeSeries, setpoint: TimeSeries | None, unit: str, segment: Segment
) -> FollowedSetpoint | None:
    """Returns a signal within a segment, with its setpoint at the same times.

    A setpoint applies until the next one, so that the latest one at each sample of the signal is used.

    Args:
        signal: measured quantity.
        setpoint: commanded quantity; None if it was not recorded.
        unit: unit of both.
        segment: boot and time that are shown.

    Returns:
        The signal with its setpoint, None if that was not recorded in the segment. The result is None with less than
        two samples of the signal there.
    """
    measured_signal = _samples_within(signal, segment)
    if measured_signal is None:
        return None
    latest_setpoint = None
    if setpoint is not None:
        recorded_setpoint = Setpoint(name="", unit=unit, message="", signal=setpoint)
        setpoint_at_samples = held_setpoint(recorded_setpoint, segment.boot, measured_signal.time)
        if np.isfinite(setpoint_at_samples).any():
            latest_setpoint = setpoint_at_samples
    return FollowedSetpoint(measured_signal, latest_setpoint, unit)


def wind_history(evidence: WindEvidence, segment: Segment) -> WindHistory | None:
    """Returns the estimated wind, with the autopilot's own estimate as speed (m/s) and direction (degrees).

    Args:
        evidence: the wind as it was estimated here, and as the autopilot estimates it.
        segment: boot and time that are shown.

    Returns:
        The wind; None if it is not known, or was estimated in another boot than the ``segment`` is of.
    """
    wind = evidence.estimate
    if wind is None or wind.boot != segment.boot:
        return None
    autopilot = evidence.autopilot_estimate
    if autopilot is None:
        return WindHistory(wind, None, None)
    # The autopilot does not say how uncertain its estimate is, so that its band has the width 0.
    polar = wind.as_polar(autopilot.values, band=np.zeros_like(autopilot.values))
    speed = TimeSeries(autopilot.time, autopilot.boot, polar.speed)
    direction = TimeSeries(autopilot.time, autopilot.boot, polar.direction)
    return WindHistory(wind, _samples_within(speed, segment), _samples_within(direction, segment))


def _mode_intervals(signals: Signals, segment: Segment) -> tuple[ModeInterval, ...]:
    """Lists the flight modes within a segment, each from its change to the next.

    The mode in which the segment begins may have been set before it, so that intervals are cut at the segment's ends.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        segment: boot and time that are shown.

    Returns:
        The modes in time order, with start and end of each.
    """
    changes = signals.mode_changes(segment.boot)
    end_times = [time for time, _ in changes[1:]] + [segment.end]
    modes = []
    for (time, name), end_time in zip(changes, end_times, strict=False):
        start = max(time, segment.start)
        end = min(end_time, segment.end)
        if start < end:
            modes.append(ModeInterval(name, start, end))
    return tuple(modes)
