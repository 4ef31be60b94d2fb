"""A made-up roll axis for the engine's tests."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mavdem import Flight

DT = 0.01
RATE, GAIN = 4.0, np.array([0.08, -0.08, -0.08, 0.08])


def simulated(
    seed: int = 0, samples: int = 850, wind: float = 0.0, lag: float = 0.0, liveliness: float = 1.0
) -> Flight:
    """A roll axis with damping, driven by four motors and, with ``wind``, by coloured moments (rad/s²).

    From sample 700 on the motors work ``liveliness`` times as hard.
    """
    rng = np.random.default_rng(seed)
    fine = 10
    motors = gaussian_filter1d(rng.standard_normal((samples, 4)), 8, axis=0) * 40
    motors[700:] *= liveliness
    motors = np.repeat(motors, fine, axis=0)
    moment = (
        wind * gaussian_filter1d(rng.standard_normal(samples * fine), 5 * fine) * np.sqrt(10 * fine * np.sqrt(np.pi))
    )
    roll = rate = torque = 0.0
    outputs = np.empty((samples, 2))
    step = DT / fine
    for i in range(samples * fine):
        if i % fine == 0:
            outputs[i // fine] = roll, rate
        command = GAIN @ motors[i]
        torque = command if not lag else torque + step / lag * (command - torque)
        rate += step * (torque - RATE * rate - 9.0 * roll + moment[i])
        roll += step * rate
    return Flight(DT * np.arange(samples), 1500 + motors[::fine], outputs + [0.2, 0.0])
