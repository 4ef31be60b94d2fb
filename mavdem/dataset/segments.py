"""Segments of a log: spans of one boot in which attitude and model inputs were recorded without gaps."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from mavdem.arrays import Array, Flags
from mavdem.dataset import phases
from mavdem.dataset.attitude import Attitude
from mavdem.dataset.intervals import Intervals, intersection, split_at_gaps
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.resampling import (
    STAMP_RESOLUTION,
    STEP_TOLERANCE,
)
from mavdem.dataset.signals import MIN_STREAM_RATE, Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.ingest.telemetry import (
    MAX_GAP_SECONDS,
)

pass


MEDIAN_STEPS = 41
"""Steps, about 1 s at ``MINIMUM_RATE``, whose median is a stream's usual step. A median follows a change of rate to the
very step, and is not moved by the loss of a fifth of the messages."""


@dataclass(frozen=True, order=True)
class Segment:
    """Settled flight from ``start`` to ``end``, seconds on one boot's clock, with attitude and inputs throughout."""

    boot: int
    start: float
    end: float

    @property
    def duration(self) -> float:
        """Seconds from start to end."""
        return self.end - self.start


Segments = Sequence[Segment]
"""Of one flight, or of a log."""


@cached_per_vehicle()
def recorded_spans(signals: Signals) -> Segments:
    """Returns each boot from its first message to its last, but for texts: a log may begin with older ones."""
    messages = [
        columns for name, columns in signals.telemetry.messages.items() if name != "STATUSTEXT"
    ]
    if not messages:
        return ()
    time, boot = (
        np.concatenate([columns[name] for columns in messages]) for name in ("time", "boot")
    )
    parts = []
    for number in np.unique(boot[np.isfinite(time)]):
        stamps = time[(boot == number) & np.isfinite(time)]
        parts.append(Segment(int(number), float(stamps.min()), float(stamps.max())))
    return tuple(parts)


@cached_per_vehicle("axis", "inputs")
def settled_segments(signals: Signals) -> Segments:
    """Returns segments of one boot each: armed, airborne, settled, upright, fast and without gaps; the longest first.

    A step longer than ``MAX_GAP_SECONDS``, or messages that usually come slower than ``MINIMUM_RATE``, end a segment:
    ground stations change the rates in flight. Only where that leaves no segment at all is any rate allowed, and steps
    of three intervals; learnability then decides.
    """
    segments: list[Segment] = []
    for unbroken_runs in (_fast, _at_any_rate):
        sampled = _sampled(
            signals, unbroken_runs, lambda boot: phases.settled_intervals(signals, boot)
        )
        segments = segments or [segment for segment in sampled if segment.duration >= 1.0]
    return tuple(sorted(segments, key=lambda segment: -segment.duration))


def longest_recorded_segment(signals: Signals) -> Segment | None:
    """Returns the longest part, flown or not, with attitude and inputs without gaps, at any rate; None without any."""
    sampled = _sampled(signals, _at_any_rate, lambda _: [(-np.inf, np.inf)])
    return max(sampled, key=lambda segment: segment.duration, default=None)


def _sampled(
    signals: Signals,
    unbroken_runs: Callable[[Array], Intervals],
    wanted: Callable[[int], Intervals],
) -> Iterator[Segment]:
    """Where both streams are unbroken, in the ``wanted`` intervals of each boot."""
    attitude = signals.attitude
    drive = signals.model_inputs
    if attitude is not None and drive is not None:
        for boot in np.intersect1d(attitude.boot, drive.boot):
            runs = (unbroken_runs(stream.time[stream.boot == boot]) for stream in (attitude, drive))
            for span in intersection(intersection(*runs), wanted(int(boot))):
                if has_both_streams(attitude, drive, segment := Segment(int(boot), *span)):
                    yield segment


def in_segments(
    stream: Attitude | MotorOutputs | TimeSeries,
    *segments: Segment,
    slack: float = STAMP_RESOLUTION,
) -> Flags:
    """Returns which samples (N,) belong to the segments, those up to ``slack``, s, beyond an end included."""
    inside = np.zeros(len(stream.time), dtype=bool)
    for part in segments:
        near = (stream.time >= part.start - slack) & (stream.time <= part.end + slack)
        inside |= near & (stream.boot == part.boot)
    return inside


def has_both_streams(attitude: Attitude, motors: MotorOutputs, segment: Segment) -> bool:
    """Returns whether both streams have the two samples in the segment that a rate takes, and a time in common."""
    near = attitude.time[in_segments(attitude, segment)]
    driven = motors.time[in_segments(motors, segment)]
    return len(near) > 1 < len(driven) and bool(
        max(near[0], driven[0]) <= min(near[-1], driven[-1])
    )


def _fast(time: Array) -> Intervals:
    """Where the stamps (N,) of one boot come at ``MINIMUM_RATE`` or faster and without gaps."""
    steps = np.diff(time)
    return (
        split_at_gaps(time, slow_steps(steps) | (steps > MAX_GAP_SECONDS)) if len(time) > 1 else []
    )


def slow_steps(steps: Array) -> Flags:
    """Returns which steps (N,) between the stamps of one boot are usually too long for ``MINIMUM_RATE``."""
    return median_filter(steps, size=MEDIAN_STEPS, mode="mirror") > STEP_TOLERANCE / MIN_STREAM_RATE


def _at_any_rate(time: Array) -> Intervals:
    """Where the stamps (N,) of one boot come without gaps, by the measure of their own usual step."""
    steps = np.diff(time)
    return (
        split_at_gaps(time, steps > max(MAX_GAP_SECONDS, 3 * np.median(steps)))
        if len(time) > 1
        else []
    )
