"""A roll axis in turbulence, flown by an autopilot that answers what it measures."""

from __future__ import annotations

import numpy as np

from mavdem import Flight

SIGNS = np.array([1.0, -1.0, -1.0, 1.0])


def in_closed_loop(samples: int = 1000, seed: int = 0, dt: float = 0.01) -> Flight:
    """Roll and rate answered 0.03 s late through four motors; the wind decays over 0.5 s."""
    rng, fine = np.random.default_rng(seed), 5
    roll = rate = torque = wind = command = 0.0
    motors, outputs = np.empty((samples, 4)), np.empty((samples, 2))
    step = dt / fine
    for t in range(samples):
        outputs[t] = roll, rate
        command = -(60 * roll + 12 * rate)
        motors[t] = 1500 + SIGNS * command + 0.2 * rng.standard_normal(4)
        for _ in range(fine):
            wind += -step * 2.0 * wind + 6.0 * np.sqrt(step) * rng.standard_normal()
            torque += step / 0.03 * (command - torque)
            rate += step * (torque - rate + 10 * wind)
            roll += step * rate
    return Flight(dt * np.arange(samples), motors, outputs)
