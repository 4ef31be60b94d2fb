"""DEM's model of a known system: a stabilised roll angle in noise of known colour."""

from typing import NamedTuple

import numpy as np
from joint_gaussian import System

from mavdem.dem.engine.generative import (
    GenerativeModel,
    Prior,
    temporal_precision,
)
from mavdem.dem.priors import KNOWN

DT = 0.1  # seconds; it responds within about one second
# of the relation that makes the rate the derivative of the roll angle, rad/s
KINEMATIC_NOISE = 0.03


def roll(smoothness, output_noise, *, outputs=2):
    """φ̇ = rate; the rate has stiffness, damping and gain, which are free, and noise; one output is the angle alone."""
    A = np.array([[0.0, 1.0], [-4.0, -1.2]])
    B = np.array([[0.0], [4.0]])
    C = np.eye(outputs, 2)
    free = np.array([2, 3, 5])
    return System(
        A,
        B,
        C,
        np.array([KINEMATIC_NOISE, 3.0]),
        np.full(outputs, output_noise),
        smoothness * DT,
        DT,
        free,
    )


class Embedding(NamedTuple):
    """How DEM embeds a series."""

    p: int  # order of the generalized outputs and states
    # order of w̃; p includes the last derivative's equation, 0 = A x⁽ᵖ⁾ + … + w⁽ᵖ⁾, p − 1 leaves it out
    q: int


def generative_model(system, embedding, prior):
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
    inputs = KNOWN * np.eye(r * (p + 1))
    return GenerativeModel(
        n,
        r,
        m,
        p,
        p,
        q,
        temporal_precision(p, system.smoothness),
        temporal_precision(q, system.smoothness),
        np.arange(m),
        m + np.arange(n),
        inputs,
        Prior(theta_mean, theta_precision, lambda_mean, KNOWN * np.eye(m + n)),
    )
