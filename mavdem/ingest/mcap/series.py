"""Writing time series as JSON messages of an MCAP file; the records are built as arrays, a chunk at a time.

The file is byte for byte what the writer of the ``mcap`` package makes of the same messages, which takes one message at
a time and is several times slower. Source of the layout: https://mcap.dev/spec.
"""

import json
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from typing import BinaryIO, NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

from mavdem.arrays import Array, Integers
from mavdem.ingest.mcap.records import (
    CHUNK_BYTES,
    LIBRARY,
    MAGIC,
    NANOSECONDS,
    RECORD_HEAD,
    json_value,
    object_schema,
)

StructuredArray = NDArray[np.void]
"""Array (N,) whose elements have named fields."""

Series = tuple[Array, Mapping[str, Array]]
"""Times (T,), s, and columns (T,) by name."""

MESSAGE_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
"""Bytes of a message record before the message's data: opcode and length of the record, then the first fields of its
content."""

INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
"""Bytes of an entry of a message index: the time of a message, and where its record is in the unpacked chunk."""


class Messages(NamedTuple):
    """Messages of all channels in the order of time."""

    heads: StructuredArray
    """Heads of the records (N,), of the type ``MESSAGE_HEAD``."""
    bodies: list[bytes]
    """Data of the N messages."""

    @property
    def record_sizes(self) -> Integers:
        """Sizes of the whole records (N,), bytes."""
        return self.heads["length"].astype(np.int64) + RECORD_HEAD.size

    def messages_between(self, first: int, last: int) -> "Messages":
        """Returns the messages from number ``first`` up to number ``last``, which is not included."""
        return Messages(self.heads[first:last], self.bodies[first:last])

    def counts(self) -> dict[int, int]:
        """Returns the number of messages of each channel, in the order in which the channels first occur."""
        channels, first_rows, counts = np.unique(
            self.heads["channel"], return_index=True, return_counts=True
        )
        order = np.argsort(first_rows)
        return dict(zip(channels[order].tolist(), counts[order].tolist(), strict=True))


def write_series(
    file: BinaryIO, series: Mapping[str, Series], chunk_bytes: int = CHUNK_BYTES
) -> None:
    """Writes columns over time as JSON, one message per row; a value that is not finite becomes null.

    ``tests/ingest/test_mcap_series.py`` compares the file with the one that the library writes.

    Args:
        file: Open file to write to.
        series: Times (T,), s, from 0 on, and columns (T,), by topic. Messages of all topics are written in the order of
            time.
        chunk_bytes: A chunk ends with the message that makes it larger than this, bytes.
    """
    schemas, channels = _schemas_and_channels(series)
    definitions = b""
    for schema_record, channel_record in zip(schemas, channels, strict=True):
        definitions += _record_bytes(schema_record) + _record_bytes(channel_record)
    messages = _encoded_messages(series)
    start = MAGIC + _record_bytes(Header(profile="", library=LIBRARY))
    file.write(start)
    offset = len(start)
    chunk_indexes = []
    for records, chunk_messages in _messages_by_chunk(messages, definitions, chunk_bytes):
        content, chunk_index = _chunk_with_indexes(records, chunk_messages, offset)
        file.write(content)
        offset += len(content)
        chunk_indexes.append(chunk_index)
    data_end = _record_bytes(DataEnd(0))
    file.write(data_end)
    times = messages.heads["log_time"]
    statistics = Statistics(
        attachment_count=0,
        channel_count=len(channels),
        channel_message_counts=messages.counts(),
        chunk_count=len(chunk_indexes),
        message_count=len(times),
        message_start_time=int(times[0]) if len(times) else 0,
        message_end_time=int(times[-1]) if len(times) else 0,
        metadata_count=0,
        schema_count=len(schemas),
    )
    groups: dict[Opcode, Sequence[McapRecord]] = {
        Opcode.SCHEMA: schemas,
        Opcode.CHANNEL: channels,
        Opcode.STATISTICS: [statistics],
        Opcode.CHUNK_INDEX: chunk_indexes,
        Opcode.ATTACHMENT_INDEX: [],
        Opcode.METADATA_INDEX: [],
    }
    file.write(_summary_section(groups, offset + len(data_end)) + MAGIC)


def _schemas_and_channels(series: Mapping[str, Series]) -> tuple[list[Schema], list[Channel]]:
    """Defines a JSON schema and a channel for each topic; both are numbered from 1.

    Args:
        series: Times and columns by topic.

    Returns:
        The schemas, whose objects have a number for each column, and the channels, in the order of the topics.
    """
    schemas = []
    channels = []
    for number, (topic, (_, columns)) in enumerate(series.items(), 1):
        schema = object_schema({name: {"type": "number"} for name in columns})
        name = topic.replace("/", ".")
        schemas.append(Schema(number, json.dumps(schema).encode(), "jsonschema", name))
        channels.append(Channel(number, topic, "json", {}, number))
    return schemas, channels


def _encoded_messages(series: Mapping[str, Series]) -> Messages:
    """Builds the heads and the JSON bodies of all messages, in the order of time.

    Each topic has a channel; channels have the numbers 1, 2, … in the order of the topics. Messages of the same time
    are in the order of their channels.

    Args:
        series: For each topic the times (T,), s, and columns (T,) by name.

    Returns:
        Heads and bodies of all messages.
    """
    bodies: list[str] = []
    times = [np.empty(0)]
    channels = [np.empty(0, dtype=np.uint16)]
    for channel, (time, columns) in enumerate(series.values(), 1):
        bodies += _json_rows(columns)
        times.append(time)
        channels.append(np.full(len(time), channel, dtype=np.uint16))
    seconds = np.concatenate(times)
    heads = np.zeros(len(seconds), dtype=MESSAGE_HEAD)
    heads["opcode"] = Opcode.MESSAGE
    # The length of a record counts from the end of its own head on: the rest of the message's head, and the body.
    # ``json`` writes ASCII only, so that a text has as many bytes as characters.
    rest_of_head = MESSAGE_HEAD.itemsize - RECORD_HEAD.size
    body_lengths = np.fromiter(map(len, bodies), dtype=np.int64, count=len(bodies))
    heads["length"] = rest_of_head + body_lengths
    heads["channel"] = np.concatenate(channels)
    heads["log_time"] = np.rint(seconds * NANOSECONDS)
    heads["publish_time"] = heads["log_time"]
    order = np.argsort(seconds, kind="stable")
    return Messages(heads[order], [bodies[row].encode() for row in order.tolist()])


def _json_rows(columns: Mapping[str, Array]) -> Iterator[str]:
    """Returns the rows of a table as JSON objects.

    Each whole column is formatted at once, as a JSON list whose items are then split; this is much faster than row by
    row. The items of a row are put into a pattern, such as '{"x": %s, "y": %s}'.

    Args:
        columns: Columns (T,) by name.

    Returns:
        JSON text of each of the T rows.
    """
    # In a pattern "%%" stands for a percent sign.
    keys = [json.dumps(name).replace("%", "%%") for name in columns]
    row_pattern = "{" + ", ".join(f"{key}: %s" for key in keys) + "}"
    texts_of_columns = []
    for column in columns.values():
        if len(column) == 0:
            return iter(())
        values = column.tolist()
        if not np.isfinite(column).all():
            # JSON has no NaN and no infinity; they become null.
            values = json_value(values)
        list_text = json.dumps(values)
        texts_of_columns.append(list_text.removeprefix("[").removesuffix("]").split(", "))
    texts_of_rows = zip(*texts_of_columns, strict=True)
    return (row_pattern % texts for texts in texts_of_rows)


def _messages_by_chunk(
    messages: Messages, definitions: bytes, chunk_bytes: int
) -> Iterator[tuple[bytes, Messages]]:
    """Divides messages into chunks, each of which ends with the message that makes it larger than a limit.

    So a chunk exceeds the limit by at most one message, as with the writer of the MCAP library.

    Args:
        messages: Heads and bodies of all messages, in the order of time.
        definitions: Records of schemas and channels, with which the first chunk begins.
        chunk_bytes: Limit of the size, bytes.

    Yields:
        The records of definitions with which a chunk begins, and its messages.
    """
    # Number of bytes of all messages up to each one, itself included.
    bytes_up_to = np.cumsum(messages.record_sizes)
    first_message = 0
    # Number of bytes of all messages before the chunk. It begins below 0 since the definitions, too, fill the first
    # chunk.
    bytes_before = -len(definitions)
    while first_message < len(bytes_up_to):
        # The chunk ends with the first message up to which it has more bytes than the limit, or with the last of all.
        last_message = int(np.searchsorted(bytes_up_to, bytes_before + chunk_bytes, side="right"))
        end_message = min(last_message + 1, len(bytes_up_to))
        yield definitions, messages.messages_between(first_message, end_message)
        # Only the first chunk begins with the definitions.
        definitions = b""
        bytes_before = int(bytes_up_to[end_message - 1])
        first_message = end_message


def _chunk_with_indexes(
    definitions: bytes, messages: Messages, offset: int
) -> tuple[bytes, ChunkIndex]:
    """Builds a chunk and the message indexes that follow it.

    Args:
        definitions: Records with which the chunk begins.
        messages: Messages of the chunk, at least one.
        offset: Offset of the chunk in the file.

    Returns:
        The bytes of all these records, and the index of the chunk for the summary.
    """
    times = messages.heads["log_time"]
    heads = messages.heads.view(f"V{MESSAGE_HEAD.itemsize}").tolist()
    # Heads and bodies by turns: the records of the messages.
    record_parts = chain.from_iterable(zip(heads, messages.bodies, strict=True))
    records = definitions + b"".join(record_parts)
    packed_records = zstandard.compress(records)
    chunk = Chunk(
        compression="zstd",
        data=packed_records,
        message_start_time=int(times[0]),
        message_end_time=int(times[-1]),
        uncompressed_crc=zlib.crc32(records),
        uncompressed_size=len(records),
    )
    content = _record_bytes(chunk)
    chunk_length = len(content)
    index_entries = np.empty(len(times), dtype=INDEX_ENTRY)
    index_entries["log_time"] = times
    record_sizes = messages.record_sizes
    # Offset of each message in the unpacked records of the chunk.
    index_entries["offset"] = len(definitions) + np.cumsum(record_sizes) - record_sizes
    index_offsets = {}
    for channel in messages.counts():
        index_offsets[channel] = offset + len(content)
        content += _message_index(channel, index_entries[messages.heads["channel"] == channel])
    return content, ChunkIndex(
        chunk_length=chunk_length,
        chunk_start_offset=offset,
        compression=chunk.compression,
        compressed_size=len(packed_records),
        message_start_time=chunk.message_start_time,
        message_end_time=chunk.message_end_time,
        message_index_length=len(content) - chunk_length,
        message_index_offsets=index_offsets,
        uncompressed_size=chunk.uncompressed_size,
    )


def _message_index(channel: int, entries: StructuredArray) -> bytes:
    """Returns the record with the times and offsets of the messages of a channel in a chunk.

    Args:
        channel: Number of the channel, from 1; each topic has one.
        entries: An entry for each of its messages, of the type ``INDEX_ENTRY``.

    Returns:
        Bytes of the record.
    """
    content = struct.pack("<HI", channel, entries.nbytes) + entries.tobytes()
    return RECORD_HEAD.pack(Opcode.MESSAGE_INDEX, len(content)) + content


def _summary_section(groups: Mapping[Opcode, Sequence[McapRecord]], offset: int) -> bytes:
    """Returns the summary of a file: groups of records, where each group is, and the footer with the checksum.

    Args:
        groups: Records by their opcode, the number of their type.
        offset: Offset of the summary in the file.

    Returns:
        Bytes of the summary, to be written at that offset.
    """
    summary = b""
    summary_offsets = b""
    for opcode, records in groups.items():
        group_bytes = b"".join(map(_record_bytes, records))
        summary_offset = SummaryOffset(opcode, offset + len(summary), len(group_bytes))
        summary_offsets += _record_bytes(summary_offset)
        summary += group_bytes
    offsets_start = offset + len(summary)
    summary += summary_offsets
    # The checksum covers the summary and the footer without its last four bytes, the checksum itself.
    footer = _record_bytes(Footer(offset, offsets_start, 0))
    footer_without_checksum = footer[:-4]
    checksum = zlib.crc32(footer_without_checksum, zlib.crc32(summary))
    return summary + _record_bytes(Footer(offset, offsets_start, checksum))


def _record_bytes(record: McapRecord) -> bytes:
    """Returns the bytes of one record."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
