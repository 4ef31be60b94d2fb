"""Many fits at once: the same call on this machine's cores, on threads, or on a cluster."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures import Executor

from mavdem.dem.learn import learn
from mavdem.dem.learned import Learned
from mavdem.dem.many import answer_many
from mavdem.dem.record import Recorded
from mavdem.dem.settings import Settings

Job = tuple[Recorded | Sequence[Recorded], Settings | None]
"""What ``learn`` takes: a flight, and settings or ``None`` for the default ones."""


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
    return answer_many(_answer, _checked(jobs), executor)


def _checked(jobs: Iterable[Job]) -> Iterator[Job]:
    for job in jobs:
        if not (isinstance(job, tuple | list) and len(job) == 2):
            raise ValueError(f"jobs must be pairs of a flight and its settings, not {job!r}")
        train, settings = job
        yield train, settings


def _answer(job: Job) -> Learned | ValueError:
    train, settings = job
    try:
        return learn(train, settings)
    except ValueError as error:
        # A traceback would keep the fit's arrays, and would not come through from another process.
        return error.with_traceback(None)
