"""Euler angles of an attitude."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def roll_and_pitch(attitude: Array) -> tuple[Array, Array]:
    """Roll and pitch (N,), rad, of unit quaternions (N, 4): w, x, y, z, body to north-east-down, in Z-Y-X order."""
    w, x, y, z = attitude.T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    return roll, pitch
