"""Gauss-Newton: maximises a function that is nearly quadratic, by damped steps."""

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from mavdem.arrays import Array

RELATIVE_STEP = 1e-4  # of a parameter, for slopes by differences: between rounding and curvature
CONVERGED_NATS = 5e-3  # that the last step gains: so little does not separate two models
MAX_STEPS = 40  # of one search, at most


class Quadratic(NamedTuple):
    """A function to second order about a point: its value and slope there, and its negative's curvature."""

    at: Array
    value: float
    slope: Array
    curvature: Array

    @property
    def remaining(self) -> float:
        """What the function gains up to the maximum of the quadratic."""
        return float(0.5 * self.slope @ np.linalg.solve(self.curvature, self.slope))


class Objective(Protocol):
    """A function to maximise."""

    def value(self, at: Array) -> float:
        """Returns the value at a point (f,), NaN where there is none."""

    def quadratic(self, at: Array) -> Quadratic:
        """Returns the function to second order about a point."""


class Damping(NamedTuple):
    """How steps are damped."""

    first: float  # damping of the first step, as a share of the curvature's diagonal
    # times more after a step that does not increase the function, and less after one that does
    factor: float
    attempts: int  # at most for one step
    limited: Callable[[Array], Array] = np.asarray  # makes a step (f,) short enough to be trusted

    def after(self, damping: float, gained: float, predicted: float) -> float:
        """Returns the damping after a step that increased the function, by how much the quadratic predicted."""
        if gained > predicted / 2:
            return max(damping / self.factor, 1e-6)
        return damping if gained > predicted / 5 else 4 * damping


def gauss_newton(
    objective: Objective,
    start: Quadratic,
    damping: Damping,
    iterations: int = MAX_STEPS,
    enough: Callable[[Quadratic], bool] = lambda now: False,
) -> tuple[list[Quadratic], float]:
    """Maximises from ``start`` until a step gains no more than ``CONVERGED_NATS``, or what it came to is ``enough``.

    By Levenberg and Marquardt's method (Nocedal and Wright, Numerical Optimization, 2nd ed., 10.3), in at most so many
    ``iterations``: a step that does not increase the function is damped more; after one that does, the next is damped
    less.

    Returns the function about each iterate, the start's first; and what the last step gained or, where no attempt at a
    step increased the function, what the last quadratic still predicts.
    """
    trace = [start]
    damped = damping.first
    gained = np.inf
    while gained > CONVERGED_NATS and len(trace) <= iterations and not enough(trace[-1]):
        now = trace[-1]
        for _ in range(damping.attempts):
            curvature = now.curvature + damped * np.diag(now.curvature.diagonal())
            step = damping.limited(np.asarray(np.linalg.solve(curvature, now.slope), float))
            gained = objective.value(now.at + step) - now.value
            if gained > 0:
                break
            damped *= damping.factor
        if not gained > 0:
            return trace, now.remaining
        damped = damping.after(
            damped, gained, float(now.slope @ step - 0.5 * step @ now.curvature @ step)
        )
        trace.append(objective.quadratic(now.at + step))
    return trace, gained
