from math import factorial

import numpy as np
import pytest
from numpy.polynomial import hermite
from scipy.ndimage import gaussian_filter1d

from mavdem.dem.engine.coordinates import temporal_covariance, temporal_precision


@pytest.mark.parametrize("s", [0.01, 1.0, 7.0])
def test_first_entries_are_those_printed_in_the_paper(s):
    expected = [[1, 0, -1 / (2 * s**2)], [0, 1 / (2 * s**2), 0], [-1 / (2 * s**2), 0, 3 / (4 * s**4)]]
    np.testing.assert_allclose(temporal_covariance(2, s), expected)


def test_entries_are_derivatives_of_the_autocorrelation_at_zero():
    # d^k/dτ^k exp(−τ²/4s²) at 0 is (−1/(2s))^k H_k(0) with physicists' Hermite polynomials.
    s, order = 1.7, 6
    covariance = temporal_covariance(order, s)
    for i in range(order + 1):
        for j in range(order + 1):
            hermite_at_zero = hermite.hermval(0.0, [0] * (i + j) + [1])
            expected = (-1) ** i * (-1 / (2 * s)) ** (i + j) * hermite_at_zero
            assert covariance[i, j] == pytest.approx(expected, abs=1e-12 * factorial(i + j))


@pytest.mark.parametrize("s", [1e-3, 0.5, 100.0])
@pytest.mark.parametrize("order", [0, 1, 2, 6])
def test_precision_is_the_inverse_in_any_unit_of_time(order, s):
    # Relative to the size of each row and column, which runs over s^-2p.
    units = s ** np.arange(order + 1)
    product = temporal_covariance(order, s) @ temporal_precision(order, s)
    np.testing.assert_allclose(product * np.outer(units, 1 / units), np.eye(order + 1), atol=1e-8)


@pytest.mark.parametrize("s", [5.0, 10.0])
def test_white_noise_through_the_kernel_has_this_covariance(s):
    # s in samples. Convolving with exp(−t²/2s²) and finite differences of the result, whose error is of order (1/s)².
    samples = 400_000
    noise = gaussian_filter1d(np.random.default_rng(1).standard_normal(samples), s, truncate=8)
    noise /= noise.std()
    slope = (noise[2:] - noise[:-2]) / 2
    independent = samples / (2 * s * np.sqrt(np.pi))
    tolerance = 4 * np.sqrt(2 / independent) + 1 / s**2
    assert slope.var() == pytest.approx(temporal_covariance(1, s)[1, 1], rel=tolerance)
    curvature = noise[2:] - 2 * noise[1:-1] + noise[:-2]
    assert np.mean(noise[1:-1] * curvature) == pytest.approx(temporal_covariance(2, s)[0, 2], rel=tolerance)
