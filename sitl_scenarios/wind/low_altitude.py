"""Turbulence near the ground: lengths, intensities and rotation that Dryden's and von Kármán's models share.

MIL-F-8785C, 3.7.3.4 and figures 10 and 11 (and MIL-HDBK-1797B, Appendix A, 4.9.2), with the height h in feet:

    L_w = h,  L_u = L_v = h / (0.177 + 0.000823 h)^1.2
    σ_w = 0.1 u₂₀,  σ_u = σ_v = σ_w / (0.177 + 0.000823 h)^0.4

MIL-HDBK-1797B halves L_v and L_w and writes 2L in their spectra, so that the spectra are the same; it is 8785C's L
here. The spectra are in space, and an aircraft meets them at its airspeed V. A hovering vehicle has none but the
wind's: V is the mean wind, and ``SLOWEST`` at least, where the standard is silent.
"""

from __future__ import annotations

from math import pi
from typing import NamedTuple

from sitl_scenarios.scenario import TurbulentWind

FOOT = 0.3048  # m
SLOWEST = 1.0  # m/s: V in less wind


class Turbulence(NamedTuple):
    """At one height in one wind."""

    # along, across and down: (L/V in s, σ in m/s) of the components along the mean wind, across it and down
    along: tuple[float, float]
    across: tuple[float, float]
    down: tuple[float, float]
    # (time constant in s, standard deviation in rad/s) of the air's rotation about a horizontal axis
    rotation: tuple[float, float]


def turbulence(wind: TurbulentWind, height: float, span: float) -> Turbulence:
    """Lengths and intensities of a wind, by the standard.

    Of its rotation it gives that about the flight path, p_g, a first-order process for Dryden and von Kármán alike:

        Φ_p(Ω) = σ_w²/L_w · 0.8 (π L_w / 4b)^(1/3) / (1 + (4bΩ/π)²),

    whose variance is the integral of that over Ω ≥ 0. A hovering vehicle has no path: both of its axes get this. The
    ``height`` is in m, and so is the ``span`` b between the outermost rotors.
    """
    # The standard's model begins at 10 feet, and holds below as it is there.
    feet = max(height / FOOT, 10.0)
    slope = 0.177 + 0.000823 * feet
    airspeed = max(wind.speed, SLOWEST)
    low, wide = feet * FOOT, feet / slope**1.2 * FOOT
    vertical = 0.1 * wind.wind_at_20_feet
    horizontal = vertical / slope**0.4
    variance = vertical**2 / low * 0.8 * (pi * low / (4 * span)) ** (1 / 3) * pi**2 / (8 * span)
    return Turbulence(
        along=(wide / airspeed, horizontal),
        across=(wide / airspeed, horizontal),
        down=(low / airspeed, vertical),
        rotation=(4 * span / (pi * airspeed), variance**0.5),
    )
