"""Message definitions, and payloads to columns, by the definitions of pymavlink's ``all`` dialect.

That dialect joins ``ardupilotmega`` with ``common``, ``development`` and the others whose ids do not collide, so that
PX4's newer messages are known too. Field order on the wire, truncation and extensions:
https://mavlink.io/en/guide/serialization.html.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from mavdem.ingest.checksum import Bytes, rows_of
from mavdem.ingest.framing import HEADER, HEADER_1, MARKER_1

BATCH = 1 << 14
"""Messages decoded together: few enough to stay in the processor's cache."""

WIRE_TYPES = {
    "char": "S1",
    "int8_t": "i1",
    "uint8_t": "u1",
    "int16_t": "<i2",
    "uint16_t": "<u2",
    "int32_t": "<i4",
    "uint32_t": "<u4",
    "int64_t": "<i8",
    "uint64_t": "<u8",
    "float": "<f4",
    "double": "<f8",
}


@dataclass(frozen=True)
class Definition:
    """One message of the dialect.

    Attributes:
        message_id: its id.
        name: its name, "ATTITUDE".
        fields: field names in the order of the definition, extensions last.
        wire: the payload as a structured dtype, in the order of the wire, extensions included.
        seed: CRC_EXTRA.
    """

    message_id: int
    name: str
    fields: tuple[str, ...]
    wire: np.dtype[Any]
    seed: int


@cache
def definitions() -> Mapping[int, Definition]:
    """Every message of the dialect by id."""
    return {message_id: _definition(message) for message_id, message in dialect.mavlink_map.items()}


@cache
def seeds() -> NDArray[np.int32]:
    """CRC_EXTRA by message id; -1 where the dialect has no such message."""
    table = np.full(max(definitions()) + 1, -1, dtype=np.int32)
    for message_id, definition in definitions().items():
        table[message_id] = definition.seed
    return table


def columns(
    data: Bytes, start: NDArray[np.integer], definition: Definition, names: Sequence[str] = ()
) -> dict[str, NDArray[Any]]:
    """The payloads of frames of one message as contiguous columns by name: (N,), or (N, k) for an array field.

    Bytes that were not sent, the trailing zeros MAVLink 2 cuts off and the extensions MAVLink 1 lacks, are zero; bytes
    beyond the definition, extensions newer than the dialect, are left out. Texts are bytes, ``S``.

    Args:
        data: (size,) the stream.
        start: (N,) places of the frames' markers.
        definition: of the message.
        names: the fields; all unless given.
    """
    names = tuple(names) or definition.fields
    kinds = {name: definition.wire[name] for name in names}
    filled = {name: np.empty((len(start), *kind.shape), dtype=kind.base) for name, kind in kinds.items()}
    for begin in range(0, len(start), BATCH):
        rows = slice(begin, begin + BATCH)
        messages = _messages(data, start[rows].astype(np.int64), definition, names)
        for name in names:
            filled[name][rows] = messages[name]
    return filled


def _messages(data: Bytes, start: NDArray[np.int64], definition: Definition, names: Sequence[str]) -> NDArray[Any]:
    """A structured array (N,) of the named fields, read from the stretch of the payload that holds them."""
    fields = {name: definition.wire.fields[name][:2] for name in names} if definition.wire.fields else {}
    first = min(offset for _, offset in fields.values())
    width = max(offset + kind.itemsize for kind, offset in fields.values()) - first
    wire = np.dtype(
        {
            "names": list(fields),
            "formats": [kind for kind, _ in fields.values()],
            "offsets": [offset - first for _, offset in fields.values()],
            "itemsize": width,
        }
    )
    payload = start + np.where(data[start] == MARKER_1, HEADER_1, HEADER) + first
    inside = int(np.searchsorted(payload, len(data) - width, side="right"))
    table = rows_of(data, payload[:inside], width)
    if inside < len(payload):
        # The definition may reach beyond the end of the stream; what is read instead was not sent.
        rest = data[np.minimum(payload[inside:, None] + np.arange(width), len(data) - 1)]
        table = np.concatenate([table, rest])
    sent = data[start + 1]
    if int(sent.min()) < first + width:
        table[np.arange(first, first + width) >= sent[:, None]] = 0
    return table.view(wire)[:, 0]


def enum_name(enum: str, value: int) -> str:
    """The name of an enum's entry without the enum's own name: ("MAV_TYPE", 2) is "QUADROTOR"; else the number."""
    entry = dialect.enums[enum].get(value)
    if entry is None or entry.name.endswith("_ENUM_END"):
        return str(value)
    return str(entry.name).removeprefix(f"{enum}_")


def _definition(message: Any) -> Definition:
    types = dict(zip(message.fieldnames, message.fieldtypes, strict=True))
    wire = [
        _wire_field(name, types[name], count)
        for name, count in zip(message.ordered_fieldnames, message.array_lengths, strict=True)
    ]
    return Definition(message.id, message.msgname, tuple(message.fieldnames), np.dtype(wire), message.crc_extra)


def _wire_field(name: str, kind: str, count: int) -> tuple[str, str] | tuple[str, str, tuple[int]]:
    if kind == "char" and count:
        return name, f"S{count}"
    return (name, WIRE_TYPES[kind], (count,)) if count else (name, WIRE_TYPES[kind])
