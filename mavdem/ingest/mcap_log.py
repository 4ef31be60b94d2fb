"""MCAP recordings (.mcap): MAVLink as JSON, in the layouts of BlueOS and of another bridge, or as frames; else ROS 2.

MCAP's registry has no MAVLink. In use are the topics ``mavlink/{system}/{component}/{MESSAGE}`` (BlueOS) and the same
with a slash before, both with a JSON body (``mavlink_json``), and ``mavlink/out``, which repeats everything. Frames are
recorded with the message encoding ``mavlink``, or as bytes without a schema. Whoever is heard in frames is read from
them alone: what there is as JSON beside them is the same once more. Topics of ROS 2 (``ros2_log``) are read where there
is no MAVLink.

Source of BlueOS's layout: its recorder, https://github.com/bluerobotics/BlueOS.
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

from mavdem.errors import Unreadable
from mavdem.ingest.census import Census
from mavdem.ingest.compose import Sender
from mavdem.ingest.decode import seeds
from mavdem.ingest.files import file_bytes
from mavdem.ingest.framing import GOOD, MARKER_1, MARKER_2, Frames, Progress, find_in_pieces
from mavdem.ingest.json_topics import JsonTopics, Kind
from mavdem.ingest.log import Log
from mavdem.ingest.mcap_records import Channel, Message, Recording, listed
from mavdem.ingest.part import Part, joined
from mavdem.ingest.receipt import AROUND, FAR
from mavdem.ingest.ros2_topics import flight_topics
from mavdem.ingest.strays import Places, Times, far_off
from mavdem.ingest.stream import Stream
from mavdem.ingest.vehicles import assemble

OWN_TOPIC = re.compile(r"/?mavlink/(\d{1,3})/(\d{1,3})/(\w+)")
REPEATED_TOPIC = re.compile(r"/?mavlink/out")
JSON = frozenset({"json", "json5"})
FRAMES = "mavlink"
"""The message encoding of frames."""
NO_FRAMES = JSON | {"ros1", "cdr", "protobuf", "flatbuffer", "cbor", "msgpack"}
"""Message encodings (https://mcap.dev/spec/registry) of something else, whatever the first byte."""
OF_A_FLIGHT = frozenset({"flight/inputs", "flight/outputs"})
"""Topics of ``mavdem.channels``, whose recordings lie where a log may be meant."""
MARKERS = (bytes([MARKER_1]), bytes([MARKER_2]))


def read_mcap(path: str | os.PathLike[str], progress: Progress | None = None) -> Log:
    """Reads the MAVLink in an MCAP recording, or else the flights in its ROS 2 topics.

    Cut and damaged recordings are read as far as they go.

    Args:
        path: the file.
        progress: called with the fraction done.

    Raises:
        Unreadable: the file cannot be opened, there is neither in it, or there is ROS 2 and nothing to read it with.
    """
    recording = Recording(file_bytes(path))
    stream, seen = _stream(os.fspath(path), recording, progress)
    if stream is None:
        if not flight_topics(recording.channels.values(), recording.schemas):
            raise Unreadable(_nothing_in(path, recording, seen))
        return _of_ros2(os.fspath(path), recording, _within(progress, 0.5, 1.0))
    census = Census(len(stream.data), seeds())
    census.add(stream.frames)
    received = _received(stream.stamps)
    known = received[~np.isnan(received)]
    span = (float(known.min()), float(known.max())) if len(known) else (np.nan, np.nan)

    def at(start: Places) -> Times:
        return received[np.searchsorted(stream.frames.start, start, side="right") - 1]

    return assemble(stream.data, census, at, span, stream.bytes_skipped, stream.source, stream.repairs)


def mcap_stream(path: str | os.PathLike[str], progress: Progress | None = None) -> Stream:
    """The MAVLink in an MCAP recording as frames; those of JSON messages are composed of their values.

    Args:
        path: the file.
        progress: called with the fraction done.

    Raises:
        Unreadable: the file cannot be opened, or there is no MAVLink in it.
    """
    recording = Recording(file_bytes(path))
    stream, seen = _stream(os.fspath(path), recording, progress)
    if stream is None:
        raise Unreadable(_nothing_in(path, recording, seen))
    return stream


def _of_ros2(source: str, recording: Recording, progress: Progress | None) -> Log:
    try:
        from mavdem.ingest.ros2_log import read_ros2
    except ImportError:
        raise Unreadable(
            f'{source} is a ROS 2 recording, which takes another package to read: pip install "mavdem[ros2]".'
        ) from None
    return read_ros2(recording, source, progress)


def _stream(source: str, recording: Recording, progress: Progress | None) -> tuple[Stream | None, int]:
    """The MAVLink in a recording; None, and how many messages looked like it, where there is none."""
    carried: dict[Channel, _Carried | None] = {}
    for place, message in enumerate(recording.messages(_within(progress, 0.0, 0.5))):
        if message.channel not in carried:
            carried[message.channel] = _Carried() if _carries_frames(message) else None
        if (frames := carried[message.channel]) is not None:
            frames.add(place, message)
    found = [frames.found() for frames in carried.values() if frames is not None]
    heard = set().union(*(_speaking(part.frames) for part, _ in found))
    channels = list(recording.channels.values())
    if not heard and not any(channel.encoding in JSON for channel in channels):
        return None, sum(len(part.frames) for part, _ in found)
    json, left_out = _json_parts(recording.content, channels, heard, _within(progress, 0.5, 1.0))
    parts = [*(part for part, _ in found), *json]
    if not any((part.frames.verdict == GOOD).any() for part in parts):
        return None, sum(len(part.frames) for part in parts)
    part = joined(parts)
    stamps = part.log_time // np.uint64(1000)
    repairs = [*recording.damage.sentences(), *left_out]
    if flight_topics(channels, recording.schemas):
        repairs.append("The recording has ROS 2 topics of a flight too; they were not read.")
    skipped = sum(skipped for _, skipped in found)
    return Stream(source, ".mcap", part.data, part.frames, stamps, skipped, tuple(repairs)), len(part.frames)


def _carries_frames(message: Message) -> bool:
    """Whether a channel carries frames, by its first message."""
    channel = message.channel
    if channel.encoding == FRAMES:
        return True
    return channel.schema == 0 and channel.encoding not in NO_FRAMES and message.data[:1] in MARKERS


@dataclass
class _Carried:
    """The frames in a channel's messages, which may hold one each, or several, or a piece."""

    # Not lists: an integer of Python's own takes five times as much, and there may be millions of messages.
    content: bytearray = field(default_factory=bytearray)
    ends: array[int] = field(default_factory=partial(array, "q"))
    places: array[int] = field(default_factory=partial(array, "q"))
    log_times: array[int] = field(default_factory=partial(array, "Q"))

    def add(self, place: int, message: Message) -> None:
        self.content += message.data
        self.ends.append(len(self.content))
        self.places.append(place)
        self.log_times.append(message.log_time)

    def found(self) -> tuple[Part, int]:
        """The frames, and the number of bytes that belong to none."""
        data = np.frombuffer(self.content, dtype=np.uint8)
        frames, holding = find_in_pieces(data, np.array(self.ends), seeds())
        places, times = np.array(self.places), np.array(self.log_times)
        skipped = len(data) - int((frames.end - frames.start).sum())
        return Part(data, frames, places[holding], times[holding]), skipped


def _speaking(frames: Frames) -> set[Sender]:
    ids = (frames.system[frames.verdict == GOOD].tolist(), frames.component[frames.verdict == GOOD].tolist())
    return {Sender(*sender) for sender in zip(*ids, strict=True)}


def _json_parts(
    content: bytes, channels: Sequence[Channel], heard: set[Sender], progress: Progress | None
) -> tuple[list[Part], tuple[str, ...]]:
    """What there is as JSON of senders not ``heard`` in frames, and a sentence for each reason to leave some out."""
    kinds = _own_kinds(channels)
    repeated = {channel for channel in channels if channel.encoding in JSON and REPEATED_TOPIC.fullmatch(channel.topic)}
    if not repeated and all(kind.sender in heard for kind in kinds.values()):
        if progress is not None:
            progress(1.0)
        return [], ()
    topics = JsonTopics(kinds.values(), heard)
    for place, message in enumerate(Recording(content).messages(progress)):
        kind = kinds.get(message.channel)
        if kind is not None:
            topics.add(kind, place, message)
        elif message.channel in repeated:
            topics.add_repeated(place, message)
    parts = list(topics.parts())
    return parts, topics.sentences()


def _own_kinds(channels: Sequence[Channel]) -> dict[Channel, Kind]:
    """The channels of one kind of message each. Where both bridges were recorded, BlueOS's alone: it has headers."""
    kinds = {channel: kind for channel in channels if (kind := _own_kind(channel)) is not None}
    with_headers = {kind for channel, kind in kinds.items() if not channel.topic.startswith("/")}
    return {
        channel: kind for channel, kind in kinds.items() if not (channel.topic.startswith("/") and kind in with_headers)
    }


def _own_kind(channel: Channel) -> Kind | None:
    """What a channel's messages are, by its topic; None where that tells nothing."""
    topic = OWN_TOPIC.fullmatch(channel.topic)
    if topic is None or channel.encoding not in JSON:
        return None
    system, component = int(topic[1]), int(topic[2])
    return Kind(Sender(system, component), topic[3]) if max(system, component) <= 255 else None


def _within(progress: Progress | None, first: float, last: float) -> Progress | None:
    """Progress of a step that goes from one fraction to another."""
    if progress is None:
        return None
    return lambda fraction: progress(first + (last - first) * fraction)


def _received(stamps: NDArray[np.uint64]) -> Times:
    """Seconds; NaN where there is no stamp or it lies far from its neighbours'."""
    received = np.where(stamps > 0, stamps / 1e6, np.nan)
    rows = np.flatnonzero(stamps)
    if (np.abs(np.diff(received[rows])) > FAR).any():
        received[rows[far_off(received[rows], AROUND, FAR)]] = np.nan
    return received


def _nothing_in(path: str | os.PathLike[str], recording: Recording, messages: int) -> str:
    if messages:
        return (
            f"{os.fspath(path)} is an MCAP recording of {messages} messages that look like MAVLink, but none agrees "
            "with a dialect that pymavlink knows: it is of another dialect or damaged throughout."
        )
    if flight_topics(recording.channels.values(), recording.schemas):
        return (
            f"{os.fspath(path)} is an MCAP recording of ROS 2 topics, not of MAVLink: it can be learnt from, or made a "
            "table (.csv), but no stream of MAVLink."
        )
    names = {channel.topic for channel in recording.channels.values()}
    if names >= OF_A_FLIGHT:
        return (
            f"{os.fspath(path)} is what `mavdem learn` wrote of a flight, for viewers: name the log that was learnt "
            "from instead."
        )
    held = f"its topics are {listed(names)}" if names else "nothing in it can be read"
    return (
        f"{os.fspath(path)} holds no MAVLink, as an MCAP recording, and no topics of PX4 or MAVROS ({held}): record "
        "mavlink/…, or in ROS 2 /fmu/out/… or /mavros/…."
    )
