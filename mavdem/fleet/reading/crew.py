"""Crew: the logs of a run, read by several processes of this machine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Protocol

from mavdem.fleet.reading.limited_worker import SECONDS_TO_END, LimitedWorker
from mavdem.fleet.reading.outcome import READ_LOG, Job, Limits, ReadOutcome
from mavdem.fleet.reading.sources import Source


class Reader(Protocol):
    """What reads many logs: a crew of this machine, or a cluster.

    Attributes:
        limits: of each log.
    """

    limits: Limits

    def outcomes(
        self, sources: Sequence[Source], job_of: Callable[[Source], Job]
    ) -> Iterator[tuple[Source, ReadOutcome]]:
        """Each log with its outcome, in the order in which they end; ``job_of`` is called when its turn has come."""


class Crew:
    """Reads logs with so many processes at a time, each within ``limits``, by the function ``read``."""

    def __init__(self, processes: int, limits: Limits, read: str = READ_LOG) -> None:
        self.processes = processes
        self.limits = limits
        self.read = read

    def outcomes(
        self, sources: Sequence[Source], job_of: Callable[[Source], Job]
    ) -> Iterator[tuple[Source, ReadOutcome]]:
        """As :class:`Reader` has it; raises ``Unreadable`` if no process can be started."""
        left, taking = iter(sources), Lock()
        done: SimpleQueue[tuple[Source, ReadOutcome] | Exception] = SimpleQueue()
        workers = [LimitedWorker(self.limits, self.read) for _ in range(min(self.processes, len(sources)))]

        def work(worker: LimitedWorker) -> None:
            try:
                while True:
                    with taking:
                        source = next(left, None)
                        job = None if source is None else job_of(source)
                    if source is None or job is None:
                        return
                    done.put((source, worker.run(job)))
            except Exception as error:
                done.put(error)
            finally:
                worker.close()

        threads = [Thread(target=work, args=(worker,), daemon=True) for worker in workers]
        for thread in threads:
            thread.start()
        try:
            for _ in sources:
                found = done.get()
                if isinstance(found, Exception):
                    raise found
                yield found
        finally:
            for worker in workers:
                worker.stop()
            for thread in threads:
                thread.join(SECONDS_TO_END)
