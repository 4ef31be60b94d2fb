"""Kalman filters with a known model: for white process noise, with noise states, and with cross-covariances.

All estimate the states x of x⁺ = Φ x + Γ v + w, y = C x + z from the outputs y, with a measurement noise z that is
white. They differ in what they assume of the process noise w:

- the Kalman filter takes it for white,
- state augmentation makes it an autoregression (AR), whose last values are further states (A. E. Bryson and D. E.
  Johansen, "Linear filtering for time-varying systems using measurements containing colored noise", IEEE Transactions
  on Automatic Control 10, 1965),
- SMIKF, the Kalman filter with second moment information, makes it an AR(1) process, and keeps the covariance of w with
  the error of the state in the place of further states.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from mavdem.arrays import SMALLEST_POSITIVE, Array
from mavdem.dem.engine.kalman import KalmanFilter
from mavdem.dem.engine.linalg import may_overflow


class DiscreteModel(NamedTuple):
    """The linear model x⁺ = Φ x + Γ v + w, y = C x + z, with white noises."""

    Phi: Array
    """(n, n) state transition matrix."""

    Gamma: Array
    """(n, r) input matrix."""

    C: Array
    """(m, n) output matrix."""

    Q: Array
    """(n, n) covariance of the process noise w."""

    R: Array
    """(m, m) covariance of the measurement noise z."""


class Autoregression(NamedTuple):
    """An autoregressive process w_t = Σ a_j w_{t−j} + e_t."""

    coefficients: Array
    """(order,) a₁ … a_order."""

    variance: float
    """Variance of e."""


def fit_autoregression(series: Array, order: int) -> Autoregression:
    """Fits an autoregression by Burg's method (S. M. Kay, Modern Spectral Estimation, 1988, sec. 7.6).

    Its models are always stable. Bos et al. use MATLAB's ``ar``, the modified covariance method, whose models need not
    be; on the flights the errors of the observers agree to 0.2 %. The mean of the series is not subtracted.

    Args:
        series: (T,) values.
        order: number of coefficients.

    Returns:
        (order,) coefficients, and the variance of the prediction error.
    """
    forward_errors = series[1:]
    backward_errors = series[:-1]
    coefficients = np.zeros(0)
    variance = float(np.mean(series**2))
    for _ in range(order):
        power = float(forward_errors @ forward_errors + backward_errors @ backward_errors)
        # A series that is zero has no error to predict.
        correlation = 2 * float(forward_errors @ backward_errors)
        reflection = correlation / max(power, SMALLEST_POSITIVE)
        coefficients = np.append(coefficients - reflection * coefficients[::-1], reflection)
        variance *= 1 - reflection**2
        next_forward_errors = forward_errors - reflection * backward_errors
        next_backward_errors = backward_errors - reflection * forward_errors
        forward_errors = next_forward_errors[1:]
        backward_errors = next_backward_errors[:-1]
    return Autoregression(coefficients, variance)


def with_noise_states(model: DiscreteModel, noise: Array, order: int) -> DiscreteModel:
    """Extends a model by the last values of its autoregressive process noise as further states.

    The states are [x; w_t; w_{t−1}; …]. Each component of w has an autoregression of its own.

    Args:
        model: the model; its Q is replaced.
        noise: (T, n) process noise, to which the autoregressions are fitted.
        order: order of the autoregressions.

    Returns:
        The extended model, whose noise is white.
    """
    n, r = model.Gamma.shape
    fits = [fit_autoregression(series, order) for series in noise.T]
    noise_count = order * n
    # Rows and columns: n states x, then n values of w_t, and n of each of its earlier values.
    latest_noise = slice(n, 2 * n)
    Phi = np.zeros((n + noise_count, n + noise_count))
    # The next state is Φ x + w_t.
    Phi[:n, :n] = model.Phi
    Phi[:n, latest_noise] = np.eye(n)
    # The next noise is the autoregression of the earlier ones, with white noise of covariance Q.
    for lag in range(order):
        columns = slice(n + lag * n, n + (lag + 1) * n)
        Phi[latest_noise, columns] = np.diag([fit.coefficients[lag] for fit in fits])
    Q = np.zeros_like(Phi)
    Q[latest_noise, latest_noise] = np.diag([fit.variance for fit in fits])
    # All other values of the noise belong to one sample before.
    Phi[2 * n :, n:-n] = np.eye(noise_count - n)
    return DiscreteModel(
        Phi,
        Gamma=np.vstack([model.Gamma, np.zeros((noise_count, r))]),
        C=np.hstack([model.C, np.zeros((len(model.C), noise_count))]),
        Q=Q,
        R=model.R,
    )


def with_past_states(model: DiscreteModel, kept_states: int, lag: int) -> DiscreteModel:
    """Adds past values of some states to a model as further states: a delay line of ``lag`` samples.

    The Kalman filter of this model is a fixed-lag smoother of these states: it corrects their past values, too. With
    the states x of the model, of which the first ones, s, are kept, the new states are [x; s_{t−1}; …; s_{t−lag}].

    Args:
        model: the discrete-time linear model, with the covariances of its noises.
        kept_states: number of the first states whose past values are kept.
        lag: number of samples for which they are kept.

    Returns:
        The extended model.
    """
    n, r = model.Gamma.shape
    past_count = kept_states * lag
    Phi = block_diag(model.Phi, np.zeros((past_count, past_count)))
    # In each step s becomes s_{t−1}, which has the first rows of the past.
    latest_past = slice(n, n + kept_states)
    Phi[latest_past, :kept_states] = np.eye(kept_states)
    # Every past value but the oldest becomes the one of a sample earlier.
    moved_count = past_count - kept_states
    earlier_past = slice(n + kept_states, n + past_count)
    Phi[earlier_past, n : n + moved_count] = np.eye(moved_count)
    # Past values have no inputs and no noise, and are not measured.
    return DiscreteModel(
        Phi,
        Gamma=np.vstack([model.Gamma, np.zeros((past_count, r))]),
        C=np.hstack([model.C, np.zeros((len(model.C), past_count))]),
        Q=block_diag(model.Q, np.zeros((past_count, past_count))),
        R=model.R,
    )


@may_overflow
def kalman_states(model: DiscreteModel, outputs: Array, inputs: Array) -> Array:
    """Estimates the states from each sample's output and all earlier ones, by the Kalman filter.

    The filter starts from state 0 with the identity as its covariance, as in the scripts of Bos et al.

    Args:
        model: the discrete-time linear model, with the covariances of its noises.
        outputs: (T, m) measured outputs.
        inputs: (T, r) inputs.

    Returns:
        (T, n) states.
    """
    n = len(model.Phi)
    m = len(model.C)
    uncorrelated_noises = np.zeros((n, m))
    kalman_filter = KalmanFilter.design(
        model.Phi,
        model.C,
        model.Q,
        model.R,
        uncorrelated_noises,
        initial_covariance=np.eye(n),
        samples=len(outputs),
    )
    predicted_states, innovations = kalman_filter.filter(
        np.zeros(n), inputs @ model.Gamma.T, outputs
    )
    # The filter predicts each state from earlier samples. The sample itself corrects it with the gain P Cᵀ F⁻¹.
    covariances = kalman_filter.covariances[: len(kalman_filter.gains)]
    correction_gains = covariances @ model.C.T @ kalman_filter.innovation_precisions
    # Index of the gain of each sample among the filter's gains, of which the last one is used once it is steady.
    gain_of_sample = kalman_filter.gain_rows(len(outputs))
    # Letters of einsum: sample t, state n, output m.
    corrections = np.einsum("tnm,tm->tn", correction_gains[gain_of_sample], innovations)
    # The last predicted state belongs to the sample after the last one.
    return predicted_states[:-1] + corrections


def fixed_lag_states(
    model: DiscreteModel, kept_states: int, lag: int, outputs: Array, inputs: Array
) -> Array:
    """Estimates the first states of each sample from all outputs up to ``lag`` samples later: a fixed-lag smoother.

    It is compared with DEM, whose estimates also use later samples: derivatives are taken in the middle of a window.

    Args:
        model: the discrete-time linear model, with the covariances of its noises.
        kept_states: number of the first states that are estimated.
        lag: samples after each one that its estimate uses.
        outputs: (T, m) measured outputs.
        inputs: (T, r) inputs.

    Returns:
        (T, kept_states) states; NaN at the last ``lag`` samples.
    """
    model_with_past = with_past_states(model, kept_states, lag)
    states_with_past = kalman_states(model_with_past, outputs, inputs)
    # The last of these states belong to ``lag`` samples before; the last samples have no estimate.
    delayed_states = states_with_past[:, -kept_states:]
    states = np.full((len(outputs), kept_states), np.nan)
    states[:-lag] = delayed_states[lag:]
    return states


@may_overflow
def smikf_states(
    model: DiscreteModel, noise: Array, outputs: Array, inputs: Array, *, accumulates: bool = True
) -> Array:
    """Estimates the states by SMIKF, the Kalman filter with second moment information.

    The noise is w⁺ = D w + e. Its covariance with the error of the corrected state, P_xw, adds to the covariance of the
    prediction, P⁻ = Φ P Φᵀ + Φ P_xw + P_xwᵀ Φᵀ + P_ww, and is itself carried on as (I − K C)(Φ P_xw + P_ww) Dᵀ.

    Args:
        model: the model; its Q is replaced.
        noise: (T, n) process noise, to which AR(1) processes are fitted.
        outputs: (T, m) measured outputs.
        inputs: (T, r) inputs.
        accumulates: whether P_xw contains the term Φ P_xw of earlier samples. The scripts of Bos et al. leave it out.

    Returns:
        (T, n) states.
    """
    n = len(model.Phi)
    identity = np.eye(n)
    fits = [fit_autoregression(series, 1) for series in noise.T]
    D = np.diag([fit.coefficients[0] for fit in fits])
    innovation_covariance = np.diag([fit.variance for fit in fits])
    noise_covariance = innovation_covariance.copy()
    state = np.zeros(n)
    covariance = np.eye(n)
    cross_covariance = np.zeros((n, n))
    states = np.zeros((len(outputs), n))
    for t in range(1, len(outputs)):
        # Covariance of the noise with the part of the predicted state's error that earlier noise causes.
        propagated_cross_covariance = model.Phi @ cross_covariance
        predicted_covariance = (
            model.Phi @ covariance @ model.Phi.T
            + propagated_cross_covariance
            + propagated_cross_covariance.T
            + noise_covariance
        )
        F = model.C @ predicted_covariance @ model.C.T + model.R
        gain = predicted_covariance @ model.C.T @ np.linalg.inv(F)
        predicted_state = model.Phi @ state + model.Gamma @ inputs[t - 1]
        state = predicted_state + gain @ (outputs[t] - model.C @ predicted_state)
        I_minus_KC = identity - gain @ model.C
        covariance = I_minus_KC @ predicted_covariance
        predicted_cross_covariance = noise_covariance
        if accumulates:
            predicted_cross_covariance = noise_covariance + propagated_cross_covariance
        # The next noise is D w + e.
        cross_covariance = I_minus_KC @ predicted_cross_covariance @ D.T
        noise_covariance = D @ noise_covariance @ D.T + innovation_covariance
        states[t] = state
    return states
