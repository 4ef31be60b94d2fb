"""The messages of one ROS 2 topic as columns of numbers, decoded by ``rosbags``; only the fields that are needed.

Definitions: https://mcap.dev/spec/registry#ros2msg (the text, then the definitions that it refers to, separated by
lines of "="). Layout of messages: https://www.omg.org/spec/DDSI-RTPS, section 10 (CDR; the four bytes before each
message).
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Schema

from mavdem.arrays import Integers
from mavdem.ingest.telemetry import MAX_FIELDS, Fields

CDR = "cdr"
"""Message encoding of rosbag2 (https://mcap.dev/spec/registry)."""

ROS2_DEFINITION = "ros2msg"
"""Schema encoding of rosbag2 (https://mcap.dev/spec/registry)."""

TEXT_FIELDS = ("mode",)
"""Fields that are texts, not numbers."""

MAX_DEFINITION_CHARACTERS = 1 << 16
"""Longest definition that is parsed; PX4's longest, of vehicle_status, has 7000 characters."""

ARRAY_LENGTH = re.compile(r"\[\+?(\d+)\]")
"""The length of an array in a definition."""

Decoder = Callable[[bytes], Any]
"""Decodes one message to an object with its fields as attributes."""


class TopicColumns(NamedTuple):
    """The N messages of a topic."""

    columns: Fields
    """Columns (N,) by name: "header.stamp.sec", or "q[0]" of an array; texts are objects."""
    positions: Integers
    """Number (N,) of each message in the recording, ascending."""


def decoder(schema: Schema) -> Decoder | None:
    """Returns the decoder of a message type.

    The recording has the definition of each type as text, from which the library ``rosbags`` generates and runs Python
    code. A bad definition may therefore raise anything. Definitions that are very long, or announce very long arrays,
    are refused before.

    Args:
        schema: Name and definition of the type.

    Returns:
        The decoder; None if its definition is damaged, malicious, or in another language.
    """
    # Imported here, since the library belongs to an extra that need not be installed.
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    text = schema.data.decode("utf-8", errors="replace")
    if schema.encoding != ROS2_DEFINITION or len(text) > MAX_DEFINITION_CHARACTERS:
        return None
    try:
        array_elements = sum(map(int, ARRAY_LENGTH.findall(text)))
        if array_elements > MAX_FIELDS:
            return None
        # Recorders may leave out this one definition, which all others refer to.
        stamp_types = get_types_from_msg("int32 sec\nuint32 nanosec", "builtin_interfaces/msg/Time")
        store.register(stamp_types | get_types_from_msg(text, schema.name))
    except Exception:
        return None
    return partial(store.deserialize_cdr, typename=schema.name)


def columns_of(
    messages: Mapping[int, Any], required: Sequence[str], optional: Sequence[str]
) -> TopicColumns | None:
    """Puts the fields of decoded messages into columns.

    A field that is missing, or has another type than expected, is skipped. The fields that were available decide
    whether the messages are of the expected type.

    Args:
        messages: Decoded messages by their number in the recording.
        required: Fields that must be there. "q[4]" is an array, cut or filled with zeros to that length.
        optional: Fields of which one must be there at least, if any are given.

    Returns:
        The columns; None if there are no messages, or they are of another type.
    """
    columns: Fields = {}
    available_fields = set()
    for field in (*required, *optional):
        try:
            columns |= _field_columns(messages.values(), field)
        except (AttributeError, TypeError, ValueError):
            continue
        available_fields.add(field)
    has_all_required = available_fields.issuperset(required)
    has_some_optional = not optional or not available_fields.isdisjoint(optional)
    if not messages or not has_all_required or not has_some_optional:
        return None
    return TopicColumns(columns, np.fromiter(messages, np.int64))


def _field_columns(messages: Iterable[Any], field: str) -> Fields:
    """Collects one field of decoded messages: as one column or, of an array, as one column for each element.

    Arrays of messages may differ in length. They are cut to the length in the field's name, or filled up with zeros.

    Args:
        messages: N messages of one topic, as ``rosbags`` decodes them.
        field: Name of the field, with dots between levels ("pose.position.x"); "q[4]" is an array of length 4.

    Returns:
        A column (N,) under the field's name; of an array of length k, the columns "q[0]" to "q[k-1]".

    Raises:
        AttributeError: The messages do not have the field.
        TypeError, ValueError: It is of another type.
    """
    name, _, length_text = field.removesuffix("]").partition("[")
    values = list(map(attrgetter(name), messages))
    is_array = bool(length_text)
    if not is_array:
        # ``fromiter`` raises if the values are texts or arrays instead of numbers.
        return {name: np.fromiter(values, np.object_ if name in TEXT_FIELDS else np.float64)}
    length = int(length_text)
    table = np.zeros((len(values), length))
    for row, array in zip(table, values, strict=True):
        row[: len(array)] = array[:length]
    return {f"{name}[{n}]": table[:, n] for n in range(length)}
