"""Message definitions of pymavlink's ``all`` dialect, payloads as columns, and frames of given payloads.

That dialect joins ``ardupilotmega`` with ``common``, ``development`` and the others whose ids do not collide, so that
it has PX4's newer messages too. Field order on the wire, truncation and extensions:
https://mavlink.io/en/guide/serialization.html.
"""

from collections.abc import Mapping
from functools import cache
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from mavdem.containers import Names
from mavdem.ingest.mavlink import framing
from mavdem.ingest.mavlink.framing import (
    HEADER_BYTES_V1,
    HEADER_BYTES_V2,
    MARKER_V1,
    MARKER_V2,
    Bytes,
    Seeds,
    rows_of,
)
from mavdem.ingest.telemetry import Columns, Fields, Parameters
from mavdem.ingest.vocabulary import mavlink_constant

INTEGER_TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32")  # of parameters


class MessageDefinition(NamedTuple):
    """One message of the dialect: ``fields`` are in the order of the definition, extensions last.

    ``wire`` is the payload as a structured dtype, in the order of the wire, extensions included.
    """

    message_id: int
    name: str
    fields: Names
    wire: np.dtype[Any]
    crc_extra: int


@cache
def definitions_by_id() -> Mapping[int, MessageDefinition]:
    """Returns every message of the dialect by id."""
    return {message_id: _definition(message) for message_id, message in dialect.mavlink_map.items()}


@cache
def definitions_by_name() -> Mapping[str, MessageDefinition]:
    """Returns every message of the dialect by name."""
    return {definition.name: definition for definition in definitions_by_id().values()}


@cache
def crc_extra_table() -> Seeds:
    """Returns CRC_EXTRA by message id; -1 where the dialect has no such message, as at the last, which is too large."""
    table = np.full(max(definitions_by_id()) + 2, -1, dtype=np.int32)
    for message_id, definition in definitions_by_id().items():
        table[message_id] = definition.crc_extra
    return table


def decoded_columns(
    data: Bytes, start: NDArray[np.integer], definition: MessageDefinition
) -> Fields:
    """Returns the payloads of frames of one message as columns by name: (N,), or (N, k) for an array field.

    The frames' markers are at ``start`` (N,) in ``data``. Bytes that were not sent are zero: trailing zeros in
    MAVLink 2, extensions in MAVLink 1. Bytes beyond the definition, extensions newer than the dialect, are left out.
    Texts are bytes, ``S``.
    """
    width = definition.wire.itemsize
    payload = start.astype(np.int64) + np.where(
        data[start] == MARKER_V1, HEADER_BYTES_V1, HEADER_BYTES_V2
    )
    table = np.empty((len(payload), width), np.uint8)
    # What was not sent of the last frames may lie beyond the end.
    is_last = payload + width > len(data)
    table[~is_last] = rows_of(data, payload[~is_last], width)
    table[is_last] = data.take(payload[is_last, None] + np.arange(width), mode="clip")
    table[np.arange(width) >= data[start + 1][:, None]] = 0
    messages = table.view(definition.wire)[:, 0]
    return {name: np.ascontiguousarray(messages[name]) for name in definition.fields}


def pymavlink_messages(data: bytes) -> list[Any]:
    """Returns the messages in ``data`` as pymavlink has them; damage is BAD_DATA."""
    parser = dialect.MAVLink(None)
    parser.robust_parsing = True
    return parser.parse_buffer(data) or []


def enum_name(enum: str, value: int) -> str:
    """Returns the name of an enum's entry without the enum's own: ("MAV_TYPE", 2) is "QUADROTOR"; else the number."""
    entry = dialect.enums[enum].get(value)
    if entry is None or entry.name.endswith("_ENUM_END"):
        return str(value)
    return str(entry.name).removeprefix(f"{enum}_")


def latest_parameters(sent: Columns, autopilot: str) -> Parameters:
    """Returns the last finite value of each parameter by name, of :func:`decoded_parameters`."""
    return {name: value for name, value in decoded_parameters(sent, autopilot) if isfinite(value)}


def decoded_parameters(sent: Columns, autopilot: str) -> list[tuple[str, float]]:
    """Returns name and value of each row of PARAM_VALUE's columns, from the MAV_AUTOPILOT of the sender.

    A parameter travels in a float32. ArduPilot casts integers to it; PX4 copies their bits. Source:
    https://mavlink.io/en/services/parameter.html#parameter-encoding.
    """
    with np.errstate(invalid="ignore"):  # NaN stays NaN
        values = sent["param_value"].astype(np.float64)
    if autopilot == "PX4":
        # The integers in the first bytes of little-endian float32 values.
        bits = np.ascontiguousarray(sent["param_value"], dtype="<f4").view("<u4")
        for kind in INTEGER_TYPES:
            rows = sent["param_type"] == mavlink_constant(f"MAV_PARAM_TYPE_{kind.upper()}")
            values[rows] = bits[rows].astype(kind)
    names = [
        name.split(b"\0", 1)[0].decode("ascii", errors="replace")
        for name in sent["param_id"].tolist()
    ]
    return list(zip(names, values.tolist(), strict=True))


def _definition(message: Any) -> MessageDefinition:
    types = dict(zip(message.fieldnames, message.fieldtypes, strict=True))
    wire = []
    for name, count in zip(message.ordered_fieldnames, message.array_lengths, strict=True):
        kind = types[name].removesuffix("_t").replace("float", "float32")
        if kind == "char":
            wire.append((name, f"S{count or 1}"))
        else:
            wire.append((name, f"({count},){kind}" if count else kind))
    layout = np.dtype(wire).newbyteorder("<")
    return MessageDefinition(
        message.id, message.msgname, tuple(message.fieldnames), layout, message.crc_extra
    )


class FrameSender(NamedTuple):
    """MAVLink ids ``system`` and ``component`` of who sends a frame."""

    system: int
    component: int


def encode_frame(
    payload: bytes,
    definition: MessageDefinition,
    sender: FrameSender,
    number: int,
) -> bytes:
    """Returns the frame, of MAVLink 2, of a payload with a sequence ``number``; without trailing zeros."""
    payload = payload.rstrip(b"\0") or b"\0"
    header = bytes((MARKER_V2, len(payload), 0, 0, number, *sender))
    header += definition.message_id.to_bytes(3, "little")
    checksum = framing.frame_checksum(header[1:] + payload, definition.crc_extra)
    return header + payload + checksum.to_bytes(framing.CHECKSUM_BYTES, "little")
