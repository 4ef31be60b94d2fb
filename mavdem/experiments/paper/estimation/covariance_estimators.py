"""Standard estimators of measurement noise variances, which assume white process and measurement noise.

J. Duník, O. Straka, O. Kost and J. Havlík, "Noise covariance matrices in state-space models: A survey and comparison of
estimation methods", International Journal of Adaptive Control and Signal Processing 31, 2017, has all but one of them.
Each takes a :class:`NoisyRecord`, and uses its model and the variances of its process noise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from mavdem.arrays import Array
from mavdem.dem.engine.kalman import LinearGaussianModel, smooth_states, steady_state_gain
from mavdem.experiments.paper.estimation.noisy_records import NoisyRecord

FIRST_LOG_PRECISION = 10.0
"""Log precision λ of the measurement noise from which every estimator starts, as in the code that the authors publish.

The true ones are 4 to 8.
"""

SMALLEST_VARIANCE = 1e-10
"""Floor of estimated variances: some estimators subtract, and may end below zero."""

CORRELATION_LAGS = 10
"""Number of lags of the autocovariances that :func:`innovation_correlation` uses; a choice."""

EM_ITERATIONS = 30
"""Iterations of the EM algorithm; its variances change by less than 1 % afterwards."""

FORGETTING_FACTOR = 0.98
"""Factor by which the weight of earlier samples decreases at each new sample, in recursive estimators; a choice.

It makes a memory of 1 / (1 − 0.98) = 50 samples.
"""

VB_ITERATIONS = 2
"""Iterations of the variational filter at each sample, as in the code that the authors publish."""


class RecursiveEstimates(NamedTuple):
    """Estimates of an estimator that goes from sample to sample."""

    variances: Array
    """(T, n) variances of the measurement noise, after each sample."""

    states: Array
    """(T, n) states, after each sample."""


def first_variances(record: NoisyRecord) -> Array:
    """Returns the variances (n,) of the measurement noise from which every estimator starts."""
    return np.full(len(record.process_variances), np.exp(-FIRST_LOG_PRECISION))


def innovation_correlation(record: NoisyRecord) -> Array:
    """Estimates the variances from the autocovariances of a filter's innovations, by least squares (ALS).

    A filter with a fixed gain K predicts the outputs. With its prediction error ε⁺ = L ε + w − K z, L = Φ − K, and the
    innovation e = ε + z, the autocovariances of e are linear in the variances: P + R at lag 0, and Lʲ P − Lʲ⁻¹ K R at
    lag j, where P is the covariance of ε and R the covariance of z. R is fitted to the measured ones.

    B. J. Odelson, M. R. Rajamani and J. B. Rawlings, "A new autocovariance least-squares method for estimating noise
    covariances", Automatica 42, 2006.

    Args:
        record: T samples, with the model and the variances of the process noise.

    Returns:
        (n,) variances of the measurement noise.
    """
    Phi, Gamma = record.transition
    n = len(Phi)
    Q = np.diag(record.process_variances)
    # The method needs any gain that makes the filter stable. This one is optimal if both noises are equally large.
    K = steady_state_gain(Phi, np.eye(n), Q, Q).gain
    L = Phi - K
    state = record.outputs[0]
    innovations = np.zeros_like(record.outputs)
    for t, output in enumerate(record.outputs):
        innovations[t] = output - state
        state = Phi @ state + Gamma @ record.inputs[t] + K @ innovations[t]
    measured_autocovariances = _autocovariances(innovations, CORRELATION_LAGS)
    # What the process noise explains is subtracted, and the variances of the measurement noise fit the rest.
    no_noise = np.zeros((n, n))
    autocovariances_by_process_noise = _innovation_autocovariances(L, K, Q, no_noise)
    effects_of_unit_variances = [
        _innovation_autocovariances(L, K, no_noise, R) for R in _unit_covariances(n)
    ]
    scales = np.sqrt(measured_autocovariances[0].diagonal())
    return _least_squares_variances(
        measured_autocovariances - autocovariances_by_process_noise,
        scales,
        effects_of_unit_variances,
    )


def _innovation_autocovariances(L: Array, K: Array, Q: Array, R: Array) -> Array:
    """Computes the autocovariances of the innovations of a filter with a fixed gain, for given white noises.

    Args:
        L: (n, n) transition Φ − K of the filter's prediction error.
        K: (n, n) gain of the filter; all n states are measured.
        Q: (n, n) covariance of the process noise.
        R: (n, n) covariance of the measurement noise.

    Returns:
        (``CORRELATION_LAGS``, n, n) autocovariances from lag 0 on.
    """
    # The prediction error e⁺ = L e + w − K z has the covariance P, and the innovation is e + z. It is correlated with
    # later ones by e, and by z, which enters the next prediction through the gain.
    P = solve_discrete_lyapunov(L, Q + K @ R @ K.T)
    autocovariances = [P + R]
    autocovariance = L @ P - K @ R
    for _ in range(CORRELATION_LAGS - 1):
        autocovariances.append(autocovariance)
        autocovariance = L @ autocovariance
    return np.array(autocovariances)


def measurement_difference(record: NoisyRecord) -> Array:
    """Estimates the variances from the difference between each measurement and its prediction from the one before.

    As all states are measured, no filter is needed: the differences are y⁺ − Φ y − Γ v = w + z⁺ − Φ z. Their
    autocovariance is Q + R + Φ R Φᵀ at lag 0 and −Φ R at lag 1, which is linear in the variances R.

    J. Duník, O. Kost and O. Straka, "Design of measurement difference autocovariance method for estimation of process
    and measurement noise covariances", Automatica 90, 2018.

    Args:
        record: T samples, with the model and the variances of the process noise.

    Returns:
        (n,) variances.
    """
    Phi, Gamma = record.transition
    n = len(Phi)
    differences = record.outputs[1:] - record.outputs[:-1] @ Phi.T - record.inputs[:-1] @ Gamma.T
    measured_autocovariances = _autocovariances(differences, lags=2)
    scales = np.sqrt(measured_autocovariances[0].diagonal())
    measured_autocovariances[0] -= np.diag(record.process_variances)
    effects_of_unit_variances = [
        np.array([R + Phi @ R @ Phi.T, -Phi @ R]) for R in _unit_covariances(n)
    ]
    return _least_squares_variances(measured_autocovariances, scales, effects_of_unit_variances)


def _unit_covariances(n: int) -> list[Array]:
    """Returns n covariances (n, n) of a noise that only one of the outputs has, with variance 1."""
    return [np.diag(row) for row in np.eye(n)]


def _autocovariances(series: Array, lags: int) -> Array:
    """Returns the autocovariances (lags, n, n), E sₜ₊ⱼ sₜᵀ, of series (T, n)."""
    count = len(series)
    return np.array([series[lag:].T @ series[: count - lag] / count for lag in range(lags)])


def _least_squares_variances(
    measured_autocovariances: Array, scales: Array, effects: list[Array]
) -> Array:
    """Returns the variances whose effects add up to the measured autocovariances, by least squares.

    Args:
        measured_autocovariances: (lags, n, n) autocovariances.
        scales: (n,) standard deviations of the series. Each difference of autocovariances is divided by those of its
            two series, so that series of different units count alike.
        effects: for each of the n variances the autocovariances (lags, n, n) that it causes if it is 1.

    Returns:
        The variances (n,).
    """
    weights = 1 / np.outer(scales, scales)
    columns = np.stack([(weights * effect).ravel() for effect in effects], axis=1)
    # The columns are scaled to length 1, since variances of several units differ by orders of magnitude.
    lengths = np.linalg.norm(columns, axis=0)
    targets = (weights * measured_autocovariances).ravel()
    scaled_variances = np.linalg.lstsq(columns / lengths, targets, rcond=None)[0]
    variances = scaled_variances / lengths
    return np.maximum(variances, SMALLEST_VARIANCE)


def expectation_maximization(record: NoisyRecord) -> Array:
    """Estimates the variances by maximum likelihood, with the EM algorithm.

    The E step smooths the states with the latest variances; the M step sets the variances to the expected squares of
    the measurement errors.

    R. H. Shumway and D. S. Stoffer, "An approach to time series smoothing and forecasting using the EM algorithm",
    Journal of Time Series Analysis 3(4), 1982.

    Args:
        record: T samples, with the model and the variances of the process noise.

    Returns:
        (n,) variances.
    """
    Phi, Gamma = record.transition
    n = len(Phi)
    variances = first_variances(record)
    for _ in range(EM_ITERATIONS):
        model = LinearGaussianModel(
            A=Phi,
            B=Gamma,
            offset=np.zeros(n),
            C=np.eye(n),
            trim=np.zeros(n),
            Q=np.diag(record.process_variances),
            R=np.diag(variances),
        )
        smoothed_states = smooth_states(model, record.outputs[0], record.inputs, record.outputs)
        residuals = record.outputs - smoothed_states.means
        state_variances = smoothed_states.covariances.diagonal(axis1=1, axis2=2)
        variances = np.maximum((residuals**2 + state_variances).mean(axis=0), SMALLEST_VARIANCE)
    return variances


class FilterStep(NamedTuple):
    """Prediction of a Kalman filter for one sample."""

    state: Array
    """(n,) predicted state."""

    covariance: Array
    """(n, n) covariance of the predicted state."""


def corrected_step(prediction: FilterStep, output: Array, variances: Array) -> FilterStep:
    """Corrects a Kalman filter's prediction with a sample, in which all states are measured.

    Args:
        prediction: the prediction for the sample.
        output: (n,) measured states.
        variances: (n,) variances of the measurement noise.

    Returns:
        State and covariance after the sample.
    """
    # The measurement is the state itself plus noise, so that the output matrix of the usual formulas is the identity.
    P = prediction.covariance
    innovation_covariance = P + np.diag(variances)
    gain = P @ np.linalg.inv(innovation_covariance)
    innovation = output - prediction.state
    return FilterStep(prediction.state + gain @ innovation, P - gain @ P)


def predicted_step(record: NoisyRecord, filter_step: FilterStep, t: int) -> FilterStep:
    """Predicts state and covariance of a Kalman filter for the sample after t.

    Args:
        record: the record, with its model and inputs.
        filter_step: state and covariance of sample t, after its correction.
        t: number of the sample.

    Returns:
        Predicted state and covariance.
    """
    Phi, Gamma = record.transition
    state = Phi @ filter_step.state + Gamma @ record.inputs[t]
    covariance = Phi @ filter_step.covariance @ Phi.T + np.diag(record.process_variances)
    return FilterStep(state, covariance)


def _first_prediction(record: NoisyRecord) -> FilterStep:
    """Returns the prediction for the first sample: its output, with the identity as covariance."""
    return FilterStep(record.outputs[0], np.eye(len(record.process_variances)))


def kalman_states_with_variances(record: NoisyRecord, variances: Array) -> Array:
    """Estimates the states by a Kalman filter with given variances of the measurement noise.

    Args:
        record: T samples, with the model and the variances of the process noise.
        variances: (n,) variances of the measurement noise.

    Returns:
        (T, n) states.
    """
    step = _first_prediction(record)
    states = np.zeros_like(record.outputs)
    for t, output in enumerate(record.outputs):
        step = corrected_step(step, output, variances)
        states[t] = step.state
        step = predicted_step(record, step, t)
    return states


def covariance_matching(record: NoisyRecord) -> RecursiveEstimates:
    """Estimates the variances by covariance matching: innovations must have the covariance that the filter computes.

    The variance of the measurement noise is the mean square of the innovations less the variance of the prediction.
    Both are means with exponentially decreasing weights; the authors take means over a window.

    K. A. Myers and B. D. Tapley, "Adaptive sequential estimation with unknown noise statistics", IEEE Transactions on
    Automatic Control 21, 1976.

    Args:
        record: T samples, with the model and the variances of the process noise.

    Returns:
        Variances (T, n) and states (T, n) at each sample.
    """
    step = _first_prediction(record)
    variances = first_variances(record)
    innovation_power = variances.copy()
    prediction_variance = np.zeros_like(variances)
    variance_history = np.zeros_like(record.outputs)
    states = np.zeros_like(record.outputs)
    new_weight = 1 - FORGETTING_FACTOR
    for t, output in enumerate(record.outputs):
        innovation = output - step.state
        # The first prediction is the first output itself, with an arbitrary covariance: its innovation has no
        # information.
        if t > 0:
            innovation_power = FORGETTING_FACTOR * innovation_power + new_weight * innovation**2
            prediction_variance = (
                FORGETTING_FACTOR * prediction_variance + new_weight * step.covariance.diagonal()
            )
            variances = np.maximum(innovation_power - prediction_variance, SMALLEST_VARIANCE)
        step = corrected_step(step, output, variances)
        variance_history[t] = variances
        states[t] = step.state
        step = predicted_step(record, step, t)
    return RecursiveEstimates(variance_history, states)


def sage_husa(record: NoisyRecord) -> RecursiveEstimates:
    """Estimates the variances by Sage and Husa's recursion with fading memory, from the residuals after correction.

    The variance of the measurement noise is the weighted mean of the squared residuals plus the variance of the
    corrected state. In this form, with residuals and not innovations, variances stay positive.

    A. P. Sage and G. W. Husa, "Adaptive filtering with unknown prior statistics", Joint Automatic Control Conference,
    1969.

    Args:
        record: T samples, with the model and the variances of the process noise.

    Returns:
        Variances (T, n) and states (T, n) at each sample.
    """
    step = _first_prediction(record)
    variances = first_variances(record)
    variance_history = np.zeros_like(record.outputs)
    states = np.zeros_like(record.outputs)
    for t, output in enumerate(record.outputs):
        step = corrected_step(step, output, variances)
        residual_power = (output - step.state) ** 2 + step.covariance.diagonal()
        # The weights of the first variances and of t + 1 samples are a geometric series, normalised to a sum of 1.
        new_weight = (1 - FORGETTING_FACTOR) / (1 - FORGETTING_FACTOR ** (t + 2))
        variances = (1 - new_weight) * variances + new_weight * residual_power
        variance_history[t] = variances
        states[t] = step.state
        step = predicted_step(record, step, t)
    return RecursiveEstimates(variance_history, states)


def variational_bayes(record: NoisyRecord) -> RecursiveEstimates:
    """Estimates the variances together with the state, by variational Bayes.

    Each variance has an inverse gamma distribution, whose shape α and scale β decrease by ``FORGETTING_FACTOR`` from
    sample to sample, so that new samples count more than old ones. With each sample, α grows by ½, and β by half of the
    expected squared error of measurement. That error depends on the variance β / α itself, so that β is computed by
    ``VB_ITERATIONS`` of a fixed-point iteration.

    S. Särkkä and A. Nummenmaa, "Recursive noise adaptive Kalman filtering by variational Bayesian approximations", IEEE
    Transactions on Automatic Control 54(3), 2009.

    Args:
        record: T samples, with the model and the variances of the process noise.

    Returns:
        Variances (T, n) and states (T, n) at each sample.
    """
    prediction = _first_prediction(record)
    shape = np.ones(len(record.process_variances))
    scale = first_variances(record)
    variances = np.zeros_like(record.outputs)
    states = np.zeros_like(record.outputs)
    for t, output in enumerate(record.outputs):
        shape = shape + 0.5
        new_scale = scale
        correction = prediction
        for _ in range(VB_ITERATIONS):
            correction = corrected_step(prediction, output, new_scale / shape)
            residual = output - correction.state
            expected_squared_error = residual**2 + correction.covariance.diagonal()
            new_scale = scale + 0.5 * expected_squared_error
        variances[t] = new_scale / shape
        states[t] = correction.state
        prediction = predicted_step(record, correction, t)
        shape = FORGETTING_FACTOR * shape
        scale = FORGETTING_FACTOR * new_scale
    return RecursiveEstimates(variances, states)
