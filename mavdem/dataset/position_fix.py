"""Position fixes: whether a satellite receiver, or another sensor, supplied the estimator with the position.

Without one, an estimator integrates accelerations, so that its velocity runs away, and some report it as valid.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array, Flags
from mavdem.dataset.time_series import float_column
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.telemetry import Columns, Telemetry

FIX_3D = mavlink_constant("GPS_FIX_TYPE_3D_FIX")
"""The least GPS fix type with a position in three dimensions."""

MIN_FIX_SATELLITES = 4
"""Number of satellites that a position in three dimensions and the receiver's clock need at least."""

MAX_FIX_SECONDS = 5.0
"""Time, s, for which a receiver's last message counts beside another one that goes on: a choice; they send at 1 Hz or
more, but over slow links less often."""

MAX_USUAL_STEPS = 5.0
"""Number of a receiver's usual steps that may pass without a message, on links that lose some: a choice."""

UNKNOWN_SATELLITES = 255
"""Value of ``satellites_visible`` where the number is not known: UINT8_MAX, by MAVLink's common.xml."""

UNKNOWN_DILUTION = 65535
"""Value of ``eph`` where the dilution is not known: UINT16_MAX, by MAVLink's common.xml."""

RECEIVER_MESSAGES = ("GPS_RAW_INT", "GPS2_RAW")
"""Messages of the satellite receivers."""

RECEIVER_PARAMETERS = ("GPS_TYPE", "GPS1_TYPE", "GPS_TYPE2", "GPS2_TYPE")
"""ArduPilot's parameters with the type of each receiver, 0 for none; the names changed in 4.6."""

OTHER_SOURCE_PARAMETERS = ("FLOW_TYPE", "FLOW_ENABLE", "VISO_TYPE", "BCN_TYPE", "EXT_NAV_TYPE")
"""ArduPilot's parameters of sensors that measure velocity or position without satellites, 0 for none."""


def has_fix_by_row(columns: Columns) -> Flags:
    """Flags the messages of a satellite receiver that have a three-dimensional position fix.

    Args:
        columns: Fields of GPS_RAW_INT or GPS2_RAW.

    Returns:
        Flags (N,).
    """
    fix_types = np.asarray(columns["fix_type"])
    if "satellites_visible" not in columns:
        return fix_types >= FIX_3D
    return is_position_fix(fix_types, float_column(columns, "satellites_visible"))


def is_position_fix(fix_types: NDArray[Any], satellites: Array) -> Flags:
    """Flags messages of a satellite receiver that have a three-dimensional position fix, with enough satellites.

    Args:
        fix_types: Types of the fix (N,), GPS_FIX_TYPE.
        satellites: Numbers of satellites (N,). An unknown number, infinite or NaN, does not contradict a fix.

    Returns:
        Flags (N,).
    """
    has_enough = (satellites >= MIN_FIX_SATELLITES) | ~np.isfinite(satellites)
    return (fix_types >= FIX_3D) & has_enough


def has_receiver(telemetry: Telemetry) -> bool:
    """Returns whether a log has messages of a satellite receiver, with a fix or without."""
    return any(
        len(telemetry.messages.get(message, {}).get("fix_type", ()))
        for message in RECEIVER_MESSAGES
    )


def has_position_fix(telemetry: Telemetry, boot: int, time: Array) -> Flags:
    """Returns at which times of a boot some satellite receiver had a three-dimensional fix.

    The last message of a receiver is valid until its next one. But a receiver that is silent for longer than its usual
    gap does not count while another one continues. If no receiver was recorded, one with a fix is assumed, unless the
    parameters show that the vehicle has none.

    Args:
        telemetry: Messages of the vehicle.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.
        time: Times (T,) in that boot, s.

    Returns:
        Flags (T,).
    """
    receivers = []
    for message in RECEIVER_MESSAGES:
        receiver = _receiver_fixes(telemetry.messages.get(message, {}), boot, time)
        if receiver is not None:
            receivers.append(receiver)
    if not receivers:
        return np.full(len(time), not _has_no_receiver(telemetry))
    has_fix: Flags = np.any([receiver.has_fix for receiver in receivers], axis=0)
    # Whether some receiver is not silent, and whether one of those has a fix.
    is_any_recent: Flags = np.any([receiver.is_recent for receiver in receivers], axis=0)
    has_recent_fix: Flags = np.any(
        [receiver.has_fix & receiver.is_recent for receiver in receivers], axis=0
    )
    return np.where(is_any_recent, has_recent_fix, has_fix)


class _ReceiverFixes(NamedTuple):
    """What the valid message of one satellite receiver shows at each of T times."""

    has_fix: Flags
    """Whether the message has a three-dimensional position fix (T,)."""
    is_recent: Flags
    """Whether the receiver is not silent for longer than its usual gap (T,)."""


def _receiver_fixes(columns: Columns, boot: int, time: Array) -> _ReceiverFixes | None:
    """Returns at which times of a boot a satellite receiver had a fix, by its last message.

    Args:
        columns: Fields of the receiver's messages, N rows; empty if they were not recorded.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.
        time: Times (T,) in that boot, s. Before the first message, that message is valid.

    Returns:
        Whether it had a fix, and whether the message is recent; None if it sent no fix in that boot.
    """
    if "fix_type" not in columns:
        return None
    rows = np.flatnonzero(columns["boot"] == boot)
    if not len(rows):
        return None
    rows_by_time = rows[np.argsort(columns["time"][rows], kind="stable")]
    message_time = columns["time"][rows_by_time]
    message_has_fix = has_fix_by_row(columns)[rows_by_time]
    # Index of the last message up to each time, or of the first message before it.
    messages_so_far = np.searchsorted(message_time, time, side="right")
    valid_message = np.maximum(messages_so_far - 1, 0)
    seconds_since_message = time - message_time[valid_message]
    return _ReceiverFixes(
        has_fix=message_has_fix[valid_message],
        is_recent=seconds_since_message <= _longest_usual_gap(message_time),
    )


def _longest_usual_gap(time: Array) -> float:
    """Returns the longest time between messages (N,) of a receiver that sends, s: some of its usual steps."""
    if len(time) < 2:
        return MAX_FIX_SECONDS
    return max(MAX_FIX_SECONDS, MAX_USUAL_STEPS * float(np.median(np.diff(time))))


def measures_velocity(telemetry: Telemetry, boot: int, time: Array) -> Flags:
    """Returns at which times the estimator's velocity is supported by a sensor of velocity or position.

    PX4 itself reports when its velocity is not valid, so that all of it counts. ArduPilot sometimes reports a velocity
    as valid without any such sensor.

    Args:
        telemetry: Messages of the vehicle.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.
        time: Times (T,) in that boot, s.

    Returns:
        Flags (T,).
    """
    if telemetry.autopilot == "PX4" or has_other_position_source(telemetry):
        return np.ones(len(time), np.bool_)
    return has_position_fix(telemetry, boot, time)


def has_other_position_source(telemetry: Telemetry) -> bool:
    """Returns whether ArduPilot's parameters set up a sensor of velocity or position other than satellites."""
    return any(telemetry.parameters.get(name) for name in OTHER_SOURCE_PARAMETERS)


def most_satellites(telemetry: Telemetry) -> int | None:
    """Returns the largest number of satellites that a receiver reported; None if no number is known.

    Args:
        telemetry: messages of the vehicle.
    """
    largest_count = None
    for message in RECEIVER_MESSAGES:
        columns = telemetry.messages.get(message, {})
        if "satellites_visible" not in columns:
            continue
        counts = float_column(columns, "satellites_visible")
        is_known = np.isfinite(counts) & (counts < UNKNOWN_SATELLITES)
        if is_known.any():
            largest_count = max(largest_count or 0, int(counts[is_known].max()))
    return largest_count


def _has_no_receiver(telemetry: Telemetry) -> bool:
    """Returns whether the parameters say that no satellite receiver is set up."""
    types = [
        telemetry.parameters[name] for name in RECEIVER_PARAMETERS if name in telemetry.parameters
    ]
    return bool(types) and not any(types)
