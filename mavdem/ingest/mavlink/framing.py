"""MAVLink frames in bytes: one scan, block by block, and a table of frames.

A frame is good when its checksum agrees. Bytes FD and FE also occur inside payloads and time stamps, so a marker is
only a candidate. Candidates are accepted in this order:

1. ``linked`` frames: the checksum agrees, and another marker is where the next frame should begin, or the bytes end;
2. frames of another dialect, or damaged ones of the right length, whose checksum cannot agree: they fill the space
   between two linked frames exactly;
3. other frames whose checksum agrees, in the space that is left.

A linked frame decides all bytes before it, so the scan holds no more than a block and the bytes since the last.

Sources: https://mavlink.io/en/guide/serialization.html (layout, truncation; the X.25 checksum is CRC-16/MCRF4XX,
register reflected, poly 0x8408, starting with 0xFFFF, over the bytes after the marker and then CRC_EXTRA),
https://mavlink.io/en/guide/message_signing.html (signature of 13 bytes).
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from fastcrc.crc16 import mcrf4xx
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from mavdem.arrays import Flags

Bytes = NDArray[np.uint8]
Places = NDArray[np.int64]
Seeds = NDArray[np.int32]  # CRC_EXTRA by message id, -1 for none


def frame_checksum(content: bytes, seed: int) -> int:
    """Returns the checksum of a frame's ``content`` and ``seed``, which is its CRC_EXTRA."""
    return mcrf4xx(content + bytes((seed,)))


CRC_STEPS = np.array([mcrf4xx(bytes((byte,)), 0) for byte in range(256)])
"""What a byte adds to a checksum, by that byte and the checksum's lower one: seeds of many frames at once."""


def rows_of(data: Bytes, start: Places, width: int) -> Bytes:
    """Returns the ``width`` bytes from each ``start`` (N,) on, as a table (N, width)."""
    everywhere = np.ndarray((max(len(data) - width + 1, 0),), f"V{width}", data, strides=(1,))
    return everywhere[start].view(np.uint8).reshape(len(start), width)


MARKER_V1: int = dialect.PROTOCOL_MARKER_V1
MARKER_V2: int = dialect.PROTOCOL_MARKER_V2
MARKERS = (bytes([MARKER_V1]), bytes([MARKER_V2]))
SIGNED_FLAG: int = dialect.MAVLINK_IFLAG_SIGNED
# Bytes
SIGNATURE_BYTES: int = dialect.MAVLINK_SIGNATURE_BLOCK_LEN
HEADER_BYTES_V1: int = dialect.HEADER_LEN_V1
HEADER_BYTES_V2: int = dialect.HEADER_LEN_V2
CHECKSUM_BYTES = np.uint16().itemsize
MAX_FRAME_BYTES = HEADER_BYTES_V2 + np.iinfo(np.uint8).max + CHECKSUM_BYTES + SIGNATURE_BYTES
SCANNED_BYTES = 1 << 18  # Bytes scanned at a time: bounds the memory for hostile input, all markers


CHECKSUM_MATCHES, MESSAGE_UNKNOWN, CHECKSUM_FAILED = range(1, 4)
"""Of a frame: the checksum agrees; the message id is not in the dialect; the checksum disagrees."""


@dataclass(frozen=True, eq=False)
class Frames:
    """A table of frames in stream order; every column has shape (N,).

    ``start`` is the offset of the marker, ``end`` that after the last byte. ``checksum`` is ``CHECKSUM_MATCHES``,
    ``MESSAGE_UNKNOWN`` or ``CHECKSUM_FAILED``.
    """

    start: Places
    end: Places
    message_id: Places
    system: Bytes
    component: Bytes
    sequence: Bytes
    checksum: Bytes

    @property
    def size(self) -> Places:
        """(N,) bytes of each whole frame."""
        return self.end - self.start

    def __len__(self) -> int:
        return len(self.start)

    def __getitem__(self, rows: slice | Flags | Places) -> Frames:
        return Frames(*(column[rows] for column in vars(self).values()))


def concatenated(tables: Sequence[Frames]) -> Frames:
    """Returns tables, one at least, one after the other."""
    columns = zip(*(vars(table).values() for table in tables), strict=True)
    return Frames(*map(np.concatenate, columns))


def find_frames(data: Bytes, seeds: Seeds, gap: int = 0) -> Frames:
    """Returns every frame in ``data``, also of unknown messages and with failed checksums.

    ``seeds`` is CRC_EXTRA by message id, -1 where the dialect has no such message; ``gap`` the bytes between one frame
    and the next: 8 for the time stamps of a tlog, 0 for a plain stream.
    """
    size = len(data)
    decided = 0
    blocks = []
    waiting: list[Frames] = []  # of the third kind, after the decided bytes
    for begin in range(0, max(size, 1), SCANNED_BYTES):
        end = min(begin + SCANNED_BYTES, size)
        block = _FrameBlock(data, begin, end, gap, seeds)
        linked = _apart(block.linked(), decided)
        if len(linked) or end == size:
            until = size if end == size else int(linked.end[-1])
            taken = _merged([linked, _explained(data, linked, decided, until, gap, seeds)])
            loose = [
                frames[_fits(frames.start, frames.end, taken, decided, until)] for frames in waiting
            ]
            loose.append(block.loose(_fits(block.start, block.end, taken, decided, until)))
            blocks.append(_merged([taken, _apart(_merged(loose), decided)]))
            decided = until
            waiting = []
        waiting.append(block.loose(block.start >= decided))
    return concatenated(blocks)


class _FrameBlock:
    """The candidates (N,) that begin in one block of the bytes: markers with known incompatibility flags."""

    def __init__(self, data: Bytes, begin: int, end: int, gap: int, seeds: Seeds) -> None:
        self._begin, self._size, self._seeds = begin, len(data), seeds
        # With the bytes that the last candidate covers, zeros after the end of the stream.
        self._bytes = np.zeros(end - begin + MAX_FRAME_BYTES + gap + 2, dtype=np.uint8)
        there = data[begin : begin + len(self._bytes)]
        self._bytes[: len(there)] = there
        self._content = self._bytes.tobytes()
        block = self._bytes[: end - begin]
        start = np.flatnonzero((block == MARKER_V1) | (block == MARKER_V2))
        header = rows_of(self._bytes, start, HEADER_BYTES_V2)
        known_flags = (header[:, 0] == MARKER_V1) | (header[:, 2] <= SIGNED_FLAG)
        self._header = header[known_flags]
        self.start = start[known_flags] + begin
        self.end = self.start + _lengths(self._header)
        following = self._bytes[self.end + (gap - begin)]
        marked = (following == MARKER_V1) | (following == MARKER_V2)
        self._linked = (self.end + gap >= self._size) | marked

    def linked(self) -> Frames:
        """The frames whose checksum agrees, where another begins after them or the bytes end before one could."""
        return self._good(self._linked)

    def loose(self, within: Flags) -> Frames:
        """The others ``within`` whose checksum agrees; each linked one was accepted, or begins inside one that was."""
        return self._good(within & ~self._linked)

    def _good(self, wanted: Flags) -> Frames:
        rows = np.flatnonzero(wanted & (self.end <= self._size))
        frames = _headed(self.start[rows], self._header[rows])
        seeds = self._seeds.take(frames.message_id, mode="clip")
        has_seed = seeds >= 0
        frames = frames[has_seed]
        seeds = seeds[has_seed]
        behind = frames.start + _covered(self._header[rows[has_seed]]) - self._begin
        sent = self._bytes[behind] | self._bytes[behind + 1].astype(np.uint16) << 8
        covered = zip((frames.start - self._begin + 1).tolist(), behind.tolist(), strict=True)
        sums = [mcrf4xx(self._content[first:last]) for first, last in covered]
        before = np.array(sums, dtype=np.uint16)
        return frames[sent == before >> 8 ^ CRC_STEPS[(before ^ seeds) & 0xFF]]


def _covered(header: Bytes) -> Places:
    """Bytes of the frame before its checksum, from headers (N, ``HEADER_BYTES_V2``)."""
    before = np.where(header[:, 0] == MARKER_V2, HEADER_BYTES_V2, HEADER_BYTES_V1)
    return np.add(before, header[:, 1], dtype=np.int64)


def _lengths(header: Bytes) -> Places:
    """Bytes of the whole frame."""
    signed = (header[:, 0] == MARKER_V2) & (header[:, 2] == SIGNED_FLAG)
    return _covered(header) + np.where(signed, CHECKSUM_BYTES + SIGNATURE_BYTES, CHECKSUM_BYTES)


def frames_at(data: Bytes, start: Places) -> Frames:
    """Returns the frames that begin at ``start`` (N,), all with the checksum ``CHECKSUM_MATCHES``."""
    # A header at the very end may be shorter than ``HEADER_BYTES_V2``; the bytes read instead are no part of it.
    return _headed(start, data.take(start[:, None] + np.arange(HEADER_BYTES_V2), mode="clip"))


def _headed(start: Places, header: Bytes) -> Frames:
    """The frames that begin at ``start`` with these headers (N, ``HEADER_BYTES_V2``)."""
    second = header[:, 0] == MARKER_V2
    low, middle, high = (header[:, 7 + byte].astype(np.int64) for byte in range(3))
    sequence, system, component = np.where(second[:, None], header[:, 4:7], header[:, 2:5]).T
    return Frames(
        start=start,
        end=start + _lengths(header),
        message_id=np.where(second, low | middle << 8 | high << 16, header[:, 5]),
        sequence=sequence,
        system=system,
        component=component,
        checksum=np.full(len(start), CHECKSUM_MATCHES, dtype=np.uint8),
    )


def _apart(frames: Frames, free: int) -> Frames:
    """Frames in order, without those that begin before ``free`` or inside an earlier one."""
    frames = frames[frames.start >= free]
    if (frames.start[1:] >= frames.end[:-1]).all():
        return frames
    keep = np.zeros(len(frames), dtype=np.bool_)
    for row, (start, end) in enumerate(
        zip(frames.start.tolist(), frames.end.tolist(), strict=True)
    ):
        if start >= free:
            keep[row] = True
            free = end
    return frames[keep]


def _explained(
    data: Bytes, linked: Frames, decided: int, until: int, gap: int, seeds: Seeds
) -> Frames:
    """The frames that fill the space before, between and, at the end of the bytes, after linked frames exactly."""
    ends = np.concatenate([[decided], linked.end])
    before = ends + gap
    after = np.append(linked.start, len(data) + gap if until == len(data) else 0)
    content = data.data
    starts = array("q")
    for row in np.flatnonzero(after > before).tolist():
        starts.extend(_chain(content, int(before[row]), int(after[row]), gap))
    filling = np.frombuffer(starts, dtype=np.int64)
    frames = frames_at(data, filling)
    frames.checksum[:] = np.where(
        seeds.take(frames.message_id, mode="clip") < 0, MESSAGE_UNKNOWN, CHECKSUM_FAILED
    )
    return frames[frames.end <= len(data)]


def _chain(content: memoryview, offset: int, goal: int, gap: int) -> Sequence[int]:
    """Starts of the frames from ``offset`` on, by their headers, if they lead to the goal or the end of the bytes."""
    starts = array("q")
    size = len(content)
    while offset < goal and offset + 3 <= size:
        length = frame_length(*content[offset : offset + 3])
        if length is None:
            break
        starts.append(offset)
        offset += length + gap
    cut_off = goal > size and offset + 3 > size
    return starts if offset == goal or cut_off else array("q")


def frame_length(marker: int, payload: int, flags: int) -> int | None:
    """Returns the number of bytes of the frame whose header starts with these three; None if no header does."""
    if marker == MARKER_V1:
        return HEADER_BYTES_V1 + payload + CHECKSUM_BYTES
    if marker == MARKER_V2 and flags <= SIGNED_FLAG:
        return HEADER_BYTES_V2 + payload + CHECKSUM_BYTES + SIGNATURE_BYTES * flags
    return None


def _fits(start: Places, end: Places, taken: Frames, decided: int, until: int) -> Flags:
    """Whether frames lie between ``decided`` and ``until`` and overlap none of those in ``taken``."""
    following = np.searchsorted(taken.start, start, side="right")
    free_from = np.concatenate([[decided], taken.end])[following]
    limit = np.append(taken.start, until)[following]
    return (start >= free_from) & (end <= limit)


def _merged(tables: list[Frames]) -> Frames:
    """Tables as one, in stream order."""
    filled = [table for table in tables if len(table)] or tables[:1]
    if len(filled) == 1:
        return filled[0]
    both = concatenated(filled)
    return both[np.argsort(both.start, kind="stable")]
