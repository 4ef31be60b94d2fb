"""Systems that the axis's command drives: the model, the physical parameters, and draws from their uncertainty."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from mavdem.dem import Learned, Physical
from mavdem.dem.engine.model import pack, unpack

Array = NDArray[np.float64]

DRAWS = 400


class Systems(NamedTuple):
    """N linear systems ẋ = A x + b c, y = C x that one command c drives, ``delay`` seconds late.

    A (N, n, n), b (N, n), C (N, m, n), delay (N,).
    """

    A: Array
    b: Array
    C: Array
    delay: Array

    def over_frequency(self, frequency: Array, output: int) -> NDArray[np.complex128]:
        """(N, F) of one output to the command at ``frequency`` (F,), Hz."""
        s = 2j * np.pi * frequency
        resolvent = s[:, None, None] * np.eye(self.A.shape[-1]) - self.A[:, None]
        pushed = np.broadcast_to(self.b[:, None, :, None], (*resolvent.shape[:-1], 1))
        states = np.linalg.solve(resolvent, pushed)[..., 0]
        return np.asarray((states * self.C[:, None, output]).sum(axis=-1) * np.exp(-self.delay[:, None] * s))

    def after_step(self, time: Array) -> Array:
        """(N, T, m) of the outputs after the command's step from 0 to 1 at 0 s, at times (T,) evenly from 0 on."""
        n = self.A.shape[-1]
        generator = np.zeros((len(self.A), n + 1, n + 1))
        generator[:, :n, :n], generator[:, :n, n] = self.A, self.b
        flow, state = expm(generator * (time[1] - time[0])), np.zeros((len(self.A), n + 1))
        state[:, n] = 1.0
        states = [state]
        for _ in time[1:]:
            states.append(np.einsum("nij,nj->ni", flow, states[-1]))
        outputs = np.einsum("nmi,tni->nmt", self.C, np.array(states)[..., :n])
        late = [
            [np.interp(time - wait, time, one, left=0.0) for one in own]
            for own, wait in zip(outputs, self.delay.tolist(), strict=True)
        ]
        return np.swapaxes(np.array(late), 1, 2)


def system(A: Array, B: Array, C: Array, motors: Array, delay: float = 0.0) -> Systems:
    """The one system that a command which moves the ``motors`` (r,) drives ``delay`` seconds late."""
    return Systems(A[None], (B @ motors)[None], C[None], np.array([float(delay)]))


def drawn_models(learned: Learned, motors: Array, seed: int = 0) -> Systems:
    """``DRAWS`` systems whose θ is drawn about the estimate, driven by a command that moves the ``motors`` (r,).

    By the sandwich covariance with Student's distribution or, where that is not known, by the posterior.
    """
    A, B, C = learned.model[:3]
    theta, (n, r), m = pack(A, B, C), B.shape, len(C)
    rng, scatter = np.random.default_rng(seed), learned.scatter
    away = _normal(rng, learned.theta_covariance if scatter is None else scatter.covariance)
    if scatter is not None:
        away /= np.sqrt(rng.chisquare(scatter.freedom, (DRAWS, 1)) / scatter.freedom)
    As, Bs, Cs = (np.array(part) for part in zip(*(unpack(theta + one, n, r, m) for one in away), strict=True))
    return Systems(As, Bs @ motors, Cs, np.zeros(DRAWS))


def physical_system(read: Physical, motors: Array, outputs: int) -> Systems:
    """The physical parameters, with ``outputs`` 2, angle and rate, or 1, the rate alone."""
    theta = np.array([*read.effect, read.damping, read.lag, read.delay])
    return _physical_systems(theta[None], motors, outputs)


def drawn_physical(read: Physical, motors: Array, outputs: int, seed: int = 0) -> Systems:
    """``DRAWS`` of :func:`physical_system`, by the covariance of the parameters."""
    theta = np.array([*read.effect, read.damping, read.lag, read.delay])
    drawn = theta + _normal(np.random.default_rng(seed), read.covariance)
    drawn[:, -2:] = drawn[:, -2:].clip(0.05 * theta[-2:])  # a lag and a delay are positive
    return _physical_systems(drawn, motors, outputs)


def _physical_systems(theta: Array, motors: Array, outputs: int) -> Systems:
    effect, (damping, lag, delay) = theta[:, :-3] @ motors, theta[:, -3:].T
    A, b = np.zeros((len(theta), 3, 3)), np.zeros((len(theta), 3))
    A[:, 0, 1] = A[:, 1, 2] = 1.0
    A[:, 1, 1], A[:, 2, 2], b[:, 2] = -damping, -1 / lag, effect / lag
    first = 2 - outputs
    C = np.broadcast_to(np.eye(outputs, 3 - first), (len(theta), outputs, 3 - first))
    return Systems(A[:, first:, first:], b[:, first:], C, delay)


def _normal(rng: np.random.Generator, covariance: Array) -> Array:
    """(DRAWS, k) about 0, of a covariance (k, k) that may be singular."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    return np.asarray(rng.standard_normal((DRAWS, len(values))) @ (vectors * np.sqrt(values.clip(0))).T)
