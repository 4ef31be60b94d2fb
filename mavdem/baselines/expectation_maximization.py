"""EM: the state-space model under which the training data are most probable, by expectation and maximization."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from mavdem.baselines.identified import NOT_THE_BEST, Fitted, Identified, Segments, identified, required_order
from mavdem.baselines.subspace_identification import found_by_projection, innovation_gain
from mavdem.dem.engine.kalman import GaussianModel, Smoothed, smoothed
from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.record import UniformRecord

STARTS = 4  # the subspace model, and others at random
TRIAL_ITERATIONS, MAX_ITERATIONS = 30, 300  # iterations from each start, and at most in all from the best of them
START_NOISE = 0.1  # least variance of w at every start: EM converges slowly from a motion that is taken to be exact

CONVERGED_NATS = 0.1
"""EM has converged when the likelihood has less than this to gain, extrapolated from its last gains."""

RANK_TOLERANCE = 1e-12
"""Sums of squares of regressors below this of the largest count as zero, in whatever combination they are so small."""

LEAST_NOISE = 1e-8  # smallest variance of w and v in any direction, states and outputs being of size 1


def em(train: UniformRecord | Sequence[UniformRecord], order: int = 2, seed: int = 0) -> Identified:
    """The model of :class:`StateSpace`'s A, B and C with independent white noises of states and outputs.

    Expectation: states are smoothed under the model there is. Maximization: A, B, offset and Q, C, trim and R, and
    the states in which segments begin are regressed on them (Shumway and Stoffer, Journal of Time Series Analysis 3(4),
    1982; with inputs Cara, Juan and Alarcón, Mechanical Systems and Signal Processing 46(2), 2014). The likelihood
    rises with every iteration, to a maximum that need not be the highest: so it starts from the subspace model and at
    random, and after some iterations continues from the highest likelihood. K is the steady Kalman gain.
    Consistent in closed loop, as far as order and noises are right. ``train``, ``order`` and errors are as for
    :func:`mavdem.baselines.subspace`; ``seed`` is of the random starts. ``ValueError`` too where EM breaks down from
    each.
    """
    order = required_order(order)

    unfinished = f"The likelihood was still rising after {MAX_ITERATIONS} iterations of EM: {NOT_THE_BEST}."
    return identified(f"EM({order})", train, lambda segments: _best_fit(segments, order, seed), unfinished)


class EMFit(NamedTuple):
    """The state of EM: ``starts`` (segments, n) are means of first states; one likelihood an iteration."""

    model: GaussianModel
    starts: Array
    log_likelihoods: tuple[float, ...]
    converged: bool


def iterated(begun: EMFit, segments: Segments, iterations: int) -> EMFit:
    """As many iterations more, or until it has converged."""
    model, starts, likelihoods, converged = begun
    for _ in range(iterations):
        if converged:
            break
        expected = [smoothed(model, start, *segment) for start, segment in zip(starts, segments, strict=True)]
        likelihoods += (sum(of.log_likelihood for of in expected),)
        if not np.isfinite(likelihoods[-1]):
            raise np.linalg.LinAlgError("the likelihood is not finite")
        converged = _left_to_gain(likelihoods) < CONVERGED_NATS
        if not converged:
            model = _maximized(model, expected, segments)
            starts = np.array([of.means[0] for of in expected])
    return EMFit(model, starts, likelihoods, converged)


def _left_to_gain(likelihoods: tuple[float, ...]) -> float:
    """What the gains to come sum to, if they go on shrinking as the last two did (Aitken)."""
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


def _best_fit(segments: Segments, order: int, seed: int) -> Fitted:
    """From the start that has come highest after its trial, to the end; of those from which nothing breaks down."""
    tried = []
    for start in starting_points(segments, order, seed):
        with suppress(np.linalg.LinAlgError):
            tried.append(iterated(start, segments, TRIAL_ITERATIONS))
    for trial in sorted(tried, key=lambda one: one.log_likelihoods[-1], reverse=True):
        with suppress(np.linalg.LinAlgError):
            fitted = iterated(trial, segments, MAX_ITERATIONS - TRIAL_ITERATIONS)
            A, B, offset, C, trim, Q, R = fitted.model
            (n, k), m = B.shape, len(C)
            gain = innovation_gain(A, C, Q, R, np.zeros((n, m)))
            model = StateSpace(A, B, C, np.zeros((m, k)), gain, offset, np.zeros(k), trim)
            return Fitted(model, fitted.starts, fitted.converged)
    raise ValueError(
        f"EM for {order} states broke down from each of {STARTS} starts, since covariances lost their rank or left the "
        f"range of numbers: lower the order, or train on other samples"
    )


def starting_points(segments: Segments, order: int, seed: int) -> list[EMFit]:
    """The subspace model with noise, and models at random."""
    rng = np.random.default_rng(seed)
    # First, since it refuses an order that no memory holds.
    starts = [_from_subspace(segments, order)]
    return starts + [_at_random(rng, segments, order) for _ in range(STARTS - 1)]


def _from_subspace(segments: Segments, order: int) -> EMFit:
    found, starts, _ = found_by_projection(segments, order)
    A, B, C, _, K, offset, _, trim, *_ = found
    pairs = zip(starts, segments, strict=True)
    errors = np.concatenate([segment[1] - found.predicted(start, *segment) for start, segment in pairs])
    R = errors.T @ errors / len(errors)
    noise = K @ R @ K.T + START_NOISE * np.eye(order)
    model = GaussianModel(A, B, offset, C, trim, noise, R + LEAST_NOISE * np.eye(len(C)))
    return EMFit(model, starts, (), False)


def _at_random(rng: np.random.Generator, segments: Segments, order: int) -> EMFit:
    k, m = segments[0][0].shape[1], segments[0][1].shape[1]
    turn = np.linalg.qr(rng.standard_normal((order, order))).Q
    A = turn * rng.uniform(0.5, 0.95, order) @ turn.T
    model = GaussianModel(
        A,
        0.1 * rng.standard_normal((order, k)),
        np.zeros(order),
        rng.standard_normal((m, order)),
        np.zeros(m),
        START_NOISE * np.eye(order),
        START_NOISE * np.eye(m),
    )
    return EMFit(model, np.zeros((len(segments), order)), (), False)
