"""Telemetry logs (.tlog): reading and writing frames, each behind the 8-byte time at which it was received.

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
from mavdem.ingest.contents import file_bytes
from mavdem.ingest.mavlink.definitions import crc_extra_table
from mavdem.ingest.mavlink.framing import (
    CHECKSUM_MATCHES,
    Bytes,
    find_frames,
    rows_of,
)
from mavdem.ingest.mavlink.vehicles import FrameStream, assemble
from mavdem.ingest.telemetry import Log, repair_facts

STAMP_BYTES = np.dtype(np.uint64).itemsize  # Bytes of the receive stamp before each frame


def read_tlog(path: PathName) -> Log:
    """Reads a telemetry log; a damaged one as far as possible.

    Raises Unreadable: the file cannot be opened, or contains no MAVLink.
    """
    return assemble(tlog_stream(path))


def tlog_stream(path: PathName) -> FrameStream:
    """Returns the frames of a telemetry log with their stamps, in the order received; raises as ``read_tlog``."""
    source = os.fspath(path)
    data, repairs = _without_carriage_returns(file_bytes(path))
    frames = find_frames(data, crc_extra_table(), STAMP_BYTES)
    space = frames.start - np.concatenate([[0], frames.end[:-1]])
    covered = np.minimum(space, STAMP_BYTES) + frames.size
    skipped = len(data) - int(covered.sum())
    good = np.count_nonzero(frames.checksum == CHECKSUM_MATCHES)
    if len(frames) and not good:
        count = len(frames)
        raise Unreadable(Source.DIALECT_UNKNOWN, path=source, count=count, recording=False)
    if good <= 1e-6 * skipped:  # random bytes have some 1.5e-7 good frames each
        raise Unreadable(Source.FORMAT_UNKNOWN, path=source, name="mavlink")
    # Behind damage, the bytes before a frame may be anything.
    stamps = np.where(space == STAMP_BYTES, _stamps(data, frames.start), np.uint64(0))
    return FrameStream(source, ".tlog", data, frames, stamps, skipped, repairs)


def write_tlog(file: BinaryIO, stream: FrameStream) -> int:
    """Writes every frame of a stream with its stamp and returns how many there were."""
    return write_stamped(file, stream.stamped_frames())


def write_stamped(file: BinaryIO, frames: Iterable[tuple[int, bytes]]) -> int:
    """Writes frames, each after its receive stamp, UNIX µs, and returns how many there were."""
    count = 0
    for stamp, frame in frames:
        file.write(struct.pack(">Q", stamp) + frame)
        count += 1
    return count


def _stamps(data: Bytes, start: Integers) -> NDArray[np.uint64]:
    """Big-endian µs before each frame; undefined for a frame that begins before a stamp fits."""
    return (
        rows_of(data, np.maximum(start - STAMP_BYTES, 0), STAMP_BYTES)
        .view(">u8")[:, 0]
        .astype(np.uint64)
    )


def _without_carriage_returns(content: bytes) -> tuple[Bytes, Facts]:
    """Undoes the conversion of line ends by a text-mode transfer: each line feed then follows a carriage return."""
    feeds = content.count(b"\n")
    if feeds < 8 or content.count(b"\r\n") < feeds:  # chance gives 1 in 2^64
        return np.frombuffer(content, dtype=np.uint8), ()
    restored = content.replace(b"\r\n", b"\n")
    undone = repair_facts(Repair.CARRIAGE_RETURNS_UNDONE, count=feeds)
    return np.frombuffer(restored, dtype=np.uint8), undone
