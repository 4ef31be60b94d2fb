"""A Dask cluster whose workers read logs, each in a process of its own as on one machine."""

from __future__ import annotations

import os
import platform
import re
import socket
from collections.abc import Generator, Iterator
from importlib import metadata
from itertools import chain, islice
from multiprocessing import current_process
from multiprocessing.connection import wait
from typing import Any
from urllib.parse import urlsplit

from mavdem.errors import Unreadable
from mavdem.extras import require
from mavdem.facts import Fact
from mavdem.facts.fleet import Reading
from mavdem.fleet.row import SCHEMA_VERSION
from mavdem.fleet.sources import is_url
from mavdem.fleet.workers import ATTEMPTS, READ_LOG, Job, Limits, LogReader, Outcome, failed

SECONDS_TO_CONNECT = 10.0

# in a worker of the cluster: processes that wait for a log
_idle = list[LogReader]()


class Cluster:
    """Reads logs on the Dask cluster at ``address``, as ``WorkerPool`` does; others take what a dead worker had."""

    def __init__(self, address: str, limits: Limits, read: str = READ_LOG) -> None:
        require("dask")
        if not re.fullmatch(r"\w+://\S+:\d{1,5}", address):
            raise Unreadable(Fact(Reading.NO_ADDRESS, address=address))
        self.address = address
        self.limits = limits
        self.read = read

    def outcomes(self, jobs: Iterator[Job]) -> Generator[Outcome]:
        """As ``Reader`` has it.

        Raises ``Unreadable``: there is no such cluster, it has no worker, or one of its workers has another version of
        mavdem or Python, or cannot see the first file.
        """
        from distributed import Client, KilledWorker, as_completed

        if (first := next(jobs, None)) is None:
            return
        try:
            # Asked first: a client that finds nobody there takes its time, and prints what its parts say.
            at = urlsplit(self.address)
            socket.create_connection((at.hostname, at.port), SECONDS_TO_CONNECT).close()
            client = Client(self.address, timeout=SECONDS_TO_CONNECT, set_as_default=False)  # type: ignore[no-untyped-call]
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
            no_scheduler = Fact(Reading.NO_SCHEDULER, address=self.address, because=reason)
            raise Unreadable(no_scheduler) from None
        with client:
            threads = self._threads(client, first.path)
            jobs = chain([first], jobs)
            sent: dict[Any, Job] = {}
            done: Any = as_completed(loop=client.loop)  # type: ignore[no-untyped-call]

            def send(count: int) -> None:
                for job in islice(jobs, count):
                    # tried again where a machine has no process to spare
                    future = client.submit(
                        read_on_worker, job, self.limits, self.read, pure=False, retries=ATTEMPTS
                    )
                    sent[future] = job
                    done.add(future)

            send(8 * threads)  # before they are needed
            for future in done:
                job = sent.pop(future)
                if future.cancelled():
                    raise Unreadable(Fact(Reading.SCHEDULER_GONE, address=self.address))
                trouble = future.exception()
                if isinstance(trouble, KilledWorker):
                    yield failed(job, "died", Fact(Reading.CLUSTER_WORKERS_DIED))
                elif trouble is not None:
                    cause = Fact(
                        Reading.CLUSTER_CANNOT_READ, address=self.address, because=str(trouble)
                    )
                    raise Unreadable(cause)
                else:
                    yield future.result()
                send(1)
            # Not where the run breaks off: who asks a cluster that has gone waits for it.
            client.run(stop_readers, on_error="ignore")

    def _threads(self, client: Any, path: str) -> int:
        """How many threads the workers have; raises ``Unreadable`` if there are none, or one cannot read the log."""
        address = self.address
        if not (threads := dict(client.nthreads())):
            raise Unreadable(Fact(Reading.NO_CLUSTER_WORKERS, address=address))
        here, readable_here = machine(path)
        try:
            workers = client.run(machine, path)
        except Exception as error:  # raised there: without mavdem the function cannot be found
            cause = f"{type(error).__name__}: {error}"
            version = metadata.version("mavdem")
            lacking = Fact(
                Reading.CLUSTER_WITHOUT_MAVDEM, address=address, because=cause, version=version
            )
            raise Unreadable(lacking) from None
        for worker, (there, readable) in sorted(workers.items()):
            if there != here:
                raise Unreadable(
                    Fact(Reading.CLUSTER_OF_OTHER_VERSION, name=worker, there=there, here=here)
                )
            if readable_here and not readable:
                raise Unreadable(Fact(Reading.CLUSTER_WITHOUT_LOG, name=worker, path=path))
        return sum(threads.values())


def read_on_worker(job: Job, limits: Limits, read: str) -> Outcome:
    """In a worker of the cluster: reads a log in a process that outlives it."""
    # Dask's workers are daemons, which may have no children; these end with their worker.
    current_process().daemon = False
    try:
        reader = _idle.pop()
    except IndexError:
        reader = LogReader()
    reader.send(job, limits, read)
    outcome = None
    while outcome is None:
        outcome = reader.outcome(bool(wait([reader.connection], reader.seconds_left)))
    _idle.append(reader)
    return outcome


def stop_readers() -> None:
    """In a worker of the cluster: ends the processes; another run's are started again."""
    while _idle:
        _idle.pop().stop()


def machine(path: str) -> tuple[str, bool]:
    """Returns the versions here of mavdem, of the columns and of Python, and whether the log at ``path`` is here."""
    python = ".".join(platform.python_version_tuple()[:2])
    mavdem = f"mavdem {metadata.version('mavdem')} (columns {SCHEMA_VERSION}) on Python {python}"
    return mavdem, is_url(path) or os.path.lexists(path)
