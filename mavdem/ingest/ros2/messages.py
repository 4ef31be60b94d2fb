"""The messages of one ROS 2 topic as columns of numbers: decoded by ``rosbags``, of each only the fields asked for.

Definitions: https://mcap.dev/spec/registry#ros2msg (the text with the definitions it refers to behind lines of "=").
Layout of messages: https://www.omg.org/spec/DDSI-RTPS, section 10 (CDR; the four bytes before each message).
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Schema

from mavdem.arrays import Integers
from mavdem.ingest.telemetry import MAX_FIELDS, Fields

CDR = "cdr"  # Message encoding of rosbag2 (https://mcap.dev/spec/registry)
DEFINITION = "ros2msg"  # Schema encoding of rosbag2 (https://mcap.dev/spec/registry)
TEXTS = ("mode",)  # fields that are no numbers
Decoder = Callable[[bytes], Any]


class TopicColumns(NamedTuple):
    """Messages of a topic: ``columns`` (N,) by name, "header.stamp.sec", or "q[0]" of an array, and texts as objects.

    ``places`` (N,) are their numbers in the recording, ascending.
    """

    columns: Fields
    places: Integers


MAX_CHARACTERS = 1 << 16  # Of a definition; PX4's longest, vehicle_status, has 7000


def decoder(schema: Schema) -> Decoder | None:
    """Returns the decoder of a type; None where its definition is damaged, malicious, or in another language."""
    # of an extra that need not be installed
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    text = schema.data.decode("utf-8", errors="replace")
    if schema.encoding != DEFINITION or len(text) > MAX_CHARACTERS:
        return None
    try:
        if sum(map(int, re.findall(r"\[\+?(\d+)\]", text))) > MAX_FIELDS:
            return None
        # The one that recorders may leave out.
        stamps = get_types_from_msg("int32 sec\nuint32 nanosec", "builtin_interfaces/msg/Time")
        store.register(stamps | get_types_from_msg(text, schema.name))
    except Exception:  # the library may raise anything: by then it has run code of its own making
        return None
    return partial(store.deserialize_cdr, typename=schema.name)


def columns_of(
    messages: Mapping[int, Any], needed: Sequence[str], wanted: Sequence[str]
) -> TopicColumns | None:
    """Returns the fields of decoded messages, by their places, as columns; None where they are of another type.

    All have those ``needed``, and one of those ``wanted`` at least, if any. "q[4]" is an array, cut or filled with
    zeros to that length.
    """
    columns: Fields = {}
    fields = set()
    for field in (*needed, *wanted):
        with suppress(AttributeError, TypeError, ValueError):
            columns |= _columns(messages.values(), field)
            fields.add(field)
    if messages and fields.issuperset(needed) and (fields.intersection(wanted) or not wanted):
        return TopicColumns(columns, np.fromiter(messages, np.int64))
    return None


def _columns(messages: Iterable[Any], field: str) -> Fields:
    name, _, length = field.removesuffix("]").partition("[")
    values = list(map(attrgetter(name), messages))
    if not length:
        # A number that is a text or an array raises.
        return {name: np.fromiter(values, np.object_ if name in TEXTS else np.float64)}
    table = np.zeros((len(values), int(length)))
    for row, value in zip(table, values, strict=True):
        row[: len(value)] = value[: int(length)]
    return {f"{name}[{n}]": column for n, column in enumerate(table.T)}
