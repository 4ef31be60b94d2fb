"""Output files of a command: checking before the work that they can be written, and replacing them atomically."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import click

from mavdem.containers import Names
from mavdem.errors import Unreadable
from mavdem.extras import require_extra_of_file
from mavdem.facts.command import Unwritable
from mavdem.files import (
    PathName,
    atomic_writes,
    is_writable,
    reporting_write_errors,
    writable_target,
)


def check_output_folder(folder: Path, names: Names = (), *inputs: PathName | None) -> None:
    """Checks, before a command begins its work, that it can write its files into a folder.

    Learning takes minutes, and its result must not be lost because of a wrong path. Nothing remains created or changed:
    the check is made in the nearest folder that exists, in which the missing ones would be created.

    Args:
        folder: Folder for the results. It need not exist.
        names: Names of the files to write in it.
        *inputs: Files that the command reads, which must not be replaced; None for an option that was not given.

    Raises:
        Unreadable: The folder or a file cannot be written, or a file to write is one of ``inputs``.
    """
    _check_folder(folder)
    for name in names:
        # A file that does not exist yet, in a folder that may not exist yet, is no error.
        with reporting_write_errors(folder / name), suppress(FileNotFoundError):
            writable_target(folder / name)
    # Paths are compared after links are resolved: an input may be reached by another name.
    targets = {os.path.realpath(folder / name) for name in names}
    for path in inputs:
        if path and os.path.realpath(path) in targets:
            raise Unreadable(Unwritable.OUT_REPLACES_INPUT, path=folder, existing=path)


def _check_folder(folder: Path) -> None:
    """Checks that files can be written into a folder, or that it can be created for them.

    Args:
        folder: The folder.

    Raises:
        Unreadable: The nearest path that exists is a file or not writable, or a name is too long for the file system.
    """
    # The folder itself or the nearest of its parents that exists; the last one, the root, always does.
    folder_and_parents = (folder, *folder.absolute().parents)
    existing_path = next(path for path in folder_and_parents if os.path.lexists(path))
    if not existing_path.is_dir():
        raise Unreadable(Unwritable.OUT_IS_A_FILE, path=folder, existing=existing_path)
    if not is_writable(existing_path):
        raise Unreadable(Unwritable.OUT_NOT_WRITABLE, path=folder, existing=existing_path)
    with reporting_write_errors(folder, code=Unwritable.OUT_FAILED):
        for part in folder.parts:
            # ``lstat`` raises an error if a name is too long for the file system, even if the path does not exist.
            with suppress(FileNotFoundError):
                (existing_path / part).lstat()


def check_output_file(path: Path | None, option: str, endings: Names) -> None:
    """Checks, before a command begins its work, that it can write a file.

    Args:
        path: Path of the file; None if the option was not given, and then nothing is checked.
        option: Name of the option, for the error message.
        endings: Endings that the name may have, in lower case and with their dots.

    Raises:
        click.BadParameter: The name has another ending.
        MissingExtra: Its format needs a package that is not installed.
        Unreadable: The file cannot be written.
    """
    if path is None:
        return
    if path.suffix.lower() not in endings:
        raise click.BadParameter(f"{path} must end in {' or '.join(endings)}.", param_hint=option)
    require_extra_of_file(path)
    with reporting_write_errors(path):
        writable_target(path)


@contextmanager
def replaced_files(
    folder: Path, names: Sequence[str], stale_names: Names = ()
) -> Iterator[tuple[Path, ...]]:
    """Creates or replaces files of a folder together, when the block has written all of them.

    Args:
        folder: Folder of the files, which is created if it does not exist.
        names: Names of the files.
        stale_names: Names of files that an earlier run may have left in the folder. Files that are not among ``names``
            are removed at the end.

    Yields:
        For each of ``names`` the path of a temporary file that the block has to write.

    Raises:
        Unreadable: A file cannot be written; then none is replaced.
    """
    with reporting_write_errors(folder, code=Unwritable.OUT_FAILED):
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / name for name in names]
        with atomic_writes(*paths) as temporary_paths:
            yield temporary_paths
        names_to_remove = set(stale_names) - set(names)
        for name in names_to_remove:
            (folder / name).unlink(missing_ok=True)


def write_texts(folder: Path, texts: Mapping[str, str], stale_names: Names = ()) -> None:
    """Creates or replaces text files of a folder together.

    Args:
        folder: Folder of the files, which is created if it does not exist.
        texts: Text of each file by its name.
        stale_names: Names of files that an earlier run may have left in the folder; those without a text are removed.

    Raises:
        Unreadable: A file cannot be written; then none is replaced.
    """
    with replaced_files(folder, list(texts), stale_names) as paths:
        for path, text in zip(paths, texts.values(), strict=True):
            # A text may contain the name of a file, which need not be valid Unicode.
            path.write_text(text, "utf-8", "replace")
