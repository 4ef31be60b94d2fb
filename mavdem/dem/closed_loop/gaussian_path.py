"""Gaussian paths: what a joint autoregression predicts with unknown inputs, and infers where inputs are measured.

Three questions about the outputs y (the first m channels) after a known past: the inputs unknown; the inputs measured
up to the sample itself; all inputs measured. Given the parameters the answers are Gaussian and exact, and their
variance does not depend on the samples. The uncertainty of the parameters is not in it.

Inputs are measured without noise, so that all that is uncertain at a sample are the outputs before it since the past
ended: the state x of the filter and of the smoother, which have m · lags states. Both are in the form for noise of
measurement and process that are correlated (Durbin and Koopman, Time Series Analysis by State Space Methods, 2nd ed.,
secs. 4.3 and 4.4). It inverts no covariance of states, which may be singular.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.dem.closed_loop.autoregression import Autoregression
from mavdem.dem.engine.linalg import Array, inverse

INPUT_NOISE = 1e-9
"""Variance added to the innovations of inputs: one that is constant, or depends on others, has none of its own."""

STEADY_TOLERANCE = 1e-11  # change of a covariance in a step, relative to its largest entry, that no longer counts


class GaussianPath(NamedTuple):
    """Mean and variance of each sample, (…, H, m) each, in the model's units.

    Where a mean overflows it is 0, the mean of the training data, with infinite variance.
    """

    mean: Array
    variance: Array


def past_of(channels: Array, lags: int) -> Array:
    """(lags, k) the last samples of ``channels`` (T, k); where there are fewer the first counts for those before it."""
    if len(channels) >= lags:
        return channels[len(channels) - lags :]
    filled = np.zeros((lags, channels.shape[1]))
    if len(channels):
        filled[:] = channels[0]
        filled[lags - len(channels) :] = channels
    return filled


def predicted(model: Autoregression, past: Array, steps: int) -> GaussianPath:
    """All channels (…, steps, k) after ``past`` (…, lags, k), outputs first: nothing is known of that time.

    The ``past`` ends with the latest sample; leading axes are separate pasts, all answered at once.
    """
    k, across = model.channels, model.across
    # Rows of Ψ, the response of a sample to each innovation before it.
    response = np.eye(model.lags * k, k)
    variance = np.empty((steps, k))
    with np.errstate(over="ignore", invalid="ignore"):
        for step in range(steps):
            own = response[:k]
            variance[step] = np.einsum("ij,jl,il->i", own, model.covariance, own)
            response = np.concatenate([across @ response, response[:-k]])
        return _path(predicted_mean(model, past, steps), variance.cumsum(axis=0))


def predicted_mean(model: Autoregression, past: Array, steps: int) -> Array:
    """The mean of :func:`predicted` (…, steps, k), which may overflow to infinity or NaN."""
    k, lags, across = model.channels, model.lags, model.across.T.copy()
    # All samples in one array, the latest first, so that the lags of each step are a slice of it.
    samples = np.empty((*past.shape[:-2], (steps + lags) * k))
    samples[..., steps * k :] = _latest_first(past)
    with np.errstate(over="ignore", invalid="ignore"):
        for start in range((steps - 1) * k, -1, -k):
            samples[..., start : start + k] = samples[..., start + k : start + (lags + 1) * k] @ across + model.offset
    return samples[..., : steps * k].reshape(*past.shape[:-2], steps, k)[..., ::-1, :]


def filtered(model: Autoregression, past: Array, inputs: Array) -> GaussianPath:
    """Outputs (…, H, m) after ``past`` (…, lags, k), each given the ``inputs`` (…, H, r) up to its own sample."""
    loop = _Loop.of(model, inputs.shape[-1])
    covariances, gains, _ = loop.covariances(inputs.shape[-2])
    states, _ = loop.states(past, inputs, gains)
    variance = np.diagonal(covariances[1:], axis1=1, axis2=2)[:, : loop.outputs]
    return _path(states[..., 1:, : loop.outputs], variance)


def smoothed(model: Autoregression, past: Array, inputs: Array) -> GaussianPath:
    """Outputs (…, H, m) after ``past`` (…, lags, k), each given all ``inputs`` (…, H, r).

    References:
        P. de Jong, "Smoothing and interpolation with the state-space model", Journal of the American Statistical
        Association 84(408), 1989.
    """
    loop = _Loop.of(model, inputs.shape[-1])
    m, steps = loop.outputs, inputs.shape[-2]
    covariances, gains, weights = loop.covariances(steps)
    states, errors = loop.states(past, inputs, gains)
    mean, variance = np.empty((*past.shape[:-2], steps, m)), np.empty((steps, m))
    pull, information = np.zeros_like(states[..., 0, :]), np.zeros_like(covariances[0])
    with np.errstate(over="ignore", invalid="ignore"):
        for step in reversed(range(steps)):
            P = covariances[step + 1]
            mean[..., step, :] = states[..., step + 1, :m] + pull @ P[:, :m]
            variance[step] = np.diagonal(P - P @ information @ P)[:m]
            kept = loop.step - gains[step] @ loop.seen
            seen = loop.seen.T @ weights[step]
            pull = errors[..., step, :] @ seen.T + pull @ kept
            information = seen @ loop.seen + kept.T @ information @ kept
    return _path(mean, np.maximum(variance, 0.0))


class _Loop(NamedTuple):
    """The model with x, the outputs of all lags, as its state: x⁺ = step x + … + w, inputs = seen x + … + v.

    What the inputs of the lags add is known and comes on top. The first m of w, and v, are the innovations.
    """

    outputs: int
    step: Array  # (n, n), n = m · lags
    seen: Array  # (r, n)
    of_inputs: Array  # (k, r · lags) effect of the lagged inputs on the next outputs and inputs
    offset: Array  # (k,)
    covariance: Array  # (k, k), with the noise of the inputs

    @classmethod
    def of(cls, model: Autoregression, inputs: int) -> _Loop:
        lags, k, _ = model.coefficients.shape
        m = k - inputs
        across = model.coefficients.swapaxes(0, 1)
        of_outputs = across[:, :, :m].reshape(k, lags * m)
        step = np.eye(lags * m, k=-m)
        step[:m] = of_outputs[:m]
        covariance = model.covariance.copy()
        covariance[m:, m:] += INPUT_NOISE * np.eye(inputs)
        return cls(m, step, of_outputs[m:], across[:, :, m:].reshape(k, lags * inputs), model.offset, covariance)

    def covariances(self, steps: int) -> tuple[Array, Array, Array]:
        """P (H + 1, n, n) of x before each step and after the last, gain (H, n, r), and weight S⁻¹ (H, r, r).

        From the step on where P is steady all are the same.
        """
        m, (r, n) = self.outputs, self.seen.shape
        crossed = np.zeros((n, r))
        crossed[:m] = self.covariance[:m, m:]
        of_outputs, of_inputs = self.covariance[:m, :m], self.covariance[m:, m:]
        P, gains, weights = np.zeros((steps + 1, n, n)), np.zeros((steps, n, r)), np.zeros((steps, r, r))
        with np.errstate(over="ignore", invalid="ignore"):
            for step in range(steps):
                before = P[step]
                spread = self.seen @ before @ self.seen.T + of_inputs
                try:
                    weights[step] = inverse(spread)
                except np.linalg.LinAlgError:
                    P[step + 1 :] = np.inf
                    break
                gains[step] = gain = (self.step @ before @ self.seen.T + crossed) @ weights[step]
                kept = self.step - gain @ self.seen
                # In Joseph's form it stays positive.
                after = kept @ before @ kept.T + gain @ of_inputs @ gain.T
                mixed = gain @ crossed.T
                after -= mixed + mixed.T
                after[:m, :m] += of_outputs
                P[step + 1] = (after + after.T) / 2
                if np.abs(P[step + 1] - before).max() <= STEADY_TOLERANCE * np.abs(before).max():
                    P[step + 2 :], gains[step + 1 :], weights[step + 1 :] = P[step + 1], gain, weights[step]
                    break
        return P, gains, weights

    def states(self, past: Array, inputs: Array, gains: Array) -> tuple[Array, Array]:
        """X (…, H + 1, n) before each step and after the last, and the errors (…, H, r) of predicting the inputs."""
        m, steps, n = self.outputs, inputs.shape[-2], len(self.step)
        lags = n // m
        known = np.concatenate([past[..., m:], inputs], axis=-2)
        lagged = [known[..., lags - lag : lags - lag + steps, :] for lag in range(1, lags + 1)]
        drives = np.concatenate(lagged, axis=-1) @ self.of_inputs.T + self.offset
        states, errors = np.zeros((*past.shape[:-2], steps + 1, n)), inputs - drives[..., m:]
        states[..., 0, :] = _latest_first(past[..., :m])
        with np.errstate(over="ignore", invalid="ignore"):
            for step in range(steps):
                x = states[..., step, :]
                errors[..., step, :] -= x @ self.seen.T
                states[..., step + 1, :] = x @ self.step.T + errors[..., step, :] @ gains[step].T
                states[..., step + 1, :m] += drives[..., step, :m]
        return states, errors


def _latest_first(past: Array) -> Array:
    """(…, lags · k) of (…, lags, k)."""
    return past[..., ::-1, :].reshape(*past.shape[:-2], past.shape[-2] * past.shape[-1])


def _path(mean: Array, variance: Array) -> GaussianPath:
    finite = np.isfinite(mean)
    known = finite & np.isfinite(variance)
    return GaussianPath(np.where(finite, mean, 0.0), np.where(known, variance, np.inf))
