"""Running medians and maxima, against the filters of SciPy that are slow to import."""

from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import mark
from scipy.ndimage import maximum_filter1d, median_filter

from mavdem.running_windows import running_maximum, running_median

SCIPY_MODES = {"edge": "nearest", "reflect": "mirror", "symmetric": "reflect"}


@mark.parametrize("padding", SCIPY_MODES)
@mark.parametrize("width", [1, 3, 5, 9])
@mark.parametrize("shape", [(40,), (40, 2)])
def test_the_running_median_is_that_of_scipy(shape, width, padding):
    values = default_rng(0).standard_normal(shape).round(1)
    size = (width, *[1] * (len(shape) - 1))
    expected = median_filter(values, size, mode=SCIPY_MODES[padding])
    assert_array_equal(running_median(values, width, padding), expected)
    # Of series that are shorter than the padding, the filter of SciPy 1.17 returns memory that was never written.
    assert_array_equal(running_median(values[:1], width, padding), values[:1])
    assert len(running_median(values[:0], width, padding)) == 0


@mark.parametrize("width", [1, 2, 5, 8, 100])
def test_the_running_maximum_is_of_the_values_so_far(width):
    values = default_rng(0).standard_normal(40)
    expected = maximum_filter1d(values, width, origin=(width - 1) // 2, mode="nearest")
    # Where the window begins before the series, SciPy repeats the first value, which is in the window anyway.
    assert_array_equal(running_maximum(values, width), expected)
    assert len(running_maximum(values[:0], width)) == 0
