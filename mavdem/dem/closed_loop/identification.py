"""Identification: the most probable plant of axes that share their motors, by Fisher's scoring from several starts."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from mavdem.dem.closed_loop.likelihood import NAMES, SHARED, Axis
from mavdem.dem.engine.linalg import Array, inverse

STARTS = tuple(product((3.0, 10.0), ((0.05, 0.009), (0.02, 0.005))))
"""Crossover, Hz, and lag and delay, s, to begin with: of large and of small vehicles."""
FIRST_STEPS = 8  # from each start; the best goes on
MAX_STEPS = 60
CONVERGED_NATS = 1e-2
LONGEST_STEP = 1.0  # standard deviations beforehand, of any parameter


class Identified(NamedTuple):
    """The most probable parameters of A axes together."""

    axes: tuple[Axis, ...]
    theta: Array  # (A, k), in the order of ``NAMES``
    covariance: Array  # (A, k, k) of each
    value: float  # of the log joint


class _Together(NamedTuple):
    """The axes' parameters in one vector: those that they share once."""

    axes: Sequence[Axis]
    places: Array  # (A, k) of each axis's parameters in it

    def prior(self) -> tuple[Array, Array]:
        mean = np.zeros(self.places.max() + 1)
        sd = np.ones_like(mean)
        for axis, places in zip(self.axes, self.places, strict=True):
            mean[places], sd[places] = axis.prior
        return mean, sd

    def value(self, whole: Array) -> float:
        mean, sd = self.prior()
        likelihood = sum(
            axis.value(whole[places]) for axis, places in zip(self.axes, self.places, strict=True)
        )
        return likelihood - 0.5 * float(np.sum(((whole - mean) / sd) ** 2))

    def scores(self, whole: Array) -> tuple[Array, Array]:
        mean, sd = self.prior()
        score = -(whole - mean) / sd**2
        information = np.diag(sd**-2.0)
        for axis, places in zip(self.axes, self.places, strict=True):
            slope, own = axis.scores(whole[places], 1e-4 * sd[places])
            np.add.at(score, places, slope)
            information[np.ix_(places, places)] += own
        return score, information

    def ascended(self, whole: Array, steps: int) -> tuple[Array, float]:
        """After so many damped steps of Fisher's scoring, or where there is nothing to gain."""
        _, sd = self.prior()
        value = self.value(whole)
        damping = 1e-2
        for _ in range(steps):
            score, information = self.scores(whole)
            gain = 0.0
            while damping < 1e8:
                damped = information + damping * np.diag(information.diagonal())
                step = np.linalg.solve(damped, score)
                step /= max(1.0, float(np.abs(step / np.minimum(sd, 1.5)).max()) / LONGEST_STEP)
                gain = self.value(whole + step) - value
                if gain > 0:
                    break
                damping *= 4
            if not gain > 0:
                break
            whole = whole + step
            value += gain
            damping = max(damping / 6, 1e-6)
            if gain < CONVERGED_NATS:
                break
        return whole, value


def identified(axes: Sequence[Axis]) -> Identified:
    """Returns the most probable parameters of ``axes`` with the same motors; ``LinAlgError`` where there are none."""
    count = len(NAMES)
    places = np.arange(len(axes) * count).reshape(-1, count)
    places[:, SHARED] = places[0, SHARED]
    _, places = np.unique(places, return_inverse=True)
    together = _Together(axes, places.reshape(-1, count))
    begun = []
    for crossover, (lag, delay) in STARTS:
        whole, _ = together.prior()
        for axis, own in zip(axes, together.places, strict=True):
            back = abs(axis.known.back(np.array([crossover]))[0])
            values = np.log([2 * np.pi * crossover / back, lag, delay])
            whole[own[[NAMES.index(name) for name in ("effect", "lag", "delay")]]] = values
        begun.append(together.ascended(whole, FIRST_STEPS))
    whole, _ = max(begun, key=lambda one: one[1])
    whole, value = together.ascended(whole, MAX_STEPS)
    _, information = together.scores(whole)
    covariance = inverse(information)
    return Identified(
        tuple(axes),
        whole[together.places],
        np.array([covariance[np.ix_(own, own)] for own in together.places]),
        value,
    )
