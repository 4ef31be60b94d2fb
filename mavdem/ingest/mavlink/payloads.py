"""Payloads of MAVLink messages: decoding them as columns or one at a time, and encoding them in frames.

Field order on the wire, truncation and extensions: https://mavlink.io/en/guide/serialization.html.
"""

import struct
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.byte_rows import Bytes, rows_of
from mavdem.ingest.mavlink.checksums import frame_checksum
from mavdem.ingest.mavlink.dialect import MessageDefinition, definitions_by_name, mavlink_constant
from mavdem.ingest.mavlink.framing import (
    CHECKSUM_BYTES,
    HEADER_BYTES_V1,
    HEADER_BYTES_V2,
    LENGTH_BYTE,
    MARKER_V1,
    MARKER_V2,
)
from mavdem.ingest.telemetry import Columns, Parameters

INTEGER_TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32")
"""NumPy types of integer parameters; in capitals, the ends of their names in MAV_PARAM_TYPE."""

MARKER_V2_BYTE = bytes((MARKER_V2,))
"""First byte of each frame of MAVLink 2."""

HEADER_AFTER_MARKER = struct.Struct("<BBBBBBHB")
"""The rest of its header: length of the payload, both flags, sequence, system, component, and the message's number of
three bytes."""


class SentPayloads(NamedTuple):
    """What was sent of the payloads of N frames."""

    header_bytes: Bytes
    """Number of bytes before each payload (N,)."""
    sent_bytes: Bytes
    """Number of bytes that were sent of it (N,)."""


def sent_payloads(data: Bytes, start: NDArray[np.integer]) -> SentPayloads:
    """Finds out from the headers of N frames where their payloads begin and how many bytes of them were sent.

    MAVLink 2 does not send zeros at the end of a payload. If the result is the same for all frames, as it mostly is, it
    is stored as a single number, to save memory.

    Args:
        data: Bytes (B,) of the stream.
        start: Offset (N,) of each frame's marker.

    Returns:
        Offset of each payload in its frame, and number of its bytes that were sent (N,).
    """
    headers = rows_of(data, start, LENGTH_BYTE + 1)
    is_version_1 = headers[:, 0] == MARKER_V1
    header_bytes = np.where(is_version_1, HEADER_BYTES_V1, HEADER_BYTES_V2).astype(np.uint8)
    payload_bytes = headers[:, LENGTH_BYTE]
    return SentPayloads(_broadcast_if_constant(header_bytes), _broadcast_if_constant(payload_bytes))


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
        data: Bytes (B,) of the stream.
        start: Offset (N,) of each frame's marker.
        definition: MAVLink's definition of the message: names, types and order of its fields.
        name: Name of the field ("roll").
        payloads: Offsets and lengths of the payloads, if they were read before; None to read them.

    Returns:
        The column (N,), or (N, k) of an array field. Texts are bytes, ``S``.
    """
    assert definition.payload_type.fields is not None
    field_type, field_offset = definition.payload_type.fields[name][:2]
    field_bytes = slice(field_offset, field_offset + field_type.itemsize)
    values = _bytes_of_payloads(data, start, field_bytes, payloads or sent_payloads(data, start))
    return values.view(np.dtype([(name, field_type)]))[name][:, 0]


def decoded_payloads(
    data: Bytes,
    start: NDArray[np.integer],
    definition: MessageDefinition,
    payloads: SentPayloads,
) -> NDArray[np.void]:
    """Decodes all fields of frames of one message at once, which costs little more than a single one.

    Args:
        data: Bytes (B,) of the stream.
        start: Offset (N,) of each frame's marker.
        definition: MAVLink's definition of the message: names, types and order of its fields.
        payloads: Offsets and lengths of the payloads.

    Returns:
        The payloads (N,) in the message's ``payload_type``, as ``decoded_field`` decodes each field of them.
    """
    whole_payload = slice(0, definition.payload_type.itemsize)
    payload_bytes = _bytes_of_payloads(data, start, whole_payload, payloads)
    return payload_bytes.view(definition.payload_type)[:, 0]


def _bytes_of_payloads(
    data: Bytes, start: NDArray[np.integer], field_bytes: slice, payloads: SentPayloads
) -> Bytes:
    """Reads the bytes of one field from the payloads of N frames, with zeros for the bytes that were not sent.

    Args:
        data: Bytes (B,) of the stream.
        start: Offset (N,) of each frame's marker.
        field_bytes: First byte of the field in the payload, and the byte after its last; or of the whole payload.
        payloads: Offset of each payload in its frame, and number of its bytes that were sent.

    Returns:
        The bytes of the field (N, width).
    """
    width = field_bytes.stop - field_bytes.start
    header_bytes, sent_bytes = payloads
    field_start = start.astype(np.int64) + header_bytes
    field_start += field_bytes.start
    # A field is read at its full width, however much of it was sent. In the last frames this may go beyond the end of
    # the stream. These are read byte by byte, by offsets that are clipped to the last byte.
    last_frames = np.flatnonzero(field_start + width > len(data))
    offsets_of_last = field_start[last_frames, None] + np.arange(width)
    field_start[last_frames] = 0
    # ``rows_of`` needs a stream that is at least as long as the field.
    if len(last_frames) < len(start):
        values = rows_of(data, field_start, width)
    else:
        values = np.zeros((len(start), width), dtype=np.uint8)
    values[last_frames] = data.take(offsets_of_last, mode="clip")
    # What was read after the end of a payload belongs to the checksum or to the next frame, and is set to 0, for all
    # payloads of one length at a time.
    distinct_lengths = np.flatnonzero(np.bincount(sent_bytes))
    for sent_length in distinct_lengths[distinct_lengths < field_bytes.stop].tolist():
        rows = np.flatnonzero(sent_bytes == sent_length)
        sent_width = max(sent_length - field_bytes.start, 0)
        values[rows, sent_width:] = 0
    return values


def field_values(payload: bytes, definition: MessageDefinition) -> dict[str, Any]:
    """Decodes all fields of one payload.

    Args:
        payload: The payload as sent. Zeros at its end may be missing; bytes beyond the definition are left out.
        definition: MAVLink's definition of the message: names, types and order of its fields.

    Returns:
        Numbers, lists of numbers and texts by name, in the order of the definition. A text ends at its first zero.
    """
    size = definition.payload_type.itemsize
    record = np.frombuffer(payload[:size].ljust(size, b"\0"), definition.payload_type)[0]
    values: dict[str, Any] = {}
    for name in definition.fields:
        value = record[name].tolist()
        if isinstance(value, bytes):
            text, _, _ = value.partition(b"\0")
            value = text.decode("ascii", errors="replace")
        values[name] = value
    return values


def filled_payloads(name: str, count: int = 1, /, **fields: Any) -> NDArray[np.void]:
    """Returns payloads of one message, with the given values in its fields and zero in all others.

    Args:
        name: Name of the message ("ATTITUDE").
        count: Number of payloads to make, one per message.
        fields: Values of fields: one for all payloads, or one for each, (count, …).

    Returns:
        (count,) payloads of the message's ``payload_type``.
    """
    table = np.zeros(count, dtype=definitions_by_name()[name].payload_type)
    for field, values in fields.items():
        table[field] = values
    return table


def latest_parameters(parameter_values: Columns, autopilot: str) -> Parameters:
    """Returns the last finite value of each parameter by name; arguments as of :func:`decoded_parameters`."""
    parameters = {}
    for name, value in decoded_parameters(parameter_values, autopilot):
        if isfinite(value):
            parameters[name] = value
    return parameters


def decoded_parameters(parameter_values: Columns, autopilot: str) -> list[tuple[str, float]]:
    """Decodes parameters, which travel in a float32: ArduPilot casts integers to it, PX4 copies their bits.

    Source: https://mavlink.io/en/services/parameter.html#parameter-encoding.

    Args:
        parameter_values: Columns of PARAM_VALUE (N,).
        autopilot: MAV_AUTOPILOT of the sender, without its prefix.

    Returns:
        Name and value of the parameter in each row.
    """
    # A conversion of a signalling NaN would warn; it stays NaN.
    with np.errstate(invalid="ignore"):
        values = parameter_values["param_value"].astype(np.float64)
    if autopilot == "PX4":
        # An integer of any width is in the first bytes of the little-endian float32.
        bits = np.ascontiguousarray(parameter_values["param_value"], dtype="<f4").view("<u4")
        for integer_type in INTEGER_TYPES:
            type_number = mavlink_constant(f"MAV_PARAM_TYPE_{integer_type.upper()}")
            is_selected = parameter_values["param_type"] == type_number
            values[is_selected] = bits[is_selected].astype(integer_type)
    names = []
    for name in parameter_values["param_id"].tolist():
        text, _, _ = name.partition(b"\0")
        names.append(text.decode("ascii", errors="replace"))
    return list(zip(names, values.tolist(), strict=True))


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
        payload: The payload in the layout ``definition.payload_type``; trailing zeros are not sent.
        definition: MAVLink's definition of the message: names, types and order of its fields.
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
