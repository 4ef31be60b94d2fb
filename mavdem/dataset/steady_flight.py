"""Steady flight, in which motors can be compared: the vehicle follows its attitude setpoint and keeps its heading.

While the heading turns, the direction of wind and load changes relative to the vehicle, and the yaw controller works.
The motors of a vehicle that does not follow its attitude setpoint work against something else than their own weakness.
"""

from math import nan
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.dataset.axes import AXES, TILT_AXES, TILT_COLUMNS, YAW
from mavdem.dataset.intervals import Intervals, intersection, true_intervals
from mavdem.dataset.phases import settled_intervals
from mavdem.dataset.setpoints import held_setpoint
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import series_of_boot
from mavdem.dataset.vehicle_cache import cached_per_vehicle

HEADING_CHANGE_SECONDS = 1.0
"""Seconds over which the change of heading is measured."""

MAX_HEADING_CHANGE = np.radians(10.0)
"""Change of heading, rad, over ``HEADING_CHANGE_SECONDS``, above which the vehicle turns.

It is five times what holding the heading in gusts takes, and half of a turn by the stick in slow flight.
"""

MAX_SETPOINT_ERROR = np.radians(15.0)
"""Deviation, rad, of roll or pitch from its setpoint, above which the vehicle does not follow it.

It is half of the error from which ArduPilot's crash check counts.
"""


class AttitudeTracking(NamedTuple):
    """Attitude and attitude setpoint of one boot at N times."""

    time: Array
    """(N,) seconds on the clock of the boot."""
    angles: Array
    """(N, 3) roll, pitch and heading, rad; the heading is unwrapped."""
    setpoints: Array
    """(N, 2) setpoints of roll and pitch, rad; NaN where there is none."""
    is_rate_controlled: Flags
    """(N, 2) whether the rate of roll or pitch had a setpoint."""

    @property
    def is_far_off(self) -> Flags:
        """(N,) whether roll or pitch is known to be far from its setpoint."""
        return is_far_from_setpoint(self.angles[:, TILT_COLUMNS], self.setpoints)

    @property
    def is_steady(self) -> Flags:
        """(N,) whether the vehicle is near its setpoint and does not turn."""
        heading = self.angles[:, YAW]
        earlier_heading = np.interp(self.time - HEADING_CHANGE_SECONDS, self.time, heading)
        is_turning = abs(heading - earlier_heading) > MAX_HEADING_CHANGE
        return ~self.is_far_off & ~is_turning


def is_far_from_setpoint(angles: Array, setpoints: Array) -> Flags:
    """Flags the samples in which roll or pitch is far from its setpoint.

    Args:
        angles: (..., 2) angles of roll and pitch, rad; the leading dimensions are free.
        setpoints: (..., 2) setpoints of these angles, rad; NaN where there is none.

    Returns:
        Flags (...): whether one of the two is further than ``MAX_SETPOINT_ERROR`` from its setpoint.
    """
    return (abs(angles - setpoints) > MAX_SETPOINT_ERROR).any(axis=-1)


@cached_per_vehicle()
def attitude_tracking(signals: Signals, boot: int) -> AttitudeTracking | None:
    """Returns the attitude of a boot and its setpoint, at the stamps of the heading.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        Angles (N, 3) and setpoints of roll and pitch (N, 2), rad, NaN where there is no setpoint; and whether roll and
        pitch are controlled by rate (N, 2). None if the attitude was not recorded.
    """
    recorded_angles = []
    for attitude in signals.attitudes:
        angle = series_of_boot(attitude.angle_series, boot)
        if angle is not None:
            recorded_angles.append(angle)
    if len(recorded_angles) < len(AXES):
        return None
    # The heading, which is the yaw, is the last of the three angles.
    time = recorded_angles[-1].time
    angles = [np.interp(time, angle.time, angle.values) for angle in recorded_angles]
    angle_setpoints = np.full((len(time), len(TILT_AXES)), nan)
    rate_setpoints = np.full((len(time), len(TILT_AXES)), nan)
    for axis_column, axis in enumerate(TILT_AXES):
        for setpoint in signals.for_axis(axis).setpoints:
            setpoint_values = held_setpoint(setpoint, boot, time)
            if setpoint.unit == "rad":
                angle_setpoints[:, axis_column] = setpoint_values
            else:
                rate_setpoints[:, axis_column] = setpoint_values
    return AttitudeTracking(
        time=time,
        angles=np.column_stack(angles),
        setpoints=angle_setpoints,
        is_rate_controlled=~np.isnan(rate_setpoints),
    )


@cached_per_vehicle()
def steady_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals in which motors may be compared with each other: settled flight that is steady too.

    Settled flight has neither take-off nor landing. In a manoeuvre motors differ on purpose; in steady flight the
    vehicle follows its attitude setpoint and keeps its heading. Without a recorded attitude all settled flight counts
    as steady.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        Intervals, s since boot.
    """
    tracking = attitude_tracking(signals, boot)
    settled_spans = settled_intervals(signals, boot)
    if tracking is None:
        return settled_spans
    return intersection(settled_spans, true_intervals(tracking.time, tracking.is_steady))


def lean_at(signals: Signals, boot: int, time: Array) -> Array:
    """Returns roll and pitch of a vehicle at given times, linearly interpolated.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.
        time: (N,) seconds on the clock of that boot.

    Returns:
        (N, 2) roll and pitch, rad; all NaN if no attitude was recorded in this boot.
    """
    tracking = attitude_tracking(signals, boot)
    if tracking is None:
        return np.full((len(time), len(TILT_AXES)), nan)
    tilts = tracking.angles[:, TILT_COLUMNS].T
    return np.column_stack([np.interp(time, tracking.time, tilt) for tilt in tilts])


def tracked_headings(signals: Signals, boot: int, time: Array) -> Array:
    """Returns the heading of a vehicle at given times, if its attitude follows the setpoint then.

    Callers compare motors only at times with a heading that is not NaN. Without a recorded attitude it is not known
    when the vehicle is far from its setpoint: then no time is excluded, and the heading is 0.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.
        time: (N,) seconds on the clock of that boot.

    Returns:
        (N,) headings, rad, unwrapped: NaN where roll or pitch is far from its setpoint; all 0 if no attitude was
        recorded in this boot.
    """
    tracking = attitude_tracking(signals, boot)
    if tracking is None:
        return np.zeros(len(time))
    heading = np.where(tracking.is_far_off, nan, tracking.angles[:, YAW])
    return np.interp(time, tracking.time, heading)
