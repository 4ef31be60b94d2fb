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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect
from pyulog import ULog
from scipy.ndimage import median_filter

from mavdem.errors import Unreadable
from mavdem.facts import Fact
from mavdem.facts.sources import Flaw, Repair, Source
from mavdem.ingest.contents import PathName, file_bytes
from mavdem.ingest.mavlink.definitions import enum_name
from mavdem.ingest.px4_topics import NEEDED, mav_type, messages, notes
from mavdem.ingest.telemetry import (
    Array,
    Columns,
    Facts,
    Fields,
    Flags,
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
PARAMETER = re.compile(rb"(?:int32_t|float) [\w-]+")  # Key of a parameter (P)
INFORMATION = re.compile(
    rb".(?:char\[\d+\] (?:ver_sw|ver_hw|sys_uuid)|uint32_t ver_sw_release)", re.S
)
"""The beginning of information messages (I) that are kept: PX4's version, the kind of board, and its number."""
KINDS = {
    "F": rb"(?P<name>[\w/-]+):(?P<fields>(?:\w+(?:\[\d{1,4}\])? \w+;)+)",
    "A": rb"...[\w/-]+",
    "P": rb".(?:int32_t|float) [\w-]+.{4}",
    "I": rb".\w+(?:\[\d*\])? [ -~].*",
    "M": rb"..\w+(?:\[\d*\])? [ -~].*",
    "Q": rb"..(?:int32_t|float) [\w-]+.{4}",
    "L": rb"[0-7].{8}[^\0-\x08\x0e-\x1a\x1c-\x1f]*\0*",
    "C": rb"[0-7].{10}[^\0-\x08\x0e-\x1a\x1c-\x1f]*\0*",
    "S": rb"\x2f\x73\x13\x20\x25\x0c\xbb\x12",
    "O": rb"..",
    "R": rb"..",
    "B": rb".{40,}",
}
"""What the contents of messages begin with, by the letter of their kind, but for data (D)."""
_KINDS = {ord(kind): re.compile(content, re.DOTALL) for kind, content in KINDS.items()}
_BEGUN = re.compile(b"[%s]" % "".join([*KINDS, "D"]).encode())
_DATA = ord("D")
_FIELD = re.compile(rb"(\w+)(?:\[(\d+)\])? (\w+);")
_LARGEST = 0xFFFF
_NESTED = 16
_HEADER = struct.Struct("<HB")
_STAMP = struct.Struct("<Q")
_ID = _DROPOUT = struct.Struct("<H")
_APPENDED = 1


class UlogFormat(NamedTuple):
    """The layout of a format (F) in a message: ``size`` in bytes, also ``unpadded``, without the padding at the end.

    ``stamp`` is the place of the time stamp, -1 without one.
    """

    size: int
    unpadded: int
    stamp: int = -1


def _appended(content: bytes, source: str) -> list[int]:
    """Where data begin that were appended after a crash; the message before each is cut off there."""
    flags = content[FIRST_MESSAGE + 3 : FIRST_MESSAGE + 3 + 40]
    if len(flags) < 40 or content[FIRST_MESSAGE + 2] != ord("B"):
        return []
    if flags[8] & ~_APPENDED or any(flags[9:16]):
        raise Unreadable(Fact(Source.ULOG_OF_LATER_FORMAT, path=source))
    offsets = struct.unpack_from("<3Q", flags, 16) if flags[8] else ()
    return sorted({offset for offset in offsets if FIRST_MESSAGE < offset < len(content)})


def _wrong_stamp(stamps: Array, topic: NDArray[np.uint16]) -> Flags:
    if not len(stamps):
        return np.zeros(0, dtype=np.bool_)
    median = median_filter(stamps, size=min(MEDIAN_WINDOW, len(stamps)), mode="mirror")
    wrong_stamp = np.asarray(stamps > median + MAX_STAMP_OFFSET)
    for all_rows in rows_by(topic).values():
        rows = all_rows[~wrong_stamp[all_rows]]
        wrong_stamp[rows] = stamps[rows] < np.maximum.accumulate(stamps[rows]) - MAX_STAMP_OFFSET
    return wrong_stamp


class WholeMessages:
    """The whole messages of a ULog file, from its ``MAGIC`` on, of data those of the ``wanted`` topics.

    Attributes:
        content: a ULog file of these, with their formats, subscriptions, parameters and version.
        topic, wrong_stamp: (N,) of each data message in ``content``; a wrong stamp is far from those around it.
        dropouts: (n,) ms in which the logger wrote nothing, each.
        topics: the names of all that have messages, empty for unknown ones.
        messages: how many whole messages the file has, also those that are not wanted.
        bytes_skipped, damaged: bytes that belong to no message, and the number of places with such between messages.
        cut: messages that are cut off by the end of the file, or by appended data.

    Raises Unreadable: the file's flags require a later format.
    """

    def __init__(
        self,
        content: bytes,
        wanted: Container[bytes],
        source: str,
    ) -> None:
        self.messages = self.bytes_skipped = self.damaged = self.cut = 0
        self._definitions, self._data = bytearray(), bytearray()
        self._stamps, self._numbers, self._dropouts = array("Q"), array("H"), array("H")
        self._content, self._wanted = content, wanted
        self._fields: dict[bytes, list[tuple[bytes, bytes, bytes]]] = {}
        self._layouts: Mapping[bytes, UlogFormat] = {}
        self.topics: set[bytes] = set()
        # By number: the least and the greatest size of a message, and the place of its stamp; -1 where not wanted.
        self._topics: dict[int, tuple[int, int, int, bytes]] = {}
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
        while at < end:
            after = self._after(at, end)
            if after and self._likely(at, after, end):
                self.messages += 1
                self._keep(at, after)
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
        for kind in _BEGUN.finditer(self._content, at + 2, end):
            start = kind.start() - 2
            after = self._after(start, end)
            if after and self._sound(start, after):
                following = self._after(after, end)
                if after == end or (following and self._likely(after, following, end)):
                    return start
        return end

    def _sound(self, at: int, after: int) -> bool | None:
        """Whether the bytes can be a message of its kind; None when that is not known."""
        size = after - at - 3
        kind = self._content[at + 2]
        if kind in _KINDS:
            is_first = kind != ord("B") or at == FIRST_MESSAGE
            return is_first and _KINDS[kind].fullmatch(self._content, at + 3, after) is not None
        if kind == _DATA and size > 2:
            topic = self._topics.get(_ID.unpack_from(self._content, at + 3)[0])
            return None if topic is None else topic[0] <= size <= topic[1]
        # Kinds of later versions are letters too.
        return None if size and kind != _DATA and bytes([kind]).isalpha() else False

    def _keep(self, at: int, after: int) -> None:
        message = self._content[at:after]
        kind = chr(message[2])
        if kind == "D":
            number = _ID.unpack_from(message, 3)[0]
            least, _, stamp, name = self._topics.get(number, (0, 0, -1, b""))
            self.topics.add(name)
            if stamp >= 0:
                # Without the padding at the end, which PX4 omits and pyulog does not expect.
                self._data += _HEADER.pack(least, _DATA) + message[3 : 3 + least]
                self._numbers.append(number)
                self._stamps.append(_STAMP.unpack_from(message, stamp)[0])
        elif kind == "F":
            self._define(message)
        elif kind == "A":
            self._subscribe(message)
        elif kind in ("P", "I"):
            value = len(message) - 4 - message[3]
            if kind == "P" and PARAMETER.fullmatch(message, 4, len(message) - 4) and value == 4:
                into = self._data if self._topics else self._definitions
                into += message
            elif kind == "I" and INFORMATION.fullmatch(message, 3, 4 + message[3]) and value >= 4:
                self._definitions += message
        elif kind == "L":
            self._data += message
        elif kind == "O":
            self._dropouts.append(_DROPOUT.unpack_from(message, 3)[0])

    def _define(self, message: bytes) -> None:
        """Keeps a format, if it is the first of its name and consistent."""
        found = _KINDS[ord("F")].fullmatch(message, 3)
        assert found is not None  # _sound has matched it
        fields = _FIELD.findall(found["fields"])
        if found["name"] not in self._fields and len({name for *_, name in fields}) == len(fields):
            self._fields[found["name"]] = fields
            self._definitions += message

    def _subscribe(self, message: bytes) -> None:
        number = _ID.unpack_from(message, 4)[0]
        name = message[6:]
        if not self._layouts:  # all formats come before
            self._layouts = _laid_out(self._fields)
        if number in self._topics or name not in self._layouts:
            return
        found = self._layouts[name]
        stamp = -1
        if name in self._wanted and found.stamp >= 0:
            stamp = 5 + found.stamp
            self._data += message
        self._topics[number] = (2 + found.unpadded, 2 + found.size, stamp, name)


def _laid_out(formats: Mapping[bytes, list[tuple[bytes, bytes, bytes]]]) -> dict[bytes, UlogFormat]:
    """The layouts of formats by name, from kind, length of an array and name of each field; none that is in itself."""
    known = {kind.encode(): UlogFormat(size, size) for kind, size in SIZES.items()}
    for _ in range(_NESTED):
        for format_name, fields in formats.items():
            if format_name in known or any(kind not in known for kind, *_ in fields):
                continue
            size = unpadded = 0
            stamp = -1
            for kind, length, name in fields:
                if (kind, length, name) == (b"uint64_t", b"", b"timestamp"):
                    stamp = size
                size += known[kind].size * max(int(length or 0), 1)
                if not name.startswith(b"_padding"):
                    unpadded = size
            if size <= _LARGEST:
                known[format_name] = UlogFormat(size, unpadded, stamp)
    return known


def read_ulog(path: PathName) -> Log:
    """Reads a ULog file; a damaged one as far as possible. It has one vehicle, PX4's.

    In the ``Log``, ``frames`` counts the whole messages of the file. There are no receive times. Raises Unreadable: the
    file cannot be opened, is no ULog, or contains none of the flight's topics.
    """
    source = os.fspath(path)
    content = file_bytes(path)
    if not content.startswith(MAGIC):
        raise Unreadable(Fact(Source.FORMAT_UNKNOWN, path=source, name="ulog"))
    found = WholeMessages(content, {name.encode() for name in NEEDED}, source)
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
        raise Unreadable(
            Fact(
                Source.ULOG_WITHOUT_FLIGHT,
                path=source,
                names=sorted(name.decode() for name in found.topics if name),
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
    return log_of_vehicles((telemetry,), found.messages, found.bytes_skipped)


def _parameters_set(log: ULog) -> Fields:
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


def _topics(log: ULog, found: WholeMessages) -> dict[str, dict[int, Columns]]:
    parts: dict[tuple[str, int], list[Columns]] = {}
    rows = rows_by(found.topic)
    for data in log.data_list:
        kept = ~found.wrong_stamp[rows[data.msg_id]]
        # A topic that was subscribed to twice continues under another number.
        parts.setdefault((data.name, data.multi_id), []).append(selected(data.data, kept))
    topics: dict[str, dict[int, Columns]] = {}
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


def _damage(found: WholeMessages) -> Facts:
    wrong = np.count_nonzero(found.wrong_stamp)
    lasted = found.dropouts / 1e3  # PX4's logger records the duration, not what is missing
    dropouts = {"duration": lasted.sum(), "longest_gap": lasted.max(initial=0)}
    return (
        *repair(Repair.ULOG_DAMAGED, count=found.damaged, skipped=found.bytes_skipped),
        *repair(Repair.LOGGED_MESSAGES_LEFT_OUT, count=found.cut, flaw=Flaw.CUT_OFF),
        *repair(Repair.LOGGED_MESSAGES_LEFT_OUT, count=wrong, flaw=Flaw.FAR_STAMP),
        *repair(Repair.LOGGER_DROPPED_OUT, count=len(lasted), **dropouts),
    )
