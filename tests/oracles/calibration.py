"""Simulated roll axes of known parameters: how often a parameter lies in its interval.

DEM's assumptions hold where the derivatives of every sample are drawn independently from the generative model, and
parameters from their prior. The others are sampled flights: varying motors, wind as Gaussian-kernel noise, derivatives
estimated from samples. "Own" is DEM's posterior, "corrected" the sandwich estimate of ``mavdem.dem.fitting``.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from order_systems import motion

from mavdem.confidence import LEVEL, half_width
from mavdem.dem.engine.ascent import ascend
from mavdem.dem.engine.generative import (
    GenerativeModel,
    Prior,
    SufficientStatistics,
    embed,
    sampled_output_precision,
    sampled_state_precision,
    temporal_covariance,
    temporal_precision,
)
from mavdem.dem.engine.model import pack, unpack
from mavdem.dem.fitting import uncertainty_of
from mavdem.dem.priors import KNOWN
from sitl_scenarios.wind import gaussian_noise

Array = NDArray[np.float64]

SYSTEMS = 200
ITERATIONS = 200
P, Q = 2, 1  # embedding orders; the equation of the highest derivative is left out, since its left side is not modelled
FREE = np.array([2, 3, 5])  # indices in θ of the free parameters: stiffness, damping and gain of the rate's equation
VEHICLE, SPREAD = np.array([-9.0, -4.0, 12.0]), np.array([3.0, 1.5, 4.0])  # their prior means and standard deviations


class Coverage(NamedTuple):
    """Share of parameters inside their interval."""

    own: float
    corrected: float


def theta_of(free: Array) -> Array:
    """θ of a roll axis, φ̇ = rate, with C = I."""
    A, B = np.array([[0.0, 1.0], free[:2]]), np.array([[0.0], free[2:]])
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
    correlations, groups = (output_correlation, state_correlation), (np.array([0, 0]), np.array([1, 2]))
    return GenerativeModel(2, 1, 2, P, P, Q, *correlations, *groups, KNOWN * np.eye(P + 1), prior)


KINEMATIC = 16.0  # ln precision of φ̇ = rate


def covered(model: GenerativeModel, data: Array, truth: Array) -> tuple[Array, Array]:
    """Which free parameters lie in DEM's own interval, and in the corrected one."""
    ascent = ascend(model, SufficientStatistics.of(data), ITERATIONS)
    error = np.abs(ascent.belief.theta - truth)[FREE]
    own = half_width(ascent.belief.theta_covariance.diagonal(), LEVEL)
    scatter = uncertainty_of(model, [data], ascent).scatter
    corrected = scatter.half_width(LEVEL) if scatter else np.full(len(truth), np.nan)
    return error <= own[FREE], error <= corrected[FREE]


def as_assumed(lambda_z: float, lambda_w: float, samples: int, smoothness: float) -> Coverage:
    """Coverage where every sample is drawn independently from the generative model."""
    model = generative_model(lambda_z, lambda_w, temporal_precision(P, smoothness), temporal_precision(Q, smoothness))
    return coverage(model, SPREAD, lambda truth, rng: independent_samples(model, truth, samples, smoothness, rng))


def coverage(
    model: GenerativeModel, spread: Array, simulated: Callable[[Array, np.random.Generator], Array]
) -> Coverage:
    """Coverage over ``SYSTEMS`` true parameters; ``simulated`` makes the data of one."""
    inside = []
    for seed in range(SYSTEMS):
        rng = np.random.default_rng(seed)
        truth = theta_of(VEHICLE + spread * rng.standard_normal(3))
        inside.append(covered(model, simulated(truth, rng), truth))
    return Coverage(*np.mean(inside, axis=(0, 2)))


def independent_samples(
    model: GenerativeModel, truth: Array, number: int, smoothness: float, rng: np.random.Generator
) -> Array:
    """[ỹ; η̃] (T, ·): x and ṽ at random, its derivatives by the model with w̃, and z̃ on all of it."""
    A, B, _ = unpack(truth, 2, 1, 2)
    lambda_z, *of_w = model.prior.lambda_mean

    def noise(order: int, sd: Array) -> Array:
        factor = np.linalg.cholesky(temporal_covariance(order, smoothness))
        return np.asarray(np.einsum("ij,tja->tia", factor, rng.standard_normal((number, order + 1, 2))) * sd)

    v = rng.standard_normal((number, P + 1))
    w = noise(Q, np.exp(-np.array(of_w) / 2))
    x = [rng.standard_normal((number, 2))]
    for order in range(Q + 1):
        x.append(x[-1] @ A.T + v[:, order, None] * B[:, 0] + w[:, order])
    y = np.stack(x, axis=1) + noise(P, np.full(2, np.exp(-lambda_z / 2)))
    return np.hstack([y.reshape(number, -1), v])


def sampled(ratio: float, wind: float, samples: int = 700, dt: float = 0.01) -> Coverage:
    """Coverage on flights sampled at ``dt``, in wind (rad/s²) of smoothness ``ratio`` steps."""
    smoothness, window = ratio * dt, P + 1
    model = generative_model(
        18.0,
        -2 * float(np.log(wind)),
        sampled_output_precision(P, smoothness, dt, window),
        sampled_state_precision(Q, smoothness, dt, window),
    )

    def simulated(truth: Array, rng: np.random.Generator) -> Array:
        signals = flight(truth, wind, smoothness, samples, dt, rng)
        return np.hstack([embed(signal, P, dt, window, window // 2) for signal in signals])

    return coverage(model, SPREAD / 3, simulated)


def flight(
    truth: Array, wind: float, smoothness: float, samples: int, dt: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Roll and rate (T, 2) and motors (T, 1), simulated at ten times the sampling rate."""
    A, B, _ = unpack(truth, 2, 1, 2)
    fine, before = 10, 300
    step, number = dt / 10, (samples + before) * 10
    motors = gaussian_noise(0.15, step, number, rng)
    moment = wind * gaussian_noise(smoothness, step, number, rng)
    states = motion(A, np.hstack([B, [[0.0], [1.0]]]), np.stack([motors, moment], axis=1), step)
    kept = slice(before * fine, None, fine)
    return states[kept], motors[kept, None]
