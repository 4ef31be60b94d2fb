"""Weather: the winds and moments of a scenario, summed, cycle by cycle."""

from __future__ import annotations

from math import cos, pi

import numpy as np

from sitl_scenarios.dynamics import Air, Three
from sitl_scenarios.mixer import frame
from sitl_scenarios.motion import Array
from sitl_scenarios.scenario import (
    MOMENT,
    WIND,
    DrydenWind,
    GaussianWind,
    Gust,
    Jet,
    Scenario,
    SteadyWind,
    TurbulentWind,
    towards,
)
from sitl_scenarios.vehicles import AIRFRAMES
from sitl_scenarios.wind.dryden import first_order, second_order
from sitl_scenarios.wind.gaussian import gaussian_noise
from sitl_scenarios.wind.jet import JetWind
from sitl_scenarios.wind.low_altitude import turbulence
from sitl_scenarios.wind.von_karman import von_karman_noise


def gust_speed(wind: Gust, time: Array) -> Array:
    """(N,) speed in m/s at ``time`` (N,), seconds since arming."""
    risen = np.clip((time - wind.start) / wind.rise, 0.0, 1.0)
    if wind.hold is not None:
        risen = risen - np.clip((time - wind.start - wind.rise - wind.hold) / wind.rise, 0.0, 1.0)
    # libm's cos: numpy's own chooses instructions by the machine, and the last bit with them.
    return np.array([wind.speed / 2 * (1 - cos(pi * share)) for share in risen.tolist()])


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
            noise = scenario.random(WIND, number)
            match wind:
                case SteadyWind():
                    air[:, :3] += wind.speed * towards(wind.direction)
                case GaussianWind():
                    for column in range(3):
                        air[:, column] += wind.sd * gaussian_noise(wind.s, dt, samples, noise)
                case Gust():
                    air[:, :3] += gust_speed(wind, time)[:, None] * towards(wind.direction)
                case Jet():
                    self._jets.append(JetWind(wind, scenario.height, dt, samples, noise))
                case TurbulentWind():
                    air[:, :5] += _turbulent(wind, scenario, dt, samples, noise)
        for number, moment in enumerate(scenario.moments):
            noise = scenario.random(MOMENT, number)
            air[:, Air._fields.index(moment.axis)] += moment.sd * gaussian_noise(moment.s, dt, samples, noise)
        self._air = air

    def at(self, cycle: int, position: Three) -> Air:
        """The air at ``position`` (NED, m) in a cycle, counted from 0; before the first and after the last, theirs."""
        cycle = min(max(cycle, 0), len(self._air) - 1)
        air = Air(*self._air[cycle].tolist())
        for jet in self._jets:
            north, east, down = jet.at(cycle, position)
            air = air._replace(north=air.north + north, east=air.east + east, down=air.down + down)
        return air


def _turbulent(wind: TurbulentWind, scenario: Scenario, dt: float, samples: int, noise: np.random.Generator) -> Array:
    """(N, 5) velocity NED of the mean wind and its turbulence, and the air's rotation about two horizontal axes."""
    places = frame(scenario.vehicle.frame, AIRFRAMES[scenario.vehicle.model].arm)
    known = turbulence(wind, scenario.height, max(places.right) - min(places.right))
    if isinstance(wind, DrydenWind):
        along = first_order(known.along[0], dt, samples, noise)
        across, down = (second_order(known[i][0], dt, samples, noise) for i in (1, 2))
    else:
        along, across, down = (von_karman_noise(i > 0, known[i][0], dt, samples, noise) for i in range(3))
    north, east, _ = towards(wind.direction)
    ahead, aside = wind.speed + known.along[1] * along, known.across[1] * across
    p, q = (known.rotation[1] * first_order(known.rotation[0], dt, samples, noise) for _ in range(2))
    return np.column_stack([ahead * north - aside * east, ahead * east + aside * north, known.down[1] * down, p, q])
