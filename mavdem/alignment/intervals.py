"""Sets of time intervals: sorted, disjoint (start, end) pairs in seconds of one boot; an end may be infinite."""

from __future__ import annotations

from math import inf

import numpy as np
from numpy.typing import NDArray

Interval = tuple[float, float]
Intervals = list[Interval]

ALWAYS: Intervals = [(-inf, inf)]


def where(time: NDArray[np.float64], true: NDArray[np.bool_]) -> Intervals:
    """From the first to the last stamp of each run of ``true`` (N,) at ``time`` (N,).

    A run that holds at the first or last stamp is taken to hold before or after it too, so only the changes that were
    seen bound an interval.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(np.int8)))
    return [
        (-inf if first == 0 else float(time[first]), inf if after == len(time) else float(time[after - 1]))
        for first, after in zip(edges[::2], edges[1::2], strict=True)
    ]


def unbroken(time: NDArray[np.float64], broken: NDArray[np.bool_]) -> Intervals:
    """The runs of ``time`` (N,) between the steps (N - 1,) that are ``broken``."""
    if not len(time):
        return []
    breaks = np.flatnonzero(broken)
    starts, ends = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(time) - 1]])
    return [(float(time[a]), float(time[b])) for a, b in zip(starts, ends, strict=True)]


def both(a: Intervals, b: Intervals) -> Intervals:
    """Where ``a`` and ``b`` overlap."""
    overlaps, i, j = [], 0, 0
    while i < len(a) and j < len(b):
        start, end = max(a[i][0], b[j][0]), min(a[i][1], b[j][1])
        if start < end:
            overlaps.append((start, end))
        if a[i][1] < b[j][1]:
            i += 1
        else:
            j += 1
    return overlaps


def either(a: Intervals, b: Intervals) -> Intervals:
    """Where ``a`` or ``b`` is; intervals that touch are joined."""
    return outside(both(outside(a), outside(b)))


def outside(intervals: Intervals) -> Intervals:
    """Everywhere else."""
    edges = [-inf, *(edge for interval in intervals for edge in interval), inf]
    return [(start, end) for start, end in zip(edges[::2], edges[1::2], strict=True) if start < end]


def total(intervals: Intervals) -> float:
    """Seconds in all of them."""
    return sum(end - start for start, end in intervals)
