"""Unsigned frames of given payloads, with their checksums; MAVLink 2 drops the payload's trailing zeros.

Source: https://mavlink.io/en/guide/serialization.html.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.mavlink.checksum import MAX_CHECKSUM_BYTES, Bytes, checksums
from mavdem.ingest.mavlink.definitions import MessageDefinition
from mavdem.ingest.mavlink.framing import CHECKSUM, FAILED, GOOD, HEADER, HEADER_1, MARKER_1, MARKER_2, Frames


@dataclass(frozen=True)
class FrameSender:
    """MAVLink ids ``system`` and ``component`` of who sends a frame."""

    system: int
    component: int


def composed_frames(
    payloads: NDArray[Any],
    definition: MessageDefinition,
    sender: FrameSender,
    sequence: Bytes,
    good: NDArray[np.bool_] | None = None,
    version: int = 2,
) -> tuple[Bytes, Frames]:
    """Frames of one message: their bytes, one after the other, and the table of them.

    ``payloads`` (N,) are of ``definition.wire``. Where ``good`` (N,) is given and False, the row has no bytes and the
    verdict ``FAILED``. ``version`` 1 of MAVLink has ids below 256, no extension fields and no trailing zeros dropped.
    """
    count, message_id = len(payloads), definition.message_id
    sent = np.ascontiguousarray(payloads).view(np.uint8).reshape(count, definition.wire.itemsize)
    fields: tuple[Any, ...]
    if version == 1:
        from pymavlink.dialects.v10 import all as dialect_1  # as slow to import as the other: only where it is needed

        sent = sent[:, : dialect_1.mavlink_map[message_id].unpacker.size]  # without extensions
        header, width = HEADER_1, sent.shape[1]
        length = np.full(count, width)
        fields = (MARKER_1, length, sequence, sender.system, sender.component, message_id)
    else:
        header, width = HEADER, sent.shape[1]
        backwards = (sent != 0)[:, ::-1]
        length = np.where(backwards.any(axis=1), width - backwards.argmax(axis=1), 1)
        ids = (sender.system, sender.component, *(message_id >> shift & 0xFF for shift in (0, 8, 16)))
        fields = (MARKER_2, length, 0, 0, sequence, *ids)
    good = np.ones(count, dtype=np.bool_) if good is None else good
    whole = np.zeros((count, header + width + CHECKSUM), dtype=np.uint8)
    for place, value in enumerate(fields):
        whole[:, place] = value
    whole[:, header:-CHECKSUM] = sent
    column = np.arange(whole.shape[1])
    kept = ((column < header + length[:, None]) | (column >= header + width)) & good[:, None]
    end = np.cumsum(kept.sum(axis=1))
    start = np.concatenate([[0], end])[:-1]
    frames = Frames(
        start=start,
        end=end,
        payload=start + header,
        length=length,
        message_id=np.full(count, message_id, dtype=np.int64),
        system=np.full(count, sender.system, dtype=np.uint8),
        component=np.full(count, sender.component, dtype=np.uint8),
        sequence=sequence,
        verdict=np.where(good, GOOD, FAILED).astype(np.uint8),
    )
    data = whole[kept]
    body, at = start[good] + 1, end[good] - CHECKSUM
    seeds = np.full(len(body), definition.seed, dtype=np.int32)
    sums = checksums(np.pad(data, (0, MAX_CHECKSUM_BYTES)), body, at - body, seeds)
    data[at], data[at + 1] = sums & 0xFF, sums >> 8
    return data, frames
