"""Dryden turbulence: white noise through shaping filters, discretised exactly.

MIL-F-8785C, 3.7.1.2, at airspeed V with T = L/V, for white noise of unit intensity:

    H_u(s) = σ_u √(2T) / (1 + Ts)         H_v(s) = σ_v √T (1 + √3 Ts) / (1 + Ts)²,   H_w likewise

The standard's √(2L/πV) and √(L/πV) belong to spectra of which ∫₀^∞ Φ dω is the variance. A filter is a linear system;
what it does in a step is known exactly, and so is the covariance of what the noise adds to its states in that time
(C. Van Loan, "Computing integrals involving the matrix exponential", 1978; here in closed form). So variance and
autocorrelation are the process's own at any step, and it begins in its stationary state.
"""

from __future__ import annotations

from math import exp, sqrt

import numpy as np
from scipy.signal import lfilter
from scipy.special import gammainc

from sitl_scenarios.motion import Array


def first_order(constant: float, dt: float, samples: int, noise: np.random.Generator) -> Array:
    """(samples,) of the process of H_u, of variance 1 and autocorrelation exp(−τ/T), T being ``constant``, s."""
    keeps = exp(-dt / constant)
    drive = noise.standard_normal(samples)
    drive[1:] *= sqrt(1 - keeps * keeps)
    return _lag(keeps, drive)


def second_order(constant: float, dt: float, samples: int, noise: np.random.Generator) -> Array:
    """(samples,) of the process of H_v, of variance 1 and autocorrelation (1 − τ/2T) exp(−τ/T).

    With x₁ = n/(1 + Ts) and x₂ = x₁/(1 + Ts) it is √3 x₁ + (1 − √3) x₂. In units of T, states in a stationary state
    have the covariance [[1/2, 1/4], [1/4, 1/4]]; after a = dt/T the old ones count e^(−a) [[1, 0], [a, 1]], and new
    ones have the covariance ∫₀ᵃ [1, u; u, u²] e^(−2u) du: incomplete gamma functions, which lose no digits at small a.
    """
    a = dt / constant
    keeps = exp(-a)
    q11, q12, q22 = gammainc(1, 2 * a) / 2, gammainc(2, 2 * a) / 4, gammainc(3, 2 * a) / 4
    white = noise.standard_normal((2, samples))
    first, second = sqrt(q11) * white[0], q12 / sqrt(q11) * white[0] + sqrt(q22 - q12**2 / q11) * white[1]
    first[0] = sqrt(1 / 2) * white[0, 0]
    second[0] = sqrt(1 / 8) * (white[0, 0] + white[1, 0])
    x1 = _lag(keeps, first)
    second[1:] += keeps * a * x1[:-1]
    return sqrt(3) * x1 + (1 - sqrt(3)) * _lag(keeps, second)


def _lag(keeps: float, drive: Array) -> Array:
    """X with x[0] = drive[0] and x[k] = keeps x[k − 1] + drive[k]."""
    return np.asarray(lfilter([1.0], [1.0, -keeps], drive))
