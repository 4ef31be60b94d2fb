"""The frames in the bytes of a link, and the messages in them that a model needs, one at a time.

A frame counts as in files: with a correct checksum; frames of another dialect, or damaged ones, where they fill the
bytes between two good ones exactly.
"""

import json
from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from math import inf, isfinite, nan
from typing import Any, NamedTuple

import numpy as np

from mavdem.containers import Names, Numbers
from mavdem.dataset.axes import MAX_ANGLE, MAX_BODY_RATE
from mavdem.dataset.motor_outputs import UINT16_UNKNOWN
from mavdem.dataset.setpoints import IGNORED_SETPOINT_BITS
from mavdem.ingest.mavlink import framing
from mavdem.ingest.mavlink.definitions import definitions_by_id, latest_parameters
from mavdem.ingest.mavlink.vehicles import BOOT_CLOCK_UNITS
from mavdem.ingest.motors import MOTOR_MESSAGES
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import euler_angles

MAX_UNDECIDED = 32 * framing.MAX_FRAME_BYTES  # Bytes without a good frame that wait for one

FIELDS: dict[str, Names] = {
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
    checksum: int  # ``CHECKSUM_MATCHES``, ``MESSAGE_UNKNOWN`` or ``CHECKSUM_FAILED`` of ``framing``
    payload: bytes  # as sent, without the zeros that MAVLink 2 truncates
    content: bytes  # all of it


class FrameReader:
    """Finds the frames of one stream."""

    def __init__(self) -> None:
        self.unread = 0  # number of those of other dialects, and damaged ones
        self._rest = b""
        self._searched = 0  # bytes of that in which no good frame begins
        message_readers()  # slow the first time

    def feed(self, piece: bytes) -> list[Frame]:
        """Returns the frames that the next bytes complete, in order; good ones do not depend on how bytes are cut."""
        data = self._rest + piece
        begin = 0
        offset = self._searched
        read = []
        while (length := _announced(data, offset)) <= len(data) - offset:
            frame = _frame_of(data[offset : offset + length]) if length else None
            if frame is None or frame.checksum != framing.CHECKSUM_MATCHES:
                offset += 1
                continue
            others = _filling(data[begin:offset])
            self.unread += len(others)
            read += [*others, frame]
            begin = offset = offset + length
        begin = max(begin, offset - MAX_UNDECIDED)
        self._rest = data[begin:]
        self._searched = offset - begin
        return read


def _announced(data: bytes, start: int) -> int:
    """Bytes of the frame whose header is at ``start``; 0 if none is, and the most where that does not show yet."""
    header = data[start : start + 3]
    return (framing.frame_length(*header) or 0) if len(header) == 3 else framing.MAX_FRAME_BYTES


def _filling(data: bytes) -> list[Frame]:
    """The frames of other dialects, or damaged ones, that fill the bytes between two good ones exactly."""
    frames = []
    while data:
        length = _announced(data, 0)
        if not 0 < length <= len(data):
            return []
        frames.append(_frame_of(data[:length]))
        data = data[length:]
    return frames


def _frame_of(content: bytes) -> Frame:
    """The frame that bytes are, by their header."""
    first, size = (
        (4, framing.HEADER_BYTES_V2)
        if content[0] == framing.MARKER_V2
        else (2, framing.HEADER_BYTES_V1)
    )
    sequence, system, component, *number = content[first:size]
    message_id = int.from_bytes(bytes(number), "little")
    behind = size + content[1]
    definition = definitions_by_id().get(message_id)
    checksum = framing.MESSAGE_UNKNOWN
    if definition is not None:
        sent = int.from_bytes(content[behind : behind + 2], "little")
        agrees = sent == framing.frame_checksum(content[1:behind], definition.crc_extra)
        checksum = framing.CHECKSUM_MATCHES if agrees else framing.CHECKSUM_FAILED
    payload = content[size:behind]
    return Frame(message_id, system, component, sequence, checksum, payload, content)


class Piece(NamedTuple):
    """Frames, their ``arrival`` by the monotonic clock and their ``stamp``, UNIX s."""

    arrival: float
    stamp: float
    frames: list[Frame]


class Message(NamedTuple):
    """A message that a model needs."""

    name: str
    stamp: float  # its clock, s; zero if it has none
    period: float  # where the clock wraps, s; infinite for 64-bit counters
    values: tuple[Any, ...]  # of ``FIELDS``, in their order


@cache
def message_readers() -> dict[int, tuple[str, np.dtype[Any], float, float]]:
    """Returns name, type of the payload, units of the clock in a second (0 for none) and its period, by message id."""
    readers = {}
    for definition in definitions_by_id().values():
        if definition.name in FIELDS:
            wire = definition.wire
            assert wire.fields is not None
            clock = next((field for field in BOOT_CLOCK_UNITS if field in wire.fields), None)
            units = 0.0 if clock is None else BOOT_CLOCK_UNITS[clock]
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
    """Returns the message in a frame with a correct checksum; None if a model does not need it."""
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


def attitude(message: Message) -> Numbers | None:
    """Returns roll, pitch, rad, body rates, rad/s, and yaw, rad; None if not finite or impossible."""
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


def attitude_asked(message: Message) -> Numbers:
    """Returns roll and pitch, rad, that an ATTITUDE_TARGET asks for; NaN where it asks for none."""
    mask, quaternion = message.values
    with np.errstate(invalid="ignore"):  # NaN stands for none, too
        roll, pitch, _ = map(float, euler_angles(np.array(quaternion)))
    return (nan, nan) if mask & IGNORED_SETPOINT_BITS["attitude"] else (roll, pitch)


def outputs(message: Message) -> tuple[int, Numbers]:
    """Returns the port of a message of motor outputs, and its channels, unused ones as 0."""
    if not MOTOR_MESSAGES[message.name].is_ported:
        return 0, tuple(message.values[-1].tolist())
    port, *sent = message.values
    return port, tuple(0.0 if value == UINT16_UNKNOWN else float(value) for value in sent)


def parameters_of(messages: Iterable[Message], autopilot: str) -> Parameters:
    """Returns the finite parameters by name, from the PARAM_VALUEs of the named MAV_AUTOPILOT."""
    columns = zip(*(message.values for message in messages), strict=True)
    types = {"param_id": "S16", "param_type": "u1", "param_value": "<f4"}
    parts = {
        name: np.array(column, kind)
        for (name, kind), column in zip(types.items(), columns, strict=True)
    }
    return latest_parameters(parts, autopilot)
