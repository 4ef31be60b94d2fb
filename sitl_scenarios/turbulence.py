"""Turbulence of a simulated wind: coloured noise of a Gaussian kernel, and Dryden's and von Kármán's of MIL-F-8785C.

Turbulence near the ground follows MIL-F-8785C, 3.7.3.4 and figures 10 and 11 (and MIL-HDBK-1797B, Appendix A,
4.9.2), with the height h in feet:

    L_w = h,  L_u = L_v = h / (0.177 + 0.000823 h)^1.2
    σ_w = 0.1 u₂₀,  σ_u = σ_v = σ_w / (0.177 + 0.000823 h)^0.4

MIL-HDBK-1797B halves L_v and L_w and writes 2L in their spectra, so that the spectra are the same; it is 8785C's L
here. The spectra are in space, and an aircraft meets them at its airspeed V. A hovering vehicle has none but the
wind's: V is the mean wind, and ``MIN_AIRSPEED`` at least, where the standard is silent.

Both kinds of turbulence have exactly their own variance and autocorrelation at any step, and begin in their stationary
state: Dryden's filters are solved exactly, von Kármán's autocorrelation is embedded in a circle.
"""

from collections.abc import Callable
from math import ceil, exp, fsum, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import solve_banded
from scipy.special import gamma, gammainc, kv

from sitl_scenarios.motion import Array
from sitl_scenarios.scenario import TurbulentWind

FOOT = 0.3048
"""Length of a foot, m."""

MIN_AIRSPEED = 1.0
"""Smallest airspeed V at which turbulence is met, m/s; a choice for winds that are weaker."""

MIN_HEIGHT_FEET = 10.0
"""Height at which the standard's model of low altitudes begins, ft; below, turbulence is as there."""

KERNEL_REACH = 6.0
"""Half-length of a Gaussian kernel, in its standard deviations: 1e-9 of the kernel lies beyond."""

MAX_KERNEL_STEP = 0.5
"""Longest step of a Gaussian kernel, in its standard deviations.

Up to this step the sums that stand for its integrals are exact to 1e-16.
"""

VON_KARMAN_A = 1.339
"""Constant a of von Kármán's spectra: it makes L the integral length scale of the longitudinal component."""

MAX_VON_KARMAN_LAG = 40.0
"""Lag ζ = Vτ/(aL) beyond which nothing is left of either autocorrelation: e^(−40)."""

MIN_VON_KARMAN_LAG = 1e-12
"""Smallest ζ at which Bessel functions are evaluated: they are infinite at 0."""

VON_KARMAN_FACTOR = 2 ** (2 / 3) / gamma(1 / 3)
"""Factor of von Kármán's autocorrelations, which makes them 1 at lag 0."""


def gaussian_noise(s: float, dt: float, samples: int, noise: Generator) -> Array:
    """Draws white noise through the kernel exp(−t²/2s²), of variance 1 at any sampling period.

    Its autocorrelation is exp(−τ²/4s²), and its derivative has standard deviation 1/(√2 s): s is the width of the
    *kernel* (K. Friston et al., "DEM: A variational treatment of dynamic systems", NeuroImage 2008; the paper's
    Eq. ``Smatrix``).

    Args:
        s: Standard deviation of the kernel, s; above 0.
        dt: Sampling period, s.
        samples: Number of samples.
        noise: Random number generator.

    Returns:
        (samples,) noise.
    """
    # Long periods are divided into steps, of which only the last of each period is returned.
    steps_per_sample = max(1, ceil(dt / (MAX_KERNEL_STEP * s)))
    step = dt / steps_per_sample
    half_length = ceil(KERNEL_REACH * s / step)
    # The C library's exp and exact sums: NumPy's own choose instructions by the machine, and the last bit with them.
    kernel = [exp(-((i * step / s) ** 2) / 2) for i in range(-half_length, half_length + 1)]
    norm = sqrt(fsum(k * k for k in kernel))
    white = noise.standard_normal((samples - 1) * steps_per_sample + len(kernel))
    # ``scipy.signal.fftconvolve`` does the same, but that package takes half a second to import.
    length = next_fast_len(len(white) + len(kernel) - 1, real=True)
    kernel_transform = rfft([k / norm for k in kernel], length)
    coloured = irfft(rfft(white, length) * kernel_transform, length)
    # Only where the whole kernel lies within the noise.
    return np.asarray(coloured[len(kernel) - 1 : len(white) : steps_per_sample])


class ProcessScale(NamedTuple):
    """Time constant and intensity of one component of turbulence."""

    time_constant: float
    """L/V, s; for rotation the time constant of its first-order process."""
    sd: float
    """Standard deviation, m/s; of rotation, rad/s."""


class TurbulenceScales(NamedTuple):
    """Scales of the turbulence at one height in one wind."""

    horizontal: ProcessScale
    """Scales of the components along the mean wind and across it."""
    vertical: ProcessScale
    """Scales of the vertical component."""
    rotation: ProcessScale
    """Scales of the air's rotation about a horizontal axis."""


def turbulence_scales(wind: TurbulentWind, height: float, span: float) -> TurbulenceScales:
    """Computes time constants and intensities of the turbulence of a wind, by MIL-F-8785C.

    A vehicle meets a length L at the airspeed V within the time L/V, which is the time constant. For the rotation of
    the air, the standard defines the component about the flight path, p_g, a first-order process in both models:

        Φ_p(Ω) = σ_w²/L_w · 0.8 (π L_w / 4b)^(1/3) / (1 + (4bΩ/π)²),

    whose variance is the integral of that over Ω ≥ 0. A hovering vehicle has no path: both horizontal axes get this.

    ``tests/scenarios/test_wind.py`` compares the scales with the standard's figures.

    Args:
        wind: Mean speed and intensity.
        height: Height above the ground, m.
        span: Distance b between the outermost rotors, m.

    Returns:
        Time constant, s, and standard deviation of horizontal and vertical wind, m/s, and of the air's rotation, rad/s.
    """
    # The formulas and constants are the standard's for low altitudes, which take the height in feet.
    feet = max(height / FOOT, MIN_HEIGHT_FEET)
    height_term = 0.177 + 0.000823 * feet
    airspeed = max(wind.speed, MIN_AIRSPEED)
    vertical_length = feet * FOOT
    horizontal_length = feet / height_term**1.2 * FOOT
    vertical_sd = 0.1 * wind.wind_at_20_feet
    horizontal_sd = vertical_sd / height_term**0.4
    length_ratio = (pi * vertical_length / (4 * span)) ** (1 / 3)
    rotation_variance = vertical_sd**2 / vertical_length * 0.8 * length_ratio * pi**2 / (8 * span)
    return TurbulenceScales(
        horizontal=ProcessScale(horizontal_length / airspeed, horizontal_sd),
        vertical=ProcessScale(vertical_length / airspeed, vertical_sd),
        rotation=ProcessScale(4 * span / (pi * airspeed), rotation_variance**0.5),
    )


def dryden_longitudinal(time_constant: float, dt: float, samples: int, noise: Generator) -> Array:
    """Draws Dryden's process along the wind, of variance 1.

    It is white noise of unit intensity through H_u(s) = √(2T) / (1 + Ts) (MIL-F-8785C, 3.7.1.2, whose √(2L/πV) belongs
    to spectra of which ∫₀^∞ Φ dω is the variance). Its autocorrelation is exp(−τ/T).

    Args:
        time_constant: T = L/V, s.
        dt: Sampling period, s.
        samples: Number of samples.
        noise: Random number generator.

    Returns:
        (samples,) values of the process, from its stationary state on.
    """
    # Sampled, it is x[k] = e^(−dt/T) x[k − 1] + noise, whose noise keeps the variance at 1; x[0] has variance 1 itself.
    decay = exp(-dt / time_constant)
    drive = noise.standard_normal(samples)
    drive[1:] *= sqrt(1 - decay * decay)
    return _first_order_recursion(decay, drive)


def dryden_transverse(time_constant: float, dt: float, samples: int, noise: Generator) -> Array:
    """Draws Dryden's process across the wind and down, of variance 1, by an exact solution of its filter.

    The filter is H_v(s) = √T (1 + √3 Ts) / (1 + Ts)², driven by white noise n; the autocorrelation of its output is
    (1 − τ/2T) exp(−τ/T). With the states x₁ = n/(1 + Ts) and x₂ = x₁/(1 + Ts), the output is √3 x₁ + (1 − √3) x₂. All
    of this is in units of T:

    - The stationary covariance of the states is [[1/2, 1/4], [1/4, 1/4]].
    - In a step of a = dt/T the states are multiplied by e^(−a) [[1, 0], [a, 1]].
    - The noise of the step adds the covariance Q = ∫₀ᵃ [1, u; u, u²] e^(−2u) du (C. Van Loan, "Computing integrals
      involving the matrix exponential", 1978). Its entries are incomplete gamma functions, which lose no digits at
      small a.

    ``tests/scenarios/test_wind.py`` tests the autocorrelation of the draws.

    Args:
        time_constant: T = L/V, s.
        dt: Sampling period, s.
        samples: Number of samples.
        noise: Random number generator.

    Returns:
        (samples,) values of the process, from its stationary state on.
    """
    a = dt / time_constant
    decay = exp(-a)
    q11 = gammainc(1, 2 * a) / 2
    q12 = gammainc(2, 2 * a) / 4
    q22 = gammainc(3, 2 * a) / 4
    white = noise.standard_normal((2, samples))
    # The Cholesky factor of Q makes the two noises out of white ones.
    drive1 = sqrt(q11) * white[0]
    correlated_part = q12 / sqrt(q11) * white[0]
    independent_sd = sqrt(q22 - q12**2 / q11)
    drive2 = correlated_part + independent_sd * white[1]
    # The first sample is drawn from the stationary state, by the Cholesky factor of its covariance.
    drive1[0] = sqrt(1 / 2) * white[0, 0]
    drive2[0] = sqrt(1 / 8) * (white[0, 0] + white[1, 0])
    # Each state decays by itself, and the first also drives the second.
    x1 = _first_order_recursion(decay, drive1)
    drive2[1:] += decay * a * x1[:-1]
    x2 = _first_order_recursion(decay, drive2)
    return sqrt(3) * x1 + (1 - sqrt(3)) * x2


def _first_order_recursion(decay: float, drive: Array) -> Array:
    """Returns x with x[0] = drive[0] and x[k] = decay x[k − 1] + drive[k]; (N,) like the drive.

    The equations x[k] − decay x[k − 1] = drive[k] are solved as a system with two diagonals. ``scipy.signal.lfilter``
    returns the same, but its import takes half a second.
    """
    diagonals = np.ones((2, len(drive)))
    diagonals[1] = -decay
    return solve_banded((1, 0), diagonals, drive)


def longitudinal_autocorrelation(time: Array) -> Array:
    """Returns von Kármán's autocorrelation along the wind, f = 2^(2/3)/Γ(1/3) ζ^(1/3) K_{1/3}(ζ) with ζ = Vτ/(aL).

    The source is T. von Kármán, "Progress in the statistical theory of turbulence", 1948.

    Args:
        time: Lags τ ≥ 0 in units of L/V, (N,).

    Returns:
        (N,) autocorrelation, 1 at lag 0.
    """
    zeta = np.maximum(time / VON_KARMAN_A, MIN_VON_KARMAN_LAG)
    bessel = kv(1 / 3, zeta)
    return VON_KARMAN_FACTOR * zeta ** (1 / 3) * bessel


def transverse_autocorrelation(time: Array) -> Array:
    """Returns von Kármán's autocorrelation across the wind and down, g = f − 2^(2/3)/Γ(1/3) ζ^(4/3) K_{2/3}(ζ)/2.

    Args:
        time: Lags τ ≥ 0 in units of L/V, (N,).

    Returns:
        (N,) autocorrelation, 1 at lag 0; f is that along the wind.
    """
    zeta = np.maximum(time / VON_KARMAN_A, MIN_VON_KARMAN_LAG)
    bessel = kv(2 / 3, zeta)
    return longitudinal_autocorrelation(time) - VON_KARMAN_FACTOR * zeta ** (4 / 3) * bessel / 2


def von_karman_noise(
    autocorrelation: Callable[[Array], Array],
    time_constant: float,
    dt: float,
    samples: int,
    noise: Generator,
) -> Array:
    """Draws one component of von Kármán's turbulence, of variance 1, by circulant embedding.

    MIL-F-8785C, 3.7.1.1, gives spectra that no rational filter has:

        Φ_u(Ω) = σ² 2L/π (1 + (aLΩ)²)^(−5/6)
        Φ_v(Ω) = σ² L/π (1 + 8/3 (aLΩ)²) (1 + (aLΩ)²)^(−11/6),  Φ_w likewise;  a = 1.339.

    Circulant embedding (C. Dietrich and G. Newsam, SIAM J. Sci. Comput. 1997) draws a series of just their
    autocorrelations. A synthesis from samples of the spectrum lacks what lies beyond half the sampling rate.

    ``tests/scenarios/test_wind.py`` tests the autocorrelation of the draws.

    Args:
        autocorrelation: Autocorrelation along or across the wind, as a function of lags in units of L/V.
        time_constant: L/V, s.
        dt: Sampling period, s.
        samples: Number of samples.
        noise: Random number generator.

    Returns:
        (samples,) values of the process.
    """
    memory = int(MAX_VON_KARMAN_LAG * VON_KARMAN_A * time_constant / dt) + 1
    # On a circle of this size the two ends of the series are uncorrelated.
    size = next_fast_len(2 * (samples + memory), real=True)
    lags = dt / time_constant * np.arange(memory + 1, dtype=np.float64)
    # First row of the circulant covariance matrix: positive lags from the front, negative ones from the end.
    correlation = np.zeros(size)
    correlation[: len(lags)] = autocorrelation(lags)
    negative_lags = correlation[1 : len(lags)][::-1]
    correlation[size - len(lags) + 1 :] = negative_lags
    # The Fourier transform of that row gives the eigenvalues of the matrix, which are the power of each frequency.
    # Rounding makes some of them slightly negative.
    power = np.maximum(rfft(correlation).real, 0.0)
    # A random spectrum of that power, transformed back, has this autocorrelation.
    real, imaginary = noise.standard_normal((2, len(power)))
    amplitude = np.sqrt(power * size / 2)
    spectrum = amplitude * (real + 1j * imaginary)
    # The mean, and with an even size the highest frequency, are real: their real part has all of their power.
    real_lines = [0]
    if size % 2 == 0:
        real_lines.append(len(power) - 1)
    for line in real_lines:
        spectrum[line] = np.sqrt(power[line] * size) * real[line]
    return irfft(spectrum, size)[:samples]
