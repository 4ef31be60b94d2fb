"""Power spectral densities by periodograms of half-overlapping windows, and by Welch's method, their mean.

They equal the densities of ``scipy.signal.spectrogram`` and ``welch``. That package takes half a second to import,
and most logs need nothing else of it.
"""

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array


class PowerDensity(NamedTuple):
    """One-sided power spectral density of a signal."""

    frequency: Array
    """(F,) frequencies from 0 to half of the sampling rate, Hz."""
    density: Array
    """(F,) density, the signal's unit squared per Hz; (…, W, F) for several signals in W windows."""


def power_density(
    values: Array, rate: float, window_samples: int, without_trend: bool = False
) -> PowerDensity:
    """Estimates the power spectral density of a signal by Welch's method.

    Periodograms of windows that overlap by half, each through Hann's window, are averaged (P. D. Welch, IEEE
    Transactions on Audio and Electroacoustics 15(2), 1967).

    Args:
        values: (N,) samples, at least ``window_samples``.
        rate: their rate, Hz.
        window_samples: number of samples of a window, at least 2.
        without_trend: whether the linear trend of each window is removed too, and not only its mean.

    Returns:
        The frequencies (F,), Hz, and the one-sided densities (F,), in the square of the values' unit per Hz.
    """
    densities = window_densities(values, rate, window_samples, without_trend=without_trend)
    return PowerDensity(densities.frequency, densities.density.mean(axis=0))


def window_densities(
    values: Array, rate: float, window_samples: int, *, without_trend: bool = False
) -> PowerDensity:
    """Estimates the power spectral density of signals in each of W windows, by periodograms through a Hann window.

    Windows overlap by half: window i, from 0, begins at sample i times half of the window, rounded up.

    ``tests/plant/test_power_density.py`` compares them with SciPy's.

    Args:
        values: (…, N) samples of any number of signals.
        rate: sampling rate, Hz.
        window_samples: number of samples of a window.
        without_trend: whether the linear trend of each window is removed too, and not only its mean.

    Returns:
        The frequencies (F,), Hz, and the one-sided densities (…, W, F).
    """
    step = window_samples - window_samples // 2
    windows = np.lib.stride_tricks.sliding_window_view(values, window_samples, axis=-1)
    windows = windows[..., ::step, :]
    deviations = windows - windows.mean(axis=-1, keepdims=True)
    if without_trend:
        # Time relative to the middle of the window is orthogonal to a constant, so that the slope of the regression
        # does not depend on the mean.
        time = np.arange(window_samples) - (window_samples - 1) / 2
        slopes = deviations @ time / (time @ time)
        deviations = deviations - slopes[..., None] * time
    phase = 2 * np.pi * np.arange(window_samples) / window_samples
    hann_window = 0.5 - 0.5 * np.cos(phase)
    transforms = np.fft.rfft(deviations * hann_window)
    periodograms = np.square(np.abs(transforms)) / (rate * (hann_window @ hann_window))
    # The power at negative frequencies is added to the positive ones. Frequency 0 and, for an even number of samples,
    # the highest one have no negative counterpart.
    end_of_doubled = periodograms.shape[-1]
    if window_samples % 2 == 0:
        end_of_doubled -= 1
    periodograms[..., 1:end_of_doubled] *= 2
    frequency = np.asarray(np.fft.rfftfreq(window_samples, 1 / rate), np.float64)
    return PowerDensity(frequency, periodograms)
