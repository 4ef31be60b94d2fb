"""A file that appears whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO


@contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Gives what to write to; when all is written the file is there, in place of one that was.

    Args:
        path: the file, in a folder that is there.

    Raises:
        OSError: it cannot be written there.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        # A folder cannot be replaced, and a device must not be.
        raise FileExistsError(None, "it is there and no plain file", str(path))
    with TemporaryDirectory(dir=path.parent, prefix=".unfinished.") as folder:
        unfinished = Path(folder) / path.name
        with unfinished.open("wb") as file:
            yield file
        os.replace(unfinished, path)
