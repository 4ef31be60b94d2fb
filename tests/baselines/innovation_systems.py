"""Random systems in innovation form, and what they do when driven by noise."""

import numpy as np
from numpy.typing import NDArray

from mavdem import Flight
from mavdem.baselines import StateSpace

Array = NDArray[np.float64]

DT = 0.01


def random_system(seed: int, order: int, r: int = 2, m: int = 2, noise: float = 0.1) -> StateSpace:
    """Stable with a stable predictor, modes between 0.3 and 0.95; trims off zero. Innovations are to be of size 1."""
    rng = np.random.default_rng(seed)
    modes = np.zeros((order, order))
    for i in range(0, order - 1, 2):
        radius, angle = rng.uniform(0.6, 0.95), rng.uniform(0.1, 1.0)
        modes[i : i + 2, i : i + 2] = radius * np.array(
            [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
        )
    if order % 2:
        modes[-1, -1] = rng.uniform(0.3, 0.9)
    turn = np.linalg.qr(rng.standard_normal((order, order)))[0]
    A = turn @ modes @ turn.T
    B, C = rng.standard_normal((order, r)), rng.standard_normal((m, order))
    K = rng.standard_normal((order, m)) * 0.2
    while np.abs(np.linalg.eigvals(A - K @ C)).max() > 0.9:
        K *= 0.7
    return StateSpace(
        A, B, noise * C, np.zeros((m, r)), K / noise, np.zeros(order), rng.uniform(-5, 5, r), rng.uniform(-5, 5, m)
    )


def flown(
    system: StateSpace, seed: int, samples: int, noise: float = 0.1, push: float = 1.0, feedback: Array | None = None
) -> tuple[Flight, Array]:
    """A flight of the system under white inputs of size ``push``, and its states (T + 1, n).

    With ``feedback`` (r, m) inputs also answer the outputs of the same sample, whose noise they thus know (D = 0).
    """
    rng = np.random.default_rng(seed)
    (n, r), m = system.B.shape, len(system.C)
    pushes = push * rng.standard_normal((samples, r))
    errors = noise * rng.standard_normal((samples, m))
    states, outputs = np.zeros((samples + 1, n)), np.empty((samples, m))
    for t in range(samples):
        outputs[t] = system.C @ states[t] + system.D @ pushes[t] + errors[t]
        if feedback is not None:
            pushes[t] += feedback @ outputs[t]
        states[t + 1] = system.A @ states[t] + system.B @ pushes[t] + system.offset + system.K @ errors[t]
    return Flight(DT * np.arange(samples), pushes + system.input_trim, outputs + system.output_trim), states
