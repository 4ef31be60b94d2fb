"""PX4's own logs (.ulg): whole messages without damaged bytes, then topics on the boot clock as MAVLink's messages.

A ULog message is its size (uint16), a letter for its kind, and its content, without an end mark or a checksum, so one
wrong size hides all that follows. But the file first defines its contents: a format (F) for each topic, and a
subscription (A) that gives a topic its number; a data message (D) of that number has a known size. After an impossible
message the search continues for the next place at which two possible messages follow one another. pyulog decodes only
the messages found so: given a damaged file, it prints, loses what follows, or fails. ``px4_topics`` translates them.
Layout: https://docs.px4.io/main/en/dev_log/ulog_file_format.html.
"""

from __future__ import annotations

import io
import os
import re
import struct
from array import array
from collections.abc import Container, Mapping
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect
from pyulog import ULog
from scipy.ndimage import median_filter

from mavdem.errors import Unreadable
from mavdem.facts import Fact
from mavdem.facts.sources import Flaw, Repair, Source
from mavdem.ingest.contents import file_bytes
from mavdem.ingest.mavlink.definitions import enum_name
from mavdem.ingest.mavlink.framing import Progress, no_progress
from mavdem.ingest.px4_topics import NEEDED, Px4Topic, mav_type, messages, notes
from mavdem.ingest.telemetry import (
    Log,
    Telemetry,
    joined,
    log_of_vehicles,
    repair,
    rows_by,
    selected,
)
from mavdem.ingest.vocabulary import PX4, UNNAMED, version_text

MAGIC = b"ULog\x01\x12\x35"
"""First bytes of a ULog file; one byte of version and 8 of the time of its first message follow."""
FIRST_MESSAGE = 16  # Bytes before the first message
MAX_STAMP_OFFSET = 10.0
"""Seconds ahead of the stamps around it, or behind an earlier one of its topic, that make a time stamp wrong."""
MEDIAN_WINDOW = 101
"""Data messages whose median stamp is the time. When logging starts, each topic's last message, long past, is logged
once; the topics that are read are fewer than half of the window."""
# Bounded, so that a long stretch of letters is not read again from each of them.
# Name and fields of a format
FORMAT = re.compile(rb"([\w/-]{1,255}):((?:\w{1,255}(?:\[\d{1,4}\])? \w{1,255};)+)")
SIZES = {
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
"""Bytes of the basic types."""

INFORMATION = re.compile(rb"char\[\d+\] (?:ver_sw|ver_hw|sys_uuid)|uint32_t ver_sw_release")
"""Keys of information messages (I) that are kept: PX4's version, the kind of board, and its number."""

_FIELD = re.compile(rb"(\w+)(?:\[(\d+)\])? (\w+);")
_LARGEST = 0xFFFF
_NESTED = 16
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
_APPENDED = 1


class UlogFormat(NamedTuple):
    """The layout of a format (F) in a message: ``size`` in bytes, also ``unpadded``, without the padding at the end.

    ``stamp`` is the place of the time stamp, -1 without one.
    """

    size: int
    unpadded: int
    stamp: int = -1


_BASIC = {kind.encode(): UlogFormat(size, size) for kind, size in SIZES.items()}


def _appended(content: bytes, source: str) -> list[int]:
    """Where data begin that were appended after a crash; the message before each is cut off there."""
    flags = content[FIRST_MESSAGE + 3 : FIRST_MESSAGE + 3 + 40]
    if len(flags) < 40 or content[FIRST_MESSAGE + 2] != ord("B"):
        return []
    if flags[8] & ~_APPENDED or any(flags[9:16]):
        raise Unreadable(Fact(Source.ULOG_OF_LATER_FORMAT, path=source))
    offsets = struct.unpack_from("<3Q", flags, 16) if flags[8] else ()
    return sorted({offset for offset in offsets if FIRST_MESSAGE < offset < len(content)})


def _wrong_stamp(stamps: NDArray[np.float64], topic: NDArray[np.uint16]) -> NDArray[np.bool_]:
    if not len(stamps):
        return np.zeros(0, dtype=np.bool_)
    median = median_filter(stamps, size=min(MEDIAN_WINDOW, len(stamps)), mode="mirror")
    wrong_stamp = np.asarray(stamps > median + MAX_STAMP_OFFSET)
    for all_rows in rows_by(topic).values():
        rows = all_rows[~wrong_stamp[all_rows]]
        wrong_stamp[rows] = stamps[rows] < np.maximum.accumulate(stamps[rows]) - MAX_STAMP_OFFSET
    return wrong_stamp


class WholeMessages:
    """The whole messages of a ULog file, from its ``MAGIC`` on, of data those of the ``wanted`` topics, None for all.

    Attributes:
        content: a ULog file of these, with their formats, subscriptions, parameters and version.
        topic, wrong_stamp: (N,) of each data message in ``content``; a wrong stamp is far from those around it.
        dropouts: (n,) ms in which the logger wrote nothing, each.
        messages: how many whole messages the file has, also those that are not wanted.
        bytes_skipped, damaged: bytes that belong to no message, and the number of places with such between messages.
        cut: messages that are cut off by the end of the file, or by appended data.

    Raises Unreadable: the file's flags require a later format.
    """

    def __init__(
        self,
        content: bytes,
        wanted: Container[bytes] | None,
        source: str,
        progress: Progress = no_progress,
    ) -> None:
        self.messages = self.bytes_skipped = self.damaged = self.cut = 0
        self._definitions, self._data = bytearray(), bytearray()
        self._stamps, self._numbers, self._dropouts = array("Q"), array("H"), array("H")
        self._content = content
        self._wanted = wanted
        self._progress = progress
        self._formats = Formats()
        # By number: the least and the greatest size of a message, and the place of its stamp; -1 where not wanted.
        self._topics: dict[int, tuple[int, int, int]] = {}
        self._low_bytes: set[int] = set()
        self._begun = _begun(self._low_bytes)
        ends = [*_appended(content, source), len(content)]
        for start, end in zip([FIRST_MESSAGE, *ends], ends, strict=False):
            self._walk(start, end)
        header = MAGIC + b"\x01" + content[8:FIRST_MESSAGE].ljust(8, b"\0")
        self.content = b"".join((header, self._definitions, self._data))
        self.topic = np.frombuffer(self._numbers, dtype=np.uint16)
        stamps = np.frombuffer(self._stamps, dtype=np.uint64).astype(np.float64) / 1e6
        self.wrong_stamp = _wrong_stamp(stamps, self.topic)
        self.dropouts = np.frombuffer(self._dropouts, dtype=np.uint16)

    def _walk(self, at: int, end: int) -> None:
        """Walks the messages of ``content[at:end]``; a message that ``end`` cuts off is left out."""
        content = self._content
        topics = self._topics
        reported = at
        while at < end:
            if at - reported > 1 << 20:
                self._progress(at / len(content))
                reported = at
            after = self._after(at, end)
            if after and self._likely(at, after, end):
                self.messages += 1
                kind = content[at + 2]
                if kind == 0x44:  # D
                    number = _ID.unpack_from(content, at + 3)[0]
                    least, _, stamp = topics.get(number, (0, 0, -1))
                    if stamp >= 0:
                        # Without the padding at the end, which PX4 omits and pyulog does not expect.
                        self._data += _HEADER.pack(least, kind) + content[at + 3 : at + 3 + least]
                        self._numbers.append(number)
                        self._stamps.append(_STAMP.unpack_from(content, at + stamp)[0])
                else:
                    self._keep(chr(kind), at, after)
                at = after
                continue
            resumed = self._resumed(at + 1, end)
            if resumed == end and not after:
                self.cut += 1
            else:
                self.damaged += 1
            self.bytes_skipped += resumed - at
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
            at = after
            after = self._after(after, end)
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
        content = self._content
        size = after - at - 3
        kind = content[at + 2]
        if kind == 0x44:  # D, nearly all of them
            if size <= 2:
                return False
            topic = self._topics.get(_ID.unpack_from(content, at + 3)[0])
            return None if topic is None else topic[0] <= size <= topic[1]
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
                return (
                    first <= after
                    and content[at + 3] in b"01234567"
                    and bool(_TEXT.fullmatch(content, first, head))
                )
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
            found = FORMAT.fullmatch(message, 3)
            assert found is not None  # _sound has matched it
            self._definitions += message if self._formats.add(found[1], found[2]) else b""
        elif kind == "A":
            self._subscribe(message)
        elif (kind == "P" and not self._topics) or (
            kind == "I" and INFORMATION.fullmatch(message, 4, 4 + message[3])
        ):
            self._definitions += message
        elif kind in ("P", "L"):
            self._data += message
        elif kind == "O":
            self._dropouts.append(_DROPOUT.unpack_from(message, 3)[0])

    def _subscribe(self, message: bytes) -> None:
        number = _ID.unpack_from(message, 4)[0]
        name = message[6:]
        found = self._formats.layout(name)
        if number in self._topics or found is None:
            return
        stamp = -1
        if (self._wanted is None or name in self._wanted) and found.stamp >= 0:
            stamp = 5 + found.stamp
            self._data += message
        if number & 0xFF not in self._low_bytes:
            self._low_bytes.add(number & 0xFF)
            self._begun = _begun(self._low_bytes)
        self._topics[number] = (2 + found.unpadded, 2 + found.size, stamp)


class Formats:
    """The formats of a file; a format may come before those that it contains.

    Each is laid out once, when a topic of it is subscribed to first: a few formats that contain each other many times
    would else take forever. One that contains itself, or misses another, or is too large, never is.
    """

    def __init__(self) -> None:
        # Kind, which may be another format, length of an array, empty of one value, and name.
        self._fields: dict[bytes, list[tuple[bytes, bytes, bytes]]] = {}
        self._layouts: dict[bytes, UlogFormat | None] = dict(_BASIC)

    def add(self, name: bytes, fields: bytes) -> bool:
        """Adds what ``FORMAT`` found, if it is the first of its name and consistent; returns whether."""
        found = _FIELD.findall(fields)
        if name in self._fields or len({field for *_, field in found}) != len(found):
            return False
        self._fields[name] = found
        return True

    def layout(self, name: bytes, inside: int = 0) -> UlogFormat | None:
        """Returns the layout of a format ``inside`` so many others; None where it has none."""
        if name not in self._layouts and name in self._fields and inside < _NESTED:
            self._layouts[name] = None  # inside itself
            self._layouts[name] = self._laid_out(self._fields[name], inside)
        return self._layouts.get(name)

    def _laid_out(self, fields: list[tuple[bytes, bytes, bytes]], inside: int) -> UlogFormat | None:
        size = unpadded = 0
        stamp = -1
        for kind, length, name in fields:
            if (part := self.layout(kind, inside + 1)) is None:
                return None
            if (kind, length, name) == (b"uint64_t", b"", b"timestamp"):
                stamp = size
            size += part.size * max(int(length or 0), 1)
            if not name.startswith(b"_padding"):
                unpadded = size
        return UlogFormat(size, unpadded, stamp) if size <= _LARGEST else None


def _begun(low_bytes: set[int]) -> re.Pattern[bytes]:
    """Where a message may begin, at the letter of its kind, for topics whose numbers have these low bytes."""
    numbers = b"".join(b"\\x%02x" % number for number in sorted(low_bytes))
    return re.compile(_BEGUN + (b"|D(?=[%s])" % numbers if numbers else b""), re.DOTALL)


def read_ulog(path: str | os.PathLike[str], progress: Progress = no_progress) -> Log:
    """Reads a ULog file; a damaged one as far as possible. It has one vehicle, PX4's.

    In the ``Log``, ``frames`` counts the whole messages of the file. There are no receive times. Raises Unreadable: the
    file cannot be opened, is no ULog, or contains none of the flight's topics.
    """
    source = os.fspath(path)
    content = file_bytes(path)
    if not content.startswith(MAGIC):
        raise Unreadable(Fact(Source.FORMAT_UNKNOWN, path=source, name="ulog"))
    found = WholeMessages(content, {name.encode() for name in NEEDED}, source, progress)
    log = ULog(io.BytesIO(found.content))
    values = [
        *log.initial_parameters.items(),
        *((name, value) for _, name, value in log.changed_parameters),
    ]
    # The last finite value of each.
    parameters = {
        name: float(value)
        for name, value in values
        if isinstance(value, int | float) and isfinite(value)
    }
    topics = _topics(log, found)
    kind = mav_type(topics, parameters)
    vehicle = enum_name("MAV_TYPE", kind) if kind is not None else UNNAMED
    made, names = messages(topics, parameters, vehicle, kind)
    if not made:
        held = ULog(io.BytesIO(WholeMessages(content, None, source).content)).data_list
        raise Unreadable(
            Fact(
                Source.ULOG_WITHOUT_FLIGHT,
                path=source,
                names=sorted({topic.name for topic in held if len(topic.data["timestamp"])}),
                damaged=bool(found.damaged),
                cut=bool(found.cut),
            )
        )
    if texts := log.logged_messages:
        severity, stamps = (
            np.array([getattr(one, name) for one in texts]) for name in ("log_level", "timestamp")
        )
        columns = {
            "severity": severity - ord("0"),
            "text": np.array([one.message for one in texts], dtype=object),
        }
        made["STATUSTEXT"] = columns | {
            "time": stamps / 1e6,
            "boot": np.zeros(len(texts), dtype=np.int64),
        }
    made["PARAM_VALUE"] = _parameters_set(log)
    ids = (parameters.get(name, 1.0) for name in ("MAV_SYS_ID", "MAV_COMP_ID"))
    # 1 is PX4's default
    system, component = (int(number) if 1 <= number <= 255 else 1 for number in ids)
    telemetry = Telemetry(
        system=system,
        component=component,
        vehicle=vehicle,
        autopilot=enum_name("MAV_AUTOPILOT", PX4),
        messages=made,
        parameters=parameters,
        source=source,
        repairs=(*_damage(found), *notes(topics, made)),
        translated_from="ULog",
        earlier={
            name: float(old)
            for name, old in log.initial_parameters.items()
            if parameters.get(name, old) != old
        },
        names=names,
        firmware=_firmware(log.msg_info_dict),
        dropouts=len(found.dropouts),
        board=str(log.msg_info_dict.get("sys_uuid", "")).lower(),
        hardware=str(log.msg_info_dict.get("ver_hw", "")),
    )
    progress(1.0)
    return log_of_vehicles((telemetry,), found.messages, found.bytes_skipped)


def _parameters_set(log: ULog) -> dict[str, NDArray[Any]]:
    """PARAM_VALUE, all as float32: when the logger began, and when one was set."""
    began = [(log.start_timestamp, name, value) for name, value in log.initial_parameters.items()]
    rows = [*began, *log.changed_parameters]
    stamps, names, values = zip(*rows, strict=True) if rows else ((), (), ())
    return {
        "time": np.array(stamps, np.float64) / 1e6,
        "boot": np.zeros(len(rows), np.int64),
        "param_id": np.array([name.encode() for name in names], np.object_),
        "param_value": np.array(values, np.float32),
        "param_type": np.full(len(rows), dialect.MAV_PARAM_TYPE_REAL32),
    }


def _topics(log: ULog, found: WholeMessages) -> dict[str, dict[int, Px4Topic]]:
    parts: dict[tuple[str, int], list[Px4Topic]] = {}
    rows = rows_by(found.topic)
    for data in log.data_list:
        kept = ~found.wrong_stamp[rows[data.msg_id]]
        # A topic that was subscribed to twice continues under another number.
        parts.setdefault((data.name, data.multi_id), []).append(selected(data.data, kept))
    topics: dict[str, dict[int, Px4Topic]] = {}
    for (name, instance), pieces in parts.items():
        fields = joined(pieces)
        fields = selected(fields, np.argsort(fields["timestamp"], kind="stable"))
        time = fields["timestamp"].astype(np.float64) / 1e6
        if len(time):
            # When logging starts, each topic's last message, long past, is logged: what it says held then.
            time[0] = np.clip(log.start_timestamp / 1e6, time[0], time[1:2].min(initial=np.inf))
            topics.setdefault(name, {})[instance] = fields | {"time": time}
    return topics


def _firmware(information: Mapping[str, object]) -> str:
    version = information.get("ver_sw_release")
    commit = information.get("ver_sw")
    number = (
        f" v{version_text(version)}" if isinstance(version, int) and 0 <= version < 1 << 32 else ""
    )
    return f"PX4{number} ({commit[:8]})" if isinstance(commit, str) else f"PX4{number}"


def _damage(found: WholeMessages) -> tuple[Fact, ...]:
    wrong = np.count_nonzero(found.wrong_stamp)
    lasted = found.dropouts / 1e3  # PX4's logger records the duration, not what is missing
    dropouts = {"duration": lasted.sum(), "longest_gap": lasted.max(initial=0)}
    return (
        *repair(Repair.ULOG_DAMAGED, count=found.damaged, skipped=found.bytes_skipped),
        *repair(Repair.LOGGED_MESSAGES_LEFT_OUT, count=found.cut, flaw=Flaw.CUT_OFF),
        *repair(Repair.LOGGED_MESSAGES_LEFT_OUT, count=wrong, flaw=Flaw.FAR_STAMP),
        *repair(Repair.LOGGER_DROPPED_OUT, count=len(lasted), **dropouts),
    )
