"""Tests of a noise: whether it is Gaussian, as the Laplace approximation assumes, and whether it is white or coloured.

The Jarque-Bera test of skewness and excess kurtosis assumes independent samples. Those of coloured noise have a larger
variance: for a stationary Gaussian series of autocorrelation ρ, the variances of √N times skewness and kurtosis tend to
6 Σρ(k)³ and 24 Σρ(k)⁴ over all lags, positive and negative (Lomnicki), instead of 6 and 24. So the test rejects
coloured Gaussian noise nearly always. ``normality`` estimates these sums as Lobato and Velasco do and keeps its level
for any colour; ``normality_if_white`` is the plain test.

The Ljung-Box test is of the autocorrelations up to a lag.

A process noise is *estimated* from derivatives, each from a window of samples, so that neighbouring values share
samples and are correlated for any noise. ``overlap`` is the number of values that share a sample; ``whiteness`` is of
values that share none.

References:
    C. M. Jarque, A. K. Bera, "A test for normality of observations and regression residuals", International
        Statistical Review 55 (1987) 163-172.
    Z. A. Lomnicki, "Tests for departure from normality in the case of linear stochastic processes", Metrika 4 (1961).
    I. N. Lobato, C. Velasco, "A simple test of normality for time series", Econometric Theory 20 (2004) 671-689.
    G. M. Ljung, G. E. P. Box, "On a measure of lack of fit in time series models", Biometrika 65 (1978) 297-303.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2, jarque_bera, norm

from mavdem.dem import Learned
from mavdem.dem.engine.linalg import Array

MIN_VALUES = 20  # with fewer values no test of shape or colour has power
LAGS, SHARE_OF_LAGS = 10, 5  # the Ljung-Box test uses at most so many lags, and one lag for so many values
MAX_LAGS = 100  # lags of the reported autocorrelation; at most a quarter of the values
WHITE_BOUND = float(norm.ppf(0.975))  # half width of the 95 % bounds of white noise's autocorrelation, times √N


class Significance(NamedTuple):
    """The result of a test.

    Attributes:
        statistic: large if the hypothesis is unlikely.
        p_value: probability of a statistic at least as large under the hypothesis.
    """

    statistic: float
    p_value: float


@dataclass(frozen=True)
class Noise:
    """The statistics of one series of noise.

    Attributes:
        values: number of values.
        dt: step between them, s.
        mean, sd: in the unit of the noise.
        skewness, excess_kurtosis: 0 of a Gaussian.
        histogram: density of the values over ``edges``, in units of sd about the mean.
        edges: one more than bins.
        autocorrelation: at lags 0, 1, …, in steps.
        bound: 95 % of white noise's autocorrelations lie within ± this.
        normality: test for Gaussian noise of any colour.
        normality_if_white: the plain Jarque-Bera test, which rejects coloured noise too.
        whiteness: test for white noise, of values that share no samples.
        whiteness_of_all: the same of all values.
        overlap: values closer than so many steps share samples.
        correlation_time: s, the integral of the autocorrelation over both signs of lag, up to where it first falls
            below ``bound``.
        smoothness: kernel width s, in seconds, of the Gaussian-kernel noise whose autocorrelation exp(−τ²/4s²) falls
            to a half at the same lag. White noise has about a third of dt, the resolution of the samples.
        effective_values: effective sample size of the mean.
    """

    values: int
    dt: float
    mean: float
    sd: float
    skewness: float
    excess_kurtosis: float
    histogram: tuple[float, ...]
    edges: tuple[float, ...]
    autocorrelation: tuple[float, ...]
    bound: float
    normality: Significance
    normality_if_white: Significance
    whiteness: Significance
    whiteness_of_all: Significance
    overlap: int
    correlation_time: float
    smoothness: float
    effective_values: float

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values by name."""
        tests = ("normality", "normality_if_white", "whiteness", "whiteness_of_all")
        return asdict(self) | {name: getattr(self, name)._asdict() for name in tests}


def analyse_noise(values: ArrayLike, dt: float, overlap: int = 1) -> Noise:
    """The statistics of a series of noise: ``values`` (N,), finite, ``dt`` seconds apart, in any unit.

    ``overlap``: number of neighbouring values that an underlying sample contributes to; 1 if values share none.

    Raises:
        ValueError: fewer than twenty values that share no samples, or values that are not finite or do not vary.
    """
    series = np.asarray(values, np.float64)
    if series.ndim != 1 or not np.isfinite(series).all():
        raise ValueError(f"values must be finite, of shape (N,), not {series.shape}")
    if overlap < 1 or len(series[::overlap]) < MIN_VALUES:
        raise ValueError(f"values must be {MIN_VALUES} at least that share no samples, not {len(series)} / {overlap}")
    if not np.ptp(series):
        raise ValueError("values must vary")
    deviation = series - series.mean()
    sd = float(deviation.std())
    covariance = autocovariance(deviation / sd)
    lags = min(MAX_LAGS, len(series) // 4) + 1
    histogram, edges = np.histogram(deviation / sd, bins="auto", density=True)
    plain = jarque_bera(series)
    bound = WHITE_BOUND / float(np.sqrt(len(series)))
    time = dt * _integrated(covariance, bound)
    return Noise(
        len(series),
        dt,
        float(series.mean()),
        sd,
        float(((deviation / sd) ** 3).mean()),
        float(((deviation / sd) ** 4).mean()) - 3,
        tuple(histogram.tolist()),
        tuple(edges.tolist()),
        tuple(covariance[:lags].tolist()),
        bound,
        normality(deviation / sd),
        Significance(float(plain.statistic), float(plain.pvalue)),
        whiteness(series[::overlap]),
        whiteness(series),
        overlap,
        time,
        dt * _width(covariance, bound),
        len(series) * dt / time,
    )


def normality(series: ArrayLike) -> Significance:
    """Test whether a stationary series of any colour is Gaussian (Lobato and Velasco's G, χ² of two degrees)."""
    x = np.asarray(series, np.float64)
    x = x - x.mean()
    n, variance = len(x), x.var()
    covariance = autocovariance(x)
    # Each lag with the one that a series closed to a ring would have too; the sums then need no truncation.
    opposite = np.append(0.0, covariance[:0:-1])
    both_signs = np.append(1.0, np.full(n - 1, 2.0))
    third, fourth = ((both_signs * covariance * (covariance + opposite) ** power).sum() for power in (2, 3))
    statistic = n * (x**3).mean() ** 2 / (6 * third) + n * ((x**4).mean() - 3 * variance**2) ** 2 / (24 * fourth)
    return Significance(float(statistic), float(chi2.sf(statistic, 2)))


def whiteness(series: ArrayLike) -> Significance:
    """Test whether a series is white: Ljung and Box's Q of the first ten lags, χ² of as many degrees."""
    x = np.asarray(series, np.float64)
    n = len(x)
    lags = np.arange(1, min(LAGS, n // SHARE_OF_LAGS) + 1)
    covariance = autocovariance(x - x.mean())
    statistic = n * (n + 2) * float(((covariance[lags] / covariance[0]) ** 2 / (n - lags)).sum())
    return Significance(statistic, float(chi2.sf(statistic, len(lags))))


def autocovariance(deviation: Array) -> Array:
    """(N,) Σ x_t x_{t+k} / N at lags k = 0 … N − 1, of a series (N,) of mean zero."""
    n = len(deviation)
    spectrum = np.abs(np.fft.rfft(deviation, 2 * n)) ** 2
    return np.asarray(np.fft.irfft(spectrum)[:n] / n)


def _integrated(correlation: Array, bound: float) -> float:
    """Sum over lags of both signs, up to the first below the bound."""
    ends = np.flatnonzero(correlation < bound)
    return float(2 * correlation[: ends[0] if len(ends) else None].sum() - 1)


def _width(correlation: Array, bound: float) -> float:
    """Steps: the kernel width that belongs to the lag of half height.

    Between lags, ln ρ is interpolated linearly in the squared lag, as for Gaussian-kernel noise. Half height has the
    estimate of lowest variance: half that of one from the integral, which includes the random tail.
    """
    after = int(np.flatnonzero(correlation < 0.5)[0])
    before = after - 1
    high, low = np.log(correlation[before]), np.log(max(correlation[after], bound))
    squared_lag = before**2 + (high - np.log(0.5)) / (high - low) * (after**2 - before**2)
    return float(np.sqrt(squared_lag / np.log(2)) / 2)


def process_noise(learned: Learned) -> dict[int, Noise]:
    """The statistics of the process noise of ``learned``, as it drives each output, by the output's number.

    That is C w, w = x′ − A x − B v as the D step estimates it, in units of the outputs per second: for the roll rate
    rad/s², the w^φ̇ of the paper's histograms. It does not depend on the coordinates of the states. If the training
    data have gaps it is that of the longest part between them.

    Raises:
        ValueError: too few training samples, or a noise that does not vary, as when p = 0.
    """
    places, noise = learned.process_noise()
    runs = np.split(np.arange(len(places)), np.flatnonzero(np.diff(places) > 1) + 1)
    driving = noise[max(runs, key=len)] @ learned.model.C.T
    window = learned.settings.window
    assert window is not None
    return {output: analyse_noise(driving[:, output], learned.dt, overlap=window) for output in range(driving.shape[1])}
