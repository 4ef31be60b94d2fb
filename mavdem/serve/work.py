"""Work: threads that take logs from the library, and give each to a process within limits or to a cluster."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from contextlib import closing, suppress
from itertools import chain

from mavdem.errors import Refusal, Unreadable
from mavdem.facts.serve import Stage
from mavdem.fleet.cluster import Cluster
from mavdem.fleet.store import STORE
from mavdem.fleet.workers import Job, Limits, LogReader, Outcome, outcome_of
from mavdem.serve.library import Entry, Library
from mavdem.serve.reading import PUBLISH, READ, publish

PAUSE_SECONDS = 1.0  # between looks for logs that other servers have received, and at the clock


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
        runs = [self._on_cluster] if cluster else [self._in_process] * processes
        self._threads = [threading.Thread(target=run, daemon=True) for run in runs]

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

    def _finish(self, entry: Entry, outcome: Outcome) -> None:
        with suppress(Refusal):
            self._library.finish(entry, outcome, self._limits)

    def _give_back(self, entries: Iterable[Entry]) -> None:
        """Lets logs wait again that nothing could read now, as where a cluster has gone."""
        for entry in entries:
            with suppress(Refusal):
                self._library.change(entry.id, stage=Stage.WAITING, claimed="")
        self._is_ending.wait(PAUSE_SECONDS)

    def _in_process(self) -> None:
        reader = LogReader(self._is_ending.is_set)
        try:
            # At first what it needs is imported: a log should not wait for that.
            for entry in chain([None], self._claimed()):
                read = self._read if entry else PUBLISH
                try:
                    outcome = reader.read(self._job(entry), self._limits, read)
                except Unreadable:
                    self._give_back([entry] if entry else [])
                    continue
                if outcome is not None and entry is not None:
                    self._finish(entry, outcome)
        finally:
            reader.stop()

    def _on_cluster(self) -> None:
        assert self._cluster is not None
        entries = dict[str, Entry]()

        def jobs(first: Entry) -> Iterator[Job]:
            entry: Entry | None = first
            while entry is not None:
                job = self._job(entry)
                entries[job.path] = entry
                yield job
                entry = self._library.claim()

        for first in self._claimed():
            if first is None:
                outcome_of(self._job(None), publish)
                continue
            try:
                with closing(self._cluster.outcomes(jobs(first))) as outcomes:
                    for outcome in outcomes:
                        self._finish(entries.pop(outcome.path), outcome)
            except Unreadable:
                self._give_back(entries.values())
                entries.clear()

    def _job(self, entry: Entry | None) -> Job:
        """The job of a log, or of the fleet's table."""
        path = self._library.path_of(entry) if entry else self._library.folder / STORE
        return Job(str(path))
