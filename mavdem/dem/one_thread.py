"""Linear algebra gets one thread, since the matrices are small: waking others takes several times as long as the work.

That holds for the whole process, so threads that learn take turns; they would hardly be faster together.
"""

from __future__ import annotations

import os
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


@contextmanager
def one_thread_if_free() -> Iterator[bool]:
    """The same for who cannot wait: yields whether it is held, and does not where another thread has its turn."""
    free = _turn.acquire(blocking=False)
    try:
        if free:
            with _linear_algebra().limit(limits=1, user_api="blas"):
                yield True
        else:
            yield False
    finally:
        if free:
            _turn.release()


def _begin_anew() -> None:
    """In a process that was forked while another thread had its turn: that thread is not in it, and never ends it."""
    global _turn
    _turn = Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_begin_anew)


@cache
def _linear_algebra() -> ThreadpoolController:
    """Looking for the libraries takes longer than a fit."""
    return ThreadpoolController()
