"""Parts of a recording, each with frames of its own, and the one table they make in the order of the file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.checksum import Bytes
from mavdem.ingest.framing import Frames, Places, concatenated


@dataclass(frozen=True, eq=False)
class Part:
    """Some of a recording's frames.

    Attributes:
        data: the bytes they lie in.
        frames: the table of them, (N,).
        place: (N,) number of the message of the recording in which each begins.
        log_time: (N,) UNIX nanoseconds it was recorded.
    """

    data: Bytes
    frames: Frames
    place: Places
    log_time: NDArray[np.uint64]


def joined(parts: Sequence[Part]) -> Part:
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
    return Part(np.frombuffer(data, dtype=np.uint8), frames, place[order], log_time)
