"""Generalized coordinates of a signal as it is seen through a Gaussian kernel: what is read is exact.

Derivatives that a polynomial reads from samples are not quite those of one signal: where it turns within the window,
the y″ that is read is not the derivative of the y′ that is read, and states that nobody has may explain the difference.
A signal convolved with a kernel has for derivatives its convolutions with the kernel's own, sums over samples in which
only aliasing errs. Convolution leaves ẋ = Ax + Bv + w and y = Cx + z what they are; white noise becomes Gaussian-kernel
noise of the kernel's width σ, and Gaussian-kernel noise of smoothness s that of √(s² + σ²), so that Eq. ``Smatrix``
holds of what is read.

(Derivatives of Gaussians: Koenderink and van Doorn 1987, Biological Cybernetics 55, 367. That filtering both sides of a
linear equation alike leaves it true: Young 1981, Automatica 17, 23.)
"""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.polynomial.hermite_e import hermeval
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

Array = NDArray[np.float64]

REACH = 6.0
"""Widths of the kernel to either side, beyond which even its eighth derivative is next to nothing (5e-5)."""

NARROWEST = 1.5
"""Steps: of a narrower kernel's derivatives, samples do not tell the shape."""

ROUNDING = 1e-9
"""Of a width that is meant to be a number of steps."""


def kernel_weights(order: int, width: float, dt: float) -> Array:
    """Weights that turn samples into derivatives of the signal convolved with exp(−t²/2σ²)/√(2π)σ.

    Args:
        order: highest derivative p.
        width: σ of the kernel, seconds, at least ``NARROWEST`` steps.
        dt: sampling step, s.

    Returns:
        (order + 1, window): row k gives the k-th derivative at the window's centre.

    Raises:
        ValueError: a kernel too narrow for the samples.
    """
    if not width >= NARROWEST * dt * (1 - ROUNDING):
        raise ValueError(f"width must be at least {NARROWEST:g} steps of {dt:g} s, not {width:g} s")
    reach = ceil(REACH * width / dt * (1 - ROUNDING))
    at = np.arange(-reach, reach + 1) * dt / width
    kernel = np.exp(-(at**2) / 2) * dt / (np.sqrt(2 * np.pi) * width)
    # The k-th derivative of the kernel is (−1/σ)ᵏ Heₖ(t/σ) times it; a convolution meets it turned around, t → −t.
    return np.stack([hermeval(at, np.eye(order + 1)[k]) * kernel / width**k for k in range(order + 1)])


def embed_through_kernel(samples: Array, order: int, width: float, dt: float) -> Array:
    """Generalized vectors of a sampled signal convolved with a Gaussian kernel, where the whole kernel fits.

    Args:
        samples: (T, m), uniformly sampled.
        order, width, dt: see :func:`kernel_weights`.

    Returns:
        (T − window + 1, (order + 1)·m), order-major; none where the window is longer than the signal.
    """
    weights = kernel_weights(order, width, dt)
    reach = weights.shape[1] // 2
    if len(samples) <= 2 * reach:
        return np.empty((0, (order + 1) * samples.shape[1]))
    return np.hstack([correlate1d(samples, row, axis=0)[reach:-reach] for row in weights])
