"""Wind velocity of a recorded flight: which messages it is estimated from, and which parts of the flight count."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.confidence import IntervalEstimate
from mavdem.dataset import flight_states, intervals, phases
from mavdem.dataset.attitude import Attitude, attitude_from_messages
from mavdem.dataset.attitude_error import attitude_error
from mavdem.dataset.axes import AXES, HORIZONTAL, NORTH, YAW
from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.position_fix import (
    RECEIVER_MESSAGES,
    has_fix_by_row,
    has_receiver,
    measures_velocity,
    most_satellites,
)
from mavdem.dataset.signals import Signals
from mavdem.dataset.steady_flight import MAX_SETPOINT_ERROR
from mavdem.dataset.time_series import (
    TimeSeries,
    recorded_series,
    series_of_boot,
)
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.lights import Unjudged
from mavdem.facts.online import DragSource
from mavdem.facts.wind import NoWind
from mavdem.files import AnyPath
from mavdem.ingest import read_log
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.ingest.telemetry import Telemetry, interpolated
from mavdem.wind_velocity.estimate_resets import YAW_RESET, estimate_resets, motion_resets
from mavdem.wind_velocity.estimation import estimate_wind
from mavdem.wind_velocity.ground_lean import with_lean_on_ground
from mavdem.wind_velocity.ground_motion import (
    HEIGHT,
    MAX_VELOCITY_GAP,
    VELOCITY,
    recorded_ground_motion,
    velocity_interval,
)
from mavdem.wind_velocity.mean_wind import INDEPENDENT_SECONDS
from mavdem.wind_velocity.motion_grid import MAX_FLIGHT_SECONDS, MIN_SAMPLES
from mavdem.wind_velocity.vehicle_drag import Drag, drag_model_setting
from mavdem.wind_velocity.velocity import WindVelocity

ESTIMATOR_FLAG_MESSAGES = ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS")
"""Messages with flags of the autopilot's state estimator."""

VELOCITY_VALID_FLAG = mavlink_constant("ESTIMATOR_VELOCITY_HORIZ")
"""Flag of the estimator: the horizontal velocity is known."""

STANDSTILL_ASSUMED = mavlink_constant("ESTIMATOR_CONST_POS_MODE")
"""Flag of the estimator: it has no position source, and assumes that the vehicle stands still."""

MIN_FLIGHT_HEIGHT = 1.5
"""Height above the lowest one, m, from which on the vehicle flies, if neither motors nor landed state are known."""

MAX_GROUND_SPEED = 70.0
"""Horizontal speed, m/s, that no multirotor that is analysed here flies: beyond it the estimate has run away."""

MAX_WIND_SPEED = 40.0
"""Wind speed, m/s, in which no multirotor holds its attitude: beyond it, velocity or attitude are wrong.

A hurricane begins at 33 m/s; the largest wind that makers allow multirotors is 23 m/s.
"""

MAX_SETTING_RATIO = 4.0
"""Largest ratio of the ends of the 90 % interval of a drag parameter that is to be set.

A choice: the flight then shows it within a factor of about two either way.
"""

STUCK_LEAN = np.radians(25.0)
"""Lean, rad, from which on a vehicle that does not move is stuck: a free one leans so far against a storm only."""

STUCK_DISTANCE = 0.1
"""Distance within a second, m, below which the vehicle does not move."""

STUCK_SECONDS = 5.0
"""Time for which a vehicle leans and does not move, s, from which on it is stuck.

A simulated one that holds its position in steady wind does not move for 1.3 s at most.
"""


class WindEvidence(NamedTuple):
    """What a log shows of the wind in m/s."""

    estimate: WindVelocity | None
    """The wind estimated from attitude and velocity; ``None`` if it cannot be."""

    autopilot_estimate: TimeSeries | None
    """The autopilot's own estimate, north and east in m/s; ``None`` if it was not logged."""

    reason: Fact | None
    """Why there is no estimate; ``None`` if there is one."""

    drag_model_setting: str = ""
    """Setting with which the autopilot would estimate the wind itself; empty if it has none."""

    zero_estimate: str = ""
    """Message with the autopilot's own estimate, such as WIND, if that is always 0; otherwise empty."""


UNKNOWN_WIND = WindEvidence(None, None, None)
"""The evidence before the wind is estimated."""


class _FlightMotion(NamedTuple):
    """Motion in the free flight of one boot, at N stamps of the attitude."""

    boot: int
    """Number of the boot; a boot lasts from one start of the autopilot to the next."""

    time: Array
    """Stamps (N,), s on the boot's clock."""

    attitude: Array
    """Roll, pitch and yaw (N, 3), rad."""

    velocity: Array
    """Velocity over ground, north, east and down (N, 3), m/s."""

    height: Array
    """Height (N,), m."""

    left_out: intervals.Intervals
    """Parts of the settled flight, s, that are left out because the attitude did not follow its setpoint."""


def wind(path: AnyPath, vehicle: str | None = None, drag: Drag | None = None) -> WindVelocity:
    """Estimates the wind of a log's longest flight, from attitude and velocity over ground at 1 Hz and faster.

    Args:
        path: a log that ``mavdem.ingest.read_log`` reads.
        vehicle: "system" or "system:component", if the log contains several vehicles.
        drag: drag of the vehicle; None for the autopilot's coefficients if they were set, and otherwise for the mean of
            a population of vehicles.

    Returns:
        The wind velocity, with its bands and gusts.

    Raises:
        Unreadable: the log cannot be read.
        NotLearnable: the log has no vehicle, no velocity, no yaw, no flight, or only a flight that was not free.
    """
    log = read_log(path)
    telemetry = choose_vehicle(log.vehicles, vehicle)
    return wind_of_signals(Signals(telemetry), drag)


def wind_evidence(signals: Signals) -> WindEvidence:
    """Returns the estimates of the wind in the log of a vehicle, by this library and by the autopilot.

    Only a multirotor leans against the wind; for another vehicle there is only the autopilot's own estimate.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        The estimates of this library and of the autopilot, and the reason if this library has none. For a multirotor,
        the estimate of the autopilot is left out too then, since there is none to compare it with.
    """
    telemetry = signals.telemetry
    vehicle_type = telemetry.vehicle
    setting = drag_model_setting(telemetry.autopilot, telemetry.parameters)
    if vehicle_type not in POSSIBLE_MULTIROTORS:
        reason = Fact(Unjudged.MULTIROTORS_ONLY, kind=vehicle_type)
        return WindEvidence(None, signals.autopilot_wind, reason, setting)
    try:
        return WindEvidence(
            wind_of_signals(signals),
            signals.autopilot_wind,
            None,
            setting,
            signals.zero_wind_message,
        )
    except NotLearnable as error:
        return WindEvidence(None, None, error.fact, setting)


def wind_of_signals(signals: Signals, drag: Drag | None = None) -> WindVelocity:
    """Estimates the wind from the messages of a vehicle, in the boot that has the longest free flight.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        drag: drag of the vehicle, as for :func:`wind`.

    Returns:
        The wind, with the number of its boot.

    Raises:
        NotLearnable: velocity, attitude or flight are missing, the vehicle is held, or its clock jumps.
    """
    telemetry = signals.telemetry
    # The attitude is used at its own stamps. In a resampled attitude a reset of the yaw would not be a jump.
    angles = []
    for axis in AXES:
        angle = attitude_from_messages(telemetry, axis)
        if angle is not None:
            angles.append(angle)
    ground_motion = recorded_ground_motion(telemetry)
    if len(angles) < len(AXES) or ground_motion is None:
        # Roll, pitch and yaw come in this order: an angle is missing only together with those after it.
        raise NotLearnable(
            NoWind.NO_VELOCITY,
            missing=AXES[len(angles) :],
            name=telemetry.name_in_source("LOCAL_POSITION_NED"),
            recorder=telemetry.translated_from,
            has_receiver=has_receiver(telemetry),
        )
    _require_position_source(telemetry, ground_motion)
    motion = _longest_free_flight(signals, angles, ground_motion)
    velocity_is_constant = np.ptp(motion.velocity[:, NORTH]) == 0
    if velocity_is_constant and _lacks_fix(telemetry):
        # If another sensor of velocity is configured, it did not measure either.
        raise NotLearnable(NoWind.NO_POSITION_FIX, satellites=most_satellites(telemetry))
    _require_usable(motion, _longest_time_stuck(signals.position, motion))
    if drag is None:
        drag = Drag.from_parameters(telemetry.autopilot, telemetry.parameters)
    times_of_flight = motion.time[0], motion.time[-1]
    roll_and_pitch = angles[:YAW]
    drag = with_lean_on_ground(drag, signals, roll_and_pitch, motion.boot, times_of_flight)
    estimate = estimate_wind(motion.time, motion.attitude, motion.velocity, drag, motion.height)
    if estimate.speed_identifiable and estimate.speed > MAX_WIND_SPEED:
        raise NotLearnable(NoWind.BEYOND_ANY_WIND, speed=MAX_WIND_SPEED)
    return replace(estimate, boot=motion.boot, left_out=tuple(motion.left_out))


def _longest_free_flight(
    signals: Signals, angles: Sequence[Attitude], ground_motion: TimeSeries
) -> _FlightMotion:
    """Returns the motion in the boot of a log that has most samples of free flight.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        angles: roll, pitch and yaw.
        ground_motion: velocity and height, as :func:`recorded_ground_motion` returns them.

    Raises:
        NotLearnable: no boot has enough of it.
    """
    motions = []
    for boot in np.unique(ground_motion.boot).tolist():
        motion_of_boot = _free_flight(signals, angles, ground_motion, boot)
        if motion_of_boot is not None:
            motions.append(motion_of_boot)
    longest = max(motions, key=lambda motion: len(motion.time), default=None)
    if longest is not None and len(longest.time) >= MIN_SAMPLES:
        return longest
    if any(motion.left_out for motion in motions):
        raise NotLearnable(
            NoWind.ATTITUDE_NOT_FOLLOWED, angle=MAX_SETPOINT_ERROR, duration=INDEPENDENT_SECONDS
        )
    raise NotLearnable(
        NoWind.NO_FLIGHT_WITH_VELOCITY,
        airborne=_settled_seconds(signals, ground_motion),
        name=signals.telemetry.name_in_source("LOCAL_POSITION_NED"),
        sampling_interval=velocity_interval(ground_motion),
        interval_limit=MAX_VELOCITY_GAP,
        has_receiver=has_receiver(signals.telemetry),
    )


def _settled_seconds(signals: Signals, ground_motion: TimeSeries) -> float:
    """Returns how long the vehicle was in settled flight, over all boots of the log.

    Times at which velocity or yaw is unknown are included.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        ground_motion: velocity and height, as :func:`recorded_ground_motion` returns them.

    Returns:
        The duration, s.
    """
    duration = 0.0
    for boot in np.unique(ground_motion.boot).tolist():
        motion = ground_motion.of_boot(boot)
        flights = _settled_flights(signals, boot, motion.time, motion.values[:, HEIGHT])
        recorded_intervals = intervals.intersection(flights, [(motion.time[0], motion.time[-1])])
        duration += sum(end - start for start, end in recorded_intervals)
    return float(duration)


def _require_position_source(telemetry: Telemetry, ground_motion: TimeSeries) -> None:
    """Checks that a sensor such as GPS measured velocity or position: otherwise the estimated velocity is arbitrary.

    Args:
        telemetry: messages of the vehicle.
        ground_motion: velocity and height, as :func:`recorded_ground_motion` returns them.

    Raises:
        NotLearnable: no sensor measured at any time at which a velocity was recorded; or the log has no velocity
            because receivers never had a fix. For a log without velocity for another reason nothing is raised, since
            the caller reports that.
    """
    boots = np.unique(ground_motion.boot).tolist()
    for boot in boots:
        if measures_velocity(telemetry, boot, ground_motion.of_boot(boot).time).any():
            return
    has_velocity = bool(boots)
    if has_velocity or _lacks_fix(telemetry):
        raise NotLearnable(NoWind.NO_POSITION_FIX, satellites=most_satellites(telemetry))


def _lacks_fix(telemetry: Telemetry) -> bool:
    """Returns whether a log has satellite receivers that never had a position fix.

    Args:
        telemetry: messages of the vehicle.

    Returns:
        True only if there is a receiver, and none ever had a fix.
    """
    if not has_receiver(telemetry):
        return False
    for message in RECEIVER_MESSAGES:
        columns = telemetry.messages.get(message, {})
        if len(columns.get("fix_type", ())) and has_fix_by_row(columns).any():
            return False
    return True


def _require_usable(motion: _FlightMotion, stuck_seconds: float) -> None:
    """Checks that the vehicle was free, its clock did not jump, and yaw and velocity were measured.

    Args:
        motion: attitude, velocity over ground and specific force of the flight.
        stuck_seconds: longest time for which the vehicle was stuck, s.

    Raises:
        NotLearnable: one of these conditions fails.
    """
    if stuck_seconds >= STUCK_SECONDS:
        raise NotLearnable(NoWind.STUCK, duration=stuck_seconds, lean=STUCK_LEAN)
    if np.ptp(motion.time) > MAX_FLIGHT_SECONDS:
        raise NotLearnable(NoWind.CLOCK_JUMPS)
    # A value that never changes was not measured.
    is_yaw_constant = np.ptp(motion.attitude[:, YAW]) == 0
    if is_yaw_constant:
        raise NotLearnable(NoWind.NOT_MEASURED, name="yaw")
    is_velocity_constant = np.ptp(motion.velocity[:, NORTH]) == 0
    if is_velocity_constant:
        raise NotLearnable(NoWind.NOT_MEASURED, name="velocity")


def _free_flight(
    signals: Signals, angles: Sequence[Attitude], ground_motion: TimeSeries, boot: int
) -> _FlightMotion | None:
    """Returns the motion in the flight of one boot, as far as the estimator determined it, at the stamps of the yaw.

    Left out are gaps of the velocity, resets of velocity or position, everything before the last reset of the yaw in
    flight, times at which the estimator's flags mark the velocity as invalid, and times at which the attitude does not
    follow its setpoint.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        angles: roll, pitch and yaw.
        ground_motion: velocity and height, as :func:`recorded_ground_motion` returns them.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The motion; ``None`` if the boot has no attitude or velocity.
    """
    motion_in_boot = ground_motion.of_boot(boot)
    velocity_time, ground_values = motion_in_boot.time, motion_in_boot.values
    angles_of_boot = [angle.angle_series.of_boot(boot) for angle in angles]
    if len(velocity_time) < 2 or not all(len(angle.time) for angle in angles_of_boot):
        return None
    # The times are the heading's; roll and pitch are interpolated.
    time = angles_of_boot[YAW].time
    attitude = [np.interp(time, angle.time, angle.values) for angle in angles_of_boot]
    yaw = attitude[YAW]

    flights = _settled_flights(signals, boot, velocity_time, ground_values[:, HEIGHT])
    motion = interpolated(time, velocity_time, ground_values[:, : HEIGHT + 1])
    ground_speed = np.linalg.norm(motion[:, HORIZONTAL], axis=1)
    is_usable = (
        intervals.in_intervals(time, flights)
        & _is_between_velocities(time, velocity_time)
        & ~_is_near_motion_reset(time, motion_in_boot)
        & (time > _last_yaw_reset(time, yaw, flights) + MAX_VELOCITY_GAP)
        & _has_valid_velocity(signals.telemetry, boot, time)
        & measures_velocity(signals.telemetry, boot, time)
        & (ground_speed <= MAX_GROUND_SPEED)
    )
    lost_control = intervals.intersection(flights, _intervals_of_lost_control(signals, boot))
    is_lost = intervals.in_intervals(time, lost_control)
    # A loss of control during which nothing else was usable is not reported as left out.
    left_out = lost_control if (is_usable & is_lost).any() else []
    is_usable &= ~is_lost
    return _FlightMotion(
        boot,
        time=time[is_usable],
        attitude=np.column_stack(attitude)[is_usable],
        velocity=motion[is_usable, VELOCITY],
        height=motion[is_usable, HEIGHT],
        left_out=left_out,
    )


def _is_between_velocities(time: Array, velocity_time: Array) -> Flags:
    """Returns at which times there is a velocity before and after, at most ``MAX_VELOCITY_GAP`` apart.

    Args:
        time: (N,) times, s.
        velocity_time: (T,) stamps of the velocities, s, ascending; at least two.

    Returns:
        (N,) flags.
    """
    is_within_record = (time >= velocity_time[0]) & (time <= velocity_time[-1])
    # Row of the first velocity after each time. Outside the record it is limited to a row that has one before it.
    row_after = np.clip(np.searchsorted(velocity_time, time), 1, len(velocity_time) - 1)
    gap = velocity_time[row_after] - velocity_time[row_after - 1]
    return is_within_record & (gap <= MAX_VELOCITY_GAP)


def _is_near_motion_reset(time: Array, ground_motion: TimeSeries) -> Flags:
    """Returns at which times the estimator reset velocity or position ``MAX_VELOCITY_GAP`` before or after at most.

    Args:
        time: (N,) times, s.
        ground_motion: velocity and height of one boot.

    Returns:
        (N,) flags.
    """
    has_reset_since_last = motion_resets(ground_motion.time, ground_motion.values)
    around_resets = []
    for reset_time in ground_motion.time[1:][has_reset_since_last]:
        around_resets.append((reset_time - MAX_VELOCITY_GAP, reset_time + MAX_VELOCITY_GAP))
    return intervals.in_intervals(time, around_resets)


def _last_yaw_reset(time: Array, yaw: Array, flights: intervals.Intervals) -> float:
    """Returns the time, s, of the last reset of the yaw before the end of the last flight; minus infinity without one.

    After that flight, a jump of the yaw is a fall or a spin.

    Args:
        time: (N,) stamps of the yaw, s.
        yaw: (N,) heading, rad.
        flights: start and end of each flight, s.
    """
    is_reset = estimate_resets(time, yaw, YAW_RESET, period=2 * np.pi)
    end_of_flights = np.max(flights, initial=0)
    is_reset &= time[1:] < end_of_flights
    return float(np.max(time[1:][is_reset], initial=-np.inf))


def _intervals_of_lost_control(signals: Signals, boot: int) -> intervals.Intervals:
    """Returns when roll or pitch did not follow its setpoint, with a margin of ``INDEPENDENT_SECONDS`` on both sides.

    In a loss of control the vehicle's lean and acceleration do not show the wind, and would count as a gust. The wind
    of a moment is estimated from the motion around it, which the margin allows for.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        Intervals, s since boot; none if the setpoint was not recorded.
    """
    error = attitude_error(signals, boot)
    if error is None:
        return []
    is_lost = error.has_setpoint & (error.magnitude > MAX_SETPOINT_ERROR)
    # Intervals whose margins would overlap are merged.
    lost_intervals = intervals.merge_close_intervals(
        intervals.true_intervals(error.time, is_lost), gap=2 * INDEPENDENT_SECONDS
    )
    return [
        (start - INDEPENDENT_SECONDS, end + INDEPENDENT_SECONDS) for start, end in lost_intervals
    ]


def _has_valid_velocity(telemetry: Telemetry, boot: int, time: Array) -> Flags:
    """Returns at which times the autopilot's state estimator has a valid horizontal velocity.

    Without a position source, an estimator reports a meaningless velocity, and marks it as invalid by its flags. If a
    log has no flags, the velocity counts as valid.

    Args:
        telemetry: messages of the vehicle.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        time: (N,) times in that boot, s.

    Returns:
        (N,) flags; also false between two messages if one of them marks the velocity as invalid.
    """
    is_known = np.ones(len(time), np.bool_)
    for name in ESTIMATOR_FLAG_MESSAGES:
        flags = series_of_boot(recorded_series(telemetry, name, "flags"), boot)
        if flags is None:
            continue
        valid = horizontal_velocity_valid(flags.values.astype(np.int64))
        # Between two messages that differ, the interpolated value is neither 0 nor 1.
        unknown = np.interp(time, flags.time, ~valid)
        is_known &= unknown == 0
    return is_known


def estimator_message(autopilot: str) -> str:
    """Returns the name of the message with which an autopilot reports how its state estimator does.

    Args:
        autopilot: name of the MAV_AUTOPILOT, such as "PX4".
    """
    return "ESTIMATOR_STATUS" if autopilot == "PX4" else "EKF_STATUS_REPORT"


def horizontal_velocity_valid(flags: Any) -> Any:
    """Returns whether the flags of an estimator, integers of any shape, state that its velocity is valid.

    It must not assume a standstill.
    """
    return flags & (VELOCITY_VALID_FLAG | STANDSTILL_ASSUMED) == VELOCITY_VALID_FLAG


def _longest_time_stuck(position: TimeSeries | None, motion: _FlightMotion) -> float:
    """Returns the longest time for which the vehicle leaned far and did not move.

    A free vehicle that leans far accelerates. If it does not, something holds it, so that its lean does not show the
    wind.

    Args:
        position: (N, k) position of the vehicle, m; None if it is not known, and then 0 is returned.
        motion: motion in the flight of one boot.

    Returns:
        Longest time, s, in which the lean was at least ``STUCK_LEAN``, and the position moved by less than
        ``STUCK_DISTANCE`` in each second.
    """
    position_in_boot = series_of_boot(position, motion.boot)
    if position_in_boot is None:
        return 0.0
    # How far the vehicle moved along each coordinate in the second before each sample of the motion.
    movements = []
    for coordinate in position_in_boot.values.T:
        coordinate_now = np.interp(motion.time, position_in_boot.time, coordinate)
        coordinate_before = np.interp(motion.time - 1.0, position_in_boot.time, coordinate)
        movements.append(coordinate_now - coordinate_before)
    distance = np.linalg.norm(movements, axis=0)
    roll, pitch, _ = motion.attitude.T
    lean = np.arccos(np.cos(roll) * np.cos(pitch))
    is_stuck = (lean >= STUCK_LEAN) & (distance < STUCK_DISTANCE)
    return intervals.longest_true_duration(motion.time, is_stuck)


def _settled_flights(
    signals: Signals, boot: int, time: Array, height: Array
) -> intervals.Intervals:
    """Returns the intervals of settled flight in a boot.

    If neither motors nor landed state were recorded, the vehicle counts as flying while it is armed and more than
    ``MIN_FLIGHT_HEIGHT`` above its lowest height.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        time: stamps of the heights (N,), s.
        height: (N,) m.

    Returns:
        Intervals, s since boot, without take-off and landing.
    """
    if signals.collective is not None or signals.landed_state is not None:
        return phases.settled_intervals(signals, boot)
    min_height = np.nanmin(height) + MIN_FLIGHT_HEIGHT
    armed = flight_states.armed_intervals(signals, boot)
    above_ground = intervals.true_intervals(time, height > min_height)
    flights = []
    for candidate in intervals.intersection(armed, above_ground):
        flight = phases.without_transients(candidate, None)
        if flight is not None:
            flights.append(flight)
    return flights


def is_certain_setting(value: IntervalEstimate) -> bool:
    """Returns whether the interval of a parameter of the drag model is narrow enough to set it (MAX_SETTING_RATIO)."""
    return value.high <= MAX_SETTING_RATIO * value.low


def drag_settings(drag: Drag, telemetry: Telemetry) -> dict[str, IntervalEstimate]:
    """Returns the parameters of the autopilot's own drag model that should be set to make its wind estimate better.

    A parameter is left out if its interval is so wide that the autopilot's own value may be as good, and if a DataFlash
    log, which has all parameters of the firmware, does not contain it. No parameter is returned if the drag was not
    estimated from a flight of this vehicle, but is that of its own parameters or of the population of vehicles.

    Args:
        drag: linear and quadratic drag of the vehicle, with their uncertainty.
        telemetry: log of the vehicle, with its autopilot and parameters.

    Returns:
        Value with its 90 % interval by name of the parameter; empty if none should be set.
    """
    if drag.source in (DragSource.POPULATION, DragSource.PARAMETERS):
        return {}
    has_all_parameters = telemetry.translated_from == "DataFlash"
    settings = {}
    for name, value in drag.autopilot_parameters(telemetry.autopilot).items():
        may_be_in_firmware = name in telemetry.parameters or not has_all_parameters
        if is_certain_setting(value) and may_be_in_firmware:
            settings[name] = value
    return settings
