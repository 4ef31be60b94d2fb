"""Identification: the most probable plant of one axis, by Fisher's scoring from several starts."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from mavdem.dem.closed_loop.likelihood import PLANT, Axis
from mavdem.dem.engine.linalg import Array, inverse

STARTS = tuple(product((3.0, 10.0), ((0.05, 0.009), (0.02, 0.005))))
"""Crossover, Hz, with lag and delay, s, to begin with: of large and of small vehicles."""
FIRST_STEPS = 8  # from each start; the best goes on
MAX_STEPS = 60
CONVERGED_NATS = 1e-2
LONGEST_STEP = 1.5  # of any parameter, and a standard deviation beforehand at most
RELATIVE_STEP = 1e-4  # of that, for slopes by differences


class Identified(NamedTuple):
    """The most probable parameters of an axis."""

    axis: Axis
    theta: Array  # (k,) in the order of ``likelihood.NAMES``
    covariance: Array  # (k, k)


def identified(axis: Axis) -> Identified:
    """Returns the most probable parameters of an ``axis``; ``LinAlgError`` where there are none."""
    mean, _ = axis.prior
    begun = []
    for crossover, (lag, delay) in STARTS:
        theta = mean.copy()
        back = abs(axis.known.back(np.array([crossover]))[0])
        effect, _, *late = PLANT
        theta[[effect, *late]] = np.log([2 * np.pi * crossover / back, lag, delay])
        begun.append(_ascended(axis, theta, FIRST_STEPS))
    theta, _ = max(begun, key=lambda one: one[1])
    theta, value = _ascended(axis, theta, MAX_STEPS)
    if not np.isfinite(value):
        raise np.linalg.LinAlgError("nothing has a likelihood")
    _, information = _scores(axis, theta)
    return Identified(axis, theta, inverse(information))


def _log_joint(axis: Axis, theta: Array) -> float:
    mean, sd = axis.prior
    return axis.value(theta) - 0.5 * float(np.sum(((theta - mean) / sd) ** 2))


def _scores(axis: Axis, theta: Array) -> tuple[Array, Array]:
    """Slope (k,) of the log joint, and the information (k, k), prior included."""
    mean, sd = axis.prior
    slope, information = axis.scores(theta, RELATIVE_STEP * sd)
    return slope - (theta - mean) / sd**2, information + np.diag(sd**-2.0)


def _ascended(axis: Axis, theta: Array, steps: int) -> tuple[Array, float]:
    """Parameters and log joint after so many damped steps, or where there is nothing to gain."""
    longest = np.minimum(axis.prior[1], LONGEST_STEP)
    value = _log_joint(axis, theta)
    damping = 1e-2
    for _ in range(steps):
        score, information = _scores(axis, theta)
        gain = 0.0
        step = score
        while not gain > 0 and damping < 1e8:
            damped = information + damping * np.diag(information.diagonal())
            step = np.asarray(np.linalg.solve(damped, score))
            step /= max(1.0, float(np.abs(step / longest).max()))
            gain = _log_joint(axis, theta + step) - value
            damping *= 1 / 6 if gain > 0 else 4
        if not gain > 0:
            break
        theta = theta + step
        value += gain
        damping = max(damping, 1e-6)
        if gain < CONVERGED_NATS:
            break
    return theta, value
