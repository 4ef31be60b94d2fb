"""The free energy F̄ of the plant in its loop, by the same terms as in DEM, and F(t), the share of each sample.

The model is linear and Gaussian, so that the D step is exact: given the parameters, a Kalman filter and smoother have
the posterior of the states, and F̄ is the log likelihood. The posterior of parameters θ and hyperparameters λ is
Laplace's, and F̄ is then his approximation of the log evidence, in the units of the record:

    F̄ = ln p(z | θ, λ) + ln p(θ, λ) + ½ ln |2π Σ|.

With the driving noises ω of the states, of unit variance, and the measurement noises v of covariance R, both smoothed,
and the innovations e of covariance F, the log likelihood is

    −½ Σ ln |2πR| + ½ Σ (ln |R| − ln |F|) − ½ Σ vᵀ R⁻¹ v − ½ Σ ωᵀ ω,

the noises' entropy, the entropy of the states after the measurement minus that before it, and two prediction errors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import scipy

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
    """One segment after the Kalman filter (innovations, gains) and the disturbance smoother (vectors r)."""

    innovations: Array
    """(T, 3) innovations e."""

    precisions: Array
    """(T, 3, 3) inverses F⁻¹ of their covariances."""

    smoother_vectors: Array
    """(T + 1, n + 3) vectors r of the disturbance smoother: row t is a weighted sum of the innovations from t on."""

    gains: Array
    """(T, n + 3, 3) gains of the filter."""

    @property
    def log_densities(self) -> Array:
        """(T,) log density of each sample given those before it, nats."""
        log_determinants = np.linalg.slogdet(self.precisions / (2 * np.pi))[1]
        # The quadratic form eᵀ F⁻¹ e of each sample t.
        squares = np.einsum("ti,tij,tj->t", self.innovations, self.precisions, self.innovations)
        return np.asarray(0.5 * (log_determinants - squares))


def trim_augmented_filter(loop: SampledLoop, trim_covariance: Array, samples: int) -> KalmanFilter:
    """Returns the exact Kalman filter of the loop, with the trims of the channels as three more, constant states.

    The trim of a channel is the mean that it has in the segment.

    Args:
        loop: the closed loop as discrete-time state-space model, sampled at the rate of the record.
        trim_covariance: (3, 3) prior covariance of the trims.
        samples: number of samples of the longest segment to filter.

    Returns:
        The filter of the loop's states, and then the trims.
    """
    # A trim is constant: its transition is 1, and no noise drives it. It is added to its channel.
    constant_trims = np.eye(CHANNELS)
    no_trim_noise = np.zeros((CHANNELS, CHANNELS))
    return KalmanFilter.design(
        A=scipy.linalg.block_diag(loop.transition, constant_trims),
        C=np.hstack([loop.output, np.eye(CHANNELS)]),
        Q=scipy.linalg.block_diag(loop.process_covariance, no_trim_noise),
        R=loop.noise_covariance,
        S=np.zeros((STATES + CHANNELS, CHANNELS)),
        initial_covariance=scipy.linalg.block_diag(loop.stationary_covariance, trim_covariance),
        samples=samples,
    )


def filter_segment(kalman_filter: KalmanFilter, samples: Array) -> FilteredSegment:
    """Runs the Kalman filter forward over one segment, and the disturbance smoother backward.

    The filter has the innovations e with covariance F, and the transition L = A − K C of its errors. The smoother's
    recursion is r_{t−1} = Cᵀ F⁻¹ e + Lᵀ r_t, from 0 after the last sample; smoothed noises are linear in r.

    Args:
        kalman_filter: the filter of :func:`trim_augmented_filter`, with n states.
        samples: (T, 3) centred samples.

    Returns:
        Innovations and their precisions F⁻¹, the vectors r (T + 1, n), and the gains K, sample by sample.
    """
    T = len(samples)
    n = len(kalman_filter.A)
    # The state at the first sample has the mean 0, and no known input acts on the states.
    initial_state = np.zeros(n)
    known_forcing = np.zeros((T, n))
    _, innovations = kalman_filter.filter(initial_state, known_forcing, samples)
    rows = kalman_filter.gain_rows(T)
    # The filter has one row for each step until it is steady, and the steady one for all later steps.
    gains = kalman_filter.gains[rows]
    precisions = kalman_filter.innovation_precisions[rows]
    # Cᵀ F⁻¹ e of each sample t, as rows.
    weighted_innovations = np.einsum("tij,tj->ti", precisions, innovations) @ kalman_filter.C
    transitions = kalman_filter.A - kalman_filter.gains @ kalman_filter.C
    smoother_vectors = np.zeros((T + 1, n))
    for t in range(T - 1, -1, -1):
        later_vector = smoother_vectors[t + 1] @ transitions[rows[t]]
        smoother_vectors[t] = weighted_innovations[t] + later_vector
    return FilteredSegment(innovations, precisions, smoother_vectors, gains)


class LoopFreeEnergy(NamedTuple):
    """F̄ of a closed loop by named terms, and F(t)."""

    terms: Mapping[str, float]
    """Terms of F̄ by their names in :class:`~mavdem.dem.engine.free_energy.Term`, nats; their sum is F̄."""

    log_densities: Array
    """(T,) log density of each sample given those before it, nats."""

    @property
    def total(self) -> float:
        """F̄, nats."""
        return sum(self.terms.values())

    @property
    def complexity(self) -> float:
        """What parameters and hyperparameters cost: the log likelihood less F̄, nats."""
        return float(self.log_densities.sum()) - self.total

    @property
    def free_energy_of_samples(self) -> Array:
        """(T,) F(t), nats: a sample's log density, less its equal share of the complexity. The sum is F̄."""
        return self.log_densities - self.complexity / len(self.log_densities)


class _SquaredErrors(NamedTuple):
    """Sums of the squares of smoothed noises over one segment, each in units of its covariance."""

    outputs: float
    """The terms of the measurement noises v."""

    inputs: float
    """The terms of the driving noise of the setpoint."""

    states: float
    """The terms of all other driving noises, of the start, and of the trims."""


class _ProcessCovariances(NamedTuple):
    """Prior covariances of the states' noise in one step, Q, and of the states at the first sample, P₀."""

    step: Array
    """(n, n) covariance of one step."""

    start: Array
    """(n, n) covariance of the states before anything is measured."""

    def squared_errors(self, smoother_vectors: Array) -> float:
        """Returns the sum of squares of the smoothed noises, each weighted by the inverse of its covariance.

        The disturbance smoother has a vector r for each step, with which the smoothed noise of the step is w = Q r. So
        its square weighted by Q⁻¹, wᵀ Q⁻¹ w, is rᵀ Q r, without an inverse. The states at the first sample are P₀ r
        likewise, with the square rᵀ P₀ r.

        Args:
            smoother_vectors: (T + 1, n) vectors r: of the first sample in row 0, then of each step.
        """
        first_vector = smoother_vectors[0]
        step_vectors = smoother_vectors[1:]
        # The sum of the elementwise product is the sum of rᵀ Q r over the steps.
        step_squares = np.sum(step_vectors @ self.step * step_vectors)
        return float(step_squares + first_vector @ self.start @ first_vector)


def _squared_errors(
    segment: FilteredSegment,
    noise_variance: Array,
    driving: _ProcessCovariances,
    setpoint: _ProcessCovariances,
    trim_covariance: Array,
) -> _SquaredErrors:
    """Sums the squares of all smoothed noises of one segment, for each group of noises.

    The smoothed value of any noise is its prior covariance times the smoother's vector r. Its square over its variance
    is therefore rᵀ · covariance · r, which is what is summed here. The trims (the mean of each channel in the segment)
    are constant states, so that their smoothed value is determined by r at the first sample alone.

    Args:
        segment: the filtered and smoothed segment.
        noise_variance: (3,) variances of the measurement noises.
        driving: covariances that all noises together cause in the states.
        setpoint: the same, caused by the noise of the setpoint alone. As the noises are independent, the squares of the
            others are the difference.
        trim_covariance: (3, 3) prior covariance of the trims.

    Returns:
        Sums of squares, each divided by its variance, of measurement noise, setpoint, and other driving noises, which
        include the trims.
    """
    # The columns of r belong to the states of the loop, and then to the trims.
    state_vectors = segment.smoother_vectors[:, :STATES]
    trim_vector = segment.smoother_vectors[0, STATES:]
    setpoint_errors = setpoint.squared_errors(state_vectors)
    trim_squares = float(trim_vector @ trim_covariance @ trim_vector)
    # The smoothed measurement noise is R (F⁻¹ e − Kᵀ r). Letters of einsum: sample t, channels i and j, state n.
    noise_per_variance = np.einsum("tij,tj->ti", segment.precisions, segment.innovations)
    noise_per_variance -= np.einsum("tni,tn->ti", segment.gains, segment.smoother_vectors[1:])
    # The square of a noise over its variance is (noise / variance)² · variance.
    return _SquaredErrors(
        outputs=float(np.sum(noise_per_variance**2 * noise_variance)),
        inputs=setpoint_errors,
        states=driving.squared_errors(state_vectors) - setpoint_errors + trim_squares,
    )


def loop_free_energy(posterior: LoopPosterior, maximum: QuadraticExpansion) -> LoopFreeEnergy:
    """Computes F̄ of a closed loop and its terms at the maximum of its posterior.

    Args:
        posterior: the log posterior.
        maximum: its expansion about the maximum.

    Returns:
        The terms, nats, whose sum is F̄, and the log density of each sample.
    """
    loop_data = posterior.data
    theta = maximum.point
    loop = sampled_loop(theta, posterior.controller, loop_data.dt)
    kalman_filter = trim_augmented_filter(
        loop, loop_data.trim_covariance, samples=max(map(len, loop_data.segments))
    )
    segments = [filter_segment(kalman_filter, samples) for samples in loop_data.segments]
    driving = _ProcessCovariances(loop.process_covariance, loop.stationary_covariance)
    setpoint = _ProcessCovariances(
        *setpoint_process_covariance(theta, posterior.controller, loop_data.dt, loop.state_sd)
    )
    errors = [
        _squared_errors(segment, loop.noise_variance, driving, setpoint, loop_data.trim_covariance)
        for segment in segments
    ]
    precision_log_determinant = sum(
        np.linalg.slogdet(segment.precisions)[1].sum() for segment in segments
    )
    sample_count = loop_data.sample_count
    noise_log_determinant = sample_count * np.log(loop.noise_variance).sum()

    # For the hyperparameters this is the entropy of their marginal posterior, and for the parameters the entropy of
    # their posterior given the hyperparameters.
    parameters = slice(0, PARAMETERS)
    hyperparameters = slice(PARAMETERS, None)
    parameter_log_determinant = logdet(maximum.curvature[parameters, parameters])
    hyperparameter_log_determinant = logdet(maximum.curvature) - parameter_log_determinant
    deviations = ((theta - posterior.prior.mean) / posterior.prior.sd) ** 2
    log_prior_sd = np.log(posterior.prior.sd)
    terms = {
        Term.NOISE_ENTROPY: -0.5
        * (noise_log_determinant + sample_count * CHANNELS * np.log(2 * np.pi)),
        Term.STATE_AND_INPUT_ENTROPY: 0.5 * (noise_log_determinant + precision_log_determinant),
        Term.PARAMETER_ENTROPY: -0.5 * parameter_log_determinant - log_prior_sd[parameters].sum(),
        Term.HYPERPARAMETER_ENTROPY: -0.5 * hyperparameter_log_determinant
        - log_prior_sd[hyperparameters].sum(),
        Term.PREDICTION_ERROR_OF_OUTPUTS: -0.5 * sum(error.outputs for error in errors),
        Term.PREDICTION_ERROR_OF_INPUTS: -0.5 * sum(error.inputs for error in errors),
        Term.PREDICTION_ERROR_OF_STATES: -0.5 * sum(error.states for error in errors),
        Term.PREDICTION_ERROR_OF_PARAMETERS: -0.5 * deviations[parameters].sum(),
        Term.PREDICTION_ERROR_OF_HYPERPARAMETERS: -0.5 * deviations[hyperparameters].sum(),
    }
    return LoopFreeEnergy(
        terms={name: float(value) for name, value in terms.items()},
        log_densities=np.concatenate([segment.log_densities for segment in segments]),
    )
