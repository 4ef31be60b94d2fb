"""Axes of rotation of a vehicle, the outputs of a model of each, and the possible range of angles and body rates."""

from math import tau
from typing import NamedTuple

import numpy as np

TILT_AXES = ("roll", "pitch")
"""Axes whose model has two outputs, Euler angle and body rate: gravity acts on the angle."""

AXES = (*TILT_AXES, "yaw")
"""All axes, in the order of the columns of attitudes and body rates."""

ROLL, PITCH, YAW = range(len(AXES))
"""Columns of attitudes (N, 3) and body rates."""

TILT_COLUMNS = slice(0, len(TILT_AXES))
"""Columns of roll and pitch in an attitude (N, 3), without the heading."""

NORTH, EAST, DOWN = range(3)
"""Columns of velocities and positions (N, 3) over ground."""

HORIZONTAL = slice(0, 2)
"""Columns of north and east in them."""

MAX_ANGLE = tau
"""Largest absolute Euler angle, rad, that a message can mean, whatever its convention: a whole turn."""

MAX_BODY_RATE = np.radians(4000.0)
"""Largest absolute body rate, rad/s, that a gyroscope can measure: most reach 2000 deg/s, none over 4000."""


class ModelOutput(NamedTuple):
    """One output of a model of an axis."""

    name: str
    """Name, such as "roll" or "roll rate"."""

    unit: str
    """Unit, such as "rad" or "rad/s"."""


def model_outputs(axis: str) -> tuple[ModelOutput, ...]:
    """Returns the outputs of a flight that is aligned for one axis, in the order of their columns.

    Roll and pitch have the Euler angle and the body rate. Yaw has the body rate only: a heading may have any value,
    and the dynamics do not depend on it.

    Args:
        axis: "roll", "pitch" or "yaw".
    """
    rate = ModelOutput(f"{axis} rate", "rad/s")
    if axis in TILT_AXES:
        return ModelOutput(axis, "rad"), rate
    return (rate,)
