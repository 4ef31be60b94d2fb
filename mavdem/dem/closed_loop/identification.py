"""Identification: the most probable plant of one axis, by Fisher's scoring from several starts."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from mavdem.dem.closed_loop.likelihood import MEAN, NAMES, PLANT, SD, Axis
from mavdem.dem.engine.gauss_newton import (
    MAX_STEPS,
    RELATIVE_STEP,
    Damping,
    Quadratic,
    gauss_newton,
)
from mavdem.dem.engine.linalg import Array, inverse

STARTS = tuple(product((3.0, 10.0), ((0.05, 0.009), (0.02, 0.005))))
"""Crossover, Hz, with lag and delay, s, to begin with: of large and of small vehicles."""
FIRST_STEPS = 8  # from each start, of which the two best go on
LONGEST_STEP = 1.5  # of any parameter, and a standard deviation beforehand at most


class Identified(NamedTuple):
    """The most probable parameters of an axis."""

    axis: Axis
    theta: Array  # (k,) in the order of ``likelihood.NAMES``
    covariance: Array  # (k, k)


def identified(axis: Axis) -> Identified:
    """Returns the most probable parameters of an ``axis``; ``LinAlgError`` where there are none."""
    objective = _LogJoint(axis)
    begun = []
    for crossover, (lag, delay) in STARTS:
        theta = MEAN.copy()
        back = abs(axis.known.back(np.array([crossover]))[0])
        effect, _, *late = PLANT
        theta[[effect, *late]] = np.log([2 * np.pi * crossover / back, lag, delay])
        theta = objective.moved(theta)
        begun.append(objective.ascended(objective.quadratic(theta, theta), FIRST_STEPS))
    ended = []
    for fit in sorted(begun, key=lambda fit: fit.value)[-2:]:
        theta = objective.moved(fit.at)
        ended.append(objective.ascended(objective.quadratic(theta, theta), MAX_STEPS))
    best = max(ended, key=lambda fit: fit.value)
    if not np.isfinite(best.value):
        raise np.linalg.LinAlgError("nothing has a likelihood")
    return Identified(axis, best.at, inverse(best.curvature))


class _LogJoint(NamedTuple):
    """The log joint of an axis's spectra and parameters, an ``Objective`` of Fisher's scoring."""

    axis: Axis

    def value(self, at: Array) -> tuple[float, Array]:
        """The value; of residuals there is no use."""
        return self.axis.value(at) + _log_prior(at), at

    def quadratic(self, at: Array, residuals: Array) -> Quadratic:
        """To second order, the information for the curvature."""
        del residuals
        value, slope, information = self.axis.scores(at, RELATIVE_STEP * SD)
        curvature = information + np.diag(SD**-2.0)
        return Quadratic(at, value + _log_prior(at), slope - (at - MEAN) / SD**2, curvature)

    def ascended(self, start: Quadratic, steps: int) -> Quadratic:
        """After so many damped steps, or where there is nothing to gain."""
        damping = Damping(first=1e-2, factor=5.0, attempts=16, limited=self._limited)
        trace, _ = gauss_newton(self, start, damping, steps)
        return trace[-1]

    def moved(self, theta: Array) -> Array:
        """The most probable of parameters ``theta`` and those with steps at other times between messages."""
        at = np.eye(len(theta))[NAMES.index("step_time")]
        others = [theta + at * (MEAN + far * SD - theta) for far in (-2, -1, 1, 2)]
        return max([theta, *others], key=lambda parameters: self.value(parameters)[0])

    def _limited(self, step: Array) -> Array:
        """A step that changes no parameter by more than ``LONGEST_STEP``."""
        longest = np.minimum(SD, LONGEST_STEP)
        return step / max(1.0, float(np.abs(step / longest).max()))


def _log_prior(at: Array) -> float:
    return -0.5 * float(np.sum(((at - MEAN) / SD) ** 2))
