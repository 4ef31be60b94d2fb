"""Linear algebra of small matrices: Cholesky's factorization, overflow as an error, and one BLAS thread.

Matrices are first scaled to a unit diagonal: derivatives of different orders differ by powers of the sampling rate.
LAPACK is called directly, since SciPy's wrappers would cost more than the work.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from threading import RLock

import numpy as np
from numpy.linalg import LinAlgError
from numpy.random import default_rng
from scipy.linalg.lapack import dposv, dpotrf, dpotri
from threadpoolctl import ThreadpoolController

from mavdem.arrays import Array, ArrayPair

# keeps zeros from being divided by, or their logarithms from being taken
SMALLEST_POSITIVE = np.finfo(np.float64).tiny
ROUNDING_TOLERANCE = 1e-9
"""Of a number, relative to the largest like it: what differs, grows or varies by less does so by rounding."""


def solve(matrix: Array, right: Array) -> Array:
    """Returns matrix⁻¹ right, for a positive definite matrix (k, k); ``numpy.linalg.LinAlgError`` if it is not."""
    unit, scaled = _scaled(matrix)
    _, solution, failed = dposv(scaled, (right.T * unit).T)
    _check(failed)
    return (solution.T * unit).T


def inverse(matrix: Array) -> Array:
    """Returns matrix⁻¹, symmetric to the last bit; ``numpy.linalg.LinAlgError`` if it is not positive definite."""
    unit, scaled = _scaled(matrix)
    factor, failed = dpotrf(scaled, clean=1)
    _check(failed)
    # Both keep to the upper triangle and leave zeros below it.
    upper = dpotri(factor)[0] * unit * unit[:, None]
    upper.flat[:: len(upper) + 1] *= 0.5
    return upper + upper.T


def logdet(matrix: Array) -> float:
    """Returns ln|matrix|; ``numpy.linalg.LinAlgError`` if it is not positive definite."""
    unit, scaled = _scaled(matrix)
    factor, failed = dpotrf(scaled)
    _check(failed)
    return 2.0 * float(np.log(factor.diagonal() / unit).sum())


def _scaled(matrix: Array) -> ArrayPair:
    # A diagonal that is not positive stays so, and the factorization fails: a check here would cost as much.
    unit = 1.0 / np.sqrt(abs(matrix.diagonal()) + SMALLEST_POSITIVE)
    return unit, matrix * unit * unit[:, None]


def _check(failed: int) -> None:
    if failed:
        raise LinAlgError("the matrix is not positive definite")


def normal_draws(mean: Array, covariance: Array, number: int, seed: int) -> Array:
    """Returns a ``number`` of Gaussian draws (number, k) by ``seed``, the same on every processor.

    An even number has this ``mean`` and, of no more than half as many parameters, this ``covariance`` exactly, which
    may be singular.
    """
    half = default_rng(seed).standard_normal(((number + 1) // 2, len(mean)))
    if len(mean) <= len(half):
        half = np.linalg.qr(half)[0] * np.sqrt(len(half))
    # By the symmetric root: in others the signs of eigenvectors are any.
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    root = vectors * np.sqrt(values.clip(0)) @ vectors.T
    return mean + np.vstack([half, -half])[:number] @ root


def require_positive_definite(matrix: Array, name: str, size: int) -> None:
    """Raises ``ValueError``, which names the argument, unless it is symmetric positive definite, (size, size)."""
    if np.shape(matrix) != (size, size):
        raise ValueError(f"{name} must have shape ({size}, {size}), not {np.shape(matrix)}")
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name} must be finite")
    if abs(matrix - matrix.T).max(initial=0.0) > ROUNDING_TOLERANCE * abs(matrix).max(initial=0.0):
        raise ValueError(f"{name} must be symmetric")
    if size:
        try:
            logdet(matrix)
        except LinAlgError:
            raise ValueError(f"{name} must be positive definite") from None


may_overflow = np.errstate(over="ignore", invalid="ignore")
"""Of functions: what an unstable model forecasts, or huge inputs make, becomes infinity or NaN without a warning."""


@contextmanager
def raise_on_overflow() -> Iterator[None]:
    """Raises ``numpy.linalg.LinAlgError`` instead of continuing with infinity or NaN."""
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            yield
    except FloatingPointError as error:
        raise LinAlgError(f"overflow: {error}") from None


_lock = RLock()


@contextmanager
def one_thread(wait: bool = True) -> Iterator[bool]:
    """Limits linear algebra to one thread; other threads that call this ``wait``, or are yielded ``False`` at once."""
    lock = _lock
    if not lock.acquire(blocking=wait):
        yield False
        return
    try:
        with _linear_algebra().limit(limits=1, user_api="blas"):
            yield True
    finally:
        lock.release()


def _new_lock() -> None:
    """In a forked process: a thread of the parent that has the lock is not there to release it."""
    global _lock
    _lock = RLock()


os.register_at_fork(after_in_child=_new_lock)


@cache
def _linear_algebra() -> ThreadpoolController:
    """Looking for the libraries takes longer than a fit."""
    return ThreadpoolController()
