"""Systems: what the axis's command does to a vehicle, over frequency.

Each curve is of linear systems: the model, or the physical parameters and draws from their uncertainty, of which the
bands are percentiles.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem import Learned, Physical
from mavdem.dem.engine.linalg import Array
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


def model_systems(learned: Learned, motors: Array) -> Systems:
    """Returns DEM's model, driven by a command that moves the ``motors`` (r,)."""
    A, B, C = learned.model[:3]
    return Systems(A[None], (B @ motors)[None], C[None], np.zeros(1))


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


def curves_of(
    learned: Learned, motors: Array, truth: Truth | None, model: str = "physical"
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
