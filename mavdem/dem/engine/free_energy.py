"""Free energy: the one definition of F̄. The D, E and M steps maximise it and are tested against it."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.engine.generative import GeneralizedMoments, GenerativeModel, SufficientStatistics
from mavdem.dem.engine.linalg import logdet


class Posterior(NamedTuple):
    """The recognition density q: Gaussian in X (at every sample), θ and λ."""

    moments: GeneralizedMoments  # of the data and the means of X
    state_covariance: Array  # Σˣ of X = [x̃; ṽ], the same at every sample
    theta: Array
    theta_covariance: Array
    lambda_: Array
    lambda_covariance: Array

    @property
    def model(self) -> GenerativeModel:
        """The generative model that it is about."""
        return self.moments.model

    @property
    def samples(self) -> SufficientStatistics:
        """The data."""
        return self.moments.samples

    @property
    def state_map(self) -> Array:
        """L with X = L [ỹ; η̃], (dim X, dim [ỹ; η̃])."""
        return self.moments.stack[self.model.hidden]


class SampleFreeEnergy(NamedTuple):
    """F(t) = U + W + H, Eq. ``free_E``, as a function of the sample; constants in 2π are left out.

    W is the expectation of the curvature, ½ tr(Σ U_ϑϑ): the ½ that Eq. ``F_bar_MF`` has and Eq. ``free_E`` lost. So it
    is a constant less half the squares of the sample's errors and of its states. The priors and entropies of θ and λ,
    which are the same at every sample, are in each F(t) and only once in F̄.
    """

    constant: float  # F(t) of a sample without errors, at states 0
    # what of it the priors and entropies of θ and λ make up, which are in F̄ only once
    parameter_terms: float
    errors: Array  # E with ε̃ = E [ỹ; η̃; X]
    precision: Array  # of ε̃, that of the noise included that uncertain λ make
    uncertainty: Array  # of X, which uncertain θ make

    @classmethod
    def from_posterior(cls, posterior: Posterior) -> SampleFreeEnergy:
        """Returns that under a posterior, whose moments are not used."""
        model = posterior.model
        theta = posterior.theta
        lambda_ = posterior.lambda_
        prior = model.prior
        # W^λ and W^θ of a sample are expand in its errors and in its X.
        precision = model.precision(expected_weights(lambda_, posterior.lambda_covariance))
        uncertainty = model.state_uncertainty(np.exp(lambda_), posterior.theta_covariance)
        priors = 0.5 * float(
            sum(model.log_precision_of_priors)
            + logdet(posterior.theta_covariance)
            + logdet(posterior.lambda_covariance)
            - sum(prior.squared_errors(theta, lambda_))
            - np.sum(posterior.theta_covariance * prior.theta_precision)
            - np.sum(posterior.lambda_covariance * prior.lambda_precision)
        )
        noise = 0.5 * float(
            model.log_precision(lambda_)
            + np.sum(posterior.state_covariance * state_curvature(posterior))
            + logdet(posterior.state_covariance)
        )
        return cls(priors + noise, priors, model.error_operator(theta), precision, uncertainty)

    def evaluate(self, data: Array, states: Array) -> Array:
        """Returns F(t), (T,), of generalized data [ỹ; η̃] (T, ·) and means of the states X (T, dim X)."""
        errors = np.hstack([data, states]) @ self.errors.T
        squares = np.sum(errors @ self.precision * errors, axis=1) + np.sum(
            states @ self.uncertainty * states, axis=1
        )
        return self.constant - 0.5 * squares

    def action(self, data: Array, states: Array) -> float:
        """Returns F̄, the sum over all samples (T, ·) with the priors counted once."""
        return self.evaluate(data, states).sum() - (len(data) - 1) * self.parameter_terms


def expected_weights(lambda_: Array, lambda_covariance: Array) -> Array:
    """Returns noise precisions as the squared errors feel them: e^λ (1 + ½ Σ^λ).

    The mean-field term of λ is included.
    """
    return np.exp(lambda_) * (1.0 + 0.5 * lambda_covariance.diagonal())


def state_curvature(posterior: Posterior) -> Array:
    """Returns U_XX, the same at every sample."""
    model = posterior.model
    of_X = model.error_operator(posterior.theta)[:, model.hidden]
    return -of_X.T @ model.precision(np.exp(posterior.lambda_)) @ of_X


def theta_curvature(posterior: Posterior) -> Array:
    """Returns Ū_θθ (k, k)."""
    weights = np.exp(posterior.lambda_)
    of_errors = posterior.model.parameter_precision(weights, posterior.moments.joint)
    return -posterior.model.prior.theta_precision - of_errors


def lambda_curvature(posterior: Posterior) -> Array:
    """Returns Ū_λλ (g, g)."""
    squares = posterior.moments.squared_errors(posterior.theta)
    return (
        -np.diag(0.5 * np.exp(posterior.lambda_) * squares) - posterior.model.prior.lambda_precision
    )


class Term(StrEnum):
    """The named terms of F̄ᵒ, Eq. ``F_action_opt``."""

    NOISE_ENTROPY = "noise entropy"
    STATE_AND_INPUT_ENTROPY = "state and input entropy"
    PARAMETER_ENTROPY = "parameter entropy"
    HYPERPARAMETER_ENTROPY = "hyperparameter entropy"
    PREDICTION_ERROR_OF_OUTPUTS = "prediction error of outputs"
    PREDICTION_ERROR_OF_INPUTS = "prediction error of inputs"
    PREDICTION_ERROR_OF_STATES = "prediction error of states"
    PREDICTION_ERROR_OF_PARAMETERS = "prediction error of parameters"
    PREDICTION_ERROR_OF_HYPERPARAMETERS = "prediction error of hyperparameters"


def free_energy_terms(posterior: Posterior) -> Mapping[str, float]:
    """Returns the named terms of F̄ᵒ, Eq. ``F_action_opt``, of a posterior whose precisions are the negative curvatures.

    They sum to F̄ᵒ, which is :meth:`SampleFreeEnergy.action` there plus half the number of everything estimated,
    T·dim X + dim θ + dim λ (the mean-field terms, which the paper drops with the constants).
    """
    model = posterior.model
    of_theta, of_lambda = model.log_precision_of_priors
    theta_error, lambda_error = model.prior.squared_errors(posterior.theta, posterior.lambda_)
    T = posterior.samples.number
    squares = model.precision(np.exp(posterior.lambda_)) * posterior.moments.errors(posterior.theta)
    of_y, of_v, of_x = model.errors
    of_x = slice(of_x.start, None)  # with x itself, where something is known of it
    values = (
        0.5 * T * model.log_precision(posterior.lambda_),
        0.5 * T * logdet(posterior.state_covariance),
        0.5 * (logdet(posterior.theta_covariance) + of_theta),
        0.5 * (logdet(posterior.lambda_covariance) + of_lambda),
        -0.5 * squares[of_y, of_y].sum(),
        -0.5 * squares[of_v, of_v].sum(),
        -0.5 * squares[of_x, of_x].sum(),
        -0.5 * theta_error,
        -0.5 * lambda_error,
    )
    return dict(zip(Term, values, strict=True))
