"""Telemetry logs (.tlog): reading and writing MAVLink frames, each preceded by its receive time in 8 bytes.

The receive stamp is big-endian microseconds since 1970. It may be late by seconds, so messages are placed in time by
the autopilot's own stamps (``mavlink.clocks``) instead. Layout: pymavlink ``mavutil.mavlogfile``.
"""

import os
import struct
from collections.abc import Iterable
from functools import partial
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mavdem.errors import Unreadable
from mavdem.facts import Facts
from mavdem.facts.sources import Repair, SourceFact
from mavdem.files import PathName
from mavdem.ingest.byte_rows import Bytes, rows_of
from mavdem.ingest.contents import mapped_bytes
from mavdem.ingest.mavlink.clock_readings import Rows
from mavdem.ingest.mavlink.dialect import crc_extra_table
from mavdem.ingest.mavlink.frame_stream import STAMPS_AT_ONCE, FrameStream
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES, SCANNED_BYTES, Frames, find_frames
from mavdem.ingest.mavlink.vehicles import assemble
from mavdem.ingest.telemetry import Log, repair_facts

STAMP_BYTES = np.dtype(np.uint64).itemsize
"""Number of bytes of the receive stamp before each frame."""

CHECKED_BYTES = 1 << 22
"""Bytes at the beginning of a file that :func:`check_beginning` searches: half a minute of a fast link."""

MIN_FRAME_DENSITY = 1e-6
"""Frames with a matching checksum per byte that belongs to no frame, below which a file is not a telemetry log.

In random bytes a frame is found by chance every 7 million bytes (1.5e-7).
"""

LINE_FEED, CARRIAGE_RETURN = b"\n\r"
"""Bytes that end lines."""

MIN_LINE_FEEDS = 8
"""Number of line feeds that must all follow a carriage return for a text-mode transfer to be undone.

By chance, 8 such bytes follow 8 carriage returns once in 2^64.
"""


def read_tlog(path: PathName) -> Log:
    """Reads a telemetry log, a damaged one as far as possible.

    Args:
        path: The log, or an archive of it.

    Returns:
        The log, with the telemetry of each vehicle in it.

    Raises:
        Unreadable: The file cannot be opened, or contains no MAVLink.
    """
    return assemble(tlog_stream(path))


def tlog_from_bytes(source: str, content: bytes) -> Log:
    """Reads a telemetry log that is in memory, as :func:`read_tlog` reads a file.

    Args:
        source: The name that the log gets.
        content: Its bytes.

    Returns:
        The log, with the telemetry of each vehicle in it.

    Raises:
        Unreadable: The bytes contain no MAVLink.
    """
    return assemble(_frame_stream(source, np.frombuffer(content, dtype=np.uint8)))


def tlog_stream(path: PathName) -> FrameStream:
    """Finds the frames of a telemetry log and their receive stamps, in the order received.

    In an undamaged log the 8 bytes between two frames are the stamp of the second one. If their number is different,
    some bytes are damaged, and the frame has no stamp. A file with very few frames for its size is not a telemetry log.

    Args:
        path: The log, or an archive of it.

    Returns:
        The frames, with the number of bytes that are not part of any.

    Raises:
        Unreadable: The file cannot be opened, or contains no MAVLink.
    """
    return _frame_stream(os.fspath(path), mapped_bytes(path))


def _frame_stream(source: str, data: Bytes) -> FrameStream:
    """Finds the frames of a telemetry log in its bytes.

    A log that was copied as text, with a carriage return added before each line feed, is repaired first.

    Args:
        source: Name of the log.
        data: All bytes of the log.

    Returns:
        The frames, a function that reads their receive stamps when they are needed, the number of bytes that are part
        of neither, and what was repaired.

    Raises:
        Unreadable: The bytes contain no MAVLink.
    """
    repaired_data, repairs = _without_carriage_returns(data)
    frames, skipped_bytes = _frames_of_log(source, repaired_data)
    receive_stamps = partial(_receive_stamps, repaired_data, frames)
    return FrameStream(
        source, ".tlog", repaired_data, frames, receive_stamps, skipped_bytes, repairs
    )


def check_beginning(path: PathName) -> None:
    """Checks that the first ``CHECKED_BYTES`` of a file hold MAVLink frames, which takes a tenth of a second at most.

    Args:
        path: The file; it is not unpacked.

    Raises:
        Unreadable: The file cannot be opened, or contains no MAVLink.
    """
    with open(path, "rb") as file:
        beginning = file.read(CHECKED_BYTES)
    data, _ = _without_carriage_returns(np.frombuffer(beginning, dtype=np.uint8))
    _frames_of_log(os.fspath(path), data)


def _frames_of_log(source: str, data: Bytes) -> tuple[Frames, int]:
    """Finds the frames of a telemetry log, and counts the bytes between them that are no time stamps.

    A few frames may be found by chance in any file. So a file with hardly any frames for its size is refused.

    Args:
        source: Name of the log, for error messages.
        data: Its bytes, or the bytes of its beginning.

    Returns:
        The frames, and the number of bytes that belong neither to a frame nor to the stamp before it.

    Raises:
        Unreadable: There is no MAVLink, or hardly any for the size.
    """
    frames = find_frames(data, crc_extra_table(), STAMP_BYTES)
    bytes_outside_frames = len(data) - int(frames.size.sum(dtype=np.int64))
    # Up to 8 of the bytes before each frame are its stamp.
    stamp_bytes = 0
    for block_start in range(0, len(frames), STAMPS_AT_ONCE):
        bytes_before = _bytes_before(frames, slice(block_start, block_start + STAMPS_AT_ONCE))
        stamp_bytes += int(np.minimum(bytes_before, STAMP_BYTES).sum(dtype=np.int64))
    skipped_bytes = bytes_outside_frames - stamp_bytes
    matching_count = np.count_nonzero(frames.checksum == CHECKSUM_MATCHES)
    if len(frames) and not matching_count:
        count = len(frames)
        raise Unreadable(SourceFact.DIALECT_UNKNOWN, path=source, count=count, recording=False)
    if matching_count <= MIN_FRAME_DENSITY * skipped_bytes:
        raise Unreadable(SourceFact.FORMAT_UNKNOWN, path=source, name="mavlink")
    return frames, skipped_bytes


def write_tlog(file: BinaryIO, stream: FrameStream) -> int:
    """Writes every frame of a stream with its stamp and returns how many there were."""
    return write_stamped(file, stream.stamped_frames())


def write_stamped(file: BinaryIO, frames: Iterable[tuple[int, bytes]]) -> int:
    """Writes frames, each after its receive stamp.

    Args:
        file: Open file to write to.
        frames: Receive stamp, UNIX µs, and bytes of each frame.

    Returns:
        The number of frames.
    """
    count = 0
    for stamp, frame in frames:
        file.write(struct.pack(">Q", stamp) + frame)
        count += 1
    return count


def _bytes_before(frames: Frames, rows: slice | Rows) -> NDArray[np.integer]:
    """Returns the number of bytes between each of some frames and the frame before it.

    Args:
        frames: All frames (N,) of the log.
        rows: Rows (n,) of the frames.

    Returns:
        Numbers of bytes (n,).
    """
    if isinstance(rows, slice):
        first_row, stop_row, _ = rows.indices(len(frames))
        return _bytes_before_successive(frames, first_row, stop_row)
    rows_before = rows - 1
    ends_before = frames.start[rows_before] + frames.size[rows_before]
    # The first frame of the log has the beginning of the log before it, byte 0.
    return frames.start[rows] - np.where(rows > 0, ends_before, 0)


def _bytes_before_successive(frames: Frames, first_row: int, stop_row: int) -> NDArray[np.integer]:
    """Returns the number of bytes before each of successive frames, without arrays of row numbers for a large log.

    Args:
        frames: All frames (N,) of the log.
        first_row: Row of the first of the n frames.
        stop_row: Row after the last of them.

    Returns:
        Numbers of bytes (n,).
    """
    if first_row >= stop_row:
        return np.zeros(0, dtype=frames.start.dtype)
    # Each frame begins after the end of the one before it, and the first frame of the log after byte 0.
    end_before_first = 0 if first_row == 0 else frames[first_row - 1 : first_row].end[0]
    ends_before = np.insert(frames[first_row : stop_row - 1].end, 0, end_before_first)
    return frames.start[first_row:stop_row] - ends_before


def _receive_stamps(data: Bytes, frames: Frames, rows: slice | Rows) -> NDArray[np.uint64]:
    """Reads the receive stamps in the 8 bytes before some frames.

    Args:
        data: The bytes of the log.
        frames: All its frames (N,).
        rows: Rows (n,) of the frames.

    Returns:
        Receive stamps (n,), UNIX µs; 0 where there is none.
    """
    # After damage, another number of bytes lies between two frames, and these are no stamp.
    has_stamp = _bytes_before(frames, rows) == STAMP_BYTES
    stamp_start = frames.start[rows][has_stamp] - STAMP_BYTES
    stamps = np.zeros(len(has_stamp), dtype=np.uint64)
    stamps[has_stamp] = rows_of(data, stamp_start, STAMP_BYTES).view(">u8")[:, 0]
    return stamps


def _without_carriage_returns(data: Bytes) -> tuple[Bytes, Facts]:
    """Undoes the conversion of line ends by a transfer in text mode, which puts a carriage return before line feeds.

    The damage is recognised by a carriage return before every byte with the value of a line feed, which does not happen
    by chance in a binary file.

    Args:
        data: The bytes of the log.

    Returns:
        The bytes as they were recorded, and a fact that reports the repair if there was one.
    """
    line_feed_count = 0
    for block_start in range(0, len(data), SCANNED_BYTES):
        block = data[block_start : block_start + SCANNED_BYTES]
        line_feeds = block_start + np.flatnonzero(block == LINE_FEED)
        if not len(line_feeds):
            continue
        is_first_byte = line_feeds[0] == 0
        if is_first_byte or (data[line_feeds - 1] != CARRIAGE_RETURN).any():
            # A line feed without a carriage return before it shows that nothing was converted.
            return data, ()
        line_feed_count += len(line_feeds)
    if line_feed_count < MIN_LINE_FEEDS:
        return data, ()
    restored_data = data.tobytes().replace(b"\r\n", b"\n")
    repairs = repair_facts(Repair.CARRIAGE_RETURNS_UNDONE, count=line_feed_count)
    return np.frombuffer(restored_data, dtype=np.uint8), repairs
