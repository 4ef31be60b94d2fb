"""Flights that belong to both of two compared states: each is counted in one of them alone.

The estimates of both states must be independent of each other, and a flight does not differ from itself.
"""

from pathlib import PurePath
from typing import NamedTuple

from mavdem.containers import Names
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.flights import AxisRows, Flights, group_into_flights, log_row, overlap_in_time
from mavdem.fleet.row import FlightRow
from mavdem.fleet.state import VehicleState


class SeparateStates(NamedTuple):
    """Two states of a vehicle without flights that belong to both."""

    before: VehicleState
    """The first state."""

    after: VehicleState
    """The second state."""

    common_files: Names = ()
    """File names of the flights that belonged to both."""

    counting_state: str = ""
    """State that keeps these flights, "A" or "B"; empty if there are none, or if all flights belong to both."""


def separate_states(before: VehicleState, after: VehicleState) -> SeparateStates:
    """Leaves the flights that belong to both states out of one of them.

    They are left out of the state with more flights, so that the other keeps them, as the latest log does when it is
    compared with the fleet that has it already. Of two states with as many flights the first loses them. If all flights
    belong to both states, none is left out.

    Args:
        before: flights of the first state.
        after: flights of the second state.

    Returns:
        Both states, of which none loses all its flights.
    """
    name_before, name_after = STATE_NAMES
    flights_before = group_into_flights(row for row in before.rows if row.is_read)
    flights_after = group_into_flights(row for row in after.rows if row.is_read)
    common_before = _flights_in_common(flights_before, flights_after)
    if not common_before:
        return SeparateStates(before, after)
    common_after = _flights_in_common(flights_after, flights_before)
    common_files = tuple(PurePath(log_row(flight).file).name for flight in common_before)
    is_first_covered = len(common_before) == len(flights_before)
    is_second_covered = len(common_after) == len(flights_after)
    if is_first_covered and is_second_covered:
        return SeparateStates(before, after, common_files)
    if len(flights_before) >= len(flights_after):
        before = _without_flights(before, common_before)
        return SeparateStates(before, after, common_files, counting_state=name_after)
    after = _without_flights(after, common_after)
    return SeparateStates(before, after, common_files, counting_state=name_before)


def _flights_in_common(flights: Flights, other_flights: Flights) -> list[AxisRows]:
    """Returns those of some flights that are among others, too."""
    common = []
    for flight in flights:
        if any(_is_same_flight(log_row(flight), log_row(other)) for other in other_flights):
            common.append(flight)
    return common


def _is_same_flight(row: FlightRow, other_row: FlightRow) -> bool:
    """Returns whether two rows are of one flight: of copies of a log, or of two recordings of the flight.

    A vehicle cannot fly twice at once, so that flights which overlap in time are one. That says nothing of vehicles
    without a name of their own, since many share a MAVLink system id, nor of a simulator, whose clock is not real.
    """
    if row.key and row.key == other_row.key:
        return (row.system, row.component) == (other_row.system, other_row.component)
    if row.vehicle != other_row.vehicle or not row.has_own_name or row.simulated:
        return False
    # Whichever of both begins first, the other one begins before its end.
    return overlap_in_time(row, other_row) and overlap_in_time(other_row, row)


def _without_flights(state: VehicleState, flights: list[AxisRows]) -> VehicleState:
    """Returns a state without the rows of some of its flights."""
    left_out = [row for flight in flights for row in flight]
    return state._replace(rows=[row for row in state.rows if row not in left_out])
