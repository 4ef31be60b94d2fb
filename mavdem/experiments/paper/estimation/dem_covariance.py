"""DEM's M step as an estimator of noise variances: of a whole record, and from sample to sample."""

from __future__ import annotations

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.engine.free_energy import Posterior
from mavdem.dem.engine.generalized_coordinates import embed, temporal_precision
from mavdem.dem.engine.generative import GenerativeModel, Prior
from mavdem.dem.engine.model import pack
from mavdem.dem.engine.moments import GeneralizedMoments, SufficientStatistics
from mavdem.dem.engine.steps import d_step, m_step, with_optimal_covariances
from mavdem.experiments.paper.estimation.covariance_estimators import (
    FIRST_LOG_PRECISION,
    FORGETTING_FACTOR,
    RecursiveEstimates,
)
from mavdem.experiments.paper.estimation.noisy_records import NoisyRecord

ORDER = 4
"""Embedding order p of outputs and states; a choice."""

INPUT_ORDER = 2
"""Embedding order d of the inputs; a choice."""

UNKNOWN_PRECISION = np.exp(-4.0)
"""Prior precision of the λ of the measurement noise, as in the code that the authors publish."""

KNOWN_PRECISION = np.exp(32.0)
"""Prior precision of all that is known: θ, the λ of the process noise, and the inputs."""

MAX_ITERATIONS = 50
"""Largest number of D and M steps in turn; they converge in fewer."""

CONVERGED_CHANGE = 1e-3
"""Change of λ in one iteration below which the estimate has converged, 0.1 % of a variance."""

UPDATE_SAMPLES = 8
"""Samples after which the online estimate takes a D and an M step; a choice."""


def generative_model(record: NoisyRecord) -> GenerativeModel:
    """Returns DEM's model of a record, in which only the precisions of the measurement noises are unknown.

    All other quantities are known: their priors have the very high precision ``KNOWN_PRECISION``.

    Args:
        record: T samples with the system matrices, and the variances and smoothness of its process noise.

    Returns:
        The model of n states, all of which are measured, and r inputs. λ has the log precisions of the measurement
        noises (n), whose prior is weak, and then of the process noises (n), which are known.
    """
    n, r = record.B.shape
    # All states are measured: C is the identity.
    theta = pack(record.A, record.B, np.eye(n))
    # DEM's noise cannot be white. In its place a smoothness of one sampling step is assumed, as by ``mavdem learn``.
    smoothness = record.smoothness or record.dt
    process_smoothness = record.process_smoothness or record.dt
    # The noise of the continuous model has the unit of the states per second.
    process_precisions = record.dt**2 / record.process_variances
    lambda_mean = np.concatenate([np.full(n, FIRST_LOG_PRECISION), np.log(process_precisions)])
    lambda_precision = np.repeat([UNKNOWN_PRECISION, KNOWN_PRECISION], n)
    return GenerativeModel(
        n=n,
        r=r,
        m=n,
        p=ORDER,
        d=INPUT_ORDER,
        q=ORDER - 1,
        output_temporal_precision=temporal_precision(ORDER, smoothness),
        state_temporal_precision=temporal_precision(ORDER - 1, process_smoothness),
        # Index in λ of the noise of each output and of each state.
        output_groups=np.arange(n),
        state_groups=n + np.arange(n),
        input_precision=KNOWN_PRECISION * np.eye(r * (INPUT_ORDER + 1)),
        prior=Prior(
            theta_mean=theta,
            theta_precision=KNOWN_PRECISION * np.eye(len(theta)),
            lambda_mean=lambda_mean,
            lambda_precision=np.diag(lambda_precision),
        ),
    )


def generalized_data(record: NoisyRecord) -> Array:
    """Embeds the outputs and inputs of a record in generalized coordinates.

    Args:
        record: T samples.

    Returns:
        A row [ỹ; η̃] for each of the T − ``ORDER`` samples with a whole window of ``ORDER`` + 1 samples around it. The
        derivatives of the outputs reach up to ``ORDER``, the derivatives of the inputs up to ``INPUT_ORDER``.
    """
    center = ORDER // 2
    outputs = embed(record.outputs, ORDER, record.dt, ORDER + 1, center)
    inputs = embed(record.inputs, ORDER, record.dt, ORDER + 1, center)
    used_columns = record.B.shape[1] * (INPUT_ORDER + 1)
    return np.hstack([outputs, inputs[:, :used_columns]])


def first_posterior(model: GenerativeModel, statistics: SufficientStatistics) -> Posterior:
    """Returns a posterior at the priors of θ and λ, from which the steps of DEM start.

    Args:
        model: the generative model, with its priors.
        statistics: sufficient statistics of the generalized data.

    Returns:
        The posterior; its states are 0, and not used.
    """
    prior = model.prior
    hidden_size = model.n * (model.p + 1) + model.r * (model.d + 1)
    no_states = np.zeros((hidden_size, len(statistics.gram)))
    return Posterior(
        GeneralizedMoments.from_state_map(model, statistics, no_states),
        state_covariance=np.zeros((hidden_size, hidden_size)),
        theta=prior.theta_mean,
        theta_covariance=np.zeros_like(prior.theta_precision),
        lambda_=prior.lambda_mean,
        lambda_covariance=np.zeros_like(prior.lambda_precision),
    )


def with_new_precisions(posterior: Posterior, statistics: SufficientStatistics) -> Posterior:
    """Estimates the states anew by a D step of DEM, and then the log noise precisions λ by an M step.

    The covariance of the states is updated too: without it the M step would treat uncertain states as exact, and
    overestimate the precisions. The covariances of the system matrices θ and of λ stay 0, so that their uncertainty is
    not propagated: the code that the authors published does not do that either.

    Args:
        posterior: the posterior before the steps.
        statistics: number and second moments of the samples, each a vector of outputs and inputs with their time
            derivatives.

    Returns:
        The posterior with new states and λ.
    """
    # The D step returns the map from the data of a sample to its states.
    state_map = d_step(posterior)
    moments = GeneralizedMoments.from_state_map(posterior.model, statistics, state_map)
    with_new_states = posterior._replace(moments=moments)
    state_covariance = with_optimal_covariances(with_new_states).state_covariance
    with_new_covariance = with_new_states._replace(state_covariance=state_covariance)
    return with_new_covariance._replace(lambda_=m_step(with_new_covariance))


def dem_variances(record: NoisyRecord) -> RecursiveEstimates:
    """Estimates the variances of a whole record by D and M steps in turn, until λ no longer changes.

    Args:
        record: T samples, with the system matrices.

    Returns:
        The variances, the same at every sample, and the states by the last D step. The states are NaN at both ends of
        the record, where there is no complete embedding window.
    """
    data = generalized_data(record)
    statistics = SufficientStatistics.from_segments(data)
    posterior = first_posterior(generative_model(record), statistics)
    for _ in range(MAX_ITERATIONS):
        earlier_lambda = posterior.lambda_
        posterior = with_new_precisions(posterior, statistics)
        if np.abs(posterior.lambda_ - earlier_lambda).max() < CONVERGED_CHANGE:
            break
    n = len(record.A)
    # The first n rows of the D step's map give the states, the others their derivatives and the inputs.
    state_map = d_step(posterior)[:n]
    states = np.full_like(record.outputs, np.nan)
    # Row i of the data is of the window whose central sample is i + center.
    center = ORDER // 2
    has_window = slice(center, center + len(data))
    states[has_window] = data @ state_map.T
    # λ begins with the log precisions of the measurement noises.
    noise_variances = np.exp(-posterior.lambda_[:n])
    variances = np.tile(noise_variances, (len(record.outputs), 1))
    return RecursiveEstimates(variances, states)


def online_dem_variances(record: NoisyRecord) -> Array:
    """Estimates the variances from sample to sample, with exponentially decreasing weights of earlier samples.

    Args:
        record: T samples, with the system matrices.

    Returns:
        (T, n) variances after each sample.
    """
    n = len(record.A)
    data = generalized_data(record)
    model = generative_model(record)
    gram = np.zeros((data.shape[1], data.shape[1]))
    sample_count = 0.0
    posterior = first_posterior(model, SufficientStatistics(sample_count, gram))
    variances = np.tile(np.exp(-posterior.lambda_[:n]), (len(record.outputs), 1))
    # Row i of the generalized data is known when its window of ORDER + 1 samples from sample i on is complete.
    window_end = ORDER
    for index, generalized_sample in enumerate(data):
        gram = FORGETTING_FACTOR * gram + np.outer(generalized_sample, generalized_sample)
        sample_count = FORGETTING_FACTOR * sample_count + 1
        if (index + 1) % UPDATE_SAMPLES == 0:
            statistics = SufficientStatistics(sample_count, gram)
            posterior = with_new_precisions(posterior, statistics)
        variances[window_end + index] = np.exp(-posterior.lambda_[:n])
    return variances
