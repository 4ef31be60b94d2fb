"""Wind: noise, Dryden and von Kármán turbulence, gusts and jets; and a scenario's weather, their sum, cycle by cycle.

Turbulence near the ground is that of MIL-F-8785C, 3.7.3.4 and figures 10 and 11 (and MIL-HDBK-1797B, Appendix A,
4.9.2), with the height h in feet:

    L_w = h,  L_u = L_v = h / (0.177 + 0.000823 h)^1.2
    σ_w = 0.1 u₂₀,  σ_u = σ_v = σ_w / (0.177 + 0.000823 h)^0.4

MIL-HDBK-1797B halves L_v and L_w and writes 2L in their spectra, so that the spectra are the same; it is 8785C's L
here. The spectra are in space, and an aircraft meets them at its airspeed V. A hovering vehicle has none but the
wind's: V is the mean wind, and ``LEAST_SPEED`` at least, where the standard is silent.

Both kinds of turbulence have exactly their own variance and autocorrelation at any step, and begin in their stationary
state: Dryden's filters are solved exactly, von Kármán's autocorrelation is embedded in a circle.
"""

from collections.abc import Callable
from functools import partial
from math import ceil, cos, exp, fsum, log, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal import fftconvolve, lfilter
from scipy.special import gamma, gammainc, kv

from sitl_scenarios.dynamics import AirState
from sitl_scenarios.motion import Array, Pair
from sitl_scenarios.rotors import rotor_frame
from sitl_scenarios.scenario import (
    MOMENT,
    WIND,
    GaussianWind,
    Gust,
    Jet,
    Scenario,
    SteadyWind,
    TurbulentWind,
    towards,
)
from sitl_scenarios.vectors import Vector3
from sitl_scenarios.vehicles import airframe


def gaussian_noise(s: float, dt: float, samples: int, noise: Generator) -> Array:
    """Returns (samples,) of white noise through the kernel exp(−t²/2s²), s > 0 in seconds, of variance 1 at any ``dt``.

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
    return fftconvolve(white, [k / size for k in kernel], "valid")[::every]


FOOT = 0.3048  # m
LEAST_SPEED = 1.0  # m/s: V in less wind


class Turbulence(NamedTuple):
    """At one height in one wind."""

    # (L/V in s, σ in m/s) of the components along the mean wind and across it, and down
    level: Pair
    down: Pair
    # (time constant in s, standard deviation in rad/s) of the air's rotation about a horizontal axis
    rotation: Pair


def turbulence(wind: TurbulentWind, height: float, span: float) -> Turbulence:
    """Returns lengths and intensities of a wind, by the standard.

    ``height`` and ``span`` b between the outermost rotors are in m.

    Of its rotation it gives that about the flight path, p_g, a first-order process for Dryden and von Kármán alike:

        Φ_p(Ω) = σ_w²/L_w · 0.8 (π L_w / 4b)^(1/3) / (1 + (4bΩ/π)²),

    whose variance is the integral of that over Ω ≥ 0. A hovering vehicle has no path: both of its axes get this.
    """
    # The standard's model begins at 10 feet, and holds below as it is there.
    feet = max(height / FOOT, 10.0)
    slope = 0.177 + 0.000823 * feet
    airspeed = max(wind.speed, LEAST_SPEED)
    low = feet * FOOT
    wide = feet / slope**1.2 * FOOT
    vertical = 0.1 * wind.wind_at_20_feet
    horizontal = vertical / slope**0.4
    shape = (pi * low / (4 * span)) ** (1 / 3)
    variance = vertical**2 / low * 0.8 * shape * pi**2 / (8 * span)
    return Turbulence(
        level=(wide / airspeed, horizontal),
        down=(low / airspeed, vertical),
        rotation=(4 * span / (pi * airspeed), variance**0.5),
    )


def first_order(constant: float, dt: float, samples: int, noise: Generator) -> Array:
    """Returns (samples,) of Dryden's process along the wind, variance 1; T = L/V is ``constant``, s.

    White noise of unit intensity through H_u(s) = √(2T) / (1 + Ts) (MIL-F-8785C, 3.7.1.2, whose √(2L/πV) belongs to
    spectra of which ∫₀^∞ Φ dω is the variance); its autocorrelation is exp(−τ/T).
    """
    keeps = exp(-dt / constant)
    drive = noise.standard_normal(samples)
    drive[1:] *= sqrt(1 - keeps * keeps)
    return _lag(keeps, drive)


def second_order(constant: float, dt: float, samples: int, noise: Generator) -> Array:
    """Returns (samples,) of Dryden's process across the wind and down, of variance 1.

    H_v(s) = √T (1 + √3 Ts) / (1 + Ts)², whose autocorrelation is (1 − τ/2T) exp(−τ/T). With x₁ = n/(1 + Ts) and
    x₂ = x₁/(1 + Ts) it is √3 x₁ + (1 − √3) x₂. In units of T, states in a stationary state have the covariance
    [[1/2, 1/4], [1/4, 1/4]]; after a = dt/T the old ones count e^(−a) [[1, 0], [a, 1]], and what the noise adds has the
    covariance ∫₀ᵃ [1, u; u, u²] e^(−2u) du (C. Van Loan, "Computing integrals involving the matrix exponential", 1978):
    incomplete gamma functions, which lose no digits at small a.
    """
    a = dt / constant
    keeps = exp(-a)
    q11 = gammainc(1, 2 * a) / 2
    q12 = gammainc(2, 2 * a) / 4
    q22 = gammainc(3, 2 * a) / 4
    white = noise.standard_normal((2, samples))
    first = sqrt(q11) * white[0]
    shared = q12 / sqrt(q11) * white[0]
    apart = sqrt(q22 - q12**2 / q11)
    second = shared + apart * white[1]
    first[0] = sqrt(1 / 2) * white[0, 0]
    both = white[0, 0] + white[1, 0]
    second[0] = sqrt(1 / 8) * both
    x1 = _lag(keeps, first)
    second[1:] += keeps * a * x1[:-1]
    x2 = _lag(keeps, second)
    return sqrt(3) * x1 + (1 - sqrt(3)) * x2


def _lag(keeps: float, drive: Array) -> Array:
    """X with x[0] = drive[0] and x[k] = keeps x[k − 1] + drive[k]."""
    return lfilter([1.0], [1.0, -keeps], drive)


LENGTH = 1.339  # a: it makes L the integral of f


_SCALE = 2 ** (2 / 3) / gamma(1 / 3)


def along(time: Array) -> Array:
    """Returns the autocorrelation along the wind, f = 2^(2/3)/Γ(1/3) ζ^(1/3) K_{1/3}(ζ), at lags ``time`` ≥ 0; (N,).

    ζ = Vτ/(aL), ``time`` in units of L/V (T. von Kármán, "Progress in the statistical theory of turbulence", 1948).
    """
    zeta = np.maximum(time / LENGTH, 1e-12)
    bessel = kv(1 / 3, zeta)
    return _SCALE * zeta ** (1 / 3) * bessel


def across(time: Array) -> Array:
    """Returns that across it, g = f − 2^(2/3)/Γ(1/3) ζ^(4/3) K_{2/3}(ζ)/2."""
    zeta = np.maximum(time / LENGTH, 1e-12)
    bessel = kv(2 / 3, zeta)
    return along(time) - _SCALE * zeta ** (4 / 3) * bessel / 2


def von_karman_noise(
    autocorrelation: Callable[[Array], Array],
    constant: float,
    dt: float,
    samples: int,
    noise: Generator,
) -> Array:
    """Returns (samples,) of von Kármán's turbulence, ``along`` the wind or ``across``, variance 1; L/V ``constant``, s.

    MIL-F-8785C, 3.7.1.1, gives spectra that no rational filter has:

        Φ_u(Ω) = σ² 2L/π (1 + (aLΩ)²)^(−5/6)
        Φ_v(Ω) = σ² L/π (1 + 8/3 (aLΩ)²) (1 + (aLΩ)²)^(−11/6),  Φ_w likewise;  a = 1.339.

    A series of just their autocorrelations is drawn by circulant embedding (C. Dietrich and G. Newsam, SIAM J. Sci.
    Comput. 1997), as no synthesis from samples of the spectrum is, which lacks what lies beyond half the sampling rate.
    """
    # At ζ = 40 nothing is left of either autocorrelation: e^(−40).
    memory = int(40.0 * LENGTH * constant / dt) + 1
    # A circle on which the two ends of the series are uncorrelated.
    size = next_fast_len(2 * (samples + memory), real=True)
    lags = dt / constant * np.arange(memory + 1, dtype=np.float64)
    correlation = np.zeros(size)
    correlation[: len(lags)] = autocorrelation(lags)
    mirrored = correlation[1 : len(lags)][::-1]
    correlation[size - len(lags) + 1 :] = mirrored
    # What rounding leaves below zero is none.
    power = np.maximum(rfft(correlation).real, 0.0)
    parts = noise.standard_normal((2, len(power)))
    amplitude = np.sqrt(power * size / 2)
    spectrum = amplitude * (parts[0] + 1j * parts[1])
    # The mean, and with an even size the highest frequency, have one part, with all of their power.
    singles = (0, -1) if size % 2 == 0 else (0,)
    for single in singles:
        spectrum[single] = np.sqrt(power[single] * size) * parts[0, single]
    return irfft(spectrum, size)[:samples]


SPREAD = 0.094  # S: half-width by distance


def jet_speed(jet: Jet, along: float, aside: float) -> float:
    """Returns the mean speed in a jet, m/s, so many m ``along`` its axis from the blower and ``aside`` from the axis.

    A round turbulent jet (S. B. Pope, "Turbulent Flows", 2000, section 5.1): beyond its potential core the speed on the
    axis falls as U_c/U₀ = 6 d/x, and the profile's half-width grows as r_½ = 0.094 x; in the core, up to x = 6 d, both
    are taken as at its end. The profile is Gaussian, a common approximation (J. Lee and V. Chu, "Turbulent Jets and
    Plumes", 2003) to Pope's (1 + (√2 − 1)(r/r_½)²)⁻²: they part by 0.08 U_c at most, at 2 r_½. What is not axial in the
    mean is left out, and so are gradients across the vehicle.
    """
    if along <= 0.0:
        return 0.0
    end = 6.0 * jet.diameter  # where the speed on the axis begins to fall
    axial = jet.speed * min(1.0, end / along)
    half_width = SPREAD * max(along, end)
    return axial * exp(-log(2) * (aside / half_width) ** 2)


def _jet_wind(jet: Jet, height: float, turbulence: Array, position: Vector3) -> Vector3:
    """Velocity of the air NED, m/s, at a place (NED, m), of a jet whose axis is at the ``height`` of the hover, m.

    Its ``turbulence`` (3,) is along, across and down, relative to the mean speed where the vehicle is.
    """
    n, e, _ = towards(jet.direction).tolist()
    north, east, down = position
    along = jet.distance + north * n + east * e
    right = east * n - north * e - jet.offset
    below = down + height
    distance = (right * right + below * below) ** 0.5
    speed = jet_speed(jet, along, distance)
    a, b, c = turbulence.tolist()
    mean = 1.0 + a
    return speed * (mean * n - b * e), speed * (mean * e + b * n), speed * c


def gust_speed(wind: Gust, time: Array) -> Array:
    """Returns (N,) speed in m/s at ``time`` (N,), seconds since arming."""
    risen = np.clip((time - wind.start) / wind.rise, 0.0, 1.0)
    if wind.hold is not None:
        fallen = np.clip((time - wind.start - wind.rise - wind.hold) / wind.rise, 0.0, 1.0)
        risen = risen - fallen
    # libm's cos: numpy's own chooses instructions by the machine, and the last bit with them.
    shares = risen.tolist()
    return np.array([wind.speed / 2 * (1 - cos(pi * share)) for share in shares])


class Weather:
    """The air of a flight, held through each cycle of ``dt`` s; ``time`` (N,): of each, seconds since arming."""

    def __init__(self, scenario: Scenario, dt: float, time: Array) -> None:
        samples = len(time)
        # Columns as in AirState.
        air = np.zeros((samples, 8))
        self._height = scenario.height
        self._jets = list[tuple[Jet, Array]]()
        for number, wind in enumerate(scenario.wind):
            noise = scenario.random(WIND, number)
            match wind:
                case SteadyWind():
                    air[:, :3] += wind.speed * towards(wind.direction)
                case GaussianWind():
                    for column in range(3):
                        air[:, column] += wind.sd * gaussian_noise(wind.s, dt, samples, noise)
                case Gust():
                    speed = gust_speed(wind, time)
                    air[:, :3] += speed[:, None] * towards(wind.direction)
                case Jet():
                    columns = [gaussian_noise(wind.s, dt, samples, noise) for _ in range(3)]
                    turbulence = wind.turbulence * np.column_stack(columns)
                    self._jets.append((wind, turbulence))
                case TurbulentWind():
                    air[:, :5] += _turbulent(wind, scenario, dt, samples, noise)
        for number, moment in enumerate(scenario.moments):
            noise = scenario.random(MOMENT, number)
            column = AirState._fields.index(moment.axis)
            moments = gaussian_noise(moment.s, dt, samples, noise)
            air[:, column] += moment.sd * moments
        self._air = air
        self._profile = scenario.profile
        self._time = time.tolist()

    def air_at(self, cycle: int, position: Vector3) -> AirState:
        """Returns the air at ``position`` (NED, m) in a cycle, counted from 0.

        Before the first and after the last it is theirs.
        """
        cycle = min(max(cycle, 0), len(self._air) - 1)
        air = AirState(*self._air[cycle].tolist())
        if self._profile.model_fields_set:
            height = -position[2]
            since_arming = max(self._time[cycle], 0.0)
            c, s = self._profile.at(height, since_arming)
            air = air._replace(
                north=c * air.north - s * air.east, east=s * air.north + c * air.east
            )
        for jet, turbulence in self._jets:
            north, east, down = _jet_wind(jet, self._height, turbulence[cycle], position)
            air = air._replace(north=air.north + north, east=air.east + east, down=air.down + down)
        return air


def _turbulent(
    wind: TurbulentWind, scenario: Scenario, dt: float, samples: int, noise: Generator
) -> Array:
    """(N, 5) velocity NED of the mean wind and its turbulence, and the air's rotation about two horizontal axes."""
    places = rotor_frame(scenario.vehicle.frame, airframe(scenario.vehicle).arm)
    turbulent = turbulence(wind, scenario.height, max(places.right) - min(places.right))
    level, gust = turbulent.level
    slow, lift = turbulent.down
    first, second = first_order, second_order
    if wind.kind == "von_karman":
        first, second = partial(von_karman_noise, along), partial(von_karman_noise, across)
    ahead = wind.speed + gust * first(level, dt, samples, noise)
    aside = gust * second(level, dt, samples, noise)
    down = lift * second(slow, dt, samples, noise)
    north, east, _ = towards(wind.direction)
    corner, spin = turbulent.rotation
    p, q = (spin * first_order(corner, dt, samples, noise) for _ in range(2))
    return np.column_stack([ahead * north - aside * east, ahead * east + aside * north, down, p, q])
