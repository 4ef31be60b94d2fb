"""Reading a flight log of any format, which is recognised by the first bytes of the file or by its name."""

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mavdem.errors import Unreadable
from mavdem.extras import require_extra
from mavdem.facts.sources import SourceFact
from mavdem.files import AnyPath
from mavdem.ingest.contents import file_beginning, is_dataflash_text
from mavdem.ingest.telemetry import Log
from mavdem.log_formats import (
    COMPRESSED_ENDING,
    ENCRYPTED_ULOG_MAGIC,
    FORMAT_OF_ENDING,
    FORMAT_SIGNATURES,
    PX4_LOG_ENDING,
    UNREAD_LOG_ENDINGS,
    ZIP_ENDING,
    Format,
)
from mavdem.machine import return_freed_memory

if TYPE_CHECKING:
    from mavdem.ingest.mavlink.frame_stream import FrameStream


MIN_BYTES_TO_RETURN = 1 << 26
"""Size of a log from which on the memory that its reading needed is returned to the system: a choice.

Of a smaller one the analysis needs it again immediately, and to return it would take up to a sixth of the time of
reading.
"""


# Damaged files hold numbers that overflow or are NaN. Whoever uses a message leaves them out, without a warning.
@np.errstate(all="ignore")
def read_log(path: AnyPath) -> Log:
    """Reads a recorded flight.

    >>> log = mavdem.ingest.read_log("flight.tlog")
    >>> [(vehicle.system, vehicle.vehicle) for vehicle in log.vehicles]
    [(1, 'QUADROTOR')]
    >>> log.vehicles[0].messages["ATTITUDE"]["roll"].shape == log.vehicles[0].messages["ATTITUDE"]["time"].shape
    True

    Args:
        path: a telemetry log (.tlog), an MCAP recording of MAVLink or ROS 2 (.mcap), an ArduPilot DataFlash log (.bin,
            or as text .log) or a PX4 ULog (.ulg), whatever its name, or an xz or zip archive of one; str, bytes or
            path-like.

    Returns:
        The log, with the telemetry of each vehicle in it.

    Raises:
        Unreadable: the file cannot be opened, has another format, or contains no flight.
        ValueError: ``path`` is not a path.

    See Also:
        :func:`mavdem.read_flight`: what a model is learned from; :class:`mavdem.Telemetry`.
    """
    name, log_format = detect_format(path)
    # A library that only one format needs is imported when a file of that format is read.
    match log_format:
        case Format.ULOG:
            from mavdem.ingest.ulog import read_ulog as read
        case Format.DATAFLASH:
            from mavdem.ingest.dataflash.log import read_dataflash as read
        case Format.MCAP:
            require_extra("mcap", name)
            from mavdem.ingest.mcap.log import read_mcap as read
        case Format.TLOG:
            from mavdem.ingest.tlog import read_tlog as read
    log = read(name)
    if Path(name).stat().st_size >= MIN_BYTES_TO_RETURN:
        # Large temporary arrays are freed by now, but Python's allocator may keep their memory.
        return_freed_memory()
    return log


def read_stream(path: AnyPath) -> "FrameStream":
    """Reads the MAVLink frames of a telemetry log (.tlog) or of an MCAP recording (.mcap), whatever the file's name.

    Args:
        path: the file; str, bytes or path-like.

    Returns:
        The frames with their receive stamps.

    Raises:
        Unreadable: the file cannot be opened, has another format, or contains no MAVLink.
        ValueError: ``path`` is not a path.
    """
    name, log_format = detect_format(path)
    if log_format is Format.MCAP:
        require_extra("mcap", name)
        from mavdem.ingest.mcap.log import mcap_stream

        return mcap_stream(name)
    if log_format is not Format.TLOG:
        raise Unreadable(SourceFact.FORMAT_WITHOUT_FRAMES, path=name, name=log_format)
    from mavdem.ingest.tlog import tlog_stream

    return tlog_stream(name)


PLAUSIBLE_STAMPS = range(946_684_800_000_000, 4_102_444_800_000_000)
"""Receive stamps of a telemetry log, UNIX µs, that are plausible: those of the years 2000 to 2099."""


def looks_like_log(path: AnyPath) -> bool:
    """Returns whether a file is a log, judged by its name and, if the name is not conclusive, by its first bytes.

    This is a quick test for the files in a folder. It also accepts logs that cannot be read (damaged zip archives,
    archives of several logs, log formats of PX4 that are not supported), so that they are reported to the user.

    The start marker of a MAVLink message alone proves little, so a telemetry log under another name must also begin
    with a plausible receive time.

    Args:
        path: the file; str, bytes or path-like.

    Returns:
        True for a log, also for one that cannot be read.
    """
    name = os.fsdecode(path)
    if _format_of_name(name) is not None or name.lower().endswith(UNREAD_LOG_ENDINGS):
        return True
    try:
        beginning = file_beginning(name)
    except Unreadable as error:
        refusal = error.fact
        if refusal.code is SourceFact.ARCHIVE_WITHOUT_ONE_LOG:
            # An archive of several logs counts as a log, one without any does not.
            return bool(refusal.figures["count"])
        return refusal.code is SourceFact.ARCHIVE_DAMAGED and name.lower().endswith(ZIP_ENDING)
    # For most logs the name suffices, so that the modules of MAVLink need not be imported. They take time.
    from mavdem.ingest.mavlink.framing import MARKERS
    from mavdem.ingest.tlog import STAMP_BYTES

    stamp = int.from_bytes(beginning[:STAMP_BYTES], "big")
    if stamp in PLAUSIBLE_STAMPS and beginning.startswith(MARKERS, STAMP_BYTES):
        return True
    if is_dataflash_text(beginning) or beginning.startswith(ENCRYPTED_ULOG_MAGIC):
        return True
    return _format_of_first_bytes(beginning) is not None


OTHER_FORMATS = {b"\x1f\x8b": "gzip", b"PAR1": "parquet", b"time_s,": "csv"}
"""First bytes of files that often contain a log, or a table of its flight, but are not read, and their names."""

DATAFLASH_LINE = re.compile(rb"^(ATT|RATE|IMU|RCOU|CTUN|GPS|PARM|MODE), *\d", re.MULTILINE)
"""Line of a DataFlash log as text, by which one is recognised that lacks its definitions."""

GIT_LFS_POINTER = b"version https://git-lfs.github.com/spec/"
"""First bytes of the text that replaces a file in a Git repository whose large files were not fetched."""


def detect_format(path: AnyPath) -> tuple[str, Format]:
    """Recognises the format of a log.

    Fixed first bytes decide, whatever the name. A file without them is a telemetry log if a MAVLink frame follows the
    first receive stamp. Else the name decides, since a beginning may be damaged; a binary file of another name may be
    a telemetry log whose first frames are damaged.

    Args:
        path: The file; str, bytes or path-like.

    Returns:
        The name of the file as text, and its format.

    Raises:
        Unreadable: The file cannot be opened, or has another format.
        ValueError: ``path`` is not a path.
    """
    if not isinstance(path, str | bytes | os.PathLike):
        raise ValueError(f"path must name a file, not be {path!r}")
    name = os.fsdecode(path)
    beginning = file_beginning(name)
    if beginning.startswith(ENCRYPTED_ULOG_MAGIC):
        raise Unreadable(SourceFact.ULOG_ENCRYPTED, path=name)
    if name.lower().endswith(PX4_LOG_ENDING):
        raise Unreadable(SourceFact.PX4_LOG_BEFORE_ULOG, path=name)
    log_format = _format_of_first_bytes(beginning)
    if log_format is not None:
        return name, log_format
    if is_dataflash_text(beginning):
        return name, Format.DATAFLASH
    if beginning.startswith(GIT_LFS_POINTER):
        raise Unreadable(SourceFact.GIT_LFS_POINTER, path=name)
    for first_bytes, other_format in OTHER_FORMATS.items():
        if beginning.startswith(first_bytes):
            raise Unreadable(SourceFact.FORMAT_UNKNOWN, path=name, name=other_format)
    from mavdem.ingest.mavlink.framing import MARKERS
    from mavdem.ingest.tlog import STAMP_BYTES

    if beginning.startswith(MARKERS, STAMP_BYTES):
        return name, Format.TLOG
    log_format = _format_of_name(name)
    if log_format is not None and log_format is not Format.TLOG:
        return name, log_format
    if _is_binary(beginning):
        return name, Format.TLOG
    if DATAFLASH_LINE.search(beginning):
        raise Unreadable(SourceFact.DATAFLASH_WITHOUT_DEFINITIONS, path=name, count=0)
    raise Unreadable(SourceFact.FORMAT_UNKNOWN, path=name, name="text")


def _format_of_first_bytes(beginning: bytes) -> Format | None:
    """Returns the format whose fixed first bytes a file has; None without any."""
    for log_format, signature in FORMAT_SIGNATURES.items():
        if signature.first_bytes and beginning.startswith(signature.first_bytes):
            return log_format
    return None


def _format_of_name(name: str) -> Format | None:
    """Returns the format by the ending of a file's name, also of an archive; None if no format has that ending."""
    uncompressed_name = name.lower().removesuffix(COMPRESSED_ENDING)
    return FORMAT_OF_ENDING.get(Path(uncompressed_name).suffix)


FIRST_TEXT_CONTROL, LAST_TEXT_CONTROL = 9, 13
"""Range of the control characters that texts contain: tabulator, line feed, vertical tab, form feed, return."""

ESCAPE = 27
"""Control character with which coloured texts begin their colours."""

FIRST_PRINTABLE, LAST_PRINTABLE = 32, 126
"""Range of the printable ASCII characters."""


def _is_binary(content: bytes) -> bool:
    """Returns whether some byte is no character of an ASCII text."""
    for byte in content:
        is_control = FIRST_TEXT_CONTROL <= byte <= LAST_TEXT_CONTROL or byte == ESCAPE
        if not is_control and not FIRST_PRINTABLE <= byte <= LAST_PRINTABLE:
            return True
    return False
