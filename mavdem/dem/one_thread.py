"""Linear algebra gets one thread, since the matrices are small: waking others takes several times as long as the work.

That holds for the whole process, so threads that learn take turns; they would hardly be faster together.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from threading import Lock

from threadpoolctl import ThreadpoolController

_turn = Lock()


@contextmanager
def one_thread() -> Iterator[None]:
    """Holds linear algebra to one thread, and other threads that want the same until it is done."""
    with _turn, _linear_algebra().limit(limits=1, user_api="blas"):
        yield


@cache
def _linear_algebra() -> ThreadpoolController:
    """Looking for the libraries takes longer than a fit."""
    return ThreadpoolController()
