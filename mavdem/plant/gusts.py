"""Gusts: where the wind's torque leaves its running level by more than its turbulence does, and returns to it.

They last as long as the estimate resolves. A step that stays, as of a motor that weakens, is none.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from mavdem.arrays import Array
from mavdem.confidence import coverage_factor
from mavdem.dem.record import Record
from mavdem.plant.parameters import Physical

# of the estimate's variance, that its errors may have before it is not resolved
MAX_ERROR_SHARE = 0.75
RUNNING_LEVEL_SECONDS = 10.0  # of the running median, which a gust stands out from
THRESHOLD = 4.0  # standard deviations from it, by the median absolute deviation
END = 0.5  # of the threshold, within which a gust begins and ends
# half widths of the band, which a gust exceeds: errors in quick manoeuvres are no gusts
CERTAIN_BANDS = 2.0


class DetectedGust(NamedTuple):
    """Wind that leaves its running level by ``THRESHOLD`` standard deviations.

    Attributes:
        sample: the first of it, in the record.
        start: that sample's time since the record's first, s; gaps between segments do not count.
        length: s, for which it stays beyond half the threshold.
        size: its largest distance from the level, with its sign, rad/s².
    """

    sample: int
    start: float
    length: float
    size: float


class Gusts(NamedTuple):
    """What was found, the threshold in rad/s², and how many a minute Gaussian turbulence alone would give."""

    found: tuple[DetectedGust, ...]
    threshold: float
    false_per_minute: float


def min_gust_duration(physical: Physical, dt: float) -> float:
    """Returns how long a gust lasts at least, s: longer than the motors take to answer, and two steps.

    Within that an error of lag or delay looks like a gust.
    """
    return 2 * dt + physical.lag + physical.delay


def gusts(
    torque: Array,
    band: Array,
    record: Record,
    shortest: float = 0.0,
) -> Gusts:
    """Returns the gusts of the wind's ``torque`` (T,), no less than twice the half width of its ``band`` (T,).

    There are none where the errors that the band stands for are most of what the torque is.
    They last ``shortest`` s or more and return to the level they left: a step, as of a motor, is none. The rate of
    false ones is that at which a Gaussian process of the same variance and the same variance of its derivative crosses
    the threshold, on both sides (Rice, "Mathematical analysis of random noise", 1944, sec. 3.3).
    """
    width = round(RUNNING_LEVEL_SECONDS / record.dt)
    parts = np.split(torque, record.segment_starts[1:])
    levels = [median_filter(part, min(len(part), width) | 1) for part in parts]
    away = torque - np.concatenate(levels)
    sd = float(np.median(abs(away))) / coverage_factor(0.5)
    if sd == 0.0 or np.mean((band / coverage_factor()) ** 2) > MAX_ERROR_SHARE * np.var(torque):
        return Gusts((), THRESHOLD * sd, 0.0)
    # Likewise by the median, so that gusts and gaps do not count.
    slope = float(np.median(abs(np.diff(away)))) / coverage_factor(0.5) / record.dt
    false = 2 * 60 * slope / sd / (2 * np.pi) * float(np.exp(-(THRESHOLD**2) / 2))
    # A change of sign ends a gust, and so does a gap.
    signs = np.sign(away) * (abs(away) > END * THRESHOLD * sd)
    changes = 1 + np.flatnonzero(np.diff(signs))
    edges = sorted({0, len(away), *changes.tolist(), *record.segment_starts.tolist()})
    detected = []
    for start, stop in pairwise(edges):
        peak = start + int(np.argmax(abs(away[start:stop])))
        length = (stop - start) * record.dt
        high = abs(away[peak]) > max(THRESHOLD * sd, CERTAIN_BANDS * band[peak])
        if high and length >= shortest and not _stays(torque, start, stop, width // 2, sd, record):
            detected.append(DetectedGust(start, start * record.dt, length, away[peak]))
    return Gusts(tuple(detected), THRESHOLD * sd, false)


def _stays(torque: Array, start: int, stop: int, beside: int, sd: float, record: Record) -> bool:
    """Whether what begins and ends at these samples leaves the torque at another level, so many samples ``beside``."""
    first = record.segment_starts[record.segment_starts <= start].max()
    end = record.segment_starts[record.segment_starts >= stop].min(initial=len(torque))
    sides = torque[max(start - beside, first) : start], torque[stop : min(stop + beside, end)]
    return all(map(len, sides)) and abs(np.ptp(list(map(np.median, sides)))) > THRESHOLD * sd
