"""Descents faster than a landing, as facts (coded findings): a fall, or a dive from which the vehicle flew on."""

from collections.abc import Iterator

import numpy as np

from mavdem.arrays import Flags
from mavdem.assessment.attitude_losses import FALL_SPEED
from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.dataset.grounded import MAX_GROUND_HEIGHT
from mavdem.dataset.intervals import TimeInterval, in_intervals, true_intervals
from mavdem.dataset.time_series import TimeSeries, series_of_boot
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.witnesses import SensorFact
from mavdem.witnesses.boot_sensors import CLOSED_STICK, BootSensors
from mavdem.witnesses.sensor_facts import supporting_fact, supporting_facts

SINK_AGREEMENT = 0.7
"""Least decrease of the height in a fall, as a fraction of its integrated speed; with less, the speed diverged."""

BAROMETER_LAG = 1.0
"""Seconds by which the descent that a barometer shows may be late: its altitude is averaged over that time."""

DIVE_SPEED = 3.5
"""Speed downward, m/s, of a dive: faster than autopilots descend with power."""

MIN_DIVE_SECONDS = 0.5
"""Seconds that a dive lasts at least; in less, no vehicle reaches ``DIVE_SPEED``."""

DIVE_COLLECTIVE_RATIO = 0.5
"""Collective, relative to the median of the flight, below which the throttle is assumed to be closed if no stick was
recorded."""


def fall_events(sensors: BootSensors, interval: TimeInterval) -> Iterator[Fact]:
    """Yields an event if the vehicle fell faster than ``FALL_SPEED`` and all height sensors confirm that.

    A diverging estimate of the vertical speed looks like a fall. So the height, if it was recorded, must decrease by at
    least ``SINK_AGREEMENT`` times the product of mean speed and duration of the fall. If the barometer contradicts the
    estimate, it too must sink faster than ``FALL_SPEED``.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        interval: start and end of the time to examine, s since boot.

    Yields:
        At most one event, from the first to the last sample of the estimate faster than ``FALL_SPEED``, with the
        ``speed`` downward, m/s, and the facts of the height sensors as ``witnesses``.
    """
    climb_rate = sensors.climb_estimate
    if climb_rate is None:
        return
    is_falling = in_intervals(climb_rate.time, [interval]) & (climb_rate.values < -FALL_SPEED)
    if not is_falling.any():
        return
    fall_times = climb_rate.time[is_falling]
    start = float(fall_times[0])
    end = float(fall_times[-1])
    # The barometer lags behind, so that its descent is sought a little later too.
    examined_interval = (start - BAROMETER_LAG, end + BAROMETER_LAG)
    sink_rate = sensors.sink_rate(examined_interval)
    # The climb estimate may be right until an impact at the end of the fall, and wrong in the lag after it. So of both
    # intervals the one counts in which the sensors confirm the larger speed.
    interval_until_end = (start - BAROMETER_LAG, end)
    sink_rate_until_end = sensors.sink_rate(interval_until_end)
    if sink_rate is not None and sink_rate_until_end is not None:
        if sink_rate_until_end > sink_rate:
            sink_rate = sink_rate_until_end
            examined_interval = interval_until_end
    if sink_rate is None or sink_rate < FALL_SPEED:
        return
    mean_climb_rate = float(climb_rate.values[is_falling].mean())
    if _height_contradicts_fall(sensors, (start, end), mean_climb_rate):
        return
    yield Fact(
        MotionEvent.FELL,
        time=start,
        end_time=end,
        speed=sink_rate,
        boot=sensors.boot,
        witnesses=supporting_facts(sensors.sink_facts(examined_interval)),
    )


def _height_contradicts_fall(
    sensors: BootSensors, fall: TimeInterval, mean_climb_rate: float
) -> bool:
    """Returns whether the vehicle lost less height than in a real fall; false if no height was recorded.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        fall: start and end of the fall, s since boot.
        mean_climb_rate: mean of the estimated climb in it, m/s, which is negative.
    """
    height = sensors.height_above_take_off
    if height is None:
        return False
    start, end = fall
    start_height, end_height = np.interp([start, end], height.time, height.values)
    # Both changes are negative: the vehicle must have sunk by at least the expected change.
    expected_change = SINK_AGREEMENT * mean_climb_rate * (end - start)
    return bool(end_height - start_height > expected_change)


def dive_events(sensors: BootSensors, flight_interval: TimeInterval) -> Iterator[Fact]:
    """Yields the dives of a flight: the throttle was closed, the vehicle sank fast, and it flew on afterwards.

    A dive is intended and therefore good, but it explains high speeds and full throttle at its end. It must last for
    ``MIN_DIVE_SECONDS`` and reach ``DIVE_SPEED`` by all height sensors, up to ``BAROMETER_LAG`` after the throttle was
    opened again.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.
    """
    is_throttle_closed = _throttle_closed(sensors, flight_interval)
    if is_throttle_closed is None:
        return
    # The closed throttle is shown by the stick or, if that was not recorded, by the motors.
    evidence_of_closing = SensorFact.THROTTLE_CLOSED
    if sensors.stick is None:
        evidence_of_closing = SensorFact.MOTORS_THROTTLED
    flight_start, flight_end = flight_interval
    time = is_throttle_closed.time
    for closing_time, opening_time in true_intervals(time, is_throttle_closed.values > 0):
        # Intervals at the ends of the record are infinite.
        start = max(closing_time, flight_start, time[0])
        end = min(opening_time, flight_end, time[-1])
        if end - start < MIN_DIVE_SECONDS:
            continue
        examined_interval = (start, end + BAROMETER_LAG)
        sink_rate = sensors.sink_rate(examined_interval)
        if sink_rate is None or sink_rate < DIVE_SPEED:
            continue
        if not flies_on(sensors, flight_interval, end):
            continue
        closing_fact = supporting_fact(evidence_of_closing, time=start)
        descent_facts = supporting_facts(sensors.sink_facts(examined_interval))
        yield Fact(
            MotionEvent.DIVED,
            Level.GOOD,
            time=start,
            end_time=end,
            speed=sink_rate,
            boot=sensors.boot,
            witnesses=(closing_fact, *descent_facts),
        )


def _throttle_closed(sensors: BootSensors, flight_interval: TimeInterval) -> TimeSeries | None:
    """Returns at which samples of the motors' mean output the throttle was closed.

    The mean output must be below ``DIVE_COLLECTIVE_RATIO`` times its median in the flight. If the pilot's stick was
    recorded it must be near its lower end too, at up to twice ``CLOSED_STICK``, since a dive does not need a fully
    closed stick.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.

    Returns:
        (N,) 0 or 1, of the whole boot; None if no motor outputs were recorded in the flight.
    """
    collective = series_of_boot(sensors.signals.collective, sensors.boot)
    if collective is None:
        return None
    in_flight = in_intervals(collective.time, [flight_interval])
    if not in_flight.any():
        return None
    usual_output = float(np.median(collective.values[in_flight]))
    is_low: Flags = collective.values < DIVE_COLLECTIVE_RATIO * usual_output
    stick = sensors.stick
    if stick is not None:
        # The motors do not follow the stick in automatic modes, so that both must be low.
        is_low &= np.interp(collective.time, stick.time, stick.values) <= 2 * CLOSED_STICK
    return TimeSeries(collective.time, collective.boot, is_low.astype(float))


def flies_on(sensors: BootSensors, flight_interval: TimeInterval, time: float) -> bool:
    """Returns whether the vehicle was still in the air ``RECOVERY_SECONDS`` after a time.

    Flight and record must last that long, and the vehicle must be above ``MAX_GROUND_HEIGHT`` then, if its height is
    known.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.
        time: s since boot.
    """
    recovery_end = time + RECOVERY_SECONDS
    _, flight_end = flight_interval
    if min(flight_end, sensors.record_end) < recovery_end:
        return False
    height = sensors.height_at(recovery_end)
    return height is None or height > MAX_GROUND_HEIGHT
