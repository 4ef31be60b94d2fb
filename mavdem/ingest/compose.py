"""MAVLink 2 frames around payloads that came without: unsigned, trailing zeros cut off, sealed with their checksum.

Source: https://mavlink.io/en/guide/serialization.html.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.checksum import LONGEST, Bytes, checksums
from mavdem.ingest.decode import Definition
from mavdem.ingest.framing import CHECKSUM, FAILED, GOOD, HEADER, MARKER_2, Frames


@dataclass(frozen=True)
class Sender:
    """Who sends: MAVLink ids ``system`` and ``component``."""

    system: int
    component: int


def compose(
    payloads: NDArray[Any], definition: Definition, sender: Sender, sequence: Bytes, good: NDArray[np.bool_]
) -> tuple[Bytes, Frames]:
    """Frames of one message: their bytes, one behind the other, and the table of them.

    Args:
        payloads: (N,) of ``definition.wire``.
        definition: of the message.
        sender: whose ids the frames carry.
        sequence: (N,) sequence numbers.
        good: (N,) whether the payload is one; the row of another has no bytes and the verdict ``FAILED``.
    """
    width, count = definition.wire.itemsize, len(payloads)
    sent = np.ascontiguousarray(payloads).view(np.uint8).reshape(count, width)
    from_behind = (sent != 0)[:, ::-1]
    length: Any = np.where(from_behind.any(axis=1), width - from_behind.argmax(axis=1), 1)
    whole = np.zeros((count, HEADER + width + CHECKSUM), dtype=np.uint8)
    low, middle, high = (definition.message_id >> shift & 0xFF for shift in (0, 8, 16))
    for place, value in enumerate(
        (MARKER_2, length, 0, 0, sequence, sender.system, sender.component, low, middle, high)
    ):
        whole[:, place] = value
    whole[:, HEADER:-CHECKSUM] = sent
    column = np.arange(whole.shape[1])
    kept = (column < HEADER + length[:, None]) | (column >= HEADER + width)
    kept &= good[:, None]
    end = np.cumsum(kept.sum(axis=1))
    start = np.concatenate([[0], end[:-1]])
    frames = Frames(
        start=start,
        end=end,
        payload=start + HEADER,
        length=length,
        message_id=np.full(count, definition.message_id, dtype=np.int64),
        system=np.full(count, sender.system, dtype=np.uint8),
        component=np.full(count, sender.component, dtype=np.uint8),
        sequence=sequence,
        verdict=np.where(good, GOOD, FAILED).astype(np.uint8),
    )
    data = whole[kept]
    sealed = frames[good]
    body, at = sealed.start + 1, sealed.end - CHECKSUM
    seeds = np.full(len(sealed), definition.seed, dtype=np.int32)
    sums = checksums(np.pad(data, (0, LONGEST)), body, at - body, seeds)
    data[at], data[at + 1] = sums & 0xFF, sums >> 8
    return data, frames
