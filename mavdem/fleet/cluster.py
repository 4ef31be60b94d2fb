"""Cluster: the logs of a run, read by the workers of a Dask cluster, each with the same pool as on one machine."""

from __future__ import annotations

import os
import platform
import re
import socket
from collections.abc import Iterator
from importlib import metadata
from itertools import chain, islice
from multiprocessing import current_process
from threading import Lock
from typing import Any
from urllib.parse import urlsplit

from mavdem.errors import Unreadable, require
from mavdem.fleet.row import SCHEMA_VERSION
from mavdem.fleet.sources import is_url
from mavdem.fleet.workers import READ_LOG, Job, Limits, Outcome, WorkerPool, failed

RETRIES = 2  # of a log whose reading fails on a worker, as where a machine has no process to spare
SECONDS_TO_CONNECT = 10.0

_pools: dict[tuple[Limits, str], WorkerPool] = {}  # in a worker of the cluster: the processes of the last run
_lock = Lock()


class Cluster:
    """Reads logs on the Dask cluster at ``address``, as ``WorkerPool`` does; others take what a dead worker had."""

    def __init__(self, address: str, limits: Limits, read: str = READ_LOG) -> None:
        require("Reading logs on a cluster", "dask")
        if not re.fullmatch(r"\w+://\S+:\d{1,5}", address):
            raise Unreadable(f"{address!r} is no address like tcp://10.0.0.1:8786.")
        self.address, self.limits, self.read = address, limits, read

    def outcomes(self, jobs: Iterator[Job]) -> Iterator[Outcome]:
        """As ``Reader`` has it.

        Raises ``Unreadable``: there is no such cluster, it has no worker, or one of its workers has another version of
        mavdem or Python, or cannot see the first file.
        """
        from distributed import Client, KilledWorker, as_completed

        if (first := next(jobs, None)) is None:
            return
        jobs = chain([first], jobs)
        try:
            # Asked first: a client that finds nobody there takes its time, and prints what its parts say.
            at = urlsplit(self.address)
            socket.create_connection((at.hostname, at.port), SECONDS_TO_CONNECT).close()
            client = Client(self.address, timeout=SECONDS_TO_CONNECT, set_as_default=False)  # type: ignore[no-untyped-call]
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
            raise Unreadable(f"There is no Dask scheduler at {self.address} ({reason}): check the address.") from None
        with client:
            threads = _threads(client, self.address, first.path)
            sent: dict[Any, Job] = {}
            done: Any = as_completed(loop=client.loop)  # type: ignore[no-untyped-call]

            def send(count: int) -> None:
                for job in islice(jobs, count):
                    future = client.submit(read_on_worker, job, self.limits, self.read, pure=False, retries=RETRIES)
                    sent[future] = job
                    done.add(future)

            send(8 * threads)  # before they are needed
            for future in done:
                job = sent.pop(future)
                if future.cancelled():
                    kept = "what was read is kept; start it, and the same command goes on."
                    raise Unreadable(f"The scheduler at {self.address} has gone: {kept}")
                trouble = future.exception()
                if isinstance(trouble, KilledWorker):
                    yield failed(job, "died", "The workers of the cluster that read it died.")
                elif trouble is not None:
                    raise Unreadable(f"The workers of {self.address} cannot read logs ({trouble}).")
                else:
                    yield future.result()
                send(1)
            # Not where the run breaks off: who asks a cluster that has gone waits for it.
            client.run(stop_pools, on_error="ignore")


def read_on_worker(job: Job, limits: Limits, read: str) -> Outcome:
    """In a worker of the cluster: reads a log in a process that outlives it."""
    from distributed import get_worker

    with _lock:
        if (limits, read) not in _pools:
            stop_pools()
            # Dask's workers are daemons, which may have no children; these end with their worker.
            current_process().daemon = False
            threads = get_worker().state.nthreads
            _pools[limits, read] = WorkerPool(threads, limits, read)
            _pools[limits, read].start()
        pool = _pools[limits, read]
    return pool.run(job)


def stop_pools() -> None:
    """In a worker of the cluster: ends the processes; another run's are started again."""
    while _pools:
        _pools.popitem()[1].stop()


def machine(path: str) -> tuple[str, bool]:
    """Returns the versions here of mavdem, of the columns and of Python, and whether the log at ``path`` is here."""
    python = ".".join(platform.python_version_tuple()[:2])
    has_log = is_url(path) or os.path.lexists(path)
    return f"mavdem {metadata.version('mavdem')} (columns {SCHEMA_VERSION}) on Python {python}", has_log


def _threads(client: Any, address: str, path: str) -> int:
    """How many threads the workers have; raises ``Unreadable`` where there are none, or one cannot read the log."""
    if not (threads := dict(client.nthreads())):
        raise Unreadable(f"The cluster at {address} has no workers: start some with `dask worker {address}`.")
    here, readable_here = machine(path)
    try:
        workers = client.run(machine, path)
    except Exception as error:  # raised there: where there is no mavdem, the function cannot be found
        lacking = f"have no mavdem that reads logs of a fleet ({type(error).__name__}: {error})"
        install = f"install 'mavdem[dask,fleet]' {metadata.version('mavdem')} there."
        raise Unreadable(f"The workers of {address} {lacking}: {install}") from None
    for worker, (there, readable) in sorted(workers.items()):
        if there != here:
            raise Unreadable(f"The worker {worker} has {there}, this machine {here}: install the same there.")
        if readable_here and not readable:
            shared = "put the logs into a folder that all machines share, or name them by URLs"
            raise Unreadable(f"The worker {worker} cannot read {path}: {shared}.")
    return sum(threads.values())
