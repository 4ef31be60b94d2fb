"""Whether series are those of a stationary Gaussian process: bounds from the sample's size, none of them chosen.

Of K independent series of n samples and the process's autocorrelation ρ follows how far estimates scatter (M. Bartlett
1946; M. Priestley, "Spectral Analysis and Time Series", 1981, 5.3 and 6.2). Each bound is exceeded by chance with
probability ``FALSE_ALARM``.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, gamma, norm

Array = NDArray[np.float64]

FALSE_ALARM = 1e-4

BANDS = 8


@dataclass(frozen=True)
class Stationary:
    """A process of variance 1: its ``autocorrelation`` at lags in seconds, seen in ``series`` (K, n) at steps of dt."""

    autocorrelation: Callable[[Array], Array]
    series: Array
    dt: float

    def variance(self) -> tuple[float, float, float]:
        """Estimate, and its lowest and highest.

        The mean square of n_eff independent samples, n_eff = Kn/Σρ², has a χ² distribution to second order.
        """
        count, n = self.series.shape
        weights = 1 - np.arange(n) / n
        rho = self.autocorrelation(np.arange(n) * self.dt)
        effective = count * n / (2 * np.sum(weights * rho**2) - 1)
        lowest, highest = chi2.interval(1 - FALSE_ALARM, effective) / effective
        return float(np.mean(self.series**2)), float(lowest), float(highest)

    def autocovariance(self, lag: int) -> tuple[float, float, float]:
        """Estimate at a lag in samples, and its lowest and highest.

        Var = Σ_k (1 − |k|/n′) (ρ_k² + ρ_{k+m} ρ_{k−m}) / (Kn′), n′ = n − m: Bartlett.
        """
        count, n = self.series.shape
        pairs = n - lag
        k = np.arange(-pairs + 1, pairs)

        def rho(at: Array) -> Array:
            return self.autocorrelation(np.abs(at) * self.dt)

        terms = (1 - np.abs(k) / pairs) * (rho(k) ** 2 + rho(k + lag) * rho(k - lag))
        margin = norm.isf(FALSE_ALARM / 2) * np.sqrt(terms.sum() / (count * pairs))
        expected = float(rho(np.array([lag]))[0])
        estimate = float(np.mean(self.series[:, : n - lag] * self.series[:, lag:]))
        return estimate, expected - margin, expected + margin

    def spectrum(self) -> list[tuple[float, float, float]]:
        """Mean ratio of periodogram and its expectation in bands of frequency, and its lowest and highest.

        Ordinates are independent and exponential where little leaks into them from elsewhere; others are left out.
        """
        count, n = self.series.shape
        expected, limit = self._expected(n), self._expected(16 * n)[::16]
        inner = np.arange(1, (n + 1) // 2)
        clean = inner[np.abs(expected[inner] / limit[inner] - 1) < 0.01]
        ordinates = np.mean(np.abs(np.fft.rfft(self.series)) ** 2, axis=0)[clean] * self.dt / n / expected[clean]
        edges = np.unique(np.geomspace(1, len(clean), BANDS + 1).astype(int) - 1)
        answers = []
        for start, end in zip(edges[:-1], edges[1:], strict=True):
            shape = count * (end - start)
            lowest, highest = gamma.interval(1 - FALSE_ALARM, shape, scale=1 / shape)
            answers.append((float(ordinates[start:end].mean()), float(lowest), float(highest)))
        return answers

    def _expected(self, n: int) -> Array:
        """Of the periodogram of n samples: the autocovariance under Fejér's window, transformed."""
        lags = np.arange(n)
        c = self.autocorrelation(lags * self.dt)
        wrapped = (1 - lags / n) * c
        wrapped[1:] += (lags / n * self.autocorrelation((n - lags) * self.dt))[1:]
        return self.dt * np.fft.rfft(wrapped).real


def holds(checked: tuple[float, float, float]) -> bool:
    """Whether an estimate lies within its bounds."""
    estimate, lowest, highest = checked
    return lowest <= estimate <= highest
