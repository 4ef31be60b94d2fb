"""Linear algebra of small positive definite matrices, Gaussian samples, and guards for overflow and BLAS threads.

Positive definite matrices are scaled to a unit diagonal before they are factorized: in generalized coordinates
derivatives of different orders differ by powers of the sampling rate. LAPACK is called directly, because the checks
of SciPy's wrappers take longer than the factorization of such small matrices.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from threading import RLock

import numpy as np
import scipy
from numpy.linalg import LinAlgError
from numpy.random import default_rng
from threadpoolctl import ThreadpoolController

from mavdem.arrays import SMALLEST_POSITIVE, Array, ArrayPair

ROUNDING_TOLERANCE = 1e-9
"""Relative size, to the largest number of the same kind, below which a difference is assumed to be rounding.

A choice: rounding of a float is 2e-16, and the computations here lose up to six digits.
"""


def solve(matrix: Array, right_hand_side: Array) -> Array:
    """Solves matrix · X = right_hand_side for a symmetric positive definite matrix, by Cholesky's factorization.

    Args:
        matrix: (k, k) symmetric positive definite.
        right_hand_side: (k,) or (k, columns) right-hand side.

    Returns:
        X, in the shape of ``right_hand_side``: (k,) or (k, columns).

    Raises:
        numpy.linalg.LinAlgError: the matrix is not positive definite.
    """
    scale, scaled_matrix = _scaled_to_unit_diagonal(matrix)
    _, solution, info = scipy.linalg.lapack.dposv(scaled_matrix, (right_hand_side.T * scale).T)
    _raise_if_not_factorized(info)
    return (solution.T * scale).T


def inverse(matrix: Array) -> Array:
    """Inverts a symmetric positive definite matrix, by Cholesky's factorization.

    Args:
        matrix: (k, k) symmetric positive definite.

    Returns:
        The inverse (k, k), symmetric to the last bit.

    Raises:
        numpy.linalg.LinAlgError: the matrix is not positive definite.
    """
    scale, scaled_matrix = _scaled_to_unit_diagonal(matrix)
    factor, info = scipy.linalg.lapack.dpotrf(scaled_matrix, clean=1)
    _raise_if_not_factorized(info)
    # LAPACK computes only the upper triangle; the entries below it are 0.
    upper_triangle = scipy.linalg.lapack.dpotri(factor)[0] * scale * scale[:, None]
    # The sum with the transpose would count the diagonal, every (k + 1)-th entry, twice: it is halved before.
    upper_triangle.flat[:: len(upper_triangle) + 1] *= 0.5
    return upper_triangle + upper_triangle.T


def logdet(matrix: Array) -> float:
    """Returns the logarithm of the determinant of a symmetric positive definite matrix, by Cholesky's factorization.

    Args:
        matrix: (k, k) symmetric positive definite.

    Raises:
        numpy.linalg.LinAlgError: the matrix is not positive definite.
    """
    scale, scaled_matrix = _scaled_to_unit_diagonal(matrix)
    factor, info = scipy.linalg.lapack.dpotrf(scaled_matrix)
    _raise_if_not_factorized(info)
    # The determinant is Π (L_ii / s_i)², with the Cholesky factor L of the scaled matrix and the scale s.
    return 2.0 * float(np.log(factor.diagonal() / scale).sum())


def _scaled_to_unit_diagonal(matrix: Array) -> ArrayPair:
    """Returns the scale s (k,) and the matrix diag(s) · matrix · diag(s), whose diagonal is ±1.

    A diagonal entry that is not positive stays so, and the factorization that follows reports it.
    """
    scale = 1.0 / np.sqrt(abs(matrix.diagonal()) + SMALLEST_POSITIVE)
    return scale, matrix * scale * scale[:, None]


def _raise_if_not_factorized(info: int) -> None:
    """Raises ``LinAlgError`` if Cholesky's factorization broke down: then LAPACK returns an ``info`` other than 0."""
    if info:
        raise LinAlgError("the matrix is not positive definite")


def normal_draws(mean: Array, covariance: Array, number: int, seed: int) -> Array:
    """Draws samples of a Gaussian, in antithetic pairs and with matched moments.

    The mean of an even number of samples is exactly ``mean``. If there are at least twice as many samples as
    dimensions, their covariance is also exactly ``covariance``, since the standard normal samples are made orthonormal
    first. So a few samples represent the Gaussian well.

    Args:
        mean: (k,) mean.
        covariance: (k, k) covariance; it may be singular.
        number: number of samples.
        seed: seed of the generator; the samples are the same on every processor.

    Returns:
        Samples (number, k).
    """
    # The first half of the standard normal samples; the second half has the opposite signs, so that the mean is 0.
    half_of_samples = default_rng(seed).standard_normal(((number + 1) // 2, len(mean)))
    if len(mean) <= len(half_of_samples):
        # Orthonormal columns, times √(number of rows), have the identity as their sample covariance.
        half_of_samples = np.linalg.qr(half_of_samples)[0] * np.sqrt(len(half_of_samples))
    # The symmetric root is used because it is unique, while the signs of eigenvectors differ between processors. By
    # rounding, eigenvalues of a singular covariance may be slightly negative.
    eigenvalues, eigenvectors = np.linalg.eigh((covariance + covariance.T) / 2)
    covariance_root = eigenvectors * np.sqrt(eigenvalues.clip(0)) @ eigenvectors.T
    standard_samples = np.vstack([half_of_samples, -half_of_samples])[:number]
    return mean + standard_samples @ covariance_root


def require_positive_definite(matrix: Array, name: str, size: int) -> None:
    """Checks that an argument is a finite, symmetric positive definite matrix.

    Args:
        matrix: the argument, which should have the shape (size, size).
        name: name of the argument, with which the error message begins.
        size: expected number of rows and columns.

    Raises:
        ValueError: the argument lacks one of these properties, which the message names.
    """
    if np.shape(matrix) != (size, size):
        raise ValueError(f"{name} must have shape ({size}, {size}), not {np.shape(matrix)}")
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name} must be finite")
    # Asymmetry within rounding is accepted.
    asymmetry = abs(matrix - matrix.T).max(initial=0.0)
    if asymmetry > ROUNDING_TOLERANCE * abs(matrix).max(initial=0.0):
        raise ValueError(f"{name} must be symmetric")
    # An empty matrix has nothing to factorize.
    if size:
        _, scaled_matrix = _scaled_to_unit_diagonal(matrix)
        try:
            # NumPy's factorization, so that a mere check of an argument does not import SciPy's.
            np.linalg.cholesky(scaled_matrix)
        except LinAlgError:
            raise ValueError(f"{name} must be positive definite") from None


may_overflow = np.errstate(over="ignore", invalid="ignore")
"""Decorator of functions whose results may overflow to infinity or NaN, without a warning.

Forecasts of an unstable model overflow, and so do forecasts from huge inputs; callers look at the result.
"""


@contextmanager
def raise_on_overflow() -> Iterator[None]:
    """Returns a context in which arithmetic that overflows or is undefined raises an error instead of returning NaN.

    Raises:
        numpy.linalg.LinAlgError: a result overflowed, or was NaN.
    """
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            yield
    except FloatingPointError as error:
        raise LinAlgError(f"overflow: {error}") from None


_blas_lock = RLock()
"""Held by the thread that has limited BLAS to one thread: the limit is one for the whole process."""


@contextmanager
def one_thread(*, wait: bool = True) -> Iterator[bool]:
    """Limits BLAS to one thread in the context, since the matrices are so small that more threads only take time.

    Args:
        wait: whether to wait while another thread of this process is inside such a context.

    Yields:
        Whether the limit is in force. It is not if another thread is inside such a context and ``wait`` is False.
    """
    # A local name refers to the lock until the end, since a fork replaces the global one. The lock is reentrant: a
    # thread that holds it may open a further context.
    lock = _blas_lock
    if not lock.acquire(blocking=wait):
        yield False
        return
    try:
        with _blas_controller().limit(limits=1, user_api="blas"):
            yield True
    finally:
        lock.release()


def _renew_lock_after_fork() -> None:
    """Gives a forked process a new lock, since the parent's thread that may hold the old one does not exist in it."""
    global _blas_lock
    _blas_lock = RLock()


# Windows has no fork.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_lock_after_fork)


def load_libraries() -> None:
    """Loads the modules of SciPy that learning uses, and finds the BLAS libraries, which :func:`one_thread` needs.

    Otherwise each would be loaded at its first use, in every process. A process that is forked afterwards shares them.
    """
    for module in ("fft", "linalg", "ndimage", "special"):
        import_module(f"scipy.{module}")
    _blas_controller()


@cache
def _blas_controller() -> ThreadpoolController:
    """Returns the controller of the loaded BLAS libraries; finding these takes longer than a fit, so it is kept."""
    # SciPy has its own BLAS, which is found only if it is loaded.
    import_module("scipy.linalg")
    return ThreadpoolController()
