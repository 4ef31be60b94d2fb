"""Workers: processes that read logs, each log within limits of time and memory, so that no log stops a run.

A log that hangs, crashes its reader or wants too much memory ends the process that reads it, and nothing else: the pool
replaces the process. What is asked of a process is a ``Job``, what comes back an ``Outcome``. Each worker of a Dask
cluster has the same pool as one machine.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import resource
import shutil
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, ThreadPoolExecutor, wait
from concurrent.futures import TimeoutError as OutOfTime
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import metadata
from itertools import chain, islice
from math import ceil
from multiprocessing import current_process, get_context, parent_process
from pathlib import Path
from pkgutil import resolve_name
from threading import Lock, Thread
from typing import Any, Literal, NamedTuple, Protocol
from urllib.parse import urlsplit

from mavdem.dem.parallel import stay_in_this_process
from mavdem.errors import Unreadable, require
from mavdem.fleet.row import SCHEMA_VERSION, FlightRow
from mavdem.fleet.sources import fetch, is_url

MEGABYTE = 1 << 20
PAGES = "pages"  # the folder of pages of flights, in the fleet's
READ_LOG = "mavdem.fleet.rows_of_log:rows_of_log"  # the function that makes rows of a log
ATTEMPTS = 2  # at a log whose reading killed the process: something else may have killed it once
# Times the limit of processor time that a log may take by the clock: on a busy machine it waits
WAITING = 10
# exit code of a process that reached its limit: what is left of its memory is in pieces
WANT_OF_MEMORY = 77

Ended = Literal["read", "known", "source", "error", "time", "memory", "died"]
"""How the reading of a log ended: it was read, or had been before; it could not be reached; mavdem failed; it took too
long or too much memory; or the process that read it died."""
LogRows = tuple[list[FlightRow], dict[str, str]]
"""What a log says: its rows, and the HTML of pages by the name of the file."""


class Limits(NamedTuple):
    """What one log may cost: ``seconds`` of the processor, and ``megabytes`` of memory of the process that reads it."""

    seconds: float = 300.0
    megabytes: int = 600


class Job(NamedTuple):
    """One log to read."""

    path: str  # absolute path, or URL
    # keys of logs of the same size that were read before: if it has one of them it is not read again
    known: tuple[str, ...] = ()
    # the function that makes a flight's page, as ``package.module:function``; empty for none
    page: str = ""


@dataclass(frozen=True)
class Outcome:
    """What became of a job."""

    path: str  # of the log
    ended: Ended  # how
    rows: tuple[FlightRow, ...] = ()  # of the log; at least one, unless it was known
    key: str = ""  # hash and size of the log's content; empty if it was not reached
    pages: dict[str, str] = field(default_factory=dict)  # HTML by the name of the file
    seconds: float = 0.0  # it took
    # the most memory that the process has had, with this log and those before
    megabytes: float = 0.0


def failed(job: Job, ended: Ended, status: str, key: str = "") -> Outcome:
    """Returns the outcome of a log of which only ``status`` can be said."""
    return Outcome(job.path, ended, (FlightRow(file=job.path, key=key, status=status),), key)


class Reader(Protocol):
    """What reads many logs: the processes of this machine, or a cluster."""

    limits: Limits  # of each log

    def outcomes(self, jobs: Iterator[Job]) -> Iterator[Outcome]:
        """Yields outcomes in the order in which they come; a job is taken when its turn has come."""


class WorkerPool:
    """Reads logs with so many ``processes`` at a time, each log within ``limits``, by the function ``read``."""

    def __init__(self, processes: int, limits: Limits, read: str = READ_LOG) -> None:
        self.limits = limits
        self._processes = processes
        self._read = read

    def start(self) -> None:
        """Makes ready; the processes are started when the first log is read, and :meth:`stop` ends them."""
        from pebble import ProcessPool

        # Read when NumPy is imported. Others like the process have the other cores.
        for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ.setdefault(name, "1")
        os.environ.setdefault("MPLBACKEND", "agg")
        # What a process fetches goes also where it was killed.
        self._scratch = tempfile.TemporaryDirectory(prefix="mavdem-", ignore_cleanup_errors=True)
        given = self.limits.megabytes, self._scratch.name
        self._pool = ProcessPool(
            self._processes, initializer=_begin, initargs=given, context=get_context("spawn")
        )

    def outcomes(self, jobs: Iterator[Job]) -> Iterator[Outcome]:
        """As :class:`Reader` has it; raises ``Unreadable`` if no process can be started."""
        # One more than processes, so that none waits for what comes next. Ctrl-C reaches this process only, which
        # decides what it means: the threads, and the processes that they start, have it blocked.
        block = partial(signal.pthread_sigmask, signal.SIG_BLOCK, {signal.SIGINT})
        self.start()
        with ThreadPoolExecutor(self._processes + 1, initializer=block) as threads:
            try:
                running = {
                    threads.submit(self.run, job) for job in islice(jobs, self._processes + 1)
                }
                while running:
                    done, running = wait(running, return_when=FIRST_COMPLETED)
                    for future in done:
                        yield future.result()
                    running |= {threads.submit(self.run, job) for job in islice(jobs, len(done))}
            finally:
                self.stop()

    def run(self, job: Job) -> Outcome:
        """Reads one log, and returns when that is done; raises ``Unreadable`` if no process can be started."""
        from pebble import ProcessExpired

        seconds = self.limits.seconds
        code = 0
        late = replace(
            failed(job, "time", f"It takes longer than its time limit of {seconds:g} s."),
            seconds=seconds,
        )
        for _ in range(ATTEMPTS):
            try:
                task = self._pool.schedule(
                    perform, (job, self._read, seconds), timeout=WAITING * seconds
                )
                outcome: Outcome = task.result()
                return outcome
            except OutOfTime:
                return late
            except ProcessExpired as error:
                if error.exitcode == -signal.SIGXCPU:
                    return late
                if (code := error.exitcode or 0) == WANT_OF_MEMORY:
                    status = f"It needs more memory than its limit of {self.limits.megabytes} MB."
                    return replace(failed(job, "memory", status), megabytes=self.limits.megabytes)
            except (BrokenProcessPool, CancelledError, OSError, RuntimeError) as error:
                kept = "what was read is kept. See why with MAVDEM_TRACEBACK=1."
                raise Unreadable(
                    f"No process that reads logs can be started ({error}): {kept}"
                ) from None
        cause = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return failed(
            job, "died", f"The process that read it died ({cause}), each of {ATTEMPTS} times."
        )

    def stop(self) -> None:
        """Ends the processes, also while another thread waits for an outcome, and removes what they leave."""
        self._pool.stop()  # type: ignore[no-untyped-call]
        self._pool.join()
        self._scratch.cleanup()


def _begin(megabytes: int, scratch: str) -> None:
    """In a process: sets its limits, and what it leaves to whom."""
    # what a terminal sends to its programs is not for it, and the system shares its time out by session
    os.setsid()
    if not os.environ.get("MAVDEM_TRACEBACK"):
        nothing = os.open(os.devnull, os.O_WRONLY)
        for output in (1, 2):
            os.dup2(nothing, output)
    tempfile.tempdir = scratch
    stay_in_this_process()  # others like it have the other cores
    # Linux counts what is allocated; elsewhere the limit may do nothing. Not the address space: mapped files and
    # reserved stacks of threads take no memory.
    with suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_DATA, (megabytes * MEGABYTE, megabytes * MEGABYTE))
    Thread(target=_end_with_parent, args=(scratch,), daemon=True).start()


def _end_with_parent(scratch: str) -> None:
    """Ends this process where the one that asks was killed: nobody waits for an answer."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    shutil.rmtree(scratch, ignore_errors=True)
    os._exit(1)


def perform(job: Job, read: str, seconds: float) -> Outcome:
    """Reads one log in ``seconds`` of the processor; ends the process where memory is wanting, which is in pieces."""
    began = time.perf_counter()
    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    soft = ceil(time.process_time() + seconds)
    resource.setrlimit(
        resource.RLIMIT_CPU, (soft if hard == resource.RLIM_INFINITY else min(soft, hard), hard)
    )
    try:
        outcome = outcome_of(job, resolve_name(read))
    except MemoryError:
        os._exit(WANT_OF_MEMORY)
    kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (
        1024 if sys.platform == "darwin" else 1
    )
    return replace(outcome, seconds=time.perf_counter() - began, megabytes=kilobytes / 1024)


def outcome_of(
    job: Job, read: Callable[[Path, str, Callable[..., str] | None], LogRows]
) -> Outcome:
    """Returns what becomes of a job here, by ``read`` of path, key and page maker or None; raises ``MemoryError``."""
    key = ""
    try:
        with _as_file(job.path) as path:
            with path.open("rb") as file:
                key = f"{hashlib.file_digest(file, 'sha256').hexdigest()[:32]}-{file.tell()}"
            if key in job.known:
                return Outcome(job.path, "known", key=key)
            rows, pages = read(path, key, resolve_name(job.page) if job.page else None)
            return Outcome(
                job.path, "read", tuple(_named(row, job, path, key) for row in rows), key, pages
            )
    except Unreadable as error:
        if isinstance(error.__context__, MemoryError):
            raise MemoryError from None  # with a higher limit it may be read
        return failed(job, "read" if key else "source", _nameless(str(error), job.path), key)
    except OSError as error:
        return failed(job, "source", f"It cannot be read ({error.strerror or error}).", key)
    except MemoryError:
        raise
    except Exception as error:
        return failed(
            job, "error", f"This should not have happened ({type(error).__name__}: {error}).", key
        )


@contextmanager
def _as_file(path: str) -> Iterator[Path]:
    """Gives the log as a plain file of this machine; raises ``Unreadable`` or ``OSError``."""
    if not is_url(path):
        if Path(path).exists() and not Path(path).is_file():
            raise Unreadable(f"{path} is not a plain file.")  # opening one may wait for ever
        yield Path(path)
        return
    with tempfile.TemporaryDirectory(prefix="mavdem-") as folder:
        copy = Path(folder) / (urlsplit(path).path.rpartition("/")[2][-100:] or "log")
        fetch(path, copy)
        yield copy


def _named(row: FlightRow, job: Job, path: Path, key: str) -> FlightRow:
    """The row with the name of the log, which is only there: copies of a log have equal rows."""
    status, *warnings = (_nameless(sentence, str(path)) for sentence in (row.status, *row.warnings))
    version = metadata.version("mavdem")
    return replace(
        row, file=job.path, key=key, status=status, warnings=tuple(warnings), mavdem_version=version
    )


def _nameless(sentence: str, path: str) -> str:
    """A sentence about a log without its name, which has its own column."""
    return sentence.replace(path, "It", sentence.startswith(path)).replace(path, "the log")


RETRIES = 2  # of a log whose reading fails on a worker, as where a machine has no process to spare
SECONDS_TO_CONNECT = 10.0

# in a worker of the cluster: the processes of the last run
_pools: dict[tuple[Limits, str], WorkerPool] = {}
_lock = Lock()


class Cluster:
    """Reads logs on the Dask cluster at ``address``, as ``WorkerPool`` does; others take what a dead worker had."""

    def __init__(self, address: str, limits: Limits, read: str = READ_LOG) -> None:
        require("Reading logs on a cluster", "dask")
        if not re.fullmatch(r"\w+://\S+:\d{1,5}", address):
            raise Unreadable(f"{address!r} is no address like tcp://10.0.0.1:8786.")
        self.address = address
        self.limits = limits
        self.read = read

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
            raise Unreadable(
                f"There is no Dask scheduler at {self.address} ({reason}): check the address."
            ) from None
        with client:
            threads = _threads(client, self.address, first.path)
            sent: dict[Any, Job] = {}
            done: Any = as_completed(loop=client.loop)  # type: ignore[no-untyped-call]

            def send(count: int) -> None:
                for job in islice(jobs, count):
                    future = client.submit(
                        read_on_worker, job, self.limits, self.read, pure=False, retries=RETRIES
                    )
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
    return (
        f"mavdem {metadata.version('mavdem')} (columns {SCHEMA_VERSION}) on Python {python}",
        has_log,
    )


def _threads(client: Any, address: str, path: str) -> int:
    """How many threads the workers have; raises ``Unreadable`` where there are none, or one cannot read the log."""
    if not (threads := dict(client.nthreads())):
        raise Unreadable(
            f"The cluster at {address} has no workers: start some with `dask worker {address}`."
        )
    here, readable_here = machine(path)
    try:
        workers = client.run(machine, path)
    except (
        Exception
    ) as error:  # raised there: where there is no mavdem, the function cannot be found
        lacking = f"have no mavdem that reads logs of a fleet ({type(error).__name__}: {error})"
        install = f"install 'mavdem[dask]' {metadata.version('mavdem')} there."
        raise Unreadable(f"The workers of {address} {lacking}: {install}") from None
    for worker, (there, readable) in sorted(workers.items()):
        if there != here:
            raise Unreadable(
                f"The worker {worker} has {there}, this machine {here}: install the same there."
            )
        if readable_here and not readable:
            shared = "put the logs into a folder that all machines share, or name them by URLs"
            raise Unreadable(f"The worker {worker} cannot read {path}: {shared}.")
    return sum(threads.values())
