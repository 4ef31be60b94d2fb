"""Message definitions of a DataFlash log (FMT), and the columns its messages make.

Every message begins with A3 95 and its id; FMT, whose own definition is fixed, gives the length, the name, one
character a field, and the field names. Source: ArduPilot ``libraries/AP_Logger/LogStructure.h`` and
https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.telemetry import joined, selected

HEADER, HEADER_LENGTH = b"\xa3\x95", 3  # The header's two bytes, and the bytes of it and the id
MAX_MESSAGE_BYTES = 255  # Bytes of a message at most: its length has one byte
FIELD_TYPES: Mapping[str, str] = (
    {"a": "(32,)<i2", "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8"}
    | {"g": "<f2", "f": "<f4", "d": "<f8", "n": "S4", "N": "S16", "Z": "S64"}
    | {"c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4", "M": "u1"}
)
"""NumPy type by format character; a is 32 numbers, n, N and Z are texts, M a flight mode."""
TEXTS = "nNZ"
DIVISORS = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}
"""Divisor that turns a stored integer into the field's unit."""


@dataclass(frozen=True)
class FormatDefinition:
    """One message as a FMT defines it; ``length`` is that of a whole message, bytes, header included.

    ``characters`` has one format character a field.
    """

    name: str
    length: int
    characters: str
    fields: tuple[str, ...]

    @cached_property
    def wire(self) -> np.dtype[Any] | None:
        """The bytes after the header, fields numbered from 0; None where characters or names are inconsistent."""
        known = all(character in FIELD_TYPES for character in self.characters)
        if not (known and len(self.fields) == len(self.characters) == len(set(self.fields))):
            return None
        # By number: NumPy may change a name that damage has made.
        return np.dtype([(f"{i}", FIELD_TYPES[character]) for i, character in enumerate(self.characters)])

    @property
    def wire_length(self) -> int:
        """Bytes of a whole message by its fields; 0 where they are inconsistent."""
        return HEADER_LENGTH + self.wire.itemsize if self.wire is not None else 0


FORMAT_ID = 0x80
FORMAT = FormatDefinition("FMT", 89, "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))


@dataclass(frozen=True, eq=False)
class MessageTable:
    """Messages of one name: the ``place`` (N,) of each in the stream, increasing, and ``columns`` by field name.

    A column, (N,) or (N, 32), is in the field's unit; texts are bytes, ``S`` or objects.
    """

    place: NDArray[np.int64]
    columns: Mapping[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class DataflashRecording:
    """A DataFlash log, binary or text: the number of messages by name, ``counts``; none is decoded yet.

    ``table`` decodes those of one name; it is empty for a name that does not occur or has inconsistent fields.
    """

    counts: Mapping[str, int]
    table: Callable[[str], MessageTable]
    bytes_skipped: int
    repairs: tuple[str, ...]


EMPTY = MessageTable(np.zeros(0, dtype=np.int64), {})
MAX_DEFINITIONS = 256  # Definitions of one message that are used: each appended log may have one, no log has this many


def defined(values: tuple[int, int, bytes, bytes, bytes]) -> tuple[int, FormatDefinition] | None:
    """The id and definition in the values of an FMT; None where the name is not one."""
    kind, length, name, characters, fields = values
    texts = [_text(value) for value in (name, characters, fields)]
    if not all(text.isascii() and text.isprintable() for text in texts) or not texts[0].replace("_", "").isalnum():
        return None
    columns = tuple(field.strip() for field in texts[2].split(",")) if texts[2] else ()
    return kind, FormatDefinition(texts[0], length, texts[1], columns)


def joined_tables(tables: list[MessageTable]) -> MessageTable:
    """The tables of one name as one, in stream order, with the fields that all of them have."""
    tables = [table for table in tables if len(table.place)]
    if len(tables) < 2:
        return tables[0] if tables else EMPTY
    place = np.concatenate([table.place for table in tables])
    order = np.argsort(place, kind="stable")
    return MessageTable(place[order], selected(joined([table.columns for table in tables]), order))


def numbers(table: MessageTable) -> MessageTable:
    """Its fields with one number a message: in a damaged definition any field may be a text or an array."""
    fields = {name: values for name, values in table.columns.items() if values.ndim == 1 and values.dtype.kind in "iuf"}
    return MessageTable(table.place, fields)


def _text(value: bytes) -> str:
    return value.split(b"\0", 1)[0].decode("latin-1").strip()
