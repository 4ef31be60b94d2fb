"""Slow swings of the attitude, as facts (coded findings), in modes in which the autopilot alone decides where to fly.

A position controller whose gains are too high for the vehicle, or whose position is wrong, leans the vehicle to and
fro by tens of degrees, once in one to five seconds. The attitude may follow its setpoint throughout, so that no error
of the attitude shows it. A path that turns to and fro by itself leans a sound vehicle as much
(:mod:`mavdem.assessment.commanded_swings`).
"""

from collections.abc import Iterator, Sequence

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.commanded_swings import commanded_lean, path_leans
from mavdem.dataset.axes import TILT_AXES, TILT_COLUMNS
from mavdem.dataset.flight_states import mode_intervals
from mavdem.dataset.intervals import TimeInterval, in_intervals, intersection
from mavdem.dataset.signals import Signals
from mavdem.dataset.steady_flight import attitude_tracking
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent

AUTONOMOUS_MODES = frozenset(
    {"Auto", "RTL", "Smart rtl", "Land", "Circle", "Brake"}
    | {"Mission", "Hold", "Return", "Takeoff", "Descend", "Precision landing", "Orbit"}
)
"""Modes of ArduPilot and PX4 in which neither a stick nor another computer determines how the vehicle leans."""

SWING_ANGLE = np.radians(20.0)
"""Lean, rad, to both sides that makes a swing: turns of a mission lean as far, but to one side."""

MAX_SWING_SECONDS = 2.5
"""Longest time, s, from one side to the other: position controllers swing once in one to five seconds."""

MIN_SWINGS = 4
"""Number of leans to alternate sides that are swings; to stop and to fly back takes two."""


def attitude_swings(signals: Signals, boot: int, flight_interval: TimeInterval) -> Iterator[Fact]:
    """Yields an event for each time in which roll or pitch swung to and fro in an autonomous mode.

    A swing that the path commanded, such as a zigzag, is good.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.

    Yields:
        A fact for each swing of an axis, which is its subject, "roll" or "pitch". Its figures are:

        - ``angle``: the largest angle, rad;
        - ``count``: the number of leans to either side;
        - ``period``: the time from a lean to the next one to the same side, s;
        - ``commanded_angle``: the largest lean that the path needs, rad; only for a commanded swing;
        - ``other_axis`` and ``other_angle``: the other axis and its largest angle, rad, if it leaned as far meanwhile.
    """
    tracking = attitude_tracking(signals, boot)
    if tracking is None:
        return
    autonomous = intersection([flight_interval], mode_intervals(signals, boot, AUTONOMOUS_MODES))
    is_autonomous = in_intervals(tracking.time, autonomous)
    leans_of_path = path_leans(signals, boot, tracking)
    # Angles that the pilot may have commanded are set to 0, so that they are no swings.
    angles = np.where(is_autonomous[:, np.newaxis], tracking.angles[:, TILT_COLUMNS], 0.0)
    roll, pitch = angles.T
    for column, axis in enumerate(TILT_AXES):
        angle = angles[:, column]
        other_axis, other_angle = ("pitch", pitch) if axis == "roll" else ("roll", roll)
        for peaks_of_swing in _alternating_peaks(tracking.time, angle):
            swing = _swing_event(tracking.time, angle, peaks_of_swing)
            swing = swing.replace(subject=axis, boot=boot)
            swing = _with_lean_of_other_axis(swing, peaks_of_swing, other_axis, other_angle)
            if leans_of_path is not None:
                commanded_angle = commanded_lean(
                    tracking.time, angle, leans_of_path[:, column], peaks_of_swing
                )
                if commanded_angle is not None:
                    swing = swing.replace(Level.GOOD, commanded_angle=commanded_angle)
            yield swing


def _swing_event(time: Array, angle: Array, peaks_of_swing: Sequence[int]) -> Fact:
    """Returns the event that an angle swung to and fro, from its first lean to its last one.

    Args:
        time: (N,) times of the samples, s, ascending.
        angle: (N,) roll or pitch, rad.
        peaks_of_swing: indices of the samples with the largest angles, to alternate sides; at least two.

    Returns:
        A fact (coded finding) with its times, s, the largest ``angle``, rad, the number of leans as ``count``, and the
        ``period``, s.
    """
    peak_times = time[peaks_of_swing]
    # Successive leans are to opposite sides: half a period apart.
    mean_half_period = float(np.diff(peak_times).mean())
    return Fact(
        MotionEvent.ATTITUDE_SWUNG,
        time=float(peak_times[0]),
        end_time=float(peak_times[-1]),
        angle=float(abs(angle[peaks_of_swing]).max()),
        count=len(peaks_of_swing),
        period=2 * mean_half_period,
    )


def _with_lean_of_other_axis(
    swing: Fact, peaks_of_swing: Sequence[int], other_axis: str, other_angle: Array
) -> Fact:
    """Adds to the swing of one axis that the other axis leaned by more than ``SWING_ANGLE`` meanwhile, if it did.

    A vehicle that circles with a constant heading, for example, swings about both axes.

    Args:
        swing: the event of the swing, a coded finding.
        peaks_of_swing: indices of its leans among the samples, ascending.
        other_axis: name of the other axis, "roll" or "pitch".
        other_angle: (N,) its angle, rad.

    Returns:
        The event, with the figures ``other_axis`` and ``other_angle``, rad, the largest one, if the other axis leaned.
    """
    samples_of_swing = slice(peaks_of_swing[0], peaks_of_swing[-1] + 1)
    largest_angle = float(abs(other_angle[samples_of_swing]).max())
    if largest_angle <= SWING_ANGLE:
        return swing
    return swing.replace(other_axis=other_axis, other_angle=largest_angle)


def _alternating_peaks(time: Array, angle: Array) -> list[list[int]]:
    """Finds swings of an angle: runs of leans to the left and right, or forward and back, in turn.

    Args:
        time: (N,) times of the samples, s, ascending.
        angle: (N,) roll or pitch, rad.

    Returns:
        For each run, the indices of the samples with its largest leans: at least ``MIN_SWINGS``, each within
        ``MAX_SWING_SECONDS`` of the lean before.
    """
    alternating_runs: list[list[int]] = []
    for peak in _peaks_of_leans(time, angle):
        continues_run = False
        if alternating_runs:
            last_peak = alternating_runs[-1][-1]
            is_to_other_side = angle[peak] * angle[last_peak] < 0
            continues_run = is_to_other_side and time[peak] - time[last_peak] <= MAX_SWING_SECONDS
        if continues_run:
            alternating_runs[-1].append(peak)
        else:
            alternating_runs.append([peak])
    return [run_peaks for run_peaks in alternating_runs if len(run_peaks) >= MIN_SWINGS]


def _peaks_of_leans(time: Array, angle: Array) -> list[int]:
    """Finds the largest angle of each lean: a time in which the angle exceeds ``SWING_ANGLE`` to one side.

    A lean to the same side that comes ``MAX_SWING_SECONDS`` later is another one.

    Args:
        time: (N,) times of the samples, s, ascending.
        angle: (N,) roll or pitch, rad.

    Returns:
        The indices of the samples with the largest angle of each lean, ascending.
    """
    peaks: list[int] = []
    for sample in np.flatnonzero(abs(angle) > SWING_ANGLE).tolist():
        is_same_lean = False
        if peaks:
            is_same_side = angle[sample] * angle[peaks[-1]] > 0
            is_same_lean = is_same_side and time[sample] - time[peaks[-1]] < MAX_SWING_SECONDS
        if not is_same_lean:
            peaks.append(sample)
        elif abs(angle[sample]) > abs(angle[peaks[-1]]):
            peaks[-1] = sample
    return peaks
