"""Writing a recorded stream as a telemetry log: each frame behind the big-endian microseconds it was received."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import BinaryIO

from mavdem.ingest.stream import Stream


def write_tlog(file: BinaryIO, stream: Stream) -> int:
    """Writes every frame with its stamp and answers how many there were.

    Args:
        file: open for writing.
        stream: what to write; messages that could not be made a frame of are left out.
    """
    return write_stamped(file, stream.stamped_frames())


def write_stamped(file: BinaryIO, frames: Iterable[tuple[int, bytes]]) -> int:
    """Writes frames, each with its UNIX microseconds, and answers how many there were."""
    count = 0
    for stamp, frame in frames:
        file.write(struct.pack(">Q", stamp) + frame)
        count += 1
    return count
