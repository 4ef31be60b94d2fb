"""State of a vehicle: its flights in a log or a fleet. ``mavdem diff`` compares two states."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import date, datetime
from functools import partial
from pathlib import Path
from typing import NamedTuple

from mavdem.assessment import Assessment
from mavdem.containers import JsonValues
from mavdem.errors import NotLearnable
from mavdem.facts.fleet import Incomparable
from mavdem.fleet.flights import group_into_flights, worst_row
from mavdem.fleet.judgement import assess_safely
from mavdem.fleet.parameter_changes import changed_parameters
from mavdem.fleet.parameter_text import parse_parameters
from mavdem.fleet.row import UNKNOWN, FlightRow, FlightRows
from mavdem.fleet.rows_of_log import rows_of_log
from mavdem.fleet.stored_rows import is_fleet, read_baseline, read_brief_rows, read_rows
from mavdem.fleet.tracking import RowKey, assess_rows, row_key, rows_without_health
from mavdem.fleet.workers import content_key
from mavdem.ingest.telemetry import Parameters, Telemetry


class Days(NamedTuple):
    """The days from a first to a last one, both included."""

    first: date
    """The first day, UTC."""
    last: date
    """The last day, UTC."""

    def include(self, row: FlightRow) -> bool:
        """Returns whether a flight began on one of these days; a flight without a date did not."""
        return row.date is not None and self.first <= row.date.date() <= self.last


class VehicleState(NamedTuple):
    """One side of a comparison: the flights of a vehicle in a log or a fleet, or of several until one is chosen."""

    rows: FlightRows
    """a row for each flight and axis"""
    review: JsonValues
    """the document of ``mavdem review`` of a log; empty of a fleet"""
    vehicles: Sequence[Telemetry]
    """the vehicles of a log; none of a fleet"""
    fleet_rows: Sequence[FlightRow] = ()
    """rows of all flights of the vehicle in its fleet, also of other days; empty of a log"""
    baseline: Sequence[FlightRow] = ()
    """rows of the healthy flights of its fleet; empty without a baseline, and of a log"""

    @property
    def names(self) -> set[str]:
        """The names of the vehicles whose flights have figures."""
        return {row.vehicle for row in self.rows if row.is_read}

    @property
    def headline(self) -> str | None:
        """The headline of the latest flight."""
        latest_flight = group_into_flights(self.rows)[-1]
        return latest_flight[-1].headline

    @property
    def parameters(self) -> Parameters:
        """The autopilot's parameters of the vehicle by name; of a fleet, which stores no others, those of control.

        A parameter that was changed between flights of a fleet has no single value, and is left out.
        """
        if self.telemetry is not None:
            return self.telemetry.parameters
        parameters_of_flights = [_control_parameters(row) for row in self.rows if row.is_read]
        if not parameters_of_flights:
            return {}
        values_by_name = dict(parameters_of_flights[0])
        for parameters in parameters_of_flights[1:]:
            changed_names = {
                change.name for change in changed_parameters(values_by_name, parameters)
            }
            for name in changed_names | (values_by_name.keys() - parameters.keys()):
                del values_by_name[name]
        return values_by_name

    @property
    def telemetry(self) -> Telemetry | None:
        """The messages of the vehicle in its log; None if the flights are of a fleet, which stores no messages.

        A log may have several vehicles. The MAVLink system and component in the first row of the flights say which one
        is meant.
        """
        first_row = self.rows[0]
        for vehicle in self.vehicles:
            has_same_ids = vehicle.system == first_row.system
            if has_same_ids and vehicle.component == first_row.component:
                return vehicle
        return None

    def with_vehicles(self, names: set[str]) -> "VehicleState":
        """Returns the flights of the vehicles with these names."""
        return self._replace(rows=[row for row in self.rows if row.vehicle in names])


def state_of(
    name: str, path: Path, vehicle: str | None = None, days: Days | None = None
) -> VehicleState:
    """Returns the flights of a vehicle in a log or a fleet: one of the two states that ``mavdem diff`` compares.

    Args:
        name: name of the log or the fleet in messages.
        path: path of the log, or of the folder of the fleet.
        vehicle: name of the vehicle, as a fleet has it; in a log also "system:component". All vehicles unless given.
        days: days whose flights count; all days unless given.

    Returns:
        The flights, with the document of the review where they are of a log.

    Raises:
        NotLearnable: there are no flights of the vehicle.
        Unreadable: the log or the fleet cannot be read.
    """
    comes_from_fleet = is_fleet(path)
    state = _state_of_fleet(path, vehicle) if comes_from_fleet else state_of_log(path)
    # The name "1:1" of a vehicle in a log begins with its system id, which its rows have without the component.
    system_id = "" if comes_from_fleet else (vehicle or "").partition(":")[0]
    chosen_rows = []
    for row in state.rows:
        is_of_vehicle = vehicle is None or row.vehicle == vehicle or str(row.system) == system_id
        if is_of_vehicle and (days is None or days.include(row)):
            chosen_rows.append(row)
    chosen_state = state._replace(rows=chosen_rows)
    if comes_from_fleet and chosen_state.names == {UNKNOWN}:
        raise NotLearnable(Incomparable.VEHICLES_UNKNOWN, subject=name)
    if chosen_state.names:
        return chosen_state
    # Other vehicles have flights, but there is none of this name, not even a row without a flight.
    is_name_wrong = vehicle is not None and bool(state.names) and vehicle not in state.names
    if is_name_wrong and not chosen_rows:
        raise NotLearnable(
            Incomparable.VEHICLE_MISSING, subject=name, name=vehicle, names=sorted(state.names)
        )
    reason = min((row.status for row in chosen_rows), default=None)
    raise NotLearnable(Incomparable.NO_FLIGHT, subject=name, reason=reason)


def _state_of_fleet(folder: Path, vehicle: str | None) -> VehicleState:
    """Returns the flights of a vehicle in a fleet, or those of all vehicles if there is none of this name.

    The flights of all vehicles have the names that an error message then lists.

    Args:
        folder: folder of the fleet.
        vehicle: name of the vehicle; None for all.
    """
    rows = read_rows(folder, vehicle) or read_brief_rows(folder)
    return VehicleState(
        rows, review={}, vehicles=(), fleet_rows=rows, baseline=read_baseline(folder)
    )


def state_of_log(path: Path) -> VehicleState:
    """Returns the flights of all vehicles of a log, with the document of its review.

    Args:
        path: the log.

    Returns:
        The state: rows of the flights, the document of the review, and the messages of the vehicles.

    Raises:
        Unreadable: the log cannot be read.
    """
    assessments: list[Assessment] = []

    def keep_assessment(_: str, assessment: Assessment) -> str:
        """Stores the assessment of a vehicle, and returns an empty page: none is needed here."""
        assessments.append(assessment)
        return ""

    rows, _ = rows_of_log(path, str(path), keep_assessment)
    # A recording that is a folder of files has no content of its own.
    if path.is_file():
        key = content_key(path)
        rows = [replace(row, key=key) for row in rows]
    review = JsonValues()
    vehicles: Sequence[Telemetry] = ()
    # Each vehicle of the log that has a flight was assessed. Of several, the last one counts.
    for assessment in assessments:
        review.update(assessment.as_dict())
        vehicles = assessment.log.vehicles
    return VehicleState(rows, review, vehicles)


def with_motors_judged(
    before: VehicleState, after: VehicleState
) -> tuple[VehicleState, VehicleState]:
    """Judges the motors in all flights of both states together, as ``mavdem track`` judges the flights of a vehicle.

    Each fleet has judged its own flights already, but only among themselves: if all are weak, they seem healthy. So the
    flights are judged again, together with all flights of the vehicle in both fleets, by comparison with their
    baselines or, without any, with the first sound flights. If one state is older than the other, only flights before
    the newer one count as healthy, since its own would hide what changed. Flights of different vehicles are not judged
    again.

    Args:
        before: flights of the first state.
        after: flights of the second state.

    Returns:
        The first and the second state, with the health of the motors in the rows of their flights.
    """
    names = before.names | after.names
    if len(names) != 1 or UNKNOWN in names:
        return before, after
    [vehicle] = names
    all_rows = [*before.rows, *before.fleet_rows, *after.rows, *after.fleet_rows]
    rows_by_key = _distinct_rows_of_vehicle(all_rows, vehicle)
    baseline_by_key = _distinct_rows_of_vehicle([*before.baseline, *after.baseline], vehicle)
    rows = list(rows_by_key.values())
    start = _start_of_newer_state(before, after)
    candidates = None
    if start is not None:
        candidates = [row for row in rows if row.date is not None and row.date < start]
    judged_rows = assess_safely(
        rows, partial(assess_rows, candidates=candidates), list(baseline_by_key.values())
    )
    judged_by_key = dict(zip(rows_by_key, judged_rows, strict=True))
    judged_before = [judged_by_key.get(row_key(row), row) for row in before.rows]
    judged_after = [judged_by_key.get(row_key(row), row) for row in after.rows]
    return before._replace(rows=judged_before), after._replace(rows=judged_after)


def _distinct_rows_of_vehicle(rows: Iterable[FlightRow], vehicle: str) -> dict[RowKey, FlightRow]:
    """Returns the rows of one vehicle by flight and axis; of copies of a flight, only the first.

    Args:
        rows: rows of the fleet's table. A flight may be among them twice, as one that is in both compared states.
        vehicle: name of the vehicle.
    """
    rows_by_key: dict[RowKey, FlightRow] = {}
    for row in rows:
        if row.vehicle == vehicle:
            rows_by_key.setdefault(row_key(row), row)
    return rows_by_key


def _start_of_newer_state(before: VehicleState, after: VehicleState) -> datetime | None:
    """Returns when the first flight of the newer of two states began.

    Returns:
        The time; None if neither state is older than the other, since their flights are mixed in time or a date is not
        known.
    """
    spans = []
    for state in (before, after):
        dates = [row.date for row in state.rows if row.is_read]
        known_dates = [start for start in dates if start is not None]
        if not known_dates or len(known_dates) < len(dates):
            return None
        spans.append((min(known_dates), max(known_dates)))
    (first_of_before, last_of_before), (first_of_after, last_of_after) = spans
    if last_of_before < first_of_after:
        return first_of_after
    if last_of_after < first_of_before:
        return first_of_before
    return None


def rows_judged_by_each_other(
    before: FlightRows, after: FlightRows
) -> tuple[FlightRows, FlightRows]:
    """Judges the motors of two logs by comparison with each other, and with no third flight of the vehicle.

    The health of motors shows only in several flights of one vehicle, so that the flights of both logs are judged
    together. Logs of different vehicles cannot be; their motors then have no health by comparison.

    Args:
        before: rows of the first log in the fleet's table. They may have been judged with other flights as well, which
            does not count here.
        after: rows of the second log.

    Returns:
        The rows of the first and of the second log, in their order, with the health of the motors.
    """
    vehicle_names = {row.vehicle for row in (*before, *after) if row.is_read}
    are_of_one_vehicle = len(vehicle_names) == 1 and UNKNOWN not in vehicle_names
    if not are_of_one_vehicle:
        return rows_without_health(before), rows_without_health(after)
    # Neither of two logs is a baseline that is known to be healthy.
    judged_rows = assess_safely([*before, *after], assess_rows, healthy_rows=[])
    return judged_rows[: len(before)], judged_rows[len(before) :]


def rows_with_known_health(library_rows: FlightRows, pair_rows: FlightRows) -> FlightRows:
    """Returns the rows of a compared flight with the health of its motors by as many other flights as possible.

    Args:
        library_rows: rows of the flight, with the health by all flights of its vehicle in the library.
        pair_rows: the same rows, with the health by the two compared flights alone.

    Returns:
        The rows of the library. If the library has not judged the motors, the rows of the pair.
    """
    if any(row.health != UNKNOWN for row in library_rows):
        return library_rows
    return pair_rows


def motors_by_pair(rows: FlightRows, pair_rows: FlightRows) -> str:
    """Returns how the motors are judged by two flights alone, if all flights of the vehicle give another judgement.

    The page that compares two flights first states the judgement by all flights of the vehicle, which is more certain.
    This text is added below it.

    Args:
        rows: rows of the later flight in the table of flights, with the judgement that the page states first.
        pair_rows: the same rows with the judgement by the two flights alone; empty if there is none.

    Returns:
        The judgement by the two flights, in sentences. Empty if it leaves the health of the motors unknown, or has the
        same finding on the same motor as the first judgement: then only the probabilities differ.
    """
    if not pair_rows:
        return ""
    row = worst_row(rows)
    pair_row = worst_row(pair_rows)
    is_same_finding = (
        pair_row.health_code == row.health_code and pair_row.suspect_motor == row.suspect_motor
    )
    if pair_row.health == UNKNOWN or is_same_finding:
        return ""
    return pair_row.health_reason or ""


def states_of_common_vehicle(
    before: VehicleState, after: VehicleState
) -> tuple[VehicleState, VehicleState]:
    """Reduces two states to the flights of the one vehicle that both have.

    Two states of one vehicle each are compared as they are, even if these vehicles differ. If one of the states has
    several vehicles, exactly one must be common to both.

    Args:
        before: flights and parameters of the first state.
        after: flights and parameters of the second state.

    Returns:
        The first and the second state, with the flights to compare.

    Raises:
        NotLearnable: the states have no vehicle in common, or several.
    """
    is_each_of_one_vehicle = len(before.names) < 2 and len(after.names) < 2
    if is_each_of_one_vehicle:
        return before, after
    common_names = (before.names & after.names) - {UNKNOWN}
    if len(common_names) != 1:
        raise NotLearnable(
            Incomparable.NO_COMMON_VEHICLE,
            shared=len(common_names),
            names=sorted(before.names | after.names),
        )
    return before.with_vehicles(common_names), after.with_vehicles(common_names)


def _control_parameters(row: FlightRow) -> Parameters:
    """Returns the control parameters of a flight by name; empty if its row has none, or damaged ones."""
    return parse_parameters(row.control_parameters or "{}") or {}
