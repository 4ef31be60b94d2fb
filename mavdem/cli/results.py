"""Results: the folder that review and learn write, with the page, the documents and the recordings of a log."""

import json
import os
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
    while not _is_free(folder / REPORT, log):
        number += 1
        folder = Path(f"{first}-{number}")
    return folder


def _is_free(report: Path, log: Path) -> bool:
    """Whether there is no ``report``, or that of this ``log``."""
    if not os.path.isfile(report):
        return True
    with suppress(Exception):  # it may be anything, of another program
        document = json.loads(report.read_text())
        if document["document"] == "learn":  # which names a log only if it has settled flight
            document = document.get("flight", {"source": log})
        return os.path.realpath(document["source"]) == os.path.realpath(log)
    return False


def write_results(folder: Path, document: Values, assessment: Assessment) -> None:
    """Draws and writes the result files, as :func:`files_in` does, with this report, which then names them.

    Those of a run before go.
    """
    names = result_files(assessment)
    document["files"] = {name: str(folder / name) for name in names}
    with (
        progress("Drawing and writing the files", measured=False),
        files_in(folder, names, RESULT_FILES) as paths,
    ):
        write_result_files(dict(zip(names, paths, strict=True)), json_text(document), assessment)
