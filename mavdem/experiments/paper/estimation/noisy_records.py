"""Records of a known linear system with noise of known variances, on which estimators of variances are tested.

    x⁺ = Φ x + Γ v + w,   y = x + z

All states are measured. The variances of the measurement noise z are to be estimated, the variances of the process
noise w are known. Both noises are white, or have the autocorrelation exp(−τ²/4s²) of DEM's noise with the smoothness s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.random import Generator, default_rng

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.model import discretize
from mavdem.experiments.paper.estimation.dem_observer import DEM_SMOOTHNESS
from mavdem.experiments.paper.estimation.roll_windows import (
    ROLL_SYSTEM_MATRIX,
    flight_windows,
    smooth_noise,
)
from mavdem.flight import Flight

SIMULATED_DT = 0.1
"""s, the sampling step of the simulated records, as in the code that the authors publish."""

SIMULATED_SAMPLES = 321
"""Samples of a simulated record, 32 s, as in that code."""

STATES = 2
"""Number of states of the random systems; a choice."""

DECAY_RATES = (0.5, 2.0)
"""1/s, range of the decay rates of the random systems' modes; a choice."""

MAX_FREQUENCY = 2.0
"""rad/s, largest frequency of their modes; a choice, at which a period has 31 samples."""

PROCESS_NOISE_SD = 0.02
"""Standard deviation of the simulated process noise in one sample; a choice, against states of about 1."""

LOG_PRECISION_RANGE = (4.0, 8.0)
"""Range of the true log precisions λ of the measurement noises; a choice: standard deviations of 0.018 to 0.135."""

INPUT_TIMES = (8.0, 20.0)
"""s, times of the two pulses of the input, as in the code that the authors publish."""

ADDED_NOISE_SD = np.array([0.01, 0.1])
"""Standard deviations of the noise that is added to the recorded roll (rad) and roll rate (rad/s); a choice.

It is far above the noise of the recordings, about 1e-4 rad, so that the variance of the sum is known.
"""


@dataclass(frozen=True, eq=False)
class NoisyRecord:
    """A record of T samples with measured states, whose noise variances are to be estimated."""

    A: Array
    """(n, n) system matrix, 1/s."""

    B: Array
    """(n, r) input matrix."""

    dt: float
    """Sampling step, s."""

    states: Array
    """(T, n) true states."""

    outputs: Array
    """(T, n) measured states."""

    inputs: Array
    """(T, r) inputs."""

    process_variances: Array
    """(n,) known variances of the process noise w of one sample."""

    noise_variances: Array
    """(n,) true variances of the measurement noise z at the last sample."""

    smoothness: float
    """Width of the measurement noise's Gaussian kernel, s; 0 for white noise."""

    process_smoothness: float
    """Width of the process noise's Gaussian kernel, s; 0 for white noise."""

    @cached_property
    def transition(self) -> ArrayPair:
        """Φ (n, n) and Γ (n, r) of one sampling step, over which the inputs are held."""
        transition = discretize(self.A, self.B, self.dt)
        return transition.Phi, transition.Gamma0 + transition.Gamma1


def random_record(seed: int, smoothness: float, variance_step: float = 1.0) -> NoisyRecord:
    """Simulates a record of a random stable system, with random noise variances.

    Args:
        seed: seed of the system, its noises and their variances.
        smoothness: width of the noises' kernel, s; 0 for white noise.
        variance_step: factor by which the variances of the measurement noise change in the middle of the record.

    Returns:
        T samples of a system with two states, with its true states and variances.
    """
    rng = default_rng(seed)
    A = _random_system(rng)
    B = rng.standard_normal((STATES, 1))
    time = SIMULATED_DT * np.arange(SIMULATED_SAMPLES)
    first_pulse, second_pulse = INPUT_TIMES
    # Each pulse is a Gaussian function of time with a standard deviation of √2 s.
    inputs = np.exp(-((time - first_pulse) ** 2) / 4) + np.exp(-((time - second_pulse) ** 2) / 4)
    kernel_samples = smoothness / SIMULATED_DT
    process_noise = PROCESS_NOISE_SD * smooth_noise(
        rng.standard_normal((SIMULATED_SAMPLES, STATES)), kernel_samples
    )
    # Each state is measured with its own noise. In the second half of the record the variances are others.
    first_variances = np.exp(-rng.uniform(*LOG_PRECISION_RANGE, STATES))
    measurement_noise = np.sqrt(first_variances) * smooth_noise(
        rng.standard_normal((SIMULATED_SAMPLES, STATES)), kernel_samples
    )
    measurement_noise[SIMULATED_SAMPLES // 2 :] *= np.sqrt(variance_step)
    # The record computes the transition of the states from its matrices. So it is made first, without states.
    record = NoisyRecord(
        A,
        B,
        SIMULATED_DT,
        states=np.zeros((SIMULATED_SAMPLES, STATES)),
        outputs=measurement_noise,
        inputs=inputs[:, None],
        process_variances=np.full(STATES, PROCESS_NOISE_SD**2),
        noise_variances=first_variances * variance_step,
        smoothness=smoothness,
        process_smoothness=smoothness,
    )
    Phi, Gamma = record.transition
    states = np.zeros((SIMULATED_SAMPLES, STATES))
    for t in range(SIMULATED_SAMPLES - 1):
        states[t + 1] = Phi @ states[t] + Gamma @ record.inputs[t] + process_noise[t]
    return replace(record, states=states, outputs=states + measurement_noise)


def _random_system(rng: Generator) -> Array:
    """Returns a random stable system with one damped oscillation, in random coordinates.

    Args:
        rng: generator of random numbers.

    Returns:
        System matrix A (2, 2), 1/s.
    """
    decay = rng.uniform(*DECAY_RATES)
    frequency = rng.uniform(0, MAX_FREQUENCY)
    # The eigenvalues of this matrix are −decay ± j frequency: an oscillation that decays.
    oscillation = np.array([[-decay, frequency], [-frequency, -decay]])
    # A shear of at most 1 changes the coordinates; its matrix is far from singular.
    shear = np.array([[1.0, rng.uniform(-1, 1)], [0.0, 1.0]])
    return shear @ oscillation @ np.linalg.inv(shear)


def flight_records(flights: Mapping[str, Flight], smoothness: float) -> list[NoisyRecord]:
    """Returns one window of each recorded flight with added measurement noise of known variance.

    Args:
        flights: flights of the AR.Drone by name.
        smoothness: width of the Gaussian kernel that the added noise is smoothed with, s; 0 for white noise.

    Returns:
        One record of 2 s for each flight. The process noise is what the model does not explain of the recorded states.
    """
    records = []
    for number, window in enumerate(flight_windows(flights, count=1)):
        white_noise = default_rng(number).standard_normal(window.states.shape)
        noise = ADDED_NOISE_SD * smooth_noise(white_noise, smoothness / window.dt)
        records.append(
            NoisyRecord(
                ROLL_SYSTEM_MATRIX,
                window.B,
                window.dt,
                states=window.states,
                outputs=window.states + noise,
                inputs=window.inputs,
                process_variances=window.process_noise.var(axis=0, ddof=1),
                noise_variances=ADDED_NOISE_SD**2,
                smoothness=smoothness,
                # The smoothness of recorded process noise is not known: this is the value of Bos et al.
                process_smoothness=DEM_SMOOTHNESS,
            )
        )
    return records
