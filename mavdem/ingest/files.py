"""The bytes of a file, unpacked if it is an xz archive, or one sentence why not."""

from __future__ import annotations

import lzma
import mmap
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, TypeVar

import numpy as np
from numpy.typing import NDArray

from mavdem.errors import Unreadable

READ = (
    "this version reads telemetry logs (.tlog), MCAP recordings of MAVLink or ROS 2 (.mcap), ArduPilot DataFlash logs "
    "(.bin, .log) and PX4 ULogs (.ulg, .ulg.xz) only"
)
"""What is said of files that are none of these."""
LARGE = 64 << 20
"""Bytes of a file from which on it is mapped instead of read: it takes no memory of its own, but must stay as it is."""
XZ = b"\xfd7zXZ\x00"
"""How an xz archive begins."""
AHEAD = 1 << 16
"""Bytes of a file that are read to tell its beginning: unpacked they are hardly ever fewer."""
LARGEST_UNPACKED = 1 << 30
"""Bytes that an archive may hold: a few hours of the densest logs. A small one can be made to hold any number."""
UNPACKING_MEMORY = 1 << 27
"""Bytes that unpacking itself may take; the strongest setting of xz takes half."""
Content = TypeVar("Content", bytes, bytes | mmap.mmap)


def file_bytes(path: str | os.PathLike[str]) -> bytes:
    """The whole file, or what the xz archive holds that it is.

    Raises:
        Unreadable: it is missing, no plain file, not permitted, empty, or larger than the memory; or an archive that is
            damaged, or holds more than ``LARGEST_UNPACKED`` bytes.
    """
    return _content(path, _read, _unpacked)


def file_beginning(path: str | os.PathLike[str], count: int) -> bytes:
    """The first ``count`` bytes of what ``file_bytes`` gives, ``AHEAD`` at most.

    Raises:
        Unreadable: as ``file_bytes``, as far as the beginning tells.
    """
    return _content(path, lambda file, size: file.read(min(size, AHEAD)), _unpacked_beginning)[:count]


def mapped_bytes(path: str | os.PathLike[str]) -> bytes | mmap.mmap:
    """As ``file_bytes``, but a large file that is no archive as it lies on the disk, brought in where it is looked at.

    Raises:
        Unreadable: as ``file_bytes``, and larger than the address space instead of the memory.
    """
    return _content(path, _read_or_mapped, _unpacked)


def require_whole(data: NDArray[np.uint8], source: str) -> None:
    """Makes sure that ``data`` over ``mapped_bytes`` of the file ``source`` can be read still.

    Raises:
        Unreadable: the file was cut after it was opened; the system ends a process that reads what is gone.
    """
    content = data.base.obj if isinstance(data.base, memoryview) else data.base
    if isinstance(content, mmap.mmap) and content.size() < len(content):
        raise Unreadable(f"{source} was cut short while it was in use: read it again.")


def _content(
    path: str | os.PathLike[str],
    read: Callable[[BinaryIO, int], Content],
    unpacked: Callable[[bytes | mmap.mmap, Path], bytes],
) -> Content | bytes:
    path = Path(path)
    try:
        status = path.stat()
        kind = status.st_mode
        if stat.S_ISDIR(kind):
            raise Unreadable(f"{path} is a folder: name a log file in it.")
        if not stat.S_ISREG(kind):
            raise Unreadable(f"{path} is not a plain file: name a log file.")
        with path.open("rb") as file:
            content: Content | bytes = read(file, status.st_size)
        if content[: len(XZ)] == XZ:
            content = unpacked(content, path)
    except FileNotFoundError:
        raise Unreadable(f"{path} does not exist: check the name.") from None
    except MemoryError:
        raise Unreadable(f"{path} does not fit into memory: cut it into shorter logs.") from None
    except (OSError, ValueError) as error:
        if isinstance(error, Unreadable):
            raise
        reason = getattr(error, "strerror", None) or error
        raise Unreadable(f"{path} cannot be read ({reason}): check the name and its permissions.") from None
    if not len(content):
        raise Unreadable(f"{path} is empty: nothing was recorded.")
    return content


def _read(file: BinaryIO, size: int) -> bytes:
    # Not to the end: a file that says it is empty may never end (/proc), and one being recorded may grow.
    return file.read(size)


def _read_or_mapped(file: BinaryIO, size: int) -> bytes | mmap.mmap:
    return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if size >= LARGE else _read(file, size)


def _unpacked(content: bytes | mmap.mmap, path: Path) -> bytes:
    """What the first stream of an xz archive holds; ``xz`` writes no second."""
    unpacked, at_end = _decompressed(content, path, LARGEST_UNPACKED)
    if not at_end:
        whole = len(unpacked) < LARGEST_UNPACKED
        why = "is cut off: save what can be" if whole else f"holds more than {LARGEST_UNPACKED >> 20} MiB: unpack it"
        raise Unreadable(f"{path} is an xz archive that {why} with `xz -dc`.")
    return unpacked


def _unpacked_beginning(content: bytes | mmap.mmap, path: Path) -> bytes:
    return _decompressed(content, path, AHEAD)[0]


def _decompressed(content: bytes | mmap.mmap, path: Path, most: int) -> tuple[bytes, bool]:
    """At ``most`` so many bytes of what an xz archive holds, and whether that is all."""
    unpacking = lzma.LZMADecompressor(lzma.FORMAT_XZ, UNPACKING_MEMORY)
    try:
        return unpacking.decompress(content, most), unpacking.eof
    except lzma.LZMAError as error:
        raise Unreadable(f"{path} is a damaged xz archive ({error}): save what can be with `xz -dc`.") from None
