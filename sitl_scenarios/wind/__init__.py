"""Wind: what moves past the vehicle, one file a model, summed."""

from __future__ import annotations

import numpy as np

from sitl_scenarios.dynamics import Air, Three
from sitl_scenarios.frames import frame
from sitl_scenarios.motion import Array
from sitl_scenarios.randomness import MOMENT, WIND, generator
from sitl_scenarios.scenario import Dryden, Gaussian, Gust, Jet, Scenario, Steady, VonKarman
from sitl_scenarios.vehicles import AIRFRAMES
from sitl_scenarios.wind.direction import towards
from sitl_scenarios.wind.dryden import first_order, second_order
from sitl_scenarios.wind.gaussian import gaussian_noise
from sitl_scenarios.wind.gust import gust
from sitl_scenarios.wind.jet import JetWind
from sitl_scenarios.wind.low_altitude import turbulence
from sitl_scenarios.wind.von_karman import von_karman

_AXES = {"roll": 5, "pitch": 6, "yaw": 7}
"""Columns of ``Air``."""


class Weather:
    """The air of a flight, cycle by cycle; it is held through each.

    Args:
        scenario: its winds, moments and seed.
        dt: cycle, s.
        time: (N,) seconds since arming, of each cycle.
    """

    def __init__(self, scenario: Scenario, dt: float, time: Array) -> None:
        samples = len(time)
        # Columns as in Air.
        air = np.zeros((samples, 8))
        self._jets: list[JetWind] = []
        for number, wind in enumerate(scenario.wind):
            noise = generator(scenario.seed, WIND, number)
            match wind:
                case Steady():
                    air[:, :3] += wind.speed * towards(wind.direction)
                case Gaussian():
                    for column in range(3):
                        air[:, column] += wind.sd * gaussian_noise(wind.s, dt, samples, noise)
                case Gust():
                    air[:, :3] += gust(wind, time)[:, None] * towards(wind.direction)
                case Jet():
                    self._jets.append(JetWind(wind, scenario.height, dt, samples, noise))
                case Dryden() | VonKarman():
                    air[:, :5] += _turbulent(wind, scenario, dt, samples, noise)
        for number, moment in enumerate(scenario.moments):
            noise = generator(scenario.seed, MOMENT, number)
            air[:, _AXES[moment.axis]] += moment.sd * gaussian_noise(moment.s, dt, samples, noise)
        self._air = air

    def at(self, cycle: int, position: Three) -> Air:
        """The air at ``position`` (NED, m) in a cycle, counted from 0; before the first and after the last, theirs."""
        cycle = min(max(cycle, 0), len(self._air) - 1)
        air = Air(*self._air[cycle].tolist())
        for jet in self._jets:
            north, east, down = jet.at(cycle, position)
            air = air._replace(north=air.north + north, east=air.east + east, down=air.down + down)
        return air


def _turbulent(
    wind: Dryden | VonKarman, scenario: Scenario, dt: float, samples: int, noise: np.random.Generator
) -> Array:
    """(N, 5) velocity NED of the mean wind and its turbulence, and the air's rotation about two horizontal axes."""
    places = frame(scenario.vehicle.frame, AIRFRAMES[scenario.vehicle.model].arm)
    known = turbulence(wind, scenario.height, max(places.right) - min(places.right))
    if isinstance(wind, Dryden):
        along = first_order(known.along[0], dt, samples, noise)
        across, down = (second_order(known[i][0], dt, samples, noise) for i in (1, 2))
    else:
        along, across, down = (von_karman(i > 0, known[i][0], dt, samples, noise) for i in range(3))
    north, east, _ = towards(wind.direction)
    ahead, aside = wind.speed + known.along[1] * along, known.across[1] * across
    p, q = (known.rotation[1] * first_order(known.rotation[0], dt, samples, noise) for _ in range(2))
    return np.column_stack([ahead * north - aside * east, ahead * east + aside * north, known.down[1] * down, p, q])
