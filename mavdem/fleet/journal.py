"""The journal: what was read since the data set was last written, a line a log, on the disk before the next begins."""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any

from mavdem.fleet.dataset import group_of
from mavdem.fleet.ledger import Ledger, LedgerEntry
from mavdem.fleet.row import SCHEMA_VERSION, FlightRow

JOURNAL = "journal.jsonl"


class Journal:
    """The journal of a fleet's folder, which must be there.

    A line that a crash cut off is dropped, as are those of another version of the columns.

    Attributes:
        entries: of the logs in it, by path, the last of each.
        lines: where the rows of each content are in the file, by the entry's identity, the last of each.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / JOURNAL
        self.entries: dict[str, LedgerEntry] = {}
        self.lines: dict[str, int] = {}
        self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        whole = 0
        with self.path.open("rb") as file:
            for line in file:
                try:
                    values = json.loads(line)
                    entry = _entry(values)
                    has_rows = values["rows"] is not None
                except (ValueError, TypeError, KeyError):
                    break
                if not line.endswith(b"\n") or entry.schema != SCHEMA_VERSION:
                    break
                self._note(entry, has_rows, whole)
                whole += len(line)
        # What such a line held, and those after it, is read again.
        os.ftruncate(self._file, whole)

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._file)

    def _note(self, entry: LedgerEntry, has_rows: bool, place: int) -> None:
        self.entries[entry.path] = entry
        if has_rows:
            self.lines[entry.identity] = place

    def append(self, entry: LedgerEntry, rows: Sequence[FlightRow] | None) -> None:
        """Adds a log, and returns when the disk has it; no rows where those of the same content are there already.

        Raises ``OSError``: the disk is full, say; what was added before is kept.
        """
        place = os.fstat(self._file).st_size
        values = {"entry": asdict(entry), "rows": None if rows is None else [row.as_dict() for row in rows]}
        line = memoryview(json.dumps(values).encode() + b"\n")
        try:
            while line:
                line = line[os.write(self._file, line) :]
            os.fsync(self._file)
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._file, place)
            raise
        self._note(entry, rows is not None, place)

    def lines_by_group(self) -> dict[str, list[int]]:
        """Where in the file the rows of each group of the data set are."""
        places = defaultdict(list)
        for entry in {entry.identity: entry for entry in self.entries.values()}.values():
            if entry.identity in self.lines:
                for group in entry.groups:
                    places[group].append(self.lines[entry.identity])
        return places

    def rows(self, places: Sequence[int], group: str) -> Iterator[FlightRow]:
        """The rows of one group in the lines at these places."""
        with self.path.open("rb") as file:
            for place in sorted(places):
                file.seek(place)
                for values in json.loads(file.readline())["rows"]:
                    row = FlightRow.from_dict(values)
                    if group_of(row.vehicle) == group:
                        yield row

    def into(self, ledger: Ledger) -> None:
        """Adds its entries to a ledger."""
        for entry in self.entries.values():
            ledger.add(entry)

    def clear(self) -> None:
        """Forgets everything, once the data set has it."""
        os.ftruncate(self._file, 0)
        os.fsync(self._file)
        self.entries.clear()
        self.lines.clear()


def has_lines(folder: Path) -> bool:
    """Whether the journal of a folder has anything."""
    try:
        return (folder / JOURNAL).stat().st_size > 0
    except OSError:
        return False


def _entry(values: dict[str, Any]) -> LedgerEntry:
    return LedgerEntry(**values["entry"] | {"groups": tuple(values["entry"]["groups"])})
