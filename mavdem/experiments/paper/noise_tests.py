"""Statistical tests of a noise series: is it Gaussian, whatever its colour, and is it white?

For a stationary Gaussian series of N values with autocorrelation ρ, the variances of √N times skewness and excess
kurtosis tend to 6 Σρ(k)³ and 24 Σρ(k)⁴ over all lags k, positive and negative (Lomnicki). The Jarque-Bera test takes 6
and 24, as if the series were white, so it nearly always rejects coloured Gaussian noise; :func:`normality` estimates
the sums, as Lobato and Velasco do.

The process noise of a model is *estimated* from derivatives, each from a window of samples. Neighbouring values thus
share samples and are correlated whatever the noise; :func:`analyse_noise` tests for colour with values that share none.

References:
    Z. A. Lomnicki, "Tests for departure from normality in the case of linear stochastic processes", Metrika 4 (1961).
    I. N. Lobato, C. Velasco, "A simple test of normality for time series", Econometric Theory 20 (2004) 671-689.
    G. M. Ljung, G. E. P. Box, "On a measure of lack of fit in time series models", Biometrika 65 (1978) 297-303.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from scipy.signal import correlate
from scipy.stats import chi2, norm

from mavdem.arrays import Array
from mavdem.containers import JsonValues

LJUNG_BOX_LAGS = 10
"""Lags of the Ljung-Box test, the usual number for series of hundreds of values."""

MAX_REPORTED_LAG = 100
"""Largest lag of the reported autocorrelation; at most a quarter of the number of values, since estimates at larger
lags are of few pairs."""

WHITE_NOISE_BOUND = float(norm.ppf(0.975))
"""Half width of the 95 % bounds on the autocorrelation of white noise, times √N (Bartlett): 1.96."""


class Significance(NamedTuple):
    """The result of a statistical test; the names of the fields are keys of documents."""

    statistic: float
    """Value of the test statistic."""

    p_value: float
    """Probability of a statistic at least as large if the hypothesis is true."""


class NoiseAnalysis(NamedTuple):
    """The statistics of one noise series."""

    values: Array
    """(N,) the series with its mean removed, in units of its standard deviation."""

    autocorrelation: Array
    """(lags,) autocorrelation at lags 0, 1, 2, …"""

    bound: float
    """95 % of the autocorrelations of white noise lie between −``bound`` and ``bound``."""

    normality: Significance
    """Test of the hypothesis that the noise is Gaussian, of any colour."""

    whiteness: Significance
    """Test of the hypothesis that the noise is white, by values that share no samples."""

    overlap: int
    """Lag from which on two values share no samples."""

    def to_dict(self) -> JsonValues:
        """Returns plain JSON values by name, without the series itself."""
        return {
            "autocorrelation": self.autocorrelation.tolist(),
            "bound": self.bound,
            "normality": self.normality._asdict(),
            "whiteness": self.whiteness._asdict(),
        }


def analyse_noise(values: Array, overlap: int) -> NoiseAnalysis:
    """Estimates the autocorrelation of a noise series, and tests whether it is Gaussian and whether it is white.

    Args:
        values: (N,) the series, not constant, in any unit.
        overlap: number of neighbouring values that share underlying samples; 1 if none do.

    Returns:
        Autocorrelation with its bound, and both tests.
    """
    standardised_values = (values - values.mean()) / values.std()
    lag_count = min(MAX_REPORTED_LAG, len(values) // 4) + 1
    return NoiseAnalysis(
        standardised_values,
        autocorrelation=autocovariance(standardised_values)[:lag_count],
        bound=WHITE_NOISE_BOUND / sqrt(len(values)),
        normality=normality(standardised_values),
        whiteness=whiteness(values[::overlap]),
        overlap=overlap,
    )


def normality(series: Array) -> Significance:
    """Tests the hypothesis that a stationary series of any colour is Gaussian (Lobato and Velasco's G).

    With the moments m₂, m₃, m₄ about the mean and the autocovariance γ, and sums over all positive and negative lags,

        G = N m₃² / (6 Σγ(k)³) + N (m₄ − 3 m₂²)² / (24 Σγ(k)⁴),

    which is distributed as χ² with two degrees of freedom.

    Args:
        series: (N,) values in any unit.

    Returns:
        Statistic G, and p-value.
    """
    deviation = series - series.mean()
    count = len(deviation)
    variance = deviation.var()
    covariance = autocovariance(deviation)
    # Lobato and Velasco add to γ(k) the autocovariance γ(N − k) that a series closed to a ring has at the same lag. The
    # sums then need no truncation.
    opposite_covariance = np.append(0.0, covariance[:0:-1])
    ring_covariance = covariance + opposite_covariance
    # Each lag but 0 counts twice, for the negative lag.
    lag_weights = np.append(1.0, np.full(count - 1, 2.0))
    cubes = (lag_weights * covariance * ring_covariance**2).sum()
    fourth_powers = (lag_weights * covariance * ring_covariance**3).sum()
    third_moment = (deviation**3).mean()
    fourth_cumulant = (deviation**4).mean() - 3 * variance**2
    skewness_term = count * third_moment**2 / (6 * cubes)
    kurtosis_term = count * fourth_cumulant**2 / (24 * fourth_powers)
    statistic = skewness_term + kurtosis_term
    return Significance(float(statistic), float(chi2.sf(statistic, 2)))


def whiteness(series: Array) -> Significance:
    """Tests the hypothesis that a series is white, by the test of Ljung and Box.

    Its statistic is Q = N (N + 2) Σ ρ(k)² / (N − k), with the autocorrelation ρ(k) at the lags k = 1 to
    ``LJUNG_BOX_LAGS``. If the series is white, Q has the χ² distribution with as many degrees of freedom as lags.

    Args:
        series: (N,) values in any unit, more than ``LJUNG_BOX_LAGS``.

    Returns:
        Statistic Q, and p-value.
    """
    count = len(series)
    lags = np.arange(1, LJUNG_BOX_LAGS + 1)
    covariance = autocovariance(series - series.mean())
    autocorrelation = covariance[lags] / covariance[0]
    statistic = count * (count + 2) * float((autocorrelation**2 / (count - lags)).sum())
    return Significance(statistic, float(chi2.sf(statistic, len(lags))))


def autocovariance(deviation: Array) -> Array:
    """Returns the autocovariance Σ x_t x_{t+k} / N at lags k = 0 … N − 1.

    Args:
        deviation: (N,) a series of mean zero.

    Returns:
        (N,) autocovariance, in the square of the series' unit.
    """
    count = len(deviation)
    # The sums at all lags, from 1 − N to N − 1. They are symmetric, and lag 0 has the index N − 1.
    sums = correlate(deviation, deviation)
    return sums[count - 1 :] / count
