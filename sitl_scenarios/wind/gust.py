"""The 1-cosine gust: MIL-F-8785C, 3.7.1.3, in time instead of distance: V = V_m/2 (1 − cos(πt/t_m)) while it rises."""

from __future__ import annotations

from math import cos, pi

import numpy as np

from sitl_scenarios.motion import Array
from sitl_scenarios.scenario import Gust


def gust(wind: Gust, time: Array) -> Array:
    """(N,) speed in m/s at ``time`` (N,), seconds since arming."""
    risen = np.clip((time - wind.start) / wind.rise, 0.0, 1.0)
    if wind.hold is not None:
        risen = risen - np.clip((time - wind.start - wind.rise - wind.hold) / wind.rise, 0.0, 1.0)
    # libm's cos: numpy's own chooses instructions by the machine, and the last bit with them.
    return np.array([wind.speed / 2 * (1 - cos(pi * share)) for share in risen.tolist()])
