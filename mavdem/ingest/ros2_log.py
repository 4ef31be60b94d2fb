"""Flights in ROS 2 recordings (rosbag2's MCAP files): PX4's topics and MAVROS's, brought to MAVLink's messages.

What the topics mean is told by ``px4_topics`` and ``mavros_topics``. Recordings hold no parameters.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from mavdem.errors import Unreadable
from mavdem.ingest import mavros_topics, px4_topics
from mavdem.ingest.framing import Progress
from mavdem.ingest.log import Log, Speaker
from mavdem.ingest.mcap_records import Recording, listed
from mavdem.ingest.ros2_messages import Decoder, Ros2Topic, Table, decoder
from mavdem.ingest.ros2_topics import CDR, PX4, Topic, flight_topics
from mavdem.ingest.ros2_vehicles import PX4_STAMP, numbered, vehicle
from mavdem.telemetry import Telemetry


def read_ros2(recording: Recording, source: str, progress: Progress | None = None) -> Log:
    """Reads the vehicles in a ROS 2 recording; of each, PX4's own topics or, where there are none, MAVROS's.

    In the ``Log``, ``frames`` counts the messages that were read.

    Args:
        recording: read once, so that its channels and schemas are known; it is read anew.
        source: the file's name.
        progress: called with the fraction done.

    Raises:
        Unreadable: there is no message of a flight that can be decoded.
    """
    taken = _Taken(recording)
    taken.read(progress)
    made = [one for namespace, topics in taken.vehicles() if (one := vehicle(namespace, topics)) is not None]
    if not made:
        raise Unreadable(
            f"{source} is a ROS 2 recording, but no message of a flight in it can be decoded: it is damaged, or the "
            "definitions of its messages are."
        )
    repairs = taken.sentences()
    vehicles = tuple(
        Telemetry(
            system=one.system,
            component=one.component,
            vehicle=one.vehicle,
            autopilot=one.autopilot,
            messages=one.messages,
            source=source,
            repairs=repairs + one.repairs,
            translated_from=one.bridge,
        )
        for one in numbered(made)
    )
    counts = [{name: len(columns["time"]) for name, columns in one.messages.items()} for one in vehicles]
    speakers = tuple(
        Speaker(one.system, one.component, one.vehicle, one.autopilot, sent, lost=0)
        for one, sent in zip(vehicles, counts, strict=True)
    )
    return Log(source, vehicles, speakers, (), taken.count, taken.skipped, taken.received)


class _Taken:
    """What is taken of a recording: the topics of a flight, and how many messages had to be left out."""

    def __init__(self, recording: Recording) -> None:
        self._content, self._schemas = recording.content, recording.schemas
        told = flight_topics(recording.channels.values(), recording.schemas)
        decoders = {number: decoder(self._schemas[number]) for number in {channel.schema for channel in told}}
        self._feeds = {channel: _Feed(topic, decoders[channel.schema]) for channel, topic in told.items()}
        self._unvouched = self._undefined = self.skipped = self.count = 0
        self._damage: tuple[str, ...] = ()
        self.received = (np.nan, np.nan)

    def read(self, progress: Progress | None) -> None:
        """Takes the messages."""
        recording = Recording(self._content)
        first, last = np.inf, -np.inf
        for place, message in enumerate(recording.messages(progress)):
            channel = message.channel
            feed = self._feeds.get(channel)
            if feed is None:
                self._undefined += channel.encoding == CDR and channel.schema not in self._schemas
            elif not message.vouched:
                # Nothing in a message of ROS 2 tells a wrong number from a right one.
                self._unvouched += 1
            elif feed.decode is None:
                feed.values.failed += 1
            elif feed.values.add(place, message.data, feed.decode):
                self.count += 1
                first, last = min(first, message.log_time), max(last, message.log_time)
        if self.count:
            self.received = (first / 1e9, last / 1e9)
        self._damage, self.skipped = recording.damage.sentences(), recording.damage.skipped

    def vehicles(self) -> Iterator[tuple[str, dict[Topic, Table]]]:
        """The namespace of each vehicle and its topics; of several that tell the same, the one with most messages."""
        found: dict[str, dict[Topic, Table]] = {}
        for feed in self._feeds.values():
            table = feed.values.table()
            topics = found.setdefault(feed.topic.vehicle, {})
            if len(table.places) > (len(topics[feed.topic].places) if feed.topic in topics else 0):
                topics[feed.topic] = table
        yield from sorted(found.items())

    def sentences(self) -> tuple[str, ...]:
        """A sentence for each thing that is damaged, and for each reason for which messages were left out."""
        said = list(self._damage)
        if self._unvouched:
            said.append(f"{self._unvouched} ROS 2 messages in damaged chunks were left out.")
        if self._undefined:
            said.append(f"{self._undefined} ROS 2 messages whose definition is damaged or missing were left out.")
        failed = {channel.topic: feed.values.failed for channel, feed in self._feeds.items() if feed.values.failed}
        if failed:
            many = sum(failed.values())
            said.append(f"{many} ROS 2 messages that cannot be decoded were left out, of {listed(failed)}.")
        return tuple(said)


@dataclass
class _Feed:
    """The messages of one channel: the topic they are of, what decodes them, and what was taken."""

    topic: Topic
    decode: Decoder | None
    values: Ros2Topic = field(init=False)

    def __post_init__(self) -> None:
        if self.topic.bridge == PX4:
            self.values = Ros2Topic((PX4_STAMP,), px4_topics.NEEDED[self.topic.name], ())
        else:
            kind = mavros_topics.TOPICS[self.topic.name]
            self.values = Ros2Topic((*mavros_topics.STAMP, *kind.numbers), (), kind.texts)
