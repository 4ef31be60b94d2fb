"""Layouts: how a vehicle's rotors may stand, and so which of their pushes turn it, before a flight has told.

Rotors that all push a little more lift the vehicle and hardly turn it. Four rotors mostly stand in an X, two on either
side of each axis, so that two work against two; or in a plus, so that one works against one and two do nothing. Which
it is the free energy tells: with each layout it is known to second order from where one climb has ended.
"""

from __future__ import annotations

from functools import cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIFT_PRECISION = 4.0
"""Prior precision, in the engine's units, of how far all rotors together turn the vehicle."""

QUIET_PRECISION = 0.1
"""Likewise of each other combination that, with a layout, does not turn it: rotors are not quite alike."""

FEWEST_ROTORS = 3
"""With fewer inputs they are not a multirotor's motors, but what somebody demands of an axis."""

X_SHARE, PLUS_SHARE = 0.94, 0.05
"""Of vehicles with four rotors; the others stand in some other way."""


class Layout(NamedTuple):
    """One way in which r rotors may stand.

    Attributes:
        quiet: (k, r) combinations of their pushes, of unit length and at right angles, that hardly turn the vehicle.
        precision: (k,) prior precision of the effect of each, in the engine's units.
        log_share: natural logarithm of the share of vehicles that are so.
    """

    quiet: Array
    precision: Array
    log_share: float

    def added_precision(self, sizes: tuple[int, int, int], rows: NDArray[np.intp]) -> Array:
        """(k, k) what it adds to the prior precision of θ.

        Args:
            sizes: n states, r inputs, of which those after the rotors are others, and m outputs.
            rows: of B that the rotors may move.
        """
        n, r, m = sizes
        added = np.zeros((n * n + n * r + m * n,) * 2)
        of_row = self.quiet.T @ (self.precision[:, None] * self.quiet)
        for row in rows:
            places = n * n + row * r + np.arange(len(of_row))
            added[np.ix_(places, places)] = of_row
        return added


class Likelihood(NamedTuple):
    """The log likelihood about some parameters, to second order: its slope (f,) and its curvature (f, f) there."""

    at: Array
    slope: Array
    curvature: Array

    def log_evidence(self, mean: Array, precision: Array) -> float:
        """With a prior of the parameters, but for what is the same with any prior.

        Args:
            mean, precision: (f,), (f, f) of the prior.
        """
        posterior = self.curvature + precision
        pull = self.slope + precision @ (mean - self.at)
        off = mean - self.at
        height = 0.5 * pull @ np.linalg.solve(posterior, pull) - 0.5 * off @ precision @ off
        return float(height + 0.5 * (np.linalg.slogdet(precision)[1] - np.linalg.slogdet(posterior)[1]))


@cache
def layouts(rotors: int) -> tuple[Layout, ...]:
    """Every way in which so many rotors may stand, the one of which least is known first; none for other inputs.

    Args:
        rotors: inputs that are motors.
    """
    if rotors < FEWEST_ROTORS:
        return ()
    lift = np.full((1, rotors), rotors**-0.5)
    if rotors != 4:
        return (Layout(lift, np.array([LIFT_PRECISION]), 0.0),)
    any_way = Layout(lift, np.array([LIFT_PRECISION]), float(np.log(1 - X_SHARE - PLUS_SHARE)))
    precision = np.array([LIFT_PRECISION, QUIET_PRECISION, QUIET_PRECISION])
    ways = np.array([[1, 1, -1, -1], [1, -1, 1, -1], [1, -1, -1, 1]]) / 2
    in_an_x = [
        Layout(np.vstack([lift, np.delete(ways, turning, axis=0)]), precision, float(np.log(X_SHARE / 3)))
        for turning in range(3)
    ]
    in_a_plus = [
        Layout(np.vstack([lift, *_quiet_in_a_plus(*pair)]), precision, float(np.log(PLUS_SHARE / 6)))
        for pair in combinations(range(4), 2)
    ]
    return any_way, *in_an_x, *in_a_plus


def _quiet_in_a_plus(one: int, other: int) -> tuple[Array, Array]:
    """Where rotor ``one`` works against ``other``: the third against the fourth, and those two against these."""
    turning, against = np.zeros(4), np.full(4, -0.5)
    third, fourth = (rotor for rotor in range(4) if rotor not in (one, other))
    turning[[third, fourth]] = np.array([1, -1]) / np.sqrt(2)
    against[[one, other]] = 0.5
    return turning, against
