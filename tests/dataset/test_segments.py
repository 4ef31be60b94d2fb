"""Samples of segments, and the series that they are taken from."""

import numpy as np
import pytest
from hover import Hover, changed, columns

from mavdem.dataset.segments import Segment, in_segments, recorded_spans, rows_of_segment
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, clean_series


def two_boots():
    """Returns a series of two boots of 2 s at 10 Hz."""
    time = np.tile(np.arange(20) / 10, 2)
    return TimeSeries(time, np.repeat([0, 1], 20), np.arange(40.0))


@pytest.mark.parametrize("segment", [Segment(1, 0.5, 1.0), Segment(0, -np.inf, np.inf)])
def test_rows_of_a_segment_are_those_of_its_boot_and_time(segment):
    series = two_boots()
    is_in_time = (series.time >= segment.start) & (series.time <= segment.end)
    expected = is_in_time & (series.boot == segment.boot)
    np.testing.assert_array_equal(in_segments(series, segment), expected)
    np.testing.assert_array_equal(
        series.values[rows_of_segment(series, segment)], series.values[expected]
    )


def test_a_segment_of_another_boot_has_no_rows():
    assert not len(two_boots().values[rows_of_segment(two_boots(), Segment(2, 0.0, 1.0))])


def test_a_whole_message_is_not_copied():
    series = two_boots()
    columns = {"time": series.time, "boot": series.boot}
    clean = clean_series(columns, series.values)
    assert np.shares_memory(clean.time, series.time)
    assert clean.unused_count == 0


def test_repeated_and_late_messages_are_sorted_out():
    columns = {"time": np.array([0.0, 0.2, 0.1, 0.1]), "boot": np.zeros(4, np.int64)}
    clean = clean_series(columns, np.array([1.0, 3.0, 2.0, 2.5]))
    np.testing.assert_array_equal(clean.values, [1.0, 2.0, 3.0])
    assert clean.unused_count == 1


def test_a_command_from_before_a_log_does_not_lengthen_it():
    telemetry = Hover().telemetry(5.0, 50.0)
    with_command = changed(telemetry, "vehicle_command", **columns([-60.0], command=176.0))
    assert recorded_spans(Signals(with_command)) == recorded_spans(Signals(telemetry))
