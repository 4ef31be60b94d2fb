"""The frames in the bytes of a link, and the messages in them that a model needs, one at a time.

A frame counts as in files: with a correct checksum; where there is damage, garbage or another dialect, ``find_frames``
decides what came before the next good one. Nothing is lost by waiting for that.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from math import inf, isfinite, nan
from typing import Any, NamedTuple

import numpy as np

from mavdem.alignment.drive import MAX_ANGLE, MAX_BODY_RATE, UINT16_UNKNOWN
from mavdem.alignment.signals import IGNORED
from mavdem.ingest.mavlink import framing
from mavdem.ingest.mavlink.definitions import definitions, parameter_values, seeds
from mavdem.ingest.mavlink.vehicles import CLOCK_UNITS
from mavdem.ingest.motors import MOTOR_MESSAGES
from mavdem.ingest.vocabulary import euler_angles

Values = tuple[float, ...]

MAX_UNDECIDED = 32 * framing.LONGEST_FRAME  # Bytes without a good frame that wait for one

FIELDS: dict[str, tuple[str, ...]] = {
    name: tuple(fields)
    for name, fields in json.loads((files("mavdem.live") / "fields.json").read_text()).items()
} | {name: form.fields for name, form in MOTOR_MESSAGES.items()}
"""Of the messages that a model or the wind needs; of those in ``CLIMB_FIELDS`` the vertical speed first."""


OF_ITSELF = (
    "HEARTBEAT",
    "STATUSTEXT",
    "SYS_STATUS",
    "BATTERY_STATUS",
    "POWER_STATUS",
    "VIBRATION",
    "GPS_RAW_INT",
)
"""What an autopilot says of itself, slowly: the time of the message before them is theirs."""


class Frame(NamedTuple):
    """One frame of a stream, as its header announces it."""

    message_id: int
    system: int
    component: int
    sequence: int
    verdict: int  # ``GOOD``, ``UNKNOWN`` or ``FAILED`` of ``framing``
    payload: bytes  # as sent, without the zeros that MAVLink 2 truncates


class FrameReader:
    """Finds the frames of one stream."""

    def __init__(self) -> None:
        self.unread = 0  # number of those of other dialects, and damaged ones
        self._rest = b""
        message_readers(), seeds()  # slow the first time

    def feed(self, piece: bytes) -> list[Frame]:
        """Returns the frames that the next bytes complete, in order; good ones do not depend on how bytes are cut."""
        data = self._rest + piece
        start = 0
        read: list[Frame] = []
        while start < len(data):
            frame, end = _frame_at(data, start)
            if frame is not None and frame.verdict == framing.GOOD:
                read.append(frame)
                start = end
            elif end < len(data) and (decided := self._search(data, start, read)) is not None:
                start = decided
            else:
                break  # incomplete, or alone: what follows decides
        self._rest = data[start:]
        self.unread += sum(frame.verdict != framing.GOOD for frame in read)
        return read

    def _search(self, data: bytes, start: int, read: list[Frame]) -> int | None:
        """Adds the frames up to the last good one, as a file's are found; returns where they end, None if unknown."""
        table = framing.concatenated(
            list(framing.find_frames(np.frombuffer(data, np.uint8)[start:], seeds()))
        )
        good = np.flatnonzero(table.verdict == framing.GOOD)
        if len(good):
            table = table[: int(good[-1]) + 1]
            until = int(table.end[-1])
        elif len(data) - start <= MAX_UNDECIDED:
            return None
        else:
            table = table[table.end <= len(data) - start - framing.LONGEST_FRAME]
            until = len(data) - start - framing.LONGEST_FRAME
        columns = (table.message_id, table.system, table.component, table.sequence, table.verdict)
        for begin, length, *header in zip(
            start + table.payload, table.length, *columns, strict=True
        ):
            read.append(Frame._make([*map(int, header), data[begin : begin + length]]))
        return start + until


def _frame_at(data: bytes, start: int) -> tuple[Frame | None, int]:
    """The frame announced by the header at ``start``, None without a complete one, and where it ends or would end."""
    header = data[start : start + framing.HEADER]
    if header[0] not in (framing.MARKER_1, framing.MARKER_2):
        return None, start
    if len(header) < 3:
        return None, len(data)
    length = framing.announced_length(*header[:3])
    if length is None:
        return None, start
    if (end := start + length) > len(data):
        return None, end
    first, size = (4, framing.HEADER) if header[0] == framing.MARKER_2 else (2, framing.HEADER_1)
    sequence, system, component = header[first : first + 3]
    message_id = int.from_bytes(header[first + 3 : size], "little")
    payload = start + size
    behind = start + size + header[1]
    definition = definitions().get(message_id)
    verdict = framing.UNKNOWN
    if definition is not None:
        expected = framing.frame_checksum(data[start + 1 : behind], definition.seed)
        verdict = (
            framing.GOOD if data[behind] | data[behind + 1] << 8 == expected else framing.FAILED
        )
    return Frame(message_id, system, component, sequence, verdict, data[payload:behind]), end


class Message(NamedTuple):
    """A message that a model needs."""

    name: str
    stamp: float  # its clock, s; zero if it has none
    period: float  # where the clock wraps, s; infinite for 64-bit counters
    values: tuple[Any, ...]  # of ``FIELDS``, in their order


@cache
def message_readers() -> dict[int, tuple[str, np.dtype[Any], float, float]]:
    """Name, type of the payload, units of the clock in a second (0 for none) and its period, by message id."""
    readers = {}
    for definition in definitions().values():
        if definition.name in FIELDS:
            wire = definition.wire
            assert wire.fields is not None
            clock = next((field for field in CLOCK_UNITS if field in wire.fields), None)
            units = 0.0 if clock is None else CLOCK_UNITS[clock]
            period = (
                inf
                if clock is None or wire[clock].itemsize == 8
                else 2.0 ** (8 * wire[clock].itemsize) / units
            )
            # a view: offsets and size of all
            needed = wire[[*FIELDS[definition.name], *filter(None, [clock])]]
            readers[definition.message_id] = definition.name, needed, units, period
    return readers


def message_of(frame: Frame) -> Message | None:
    """The message in a frame with a correct checksum; None if a model does not need it."""
    reader = message_readers().get(frame.message_id)
    if reader is None:
        return None
    name, kind, units, period = reader
    # Truncated bytes are zero; bytes beyond the definition are newer than the dialect.
    values = np.frombuffer(frame.payload[: kind.itemsize].ljust(kind.itemsize, b"\0"), kind)[
        0
    ].item()
    return (
        Message(name, values[-1] / units, period, values[:-1])
        if units
        else Message(name, 0.0, inf, values)
    )


def attitude(message: Message) -> Values | None:
    """Roll, pitch, rad, body rates, rad/s, and yaw, rad; None if not finite or impossible."""
    if message.name == "ATTITUDE":
        roll, pitch, yaw, p, q, r = message.values
    else:
        *attitude, p, q, r = message.values
        if not all(map(isfinite, attitude)):
            return None
        roll, pitch, yaw = map(float, euler_angles(np.array(attitude)))
    # NaN fails every comparison.
    possible = all(abs(angle) <= MAX_ANGLE for angle in (roll, pitch))
    possible = possible and all(abs(rate) <= MAX_BODY_RATE for rate in (p, q, r))
    return (roll, pitch, p, q, r, yaw) if possible else None


def attitude_asked(message: Message) -> Values:
    """Roll and pitch, rad, that an ATTITUDE_TARGET asks for; NaN where it asks for none."""
    mask, quaternion = message.values
    with np.errstate(invalid="ignore"):  # NaN stands for none, too
        roll, pitch, _ = map(float, euler_angles(np.array(quaternion)))
    return (nan, nan) if mask & IGNORED["attitude"] else (roll, pitch)


def outputs(message: Message) -> tuple[int, Values]:
    """The port of a message of motor outputs, or the group of a demand, and its channels, unused ones as 0."""
    if message.name not in MOTOR_MESSAGES or not MOTOR_MESSAGES[message.name].is_ported:
        return int(message.values[0]) if len(message.values) > 1 else 0, tuple(
            message.values[-1].tolist()
        )
    port, *sent = message.values
    return port, tuple(0.0 if value == UINT16_UNKNOWN else float(value) for value in sent)


def parameters_of(messages: Iterable[Message], autopilot: str) -> dict[str, float]:
    """The finite parameters by name, from the PARAM_VALUEs of the named MAV_AUTOPILOT."""
    columns = zip(*(message.values for message in messages), strict=True)
    types = {"param_id": "S16", "param_type": "u1", "param_value": "<f4"}
    parts = {
        name: np.array(column, kind)
        for (name, kind), column in zip(types.items(), columns, strict=True)
    }
    return parameter_values(parts, autopilot)
