"""Definitions of DataFlash messages, as the message FMT gives them: id, length, name, types and names of the fields.

Source: ArduPilot ``libraries/AP_Logger/LogStructure.h`` and
https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html.
"""

import struct
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from mavdem.containers import Names
from mavdem.log_formats import FORMAT_SIGNATURES, Format

MARKER = FORMAT_SIGNATURES[Format.DATAFLASH].first_bytes
"""First two bytes of every message (HEAD_BYTE1, HEAD_BYTE2)."""

ID_BYTE = len(MARKER)
"""Offset of the message id in a message."""

HEADER_BYTES = len(MARKER) + np.uint8().itemsize
"""Number of bytes of a message's header: the marker and the message id."""

MAX_MESSAGE_BYTES = np.iinfo(np.uint8).max
"""Number of bytes that a message has at most: its length is one byte in FMT."""

MESSAGE_IDS = 256
"""Number of message ids: an id is one byte."""

FIELD_TYPES = {
    "a": "(32,)<i2",
    "b": "i1",
    "B": "u1",
    "h": "<i2",
    "H": "<u2",
    "i": "<i4",
    "I": "<u4",
    "q": "<i8",
    "Q": "<u8",
    "g": "<f2",
    "f": "<f4",
    "d": "<f8",
    "n": "S4",
    "N": "S16",
    "Z": "S64",
    "c": "<i2",
    "C": "<u2",
    "e": "<i4",
    "E": "<u4",
    "L": "<i4",
    "M": "u1",
}
"""NumPy type by format character; "a" is an array of 32 numbers, "n", "N" and "Z" are texts, "M" is a flight mode."""

FIELD_BYTES = {character: np.dtype(kind).itemsize for character, kind in FIELD_TYPES.items()}
"""Number of bytes of a field by its format character."""

TEXT_CHARACTERS = "nNZ"
"""Format characters of texts."""

DIVISORS = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}
"""Divisor that turns a stored integer into the field's unit, by format character; "L" is a latitude or a longitude."""


@dataclass(frozen=True)
class FormatDefinition:
    """The definition of one message, as an FMT gives it."""

    name: str
    """Name of the message: "ATT"."""
    length: int
    """Number of bytes of a message, header included."""
    characters: str
    """One format character per field."""
    fields: Names
    """Names of the fields."""

    @cached_property
    def body_type(self) -> np.dtype[Any] | None:
        """The bytes after the header as a NumPy structured type; None if characters or names are inconsistent.

        Its fields are called "0", "1" and so on: NumPy may change a name that damage has made.
        """
        if not self.length_by_fields:
            return None
        return np.dtype(
            [(f"{i}", FIELD_TYPES[character]) for i, character in enumerate(self.characters)]
        )

    @cached_property
    def length_by_fields(self) -> int:
        """Number of bytes of a message that follows from the types of its fields, header included.

        It is 0 where it cannot be computed: a field has an unknown type, two fields have the same name, or the numbers
        of types and names differ.
        """
        if not FIELD_BYTES.keys() >= set(self.characters):
            return 0
        has_name_per_field = len(self.fields) == len(self.characters)
        if not has_name_per_field or len(set(self.fields)) < len(self.fields):
            return 0
        return HEADER_BYTES + sum(FIELD_BYTES[character] for character in self.characters)


FORMAT_ID = 0x80
"""Id of the message FMT, which defines all others (LOG_FORMAT_MSG)."""

FORMAT = FormatDefinition("FMT", 89, "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))
"""The definition of FMT itself (``struct log_Format``)."""

FORMAT_BODY = struct.Struct("<BB4s16s64s")
"""The fields of FMT after the header, as ``FormatFields`` names them."""


class FormatFields(NamedTuple):
    """The fields of one FMT, as they were logged."""

    message_id: int
    """Id of the message that it defines."""
    length: int
    """Number of bytes of that message, header included."""
    name: bytes
    """Name of that message."""
    characters: bytes
    """One format character per field."""
    field_names: bytes
    """Names of the fields, separated by commas."""


class NumberedDefinition(NamedTuple):
    """The definition of a message, and the id by which the headers of its messages refer to it."""

    message_id: int
    """Number of the message."""
    definition: FormatDefinition
    """Its name, length and fields."""


def parse_definition(values: FormatFields) -> NumberedDefinition | None:
    """Reads the definition in the fields of an FMT.

    Args:
        values: The fields of the FMT, texts as bytes that zeros may fill up.

    Returns:
        The definition with its id; None if the name is not one, or a text is not printable ASCII, because of damage.
    """
    name = _padded_text(values.name)
    characters = _padded_text(values.characters)
    field_names = _padded_text(values.field_names)
    for text in (name, characters, field_names):
        if not text.isascii() or not text.isprintable():
            return None
    if not name.replace("_", "").isalnum():
        return None
    fields = tuple(field.strip() for field in field_names.split(",")) if field_names else ()
    definition = FormatDefinition(name, values.length, characters, fields)
    return NumberedDefinition(values.message_id, definition)


def are_markers_frequent(marker_count: int, byte_count: int) -> bool:
    """Returns whether bytes have so many message markers that they must be messages of a DataFlash log.

    Each message begins with a marker and has at most ``MAX_MESSAGE_BYTES``. In random data the two bytes of a marker
    would occur only once in 65536 bytes.

    Args:
        marker_count: number of markers in the bytes.
        byte_count: number of the bytes.
    """
    return marker_count * MAX_MESSAGE_BYTES > byte_count


def has_dataflash_messages(beginning: bytes) -> bool:
    """Returns whether the beginning of a file has messages of a DataFlash log, even without their definitions."""
    return are_markers_frequent(beginning.count(MARKER), len(beginning))


def _padded_text(value: bytes) -> str:
    """Returns a text without the zeros that fill its field, and without spaces around it."""
    text, _, _ = value.partition(b"\0")
    return text.decode("latin-1").strip()
