"""Gusts: where the wind's torque leaves its running level by more than its turbulence does, and returns to it.

They last as long as the estimate resolves. A step that stays, as of a motor that weakens, is none.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from mavdem.confidence import quantile
from mavdem.dem.engine.linalg import Array
from mavdem.dem.graybox.parameters import Physical, wind_density
from mavdem.dem.record import Record

# of the estimate's variance, that its errors may have before it is not resolved
MAX_ERROR_SHARE = 0.75
LEVEL_SECONDS = 10.0  # of the running median, which a gust stands out from
LEVEL_STEP_SECONDS = 0.1  # between samples of that median
THRESHOLD = 4.0  # standard deviations from it, by the median absolute deviation
END = 0.5  # of the threshold, within which a gust begins and ends
# half widths of the band, which a gust exceeds: errors in quick manoeuvres are no gusts
CERTAIN = 2.0
NORMAL_MEDIAN = 0.6745  # absolute deviation of a normal distribution, in standard deviations


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


def shortest_gust(physical: Physical, dt: float) -> float:
    """Returns how long a gust lasts at least, s: half a period of the fastest wind that the estimate resolves.

    That is above the noise of the rate, and below half of the Nyquist frequency. And the time that the motors take to
    answer, within which an error of lag or delay looks like a gust.
    """
    frequency = np.linspace(0.0, 0.25 / dt, 201)[1:]
    noise = 2 * dt * physical.noise**2 * ((2 * np.pi * frequency) ** 2 + physical.damping**2)
    resolved = frequency[wind_density(physical, frequency) > noise]
    return 0.5 / float(resolved.max(initial=frequency[0])) + physical.lag + physical.delay


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
    parts = np.split(torque, record.starts[1:])
    bands = np.split(band, record.starts[1:])
    away = [part - _level(part, record.dt) for part in parts]
    sd = float(np.median(np.abs(np.concatenate(away)))) / NORMAL_MEDIAN
    if sd == 0.0 or np.mean((band / quantile()) ** 2) > MAX_ERROR_SHARE * np.var(torque):
        return Gusts((), THRESHOLD * sd, 0.0)
    slopes = np.concatenate([np.diff(part) for part in away]) / record.dt
    # Likewise by the median, so that gusts do not count.
    crossings = float(np.median(np.abs(slopes))) / NORMAL_MEDIAN / sd / (2 * np.pi)
    false = 2 * 60 * crossings * float(np.exp(-(THRESHOLD**2) / 2))
    detected = []
    beside = round(LEVEL_SECONDS / 2 / record.dt)
    for first, whole, part, width in zip(record.starts.tolist(), parts, away, bands, strict=True):
        # A change of sign ends a gust.
        signs = np.sign(part) * (np.abs(part) > END * THRESHOLD * sd)
        edges = [0, *(1 + np.flatnonzero(np.diff(signs))).tolist(), len(part)]
        for start, stop in pairwise(edges):
            peak = start + int(np.argmax(np.abs(part[start:stop])))
            length = (stop - start) * record.dt
            sides = [whole[max(start - beside, 0) : start], whole[stop : stop + beside]]
            stays = (
                all(map(len, sides)) and abs(np.ptp(list(map(np.median, sides)))) > THRESHOLD * sd
            )
            high = abs(part[peak]) > max(THRESHOLD * sd, CERTAIN * width[peak])
            if high and length >= shortest and not stays:
                at = first + start
                detected.append(DetectedGust(at, at * record.dt, length, float(part[peak])))
    return Gusts(tuple(detected), THRESHOLD * sd, false)


def _level(part: Array, dt: float) -> Array:
    """(T,) the running median of a segment."""
    stride = max(1, round(LEVEL_STEP_SECONDS / dt))
    coarse = part[::stride]
    width = min(len(coarse), round(LEVEL_SECONDS / (stride * dt)))
    median = median_filter(coarse, width | 1, mode="nearest")
    return np.interp(np.arange(len(part)), np.arange(len(coarse)) * stride, median)
