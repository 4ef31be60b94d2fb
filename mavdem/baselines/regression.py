"""Linear regression, also with dependent regressors, and with a ridge that makes a model stable."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from mavdem.dem.engine.linalg import Array

RANK_TOLERANCE = 1e-8
"""Singular values of the regressors below this of the largest count as zero: of all solutions the smallest is taken."""

RIDGES = np.geomspace(1e-12, 1e6, 55)  # tried one after the other, per sample: from no effect to zero coefficients


def regression(regressors: Array, targets: Array, ridge: NDArray[np.floating] | None = None) -> Array:
    """The smallest least-squares solution (columns, k) of regressors (N, columns) · solution = targets (N, k).

    The square of each coefficient costs its ``ridge`` (columns,).
    """
    if ridge is not None:
        regressors = np.vstack([regressors, np.diag(np.sqrt(ridge))])
        targets = np.vstack([targets, np.zeros((len(ridge), targets.shape[1]))])
    return np.asarray(np.linalg.lstsq(regressors, targets, rcond=RANK_TOLERANCE)[0])


def triangle(table: Array) -> Array:
    """R of the QR decomposition of (N, columns): at most as many rows as columns, with the same inner products."""
    (R,) = qr(table, mode="r", check_finite=False)
    return np.asarray(R[: table.shape[1]], np.float64)


def stable_radius(samples: int) -> float:
    """The largest spectral radius of a stabilised model: its slowest mode decays within the length of its data."""
    return 1 - 1 / samples


def least_ridge(radius: Callable[[float], float], samples: int) -> float:
    """The first of :data:`RIDGES`, times the number of samples, whose model has a small enough spectral radius."""
    enough = (ridge for ridge in RIDGES * samples if radius(ridge) <= stable_radius(samples))
    return float(next(enough, RIDGES[-1] * samples))
