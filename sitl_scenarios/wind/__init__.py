"""Wind: what moves past the vehicle, one file a model, summed."""

from __future__ import annotations

import numpy as np

from sitl_scenarios.dynamics import Air, Three
from sitl_scenarios.motion import Array
from sitl_scenarios.scenario import Scenario, Steady
from sitl_scenarios.wind.direction import towards


class Weather:
    """The air of a flight, cycle by cycle.

    Args:
        scenario: its winds, moments and seed.
        time: (N,) seconds since arming, of each cycle.
    """

    def __init__(self, scenario: Scenario, time: Array) -> None:
        air = np.zeros((len(time), 8))
        for wind in scenario.wind:
            if isinstance(wind, Steady):
                air[:, :3] += wind.speed * towards(wind.direction)
        self._air = air

    def at(self, cycle: int, position: Three) -> Air:
        """The air at ``position`` (NED, m) in a cycle, counted from 0; before the first and after the last, theirs."""
        row = self._air[min(max(cycle, 0), len(self._air) - 1)]
        return Air(*row.tolist())
