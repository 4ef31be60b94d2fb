"""The files that results are kept in, each of them whole or not there."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click

from mavdem.channels import write_channels
from mavdem.cli.output import json_text
from mavdem.cli.signals import ending_at_once
from mavdem.cli.source import no_option
from mavdem.dem import Learned
from mavdem.errors import Unreadable
from mavdem.flight import Flight

NAMES = ("model.json", "report.json", "flight.rrd", "flight.mcap")
"""Of the files of a learnt flight."""


def folder_named(context: click.Context, parameter: click.Parameter, value: str | None) -> Path | None:
    """The folder of an option; refuses no name, which a path would take for the current folder."""
    if value is None:
        return None
    if not no_option(context, parameter, value):
        raise click.BadParameter("it names no folder; for this one name `.`.", context, parameter)
    return Path(value)


def check_folder(folder: Path, names: Sequence[str] = NAMES) -> None:
    """Refuses a folder that cannot be written to, before the work is done; it makes nothing.

    Args:
        folder: where results are to go.
        names: of their files.

    Raises:
        Unreadable: it or a folder above it is a file, or not permitted; or a folder is where a result must go.
    """
    existing = next(place for place in (folder, *folder.absolute().parents) if os.path.lexists(place))
    if not existing.is_dir():
        raise Unreadable(f"--out {folder} is no folder, because {existing} is a file: name another.")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise Unreadable(f"--out {folder} cannot be made: {existing} is not writable.")
    for path in (folder / name for name in names):
        # Found only when the others are replaced, it would leave results of two runs.
        if path.is_dir() and not path.is_symlink():
            raise Unreadable(f"{path} is a folder, where a file is to be written: move it, or name another --out.")


def write_results(folder: Path, report: dict[str, Any], train: Flight, test: Flight, learned: Learned) -> None:
    """Writes model.json (the ``Learned``), report.json and flight.rrd and .mcap; makes ``folder`` where it is missing.

    Args:
        folder: where to.
        report: what report.json will hold.
        train, test, learned: what flight.rrd will show and flight.mcap hold.

    Raises:
        Unreadable: they cannot be written.
    """
    # Rerun takes a second to load, and a flight that cannot be learnt needs none of it.
    with ending_at_once():
        from mavdem.view import write_recording

    with files_in(folder, NAMES) as (model_json, report_json, recording, channels):
        model_json.write_text(learned.to_json() + "\n")
        report_json.write_text(json_text(report) + "\n")
        write_recording(recording, train, test, learned)
        write_channels(channels, train, learned, test)


@contextmanager
def files_in(folder: Path, names: Sequence[str]) -> Iterator[list[Path]]:
    """Gives for each file the path of one to write instead; when all are written they take their places.

    Args:
        folder: where to; made where it is missing.
        names: of the files.

    Raises:
        Unreadable: they cannot be written.
    """
    try:
        with _made(folder), TemporaryDirectory(dir=folder, prefix=".unfinished.") as unfinished:
            files = [Path(unfinished) / name for name in names]
            yield files
            for path in files:
                os.replace(path, folder / path.name)
    except OSError as error:
        raise Unreadable(f"--out {folder} cannot be written ({error.strerror or error}): name another.") from None


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Makes a folder and those above it, and on failure removes those that it made."""
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for place in missing:
            with suppress(OSError):  # never made, or somebody else has put something there
                place.rmdir()
        raise
