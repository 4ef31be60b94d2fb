"""Stream: the frames of a recording in the order they were received, whatever file they lay in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.checksum import Bytes
from mavdem.ingest.framing import Frames


@dataclass(frozen=True, eq=False)
class Stream:
    """A recorded stream, not yet sorted by who sent what.

    Attributes:
        source: the file it came from.
        form: the kind of file that is, as the usual end of its name, ".tlog".
        data: the bytes the frames lie in, in the same order.
        frames: a row for each of the N messages in the order of the recording; one that could not be made a frame of
            has none of the bytes, and a verdict other than ``GOOD``.
        stamps: (N,) UNIX microseconds each was received, as recorded; 0 where that was not.
        bytes_skipped: bytes of the recorded stream that belong to no frame.
        repairs: a sentence for each thing that was mended.
    """

    source: str
    form: str
    data: Bytes
    frames: Frames
    stamps: NDArray[np.uint64]
    bytes_skipped: int
    repairs: tuple[str, ...]

    def stamped_frames(self) -> Iterator[tuple[int, bytes]]:
        """The stamp and the bytes of each frame; one that has no stamp takes that of the frame before."""
        rows = np.flatnonzero(self.frames.end > self.frames.start)
        stamps = self.stamps[rows]
        last = np.maximum.accumulate(np.where(stamps > 0, np.arange(len(rows)), 0))
        content = self.data.data
        places = zip(self.frames.start[rows].tolist(), self.frames.end[rows].tolist(), strict=True)
        for stamp, (start, end) in zip(stamps[last].tolist(), places, strict=True):
            yield stamp, bytes(content[start:end])
