"""FrameStream: the frames of a recording in the order they were received, of any file format."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.mavlink.checksum import Bytes
from mavdem.ingest.mavlink.framing import Frames, Places, concatenated


@dataclass(frozen=True, eq=False)
class FrameStream:
    """A recorded stream, not yet sorted by who sent what; ``form`` is the usual end of such files' names, ".tlog"."""

    source: str
    form: str
    data: Bytes  # the bytes with the frames, in the same order
    # a row for each of the N messages in the order of the recording; a message that could not become a frame has no
    # bytes, and a verdict other than ``GOOD``
    frames: Frames
    stamps: NDArray[np.uint64]  # (N,) UNIX microseconds each was received, as recorded; 0 where that was not
    bytes_skipped: int
    repairs: tuple[str, ...]

    def stamped_frames(self) -> Iterator[tuple[int, bytes]]:
        """The stamp and the bytes of each frame; a frame without a stamp has that of the frame before."""
        rows = np.flatnonzero(self.frames.end > self.frames.start)
        stamps = self.stamps[rows]
        last = np.maximum.accumulate(np.where(stamps > 0, np.arange(len(rows)), 0))
        content = self.data.data
        places = zip(self.frames.start[rows].tolist(), self.frames.end[rows].tolist(), strict=True)
        for stamp, (start, end) in zip(stamps[last].tolist(), places, strict=True):
            yield stamp, bytes(content[start:end])


@dataclass(frozen=True, eq=False)
class RecordingPart:
    """Some of a recording's frames, (N,), and the bytes with them.

    ``place`` (N,) is the number of the message of the recording in which each begins, ``log_time`` (N,) UNIX ns.
    """

    data: Bytes
    frames: Frames
    place: Places
    log_time: NDArray[np.uint64]


def joined(parts: Sequence[RecordingPart]) -> RecordingPart:
    """All parts, one at least, as one, its frames and their bytes in the order of the recording."""
    if len(parts) == 1:
        return parts[0]
    frames = concatenated([part.frames for part in parts])
    place = np.concatenate([part.place for part in parts])
    order = np.argsort(place, kind="stable")
    contents = [part.data.data for part in parts]
    holding = np.repeat(np.arange(len(parts)), [len(part.frames) for part in parts])[order]
    frames, data = frames[order], bytearray()
    for number, start, end in zip(holding.tolist(), frames.start.tolist(), frames.end.tolist(), strict=True):
        data += contents[number][start:end]
    moved = np.cumsum(frames.end - frames.start) - frames.end
    frames = replace(frames, start=frames.start + moved, end=frames.end + moved, payload=frames.payload + moved)
    log_time = np.concatenate([part.log_time for part in parts])[order]
    return RecordingPart(np.frombuffer(data, dtype=np.uint8), frames, place[order], log_time)
