"""Flights and vehicles that the rows of a fleet's table belong to, and the counts of a fleet."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from mavdem.containers import group_by
from mavdem.dataset.axes import AXES
from mavdem.facts.motors import MotorHealth
from mavdem.fleet.row import SYSTEM_ID_BASIS, FlightRow, FlightRows

HEALTHS = tuple(MotorHealth)
"""Health of the motors, the worst first."""

HEALTH_RANKS: dict[str, int] = {health: rank for rank, health in enumerate(HEALTHS)}
"""Rank of each health, 0 for the worst."""

AXIS_ORDER = (*AXES, "")
"""Order of the axes of a flight; a row without an axis comes last."""

AxisRows = Sequence[FlightRow]
"""The rows of one flight, one for each axis."""

Flights = Sequence[AxisRows]
"""Flights of one vehicle in order of date, the rows of each."""


def log_row(flight: AxisRows) -> FlightRow:
    """Returns the first row of a flight, from which to read values of its log, such as date and vehicle.

    They are the same in all rows of the flight: the rows differ only in values that belong to an axis.
    """
    return flight[0]


def group_into_flights(rows: Iterable[FlightRow]) -> list[FlightRows]:
    """Groups the rows of a fleet's table by flight.

    Args:
        rows: rows of the table: the figures of one flight on one axis each.

    Returns:
        The rows of each flight, its axes in the order of ``AXIS_ORDER``. Flights are sorted by date, those without one
        last, then by vehicle and file.
    """

    def date_and_order(flight: AxisRows) -> tuple[object, ...]:
        """Returns the key by which flights are sorted: seconds since 1970, then vehicle and file."""
        row = log_row(flight)
        seconds = math.inf
        if row.date is not None:
            seconds = row.date.timestamp()
        return seconds, row.order

    flights = group_by(rows, lambda row: row.order.without_axis)
    for flight in flights.values():
        flight.sort(key=lambda row: AXIS_ORDER.index(row.axis or ""))
    return sorted(flights.values(), key=date_and_order)


def group_by_vehicle(rows: Iterable[FlightRow]) -> dict[str, list[FlightRows]]:
    """Groups the rows of a fleet's table by vehicle and then by flight.

    Args:
        rows: rows of the table: the figures of one flight on one axis each. Rows of logs without a flight are left out.

    Returns:
        The flights of each vehicle, by its name, in alphabetical order.
    """
    flights = group_into_flights(row for row in rows if row.has_flight)
    flights_by_vehicle = group_by(flights, lambda flight: log_row(flight).vehicle)
    return dict(sorted(flights_by_vehicle.items()))


def has_shared_name(flights: Iterable[AxisRows]) -> bool:
    """Returns whether several vehicles may have the name of these flights' vehicle: it is a MAVLink system id.

    Most vehicles have the system id 1. Other names, such as the serial number of a board, are of one vehicle.

    Args:
        flights: flights under one name, each as the list of its rows in the fleet's table.
    """
    for flight in flights:
        for row in flight:
            if row.vehicle_basis == SYSTEM_ID_BASIS:
                return True
    return False


def worst_health(flight: AxisRows) -> str:
    """Returns the worst health of a flight's axes: "fault", "drift", "ok", or "unknown" if none was judged."""
    return worst_row(flight).health


def worst_row(flight: AxisRows) -> FlightRow:
    """Returns the row of the axis with the worst health, the first of equal ones."""
    return min(flight, key=lambda row: HEALTH_RANKS[row.health])


def best_tier(flight: AxisRows) -> str:
    """Returns the best tier of a flight's axes, "a" before "b" before "c"; empty if none is known."""
    known_tiers = [row.tier for row in flight if row.tier]
    return min(known_tiers, default="")


def distinct_flights(flights: Sequence[FlightRows]) -> list[FlightRows]:
    """Returns the flights of one vehicle without duplicates: two logs of one flight, such as tlog and DataFlash.

    Flights that overlap in time are one flight, since a vehicle cannot fly twice at once. Of its logs the one with the
    best tier is returned: tier "a" allows a full model, and the later letters allow less. A flight without a date is
    never taken for a duplicate.

    Args:
        flights: flights of one vehicle, in order of date.

    Returns:
        One entry for each flight, in order of date.
    """
    distinct: list[FlightRows] = []
    for flight in flights:
        if not distinct:
            distinct.append(flight)
            continue
        latest = distinct[-1]
        is_duplicate = overlap_in_time(log_row(latest), log_row(flight))
        if not is_duplicate:
            distinct.append(flight)
        elif _tier_rank(flight) < _tier_rank(latest):
            # The earlier log stays if the tiers are equal.
            distinct[-1] = flight
    return distinct


def overlap_in_time(earlier_row: FlightRow, later_row: FlightRow) -> bool:
    """Returns whether a flight begins before an earlier one has ended; False if a date is not known.

    Args:
        earlier_row: row of the flight that began first.
        later_row: row of the other flight.
    """
    if later_row.date is None or earlier_row.date is None:
        return False
    seconds = (later_row.date - earlier_row.date).total_seconds()
    return seconds < (earlier_row.duration or 0.0)


def _tier_rank(flight: AxisRows) -> str:
    """Returns the key by which flights are ordered from the best tier to the worst; an unknown tier comes last."""
    return best_tier(flight) or "z"
