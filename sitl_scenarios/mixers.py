"""Mixers of ArduPilot and PX4: motor thrusts for demands of roll, pitch, yaw and thrust, and their order at saturation.

Neither mixer climbs in order to turn. Thrusts (n,) of n motors are fractions of the largest: 0 at the start of a
motor's range, 1 at the end. ``columns`` (3, n) are what demands of roll, pitch and yaw add to the thrusts.
"""

import numpy as np

from sitl_scenarios.motion import Array
from sitl_scenarios.rotors import RotorFrame
from sitl_scenarios.vectors import Vector4

YAW_HEADROOM = 0.2
"""Thrust that yaw may use whatever roll and pitch need: ArduPilot's MOT_YAW_HEADROOM, by default 200 of 1000."""

YAW_MARGIN = 0.15
"""Thrust above 1 that yaw may demand before the collective thrust gives way: PX4's MINIMUM_YAW_MARGIN."""

MAX_CENTRED_THRUST = 0.5
"""Collective thrust above which ArduPilot's mixer counts the room for yaw as at half thrust."""

MIN_RELATIVE_ELEMENT = 1e-6
"""Smallest element of a mixer's column, relative to its largest, that is not a rounding error."""

MIN_DENOMINATOR = 1e-9
"""Smallest divisor of the collective thrust: with no thrust and no demand at all, it would be zero."""


def ardupilot_columns(frame: RotorFrame) -> Array:
    """Returns ArduPilot's mixer of a frame, (3, n): ``AP_MotorsMatrix`` makes the largest element of a row a half."""
    return np.array([frame.roll, frame.pitch, frame.yaw]) / 2


def px4_columns(frame: RotorFrame, moment_ratio: float) -> Array:
    """Returns PX4's mixer of a frame: the pseudo-inverse of the effects of its motors, scaled as PX4 scales it.

    Each column of the pseudo-inverse holds the motor thrusts that turn the vehicle about one axis only. As in
    ``ControlAllocationPseudoInverse.cpp``, the columns of roll and pitch are divided by the same scale: the larger of
    |column| √(2/m), where m is the number of motors that the column moves. Yaw is divided by its largest element.

    Args:
        frame: Positions and directions of rotation of n rotors.
        moment_ratio: Torque of a rotor per unit of its thrust, m: the size of CA_ROTORn_KM.

    Returns:
        (3, n) what demands of roll, pitch and yaw add to the thrusts of the motors.
    """
    # Rows: torque about roll, pitch and yaw, and thrust, that a thrust of 1 of each motor gives the vehicle; (4, n).
    effects = np.array(
        [
            [-right for right in frame.right],
            frame.forward,
            [moment_ratio * direction for direction in frame.yaw],
            np.ones(len(frame.yaw)),
        ]
    )
    roll, pitch, yaw, _ = np.linalg.pinv(effects).T
    tilt_scale = max(_tilt_scale(roll), _tilt_scale(pitch))
    return np.array([roll / tilt_scale, pitch / tilt_scale, yaw / yaw.max()])


def _tilt_scale(column: Array) -> float:
    """Returns PX4's scale |column| √(2/m) of a column of roll or pitch that moves m motors."""
    # The element of a rotor on the axis would be zero without rounding.
    moved_motors = np.count_nonzero(abs(column) > MIN_RELATIVE_ELEMENT * abs(column).max())
    return float(np.linalg.norm(column) / np.sqrt(moved_motors / 2))


def ardupilot_thrusts(columns: Array, demands: Vector4) -> Array:
    """Distributes demands over the motors like ArduPilot's ``AP_MotorsMatrix::output_armed_stabilizing``.

    The thrust of a motor is the collective thrust plus what roll, pitch and yaw add to it, and must stay from 0 to 1.
    If that is too little room, ArduPilot gives up, in this order:

    1. yaw, down to ``YAW_HEADROOM``, because the heading matters least;
    2. roll, pitch and yaw alike, by one factor, until the motor with the lowest thrust just stands still at the
       demanded collective thrust, and the motors fit into a range of 1;
    3. collective thrust, where the motor with the highest thrust would exceed 1.

    Args:
        columns: (3, n) change of each motor's thrust by a demand of 1; rows are roll, pitch and yaw. No element of yaw
            is zero.
        demands: Roll, pitch and yaw, −1 to 1, and collective thrust, 0 to 1.

    Returns:
        Thrust of each motor, (n,), 0 to 1.
    """
    roll, pitch, yaw, thrust = demands
    # Floats are used, since NumPy's calls on such small arrays take several times as long.
    roll_column, pitch_column, yaw_column = columns.tolist()
    tilt_thrusts = [
        roll * roll_element + pitch * pitch_element
        for roll_element, pitch_element in zip(roll_column, pitch_column, strict=True)
    ]

    # Each motor has a margin for yaw, up to 1 or down to 0, by the direction in which yaw moves it. The motor with the
    # smallest margin limits yaw.
    centred_thrust = min(MAX_CENTRED_THRUST, thrust)
    yaw_limits = []
    for tilt_thrust, yaw_element in zip(tilt_thrusts, yaw_column, strict=True):
        is_raised_by_yaw = yaw * yaw_element > 0
        if is_raised_by_yaw:
            thrust_margin = 1 - centred_thrust - tilt_thrust
        else:
            thrust_margin = centred_thrust + tilt_thrust
        yaw_limits.append(thrust_margin / abs(yaw_element))
    max_yaw = max(min(yaw_limits), YAW_HEADROOM)
    limited_yaw = min(max(yaw, -max_yaw), max_yaw)

    # One factor for all motors: their spread fits into 1, and none falls below 0 at the demanded thrust.
    differential = [
        tilt_thrust + limited_yaw * yaw_element
        for tilt_thrust, yaw_element in zip(tilt_thrusts, yaw_column, strict=True)
    ]
    lowest = min(differential)
    highest = max(differential)
    spread_scale = 1 / max(highest - lowest, 1.0)
    depth_scale = thrust / max(-lowest, thrust, MIN_DENOMINATOR)
    scale = min(spread_scale, depth_scale)

    max_collective = 1 - highest * scale
    collective = min(max(thrust, -lowest * scale), max_collective)
    return np.array([collective + scale * difference for difference in differential])


def px4_thrusts(columns: Array, demands: Vector4) -> Array:
    """Distributes demands over the motors like PX4's ``ControlAllocationSequentialDesaturation`` with MC_AIRMODE 0.

    The thrust of a motor is the collective thrust plus what roll, pitch and yaw add to it, and must stay from 0 to 1.
    PX4 brings the motors back into their range step by step, each time along one direction: first the collective thrust
    is lowered, then roll, pitch and yaw are reduced. With MC_AIRMODE 0 the collective thrust is never raised.

    Args:
        columns: (3, n) change of each motor's thrust by a demand of 1; rows are roll, pitch and yaw.
        demands: (4,) roll, pitch and yaw, −1 to 1, and collective thrust, 0 to 1.

    Returns:
        (n,) thrust of each motor, 0 to 1.
    """
    roll, pitch, yaw, thrust = demands
    roll_column, pitch_column, yaw_column = columns
    thrusts = _with_lower_collective(thrust + (roll, pitch) @ columns[:2])
    thrusts = _desaturated(thrusts, roll_column)
    thrusts = _desaturated(thrusts, pitch_column)
    # Yaw is added last, so that it never takes anything from roll and pitch. It may exceed the range by a margin, for
    # which the collective thrust is then lowered.
    thrusts = _desaturated(thrusts + yaw * yaw_column, yaw_column, 1 + YAW_MARGIN)
    return _with_lower_collective(thrusts).clip(0.0, 1.0)


def _with_lower_collective(thrusts: Array) -> Array:
    """Returns thrusts moved down together to leave the limits, (n,); they are never moved up."""
    return _desaturated(thrusts, -1.0, only_positive=True)


def _desaturated(
    thrusts: Array, column: Array | float, highest: float = 1.0, *, only_positive: bool = False
) -> Array:
    """Moves motor thrusts along one column of the mixer back into their range, like PX4's ``desaturateActuators``.

    Adding a multiple of a column changes one demand only, say roll, and leaves the others. Each motor outside the range
    needs a certain multiple; the largest positive and the largest negative one are added up. If that step pushes other
    motors out of the range, a second one, of half the multiple then needed, balances both sides.

    Args:
        thrusts: Thrust of each motor, (n,).
        column: Change of the thrusts per unit of the demand, (n,), or one number that holds for all motors.
        highest: Upper limit of the thrusts; the lower one is 0.
        only_positive: Whether only positive multiples of ``column`` may be added.

    Returns:
        Thrusts, (n,), which may still violate a limit where no multiple of the column can resolve it.
    """
    # Most thrusts are within the limits. The check uses floats: NumPy's calls on small arrays take ten times as long.
    if all(0.0 <= thrust <= highest for thrust in thrusts.tolist()):
        return thrusts
    for step_fraction in (1.0, 0.5):
        correction = thrusts.clip(0.0, highest) - thrusts
        # A motor that the column does not change is given an infinite divisor, so that it needs no multiple of the
        # column.
        needed_multiples = correction / np.where(column, column, np.inf)
        multiple = needed_multiples.min(initial=0.0) + needed_multiples.max(initial=0.0)
        if only_positive and multiple < 0:
            break
        thrusts = thrusts + step_fraction * multiple * column
    return thrusts
