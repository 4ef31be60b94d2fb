"""Attitude of a vehicle: Euler angle and body rate of each axis, from the messages that contain them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags, Integers, cumulative_integral
from mavdem.dataset.axes import AXES, MAX_ANGLE, MAX_BODY_RATE
from mavdem.dataset.time_series import (
    TimeSeries,
    clean_series,
    float_column,
    float_columns,
    message_counts,
    preferred_message,
)
from mavdem.ingest.telemetry import MIN_PREFERRED_SHARE, Columns, Telemetry, rows_by_value
from mavdem.ingest.vocabulary import euler_angles

ATTITUDE_MESSAGES = ("ATTITUDE", "ATTITUDE_QUATERNION")
"""MAVLink messages with the attitude, the preferred one first."""

TUNING_MESSAGE = "PID_TUNING"
"""MAVLink message of ArduPilot with the body rate of one axis and its setpoint."""

FIRST_TUNING_AXIS = 1
"""Number of roll in the field ``axis`` of that message (PID_TUNING_AXIS); pitch and yaw follow."""

MIN_DEGREES_RATIO = 10.0
"""Ratio of the standard deviations of a body rate and the attitude message's rate, above which it is in degrees.

A rate in degrees is 57 times as large; a choice between 1 and that.
"""

MAX_STEP_WITHOUT_OUTAGE = 3.0
"""Step between two attitudes, in median steps, above which messages were lost; a choice."""


@dataclass(frozen=True, eq=False)
class Attitude:
    """N samples of the motion about one axis, without rows that are not finite or impossible."""

    message: str
    """Name of the message from which the samples are taken."""
    time: Array
    """(N,) seconds on the clock of the sample's boot."""
    boot: Integers
    """(N,) number of the boot of each sample, from 0."""
    angle: Array
    """(N,) Euler angle, rad; the angle of yaw is unwrapped, without jumps by a turn."""
    rate: Array
    """(N,) body rate, rad/s: p of roll, q of pitch, r of yaw."""
    euler_rate: Array
    """(N,) derivative of ``angle``, rad/s, that attitude and all three body rates imply."""
    sent_count: int
    """Number of messages that were recorded."""
    unused_count: int
    """Number of those that could not be used: not finite, impossible, or a second value at the same stamp."""
    impossible_count: int
    """Number of those with an angle beyond ``MAX_ANGLE`` or a body rate beyond ``MAX_BODY_RATE``."""

    @property
    def angle_series(self) -> TimeSeries:
        """The Euler angle, rad, as a time series."""
        return TimeSeries(self.time, self.boot, self.angle)

    @property
    def rate_series(self) -> TimeSeries:
        """The body rate, rad/s, as a time series."""
        return TimeSeries(self.time, self.boot, self.rate)


def attitude_of_axis(telemetry: Telemetry, axis: str) -> Attitude | None:
    """Returns Euler angle and body rate of an axis from the fastest source that covers the flight.

    Logs of ArduPilot can have the body rate in PID_TUNING far more often than the attitude. Then the samples are those
    of PID_TUNING, and their angle is the integral of the rate, corrected by the attitudes that were sent in between.
    PID_TUNING of a telemetry stream is not used, since the message has no time stamp there.

    Args:
        telemetry: Messages of the vehicle.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The attitude; None if no attitude was recorded.
    """
    sent_attitude = attitude_from_messages(telemetry, axis)
    # In a DataFlash log the message has another name, RATE. So its MAVLink name means that it came over a link.
    is_from_link = telemetry.name_in_source(TUNING_MESSAGE) == TUNING_MESSAGE
    if sent_attitude is None or is_from_link:
        return sent_attitude
    tuning = tuning_rates(telemetry, axis, sent_attitude)
    if tuning is None:
        return sent_attitude
    counts = {sent_attitude.message: len(sent_attitude.time), TUNING_MESSAGE: len(tuning.time)}
    if preferred_message(counts) == sent_attitude.message:
        return sent_attitude
    integrated_rates = _integrated_rates(sent_attitude, tuning)
    # If the fast rates cover only a part of the flight, the slower messages are used, so that the rest is not lost.
    if integrated_rates.covered_count < MIN_PREFERRED_SHARE * len(sent_attitude.time):
        return sent_attitude
    is_selected = np.isfinite(integrated_rates.angle)
    return Attitude(
        message=TUNING_MESSAGE,
        time=tuning.time[is_selected],
        boot=tuning.boot[is_selected],
        angle=integrated_rates.angle[is_selected],
        rate=tuning.values[is_selected, 0],
        euler_rate=integrated_rates.euler_rate[is_selected],
        sent_count=tuning.sent_count,
        unused_count=tuning.unused_count,
        impossible_count=sent_attitude.impossible_count,
    )


def tuning_rates(
    telemetry: Telemetry, axis: str, sent_attitude: Attitude | None
) -> TimeSeries | None:
    """Returns the body rate of an axis and its setpoint from PID_TUNING.

    Some firmware sends them in degrees/s, some in rad/s. The unit is recognised by comparison with the standard
    deviation of the body rate in the attitude message, which is always in rad/s.

    Args:
        telemetry: Messages of the vehicle.
        axis: "roll", "pitch" or "yaw".
        sent_attitude: Attitude of the axis as it was sent; without it the rates keep their unit.

    Returns:
        Body rate and setpoint (N, 2), rad/s; None if none were recorded.
    """
    columns = telemetry.messages.get(TUNING_MESSAGE)
    if columns is None:
        return None
    rates = np.column_stack([float_column(columns, "achieved"), float_column(columns, "desired")])
    # In whichever of the two units, no body rate is larger than the limit in degrees/s.
    rates[abs(rates) > np.degrees(MAX_BODY_RATE)] = np.nan
    is_of_axis = columns["axis"] == FIRST_TUNING_AXIS + AXES.index(axis)
    tuning = clean_series(columns, rates, is_of_axis)
    if not len(tuning.time):
        return None
    if sent_attitude is None:
        return tuning
    achieved_rate = tuning.values[:, 0]
    is_in_degrees = achieved_rate.std() > MIN_DEGREES_RATIO * sent_attitude.rate.std()
    return replace(tuning, values=np.radians(tuning.values)) if is_in_degrees else tuning


# Rows that are not finite are left out at the end, so their warnings say nothing.
@np.errstate(all="ignore")
def attitude_from_messages(telemetry: Telemetry, axis: str) -> Attitude | None:
    """Returns Euler angle and body rate of an axis from ATTITUDE, or ATTITUDE_QUATERNION if that is clearly faster.

    Args:
        telemetry: Messages of the vehicle.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The attitude; None if neither message was recorded.
    """
    message = preferred_message(message_counts(telemetry, ATTITUDE_MESSAGES))
    if message is None:
        return None
    columns = telemetry.messages[message]
    roll, pitch, yaw = _euler_angles(columns, message, axis)
    roll_rate = float_column(columns, "rollspeed")
    pitch_rate = float_column(columns, "pitchspeed")
    yaw_rate = float_column(columns, "yawspeed")

    is_impossible = _exceeds_limit([roll, pitch, yaw], MAX_ANGLE) | _exceeds_limit(
        [roll_rate, pitch_rate, yaw_rate], MAX_BODY_RATE
    )
    # Kinematics of Z-Y-X Euler angles (Stevens and Lewis, "Aircraft Control and Simulation", chapter 1).
    heading_term = pitch_rate * np.sin(roll) + yaw_rate * np.cos(roll)
    if axis == "roll":
        motion = (roll, roll_rate, roll_rate + heading_term * np.tan(pitch))
    elif axis == "pitch":
        motion = (pitch, pitch_rate, pitch_rate * np.cos(roll) - yaw_rate * np.sin(roll))
    else:
        motion = (yaw, yaw_rate, heading_term / np.cos(pitch))
    table = np.column_stack(motion)
    table[is_impossible] = np.nan

    series = clean_series(columns, table)
    angle, rate, euler_rate = series.values.T
    return Attitude(
        message=message,
        time=series.time,
        boot=series.boot,
        angle=np.unwrap(angle) if axis == "yaw" else angle,
        rate=rate,
        euler_rate=euler_rate,
        sent_count=series.sent_count,
        unused_count=series.unused_count,
        impossible_count=int(np.count_nonzero(is_impossible)),
    )


def _euler_angles(columns: Columns, message: str, axis: str) -> tuple[Array, Array, Array]:
    """Returns the Euler angles of a message that has the attitude.

    Rows with an impossible value are excluded later. The yaw of ATTITUDE is read only for a model of yaw, so that a bad
    heading does not exclude rows from a model of roll or pitch. A quaternion cannot be separated in this way.

    Args:
        columns: fields of the message, N rows.
        message: ATTITUDE_QUATERNION, or another message with the fields roll, pitch and yaw in rad.
        axis: "roll", "pitch" or "yaw", the axis of the model.

    Returns:
        Roll, pitch and yaw (N,), rad; yaw is 0 where it was not read.
    """
    if message == "ATTITUDE_QUATERNION":
        roll, pitch, yaw = euler_angles(float_columns(columns, ("q1", "q2", "q3", "q4")))
        return roll, pitch, yaw
    roll = float_column(columns, "roll")
    pitch = float_column(columns, "pitch")
    yaw = float_column(columns, "yaw") if axis == "yaw" else np.zeros_like(roll)
    return roll, pitch, yaw


def down_in_body(roll: Array, pitch: Array) -> Array:
    """Returns the direction of gravity in the body frame: the third row of the rotation from body to earth.

    Args:
        roll: (…,) rad.
        pitch: (…,) rad.

    Returns:
        Unit vectors (…, 3), along body x, y and z.
    """
    components = (-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch))
    return np.stack(components, axis=-1)


def _exceeds_limit(quantities: list[Array], limit: float) -> Flags:
    """Flags the samples in which the magnitude of some quantity exceeds a limit, so that the sample is impossible.

    Args:
        quantities: N values each of one or several quantities, at least one, in the same unit.
        limit: the largest possible magnitude, in that unit.

    Returns:
        Flags (N,). A value that is not finite exceeds no limit: such a sample counts as unusable, not as impossible.
    """
    exceeds = np.zeros(len(quantities[0]), dtype=np.bool_)
    for quantity in quantities:
        magnitudes = np.abs(quantity)
        exceeds |= np.isfinite(magnitudes) & (magnitudes > limit)
    return exceeds


class _IntegratedRates(NamedTuple):
    """The attitude at the N stamps of a body rate, by integration of the rate."""

    angle: Array
    """(N,) Euler angle, rad; NaN where no attitude was sent."""
    euler_rate: Array
    """(N,) derivative of the Euler angle, rad/s."""
    covered_count: int
    """Number of attitude messages in the time that the rates cover."""


def _integrated_rates(attitude: Attitude, tuning: TimeSeries) -> _IntegratedRates:
    """Integrates a fast body rate to an Euler angle, and corrects its drift by the slower attitude messages.

    The drift is the difference between the sent angle and the integral at each attitude message. It is interpolated
    linearly between the messages and added to the integral. So the angle has the bandwidth of the fast rate, and agrees
    with the messages (a complementary filter).

    Args:
        attitude: Attitude of the axis, from the attitude messages.
        tuning: Body rate of the axis and its setpoint (N, 2), rad/s, from PID_TUNING.

    Returns:
        Angle, rad, and its derivative, rad/s, (N,) at the stamps of the body rate, for each boot separately; and the
        number of attitude messages within them. The angle is NaN before the first attitude message, after the last one,
        and in an outage of the messages.
    """
    body_rate = tuning.values[:, 0]
    angle = np.full_like(body_rate, np.nan)
    euler_rate = body_rate.copy()
    covered_count = 0
    for boot, rows in rows_by_value(attitude.boot).items():
        sent_time = attitude.time[rows]
        sent_angle = attitude.angle[rows]
        is_covered = (tuning.boot == boot) & _is_between_messages(tuning.time, sent_time)
        if not np.any(is_covered):
            continue
        time = tuning.time[is_covered]
        integral = cumulative_integral(body_rate[is_covered], np.diff(time))
        drift_at_messages = sent_angle - np.interp(sent_time, time, integral)
        angle[is_covered] = integral + np.interp(time, sent_time, drift_at_messages)
        is_in_span = (sent_time >= time[0]) & (sent_time <= time[-1])
        covered_count += int(np.count_nonzero(is_in_span))
        # The Euler rate is the body rate of the axis plus a coupling by the other two rates, which are known only at
        # the slower messages.
        coupling_at_messages = attitude.euler_rate[rows] - attitude.rate[rows]
        euler_rate[is_covered] += np.interp(time, sent_time, coupling_at_messages)
    return _IntegratedRates(angle, euler_rate, covered_count)


def _is_between_messages(time: Array, sent_time: Array) -> Flags:
    """Flags the times at which an attitude can be interpolated, since two messages without an outage surround them.

    A step of more than ``MAX_STEP_WITHOUT_OUTAGE`` times the median step between messages is an outage.

    Args:
        time: (N,) the times, s since boot.
        sent_time: (M,) stamps of the attitude messages of the same boot, s, ascending.

    Returns:
        Flags (N,); False before the first message, after the last one and within an outage.
    """
    is_in_span = (time >= sent_time[0]) & (time <= sent_time[-1])
    steps = np.diff(sent_time, append=sent_time[-1])
    is_outage = steps > MAX_STEP_WITHOUT_OUTAGE * np.median(steps)
    preceding_message = np.searchsorted(sent_time, time, side="right") - 1
    return is_in_span & ~is_outage[preceding_message]
