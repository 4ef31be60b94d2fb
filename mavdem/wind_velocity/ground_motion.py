"""The velocity of a vehicle over ground, its height and position, from the messages of a log."""

import numpy as np

from mavdem.dataset.axes import HORIZONTAL
from mavdem.dataset.signals import CLIMB_RATE_FIELDS, Signals
from mavdem.dataset.time_series import TimeSeries, clean_series, float_column
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.ingest.telemetry import Columns, Telemetry
from mavdem.ingest.vocabulary import MILLIMETRES_PER_METRE


def _velocity_messages() -> dict[str, float]:
    """Returns the messages that have the velocity over ground, with their units.

    They are taken from the messages with a climb rate whose field is ``vz``, since these also have the horizontal
    velocity, as ``vx`` and ``vy``.

    Returns:
        By name of the message, the preferred one first: the factor that converts its velocity to m/s.
    """
    factors = {}
    for name, (field, climb_factor) in CLIMB_RATE_FIELDS.items():
        # The climb rate is positive upward, and the field vz positive downward, so that the factor of the climb rate is
        # negative.
        if field == "vz":
            factors[name] = -climb_factor
    return factors


VELOCITY_MESSAGES = _velocity_messages()
"""Messages with the velocity over ground, the preferred first, and the factor that converts it to m/s."""

VELOCITY = slice(0, 3)
"""Columns of the velocity north, east and down in the values of :func:`recorded_ground_motion`."""

MAX_VELOCITY_GAP = 1.5
"""Longest time between two velocities that are interpolated, and time around a reset that is left out, s."""

HEIGHT = 3
"""Column of the height in these values; columns after it have the position, if it was recorded."""


@cached_per_vehicle()
def horizontal_velocity(signals: Signals) -> TimeSeries | None:
    """Returns the velocity over ground (N, 2), north and east, m/s; None if it was not recorded.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
    """
    motion = recorded_ground_motion(signals.telemetry)
    if motion is None:
        return None
    # A copy does not hold the memory of the other columns.
    return TimeSeries(motion.time, motion.boot, motion.values[:, HORIZONTAL].copy())


def recorded_ground_motion(telemetry: Telemetry) -> TimeSeries | None:
    """Returns the velocity over ground and the height, from the preferred message that came often enough.

    A ground station may ask for one of the messages more often than for the other. If none came often enough
    (``MAX_VELOCITY_GAP``), the preferred one is used.

    The position, if the message has it, is used to detect resets of the estimator, and a vehicle that is stuck.

    Args:
        telemetry: messages of the vehicle.

    Returns:
        Samples (N, 4) of the velocity north, east and down, m/s, and height, m, 0 if it is not known; or (N, 6) with
        the position north and east, m, if the message contains it. ``None`` if there is no such message.
    """
    preferred_motion = None
    for name in VELOCITY_MESSAGES:
        columns = telemetry.messages.get(name, {})
        if len(columns.get("vx", ())) <= 1:
            continue
        motion = _motion_of_message(name, columns)
        interval = velocity_interval(motion)
        if interval is not None and interval <= MAX_VELOCITY_GAP:
            return motion
        if preferred_motion is None:
            preferred_motion = motion
    return preferred_motion


def velocity_interval(ground_motion: TimeSeries) -> float | None:
    """Returns the median time, s, between two recorded velocities, over all boots; None without two in one boot.

    Args:
        ground_motion: velocity and height, as :func:`recorded_ground_motion` returns them.
    """
    is_same_boot = np.diff(ground_motion.boot) == 0
    intervals_between = np.diff(ground_motion.time)[is_same_boot]
    return float(np.median(intervals_between)) if len(intervals_between) else None


def _motion_of_message(name: str, columns: Columns) -> TimeSeries:
    """Returns velocity, height and, if the message has it, position, as :func:`recorded_ground_motion` does.

    Args:
        name: name of the message, one of ``VELOCITY_MESSAGES``.
        columns: its fields.
    """
    metres_per_unit = VELOCITY_MESSAGES[name]
    if name == "LOCAL_POSITION_NED":
        height = -float_column(columns, "z")
    else:
        height = float_column(columns, "relative_alt") / MILLIMETRES_PER_METRE
    motion = [metres_per_unit * float_column(columns, field) for field in ("vx", "vy", "vz")]
    motion.append(np.nan_to_num(height))
    for field in ("x", "y"):
        if field in columns:
            motion.append(float_column(columns, field))
    is_valid = None
    if "valid" in columns:
        is_valid = np.asarray(columns["valid"], np.bool_)
    return clean_series(columns, np.column_stack(motion), is_valid)
