"""Gauss-Newton: maximises a function that is nearly expand, by damped steps."""

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from mavdem.arrays import Array

FINITE_DIFFERENCE_STEP = (
    1e-4  # of a parameter, for slopes by differences: between rounding and curvature
)
CONVERGED_STEP_NATS = 5e-3  # that the last step gains: so little does not separate two models
MAX_STEPS = 40  # of one search, at most


class QuadraticExpansion(NamedTuple):
    """A function to second order about a point: its value and slope there, and its negative's curvature."""

    point: Array
    value: float
    gradient: Array
    curvature: Array

    @property
    def predicted_gain(self) -> float:
        """What the function gains up to the maximum of the expand."""
        return float(0.5 * self.gradient @ np.linalg.solve(self.curvature, self.gradient))


class Objective(Protocol):
    """A function to maximise."""

    def value(self, at: Array) -> float:
        """Returns the value at a point (f,), NaN where there is none."""

    def expand(self, at: Array) -> QuadraticExpansion:
        """Returns the function to second order about a point."""


class Damping(NamedTuple):
    """How steps are damped."""

    initial: float  # damping of the first step, as a share of the curvature's diagonal
    # times more after a step that does not increase the function, and less after one that does
    factor: float
    max_attempts: int  # at most for one step
    limit_step: Callable[[Array], Array] = (
        np.asarray
    )  # makes a step (f,) short enough to be trusted

    def after(self, damping: float, gained: float, predicted: float) -> float:
        """Returns the damping after a step that increased the function, by how much the expand predicted."""
        if gained > predicted / 2:
            return max(damping / self.factor, 1e-6)
        return damping if gained > predicted / 5 else 4 * damping


def gauss_newton(
    objective: Objective,
    start: QuadraticExpansion,
    damping: Damping,
    iterations: int = MAX_STEPS,
    enough: Callable[[QuadraticExpansion], bool] = lambda now: False,
) -> tuple[list[QuadraticExpansion], float]:
    """Maximises from ``start`` until a step gains no more than ``CONVERGED_STEP_NATS``, or ``enough`` is true.

    By Levenberg and Marquardt's method (Nocedal and Wright, Numerical Optimization, 2nd ed., 10.3), in at most so many
    ``iterations``: a step that does not increase the function is damped more; after one that does, the next is damped
    less.

    Returns the function about each iterate, the start's first; and what the last step gained or, where no attempt at a
    step increased the function, what the last expand still predicts.
    """
    trace = [start]
    damped = damping.initial
    gained = np.inf
    while gained > CONVERGED_STEP_NATS and len(trace) <= iterations and not enough(trace[-1]):
        now = trace[-1]
        for _ in range(damping.max_attempts):
            curvature = now.curvature + damped * np.diag(now.curvature.diagonal())
            step = damping.limit_step(np.asarray(np.linalg.solve(curvature, now.gradient), float))
            gained = objective.value(now.point + step) - now.value
            if gained > 0:
                break
            damped *= damping.factor
        if not gained > 0:
            return trace, now.predicted_gain
        damped = damping.after(
            damped, gained, float(now.gradient @ step - 0.5 * step @ now.curvature @ step)
        )
        trace.append(objective.expand(now.point + step))
    return trace, gained
