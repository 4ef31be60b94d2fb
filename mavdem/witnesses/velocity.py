"""Velocity as the estimator reports it: whether a vehicle lost its speed at once, as one that hits something does."""

import numpy as np

from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, clean_series, float_columns, series_of_boot
from mavdem.dataset.vehicle_cache import cached_per_vehicle

VELOCITY_MESSAGES = {"LOCAL_POSITION_NED": 1.0, "GLOBAL_POSITION_INT": 0.01}
"""Messages with the velocity over ground, the preferred one first, and the factor that converts it to m/s."""

STOP_SECONDS = 0.5
"""Time, s, within which an obstacle takes the speed of a vehicle: two samples at 4 Hz."""

STOP_SPEED = 1.5
"""Decrease of the speed, m/s, within that time that shows a stop. Thrust brakes by 5 m/s at most in it, but a
controller brakes before the vehicle knocks, and not at that moment."""

STOP_RATIO = 0.5
"""Speed after a stop relative to that before it, at most: a vehicle that only lost a propeller flies on as fast."""


@cached_per_vehicle()
def velocity(signals: Signals) -> TimeSeries | None:
    """Returns the velocity over ground as the estimator reports it, for all boots.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        (N, 3) m/s north, east and down, of the first message that has it; None if none does.
    """
    for message, factor in VELOCITY_MESSAGES.items():
        columns = signals.telemetry.messages.get(message, {})
        if all(field in columns for field in ("vx", "vy", "vz")):
            return clean_series(columns, factor * float_columns(columns, ("vx", "vy", "vz")))
    return None


def stopped_at(signals: Signals, boot: int, time: float) -> bool | None:
    """Returns whether a vehicle lost most of its speed within ``STOP_SECONDS`` around a moment, as by an impact.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        time: time of the moment, s since boot.

    Returns:
        Whether it did; None if its velocity is not known, or if it lost its speed between two samples that are too far
        apart to show whether that was at once.
    """
    series = series_of_boot(velocity(signals), boot)
    if series is None:
        return None
    is_near = abs(series.time - time) <= STOP_SECONDS
    if np.count_nonzero(is_near) < 2:
        return None
    times = series.time[is_near]
    speeds = np.linalg.norm(series.values[is_near], axis=1)
    for speed, sample_time in zip(speeds, times, strict=True):
        is_soon_after = (times >= sample_time) & (times - sample_time <= STOP_SECONDS)
        # The smallest speed soon after each sample is used, so that a rebound does not hide the stop.
        if _is_stop(speed, speeds[is_soon_after].min()):
            return True
    for index in range(len(speeds) - 1):
        step = times[index + 1] - times[index]
        # Within a long step the vehicle may have stopped at once, or may have braked.
        if step > STOP_SECONDS and _is_stop(speeds[index], speeds[index + 1]):
            return None
    return False


def _is_stop(speed: float, speed_after: float) -> bool:
    """Returns whether a change of the speed, m/s, is as large as that by an obstacle."""
    return speed - speed_after > STOP_SPEED and speed_after < STOP_RATIO * speed
