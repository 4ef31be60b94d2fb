"""Results: the folder that a command names itself; page, documents and recordings that review and learn write."""

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from mavdem.assessment import Assessment
from mavdem.cli.output import files_in, json_text, progress
from mavdem.containers import JsonValues
from mavdem.results import REPORT_FILE, RESULT_FILES, result_files, write_result_files


def named_after(source: str) -> Path:
    """Returns the folder named after a log, the ``source``, in the current one, as :func:`free_folder` does.

    It has not the log's own name.
    """
    log = Path(source)
    stem = Path(log.name.removesuffix(".xz")).stem
    first = stem if stem.strip(".") and stem != log.name else f"{log.name}-learned"
    return free_folder(first, REPORT_FILE, {"source": source})


def free_folder(first: str, document: str, sources: Mapping[str, str]) -> Path:
    """Returns the ``first`` of folders, "flight", "flight-2" and so on, without results of others than ``sources``.

    Those are named by the ``document`` in it, with these keys.
    """
    folder = Path(first)
    number = 1
    while not _is_free(folder / document, sources):
        number += 1
        folder = Path(f"{first}-{number}")
    return folder


def _is_free(path: Path, sources: Mapping[str, str]) -> bool:
    """Whether there is no ``path``, or that of these ``sources``."""
    if not os.path.isfile(path):
        return True
    with suppress(Exception):  # it may be anything, of another program
        document = json.loads(path.read_text())
        return all(
            os.path.realpath(document[name]) == os.path.realpath(source)
            for name, source in sources.items()
        )
    return False


def write_results(folder: Path, document: JsonValues, assessment: Assessment) -> None:
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
