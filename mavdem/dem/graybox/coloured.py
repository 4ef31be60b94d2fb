"""Coloured noise as a state that white noise drives: turbulence, and the smooth noise of generalized coordinates."""

from __future__ import annotations

from math import factorial
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm, solve_continuous_lyapunov

from mavdem.dem.engine.linalg import Array


class Coloured(NamedTuple):
    """Stationary noise of variance 1, y = C x with ẋ = A x + white noise, in units of its own time."""

    A: Array  # (k, k)
    drive: Array  # (k, k) intensity of the white noise
    C: Array  # (k,)


def step_covariance(A: Array, drive: Array, dt: float) -> Array:
    """(…, n, n) covariance that white noise of intensity ``drive`` (…, n, n) adds to ẋ = A x in a step of ``dt`` s.

    Van Loan, "Computing integrals involving the matrix exponential", 1978.
    """
    n = A.shape[-1]
    flow = expm(np.block([[-A, drive], [np.zeros_like(A), np.swapaxes(A, -1, -2)]]) * dt)
    return np.asarray(np.swapaxes(flow[..., n:, n:], -1, -2) @ flow[..., :n, n:])


def _autoregressive(coefficients: Array) -> Coloured:
    """Of a denominator with the leading coefficient 1, highest power first, each state of variance 1."""
    order = len(coefficients) - 1
    A = np.eye(order, k=1)
    A[-1] = -coefficients[:0:-1]
    drive = np.zeros((order, order))
    drive[-1, -1] = 1.0
    size = np.sqrt(solve_continuous_lyapunov(A, -drive).diagonal())
    drive[-1, -1] /= size[-1] ** 2
    return Coloured(A * size / size[:, None], drive, np.eye(order)[0])


def _smooth(order: int) -> Coloured:
    """Noise of the Gaussian kernel whose width is the unit of time, of spectrum exp(−ω²).

    1/exp(ω²) by Taylor's series in the denominator: Hartikainen and Särkkä, "Kalman filtering and smoothing solutions
    to temporal Gaussian process regression models", MLSP 2010, sec. 3.3.
    """
    series = np.zeros(2 * order + 1)
    series[::2] = [(-1) ** power / factorial(power) for power in range(order, -1, -1)]
    roots = np.roots(series)
    return _autoregressive(np.real(np.poly(roots[roots.real < 0])))


FIRST_ORDER = _autoregressive(np.ones(2))  # autocorrelation exp(−|τ|): turbulence along its mean wind

SMOOTH = _smooth(8)
"""Autocorrelation exp(−τ²/4): noise with a Gaussian kernel, the noise of generalized coordinates (Eq. ``Smatrix``)."""

GUSTS = _smooth(4)
"""The same to fourth order, with half of the states: enough for the spectrum where there is power."""
