"""Estimated heights that barometer and satellites both refute, as facts (coded findings).

An estimator integrates the accelerometer and corrects the result by the barometer. An accelerometer that reads wrongly
all the time, as by vibration that it rectifies, shifts the estimate until the correction balances the error.
Innovations hardly show that, and the autopilot holds the wrong height.
"""

from collections.abc import Iterator

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.height_disagreements import height_difference, initial_difference
from mavdem.dataset.intervals import TimeInterval, in_intervals, true_intervals
from mavdem.dataset.time_series import TimeSeries, series_of_boot
from mavdem.facts import Fact
from mavdem.facts.ending import MotionEvent
from mavdem.ingest.telemetry import Parameters
from mavdem.witnesses.boot_sensors import BootSensors
from mavdem.witnesses.height import windowed_mean

MIN_OFFSET = 2.0
"""Distance, m, of the estimate from both sensors, from which on they refute it; in sound real flights 1.5 at most."""

OFFSET_MEAN_SECONDS = 10.0
"""Seconds over which the heights are averaged: a correction of the estimate by the barometer takes some seconds."""

OTHER_HEIGHT_SOURCES = {
    "EK2_ALT_SOURCE": (1, 3),
    "EK3_SRC1_POSZ": (2, 4, 6),
    "EKF2_HGT_MODE": (2, 3),
    "EKF2_HGT_REF": (2, 3),
}
"""Values of parameters with which the height is neither by barometer nor by satellites, but above what is below."""


def height_offsets(sensors: BootSensors, flight_interval: TimeInterval) -> Iterator[Fact]:
    """Yields an event if the estimated height was off from both barometer and satellites in a flight, the same way.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.

    Yields:
        At most one event, from the first time at which the distance from the nearer sensor reached ``MIN_OFFSET`` to
        the last, with the largest such distance as ``height``, m, positive if the estimate was too high.
    """
    if _has_other_height_source(sensors.signals.telemetry.parameters):
        return
    offset = _offset_from_both_sensors(sensors, flight_interval)
    if offset is None:
        return
    intervals = true_intervals(offset.time, abs(offset.values) >= MIN_OFFSET)
    if not intervals:
        return
    first_start, _ = intervals[0]
    _, last_end = intervals[-1]
    largest_sample = abs(offset.values).argmax()
    yield Fact(
        MotionEvent.HEIGHT_OFFSET,
        time=first_start,
        # An interval that lasts to the end of the record is infinite.
        end_time=min(last_end, float(offset.time[-1])),
        height=float(offset.values[largest_sample]),
        boot=sensors.boot,
    )


def _has_other_height_source(parameters: Parameters) -> bool:
    """Returns whether the autopilot's estimate of the height is set to follow a rangefinder, a beacon or vision."""
    for name, values_of_other_sources in OTHER_HEIGHT_SOURCES.items():
        if parameters.get(name) in values_of_other_sources:
            return True
    return False


def _offset_from_both_sensors(
    sensors: BootSensors, flight_interval: TimeInterval
) -> TimeSeries | None:
    """Returns how far the estimated height was from the nearer one of barometer and satellites since the take-off.

    Args:
        sensors: sensors of the vehicle in one boot.
        flight_interval: start and end of the flight, s since boot.

    Returns:
        The distance (N,), m, averaged over ``OFFSET_MEAN_SECONDS``, at the receiver's fixes in flight: positive above
        both sensors, negative below both, 0 between them. None if one of the three heights was not recorded.
    """
    take_off, _ = flight_interval
    barometer = sensors.height.barometer
    estimate = series_of_boot(sensors.signals.height, sensors.boot)
    above_satellites = height_difference(sensors.signals, sensors.boot)
    if barometer is None or estimate is None or above_satellites is None:
        return None
    is_estimated = in_intervals(above_satellites.time, [(estimate.time[0], estimate.time[-1])])
    if not is_estimated.any():
        return None
    above_satellites = above_satellites.select(is_estimated)
    fix_times = above_satellites.time
    barometer_height = np.interp(fix_times, barometer.time, barometer.values)
    estimated_height = np.interp(fix_times, estimate.time, estimate.values)
    estimate_above_barometer = TimeSeries(
        fix_times, above_satellites.boot, estimated_height - barometer_height
    )
    initial_satellites = initial_difference(above_satellites, take_off)
    initial_estimate = initial_difference(estimate_above_barometer, take_off)
    if initial_satellites is None or initial_estimate is None:
        return None
    is_in_flight = in_intervals(fix_times, [flight_interval])
    time = fix_times[is_in_flight]
    # How far the estimate and the altitude by satellites are above the barometer since the take-off; the barometer
    # itself is at 0. What precedes and follows the flight does not enter the means.
    estimate_height = windowed_mean(
        time, estimate_above_barometer.values[is_in_flight] - initial_estimate, OFFSET_MEAN_SECONDS
    )
    satellite_height = windowed_mean(
        time, initial_satellites - above_satellites.values[is_in_flight], OFFSET_MEAN_SECONDS
    )
    offset = _distance_from_nearer_sensor(estimate_height, satellite_height)
    # Close to the ends of the flight a mean is of fewer seconds. ``time`` may be empty, hence the slices.
    half_window = OFFSET_MEAN_SECONDS / 2
    is_whole_mean = (time >= time[:1] + half_window) & (time <= time[-1:] - half_window)
    if not is_whole_mean.any():
        return None
    return TimeSeries(time, above_satellites.boot[is_in_flight], offset).select(is_whole_mean)


def _distance_from_nearer_sensor(estimate: Array, satellites: Array) -> Array:
    """Returns how far estimated heights are from the nearer one of barometer and satellites.

    Args:
        estimate: (N,) estimated heights above the barometer's, m.
        satellites: (N,) heights by satellites above the barometer's, m.

    Returns:
        (N,) distances, m: positive above both sensors, negative below both, 0 between them.
    """
    barometer_height = 0.0
    higher_sensor = np.maximum(satellites, barometer_height)
    lower_sensor = np.minimum(satellites, barometer_height)
    # An estimate between both sensors is its own nearest height.
    nearest_height = np.clip(estimate, lower_sensor, higher_sensor)
    return estimate - nearest_height
