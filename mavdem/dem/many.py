"""Many calls of one function at once: on this machine's cores, on threads, or on a cluster."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from functools import partial
from itertools import chain, islice
from typing import TypeVar

from mavdem.dem.workers import Pool, pool, spare_cores, told_to_stop

Job = TypeVar("Job")
Answer = TypeVar("Answer")

FEW = 8
"""So many jobs are done sooner here than by workers, which take about a second to start."""

LARGEST_CHUNK = 8
"""Jobs sent together at most. A flight that they share is sent once, and so is the one their answers share."""

JOBS_PER_SIZE = 32
"""After so many jobs chunks grow by one job."""

AHEAD = 8
"""Chunks per worker of our own that are sent before the answer that is waited for: the others' answers are kept until
then, and one slow job should not keep the other workers idle."""

AHEAD_ELSEWHERE = 256
"""The same for a given executor, of which nobody can ask how many workers it has."""


def answer_many(
    work: Callable[[Job], Answer], jobs: Iterable[Job], executor: Executor | None = None
) -> Generator[Answer, None, None]:
    """``work`` of each of many jobs; answers in their order, as soon as they are there.

    Jobs are taken from ``jobs`` a bounded number ahead of the answers, so both may be endless. Closing the generator,
    or an exception, cancels what is not begun. By default one process works on each core this process may use, and in a
    worker of another pool, or for a few jobs, this process does by itself. The processes end with the generator, as
    soon as the jobs they are at; a given ``executor`` is left running.

    Args:
        work: for other processes a function of a module, or a ``partial`` of one.
        jobs: its arguments, and what it answers, must pickle for other processes.
        executor: does the work; any ``concurrent.futures.Executor``.

    Raises:
        concurrent.futures.BrokenExecutor: a worker died, such as for want of memory.
        Exception: what ``work`` and ``jobs`` raised.
    """
    jobs = iter(jobs)
    sent: deque[Future[list[Answer]]] = deque()
    if executor is not None:
        try:
            yield from _answer_on(executor, work, jobs, sent, AHEAD_ELSEWHERE)
        finally:
            # Workers that a signal to the whole group has ended break a pool, which before Python 3.13 waits for ever
            # where jobs are cancelled.
            if not isinstance(executor, Pool):
                for future in sent:
                    future.cancel()
        return
    first = list(islice(jobs, FEW + 1))
    workers = spare_cores() if len(first) > FEW else 1
    jobs = chain(first, jobs)
    if workers == 1:
        for job in jobs:
            yield from _answer_each(work, [job])
        return
    with pool(workers) as own:
        yield from _answer_on(own, work, jobs, sent, AHEAD * workers)


def _answer_on(
    executor: Executor,
    work: Callable[[Job], Answer],
    jobs: Iterable[Job],
    sent: deque[Future[list[Answer]]],
    ahead: int,
) -> Generator[Answer, None, None]:
    """``sent`` holds what is on its way, of which there are at most ``ahead``."""
    try:
        for chunk in _chunks(jobs):
            sent.append(executor.submit(partial(_answer_each, work), chunk))
            while sent and (len(sent) >= ahead or sent[0].done()):
                yield from sent[0].result()
                sent.popleft()
        while sent:
            yield from sent[0].result()
            sent.popleft()
    except BrokenExecutor as error:
        # A broken pool breaks these off itself, and before Python 3.13 it cannot where they are cancelled.
        sent.clear()
        raise type(error)(
            "a worker died: for want of memory, killed, or unable to start. Ask for fewer at a time with an executor "
            "of fewer workers; and where a script calls this, do so below `if __name__ == '__main__':`"
        ) from error


def _chunks(jobs: Iterable[Job]) -> Iterator[list[Job]]:
    """Single jobs first, so that a few reach all workers, and more at a time when there prove to be many."""
    jobs, taken = iter(jobs), 0
    while chunk := list(islice(jobs, min(1 + taken // JOBS_PER_SIZE, LARGEST_CHUNK))):
        taken += len(chunk)
        yield chunk


def _answer_each(work: Callable[[Job], Answer], jobs: list[Job]) -> list[Answer]:
    return [work(job) for job in jobs if not told_to_stop()]
