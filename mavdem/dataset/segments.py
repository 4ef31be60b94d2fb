"""Segments of a log: parts of one boot in which attitude and model inputs were recorded without gaps."""

from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
import scipy

from mavdem.arrays import Array, Flags
from mavdem.dataset import phases
from mavdem.dataset.attitude import Attitude
from mavdem.dataset.flight_states import mode_intervals
from mavdem.dataset.intervals import Intervals, complement, intersection, split_at_gaps
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.resampling import STAMP_RESOLUTION
from mavdem.dataset.signals import MIN_STREAM_RATE, Signals
from mavdem.dataset.time_series import TimeSeries, rows_of_boot
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.ingest.telemetry import MAX_GAP_SECONDS

MEDIAN_STEPS = 41
"""Number of steps between stamps whose running median is the usual step, about 1 s at ``MIN_STREAM_RATE``.

A median follows a change of rate to the very step, and the loss of a fifth of the messages does not move it.
"""

STEP_TOLERANCE = 1.1
"""Usual step of a stream, in steps at ``MIN_STREAM_RATE``, above which the stream is too slow.

Jitter of the stamps must not split a stream. Learnability decides whether the mean rate of a segment is enough.
"""

MAX_STEP_AT_ANY_RATE = 3.0
"""Step, in median steps, above which a stream of any rate has a gap; a choice."""

MIN_SEGMENT_SECONDS = 1.0
"""Duration, s, below which settled flight makes no segment."""

MESSAGES_FROM_BEFORE_LOG = frozenset(("STATUSTEXT", "action_request", "vehicle_command"))
"""Texts and requests: a log may begin with those that waited for it, some of them a minute old."""


@dataclass(frozen=True, order=True)
class Segment:
    """A span of one boot; segments sort by boot and time."""

    boot: int
    """Number of the boot, from 0."""
    start: float
    """Seconds on the clock of that boot."""
    end: float
    """Seconds on the clock of that boot."""

    @property
    def duration(self) -> float:
        """Seconds from start to end."""
        return self.end - self.start


Segments = Sequence[Segment]
"""Segments of one flight, or of a log."""


@cached_per_vehicle()
def recorded_spans(signals: Signals) -> Segments:
    """Returns the span of time in which something was recorded, for each boot.

    ``MESSAGES_FROM_BEFORE_LOG`` do not count.

    Args:
        signals: signals of the vehicle, with its messages.

    Returns:
        One segment per boot, from the first to the last finite stamp of its messages, s since boot.
    """
    messages = []
    boot_count = 1
    for name, columns in signals.telemetry.messages.items():
        if name not in MESSAGES_FROM_BEFORE_LOG:
            messages.append(columns)
            last_boot = int(columns["boot"].max(initial=0))
            boot_count = max(boot_count, last_boot + 1)
    # The earliest and the latest stamp of each boot so far, by the number of the boot.
    first_stamps = np.full(boot_count, np.inf)
    last_stamps = np.full(boot_count, -np.inf)
    for columns in messages:
        is_finite = np.isfinite(columns["time"])
        stamps = columns["time"][is_finite]
        boots = columns["boot"][is_finite]
        np.minimum.at(first_stamps, boots, stamps)
        np.maximum.at(last_stamps, boots, stamps)
    spans = []
    for boot in range(boot_count):
        has_messages = np.isfinite(first_stamps[boot])
        if has_messages:
            spans.append(Segment(boot, float(first_stamps[boot]), float(last_stamps[boot])))
    return tuple(spans)


@cached_per_vehicle("axis", "inputs")
def settled_segments(signals: Signals) -> Segments:
    """Returns the segments of settled flight in which attitude and model inputs come fast and without gaps.

    Settled flight has neither take-off nor landing. A segment of it ends at a gap longer than ``MAX_GAP_SECONDS``, and
    where the usual rate falls below ``MIN_STREAM_RATE``, since ground stations change rates in flight. Only if no
    segment at all remains, any rate is allowed, with gaps up to three times the usual step; whether such a segment can
    be used is decided later (``learnability``).

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        Segments of one boot each, the longest first.
    """
    for intervals_without_gaps in (_fast_intervals, _intervals_at_any_rate):
        segments = []
        for boot in _boots_with_both_streams(signals):
            settled_intervals = phases.settled_intervals(signals, boot)
            segments += _sampled_segments(signals, boot, settled_intervals, intervals_without_gaps)
        long_segments = [segment for segment in segments if segment.duration >= MIN_SEGMENT_SECONDS]
        if long_segments:
            return tuple(sorted(long_segments, key=lambda segment: -segment.duration))
    return ()


def longest_recorded_segment(signals: Signals) -> Segment | None:
    """Returns the longest part of a log in which attitude and model inputs were recorded without a gap.

    It describes logs without settled flight, from which no model can be learned: the vehicle may be on the ground, and
    its messages may be slow.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of one axis.

    Returns:
        The segment; None if the two were never recorded together.
    """
    # A segment may lie anywhere in a boot, which lasts from one start of the autopilot to the next.
    whole_boot = [(-inf, inf)]
    segments = []
    for boot in _boots_with_both_streams(signals):
        segments += _sampled_segments(signals, boot, whole_boot, _intervals_at_any_rate)
    return max(segments, key=lambda segment: segment.duration, default=None)


def segments_without_modes(signals: Signals, segments: Segments, modes: Container[str]) -> Segments:
    """Removes from segments the times in which the vehicle was in one of some flight modes.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        segments: number of the boot, start and end of each segment, s.
        modes: names of the flight modes to remove ("Land").

    Returns:
        The remaining segments, in the order of those that they belong to.
    """
    remaining_segments = []
    for segment in segments:
        intervals_in_modes = mode_intervals(signals, segment.boot, modes)
        intervals_in_other_modes = complement(intervals_in_modes)
        whole_segment = (segment.start, segment.end)
        for start, end in intersection([whole_segment], intervals_in_other_modes):
            remaining_segments.append(Segment(segment.boot, start, end))
    return tuple(remaining_segments)


def in_segments(
    stream: Attitude | MotorOutputs | TimeSeries,
    *segments: Segment,
    slack: float = STAMP_RESOLUTION,
) -> Flags:
    """Flags the samples of a stream that belong to any of several segments.

    Args:
        stream: N samples with their times and boots.
        segments: Number of the boot, start and end of each segment, s.
        slack: Seconds beyond the ends of a segment whose samples still belong to it.

    Returns:
        Flags (N,).
    """
    is_inside = np.zeros(len(stream.time), dtype=bool)
    for segment in segments:
        is_inside[rows_of_segment(stream, segment, slack)] = True
    return is_inside


def rows_of_segment(
    stream: Attitude | MotorOutputs | TimeSeries,
    segment: Segment,
    slack: float = STAMP_RESOLUTION,
) -> slice:
    """Returns the samples of a stream that belong to a segment of flight, as a slice.

    They are found by bisection, since streams are sorted by boot and time. A log of hours has hundreds of segments, for
    which a comparison with every sample is slow.

    Args:
        stream: Samples with their times and boots.
        segment: Number of the boot, start and end of the segment, s.
        slack: Seconds beyond its ends whose samples still belong to it.

    Returns:
        The slice of the whole stream.
    """
    boot_slice = rows_of_boot(stream.boot, segment.boot)
    time = stream.time[boot_slice]
    # Indices within the boot, of the first sample of the segment and of the first one after it.
    first = int(np.searchsorted(time, segment.start - slack))
    stop = int(np.searchsorted(time, segment.end + slack, side="right"))
    return slice(boot_slice.start + first, boot_slice.start + stop)


def _boots_with_both_streams(signals: Signals) -> list[int]:
    """Returns the numbers of all boots with both attitude and model inputs."""
    if signals.attitude is None or signals.model_inputs is None:
        return []
    boots = np.intersect1d(signals.attitude.boot, signals.model_inputs.boot)
    return [int(boot) for boot in boots]


def _sampled_segments(
    signals: Signals,
    boot: int,
    allowed_intervals: Intervals,
    intervals_without_gaps: Callable[[Array], Intervals],
) -> list[Segment]:
    """Finds the segments of a boot in which neither attitude nor model inputs have a gap.

    Args:
        signals: Signals of the vehicle, with attitude and model inputs.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.
        allowed_intervals: The intervals of the boot in which segments may lie, s.
        intervals_without_gaps: Function that returns the intervals between the gaps of a stream, from its stamps (N,).

    Returns:
        The segments, in time order.
    """
    attitude, inputs = signals.attitude_and_inputs
    attitude_time = attitude.time[rows_of_boot(attitude.boot, boot)]
    input_time = inputs.time[rows_of_boot(inputs.boot, boot)]
    common_intervals = intersection(
        intervals_without_gaps(attitude_time), intervals_without_gaps(input_time)
    )
    segments = []
    for start, end in intersection(common_intervals, allowed_intervals):
        segment = Segment(boot, start, end)
        if _has_samples_of_both(attitude, inputs, segment):
            segments.append(segment)
    return segments


def _has_samples_of_both(attitude: Attitude, inputs: MotorOutputs, segment: Segment) -> bool:
    """Returns whether attitude and model inputs of a segment can be resampled to a common grid.

    Interpolation needs two samples of each stream, and the grid needs a time that both streams cover.

    Args:
        attitude: attitude of the axis, of all boots.
        inputs: motor outputs or demand, of all boots.
        segment: number of the boot, start and end of the segment, s.
    """
    attitude_time = attitude.time[rows_of_segment(attitude, segment)]
    input_time = inputs.time[rows_of_segment(inputs, segment)]
    if len(attitude_time) < 2 or len(input_time) < 2:
        return False
    common_start = max(attitude_time[0], input_time[0])
    common_end = min(attitude_time[-1], input_time[-1])
    return bool(common_start <= common_end)


def _fast_intervals(time: Array) -> Intervals:
    """Finds the intervals in which a stream has no gaps, and comes at ``MIN_STREAM_RATE`` or faster.

    Args:
        time: (N,) stamps of the messages of one boot, s, ascending.

    Returns:
        Start and end of each interval, s; none with fewer than two messages.
    """
    if len(time) < 2:
        return []
    steps = np.diff(time)
    return split_at_gaps(time, slow_steps(steps) | (steps > MAX_GAP_SECONDS))


def slow_steps(steps: Array) -> Flags:
    """Flags the parts of a stream in which it is slower than ``MIN_STREAM_RATE``, about 1 s around each step.

    Args:
        steps: (N,) times between successive stamps of the stream, s.

    Returns:
        Flags (N,): whether the running median of ``MEDIAN_STEPS`` steps is longer than the rate allows.
    """
    usual_steps = scipy.ndimage.median_filter(steps, size=MEDIAN_STEPS, mode="mirror")
    max_usual_step = STEP_TOLERANCE / MIN_STREAM_RATE
    return usual_steps > max_usual_step


def _intervals_at_any_rate(time: Array) -> Intervals:
    """Finds the intervals in which a stream has no gaps, however slow it is.

    A gap is longer than ``MAX_GAP_SECONDS``, and longer than ``MAX_STEP_AT_ANY_RATE`` median steps of the stream.

    Args:
        time: (N,) stamps of the messages of one boot, s, ascending.

    Returns:
        Start and end of each interval, s; none with fewer than two messages.
    """
    if len(time) < 2:
        return []
    steps = np.diff(time)
    max_step = max(MAX_GAP_SECONDS, MAX_STEP_AT_ANY_RATE * np.median(steps))
    return split_at_gaps(time, steps > max_step)
