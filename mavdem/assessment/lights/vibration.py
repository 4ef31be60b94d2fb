"""The light of vibration: acceleration and clips of each IMU against the limits of the autopilot that measured it."""

import numpy as np

from mavdem.assessment.condition import settled_parts, vibration_of
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.lights.limits import SEVERITY, Limits
from mavdem.dataset import phases
from mavdem.dataset.segments import Segment, in_segments
from mavdem.facts import Fact
from mavdem.facts.vibration import VibrationLight

ARDUPILOT = Limits(15.0, 30.0)
"""m/s², of VIBE: https://ardupilot.org/copter/docs/common-measuring-vibration.html."""
PX4 = Limits(4.905, 9.81)
"""m/s², of ``accel_vibration_metric``: https://github.com/PX4/flight_review, app/plot_app/configured_plots.py."""
CLIPS = Limits(0, 100)
"""Of an IMU in flight: up to the second ArduPilot's page calls them acceptable."""


def vibration_light(evidence: Evidence) -> Fact:
    """Returns the largest mean vibration in settled flight, else in the air, and the most clips, of all IMUs."""
    signals = evidence.signals
    telemetry = signals.telemetry
    limits = PX4 if telemetry.autopilot == "PX4" else ARDUPILOT
    unknown = Fact(VibrationLight.VIBRATION_UNKNOWN, recorder=telemetry.translated_from)
    measured = vibration_of(signals)
    if measured is None:
        return unknown
    levels = measured.levels
    flown = (
        Segment(boot, *span)
        for boot in np.unique(levels.boot).tolist()
        for span in phases.airborne_intervals(signals, boot)
    )
    settled = settled_parts(signals)
    here = in_segments(levels, *(settled or flown))
    if not here.any():
        return unknown
    mean = levels.values[here].mean(axis=0)
    largest = mean.max()
    imu, axis = divmod(mean.argmax(), len(measured.axes))
    clips = int(measured.clips[here].sum(axis=0).max())
    return Fact(
        VibrationLight.VIBRATION_MEASURED,
        max(limits.level(largest), CLIPS.level(clips), key=SEVERITY.index),
        subject=f"IMU {imu + 1}",
        axis=measured.axes[axis],
        vibration=largest,
        acceptable_vibration=limits.bad if largest > limits.bad else limits.watch,
        clips=clips,
        is_settled=bool(settled),
    )
