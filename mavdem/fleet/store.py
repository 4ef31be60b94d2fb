"""The store of a fleet, one SQLite file: which logs were read and the rows of each; and the table made of them.

``FLEET/fleet.sqlite`` is written one log at a time, each in a transaction of its own: a run may be killed at any
moment, and two runs may write side by side, a server among them, whose library (``mavdem.serve.library``) is in the
same file. At the end of a run ``FLEET/flights/flights.parquet`` is written from it as a whole, for DuckDB, Polars and
pandas, where pyarrow is installed.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import fields, replace
from importlib import metadata
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from filelock import FileLock

from mavdem.containers import JsonValues, Names
from mavdem.errors import Unreadable, error_message
from mavdem.extras import missing_modules
from mavdem.facts import Fact
from mavdem.facts.fleet import Folder
from mavdem.facts.lights import Light
from mavdem.facts.motors import HealthUnknown
from mavdem.files import atomic_write
from mavdem.fleet.row import SCHEMA_VERSION, FlightRow, FlightRows, row_schema, utf8_text
from mavdem.fleet.sources import UNKNOWN_SIZE, LogSource, is_url
from mavdem.fleet.workers import PAGES, JobLimits, JobOutcome

STORE = "fleet.sqlite"
"""Name of the store in the folder of a fleet."""

TABLE = Path("flights", "flights.parquet")
"""Path of the table in the folder of a fleet."""

TABLE_LOCK = ".flights.lock"
"""Name of the file that is locked while the table is written; outside the table's folder, all of which is read."""

JUDGEMENT_LOCK = ".pages.lock"
"""Name of the file that is locked while vehicles are judged, and while pages say how their flights were judged."""

ROWS_PER_GROUP = 2_000
"""Rows of a group in the Parquet file, which are in memory at a time: 8 MB as JSON. Readers that look for a vehicle
skip whole groups, by the least and the greatest name in each."""

BUSY_SECONDS = 600.0
"""s for which a run waits while another one writes, such as the table of a large fleet."""

BRIEF_COLUMNS = (
    "file",
    "key",
    "vehicle",
    "vehicle_basis",
    "frame",
    "firmware",
    "system",
    "component",
    "date",
    "axis",
    "tier",
    "duration",
    "wind_speed",
    "wind_direction",
    "headline",
    "headline_level",
    *(f"light_{light}" for light in Light),
    "health",
    "fault_probability",
    "suspect_motor",
    "health_reason",
    "warnings",
    "status",
    "status_code",
    "page",
)
"""Columns that an index of all flights shows. They are stored by themselves too, since a row has four times as many."""

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


class StoredRow(NamedTuple):
    """A row as the store has it."""

    text: str
    """The row as JSON."""
    file: str
    """Name of its log in the table."""


def is_fleet(folder: Path) -> bool:
    """Returns whether a folder has a store, which ``mavdem track`` has written."""
    return (folder / STORE).is_file()


def read_rows(folder: Path, vehicle: str | None = None) -> FlightRows:
    """Returns the rows of a fleet, by vehicle, file and axis.

    Args:
        folder: folder of the fleet.
        vehicle: name of the vehicle whose rows are returned; None for those of all vehicles.

    Raises:
        Unreadable: the folder has no store, or a damaged one.
    """
    query = "select row, file from flights where file is not null"
    if vehicle is not None:
        query += " and vehicle = :vehicle"
    return _stored_rows(folder, query, {"vehicle": vehicle})


def read_brief_rows(folder: Path) -> FlightRows:
    """Returns the rows of a fleet with ``BRIEF_COLUMNS`` alone; other columns have their defaults.

    Raises:
        Unreadable: the folder has no store, or a damaged one.
    """
    return _stored_rows(folder, "select brief, file from flights where file is not null", {})


def read_rows_of_logs(folder: Path, files: Iterable[str]) -> FlightRows:
    """Returns the rows of the logs with these names in the table of a fleet.

    Raises:
        Unreadable: the folder has no store, or a damaged one.
    """
    query = "select row, file from flights where file in (select value from json_each(:files))"
    return _stored_rows(folder, query, {"files": json.dumps(sorted(files))})


def _stored_rows(folder: Path, query: str, values: JsonValues) -> FlightRows:
    """Returns the rows that a query with named ``values`` finds in the store of a fleet, in their order.

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
            if not _has_brief_rows(db):
                # A store of an earlier version has none until a run has opened it. Whole rows have their columns too.
                query = query.replace("select brief", "select row")
            rows = [row_of_json(text, file) for text, file in db.execute(query, values)]
    except sqlite3.Error as error:
        raise Unreadable(_damage(path, error)) from None
    return sorted(rows, key=lambda row: row.order)


def _has_brief_rows(db: sqlite3.Connection) -> bool:
    """Returns whether a store has brief rows, which those of earlier versions have not."""
    query = "select 1 from pragma_table_info('flights') where name = 'brief'"
    return db.execute(query).fetchone() is not None


def _damage(path: Path, error: Exception) -> Fact:
    """Returns the fact that a store is damaged."""
    return Fact(Folder.FLEET_DAMAGED, path=path, because=error)


def write_rows(
    folder: Path, rows: Iterable[StoredRow], changed_vehicles: Sequence[str] | None = None
) -> None:
    """Writes the table of a fleet from stored rows, in place of an earlier one.

    Without pyarrow no table is written, and an earlier one is removed, since it is no longer true.

    Args:
        folder: folder of the fleet.
        rows: rows in the order of their vehicles.
        changed_vehicles: names of the vehicles whose rows are replaced by ``rows``, while those of others stay as they
            are in the table; None to make the whole table of ``rows``.

    Raises:
        OSError: the table cannot be written.
        sqlite3.DatabaseError: a row is damaged.
    """
    path = folder / TABLE
    if missing_modules("parquet"):
        path.unlink(missing_ok=True)
        return
    import pyarrow
    from pyarrow import parquet

    # Arrow's own pools keep some 50 MB more for themselves.
    pyarrow.set_memory_pool(pyarrow.system_memory_pool())
    path.parent.mkdir(exist_ok=True)
    groups = _row_groups(rows)
    if changed_vehicles is not None:
        groups = _full_groups(_merged_groups(path, groups, changed_vehicles))
    # The unfinished file is in the fleet's folder: readers of all files beside the table would read it, too.
    with atomic_write(path, folder) as file:
        with parquet.ParquetWriter(file, row_schema(), compression="zstd") as writer:
            for group in groups:
                writer.write_table(group)
        file.flush()
        os.fsync(file.fileno())


def has_current_table(folder: Path) -> bool:
    """Returns whether a fleet has a table with the columns of this version, so that parts of it can be replaced."""
    if missing_modules("parquet"):
        return False
    import pyarrow
    from pyarrow import parquet

    try:
        # pyarrow opens no path that is not valid Unicode.
        with (folder / TABLE).open("rb") as file:
            table_schema = parquet.read_schema(file)
    except (OSError, pyarrow.ArrowException):
        return False
    schema = row_schema()
    # The schema of a file has further metadata on each column, but not on the table.
    return bool(table_schema.equals(schema) and table_schema.metadata == schema.metadata)


def _row_groups(rows: Iterable[StoredRow]) -> Iterator[Any]:
    """Yields rows as tables of pyarrow with ``ROWS_PER_GROUP`` rows each, in their order.

    Raises:
        sqlite3.DatabaseError: a row is damaged.
    """
    rows = iter(rows)
    group = list(islice(rows, ROWS_PER_GROUP))
    while group:
        yield _arrow_table(group)
        group = list(islice(rows, ROWS_PER_GROUP))


def _merged_groups(
    path: Path, new_groups: Iterable[Any], changed_vehicles: Sequence[str]
) -> Iterator[Any]:
    """Yields the row groups of a table in which the rows of some vehicles are replaced, in the order of the vehicles.

    Args:
        path: of the table.
        new_groups: the rows that take the place of those of the changed vehicles, as tables of pyarrow.
        changed_vehicles: their names.
    """
    import pyarrow
    from pyarrow import compute, parquet

    schema = row_schema()
    names = pyarrow.array(changed_vehicles, pyarrow.string())
    new_rows = pyarrow.concat_tables([schema.empty_table(), *new_groups])
    # pyarrow opens no path that is not valid Unicode.
    with path.open("rb") as stream, parquet.ParquetFile(stream) as file:
        for number in range(file.num_row_groups):
            # Without threads it takes half the memory, and no longer.
            group = file.read_row_group(number, use_threads=False).cast(schema)
            last_vehicle = group["vehicle"][-1]
            kept_rows = group.filter(compute.invert(compute.is_in(group["vehicle"], names)))
            comes_before = compute.less_equal(new_rows["vehicle"], last_vehicle)
            # Arrow's sort is stable, so that the rows of each vehicle stay in their order.
            together = pyarrow.concat_tables([kept_rows, new_rows.filter(comes_before)])
            new_rows = new_rows.filter(compute.invert(comes_before))
            # A group without rows would have no last vehicle when it is read again.
            if together.num_rows:
                yield together.sort_by("vehicle")
    if new_rows.num_rows:
        yield new_rows


def _full_groups(tables: Iterable[Any]) -> Iterator[Any]:
    """Yields the rows of tables of pyarrow as tables with ``ROWS_PER_GROUP`` rows each, in their order.

    Tables whose rows are replaced again and again would become ever more, and ever larger.
    """
    import pyarrow

    waiting = row_schema().empty_table()
    for table in tables:
        waiting = pyarrow.concat_tables([waiting, table])
        while waiting.num_rows >= ROWS_PER_GROUP:
            yield waiting.slice(0, ROWS_PER_GROUP)
            waiting = waiting.slice(ROWS_PER_GROUP)
        waiting = waiting.combine_chunks()
    if waiting.num_rows:
        yield waiting


def _arrow_table(rows: Sequence[StoredRow]) -> Any:
    """Returns stored rows as a ``pyarrow.Table`` with the columns of this version.

    Arrow reads the JSON itself: a table of thousands of rows is written while Python would have parsed a few hundred.

    Raises:
        sqlite3.DatabaseError: a row is damaged.
    """
    import pyarrow
    from pyarrow import json as arrow_json

    schema = row_schema()
    # Times are stored with their zone, UTC, which the table does not name; Arrow reads no such text as a time.
    date_index = schema.get_field_index("date")
    text_schema = schema.set(date_index, pyarrow.field("date", pyarrow.string()))
    # A line is a row, as long as no row contains a line break; a damaged one may.
    lines = "\n".join(row.text.replace("\n", " ") for row in rows)
    try:
        table = arrow_json.read_json(
            pyarrow.BufferReader(lines.encode()),
            arrow_json.ReadOptions(use_threads=False, block_size=max(len(lines.encode()), 1)),
            arrow_json.ParseOptions(
                explicit_schema=text_schema, unexpected_field_behavior="ignore"
            ),
        )
    except pyarrow.ArrowInvalid as error:
        raise sqlite3.DatabaseError(error) from None
    dates = table["date"].cast(pyarrow.timestamp("us", "UTC")).cast(pyarrow.timestamp("us"))
    files = pyarrow.array([row.file for row in rows], pyarrow.string())
    table = table.set_column(date_index, schema.field("date"), dates)
    table = table.set_column(schema.get_field_index("file"), schema.field("file"), files)
    return table.cast(schema)


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
        self._add_brief_rows()
        (version,) = self.db.execute("pragma user_version").fetchone()
        if version != SCHEMA_VERSION:
            # The rows stay until their log is read again, and the table is written anew as a whole.
            self.db.executescript(
                f"""begin immediate; update logs set ended = 'source';
                insert into unpublished (vehicle) values (null);
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

    def _add_brief_rows(self) -> None:
        """Adds brief rows and pages to the store of an earlier version, whose rows had neither."""
        if _has_brief_rows(self.db):
            return
        with self.transaction():
            # Another run may have added them while this one waited.
            if _has_brief_rows(self.db):
                return
            self.db.execute("alter table flights add column brief text")
            self.db.execute("alter table flights add column page text")
            self.db.execute("alter table unpublished add column vehicle text")
            query = "select rowid, row, coalesce(file, '') from flights"
            for row_id, *columns in self.db.execute(query).fetchall():
                # A damaged row is reported where it is used.
                with suppress(sqlite3.DatabaseError):
                    row = row_of_json(*columns)
                    self.db.execute(
                        "update flights set brief = ?, page = ? where rowid = ?",
                        [brief_json(row), row.page, row_id],
                    )

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
            for row in outcome.rows:
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
        written = set()
        if (self.folder / PAGES).is_dir():
            written = {f"{PAGES}/{name}" for name in os.listdir(self.folder / PAGES)}
        pages = self.db.execute("select distinct log, page from flights where page is not null")
        contents = [[content] for content, page in pages if page not in written]
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
        return self._rows_of("row", sources)

    def brief_rows_of(self, sources: Iterable[LogSource]) -> FlightRows:
        """Returns the rows of these logs with ``BRIEF_COLUMNS`` alone, which takes a quarter of the time."""
        return self._rows_of("brief", sources)

    def _rows_of(self, column: str, sources: Iterable[LogSource]) -> FlightRows:
        """Returns the rows of these logs from the ``column`` "row" or "brief" of the table of flights."""
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

    def publish(self, assess: AssessRows) -> None:
        """Judges the vehicles of which anything is new, or whose baseline is, and writes the table if it changed.

        Rows are marked with the hash of the baseline by which they were judged; those with another mark, or none, are
        to be judged again. A changed vehicle is noted in the table ``unpublished`` within the same transaction, so that
        a run that is killed before it writes the Parquet file leaves this to the next one.

        Args:
            assess: judges all rows of a vehicle.
        """
        with self.judgement_lock(), self.transaction():
            # Another run may have set the baseline while this one waited for the lock.
            healthy = self.healthy
            baseline = hashlib.sha256(repr(healthy).encode()).hexdigest()
            self._update_names()
            query = """select distinct vehicle from flights where file is not null and judged is not ?
                order by vehicle"""
            for (vehicle,) in self.db.execute(query, [baseline]).fetchall():
                healthy_rows = [row for row in healthy if row.vehicle == vehicle]
                self._judge_vehicle(vehicle, assess, healthy_rows, baseline)
        # Two runs that end together write one after the other, so that the later one has all rows. Other runs can go on
        # meanwhile.
        with FileLock(self.folder / TABLE_LOCK):
            self._write_table()

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
        unjudged_query = query.replace("order by", f"and judged is not '{baseline}' order by")
        found = self.db.execute(unjudged_query, [vehicle]).fetchall()
        # Without a name of its own or a baseline a flight is not compared with others, which stay as they are.
        if healthy_rows or row_of_json(*found[0][1:]).has_own_name:
            found = self.db.execute(query, [vehicle]).fetchall()
        rows = [row_of_json(text, file) for _, text, file in found]
        judged_rows = assess_safely(rows, assess, healthy_rows)
        for (row_id, *_), row in zip(found, judged_rows, strict=True):
            self.db.execute(
                "update flights set row = ?, brief = ?, judged = ? where rowid = ?",
                [json.dumps(row.as_dict()), brief_json(row), baseline, row_id],
            )
        self.db.execute("insert into unpublished (vehicle) values (?)", [vehicle])
        self.db.execute("insert or ignore into outdated_pages values (?)", [vehicle])

    def judgement_lock(self) -> FileLock:
        """Returns a lock within whose block no other run judges a vehicle, so that what pages say stays true.

        Without it a run could write pages by the rows that it has read, and mark them as updated, while another run
        judges the same vehicle anew.
        """
        return FileLock(self.folder / JUDGEMENT_LOCK)

    def outdated_vehicles(self) -> set[str]:
        """Returns the names of vehicles that were judged anew since their pages were last marked as updated."""
        return {vehicle for (vehicle,) in self.db.execute("select vehicle from outdated_pages")}

    def mark_pages_updated(self, vehicles: Iterable[str]) -> None:
        """Notes that the pages of the flights of these vehicles say how the flights differ from each other."""
        with self.transaction():
            names = [[vehicle] for vehicle in vehicles]
            self.db.executemany("delete from outdated_pages where vehicle = ?", names)

    def _write_table(self) -> None:
        """Writes the table file from the rows as they are now, unless it is up to date.

        The table ``unpublished`` has a number and a vehicle for each change since the file was written. Those up to the
        last number that is read together with the rows are deleted afterwards; later ones stay for the next run. Rows
        of other vehicles are taken from the file.
        """
        with self.db:
            self.db.execute("begin")
            changes = self.db.execute("select change, vehicle from unpublished").fetchall()
            if not changes and (self.folder / TABLE).is_file():
                return
            vehicles = sorted({vehicle for _, vehicle in changes if vehicle is not None})
            # A change of an earlier version of mavdem names no vehicle.
            all_name_vehicles = all(vehicle is not None for _, vehicle in changes)
            changed_vehicles = None
            if all_name_vehicles and has_current_table(self.folder):
                changed_vehicles = vehicles
            query = """select row, file from flights where file is not null and
                (? or vehicle in (select vehicle from unpublished))
                order by vehicle, file, log, rowid"""
            found = self.db.execute(query, [changed_vehicles is None])
            rows = (StoredRow(*columns) for columns in found)
            write_rows(self.folder, rows, changed_vehicles)
        last_change = max((change for change, _ in changes), default=0)
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
        vehicles = f"select distinct vehicle from flights where {condition}"
        self.db.execute(f"insert into unpublished (vehicle) {vehicles}", values)
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


def brief_json(row: FlightRow) -> str:
    """Returns the ``BRIEF_COLUMNS`` of a row as JSON, without those that are not known."""
    values = row.as_dict()
    known = {name: values[name] for name in BRIEF_COLUMNS if values[name] not in (None, ())}
    return json.dumps(known)


def row_of_json(text: str, file: str | None = None) -> FlightRow:
    """Returns a row of the store. Columns of other versions are left out.

    Args:
        text: the row as JSON.
        file: the name of its log in the table; that of the JSON unless given.

    Raises:
        sqlite3.DatabaseError: the text is no row.
    """
    try:
        values = json.loads(text)
        # Most rows are of this version, and need no search for columns of others.
        if not values.keys() <= COLUMNS:
            values = {name: value for name, value in values.items() if name in COLUMNS}
        if file is not None:
            values["file"] = file
        return FlightRow.from_stored(values)
    except (AttributeError, TypeError, ValueError, RecursionError) as error:
        raise sqlite3.DatabaseError(error) from error
