"""What a noise is like: whether it is Gaussian, as the Laplace approximation takes it, and whether white or coloured.

The Jarque-Bera test asks whether skewness and excess kurtosis are those of chance, and takes samples for independent.
Coloured ones scatter more: of a stationary Gaussian series of autocorrelation ρ the variances of √N times skewness and
kurtosis tend to 6 Σρ(k)³ and 24 Σρ(k)⁴ over all lags, positive and negative (Lomnicki), where independent samples have
6 and 24. So coloured Gaussian noise is called non-Gaussian as good as always. ``normality`` estimates these sums as
Lobato and Velasco do and holds its level for any colour; ``normality_if_white`` is the plain test.

The Ljung-Box test asks whether autocorrelations up to a lag are those of chance.

A process noise is *estimated* from derivatives, each read from a window of samples, so that neighbours share samples
and agree even where the noise is white. ``overlap`` says how many do; ``whiteness`` is then of values that share none.

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
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2, jarque_bera, norm

from mavdem.dem import Learned

Array = NDArray[np.float64]

FEWEST_VALUES = 20
"""Below this no test of shape or colour says anything."""

LAGS, SHARE_OF_LAGS = 10, 5
"""The Ljung-Box test takes so many lags, but no more than one of so many values."""

SHOWN_LAGS = 100
"""Lags of the autocorrelation that are told, of which a quarter of the values is the most."""

BOUND = float(norm.ppf(0.975))
"""Half width of the 95 % bounds of white noise's autocorrelation, times √N."""


class Significance(NamedTuple):
    """What a test came to.

    Attributes:
        statistic: large where the hypothesis is unlikely.
        p_value: how probable a statistic as large is where it holds.
    """

    statistic: float
    p_value: float


@dataclass(frozen=True)
class Noise:
    """What one series of noise is like.

    Attributes:
        values: how many there are.
        dt: step between them, s.
        mean, sd: in the unit of the noise.
        skewness, excess_kurtosis: 0 of a Gaussian.
        histogram: density of the values over ``edges``, in units of sd about the mean.
        edges: one more than bins.
        autocorrelation: at lags 0, 1, …, in steps.
        bound: 95 % of white noise's autocorrelations lie within ± this.
        normality: whether it is Gaussian, of whatever colour.
        normality_if_white: the same by the plain Jarque-Bera test, which rejects coloured noise for its colour.
        whiteness: whether values that share no samples are white.
        whiteness_of_all: whether all values are, shared samples or not.
        overlap: neighbouring values up to so many steps apart, less one, share samples.
        correlation_time: seconds over which it agrees with itself: the integral of the autocorrelation, over both
            signs of lag, up to where it first falls below ``bound``.
        smoothness: kernel width s, in seconds, of the Gaussian-kernel noise whose autocorrelation exp(−τ²/4s²) falls
            to a half at the same lag. Of white noise it is what samples cannot tell from white, about a third of dt.
        effective_values: as many independent ones tell as much of the mean.
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
    """What a series of noise is like.

    Args:
        values: (N,) finite, ``dt`` apart, in any unit.
        dt: seconds.
        overlap: how many neighbouring values an underlying sample goes into; 1 where each value is its own.

    Raises:
        ValueError: fewer than twenty values that share no samples, or values that are not finite or do not vary.
    """
    series = np.asarray(values, np.float64)
    if series.ndim != 1 or not np.isfinite(series).all():
        raise ValueError(f"values must be finite, of shape (N,), not {series.shape}")
    if overlap < 1 or len(series[::overlap]) < FEWEST_VALUES:
        raise ValueError(
            f"values must be {FEWEST_VALUES} at least that share no samples, not {len(series)} / {overlap}"
        )
    if not np.ptp(series):
        raise ValueError("values must vary")
    deviation = series - series.mean()
    sd = float(deviation.std())
    covariance = autocovariance(deviation / sd)
    lags = min(SHOWN_LAGS, len(series) // 4) + 1
    histogram, edges = np.histogram(deviation / sd, bins="auto", density=True)
    plain = jarque_bera(series)
    bound = BOUND / float(np.sqrt(len(series)))
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
    """Whether a stationary series of whatever colour is Gaussian (Lobato and Velasco's G, χ² of two degrees).

    Args:
        series: (N,) values.
    """
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
    """Whether a series is white: Ljung and Box's Q of the first lags, ten or a fifth of the values, χ² of as many.

    Args:
        series: (N,) values.
    """
    x = np.asarray(series, np.float64)
    n = len(x)
    lags = np.arange(1, min(LAGS, n // SHARE_OF_LAGS) + 1)
    covariance = autocovariance(x - x.mean())
    statistic = n * (n + 2) * float(((covariance[lags] / covariance[0]) ** 2 / (n - lags)).sum())
    return Significance(statistic, float(chi2.sf(statistic, len(lags))))


def autocovariance(deviation: Array) -> Array:
    """(N,) Σ x_t x_{t+k} / N at lags k = 0 … N − 1, of a series (N,) of mean zero.

    Args:
        deviation: from the mean.
    """
    n = len(deviation)
    spectrum = np.abs(np.fft.rfft(deviation, 2 * n)) ** 2
    return np.asarray(np.fft.irfft(spectrum)[:n] / n)


def _integrated(correlation: Array, bound: float) -> float:
    """Sum over lags of both signs, up to the first that is chance."""
    ends = np.flatnonzero(correlation < bound)
    return float(2 * correlation[: ends[0] if len(ends) else None].sum() - 1)


def _width(correlation: Array, bound: float) -> float:
    """Steps: the kernel width that the lag of half height belongs to.

    Between lags, ln ρ is taken for linear in the square of the lag, as that of Gaussian-kernel noise is. The height is
    where the estimate scatters least: half as much as one from the integral, which adds up what chance leaves of the
    tail.
    """
    after = int(np.flatnonzero(correlation < 0.5)[0])
    before = after - 1
    high, low = np.log(correlation[before]), np.log(max(correlation[after], bound))
    squared_lag = before**2 + (high - np.log(0.5)) / (high - low) * (after**2 - before**2)
    return float(np.sqrt(squared_lag / np.log(2)) / 2)


def process_noise(learned: Learned) -> dict[int, Noise]:
    """What the process noise of a learnt model is like, as it drives each output, by the output's number.

    That is C w, w = x′ − A x − B v as the D step found it, in units of the outputs per second: for the roll rate
    rad/s², the w^φ̇ of the paper's histograms. It does not depend on what the states are called. Where the training data
    have gaps it is that of the longest stretch between them.

    Args:
        learned: the model.

    Raises:
        ValueError: too few training samples, or a noise that does not vary, as when p = 0.
    """
    places, noise = learned.process_noise()
    runs = np.split(np.arange(len(places)), np.flatnonzero(np.diff(places) > 1) + 1)
    driving = noise[max(runs, key=len)] @ learned.model.C.T
    window = learned.settings.window
    assert window is not None
    return {output: analyse_noise(driving[:, output], learned.dt, overlap=window) for output in range(driving.shape[1])}
