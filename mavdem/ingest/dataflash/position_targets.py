"""POSITION_TARGET_LOCAL_NED from DataFlash logs: the setpoints of position and velocity of ArduCopter's controller.

ArduCopter logs them since 4.1 in PSCN, PSCE and PSCD, one for each axis. Older messages are not read: PSC and NTUN have
had several units.
"""

from typing import NamedTuple

from mavdem.ingest.dataflash.attitude import NamedMessage
from mavdem.ingest.dataflash.tables import (
    float_table,
    messages_with_fields,
    resampled,
    with_stamps,
)
from mavdem.ingest.telemetry import Fields, Tables


class AxisTargets(NamedTuple):
    """Where the targets of one axis are logged, and what MAVLink calls them."""

    message: str
    """Name of the message."""
    fields: tuple[str, str]
    """Its fields with the target of the position, m, and of the velocity, m/s."""
    names: tuple[str, str]
    """Names of both in MAVLink."""


AXES = (
    AxisTargets("PSCD", ("TPD", "TVD"), ("z", "vz")),
    AxisTargets("PSCN", ("TPN", "TVN"), ("x", "vx")),
    AxisTargets("PSCE", ("TPE", "TVE"), ("y", "vy")),
)
"""The axes; down, which more flight modes control, comes first: the others get its stamps."""

POSITION_CONTROLLER_MESSAGES = tuple(axis.message for axis in AXES)
"""Messages of the position controller."""


def position_targets(tables: Tables) -> NamedMessage:
    """Makes POSITION_TARGET_LOCAL_NED: position, m, and velocity, m/s, in north-east-down.

    A target is NaN while its axis was not controlled. Each axis is logged in a separate message; all are interpolated
    at the stamps of the first one.

    Args:
        tables: DataFlash's messages by name.

    Returns:
        Columns x, y, z, vx, vy and vz (n,); none if no axis was logged.
    """
    columns: Fields = {}
    stamps = None
    for axis in AXES:
        logged_columns = messages_with_fields(tables, axis.message, axis.fields)
        if not logged_columns:
            continue
        if stamps is None:
            stamps = logged_columns
        targets = resampled(stamps, logged_columns, float_table(logged_columns, axis.fields))
        position_name, velocity_name = axis.names
        columns[position_name] = targets[:, 0]
        columns[velocity_name] = targets[:, 1]
    name = "/".join(POSITION_CONTROLLER_MESSAGES)
    return NamedMessage(name, {} if stamps is None else with_stamps(stamps, columns))
