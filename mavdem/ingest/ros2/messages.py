"""The messages of one ROS 2 topic as columns of numbers: decoded by ``rosbags``, of each only the fields asked for.

Definitions: https://mcap.dev/spec/registry#ros2msg (the text with the definitions it refers to behind lines of "=").
Layout of messages: https://www.omg.org/spec/DDSI-RTPS, section 10 (CDR; the four bytes before each message).
"""

from __future__ import annotations

import re
from array import array
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache, partial
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from mavdem.ingest.mcap.records import Schema
from mavdem.ingest.telemetry import Array, Integers

CDR = "cdr"  # Message encoding of rosbag2 (https://mcap.dev/spec/registry)
DEFINITION = "ros2msg"  # Schema encoding of rosbag2 (https://mcap.dev/spec/registry)
Decoder = Callable[[bytes], Any]


class TopicColumns(NamedTuple):
    """Messages of a topic: ``columns`` (N,) by name, "header.stamp.sec" or "q[0]", and how often each text occurred.

    ``places`` (N,) are their numbers in the recording, ascending.
    """

    columns: dict[str, Array]
    places: Integers
    texts: Counter[str]


MAX_CHARACTERS = 1 << 16  # Of a definition; PX4's longest, vehicle_status, has 7000
MAX_VALUES = 1000
"""Values in the fixed arrays of a definition, of which PX4's and MAVROS's have up to 100: the library writes code for
each."""


def decoder(schema: Schema) -> Decoder | None:
    """Returns the decoder of a type; None where its definition is damaged, malicious, or in another language."""
    # of an extra that need not be installed
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    if schema.encoding != DEFINITION or len(schema.text) > MAX_CHARACTERS:
        return None
    try:
        if sum(map(int, re.findall(r"\[(\d+)\]", schema.text))) > MAX_VALUES:
            return None
        # The one that recorders may leave out.
        stamps = get_types_from_msg("int32 sec\nuint32 nanosec", "builtin_interfaces/msg/Time")
        store.register(stamps | get_types_from_msg(schema.text, schema.name))
    except Exception:  # the library may raise anything: by then it has run code of its own making
        return None
    return partial(store.deserialize_cdr, typename=schema.name)


class RosTopicReader:
    """Decodes the messages of one topic one by one; ``failed`` counts those that cannot be decoded."""

    def __init__(self, needed: Sequence[str], wanted: Sequence[str], texts: Sequence[str]) -> None:
        """Starts with the names of the numbers and ``texts`` that messages must have, and of ``wanted`` numbers.

        Of the latter, if any, they must have one. "q[4]" is an array, cut or filled with zeros to that length.
        """
        self.failed = 0
        self._needed, self._wanted, self._texts = needed, wanted, texts
        self._there: list[str] = []
        self._values, self._places = array("d"), array("q")
        self._texts_counted: Counter[str] = Counter()

    def add(self, place: int, data: bytes, decode: Decoder | None) -> bool:
        """Adds message number ``place`` of the recording; returns whether it could be decoded."""
        try:
            assert decode is not None
            message = decode(data)
            if not self._there:
                self._there = self._fields_of(message)
            row = array("d")
            for name in self._there:
                row.extend(_numbers(message, name))
            texts = [attrgetter(name)(message) for name in self._texts]
        except Exception:  # cut short, or of another type: the library may raise anything
            self.failed += 1
            return False
        self._values.extend(row)
        self._places.append(place)
        for text in texts:  # bounded: a vehicle has a few dozen modes
            if text in self._texts_counted or len(self._texts_counted) < 100:
                self._texts_counted[text] += 1
        return True

    def table(self) -> TopicColumns:
        """The values of all messages."""
        names = []
        for field in self._there:
            name, count = _named(field)
            names += [f"{name}[{n}]" for n in range(count)] or [name]
        values = np.frombuffer(self._values, dtype=np.float64)
        columns = values.reshape(len(self._places), len(names)).T
        places = np.frombuffer(self._places, dtype=np.int64)
        return TopicColumns(dict(zip(names, columns, strict=True)), places, self._texts_counted)

    def _fields_of(self, message: Any) -> list[str]:
        """The names of the numbers that such messages have; AttributeError without a wanted one."""
        wanted = []
        for field in self._wanted:
            with suppress(AttributeError):
                attrgetter(_named(field)[0])(message)
                wanted.append(field)
        if self._wanted and not wanted:
            raise AttributeError("none of the wanted fields")
        return [*self._needed, *wanted]


def _numbers(message: Any, field: str) -> list[float]:
    name, count = _named(field)
    value = attrgetter(name)(message)
    return [*value[:count], *[0.0] * (count - len(value))] if count else [value]


@cache
def _named(field: str) -> tuple[str, int]:
    """Name and length of an array, 0 for a single value."""
    name, _, count = field.removesuffix("]").partition("[")
    return name, int(count or 0)
