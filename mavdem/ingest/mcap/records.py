"""MCAP files: their messages in the order of the file, also of cut and damaged ones as far as possible; and writing.

The ``mcap`` package reads sound files and stops at the first wrong length. Here every length is checked, a damaged
record is skipped up to the next place where records follow one another, a cut chunk is read up to the cut, and the
unpacked size of the chunks is bounded. No index is needed. Source: https://mcap.dev/spec.

A stream is written as frames, in the channel ``mavlink/raw`` with the message encoding ``mavlink``: one message each,
with the receive stamp as log time. BlueOS's JSON topics, ``mavlink/{system}/{component}/{MESSAGE}``, repeat them for
viewers; numbers that JSON lacks are null there.
"""

from __future__ import annotations

import json
import re
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from itertools import repeat
from math import isfinite
from operator import add
from typing import Any, BinaryIO, NamedTuple

import lz4.frame
import mcap.records
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.writer import Writer
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from mavdem.facts.sources import Repair
from mavdem.ingest.contents import MAX_RATIO
from mavdem.ingest.mavlink.vehicles import FrameStream
from mavdem.ingest.telemetry import Facts, repair

MAGIC = b"\x89MCAP0\r\n"
LAST_OPCODE = max(Opcode)
PRIVATE_OPCODES = 0x80
RECORD_HEAD = struct.Struct("<BQ")  # Opcode and length before each record
# Channel, sequence, log time and publish time before a message's data
MESSAGE_HEAD = struct.Struct("<HIQQ")
_LIKELY_HEAD = re.compile(rb"[\x01-\x%02x](?=.{4}\0{4})" % LAST_OPCODE, re.DOTALL)
"""The opcode of a record, none of which is as long as 4 GiB."""
# First and last time of a chunk, its unpacked size, checksum, and length of the compression's name, before that
CHUNK_HEAD = struct.Struct("<QQQII")
CHUNK_LENGTH = struct.Struct("<Q")  # Of the packed records, before them
CHUNK_BYTES = 1 << 20  # Bytes that are compressed together by default, or unpacked together
MAX_CHUNK_BYTES = 1 << 28  # Unpacked bytes of one chunk
MAX_BYTES = 1 << 24
"""Unpacked bytes of all chunks: so many, plus ``MAX_RATIO`` per byte of the file. JSON packs to a fiftieth. In memory,
the smallest messages take ten times their bytes."""


class Channel(NamedTuple):
    """The ``topic`` of messages, the ``encoding`` of their data, and the number of their ``schema`` (0 for none)."""

    topic: str
    encoding: str
    schema: int


class Schema(NamedTuple):
    """The type of messages, with its definition, ``text``."""

    name: str
    encoding: str
    text: str


class McapMessage(NamedTuple):
    """One message; ``log_time`` is in UNIX ns, and ``sound`` False in a damaged chunk: the bytes may be wrong."""

    channel: Channel
    log_time: int
    data: bytes
    sound: bool


class _Chunk(NamedTuple):
    """Where a chunk's packed records lie in the file, their compression, unpacked size and checksum."""

    start: int
    end: int
    compression: str
    size: int
    checksum: int

    @classmethod
    def at(cls, content: bytes, start: int, stop: int) -> _Chunk | None:
        """The chunk whose record begins at ``start``; None where its head is cut."""
        if start + CHUNK_HEAD.size > stop:
            return None
        _, _, size, checksum, length = CHUNK_HEAD.unpack_from(content, start)
        named = start + CHUNK_HEAD.size + length
        first = named + CHUNK_LENGTH.size
        if first > stop:
            return None
        compression = content[start + CHUNK_HEAD.size : named].decode(errors="replace")
        return cls(
            first, first + CHUNK_LENGTH.unpack_from(content, named)[0], compression, size, checksum
        )


@dataclass
class McapRecording:
    """An MCAP file; ``channels`` and ``schemas`` by their number, as far as it was read.

    ``damaged`` is the number of damaged chunks, ``skipped`` that of bytes of no record, ``cut`` whether the end is.
    """

    content: bytes
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    damaged: int = 0
    skipped: int = 0
    cut: bool = False
    _allowance: int = 0

    def messages(self) -> Iterator[McapMessage]:
        """Every message whose channel is known, in the order of the file."""
        self._allowance = MAX_BYTES + MAX_RATIO * len(self.content)
        first = len(MAGIC) if self.content.startswith(MAGIC) else 0
        records = list(self._records(self.content, first))
        self.cut |= not records or records[-1][0] != Opcode.FOOTER
        # The summary at the end repeats channels and schemas, which helps where the first record is damaged.
        for opcode, start, stop in records:
            if opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
                self._note(opcode, self.content, start, stop)
        # After damage, messages outside of chunks are the rest of a chunk that has lost its checksum.
        sound = not (self.skipped and any(opcode == Opcode.CHUNK for opcode, _, _ in records))
        for opcode, start, stop in records:
            if opcode == Opcode.CHUNK:
                yield from self._in_chunk(start, stop)
            elif opcode == Opcode.MESSAGE:
                message = self._message(self.content, start, stop, sound)
                if message is not None:
                    yield message

    def repairs(self) -> Facts:
        """Each kind of damage."""
        return (
            *repair(Repair.CHUNKS_DAMAGED, count=self.damaged),
            *repair(Repair.BYTES_SKIPPED, count=self.skipped, part="recording"),
            *(repair(Repair.RECORDING_CUT) if self.cut else ()),
        )

    def _records(self, content: bytes, place: int) -> Iterator[tuple[int, int, int]]:
        """Opcode, start and end of the content of each record from ``place`` on; a chunk at the end may be cut."""
        end = len(content)
        while place < end:
            if place + RECORD_HEAD.size <= end:
                opcode, length = RECORD_HEAD.unpack_from(content, place)
                start = place + RECORD_HEAD.size
                stop = place + RECORD_HEAD.size + length
                if stop <= end and (0 < opcode <= LAST_OPCODE or opcode >= PRIVATE_OPCODES):
                    yield opcode, start, stop
                    place = stop
                    continue
                # A chunk whose two lengths agree extends beyond the end of the file.
                cut = _Chunk.at(content, start, end) if opcode == Opcode.CHUNK else None
                if cut is not None and cut.end == stop:
                    self.cut = True
                    yield opcode, start, end
                    return
            if content.startswith(MAGIC, place):
                place += len(MAGIC)
                continue
            following = _next_record(content, place + 1)
            if following < end or content is not self.content:
                self.skipped += following - place
            else:
                self.cut = True
            place = following

    def _in_chunk(self, start: int, stop: int) -> Iterator[McapMessage]:
        chunk = _Chunk.at(self.content, start, stop)
        if chunk is None:
            return
        cut = self.cut and stop == len(self.content) < chunk.end
        most = min(self._allowance, MAX_CHUNK_BYTES)
        packed = self.content[chunk.start : min(chunk.end, stop)]
        records = _unpacked(chunk.compression, packed, most)
        self._allowance -= len(records)
        whole = len(records) == chunk.size and chunk.checksum in (0, zlib.crc32(records))
        sound = cut or whole
        self.damaged += not sound
        for opcode, inner, end in self._records(records, 0):
            if opcode == Opcode.MESSAGE:
                message = self._message(records, inner, end, sound)
                if message is not None:
                    yield message
            elif opcode == Opcode.CHANNEL or (opcode == Opcode.SCHEMA and sound):
                # One wrong letter in a schema makes every message of a sound chunk wrong.
                self._note(opcode, records, inner, end)

    def _message(self, content: bytes, start: int, stop: int, sound: bool) -> McapMessage | None:
        if start + MESSAGE_HEAD.size > stop:
            return None
        number, _, log_time, _ = MESSAGE_HEAD.unpack_from(content, start)
        if number not in self.channels:
            return None
        return McapMessage(
            self.channels[number], log_time, content[start + MESSAGE_HEAD.size : stop], sound
        )

    def _note(self, opcode: int, content: bytes, start: int, stop: int) -> None:
        """Keeps a channel or a schema, if its record is whole."""
        stream = ReadDataStream(BytesIO(content[start:stop]))
        with suppress(McapError, struct.error, ValueError):
            if opcode == Opcode.CHANNEL:
                one = mcap.records.Channel.read(stream)
                self.channels[one.id] = Channel(one.topic, one.message_encoding, one.schema_id)
            else:
                kind = mcap.records.Schema.read(stream)
                text = kind.data.decode("utf-8", errors="replace")
                self.schemas[kind.id] = Schema(kind.name, kind.encoding, text)


def _next_record(content: bytes, place: int) -> int:
    """The first place from ``place`` on where records follow one another; the end without one."""
    likely = (found.start() for found in _LIKELY_HEAD.finditer(content, place))
    return next((at for at in likely if _follow_one_another(content, at)), len(content))


def _follow_one_another(content: bytes, place: int) -> bool:
    """Whether three records follow one another at a place, or fewer up to the end."""
    for _ in range(3):
        if place == len(content) or content.startswith(MAGIC, place):
            return True
        if place + RECORD_HEAD.size > len(content):
            return False
        opcode, length = RECORD_HEAD.unpack_from(content, place)
        if not 0 < opcode <= LAST_OPCODE:
            return False
        place += RECORD_HEAD.size + length
    return place <= len(content)


def _unpacked(compression: str, packed: bytes, most: int) -> bytes:
    """The records of a chunk as far as they can be unpacked, and ``most`` of their bytes."""
    records = bytearray()
    opened: dict[str, Callable[[bytes], Any]] = {
        "": BytesIO,
        "lz4": _lz4,
        "zstd": zstandard.ZstdDecompressor().stream_reader,
    }
    if compression in opened:
        reader = opened[compression](packed)
        # RuntimeError: from lz4; EOFError: it is cut
        with suppress(zstandard.ZstdError, RuntimeError, EOFError, MemoryError):
            while piece := reader.read(min(CHUNK_BYTES, most - len(records))):
                records += piece
    return bytes(records)


def _lz4(packed: bytes) -> Any:
    return lz4.frame.open(BytesIO(packed))


MAX_STAMP = 2**64 // 1000 - 1
"""The last receive stamp, µs, that 64 bits of nanoseconds hold: the year 2554."""
HEADER_FIELDS = ("system_id", "component_id", "sequence", "message_id")
# Times (T,), s, and columns (T,) by name
Series = tuple[NDArray[np.float64], Mapping[str, NDArray[np.float64]]]


def write_mcap(file: BinaryIO, stream: FrameStream) -> int:
    """Writes every frame with its stamp, and the dialect's messages as JSON; returns the number of frames.

    A stamp beyond the year 2554, which MCAP cannot hold, becomes that of the frame before.
    """
    writer = started(file)
    raw = raw_channel(writer)
    channels: dict[str, int] = {}
    parser = dialect.MAVLink(None)
    last = count = 0
    for stamp, frame in stream.stamped_frames():
        last = stamp if stamp <= MAX_STAMP else last
        write_message(writer, raw, last * 1000, frame)
        count += 1
        with suppress(dialect.MAVError):  # the message of another dialect, or damaged
            message = parser.decode(bytearray(frame))
            who = message.get_srcSystem(), message.get_srcComponent()
            topic = "/".join(("mavlink", *map(str, who), message.get_type()))
            if topic not in channels:
                channels[topic] = _registered(writer, topic, _schema(type(message)))
            numbers = zip(HEADER_FIELDS, (*who, message.get_seq(), message.id), strict=True)
            fields = {_key(name): _plain(getattr(message, name)) for name in message.fieldnames}
            body = {"header": dict(numbers), "message": {"type": message.get_type(), **fields}}
            write_message(writer, channels[topic], last * 1000, json.dumps(body).encode())
    writer.finish()  # type: ignore[no-untyped-call]
    return count


def write_series(file: BinaryIO, series: Mapping[str, Series]) -> None:
    """Writes columns over time, s from 0 on, by topic as JSON, one message a row; a value not finite becomes null."""
    writer = started(file)
    queue: list[tuple[float, int, str]] = []
    for topic, (time, named) in series.items():
        channel = _registered(writer, topic, _object({name: {"type": "number"} for name in named}))
        # A column is encoded as a whole: the file takes a third less time than with a call for each row.
        columns = [
            json.dumps(_plain(column.tolist()))[1:-1].split(", ") for column in named.values()
        ]
        keys = [json.dumps(name) + ": " for name in named]
        rows = ("{" + ", ".join(map(add, keys, row)) + "}" for row in zip(*columns, strict=True))
        queue += zip(time.tolist(), repeat(channel), rows)
    for at, channel, body in sorted(queue, key=lambda entry: entry[0]):
        write_message(writer, channel, round(at * 1e9), body.encode())
    writer.finish()  # type: ignore[no-untyped-call]


def started(file: BinaryIO, chunk: int = CHUNK_BYTES) -> Writer:
    """Returns a writer of messages in chunks of ``chunk`` bytes; ``finish`` ends it."""
    writer = Writer(file, chunk_size=chunk)
    writer.start(library="mavdem")
    return writer


def raw_channel(writer: Writer) -> int:
    """Returns a new channel of frames."""
    return writer.register_channel("mavlink/raw", "mavlink", schema_id=0)


def write_message(writer: Writer, channel: int, time: int, data: bytes) -> None:
    """Writes a message of a channel, at a time in ns."""
    writer.add_message(channel, log_time=time, data=data, publish_time=time)


def _registered(writer: Writer, topic: str, schema: Mapping[str, Any]) -> int:
    """A new JSON channel; a viewer plots the fields in its schema."""
    number = writer.register_schema(
        topic.replace("/", "."), "jsonschema", json.dumps(schema).encode()
    )
    return writer.register_channel(topic, "json", number)


def _key(name: str) -> str:
    """A field's name in BlueOS's JSON, where ``type`` is the message's."""
    return "mavtype" if name == "type" else name


def _plain(value: Any) -> Any:
    """A value as JSON has it: null for a number that is not finite."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def _schema(message: Any) -> dict[str, Any]:
    header = _object({name: {"type": "integer"} for name in HEADER_FIELDS})
    fields = {}
    for name, count in zip(message.ordered_fieldnames, message.array_lengths, strict=True):
        kind = message.fieldtypes[message.fieldnames.index(name)]
        array = {"type": "array", "items": {"type": "number"}}
        single = {"type": "string" if kind == "char" else "number"}
        fields[_key(name)] = array if count and kind != "char" else single
    return _object({"header": header, "message": _object({"type": {"type": "string"}, **fields})})


def _object(properties: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": dict(properties)}
