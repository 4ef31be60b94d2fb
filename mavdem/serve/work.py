"""Work: threads that take logs from the library, and give each to a process within limits or to a cluster."""

import sqlite3
import threading

from mavdem.errors import Refusal
from mavdem.facts.serve import Stage
from mavdem.fleet.cluster import Cluster
from mavdem.fleet.workers import Job, JobLimits, LogReader, ReadLog, outcome_of
from mavdem.live.link import RETRY_SECONDS
from mavdem.serve.library import SERVERS, Entry, Library
from mavdem.serve.reading import publish, read_for_library

MOST_SENT = 32  # logs that a cluster is given at a time
PASSING = (Refusal, OSError, sqlite3.Error)
"""The disk is full, a cluster has gone, or all descriptors are taken: it may be better in a while."""


class Work:
    """Reads the logs of a ``library`` with so many ``processes``, or on the ``cluster``, each within ``limits``."""

    def __init__(
        self,
        library: Library,
        processes: int,
        limits: JobLimits,
        cluster: Cluster | None = None,
        read: ReadLog = read_for_library,
    ) -> None:
        self._library = library
        self._limits = limits
        self._cluster = cluster
        self._read = read
        self._is_ending = threading.Event()
        self._has_come = threading.Condition()
        count = MOST_SENT if cluster else processes
        self._threads = [threading.Thread(target=self._run, daemon=True) for _ in range(count)]

    def start(self) -> None:
        """Begins."""
        for thread in self._threads:
            thread.start()

    def notify(self) -> None:
        """Says that a log has come."""
        with self._has_come:
            self._has_come.notify()

    def stop(self) -> None:
        """Ends the processes, whatever they do; returns when they have ended."""
        self._is_ending.set()
        with self._has_come:
            self._has_come.notify_all()
        if self._cluster is not None:
            self._cluster.stop()
        for thread in self._threads:
            thread.join()

    def _run(self) -> None:
        reader = self._cluster or LogReader(self._is_ending.is_set)
        # What a process needs is imported as it makes the table: a log should not wait for that.
        is_cold = self._cluster is None
        while not self._is_ending.is_set():
            try:
                if (entry := self._library.claim()) is not None:
                    self._read_log(reader, entry)
                elif is_cold or self._library.is_unpublished.is_set():
                    is_cold = False
                    self._library.is_unpublished.clear()
                    self._publish(reader)
                else:
                    self._wait()
            except PASSING:
                self._is_ending.wait(RETRY_SECONDS)
        reader.stop()

    def _wait(self) -> None:
        """Waits for a log, takes over what a dead server was doing, and enters what `mavdem track` has read."""
        if self._library.dead_servers():
            self._library.recover()
        self._library.adopt()
        with self._has_come:
            self._has_come.wait(RETRY_SECONDS)

    def _read_log(self, reader: LogReader | Cluster, entry: Entry) -> None:
        try:
            outcome = reader.read(Job(str(self._library.path_of(entry))), self._limits, self._read)
        except PASSING:  # nothing can read it now
            self._library.change(entry.id, stage=Stage.WAITING, claimed="")
            raise
        if outcome is not None:
            self._library.finish(entry, outcome, self._limits)

    def _publish(self, reader: LogReader | Cluster) -> None:
        """Makes the fleet's table anew, on this machine."""
        # A job is a file that is read, and who closes SQLite's drops the locks of its process.
        job = Job(str(self._library.folder / SERVERS / self._library.name))
        if self._cluster is None:
            reader.read(job, self._limits, publish)
        else:
            outcome_of(job, publish)
