"""Worker processes that read logs, each log within limits of time and memory, so that no log stops a run.

A log that hangs, crashes its reader or needs too much memory ends the process that reads it, and nothing else: another
process takes its place. A process is given a ``Job`` and returns a ``JobOutcome``. The thread that waits for outcomes
supervises the processes, and kills them when it stops waiting, for whatever reason.
"""

import errno
import hashlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, chdir, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module, metadata
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any, Literal, NamedTuple
from urllib.parse import urlsplit

from mavdem.containers import JsonValues, Names
from mavdem.dem.parallel import (
    ProcessPool,
    blocked_signals,
    forbid_child_processes,
    process_pool,
)
from mavdem.errors import Unreadable
from mavdem.extras import MissingExtra
from mavdem.facts import Fact
from mavdem.facts.fleet import ReadingFact
from mavdem.files import is_disk_full
from mavdem.fleet.row import FlightRow
from mavdem.fleet.sources import copy_remote_file, is_url
from mavdem.processes import (
    TERMINATION_SIGNALS,
    limit_memory,
    peak_mebibytes,
    resource_use,
    signal_name,
)

if TYPE_CHECKING:
    # The process that supervises the readers does not need what they do.
    from mavdem.assessment import Assessment

PAGES = "pages"
"""Name of the folder with the pages of flights, in the folder of the fleet."""

ATTEMPTS = 2
"""Attempts at a log whose reading killed the process: something else may have killed it the first time."""

CLOCK_SECONDS_PER_PROCESSOR_SECOND = 10
"""Seconds by the clock that a log may take for each second of its limit of processor time: on a busy machine its
process waits."""

POLL_SECONDS = 0.5
"""s between checks whether a reading is done, is beyond its limits, and whether it is to be given up."""

EXIT_CODE_SECONDS = 5
"""s to wait for the exit code of a process that has ended; it is there within milliseconds on an idle machine."""

MAX_READER_THREADS = 2**10
"""Threads that wait for readers, at most; more than any machine or cluster has readers."""

MAX_COPY_NAME_LETTERS = 100
"""Last letters of a file's name that the copy of a fetched log has: file systems allow 255 bytes."""

KEY_HASH_DIGITS = 32
"""Hexadecimal digits of the content's SHA-256 in a key: 128 bits, by which no two logs agree by chance."""

JobEnding = Literal["read", "known", "source", "error", "time", "memory", "died"]
"""How the reading of a log ended: it was read, or its content had been read before; it could not be reached, or its
format needs a package that is not installed; mavdem failed; it took too long or too much memory; or the process that
read it died."""


class LogRows(NamedTuple):
    """What reading a log gives; both are empty where the reader has written its results to files."""

    rows: list[FlightRow]
    """The rows of the log."""

    pages: dict[str, str]
    """HTML of pages of its flights, by the name of the file."""


MakePage = Callable[[str, "Assessment"], str]
"""Makes the HTML of a flight's page from the name of its log and its assessment."""

ReadLog = Callable[[Path, str, MakePage | None], LogRows]
"""Reads a log, by its path and the key of its content, and makes its pages; a function of a module, which pickles."""


@dataclass(frozen=True)
class FunctionByName:
    """A function of a module that only the process which calls it imports, and not the one that names it."""

    module: str
    """Name of the module."""
    name: str
    """Name of the function in it."""

    def __call__(self, *args: Any) -> Any:
        """Calls the function."""
        return _function(self.module, self.name)(*args)

    def __reduce__(self) -> tuple[Callable[[str, str], Any], tuple[str, str]]:
        """Makes the function itself of it where another process receives it, which imports the module by then."""
        return _function, (self.module, self.name)


def _function(module: str, name: str) -> Any:
    """Returns a function of a module, which is imported for this.

    Args:
        module: full name of the module.
        name: name of the function in it.
    """
    return getattr(import_module(module), name)


class JobLimits(NamedTuple):
    """The time and memory that the reading of one log may take."""

    seconds: float = 300.0
    """s of processor time"""
    megabytes: int = 600
    """MiB of memory of the process that reads it"""
    logs: int = sys.maxsize
    """logs that a process reads before a new one takes its place"""


class Job(NamedTuple):
    """One log to read."""

    path: str
    """absolute path, or URL"""
    known: Names = ()
    """keys of logs of the same size that were read before: a log with one of them is not read again"""
    page: MakePage | None = None
    """makes the page of each flight; a function of a module, which pickles"""


@dataclass(frozen=True)
class JobOutcome:
    """What became of a job."""

    path: str
    """of the log"""
    ended: JobEnding
    """how the reading ended"""
    rows: tuple[FlightRow, ...] = ()
    """rows of the log; at least one, unless its content was known"""
    key: str = ""
    """hash and size of the log's content; empty if the content was not reached"""
    pages: dict[str, str] = field(default_factory=dict)
    """HTML by the name of the file"""
    seconds: float = 0.0
    """s that the reading took"""
    megabytes: float = 0.0
    """MiB, the largest memory that the process has had, with this log and those before"""
    is_disk_full: bool = False
    """whether there was no room on the disk for the results, so that the log must be read again"""


def failed(job: Job, ending: JobEnding, status: Fact, key: str = "") -> JobOutcome:
    """Returns the outcome of a job whose log could not be read: one row of the fleet's table, which says why.

    Args:
        job: the log that was to be read.
        ending: how the reading ended, such as "time" if it took too long.
        status: the reason, a coded finding.
        key: hash and size of the log's content; empty if the content was not reached.
    """
    # Such as the path of the log.
    columns_of_log = _job_columns(job, key)
    row = FlightRow.without_flight(status=status, **columns_of_log)
    return JobOutcome(job.path, ending, rows=(row,), key=key)


def _job_columns(job: Job, key: str) -> JsonValues:
    """Returns the columns that all rows of one log have in common: its path, its key and the version of mavdem.

    Args:
        job: the log that was read.
        key: hash and size of the log's content; empty if the content was not reached.
    """
    return {"file": job.path, "key": key, "mavdem_version": metadata.version("mavdem")}


class Supervision:
    """Supervision of the process that reads one log, from outside: whether it keeps the limits of time and memory.

    Attributes:
        ending: "time" or "memory" after the process was beyond that limit, otherwise "died".
    """

    def __init__(self, process_id: int, limits: JobLimits) -> None:
        """Begins with the reading of the log.

        Args:
            process_id: number of the process that reads it.
            limits: time and memory for its reading.
        """
        self.ending: JobEnding = "died"
        self._process_id = process_id
        self._limits = limits
        self._earlier_use = resource_use(process_id)
        self._deadline = time.monotonic() + CLOCK_SECONDS_PER_PROCESSOR_SECOND * limits.seconds

    def is_beyond_limits(self) -> bool:
        """Returns whether the process exceeds its limit of time or memory now, and notes which one in ``ending``.

        A process that waits or hangs takes no processor time, so that the time by the clock is limited too. Processor
        time that the process took for earlier logs does not count.
        """
        use = resource_use(self._process_id)
        processor_seconds = use.processor_seconds - self._earlier_use.processor_seconds
        if processor_seconds > self._limits.seconds or time.monotonic() > self._deadline:
            self.ending = "time"
            return True
        if use.megabytes > self._limits.megabytes:
            self.ending = "memory"
            return True
        return False


class LogReader:
    """A process that reads one log at a time. If it dies, another process is started for the next log."""

    def __init__(self, is_cancelled: Callable[[], bool] = lambda: False) -> None:
        """Starts no process before the first log.

        Args:
            is_cancelled: whether to give up a reading; it is called every ``POLL_SECONDS``.
        """
        self._is_cancelled = is_cancelled
        self._exits = ExitStack()
        self._process: BaseProcess | None = None
        self._executor: ProcessPool
        self._logs_of_process = 0

    def read(self, job: Job, limits: JobLimits, read: ReadLog) -> JobOutcome | None:
        """Reads a log in the process, and finds out why where the process does not return an outcome.

        Without an outcome the process has ended, or is beyond its limits. If it has ended, the exit code ENOMEM says
        that it had too little memory, and any other that it crashed. After a crash, and after missing memory in a
        process that had read other logs, a new process tries once more.

        Args:
            job: the log to read, by its path.
            limits: time and memory for its reading.
            read: the function that reads it.

        Returns:
            Its outcome; None if the reading was given up.

        Raises:
            Unreadable: no process can be started.
        """
        ending: JobEnding = "died"
        exit_code: int | None = None
        if self._logs_of_process >= limits.logs:
            self.stop()
        for _ in range(ATTEMPTS):
            process = self._process or self._start_process(read)
            self._logs_of_process += 1
            supervision = Supervision(process.pid or 0, limits)
            outcome = None
            try:
                future = self._executor.submit(read_within_limits, job, limits, read)
                outcome = self._awaited_result(future, supervision.is_beyond_limits)
                ending = supervision.ending
            except BrokenExecutor:
                exit_code = exit_code_of_ended(process)
                ending = "memory" if exit_code == errno.ENOMEM else "died"
                # The signal that ended it may have been sent to the whole run, which takes as long to notice it.
                time.sleep(2 * POLL_SECONDS)
            if outcome is not None or self._is_cancelled():
                return outcome
            was_first_log = self._logs_of_process == 1
            self.stop()
            if ending == "time":
                too_long = Fact(ReadingFact.READING_TOO_LONG, time_limit=limits.seconds)
                return replace(failed(job, "time", too_long), seconds=limits.seconds)
            # After other logs their memory may have been missing: then a new process tries.
            if ending == "memory" and was_first_log:
                too_large = Fact(ReadingFact.READING_TOO_LARGE, memory_limit=limits.megabytes)
                return replace(failed(job, "memory", too_large), megabytes=limits.megabytes)
        died = Fact(ReadingFact.READER_DIED, reason=_exit_text(exit_code), attempts=ATTEMPTS)
        return failed(job, "died", died)

    def _start_process(self, read: ReadLog) -> BaseProcess:
        """Starts the worker's process, and waits until it has imported its modules.

        The limits of time and memory for a log do not include these imports.

        Args:
            read: function that will read logs.

        Returns:
            The process.

        Raises:
            Unreadable: the process cannot be started.
        """
        # NumPy reads these when it is imported. One thread for each process is enough: other readers use the other
        # cores.
        for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ.setdefault(name, "1")
        os.environ.setdefault("MPLBACKEND", "agg")
        try:
            self._executor = self._exits.enter_context(process_pool(1))
            (self._process,) = self._executor.processes
            self._awaited_result(self._executor.submit(_receive, read))
        except (OSError, BrokenExecutor) as error:
            self.stop()
            raise Unreadable(ReadingFact.READERS_NOT_STARTED, reason=error) from None
        return self._process

    def _awaited_result(
        self, future: Future[Any], is_beyond_limits: Callable[[], bool] = lambda: False
    ) -> Any:
        """Waits for the result of a reading process while it keeps its limits and nobody cancels the reading.

        Args:
            future: future of the result.
            is_beyond_limits: function that returns whether the process exceeds a limit; it is called every
                ``POLL_SECONDS``.

        Returns:
            The result; None if the process exceeded its limits, or the reading was cancelled.
        """
        while not self._is_cancelled():
            if wait([future], POLL_SECONDS).done:
                return future.result()
            if is_beyond_limits():
                break
        return None

    def stop(self) -> None:
        """Kills the process, whatever it does, and removes the files that it leaves."""
        process = self._process
        self._process = None
        self._logs_of_process = 0
        if process is not None:
            process.kill()
        self._exits.close()
        if process is not None:
            # A process that was killed could not remove the copies of logs that it fetched.
            for folder in Path(tempfile.gettempdir()).glob(f"mavdem-{process.pid}-*"):
                shutil.rmtree(folder, ignore_errors=True)


class WorkerPool:
    """Reads logs on this machine, in several processes side by side.

    Attributes:
        limits: limits of each log.
    """

    def __init__(self, processes: int, limits: JobLimits, read: ReadLog) -> None:
        """Creates a pool of worker processes, which start when the first log is read.

        Args:
            processes: number of logs that are read at a time.
            limits: limits of each log.
            read: the function that reads a log.
        """
        self.limits = limits
        self._processes = processes
        self._read = read

    def outcomes(self, jobs: Iterator[Job]) -> Generator[JobOutcome]:
        """Yields the outcomes of jobs in the order in which they come; a job is taken when a process is free.

        Args:
            jobs: logs to read, each with its limits.

        Raises:
            Unreadable: no process can be started.
        """
        cancellation = Event()
        readers = []
        read_functions = []
        for _ in range(self._processes):
            reader = LogReader(cancellation.is_set)
            readers.append(reader)
            read_functions.append(partial(reader.read, limits=self.limits, read=self._read))
        try:
            yield from read_in_parallel(read_functions, jobs, cancellation.set)
        finally:
            with blocked_signals(*TERMINATION_SIGNALS):
                for reader in readers:
                    reader.stop()


def read_in_parallel(
    read_functions: Iterable[Callable[[Job], JobOutcome | None]],
    jobs: Iterator[Job],
    cancel: Callable[[], None],
) -> Generator[JobOutcome]:
    """Reads logs by several readers in parallel, with a thread for each that waits for its process.

    Args:
        read_functions: the readers' functions; each reads one log at a time, and returns None if it was cancelled.
        jobs: the logs; the next one is taken when a reader is free.
        cancel: function that is called when no more outcomes are wanted; the readers' functions return soon after it.

    Yields:
        The outcomes, in the order in which they come.
    """
    # Each reader has one log at a time: when it is done, its function is submitted again with the next log.
    executor = ThreadPoolExecutor(MAX_READER_THREADS)
    try:
        # The readers that work, by the future of the log that each reads.
        busy_readers = {}
        for read_function, job in zip(read_functions, jobs, strict=False):
            busy_readers[executor.submit(read_function, job)] = read_function
        while busy_readers:
            # It waits for a limited time only: another thread may have received a signal, which Python handles in this
            # thread when it wakes.
            completed_futures = wait(busy_readers, POLL_SECONDS, FIRST_COMPLETED).done
            # One outcome is taken at a time. Others that are completed too make the next wait return at once.
            future = next(iter(completed_futures), None)
            if future is None:
                continue
            read_function = busy_readers.pop(future)
            outcome = future.result()
            if outcome is not None:
                yield outcome
            # The reader takes the next log, if there is one.
            next_job = next(jobs, None)
            if next_job is not None:
                busy_readers[executor.submit(read_function, next_job)] = read_function
    finally:
        # This also runs if the caller takes no more outcomes. A termination signal waits until all threads have ended.
        cancel()
        with blocked_signals(*TERMINATION_SIGNALS):
            executor.shutdown()


def exit_code_of_ended(process: BaseProcess) -> int | None:
    """Returns the exit code of a process that has ended or is about to; negative, the signal that killed it.

    The operating system tells an exit code once, to the thread that asks first: the executor's own thread, or one that
    starts another process. Until that thread has stored it, ``process.exitcode`` is None for every other thread.

    Args:
        process: a child of this process.

    Returns:
        The exit code; None if it is unknown after ``EXIT_CODE_SECONDS``, as where this process ignores ended children.
    """
    deadline = time.monotonic() + EXIT_CODE_SECONDS
    process.join(EXIT_CODE_SECONDS)
    while process.exitcode is None and time.monotonic() < deadline:
        time.sleep(0.001)
    return process.exitcode


def _exit_text(exit_code: int | None) -> str:
    """Returns how a process ended, such as "exit code 1", or the name of the signal that killed it.

    Args:
        exit_code: exit code of the process; negative, the signal that killed it; None if it is not known.
    """
    if exit_code is None:
        return "unknown exit code"
    if exit_code < 0:
        return signal_name(-exit_code)
    return f"exit code {exit_code}"


def _receive(read: ReadLog) -> None:
    """Does nothing, in the process of a ``LogReader``, which has then imported the modules of ``read``."""


def read_within_limits(job: Job, limits: JobLimits, read: ReadLog) -> JobOutcome:
    """Reads one log within limits, in the process of a ``LogReader``.

    Linux limits the memory of the process; ``Supervision`` checks memory and processor time from outside, on every
    system. If memory runs out, the process ends with the exit code ENOMEM, since its remaining memory is fragmented.

    Args:
        job: the log to read, by its path.
        limits: processor time and memory for it.
        read: the function that reads it.

    Returns:
        The outcome, with the seconds that the reading took and the largest memory of the process so far, MiB.
    """
    begin = time.perf_counter()
    if not os.environ.get("MAVDEM_TRACEBACK"):
        _silence_output()
    # Each process uses one core; other readers use the others.
    forbid_child_processes()
    limit_memory(limits.megabytes)
    try:
        outcome = outcome_of(job, read)
    except MemoryError:
        os._exit(errno.ENOMEM)
    return replace(outcome, seconds=time.perf_counter() - begin, megabytes=peak_mebibytes())


def _silence_output() -> None:
    """Sends the standard output and the standard error of this process, also of C libraries, to nowhere."""
    null_device = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):
        os.dup2(null_device, descriptor)
    os.close(null_device)


def outcome_of(job: Job, read: ReadLog) -> JobOutcome:
    """Reads one log in this process, and returns an outcome even if reading fails.

    A log that cannot be read must not end the run over thousands of others. How it ended decides whether it is read
    again: "read", its content is known, even if it is not a log; "known", it is a copy of a log that was read;
    "source", it could not be reached, or a package that its format needs is not installed; "error", mavdem itself
    failed. A lack of memory alone is raised: another process with a higher limit may read the log.

    Args:
        job: path or URL of the log, and the keys of logs of the same size that were read already.
        read: function that reads a file, given its path, key and the maker of its page.

    Returns:
        The outcome, also of a log that cannot be reached or read.

    Raises:
        MemoryError: there is not enough memory.
    """
    key = ""
    try:
        with _local_file(job.path) as path:
            key = content_key(path)
            if key in job.known:
                return JobOutcome(job.path, "known", key=key)
            rows, pages = read(path, key, job.page)
            named_rows = tuple(replace(row, **_job_columns(job, key)) for row in rows)
            return JobOutcome(job.path, ended="read", rows=named_rows, key=key, pages=pages)
    except Unreadable as error:
        # The log may be read in a process with a higher limit of memory.
        if isinstance(error.__context__, MemoryError):
            raise MemoryError from None
        if is_disk_full(error):
            return replace(failed(job, "source", error.fact, key), is_disk_full=True)
        # The fact does not name the file: copies of a log have equal rows, but for the column with their names.
        reason = error.fact.replace(path="The log")
        return failed(job, "read" if key else "source", reason, key)
    except MissingExtra as error:
        # Once the package is installed, the log can be read.
        return failed(job, "source", error.fact.replace(subject="The log"), key)
    except OSError as error:
        unreachable = Fact(ReadingFact.LOG_UNREACHABLE, reason=error.strerror or error)
        return replace(failed(job, "source", unreachable, key), is_disk_full=is_disk_full(error))
    except MemoryError:
        raise
    except Exception as error:
        return failed(job, "error", reading_failure(error), key)


def content_key(path: Path) -> str:
    """Returns the key of a log's content: the beginning of its SHA-256 and its size in bytes.

    Args:
        path: the log, a plain file.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        return f"{digest[:KEY_HASH_DIGITS]}-{file.tell()}"


def reading_failure(error: Exception) -> Fact:
    """Returns the fact that mavdem failed on a log by an error of its own."""
    return Fact(ReadingFact.READING_FAILED, reason=f"{type(error).__name__}: {error}")


@contextmanager
def _local_file(path: str) -> Iterator[Path]:
    """Provides a log as a plain file of this machine for a block; a log behind a URL is copied for that time.

    The name of the folder with the copy contains the number of this process, so that the copy is found and removed if
    the process is killed.

    Args:
        path: path or URL of the log.

    Yields:
        Path of the file.

    Raises:
        Unreadable: the path is not a plain file, or the URL cannot be fetched.
        OSError: the disk has no space for the copy.
    """
    if not is_url(path):
        # Opening a pipe may wait for ever.
        if Path(path).exists() and not Path(path).is_file():
            raise Unreadable(ReadingFact.NO_PLAIN_FILE)
        yield Path(path)
        return
    with tempfile.TemporaryDirectory(prefix=f"mavdem-{os.getpid()}-") as folder, chdir(folder):
        name = urlsplit(path).path.rpartition("/")[2]
        copy = Path(name[-MAX_COPY_NAME_LETTERS:] or "log")
        copy_remote_file(path, copy)
        yield copy
