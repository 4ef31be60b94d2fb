"""MAVLink's message definitions and enumerations, taken from pymavlink's ``all`` dialect.

They are in ``dialect.json``, which ``tools/dialect`` writes: pymavlink itself takes a hundred megabytes of an
installation. Field order on the wire, truncation and extensions: https://mavlink.io/en/guide/serialization.html.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.containers import Names

CrcExtras = NDArray[np.int32]
"""CRC_EXTRA by message id, -1 for ids without a message in the dialect.

CRC_EXTRA is a byte that follows from the definition of the message. It is part of the checksum, so that frames of a
sender with another definition do not match.
"""


@dataclass(frozen=True, eq=False)
class MessageDefinition:
    """The definition of one MAVLink message."""

    message_id: int
    """Its number."""
    name: str
    """Its name: "ATTITUDE"."""
    crc_extra: int
    """CRC_EXTRA, a byte of every checksum of this message, which follows from the definition."""
    wire_fields: Names
    """Its fields in the order of sending, extensions last, each as type and name: "float[4] q"."""
    definition_order: tuple[int, ...]
    """Their numbers in that order, from 0, in the order of the definition."""
    units: Mapping[str, str]
    """Units of those fields that have one, by the field's name, as the definition writes them: "rad", "degE7"."""

    @cached_property
    def payload_type(self) -> np.dtype[Any]:
        """The payload as a NumPy structured type, with its fields in the order of sending, extensions included."""
        return np.dtype([_numpy_field(field) for field in self.wire_fields]).newbyteorder("<")

    @cached_property
    def fields(self) -> Names:
        """Names of its fields in the order of the definition, extensions last."""
        names = [field.split()[1] for field in self.wire_fields]
        return tuple(names[number] for number in self.definition_order)


def _numpy_field(field: str) -> tuple[str, str]:
    """Converts a field of a definition to one of a NumPy structured type.

    >>> _numpy_field("uint8_t type"), _numpy_field("float[4] q"), _numpy_field("char[50] text")
    (('type', 'uint8'), ('q', '(4,)float32'), ('text', 'S50'))

    Args:
        field: MAVLink's type and the name of the field.

    Returns:
        Name and NumPy's type: a number, an array of numbers, or a text of some bytes.
    """
    mavlink_type, name = field.split()
    # The length is empty for a single number or character.
    element_type, _, length = mavlink_type.rstrip("]").partition("[")
    if element_type == "char":
        return name, f"S{length or 1}"
    number_type = element_type.removesuffix("_t").replace("float", "float32")
    return name, f"({length},){number_type}" if length else number_type


class _Dialect(NamedTuple):
    """What ``dialect.json`` holds."""

    messages: Mapping[str, MessageDefinition]
    """Definitions of messages by name."""
    enums: Mapping[str, Mapping[str, int]]
    """Enumerations by name, each with the numbers of its entries by their names."""


@cache
def _load_dialect() -> _Dialect:
    """Reads ``dialect.json``, the messages and enumerations of pymavlink's ``all`` dialect.

    In the file a message has its ``id``, ``crc_extra``, ``fields`` ("uint8_t type, float[4] q", in the order on the
    wire), ``order``, the names of the fields in the order of the definition, and ``units`` of some of the fields.

    Returns:
        Message definitions by name, and the names of the entries of each enumeration; cached.
    """
    text = (files("mavdem.ingest.mavlink") / "dialect.json").read_text("utf-8")
    document = json.loads(text)
    messages = {}
    for name, entry in document["messages"].items():
        messages[name] = MessageDefinition(
            message_id=entry["id"],
            name=name,
            crc_extra=entry["crc_extra"],
            wire_fields=tuple(entry["fields"].split(", ")),
            definition_order=tuple(entry["order"]),
            units=entry.get("units", {}),
        )
    return _Dialect(messages, document["enums"])


def definitions_by_name() -> Mapping[str, MessageDefinition]:
    """Returns every message of the dialect by name."""
    return _load_dialect().messages


@cache
def definitions_by_id() -> Mapping[int, MessageDefinition]:
    """Returns every message of the dialect by id."""
    return {definition.message_id: definition for definition in definitions_by_name().values()}


@cache
def crc_extra_table() -> CrcExtras:
    """Returns the table of CRC_EXTRA, whose rows are message ids; the value is -1 for an id without a definition.

    CRC_EXTRA is a number that sender and receiver derive from their definition of a message; it enters the checksum, so
    that a frame by another definition fails. An extra last row has the value -1. It stands for all ids that are larger
    than any defined one, since ``take`` with the mode "clip" looks these up there.
    """
    definitions = definitions_by_id()
    largest_id = max(definitions)
    # A row for each id from 0 to the largest one, and the extra one.
    row_count = largest_id + 2
    table = np.full(row_count, -1, dtype=np.int32)
    for message_id, definition in definitions.items():
        table[message_id] = definition.crc_extra
    return table


def mavlink_message_id(name: str) -> int:
    """Returns the id of a message by its name: 30 of "ATTITUDE"."""
    return definitions_by_name()[name].message_id


@cache
def enum_entries() -> Mapping[str, int]:
    """Returns the number of every entry of MAVLink's enumerations by its whole name."""
    return {
        name: number for enum in _load_dialect().enums.values() for name, number in enum.items()
    }


def mavlink_constant(name: str) -> int:
    """Returns MAVLink's number of an entry of an enumeration, by its whole name: "MAV_TYPE_QUADROTOR"."""
    return enum_entries()[name]


@cache
def _short_names(enum: str) -> Mapping[int, str]:
    """Returns the names of an enumeration's entries, without the enumeration's own name, by number."""
    return {
        number: name.removeprefix(f"{enum}_")
        for name, number in _load_dialect().enums[enum].items()
    }


def enum_name(enum: str, value: int) -> str:
    """Returns the short name of a value of a MAVLink enumeration, such as "QUADROTOR" for MAV_TYPE_QUADROTOR.

    Args:
        enum: Name of the enumeration: "MAV_TYPE".
        value: Number of the entry: 2.

    Returns:
        The name without the name of the enumeration; the number as text if there is no such entry.
    """
    return _short_names(enum).get(value, str(value))
