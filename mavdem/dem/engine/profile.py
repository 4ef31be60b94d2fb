"""F̄ as a function of θ and λ alone, with X following them to its maximum: its slope, and where its maximum lies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.free_energy import Belief, state_curvature
from mavdem.dem.engine.generative import GeneralizedMoments, GenerativeModel, SufficientStatistics
from mavdem.dem.engine.linalg import Array, inverse
from mavdem.dem.engine.resumable import Resumable
from mavdem.dem.engine.steps import d_step, lambda_slope, theta_slope

DIFFERENCE_SD = 1.0
"""Step of differences of the slope, in posterior standard deviations: F̄ is nearly quadratic over it, and rounding is
negligible."""

MIN_CURVATURE = 1e-6
"""Least curvature of a direction, in units of the posterior's own: it limits the step along flatter ones."""

SLOPES_A_PART = 4


class Newton(NamedTuple):
    """The Newton step of the profile, of θ and λ to the maximum of the quadratic, and the nats it predicts."""

    theta: Array
    lambda_: Array
    gain: float


def resumable_newton_step(model: GenerativeModel, samples: SufficientStatistics, belief: Belief) -> Resumable[Newton]:
    """The step from a belief, resumable; it increases F̄ also where that is not concave."""
    unit = np.sqrt(np.concatenate([belief.theta_covariance.diagonal(), belief.lambda_covariance.diagonal()]))
    here = _slope(model, samples, belief, np.zeros(len(unit)))
    columns = []
    for number, step in enumerate(DIFFERENCE_SD * np.diag(unit)):
        if number % SLOPES_A_PART == 0:
            yield
        columns.append((here - _slope(model, samples, belief, step)) * unit / DIFFERENCE_SD)
    curvature = np.array(columns)
    values, modes = np.linalg.eigh((curvature + curvature.T) / 2)
    along = modes.T @ (unit * here)
    # Along a direction in which F̄ is convex, the step is that of a concave F̄ with the same curvature.
    steps = along / np.maximum(np.abs(values), MIN_CURVATURE)
    theta, lambda_ = np.split(unit * (modes @ steps), [len(belief.theta)])
    return Newton(theta, lambda_, 0.5 * float(along @ steps))


def theta_curvature_of_profile(model: GenerativeModel, samples: SufficientStatistics, belief: Belief) -> Array:
    """−∂²F̄/∂θ² (k, k), with X following θ and λ held."""
    k = len(belief.theta)
    steps = np.zeros((k, k + len(belief.lambda_)))
    steps[:, :k] = DIFFERENCE_SD * np.diag(np.sqrt(belief.theta_covariance.diagonal()))
    curvature = np.array(
        [
            (_slope(model, samples, belief, -step) - _slope(model, samples, belief, step))[:k] / (2 * step.max())
            for step in steps
        ]
    )
    return np.asarray((curvature + curvature.T) / 2)


def _slope(model: GenerativeModel, samples: SufficientStatistics, belief: Belief, step: Array) -> Array:
    """∂F̄/∂(θ, λ), (k + g,), a step from the belief, X and its covariance at their maximum there, the others held."""
    theta, lambda_ = belief.theta + step[: len(belief.theta)], belief.lambda_ + step[len(belief.theta) :]
    state_map = d_step(model, theta, belief.theta_covariance, lambda_, belief.lambda_covariance)
    there = belief._replace(
        moments=GeneralizedMoments.of(model, samples, state_map),
        state_covariance=inverse(-state_curvature(model, theta, np.exp(lambda_))),
        theta=theta,
        lambda_=lambda_,
    )
    return np.concatenate([theta_slope(model, samples, there)[0], lambda_slope(model, samples, there)[0]])
