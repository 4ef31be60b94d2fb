"""Which kind of log a file is, by its first bytes and then by its name."""

from __future__ import annotations

import os
from pathlib import Path

from mavdem.errors import Unreadable
from mavdem.ingest.files import file_bytes
from mavdem.ingest.framing import MARKER_1, MARKER_2, Progress
from mavdem.ingest.log import Log
from mavdem.ingest.tlog import STAMP, read_tlog

BEGINNINGS = {
    b"\x89MCAP0\r\n": "an MCAP recording",
    b"ULog\x01\x12\x35": "a PX4 ULog",
    b"\x1f\x8b": "a gzip archive",
    b"PK\x03\x04": "a zip archive",
    b"\xfd7zXZ\x00": "an xz archive",
}
"""First bytes of the files that are often at hand where a telemetry log is meant."""
NAMES = {".mcap": "an MCAP recording", ".ulg": "a PX4 ULog"}
READ = "telemetry logs (.tlog) and ArduPilot DataFlash logs (.bin, .log)"
TEXT_SAMPLE = 4096


def read_log(path: str | bytes | os.PathLike[str], progress: Progress | None = None) -> Log:
    """Reads a recorded flight.

    Args:
        path: a telemetry log (.tlog) or an ArduPilot DataFlash log (.bin, .log), whatever its name; str, bytes or
            path-like.
        progress: called with the fraction done.

    Raises:
        Unreadable: the file cannot be opened, is of another kind, or there is no MAVLink in it.
        ValueError: ``path`` is no path.
    """
    if not isinstance(path, str | bytes | os.PathLike):
        raise ValueError(f"path must name a file, not be {path!r}")
    name = os.fsdecode(path)
    content = file_bytes(name)[:TEXT_SAMPLE]
    if _is_dataflash(name, content):
        from mavdem.ingest.dataflash import read_dataflash

        return read_dataflash(name, progress)
    kind = next((kind for beginning, kind in BEGINNINGS.items() if content.startswith(beginning)), None)
    if kind is None and not _begins_like_tlog(content):
        kind = NAMES.get(Path(name).suffix.lower()) or ("text" if _is_text(content) else None)
    if kind is not None:
        raise Unreadable(f"{name} is {kind}: this version reads {READ} only.")
    return read_tlog(name, progress)


def _is_dataflash(name: str, content: bytes) -> bool:
    """By its first bytes, or a damaged one by its name."""
    from mavdem.ingest.dataflash_text import is_text

    named = Path(name).suffix.lower() == ".bin" and not _begins_like_tlog(content)
    return content.startswith(b"\xa3\x95") or is_text(content) or named and not content.startswith(tuple(BEGINNINGS))


def _begins_like_tlog(content: bytes) -> bool:
    return len(content) > STAMP and content[STAMP] in (MARKER_1, MARKER_2)


def _is_text(content: bytes) -> bool:
    return not any(byte < 9 or (13 < byte < 32 and byte != 27) or byte > 126 for byte in content)
