"""Facts about a log's vehicle: the tier that it allows, what the vehicle's name is made of, and its date."""

from enum import StrEnum

from mavdem.facts.fact import Code


class Basis(StrEnum):
    """What a vehicle's name is made of; the last is shared by many."""

    BOARD = "board"
    ACCELEROMETER = "accelerometer"
    COMPASS = "compass"
    SYSTEM_ID = "system id"


class DateBasis(StrEnum):
    """What the date of a flight was read from."""

    GPS = "GPS time"
    AUTOPILOT = "clock of the autopilot"
    RECEIVER = "clock of the receiving computer"
    LOG_NAME = "name that the autopilot gave its log"


class TierAllowance(Code):
    """What a tier allows; its remedy is what a log needs for it."""

    TIER_A = "tier_a"
    TIER_B = "tier_b"
    TIER_C = "tier_c"


def system_id_name(autopilot: str, system: int) -> str:
    """Makes a name for a vehicle whose log identifies it by a MAVLink system id only, such as "px4-1".

    Args:
        autopilot: MAV_AUTOPILOT without its prefix.
        system: MAVLink system id.

    Returns:
        The name, in lower case.
    """
    return f"{autopilot}-{system}".lower()


def autopilot_of_system_id_name(name: str) -> str:
    """Returns the autopilot in a name that :func:`system_id_name` has made, as MAV_AUTOPILOT without its prefix."""
    return name.rpartition("-")[0].upper()


GENERIC_FRAME = "GENERIC"
"""MAV_TYPE of an autopilot that does not know its frame."""

FRAME_SEPARATOR = "_"
"""Stands between the number of a board or the hash of a calibration, which do not contain it, and the frame."""

FRAMES_WITHOUT_SUFFIX = ("", "UNKNOWN", GENERIC_FRAME, "QUADROTOR")
"""Frames that are not in the names of vehicles: those that a log does not know, and that of nearly all logs."""


def name_with_frame(name: str, frame: str) -> str:
    """Adds the frame to the name that a board or a calibration gives to a vehicle, such as "001a002f_hexarotor".

    A board that is moved to another frame keeps its serial number and calibration, but what flies is another vehicle,
    whose motors and figures are not compared with those of the first. The names of quadrotors and of unknown frames
    stay as they are.

    Args:
        name: serial number of the board, or the hash of a calibration.
        frame: MAV_TYPE without its prefix.
    """
    if frame in FRAMES_WITHOUT_SUFFIX:
        return name
    return f"{name}{FRAME_SEPARATOR}{frame.lower()}"


def is_calibration_name(name: str) -> bool:
    """Returns whether a vehicle's name is the hash of a sensor's calibration, such as "accelerometer-1f6f6923a0b1"."""
    return name.startswith((f"{Basis.ACCELEROMETER}-", f"{Basis.COMPASS}-"))


def name_without_frame(name: str) -> str:
    """Returns the part of a vehicle's name before the frame that :func:`name_with_frame` has added, if any."""
    return name.partition(FRAME_SEPARATOR)[0]


def frame_in_name(name: str) -> str:
    """Returns the frame that :func:`name_with_frame` has added to a vehicle's name, such as "submarine"; or nothing."""
    return name.partition(FRAME_SEPARATOR)[2]
