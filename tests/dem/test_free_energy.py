"""Every step, rate and precision is checked against the one function that says what F̄ is."""

import numpy as np
from hypothesis import given, settings
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, mark, param
from random_models import models, random_posterior, random_samples, seeds
from scipy.linalg import block_diag
from simulated import simulated

from mavdem import Settings
from mavdem.dem.engine.ascent import maximise_free_energy, posterior_after_each_round
from mavdem.dem.engine.free_energy import (
    SampleFreeEnergy,
    Term,
    free_energy_terms,
    lambda_curvature,
    state_curvature,
    theta_curvature,
)
from mavdem.dem.engine.linalg import logdet
from mavdem.dem.engine.model import unpack
from mavdem.dem.engine.moments import SufficientStatistics
from mavdem.dem.engine.steps import (
    FreeEnergyOfLambda,
    d_step,
    e_step,
    m_step,
    state_gradient,
    theta_gradient,
    theta_precision,
    with_optimal_covariances,
)
from mavdem.dem.fitting import generalized_data, generative_model
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling


def lambda_gradient(posterior):
    return FreeEnergyOfLambda.from_posterior(posterior).derivatives(posterior.lambda_)


def of_any_model(test):
    return settings(max_examples=20)(given(model=models, seed=seeds)(test))


def random_samples_and_posterior(seed, model):
    samples = random_samples(seed, model)
    return samples, random_posterior(seed, model, samples)[1]


def gradient(function, at):
    """Central differences."""
    slope = np.empty(at.size)
    for i in range(at.size):
        step = 1e-4 * np.eye(1, at.size, i).reshape(at.shape)
        slope[i] = (function(at + step) - function(at - step)) / 2e-4
    return slope.reshape(at.shape)


def close(actual, expected):
    assert_allclose(actual, expected, atol=1e-6 * (abs(expected).max() + 1))


@mark.slow
@of_any_model
def test_gradients_are_those_of_the_free_energy(model, seed):
    """Gradients and curvatures equal numeric derivatives of the free energy, at a random posterior.

    The derivatives are of F by X, and of the action by θ and λ, with the mean-field terms.
    """
    rng = default_rng(seed)
    data = rng.standard_normal((5, model.hidden_columns.start))
    samples = SufficientStatistics.from_segments(data)
    state_map, posterior = random_posterior(seed, model, samples)
    states = data @ state_map.T

    data_gain, precision = state_gradient(posterior)
    energy = SampleFreeEnergy.from_posterior(posterior)
    numeric = gradient(lambda X: energy.evaluate(data, X).sum(), states)
    close(data @ data_gain.T - states @ precision, numeric)

    def action(**changed):
        changed_energy = SampleFreeEnergy.from_posterior(posterior._replace(**changed))
        return changed_energy.evaluate(data, states).sum()

    slope, precision = theta_gradient(posterior), theta_precision(posterior)
    close(slope, gradient(lambda at: action(theta=at), posterior.theta))
    direction = rng.standard_normal(len(slope))
    gradient_ahead, gradient_behind = (
        theta_gradient(posterior._replace(theta=posterior.theta + d))
        for d in (direction, -direction)
    )
    close(precision @ direction, (gradient_behind - gradient_ahead) / 2)

    slope, precision = lambda_gradient(posterior)
    close(slope, gradient(lambda at: action(lambda_=at), posterior.lambda_))
    direction = rng.standard_normal(len(slope))
    directional_gradient = gradient(
        lambda at: direction @ lambda_gradient(posterior._replace(lambda_=at))[0],
        posterior.lambda_,
    )
    close(-precision @ direction, directional_gradient)


@of_any_model
def test_internal_energy_has_the_curvatures_of_free_energy_without_uncertainty(model, seed):
    """Without mean-field terms; those of the free energy are compared with differences above."""
    samples, posterior = random_samples_and_posterior(seed, model)
    sure = posterior._replace(
        **{
            name: 0 * getattr(posterior, name)
            for name in ("state_covariance", "theta_covariance", "lambda_covariance")
        }
    )
    of_states = state_gradient(sure)
    close(-state_curvature(posterior), of_states[1])
    close(-theta_curvature(posterior), theta_precision(sure))
    close(-lambda_curvature(posterior), lambda_gradient(sure)[1])


@of_any_model
def test_each_step_ends_where_the_gradient_of_the_free_energy_is_zero(model, seed):
    """By the gradients that the test above compares with differences."""
    samples, posterior = random_samples_and_posterior(seed, model)
    data_gain, precision = state_gradient(posterior)
    close(precision @ d_step(posterior), data_gain)
    start_slope = abs(theta_gradient(posterior)).max()
    slope = theta_gradient(posterior._replace(theta=e_step(posterior)))
    assert abs(slope).max() < 1e-6 * (start_slope + samples.sample_count)
    slope, _ = lambda_gradient(posterior._replace(lambda_=m_step(posterior)))
    assert abs(slope).max() < 1e-5 * samples.sample_count


@of_any_model
def test_each_term_of_the_samples_sums_to_that_of_the_free_energy_action(model, seed):
    data = default_rng(seed).standard_normal((6, model.hidden_columns.start))
    samples = SufficientStatistics.from_segments(data)
    posterior = with_optimal_covariances(random_posterior(seed, model, samples)[1])
    energy = SampleFreeEnergy.from_posterior(posterior)
    sums = dict(zip(Term, energy.terms(data).sum(axis=0), strict=True))
    # At optimal covariances the mean-field term has only a constant, which is not counted.
    assert sums.pop(Term.MEAN_FIELD) == approx(0.0, abs=1e-6)
    terms = free_energy_terms(posterior)
    assert sums == approx(terms, rel=1e-9, abs=1e-6)
    assert energy.evaluate(data).sum() == approx(sum(terms.values()), rel=1e-9, abs=1e-6)


def log_density(error, precision):
    """But for what every precision of that size has in common."""
    return 0.5 * (np.linalg.slogdet(precision)[1] - error @ precision @ error)


@of_any_model
def test_the_energy_is_that_of_the_generative_model_written_out(model, seed):
    """With entropies; by sample, with Ã, B̃, C̃, D and Π̃ as Eqs. ``generative_process`` and ``free_E`` write them."""
    rng = default_rng(seed)
    n, r, m, p, d, q = (getattr(model, name) for name in "nrmpdq")
    outputs = rng.standard_normal((5, m * (p + 1)))
    inputs = rng.standard_normal((5, r * (d + 1)))
    data = np.hstack([outputs, inputs])
    samples = SufficientStatistics.from_segments(data)
    state_map, posterior = random_posterior(seed, model, samples)
    A, B, C = unpack(posterior.theta, n, r, m)
    x, v = np.split(data @ state_map.T, [n * (p + 1)], axis=1)
    # Of the equation of order i, i + 1 of x on its left side, and i of x and of v on its right.
    left = np.kron(np.eye(q + 1, p + 1, 1), np.eye(n)) - np.kron(np.eye(q + 1, p + 1), A)
    of_x = x @ left.T - v @ np.kron(np.eye(q + 1, d + 1), B).T
    of_y = outputs - x @ np.kron(np.eye(p + 1), C).T
    noise = np.exp(posterior.lambda_)
    precision = block_diag(
        np.kron(model.output_temporal_precision, np.diag(noise[model.output_groups])),
        model.input_precision,
        np.kron(model.state_temporal_precision, np.diag(noise[model.state_groups])),
    )
    prior = model.prior
    energy = log_density(posterior.theta - prior.theta_mean, prior.theta_precision)
    energy += log_density(posterior.lambda_ - prior.lambda_mean, prior.lambda_precision)
    for error, states in zip(np.hstack([of_y, v - inputs, of_x]), x, strict=True):
        energy += log_density(error, precision)
        if model.state_precision is not None:
            energy += log_density(states[:n], model.state_precision)
        energy += logdet(posterior.state_covariance) / 2
    energy += (logdet(posterior.theta_covariance) + logdet(posterior.lambda_covariance)) / 2
    terms = free_energy_terms(posterior)
    assert sum(terms.values()) == approx(energy, rel=1e-9)


@mark.slow
@given(model=models, seed=seeds)
@settings(max_examples=30)
def test_the_free_energy_never_decreases(model, seed):
    data = default_rng(seed).standard_normal((40, model.hidden_columns.start))
    ascent = maximise_free_energy(model, SufficientStatistics.from_segments(data), 12)
    assert (np.diff(ascent.free_energy) >= 0).all() and np.isfinite(ascent.learning.theta).all()
    assert (
        len(ascent.learning.theta)
        == len(ascent.learning.lambda_)
        == len(ascent.free_energy)
        <= 12 + 1
    )


def problem(**settings):
    complete = Settings(**{"order": 3, "d": 2, "window": 9, "parameter_precision": 1.0, **settings})
    record = Record.from_flights(simulated(wind=0.5)[:700])
    scaling = Scaling.from_record(record, complete)
    model = generative_model(complete, scaling, record)
    return model, SufficientStatistics.from_segments(*generalized_data(complete, scaling, record))


@mark.slow
@mark.parametrize("settings", [param({}, marks=mark.in_full), {"order": 2, "window": 3}])
def test_a_converged_ascent_has_nothing_left_to_gain(settings):
    model, samples = problem(**settings)
    finished = maximise_free_energy(model, samples, 300)
    assert finished.converged
    posterior = posterior_after_each_round(model, samples, 300)[-1]
    assert sum(free_energy_terms(posterior).values()) < finished.free_energy[-1] + 1
