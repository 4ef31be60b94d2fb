"""Linear algebra of small matrices: Cholesky's factorization, overflow as an error, and one BLAS thread.

Matrices are first scaled to a unit diagonal: derivatives of different orders differ by powers of the sampling rate.
LAPACK is called directly, since SciPy's wrappers would cost more than the work.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from threading import RLock
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv, dpotrf, dpotri
from threadpoolctl import ThreadpoolController

Array = NDArray[np.float64]

SMALLEST = 1e-300  # keeps a zero on the diagonal from being divided by
SYMMETRY = 1e-9  # rounding that a symmetric matrix may show, relative to its largest entry


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
    # A diagonal that is not positive stays so, and the factorization fails: a check here would cost as much.
    unit = 1.0 / np.sqrt(np.abs(matrix.diagonal()) + SMALLEST)
    return unit, matrix * unit * unit[:, None]


def _check(failed: int) -> None:
    if failed:
        raise np.linalg.LinAlgError("the matrix is not positive definite")


def require_positive_definite(matrix: Array, name: str, size: int) -> None:
    """``ValueError``, which names the argument, unless it is a symmetric positive definite (size, size) matrix."""
    if np.shape(matrix) != (size, size):
        raise ValueError(f"{name} must have shape ({size}, {size}), not {np.shape(matrix)}")
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name} must be finite")
    if np.abs(matrix - matrix.T).max(initial=0.0) > SYMMETRY * np.abs(matrix).max(initial=0.0):
        raise ValueError(f"{name} must be symmetric")
    if size:
        try:
            logdet(matrix)
        except np.linalg.LinAlgError:
            raise ValueError(f"{name} must be positive definite") from None


@contextmanager
def raise_on_overflow() -> Iterator[None]:
    """Raises ``numpy.linalg.LinAlgError`` instead of continuing with infinity or NaN."""
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            yield
    except FloatingPointError as error:
        raise np.linalg.LinAlgError(f"overflow: {error}") from None


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


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_new_lock)


@cache
def _linear_algebra() -> ThreadpoolController:
    """Looking for the libraries takes longer than a fit."""
    return ThreadpoolController()


class Quadratic(NamedTuple):
    """A function to second order about a point: its value and slope there, and its negative's curvature."""

    at: Array
    value: float
    slope: Array
    curvature: Array

    @property
    def remaining(self) -> float:
        """What the function gains up to the maximum of the quadratic."""
        return float(0.5 * self.slope @ np.linalg.solve(self.curvature, self.slope))


class Objective(Protocol):
    """A function to maximise."""

    def value(self, at: Array) -> tuple[float, Array]:
        """The value at a point (f,), NaN where there is none, and the residuals that it is made of."""

    def quadratic(self, at: Array, residuals: Array) -> Quadratic:
        """The function to second order about a point whose residuals are known."""


class Damping(NamedTuple):
    """How steps are damped."""

    first: float  # damping of the first step, as a share of the curvature's diagonal
    # times more after a step that does not increase the function, and less after one that does
    factor: float
    attempts: int  # at most for one step
    limited: Callable[[Array], Array] = np.asarray  # makes a step (f,) short enough to be trusted
    careful: bool = False  # compare the gain with what the quadratic predicts before damping less

    def after(self, damping: float, gained: float, predicted: float) -> float:
        """The damping of the step after one that increased the function."""
        if not self.careful or gained > predicted / 2:
            return max(damping / self.factor, 1e-6) if self.careful else damping / self.factor
        return damping if gained > predicted / 5 else 4 * damping


def gauss_newton(
    objective: Objective, start: Quadratic, damping: Damping, iterations: int, converged: float
) -> tuple[list[Quadratic], float]:
    """Maximises from ``start`` until a step gains no more than ``converged``, by at most so many steps.

    Levenberg and Marquardt's method (Nocedal and Wright, Numerical Optimization, 2nd ed., 10.3): a step that does not
    increase the function is damped more; after one that does, the next is damped less.

    Returns the function about each iterate, the start's first; and what the last step gained or, where no attempt at a
    step increased the function, what the last quadratic still predicts.
    """
    trace = [start]
    damped = damping.first
    gained = np.inf
    while gained > converged and len(trace) <= iterations:
        now = trace[-1]
        for _ in range(damping.attempts):
            curvature = now.curvature + damped * np.diag(now.curvature.diagonal())
            step: Array = damping.limited(
                np.asarray(np.linalg.solve(curvature, now.slope), np.float64)
            )
            value, residuals = objective.value(now.at + step)
            gained = value - now.value
            if gained > 0:
                break
            damped *= damping.factor
        if not gained > 0:
            return trace, now.remaining
        damped = damping.after(
            damped, gained, float(now.slope @ step - 0.5 * step @ now.curvature @ step)
        )
        trace.append(objective.quadratic(now.at + step, residuals))
    return trace, gained
