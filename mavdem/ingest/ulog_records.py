"""The sound records of a ULog file: what damage, an old layout or a cut would make a parser misread is left out.

A ULog is a chain of records, each with a header of three bytes: its length (uint16) and its type, a letter. There are
no checksums, and files before PX4 1.11 have no marks of synchronisation, so that one wrong length would shift all that
follows. Here a record must fit the definitions of the file; where one does not, the search goes on byte by byte until
several records in a row fit. The rest of the file is then a sound ULog, which any parser reads.

Layout: https://docs.px4.io/main/en/dev_log/ulog_file_format.html.
"""

import re
import struct
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from functools import cache
from typing import NamedTuple

from mavdem.ingest.telemetry import MAX_FIELDS

FILE_HEADER_BYTES = 16
"""Number of bytes before the first record: the magic, the version of the format and the time of the start."""

HEADER = struct.Struct("<HB")
"""Header of each record: number of bytes behind it, and its type."""

DATA_HEADER = struct.Struct("<HBH")
"""Header of a data record, and the number of its subscription."""

STAMP = struct.Struct("<Q")
"""Time stamp of a record, µs since boot."""

MICROSECONDS = 1e6
"""Microseconds in a second."""

FLAG_BITS, FORMAT, INFORMATION, PARTS, PARAMETER, DEFAULT = b"BFIMPQ"
"""Types of the records of definitions: PARTS is information in several records, DEFAULT that of a parameter."""

SUBSCRIPTION, UNSUBSCRIPTION, DATA, TEXT, TAGGED_TEXT, SYNC, DROPOUT = b"ARDLCSO"
"""Types of the records of data."""

TYPE_BYTES = re.compile(b"[BFIMPQARDLCSO]")
"""Any type of a record."""

FUTURE_TYPES = frozenset(b"EGHJKNTUVWXYZ")
"""Letters that may be types of records in a later version of the format."""

UNWRITTEN_BYTES = re.compile(rb"\0+|\xff+")
"""What a card holds where nothing was written."""

MAX_UNKNOWN_BYTES = 10_000
"""Largest length of a record that fits no definition, yet is passed over by its length; pyulog has the same bound."""

SYNC_MAGIC = bytes.fromhex("2F731320250CBB12")
"""Content of a mark of synchronisation."""

FLAG_BYTES = 40
"""Number of bytes of the flags: 8 compatible ones, 8 incompatible ones, and three offsets of appended data."""

APPENDED_DATA_FLAG = 1
"""Bit of the first incompatible flag: data was appended, at the offsets behind the flags."""

MAX_TEXT_BYTES = 1000
"""Largest length of a text; PX4's have up to 127 characters (msg/LogMessage.msg)."""

TEXT_LEVELS = b"01234567"
"""Levels of texts, as characters: those of syslog."""

NUMBER_BYTES = {
    "int8_t": 1,
    "uint8_t": 1,
    "bool": 1,
    "char": 1,
    "int16_t": 2,
    "uint16_t": 2,
    "int32_t": 4,
    "uint32_t": 4,
    "float": 4,
    "int64_t": 8,
    "uint64_t": 8,
    "double": 8,
}
"""Number of bytes of a number, by its type."""

FIELD = re.compile(r"(\w+)(?:\[(\d{1,5})\])? (\w+)")
"""One field in a definition: its type, the number of its elements if it is an array, and its name."""

NAME = re.compile(rb"[\x21-\x39\x3b-\x7e]+")
"""Name of a message: printable characters without the colon behind it."""

MAX_NAME_BYTES = 255
"""Largest length of the name of a message: a choice; PX4's have up to some 40 characters."""

KEY = re.compile(rb"(\w++)(\[\d*\])? [\x21-\x7e]+")
"""Key of an information or a parameter: a type, perhaps of an array, and a name."""

START_OF_DEFINITION = (
    rb"[\x04-\xff]\0A|..F[\x21-\x39\x3b-\x7e]{1,255}+:|\x08\0S|\x02\0[OR]|..[LC][0-7]|"
    rb"..(?:[IP]|[MQ].).(?:u?int(?:8|16|32|64)_t|float|double|bool|char)"
)
"""Beginnings of all records but those of data, for the search behind damage.

A search for the mere letters would stop at each byte of a run of one letter. Names of messages may have 252 characters.
"""

RECORDS_OF_CHAIN = 5
"""Number of records in a row that must fit the definitions for the search after damage to end: a choice.

A data record fits by chance at one place of 2^40 / (number of topics): three random records would be enough. Five cost
nothing where the file is sound.
"""

MAX_UNKNOWN_RECORDS = 20
"""Number of records without a definition that such a chain may contain: a choice."""


class RecordLoss(NamedTuple):
    """What could not be read of a damaged file."""

    places: int = 0
    """Number of damaged places."""
    lost_bytes: int = 0
    """Number of bytes that were left out there."""
    lost_seconds: float = 0.0
    """Sum of the times, s, between the last record before each place and the first one behind it."""


class SoundRecords(NamedTuple):
    """A ULog file without its damaged places."""

    content: bytes
    """The file; if nothing was to be left out, the very one that was given."""
    loss: RecordLoss
    """What was lost by damage."""


def sound_records(content: bytes) -> SoundRecords:
    """Leaves out of a ULog file what does not fit its definitions.

    Also left out are records that parsers stumble over though they are sound: those of a topic without a time stamp,
    repeated subscriptions and definitions, and types of records that this version of the format does not have. Data
    that was appended after a crash follows the other data at once.

    Args:
        content: A file that begins with the magic of ULog.

    Returns:
        The sound records, and what was lost.
    """
    scan = _RecordScan(content)
    scan.run()
    return SoundRecords(scan.sound_content(), scan.loss)


class _Header(NamedTuple):
    """The header of a record."""

    length: int
    """Number of bytes behind it."""
    kind: int
    """Type of the record, a letter."""


class _Field(NamedTuple):
    """One field in the definition of a message."""

    kind: str
    """Its type: that of a number, or the name of another message."""
    elements: int
    """Number of elements of an array; 1 for a field that is none."""
    name: str
    """Its name."""


@dataclass(frozen=True)
class _Topic:
    """What the data records of one subscription look like, without their header and the subscription's number."""

    min_bytes: int
    """Number of bytes of all fields but the padding at the end, which PX4 does not write."""
    max_bytes: int
    """Number of bytes with that padding."""
    stamp_offset: int | None
    """Offset of the time stamp, bytes; None where there is none, so that the records are not used."""


class _Fit(Enum):
    """How a record fits the definitions of the file."""

    SOUND = auto()
    """It fits, and is kept."""
    UNUSED = auto()
    """It fits, and is left out."""
    UNKNOWN = auto()
    """There is no definition for it; by its length it may be a record."""
    DAMAGED = auto()
    """It does not fit."""


class _RecordScan:
    """One pass over a ULog file that finds its records.

    Attributes:
        content: The file.
        loss: What was lost by damage so far.
    """

    def __init__(self, content: bytes) -> None:
        """Prepares the pass.

        Args:
            content: A file that begins with the magic of ULog.
        """
        self.content = content
        self.loss = RecordLoss()
        # Parts of the file that are kept, each from a first byte to the one behind the last.
        self._kept: list[slice] = [slice(0, FILE_HEADER_BYTES)]
        self._formats: dict[str, Sequence[_Field]] = {}
        self._topics: dict[int, _Topic] = {}
        self._subscriptions: dict[int, bytes] = {}
        # Length of a whole data record by its first five bytes. These are the same in all records of a subscription,
        # so that one look-up is all that a sound record costs.
        self._data_lengths: dict[bytes, int] = {}
        self._record_start: re.Pattern[bytes] | None = None
        self._flags = b""

    def run(self) -> None:
        """Finds the records of the whole file, part by part where data was appended to it."""
        start = FILE_HEADER_BYTES
        header = self.content[start : start + HEADER.size]
        if header == HEADER.pack(FLAG_BYTES, FLAG_BITS):
            flags_end = start + HEADER.size + FLAG_BYTES
            self._flags = self.content[start:flags_end]
            start = flags_end
        for end in [*self._appended_offsets(start), len(self.content)]:
            self._run_part(start, end)
            start = end

    def sound_content(self) -> bytes:
        """Returns the file made of the records that are kept."""
        flags = self._flags_without_offsets()
        first_record = FILE_HEADER_BYTES + len(flags)
        is_whole = self._kept[1:] == [slice(first_record, len(self.content))]
        if is_whole and flags == self._flags:
            return self.content
        pieces = [self.content[part] for part in self._kept]
        pieces.insert(1, flags)
        return b"".join(pieces)

    def _appended_offsets(self, first_record: int) -> list[int]:
        """Returns where data was appended, ascending; none where the flags say so, or are damaged."""
        if not self._flags:
            return []
        values = struct.unpack("<8B8B3Q", self._flags[HEADER.size :])
        first_incompatible_flag = values[8]
        offsets = [offset for offset in values[16:] if offset]
        is_ascending = offsets == sorted(set(offsets))
        lies_in_file = all(first_record < offset < len(self.content) for offset in offsets)
        if first_incompatible_flag & APPENDED_DATA_FLAG and is_ascending and lies_in_file:
            return offsets
        return []

    def _flags_without_offsets(self) -> bytes:
        """Returns the record of the flags for a file whose appended data follows the rest; empty without flags."""
        flags = bytearray(self._flags)
        if flags:
            first_incompatible_flag = HEADER.size + 8
            first_offset = HEADER.size + 16
            flags[first_incompatible_flag] &= ~APPENDED_DATA_FLAG
            flags[first_offset:] = bytes(len(flags) - first_offset)
        return bytes(flags)

    def _run_part(self, start: int, end: int) -> None:
        """Finds the records between two offsets.

        A record that is cut by the end is left out; that is no damage, since logs usually end so.

        Args:
            start: Offset of the first record.
            end: Offset at which the part ends, or another one was appended.
        """
        content = self.content
        data_lengths = self._data_lengths
        # Where the records begin that were found last, of the run of sound records that is being read.
        recent: deque[int] = deque(maxlen=RECORDS_OF_CHAIN)
        run_start = position = start
        while position < end:
            # This loop runs once for each data record of the file.
            length = data_lengths.get(content[position : position + DATA_HEADER.size])
            if length is not None:
                recent.append(position)
                position += length
                continue
            fit = self._fit(position, end)
            next_position = self._next_position(position)
            if fit is _Fit.UNKNOWN and not self._is_whole_unknown_record(position, end):
                fit = _Fit.DAMAGED
            if fit is _Fit.SOUND:
                self._learn(position)
                recent.append(position)
                position = next_position
                continue
            omitted = slice(position, next_position)
            if fit is _Fit.DAMAGED:
                omitted = self._damaged_place(position, end, recent)
            elif fit is _Fit.UNKNOWN and content[position + 2] == DATA:
                # What the file says of this subscription was lost by damage before.
                self._add_loss(0, omitted.stop - omitted.start, 0.0)
            self._kept.append(slice(run_start, omitted.start))
            run_start = position = omitted.stop
            recent.clear()
        if position > end and recent:
            # The last record is cut off.
            position = recent[-1]
        self._kept.append(slice(run_start, position))

    def _header(self, position: int) -> _Header:
        """Returns the header at an offset; one that is cut off by the end of the file has length 0 and type 0."""
        if position + HEADER.size > len(self.content):
            return _Header(0, 0)
        return _Header(*HEADER.unpack_from(self.content, position))

    def _next_position(self, position: int) -> int:
        """Returns where the record at an offset ends, by its length."""
        return position + HEADER.size + self._header(position).length

    def _fit(self, position: int, end: int) -> _Fit:
        """Compares the record at an offset with the definitions of the file.

        Args:
            position: Offset of the record.
            end: Offset at which its part of the file ends; a record that goes beyond does not fit.
        """
        length, kind = self._header(position)
        body_start = position + HEADER.size
        if body_start + length > end:
            return _Fit.DAMAGED
        if kind == DATA:
            return self._fit_of_data(body_start, length)
        body = self.content[body_start : body_start + length]
        if kind == FORMAT:
            parsed = _parsed_format(body)
            # A second definition of the same name would replace the first.
            is_repeated = parsed is not None and parsed.name in self._formats
            return _Fit.UNUSED if is_repeated else _fit_if(parsed is not None)
        if kind == SUBSCRIPTION:
            return self._fit_of_subscription(body)
        if kind in (INFORMATION, PARAMETER):
            return _fit_if(_is_key_and_value(body))
        if kind in (PARTS, DEFAULT):
            # A byte of flags comes before the key.
            return _fit_if(_is_key_and_value(body[1:]))
        if kind == TEXT:
            return _fit_if(_is_text(body, stamp_offset=1))
        if kind == TAGGED_TEXT:
            # The tag, two bytes, comes before the stamp.
            return _fit_if(_is_text(body, stamp_offset=3))
        if kind == SYNC:
            return _fit_if(body == SYNC_MAGIC)
        if kind == DROPOUT:
            return _fit_if(length == 2)
        if kind == UNSUBSCRIPTION:
            return _Fit.UNUSED if length == 2 else _Fit.DAMAGED
        is_data = (
            self.content[position : position + 2] + bytes([DATA]) + body[:2] in self._data_lengths
        )
        if kind in FUTURE_TYPES and 0 < length <= MAX_UNKNOWN_BYTES and not is_data:
            return _Fit.UNKNOWN
        return _Fit.DAMAGED

    def _fit_of_data(self, body_start: int, length: int) -> _Fit:
        """Compares a data record with what its subscription says.

        Args:
            body_start: Offset of the number of the subscription.
            length: Number of bytes from there on.
        """
        if length < 2:
            return _Fit.DAMAGED
        number = int.from_bytes(self.content[body_start : body_start + 2], "little")
        topic = self._topics.get(number)
        if topic is None:
            return _Fit.UNKNOWN if length <= MAX_UNKNOWN_BYTES else _Fit.DAMAGED
        if not topic.min_bytes <= length - 2 <= topic.max_bytes:
            return _Fit.DAMAGED
        return _Fit.UNUSED if topic.stamp_offset is None else _Fit.SOUND

    def _fit_of_subscription(self, body: bytes) -> _Fit:
        """Compares a subscription with the definitions of messages."""
        name = body[3:]
        if len(name) > MAX_NAME_BYTES or NAME.fullmatch(name) is None:
            return _Fit.DAMAGED
        if int.from_bytes(body[1:3], "little") in self._topics:
            # Parsers would begin the topic anew and lose what came before.
            return _Fit.UNUSED
        return _Fit.UNKNOWN if self._topic_of_format(name.decode()) is None else _Fit.SOUND

    def _learn(self, position: int) -> None:
        """Enters a sound record that defines a message, or subscribes to one."""
        length, kind = self._header(position)
        body_start = position + HEADER.size
        body = self.content[body_start : body_start + length]
        if kind == FORMAT:
            parsed = _parsed_format(body)
            if parsed is not None:
                self._formats[parsed.name] = parsed.fields
        elif kind == SUBSCRIPTION:
            number = int.from_bytes(body[1:3], "little")
            topic = self._topic_of_format(body[3:].decode())
            if topic is not None:
                self._topics[number] = topic
                self._record_start = None
                if topic.stamp_offset is not None:
                    data_header = DATA_HEADER.pack(topic.min_bytes + 2, DATA, number)
                    self._data_lengths[data_header] = DATA_HEADER.size + topic.min_bytes

    def _topic_of_format(self, name: str) -> _Topic | None:
        """Returns what the data records of a message look like.

        Returns:
            None where its definition is missing, contains one that is missing, contains itself, has a name twice, or
            has more than ``MAX_FIELDS`` numbers.
        """
        if name not in self._formats or not self._is_of_usual_size(name):
            return None
        fields = self._numbers(name)
        if fields is None or len({field.name for field in fields}) < len(fields):
            return None
        max_bytes = sum(NUMBER_BYTES[field.kind] for field in fields)
        while fields and fields[-1].name.startswith("_padding"):
            fields.pop()
        stamp_offset = None
        offset = 0
        for field in fields:
            # Parsers read eight bytes, whatever the type of the time stamp is.
            if field.name == "timestamp":
                stamp_offset = offset
            offset += NUMBER_BYTES[field.kind]
        if stamp_offset is not None and stamp_offset + STAMP.size > offset:
            stamp_offset = None
        return _Topic(offset, max_bytes, stamp_offset)

    def _is_of_usual_size(self, name: str) -> bool:
        """Returns whether a message has at most ``MAX_FIELDS`` numbers, so that memory suffices to decode it.

        Messages may contain other messages and arrays of them, so that a short definition can announce any number of
        numbers. These are counted through all levels.
        """

        @cache
        def number_count(kind: str) -> int:
            """Returns how many numbers a field of this type has: a message's type, or that of a number."""
            count = 0
            for field in self._formats.get(kind, ()):
                count += field.elements * number_count(field.kind)
            return count or 1

        try:
            return number_count(name) <= MAX_FIELDS
        except RecursionError:
            return False

    def _numbers(self, kind: str, name: str = "") -> list[_Field] | None:
        """Lists all numbers of a message or of a field of one, in the order of the file.

        Args:
            kind: The message's name, or the type of a number.
            name: Name of the field; empty for a whole message.

        Returns:
            A field for each number; None where a definition is missing.
        """
        if kind in NUMBER_BYTES:
            return [_Field(kind, 1, name)]
        if kind not in self._formats:
            return None
        numbers = []
        for field in self._formats[kind]:
            field_name = f"{name}.{field.name}" if name else field.name
            for element in range(field.elements):
                element_name = f"{field_name}[{element}]" if field.elements > 1 else field_name
                element_numbers = self._numbers(field.kind, element_name)
                if element_numbers is None:
                    return None
                numbers.extend(element_numbers)
        return numbers

    def _is_chain(self, position: int, end: int, *, may_begin_unknown: bool = False) -> bool:
        """Returns whether ``RECORDS_OF_CHAIN`` records from an offset on fit the definitions, or all up to the end.

        Between them some may be unknown. A mark of synchronisation is proof by itself.

        Args:
            position: Offset of the first record.
            end: Offset at which the part of the file ends; the last record may be cut off there.
            may_begin_unknown: Whether the first record may be unknown too.
        """
        fitting_records = 0
        unknown_records = 0
        while fitting_records < RECORDS_OF_CHAIN:
            if position >= end:
                return fitting_records > 0 or may_begin_unknown
            if self._next_position(position) > end or end - position < HEADER.size:
                data_header = self.content[position : position + DATA_HEADER.size]
                return fitting_records > 0 or data_header in self._data_lengths
            fit = self._fit(position, end)
            if fit is _Fit.DAMAGED:
                return False
            if fit is _Fit.UNKNOWN:
                unknown_records += 1
                is_first = fitting_records == 0
                if unknown_records > MAX_UNKNOWN_RECORDS or (is_first and not may_begin_unknown):
                    return False
            elif self._header(position).kind == SYNC:
                return True
            else:
                fitting_records += 1
            position = self._next_position(position)
        return True

    def _is_whole_unknown_record(self, position: int, end: int) -> bool:
        """Returns whether what follows is a record without a definition, and not some damaged bytes.

        Behind a record a chain of others begins, and inside of it none does.
        """
        next_position = self._next_position(position)
        if not self._is_chain(next_position, end, may_begin_unknown=True):
            return False
        inside = self._record_start_pattern().finditer(self.content, position + 1, next_position)
        return not any(self._is_chain(start.start(), end) for start in inside)

    def _next_chain(self, start: int, end: int) -> int:
        """Returns the first offset from ``start`` on at which a chain of records begins; ``end`` without any."""
        for record_start in self._record_start_pattern().finditer(self.content, start, end):
            position = record_start.start()
            if self._is_chain(position, end):
                return position
        return end

    def _record_start_pattern(self) -> re.Pattern[bytes]:
        """Returns the pattern of bytes at which a record may begin, by the subscriptions that were read so far."""
        if self._record_start is None:
            numbers = [re.escape(number.to_bytes(2, "little")) for number in self._topics]
            # An empty list would match any data record.
            start_of_data = rb"..D(?:" + b"|".join(numbers) + rb")|" if numbers else b""
            # Looking ahead, a match has no length: the next one may begin at the byte behind.
            pattern = rb"(?=" + start_of_data + START_OF_DEFINITION + rb")"
            self._record_start = re.compile(pattern, re.DOTALL)
        return self._record_start

    def _damaged_place(self, position: int, end: int, recent: Sequence[int]) -> slice:
        """Finds what must be left out around a record that does not fit, and adds it to the loss.

        The data record before it may be damaged too. Where bytes are missing, it contains the beginning of the next
        record; where bytes were overwritten, nothing shows it. It is kept only if no more than the header of the record
        behind it is wrong.

        Args:
            position: Offset of the record that does not fit.
            end: Offset at which the part of the file ends.
            recent: Offsets of the last records before it.

        Returns:
            What is left out.
        """
        start = position
        has_data_before = bool(recent) and self._header(recent[-1]).kind == DATA
        if has_data_before:
            start = recent[-1]
        next_chain = self._next_chain(start + 1, end)
        next_position = self._next_position(position)
        is_followed = next_position < end and self._fit(next_position, end) is _Fit.SOUND
        if is_followed and next_position <= next_chain:
            # The length is right; what the record contains is wrong.
            next_chain = next_position
        is_cut_record = self._is_cut_record(position, end)
        if next_chain == end and (is_cut_record or self._is_unwritten(position, end)):
            # Logs usually end so, when the power is switched off: nothing was lost that had been written.
            return slice(position if is_cut_record else start, end)
        if self._has_wrong_header_only(position, next_chain):
            start = position
        before = [offset for offset in recent if offset < start]
        gap = self._seconds_between(before, self._first_data(next_chain, end))
        self._add_loss(1, next_chain - start, gap)
        return slice(start, next_chain)

    def _is_cut_record(self, position: int, end: int) -> bool:
        """Returns whether what follows may be the beginning of a record that goes beyond the end."""
        if end - position < HEADER.size:
            return True
        is_type = TYPE_BYTES.match(self.content, position + HEADER.size - 1) is not None
        return is_type and self._next_position(position) > end

    def _is_unwritten(self, position: int, end: int) -> bool:
        """Returns whether nothing but zeros, or nothing but ones, follows: what a card holds where nobody wrote."""
        unwritten = UNWRITTEN_BYTES.match(self.content, position, end)
        return unwritten is not None and unwritten.end() == end

    def _has_wrong_header_only(self, position: int, next_chain: int) -> bool:
        """Returns whether a record has its right length, so that no more than its header is wrong.

        Args:
            position: Offset of the record.
            next_chain: Offset at which the next record begins.
        """
        length = next_chain - position
        if position + HEADER.size + self._header(position).length == next_chain:
            return True
        number = self.content[position + HEADER.size : position + DATA_HEADER.size]
        data_header = HEADER.pack((length - HEADER.size) % (1 << 16), DATA) + number
        return self._data_lengths.get(data_header) == length

    def _first_data(self, position: int, end: int) -> list[int]:
        """Returns the offsets of up to ``RECORDS_OF_CHAIN`` data records from an offset on, without any unknown one."""
        offsets: list[int] = []
        while position < end and len(offsets) < RECORDS_OF_CHAIN:
            fit = self._fit(position, end)
            if fit is _Fit.DAMAGED:
                break
            if fit is _Fit.SOUND and self._header(position).kind == DATA:
                offsets.append(position)
            position = self._next_position(position)
        return offsets

    def _seconds_between(self, before: Sequence[int], after: Sequence[int]) -> float:
        """Returns the time between the records before a damaged place and those behind it, s.

        The latest stamp before and the earliest behind may be damaged themselves, or be much older than their
        neighbours, as the first of a topic are. So the second one of each is taken where there are several.

        Args:
            before: Offsets of records before the place.
            after: Offsets of records behind it.

        Returns:
            The time, 0 or more; 0 where no data record is on one of the sides.
        """
        stamps_before = sorted(self._stamps(before), reverse=True)
        stamps_after = sorted(self._stamps(after))
        if not stamps_before or not stamps_after:
            return 0.0
        last = stamps_before[1] if len(stamps_before) > 2 else stamps_before[0]
        first = stamps_after[1] if len(stamps_after) > 2 else stamps_after[0]
        return max(first - last, 0) / MICROSECONDS

    def _stamps(self, offsets: Sequence[int]) -> list[int]:
        """Returns the time stamps of those of some records that are data with a stamp, µs since boot."""
        stamps = []
        for offset in offsets:
            body_start = offset + DATA_HEADER.size
            length = self._data_lengths.get(self.content[offset:body_start])
            if length is None:
                continue
            number = int.from_bytes(self.content[offset + HEADER.size : body_start], "little")
            stamp_offset = self._topics[number].stamp_offset
            if stamp_offset is not None and offset + length <= len(self.content):
                stamp_start = body_start + stamp_offset
                stamp_bytes = self.content[stamp_start : stamp_start + STAMP.size]
                stamps.append(int.from_bytes(stamp_bytes, "little"))
        return stamps

    def _add_loss(self, places: int, lost_bytes: int, lost_seconds: float) -> None:
        """Adds what was left out at one place to what was lost so far."""
        self.loss = RecordLoss(
            self.loss.places + places,
            self.loss.lost_bytes + lost_bytes,
            self.loss.lost_seconds + lost_seconds,
        )


class _ParsedFormat(NamedTuple):
    """The definition of a message."""

    name: str
    """Its name."""
    fields: Sequence[_Field]
    """Its fields."""


def _parsed_format(body: bytes) -> _ParsedFormat | None:
    """Parses the definition of a message, "name:type field;type[4] field;"; returns None for a damaged one."""
    name_end = body.find(b":", 0, MAX_NAME_BYTES + 1)
    if name_end < 0 or NAME.fullmatch(body, 0, name_end) is None:
        return None
    fields = []
    for text in body[name_end + 1 :].decode("latin-1").split(";"):
        if not text:
            continue
        match = FIELD.fullmatch(text)
        if match is None:
            return None
        kind, elements, field_name = match.groups()
        # Parsers read an array of no elements as one number.
        fields.append(_Field(kind, max(int(elements or 1), 1), field_name))
    return _ParsedFormat(body[:name_end].decode(), fields)


def _is_key_and_value(content: bytes) -> bool:
    """Returns whether an information or a parameter has a key with a type, and a value of that type.

    Args:
        content: The length of the key (one byte), the key ("float MC_ROLL_P"), and the value.
    """
    if not content:
        return False
    key_end = 1 + content[0]
    key = KEY.fullmatch(content, 1, key_end)
    if key is None or key_end > len(content):
        return False
    # The values of arrays have any length.
    value_bytes = NUMBER_BYTES.get(key[1].decode())
    return key[2] is not None or value_bytes in (None, len(content) - key_end)


def _is_text(body: bytes, stamp_offset: int) -> bool:
    """Returns whether the content of a record is a text with its level, its stamp, and no more than a text has."""
    text = body[stamp_offset + STAMP.size :]
    has_stamp = len(body) >= stamp_offset + STAMP.size
    return has_stamp and body[0] in TEXT_LEVELS and len(text) <= MAX_TEXT_BYTES and 0 not in text


def _fit_if(fits: bool) -> _Fit:
    """Returns the fit of a record that is kept if it fits."""
    return _Fit.SOUND if fits else _Fit.DAMAGED
