"""Binary DataFlash logs (.bin): their definitions (FMT), finding the messages, and decoding them by column.

Every message begins with A3 95 and its id; FMT, whose own definition is fixed, gives the length, the name, one
character a field, and the field names. There are no checksums. A message is accepted when its header is where the one
before it ends, and another follows it; after damage the next header with a known id is tried.

Source: ArduPilot ``libraries/AP_Logger/LogStructure.h`` and
https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html.
"""

import re
import struct
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Integers
from mavdem.containers import Names
from mavdem.facts import Facts
from mavdem.facts.sources import Repair
from mavdem.ingest.telemetry import Columns, repair_facts, rows_by_value

# The header's two bytes, and the bytes of it and the id
HEADER = b"\xa3\x95"
HEADER_LENGTH = len(HEADER) + np.uint8().itemsize
MAX_MESSAGE_BYTES = np.iinfo(np.uint8).max  # Bytes of a message at most: its length has one byte
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
"""NumPy type by format character; a is 32 numbers, n, N and Z are texts, M a flight mode."""
TEXTS = "nNZ"
DIVISORS = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}
"""Divisor that turns a stored integer into the field's unit."""


@dataclass(frozen=True)
class FormatDefinition:
    """One message as a FMT defines it, with one format character a field; ``length`` in bytes, header included."""

    name: str
    length: int
    characters: str
    fields: Names

    @cached_property
    def wire(self) -> np.dtype[Any] | None:
        """The bytes after the header, fields numbered from 0; None where characters or names are inconsistent."""
        decodable = all(character in FIELD_TYPES for character in self.characters)
        if not (decodable and len(self.fields) == len(self.characters) == len(set(self.fields))):
            return None
        # By number: NumPy may change a name that damage has made.
        return np.dtype(
            [(f"{i}", FIELD_TYPES[character]) for i, character in enumerate(self.characters)]
        )

    @property
    def wire_length(self) -> int:
        """Bytes of a whole message by its fields; 0 where they are inconsistent."""
        return HEADER_LENGTH + self.wire.itemsize if self.wire is not None else 0


FORMAT_ID = 0x80  # of the message FMT, which defines all others (AP_Logger)
FORMAT = FormatDefinition("FMT", 89, "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))


class MessageTable(NamedTuple):
    """Messages of one name: the ``place`` (N,) of each in the stream, increasing, and ``columns`` by field name.

    A column, (N,) or (N, 32), is in the field's unit; texts are bytes, ``S`` or objects.
    """

    place: Integers
    columns: Columns


class DataflashRecording(NamedTuple):
    """A DataFlash log, binary or text: the number of messages by name, ``counts``; none is decoded yet.

    ``table`` decodes those of one name; it is empty for a name that does not occur or has inconsistent fields.
    """

    counts: Mapping[str, int]
    table: Callable[[str], MessageTable]
    bytes_skipped: int
    repairs: Facts


EMPTY = MessageTable(np.zeros(0, dtype=np.int64), {})


def defined(values: tuple[int, int, bytes, bytes, bytes]) -> tuple[int, FormatDefinition] | None:
    """Returns the id and definition in the values of an FMT; None where the name is not one."""
    kind, length, name, characters, fields = values
    texts = [
        value.split(b"\0", 1)[0].decode("latin-1").strip() for value in (name, characters, fields)
    ]
    if (
        not all(text.isascii() and text.isprintable() for text in texts)
        or not texts[0].replace("_", "").isalnum()
    ):
        return None
    columns = tuple(field.strip() for field in texts[2].split(",")) if texts[2] else ()
    return kind, FormatDefinition(texts[0], length, texts[1], columns)


NOT_NUMBERS = ("Message", "Name", "x", "y", "z")
"""Fields with a text, or an array, a message: those of MSG, PARM and ISBD."""


def numbers(table: MessageTable) -> MessageTable:
    """Returns a table's fields with one number a message, and those of ``NOT_NUMBERS``.

    In a damaged definition any field may be a text or an array.
    """
    fields = {
        name: values
        for name, values in table.columns.items()
        if name in NOT_NUMBERS or (values.ndim == 1 and values.dtype.kind in "iuf")
    }
    return MessageTable(table.place, fields)


_FORMAT_BEGUN = re.compile(
    HEADER + bytes([FORMAT_ID]) + rb"(?=..[^\0]{0,3}[A-Za-z0-9_])", re.DOTALL
)
"""The beginning of an FMT, long enough to skip most other matches: long runs of headers contain millions."""


def read_binary(content: bytes) -> DataflashRecording:
    """Returns the messages in the bytes of a binary log, up to where another one of other definitions was appended."""
    scan = _Scan(content)
    scan.run()
    # Padded, so that the last message may be read with any definition.
    data = np.pad(np.frombuffer(content, dtype=np.uint8), (0, MAX_MESSAGE_BYTES))
    starts = np.array(scan.starts, dtype=np.int64)
    named = {}
    for kind, rows in rows_by_value(data[starts + 2]).items():
        definition = scan.definitions[kind]
        named[definition.name] = definition, starts[rows]

    def table(name: str) -> MessageTable:
        return _decoded(data, *named[name]) if name in named else EMPTY

    counts = {name: len(places) for name, (_, places) in named.items()}
    return DataflashRecording(counts, table, scan.skipped(), scan.repairs)


class _Scan:
    """One pass over a log: ``starts`` are the places of its messages, ``definitions`` theirs by id."""

    def __init__(self, content: bytes) -> None:
        self.content = content
        self.starts = array("q")
        self.read = 0
        self.repairs: Facts = ()
        self.definitions = {FORMAT_ID: FORMAT}
        self._learn_definitions()
        self.lengths = [0] * 256
        for kind, definition in self.definitions.items():
            self.lengths[kind] = definition.length

    def run(self) -> None:
        content = self.content
        lengths = self.lengths
        starts = self.starts
        size = len(content)
        offset = 0
        first, second = HEADER
        while offset <= size - HEADER_LENGTH:
            if content[offset] == first and content[offset + 1] == second:
                kind = content[offset + 2]
                length = lengths[kind]
                if kind == FORMAT_ID and self._is_of_another(offset):
                    return
                if length and offset + length <= size:
                    starts.append(offset)
                    self.read += length
                    offset += length
                else:
                    offset = self._next_header(offset + 1)
            else:
                offset = self._after_damage(offset)

    def skipped(self) -> int:
        """Bytes that belong to no message, without the fill of a flash chip's last page."""
        tail = self.content[self._end() :]
        filled = (
            len(tail) if tail.count(tail[:1]) == len(tail) and tail[:1] in (b"\0", b"\xff") else 0
        )
        return len(self.content) - self.read - filled

    def _learn_definitions(self) -> None:
        """Finds the first definition of each id anywhere in the log: messages may come before their FMT.

        Of a definition whose length is not that of its fields, the fields count.
        """
        contradictory: dict[int, FormatDefinition] = {}
        for begun in _FORMAT_BEGUN.finditer(self.content):
            defined = self._defined_at(begun.start())
            if defined is not None and defined[0] not in self.definitions:
                kind, definition = defined
                # A field of a newer type is no damage.
                sound = definition.wire is None or definition.length == definition.wire_length
                if sound and definition.length >= HEADER_LENGTH:
                    self.definitions[kind] = definition
                elif definition.wire_length > HEADER_LENGTH:
                    contradictory.setdefault(kind, definition)
        for kind, definition in contradictory.items():
            if kind not in self.definitions:
                length = definition.wire_length
                self.definitions[kind] = replace(definition, length=length)
                self.repairs += repair_facts(
                    Repair.DEFINITION_CONTRADICTED,
                    name=definition.name,
                    length=definition.length,
                    field_length=length,
                )

    def _end(self) -> int:
        """The place behind the last message."""
        if not self.starts:
            return 0
        return self.starts[-1] + self.lengths[self.content[self.starts[-1] + 2]]

    def _is_of_another(self, offset: int) -> bool:
        """Whether a definition differs from the one before it: another log was appended."""
        kind, definition = self._defined_at(offset) or (FORMAT_ID, FORMAT)
        is_sound = kind in self.definitions and definition.length == definition.wire_length
        return is_sound and definition != self.definitions[kind]

    def _defined_at(self, offset: int) -> tuple[int, FormatDefinition] | None:
        if offset + FORMAT.length > len(self.content):
            return None
        return defined(struct.unpack_from("<BB4s16s64s", self.content, offset + HEADER_LENGTH))

    def _after_damage(self, offset: int) -> int:
        """The place to continue from where there is no header; the message that ends there is left out."""
        following = self._next_header(offset)
        if self.starts and following < len(self.content) and self._end() == offset:
            previous = self.starts.pop()
            self.read -= offset - previous
            return self._next_header(previous + 1)
        return following

    def _next_header(self, offset: int) -> int:
        header = self.content.find(HEADER, offset)
        return header if header >= 0 else len(self.content)


def _decoded(
    data: NDArray[np.uint8], definition: FormatDefinition, places: Integers
) -> MessageTable:
    wire = definition.wire
    if wire is None or definition.length != definition.wire_length or not wire.itemsize:
        return EMPTY
    bodies = np.lib.stride_tricks.sliding_window_view(data, wire.itemsize)[places + HEADER_LENGTH]
    messages = bodies.view(wire)[:, 0]
    columns = {}
    for i, (name, character) in enumerate(
        zip(definition.fields, definition.characters, strict=True)
    ):
        column = np.ascontiguousarray(messages[f"{i}"])
        columns[name] = column / DIVISORS[character] if character in DIVISORS else column
    return MessageTable(places, columns)
