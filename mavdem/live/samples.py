"""The latest samples of one stream, in the order of their stamps."""

from __future__ import annotations

from bisect import bisect_left
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

from mavdem.alignment.align import MAX_GAP_SECONDS, MEDIAN_STEPS, mean_rate
from mavdem.live.messages import Values

KEPT_SECONDS = 2.5  # Enough to decide rates and steps
MAX_SAMPLES = 8192


class SampleBuffer:
    """Stamps and values of the last ``KEPT_SECONDS`` since the last gap.

    ``time``: (N,) s, ascending. ``values``: (N,) tuples. ``gap``: the step, s, before the latest sample, if longer than
    ``MAX_GAP_SECONDS``; else 0. ``added``: number of samples so far. ``late``: number of samples that came after the
    row they belong to. ``used_until``: s; rows up to it are complete, and samples before it are late.
    """

    def __init__(self) -> None:
        self.time: list[float] = []
        self.values: list[Values] = []
        self.gap, self.added, self.late = 0.0, 0, 0
        self.used_until = -inf
        self._recent: list[float] = []

    def add(self, time: float, values: Values) -> bool:
        """Adds a sample; returns False for a copy, a repeated stamp, a late sample and values that are not finite."""
        if not all(map(isfinite, values)):
            return False
        self.gap = 0.0
        if not self.time or time > self.time[-1]:
            if self.time and time - self.time[-1] > MAX_GAP_SECONDS:
                self.gap = time - self.time[-1]
                self.clear()
            self.time.append(time)
            self.values.append(values)
        else:
            row = bisect_left(self.time, time)
            if self.time[row] == time:
                return False
            if time <= self.used_until or row == 0:
                self.late += 1
                return False
            self.time.insert(row, time)
            self.values.insert(row, values)
        self.added += 1
        self._recent.append(self.time[-1])
        # Only now and then: deleting from the front of a list moves all of it.
        if len(self.time) > MAX_SAMPLES or (self.added % 64 == 0 and self.time[0] < self.time[-1] - KEPT_SECONDS):
            drop = max(bisect_left(self.time, self.time[-1] - KEPT_SECONDS), len(self.time) - MAX_SAMPLES // 2, 0)
            del self.time[:drop], self.values[:drop]
        recent = self._recent
        if len(recent) > MAX_SAMPLES or recent[0] < recent[-1] - 2 * KEPT_SECONDS:
            del recent[: max(bisect_left(recent, recent[-1] - KEPT_SECONDS), len(recent) - MAX_SAMPLES)]
        return True

    def clear(self) -> None:
        """Removes the samples; the rate stays."""
        self.time.clear()
        self.values.clear()

    def rate(self, now: float, over: float) -> float:
        """Hz over the last ``over`` seconds before ``now``, gaps included; 0 with fewer than two samples."""
        since = self._recent[bisect_left(self._recent, now - over) :]
        return mean_rate(np.array(since)) if len(since) > 1 and since[-1] > since[0] else 0.0

    def count(self, now: float, over: float) -> int:
        """Samples in the last ``over`` seconds before ``now``."""
        return len(self._recent) - bisect_left(self._recent, now - over)

    def usual_step(self, samples: int = MEDIAN_STEPS) -> float | None:
        """Mean, s, of the middle half of the last steps, robust to jitter and to one lost in five; None if few."""
        if len(self.time) <= samples:
            return None
        latest = self.time[-samples - 1 :]
        steps = sorted(after - before for before, after in zip(latest, latest[1:], strict=False))
        middle = steps[samples // 4 : samples - samples // 4]
        return sum(middle) / len(middle)

    def interpolate(self, time: float) -> Values:
        """Linear interpolation at ``time``, which must lie between the first and the last sample."""
        after = bisect_left(self.time, time)
        if self.time[after] == time:
            return self.values[after]
        before = after - 1
        start, span = self.time[before], self.time[after] - self.time[before]
        return tuple(
            (right - left) / span * (time - start) + left
            for left, right in zip(self.values[before], self.values[after], strict=True)
        )

    def nearest(self, time: float, within: float) -> Values | None:
        """The sample nearest to ``time``; None if it is farther than ``within``."""
        after = bisect_left(self.time, time)
        rows = [row for row in (after - 1, after) if 0 <= row < len(self.time)]
        row = min(rows, key=lambda row: abs(self.time[row] - time), default=None)
        return None if row is None or abs(self.time[row] - time) > within else self.values[row]

    def between(self, start: float, end: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Stamps (N,) and values (N, k) from one sample before ``start`` to one after ``end``, where they exist."""
        rows = slice(max(bisect_left(self.time, start) - 1, 0), bisect_left(self.time, end) + 1)
        return np.array(self.time[rows]), np.array(self.values[rows])
