"""MCAP files: reading their messages in the order of the file, as far as possible from damaged ones, and writing them.

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
from math import isfinite
from typing import Any, BinaryIO, NamedTuple

import lz4.frame
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer

from mavdem.containers import JsonValues
from mavdem.facts import Facts
from mavdem.facts.sources import Repair
from mavdem.ingest.contents import MAX_COMPRESSION_RATIO, MIN_UNPACKED_LIMIT
from mavdem.ingest.mavlink.dialect import MessageDefinition, definitions_by_id
from mavdem.ingest.mavlink.frame_reader import Frame, parse_frame
from mavdem.ingest.mavlink.frame_stream import MAX_NANOSECOND_STAMP, FrameStream
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES
from mavdem.ingest.mavlink.payloads import field_values
from mavdem.ingest.telemetry import repair_facts
from mavdem.log_formats import FORMAT_SIGNATURES, Format

MAGIC = FORMAT_SIGNATURES[Format.MCAP].first_bytes
"""First and last bytes of an MCAP file."""

READ_OPCODES = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK)
"""Kinds of records that are read; all others are skipped."""

RECORD_HEAD = struct.Struct("<BQ")
"""What precedes the content of each record: the opcode and the content's length."""

LIKELY_HEAD = re.compile(rb"[\x01-\x%02x](?=.{4}\0{4})" % max(Opcode), re.DOTALL)
"""A byte that may be the opcode of a record: no record is as long as 4 GiB, so the length's last four bytes are 0."""

CHUNK_BYTES = 1 << 20
"""Number of bytes that are compressed together by default (that of the ``mcap`` package), or unpacked together."""

DAMAGE_ERRORS = (McapError, struct.error, ValueError, OverflowError)
"""What the library raises where a record is damaged."""

NANOSECONDS = 1e9
"""Nanoseconds in a second."""

NANOSECONDS_PER_MICROSECOND = 1000
"""Nanoseconds in a microsecond."""


class RecordLocation(NamedTuple):
    """Where a record's content is in the file."""

    opcode: int
    """Kind of the record."""
    start: int
    """Offset of the content's first byte."""
    end: int
    """Offset after the content."""


MAX_CHUNK_SECONDS = 3600.0
"""Longest time of a chunk that is believable, s: a choice; recorders write one every few seconds."""


@dataclass
class McapRecording:
    """An MCAP file, with the channels, schemas and damage found as far as it was read."""

    content: bytes
    """The bytes of the file."""
    channels: dict[int, Channel] = field(default_factory=dict)
    """Channels by their number."""
    schemas: dict[int, Schema] = field(default_factory=dict)
    """Schemas by their number."""
    damaged_chunks: int = 0
    """Number of damaged chunks."""
    lost_bytes: int = 0
    """Number of bytes that these have in the file."""
    lost_seconds: float = 0.0
    """Time that these span, s, by the times in their heads."""
    skipped_bytes: int = 0
    """Number of bytes that belong to no record."""
    is_cut_off: bool = False
    """Whether the end of the file is missing."""
    _unpackable_bytes: int = 0
    """Number of bytes to which the remaining chunks may unpack."""

    def messages(self) -> Iterator[Message]:
        """Yields every message whose channel is known, in the order of the file, except those in damaged chunks.

        An MCAP file is a sequence of records. A message is a record that names its channel by number. The channel is a
        record too, with the topic. A chunk is a record that contains other records, mostly compressed. Records are
        located first and decoded afterwards, so that channels and schemas outside of chunks are known before any
        message is yielded, wherever in the file they are.
        """
        # The bytes to which all chunks together may unpack are bounded, so that a small hostile file cannot fill the
        # memory.
        self._unpackable_bytes = MIN_UNPACKED_LIMIT + MAX_COMPRESSION_RATIO * len(self.content)
        locations = list(self._record_locations())
        # The summary at the end repeats channels and schemas, which helps where the first record is damaged.
        for location in locations:
            if location.opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
                self._register(self._decoded_record(location))
        for record in self._records_at(locations):
            self._register(record)
            if isinstance(record, Message) and record.channel_id in self.channels:
                yield record

    def repairs(self) -> Facts:
        """Reports the damage that was found while the messages were read, as facts for the user.

        Returns:
            A fact on damaged chunks, one on skipped bytes, and one if the recording was cut; those that apply.
        """
        repairs = repair_facts(
            Repair.CHUNKS_DAMAGED,
            count=self.damaged_chunks,
            size=self.lost_bytes,
            duration=self.lost_seconds,
        )
        repairs += repair_facts(
            Repair.BYTES_SKIPPED,
            count=self.skipped_bytes,
            total=len(self.content),
            part="recording",
        )
        if self.is_cut_off:
            repairs += repair_facts(Repair.RECORDING_CUT)
        return repairs

    def _record_locations(self) -> Iterator[RecordLocation]:
        """Yields the records with one of ``READ_OPCODES``, and counts the bytes of damage between records.

        Records are followed from one to the next by the lengths in their heads. After damage, the next place at which a
        record probably begins is searched. The last record of a complete file is a footer; a file without it was cut
        off.

        Yields:
            Opcode and place of each record, in the order of the file.
        """
        file_end = len(self.content)
        offset = 0
        last_opcode = 0
        while offset < file_end:
            record_end = _record_end(self.content, offset)
            if self.content.startswith(MAGIC, offset):
                offset += len(MAGIC)
            elif record_end is not None:
                last_opcode = self.content[offset]
                if last_opcode in READ_OPCODES:
                    yield RecordLocation(last_opcode, offset + RECORD_HEAD.size, record_end)
                offset = record_end
            else:
                next_record = _next_record(self.content, offset + 1)
                # Bytes after the last record are a record that was cut off, not damage.
                if next_record < file_end:
                    self.skipped_bytes += next_record - offset
                offset = next_record
        self.is_cut_off = last_opcode != Opcode.FOOTER

    def _decoded_record(self, location: RecordLocation) -> McapRecord | None:
        """Decodes one record.

        Args:
            location: Opcode and place of the record.

        Returns:
            The record, as the ``mcap`` package has it; None if it is damaged.
        """
        record_bytes = self.content[location.start - RECORD_HEAD.size : location.end]
        with suppress(*DAMAGE_ERRORS):
            reader = StreamReader(BytesIO(record_bytes), skip_magic=True, emit_chunks=True)
            return next(reader.records)
        return None

    def _records_at(self, locations: list[RecordLocation]) -> Iterator[McapRecord | None]:
        """Yields the records at these locations, those inside chunks instead of the chunks; None for damaged ones.

        In a file with chunks all messages are in chunks. After damage, messages outside of them are the rest of a chunk
        that has lost its checksum, and are left out.

        Args:
            locations: The records outside of chunks, and the chunks, in the order of the file.

        Yields:
            The decoded records in the order of the file, and None for each damaged one.
        """
        has_chunks = any(location.opcode == Opcode.CHUNK for location in locations)
        for location in locations:
            if location.opcode == Opcode.CHUNK:
                yield from self._records_in_chunk(location)
            elif location.opcode != Opcode.MESSAGE or not has_chunks:
                yield self._decoded_record(location)

    def _records_in_chunk(self, location: RecordLocation) -> list[McapRecord]:
        """Returns the records of a chunk.

        Of a damaged chunk nothing is used, since its checksum covers all of it.

        Args:
            location: Location of the chunk in the file.

        Returns:
            The records; empty if the chunk is damaged. It is then counted in ``damaged_chunks``, and its size and
            duration are added to ``lost_bytes`` and ``lost_seconds``.
        """
        chunk = self._decoded_record(location)
        if isinstance(chunk, Chunk):
            records = self._unpacked_chunk(chunk)
            if records is not None:
                return records
            seconds = (chunk.message_end_time - chunk.message_start_time) / NANOSECONDS
            # The times in the chunk's head may be damaged too, and are used only if they are plausible.
            if 0.0 <= seconds <= MAX_CHUNK_SECONDS:
                self.lost_seconds += seconds
        self.damaged_chunks += 1
        self.lost_bytes += location.end - location.start
        return []

    def _unpacked_chunk(self, chunk: Chunk) -> list[McapRecord] | None:
        """Unpacks the records of a chunk, and checks their size and checksum.

        The bytes are unpacked here with a bound on their size, which the library does not have. The library then parses
        the records.

        Args:
            chunk: The chunk, whose bytes may be compressed.

        Returns:
            The records; None if they are damaged, or unpack to more bytes than are allowed.
        """
        max_size = min(self._unpackable_bytes, MIN_UNPACKED_LIMIT)
        record_bytes = _unpacked_records(chunk.compression, chunk.data, max_size)
        self._unpackable_bytes -= len(record_bytes)
        if len(record_bytes) != chunk.uncompressed_size:
            return None
        uncompressed_chunk = replace(chunk, compression="", data=record_bytes)
        with suppress(*DAMAGE_ERRORS):
            return breakup_chunk(uncompressed_chunk, validate_crc=True)
        return None

    def _register(self, record: McapRecord | None) -> None:
        """Notes a channel or a schema by its number."""
        if isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Schema):
            self.schemas[record.id] = record


def _record_end(content: bytes, offset: int) -> int | None:
    """Returns the offset after the record that begins at an offset; None if no record can begin there."""
    if offset + RECORD_HEAD.size > len(content):
        return None
    opcode, length = RECORD_HEAD.unpack_from(content, offset)
    end = offset + RECORD_HEAD.size + int(length)
    return end if opcode and end <= len(content) else None


def _next_record(content: bytes, offset: int) -> int:
    """Finds the offset at which reading continues after damage: the first at which two records follow each other.

    A single byte often looks like the beginning of a record by chance, but hardly ever with another record, or the
    magic bytes at the end of the file, at its stated end.

    Args:
        content: All bytes of the file.
        offset: Offset at which the search begins.

    Returns:
        Offset of the first of the two records; the end of the file if there are none.
    """
    for head in LIKELY_HEAD.finditer(content, offset):
        end = _record_end(content, head.start())
        if end is None:
            continue
        if content.startswith(MAGIC, end) or _record_end(content, end) is not None:
            return head.start()
    return len(content)


def _unpacked_records(compression: str, packed_bytes: bytes, max_size: int) -> bytes:
    """Unpacks the records of a chunk, as far as they can be.

    Args:
        compression: Name of the compression in MCAP: empty, "lz4" or "zstd".
        packed_bytes: The compressed bytes of the chunk.
        max_size: Number of bytes to unpack at most.

    Returns:
        The records; empty for another compression.
    """
    reader: Any
    if compression == "":
        reader = BytesIO(packed_bytes)
    elif compression == "lz4":
        reader = lz4.frame.open(BytesIO(packed_bytes))
    elif compression == "zstd":
        reader = zstandard.ZstdDecompressor().stream_reader(packed_bytes)
    else:
        return b""
    records = bytearray()
    # RuntimeError comes from lz4; EOFError, where the records are cut off.
    with suppress(zstandard.ZstdError, RuntimeError, EOFError, MemoryError):
        while True:
            # At the bound 0 bytes are read, which ends the loop as the end of the records does.
            unpacked_bytes = reader.read(min(CHUNK_BYTES, max_size - len(records)))
            if not unpacked_bytes:
                break
            records += unpacked_bytes
    return bytes(records)


LIBRARY = "mavdem"
"""Name of the writing program in the header of a file."""

HEADER_FIELDS = ("system_id", "component_id", "sequence", "message_id")
"""Fields of the header in BlueOS's JSON."""


def write_mcap(file: BinaryIO, stream: FrameStream) -> int:
    """Writes the frames of a MAVLink stream to an MCAP file, and their messages a second time as JSON.

    The frames keep the recording complete, and from the JSON a viewer can plot fields. A stamp beyond the year 2554,
    which MCAP cannot hold, is replaced by the stamp of the frame before.

    Args:
        file: Open file to write to.
        stream: The frames with their receive stamps.

    Returns:
        The number of frames.
    """
    writer = start_writer(file)
    frame_channel = register_frame_channel(writer)
    json_channels: dict[str, int] = {}
    last_stamp = 0
    count = 0
    for stamp, content in stream.stamped_frames():
        last_stamp = stamp if stamp <= MAX_NANOSECOND_STAMP else last_stamp
        log_time = last_stamp * NANOSECONDS_PER_MICROSECOND
        write_message(writer, frame_channel, log_time, content)
        count += 1
        # A message of another dialect, or a damaged one, is written as a frame only.
        frame = parse_frame(content)
        if frame.checksum != CHECKSUM_MATCHES:
            continue
        definition = definitions_by_id()[frame.message_id]
        topic = f"mavlink/{frame.system}/{frame.component}/{definition.name}"
        if topic not in json_channels:
            schema = _message_schema(definition)
            json_channels[topic] = _register_json_channel(writer, topic, schema)
        body = json.dumps(_json_body(frame, definition)).encode()
        write_message(writer, json_channels[topic], log_time, body)
    writer.finish()  # type: ignore[no-untyped-call]
    return count


def _json_body(frame: Frame, definition: MessageDefinition) -> JsonValues:
    """Returns a message as a JSON object in BlueOS's layout.

    The part "header" has the ids of sender and message and the sequence number, the part "message" the name of the
    message and its fields.

    Args:
        frame: The frame of the message.
        definition: MAVLink's definition of its message: names, types and order of the fields.

    Returns:
        The object.
    """
    header_values = (frame.system, frame.component, frame.sequence, frame.message_id)
    fields: JsonValues = {"type": definition.name}
    for name, value in field_values(frame.payload, definition).items():
        fields[_json_name(name)] = json_value(value)
    return {"header": dict(zip(HEADER_FIELDS, header_values, strict=True)), "message": fields}


def start_writer(file: BinaryIO, chunk_bytes: int = CHUNK_BYTES) -> Writer:
    """Returns a writer of messages, which must be ended by its method ``finish``.

    Args:
        file: Open file to write to.
        chunk_bytes: Number of bytes of a chunk, which is written when it is full.
    """
    writer = Writer(file, chunk_size=chunk_bytes)
    writer.start(library=LIBRARY)
    return writer


def register_frame_channel(writer: Writer) -> int:
    """Registers the channel of frames, and returns its number."""
    return writer.register_channel("mavlink/raw", "mavlink", schema_id=0)


def write_message(writer: Writer, channel: int, time: int, data: bytes) -> None:
    """Writes a message of a channel, at a time in ns."""
    writer.add_message(channel, log_time=time, data=data, publish_time=time)


def _register_json_channel(writer: Writer, topic: str, schema: Mapping[str, Any]) -> int:
    """Registers a channel of JSON messages, whose schema tells viewers which fields they can plot.

    Args:
        writer: The writer of the recording.
        topic: Topic of the channel; with dots in place of slashes it is the name of the schema.
        schema: JSON schema of the messages.

    Returns:
        Number of the channel.
    """
    schema_number = writer.register_schema(
        topic.replace("/", "."), "jsonschema", json.dumps(schema).encode()
    )
    return writer.register_channel(topic, "json", schema_number)


def _json_name(name: str) -> str:
    """Returns a field's name in BlueOS's JSON, where ``type`` is the message's."""
    return "mavtype" if name == "type" else name


def json_value(value: Any) -> Any:
    """Returns a value as JSON has it: null for a number that is not finite."""
    if isinstance(value, list):
        return [json_value(item) for item in value]
    if isinstance(value, float) and not isfinite(value):
        return None
    return value


def _message_schema(definition: MessageDefinition) -> JsonValues:
    """Returns the JSON schema of a message in BlueOS's layout: objects "header" and "message".

    Args:
        definition: MAVLink's definition of the message: names, types and order of its fields.
    """
    header = object_schema({name: {"type": "integer"} for name in HEADER_FIELDS})
    fields: JsonValues = {"type": {"type": "string"}}
    assert definition.payload_type.names is not None
    for name in definition.payload_type.names:
        field_type = definition.payload_type[name]
        if field_type.kind == "S":
            field_schema: JsonValues = {"type": "string"}
        elif field_type.shape:
            field_schema = {"type": "array", "items": {"type": "number"}}
        else:
            field_schema = {"type": "number"}
        fields[_json_name(name)] = field_schema
    return object_schema({"header": header, "message": object_schema(fields)})


def object_schema(properties: Mapping[str, Any]) -> JsonValues:
    """Returns the JSON schema of an object with these properties."""
    return {"type": "object", "properties": dict(properties)}
