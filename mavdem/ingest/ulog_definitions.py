"""The definitions in a ULog file (fields of each message, number of each topic), and whether a record fits them.

A file defines its messages (the fields of each) and subscriptions (the number under which the records of one topic
follow). Other records have a layout of their own.

Layout: https://docs.px4.io/main/en/dev_log/ulog_file_format.html.
"""

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from mavdem.ingest.byte_rows import rows_of
from mavdem.ingest.contents import FileContent
from mavdem.ingest.record_runs import PossibleRecords
from mavdem.ingest.telemetry import MAX_FIELDS

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

STAMP = struct.Struct("<Q")
"""Time stamp of a record, µs since boot."""

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

NUMBER_TYPES: dict[str, np.dtype[Any]] = {
    "int8_t": np.dtype("<i1"),
    "uint8_t": np.dtype("<u1"),
    "bool": np.dtype("<i1"),
    "char": np.dtype("<i1"),
    "int16_t": np.dtype("<i2"),
    "uint16_t": np.dtype("<u2"),
    "int32_t": np.dtype("<i4"),
    "uint32_t": np.dtype("<u4"),
    "float": np.dtype("<f4"),
    "int64_t": np.dtype("<i8"),
    "uint64_t": np.dtype("<u8"),
    "double": np.dtype("<f8"),
}
"""How a number is stored, by its type: little-endian. Flags and characters are read as integers, as pyulog does."""

NUMBER_BYTES = {type_name: stored.itemsize for type_name, stored in NUMBER_TYPES.items()}
"""Number of bytes of a number, by its type."""

NUMBER_BYTES_BY_KEY_TYPE = {type_name.encode(): count for type_name, count in NUMBER_BYTES.items()}
"""The same by the type as the key of a parameter has it, in bytes."""

FIELD = re.compile(r"(\w+)(?:\[(\d{1,5})\])? (\w+)")
"""One field in a definition: its type, the number of its elements if it is an array, and its name."""

FIELD_LIST = re.compile(r"(?:\w++(?:\[\d{1,5}\])? \w++)?(?:;(?:\w++(?:\[\d{1,5}\])? \w++)?)*+")
"""All fields in a definition, with a semicolon between them; there may be nothing between two semicolons."""

NAME = re.compile(rb"[\x21-\x39\x3b-\x7e]+")
"""Name of a message: printable characters without the colon after it."""

MAX_NAME_BYTES = 255
"""Largest length of the name of a message: a choice; PX4's have up to some 40 characters."""

KEY = re.compile(rb"(?P<type>\w++)(?P<array>\[\d*\])? [\x21-\x7e]+")
"""Key of an information or a parameter: a type, perhaps of an array, and a name."""

START_OF_DEFINITION = (
    rb"[\x04-\xff]\0A|..F[\x21-\x39\x3b-\x7e]{1,255}+:|\x08\0S|\x02\0[OR]|..[LC][0-7]|"
    rb"..(?:[IP]|[MQ].).(?:u?int(?:8|16|32|64)_t|float|double|bool|char)"
)
"""Beginnings of all records but those of data, for the search after damage.

A search for the mere letters would stop at each byte of a run of one letter. Names of messages may have 252 characters.
"""


PADDING = "_padding"
"""Beginning of the names of fields that hold nothing."""

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


class _Field(NamedTuple):
    """One field in the definition of a message."""

    type_name: str
    """Its type: the type of a number, such as "float", or the name of another message."""
    elements: int
    """Number of elements of an array; 1 for a field that is not an array."""
    name: str
    """Its name."""


class KeyedRun(NamedTuple):
    """Sound records of information and parameters that follow each other without a gap."""

    starts: Sequence[int]
    """Where each begins."""
    end: int
    """Where the last one ends."""


class NumberField(NamedTuple):
    """A number in the data records of a topic."""

    name: str
    """Its name, such as ``q[0]`` for an element of an array, or ``current.lat`` in a message within the message."""
    type_name: str
    """Its type, a key of ``NUMBER_TYPES``."""
    offset: int
    """Number of bytes before it, without the header of the record."""


@dataclass(frozen=True)
class TopicLayout:
    """What the data records of one subscription look like, without their header and the subscription's number."""

    name: str
    """Name of the topic."""
    min_bytes: int
    """Number of bytes of all fields but the padding at the end, which PX4 does not write."""
    max_bytes: int
    """Number of bytes with that padding."""
    stamp_offset: int | None
    """Offset of the time stamp, bytes; None where there is none, so that the records are not used."""


class _MessageSize(NamedTuple):
    """What a message takes, with the messages in it."""

    numbers: int
    """Count of its numbers."""
    length: int
    """Number of their bytes."""
    has_distinct_names: bool
    """Whether no two fields of a message have one name, here and in the messages in it."""


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
        # The list of the fields of each message, as text, and parsed where it is needed: most have no subscription.
        self._formats: dict[str, str] = {}
        self._fields: dict[str, Sequence[_Field]] = {}
        # Layouts of messages by name: each is needed when a subscription is compared, and when it is learned.
        self._layouts: dict[str, TopicLayout | None] = {}
        self._sizes: dict[str, _MessageSize | None] = {}
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
            parsed_format = _parsed_format(body)
            # A second definition of the same name would replace the first.
            is_repeated = parsed_format is not None and parsed_format.name in self._formats
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
        return Fit.UNKNOWN if self._layout(name.decode()) is None else Fit.SOUND

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
            parsed_format = _parsed_format(body)
            if parsed_format is not None:
                self._formats[parsed_format.name] = parsed_format.fields
                # What was derived from the definitions so far may depend on this one, if messages are nested.
                self._fields.pop(parsed_format.name, None)
                self._layouts.clear()
                self._sizes.clear()
        elif record_type == SUBSCRIPTION:
            instance, number = SUBSCRIPTION_HEADER.unpack_from(body)
            topic = self._layout(body[SUBSCRIPTION_HEADER.size :].decode())
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

    def _layout(self, name: str) -> TopicLayout | None:
        """Returns the layout of a message's data records, or None (see ``_layout_of_format``)."""
        if name not in self._layouts:
            self._layouts[name] = self._layout_of_format(name)
        return self._layouts[name]

    def _layout_of_format(self, name: str) -> TopicLayout | None:
        """Returns the layout of a message's data records: their length, and where the time stamp is.

        Padding at the end, fields whose names begin with ``_padding``, is not always logged, so that a record has a
        minimal and a maximal length.

        Args:
            name: Name of the message ("vehicle_attitude").

        Returns:
            The layout; None if the definition or one that it contains is missing, or if it contains itself, has a field
            name twice, or has more than ``MAX_FIELDS`` numbers.
        """
        try:
            size = self._size_of_type(name)
        except RecursionError:
            # The message contains itself.
            return None
        # Even a short definition may announce very many numbers, since messages contain arrays of other messages.
        if name not in self._formats or size is None or size.numbers > MAX_FIELDS:
            return None
        if not size.has_distinct_names:
            names = [number.name for number in self.number_fields(name)]
            if len(set(names)) < len(names):
                return None
        min_bytes = size.length - self._padding_bytes(name)
        return TopicLayout(name, min_bytes, size.length, self._stamp_offset(name, min_bytes))

    def _padding_bytes(self, name: str) -> int:
        """Returns the number of bytes of the padding fields at the end of a message."""
        padding_bytes = 0
        for field in reversed(self._fields_of(name)):
            if not field.name.startswith(PADDING):
                break
            padding_bytes += self._length(field)
        return padding_bytes

    def _stamp_offset(self, name: str, min_bytes: int) -> int | None:
        """Returns the offset of the field ``timestamp`` in a message.

        Args:
            name: Name of the message ("vehicle_attitude").
            min_bytes: Its number of bytes without the padding at the end.

        Returns:
            The offset, bytes; None if the message has no such field, or too few bytes after it.
        """
        offset = 0
        for field in self._fields_of(name):
            # Parsers read eight bytes of the time stamp, even if it is declared with another type.
            is_stamp = field.name == "timestamp" and field.elements == 1
            if is_stamp and field.type_name in NUMBER_BYTES and offset + STAMP.size <= min_bytes:
                return offset
            offset += self._length(field)
        return None

    def _size_of_type(self, type_name: str) -> _MessageSize | None:
        """Returns the size of a type: of a number, or of a message with the messages nested in it.

        Args:
            type_name: The type of a number, such as "float", or the name of a message.

        Returns:
            Number of values, number of bytes, and whether no message has two fields of one name; None if the message or
            one nested in it is not defined.

        Raises:
            RecursionError: The message contains itself.
        """
        if type_name in NUMBER_BYTES:
            return _MessageSize(1, NUMBER_BYTES[type_name], has_distinct_names=True)
        if type_name not in self._formats:
            return None
        if type_name not in self._sizes:
            self._sizes[type_name] = self._size_of_fields(self._fields_of(type_name))
        return self._sizes[type_name]

    def _size_of_fields(self, fields: Sequence[_Field]) -> _MessageSize | None:
        """Returns the size of all fields of a message together.

        Args:
            fields: The fields, which may be arrays or nested messages.

        Returns:
            Number of values, number of bytes, and whether no message has two fields of one name, which parsers could
            not distinguish; None if a nested message is not defined.

        Raises:
            RecursionError: A nested message contains itself.
        """
        value_count = 0
        byte_count = 0
        has_distinct_names = len({field.name for field in fields}) == len(fields)
        for field in fields:
            element_size = self._size_of_type(field.type_name)
            if element_size is None:
                return None
            value_count += field.elements * element_size.numbers
            byte_count += field.elements * element_size.length
            has_distinct_names = has_distinct_names and element_size.has_distinct_names
        return _MessageSize(value_count, byte_count, has_distinct_names)

    def _length(self, field: _Field) -> int:
        """Returns the number of bytes of a field whose type is defined."""
        size = self._size_of_type(field.type_name)
        return field.elements * size.length if size is not None else 0

    def number_fields(self, name: str) -> Sequence[NumberField]:
        """Lists the numbers in a message, nested messages included, without the padding at the end.

        Args:
            name: Name of the message, which must have a layout.

        Returns:
            Name, type and offset of each number, in the order of the file.
        """
        numbers: list[NumberField] = []
        self._list_numbers(name, "", numbers)
        while numbers and numbers[-1].name.startswith(PADDING):
            numbers.pop()
        return numbers

    def _list_numbers(self, type_name: str, name: str, numbers: list[NumberField]) -> None:
        """Appends the numbers in a field to a list, with their offsets, by recursion into nested messages and arrays.

        A field "position" of a message type with "x" and "y" gives the numbers "position.x" and "position.y".

        Args:
            type_name: Type of the field: the type of a number, or the name of a message.
            name: Name of the field; empty for a whole message.
            numbers: The numbers before the field in the record, to which the numbers in the field are appended.
        """
        if type_name in NUMBER_BYTES:
            offset = 0
            if numbers:
                previous = numbers[-1]
                offset = previous.offset + NUMBER_BYTES[previous.type_name]
            numbers.append(NumberField(name, type_name, offset))
            return
        for field in self._fields_of(type_name):
            field_name = f"{name}.{field.name}" if name else field.name
            for element in range(field.elements):
                element_name = f"{field_name}[{element}]" if field.elements > 1 else field_name
                self._list_numbers(field.type_name, element_name, numbers)

    def _fields_of(self, name: str) -> Sequence[_Field]:
        """Returns the fields of a message, which are parsed when they are first used.

        Args:
            name: Name of the message ("vehicle_attitude").

        Returns:
            The fields in the order of the definition; none if the message is not defined.
        """
        if name not in self._fields:
            fields = []
            for type_name, elements, field_name in FIELD.findall(self._formats.get(name, "")):
                # ULog parsers read an array of 0 elements as a single number.
                fields.append(_Field(type_name, max(int(elements or 1), 1), field_name))
            self._fields[name] = fields
        return self._fields[name]

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


class _ParsedFormat(NamedTuple):
    """The definition of a message."""

    name: str
    """Its name."""
    fields: str
    """Its fields, as the file lists them."""


# Each definition is parsed when it is compared with those before, and again when it is learned.
@lru_cache(maxsize=1)
def _parsed_format(body: bytes) -> _ParsedFormat | None:
    """Parses the definition of a message.

    Args:
        body: The definition, "name:type field;type[4] field;".

    Returns:
        Name and fields of the message; None if the definition is damaged.
    """
    name_end = body.find(b":", 0, MAX_NAME_BYTES + 1)
    if name_end < 0 or NAME.fullmatch(body, 0, name_end) is None:
        return None
    fields = body[name_end + 1 :].decode("latin-1")
    if FIELD_LIST.fullmatch(fields) is None:
        return None
    return _ParsedFormat(body[:name_end].decode(), fields)


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
