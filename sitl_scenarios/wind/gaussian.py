"""Noise with a Gaussian kernel: the paper's coloured noise."""

from __future__ import annotations

from math import ceil, exp, fsum, sqrt

import numpy as np
from scipy.signal import fftconvolve

from sitl_scenarios.motion import Array


def gaussian_noise(s: float, dt: float, samples: int, noise: np.random.Generator) -> Array:
    """(samples,) of white noise through the kernel exp(−t²/2s²), s > 0 in seconds, of variance 1 at any ``dt``.

    Its autocorrelation is exp(−τ²/4s²), and its derivative has standard deviation 1/(√2 s): s is the width of the
    *kernel* (K. Friston et al., "DEM: A variational treatment of dynamic systems", NeuroImage 2008; the paper's
    Eq. ``Smatrix``).
    """
    # Steps of s/2 or less make the sums that stand for integrals exact to 1e-16; beyond 6 s lies 1e-9 of the kernel.
    every = max(1, ceil(dt / (0.5 * s)))
    step = dt / every
    reach = ceil(6.0 * s / step)
    # Plain sums and libm's exp: numpy's own choose instructions by the machine, and the last bit with them.
    kernel = [exp(-((i * step / s) ** 2) / 2) for i in range(-reach, reach + 1)]
    size = sqrt(fsum(k * k for k in kernel))
    white = noise.standard_normal((samples - 1) * every + len(kernel))
    coloured = fftconvolve(white, [k / size for k in kernel], "valid")
    return np.asarray(coloured[::every], dtype=np.float64)
