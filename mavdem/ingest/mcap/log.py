"""MCAP recordings (.mcap): MAVLink as frames or as JSON, in the layouts of BlueOS and of another bridge; or ROS 2.

MCAP's registry has no MAVLink. In use are the topics ``mavlink/{system}/{component}/{MESSAGE}`` (BlueOS) and the same
after a slash, both with a JSON body, and ``mavlink/out``, which repeats everything and is not read. Frames are
recorded with the message encoding ``mavlink``, or as bytes without a schema. A sender with frames is read from them
alone: its JSON messages are the same again. Topics of ROS 2 (``ros2.log``) are read where there is no MAVLink. Source
of BlueOS's layout: its recorder, https://github.com/bluerobotics/BlueOS.
"""

import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from mcap.records import Channel

from mavdem.errors import Unreadable
from mavdem.extras import require_extra
from mavdem.facts import Fact, Facts
from mavdem.facts.sources import Flaw, Repair, SourceFact
from mavdem.files import PathName
from mavdem.ingest.contents import file_bytes
from mavdem.ingest.mavlink.dialect import crc_extra_table, definitions_by_name
from mavdem.ingest.mavlink.frame_stream import ChannelFrames, FrameStream, merged_channels
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES, MARKERS, find_frames
from mavdem.ingest.mavlink.payloads import FrameSender, encode_frame
from mavdem.ingest.mavlink.sequence_counters import SEQUENCE_NUMBERS
from mavdem.ingest.mavlink.vehicles import assemble
from mavdem.ingest.mcap.json_messages import read_json_message
from mavdem.ingest.mcap.records import MAGIC, NANOSECONDS_PER_MICROSECOND, McapRecording
from mavdem.ingest.ros2.log import read_ros2
from mavdem.ingest.ros2.topics import flight_topics
from mavdem.ingest.telemetry import Log, repair_facts

JSON_ENCODINGS = frozenset({"json", "json5"})
"""Message encodings of JSON."""

ENCODINGS_WITHOUT_FRAMES = JSON_ENCODINGS | {
    "ros1",
    "cdr",
    "protobuf",
    "flatbuffer",
    "cbor",
    "msgpack",
}
"""Message encodings (https://mcap.dev/spec/registry) whose messages are not frames, whatever their first byte."""

NO_SCHEMA = 0
"""Number of the schema of a channel without any."""

FLIGHT_TABLE_TOPICS = {"flight/inputs", "flight/outputs"}
"""Topics of the recordings of mavdem itself (``mavdem.export.mcap_channels``), which hold no log."""

MAX_ID = 255
"""Largest MAVLink system or component id."""

MAX_REPORTED_NAMES = 5
"""Number of unknown messages that a fact names, the most frequent first."""


def read_mcap(path: PathName) -> Log:
    """Reads the MAVLink in an MCAP recording, or otherwise the flights in its ROS 2 topics, even if it is damaged.

    Args:
        path: The recording, or an archive of it.

    Returns:
        The log, with the telemetry of each vehicle in it.

    Raises:
        Unreadable: It cannot be opened or contains neither.
        MissingExtra: It holds ROS 2 topics, and their reader is not installed.
    """
    source = os.fspath(path)
    recording = McapRecording(file_bytes(path))
    try:
        stream = _mavlink_stream(source, recording)
    except Unreadable:
        if not flight_topics(recording):
            raise
        require_extra("ros2", source)
        return read_ros2(recording, source)
    return assemble(stream)


def mcap_stream(path: PathName) -> FrameStream:
    """Reads the MAVLink of an MCAP recording as frames; messages in JSON are encoded as frames.

    Args:
        path: The recording, or an archive of it.

    Returns:
        The frames in the order in which they were recorded, with their receive times.

    Raises:
        Unreadable: It cannot be opened, or contains no MAVLink.
    """
    return _mavlink_stream(os.fspath(path), McapRecording(file_bytes(path)))


class _RecordedBytes(NamedTuple):
    """A message of a recording whose bytes are MAVLink: a frame, several frames, or a piece of one."""

    message_number: int
    """Number of the message in the recording."""
    log_time: int
    """When it was recorded, UNIX ns."""
    data: bytes
    """Its bytes."""


def _mavlink_stream(source: str, recording: McapRecording) -> FrameStream:
    """Collects the MAVLink in a recording as one stream of frames, whichever way it was recorded.

    A channel of the recording has MAVLink either as frames, which are taken as they are, or as JSON text, which is
    encoded as frames again. If a sender was recorded in both ways, its JSON messages are skipped, so that nothing
    counts twice. A recording counts as MAVLink if the checksum of any frame matches.

    Args:
        source: Name of the file, for error messages and the report.
        recording: The opened recording, whose records are read here.

    Returns:
        The frames in the order of the recording, with their reception times.

    Raises:
        Unreadable: There is no MAVLink.
    """
    # This reads the whole recording, so that its channels are known below.
    channels = [_frames_of_channel(messages) for messages in _messages_by_channel(recording)]
    # Bytes that belong to no frame, in channels that carry frames.
    skipped_bytes = sum(len(channel.data) - int(channel.frames.size.sum()) for channel in channels)
    frame_senders = _senders_in(channels)
    json_topics = {
        number: topic
        for number, topic in _json_topics(recording).items()
        if topic.sender not in frame_senders
    }
    repairs = recording.repairs()
    unread_messages = 0
    if json_topics:
        json_messages = _frames_of_json(recording.content, json_topics)
        channels.append(json_messages.frames)
        unread_messages = json_messages.unreadable_count
        repairs += json_messages.repairs
    if not any((channel.frames.checksum == CHECKSUM_MATCHES).any() for channel in channels):
        similar_messages = unread_messages + sum(len(channel.frames) for channel in channels)
        raise Unreadable(_no_mavlink_fact(source, recording, similar_messages))
    merged = merged_channels(channels)
    stamps = merged.log_time // np.uint64(NANOSECONDS_PER_MICROSECOND)
    if flight_topics(recording):
        repairs += repair_facts(Repair.TOPICS_NOT_READ, name="ros2")
    return FrameStream(
        source, ".mcap", merged.data, merged.frames, stamps.__getitem__, skipped_bytes, repairs
    )


def _messages_by_channel(recording: McapRecording) -> list[list[_RecordedBytes]]:
    """Returns the messages of each channel that carries MAVLink frames.

    The first message of a channel shows whether it does. Each channel is a separate stream of bytes: a frame may be
    split over two messages of one channel, with messages of other channels between them.

    Args:
        recording: The recording; this call reads it, after which its channels are known.

    Returns:
        For each such channel its messages, in the order of the file.
    """
    messages_of_channel: dict[int, list[_RecordedBytes]] = {}
    other_channels = set()
    for message_number, message in enumerate(recording.messages()):
        channel = message.channel_id
        if channel in other_channels:
            continue
        if channel not in messages_of_channel:
            if not _carries_frames(recording.channels[channel], message.data):
                other_channels.add(channel)
                continue
            messages_of_channel[channel] = []
        recorded = _RecordedBytes(message_number, message.log_time, message.data)
        messages_of_channel[channel].append(recorded)
    return list(messages_of_channel.values())


def _carries_frames(channel: Channel, first_message: bytes) -> bool:
    """Returns whether a channel's messages are MAVLink frames: by its encoding, or without any by a frame's marker."""
    if channel.message_encoding == "mavlink":
        return True
    if channel.schema_id != NO_SCHEMA or channel.message_encoding in ENCODINGS_WITHOUT_FRAMES:
        return False
    return first_message.startswith(MARKERS)


def _frames_of_channel(messages: Sequence[_RecordedBytes]) -> ChannelFrames:
    """Finds the frames in the messages of one channel.

    The bytes of all messages are joined first, so that a frame that was split over two messages is found too. It gets
    the number and the time of the message in which it begins.

    Args:
        messages: The messages of the channel, in the order of the file.

    Returns:
        The joined bytes, the frames (N,), and for each frame the number of its message and the time, UNIX ns.
    """
    data = np.frombuffer(b"".join(message.data for message in messages), dtype=np.uint8)
    message_ends = np.cumsum([len(message.data) for message in messages], dtype=np.int64)
    frames = find_frames(data, crc_extra_table())
    message_of_frame = np.searchsorted(message_ends, frames.start, side="right")
    numbers = np.array([message.message_number for message in messages], dtype=np.int64)
    times = np.array([message.log_time for message in messages], dtype=np.uint64)
    return ChannelFrames(data, frames, numbers[message_of_frame], times[message_of_frame])


def _senders_in(channels: Sequence[ChannelFrames]) -> set[FrameSender]:
    """Returns the senders of all frames whose checksum matches.

    Args:
        channels: The frames of each channel.
    """
    senders: set[FrameSender] = set()
    for channel in channels:
        frames = channel.frames[channel.frames.checksum == CHECKSUM_MATCHES]
        ids = zip(frames.system.tolist(), frames.component.tolist(), strict=True)
        senders.update(FrameSender(system, component) for system, component in ids)
    return senders


class JsonTopic(NamedTuple):
    """A topic with one message of one sender as JSON."""

    sender: FrameSender
    """The sender."""
    message: str
    """Name of the message."""


_JSON_TOPIC = re.compile(r"/?mavlink/(?P<system>\d{1,3})/(?P<component>\d{1,3})/(?P<message>\w+)")


def _json_topics(recording: McapRecording) -> dict[int, JsonTopic]:
    """Finds the channels whose messages are MAVLink as JSON; each has one message type of one sender.

    If both bridges were recorded, the same message is in two topics, ``mavlink/...`` of BlueOS and ``/mavlink/...``.
    BlueOS's is read, because only it has headers with sequence numbers.

    Args:
        recording: The recording, which was read, so that its channels are known.

    Returns:
        Sender and message of each such channel, by the channel's number.
    """
    topics = {}
    topic_names = {channel.topic for channel in recording.channels.values()}
    for number, channel in recording.channels.items():
        match = _JSON_TOPIC.fullmatch(channel.topic)
        if match is None or channel.message_encoding not in JSON_ENCODINGS:
            continue
        is_other_bridge = channel.topic.startswith("/")
        if is_other_bridge and channel.topic.removeprefix("/") in topic_names:
            continue
        sender = FrameSender(int(match["system"]), int(match["component"]))
        if max(sender) <= MAX_ID:
            topics[number] = JsonTopic(sender, match["message"])
    return topics


class _JsonMessages(NamedTuple):
    """Messages of a recording that came as JSON."""

    frames: ChannelFrames
    """The messages, encoded as frames."""

    unreadable_count: int
    """Number of messages that cannot be read."""

    repairs: Facts
    """Why they cannot."""


def _frames_of_json(content: bytes, topics: Mapping[int, JsonTopic]) -> _JsonMessages:
    """Reads the JSON messages of a recording, and encodes them as frames, so that one path decodes all messages.

    Args:
        content: The bytes of the recording, which is read again.
        topics: The topics to read, by number of the channel.

    Returns:
        The messages as frames; the number of those that cannot be read; and facts that state why.
    """
    recorded_frames = []
    last_sequence: dict[FrameSender, int] = {}
    unknown_messages: Counter[str] = Counter()
    undecodable_topics: Counter[str] = Counter()
    recording = McapRecording(content)
    for message_number, message in enumerate(recording.messages()):
        topic = topics.get(message.channel_id)
        if topic is None:
            continue
        definition = definitions_by_name().get(topic.message)
        if definition is None:
            unknown_messages[topic.message] += 1
            continue
        json_message = read_json_message(message.data, definition)
        sequence = json_message.sequence
        if sequence is None:
            # Without a number in its header, a message shows no loss.
            sequence = (last_sequence.get(topic.sender, -1) + 1) % SEQUENCE_NUMBERS
        last_sequence[topic.sender] = sequence
        if json_message.payload is None:
            undecodable_topics[recording.channels[message.channel_id].topic] += 1
        else:
            frame = encode_frame(json_message.payload, definition, topic.sender, sequence)
            recorded_frames.append(_RecordedBytes(message_number, message.log_time, frame))
    repairs = _json_repairs(unknown_messages, undecodable_topics)
    unread_messages = unknown_messages.total() + undecodable_topics.total()
    return _JsonMessages(_frames_of_channel(recorded_frames), unread_messages, repairs)


def _json_repairs(unknown_messages: Counter[str], undecodable_topics: Counter[str]) -> Facts:
    """Reports the JSON messages that cannot be encoded as MAVLink frames.

    Args:
        unknown_messages: Number of messages whose name MAVLink's definitions do not have, by this name.
        undecodable_topics: Number of messages with a damaged or missing field, by topic.

    Returns:
        A fact for each of the two causes that occurred.
    """
    repairs = repair_facts(
        Repair.LOGGED_MESSAGES_LEFT_OUT,
        count=undecodable_topics.total(),
        flaw=Flaw.UNDECODABLE,
        names=sorted(undecodable_topics),
    )
    names = [name for name, _ in unknown_messages.most_common(MAX_REPORTED_NAMES)]
    return repairs + repair_facts(
        Repair.JSON_OF_NO_DIALECT,
        count=unknown_messages.total(),
        names=names,
        more=len(unknown_messages) - len(names),
    )


def _no_mavlink_fact(source: str, recording: McapRecording, similar_messages: int) -> Fact:
    """Returns the fact that explains why no MAVLink was read from a recording, and what the recording seems to be.

    The most specific reason comes first:

    1. There are messages that look like MAVLink, but whose definitions are not in the dialect.
    2. It has topics of a flight that ROS 2 recorded, which are read as another format.
    3. It has topics named for MAVLink, and is damaged, so that their messages may be lost.
    4. It has the topics of a recording that mavdem itself has written: its results, which hold no log.
    5. It has no topics, and does not begin as an MCAP recording does: only its name is that of one.
    6. Otherwise it is a recording without a flight.

    Args:
        source: Name of the file, for error messages and the report.
        recording: The recording, which was read.
        similar_messages: Number of messages that look like MAVLink, but cannot be read.

    Returns:
        The fact for the user.
    """
    if similar_messages:
        return Fact(SourceFact.DIALECT_UNKNOWN, path=source, count=similar_messages, recording=True)
    topic_names = {channel.topic for channel in recording.channels.values()}
    has_mavlink_topics = any(name.lstrip("/").startswith("mavlink/") for name in topic_names)
    code = SourceFact.MCAP_WITHOUT_FLIGHT
    if flight_topics(recording):
        code = SourceFact.MCAP_OF_ROS2
    elif recording.repairs() and has_mavlink_topics:
        code = SourceFact.MCAP_DAMAGED
    elif topic_names >= FLIGHT_TABLE_TOPICS:
        code = SourceFact.MCAP_OF_MAVDEM
    elif not topic_names and not recording.content.startswith(MAGIC):
        return Fact(SourceFact.FORMAT_UNKNOWN, path=source, name="mavlink")
    return Fact(code, path=source, names=sorted(topic_names))
