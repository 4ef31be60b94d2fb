"""What a DataFlash log says of its own messages (FMT), and the columns they make.

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

HEADER = b"\xa3\x95"
HEADER_LENGTH = 3
"""The header's two bytes and the id."""
LONGEST = 255
"""Bytes of a message: its length is told in one."""

FIELD_TYPES: Mapping[str, str | tuple[str, tuple[int]]] = {
    "a": ("<i2", (32,)),
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
"""numpy type by format character; a is 32 numbers, n, N and Z are texts, M a flight mode."""
TEXTS = "nNZ"
DIVISORS = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}
"""What a stored integer is divided by to give the field's unit."""


@dataclass(frozen=True)
class Definition:
    """One message as a FMT defines it.

    Attributes:
        name: its name, "ATT".
        length: bytes of a whole message, header included, as FMT says.
        characters: one format character a field.
        fields: field names.
    """

    name: str
    length: int
    characters: str
    fields: tuple[str, ...]

    @cached_property
    def wire(self) -> np.dtype[Any] | None:
        """What follows the header, its fields numbered from 0; None where characters or names make no sense."""
        known = all(character in FIELD_TYPES for character in self.characters)
        if not (known and len(self.fields) == len(self.characters) == len(set(self.fields))):
            return None
        # By number: of a name that damage has made, NumPy may make another.
        kinds: list[Any] = [
            (f"{i}", kind) if isinstance(kind := FIELD_TYPES[character], str) else (f"{i}", *kind)
            for i, character in enumerate(self.characters)
        ]
        return np.dtype(kinds)

    @property
    def wire_length(self) -> int:
        """Bytes of a whole message by its fields; 0 where they make no sense."""
        return HEADER_LENGTH + self.wire.itemsize if self.wire is not None else 0


FORMAT_ID = 0x80
FORMAT = Definition("FMT", 89, "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))


@dataclass(frozen=True, eq=False)
class Table:
    """Messages of one name, (N,), in stream order.

    Attributes:
        place: (N,) where each stands in the stream, increasing.
        columns: (N,) or (N, 32) by field name, in the field's unit; texts are bytes, ``S`` or objects.
    """

    place: NDArray[np.int64]
    columns: Mapping[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class Recording:
    """A DataFlash log, binary or text, its messages found but not decoded.

    Attributes:
        counts: number of messages by name.
        table: decodes the messages of one name; of a name that does not occur, and of fields that make no sense, the
            table is empty.
        bytes_skipped: bytes that belong to no message.
        repairs: one sentence for each thing that was mended.
    """

    counts: Mapping[str, int]
    table: Callable[[str], Table]
    bytes_skipped: int
    repairs: tuple[str, ...]


EMPTY = Table(np.zeros(0, dtype=np.int64), {})
MOST_DEFINITIONS = 256
"""Definitions of one message that are believed: each log that was appended may bring one, no log this many."""


def defined(values: tuple[int, int, bytes, bytes, bytes]) -> tuple[int, Definition] | None:
    """The id and definition out of a FMT's values; None where it has no name, and so is none."""
    kind, length, name, characters, fields = values
    texts = [_text(value) for value in (name, characters, fields)]
    if not all(text.isascii() and text.isprintable() for text in texts) or not texts[0].replace("_", "").isalnum():
        return None
    columns = tuple(field.strip() for field in texts[2].split(",")) if texts[2] else ()
    return kind, Definition(texts[0], length, texts[1], columns)


def joined(tables: list[Table]) -> Table:
    """The tables of one name as one, in stream order; of different definitions the fields that all have."""
    tables = [table for table in tables if len(table.place)]
    if len(tables) < 2:
        return tables[0] if tables else EMPTY
    place = np.concatenate([table.place for table in tables])
    order = np.argsort(place, kind="stable")
    shared = [name for name in tables[0].columns if all(name in table.columns for table in tables)]
    return Table(
        place[order],
        {name: np.concatenate([table.columns[name] for table in tables])[order] for name in shared},
    )


def numbers(table: Table) -> Table:
    """Its fields of one number a message, which are all that are needed but for texts.

    In a damaged definition any field may be a text or an array.
    """
    fields = {name: values for name, values in table.columns.items() if values.ndim == 1 and values.dtype.kind in "iuf"}
    return Table(table.place, fields)


def _text(value: bytes) -> str:
    return value.split(b"\0", 1)[0].decode("latin-1").strip()
