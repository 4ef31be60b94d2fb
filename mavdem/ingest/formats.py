"""Which kind of log a file is, by its first bytes and then by its name, and who reads it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from mavdem.errors import Unreadable
from mavdem.ingest.dataflash_text import is_text as is_dataflash_text
from mavdem.ingest.files import READ, file_beginning
from mavdem.ingest.framing import MARKER_1, MARKER_2, Progress
from mavdem.ingest.log import Log
from mavdem.ingest.receipt import STAMP
from mavdem.ingest.tlog import read_tlog

ULOG, DATAFLASH, DATAFLASH_TEXT = "PX4 ULog", "DataFlash", "DataFlash as text"
MCAP, TLOG = "MCAP recording", "telemetry log"
BEGINNINGS = {b"ULog\x01\x12\x35": ULOG, b"\xa3\x95": DATAFLASH, b"\x89MCAP0\r\n": MCAP}
"""First bytes of the logs that can be read and begin in one way."""
NAMES = {".ulg": ULOG, ".bin": DATAFLASH, ".mcap": MCAP}
"""What a file is by its name, where its beginning is damaged."""
OTHERS = {
    b"\x1f\x8b": "a gzip archive",
    b"PK\x03\x04": "a zip archive",
}
"""First bytes of the files that are often at hand where a log is meant."""
SAMPLE = 4096


def read_log(path: str | bytes | os.PathLike[str], progress: Progress | None = None) -> Log:
    """Reads a recorded flight.

    Args:
        path: a telemetry log (.tlog), an MCAP recording of MAVLink or ROS 2 (.mcap), an ArduPilot DataFlash log (.bin,
            or as text .log) or a PX4 ULog (.ulg), whatever its name, or an xz archive of one; str, bytes or path-like.
        progress: called with the fraction done.

    Raises:
        Unreadable: the file cannot be opened, is of another kind, or there is no flight in it.
        ValueError: ``path`` is no path.
    """
    if not isinstance(path, str | bytes | os.PathLike):
        raise ValueError(f"path must name a file, not be {path!r}")
    name = os.fsdecode(path)
    beginning = file_beginning(name, SAMPLE)
    reader = _reader(_kind(name, beginning))
    if reader is None:
        other = next((other for first, other in OTHERS.items() if beginning.startswith(first)), "text")
        raise Unreadable(f"{name} is {other}: {READ}.")
    return reader(name, progress)


def _kind(name: str, beginning: bytes) -> str | None:
    """None for what is surely something else."""
    for first, kind in BEGINNINGS.items():
        if beginning.startswith(first):
            return kind
    if is_dataflash_text(beginning):
        return DATAFLASH_TEXT
    if beginning.startswith(tuple(OTHERS)):
        return None
    if len(beginning) > STAMP and beginning[STAMP] in (MARKER_1, MARKER_2):
        return TLOG
    named = NAMES.get(Path(name.removesuffix(".xz")).suffix.lower())
    return named or (None if _is_text(beginning) else TLOG)


def _reader(kind: str | None) -> Callable[[str, Progress | None], Log] | None:
    """Libraries that only one kind of log needs are imported when it comes."""
    if kind == ULOG:
        from mavdem.ingest.ulog import read_ulog

        return read_ulog
    if kind in (DATAFLASH, DATAFLASH_TEXT):
        from mavdem.ingest.dataflash import read_dataflash

        return read_dataflash
    if kind == MCAP:
        from mavdem.ingest.mcap_log import read_mcap

        return read_mcap
    return read_tlog if kind == TLOG else None


def _is_text(content: bytes) -> bool:
    return not any(byte < 9 or (13 < byte < 32 and byte != 27) or byte > 126 for byte in content)
