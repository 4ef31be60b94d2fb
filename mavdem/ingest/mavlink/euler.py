"""Euler angles of an attitude."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def euler_angles(attitude: Array) -> tuple[Array, Array, Array]:
    """Roll, pitch and yaw (N,), rad, of unit quaternions (N, 4): w, x, y, z, body to north-east-down, Z-Y-X."""
    w, x, y, z = attitude.T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    return roll, pitch, np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def quaternion(roll: Array, pitch: Array, yaw: Array) -> Array:
    """Unit quaternions (N, 4), w, x, y, z, of Euler angles (N,), rad: the inverse of :func:`euler_angles`."""
    (a, b), (c, d), (e, f) = ((np.cos(angle / 2), np.sin(angle / 2)) for angle in (roll, pitch, yaw))
    return np.column_stack([a * c * e + b * d * f, b * c * e - a * d * f, a * d * e + b * c * f, a * c * f - b * d * e])
