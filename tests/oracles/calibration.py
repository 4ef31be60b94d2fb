"""Simulated roll axes of known parameters: how often a parameter lies in its interval.

DEM's assumptions hold: the derivatives of every sample are drawn independently from the generative model, and
parameters from their prior.
"""

import numpy as np
from numpy.typing import NDArray

from mavdem.confidence import LEVEL, half_width
from mavdem.dem.engine.ascent import ascend
from mavdem.dem.engine.generative import (
    GenerativeModel,
    Prior,
    SufficientStatistics,
    temporal_covariance,
    temporal_precision,
)
from mavdem.dem.engine.model import pack, unpack
from mavdem.dem.priors import KNOWN

Array = NDArray[np.float64]

SYSTEMS = 200
ITERATIONS = 200
# embedding orders; the equation of the highest derivative is left out, since its left side is not modelled
P = 2
Q = 1
# indices in θ of the free parameters: stiffness, damping and gain of the rate's equation
FREE = np.array([2, 3, 5])
# their prior means and standard deviations
VEHICLE = np.array([-9.0, -4.0, 12.0])
SPREAD = np.array([3.0, 1.5, 4.0])


def theta_of(free: Array) -> Array:
    """θ of a roll axis, φ̇ = rate, with C = I."""
    A = np.array([[0.0, 1.0], free[:2]])
    B = np.array([[0.0], free[2:]])
    return pack(A, B, np.eye(2))


def generative_model(
    lambda_z: float, lambda_w: float, output_correlation: Array, state_correlation: Array
) -> GenerativeModel:
    """Everything known but the free parameters; λ to within a standard deviation of 1."""
    precision = KNOWN * np.eye(10)
    precision[FREE, FREE] = SPREAD**-2.0
    # The kinematic relation has next to no noise; the rate's equation has the wind.
    lambda_mean = np.array([lambda_z, KINEMATIC, lambda_w])
    lambda_precision = np.diag([KNOWN, KNOWN, 1.0])
    prior = Prior(theta_of(VEHICLE), precision, lambda_mean, lambda_precision)
    correlations = (output_correlation, state_correlation)
    groups = (np.array([0, 0]), np.array([1, 2]))
    return GenerativeModel(2, 1, 2, P, P, Q, *correlations, *groups, KNOWN * np.eye(P + 1), prior)


KINEMATIC = 16.0  # ln precision of φ̇ = rate


def coverage(lambda_z: float, lambda_w: float, samples: int, smoothness: float) -> float:
    """Share of the free parameters inside DEM's own interval, over ``SYSTEMS`` true ones."""
    model = generative_model(
        lambda_z, lambda_w, temporal_precision(P, smoothness), temporal_precision(Q, smoothness)
    )
    inside = []
    for seed in range(SYSTEMS):
        rng = np.random.default_rng(seed)
        truth = theta_of(VEHICLE + SPREAD * rng.standard_normal(3))
        data = independent_samples(model, truth, samples, smoothness, rng)
        belief = ascend(model, SufficientStatistics.of(data), ITERATIONS).belief
        half = half_width(belief.theta_covariance.diagonal(), LEVEL)
        inside.append((np.abs(belief.theta - truth) <= half)[FREE])
    return float(np.mean(inside))


def independent_samples(
    model: GenerativeModel, truth: Array, number: int, smoothness: float, rng: np.random.Generator
) -> Array:
    """[ỹ; η̃] (T, ·): x and ṽ at random, its derivatives by the model with w̃, and z̃ on all of it."""
    A, B, _ = unpack(truth, 2, 1, 2)
    lambda_z, *of_w = model.prior.lambda_mean

    def noise(order: int, sd: Array) -> Array:
        factor = np.linalg.cholesky(temporal_covariance(order, smoothness))
        return np.asarray(
            np.einsum("ij,tja->tia", factor, rng.standard_normal((number, order + 1, 2))) * sd
        )

    v = rng.standard_normal((number, P + 1))
    w = noise(Q, np.exp(-np.array(of_w) / 2))
    x = [rng.standard_normal((number, 2))]
    for order in range(Q + 1):
        x.append(x[-1] @ A.T + v[:, order, None] * B[:, 0] + w[:, order])
    y = np.stack(x, axis=1) + noise(P, np.full(2, np.exp(-lambda_z / 2)))
    return np.hstack([y.reshape(number, -1), v])
