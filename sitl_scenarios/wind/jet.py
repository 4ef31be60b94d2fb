"""A blower's jet: a round turbulent jet of air with an edge that the vehicle enters and leaves.

S. B. Pope, "Turbulent Flows", 2000, section 5.1: beyond its potential core the speed on the axis falls as
U_c/U₀ = 6 d/x, and the profile's half-width grows as r_½ = 0.094 x; in the core, up to x = 6 d, both are taken as at
its end, U₀ and about d/2. The profile itself is Gaussian, a common approximation (J. Lee and V. Chu, "Turbulent Jets
and Plumes", 2003) to Pope's (1 + (√2 − 1)(r/r_½)²)⁻²: they part by 0.08 U_c at most, at 2 r_½, where his has the longer
tail. What is not axial in the mean is left out, and so are gradients across the vehicle.
"""

from __future__ import annotations

from math import exp, log

import numpy as np

from sitl_scenarios.dynamics import Three
from sitl_scenarios.motion import Array
from sitl_scenarios.scenario import Jet, towards
from sitl_scenarios.wind.gaussian import gaussian_noise

SPREAD = 0.094  # S: half-width by distance


def jet_speed(jet: Jet, along: float, aside: float) -> float:
    """Mean speed in the jet, m/s, so many m ``along`` its axis from the blower and ``aside`` from the axis."""
    if along <= 0.0:
        return 0.0
    end = 6.0 * jet.diameter  # where the speed on the axis begins to fall
    return jet.speed * min(1.0, end / along) * exp(-log(2) * (aside / (SPREAD * max(along, end))) ** 2)


class JetWind:
    """The air of a jet, cycle by cycle.

    Its axis is at the ``height`` of the vehicle's hover, m. Its turbulence is Gaussian-kernel noise along, across and
    down, independent, as strong as the mean speed is where the vehicle is.
    """

    def __init__(self, jet: Jet, height: float, dt: float, samples: int, noise: np.random.Generator) -> None:
        self._jet, self._height = jet, height
        self._north, self._east, _ = towards(jet.direction).tolist()
        columns = [gaussian_noise(jet.s, dt, samples, noise) for _ in range(3)]
        self._turbulence: Array = jet.turbulence * np.column_stack(columns)

    def at(self, cycle: int, position: Three) -> Three:
        """Velocity of the air NED, m/s, at ``position`` (NED, m) in a cycle."""
        n, e = self._north, self._east
        north, east, down = position
        along = self._jet.distance + north * n + east * e
        right = east * n - north * e - self._jet.offset
        below = down + self._height
        speed = jet_speed(self._jet, along, (right * right + below * below) ** 0.5)
        a, b, c = self._turbulence[cycle].tolist()
        return speed * ((1.0 + a) * n - b * e), speed * ((1.0 + a) * e + b * n), speed * c
