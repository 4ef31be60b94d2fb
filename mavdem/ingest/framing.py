"""Finding MAVLink frames in bytes: one scan, checksums by column, a table of frames.

A frame counts when its checksum agrees. Bytes FD and FE also occur inside payloads and time stamps, so a marker is only
a candidate, and candidates are taken in the order of their evidence:

1. the checksum agrees and another marker stands where the next frame should begin;
2. frames of another dialect, or damaged but of the right length: no checksum can vouch for them, but they fill the
   space between two frames of the first kind exactly;
3. the checksum agrees, within whatever space is left.

Sources: https://mavlink.io/en/guide/serialization.html (layout, truncation, X.25 checksum with CRC_EXTRA),
https://mavlink.io/en/guide/message_signing.html (signature of 13 bytes).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Places = NDArray[np.int64]
Progress = Callable[[float], None]
"""Called now and then with the fraction that is done, 0 to 1."""

MARKER_1, MARKER_2 = 0xFE, 0xFD
SIGNED = 1
SIGNATURE = 13
CHECKSUM = 2
LONGEST_FRAME = 10 + 255 + CHECKSUM + SIGNATURE
BLOCK = 1 << 20
"""Bytes scanned at a time: bounds the memory that hostile input, all markers, can take."""
BATCH = 1 << 14
"""Frames whose checksums are computed together: few enough to stay in the processor's cache."""

GOOD, UNKNOWN, FAILED = 0, 1, 2
"""A frame's verdict: the checksum agrees; the message id is not of this dialect; the checksum disagrees."""


@dataclass(frozen=True, eq=False)
class Frames:
    """A table of frames in stream order; every column has shape (N,).

    Attributes:
        start: place of the marker in the bytes.
        end: place after the last byte.
        payload: place of the payload.
        length: bytes of payload on the wire.
        message_id, system, component, sequence: from the header.
        verdict: ``GOOD``, ``UNKNOWN`` or ``FAILED``.
    """

    start: Places
    end: Places
    payload: Places
    length: Places
    message_id: Places
    system: Bytes
    component: Bytes
    sequence: Bytes
    verdict: Bytes

    def __len__(self) -> int:
        return len(self.start)

    def __getitem__(self, rows: slice | NDArray[np.bool_] | Places) -> Frames:
        return Frames(*(getattr(self, column.name)[rows] for column in fields(self)))


def padded(content: bytes) -> Bytes:
    """The bytes as an array with enough zeros behind that any header or payload may be read past the end."""
    data = np.zeros(len(content) + LONGEST_FRAME, dtype=np.uint8)
    data[: len(content)] = np.frombuffer(content, dtype=np.uint8)
    return data


def find_frames(data: Bytes, seeds: NDArray[np.int32], gap: int = 0, progress: Progress | None = None) -> Frames:
    """Every frame in ``data``, those of unknown messages and those with failed checksums included.

    Args:
        data: bytes as ``padded`` gives them.
        seeds: CRC_EXTRA by message id, -1 where the dialect has no such message.
        gap: bytes between one frame and the next: 8 for the time stamps of a tlog, 0 for a plain stream.
    """
    size = len(data) - LONGEST_FRAME
    linked = [
        _good(data, starts[_linked(data, starts, size, gap)], size, seeds)
        for starts in _candidates(data, size, progress)
    ]
    chosen = _apart(_concatenated(linked))
    explained = _read_headers(data, _chains(data, chosen, size, gap))
    explained.verdict[:] = np.where(_seeds_of(explained, seeds) < 0, UNKNOWN, FAILED)
    chosen = _merged(chosen, explained)
    loose = [_good(data, starts[_outside(chosen, starts)], size, seeds) for starts in _candidates(data, size, None)]
    return _merged(chosen, _apart(_fitting(chosen, _concatenated(loose))))


def _candidates(data: Bytes, size: int, progress: Progress | None) -> Iterator[Places]:
    """Places of markers with incompatibility flags this reader knows, block by block."""
    for begin in range(0, max(size, 1), BLOCK):
        block = data[begin : min(begin + BLOCK, size)]
        starts = begin + np.flatnonzero((block == MARKER_1) | (block == MARKER_2))
        yield starts[(data[starts] == MARKER_1) | (data[starts + 2] <= SIGNED)]
        if progress is not None:
            progress(min((begin + BLOCK) / max(size, 1), 1.0))


def _read_headers(data: Bytes, start: Places) -> Frames:
    """The frames that begin at ``start``, verdict still open (``GOOD``)."""
    second = data[start] == MARKER_2
    low, middle, high = (data[start + 7 + byte].astype(np.int64) for byte in range(3))
    return Frames(
        start=start,
        end=_ends(data, start),
        payload=start + np.where(second, 10, 6),
        length=data[start + 1].astype(np.int64),
        message_id=np.where(second, low | middle << 8 | high << 16, data[start + 5]),
        sequence=data[start + np.where(second, 4, 2)],
        system=data[start + np.where(second, 5, 3)],
        component=data[start + np.where(second, 6, 4)],
        verdict=np.full(len(start), GOOD, dtype=np.uint8),
    )


def _ends(data: Bytes, start: Places) -> Places:
    second = data[start] == MARKER_2
    signature = np.where(second & (data[start + 2] == SIGNED), SIGNATURE, 0)
    return start + np.where(second, 10, 6) + data[start + 1] + CHECKSUM + signature


def _linked(data: Bytes, start: Places, size: int, gap: int) -> NDArray[np.bool_]:
    """Whether a marker, or the end of the bytes, stands where the frame after this one would begin."""
    end = _ends(data, start)
    following = data[np.minimum(end + gap, size)]
    marked = (following == MARKER_1) | (following == MARKER_2)
    return np.asarray((end == size) | ((end + gap < size) & marked))


def _good(data: Bytes, start: Places, size: int, seeds: NDArray[np.int32]) -> Frames:
    """Those of the frames that begin at ``start`` that are whole, known, and agree with their checksum."""
    frames = _read_headers(data, start)
    frames = frames[(frames.end <= size) & (_seeds_of(frames, seeds) >= 0)]
    at = frames.payload + frames.length
    sent = data[at] | data[at + 1].astype(np.uint16) << 8
    return frames[sent == checksums(data, frames, _seeds_of(frames, seeds))]


def _seeds_of(frames: Frames, seeds: NDArray[np.int32]) -> NDArray[np.int32]:
    inside = frames.message_id < len(seeds)
    return np.where(inside, seeds[np.where(inside, frames.message_id, 0)], -1)


def _apart(frames: Frames) -> Frames:
    """Frames in order, without those that begin inside an earlier one."""
    if (frames.start[1:] >= frames.end[:-1]).all():
        return frames
    keep, free = np.zeros(len(frames), dtype=np.bool_), 0
    for row, (start, end) in enumerate(zip(frames.start.tolist(), frames.end.tolist(), strict=True)):
        if start >= free:
            keep[row], free = True, end
    return frames[keep]


def _chains(data: Bytes, chosen: Frames, size: int, gap: int) -> Places:
    """Starts of the frames that fill the space between chosen frames, or before and behind them, exactly."""
    before = np.concatenate([[0], chosen.end]) + gap
    after = np.concatenate([chosen.start, [size + gap]])
    content = data.data
    starts: list[int] = []
    for row in np.flatnonzero(after > before).tolist():
        goal = int(after[row])
        chain, place = _chain(content, int(before[row]), goal, gap)
        cut_off = goal > size and place + 3 > size
        if place == goal or cut_off:
            starts += chain
    filling = np.array(starts, dtype=np.int64)
    return filling[_ends(data, filling) <= size]


def _chain(content: memoryview, place: int, goal: int, gap: int) -> tuple[list[int], int]:
    """Follows headers from ``place`` on until one is missing or the goal is reached: the starts, and where it ended."""
    starts = []
    while place < goal:
        marker, length, flags = content[place : place + 3]
        if marker == MARKER_1:
            end = place + 6 + length + CHECKSUM
        elif marker == MARKER_2 and flags <= SIGNED:
            end = place + 10 + length + CHECKSUM + SIGNATURE * flags
        else:
            break
        starts.append(place)
        place = end + gap
    return starts, place


def _outside(chosen: Frames, start: Places) -> NDArray[np.bool_]:
    """Whether a place lies in none of the chosen frames."""
    if not len(chosen):
        return np.ones(len(start), dtype=np.bool_)
    previous = np.searchsorted(chosen.start, start, side="right") - 1
    return (previous < 0) | (start >= chosen.end[previous])


def _fitting(chosen: Frames, frames: Frames) -> Frames:
    """Those frames that end before the next chosen one begins."""
    following = np.searchsorted(chosen.start, frames.start)
    limit = np.append(chosen.start, np.iinfo(np.int64).max)[following]
    return frames[frames.end <= limit]


def _concatenated(tables: list[Frames]) -> Frames:
    return Frames(*(np.concatenate([getattr(table, column.name) for table in tables]) for column in fields(Frames)))


def _merged(one: Frames, other: Frames) -> Frames:
    if not len(other):
        return one
    both = _concatenated([one, other])
    return both[np.argsort(both.start, kind="stable")]


def _checksum_table() -> NDArray[np.uint16]:
    """What two more bytes do to the X.25 register: indexed by register XOR the bytes as a little-endian word."""
    register = np.arange(1 << 16, dtype=np.uint16)
    for _ in range(16):
        register = np.where(register & 1, register >> 1 ^ 0x8408, register >> 1).astype(np.uint16)
    return register


def checksums(data: Bytes, frames: Frames, seeds: NDArray[np.int32]) -> NDArray[np.uint16]:
    """X.25 checksums (N,) from the byte after the marker to the end of the payload and the seed, two bytes a step.

    Args:
        data: bytes as ``padded`` gives them.
        frames: whole frames in them.
        seeds: (N,) CRC_EXTRA of each.
    """
    computed = np.empty(len(frames), dtype=np.uint16)
    for begin in range(0, len(frames), BATCH):
        rows = slice(begin, begin + BATCH)
        start = frames.start[rows] + 1
        count = frames.payload[rows] + frames.length[rows] - start
        order = np.argsort(-count, kind="stable")
        start, count, seed = start[order], count[order], seeds[rows][order]
        words = count // 2
        register = np.full(len(start), 0xFFFF, dtype=np.uint16)
        for step, active in enumerate(np.searchsorted(-words, -np.arange(words[0]))):
            at = start[:active] + 2 * step
            word = data[at] | data[at + 1].astype(np.uint16) << 8
            register[:active] = _CHECKSUM_TABLE[register[:active] ^ word]
        last = np.where(count % 2, data[start + count - 1] | seed << 8, seed)
        two_left = _CHECKSUM_TABLE[register ^ last.astype(np.uint16)]
        one_left = register >> 8 ^ _CHECKSUM_BYTE_TABLE[(register ^ last) & 0xFF]
        computed[begin + order] = np.where(count % 2, two_left, one_left)
    return computed


_CHECKSUM_TABLE = _checksum_table()
_CHECKSUM_BYTE_TABLE = _CHECKSUM_TABLE[:: 1 << 8]
