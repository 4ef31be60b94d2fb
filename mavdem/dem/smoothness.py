"""The correlation between a coloured noise and its own derivatives.

The noise is white noise convolved with the Gaussian kernel exp(−t²/2s²). Its autocorrelation is exp(−τ²/4s²), so
the smoothness s is the width of the *kernel*, not of the autocorrelation, and the first derivative has variance
1/(2s²).
"""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import inv


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
