"""The D, E and M steps: each raises F̄ over one part of the posterior with the others held.

X and θ enter F̄ quadratically, so their steps are exact; λ enters through e^λ and takes guarded Newton steps. Each
follows its gradient flow, Eq. ``GA_basic``, to the end: the limit of infinite learning rates k, which is always stable.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.free_energy import (
    Posterior,
    expected_weights,
    lambda_curvature,
    state_curvature,
    theta_curvature,
)
from mavdem.dem.engine.gauss_newton import MAX_STEPS
from mavdem.dem.engine.linalg import inverse, solve

LONGEST_PRECISION_STEP = 4.0
"""A step of λ changes a noise precision at most by e⁴: far from the maximum the curvature says little."""
SHORTEST_PRECISION_STEP = 1e-6
"""A step of λ shorter than this ends the M step: Newton's method has then converged to twice as many digits."""


def d_step(posterior: Posterior) -> Array:
    """Takes the D step: every sample's X at the maximum of F under a posterior in θ and λ.

    F is expand in X with the same curvature at every sample, so X(t) = L [ỹ(t); η̃(t)] with one L (dim X,
    dim [ỹ; η̃]), which is returned.
    """
    of_data, precision = state_slope(posterior)
    return solve(precision, of_data)


def state_slope(posterior: Posterior) -> ArrayPair:
    """Returns G (dim X, dim [ỹ; η̃]) and P (dim X, dim X) with ∂F/∂X = G [ỹ; η̃] − P X.

    Mean-field terms of θ and λ are included.
    """
    model = posterior.model
    E = model.error_operator(posterior.theta)
    data = E[:, : model.hidden.start]
    X = E[:, model.hidden]
    weights = expected_weights(posterior.lambda_, posterior.lambda_covariance)
    weighted = X.T @ model.precision(weights)
    uncertainty = model.state_uncertainty(np.exp(posterior.lambda_), posterior.theta_covariance)
    return -weighted @ data, weighted @ X + uncertainty


def e_step(posterior: Posterior) -> Array:
    """Takes the E step: returns θ at the maximum of F̄ given the rest."""
    gradient, precision = theta_slope(posterior)
    return posterior.theta + solve(precision, gradient)


def theta_slope(posterior: Posterior) -> ArrayPair:
    """Returns ∂F̄/∂θ (k,) and −∂²F̄/∂θ² (k, k), the mean-field terms of X and of λ included."""
    model = posterior.model
    prior = model.prior
    weights = np.exp(posterior.lambda_)
    expected = expected_weights(posterior.lambda_, posterior.lambda_covariance)
    spread = np.zeros_like(posterior.moments.joint)
    spread[model.hidden, model.hidden] = posterior.samples.number * posterior.state_covariance
    gradient = (
        prior.theta_precision @ (prior.theta_mean - posterior.theta)
        + model.parameter_slope(expected, posterior.moments.products(posterior.theta))
        + model.parameter_slope(weights, model.error_operator(posterior.theta) @ spread)
    )
    precision = (
        prior.theta_precision
        + model.parameter_precision(expected, posterior.moments.joint)
        + model.parameter_precision(weights, spread)
    )
    return gradient, precision


def m_step(posterior: Posterior) -> Array:
    """Takes the M step: returns λ at the maximum of F̄ given the rest, which is concave in λ, by Newton's steps.

    They are shortened until F̄ rises.
    """
    of_lambda = FreeEnergyOfLambda.from_posterior(posterior)
    lambda_ = posterior.lambda_
    value = of_lambda.value(lambda_)
    for _ in range(MAX_STEPS):
        gradient, precision = of_lambda.slope(lambda_)
        step = np.clip(solve(precision, gradient), -LONGEST_PRECISION_STEP, LONGEST_PRECISION_STEP)
        while (raised := of_lambda.value(lambda_ + step)) < value and abs(
            step
        ).max() > SHORTEST_PRECISION_STEP:
            step = step / 2
        if raised < value:
            break
        lambda_ = lambda_ + step
        value = raised
        if abs(step).max() <= SHORTEST_PRECISION_STEP:
            break
    return lambda_


class FreeEnergyOfLambda(NamedTuple):
    """F̄ as a function of λ alone: −½ Σ_g c_g e^{λ_g} + gain·λ − ½ (λ−η)ᵀP(λ−η) and a constant."""

    cost: Array  # (g,)
    gain: Array  # (g,)
    mean: Array  # (g,)
    precision: Array  # (g, g)

    @classmethod
    def from_posterior(cls, posterior: Posterior) -> FreeEnergyOfLambda:
        """Returns that of a posterior in the rest."""
        model = posterior.model
        number = posterior.samples.number
        of_X = model.error_operator(posterior.theta)[:, model.hidden]
        squares = posterior.moments.squared_errors(posterior.theta)
        spread = number * model.squared_errors(of_X @ posterior.state_covariance @ of_X.T)
        cost = (
            squares * (1.0 + 0.5 * posterior.lambda_covariance.diagonal())
            + spread
            + model.parameter_spread(posterior.moments.joint, posterior.theta_covariance)
        )
        gain = 0.5 * number * model.log_precision_slope
        return cls(cost, gain, model.prior.lambda_mean, model.prior.lambda_precision)

    def value(self, lambda_: Array) -> float:
        """Returns F̄ but for the constant."""
        error = lambda_ - self.mean
        return float(
            -0.5 * self.cost @ np.exp(lambda_)
            + self.gain @ lambda_
            - 0.5 * error @ self.precision @ error
        )

    def slope(self, lambda_: Array) -> ArrayPair:
        """Returns ∂F̄/∂λ (g,) and −∂²F̄/∂λ² (g, g), the mean-field terms of X and of θ included."""
        pull = 0.5 * self.cost * np.exp(lambda_)
        return self.gain - pull - self.precision @ (lambda_ - self.mean), np.diag(
            pull
        ) + self.precision


def with_optimal_covariances(posterior: Posterior) -> Posterior:
    """Returns the posterior with every covariance at the maximum of F̄, Eq. ``Pi_curvature``."""
    return posterior._replace(
        state_covariance=inverse(-state_curvature(posterior)),
        theta_covariance=inverse(-theta_curvature(posterior)),
        lambda_covariance=inverse(-lambda_curvature(posterior)),
    )
