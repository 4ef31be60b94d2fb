"""The free energy F̄ of the plant in its loop, by the terms that DEM's has, and F(t), the share of each sample.

The model is linear and Gaussian, so that the D step is exact: given the parameters, a Kalman filter and smoother have
the posterior of the states, and F̄ is the log likelihood. The posterior of parameters θ and hyperparameters λ is
Laplace's, and F̄ is then his approximation of the log evidence, in the units of the record:

    F̄ = ln p(z | θ, λ) + ln p(θ, λ) + ½ ln |2π Σ|.

With the driving noises ω of the states, of unit variance, and the measurement noises v of covariance R, both smoothed,
and the innovations e of covariance F, the log likelihood is

    −½ Σ ln |2πR| + ½ Σ (ln |R| − ln |F|) − ½ Σ vᵀ R⁻¹ v − ½ Σ ωᵀ ω,

the noises' entropy, the entropy of the states after the measurement less that before it, and two prediction errors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.engine.free_energy import Term
from mavdem.dem.engine.gauss_newton import QuadraticExpansion
from mavdem.dem.engine.kalman import KalmanFilter
from mavdem.dem.engine.linalg import logdet
from mavdem.plant.closed_loop.evidence import LoopPosterior
from mavdem.plant.closed_loop.state_space import (
    CHANNELS,
    PARAMETERS,
    STATES,
    SampledLoop,
    sampled_loop,
    setpoint_process_covariance,
)

MOTORS_CHANNEL = CHANNELS - 1
"""Index of the motors' combination among the channels; the outputs, angle and rate, come before it."""


class FilteredSegment(NamedTuple):
    """The innovations of one segment with everything that its free energy needs."""

    innovations: Array
    """(T, 3) innovations e."""

    precisions: Array
    """(T, 3, 3) inverses F⁻¹ of their covariances."""

    smoothing: Array
    """(T + 1, n + 3) vectors r of the disturbance smoother: row t sums up what samples t and later show."""

    gains: Array
    """(T, n + 3, 3) gains of the filter."""

    @property
    def log_densities(self) -> Array:
        """(T,) log density of each sample given those before it, nats."""
        log_determinants = np.linalg.slogdet(self.precisions / (2 * np.pi))[1]
        squares = np.einsum("ti,tij,tj->t", self.innovations, self.precisions, self.innovations)
        return np.asarray(0.5 * (log_determinants - squares))

    @property
    def output_log_densities(self) -> Array:
        """(T,) log density of angle and rate, given the motors of the same sample and all samples before it, nats.

        It is that of all channels less that of the motors alone.
        """
        covariances = np.linalg.inv(self.precisions)
        motors_variance = covariances[:, MOTORS_CHANNEL, MOTORS_CHANNEL]
        motors_innovations = self.innovations[:, MOTORS_CHANNEL]
        motors_log_densities = -0.5 * (
            np.log(2 * np.pi * motors_variance) + motors_innovations**2 / motors_variance
        )
        return self.log_densities - motors_log_densities


def trim_augmented_filter(loop: SampledLoop, trim_covariance: Array, samples: int) -> KalmanFilter:
    """Returns the exact Kalman filter of the loop, with the trims of the channels as three more, constant states.

    Args:
        loop: the sampled loop.
        trim_covariance: (3, 3) prior covariance of the trims.
        samples: number of samples that the filter is needed for.
    """
    n = STATES + CHANNELS
    transition = np.eye(n)
    transition[:STATES, :STATES] = loop.transition
    process_covariance = np.zeros((n, n))
    process_covariance[:STATES, :STATES] = loop.process_covariance
    initial_covariance = np.zeros((n, n))
    initial_covariance[:STATES, :STATES] = loop.stationary_covariance
    initial_covariance[STATES:, STATES:] = trim_covariance
    return KalmanFilter.design(
        A=transition,
        C=np.hstack([loop.output, np.eye(CHANNELS)]),
        Q=process_covariance,
        R=loop.noise_covariance,
        S=np.zeros((n, CHANNELS)),
        initial_covariance=initial_covariance,
        samples=samples,
    )


def filter_segment(kalman_filter: KalmanFilter, samples: Array) -> FilteredSegment:
    """Filters one segment, and runs the disturbance smoother backward: r_{t−1} = Cᵀ F⁻¹ e + Lᵀ r_t.

    Args:
        kalman_filter: the filter of :func:`trim_augmented_filter`.
        samples: (T, 3) centred samples.
    """
    T = len(samples)
    n = len(kalman_filter.A)
    _, innovations = kalman_filter.filter(np.zeros(n), np.zeros((T, n)), samples)
    rows = kalman_filter.gain_rows(T)
    gains = kalman_filter.gains[rows]
    precisions = kalman_filter.innovation_precisions[rows]
    weighted = np.einsum("tij,tj->ti", precisions, innovations) @ kalman_filter.C
    transitions = kalman_filter.A - kalman_filter.gains @ kalman_filter.C
    smoothing = np.zeros((T + 1, n))
    for t in range(T - 1, -1, -1):
        smoothing[t] = weighted[t] + smoothing[t + 1] @ transitions[rows[t]]
    return FilteredSegment(innovations, precisions, smoothing, gains)


class LoopFreeEnergy(NamedTuple):
    """F̄ of a closed loop by named terms, and F(t)."""

    terms: Mapping[str, float]
    """Terms of F̄ by their names in :class:`~mavdem.dem.engine.free_energy.Term`, nats; their sum is F̄."""

    log_densities: Array
    """(T,) log density of each sample given those before it, nats."""

    output_log_densities: Array
    """(T,) the same of angle and rate alone, given the motors of the same sample as well."""

    @property
    def total(self) -> float:
        """F̄, nats."""
        return sum(self.terms.values())

    @property
    def complexity(self) -> float:
        """What parameters and hyperparameters cost: the log likelihood less F̄, nats."""
        return float(self.log_densities.sum()) - self.total

    @property
    def of_samples(self) -> Array:
        """(T,) F(t), nats: a sample's log density, less its equal share of the complexity. The sum is F̄."""
        return self.log_densities - self.complexity / len(self.log_densities)


def loop_free_energy(posterior: LoopPosterior, maximum: QuadraticExpansion) -> LoopFreeEnergy:
    """Computes F̄ of a closed loop and its terms at the maximum of its posterior.

    Args:
        posterior: the log posterior.
        maximum: its expansion about the maximum.
    """
    data = posterior.data
    theta = maximum.point
    loop = sampled_loop(theta, posterior.controller, data.dt)
    setpoint_covariance, setpoint_start = setpoint_process_covariance(
        theta, posterior.controller, data.dt, loop.state_sd
    )
    longest = max(map(len, data.segments))
    kalman_filter = trim_augmented_filter(loop, data.trim_covariance, longest)
    segments = [filter_segment(kalman_filter, samples) for samples in data.segments]

    input_squares = 0.0
    state_squares = 0.0
    output_squares = 0.0
    log_determinants = 0.0
    trims = slice(STATES, None)
    for segment in segments:
        states = segment.smoothing[:, :STATES]
        # ω is smoothed to Q r after each sample, and to P₀ r before the first, whose squares are rᵀ Q r and rᵀ P₀ r.
        driving = np.sum(states[1:] @ loop.process_covariance * states[1:])
        driving += states[0] @ loop.stationary_covariance @ states[0]
        by_setpoint = np.sum(states[1:] @ setpoint_covariance * states[1:])
        by_setpoint += states[0] @ setpoint_start @ states[0]
        trim_squares = segment.smoothing[0, trims] @ data.trim_covariance
        input_squares += by_setpoint
        state_squares += driving - by_setpoint + trim_squares @ segment.smoothing[0, trims]
        # v is smoothed to R (F⁻¹ e − Kᵀ r).
        weighted = np.einsum("tij,tj->ti", segment.precisions, segment.innovations)
        weighted -= np.einsum("tni,tn->ti", segment.gains, segment.smoothing[1:])
        output_squares += np.sum(weighted**2 * loop.noise_variance)
        log_determinants += np.linalg.slogdet(segment.precisions)[1].sum()

    samples = data.sample_count
    noise_log_determinant = samples * np.log(loop.noise_variance).sum()
    curvature = maximum.curvature
    # The hyperparameters' entropy is that of their marginal posterior, that of the parameters is given them.
    parameters = slice(0, PARAMETERS)
    hyperparameters = slice(PARAMETERS, None)
    parameter_log_determinant = logdet(curvature[parameters, parameters])
    hyperparameter_log_determinant = logdet(curvature) - parameter_log_determinant
    deviations = ((theta - posterior.prior.mean) / posterior.prior.sd) ** 2
    log_prior_sd = np.log(posterior.prior.sd)
    terms = {
        Term.NOISE_ENTROPY: -0.5 * (noise_log_determinant + samples * CHANNELS * np.log(2 * np.pi)),
        Term.STATE_AND_INPUT_ENTROPY: 0.5 * (noise_log_determinant + log_determinants),
        Term.PARAMETER_ENTROPY: -0.5 * parameter_log_determinant - log_prior_sd[parameters].sum(),
        Term.HYPERPARAMETER_ENTROPY: -0.5 * hyperparameter_log_determinant
        - log_prior_sd[hyperparameters].sum(),
        Term.PREDICTION_ERROR_OF_OUTPUTS: -0.5 * output_squares,
        Term.PREDICTION_ERROR_OF_INPUTS: -0.5 * input_squares,
        Term.PREDICTION_ERROR_OF_STATES: -0.5 * state_squares,
        Term.PREDICTION_ERROR_OF_PARAMETERS: -0.5 * deviations[parameters].sum(),
        Term.PREDICTION_ERROR_OF_HYPERPARAMETERS: -0.5 * deviations[hyperparameters].sum(),
    }
    return LoopFreeEnergy(
        terms={name: float(value) for name, value in terms.items()},
        log_densities=np.concatenate([segment.log_densities for segment in segments]),
        output_log_densities=np.concatenate([segment.output_log_densities for segment in segments]),
    )
