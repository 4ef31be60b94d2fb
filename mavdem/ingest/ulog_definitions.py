"""The definitions in a ULog file, and checking whether a record fits them.

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

DATA_HEADER_FIELDS = np.dtype([("length", "<u2"), ("kind", "u1"), ("subscription", "<u2")])
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

NUMBER_BYTES = {kind: stored.itemsize for kind, stored in NUMBER_TYPES.items()}
"""Number of bytes of a number, by its type."""

NUMBER_BYTES_BY_KEY_TYPE = {kind.encode(): count for kind, count in NUMBER_BYTES.items()}
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
    kind: int
    """Type of the record, a letter."""


class _Field(NamedTuple):
    """One field in the definition of a message."""

    kind: str
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
    kind: str
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
    """The definitions of a ULog file that were read so far, and the records by their offsets.

    Attributes:
        content: Bytes of the file.
        topics: Layout of the data records of each subscription, by its number, in the order of the file.
        instances: Number of the topic's instance that each subscription follows, by the subscription's number.
        lengths_by_number: The length that the header of a data record gives, by the number of its subscription
            (65536,); 0 where there is no such subscription.
    """

    def __init__(self, content: FileContent) -> None:
        """Begins without any definition.

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
        self._record_start: re.Pattern[bytes] | None = None

    def header(self, position: int) -> RecordHeader:
        """Returns the header at an offset; one that is cut off by the end of the file has length 0 and type 0."""
        if position + HEADER.size > len(self.content):
            return RecordHeader(0, 0)
        return RecordHeader(*HEADER.unpack_from(self.content, position))

    def next_position(self, position: int) -> int:
        """Returns the offset at which the record at an offset ends, by its length."""
        return position + HEADER.size + self.header(position).length

    def fit(self, position: int, end: int, header: RecordHeader | None = None) -> Fit:
        """Checks whether the record at an offset is consistent with the definitions of the file.

        Args:
            position: Offset of the record, bytes.
            end: Offset of the end of this part of the file, which the record must not exceed.
            header: Header of the record, if it was read before.

        Returns:
            Whether the record is sound, unused by parsers, of an unknown kind, or damaged.
        """
        length, kind = header or self.header(position)
        body_start = position + HEADER.size
        if body_start + length > end:
            return Fit.DAMAGED
        if kind == DATA:
            return self._fit_of_data(body_start, length)
        body = self.content[body_start : body_start + length]
        if kind in KEY_OFFSETS:
            return _fit_if(fits=_is_key_and_value(body[KEY_OFFSETS[kind] - HEADER.size :]))
        if kind == FORMAT:
            parsed_format = _parsed_format(body)
            # A second definition of the same name would replace the first.
            is_repeated = parsed_format is not None and parsed_format.name in self._formats
            return Fit.UNUSED if is_repeated else _fit_if(fits=parsed_format is not None)
        if kind == SUBSCRIPTION:
            return self._fit_of_subscription(body)
        if kind == TEXT:
            return _fit_if(fits=_is_text(body, stamp_offset=1))
        if kind == TAGGED_TEXT:
            # The tag, two bytes, precedes the stamp.
            return _fit_if(fits=_is_text(body, stamp_offset=3))
        if kind == SYNC:
            return _fit_if(fits=body == SYNC_MAGIC)
        if kind == DROPOUT:
            return _fit_if(fits=length == 2)
        if kind == UNSUBSCRIPTION:
            return Fit.UNUSED if length == 2 else Fit.DAMAGED
        # A data record whose letter is damaged must not pass for a record of an unknown kind: with the right letter it
        # would have the length of its subscription.
        data_header = self.content[position : position + 2] + bytes([DATA]) + body[:2]
        is_data = self.data_length(data_header) is not None
        if kind in FUTURE_TYPES and 0 < length <= MAX_UNKNOWN_BYTES and not is_data:
            return Fit.UNKNOWN
        return Fit.DAMAGED

    def keyed_run(self, position: int, end: int) -> KeyedRun:
        """Finds sound information and parameter records that follow each other, of which a log has about a thousand.

        They are checked here in one loop, which is faster than :meth:`fit` for each.

        Args:
            position: Offset of the first record.
            end: Offset of the end of this part of the file, which no record must exceed.

        Returns:
            Offsets of the records, and the offset after the last one, which is ``position`` if there are none.
        """
        content = self.content
        starts = []
        while position + HEADER.size <= end:
            length, kind = HEADER.unpack_from(content, position)
            next_position = position + HEADER.size + length
            if kind not in KEY_OFFSETS or next_position > end:
                break
            if not _is_key_and_value(content[position + KEY_OFFSETS[kind] : next_position]):
                break
            starts.append(position)
            position = next_position
        return KeyedRun(starts, position)

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

    def learn(self, position: int) -> None:
        """Adds a definition or subscription of the file; other records change nothing.

        Args:
            position: Offset of the record, which is sound (:meth:`fit`).
        """
        length, kind = self.header(position)
        body_start = position + HEADER.size
        body = self.content[body_start : body_start + length]
        if kind == FORMAT:
            parsed_format = _parsed_format(body)
            if parsed_format is not None:
                self._formats[parsed_format.name] = parsed_format.fields
                # Layouts and sizes of other messages may depend on this definition.
                self._fields.pop(parsed_format.name, None)
                self._layouts.clear()
                self._sizes.clear()
        elif kind == SUBSCRIPTION:
            instance, number = SUBSCRIPTION_HEADER.unpack_from(body)
            topic = self._layout(body[SUBSCRIPTION_HEADER.size :].decode())
            if topic is not None:
                self.topics[number] = topic
                self.instances[number] = instance
                self._record_start = None
                if topic.stamp_offset is not None:
                    self.lengths_by_number[number] = TOPIC_NUMBER_BYTES + topic.min_bytes

    def data_length(self, data_header: bytes) -> int | None:
        """Returns the number of bytes of a whole data record, header included.

        Args:
            data_header: The first five bytes of the record, or fewer at the end of the file.

        Returns:
            The number; None if it is no header of a data record.
        """
        if len(data_header) < DATA_HEADER.size:
            return None
        length, kind, number = DATA_HEADER.unpack(data_header)
        is_of_topic = kind == DATA and length > 0 and self.lengths_by_number[number] == length
        return HEADER.size + length if is_of_topic else None

    def possible_data_records(self, first: int, stop: int) -> PossibleRecords:
        """Finds offsets that look like data records of the subscriptions read so far.

        The header of a data record is five bytes: its length, the letter D, and the number of a subscription, all of
        whose records have one length.

        Args:
            first: Offset of the first byte at which a record may begin.
            stop: Offset before which records begin; the last may end after it.

        Returns:
            Offset (n,) of the start of each possible record, and of the byte after it.
        """
        # The bytes of all headers that begin in the range, up to the end of the last header.
        content = np.frombuffer(self.content, dtype=np.uint8)
        header_bytes = content[first : stop + DATA_HEADER.size - 1]
        header_count = max(len(header_bytes) - DATA_HEADER.size + 1, 0)
        letter_offset = HEADER.size - 1
        letters = header_bytes[letter_offset : letter_offset + header_count]
        starts = np.flatnonzero(letters == DATA)
        headers = rows_of(header_bytes, starts, DATA_HEADER.size).view(DATA_HEADER_FIELDS)[:, 0]
        lengths = headers["length"]
        is_data = (lengths > 0) & (self.lengths_by_number[headers["subscription"]] == lengths)
        starts = starts[is_data] + first
        return PossibleRecords(starts, starts + HEADER.size + lengths[is_data])

    def _layout(self, name: str) -> TopicLayout | None:
        """Returns the layout of a message's data records, or None (see ``_layout_of_format``)."""
        if name not in self._layouts:
            self._layouts[name] = self._layout_of_format(name)
        return self._layouts[name]

    def _layout_of_format(self, name: str) -> TopicLayout | None:
        """Returns the layout of a message's data records.

        Padding at the end, fields whose names begin with ``_padding``, is not always logged, so that a record has a
        minimal and a maximal length.

        Args:
            name: Name of the message.

        Returns:
            The layout; None if the definition or one that it contains is missing, or if it contains itself, has a field
            name twice, or has more than ``MAX_FIELDS`` numbers.
        """
        try:
            size = self._size(name)
        except RecursionError:
            # The message contains itself.
            return None
        # Even a short definition may announce very many numbers, since messages contain arrays of other messages.
        if name not in self._formats or size is None or size.numbers > MAX_FIELDS:
            return None
        if not size.has_distinct_names:
            numbers = [number.name for number in self.number_fields(name)]
            if len(set(numbers)) < len(numbers):
                return None
        fields = self._fields_of(name)
        min_bytes = size.length
        for field in reversed(fields):
            if not field.name.startswith(PADDING):
                break
            min_bytes -= self._length(field)
        stamp_offset = None
        offset = 0
        for field in fields:
            # Parsers read eight bytes of the time stamp, even if it is declared with another type.
            is_stamp = field.name == "timestamp" and field.elements == 1
            if is_stamp and field.kind in NUMBER_BYTES and offset + STAMP.size <= min_bytes:
                stamp_offset = offset
                break
            offset += self._length(field)
        return TopicLayout(name, min_bytes, size.length, stamp_offset)

    def _size(self, kind: str) -> _MessageSize | None:
        """Returns the number of values and of bytes of a number or a message; None if a definition is missing.

        Args:
            kind: The message's name, or the type of a number.

        Returns:
            Number of values, number of bytes, and whether no field name occurs twice; or None.

        Raises:
            RecursionError: The message contains itself.
        """
        if kind in NUMBER_BYTES:
            return _MessageSize(1, NUMBER_BYTES[kind], has_distinct_names=True)
        if kind not in self._formats:
            return None
        if kind not in self._sizes:
            self._sizes[kind] = self._size_of_fields(self._fields_of(kind))
        return self._sizes[kind]

    def _size_of_fields(self, fields: Sequence[_Field]) -> _MessageSize | None:
        """Returns the number of values and of bytes of all fields together; None if a definition is missing.

        Args:
            fields: Fields of a message, which may be arrays or nested messages.

        Returns:
            Number of values, number of bytes, and whether no field name occurs twice; or None.

        Raises:
            RecursionError: A nested message contains itself.
        """
        numbers = 0
        length = 0
        has_distinct_names = len({field.name for field in fields}) == len(fields)
        for field in fields:
            size = self._size(field.kind)
            if size is None:
                return None
            numbers += field.elements * size.numbers
            length += field.elements * size.length
            has_distinct_names = has_distinct_names and size.has_distinct_names
        return _MessageSize(numbers, length, has_distinct_names)

    def _length(self, field: _Field) -> int:
        """Returns the number of bytes of a field whose type is defined."""
        size = self._size(field.kind)
        return field.elements * size.length if size is not None else 0

    def number_fields(self, name: str) -> Sequence[NumberField]:
        """Lists the numbers in a message, those of nested messages included, without the padding at the end.

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

    def _list_numbers(self, kind: str, name: str, numbers: list[NumberField]) -> None:
        """Appends all numbers of a message, or of a field of one, to ``numbers``, by recursion into nested messages.

        Args:
            kind: The message's name, or the type of a number.
            name: Name of the field; empty for a whole message.
            numbers: List of the numbers before it, to which its own are appended.
        """
        if kind in NUMBER_BYTES:
            offset = 0
            if numbers:
                offset = numbers[-1].offset + NUMBER_BYTES[numbers[-1].kind]
            numbers.append(NumberField(name, kind, offset))
            return
        for field in self._fields_of(kind):
            field_name = f"{name}.{field.name}" if name else field.name
            for element in range(field.elements):
                element_name = f"{field_name}[{element}]" if field.elements > 1 else field_name
                self._list_numbers(field.kind, element_name, numbers)

    def _fields_of(self, name: str) -> Sequence[_Field]:
        """Returns the fields of a message, which are parsed when they are first used.

        Args:
            name: Name of the message.

        Returns:
            The fields in the order of the definition; none if the message is not defined.
        """
        if name not in self._fields:
            fields = []
            for kind, elements, field_name in FIELD.findall(self._formats.get(name, "")):
                # ULog parsers read an array of 0 elements as a single number.
                fields.append(_Field(kind, max(int(elements or 1), 1), field_name))
            self._fields[name] = fields
        return self._fields[name]

    def record_start_pattern(self) -> re.Pattern[bytes]:
        """Returns the pattern of bytes with which a record may begin, by the subscriptions that were read so far."""
        if self._record_start is None:
            numbers = [re.escape(number.to_bytes(2, "little")) for number in self.topics]
            # An empty list of numbers would match any data record.
            start_of_data = rb"..D(?:" + b"|".join(numbers) + rb")|" if numbers else b""
            # A lookahead matches without consuming bytes, so that the next match may begin at the next byte.
            pattern = rb"(?=" + start_of_data + START_OF_DEFINITION + rb")"
            self._record_start = re.compile(pattern, re.DOTALL)
        return self._record_start


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


def _fit_if(*, fits: bool) -> Fit:
    """Returns the fit of a record that is kept if it fits."""
    return Fit.SOUND if fits else Fit.DAMAGED
