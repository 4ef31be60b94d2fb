"""The JSON messages of a recording as frames, by sender."""

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

from mavdem.ingest.log import repair_sentences
from mavdem.ingest.mavlink.checksum import Bytes
from mavdem.ingest.mavlink.compose import FrameSender, composed_frames
from mavdem.ingest.mavlink.framing import UNKNOWN, Frames, Places
from mavdem.ingest.mavlink.json_messages import NO_SEQUENCE, definition_named, parse, payloads
from mavdem.ingest.mavlink.stream import RecordingPart
from mavdem.ingest.mcap.records import McapMessage

BATCH = 4096  # Messages of one topic that are parsed together: parsed, they take ten times the memory of their payloads
NAME_PATTERN = re.compile(rb'"type"\s*:\s*"(\w+)"')
SYSTEM_PATTERN, COMPONENT_PATTERN = (
    re.compile(rb'"%s"\s*:\s*(\d+)' % name) for name in (b"system_id", b"component_id")
)


class JsonTopic(NamedTuple):
    """A message's ``name`` and its sender."""

    sender: FrameSender
    name: str


@dataclass
class _JsonMessages:
    """The messages of one topic, parsed batch by batch."""

    kind: JsonTopic
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
            ids = (one.message_id for one in written if one is not None and one.message_id is not None)
            self.message_id = next(ids, self.message_id)
            return
        fields = [one.fields if one is not None and one.name in (None, self.kind.name) else {} for one in written]
        made, good = payloads(fields, definition)
        self.payloads.append(made)
        self.good.append(good)

    def part(self, sequence: Bytes) -> RecordingPart | None:
        """The messages as frames with these sequence numbers; None where the message is not known."""
        definition = definition_named(self.kind.name)
        if definition is not None:
            sender, good = self.kind.sender, np.concatenate(self.good)
            data, frames = composed_frames(np.concatenate(self.payloads), definition, sender, sequence, good)
        elif self.message_id is not None:
            sender, none = self.kind.sender, np.zeros(len(sequence), dtype=np.int64)
            system, component, verdict = (
                np.full(len(none), number, dtype=np.uint8) for number in (sender.system, sender.component, UNKNOWN)
            )
            data, ids = np.zeros(0, dtype=np.uint8), none + self.message_id
            frames = Frames(none, none, none, none, ids, system, component, sequence, verdict)
        else:
            return None
        return RecordingPart(data, frames, np.array(self.places), np.array(self.log_times))


class JsonTopics:
    """The JSON messages of a recording, each once.

    Messages of a damaged chunk are left out: JSON has no checksum that shows a wrong digit.
    """

    def __init__(self, own: Collection[JsonTopic], left_out: Collection[FrameSender]) -> None:
        """Starts with the messages that have a topic of their own, and the senders that are read from frames."""
        self._own = frozenset(own)
        self._left_out = frozenset(left_out)
        self._topics: dict[JsonTopic, _JsonMessages] = {}
        self._damaged = self._unnamed = 0
        self._nameless: Counter[str] = Counter()

    def add(self, kind: JsonTopic, place: int, message: McapMessage) -> None:
        """Adds a message of a topic of its own; ``place`` is its number in the recording."""
        if kind.sender in self._left_out:
            return
        if not message.sound:
            self._damaged += 1
            return
        if kind not in self._topics:
            self._topics[kind] = _JsonMessages(kind)
        self._topics[kind].add(place, message.log_time, message.data)

    def add_repeated(self, place: int, message: McapMessage) -> None:
        """Adds a message of the topic that repeats the others, unless it has one of its own."""
        if self._likely_kind(message.data) in self._own:
            return
        kind = self._kind(message.data) if message.sound else None
        if kind is None:
            self._unnamed += message.sound
            self._damaged += not message.sound
        elif kind not in self._own:
            self.add(kind, place, message)

    def parts(self) -> Iterator[RecordingPart]:
        """The added messages as frames."""
        by_sender: dict[FrameSender, list[_JsonMessages]] = {}
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
        names, unknown = [name for name, _ in self._nameless.most_common(5)], self._nameless.total()
        more = f" and {len(self._nameless) - len(names)} more" if len(self._nameless) > len(names) else ""
        return repair_sentences(
            (self._damaged, f"{self._damaged} JSON messages in damaged chunks were left out."),
            (self._unnamed, f"{self._unnamed} JSON messages without a name or a sender were left out."),
            (unknown, f"{unknown} JSON messages of no known dialect ({', '.join(names)}{more}) were left out."),
        )

    def _likely_kind(self, body: bytes) -> JsonTopic | None:
        """The likely topic of a body, by its first matches: parsing it would take three times as long."""
        found = [pattern.search(body) for pattern in (SYSTEM_PATTERN, COMPONENT_PATTERN, NAME_PATTERN)]
        if not all(found):
            return None
        system, component, name = (match[1].decode() for match in found if match is not None)
        if len(system) > 3 or len(component) > 3:
            return None
        return JsonTopic(FrameSender(int(system), int(component)), name)

    def _kind(self, body: bytes) -> JsonTopic | None:
        written = parse(body)
        if written is None or written.name is None or written.system is None or written.component is None:
            return None
        return JsonTopic(FrameSender(written.system, written.component), written.name)


def _numbered(sequence: NDArray[np.int64], places: Places) -> Bytes:
    """One sender's sequence numbers; missing ones continue from the one before, so that they show no loss."""
    order = np.argsort(places, kind="stable")
    known, row = sequence[order], np.arange(len(order))
    last = np.maximum.accumulate(np.where(known != NO_SEQUENCE, row, -1))
    before = np.where(last >= 0, known[last], -1)
    numbers = np.empty(len(order), dtype=np.uint8)
    numbers[order] = (before + row - last) % 256
    return numbers
