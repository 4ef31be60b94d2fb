"""The store of a fleet, one SQLite file: which logs were read and the rows of each; and the table made of them.

``FLEET/fleet.sqlite`` is written one log at a time, each in a transaction of its own: a run may be killed at any
moment, and two runs may write side by side, a server among them, whose library (``mavdem.serve.library``) is in the
same file. At the end of a run ``FLEET/flights/flights.parquet`` is written from it as a whole, for DuckDB, Polars and
pandas, where pyarrow is installed.
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
from mavdem.fleet.row import SCHEMA_VERSION, FlightRow, FlightRows, row_schema, utf8_text
from mavdem.fleet.sources import UNKNOWN_SIZE, LogSource, is_url
from mavdem.fleet.workers import PAGES, JobLimits, JobOutcome

STORE = "fleet.sqlite"
"""Name of the store in the folder of a fleet."""

TABLE = Path("flights", "flights.parquet")
"""Path of the table in the folder of a fleet."""

ROWS_PER_GROUP = 10_000
"""Rows of a group in the Parquet file. Readers that look for a vehicle skip whole groups, by the least and the greatest
name in each."""

BUSY_SECONDS = 600.0
"""s for which a run waits while another one writes, such as the table of a large fleet."""

COLUMNS = {column.name for column in fields(FlightRow)}
"""Names of the columns of this version."""

TABLES_SQL = Path(__file__).with_suffix(".sql").read_text(encoding="utf-8")
"""The SQL that makes the tables of the store."""

IS_FINAL_SQL = """
not (ended = 'source' or ended = 'error' and mavdem_version <> :mavdem or
     ended in ('time', 'memory', 'died') and (time_limit < :seconds or memory_limit < :megabytes))
"""
"""SQL: whether another reading of a log would end as the last one did. It may not after an unreachable source, an error
of another version of mavdem, or lower limits of time and memory."""

IS_LOST_SQL = "log not in (select log from logs)"
"""SQL: whether the log of a row no longer exists under any name."""

AssessRows = Callable[[FlightRows, FlightRows], FlightRows]
"""A function of all rows of one vehicle, and the rows of its baseline; it returns the same rows with their health."""


def is_fleet(folder: Path) -> bool:
    """Returns whether a folder has a store, which ``mavdem track`` has written."""
    return (folder / STORE).is_file()


def read_rows(folder: Path) -> FlightRows:
    """Returns the rows of a fleet, by vehicle, file and axis.

    Raises:
        Unreadable: the folder has no store, or a damaged one.
    """
    path = folder / STORE
    if not is_fleet(folder):
        raise Unreadable(Folder.NO_FLEET, path=folder)
    # SQLite writes its lock beside the store, which it cannot in a folder that is not writable.
    access = "mode=rw" if os.access(folder, os.W_OK) else "immutable=1"
    uri = f"{path.absolute().as_uri()}?{access}"
    try:
        with closing(sqlite3.connect(uri, timeout=BUSY_SECONDS, uri=True)) as db:
            stored_rows = db.execute("select row, file from flights where file is not null")
            rows = [row_of_json(text, file) for text, file in stored_rows]
    except sqlite3.Error as error:
        raise Unreadable(_damage(path, error)) from None
    return sorted(rows, key=lambda row: row.order)


def _damage(path: Path, error: Exception) -> Fact:
    """Returns the fact that a store is damaged."""
    return Fact(Folder.FLEET_DAMAGED, path=path, because=error)


def write_rows(folder: Path, rows: Iterable[FlightRow]) -> None:
    """Writes the table of a fleet from ``rows``, in their order, in place of an earlier one.

    Without pyarrow no table is written, and an earlier one is removed, since it is no longer true.

    Raises:
        OSError: the table cannot be written.
    """
    path = folder / TABLE
    if missing_modules("parquet"):
        path.unlink(missing_ok=True)
        return
    import pyarrow
    from pyarrow import parquet

    path.parent.mkdir(exist_ok=True)
    table = pyarrow.Table.from_pylist([asdict(row) for row in rows], row_schema())
    # The unfinished file is in the fleet's folder: readers of all files beside the table would read it, too.
    with atomic_write(path, folder) as file:
        parquet.write_table(table, file, row_group_size=ROWS_PER_GROUP, compression="zstd")
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def open_store(folder: Path) -> Iterator[Store]:
    """Opens the store of a fleet's folder, both of which are made if they do not exist.

    Raises:
        Unreadable: the store cannot be written, or is damaged.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        store = Store(folder)
        with closing(store.db):
            yield store
    except (OSError, sqlite3.OperationalError) as error:
        not_written = Fact(Folder.FLEET_NOT_WRITTEN, path=folder, because=error_message(error))
        raise Unreadable(not_written) from None
    except sqlite3.DatabaseError as error:
        raise Unreadable(_damage(folder / STORE, error)) from None


class Store:
    """The open store of a fleet. Its methods raise the errors of SQLite, which :func:`open_store` explains.

    Attributes:
        folder: of the fleet.
        db: the connection, which belongs to one thread.
    """

    def __init__(self, folder: Path) -> None:
        """Opens or makes the store; where its columns are of another version, all logs are to be read again.

        The write-ahead log lets others read while one writes. SQLite's ``user_version`` holds the version of the
        columns.

        Args:
            folder: folder of the fleet, which exists.

        Raises:
            sqlite3.OperationalError: the file cannot be opened, or the disk does not support a write-ahead log.
        """
        self.folder = folder
        self.db = sqlite3.connect(folder / STORE, timeout=BUSY_SECONDS, isolation_level=None)
        self.db.row_factory = sqlite3.Row
        if self.db.execute("pragma journal_mode = wal").fetchone()[0] != "wal":
            raise sqlite3.OperationalError("SQLite's write-ahead log does not work on this disk")
        self.db.executescript(TABLES_SQL)
        (version,) = self.db.execute("pragma user_version").fetchone()
        if version != SCHEMA_VERSION:
            # The rows stay until their log is read again.
            self.db.executescript(
                f"""begin immediate; update logs set ended = 'source';
                pragma user_version = {SCHEMA_VERSION}; commit;"""
            )

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Makes all changes of its block, or none, while other runs wait; inside another transaction, as part of it."""
        if self.db.in_transaction:
            yield
            return
        with self.db:
            self.db.execute("begin immediate")
            yield

    def has_read(self, source: LogSource, limits: JobLimits) -> bool:
        """Returns whether a log need not be read: it is unchanged, and another reading would end as the last one did.

        A log without a version, such as a pipe, always counts as changed.
        """
        query = f"""select 1 from logs where path = :path and version = :version and version <> '' and
            :size in ({UNKNOWN_SIZE}, size) and {IS_FINAL_SQL}"""
        return self.db.execute(query, _query_values(source, limits)).fetchone() is not None

    def keys_of_size(self, source: LogSource, limits: JobLimits) -> Names:
        """Returns the keys of known logs of the same size, of which a log may be a copy that need not be read."""
        query = f"""select distinct key from logs where size = :size and key <> '' and {IS_FINAL_SQL}
            order by key"""
        return tuple(key for (key,) in self.db.execute(query, _query_values(source, limits)))

    def earlier_reading_holds(self, source: LogSource, outcome: JobOutcome) -> bool:
        """Returns whether the earlier reading of a log stays valid after an outcome without its content.

        That a source cannot be reached now says nothing of its content. Where the reading ended otherwise before the
        content was known, the earlier reading holds unless the source has changed.
        """
        if outcome.key:
            return False
        query = "select version from logs where path = ? and key <> ''"
        entry = self.db.execute(query, [utf8_text(source.path)]).fetchone()
        if entry is None:
            return False
        (version,) = entry
        return outcome.ended == "source" or source.version in ("", version)

    def add(self, source: LogSource, outcome: JobOutcome, limits: JobLimits) -> None:
        """Adds the outcome of a log, with its pages, in place of what the store had by its name and by its content.

        The table ``logs`` has an entry for each name of a log; the rows of flights belong to the content, which several
        names may share. A log whose content was known by another name becomes a further name of that content.

        Args:
            source: name, size and version of the log.
            outcome: what came of reading it.
            limits: the limits within which it was read; with higher ones it may be read again.
        """
        self._write_pages(outcome)
        path = utf8_text(source.path)
        # Without a key the content was not reached; then the path stands for it.
        content = outcome.key or f"path:{path}"
        with self.transaction():
            # Whether the log is among those of the fleet's table stays as it was.
            query = "select max(tracked) from logs where path = ?"
            (tracked,) = self.db.execute(query, [path]).fetchone()
            if outcome.ended == "known":
                self._add_name(path, source.version, tracked, content)
                return
            # A key ends in the size of the content.
            size = int(outcome.key.rpartition("-")[2]) if outcome.key else source.size
            entry = (
                path,
                source.version,
                size,
                outcome.key,
                content,
                outcome.ended,
                outcome.seconds,
                outcome.megabytes,
                limits.seconds,
                limits.megabytes,
                metadata.version("mavdem"),
                tracked,
            )
            parameters = ", ".join("?" * len(entry))
            self.db.execute(f"insert or replace into logs values ({parameters})", entry)
            self._delete_rows("log = ?", [content])
            rows = [(content, row.vehicle, json.dumps(row.as_dict())) for row in outcome.rows]
            self.db.executemany("insert into flights (log, vehicle, row) values (?, ?, ?)", rows)

    def _write_pages(self, outcome: JobOutcome) -> None:
        """Writes the pages of an outcome into the folder of the fleet."""
        for name, html in outcome.pages.items():
            (self.folder / PAGES).mkdir(exist_ok=True)
            with atomic_write(self.folder / PAGES / name) as file:
                # The name of a file, which a page shows, need not be Unicode.
                file.write(html.encode(errors="replace"))

    def _add_name(self, path: str, version: str, tracked: int | None, content: str) -> None:
        """Adds a name of a log whose content is known, and removes those of its names that no longer exist.

        The new entry is a copy of another one of the same content, so that it says how the reading ended. A file that
        was moved is thus known by its new path without being read again.

        Args:
            path: the new name.
            version: version of the file, which changes with its content.
            tracked: whether the log is in the table of the fleet.
            content: key of the content.
        """
        known_paths = self.db.execute("select path from logs where log = ?", [content]).fetchall()
        self.db.execute(
            """insert or replace into logs select ?, ?, size, key, log, ended, seconds, megabytes, time_limit,
            memory_limit, mavdem_version, ? from logs where log = ? limit 1""",
            [path, version, tracked, content],
        )
        for (known_path,) in known_paths:
            if not is_url(known_path) and not os.path.lexists(known_path):
                self.db.execute("delete from logs where path = ?", [known_path])

    def remove(self, source: LogSource) -> None:
        """Removes a log by its name, and its rows where the log has no other name."""
        with self.transaction():
            self.db.execute("delete from logs where path = ?", [utf8_text(source.path)])
            self._delete_rows()

    def reread_logs_without_page(self) -> None:
        """Marks the logs to be read again whose pages are incomplete: one that a row of theirs names does not exist.

        A page is the HTML file of a flight. A log whose column ``ended`` is "source" is read again like one whose file
        could not be opened.
        """
        # A row is the JSON text of a flight; one that is damaged counts as a row without a page.
        pages = self.db.execute(
            """select distinct log, json_extract(iif(json_valid(row), row, '{}'), '$.page') as page from flights
            where page glob ?""",
            [f"{PAGES}/*"],
        )
        contents = [[content] for content, page in pages if not (self.folder / page).is_file()]
        self.db.executemany("update logs set ended = 'source' where log = ?", contents)

    def track(self, sources: Iterable[LogSource]) -> None:
        """Marks logs as tracked, as far as the store has them: the fleet's table shows the flights of these only."""
        with self.transaction():
            paths = [(utf8_text(source.path),) for source in sources]
            self.db.executemany("update logs set tracked = 1 where path = ?", paths)

    def rows(self, query: str) -> Iterator[FlightRow]:
        """Yields the rows that a query finds.

        Args:
            query: SQL that selects ``row``, or ``row`` and the name of the log in the table.

        Raises:
            sqlite3.DatabaseError: a row is damaged.
        """
        return (row_of_json(*values) for values in self.db.execute(query))

    def sound_rows(self, query: str, values: Sequence[Any] = ()) -> Iterator[FlightRow]:
        """Yields the rows that a query with ``values`` finds, as :meth:`rows` does, without those that are damaged."""
        for columns in self.db.execute(query, values):
            with suppress(sqlite3.DatabaseError):
                yield row_of_json(*columns)

    def rows_of(self, sources: Iterable[LogSource]) -> FlightRows:
        """Returns the rows of these logs, without those that are damaged."""
        query = """select row, path from flights join logs using (log)
        where path in (select value from json_each(?)) order by flights.rowid"""
        paths = json.dumps([utf8_text(source.path) for source in sources])
        return list(self.sound_rows(query, [paths]))

    @property
    def healthy(self) -> FlightRows:
        """The rows of the baseline, the healthy flights that others are compared with; empty if there is none."""
        return list(self.rows("select row from healthy order by row"))

    @healthy.setter
    def healthy(self, rows: Iterable[FlightRow]) -> None:
        with self.transaction():
            self.db.execute("delete from healthy")
            texts = [(json.dumps(row.as_dict()),) for row in rows]
            self.db.executemany("insert into healthy values (?)", texts)

    def publish(self, assess: AssessRows) -> None:
        """Judges the vehicles of which anything is new, or whose baseline is, and writes the table if it changed.

        Rows are marked with the hash of the baseline by which they were judged; those with another mark, or none, are
        to be judged again. A change is noted in the table ``unpublished`` within the same transaction, so that a run
        that is killed before it writes the Parquet file leaves this to the next one.

        Args:
            assess: judges all rows of a vehicle.
        """
        healthy = self.healthy
        baseline = hashlib.sha256(repr(healthy).encode()).hexdigest()
        with self.transaction():
            changes_before = self.db.total_changes
            self._update_names()
            query = """select distinct vehicle from flights where file is not null and judged is not ?
                order by vehicle"""
            for (vehicle,) in self.db.execute(query, [baseline]).fetchall():
                healthy_rows = [row for row in healthy if row.vehicle == vehicle]
                self._judge_vehicle(vehicle, assess, healthy_rows, baseline)
            has_changed = self.db.total_changes > changes_before
            if has_changed or not (self.folder / TABLE).is_file():
                self.db.execute("insert into unpublished values (null)")
        folder = os.open(self.folder, os.O_RDONLY)
        try:
            # Two runs that end together write one after the other, so that the later one has all rows. Other runs can
            # go on meanwhile.
            fcntl.flock(folder, fcntl.LOCK_EX)
            self._write_table()
        finally:
            os.close(folder)

    def _judge_vehicle(
        self, vehicle: str, assess: AssessRows, healthy_rows: FlightRows, baseline: str
    ) -> None:
        """Judges the health of one vehicle anew from all its flights in the table, and stores the result in its rows.

        All flights are judged together: a motor is compared with itself in the flights before.

        Args:
            vehicle: its name.
            assess: judges the rows.
            healthy_rows: those of its baseline.
            baseline: hash of the whole baseline, which marks the rows as judged with it.
        """
        query = """select rowid, row, file from flights where vehicle = ? and file is not null
            order by file, log, rowid"""
        row_ids = []
        rows = []
        for row_id, text, file in self.db.execute(query, [vehicle]):
            row_ids.append(row_id)
            rows.append(row_of_json(text, file))
        judged_rows = assess_safely(rows, assess, healthy_rows)
        for row, row_id in zip(judged_rows, row_ids, strict=True):
            self.db.execute(
                "update flights set row = ?, judged = ? where rowid = ?",
                [json.dumps(row.as_dict()), baseline, row_id],
            )

    def _write_table(self) -> None:
        """Writes the table file from the rows as they are now, unless it is up to date.

        The table ``unpublished`` has a number for each change since the file was written. Those up to the last number
        that is read together with the rows are deleted afterwards; later ones stay for the next run.
        """
        with self.db:
            self.db.execute("begin")
            (last_change,) = self.db.execute("select max(change) from unpublished").fetchone()
            if last_change is None:
                return
            query = """select row, file from flights where file is not null
                order by vehicle, file, log, rowid"""
            write_rows(self.folder, self.rows(query))
        self.db.execute("delete from unpublished where change <= ?", [last_change])

    def _update_names(self) -> None:
        """Gives each row the first name of its log, and deletes the rows of logs that have no name any more."""
        self._delete_rows()
        self.db.execute(
            """update flights set file = name, judged = null from
            (select log as known, min(path) as name from logs where tracked group by log)
            where log = known and file is not name"""
        )

    def _delete_rows(self, condition: str = IS_LOST_SQL, values: Sequence[Any] = ()) -> None:
        """Deletes the rows that meet an SQL condition; their vehicles are to be judged again.

        The health of a vehicle's motors is judged from all its flights together, so that the rows that stay are no
        longer right. They are marked by an empty column ``judged``.

        Args:
            condition: SQL; by default that the log of a row no longer exists under any name.
            values: Values of the question marks in it.
        """
        vehicles = f"select vehicle from flights where {condition}"
        self.db.execute(f"update flights set judged = null where vehicle in ({vehicles})", values)
        self.db.execute(f"delete from flights where {condition}", values)


def assess_safely(rows: FlightRows, assess: AssessRows, healthy_rows: FlightRows) -> FlightRows:
    """Judges the rows of one vehicle; where that fails their ``health_reason`` says so, and other vehicles go on."""
    try:
        return assess(rows, healthy_rows)
    except Exception as error:
        reason = Fact(HealthUnknown.HEALTH_FAILED, because=f"{type(error).__name__}: {error}")
        return [replace(row, health_reason=str(reason), health_code=reason.code) for row in rows]


def _query_values(source: LogSource, limits: JobLimits) -> JsonValues:
    """Returns the values of the named parameters in queries for a log."""
    return {
        **source._asdict(),
        **limits._asdict(),
        "path": utf8_text(source.path),
        "mavdem": metadata.version("mavdem"),
    }


def row_of_json(text: str, file: str | None = None) -> FlightRow:
    """Returns a row of the store. Columns of other versions are left out.

    Args:
        text: the row as JSON.
        file: the name of its log in the table; that of the JSON unless given.

    Raises:
        sqlite3.DatabaseError: the text is no row.
    """
    try:
        values = {name: value for name, value in json.loads(text).items() if name in COLUMNS}
        if file is not None:
            values["file"] = file
        return FlightRow(**values)
    except (AttributeError, TypeError, ValueError, RecursionError) as error:
        raise sqlite3.DatabaseError(error) from error
