"""Attitude: what a quaternion says in angles."""

from __future__ import annotations

from math import asin, atan2

from sitl_scenarios.dynamics import Quaternion


def euler(attitude: Quaternion) -> tuple[float, float, float]:
    """Roll, pitch and yaw, rad, Z-Y-X, of a unit quaternion from body to NED."""
    w, x, y, z = attitude
    return (
        atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        asin(min(max(2 * (w * y - z * x), -1.0), 1.0)),
        atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )
