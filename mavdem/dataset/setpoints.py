"""Setpoints of attitude and body rate that a controller followed, and test signals that were added to its commands.

A setpoint is a command: it holds until the next one, for ``MAX_SETPOINT_AGE`` at most. A sample therefore has the last
setpoint at or before its own stamp, on average half an interval late.

ArduPilot stamps ATTITUDE_TARGET when it sends it. PX4 stamps it with the time of its attitude setpoint: on a flight
recorded both ways the body rates in it were 0 to 8 ms newer than their stamp, 4 ms at the 95th percentile, as are those
in its ATTITUDE.

A rate setpoint is not the same everywhere. In ArduPilot's ATTITUDE_TARGET it is the rate of the attitude setpoint. In
DataFlash's RATE, and from PX4, it also corrects the error of the attitude.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.axes import AXES, MAX_BODY_RATE, TILT_AXES
from mavdem.dataset.time_series import TimeSeries, clean_series, float_column, rows_of_boot
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.telemetry import Columns, Telemetry
from mavdem.ingest.vocabulary import Injection, euler_angles, wrapped_angle

SETPOINT_MESSAGE = "ATTITUDE_TARGET"
"""MAVLink message with the setpoints of attitude and body rates."""

IGNORED_SETPOINT_BITS = {
    "roll": mavlink_constant("ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE"),
    "pitch": mavlink_constant("ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE"),
    "yaw": mavlink_constant("ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE"),
    "attitude": mavlink_constant("ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE"),
}
"""Bits of ``type_mask`` of that message by quantity: the rate about an axis or the attitude. Set: no setpoint."""

STAMP_ROUNDING = 1e-6
"""Tolerance, s, of a comparison of two times: stamps have no more digits, and grid points are rounded sums."""

MAX_SETPOINT_AGE = 2.0
"""Age, s, beyond which a setpoint holds no longer: its messages end in modes without such a setpoint. A choice."""


@dataclass(frozen=True, eq=False)
class Setpoint:
    """The recorded setpoint of one quantity of an axis."""

    name: str
    """Name for people, such as "roll rate setpoint"."""
    unit: str
    """Unit of its values: "rad" of an Euler angle, "rad/s" of a body rate."""
    message: str
    """Name of the message that it was recorded in."""
    signal: TimeSeries
    """Its values (N,)."""


class InjectedSignal(NamedTuple):
    """A known signal that the autopilot added to a command, to identify the vehicle.

    ArduCopter logs it when it is generated, and adds it in the next cycle of its loop.
    """

    injection_point: Injection
    """The command that it was added to."""
    signal: TimeSeries
    """Its values (N,): rad, rad/s, or a demand from -1 to 1."""


def recorded_setpoints(telemetry: Telemetry, axis: str) -> tuple[Setpoint, ...]:
    """Returns the setpoints of an axis in ATTITUDE_TARGET.

    Args:
        telemetry: Messages of the vehicle.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The setpoint of the body rate, rad/s, and the setpoint of the Euler angle, rad; each only if a value was
        recorded. A setpoint of yaw that is constant in the whole log is left out: it is not used, since the autopilot
        controls the rate alone.
    """
    columns = telemetry.messages.get(SETPOINT_MESSAGE)
    if columns is None:
        return ()
    # The bits of the type mask mark the setpoints of a message that the autopilot ignores.
    type_mask = columns.get("type_mask", np.zeros(len(columns["time"])))
    mask_bits = np.asarray(type_mask).astype(int)

    is_rate_ignored = mask_bits & IGNORED_SETPOINT_BITS[axis]
    rates = np.where(is_rate_ignored, np.nan, float_column(columns, f"body_{axis}_rate"))
    rates[abs(rates) > MAX_BODY_RATE] = np.nan
    rate_series = clean_series(columns, rates)
    setpoints = [Setpoint(f"{axis} rate setpoint", "rad/s", SETPOINT_MESSAGE, rate_series)]

    is_angle_ignored = mask_bits & IGNORED_SETPOINT_BITS["attitude"]
    angles = np.where(is_angle_ignored, np.nan, _euler_angle_setpoint(columns, axis))
    angle_series = clean_series(columns, angles)
    is_controlled = axis in TILT_AXES or bool(np.any(np.diff(angle_series.values)))
    if is_controlled:
        setpoints.append(Setpoint(f"{axis} setpoint", "rad", SETPOINT_MESSAGE, angle_series))
    return tuple(setpoint for setpoint in setpoints if len(setpoint.signal.time))


def _euler_angle_setpoint(columns: Columns, axis: str) -> Array:
    """Returns the Euler angle of an axis in the quaternions of ATTITUDE_TARGET.

    Args:
        columns: Fields of the message, N rows; the quaternions need not be of unit length.
        axis: "roll", "pitch" or "yaw".

    Returns:
        Angles (N,), rad; NaN in a row without a quaternion, which has zeros or NaN in its place.
    """
    quaternions = np.atleast_2d(float_column(columns, "q"))
    with np.errstate(invalid="ignore", divide="ignore"):
        lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
        return euler_angles(quaternions / lengths)[AXES.index(axis)]


def near_measured_yaw(setpoint: Setpoint, yaw: TimeSeries) -> Setpoint:
    """Returns a setpoint of yaw moved by whole turns to within half a turn of the measured yaw.

    Headings that differ by a whole turn are the same. The measured yaw is unwrapped (it has no jumps by a turn), so the
    difference of the two is the error of the heading only if the setpoint is unwrapped in the same way.

    Args:
        setpoint: setpoint of yaw, rad.
        yaw: the measured yaw, rad, unwrapped.

    Returns:
        The setpoint, unchanged in boots without a measured yaw.
    """
    series = setpoint.signal
    unwrapped_setpoint = series.values.copy()
    for boot in np.unique(series.boot):
        rows = rows_of_boot(series.boot, boot)
        yaw_of_boot = yaw.of_boot(boot)
        if not len(yaw_of_boot.time):
            continue
        measured_yaw = np.interp(series.time[rows], yaw_of_boot.time, yaw_of_boot.values)
        # The error between −π and π is the same for all setpoints that differ by whole turns.
        yaw_error = wrapped_angle(series.values[rows] - measured_yaw)
        unwrapped_setpoint[rows] = measured_yaw + yaw_error
    return replace(setpoint, signal=replace(series, values=unwrapped_setpoint))


def held_setpoint(setpoint: Setpoint, boot: int, time: Array) -> Array:
    """Returns a setpoint at given times: at each the last value that came at or before it (zero-order hold).

    Args:
        setpoint: Recorded values of the setpoint, with their times and boots.
        boot: Number of the boot that the times belong to.
        time: (T,) seconds on the clock of that boot.

    Returns:
        (T,) values in the unit of the setpoint; NaN where none came within ``MAX_SETPOINT_AGE`` before.
    """
    signal = setpoint.signal.of_boot(boot)
    # A setpoint of NaN at time −∞ is put before the first one, and is the last value of earlier times.
    stamps = np.append(-np.inf, signal.time)
    setpoint_values = np.append(np.nan, signal.values)
    # The row of the last setpoint at or before each time. Stamps are rounded, and may be that much too late.
    last_row = np.searchsorted(stamps, time + STAMP_ROUNDING, side="right") - 1
    age = time - stamps[last_row]
    still_holds = age <= MAX_SETPOINT_AGE + STAMP_ROUNDING
    return np.where(still_holds, setpoint_values[last_row], np.nan)
