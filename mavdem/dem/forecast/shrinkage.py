"""Shrinkage of forecasts towards the trim, by the posterior variance of θ under the inputs of the forecast.

A priori a deviation from the trim has variance S: as in training, and more where the motors work harder than they did
then. A forecast d whose own variance is V is then shrunk to d / (1 + V/S), with variance V / (1 + V/S), and more the
larger it is. The deviation may be true all the same, in the share 1 / (1 + V/S), so that what was removed counts as an
expected error. All in units of the training data's spread.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.engine.linalg import Array

DOUBLING_DEVIATION = 5.0  # in standard deviations √S: at this deviation a forecast's variance counts twice


def prior_variance(inputs: Array, steps: int) -> Array:
    """S (T, 1) of forecasts begun at every ``steps``-th row: the motors' mean square over each of them, at least 1."""
    squares = np.mean(inputs**2, axis=1)
    begins = np.arange(0, len(squares), steps)
    lengths = np.diff(np.append(begins, len(squares)))
    return np.repeat(np.maximum(1.0, np.add.reduceat(squares, begins) / lengths), lengths)[:, None]


def shrunk(deviation: Array, variance: Array, prior: Array) -> Array:
    """The deviations (T, m) shrunk by V (T, m) and S (T, 1); 0 where the variance overflows."""
    _, d, V = _finite(deviation, variance)
    return np.asarray(d / (1 + V / prior * (1 + d**2 / (prior * DOUBLING_DEVIATION**2))))


def expected_error(deviation: Array, variance: Array, prior: Array) -> Array:
    """(T, m) expected squared error of the shrunk forecast, as far as θ is its cause."""
    finite, d, V = _finite(deviation, variance)
    removed = d - shrunk(d, V, prior)
    return np.where(finite, (V + removed**2) / (1 + V / prior), prior)


def _finite(deviation: Array, variance: Array) -> tuple[NDArray[np.bool_], Array, Array]:
    """Where both are finite, and both with 0 elsewhere."""
    finite = np.isfinite(variance) & np.isfinite(deviation)
    return finite, np.where(finite, deviation, 0.0), np.where(finite, variance, 0.0)
