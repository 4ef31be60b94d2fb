"""Gusts: short excursions of the wind torque from its running median, larger than turbulence causes.

A gust is at least as long as the estimate resolves. A step that stays, as when a motor weakens, is no gust.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy

from mavdem.arrays import Array, Flags
from mavdem.confidence import coverage_factor
from mavdem.dem.record import Record
from mavdem.plant.parameters import Physical

MAX_ERROR_SHARE = 0.75
"""Largest variance of the wind torque's errors, relative to the variance of its estimate, with which it is resolved."""

RUNNING_LEVEL_SECONDS = 10.0
"""Width of the running median that gusts stand out from, s: a choice, longer than a gust."""

GUST_THRESHOLD = 4.0
"""Peak distance of a gust from the running level, in robust standard deviations: a choice, rare in turbulence."""

END_THRESHOLD_SHARE = 0.5
"""Distance from the running level at which a gust begins and ends, relative to the threshold: a choice."""

MIN_BAND_MULTIPLE = 2.0
"""Least peak distance of a gust, in half widths of the torque's band: errors in quick manoeuvres are no gusts."""


class DetectedGust(NamedTuple):
    """A gust: wind torque that leaves its running level by ``GUST_THRESHOLD`` standard deviations, and returns.

    Attributes:
        sample: index of its first sample in the record.
        start: time of that sample since the record's first, s; gaps between segments do not count.
        length: time for which it stays beyond half of the threshold, s.
        size: largest distance from the running level, with its sign, rad/s².
    """

    sample: int
    start: float
    length: float
    size: float


class GustDetection(NamedTuple):
    """Result of the detection of gusts."""

    gusts: tuple[DetectedGust, ...]
    """The gusts, in order of time."""

    threshold: float
    """Distance from the running level that a gust exceeds, rad/s²."""

    false_per_minute: float
    """Number of false gusts a minute to expect of Gaussian turbulence alone."""


def min_gust_duration(physical: Physical, dt: float) -> float:
    """Returns the least duration of a gust, s: the motors' lag and delay, and two steps of dt seconds.

    Within that time an error of lag or delay looks like a gust.
    """
    return 2 * dt + physical.lag + physical.delay


def detect_gusts(
    torque: Array,
    band: Array,
    record: Record,
    min_duration: float = 0.0,
    is_wind: Flags | None = None,
) -> GustDetection:
    """Detects the gusts in the wind torque over time.

    A gust is an excursion from the running level of the torque. Its peak exceeds ``GUST_THRESHOLD`` robust standard
    deviations, and it begins and ends at ``END_THRESHOLD_SHARE`` of that threshold.

    The rate of false gusts is that at which a Gaussian process with the same variance, and the same variance of its
    derivative, crosses the threshold on either side (S. O. Rice, "Mathematical analysis of random noise", 1944, sec.
    3.3). Both variances are estimated by medians, which gusts and gaps hardly change. If most of the torque's variance
    is that of its errors, no gusts are detected.

    Args:
        torque: wind torque (T,), rad/s².
        band: half width of its 90 % band (T,), rad/s²; a gust is at least twice as large.
        record: the samples' time step and segments.
        min_duration: least duration of a gust, s.
        is_wind: whether the wind makes the torque of a sample (T,); None if it does in all. Other samples are in no
            gust.

    Returns:
        The gusts, the threshold, and the rate of false gusts.
    """
    if is_wind is None:
        is_wind = np.ones(len(torque), bool)
    # At other samples the torque is replaced by its usual level, which is not detected as a gust.
    torque = np.where(is_wind, torque, np.median(torque[is_wind]))
    level_samples = round(RUNNING_LEVEL_SECONDS / record.dt)
    deviation = torque - _running_level(torque, record, level_samples)
    sd = float(np.median(abs(deviation[is_wind]))) / coverage_factor(0.5)
    threshold = GUST_THRESHOLD * sd
    error_variance = np.mean((band[is_wind] / coverage_factor()) ** 2)
    if sd == 0.0 or error_variance > MAX_ERROR_SHARE * np.var(torque[is_wind]):
        return GustDetection((), threshold, 0.0)

    slopes = np.diff(deviation)[is_wind[1:]] / record.dt
    false_per_minute = _false_gusts_per_minute(slopes, sd)

    # Excursions are samples in a row beyond the end threshold on one side. They also end at a gap between segments.
    signs = np.sign(deviation) * (abs(deviation) > END_THRESHOLD_SHARE * threshold)
    sign_changes = 1 + np.flatnonzero(np.diff(signs))
    edges = sorted({0, len(deviation), *sign_changes.tolist(), *record.segment_starts.tolist()})
    gusts = []
    for start, stop in pairwise(edges):
        peak = start + int(np.argmax(abs(deviation[start:stop])))
        duration = (stop - start) * record.dt
        is_large = abs(deviation[peak]) > max(threshold, MIN_BAND_MULTIPLE * band[peak])
        if not is_large or duration < min_duration:
            continue
        if _is_step_of_level(torque, start, stop, level_samples // 2, threshold, record):
            continue
        gusts.append(DetectedGust(start, start * record.dt, duration, deviation[peak]))
    return GustDetection(tuple(gusts), threshold, false_per_minute)


def _false_gusts_per_minute(slopes: Array, sd: float) -> float:
    """Returns how often Gaussian turbulence would cross the thresholds of gusts, above and below the level.

    By Rice's formula the rate of outward crossings of both thresholds, ±c standard deviations, is
    2 · (slope_sd / sd) / 2π · exp(−c²/2) per second.

    Args:
        slopes: derivative of the torque (n,), rad/s³.
        sd: standard deviation of the torque, rad/s².

    Returns:
        Number of crossings a minute.
    """
    # A robust standard deviation: the median absolute value of a normal variable is 0.67 times its standard deviation.
    slope_sd = float(np.median(abs(slopes))) / coverage_factor(0.5)
    # The probability density of the torque at a threshold, relative to that at 0.
    relative_density = float(np.exp(-(GUST_THRESHOLD**2) / 2))
    crossings_per_second = 2 * slope_sd / sd / (2 * np.pi) * relative_density
    return 60 * crossings_per_second


def _running_level(torque: Array, record: Record, width: int) -> Array:
    """Returns the level about which the wind torque fluctuates: its running median, which short gusts hardly move.

    Args:
        torque: wind torque (T,), rad/s².
        record: the segments; the median does not reach across a gap between them.
        width: number of samples of the median; less in a shorter segment.

    Returns:
        Level (T,), rad/s².
    """
    levels = []
    for segment in np.split(torque, record.segment_starts[1:]):
        # A median filter about each sample needs an odd width; setting the last bit rounds an even one up.
        odd_width = min(len(segment), width) | 1
        levels.append(scipy.ndimage.median_filter(segment, odd_width))
    return np.concatenate(levels)


def _is_step_of_level(
    torque: Array, start: int, stop: int, samples_each_side: int, threshold: float, record: Record
) -> bool:
    """Returns whether an excursion of the wind torque is a lasting step of its level, and not a gust.

    It is a step if the medians of the torque before and after the excursion differ by more than a threshold.

    Args:
        torque: wind torque (T,), rad/s².
        start: first sample of the excursion.
        stop: index of the first sample after the excursion.
        samples_each_side: number of samples before the excursion, and after it, whose medians are compared; fewer at
            the ends of its segment.
        threshold: difference of the medians that counts, rad/s².
        record: the flight, of which only the starts of the segments are used.

    Returns:
        Whether it is a step; False at an end of the segment, where one of the medians is missing.
    """
    starts = record.segment_starts
    segment_start = starts[starts <= start].max()
    segment_end = starts[starts >= stop].min(initial=len(torque))
    torque_before = torque[max(start - samples_each_side, segment_start) : start]
    torque_after = torque[stop : min(stop + samples_each_side, segment_end)]
    # At an end of the segment there is nothing to compare with.
    if not len(torque_before) or not len(torque_after):
        return False
    level_change = float(np.median(torque_after) - np.median(torque_before))
    return abs(level_change) > threshold
