"""Generalized coordinates: x̃ = [x; x′; x″; …], a signal and its derivatives, from samples; and S of their noise.

A generalized vector is order-major: all components at order 0, then all their first derivatives, and so on.
"""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import inv
from scipy.ndimage import correlate1d
from scipy.special import erf


def taylor_weights(order: int, dt: float, window: int, at: float) -> NDArray[np.float64]:
    """Weights that turn samples into derivatives: the least-squares polynomial of degree ``order`` over a window.

    With ``window = order + 1`` the polynomial interpolates, which is the inverse of the Taylor matrix that the
    literature embeds with. A wider window averages measurement noise away, at the price of bandwidth. The derivatives
    are taken ``at`` a place in the window, in samples from its first, of samples ``dt`` s apart; row k of
    (order + 1, window) gives the k-th.
    """
    offsets = np.arange(window) - at
    # The fit is made in steps, where it is well conditioned, and scaled to seconds afterwards.
    taylor = np.stack([offsets**k / factorial(k) for k in range(order + 1)], axis=1)
    per_step = np.linalg.pinv(taylor)
    return per_step / dt ** np.arange(order + 1)[:, None]


def embed(samples: NDArray[np.float64], order: int, dt: float, window: int, at: int) -> NDArray[np.float64]:
    """Generalized vectors of ``samples`` (T, m), one for each place the whole window of :func:`taylor_weights` fits.

    (T − window + 1, (order + 1)·m): row i belongs to sample ``i + at``. Nothing is padded.
    """
    weights = taylor_weights(order, dt, window, at)
    # The filter centres itself on window // 2; what it pads beyond the ends is cut off again.
    whole = slice(window // 2, len(samples) - (window - 1 - window // 2))
    return np.hstack([correlate1d(samples, row, axis=0)[whole] for row in weights])


def derivative_operator(order: int, size: int) -> NDArray[np.float64]:
    """D, Eq. ``generative_process``, which moves every block of ``size`` up by one order; the last becomes zero."""
    return np.asarray(np.kron(np.eye(order + 1, k=1), np.eye(size)), np.float64)


WORST_CONDITION = 1e12
"""Of a covariance that is inverted: beyond, less than four digits are left of some of it."""


def temporal_covariance(order: int, smoothness: float) -> NDArray[np.float64]:
    """Covariance of [w, w′, …] of a noise of unit variance and kernel width s, Eq. ``Smatrix`` before it is inverted.

    (order + 1, order + 1), in powers of 1/s: entry (i, j) is (−1)ⁱ times the (i+j)-th derivative of the autocorrelation
    at zero, which vanishes where i + j is odd.
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
    """S of a noise on the samples themselves, z, whose derivatives are estimated from a window of them.

    W K Wᵀ (order + 1, order + 1) inverted, for the weights W of ``taylor_weights`` and K the autocorrelation between
    samples of the window.
    """
    weights, lag = _reading(order, dt, window)
    return _precision_in_steps(weights @ np.exp(-((lag / smoothness) ** 2) / 4) @ weights.T, dt)


def sampled_state_precision(order: int, smoothness: float, dt: float, window: int) -> NDArray[np.float64]:
    """S of a noise that drives the states, w, whose k-th derivative is estimated as the k + 1-st of what it drives.

    So it is that of the noise's integral, of which the weights of derivatives see differences only: with
    g(τ) = ∫₀^τ (τ − u) exp(−u²/4s²) du, the mean square of the integral over τ is 2 g(τ), and the covariance −W g Wᵀ.
    The ``order`` of the noise is one less than that of the states.
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
            '"continuous": as estimated from samples, those of so smooth a noise are lost in rounding'
        )
    inverse = inv(covariance * np.outer(units, units)) * np.outer(units, units)
    return np.asarray((inverse + inverse.T) / 2)
