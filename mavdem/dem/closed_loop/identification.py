"""Identification: the most probable plant of one axis, by Fisher's scoring from several starts."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from mavdem.dem.closed_loop.likelihood import PLANT, Axis
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
FIRST_STEPS = 8  # from each start; the best goes on
LONGEST_STEP = 1.5  # of any parameter, and a standard deviation beforehand at most


class Identified(NamedTuple):
    """The most probable parameters of an axis."""

    axis: Axis
    theta: Array  # (k,) in the order of ``likelihood.NAMES``
    covariance: Array  # (k, k)


def identified(axis: Axis) -> Identified:
    """Returns the most probable parameters of an ``axis``; ``LinAlgError`` where there are none."""
    objective = _LogJoint(axis)
    mean, _ = axis.prior
    begun = []
    for crossover, (lag, delay) in STARTS:
        theta = mean.copy()
        back = abs(axis.known.back(np.array([crossover]))[0])
        effect, _, *late = PLANT
        theta[[effect, *late]] = np.log([2 * np.pi * crossover / back, lag, delay])
        begun.append(objective.ascended(objective.quadratic(theta, theta), FIRST_STEPS))
    best = objective.ascended(max(begun, key=lambda one: one.value), MAX_STEPS)
    if not np.isfinite(best.value):
        raise np.linalg.LinAlgError("nothing has a likelihood")
    return Identified(axis, best.at, inverse(best.curvature))


class _LogJoint(NamedTuple):
    """The log joint of an axis's spectra and parameters, an ``Objective`` of Fisher's scoring."""

    axis: Axis

    def value(self, at: Array) -> tuple[float, Array]:
        """The value; of residuals there is no use."""
        mean, sd = self.axis.prior
        return self.axis.value(at) - 0.5 * float(np.sum(((at - mean) / sd) ** 2)), at

    def quadratic(self, at: Array, residuals: Array) -> Quadratic:
        """To second order, the information for the curvature."""
        del residuals
        mean, sd = self.axis.prior
        slope, information = self.axis.scores(at, RELATIVE_STEP * sd)
        curvature = information + np.diag(sd**-2.0)
        return Quadratic(at, self.value(at)[0], slope - (at - mean) / sd**2, curvature)

    def ascended(self, start: Quadratic, steps: int) -> Quadratic:
        """After so many damped steps, or where there is nothing to gain."""
        damping = Damping(first=1e-2, factor=5.0, attempts=16, limited=self._limited)
        trace, _ = gauss_newton(self, start, damping, steps)
        return trace[-1]

    def _limited(self, step: Array) -> Array:
        """A step that changes no parameter by more than ``LONGEST_STEP``."""
        longest = np.minimum(self.axis.prior[1], LONGEST_STEP)
        return step / max(1.0, float(np.abs(step / longest).max()))
