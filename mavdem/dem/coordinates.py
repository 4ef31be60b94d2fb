"""Generalized coordinates: a signal and its derivatives, x̃ = [x; x′; x″; …], and how to read them off samples.

A generalized vector is order-major: all components at order 0, then all their first derivatives, and so on.
"""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d


def taylor_weights(order: int, dt: float, window: int, at: float) -> NDArray[np.float64]:
    """Weights that turn samples into derivatives: the least-squares polynomial of degree ``order`` over a window.

    With ``window = order + 1`` the polynomial interpolates, which is the inverse of the Taylor matrix that the
    literature embeds with. A wider window averages measurement noise away, at the price of bandwidth.

    Args:
        order: highest derivative p.
        dt: sampling step, s.
        window: samples used, at least ``order + 1``.
        at: place in the window, in samples from its first, at which the derivatives are taken.

    Returns:
        (order + 1, window): row k gives the k-th derivative.
    """
    offsets = np.arange(window) - at
    # The fit is made in steps, where it is well conditioned, and scaled to seconds afterwards.
    taylor = np.stack([offsets**k / factorial(k) for k in range(order + 1)], axis=1)
    per_step = np.linalg.pinv(taylor)
    return per_step / dt ** np.arange(order + 1)[:, None]


def embed(samples: NDArray[np.float64], order: int, dt: float, window: int, at: int) -> NDArray[np.float64]:
    """Generalized vectors of a sampled signal, one for each place the whole window fits.

    Args:
        samples: (T, m), uniformly sampled.
        order, dt, window, at: see :func:`taylor_weights`.

    Returns:
        (T − window + 1, (order + 1)·m): row i belongs to sample ``i + at``. Nothing is padded.
    """
    weights = taylor_weights(order, dt, window, at)
    # The filter centres itself on window // 2; what it pads beyond the ends is cut off again.
    whole = slice(window // 2, len(samples) - (window - 1 - window // 2))
    return np.hstack([correlate1d(samples, row, axis=0)[whole] for row in weights])


def derivative_operator(order: int, size: int) -> NDArray[np.float64]:
    """D, which moves every block of a generalized vector up by one order; the last becomes zero.

    Returns:
        ((order + 1)·size, (order + 1)·size), Eq. ``generative_process``.
    """
    return np.asarray(np.kron(np.eye(order + 1, k=1), np.eye(size)), np.float64)
