"""Many fits at once: the same call on this machine's cores, on threads, or on a cluster."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from itertools import chain, islice

from mavdem.dem.learn import learn
from mavdem.dem.learned import Learned
from mavdem.dem.record import Recorded
from mavdem.dem.settings import Settings
from mavdem.dem.workers import pool, spare_cores, told_to_stop

Job = tuple[Recorded | Sequence[Recorded], Settings | None]
"""What ``learn`` takes: a flight, and settings or ``None`` for the default ones."""

Answer = Learned | ValueError
"""What ``learn`` made of a job: the model, or why there is none."""

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


def learn_many(
    jobs: Iterable[tuple[Recorded | Sequence[Recorded], Settings | None]], executor: Executor | None = None
) -> Generator[Learned | ValueError, None, None]:
    """Learns a model for each of many jobs; answers in their order, as soon as they are there.

    Answers are those of ``learn``, bit by bit where the workers' processors and libraries are this machine's. Jobs are
    taken from ``jobs`` a bounded number ahead of the answers, so both may be endless. Closing the generator, or an
    exception, cancels what is not begun.

    By default one process works on each core this process may use, and in a worker of another pool, or for a few jobs,
    this process does by itself. The processes import the running script: call this below ``if __name__ ==
    "__main__":``. They end with the generator, as soon as the fits they are at; a given ``executor`` is left running.
    On a cluster, for instance (``pip install mavdem[dask]``)::

        with distributed.Client("tcp://scheduler:8786") as client:
            for answer in mavdem.learn_many(jobs, client.get_executor()):
                ...

    Args:
        jobs: pairs of what ``learn`` takes: a flight or its segments, and settings or ``None``. For an executor of
            other processes they must pickle, as ``Flight`` and ``Settings`` do.
        executor: does the work; any ``concurrent.futures.Executor``. Threads of a process take turns.

    Yields:
        for each job what ``learn`` returned, or the ``ValueError`` that it raised.

    Raises:
        concurrent.futures.BrokenExecutor: a worker died, such as for want of memory.
        Exception: anything but a ``ValueError`` that ``learn`` raised, and what ``jobs`` raised.
    """
    jobs = _checked(jobs)
    sent: deque[Future[list[Answer]]] = deque()
    if executor is not None:
        try:
            yield from _learn_on(executor, jobs, sent, AHEAD_ELSEWHERE)
        finally:
            for future in sent:
                future.cancel()
        return
    first = list(islice(jobs, FEW + 1))
    workers = spare_cores() if len(first) > FEW else 1
    jobs = chain(first, jobs)
    if workers == 1:
        for job in jobs:
            yield from _learn_each([job])
        return
    with pool(workers) as own:
        yield from _learn_on(own, jobs, sent, AHEAD * workers)


def _learn_on(
    executor: Executor, jobs: Iterable[Job], sent: deque[Future[list[Answer]]], ahead: int
) -> Generator[Answer, None, None]:
    """``sent`` holds what is on its way, of which there are at most ``ahead``."""
    try:
        for chunk in _chunks(jobs):
            sent.append(executor.submit(_learn_each, chunk))
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


def _checked(jobs: Iterable[Job]) -> Iterator[Job]:
    for job in jobs:
        if not (isinstance(job, tuple | list) and len(job) == 2):
            raise ValueError(f"jobs must be pairs of a flight and its settings, not {job!r}")
        train, settings = job
        yield train, settings


def _learn_each(jobs: list[Job]) -> list[Answer]:
    return [_answer(train, settings) for train, settings in jobs if not told_to_stop()]


def _answer(train: Recorded | Sequence[Recorded], settings: Settings | None) -> Answer:
    try:
        return learn(train, settings)
    except ValueError as error:
        # A traceback would keep the fit's arrays, and would not come through from another process.
        return error.with_traceback(None)
