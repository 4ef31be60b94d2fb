"""Mixers: what ArduPilot and PX4 leave of their controllers' demands where motors are at their limits.

Neither climbs to turn. Thrusts (4,) are shares of a motor's most: 0 where it begins, 1 where it ends; ``columns``
(3, 4) are what demands of roll, pitch and yaw add to them.
"""

import numpy as np

from sitl_scenarios.dynamics import Four
from sitl_scenarios.motion import Array

YAW_HEADROOM = 0.2  # of thrust, that yaw has at least: ArduPilot's MOT_YAW_HEADROOM, 200 by default
YAW_MARGIN = 0.15  # of thrust beyond the most, that yaw may ask for: PX4's MINIMUM_YAW_MARGIN


def ardupilot(columns: Array, demands: Four) -> Array:
    """Returns thrusts for ``demands`` of roll, pitch, yaw and thrust.

    They are by ``AP_MotorsMatrix::output_armed_stabilizing``. Yaw gives way first, then all three alike, until the
    lowest motor stands still at the thrust asked for.
    """
    *tilt, yaw, thrust = demands
    tilting = tilt @ columns[:2]
    best = min(0.5, thrust)
    upwards = 1 - best - tilting
    downwards = best + tilting
    rooms = np.where(yaw * columns[2] > 0, upwards, downwards)
    room = (rooms / abs(columns[2])).min()
    allowed = max(room, YAW_HEADROOM)
    limited_yaw = min(max(yaw, -allowed), allowed)
    turning = tilting + limited_yaw * columns[2]
    below = -turning.min()
    within_range = 1 / max(np.ptp(turning), 1.0)
    above_zero = thrust / max(below, thrust, 1e-9)
    scale = min(within_range, above_zero)
    turning *= scale
    highest = 1 - turning.max()
    lifted = min(max(thrust, below * scale), highest)
    return lifted + turning


def px4(columns: Array, demands: Four) -> Array:
    """Returns thrusts likewise, by ``ControlAllocationSequentialDesaturation`` with MC_AIRMODE 0.

    The order is roll, pitch, then yaw.
    """
    *tilt, yaw, thrust = demands
    thrusts = _within(thrust + tilt @ columns[:2], -1.0, is_thrust=True)
    for column in columns[:2]:
        thrusts = _within(thrusts, column)
    yawing = thrusts + yaw * columns[2]
    thrusts = _within(yawing, columns[2], 1 + YAW_MARGIN)
    return _within(thrusts, -1.0, is_thrust=True).clip(0.0, 1.0)


def _within(
    thrusts: Array, column: Array | float, highest: float = 1.0, is_thrust: bool = False
) -> Array:
    """Thrusts moved along a ``column`` to leave the limits (``desaturateActuators``); of thrust not upwards."""
    # Most are within them: of floats, as numpy's calls on arrays of four take ten times as long.
    if all(0.0 <= thrust <= highest for thrust in thrusts.tolist()):
        return thrusts
    for share in (1.0, 0.5):
        excess = thrusts.clip(0.0, highest) - thrusts
        needed = excess / np.where(column, column, np.inf)
        gain = needed.min(initial=0.0) + needed.max(initial=0.0)
        if is_thrust and gain < 0:
            break
        thrusts = thrusts + share * gain * column
    return thrusts
