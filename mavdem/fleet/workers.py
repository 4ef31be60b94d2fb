"""Workers: processes that read logs, each log within limits of time and memory, so that no log stops a run.

A log that hangs, crashes its reader or wants too much memory ends the process that reads it, and nothing else: another
takes its place. What is asked of a process is a ``Job``, what comes back a ``JobOutcome``. The processes are
supervised by the thread that waits for outcomes, and killed when it waits no longer, whatever ends it.
"""

import errno
import hashlib
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, chdir, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import metadata
from itertools import islice
from math import ceil, inf
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Event
from typing import Any, Literal, NamedTuple
from urllib.parse import urlsplit

from mavdem.assessment import Assessment
from mavdem.containers import JsonValues, Names
from mavdem.dem.parallel import (
    TERMINATION_SIGNALS,
    ProcessPool,
    blocked_signals,
    forbid_child_processes,
    process_pool,
)
from mavdem.errors import Unreadable
from mavdem.facts import Fact
from mavdem.facts.fleet import Reading
from mavdem.fleet.row import FlightRow
from mavdem.fleet.sources import fetch, is_url

PAGES = "pages"  # the folder of pages of flights, in the fleet's
ATTEMPTS = 2  # at a log whose reading killed the process: something else may have killed it once
# Times the limit of processor time that a log may take by the clock: on a busy machine it waits
WAITING = 10
LOOK_SECONDS = 0.5  # between looks how far a reading is, and whether it is to be given up

Ended = Literal["read", "known", "source", "error", "time", "memory", "died"]
"""How the reading of a log ended: it was read, or had been before; it could not be reached; mavdem failed; it took too
long or too much memory; or the process that read it died."""
LogRows = tuple[list[FlightRow], dict[str, str]]
"""What a log says: its rows, and the HTML of pages by the name of the file."""
MakePage = Callable[[str, Assessment], str]
ReadLog = Callable[[Path, str, MakePage | None], LogRows]
"""Makes rows of a log of path and key, and pages by what makes one; a function of a module."""


class JobLimits(NamedTuple):
    """What one log may cost: ``seconds`` of the processor, and ``megabytes`` of memory of the process that reads it.

    That is renewed after so many ``logs``.
    """

    seconds: float = 300.0
    megabytes: int = 600
    logs: int = sys.maxsize


class Job(NamedTuple):
    """One log to read."""

    path: str  # absolute path, or URL
    # keys of logs of the same size that were read before: if it has one of them it is not read again
    known: Names = ()
    page: MakePage | None = None  # a function of a module


@dataclass(frozen=True)
class JobOutcome:
    """What became of a job."""

    path: str  # of the log
    ended: Ended  # how
    rows: tuple[FlightRow, ...] = ()  # of the log; at least one, unless it was known
    key: str = ""  # hash and size of the log's content; empty if it was not reached
    pages: dict[str, str] = field(default_factory=dict)  # HTML by the name of the file
    seconds: float = 0.0  # it took
    # the most memory that the process has had, with this log and those before
    megabytes: float = 0.0


def failed(job: Job, ended: Ended, status: Fact, key: str = "") -> JobOutcome:
    """Returns the outcome of a log of which only ``status`` can be said."""
    row = FlightRow.without_flight(status=status, **_of_job(job, key))
    return JobOutcome(job.path, ended, (row,), key)


def _of_job(job: Job, key: str) -> JsonValues:
    """Columns that a row has of what was asked for."""
    return {"file": job.path, "key": key, "mavdem_version": metadata.version("mavdem")}


class LogReader:
    """A process that reads one log at a time; in place of one that died another is started.

    A reading is given up where, asked twice a second, ``is_ending`` says so.
    """

    def __init__(self, is_ending: Callable[[], bool] = lambda: False) -> None:
        self._is_ending = is_ending
        self._exits = ExitStack()
        self._process: BaseProcess | None = None
        self._executor: ProcessPool
        self._logs = 0  # that the process was given

    def read(self, job: Job, limits: JobLimits, read: ReadLog) -> JobOutcome | None:
        """Returns what became of a log that the function ``read`` reads; None where that was given up.

        Raises ``Unreadable``: no process can be started.
        """
        code = 0
        if self._logs >= limits.logs:
            self.stop()
        for _ in range(ATTEMPTS):
            process = self._process or self._started()
            self._logs += 1
            deadline = time.monotonic() + WAITING * limits.seconds
            outcome = None
            try:
                future = self._executor.submit(perform, job, limits, read)
                outcome = self._result(future, deadline)
                code = -signal.SIGXCPU
            except BrokenExecutor:
                process.join()
                code = process.exitcode or 0
                # A signal that ended it may be the run's, too, which looks as often.
                time.sleep(2 * LOOK_SECONDS)
            if outcome is not None or self._is_ending():
                return outcome
            is_first = self._logs == 1
            self.stop()
            if code == -signal.SIGXCPU:
                late = Fact(Reading.READING_TOO_LONG, time_limit=limits.seconds)
                return replace(failed(job, "time", late), seconds=limits.seconds)
            if code == errno.ENOMEM and is_first:  # no log before has left anything
                big = Fact(Reading.READING_TOO_LARGE, memory_limit=limits.megabytes)
                return replace(failed(job, "memory", big), megabytes=limits.megabytes)
        because = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return failed(job, "died", Fact(Reading.READER_DIED, because=because, attempts=ATTEMPTS))

    def _started(self) -> BaseProcess:
        # Read when NumPy is imported. Others like the process have the other cores.
        for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ.setdefault(name, "1")
        os.environ.setdefault("MPLBACKEND", "agg")
        try:
            self._executor = self._exits.enter_context(process_pool(1))
            (self._process,) = self._executor.processes
            self._result(self._executor.submit(os.getpid))
        except (OSError, BrokenExecutor) as error:
            self.stop()
            raise Unreadable(Reading.READERS_NOT_STARTED, because=error) from None
        return self._process

    def _result(self, future: Future[Any], deadline: float = inf) -> Any:
        """What a job gives until the ``deadline``; None after it, or where the reading is given up."""
        while time.monotonic() < deadline and not self._is_ending():
            if wait([future], LOOK_SECONDS).done:
                return future.result()
        return None

    def stop(self) -> None:
        """Ends the process, whatever it does, and removes what it leaves."""
        process, self._process = self._process, None
        self._logs = 0
        if process is not None:
            process.kill()
        self._exits.close()
        if process is not None:
            # What it fetched goes also where it was killed.
            for left in Path(tempfile.gettempdir()).glob(f"mavdem-{process.pid}-*"):
                shutil.rmtree(left, ignore_errors=True)


class WorkerPool:
    """Reads logs with so many ``processes`` at a time, each log within ``limits``, by the function ``read``."""

    def __init__(self, processes: int, limits: JobLimits, read: ReadLog) -> None:
        self.limits = limits
        self._processes = processes
        self._read = read

    def outcomes(self, jobs: Iterator[Job]) -> Generator[JobOutcome]:
        """Yields outcomes in the order in which they come; a job is taken when its turn has come.

        Raises ``Unreadable`` if no process can be started.
        """
        is_ending = Event()
        readers = [LogReader(is_ending.is_set) for _ in range(self._processes)]
        reads = [partial(reader.read, limits=self.limits, read=self._read) for reader in readers]
        try:
            yield from side_by_side(reads, jobs, is_ending.set)
        finally:
            with blocked_signals(*TERMINATION_SIGNALS):
                for reader in readers:
                    reader.stop()


def side_by_side(
    reads: Iterable[Callable[[Job], JobOutcome | None]],
    jobs: Iterator[Job],
    end: Callable[[], None],
) -> Generator[JobOutcome]:
    """Yields outcomes in the order in which they come; each of ``reads`` reads one log at a time, in a thread.

    When no more are wanted, ``end`` is called, upon which they return soon.
    """
    executor = ThreadPoolExecutor(2**10)  # as many threads as there are readers
    try:
        busy = {executor.submit(read, job): read for read, job in zip(reads, jobs, strict=False)}
        while busy:
            # Not for ever: another thread may have received a signal, which Python handles in this one when it wakes.
            for future in islice(wait(busy, LOOK_SECONDS, FIRST_COMPLETED).done, 1):
                read = busy.pop(future)
                if (outcome := future.result()) is not None:
                    yield outcome
                for job in islice(jobs, 1):
                    busy[executor.submit(read, job)] = read
    finally:
        end()
        with blocked_signals(*TERMINATION_SIGNALS):
            executor.shutdown()


def perform(job: Job, limits: JobLimits, read: ReadLog) -> JobOutcome:
    """Reads one log within ``limits``; ends the process where memory is wanting, which is in pieces."""
    began = time.perf_counter()
    if not os.environ.get("MAVDEM_TRACEBACK"):
        nothing = os.open(os.devnull, os.O_WRONLY)
        for output in (1, 2):
            os.dup2(nothing, output)
        os.close(nothing)
    forbid_child_processes()  # others like it have the other cores
    _limit(resource.RLIMIT_CPU, ceil(time.process_time() + limits.seconds))
    # Linux counts what is allocated; elsewhere the limit may do nothing. Not the address space: mapped files and
    # reserved stacks of threads take no memory.
    with suppress(ValueError, OSError):
        _limit(resource.RLIMIT_DATA, limits.megabytes << 20)
    try:
        outcome = outcome_of(job, read)
    except MemoryError:
        os._exit(errno.ENOMEM)  # what is left of its memory is in pieces
    kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (
        1024 if sys.platform == "darwin" else 1
    )
    return replace(outcome, seconds=time.perf_counter() - began, megabytes=kilobytes / 1024)


def _limit(resource_number: int, soft: int) -> None:
    hard = resource.getrlimit(resource_number)[1]
    resource.setrlimit(
        resource_number, (soft if hard == resource.RLIM_INFINITY else min(soft, hard), hard)
    )


def outcome_of(job: Job, read: ReadLog) -> JobOutcome:
    """Returns what becomes of a job here, by ``read`` of path, key and page maker or None; raises ``MemoryError``."""
    key = ""
    try:
        with _as_file(job.path) as path:
            with path.open("rb") as file:
                key = f"{hashlib.file_digest(file, 'sha256').hexdigest()[:32]}-{file.tell()}"
            if key in job.known:
                return JobOutcome(job.path, "known", key=key)
            rows, pages = read(path, key, job.page)
            own = tuple(replace(row, **_of_job(job, key)) for row in rows)
            return JobOutcome(job.path, "read", own, key, pages)
    except Unreadable as error:
        if isinstance(error.__context__, MemoryError):
            raise MemoryError from None  # with a higher limit it may be read
        # Copies of a log have equal rows, but for the column of their names.
        return failed(job, "read" if key else "source", error.fact.but(path="The log"), key)
    except OSError as error:
        unreachable = Fact(Reading.LOG_UNREACHABLE, because=error.strerror or error)
        return failed(job, "source", unreachable, key)
    except MemoryError:
        raise
    except Exception as error:
        return failed(job, "error", fault(error), key)


def fault(error: Exception) -> Fact:
    """Returns what is said of an error that is mavdem's own."""
    return Fact(Reading.READING_FAILED, because=f"{type(error).__name__}: {error}")


@contextmanager
def _as_file(path: str) -> Iterator[Path]:
    """Gives the log as a plain file of this machine; raises ``Unreadable`` or ``OSError``."""
    if not is_url(path):
        if Path(path).exists() and not Path(path).is_file():
            raise Unreadable(Reading.NO_PLAIN_FILE)  # opening one may wait for ever
        yield Path(path)
        return
    with tempfile.TemporaryDirectory(prefix=f"mavdem-{os.getpid()}-") as folder, chdir(folder):
        copy = Path(urlsplit(path).path.rpartition("/")[2][-100:] or "log")
        fetch(path, copy)
        yield copy
