"""Files that a command writes: checked before the work, and each appears whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import click

from mavdem.analysis import LogAnalysis
from mavdem.cli.options import no_option
from mavdem.cli.output import json_text
from mavdem.cli.signals import ending_at_once
from mavdem.errors import Unreadable, missing
from mavdem.export.channels import write_channels
from mavdem.files import atomic_write, atomic_writes, replaceable

RECORDING = "flight.rrd"
RESULT_FILES = ("model.json", "report.json", "report.html", RECORDING, "flight.mcap")


def folder_named(context: click.Context, parameter: click.Parameter, value: str | None) -> Path | None:
    """Returns the folder of an option; refuses no name, which a path would take for the current folder."""
    if value is None:
        return None
    if not no_option(context, parameter, value):
        raise click.BadParameter("it names no folder; use `.` for the current one.", context, parameter)
    return Path(value)


def check_folder(folder: Path, names: Sequence[str] = RESULT_FILES) -> None:
    """Raises ``Unreadable``, before the work, for a folder that cannot be written to; it makes nothing."""
    existing = next(place for place in (folder, *folder.absolute().parents) if os.path.lexists(place))
    if not existing.is_dir():
        raise Unreadable(f"--out {folder} is not a folder, because {existing} is a file: name another.")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise Unreadable(f"--out {folder} cannot be made: {existing} is not writable.")
    for path in (folder / name for name in names):
        # Found only when the others are replaced, it would leave results of two runs.
        try:
            occupied = path.is_dir() and not path.is_symlink()
        except OSError as error:  # its name is too long
            raise Unreadable(f"--out {folder} cannot be made ({error.strerror}): name another.") from None
        if occupied:
            raise Unreadable(f"{path} is a folder, where a file is to be written: move it, or name another --out.")


def write_results(folder: Path, report: dict[str, Any], page: str, analysis: LogAnalysis) -> None:
    """Writes the :func:`result_files`, as :func:`files_in` does; ``page`` is the HTML. Those of a run before go."""
    learned, held_out, flights = analysis.learned, analysis.held_out, analysis.flights
    names = result_files(with_model=learned is not None)
    with files_in(folder, names) as paths:
        place = dict(zip(names, paths, strict=True))
        place["report.json"].write_text(json_text(report) + "\n")
        place["report.html"].write_bytes(page_bytes(page))
        if learned is not None and held_out is not None:
            place["model.json"].write_text(learned.to_json() + "\n")
            if RECORDING in names:
                # Rerun takes a second to load, and a flight that cannot be learned needs none of it.
                with ending_at_once():
                    from mavdem.view import write_recording

                write_recording(place[RECORDING], flights, learned, held_out)
            write_channels(place["flight.mcap"], flights, learned, held_out)
    for name in set(RESULT_FILES) - set(names):
        (folder / name).unlink(missing_ok=True)


def write_page(path: Path, page: str) -> None:
    """Writes HTML, whole or not at all; raises ``Unreadable`` where it cannot be written."""
    with writing(path), atomic_write(path) as file:
        file.write(page_bytes(page))


def page_bytes(page: str) -> bytes:
    """Returns HTML in UTF-8, which a file's name in it need not be."""
    return page.encode(errors="replace")


def result_files(with_model: bool = True) -> tuple[str, ...]:
    """Returns the ``RESULT_FILES`` that can be written: most need a model, and the recording needs Rerun."""
    if not with_model:
        return ("report.json", "report.html")
    return tuple(name for name in RESULT_FILES if name != RECORDING or not missing("view"))


@contextmanager
def files_in(folder: Path, names: Sequence[str]) -> Iterator[tuple[Path, ...]]:
    """Yields paths to write instead of these files, which then replace them; raises ``Unreadable`` if not."""
    try:
        with _made(folder), atomic_writes(*(folder / name for name in names)) as files:
            yield files
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


def check_file(path: Path | None, option: str, endings: tuple[str, ...]) -> None:
    """Raises ``Unreadable``, before the work, for a file that cannot be written, ``BadParameter`` for other endings."""
    if path is not None:
        if path.suffix.lower() not in endings:
            raise click.BadParameter(f"{path} must end in {' or '.join(endings)}.", param_hint=option)
        with writing(path):
            replaceable(path)


@contextmanager
def writing(*files: Path) -> Iterator[None]:
    """Raises ``Unreadable`` for an ``OSError``: files that cannot be written."""
    try:
        yield
    except OSError as error:
        names = " or ".join(str(path) for path in files)
        raise Unreadable(f"{names} cannot be written ({error.strerror or error}): name another file.") from None
