"""Sets of time intervals: lists of (start, end) in seconds of one boot, sorted and disjoint; an end may be infinite."""

from math import inf

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.confidence import Interval

pass


Intervals = list[Interval]


def true_intervals(time: Array, true: Flags) -> Intervals:
    """Returns from the first to the last stamp of each run of ``true`` (N,) at ``time`` (N,).

    A run that holds at the first or last stamp is taken to hold before or after it too, so only the changes that were
    seen bound an interval.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(np.int8)))
    runs = zip(edges[::2], edges[1::2], strict=True)
    return [
        (-inf if a == 0 else float(time[a]), inf if b == len(time) else float(time[b - 1]))
        for a, b in runs
    ]


def longest_true_duration(time: Array, true: Flags) -> float:
    """Returns for how long, s, without a break ``true`` (N,) holds at ``time`` (N,)."""
    ends = np.clip(true_intervals(time, true), time[0], time[-1])
    return float(max((end - start for start, end in ends), default=0.0))


def split_at_gaps(time: Array, broken: Flags) -> Intervals:
    """Returns the runs of ``time`` (N,) between the steps (N - 1,) that are ``broken``; none of a single stamp."""
    if not len(time):
        return []
    breaks = np.flatnonzero(broken)
    starts = time[np.append(0, breaks + 1)]
    ends = time[np.append(breaks, -1)]
    last = starts < ends
    return [*zip(starts[last].tolist(), ends[last].tolist(), strict=True)]


def intersection(a: Intervals, b: Intervals) -> Intervals:
    """Returns where ``a`` and ``b`` overlap."""
    overlaps = []
    i = 0
    j = 0
    while i < len(a) and j < len(b):
        start = max(a[i][0], b[j][0])
        end = min(a[i][1], b[j][1])
        if start < end:
            overlaps.append((start, end))
        if a[i][1] < b[j][1]:
            i += 1
        else:
            j += 1
    return overlaps


def union(a: Intervals, b: Intervals) -> Intervals:
    """Returns where ``a`` or ``b`` is; intervals that touch are joined."""
    return complement(intersection(complement(a), complement(b)))


def complement(intervals: Intervals) -> Intervals:
    """Returns everywhere else."""
    edges = [-inf, *(edge for interval in intervals for edge in interval), inf]
    return [(start, end) for start, end in zip(edges[::2], edges[1::2], strict=True) if start < end]


def total_duration(intervals: Intervals) -> float:
    """Returns the seconds in all of them."""
    return sum(end - start for start, end in intervals)


def in_intervals(time: Array | float, intervals: Intervals) -> Flags:
    """Returns which stamps (N,) are in the intervals, or whether one is."""
    at = np.asarray(time)
    return np.any([(at >= start) & (at <= end) for start, end in [(inf, inf), *intervals]], axis=0)
