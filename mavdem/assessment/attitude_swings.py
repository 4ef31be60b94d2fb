"""Slow swings of the attitude in modes in which the autopilot alone decides where to fly.

A position controller whose gains are too high for the vehicle, or whose position is wrong, leans the vehicle to and
fro by tens of degrees, once in one to five seconds. The attitude may follow its setpoint throughout, so that no error
of the attitude shows it.
"""

from collections.abc import Iterator

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import Interval
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.intervals import in_intervals, intersection
from mavdem.dataset.phases import mode_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.steady_flight import attitude_tracking
from mavdem.facts import Fact
from mavdem.facts.ending import MotionEvent

AUTONOMOUS_MODES = frozenset(
    {"Auto", "RTL", "Smart rtl", "Land", "Circle", "Brake"}
    | {"Mission", "Hold", "Return", "Takeoff", "Descend", "Precision landing", "Orbit"}
)
"""Modes of ArduPilot and PX4 in which neither a stick nor another computer decides how the vehicle leans."""

SWING_ANGLE = np.radians(20.0)
"""Lean, rad, to both sides that makes a swing: turns of a mission lean as far, but to one side."""

MAX_SWING_SECONDS = 2.5
"""Longest time, s, from one side to the other: position controllers swing once in one to five seconds."""

MIN_SWINGS = 4
"""Number of leans to alternate sides that are swings; to stop and to fly back takes two."""


def attitude_swings(signals: Signals, boot: int, flight: Interval) -> Iterator[Fact]:
    """Yields an event for each time in which roll or pitch swung to and fro in an autonomous mode.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
        flight: start and end of the flight, s since boot.

    Yields:
        A fact for each axis and time, with the name of the axis as its subject, the largest ``angle``, rad, the number
        of leans as ``count``, and the time, s, from a lean to the next one to the same side as ``period``.
    """
    tracking = attitude_tracking(signals, boot)
    if tracking is None:
        return
    autonomous = intersection([flight], mode_intervals(signals, boot, AUTONOMOUS_MODES))
    is_autonomous = in_intervals(tracking.time, autonomous)
    for column, axis in enumerate(TILT_AXES):
        angle = np.where(is_autonomous, tracking.angles[:, column], 0.0)
        for peaks in _alternating_peaks(tracking.time, angle):
            times = tracking.time[peaks]
            yield Fact(
                MotionEvent.ATTITUDE_SWUNG,
                time=float(times[0]),
                until=float(times[-1]),
                subject=axis,
                angle=float(abs(angle[peaks]).max()),
                count=len(peaks),
                period=2 * float(np.diff(times).mean()),
                boot=boot,
            )


def _alternating_peaks(time: Array, angle: Array) -> list[list[int]]:
    """Finds swings of an angle: runs of leans to the left and right, or forward and back, in turn.

    A lean is a time in which the angle exceeds ``SWING_ANGLE`` to one side.

    Args:
        time: (N,) times of the samples, s, ascending.
        angle: (N,) roll or pitch, rad.

    Returns:
        For each run, the rows of its largest leans: at least ``MIN_SWINGS``, each within ``MAX_SWING_SECONDS`` of the
        one before.
    """
    # First, the row of the largest angle of each lean. A lean to the same side that comes much later is another one.
    peaks: list[int] = []
    for row in np.flatnonzero(abs(angle) > SWING_ANGLE).tolist():
        last = peaks[-1] if peaks else None
        is_same_lean = (
            last is not None
            and angle[row] * angle[last] > 0
            and time[row] - time[last] < MAX_SWING_SECONDS
        )
        if last is None or not is_same_lean:
            peaks.append(row)
        elif abs(angle[row]) > abs(angle[last]):
            peaks[-1] = row
    # Then, the runs in which each lean is to the other side than the one before, and follows it soon.
    runs: list[list[int]] = []
    for peak in peaks:
        last = runs[-1][-1] if runs else None
        alternates = last is not None and angle[peak] * angle[last] < 0
        if last is not None and alternates and time[peak] - time[last] <= MAX_SWING_SECONDS:
            runs[-1].append(peak)
        else:
            runs.append([peak])
    return [run for run in runs if len(run) >= MIN_SWINGS]
