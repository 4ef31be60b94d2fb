"""Vehicles that users have assigned to flights whose logs do not identify theirs, in a table of the fleet's store.

Without a serial number or a calibration a log has only the MAVLink system id, which is 1 unless somebody changed it.
Two logs with the same system id may therefore be of two vehicles, until a user assigns them to one.
"""

import json
import sqlite3
from collections.abc import Iterable
from dataclasses import replace

from mavdem.facts.vehicle import system_id_name
from mavdem.fleet.names import content_hash, same_content_sql
from mavdem.fleet.row import GIVEN_BASIS, SYSTEM_ID_BASIS, FlightRow, FlightRows
from mavdem.fleet.stored_rows import brief_json, row_of_json


def name_in_log(row: FlightRow) -> str:
    """Returns the name that the log of a flight gives to its vehicle, whatever name users have assigned.

    Users can assign a flight to another vehicle only if its log identifies the vehicle by a system id alone. The name
    in the log is then made of that id.

    Args:
        row: a row of the fleet's table: the figures of the flight on one axis.

    Returns:
        The name, such as "px4-1".
    """
    is_assigned = row.vehicle_basis == GIVEN_BASIS
    if not is_assigned:
        return row.vehicle
    return system_id_name(row.autopilot or "", row.system or 0)


def rows_with_assigned_vehicles(db: sqlite3.Connection, rows: Iterable[FlightRow]) -> FlightRows:
    """Replaces the vehicle in rows of the fleet's table, where a user has assigned the flight to a vehicle.

    Args:
        db: the SQLite database of the fleet's store.
        rows: rows of a log, as they were read or stored: the figures of one flight on one axis each.

    Returns:
        The rows in the same order. Rows whose log identifies its vehicle are the same objects.
    """
    assigned_rows = []
    for row in rows:
        # The log has no name of the vehicle but the one made of its system id; it may have been assigned before.
        can_be_assigned = row.vehicle_basis in (SYSTEM_ID_BASIS, GIVEN_BASIS)
        if can_be_assigned:
            logged_name = name_in_log(row)
            query = "select vehicle from flight_vehicles where content = ? and logged_name = ?"
            assignment = db.execute(query, [content_hash(row.key), logged_name]).fetchone()
            if assignment is None:
                row = replace(row, vehicle=logged_name, vehicle_basis=SYSTEM_ID_BASIS)
            else:
                row = replace(row, vehicle=assignment["vehicle"], vehicle_basis=GIVEN_BASIS)
        assigned_rows.append(row)
    return assigned_rows


def assign_vehicle(db: sqlite3.Connection, row: FlightRow, vehicle: str) -> None:
    """Assigns a vehicle to a flight, and marks its former and its new vehicle to be judged again.

    The caller must have begun a transaction.

    Args:
        db: the SQLite database of the fleet's store.
        row: a row of the flight, whose log does not identify its vehicle.
        vehicle: name of the vehicle; empty to take the assignment away.
    """
    content = content_hash(row.key)
    logged_name = name_in_log(row)
    db.execute(
        "delete from flight_vehicles where content = ? and logged_name = ?", [content, logged_name]
    )
    if vehicle:
        db.execute("insert into flight_vehicles values (?, ?, ?)", [content, logged_name, vehicle])
    changed_vehicles = _update_flight_rows(db, content)
    for changed_vehicle in sorted(changed_vehicles):
        # Its table file for other programs is to be written again, too.
        db.execute("insert into unpublished (vehicle) values (?)", [changed_vehicle])
        db.execute("update flights set judged = null where vehicle = ?", [changed_vehicle])


def _update_flight_rows(db: sqlite3.Connection, content: str) -> set[str]:
    """Writes the vehicles that are assigned to the flights of one log into their stored rows.

    Args:
        db: the SQLite database of the fleet's store.
        content: hash of the content of the log.

    Returns:
        The former and the new vehicles of the rows that have changed.
    """
    changed_vehicles = set()
    query = f"select rowid, row, coalesce(file, '') from flights where {same_content_sql('?')}"
    for row_id, text, file in db.execute(query, [content, content]).fetchall():
        stored_row = row_of_json(text, file)
        (assigned_row,) = rows_with_assigned_vehicles(db, [stored_row])
        if assigned_row.vehicle == stored_row.vehicle:
            continue
        changed_vehicles |= {stored_row.vehicle, assigned_row.vehicle}
        values = [
            assigned_row.vehicle,
            json.dumps(assigned_row.as_dict()),
            brief_json(assigned_row),
            row_id,
        ]
        db.execute("update flights set vehicle = ?, row = ?, brief = ? where rowid = ?", values)
    return changed_vehicles
