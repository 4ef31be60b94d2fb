"""Sets of time intervals: what lies outside of intervals that overlap."""

from math import inf

from mavdem.dataset.intervals import complement


def test_the_complement_of_overlapping_intervals_lies_outside_of_all_of_them():
    # The second interval lies within the first, and the third begins before the end of it.
    intervals = [(1.0, 9.0), (2.0, 3.0), (8.0, 10.0), (12.0, 13.0)]
    assert complement(intervals) == [(-inf, 1.0), (10.0, 12.0), (13.0, inf)]
