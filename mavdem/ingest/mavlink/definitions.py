"""MAVLink message definitions of pymavlink's ``all`` dialect: payloads as columns, and frames made of payloads.

That dialect joins ``ardupilotmega`` with ``common``, ``development`` and the others whose ids do not collide, so that
it has PX4's newer messages too. Field order on the wire, truncation and extensions:
https://mavlink.io/en/guide/serialization.html.
"""

import struct
from collections.abc import Mapping
from functools import cache
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from mavdem.containers import Names
from mavdem.ingest.byte_rows import Bytes, rows_of
from mavdem.ingest.mavlink.checksums import frame_checksum
from mavdem.ingest.mavlink.framing import (
    CHECKSUM_BYTES,
    HEADER_BYTES_V1,
    HEADER_BYTES_V2,
    LENGTH_BYTE,
    MARKER_V1,
    MARKER_V2,
    CrcExtras,
)
from mavdem.ingest.telemetry import Columns, Parameters
from mavdem.ingest.vocabulary import mavlink_constant

INTEGER_TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32")
"""NumPy types of integer parameters; in capitals, the ends of their names in MAV_PARAM_TYPE."""

MARKER_V2_BYTE = bytes((MARKER_V2,))
"""First byte of each frame of MAVLink 2."""

HEADER_AFTER_MARKER = struct.Struct("<BBBBBBHB")
"""The rest of its header: length of the payload, both flags, sequence, system, component, and the message's number of
three bytes."""


class MessageDefinition(NamedTuple):
    """The definition of one MAVLink message."""

    message_id: int
    """Its number."""
    name: str
    """Its name: "ATTITUDE"."""
    fields: Names
    """Names of its fields in the order of the definition, extensions last."""
    wire: np.dtype[Any]
    """The payload as a structured type, in the order of the wire, extensions included."""
    crc_extra: int
    """CRC_EXTRA, a byte of every checksum of this message, which follows from the definition."""


@cache
def definitions_by_id() -> Mapping[int, MessageDefinition]:
    """Returns every message of the dialect by id."""
    return {message_id: _definition(message) for message_id, message in dialect.mavlink_map.items()}


@cache
def definitions_by_name() -> Mapping[str, MessageDefinition]:
    """Returns every message of the dialect by name."""
    return {definition.name: definition for definition in definitions_by_id().values()}


@cache
def crc_extra_table() -> CrcExtras:
    """Returns CRC_EXTRA by message id, -1 for none.

    CRC_EXTRA is a number that sender and receiver derive from their definition of a message; it enters the checksum, so
    that a frame by another definition fails. The last row stands for all ids that are too large: it has none.
    """
    table = np.full(max(definitions_by_id()) + 2, -1, dtype=np.int32)
    for message_id, definition in definitions_by_id().items():
        table[message_id] = definition.crc_extra
    return table


class SentPayloads(NamedTuple):
    """What was sent of the payloads of N frames."""

    header_bytes: Bytes
    """Number of bytes before each payload (N,)."""
    sent_bytes: Bytes
    """Number of bytes that were sent of it (N,)."""


def sent_payloads(data: Bytes, start: NDArray[np.integer]) -> SentPayloads:
    """Reads of frames where their payloads begin, and how long these are; needed for each field of them.

    Args:
        data: The stream (B,).
        start: Offset (N,) of each frame's marker.
    """
    headers = rows_of(data, start, LENGTH_BYTE + 1)
    is_version_1 = headers[:, 0] == MARKER_V1
    header_bytes = np.where(is_version_1, HEADER_BYTES_V1, HEADER_BYTES_V2).astype(np.uint8)
    return SentPayloads(
        _broadcast_if_constant(header_bytes), _broadcast_if_constant(headers[:, LENGTH_BYTE])
    )


def _broadcast_if_constant(values: Bytes) -> Bytes:
    """Returns the same values (N,); where all are equal, one stands for all."""
    if len(values) and (values == values[0]).all():
        return np.broadcast_to(values[0], len(values))
    return values.copy()


def decoded_field(
    data: Bytes,
    start: NDArray[np.integer],
    definition: MessageDefinition,
    name: str,
    payloads: SentPayloads | None = None,
) -> NDArray[Any]:
    """Decodes one field of frames of one message.

    Bytes that were not sent are zero: trailing zeros in MAVLink 2, extensions in MAVLink 1. Bytes beyond the
    definition, extensions newer than the dialect, are left out.

    Args:
        data: The stream (B,).
        start: Offset (N,) of each frame's marker.
        definition: The definition of the message.
        name: Name of the field.
        payloads: What was sent of the frames, where that was read before.

    Returns:
        The column (N,), or (N, k) of an array field. Texts are bytes, ``S``.
    """
    assert definition.wire.fields is not None
    field_type, field_offset = definition.wire.fields[name][:2]
    width = field_type.itemsize
    header_bytes, sent_bytes = payloads or sent_payloads(data, start)
    field_start = start.astype(np.int64) + header_bytes
    field_start += field_offset
    # A field is cut out at full width, whatever was sent of it. In the last frames of the stream this would reach
    # beyond its end, so their bytes are taken one by one, with the last byte repeated.
    exceeds_stream = np.flatnonzero(field_start + width > len(data))
    offsets = field_start[exceeds_stream, None] + np.arange(width)
    field_start[exceeds_stream] = 0
    # A stream that is shorter than the field has no piece of its width at all.
    if len(exceeds_stream) < len(start):
        values = rows_of(data, field_start, width)
    else:
        values = np.zeros((len(start), width), dtype=np.uint8)
    values[exceeds_stream] = data.take(offsets, mode="clip")
    # What lies behind the sent bytes belongs to the checksum or to the next frame.
    cut_rows = np.flatnonzero(sent_bytes < field_offset + width)
    cut_values = values[cut_rows]
    cut_values[np.arange(field_offset, field_offset + width) >= sent_bytes[cut_rows, None]] = 0
    values[cut_rows] = cut_values
    return values.view(np.dtype([(name, field_type)]))[name][:, 0]


def pymavlink_messages(data: bytes) -> list[Any]:
    """Parses bytes with pymavlink; damaged frames become messages of the type BAD_DATA."""
    parser = dialect.MAVLink(None)
    parser.robust_parsing = True
    return parser.parse_buffer(data) or []


def enum_name(enum: str, value: int) -> str:
    """Returns the name of an enumeration's entry without the enumeration's own name.

    Args:
        enum: Name of the enumeration: "MAV_TYPE".
        value: Number of the entry: 2.

    Returns:
        The name, "QUADROTOR"; the number where there is no such entry.
    """
    entry = dialect.enums[enum].get(value)
    if entry is None or entry.name.endswith("_ENUM_END"):
        return str(value)
    return str(entry.name).removeprefix(f"{enum}_")


def latest_parameters(sent: Columns, autopilot: str) -> Parameters:
    """Returns the last finite value of each parameter by name; arguments as of :func:`decoded_parameters`."""
    parameters = {}
    for name, value in decoded_parameters(sent, autopilot):
        if isfinite(value):
            parameters[name] = value
    return parameters


def decoded_parameters(sent: Columns, autopilot: str) -> list[tuple[str, float]]:
    """Decodes parameters, which travel in a float32: ArduPilot casts integers to it, PX4 copies their bits.

    Source: https://mavlink.io/en/services/parameter.html#parameter-encoding.

    Args:
        sent: Columns of PARAM_VALUE (N,).
        autopilot: MAV_AUTOPILOT of the sender, without its prefix.

    Returns:
        Name and value of the parameter in each row.
    """
    # A conversion of a signalling NaN would warn; it stays NaN.
    with np.errstate(invalid="ignore"):
        values = sent["param_value"].astype(np.float64)
    if autopilot == "PX4":
        # An integer of any width is in the first bytes of the little-endian float32.
        bits = np.ascontiguousarray(sent["param_value"], dtype="<f4").view("<u4")
        for integer_type in INTEGER_TYPES:
            type_number = mavlink_constant(f"MAV_PARAM_TYPE_{integer_type.upper()}")
            rows = sent["param_type"] == type_number
            values[rows] = bits[rows].astype(integer_type)
    names = []
    for name in sent["param_id"].tolist():
        text, _, _ = name.partition(b"\0")
        names.append(text.decode("ascii", errors="replace"))
    return list(zip(names, values.tolist(), strict=True))


def _definition(message: Any) -> MessageDefinition:
    """Makes the definition of a message from pymavlink's class for it.

    MAVLink sorts fields by size on the wire: ``ordered_fieldnames`` has that order, ``fieldnames`` that of the
    definition. The C types, such as "uint8_t", are turned into types of NumPy, so that a payload is decoded as one
    structured item: "uint8" for a number, "(4,)float32" for an array of four, "S50" for a text of 50 bytes.

    Args:
        message: pymavlink's class of the message.

    Returns:
        The definition, with the layout of the payload as a structured NumPy type.
    """
    type_of_field = dict(zip(message.fieldnames, message.fieldtypes, strict=True))
    wire_fields = []
    # An array length of 0 stands for a field that is no array.
    for name, length in zip(message.ordered_fieldnames, message.array_lengths, strict=True):
        c_type = type_of_field[name]
        numpy_type = c_type.removesuffix("_t").replace("float", "float32")
        if numpy_type == "char":
            numpy_type = f"S{length or 1}"
        elif length:
            numpy_type = f"({length},){numpy_type}"
        wire_fields.append((name, numpy_type))
    return MessageDefinition(
        message_id=message.id,
        name=message.msgname,
        fields=tuple(message.fieldnames),
        wire=np.dtype(wire_fields).newbyteorder("<"),
        crc_extra=message.crc_extra,
    )


class FrameSender(NamedTuple):
    """Who sends a frame."""

    system: int
    """MAVLink system id."""
    component: int
    """MAVLink component id."""


def encode_frame(
    payload: bytes, definition: MessageDefinition, sender: FrameSender, sequence: int
) -> bytes:
    """Makes a frame of MAVLink 2: header, payload and checksum, without a signature.

    Args:
        payload: The payload in the layout ``definition.wire``; trailing zeros are not sent.
        definition: Definition of the message.
        sender: System and component that send it.
        sequence: Sequence number of the frame, 0 to 255.

    Returns:
        The bytes of the frame.
    """
    # MAVLink 2 cuts trailing zeros off, which the receiver adds again; at least one byte of the payload is sent.
    payload = payload.rstrip(b"\0") or b"\0"
    incompatibility_flags = compatibility_flags = 0
    header = HEADER_AFTER_MARKER.pack(
        len(payload),
        incompatibility_flags,
        compatibility_flags,
        sequence,
        sender.system,
        sender.component,
        definition.message_id & 0xFFFF,
        definition.message_id >> 16,
    )
    content = header + payload
    checksum = frame_checksum(content, definition.crc_extra)
    return MARKER_V2_BYTE + content + checksum.to_bytes(CHECKSUM_BYTES, "little")
