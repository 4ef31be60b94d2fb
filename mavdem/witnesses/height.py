"""Height and climb by two sources: the barometer, and the autopilot's estimate, which may diverge.

The estimator integrates the accelerometer. A bias of that, or vibration that it rectifies, lets the estimated height
fall or rise without end while the vehicle hovers, and in automatic height modes the vehicle then follows the error. The
barometer does not integrate anything; what it measures wrongly, by wind or its own downwash, is bounded.
"""

from dataclasses import dataclass
from math import isinf
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.intervals import Intervals, true_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, series_of_boot
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.facts.witnesses import HeightSource
from mavdem.witnesses.sensors import barometer_altitude

SLOPE_SECONDS = 2.0
"""Seconds over which a climb is measured by differences of the barometer's altitude; a choice between noise and lag."""

MEAN_SECONDS = 1.0
"""Seconds over which the barometer's altitude is averaged before that."""

GRID_RATE = 5.0
"""Rate, Hz, at which climb by barometer and by estimate are compared."""

MAX_BAROMETER_NOISE = 3.0
"""Robust RMS, m/s², of the second differences of the altitude's means over 1 s, above which a barometer is not usable.

Of 240 real logs 95 % are below 0.7; one with a broken sensor has 45.
"""

MAX_CLIMB_DIFFERENCE = 2.5
"""Difference, m/s, of climb by estimate and by barometer beyond which they contradict each other.

On real logs the same events are found with any limit from 1.2 to 3.5 m/s.
"""

MIN_CONTRADICTION_SECONDS = 1.5
"""Seconds that such a difference must last: gusts at the static port pass faster."""

MIN_BAROMETER_RATE = 1.0
"""Rate, Hz, below which a barometer shows no climb: half of ``SLOPE_SECONDS``."""

MAX_HEIGHT_DIFFERENCE = 5.0
"""Difference, m, of height by estimate and by barometer since take-off beyond which the estimate is not used.

Weather moves a barometer by about 1 m in 10 minutes; wind and downwash by up to 3 m.
"""

NORMAL_MAD_RATIO = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True, eq=False)
class HeightComparison:
    """What barometer and estimate show of height and climb in one boot; time is s since boot."""

    barometer: TimeSeries | None
    """Altitude (N,), m, averaged over ``MEAN_SECONDS``; None without a usable barometer."""
    barometer_noise: float | None
    """Robust RMS, m/s², of the second differences of 1 s means; None without a barometer."""
    barometer_climb: TimeSeries | None
    """Climb (M,) by the barometer, m/s upward, at ``GRID_RATE``; None without a usable barometer."""
    estimated_climb: TimeSeries | None
    """Climb (K,) by the autopilot's estimate, m/s upward, averaged over ``SLOPE_SECONDS``; None if not recorded."""
    contradictions: Intervals
    """When both climbs were known and differed by more than ``MAX_CLIMB_DIFFERENCE``, s."""
    climb_difference: float | None
    """Median of the size of that difference, m/s; None if not both climbs are known."""

    def barometer_change(self, start: float, end: float) -> float | None:
        """Returns the rise of the barometer's height from one time to another, m; None without a usable barometer."""
        if self.barometer is None:
            return None
        start_height, end_height = np.interp(
            [start, end], self.barometer.time, self.barometer.values
        )
        return float(end_height - start_height)


@cached_per_vehicle()
def height_comparison(signals: Signals, boot: int) -> HeightComparison:
    """Compares the climb rates by the barometer and by the autopilot's estimate in a boot.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        Both climb rates, averaged, with the intervals in which they contradict each other. A barometer that is too
        noisy, or too slow for its noise to be estimated, is left out.
    """
    noise = None
    barometer = None
    barometer_climb = None
    altitude = series_of_boot(barometer_altitude(signals), boot)
    if altitude is not None:
        noise = barometer_noise(altitude)
        if is_usable_barometer(noise):
            mean_altitude = windowed_mean(altitude.time, altitude.values, MEAN_SECONDS)
            barometer = TimeSeries(altitude.time, altitude.boot, mean_altitude)
            barometer_climb = _climb_by_barometer(barometer)
    estimated_climb = None
    climb_rate = series_of_boot(signals.climb_rate, boot)
    if climb_rate is not None:
        mean_climb = windowed_mean(climb_rate.time, climb_rate.values, SLOPE_SECONDS)
        estimated_climb = TimeSeries(climb_rate.time, climb_rate.boot, mean_climb)
    return HeightComparison(
        barometer=barometer,
        barometer_noise=noise,
        barometer_climb=barometer_climb,
        estimated_climb=estimated_climb,
        contradictions=_contradicted_intervals(barometer_climb, estimated_climb),
        climb_difference=_median_difference(barometer_climb, estimated_climb),
    )


def is_usable_barometer(noise: float | None) -> bool:
    """Returns whether a barometer with such a :func:`barometer_noise`, m/s², measures the height; None is unknown."""
    return noise is not None and noise <= MAX_BAROMETER_NOISE


def barometer_noise(altitude: TimeSeries) -> float | None:
    """Estimates the noise of a barometer: the robust RMS of the second differences of its means over 1 s.

    The second difference of an altitude over steps of 1 s is a vertical acceleration. No multirotor keeps up a large
    one, so that a large value is noise of the sensor (:func:`is_usable_barometer`). The RMS is robust because it is
    computed from the median absolute deviation, which a few outliers do not change.

    Args:
        altitude: (N,) m, of one boot.

    Returns:
        The noise, m/s²; None if the samples are too few or too slow to estimate it.
    """
    duration = altitude.time[-1] - altitude.time[0]
    if len(altitude.time) < MIN_BAROMETER_RATE * max(duration, SLOPE_SECONDS):
        return None
    # The mean altitude in each second of the boot clock that has samples.
    seconds = np.floor(altitude.time).astype(np.int64)
    distinct_seconds, rows, counts = np.unique(seconds, return_inverse=True, return_counts=True)
    means = np.bincount(rows, altitude.values) / counts
    # Only three seconds that follow each other make a second difference.
    is_consecutive = distinct_seconds[2:] - distinct_seconds[:-2] == 2
    second_differences = np.diff(means, n=2)[is_consecutive]
    if not len(second_differences):
        return None
    deviations = abs(second_differences - np.median(second_differences))
    return float(NORMAL_MAD_RATIO * np.median(deviations))


def windowed_mean(time: Array, values: Array, width: float) -> Array:
    """Returns the centred moving mean of samples.

    Args:
        time: (N,) s, ascending.
        values: (N,) samples.
        width: width of the window, s.

    Returns:
        (N,) the mean of all samples within half a width of each stamp.
    """
    # The sum over a window is the difference of two cumulative sums.
    cumulative = np.concatenate([[0.0], np.cumsum(values)])
    first_row = np.searchsorted(time, time - width / 2, side="left")
    row_after = np.searchsorted(time, time + width / 2, side="right")
    return (cumulative[row_after] - cumulative[first_row]) / (row_after - first_row)


def _climb_by_barometer(barometer: TimeSeries) -> TimeSeries | None:
    """Returns the slope of the barometer's altitude over ``SLOPE_SECONDS``, m/s upward, at ``GRID_RATE``.

    Args:
        barometer: (N,) altitude of one boot, m, as a moving average.

    Returns:
        (M,) central differences; None if the record is not longer than ``SLOPE_SECONDS``.
    """
    # A slope at a time needs the altitude half of ``SLOPE_SECONDS`` before it and after it, within the record.
    half_width = SLOPE_SECONDS / 2
    first_time = barometer.time[0] + half_width
    last_time = barometer.time[-1] - half_width
    if last_time <= first_time:
        return None
    time = np.arange(first_time, last_time, 1 / GRID_RATE)
    altitude_after = np.interp(time + half_width, barometer.time, barometer.values)
    altitude_before = np.interp(time - half_width, barometer.time, barometer.values)
    boot = np.full(len(time), barometer.boot[0])
    return TimeSeries(time, boot, (altitude_after - altitude_before) / SLOPE_SECONDS)


def _contradicted_intervals(
    barometer_climb: TimeSeries | None, estimated_climb: TimeSeries | None
) -> Intervals:
    """Returns the intervals in which estimate and barometer differ by more than ``MAX_CLIMB_DIFFERENCE`` for long.

    Args:
        barometer_climb: (M,) climb rate by the barometer, m/s upward, at even times; None without a usable barometer.
        estimated_climb: (K,) climb rate by the estimate, m/s upward; None if it was not recorded.

    Returns:
        Intervals, s since boot, of at least ``MIN_CONTRADICTION_SECONDS`` in which both were recorded.
    """
    if barometer_climb is None or estimated_climb is None or not len(barometer_climb.time):
        return []
    time = barometer_climb.time
    estimate = np.interp(time, estimated_climb.time, estimated_climb.values)
    # Before its first and after its last sample the estimate is not known.
    is_estimate_known = (time >= estimated_climb.time[0]) & (time <= estimated_climb.time[-1])
    differs = abs(estimate - barometer_climb.values) > MAX_CLIMB_DIFFERENCE
    is_contradicted = is_estimate_known & differs
    long_intervals = []
    for start, end in true_intervals(time, is_contradicted):
        # An interval at an end of the record is infinite there, and is cut to its recorded part.
        recorded_start = max(start, float(time[0]))
        recorded_end = min(end, float(time[-1]))
        if recorded_end - recorded_start >= MIN_CONTRADICTION_SECONDS:
            long_intervals.append((recorded_start, recorded_end))
    return long_intervals


def _median_difference(
    barometer_climb: TimeSeries | None, estimated_climb: TimeSeries | None
) -> float | None:
    """Returns the median absolute difference of two climb rates.

    Args:
        barometer_climb: (M,) m/s upward; None without a usable barometer.
        estimated_climb: (K,) m/s upward; None if it was not recorded.

    Returns:
        The median absolute difference, m/s; None if they have no time in common.
    """
    if barometer_climb is None or estimated_climb is None:
        return None
    time = barometer_climb.time
    # Before its first and after its last sample the estimate is not known.
    is_estimate_known = (time >= estimated_climb.time[0]) & (time <= estimated_climb.time[-1])
    if not is_estimate_known.any():
        return None
    estimate = np.interp(time, estimated_climb.time, estimated_climb.values)
    differences = abs(estimate - barometer_climb.values)
    return float(np.median(differences[is_estimate_known]))


class ReliableHeight(NamedTuple):
    """A height above the take-off by a reliable source, and which source that is."""

    series: TimeSeries
    """Height (N,), m."""
    source: HeightSource
    """The barometer, or the autopilot's estimate."""


def reliable_height(signals: Signals, boot: int, take_off: float) -> ReliableHeight | None:
    """Returns the height above the take-off, by the more reliable one of two sources.

    That is the autopilot's estimate, unless a usable barometer contradicts it by far at any time; then it is the
    barometer (:func:`_reliable_source`).

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        take_off: time of the take-off, s since boot; minus infinity if the log begins in the air. Then the height is
            that above the autopilot's home, by the estimate alone.

    Returns:
        The height (N,), m, with its source; None if neither source was recorded.
    """
    source = _reliable_source(signals, boot, take_off)
    if source is None:
        return None
    height = _recorded_height(signals, boot, source)
    if not isinf(take_off):
        height = _above_take_off(height, take_off)
    return None if height is None else ReliableHeight(height, source)


def reliable_height_at(signals: Signals, boot: int, take_off: float, time: float) -> float | None:
    """Returns :func:`reliable_height` at one time, m; None if neither source was recorded.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        take_off: time of the take-off, s since boot; minus infinity if the log begins in the air.
        time: s since boot.
    """
    source = _reliable_source(signals, boot, take_off)
    if source is None:
        return None
    height = _recorded_height(signals, boot, source)
    if height is None:
        return None
    recorded_height = height.value_at(time)
    return recorded_height if isinf(take_off) else recorded_height - height.value_at(take_off)


def _recorded_height(signals: Signals, boot: int, source: HeightSource) -> TimeSeries | None:
    """Returns the height (N,) that a source measured, m above its own zero; None if it was not recorded."""
    if source is HeightSource.ESTIMATE:
        return series_of_boot(signals.height, boot)
    return height_comparison(signals, boot).barometer


# The source alone is cached: a log of hours has a take-off for each of many flights, and their heights would take its
# size in memory.
@cached_per_vehicle()
def _reliable_source(signals: Signals, boot: int, take_off: float) -> HeightSource | None:
    """Chooses the source whose height :func:`reliable_height` returns: the autopilot's estimate or the barometer.

    The estimate is preferred, except if it is ever farther than ``MAX_HEIGHT_DIFFERENCE`` from the barometer: then it
    has probably diverged.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        take_off: time of the take-off, s since boot; minus infinity if the log begins in the air. Both heights are
            compared above the take-off, so that then only the estimate, which is above home, can be used.

    Returns:
        The source; None if neither was recorded.
    """
    recorded_estimate = _recorded_height(signals, boot, HeightSource.ESTIMATE)
    if isinf(take_off):
        return None if recorded_estimate is None else HeightSource.ESTIMATE
    estimate = _above_take_off(recorded_estimate, take_off)
    recorded_barometer = _recorded_height(signals, boot, HeightSource.BAROMETER)
    barometer = _above_take_off(recorded_barometer, take_off)
    if barometer is None:
        return None if estimate is None else HeightSource.ESTIMATE
    if estimate is None:
        return HeightSource.BAROMETER
    estimate_at_barometer = np.interp(barometer.time, estimate.time, estimate.values)
    differs = abs(estimate_at_barometer - barometer.values) > MAX_HEIGHT_DIFFERENCE
    # Before its first and after its last sample the estimate is not known.
    is_estimate_known = (barometer.time >= estimate.time[0]) & (barometer.time <= estimate.time[-1])
    if (differs & is_estimate_known).any():
        return HeightSource.BAROMETER
    return HeightSource.ESTIMATE


def _above_take_off(height: TimeSeries | None, take_off: float) -> TimeSeries | None:
    """Returns a height less its value at take-off, m; None without a height."""
    if height is None:
        return None
    return TimeSeries(height.time, height.boot, height.values - height.value_at(take_off))
