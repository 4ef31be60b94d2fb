"""Made-up roll axes: driven by its motors, and flown by an autopilot that answers what it measures."""

import numpy as np
from numpy.random import default_rng
from scipy.ndimage import gaussian_filter1d

from mavdem import Flight

DT = 0.01
SIGNS = np.array([1.0, -1.0, -1.0, 1.0])
RATE = 4.0
GAIN = np.array([0.08, -0.08, -0.08, 0.08])


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


def in_closed_loop(samples=1000, seed=0, windy=10.0):
    """Roll and rate answered 0.03 s late through four motors; the wind decays over 0.5 s."""
    rng = default_rng(seed)
    fine = 5
    roll = rate = torque = wind = command = 0.0
    motors = np.empty((samples, 4))
    outputs = np.empty((samples, 2))
    step = DT / fine
    for t in range(samples):
        outputs[t] = roll, rate
        command = -(60 * roll + 12 * rate)
        drawn = rng.standard_normal(4 + fine)
        motors[t] = 1500 + SIGNS * command + 0.2 * drawn[:4]
        for push in drawn[4:].tolist():
            wind += -step * 2.0 * wind + 6.0 * step**0.5 * push
            torque += step / 0.03 * (command - torque)
            rate += step * (torque - rate + windy * wind)
            roll += step * rate
    return Flight(DT * np.arange(samples), motors, outputs)
