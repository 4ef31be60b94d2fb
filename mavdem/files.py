"""Atomic writing of files: a file appears complete or not at all; and TOML tables that are stored beside a module.

A file that is replaced keeps its mode. Where the path is a symbolic link, the link stays and its target is replaced.
"""

import errno
import os
import shutil
import stat
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

from mavdem.errors import Unreadable, error_message
from mavdem.facts.command import Unwritable

PathName = str | os.PathLike[str]
"""Path of a file, as text or as an object."""

AnyPath = PathName | bytes
"""Path of a file, also as the bytes that the operating system uses for it."""

UNFINISHED_PREFIX = ".unfinished."
"""Beginning of the names of temporary folders: hidden, and recognisable where a crash has left one behind."""


def load_adjacent_toml(module: str, name: str) -> dict[str, Any]:
    """Loads a TOML file that is stored in the folder of a module.

    Args:
        module: ``__file__`` of the module.
        name: Path of the TOML file, relative to the module's folder.

    Returns:
        The content of the file, its tables as nested dictionaries.
    """
    return tomllib.loads((Path(module).parent / name).read_text("utf-8"))


@contextmanager
def atomic_write(path: PathName, scratch: Path | None = None) -> Iterator[BinaryIO]:
    """Opens a file for writing, which appears under its name only after the block has ended without an error.

    So a crash, a full disk or Ctrl-C leaves the former file, and never a partial one.

    Args:
        path: Path of the file; a file that exists there is replaced.
        scratch: Folder for the unfinished file, on the same file system; the file's own folder unless given.

    Yields:
        A binary file to write to.

    Raises:
        OSError: The file cannot be written there, for example because there is no such folder.
    """
    with atomic_writes(path, scratch=scratch) as (unfinished,), unfinished.open("wb") as file:
        yield file


@contextmanager
def atomic_writes(*paths: PathName, scratch: Path | None = None) -> Iterator[tuple[Path, ...]]:
    """Replaces several files together, when all of them are written.

    Each file is first written into a temporary folder beside it, and then renamed, which POSIX does atomically within
    a file system. The folders are removed at the end of the block, also after an error.

    Args:
        *paths: Paths of the files; those that exist are replaced.
        scratch: Folder for the unfinished files, on the same file system; each file's own folder unless given.

    Yields:
        For each of ``paths`` the path of a temporary file that the block has to write instead.

    Raises:
        OSError: A file cannot be written there; then none is replaced.
    """
    unfinished_by_target: dict[Path, Path] = {}
    with ExitStack() as stack:
        for path in paths:
            target = writable_target(path)
            if target in unfinished_by_target:
                raise FileExistsError(
                    None, "it is the same file as another that is to be written", str(path)
                )
            folder = stack.enter_context(
                TemporaryDirectory(dir=scratch or target.parent, prefix=UNFINISHED_PREFIX)
            )
            unfinished_by_target[target] = Path(folder) / target.name
        yield tuple(unfinished_by_target.values())
        # All modes are copied before any file is replaced, since copying may fail, and renaming hardly ever does.
        for target, unfinished in unfinished_by_target.items():
            if target.exists():
                shutil.copymode(target, unfinished)
        for target, unfinished in unfinished_by_target.items():
            os.replace(unfinished, target)


def write_text_atomically(path: Path, text: str) -> None:
    """Writes a text file in UTF-8, complete or not at all; raises ``Unreadable`` where it cannot be written."""
    with reporting_write_errors(path), atomic_write(path) as file:
        # The text may contain the name of a file, which need not be valid Unicode.
        file.write(text.encode(errors="replace"))


@contextmanager
def reporting_write_errors(
    *files: Path, code: Unwritable = Unwritable.FILE_FAILED
) -> Iterator[None]:
    """Turns an ``OSError`` of the block into an ``Unreadable`` that names the files.

    Args:
        *files: Files or folders that the block writes.
        code: Code of the fact that the error carries.
    """
    try:
        yield
    except OSError as error:
        names = " or ".join(str(path) for path in files)
        raise Unreadable(code, path=names, reason=error_message(error)) from None


def is_disk_full(error: BaseException | None) -> bool:
    """Returns whether an error, or one that it replaced, is that the disk or the user's quota on it is full.

    Args:
        error: an error of any class; None for none.
    """
    while error is not None:
        is_of_system = getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT)
        is_of_sqlite = getattr(error, "sqlite_errorname", "") == "SQLITE_FULL"
        if is_of_system or is_of_sqlite:
            return True
        # The error that was handled when this one was raised.
        error = error.__cause__ or error.__context__
    return False


def writable_target(path: PathName) -> Path:
    """Returns the regular file that writing to ``path`` creates or replaces, after checking that this is possible.

    Args:
        path: Path of a file, which may be a symbolic link and need not exist.

    Returns:
        The path itself, with all symbolic links resolved.

    Raises:
        OSError: The path is a folder, a device or the like, a name is too long, or the folder does not exist or is not
            writable.
    """
    target = Path(os.path.realpath(path))
    with suppress(FileNotFoundError):
        mode = target.stat().st_mode
        # Replacing a device such as /dev/null by a file would break the system.
        if not stat.S_ISREG(mode):
            reason = "it is a folder" if stat.S_ISDIR(mode) else "it is there and no plain file"
            raise FileExistsError(None, reason, str(path))
    for folder in (Path(path).parent, target.parent):
        if not folder.is_dir():
            raise FileNotFoundError(None, f"there is no folder {folder}", str(path))
    if not is_writable(target.parent):
        raise PermissionError(None, f"the folder {target.parent} is not writable", str(path))
    return target


def numbered_path(path: Path, number: int) -> Path:
    """Returns the path of a further file beside one: "flight-2.tlog" for "flight.tlog" and the number 2.

    Args:
        path: path of the first file.
        number: number of the further file, from 2 on.
    """
    return path.with_stem(f"{path.stem}-{number}")


def is_writable(folder: Path) -> bool:
    """Returns whether files can be created in a folder.

    It creates and removes a folder as a test, because on some file systems the mode does not show it.

    Args:
        folder: The folder, which exists.
    """
    with suppress(OSError), TemporaryDirectory(dir=folder, prefix=UNFINISHED_PREFIX):
        return True
    return False
