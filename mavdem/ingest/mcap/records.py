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
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from itertools import repeat
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

from mavdem.facts import Fact
from mavdem.facts.sources import Repair
from mavdem.ingest.contents import MAX_RATIO
from mavdem.ingest.mavlink.definitions import MessageDefinition, columns, definitions
from mavdem.ingest.mavlink.framing import GOOD, Bytes, Progress, no_progress
from mavdem.ingest.mavlink.vehicles import FrameStream
from mavdem.ingest.telemetry import repair

MAGIC = b"\x89MCAP0\r\n"
LAST_OPCODE = max(Opcode)
PRIVATE_OPCODES = 0x80
RECORD_HEAD = struct.Struct("<BQ")  # Opcode and length before each record
# Channel, sequence, log time and publish time before a message's data
MESSAGE_HEAD = struct.Struct("<HIQQ")
MAX_CHUNK_HEAD = 1 << 10  # Bytes before a chunk's records
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
        stream = ReadDataStream(BytesIO(content[start : min(stop, start + MAX_CHUNK_HEAD)]))
        try:
            stream.read(16)  # its first and its last time
            size, checksum = stream.read8(), stream.read4()
            compression, length = stream.read_prefixed_string(), stream.read8()
        except (McapError, struct.error, ValueError):
            return None
        first = start + stream.count
        return cls(first, first + length, compression, size, checksum)


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

    def messages(self, progress: Progress = no_progress) -> Iterator[McapMessage]:
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
                progress(stop / len(self.content))
            elif opcode == Opcode.MESSAGE:
                message = self._message(self.content, start, stop, sound)
                if message is not None:
                    yield message
        progress(1.0)

    def repairs(self) -> tuple[Fact, ...]:
        """Each kind of damage."""
        return (
            *repair(Repair.CHUNKS_DAMAGED, count=self.damaged),
            *repair(Repair.BYTES_SKIPPED, count=self.skipped, part="recording"),
            *(repair(Repair.RECORDING_CUT) if self.cut else ()),
        )

    def _records(self, content: bytes, place: int) -> Iterator[tuple[int, int, int]]:
        """Opcode, start and end of the content of each record from ``place`` on; a chunk at the end may be cut."""
        end = len(content)
        data = np.frombuffer(content, dtype=np.uint8)
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
            following = _next_record(content, data, place + 1)
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
        records, whole = _unpacked(
            chunk.compression, self.content[chunk.start : min(chunk.end, stop)], most
        )
        self._allowance -= len(records)
        sound = cut or (
            whole and len(records) == chunk.size and chunk.checksum in (0, zlib.crc32(records))
        )
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


def _next_record(content: bytes, data: Bytes, place: int) -> int:
    """The first place from ``place`` on where records follow one another; the end without one."""
    search = 1 << 12  # bytes, doubled each time, so that the cost is that of the skipped bytes
    last = len(content) - RECORD_HEAD.size
    while place <= last:
        stop = min(place + search, last + 1)
        opcodes = data[place:stop]
        likely = place + np.flatnonzero((opcodes > 0) & (opcodes <= LAST_OPCODE))
        for high in range(5, 9):  # no record is as long as 4 GiB
            likely = likely[data[likely + high] == 0]
        for candidate in likely.tolist():
            if _follow_one_another(content, candidate):
                return candidate
        place = stop
        search = 2 * search
    return len(content)


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


def _unpacked(compression: str, packed: bytes, most: int) -> tuple[bytes, bool]:
    """The records of a chunk as far as they can be unpacked, and whether they are whole; ``most`` of their bytes."""
    records = bytearray()
    whole = compression in ("", "zstd", "lz4")
    with suppress(zstandard.ZstdError, RuntimeError, MemoryError):  # RuntimeError: from lz4
        for piece in _pieces(compression, packed):
            if len(records) + len(piece) > most:
                break
            records += piece
        else:
            return bytes(records), whole
    return bytes(records), False


def _pieces(compression: str, packed: bytes) -> Iterator[bytes]:
    if compression == "":
        yield packed
    elif compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as reader:
            while piece := reader.read(CHUNK_BYTES):
                yield piece
    elif compression == "lz4":
        unpacker = lz4.frame.LZ4FrameDecompressor()
        piece = unpacker.decompress(packed, max_length=CHUNK_BYTES)
        while piece:
            yield piece
            piece = b"" if unpacker.eof else unpacker.decompress(b"", max_length=CHUNK_BYTES)


HEADER_FIELDS = ("system_id", "component_id", "sequence", "message_id")
BATCH = (
    1 << 12
)  # Messages of JSON that are held at a time: parsed, they take ten times the memory of their payloads
# The last receive stamp, µs, that 64 bits of nanoseconds hold: the year 2554
MAX_STAMP = 2**64 // 1000 - 1
# Times (T,), s, and columns (T,) by name
Series = tuple[NDArray[np.float64], Mapping[str, NDArray[np.float64]]]


def write_mcap(file: BinaryIO, stream: FrameStream) -> int:
    """Writes every frame with its stamp, and the dialect's messages as JSON; returns the number of frames.

    A stamp beyond the year 2554, which MCAP cannot hold, becomes that of the frame before.
    """
    writer = started(file)
    raw = raw_channel(writer)
    channels: dict[str, int] = {}
    frames = stream.stamped_frames()
    rows = np.flatnonzero(stream.frames.end > stream.frames.start)
    last = 0
    for begin in range(0, len(rows), BATCH):
        batch = rows[begin : begin + BATCH]
        for row, (topic, body) in zip(batch.tolist(), _bodies(stream, batch), strict=True):
            stamp, frame = next(frames)
            last = stamp if stamp <= MAX_STAMP else last
            write_message(writer, raw, last * 1000, frame)
            if topic is not None:
                if topic not in channels:
                    channels[topic] = _registered(writer, topic, _schema(stream, row))
                write_message(writer, channels[topic], last * 1000, json.dumps(body).encode())
    writer.finish()  # type: ignore[no-untyped-call]
    return len(rows)


def write_series(file: BinaryIO, series: Mapping[str, Series]) -> None:
    """Writes columns over time, s from 0 on, by topic as JSON, one message a row; a value not finite becomes null."""
    writer = started(file)
    queue: list[tuple[float, int, str]] = []
    for topic, (time, named) in series.items():
        channel = _registered(writer, topic, _object({name: {"type": "number"} for name in named}))
        # A column's numbers become text together; a row only puts them in their places.
        row = "{" + ", ".join(json.dumps(name).replace("%", "%%") + ": %s" for name in named) + "}"
        texts = [json.dumps(_numbers(column))[1:-1].split(", ") for column in named.values()]
        queue += zip(time.tolist(), repeat(channel), map(row.__mod__, zip(*texts, strict=True)))
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


def _bodies(
    stream: FrameStream, rows: NDArray[np.int64]
) -> list[tuple[str | None, dict[str, Any]]]:
    frames = stream.frames[rows]
    bodies: list[tuple[str | None, dict[str, Any]]] = [(None, {})] * len(rows)
    for message_id in np.unique(frames.message_id[frames.verdict == GOOD]).tolist():
        definition = definitions()[message_id]
        same = np.flatnonzero((frames.message_id == message_id) & (frames.verdict == GOOD))
        values = columns(stream.data, frames.start[same], definition)
        values_by_row = zip(
            *(_values(values[name], definition, name) for name in definition.fields), strict=True
        )
        keys = [_key(name) for name in definition.fields]
        for at, row in zip(same.tolist(), values_by_row, strict=True):
            system, component, sequence = (
                int(n[at]) for n in (frames.system, frames.component, frames.sequence)
            )
            header = dict(
                zip(HEADER_FIELDS, (system, component, sequence, message_id), strict=True)
            )
            message = {"type": definition.name, **dict(zip(keys, row, strict=True))}
            bodies[at] = (
                f"mavlink/{system}/{component}/{definition.name}",
                {"header": header, "message": message},
            )
    return bodies


def _key(name: str) -> str:
    """A field's name in BlueOS's JSON, where ``type`` is the message's."""
    return "mavtype" if name == "type" else name


def _values(column: NDArray[Any], definition: MessageDefinition, name: str) -> list[Any]:
    if column.dtype.kind == "S":
        return [value.decode("utf-8", errors="replace") for value in column.tolist()]
    if column.dtype.kind == "f":
        return _numbers(column)
    entries = _entries(definition, name) if column.ndim == 1 else {}
    listed = column.tolist()
    return (
        [{"type": entries[value]} if value in entries else value for value in listed]
        if entries
        else listed
    )


def _entries(definition: MessageDefinition, name: str) -> dict[int, str]:
    """The names of the values of an enum field; empty for a bitmask and for other fields."""
    message = dialect.mavlink_map[definition.message_id]
    enum = message.fieldenums_by_name.get(name)
    if enum is None or message.fielddisplays_by_name.get(name) == "bitmask":
        return {}
    return {
        value: entry.name
        for value, entry in dialect.enums[enum].items()
        if not entry.name.endswith("_ENUM_END")
    }


def _numbers(column: NDArray[Any]) -> list[Any]:
    """Floats in the fewest digits that are exact in their own width; None for a value that is not finite."""
    if column.ndim > 1:
        return [_numbers(row) for row in column]
    digits = column.astype("U32").tolist() if column.dtype.itemsize == 4 else column.tolist()
    return [
        float(text) if good else None
        for text, good in zip(digits, np.isfinite(column).tolist(), strict=True)
    ]


def _schema(stream: FrameStream, row: int) -> dict[str, Any]:
    definition = definitions()[int(stream.frames.message_id[row])]
    header = _object({name: {"type": "integer"} for name in HEADER_FIELDS})
    fields = {_key(name): _field_schema(definition, name) for name in definition.fields}
    return _object({"header": header, "message": _object({"type": {"type": "string"}, **fields})})


def _field_schema(definition: MessageDefinition, name: str) -> dict[str, Any]:
    kind = definition.wire[name]
    if kind.kind == "S":
        return {"type": "string"}
    if kind.subdtype is not None:
        return {"type": "array", "items": {"type": "number"}}
    return (
        _object({"type": {"type": "string"}}) if _entries(definition, name) else {"type": "number"}
    )


def _object(properties: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": dict(properties)}
