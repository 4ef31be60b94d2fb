"""Judgement of a fleet: the motors' health of each vehicle with new flights, from all its flights, into the store.

A judged vehicle is noted in two tables of the store: in ``unpublished`` until its rows are in the table of the fleet,
and in ``outdated_pages`` until the pages of its flights say how the flights differ.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from filelock import FileLock

from mavdem.facts import Fact
from mavdem.facts.motors import HealthUnknown
from mavdem.fleet.row import FlightRow, FlightRows
from mavdem.fleet.store import Store
from mavdem.fleet.stored_rows import brief_json, row_of_json
from mavdem.fleet.table_files import update_table

JUDGEMENT_LOCK = ".pages.lock"
"""Name of the file that is locked while vehicles are judged, and while pages say how their flights were judged."""

RULES_VERSION = 2
"""Version of the rules by which motors are judged (``mavdem.motors``), raised whenever one of them changes.

Fleets that were judged by the rules of another version are judged again by the next run. Since version 2 the healthy
flights of a vehicle end at the first one in which something changed.
"""


class _StoredRow(NamedTuple):
    """A row of the fleet's table, and where the store has it."""

    row_id: int
    """Number of the row in the SQL table of flights."""
    row: FlightRow


AssessRows = Callable[[FlightRows, FlightRows], FlightRows]
"""A function of all rows of one vehicle, and the rows of its baseline; it returns the same rows with their health."""


def publish_judgements(store: Store, assess: AssessRows) -> None:
    """Judges vehicles with new flights, a new baseline or outdated rules, and writes the changes to the fleet's table.

    Rows are marked with the baseline and the version of the rules by which they were judged (:func:`_judgement_mark`);
    those with another mark, or none, are judged again. A changed vehicle is entered in the SQL table ``unpublished``
    within the same transaction, so that, if the run is killed before it writes the Parquet files, the next run writes
    them.

    Args:
        store: the open SQLite store of the fleet, with the rows of all logs.
        assess: function that judges all rows of a vehicle.
    """
    with judgement_lock(store.folder), store.transaction():
        # Another run may have set the baseline while this one waited for the lock.
        healthy = store.healthy
        mark = _judgement_mark(healthy)
        store.update_names()
        # The column ``judged`` has the mark, and ``file`` is null where a log is not tracked.
        query = """select distinct vehicle from flights where file is not null and judged is not ?
            order by vehicle"""
        for (vehicle,) in store.db.execute(query, [mark]).fetchall():
            healthy_rows = [row for row in healthy if row.vehicle == vehicle]
            _judge_vehicle(store, vehicle, assess, healthy_rows, mark)
    update_table(store)


def _judgement_mark(healthy: FlightRows) -> str:
    """Returns a hash of the rules and the baseline, with which rows are marked when they are judged by these.

    Args:
        healthy: rows of the baseline of all vehicles; empty without one.
    """
    return hashlib.sha256(f"{RULES_VERSION} {healthy!r}".encode()).hexdigest()


def _judge_vehicle(
    store: Store, vehicle: str, assess: AssessRows, healthy_rows: FlightRows, mark: str
) -> None:
    """Judges the health of one vehicle again from its flights in the fleet's table, and stores the result there.

    All its flights are judged together, since each motor is compared with itself in earlier flights.

    Args:
        store: the open SQLite store of the fleet, with the rows of all logs.
        vehicle: name of the vehicle; it has at least one row that is not judged yet.
        assess: function that judges all rows of a vehicle.
        healthy_rows: rows of the vehicle in the baseline; empty if it has none.
        mark: mark of rows that are judged now (:func:`_judgement_mark`).
    """
    stored_rows = _rows_to_judge(store, vehicle, mark, has_baseline=bool(healthy_rows))
    rows = [stored_row.row for stored_row in stored_rows]
    judged_rows = assess_safely(rows, assess, healthy_rows)
    for stored_row, judged_row in zip(stored_rows, judged_rows, strict=True):
        store.db.execute(
            "update flights set row = ?, brief = ?, judged = ? where rowid = ?",
            [json.dumps(judged_row.as_dict()), brief_json(judged_row), mark, stored_row.row_id],
        )
    # The Parquet file and the pages of the vehicle are now older than its rows.
    store.db.execute("insert into unpublished (vehicle) values (?)", [vehicle])
    store.db.execute("insert or ignore into outdated_pages values (?)", [vehicle])


def _rows_to_judge(
    store: Store, vehicle: str, mark: str, *, has_baseline: bool
) -> list[_StoredRow]:
    """Returns the rows of a vehicle that are to be judged together, in the order of their files.

    These are all its rows. But if its name may be that of several vehicles, and there is no baseline, flights are not
    compared with each other: then only those without the mark are judged.

    Args:
        store: the open SQLite store of the fleet.
        vehicle: name of the vehicle; it has at least one row without the mark.
        mark: mark of rows that are judged already.
        has_baseline: whether the vehicle has flights that are known to be healthy.
    """
    selection = "select rowid, row, file from flights where vehicle = ? and file is not null"
    order = "order by file, log, rowid"
    unjudged_query = f"{selection} and judged is not ? {order}"
    values = store.db.execute(unjudged_query, [vehicle, mark]).fetchall()
    _, first_text, first_file = values[0]
    has_own_name = row_of_json(first_text, first_file).has_own_name
    if has_baseline or has_own_name:
        values = store.db.execute(f"{selection} {order}", [vehicle]).fetchall()
    return [_StoredRow(row_id, row_of_json(text, file)) for row_id, text, file in values]


def assess_safely(rows: FlightRows, assess: AssessRows, healthy_rows: FlightRows) -> FlightRows:
    """Judges the motors of one vehicle, and stores an error in its rows, so that other vehicles can still be judged.

    Args:
        rows: all rows of the vehicle in the fleet's table, one for each axis of each flight.
        assess: the function that judges them.
        healthy_rows: rows of the baseline, the flights known to be healthy.

    Returns:
        The rows with their health. If ``assess`` raises an error, the unchanged rows with the error as their
        ``health_reason``.
    """
    try:
        return assess(rows, healthy_rows)
    except Exception as error:
        reason = Fact(HealthUnknown.HEALTH_FAILED, reason=f"{type(error).__name__}: {error}")
        return [replace(row, health_reason=str(reason), health_code=reason.code) for row in rows]


def judgement_lock(folder: Path) -> FileLock:
    """Returns the lock that a run holds while it judges vehicles, or writes their pages.

    Without it a run could write pages from the rows that it has read, and mark them as updated, while another run
    judges the same vehicle again: the pages would then be wrong.

    Args:
        folder: folder of the fleet, with its SQLite store, its table and its pages.
    """
    return FileLock(folder / JUDGEMENT_LOCK)


def outdated_vehicles(store: Store) -> set[str]:
    """Returns the names of vehicles that were judged again since their pages were last marked as updated."""
    return {vehicle for (vehicle,) in store.db.execute("select vehicle from outdated_pages")}


def mark_pages_updated(store: Store, vehicles: Iterable[str]) -> None:
    """Records in a fleet's store that the pages of some vehicles' flights have the present comparison of their flights.

    Args:
        store: the store, which lists vehicles with outdated pages.
        vehicles: names of the vehicles that are taken off this list.
    """
    with store.transaction():
        names = [[vehicle] for vehicle in vehicles]
        store.db.executemany("delete from outdated_pages where vehicle = ?", names)
