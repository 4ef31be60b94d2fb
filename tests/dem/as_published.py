"""The D, E and M steps of the paper's authors' code, made of this engine's parts, with what they do differently.

The engine maximizes one F̄ exactly. The published steps are approximations of that, and numerical guards; each is named
where it is made. They serve to compare the engine's parts with the authors' results, which have gone through all this.
"""

import numpy as np
from scipy.linalg import block_diag, expm

from mavdem.dem.engine.free_energy import state_curvature, theta_curvature
from mavdem.dem.engine.generative import GeneralizedMoments, derivative_operator
from mavdem.dem.engine.linalg import solve
from mavdem.dem.engine.model import unpack

LEAST_RIDGE = np.exp(-32.0)
SHORTEST_STEP = 0.02
LONGEST_STEP = 2.0
SUBSTEPS = 8
"""The M step ends after a step of λ whose lengths sum to less than the first, or after so many."""


def ridged(matrix):
    """A precision (…, k, k) as they invert it: k units in the last place of its norm are added to its diagonal."""
    size = matrix.shape[-1]
    ridge = np.maximum(
        size * np.spacing(np.linalg.norm(matrix, np.inf, axis=(-2, -1))), LEAST_RIDGE
    )
    return matrix + ridge[..., None, None] * np.eye(size)


def truncated_inverse(matrix):
    """Their other inverse, without directions that are within k units in the last place of the norm of a (k, k)."""
    norm = np.linalg.norm(matrix, 2)
    return np.linalg.pinv(matrix, rcond=len(matrix) * np.spacing(norm) / norm)


def moments(model, data, X):
    """Those of [ỹ; η̃] (T, ·) and X (T, ·) sample by sample, so that errors are taken before their moments."""
    return GeneralizedMoments(model, np.eye(len(X)), np.hstack([data, X]).T)


def d_step(
    model,
    data,
    theta,
    theta_covariance,
    weights,
    dt,
):
    """X of every sample, (T, dim X): a flow at k = 1 that each sample has ``dt`` seconds to pull, from rest.

    D is in the flow but not in its linearization; the mean field of θ has half its gradient; the last row is lost, and
    the one before stands for it.
    """
    operator = model.error_operator(theta)
    precision = model.precision(weights)
    of_data = operator[:, : model.hidden.start]
    of_X = operator[:, model.hidden]
    # The operator is linear in θ but for a constant, so the spread of θ makes one of its own.
    constant = model.error_operator(np.zeros_like(theta))
    spread = (
        model.error_operator(column) - constant for column in np.linalg.cholesky(theta_covariance).T
    )
    mean_field = sum(s[:, model.hidden].T @ precision @ s[:, model.hidden] for s in spread)
    jacobian = -of_X.T @ precision @ of_X - 0.5 * mean_field
    D = block_diag(derivative_operator(model.p, model.n), derivative_operator(model.d, model.r))
    gain = (expm(jacobian * dt) - np.eye(len(D))) @ truncated_inverse(jacobian)
    onward = np.eye(len(D)) + gain @ (jacobian + D)
    pulls = -data @ (gain @ of_X.T @ precision @ of_data).T
    X = np.zeros_like(pulls)
    for t, pull in enumerate(pulls):
        # Before the first is the last, which is still zero.
        X[t] = onward @ X[t - 1] + pull
    X[-1] = X[-2]
    return X


def internal_slope(model, at, theta, weights):
    """Ū_θ (k,)."""
    pull = model.prior.theta_precision @ (theta - model.prior.theta_mean)
    return model.parameter_slope(weights, at.products(theta)) - pull


def mean_field(model, state_precision, theta, weights):
    """Their gradient (k,) and curvature (k, k) in θ of one sample's W of the states: half of what they are."""
    spread = np.zeros((model.hidden.start + len(state_precision),) * 2)
    spread[model.hidden, model.hidden] = truncated_inverse(state_precision)
    slope = model.parameter_slope(weights, model.error_operator(theta) @ spread)
    return 0.5 * slope, -0.5 * model.parameter_precision(weights, spread)


def e_step(model, at, theta, weights):
    """θ after a full Newton step on Ū and their mean field."""
    number = at.stack.shape[1]
    slope, curvature = mean_field(model, -state_curvature(model, theta, weights), theta, weights)
    slope = internal_slope(model, at, theta, weights) + number * slope
    curvature = theta_curvature(model, at, weights) + number * curvature
    return theta - np.linalg.solve(curvature, slope)


def expected_errors(model, at, theta, weights):
    """Σ_t ⟨ε̃ε̃ᵀ⟩ for the M step, (dim ε̃, dim ε̃).

    The precision of θ at a sample is that which the samples up to it give, without the prior.
    """
    n = model.n
    p = model.p
    d = model.d
    number = at.stack.shape[1]
    of_X = model.error_operator(theta)[:, model.hidden]
    states = number * of_X @ np.linalg.inv(ridged(-state_curvature(model, theta, weights))) @ of_X.T
    X = at.stack[model.hidden].T
    x = X[:, : n * (p + 1)].reshape(number, p + 1, n)
    v = np.zeros((number, p + 1, model.r))
    v[:, : d + 1] = X[:, n * (p + 1) :].reshape(number, d + 1, model.r)
    A, B, C = unpack(np.arange(len(theta)), *model.sizes)
    of_w = (np.hstack([A, B]), np.dstack([x, v]))
    of_z = (C, x)
    precision = np.zeros((number, len(theta), len(theta)))
    for (rows, regressors), S, noise in (
        (of_w, model.state_correlation, weights[model.state_groups]),
        (of_z, model.output_correlation, weights[model.output_groups]),
    ):
        information = np.cumsum(regressors.swapaxes(1, 2) @ S @ regressors, axis=0)
        for row, weight in zip(rows, noise, strict=True):
            precision[:, row[:, None], row] = weight * information
    covariance = np.linalg.inv(ridged(precision))

    def spread(rows, regressors):
        by_component = np.zeros((p + 1, len(rows), p + 1, len(rows)))
        for component, row in enumerate(rows):
            weighted = regressors @ covariance[:, row[:, None], row]
            by_component[:, component, :, component] = np.tensordot(
                weighted, regressors, axes=([0, 2], [0, 2])
            )
        return by_component.reshape((p + 1) * len(rows), -1)

    inputs = np.zeros((model.r * (d + 1),) * 2)
    return at.errors(theta) + states + block_diag(spread(*of_z), inputs, spread(*of_w))


def m_step(model, number, squares, lambda_):
    """λ after each of its substeps, the start first; the last but one is what the next D and E steps use."""
    path = [lambda_]
    while len(path) <= SUBSTEPS:
        step = solve(
            fisher_information(model, number), lambda_slope(model, number, squares, path[-1])
        )
        path.append(path[-1] + np.clip(step, -LONGEST_STEP, LONGEST_STEP))
        if abs(step).sum() < SHORTEST_STEP:
            break
    return path


def lambda_slope(model, number, squares, lambda_):
    """∂F̄/∂λ (g,) for expected squared errors ``squares`` (g,)."""
    pull = model.prior.lambda_precision @ (lambda_ - model.prior.lambda_mean)
    return 0.5 * (number * model.log_precision_slope - np.exp(lambda_) * squares) - pull


def fisher_information(model, number):
    """−F̄_λλ where λ fits the errors, which they take everywhere, (g, g)."""
    return np.diag(0.5 * number * model.log_precision_slope) + model.prior.lambda_precision
