"""Result folders of commands: their default names, and the page, document and recordings that are written to them."""

import json
import os
from collections.abc import Mapping
from pathlib import Path

from mavdem.assessment import Assessment
from mavdem.cli.output import json_text, progress
from mavdem.cli.output_files import replaced_files
from mavdem.containers import JsonValues, Names
from mavdem.extras import require_extra_of_file
from mavdem.results import (
    CHANNELS_FILE,
    RECORDING_FILE,
    REPORT_FILE,
    RESULT_FILES,
    result_files,
    write_result_files,
)


def default_result_folder(source: str) -> Path:
    """Returns the folder for the results of a log if the user has not named one.

    It is in the current folder and named after the log without its ending. If a folder of that name contains the
    results of another log, it gets a new name.

    Args:
        source: Path of the log.

    Returns:
        Path of the folder, which may exist already.
    """
    log_path = Path(source)
    name = Path(log_path.name.removesuffix(".xz")).stem
    # The name must differ from the log's, also if that has no ending, and must not be "." or "..".
    if name == log_path.name or not name.strip("."):
        name = f"{log_path.name}-learned"
    return available_folder(name, REPORT_FILE, {"source": source})


def available_folder(name: str, document_name: str, sources: Mapping[str, str]) -> Path:
    """Returns the first of the folders "name", "name-2", "name-3" and so on that has no results of other sources.

    Results of the same log are replaced when it is read again; results of another log of the same name are not.

    Args:
        name: Path of the first folder.
        document_name: Name of the JSON document that shows from which sources the results of a folder were made.
        sources: Paths of the sources of the new results, by the document's key for each.

    Returns:
        Path of the folder, which need not exist.
    """
    folder = Path(name)
    number = 1
    while not _is_available(folder / document_name, sources):
        number += 1
        folder = Path(f"{name}-{number}")
    return folder


def _is_available(document_path: Path, sources: Mapping[str, str]) -> bool:
    """Returns whether a document does not exist, or was made of the same sources, so that it may be replaced.

    Args:
        document_path: Path of the JSON document.
        sources: Paths of the sources, by the document's key for each.
    """
    if not os.path.isfile(document_path):
        return True
    try:
        document = json.loads(document_path.read_text(encoding="utf-8"))
        for key, source in sources.items():
            if os.path.realpath(document[key]) != os.path.realpath(source):
                return False
    except Exception:
        # The file was made by another program, may contain anything, and must not be replaced.
        return False
    return True


def chosen_recordings(*, rrd: bool, mcap: bool) -> Names:
    """Returns the names of the recordings that --rrd and --mcap request.

    Args:
        rrd: Whether --rrd was given.
        mcap: Whether --mcap was given.

    Raises:
        MissingExtra: One of them needs a package that is not installed.
    """
    names = []
    if rrd:
        names.append(RECORDING_FILE)
    if mcap:
        names.append(CHANNELS_FILE)
    for name in names:
        require_extra_of_file(name)
    return tuple(names)


def write_results(
    folder: Path, document: JsonValues, assessment: Assessment, recordings: Names
) -> None:
    """Draws and writes the result files of an assessment, and shows progress on standard error.

    Result files of an earlier run that this assessment does not have are removed.

    Args:
        folder: Folder of the files.
        document: Document of the results, which receives the files' paths under its key "files".
        assessment: All results on a vehicle of a log: events, status lights, model, loops and wind.
        recordings: Names of the requested recordings.

    Raises:
        Unreadable: A file cannot be written; then none is replaced.
    """
    names = result_files(assessment, recordings)
    document["files"] = {name: str(folder / name) for name in names}
    with (
        progress("Drawing and writing the files", measured=False),
        replaced_files(folder, names, RESULT_FILES) as paths,
    ):
        write_result_files(dict(zip(names, paths, strict=True)), json_text(document), assessment)
