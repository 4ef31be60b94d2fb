"""The bytes of a file, or one sentence why not."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from mavdem.errors import Unreadable


def file_bytes(path: str | os.PathLike[str]) -> bytes:
    """The whole file.

    Raises:
        Unreadable: it is missing, no plain file, not permitted, empty, or larger than the memory.
    """
    path = Path(path)
    try:
        status = path.stat()
        kind = status.st_mode
        if stat.S_ISDIR(kind):
            raise Unreadable(f"{path} is a folder: name a log file in it.")
        if not stat.S_ISREG(kind):
            raise Unreadable(f"{path} is not a plain file: name a log file.")
        # Not to the end: a file that says it is empty may never end (/proc), and one being recorded may grow.
        with path.open("rb") as file:
            content = file.read(status.st_size)
    except FileNotFoundError:
        raise Unreadable(f"{path} does not exist: check the name.") from None
    except MemoryError:
        raise Unreadable(f"{path} does not fit into memory: cut it into shorter logs.") from None
    except (OSError, ValueError) as error:
        if isinstance(error, Unreadable):
            raise
        reason = getattr(error, "strerror", None) or error
        raise Unreadable(f"{path} cannot be read ({reason}): check the name and its permissions.") from None
    if not content:
        raise Unreadable(f"{path} is empty: nothing was recorded.")
    return content
