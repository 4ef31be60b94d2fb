"""MCAP recordings (.mcap): MAVLink as JSON, in the layouts of BlueOS and of another bridge, or as frames; else ROS 2.

MCAP's registry has no MAVLink. In use are the topics ``mavlink/{system}/{component}/{MESSAGE}`` (BlueOS) and the same
after a slash, both with a JSON body, and ``mavlink/out``, which repeats everything and is not read. Frames are
recorded with the message encoding ``mavlink``, or as bytes without a schema. A sender with frames is read from them
alone: its JSON messages are the same again. Topics of ROS 2 (``ros2.log``) are read where there is no MAVLink. Source
of BlueOS's layout: its recorder, https://github.com/bluerobotics/BlueOS.

JSON has two layouts: the fields at top level, or BlueOS's ``{"header": {"system_id", "component_id", "sequence",
"message_id"}, "message": {"type": "ATTITUDE", ...fields}}``, where a field called ``type`` is ``mavtype``, an enum's
value is ``{"type": "MAV_TYPE_QUADROTOR"}``, a bitmask ``{"bits": 81}`` or ``"A | B"``, and a text an array of its
characters. Numbers are those of JSON5; plain JSON has null for NaN. Source: the JSON of rust-mavlink
(https://github.com/mavlink/rust-mavlink, ``serde`` feature), which BlueOS records.
"""

import json
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache, lru_cache, reduce
from math import nan
from operator import or_
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Channel
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from mavdem.errors import Unreadable
from mavdem.extras import require_extra
from mavdem.facts import Fact, Facts
from mavdem.facts.sources import Flaw, Repair, Source
from mavdem.files import PathName
from mavdem.ingest.contents import file_bytes
from mavdem.ingest.mavlink.definitions import (
    FrameSender,
    MessageDefinition,
    crc_extra_table,
    definitions_by_name,
    encode_frame,
)
from mavdem.ingest.mavlink.framing import (
    CHECKSUM_MATCHES,
    MARKERS,
    find_frames,
)
from mavdem.ingest.mavlink.vehicles import FrameStream, RecordingPart, assemble, joined_parts
from mavdem.ingest.mcap.records import McapRecording
from mavdem.ingest.ros2.log import flight_topics, read_ros2
from mavdem.ingest.telemetry import Log, repair_facts

JSON = frozenset({"json", "json5"})
NO_FRAMES = JSON | {"ros1", "cdr", "protobuf", "flatbuffer", "cbor", "msgpack"}
"""Message encodings (https://mcap.dev/spec/registry) that are not of frames, whatever the first byte."""


def read_mcap(path: PathName) -> Log:
    """Reads the MAVLink in an MCAP recording, or else the flights in its ROS 2 topics, also where it is damaged.

    Raises Unreadable: it cannot be opened or contains neither; MissingExtra: the reader of ROS 2 is not installed.
    """
    source = os.fspath(path)
    recording = McapRecording(file_bytes(path))
    try:
        stream = _stream(source, recording)
    except Unreadable:
        if not flight_topics(recording):
            raise
        require_extra("ros2", source)
        return read_ros2(recording, source)
    return assemble(stream)


def mcap_stream(path: PathName) -> FrameStream:
    """Returns the MAVLink of an MCAP recording, JSON too, as frames; raises ``Unreadable``: no file, or none in it."""
    return _stream(os.fspath(path), McapRecording(file_bytes(path)))


class _Piece(NamedTuple):
    """What a message of a recording holds of a stream of frames: a frame, several, or a part of one."""

    place: int
    log_time: int
    data: bytes


def _stream(source: str, recording: McapRecording) -> FrameStream:
    """The MAVLink in a recording; raises Unreadable: there is none."""
    carried: dict[int, list[_Piece] | None] = {}
    for position, message in enumerate(recording.messages()):
        number = message.channel_id
        if number not in carried:
            carries_frames = _carries_frames(recording.channels[number], message.data)
            carried[number] = [] if carries_frames else None
        if (pieces := carried[number]) is not None:
            pieces.append(_Piece(position, message.log_time, message.data))
    parts = [_part(pieces) for pieces in carried.values() if pieces is not None]
    skipped = sum(len(part.data) - int(part.frames.size.sum()) for part in parts)
    heard = set()
    for part in parts:
        good = part.frames[part.frames.checksum == CHECKSUM_MATCHES]
        heard |= set(map(FrameSender, good.system.tolist(), good.component.tolist()))
    topics = _json_topics(recording)
    own = {number: topic for number, topic in topics.items() if topic.sender not in heard}
    repairs = recording.repairs()
    unread = 0
    if own:
        written, unread, left_out = _json_part(recording.content, own)
        parts.append(written)
        repairs += left_out
    if not any((part.frames.checksum == CHECKSUM_MATCHES).any() for part in parts):
        like = unread + sum(len(part.frames) for part in parts)
        raise Unreadable(_nothing_in(source, recording, like))
    part = joined_parts(parts)
    stamps = part.log_time // np.uint64(1000)
    if flight_topics(recording):
        repairs += repair_facts(Repair.TOPICS_NOT_READ, name="ros2")
    return FrameStream(source, ".mcap", part.data, part.frames, stamps, skipped, repairs)


def _carries_frames(channel: Channel, data: bytes) -> bool:
    is_bare = channel.schema_id == 0 and channel.message_encoding not in NO_FRAMES
    return channel.message_encoding == "mavlink" or (is_bare and data.startswith(MARKERS))


def _part(pieces: Sequence[_Piece]) -> RecordingPart:
    data = np.frombuffer(b"".join(piece.data for piece in pieces), dtype=np.uint8)
    ends = np.cumsum([len(piece.data) for piece in pieces], dtype=np.int64)
    frames = find_frames(data, crc_extra_table())
    holding = np.searchsorted(ends, frames.start, side="right")
    places = np.array([piece.place for piece in pieces], dtype=np.int64)
    times = np.array([piece.log_time for piece in pieces], dtype=np.uint64)
    return RecordingPart(data, frames, places[holding], times[holding])


class JsonTopic(NamedTuple):
    """A message's ``name`` and its sender."""

    sender: FrameSender
    name: str


def _json_topics(recording: McapRecording) -> dict[int, JsonTopic]:
    """The channels of one message each. Where both bridges were recorded, BlueOS's alone: it has headers."""
    topics = {}
    names = {channel.topic for channel in recording.channels.values()}
    for number, channel in recording.channels.items():
        topic = re.fullmatch(r"/?mavlink/(\d{1,3})/(\d{1,3})/(\w+)", channel.topic)
        repeats = channel.topic.startswith("/") and channel.topic[1:] in names
        if topic is not None and channel.message_encoding in JSON and not repeats:
            ids = int(topic[1]), int(topic[2])
            if max(ids) <= 255:
                topics[number] = JsonTopic(FrameSender(*ids), topic[3])
    return topics


def _json_part(content: bytes, topics: Mapping[int, JsonTopic]) -> tuple[RecordingPart, int, Facts]:
    """The JSON messages of these topics as frames, how many are none, and why."""
    written = []
    last: dict[FrameSender, int] = {}
    unknown: Counter[str] = Counter()
    wrong: Counter[str] = Counter()
    recording = McapRecording(content)
    for position, message in enumerate(recording.messages()):
        if message.channel_id not in topics:
            continue
        sender, name = topics[message.channel_id]
        definition = definitions_by_name().get(name)
        if definition is None:
            unknown[name] += 1
            continue
        payload, number = read_body(message.data, definition)
        # Without a number in its header, a message shows no loss.
        last[sender] = (last.get(sender, -1) + 1) % 256 if number is None else number
        if payload is None:
            wrong[recording.channels[message.channel_id].topic] += 1
        else:
            frame = encode_frame(payload, definition, sender, last[sender])
            written.append(_Piece(position, message.log_time, frame))
    names = [name for name, _ in unknown.most_common(5)]
    more = len(unknown) - len(names)
    left_out = (
        *repair_facts(
            Repair.LOGGED_MESSAGES_LEFT_OUT,
            count=wrong.total(),
            flaw=Flaw.UNDECODABLE,
            names=sorted(wrong),
        ),
        *repair_facts(Repair.JSON_OF_NO_DIALECT, count=unknown.total(), names=names, more=more),
    )
    return _part(written), unknown.total() + wrong.total(), left_out


def _nothing_in(source: str, recording: McapRecording, messages: int) -> Fact:
    """Why no MAVLink is in a recording, in which so many messages look like it."""
    if messages:
        return Fact(Source.DIALECT_UNKNOWN, path=source, count=messages, recording=True)
    names = {channel.topic for channel in recording.channels.values()}
    code = Source.MCAP_WITHOUT_FLIGHT
    if flight_topics(recording):
        code = Source.MCAP_OF_ROS2
    elif recording.repairs() and any(name.lstrip("/").startswith("mavlink/") for name in names):
        code = Source.MCAP_DAMAGED
    elif names >= {"flight/inputs", "flight/outputs"}:  # of mavdem.export.mcap_channels
        code = Source.MCAP_OF_MAVDEM
    return Fact(code, path=source, names=sorted(names))


_PARSER = json.JSONDecoder(strict=False)  # texts may contain control characters


def read_body(body: bytes, definition: MessageDefinition) -> tuple[bytes | None, int | None]:
    """Returns the payload of the message in a body of either layout, and its sequence number; None without them.

    It has one where it has the message's name and all values have the right type. A missing field is zero, or NaN
    where it is a float. A parameter of value NaN becomes a float.
    """
    message = _document(body)
    number = None
    if isinstance(message, dict) and isinstance(message.get("message"), dict):
        header = message.get("header")
        sent = header.get("sequence") if isinstance(header, dict) else None
        number = sent if type(sent) is int and 0 <= sent <= 255 else None
        message = message["message"]
        if message.pop("type", definition.name) != definition.name:
            return None, number
        if "mavtype" in message:
            message["type"] = message["mavtype"]
    if not isinstance(message, dict) or message.keys().isdisjoint(definition.fields):
        return None, number
    made = _unsent(definition).copy()
    try:
        with np.errstate(over="raise", invalid="ignore"):
            for name in message.keys() & set(definition.fields):
                made[name] = _value(message[name], definition.wire[name], made[name][0].tolist())
    except (TypeError, ValueError, ArithmeticError):
        return None, number
    if definition.name == "PARAM_VALUE" and np.isnan(made["param_value"][0]):
        # PX4 sends an integer as the bits of a float. JSON has one NaN only, so the bits are lost.
        made["param_type"] = dialect.MAV_PARAM_TYPE_REAL32
    return made.tobytes(), number


@lru_cache(maxsize=1 << 10)
def _unsent(definition: MessageDefinition) -> NDArray[Any]:
    """The message without any of its fields: zeros, and NaN where it has floats."""
    made = np.zeros(1, dtype=definition.wire)
    for name in definition.fields:
        if definition.wire[name].base.kind == "f":
            made[name] = nan
    return made


def _document(body: bytes) -> Any:
    try:
        return _PARSER.decode(body.decode("utf-8", errors="replace"))
    except (ValueError, RecursionError):
        # Rust prints an infinity so, instead of JSON5's Infinity.
        repaired = re.sub(rb"(?<=[:,\[])\s*(-?)inf(?=\s*[,\]}])", rb"\1Infinity", body)
        return None if repaired == body else _document(repaired)


@cache
def _enum_values() -> Mapping[str, int]:
    return {entry.name: value for enum in dialect.enums.values() for value, entry in enum.items()}


def _value(value: Any, kind: np.dtype[Any], absent: Any) -> Any:
    """A field's value; ``absent`` is that of a field, or of the items of an array, that were not sent."""
    if kind.kind == "S":
        text = _text(value)
        if len(text.rstrip(b"\0")) > kind.itemsize:
            raise ValueError
        return text[: kind.itemsize]
    if kind.subdtype is None:
        return _number(value, kind)
    if not isinstance(value, list) or len(value) > len(absent):
        raise ValueError
    return [*(_number(item, kind.base) for item in value), *absent[len(value) :]]


def _number(value: Any, kind: np.dtype[Any]) -> float:
    """A value as a number: itself, an entry of an enum, or a bitmask."""
    if isinstance(value, dict):
        value = value.get("type", value.get("bits"))
    if isinstance(value, str):
        value = _flags(value)
    if kind.kind == "f":
        return nan if value is None else float(value)
    if value != int(value):
        raise ValueError
    return int(value)


def _flags(text: str) -> float:
    """The bits of names joined with |, or the value of a single name; names may also be numbers, also in quotes."""
    try:
        names = filter(None, map(str.strip, text.split("|")))
        values = [
            _enum_values()[name] if name in _enum_values() else int(name, 0) for name in names
        ]
        return reduce(or_, values, 0)
    except ValueError:
        return float(text)  # in quotes, as NaN is in JSON without JSON5


def _text(value: Any) -> bytes:
    """A text's bytes; in JSON it is a string, or an array of its characters or of their codes, a byte each."""
    if value is None:
        return b""
    if isinstance(value, str):
        return value.encode("utf-8", errors="replace")
    codes = value if isinstance(value, list) else [value]
    # A character of an array is one byte.
    return bytes(ord(code) if isinstance(code, str) else code for code in codes)
