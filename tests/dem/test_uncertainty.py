"""How often the posterior and intervals hold parameters."""

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, mark, raises
from simulated import simulated

from mavdem import Settings, learn
from mavdem.confidence import LEVEL, half_width, quantile, require_probability
from mavdem.dem.engine.ascent import ascend
from mavdem.dem.engine.generative import (
    GenerativeModel,
    Prior,
    SufficientStatistics,
    temporal_covariance,
    temporal_precision,
)
from mavdem.dem.engine.model import pack
from mavdem.dem.priors import KNOWN

SYSTEMS = 60
SAMPLES = 150
# orders of the outputs and states, and of w̃: the equation of the highest derivative is left out, since its left side
# is not modelled
P, Q = 2, 1
SMOOTHNESS = 0.1  # s
# ln precisions of the outputs' noise, of φ̇ = rate, and of the rate's equation, which has the wind
LAMBDA = np.array([18.0, 18.0, 16.0, 2.0])
# prior means and standard deviations of stiffness, damping and gain of the rate's equation, and their places in θ
VEHICLE = np.array([-9.0, -4.0, 12.0])
SPREAD = np.array([3.0, 1.5, 4.0])
FREE = np.array([2, 3, 5])


def roll_axis(stiffness, damping, gain):
    """A, B and C: φ̇ = rate, and both are measured."""
    return np.array([[0.0, 1.0], [stiffness, damping]]), np.array([[0.0], [gain]]), np.eye(2)


def independent_samples(axis, rng):
    """[ỹ; η̃] (T, ·): x and ṽ at random, its derivatives by the model with w̃, and z̃ on all of it."""

    def noise(order, precisions):
        factor = np.linalg.cholesky(temporal_covariance(order, SMOOTHNESS))
        white = rng.standard_normal((SAMPLES, order + 1, 2))
        return np.einsum("ij,tja->tia", factor, white) * np.exp(-precisions / 2)

    A, B, _ = axis
    v = rng.standard_normal((SAMPLES, P + 1))
    w = noise(Q, LAMBDA[2:])
    x = [rng.standard_normal((SAMPLES, 2))]
    for order in range(P):
        x.append(x[-1] @ A.T + v[:, order, None] * B[:, 0] + w[:, order])
    y = np.stack(x, axis=1) + noise(P, LAMBDA[:2])
    return np.hstack([y.reshape(SAMPLES, -1), v])


@mark.slow
def test_intervals_hold_parameters_where_the_assumptions_hold():
    """The derivatives of every sample are drawn independently from the generative model, parameters from their prior.

    Everything else is known, and the wind's λ to within a standard deviation of 1.
    """
    mean = pack(*roll_axis(*VEHICLE))
    precision = KNOWN * np.eye(len(mean))
    precision[FREE, FREE] = SPREAD**-2.0
    prior = Prior(mean, precision, LAMBDA, np.diag([KNOWN, KNOWN, KNOWN, 1.0]))
    correlations = temporal_precision(P, SMOOTHNESS), temporal_precision(Q, SMOOTHNESS)
    groups = np.arange(2), np.arange(2, 4)
    model = GenerativeModel(2, 1, 2, P, P, Q, *correlations, *groups, KNOWN * np.eye(P + 1), prior)
    inside = []
    for seed in range(SYSTEMS):
        rng = default_rng(seed)
        truth = VEHICLE + SPREAD * rng.standard_normal(3)
        data = independent_samples(roll_axis(*truth), rng)
        belief = ascend(model, SufficientStatistics.of(data), 200).belief
        half = half_width(belief.theta_covariance.diagonal(), LEVEL)
        inside.append(abs(belief.theta[FREE] - truth) <= half[FREE])
    assert 0.85 <= np.mean(inside) <= 0.95


def test_without_a_simulation_error_fit_no_interval_is_reported():
    assert np.isnan(learn(simulated(wind=0.5)[:700], Settings.paper()).model_interval().A).all()


@mark.parametrize("level", [0, 1, np.nan, "x", True])
def test_a_level_that_is_no_probability_is_named(level):
    with raises(ValueError, match="^level must"):
        require_probability(level)


def test_half_widths_are_those_of_normal_deviations_or_of_students():
    widths = half_width(np.array([1.0, 4.0, 4.0]), 0.9, [np.inf, np.inf, 3.0])
    assert_allclose(widths, [1.645, 3.290, 4.707], rtol=1e-3)
    assert quantile() == approx(float(half_width(1.0)))
