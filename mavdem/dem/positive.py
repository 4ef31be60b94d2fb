"""Positive definite matrices: inverse, solution and log determinant by Cholesky's factorization.

Derivatives of different orders differ by powers of the sampling rate, so matrices are first scaled to a unit diagonal;
their condition then tells what the data determine, not which unit time is measured in. LAPACK is called directly: the
matrices are so small that SciPy's wrappers would cost more than the work.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv, dpotrf, dpotri

Array = NDArray[np.float64]


def solve(matrix: Array, right: Array) -> Array:
    """matrix⁻¹ right, for a positive definite matrix (k, k); ``numpy.linalg.LinAlgError`` if it is not."""
    unit, scaled = _scaled(matrix)
    _, solution, failed = dposv(scaled, (right.T * unit).T)
    _check(failed)
    return np.asarray((solution.T * unit).T)


def inverse(matrix: Array) -> Array:
    """matrix⁻¹, symmetric to the last bit; ``numpy.linalg.LinAlgError`` if it is not positive definite."""
    unit, scaled = _scaled(matrix)
    factor, failed = dpotrf(scaled, clean=1)
    _check(failed)
    # Both keep to the upper triangle and leave zeros below it.
    upper = dpotri(factor)[0] * unit * unit[:, None]
    upper.flat[:: len(upper) + 1] *= 0.5
    return np.asarray(upper + upper.T)


def logdet(matrix: Array) -> float:
    """ln|matrix|; ``numpy.linalg.LinAlgError`` if it is not positive definite."""
    unit, scaled = _scaled(matrix)
    factor, failed = dpotrf(scaled)
    _check(failed)
    return 2.0 * float(np.log(factor.diagonal() / unit).sum())


def _scaled(matrix: Array) -> tuple[Array, Array]:
    diagonal = matrix.diagonal()
    _check(not (diagonal > 0).all())
    unit = 1.0 / np.sqrt(diagonal)
    return unit, matrix * unit * unit[:, None]


def _check(failed: int) -> None:
    if failed:
        raise np.linalg.LinAlgError("the matrix is not positive definite")
