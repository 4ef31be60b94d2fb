"""Files that appear whole or not at all.

A file that was there keeps its mode, and a symbolic link stays: what it leads to is replaced.
"""

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
from mavdem.facts.command import Place

PathName = str | os.PathLike[str]
AnyPath = PathName | bytes


def load_adjacent_toml(module: str, name: str) -> dict[str, Any]:
    """Returns the table in the TOML file of this ``name`` beside a ``module``, given by its ``__file__``."""
    return tomllib.loads((Path(module).parent / name).read_text("utf-8"))


@contextmanager
def atomic_write(path: PathName, scratch: Path | None = None) -> Iterator[BinaryIO]:
    """Gives what to write to; when all is written the file is there, in place of one that was.

    Args:
        path: of the file.
        scratch: the folder, on the same file system, for what is unfinished; beside the file unless given.

    Raises:
        OSError: it cannot be written there, as when there is no such folder.
    """
    with atomic_writes(path, scratch=scratch) as (unfinished,), unfinished.open("wb") as file:
        yield file


@contextmanager
def atomic_writes(*paths: PathName, scratch: Path | None = None) -> Iterator[tuple[Path, ...]]:
    """Gives for each file the path of one to write instead; when all are written they take their places together.

    Raises:
        OSError: one cannot be written there; then none is replaced.
    """
    unfinished = {}
    with ExitStack() as stack:
        for path in paths:
            target = writable_target(path)
            if target in unfinished:
                raise FileExistsError(
                    None, "it is the same file as another that is to be written", str(path)
                )
            folder = stack.enter_context(
                TemporaryDirectory(dir=scratch or target.parent, prefix=".unfinished.")
            )
            unfinished[target] = Path(folder) / target.name
        yield tuple(unfinished.values())
        for target, new in unfinished.items():
            if target.exists():
                shutil.copymode(target, new)
        for target, new in unfinished.items():
            os.replace(new, target)


def write_text_atomically(path: Path, text: str) -> None:
    """Writes a file, whole or not at all; raises ``Unreadable`` where it cannot be written."""
    with reporting_write_errors(path), atomic_write(path) as file:
        file.write(text.encode(errors="replace"))  # the name of a file in it need not be UTF-8


@contextmanager
def reporting_write_errors(*files: Path, code: Place = Place.FILE_FAILED) -> Iterator[None]:
    """Raises ``Unreadable`` with this ``code`` for an ``OSError``: files, or a folder, that cannot be written."""
    try:
        yield
    except OSError as error:
        names = " or ".join(str(path) for path in files)
        raise Unreadable(code, path=names, because=error_message(error)) from None


def writable_target(path: PathName) -> Path:
    """Returns the file that writing to ``path`` makes or replaces: itself, or where a symbolic link leads.

    Raises:
        OSError: something is there that cannot be replaced, or a name is too long, or a folder not writable.
    """
    target = Path(os.path.realpath(path))
    with suppress(FileNotFoundError):
        mode = target.stat().st_mode
        if not stat.S_ISREG(mode):  # a device must not be replaced
            obstacle = "it is a folder" if stat.S_ISDIR(mode) else "it is there and no plain file"
            raise FileExistsError(None, obstacle, str(path))
    for folder in (Path(path).parent, target.parent):
        if not folder.is_dir():
            raise FileNotFoundError(None, f"there is no folder {folder}", str(path))
    if not is_writable(target.parent):
        raise PermissionError(None, f"the folder {target.parent} is not writable", str(path))
    return target


def is_writable(folder: Path) -> bool:
    """Returns whether something can be made in a ``folder``, by trying: its mode does not tell for all file systems."""
    with suppress(OSError), TemporaryDirectory(dir=folder, prefix=".unfinished."):
        return True
    return False
