"""Welch's method against that of SciPy."""

from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import mark
from scipy.signal import detrend, welch

from mavdem.plant.power_density import power_density


@mark.parametrize("window_samples", [2, 63, 64, 250])
@mark.parametrize("without_trend", [False, True])
def test_the_power_density_is_that_of_scipy(window_samples, without_trend):
    values = default_rng(0).standard_normal(250).cumsum()
    frequency, density = power_density(values, 50.0, window_samples, without_trend)
    trend = detrend if without_trend else "constant"
    expected = welch(values, 50.0, nperseg=window_samples, detrend=trend)
    assert_allclose(frequency, expected[0])
    assert_allclose(density, expected[1], rtol=1e-9, atol=1e-25)
