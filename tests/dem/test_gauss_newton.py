"""Damped Gauss-Newton steps on a function of one variable whose maximum is known."""

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array
from mavdem.dem.engine.gauss_newton import Damping, QuadraticExpansion, gauss_newton

MAXIMUM = 1.0
"""Where ln(x) − x has its maximum."""

DAMPING = Damping(initial=1e-2, factor=6.0, max_attempts=12)
"""Damping as the fits of plants have it."""


class LogarithmLessLine:
    """The function ln(x) − x of x > 0, with the number of its evaluations."""

    def __init__(self) -> None:
        """Begins to count."""
        self.values = 0
        self.expansions = 0

    def value(self, point: Array, /) -> float:
        """Returns the value at x (1,); NaN where there is none."""
        self.values += 1
        return float(np.log(point[0]) - point[0]) if point[0] > 0 else float("nan")

    def expand(self, point: Array, /) -> QuadraticExpansion:
        """Returns the expansion about x (1,)."""
        self.expansions += 1
        if point[0] <= 0:
            raise LinAlgError("the logarithm is not defined")
        value = float(np.log(point[0]) - point[0])
        curvature = np.array([[1 / point[0] ** 2]])
        return QuadraticExpansion(point, value, 1 / point - 1, curvature)


def test_a_step_that_succeeds_is_evaluated_once():
    objective = LogarithmLessLine()
    trace, _ = gauss_newton(objective, objective.expand(np.array([0.5])), DAMPING)
    assert abs(trace[-1].point[0] - MAXIMUM) < 0.01
    assert objective.values == 0
    assert objective.expansions == len(trace)


def test_a_step_out_of_the_domain_is_damped_more():
    # From 3 the first step goes to −3.
    objective = LogarithmLessLine()
    trace, _ = gauss_newton(objective, objective.expand(np.array([3.0])), DAMPING)
    assert abs(trace[-1].point[0] - MAXIMUM) < 0.05
    assert objective.values > 0
    assert all(after.value > before.value for before, after in zip(trace, trace[1:], strict=False))


class MisjudgedBowl:
    """A quadratic function of four variables whose expansions have a curvature that is wrong by factors."""

    true_curvature = np.diag([1.0, 4.0, 9.0, 16.0]) + 0.5
    reported_curvature = np.diag([6.0, 4.0, 1.5, 16.0]) + 0.5

    def value(self, point: Array, /) -> float:
        """Returns the value at a point (4,)."""
        return float(-0.5 * point @ self.true_curvature @ point)

    def expand(self, point: Array, /) -> QuadraticExpansion:
        """Returns the expansion about a point (4,), with the true gradient."""
        gradient = -self.true_curvature @ point
        return QuadraticExpansion(point, self.value(point), gradient, self.reported_curvature)


def test_a_curvature_that_is_corrected_by_gradients_saves_half_of_the_steps():
    """The curvature that the objective states is wrong; secant corrections from gradients make up for that."""
    objective = MisjudgedBowl()
    start = objective.expand(np.array([30.0, -20.0, 20.0, 10.0]))
    uncorrected_steps, _ = gauss_newton(objective, start, DAMPING, 200)
    corrected_steps, gain = gauss_newton(objective, start, DAMPING, 200, corrects_curvature=True)
    assert len(corrected_steps) < len(uncorrected_steps) / 2
    assert gain < 5e-3
    assert corrected_steps[-1].value > -0.01
