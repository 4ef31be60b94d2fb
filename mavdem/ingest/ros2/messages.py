"""The messages of one ROS 2 topic as columns of numbers: decoded by ``mcap_ros2``, of each only the fields asked for.

``mcap_ros2`` accepts any definition: one that nests endlessly keeps it busy endlessly, its parser takes quadratic time
over some comments and prints what it does not understand. So a definition is parsed here first, and the library gets a
new one with types and names of fields only, of messages of bounded size. Sources:
https://mcap.dev/spec/registry#ros2msg (the text with the definitions it refers to behind lines of "=") and
https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html (the lines).
Layout of messages: https://www.omg.org/spec/DDSI-RTPS, section 10 (CDR; the four bytes before each message).
"""

from __future__ import annotations

import re
from array import array
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from graphlib import CycleError, TopologicalSorter
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from mcap import records
from numpy.typing import NDArray

from mavdem.ingest.mcap.records import Schema

CDR = "cdr"  # Message encoding of rosbag2 (https://mcap.dev/spec/registry)
DEFINITION = "ros2msg"  # Schema encoding of rosbag2 (https://mcap.dev/spec/registry)
Decoder = Callable[[bytes], Any]


class TopicColumns(NamedTuple):
    """Messages of a topic: ``columns`` (N,) by name, "header.stamp.sec" or "q[0]", and how often each text occurred.

    ``places`` (N,) are their numbers in the recording, ascending.
    """

    columns: dict[str, NDArray[np.float64]]
    places: NDArray[np.int64]
    texts: Counter[str]


MAX_CHARACTERS = 1 << 16  # Of a definition; PX4's longest, vehicle_status, has 7000
PRIMITIVES = frozenset(
    {
        "bool",
        "byte",
        "char",
        "float32",
        "float64",
        "int8",
        "uint8",
        "int16",
        "uint16",
        "int32",
        "uint32",
        "int64",
        "uint64",
        "string",
    }
)
_LOWER = "[a-z](?:_?[a-z0-9])*"  # Names of packages and fields
_BETWEEN = re.compile(r"={3,}")
_OF = re.compile(rf"MSG:\s+({_LOWER})/(?:msg/)?([A-Z][A-Za-z0-9]*)", re.ASCII)
_FIELD = re.compile(
    rf"(?P<of>(?:{_LOWER}/)?[A-Za-z][A-Za-z0-9]*)(?P<longest><=\d+)?"
    rf"(?P<array>\[(?:(?P<size>[1-9]\d{{0,8}})|<=[1-9]\d{{0,8}})?\])?\s+(?P<name>{_LOWER})(?:\s.*)?",
    re.ASCII,
)
_CONSTANT = re.compile(r"[a-z0-9]+(?:<=\d+)?\s+[A-Z][A-Z0-9_]*\s*=.*", re.ASCII)


class _RosField(NamedTuple):
    of: str  # a primitive or a message's "package/Name"
    array: str  # as the text writes it: "[4]" or "[<=4]"
    size: int  # of a fixed array; 1 for others and for single values
    name: str


def rewritten(name: str, text: str) -> str | None:
    """The definition for the decoder of "package/msg/Name": fields only, without comments, defaults and constants.

    None where a line is invalid, a type is not defined, the text is longer than ``MAX_CHARACTERS``, a message contains
    itself or nothing, or is larger than ``MAX_VALUES``.
    """
    package, _, short = name.partition("/msg/")
    own = f"{package}/{short}"
    messages = _messages(own, text) if len(text) <= MAX_CHARACTERS else None
    if messages is None or not all(messages.values()):
        return None
    inside = {of: {field.of for field in fields} for of, fields in messages.items()}
    values = dict(BUILT_IN)
    try:
        for of in TopologicalSorter(inside).static_order():
            if of in messages:
                values[of] = sum(field.size * values[field.of] for field in messages[of])
    except (CycleError, KeyError):
        return None
    if values[own] > MAX_VALUES:
        return None
    written = {
        of: "\n".join(f"{field.of}{field.array} {field.name}" for field in messages[of])
        for of in messages
    }
    first = written.pop(own)
    return "\n===\n".join([first, *(f"MSG: {of}\n{fields}" for of, fields in written.items())])


MAX_VALUES = 1000
"""Values in one message, those of a fixed array counted one by one; PX4's and MAVROS's messages hold up to 100."""
BUILT_IN = dict.fromkeys(PRIMITIVES, 1) | {
    "builtin_interfaces/Time": 2,
    "builtin_interfaces/Duration": 2,
}
"""Numbers of values in what definitions use without defining it."""


def _messages(own: str, text: str) -> dict[str, list[_RosField]] | None:
    """The fields of each message that the text defines, ``own`` first; None where a line is invalid."""
    messages: dict[str, list[_RosField]] = {own: []}
    current = own
    for line in text.splitlines():
        line = line.partition("#")[0].strip()
        if not line or _BETWEEN.fullmatch(line) or _CONSTANT.fullmatch(line):
            continue
        if of := _OF.fullmatch(line):
            current = f"{of[1]}/{of[2]}"
            if current in messages:
                return None
            messages[current] = []
            continue
        found = _FIELD.fullmatch(line)
        if found is None or (found["longest"] and found["of"] != "string"):
            return None
        local = found["of"] not in PRIMITIVES and "/" not in found["of"]
        kind = f"{current.partition('/')[0]}/{found['of']}" if local else found["of"]
        messages[current].append(
            _RosField(kind, found["array"] or "", int(found["size"] or 1), found["name"])
        )
    return messages


def decoder(schema: Schema) -> Decoder | None:
    """Returns the decoder of a type; None where its definition is damaged, malicious, or in another language."""
    from mcap_ros2.decoder import DecoderFactory  # of an extra that need not be installed

    if schema.encoding != DEFINITION or (text := rewritten(schema.name, schema.text)) is None:
        return None
    try:
        plain = records.Schema(id=1, data=text.encode(), encoding=DEFINITION, name=schema.name)
        decode: Decoder | None = DecoderFactory().decoder_for(CDR, plain)
    except Exception:  # the library does not document what it raises
        return None
    return decode


class RosTopicReader:
    """Decodes the messages of one topic one by one; ``failed`` counts those that cannot be decoded."""

    def __init__(self, needed: Sequence[str], wanted: Sequence[str], texts: Sequence[str]) -> None:
        """Starts with the names of the numbers and ``texts`` that messages must have, and of ``wanted`` numbers.

        Of the latter, if any, they must have one. "q[4]" is an array, cut or filled with zeros to that length.
        """
        self.failed = 0
        self._needed = needed
        self._wanted = wanted
        self._texts = texts
        self._numbers: list[tuple[str, int]] = []
        self._get: Callable[[Any], tuple[Any, ...]] | None = None
        self._values, self._places = array("d"), array("q")
        self._texts_counted: Counter[str] = Counter()

    def add(self, place: int, data: bytes, decode: Decoder | None) -> bool:
        """Adds message number ``place`` of the recording; returns whether it could be decoded."""
        # Plain CDR, either way round; other encapsulations align differently.
        row = (
            self._row(data, decode)
            if decode is not None and data[:2] in (b"\0\0", b"\0\1")
            else None
        )
        if row is None:
            self.failed += 1
            return False
        self._values.extend(row)
        self._places.append(place)
        return True

    def table(self) -> TopicColumns:
        """The values of all messages."""
        names = [
            one
            for field, n in self._numbers
            for one in ([f"{field}[{i}]" for i in range(n)] or [field])
        ]
        values = np.frombuffer(self._values, dtype=np.float64).reshape(
            len(self._places), len(names)
        )
        places = np.frombuffer(self._places, dtype=np.int64)
        return TopicColumns(dict(zip(names, values.T, strict=True)), places, self._texts_counted)

    def _row(self, data: bytes, decode: Decoder) -> array[float] | None:
        """The numbers of a message; None where it lacks one."""
        try:
            message = decode(data)
            if self._get is None:
                self._get = self._getter(message)
            values = self._get(message)
            row: list[float] = []
            for (_, count), value in zip(self._numbers, values, strict=False):
                if count:
                    row += value[:count]
                    row += [0.0] * (count - len(value))
                else:
                    row.append(value)
            numbers = array("d", row)
        except Exception:  # cut short, or of another type: the library may raise anything
            return None
        for text in values[len(self._numbers) :]:  # bounded: a vehicle has a few dozen modes
            if text in self._texts_counted or len(self._texts_counted) < 100:
                self._texts_counted[text] += 1
        return numbers

    def _getter(self, message: Any) -> Callable[[Any], tuple[Any, ...]]:
        """The getter of the fields that such messages have, numbers before texts; AttributeError without them."""
        numbers = [_named(field) for field in self._needed]
        wanted = [_named(field) for field in self._wanted]
        for name, count in wanted:
            with suppress(AttributeError):
                attrgetter(name)(message)
                numbers.append((name, count))
        if wanted and len(numbers) == len(self._needed):
            raise AttributeError("none of the wanted fields")
        get: Callable[[Any], tuple[Any, ...]] = attrgetter(
            *(name for name, _ in numbers), *self._texts
        )
        get(message)
        self._numbers = numbers
        return get


def _named(field: str) -> tuple[str, int]:
    """Name and length of an array, 0 for a single value."""
    name, _, count = field.removesuffix("]").partition("[")
    return name, int(count or 0)
