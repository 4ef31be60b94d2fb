"""Section V.C: is the process noise Gaussian, as the Laplace approximation assumes, and is it coloured?

For a stationary Gaussian series of autocorrelation ρ, the variances of √N times skewness and excess kurtosis tend to
6 Σρ(k)³ and 24 Σρ(k)⁴ over all lags, positive and negative (Lomnicki). The Jarque-Bera test takes 6 and 24, so it
rejects coloured Gaussian noise nearly always; ``normality`` estimates the sums as Lobato and Velasco do.

A process noise is *estimated* from derivatives, each from a window of samples, so that neighbouring values are
correlated for any noise: ``overlap`` of them share a sample, and ``whiteness`` is of values that share none.

References:
    Z. A. Lomnicki, "Tests for departure from normality in the case of linear stochastic processes", Metrika 4 (1961).
    I. N. Lobato, C. Velasco, "A simple test of normality for time series", Econometric Theory 20 (2004) 671-689.
    G. M. Ljung, G. E. P. Box, "On a measure of lack of fit in time series models", Biometrika 65 (1978) 297-303.
"""

from __future__ import annotations

from functools import partial
from math import sqrt
from typing import NamedTuple

import numpy as np
from scipy.signal import correlate
from scipy.stats import chi2, norm

from mavdem.arrays import Array
from mavdem.containers import JsonValues
from mavdem.dem import learn
from mavdem.experiments.paper import figures
from mavdem.experiments.paper.runner import PAPER, Check, ExperimentResult, Runner
from mavdem.experiments.window import Window
from mavdem.report.figures.style import Picture

TEST_LEVEL = 0.01  # of each test; with five tests, one report in twenty rejects a true hypothesis


def run(runner: Runner) -> ExperimentResult:
    """Tests the process noise of the learned models."""
    named = {f"experiment {number}": window for number, window in runner.experiments.items()}
    # Every other window: those next to each other share a half.
    apart = runner.recorded[::2]
    noises = runner.each(noise_of_model, (*named.values(), *apart))
    learned = dict(zip(named, noises, strict=False))
    real = noises[len(named) :]
    by_p = sorted(real, key=lambda noise: noise.normality.p_value)
    shown = learned | ({"real AR.Drone": by_p[len(by_p) // 2]} if by_p else {})
    bound = max(noise.bound for noise in shown.values())
    correlations = {name: noise.autocorrelation[:60] for name, noise in shown.items()}
    return ExperimentResult(
        checks=(
            *checks(list(learned.values()), "w^φ̇ of the learned models", "flights"),
            *(checks(real, "w^φ̇ of the real AR.Drone", "windows") if real else ()),
        ),
        numbers={
            "learnt": {name: noise.to_dict() for name, noise in learned.items()},
            "real AR.Drone, learnt": [noise.to_dict() for noise in real],
        },
        pictures=(
            Picture(
                "Histograms of the process noise w^φ̇",
                "Under DEM’s models (the paper’s settings), in units of its standard deviation; line: a Gaussian. Of "
                "the real AR.Drone, the window with the median p.",
                partial(figures.histograms, {name: noise.values for name, noise in shown.items()}),
            ),
            Picture(
                "Autocorrelation of w^φ̇",
                f"Lines: 95 % bounds of white noise. Values at lags below {PAPER.window} share samples, so they "
                "correlate even if the noise is white.",
                partial(figures.lines, {"": correlations}, "lag, samples", bounds=(-bound, bound)),
            ),
        ),
    )


def noise_of_model(window: Window) -> NoiseSeries:
    """Returns w^φ̇ = (C(x′ − Ax − Bv))^φ̇, rad/s², under DEM with the paper's settings, as the D step estimates it."""
    learned = learn(window.train, PAPER)
    _, noise = learned.process_noise()
    overlap = learned.settings.window
    assert overlap is not None
    return analyse_noise(noise @ learned.model.C[-1], overlap)


def checks(noises: list[NoiseSeries], whose: str, pieces: str) -> tuple[Check, ...]:
    """Returns whether each is Gaussian, and whether coloured; ``whose`` and ``pieces`` are for the sentences."""
    gaussian = sum(noise.normality.p_value >= TEST_LEVEL for noise in noises)
    coloured = sum(
        noise.autocorrelation[noise.overlap] > noise.bound and noise.whiteness.p_value < TEST_LEVEL
        for noise in noises
    )
    return (
        Check(
            f"{whose}: the test for Gaussian noise of any colour has p ≥ {TEST_LEVEL} every time",
            gaussian == len(noises),
            f"{whose} is Gaussian in {gaussian} of {len(noises)} {pieces}",
        ),
        Check(
            f"{whose}: its autocorrelation lies above the 95 % bound at the first lag that shares no samples, and the "
            f"test for white noise of values that share none has p < {TEST_LEVEL}, every time",
            coloured == len(noises),
            f"{whose} is coloured in {coloured} of {len(noises)}",
        ),
    )


LAGS = 10  # of the Ljung-Box test
MAX_LAGS = 100  # lags of the reported autocorrelation; at most a quarter of the values
# half width of the 95 % bounds of white noise's autocorrelation, times √N
WHITE_BOUND = float(norm.ppf(0.975))


class Significance(NamedTuple):
    """The result of a test: ``p_value``, the probability of a ``statistic`` as large under the hypothesis."""

    statistic: float
    p_value: float


class NoiseSeries(NamedTuple):
    """One series of noise."""

    values: Array  # (N,) about their mean, in units of their standard deviation
    autocorrelation: Array  # at lags 0, 1, … in steps
    bound: float  # 95 % of white noise's autocorrelations lie within ± it
    normality: Significance  # test for Gaussian noise of any colour
    whiteness: Significance  # test for white noise, of values that share no samples
    overlap: int  # values closer than so many steps share samples

    def to_dict(self) -> JsonValues:
        """Returns plain JSON values by name."""
        return {
            "autocorrelation": self.autocorrelation.tolist(),
            "bound": self.bound,
            "normality": self.normality._asdict(),
            "whiteness": self.whiteness._asdict(),
        }


def analyse_noise(values: Array, overlap: int) -> NoiseSeries:
    """Returns the statistics of a series of noise: ``values`` (N,) that vary, in any unit.

    ``overlap``: number of neighbouring values that an underlying sample contributes to; 1 if values share none.
    """
    scaled = (values - values.mean()) / values.std()
    return NoiseSeries(
        scaled,
        autocorrelation=autocovariance(scaled)[: min(MAX_LAGS, len(values) // 4) + 1],
        bound=WHITE_BOUND / sqrt(len(values)),
        normality=normality(scaled),
        whiteness=whiteness(values[::overlap]),
        overlap=overlap,
    )


def normality(series: Array) -> Significance:
    """Tests whether a stationary series of any colour is Gaussian (Lobato and Velasco's G, χ² of two degrees)."""
    x = series - series.mean()
    n = len(x)
    variance = x.var()
    covariance = autocovariance(x)
    # Each lag with the one that a series closed to a ring would have too; the sums then need no truncation.
    opposite = np.append(0.0, covariance[:0:-1])
    both_signs = np.append(1.0, np.full(n - 1, 2.0))
    third, fourth = (
        (both_signs * covariance * (covariance + opposite) ** power).sum() for power in (2, 3)
    )
    statistic = n * (x**3).mean() ** 2 / (6 * third) + n * (
        (x**4).mean() - 3 * variance**2
    ) ** 2 / (24 * fourth)
    return Significance(float(statistic), float(chi2.sf(statistic, 2)))


def whiteness(series: Array) -> Significance:
    """Tests whether a series is white: Ljung and Box's Q of the first ten lags, χ² of as many degrees."""
    n = len(series)
    lags = np.arange(1, LAGS + 1)
    covariance = autocovariance(series - series.mean())
    statistic = n * (n + 2) * float(((covariance[lags] / covariance[0]) ** 2 / (n - lags)).sum())
    return Significance(statistic, float(chi2.sf(statistic, len(lags))))


def autocovariance(deviation: Array) -> Array:
    """Returns (N,) Σ x_t x_{t+k} / N at lags k = 0 … N − 1, of a series (N,) of mean zero."""
    return correlate(deviation, deviation)[len(deviation) - 1 :] / len(deviation)
