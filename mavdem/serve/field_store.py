"""Any field of a log of the library: a worker process reads the log once, the server reads columns of what it wrote.

The first request for a flight has its log read within the limits of every log, which takes seconds. The worker writes
all columns into one file, one after another, and a list of where each begins. The server maps that file into memory, so
that a request reads nothing but the columns that it needs. The columns of the flights that were asked for last are kept
until the server ends.
"""

import shutil
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple, Protocol

from mavdem.containers import JsonValues
from mavdem.errors import Refusal
from mavdem.export.fields import FieldSamples, samples_of
from mavdem.facts.serve import Crowd, Request
from mavdem.fleet.workers import Job, JobLimits, JobOutcome, LogReader, ReadLog
from mavdem.serve.stored_columns import StoredLog, open_columns, write_columns
from mavdem.serve.stored_files import ServerLock, is_locked, register_server

MAX_KEPT_LOGS = 4
"""Logs whose columns are kept, those that were asked for last. Each takes as much of the disk as
``stored_columns.MAX_COLUMN_BYTES`` at most; logs that are being plotted are kept beyond this number."""

MAX_WAITING_REQUESTS = 8
"""Requests that wait for a log to be read at a time: each takes a thread of the server, which has forty."""

LASTING_ENDINGS = ("read", "time", "memory")
"""How the reading of a log ended where another attempt would end the same: the log is damaged, or beyond its limits.
It is not read again while it is kept, since each attempt may take minutes in which no other log is read."""

FOLDER_PREFIX = "mavdem-fields-"
"""Beginning of the name of a server's folder of columns, among the system's temporary files."""

SERVER_FILE = "server"
"""Name of the file in that folder that the server has locked for as long as it lives."""

DEFAULT_LIMITS = JobLimits()
"""Time and memory for reading a log whose fields are plotted, where the command line sets none."""


class Reader(Protocol):
    """Reads logs, one at a time, such as ``LogReader``."""

    def read(self, job: Job, limits: JobLimits, read: ReadLog) -> JobOutcome | None:
        """Returns the outcome of reading a log by a function; None where that was given up."""

    def stop(self) -> None:
        """Ends the reading."""


class FieldRequest(NamedTuple):
    """A field of a message that somebody wants to see."""

    message: str
    """Name of the message, as MAVLink or as the log calls it."""
    field: str
    """Name of one of its fields."""
    instance: int | None = None
    """Which of several equal sensors or outputs; None for all of them."""
    boot: int = 0
    """After which boot of the autopilot, from 0."""
    vehicle: str = ""
    """``SYSTEM_COMPONENT`` of a vehicle of the log; empty for that of the flight's page."""


class LogVersion(NamedTuple):
    """A log with its content: another file in its place has other columns."""

    path: Path
    """Path of the log."""
    size: int
    """Its size, bytes."""
    modified: int
    """When it was written last, ns of UNIX time."""


class KeptLog:
    """The columns of a log, or the place for them while it is read.

    Attributes:
        reading: held while the log is read; other requests for the same log wait for it.
        columns: the columns; None before the log was read.
        problem: why the log cannot be read, in a sentence; empty where that is not known.
        users: number of requests that use this now. It is changed under the store's lock only.
        folder: the folder with the files; None before the log was read.
    """

    def __init__(self) -> None:
        self.reading = threading.Lock()
        self.columns: StoredLog | None = None
        self.problem = ""
        self.users = 0
        self.folder: Path | None = None

    def remove_files(self) -> None:
        """Removes the files, which nobody may use any more."""
        # Windows removes no file that is mapped into memory.
        self.columns = None
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)


class FieldStore:
    """The columns of the logs that were asked for last, for all threads of one server.

    While one log is read, the fields of the others are answered: a lock of its own guards the reading of each log, and
    the lock of the store is held for moments only.
    """

    def __init__(self, limits: JobLimits = DEFAULT_LIMITS, reader: Reader | None = None) -> None:
        """Starts no process before the first request.

        Args:
            limits: time and memory for reading one log.
            reader: reads one log at a time; None for a process of its own.
        """
        self._limits = limits
        self._is_stopping = threading.Event()
        self._reader = reader or LogReader(self._is_stopping.is_set)
        self._reader_lock = threading.Lock()
        self._waiting = threading.BoundedSemaphore(MAX_WAITING_REQUESTS)
        # Guards the logs, which are in the order in which they were asked for, and their numbers of users.
        self._lock = threading.Lock()
        self._logs: OrderedDict[LogVersion, KeptLog] = OrderedDict()
        # The folder for the columns of all logs, and the lock that shows that this server lives.
        self._parent: Path | None = None
        self._server_lock: ServerLock | None = None

    def messages(
        self, log: Path, vehicle: str = "", document: Path | None = None
    ) -> list[JsonValues]:
        """Lists the messages of a log with their fields and instances.

        Args:
            log: path of the log.
            vehicle: ``SYSTEM_COMPONENT`` of a vehicle of the log; empty for that of the flight's page.
            document: path of the document that was written with the flight's page, which says of which vehicle the page
                is; None for the first vehicle of the log.

        Raises:
            Refusal: the log cannot be read, has no such vehicle, or too many requests wait.
        """
        with self._columns(log, document) as columns:
            return columns.vehicle(vehicle).messages

    def samples(
        self, log: Path, request: FieldRequest, document: Path | None = None
    ) -> FieldSamples:
        """Returns all samples of one field.

        Args:
            log: path of the log.
            request: the field.
            document: as for ``messages``.

        Raises:
            Refusal: the log cannot be read, has no such field, or too many requests wait.
        """
        with self._columns(log, document) as columns:
            telemetry = columns.telemetry(request.vehicle)
            try:
                return samples_of(
                    telemetry, request.message, request.field, request.instance, request.boot
                )
            except ValueError as error:
                raise Refusal(Request.NO_SUCH_FIELD, because=str(error)) from None

    def remove(self, log: Path) -> None:
        """Removes the columns of a log, such as one that is deleted; those in use go when they are not used any more.

        Args:
            log: path of the log.
        """
        unused = []
        with self._lock:
            for version in list(self._logs):
                if version.path == log:
                    kept = self._logs.pop(version)
                    if not kept.users:
                        unused.append(kept)
        for kept in unused:
            kept.remove_files()

    def stop(self) -> None:
        """Ends the process, whatever it does, and removes all columns."""
        self._is_stopping.set()
        # A log that is being read is given up within a moment.
        with self._reader_lock:
            self._reader.stop()
            if self._parent is not None:
                shutil.rmtree(self._parent, ignore_errors=True)
            if self._server_lock is not None:
                self._server_lock.release()

    @contextmanager
    def _columns(self, log: Path, document: Path | None) -> Iterator[StoredLog]:
        """Yields the columns of a log, which nobody removes meanwhile.

        Args:
            log: path of the log.
            document: as for ``messages``.

        Raises:
            Refusal: the log is not there or cannot be read, or too many requests wait.
        """
        try:
            status = log.stat()
        except OSError:
            raise Refusal(Request.NO_SUCH_FLIGHT) from None
        version = LogVersion(log, status.st_size, status.st_mtime_ns)
        with self._lock:
            kept = self._logs.setdefault(version, KeptLog())
            self._logs.move_to_end(version)
            kept.users += 1
        try:
            columns = kept.columns
            if columns is None:
                columns = self._read_once(kept, log, document)
            yield columns
        finally:
            self._release(version, kept)

    def _release(self, version: LogVersion, kept: KeptLog) -> None:
        """Ends a use of a log, and removes what is not to be kept: logs that were given up, and the oldest ones.

        Args:
            version: the log.
            kept: its columns, which may have been taken out of the store meanwhile.
        """
        unused = []
        with self._lock:
            kept.users -= 1
            is_given_up = kept.columns is None and not kept.problem
            if is_given_up and not kept.users and self._logs.get(version) is kept:
                del self._logs[version]
            for old_version, old in list(self._logs.items()):
                if len(self._logs) <= MAX_KEPT_LOGS:
                    break
                if not old.users:
                    unused.append(self._logs.pop(old_version))
            if not kept.users and kept not in unused and self._logs.get(version) is not kept:
                unused.append(kept)
        for old in unused:
            old.remove_files()

    def _read_once(self, kept: KeptLog, log: Path, document: Path | None) -> StoredLog:
        """Has a log read, or waits where another request has it read, and returns its columns.

        Args:
            kept: the place for its columns.
            log: path of the log.
            document: as for ``messages``.

        Raises:
            Refusal: it cannot be read, the server is ending, or too many requests wait.
        """
        if not self._waiting.acquire(blocking=False):
            raise Refusal(Request.UPLOADS_TOO_MANY, count=MAX_WAITING_REQUESTS, name=Crowd.FIELDS)
        try:
            with kept.reading:
                # A log with a problem is not tried again.
                if kept.columns is None and not kept.problem:
                    with self._reader_lock:
                        self._read(kept, log, document)
                if kept.columns is None:
                    raise Refusal(Request.LOG_NOT_READ, because=kept.problem)
                return kept.columns
        finally:
            self._waiting.release()

    def _read(self, kept: KeptLog, log: Path, document: Path | None) -> None:
        """Has a log read by the worker process.

        Args:
            kept: gets the columns, or the reason why the log cannot be read.
            log: path of the log.
            document: as for ``messages``.

        Raises:
            Refusal: the log could not be read this time, or the server is ending.
        """
        if self._is_stopping.is_set():
            raise _refusal_at_end()
        if self._parent is None:
            _remove_leftovers()
            self._parent = Path(tempfile.mkdtemp(prefix=FOLDER_PREFIX))
            self._server_lock = register_server(self._parent / SERVER_FILE)
        kept.folder = Path(tempfile.mkdtemp(dir=self._parent))
        read = partial(write_columns, kept.folder, document)
        outcome = self._reader.read(Job(str(log)), self._limits, read)
        if outcome is not None and outcome.ended == "read" and not outcome.rows:
            kept.columns = open_columns(kept.folder)
            return
        shutil.rmtree(kept.folder, ignore_errors=True)
        if outcome is None:
            raise _refusal_at_end()
        problem = str(outcome.rows[0].status)
        if outcome.ended not in LASTING_ENDINGS:
            raise Refusal(Request.LOG_NOT_READ, because=problem)
        kept.problem = problem


def _refusal_at_end() -> Refusal:
    """Returns the refusal of a request that comes while the server ends."""
    return Refusal(Request.NOT_STARTED, name="The reader", because="the server is ending")


def _remove_leftovers() -> None:
    """Removes the columns of servers that were killed: their files are not locked any more."""
    for folder in Path(tempfile.gettempdir()).glob(f"{FOLDER_PREFIX}*"):
        # Other users' folders cannot be opened. One without the file is that of a server which starts right now.
        with suppress(OSError):
            server_file = folder / SERVER_FILE
            if server_file.is_file() and not is_locked(server_file):
                shutil.rmtree(folder, ignore_errors=True)
