"""The D, E and M steps of DEM: they maximise the free energy F̄ over states X, parameters θ and log noise precisions λ.

Each step holds the other quantities, and takes the gradient ascent of Eq. ``GA_basic`` to its end: the limit of
infinite learning rates k, which is always stable. F̄ is quadratic in X and in θ, so their maxima have closed forms. In λ
it has exponentials e^λ, and is maximised by Newton's method.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.engine.free_energy import (
    Posterior,
    expected_noise_precisions,
    lambda_curvature,
    state_curvature,
    theta_curvature,
)
from mavdem.dem.engine.linalg import inverse, solve

MAX_NEWTON_STEPS = 40
"""Largest number of Newton steps of one M step: a guard, since the method converges in far fewer."""

MAX_LAMBDA_STEP = 4.0
"""Largest change of a log noise precision in one Newton step.

A choice: the precision changes by a factor of e⁴ = 55 at most. Far from the maximum the curvature, which is
exponential in λ, suggests steps that are much too long.
"""

MIN_LAMBDA_STEP = 1e-6
"""Change of the log noise precisions below which the M step has converged.

Newton's method converges quadratically: after a step of 1e-6 the error is about 1e-12.
"""


def d_step(posterior: Posterior) -> Array:
    """Performs the D step: finds the states X of every sample at the maximum of F, given θ and λ.

    F is quadratic in X with the same curvature at every sample. So the maximum is linear in the data, X = L [ỹ; η̃],
    with one matrix L for all samples.

    Args:
        posterior: the posterior of θ and λ; its states are not used.

    Returns:
        L (dim X, dim [ỹ; η̃]).
    """
    data_effect, precision = state_gradient(posterior)
    return solve(precision, data_effect)


class StateGradient(NamedTuple):
    """The gradient of F by the states X of a sample, ∂F/∂X = G [ỹ; η̃] − P X."""

    data_effect: Array
    """(dim X, dim [ỹ; η̃]) G."""

    precision: Array
    """(dim X, dim X) P."""


def state_gradient(posterior: Posterior) -> StateGradient:
    """Returns the gradient of F by the states of a sample, as the matrices of a linear function.

    The prediction errors are linear in the data and in X, ε̃ = E_data [ỹ; η̃] + E_X X, and F contains −½ ε̃ᵀ Π̃ ε̃. So the
    gradient is −E_Xᵀ Π̃ ε̃, a linear function of data and X, with two changes by the mean field: the uncertainty of λ
    increases the noise precisions in Π̃, and the uncertainty of θ penalizes X by −M X.

    Args:
        posterior: the posterior of θ and λ; its states are not used.

    Returns:
        The matrix −E_Xᵀ Π̃ E_data that multiplies the data, and E_Xᵀ Π̃ E_X + M, which multiplies −X: the precision of X.
    """
    model = posterior.model
    E = model.error_operator(posterior.theta)
    E_data = E[:, : model.hidden_columns.start]
    E_X = E[:, model.hidden_columns]
    noise_precisions = expected_noise_precisions(posterior.lambda_, posterior.lambda_covariance)
    # E_Xᵀ Π̃.
    weighted_errors = E_X.T @ model.error_precision(noise_precisions)
    mean_field_curvature = model.mean_field_curvature_in_states(
        np.exp(posterior.lambda_), posterior.theta_covariance
    )
    return StateGradient(
        data_effect=-weighted_errors @ E_data,
        precision=weighted_errors @ E_X + mean_field_curvature,
    )


def e_step(posterior: Posterior) -> Array:
    """Performs the E step: finds the parameters θ at the maximum of F̄, given the states and λ.

    F̄ is quadratic in θ, so that one Newton step from any θ reaches the maximum.

    Args:
        posterior: the posterior, at whose θ the step starts.

    Returns:
        θ (k,) at the maximum.
    """
    return posterior.theta + solve(theta_precision(posterior), theta_gradient(posterior))


def theta_gradient(posterior: Posterior) -> Array:
    """Returns the first derivative of F̄ by θ.

    It is the sum of three gradients: of the log prior of θ, of the squared errors at the means of the states, and of
    the mean-field term, by which the uncertainty of the states adds to these squared errors. In the second one the
    uncertainty of λ increases the noise precisions.

    Args:
        posterior: the posterior of the states, θ and λ.

    Returns:
        ∂F̄/∂θ (k,), at the θ of the posterior.
    """
    model = posterior.model
    prior = model.prior
    noise_precisions = np.exp(posterior.lambda_)
    expected_precisions = expected_noise_precisions(posterior.lambda_, posterior.lambda_covariance)
    prior_gradient = prior.theta_precision @ (prior.theta_mean - posterior.theta)
    # Second moments of the errors with [ỹ; η̃; X]: at the means of the states, and by the uncertainty of the states.
    moments_at_means = posterior.moments.cross_moments(posterior.theta)
    moments_by_uncertainty = model.error_operator(posterior.theta) @ _state_spread(posterior)
    return (
        prior_gradient
        + model.error_gradient_in_theta(expected_precisions, moments_at_means)
        + model.error_gradient_in_theta(noise_precisions, moments_by_uncertainty)
    )


def theta_precision(posterior: Posterior) -> Array:
    """Returns the negative second derivative of F̄ by θ, a sum of the same three terms as :func:`theta_gradient`.

    Args:
        posterior: the posterior of the states, θ and λ.

    Returns:
        −∂²F̄/∂θ² (k, k); it does not depend on θ.
    """
    model = posterior.model
    expected_precisions = expected_noise_precisions(posterior.lambda_, posterior.lambda_covariance)
    return (
        model.prior.theta_precision
        + model.error_curvature_in_theta(expected_precisions, posterior.moments.regressor_moments)
        + model.error_curvature_in_theta(
            np.exp(posterior.lambda_), model.regressor_moments(_state_spread(posterior))
        )
    )


def _state_spread(posterior: Posterior) -> Array:
    """Returns what the uncertainty of the states X adds to the second moments of the joint vector [ỹ; η̃; X].

    It is the covariance of the states times the number of samples, since the moments are summed over the samples, in
    the block of X. The rest is 0: the data ỹ and η̃ are known exactly.
    """
    hidden = posterior.model.hidden_columns
    state_spread = np.zeros_like(posterior.moments.joint_moments)
    state_spread[hidden, hidden] = posterior.samples.sample_count * posterior.state_covariance
    return state_spread


def m_step(posterior: Posterior) -> Array:
    """Performs the M step: finds the log noise precisions λ at the maximum of F̄, given the states and θ.

    F̄ is concave in λ, so that Newton's method finds its only maximum. Each entry of a step is limited to
    ``MAX_LAMBDA_STEP``, and a step that decreases F̄ is halved. The search ends with a step below ``MIN_LAMBDA_STEP``.

    Args:
        posterior: the posterior, at whose λ the search starts.

    Returns:
        λ (g,) at the maximum.
    """
    free_energy = FreeEnergyOfLambda.from_posterior(posterior)
    lambda_ = posterior.lambda_
    value = free_energy.value(lambda_)
    for _ in range(MAX_NEWTON_STEPS):
        gradient, precision = free_energy.derivatives(lambda_)
        step = np.clip(solve(precision, gradient), -MAX_LAMBDA_STEP, MAX_LAMBDA_STEP)
        next_value = free_energy.value(lambda_ + step)
        while next_value < value and abs(step).max() > MIN_LAMBDA_STEP:
            step = step / 2
            next_value = free_energy.value(lambda_ + step)
        if next_value < value:
            # Even the smallest step decreases F̄: the maximum is reached up to rounding.
            break
        lambda_ = lambda_ + step
        value = next_value
        if abs(step).max() <= MIN_LAMBDA_STEP:
            break
    return lambda_


class LambdaDerivatives(NamedTuple):
    """Derivatives of F̄ by the g log noise precisions λ."""

    gradient: Array
    """(g,) ∂F̄/∂λ."""

    precision: Array
    """(g, g) −∂²F̄/∂λ²."""


class FreeEnergyOfLambda(NamedTuple):
    """F̄ as a function of λ alone, up to a constant: −½ Σ_g c_g e^{λ_g} + bᵀλ − ½ (λ − η)ᵀ P (λ − η)."""

    c: Array
    """(g,) expected squared errors that each noise precision weights, summed over the samples."""

    b: Array
    """(g,) half the number of errors of each noise: the derivative of the noise entropy."""

    eta: Array
    """(g,) prior mean η^λ."""

    P: Array
    """(g, g) prior precision P^λ."""

    @classmethod
    def from_posterior(cls, posterior: Posterior) -> FreeEnergyOfLambda:
        """Returns F̄ as a function of λ, with the states and θ of a posterior.

        The coefficients c are expected squared errors: the squares at the means of states, θ and λ, plus what their
        uncertainties add (mean field). b is half the number of errors of each noise, and η and P are the prior's.

        Args:
            posterior: the posterior; its mean of λ is not used.

        Returns:
            The function, by its coefficients.
        """
        model = posterior.model
        sample_count = posterior.samples.sample_count
        E_X = model.error_operator(posterior.theta)[:, model.hidden_columns]
        squares_at_means = posterior.moments.squared_errors_by_noise(posterior.theta)
        # The expected value of e^λ is larger than e^λ at the mean of λ, by this factor.
        lambda_factor = 1.0 + 0.5 * posterior.lambda_covariance.diagonal()
        # Every sample's states have the same covariance Σˣ, which adds E_X Σˣ E_Xᵀ to the squares of its errors.
        squares_by_states = sample_count * model.squared_errors_by_noise(
            E_X @ posterior.state_covariance @ E_X.T
        )
        squares_by_theta = model.mean_field_squared_errors(
            posterior.moments.regressor_moments, posterior.theta_covariance
        )
        return cls(
            c=squares_at_means * lambda_factor + squares_by_states + squares_by_theta,
            b=0.5 * sample_count * model.log_det_gradient,
            eta=model.prior.lambda_mean,
            P=model.prior.lambda_precision,
        )

    def value(self, lambda_: Array) -> float:
        """Returns F̄, nats, up to the constant, at λ (g,)."""
        error = lambda_ - self.eta
        return float(
            -0.5 * self.c @ np.exp(lambda_) + self.b @ lambda_ - 0.5 * error @ self.P @ error
        )

    def derivatives(self, lambda_: Array) -> LambdaDerivatives:
        """Returns the first and second derivatives of F̄ at λ (g,)."""
        weighted_squares = 0.5 * self.c * np.exp(lambda_)
        gradient = self.b - weighted_squares - self.P @ (lambda_ - self.eta)
        precision = np.diag(weighted_squares) + self.P
        return LambdaDerivatives(gradient, precision)


def with_optimal_covariances(posterior: Posterior) -> Posterior:
    """Sets every covariance of a posterior to the maximum of F̄, Eq. ``Pi_curvature``.

    They are the inverses of the negative second derivatives of the internal energy, or action, at the means (Laplace
    approximation).

    Args:
        posterior: the posterior, whose means are kept.

    Returns:
        A copy of the posterior with these covariances.

    Raises:
        numpy.linalg.LinAlgError: a negative curvature is not positive definite.
    """
    return posterior._replace(
        state_covariance=inverse(-state_curvature(posterior)),
        theta_covariance=inverse(-theta_curvature(posterior)),
        lambda_covariance=inverse(-lambda_curvature(posterior)),
    )
