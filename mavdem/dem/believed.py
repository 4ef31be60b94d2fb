"""Believed: how far a forecast is, by what the posterior of θ makes of the inputs it is asked for.

Beforehand a deviation from the trim is as large as in training, and larger where the motors work harder than they did
then: of variance S. A forecast d whose own variance is V then tells of a deviation of d / (1 + V/S), and leaves
V / (1 + V/S) open. A vehicle that is held never is very far from its trim, though: the farther a forecast leads, the
less it is believed. What is not believed may be true all the same, in the share 1 / (1 + V/S), and is expected as an
error.

All in units of the training data's spread.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FAR = 5.0
"""Times the root of S: at such a deviation a forecast's variance counts twice."""


def sizes(inputs: Array, steps: int) -> Array:
    """S (T, 1) of forecasts begun at every ``steps``-th row: how hard the motors work over each of them, at least 1.

    Args:
        inputs: (T, r) of the motors, of mean square 1 in training.
        steps: that each forecast is long.
    """
    squares = np.mean(inputs**2, axis=1)
    begins = np.arange(0, len(squares), steps)
    if not len(begins):
        return np.empty((0, 1))
    lengths = np.diff(np.append(begins, len(squares)))
    return np.repeat(np.maximum(1.0, np.add.reduceat(squares, begins) / lengths), lengths)[:, None]


def believed(deviation: Array, variance: Array, size: Array) -> Array:
    """What is believed of deviations (T, m); of one whose variance is beyond all numbers nothing.

    Args:
        deviation: forecast.
        variance: V, (T, m).
        size: S, (T, 1).
    """
    _, d, V = _within_numbers(deviation, variance)
    return np.asarray(d / (1 + V / size * (1 + d**2 / (size * FAR**2))))


def expected_error(deviation: Array, variance: Array, size: Array) -> Array:
    """(T, m) squared error of what is believed, as far as θ is its cause: V and what is not believed, over 1 + V/S.

    Args:
        deviation, variance, size: as of :func:`believed`.
    """
    within, d, V = _within_numbers(deviation, variance)
    off = d - believed(d, V, size)
    return np.where(within, (V + off**2) / (1 + V / size), size)


def _within_numbers(deviation: Array, variance: Array) -> tuple[NDArray[np.bool_], Array, Array]:
    """Where both are numbers, and both with 0 where they are not."""
    within = np.isfinite(variance) & np.isfinite(deviation)
    return within, np.where(within, deviation, 0.0), np.where(within, variance, 0.0)
