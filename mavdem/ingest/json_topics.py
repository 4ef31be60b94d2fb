"""The JSON messages of a recording by who sent them, made frames of."""

from __future__ import annotations

import re
from array import array
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.checksum import Bytes
from mavdem.ingest.compose import Sender, compose
from mavdem.ingest.framing import UNKNOWN, Frames, Places
from mavdem.ingest.mavlink_json import NO_SEQUENCE, definition_named, parse, payloads
from mavdem.ingest.mcap_records import Message
from mavdem.ingest.part import Part

BATCH = 4096
"""Messages of one kind that are parsed together: what is parsed takes ten times the memory of what it is made into."""
MOST_NAMES_TOLD = 5
NAME = re.compile(rb'"type"\s*:\s*"(\w+)"')
SYSTEM, COMPONENT = (re.compile(rb'"%s"\s*:\s*(\d+)' % name) for name in (b"system_id", b"component_id"))


class Kind(NamedTuple):
    """A message's ``name`` and who sends it."""

    sender: Sender
    name: str


@dataclass
class _Topic:
    """The messages of one kind, parsed batch by batch."""

    kind: Kind
    waiting: list[bytes] = field(default_factory=list)
    places: array[int] = field(default_factory=partial(array, "q"))
    log_times: array[int] = field(default_factory=partial(array, "Q"))
    sequence: array[int] = field(default_factory=partial(array, "q"))
    payloads: list[NDArray[np.void]] = field(default_factory=list)
    good: list[NDArray[np.bool_]] = field(default_factory=list)
    message_id: int | None = None

    def add(self, place: int, log_time: int, body: bytes) -> None:
        self.places.append(place)
        self.log_times.append(log_time)
        self.waiting.append(body)
        if len(self.waiting) >= BATCH:
            self.parse()

    def parse(self) -> None:
        written = [parse(body) for body in self.waiting]
        self.waiting.clear()
        self.sequence.extend(NO_SEQUENCE if one is None else one.sequence for one in written)
        definition = definition_named(self.kind.name)
        if definition is None:
            told = (one.message_id for one in written if one is not None and one.message_id is not None)
            self.message_id = next(told, self.message_id)
            return
        fields = [one.fields if one is not None and one.name in (None, self.kind.name) else {} for one in written]
        made, good = payloads(fields, definition)
        self.payloads.append(made)
        self.good.append(good)

    def part(self, sequence: Bytes) -> Part | None:
        """What it makes, given the sequence numbers; None where nobody knows what message it is."""
        definition = definition_named(self.kind.name)
        if definition is not None:
            sender, good = self.kind.sender, np.concatenate(self.good)
            data, frames = compose(np.concatenate(self.payloads), definition, sender, sequence, good)
        elif self.message_id is not None:
            data, frames = np.zeros(0, dtype=np.uint8), self._unknown(self.message_id, sequence)
        else:
            return None
        return Part(data, frames, np.array(self.places), np.array(self.log_times))

    def _unknown(self, message_id: int, sequence: Bytes) -> Frames:
        nowhere = np.zeros(len(sequence), dtype=np.int64)
        sender = self.kind.sender
        system, component, verdict = (
            np.full(len(sequence), number, dtype=np.uint8) for number in (sender.system, sender.component, UNKNOWN)
        )
        return Frames(nowhere, nowhere, nowhere, nowhere, nowhere + message_id, system, component, sequence, verdict)


class JsonTopics:
    """The JSON messages of a recording, each counted once.

    Messages of a damaged chunk are left out: nothing in JSON tells a wrong digit from a right one.
    """

    def __init__(self, own: Collection[Kind], left_out: Collection[Sender]) -> None:
        """Takes the kinds of messages that have a topic of their own, and the senders that are read from elsewhere."""
        self._own = frozenset(own)
        self._left_out = frozenset(left_out)
        self._topics: dict[Kind, _Topic] = {}
        self._unvouched = 0
        self._unnamed = 0
        self._nameless: Counter[str] = Counter()

    def add(self, kind: Kind, place: int, message: Message) -> None:
        """Takes a message of a topic of its own; ``place`` is its number in the recording."""
        if kind.sender in self._left_out:
            return
        if not message.vouched:
            self._unvouched += 1
            return
        topic = self._topics.get(kind)
        if topic is None:
            topic = self._topics[kind] = _Topic(kind)
        topic.add(place, message.log_time, message.data)

    def add_repeated(self, place: int, message: Message) -> None:
        """Takes a message of the topic that repeats the others, unless it has one of its own."""
        if self._likely_kind(message.data) in self._own:
            return
        kind = self._kind(message.data) if message.vouched else None
        if kind is None:
            self._unnamed += message.vouched
            self._unvouched += not message.vouched
        elif kind not in self._own:
            self.add(kind, place, message)

    def parts(self) -> Iterator[Part]:
        """What was taken, as frames."""
        by_sender: dict[Sender, list[_Topic]] = {}
        for topic in self._topics.values():
            topic.parse()
            by_sender.setdefault(topic.kind.sender, []).append(topic)
        for topics in by_sender.values():
            lengths = [len(topic.places) for topic in topics]
            sequence = _numbered(
                np.concatenate([topic.sequence for topic in topics]).astype(np.int64),
                np.concatenate([topic.places for topic in topics]),
            )
            for topic, numbers in zip(topics, np.split(sequence, np.cumsum(lengths)[:-1]), strict=True):
                part = topic.part(numbers)
                if part is None:
                    self._nameless[topic.kind.name] += len(topic.places)
                else:
                    yield part

    def sentences(self) -> tuple[str, ...]:
        """A sentence for each reason for which messages were left out."""
        said = []
        if self._unvouched:
            said.append(f"{self._unvouched} JSON messages in damaged chunks were left out.")
        if self._unnamed:
            said.append(f"{self._unnamed} JSON messages that do not tell what they are were left out.")
        if self._nameless:
            names = [name for name, _ in self._nameless.most_common(MOST_NAMES_TOLD)]
            more = f" and {len(self._nameless) - len(names)} more" if len(self._nameless) > len(names) else ""
            said.append(
                f"{self._nameless.total()} JSON messages of no known dialect ({', '.join(names)}{more}) were left out."
            )
        return tuple(said)

    def _likely_kind(self, body: bytes) -> Kind | None:
        """What a body seems to be, by the first words that say so: parsing it would take three times as long."""
        found = [pattern.search(body) for pattern in (SYSTEM, COMPONENT, NAME)]
        if not all(found):
            return None
        system, component, name = (match[1].decode() for match in found if match is not None)
        if len(system) > 3 or len(component) > 3:
            return None
        return Kind(Sender(int(system), int(component)), name)

    def _kind(self, body: bytes) -> Kind | None:
        written = parse(body)
        if written is None or written.name is None or written.system is None or written.component is None:
            return None
        return Kind(Sender(written.system, written.component), written.name)


def _numbered(sequence: NDArray[np.int64], places: Places) -> Bytes:
    """One sender's sequence numbers; those that are missing go on from the one before, so that they tell no loss."""
    order = np.argsort(places, kind="stable")
    told, row = sequence[order], np.arange(len(order))
    last = np.maximum.accumulate(np.where(told != NO_SEQUENCE, row, -1))
    before = np.where(last >= 0, told[last], -1)
    numbers = np.empty(len(order), dtype=np.uint8)
    numbers[order] = (before + row - last) % 256
    return numbers
