"""Noise analysis: tests that reject as often as they say where the hypothesis holds, and nearly always where not."""

import numpy as np
from numpy.random import default_rng
from pytest import mark
from scipy.stats import binom

from mavdem.experiments.paper import noise
from sitl_scenarios.turbulence import gaussian_noise

SERIES = 400
VALUES = 700
FEWEST, MOST = binom.ppf([0.001, 0.999], SERIES, 0.05)
"""Rejections at 0.05 of so many series: a test of the right level is within in 998 of 1000 tries."""


def gaussian(rng, steps):
    """White noise through a Gaussian kernel of so many steps; white for 0."""
    return gaussian_noise(steps, 1.0, VALUES, rng) if steps else rng.standard_normal(VALUES)


def rejections(test, make, series=SERIES):
    rng = default_rng(0)
    return sum(test(make(rng)).p_value < 0.05 for _ in range(series))


@mark.slow
@mark.parametrize("steps", [0, 1, 3, 10])
def test_gaussian_noise_of_any_colour_is_called_another_as_often_as_said(steps):
    assert FEWEST <= rejections(noise.normality, lambda rng: gaussian(rng, steps)) <= MOST


@mark.parametrize("shape", ["standard_normal", "standard_exponential"])
def test_white_noise_is_called_coloured_as_often_as_said(shape):
    assert FEWEST <= rejections(noise.whiteness, lambda rng: getattr(rng, shape)(VALUES)) <= MOST
    assert rejections(noise.whiteness, lambda rng: gaussian(rng, 0.6), 100) >= 95


@mark.slow
def test_whiteness_is_of_values_that_share_no_samples():
    """A running mean of five agrees with itself four steps on, and no further."""

    def averaged(rng):
        return np.convolve(rng.standard_normal(VALUES + 4), np.full(5, 0.2), "valid")

    def apart(series):
        return noise.analyse_noise(series, overlap=5).whiteness

    assert rejections(noise.whiteness, averaged, 100) == 100
    assert FEWEST <= rejections(apart, averaged) <= MOST
