"""Writing a recorded stream as a telemetry log: each frame behind the big-endian microseconds it was received."""

from __future__ import annotations

import struct
from typing import BinaryIO

from mavdem.ingest.stream import Stream


def write_tlog(file: BinaryIO, stream: Stream) -> int:
    """Writes every frame with its stamp and answers how many there were.

    Args:
        file: open for writing.
        stream: what to write; messages that could not be made a frame of are left out.
    """
    count = 0
    for stamp, frame in stream.stamped_frames():
        file.write(struct.pack(">Q", stamp) + frame)
        count += 1
    return count
