"""One message at a time: the fields that a model needs, and the stamp of its clock, from one frame.

The definitions and meanings of the columns in ``ingest`` and ``alignment.signals``, unpacked with ``struct``: a table
takes a hundred times as long for its first row.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from functools import cache
from math import asin, atan2, inf, isfinite
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from mavdem.alignment.drive import DEMAND_MESSAGE, MAX_ANGLE, MAX_BODY_RATE, UNUSED_CHANNEL
from mavdem.alignment.signals import CLIMB_FIELDS
from mavdem.ingest.mavlink.definitions import MessageDefinition, definitions, parameter_values
from mavdem.ingest.mavlink.vehicles import CLOCK_UNITS
from mavdem.live.frames import LiveFrame

Values = tuple[float, ...]

_FORMATS = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q"}
_FORMATS |= {"f4": "f", "f8": "d"}


class LiveMessage(NamedTuple):
    """A message that a model needs."""

    name: str  # of the message
    stamp: float  # its clock, s; zero if it has none
    period: float  # where the clock wraps, s; infinite for 64-bit counters
    values: tuple[Any, ...]  # of :data:`FIELDS`, flat


FIELDS: dict[str, tuple[str, ...]] = {
    "HEARTBEAT": ("type", "autopilot", "base_mode", "custom_mode", "system_status"),
    "PARAM_VALUE": ("param_id", "param_type", "param_value"),
    "EXTENDED_SYS_STATE": ("landed_state",),
    "MESSAGE_INTERVAL": ("message_id", "interval_us"),
    "COMMAND_ACK": ("command", "result", "target_system", "target_component"),
    "ATTITUDE": ("roll", "pitch", "rollspeed", "pitchspeed", "yawspeed"),
    "ATTITUDE_QUATERNION": ("q1", "q2", "q3", "q4", "rollspeed", "pitchspeed", "yawspeed"),
    "SERVO_OUTPUT_RAW": ("port", *(f"servo{n}_raw" for n in range(1, 17))),
    "ACTUATOR_OUTPUT_STATUS": ("actuator",),
    "HIL_ACTUATOR_CONTROLS": ("controls",),
    DEMAND_MESSAGE: ("group_mlx", "controls"),
} | {message: (field,) for message, (field, _) in CLIMB_FIELDS.items()}
"""The messages that a model needs and their fields."""


def message_of(frame: LiveFrame) -> LiveMessage | None:
    """The message in a frame with a correct checksum; None if a model does not need it."""
    reader = readers().get(frame.message_id)
    return None if reader is None else reader(frame.payload)


def attitude(message: LiveMessage) -> Values | None:
    """Roll, pitch, rad, and body rates p and q, rad/s; None if not finite or impossible."""
    if message.name == "ATTITUDE":
        roll, pitch, p, q, r = message.values
    else:
        w, x, y, z, p, q, r = message.values
        if not all(map(isfinite, (w, x, y, z))):
            return None
        roll = atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        pitch = asin(min(max(2 * (w * y - z * x), -1.0), 1.0))
    # NaN fails every comparison.
    possible = all(abs(angle) <= MAX_ANGLE for angle in (roll, pitch))
    possible = possible and all(abs(rate) <= MAX_BODY_RATE for rate in (p, q, r))
    return (roll, pitch, p, q) if possible else None


def outputs(message: LiveMessage) -> tuple[int, Values]:
    """The port of a message of motor outputs, and the outputs; unused ones are 0."""
    if message.name != "SERVO_OUTPUT_RAW":
        return 0, message.values
    port, *sent = message.values
    return port, tuple(0.0 if value == UNUSED_CHANNEL else float(value) for value in sent)


def parameters_of(messages: Iterable[LiveMessage], autopilot: str) -> dict[str, float]:
    """The finite parameters by name, from the PARAM_VALUEs of the named MAV_AUTOPILOT."""
    names, kinds, values = zip(*(message.values for message in messages), strict=True)
    columns = {
        "param_id": np.array(names, dtype="S16"),
        "param_type": np.array(kinds, dtype="u1"),
        "param_value": np.array(values, dtype="<f4"),
    }
    return parameter_values(columns, autopilot)


@cache
def readers() -> dict[int, Callable[[bytes], LiveMessage]]:
    """What reads the payload of a message, by message id; slow the first time."""
    return {
        definition.message_id: _reader(definition, FIELDS[definition.name])
        for definition in definitions().values()
        if definition.name in FIELDS
    }


def _reader(definition: MessageDefinition, fields: tuple[str, ...]) -> Callable[[bytes], LiveMessage]:
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

    def read(payload: bytes) -> LiveMessage:
        # Truncated bytes are zero; bytes beyond the definition are newer than the dialect.
        values = unpack(payload[:size].ljust(size, b"\0"))
        return LiveMessage(name, 0.0 if clock is None else values[at] / units, period, pick(values))

    return read
