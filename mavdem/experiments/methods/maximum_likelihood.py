"""Maximum likelihood: PEM minimises one-step prediction errors, EM makes the training data the most probable."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.gauss_newton import (
    CONVERGED_STEP_NATS,
    FINITE_DIFFERENCE_STEP,
    Damping,
    QuadraticExpansion,
    gauss_newton,
)
from mavdem.dem.engine.kalman import LinearGaussianModel, SmoothedStates, smooth_states
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.record import Segments, TrainingData
from mavdem.errors import NotLearnable
from mavdem.experiments.methods.identified import (
    DEPENDENCE_TOLERANCE,
    EM_NATS,
    RANK_TOLERANCE,
    Fitted,
    Identified,
    identified,
)
from mavdem.experiments.methods.subspace_identification import found_by_projection, innovation_gain
from mavdem.facts.forecasts import Forecasts

DAMPING = Damping(initial=1e-3, factor=8.0, max_attempts=8)
MAX_ITERATIONS = 300  # of PEM, and of EM: in a flat valley many small steps follow


def pem(train: TrainingData, order: int = 2) -> Identified:
    """Returns the model in innovation form that makes the determinant of the one-step errors' covariance smallest.

    That is maximum likelihood where errors are Gaussian (Ljung, System Identification, 2nd ed., secs. 7.2, 10.2): all
    of A, B, C, K, the offset and the states in which segments begin, in full parametrization, by Gauss-Newton steps on
    errors weighted by their covariance. The determinant never rises. It starts from the subspace model, and stays where
    the predictor A − K C is stable. Consistent in closed loop, as far as the order is right.

    ``train``, ``order`` and errors are as for :func:`mavdem.baselines.subspace`.
    """
    return identified("PEM", train, order, _minimised)


class PredictionErrors(NamedTuple):
    """The likelihood of the samples of segments, as a function of what is varied, which is one vector (f,).

    A, B, C, K, the offset and the ``starts`` (segments, n) of segments follow each other, rows first; trims are those
    of the ``model``.
    """

    model: StateSpace
    starts: Array
    segments: Segments

    @property
    def _parts(self) -> tuple[Array, ...]:
        model = self.model
        return model.A, model.B, model.C, model.K, model.offset, self.starts

    @property
    def at(self) -> Array:
        """The vector of the model and the starts."""
        return np.concatenate([part.ravel() for part in self._parts])

    def moved(self, at: Array) -> PredictionErrors:
        """Returns the same with the model and the starts of a vector."""
        cuts = np.cumsum([part.size for part in self._parts])[:-1]
        pieces = zip(np.split(at, cuts), self._parts, strict=True)
        A, B, C, K, offset, starts = (values.reshape(part.shape) for values, part in pieces)
        return self._replace(
            model=replace(self.model, A=A, B=B, C=C, K=K, offset=offset), starts=starts
        )

    def errors(self, at: Array) -> Array:
        """Returns (T, m) errors of each sample of all segments."""
        model, starts, segments = self.moved(at)
        ahead = [
            model.predicted_outputs(start, *segment)
            for start, segment in zip(starts, segments, strict=True)
        ]
        seen = np.concatenate([outputs for _, outputs in segments])
        return seen - np.concatenate(ahead)

    def value(self, at: Array) -> float:
        """Returns the log likelihood up to a constant, NaN where the predictor is not stable."""
        model = self.moved(at).model
        predictor = model.A - model.K @ model.C
        radius = abs(np.linalg.eigvals(predictor)).max()
        return _likelihood(self.errors(at)) if radius < 1 else np.nan

    def expand(self, at: Array) -> QuadraticExpansion:
        """Returns slope and Gauss-Newton curvature of the likelihood, by differences of the errors."""
        residuals = self.errors(at)
        steps = FINITE_DIFFERENCE_STEP * np.maximum(1.0, abs(at))
        beside = np.array([self.errors(at + step) for step in np.diag(steps)])
        slopes = (beside - residuals) / steps[:, None, None]
        precision = np.linalg.inv(_covariance(residuals))
        root = np.linalg.cholesky(precision)
        jacobian = (slopes @ root).reshape(len(at), -1)
        curvature = jacobian @ jacobian.T
        # The choice of states changes no error.
        floor = ROUNDING_TOLERANCE * curvature.diagonal().max()
        curvature += floor * np.eye(len(at))
        slope = -jacobian @ (residuals @ root).ravel()
        return QuadraticExpansion(at, _likelihood(residuals), slope, curvature)


def _likelihood(errors: Array) -> float:
    log_determinant = np.linalg.slogdet(_covariance(errors))[1]
    return float(-0.5 * len(errors) * log_determinant)


def _covariance(errors: Array) -> Array:
    floor = RANK_TOLERANCE**2 * np.eye(errors.shape[1])
    return errors.T @ errors / len(errors) + floor


def _minimised(segments: Segments, order: int) -> Fitted:
    projected = found_by_projection(segments, order)
    objective = PredictionErrors(projected.model, projected.starts, segments)
    start = objective.expand(objective.at)
    trace, gained = gauss_newton(objective, start, DAMPING, MAX_ITERATIONS)
    best = objective.moved(trace[-1].point)
    iterations = None if gained <= CONVERGED_STEP_NATS else len(trace) - 1
    return Fitted(best.model, best.starts, iterations)


# least variance of w at the start: EM converges slowly from a motion that is taken to be exact
START_NOISE = 0.1


def em(train: TrainingData, order: int = 2) -> Identified:
    """Returns the model of :class:`StateSpace`'s A, B and C with independent white noises of states and outputs.

    Expectation: states are smoothed under the model there is. Maximization: A, B, offset and Q, C, trim and R, and
    the states in which segments begin are regressed on them (Shumway and Stoffer, Journal of Time Series Analysis 3(4),
    1982; with inputs Cara, Juan and Alarcón, Mechanical Systems and Signal Processing 46(2), 2014). The likelihood
    rises with every iteration from the subspace model on, to a maximum that need not be the highest. K is the steady
    Kalman gain. Consistent in closed loop, as far as order and noises are right. ``train``, ``order`` and errors are as
    for :func:`mavdem.baselines.subspace`; ``ValueError`` too where EM breaks down.
    """
    return identified("EM", train, order, _fitted)


class EMFit(NamedTuple):
    """What EM came to: ``starts`` (segments, n) are means of first states; one likelihood an iteration."""

    model: LinearGaussianModel
    starts: Array
    log_likelihoods: list[float]


def iterated(segments: Segments, order: int, iterations: int = MAX_ITERATIONS) -> EMFit:
    """Iterates from the subspace model, with noise, so many ``iterations`` on, or until it has converged."""
    projected, starts, _ = found_by_projection(segments, order)
    pairs = zip(starts, segments, strict=True)
    errors = np.concatenate(
        [segment[1] - projected.predicted_outputs(start, *segment) for start, segment in pairs]
    )
    R = errors.T @ errors / len(errors)
    noise = projected.K @ R @ projected.K.T + START_NOISE * np.eye(order)
    R += ROUNDING_TOLERANCE * np.eye(len(R))
    model = LinearGaussianModel(
        projected.A, projected.B, projected.offset, projected.C, projected.output_trim, noise, R
    )
    likelihoods = []
    for _ in range(iterations):
        expected = [
            smooth_states(model, start, *segment)
            for start, segment in zip(starts, segments, strict=True)
        ]
        likelihoods.append(sum(states.log_likelihood for states in expected))
        if not np.isfinite(likelihoods[-1]):
            raise LinAlgError("the likelihood is not finite")
        if len(likelihoods) > 1 and likelihoods[-1] - likelihoods[-2] < EM_NATS:
            return EMFit(model, starts, likelihoods)
        model = _maximized(model, expected, segments)
        starts = np.array([states.means[0] for states in expected])
    return EMFit(model, starts, likelihoods)


def _maximized(
    model: LinearGaussianModel, expected: list[SmoothedStates], segments: Segments
) -> LinearGaussianModel:
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
        dynamics[-1][-n:, :n] += states.lag_one_covariances.sum(0)
        dynamics[-1][-n:, -n:] += covariances[1:].sum(0)
        seen = np.hstack([means, ones, outputs])
        observation.append(seen.T @ seen)
        observation[-1][:n, :n] += covariances.sum(0)
    samples = sum(len(outputs) for _, outputs in segments)
    best, Q = _regressed(dynamics, n, samples - len(segments))
    trims, R = _regressed(observation, len(model.C), samples)
    return LinearGaussianModel(
        best[:, :n], best[:, n : n + k], best[:, -1], trims[:, :n], trims[:, n], Q, R
    )


def _regressed(products: list[Array], targets: int, number: int) -> ArrayPair:
    """Coefficients of so many ``targets``, the last columns, on those before; and the covariance of what they leave.

    ``products`` are the segments' expected sums over a ``number`` of rows, of which the upper right is not used. The
    covariance is no smaller in any direction than ``ROUNDING_TOLERANCE``: the likeliest such, states and outputs
    being of size 1.
    """
    total = np.sum(products, axis=0)
    zz = total[:-targets, :-targets]
    yz = total[-targets:, :-targets]
    yy = total[-targets:, -targets:]
    coefficients = yz @ np.linalg.pinv(zz, rcond=DEPENDENCE_TOLERANCE**2, hermitian=True)
    explained = coefficients @ yz.T
    squared = coefficients @ zz @ coefficients.T
    left = (yy - explained - explained.T + squared) / number
    variances, axes = np.linalg.eigh((left + left.T) / 2)
    return coefficients, (axes * np.maximum(variances, ROUNDING_TOLERANCE) @ axes.T)


def _fitted(segments: Segments, order: int) -> Fitted:
    try:
        fit = iterated(segments, order)
        A, B, offset, C, trim, Q, R = fit.model
        (n, k) = B.shape
        m = len(C)
        gain = innovation_gain(A, C, Q, R, np.zeros((n, m)))
    except LinAlgError:
        raise NotLearnable(Forecasts.EM_BROKE_DOWN, order=order) from None
    return Fitted(
        StateSpace(A, B, C, np.zeros((m, k)), gain, offset, np.zeros(k), trim),
        fit.starts,
        None if len(fit.log_likelihoods) < MAX_ITERATIONS else MAX_ITERATIONS,
    )
