"""The messages that a ULog file defines: their fields, sizes, and the layout of the records that hold them.

A definition lists the fields of a message, each with type and name. A field is a number, another message, or an array
of either.

Layout: https://docs.px4.io/main/en/dev_log/ulog_file_format.html.
"""

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from mavdem.ingest.telemetry import MAX_FIELDS

STAMP = struct.Struct("<Q")
"""Time stamp of a record, µs since boot."""

NUMBER_TYPES: dict[str, np.dtype[Any]] = {
    "int8_t": np.dtype("<i1"),
    "uint8_t": np.dtype("<u1"),
    "bool": np.dtype("<i1"),
    "char": np.dtype("<i1"),
    "int16_t": np.dtype("<i2"),
    "uint16_t": np.dtype("<u2"),
    "int32_t": np.dtype("<i4"),
    "uint32_t": np.dtype("<u4"),
    "float": np.dtype("<f4"),
    "int64_t": np.dtype("<i8"),
    "uint64_t": np.dtype("<u8"),
    "double": np.dtype("<f8"),
}
"""How a number is stored, by its type: little-endian. Flags and characters are read as integers, as pyulog does."""

NUMBER_BYTES = {type_name: stored.itemsize for type_name, stored in NUMBER_TYPES.items()}
"""Number of bytes of a number, by its type."""

FIELD = re.compile(r"(\w+)(?:\[(\d{1,5})\])? (\w+)")
"""One field in a definition: its type, the number of its elements if it is an array, and its name."""

FIELD_LIST = re.compile(r"(?:\w++(?:\[\d{1,5}\])? \w++)?(?:;(?:\w++(?:\[\d{1,5}\])? \w++)?)*+")
"""All fields in a definition, with a semicolon between them; there may be nothing between two semicolons."""

NAME = re.compile(rb"[\x21-\x39\x3b-\x7e]+")
"""Name of a message: printable characters without the colon after it."""

MAX_NAME_BYTES = 255
"""Largest length of the name of a message: a choice; PX4's have up to some 40 characters."""

PADDING = "_padding"
"""Beginning of the names of fields that hold nothing."""


class NumberField(NamedTuple):
    """A number in the data records of a topic."""

    name: str
    """Its name, such as ``q[0]`` for an element of an array, or ``current.lat`` in a message within the message."""
    type_name: str
    """Its type, a key of ``NUMBER_TYPES``."""
    offset: int
    """Number of bytes before it, without the header of the record."""


@dataclass(frozen=True)
class TopicLayout:
    """What the data records of one subscription look like, without their header and the subscription's number."""

    name: str
    """Name of the topic."""
    min_bytes: int
    """Number of bytes of all fields but the padding at the end, which PX4 does not write."""
    max_bytes: int
    """Number of bytes with that padding."""
    stamp_offset: int | None
    """Offset of the time stamp, bytes; None where there is none, so that the records are not used."""


class _Field(NamedTuple):
    """One field in the definition of a message."""

    type_name: str
    """Its type: the type of a number, such as "float", or the name of another message."""
    elements: int
    """Number of elements of an array; 1 for a field that is not an array."""
    name: str
    """Its name."""


class _MessageSize(NamedTuple):
    """The size of a message, with the messages in it."""

    numbers: int
    """Number of its numbers: arrays and nested messages count as what they contain."""
    length: int
    """Number of its bytes."""
    has_distinct_names: bool
    """Whether no two fields of a message have one name, here and in the messages in it."""


class ParsedFormat(NamedTuple):
    """The definition of a message."""

    name: str
    """Its name."""
    fields: str
    """Its fields, as the file lists them."""


class MessageFormats:
    """The definitions of messages in a ULog file that were read so far."""

    def __init__(self) -> None:
        """Starts with no definitions."""
        # The list of the fields of each message, as text, and parsed when it is needed: most have no subscription.
        self._formats: dict[str, str] = {}
        self._fields: dict[str, Sequence[_Field]] = {}
        # Layouts of messages by name: each is needed when a subscription is compared, and when it is learned.
        self._layouts: dict[str, TopicLayout | None] = {}
        self._sizes: dict[str, _MessageSize | None] = {}

    def __contains__(self, name: str) -> bool:
        """Returns whether a message of this name is defined."""
        return name in self._formats

    def add(self, definition: ParsedFormat) -> None:
        """Adds the definition of a message.

        Args:
            definition: Name and fields of the message.
        """
        self._formats[definition.name] = definition.fields
        # What was derived from the definitions so far may depend on this one, if messages are nested.
        self._fields.pop(definition.name, None)
        self._layouts.clear()
        self._sizes.clear()

    def layout(self, name: str) -> TopicLayout | None:
        """Returns the layout of the data records of a message.

        Args:
            name: Name of the message ("vehicle_attitude").

        Returns:
            The layout; None if the definition is not usable (:meth:`_layout_of_format`).
        """
        if name not in self._layouts:
            self._layouts[name] = self._layout_of_format(name)
        return self._layouts[name]

    def number_fields(self, name: str) -> Sequence[NumberField]:
        """Lists the numbers in a message, nested messages included, without the padding at the end.

        Args:
            name: Name of the message, which must have a layout.

        Returns:
            Name, type and offset of each number, in the order of the file.
        """
        numbers: list[NumberField] = []
        self._list_numbers(name, "", numbers)
        while numbers and numbers[-1].name.startswith(PADDING):
            numbers.pop()
        return numbers

    def _layout_of_format(self, name: str) -> TopicLayout | None:
        """Computes the layout of a message's data records: their length, and where the time stamp is.

        Padding at the end, fields whose names begin with ``_padding``, is not always logged, so that a record has a
        minimal and a maximal length.

        Args:
            name: Name of the message ("vehicle_attitude").

        Returns:
            The layout; None if the definition or one that it contains is missing, or if it contains itself, has a field
            name twice, or has more than ``MAX_FIELDS`` numbers.
        """
        try:
            size = self._size_of_type(name)
        except RecursionError:
            # The message contains itself.
            return None
        # Even a short definition may announce very many numbers, since messages contain arrays of other messages.
        if name not in self._formats or size is None or size.numbers > MAX_FIELDS:
            return None
        if not size.has_distinct_names:
            names = [number.name for number in self.number_fields(name)]
            if len(set(names)) < len(names):
                return None
        min_bytes = size.length - self._padding_bytes(name)
        return TopicLayout(name, min_bytes, size.length, self._stamp_offset(name, min_bytes))

    def _padding_bytes(self, name: str) -> int:
        """Returns the number of bytes of the padding fields at the end of a message."""
        padding_bytes = 0
        for field in reversed(self._fields_of(name)):
            if not field.name.startswith(PADDING):
                break
            padding_bytes += self._length(field)
        return padding_bytes

    def _stamp_offset(self, name: str, min_bytes: int) -> int | None:
        """Returns the offset of the field ``timestamp`` in a message.

        Args:
            name: Name of the message ("vehicle_attitude").
            min_bytes: Its number of bytes without the padding at the end.

        Returns:
            The offset, bytes; None if the message has no such field, or too few bytes after it.
        """
        offset = 0
        for field in self._fields_of(name):
            # Parsers read eight bytes of the time stamp, even if it is declared with another type.
            is_stamp = field.name == "timestamp" and field.elements == 1
            if is_stamp and field.type_name in NUMBER_BYTES and offset + STAMP.size <= min_bytes:
                return offset
            offset += self._length(field)
        return None

    def _size_of_type(self, type_name: str) -> _MessageSize | None:
        """Returns the size of a type: of a number, or of a message with the messages nested in it.

        Args:
            type_name: The type of a number, such as "float", or the name of a message.

        Returns:
            Number of values, number of bytes, and whether no message has two fields of one name; None if the message or
            one nested in it is not defined.

        Raises:
            RecursionError: The message contains itself.
        """
        if type_name in NUMBER_BYTES:
            return _MessageSize(1, NUMBER_BYTES[type_name], has_distinct_names=True)
        if type_name not in self._formats:
            return None
        if type_name not in self._sizes:
            self._sizes[type_name] = self._size_of_fields(self._fields_of(type_name))
        return self._sizes[type_name]

    def _size_of_fields(self, fields: Sequence[_Field]) -> _MessageSize | None:
        """Returns the size of all fields of a message together.

        Args:
            fields: The fields, which may be arrays or nested messages.

        Returns:
            Number of values, number of bytes, and whether no message has two fields of one name, which parsers could
            not distinguish; None if a nested message is not defined.

        Raises:
            RecursionError: A nested message contains itself.
        """
        value_count = 0
        byte_count = 0
        has_distinct_names = len({field.name for field in fields}) == len(fields)
        for field in fields:
            element_size = self._size_of_type(field.type_name)
            if element_size is None:
                return None
            value_count += field.elements * element_size.numbers
            byte_count += field.elements * element_size.length
            has_distinct_names = has_distinct_names and element_size.has_distinct_names
        return _MessageSize(value_count, byte_count, has_distinct_names)

    def _length(self, field: _Field) -> int:
        """Returns the number of bytes of a field whose type is defined."""
        size = self._size_of_type(field.type_name)
        return field.elements * size.length if size is not None else 0

    def _list_numbers(self, type_name: str, name: str, numbers: list[NumberField]) -> None:
        """Appends the numbers in a field to a list, with their offsets, by recursion into nested messages and arrays.

        A field "position" of a message type with "x" and "y" gives the numbers "position.x" and "position.y".

        Args:
            type_name: Type of the field: the type of a number, or the name of a message.
            name: Name of the field; empty for a whole message.
            numbers: The numbers before the field in the record, to which the numbers in the field are appended.
        """
        if type_name in NUMBER_BYTES:
            offset = 0
            if numbers:
                previous = numbers[-1]
                offset = previous.offset + NUMBER_BYTES[previous.type_name]
            numbers.append(NumberField(name, type_name, offset))
            return
        for field in self._fields_of(type_name):
            field_name = f"{name}.{field.name}" if name else field.name
            for element in range(field.elements):
                element_name = f"{field_name}[{element}]" if field.elements > 1 else field_name
                self._list_numbers(field.type_name, element_name, numbers)

    def _fields_of(self, name: str) -> Sequence[_Field]:
        """Returns the fields of a message, which are parsed when they are first used.

        Args:
            name: Name of the message ("vehicle_attitude").

        Returns:
            The fields in the order of the definition; none if the message is not defined.
        """
        if name not in self._fields:
            fields = []
            for type_name, elements, field_name in FIELD.findall(self._formats.get(name, "")):
                # ULog parsers read an array of 0 elements as a single number.
                fields.append(_Field(type_name, max(int(elements or 1), 1), field_name))
            self._fields[name] = fields
        return self._fields[name]


# Each definition is parsed when it is compared with those before, and again when it is learned.
@lru_cache(maxsize=1)
def parsed_format_of(body: bytes) -> ParsedFormat | None:
    """Parses the definition of a message.

    Args:
        body: The definition, "name:type field;type[4] field;".

    Returns:
        Name and fields of the message; None if the definition is damaged.
    """
    name_end = body.find(b":", 0, MAX_NAME_BYTES + 1)
    if name_end < 0 or NAME.fullmatch(body, 0, name_end) is None:
        return None
    fields = body[name_end + 1 :].decode("latin-1")
    if FIELD_LIST.fullmatch(fields) is None:
        return None
    return ParsedFormat(body[:name_end].decode(), fields)
