"""The correlation between a coloured noise and its own derivatives.

The noise is white noise convolved with the Gaussian kernel exp(−t²/2s²). Its autocorrelation is exp(−τ²/4s²), so
the smoothness s is the width of the *kernel*, not of the autocorrelation, and the first derivative has variance
1/(2s²).

Derivatives that are read from samples are others than the true ones: a window averages, and a difference sees nothing
within a step. What is read is linear in the samples, so its covariance is known as exactly as that of the noise.
"""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import inv
from scipy.special import erf

from mavdem.dem.coordinates import taylor_weights

WORST_CONDITION = 1e12
"""Of a covariance that is inverted: beyond, less than four digits are left of some of it."""


def temporal_covariance(order: int, smoothness: float) -> NDArray[np.float64]:
    """Covariance of [w, w′, …] of a noise of unit variance, Eq. ``Smatrix`` before it is inverted.

    Args:
        order: highest derivative.
        smoothness: kernel width s > 0, seconds.

    Returns:
        (order + 1, order + 1), in powers of 1/s: entry (i, j) is (−1)ⁱ times the (i+j)-th derivative of the
        autocorrelation at zero, which vanishes where i + j is odd.
    """
    covariance = np.zeros((order + 1, order + 1))
    for i in range(order + 1):
        for j in range(i % 2, order + 1, 2):
            k = (i + j) // 2
            derivative = (-1) ** k * factorial(2 * k) / factorial(k) / (4 * smoothness**2) ** k
            covariance[i, j] = (-1) ** i * derivative
    return covariance


def temporal_precision(order: int, smoothness: float) -> NDArray[np.float64]:
    """S(s²), the inverse of :func:`temporal_covariance`, (order + 1, order + 1).

    It is inverted in units of s, where its condition does not depend on the unit of time.
    """
    units = smoothness ** np.arange(order + 1)
    return np.asarray(inv(temporal_covariance(order, 1.0)) * np.outer(units, units))


def sampled_output_precision(order: int, smoothness: float, dt: float, window: int) -> NDArray[np.float64]:
    """S of a noise on the samples themselves, z, whose derivatives are read from a window of them.

    W K Wᵀ inverted, for the weights W of ``taylor_weights`` and K the autocorrelation between samples of the window.

    Args:
        order: highest derivative.
        smoothness: kernel width s > 0, seconds.
        dt, window: sampling step (s) and samples read.

    Returns:
        (order + 1, order + 1).
    """
    weights, lag = _reading(order, dt, window)
    return _precision_in_steps(weights @ np.exp(-((lag / smoothness) ** 2) / 4) @ weights.T, dt)


def sampled_state_precision(order: int, smoothness: float, dt: float, window: int) -> NDArray[np.float64]:
    """S of a noise that drives the states, w, whose k-th derivative is read as the k + 1-st of what it drives.

    So it is that of the noise's integral, of which the weights of derivatives see differences only: with
    g(τ) = ∫₀^τ (τ − u) exp(−u²/4s²) du, the mean square of the integral over τ is 2 g(τ), and the covariance −W g Wᵀ.

    Args:
        order: highest derivative of the noise, one less than that of the states.
        smoothness, dt, window: as in :func:`sampled_output_precision`.

    Returns:
        (order + 1, order + 1).
    """
    weights, lag = _reading(order + 1, dt, window)
    span, s = np.abs(lag), smoothness
    g = span * s * np.sqrt(np.pi) * erf(span / (2 * s)) + 2 * s**2 * np.expm1(-((span / s) ** 2) / 4)
    return _precision_in_steps(-weights[1:] @ g @ weights[1:].T, dt)


def _reading(order: int, dt: float, window: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weights (order + 1, window) of derivatives at the window's centre, and the times between its samples, s."""
    instants = dt * np.arange(window)
    return taylor_weights(order, dt, window, window // 2), instants[:, None] - instants


def _precision_in_steps(covariance: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
    """The inverse, taken in units of steps, where orders do not differ by powers of the sampling rate."""
    units = dt ** np.arange(len(covariance))
    if not np.linalg.cond(covariance * np.outer(units, units)) < WORST_CONDITION:
        raise ValueError(
            f"smoothness must be shorter for derivatives up to order {len(covariance) - 1}, or correlation "
            '"continuous": as they are read from samples, those of so smooth a noise are lost in rounding'
        )
    inverse = inv(covariance * np.outer(units, units)) * np.outer(units, units)
    return np.asarray((inverse + inverse.T) / 2)
