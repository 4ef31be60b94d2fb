"""Whether a record of a ULog file fits the definitions in the file: of its messages and of its subscriptions.

A file defines its messages (the fields of each, ``ulog_formats.py``) and its subscriptions (the number under which the
records of one topic follow). Other records have a layout of their own.

Layout: https://docs.px4.io/main/en/dev_log/ulog_file_format.html.
"""

import re
import struct
from collections.abc import Sequence
from enum import Enum, auto
from typing import NamedTuple

import numpy as np

from mavdem.ingest.byte_rows import rows_of
from mavdem.ingest.contents import FileContent
from mavdem.ingest.record_runs import PossibleRecords
from mavdem.ingest.ulog_formats import (
    MAX_NAME_BYTES,
    NAME,
    NUMBER_BYTES,
    STAMP,
    MessageFormats,
    TopicLayout,
    parsed_format_of,
)

HEADER = struct.Struct("<HB")
"""Header of each record: number of bytes after it, and its type."""

DATA_HEADER = struct.Struct("<HBH")
"""Header of a data record, and the number of its subscription."""

DATA_HEADER_FIELDS = np.dtype([("length", "<u2"), ("type", "u1"), ("subscription", "<u2")])
"""The same header as a structured type, for many records at once."""

TOPIC_NUMBER_BYTES = 2
"""Number of bytes of a subscription's number, with which the body of its data records begins."""

SUBSCRIPTION_HEADER = struct.Struct("<BH")
"""Numbers of the instance and of the subscription, before the message's name in the body of a subscription."""

FLAG_BITS, FORMAT, INFORMATION, PARTS, PARAMETER, DEFAULT = b"BFIMPQ"
"""Types of the records of definitions: PARTS is information in several records, DEFAULT that of a parameter."""

SUBSCRIPTION, UNSUBSCRIPTION, DATA, TEXT, TAGGED_TEXT, SYNC, DROPOUT = b"ARDLCSO"
"""Types of the records of data."""

FUTURE_TYPES = frozenset(b"EGHJKNTUVWXYZ")
"""Letters that may be types of records in a later version of the format."""

MAX_UNKNOWN_BYTES = 10_000
"""Largest length of a record that fits no definition, yet is passed over by its length; pyulog has the same bound."""

SYNC_MAGIC = bytes.fromhex("2F731320250CBB12")
"""Content of a mark of synchronisation."""

MAX_TEXT_BYTES = 1000
"""Largest length of a text; PX4's have up to 127 characters (msg/LogMessage.msg)."""

TEXT_LEVELS = b"01234567"
"""Levels of texts, as characters: those of syslog."""

NUMBER_BYTES_BY_KEY_TYPE = {type_name.encode(): count for type_name, count in NUMBER_BYTES.items()}
"""The same by the type as the key of a parameter has it, in bytes."""

KEY = re.compile(rb"(?P<type>\w++)(?P<array>\[\d*\])? [\x21-\x7e]+")
"""Key of an information or a parameter: a type, perhaps of an array, and a name."""

START_OF_DEFINITION = (
    rb"[\x04-\xff]\0A|..F[\x21-\x39\x3b-\x7e]{1,255}+:|\x08\0S|\x02\0[OR]|..[LC][0-7]|"
    rb"..(?:[IP]|[MQ].).(?:u?int(?:8|16|32|64)_t|float|double|bool|char)"
)
"""Beginnings of all records but those of data, for the search after damage.

A search for the mere letters would stop at each byte of a run of one letter. Names of messages may have 252 characters.
"""


KEY_OFFSETS = {
    INFORMATION: HEADER.size,
    PARAMETER: HEADER.size,
    PARTS: HEADER.size + 1,
    DEFAULT: HEADER.size + 1,
}
"""Offset of the length of the key in a record that has one; some have a byte of flags after the header."""


class RecordHeader(NamedTuple):
    """The header of a record."""

    length: int
    """Number of bytes after it."""
    record_type: int
    """Type of the record, a letter."""


class KeyedRun(NamedTuple):
    """Sound records of information and parameters that follow each other without a gap."""

    starts: Sequence[int]
    """Where each begins."""
    end: int
    """Where the last one ends."""


class Fit(Enum):
    """How a record fits the definitions of the file."""

    SOUND = auto()
    """It fits, and is kept."""
    UNUSED = auto()
    """It fits, and is left out."""
    UNKNOWN = auto()
    """There is no definition for it; by its length it may be a record."""
    DAMAGED = auto()
    """It does not fit."""


class RecordDefinitions:
    """The message definitions and subscriptions of a ULog file that were read so far; checks records against them.

    Attributes:
        content: Bytes of the file.
        formats: The definitions of messages.
        topics: Layout of the data records of each subscription, by its number, in the order of the file.
        instances: Number of the topic's instance that each subscription follows, by the subscription's number.
        lengths_by_number: The length that the header of a data record gives, by the number of its subscription
            (65536,); 0 where there is no such subscription.
    """

    def __init__(self, content: FileContent) -> None:
        """Starts with no definitions.

        Args:
            content: Bytes of the file.
        """
        self.content = content
        self.topics: dict[int, TopicLayout] = {}
        self.instances: dict[int, int] = {}
        self.lengths_by_number = np.zeros(1 << 16, dtype=np.uint16)
        self.formats = MessageFormats()
        self._record_start_pattern: re.Pattern[bytes] | None = None

    def header(self, offset: int) -> RecordHeader:
        """Returns the header at an offset; one that is cut off by the end of the file has length 0 and type 0."""
        if offset + HEADER.size > len(self.content):
            return RecordHeader(0, 0)
        return RecordHeader(*HEADER.unpack_from(self.content, offset))

    def record_end(self, offset: int) -> int:
        """Returns the offset at which the record at an offset ends, by its length."""
        return offset + HEADER.size + self.header(offset).length

    def fit(self, offset: int, end: int, header: RecordHeader | None = None) -> Fit:
        """Checks whether the record at an offset is consistent with the definitions of the file.

        Args:
            offset: Offset of the record in the file, bytes.
            end: Offset which the record must not exceed: the end of the file, or where data was appended to it.
            header: Header of the record, if it was read before.

        Returns:
            Whether the record is sound, unused by parsers, of an unknown type, or damaged.
        """
        length, record_type = header or self.header(offset)
        body_start = offset + HEADER.size
        if body_start + length > end:
            return Fit.DAMAGED
        if record_type == DATA:
            return self._fit_of_data(body_start, length)
        body = self.content[body_start : body_start + length]
        if record_type in KEY_OFFSETS:
            key_and_value = body[KEY_OFFSETS[record_type] - HEADER.size :]
            return _sound_or_damaged(_is_key_and_value(key_and_value))
        if record_type == FORMAT:
            parsed_format = parsed_format_of(body)
            # A second definition of the same name would replace the first.
            is_repeated = parsed_format is not None and parsed_format.name in self.formats
            return Fit.UNUSED if is_repeated else _sound_or_damaged(parsed_format is not None)
        if record_type == SUBSCRIPTION:
            return self._fit_of_subscription(body)
        if record_type == TEXT:
            return _sound_or_damaged(_is_text(body, stamp_offset=1))
        if record_type == TAGGED_TEXT:
            # The tag, two bytes, precedes the stamp.
            return _sound_or_damaged(_is_text(body, stamp_offset=3))
        if record_type == SYNC:
            return _sound_or_damaged(body == SYNC_MAGIC)
        if record_type == DROPOUT:
            return _sound_or_damaged(length == 2)
        if record_type == UNSUBSCRIPTION:
            return Fit.UNUSED if length == 2 else Fit.DAMAGED
        # A data record whose type letter is damaged must not pass for a record of an unknown type: with the right
        # letter it would have the length of its subscription.
        header_with_right_type = self.content[offset : offset + 2] + bytes([DATA]) + body[:2]
        is_data = self.data_length(header_with_right_type) is not None
        if record_type in FUTURE_TYPES and 0 < length <= MAX_UNKNOWN_BYTES and not is_data:
            return Fit.UNKNOWN
        return Fit.DAMAGED

    def keyed_run(self, offset: int, end: int) -> KeyedRun:
        """Finds a run of undamaged information and parameter records, each of which follows the one before directly.

        Such a record has a key, "float MC_ROLL_P", and a value. A log has about a thousand of them. They are checked
        here in one loop, which is faster than :meth:`fit` for each.

        Args:
            offset: Offset of the first record, bytes.
            end: Offset which no record must exceed: the end of the file, or where data was appended to it.

        Returns:
            Offsets of the records, and the offset after the last one, which is ``offset`` if there are none.
        """
        content = self.content
        starts = []
        while offset + HEADER.size <= end:
            length, record_type = HEADER.unpack_from(content, offset)
            record_end = offset + HEADER.size + length
            if record_type not in KEY_OFFSETS or record_end > end:
                break
            key_and_value = content[offset + KEY_OFFSETS[record_type] : record_end]
            if not _is_key_and_value(key_and_value):
                break
            starts.append(offset)
            offset = record_end
        return KeyedRun(starts, offset)

    def _fit_of_data(self, body_start: int, length: int) -> Fit:
        """Checks the length of a data record against the layout of its topic.

        Args:
            body_start: Offset of the subscription number, with which the body begins.
            length: Length of the body, bytes.

        Returns:
            Damaged if the length is wrong, unused if the message has no time stamp, unknown if the number has no
            subscription; otherwise sound.
        """
        if length < TOPIC_NUMBER_BYTES:
            return Fit.DAMAGED
        number_bytes = self.content[body_start : body_start + TOPIC_NUMBER_BYTES]
        number = int.from_bytes(number_bytes, "little")
        topic = self.topics.get(number)
        if topic is None:
            return Fit.UNKNOWN if length <= MAX_UNKNOWN_BYTES else Fit.DAMAGED
        if not topic.min_bytes <= length - TOPIC_NUMBER_BYTES <= topic.max_bytes:
            return Fit.DAMAGED
        return Fit.UNUSED if topic.stamp_offset is None else Fit.SOUND

    def _fit_of_subscription(self, body: bytes) -> Fit:
        """Checks a subscription against the definitions of messages and the earlier subscriptions.

        Args:
            body: Number of the instance (one byte), number of the subscription (two bytes), and name of the message.

        Returns:
            Damaged if the name is not valid, unused if the number has a subscription already, unknown if the message is
            not defined; otherwise sound.
        """
        name = body[SUBSCRIPTION_HEADER.size :]
        if len(name) > MAX_NAME_BYTES or NAME.fullmatch(name) is None:
            return Fit.DAMAGED
        _, number = SUBSCRIPTION_HEADER.unpack_from(body)
        if number in self.topics:
            # Parsers would begin the topic again, and lose its data up to here.
            return Fit.UNUSED
        return Fit.UNKNOWN if self.formats.layout(name.decode()) is None else Fit.SOUND

    def add(self, offset: int) -> None:
        """Adds the definition or subscription in a record of the file; other records change nothing.

        A definition (FORMAT) names the fields of a message. A subscription assigns a number to an instance of a topic;
        data records carry that number.

        Args:
            offset: Offset of the record, which is sound (:meth:`fit`).
        """
        length, record_type = self.header(offset)
        body_start = offset + HEADER.size
        body = self.content[body_start : body_start + length]
        if record_type == FORMAT:
            parsed_format = parsed_format_of(body)
            if parsed_format is not None:
                self.formats.add(parsed_format)
        elif record_type == SUBSCRIPTION:
            instance, number = SUBSCRIPTION_HEADER.unpack_from(body)
            topic = self.formats.layout(body[SUBSCRIPTION_HEADER.size :].decode())
            if topic is not None:
                self.topics[number] = topic
                self.instances[number] = instance
                if topic.stamp_offset is not None:
                    self.lengths_by_number[number] = TOPIC_NUMBER_BYTES + topic.min_bytes
                # The pattern of a record's start contains the numbers of all subscriptions.
                self._record_start_pattern = None

    def data_length(self, data_header: bytes) -> int | None:
        """Returns the number of bytes of a whole data record, header included, by its first five bytes.

        Args:
            data_header: Length of the body (2 bytes), type letter "D", and number of the subscription (2 bytes); fewer
                bytes at the end of the file.

        Returns:
            The number; None unless the subscription has records of this length.
        """
        if len(data_header) < DATA_HEADER.size:
            return None
        length, record_type, number = DATA_HEADER.unpack(data_header)
        is_data = record_type == DATA and length > 0 and self.lengths_by_number[number] == length
        return HEADER.size + length if is_data else None

    def possible_data_records(self, first: int, stop: int) -> PossibleRecords:
        """Finds all offsets in a range of the file that look like data records of the subscriptions read so far.

        The header of a data record is five bytes: its length, the letter D, and the number of a subscription, all of
        whose records have one length.

        Args:
            first: Offset of the first byte at which a record may begin.
            stop: Offset before which records begin; the last may end after it.

        Returns:
            Offset (n,) of the start of each possible record, and of the byte after it.
        """
        content = np.frombuffer(self.content, dtype=np.uint8)
        # All headers that begin in the range lie in these bytes.
        searched_bytes = content[first : stop + DATA_HEADER.size - 1]
        header_count = max(len(searched_bytes) - DATA_HEADER.size + 1, 0)
        # The letter is the third byte of a header. Headers begin where a D is two bytes later.
        letter_offset = HEADER.size - 1
        letters = searched_bytes[letter_offset : letter_offset + header_count]
        starts = np.flatnonzero(letters == DATA)
        headers = rows_of(searched_bytes, starts, DATA_HEADER.size).view(DATA_HEADER_FIELDS)[:, 0]
        lengths = headers["length"]
        lengths_of_subscriptions = self.lengths_by_number[headers["subscription"]]
        is_data = (lengths > 0) & (lengths == lengths_of_subscriptions)
        starts = starts[is_data] + first
        return PossibleRecords(starts, starts + HEADER.size + lengths[is_data])

    def record_start_pattern(self) -> re.Pattern[bytes]:
        """Returns a pattern of the bytes with which a record may begin, for the search after damage.

        A data record begins with its length, the letter D, and the number of one of the subscriptions read so far.
        ``START_OF_DEFINITION`` has the beginnings of all other records.
        """
        if self._record_start_pattern is None:
            numbers = [re.escape(number.to_bytes(2, "little")) for number in self.topics]
            # An empty list of numbers would match any data record.
            start_of_data = rb"..D(?:" + b"|".join(numbers) + rb")|" if numbers else b""
            # A lookahead matches without consuming bytes, so that the next match may begin at the next byte.
            pattern = rb"(?=" + start_of_data + START_OF_DEFINITION + rb")"
            self._record_start_pattern = re.compile(pattern, re.DOTALL)
        return self._record_start_pattern


def _is_key_and_value(content: bytes) -> bool:
    """Returns whether the body of an information or parameter record is a valid key and a value of the key's type.

    Args:
        content: The length of the key (one byte), the key with its type ("float MC_ROLL_P"), and the value.
    """
    if not content:
        return False
    key_end = 1 + content[0]
    key = KEY.fullmatch(content, 1, key_end)
    if key is None or key_end > len(content):
        return False
    # The length of the value is fixed only for a single number, not for arrays and texts.
    key_type, array = key.groups()
    number_bytes = NUMBER_BYTES_BY_KEY_TYPE.get(key_type)
    return array is not None or number_bytes is None or len(content) - key_end == number_bytes


def _is_text(body: bytes, stamp_offset: int) -> bool:
    """Returns whether the content of a record is a text with its level, its stamp, and no more than a text has."""
    text = body[stamp_offset + STAMP.size :]
    has_stamp = len(body) >= stamp_offset + STAMP.size
    return has_stamp and body[0] in TEXT_LEVELS and len(text) <= MAX_TEXT_BYTES and 0 not in text


def _sound_or_damaged(fits: bool) -> Fit:
    """Returns the fit of a record that is kept if it fits the definitions, and damaged otherwise."""
    return Fit.SOUND if fits else Fit.DAMAGED
