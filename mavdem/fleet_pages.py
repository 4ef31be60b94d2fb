"""The pages of a fleet's folder: the index page is written, and the pages of its flights are updated."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from mavdem.files import write_text_atomically
from mavdem.fleet.flights import group_into_flights, worst_row
from mavdem.fleet.judgement import mark_pages_updated, outdated_vehicles
from mavdem.fleet.names import GivenNames, read_names
from mavdem.fleet.page_parts import cached_charts, cached_summaries
from mavdem.fleet.row import FlightRows
from mavdem.fleet.store import Store
from mavdem.fleet.stored_rows import read_brief_rows, read_rows
from mavdem.fleet.tracking import healthy_figures_by_log
from mavdem.fleet.workers import PAGES
from mavdem.report.blocks import Block
from mavdem.report.pages.fleet_page import fleet_page, vehicle_charts
from mavdem.report.pages.motor_anomaly import (
    MotorAnomaly,
    motor_anomaly,
    with_motor_anomaly,
)
from mavdem.report.vehicle_summary import (
    SUMMARY_VERSION,
    VehicleSummary,
    summary_adapter,
    summary_of_vehicle,
)

INDEX_FILE = "index.html"
"""Name of a fleet's index page."""

PAGE_TOP_LENGTH = 1 << 16
"""Characters at the beginning of a flight's page that are searched for its headline; pages can be much longer."""


@dataclass(frozen=True)
class FleetPages:
    """The pages of a fleet that were written."""

    index: Path
    """Path of the index page."""
    summaries: Sequence[VehicleSummary]
    """What the index page shows of the flights under each name."""
    names: GivenNames
    """Names that were given to vehicles and flights."""


def write_fleet_pages(store: Store, changes: Mapping[str, Sequence[Block]]) -> FleetPages:
    """Writes the index page of a fleet, and updates the pages of its flights.

    The page of each flight states how the flight differs from others of its vehicle. This comparison may change when
    flights are added, and is updated on all pages of the vehicle. For vehicles without new results since the index was
    last written, their parts of the index are taken from the store.

    Args:
        store: The open SQLite store of the fleet, with the rows of all logs.
        changes: Changes of each vehicle since a baseline, as blocks of text, by the vehicle's name.

    Returns:
        Path of the index page, the summary of each vehicle, and the names that users gave.

    Raises:
        Unreadable: A page cannot be written.
    """
    folder = store.folder
    outdated_names = outdated_vehicles(store)
    for vehicle in outdated_names:
        _update_flight_pages(folder, read_brief_rows(folder, vehicle))
    summaries = _cached_summaries(store, outdated_names)
    names = read_names(store.db)
    index = folder / INDEX_FILE
    charts = partial(_charts_html, store)
    write_text_atomically(index, fleet_page(summaries, changes, charts, names))
    mark_pages_updated(store, outdated_names)
    return FleetPages(index, summaries, names)


def _cached_summaries(store: Store, outdated_names: Collection[str]) -> list[VehicleSummary]:
    """Returns the summary of each vehicle for the index page, from the store if it is kept there and up to date.

    Args:
        store: The open SQLite store of the fleet, with the rows of all logs.
        outdated_names: Names of the vehicles with new results, whose summaries are made again.
    """
    summary_json = partial(_summary_json, store.folder)
    texts = cached_summaries(store, SUMMARY_VERSION, outdated_names, summary_json)
    try:
        return _read_summaries(texts)
    except ValueError:
        # A stored summary is damaged. All summaries are made from the rows again.
        all_names = [name for (name,) in store.db.execute("select vehicle from vehicle_parts")]
        return _read_summaries(cached_summaries(store, SUMMARY_VERSION, all_names, summary_json))


def _summary_json(folder: Path, vehicle: str) -> str:
    """Returns the summary of a vehicle as JSON.

    Args:
        folder: Folder of the fleet, with its SQLite store, its table and its pages.
        vehicle: Name of the vehicle.
    """
    summary = summary_of_vehicle(vehicle, read_brief_rows(folder, vehicle))
    return summary_adapter().dump_json(summary).decode()


def _charts_html(store: Store, vehicle: str) -> str:
    """Returns the charts of a vehicle as HTML, from the store if they are kept there.

    Args:
        store: The open SQLite store of the fleet, with the rows of all logs.
        vehicle: Name of the vehicle.
    """

    def draw_charts(name: str) -> str:
        """Draws the charts anew, from the rows of all flights."""
        rows = read_rows(store.folder, name)
        baseline_rows = [row for row in store.healthy if row.vehicle == name]
        return vehicle_charts(rows, healthy_figures_by_log(rows, baseline_rows))

    return cached_charts(store, vehicle, draw_charts)


def _read_summaries(texts: Iterable[str]) -> list[VehicleSummary]:
    """Returns the summaries of vehicles that were kept as JSON.

    Raises:
        ValueError: A text is damaged: pydantic's errors of validation are of this class.
    """
    return [summary_adapter().validate_json(text) for text in texts]


def _update_flight_pages(folder: Path, rows: FlightRows) -> None:
    """Updates the pages of a vehicle's flights.

    Args:
        folder: Folder of the fleet, with its SQLite store, its table and its pages.
        rows: Rows of the vehicle, one for each axis of each flight.

    Raises:
        Unreadable: A page cannot be written.
    """
    rows_with_page = [row for row in rows if row.page]
    for flight_rows in group_into_flights(rows_with_page):
        page = flight_rows[0].page or ""
        path = folder / PAGES / Path(page).name
        # Somebody may have deleted the page.
        if path.is_file():
            anomaly = motor_anomaly(worst_row(flight_rows))
            _update_flight_page(path, anomaly)


def _update_flight_page(path: Path, anomaly: MotorAnomaly | None) -> None:
    """Replaces the comparison with other flights at the top of a flight's page.

    Pages may be long, so only their top is searched, and an unchanged page is not written again.

    Args:
        path: Path of the page.
        anomaly: anomaly of the motors that the comparison shows; None without any.

    Raises:
        Unreadable: The page cannot be written.
    """
    with path.open(encoding="utf-8", errors="replace") as file:
        top = file.read(PAGE_TOP_LENGTH)
        updated_top = with_motor_anomaly(top, anomaly)
        if updated_top != top:
            write_text_atomically(path, updated_top + file.read())
