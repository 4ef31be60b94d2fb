"""What runs beside the samples of a live session, or goes on for some seconds after them."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import ExitStack
from multiprocessing import active_children
from threading import Thread
from typing import Any, TypeVar

from mavdem.dem.parallel import pool

LOW_PRIORITY = 10  # Niceness, 0 to 19, of the process that learns: samples do not wait for a core

Result = TypeVar("Result")


class LearningProcess(Executor):
    """An executor with one process of low priority; if that is killed, the next job runs in a new one."""

    def __init__(self) -> None:
        self._exits = ExitStack()
        self._start()

    def submit(self, job: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """Runs a job; see ``concurrent.futures.Executor``."""
        try:
            return self._pool.submit(job, *args, **kwargs)
        except BrokenExecutor:
            self._start()
            return self._pool.submit(job, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Kills the process, whatever it computes."""
        for child in self._children:
            child.kill()
        self._exits.close()

    def _start(self) -> None:
        self._exits.close()
        others = active_children()
        self._pool = self._exits.enter_context(pool(1))
        self._children = [child for child in active_children() if child not in others]
        if hasattr(os, "nice"):
            self._pool.submit(os.nice, LOW_PRIORITY)


def in_background(work: Callable[[], Result]) -> Future[Result]:
    """Starts ``work`` in a thread; the process ends without waiting for it."""
    future: Future[Result] = Future()

    def run() -> None:
        try:
            future.set_result(work())
        except BaseException as error:  # whoever waits for the result gets it
            future.set_exception(error)

    Thread(target=run, daemon=True).start()
    return future
