"""Periodograms and Welch's method against those of SciPy."""

from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import mark
from scipy.signal import detrend, spectrogram, welch

from mavdem.plant.power_density import power_density, window_densities


@mark.parametrize("window_samples", [2, 63, 64, 250])
@mark.parametrize("without_trend", [False, True])
def test_the_power_density_is_that_of_scipy(window_samples, without_trend):
    """Windows of several lengths, with and without the linear trend removed."""
    values = default_rng(0).standard_normal(250).cumsum()
    frequency, density = power_density(values, 50.0, window_samples, without_trend)
    trend = detrend if without_trend else "constant"
    expected = welch(values, 50.0, nperseg=window_samples, detrend=trend)
    assert_allclose(frequency, expected[0])
    assert_allclose(density, expected[1], rtol=1e-9, atol=1e-25)


def test_the_densities_of_windows_are_those_of_scipy():
    values = default_rng(0).standard_normal((3, 250))
    frequency, density = window_densities(values, 50.0, 64)
    expected = spectrogram(values, 50.0, "hann", 64, 32)
    assert_allclose(frequency, expected[0])
    assert_allclose(density, expected[2].transpose(0, 2, 1), rtol=1e-9, atol=1e-25)
