"""Systems: what the axis's command does to a vehicle, over frequency, by its physical parameters or by DEM's model."""

import numpy as np

from mavdem.arrays import Array
from mavdem.dem import Learned
from mavdem.loops.loop_construction import POSTERIOR_DRAWS
from mavdem.loops.margins import Complex
from mavdem.plant import Physical


def model_response(learned: Learned, motors: Array, frequency: Array, output: int) -> Complex:
    """Returns (1, F) of an ``output`` of DEM's model to a command that moves the ``motors`` (r,), at (F,) Hz."""
    A, B, C = learned.model.A, learned.model.B, learned.model.C
    s = 2j * np.pi * frequency[:, None, None]
    states = np.linalg.solve(s * np.eye(len(A)) - A, (B @ motors)[:, None])
    return (C[output] @ states).T


def plant_response(physical: Physical, motors: Array, frequency: Array, is_angle: bool) -> Complex:
    """Returns (1 + POSTERIOR_DRAWS, F) of the rate, or the angle: of the physical parameters, then of draws of them."""
    theta = physical.draws(POSTERIOR_DRAWS, 0)
    effect = theta[:, :-3] @ motors
    damping, lag, delay = theta[:, -3:].T[..., None]
    s = 2j * np.pi * frequency
    rate = effect[:, None] * np.exp(-delay * s) / ((s + damping) * (lag * s + 1))
    return rate / s if is_angle else rate


def plant_of(learned: Learned) -> Physical | None:
    """Returns the physical parameters, where they are identifiable, and their outputs are those of the model."""
    physical = learned.physical
    outputs = learned.record.outputs.shape[1]
    return physical if physical is not None and outputs <= 2 and physical.identifiable else None
