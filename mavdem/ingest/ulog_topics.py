"""The topics of a ULog file as columns, decoded from all records of a topic at once."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.byte_rows import Bytes, Offsets, bytes_at, rows_of
from mavdem.ingest.px4_topics import TOPIC_FIELDS
from mavdem.ingest.telemetry import Columns, rows_by_value
from mavdem.ingest.ulog_definitions import DATA, DATA_HEADER, HEADER
from mavdem.ingest.ulog_formats import NUMBER_TYPES, NumberField, TopicLayout
from mavdem.ingest.ulog_other_records import OtherRecords, read_other_records
from mavdem.ingest.ulog_records import SoundRecords


class LoggedTopic(NamedTuple):
    """The data records of one subscription."""

    name: str
    """Name of the topic."""
    instance: int
    """Number of the topic's instance."""
    columns: Columns
    """Fields (N,) of the N records that mavdem reads, and ``timestamp``; empty for a topic that it does not read."""


class ParsedRecords(NamedTuple):
    """The records of a file, sorted by what they are."""

    topics: list[LoggedTopic]
    """The topics that have data, in the order of their subscriptions."""
    data_records: int
    """Number of data records."""
    other: OtherRecords
    """What the other records contain."""


def parse_records(records: SoundRecords, *, has_all_fields: bool = False) -> ParsedRecords:
    """Decodes the data records of a file topic by topic, and reads the other records.

    All records of one subscription are of one topic, and are decoded together.

    Args:
        records: Sound records of the file.
        has_all_fields: Whether all fields of all topics are decoded, or only those that mavdem reads.

    Returns:
        The topics as columns, the number of data records, and the contents of the other records.
    """
    content = np.frombuffer(records.content, dtype=np.uint8)
    # The header of a record ends with a letter for its type. In a data record the number of the subscription follows.
    record_types = bytes_at(content, records.offsets + HEADER.size - 1)
    is_data = record_types == DATA
    data_offsets = records.offsets[is_data]
    subscriptions = _integers_at(content, data_offsets + HEADER.size, np.dtype("<u2"))
    rows_of_subscription = rows_by_value(subscriptions)
    topics = []
    definitions = records.definitions
    for subscription, layout in definitions.topics.items():
        if subscription not in rows_of_subscription:
            continue
        # A topic that mavdem does not read has no columns.
        columns: Columns = {}
        if has_all_fields or layout.name in TOPIC_FIELDS:
            fields = definitions.formats.number_fields(layout.name)
            if not has_all_fields:
                fields = _fields_to_read(layout.name, fields)
            offsets_of_topic = data_offsets[rows_of_subscription[subscription]]
            body_offsets = offsets_of_topic + DATA_HEADER.size
            columns = _decoded_columns(content, body_offsets, layout, fields)
        topics.append(LoggedTopic(layout.name, definitions.instances[subscription], columns))
    other_records = read_other_records(records, records.offsets[~is_data], data_offsets)
    return ParsedRecords(topics, len(data_offsets), other_records)


def _decoded_columns(
    content: Bytes, body_offsets: Offsets, layout: TopicLayout, fields: Sequence[NumberField]
) -> Columns:
    """Decodes fields of one topic, for all records at once.

    Args:
        content: All bytes of the file.
        body_offsets: Offset (N,) of the byte after the subscription number of each record.
        layout: Length of the topic's records, and the offset of their time stamp.
        fields: Name, type and offset of each field to decode.

    Returns:
        Columns (N,) by name.
    """
    # A record type with the given fields only: the bytes between them are skipped.
    record_type = np.dtype(
        {
            "names": [field.name for field in fields],
            "formats": [NUMBER_TYPES[field.type_name] for field in fields],
            "offsets": [field.offset for field in fields],
            "itemsize": layout.min_bytes,
        }
    )
    bodies = rows_of(content, body_offsets, layout.min_bytes).view(record_type)[:, 0]
    return {field.name: np.ascontiguousarray(bodies[field.name]) for field in fields}


def _fields_to_read(topic: str, fields: Sequence[NumberField]) -> Sequence[NumberField]:
    """Returns the fields that mavdem reads of a topic of ``TOPIC_FIELDS``, and the time stamp.

    Args:
        topic: Name of the topic ("vehicle_attitude").
        fields: All fields of the topic.

    Returns:
        Some of the fields, in the same order.
    """
    # An array is "q[4]" in the table, with its length, and "q[0]", "q[1]", … in the file.
    names = {"timestamp", *(name.partition("[")[0] for name in TOPIC_FIELDS[topic])}
    return [field for field in fields if field.name.partition("[")[0] in names]


def _integers_at(
    content: Bytes, offsets: Offsets, stored_type: np.dtype[Any]
) -> NDArray[np.unsignedinteger[Any]]:
    """Reads one integer at each of N offsets of a file.

    Args:
        content: All bytes of the file.
        offsets: Offset (N,) of each integer.
        stored_type: Data type of the integers in the file, with its size and byte order.

    Returns:
        (N,) integers.
    """
    return rows_of(content, offsets, stored_type.itemsize).view(stored_type)[:, 0]
