"""The bytes of a log file, unpacked if it is an archive (xz, or zip), or the reason why they cannot be read."""

import io
import lzma
import mmap
import re
import stat
import zipfile
import zlib
from pathlib import Path

import numpy as np

from mavdem.errors import Unreadable, error_message
from mavdem.facts import Fact
from mavdem.facts.sources import SourceFact
from mavdem.files import PathName
from mavdem.ingest.byte_rows import RESIDENT_BYTES, Bytes, release_pages
from mavdem.log_formats import LOG_ENDINGS

WEB_ADDRESS = re.compile(r"(?P<scheme>https?|ftp|s3|gs):/+(?P<rest>.*)", re.IGNORECASE)
"""An address on the web; as a path it has one slash after the scheme."""

RECOGNITION_BYTES = 4096
"""Number of a file's first bytes by which its format is recognised: a choice, with room for comments before it."""

BEGINNING_BYTES = 1 << 16
"""Number of bytes that are read of a file for its beginning; unpacked they are hardly ever fewer."""

MAX_LOG_BYTES = 1 << 30
"""Largest file that is read into memory, and largest content of an archive: hours of the densest logs."""

MIN_MAPPED_BYTES = 1 << 26
"""Size from which on a file is mapped into memory instead of being read: a choice.

Only what is looked at of a mapped file takes memory. But a program that shortens it meanwhile ends the process, so that
files that fit into memory easily are read.
"""

MIN_UNPACKED_LIMIT = 1 << 26
"""Number of bytes that any archive may unpack to, however small it is."""

MAX_COMPRESSION_RATIO = 100
"""Number of bytes that an archive may unpack to beyond ``MIN_UNPACKED_LIMIT``, for each byte of its own.

A choice: a small archive can be made to unpack to any number of bytes.
"""

UNPACKING_MEMORY = 1 << 27
"""Memory, bytes, that unpacking an xz archive may take by itself; the strongest setting of xz takes half of it."""

XZ_MAGIC = b"\xfd7zXZ\x00"
"""First bytes of an xz archive (https://tukaani.org/xz/xz-file-format.txt, section 2.1.1.1)."""

ZIP_MAGIC = b"PK\x03\x04"
"""First bytes of a zip archive (PKWARE's APPNOTE.TXT, section 4.3.7)."""

EMPTY_ZIP_MAGIC = b"PK\x05\x06"
"""First bytes of a zip archive without a file: its end record."""

ARCHIVE_MAGICS = (XZ_MAGIC, ZIP_MAGIC, EMPTY_ZIP_MAGIC)
"""First bytes of the archives that are unpacked."""

BOUNDED_COMPRESSION_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Compression methods of zip archives that are read: Python's zipfile can unpack these up to a bound.

With the others (bzip2, LZMA) it unpacks all of the bytes that it has read: a kilobyte becomes a gigabyte before any
bound is checked.
"""

MAX_DIRECTORY_BYTES = 1 << 20
"""Largest directory of a zip archive that is read, bytes: it has some ten thousand names.

For each name zipfile makes an object, which takes about a kilobyte of memory.
"""

ENCRYPTION_FLAG = 1
"""Bit in the flags of a zip archive's member that needs a password (section 4.4.4 there)."""

MACOS_FOLDER = "__MACOSX/"
"""Folder of the files that macOS adds to zip archives; they have the names of the others."""

DATAFLASH_TEXT_DEFINITION = b"\nFMT,"
"""Beginning of a line that defines a message in a DataFlash log written as text."""


def file_bytes(path: PathName) -> bytes:
    """Reads the whole file, the contents of an xz archive, or the one log in a zip archive.

    Args:
        path: Path of the file or archive.

    Returns:
        The bytes of the log.

    Raises:
        Unreadable: It is missing, no plain file, not permitted, empty, larger than ``MAX_LOG_BYTES`` or than the
            memory, a damaged archive, or a zip archive of several logs or of none.
    """
    return _read_unpacked(path)


FileContent = bytes | mmap.mmap
"""The bytes of a file: read, or mapped into memory."""


def file_content(path: PathName) -> FileContent:
    """Returns the bytes of a file, mapped into memory if it is large.

    An archive is never mapped, since it must be unpacked (:func:`file_bytes`).

    Args:
        path: Path of the file or archive.

    Returns:
        The bytes, or a mapping, which is read from the disk as it is used.

    Raises:
        Unreadable: As ``file_bytes``.
    """
    path = Path(path)
    size = path.stat().st_size if path.is_file() else 0
    # A folder or a device counts as size 0; ``file_bytes`` raises the error for it, and for a file that is too large.
    is_mappable = MIN_MAPPED_BYTES <= size <= MAX_LOG_BYTES
    if not is_mappable:
        return file_bytes(path)
    try:
        with path.open("rb") as file:
            mapping = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:
        raise Unreadable(
            SourceFact.FILE_NOT_OPENED, path=path, reason=error_message(error)
        ) from None
    if mapping[: len(XZ_MAGIC)].startswith(ARCHIVE_MAGICS):
        return file_bytes(path)
    if not _has_content(np.frombuffer(mapping, dtype=np.uint8)):
        raise Unreadable(SourceFact.FILE_EMPTY, path=path, zeros=True)
    return mapping


def mapped_bytes(path: PathName) -> Bytes:
    """Returns the bytes (B,) of a file as ``file_content`` does.

    Raises:
        Unreadable: As ``file_bytes``.
    """
    return np.frombuffer(file_content(path), dtype=np.uint8)


def _has_content(data: Bytes) -> bool:
    """Returns whether any byte of a file (B,) is not zero."""
    for start in range(0, len(data), RESIDENT_BYTES):
        if data[start : start + RESIDENT_BYTES].any():
            return True
        release_pages(data)
    return False


def file_beginning(path: PathName) -> bytes:
    """Returns the first 4096 bytes of a file or of what an archive contains; fewer where it is shorter.

    Raises:
        Unreadable: As ``file_bytes``, as far as these bytes show it.
    """
    return _read_unpacked(path, limit=BEGINNING_BYTES)[:RECOGNITION_BYTES]


def is_dataflash_text(content: bytes) -> bool:
    """Returns whether a log with this beginning is a DataFlash log as text.

    Some ground stations write a few words before the first definition.
    """
    return DATAFLASH_TEXT_DEFINITION in b"\n" + content[:RECOGNITION_BYTES]


def _read_unpacked(path: PathName, limit: int | None = None) -> bytes:
    """Reads a file, and unpacks it if it is a ZIP or XZ archive.

    Every failure becomes an ``Unreadable`` with a fact that states the cause to the user: a folder, a device, a missing
    or empty file, too little memory.

    Args:
        path: The file.
        limit: Greatest number of bytes to read from the file, and again to unpack from an archive; None for everything.

    Returns:
        The content, not empty.

    Raises:
        Unreadable: The file cannot be read or unpacked, or contains no data: it is empty, or all its bytes are zero.
    """
    path = Path(path)
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise Unreadable(_folder_fact(path))
        if not stat.S_ISREG(status.st_mode):
            raise Unreadable(SourceFact.SPECIAL_FILE, path=path)
        content = _packed_content(path, status.st_size, limit)
        if content.startswith((ZIP_MAGIC, EMPTY_ZIP_MAGIC)):
            content = _content_of_zip(path, limit)
        if content.startswith(XZ_MAGIC):
            content = _content_of_xz(content, path, limit)
    except FileNotFoundError:
        address = WEB_ADDRESS.fullmatch(str(path))
        if address is not None:
            raise Unreadable(
                SourceFact.WEB_ADDRESS, path=f"{address['scheme']}://{address['rest']}"
            ) from None
        raise Unreadable(SourceFact.FILE_MISSING, path=path) from None
    except MemoryError:
        raise Unreadable(
            SourceFact.FILE_TOO_LARGE, path=path, size_limit=None, archive=""
        ) from None
    except Unreadable:
        raise
    except (OSError, ValueError) as error:
        raise Unreadable(
            SourceFact.FILE_NOT_OPENED, path=path, reason=error_message(error)
        ) from None
    # Files that lost their data are all zeros. The ends are looked at first, since strip() copies the content.
    may_be_all_zeros = bool(content) and content[0] == 0 and content[-1] == 0
    is_all_zeros = may_be_all_zeros and not content.strip(b"\0")
    if not content or is_all_zeros:
        raise Unreadable(SourceFact.FILE_EMPTY, path=path, zeros=bool(status.st_size))
    return content


def _packed_content(path: Path, size: int, limit: int | None) -> bytes:
    """Returns the bytes of a file as they are, without unpacking.

    Exactly ``size`` bytes are read, not all up to the end: a file of size 0 may never end (in /proc), and one that is
    being recorded grows.

    Args:
        path: Path of the file.
        size: Size of the file, bytes.
        limit: Number of bytes to read at most; None for ``size``.

    Returns:
        The bytes.

    Raises:
        Unreadable: More than ``MAX_LOG_BYTES`` would have to be read.
    """
    if limit is not None:
        size = min(size, limit)
    with path.open("rb") as file:
        if size > MAX_LOG_BYTES:
            raise Unreadable(
                SourceFact.FILE_TOO_LARGE, path=path, size_limit=MAX_LOG_BYTES, archive=""
            )
        return file.read(size)


def _folder_fact(path: Path) -> Fact:
    """Returns the fact that a folder was given where a log is needed.

    A fact is a coded finding with the figures of its sentence.

    Args:
        path: Path of the folder.

    Returns:
        The fact, with the number of logs in the folder, which are known by the endings of their names, and the path of
        the first log as an example; without a log there is no example.
    """
    logs = []
    for file in path.iterdir():
        if file.name.lower().endswith(LOG_ENDINGS) and file.is_file():
            logs.append(file)
    logs.sort()
    example = str(logs[0]) if logs else None
    return Fact(
        SourceFact.FOLDER_GIVEN, path=path, count=len(logs), example=example, endings=LOG_ENDINGS
    )


def _content_of_xz(content: bytes, path: Path, limit: int | None) -> bytes:
    """Unpacks the first stream of an xz archive; ``xz`` writes no second stream.

    The size of the result is bounded by the size of the archive, since a malicious one of some kilobytes can unpack to
    more than any memory holds.

    Args:
        content: The archive, or its beginning.
        path: Path of the archive, for error messages.
        limit: Greatest number of bytes to unpack; None for everything, and then the archive must be complete.

    Returns:
        The unpacked bytes, at most ``limit``.

    Raises:
        Unreadable: The archive is damaged, cut off, or unpacks to more than a log would.
    """
    decompressor = lzma.LZMADecompressor(lzma.FORMAT_XZ, UNPACKING_MEMORY)
    max_size = limit
    if max_size is None:
        max_size = min(MAX_LOG_BYTES, MIN_UNPACKED_LIMIT + MAX_COMPRESSION_RATIO * len(content))
    try:
        unpacked_bytes = decompressor.decompress(content, max_size)
    except lzma.LZMAError as error:
        raise Unreadable(SourceFact.ARCHIVE_DAMAGED, path=path, reason=error, kind="xz") from None
    if limit is None and not decompressor.eof:
        # The archive has not ended: either the file is cut off, or the bound on the unpacked size was reached.
        if len(unpacked_bytes) < max_size:
            raise Unreadable(SourceFact.ARCHIVE_DAMAGED, path=path, reason=None, kind="xz")
        raise Unreadable(SourceFact.FILE_TOO_LARGE, path=path, size_limit=max_size, archive="xz")
    return unpacked_bytes


def _content_of_zip(path: Path, limit: int | None) -> bytes:
    """Returns the log in a zip archive, whose unpacked size may be at most a multiple of its packed size.

    The bound is needed since a malicious archive of some kilobytes can unpack to more than any memory holds.

    Args:
        path: Path of the archive.
        limit: Number of bytes to read at most; None for the whole log.

    Returns:
        The bytes of the only log in the archive, or its first ``limit`` bytes.

    Raises:
        Unreadable: The archive is damaged, needs a password or is packed in a rare way, contains several logs or none,
            or its directory or its log is too large.
    """
    try:
        with (
            _LimitedReader(io.FileIO(path)) as archive_file,
            _open_zip(archive_file) as archive,
        ):
            member = _only_log(archive, path)
            # A malicious directory may state a packed size that is larger than the file.
            packed_size = min(member.compress_size, path.stat().st_size)
            bounded_size = MIN_UNPACKED_LIMIT + MAX_COMPRESSION_RATIO * packed_size
            max_size = min(MAX_LOG_BYTES, bounded_size)
            with archive.open(member) as file:
                # One byte more than allowed shows that the log is too large.
                content = file.read(max_size + 1 if limit is None else limit)
    except _ReadTooLarge:
        raise Unreadable(
            SourceFact.ARCHIVE_DAMAGED, path=path, reason="directory", kind="zip"
        ) from None
    # The library raises a RuntimeError without a password.
    except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, RuntimeError) as error:
        raise Unreadable(
            SourceFact.ARCHIVE_DAMAGED, path=path, reason=error_message(error), kind="zip"
        ) from None
    if limit is None and len(content) > max_size:
        raise Unreadable(SourceFact.FILE_TOO_LARGE, path=path, size_limit=max_size, archive="zip")
    if content.startswith((ZIP_MAGIC, EMPTY_ZIP_MAGIC)):
        # An archive within the archive is not unpacked.
        names = [member.filename]
        raise Unreadable(SourceFact.ARCHIVE_WITHOUT_ONE_LOG, path=path, names=names, count=0)
    return content


class _ReadTooLarge(Exception):
    """One call would read more bytes than a :class:`_LimitedReader` allows."""


class _LimitedReader(io.BufferedReader):
    """A file that can refuse to read many bytes at once.

    Attributes:
        max_read_size: Largest number of bytes that one call of ``read`` may ask for; None for no limit.
    """

    max_read_size: int | None = None

    def read(self, size: int | None = -1, /) -> bytes:
        """Returns the next bytes of the file.

        Args:
            size: Largest number of bytes; None or -1 for all that follow, to which the limit does not apply.

        Raises:
            _ReadTooLarge: The number is larger than ``max_read_size``.
        """
        if self.max_read_size is not None and size is not None and size > self.max_read_size:
            raise _ReadTooLarge
        return super().read(size)


def _open_zip(file: _LimitedReader) -> zipfile.ZipFile:
    """Opens a zip archive and reads its directory, unless this is longer than ``MAX_DIRECTORY_BYTES``.

    zipfile has no limit of its own: it makes an object for each name in the directory, however many there are. But it
    reads the directory with a single call of ``read``, before it makes any object. All its other reads on opening are
    shorter than the limit. So a limit of each read on opening is one of the directory.

    Args:
        file: The file of the archive. Once the archive is open, its reads are not limited: those of the archive's
            content are bounded elsewhere.

    Returns:
        The open archive.

    Raises:
        _ReadTooLarge: The directory is too long.
        zipfile.BadZipFile: The directory is damaged or missing.
    """
    file.max_read_size = MAX_DIRECTORY_BYTES
    archive = zipfile.ZipFile(file)
    file.max_read_size = None
    return archive


def _only_log(archive: zipfile.ZipFile, path: Path) -> zipfile.ZipInfo:
    """Returns the entry of the one log in a zip archive.

    It is the only file whose name has the ending of a log, or, if no name has such an ending, the only file. Folders
    and the files that macOS adds to archives do not count.

    Args:
        archive: The opened archive.
        path: Path of the archive, for error messages.

    Returns:
        The entry of the log.

    Raises:
        Unreadable: There are several logs, or none, or the log needs a password or is packed in a rare way.
    """
    files = []
    for member in archive.infolist():
        if not member.is_dir() and not member.filename.startswith(MACOS_FOLDER):
            files.append(member)
    logs = [member for member in files if member.filename.lower().endswith(LOG_ENDINGS)]
    if not logs and len(files) == 1:
        logs = files
    if len(logs) != 1:
        names = [member.filename for member in logs]
        raise Unreadable(
            SourceFact.ARCHIVE_WITHOUT_ONE_LOG, path=path, names=names, count=len(names)
        )
    if logs[0].flag_bits & ENCRYPTION_FLAG:
        raise Unreadable(SourceFact.ARCHIVE_DAMAGED, path=path, reason="password", kind="zip")
    if logs[0].compress_type not in BOUNDED_COMPRESSION_METHODS:
        raise Unreadable(SourceFact.ARCHIVE_DAMAGED, path=path, reason="packing", kind="zip")
    return logs[0]
