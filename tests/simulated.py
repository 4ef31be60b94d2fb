"""Made-up roll axes: driven by its motors, and flown by an autopilot that answers what it measures."""

from functools import cache

import numpy as np
from numpy.random import default_rng
from scipy.ndimage import gaussian_filter1d

from mavdem import Flight

DT = 0.01
SIGNS = np.array([1.0, -1.0, -1.0, 1.0])
RATE = 4.0
GAIN = np.array([0.08, -0.08, -0.08, 0.08])


@cache
def simulated(seed=0, samples=850, wind=0.0, lag=0.0):
    """A roll axis with damping, driven by four motors and, with ``wind``, by coloured moments (rad/s²)."""
    rng = default_rng(seed)
    substep = 10
    motors = gaussian_filter1d(rng.standard_normal((samples, 4)), 8, axis=0) * 40
    commands = [float(GAIN @ motor) for motor in motors]
    moment = (
        wind
        * gaussian_filter1d(rng.standard_normal(samples * substep), 5 * substep)
        * np.sqrt(10 * substep * np.sqrt(np.pi))
    )
    roll = rate = torque = 0.0
    outputs = np.empty((samples, 2))
    step = DT / substep
    for t, command in enumerate(commands):
        outputs[t] = roll, rate
        for random_push in moment[t * substep : (t + 1) * substep].tolist():
            torque = command if not lag else torque + step / lag * (command - torque)
            rate += step * (torque - RATE * rate - 9.0 * roll + random_push)
            roll += step * rate
    return Flight(DT * np.arange(samples), 1500 + motors, outputs + [0.2, 0.0])


LAG = 0.04
DAMPING = 2.0
MOTORS = np.array([-0.06, 0.06, 0.06, -0.06])
FINE = 10


def in_closed_loop(seed=0, steering=0.0, samples=700, wind=1.0, commanded=None):
    """Simulates an axis in closed loop, with turbulence (rad/s²) and steering (rad/s).

    The last samples may have ``commanded`` motors (H, 4), µs, whatever the controller wants.
    """
    rng = default_rng(seed)
    reference = steering * np.sign(np.sin(2 * np.pi * np.arange(samples) * DT / 1.3))
    angle = rate = torque = drift = previous_command = 0.0
    substep = DT / FINE
    decay = float(np.exp(-substep / 0.5))
    gust_size = float(np.sqrt(1 - decay**2)) * wind
    commands = np.zeros((samples, 4))
    outputs = np.empty((samples, 2))
    for k in range(samples):
        outputs[k] = angle, rate + 0.005 * rng.standard_normal()
        demand = 12 * (reference[k] - 3 * angle - outputs[k, 1])
        commands[k] = demand * MOTORS / (MOTORS @ MOTORS) + rng.standard_normal(4)
        if commanded is not None and k >= samples - len(commanded):
            commands[k] = commanded[k - samples]
        torque_command = float(MOTORS @ commands[k])
        # Commands act half a sample late.
        for step, random_push in enumerate(rng.standard_normal(FINE).tolist()):
            torque += (
                substep
                / LAG
                * ((torque_command if step >= 5 or k == 0 else previous_command) - torque)
            )
            drift = decay * drift + gust_size * random_push
            rate += substep * (torque - DAMPING * rate + drift)
            angle += substep * rate
        previous_command = torque_command
    return Flight(DT * np.arange(samples), 1500 + commands, outputs)
