"""The variational free energy F̄ of a linear model with states X, parameters θ and log noise precisions λ.

It is the one definition of F̄ that the D, E and M steps maximise, an approximation of the log evidence of the model.

F(t) is the free energy of one sample, and F̄, the free energy action, its sum over all samples with the priors counted
once. Every gradient and curvature of the steps is tested against finite differences of this definition.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.engine.generative import GeneralizedMoments, GenerativeModel, SufficientStatistics
from mavdem.dem.engine.linalg import logdet


class Posterior(NamedTuple):
    """The recognition density q: independent Gaussians of the states X of each sample, of θ and of λ (mean field)."""

    moments: GeneralizedMoments
    """The data, and the means of X as a linear map of them."""

    state_covariance: Array
    """(dim X, dim X) covariance Σˣ of X = [x̃; ṽ], the same at every sample."""

    theta: Array
    """(k,) mean of the parameters."""

    theta_covariance: Array
    """(k, k) covariance Σ^θ."""

    lambda_: Array
    """(g,) mean of the log noise precisions."""

    lambda_covariance: Array
    """(g, g) covariance Σ^λ."""

    @property
    def model(self) -> GenerativeModel:
        """The generative model whose posterior this is."""
        return self.moments.model

    @property
    def samples(self) -> SufficientStatistics:
        """Sufficient statistics of the data."""
        return self.moments.samples

    @property
    def state_map(self) -> Array:
        """L, (dim X, dim [ỹ; η̃]), which maps the data of a sample to the means of its states: X = L [ỹ; η̃]."""
        return self.moments.joint_map[self.model.hidden_columns]


class SampleFreeEnergy(NamedTuple):
    """The free energy F(t) of one sample as a function of its data and its states X, at a fixed posterior of θ and λ.

    F(t) = U + W + H, Eq. ``free_E``: internal energy, mean-field terms and entropy. It is a constant less half the
    weighted squares of the sample's errors and of its states. W is the expectation of the curvature, ½ tr(Σ U_ϑϑ), with
    the ½ that Eq. ``F_bar_MF`` has and Eq. ``free_E`` has lost. Constants in 2π are left out. The terms of θ and λ are
    the same at every sample: each F(t) contains them, F̄ only once.
    """

    constant: float
    """F(t), nats, of a sample whose errors and states are zero."""

    parameter_terms: float
    """The part of ``constant`` that the priors and entropies of θ and λ make up, nats."""

    error_operator: Array
    """E with the errors ε̃ = E [ỹ; η̃; X]."""

    error_precision: Array
    """Precision of ε̃, including the uncertainty of λ."""

    mean_field_curvature: Array
    """(dim X, dim X) penalty of the states, which the uncertainty of θ makes."""

    @classmethod
    def from_posterior(cls, posterior: Posterior) -> SampleFreeEnergy:
        """Returns F(t) as a function of the sample, under the posterior of θ and λ.

        Args:
            posterior: the posterior. The means of its states play no part, since they are arguments of F(t); their
                covariance counts.
        """
        model = posterior.model
        theta = posterior.theta
        lambda_ = posterior.lambda_
        prior = model.prior
        # The mean-field terms of λ and of θ are quadratic in the errors and in the states of a sample.
        error_precision = model.error_precision(
            expected_noise_precisions(lambda_, posterior.lambda_covariance)
        )
        mean_field_curvature = model.mean_field_curvature_in_states(
            np.exp(lambda_), posterior.theta_covariance
        )
        # ½ (ln|P| + ln|Σ| − δᵀ P δ − tr(Σ P)) for θ and for λ, δ being the deviation from the prior mean: the prior,
        # the entropy, and the mean-field term of the prior.
        parameter_terms = 0.5 * float(
            sum(model.log_det_prior_precisions)
            + logdet(posterior.theta_covariance)
            + logdet(posterior.lambda_covariance)
            - sum(prior.squared_errors(theta, lambda_))
            - np.sum(posterior.theta_covariance * prior.theta_precision)
            - np.sum(posterior.lambda_covariance * prior.lambda_precision)
        )
        # The normalisation of the noises, and the mean-field term and entropy of the states.
        sample_terms = 0.5 * float(
            model.log_det_error_precision(lambda_)
            + np.sum(posterior.state_covariance * state_curvature(posterior))
            + logdet(posterior.state_covariance)
        )
        return cls(
            constant=parameter_terms + sample_terms,
            parameter_terms=parameter_terms,
            error_operator=model.error_operator(theta),
            error_precision=error_precision,
            mean_field_curvature=mean_field_curvature,
        )

    def evaluate(self, data: Array, states: Array) -> Array:
        """Computes the free energy F(t) of each sample: a constant less half the weighted squares of errors and states.

        Args:
            data: (T, dim [ỹ; η̃]) generalized data.
            states: (T, dim X) means of the states.

        Returns:
            F(t), (T,), nats.
        """
        errors = np.hstack([data, states]) @ self.error_operator.T
        squares = np.sum(errors @ self.error_precision * errors, axis=1) + np.sum(
            states @ self.mean_field_curvature * states, axis=1
        )
        return self.constant - 0.5 * squares

    def action(self, data: Array, states: Array) -> float:
        """Returns F̄, nats: the sum of F(t) over all samples, with the terms of θ and λ counted once.

        Every F(t) contains these terms, so that T − 1 of them are taken off the sum.

        Args:
            data: (T, dim [ỹ; η̃]) generalized data.
            states: (T, dim X) means of the states.
        """
        return self.evaluate(data, states).sum() - (len(data) - 1) * self.parameter_terms


def expected_noise_precisions(lambda_: Array, lambda_covariance: Array) -> Array:
    """Returns the expected noise precisions e^λ (1 + ½ Σ^λ), (g,), to second order in the uncertainty of λ.

    With them, instead of e^λ, the squared errors include the mean-field term of λ.

    Args:
        lambda_: (g,) means of the log noise precisions.
        lambda_covariance: (g, g) their covariance.
    """
    return np.exp(lambda_) * (1.0 + 0.5 * lambda_covariance.diagonal())


def state_curvature(posterior: Posterior) -> Array:
    """Returns the second derivative U_XX of the internal energy by the states, (dim X, dim X), of any one sample."""
    model = posterior.model
    E_X = model.error_operator(posterior.theta)[:, model.hidden_columns]
    return -E_X.T @ model.error_precision(np.exp(posterior.lambda_)) @ E_X


def theta_curvature(posterior: Posterior) -> Array:
    """Returns the second derivative Ū_θθ of the internal action by the parameters, (k, k).

    The internal action Ū is F̄ without entropies and mean-field terms: the log joint density at the means, summed over
    the samples.

    Args:
        posterior: the posterior, at whose means the derivative is taken.
    """
    error_curvature = posterior.model.error_curvature_in_theta(
        np.exp(posterior.lambda_), posterior.moments.joint_moments
    )
    return -posterior.model.prior.theta_precision - error_curvature


def lambda_curvature(posterior: Posterior) -> Array:
    """Returns the second derivative Ū_λλ of the internal action by the log noise precisions, (g, g).

    The squared errors weighted by e^λ, and the prior, are the only parts of the log joint density Ū that are not linear
    in λ.

    Args:
        posterior: the posterior, at whose means the derivative is taken.
    """
    squares = posterior.moments.squared_errors_by_noise(posterior.theta)
    error_curvature = np.diag(0.5 * np.exp(posterior.lambda_) * squares)
    return -error_curvature - posterior.model.prior.lambda_precision


class Term(StrEnum):
    """Names of the terms of F̄ᵒ, Eq. ``F_action_opt``, as results and documents report them."""

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
    """Returns the terms of F̄ᵒ by name, nats, Eq. ``F_action_opt``: F̄ at optimal covariances.

    The sum of the terms is F̄ᵒ. It is :meth:`SampleFreeEnergy.action` plus half the number of all estimated quantities,
    T · dim X + dim θ + dim λ: at optimal covariances the mean-field terms are constants, which the paper drops.

    Args:
        posterior: a posterior whose covariances are the inverses of the negative curvatures, as
            ``steps.with_optimal_covariances`` makes them.
    """
    model = posterior.model
    log_det_theta_prior, log_det_lambda_prior = model.log_det_prior_precisions
    theta_error, lambda_error = model.prior.squared_errors(posterior.theta, posterior.lambda_)
    T = posterior.samples.sample_count
    # Π̃ times Σ ε̃ε̃ᵀ, entry by entry: the sum over the block of one kind of errors is their Σ ε̃ᵀ Π̃ ε̃.
    weighted_squares = model.error_precision(
        np.exp(posterior.lambda_)
    ) * posterior.moments.error_moments(posterior.theta)
    output_rows, input_rows, state_rows, _ = model.error_rows
    # The error of a prior of x, which comes after those of the states, counts among them.
    state_rows = slice(state_rows.start, None)
    return {
        Term.NOISE_ENTROPY: 0.5 * T * model.log_det_error_precision(posterior.lambda_),
        Term.STATE_AND_INPUT_ENTROPY: 0.5 * T * logdet(posterior.state_covariance),
        Term.PARAMETER_ENTROPY: 0.5 * (logdet(posterior.theta_covariance) + log_det_theta_prior),
        Term.HYPERPARAMETER_ENTROPY: 0.5
        * (logdet(posterior.lambda_covariance) + log_det_lambda_prior),
        Term.PREDICTION_ERROR_OF_OUTPUTS: -0.5 * weighted_squares[output_rows, output_rows].sum(),
        Term.PREDICTION_ERROR_OF_INPUTS: -0.5 * weighted_squares[input_rows, input_rows].sum(),
        Term.PREDICTION_ERROR_OF_STATES: -0.5 * weighted_squares[state_rows, state_rows].sum(),
        Term.PREDICTION_ERROR_OF_PARAMETERS: -0.5 * theta_error,
        Term.PREDICTION_ERROR_OF_HYPERPARAMETERS: -0.5 * lambda_error,
    }
