"""Attitude: angle and body rate of an axis, from the messages that have them."""

from dataclasses import dataclass, replace

import numpy as np

from mavdem.arrays import Array, Integers
from mavdem.dataset.axes import AXES, MAX_ANGLE, MAX_BODY_RATE
from mavdem.dataset.time_series import (
    TimeSeries,
    clean_series,
    float_column,
    float_columns,
    message_counts,
    preferred_message,
)
from mavdem.ingest.telemetry import MIN_PREFERRED_SHARE, Telemetry, rows_by_value
from mavdem.ingest.vocabulary import euler_angles

# Messages with the attitude, the preferred first
ATTITUDE_MESSAGES = ("ATTITUDE", "ATTITUDE_QUATERNION")
TUNING_MESSAGE = "PID_TUNING"
DEGREES = 10.0  # times the rate of the attitude, from which on a rate is in degrees


@dataclass(frozen=True, eq=False)
class Attitude:
    """One axis at ``time`` (N,) s of ``boot`` (N,), from ``message``, without rows not finite or impossible."""

    message: str
    time: Array
    boot: Integers
    angle: Array  # (N,) Euler angle, rad; that of yaw without its jumps by a turn
    rate: Array  # (N,) body rate, rad/s: p for roll, q for pitch, r for yaw
    # (N,) the derivative of ``angle`` that the three body rates and the attitude imply, rad/s
    euler_rate: Array
    sent_count: int  # messages in the stream
    # those not used: not finite, impossible, or with the stamp of another. Exact copies do not count.
    unused_count: int
    # those with an angle beyond ``MAX_ANGLE`` or a body rate beyond ``MAX_BODY_RATE``
    impossible_count: int

    @property
    def angle_series(self) -> TimeSeries:
        """The angle alone."""
        return TimeSeries(self.time, self.boot, self.angle)

    @property
    def rate_series(self) -> TimeSeries:
        """The body rate alone."""
        return TimeSeries(self.time, self.boot, self.rate)


def tuning_rates(telemetry: Telemetry, axis: str, sent: Attitude | None) -> TimeSeries | None:
    """Returns body rate and its setpoint (N, 2), rad/s, from PID_TUNING; None where there are none.

    Firmware sends deg/s or rad/s, which the attitude that was ``sent`` tells, where there is one.
    """
    columns = telemetry.messages.get(TUNING_MESSAGE)
    if columns is None:
        return None
    pair = np.column_stack([float_column(columns, "achieved"), float_column(columns, "desired")])
    pair[abs(pair) > np.degrees(MAX_BODY_RATE)] = np.nan
    tuning = clean_series(columns, pair, columns["axis"] == 1 + AXES.index(axis))
    if not len(tuning.time):
        return None
    if sent is not None and tuning.values[:, 0].std() > DEGREES * sent.rate.std():
        return replace(tuning, values=np.radians(tuning.values))
    return tuning


def attitude_of_axis(telemetry: Telemetry, axis: str) -> Attitude | None:
    """Returns angle and body rate of ``axis``, with the rates of PID_TUNING where those come clearly faster throughout.

    The angle is then the integral of the rate, held to the angles sent. Only a log's PID_TUNING is taken: in
    a stream it has no stamp of its own.
    """
    sent = attitude_from_messages(telemetry, axis)
    if sent is None or telemetry.name_in_source(TUNING_MESSAGE) == TUNING_MESSAGE:
        return sent
    tuning = tuning_rates(telemetry, axis, sent)
    if tuning is None:
        return sent
    from scipy.integrate import cumulative_trapezoid  # it takes half a second to import

    lengths = {sent.message: len(sent.time), TUNING_MESSAGE: len(tuning.time)}
    if preferred_message(lengths) == sent.message:
        return sent
    rate = tuning.values[:, 0]
    angle = np.full_like(rate, np.nan)
    slope = rate.copy()
    covered = 0
    for boot, rows in rows_by_value(sent.boot).items():
        time = sent.time[rows]
        within = (tuning.boot == boot) & (tuning.time >= time[0]) & (tuning.time <= time[-1])
        steps = np.diff(time, append=time[-1])
        outages = steps > 3 * np.median(steps)
        within &= ~outages[np.searchsorted(time, tuning.time, side="right") - 1]
        if np.any(within):
            at = tuning.time[within]
            turned = cumulative_trapezoid(rate[within], at, initial=0)
            drift = sent.angle[rows] - np.interp(time, at, turned)
            angle[within] = turned + np.interp(at, time, drift)
            covered += int(np.count_nonzero((time >= at[0]) & (time <= at[-1])))
            slope[within] += np.interp(at, time, sent.euler_rate[rows] - sent.rate[rows])
    # What is flown without these rates is not to be lost.
    if covered < MIN_PREFERRED_SHARE * len(sent.time):
        return sent
    kept = np.isfinite(angle)
    return Attitude(
        TUNING_MESSAGE,
        tuning.time[kept],
        tuning.boot[kept],
        angle[kept],
        rate[kept],
        slope[kept],
        tuning.sent_count,
        tuning.unused_count,
        sent.impossible_count,
    )


@np.errstate(all="ignore")  # rows that are not finite are left out at the end
def attitude_from_messages(telemetry: Telemetry, axis: str) -> Attitude | None:
    """Returns that of ATTITUDE or, where it is clearly faster, ATTITUDE_QUATERNION."""
    message = preferred_message(message_counts(telemetry, ATTITUDE_MESSAGES))
    if message is None:
        return None
    columns = telemetry.messages[message]
    if message == "ATTITUDE_QUATERNION":
        roll, pitch, yaw = euler_angles(float_columns(columns, ("q1", "q2", "q3", "q4")))
    else:
        roll = float_column(columns, "roll")
        pitch = float_column(columns, "pitch")
        yaw = float_column(columns, "yaw") if axis == "yaw" else np.zeros_like(roll)
    p, q, r = (float_column(columns, field) for field in ("rollspeed", "pitchspeed", "yawspeed"))
    sizes = np.abs([roll, pitch, yaw, p, q, r])
    limits = np.repeat([MAX_ANGLE, MAX_BODY_RATE], 3)
    impossible = (np.isfinite(sizes) & (sizes > limits[:, None])).any(axis=0)
    # Z-Y-X Euler kinematics (any flight dynamics text, e.g. Stevens and Lewis, chapter 1).
    turning = q * np.sin(roll) + r * np.cos(roll)
    motion = {
        "roll": (roll, p, p + turning * np.tan(pitch)),
        "pitch": (pitch, q, q * np.cos(roll) - r * np.sin(roll)),
        "yaw": (yaw, r, turning / np.cos(pitch)),
    }
    table = np.column_stack(motion[axis])
    table[impossible] = np.nan
    kept = clean_series(columns, table)
    angle, rate, slope = kept.values.T
    if axis == "yaw":
        angle = np.unwrap(angle)
    far_out = int(np.count_nonzero(impossible))
    return Attitude(
        message,
        kept.time,
        kept.boot,
        angle,
        rate,
        slope,
        kept.sent_count,
        kept.unused_count,
        far_out,
    )
