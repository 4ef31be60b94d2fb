"""EM: the state-space model under which the training data are most probable, by expectation and maximization."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavdem.baselines.identified import CONVERGED_NATS, Fitted, Identified, Segments, identified
from mavdem.baselines.subspace_identification import found_by_projection, innovation_gain
from mavdem.dem.engine.kalman import GaussianModel, Smoothed, smoothed
from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.record import UniformRecord, required_number

MAX_ITERATIONS = 300
START_NOISE = 0.1  # least variance of w at the start: EM converges slowly from a motion that is taken to be exact

RANK_TOLERANCE = 1e-12
"""Sums of squares of regressors below this of the largest count as zero, in whatever combination they are so small."""

LEAST_NOISE = 1e-8  # smallest variance of w and v in any direction, states and outputs being of size 1


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
    unfinished = f"The likelihood was still rising after {MAX_ITERATIONS} iterations of EM"
    return identified(f"EM({order})", train, lambda segments: _fitted(segments, order), unfinished)


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
    errors = np.concatenate([segment[1] - found.predicted(start, *segment) for start, segment in pairs])
    R = errors.T @ errors / len(errors)
    noise = K @ R @ K.T + START_NOISE * np.eye(order)
    model, likelihoods = GaussianModel(A, B, offset, C, trim, noise, R + LEAST_NOISE * np.eye(len(C))), list[float]()
    for _ in range(iterations):
        expected = [smoothed(model, start, *segment) for start, segment in zip(starts, segments, strict=True)]
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
    return float(last * last / (before - last)) if 0 <= last < before else float(np.inf if last > 0 else 0.0)


def _maximized(model: GaussianModel, expected: list[Smoothed], segments: Segments) -> GaussianModel:
    """The model under which the expected likelihood of outputs and states together is highest."""
    n, k = model.B.shape
    dynamics, observation = [], []
    for (inputs, outputs), states in zip(segments, expected, strict=True):
        ones = np.ones((len(outputs), 1))
        means, covariances = states.means, states.covariances
        regressors = np.hstack([means, inputs, ones])[:-1]
        dynamics.append(
            _ExpectedSums.of(
                regressors, means[1:], covariances[:-1].sum(0), states.lagged.sum(0), covariances[1:].sum(0)
            )
        )
        regressors = np.hstack([means, ones])
        observation.append(_ExpectedSums.of(regressors, outputs, covariances.sum(0)))
    of_states, of_outputs = _ExpectedSums.sum(dynamics), _ExpectedSums.sum(observation)
    best, seen = of_states.solution(), of_outputs.solution()
    return GaussianModel(
        A=best[:, :n],
        B=best[:, n : n + k],
        offset=best[:, -1],
        C=seen[:, :n],
        trim=seen[:, n],
        Q=of_states.covariance(best),
        R=of_outputs.covariance(seen),
    )


class _ExpectedSums(NamedTuple):
    """Expected sums of squares and products of targets y and regressors z."""

    zz: Array
    yz: Array
    yy: Array
    number: int

    @classmethod
    def of(
        cls, regressors: Array, targets: Array, states: Array, lagged: Array | float = 0.0, own: Array | float = 0.0
    ) -> _ExpectedSums:
        """From means, and the summed covariances of the states (the first regressors), with targets, and of those."""
        zz, yz, n = regressors.T @ regressors, targets.T @ regressors, len(states)
        zz[:n, :n] += states
        yz[:, :n] += lagged
        return cls(zz, yz, targets.T @ targets + own, len(targets))

    @classmethod
    def sum(cls, parts: list[_ExpectedSums]) -> _ExpectedSums:
        """That of several segments."""
        return cls(*(sum(values) for values in zip(*parts, strict=True)))

    def solution(self) -> Array:
        """The coefficients of the regression of y on z."""
        return np.asarray(self.yz @ np.linalg.pinv(self.zz, rcond=RANK_TOLERANCE, hermitian=True))

    def covariance(self, coefficients: Array) -> Array:
        """That of what they leave over, no smaller in any direction than the least noise: the likeliest such."""
        explained = coefficients @ self.yz.T
        left = (self.yy - explained - explained.T + coefficients @ self.zz @ coefficients.T) / self.number
        variances, axes = np.linalg.eigh((left + left.T) / 2)
        return np.asarray(axes * np.maximum(variances, LEAST_NOISE) @ axes.T)


def _fitted(segments: Segments, order: int) -> Fitted:
    try:
        fit = iterated(segments, order)
        A, B, offset, C, trim, Q, R = fit.model
        (n, k), m = B.shape, len(C)
        gain = innovation_gain(A, C, Q, R, np.zeros((n, m)))
    except np.linalg.LinAlgError:
        raise ValueError(
            f"EM for {order} states broke down, since covariances lost their rank or left the range of numbers: lower "
            "the order, or train on other samples"
        ) from None
    return Fitted(StateSpace(A, B, C, np.zeros((m, k)), gain, offset, np.zeros(k), trim), fit.starts, fit.converged)
