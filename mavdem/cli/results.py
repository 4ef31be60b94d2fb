"""Results: the folder that review and learn write, with the page, the documents and the recordings of a log."""

import json
from contextlib import suppress
from pathlib import Path

from mavdem.assessment import Assessment
from mavdem.cli.output import files_in, json_text, progress
from mavdem.heading import Values
from mavdem.results import REPORT, RESULT_FILES, result_files, write_result_files


def named_after(source: str) -> Path:
    """Returns the folder named after a log, the ``source``, in the current one: "flight", or "flight-2" and so on.

    It has not the log's own name, and no results of another log.
    """
    log = Path(source)
    stem = Path(log.name.removesuffix(".xz")).stem
    first = stem if stem.strip(".") and stem != log.name else f"{log.name}-learned"
    folder = Path(first)
    number = 1
    while not _is_free(folder, log):
        number += 1
        folder = Path(f"{first}-{number}")
    return folder


def _is_free(folder: Path, log: Path) -> bool:
    """Whether there is no report in a ``folder``, or that of this ``log``."""
    with suppress(OSError, ValueError, LookupError, TypeError, AttributeError):
        report = json.loads((folder / REPORT).read_bytes())
        own = report.get("flight", report)["source"]  # of learn, or of review
        return Path(own).resolve() == log.resolve()
    return True


def files_of(folder: Path, assessment: Assessment) -> dict[str, str]:
    """Returns the paths of the result files in a ``folder``, by name."""
    return {name: str(folder / name) for name in result_files(assessment)}


def write_results(folder: Path, document: Values, assessment: Assessment) -> None:
    """Draws and writes the result files, as :func:`files_in` does, with this report. Those of a run before go."""
    names = result_files(assessment)
    with (
        progress("Drawing and writing the files", measured=False),
        files_in(folder, names, RESULT_FILES) as paths,
    ):
        write_result_files(dict(zip(names, paths, strict=True)), json_text(document), assessment)
