"""Jobs, limits and outcomes: what is asked of the process that reads one log, and what it answers."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from io import BufferedReader
from typing import Literal

from mavdem.fleet.row import FlightRow

MEGABYTE = 1 << 20
READ_LOG = "mavdem.fleet.reading.flights:rows_of_log"  # the function that makes rows of a log
READY = "ready"  # the first line of a process that reads logs: all is imported

Ended = Literal["read", "known", "source", "error", "time", "memory", "died"]
"""How the reading of a log ended: it was read, or had been before; it could not be reached; mavdem failed; it took too
long or too much memory; or the process that read it died."""


@dataclass(frozen=True)
class Limits:
    """What one log may cost: ``seconds``, and ``megabytes`` of memory of the process that reads it."""

    seconds: float = 300.0
    megabytes: int = 600


@dataclass(frozen=True)
class Job:
    """One log to read.

    Attributes:
        path: absolute path, or URL.
        known: keys of logs of the same size that were read before: if it has one of them it is not read again.
        page: the function that writes a flight's page, as ``package.module:function``; empty for none.
        pages: the folder for pages.
    """

    path: str
    known: tuple[str, ...] = ()
    page: str = ""
    pages: str = ""


@dataclass(frozen=True)
class ReadOutcome:
    """What became of a job.

    Attributes:
        ended: how.
        rows: of the log; at least one, unless it was known.
        key: of the log's content; empty if it was not reached.
        seconds: it took.
        megabytes: the most memory that the process had.
    """

    ended: Ended
    rows: tuple[FlightRow, ...] = ()
    key: str = ""
    seconds: float = 0.0
    megabytes: float = 0.0

    def to_json(self) -> str:
        """One line."""
        return json.dumps(asdict(replace(self, rows=())) | {"rows": [row.as_dict() for row in self.rows]})

    @staticmethod
    def from_json(line: str | bytes) -> ReadOutcome:
        """The outcome of :meth:`to_json`; raises ``ValueError``, ``TypeError`` or ``KeyError`` for anything else."""
        values = json.loads(line)
        rows = tuple(FlightRow.from_dict(row) for row in values.pop("rows"))
        return ReadOutcome(rows=rows, **values)


def failed(job: Job, ended: Ended, status: str, key: str = "") -> ReadOutcome:
    """The outcome of a log of which only ``status`` can be said."""
    return ReadOutcome(ended, (FlightRow(file=job.path, key=key, status=status),), key)


def content_key(file: BufferedReader) -> str:
    """Hash and size of a file's content, by which it is known under any name."""
    digest = hashlib.file_digest(file, "sha256").hexdigest()
    return f"{digest[:32]}-{file.tell()}"


def size_of(key: str) -> int:
    """The size in a key, bytes; -1 in an empty one."""
    return int(key.rpartition("-")[2] or -1)
