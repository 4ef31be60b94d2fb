"""Result files of a log: which there are, and how the page, the document and the recordings are written."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from mavdem.assessment import Assessment
from mavdem.assessment.assess import assess_signals
from mavdem.assessment.axis import Options
from mavdem.containers import JsonValues, Names
from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.signals import Signals
from mavdem.extras import EXTRAS_OF_ENDINGS, missing_modules, require_extra_of_file
from mavdem.files import reporting_write_errors, writable_target
from mavdem.ingest import read_log
from mavdem.report.templates import as_clause

if TYPE_CHECKING:
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


def result_files(assessment: Assessment, recordings: Names = ()) -> Names:
    """Returns the names of those ``RESULT_FILES`` that are to be written for an assessment.

    Without a model there are only the document, the page and, if there is a flight to show, the dashboard.

    Args:
        assessment: All results on a vehicle of a log: events, status lights, model, loops and wind.
        recordings: The requested ones of ``RECORDINGS``.
    """
    if assessment.model is not None:
        return (MODEL_FILE, REPORT_FILE, PAGE_FILE, *recordings)
    if RECORDING_FILE in recordings and _has_flight_to_show(assessment):
        return (REPORT_FILE, PAGE_FILE, RECORDING_FILE)
    return (REPORT_FILE, PAGE_FILE)


def _has_flight_to_show(assessment: Assessment) -> bool:
    """Returns whether a log has signals over time for a dashboard: a vehicle was analysed, and has an attitude."""
    evidence = assessment.evidence
    return (
        assessment.analysis is not None
        and evidence is not None
        and evidence.time_history is not None
    )


def possible_recordings() -> Names:
    """Returns the ``RECORDINGS`` that can be written here, since their packages are installed."""
    return tuple(
        name for name in RECORDINGS if not missing_modules(EXTRAS_OF_ENDINGS[Path(name).suffix])
    )


def write_result_files(paths: Mapping[str, Path], document: str, assessment: Assessment) -> None:
    """Writes the result files of an assessment: document, page, recordings and, if there is one, the model.

    Args:
        paths: Path to write to, for each name that :func:`result_files` returns.
        document: Text of the JSON document, which becomes the ``REPORT_FILE``.
        assessment: The assessment that the page, the model and the recordings show.
    """
    # Imported here, so that the output on the terminal does not wait for the import.
    from mavdem.report.pages.flight_page import review_page

    paths[REPORT_FILE].write_text(document + "\n", "utf-8")
    # The page may contain the name of a file, which need not be valid Unicode.
    paths[PAGE_FILE].write_text(review_page(assessment), "utf-8", "replace")
    analysis = assessment.analysis
    if MODEL_FILE in paths and analysis is not None and analysis.learned is not None:
        paths[MODEL_FILE].write_text(analysis.learned.to_json() + "\n", "utf-8")
    write_recordings(paths, assessment)


def write_recordings(paths: Mapping[str, Path], assessment: Assessment) -> None:
    """Writes the recordings of an assessment, as far as there is something to record.

    Args:
        paths: Path to write to, for each of the ``RECORDINGS`` that is wanted. The dashboard needs a flight, the
            channels a model: without it their file is not written.
        assessment: All results on a vehicle of a log: events, status lights, model, loops and wind.
    """
    if RECORDING_FILE in paths and _has_flight_to_show(assessment):
        write_dashboard(paths[RECORDING_FILE], assessment)
    analysis = assessment.analysis
    if analysis is None or analysis.learned is None or analysis.held_out is None:
        return
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

    Rerun's recording shows a flight without a model, too.

    Args:
        source: The log.
        out: The file to write, .rrd or .mcap, which appears whole or not at all.
        axis, vehicle, inputs: As for :func:`mavdem.read_flight`.

    Returns:
        Plain JSON values of the document of ``mavdem convert``: samples from which the model was learned, or without
        one those of the attitude, their step (None without a model) and first and last time, s.

    Raises:
        Unreadable: The log cannot be read, or ``out`` cannot be written.
        NotLearnable: No model can be learned from the log, and Rerun's recording has no flight to show.
        MissingExtra: The format of ``out`` needs a package that is not installed.
        ValueError: ``out`` is the source.
    """
    ending = out.suffix.lower()
    require_extra_of_file(out)
    with reporting_write_errors(out):
        # A target that cannot be written is refused before the work.
        writable_target(out)
        if out.exists() and source.exists() and out.samefile(source):
            raise ValueError(f"{out} is the input: name another file")
        log = read_log(source)
        signals = Signals(choose_vehicle(log.vehicles, vehicle))
        assessment = assess_signals(log, signals, axis, Options(inputs=inputs))
        file_name = CHANNELS_FILE if ending == Path(CHANNELS_FILE).suffix else RECORDING_FILE
        if file_name not in result_files(assessment, (file_name,)):
            raise assessment.refusal
        write_recordings({file_name: out}, assessment)
    analysis = assessment.analysis
    assert analysis is not None
    if assessment.model is None:
        return _document_without_model(source, out, assessment)
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


def _document_without_model(source: Path, out: Path, assessment: Assessment) -> JsonValues:
    """Returns the document of ``mavdem convert`` for a recording of a flight without a model.

    Args:
        source: The log.
        out: The recording.
        assessment: All results on a vehicle of the log, with its signals over time.
    """
    evidence = assessment.evidence
    assert evidence is not None and evidence.time_history is not None
    history = evidence.time_history
    angles = [axis.angle.measured for axis in history.axes.values() if axis and axis.angle]
    return {
        "source": str(source),
        "out": str(out),
        "samples": max((len(angle.time) for angle in angles if angle is not None), default=0),
        "dt": None,
        "start": history.segment.start,
        "end": history.segment.end,
        "learnable": False,
        "cautions": [f"No model was learned: {as_clause(assessment.refusal.reason)}."],
    }


def write_dashboard(target: Target, assessment: Assessment) -> None:
    """Writes the Rerun recording of an assessment: of the flight and, if one was learned, its model.

    Args:
        target: Path of an .rrd file, or a recording that is streamed to a viewer.
        assessment: All results on a vehicle of a log: events, status lights, model, loops and wind.
    """
    # Rerun takes a second to import, and is not needed where nothing can be learned from a flight.
    from mavdem.view import write_recording

    write_recording(target, assessment)
