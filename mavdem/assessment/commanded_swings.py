"""Swings of the attitude that the path commanded: position setpoints that turn to and fro by themselves.

A path whose waypoints follow each other within seconds leans a sound vehicle to and fro. The setpoint of the position
then accelerates to alternate sides, and the lean follows it. A position controller that oscillates leans the vehicle
about a path that does not.
"""

from collections.abc import Sequence

import numpy as np
import scipy

from mavdem.arrays import Array
from mavdem.dataset.axes import YAW
from mavdem.dataset.intervals import split_at_gaps
from mavdem.dataset.signals import Signals
from mavdem.dataset.steady_flight import AttitudeTracking
from mavdem.dataset.time_series import TimeSeries, recorded_series, series_of_boot
from mavdem.physical_constants import GRAVITY

POSITION_TARGET_MESSAGE = "POSITION_TARGET_LOCAL_NED"
"""Message with the setpoints of position, x, y and z, m, and velocity, vx, vy and vz, m/s."""

GRID_STEP = 0.05
"""Seconds between samples of the path: a tenth of the quickest half swing that a position controller makes."""

SMOOTHING_SECONDS = 0.25
"""Standard deviation, s, of the Gaussian that smooths the path before it is differentiated twice.

Logs have the position setpoint at 5 to 10 Hz. A swing with a period of 2.5 s keeps 0.8 of its amplitude.
"""

SMOOTHING_RADIUS = round(4 * SMOOTHING_SECONDS / GRID_STEP)
"""Samples of the path to each side that the Gaussian covers: four standard deviations, SciPy's default."""

MAX_SETPOINT_GAP = 2.5
"""Longest time, s, between two setpoints of one path: the longest half swing that is judged may hide in a longer one.
"""

MAX_PATH_LEAN = np.radians(45.0)
"""Lean, rad, above which an acceleration of the setpoint is no path but a jump, as by a reset of the position.

It is the steepest lean that ArduPilot's and PX4's parameters allow in automatic flight by default.
"""

MIN_LEAD_SECONDS = 0.1
"""Time, s, by which a path that commands a lean is ahead of it: the attitude needs a few tenths of a second to follow.

A setpoint that only follows the vehicle, such as the nearest point of a line, is not ahead.
"""

MIN_COMMANDED_SHARE = 0.5
"""Share of the leans of a swing from which on the path made it: the greater part."""


def path_leans(signals: Signals, boot: int, tracking: AttitudeTracking) -> Array | None:
    """Returns the roll and pitch that a vehicle needs to follow the path of its position setpoint, without wind.

    They follow from the horizontal acceleration of the setpoint along the body axes, a = g tan(lean). Where that is not
    known, as in a gap of the setpoints and for a second before and after one, they are 0.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        tracking: the attitude of the boot at N times.

    Returns:
        Roll and pitch (N, 2), rad; None if no position setpoint was recorded in the boot.
    """
    recorded_setpoints = recorded_series(signals.telemetry, POSITION_TARGET_MESSAGE, "x", "y")
    setpoints = series_of_boot(recorded_setpoints, boot)
    if setpoints is None or len(setpoints.time) < 2:
        return None
    accelerations = np.zeros((len(tracking.time), 2))
    is_gap = np.diff(setpoints.time) > MAX_SETPOINT_GAP
    for start, end in split_at_gaps(setpoints.time, is_gap):
        first_row, end_row = np.searchsorted(tracking.time, [start, end])
        rows = slice(first_row, end_row)
        accelerations[rows] = _path_accelerations(tracking.time[rows], setpoints, start, end)
    north, east = accelerations.T
    heading = tracking.angles[:, YAW]
    forward = np.cos(heading) * north + np.sin(heading) * east
    right = np.cos(heading) * east - np.sin(heading) * north
    # The nose is down, at a negative pitch, when the vehicle accelerates forward.
    return np.column_stack([np.arctan(right / GRAVITY), np.arctan(-forward / GRAVITY)])


def commanded_lean(
    time: Array, angle: Array, path_lean: Array, peaks_of_swing: Sequence[int]
) -> float | None:
    """Returns the largest lean of a swing that the path commanded; None if the path did not make the swing.

    A swing consists of leans to alternate sides. The path made it under two conditions: before the peak of each lean,
    the path itself leans to the same side, as a cause comes before its effect; and on average it leans by at least
    ``MIN_COMMANDED_SHARE`` of the vehicle's lean.

    Args:
        time: (N,) times of the samples, s, ascending.
        angle: (N,) roll or pitch, rad.
        path_lean: (N,) the same angle as the path needs it, rad.
        peaks_of_swing: indices of the samples with the largest angles, to alternate sides; at least two.
    """
    peak_times = time[peaks_of_swing]
    # The lean of each peak begins at the peak before. The first lean counts as long as the second one.
    start_of_first_lean = 2 * peak_times[0] - peak_times[1]
    start_times = [start_of_first_lean, *peak_times[:-1]]
    shares = []
    largest_lean = 0.0
    for peak, start_time in zip(peaks_of_swing, start_times, strict=True):
        rows = slice(np.searchsorted(time, start_time), peak + 1)
        leans_to_side = path_lean[rows] * np.sign(angle[peak])
        row_of_largest = int(np.argmax(leans_to_side))
        lean = float(leans_to_side[row_of_largest])
        lead = time[peak] - time[rows][row_of_largest]
        if lean <= 0 or lean > MAX_PATH_LEAN or lead < MIN_LEAD_SECONDS:
            return None
        shares.append(min(lean / abs(float(angle[peak])), 1.0))
        largest_lean = max(largest_lean, lean)
    return largest_lean if np.mean(shares) >= MIN_COMMANDED_SHARE else None


def _path_accelerations(time: Array, setpoints: TimeSeries, start: float, end: float) -> Array:
    """Returns the acceleration of the position setpoint in an interval without gaps.

    Args:
        time: (K,) times at which it is needed, s, ascending.
        setpoints: north and east (N, 2) of the setpoint, m.
        start: time of the first setpoint of the interval, s.
        end: time of the last one, s.

    Returns:
        Acceleration to the north and east (K, 2), m/s². It is 0 near both ends, where the filter would need the path
        before or after them.
    """
    grid = np.arange(start, end, GRID_STEP)
    accelerations = np.zeros((len(time), 2))
    # Both the filter and the second difference need the path on each side.
    inside = slice(SMOOTHING_RADIUS + 1, -SMOOTHING_RADIUS - 1)
    if not len(grid[inside]):
        return accelerations
    for column in range(2):
        path = np.interp(grid, setpoints.time, setpoints.values[:, column])
        # A filter that also differentiates would take the distance from home for an acceleration, since its cut-off
        # weights do not add up to 0.
        smoothed_path = scipy.ndimage.gaussian_filter1d(
            path, SMOOTHING_SECONDS / GRID_STEP, radius=SMOOTHING_RADIUS
        )
        second_difference = np.diff(smoothed_path, n=2, prepend=0.0, append=0.0)
        acceleration = second_difference[inside] / GRID_STEP**2
        accelerations[:, column] = np.interp(time, grid[inside], acceleration, left=0.0, right=0.0)
    return accelerations
