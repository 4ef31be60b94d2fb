"""Store of a fleet, one SQLite file: the logs that were read, how each reading ended, and the rows of each log.

``FLEET/fleet.sqlite`` is written one log at a time, each in a transaction of its own: a run may be killed at any
moment, and two runs may write side by side, a server among them, whose library (``mavdem.serve.library``) is in the
same file. Vehicles are judged (``mavdem.fleet.judgement``) and the table is written (``mavdem.fleet.table_files``) at
the end of a run.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from importlib import metadata
from pathlib import Path
from typing import Any

from mavdem.containers import JsonValues, Names
from mavdem.errors import Unreadable, error_message
from mavdem.facts import Fact
from mavdem.facts.fleet import FleetFolderFact
from mavdem.files import atomic_write
from mavdem.fleet.assigned_vehicles import rows_with_assigned_vehicles
from mavdem.fleet.row import SCHEMA_VERSION, FlightRow, FlightRows, utf8_text
from mavdem.fleet.sources import UNKNOWN_SIZE, LogSource, is_url
from mavdem.fleet.stored_rows import (
    BUSY_SECONDS,
    STORE,
    brief_json,
    damage_of_store,
    has_brief_rows,
    row_of_json,
)
from mavdem.fleet.workers import PAGES, JobLimits, JobOutcome

TABLES_SQL = Path(__file__).with_suffix(".sql").read_text(encoding="utf-8")
"""The SQL that makes the tables of the store."""

OF_MISSING_PACKAGE_SQL = """
exists (select 1 from flights where flights.log = logs.log and instr(row, '(MissingExtra'))
"""
"""SQL: whether a log was not read for a missing package, which earlier versions called an error of mavdem's own. Their
rows say so in their status only."""

WOULD_END_ALIKE_SQL = f"""
not (ended = 'source' or
     ended = 'error' and (mavdem_version <> :mavdem or {OF_MISSING_PACKAGE_SQL}) or
     ended in ('time', 'memory', 'died') and (time_limit < :seconds or memory_limit < :megabytes))
"""
"""SQL: whether another reading of a log would end as the last one did. It may not after an unreachable source, a
missing package, an error of another version of mavdem, or lower limits of time and memory."""

IS_LOST_SQL = "log not in (select log from logs)"
"""SQL: whether the log of a row no longer exists under any name."""


@contextmanager
def open_store(folder: Path) -> Iterator[Store]:
    """Opens the store of a fleet's folder for a block, and creates folder and store if they do not exist.

    Args:
        folder: folder of the fleet, with its SQLite store, its table and its pages.

    Yields:
        The open store.

    Raises:
        Unreadable: the store cannot be written, or is damaged.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        store = Store(folder)
        with closing(store.db):
            yield store
    except (OSError, sqlite3.OperationalError) as error:
        not_written = Fact(
            FleetFolderFact.FLEET_NOT_WRITTEN, path=folder, reason=error_message(error)
        )
        raise Unreadable(not_written) from None
    except sqlite3.DatabaseError as error:
        raise Unreadable(damage_of_store(folder / STORE, error)) from None


class Store:
    """The open store of a fleet. Its methods raise the errors of SQLite, which :func:`open_store` explains.

    Attributes:
        folder: folder of the fleet.
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
        self._add_brief_rows()
        self.db.execute("create index if not exists flights_by_page on flights (log, page)")
        (version,) = self.db.execute("pragma user_version").fetchone()
        if version != SCHEMA_VERSION:
            # The rows stay until their log is read again, and the table is written again as a whole.
            self.db.executescript(
                f"""begin immediate; update logs set ended = 'source';
                insert into unpublished (vehicle) values (null);
                pragma user_version = {SCHEMA_VERSION}; commit;"""
            )

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Opens an SQL transaction for the block of a ``with`` statement: all changes of the block are made, or none.

        Other runs that write to the store wait meanwhile. Within another transaction it does nothing: the changes then
        belong to the outer one.
        """
        if self.db.in_transaction:
            yield
            return
        with self.db:
            self.db.execute("begin immediate")
            yield

    def _add_brief_rows(self) -> None:
        """Upgrades the store of an earlier version, whose table has no columns with brief rows and pages of flights.

        A brief row has only the columns that a page of the fleet shows, and is read faster.
        """
        if has_brief_rows(self.db):
            return
        with self.transaction():
            # Another run may have added them while this one waited.
            if has_brief_rows(self.db):
                return
            self.db.execute("alter table flights add column brief text")
            self.db.execute("alter table flights add column page text")
            self.db.execute("alter table unpublished add column vehicle text")
            query = "select rowid, row, coalesce(file, '') from flights"
            for row_id, row_json, file in self.db.execute(query).fetchall():
                # A damaged row is reported where it is used.
                with suppress(sqlite3.DatabaseError):
                    row = row_of_json(row_json, file)
                    self.db.execute(
                        "update flights set brief = ?, page = ? where rowid = ?",
                        [brief_json(row), row.page, row_id],
                    )

    def has_read(self, source: LogSource, limits: JobLimits) -> bool:
        """Returns whether a log need not be read again: it is unchanged, and another reading would end as the last did.

        A log without a version, such as a pipe, always counts as changed. A reading that failed may succeed now, for
        example with higher limits; the condition ``WOULD_END_ALIKE_SQL`` excludes such logs.

        Args:
            source: the log, with its version, such as the time of its last change.
            limits: time and memory that its reading may take.
        """
        query = f"""select 1 from logs where path = :path and version = :version and version <> '' and
            :size in ({UNKNOWN_SIZE}, size) and {WOULD_END_ALIKE_SQL}"""
        entry_of_unchanged_log = self.db.execute(query, _query_values(source, limits)).fetchone()
        return entry_of_unchanged_log is not None

    def keys_of_size(self, source: LogSource, limits: JobLimits) -> Names:
        """Returns the content hashes of stored logs of the same size: a log may be a copy of one of them.

        The process that opens the log compares its hash with these: a copy of a stored log need not be read again.

        Args:
            source: the log, with its size in bytes.
            limits: time and memory that its reading may take.

        Returns:
            The hashes in alphabetical order, without those of logs whose reading failed and may succeed now.
        """
        query = f"""select distinct key from logs where size = :size and key <> '' and {WOULD_END_ALIKE_SQL}
            order by key"""
        key_rows = self.db.execute(query, _query_values(source, limits))
        return tuple(key for (key,) in key_rows)

    def are_stored_rows_valid(self, source: LogSource, outcome: JobOutcome) -> bool:
        """Returns whether the stored rows of a log stay valid after another attempt to read it.

        They are replaced if the attempt got the content of the log, or if there are none yet. Otherwise they stay in
        two cases: the log could not be reached, since it may still have the same content; or it is unchanged, as its
        version shows, and the attempt failed for another reason, such as too little memory.

        Args:
            source: the log, with its present version, such as the time of its last change; the version is empty if it
                is not known.
            outcome: outcome of the attempt; its ``key`` is the hash of the content, or empty if that was not reached.
        """
        got_content = bool(outcome.key)
        if got_content:
            return False
        query = "select version from logs where path = ? and key <> ''"
        stored_log = self.db.execute(query, [utf8_text(source.path)]).fetchone()
        if stored_log is None:
            return False
        (stored_version,) = stored_log
        # "source" is the ``JobEnding`` of a log that could not be reached.
        is_unreachable = outcome.ended == "source"
        # A log whose version is not known counts as unchanged.
        is_unchanged = source.version in ("", stored_version)
        return is_unreachable or is_unchanged

    def add(self, source: LogSource, outcome: JobOutcome, limits: JobLimits) -> None:
        """Adds the outcome of a log, with its pages, in place of what the store had by its name and by its content.

        The table ``logs`` has an entry for each name of a log; the rows of flights belong to the content, which several
        names may share. A log whose content was known by another name becomes a further name of that content.

        Args:
            source: name, size and version of the log.
            outcome: outcome of reading it.
            limits: the limits within which it was read; with higher ones it may be read again.
        """
        self._write_pages(outcome)
        path = utf8_text(source.path)
        # Without a key the content was not reached; then the path stands for it.
        content = outcome.key or f"path:{path}"
        with self.transaction():
            # Whether the log is among those of the fleet's table stays as it was.
            query = "select max(tracked) from logs where path = ?"
            (is_tracked,) = self.db.execute(query, [path]).fetchone()
            if outcome.ended == "known":
                self._add_path(path, source.version, is_tracked, content)
                return
            # A key ends in the size of the content.
            size = int(outcome.key.rpartition("-")[2]) if outcome.key else source.size
            entry = {
                "path": path,
                "version": source.version,
                "size": size,
                "key": outcome.key,
                "log": content,
                "ended": outcome.ended,
                "seconds": outcome.seconds,
                "megabytes": outcome.megabytes,
                "time_limit": limits.seconds,
                "memory_limit": limits.megabytes,
                "mavdem_version": metadata.version("mavdem"),
                "tracked": is_tracked,
            }
            columns = ", ".join(entry)
            placeholders = ", ".join(f":{column}" for column in entry)
            self.db.execute(
                f"insert or replace into logs ({columns}) values ({placeholders})", entry
            )
            self._delete_rows("log = ?", [content])
            for row in rows_with_assigned_vehicles(self.db, outcome.rows):
                values = [
                    content,
                    row.vehicle,
                    json.dumps(row.as_dict()),
                    brief_json(row),
                    row.page,
                ]
                self.db.execute(
                    "insert into flights (log, vehicle, row, brief, page) values (?, ?, ?, ?, ?)",
                    values,
                )

    def _write_pages(self, outcome: JobOutcome) -> None:
        """Writes the pages of the flights of one log into the folder of the fleet.

        Args:
            outcome: what a worker process returned for the log, with the HTML of each page by the name of its file.
        """
        for name, html in outcome.pages.items():
            (self.folder / PAGES).mkdir(exist_ok=True)
            with atomic_write(self.folder / PAGES / name) as file:
                # The name of a file, which a page shows, need not be Unicode.
                file.write(html.encode(errors="replace"))

    def _add_path(self, path: str, version: str, tracked: int | None, content: str) -> None:
        """Adds a path of a log whose content is in the store, and removes paths of that content that no longer exist.

        The new entry is a copy of another one of the same content, including how the reading ended. So a file that was
        moved is known by its new path without being read again.

        Args:
            path: new path of the log.
            version: version of the file, which changes with its content.
            tracked: 1 if the log is in the table of the fleet; None otherwise.
            content: key of the content of the log.
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
        """Marks the logs whose flights lack their page, an HTML file that somebody has deleted, to be read again.

        The column ``ended`` says how the last reading of a log ended. The logs get the value "source" there, as if
        their file could not have been opened, so that the next run reads them.
        """
        existing_pages = set()
        if (self.folder / PAGES).is_dir():
            existing_pages = {f"{PAGES}/{name}" for name in os.listdir(self.folder / PAGES)}
        query = "select distinct log, page from flights where page is not null"
        logs_without_page = []
        for log_key, page in self.db.execute(query):
            if page not in existing_pages:
                logs_without_page.append([log_key])
        self.db.executemany("update logs set ended = 'source' where log = ?", logs_without_page)

    def track(self, sources: Iterable[LogSource]) -> None:
        """Marks logs as tracked, as far as the store has them: the fleet's table shows the flights of these only."""
        with self.transaction():
            paths = [(utf8_text(source.path),) for source in sources]
            self.db.executemany("update logs set tracked = 1 where path = ?", paths)

    def copies(self) -> list[Names]:
        """Returns the paths of each tracked log that several files hold, as in [("/logs/a.ulg", "/logs/copy.ulg")]."""
        query = """select json_group_array(path) from logs where tracked and key <> '' group by key
            having count(*) > 1 order by min(path)"""
        return [tuple(sorted(json.loads(paths))) for (paths,) in self.db.execute(query)]

    def rows(self, query: str) -> Iterator[FlightRow]:
        """Yields the rows of the fleet's table that a query selects: figures of one flight on one axis each.

        Args:
            query: SQL that selects ``row``, the row as JSON, or ``row`` and the present name of the log's file.

        Raises:
            sqlite3.DatabaseError: a row is damaged.
        """
        selected_columns = self.db.execute(query)
        return (row_of_json(*columns) for columns in selected_columns)

    def sound_rows(self, query: str, values: Sequence[Any] = ()) -> Iterator[FlightRow]:
        """Yields the rows of the fleet's table that a query finds, without rows whose stored text is damaged.

        Args:
            query: SQL query, whose columns are what :func:`row_of_json` takes.
            values: values of the placeholders in the query.
        """
        for columns in self.db.execute(query, values):
            with suppress(sqlite3.DatabaseError):
                yield row_of_json(*columns)

    def rows_of(self, sources: Iterable[LogSource]) -> FlightRows:
        """Returns the rows of some logs, in the order in which they were stored, without damaged rows.

        Args:
            sources: the logs, by whose paths the rows are selected.
        """
        return self._rows_of("row", sources)

    def brief_rows_of(self, sources: Iterable[LogSource]) -> FlightRows:
        """Returns the rows of some logs with ``BRIEF_COLUMNS`` alone, which takes a quarter of the time of whole rows.

        Args:
            sources: the logs, by whose paths the rows are selected.
        """
        return self._rows_of("brief", sources)

    def _rows_of(self, column: str, sources: Iterable[LogSource]) -> FlightRows:
        """Returns the rows of some logs, in the order in which they were stored.

        Args:
            column: column of the table of flights: "row", or "brief" for rows without what only pages of flights need.
            sources: the logs, by whose paths the rows are selected.
        """
        query = f"""select {column}, path from flights join logs using (log)
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

    def update_names(self) -> None:
        """Updates the path of the log in each row of the table, and deletes the rows of logs that no longer exist.

        A log may have several paths, for example if it was copied: the first one in alphabetical order is stated. Only
        logs in the table of the fleet count (column ``tracked``). The text of a row names its file, and is written when
        the vehicle is judged. So rows whose path changes are marked to be judged again, by an empty column ``judged``.
        """
        # The rows of logs without a path.
        self._delete_rows()
        # "is not" also holds where a row has no file yet, where "<>" would give null.
        self.db.execute(
            """update flights set file = first_path, judged = null from
            (select log as tracked_log, min(path) as first_path from logs where tracked group by log)
            where log = tracked_log and file is not first_path"""
        )

    def _delete_rows(self, condition: str = IS_LOST_SQL, values: Sequence[Any] = ()) -> None:
        """Deletes the rows that meet an SQL condition; their vehicles are to be judged again.

        The health of a vehicle's motors is judged from all its flights together, so that the rows that stay are no
        longer right. They are marked by an empty column ``judged``.

        Args:
            condition: SQL; by default that the log of a row no longer exists under any name.
            values: Values of the question marks in it.
        """
        affected_vehicles = f"select distinct vehicle from flights where {condition}"
        # The table files for other programs (``fleet/table_files.py``) are written again for these vehicles.
        self.db.execute(f"insert into unpublished (vehicle) {affected_vehicles}", values)
        self.db.execute(
            f"update flights set judged = null where vehicle in ({affected_vehicles})", values
        )
        self.db.execute(f"delete from flights where {condition}", values)


def _query_values(source: LogSource, limits: JobLimits) -> JsonValues:
    """Returns the values for the named parameters of SQL queries about a log, such as ``:path``.

    Args:
        source: path of the log, with its size and the version of its content.
        limits: time and memory that its reading may take.

    Returns:
        Values by name: the fields of ``source`` and ``limits``, and ``mavdem``, the version of this program.
    """
    values = JsonValues()
    values.update(source._asdict())
    values.update(limits._asdict())
    # SQLite takes no text that is not valid Unicode, as the name of a file may be.
    values["path"] = utf8_text(source.path)
    values["mavdem"] = metadata.version("mavdem")
    return values
