"""Telemetry logs (.tlog): reading and writing MAVLink frames, each behind the 8-byte time at which it was received.

The receive stamp is big-endian microseconds since 1970. It may be late by seconds, so messages are placed in time by
the autopilot's own stamps (``mavlink.clocks``) instead. Layout: pymavlink ``mavutil.mavlogfile``.
"""

import os
import struct
from collections.abc import Iterable
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Integers
from mavdem.errors import Unreadable
from mavdem.facts import Facts
from mavdem.facts.sources import Repair, Source
from mavdem.files import PathName
from mavdem.ingest.byte_rows import Bytes, rows_of
from mavdem.ingest.contents import file_bytes
from mavdem.ingest.mavlink.definitions import crc_extra_table
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES, find_frames
from mavdem.ingest.mavlink.vehicles import FrameStream, assemble
from mavdem.ingest.telemetry import Log, repair_facts

STAMP_BYTES = np.dtype(np.uint64).itemsize
"""Number of bytes of the receive stamp before each frame."""

MIN_FRAME_DENSITY = 1e-6
"""Frames with a matching checksum per byte that belongs to no frame, below which a file is no telemetry log.

In random bytes a frame is found by chance every 7 million bytes (1.5e-7).
"""

MIN_LINE_FEEDS = 8
"""Number of line feeds that must all follow a carriage return for a text-mode transfer to be undone.

By chance, 8 such bytes follow 8 carriage returns once in 2^64.
"""


def read_tlog(path: PathName) -> Log:
    """Reads a telemetry log, a damaged one as far as possible.

    Raises:
        Unreadable: The file cannot be opened, or contains no MAVLink.
    """
    return assemble(tlog_stream(path))


def tlog_stream(path: PathName) -> FrameStream:
    """Finds the frames of a telemetry log and their receive stamps, in the order received.

    In an undamaged log 8 bytes of stamp lie before each frame. Where the distance to the frame before is different,
    some bytes are damaged, and the frame has no stamp. A file with hardly any frame for its size is something else.

    Raises:
        Unreadable: The file cannot be opened, or contains no MAVLink.
    """
    source = os.fspath(path)
    data, repairs = _without_carriage_returns(file_bytes(path))
    frames = find_frames(data, crc_extra_table(), STAMP_BYTES)
    bytes_before = frames.start - np.concatenate([[0], frames.end[:-1]])
    covered = np.minimum(bytes_before, STAMP_BYTES) + frames.size
    skipped = len(data) - int(covered.sum())
    matching = np.count_nonzero(frames.checksum == CHECKSUM_MATCHES)
    if len(frames) and not matching:
        count = len(frames)
        raise Unreadable(Source.DIALECT_UNKNOWN, path=source, count=count, recording=False)
    if matching <= MIN_FRAME_DENSITY * skipped:
        raise Unreadable(Source.FORMAT_UNKNOWN, path=source, name="mavlink")
    # After damage, the bytes before a frame may be anything.
    has_stamp = bytes_before == STAMP_BYTES
    stamps = _receive_stamps(data, frames.start)
    stamps[~has_stamp] = 0
    return FrameStream(source, ".tlog", data, frames, stamps, skipped, repairs)


def write_tlog(file: BinaryIO, stream: FrameStream) -> int:
    """Writes every frame of a stream with its stamp and returns how many there were."""
    return write_stamped(file, stream.stamped_frames())


def write_stamped(file: BinaryIO, frames: Iterable[tuple[int, bytes]]) -> int:
    """Writes frames, each behind its receive stamp.

    Args:
        file: Where to write.
        frames: Receive stamp, UNIX µs, and bytes of each frame.

    Returns:
        The number of frames.
    """
    count = 0
    for stamp, frame in frames:
        file.write(struct.pack(">Q", stamp) + frame)
        count += 1
    return count


def _receive_stamps(data: Bytes, frame_start: Integers) -> NDArray[np.uint64]:
    """Reads the stamp (N,), UNIX µs, before each frame; it is undefined where no stamp fits before the frame."""
    stamp_start = np.maximum(frame_start - STAMP_BYTES, 0)
    big_endian = rows_of(data, stamp_start, STAMP_BYTES).view(">u8")[:, 0]
    return big_endian.astype(np.uint64)


def _without_carriage_returns(content: bytes) -> tuple[Bytes, Facts]:
    """Undoes the conversion of line ends by a transfer in text mode, which puts a carriage return before line feeds.

    It is recognised by every byte of the value of a line feed having a carriage return before it, which in a binary
    file does not happen by chance.

    Returns:
        The bytes as they were recorded, and the repair if there was one.
    """
    line_feeds = content.count(b"\n")
    if line_feeds < MIN_LINE_FEEDS or content.count(b"\r\n") < line_feeds:
        return np.frombuffer(content, dtype=np.uint8), ()
    restored = content.replace(b"\r\n", b"\n")
    repairs = repair_facts(Repair.CARRIAGE_RETURNS_UNDONE, count=line_feeds)
    return np.frombuffer(restored, dtype=np.uint8), repairs
