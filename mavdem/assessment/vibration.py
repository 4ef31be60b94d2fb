"""The light of vibration: acceleration and clips of each IMU against the limits of the autopilot that measured it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.alignment import phases
from mavdem.alignment.align import Segment, within
from mavdem.alignment.drive import Signal
from mavdem.alignment.signals import Signals
from mavdem.assessment.evidence import Evidence
from mavdem.condition.condition import parts_of, settled_parts, vibration_by_imu
from mavdem.facts import Fact, Level
from mavdem.facts.lights import VibrationLight


class Limits(NamedTuple):
    """m/s², up to which vibration is good, and beyond which it is bad."""

    watch: float
    bad: float


LIMITS = {"PX4": Limits(4.905, 9.81)}
"""Of ``accel_vibration_metric``: https://github.com/PX4/flight_review, app/plot_app/configured_plots.py."""
ARDUPILOT = Limits(15.0, 30.0)
"""Of VIBE: https://ardupilot.org/copter/docs/common-measuring-vibration.html."""
MANY_CLIPS = 100
"""In flight, up to which the same page calls clips acceptable."""


def vibration_light(evidence: Evidence) -> Fact:
    """Returns the largest mean vibration in settled flight, or else in the air, by IMU and axis, and how often it clips."""
    signals = evidence.signals
    measured = vibration_by_imu(signals)
    rows = _flown(signals, measured)
    if measured is None or not rows.any():
        return Fact(VibrationLight.VIBRATION_UNKNOWN, autopilot=signals.telemetry.autopilot)
    axes = measured.axes
    mean = measured.levels.values[rows].mean(axis=0)
    most = int(mean.argmax())
    clips = measured.clips[rows].sum(axis=0)
    limits = LIMITS.get(signals.telemetry.autopilot, ARDUPILOT)
    level = Level.GOOD
    if mean[most] > limits.bad or clips.max() > MANY_CLIPS:
        level = Level.BAD
    elif mean[most] > limits.watch or clips.any():
        level = Level.WATCH
    return Fact(
        VibrationLight.VIBRATION_MEASURED,
        level,
        subject=f"IMU {most // len(axes) + 1}",
        axis=axes[most % len(axes)],
        vibration=mean[most],
        vibration_limit=limits.bad if level is Level.BAD else limits.watch,
        clips=int(clips.max()),
    )
