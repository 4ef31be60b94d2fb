"""Jumps of the GPS position: fixes that are further apart than the motion before and after them explains.

An estimator's flag for a "glitch" of GPS is no jump of the position. PX4 sets it for any innovation of GPS beyond its
limit, also for the vertical velocity (``Ekf::get_ekf_soln_status``), and ArduPilot while the receiver's accuracy is
poor (``NavEKF3_core::calcGpsGoodForFlight``). So the positions themselves are looked at.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from mavdem.arrays import Array
from mavdem.dataset.intervals import TimeInterval
from mavdem.dataset.position_fix import RECEIVER_MESSAGES, has_fix_by_row
from mavdem.dataset.signals import global_positions, plane_positions
from mavdem.dataset.time_series import TimeSeries, clean_series, float_column
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import MILLIMETRES_PER_METRE

MIN_JUMP = 2.5
"""Smallest distance, m, of a jump, from which the filters of PX4 and ArduPilot reject a position.

Both accept five standard deviations of 0.5 m by default (EKF2_GPS_P_GATE and EKF2_GPS_P_NOISE, EK3_POS_I_GATE and
EK3_POSNE_M_NSE).
"""

MAX_FIX_STEP = 2.0
"""Time, s, between two fixes above which a jump may as well be a manoeuvre; receivers send at 1 Hz or more."""

NEIGHBOURING_STEPS = 5
"""Number of steps whose median velocity is that of the vehicle: a jump there and back makes two of them wrong."""

FLAG_DELAY = 2.0
"""Time, s, by which an estimator's flag may come after the jump: links send its status at 1 Hz or slower; a choice."""


@dataclass(frozen=True)
class PositionJumps:
    """The jumps of the position that the satellite receivers of one vehicle measured."""

    is_recorded: bool
    """Whether any receiver's positions were recorded."""
    time: Array
    """(N,) when each jump ended, s since boot."""
    boot: Array
    """(N,) number of the boot of each jump."""
    distance: Array
    """(N,) how far the position jumped beyond the motion of the vehicle, m."""

    def largest_in(self, boot: int, interval: TimeInterval) -> float | None:
        """Returns the largest jump in an interval of a boot or up to ``FLAG_DELAY`` before it.

        Args:
            boot: number of the boot; a boot lasts from one start of the autopilot to the next.
            interval: start and end, s since boot.

        Returns:
            The distance, m; None without a jump.
        """
        start, end = interval
        is_inside = (self.time >= start - FLAG_DELAY) & (self.time <= end)
        is_selected = (self.boot == boot) & is_inside
        return float(self.distance[is_selected].max()) if is_selected.any() else None


def position_jumps(telemetry: Telemetry) -> PositionJumps:
    """Finds the jumps in the positions of all satellite receivers of a vehicle.

    Args:
        telemetry: messages of the vehicle.

    Returns:
        Time, s since boot, number of the boot and distance, m, of each jump, receiver by receiver; and whether any
        position was recorded.
    """
    is_recorded = False
    # Tables with a row for each jump. The first one is empty, so that there is one to join without any jump.
    jump_tables = [np.zeros((0, 3))]
    for message in RECEIVER_MESSAGES:
        positions = receiver_positions(telemetry, message)
        if positions is None:
            continue
        is_recorded = True
        for boot in np.unique(positions.boot).tolist():
            jump_tables.append(_jumps_in_boot(positions, int(boot)))
    time, boot, distance = np.concatenate(jump_tables).T
    return PositionJumps(is_recorded, time, boot, distance)


def receiver_positions(telemetry: Telemetry, message: str) -> TimeSeries | None:
    """Returns the positions of one satellite receiver, relative to its first fix.

    Args:
        telemetry: messages of the vehicle.
        message: GPS_RAW_INT or GPS2_RAW.

    Returns:
        The positions (N, 2), m north and east of its first fix; None if it recorded none.
    """
    columns = telemetry.messages.get(message, {})
    if not all(field in columns for field in ("lat", "lon", "fix_type")):
        return None
    degrees, is_valid = global_positions(columns)
    is_fix = is_valid & has_fix_by_row(columns)
    if not is_fix.any():
        return None
    metres = plane_positions(degrees, origin=degrees[np.argmax(is_fix)])
    return clean_series(columns, metres, is_fix)


def receiver_altitudes(telemetry: Telemetry, message: str) -> TimeSeries | None:
    """Returns the altitudes (N,), m above sea level, of one satellite receiver's fixes; None if it recorded none.

    Args:
        telemetry: messages of the vehicle.
        message: GPS_RAW_INT or GPS2_RAW, whose field ``alt`` is in mm.
    """
    columns = telemetry.messages.get(message, {})
    if not all(field in columns for field in ("alt", "fix_type")):
        return None
    is_fix = has_fix_by_row(columns)
    if not is_fix.any():
        return None
    return clean_series(columns, float_column(columns, "alt") / MILLIMETRES_PER_METRE, is_fix)


def _jumps_in_boot(positions: TimeSeries, boot: int) -> Array:
    """Returns the jumps of one receiver's position in one boot.

    The velocity of a step is compared with the median velocity of the steps around it, so that a vehicle that speeds up
    or turns does not seem to jump. A jump must exceed ``MIN_JUMP`` plus the distance that the vehicle usually flies in
    a step, since links repeat and delay fixes.

    Args:
        positions: (N, 2) north and east, m.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        Jumps (M, 3): time after the jump, s, number of the boot, and distance, m.
    """
    positions_in_boot = positions.select(positions.boot == boot)
    intervals = np.diff(positions_in_boot.time)
    if not len(intervals):
        return np.zeros((0, 3))
    velocities = np.diff(positions_in_boot.values, axis=0) / intervals[:, None]
    usual_velocities = scipy.ndimage.median_filter(
        velocities, size=(NEIGHBOURING_STEPS, 1), mode="nearest"
    )
    unusual_speeds = np.linalg.norm(velocities - usual_velocities, axis=1)
    distances = unusual_speeds * intervals
    # After a delayed fix the next one comes early, with the motion of a usual interval in a shorter one. So at least
    # the motion of a usual interval is allowed.
    allowed_intervals = np.maximum(intervals, np.median(intervals))
    usual_distances = np.linalg.norm(usual_velocities, axis=1) * allowed_intervals
    is_jump = (distances > MIN_JUMP + usual_distances) & (intervals <= MAX_FIX_STEP)
    times_after = positions_in_boot.time[1:][is_jump]
    boots = np.full(len(times_after), boot)
    return np.column_stack([times_after, boots, distances[is_jump]])
