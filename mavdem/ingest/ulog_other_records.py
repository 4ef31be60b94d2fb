"""The records of a ULog file that are not logged data: information, parameters, texts, interruptions of the logger.

They are few, and are read one by one. What they contain was compared with its type before (``ulog_definitions``).
Values are those that pyulog reads (``tests/ingest/test_ulog.py``).

Layout: https://docs.px4.io/main/en/dev_log/ulog_file_format.html.
"""

import struct
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mavdem.ingest.byte_rows import Offsets
from mavdem.ingest.ulog_definitions import (
    DATA_HEADER,
    DEFAULT,
    DROPOUT,
    HEADER,
    INFORMATION,
    KEY_OFFSETS,
    PARAMETER,
    SUBSCRIPTION,
    TAGGED_TEXT,
    TEXT,
)
from mavdem.ingest.ulog_formats import STAMP
from mavdem.ingest.ulog_records import APPENDED_DATA_FLAG, SoundRecords

VALUE_TYPES = {
    b"int8_t": struct.Struct("<b"),
    b"uint8_t": struct.Struct("<B"),
    b"bool": struct.Struct("<?"),
    b"int16_t": struct.Struct("<h"),
    b"uint16_t": struct.Struct("<H"),
    b"int32_t": struct.Struct("<i"),
    b"uint32_t": struct.Struct("<I"),
    b"float": struct.Struct("<f"),
    b"int64_t": struct.Struct("<q"),
    b"uint64_t": struct.Struct("<Q"),
    b"double": struct.Struct("<d"),
}
"""How a number after a key is stored, by its type."""

START_OF_DATA = (SUBSCRIPTION, TEXT, TAGGED_TEXT)
"""Types of the records with which the data begins; parameters before are those at the start of the logger."""

RECORDS_TO_DATE_BY = 100
"""Number of data records before a parameter whose latest stamp dates it: a choice.

Records of slow topics may be older than their neighbours by seconds. PX4 writes a hundred records in some 10 ms.
"""

FIRMWARE_DEFAULT = 1
"""Bit of a default value (message Q): it is the firmware's."""

AIRFRAME_DEFAULT = 2
"""Bit of a default value: it is that of the chosen airframe."""

DEFAULTS_FLAG = 1
"""Bit of the compatible flags: the file has default values of parameters."""

START_STAMP_OFFSET = 8
"""Offset of the time of the start, after the magic bytes and the version of the format."""

TEXT_HEADER = struct.Struct("<BQ")
"""Level and time stamp before a text."""

DURATION = struct.Struct("<H")
"""Duration of an interruption, ms."""

TEXT_TYPE = b"char["
"""Beginning of the type of a text in a key: an array of characters."""

KeyedValue = str | bytes | float
"""A text or a number after a key; bytes where it is neither."""


class ParameterSetting(NamedTuple):
    """The value of a parameter from some time on."""

    stamp: int
    """When it was set, µs since boot."""
    name: str
    """Name of the parameter."""
    value: float
    """Its value; it may be NaN or infinite."""


class LoggedText(NamedTuple):
    """A text that PX4 logged."""

    level: int
    """ASCII character of its level, a digit as in syslog."""
    stamp: int
    """When it was logged, µs since boot."""
    text: str
    """The text."""


@dataclass
class OtherRecords:
    """What the records of a file contain that are not logged data."""

    start_stamp: int
    """When the logger began, µs since boot."""
    information: dict[str, KeyedValue] = field(default_factory=dict)
    """Values about the system by name, the last one of each."""
    initial_settings: dict[str, float] = field(default_factory=dict)
    """Value of each parameter when the logger began, by name."""
    changed_settings: list[ParameterSetting] = field(default_factory=list)
    """The parameters that were set later, in the order of the file."""
    firmware_defaults: dict[str, float] = field(default_factory=dict)
    """Default values of the firmware that differ from those in use, by the name of the parameter."""
    airframe_defaults: dict[str, float] = field(default_factory=dict)
    """The same of the chosen airframe."""
    texts: list[LoggedText] = field(default_factory=list)
    """Texts without a tag, in the order of the file."""
    dropout_durations: list[int] = field(default_factory=list)
    """Duration of each interruption of the logger, ms."""


def is_of_later_format(records: SoundRecords) -> bool:
    """Returns whether the flags of a file have an incompatible bit that is not known here."""
    return records.flags.incompatible & ~APPENDED_DATA_FLAG != 0


def read_other_records(
    records: SoundRecords, other_offsets: Offsets, data_offsets: Offsets
) -> OtherRecords:
    """Reads the records of a file that are not logged data: information, parameters, texts and dropouts.

    A parameter that is set in flight has no stamp: as pyulog does, it is dated to the latest stamp of the data before.

    Args:
        records: The sound records of the file.
        other_offsets: Offset (M,) of each record without data, ascending.
        data_offsets: Offset (N,) of each data record, ascending.

    Returns:
        Their contents. Parameters whose values are not numbers come from damage, and are left out.
    """
    content = records.content
    (start_stamp,) = STAMP.unpack_from(content, START_STAMP_OFFSET)
    other = OtherRecords(start_stamp)
    latest_stamp = start_stamp
    has_begun_data = False
    # Number of data records before each of the other records.
    data_counts = np.searchsorted(data_offsets, other_offsets)
    for offset, data_count in zip(other_offsets.tolist(), data_counts.tolist(), strict=True):
        length, record_type = HEADER.unpack_from(content, offset)
        body_offset = offset + HEADER.size
        record_end = body_offset + length
        has_begun_data = has_begun_data or record_type in START_OF_DATA
        if record_type == PARAMETER and has_begun_data:
            name, value = _name_and_value(content[offset:record_end], KEY_OFFSETS[PARAMETER])
            if not isinstance(value, str | bytes):
                last_offsets = data_offsets[max(data_count - RECORDS_TO_DATE_BY, 0) : data_count]
                latest_stamp = max(latest_stamp, _latest_stamp(records, last_offsets))
                setting = ParameterSetting(latest_stamp, name, float(value))
                other.changed_settings.append(setting)
        elif record_type in KEY_OFFSETS:
            _add_value(other, record_type, content[offset:record_end])
        elif record_type == TEXT:
            level, stamp = TEXT_HEADER.unpack_from(content, body_offset)
            text = content[body_offset + TEXT_HEADER.size : record_end].decode(errors="ignore")
            other.texts.append(LoggedText(level, stamp, text))
        elif record_type == DROPOUT and has_begun_data:
            other.dropout_durations.extend(DURATION.unpack_from(content, body_offset))
    # Without this flag of the file, records of the type of default values are damage.
    if not records.flags.compatible & DEFAULTS_FLAG:
        other.firmware_defaults.clear()
        other.airframe_defaults.clear()
    return other


def _add_value(other: OtherRecords, record_type: int, record: bytes) -> None:
    """Adds the value in an information record, a record of a default, or one of a parameter at the logger's start.

    Args:
        other: Contents of the records so far, which are extended in place.
        record_type: Type of the record: ``INFORMATION``, ``DEFAULT`` or ``PARAMETER``; others are ignored.
        record: All bytes of the record, header included. The value of a default or parameter must be a number.
    """
    name, value = _name_and_value(record, KEY_OFFSETS[record_type])
    if record_type == INFORMATION:
        other.information[name] = value
    elif isinstance(value, str | bytes):
        return
    elif record_type == PARAMETER:
        other.initial_settings[name] = float(value)
    elif record_type == DEFAULT:
        # The first byte after the header has a flag for each kind of default value.
        kinds = record[HEADER.size]
        if kinds & FIRMWARE_DEFAULT:
            other.firmware_defaults[name] = float(value)
        if kinds & AIRFRAME_DEFAULT:
            other.airframe_defaults[name] = float(value)


def _name_and_value(record: bytes, key_offset: int) -> tuple[str, KeyedValue]:
    """Reads an information or parameter record: the length of a key, the key ("float MC_ROLL_P"), and the value.

    Args:
        record: All bytes of the record, header included.
        key_offset: Offset of the byte with the key's length in the record.

    Returns:
        The name in the key, and the value: a number or a text if the type in the key is one, otherwise bytes.
    """
    key_end = key_offset + 1 + record[key_offset]
    key_type, _, name = record[key_offset + 1 : key_end].partition(b" ")
    value_type = VALUE_TYPES.get(key_type)
    value = record[key_end:]
    if value_type is not None:
        return name.decode(), value_type.unpack(value)[0]
    if key_type.startswith(TEXT_TYPE):
        return name.decode(), value.decode(errors="ignore")
    return name.decode(), value


def _latest_stamp(records: SoundRecords, data_offsets: Offsets) -> int:
    """Returns the latest time stamp of some data records, µs since boot; 0 without any.

    Args:
        records: The records of the file.
        data_offsets: Offset (N,) of each data record that is examined.
    """
    latest_stamp = 0
    topics = records.definitions.topics
    for offset in data_offsets.tolist():
        _, _, number = DATA_HEADER.unpack_from(records.content, offset)
        # Sound data records have a stamp. Its offset counts from the end of the header.
        stamp_start = offset + DATA_HEADER.size + (topics[number].stamp_offset or 0)
        (stamp,) = STAMP.unpack_from(records.content, stamp_start)
        latest_stamp = max(latest_stamp, stamp)
    return latest_stamp
