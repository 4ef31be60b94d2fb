"""Flight modes of ArduPilot and PX4: their names, by the numbers that the autopilots send and log."""

from collections.abc import Mapping
from math import isfinite
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Integers
from mavdem.files import load_adjacent_toml
from mavdem.ingest.mavlink.dialect import enum_name
from mavdem.ingest.telemetry import Columns

MAIN_MODE_SHIFT = 16
"""First bit of PX4's main mode in a custom mode, one byte (union px4_custom_mode)."""

SUB_MODE_SHIFT = 24
"""First bit of PX4's sub mode in a custom mode, one byte."""

BYTE_MASK = 0xFF
"""The lowest byte of a number."""


class Px4Mode(NamedTuple):
    """One flight mode of PX4, a row of ``flight_modes.toml``."""

    main_mode: int
    """Main mode in HEARTBEAT.custom_mode (``px4_custom_mode.h``); 0 for a mode that has none there."""
    sub_mode: int
    """Sub mode there; 0 for a main mode without any."""
    navigation_state: int
    """Number of the mode in the topic vehicle_status, field nav_state; -1 for a mode that the topic does not have."""
    name: str
    """What the mode is called on screens."""

    @property
    def custom_mode(self) -> int:
        """HEARTBEAT.custom_mode: the main mode in bits 16 to 23, the sub mode in bits 24 to 31.

        A mode without a main mode is numbered by its navigation state.
        """
        if self.main_mode == 0:
            return self.navigation_state
        return self.main_mode << MAIN_MODE_SHIFT | self.sub_mode << SUB_MODE_SHIFT


AUTO_MODE = 4
"""PX4's main mode of all modes that fly by themselves; only the sub mode distinguishes them."""

EXTERNAL_SUB_MODES = range(11, 19)
"""Sub modes of PX4's AUTO for modes that run outside of PX4, such as those of ROS 2, which have names of their own."""

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
    """Converts PX4's navigation states to the numbers of flight modes that its HEARTBEAT has.

    Args:
        states: (N,) values of vehicle_status.nav_state.

    Returns:
        (N,) values of HEARTBEAT.custom_mode. A state without a custom mode keeps its number, which is smaller than the
        number of any custom mode.
    """
    custom_modes = [_CUSTOM_MODE_OF_STATE.get(int(state), int(state)) for state in states]
    return np.array(custom_modes, dtype=np.int64)


def announced_names(available_modes: Columns) -> dict[int, str]:
    """Returns the names of flight modes in the messages AVAILABLE_MODES, by custom mode.

    Args:
        available_modes: Columns of AVAILABLE_MODES (N,); they may be missing.

    Returns:
        Names by HEARTBEAT.custom_mode, the last announced one of each; modes without a name are left out.
    """
    names: dict[int, str] = {}
    if "mode_name" not in available_modes or "custom_mode" not in available_modes:
        return names
    numbers = available_modes["custom_mode"].tolist()
    for number, text in zip(numbers, available_modes["mode_name"].tolist(), strict=True):
        name = text.decode(errors="replace") if isinstance(text, bytes) else str(text)
        name = name.partition("\0")[0].strip()
        if name and isfinite(number):
            names[int(number)] = name
    return names


def mode_name(
    autopilot: str,
    vehicle: str,
    number: int,
    announced_names: Mapping[int, str] = MappingProxyType({}),
) -> str:
    """Returns the name of a flight mode.

    Args:
        autopilot: MAV_AUTOPILOT without its prefix ("PX4").
        vehicle: MAV_TYPE without its prefix ("QUADROTOR").
        number: Number of the mode, as HEARTBEAT.custom_mode has it.
        announced_names: Names that the autopilot announced, by custom mode. They are used for PX4's external modes, and
            for modes that ``flight_modes.toml`` and MAVLink's enumerations do not have.

    Returns:
        The name ("Loiter"), or "mode 33" where the mode has none; of PX4 "mode 4:19", by main and sub mode.
    """
    if autopilot == "PX4":
        return _px4_mode_name(number, announced_names)
    name = str(number)
    if autopilot == "ARDUPILOTMEGA":
        name = enum_name(ARDUPILOT_MODE_ENUMS.get(vehicle, "COPTER_MODE"), number)
    if name.isdigit():
        return announced_names.get(number, f"mode {name}")
    return name.replace("_", " ").capitalize().replace("Rtl", "RTL")


def _px4_mode_name(number: int, announced_names: Mapping[int, str]) -> str:
    """Returns the name of a flight mode of PX4.

    Args:
        number: Number of the mode, as HEARTBEAT.custom_mode has it.
        announced_names: Names that the autopilot announced, by custom mode. They are used for external modes, whose
            meaning differs from vehicle to vehicle, and for modes that ``flight_modes.toml`` does not have.

    Returns:
        The name ("Position"). A mode without one gets the name of its main mode, or "mode 4:19" by main and sub mode.
    """
    # The main mode is in bits 16 to 23 and the sub mode in bits 24 to 31 (union px4_custom_mode).
    main_mode = number >> MAIN_MODE_SHIFT & BYTE_MASK
    sub_mode = number >> SUB_MODE_SHIFT & BYTE_MASK
    is_external = main_mode == AUTO_MODE and sub_mode in EXTERNAL_SUB_MODES
    is_listed = number in _NAME_OF_CUSTOM_MODE
    if number in announced_names and (is_external or not is_listed):
        return announced_names[number]
    if is_listed:
        return _NAME_OF_CUSTOM_MODE[number]
    if not main_mode:
        return f"mode {number}"
    # The sub modes of AUTO are modes such as mission or landing; the sub modes of other main modes are only variants.
    name_of_main_mode = _NAME_OF_CUSTOM_MODE.get(main_mode << MAIN_MODE_SHIFT)
    if name_of_main_mode is not None and main_mode != AUTO_MODE:
        return name_of_main_mode
    return f"mode {main_mode}:{sub_mode}"
