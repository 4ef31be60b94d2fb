"""The systems of the paper's table ``tab:systems``, from the dynamics that fly."""

from typing import Literal

import numpy as np

from sitl_scenarios.scenario import VehicleSpec
from sitl_scenarios.truth import Linear, linearised

PAPER_ORDER = (2, 0, 3, 1)
"""Which motor of an X frame, from 0 in our order, is the paper's first, second, third and fourth. The AR.Drone counts
clockwise from the front left, hence [1 −1 −1 1] in roll: front left, front right, rear right, rear left."""


def paper_system(order: Literal[1, 2, 3, 4]) -> Linear:
    """A and B of System 1 to 4: AR.Drone 2.0, without rotor drag and lag, PWM of 0 to 255; its y points to the left."""
    east = ("east", "east speed", "roll", "roll rate")[4 - order :]
    linear = linearised(VehicleSpec(model="ardrone2", rotor_drag=False)).without_lag().of(east)
    mirror = np.diag([-1.0 if state.startswith("east") else 1.0 for state in east])
    names = tuple({"east": "y", "east speed": "ẏ", "roll": "φ", "roll rate": "φ̇"}[state] for state in east)
    return Linear(names, mirror @ linear.A @ mirror, mirror @ linear.B[:, PAPER_ORDER])
