"""Tracking: from the logs that were named to the data set, of which only what is new is read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mavdem.errors import Unreadable, require
from mavdem.fleet.compaction import SecondPass, compact
from mavdem.fleet.dataset import check_free, group_of, groups_in, is_fleet, read_rows, set_old_aside, write_group
from mavdem.fleet.journal import Journal, has_lines
from mavdem.fleet.ledger import Ledger, entry_of, read_ledger
from mavdem.fleet.lock import locked
from mavdem.fleet.reading.crew import Reader
from mavdem.fleet.reading.outcome import Job, ReadOutcome
from mavdem.fleet.reading.sources import Source, find_logs
from mavdem.fleet.row import OK, FlightRow, as_text
from mavdem.fleet.second_pass import with_health

PAGES, BASELINE = "pages", "baseline"  # folders of a fleet: pages of flights, and rows of healthy ones

Progress = Callable[[int, int], None]
"""Called with how many logs are done, and how many there are to read."""


@dataclass(frozen=True)
class TrackedLogs:
    """What a run did.

    Attributes:
        logs: how many were named.
        read: how many of them were read; the others were known.
        problems: names that name no log, and known logs that could not be read now, a sentence each.
    """

    logs: int
    read: int
    problems: tuple[str, ...]


class FleetTracker:
    """Keeps the data set of a fleet.

    Args:
        folder: of the fleet; made if it is not there.
        reader: what reads the logs.
        page: the function that writes a flight's page, as ``package.module:function``; empty for none.
        second_pass: what judges all flights of a vehicle.
    """

    def __init__(
        self,
        folder: Path,
        reader: Reader,
        page: str = "",
        second_pass: SecondPass = with_health,
    ) -> None:
        require("Tracking a fleet", "fleet")
        self.folder = folder
        self._reader = reader
        self._page = page
        self._second_pass = second_pass
        self._unread: list[str] = []  # of this run: known logs that could not be read, a sentence each

    def track(
        self, names: Sequence[str], baseline: Sequence[str] = (), progress: Progress = lambda *_: None
    ) -> TrackedLogs:
        """Brings the data set up to date with the logs that ``names`` stand for.

        Args:
            names: files, folders, patterns and URLs.
            baseline: the same of healthy flights, or one fleet; as in the last run unless given.
            progress: is called as logs are read.

        Raises:
            Unreadable: there is no log, another run is at work, the folder cannot be written to, or is damaged.
        """
        self._unread = []
        found = find_logs(names, self.folder)
        if not found.logs and not is_fleet(self.folder):
            raise Unreadable(found.problems[0])
        try:
            check_free(self.folder)
            self.folder.mkdir(parents=True, exist_ok=True)
            with locked(self.folder):
                if baseline:
                    self._set_baseline(baseline, progress)
                read = self._update(self.folder, found.logs, progress, self._second_pass, self.healthy())
        except OSError as error:
            kept = "what was read is kept; " if has_lines(self.folder) else ""
            raise Unreadable(
                f"{self.folder} cannot be written to ({error.strerror or error}): {kept}once that is put right, the "
                "same command goes on."
            ) from None
        return TrackedLogs(len(found.logs), read, (*found.problems, *self._unread))

    def healthy(self) -> list[FlightRow]:
        """The rows of the baseline; none if there is none.

        Raises:
            Unreadable: it was written by a version of mavdem with other columns, or is damaged.
        """
        place = self.folder / BASELINE
        rows = read_rows(place) if is_fleet(place) else []
        if not rows and is_fleet(place):
            raise Unreadable(
                f"{place} has the columns of another version of mavdem: name the healthy flights again with --baseline."
            )
        return rows

    def _set_baseline(self, names: Sequence[str], progress: Progress) -> None:
        """Takes rows of healthy flights over, in place of those before."""
        place = self.folder / BASELINE
        if len(names) == 1 and is_fleet(Path(names[0])):
            chosen = read_rows(Path(names[0]))
        else:
            found = find_logs(names, self.folder)
            if found.problems:
                raise Unreadable(f"--baseline: {found.problems[0]}")
            read = place / "logs"
            read.mkdir(parents=True, exist_ok=True)
            self._update(read, found.logs, progress, as_they_are)
            entries = read_ledger(read).named(found.logs)
            keys = {entry.key for entry in entries}
            chosen = [row for row in read_rows(read) if row.key in keys]
        if not any(row.status == OK for row in chosen):
            why = f"{chosen[0].file}: {chosen[0].status}" if chosen else "its logs cannot be read"
            raise Unreadable(f"--baseline holds no flight ({why}): name logs of healthy flights.")
        set_old_aside(place)
        # In one file, so that a run that is killed here leaves the one baseline or the other.
        write_group(place, BASELINE, chosen)
        for group in groups_in(place):
            if group != BASELINE:
                write_group(place, group, ())

    def _update(
        self,
        folder: Path,
        logs: Sequence[Source],
        progress: Progress,
        second_pass: SecondPass,
        healthy: Sequence[FlightRow] = (),
    ) -> int:
        """Reads what is new into a folder's data set; returns how many logs that were."""
        limits = self._reader.limits
        (folder / PAGES).mkdir(exist_ok=True)
        set_old_aside(folder)
        with Journal(folder) as journal:
            ledger = read_ledger(folder).with_rows_in(groups_in(folder))
            journal.into(ledger)
            # The largest first: were one the last, the other processes would wait for it.
            new = sorted((log for log in logs if not ledger.knows(log, limits)), key=lambda log: -log.size)

            def job_of(source: Source) -> Job:
                known = ledger.keys_to_try(source, limits)
                pages = str((folder / PAGES).absolute()) if self._page else ""
                return Job(source.path, known, self._page, pages)

            progress(0, len(new))
            for number, (source, outcome) in enumerate(_outcomes(self._reader, new, job_of), 1):
                if ledger.keeps(source, outcome):
                    why = outcome.rows[0].status
                    self._unread.append(f"{source.path} cannot be read now: what is known of it is kept. {why}")
                else:
                    _note(journal, ledger, source, outcome, self._reader)
                progress(number, len(new))
            compact(folder, journal, second_pass, healthy)
        return len(new)


def as_they_are(rows: Sequence[FlightRow], baseline: Sequence[FlightRow]) -> Sequence[FlightRow]:
    """No second pass: of healthy flights, which are what others are judged by."""
    return rows


def _outcomes(
    reader: Reader, logs: Sequence[Source], job_of: Callable[[Source], Job]
) -> Iterator[tuple[Source, ReadOutcome]]:
    """Those of the reader, whose own trouble is none of the fleet's folder."""
    try:
        yield from reader.outcomes(logs, job_of)
    except OSError as error:
        raise Unreadable(
            f"Logs cannot be read any further ({error.strerror or error}): what was read is kept; once that is put "
            "right, the same command goes on."
        ) from None


def _note(journal: Journal, ledger: Ledger, source: Source, outcome: ReadOutcome, reader: Reader) -> None:
    if outcome.ended == "known":
        like = ledger.of_key(outcome.key)
        entry = replace(like, path=as_text(source.path), size=source.size, version=source.version)
        journal.append(entry, None)
    else:
        entry = entry_of(source, outcome, (group_of(row.vehicle) for row in outcome.rows), reader.limits)
        journal.append(entry, outcome.rows)
    ledger.add(entry)
