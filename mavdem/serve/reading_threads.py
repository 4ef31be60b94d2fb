"""Threads that claim waiting logs of the library and have each read, by a worker process or a Dask cluster.

They have recordings made in the same way, for those who ask for them.
"""

import sqlite3
import threading
import time
from collections.abc import Callable

from mavdem.errors import Refusal
from mavdem.facts import Fact
from mavdem.facts.serve import RefusalReason, Stage
from mavdem.fleet.cluster import Cluster
from mavdem.fleet.workers import Job, JobLimits, LogReader, ReadLog, outcome_of
from mavdem.live.link import RETRY_SECONDS
from mavdem.serve.index import LibraryEntry
from mavdem.serve.library import Library
from mavdem.serve.reading import publish_table, read_for_library
from mavdem.serve.recordings import RecordingRequests, make_recordings
from mavdem.serve.recovery import dead_servers, recover
from mavdem.serve.stored_files import SERVERS

MAX_CLUSTER_JOBS = 32
"""Logs that are given to a cluster at a time, at most."""

WAITING_AGAIN = {"stage": Stage.WAITING, "claimed": ""}
"""Columns of the index of a log that could not be read now."""

FULL_DISK_SECONDS = 60.0
"""Time, s, after which logs are read again that the disk had no room for: a choice, so that a disk that stays full
does not keep the processors busy."""

TEMPORARY_ERRORS = (Refusal, OSError, sqlite3.Error)
"""Errors that may pass, after which another attempt is made: the disk is full, the cluster does not answer, or the
process has too many open files."""


class ReadingThreads:
    """Reads the logs that wait in a library, several at a time, until it is stopped."""

    def __init__(
        self,
        library: Library,
        processes: int,
        limits: JobLimits,
        cluster: Cluster | None = None,
        read: ReadLog = read_for_library,
    ) -> None:
        """Prepares the threads, which begin with :meth:`start`.

        Args:
            library: the logs that the server stores, with their results and their index.
            processes: number of worker processes on this machine; without effect where there is a cluster.
            limits: time and memory for each log.
            cluster: Dask cluster that reads the logs; None for this machine.
            read: the function that reads one log.
        """
        self._library = library
        self._recordings = RecordingRequests(library)
        self._limits = limits
        self._cluster = cluster
        self._read = read
        self._is_stopping = threading.Event()
        # Time of the monotonic clock, s, before which no log is read, since the disk was full.
        self._reading_resumes = 0.0
        self._log_added = threading.Condition()
        count = MAX_CLUSTER_JOBS if cluster else processes
        self._threads = [
            threading.Thread(target=self._read_waiting_logs, daemon=True) for _ in range(count)
        ]

    def start(self) -> None:
        """Starts the threads."""
        for thread in self._threads:
            thread.start()

    def notify(self) -> None:
        """Wakes a thread, after a log was added to the library, or recordings were requested."""
        with self._log_added:
            self._log_added.notify()

    def stop(self) -> None:
        """Ends the threads and kills their processes, even in the middle of a log; returns when all have ended."""
        self._is_stopping.set()
        with self._log_added:
            self._log_added.notify_all()
        if self._cluster is not None:
            self._cluster.stop()
        for thread in self._threads:
            thread.join()

    def _read_waiting_logs(self) -> None:
        """Runs in each thread: reads waiting logs one after the other, and writes the fleet's table when none waits.

        Recordings have priority, since a visitor waits for them; then logs are read. The table is written when nothing
        waits, once for all logs that were read since.

        After an error that may pass (``TEMPORARY_ERRORS``), the thread waits for ``RETRY_SECONDS`` and continues.
        """
        reader = self._cluster or LogReader(self._is_stopping.is_set)
        # A worker process imports its modules when it writes the table for the first time. That is done immediately, so
        # that the first log need not wait for it.
        needs_warm_up = self._cluster is None
        while not self._is_stopping.is_set():
            try:
                flight = self._recordings.claim()
                is_disk_full = time.monotonic() < self._reading_resumes
                entry = None if flight or is_disk_full else self._library.claim()
                if flight is not None:
                    self._make_recordings(reader, flight)
                elif entry is not None:
                    self._read_log(reader, entry)
                elif needs_warm_up or self._library.table_is_outdated.is_set():
                    needs_warm_up = False
                    self._library.table_is_outdated.clear()
                    self._publish_table(reader)
                else:
                    self._wait_for_log()
            except TEMPORARY_ERRORS:
                self._is_stopping.wait(RETRY_SECONDS)
        reader.stop()

    def _wait_for_log(self) -> None:
        """Waits until a log is added to the library, for ``RETRY_SECONDS`` at most.

        Some work is not announced by another thread, so that it is looked for before each wait: logs of servers that
        have died are taken over, and logs that the command ``mavdem track`` has read are added.
        """
        if dead_servers(self._library):
            recover(self._library)
        self._library.add_fleet_logs()
        with self._log_added:
            self._log_added.wait(RETRY_SECONDS)

    def _read_log(self, reader: LogReader | Cluster, entry: LibraryEntry) -> None:
        """Has a claimed log read, and stores its outcome.

        If the disk is full, the log waits again, for ``FULL_DISK_SECONDS`` at least. If the server ends meanwhile,
        there is no outcome; another server, or the next start, reads the log.

        Args:
            reader: reader of the log, within the limits of time and memory.
            entry: the log, as this thread has claimed it.

        Raises:
            Refusal, OSError, sqlite3.Error: the log cannot be read now, and waits again.
        """
        job = Job(str(self._library.log_path(entry)))
        try:
            outcome = reader.read(job, self._limits, self._read)
        except TEMPORARY_ERRORS:
            self.store_persistently(lambda: self._library.change(entry.id, **WAITING_AGAIN))
            raise
        if outcome is None:
            return
        if outcome.is_disk_full:
            self._reading_resumes = time.monotonic() + FULL_DISK_SECONDS
            problem = Fact(RefusalReason.DISK_FULL).sentence
            self.store_persistently(
                lambda: self._library.change(entry.id, **WAITING_AGAIN, problem=problem)
            )
            return
        self.store_persistently(lambda: self._library.finish_reading(entry, outcome, self._limits))

    def _make_recordings(self, reader: LogReader | Cluster, entry: LibraryEntry) -> None:
        """Has the recordings of a flight made, and stores the outcome.

        If the server ends meanwhile, there is no outcome; the recordings are then made later.

        Args:
            reader: runs the work, within the limits of time and memory.
            entry: the flight, whose recordings this thread has claimed.

        Raises:
            Refusal, OSError, sqlite3.Error: they cannot be made now, and wait again.
        """
        job = Job(str(self._library.log_path(entry)))
        try:
            outcome = reader.read(job, self._limits, make_recordings)
        except TEMPORARY_ERRORS:
            self.store_persistently(lambda: self._recordings.give_back(entry))
            raise
        if outcome is not None:
            self.store_persistently(lambda: self._recordings.finish(entry, outcome))

    def store_persistently(self, change: Callable[[], object]) -> None:
        """Makes a change of the index, and tries again every ``RETRY_SECONDS`` while it fails by a temporary error.

        Otherwise a log would stay claimed for ever if the disk is full at that moment. It gives up if the flight was
        deleted, or if the server ends, which then releases the logs that it has claimed.

        Args:
            change: function that makes the change.
        """
        while True:
            try:
                change()
                return
            except TEMPORARY_ERRORS as error:
                was_deleted = (
                    isinstance(error, Refusal) and error.fact.code is RefusalReason.NO_SUCH_FLIGHT
                )
                if was_deleted or self._is_stopping.wait(RETRY_SECONDS):
                    return

    def _publish_table(self, reader: LogReader | Cluster) -> None:
        """Has the fleet's table of flights written again, which many flights make slow.

        A worker process of this machine does it. If a cluster reads the logs, this thread does it itself, since the
        workers of the cluster only read logs.

        Args:
            reader: reader of logs: a process of this machine, or the workers of a cluster.
        """
        # A job names a file, from whose path the function finds the library's folder. It must not be the SQLite file:
        # whatever runs a job opens and closes its file, and if a process closes a file, POSIX releases all locks that
        # the process has on it, also those of SQLite. So the job names the small file of this server.
        server_file = self._library.folder / SERVERS / self._library.name
        job = Job(str(server_file))
        if self._cluster is None:
            reader.read(job, self._limits, publish_table)
        else:
            outcome_of(job, publish_table)
