"""MCAP files: their messages in the order of the file, also of cut and damaged ones as far as possible; and writing.

The ``mcap`` package decodes records; it stops at the first wrong length. Here damage is skipped up to the next place
where records follow one another, a damaged or cut chunk is left out, and the unpacked size of the chunks is bounded. No
index is needed. Source: https://mcap.dev/spec.

A stream is written as frames, in the channel ``mavlink/raw`` with the message encoding ``mavlink``: one message each,
with the receive stamp as log time. BlueOS's JSON topics, ``mavlink/{system}/{component}/{MESSAGE}``, repeat them for
viewers; numbers that JSON lacks are null there.
"""

import json
import re
import struct
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from io import BytesIO
from itertools import repeat
from math import isfinite
from operator import itemgetter
from typing import Any, BinaryIO

import lz4.frame
import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer
from pymavlink.dialects.v20 import all as dialect

from mavdem.arrays import Array
from mavdem.containers import JsonValues
from mavdem.facts import Facts
from mavdem.facts.sources import Repair
from mavdem.ingest.contents import MAX_COMPRESSION_RATIO, MIN_UNPACKED_LIMIT
from mavdem.ingest.mavlink.vehicles import FrameStream
from mavdem.ingest.telemetry import repair_facts
from mavdem.log_formats import FORMAT_SIGNATURES, Format

MAGIC = FORMAT_SIGNATURES[Format.MCAP].first_bytes
READ = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK)
RECORD_HEAD = struct.Struct("<BQ")  # Opcode and length before each record
_LIKELY_HEAD = re.compile(rb"[\x01-\x%02x](?=.{4}\0{4})" % max(Opcode), re.DOTALL)
"""The opcode of a record, none of which is as long as 4 GiB."""
CHUNK_BYTES = 1 << 20  # Bytes that are compressed together by default, or unpacked together


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

    def messages(self) -> Iterator[Message]:
        """Yields every message whose channel is known, in the order of the file; of damaged chunks none."""
        self._allowance = MIN_UNPACKED_LIMIT + MAX_COMPRESSION_RATIO * len(self.content)
        places = list(self._records())
        # The summary at the end repeats channels and schemas, which helps where the first record is damaged.
        for opcode, start, stop in places:
            if opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
                self._note(self._read(start, stop))
        for record in self._whole_records(places):
            self._note(record)
            if isinstance(record, Message) and record.channel_id in self.channels:
                yield record

    def repairs(self) -> Facts:
        """Returns each kind of damage."""
        return (
            *repair_facts(Repair.CHUNKS_DAMAGED, count=self.damaged),
            *repair_facts(Repair.BYTES_SKIPPED, count=self.skipped, part="recording"),
            *(repair_facts(Repair.RECORDING_CUT) if self.cut else ()),
        )

    def _records(self) -> Iterator[tuple[int, int, int]]:
        """Opcode, start and end of the content of each record that is ``READ``."""
        end = len(self.content)
        offset = opcode = 0
        while offset < end:
            stop = _record_end(self.content, offset)
            if self.content.startswith(MAGIC, offset):
                offset += len(MAGIC)
            elif stop:
                opcode = self.content[offset]
                if opcode in READ:
                    yield opcode, offset + RECORD_HEAD.size, stop
                offset = stop
            else:
                following = _next_record(self.content, offset + 1)
                self.skipped += following - offset if following < end else 0
                offset = following
        self.cut = opcode != Opcode.FOOTER

    def _read(self, start: int, stop: int) -> McapRecord | None:
        """The record with this content; None where it is damaged."""
        content = BytesIO(self.content[start - RECORD_HEAD.size : stop])
        with suppress(*DAMAGE):
            return next(StreamReader(content, skip_magic=True, emit_chunks=True).records)
        return None

    def _whole_records(self, places: list[tuple[int, int, int]]) -> Iterator[McapRecord | None]:
        is_chunked = any(opcode == Opcode.CHUNK for opcode, *_ in places)
        for opcode, start, stop in places:
            if opcode == Opcode.CHUNK:
                yield from self._in_chunk(start, stop)
            # After damage, messages outside of chunks are the rest of a chunk that has lost its checksum.
            elif opcode != Opcode.MESSAGE or not is_chunked:
                yield self._read(start, stop)

    def _in_chunk(self, start: int, stop: int) -> list[McapRecord]:
        """The records of a chunk; none where it is damaged."""
        chunk = self._read(start, stop)
        if isinstance(chunk, Chunk):
            most = min(self._allowance, MIN_UNPACKED_LIMIT)
            records = _unpacked(chunk.compression, chunk.data, most)
            self._allowance -= len(records)
            plain = replace(chunk, compression="", data=records)
            with suppress(*DAMAGE):
                if len(records) == chunk.uncompressed_size:
                    return breakup_chunk(plain, validate_crc=True)
        self.damaged += 1
        return []

    def _note(self, record: McapRecord | None) -> None:
        if isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Schema):
            self.schemas[record.id] = record


DAMAGE = (McapError, struct.error, ValueError, OverflowError)
"""What the library raises where a record is damaged."""


def _record_end(content: bytes, offset: int) -> int:
    """Where the record at a place ends; 0 where there is none."""
    if offset + RECORD_HEAD.size > len(content):
        return 0
    opcode, length = RECORD_HEAD.unpack_from(content, offset)
    stop = offset + RECORD_HEAD.size + int(length)
    return stop if opcode and stop <= len(content) else 0


def _next_record(content: bytes, offset: int) -> int:
    """The first place from ``offset`` on where two records follow one another; the end without one."""
    for head in _LIKELY_HEAD.finditer(content, offset):
        stop = _record_end(content, head.start())
        if stop and (content.startswith(MAGIC, stop) or _record_end(content, stop)):
            return head.start()
    return len(content)


def _unpacked(compression: str, packed: bytes, most: int) -> bytes:
    """The records of a chunk as far as they can be unpacked, and ``most`` of their bytes."""
    records = bytearray()
    opened = {
        "": BytesIO,
        "lz4": lambda packed: lz4.frame.open(BytesIO(packed)),
        "zstd": zstandard.ZstdDecompressor().stream_reader,
    }
    if compression in opened:
        reader = opened[compression](packed)
        # RuntimeError: from lz4; EOFError: it is cut
        with suppress(zstandard.ZstdError, RuntimeError, EOFError, MemoryError):
            while piece := reader.read(min(CHUNK_BYTES, most - len(records))):
                records += piece
    return bytes(records)


MAX_STAMP = np.iinfo(np.uint64).max // 1000 - 1
"""The last receive stamp, µs, that 64 bits of nanoseconds hold: the year 2554."""
HEADER_FIELDS = ("system_id", "component_id", "sequence", "message_id")
# Times (T,), s, and columns (T,) by name
Series = tuple[Array, Mapping[str, Array]]


def write_mcap(file: BinaryIO, stream: FrameStream) -> int:
    """Writes every frame with its stamp, and the dialect's messages as JSON; returns the number of frames.

    A stamp beyond the year 2554, which MCAP cannot hold, becomes that of the frame before.
    """
    writer = start_writer(file)
    raw = register_frame_channel(writer)
    channels = {}
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
    writer = start_writer(file)
    queue: list[tuple[float, int, str]] = []
    for topic, (time, named) in series.items():
        channel = _registered(writer, topic, _object({name: {"type": "number"} for name in named}))
        # A column at once: the rows of a flight take a quarter of a second one by one.
        form = json.dumps(dict.fromkeys(named, "%s")).replace('"%s"', "%s")
        texts = (json.dumps(_plain(column.tolist()))[1:-1].split(", ") for column in named.values())
        queue += zip(time.tolist(), repeat(channel), map(form.__mod__, zip(*texts, strict=True)))
    for at, channel, body in sorted(queue, key=itemgetter(0)):
        write_message(writer, channel, round(at * 1e9), body.encode())
    writer.finish()  # type: ignore[no-untyped-call]


def start_writer(file: BinaryIO, chunk: int = CHUNK_BYTES) -> Writer:
    """Returns a writer of messages in chunks of ``chunk`` bytes; ``finish`` ends it."""
    writer = Writer(file, chunk_size=chunk)
    writer.start(library="mavdem")
    return writer


def register_frame_channel(writer: Writer) -> int:
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


def _schema(message: Any) -> JsonValues:
    header = _object({name: {"type": "integer"} for name in HEADER_FIELDS})
    fields = {}
    for name, count in zip(message.ordered_fieldnames, message.array_lengths, strict=True):
        kind = message.fieldtypes[message.fieldnames.index(name)]
        array = {"type": "array", "items": {"type": "number"}}
        single = {"type": "string" if kind == "char" else "number"}
        fields[_key(name)] = array if count and kind != "char" else single
    return _object({"header": header, "message": _object({"type": {"type": "string"}, **fields})})


def _object(properties: Mapping[str, Any]) -> JsonValues:
    return {"type": "object", "properties": dict(properties)}
