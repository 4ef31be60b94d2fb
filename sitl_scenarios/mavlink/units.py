"""Units and frames of MAVLink's fields: the place of the take-off, headings, and columns by name."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl_scenarios.motion import Array, Arrays, Motion, estimated_angles

HOME = (47.397742, 8.545594, 488.0)
"""Latitude and longitude, degrees, and altitude, m, of the take-off: the home of PX4's simulators."""

METRES_PER_DEGREE = 111_195.0
"""Length of a degree of latitude, m, on a sphere of 6371 km."""


def named_columns(names: str, values: NDArray[Any]) -> Arrays:
    """Names the columns of an array, as the fields of a message.

    Args:
        names: Names of the n columns, separated by spaces.
        values: (N, n) values.

    Returns:
        Columns (N,) by name.
    """
    return dict(zip(names.split(), values.T, strict=True))


def heading(motion: Motion) -> Array:
    """Returns the estimated heading, degrees clockwise from north, 0 to 360; (N,)."""
    return np.degrees(estimated_angles(motion)[:, 2]) % 360
