"""Parts of a recording, each with frames of its own, and the one table they make in the order of the file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.framing import Bytes, Frames, Places, padded


@dataclass(frozen=True, eq=False)
class Part:
    """Some of a recording's frames.

    Attributes:
        data: the bytes they lie in, without padding.
        frames: the table of them, (N,).
        place: (N,) number of the message of the recording in which each begins.
        log_time: (N,) UNIX nanoseconds it was recorded.
    """

    data: Bytes
    frames: Frames
    place: Places
    log_time: NDArray[np.uint64]


def joined(parts: Sequence[Part]) -> Part:
    """All parts, one at least, as one in the order of the recording; its data are as ``padded`` gives them."""
    offsets = np.cumsum([0, *(len(part.data) for part in parts)])
    place = np.concatenate([part.place for part in parts])
    order = np.argsort(place, kind="stable")
    moved = [_moved(part.frames, int(offset)) for part, offset in zip(parts, offsets[:-1], strict=True)]
    columns = ([getattr(frames, column.name) for frames in moved] for column in fields(Frames))
    frames = Frames(*(np.concatenate(column)[order] for column in columns))
    data = padded(b"".join(part.data.tobytes() for part in parts))
    return Part(data, frames, place[order], np.concatenate([part.log_time for part in parts])[order])


def _moved(frames: Frames, offset: int) -> Frames:
    """The same frames in data that begin ``offset`` bytes earlier."""
    return replace(frames, start=frames.start + offset, end=frames.end + offset, payload=frames.payload + offset)
