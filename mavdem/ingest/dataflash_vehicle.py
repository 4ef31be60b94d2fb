"""Which vehicle wrote a DataFlash log: its MAV_TYPE and system id, from its first messages and its parameters."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import isfinite

from mavdem.ingest.dataflash_definition import Table, numbers

UNKNOWN, COPTER = 0, 2
FIRMWARES = {"plane": 1, "copter": COPTER, "tracker": 5, "blimp": 7, "rover": 10, "sub": 12}
"""MAV_TYPE by what follows "Ardu", "APM:" or "Antenna" in MSG ("ArduCopter V4.5.7", "APM:Copter V3.5")."""
_FIRMWARE = re.compile(r"^(?:Ardu|APM:|Antenna)?(plane|copter|tracker|blimp|rover|sub)\b", re.IGNORECASE)
MULTIROTOR = 43
"""MAV_TYPE_GENERIC_MULTIROTOR: a copter of which nothing says how many motors it has."""
FRAME_CLASSES = {0: 2, 1: 2, 2: 13, 3: 14, 4: 14, 5: 13, 6: 4, 7: 15, 8: 3, 9: 3, 10: 3, 11: 4, 12: 29, 13: 4, 14: 35}
"""MAV_TYPE by FRAME_CLASS: what ArduCopter puts into its HEARTBEAT (``get_frame_mav_type``)."""
FRAME_NAMES = {"QUAD": 2, "HEXA": 13, "Y6": 13, "OCTA": 14, "OCTAQUAD": 14, "OCTA_QUAD": 14, "TRI": 15, "HELI": 4}
"""The same by the name in MSG: "Frame: QUAD/X"."""
_FRAME = re.compile(r"^Frame: ([A-Z0-9_]+)")
ONLY_COPTERS = ("FRAME_CLASS", "ATC_RAT_RLL_P")
"""Parameters that, together, no other ArduPilot vehicle has."""
SYSTEM_IDS = ("MAV_SYSID", "SYSID_THISMAV")
"""The parameter from ArduPilot 4.7 on, and before."""


def parameters(logged: Table) -> dict[str, float]:
    """The last finite value of each parameter by name, from PARM."""
    values, names = numbers(logged).columns.get("Value"), texts(logged, "Name")
    if values is None or len(names) != len(values):
        return {}
    pairs = zip(names, values.astype(float).tolist(), strict=True)
    return {name: value for name, value in pairs if isfinite(value)}


def texts(logged: Table, field: str) -> list[str]:
    """The texts of one field; empty where it is missing."""
    values = logged.columns.get(field, logged.place[:0]).tolist()
    return [value.split(b"\0", 1)[0].decode("utf-8", errors="replace") for value in values if isinstance(value, bytes)]


def mav_type(said: Sequence[str], parameters: Mapping[str, float]) -> int:
    """The vehicle's MAV_TYPE, from the texts of MSG and its parameters; ``UNKNOWN`` (GENERIC) where nothing says."""
    firmwares = [found[1].lower() for text in said if (found := _FIRMWARE.match(text))]
    if firmwares:
        kind = FIRMWARES[firmwares[0]]
    else:
        kind = COPTER if all(name in parameters for name in ONLY_COPTERS) else UNKNOWN
    if kind != COPTER:
        return kind
    if "FRAME_CLASS" in parameters:
        return FRAME_CLASSES.get(int(parameters["FRAME_CLASS"]), MULTIROTOR)
    frames = [found[1] for text in said if (found := _FRAME.match(text))]
    return FRAME_NAMES.get(frames[0], MULTIROTOR) if frames else MULTIROTOR


def system_id(parameters: Mapping[str, float]) -> int:
    """The MAVLink system id, 1 where no parameter says."""
    return next((int(parameters[name]) for name in SYSTEM_IDS if 1 <= parameters.get(name, 0) <= 255), 1)
