"""The autopilot's parameters out of PARAM_VALUE.

A parameter travels in a float32. ArduPilot casts integers to it; PX4 copies their bits. Source:
https://mavlink.io/en/services/parameter.html#parameter-encoding.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.telemetry import Columns

BITWISE = frozenset({"PX4"})
"""Autopilots that copy the bits of an integer parameter."""
INTEGER_TYPES = {1: "<u1", 2: "<i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4"}
"""MAV_PARAM_TYPE UINT8 to INT32."""


def parameters(sent: Columns, autopilot: str) -> dict[str, float]:
    """The last finite value of each parameter by name, from PARAM_VALUE's columns and the MAV_AUTOPILOT that sent them.

    A value that is not finite says nothing and counts as not sent.
    """
    with np.errstate(invalid="ignore"):  # what is no number stays none
        values = sent["param_value"].astype(np.float64)
    if autopilot in BITWISE:
        for number, kind in INTEGER_TYPES.items():
            rows = sent["param_type"] == number
            values[rows] = _low_bytes(sent["param_value"][rows], kind)
    names = [name.split(b"\0", 1)[0].decode("ascii", errors="replace") for name in sent["param_id"].tolist()]
    return {name: value for name, value in zip(names, values.tolist(), strict=True) if isfinite(value)}


def _low_bytes(values: NDArray[Any], kind: str) -> NDArray[Any]:
    """The integers in the first bytes of little-endian float32 values."""
    width = np.dtype(kind).itemsize
    content = np.ascontiguousarray(values, dtype="<f4").view(np.uint8).reshape(-1, 4)
    return np.ascontiguousarray(content[:, :width]).view(kind)[:, 0]
