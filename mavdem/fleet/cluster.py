"""A Dask cluster whose workers read logs, each in a process of its own as on one machine."""

import platform
import re
import socket
from collections.abc import Generator, Iterator
from contextlib import ExitStack
from functools import partial
from importlib import metadata
from multiprocessing import current_process
from threading import Lock
from typing import Any
from urllib.parse import urlsplit

from mavdem.errors import Unreadable
from mavdem.extras import require_extra
from mavdem.facts import Fact
from mavdem.facts.fleet import Reading
from mavdem.fleet.row import SCHEMA_VERSION
from mavdem.fleet.workers import (
    ATTEMPTS,
    Job,
    JobLimits,
    JobOutcome,
    LogReader,
    ReadLog,
    failed,
    side_by_side,
)

SECONDS_TO_CONNECT = 10.0  # s, in which the scheduler must answer

# in a worker of the cluster: processes that wait for a log
_idle = list[LogReader]()


class Cluster:
    """Reads logs on the Dask cluster at ``address``, as ``WorkerPool`` does; others take what a dead worker had."""

    def __init__(self, address: str, limits: JobLimits, read: ReadLog) -> None:
        require_extra("dask")
        if not re.fullmatch(r"\w+://\S+:\d{1,5}", address):
            raise Unreadable(Reading.NO_ADDRESS, address=address)
        self.address = address
        self.limits = limits
        self._read = read
        self._client: Any = None
        self._lock = Lock()

    def outcomes(self, jobs: Iterator[Job]) -> Generator[JobOutcome]:
        """Yields outcomes as ``WorkerPool`` does; raises ``Unreadable``, as :meth:`read` does."""
        threads = sum(self._connected().nthreads().values())
        read = partial(self.read, limits=self.limits, read=self._read)
        # One is on its way while another is read.
        yield from side_by_side([read] * 2 * threads, jobs, self.stop)

    def read(self, job: Job, limits: JobLimits, read: ReadLog) -> JobOutcome:
        """Returns what becomes of a log that the function ``read`` reads.

        Raises ``Unreadable``: there is no such cluster, it has no worker, or one of its workers has another version of
        mavdem or Python.
        """
        from distributed import KilledWorker

        client = self._connected()
        try:
            # tried again where a machine has no process to spare
            future = client.submit(read_on_worker, job, limits, read, pure=False, retries=ATTEMPTS)
            return future.result()
        except KilledWorker:
            return failed(job, "died", Fact(Reading.CLUSTER_WORKERS_DIED))
        except Exception as error:
            self.stop()
            raise self._refusal(Reading.CLUSTER_CANNOT_READ, because=str(error)) from None

    def stop(self) -> None:
        """Gives up what is being read, and ends the processes that wait; the next log connects anew."""
        with self._lock:
            client, self._client = self._client, None
        if client is not None and client.status == "running":
            client.run(stop_readers, on_error="ignore")
        if client is not None:
            client.close()

    def _refusal(self, code: Reading, **figures: Any) -> Unreadable:
        return Unreadable(code, address=self.address, **figures)

    def _connected(self) -> Any:
        from distributed import Client

        with self._lock:
            if self._client is not None:
                return self._client
            try:
                # Asked first: a client that finds nobody there takes its time, and prints what its parts say.
                at = urlsplit(self.address)
                socket.create_connection((at.hostname, at.port), SECONDS_TO_CONNECT).close()
                client = Client(self.address, timeout=SECONDS_TO_CONNECT, set_as_default=False)  # type: ignore[no-untyped-call]
            except (OSError, ValueError) as error:
                because = str(error).splitlines()[0]
                raise self._refusal(Reading.NO_SCHEDULER, because=because) from None
            with ExitStack() as ends:
                ends.callback(client.close)
                self._check(client)
                ends.pop_all()
            self._client = client
            return client

    def _check(self, client: Any) -> None:
        """Raises ``Unreadable`` if there are no workers, or one has other programs."""
        try:
            workers = client.run(versions)
        except Exception as error:  # raised there: without mavdem the function cannot be found
            raise self._refusal(Reading.CLUSTER_CANNOT_READ, because=str(error)) from None
        if not workers:
            raise self._refusal(Reading.NO_CLUSTER_WORKERS)
        here = versions()
        for name, there in workers.items():
            if there != here:
                code = Reading.CLUSTER_OF_OTHER_VERSION
                raise self._refusal(code, name=name, there=there, here=here)


def read_on_worker(job: Job, limits: JobLimits, read: ReadLog) -> JobOutcome:
    """Reads a log, in a worker of the cluster, in a process that outlives it."""
    # Dask's workers are daemons, which may have no children; these end with their worker.
    current_process().daemon = False
    try:
        reader = _idle.pop()
    except IndexError:
        reader = LogReader()
    outcome = reader.read(job, limits, read)
    assert outcome is not None
    _idle.append(reader)
    return outcome


def stop_readers() -> None:
    """Ends the processes in a worker of the cluster; another run's are started again."""
    while _idle:
        _idle.pop().stop()


def versions() -> str:
    """Returns the versions here of mavdem, of the columns and of Python."""
    python = ".".join(platform.python_version_tuple()[:2])
    return f"mavdem {metadata.version('mavdem')} (columns {SCHEMA_VERSION}) on Python {python}"
