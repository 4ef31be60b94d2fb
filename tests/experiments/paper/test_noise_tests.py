"""Tests of noise series: they reject a true hypothesis at their level, and nearly always reject a false one."""

import numpy as np
from numpy.random import default_rng
from pytest import mark
from scipy.stats import binom

from mavdem.experiments.paper import noise_tests
from sitl_scenarios.turbulence import gaussian_noise

pytestmark = mark.slow

SERIES_COUNT = 400
VALUES = 700
LEVEL = 0.05
MIN_REJECTIONS, MAX_REJECTIONS = binom.ppf([0.001, 0.999], SERIES_COUNT, LEVEL)
"""Rejections of a true hypothesis at ``LEVEL``: a test of that level lies between in 998 of 1000 cases."""


def gaussian_series(rng, kernel_steps):
    """Gaussian noise, coloured by a kernel of that width in steps; white for 0."""
    if kernel_steps == 0:
        return rng.standard_normal(VALUES)
    return gaussian_noise(kernel_steps, 1.0, VALUES, rng)


def rejections(test, make_series, series_count=SERIES_COUNT):
    """Number of series that a test rejects at ``LEVEL``."""
    rng = default_rng(0)
    return sum(test(make_series(rng)).p_value < LEVEL for _ in range(series_count))


@mark.in_full
@mark.parametrize("kernel_steps", [0, 1, 3, 10])
def test_normality_rejects_gaussian_noise_of_any_colour_at_its_level(kernel_steps):
    count = rejections(noise_tests.normality, lambda rng: gaussian_series(rng, kernel_steps))
    assert MIN_REJECTIONS <= count <= MAX_REJECTIONS


@mark.parametrize("distribution", ["standard_normal", "standard_exponential"])
def test_whiteness_rejects_white_noise_of_any_distribution_at_its_level(distribution):
    count = rejections(noise_tests.whiteness, lambda rng: getattr(rng, distribution)(VALUES))
    assert MIN_REJECTIONS <= count <= MAX_REJECTIONS


def test_whiteness_rejects_coloured_noise():
    assert rejections(noise_tests.whiteness, lambda rng: gaussian_series(rng, 0.6), 100) >= 95


@mark.in_full
def test_whiteness_is_tested_with_values_that_share_no_samples():
    """A running mean of five white samples is correlated over four lags and no further."""

    def running_mean(rng):
        return np.convolve(rng.standard_normal(VALUES + 4), np.full(5, 0.2), "valid")

    def whiteness_without_overlap(series):
        return noise_tests.analyse_noise(series, overlap=5).whiteness

    assert rejections(noise_tests.whiteness, running_mean, 100) == 100
    count = rejections(whiteness_without_overlap, running_mean)
    assert MIN_REJECTIONS <= count <= MAX_REJECTIONS
