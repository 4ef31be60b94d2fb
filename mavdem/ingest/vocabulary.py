"""MAVLink's numbers for a vehicle and its state, and HEARTBEAT, which carries most of them.

Source: MAV_MODE_FLAG, MAV_AUTOPILOT, MAV_COMPONENT, MAV_STATE and MAV_LANDED_STATE of ``minimal.xml`` and
``common.xml``; modes of ArduCopter's ``mode.h`` and PX4's ``px4_custom_mode.h``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED in HEARTBEAT.base_mode
CUSTOM_MODE = 1  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED in HEARTBEAT.base_mode
ON_GROUND, IN_AIR, TAKING_OFF, LANDING = 1, 2, 3, 4  # MAV_LANDED_STATE in EXTENDED_SYS_STATE.landed_state
OFF_GROUND = (IN_AIR, TAKING_OFF, LANDING)  # ArduPilot and PX4 report the last two only once they have left the ground
STANDBY, ACTIVE = 3, 4  # MAV_STATE in HEARTBEAT.system_status: on the ground, and in flight
GENERIC, ARDUPILOT, PX4 = 0, 3, 12  # MAV_AUTOPILOT; GENERIC where the autopilot is not known
AUTOPILOT_COMPONENT = 1  # MAV_COMP_ID_AUTOPILOT1
LANDING_MODES = {
    ARDUPILOT: {6, 9, 21, 27},  # RTL, LAND, SMART_RTL, AUTO_RTL
    PX4: {sub << 24 | 4 << 16 for sub in (5, 6, 9)},  # of AUTO: RTL, LAND, PRECLAND
}
"""HEARTBEAT.custom_mode of multirotors that land by themselves, sooner or later, by MAV_AUTOPILOT."""
RADIO = "TELEMETRY_RADIO"  # What sends ``RADIO_MESSAGES`` only, and no HEARTBEAT: a SiK radio, usually as 51:68
RADIO_MESSAGES = frozenset({"RADIO_STATUS", "RADIO"})
UNNAMED = "UNKNOWN"  # Name of a vehicle or an autopilot that no HEARTBEAT gives

VERSION_KINDS = {0: "dev", 64: "alpha", 128: "beta", 192: "rc", 255: ""}
"""FIRMWARE_VERSION_TYPE: the least last byte of a version number, and the kind of version; none of a release."""


def version_text(number: int) -> str:
    """A firmware's version as PX4 and ArduPilot number it, a byte each: "1.16.1-rc"."""
    major, minor, patch, last = number.to_bytes(4, "big")
    kind = next(name for least, name in reversed(VERSION_KINDS.items()) if last >= least)
    return f"{major}.{minor}.{patch}-{kind}".rstrip("-")


def heartbeat_fields(vehicle_type: int, autopilot: int, base_mode: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Fields of HEARTBEAT (N,) for one vehicle, from its MAV_TYPE, its MAV_AUTOPILOT and ``base_mode`` (N,)."""
    constant = {"type": vehicle_type, "autopilot": autopilot}
    columns = {name: np.full(len(base_mode), number, dtype=np.uint8) for name, number in constant.items()}
    return columns | {"base_mode": base_mode.astype(np.uint8)}
