"""Telemetry logs (.tlog): reading and writing frames, each behind the 8-byte time at which it was received.

The receive stamp is big-endian microseconds since 1970. It may be late by seconds, so messages are placed in time by
the autopilot's own stamps (``mavlink.clocks``) instead. Layout: pymavlink ``mavutil.mavlogfile``.
"""

from __future__ import annotations

import mmap
import os
import re
import struct
from array import array
from collections.abc import Iterable, Iterator
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mavdem.errors import Unreadable
from mavdem.facts import Fact
from mavdem.facts.sources import Repair, Source
from mavdem.ingest.contents import mapped_bytes, require_whole
from mavdem.ingest.mavlink.clocks import BATCH, Places, Times, far_off, without
from mavdem.ingest.mavlink.definitions import seeds
from mavdem.ingest.mavlink.framing import (
    GOOD,
    Bytes,
    Frames,
    Progress,
    concatenated,
    find_frames,
    no_progress,
    rows_of,
)
from mavdem.ingest.mavlink.vehicles import FrameIndex, FrameStream, assemble
from mavdem.ingest.telemetry import Log, repair

STAMP_BYTES = 8  # Bytes of the receive stamp before each frame
MAX_STAMP_JUMP = 3600.0  # Seconds from its neighbours beyond which a receive stamp is wrong
MAX_JUMP_AFTER_DAMAGE = 60.0  # The same for a stamp after damage, which may itself be damaged
STAMP_WINDOW = 9  # Stamps whose median is compared with the one in their middle


def read_tlog(path: str | os.PathLike[str], progress: Progress = no_progress) -> Log:
    """Reads a telemetry log; a damaged one as far as possible.

    Raises Unreadable: the file cannot be opened, contains no MAVLink, or is cut short while it is read.
    """
    source = os.fspath(path)
    data, repairs = _without_carriage_returns(mapped_bytes(path))
    index = FrameIndex(len(data))
    stamps = ReceiveStamps(data)
    for frames in _tables(data, source, progress):
        index.add(frames)
        stamps.add(frames)
    stamps.close()
    _require_mavlink(source, index.good, index.frames, stamps.bytes_skipped)
    return assemble(data, index, stamps.at, stamps.span, stamps.bytes_skipped, source, repairs)


def tlog_stream(path: str | os.PathLike[str], progress: Progress = no_progress) -> FrameStream:
    """Returns the frames of a telemetry log with their stamps, in the order received; raises as ``read_tlog``."""
    source = os.fspath(path)
    data, repairs = _without_carriage_returns(mapped_bytes(path))
    stamps = ReceiveStamps(data)
    tables = []
    for table in _tables(data, source, progress):
        stamps.add(table)
        tables.append(table)
    frames = concatenated(tables)
    good = int(np.count_nonzero(frames.verdict == GOOD))
    _require_mavlink(source, good, len(frames), stamps.bytes_skipped)
    return FrameStream(
        source, ".tlog", data, frames, stamps.recorded(frames.start), stamps.bytes_skipped, repairs
    )


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


class ReceiveStamps:
    """The receive stamps of a stream, added table by table; ``bytes_skipped`` are neither frame nor stamp.

    After ``close``, ``span`` is the first and the last trustworthy stamp, UNIX s; NaN where there is none.
    """

    def __init__(self, data: Bytes) -> None:
        self._data = data
        self.bytes_skipped = len(data)
        self.span = (np.nan, np.nan)
        self._end = 0
        # Places of all frames, and how many bytes there are before each, up to one more than a stamp has.
        self._starts, self._spaces = array("I" if len(data) < 1 << 32 else "Q"), array("B")
        # Places of frames without a stamp; and without a trustworthy one, with the end of the stream.
        self._without: Places = np.empty(0, dtype=np.int64)
        self._untrusted = self._without

    def add(self, frames: Frames) -> None:
        """Adds the next frames of the stream."""
        if len(frames):
            space = frames.start - np.concatenate([[self._end], frames.end[:-1]])
            self._end = int(frames.end[-1])
            self.bytes_skipped -= int(
                np.minimum(space, STAMP_BYTES).sum() + (frames.end - frames.start).sum()
            )
            self._starts.frombytes(frames.start.astype(self._starts.typecode).tobytes())
            self._spaces.frombytes(np.minimum(space, STAMP_BYTES + 1).astype(np.uint8).tobytes())

    def close(self) -> None:
        """Ends the stream."""
        starts = np.frombuffer(self._starts, self._starts.typecode)
        spaces = np.frombuffer(self._spaces, np.uint8)
        del self._starts, self._spaces
        self._without = starts[spaces < STAMP_BYTES]
        starts, spaces = without(spaces < STAMP_BYTES, starts, spaces)
        untrusted = [self._without, np.array([len(self._data)])]
        beyond = STAMP_WINDOW // 2
        for begin in range(0, len(starts), BATCH):
            around = slice(max(begin - beyond, 0), begin + BATCH + beyond)
            inside = slice(begin - around.start, begin - around.start + BATCH)
            times = _stamps(self._data, starts[around].astype(np.int64)) / 1e6
            limit = np.where(spaces[around] == STAMP_BYTES, MAX_STAMP_JUMP, MAX_JUMP_AFTER_DAMAGE)
            far = np.zeros(len(times), dtype=np.bool_)
            if (np.abs(np.diff(times)) > limit[1:]).any():
                far = far_off(times, STAMP_WINDOW, limit)
            untrusted.append(starts[around][inside][far[inside]])
            near = np.append(times[inside][~far[inside]], self.span)
            self.span = float(np.fmin.reduce(near)), float(np.fmax.reduce(near))
        self._untrusted = np.sort(np.concatenate(untrusted))

    def at(self, start: Places) -> Times:
        """UNIX s (N,) of frames that begin at ``start`` (N,), ascending; NaN: no stamp, or far from its neighbours."""
        untrusted = np.isin(start, self._untrusted)
        return np.where(untrusted, np.nan, _stamps(self._data, start.astype(np.int64)) / 1e6)

    def recorded(self, start: Places) -> NDArray[np.uint64]:
        """UNIX µs (N,) before the frames that begin at ``start`` (N,); 0 where there are none."""
        stampless = np.isin(start, self._without)
        return np.where(stampless, np.uint64(0), _stamps(self._data, start.astype(np.int64)))


def _stamps(data: Bytes, start: NDArray[np.int64]) -> NDArray[np.uint64]:
    """Big-endian µs before each frame; undefined for a frame that begins before a stamp fits."""
    if len(data) < STAMP_BYTES:
        return np.zeros(len(start), dtype=np.uint64)
    return (
        rows_of(data, np.maximum(start - STAMP_BYTES, 0), STAMP_BYTES)
        .view(">u8")[:, 0]
        .astype(np.uint64)
    )


def _tables(data: Bytes, source: str, progress: Progress) -> Iterator[Frames]:
    for frames in find_frames(data, seeds(), STAMP_BYTES, progress):
        require_whole(data, source)
        yield frames


def _without_carriage_returns(content: bytes | mmap.mmap) -> tuple[Bytes, tuple[Fact, ...]]:
    """Undoes the conversion of line ends by a text-mode transfer: each line feed then follows a carriage return."""
    data = np.frombuffer(content, dtype=np.uint8)
    if re.search(rb"\n(?<!\r\n)", content):
        return data, ()
    restored = bytes(content).replace(b"\r\n", b"\n")
    feeds = len(content) - len(restored)
    if feeds < 8:  # chance gives 1 in 2^64
        return data, ()
    undone = repair(Repair.CARRIAGE_RETURNS_UNDONE, count=feeds)
    return np.frombuffer(restored, dtype=np.uint8), undone


def _require_mavlink(source: str, good: int, frames: int, skipped: int) -> None:
    if frames and not good:
        raise Unreadable(Fact(Source.DIALECT_UNKNOWN, path=source, count=frames, recording=False))
    if good <= 1e-6 * skipped:  # random bytes have some 1.5e-7 good frames each
        raise Unreadable(Fact(Source.FORMAT_UNKNOWN, path=source, name="mavlink"))
