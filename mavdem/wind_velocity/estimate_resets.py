"""Resets of an estimator: jumps of its velocity, yaw or position that are no motion of the vehicle."""

from typing import Any, NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.dataset.axes import HORIZONTAL
from mavdem.wind_velocity.ground_motion import HEIGHT


class ResetLimit(NamedTuple):
    """Largest change between two samples that is no reset of the estimator: offset + rate · time between them."""

    offset: float
    """Part that does not depend on the time."""

    rate: float
    """Part per second."""


VELOCITY_RESET = ResetLimit(offset=1.0, rate=15.0)
"""Limit for a component of the velocity, m/s and m/s²: no multirotor accelerates faster for long."""

YAW_RESET = ResetLimit(offset=0.35, rate=6.0)
"""Limit for the yaw, rad and rad/s. Before a reset of the yaw in flight, the yaw was not known."""

POSITION_RESET = ResetLimit(offset=1.0, rate=2.0)
"""Limit for the change of a position beyond what its velocity covers, m and m/s."""


def motion_resets(time: Array, values: Array) -> Flags:
    """Finds the resets of the estimator's velocity and position.

    Args:
        time: stamps (N,), s.
        values: velocity, height and perhaps position (N, 4 or 6), as :func:`recorded_ground_motion` returns them.

    Returns:
        Whether there is a reset between each two successive samples (N − 1,).
    """
    velocity_north, velocity_east = values[:, HORIZONTAL].T
    resets = estimate_resets(time, velocity_north, VELOCITY_RESET)
    resets |= estimate_resets(time, velocity_east, VELOCITY_RESET)
    # The columns after the height are the position north and east, which may be missing.
    positions = values[:, HEIGHT + 1 :].T
    for position, speed in zip(positions, (velocity_north, velocity_east), strict=False):
        resets |= is_position_reset(np.diff(position), speed[:-1], speed[1:], np.diff(time))
    return resets


def is_position_reset(change: Any, speed_before: Any, speed_after: Any, dt: Any) -> Any:
    """Returns whether a coordinate of the position changed by more than its velocity explains.

    All arguments are numbers, or arrays of the same shape.

    Args:
        change: change of the coordinate, m.
        speed_before: its velocity before the change, m/s.
        speed_after: its velocity after the change, m/s.
        dt: duration of the change, s.

    Returns:
        A flag, or an array of flags.
    """
    covered_distance = (speed_before + speed_after) * dt / 2
    return abs(change - covered_distance) > POSITION_RESET.offset + POSITION_RESET.rate * dt


def estimate_resets(time: Array, values: Array, limit: ResetLimit, period: float = np.inf) -> Flags:
    """Finds the resets of an estimate: changes from one sample to the next that are larger than a limit.

    Args:
        time: stamps (N,), s.
        values: (N,) in the unit of the limit.
        limit: largest change that is not a reset.
        period: period of values that are angles, in their unit; the smaller change modulo the period counts. Infinite
            for values that do not repeat.

    Returns:
        Whether there is a reset between each two successive samples (N − 1,).
    """
    changes = abs(np.diff(values)) % period
    shortest_changes = np.minimum(changes, period - changes)
    return np.asarray(shortest_changes > limit.offset + limit.rate * np.diff(time))
