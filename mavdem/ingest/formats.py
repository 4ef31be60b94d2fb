"""Which format a log file has, by its first bytes and then by its name, and which reader it takes."""

import os
from enum import StrEnum
from pathlib import Path

import numpy as np

from mavdem.errors import Unreadable
from mavdem.facts.sources import Source
from mavdem.files import AnyPath
from mavdem.ingest.contents import file_beginning, is_dataflash_text
from mavdem.ingest.mavlink.framing import MARKERS
from mavdem.ingest.mavlink.vehicles import FrameStream
from mavdem.ingest.telemetry import Log
from mavdem.ingest.tlog import STAMP_BYTES, tlog_stream


class Format(StrEnum):
    """What logs are written in."""

    ULOG = "ulog"
    DATAFLASH = "dataflash"
    MCAP = "mcap"
    TLOG = "tlog"


BEGINNINGS = {
    b"ULog\x01\x12\x35": Format.ULOG,
    b"\xa3\x95": Format.DATAFLASH,
    b"\x89MCAP0\r\n": Format.MCAP,
}
"""First bytes of each format that has fixed ones."""
EXTENSIONS = {".ulg": Format.ULOG, ".bin": Format.DATAFLASH, ".mcap": Format.MCAP}
"""Format by file name, for a file whose beginning is damaged."""
ARCHIVES = {b"\x1f\x8b": "gzip", b"PK\x03\x04": "zip", b"PAR1": "parquet", b"time_s,": "csv"}
"""First bytes of files that often contain a log, or a table of its flight, but are not read."""

# µs since 1970, of the years 2000 to 2099
STAMPS = range(946_684_800_000_000, 4_102_444_800_000_000)


# Damage makes numbers that are none; who uses a message leaves them out.
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
            or as text .log) or a PX4 ULog (.ulg), whatever its name, or an xz archive of one; str, bytes or path-like.

    Raises:
        Unreadable: the file cannot be opened, has another format, or contains no flight.
        ValueError: ``path`` is not a path.

    See Also:
        :func:`mavdem.read_flight`: what a model is learned from; :class:`mavdem.Telemetry`.
    """
    name, kind = format_of(path)
    # A library that only one format needs is imported when a file of that format is read.
    match kind:
        case Format.ULOG:
            from mavdem.ingest.ulog import read_ulog as read
        case Format.DATAFLASH:
            from mavdem.ingest.dataflash.log import read_dataflash as read
        case Format.MCAP:
            from mavdem.ingest.mcap.log import read_mcap as read
        case Format.TLOG:
            from mavdem.ingest.tlog import read_tlog as read
    return read(name)


def looks_like_log(path: AnyPath) -> bool:
    """Returns whether a file is a log, by its name or else by its first bytes; it need not be readable."""
    name = os.fsdecode(path)
    if Path(name.lower().removesuffix(".xz")).suffix in (*EXTENSIONS, ".tlog"):
        return True
    try:
        beginning = file_beginning(name)
    except Unreadable:
        return False
    stamped = int.from_bytes(beginning[:STAMP_BYTES], "big") in STAMPS
    return (
        (stamped and beginning.startswith(MARKERS, STAMP_BYTES))
        or is_dataflash_text(beginning)
        or beginning.startswith(tuple(BEGINNINGS))
    )


def read_stream(path: AnyPath) -> FrameStream:
    """Reads the MAVLink frames of a telemetry log (.tlog) or of an MCAP recording (.mcap), whatever the file's name.

    Raises Unreadable: it cannot be opened, has another format, or no MAVLink; ValueError: ``path`` is not a path.
    """
    name, kind = format_of(path)
    if kind is Format.MCAP:
        from mavdem.ingest.mcap.log import mcap_stream

        return mcap_stream(name)
    if kind is not Format.TLOG:
        raise Unreadable(Source.FORMAT_WITHOUT_FRAMES, path=name, name=kind)
    return tlog_stream(name)


def format_of(path: AnyPath) -> tuple[str, Format]:
    """Returns the name of a file and its format; raises ``Unreadable`` where that is none, ``ValueError``: no path."""
    if not isinstance(path, str | bytes | os.PathLike):
        raise ValueError(f"path must name a file, not be {path!r}")
    name = os.fsdecode(path)
    beginning = file_beginning(name)
    kind = next((kind for first, kind in BEGINNINGS.items() if beginning.startswith(first)), None)
    if kind or is_dataflash_text(beginning):
        return name, kind or Format.DATAFLASH
    if beginning.startswith(b"version https://git-lfs.github.com/spec/"):
        raise Unreadable(Source.GIT_LFS_POINTER, path=name)
    other = next((other for first, other in ARCHIVES.items() if beginning.startswith(first)), None)
    if other is None:
        if beginning.startswith(MARKERS, STAMP_BYTES):
            return name, Format.TLOG
        kind_by_name = EXTENSIONS.get(Path(name.removesuffix(".xz")).suffix.lower())
        binary = any(
            byte < 9 or (13 < byte < 32 and byte != 27) or byte > 126 for byte in beginning
        )
        if kind_by_name is not None or binary:
            return name, kind_by_name or Format.TLOG
    raise Unreadable(Source.FORMAT_UNKNOWN, path=name, name=other or "text")
