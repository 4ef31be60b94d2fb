"""Variational free energy F̄ (log evidence) of a linear model with states X, parameters θ, log noise precisions λ.

It is the one definition of F̄ that the D, E and M steps maximise, an approximation of the log evidence of the model.

F(t) is the free energy of one sample, and F̄, the free energy action, its sum over the training samples: learning, the
results of a flight and the online learner all take F(t) from :class:`SampleFreeEnergy`. Every gradient and curvature of
the steps is tested against finite differences of this definition.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.engine.generative import GenerativeModel
from mavdem.dem.engine.linalg import logdet
from mavdem.dem.engine.moments import GeneralizedMoments, SufficientStatistics


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


class Term(StrEnum):
    """Names of the terms of the free energy, as results and documents report them.

    All but the last are the terms of F̄ᵒ, Eq. ``F_action_opt``.
    """

    NOISE_ENTROPY = "noise entropy"
    STATE_AND_INPUT_ENTROPY = "state and input entropy"
    PARAMETER_ENTROPY = "parameter entropy"
    HYPERPARAMETER_ENTROPY = "hyperparameter entropy"
    PREDICTION_ERROR_OF_OUTPUTS = "prediction error of outputs"
    PREDICTION_ERROR_OF_INPUTS = "prediction error of inputs"
    PREDICTION_ERROR_OF_STATES = "prediction error of states"
    PREDICTION_ERROR_OF_PARAMETERS = "prediction error of parameters"
    PREDICTION_ERROR_OF_HYPERPARAMETERS = "prediction error of hyperparameters"

    MEAN_FIELD = "mean field"
    """What the uncertainty of states, parameters and noises adds to one sample's expected squared errors.

    It is counted from its mean over the training samples, so that it sums to zero over these.
    """


SAMPLE_TERMS = (
    Term.PREDICTION_ERROR_OF_OUTPUTS,
    Term.PREDICTION_ERROR_OF_INPUTS,
    Term.PREDICTION_ERROR_OF_STATES,
    Term.MEAN_FIELD,
)
"""The terms that differ from sample to sample; all others are the same at every sample of a model."""


SAMPLE_TERM_COLUMNS = [list(Term).index(term) for term in SAMPLE_TERMS]
"""Columns of the ``SAMPLE_TERMS`` among all terms."""


EVALUATED_SAMPLES = 1 << 16
"""Number of samples whose free energies are computed at once: a choice, eleven minutes at 100 Hz."""


@dataclass(frozen=True, eq=False)
class SampleFreeEnergy:
    """The free energy F(t) of one sample, as a function of its data and its states, at a fixed posterior of θ and λ.

    F(t) is the contribution of one sample to the free energy action F̄: summed over the training samples it is F̄. Its
    terms have the names of the terms of F̄, and each sums to the term of F̄ with its name.

    - The squared errors of outputs, inputs and states, the noise entropy, and the entropy of states and inputs belong
      to the sample.
    - The priors and entropies of θ and λ, the complexity of the model, belong to the training data as a whole. Every
      sample has an equal share, one T-th for T training samples.
    - The mean-field term W is the expectation of the curvature, ½ tr(Σ U_ϑϑ), with the ½ that Eq. ``F_bar_MF`` has and
      Eq. ``free_E`` has lost. Half the number of estimated quantities, the constant in the entropy of a Gaussian, is
      counted with it: so the term sums to zero where all covariances are optimal, as in F̄ᵒ of Eq. ``F_action_opt``.

    Constants in 2π are left out.
    """

    constants: Array
    """(10,) the terms of a sample without errors and with zero states, nats, in the order of ``Term``."""

    error_operator: Array
    """E with the errors ε̃ = E [ỹ; η̃; X]."""

    error_precision: Array
    """(dim ε̃, dim ε̃) precision Π̃ of the errors, at the mean of λ."""

    error_weights: Array
    """(dim ε̃, 4) weights that sum the weighted squares of the errors to the ``SAMPLE_TERMS``."""

    mean_field_curvature: Array
    """(dim X, dim X) penalty of the states, which the uncertainty of θ makes."""

    state_map: Array
    """(dim X, dim [ỹ; η̃]) map from the data of a sample to the posterior means of its states."""

    @classmethod
    def from_posterior(cls, posterior: Posterior) -> SampleFreeEnergy:
        """Prepares the free energy F(t) as a function of one sample, for the posterior of the training data.

        Args:
            posterior: the posterior, with the number of training samples.

        Returns:
            The function, with all factors that do not depend on the sample.
        """
        model = posterior.model
        totals = _terms_without_sample_errors(posterior)
        totals[Term.MEAN_FIELD] = _mean_field_constant(posterior)
        # Terms of the training data as a whole are divided equally among its samples.
        sample_count = posterior.samples.sample_count
        constants = np.array([totals.get(term, 0.0) / sample_count for term in Term])
        noise_precisions = np.exp(posterior.lambda_)
        return cls(
            constants=constants,
            error_operator=model.error_operator(posterior.theta),
            error_precision=model.error_precision(noise_precisions),
            error_weights=_error_weights(posterior),
            mean_field_curvature=model.mean_field_curvature_in_states(
                noise_precisions, posterior.theta_covariance
            ),
            state_map=posterior.state_map,
        )

    def terms(self, data: Array, states: Array | None = None) -> Array:
        """Computes the terms of the free energy F(t) of each sample, such as the prediction error of the outputs.

        Args:
            data: (T, dim [ỹ; η̃]) outputs ỹ and inputs η̃ with their derivatives, a row for each sample.
            states: (T, dim X) means of the states; None to estimate them from the data by the posterior.

        Returns:
            (T, 10) terms in the order of ``Term``, nats, which sum to F(t).
        """
        if states is None:
            states = data @ self.state_map.T
            errors = data @ self._error_map.T
        else:
            errors = np.hstack([data, states]) @ self.error_operator.T
        return self.terms_of_errors(errors, states)

    def terms_of_errors(self, errors: Array, states: Array) -> Array:
        """Computes the terms of F(t) of samples whose prediction errors and states are known.

        Each term is a constant (log determinants, entropies) minus half of the sum of its squared prediction errors,
        weighted by their precision. The mean-field term is quadratic in the states as well.

        Args:
            errors: (T, dim ε̃) prediction errors.
            states: (T, dim X) means of the states.

        Returns:
            (T, 10) terms in the order of ``Term``, nats, which sum to F(t).
        """
        # The summands of ε̃ᵀ Π̃ ε̃, one for each entry of ε̃ (T, dim ε̃), are summed by the weights to the four terms that
        # differ between samples (T, 4).
        weighted_squares = errors @ self.error_precision * errors
        squares_by_term = weighted_squares @ self.error_weights
        # The uncertainty of θ adds a square of the states to the mean-field term.
        squares_of_states = np.sum(states @ self.mean_field_curvature * states, axis=1)
        squares_by_term[:, SAMPLE_TERMS.index(Term.MEAN_FIELD)] += squares_of_states
        terms = np.empty((len(errors), len(self.constants)))
        terms[:] = self.constants
        terms[:, SAMPLE_TERM_COLUMNS] -= 0.5 * squares_by_term
        return terms

    @cached_property
    def error_and_state_map(self) -> Array:
        """(dim ε̃ + dim X, dim [ỹ; η̃]) map from the data of a sample to its errors and its states."""
        return np.vstack([self._error_map, self.state_map])

    @cached_property
    def _error_map(self) -> Array:
        """(dim ε̃, dim [ỹ; η̃]) map from the data of a sample to its errors, at the posterior means of the states."""
        data_map = np.eye(self.state_map.shape[1])
        return self.error_operator @ np.vstack([data_map, self.state_map])

    def evaluate(self, data: Array, states: Array | None = None) -> Array:
        """Computes the free energy F(t) of each sample, the sum of its terms.

        Args:
            data: (T, dim [ỹ; η̃]) generalized data.
            states: (T, dim X) means of the states; None to estimate them from the data by the posterior.

        Returns:
            F(t), (T,), nats.
        """
        if states is not None:
            return self.terms(data, states).sum(axis=1)
        # The samples are processed in chunks: the states and errors of an hour of flight would need hundreds of
        # megabytes.
        free_energy = np.empty(len(data))
        for start in range(0, len(data), EVALUATED_SAMPLES):
            chunk = slice(start, start + EVALUATED_SAMPLES)
            free_energy[chunk] = self.terms(data[chunk]).sum(axis=1)
        return free_energy


def _error_weights(posterior: Posterior) -> Array:
    """Returns the weight of each squared prediction error in each of the four ``SAMPLE_TERMS``.

    Those terms are the errors of outputs, of inputs and of states, and the mean-field term. The weight is 1 in the term
    that the error belongs to. The mean-field term contains what the uncertainty of λ adds to the squared errors: there
    the weight is the relative increase of the expected precision of the error's noise.

    Args:
        posterior: means and covariances of states, θ and λ, given the training data.

    Returns:
        Weights (dim ε̃, 4).
    """
    model = posterior.model
    expected_precisions = expected_noise_precisions(posterior.lambda_, posterior.lambda_covariance)
    # Errors that do not depend on λ have the index −1, which selects the 0 that is appended at the end.
    relative_increases = np.append(expected_precisions / np.exp(posterior.lambda_) - 1.0, 0.0)
    rows = _error_rows_by_term(model)
    weights = np.zeros((len(model.noise_of_error), len(SAMPLE_TERMS)))
    for column, term in enumerate(SAMPLE_TERMS):
        if term is Term.MEAN_FIELD:
            weights[:, column] = relative_increases[model.noise_of_error]
        else:
            weights[rows[term], column] = 1.0
    return weights


def expected_noise_precisions(lambda_: Array, lambda_covariance: Array) -> Array:
    """Returns the expected noise precisions e^λ (1 + ½ Σ^λ), to second order in the uncertainty of λ.

    If squared errors are weighted by them instead of by e^λ, the result includes the mean-field term of λ.

    Args:
        lambda_: (g,) means of the log noise precisions.
        lambda_covariance: (g, g) their covariance.

    Returns:
        The precisions (g,).
    """
    return np.exp(lambda_) * (1.0 + 0.5 * lambda_covariance.diagonal())


def state_curvature(posterior: Posterior) -> Array:
    """Returns the second derivative U_XX of the internal energy by the states, (dim X, dim X), of any one sample."""
    model = posterior.model
    E_X = model.error_operator(posterior.theta)[:, model.hidden_columns]
    return -E_X.T @ model.error_precision(np.exp(posterior.lambda_)) @ E_X


def theta_curvature(posterior: Posterior) -> Array:
    """Returns the second derivative Ū_θθ of the internal action by the parameters.

    The internal action Ū is F̄ without entropies and mean-field terms: the log joint density at the means, summed over
    the samples.

    Args:
        posterior: the posterior, at whose means the derivative is taken.

    Returns:
        The second derivative Ū_θθ (k, k).
    """
    error_curvature = posterior.model.error_curvature_in_theta(
        np.exp(posterior.lambda_), posterior.moments.regressor_moments
    )
    return -posterior.model.prior.theta_precision - error_curvature


def lambda_curvature(posterior: Posterior) -> Array:
    """Returns the second derivative Ū_λλ of the internal action by the log noise precisions.

    Only the squared errors, which are weighted by e^λ, and the prior contribute: all other terms of the log joint
    density Ū are linear in λ.

    Args:
        posterior: the posterior, at whose means the derivative is taken.

    Returns:
        The second derivative Ū_λλ (g, g).
    """
    squares = posterior.moments.squared_errors_by_noise(posterior.theta)
    error_curvature = np.diag(0.5 * np.exp(posterior.lambda_) * squares)
    return -error_curvature - posterior.model.prior.lambda_precision


def free_energy_terms(posterior: Posterior) -> Mapping[str, float]:
    """Computes the terms of the free energy F̄ of all training samples, at optimal covariances (F̄ᵒ).

    Three terms are sums of the samples' squared prediction errors of outputs, of inputs and of states, weighted by
    their precision: −½ Σ ε̃ᵀ Π̃ ε̃. The others, entropies and priors, do not depend on these errors. The mean-field
    term is zero at optimal covariances, and is left out. The errors of all samples enter only by the sums of their
    products, so that no loop over samples is needed.

    :class:`SampleFreeEnergy` has the same terms for each sample. The formula is Eq. ``F_action_opt`` of the paper
    (docs/mathematics.md).

    Args:
        posterior: a posterior whose covariances are the inverses of the negative curvatures, as
            ``steps.with_optimal_covariances`` makes them.

    Returns:
        The terms by name, nats.
    """
    model = posterior.model
    error_precision = model.error_precision(np.exp(posterior.lambda_))
    error_moments = posterior.moments.error_moments(posterior.theta)
    # Π̃ times Σ ε̃ε̃ᵀ, entry by entry. The sum of these products over the rows and columns of the errors of the outputs
    # is their Σ ε̃ᵀ Π̃ ε̃; the same holds for inputs and states.
    weighted_squares = error_precision * error_moments
    terms = _terms_without_sample_errors(posterior)
    for term, rows in _error_rows_by_term(model).items():
        terms[term] = -0.5 * weighted_squares[rows, rows].sum()
    return {term: terms[term] for term in Term if term is not Term.MEAN_FIELD}


def _error_rows_by_term(model: GenerativeModel) -> Mapping[Term, slice]:
    """Returns the rows of the vector of prediction errors ε̃ that belong to each term of the free energy.

    Three terms are weighted sums of squared prediction errors: of the outputs, of the inputs, and of the states. The
    last one includes the prior of the state x, whose error is x itself, if the model has this prior.

    Args:
        model: model in generalised coordinates, which gives the order of the errors in ε̃.

    Returns:
        A contiguous range of rows for each of the three terms.
    """
    rows = model.error_rows
    # The rows of the prior follow those of the states.
    rows_of_states_and_prior = slice(rows.states.start, rows.state_prior.stop)
    return {
        Term.PREDICTION_ERROR_OF_OUTPUTS: rows.outputs,
        Term.PREDICTION_ERROR_OF_INPUTS: rows.inputs,
        Term.PREDICTION_ERROR_OF_STATES: rows_of_states_and_prior,
    }


def _terms_without_sample_errors(posterior: Posterior) -> dict[Term, float]:
    """Returns the terms of F̄ that do not depend on the errors of samples, summed over the training data.

    Args:
        posterior: estimates of states, parameters and noise precisions, with their covariances.

    Returns:
        The terms by name, nats.
    """
    model = posterior.model
    log_det_prior = model.log_det_prior_precisions
    squared_error = model.prior.squared_errors(posterior.theta, posterior.lambda_)
    T = posterior.samples.sample_count
    return {
        Term.NOISE_ENTROPY: 0.5 * T * model.log_det_error_precision(posterior.lambda_),
        Term.STATE_AND_INPUT_ENTROPY: 0.5 * T * logdet(posterior.state_covariance),
        Term.PARAMETER_ENTROPY: 0.5 * (logdet(posterior.theta_covariance) + log_det_prior.theta),
        Term.HYPERPARAMETER_ENTROPY: 0.5
        * (logdet(posterior.lambda_covariance) + log_det_prior.lambda_),
        Term.PREDICTION_ERROR_OF_PARAMETERS: -0.5 * squared_error.theta,
        Term.PREDICTION_ERROR_OF_HYPERPARAMETERS: -0.5 * squared_error.lambda_,
    }


def _mean_field_constant(posterior: Posterior) -> float:
    """Returns the constant in the mean-field term of F̄: what depends neither on errors nor on states.

    The mean-field term is what the uncertainty of the states X, of θ and of λ adds to F̄: for each of the three
    ½ (tr(Σ H) + d). Here Σ is its posterior covariance, H is the second derivative of the log joint density with
    respect to it, which is negative definite, and d is the number of its entries.

    For the states, H is the same at every sample, so that the whole term is constant. For θ and λ, H is −P, with the
    precision P of the prior, minus a matrix that the data determine. With −P the term is the constant ½ (d − tr(Σ P)).
    The rest is quadratic in the states (for θ) or in the errors (for λ): ``SampleFreeEnergy`` adds it sample by sample.

    Args:
        posterior: estimates of states, parameters and noise precisions, with their covariances.

    Returns:
        The constant of all training samples together, nats: the states contribute once for each sample, θ and λ once.
    """
    prior = posterior.model.prior
    # The sum of the elementwise product of two symmetric matrices is the trace of their product.
    state_trace = np.sum(posterior.state_covariance * state_curvature(posterior))
    theta_trace = np.sum(posterior.theta_covariance * prior.theta_precision)
    lambda_trace = np.sum(posterior.lambda_covariance * prior.lambda_precision)
    state_term = state_trace + len(posterior.state_covariance)
    theta_term = len(posterior.theta) - theta_trace
    lambda_term = len(posterior.lambda_) - lambda_trace
    return 0.5 * float(posterior.samples.sample_count * state_term + theta_term + lambda_term)
