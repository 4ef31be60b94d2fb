"""Results: the files of a folder that say what is known of a log, or of a fleet: pages, documents and recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mavdem.assessment import Assessment
from mavdem.containers import Names
from mavdem.export.conversion import write_channels
from mavdem.extras import missing_modules
from mavdem.files import write_text_atomically
from mavdem.fleet.row import FlightRows, flights_of, worst_row
from mavdem.fleet.workers import PAGES
from mavdem.report.blocks import Block
from mavdem.report.fleet_page import beside_others, fleet_page, with_top
from mavdem.report.flight_page import review_page

if TYPE_CHECKING:
    from mavdem.view import Target

REPORT_FILE = "report.json"
PAGE_FILE = "report.html"
RECORDING_FILE = "flight.rrd"
RESULT_FILES = ("model.json", REPORT_FILE, PAGE_FILE, RECORDING_FILE, "flight.mcap")


def result_files(assessment: Assessment) -> Names:
    """Returns the ``RESULT_FILES`` that can be written: most need a model, and the recording needs Rerun."""
    if assessment.model is None:
        return (REPORT_FILE, PAGE_FILE)
    return tuple(
        name for name in RESULT_FILES if name != RECORDING_FILE or not missing_modules("view")
    )


def write_result_files(paths: Mapping[str, Path], document: str, assessment: Assessment) -> None:
    """Writes the :func:`result_files`, each to its one of ``paths``, with this ``document`` as report."""
    analysis = assessment.analysis
    paths[REPORT_FILE].write_text(document + "\n")
    paths[PAGE_FILE].write_text(review_page(assessment), "utf-8", "replace")
    if analysis is not None and analysis.learned is not None and analysis.held_out is not None:
        paths["model.json"].write_text(analysis.learned.to_json() + "\n")
        if RECORDING_FILE in paths:
            write_dashboard(paths[RECORDING_FILE], assessment)
        write_channels(
            paths["flight.mcap"],
            analysis.flights,
            analysis.learned,
            analysis.held_out,
            assessment.wind_of_model,
        )


def write_dashboard(target: Target, assessment: Assessment) -> None:
    """Writes an ``assessment`` with a model as an .rrd file, or to a stream."""
    # Rerun takes a second to load, and a flight that cannot be learned needs none of it.
    from mavdem.view import write_recording

    write_recording(target, assessment)


def write_fleet_pages(
    folder: Path, rows: FlightRows, changes: Mapping[str, Sequence[Block]]
) -> Path:
    """Writes and returns the index of a fleet, with ``changes`` since a baseline by vehicle.

    Each flight's page says how the flight differs from the vehicle's others, as the rows say it now. Raises
    ``Unreadable`` where a page cannot be written.
    """
    for flight in flights_of(rows):
        path = folder / PAGES / Path(flight[0].page or "").name
        if path.is_file():
            with path.open(encoding="utf-8", errors="replace") as file:
                start = file.read(1 << 16)  # of what may be long: the headline is in it
                judged = with_top(start, beside_others(worst_row(flight)))
                if judged != start:
                    write_text_atomically(path, judged + file.read())
    index = folder / "index.html"
    write_text_atomically(index, fleet_page(rows, changes))
    return index
