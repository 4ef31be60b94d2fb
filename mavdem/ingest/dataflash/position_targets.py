"""POSITION_TARGET_LOCAL_NED from DataFlash logs: the setpoints of position and velocity of ArduCopter's controller.

ArduCopter logs them since 4.1 in PSCN, PSCE and PSCD, one for each axis. Older messages are not read: PSC and NTUN have
had several units.
"""

from typing import NamedTuple

from mavdem.ingest.dataflash.attitude import NamedMessage
from mavdem.ingest.dataflash.tables import float_table, messages_with_fields, resampled, with_stamps
from mavdem.ingest.telemetry import Fields, Tables


class AxisFields(NamedTuple):
    """Where the targets of one axis are logged, and what MAVLink calls them."""

    message: str
    """Name of the message."""
    logged_fields: tuple[str, str]
    """Its fields with the target of the position, m, and of the velocity, m/s."""
    mavlink_fields: tuple[str, str]
    """Names of both in MAVLink."""


FIELDS_OF_AXES = (
    AxisFields("PSCD", ("TPD", "TVD"), ("z", "vz")),
    AxisFields("PSCN", ("TPN", "TVN"), ("x", "vx")),
    AxisFields("PSCE", ("TPE", "TVE"), ("y", "vy")),
)
"""Fields of each axis; down, which more flight modes control, comes first: the others get its stamps."""

POSITION_CONTROLLER_MESSAGES = tuple(axis.message for axis in FIELDS_OF_AXES)
"""Messages of the position controller."""


def position_targets(tables: Tables) -> NamedMessage:
    """Makes POSITION_TARGET_LOCAL_NED: position, m, and velocity, m/s, in north-east-down.

    Each axis is logged in a separate message. All are interpolated at the stamps of the first axis that was logged, and
    are NaN while the axis was not controlled. An axis that was not logged has no columns.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").

    Returns:
        Columns x, y, z, vx, vy and vz (n,) if they were logged, with the name of the messages in the log.
    """
    columns: Fields = {}
    first_logged_axis = None
    for axis in FIELDS_OF_AXES:
        logged_columns = messages_with_fields(tables, axis.message, axis.logged_fields)
        if not logged_columns:
            continue
        if first_logged_axis is None:
            first_logged_axis = logged_columns
        logged_targets = float_table(logged_columns, axis.logged_fields)
        targets = resampled(first_logged_axis, logged_columns, logged_targets)
        position_field, velocity_field = axis.mavlink_fields
        columns[position_field] = targets[:, 0]
        columns[velocity_field] = targets[:, 1]
    name = "/".join(POSITION_CONTROLLER_MESSAGES)
    if first_logged_axis is None:
        return NamedMessage(name, {})
    return NamedMessage(name, with_stamps(first_logged_axis, columns))
