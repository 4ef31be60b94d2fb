"""Mixers: what ArduPilot and PX4 leave of their controllers' demands where motors are at their limits.

Thrusts are shares of a motor's most: 0 where it begins, 1 where it ends.
"""

from __future__ import annotations

from collections.abc import Sequence

from sitl_scenarios.dynamics import Four, RotorFrame

YAW_HEADROOM = 0.2  # of thrust, that yaw has at least: ArduPilot's MOT_YAW_HEADROOM, 200 by default
YAW_MARGIN = 0.15  # of thrust beyond the most, that yaw may ask for: PX4's MINIMUM_YAW_MARGIN


def ardupilot(frame: RotorFrame, demands: Four) -> Four:
    """Thrusts by ``AP_MotorsMatrix::output_armed_stabilizing``, without boost: the vehicle does not climb for attitude.

    ``demands`` are roll, pitch, yaw and thrust. Yaw gives way first, then all three alike, until the lowest motor
    stands still at the thrust asked for.
    """
    roll, pitch, yaw, thrust = demands
    tilting = [roll * r + pitch * p for r, p in zip(frame.roll, frame.pitch, strict=True)]
    best = min(0.5, thrust)
    rooms = [
        (1.0 - best - one if yaw * turn > 0.0 else best + one) / abs(turn)
        for one, turn in zip(tilting, frame.yaw, strict=True)
    ]
    allowed = max(min(rooms), YAW_HEADROOM)
    yaw = min(max(yaw, -allowed), allowed)
    turning = [one + yaw * turn for one, turn in zip(tilting, frame.yaw, strict=True)]
    lowest = min(turning)
    highest = max(turning)
    scale = 1.0
    if highest - lowest > 1.0:
        scale = 1.0 / (highest - lowest)
    if thrust + lowest < 0.0:
        scale = min(scale, -thrust / lowest)
    thrust = min(max(thrust, -lowest * scale), 1.0 - highest * scale)
    return tuple(thrust + scale * one for one in turning)


def px4(frame: RotorFrame, demands: Four) -> Four:
    """Thrusts by ``ControlAllocationSequentialDesaturation``, MC_AIRMODE 0: the vehicle does not climb for attitude."""
    roll, pitch, yaw, thrust = demands
    less = (-1.0,) * len(frame.yaw)
    thrusts = [thrust + roll * r + pitch * p for r, p in zip(frame.roll, frame.pitch, strict=True)]
    thrusts = _within(thrusts, less, one_way=True)
    thrusts = _within(_within(thrusts, frame.roll), frame.pitch)
    thrusts = [one + yaw * turn for one, turn in zip(thrusts, frame.yaw, strict=True)]
    thrusts = _within(_within(thrusts, frame.yaw, 1.0 + YAW_MARGIN), less, one_way=True)
    return tuple(min(max(one, 0.0), 1.0) for one in thrusts)


def _within(
    thrusts: Sequence[float], column: Four, highest: float = 1.0, one_way: bool = False
) -> list[float]:
    """Thrusts moved along a ``column`` of the mixer, to leave the limits (``desaturateActuators``)."""
    moved = list(thrusts)
    for share in (1.0, 0.5):
        needed = [0.0] + [
            (min(max(one, 0.0), highest) - one) / step
            for one, step in zip(moved, column, strict=True)
            if step
        ]
        gain = min(needed) + max(needed)
        if one_way and gain < 0.0 and share == 1.0:
            break
        moved = [one + share * gain * step for one, step in zip(moved, column, strict=True)]
    return moved
