"""Work: threads that take logs from the library, and give each to a process within limits or to a cluster."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain

from mavdem.errors import Refusal, Unreadable
from mavdem.facts.serve import Stage
from mavdem.fleet.cluster import Cluster
from mavdem.fleet.store import STORE
from mavdem.fleet.workers import Job, Limits, LogReader, Outcome, outcome_of
from mavdem.serve.library import Entry, Library
from mavdem.serve.reading import PUBLISH, READ, publish

PAUSE_SECONDS = 1.0  # between looks for logs that other servers have received, and at the clock
MOST_SENT = 32  # logs that a cluster is given at a time


class Work:
    """Reads the logs of a ``library`` with so many ``processes``, or on the ``cluster``, each within ``limits``."""

    def __init__(
        self,
        library: Library,
        processes: int,
        limits: Limits,
        cluster: Cluster | None = None,
        read: str = READ,
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

    def _claimed(self) -> Iterator[Entry | None]:
        """Logs as they come, until the end; None where there is none, and the fleet's table is to be made anew."""
        while not self._is_ending.is_set():
            entry = None
            with suppress(Refusal):  # the disk is full: it may be better in a while
                entry = self._library.claim()
            if entry is not None:
                yield entry
                continue
            if self._library.is_unpublished.is_set():
                self._library.is_unpublished.clear()
                yield None
            if self._library.dead_servers():
                self._library.recover()
            with self._has_come:
                self._has_come.wait(PAUSE_SECONDS)

    def _run(self) -> None:
        reader = self._cluster or LogReader(self._is_ending.is_set)
        # At first what a process needs is imported: a log should not wait for that.
        for entry in chain([] if self._cluster else [None], self._claimed()):
            try:
                outcome = self._outcome(reader, entry)
            except Unreadable:  # nothing can read it now, as where a cluster has gone
                with suppress(Refusal):
                    if entry is not None:
                        self._library.change(entry.id, stage=Stage.WAITING, claimed="")
                self._is_ending.wait(PAUSE_SECONDS)
                continue
            with suppress(Refusal):
                if outcome is not None and entry is not None:
                    self._library.finish(entry, outcome, self._limits)
        reader.stop()

    def _outcome(self, reader: LogReader | Cluster, entry: Entry | None) -> Outcome | None:
        """What becomes of a log, or of the fleet's table, which this machine makes."""
        if entry is not None:
            job = Job(str(self._library.path_of(entry)))
            return reader.read(job, self._limits, self._read)
        job = Job(str(self._library.folder / STORE))
        if self._cluster is not None:
            return outcome_of(job, publish)
        return reader.read(job, self._limits, PUBLISH)
