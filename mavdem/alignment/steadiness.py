"""Steadiness: where motors may be compared, for the vehicle neither turns its nose nor strays from its setpoint.

While the nose turns, wind and load pull from elsewhere, and the yaw controller works; and motors of a vehicle that does
not follow its attitude setpoint work against something else than their own weakness.
"""

from __future__ import annotations

from math import nan

import numpy as np
from numpy.typing import NDArray

from mavdem.alignment.drive import TILT_AXES
from mavdem.alignment.phases import Intervals, both, settled, where
from mavdem.alignment.signals import Signals, attitude, held, setpoints
from mavdem.ingest.telemetry import Array

TURN_SECONDS = 1.0
MAX_TURN = np.radians(10.0)
"""Change of heading, rad, over so many seconds, from which the nose turns: five times what holding it in gusts takes,
half of a turn by the stick in slow flight."""
MAX_STRAY = np.radians(15.0)
"""Of roll and pitch from their setpoints: half of the error from which ArduPilot's crash check counts a loss."""


def is_steady(time: Array, angles: Array, asked: Array) -> NDArray[np.bool_]:
    """Returns at which ``time`` (N,), s, the nose keeps its heading and roll and pitch follow.

    Args:
        time: in order.
        angles: (N, 3) roll, pitch and heading, rad, the last without jumps.
        asked: (N, 2) setpoints of roll and pitch, rad; NaN where there is none.
    """
    heading = angles[:, 2]
    turned = np.abs(heading - np.interp(time - TURN_SECONDS, time, heading))
    strayed = np.abs(angles[:, :2] - asked).max(axis=1)
    # Neither is so where it is not known.
    return np.asarray(~((turned > MAX_TURN) | (strayed > MAX_STRAY)))


def steady(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of settled flight of ``boot`` in which its motors may be compared."""
    yaw = attitude(signals.telemetry, "yaw")
    intervals = settled(signals, boot)
    if yaw is None or len(signals.tilts) < len(TILT_AXES):
        return intervals
    rows = yaw.boot == boot
    time = yaw.time[rows]
    if not len(time):
        return intervals
    tilts = []
    asked = []
    for axis, tilt in zip(TILT_AXES, signals.tilts, strict=True):
        here = tilt.boot == boot
        tilts.append(np.interp(time, tilt.time[here], tilt.angle[here]))
        known = (one for one in setpoints(signals.telemetry, axis) if one.unit == "rad")
        setpoint = next(known, None)
        asked.append(np.full(len(time), nan) if setpoint is None else held(setpoint, boot, time))
    angles = np.column_stack([*tilts, yaw.angle[rows]])
    return both(intervals, where(time, is_steady(time, angles, np.column_stack(asked))))
