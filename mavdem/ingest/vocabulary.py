"""MAVLink's numbers for a vehicle, its board, its state and its attitude, and HEARTBEAT, which carries most of them.

Source: MAV_MODE_FLAG, MAV_AUTOPILOT, MAV_COMPONENT, MAV_STATE and MAV_LANDED_STATE of ``minimal.xml`` and
``common.xml``; modes of ArduCopter's ``mode.h`` and PX4's ``px4_custom_mode.h``.
"""

import re
from collections.abc import Iterable
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect
from scipy.spatial.transform import Rotation

from mavdem.arrays import Array
from mavdem.files import load_adjacent_toml
from mavdem.ingest.telemetry import Fields


def mavlink_constant(name: str) -> int:
    """Returns MAVLink's number of an entry of an enumeration, by its whole name: "MAV_TYPE_QUADROTOR"."""
    return int(getattr(dialect, name))


# of HEARTBEAT.base_mode
ARMED: int = dialect.MAV_MODE_FLAG_SAFETY_ARMED
CUSTOM_MODE: int = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
# of EXTENDED_SYS_STATE.landed_state
ON_GROUND: int = dialect.MAV_LANDED_STATE_ON_GROUND
IN_AIR: int = dialect.MAV_LANDED_STATE_IN_AIR
TAKING_OFF: int = dialect.MAV_LANDED_STATE_TAKEOFF
LANDING: int = dialect.MAV_LANDED_STATE_LANDING
# ArduPilot and PX4 report the last two only once they have left the ground
OFF_GROUND = (IN_AIR, TAKING_OFF, LANDING)
# of HEARTBEAT.system_status: on the ground, in flight, and in a failsafe
STANDBY: int = dialect.MAV_STATE_STANDBY
ACTIVE: int = dialect.MAV_STATE_ACTIVE
CRITICAL: int = dialect.MAV_STATE_CRITICAL
NO_SEVERITY = np.iinfo(
    np.uint8
).max  # of STATUSTEXT whose source does not log it, beside MAV_SEVERITY's 0 to 7
GENERIC: int = dialect.MAV_AUTOPILOT_GENERIC  # where the autopilot is not known
ARDUPILOT: int = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
PX4: int = dialect.MAV_AUTOPILOT_PX4
AUTOPILOT_COMPONENT: int = dialect.MAV_COMP_ID_AUTOPILOT1
LANDING_MODES = {
    ARDUPILOT: {6, 9, 21, 27},  # RTL, LAND, SMART_RTL, AUTO_RTL
    PX4: {sub << 24 | 4 << 16 for sub in (5, 6, 9)},  # of AUTO: RTL, LAND, PRECLAND
}
"""HEARTBEAT.custom_mode of multirotors that land by themselves, sooner or later, by MAV_AUTOPILOT."""
# What sends ``RADIO_MESSAGES`` only, and no HEARTBEAT: a SiK radio, usually as 51:68
RADIO = "TELEMETRY_RADIO"
RADIO_MESSAGES = frozenset({"RADIO_STATUS", "RADIO"})
UNNAMED = "UNKNOWN"  # Name of a vehicle or an autopilot that no HEARTBEAT gives

NAMES = load_adjacent_toml(__file__, "names.toml")
CONTROL_PARAMETERS = re.compile(
    r"ATC_RAT_|ATC_ANG_(RLL|PIT|YAW)_P$|INS_GYRO_(FILTER|RATE)$|INS_(HNTC[H23]|NOTCH)_|SCHED_LOOP_RATE$|"
    r"FSTRATE_ENABLE$|FRAME_CLASS$|MOT_(THST_EXPO|THST_HOVER|SPIN_MIN|SPIN_MAX|BAT_VOLT_MAX)$|"
    r"MC_(ROLL|PITCH|YAW)|MC_BAT_SCALE_EN$|THR_MDL_FAC$|IMU_GYRO_(CUTOFF$|RATEMAX$|NF|DNF_)|IMU_DGYRO_CUTOFF$|"
    r"CA_(AIRFRAME|ROTOR_COUNT)$|CA_ROTOR[0-3]_|"
    r"RATE_(RLL|PIT|YAW)_|STB_(RLL|PIT|YAW)_P$|FRAME$|THR_MIN$|MOT_THST_MAX$|FILT[1-8]_(TYPE$|NOTCH_)"
)
"""Names of ArduPilot's and PX4's parameters that rate and attitude control depend on."""
RATE_GAIN = re.compile(r"(ATC_RAT|RATE)_RLL_P$|MC_ROLLRATE_P$")
"""Names of the gain P of roll's rate, which each controller has."""
AUTOPILOT_SET_PARAMETERS = re.compile(
    r"^(STAT_|CAL_|TC_|_HASH_CHECK|LND_FLIGHT_T|COM_FLIGHT_UUID|MOT_THST_HOVER|RC\d+_(MIN|MAX|TRIM))|"
    r"_(PRESS|TEMP|CALTEMP|DEC|TOTAL|LASTFILE|RESETS)$|(OFFS?|OFS\d?|SCAL|DIA|ODI|MOT|AHRS_TRIM)_[XYZ]$"
)
"""Names of parameters that autopilots set by themselves: counters, and in flight, at their start and by calibration."""


class Injection(IntEnum):
    """What a signal of system identification is added to: SID_AXIS of ArduCopter for roll; pitch and yaw follow."""

    ANGLE_SETPOINT = 1
    RECOVERED_ANGLE_SETPOINT = 4  # without shaping of the input
    RATE_SETPOINT = 7
    DEMAND = 10


VERSION_KINDS = ("official", "rc", "beta", "alpha", "dev")
"""Kinds of version; the last byte of a version number is that of FIRMWARE_VERSION_TYPE, or more."""


def version_text(number: int) -> str:
    """Returns a firmware's version as PX4 and ArduPilot number it, a byte each: "1.16.1-rc"."""
    major, minor, patch, last = number.to_bytes(4, "big")
    least = "FIRMWARE_VERSION_TYPE_"
    kind = next(kind for kind in VERSION_KINDS if last >= mavlink_constant(least + kind.upper()))
    return f"{major}.{minor}.{patch}-{kind}".removesuffix("-official")


def heartbeat_fields(vehicle_type: int, autopilot: int, armed: NDArray[Any]) -> Fields:
    """Returns fields of HEARTBEAT (N,) for one vehicle.

    They follow from its MAV_TYPE, its MAV_AUTOPILOT and where it is ``armed`` (N,).
    """
    base = np.where(armed > 0, ARMED, 0).astype(np.uint8)
    return {
        "type": np.full_like(base, vehicle_type),
        "autopilot": np.full_like(base, autopilot),
        "base_mode": base,
    }


ARDUPILOT_TEXT = re.compile(r"^\S+ ([0-9A-F]{8}) ([0-9A-F]{8}) ([0-9A-F]{8})$")
"""What ArduPilot says at boot: the board's name, and the processor's number as three words of four bytes."""
SIMULATED_TEXT = re.compile(r"^.[0-9a-f]{31}$")
"""What its simulator says instead: the machine's number, with the vehicle's added to the first letter."""
SIMULATED_LETTERS = 17  # Letters of it that AUTOPILOT_VERSION has room for
WORD = np.dtype(np.uint32).itemsize  # Bytes of such a word, the last byte first


def board_number_in_texts(texts: Iterable[str]) -> str:
    """Returns the number in what ArduPilot says at boot ("CUAVv5Nano 001A002F 30395113 33333539").

    It is empty where there is none.
    """
    for text in texts:
        if match := ARDUPILOT_TEXT.match(text.strip()):
            return "".join(match.groups()).lower()
        if SIMULATED_TEXT.match(text.strip()):
            return text[:SIMULATED_LETTERS].encode().hex()
    return ""


def board_name_in_texts(texts: Iterable[str]) -> str:
    """Returns the kind of board in what ArduPilot says at boot ("CUAVv5Nano"); empty where it does not."""
    return next((text.split()[0] for text in texts if ARDUPILOT_TEXT.match(text.strip())), "")


def board_number_in_bytes(uid2: bytes, words: bool) -> str:
    """Returns the number in AUTOPILOT_VERSION.uid2; with ``words``, as ArduPilot's text has it.

    It is empty where there is none.
    """
    if sum(byte > 0 for byte in uid2) < 6:  # simulators number their vehicles in one byte or two
        return ""
    number = uid2.rstrip(b"\0")
    if not words or len(number) > 3 * WORD:
        return (number[:SIMULATED_LETTERS] if words else uid2).hex()
    number = uid2[: 3 * WORD]
    return b"".join(number[at : at + WORD][::-1] for at in range(0, len(number), WORD)).hex()


def wrapped_angle(angle: Any) -> Any:
    """Returns an angle, rad, or an array of angles, within half a turn of 0."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def euler_angles(attitude: Array) -> tuple[Array, Array, Array]:
    """Returns roll, pitch and yaw (N,), rad, of unit quaternions (N, 4): w, x, y, z, body to north-east-down, Z-Y-X."""
    w, x, y, z = attitude.T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    return roll, pitch, np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def quaternion(roll: Array, pitch: Array, yaw: Array) -> Array:
    """Returns unit quaternions (N, 4), w, x, y, z, of Euler angles (N,), rad: the inverse of :func:`euler_angles`."""
    turned = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))
    return turned.as_quat(scalar_first=True)


def attitude_target(asked: Array) -> Fields:
    """Returns the fields of ATTITUDE_TARGET of attitudes (N, 4), or body rates (N, 3), rad/s; the other is masked."""
    is_attitude = asked.shape[1] == 4
    unknown = np.full((len(asked), 4), np.nan)
    roll, pitch, yaw = (unknown[:, :3] if is_attitude else asked).T
    return {
        "type_mask": np.full(len(asked), 1 | 2 | 4 if is_attitude else 128, np.uint8),
        "q": asked if is_attitude else unknown,
        "body_roll_rate": roll,
        "body_pitch_rate": pitch,
        "body_yaw_rate": yaw,
    }
