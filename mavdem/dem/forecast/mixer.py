"""Mixer geometry as a prior: which combinations of rotor thrusts turn the vehicle about an axis.

The autopilot's parameters say it; else the flight decides between an X, a plus and none in particular (docs/method.md),
by the highest log joint with each. Volumes of the posterior do not count: combinations that a flight hardly excites
would favour the geometry that fixes those it does.
"""

from __future__ import annotations

from functools import cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from mavdem.dem.engine.linalg import Array

QUIET_PRECISION = 0.1
"""Prior precision, in the engine's units, of the effect of a combination that does not turn the vehicle: its standard
deviation is about 3, since rotors are not quite alike and loads not quite centred."""

ANY_EFFECT = 50.0  # standard deviation of the effect of any other combination, in the engine's units
FEWEST_ROTORS = 3  # with fewer inputs they are not a multirotor's motors, but demands about an axis
X_SHARE, PLUS_SHARE = 0.95, 0.05  # of vehicles with four rotors


class MixerPrior(NamedTuple):
    """One geometry of r rotors."""

    quiet: Array  # (k, r) combinations of thrusts that hardly turn the vehicle, orthonormal
    log_odds: float  # natural logarithm of its prior odds against no geometry in particular

    @classmethod
    def of(cls, quiet: Array, share: float) -> MixerPrior:
        """Of combinations that are quiet in this share of vehicles."""
        return cls(quiet, float(np.log(share)) + len(quiet) * float(np.log(ANY_EFFECT * QUIET_PRECISION**0.5)))

    @property
    def turning(self) -> Array | None:
        """(r,) the one combination that turns the vehicle, of unit length; ``None`` where several may."""
        if len(self.quiet) != self.quiet.shape[1] - 1:
            return None
        direction = np.linalg.svd(self.quiet)[2][-1]
        direction[np.abs(direction) < np.abs(direction).max() / 2] = 0.0
        return np.asarray(direction * np.sign(direction[np.flatnonzero(direction)[0]]))

    def added_precision(self, sizes: tuple[int, int, int], rows: NDArray[np.intp]) -> Array:
        """(k, k) what it adds to the prior precision of θ in those ``rows`` of B that are free for the rotors."""
        n, r, m = sizes
        added = np.zeros((n * n + n * r + m * n,) * 2)
        of_row = QUIET_PRECISION * self.quiet.T @ self.quiet
        for row in rows:
            places = n * n + row * r + np.arange(len(of_row))
            added[np.ix_(places, places)] = of_row
        return added


def mixer_priors(rotors: int, effect_directions: Array | None = None) -> tuple[MixerPrior, ...]:
    """The geometries to choose from, any geometry first; none for inputs that are not rotors.

    Where ``effect_directions`` (rotors,) are known, theirs is the only one.
    """
    if rotors < FEWEST_ROTORS:
        return ()
    if effect_directions is not None and effect_directions.any():
        return (MixerPrior(null_space(effect_directions[None]).T.copy(), 0.0),)
    return _hypotheses(rotors)


@cache
def _hypotheses(rotors: int) -> tuple[MixerPrior, ...]:
    any_geometry, lift = MixerPrior(np.empty((0, rotors)), 0.0), np.full((1, rotors), rotors**-0.5)
    if rotors != 4:
        return any_geometry, MixerPrior.of(lift, 1.0)
    pairs = np.array([[1, 1, -1, -1], [1, -1, 1, -1], [1, -1, -1, 1]]) / 2
    x = [MixerPrior.of(np.vstack([lift, np.delete(pairs, turning, axis=0)]), X_SHARE / 3) for turning in range(3)]
    plus = [
        MixerPrior.of(np.vstack([lift, *_quiet_in_a_plus(*pair)]), PLUS_SHARE / 6) for pair in combinations(range(4), 2)
    ]
    return any_geometry, *x, *plus


def _quiet_in_a_plus(one: int, other: int) -> tuple[Array, Array]:
    """Where rotor ``one`` works against ``other``: the third against the fourth, and those two against these."""
    turning, against = np.zeros(4), np.full(4, -0.5)
    third, fourth = (rotor for rotor in range(4) if rotor not in (one, other))
    turning[[third, fourth]] = np.array([1, -1]) / np.sqrt(2)
    against[[one, other]] = 0.5
    return turning, against
