"""The table of a fleet for DuckDB, Polars and pandas: Parquet files, each with all rows of some vehicles.

Where the rows of a vehicle have changed its file is written anew, and the other files stay as they are: one more log
costs the same among ten thousand as among a thousand. Without pyarrow there is no table.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple, get_args, get_origin

from filelock import FileLock

from mavdem.document_heading import document_heading
from mavdem.extras import missing_modules
from mavdem.files import atomic_write
from mavdem.fleet.row import SCHEMA_VERSION, FlightRow, column_types
from mavdem.fleet.store import Store
from mavdem.fleet.stored_rows import StoredRow
from mavdem.units import field_units

TABLE_FOLDER = "flights"
"""Name of the folder with the files of the table, in the folder of the fleet."""

TABLE_LOCK = ".flights.lock"
"""Name of the file that is locked while the table is written; outside the table's folder, all of which is read."""

ROWS_PER_FILE = 2_000
"""Rows from which on a file takes no further vehicle: 8 MB as JSON, which are written in a tenth of a second. A vehicle
with more rows has a larger file."""

ROWS_PER_GROUP = 2_000
"""Rows of a group in a Parquet file, which are in memory at a time."""


def table_path(folder: Path, number: int = 0) -> Path:
    """Returns the path of a file of a fleet's table: flights.parquet, flights-1.parquet and so on.

    Args:
        folder: folder of the fleet, with its SQLite store, its table and its pages.
        number: number of the file, from 0.
    """
    name = "flights" if number == 0 else f"flights-{number}"
    return folder / TABLE_FOLDER / f"{name}.parquet"


def update_table(store: Store) -> None:
    """Writes those files of a fleet's table in which a row has changed since they were last written.

    Without pyarrow the files of an earlier table are removed, since they are out of date.

    Args:
        store: the open SQLite store of the fleet, with the rows of all logs.

    Raises:
        OSError: a file cannot be written.
        sqlite3.DatabaseError: a row is damaged.
    """
    folder = store.folder
    if missing_modules("parquet"):
        for path in (folder / TABLE_FOLDER).glob("*.parquet"):
            path.unlink()
        return
    # Two runs that end together write one after the other, so that the later one has all rows. Other runs can add logs
    # meanwhile.
    with FileLock(folder / TABLE_LOCK):
        with store.transaction():
            plan = _planned_update(store)
        for number in sorted(plan.file_numbers):
            write_file(table_path(folder, number), _rows_of_file(store.db, number), folder)
        if plan.writes_all_files:
            _remove_other_files(folder, plan.file_numbers)
        # Changes that other runs have made meanwhile stay in the table, for the next update.
        store.db.execute("delete from unpublished where change <= ?", [plan.last_change])


class _PlannedUpdate(NamedTuple):
    """Which files of a fleet's table are to be written, and the changes of rows that they will contain."""

    file_numbers: set[int]
    """Numbers of the files to be written."""

    writes_all_files: bool
    """Whether the whole table is written anew, so that other files of it are out of date."""

    last_change: int | None
    """Number of the last change in the table ``unpublished``; None if no row has changed."""


def _planned_update(store: Store) -> _PlannedUpdate:
    """Assigns each vehicle to a file of a fleet's table, and returns which files are to be written.

    The SQL table ``unpublished`` has a number and a vehicle for each change of a row since the files were last written.

    Args:
        store: the open SQLite store of the fleet, in a transaction.
    """
    changes = store.db.execute("select vehicle from unpublished").fetchall()
    changed_vehicles = {vehicle for (vehicle,) in changes}
    writes_all_files = _needs_whole_table(store, changed_vehicles)
    if writes_all_files:
        # Vehicles may move to another file. A run that ends before it has written all files must leave the whole table
        # to the next one; otherwise some vehicles would be in two files. A change of no vehicle stands for all of them.
        store.db.execute("insert into unpublished (vehicle) values (null)")
        store.db.execute("delete from table_files")
    (last_change,) = store.db.execute("select max(change) from unpublished").fetchone()
    _assign_vehicles(store.db)
    file_numbers = _outdated_files(store, writes_all_files=writes_all_files)
    return _PlannedUpdate(file_numbers, writes_all_files, last_change)


def _needs_whole_table(store: Store, changed_vehicles: set[str | None]) -> bool:
    """Decides whether all Parquet files of the fleet's table are written again, and not only those of changed vehicles.

    They are if there are none, or if they have the columns of another version of mavdem.

    Args:
        store: the open SQLite store of the fleet, with the rows of all logs.
        changed_vehicles: names of the vehicles whose rows have changed since the files were written. None among them
            stands for all vehicles: the store was made by another version, or a run did not write the whole table.

    Returns:
        Whether to write all files.
    """
    if None in changed_vehicles:
        return True
    if not changed_vehicles:
        return not table_path(store.folder).is_file()
    if not has_current_columns(table_path(store.folder)):
        return True
    numbers = store.db.execute("select distinct number from table_files").fetchall()
    for (number,) in numbers:
        path = table_path(store.folder, number)
        # A missing file is written anyway (:func:`_outdated_files`), without the rest of the table.
        if path.is_file() and not has_current_columns(path):
            return True
    # The single file of an earlier version of mavdem has all vehicles, none of which is assigned to it.
    return not numbers


def _assign_vehicles(db: sqlite3.Connection) -> None:
    """Assigns vehicles that have no file yet to the last file, or to further ones as it becomes full.

    A file may have more rows than ``ROWS_PER_FILE``, since all rows of a vehicle are in one file.

    Args:
        db: the connection to the store, whose table ``table_files`` has the number of the file of each vehicle.
    """
    query = "select number, count(*) from table_files join flights using (vehicle) group by number"
    rows_by_file = Counter[int](dict(db.execute(query).fetchall()))
    last_file = max(rows_by_file, default=0)
    query = """select vehicle, count(*) from flights
        where vehicle not in (select vehicle from table_files) group by vehicle order by vehicle"""
    for vehicle, row_count in db.execute(query).fetchall():
        if rows_by_file[last_file] >= ROWS_PER_FILE:
            last_file += 1
        rows_by_file[last_file] += row_count
        db.execute("insert into table_files values (?, ?)", [vehicle, last_file])


def _outdated_files(store: Store, *, writes_all_files: bool) -> set[int]:
    """Selects the files of the fleet's table to write again: files of changed vehicles, and missing files.

    Args:
        store: the open store of the fleet. Its SQL table ``table_files`` has the number of the file of each vehicle,
            and ``unpublished`` the vehicles whose rows have changed since their file was written.
        writes_all_files: whether all files are to be written.

    Returns:
        The numbers of these files.
    """
    query = "select number, vehicle in (select vehicle from unpublished) from table_files"
    outdated_numbers = set()
    # The first file exists also for a fleet without a flight.
    numbers = {0}
    for number, is_changed in store.db.execute(query):
        numbers.add(number)
        if is_changed:
            outdated_numbers.add(number)
    for number in numbers:
        if writes_all_files or not table_path(store.folder, number).is_file():
            outdated_numbers.add(number)
    return outdated_numbers


def _rows_of_file(db: sqlite3.Connection, number: int) -> Iterator[StoredRow]:
    """Yields the rows of all vehicles that are assigned to one file of the table.

    Args:
        db: the SQLite database of the fleet's store.
        number: number of the file, from 0.

    Yields:
        The rows, sorted by vehicle and log.
    """
    query = """select row, file from flights where file is not null and
        vehicle in (select vehicle from table_files where number = ?)
        order by vehicle, file, log, rowid"""
    for columns in db.execute(query, [number]):
        yield StoredRow(*columns)


def _remove_other_files(folder: Path, numbers: Iterable[int]) -> None:
    """Removes the Parquet files of a fleet's table whose numbers are not in use.

    Args:
        folder: folder of the fleet, with its SQLite store, its table and its pages.
        numbers: numbers of the files to keep.
    """
    kept_paths = {table_path(folder, number) for number in numbers}
    for path in (folder / TABLE_FOLDER).glob("flights-*.parquet"):
        if path not in kept_paths:
            path.unlink()


def write_file(path: Path, rows: Iterable[StoredRow], folder: Path) -> None:
    """Writes a file of a table, in place of an earlier one.

    Args:
        path: path of the file.
        rows: its rows in the order of their vehicles.
        folder: folder for the unfinished file: readers of all files beside the table would read it there.

    Raises:
        OSError: the file cannot be written.
        sqlite3.DatabaseError: a row is damaged.
    """
    import pyarrow
    from pyarrow import parquet

    # Arrow's own pools keep some 50 MB more for themselves.
    pyarrow.set_memory_pool(pyarrow.system_memory_pool())
    path.parent.mkdir(exist_ok=True)
    with atomic_write(path, folder) as file:
        with parquet.ParquetWriter(file, row_schema(), compression="zstd") as writer:
            for group in _row_groups(rows):
                writer.write_table(group)
        file.flush()
        os.fsync(file.fileno())


def row_schema() -> Any:
    """Returns name, type and unit of all columns of the table as a ``pyarrow.Schema``.

    The metadata of the schema have the versions of the columns and of mavdem. The metadata of a column have its unit.

    Raises:
        ImportError: pyarrow is not installed.
    """
    import pyarrow

    scalar_types = {
        str: pyarrow.string(),
        float: pyarrow.float64(),
        int: pyarrow.int64(),
        # Times are UTC, but their type names no zone: DuckDB shows times with a zone in local time.
        datetime: pyarrow.timestamp("us"),
    }

    def arrow_type(column_type: Any) -> Any:
        """Returns the Arrow type of a column with Python's type: a list for a tuple, otherwise the scalar type."""
        if get_origin(column_type) is tuple:
            return pyarrow.list_(arrow_type(get_args(column_type)[0]))
        return scalar_types[column_type]

    units = field_units(FlightRow)
    columns = []
    for name, column_type in column_types().items():
        column_metadata = {"unit": units[name]} if name in units else None
        columns.append(pyarrow.field(name, arrow_type(column_type), metadata=column_metadata))
    heading = document_heading("flights", SCHEMA_VERSION, {})
    versions = {
        "mavdem_schema": str(SCHEMA_VERSION),
        "mavdem_version": heading["mavdem_version"],
    }
    return pyarrow.schema(columns, versions)


def has_current_columns(path: Path) -> bool:
    """Returns whether there is a file of a table, with the columns of this version.

    Args:
        path: the Parquet file.
    """
    import pyarrow
    from pyarrow import parquet

    try:
        # PyArrow opens no path that is not valid Unicode.
        with path.open("rb") as file:
            table_schema = parquet.read_schema(file)
    except (OSError, pyarrow.ArrowException):
        return False
    schema = row_schema()
    # The schema of a file has further metadata on each column, but not on the table.
    return bool(table_schema.equals(schema) and table_schema.metadata == schema.metadata)


def _row_groups(rows: Iterable[StoredRow]) -> Iterator[Any]:
    """Yields rows as tables of pyarrow with ``ROWS_PER_GROUP`` rows each, in their order.

    Args:
        rows: rows as they are stored.

    Yields:
        A ``pyarrow.Table`` with the columns of this version; the last one may have fewer rows.

    Raises:
        sqlite3.DatabaseError: a row is damaged.
    """
    import pyarrow

    remaining_rows = iter(rows)
    while True:
        group = list(islice(remaining_rows, ROWS_PER_GROUP))
        if not group:
            return
        try:
            table = _arrow_table(group)
        except pyarrow.ArrowInvalid as error:
            raise sqlite3.DatabaseError(error) from None
        yield table


def _arrow_table(rows: Sequence[StoredRow]) -> Any:
    """Converts stored rows of the fleet's table to a ``pyarrow.Table`` with the columns of this version.

    Arrow reads the JSON itself: a table of thousands of rows is written while Python would have parsed a few hundred.

    Args:
        rows: rows as they are stored.

    Returns:
        The table, with a row for each axis of each flight.

    Raises:
        pyarrow.ArrowInvalid: a row is damaged.
    """
    import pyarrow

    schema = row_schema()
    # Times are stored with their zone, UTC, which the table does not name; Arrow reads no such text as a time.
    date_index = schema.get_field_index("date")
    text_schema = schema.set(date_index, pyarrow.field("date", pyarrow.string()))
    table = _table_of_json((row.text for row in rows), text_schema)
    dates = table["date"].cast(pyarrow.timestamp("us", "UTC")).cast(pyarrow.timestamp("us"))
    table = table.set_column(date_index, schema.field("date"), dates)
    # A log has another name in the table than in its row where it was moved. JSON makes the column, since
    # pyarrow.array() imports pandas, which takes as long as all the rest.
    file_field = schema.field("file")
    file_texts = (json.dumps({"file": row.file}) for row in rows)
    files = _table_of_json(file_texts, pyarrow.schema([file_field]))["file"]
    return table.set_column(schema.get_field_index("file"), file_field, files).cast(schema)


def _table_of_json(texts: Iterable[str], schema: Any) -> Any:
    """Parses texts of JSON objects, one for each row, to a ``pyarrow.Table`` with the columns of a schema.

    Args:
        texts: texts of JSON objects.
        schema: pyarrow's schema, with names and types of the columns.

    Returns:
        The table, with null where an object lacks a column.

    Raises:
        pyarrow.ArrowInvalid: a text is no such object.
    """
    import pyarrow
    from pyarrow import json as arrow_json

    # Arrow reads one object from each line. Only the text of a damaged row can contain a line break.
    single_lines = [text.replace("\n", " ") for text in texts]
    lines = "\n".join(single_lines).encode()
    return arrow_json.read_json(
        pyarrow.BufferReader(lines),
        arrow_json.ReadOptions(use_threads=False, block_size=max(len(lines), 1)),
        arrow_json.ParseOptions(explicit_schema=schema, unexpected_field_behavior="ignore"),
    )
