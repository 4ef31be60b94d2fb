"""Height estimates that diverge in flight, as facts (coded findings): they sink while the barometer rises, or rise.

In an automatic height mode the autopilot follows its estimate: one that falls makes the vehicle climb at full throttle,
whatever the stick asks for. The cause is the accelerometer, whose error the estimator integrates: a wrong scale or
offset, which it has at rest too, or vibration that it rectifies.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mavdem.assessment.intended_landing import CLIMB_STICK
from mavdem.assessment.lights.vibration import vibration_limits
from mavdem.dataset.attitude import down_in_body
from mavdem.dataset.flight_states import MANUAL_THROTTLE_MODES, mode_intervals
from mavdem.dataset.intervals import Intervals, TimeInterval, complement, in_intervals, intersection
from mavdem.dataset.time_series import series_of_boot
from mavdem.facts import Fact
from mavdem.facts.ending import MotionEvent
from mavdem.facts.witnesses import SensorFact
from mavdem.physical_constants import GRAVITY
from mavdem.vibration.vibration_message import (
    most_clips,
    reported_clips,
    reported_vibration,
)
from mavdem.witnesses.accelerometer import AccelerometerRecord
from mavdem.witnesses.boot_sensors import MAX_FALL_SPEED, BootSensors
from mavdem.witnesses.height import MIN_CONTRADICTION_SECONDS
from mavdem.witnesses.sensor_facts import checked_event, supporting_fact

MIN_TRUE_CLIMB = 1.0
"""Speed, m/s up or down, by the barometer, from which on the vehicle itself moves."""

MIN_FALSE_CLIMB = 0.5
"""Speed, m/s, of the estimate in the other direction."""

SINK_STICK = 0.35
"""Travel of the throttle stick below which the pilot commands a descent: as far below the middle as ``CLIMB_STICK`` is
above."""

MAX_FORCE_ERROR = 0.4
"""Deviation, m/s², of the mean upward force in flight from gravity and the barometer's acceleration, that condemns the
accelerometer. It is 0.04 in sound flights and 0.5 to 3.4 in those whose height ran away."""

MIN_REST_FRACTION = 0.5
"""Fraction of the accelerometer's error in flight from which on the error at rest explains it; a choice."""

CONTEXT_SECONDS = 5.0
"""Seconds before the divergence over which the accelerometer is averaged too: its error is integrated first."""

FULL_THROTTLE_COMMAND = 0.9
"""Largest command of all motors, as a fraction of the range, from which on they work at full throttle; a choice."""


def height_divergences(sensors: BootSensors, flight_interval: TimeInterval) -> Iterator[Fact]:
    """Yields an event for each interval of a flight in which the height estimate diverged in an automatic height mode.

    In modes in which the pilot sets the throttle the autopilot does not control the height, so that a wrong estimate
    does no harm.

    Args:
        sensors: sensors of the boot. Their ``height.contradictions`` are the intervals in which barometer and estimate
            differ.
        flight_interval: start and end of the flight, s since boot.

    Yields:
        Events of the intervals in which the estimate diverged; other contradictions have other causes.
    """
    manual = mode_intervals(sensors.signals, sensors.boot, MANUAL_THROTTLE_MODES)
    automatic = intersection([flight_interval], complement(manual))
    for interval in _lasting_intervals(intersection(sensors.height.contradictions, automatic)):
        event = _divergence(sensors, interval)
        if event is not None:
            yield event


def _lasting_intervals(intervals: Intervals) -> Intervals:
    """Returns the intervals of at least half of ``MIN_CONTRADICTION_SECONDS``: a mode may begin or end within one."""
    min_seconds = MIN_CONTRADICTION_SECONDS / 2
    return [(start, end) for start, end in intervals if end - start >= min_seconds]


def _divergence(sensors: BootSensors, interval: TimeInterval) -> Fact | None:
    """Returns the divergence of the height in an interval in which barometer and estimate contradict each other.

    The height has diverged only if the barometer and the estimate move in opposite directions, and the pilot's stick
    does not command the motion that the barometer shows. The probable cause is an error of the accelerometer or, if
    there is none, vibration.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        interval: start and end, s since boot.

    Returns:
        An event with the mean climb by the estimate as ``climb_rate`` (None beyond ``MAX_FALL_SPEED``) and by the
        barometer as ``speed``, m/s upward, its ``cause``, and what sensors show as ``witnesses``; None if the height
        did not diverge.
    """
    climb = _opposite_climb_rates(sensors, interval)
    if climb is None:
        return None
    is_rising = climb.barometer > 0
    start, end = interval
    sensor_facts = [_motion_by_barometer(sensors, interval, climb.barometer)]
    travel = _median_stick_travel(sensors, interval)
    if travel is not None:
        asks_for_climb = is_rising and travel > CLIMB_STICK
        asks_for_descent = not is_rising and travel < SINK_STICK
        if asks_for_climb or asks_for_descent:
            return None
        sensor_facts.append(
            supporting_fact(SensorFact.THROTTLE_NOT_RAISED, time=start, end_time=end, share=travel)
        )
    cause = _accelerometer_error(sensors, interval) or _vibration_fact(sensors, interval)
    if cause is not None:
        sensor_fact = cause
        if cause.figures.get("part") == "in flight":
            # This error is measured over the time around the divergence.
            sensor_fact = cause.replace(time=start - CONTEXT_SECONDS, end_time=end)
        sensor_facts.append(sensor_fact)
    full_throttle = _full_throttle(sensors, interval)
    # If a vehicle sinks at full throttle, it lacks thrust, and the throttle is not evidence for a diverged estimate.
    if full_throttle is not None and is_rising:
        sensor_facts.append(full_throttle)
    event = Fact(
        MotionEvent.HEIGHT_DIVERGED,
        time=start,
        end_time=end,
        # A diverged estimate may contain a speed that no vehicle reaches, which is not reported.
        climb_rate=climb.estimate if abs(climb.estimate) <= MAX_FALL_SPEED else None,
        speed=climb.barometer,
        cause=cause,
        boot=sensors.boot,
    )
    return checked_event(event, sensor_facts)


def _motion_by_barometer(sensors: BootSensors, interval: TimeInterval, climb_rate: float) -> Fact:
    """Returns the fact that the vehicle rose or sank in an interval by its barometer.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        interval: start and end, s since boot.
        climb_rate: mean speed upward by the barometer, m/s.
    """
    start, end = interval
    if climb_rate > 0:
        height_change = sensors.height.barometer_change(*interval)
        motion = supporting_fact(SensorFact.ROSE, source="barometer", height=height_change)
    else:
        motion = supporting_fact(SensorFact.SANK, source="barometer", speed=-climb_rate)
    return motion.replace(time=start, end_time=end)


class _ClimbRates(NamedTuple):
    """Mean speeds upward in an interval, by two sources."""

    barometer: float
    """Of the vehicle itself, by the barometer, m/s."""
    estimate: float
    """By the estimator, m/s."""


def _opposite_climb_rates(sensors: BootSensors, interval: TimeInterval) -> _ClimbRates | None:
    """Returns the mean climb rates of an interval if barometer and estimate clearly move in opposite directions.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        interval: start and end, s since boot.

    Returns:
        Both rates, m/s upward: the barometer's, taken as true, and the estimate's. None if they are not opposite, or
        one has no samples in the interval.
    """
    barometer = sensors.height.barometer_climb
    estimate = sensors.height.estimated_climb
    assert barometer is not None and estimate is not None
    barometer_rates = barometer.within(interval).values
    estimated_rates = estimate.within(interval).values
    if not len(barometer_rates) or not len(estimated_rates):
        return None
    true_climb = float(barometer_rates.mean())
    false_climb = float(estimated_rates.mean())
    is_opposite = np.sign(true_climb) != np.sign(false_climb)
    is_clear = abs(true_climb) > MIN_TRUE_CLIMB and abs(false_climb) > MIN_FALSE_CLIMB
    if not (is_opposite and is_clear):
        return None
    return _ClimbRates(true_climb, false_climb)


def _median_stick_travel(sensors: BootSensors, interval: TimeInterval) -> float | None:
    """Returns the median travel of the throttle stick in an interval, 0 to 1; None if it was not recorded there."""
    stick = sensors.stick
    if stick is None:
        return None
    travel = stick.values[in_intervals(stick.time, [interval])]
    return float(np.median(travel)) if len(travel) else None


def _accelerometer_error(sensors: BootSensors, interval: TimeInterval) -> Fact | None:
    """Returns the fact that the accelerometer measured a wrong specific force, which makes a height estimate diverge.

    The accelerometer may be wrong in two ways. A wrong scale or offset shows at rest too: then it does not measure
    gravity there. An error that vibration causes shows in flight only. The fact states the error at rest if that is
    wrong and explains at least ``MIN_REST_FRACTION`` of the error in flight, or if the error in flight is not known.
    Otherwise it states the error in flight.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        interval: start and end of the divergence, s since boot.

    Returns:
        The fact. Its figure ``acceleration``, m/s², is the specific force at rest or, for an error in flight, the force
        that the accelerometer would measure at rest with this error: gravity plus the error. None if the accelerometer
        is right, or was not recorded.
    """
    accelerometer = sensors.accelerometer
    if accelerometer is None:
        return None
    flight_error = _force_error(sensors, accelerometer, interval)
    force_at_rest = accelerometer.gravity_at_rest
    is_wrong_at_rest = accelerometer.is_sound is False
    is_wrong_in_flight = flight_error is not None and abs(flight_error) > MAX_FORCE_ERROR
    if force_at_rest is not None and is_wrong_at_rest:
        error_at_rest_is_cause = flight_error is None
        if flight_error is not None and is_wrong_in_flight:
            # The fraction is negative if the errors have opposite signs: the error at rest then explains nothing.
            explained_fraction = (force_at_rest - GRAVITY) / flight_error
            error_at_rest_is_cause = explained_fraction >= MIN_REST_FRACTION
        if error_at_rest_is_cause:
            return supporting_fact(
                SensorFact.GRAVITY_WRONG, part="at rest", acceleration=force_at_rest
            )
    if flight_error is None or not is_wrong_in_flight:
        return None
    # The measured force contains the acceleration of the vehicle, so that it is not stated itself. Gravity plus the
    # error can be compared with the force at rest, which is the figure ``gravity``.
    return supporting_fact(
        SensorFact.GRAVITY_WRONG,
        part="in flight",
        acceleration=GRAVITY + flight_error,
        gravity=force_at_rest,
    )


def _force_error(
    sensors: BootSensors, accelerometer: AccelerometerRecord, interval: TimeInterval
) -> float | None:
    """Returns the error of the mean upward specific force that the accelerometer measured around a divergence.

    A sound accelerometer measures gravity plus the mean vertical acceleration, which follows from the barometer's climb
    rates at both ends.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        accelerometer: accelerometer of the boot.
        interval: interval of the divergence, s since boot.

    Returns:
        The error, m/s²; None if barometer or attitude are not known, or there are no samples.
    """
    climb = sensors.height.barometer_climb
    divergence_start, end = interval
    start = divergence_start - CONTEXT_SECONDS
    is_inside = in_intervals(accelerometer.time, [(start, end)])
    time = accelerometer.time[is_inside]
    angles = []
    for tilt in sensors.signals.tilts:
        angle = series_of_boot(tilt.angle_series, sensors.boot)
        if angle is not None:
            angles.append(np.interp(time, angle.time, angle.values))
    if len(angles) < 2 or not len(time) or climb is None:
        return None
    roll, pitch = angles
    # The component along gravity is the scalar product of each sample with the direction of gravity in the body.
    downward_force = np.sum(accelerometer.force[is_inside] * down_in_body(roll, pitch), axis=1)
    measured_force = float(-downward_force.mean())
    start_climb, end_climb = np.interp([start, end], climb.time, climb.values)
    expected_force = GRAVITY + (end_climb - start_climb) / (end - start)
    return measured_force - expected_force


def _vibration_fact(sensors: BootSensors, interval: TimeInterval) -> Fact | None:
    """Returns the fact that accelerometers clipped or vibrated too much, which explains a diverged height.

    The estimator integrates the accelerometer to the height. Clipping, which means samples out of the range of an
    accelerometer, surely makes its mean wrong. So it is preferred to vibration above the limit, which may do so.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        interval: interval of the divergence, s since boot.

    Returns:
        A fact with the number of clips or the largest vibration, m/s²; None if there was neither, or vibration was not
        recorded.
    """
    clips = series_of_boot(reported_clips(sensors.signals), sensors.boot)
    if clips is None:
        return None
    clip_count = most_clips(clips.within(interval).values)
    if clip_count:
        start, end = interval
        return supporting_fact(SensorFact.CLIPPED, time=start, end_time=end, count=clip_count)
    vibration = reported_vibration(sensors.signals)
    if vibration is None:
        return None
    levels = vibration.levels.of_boot(sensors.boot).within(interval)
    if not len(levels.time):
        return None
    # The level of the most shaken axis in each sample.
    highest_levels = levels.values.max(axis=1)
    worst_sample = highest_levels.argmax()
    worst_level = float(highest_levels[worst_sample])
    if worst_level <= vibration_limits(sensors.signals.telemetry).bad:
        return None
    worst_time = float(levels.time[worst_sample])
    return supporting_fact(SensorFact.VIBRATED, time=worst_time, vibration=worst_level)


def _full_throttle(sensors: BootSensors, interval: TimeInterval) -> Fact | None:
    """Returns the fact that a motor worked near its upper limit while the height estimate diverged.

    A controller that follows an estimate that sinks, although the vehicle rises, opens the throttle more and more.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        interval: interval of the divergence, s since boot.

    Returns:
        A fact with the largest command of all motors, as a fraction of their range, in its figure ``share``; None if
        it was at most ``FULL_THROTTLE_COMMAND``, or no outputs were recorded.
    """
    motors = sensors.signals.motors
    if motors is None or sensors.boot not in motors.boot:
        return None
    commands = motors.range_fractions(sensors.boot).within(interval)
    if not len(commands.time):
        return None
    # The command of the motor that works hardest in each sample.
    highest_commands = commands.values.max(axis=1)
    fullest_sample = highest_commands.argmax()
    highest_command = float(highest_commands[fullest_sample])
    if highest_command <= FULL_THROTTLE_COMMAND:
        return None
    time = float(commands.time[fullest_sample])
    return supporting_fact(SensorFact.MOTORS_FULL, time=time, share=highest_command)
