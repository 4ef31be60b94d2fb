"""Flights of random systems of known order, with smooth inputs."""

import numpy as np
from numpy.random import default_rng
from scipy.linalg import block_diag, solve_continuous_lyapunov
from scipy.signal import lsim

from mavdem import Flight
from sitl_scenarios.wind import gaussian_noise

# simulated before the first sample, so that the initial state does not matter
WARM_UP_SAMPLES = 300
SUBSTEPS = 5  # simulation steps between samples; inputs are linear within a step
# rad/s, of the modes of random systems
SLOWEST = 0.7
FASTEST = 3.0
# least Hankel singular value over the largest; a random system below it is drawn again
MIN_HANKEL_RATIO = 0.1
WORST_CONDITION = 10.0  # of a random system's coordinates
# standard deviation that process noise gives a random system's outputs, over that of its inputs
DISTURBANCE = 0.02
SENSORS = 1e-3  # that of the sensors' noise, over that of each output
# seconds, of random systems
INPUT_KERNEL = 0.25
NOISE_KERNEL = 0.2


def random_flight(order, channels, seed):
    """A flight of a random stable system with as many inputs as outputs, moved by smooth inputs and by noise."""
    samples = 1000
    dt = 0.05
    rng = default_rng([order, channels, seed])
    A, B, C = random_system(order, channels, rng)
    step = dt / SUBSTEPS
    number = (samples + WARM_UP_SAMPLES) * SUBSTEPS
    inputs = smooth_noise(INPUT_KERNEL, step, number, channels, rng)
    noise = smooth_noise(NOISE_KERNEL, step, number, order, rng)
    by_inputs = motion(A, B, inputs, step) @ C.T
    by_noise = motion(A, np.eye(order), noise, step) @ C.T
    size = DISTURBANCE * np.sqrt(by_inputs.var(axis=0).mean() / by_noise.var(axis=0).mean())
    kept = slice(WARM_UP_SAMPLES * SUBSTEPS, None, SUBSTEPS)
    outputs = (by_inputs + size * by_noise)[kept]
    sensors = SENSORS * outputs.std(axis=0) * smooth_noise(NOISE_KERNEL, dt, samples, channels, rng)
    return Flight(dt * np.arange(samples), inputs[kept], outputs + sensors)


def random_system(order, channels, rng):
    """A, B and C of a stable system with real and oscillating modes, all of which are visible in the outputs."""
    while True:
        blocks = []
        left = order
        while left:
            speed = np.exp(rng.uniform(np.log(SLOWEST), np.log(FASTEST)))
            if left > 1 and rng.random() < 0.6:
                damping = rng.uniform(0.2, 0.8)
                swing = speed * np.sqrt(1 - damping**2)
                blocks.append(np.array([[-damping * speed, swing], [-swing, -damping * speed]]))
                left -= 2
            else:
                blocks.append(np.array([[-speed]]))
                left -= 1
        turn = rng.standard_normal((order, order))
        if np.linalg.cond(turn) > WORST_CONDITION:
            continue
        A = turn @ block_diag(*blocks) @ np.linalg.inv(turn)
        B = rng.standard_normal((order, channels))
        C = rng.standard_normal((channels, order))
        hankel = np.sqrt(np.linalg.eigvals(_gramian(A, B) @ _gramian(A.T, C.T)).real.clip(0))
        if hankel.min() > MIN_HANKEL_RATIO * hankel.max():
            return A, B, C


def _gramian(A, B):
    return np.asarray(solve_continuous_lyapunov(A, -B @ B.T))


def motion(A, B, driven, step):
    """States (T, n) of ẋ = Ax + B·driven from rest, for inputs (T, r)."""
    system = A, B, np.eye(len(A)), np.zeros_like(B)
    states = lsim(system, driven, step * np.arange(len(driven)))[2]
    return states.reshape(len(driven), -1)


def smooth_noise(width, step, number, channels, rng):
    """Gaussian-kernel noise of unit variance, (number, channels)."""
    return np.column_stack([gaussian_noise(width, step, number, rng) for _ in range(channels)])
