"""Mixer: from demands to four motor commands that the motors can follow."""

from __future__ import annotations

from sitl_scenarios.frames import Four, Frame

IDLE = 0.1
"""Of full command: what an armed motor turns at, at least."""


def mixed(frame: Frame, demands: Four) -> Four:
    """Normalised commands of the motors, ``IDLE`` to 1.

    Where a motor would saturate, thrust gives way first, so that the vehicle stays upright, and then all of roll, pitch
    and yaw alike.

    Args:
        frame: whose signs say which motor does what.
        demands: roll, pitch, yaw (−1 to 1) and thrust (0 to 1).
    """
    roll, pitch, yaw, thrust = demands
    r, p, s = frame.roll, frame.pitch, frame.yaw
    a = roll * r[0] + pitch * p[0] + yaw * s[0]
    b = roll * r[1] + pitch * p[1] + yaw * s[1]
    c = roll * r[2] + pitch * p[2] + yaw * s[2]
    d = roll * r[3] + pitch * p[3] + yaw * s[3]
    lowest, highest = min(a, b, c, d), max(a, b, c, d)
    if highest - lowest > 1.0 - IDLE:
        scale = (1.0 - IDLE) / (highest - lowest)
        a, b, c, d = a * scale, b * scale, c * scale, d * scale
        lowest, highest = lowest * scale, highest * scale
    thrust = min(max(thrust, IDLE - lowest), 1.0 - highest)
    return a + thrust, b + thrust, c + thrust, d + thrust
