"""A process beside the live path that does what takes long, and that another replaces when it is gone."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import ExitStack
from typing import ParamSpec, TypeVar

from mavdem.dem.workers import pool

LOW_PRIORITY = 10
"""Of 0 to 19: how far whole learnings stand back."""

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class LearningProcess(Executor):
    """An executor of one process, which stands back behind all others.

    What runs in a process that is killed is lost, and its future says so; what is submitted next runs in a new one.
    """

    def __init__(self) -> None:
        self._ends = ExitStack()
        self._begin()

    def submit(
        self, job: Callable[Arguments, Result], /, *args: Arguments.args, **kwargs: Arguments.kwargs
    ) -> Future[Result]:
        """Runs a job; see ``concurrent.futures.Executor``."""
        try:
            return self._pool.submit(job, *args, **kwargs)
        except BrokenExecutor:
            self._begin()
            return self._pool.submit(job, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Ends the process and waits until it is gone."""
        self._ends.close()

    def _begin(self) -> None:
        self._ends.close()
        self._pool = self._ends.enter_context(pool(1))
        if hasattr(os, "nice"):
            # Whole learnings may take their time; samples may not wait for a core.
            self._pool.submit(os.nice, LOW_PRIORITY)
