"""The latest samples of one stream, in the order of their stamps."""

from __future__ import annotations

from bisect import bisect_left
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

from mavdem.align import GAP, USUAL, mean_rate
from mavdem.ingest.live_messages import Values

KEPT = 2.5
"""Seconds that are kept: what rates and steps are decided from, and a little."""
MOST = 8192
"""Samples kept at most."""


class Samples:
    """Stamps and values of the last ``KEPT`` seconds since the last gap.

    Attributes:
        time: s, ascending.
        values: beside them.
        parted: the step, s, longer than ``GAP``, that the latest sample came after; 0 where it did not.
        taken: samples so far.
        late: samples that came after what they belong to was told.
    """

    def __init__(self) -> None:
        """Begins without a sample."""
        self.time: list[float] = []
        self.values: list[Values] = []
        self.parted, self.taken, self.late = 0.0, 0, 0
        self._told = -inf
        self._recent: list[float] = []

    def add(self, time: float, values: Values) -> bool:
        """Takes a sample, and tells whether it is new: no copy, no stamp of another, not too late, and finite."""
        if not all(map(isfinite, values)):
            return False
        self.parted = 0.0
        if not self.time or time > self.time[-1]:
            if self.time and time - self.time[-1] > GAP:
                self.parted = time - self.time[-1]
                self.clear()
            self.time.append(time)
            self.values.append(values)
        else:
            row = bisect_left(self.time, time)
            if self.time[row] == time:
                return False
            if time <= self._told or row == 0:
                self.late += 1
                return False
            self.time.insert(row, time)
            self.values.insert(row, values)
        self.taken += 1
        self._recent.append(self.time[-1])
        # In one go now and then: taking from the front of a list moves all of it.
        if len(self.time) > MOST or (self.taken % 64 == 0 and self.time[0] < self.time[-1] - KEPT):
            drop = max(bisect_left(self.time, self.time[-1] - KEPT), len(self.time) - MOST // 2, 0)
            del self.time[:drop], self.values[:drop]
        if len(self._recent) > MOST or self._recent[0] < self._recent[-1] - 2 * KEPT:
            del self._recent[: max(bisect_left(self._recent, self._recent[-1] - KEPT), len(self._recent) - MOST)]
        return True

    def told(self, until: float) -> None:
        """What lies before that time has been told of: nothing can be put in there any more."""
        self._told = until

    def clear(self) -> None:
        """Forgets the samples, not their rate."""
        self.time.clear()
        self.values.clear()

    def rate(self, now: float, over: float) -> float:
        """Samples a second over the last ``over`` seconds before ``now``, gaps included; 0 with fewer than two."""
        first = bisect_left(self._recent, now - over)
        since = self._recent[first:]
        return mean_rate(np.array(since)) if len(since) > 1 and since[-1] > since[0] else 0.0

    def count(self, now: float, over: float) -> int:
        """Samples in the last ``over`` seconds before ``now``."""
        return len(self._recent) - bisect_left(self._recent, now - over)

    def usual_step(self, samples: int = USUAL) -> float | None:
        """The mean of the middle half of the last steps, s: neither jitter nor a fifth lost changes it; None if few."""
        if len(self.time) <= samples:
            return None
        latest = self.time[-samples - 1 :]
        steps = sorted(after - before for before, after in zip(latest, latest[1:], strict=False))
        middle = steps[samples // 4 : samples - samples // 4]
        return sum(middle) / len(middle)

    def at(self, time: float) -> Values:
        """The line between the samples around ``time``, which must lie between the first and the last."""
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
        """The sample nearest to ``time``, where there is one as near as ``within``."""
        after = bisect_left(self.time, time)
        rows = [row for row in (after - 1, after) if 0 <= row < len(self.time)]
        row = min(rows, key=lambda row: abs(self.time[row] - time), default=None)
        return None if row is None or abs(self.time[row] - time) > within else self.values[row]

    def stretch(self, start: float, end: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Stamps (N,) and values (N, k) from one before ``start`` to one after ``end``, as far as they are there."""
        rows = slice(max(bisect_left(self.time, start) - 1, 0), bisect_left(self.time, end) + 1)
        return np.array(self.time[rows]), np.array(self.values[rows])
