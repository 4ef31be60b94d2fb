"""The stream of MAVLink frames in a file that holds one."""

from __future__ import annotations

import os

from mavdem.errors import Unreadable
from mavdem.ingest.files import file_beginning
from mavdem.ingest.formats import BEGINNINGS, MCAP, NAMES
from mavdem.ingest.framing import Progress
from mavdem.ingest.mcap_log import mcap_stream
from mavdem.ingest.stream import Stream
from mavdem.ingest.tlog import tlog_stream


def read_stream(path: str | os.PathLike[str], progress: Progress | None = None) -> Stream:
    """Reads the frames of a telemetry log (.tlog) or of an MCAP recording (.mcap), whatever the file's name.

    Args:
        path: the file.
        progress: called with the fraction done.

    Raises:
        Unreadable: the file cannot be opened, is of another kind, or there is no MAVLink in it.
    """
    beginning = file_beginning(path, max(map(len, BEGINNINGS)))
    kind = next((kind for first, kind in BEGINNINGS.items() if beginning.startswith(first)), None)
    if kind == MCAP or (kind is None and NAMES.get(os.path.splitext(path)[1].lower()) == MCAP):
        return mcap_stream(path, progress)
    if kind is not None:
        raise Unreadable(f"{os.fspath(path)} is {kind}, which holds no MAVLink frames: convert it to a table (.csv).")
    return tlog_stream(path, progress)
