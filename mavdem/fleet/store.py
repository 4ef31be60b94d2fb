"""The store of a fleet: which logs are known and what each says, in one SQLite file, and the table made of it.

``FLEET/fleet.sqlite`` is written a log at a time, each in a transaction of its own: a run may be killed at any moment,
and two may write side by side, a server among them, whose library (``mavdem.serve.library``) is in the same file. From
it ``FLEET/flights/flights.parquet`` is written whole at the end of a run, for DuckDB, Polars and pandas, where pyarrow
is installed.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, fields, replace
from importlib import metadata
from pathlib import Path
from typing import Any

from mavdem.containers import JsonValues, Names
from mavdem.errors import Unreadable, error_message
from mavdem.extras import missing_modules
from mavdem.facts import Fact
from mavdem.facts.fleet import Folder
from mavdem.facts.motors import HealthUnknown
from mavdem.files import atomic_write
from mavdem.fleet.row import SCHEMA_VERSION, FlightRow, FlightRows, as_text, row_schema
from mavdem.fleet.sources import LogSource, is_url
from mavdem.fleet.workers import PAGES, JobLimits, JobOutcome

STORE = "fleet.sqlite"
TABLE = Path("flights", "flights.parquet")
# rows that a reader skips at once, by the least and the greatest vehicle's name among them
ROW_GROUP = 10_000
BUSY_SECONDS = 600.0  # while another run may write, as the table of a large fleet
COLUMNS = {column.name for column in fields(FlightRow)}
TABLES = Path(__file__).with_suffix(".sql").read_text(encoding="utf-8")
ENDED_FOR_GOOD = """
not (ended = 'source' or ended = 'error' and mavdem_version <> :mavdem or
     ended in ('time', 'memory', 'died') and (time_limit < :seconds or memory_limit < :megabytes))
"""
"""Whether another reading would end as the last one did."""

LOST = "log not in (select log from logs)"
"""Whether a row's log is there no more under any name."""

AssessRows = Callable[[FlightRows, FlightRows], FlightRows]
"""From all rows of one vehicle, and those of its baseline, to the same rows with their health."""


def is_fleet(folder: Path) -> bool:
    """Returns whether ``mavdem track`` has written there."""
    return (folder / STORE).is_file()


def read_rows(folder: Path) -> FlightRows:
    """Returns a fleet's rows by vehicle, file and axis; raises ``Unreadable``."""
    path = folder / STORE
    if not is_fleet(folder):
        raise Unreadable(Folder.NO_FLEET, path=folder)
    # SQLite's lock is a file beside it
    access = "mode=rw" if os.access(folder, os.W_OK) else "immutable=1"
    uri = f"{path.absolute().as_uri()}?{access}"
    try:
        with closing(sqlite3.connect(uri, timeout=BUSY_SECONDS, uri=True)) as db:
            stored = db.execute("select row, file from flights where file is not null")
            rows = [_row(*values) for values in stored]
    except sqlite3.Error as error:
        raise Unreadable(_damaged(path, error)) from None
    return sorted(rows, key=lambda row: row.order)


def _damaged(path: Path, error: Exception) -> Fact:
    return Fact(Folder.FLEET_DAMAGED, path=path, because=error)


def write_rows(folder: Path, rows: Iterable[FlightRow]) -> None:
    """Makes these rows, in their order, the fleet's table, which is replaced whole; raises ``OSError``.

    Without pyarrow there is none, and one of an earlier run, which is no longer true, goes.
    """
    if missing_modules("parquet"):
        return (folder / TABLE).unlink(missing_ok=True)
    import pyarrow
    from pyarrow import parquet

    (folder / TABLE).parent.mkdir(exist_ok=True)
    table = pyarrow.Table.from_pylist([asdict(row) for row in rows], row_schema())
    # Not beside the table: readers of all files in its folder would count what is unfinished.
    with atomic_write(folder / TABLE, folder) as file:
        parquet.write_table(table, file, row_group_size=ROW_GROUP, compression="zstd")
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def opened(folder: Path) -> Iterator[Store]:
    """Gives the store of a fleet's folder, which is made if it is not there; raises ``Unreadable``."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        store = Store(folder)
        with closing(store.db):
            yield store
    except (OSError, sqlite3.OperationalError) as error:
        full = Fact(Folder.FLEET_NOT_WRITTEN, path=folder, because=error_message(error))
        raise Unreadable(full) from None
    except sqlite3.DatabaseError as error:
        raise Unreadable(_damaged(folder / STORE, error)) from None


class Store:
    """The store of a fleet's ``folder``; errors are those of SQLite, which :func:`opened` explains.

    Attributes:
        db: its connection, of one thread.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.db = sqlite3.connect(folder / STORE, timeout=BUSY_SECONDS, isolation_level=None)
        self.db.row_factory = sqlite3.Row
        if self.db.execute("pragma journal_mode = wal").fetchone()[0] != "wal":
            raise sqlite3.OperationalError("SQLite's write-ahead log does not work on this disk")
        self.db.executescript(TABLES)
        (version,) = self.db.execute("pragma user_version").fetchone()
        if version != SCHEMA_VERSION:
            # What is known of a log stays, until it is read again for the other columns.
            self.db.executescript(
                f"""begin immediate; update logs set ended = 'source';
                pragma user_version = {SCHEMA_VERSION}; commit;"""
            )

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Makes its block all or nothing, while other runs wait; within another transaction a part of that."""
        if self.db.in_transaction:
            yield
            return
        with self.db:
            self.db.execute("begin immediate")
            yield

    def knows(self, source: LogSource, limits: JobLimits) -> bool:
        """Returns whether a log is as it was, and another reading would end as the last one did."""
        query = f"""select 1 from logs where path = :path and version = :version and version <> '' and
            :size in (-1, size) and {ENDED_FOR_GOOD}"""
        return self.db.execute(query, _values(source, limits)).fetchone() is not None

    def keys_to_try(self, source: LogSource, limits: JobLimits) -> Names:
        """Returns keys of known logs that this one may be a copy of."""
        query = f"select distinct key from logs where size = :size and key <> '' and {ENDED_FOR_GOOD} order by key"
        return tuple(key for (key,) in self.db.execute(query, _values(source, limits)))

    def keeps(self, source: LogSource, outcome: JobOutcome) -> bool:
        """Returns whether what it has of a log stays, as this outcome says nothing of the content.

        A source that cannot be reached now may be as it was; so may one that ended its reading, unless it has changed.
        """
        query = "select version from logs where path = ? and key <> ''"
        entry = None if outcome.key else self.db.execute(query, [as_text(source.path)]).fetchone()
        return entry is not None and (outcome.ended == "source" or source.version in ("", entry[0]))

    def add(self, source: LogSource, outcome: JobOutcome, limits: JobLimits) -> None:
        """Adds what was read of a log, with its pages, in place of what was known by its name and its content."""
        for name, html in outcome.pages.items():
            (self.folder / PAGES).mkdir(exist_ok=True)
            with atomic_write(self.folder / PAGES / name) as file:
                file.write(html.encode(errors="replace"))  # the name of a file need not be Unicode
        path = as_text(source.path)
        log = outcome.key or f"path:{path}"
        with self.transaction():
            query = "select max(tracked) from logs where path = ?"
            (tracked,) = self.db.execute(query, [path]).fetchone()
            if outcome.ended == "known":
                names = self.db.execute("select path from logs where log = ?", [log]).fetchall()
                self.db.execute(
                    """insert or replace into logs select ?, ?, size, key, log, ended, seconds, megabytes, time_limit,
                    memory_limit, mavdem_version, ? from logs where log = ? limit 1""",
                    [path, source.version, tracked, log],
                )
                gone = [name for name in names if not (is_url(name[0]) or os.path.lexists(name[0]))]
                self.db.executemany("delete from logs where path = ?", gone)
                return
            size = int(outcome.key.rpartition("-")[2]) if outcome.key else source.size
            entry = (
                path,
                source.version,
                size,
                outcome.key,
                log,
                outcome.ended,
                outcome.seconds,
                outcome.megabytes,
                limits.seconds,
                limits.megabytes,
                metadata.version("mavdem"),
                tracked,
            )
            places = ", ".join("?" * len(entry))
            self.db.execute(f"insert or replace into logs values ({places})", entry)
            self._delete_rows("log = ?", [log])
            rows = [(log, row.vehicle, json.dumps(row.as_dict())) for row in outcome.rows]
            self.db.executemany("insert into flights (log, vehicle, row) values (?, ?, ?)", rows)

    def remove(self, source: LogSource) -> None:
        """Removes what is known of a log by this name, and its rows where it has no other."""
        with self.transaction():
            self.db.execute("delete from logs where path = ?", [as_text(source.path)])
            self._delete_rows()

    def forget_lost_pages(self) -> None:
        """Has logs read again of whose flights a page is there no more."""
        pages = self.db.execute(
            """select distinct log, json_extract(iif(json_valid(row), row, '{}'), '$.page') as page from flights
            where page glob ?""",
            [f"{PAGES}/*"],
        )
        lost = [[log] for log, page in pages if not (self.folder / page).is_file()]
        self.db.executemany("update logs set ended = 'source' where log = ?", lost)

    def track(self, sources: Iterable[LogSource]) -> None:
        """Puts the flights of these logs, as far as they are known, into the table."""
        with self.transaction():
            paths = [(as_text(source.path),) for source in sources]
            self.db.executemany("update logs set tracked = 1 where path = ?", paths)

    def rows(self, query: str) -> Iterator[FlightRow]:
        """Yields the rows that a ``query`` for row and, in the table, file finds."""
        return (_row(*row) for row in self.db.execute(query))

    def sound_rows(self, query: str, values: Sequence[Any] = ()) -> Iterator[FlightRow]:
        """Yields them without those that are damaged, which keep back no others."""
        for row in self.db.execute(query, values):
            with suppress(sqlite3.DatabaseError):
                yield _row(*row)

    def rows_of(self, sources: Iterable[LogSource]) -> FlightRows:
        """Returns the rows of these logs, without those that are damaged."""
        query = """select row, path from flights join logs using (log)
        where path in (select value from json_each(?)) order by flights.rowid"""
        paths = json.dumps([as_text(source.path) for source in sources])
        return [*self.sound_rows(query, [paths])]

    @property
    def healthy(self) -> FlightRows:
        """The rows of the baseline; none if there is none."""
        return [*self.rows("select row from healthy order by row")]

    @healthy.setter
    def healthy(self, rows: Iterable[FlightRow]) -> None:
        with self.transaction():
            self.db.execute("delete from healthy")
            self.db.executemany(
                "insert into healthy values (?)", [(json.dumps(row.as_dict()),) for row in rows]
            )

    def publish(self, assess: AssessRows) -> None:
        """Judges vehicles of which anything is new, or whose baseline is, and writes the table if it changes."""
        healthy = self.healthy
        baseline = hashlib.sha256(repr(healthy).encode()).hexdigest()
        with self.transaction():
            before = self.db.total_changes
            self._name_rows()
            query = "select distinct vehicle from flights where file is not null and judged is not ? order by vehicle"
            for (vehicle,) in self.db.execute(query, [baseline]).fetchall():
                query = """select rowid, row, file from flights where vehicle = ? and file is not null
                    order by file, log, rowid"""
                numbers, *columns = zip(*self.db.execute(query, [vehicle]), strict=True)
                rows = [*map(_row, *columns)]
                own = [row for row in healthy if row.vehicle == vehicle]
                judged = _assessed(rows, assess, own)
                for new, at in zip(judged, numbers, strict=True):
                    self.db.execute(
                        "update flights set row = ?, judged = ? where rowid = ?",
                        [json.dumps(new.as_dict()), baseline, at],
                    )
            if self.db.total_changes > before or not (self.folder / TABLE).is_file():
                self.db.execute("insert into unpublished values (null)")
        folder = os.open(self.folder, os.O_RDONLY)
        try:
            # One after the other: of two runs that end together the later one has all rows. Others can go on.
            fcntl.flock(folder, fcntl.LOCK_EX)
            self._write_table()
        finally:
            os.close(folder)

    def _write_table(self) -> None:
        """Writes the table as the rows are now, if it is not so."""
        with self.db:
            self.db.execute("begin")
            (change,) = self.db.execute("select max(change) from unpublished").fetchone()
            if change is None:
                return
            query = "select row, file from flights where file is not null order by vehicle, file, log, rowid"
            write_rows(self.folder, self.rows(query))
        self.db.execute("delete from unpublished where change <= ?", [change])

    def _name_rows(self) -> None:
        """Names rows by their log's first name, drops those of logs that are there no more under any name."""
        self._delete_rows()
        self.db.execute(
            """update flights set file = name, judged = null from
            (select log as known, min(path) as name from logs where tracked group by log)
            where log = known and file is not name"""
        )

    def _delete_rows(self, where: str = LOST, values: Sequence[Any] = ()) -> None:
        vehicles = f"select vehicle from flights where {where}"
        self.db.execute(f"update flights set judged = null where vehicle in ({vehicles})", values)
        self.db.execute(f"delete from flights where {where}", values)


def _assessed(rows: FlightRows, assess: AssessRows, healthy: FlightRows) -> FlightRows:
    try:
        return assess(rows, healthy)
    except Exception as error:  # of mavdem on one vehicle's figures: it keeps back no other's
        why = Fact(HealthUnknown.HEALTH_FAILED, because=f"{type(error).__name__}: {error}")
        return [replace(row, health_reason=str(why), health_code=why.code) for row in rows]


def _values(source: LogSource, limits: JobLimits) -> JsonValues:
    return {
        **source._asdict(),
        **limits._asdict(),
        "path": as_text(source.path),
        "mavdem": metadata.version("mavdem"),
    }


def _row(text: str, file: str | None = None) -> FlightRow:
    """A row of the store; raises ``DatabaseError`` where what stands there is none."""
    try:
        values = {name: value for name, value in json.loads(text).items() if name in COLUMNS}
        return FlightRow(**(values if file is None else values | {"file": file}))
    except (AttributeError, TypeError, ValueError, RecursionError) as error:
        raise sqlite3.DatabaseError(error) from error
