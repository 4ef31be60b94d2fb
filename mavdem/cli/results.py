"""Results: the folder that review and learn write, with the page, the documents and the recordings of a log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavdem.assessment import Assessment
from mavdem.cli.output import ending_at_once, files_in, json_text
from mavdem.export.conversion import write_channels
from mavdem.extras import missing
from mavdem.report.page import review_page

if TYPE_CHECKING:
    from mavdem.view import Target

RECORDING = "flight.rrd"
RESULT_FILES = ("model.json", "report.json", "report.html", RECORDING, "flight.mcap")


def named_after(source: str) -> Path:
    """Returns the folder named after a log, the ``source``, in the current one; not the log's own name."""
    name = Path(source).name
    stem = name.removesuffix(".xz")
    stem = stem.removesuffix(Path(stem).suffix)
    return Path(stem if stem.strip(".") and stem != name else f"{name}-learned")


def result_files(assessment: Assessment) -> tuple[str, ...]:
    """Returns the ``RESULT_FILES`` that can be written: most need a model, and the recording needs Rerun."""
    if assessment.model is None:
        return ("report.json", "report.html")
    return tuple(name for name in RESULT_FILES if name != RECORDING or not missing("view"))


def files_of(folder: Path, assessment: Assessment) -> dict[str, str]:
    """Returns the paths of the :func:`result_files` in a ``folder``, by name."""
    return {name: str(folder / name) for name in result_files(assessment)}


def write_results(folder: Path, document: dict[str, Any], assessment: Assessment) -> None:
    """Writes the :func:`result_files`, as :func:`files_in` does, with this report. Those of a run before go."""
    page = review_page(assessment)
    names = result_files(assessment)
    analysis = assessment.analysis
    with files_in(folder, names) as paths:
        place = dict(zip(names, paths, strict=True))
        place["report.json"].write_text(json_text(document) + "\n")
        place["report.html"].write_text(page, "utf-8", "replace")
        if analysis is not None and analysis.learned is not None and analysis.held_out is not None:
            place["model.json"].write_text(analysis.learned.to_json() + "\n")
            if RECORDING in names:
                write_dashboard(place[RECORDING], assessment)
            known = analysis.flights, analysis.learned, analysis.held_out
            write_channels(place["flight.mcap"], *known, assessment.wind_of_model)
    for name in set(RESULT_FILES) - set(names):
        (folder / name).unlink(missing_ok=True)


def write_dashboard(target: Target, assessment: Assessment) -> None:
    """Writes an ``assessment`` with a model as an .rrd file, or to a stream."""
    # Rerun takes a second to load, and a flight that cannot be learned needs none of it.
    with ending_at_once():
        from mavdem.view import write_recording

    analysis = assessment.analysis
    assert analysis is not None and analysis.learned is not None and analysis.held_out is not None
    known = analysis.flights, analysis.learned, analysis.held_out
    write_recording(target, *known, assessment)
