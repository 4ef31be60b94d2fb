"""Any field of a log in the library: a worker process reads the log once, and the server reads the columns it stored.

The first request for a flight has its log read within the limits of every log, which takes seconds. The worker writes
all columns into one file, one after another, and a list of where each begins. The server maps that file into memory, so
that a request reads nothing but the columns that it needs. The columns of the most recently requested flights are kept
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
from mavdem.export.fields import FieldSamples, field_samples
from mavdem.facts.serve import LimitedResource, RefusalReason
from mavdem.fleet.workers import Job, JobLimits, JobOutcome, LogReader, ReadLog
from mavdem.serve.stored_columns import StoredLog, open_columns, write_columns
from mavdem.serve.stored_files import ServerLock, is_locked, register_server

MAX_KEPT_LOGS = 4
"""Logs whose columns are kept, the most recently requested ones. Each takes as much of the disk as
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
        """Returns the outcome of reading a log by a function; None if that was given up."""

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
    """Identifies a log file with its content: when the file is replaced, its columns must be read again."""

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
        problem: why the log cannot be read, in a sentence; empty if that is not known.
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
    """Cache of the columns of the most recently used logs, for all threads of one server.

    While one log is read, the fields of the others are answered: a lock of its own guards the reading of each log, and
    the lock of the store is held for moments only.
    """

    def __init__(self, limits: JobLimits = DEFAULT_LIMITS, reader: Reader | None = None) -> None:
        """Starts no process before the first request.

        Args:
            limits: time and memory for reading one log.
            reader: reader of one log at a time; None for a process of its own.
        """
        self._limits = limits
        self._is_stopping = threading.Event()
        self._reader = reader or LogReader(self._is_stopping.is_set)
        self._reader_lock = threading.Lock()
        self._waiting = threading.BoundedSemaphore(MAX_WAITING_REQUESTS)
        # Guards the logs, which are in the order of their last request, and their numbers of users.
        self._lock = threading.Lock()
        self._logs: OrderedDict[LogVersion, KeptLog] = OrderedDict()
        # The folder for the columns of all logs, and the lock that shows that this server lives.
        self._parent: Path | None = None
        self._server_lock: ServerLock | None = None

    def messages(
        self, log: Path, vehicle: str = "", document: Path | None = None
    ) -> list[JsonValues]:
        """Lists the messages of a log with their fields and instances, after reading the log if that is necessary.

        Args:
            log: path of the log.
            vehicle: ``SYSTEM_COMPONENT`` of a vehicle of the log; empty for that of the flight's page.
            document: path of the document that was written with the flight's page, which names the vehicle of the page;
                None for the first vehicle of the log.

        Returns:
            A dictionary for each message (``MessageFields``).

        Raises:
            Refusal: the log cannot be read, has no such vehicle, or too many requests wait.
        """
        with self._columns_in_use(log, document) as columns:
            return columns.vehicle(vehicle).messages

    def samples(
        self, log: Path, request: FieldRequest, document: Path | None = None
    ) -> FieldSamples:
        """Returns all samples of one field, after reading the log if that is necessary.

        Args:
            log: path of the log.
            request: the field, with its message, instance, boot and vehicle.
            document: path of the document that names the vehicle of the flight's page; None for the first vehicle.

        Returns:
            Times, s since boot, and values.

        Raises:
            Refusal: the log cannot be read, has no such field, or too many requests wait.
        """
        with self._columns_in_use(log, document) as columns:
            telemetry = columns.telemetry(request.vehicle)
            try:
                return field_samples(
                    telemetry, request.message, request.field, request.instance, request.boot
                )
            except ValueError as error:
                raise Refusal(RefusalReason.NO_SUCH_FIELD, reason=str(error)) from None

    def remove(self, log: Path) -> None:
        """Removes the stored columns of a log, for example when the log is deleted.

        Columns that another request is using are removed from the disk when that request ends (``_release_columns``).

        Args:
            log: path of the log.
        """
        unused_logs = []
        with self._lock:
            for version in list(self._logs):
                if version.path != log:
                    continue
                kept_log = self._logs.pop(version)
                if not kept_log.users:
                    unused_logs.append(kept_log)
        # Files are removed without the lock, since the disk is slow and other requests need the lock.
        for kept_log in unused_logs:
            kept_log.remove_files()

    def stop(self) -> None:
        """Ends the worker process, even in the middle of a log, and removes the columns of all logs."""
        self._is_stopping.set()
        # The reading of a log is aborted within a moment, and releases this lock.
        with self._reader_lock:
            self._reader.stop()
            if self._parent is not None:
                shutil.rmtree(self._parent, ignore_errors=True)
            if self._server_lock is not None:
                self._server_lock.release()

    @contextmanager
    def _columns_in_use(self, log: Path, document: Path | None) -> Iterator[StoredLog]:
        """Yields the columns of a log, and counts the users of them, so that no other thread removes them meanwhile.

        Args:
            log: path of the log.
            document: path of the document that names the vehicle of the flight's page; None for the first vehicle.

        Raises:
            Refusal: the log is not there or cannot be read, or too many requests wait.
        """
        try:
            status = log.stat()
        except OSError:
            raise Refusal(RefusalReason.NO_SUCH_FLIGHT) from None
        version = LogVersion(log, status.st_size, status.st_mtime_ns)
        with self._lock:
            kept_log = self._logs.setdefault(version, KeptLog())
            # The logs are in the order of their last use: the first ones are removed first.
            self._logs.move_to_end(version)
            kept_log.users += 1
        try:
            columns = kept_log.columns
            if columns is None:
                columns = self._read_once(kept_log, log, document)
            yield columns
        finally:
            self._release_columns(version, kept_log)

    def _release_columns(self, version: LogVersion, kept_log: KeptLog) -> None:
        """Ends one use of a log's columns, and removes all columns that are not needed any more.

        These are the columns of a log whose reading was aborted, columns that :meth:`remove` took out of the store
        while they were used, and the least recently used columns if the store has more than ``MAX_KEPT_LOGS`` logs.

        Args:
            version: path of the log, with its size and time of change.
            kept_log: entry of the log in the store, with its columns.
        """
        unused_logs = []
        with self._lock:
            kept_log.users -= 1
            was_aborted = kept_log.columns is None and not kept_log.problem
            if was_aborted and not kept_log.users and self._logs.get(version) is kept_log:
                del self._logs[version]
            # The dictionary has the least recently used log first.
            for old_version, old_log in list(self._logs.items()):
                if len(self._logs) <= MAX_KEPT_LOGS:
                    break
                if not old_log.users:
                    unused_logs.append(self._logs.pop(old_version))
            # Columns that are no longer in the store under this version are removed by their last user.
            is_in_store = self._logs.get(version) is kept_log
            if not kept_log.users and not is_in_store and kept_log not in unused_logs:
                unused_logs.append(kept_log)
        # Files are removed without the lock, since the disk is slow and other requests need the lock.
        for unused_log in unused_logs:
            unused_log.remove_files()

    def _read_once(self, kept_log: KeptLog, log: Path, document: Path | None) -> StoredLog:
        """Returns the columns of a log, after having it read or waiting until another request has had it read.

        Args:
            kept_log: entry of the log in the store; its ``columns`` or ``problem`` is set.
            log: path of the log.
            document: path of the document that names the vehicle of the flight's page; None for the first vehicle.

        Raises:
            Refusal: it cannot be read, the server is ending, or too many requests wait.
        """
        if not self._waiting.acquire(blocking=False):
            raise Refusal(
                RefusalReason.UPLOADS_TOO_MANY,
                count=MAX_WAITING_REQUESTS,
                name=LimitedResource.FIELDS,
            )
        try:
            with kept_log.reading:
                # Another request may have had the log read while this one waited for the lock. A log with a problem is
                # not tried again.
                if kept_log.columns is None and not kept_log.problem:
                    with self._reader_lock:
                        self._read_log(kept_log, log, document)
                if kept_log.columns is None:
                    raise Refusal(RefusalReason.LOG_NOT_READ, reason=kept_log.problem)
                return kept_log.columns
        finally:
            self._waiting.release()

    def _folder_of_server(self) -> Path:
        """Returns the temporary folder for all columns of this server, which is created for the first log."""
        if self._parent is None:
            _remove_leftovers()
            self._parent = Path(tempfile.mkdtemp(prefix=FOLDER_PREFIX))
            self._server_lock = register_server(self._parent / SERVER_FILE)
        return self._parent

    def _read_log(self, kept_log: KeptLog, log: Path, document: Path | None) -> None:
        """Has a log read by the worker process, which writes its columns into a temporary folder.

        A failure that would repeat itself is stored as the log's ``problem``; any other one is only raised, so that the
        next request tries again.

        Args:
            kept_log: entry of the log in the store; its ``folder``, and ``columns`` or ``problem``, are set.
            log: path of the log.
            document: path of the document that names the vehicle of the flight's page; None for the first vehicle.

        Raises:
            Refusal: the log could not be read this time, or the server is ending.
        """
        if self._is_stopping.is_set():
            raise _refusal_at_end()
        kept_log.folder = Path(tempfile.mkdtemp(dir=self._folder_of_server()))
        read = partial(write_columns, kept_log.folder, document)
        outcome = self._reader.read(Job(str(log)), self._limits, read)
        # A failed job has a row with the reason as its status; a successful one has no rows here.
        if outcome is not None and outcome.ended == "read" and not outcome.rows:
            kept_log.columns = open_columns(kept_log.folder)
            return
        shutil.rmtree(kept_log.folder, ignore_errors=True)
        # A job without an outcome was aborted because the server is ending.
        if outcome is None:
            raise _refusal_at_end()
        problem = str(outcome.rows[0].status)
        if outcome.ended not in LASTING_ENDINGS:
            raise Refusal(RefusalReason.LOG_NOT_READ, reason=problem)
        kept_log.problem = problem


def _refusal_at_end() -> Refusal:
    """Returns the refusal of a request that comes while the server ends."""
    return Refusal(RefusalReason.NOT_STARTED, name="The reader", reason="the server is ending")


def _remove_leftovers() -> None:
    """Removes the temporary folders that servers left behind when they were killed.

    A running server holds a lock on a file in its folder, so that a folder without a lock belongs to a killed one.
    """
    for folder in Path(tempfile.gettempdir()).glob(f"{FOLDER_PREFIX}*"):
        # Folders of other users cannot be opened. A folder without the file belongs to a server that is just starting.
        with suppress(OSError):
            server_file = folder / SERVER_FILE
            if server_file.is_file() and not is_locked(server_file):
                shutil.rmtree(folder, ignore_errors=True)
