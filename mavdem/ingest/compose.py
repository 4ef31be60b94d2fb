"""Frames around payloads that came without: unsigned, sealed with their checksum; MAVLink 2 cuts trailing zeros off.

Source: https://mavlink.io/en/guide/serialization.html.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.checksum import LONGEST, Bytes, checksums
from mavdem.ingest.decode import Definition
from mavdem.ingest.framing import CHECKSUM, FAILED, GOOD, HEADER, HEADER_1, MARKER_1, MARKER_2, Frames

SEQUENCE_1 = 2
"""Place of the sequence number in a MAVLink 1 frame."""


@dataclass(frozen=True)
class Sender:
    """Who sends: MAVLink ids ``system`` and ``component``."""

    system: int
    component: int


def compose(
    payloads: NDArray[Any], definition: Definition, sender: Sender, sequence: Bytes, good: NDArray[np.bool_]
) -> tuple[Bytes, Frames]:
    """MAVLink 2 frames of one message: their bytes, one behind the other, and the table of them.

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
    size = kept.sum(axis=1)
    end = np.cumsum(size)
    start = end - size
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
    _seal(data, frames[good], definition)
    return data, frames


def compose_1(payloads: NDArray[Any], definition: Definition, sender: Sender, sequence: Bytes) -> tuple[Bytes, Frames]:
    """The same as MAVLink 1 frames, which hold no extension fields.

    Args:
        payloads: (N,) of ``definition.wire``.
        definition: of the message, whose id is below 256.
        sender: whose ids the frames carry.
        sequence: (N,) sequence numbers.
    """
    width, count = _width_1(definition.message_id), len(payloads)
    sent = np.ascontiguousarray(payloads).view(np.uint8).reshape(count, definition.wire.itemsize)
    whole = np.zeros((count, HEADER_1 + width + CHECKSUM), dtype=np.uint8)
    for place, value in enumerate((MARKER_1, width, 0, sender.system, sender.component, definition.message_id)):
        whole[:, place] = value
    whole[:, SEQUENCE_1] = sequence
    whole[:, HEADER_1:-CHECKSUM] = sent[:, :width]
    start = np.arange(count, dtype=np.int64) * whole.shape[1]
    frames = Frames(
        start=start,
        end=start + whole.shape[1],
        payload=start + HEADER_1,
        length=np.full(count, width, dtype=np.int64),
        message_id=np.full(count, definition.message_id, dtype=np.int64),
        system=np.full(count, sender.system, dtype=np.uint8),
        component=np.full(count, sender.component, dtype=np.uint8),
        sequence=sequence,
        verdict=np.full(count, GOOD, dtype=np.uint8),
    )
    data = whole.reshape(-1)
    _seal(data, frames, definition)
    return data, frames


@cache
def _width_1(message_id: int) -> int:
    """Bytes of a message's payload without extensions, which its MAVLink 1 definition leaves out."""
    from pymavlink.dialects.v10 import all as dialect_1  # takes as long to load as the other: only where it is needed

    return int(dialect_1.mavlink_map[message_id].unpacker.size)


def _seal(data: Bytes, frames: Frames, definition: Definition) -> None:
    """Writes the checksums of all of one message's frames into ``data``."""
    body, at = frames.start + 1, frames.end - CHECKSUM
    seeds = np.full(len(frames), definition.seed, dtype=np.int32)
    sums = checksums(np.pad(data, (0, LONGEST)), body, at - body, seeds)
    data[at], data[at + 1] = sums & 0xFF, sums >> 8
