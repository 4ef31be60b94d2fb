"""Attitudes that are not numbers in flight, as facts (coded findings): the autopilot's estimator has failed.

Messages go on, so that no gap shows it; and nothing that needs an attitude can be judged meanwhile.
"""

from collections.abc import Iterator
from math import isfinite

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.dataset.intervals import TimeInterval, true_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import float_column, float_columns
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.facts import Fact
from mavdem.facts.ending import MotionEvent

MIN_INVALID_SECONDS = 1.0
"""Time, s, for which attitudes must be no numbers to count: damaged messages are single ones. A choice."""

ANGLE_FIELDS = {
    "ATTITUDE": ("roll", "pitch", "yaw"),
    "ATTITUDE_QUATERNION": ("q1", "q2", "q3", "q4"),
}
"""Fields of the angles or of the quaternion in each of the ``ATTITUDE_MESSAGES``."""


def invalid_attitudes(signals: Signals, boot: int, flight_interval: TimeInterval) -> Iterator[Fact]:
    """Yields an event for each time in a flight in which no message had an attitude of numbers.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.

    Yields:
        Events without an end where the attitude is never a number again.
    """
    if not _has_invalid_attitudes(signals):
        return
    time, is_valid = _validity_in_flight(signals, boot, flight_interval)
    if not len(time):
        return
    for start, end in true_intervals(time, ~is_valid):
        # Intervals at the ends of the record are infinite.
        start = max(start, float(time[0]))
        if min(end, float(time[-1])) - start >= MIN_INVALID_SECONDS:
            yield Fact(
                MotionEvent.ATTITUDE_INVALID,
                time=start,
                end_time=end if isfinite(end) else None,
                boot=boot,
            )


def _validity_in_flight(
    signals: Signals, boot: int, flight_interval: TimeInterval
) -> tuple[Array, Flags]:
    """Returns at which samples of a flight the attitude consists of numbers, over all messages that have one.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.

    Returns:
        (N,) times of the samples, s since boot, ascending; and (N,) flags.
    """
    times = [np.empty(0)]
    is_valid = [np.empty(0, bool)]
    for name in ATTITUDE_MESSAGES:
        columns = signals.telemetry.messages.get(name, {})
        if not all(field in columns for field in ANGLE_FIELDS[name]):
            continue
        start, end = flight_interval
        is_in_flight = columns["boot"] == boot
        is_in_flight &= (columns["time"] >= start) & (columns["time"] <= end)
        angles = float_columns(columns, ANGLE_FIELDS[name])[is_in_flight]
        times.append(columns["time"][is_in_flight])
        is_valid.append(np.isfinite(angles).all(axis=1))
    time = np.concatenate(times)
    order = np.argsort(time, kind="stable")
    return time[order], np.concatenate(is_valid)[order]


@cached_per_vehicle()
def _has_invalid_attitudes(signals: Signals) -> bool:
    """Returns whether any logged attitude has an angle that is not a number.

    Most logs have none. The result is kept, so that each flight of such a log need not be searched.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
    """
    for name in ATTITUDE_MESSAGES:
        columns = signals.telemetry.messages.get(name, {})
        for field in ANGLE_FIELDS[name]:
            if field in columns and not np.isfinite(float_column(columns, field)).all():
                return True
    return False
