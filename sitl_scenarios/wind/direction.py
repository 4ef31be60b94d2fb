"""Directions of the wind."""

from __future__ import annotations

from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray


def towards(direction: float) -> NDArray[np.float64]:
    """(3,) unit vector NED that wind from ``direction`` degrees, clockwise from north, moves along."""
    return np.array([-cos(radians(direction)), -sin(radians(direction)), 0.0])
