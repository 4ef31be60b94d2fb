"""The messages of one ROS 2 topic as columns of numbers: decoded by ``mcap_ros2``, of each only the fields asked for.

Source of the layout: https://www.omg.org/spec/DDSI-RTPS, section 10 (CDR; the four bytes before each message).
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from mcap import records
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray

from mavdem.ingest.mcap_records import Schema
from mavdem.ingest.ros2_definition import rewritten
from mavdem.ingest.ros2_topics import CDR

DEFINITION = "ros2msg"
"""Schema encoding of rosbag2 (https://mcap.dev/spec/registry)."""
ENCAPSULATIONS = (b"\0\0", b"\0\1")
"""First bytes of plain CDR, either way round; others align differently."""
MOST_TEXTS = 100
"""Different texts that are remembered of a topic; a vehicle has a few dozen modes."""

Decoder = Callable[[bytes], Any]


class Table(NamedTuple):
    """Messages of a topic.

    Attributes:
        columns: (N,) of each number by its name, "header.stamp.sec" or "q[0]".
        places: (N,) of each message its number in the recording, ascending.
        texts: what the fields that hold text said, and how often.
    """

    columns: dict[str, NDArray[np.float64]]
    places: NDArray[np.int64]
    texts: Counter[str]


def decoder(schema: Schema) -> Decoder | None:
    """What decodes messages of a type; None where its definition is damaged, malicious, or in another language."""
    if schema.encoding != DEFINITION:
        return None
    text = rewritten(schema.name, schema.text)
    if text is None:
        return None
    try:
        plain = records.Schema(id=1, data=text.encode(), encoding=DEFINITION, name=schema.name)
        decode: Decoder | None = DecoderFactory().decoder_for(CDR, plain)
    except Exception:  # what the library raises over a definition is not told
        return None
    return decode


class Ros2Topic:
    """Takes the messages of one topic, one by one; ``failed`` counts those that could not be decoded."""

    def __init__(self, needed: Sequence[str], wanted: Sequence[str], texts: Sequence[str]) -> None:
        """Takes the names of fields.

        Args:
            needed: numbers that messages must have. "q[4]" is an array: where it is shorter, zeros follow, and what is
                beyond is left.
            wanted: numbers that are taken where messages have them; where there are any, they must have one.
            texts: texts that they must have.
        """
        self.failed = 0
        self._needed, self._wanted, self._texts = needed, wanted, texts
        self._numbers: list[tuple[str, int]] = []
        self._get: Callable[[Any], tuple[Any, ...]] | None = None
        self._values, self._places = array("d"), array("q")
        self._said: Counter[str] = Counter()

    def add(self, place: int, data: bytes, decode: Decoder) -> bool:
        """Takes the message that is number ``place`` of the recording; whether it could be decoded."""
        row = self._row(data, decode) if data[:2] in ENCAPSULATIONS else None
        if row is None:
            self.failed += 1
            return False
        self._values.extend(row)
        self._places.append(place)
        return True

    def table(self) -> Table:
        """What was taken."""
        names = [name for field, count in self._numbers for name in _elements(field, count)]
        values = np.frombuffer(self._values, dtype=np.float64).reshape(len(self._places), len(names))
        places = np.frombuffer(self._places, dtype=np.int64)
        return Table(dict(zip(names, values.T, strict=True)), places, self._said)

    def _row(self, data: bytes, decode: Decoder) -> array[float] | None:
        """The numbers of a message; None where it does not have them."""
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
        except Exception:  # cut short, or of another type: whatever the library and the numbers make of that
            return None
        for text in values[len(self._numbers) :]:
            if text in self._said or len(self._said) < MOST_TEXTS:
                self._said[text] += 1
        return numbers

    def _getter(self, message: Any) -> Callable[[Any], tuple[Any, ...]]:
        """What gets the fields that such messages have, numbers before texts.

        Raises:
            AttributeError: one that is needed is not there, or none that is wanted.
        """
        numbers = [_named(field) for field in self._needed]
        wanted = [_named(field) for field in self._wanted]
        numbers += [(name, count) for name, count in wanted if _has(message, name)]
        if wanted and len(numbers) == len(self._needed):
            raise AttributeError("none of the fields that are wanted")
        get: Callable[[Any], tuple[Any, ...]] = attrgetter(*(name for name, _ in numbers), *self._texts)
        get(message)
        self._numbers = numbers
        return get


def _named(field: str) -> tuple[str, int]:
    """Name and length of an array, 0 of what is none."""
    name, _, count = field.removesuffix("]").partition("[")
    return name, int(count or 0)


def _has(message: Any, name: str) -> bool:
    try:
        attrgetter(name)(message)
    except AttributeError:
        return False
    return True


def _elements(field: str, count: int) -> list[str]:
    return [f"{field}[{n}]" for n in range(count)] if count else [field]
