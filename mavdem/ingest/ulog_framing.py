"""The messages of a ULog file one after another, from which damaged stretches are left out.

A ULog message is its size (uint16), a letter for its kind, and its content; nothing closes it and no checksum guards
it, so that one wrong size hides all that follows. But the file says beforehand what it will hold: a format (F) for each
topic, and a subscription (A) that gives a topic its number; a data message (D) of that number has a known size. Where
a message is not what it should be, the next place is searched at which two messages in a row are.

Layout: https://docs.px4.io/main/en/dev_log/ulog_file_format.html.
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
from mavdem.ingest.framing import Progress
from mavdem.ingest.rows import rows_by
from mavdem.ingest.ulog_formats import FORMAT, SIZES, Formats

MAGIC = b"ULog\x01\x12\x35"
"""How a ULog file begins; one byte of version and 8 of the time of its first message follow."""
BEFORE = 16
"""Bytes before the first message."""
AHEAD = 10.0
"""Seconds that make a time stamp wrong: so far ahead of those logged around it, or so far behind one of its topic."""
AROUND = 101
"""Data messages whose median stamp tells the time: when logging starts, each topic's last message, long past, comes
once, and there are fewer of the topics that are read."""
MOST_VALUES = 1 << 14
"""Values that one message of each subscription to a wanted topic may hold together; in PX4's logs a few hundred do."""

_HEADER = struct.Struct("<HB")
_STAMP = struct.Struct("<Q")
_ID = _DROPOUT = struct.Struct("<H")
_SYNC = bytes.fromhex("2F731320250CBB12")
_BEGUN = (
    rb"F(?=[\w/-]{1,255}+:)|A(?=...[\w/-])|[PI](?=.[a-z])|[MQ](?=..[a-z])"
    rb"|[LC](?=[0-7])|S(?=\x2f)|(?<=\x02\x00)[OR]"
)
"""Letters of the kinds of messages but D, with what must stand beside them: a long run of one letter costs little."""
_TOPIC = re.compile(rb"[\w/-]{1,255}")
_KEY = re.compile(rb"(\w+)(\[\d*\])? [!-~]+")
_TEXT = re.compile(rb"[^\x00-\x08\x0e-\x1a\x1c-\x1f]*")
_TEXT_HEAD = 128
"""Bytes of a text that are looked at: what is damaged shows at once."""
_UNSURE_IN_A_ROW = 3
_COMPAT_FLAGS, _OFFSETS = slice(8, 16), struct.Struct("<3Q")
_APPENDED = 1


class _Topic(NamedTuple):
    """Sizes that its messages may have, and where in them the time stamp is; -1 for a topic that is not wanted."""

    least: int
    most: int
    stamp: int


@dataclass(frozen=True, eq=False)
class Intact:
    """What is whole in a ULog file.

    Attributes:
        content: a ULog file of the wanted topics, with their formats and subscriptions, and the parameters.
        topic: (N,) the number of the topic of each data message in ``content``.
        astray: (N,) whether its time stamp is far from those around it.
        dropouts: (n,) how long the logger wrote nothing, ms.
        messages: whole messages in the file, those that are not wanted included.
        bytes_skipped: bytes that belong to none.
        damaged: stretches of such bytes between messages.
        cut: messages that the end of the file, or the beginning of what was appended, cuts off.
        crowded: subscriptions to wanted topics left out because there are more than ``MOST_VALUES`` allow.
    """

    content: bytes
    topic: NDArray[np.uint16]
    astray: NDArray[np.bool_]
    dropouts: NDArray[np.uint16]
    messages: int
    bytes_skipped: int
    damaged: int
    cut: int
    crowded: int


def intact(content: bytes, wanted: Container[bytes], source: str, progress: Progress | None = None) -> Intact:
    """Finds the whole messages of a ULog file.

    Args:
        content: the file, from its ``MAGIC`` on.
        wanted: topics to keep.
        source: the file's name.
        progress: called with the fraction done.

    Raises:
        Unreadable: the file says that it cannot be read by whoever does not know a later format.
    """
    walk = _Walk(content, wanted, progress)
    ends = [*_appended(content, source), len(content)]
    for start, end in zip([BEFORE, *ends], ends, strict=False):
        walk.section(start, end)
    stamps = np.frombuffer(walk.stamps, dtype=np.uint64).astype(np.float64) / 1e6
    topic = np.frombuffer(walk.numbers, dtype=np.uint16)
    header = MAGIC + b"\x01" + content[8:BEFORE].ljust(8, b"\0")
    clean = b"".join((header, walk.definitions, walk.data))
    counts = (walk.messages, walk.skipped, walk.damaged, walk.cut, walk.crowded)
    return Intact(clean, topic, _astray(stamps, topic), np.frombuffer(walk.dropouts, dtype=np.uint16), *counts)


def _appended(content: bytes, source: str) -> list[int]:
    """Where data begin that were appended after a crash; what stands before each is cut off there."""
    if len(content) < BEFORE + 3 or content[BEFORE + 2] != ord("B"):
        return []
    flags = content[BEFORE + 3 : BEFORE + 3 + 40]
    if len(flags) < 40 or _HEADER.unpack_from(content, BEFORE)[0] < 40:
        return []
    incompatible = flags[_COMPAT_FLAGS]
    if incompatible[0] & ~_APPENDED or any(incompatible[1:]):
        raise Unreadable(f"{source} is a ULog of a later format or damaged at its beginning: its flags are unknown.")
    offsets = [offset for offset in _OFFSETS.unpack_from(flags, 16) if offset] if incompatible[0] & _APPENDED else []
    sound = all(a < b for a, b in zip([BEFORE + 43, *offsets], [*offsets, len(content)], strict=True))
    return offsets if sound else []


def _astray(stamps: NDArray[np.float64], topic: NDArray[np.uint16]) -> NDArray[np.bool_]:
    if not len(stamps):
        return np.zeros(0, dtype=np.bool_)
    astray = np.asarray(stamps > median_filter(stamps, size=min(AROUND, len(stamps)), mode="mirror") + AHEAD)
    for all_rows in rows_by(topic).values():
        rows = all_rows[~astray[all_rows]]
        astray[rows] = stamps[rows] < np.maximum.accumulate(stamps[rows]) - AHEAD
    return astray


class _Walk:
    """One pass over the sections of a file; what is kept goes into ``definitions`` and ``data``."""

    def __init__(self, content: bytes, wanted: Container[bytes], progress: Progress | None) -> None:
        self.definitions, self.data = bytearray(), bytearray()
        self.stamps, self.numbers, self.dropouts = array("Q"), array("H"), array("H")
        self.messages = self.skipped = self.damaged = self.cut = self.crowded = 0
        self._content, self._wanted, self._progress = content, wanted, progress
        self._formats = Formats()
        self._values = 0
        self._topics: dict[int, _Topic] = {}
        self._low_bytes: set[int] = set()
        self._begun = _begun(self._low_bytes)

    def section(self, at: int, end: int) -> None:
        """Walks the messages of ``content[at:end]``; a message that ``end`` cuts off is left out."""
        content, topics, told = self._content, self._topics, at
        while at < end:
            if at - told > 1 << 20 and self._progress is not None:
                self._progress(at / len(content))
                told = at
            after = self._after(at, end)
            if after and self._likely(at, after, end):
                self.messages += 1
                kind = content[at + 2]
                if kind == 0x44:  # D
                    number = _ID.unpack_from(content, at + 3)[0]
                    topic = topics.get(number)
                    if topic is not None and topic.stamp >= 0:
                        # Without padding at the end, which PX4 leaves out and pyulog does not expect.
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
        """Whether a message stands there: by itself or, where that tells nothing, by those after it."""
        sound = self._sound(at, after)
        for _ in range(_UNSURE_IN_A_ROW):
            if sound is not None:
                return sound
            if after == end:
                return True
            at, after = after, self._after(after, end)
            sound = self._sound(at, after) if after else False
        return bool(sound)

    def _resumed(self, at: int, end: int) -> int:
        """The first place from ``at`` on with a message that is sound by itself, and another after it."""
        for kind in self._begun.finditer(self._content, at + 2, end):
            start = kind.start() - 2
            after = self._after(start, end)
            if after and self._sound(start, after):
                following = self._after(after, end)
                if after == end or (following and self._likely(after, following, end)):
                    return start
        return end

    def _sound(self, at: int, after: int) -> bool | None:
        """Whether what stands there can be a message of its kind; None when nothing is known of it."""
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
                head = min(after, first + _TEXT_HEAD)
                return first <= after and content[at + 3] in b"01234567" and bool(_TEXT.fullmatch(content, first, head))
            case "S":
                return content[at + 3 : after] == _SYNC
            case "O" | "R":
                return size == 2
            case "B":
                return at == BEFORE and size >= 40
        # Kinds that a later version may add are letters too.
        return None if size and chr(kind).isascii() and chr(kind).isalpha() else False

    def _is_pair(self, at: int, after: int) -> bool:
        """Whether a length, a key of that length ("int32_t NAME") and a value of the key's type stand there."""
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
        elif kind == "P" and not self._topics:
            self.definitions += message
        elif kind == "P":
            self.data += message
        elif kind == "O":
            self.dropouts.append(_DROPOUT.unpack_from(message, 3)[0])

    def _add_format(self, message: bytes) -> None:
        found = FORMAT.fullmatch(message, 3)
        assert found is not None  # _sound has seen to it
        if self._formats.add(found[1], found[2]):
            self.definitions += message

    def _subscribe(self, message: bytes) -> None:
        number, name = _ID.unpack_from(message, 4)[0], message[6:]
        layout = self._formats.layouts.get(name)
        if number in self._topics or layout is None:
            return
        stamp = -1
        if name in self._wanted and layout.stamp >= 0:
            self._values += layout.values
            if self._values <= MOST_VALUES:
                stamp = 5 + layout.stamp
                self.data += message
            else:
                self.crowded += 1
        if number & 0xFF not in self._low_bytes:
            self._low_bytes.add(number & 0xFF)
            self._begun = _begun(self._low_bytes)
        self._topics[number] = _Topic(2 + layout.unpadded, 2 + layout.size, stamp)


def _begun(low_bytes: set[int]) -> re.Pattern[bytes]:
    """Where a message may begin, at the letter of its kind, where topics have numbers with those low bytes."""
    numbers = b"".join(b"\\x%02x" % number for number in sorted(low_bytes))
    return re.compile(_BEGUN + (b"|D(?=[%s])" % numbers if numbers else b""), re.DOTALL)
