"""Mixers: what ArduPilot and PX4 leave of their controllers' demands where motors are at their limits.

Neither climbs to turn. Thrusts (4,) are shares of a motor's most: 0 where it begins, 1 where it ends; ``columns``
(3, 4) are what demands of roll, pitch and yaw add to them.
"""

from __future__ import annotations

import numpy as np

from sitl_scenarios.dynamics import Four
from sitl_scenarios.motion import Array

YAW_HEADROOM = 0.2  # of thrust, that yaw has at least: ArduPilot's MOT_YAW_HEADROOM, 200 by default
YAW_MARGIN = 0.15  # of thrust beyond the most, that yaw may ask for: PX4's MINIMUM_YAW_MARGIN


def ardupilot(columns: Array, demands: Four) -> Array:
    """Thrusts for ``demands`` of roll, pitch, yaw and thrust, by ``AP_MotorsMatrix::output_armed_stabilizing``.

    Yaw gives way first, then all three alike, until the lowest motor stands still at the thrust asked for.
    """
    *tilt, yaw, thrust = demands
    tilting = tilt @ columns[:2]
    best = min(0.5, thrust)
    rooms = np.where(yaw * columns[2] > 0, 1 - best - tilting, best + tilting)
    allowed = max((rooms / abs(columns[2])).min(), YAW_HEADROOM)
    turning = tilting + min(max(yaw, -allowed), allowed) * columns[2]
    below = -turning.min()
    scale = min(1 / max(np.ptp(turning), 1.0), thrust / max(below, thrust, 1e-9))
    turning *= scale
    return np.asarray(min(max(thrust, below * scale), 1 - turning.max()) + turning)


def px4(columns: Array, demands: Four) -> Array:
    """Thrusts likewise, by ``ControlAllocationSequentialDesaturation`` with MC_AIRMODE 0: roll, pitch, then yaw."""
    *tilt, yaw, thrust = demands
    less = np.full(4, -1.0)
    thrusts = _within(thrust + tilt @ columns[:2], less, is_thrust=True)
    for column in columns[:2]:
        thrusts = _within(thrusts, column)
    thrusts = _within(thrusts + yaw * columns[2], columns[2], 1 + YAW_MARGIN)
    return _within(thrusts, less, is_thrust=True).clip(0.0, 1.0)


def _within(thrusts: Array, column: Array, highest: float = 1.0, is_thrust: bool = False) -> Array:
    """Thrusts moved along a ``column`` to leave the limits (``desaturateActuators``); of thrust not upwards."""
    for share in (1.0, 0.5):
        needed = (thrusts.clip(0.0, highest) - thrusts) / np.where(column, column, np.inf)
        gain = needed.min(initial=0.0) + needed.max(initial=0.0)
        if is_thrust and gain < 0:
            break
        thrusts = thrusts + share * gain * column
    return thrusts
