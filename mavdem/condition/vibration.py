"""Vibration: how much the acceleration shakes, and how often an accelerometer reached its limit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.alignment.columns import floats, in_order
from mavdem.alignment.signals import Signals
from mavdem.condition.periods import Periods, during

LEVELS = ("vibration_x", "vibration_y", "vibration_z")
CLIPS = ("clipping_0", "clipping_1", "clipping_2")


class VibrationFigures(NamedTuple):
    """Of the first IMU.

    Attributes:
        level: mean level of the acceleration, m/s²: x, y and z from ArduPilot, one for all axes from PX4. The levels of
            the two are not alike: compare flights of one autopilot.
        clips: how often an accelerometer was beyond its range.
    """

    level: tuple[float, ...]
    clips: int


def vibration_of(signals: Signals, periods: Periods) -> VibrationFigures | None:
    """The vibration during some periods; None where it was not measured then.

    PX4's VIBRATION (``streams/VIBRATION.hpp``) has angular levels in x and y, and that of the acceleration in z.
    """
    columns = signals.telemetry.messages.get("VIBRATION")
    if columns is None:
        return None
    names = LEVELS[-1:] if signals.telemetry.autopilot == "PX4" else LEVELS
    if not all(name in columns for name in (*names, *CLIPS)):
        return None
    table = np.column_stack([floats(columns, name) for name in (*names, *CLIPS)])
    time, boot, table, _ = in_order(columns["time"], columns["boot"], table)
    here = during(periods, time, boot)
    levels, clips = table[:, : len(names)], table[:, len(names) :]
    if not levels[here].any():  # also where a firmware sends zeros
        return None
    # The counts are of the boot so far.
    rises = np.clip(np.diff(clips, axis=0, prepend=clips[:1]), 0, None).sum(axis=1)
    return VibrationFigures(tuple(levels[here].mean(axis=0).tolist()), int(rises[here].sum()))
