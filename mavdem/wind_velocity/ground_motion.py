"""The velocity of a vehicle over ground, its height and position, from the messages of a log."""

import numpy as np

from mavdem.dataset.axes import HORIZONTAL
from mavdem.dataset.signals import CLIMB_RATE_FIELDS, Signals
from mavdem.dataset.time_series import TimeSeries, clean_series, float_column
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.ingest.telemetry import Telemetry
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
    """Returns the velocity over ground and the height, from the preferred message that was recorded.

    The position, if the message has it, is used to detect resets of the estimator, and a vehicle that is stuck.

    Args:
        telemetry: messages of the vehicle.

    Returns:
        Samples (N, 4) of the velocity north, east and down, m/s, and height, m, 0 if it is not known; or (N, 6) with
        the position north and east, m, if the message contains it. ``None`` if there is no such message.
    """
    for name, metres_per_unit in VELOCITY_MESSAGES.items():
        columns = telemetry.messages.get(name, {})
        sample_count = len(columns.get("vx", ()))
        if sample_count <= 1:
            continue
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
    return None
