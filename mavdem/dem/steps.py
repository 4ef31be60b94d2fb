"""The D, E and M steps: each maximizes F̄ over one part of the belief with the others held, so F̄ never falls.

X and θ enter F̄ quadratically, so their steps are exact; λ enters through e^λ and takes guarded Newton steps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.free_energy import Belief, add_blocks, lambda_curvature, state_curvature, theta_curvature
from mavdem.dem.generative import GenerativeModel, Samples
from mavdem.dem.positive import inverse, solve

Array = NDArray[np.float64]

NEWTON_STEPS = 50
LONGEST_STEP = 4.0
"""A step of λ changes a noise precision at most by e⁴: far from the maximum the curvature says little."""
SETTLED = 1e-9
"""A step of λ shorter than this ends the M step."""


def expected_weights(lambda_: Array, lambda_covariance: Array) -> Array:
    """Noise precisions as the squared errors feel them: e^λ (1 + ½ Σ^λ), the mean-field term of λ included."""
    return np.exp(lambda_) * (1.0 + 0.5 * np.diag(lambda_covariance))


def d_step(
    model: GenerativeModel, theta: Array, theta_covariance: Array, lambda_: Array, lambda_covariance: Array
) -> Array:
    """The D step in the exact limit k → ∞: every sample's X at the maximum of F.

    F is quadratic in X with the same curvature at every sample, so the answer is one linear map.

    Returns:
        L (dim X, dim [ỹ; η̃]) with X(t) = L [ỹ(t); η̃(t)].
    """
    weights = expected_weights(lambda_, lambda_covariance)
    E = model.error_operator(theta)
    precision = model.precision(weights)
    data, X = E[:, : model.hidden.start], E[:, model.hidden]
    weighted = X.T @ precision
    curvature = weighted @ X + _uncertain_parameters(model, theta_covariance, np.exp(lambda_))
    return -solve(curvature, weighted @ data)


def _uncertain_parameters(model: GenerativeModel, theta_covariance: Array, weights: Array) -> Array:
    """−W^θ's curvature in X: an uncertain parameter makes the states it multiplies expensive."""
    n, r, rows = model.n, model.r, model.parameter_rows
    dynamics = np.tensordot(weights[model.state_groups], blocks(theta_covariance, rows.dynamics), axes=1)
    observation = np.tensordot(weights[model.output_groups], blocks(theta_covariance, rows.observation), axes=1)
    x, v = n * (model.p + 1), r * (model.d + 1)
    curvature = np.zeros((x + v, x + v))
    curvature[:x, :x] = _kron(model.output_correlation, observation)
    S = model.state_correlation
    both = min(model.q, model.d) + 1
    at_x, at_v = slice(0, n * (model.q + 1)), slice(x, x + r * both)
    curvature[at_x, at_x] += _kron(S, dynamics[:n, :n])
    cross = _kron(S[:, :both], dynamics[:n, n:])
    curvature[at_x, at_v] += cross
    curvature[at_v, at_x] += cross.T
    curvature[at_v, at_v] += _kron(S[:both, :both], dynamics[n:, n:])
    return curvature


def _kron(left: Array, right: Array) -> Array:
    """``numpy.kron`` of two matrices, without the generality that takes ten times as long."""
    product = left[:, None, :, None] * right[None, :, None, :]
    return product.reshape(left.shape[0] * right.shape[0], left.shape[1] * right.shape[1])


def blocks(matrix: Array, rows: NDArray[np.intp]) -> Array:
    """The square blocks of ``matrix`` at the places ``rows`` (j, size): (j, size, size)."""
    return matrix[rows[:, :, None], rows[:, None, :]]


def e_step(model: GenerativeModel, samples: Samples, belief: Belief) -> Array:
    """The E step: θ at the maximum of F̄ given the rest, a full Newton step on a quadratic."""
    prior = model.prior
    of_errors = expected_weights(belief.lambda_, belief.lambda_covariance)
    of_states = np.exp(belief.lambda_)
    spread = np.zeros_like(belief.moments.joint)
    spread[model.hidden, model.hidden] = samples.number * belief.state_covariance
    curvature = prior.theta_precision.copy()
    slope = prior.theta_precision @ prior.theta_mean
    rows = model.parameter_rows
    for weights, regression in ((of_errors, belief.moments.regression), (of_states, model.regression(spread))):
        of_w, of_z = weights[model.state_groups], weights[model.output_groups]
        add_blocks(curvature, rows.dynamics, of_w, regression.regressors)
        add_blocks(curvature, rows.observation, of_z, regression.states)
        slope[rows.dynamics] += of_w[:, None] * regression.slopes
        slope[rows.observation] += of_z[:, None] * regression.outputs
    return solve(curvature, slope)


def m_step(model: GenerativeModel, samples: Samples, belief: Belief) -> Array:
    """The M step: λ at the maximum of F̄ given the rest, by Newton steps that are shortened until F̄ rises.

    As a function of λ, F̄ = −½ Σ_g c_g e^{λ_g} + ½ T s·λ − ½ (λ−η)ᵀP(λ−η), which is concave.
    """
    prior = model.prior
    of_X = model.error_operator(belief.theta)[:, model.hidden]
    squares = belief.moments.squared_errors(belief.theta)
    spread = samples.number * model.squared_errors(of_X @ belief.state_covariance @ of_X.T)
    cost = squares * (1.0 + 0.5 * np.diag(belief.lambda_covariance)) + spread + _parameter_spread(model, belief)
    gain = 0.5 * samples.number * model.log_precision_slope

    def objective(lambda_: Array) -> float:
        error = lambda_ - prior.lambda_mean
        return float(-0.5 * cost @ np.exp(lambda_) + gain @ lambda_ - 0.5 * error @ prior.lambda_precision @ error)

    lambda_ = belief.lambda_
    height = objective(lambda_)
    for _ in range(NEWTON_STEPS):
        pull = 0.5 * cost * np.exp(lambda_)
        slope = gain - pull - prior.lambda_precision @ (lambda_ - prior.lambda_mean)
        step = solve(np.diag(pull) + prior.lambda_precision, slope)
        step = np.clip(step, -LONGEST_STEP, LONGEST_STEP)
        while (higher := objective(lambda_ + step)) < height and np.abs(step).max() > SETTLED:
            step = step / 2
        if np.abs(step).max() <= SETTLED:
            break
        lambda_, height = lambda_ + step, higher
    return lambda_


def _parameter_spread(model: GenerativeModel, belief: Belief) -> Array:
    """tr(Σ^θ Ū_θθ) of the data, apart by λ: how much squared error the uncertainty of θ adds, (g,)."""
    regression, rows = belief.moments.regression, model.parameter_rows
    states = np.sum(blocks(belief.theta_covariance, rows.dynamics) * regression.regressors, axis=(1, 2))
    outputs = np.sum(blocks(belief.theta_covariance, rows.observation) * regression.states, axis=(1, 2))
    return np.asarray(model.group_sum @ np.concatenate([outputs, states]))


def with_optimal_precisions(model: GenerativeModel, belief: Belief) -> Belief:
    """The belief with every covariance at the maximum of F̄, Eq. ``Pi_curvature``."""
    weights = np.exp(belief.lambda_)
    return belief._replace(
        state_covariance=inverse(-state_curvature(model, belief.theta, weights)),
        theta_covariance=inverse(-theta_curvature(model, belief.moments, weights)),
        lambda_covariance=inverse(-lambda_curvature(model, belief.moments, belief.theta, belief.lambda_)),
    )
