"""Flight modes: their names, by the number that ArduCopter and PX4 send and log."""

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Integers
from mavdem.files import load_adjacent_toml
from mavdem.ingest.mavlink.definitions import enum_name

_PX4 = load_adjacent_toml(__file__, "flight_modes.toml")["px4"]
_CUSTOM = {state: main << 16 | sub << 24 for main, sub, state, _ in _PX4}
_ENUMS = {"SUBMARINE": "SUB_MODE", "GROUND_ROVER": "ROVER_MODE", "FIXED_WING": "PLANE_MODE"}
_NAMES = {_CUSTOM[state]: name for *_, state, name in _PX4}


def px4_custom_mode(states: NDArray[np.integer]) -> Integers:
    """Returns HEARTBEAT.custom_mode (N,) of vehicle_status.nav_state (N,); 0 where PX4 has no such mode."""
    return np.array([_CUSTOM.get(int(state), 0) for state in states], dtype=np.int64)


def mode_name(autopilot: str, vehicle: str, number: int) -> str:
    """Returns the name of a custom mode of a MAV_AUTOPILOT and a MAV_TYPE: "Loiter"; "mode 33" where it has none."""
    if autopilot == "PX4":
        return _NAMES.get(number, _NAMES.get(number & 0xFFFFFF, f"mode {number}"))
    name = (
        enum_name(_ENUMS.get(vehicle, "COPTER_MODE"), number)
        if autopilot == "ARDUPILOTMEGA"
        else str(number)
    )
    return (
        f"mode {name}"
        if name.isdigit()
        else name.replace("_", " ").capitalize().replace("Rtl", "RTL")
    )
