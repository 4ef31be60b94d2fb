"""Reading one log for the library, in a worker process: its rows with status lights, and its folder of result files.

The folder is made under a hidden name and renamed when it is complete. Meanwhile a progress file in it has the stage of
the work and what is known of the log so far, for the pages of those who wait.
"""

import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir, contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mavdem.assessment import Assessment
from mavdem.assessment.assess import assess_recording
from mavdem.assessment.flown_flights import flown_flights
from mavdem.assessment.reported import reported_events
from mavdem.assessment.time_history import time_history
from mavdem.containers import JsonValues
from mavdem.dataset.signals import Signals
from mavdem.documents import complete_document
from mavdem.documents.review import review_document
from mavdem.errors import Unreadable
from mavdem.facts.fleet import ReadingFact
from mavdem.facts.serve import Stage
from mavdem.files import atomic_write
from mavdem.fleet.judgement import publish_judgements
from mavdem.fleet.row import FlightRows
from mavdem.fleet.rows_of_log import rows_of_assessment
from mavdem.fleet.store import open_store
from mavdem.fleet.tracking import assess_rows
from mavdem.fleet.workers import LogRows
from mavdem.ingest import read_log
from mavdem.ingest.telemetry import Log
from mavdem.processes import lower_priority
from mavdem.report.charts.comparison_charts import flight_series
from mavdem.report.pages.flight_page import review_page
from mavdem.report.pages.library_page import first_plots
from mavdem.report.templates import Medium, sentences_for
from mavdem.results import PAGE_FILE, possible_recordings, result_files, write_result_files
from mavdem.serve.index import columns_of_flight, vehicle_page_name
from mavdem.serve.stored_files import FIRST_PLOTS, PROGRESS, RESULTS
from mavdem.serve.stored_parameters import write_parameters
from mavdem.serve.stored_series import write_series
from mavdem.wind_velocity.from_log import UNKNOWN_WIND

LOWER_PRIORITY = 5
"""Nice value of the worker processes: the server, which answers users, goes first (0 is normal, 19 the lowest)."""

ADDITIONAL_AXIS = "pitch"
"""Axis that is assessed besides roll, which every assessment has."""


class AssessedVehicle(NamedTuple):
    """One vehicle of a log with its results."""

    assessment: Assessment
    """assessment of its flight"""
    rows: FlightRows
    """its rows for the fleet, one for each axis"""


class ProgressFile:
    """The JSON file in which a worker process reports how far its work on a log is.

    Besides columns of the library's index it has the keys ``started``, UNIX time, s; ``step``, in words; ``share`` of
    the step that is done, 0 to 1, or null if that is not known; and ``has_plots``, whether the first plots can be seen.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._values: JsonValues = {"started": time.time()}

    def report(self, stage: Stage, **values: Any) -> None:
        """Writes the stage of the work, and what is known now.

        Args:
            stage: the stage, such as reading or judging.
            **values: further keys of the file, mostly columns of the library's index.
        """
        self._write(stage=stage, step="", share=None, **values)

    @contextmanager
    def show_step(self, title: str, *, measured: bool = True) -> Iterator[Callable[[float], None]]:
        """Writes a step of the work into the file, and how much of it is done while the block of the caller runs.

        The assessment of a flight calls this for each of its steps (``mavdem.assessment.axis.options.ShowStep``).

        Args:
            title: the step in words.
            measured: whether the block reports its progress. Without it, no share is shown.

        Yields:
            A function that takes the share of the step that is done, 0 to 1.
        """
        self._write(step=title, share=0.0 if measured else None)
        yield lambda share: self._write(share=share)

    def _write(self, **values: Any) -> None:
        """Sets values by their keys, and writes the file with all values so far."""
        self._values.update(values)
        with atomic_write(self._path) as file:
            file.write(json.dumps(self._values).encode())


def read_stored_log(path: Path) -> Log:
    """Reads a log of the library from within its folder, by its name alone.

    The results show the path by which a log was read: visitors must not see the folders of the server's machine.

    Args:
        path: path of the log, ``FOLDER/logs/DIGEST/NAME``.

    Returns:
        The log, with at least one vehicle.

    Raises:
        Unreadable: the log cannot be read, or has no vehicle.
    """
    with chdir(path.parent):
        log = read_log(path.name)
    if not log.vehicles:
        raise Unreadable(ReadingFact.NO_VEHICLE)
    return log


def read_for_library(path: Path, key: str, page: object) -> LogRows:
    """Reads a log of the library and writes its folder of results; a ``ReadLog`` function for worker processes.

    Its stages are reported in the progress file: reading, judging, learning, drawing. If the log has several vehicles,
    the main page and the document are about the vehicle whose flight was judged worst, and each other vehicle has a
    page ``vehicle_SYSTEM_COMPONENT.html``.

    Args:
        path: path of the log, ``FOLDER/logs/DIGEST/NAME``.
        key: key of its content. It is not used, but each ``ReadLog`` function has it.
        page: maker of a page; the same holds.

    Returns:
        The rows of all vehicles for the fleet's table, and no pages, since they are in the folder of results.

    Raises:
        Unreadable: the log cannot be read, or has no vehicle.
    """
    lower_priority(LOWER_PRIORITY)
    # FOLDER is two levels above the folder of the log.
    results = path.parents[2] / RESULTS
    digest = path.parent.name
    unfinished_folder = results / f".{digest}"
    shutil.rmtree(unfinished_folder, ignore_errors=True)
    unfinished_folder.mkdir()
    progress = ProgressFile(unfinished_folder / PROGRESS)
    progress.report(Stage.READING)
    log = read_stored_log(path)
    _write_first_plots(log, unfinished_folder / FIRST_PLOTS)
    progress.report(Stage.JUDGING, has_plots=(unfinished_folder / FIRST_PLOTS).is_file())
    vehicles = _assessed_vehicles(log, progress)
    rows: FlightRows = []
    for vehicle in vehicles:
        rows += vehicle.rows
    progress.report(Stage.DRAWING, **_index_columns(vehicles[0].assessment, rows))
    names = _write_results(vehicles, unfinished_folder)
    progress.report(Stage.DRAWING, files=",".join(names))
    (unfinished_folder / FIRST_PLOTS).unlink(missing_ok=True)
    # Results of an earlier reading of the same log may be there.
    shutil.rmtree(results / digest, ignore_errors=True)
    os.replace(unfinished_folder, results / digest)
    page_path = f"{RESULTS}/{digest}/{PAGE_FILE}"
    return LogRows([replace(row, page=page_path) for row in rows], pages={})


def publish_table(path: Path, key: str, page: object) -> LogRows:
    """Judges the vehicles of the library again and writes the fleet's table.

    It reads no log, but has the arguments of a ``ReadLog`` function, so that a worker process runs it as it reads logs:
    within limits of time and memory, and without taking processor time from the server's own process.

    Args:
        path: path of the file of the server, ``FOLDER/servers/NAME``, of which only the folder is used.
        key: not used.
        page: not used.

    Returns:
        No rows and no pages.
    """
    library_folder = path.parents[1]
    with open_store(library_folder) as store:
        publish_judgements(store, assess_rows)
    return LogRows(rows=[], pages={})


# Damaged messages hold infinite numbers and NaN.
@np.errstate(all="ignore")
def _write_first_plots(log: Log, path: Path) -> None:
    """Writes plots of a flight over time, which are shown until its assessment is complete.

    The assessment takes ten times as long as the reading. The plots show the first vehicle of the log with a time
    history; no file is written if none has one.

    Args:
        log: the log of a flight, with the messages of each vehicle.
        path: path of the file with the HTML of the plots.
    """
    for telemetry in log.vehicles:
        signals = Signals(telemetry)
        history = time_history(
            signals, (), UNKNOWN_WIND, reported_events(signals), has_all_flights=True
        )
        if history is not None:
            path.write_text(first_plots(history), "utf-8", "replace")
            return


def _assessed_vehicles(log: Log, progress: ProgressFile) -> list[AssessedVehicle]:
    """Assesses the flight of each vehicle of a log and reports the progress.

    Args:
        log: the log, with at least one vehicle.
        progress: file that receives the stages and, as soon as they are known, the sentences and levels of each
            assessment.

    Returns:
        The vehicles in the order of descending severity.
    """
    vehicles = []
    for telemetry in log.vehicles:
        progress.report(Stage.JUDGING)
        assessment = assess_recording(log, Signals(telemetry), progress=progress.show_step)
        progress.report(Stage.LEARNING, **_assessment_columns(assessment))
        rows = rows_of_assessment(assessment.with_axis(ADDITIONAL_AXIS), log.source)
        vehicles.append(AssessedVehicle(assessment, rows))
    return sorted(vehicles, key=lambda vehicle: vehicle.assessment.severity_key)


def _write_results(vehicles: Sequence[AssessedVehicle], folder: Path) -> list[str]:
    """Writes the result files of a log into a folder: all files of the first vehicle, and a page of each other one.

    Recordings are not written, since they are made on request (``mavdem.serve.recordings``).

    Args:
        vehicles: the vehicles of the log, the one with the worst judgement first.
        folder: the folder that the result files are written to.

    Returns:
        Names of the files, and of the recordings that can be made.
    """
    assessment = vehicles[0].assessment
    # The document of the review lists its files by name with their paths, which here are the names themselves.
    files = {name: name for name in result_files(assessment, possible_recordings())}
    for vehicle in vehicles[1:]:
        first_row = vehicle.rows[0]
        page_name = vehicle_page_name(f"{first_row.system}_{first_row.component}")
        files[page_name] = page_name
        html = review_page(vehicle.assessment)
        (folder / page_name).write_text(html, "utf-8", "replace")
    document = complete_document("review", review_document(assessment) | {"files": files})
    paths = {name: folder / name for name in result_files(assessment)}
    write_result_files(paths, json.dumps(document, indent=1, allow_nan=False), assessment)
    # Only an assessment in which no vehicle was judged has no evidence.
    assert assessment.evidence is not None
    write_series(folder, flight_series(assessment.evidence.signals))
    write_parameters(folder, assessment.evidence.signals.telemetry.parameters)
    return list(files)


def _assessment_columns(assessment: Assessment) -> dict[str, str]:
    """Returns the columns of the library's index that follow from an assessment: its sentences and status lights.

    A light judges one part of the vehicle or the flight, such as "motors": by a level (good, watch, bad or unknown) and
    a sentence. They are reported before all that is made of them, so that the library keeps them if that fails.

    Args:
        assessment: all results on a vehicle of the log: events, status lights, model, loops and wind.

    Returns:
        Values by the names of the columns; each light's column has the light's name.
    """
    # The sentences are read on a page of the library, where nobody has a terminal for the commands that they may name.
    with sentences_for(Medium(has_terminal=False)):
        light_sentences = {name: str(fact) for name, fact in assessment.lights.items()}
        return {
            "headline": str(assessment.stated_headline),
            "level": str(assessment.headline.level),
            "next_step": str(assessment.next_step),
            "light_sentences": json.dumps(light_sentences),
            **{name: str(fact.level) for name, fact in assessment.lights.items()},
        }


def _index_columns(assessment: Assessment, rows: FlightRows) -> JsonValues:
    """Returns the columns of the library's index that follow from the content of a log.

    Args:
        assessment: the assessment whose sentences and events the index shows for the log.
        rows: rows of the log in the fleet's table, the rows of this assessment first.

    Returns:
        Values by the names of the columns.
    """
    # Imported here, since it loads the modules of live sessions, which reading a log does not need otherwise.
    from mavdem.report.live import recorded_light_figures

    # Only an assessment in which no vehicle was judged has no evidence.
    assert assessment.recorded_signals is not None
    flights = flown_flights(assessment.recorded_signals)
    return {
        **columns_of_flight(rows),
        **_assessment_columns(assessment),
        "light_figures": json.dumps(recorded_light_figures(assessment.lights)),
        "flights": json.dumps([asdict(flight) for flight in flights]),
    }
