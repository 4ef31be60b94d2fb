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
    fine = 10
    motors = gaussian_filter1d(rng.standard_normal((samples, 4)), 8, axis=0) * 40
    commands = [float(GAIN @ motor) for motor in motors]
    moment = (
        wind
        * gaussian_filter1d(rng.standard_normal(samples * fine), 5 * fine)
        * np.sqrt(10 * fine * np.sqrt(np.pi))
    )
    roll = rate = torque = 0.0
    outputs = np.empty((samples, 2))
    step = DT / fine
    for t, command in enumerate(commands):
        outputs[t] = roll, rate
        for push in moment[t * fine : (t + 1) * fine].tolist():
            torque = command if not lag else torque + step / lag * (command - torque)
            rate += step * (torque - RATE * rate - 9.0 * roll + push)
            roll += step * rate
    return Flight(DT * np.arange(samples), 1500 + motors, outputs + [0.2, 0.0])


LAG = 0.04
DAMPING = 2.0
MOTORS = np.array([-0.06, 0.06, 0.06, -0.06])
FINE = 10


def in_closed_loop(seed=0, steering=0.0, samples=700, wind=1.0, commanded=None):
    """An axis whose controller answers the rate it measures, with turbulence (rad/s²) and with steering (rad/s).

    The last samples have motors that are ``commanded`` (H, 4), whatever the vehicle does.
    """
    rng = default_rng(seed)
    reference = steering * np.sign(np.sin(2 * np.pi * np.arange(samples) * DT / 1.3))
    angle = rate = torque = drift = before = 0.0
    fine = DT / FINE
    keeps = float(np.exp(-fine / 0.5))
    gusty = float(np.sqrt(1 - keeps**2)) * wind
    commands = np.zeros((samples, 4))
    outputs = np.empty((samples, 2))
    for k in range(samples):
        outputs[k] = angle, rate + 0.005 * rng.standard_normal()
        wanted = 12 * (reference[k] - 3 * angle - outputs[k, 1])
        commands[k] = wanted * MOTORS / (MOTORS @ MOTORS) + rng.standard_normal(4)
        if commanded is not None and k >= samples - len(commanded):
            commands[k] = commanded[k - samples]
        now = float(MOTORS @ commands[k])
        # Commands act half a sample late.
        for step, push in enumerate(rng.standard_normal(FINE).tolist()):
            torque += fine / LAG * ((now if step >= 5 or k == 0 else before) - torque)
            drift = keeps * drift + gusty * push
            rate += fine * (torque - DAMPING * rate + drift)
            angle += fine * rate
        before = now
    return Flight(DT * np.arange(samples), 1500 + commands, outputs)
