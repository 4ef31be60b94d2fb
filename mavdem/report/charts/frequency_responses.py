"""Frequency responses of a vehicle to the command of an axis, by its physical parameters or by DEM's model."""

import numpy as np

from mavdem.arrays import Array
from mavdem.dem import Learned
from mavdem.loops.loop_construction import POSTERIOR_DRAWS
from mavdem.loops.margins import Complex
from mavdem.plant import Physical

DYNAMICS_COUNT = 3
"""Parameters that follow the effectiveness of each motor in a draw of physical parameters: damping, lag and delay."""

DRAWS_SEED = 0
"""Seed of the draws, so that the same model always has the same band."""


def model_response(learned: Learned, motors: Array, frequency: Array, output: int) -> Complex:
    """Returns the frequency response of an output of DEM's model: C (sI − A)⁻¹ B m at s = 2πjf.

    Args:
        learned: the model, with matrices A, B and C.
        motors: (r,) model inputs m for a command of 1.
        frequency: frequencies f (F,), Hz.
        output: index of the output.

    Returns:
        Output per command, (1, F) complex.
    """
    A, B, C = learned.model.A, learned.model.B, learned.model.C
    s = 2j * np.pi * frequency[:, None, None]
    state_responses = np.linalg.solve(s * np.eye(len(A)) - A, (B @ motors)[:, None])
    return (C[output] @ state_responses).T


def plant_response(
    physical: Physical, motors: Array, frequency: Array, *, is_angle: bool
) -> Complex:
    """Returns the frequency response of the physical plant, for its parameters and for draws from their posterior.

    The rate per command is e^(−τs) b·m / ((s + d)(Ts + 1)) at s = 2πjf, with the effectiveness b of the motors, the
    rate damping d, the motor time constant T and the delay τ.

    Args:
        physical: the parameters with their covariance.
        motors: (r,) motor commands m for a command of 1.
        frequency: frequencies f (F,), Hz.
        is_angle: whether the response of the angle is returned, which is the response of the rate divided by s.

    Returns:
        Responses (1 + POSTERIOR_DRAWS, F), complex: of the estimate in the first row, then of the draws.
    """
    # A row is the estimate or a draw: the effectiveness of each motor, then damping, time constant and delay.
    draws = physical.draws(POSTERIOR_DRAWS, DRAWS_SEED)
    effectiveness = draws[:, :-DYNAMICS_COUNT]
    dynamics = draws[:, -DYNAMICS_COUNT:]
    # (1 + POSTERIOR_DRAWS, 1) each, so that a row has all frequencies of one draw.
    acceleration_per_command = (effectiveness @ motors)[:, None]
    damping, time_constant, delay = dynamics.T[..., None]
    s = 2j * np.pi * frequency
    denominator = (s + damping) * (time_constant * s + 1)
    rate_response = acceleration_per_command * np.exp(-delay * s) / denominator
    return rate_response / s if is_angle else rate_response


def identified_plant(learned: Learned) -> Physical | None:
    """Returns the physical parameters of a model, if a frequency response can be computed from them.

    They must be identifiable, and the outputs no more than angle and rate, which are all that the physical plant has.

    Args:
        learned: the linear model that was learned from a flight, with its training data.

    Returns:
        The parameters; None if they do not meet these conditions.
    """
    physical = learned.physical
    output_count = learned.record.outputs.shape[1]
    if physical is None or output_count > 2 or not physical.identifiable:
        return None
    return physical
