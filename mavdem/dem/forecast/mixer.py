"""Mixer geometry: which combinations of rotors may turn a vehicle about an axis, where no parameters say it."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from mavdem.dem.engine.linalg import Array

FEWEST_ROTORS = 3  # with fewer inputs they are not a multirotor's motors, but demands about an axis


def turning_patterns(rotors: int) -> list[Array]:
    """Returns (rotors,) combinations of unit length: of four rotors those of an X, then of a plus; else none."""
    if rotors != 4:
        return []
    x = np.array([[1, 1, -1, -1], [1, -1, 1, -1], [1, -1, -1, 1]]) / 2
    plus = [(np.eye(4)[one] - np.eye(4)[other]) / np.sqrt(2) for one, other in combinations(range(4), 2)]
    return [*x, *plus]
