"""One message at a time: the fields that a model needs, and the stamp of its clock, out of one frame.

The same definitions and the same meaning as those of columns (``decode``, ``messages``, ``meaning``), read with
``struct``: a table takes a hundred times as long for its first row.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from functools import cache
from math import asin, atan2, inf, isfinite
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from mavdem.ingest.decode import Definition, definitions
from mavdem.ingest.live_frames import Frame
from mavdem.ingest.meaning import CLIMBS, DEMAND, FASTEST, TURN, UNUSED_CHANNEL
from mavdem.ingest.messages import CLOCK_UNITS
from mavdem.ingest.parameters import parameters

Values = tuple[float, ...]

_FORMATS = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q"}
_FORMATS |= {"f4": "f", "f8": "d"}


class Message(NamedTuple):
    """One message of those that a model needs.

    Attributes:
        name: of the message.
        stamp: its clock, s; zero where it has none.
        period: where that wraps, s; infinite for 64-bit counters.
        values: of :data:`FIELDS`, flat; what they mean is told by the functions here.
    """

    name: str
    stamp: float
    period: float
    values: tuple[Any, ...]


FIELDS: dict[str, tuple[str, ...]] = {
    "HEARTBEAT": ("type", "autopilot", "base_mode"),
    "PARAM_VALUE": ("param_id", "param_type", "param_value"),
    "EXTENDED_SYS_STATE": ("landed_state",),
    "MESSAGE_INTERVAL": ("message_id", "interval_us"),
    "COMMAND_ACK": ("command", "result"),
    "ATTITUDE": ("roll", "pitch", "rollspeed", "pitchspeed", "yawspeed"),
    "ATTITUDE_QUATERNION": ("q1", "q2", "q3", "q4", "rollspeed", "pitchspeed", "yawspeed"),
    "SERVO_OUTPUT_RAW": ("port", *(f"servo{n}_raw" for n in range(1, 17))),
    "ACTUATOR_OUTPUT_STATUS": ("actuator",),
    "HIL_ACTUATOR_CONTROLS": ("controls",),
    DEMAND: ("group_mlx", "controls"),
} | {message: (field,) for message, (field, _) in CLIMBS.items()}
"""The messages that a model needs and their fields."""


def message_of(frame: Frame) -> Message | None:
    """What a frame whose checksum agrees holds; None where it is of no use to a model."""
    reader = _readers().get(frame.message_id)
    return None if reader is None else reader(frame.payload)


def attitude(message: Message) -> Values | None:
    """Roll, pitch, rad, and the body rates p and q, rad/s; None where they are not finite or cannot be."""
    if message.name == "ATTITUDE":
        roll, pitch, p, q, r = message.values
    else:
        w, x, y, z, p, q, r = message.values
        if not all(map(isfinite, (w, x, y, z))):
            return None
        roll = atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        pitch = asin(min(max(2 * (w * y - z * x), -1.0), 1.0))
    # Written so that what is no number does not pass.
    if not (max(abs(roll), abs(pitch)) <= TURN and max(abs(p), abs(q), abs(r)) <= FASTEST):
        return None
    if roll != roll or pitch != pitch or p != p or q != q or r != r:
        return None
    return roll, pitch, p, q


def outputs(message: Message) -> tuple[int, Values]:
    """The port a message of motor outputs is of, and the outputs; unused ones are 0."""
    if message.name != "SERVO_OUTPUT_RAW":
        return 0, message.values
    port, *sent = message.values
    return port, tuple(0.0 if value == UNUSED_CHANNEL else float(value) for value in sent)


def parameters_of(messages: Iterable[Message], autopilot: str) -> dict[str, float]:
    """The finite values of parameters by name, from PARAM_VALUEs of the MAV_AUTOPILOT named."""
    names, kinds, values = zip(*(message.values for message in messages), strict=True)
    columns = {
        "param_id": np.array(names, dtype="S16"),
        "param_type": np.array(kinds, dtype="u1"),
        "param_value": np.array(values, dtype="<f4"),
    }
    return parameters(columns, autopilot)


def prepare() -> None:
    """Does now what takes a while the first time."""
    _readers()


@cache
def _readers() -> dict[int, Callable[[bytes], Message]]:
    return {
        definition.message_id: _reader(definition, FIELDS[definition.name])
        for definition in definitions().values()
        if definition.name in FIELDS
    }


def _reader(definition: Definition, fields: tuple[str, ...]) -> Callable[[bytes], Message]:
    wire, name = definition.wire, definition.name
    assert wire.names is not None
    form, places, count = "<", {}, 0
    for field in wire.names:
        kind = wire[field]
        text, number = kind.base.kind == "S", int(np.prod(kind.shape))
        form += f"{kind.base.itemsize}s" if text else _FORMATS[kind.base.str[1:]] * number
        places[field] = range(count, count + number)
        count += number
    unpack, size = struct.Struct(form).unpack, wire.itemsize
    wanted = [place for field in fields for place in places[field]]
    pick: Callable[[tuple[Any, ...]], tuple[Any, ...]] = (
        itemgetter(*wanted) if len(wanted) > 1 else lambda values: (values[wanted[0]],)
    )
    clock = next((field for field in CLOCK_UNITS if field in places), None)
    at, units, period = 0, 1.0, inf
    if clock is not None:
        at, units = places[clock][0], CLOCK_UNITS[clock]
        period = inf if wire[clock].itemsize == 8 else 2.0 ** (8 * wire[clock].itemsize) / units

    def read(payload: bytes) -> Message:
        # What was not sent is zero; what is beyond the definition is newer than the dialect.
        values = unpack(payload[:size].ljust(size, b"\0"))
        return Message(name, 0.0 if clock is None else values[at] / units, period, pick(values))

    return read
