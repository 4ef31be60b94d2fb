"""The latest samples of one live stream of attitude or motor outputs, in the order of their time stamps."""

from array import array
from bisect import bisect_left
from math import inf, isfinite, nextafter

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import Numbers
from mavdem.dataset import resampling, segments
from mavdem.ingest.telemetry import MAX_GAP_SECONDS

MEMORY_SECONDS = 9.0
"""Duration that a stream keeps, s.

It is more than the ``DECISION_SECONDS`` that rates and steps are decided from, and than the recent flight in which a
limit cycle is looked for: ``STARTING_SPAN`` times the first of ``WINDOW_LENGTHS`` (``loops/limit_cycles.py``), 8.8 s,
or the second with ``SPAN_SLACK``, 8.2 s.
"""

MAX_SAMPLES = 8192
"""Samples that a stream keeps, a choice: 9 s at 900 Hz. It bounds the memory for hostile stamps."""

DECISION_SECONDS = 2.0
"""Duration of the streams by which rates, the step of the grid and the way of sampling are decided, s: a choice."""

SAMPLES_PER_CLEANING = 64
"""Samples between two removals of old ones, a choice: removing from the front of a list moves all of it."""


class SampleStream:
    """Time stamps and values of one stream of samples, attitude or one port of motor outputs, in the last 9 s.

    Attributes:
        time: stamps, s of the boot clock, ascending.
        gap: step before the latest sample, s, if it is longer than ``MAX_GAP_SECONDS``; otherwise 0.
        added_count: number of samples so far.
        late_count: number of samples that were dropped, since they came after the row they belong to.
        completed_time: rows up to this time are complete, s; samples before it are late.
    """

    def __init__(self) -> None:
        """Makes an empty stream of samples."""
        self.time: list[float] = []
        self.gap = 0.0
        self.added_count = 0
        self.late_count = 0
        self.completed_time = -inf
        # The k values of each stamp, one sample after the other: a review of the flight needs the latest seconds as an
        # array twice a second, and these become one without a conversion of each number.
        self._values = array("d")
        self._value_count = 0
        # First time after the latest gap, s; earlier samples count no more.
        self._gap_end = -inf

    @property
    def start_time(self) -> float:
        """Time of the first kept sample since the last gap, s; infinite without any."""
        return max(self._gap_end, self.time[0]) if self.time else inf

    def add(self, time: float, values: Numbers) -> bool:
        """Adds a sample at its place in the order of stamps, since samples may overtake each other on the network.

        It also notes whether the sample follows a gap, and drops old samples once in a while.

        Args:
            time: stamp, s of the boot clock.
            values: values of the sample; all samples of the stream have the same number of values.

        Returns:
            Whether the sample was added. It is not if a value is not finite, if a sample with its stamp is there
            already, or if it is late: the row at its time was made already, or a gap has begun another segment since.
        """
        if not all(isfinite(value) for value in values):
            return False
        stamps = self.time
        # The place of the sample in the order of stamps: nearly always the end.
        index = bisect_left(stamps, time)
        is_latest = index == len(stamps)
        if not is_latest:
            is_copy = stamps[index] == time
            is_late = time <= max(self.completed_time, self.start_time)
            if is_copy:
                return False
            if is_late:
                self.late_count += 1
                return False
        self._update_gap(time, is_latest=is_latest)
        stamps.insert(index, time)
        self._value_count = len(values)
        first_value = index * self._value_count
        # An empty slice is replaced, which inserts the values.
        self._values[first_value:first_value] = array("d", values)
        self.added_count += 1
        if self.added_count % SAMPLES_PER_CLEANING == 0:
            self._drop_old_samples()
        return True

    def _update_gap(self, time: float, *, is_latest: bool) -> None:
        """Notes how long the gap before a new sample is, if it is one, before the sample is added.

        Args:
            time: stamp of the sample, s of the boot clock.
            is_latest: whether the sample is the latest; an earlier one lies between two others, and ends no gap.
        """
        self.gap = 0.0
        if not is_latest or not self.time:
            return
        step = time - self.time[-1]
        if step > MAX_GAP_SECONDS:
            self.gap = step
            self._gap_end = time

    def sample(self, index: int) -> Numbers:
        """Returns the values of one sample.

        Args:
            index: number of the sample in ``time``, from 0.
        """
        first_value = index * self._value_count
        return tuple(self._values[first_value : first_value + self._value_count])

    @property
    def latest(self) -> Numbers:
        """Values of the latest sample by its stamp; empty before any."""
        return self.sample(len(self.time) - 1) if self.time else ()

    def table(self) -> Array:
        """Returns the values of all samples, of which there must be one, as a copy: (N, k) in the order of ``time``."""
        return np.array(self._values).reshape(len(self.time), -1)

    def _drop_old_samples(self) -> None:
        """Drops samples older than ``MEMORY_SECONDS``, and the oldest ones beyond ``MAX_SAMPLES``."""
        old_count = bisect_left(self.time, self.time[-1] - MEMORY_SECONDS)
        excess_count = len(self.time) - MAX_SAMPLES
        dropped_count = max(old_count, excess_count)
        del self.time[:dropped_count]
        del self._values[: dropped_count * self._value_count]

    def break_off(self) -> None:
        """Separates the samples so far from the next one, as a gap does, since the next ones have another rate."""
        if self.time:
            # The smallest time after the last sample.
            self._gap_end = nextafter(self.time[-1], inf)

    def recent_count(self, now: float) -> int:
        """Returns the number of samples in the ``DECISION_SECONDS`` before ``now``, s."""
        return len(self.time) - bisect_left(self.time, now - DECISION_SECONDS)

    def recent_rate(self, now: float) -> float:
        """Returns the mean rate of the samples in the last ``DECISION_SECONDS``.

        Gaps between samples lower the rate.

        Args:
            now: present time on the boot clock, s.

        Returns:
            Rate, Hz; 0 with fewer than two samples.
        """
        count = self.recent_count(now)
        if count < 2:
            # A rate needs a step between two stamps.
            return 0.0
        recent_stamps = self.time[-count:]
        return resampling.mean_rate(recent_stamps)

    def rate_since_gap(self) -> float | None:
        """Returns the mean rate over the last ``DECISION_SECONDS``, or since the latest gap if that is shorter.

        Returns:
            The rate, Hz; None with ``MEDIAN_STEPS`` samples or fewer, whose rate would be chance.
        """
        start_time = max(self.start_time, self.time[-1] - DECISION_SECONDS)
        first_index = bisect_left(self.time, start_time)
        recent_stamps = self.time[first_index:]
        if len(recent_stamps) <= segments.MEDIAN_STEPS:
            return None
        return resampling.mean_rate(recent_stamps)

    def nearest(self, time: float) -> Numbers | None:
        """Returns the values of the sample at a time, or of the nearest one within the resolution of stamps.

        Args:
            time: time on the boot clock, s.

        Returns:
            The values; None if no stamp is as near as ``STAMP_RESOLUTION``. Of two equally near samples it is the
            earlier one.
        """
        # The nearest sample is either the last one before the time, or the first one at or after it.
        next_index = bisect_left(self.time, time)
        nearest_index = None
        nearest_distance = inf
        for index in (next_index - 1, next_index):
            if 0 <= index < len(self.time):
                distance = abs(self.time[index] - time)
                if distance < nearest_distance:
                    nearest_index = index
                    nearest_distance = distance
        if nearest_index is None or nearest_distance > resampling.STAMP_RESOLUTION:
            return None
        return self.sample(nearest_index)

    def weighted_sum(self, time: float, weights: Array, offsets: Array) -> Numbers:
        """Returns the weighted sum of interpolated values around a time: a finite impulse response (FIR) filter.

        The filter's taps are equally spaced, while stamps jitter, so that values are interpolated linearly at the taps.
        A single weight of 1 at offset 0 is plain interpolation. Samples from before the last gap are not used.

        Args:
            time: time on the boot clock, s.
            weights: (L,) weight of each tap.
            offsets: (L,) time of each tap relative to ``time``, ascending, s.

        Returns:
            The sum for each value of a sample, in its unit.
        """
        tap_times = time + offsets
        # The samples around the taps: from the last one before the first tap to the first one at or after the last tap.
        first_index_since_gap = bisect_left(self.time, self.start_time)
        first_index = max(bisect_left(self.time, tap_times[0]) - 1, first_index_since_gap)
        end_index = bisect_left(self.time, tap_times[-1]) + 1
        stamps = self.time[first_index:end_index]
        value_count = self._value_count
        flat_values = self._values[first_index * value_count : end_index * value_count]
        samples = np.array(flat_values).reshape(-1, value_count)
        values_at_taps = [np.interp(tap_times, stamps, column) for column in samples.T]
        return tuple((np.array(values_at_taps) @ weights).tolist())
