"""F̄ as a function of θ and λ alone, with X following them to its maximum: its slope, and where its maximum lies.

Steps in turn hold X while they move θ, and θ while they move X: where one holds the other they creep, and the last
gain says little about what is left. The profile's Newton step says it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.free_energy import Belief, state_curvature
from mavdem.dem.generative import GenerativeModel, Moments, Samples
from mavdem.dem.parts import Parts
from mavdem.dem.positive import inverse
from mavdem.dem.steps import d_step, lambda_slope, theta_slope

Array = NDArray[np.float64]

STEP = 1.0
"""Of differences of the slope, in posterior standard deviations: over that F̄ is as good as quadratic, and the
difference stands far above rounding."""

FLATTEST = 1e-6
"""Least curvature, in units of the posterior's own, that a step counts with: along what is flatter it would be wild."""


SLOPES = 4
"""In a part of a Newton step."""


class Newton(NamedTuple):
    """The Newton step of the profile.

    Attributes:
        theta, lambda_: (k,) and (g,), from the belief to the maximum of the quadratic that F̄ looks like there.
        gain: nats that it promises.
    """

    theta: Array
    lambda_: Array
    gain: float


def newton_by_parts(model: GenerativeModel, samples: Samples, belief: Belief) -> Parts[Newton]:
    """The step from where a climb stands; upwards also where F̄ is not concave.

    Raises:
        numpy.linalg.LinAlgError: F̄ cannot be had beside the belief.
    """
    unit = np.sqrt(np.concatenate([belief.theta_covariance.diagonal(), belief.lambda_covariance.diagonal()]))
    here = _slope(model, samples, belief, np.zeros(len(unit)))
    columns = []
    for number, step in enumerate(STEP * np.diag(unit)):
        if number % SLOPES == 0:
            yield
        columns.append((here - _slope(model, samples, belief, step)) * unit / STEP)
    curvature = np.array(columns)
    values, modes = np.linalg.eigh((curvature + curvature.T) / 2)
    along = modes.T @ (unit * here)
    # Along a direction in which F̄ curves upwards, the same distance up as if it curved downwards.
    steps = along / np.maximum(np.abs(values), FLATTEST)
    theta, lambda_ = np.split(unit * (modes @ steps), [len(belief.theta)])
    return Newton(theta, lambda_, 0.5 * float(along @ steps))


def theta_curvature_of_profile(model: GenerativeModel, samples: Samples, belief: Belief) -> Array:
    """−∂²F̄/∂θ² (k, k), with X following θ and λ held.

    Raises:
        numpy.linalg.LinAlgError: F̄ cannot be had beside the belief.
    """
    k = len(belief.theta)
    steps = np.zeros((k, k + len(belief.lambda_)))
    steps[:, :k] = STEP * np.diag(np.sqrt(belief.theta_covariance.diagonal()))
    curvature = np.array(
        [
            (_slope(model, samples, belief, -step) - _slope(model, samples, belief, step))[:k] / (2 * step.max())
            for step in steps
        ]
    )
    return np.asarray((curvature + curvature.T) / 2)


def _slope(model: GenerativeModel, samples: Samples, belief: Belief, step: Array) -> Array:
    """∂F̄/∂(θ, λ), (k + g,), a step from the belief, X and its covariance at their maximum there, the others held."""
    theta, lambda_ = belief.theta + step[: len(belief.theta)], belief.lambda_ + step[len(belief.theta) :]
    state_map = d_step(model, theta, belief.theta_covariance, lambda_, belief.lambda_covariance)
    there = belief._replace(
        moments=Moments.of(model, samples, state_map),
        state_covariance=inverse(-state_curvature(model, theta, np.exp(lambda_))),
        theta=theta,
        lambda_=lambda_,
    )
    return np.concatenate([theta_slope(model, samples, there)[0], lambda_slope(model, samples, there)[0]])
