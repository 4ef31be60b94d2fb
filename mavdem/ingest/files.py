"""The bytes of a file, unpacked if it is an xz archive, or one sentence why not."""

from __future__ import annotations

import lzma
import os
import stat
from pathlib import Path

from mavdem.errors import Unreadable

XZ = b"\xfd7zXZ\x00"
"""How an xz archive begins."""
LARGEST_UNPACKED = 1 << 30
"""Bytes that an archive may hold: a few hours of the densest logs. A small one can be made to hold any number."""
UNPACKING_MEMORY = 1 << 27
"""Bytes that unpacking itself may take; the strongest setting of xz takes half."""


def file_bytes(path: str | os.PathLike[str]) -> bytes:
    """The whole file, or what the xz archive holds that it is.

    Raises:
        Unreadable: it is missing, no plain file, not permitted, empty, or larger than the memory; or an archive that is
            damaged, or holds more than ``LARGEST_UNPACKED`` bytes.
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
        if content.startswith(XZ):
            content = _unpacked(content, path)
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


def _unpacked(content: bytes, path: Path) -> bytes:
    """What the first stream of an xz archive holds; ``xz`` writes no second."""
    unpacking = lzma.LZMADecompressor(lzma.FORMAT_XZ, UNPACKING_MEMORY)
    try:
        unpacked = unpacking.decompress(content, LARGEST_UNPACKED)
    except lzma.LZMAError as error:
        raise Unreadable(f"{path} is a damaged xz archive ({error}): save what can be with `xz -dc`.") from None
    if not unpacking.eof:
        whole = len(unpacked) < LARGEST_UNPACKED
        why = "is cut off: save what can be" if whole else f"holds more than {LARGEST_UNPACKED >> 20} MiB: unpack it"
        raise Unreadable(f"{path} is an xz archive that {why} with `xz -dc`.")
    return unpacked
