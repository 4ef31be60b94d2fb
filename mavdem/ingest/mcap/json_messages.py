"""MAVLink messages in JSON, in the layouts of BlueOS and of another bridge, encoded as payloads again.

There are two layouts: the fields at top level, or BlueOS's ``{"header": {"system_id", "component_id", "sequence",
"message_id"}, "message": {"type": "ATTITUDE", ...fields}}``, where a field called ``type`` is ``mavtype``, an enum's
value is ``{"type": "MAV_TYPE_QUADROTOR"}``, a bitmask ``{"bits": 81}`` or ``"A | B"``, and a text an array of its
characters. Numbers are those of JSON5; plain JSON has null for NaN. Source: the JSON of rust-mavlink
(https://github.com/mavlink/rust-mavlink, ``serde`` feature), which BlueOS records.
"""

import json
import re
from collections.abc import Mapping
from functools import lru_cache
from math import nan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.mavlink.dialect import MessageDefinition, enum_entries, mavlink_constant

MAX_SEQUENCE = 255
"""Largest sequence number of MAVLink."""


class JsonMessage(NamedTuple):
    """What a JSON document contains of a message."""

    payload: bytes | None
    """The payload of its frame; None where the document is no message of this name, or a value has a wrong type."""
    sequence: int | None
    """The sender's number of the message; None in the layout without a header."""


def read_json_message(body: bytes, definition: MessageDefinition) -> JsonMessage:
    """Reads a message from a JSON document of either layout, and encodes its fields as a MAVLink payload.

    In BlueOS's layout the document has two objects, "header" and "message". The object "message" has the fields, and
    the name of the message as "type"; a field of the message that is itself called "type" is then called "mavtype". In
    the other layout the document is the object of the fields.

    A field that the document lacks gets a default: zero, or NaN if it is a float, which is no measured zero.

    Args:
        body: The JSON document, UTF-8.
        definition: Definition of the expected message.

    Returns:
        Payload and sequence number; no payload if the document is not such a message, or a value does not fit its
        field.
    """
    fields = _parsed_json(body)
    sequence = None
    is_in_blueos_layout = isinstance(fields, dict) and isinstance(fields.get("message"), dict)
    if is_in_blueos_layout:
        sequence = _sequence_number(fields.get("header"))
        fields = fields["message"]
        message_name = fields.pop("type", definition.name)
        if message_name != definition.name:
            return JsonMessage(None, sequence)
        if "mavtype" in fields:
            fields["type"] = fields["mavtype"]
    if not isinstance(fields, dict) or fields.keys().isdisjoint(definition.fields):
        return JsonMessage(None, sequence)
    return JsonMessage(_encoded_payload(fields, definition), sequence)


def _encoded_payload(fields: Mapping[str, Any], definition: MessageDefinition) -> bytes | None:
    """Encodes fields of a JSON document as the payload of a MAVLink message.

    Args:
        fields: Values in JSON by name of the field. Those that the message does not have are left out, and those that
            it has besides get their defaults.
        definition: MAVLink's definition of the message: names, types and order of its fields.

    Returns:
        The payload; None if a value does not fit its field.
    """
    message = _message_without_fields(definition).copy()
    try:
        with np.errstate(over="raise", invalid="ignore"):
            for name in fields.keys() & set(definition.fields):
                default = message[name][0].tolist()
                message[name] = _field_value(fields[name], definition.payload_type[name], default)
    except (TypeError, ValueError, ArithmeticError):
        return None
    if definition.name == "PARAM_VALUE" and np.isnan(message["param_value"][0]):
        # PX4 sends an integer as the bits of a float; those of a small negative integer are a NaN. JSON has only one
        # NaN, so that the value is lost. As a float the parameter remains NaN, and does not become a wrong integer.
        message["param_type"] = mavlink_constant("MAV_PARAM_TYPE_REAL32")
    return message.tobytes()


def _sequence_number(header: Any) -> int | None:
    """Returns the sequence number in the header of BlueOS's layout; None if it has none."""
    number = header.get("sequence") if isinstance(header, dict) else None
    # A bool is an int in Python, but no number in JSON.
    return number if type(number) is int and 0 <= number <= MAX_SEQUENCE else None


@lru_cache(maxsize=1 << 10)
def _message_without_fields(definition: MessageDefinition) -> NDArray[Any]:
    """Returns the message (1,), as a structured array, in which no field was sent: zeros, and NaN where it has floats.

    It is cached, since it is needed for each message of a recording; callers must copy it.

    Args:
        definition: MAVLink's definition of the message: names, types and order of its fields.
    """
    message = np.zeros(1, dtype=definition.payload_type)
    for name in definition.fields:
        if definition.payload_type[name].base.kind == "f":
            message[name] = nan
    return message


# Texts may contain control characters.
_PARSER = json.JSONDecoder(strict=False)


def _parsed_json(body: bytes) -> Any:
    """Parses a JSON document, also one with Rust's infinities.

    Args:
        body: The JSON document, UTF-8.

    Returns:
        The value; None if it is not JSON.
    """
    try:
        return _PARSER.decode(body.decode("utf-8", errors="replace"))
    except (ValueError, RecursionError):
        # Rust prints an infinity as inf, instead of JSON5's Infinity.
        repaired_body = re.sub(rb"(?<=[:,\[])\s*(-?)inf(?=\s*[,\]}])", rb"\1Infinity", body)
        return None if repaired_body == body else _parsed_json(repaired_body)


def _field_value(value: Any, field_type: np.dtype[Any], default: Any) -> Any:
    """Converts a field's value from JSON to what NumPy writes into the payload of the message.

    Args:
        value: The value in JSON: a text, a number, or an array, which may be shorter than the array of the field.
        field_type: Type of the field in the payload.
        default: Value of the field where none was sent; of an array, a list with the value of each element.

    Returns:
        Bytes for a text, a number, or a list of numbers that is filled up to the length of the array.

    Raises:
        TypeError, ValueError, ArithmeticError: It has another type, or is too long.
    """
    is_text = field_type.kind == "S"
    is_array = field_type.subdtype is not None
    if is_text:
        text = _text_bytes(value)
        if len(text.rstrip(b"\0")) > field_type.itemsize:
            raise ValueError("the text is too long")
        return text[: field_type.itemsize]
    if not is_array:
        return _number_of_json_value(value, field_type)
    if not isinstance(value, list) or len(value) > len(default):
        raise ValueError("the array is too long, or none")
    elements = [_number_of_json_value(element, field_type.base) for element in value]
    return elements + default[len(value) :]


def _number_of_json_value(value: Any, field_type: np.dtype[Any]) -> float:
    """Converts a JSON value to the number that a field has in the payload of a message.

    Args:
        value: The value in JSON: a number; a text, such as the names of flags; None, which stands for NaN; or an object
            with one of these under "type" (an entry of an enumeration) or "bits" (a bitmask).
        field_type: Type of the field in the payload.

    Returns:
        A float for a floating-point field, an integer for the others.

    Raises:
        TypeError, ValueError, OverflowError: The value is not a number, or one with decimals for an integer field.
    """
    if isinstance(value, dict):
        value = value.get("type", value.get("bits"))
    if isinstance(value, str):
        value = _value_of_text(value)
    if field_type.kind == "f":
        return nan if value is None else float(value)
    if value != int(value):
        raise ValueError("an integer field has decimals")
    return int(value)


def _value_of_text(text: str) -> float:
    """Converts a JSON string to the number that it stands for.

    It is the name of an enumeration's entry, or several names of bits joined with "|", each of which may also be an
    integer. Otherwise it is a float in quotes, as JSON without JSON5 writes "NaN".

    Args:
        text: The JSON string, without its quotation marks.

    Returns:
        The number; named bits are combined.

    Raises:
        ValueError: The string is none of these.
    """
    entries = enum_entries()
    try:
        number = 0
        for item in text.split("|"):
            name = item.strip()
            if name in entries:
                number |= entries[name]
            elif name:
                number |= int(name, 0)
        # An empty string is a bit mask in which no bit is set.
        return number
    except ValueError:
        return float(text)


def _text_bytes(value: Any) -> bytes:
    """Converts a text field from JSON to bytes.

    Args:
        value: The text in JSON: a string, an array of its characters or of their codes, a byte each, or None.

    Returns:
        The text in UTF-8, or the bytes of the array; none for None.
    """
    if value is None:
        return b""
    if isinstance(value, str):
        return value.encode("utf-8", errors="replace")
    characters = value if isinstance(value, list) else [value]
    codes = [ord(item) if isinstance(item, str) else item for item in characters]
    return bytes(codes)
