"""Von Kármán turbulence, from its autocorrelation by FFT.

MIL-F-8785C, 3.7.1.1, gives spectra that no rational filter has:

    Φ_u(Ω) = σ² 2L/π (1 + (aLΩ)²)^(−5/6)
    Φ_v(Ω) = σ² L/π (1 + 8/3 (aLΩ)²) (1 + (aLΩ)²)^(−11/6),  Φ_w likewise;  a = 1.339.

Their autocorrelations are Bessel functions of ζ = Vτ/(aL) (T. von Kármán, "Progress in the statistical theory of
turbulence", PNAS 1948):

    f = 2^(2/3)/Γ(1/3) ζ^(1/3) K_{1/3}(ζ)     along,
    g = f − 2^(2/3)/Γ(1/3) ζ^(4/3) K_{2/3}(ζ)/2     across.

A series of just these is drawn by circulant embedding (C. Dietrich and G. Newsam, SIAM J. Sci. Comput. 1997): variance
and autocorrelation are exact at any step, as no synthesis from samples of the spectrum is, which lacks what lies beyond
half the sampling rate.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import gamma, kv

from sitl_scenarios.motion import Array

LENGTH = 1.339  # a: it makes L the integral of f


def along(time: Array) -> Array:
    """F at lags ``time`` ≥ 0, in units of L/V; both (N,)."""
    zeta = np.maximum(time / LENGTH, 1e-12)
    return np.asarray(2 ** (2 / 3) / gamma(1 / 3) * zeta ** (1 / 3) * kv(1 / 3, zeta))


def across(time: Array) -> Array:
    """G at lags ``time`` ≥ 0, in units of L/V; both (N,)."""
    zeta = np.maximum(time / LENGTH, 1e-12)
    return np.asarray(along(time) - 2 ** (2 / 3) / gamma(1 / 3) * zeta ** (4 / 3) * kv(2 / 3, zeta) / 2)


def von_karman_noise(transverse: bool, constant: float, dt: float, samples: int, noise: np.random.Generator) -> Array:
    """(samples,) of the process of Φ_u, or, ``transverse``, of Φ_v, of variance 1; L/V is ``constant``, s."""
    # At ζ = 40 nothing is left of either autocorrelation: e^(−40).
    memory = int(40.0 * LENGTH * constant / dt) + 1
    # A circle on which the two ends of the series are uncorrelated.
    size = next_fast_len(2 * (samples + memory), real=True)
    lags = dt / constant * np.arange(memory + 1, dtype=np.float64)
    correlation = np.zeros(size)
    correlation[: len(lags)] = (across if transverse else along)(lags)
    correlation[size - len(lags) + 1 :] = correlation[1 : len(lags)][::-1]
    # What rounding leaves below zero is none.
    power = np.maximum(rfft(correlation).real, 0.0)
    parts = noise.standard_normal((2, len(power)))
    spectrum = np.sqrt(power * size / 2) * (parts[0] + 1j * parts[1])
    # The mean, and with an even size the highest frequency, have one part, with all of their power.
    for single in (0, -1) if size % 2 == 0 else (0,):
        spectrum[single] = np.sqrt(power[single] * size) * parts[0, single]
    return np.asarray(irfft(spectrum, size)[:samples])
