"""Sets of time intervals: their union, intersection and complement, and the intervals in which a condition holds.

A set is a list of (start, end) pairs in seconds on the clock of one boot, sorted and disjoint. An end may be infinite.
"""

from math import inf

import numpy as np

from mavdem.arrays import Array, Flags

TimeInterval = tuple[float, float]
"""Start and end of a time, s on the clock of one boot; infinite where it continues beyond the record."""

Intervals = list[TimeInterval]
"""A set of time intervals: (start, end) pairs in seconds, sorted and disjoint."""

MAX_HELD_SECONDS = 5.0
"""Time, s, for which the last sample of a record counts: a choice; slow links send at 1 Hz and lose some."""


def true_intervals(time: Array, condition: Flags) -> Intervals:
    """Returns the intervals in which a sampled condition is true, from its first to its last true stamp.

    A condition that is true at the first or the last stamp is assumed to be true before or after it as well, so that
    only recorded changes bound an interval.

    >>> true_intervals(np.array([0.0, 1.0, 2.0, 3.0]), np.array([False, True, True, False]))
    [(1.0, 2.0)]

    Args:
        time: (N,) stamps in seconds, rising.
        condition: (N,) whether the condition is true at each stamp.

    Returns:
        The intervals, the first from -inf or the last to inf where the condition is true at the end of the record.
    """
    if not len(condition):
        return []
    # Rows at which the condition differs from the row before. They alternate: the first row at which it is true, then
    # the first row at which it is false again. Before the first row and after the last one it counts as false here.
    changes = (1 + np.flatnonzero(condition[1:] != condition[:-1])).tolist()
    if condition[0]:
        changes.insert(0, 0)
    if condition[-1]:
        changes.append(len(condition))
    intervals = []
    for first_true, first_false in zip(changes[::2], changes[1::2], strict=True):
        start = -inf if first_true == 0 else float(time[first_true])
        end = inf if first_false == len(time) else float(time[first_false - 1])
        intervals.append((start, end))
    return intervals


def longest_true_duration(time: Array, condition: Flags) -> float:
    """Returns the longest uninterrupted time for which a sampled condition is true.

    Args:
        time: (N,) stamps in seconds, rising; one at least.
        condition: (N,) whether the condition is true at each stamp.

    Returns:
        The longest time, s; 0 if the condition is never true, or at single samples only.
    """
    longest_duration = 0.0
    for start, end in true_intervals(time, condition):
        # An interval that reaches an end of the record is infinite there.
        recorded_start = max(start, time[0])
        recorded_end = min(end, time[-1])
        longest_duration = max(longest_duration, recorded_end - recorded_start)
    return float(longest_duration)


def split_at_gaps(time: Array, is_gap: Flags) -> Intervals:
    """Splits a record at its gaps.

    >>> split_at_gaps(np.array([0.0, 1.0, 5.0, 6.0]), np.array([False, True, False]))
    [(0.0, 1.0), (5.0, 6.0)]

    Args:
        time: (N,) stamps in seconds, rising.
        is_gap: (N - 1,) whether the step from each stamp to the next is a gap.

    Returns:
        The intervals between the gaps; a single stamp between two gaps makes none.
    """
    if not len(time):
        return []
    # Gap i is the step from stamp i to stamp i + 1.
    gaps = np.flatnonzero(is_gap)
    first_row, last_row = 0, len(time) - 1
    starts = time[np.append(first_row, gaps + 1)].tolist()
    ends = time[np.append(gaps, last_row)].tolist()
    return [(start, end) for start, end in zip(starts, ends, strict=True) if start < end]


def grid_in_record(time: Array, step: float) -> Array:
    """Returns the times of an even grid within a record that are not in a gap longer than ``MAX_HELD_SECONDS``.

    However long a gap is, it takes no memory: one wrong time stamp can make a gap of weeks.

    >>> grid_in_record(np.array([0.0, 1.0, 9.2, 10.0, 10.5]), step=0.5)
    array([ 0. ,  0.5,  9.5, 10. ])

    Args:
        time: (N,) stamps in seconds, rising, at least one.
        step: step of the grid, s; the grid begins with the first stamp.

    Returns:
        (M,) times, s, rising.
    """
    first_time = time[0]
    parts = [np.empty(0)]
    for start, end in split_at_gaps(time, np.diff(time) > MAX_HELD_SECONDS):
        # Numbers of the first grid point in this part, and of the first one after it.
        first_point, end_point = np.ceil((np.array([start, end]) - first_time) / step)
        parts.append(first_time + step * np.arange(first_point, end_point))
    return np.concatenate(parts)


def intersection(first: Intervals, second: Intervals) -> Intervals:
    """Returns the times that are in both sets of intervals.

    >>> intersection([(0.0, 3.0), (5.0, 8.0)], [(2.0, 6.0)])
    [(2.0, 3.0), (5.0, 6.0)]

    Args:
        first: intervals (start, end) in s, ascending and without overlap.
        second: intervals of the other set, likewise.

    Returns:
        Ascending intervals, each longer than 0.
    """
    overlaps = []
    # Both sets are walked through together. The indices are those of the present interval of each.
    first_index = 0
    second_index = 0
    while first_index < len(first) and second_index < len(second):
        first_start, first_end = first[first_index]
        second_start, second_end = second[second_index]
        start = max(first_start, second_start)
        end = min(first_end, second_end)
        if start < end:
            overlaps.append((start, end))
        # The interval that ends earlier overlaps no further interval of the other set: the search continues after it.
        if first_end < second_end:
            first_index += 1
        else:
            second_index += 1
    return overlaps


def union(first: Intervals, second: Intervals) -> Intervals:
    """Returns the times that are in one of two sets of intervals or in both; intervals that touch are joined."""
    return complement(intersection(complement(first), complement(second)))


def merge_close_intervals(intervals: Intervals, gap: float) -> Intervals:
    """Merges intervals that begin less than ``gap`` seconds after the end of the interval before.

    >>> merge_close_intervals([(0.0, 1.0), (1.5, 2.0), (5.0, 6.0)], gap=1.0)
    [(0.0, 2.0), (5.0, 6.0)]

    Args:
        intervals: intervals (start, end), s, in ascending order.
        gap: shortest gap that separates two intervals, s.

    Returns:
        The merged intervals, s, in ascending order.
    """
    merged_intervals: Intervals = []
    for start, end in intervals:
        if merged_intervals:
            earlier_start, earlier_end = merged_intervals[-1]
            if start - earlier_end < gap:
                merged_intervals[-1] = (earlier_start, end)
                continue
        merged_intervals.append((start, end))
    return merged_intervals


def complement(intervals: Intervals) -> Intervals:
    """Returns the complement of a set of intervals: all times outside of them.

    >>> complement([(1.0, 2.0), (4.0, 5.0)])
    [(-inf, 1.0), (2.0, 4.0), (5.0, inf)]

    Args:
        intervals: intervals (start, end) in s, by their start; they may overlap, and ends may be infinite.

    Returns:
        The gaps between them, from minus infinity before the first to infinity after the last.
    """
    gaps = []
    previous_end = -inf
    for start, end in intervals:
        if previous_end < start:
            gaps.append((previous_end, start))
        previous_end = max(previous_end, end)
    if previous_end < inf:
        gaps.append((previous_end, inf))
    return gaps


def total_duration(intervals: Intervals) -> float:
    """Returns the sum of the durations of all intervals, in seconds."""
    return sum(end - start for start, end in intervals)


def in_intervals(time: Array | float, intervals: Intervals) -> Flags:
    """Returns whether each time is in a set of intervals, their ends included.

    Args:
        time: (N,) times in seconds, or a single one.
        intervals: Start and end of each interval, s, in the order of time.

    Returns:
        Flags with the shape of ``time``.
    """
    times = np.asarray(time)
    is_inside = np.zeros(times.shape, dtype=bool)
    for start, end in intervals:
        is_inside = is_inside | ((times >= start) & (times <= end))
    return is_inside
