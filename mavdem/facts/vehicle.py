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
