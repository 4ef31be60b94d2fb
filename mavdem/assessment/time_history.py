"""Time history of a flight: the signals of the boot that was analysed, from shortly before arming to after disarming.

A log may contain several boots: times between two starts of the autopilot, each with a clock that begins at 0. A time
history is on the clock of one of them, and has this boot only or, for a page, the flights of all boots.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.battery_levels import cell_count, is_measured, voltage_levels
from mavdem.assessment.doubted_heights import DOUBTS_ABOUT_BAROMETER
from mavdem.assessment.flights import flights_in_boot
from mavdem.assessment.height_disagreements import height_difference, initial_difference
from mavdem.assessment.shown_time import ShownTime, one_part, successive_parts
from mavdem.containers import Names
from mavdem.dataset import flight_states
from mavdem.dataset.axes import AXES, DOWN
from mavdem.dataset.batteries import battery_name
from mavdem.dataset.intervals import in_intervals
from mavdem.dataset.segments import Segment, Segments
from mavdem.dataset.setpoints import Setpoint
from mavdem.dataset.signals import Signals, plane_positions
from mavdem.dataset.time_series import TimeSeries, series_of_boot
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.facts import Facts
from mavdem.facts.ending import MotionEvent
from mavdem.facts.event import Event
from mavdem.wind_velocity.from_log import WindEvidence
from mavdem.wind_velocity.velocity import WindVelocity
from mavdem.witnesses.ground_heights import satellite_position
from mavdem.witnesses.height import height_comparison

SECONDS_AROUND_FLIGHT = 5.0
"""Time before arming and after disarming, s: a choice."""

HEIGHT_DOUBTS = (*DOUBTS_ABOUT_BAROMETER, MotionEvent.HEIGHT_OFFSET)
"""Events that compare a height with that by satellites, and find it wrong or doubtful."""

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

    Signals are limited to the ``segment``. A signal with less than two samples there, which make no line, is None.
    """

    segment: Segment
    """The boot on whose clock the times are, with the first and the last time that is shown."""
    height: TimeSeries | None
    """Height (N,), m."""
    barometer_height: TimeSeries | None
    """Height (L,) by the barometer alone, m; None without a usable barometer. It shows where the height diverged."""
    satellite_height: TimeSeries | None
    """Height (G,) by satellites, m, if an event doubts another height, or if there is no other; otherwise None.
    Receivers of sound vehicles wander by several metres, which would hide the movements of a low flight."""
    motors: MotorHistory | None
    """Outputs of the motors; None if they were not recorded."""
    voltages: Mapping[str, TimeSeries | None]
    """Voltage (N,), V, by name of the battery; empty if none was recorded."""
    voltage_limits: Mapping[str, float]
    """Limits, V, below which a battery fell in the log, by name: "low" and "critical", with the battery's name before
    it if there are several."""
    axes: Mapping[str, AxisHistory | None]
    """Angle and rate by axis; None if no attitude was recorded."""
    wind: WindHistory | None
    """The wind; None if it is not known, or was estimated in another boot."""
    modes: tuple[ModeInterval, ...]
    """Flight modes in the order of time."""
    events: tuple[Event, ...]
    """What happened in the shown boots, or in a boot that is not known, in the order of boot and time."""
    position: TimeSeries | None
    """Flown path (N, 3), m north, east and down; by the satellite receiver alone if no other was recorded."""


def time_history(
    signals: Signals,
    settled_segments: Segments,
    wind: WindEvidence,
    events: Facts,
    *,
    has_all_flights: bool = False,
) -> TimeHistory | None:
    """Returns the signals of the analysed boot over time, or of all flights, for the charts of a page.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        settled_segments: segments of settled flight. The boot is the first one's or, without any segment, the boot
            with the most samples of the attitude.
        wind: evidence of the wind.
        events: events in the order of boot and time.
        has_all_flights: whether the flights of other boots are shown too, before and after this boot. The wind and the
            flown path, whose origin changes with a restart, are of this boot alone.

    Returns:
        The time history; None if the boot has less than two samples of the attitude.
    """
    segment = _segment_of_flight(signals, settled_segments)
    if segment is None:
        return None
    barometer_height = _barometer_height(signals)
    satellite_height = _satellite_height(signals, barometer_height, events)
    shown_time = one_part(segment)
    position = shown_time.within(signals.position or _path_by_satellites(signals))
    if has_all_flights:
        shown_time = successive_parts(_segments_of_flights(signals, segment), segment.boot)
    shown_events = [shown_time.event(fact) for fact in events]
    return TimeHistory(
        segment=shown_time.segment,
        height=shown_time.within(signals.height),
        barometer_height=shown_time.within(barometer_height),
        satellite_height=shown_time.within(satellite_height),
        motors=_motor_history(signals, shown_time),
        voltages=_battery_voltages(signals, shown_time),
        voltage_limits=_crossed_voltage_limits(signals),
        axes={axis: _axis_history(signals.for_axis(axis), shown_time) for axis in AXES},
        wind=wind_history(wind, segment),
        modes=_mode_intervals(signals, shown_time),
        events=tuple(event for event in shown_events if event is not None),
        position=position,
    )


def _barometer_height(signals: Signals) -> TimeSeries | None:
    """Returns the height by the barometer alone, to be compared with the height that the autopilot estimates.

    A barometer measures height above an arbitrary level. So its height is shifted in each boot, by a constant, to agree
    with the autopilot's before the take-offs (``_barometer_level``).

    Args:
        signals: logged time series of the vehicle, with its height.

    Returns:
        The height (N,), m, averaged over a second; None if no boot has a height and a usable barometer.
    """
    if signals.height is None:
        return None
    heights_by_boot = []
    for boot in np.unique(signals.height.boot).tolist():
        altitude = height_comparison(signals, boot).barometer
        if altitude is None:
            continue
        estimated_height = signals.height.of_boot(boot)
        level = _barometer_level(signals, altitude, estimated_height)
        if level is not None:
            heights_by_boot.append(replace(altitude, values=altitude.values - level))
    return _joined(heights_by_boot)


def _barometer_level(
    signals: Signals, altitude: TimeSeries, estimated_height: TimeSeries
) -> float | None:
    """Returns how much higher a barometer reads than the autopilot's estimate, m, where both should be right.

    Args:
        signals: logged time series of the vehicle, with its flights.
        altitude: by the barometer (N,), m, in one boot.
        estimated_height: by the autopilot (M,), m, in the same boot.

    Returns:
        The difference just before the take-offs of the boot, of several flights the median, since an estimator that has
        just started may be wrong by metres; if nothing flew, the median of the whole boot. None if the barometer was
        not recorded together with the estimate.
    """
    first_time, last_time = estimated_height.time[[0, -1]]
    has_estimate = in_intervals(altitude.time, [(first_time, last_time)])
    if not has_estimate.any():
        return None
    barometer = altitude.select(has_estimate)
    estimate = np.interp(barometer.time, estimated_height.time, estimated_height.values)
    difference = replace(barometer, values=barometer.values - estimate)
    flights = flights_in_boot(signals, int(barometer.boot[0]))
    levels = [initial_difference(difference, take_off) for take_off, _ in flights]
    known_levels = [level for level in levels if level is not None]
    return float(np.median(known_levels or difference.values))


def _satellite_height(
    signals: Signals, barometer_height: TimeSeries | None, events: Facts
) -> TimeSeries | None:
    """Returns the height by satellites where it is of use: in boots in which the height by another sensor is doubtful.

    Satellites measure the height above the sea. To be drawn beside the height by the barometer, it is shifted by a
    constant in each boot, so that both are equal at a take-off. What they differ by later has grown since then. The
    take-off is that of the last flight in the boot with an event on a doubtful height.

    Args:
        signals: logged time series of the vehicle.
        barometer_height: the height by the barometer (N,), m; None without one.
        events: events of all boots, each a fact (a coded finding).

    Returns:
        The height (G,), m, averaged over a second, at the receiver's fixes; None without such an event. If the log has
        no other height, the receiver's own height above its first fix; None without a fix.
    """
    if signals.height is None:
        return _height_above_first_fix(signals)
    # Events are in the order of time, so that the last one of each boot remains.
    last_times_of_doubt = dict[int, float]()
    for event in events:
        if event.code in HEIGHT_DOUBTS:
            last_times_of_doubt[event.figures["boot"]] = event.start_time
    heights_by_boot = []
    for boot, time_of_doubt in last_times_of_doubt.items():
        barometer = series_of_boot(barometer_height, boot)
        if barometer is None:
            continue
        height = _satellite_height_in_boot(signals, barometer, boot, time_of_doubt)
        if height is not None:
            heights_by_boot.append(height)
    return _joined(heights_by_boot)


def _satellite_height_in_boot(
    signals: Signals, barometer: TimeSeries, boot: int, time_of_doubt: float
) -> TimeSeries | None:
    """Returns the height by satellites in one boot, shifted to agree with the barometer at a take-off.

    Args:
        signals: logged time series of the vehicle.
        barometer: the height by the barometer in that boot (N,), m.
        boot: number of the boot.
        time_of_doubt: when the height became doubtful, s since boot. The take-off is the last one before.

    Returns:
        The height (G,), m, at the receiver's fixes; None if it cannot be compared with the barometer.
    """
    # How much higher the barometer reads than satellites, up to a constant.
    difference = height_difference(signals, boot)
    if difference is None:
        return None
    # Minus infinity, if it stays, says that the take-off was not recorded.
    take_off = -np.inf
    for flight_start, _ in flights_in_boot(signals, boot):
        if flight_start <= time_of_doubt:
            take_off = flight_start
    difference_at_take_off = initial_difference(difference, take_off)
    if difference_at_take_off is None:
        return None
    growth_since_take_off = difference.values - difference_at_take_off
    barometer_at_fixes = np.interp(difference.time, barometer.time, barometer.values)
    return replace(difference, values=barometer_at_fixes - growth_since_take_off)


def _height_above_first_fix(signals: Signals) -> TimeSeries | None:
    """Returns the height (G,) of a satellite receiver above its first fix, m; None without a fix."""
    path = _path_by_satellites(signals)
    if path is None:
        return None
    return replace(path, values=-path.values[:, DOWN])


@cached_per_vehicle()
def _path_by_satellites(signals: Signals) -> TimeSeries | None:
    """Returns the path (G, 3) by a satellite receiver alone, m north, east and down of its first fix.

    Links at the usual rates of a ground station may have no other position.

    Args:
        signals: logged time series of the vehicle.

    Returns:
        The path; None if no receiver measured latitude, longitude and altitude.
    """
    fixes = satellite_position(signals)
    if fixes is None:
        return None
    degrees, altitude = np.split(fixes.values, [2], axis=1)
    north_east = plane_positions(degrees, origin=degrees[0])
    down = altitude[0] - altitude
    return replace(fixes, values=np.column_stack([north_east, down]))


def _joined(series_by_boot: Sequence[TimeSeries]) -> TimeSeries | None:
    """Returns the samples of several boots as one series, in the given order; None without any boot."""
    if not series_by_boot:
        return None
    return TimeSeries(
        np.concatenate([series.time for series in series_by_boot]),
        np.concatenate([series.boot for series in series_by_boot]),
        np.concatenate([series.values for series in series_by_boot]),
    )


def _segments_of_flights(signals: Signals, segment: Segment) -> list[Segment]:
    """Returns the part of each boot with a flight, and of the analysed one, in the order of the boots.

    Args:
        signals: logged time series of the vehicle, with at least one attitude.
        segment: part of the boot that was analysed.
    """
    segments = [segment]
    for boot in np.unique(signals.tilts[0].boot).tolist():
        if boot != segment.boot and flights_in_boot(signals, boot):
            other_segment = _segment_of_boot(signals, boot)
            if other_segment is not None:
                segments.append(other_segment)
    return sorted(segments, key=lambda each_segment: each_segment.boot)


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
    if settled_segments:
        boot = int(settled_segments[0].boot)
    else:
        boot = int(np.bincount(signals.tilts[0].boot, minlength=1).argmax())
    return _segment_of_boot(signals, boot)


def _segment_of_boot(signals: Signals, boot: int) -> Segment | None:
    """Returns the part of a boot from shortly before arming to shortly after disarming.

    Args:
        signals: logged time series of the vehicle, with at least one attitude.
        boot: number of the boot, from 0.

    Returns:
        The part, limited to the samples of the attitude; None with less than two of them. Without information on
        arming it is the whole boot.
    """
    tilt = signals.tilts[0]
    time = tilt.time[tilt.boot == boot]
    if len(time) < 2:
        return None
    armed = flight_states.armed_intervals(signals, boot) or [(-np.inf, np.inf)]
    first_arming, _ = armed[0]
    _, last_disarming = armed[-1]
    start = max(time[0], first_arming - SECONDS_AROUND_FLIGHT)
    end = min(time[-1], last_disarming + SECONDS_AROUND_FLIGHT)
    return Segment(boot, start, end)


def _motor_history(signals: Signals, shown_time: ShownTime) -> MotorHistory | None:
    """Returns the outputs of the motors in the shown time, in percent of their range.

    The deviations from the mean of all motors show the commands about the axes, without the common thrust.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        shown_time: the time that is shown.

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
        motors.geometry.names, shown_time.within(outputs), shown_time.within(deviations)
    )


def _battery_voltages(signals: Signals, shown_time: ShownTime) -> dict[str, TimeSeries | None]:
    """Collects the voltages of the batteries in the shown time.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        shown_time: the time that is shown.

    Returns:
        Voltage, V, by the battery's name, "battery" if there is only one; None if it was not recorded then.
    """
    batteries = signals.batteries
    if len(batteries) == 1:
        return {"battery": shown_time.within(batteries[0].voltage)}
    return {
        battery_name(battery.number): shown_time.within(battery.voltage) for battery in batteries
    }


def _crossed_voltage_limits(signals: Signals) -> dict[str, float]:
    """Returns the limits, V, below which the batteries of a vehicle fell, which charts show beside the voltages.

    A limit that was never reached is left out: it would only compress the voltages above it.

    Args:
        signals: logged time series of the vehicle, with its batteries and parameters.

    Returns:
        The limits by names such as "low", or "battery 2 low" if there are several batteries.
    """
    parameters = signals.telemetry.parameters
    limits_by_name = {}
    for battery in signals.batteries:
        if not is_measured(parameters, battery):
            continue
        cells = cell_count(parameters, battery) or 0
        limits = voltage_levels(parameters, battery.number, cells)
        prefix = f"{battery_name(battery.number)} " if len(signals.batteries) > 1 else ""
        lowest_voltage = battery.voltage.values.min()
        for name, limit in (("low", limits.watch), ("critical", limits.bad)):
            if lowest_voltage < limit:
                limits_by_name[f"{prefix}{name}"] = limit
    return limits_by_name


def _axis_history(signals: Signals, shown_time: ShownTime) -> AxisHistory | None:
    """Returns angle and rate of one axis in the shown time, with their setpoints.

    Args:
        signals: signals of the vehicle, for this axis.
        shown_time: the time that is shown.

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
        _followed_setpoint(attitude.angle_series, signals.angle_setpoint, "rad", shown_time),
        _followed_setpoint(rate, rate_setpoint, rate_unit, shown_time),
    )


def _followed_setpoint(
    signal: TimeSeries, setpoint: TimeSeries | None, unit: str, shown_time: ShownTime
) -> FollowedSetpoint | None:
    """Returns a signal in the shown time, with its setpoint at the same times.

    A setpoint applies until the next one, so that the latest one at each sample of the signal is used.

    Args:
        signal: measured quantity.
        setpoint: commanded quantity; None if it was not recorded.
        unit: unit of both.
        shown_time: the time that is shown.

    Returns:
        The signal with its setpoint, None if that was not recorded in the shown time. The result is None with less than
        two samples of the signal there.
    """
    measured_signal = shown_time.within(signal)
    if measured_signal is None:
        return None
    latest_setpoint = None
    if setpoint is not None:
        recorded_setpoint = Setpoint(name="", unit=unit, message="", signal=setpoint)
        setpoint_at_samples = shown_time.setpoint_at_samples(recorded_setpoint, signal)
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
    shown_time = one_part(segment)
    return WindHistory(wind, shown_time.within(speed), shown_time.within(direction))


def _mode_intervals(signals: Signals, shown_time: ShownTime) -> tuple[ModeInterval, ...]:
    """Lists the flight modes in the shown time, each from its change to the next.

    The mode in which a part begins may have been set before it, so that intervals are cut at the ends of each part.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        shown_time: the time that is shown.

    Returns:
        The modes in time order, with start and end of each.
    """
    modes = []
    for part in shown_time.parts:
        segment = part.segment
        changes = signals.mode_changes(segment.boot)
        # A mode ends at the next change, and the last one at the end of the part.
        end_times = [next_change.time for next_change in changes[1:]] + [segment.end]
        for change, end_time in zip(changes, end_times, strict=False):
            start = max(change.time, segment.start)
            end = min(end_time, segment.end)
            if start < end:
                modes.append(ModeInterval(change.mode, start + part.shift, end + part.shift))
    return tuple(modes)
