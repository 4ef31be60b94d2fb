"""Exact log posterior of the closed loop's parameters from the samples of a record, and its maximum.

The samples z of angle, gyro rate and motors' combination are Gaussian given the parameters, so that a Kalman filter
gives their log likelihood from its innovations e with covariance F. The filter is used in its steady state, for which
the likelihood needs one correction: with the start δ of the states and the trims μ of the channels, both unknown,

    e_t(δ, μ) = e_t − C Lᵗ δ − G_t μ,     δ ~ N(0, P₀ − P),   μ ~ N(0, P_μ),

in which L is the transition matrix of the filter, G_t its response to constant measurements, P₀ the stationary
covariance of the states and P the covariance of the steady filter. δ and μ are integrated out in closed form, which
makes the likelihood exact (P. de Jong, "The diffuse Kalman filter", Annals of Statistics 19(2), 1991).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array
from mavdem.dem.engine.gauss_newton import (
    FINITE_DIFFERENCE_STEP,
    Damping,
    QuadraticExpansion,
    gauss_newton,
)
from mavdem.dem.engine.kalman import MAX_DOUBLINGS, STEADY_CHANGE, steady_state_gain
from mavdem.dem.forecast.lag_regression import lagged_rows
from mavdem.plant.closed_loop.identification import (
    DAMPING_FACTOR,
    INITIAL_DAMPING,
    MAX_DAMPING_ATTEMPTS,
    MAX_PARAMETER_STEP,
    InitialPlant,
)
from mavdem.plant.closed_loop.state_space import (
    CHANNELS,
    NAMES,
    STATES,
    TYPICAL_CROSSOVER,
    LoopController,
    SampledLoop,
    loop_prior,
    sampled_loop,
)

TRIM_PRIOR_SD = 1.0
"""Prior standard deviation of each trim about the mean of the training data, in standard deviations of the channel."""

STARTING_PLANTS = (
    InitialPlant(crossover=3.0, lag=0.05, delay=0.009),
    InitialPlant(crossover=10.0, lag=0.02, delay=0.005),
    InitialPlant(crossover=10.0, lag=0.003, delay=0.002),
)
"""Plants to begin with: of large and of small vehicles, and of simulators, whose motors hardly lag."""

START_LAGS = 4
"""Lags of the autoregression whose one-step errors give the sizes of the noises of a first guess: a choice."""

MIN_START_ERROR = 1e-5
"""Least error of that autoregression, in standard deviations of the channel, so that the error has a logarithm."""

NOISE_FACTOR = 3.0
"""Noises of the first guess, from which an ascent begins, relative to the errors of that autoregression: a choice.

A noise that is too large costs a few nats a sample, one that is too small thousands.
"""

MAX_HALVINGS = 6
"""Times that the effect is halved until a loop is stable: a choice."""

FIRST_STEPS = 4
"""Steps of each ascent before the best of them is chosen: a choice."""

MAX_ASCENT_STEPS = 30
"""Largest number of steps of the chosen ascent: a choice."""


class LoopData(NamedTuple):
    """Samples of an axis in its loop: angle (rad), gyro rate (rad/s) and the combination of the motors."""

    segments: tuple[Array, ...]
    """Samples (T, 3) of each segment, less ``center``."""

    dt: float
    """Sampling step, s."""

    center: Array
    """(3,) means of the channels over all segments."""

    scale: Array
    """(3,) standard deviations of the channels over all segments."""

    @classmethod
    def from_samples(cls, segments: Sequence[Array], dt: float) -> LoopData:
        """Builds the data from the samples of some segments, and subtracts the mean over all of them.

        Args:
            segments: samples (T, 3) of each segment: angle, rad, gyro rate, rad/s, and the combination of the motors.
            dt: sampling step, s.

        Returns:
            The centred data, with mean and standard deviation of each channel.
        """
        samples = np.concatenate(segments)
        center = samples.mean(axis=0)
        centred_segments = tuple(segment - center for segment in segments)
        return cls(centred_segments, dt, center, samples.std(axis=0))

    def prediction_errors(self) -> Array:
        """Returns the standard deviation of each channel's one-step errors by a short vector autoregression.

        They are the sizes of the noises from which the maximisation of the posterior starts.

        Returns:
            (3,) in the units of the channels, at least ``MIN_START_ERROR`` times their standard deviations.
        """
        # A row of the past has the START_LAGS samples before the sample in the same row of ``samples``.
        past = np.concatenate([lagged_rows(segment, START_LAGS) for segment in self.segments])
        samples = np.concatenate([segment[START_LAGS:] for segment in self.segments])
        scaled_past = past / self.tiled_scale
        scaled_samples = samples / self.scale
        coefficients, *_ = np.linalg.lstsq(scaled_past, scaled_samples)
        errors = scaled_samples - scaled_past @ coefficients
        scaled_sds = np.maximum(errors.std(axis=0), MIN_START_ERROR)
        return np.asarray(scaled_sds * self.scale)

    @property
    def tiled_scale(self) -> Array:
        """(3 ``START_LAGS``,) standard deviations of the channels at each lag."""
        return np.tile(self.scale, START_LAGS)

    @property
    def sample_count(self) -> int:
        """Number of samples of all segments."""
        return sum(map(len, self.segments))

    @property
    def trim_covariance(self) -> Array:
        """(3, 3) prior covariance P_μ of the trims."""
        return np.diag((TRIM_PRIOR_SD * self.scale) ** 2)


class SteadyLikelihood(NamedTuple):
    """Log likelihood of one segment under B models, and its innovations at the most probable start and trims."""

    log_likelihood: Array
    """(B,) log likelihoods, nats."""

    innovations: Array
    """(B, T, 3) innovations."""

    covariance: Array
    """(B, 3, 3) covariance F of the innovations of the steady filter."""


def steady_likelihood(
    loop: SampledLoop, samples: Array, trim_covariance: Array
) -> SteadyLikelihood:
    """Computes the exact log likelihood of one segment with the steady filter, by the equations of the module.

    ``tests/plant/test_loop_evidence.py`` compares it with the density of the joint Gaussian of all samples.

    Args:
        loop: B models side by side.
        samples: (T, 3) centred samples.
        trim_covariance: (3, 3) prior covariance of the trims.

    Returns:
        The log likelihood, the innovations (T, 3) and their covariance F of each of the B models.

    Raises:
        numpy.linalg.LinAlgError: a model has no steady filter.
    """
    # The letters are as in the module's equations: gain K, state covariance P, innovation covariance F, and the
    # transition L of the filter's errors, each for B models.
    T = len(samples)
    B = len(loop.transition)
    C = loop.output
    K, P = steady_state_gain(loop.transition, C, loop.process_covariance, loop.noise_covariance)
    F = C @ P @ C.mT + loop.noise_covariance
    F_inverse = np.linalg.inv(F)
    L = loop.transition - K @ C

    # The filter runs over the samples and, in three more rows, over constant measurements of 1 in each channel.
    measurements = np.empty((T, 1, 1 + CHANNELS, CHANNELS))
    measurements[:, 0, 0] = samples
    measurements[:, 0, 1:] = np.eye(CHANNELS)
    residuals = _filter_residuals(L, K, C, measurements, np.zeros((B, 1 + CHANNELS, STATES)))
    weighted_residuals = residuals @ F_inverse
    # Backward in time, the sums Σ (Lᵗ)ᵀ Cᵀ F⁻¹ e_t over all samples.
    sums = np.zeros((B, 1 + CHANNELS, STATES))
    for addend in (weighted_residuals @ C)[::-1]:
        sums = sums @ L
        sums += addend
    # The products Σ e_tᵀ F⁻¹ e_t of each two of the 1 + 3 runs of the filter, for each model: samples and channels are
    # flattened to one axis, over which the matrix product sums.
    residuals_by_model = residuals.transpose(1, 2, 0, 3).reshape(B, 1 + CHANNELS, -1)
    weighted_by_model = weighted_residuals.transpose(1, 2, 0, 3).reshape(B, 1 + CHANNELS, -1)
    products = weighted_by_model @ residuals_by_model.mT

    # Joint information of the samples on the start δ and the trims μ.
    information = np.empty((B, STATES + CHANNELS, STATES + CHANNELS))
    information[:, :STATES, :STATES] = _start_information(L, C.mT @ F_inverse @ C, T)
    information[:, :STATES, STATES:] = sums[:, 1:].mT
    information[:, STATES:, :STATES] = sums[:, 1:]
    information[:, STATES:, STATES:] = products[:, 1:, 1:]
    projection = np.concatenate([sums[:, 0], products[:, 1:, 0]], axis=-1)
    prior_covariance = np.zeros_like(information)
    prior_covariance[:, :STATES, :STATES] = loop.stationary_covariance - P
    prior_covariance[:, STATES:, STATES:] = trim_covariance
    posterior_factor = np.eye(STATES + CHANNELS) + prior_covariance @ information
    prior_projection = (prior_covariance @ projection[..., None])[..., 0]
    estimate = np.linalg.solve(posterior_factor, prior_projection[..., None])[..., 0]

    # The scalar product of projection and estimate, for each model b.
    log_likelihood = 0.5 * (
        np.einsum("bi,bi->b", projection, estimate)
        - products[:, 0, 0]
        - np.linalg.slogdet(posterior_factor)[1]
        - T * np.linalg.slogdet(2 * np.pi * F)[1]
    )
    # The filter runs once more, from the most probable start, after the most probable trims have been subtracted.
    start = estimate[:, None, :STATES]
    trims = estimate[:, None, STATES:]
    innovations = _filter_residuals(L, K, C, samples[:, None, None] - trims, start)
    return SteadyLikelihood(log_likelihood, innovations[:, :, 0].swapaxes(0, 1), F)


def _filter_residuals(L: Array, K: Array, C: Array, measurements: Array, start: Array) -> Array:
    """Runs B steady-state Kalman filters at once, each over R series of measurements, and returns the residuals.

    Args:
        L: (B, n, n) transition matrices of the filters, L = A − K C.
        K: (B, n, 3) steady-state gains.
        C: (B, 3, n) output matrices.
        measurements: (T, B, R, 3) measurements y of each series; (T, 1, R, 3) if all filters have the same ones.
        start: (B, R, n) states x̂ at the first sample.

    Returns:
        Residuals y − C x̂, (T, B, R, 3).
    """
    driving = measurements @ K.mT
    transition = np.ascontiguousarray(L.mT)
    states = np.empty_like(driving)
    states[0] = start
    for t in range(len(driving) - 1):
        np.matmul(states[t], transition, out=states[t + 1])
        states[t + 1] += driving[t]
    return measurements - states @ C.mT


def _start_information(L: Array, information: Array, samples: int) -> Array:
    """Returns the information of T samples on the states at the first one: Σ_t (Lᵗ)ᵀ M Lᵗ over t = 0 … T − 1.

    The infinite sum is computed by doubling the number of its summands until it no longer grows. Its summands from T on
    are then subtracted: they are (Lᵀ)ᵗ times the infinite sum times Lᵗ at t = T.

    Args:
        L: (B, n, n) transition matrices of stable filters.
        information: (B, n, n) information M = Cᵀ F⁻¹ C of one sample.
        samples: number T of samples.

    Returns:
        (B, n, n) information.
    """
    # The sum of the first N = 1, 2, 4, … summands, and Lᴺ, by which the next N summands follow from them.
    power_of_L = L
    infinite_sum = information
    for _ in range(MAX_DOUBLINGS):
        next_summands = power_of_L.mT @ infinite_sum @ power_of_L
        infinite_sum = infinite_sum + next_summands
        power_of_L = power_of_L @ power_of_L
        if abs(next_summands).max() <= STEADY_CHANGE * abs(infinite_sum).max():
            break
    transition_to_end = np.linalg.matrix_power(L, samples)
    return infinite_sum - transition_to_end.mT @ infinite_sum @ transition_to_end


class LoopPosterior:
    """Log posterior density of the parameters' logarithms; an ``Objective`` for Fisher scoring.

    Attributes:
        data: the samples.
        controller: the controller, known or not.
        prior: prior of the logarithms.
    """

    def __init__(self, data: LoopData, controller: LoopController) -> None:
        """Stores the data and the controller, and derives the prior of the loop's parameters from them.

        Args:
            data: the samples.
            controller: the controller. If nothing is known of it, its prior is wide.
        """
        self.data = data
        self.controller = controller
        self.prior = loop_prior(controller, output_size=float(data.scale[-1]))

    def likelihoods(self, thetas: Array) -> list[SteadyLikelihood]:
        """Returns the likelihood of each segment under several parameter vectors at once.

        Args:
            thetas: B vectors of the logarithms of the parameters (B, k).

        Returns:
            For each segment, log likelihood, innovations and their covariance under each of the B vectors.

        Raises:
            numpy.linalg.LinAlgError: one of the B loops is unstable.
        """
        with np.errstate(all="ignore"):
            loop = sampled_loop(thetas, self.controller, self.data.dt)
            return [
                steady_likelihood(loop, segment, self.data.trim_covariance)
                for segment in self.data.segments
            ]

    def value(self, theta: Array) -> float:
        """Returns the log posterior density, up to a constant.

        Args:
            theta: logarithms of the parameters (k,).

        Returns:
            The log posterior density, nats; NaN if the loop is unstable.
        """
        try:
            likelihoods = self.likelihoods(theta[None])
        except LinAlgError:
            return np.nan
        log_likelihood = sum(float(segment.log_likelihood[0]) for segment in likelihoods)
        return log_likelihood + self._log_prior(theta)

    def expand(self, theta: Array) -> QuadraticExpansion:
        """Expands the log posterior about a point to second order, with the Fisher information as curvature.

        For Gaussian innovations e with covariance F, the Fisher information on two parameters a and b is
        Σ_t (e_aᵀ F⁻¹ e_b + ½ tr(F⁻¹ F_a F⁻¹ F_b)). Subscripts are derivatives, here by forward differences.

        Args:
            theta: logarithms of the parameters at the point (k,).

        Returns:
            Value, gradient (k,) and curvature (k, k) of the log posterior at the point.

        Raises:
            numpy.linalg.LinAlgError: the loop is unstable there.
        """
        k = len(theta)
        step = FINITE_DIFFERENCE_STEP
        value = self._log_prior(theta)
        gradient = (self.prior.mean - theta) / self.prior.sd**2
        curvature = np.diag(self.prior.sd**-2.0)
        # Row 0 of each result belongs to the point itself; in row i + 1, parameter i is changed by a step.
        for segment in self.likelihoods(np.vstack([theta, theta + step * np.eye(k)])):
            value += float(segment.log_likelihood[0])
            gradient += (segment.log_likelihood[1:] - segment.log_likelihood[0]) / step
            curvature += _fisher_information(segment, step)
        return QuadraticExpansion(theta, value, gradient, curvature)

    def limited_step(self, step: Array) -> Array:
        """Shortens a step (k,) so that no logarithm changes by more than ``MAX_PARAMETER_STEP``."""
        return step / max(1.0, abs(step).max() / MAX_PARAMETER_STEP)

    def _log_prior(self, theta: Array) -> float:
        """Returns the logarithm of the normal prior density of (k,), up to a constant."""
        return -0.5 * float(np.sum(((theta - self.prior.mean) / self.prior.sd) ** 2))


def _fisher_information(likelihood: SteadyLikelihood, step: float) -> Array:
    """Returns the Fisher information on the parameters in the innovations of one segment.

    It is Σ_t (e_aᵀ F⁻¹ e_b + ½ tr(F⁻¹ F_a F⁻¹ F_b)) for parameters a and b (:meth:`LoopPosterior.expand`). With the
    Cholesky factor G of the covariance F = G Gᵀ, the derivatives are whitened by G⁻¹, so that each term is a product of
    whitened derivatives.

    Args:
        likelihood: innovations e and their covariance F, in row 0 at the point, in row i + 1 with parameter i changed.
        step: change of each parameter, by which the derivatives are differences.

    Returns:
        Information (k, k).
    """
    parameter_count = len(likelihood.log_likelihood) - 1
    whitener = np.linalg.inv(np.linalg.cholesky(likelihood.covariance[0]))
    derivatives = (likelihood.innovations[1:] - likelihood.innovations[0]) / step @ whitener.T
    covariance_derivatives = (likelihood.covariance[1:] - likelihood.covariance[0]) / step
    covariance_derivatives = whitener @ covariance_derivatives @ whitener.T
    # One row for each parameter.
    derivatives = derivatives.reshape(parameter_count, -1)
    covariance_derivatives = covariance_derivatives.reshape(parameter_count, -1)
    samples = likelihood.innovations.shape[1]
    information_of_covariance = 0.5 * samples * covariance_derivatives @ covariance_derivatives.T
    return np.asarray(derivatives @ derivatives.T + information_of_covariance)


def fit_closed_loop(posterior: LoopPosterior) -> QuadraticExpansion:
    """Maximises the log posterior by damped Fisher scoring, from several starting plants.

    A few steps are made from each plant; only the ascent with the highest posterior is continued to convergence.

    Args:
        posterior: log posterior of the loop's parameters, with gradient and Fisher information.

    Returns:
        Its expansion about the highest maximum that was found.

    Raises:
        numpy.linalg.LinAlgError: no start has a stable loop.
    """
    damping = Damping(
        initial=INITIAL_DAMPING,
        factor=DAMPING_FACTOR,
        max_attempts=MAX_DAMPING_ATTEMPTS,
        limit_step=posterior.limited_step,
    )
    ends_of_first_steps = list[QuadraticExpansion]()
    for plant in STARTING_PLANTS:
        try:
            start = _stable_start(posterior, plant)
            ascent = gauss_newton(posterior, posterior.expand(start), damping, FIRST_STEPS)
        except LinAlgError:
            # The loop with this plant is unstable.
            continue
        ends_of_first_steps.append(ascent.expansions[-1])
    if not ends_of_first_steps:
        raise LinAlgError("no starting plant has a stable closed loop")
    highest_end = max(ends_of_first_steps, key=lambda expansion: expansion.value)
    ascent = gauss_newton(posterior, highest_end, damping, MAX_ASCENT_STEPS)
    return ascent.expansions[-1]


def _stable_start(posterior: LoopPosterior, plant: InitialPlant) -> Array:
    """Returns the parameters of a stable loop, from which the maximisation of the posterior can start.

    Effect, lag and delay are taken from a starting plant. All noises begin with the size of the one-step prediction
    errors of the channel that they act on, times ``NOISE_FACTOR``, and all other parameters with their prior mean. The
    effect is halved until the loop is stable.

    Args:
        posterior: log posterior of the loop's parameters, with gradient and Fisher information.
        plant: crossover, Hz, lag, s, and delay, s, to begin with.

    Returns:
        Logarithms of the parameters (k,).

    Raises:
        numpy.linalg.LinAlgError: no effect makes a stable loop.
    """
    start = posterior.prior.mean.copy()
    start[NAMES.index("effect")] += np.log(plant.crossover / TYPICAL_CROSSOVER)
    start[NAMES.index("lag")] = np.log(plant.lag)
    start[NAMES.index("delay")] = np.log(plant.delay)
    loop_data = posterior.data
    angle_error, rate_error, motors_error = (NOISE_FACTOR * loop_data.prediction_errors()).tolist()
    # The torque, rad/s², that changes the rate by its one-step error within a step.
    torque_error = rate_error / loop_data.dt
    sizes = {
        "angle_noise": angle_error,
        "filtered_noise": rate_error,
        "gyro_noise": rate_error,
        "output_noise": motors_error,
        "actuation": motors_error,
        "drift_size": torque_error,
        "eddy_size": torque_error,
        "gust_size": torque_error,
        "setpoint_size": float(loop_data.scale[0]),
    }
    for name, size in sizes.items():
        start[NAMES.index(name)] = np.log(size)
    for _ in range(MAX_HALVINGS):
        if np.isfinite(posterior.value(start)):
            return start
        start[NAMES.index("effect")] -= np.log(2.0)
    raise LinAlgError("no closed loop is stable")
