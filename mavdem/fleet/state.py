"""A state of a vehicle, which is compared with another: the flights that a log or a fleet holds of it."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from mavdem.assessment import Assessment
from mavdem.containers import JsonValues
from mavdem.errors import NotLearnable
from mavdem.facts.fleet import Incomparable
from mavdem.fleet.row import UNKNOWN, FlightRows, flights_of
from mavdem.fleet.rows_of_log import rows_of_log
from mavdem.fleet.store import is_fleet, read_rows
from mavdem.ingest.telemetry import Parameters, Telemetry


class VehicleState(NamedTuple):
    """Flights of a vehicle, or of several where none was chosen."""

    rows: FlightRows
    review: JsonValues  # the document of a log; of a fleet nothing
    vehicles: Sequence[Telemetry]  # of a log

    @property
    def names(self) -> set[str]:
        """Vehicles that there are figures of."""
        return {row.vehicle for row in self.rows if row.is_read}

    @property
    def headline(self) -> str | None:
        """That of the latest flight."""
        return flights_of(self.rows)[-1][-1].headline

    @property
    def parameters(self) -> Parameters:
        """Those of the vehicle, of a log; none of a fleet."""
        row = self.rows[0]
        for vehicle in self.vehicles:
            if (vehicle.system, vehicle.component) == (row.system, row.component):
                return vehicle.parameters
        return {}


def state_of(name: str, path: Path, vehicle: str | None = None) -> VehicleState:
    """Returns the flights of a ``vehicle`` in a log or a fleet, which is called ``name``.

    A vehicle has the name that a fleet has for it; in a log it may be system and component. Raises NotLearnable: there
    are no flights of it; Unreadable: the log or the fleet cannot be read.
    """
    is_of_fleet = is_fleet(path)
    state = VehicleState(read_rows(path), {}, ()) if is_of_fleet else _state_of_log(path)
    # A row has the system, not the component.
    system = "" if is_of_fleet else (vehicle or "").partition(":")[0]
    chosen = state._replace(
        rows=[
            row for row in state.rows if vehicle in (None, row.vehicle) or system == str(row.system)
        ]
    )
    if is_of_fleet and chosen.names == {UNKNOWN}:
        raise NotLearnable(Incomparable.VEHICLES_UNKNOWN, subject=name)
    if not chosen.names:
        if vehicle is not None and state.names and not chosen.rows:
            raise NotLearnable(
                Incomparable.VEHICLE_MISSING,
                subject=name,
                name=vehicle,
                names=sorted(state.names),
            )
        because = min((row.status for row in chosen.rows), default=None)
        raise NotLearnable(Incomparable.NO_FLIGHT, subject=name, because=because)
    return chosen


def _state_of_log(path: Path) -> VehicleState:
    review = JsonValues()
    vehicles = list[Telemetry]()

    def keep(_: str, assessment: Assessment) -> str:
        review.update(assessment.as_dict())
        vehicles[:] = assessment.log.vehicles
        return ""

    rows, _ = rows_of_log(path, str(path), keep)
    return VehicleState(rows, review, vehicles)


def of_common_vehicle(
    before: VehicleState, after: VehicleState
) -> tuple[VehicleState, VehicleState]:
    """Returns the flights of the one vehicle that both have; all, where neither has several.

    Raises NotLearnable: both have none, or several.
    """
    if max(len(before.names), len(after.names)) < 2:
        return before, after
    both = (before.names & after.names) - {UNKNOWN}
    if len(both) != 1:
        raise NotLearnable(
            Incomparable.NO_COMMON_VEHICLE,
            shared=len(both),
            names=sorted(before.names | after.names),
        )
    first, second = (
        state._replace(rows=[row for row in state.rows if row.vehicle in both])
        for state in (before, after)
    )
    return first, second
