"""Barometers that drift or freeze in flight, as facts (coded findings): on the ground they read another height."""

from collections.abc import Iterator
from math import isfinite

from mavdem.dataset.intervals import Intervals, TimeInterval
from mavdem.facts import Fact
from mavdem.facts.ending import MotionEvent
from mavdem.facts.witnesses import SensorFact
from mavdem.witnesses.boot_sensors import BootSensors
from mavdem.witnesses.ground_heights import GroundHeights, ground_heights
from mavdem.witnesses.sensor_facts import supporting_fact

MIN_DRIFT = 3.0
"""Change of the barometer's height at rest, m, from which on it may have drifted.

It was at most 1.3 m in 26 real flights that landed within 15 m of their take-off.
"""

WEATHER_RATE = 0.1 / 60
"""Rate, m/s, at which the weather changes a barometer's height: 1 m in 10 minutes."""

NOISE_RATIO = 4.0
"""Change of the barometer's height over its scatter at rest from which on it is not noise."""

MAX_SATELLITE_FRACTION = 0.5
"""Change of the altitude by satellites, as a fraction of the barometer's, up to which it denies that one; a choice.

A vehicle that lands at another height changes both by the same amount.
"""

MAX_DISTANCE = 20.0
"""Distance, m, of landing and take-off up to which they count as one place: twice the error of a poor fix."""


def barometer_drifts(
    sensors: BootSensors, flight_interval: TimeInterval, rests: Intervals | None = None
) -> Iterator[Fact]:
    """Yields an event if the barometer drifted in a flight, or froze.

    Three conditions must hold: between take-off and landing the reading on the ground changed by more than noise and
    weather explain, the altitude by satellites did not change with it, and both are the same place.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.
        rests: when the vehicle rested before and after the flight, s since boot; None to find that in the signals.

    Yields:
        At most one fact, with the change of the barometer as ``change``, m upwards, the time of the first of readings
        that are all equal as ``frozen_since``, s, None where it drifted, and the facts of barometer and receiver as
        ``witnesses``.
    """
    heights = ground_heights(sensors.signals, sensors.boot, flight_interval, rests)
    if heights is None:
        return
    change = heights.barometer_change
    flight_start, flight_end = flight_interval
    duration = min(flight_end, sensors.record_end) - flight_start
    if not _is_drift(heights, duration):
        return
    yield Fact(
        MotionEvent.BAROMETER_DRIFTED,
        time=flight_start if heights.frozen_since is None else heights.frozen_since,
        end_time=flight_end if isfinite(flight_end) else None,
        change=change,
        frozen_since=heights.frozen_since,
        boot=sensors.boot,
        witnesses=(
            supporting_fact(SensorFact.GROUND_READING_CHANGED, height=change),
            supporting_fact(
                SensorFact.SATELLITES_LEVEL,
                height=heights.satellite_change,
                distance=heights.distance,
            ),
        ),
    )


def _is_drift(heights: GroundHeights, duration: float) -> bool:
    """Returns whether the barometer drifted, so that it reads another height on the ground after the flight.

    Args:
        heights: changes from before the flight to after it, m, by barometer and by satellites, and the distance, m,
            between the places of take-off and landing.
        duration: duration of the flight, s, in which the weather changes the pressure.
    """
    change = heights.barometer_change
    limit = max(MIN_DRIFT + WEATHER_RATE * duration, NOISE_RATIO * heights.barometer_scatter)
    is_large = abs(change) >= limit
    # The size of the change by satellites decides, not its sign: one that is large the other way shows that the
    # altitude by satellites drifted itself, and proves no drift of the barometer.
    satellite_fraction = abs(heights.satellite_change / change) if change else 0.0
    is_level_by_satellites = satellite_fraction <= MAX_SATELLITE_FRACTION
    is_one_place = heights.distance <= MAX_DISTANCE
    return is_large and is_level_by_satellites and is_one_place


def drift_with_onset_time(drift: Fact, disagreement: Fact | None) -> Fact:
    """Adds to the event that the barometer drifted the time at which the drift began.

    A drift is found by the heights at rest before and after the flight, which do not show its time. It began when the
    heights by barometer and by satellites began to differ.

    Args:
        drift: the event that the barometer drifted or froze, as of :func:`barometer_drifts`.
        disagreement: the event that barometer and satellites disagreed in the same flight, which begins when their
            difference began to grow; None if they agreed.

    Returns:
        The drift with that time. It is unchanged if the difference grew in the other direction, or if the barometer
        froze, which has a time.
    """
    is_frozen = drift.figures["frozen_since"] is not None
    if disagreement is None or is_frozen:
        return drift
    is_same_direction = drift.figures["change"] * disagreement.figures["height"] > 0
    if not is_same_direction:
        return drift
    return drift.replace(time=disagreement.time)


def is_barometer_steady(
    sensors: BootSensors, flight_interval: TimeInterval, rests: Intervals | None = None
) -> bool:
    """Returns whether a barometer reads the same at rest after a flight as before it: it has not drifted in between.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.
        rests: when the vehicle rested before and after the flight, s since boot; None to find that in the signals.

    Returns:
        True if both heights agree within ``MIN_DRIFT``; False also if the vehicle was not recorded at rest both times.
    """
    heights = ground_heights(sensors.signals, sensors.boot, flight_interval, rests)
    return heights is not None and abs(heights.barometer_change) < MIN_DRIFT
