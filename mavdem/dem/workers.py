"""Processes of our own that learn, one on each core, and that nothing leaves behind."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import current_process, get_context, parent_process
from multiprocessing.connection import Connection
from threading import Thread

ENDS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
"""What ends a program from outside."""

_ear: Connection | None = None
"""In a worker: where it hears that its work is not wanted any longer."""


def spare_cores() -> int:
    """How many workers are worth starting: the cores this process may use, or 1 where it is a worker itself."""
    if parent_process() is not None and not _importing_main():
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Pool(ProcessPoolExecutor):
    """One of ours: its jobs are over at once when its block is left, and need not be cancelled."""


@contextmanager
def pool(workers: int) -> Iterator[Pool]:
    """An executor of ``workers`` processes that are gone when its block is left.

    Processes are started afresh ("spawn"): a fork of a process with threads may wait for ever for a lock of theirs.
    """
    if _importing_main():
        sys.exit("mavdem starts processes, which import this script: make that call below `if __name__ == '__main__':`")
    context = get_context("spawn")
    ear, mouth = context.Pipe(duplex=False)
    # Ctrl-C, and a terminal that closes, reach every process of it, but not those begun in here, Python's own for
    # semaphores among them: the parent decides what it means. Nor may anything break off the beginning of a process.
    with _held_back(*ENDS):
        executor = Pool(workers, context, initializer=_begin, initargs=(ear,))
    # The mouth is closed first, which the workers hear, and then waited for them.
    with ear, _waited_for(executor), mouth:
        with _held_back(*ENDS):
            for _ in range(workers):
                executor.submit(os.getpid)
        yield executor


@contextmanager
def _waited_for(executor: Pool) -> Iterator[None]:
    """Ends an executor; what a signal means comes after that.

    A wait for a thread that is broken off by an exception takes the thread for ended (bpo-45274): of the executor's
    own, that leaves the workers without a word, and Python waits for them for ever.
    """
    try:
        yield
    finally:
        with _held_back(*ENDS):
            executor.shutdown()


@contextmanager
def _held_back(*numbers: signal.Signals) -> Iterator[None]:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def told_to_stop() -> bool:
    """Whether this is a worker of :func:`pool` whose answers nobody waits for any longer."""
    return _ear is not None and _ear.poll()  # true where the other end is closed: nothing is ever said


def _importing_main() -> bool:
    """Whether this is a process that another has started, which still imports the other's script."""
    # Nothing public tells; multiprocessing itself asks this to refuse, in thirty lines, what is refused here.
    return getattr(current_process(), "_inheriting", False)


def _begin(ear: Connection) -> None:
    global _ear
    _ear = ear
    # Held back while it began; who wants to end a worker alone may.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A worker waits for its next job for ever, also when the parent was killed."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
