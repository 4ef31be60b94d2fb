"""Mixers of ArduPilot and PX4: thrusts of the motors for a controller's demands, and what gives way at their limits.

Neither mixer climbs in order to turn. Thrusts (4,) are fractions of a motor's largest: 0 at the start of its range, 1
at the end. ``columns`` (3, 4) are what demands of roll, pitch and yaw add to the four thrusts.
"""

import numpy as np

from sitl_scenarios.motion import Array
from sitl_scenarios.vectors import Vector4

YAW_HEADROOM = 0.2
"""Thrust that yaw may use whatever roll and pitch need: ArduPilot's MOT_YAW_HEADROOM, by default 200 of 1000."""

YAW_MARGIN = 0.15
"""Thrust above 1 that yaw may ask for before the collective thrust gives way: PX4's MINIMUM_YAW_MARGIN."""

MAX_CENTRED_THRUST = 0.5
"""Collective thrust above which ArduPilot's mixer counts the room for yaw as at half thrust."""


def ardupilot_thrusts(columns: Array, demands: Vector4) -> Array:
    """Mixes demands like ArduPilot's ``AP_MotorsMatrix::output_armed_stabilizing``.

    Where the motors' range is too small, yaw gives way first, down to ``YAW_HEADROOM``. Then roll, pitch and yaw are
    scaled down alike, until the motor with the lowest thrust stands still at the collective thrust.

    Args:
        columns: Effect of roll, pitch and yaw on the motors, (3, 4).
        demands: Roll, pitch, yaw and collective thrust.

    Returns:
        Thrust of each motor, (4,), 0 to 1.
    """
    roll, pitch, yaw, thrust = demands
    tilt_thrusts = (roll, pitch) @ columns[:2]
    centred_thrust = min(MAX_CENTRED_THRUST, thrust)
    room_upwards = 1 - centred_thrust - tilt_thrusts
    room_downwards = centred_thrust + tilt_thrusts
    rooms = np.where(yaw * columns[2] > 0, room_upwards, room_downwards)
    yaw_room = (rooms / abs(columns[2])).min()
    max_yaw = max(yaw_room, YAW_HEADROOM)
    limited_yaw = min(max(yaw, -max_yaw), max_yaw)
    differential = tilt_thrusts + limited_yaw * columns[2]
    lowest = -differential.min()
    range_scale = 1 / max(np.ptp(differential), 1.0)
    # The denominator is never zero.
    zero_scale = thrust / max(lowest, thrust, 1e-9)
    scale = min(range_scale, zero_scale)
    differential *= scale
    max_collective = 1 - differential.max()
    collective = min(max(thrust, lowest * scale), max_collective)
    return collective + differential


def px4_thrusts(columns: Array, demands: Vector4) -> Array:
    """Mixes demands like PX4's ``ControlAllocationSequentialDesaturation`` with MC_AIRMODE 0.

    Where the motors' range is too small, the collective thrust is lowered first, then roll, pitch and yaw are reduced
    in this order.

    Args:
        columns: Effect of roll, pitch and yaw on the motors, (3, 4).
        demands: Roll, pitch, yaw and collective thrust.

    Returns:
        Thrust of each motor, (4,), 0 to 1.
    """
    roll, pitch, yaw, thrust = demands
    roll_column, pitch_column, yaw_column = columns
    thrusts = _lowered(thrust + (roll, pitch) @ columns[:2])
    thrusts = _desaturated(thrusts, roll_column)
    thrusts = _desaturated(thrusts, pitch_column)
    thrusts = _desaturated(thrusts + yaw * yaw_column, yaw_column, 1 + YAW_MARGIN)
    return _lowered(thrusts).clip(0.0, 1.0)


def _lowered(thrusts: Array) -> Array:
    """Returns thrusts moved down together to leave the limits, (4,); they are never moved up."""
    return _desaturated(thrusts, -1.0, only_positive=True)


def _desaturated(
    thrusts: Array, column: Array | float, highest: float = 1.0, only_positive: bool = False
) -> Array:
    """Moves thrusts along a column of the mixer to leave their limits, like PX4's ``desaturateActuators``.

    It takes the step that resolves the largest violations on both sides, and then half of what is left.

    Args:
        thrusts: Thrust of each motor, (4,).
        column: Direction, (4,), or the same for all motors.
        highest: Upper limit of the thrusts; the lower one is 0.
        only_positive: Whether only steps in the direction of ``column`` are taken, and none against it.
    """
    # Most thrusts are within the limits. The check uses floats: NumPy's calls on arrays of four take ten times as long.
    if all(0.0 <= thrust <= highest for thrust in thrusts.tolist()):
        return thrusts
    for step_fraction in (1.0, 0.5):
        excess = thrusts.clip(0.0, highest) - thrusts
        # Gain of the column that each motor needs; a motor that the column does not move needs none.
        needed = excess / np.where(column, column, np.inf)
        gain = needed.min(initial=0.0) + needed.max(initial=0.0)
        if only_positive and gain < 0:
            break
        thrusts = thrusts + step_fraction * gain * column
    return thrusts
