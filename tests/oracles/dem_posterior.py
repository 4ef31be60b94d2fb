"""DEM of series from known systems, one state that decays and a stabilised roll angle: states and parameters."""

from typing import NamedTuple

import numpy as np
from joint_gaussian import ParameterPrior, System
from numpy.typing import NDArray

from mavdem.dem.engine.ascent import ascend
from mavdem.dem.engine.free_energy import state_curvature
from mavdem.dem.engine.generative import (
    GenerativeModel,
    Prior,
    SufficientStatistics,
    embed,
    sampled_output_precision,
    sampled_state_precision,
    temporal_precision,
)
from mavdem.dem.engine.linalg import inverse
from mavdem.dem.engine.steps import d_step
from mavdem.dem.priors import KNOWN

Array = NDArray[np.float64]

DT = 0.1  # seconds; both systems respond within about one second
LEAD = 40  # samples before the first at which the states start
# of the relation that makes the rate the derivative of the roll angle, rad/s
KINEMATIC_NOISE = 0.03


def decay(
    smoothness: float,
    output_noise: float,
    *,
    gain: float = 0.0,
    samples: int = 90,
) -> System:
    """ẋ = −x + gain·u + w, y = x + z, with the rate of decay free, and the gain too where there is one."""
    A = np.array([[-1.0]])
    B = np.array([[gain]])
    C = np.eye(1)
    noise = np.array([1.0]), np.array([output_noise])
    free = np.arange(2 if gain else 1)
    start = np.array([1.0])
    return System(A, B, C, *noise, smoothness * DT, DT, samples, LEAD, start, doublets, free)


def roll(smoothness: float, output_noise: float, *, outputs: int = 2) -> System:
    """φ̇ = rate; the rate has stiffness, damping and gain, which are free, and noise; one output is the angle alone."""
    A = np.array([[0.0, 1.0], [-4.0, -1.2]])
    B = np.array([[0.0], [4.0]])
    C = np.eye(outputs, 2)
    noise = np.array([KINEMATIC_NOISE, 3.0]), np.full(outputs, output_noise)
    free = np.array([2, 3, 5])
    start = np.array([1.0, 2.0])
    return System(A, B, C, *noise, smoothness * DT, DT, 90, LEAD, start, doublets, free)


def doublets(times: Array) -> Array:
    """A smooth input that varies within seconds, (k, 1)."""
    return (np.sin(1.3 * times) + np.sin(0.5 * times + 1))[:, None]


def weak_prior(system: System) -> ParameterPrior:
    """About half the true parameters, and far wider than the posterior of a series."""
    truth = system.theta[system.free]
    return ParameterPrior(truth / 2, np.eye(len(truth)) / 9)


ITERATIONS = 200  # of the ascent, which converges long before


class Embedding(NamedTuple):
    """How DEM embeds a series."""

    p: int  # order of the generalized outputs and states
    # order of w̃; p includes the last derivative's equation, 0 = A x⁽ᵖ⁾ + … + w⁽ᵖ⁾, p − 1 leaves it out
    q: int
    # S is that of derivatives estimated from samples, which requires q < p; else the kernel's
    as_read: bool = False

    @property
    def centre(self) -> int:
        """Index in the window of p + 1 samples at which the derivatives are estimated."""
        return (self.p + 1) // 2


def states_of(
    system: System, outputs: Array, embedding: Embedding, prior: ParameterPrior
) -> tuple[Array, Array]:
    """DEM's states (T − p, n) and their standard deviations (n,), with θ and λ known."""
    model = generative_model(system, embedding, prior)
    n = model.n
    lambda_ = model.prior.lambda_mean
    certain = np.zeros_like(model.prior.theta_precision)
    state_map = d_step(
        model, system.theta, certain, lambda_, np.zeros((len(lambda_), len(lambda_)))
    )
    covariance = inverse(-state_curvature(model, system.theta, np.exp(lambda_)))
    data = generalized(system, outputs, embedding)
    return data @ state_map[:n].T, np.sqrt(np.diag(covariance)[:n])


def parameters_of(
    system: System, outputs: Array, embedding: Embedding, prior: ParameterPrior
) -> tuple[Array, Array]:
    """DEM's free parameters (k,) and their covariance (k, k), with λ known."""
    model = generative_model(system, embedding, prior)
    belief = ascend(
        model, SufficientStatistics.of(generalized(system, outputs, embedding)), ITERATIONS
    ).belief
    return belief.theta[system.free], belief.theta_covariance[np.ix_(system.free, system.free)]


def generalized(system: System, outputs: Array, embedding: Embedding) -> Array:
    """Generalized data [ỹ; η̃] (T − p, ·), of outputs and inputs about the same instants."""
    p = embedding.p
    centre = embedding.centre
    signals = outputs, system.inputs(system.times)
    return np.hstack([embed(signal, p, system.dt, p + 1, centre) for signal in signals])


def generative_model(
    system: System, embedding: Embedding, prior: ParameterPrior
) -> GenerativeModel:
    """DEM's model of the system: everything known but the free parameters."""
    p = embedding.p
    q = embedding.q
    (n, r) = system.B.shape
    m = len(system.C)
    theta_mean = system.theta
    theta_precision = KNOWN * np.eye(len(system.theta))
    theta_mean[system.free] = prior.mean
    theta_precision[np.ix_(system.free, system.free)] = prior.precision
    lambda_mean = -2 * np.log(np.concatenate([system.output_noise, system.state_noise]))
    if embedding.as_read:
        output_correlation = sampled_output_precision(p, system.smoothness, system.dt, p + 1)
        state_correlation = sampled_state_precision(q, system.smoothness, system.dt, p + 1)
    else:
        output_correlation = temporal_precision(p, system.smoothness)
        state_correlation = temporal_precision(q, system.smoothness)
    correlations = output_correlation, state_correlation
    groups = (np.arange(m), m + np.arange(n))
    inputs = KNOWN * np.eye(r * (p + 1))
    of_noise = lambda_mean, KNOWN * np.eye(m + n)
    return GenerativeModel(
        n,
        r,
        m,
        p,
        p,
        q,
        *correlations,
        *groups,
        inputs,
        Prior(theta_mean, theta_precision, *of_noise),
    )
