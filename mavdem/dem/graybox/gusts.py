"""Gusts: where the wind's torque leaves its running level by more than its turbulence does."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from mavdem.dem.engine.linalg import Array
from mavdem.dem.record import Record

LEVEL_SECONDS = 10.0  # of the running median, which a gust stands out from
LEVEL_STEP_SECONDS = 0.1  # between samples of that median
THRESHOLD = 4.0  # standard deviations from it, by the median absolute deviation
END = 0.5  # of the threshold, within which a gust begins and ends
CERTAIN = 2.0  # half widths of the band, which a gust exceeds: errors in quick manoeuvres are no gusts
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


def gusts(torque: Array, band: Array, record: Record) -> Gusts:
    """Of the wind's ``torque`` (T,) in a record, and no less than twice the half width of its ``band`` (T,).

    The rate of false ones is that at which a Gaussian process of the same variance and the same variance of its
    derivative crosses the threshold, on both sides (Rice, "Mathematical analysis of random noise", 1944, sec. 3.3).
    """
    parts, bands = np.split(torque, record.starts[1:]), np.split(band, record.starts[1:])
    away = [part - _level(part, record.dt) for part in parts]
    sd = float(np.median(np.abs(np.concatenate(away)))) / NORMAL_MEDIAN
    if sd == 0.0:
        return Gusts((), 0.0, 0.0)
    slopes = np.concatenate([np.diff(part) for part in away]) / record.dt
    # Likewise by the median, so that gusts do not count.
    crossings = float(np.median(np.abs(slopes))) / NORMAL_MEDIAN / sd / (2 * np.pi)
    false = 2 * 60 * crossings * float(np.exp(-(THRESHOLD**2) / 2))
    found = []
    for first, part, width in zip(record.starts.tolist(), away, bands, strict=True):
        outside = np.concatenate([[False], np.abs(part) > END * THRESHOLD * sd, [False]])
        # A change of sign ends a gust.
        edges = np.flatnonzero(np.diff(outside * np.sign(np.concatenate([[0], part, [0]]))))
        for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            peak = start + int(np.argmax(np.abs(part[start:stop])))
            if abs(part[peak]) > max(THRESHOLD * sd, CERTAIN * width[peak]):
                sample = first + start
                found.append(DetectedGust(sample, sample * record.dt, (stop - start) * record.dt, float(part[peak])))
    return Gusts(tuple(found), THRESHOLD * sd, false)


def _level(part: Array, dt: float) -> Array:
    """(T,) the running median of a segment."""
    stride = max(1, round(LEVEL_STEP_SECONDS / dt))
    coarse = part[::stride]
    width = min(len(coarse), round(LEVEL_SECONDS / (stride * dt)))
    median = median_filter(coarse, width | 1, mode="nearest")
    return np.interp(np.arange(len(part)), np.arange(len(coarse)) * stride, median)
