"""The bytes of a file, unpacked if it is an xz archive, or why they cannot be read."""

import lzma
import stat
from pathlib import Path

from mavdem.errors import Unreadable, error_message
from mavdem.facts import Fact
from mavdem.facts.sources import Source
from mavdem.files import PathName

LOG_ENDINGS = (".tlog", ".mcap", ".bin", ".log", ".ulg", ".ulg.xz")
# Bytes that are read of a file for its beginning; unpacked they are hardly ever fewer
BEGINNING_BYTES = 1 << 16
# Of a file that is read into memory, and of an archive's content: hours of the densest logs
MAX_LOG_BYTES = 1 << 30
MIN_UNPACKED_LIMIT = 1 << 26
MAX_COMPRESSION_RATIO = 100
"""Bytes that any archive may unpack to, and more for each of its own: a small one can be made to hold any number."""


def file_bytes(path: PathName) -> bytes:
    """Returns the whole file, or the contents of an xz archive.

    Raises Unreadable: it is missing, no plain file, not permitted, empty, or larger than the memory; or an archive that
    is damaged. Neither may have more than ``MAX_LOG_BYTES``.
    """
    return _content(path)


def file_beginning(path: PathName) -> bytes:
    """Returns the first 4096 bytes; raises as ``file_bytes``, as far as these show it."""
    return _content(path, limit=BEGINNING_BYTES)[:4096]


def is_dataflash_text(content: bytes) -> bool:
    """Returns whether a log with this beginning is a DataFlash log as text; there may be words before the first FMT."""
    return b"\nFMT," in b"\n" + content[:4096]


def _content(path: PathName, limit: int | None = None) -> bytes:
    """The contents of a file or an archive; the first ``limit`` bytes of either, if given."""
    path = Path(path)
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise Unreadable(_folder(path))
        if not stat.S_ISREG(status.st_mode):
            raise Unreadable(Source.SPECIAL_FILE, path=path)
        with path.open("rb") as file:
            # Not to the end: a file of size 0 may never end (/proc), and one that is being recorded grows.
            size = status.st_size if limit is None else min(status.st_size, limit)
            if size > MAX_LOG_BYTES:
                raise Unreadable(
                    Source.FILE_TOO_LARGE, path=path, size_limit=MAX_LOG_BYTES, archive=False
                )
            content = file.read(size)
        if content[:6] == b"\xfd7zXZ\x00":
            content = _unpacked(content, path, limit)
    except FileNotFoundError:
        raise Unreadable(Source.FILE_MISSING, path=path) from None
    except MemoryError:
        raise Unreadable(Source.FILE_TOO_LARGE, path=path, size_limit=None, archive=False) from None
    except Unreadable:
        raise
    except (OSError, ValueError) as error:
        raise Unreadable(Source.FILE_NOT_OPENED, path=path, because=error_message(error)) from None
    if not content.rstrip(b"\0"):
        raise Unreadable(Source.FILE_EMPTY, path=path, zeros=bool(status.st_size))
    return content


def _folder(path: Path) -> Fact:
    """What is said of a folder where a log is needed, with the first log in it."""
    logs = sorted(
        file
        for file in path.iterdir()
        if file.name.lower().endswith(LOG_ENDINGS) and file.is_file()
    )
    example = str(logs[0]) if logs else None
    return Fact(
        Source.FOLDER_GIVEN, path=path, count=len(logs), example=example, endings=LOG_ENDINGS
    )


def _unpacked(content: bytes, path: Path, limit: int | None) -> bytes:
    """The first stream of an xz archive, or its first ``limit`` bytes; ``xz`` writes no second stream."""
    # Unpacking itself may take 128 MiB; the strongest setting of xz takes half.
    decompressor = lzma.LZMADecompressor(lzma.FORMAT_XZ, 1 << 27)
    most = (
        min(MAX_LOG_BYTES, MIN_UNPACKED_LIMIT + MAX_COMPRESSION_RATIO * len(content))
        if limit is None
        else limit
    )
    try:
        unpacked = decompressor.decompress(content, most)
    except lzma.LZMAError as error:
        raise Unreadable(Source.ARCHIVE_DAMAGED, path=path, because=error) from None
    if limit is None and not decompressor.eof:
        if len(unpacked) < most:
            raise Unreadable(Source.ARCHIVE_DAMAGED, path=path, because=None)
        raise Unreadable(Source.FILE_TOO_LARGE, path=path, size_limit=most, archive=True)
    return unpacked
