"""Kind, firmware and MAVLink system id of the vehicle of a DataFlash log, from its texts and parameters."""

import re
from collections.abc import Sequence

from mavdem.ingest.telemetry import Parameters

FIRMWARES = {
    "plane": "FIXED_WING",
    "copter": "QUADROTOR",
    "tracker": "ANTENNA_TRACKER",
    "blimp": "AIRSHIP",
    "rover": "GROUND_ROVER",
    "sub": "SUBMARINE",
}
"""MAV_TYPE by what follows "Ardu", "APM:" or "Antenna" in MSG ("ArduCopter V4.5.7", "APM:Copter V3.5")."""

_FIRMWARE = re.compile(rf"^(?:Ardu|APM:|Antenna)?({'|'.join(FIRMWARES)})\b", re.IGNORECASE)
_FRAME = re.compile(r"^Frame: ([A-Z0-9_]+)")

FRAME_CLASSES = (
    "QUADROTOR",
    "QUADROTOR",
    "HEXAROTOR",
    "OCTOROTOR",
    "OCTOROTOR",
    "HEXAROTOR",
    "HELICOPTER",
    "TRICOPTER",
    "COAXIAL",
    "COAXIAL",
    "COAXIAL",
    "HELICOPTER",
    "DODECAROTOR",
    "HELICOPTER",
    "DECAROTOR",
)
"""MAV_TYPE by FRAME_CLASS, as in ArduCopter's HEARTBEAT (``get_frame_mav_type``)."""

FRAME_NAMES = {
    "QUAD": "QUADROTOR",
    "HEXA": "HEXAROTOR",
    "Y6": "HEXAROTOR",
    "OCTA": "OCTOROTOR",
    "OCTAQUAD": "OCTOROTOR",
    "OCTA_QUAD": "OCTOROTOR",
    "TRI": "TRICOPTER",
    "HELI": "HELICOPTER",
}
"""MAV_TYPE by the frame's name in MSG: "Frame: QUAD/X"."""

SYSTEM_ID_PARAMETERS = ("MAV_SYSID", "SYSID_THISMAV")
"""Parameters with the MAVLink system id: from ArduPilot 4.7 on, and before."""

MAX_SYSTEM_ID = 255
"""Largest MAVLink system id; 0 means all."""


def system_id_of_parameters(parameters: Parameters) -> int:
    """Returns the MAVLink system id in the parameters, 1 to 255; 1, ArduPilot's default, if they have none."""
    for name in SYSTEM_ID_PARAMETERS:
        if 1 <= parameters.get(name, 0) <= MAX_SYSTEM_ID:
            return int(parameters[name])
    return 1


def firmware_text(texts: Sequence[str]) -> str:
    """Returns the first text that names the firmware; empty without any."""
    for text in texts:
        if _FIRMWARE.match(text):
            return text.strip()
    return ""


def mav_type(texts: Sequence[str], parameters: Parameters) -> str:
    """Finds out the MAV_TYPE of the vehicle, which a DataFlash log does not state as such.

    The name of the firmware shows whether it is a copter, a plane or another vehicle. Without the name, a copter is
    recognised by parameters that only copters have. The frame of a copter follows from its parameters and texts.

    Args:
        texts: The texts of MSG, which name firmware and frame.
        parameters: The autopilot's parameters by name.

    Returns:
        MAV_TYPE without its prefix, such as "QUADROTOR". It is GENERIC_MULTIROTOR for a copter whose frame is not
        known, and GENERIC if it is not even known whether it is a copter.
    """
    is_copter = False
    vehicle_type = "GENERIC"
    firmware = _FIRMWARE.match(firmware_text(texts))
    if firmware is not None:
        vehicle_type = FIRMWARES[firmware[1].lower()]
        is_copter = vehicle_type == FIRMWARES["copter"]
    elif "FRAME_CLASS" in parameters and "ATC_RAT_RLL_P" in parameters:
        # Only copters have both parameters.
        is_copter = True
    return _copter_type(texts, parameters) if is_copter else vehicle_type


def _copter_type(texts: Sequence[str], parameters: Parameters) -> str:
    """Returns the MAV_TYPE of a copter, by the parameter FRAME_CLASS or else by the frame that a text names.

    Args:
        texts: Texts that the autopilot logged at its start, in the message MSG.
        parameters: The autopilot's parameters by name.

    Returns:
        MAV_TYPE without its prefix ("HEXAROTOR"); GENERIC_MULTIROTOR if the frame is not known.
    """
    if "FRAME_CLASS" in parameters:
        frame_class = int(parameters["FRAME_CLASS"])
        if 0 <= frame_class < len(FRAME_CLASSES):
            return FRAME_CLASSES[frame_class]
        return "GENERIC_MULTIROTOR"
    for text in texts:
        frame = _FRAME.match(text)
        if frame is not None:
            return FRAME_NAMES.get(frame[1], "GENERIC_MULTIROTOR")
    return "GENERIC_MULTIROTOR"
