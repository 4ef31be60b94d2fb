"""Tests of running medians and extremes."""

import numpy as np
import scipy
from numpy.random import default_rng
from pytest import mark

from mavdem import running_filters
from mavdem.running_filters import running_maximum, running_median, running_minimum


@mark.parametrize("edge", ["mirror", "nearest", "reflect"])
@mark.parametrize("length", [1, 2, 3, 50])
@mark.parametrize("window", [1, 3, 9])
def test_running_medians_are_those_of_scipy(edge, length, window):
    values = default_rng(0).normal(size=(length, 2))
    expected = scipy.ndimage.median_filter(values, size=(window, 1), mode=edge)
    np.testing.assert_array_equal(running_median(values, window, edge), expected)


def test_running_extremes_are_those_of_each_window():
    values = default_rng(1).normal(size=40)
    for before, after in [(0, 0), (0, 4), (3, 0), (2, 5), (60, 60)]:
        windows = [values[max(row - before, 0) : row + after + 1] for row in range(len(values))]
        highest = [window.max() for window in windows]
        lowest = [window.min() for window in windows]
        np.testing.assert_array_equal(running_maximum(values, before, after), highest)
        np.testing.assert_array_equal(running_minimum(values, before, after), lowest)


def test_long_series_are_filtered_as_short_ones(monkeypatch):
    values = default_rng(2).normal(size=(60, 2))
    short = running_median(values, 5, "mirror"), running_maximum(values, 2, 7)
    monkeypatch.setattr(running_filters, "MAX_NUMPY_VALUES", 0)
    np.testing.assert_array_equal(running_median(values, 5, "mirror"), short[0])
    np.testing.assert_array_equal(running_maximum(values, 2, 7), short[1])
    for before, after in [(0, 4), (4, 0), (0, 5), (5, 0)]:
        long = running_maximum(values, before, after)
        np.testing.assert_array_equal(
            long[[0, -1]], [values[: after + 1].max(0), values[-1 - before :].max(0)]
        )


def test_no_values_have_no_running_figures():
    assert running_median(np.zeros(0), 3, "mirror").shape == (0,)
    assert running_minimum(np.zeros((0, 2)), 1, 2).shape == (0, 2)
