"""The topics of a ULog file as columns, decoded from all records of a topic at once.

What is no data (parameters, texts, information, interruptions of the logger) is rare, and left to pyulog: it reads a
file of these records and of the few data records that date them.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.byte_rows import Bytes, Offsets, bytes_at, rows_of
from mavdem.ingest.contents import FileContent
from mavdem.ingest.px4_topics import TOPIC_FIELDS
from mavdem.ingest.telemetry import Columns, rows_by_value
from mavdem.ingest.ulog_definitions import (
    DATA,
    DATA_HEADER,
    HEADER,
    NUMBER_TYPES,
    PARAMETER,
    NumberField,
    TopicLayout,
)
from mavdem.ingest.ulog_records import SoundRecords

RECORDS_TO_DATE_BY = 100
"""Number of data records before a parameter whose latest stamp dates it: a choice.

Records of slow topics may be older than their neighbours by seconds. PX4 writes a hundred records in some 10 ms.
"""


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
    other_content: bytes
    """A ULog file without the data: for pyulog."""


def parse_records(records: SoundRecords, *, has_all_fields: bool = False) -> ParsedRecords:
    """Decodes the data records of a file, and separates the other records from them.

    Args:
        records: Sound records of the file.
        has_all_fields: Whether all fields of all topics are decoded, or only those that mavdem reads.

    Returns:
        The topics as columns, the number of data records, and a file of the other records.
    """
    content = np.frombuffer(records.content, dtype=np.uint8)
    is_data = bytes_at(content, records.offsets + HEADER.size - 1) == DATA
    data_offsets = records.offsets[is_data]
    subscriptions = _subscriptions(content, data_offsets)
    rows = rows_by_value(subscriptions)
    topics = []
    for number, layout in records.topics.items():
        if number in rows:
            body_offsets = data_offsets[rows[number]] + DATA_HEADER.size
            fields = layout.fields if has_all_fields else _fields_to_read(layout)
            columns = _columns(content, body_offsets, layout, fields)
            topics.append(LoggedTopic(layout.name, records.instances[number], columns))
    other_content = _other_content(records, records.offsets[~is_data], data_offsets)
    return ParsedRecords(topics, len(data_offsets), other_content)


def _columns(
    content: Bytes, body_offsets: Offsets, layout: TopicLayout, fields: Sequence[NumberField]
) -> Columns:
    """Decodes fields of one topic.

    Args:
        content: Bytes of the file.
        body_offsets: Offset (N,) of the byte after the subscription number of each record.
        layout: Layout of the records.
        fields: The fields to decode.

    Returns:
        Columns (N,) by name; none without fields.
    """
    if not fields:
        return {}
    record_type = np.dtype(
        {
            "names": [field.name for field in fields],
            "formats": [NUMBER_TYPES[field.kind] for field in fields],
            "offsets": [field.offset for field in fields],
            "itemsize": layout.min_bytes,
        }
    )
    bodies = rows_of(content, body_offsets, layout.min_bytes).view(record_type)[:, 0]
    return {field.name: np.ascontiguousarray(bodies[field.name]) for field in fields}


def _fields_to_read(layout: TopicLayout) -> Sequence[NumberField]:
    """Returns the fields of a topic that mavdem reads, and its time stamp; none of a topic that it does not read."""
    if layout.name not in TOPIC_FIELDS:
        return ()
    # The table has the length of an array behind its name, the file the number of each element.
    names = {"timestamp", *(name.partition("[")[0] for name in TOPIC_FIELDS[layout.name])}
    return [field for field in layout.fields if field.name.partition("[")[0] in names]


def _integers_at(
    content: Bytes, offsets: Offsets, stored: np.dtype[Any]
) -> NDArray[np.unsignedinteger[Any]]:
    """Reads one integer at each of N offsets of a file.

    Args:
        content: Bytes of the file.
        offsets: Offset (N,) of each integer.
        stored: Type of the integers.

    Returns:
        (N,) integers.
    """
    return rows_of(content, offsets, stored.itemsize).view(stored)[:, 0]


def _other_content(records: SoundRecords, other_offsets: Offsets, data_offsets: Offsets) -> bytes:
    """Makes a smaller ULog file of all records that are not data, with only the data that dates parameters.

    A parameter that is set in flight has no stamp: pyulog dates it to the latest stamp of the data before it. So the
    data record with that stamp is put before the parameter.

    Args:
        records: The records of the file.
        other_offsets: Offset (M,) of each record without data, ascending.
        data_offsets: Offset (N,) of each data record, ascending.

    Returns:
        The bytes of the file.
    """
    content = records.content
    pieces = [records.file_header]
    data_before = np.searchsorted(data_offsets, other_offsets)
    for offset, data_count in zip(other_offsets.tolist(), data_before.tolist(), strict=True):
        record = _record_at(content, offset)
        if record[HEADER.size - 1] == PARAMETER and data_count > 0:
            last_offsets = data_offsets[max(data_count - RECORDS_TO_DATE_BY, 0) : data_count]
            pieces.append(_latest_record(records, last_offsets))
        pieces.append(record)
    return b"".join(pieces)


def _latest_record(records: SoundRecords, data_offsets: Offsets) -> bytes:
    """Finds the data record with the latest time stamp.

    Args:
        records: The records of the file.
        data_offsets: Offset (N,) of each data record in question.

    Returns:
        The bytes of the record.
    """
    content = np.frombuffer(records.content, dtype=np.uint8)
    stamp_starts = data_offsets + DATA_HEADER.size
    for row, number in enumerate(_subscriptions(content, data_offsets).tolist()):
        stamp_starts[row] += records.topics[number].stamp_offset or 0
    stamps = _integers_at(content, stamp_starts, np.dtype("<u8"))
    return _record_at(records.content, int(data_offsets[stamps.argmax()]))


def _subscriptions(content: Bytes, data_offsets: Offsets) -> NDArray[np.unsignedinteger[Any]]:
    """Returns the number of the subscription that each of N data records follows (N,)."""
    return _integers_at(content, data_offsets + HEADER.size, np.dtype("<u2"))


def _record_at(content: FileContent, offset: int) -> bytes:
    """Returns the whole record that begins at an offset."""
    length, _kind = HEADER.unpack_from(content, offset)
    return content[offset : offset + HEADER.size + length]
