"""Cluster: the logs of a run, read by the workers of a Dask cluster."""

from __future__ import annotations

import os
import platform
import socket
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from importlib import metadata
from queue import Empty, SimpleQueue
from typing import Any
from urllib.parse import urlsplit

from mavdem.errors import Unreadable, require
from mavdem.fleet.reading.limited_worker import LimitedWorker
from mavdem.fleet.reading.outcome import READ_LOG, Job, Limits, ReadOutcome, failed
from mavdem.fleet.reading.sources import Source, is_url
from mavdem.fleet.row import SCHEMA_VERSION

BATCH_LOGS, BATCH_BYTES = 8, 8 << 20
"""A batch is full with so many logs, or with these bytes: large enough that sending it costs nothing, and small enough
that little is read twice where a worker dies."""

BATCHES_AHEAD = 3  # of each worker's thread, sent before they are needed
RETRIES = 2  # of a batch that fails, as where a machine has no process to spare
SECONDS_TO_CONNECT = 10.0

_idle: SimpleQueue[tuple[Limits, str, LimitedWorker]] = SimpleQueue()
"""In a worker of the cluster: processes that wait for the next batch."""


class Cluster:
    """Reads logs on a Dask cluster, each within ``limits``, by the function ``read``.

    Batches go to workers that can see the files; what a worker had when it died goes to others.

    Args:
        address: of the scheduler, ``tcp://HOST:PORT``.
        limits: of each log.
        read: the function that makes rows of a log, as ``package.module:function``.
    """

    def __init__(self, address: str, limits: Limits, read: str = READ_LOG) -> None:
        require("Reading logs on a cluster", "dask")
        self.address = address
        self.limits = limits
        self.read = read

    def outcomes(
        self, sources: Sequence[Source], job_of: Callable[[Source], Job]
    ) -> Iterator[tuple[Source, ReadOutcome]]:
        """As :class:`Reader` has it.

        Raises ``Unreadable``: there is no such cluster, it has no worker, its workers have another version of mavdem or
        Python, or none of them can see the files.
        """
        if not sources:
            return
        from distributed import Client

        try:
            # Asked first: a client that finds nobody there takes its time, and prints what its parts say.
            at = urlsplit(self.address)
            socket.create_connection((at.hostname, at.port), SECONDS_TO_CONNECT).close()
            client = Client(self.address, timeout=SECONDS_TO_CONNECT, set_as_default=False)  # type: ignore[no-untyped-call]
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
            raise Unreadable(f"There is no Dask scheduler at {self.address} ({reason}): check the address.") from None
        with client:
            yield from self._of_batches(client, sources, job_of)
            # Not where the run breaks off: who asks a cluster that has gone waits for it.
            client.run(stop_idle, on_error="ignore")

    def _of_batches(
        self, client: Any, sources: Sequence[Source], job_of: Callable[[Source], Job]
    ) -> Iterator[tuple[Source, ReadOutcome]]:
        from distributed import KilledWorker, as_completed

        example = next((source.path for source in sources if readable_here(source.path)), "")
        threads, hosts = _usable(client, self.address, example)
        options = {"pure": False, "retries": RETRIES, **({"workers": hosts} if hosts else {})}

        waiting = deque(batches(sources))
        sent: dict[Any, list[Source]] = {}
        ahead = BATCHES_AHEAD * threads
        done: Any = as_completed(loop=client.loop)  # type: ignore[no-untyped-call]

        def send() -> None:
            while waiting and len(sent) < ahead:
                batch = waiting.popleft()
                jobs = [job_of(source) for source in batch]
                future = client.submit(read_batch, jobs, self.limits, self.read, **options)
                sent[future] = batch
                done.add(future)

        send()
        for future in done:
            batch = sent.pop(future)
            if future.cancelled():
                raise Unreadable(
                    f"The scheduler at {self.address} has gone: what was read is kept; start it, and the same command "
                    "goes on."
                )
            error = future.exception()
            if error is None:
                yield from zip(batch, future.result(), strict=True)
            elif isinstance(error, KilledWorker) and len(batch) > 1:
                # One log of it may be to blame, and the others are not.
                waiting.extendleft([source] for source in reversed(batch))
            elif isinstance(error, KilledWorker):
                yield batch[0], failed(job_of(batch[0]), "died", "The workers of the cluster that read it died.")
            else:
                raise Unreadable(f"The workers of {self.address} cannot read logs ({error}).")
            send()


def batches(sources: Sequence[Source]) -> Iterator[list[Source]]:
    """Logs that are sent together, in order."""
    batch: list[Source] = []
    size = 0
    for source in sources:
        if batch and (len(batch) == BATCH_LOGS or size + source.size > BATCH_BYTES):
            yield batch
            batch, size = [], 0
        batch.append(source)
        size += max(source.size, 0)
    if batch:
        yield batch


def read_batch(jobs: Sequence[Job], limits: Limits, read: str) -> list[ReadOutcome]:
    """In a worker of the cluster: reads logs one after the other, in a process that outlives the batch."""
    worker = _take(limits, read)
    try:
        return [worker.run(job) for job in jobs]
    finally:
        _idle.put((limits, read, worker))


def _take(limits: Limits, read: str) -> LimitedWorker:
    with suppress(Empty):
        while True:
            known_limits, known_read, worker = _idle.get_nowait()
            if (known_limits, known_read) == (limits, read):
                return worker
            worker.close()
    return LimitedWorker(limits, read)


def stop_idle() -> None:
    """In a worker of the cluster: ends the processes that wait for a batch; another run's are started again."""
    with suppress(Empty):
        while True:
            _idle.get_nowait()[-1].close()


def versions() -> tuple[str, int, str]:
    """Of mavdem, of the columns, and of Python, here."""
    return metadata.version("mavdem"), SCHEMA_VERSION, ".".join(platform.python_version_tuple()[:2])


def readable_here(path: str) -> bool:
    """Whether this machine has the file."""
    return is_url(path) or os.path.lexists(path)


def _usable(client: Any, address: str, path: str) -> tuple[int, list[str]]:
    """How many threads can read the log ``path``, and the hosts that have them; no hosts where all can.

    Raises ``Unreadable``: no worker can.
    """
    threads: dict[str, int] = dict(client.nthreads())
    if not threads:
        raise Unreadable(f"The cluster at {address} has no workers: start some with `dask worker {address}`.")
    own = versions()
    try:
        found = client.run(versions)
    except Exception as error:  # raised there: where there is no mavdem, the function cannot be found
        raise Unreadable(
            f"The workers of {address} have no mavdem that reads logs of a fleet ({type(error).__name__}: {error}): "
            f"install 'mavdem[dask,fleet]' {own[0]} there."
        ) from None
    for worker, theirs in sorted(found.items()):
        if theirs != own:
            raise Unreadable(
                f"The worker {worker} has mavdem {theirs[0]} (columns {theirs[1]}) on Python {theirs[2]}, this machine "
                f"mavdem {own[0]} (columns {own[1]}) on Python {own[2]}: install the same there."
            )
    seeing = [worker for worker, sees in client.run(readable_here, path).items() if sees or not path]
    if not seeing:
        raise Unreadable(
            f"No worker of {address} can read {path}: put the logs into a folder that all machines share, or name them "
            "by URLs."
        )
    # Hosts, not workers: one that is started again has another address.
    hosts = sorted({urlsplit(worker).hostname or worker for worker in seeing}) if len(seeing) < len(threads) else []
    return sum(threads[worker] for worker in seeing), hosts
