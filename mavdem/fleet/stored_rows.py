"""Rows of a fleet's store, kept as JSON in two forms: whole, and brief with the columns that a page of the fleet shows.

Reading them needs no open :class:`mavdem.fleet.store.Store`: a fleet may lie in a folder that cannot be written to.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterable
from contextlib import closing
from dataclasses import fields
from pathlib import Path
from typing import NamedTuple

from mavdem.containers import JsonValues
from mavdem.errors import Unreadable
from mavdem.facts import Fact
from mavdem.facts.fleet import FleetFolderFact
from mavdem.facts.lights import Light
from mavdem.fleet.row import FlightRow, FlightRows

STORE = "fleet.sqlite"
"""Name of the store in the folder of a fleet."""

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
    "simulated",
    "axis",
    "tier",
    "duration",
    "flight_count",
    "flight_time",
    "height",
    "control_parameters",
    "wind_speed",
    "wind_speed_interval",
    "wind_direction",
    "headline",
    "headline_level",
    "headline_rank",
    "next_step",
    *(f"light_{light}" for light in Light),
    "health",
    "fault_probability",
    "suspect_motor",
    "failed_motor",
    "watched_motor",
    "health_reason",
    "health_code",
    "reference",
    "warnings",
    "status",
    "status_code",
    "page",
)
"""Columns that an index of all flights shows. They are stored by themselves too, since a row has four times as many."""

COLUMNS = {column.name for column in fields(FlightRow)}
"""Names of the columns of this version."""


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
    """Reads the rows of a fleet's table from its store.

    Args:
        folder: folder of the fleet, with its SQLite store, its table and its pages.
        vehicle: name of a vehicle, to read its rows only; None for all vehicles.

    Returns:
        The figures of one flight on one axis each, sorted by vehicle, file and axis.

    Raises:
        Unreadable: the folder has no store, or a damaged one.
    """
    return _rows_of_vehicle(folder, "row", vehicle)


def read_brief_rows(folder: Path, vehicle: str | None = None) -> FlightRows:
    """Reads the rows of a fleet's table with few columns, which is faster, for pages that list flights.

    Args:
        folder: folder of the fleet, with its SQLite store, its table and its pages.
        vehicle: name of a vehicle, to read its rows only; None for all vehicles.

    Returns:
        The rows, sorted by vehicle, file and axis. Columns that are not in ``BRIEF_COLUMNS`` have their defaults.

    Raises:
        Unreadable: the folder has no store, or a damaged one.
    """
    return _rows_of_vehicle(folder, "brief", vehicle)


def read_baseline(folder: Path) -> FlightRows:
    """Reads the rows of a fleet's baseline, the healthy flights that others are compared with.

    Args:
        folder: folder of the fleet, with its SQLite store, its table and its pages.

    Returns:
        The rows, sorted by vehicle, file and axis; empty without a baseline.

    Raises:
        Unreadable: the folder has no store, or a damaged one.
    """
    return _stored_rows(folder, "select row, null from healthy", {})


def read_rows_of_logs(folder: Path, files: Iterable[str]) -> FlightRows:
    """Returns the rows of the logs with these names in the table of a fleet.

    Args:
        folder: folder of the fleet, with its SQLite store, its table and its pages.
        files: names of the logs, as the table has them.

    Raises:
        Unreadable: the folder has no store, or a damaged one.
    """
    query = "select row, file from flights where file in (select value from json_each(:files))"
    return _stored_rows(folder, query, {"files": json.dumps(sorted(files))})


def _rows_of_vehicle(folder: Path, column: str, vehicle: str | None) -> FlightRows:
    """Returns the rows of a vehicle, or of all vehicles, that belong to the table of a fleet.

    The store has each row twice, as JSON in two columns: whole in "row", and with fewer values in "brief", which takes
    less time to read.

    Args:
        folder: folder of the fleet, with its SQLite store, its table and its pages.
        column: the column that is read: "row" for whole rows, or "brief" for those with ``BRIEF_COLUMNS`` alone.
        vehicle: name of the vehicle; None for all vehicles.

    Returns:
        The rows, one for each flight and axis, sorted by :attr:`FlightRow.order`.

    Raises:
        Unreadable: the folder has no store, or a damaged one.
    """
    # A row gets the name of its log's file when the fleet's table is updated, and belongs to the table from then on.
    query = f"select {column}, file from flights where file is not null"
    values = {}
    if vehicle is not None:
        query += " and vehicle = :vehicle"
        values["vehicle"] = vehicle
    return _stored_rows(folder, query, values)


def _stored_rows(folder: Path, query: str, values: JsonValues) -> FlightRows:
    """Reads the rows of a fleet's table that a query selects.

    Args:
        folder: folder of the fleet, with its SQLite store, its table and its pages.
        query: an SQL query for pairs of a row as JSON and the name of its log.
        values: values of the query's named parameters.

    Returns:
        The figures of one flight on one axis each, sorted by :attr:`FlightRow.order`.

    Raises:
        Unreadable: the folder has no store, a damaged one, or one that is locked or may not be opened.
    """
    path = folder / STORE
    if not is_fleet(folder):
        raise Unreadable(FleetFolderFact.NO_FLEET, path=folder)
    access = "mode=rw"
    if not os.access(folder, os.W_OK):
        # SQLite writes its lock beside the store, which it cannot here. It needs none in a folder that stays as it is.
        access = "immutable=1"
    uri = f"{path.absolute().as_uri()}?{access}"
    try:
        with closing(sqlite3.connect(uri, timeout=BUSY_SECONDS, uri=True)) as db:
            if not has_brief_rows(db):
                # A store of an earlier version has none until a run has opened it. Whole rows have their columns too.
                query = query.replace("select brief", "select row")
            rows = [row_of_json(text, file) for text, file in db.execute(query, values)]
    except sqlite3.Error as error:
        raise Unreadable(_read_failure(path, error)) from None
    return sorted(rows, key=lambda row: row.order)


def has_brief_rows(db: sqlite3.Connection) -> bool:
    """Returns whether a store has brief rows, which stores of earlier versions lack."""
    query = "select 1 from pragma_table_info('flights') where name = 'brief'"
    return db.execute(query).fetchone() is not None


def _read_failure(path: Path, error: sqlite3.Error) -> Fact:
    """Returns the fact why a store cannot be read: it is damaged, or the operating system or another run prevents it.

    A store that is locked or may not be opened is sound: to delete it, as a damaged one, would lose the names in it.

    Args:
        path: path of the store.
        error: error of SQLite. An ``OperationalError`` is damage only if tables or columns are missing
            (``SQLITE_ERROR``).
    """
    is_operational = isinstance(error, sqlite3.OperationalError)
    if is_operational and error.sqlite_errorcode != sqlite3.SQLITE_ERROR:
        return Fact(FleetFolderFact.FLEET_NOT_READ, path=path, reason=error)
    return damage_of_store(path, error)


def damage_of_store(path: Path, error: Exception) -> Fact:
    """Returns the fact that a store is damaged."""
    return Fact(FleetFolderFact.FLEET_DAMAGED, path=path, reason=error)


def brief_json(row: FlightRow) -> str:
    """Returns the ``BRIEF_COLUMNS`` of a row as JSON, without unknown values."""
    values = row.as_dict()
    known_values = {name: values[name] for name in BRIEF_COLUMNS if values[name] not in (None, ())}
    return json.dumps(known_values)


def row_of_json(text: str, file: str | None = None) -> FlightRow:
    """Parses a row of a fleet's table from the JSON text in its store.

    Columns that this version of mavdem does not have, since another version wrote the row, are left out.

    Args:
        text: the row as JSON.
        file: the name of its log in the table; the file in the JSON unless given.

    Returns:
        The row: the figures of one flight, vehicle and axis.

    Raises:
        sqlite3.DatabaseError: the text is no row.
    """
    try:
        values = json.loads(text)
        # Most rows are of this version, and need no search for columns of others.
        has_other_columns = not values.keys() <= COLUMNS
        if has_other_columns:
            values = {name: value for name, value in values.items() if name in COLUMNS}
        if file is not None:
            values["file"] = file
        return FlightRow.from_stored(values)
    except (AttributeError, TypeError, ValueError, RecursionError) as error:
        raise sqlite3.DatabaseError(error) from error
