"""The rule by which flights may be a baseline: flights known to be healthy, which others are compared with."""

from __future__ import annotations

from mavdem.facts import Level
from mavdem.facts.motors import MotorHealth
from mavdem.fleet.row import FlightRow, FlightRows


def row_with_bad_motors(rows: FlightRows) -> FlightRow | None:
    """Returns a row of a flight whose motors are bad, by its log alone or beside the vehicle's other flights.

    Such a flight may not be part of a baseline: its fault would count as sound, and sound flights would differ from it.

    Args:
        rows: rows of the flights that are named as healthy.

    Returns:
        The first such row; None if no flight has bad motors.
    """
    for row in rows:
        if row.light_motors == Level.BAD or row.health == MotorHealth.FAULT:
            return row
    return None
