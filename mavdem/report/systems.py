"""Systems: what the axis's command does to a vehicle, over frequency (Bode) and over time (step).

Each curve is of linear systems: the model or the physical parameters, and draws from their uncertainty, of which the
bands are percentiles.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from mavdem.dem import Learned, Physical
from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import pack, unpack
from mavdem.report.palette import PHYSICAL, PREDICTED, TRUTH

Complex = NDArray[np.complex128]
Truth = tuple[Array, Array, float]

DRAWS = 400


class Systems(NamedTuple):
    """N linear systems ẋ = A x + b c, y = C x that one command c drives, ``delay`` seconds late.

    The first is the estimate; others are draws from its uncertainty. A (N, n, n), b (N, n), C (N, m, n), delay (N,).
    """

    A: Array
    b: Array
    C: Array
    delay: Array

    def over_frequency(self, frequency: Array, output: int) -> Complex:
        """Returns (N, F) of one output to the command at ``frequency`` (F,), Hz."""
        s = 2j * np.pi * frequency
        resolvent = s[:, None, None] * np.eye(self.A.shape[-1]) - self.A[:, None]
        pushed = np.broadcast_to(self.b[:, None, :, None], (*resolvent.shape[:-1], 1))
        states = np.linalg.solve(resolvent, pushed)[..., 0]
        return np.asarray(
            (states * self.C[:, None, output]).sum(axis=-1) * np.exp(-self.delay[:, None] * s)
        )

    def after_step(self, time: Array) -> Array:
        """Returns (N, T, m): the outputs after the command's step from 0 to 1 at 0 s, at (T,) s evenly from 0 on."""
        n = self.A.shape[-1]
        generator = np.zeros((len(self.A), n + 1, n + 1))
        generator[:, :n, :n] = self.A
        generator[:, :n, n] = self.b
        flow = expm(generator * (time[1] - time[0]))
        states = [np.repeat(np.eye(n + 1)[-1:], len(self.A), axis=0)]
        for _ in time[1:]:
            states.append(np.einsum("nij,nj->ni", flow, states[-1]))
        outputs = np.einsum("nmi,tni->nmt", self.C, np.array(states)[..., :n])
        late = [
            [np.interp(time - wait, time, output, left=0.0) for output in system]
            for system, wait in zip(outputs, self.delay.tolist(), strict=True)
        ]
        return np.swapaxes(np.array(late), 1, 2)


def model_systems(learned: Learned, motors: Array, seed: int = 0) -> Systems:
    """Returns DEM's model and ``DRAWS`` of it, driven by a command that moves the ``motors`` (r,).

    By the posterior, with Student's distribution where it is that of a simulation-error fit.
    """
    A, B, C = learned.model[:3]
    theta = pack(A, B, C)
    found = learned.simulation_fit
    rng = np.random.default_rng(seed)
    away = _normal(rng, learned.theta_covariance)
    if found is not None:
        away /= np.sqrt(rng.chisquare(found.freedom, (DRAWS, 1)) / found.freedom)
    (n, r) = B.shape
    m = len(C)
    drawn = (unpack(row, n, r, m) for row in theta + np.vstack([0 * theta, away]))
    As, Bs, Cs = map(np.array, zip(*drawn, strict=True))
    return Systems(As, Bs @ motors, Cs, np.zeros(DRAWS + 1))


def physical_systems(physical: Physical, motors: Array, outputs: int, seed: int = 0) -> Systems:
    """Returns physical parameters and ``DRAWS`` of them; ``outputs`` are 2, angle and rate, or 1, the rate alone."""
    theta = physical.draws(DRAWS, seed)
    effect = theta[:, :-3] @ motors
    (damping, lag, delay) = theta[:, -3:].T
    A = np.zeros((len(theta), 3, 3))
    b = np.zeros((len(theta), 3))
    A[:, 0, 1] = A[:, 1, 2] = 1.0
    A[:, 1, 1] = -damping
    A[:, 2, 2] = -1 / lag
    b[:, 2] = effect / lag
    first = 2 - outputs
    C = np.broadcast_to(np.eye(outputs, 3 - first), (len(theta), outputs, 3 - first))
    return Systems(A[:, first:, first:], b[:, first:], C, delay)


def _normal(rng: np.random.Generator, covariance: Array) -> Array:
    """(DRAWS, k) about 0, of a covariance (k, k) that may be singular."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    return np.asarray(
        rng.standard_normal((DRAWS, len(values))) @ (vectors * np.sqrt(values.clip(0))).T
    )


def curves_of(
    learned: Learned, motors: Array, truth: Truth | None, model: str = "both"
) -> Iterator[tuple[str, str, Systems]]:
    """Name, colour and systems of each curve; DEM's model where there is no plant, whatever the ``model``."""
    outputs = learned.record.outputs.shape[1]
    physical = plant_of(learned)
    if physical is not None and model != "dem":
        yield "physical parameters", PHYSICAL, physical_systems(physical, motors, outputs)
    if physical is None or model != "physical":
        yield "DEM's model", PREDICTED, model_systems(learned, motors)
    if truth is not None:
        A, B, delay = truth
        known = A, B @ motors, np.eye(outputs, len(A)), np.array(delay)
        yield "truth", TRUTH, Systems(*(one[None] for one in known))


def plant_of(learned: Learned) -> Physical | None:
    """The physical parameters, where they are identifiable, and their outputs are those of the model."""
    physical = learned.physical
    outputs = learned.record.outputs.shape[1]
    return physical if physical is not None and outputs <= 2 and physical.identifiable else None
