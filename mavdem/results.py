"""Result files of a log or a fleet: which there are, and how the page, the document and the recordings are written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mavdem.assessment import Assessment
from mavdem.assessment.assess import assess_signals
from mavdem.assessment.axis import Options
from mavdem.containers import JsonValues, Names
from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.signals import Signals
from mavdem.extras import missing_modules, require_extra
from mavdem.files import reporting_write_errors, writable_target, write_text_atomically
from mavdem.ingest import read_log
from mavdem.report.blocks import Block

if TYPE_CHECKING:
    from mavdem.fleet.names import GivenNames
    from mavdem.fleet.row import FlightRows
    from mavdem.fleet.store import Store
    from mavdem.report.vehicle_summary import VehicleSummary
    from mavdem.view import Target

MODEL_FILE = "model.json"
"""Name of the file with the learned model."""

REPORT_FILE = "report.json"
"""Name of the file with the document, as ``--json`` prints it."""

PAGE_FILE = "report.html"
"""Name of the file with the page for a browser."""

RECORDING_FILE = "flight.rrd"
"""Name of the file with the dashboard for the Rerun Viewer."""

CHANNELS_FILE = "flight.mcap"
"""Name of the file with the flight and the model's forecasts as channels for Foxglove and PlotJuggler."""

RECORDINGS = (RECORDING_FILE, CHANNELS_FILE)
"""Names of the files that are written only when they are asked for: most users never open them, and writing both took
as long as everything else that is done for a log of one minute."""

RESULT_FILES = (MODEL_FILE, REPORT_FILE, PAGE_FILE, *RECORDINGS)
"""Names of all files that the results of a log may consist of."""

INDEX_FILE = "index.html"
"""Name of a fleet's index page."""

PAGE_TOP_LENGTH = 1 << 16
"""Characters at the beginning of a flight's page that are searched for its headline; pages can be much longer."""


def result_files(assessment: Assessment, recordings: Names = ()) -> Names:
    """Returns the names of the ``RESULT_FILES`` that are to be written for an assessment, before any is written.

    Without a model there are only the document and the page.

    Args:
        assessment: The assessment.
        recordings: Those of the ``RECORDINGS`` that are asked for.
    """
    if assessment.model is None:
        return (REPORT_FILE, PAGE_FILE)
    return (MODEL_FILE, REPORT_FILE, PAGE_FILE, *recordings)


def possible_recordings() -> Names:
    """Returns those of the ``RECORDINGS`` that can be written here; flight.rrd needs the package ``rerun``."""
    return (CHANNELS_FILE,) if missing_modules("view") else RECORDINGS


def write_result_files(paths: Mapping[str, Path], document: str, assessment: Assessment) -> None:
    """Writes the result files of an assessment: document and page always, with a model also that and recordings.

    Args:
        paths: Path to write to, for each name that :func:`result_files` returns.
        document: Text of the JSON document, which becomes the ``REPORT_FILE``.
        assessment: The assessment that the page, the model and the recordings show.
    """
    # Pages and recordings are imported where they are written: the screen need not wait for it.
    from mavdem.report.pages.flight_page import review_page

    analysis = assessment.analysis
    paths[REPORT_FILE].write_text(document + "\n", "utf-8")
    # The page may contain the name of a file, which need not be valid Unicode.
    paths[PAGE_FILE].write_text(review_page(assessment), "utf-8", "replace")
    # Without a model there is nothing else to write.
    if analysis is None or analysis.learned is None or analysis.held_out is None:
        return
    paths[MODEL_FILE].write_text(analysis.learned.to_json() + "\n", "utf-8")
    write_recordings(paths, assessment)


def write_recordings(paths: Mapping[str, Path], assessment: Assessment) -> None:
    """Writes the recordings of an assessment; without a model there are none.

    Args:
        paths: Path to write to, for each of the ``RECORDINGS`` that is wanted.
        assessment: The assessment.
    """
    analysis = assessment.analysis
    if analysis is None or analysis.learned is None or analysis.held_out is None:
        return
    if RECORDING_FILE in paths:
        write_dashboard(paths[RECORDING_FILE], assessment)
    if CHANNELS_FILE in paths:
        from mavdem.export.mcap_channels import write_channels

        write_channels(
            paths[CHANNELS_FILE],
            analysis.flights,
            analysis.learned,
            analysis.held_out,
            assessment.wind_of_model,
        )


def convert_to_recording(
    source: Path, out: Path, axis: str, vehicle: str | None, inputs: str | None
) -> JsonValues:
    """Learns a model from a log, and writes it with the flight as a recording for Rerun or for Foxglove.

    Args:
        source: The log.
        out: The file to write, .rrd or .mcap, which appears whole or not at all.
        axis, vehicle, inputs: As for :func:`mavdem.read_flight`.

    Returns:
        Plain JSON values of the document of ``mavdem convert``: samples from which the model was learned, their step
        and first and last time, s.

    Raises:
        Unreadable: The log cannot be read, or ``out`` cannot be written.
        NotLearnable: No model can be learned from the log.
        MissingExtra: ``out`` is an .rrd, and Rerun is not installed.
        ValueError: ``out`` is the source.
    """
    ending = out.suffix.lower()
    if ending == Path(RECORDING_FILE).suffix:
        require_extra("view", f"{out}")
    with reporting_write_errors(out):
        # A target that cannot be written is refused before the work.
        writable_target(out)
        if out.exists() and source.exists() and out.samefile(source):
            raise ValueError(f"{out} is the input: name another file")
        log = read_log(source)
        signals = Signals(choose_vehicle(log.vehicles, vehicle))
        assessment = assess_signals(log, signals, axis, Options(inputs=inputs))
        analysis = assessment.analysis
        if analysis is None or assessment.model is None:
            raise assessment.refusal
        file_name = CHANNELS_FILE if ending == Path(CHANNELS_FILE).suffix else RECORDING_FILE
        write_recordings({file_name: out}, assessment)
    flights = analysis.flights
    return {
        "source": str(source),
        "out": str(out),
        "samples": sum(len(flight.time) for flight in flights),
        "dt": flights[0].dt,
        "start": float(flights[0].time[0]),
        "end": float(flights[-1].time[-1]),
        "learnable": True,
        "cautions": [str(caution) for caution in analysis.learnability.cautions],
    }


def write_dashboard(target: Target, assessment: Assessment) -> None:
    """Writes the Rerun recording of an assessment that has a model.

    Args:
        target: Path of an .rrd file, or a recording that is streamed to a viewer.
        assessment: The assessment.
    """
    # Rerun takes a second to import, and is not needed where nothing can be learned from a flight.
    from mavdem.view import write_recording

    write_recording(target, assessment)


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

    The page of each flight states how the flight differs from others of its vehicle. That may change when flights are
    added, and is updated on all pages of the vehicle. What the index shows of vehicles that were not judged since it
    was last written is kept in the store.

    Args:
        store: The open store of the fleet.
        changes: Changes of each vehicle since a baseline, as blocks of text, by the vehicle's name.

    Raises:
        Unreadable: A page cannot be written.
    """
    # Imported here, so that the results of a single log need nothing of fleets.
    from mavdem.fleet.judgement import mark_pages_updated, outdated_vehicles
    from mavdem.fleet.names import read_names
    from mavdem.fleet.page_parts import kept_charts, kept_summaries
    from mavdem.fleet.stored_rows import read_brief_rows, read_rows
    from mavdem.report.pages.fleet_page import fleet_page, vehicle_charts
    from mavdem.report.vehicle_summary import (
        SUMMARY_VERSION,
        summary_adapter,
        summary_of_vehicle,
    )

    folder = store.folder

    def make_summary(vehicle: str) -> str:
        """Returns the summary of a vehicle as JSON."""
        summary = summary_of_vehicle(vehicle, read_brief_rows(folder, vehicle))
        return summary_adapter().dump_json(summary).decode()

    def charts(vehicle: str) -> str:
        """Returns the charts of a vehicle as HTML."""
        return kept_charts(store, vehicle, lambda name: vehicle_charts(read_rows(folder, name)))

    outdated = outdated_vehicles(store)
    for vehicle in outdated:
        _update_flight_pages(folder, read_brief_rows(folder, vehicle))
    texts = kept_summaries(store, SUMMARY_VERSION, outdated, make_summary)
    summaries = [summary_adapter().validate_json(text) for text in texts]
    names = read_names(store.db)
    index = folder / INDEX_FILE
    write_text_atomically(index, fleet_page(summaries, changes, charts, names))
    mark_pages_updated(store, outdated)
    return FleetPages(index, summaries, names)


def _update_flight_pages(folder: Path, rows: FlightRows) -> None:
    """Updates the pages of a vehicle's flights.

    Args:
        folder: Folder of the fleet.
        rows: Rows of the vehicle.

    Raises:
        Unreadable: A page cannot be written.
    """
    from mavdem.fleet.flights import flights_of, worst_row
    from mavdem.fleet.workers import PAGES
    from mavdem.report.pages.fleet_page import fleet_remark

    for flight_rows in flights_of(row for row in rows if row.page):
        path = folder / PAGES / Path(flight_rows[0].page or "").name
        if path.is_file():
            _update_flight_page(path, fleet_remark(worst_row(flight_rows)))


def _update_flight_page(path: Path, comparison: str) -> None:
    """Replaces the comparison with other flights at the top of a flight's page.

    Pages may be long, so that only their top is searched, and a page on which nothing changes is not written again.

    Args:
        path: Path of the page.
        comparison: HTML of the comparison.

    Raises:
        Unreadable: The page cannot be written.
    """
    from mavdem.report.pages.fleet_page import with_fleet_remark

    with path.open(encoding="utf-8", errors="replace") as file:
        top = file.read(PAGE_TOP_LENGTH)
        updated_top = with_fleet_remark(top, comparison)
        if updated_top != top:
            write_text_atomically(path, updated_top + file.read())
