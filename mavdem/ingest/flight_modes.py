"""Flight modes of ArduPilot and PX4: their names, by the numbers that the autopilots send and log."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Integers
from mavdem.files import load_adjacent_toml
from mavdem.ingest.mavlink.definitions import enum_name


class Px4Mode(NamedTuple):
    """One flight mode of PX4, a row of ``flight_modes.toml``."""

    main_mode: int
    """Main mode in HEARTBEAT.custom_mode (``px4_custom_mode.h``)."""
    sub_mode: int
    """Sub mode there; 0 for a main mode without any."""
    navigation_state: int
    """Number of the mode in the topic vehicle_status, field nav_state."""
    name: str
    """What the mode is called on screens."""

    @property
    def custom_mode(self) -> int:
        """HEARTBEAT.custom_mode: the main mode in bits 16 to 23, the sub mode in bits 24 to 31."""
        return self.main_mode << 16 | self.sub_mode << 24


MAIN_MODE_MASK = 0xFFFFFF
"""Bits of PX4's custom mode without the sub mode."""

_PX4_MODES = [Px4Mode(*row) for row in load_adjacent_toml(__file__, "flight_modes.toml")["px4"]]
_CUSTOM_MODE_OF_STATE = {mode.navigation_state: mode.custom_mode for mode in _PX4_MODES}
_NAME_OF_CUSTOM_MODE = {mode.custom_mode: mode.name for mode in _PX4_MODES}

ARDUPILOT_MODE_ENUMS = {
    "SUBMARINE": "SUB_MODE",
    "GROUND_ROVER": "ROVER_MODE",
    "FIXED_WING": "PLANE_MODE",
}
"""MAVLink's enumeration of ArduPilot's flight modes by MAV_TYPE; other vehicles have COPTER_MODE."""


def px4_custom_mode(states: NDArray[np.integer]) -> Integers:
    """Converts vehicle_status.nav_state (N,) to HEARTBEAT.custom_mode (N,); 0 where PX4 has no such mode."""
    custom_modes = [_CUSTOM_MODE_OF_STATE.get(int(state), 0) for state in states]
    return np.array(custom_modes, dtype=np.int64)


def mode_name(autopilot: str, vehicle: str, number: int) -> str:
    """Returns the name of a flight mode.

    Args:
        autopilot: MAV_AUTOPILOT without its prefix.
        vehicle: MAV_TYPE without its prefix.
        number: HEARTBEAT.custom_mode.

    Returns:
        The name ("Loiter"), or "mode 33" where the mode has none.
    """
    if autopilot == "PX4":
        if number in _NAME_OF_CUSTOM_MODE:
            return _NAME_OF_CUSTOM_MODE[number]
        # A sub mode that is newer than the table belongs to a known main mode.
        return _NAME_OF_CUSTOM_MODE.get(number & MAIN_MODE_MASK, f"mode {number}")
    name = str(number)
    if autopilot == "ARDUPILOTMEGA":
        name = enum_name(ARDUPILOT_MODE_ENUMS.get(vehicle, "COPTER_MODE"), number)
    if name.isdigit():
        return f"mode {name}"
    return name.replace("_", " ").capitalize().replace("Rtl", "RTL")
