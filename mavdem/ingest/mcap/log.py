"""MCAP recordings (.mcap): MAVLink as JSON, in the layouts of BlueOS and of another bridge, or as frames; else ROS 2.

MCAP's registry has no MAVLink. In use are the topics ``mavlink/{system}/{component}/{MESSAGE}`` (BlueOS) and the same
after a slash, both with a JSON body (``mcap.json_topics``), and ``mavlink/out``, which repeats everything. Frames are
recorded with the message encoding ``mavlink``, or as bytes without a schema. A sender with frames is read from them
alone: its JSON messages are the same again. Topics of ROS 2 (``ros2.log``) are read where there is no MAVLink. Source
of BlueOS's layout: its recorder, https://github.com/bluerobotics/BlueOS.
"""

from __future__ import annotations

import os
import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mavdem.errors import Unreadable, require
from mavdem.ingest.contents import file_bytes
from mavdem.ingest.mavlink.clocks import Places, Times, far_off
from mavdem.ingest.mavlink.definitions import FrameSender, seeds
from mavdem.ingest.mavlink.framing import GOOD, MARKER_1, MARKER_2, Progress, find_in_pieces, no_progress
from mavdem.ingest.mavlink.vehicles import FrameIndex, FrameStream, RecordingPart, assemble, joined
from mavdem.ingest.mcap.json_topics import JsonTopic, JsonTopics, json_kind
from mavdem.ingest.mcap.records import Channel, McapMessage, McapRecording
from mavdem.ingest.ros2.log import flight_topics, read_ros2
from mavdem.ingest.telemetry import Log, listed
from mavdem.ingest.tlog import MAX_STAMP_JUMP, STAMP_WINDOW

JSON = frozenset({"json", "json5"})
NO_FRAMES = JSON | {"ros1", "cdr", "protobuf", "flatbuffer", "cbor", "msgpack"}
"""Message encodings (https://mcap.dev/spec/registry) that are not of frames, whatever the first byte."""


def read_mcap(path: str | os.PathLike[str], progress: Progress = no_progress) -> Log:
    """Reads the MAVLink in an MCAP recording, or else the flights in its ROS 2 topics, also where it is damaged.

    Raises Unreadable: it cannot be opened or contains neither; MissingExtra: the reader of ROS 2 is not installed.
    """
    recording = McapRecording(file_bytes(path))
    stream, seen = _stream(os.fspath(path), recording, progress)
    if stream is None:
        if not flight_topics(recording.channels.values(), recording.schemas):
            raise Unreadable(_nothing_in(path, recording, seen))
        require(f"{os.fspath(path)} is a ROS 2 recording, which", "ros2")
        return read_ros2(recording, os.fspath(path), _within(progress, 0.5, 1.0))
    index = FrameIndex(len(stream.data))
    index.add(stream.frames)
    received = _received(stream.stamps)
    known = received[~np.isnan(received)]
    span = (float(known.min()), float(known.max())) if len(known) else (np.nan, np.nan)

    def at(start: Places) -> Times:
        return received[np.searchsorted(stream.frames.start, start, side="right") - 1]

    return assemble(stream.data, index, at, span, stream.bytes_skipped, stream.source, stream.repairs)


def mcap_stream(path: str | os.PathLike[str], progress: Progress = no_progress) -> FrameStream:
    """Returns the MAVLink of an MCAP recording, JSON too, as frames; raises ``Unreadable``: no file, or none in it."""
    recording = McapRecording(file_bytes(path))
    stream, seen = _stream(os.fspath(path), recording, progress)
    if stream is None:
        raise Unreadable(_nothing_in(path, recording, seen))
    return stream


def _stream(source: str, recording: McapRecording, progress: Progress) -> tuple[FrameStream | None, int]:
    """The MAVLink in a recording, or None, and the number of messages that look like MAVLink."""
    carried: dict[Channel, _FrameChannel | None] = {}
    for place, message in enumerate(recording.messages(_within(progress, 0.0, 0.5))):
        if (channel := message.channel) not in carried:
            marked = message.data[:1] in (bytes([MARKER_1]), bytes([MARKER_2]))
            bare = channel.schema == 0 and channel.encoding not in NO_FRAMES and marked
            carried[channel] = _FrameChannel() if channel.encoding == "mavlink" or bare else None
        if (frames := carried[message.channel]) is not None:
            frames.add(place, message)
    found = [frames.found() for frames in carried.values() if frames is not None]
    heard: set[FrameSender] = set()
    for part, _ in found:
        good = part.frames[part.frames.verdict == GOOD]
        heard |= {FrameSender(*ids) for ids in zip(good.system.tolist(), good.component.tolist(), strict=True)}
    channels = list(recording.channels.values())
    if not heard and not any(channel.encoding in JSON for channel in channels):
        return None, sum(len(part.frames) for part, _ in found)
    json, unknown, left_out = _json_parts(recording.content, channels, heard, _within(progress, 0.5, 1.0))
    parts = [*(part for part, _ in found), *json]
    if not any((part.frames.verdict == GOOD).any() for part in parts):
        return None, unknown + sum(len(part.frames) for part in parts)
    part = joined(parts)
    stamps = part.log_time // np.uint64(1000)
    repairs = [*recording.repairs(), *left_out]
    if flight_topics(channels, recording.schemas):
        repairs.append("The recording also has ROS 2 topics of a flight; they were not read.")
    skipped = sum(skipped for _, skipped in found)
    return FrameStream(source, ".mcap", part.data, part.frames, stamps, skipped, tuple(repairs)), len(part.frames)


@dataclass
class _FrameChannel:
    """The frames in a channel's messages, each of which is a frame, several, or a part of one."""

    # Arrays, not lists, whose integers take five times the memory: there may be millions of messages.
    content: bytearray = field(default_factory=bytearray)
    ends: array[int] = field(default_factory=partial(array, "q"))
    places: array[int] = field(default_factory=partial(array, "q"))
    log_times: array[int] = field(default_factory=partial(array, "Q"))

    def add(self, place: int, message: McapMessage) -> None:
        self.content += message.data
        self.ends.append(len(self.content))
        self.places.append(place)
        self.log_times.append(message.log_time)

    def found(self) -> tuple[RecordingPart, int]:
        """The frames, and the number of bytes that belong to no frame."""
        data = np.frombuffer(self.content, dtype=np.uint8)
        frames, holding = find_in_pieces(data, np.array(self.ends), seeds())
        places, times = np.array(self.places), np.array(self.log_times)
        skipped = len(data) - int((frames.end - frames.start).sum())
        return RecordingPart(data, frames, places[holding], times[holding]), skipped


def _json_parts(
    content: bytes, channels: Sequence[Channel], heard: set[FrameSender], progress: Progress
) -> tuple[list[RecordingPart], int, tuple[str, ...]]:
    """The JSON messages of senders not ``heard`` in frames, how many are unknown, and why some were left out."""
    kinds = _own_kinds(channels)
    repeats = {
        channel for channel in channels if channel.encoding in JSON and re.fullmatch("/?mavlink/out", channel.topic)
    }
    topics, own = JsonTopics(), set(kinds.values())
    needed = repeats or any(kind.sender not in heard for kind in own)
    for place, message in enumerate(McapRecording(content).messages(progress) if needed else ()):
        kind = kinds.get(message.channel)
        if message.channel in repeats and (repeated := json_kind(message.data)) not in own:
            kind = repeated
        if kind is not None and kind.sender not in heard:
            topics.add(kind, place, message)
    progress(1.0)
    return list(topics.parts()), topics.unknown.total(), topics.sentences()


def _own_kinds(channels: Sequence[Channel]) -> dict[Channel, JsonTopic]:
    """The channels of one message each. Where both bridges were recorded, BlueOS's alone: it has headers."""
    own = r"/?mavlink/(\d{1,3})/(\d{1,3})/(\w+)"
    topics = {channel: re.fullmatch(own, channel.topic) for channel in channels if channel.encoding in JSON}
    kinds = {
        channel: JsonTopic(FrameSender(int(topic[1]), int(topic[2])), topic[3])
        for channel, topic in topics.items()
        if topic is not None and max(int(topic[1]), int(topic[2])) <= 255
    }
    headed = {kind for channel, kind in kinds.items() if not channel.topic.startswith("/")}
    return {channel: kind for channel, kind in kinds.items() if channel.topic[:1] != "/" or kind not in headed}


def _within(progress: Progress, first: float, last: float) -> Progress:
    return lambda fraction: progress(first + (last - first) * fraction)


def _received(stamps: NDArray[np.uint64]) -> Times:
    """Seconds; NaN without a stamp, or where it is far from its neighbours'."""
    received = np.where(stamps > 0, stamps / 1e6, np.nan)
    rows = np.flatnonzero(stamps)
    if (np.abs(np.diff(received[rows])) > MAX_STAMP_JUMP).any():
        received[rows[far_off(received[rows], STAMP_WINDOW, MAX_STAMP_JUMP)]] = np.nan
    return received


def _nothing_in(path: str | os.PathLike[str], recording: McapRecording, messages: int) -> str:
    if messages:
        what = f"is an MCAP recording of {messages} messages that look like MAVLink, but none matches a dialect "
        return f"{os.fspath(path)} {what}that pymavlink has: it is of another dialect or damaged throughout."
    if flight_topics(recording.channels.values(), recording.schemas):
        what = "is an MCAP recording of ROS 2 topics, not of MAVLink: it can be learnt from, or converted to a table"
        return f"{os.fspath(path)} {what} (.csv), but not to a stream of MAVLink."
    names = {channel.topic for channel in recording.channels.values()}
    if recording.repairs() and any(name.lstrip("/").startswith("mavlink/") for name in names):
        what = f"is an MCAP recording whose MAVLink messages ({listed(names)}) are damaged or cut off"
        return f"{os.fspath(path)} {what}: none can be read. Copy it anew from where it was recorded."
    if names >= {"flight/inputs", "flight/outputs"}:  # of mavdem.export.conversion
        return f"{os.fspath(path)} was written by `mavdem learn` for viewers: name the log of the flight instead."
    contents = f"its topics are {listed(names)}" if names else "nothing in it can be read"
    what = f"is an MCAP recording without MAVLink and without topics of PX4 or MAVROS ({contents}): record mavlink/…,"
    return f"{os.fspath(path)} {what} or in ROS 2 /fmu/out/… or /mavros/…."
