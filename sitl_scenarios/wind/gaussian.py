"""Noise with a Gaussian kernel: the paper's coloured noise."""

from __future__ import annotations

from math import ceil, exp, fsum, sqrt

import numpy as np
from scipy.signal import fftconvolve

from sitl_scenarios.motion import Array

_REACH = 6.0
"""Of the kernel, in s: beyond lies 1e-9 of it."""

_FINEST = 0.5
"""Of s: the step between the white noise's samples; the sums that stand for integrals are then exact to 1e-16."""


def gaussian_noise(s: float, dt: float, samples: int, noise: np.random.Generator) -> Array:
    """White noise through the kernel exp(−t²/2s²), of variance 1 at any ``dt``.

    Its autocorrelation is exp(−τ²/4s²), and its derivative has standard deviation 1/(√2 s): s is the width of the
    *kernel* (K. Friston et al., "DEM: A variational treatment of dynamic systems", NeuroImage 2008; the paper's
    Eq. ``Smatrix``).

    Args:
        s: > 0, seconds.
        dt: between samples, s.
        samples: how many.
        noise: source of randomness.

    Returns:
        (samples,)
    """
    every = max(1, ceil(dt / (_FINEST * s)))
    step = dt / every
    reach = ceil(_REACH * s / step)
    # Plain sums and libm's exp: numpy's own choose instructions by the machine, and the last bit with them.
    kernel = [exp(-((i * step / s) ** 2) / 2) for i in range(-reach, reach + 1)]
    size = sqrt(fsum(k * k for k in kernel))
    white = noise.standard_normal((samples - 1) * every + len(kernel))
    coloured = fftconvolve(white, [k / size for k in kernel], "valid")
    return np.asarray(coloured[::every], dtype=np.float64)
