"""The whole messages of a ULog file in order, without damaged bytes.

A ULog message is its size (uint16), a letter for its kind, and its content, without an end mark or a checksum, so one
wrong size hides all that follows. But the file first defines its contents: a format (F) for each topic, and a
subscription (A) that gives a topic its number; a data message (D) of that number has a known size. After an impossible
message the search continues for the next place at which two possible messages follow one another. Layout:
https://docs.px4.io/main/en/dev_log/ulog_file_format.html.
"""

from __future__ import annotations

import re
import struct
from array import array
from collections.abc import Container
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from mavdem.errors import Unreadable
from mavdem.ingest.mavlink.framing import Progress
from mavdem.ingest.telemetry import rows_by

MAGIC = b"ULog\x01\x12\x35"
"""First bytes of a ULog file; one byte of version and 8 of the time of its first message follow."""
FIRST_MESSAGE = 16  # Bytes before the first message
MAX_STAMP_OFFSET = 10.0
"""Seconds ahead of the stamps around it, or behind an earlier one of its topic, that make a time stamp wrong."""
MEDIAN_WINDOW = 101
"""Data messages whose median stamp is the time. When logging starts, each topic's last message, long past, is logged
once; the topics that are read are fewer than half of the window."""
MAX_VALUES = 1 << 14
"""Values in one message of each subscription to a wanted topic together; PX4's logs have a few hundred."""

# Bounded, so that a long stretch of letters is not read again from each of them.
FORMAT = re.compile(rb"([\w/-]{1,255}):((?:\w{1,255}(?:\[\d{1,4}\])? \w{1,255};)+)")  # Name and fields of a format
SIZES = {"int8_t": 1, "uint8_t": 1, "bool": 1, "char": 1, "int16_t": 2, "uint16_t": 2, "int32_t": 4, "uint32_t": 4}
SIZES |= {"float": 4, "int64_t": 8, "uint64_t": 8, "double": 8}
"""Bytes of the basic types."""

INFORMATION = re.compile(rb"char\[\d+\] (?:ver_sw|sys_uuid)|uint32_t ver_sw_release")
"""Keys of information messages (I) that are kept: PX4's version, and the number of the board."""

_FIELD = re.compile(rb"(\w+)(?:\[(\d+)\])? (\w+);")
_LARGEST, _NESTED = 0xFFFF, 16
_HEADER = struct.Struct("<HB")
_STAMP = struct.Struct("<Q")
_ID = _DROPOUT = struct.Struct("<H")
_BEGUN = (
    rb"F(?=[\w/-]{1,255}+:)|A(?=...[\w/-])|[PI](?=.[a-z])|[MQ](?=..[a-z])"
    rb"|[LC](?=[0-7])|S(?=\x2f)|(?<=\x02\x00)[OR]"
)
"""Letters of the kinds of messages but D, with the bytes beside them, so that a long run of one letter costs little."""
_TOPIC = re.compile(rb"[\w/-]{1,255}")
_KEY = re.compile(rb"(\w+)(\[\d*\])? [ -~]+")
_TEXT = re.compile(rb"[^\x00-\x08\x0e-\x1a\x1c-\x1f]*")
_COMPAT_FLAGS, _OFFSETS = slice(8, 16), struct.Struct("<3Q")
_APPENDED = 1


class UlogFormat(NamedTuple):
    """The layout of a format (F) in a message: ``size`` in bytes, also ``unpadded``, without the padding at the end.

    ``values`` counts single values, those of nested formats included; ``stamp`` is the place of the time stamp, -1
    without one, and ``nested`` the depth of nested formats, itself included.
    """

    size: int
    unpadded: int
    values: int
    stamp: int = -1
    nested: int = 0


class _UlogField(NamedTuple):
    """A value of ``kind``, which may be another format, or an array of ``length`` values unless that is 0."""

    kind: bytes
    length: int
    name: bytes


_BASIC = {kind.encode(): UlogFormat(size, size, 1) for kind, size in SIZES.items()}


class _UlogTopic(NamedTuple):
    """Sizes of its messages, and the place of the time stamp in them; -1 for a topic that is not wanted."""

    least: int
    most: int
    stamp: int


@dataclass(frozen=True, eq=False)
class WholeMessages:
    """The whole messages of a ULog file."""

    content: bytes  # a ULog file of the wanted topics, with their formats, subscriptions, parameters and version
    # topic and wrong_stamp: (N,) of each data message in ``content``; far from the stamps around it is a wrong one
    topic: NDArray[np.uint16]
    wrong_stamp: NDArray[np.bool_]
    dropouts: NDArray[np.uint16]  # (n,) ms in which the logger wrote nothing, each
    messages: int  # whole messages in the file, also those that are not wanted
    # bytes_skipped and damaged: bytes that belong to no message, and the number of places with such between messages
    bytes_skipped: int
    damaged: int
    cut: int  # messages that are cut off by the end of the file, or by appended data
    crowded: int  # subscriptions to wanted topics left out because of ``MAX_VALUES``


def whole_messages(
    content: bytes, wanted: Container[bytes] | None, source: str, progress: Progress | None = None
) -> WholeMessages:
    """The whole messages of a ULog file, from its ``MAGIC`` on, of data those of the ``wanted`` topics, None for all.

    Raises Unreadable: the file's flags require a later format.
    """
    walk = _Walk(content, wanted, progress)
    ends = [*_appended(content, source), len(content)]
    for start, end in zip([FIRST_MESSAGE, *ends], ends, strict=False):
        walk.section(start, end)
    stamps = np.frombuffer(walk.stamps, dtype=np.uint64).astype(np.float64) / 1e6
    topic = np.frombuffer(walk.numbers, dtype=np.uint16)
    header = MAGIC + b"\x01" + content[8:FIRST_MESSAGE].ljust(8, b"\0")
    clean, dropouts = b"".join((header, walk.definitions, walk.data)), np.frombuffer(walk.dropouts, dtype=np.uint16)
    counts = (walk.messages, walk.skipped, walk.damaged, walk.cut, walk.crowded)
    return WholeMessages(clean, topic, _wrong_stamp(stamps, topic), dropouts, *counts)


def _appended(content: bytes, source: str) -> list[int]:
    """Where data begin that were appended after a crash; the message before each is cut off there."""
    if len(content) < FIRST_MESSAGE + 3 or content[FIRST_MESSAGE + 2] != ord("B"):
        return []
    flags = content[FIRST_MESSAGE + 3 : FIRST_MESSAGE + 3 + 40]
    if len(flags) < 40 or _HEADER.unpack_from(content, FIRST_MESSAGE)[0] < 40:
        return []
    incompatible = flags[_COMPAT_FLAGS]
    if incompatible[0] & ~_APPENDED or any(incompatible[1:]):
        raise Unreadable(f"{source} is a ULog of a later format or damaged at its beginning: its flags are unknown.")
    offsets = [offset for offset in _OFFSETS.unpack_from(flags, 16) if offset] if incompatible[0] & _APPENDED else []
    sound = all(a < b for a, b in zip([FIRST_MESSAGE + 43, *offsets], [*offsets, len(content)], strict=True))
    return offsets if sound else []


def _wrong_stamp(stamps: NDArray[np.float64], topic: NDArray[np.uint16]) -> NDArray[np.bool_]:
    if not len(stamps):
        return np.zeros(0, dtype=np.bool_)
    median = median_filter(stamps, size=min(MEDIAN_WINDOW, len(stamps)), mode="mirror")
    wrong_stamp = np.asarray(stamps > median + MAX_STAMP_OFFSET)
    for all_rows in rows_by(topic).values():
        rows = all_rows[~wrong_stamp[all_rows]]
        wrong_stamp[rows] = stamps[rows] < np.maximum.accumulate(stamps[rows]) - MAX_STAMP_OFFSET
    return wrong_stamp


class _Walk:
    """One pass over the sections of a file; kept messages go into ``definitions`` and ``data``."""

    def __init__(self, content: bytes, wanted: Container[bytes] | None, progress: Progress | None) -> None:
        self.definitions, self.data = bytearray(), bytearray()
        self.stamps, self.numbers, self.dropouts = array("Q"), array("H"), array("H")
        self.messages = self.skipped = self.damaged = self.cut = self.crowded = 0
        self._content, self._wanted, self._progress = content, wanted, progress
        self._formats = Formats()
        self._values = 0
        self._topics: dict[int, _UlogTopic] = {}
        self._low_bytes: set[int] = set()
        self._begun = _begun(self._low_bytes)

    def section(self, at: int, end: int) -> None:
        """Walks the messages of ``content[at:end]``; a message that ``end`` cuts off is left out."""
        content, topics, reported = self._content, self._topics, at
        while at < end:
            if at - reported > 1 << 20 and self._progress is not None:
                self._progress(at / len(content))
                reported = at
            after = self._after(at, end)
            if after and self._likely(at, after, end):
                self.messages += 1
                kind = content[at + 2]
                if kind == 0x44:  # D
                    number = _ID.unpack_from(content, at + 3)[0]
                    topic = topics.get(number)
                    if topic is not None and topic.stamp >= 0:
                        # Without the padding at the end, which PX4 omits and pyulog does not expect.
                        self.data += _HEADER.pack(topic.least, kind) + content[at + 3 : at + 3 + topic.least]
                        self.numbers.append(number)
                        self.stamps.append(_STAMP.unpack_from(content, at + topic.stamp)[0])
                else:
                    self._keep(chr(kind), at, after)
                at = after
                continue
            resumed = self._resumed(at + 1, end)
            if resumed == end and not after:
                self.cut += 1
            else:
                self.damaged += 1
            self.skipped += resumed - at
            at = resumed

    def _after(self, at: int, end: int) -> int:
        """Where the message at ``at`` ends; 0 if that is beyond ``end``."""
        if at + 3 > end:
            return 0
        after = at + 3 + int(_HEADER.unpack_from(self._content, at)[0])
        return after if after <= end else 0

    def _likely(self, at: int, after: int, end: int) -> bool:
        """Whether there is a message at ``at``: by itself or, where that is undecided, by those after it."""
        sound = self._sound(at, after)
        for _ in range(3):
            if sound is not None:
                return sound
            if after == end:
                return True
            at, after = after, self._after(after, end)
            sound = self._sound(at, after) if after else False
        return bool(sound)

    def _resumed(self, at: int, end: int) -> int:
        """The first place from ``at`` on with a message that is possible by itself, and another after it."""
        for kind in self._begun.finditer(self._content, at + 2, end):
            start = kind.start() - 2
            after = self._after(start, end)
            if after and self._sound(start, after):
                following = self._after(after, end)
                if after == end or (following and self._likely(after, following, end)):
                    return start
        return end

    def _sound(self, at: int, after: int) -> bool | None:
        """Whether the bytes can be a message of its kind; None when that is not known."""
        content, size = self._content, after - at - 3
        kind = content[at + 2]
        if kind == 0x44:  # D, nearly all of them
            if size <= 2:
                return False
            topic = self._topics.get(_ID.unpack_from(content, at + 3)[0])
            return None if topic is None else topic.least <= size <= topic.most
        match chr(kind):
            case "F":
                return FORMAT.fullmatch(content, at + 3, after) is not None
            case "A":
                return size > 3 and _TOPIC.fullmatch(content, at + 6, after) is not None
            case "P" | "I":
                return self._is_pair(at + 3, after)
            case "M" | "Q":
                return size > 1 and self._is_pair(at + 4, after)
            case "L" | "C" as kind_of_text:
                first = at + (12 if kind_of_text == "L" else 14)
                head = min(after, first + 128)
                return first <= after and content[at + 3] in b"01234567" and bool(_TEXT.fullmatch(content, first, head))
            case "S":
                return content[at + 3 : after] == bytes.fromhex("2F731320250CBB12")
            case "O" | "R":
                return size == 2
            case "B":
                return at == FIRST_MESSAGE and size >= 40
        # Kinds of later versions are letters too.
        return None if size and chr(kind).isascii() and chr(kind).isalpha() else False

    def _is_pair(self, at: int, after: int) -> bool:
        """Whether the bytes are a length, a key of that length ("int32_t NAME") and a value of the key's type."""
        value = at + 1 + self._content[at] if at < after else after + 1
        key = _KEY.fullmatch(self._content, at + 1, value) if value <= after else None
        if key is None:
            return False
        return key[2] is not None or SIZES.get(key[1].decode(errors="replace"), -1) == after - value

    def _keep(self, kind: str, at: int, after: int) -> None:
        message = self._content[at:after]
        if kind == "F":
            self._add_format(message)
        elif kind == "A":
            self._subscribe(message)
        elif (kind == "P" and not self._topics) or (kind == "I" and INFORMATION.fullmatch(message, 4, 4 + message[3])):
            self.definitions += message
        elif kind == "P":
            self.data += message
        elif kind == "O":
            self.dropouts.append(_DROPOUT.unpack_from(message, 3)[0])

    def _add_format(self, message: bytes) -> None:
        found = FORMAT.fullmatch(message, 3)
        assert found is not None  # _sound has matched it
        if self._formats.add(found[1], found[2]):
            self.definitions += message

    def _subscribe(self, message: bytes) -> None:
        number, name = _ID.unpack_from(message, 4)[0], message[6:]
        found = self._formats.complete.get(name)
        if number in self._topics or found is None:
            return
        stamp = -1
        if (self._wanted is None or name in self._wanted) and found.stamp >= 0:
            self._values += found.values
            if self._values <= MAX_VALUES:
                stamp = 5 + found.stamp
                self.data += message
            else:
                self.crowded += 1
        if number & 0xFF not in self._low_bytes:
            self._low_bytes.add(number & 0xFF)
            self._begun = _begun(self._low_bytes)
        self._topics[number] = _UlogTopic(2 + found.unpadded, 2 + found.size, stamp)


class Formats:
    """The formats of a file; ``complete`` has those, by name, whose nested formats are all defined.

    A format may come before those that it contains. Each is completed once, after the last of them: a few formats that
    contain each other many times would else take forever. One that contains itself, or is too large, never is.
    """

    def __init__(self) -> None:
        self.complete: dict[bytes, UlogFormat] = {}
        self._fields: dict[bytes, list[_UlogField]] = {}
        self._missing: dict[bytes, int] = {}
        self._awaited: dict[bytes, list[bytes]] = {}

    def add(self, name: bytes, fields: bytes) -> bool:
        """Adds what ``FORMAT`` found, if it is the first of its name and consistent; returns whether."""
        found = [_UlogField(kind, int(length or 0), field) for kind, length, field in _FIELD.findall(fields)]
        if name in self._fields or len({field.name for field in found}) != len(found):
            return False
        self._fields[name] = found
        parts = {field.kind for field in found if field.kind not in _BASIC and field.kind not in self.complete}
        self._missing[name] = len(parts)
        for part in parts:
            self._awaited.setdefault(part, []).append(name)
        whole = [] if parts else [name]
        while whole:
            whole += self._completed(whole.pop())
        return True

    def _completed(self, name: bytes) -> list[bytes]:
        """Completes a format and returns those that missed nothing else."""
        layout = _layout([(field, _BASIC.get(field.kind) or self.complete[field.kind]) for field in self._fields[name]])
        if layout is None:
            return []
        self.complete[name] = layout
        waiting = self._awaited.pop(name, [])
        for other in waiting:
            self._missing[other] -= 1
        return [other for other in waiting if not self._missing[other]]


def _layout(fields: list[tuple[_UlogField, UlogFormat]]) -> UlogFormat | None:
    size = values = unpadded = 0
    stamp = -1
    for field, part in fields:
        if (field.kind, field.length, field.name) == (b"uint64_t", 0, b"timestamp"):
            stamp = size
        size += part.size * max(field.length, 1)
        values += part.values * max(field.length, 1)
        if not field.name.startswith(b"_padding"):
            unpadded = size
    nested = 1 + max(part.nested for _, part in fields)
    return UlogFormat(size, unpadded, values, stamp, nested) if size <= _LARGEST and nested <= _NESTED else None


def _begun(low_bytes: set[int]) -> re.Pattern[bytes]:
    """Where a message may begin, at the letter of its kind, for topics whose numbers have these low bytes."""
    numbers = b"".join(b"\\x%02x" % number for number in sorted(low_bytes))
    return re.compile(_BEGUN + (b"|D(?=[%s])" % numbers if numbers else b""), re.DOTALL)
