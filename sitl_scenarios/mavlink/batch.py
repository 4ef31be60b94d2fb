"""Batch: frames in order, each with a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.mavlink.framing import Bytes, Frames, concatenated


@dataclass(frozen=True, eq=False)
class Batch:
    """N frames, one behind the other in ``data``."""

    time: NDArray[np.float64]  # (N,) s of the flight, ascending: when each was sent, or is received
    data: Bytes  # their bytes
    frames: Frames  # the table of them

    def __len__(self) -> int:
        return len(self.time)

    def taken(self, rows: NDArray[np.intp], time: NDArray[np.float64]) -> Batch:
        """The frames of these rows (M,), in this order, at the times (M,)."""
        chosen = self.frames[rows]
        length = chosen.end - chosen.start
        end = np.cumsum(length)
        start = end - length
        # Each byte's place is its frame's, and its own within it.
        places = np.repeat(chosen.start - start, length) + np.arange(end[-1] if len(end) else 0)
        moved = replace(chosen, start=start, end=end, payload=chosen.payload - chosen.start + start)
        return Batch(time, self.data[places], moved)

    def content(self) -> list[bytes]:
        """The bytes of each frame."""
        whole = self.data.tobytes()
        places = zip(self.frames.start.tolist(), self.frames.end.tolist(), strict=True)
        return [whole[start:end] for start, end in places]


def joined(batches: Sequence[Batch]) -> Batch:
    """Batches, one at least, one behind the other."""
    offset = np.cumsum([0, *(len(batch.data) for batch in batches)])
    tables = [
        replace(
            batch.frames,
            start=batch.frames.start + by,
            end=batch.frames.end + by,
            payload=batch.frames.payload + by,
        )
        for batch, by in zip(batches, offset.tolist(), strict=False)
    ]
    return Batch(
        np.concatenate([batch.time for batch in batches]),
        np.concatenate([batch.data for batch in batches]),
        concatenated(tables),
    )
