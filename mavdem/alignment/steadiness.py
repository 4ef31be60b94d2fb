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


def strays(angles: Array, asked: Array) -> NDArray[np.bool_]:
    """Returns where angles (..., 2) of roll and pitch, rad, are known to be far from what is ``asked`` (..., 2)."""
    return np.asarray((np.abs(angles - asked) > MAX_STRAY).any(axis=-1))


def steady(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of settled flight of ``boot`` in which its motors may be compared."""
    time, heading, astray = _followed(signals, boot)
    turned = np.abs(heading - np.interp(time - TURN_SECONDS, time, heading))
    return both(settled(signals, boot), where(time, ~astray & ~(turned > MAX_TURN)))


def headings(signals: Signals, boot: int, time: Array) -> Array:
    """Returns the heading at ``time`` (N,), s of ``boot``, rad; NaN where the attitude strays, 0 where not recorded."""
    known, heading, astray = _followed(signals, boot)
    return np.interp(time, known, np.where(astray, nan, heading))


def _followed(signals: Signals, boot: int) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Times (N,), s, of the attitude, the heading, rad, without jumps, and where roll or pitch strays.

    Where it was not recorded, heading and time are a single 0, which holds for ever.
    """
    yaw = attitude(signals.telemetry, "yaw")
    if yaw is None or not (rows := yaw.boot == boot).any():
        return np.zeros(1), np.zeros(1), np.zeros(1, dtype=np.bool_)
    time = yaw.time[rows]
    angles = []
    asked = []
    for axis, tilt in zip(TILT_AXES, signals.tilts, strict=True):
        here = tilt.boot == boot
        angles.append(np.interp(time, tilt.time[here], tilt.angle[here]))
        known = (one for one in setpoints(signals.telemetry, axis) if one.unit == "rad")
        setpoint = next(known, None)
        asked.append(np.full(len(time), nan) if setpoint is None else held(setpoint, boot, time))
    return time, yaw.angle[rows], strays(np.column_stack(angles), np.column_stack(asked))
