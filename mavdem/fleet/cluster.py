"""Reading of logs on a Dask cluster: each log in a process of its own, with the same limits as on one machine."""

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
from mavdem.facts.fleet import ReadingFact
from mavdem.fleet.row import SCHEMA_VERSION
from mavdem.fleet.workers import (
    ATTEMPTS,
    Job,
    JobLimits,
    JobOutcome,
    LogReader,
    ReadLog,
    failed,
    read_in_parallel,
)

CONNECTION_TIMEOUT = 10.0
"""s in which the scheduler must answer; on a local network it does so within milliseconds."""

JOBS_PER_THREAD = 2
"""Logs that are submitted at a time for each thread of the workers: one is on its way while another is read."""

ADDRESS = re.compile(r"\w+://\S+:\d{1,5}")
"""An address of a scheduler, such as ``tcp://10.0.0.1:8786``."""

_idle_readers: list[LogReader] = []
"""In a worker of the cluster: the readers whose processes wait for a log."""


class Cluster:
    """Reads logs on a Dask cluster, with the interface of ``WorkerPool``.

    What a worker that died had to do is given to others.

    Attributes:
        address: address of the scheduler.
        limits: limits of each log.
    """

    def __init__(self, address: str, limits: JobLimits, read: ReadLog) -> None:
        """Checks the address; the connection is made when the first log is read.

        Args:
            address: address of the scheduler, PROTOCOL://HOST:PORT.
            limits: limits of each log.
            read: the function that reads a log.

        Raises:
            MissingExtra: ``distributed`` is not installed.
            Unreadable: it is not an address.
        """
        require_extra("dask")
        if not ADDRESS.fullmatch(address):
            raise Unreadable(ReadingFact.NO_ADDRESS, address=address)
        self.address = address
        self.limits = limits
        self._read = read
        self._client: Any = None
        self._lock = Lock()

    def outcomes(self, jobs: Iterator[Job]) -> Generator[JobOutcome]:
        """Reads the logs of all jobs on the cluster, and yields each outcome as soon as it is there, in any order.

        Args:
            jobs: the logs; the next one is taken when a thread of the cluster is free.

        Raises:
            Unreadable: there is no such cluster, it has no worker, or a worker has another version of mavdem or Python.
        """
        # The number of threads of each worker, by the worker's address.
        threads_by_worker = self._connected_client().nthreads()
        parallel_jobs = JOBS_PER_THREAD * sum(threads_by_worker.values())
        read = partial(self.read, limits=self.limits, read=self._read)
        yield from read_in_parallel([read] * parallel_jobs, jobs, self.stop)

    def read(self, job: Job, limits: JobLimits, read: ReadLog) -> JobOutcome:
        """Has a log read on a worker of the cluster, and returns the outcome.

        Args:
            job: the log, whose path must be the same on all machines of the cluster.
            limits: time and memory for it.
            read: the function that reads it.

        Returns:
            The outcome. If the log has killed the workers that tried to read it, the outcome says so.

        Raises:
            Unreadable: there is no such cluster, it has no worker, or a worker has another version of mavdem or Python.
        """
        from distributed import KilledWorker

        client = self._connected_client()
        try:
            # A worker that cannot start another process on its machine raises an error. Another worker then tries.
            future = client.submit(read_on_worker, job, limits, read, pure=False, retries=ATTEMPTS)
            return future.result()
        except KilledWorker:
            return failed(job, "died", Fact(ReadingFact.CLUSTER_WORKERS_DIED))
        except Exception as error:
            # The cluster itself has failed, and could not read the other logs either: the connection is closed.
            self.stop()
            raise self._refusal(ReadingFact.CLUSTER_CANNOT_READ, reason=str(error)) from None

    def stop(self) -> None:
        """Cancels the logs that are being read, and ends the idle reader processes; the next log connects again.

        The client is taken out of the object first, so that another thread does not use it while it closes.
        """
        with self._lock:
            client = self._client
            self._client = None
        if client is not None and client.status == "running":
            client.run(stop_readers, on_error="ignore")
        if client is not None:
            client.close()

    def _refusal(self, code: ReadingFact, **figures: Any) -> Unreadable:
        """Returns the error of this ``code``, with the cluster's address among its figures."""
        return Unreadable(code, address=self.address, **figures)

    def _connected_client(self) -> Any:
        """Returns the client of the cluster, which connects at the first call.

        Raises:
            Unreadable: no scheduler answers, or the workers cannot be used.
        """
        from distributed import Client

        with self._lock:
            if self._client is not None:
                return self._client
            try:
                # A plain connection is tried first: without a scheduler Dask's client waits long, and prints messages
                # of its own.
                url = urlsplit(self.address)
                socket.create_connection((url.hostname, url.port), CONNECTION_TIMEOUT).close()
                client = Client(self.address, timeout=CONNECTION_TIMEOUT, set_as_default=False)
            except (OSError, ValueError) as error:
                reason = str(error).splitlines()[0]
                raise self._refusal(ReadingFact.NO_SCHEDULER, reason=reason) from None
            # If a check raises, the client is closed; pop_all keeps it open where all went well.
            with ExitStack() as on_failure:
                on_failure.callback(client.close)
                self._check_workers(client)
                on_failure.pop_all()
            self._client = client
            return client

    def _check_workers(self, client: Any) -> None:
        """Checks that there are workers, and that all have the same versions as this process.

        Args:
            client: Dask's client, which is connected to the scheduler.

        Raises:
            Unreadable: there is no worker, or one has another version of mavdem, of its columns, or of Python.
        """
        try:
            versions_by_worker = client.run(versions)
        # Without mavdem on a worker its Python cannot find the function, and raises any error.
        except Exception as error:
            raise self._refusal(ReadingFact.CLUSTER_CANNOT_READ, reason=str(error)) from None
        if not versions_by_worker:
            raise self._refusal(ReadingFact.NO_CLUSTER_WORKERS)
        own_versions = versions()
        for name, worker_versions in versions_by_worker.items():
            if worker_versions != own_versions:
                code = ReadingFact.CLUSTER_OF_OTHER_VERSION
                raise self._refusal(code, name=name, there=worker_versions, here=own_versions)


def read_on_worker(job: Job, limits: JobLimits, read: ReadLog) -> JobOutcome:
    """Reads a log in a worker of the cluster, by a process that is kept for the next log.

    The worker itself does not read: a log that crashes its reader, or needs too much memory, must not end the worker.

    Args:
        job: the log to read, by its path.
        limits: time and memory for it.
        read: the function that reads it.

    Returns:
        The outcome, also of a log that could not be read.
    """
    # Dask's workers are daemons, which may have no child processes. The readers end with their worker.
    current_process().daemon = False
    # Several threads of the worker take readers from this list, so a check that it is not empty would not hold.
    try:
        reader = _idle_readers.pop()
    except IndexError:
        reader = LogReader()
    outcome = reader.read(job, limits, read)
    # There is no outcome only if the caller asks to give up, which this one never does.
    assert outcome is not None
    _idle_readers.append(reader)
    return outcome


def stop_readers() -> None:
    """Ends the waiting processes in a worker of the cluster; another run starts new ones."""
    while _idle_readers:
        _idle_readers.pop().stop()


def versions() -> str:
    """Returns the versions of mavdem, of the fleet's columns and of Python in this process."""
    python = ".".join(platform.python_version_tuple()[:2])
    return f"mavdem {metadata.version('mavdem')} (columns {SCHEMA_VERSION}) on Python {python}"
