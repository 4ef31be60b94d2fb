"""MAVLink constants, names of autopilot parameters, and conversions of attitude, shared by all readers of logs.

Sources: MAV_MODE_FLAG, MAV_AUTOPILOT, MAV_COMPONENT, MAV_STATE and MAV_LANDED_STATE of MAVLink's ``minimal.xml`` and
``common.xml``; modes of ArduCopter's ``mode.h`` and PX4's ``px4_custom_mode.h``.
"""

import re
from collections.abc import Iterable
from enum import IntEnum, StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array
from mavdem.files import load_adjacent_toml
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.telemetry import Fields

MILLIMETRES_PER_METRE = 1000.0
"""MAVLink's altitudes, and the accuracies of its positions, are in mm."""

DEGREES_PER_UNIT = 1e-7
"""Unit of latitude and longitude in MAVLink's messages, such as GLOBAL_POSITION_INT, degrees."""

UNITS_PER_DEGREE = 1e7
"""Its reciprocal, by which degrees are multiplied: ``1 / DEGREES_PER_UNIT`` is rounded."""

# Flags of HEARTBEAT.base_mode.

ARMED = mavlink_constant("MAV_MODE_FLAG_SAFETY_ARMED")
"""The motors are armed."""
CUSTOM_MODE = mavlink_constant("MAV_MODE_FLAG_CUSTOM_MODE_ENABLED")
"""The field custom_mode has the flight mode."""

# Values of EXTENDED_SYS_STATE.landed_state.

UNDEFINED_LANDED_STATE = mavlink_constant("MAV_LANDED_STATE_UNDEFINED")
"""The autopilot sends the message, but does not know the state."""
ON_GROUND = mavlink_constant("MAV_LANDED_STATE_ON_GROUND")
"""The vehicle stands on the ground."""
IN_AIR = mavlink_constant("MAV_LANDED_STATE_IN_AIR")
"""The vehicle flies."""
TAKING_OFF = mavlink_constant("MAV_LANDED_STATE_TAKEOFF")
"""The vehicle is taking off."""
LANDING = mavlink_constant("MAV_LANDED_STATE_LANDING")
"""The vehicle is landing."""
OFF_GROUND = (IN_AIR, TAKING_OFF, LANDING)
"""The states in the air: ArduPilot and PX4 report taking off and landing only while they are off the ground."""

MAVLINK_VERSION = 3
"""HEARTBEAT.mavlink_version, which every sender fills in (minimal.xml)."""

# Values of HEARTBEAT.system_status.

BOOTING = mavlink_constant("MAV_STATE_BOOT")
"""The autopilot starts."""
STANDBY = mavlink_constant("MAV_STATE_STANDBY")
"""The vehicle is ready on the ground."""
ACTIVE = mavlink_constant("MAV_STATE_ACTIVE")
"""The vehicle is in flight."""
CRITICAL = mavlink_constant("MAV_STATE_CRITICAL")
"""The vehicle is in a failsafe."""

NO_SEVERITY = np.iinfo(np.uint8).max
"""Value of STATUSTEXT.severity for texts whose source does not log it; MAV_SEVERITY has 0 to 7."""

# Values of HEARTBEAT.autopilot.

GENERIC = mavlink_constant("MAV_AUTOPILOT_GENERIC")
"""The autopilot is not known."""
ARDUPILOT = mavlink_constant("MAV_AUTOPILOT_ARDUPILOTMEGA")
"""ArduPilot."""
PX4 = mavlink_constant("MAV_AUTOPILOT_PX4")
"""PX4."""

AUTOPILOT_COMPONENT = mavlink_constant("MAV_COMP_ID_AUTOPILOT1")
"""Component id of a vehicle's autopilot."""

LANDING_MODES = {
    # RTL, LAND, SMART_RTL and AUTO_RTL of ArduCopter.
    ARDUPILOT: {6, 9, 21, 27},
    # RTL, LAND and PRECLAND: sub modes 5, 6 and 9, in bits 24 to 31, of the main mode AUTO, 4, in bits 16 to 23.
    PX4: {sub_mode << 24 | 4 << 16 for sub_mode in (5, 6, 9)},
}
"""Values of HEARTBEAT.custom_mode in which a multirotor lands by itself, sooner or later, by MAV_AUTOPILOT."""

RADIO = "TELEMETRY_RADIO"
"""Kind of a component that sends ``RADIO_MESSAGES`` only, and no HEARTBEAT: a SiK radio, usually as 51:68."""
RADIO_MESSAGES = frozenset({"RADIO_STATUS", "RADIO"})
"""The messages that a telemetry radio adds to a stream."""

UNNAMED = "UNKNOWN"
"""Name of a vehicle's type, or of an autopilot, that no HEARTBEAT gives."""

AUTOPILOT_NAMES = {"ARDUPILOTMEGA": "ArduPilot", "PX4": "PX4"}
"""How people call the autopilots whose logs are read, by their MAV_AUTOPILOT without its prefix."""

NAMES = load_adjacent_toml(__file__, "names.toml")
"""Tables of names: MAV_TYPEs, drivers, parameters and flight modes; ``names.toml`` describes each table."""

CONTROL_PARAMETERS = re.compile(
    r"ATC_RAT_|ATC_ANG_(RLL|PIT|YAW)_P$|INS_GYRO_(FILTER|RATE)$|INS_(HNTC[H23]|NOTCH)_|SCHED_LOOP_RATE$|"
    r"FSTRATE_ENABLE$|FRAME_CLASS$|MOT_(THST_EXPO|THST_HOVER|SPIN_MIN|SPIN_MAX|BAT_VOLT_MAX)$|"
    r"MC_(ROLL|PITCH|YAW)|MC_BAT_SCALE_EN$|THR_MDL_FAC$|IMU_GYRO_(CUTOFF$|RATEMAX$|NF|DNF_)|IMU_DGYRO_CUTOFF$|"
    r"MC_DTERM_CUTOFF$|CA_(AIRFRAME|ROTOR_COUNT)$|CA_ROTOR[0-3]_|"
    r"RATE_(RLL|PIT|YAW)_|STB_(RLL|PIT|YAW)_P$|FRAME$|THR_MIN$|MOT_THST_MAX$|FILT[1-8]_(TYPE$|NOTCH_)"
)
"""Names of ArduPilot's and PX4's parameters that rate and attitude control depend on."""

CODED_PARAMETERS = re.compile(
    r"FRAME(_CLASS)?$|CA_|INS_GYRO_RATE$|.*_(ENABLE|EN|MODE|OPTS|REF|HMNCS|HMC|TYPE|NTF|NEF)$"
)
"""Names of those of them whose value is a choice, a count, a place or a set of bits, which has no change in percent."""

RATE_GAIN = re.compile(r"(ATC_RAT|RATE)_RLL_P$|MC_ROLLRATE_P$")
"""Names of the proportional gain of the roll rate, which each version of each autopilot has."""

AXIS_RATE_LOOP_PARAMETERS = re.compile(
    r"(ATC_RAT|RATE)_(RLL|PIT|YAW)_(P|I|D|FF|D_FF|FILT|FILT_HZ|FLT[TED]|N[TE]F)$|"
    r"MC_(ROLL|PITCH|YAW)RATE_([PIDK]|FF)$|MC_YAW_TQ_CUTOFF$"
)
"""Names of the gains and filters of one axis' rate loop: no limits, and no gains from attitude to rate."""

OUTPUT_RANGE_PARAMETERS = re.compile(
    r"(SERVO\d+|MOT_SPIN|MOT_PWM)_(MIN|MAX)$|PWM_(MAIN|AUX)_(MIN|MAX)\d+$|MOT_THST_MAX$|THR_MIN$"
)
"""Names of the parameters that set the range of the motor outputs, of which an output is a fraction."""

RATE_PID_GAINS = re.compile(r"(ATC_RAT|RATE)_(RLL|PIT|YAW)_[PID]$|MC_(ROLL|PITCH|YAW)RATE_[PIDK]$")
"""Names of the gains of rate control on all axes."""

ATTITUDE_GAIN = re.compile(r"ATC_ANG_(RLL|PIT|YAW)_P$|STB_(RLL|PIT|YAW)_P$|MC_(ROLL|PITCH|YAW)_P$")
"""Names of the gains from attitude to rate."""

AUTOPILOT_SET_PARAMETERS = re.compile(
    r"^(STAT_|CAL_|TC_|_HASH_CHECK|LND_FLIGHT_T|COM_FLIGHT_UUID|MOT_THST_HOVER|RC\d+_(MIN|MAX|TRIM))|"
    r"_(PRESS|TEMP|CALTEMP|DEC|TOTAL|LASTFILE|RESETS)$|(OFFS?|SCAL|AHRS_TRIM)_[XYZ]$|"
    r"^COMPASS_((OFS|DIA|ODI|MOT)\d?_[XYZ]|SCALE\d?)$|^SENS_BOARD_[XYZ]_OFF$"
)
"""Names of parameters that autopilots set by themselves: counters, and what they learn in flight and by calibration."""

FLIGHT_INDEPENDENT_PARAMETERS = re.compile(r"(SIM|SIH|SYSID|MAV|SR\d|STAT|LOG|SDLOG)_")
"""Names of the parameters of a simulator, of MAVLink, logging and statistics: a vehicle flies the same with others."""

CALIBRATION_PARAMETERS = {
    "accelerometers": re.compile(
        r"INS\d?_ACC\d?(OFFS|SCAL)_[XYZ]$|INS\d?_ACC\d?_CALTEMP$|CAL_ACC\d_[XYZ]SCALE$"
    ),
    "level": re.compile(r"AHRS_TRIM_[XYZ]$|SENS_BOARD_[XYZ]_OFF$"),
    "compass": re.compile(
        r"COMPASS_((DIA|ODI|MOT)\d?_[XYZ]|SCALE\d?)$|CAL_MAG\d_[XYZ](SCALE|ODIAG|COMP)$"
    ),
    "radio": re.compile(r"RC\d+_(MIN|MAX|TRIM)$"),
    "temperature compensation": re.compile("TC_"),
}
"""Names of parameters of ArduPilot and PX4 that only a calibration by a person sets, by what is calibrated."""

CALIBRATED_OR_LEARNED_PARAMETERS = {
    "accelerometers": re.compile("CAL_ACC"),
    "gyros": re.compile("CAL_GYRO"),
    "compass": re.compile(r"COMPASS_OFS\d?_[XYZ]$|CAL_MAG"),
}
"""Names of parameters that a calibration sets, or that the autopilot learns in flight, by what is calibrated.

ArduPilot learns offsets of the compass by COMPASS_LEARN, PX4 those of all three by SENS_IMU_AUTOCAL and
SENS_MAG_AUTOCAL. Offsets of ArduPilot's gyros are in neither table, since it measures them at each start by itself
(INS_GYR_CAL).
"""


SIH_AIRFRAMES = range(10040, 10050)
"""Values of SYS_AUTOSTART for PX4's own simulators (ROMFS/px4fmu_common/init.d-posix/airframes)."""

INSTANCES_MESSAGE = "ESTIMATOR_INSTANCES"
"""Table of all instances of the state estimator, which is no message of MAVLink.

Its fields are the number of the ``instance``, ``is_primary`` (whether it flies at that time, 0 or 1), and the ratios of
``EstimatorRatio``. It is made only where a log has another instance than the primary one.
"""


ACCELEROMETERS_MESSAGE = "ACCELEROMETERS"
"""Table of the accelerometers other than that of HIGHRES_IMU, which is no message of MAVLink.

Its fields are the number of the IMU from 0 as ``instance``, and the specific force as ``xacc``, ``yacc`` and ``zacc``,
m/s². PX4's has all IMUs, since its HIGHRES_IMU is of the one that is selected at each time.
"""


class EstimatorRatio(StrEnum):
    """Innovations of a state estimator, each as a ratio to what it accepts."""

    VELOCITY = "velocity"
    POSITION = "position"
    HEIGHT = "height"
    COMPASS = "compass"


class Injection(IntEnum):
    """Where the controller adds a test signal of system identification: SID_AXIS of ArduCopter, of the roll axis.

    Pitch and yaw follow: RATE_SETPOINT + 1 is the pitch rate, RATE_SETPOINT + 2 the yaw rate.
    """

    ANGLE_SETPOINT = 1
    """Added to the angle setpoint before it is shaped."""
    RECOVERED_ANGLE_SETPOINT = 4
    """Added to the angle setpoint, while the shaping of the setpoint is off."""
    RATE_SETPOINT = 7
    """Added to the rate setpoint."""
    DEMAND = 10
    """Added to what the rate controller demands of the mixer."""


VERSION_MATURITIES = ("official", "rc", "beta", "alpha", "dev")
"""Kinds of firmware version, in falling order of their numbers in MAVLink's FIRMWARE_VERSION_TYPE."""


def version_text(number: int) -> str:
    """Formats a firmware version as PX4 and ArduPilot write it, such as "1.16.1-rc".

    Args:
        number: The version, 32 bits: one byte each for the major, minor and patch number, and one for the maturity
            (FIRMWARE_VERSION_TYPE): development, alpha, beta, release candidate or official.

    Returns:
        Version numbers, with the maturity unless the version is official.
    """
    major, minor, patch, maturity_number = number.to_bytes(4, "big")
    text = f"{major}.{minor}.{patch}"
    # The numbers of the maturities have gaps, in which the candidates are counted: 192 is the first release candidate,
    # 193 the second. So the maturity is the last one whose number is not larger. They are sorted by descending number.
    for maturity in VERSION_MATURITIES:
        if maturity_number >= mavlink_constant(f"FIRMWARE_VERSION_TYPE_{maturity.upper()}"):
            break
    return text if maturity == "official" else f"{text}-{maturity}"


def heartbeat_fields(vehicle_type: int, autopilot: int, armed: NDArray[Any]) -> Fields:
    """Makes the fields of HEARTBEAT for one vehicle.

    Args:
        vehicle_type: MAV_TYPE.
        autopilot: MAV_AUTOPILOT.
        armed: Whether the motors are armed (N,); a number above 0 means true.

    Returns:
        The columns (N,) type, autopilot and base_mode.
    """
    base_mode = np.where(armed > 0, ARMED, 0).astype(np.uint8)
    return {
        "type": np.full_like(base_mode, vehicle_type),
        "autopilot": np.full_like(base_mode, autopilot),
        "base_mode": base_mode,
    }


BOARD_TEXT = re.compile(r"^\S+ ([0-9A-F]{8}) ([0-9A-F]{8}) ([0-9A-F]{8})$")
"""Text that ArduPilot sends at boot: the board's name, and the processor's number as three words of four bytes."""

SIMULATOR_TEXT = re.compile(r"^.[0-9a-f]{31}$")
"""Text that ArduPilot's simulator sends instead: the machine's number, the vehicle's added to its first letter."""

SCENARIO_TEXT = "Simulated by mavdem"
"""Beginning of the text that vehicles simulated by this project (``sitl_scenarios``) send at boot."""

SIMULATOR_LETTERS = 17
"""Number of letters of the simulator's text for which AUTOPILOT_VERSION.uid2 has room."""

WORD_BYTES = np.dtype(np.uint32).itemsize
"""Number of bytes of one word of the processor's number; the last byte comes first."""

WORDS = 3
"""Number of words of the processor's number (STM32: 96 bits)."""

MIN_NUMBER_BYTES = 6
"""Number of bytes other than 0 that a board's number has at least; simulators number vehicles in one or two bytes."""


def board_number_from_texts(texts: Iterable[str]) -> str:
    """Returns the board's number from the texts that ArduPilot sends at boot ("CUAVv5Nano 001A002F 30395113 33333539").

    The number distinguishes vehicles with the same MAVLink ids. ArduPilot's simulator sends a text of letters instead.
    The number is then made of the bytes of its first letters, as many as AUTOPILOT_VERSION has room for, so that the
    log of a board and the stream from it give the same number.

    Args:
        texts: The texts of the log, in any order.

    Returns:
        The number in hexadecimal, lower case; empty if no text has it.
    """
    for text in texts:
        match = BOARD_TEXT.match(text.strip())
        if match is not None:
            return "".join(match.groups()).lower()
        if SIMULATOR_TEXT.match(text.strip()):
            return text[:SIMULATOR_LETTERS].encode().hex()
    return ""


def board_name_in_texts(texts: Iterable[str]) -> str:
    """Returns the kind of board from the texts that ArduPilot sends at boot ("CUAVv5Nano"); empty without one."""
    for text in texts:
        if BOARD_TEXT.match(text.strip()):
            return text.split()[0]
    return ""


def board_number_from_uid2(uid2: bytes, *, as_in_texts: bool) -> str:
    """Returns the serial number of an autopilot's board from the message AUTOPILOT_VERSION, as hexadecimal digits.

    The field ``uid2`` has the bytes of the processor's number in the order of the memory. The texts that ArduPilot
    sends at boot have the same number as three words of four bytes each, with the bytes of each word reversed. The
    number of ArduPilot's simulator is longer, and its bytes are letters in their usual order.

    Args:
        uid2: The field ``uid2``, 18 bytes.
        as_in_texts: Whether to return the number in the form of ArduPilot's texts (``board_number_from_texts``).

    Returns:
        The number in hexadecimal; empty if there is none.
    """
    bytes_in_use = sum(byte > 0 for byte in uid2)
    if bytes_in_use < MIN_NUMBER_BYTES:
        return ""
    if not as_in_texts:
        return uid2.hex()
    number = uid2.rstrip(b"\0")
    is_of_simulator = len(number) > WORDS * WORD_BYTES
    if is_of_simulator:
        return number[:SIMULATOR_LETTERS].hex()
    # The bytes of each word are reversed.
    digits = ""
    for word_start in range(0, WORDS * WORD_BYTES, WORD_BYTES):
        word = uid2[word_start : word_start + WORD_BYTES]
        digits += word[::-1].hex()
    return digits


def wrapped_angle(angle: Any) -> Any:
    """Returns an angle, rad, or an array of angles, moved by whole turns into the range from −π to below π."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def euler_angles(attitude: Array) -> tuple[Array, Array, Array]:
    """Converts unit quaternions to Euler angles, Z-Y-X convention.

    Args:
        attitude: Quaternions (N, 4): w, x, y, z, from the body to north-east-down.

    Returns:
        Roll, pitch and yaw (N,) each, rad.
    """
    w, x, y, z = attitude.T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    # Rounding may bring the sine of pitch beyond 1.
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


def quaternion(roll: Array, pitch: Array, yaw: Array) -> Array:
    """Converts Euler angles to unit quaternions: the inverse of :func:`euler_angles`.

    Args:
        roll, pitch, yaw: Angles (N,), rad, Z-Y-X convention.

    Returns:
        Quaternions (N, 4): w, x, y, z, from the body to north-east-down.
    """
    half_angles = np.array([roll, pitch, yaw]) / 2
    cos_roll, cos_pitch, cos_yaw = np.cos(half_angles)
    sin_roll, sin_pitch, sin_yaw = np.sin(half_angles)
    w = cos_roll * cos_pitch * cos_yaw + sin_roll * sin_pitch * sin_yaw
    x = sin_roll * cos_pitch * cos_yaw - cos_roll * sin_pitch * sin_yaw
    y = cos_roll * sin_pitch * cos_yaw + sin_roll * cos_pitch * sin_yaw
    z = cos_roll * cos_pitch * sin_yaw - sin_roll * sin_pitch * cos_yaw
    return np.column_stack([w, x, y, z])


IGNORE_BODY_RATES = (
    mavlink_constant("ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE")
    | mavlink_constant("ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE")
    | mavlink_constant("ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE")
)
"""Flags of ATTITUDE_TARGET.type_mask of a message whose body rates are to be ignored."""

IGNORE_ATTITUDE = mavlink_constant("ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE")
"""Flag of ATTITUDE_TARGET.type_mask of a message whose attitude is to be ignored."""


def attitude_target(setpoints: Array) -> Fields:
    """Makes the fields of ATTITUDE_TARGET for setpoints of the attitude or of the body rates.

    The other of the two is NaN, and ``type_mask`` marks it as ignored.

    Args:
        setpoints: Attitudes (N, 4), quaternions w, x, y, z, or body rates (N, 3), rad/s.

    Returns:
        The columns type_mask, q and the three body rates.
    """
    count, columns = setpoints.shape
    are_quaternions = columns == 4
    if are_quaternions:
        type_mask = IGNORE_BODY_RATES
        attitude = setpoints
        roll_rate, pitch_rate, yaw_rate = np.full((3, count), np.nan)
    else:
        type_mask = IGNORE_ATTITUDE
        attitude = np.full((count, 4), np.nan)
        roll_rate, pitch_rate, yaw_rate = setpoints.T
    return {
        "type_mask": np.full(count, type_mask, np.uint8),
        "q": attitude,
        "body_roll_rate": roll_rate,
        "body_pitch_rate": pitch_rate,
        "body_yaw_rate": yaw_rate,
    }
