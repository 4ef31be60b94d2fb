"""Simulated roll axes of known parameters: how often a parameter lies in its interval.

DEM's assumptions hold: the derivatives of every sample are drawn independently from the generative model, and
parameters from their prior.
"""

from dataclasses import replace

import numpy as np
from dem_posterior import Embedding, generative_model, roll
from joint_gaussian import ParameterPrior
from numpy.random import default_rng

from mavdem.confidence import LEVEL, half_width
from mavdem.dem.engine.ascent import ascend
from mavdem.dem.engine.generative import SufficientStatistics, temporal_covariance
from mavdem.dem.priors import KNOWN

SYSTEMS = 60
SAMPLES = 150
ITERATIONS = 200
# the equation of the highest derivative is left out, since its left side is not modelled
EMBEDDING = Embedding(p=2, q=1)
LAMBDA_Z = 18.0  # ln precision of the outputs' noise
KINEMATIC = 16.0  # ln precision of φ̇ = rate
LAMBDA_W = 2.0  # ln precision of the rate's equation, which has the wind
# prior means and standard deviations of stiffness, damping and gain of the rate's equation
VEHICLE = np.array([-9.0, -4.0, 12.0])
SPREAD = np.array([3.0, 1.5, 4.0])


def coverage():
    """Share of the free parameters inside DEM's own interval, over ``SYSTEMS`` true ones.

    Everything else is known, and the wind's λ to within a standard deviation of 1.
    """
    noise = np.exp(-np.array([KINEMATIC, LAMBDA_W]) / 2)
    axis = replace(roll(1, np.exp(-LAMBDA_Z / 2)).at(VEHICLE), state_noise=noise)
    model = generative_model(axis, EMBEDDING, ParameterPrior(VEHICLE, np.diag(SPREAD**-2.0)))
    of_noise = np.diag([KNOWN, KNOWN, KNOWN, 1.0])
    model = replace(model, prior=model.prior._replace(lambda_precision=of_noise))
    inside = []
    for seed in range(SYSTEMS):
        rng = default_rng(seed)
        truth = axis.at(VEHICLE + SPREAD * rng.standard_normal(3))
        data = independent_samples(truth, rng)
        belief = ascend(model, SufficientStatistics.of(data), ITERATIONS).belief
        half = half_width(belief.theta_covariance.diagonal(), LEVEL)
        inside.append((abs(belief.theta - truth.theta) <= half)[truth.free])
    return float(np.mean(inside))


def independent_samples(truth, rng):
    """[ỹ; η̃] (T, ·): x and ṽ at random, its derivatives by the model with w̃, and z̃ on all of it."""
    p = EMBEDDING.p

    def noise(order, sd):
        factor = np.linalg.cholesky(temporal_covariance(order, truth.smoothness))
        white = rng.standard_normal((SAMPLES, order + 1, 2))
        return np.asarray(np.einsum("ij,tja->tia", factor, white) * sd)

    v = rng.standard_normal((SAMPLES, p + 1))
    w = noise(EMBEDDING.q, truth.state_noise)
    x = [rng.standard_normal((SAMPLES, 2))]
    for order in range(p):
        x.append(x[-1] @ truth.A.T + v[:, order, None] * truth.B[:, 0] + w[:, order])
    y = np.stack(x, axis=1) + noise(p, truth.output_noise)
    return np.hstack([y.reshape(SAMPLES, -1), v])
