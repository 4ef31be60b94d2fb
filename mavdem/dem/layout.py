"""Layouts: how a vehicle's rotors may stand, and so which of their pushes turn it, before a flight has told.

Rotors that all push a little more lift the vehicle and hardly turn it. Four rotors mostly stand in an X, two on either
side of each axis, so that two work against two; or in a plus, so that one works against one and two do nothing. Which
it is the flight tells: by how probable it is at best with each layout, known to second order from where one climb has
ended. Volumes of the posterior have no say: combinations that a flight hardly excites would count for the layout that
holds those it does.
"""

from __future__ import annotations

from functools import cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

QUIET_PRECISION = 0.1
"""Prior precision, in the engine's units, of the effect of a combination that does not turn the vehicle: it is within 3
or so of nothing, since rotors are not quite alike and loads not quite centred."""

ANY_EFFECT = 50.0
"""Size that the effect of a combination otherwise may have: it is the less likely to be found so near nothing."""

FEWEST_ROTORS = 3
"""With fewer inputs they are not a multirotor's motors, but what somebody demands of an axis."""

X_SHARE, PLUS_SHARE = 0.95, 0.05
"""Of vehicles with four rotors."""


class Layout(NamedTuple):
    """One way in which r rotors may stand.

    Attributes:
        quiet: (k, r) combinations of their pushes, of unit length and at right angles, that hardly turn the vehicle.
        log_odds: natural logarithm of how likely it is beforehand, against rotors that stand in any way.
    """

    quiet: Array
    log_odds: float

    @classmethod
    def of(cls, quiet: Array, share: float) -> Layout:
        """Of combinations that are quiet in this share of vehicles."""
        return cls(quiet, float(np.log(share)) + len(quiet) * float(np.log(ANY_EFFECT * QUIET_PRECISION**0.5)))

    @property
    def turning(self) -> Array | None:
        """(r,) the one combination that turns the vehicle, of unit length; ``None`` where several may."""
        if len(self.quiet) != self.quiet.shape[1] - 1:
            return None
        way = np.linalg.svd(self.quiet)[2][-1]
        way[np.abs(way) < np.abs(way).max() / 2] = 0.0
        return np.asarray(way * np.sign(way[np.flatnonzero(way)[0]]))

    def added_precision(self, sizes: tuple[int, int, int], rows: NDArray[np.intp]) -> Array:
        """(k, k) what it adds to the prior precision of θ.

        Args:
            sizes: n states, r inputs, of which those after the rotors are others, and m outputs.
            rows: of B that the rotors may move.
        """
        n, r, m = sizes
        added = np.zeros((n * n + n * r + m * n,) * 2)
        of_row = QUIET_PRECISION * self.quiet.T @ self.quiet
        for row in rows:
            places = n * n + row * r + np.arange(len(of_row))
            added[np.ix_(places, places)] = of_row
        return added


class Likelihood(NamedTuple):
    """The log likelihood about some parameters, to second order: its slope (f,) and its curvature (f, f) there."""

    at: Array
    slope: Array
    curvature: Array

    def height(self, mean: Array, precision: Array) -> float:
        """The log joint where it is highest with a prior of the parameters, but for what is the same with any prior.

        Args:
            mean, precision: (f,), (f, f) of the prior.
        """
        posterior = self.curvature + precision
        pull = self.slope + precision @ (mean - self.at)
        off = mean - self.at
        return float(0.5 * pull @ np.linalg.solve(posterior, pull) - 0.5 * off @ precision @ off)


@cache
def layouts(rotors: int) -> tuple[Layout, ...]:
    """Every way in which so many rotors may stand, any way first; none for other inputs.

    Args:
        rotors: inputs that are motors.
    """
    if rotors < FEWEST_ROTORS:
        return ()
    any_way, lift = Layout(np.empty((0, rotors)), 0.0), np.full((1, rotors), rotors**-0.5)
    if rotors != 4:
        return any_way, Layout.of(lift, 1.0)
    ways = np.array([[1, 1, -1, -1], [1, -1, 1, -1], [1, -1, -1, 1]]) / 2
    in_an_x = [Layout.of(np.vstack([lift, np.delete(ways, turning, axis=0)]), X_SHARE / 3) for turning in range(3)]
    in_a_plus = [
        Layout.of(np.vstack([lift, *_quiet_in_a_plus(*pair)]), PLUS_SHARE / 6) for pair in combinations(range(4), 2)
    ]
    return any_way, *in_an_x, *in_a_plus


def _quiet_in_a_plus(one: int, other: int) -> tuple[Array, Array]:
    """Where rotor ``one`` works against ``other``: the third against the fourth, and those two against these."""
    turning, against = np.zeros(4), np.full(4, -0.5)
    third, fourth = (rotor for rotor in range(4) if rotor not in (one, other))
    turning[[third, fourth]] = np.array([1, -1]) / np.sqrt(2)
    against[[one, other]] = 0.5
    return turning, against
