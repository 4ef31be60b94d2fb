"""Segments of settled flight in which attitude and inputs come fast and without gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from mavdem.alignment import phases
from mavdem.alignment.drive import Motors
from mavdem.alignment.intervals import Intervals, both, unbroken
from mavdem.alignment.signals import MINIMUM_RATE, Attitude, Signals

MEDIAN_STEPS = 41
"""Steps, about 1 s at ``MINIMUM_RATE``, whose median is a stream's usual step. A median follows a change of rate to the
very step, and is not moved by the loss of a fifth of the messages."""
STEP_TOLERANCE = 1.1
"""How much longer than 1/``MINIMUM_RATE`` usual steps may be, so that jitter of the stamps does not split a stream. The
verdict decides whether the mean rate of a segment is enough."""
MAX_GAP_SECONDS = 0.1  # Longest silence that is bridged: half a period of 5 Hz, a frequency at which roll still moves
STAMP_SECONDS = 1e-3  # Resolution of ``time_boot_ms``: two stamps no further apart may belong to the same moment


@dataclass(frozen=True)
class Segment:
    """Settled flight from ``start`` to ``end``, seconds on one boot's clock, with attitude and inputs throughout."""

    boot: int
    start: float
    end: float

    @property
    def duration(self) -> float:
        """Seconds from start to end."""
        return self.end - self.start


def settled_segments(signals: Signals) -> tuple[Segment, ...]:
    """Segments of one boot each: armed, airborne, settled, upright, fast and without gaps; the longest first.

    A step longer than ``MAX_GAP_SECONDS``, or messages that usually come slower than ``MINIMUM_RATE``, end a segment:
    ground stations change the rates in flight. Only where that leaves no segment at all is any rate allowed, and steps
    of three intervals; the verdict then decides.
    """
    attitude, drive = signals.attitude, signals.drive
    if attitude is None or drive is None:
        return ()
    found: list[Segment] = []
    for unbroken_runs in (_fast, _at_any_rate):
        for boot in np.intersect1d(attitude.boot, drive.boot):
            runs = [unbroken_runs(stream.time[stream.boot == boot]) for stream in (attitude, drive)]
            for start, end in both(both(*runs), phases.settled(signals, boot)):
                segment = Segment(int(boot), start, end)
                if segment.duration >= 1.0 and is_sampled(attitude, drive, segment):
                    found.append(segment)
        if found:
            break
    return tuple(sorted(found, key=lambda segment: -segment.duration))


def longest_recorded(signals: Signals) -> Segment | None:
    """The longest part, flown or not, in which attitude and inputs come without gaps, at any rate; None without any."""
    attitude, drive = signals.attitude, signals.drive
    if attitude is None or drive is None:
        return None
    found = (
        Segment(int(boot), start, end)
        for boot in np.intersect1d(attitude.boot, drive.boot)
        for start, end in both(*(_at_any_rate(stream.time[stream.boot == boot]) for stream in (attitude, drive)))
    )
    sampled = (segment for segment in found if is_sampled(attitude, drive, segment))
    return max(sampled, key=lambda segment: segment.duration, default=None)


def within(stream: Attitude | Motors, segment: Segment) -> NDArray[np.bool_]:
    """Which samples (N,) of the stream belong to the segment, those within ``STAMP_SECONDS`` of its ends included."""
    inside = (stream.time >= segment.start - STAMP_SECONDS) & (stream.time <= segment.end + STAMP_SECONDS)
    return np.asarray(inside & (stream.boot == segment.boot))


def is_sampled(attitude: Attitude, motors: Motors, segment: Segment) -> bool:
    """Whether both streams have the two samples in the segment that a rate takes, and a time in common."""
    near, driven = attitude.time[within(attitude, segment)], motors.time[within(motors, segment)]
    return len(near) > 1 < len(driven) and bool(max(near[0], driven[0]) <= min(near[-1], driven[-1]))


def _fast(time: NDArray[np.float64]) -> Intervals:
    """Where the stamps (N,) of one boot come at ``MINIMUM_RATE`` or faster and without gaps."""
    if len(time) < 2:
        return []
    steps = np.diff(time)
    return unbroken(time, _usually_slow(steps) | (steps > MAX_GAP_SECONDS))


def slow_runs(time: NDArray[np.float64]) -> Intervals:
    """Where the stamps (N,) of one boot usually come slower than ``MINIMUM_RATE``; outages are not slow."""
    return unbroken(time, ~_usually_slow(np.diff(time))) if len(time) > 1 else []


def _usually_slow(steps: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(median_filter(steps, size=MEDIAN_STEPS, mode="mirror") > STEP_TOLERANCE / MINIMUM_RATE)


def _at_any_rate(time: NDArray[np.float64]) -> Intervals:
    """Where the stamps (N,) of one boot come without gaps, by the measure of their own usual step."""
    if len(time) < 2:
        return []
    steps = np.diff(time)
    return unbroken(time, steps > max(MAX_GAP_SECONDS, 3 * float(np.median(steps))))
