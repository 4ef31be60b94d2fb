"""The MAVLink messages that a live model, the wind and the alarms need, decoded from single frames."""

import json
from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from math import inf, nan
from typing import Any, NamedTuple

import numpy as np

from mavdem.containers import Names, Numbers
from mavdem.dataset.axes import MAX_ANGLE, MAX_BODY_RATE
from mavdem.dataset.motor_outputs import UINT16_UNKNOWN
from mavdem.dataset.setpoints import IGNORED_SETPOINT_BITS
from mavdem.ingest.mavlink.dialect import definitions_by_id
from mavdem.ingest.mavlink.frame_reader import Frame
from mavdem.ingest.mavlink.payloads import latest_parameters
from mavdem.ingest.mavlink.vehicles import BOOT_CLOCK_UNITS
from mavdem.ingest.motors import MOTOR_MESSAGES
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import euler_angles

MESSAGE_FIELDS: dict[str, Names] = {
    name: tuple(fields)
    for name, fields in json.loads(
        (files("mavdem.live") / "message_fields.json").read_text("utf-8")
    ).items()
} | {name: form.fields for name, form in MOTOR_MESSAGES.items()}
"""Fields that are decoded, by message name; of messages with a vertical speed that is the first field."""

BITS_PER_BYTE = 8
"""Bits of a byte of a payload."""

BITS_WITHOUT_WRAP = 64
"""Bits of a time stamp that never wraps in practice: counted in nanoseconds, such a counter lasts 580 years."""

STATUS_MESSAGES = (
    "HEARTBEAT",
    "STATUSTEXT",
    "SYS_STATUS",
    "BATTERY_STATUS",
    "BATTERY2",
    "POWER_STATUS",
    "VIBRATION",
    "GPS_RAW_INT",
    "AVAILABLE_MODES",
    "AUTOPILOT_VERSION",
)
"""Slow messages about the autopilot itself. They get the time of the message before them: some have another clock."""

HOME_MESSAGE = "HOME_POSITION"
"""Message with the place to which the autopilot returns. It repeats the time at which that was set."""

IMU_MESSAGES = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU")
"""Messages of the first accelerometer, which shows the knock of an impact. They get the time of the message before
them, too: some count from another moment than the boot."""

STICK_MESSAGES = ("RC_CHANNELS", "RC_CHANNELS_RAW", "MANUAL_CONTROL")
"""Messages with the pilot's throttle stick: whether the pilot stopped all motors in the air, or something failed.

Of the channels, the first eight are decoded: ArduPilot's RCMAP_THROTTLE names one of these.
"""


class Message(NamedTuple):
    """One decoded message."""

    name: str
    """Name of the message's definition."""

    stamp: float
    """Time stamp of the sender's clock, s; 0 where the message has none."""

    wrap_period: float
    """Period after which the stamp wraps to zero, s; infinite for counters of 64 bits."""

    values: tuple[Any, ...]
    """Values of the fields in the order of ``MESSAGE_FIELDS``."""


class AttitudeSample(NamedTuple):
    """Attitude and body rates of one message."""

    roll: float
    """Roll angle, rad."""

    pitch: float
    """Pitch angle, rad."""

    roll_rate: float
    """Body rate about the forward axis, rad/s."""

    pitch_rate: float
    """Body rate about the right axis, rad/s."""

    yaw_rate: float
    """Body rate about the downward axis, rad/s."""

    yaw: float
    """Yaw angle, rad."""

    @property
    def tilt_and_rates(self) -> tuple[float, float, float, float]:
        """Roll and pitch, rad, and their body rates, rad/s: what a sample stream keeps of an attitude."""
        return self.roll, self.pitch, self.roll_rate, self.pitch_rate


class _MessageReader(NamedTuple):
    """How the payload of one message is decoded."""

    name: str
    payload_type: np.dtype[Any]
    """The decoded fields in the payload, and after them the time stamp where there is one."""

    units_per_second: float
    """Units of the time stamp in a second; 0 of a message without a stamp."""

    wrap_period: float
    """Period after which the time stamp wraps, s."""


@cache
def message_readers() -> dict[int, _MessageReader]:
    """Returns the decoder of each message of ``MESSAGE_FIELDS``, by message id; the first call takes a while.

    A payload is read by a structured NumPy type of only the needed fields, with the time stamp as the last one. A stamp
    of n bits in units of 1/u s wraps after 2ⁿ/u s: ``time_boot_ms`` after 49.7 days.
    """
    readers = {}
    for definition in definitions_by_id().values():
        if definition.name not in MESSAGE_FIELDS:
            continue
        # The type of a payload; it has fields, since only a structured type is made for a message.
        payload_type = definition.payload_type
        assert payload_type.fields is not None
        names = list(MESSAGE_FIELDS[definition.name])
        units_per_second = 0.0
        wrap_period = inf
        # Stamps of other clocks are not among them.
        stamp_fields = [name for name in BOOT_CLOCK_UNITS if name in payload_type.fields]
        if stamp_fields:
            stamp_field = stamp_fields[0]
            names.append(stamp_field)
            units_per_second = BOOT_CLOCK_UNITS[stamp_field]
            bits = BITS_PER_BYTE * payload_type[stamp_field].itemsize
            if bits < BITS_WITHOUT_WRAP:
                wrap_period = 2.0**bits / units_per_second
        # A view of some fields keeps the offsets and the size of the whole payload.
        readers[definition.message_id] = _MessageReader(
            definition.name, payload_type[names], units_per_second, wrap_period
        )
    return readers


def decode_message(frame: Frame) -> Message | None:
    """Decodes the needed fields of the message in a frame.

    It is called for every frame of a link, and therefore reads only these fields, all of them at once.

    Args:
        frame: frame with a matching checksum; others may hold any bytes.

    Returns:
        The message, with its stamp in s; None if nothing live needs it.
    """
    reader = message_readers().get(frame.message_id)
    if reader is None:
        return None
    # MAVLink 2 leaves out zeros at the end of the payload. Bytes beyond the definition are fields of a newer one.
    size = reader.payload_type.itemsize
    payload = frame.payload[:size].ljust(size, b"\0")
    values = np.frombuffer(payload, reader.payload_type)[0].item()
    if not reader.units_per_second:
        return Message(reader.name, 0.0, inf, values)
    stamp = values[-1] / reader.units_per_second
    return Message(reader.name, stamp, reader.wrap_period, values[:-1])


def attitude_sample(message: Message) -> AttitudeSample | None:
    """Returns the attitude of an ATTITUDE or ATTITUDE_QUATERNION.

    A quaternion is converted to roll, pitch and yaw. An angle beyond ``MAX_ANGLE`` or a rate beyond ``MAX_BODY_RATE``
    is impossible: it is of a damaged message whose checksum matches by chance.

    Args:
        message: a decoded message of one of these two types.

    Returns:
        The attitude, rad and rad/s; None if a value is not finite or is impossible.
    """
    # The values are in the order of ``MESSAGE_FIELDS``: the angles or the quaternion, then the body rates.
    *angles, roll_rate, pitch_rate, yaw_rate = message.values
    if message.name == "ATTITUDE_QUATERNION":
        quaternion = np.array(angles)
        if not np.isfinite(quaternion).all():
            return None
        angles = [float(angle) for angle in euler_angles(quaternion)]
    roll, pitch, yaw = angles
    # NaN fails every comparison, so values that are not finite count as impossible, too.
    angles_are_possible = abs(roll) <= MAX_ANGLE and abs(pitch) <= MAX_ANGLE
    rates_are_possible = (
        abs(roll_rate) <= MAX_BODY_RATE
        and abs(pitch_rate) <= MAX_BODY_RATE
        and abs(yaw_rate) <= MAX_BODY_RATE
    )
    if not (angles_are_possible and rates_are_possible):
        return None
    return AttitudeSample(
        roll, pitch=pitch, roll_rate=roll_rate, pitch_rate=pitch_rate, yaw_rate=yaw_rate, yaw=yaw
    )


class TiltSetpoint(NamedTuple):
    """Setpoints of the tilt; NaN where none are set."""

    roll: float = nan
    """Setpoint of roll, rad."""

    pitch: float = nan
    """Setpoint of pitch, rad."""


def tilt_setpoint(message: Message) -> TiltSetpoint:
    """Returns the setpoints of roll and pitch in an ATTITUDE_TARGET.

    A set bit of its type mask says that the attitude is to be ignored, for example when only body rates are commanded.

    Args:
        message: a decoded ATTITUDE_TARGET, with the type mask and a quaternion (w, x, y, z) before its body rates.
    """
    type_mask, quaternion, *_body_rates = message.values
    if type_mask & IGNORED_SETPOINT_BITS["attitude"]:
        return TiltSetpoint()
    # A quaternion of NaN means "no setpoint" too; its angles become NaN.
    with np.errstate(invalid="ignore"):
        roll, pitch, _ = euler_angles(np.array(quaternion))
    return TiltSetpoint(float(roll), float(pitch))


class PortOutputs(NamedTuple):
    """Motor outputs of one port of an autopilot."""

    port: int
    """Number of the port, from 0."""

    outputs: Numbers
    """An output for each channel, in the unit of the message; 0 without an output."""


def port_outputs(message: Message) -> PortOutputs:
    """Returns the motor outputs of a message, and the port (group of outputs) that they belong to.

    Autopilots with more outputs than a message has channels send it once for each port (SERVO_OUTPUT_RAW). Messages
    without ports have all outputs in one array, and count as port 0. Outputs that the autopilot marks as unused become
    0, which means "no output" everywhere in live flights.

    Args:
        message: a decoded message with motor outputs.

    Returns:
        The number of the port, and its outputs in the unit of the message.
    """
    if not MOTOR_MESSAGES[message.name].is_ported:
        all_outputs = message.values[-1]
        return PortOutputs(0, tuple(all_outputs.tolist()))
    port, *channels = message.values
    outputs = []
    for value in channels:
        is_unused = value == UINT16_UNKNOWN
        outputs.append(0.0 if is_unused else float(value))
    return PortOutputs(port, tuple(outputs))


def parameters_by_name(messages: Iterable[Message], autopilot: str) -> Parameters:
    """Returns the finite values of an autopilot's parameters by name, decoded as the parameters in a log are.

    Args:
        messages: messages PARAM_VALUE of one vehicle, at least one.
        autopilot: name of the MAV_AUTOPILOT, which decides how integers are sent as floats.
    """
    ids = []
    types = []
    values = []
    for message in messages:
        parameter_id, parameter_type, value = message.values
        ids.append(parameter_id)
        types.append(parameter_type)
        values.append(value)
    # The types that the fields of the message have in a log.
    columns = {
        "param_id": np.array(ids, "S16"),
        "param_type": np.array(types, "u1"),
        "param_value": np.array(values, "<f4"),
    }
    return latest_parameters(columns, autopilot)
