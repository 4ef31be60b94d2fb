"""Samples of a plant in its loop with known parameters, and the dense covariance of such samples."""

from __future__ import annotations

import numpy as np

from mavdem.arrays import Array
from mavdem.plant.closed_loop.evidence import LoopData, LoopPosterior
from mavdem.plant.closed_loop.state_space import (
    CHANNELS,
    STATES,
    SampledLoop,
    sampled_loop,
    unknown_controller,
)

DT = 0.01
CONTROLLER = unknown_controller(proportional_gain=0.05)
TRIM = np.array([0.02, 0.0, 0.4])
"""Means of angle, rate and motors in the simulated records."""


def prior_mean() -> Array:
    """Returns the parameters (k,) that the records are simulated with."""
    samples = np.random.default_rng(0).standard_normal((10, CHANNELS)) * [0.05, 0.2, 0.02]
    return LoopPosterior(LoopData.from_samples([samples], DT), CONTROLLER).prior.mean


def simulated(samples: int, seed: int) -> Array:
    """Returns samples (T, 3) of a loop with the parameters of ``prior_mean``."""
    loop = sampled_loop(prior_mean(), CONTROLLER, DT)
    generator = np.random.default_rng(seed)
    start_factor = np.linalg.cholesky(loop.stationary_covariance + 1e-12 * np.eye(STATES))
    noise_factor = np.linalg.cholesky(loop.process_covariance + 1e-14 * np.eye(STATES))
    state = start_factor @ generator.standard_normal(STATES)
    measured = []
    for _ in range(samples):
        noise = np.sqrt(loop.noise_variance) * generator.standard_normal(CHANNELS)
        measured.append(loop.output @ state + noise + TRIM)
        state = loop.transition @ state + noise_factor @ generator.standard_normal(STATES)
    return np.array(measured)


def dense_covariance(loop: SampledLoop, stationary: Array, samples: int) -> Array:
    """Returns the covariance (3 T, 3 T) of all outputs C x, sample by sample, of a stationary loop."""
    covariance = np.zeros((CHANNELS * samples, CHANNELS * samples))
    block = stationary @ loop.output.T
    for lag in range(samples):
        for row in range(lag, samples):
            later = slice(CHANNELS * row, CHANNELS * (row + 1))
            earlier = slice(CHANNELS * (row - lag), CHANNELS * (row - lag + 1))
            covariance[later, earlier] = loop.output @ block
            covariance[earlier, later] = (loop.output @ block).T
        block = loop.transition @ block
    return covariance
