"""Linear regression, also where regressors depend on each other, and drawn in until what it makes is stable."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

Array = NDArray[np.float64]

DEPENDENT = 1e-8
"""Singular values of the regressors below this of the largest count as zero: of all solutions the smallest is taken."""

RIDGES = np.geomspace(1e-12, 1e6, 55)
"""Tried one after the other, per sample: from one that changes nothing to one that leaves nothing."""


def regression(regressors: Array, targets: Array, ridge: NDArray[np.floating] | None = None) -> Array:
    """The smallest least-squares solution (columns, k) of regressors (N, columns) · solution = targets (N, k).

    Args:
        regressors: of about the same size in every column.
        targets: what is explained.
        ridge: (columns,) what the square of each coefficient costs.
    """
    if ridge is not None:
        regressors = np.vstack([regressors, np.diag(np.sqrt(ridge))])
        targets = np.vstack([targets, np.zeros((len(ridge), targets.shape[1]))])
    return np.asarray(np.linalg.lstsq(regressors, targets, rcond=DEPENDENT)[0])


def triangle(table: Array) -> Array:
    """R of the QR decomposition of (N, columns): at most as many rows as columns, with the same inner products."""
    (R,) = qr(table, mode="r", check_finite=False)
    return np.asarray(R[: table.shape[1]], np.float64)


def stable_radius(samples: int) -> float:
    """The spectral radius that a model which is made stable may have: its slowest mode lasts as long as its data."""
    return 1 - 1 / samples


def least_ridge(radius: Callable[[float], float], samples: int) -> float:
    """The first of :data:`RIDGES`, times the number of samples, with which a model's spectral radius is small enough.

    Args:
        radius: the spectral radius of the model of a ridge.
        samples: that it is learnt from.
    """
    enough = (ridge for ridge in RIDGES * samples if radius(ridge) <= stable_radius(samples))
    return float(next(enough, RIDGES[-1] * samples))
