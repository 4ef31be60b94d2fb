"""Steadiness: where motors may be compared, for the vehicle neither turns its nose nor strays from its setpoint.

While the nose turns, wind and load pull from elsewhere, and the yaw controller works; and motors of a vehicle that does
not follow its attitude setpoint work against something else than their own weakness.
"""

from math import nan
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dataset.intervals import Intervals, intersection, true_intervals
from mavdem.dataset.phases import series_of_boot, settled_intervals
from mavdem.dataset.setpoints import held_setpoint
from mavdem.dataset.signals import Signals
from mavdem.dataset.vehicle_cache import cached_per_vehicle

TURN_SECONDS = 1.0
MAX_HEADING_CHANGE = np.radians(10.0)
"""Change of heading, rad, over so many seconds, from which the nose turns: five times what holding it in gusts takes,
half of a turn by the stick in slow flight."""
MAX_SETPOINT_ERROR = np.radians(15.0)
"""Of roll and pitch from their setpoints: half of the error from which ArduPilot's crash check counts a loss."""


class AttitudeTracking(NamedTuple):
    """The attitude of one boot and its setpoint at ``time`` (N,), s.

    Attributes:
        angles: (N, 3) roll, pitch and heading, rad, the last without jumps.
        setpoints: (N, 2) setpoints of roll and pitch, rad; NaN where there is none.
        is_rate_controlled: (N, 2) where rates of roll and pitch were asked for.
    """

    time: Array
    angles: Array
    setpoints: Array
    is_rate_controlled: Flags

    @property
    def is_straying(self) -> Flags:
        """(N,) where roll or pitch is known to be far from its setpoint."""
        return strays_from_setpoint(self.angles[:, :2], self.setpoints)

    @property
    def is_steady(self) -> Flags:
        """(N,) where it does not stray, and the nose keeps its heading."""
        heading = self.angles[:, 2]
        turned = abs(heading - np.interp(self.time - TURN_SECONDS, self.time, heading))
        return ~self.is_straying & ~(turned > MAX_HEADING_CHANGE)


def strays_from_setpoint(angles: Array, asked: Array) -> Flags:
    """Returns where angles (..., 2) of roll and pitch, rad, are known to be far from what is ``asked`` (..., 2)."""
    return (abs(angles - asked) > MAX_SETPOINT_ERROR).any(axis=-1)


@cached_per_vehicle()
def attitude_tracking(signals: Signals, boot: int) -> AttitudeTracking | None:
    """Returns the attitude of ``boot`` beside its setpoint; None where it was not recorded."""
    angles = [
        angle
        for each in signals.attitudes
        if (angle := series_of_boot(each.angle_series, boot)) is not None
    ]
    if len(angles) < len(AXES):
        return None
    time = angles[-1].time
    asked = {unit: np.full((len(time), len(TILT_AXES)), nan) for unit in ("rad", "rad/s")}
    for column, axis in enumerate(TILT_AXES):
        for setpoint in signals.for_axis(axis).setpoints:
            asked[setpoint.unit][:, column] = held_setpoint(setpoint, boot, time)
    columns = [np.interp(time, angle.time, angle.values) for angle in angles]
    return AttitudeTracking(time, np.column_stack(columns), asked["rad"], ~np.isnan(asked["rad/s"]))


@cached_per_vehicle()
def steady_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of settled flight of ``boot`` in which its motors may be compared."""
    flight = attitude_tracking(signals, boot)
    intervals = settled_intervals(signals, boot)
    return (
        intervals
        if flight is None
        else intersection(intervals, true_intervals(flight.time, flight.is_steady))
    )


def tracked_headings(signals: Signals, boot: int, time: Array) -> Array:
    """Returns the heading at ``time`` (N,), s of ``boot``, rad; NaN where the attitude strays, 0 where not recorded."""
    flight = attitude_tracking(signals, boot)
    if flight is None:
        return np.zeros(len(time))
    heading = np.where(flight.is_straying, nan, flight.angles[:, 2])
    return np.interp(time, flight.time, heading)
