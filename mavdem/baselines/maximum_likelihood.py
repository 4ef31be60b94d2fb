"""Maximum likelihood: PEM minimises one-step prediction errors, EM makes the training data the most probable."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from mavdem.baselines.identified import (
    CONVERGED_NATS,
    LEAST_VARIANCE,
    Fitted,
    Identified,
    Segments,
    identified,
)
from mavdem.baselines.subspace_identification import found_by_projection, innovation_gain
from mavdem.dem.engine.kalman import GaussianModel, Smoothed, smoothed
from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import recursion
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.record import UniformRecord, required_number
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.forecasts import Forecasts

REWEIGHTINGS = 30  # times at most that the errors are weighted again by their own covariance
EVALUATIONS = 30  # of the errors at most, with one weighting


def pem(train: UniformRecord | Sequence[UniformRecord], order: int = 2) -> Identified:
    """The model in innovation form that makes the determinant of the one-step errors' covariance smallest.

    That is maximum likelihood where errors are Gaussian (Ljung, System Identification, 2nd ed., secs. 7.2, 10.2): all
    of A, B, C, K, the offset and the states in which segments begin, in full parametrization, by Levenberg and
    Marquardt's method on errors weighted by their covariance, iterated until it converges. The determinant never rises:
    tr(R₀⁻¹R) bounds ln det R from above and touches it at R₀. It starts from the subspace model, and stays where the
    predictor A − K C is stable. Consistent in closed loop, as far as the order is right.

    ``train``, ``order`` and errors are as for :func:`mavdem.baselines.subspace`.
    """
    order = required_number(order, "order")
    return identified(f"PEM({order})", train, lambda segments: _minimised(segments, order))


class FreeParameters(NamedTuple):
    """What is varied: all of A, B, C, K and the offset, and where segments begin.

    As a vector they follow each other in the order of these fields, rows first.
    """

    A: Array  # (n, n)
    B: Array  # (n, k)
    C: Array  # (m, n)
    K: Array  # (n, m)
    offset: Array  # (n,)
    starts: Array  # (segments, n)

    def vector(self) -> Array:
        """All of them, one after the other."""
        return np.concatenate([part.ravel() for part in self])

    def of(self, vector: Array) -> FreeParameters:
        """FreeParameters of the same shapes out of a vector."""
        cuts = np.cumsum([part.size for part in self])[:-1]
        return FreeParameters(
            *(
                values.reshape(part.shape)
                for values, part in zip(np.split(vector, cuts), self, strict=True)
            )
        )


def prediction_errors(parameters: FreeParameters, model: StateSpace, segments: Segments) -> Array:
    """(T, m): of each sample of all segments."""
    model = with_parameters(model, parameters)
    ahead = [
        model.predicted(start, *segment)
        for start, segment in zip(parameters.starts, segments, strict=True)
    ]
    return np.concatenate([outputs for _, outputs in segments]) - np.concatenate(ahead)


def with_parameters(model: StateSpace, parameters: FreeParameters) -> StateSpace:
    """The model with these parameters, which has its trims from before."""
    A, B, C, K, offset, _ = parameters
    return model._replace(A=A, B=B, C=C, K=K, offset=offset)


def sensitivities(parameters: FreeParameters, model: StateSpace, segments: Segments) -> Array:
    """(T, m, parameters): derivatives of :func:`prediction_errors`, exact.

    A small change of the state runs through the same recursion x⁺ = (A − K C) x + … as the state (Ljung, System
    Identification, 2nd ed., sec. 10.3), so every derivative is made of that recursion's responses to states, inputs, a
    constant and errors.
    """
    model = with_parameters(model, parameters)
    return np.concatenate(
        [
            _of_segment(model, parameters, number, *segment)
            for number, segment in enumerate(segments)
        ]
    )


def _of_segment(
    model: StateSpace, parameters: FreeParameters, number: int, inputs: Array, outputs: Array
) -> Array:
    A, B, C, K, *_ = parameters
    (n, k) = B.shape
    m = len(C)
    samples = len(outputs)
    states = model.filtered(parameters.starts[number], inputs, outputs)[:-1]
    errors = outputs - states @ C.T - model.direct(inputs)
    inputs = inputs - model.input_trim
    signals = np.hstack([states, inputs, np.ones((samples, 1)), errors])
    # What pulses into each state do to each predicted output.
    responses, decay = _responses(A - K @ C, C, signals)
    of_states, of_inputs, of_constant, of_errors = np.split(responses, np.cumsum([n, k, 1]), axis=3)
    of_C = -np.einsum("tmls,li->tmis", of_states, K) + np.einsum("mi,ts->tmis", np.eye(m), states)
    of_starts = np.zeros((samples, m, *parameters.starts.shape))
    of_starts[:, :, number] = decay
    parts = [of_states, of_inputs, of_C, of_errors, of_constant, of_starts]
    return -np.concatenate([part.reshape(samples, m, -1) for part in parts], axis=2)


def _responses(F: Array, C: Array, signals: Array) -> tuple[Array, Array]:
    """What C x does when one signal (T, s) pushes one state of x⁺ = F x: (T, m, n, s); and of x₀ alone: (T, m, n)."""
    still = np.zeros((len(signals) - 1, len(F)))
    units = np.eye(len(F))
    decays = np.array([np.vstack([unit, recursion(F, still, unit)]) for unit in units])
    pushed = [
        [
            np.vstack([0 * unit, recursion(F, np.outer(one, unit), 0 * unit)])
            for one in signals[:-1].T
        ]
        for unit in units
    ]
    return (np.array(pushed) @ C.T).transpose(2, 3, 0, 1), (decays @ C.T).transpose(1, 2, 0)


def _determinant(errors: Array) -> float:
    """The logarithm of that of the errors' covariance."""
    return float(np.linalg.slogdet(_covariance(errors))[1])


def _covariance(errors: Array) -> Array:
    return errors.T @ errors / len(errors) + LEAST_VARIANCE * np.eye(errors.shape[1])


def _minimised(segments: Segments, order: int) -> Fitted:
    found = found_by_projection(segments, order)
    A, B, C, _, K, offset, *_ = found.model
    best = FreeParameters(A, B, C, K, offset, found.starts)
    errors = prediction_errors(best, found.model, segments)
    for _ in range(REWEIGHTINGS):
        weight = np.linalg.cholesky(np.linalg.inv(_covariance(errors)))
        tried = _downhill(best, found.model, segments, weight)
        before = _determinant(errors)
        errors_there = prediction_errors(tried, found.model, segments)
        gained = before - _determinant(errors_there)
        if gained > 0:
            best = tried
            errors = errors_there
        if gained * len(errors) / 2 < CONVERGED_NATS:
            return Fitted(with_parameters(found.model, best), best.starts)
    return Fitted(with_parameters(found.model, best), best.starts, REWEIGHTINGS)


def _downhill(
    start: FreeParameters, model: StateSpace, segments: Segments, weight: Array
) -> FreeParameters:
    """The parameters that minimise the weighted sum of squared errors."""
    nowhere = 1e3 * (prediction_errors(start, model, segments) @ weight).ravel()

    def weighted(vector: Array) -> Array:
        parameters = start.of(vector)
        if not np.isfinite(vector).all():
            return nowhere
        if np.abs(np.linalg.eigvals(parameters.A - parameters.K @ parameters.C)).max() >= 1:
            return nowhere
        return (prediction_errors(parameters, model, segments) @ weight).ravel()

    def slopes(vector: Array) -> Array:
        changes = sensitivities(start.of(vector), model, segments)
        return (weight.T @ changes).reshape(-1, len(vector))

    # With this weight half the sum of squares, about half their number, is in nats.
    converged = 2 * CONVERGED_NATS / len(nowhere)
    found = least_squares(
        weighted, start.vector(), slopes, method="lm", ftol=converged, max_nfev=EVALUATIONS
    )
    return start.of(found.x)


MAX_ITERATIONS = 300
# least variance of w at the start: EM converges slowly from a motion that is taken to be exact
START_NOISE = 0.1

SQUARES_TOLERANCE = 1e-12
"""Sums of squares of regressors below this of the largest count as zero, in whatever combination they are so small."""

# smallest variance of w and v in any direction, states and outputs being of size 1
LEAST_NOISE = 1e-8


def em(train: UniformRecord | Sequence[UniformRecord], order: int = 2) -> Identified:
    """The model of :class:`StateSpace`'s A, B and C with independent white noises of states and outputs.

    Expectation: states are smoothed under the model there is. Maximization: A, B, offset and Q, C, trim and R, and
    the states in which segments begin are regressed on them (Shumway and Stoffer, Journal of Time Series Analysis 3(4),
    1982; with inputs Cara, Juan and Alarcón, Mechanical Systems and Signal Processing 46(2), 2014). The likelihood
    rises with every iteration from the subspace model on, to a maximum that need not be the highest. K is the steady
    Kalman gain. Consistent in closed loop, as far as order and noises are right. ``train``, ``order`` and errors are as
    for :func:`mavdem.baselines.subspace`; ``ValueError`` too where EM breaks down.
    """
    order = required_number(order, "order")
    return identified(f"EM({order})", train, lambda segments: _fitted(segments, order))


class EMFit(NamedTuple):
    """What EM came to: ``starts`` (segments, n) are means of first states; one likelihood an iteration."""

    model: GaussianModel
    starts: Array
    log_likelihoods: list[float]
    converged: bool


def iterated(segments: Segments, order: int, iterations: int = MAX_ITERATIONS) -> EMFit:
    """From the subspace model, with noise, so many ``iterations`` on, or until it has converged."""
    found, starts, _ = found_by_projection(segments, order)
    A, B, C, _, K, offset, _, trim, *_ = found
    pairs = zip(starts, segments, strict=True)
    errors = np.concatenate(
        [segment[1] - found.predicted(start, *segment) for start, segment in pairs]
    )
    R = errors.T @ errors / len(errors)
    noise = K @ R @ K.T + START_NOISE * np.eye(order)
    model = GaussianModel(A, B, offset, C, trim, noise, R + LEAST_NOISE * np.eye(len(C)))
    likelihoods = list[float]()
    for _ in range(iterations):
        expected = [
            smoothed(model, start, *segment)
            for start, segment in zip(starts, segments, strict=True)
        ]
        likelihoods.append(sum(states.log_likelihood for states in expected))
        if not np.isfinite(likelihoods[-1]):
            raise np.linalg.LinAlgError("the likelihood is not finite")
        if _left_to_gain(likelihoods) < CONVERGED_NATS:
            return EMFit(model, starts, likelihoods, True)
        model = _maximized(model, expected, segments)
        starts = np.array([states.means[0] for states in expected])
    return EMFit(model, starts, likelihoods, False)


def _left_to_gain(likelihoods: list[float]) -> float:
    """What the gains of the likelihood to come sum to, if they go on shrinking as the last two did (Aitken)."""
    if len(likelihoods) < 3:
        return np.inf
    before, last = np.diff(likelihoods[-3:])
    return (
        float(last * last / (before - last))
        if 0 <= last < before
        else float(np.inf if last > 0 else 0.0)
    )


def _maximized(model: GaussianModel, expected: list[Smoothed], segments: Segments) -> GaussianModel:
    """The model under which the expected likelihood of outputs and states together is highest."""
    n, k = model.B.shape
    dynamics = []
    observation = []
    for (inputs, outputs), states in zip(segments, expected, strict=True):
        means = states.means
        covariances = states.covariances
        ones = np.ones((len(outputs), 1))
        moved = np.hstack([means[:-1], inputs[:-1], ones[:-1], means[1:]])
        dynamics.append(moved.T @ moved)
        dynamics[-1][:n, :n] += covariances[:-1].sum(0)
        dynamics[-1][-n:, :n] += states.lagged.sum(0)
        dynamics[-1][-n:, -n:] += covariances[1:].sum(0)
        seen = np.hstack([means, ones, outputs])
        observation.append(seen.T @ seen)
        observation[-1][:n, :n] += covariances.sum(0)
    samples = sum(len(outputs) for _, outputs in segments)
    best, Q = _regressed(dynamics, n, samples - len(segments))
    trims, R = _regressed(observation, len(model.C), samples)
    return GaussianModel(
        best[:, :n], best[:, n : n + k], best[:, -1], trims[:, :n], trims[:, n], Q, R
    )


def _regressed(products: list[Array], targets: int, number: int) -> tuple[Array, Array]:
    """Coefficients of so many ``targets``, the last columns, on those before; and the covariance of what they leave.

    ``products`` are the segments' expected sums over a ``number`` of rows, of which the upper right is not used. The
    covariance is no smaller in any direction than the least noise: the likeliest such.
    """
    total = np.sum(products, axis=0)
    zz = total[:-targets, :-targets]
    yz = total[-targets:, :-targets]
    yy = total[-targets:, -targets:]
    coefficients = yz @ np.linalg.pinv(zz, rcond=SQUARES_TOLERANCE, hermitian=True)
    explained = coefficients @ yz.T
    left = (yy - explained - explained.T + coefficients @ zz @ coefficients.T) / number
    variances, axes = np.linalg.eigh((left + left.T) / 2)
    return coefficients, (axes * np.maximum(variances, LEAST_NOISE) @ axes.T)


def _fitted(segments: Segments, order: int) -> Fitted:
    try:
        fit = iterated(segments, order)
        A, B, offset, C, trim, Q, R = fit.model
        (n, k) = B.shape
        m = len(C)
        gain = innovation_gain(A, C, Q, R, np.zeros((n, m)))
    except np.linalg.LinAlgError:
        raise NotLearnable(Fact(Forecasts.EM_BROKE_DOWN, order=order)) from None
    return Fitted(
        StateSpace(A, B, C, np.zeros((m, k)), gain, offset, np.zeros(k), trim),
        fit.starts,
        None if fit.converged else len(fit.log_likelihoods),
    )
