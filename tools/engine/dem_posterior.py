"""DEM of a series from a known system: its states with the parameters known, and its parameters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from joint_gaussian import ParameterPrior, System
from numpy.typing import NDArray

from mavdem.dem.ascent import ascend
from mavdem.dem.coordinates import embed
from mavdem.dem.free_energy import state_curvature
from mavdem.dem.generative import GenerativeModel, Samples
from mavdem.dem.positive import inverse
from mavdem.dem.priors import KNOWN, Prior
from mavdem.dem.smoothness import sampled_output_precision, sampled_state_precision, temporal_precision
from mavdem.dem.steps import d_step

Array = NDArray[np.float64]

ROUNDS = 200
"""Of the ascent, which settles long before."""


class Embedding(NamedTuple):
    """How DEM is to see a series.

    Attributes:
        p: order of the generalized outputs and states.
        q: order of w̃: p takes the last derivative's equation, 0 = A x⁽ᵖ⁾ + … + w⁽ᵖ⁾, for evidence; p − 1 does not.
        as_read: whether S is that of derivatives read from samples, which asks for q < p; else it is the kernel's.
    """

    p: int
    q: int
    as_read: bool = False

    @property
    def centre(self) -> int:
        """Place in the window of p + 1 samples that the derivatives belong to."""
        return (self.p + 1) // 2


def states_of(system: System, outputs: Array, embedding: Embedding, prior: ParameterPrior) -> tuple[Array, Array]:
    """DEM's states (T − p, n) and their standard deviations (n,), with θ and λ known."""
    model = generative_model(system, embedding, prior)
    n, lambda_ = model.n, model.prior.lambda_mean
    certain = np.zeros_like(model.prior.theta_precision)
    state_map = d_step(model, system.theta, certain, lambda_, np.zeros((len(lambda_), len(lambda_))))
    covariance = inverse(-state_curvature(model, system.theta, np.exp(lambda_)))
    data = generalized(system, outputs, embedding)
    return data @ state_map[:n].T, np.sqrt(np.diag(covariance)[:n])


def parameters_of(system: System, outputs: Array, embedding: Embedding, prior: ParameterPrior) -> tuple[Array, Array]:
    """DEM's free parameters (k,) and their covariance (k, k), with λ known."""
    model = generative_model(system, embedding, prior)
    belief = ascend(model, Samples.of(generalized(system, outputs, embedding)), ROUNDS).belief
    return belief.theta[system.free], belief.theta_covariance[np.ix_(system.free, system.free)]


def generalized(system: System, outputs: Array, embedding: Embedding) -> Array:
    """Generalized data [ỹ; η̃] (T − p, ·), of outputs and inputs about the same instants."""
    p, centre = embedding.p, embedding.centre
    signals = outputs, system.inputs(system.times)
    return np.hstack([embed(signal, p, system.dt, p + 1, centre) for signal in signals])


def generative_model(system: System, embedding: Embedding, prior: ParameterPrior) -> GenerativeModel:
    """DEM's model of the system: everything known but the free parameters."""
    p, q = embedding.p, embedding.q
    (n, r), m = system.B.shape, len(system.C)
    theta_mean, theta_precision = system.theta, KNOWN * np.eye(len(system.theta))
    theta_mean[system.free] = prior.mean
    theta_precision[np.ix_(system.free, system.free)] = prior.precision
    lambda_mean = -2 * np.log(np.concatenate([system.output_noise, system.state_noise]))
    if embedding.as_read:
        output_correlation = sampled_output_precision(p, system.smoothness, system.dt, p + 1)
        state_correlation = sampled_state_precision(q, system.smoothness, system.dt, p + 1)
    else:
        output_correlation = temporal_precision(p, system.smoothness)
        state_correlation = temporal_precision(q, system.smoothness)
    return GenerativeModel(
        n,
        r,
        m,
        p,
        p,
        q,
        output_correlation,
        state_correlation,
        np.arange(m),
        m + np.arange(n),
        KNOWN * np.eye(r * (p + 1)),
        Prior(theta_mean, theta_precision, lambda_mean, KNOWN * np.eye(m + n)),
    )
