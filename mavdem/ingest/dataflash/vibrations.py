"""Vibration of the IMUs and clipped samples in DataFlash logs (VIBE), as VIBRATION."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.dataflash.tables import (
    float_table,
    message_count,
    messages_with_fields,
    rows_of_instance,
    with_stamps,
)
from mavdem.ingest.mavlink.dialect import definitions_by_name
from mavdem.ingest.telemetry import Columns, Tables, selected_rows

VIBRATION_FIELDS = ("VibeX", "VibeY", "VibeZ")
"""Fields of VIBE with the standard deviations of an IMU's acceleration, m/s²."""

MAX_IMUS = sum("clipping" in name for name in definitions_by_name()["VIBRATION"].fields)
"""Number of IMUs: VIBRATION has a counter of clips for each."""


def vibration(tables: Tables) -> Columns:
    """Makes VIBRATION from VIBE, which is logged as one message per IMU, or of the first IMU alone in older versions.

    Row i of the result joins the i-th messages of all IMUs. If the log ends before the last message of some IMU, the
    others are cut to its length.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").

    Returns:
        Columns (N,): standard deviations of the first IMU's acceleration on its axes, m/s², and each IMU's counter of
        clips, the samples beyond the range of the accelerometer. Besides the message's fields there is ``levels`` (N, 3
        k), the deviations of all k IMUs. Empty if VIBE was not logged, or of no IMU that there can be.
    """
    logged_columns = messages_with_fields(tables, "VIBE", VIBRATION_FIELDS)
    if not logged_columns:
        return {}
    imus = _vibration_by_imu(logged_columns)
    if not imus:
        return {}
    levels = np.column_stack([float_table(imu, VIBRATION_FIELDS) for imu in imus])
    fields = {
        "vibration_x": levels[:, 0],
        "vibration_y": levels[:, 1],
        "vibration_z": levels[:, 2],
    }
    for number in range(MAX_IMUS):
        fields[f"clipping_{number}"] = _clip_counter(imus, number)
    return with_stamps(imus[0], {**fields, "levels": levels})


def _vibration_by_imu(vibe: Columns) -> list[Columns]:
    """Splits the vibration message VIBE by IMU, so that each IMU has the same number of rows.

    ArduPilot logs the messages of all IMUs in the same step. If the log ends within a step, the longer tables are cut.

    Args:
        vibe: All rows of VIBE, at least one; without a field ``IMU``, as in older versions, all are of the first IMU.

    Returns:
        The rows of each IMU, in the order of their numbers; row i of each was logged in the same step. Empty if all
        numbers are damaged.
    """
    possible_imus = MAX_IMUS if "IMU" in vibe else 1
    imus = []
    for number in range(possible_imus):
        imu = rows_of_instance(vibe, "IMU", number)
        if imu:
            imus.append(imu)
    common_count = min(map(message_count, imus), default=0)
    return [selected_rows(imu, np.arange(common_count)) for imu in imus]


def _clip_counter(imus: Sequence[Columns], number: int) -> NDArray[Any]:
    """Returns how many samples of one IMU's accelerometer were beyond its range so far (clips).

    Args:
        imus: The rows of VIBE by IMU, N of each.
        number: Number of the IMU, from 0.

    Returns:
        The counter of clips (N,) at each row; zeros if the IMU has no counter.
    """
    if "Clip" in imus[0]:
        # Each IMU's messages have its own counter.
        if number < len(imus):
            return imus[number]["Clip"]
    elif f"Clip{number}" in imus[0]:
        # In older versions of ArduPilot one message has the counters of all IMUs.
        return imus[0][f"Clip{number}"]
    return np.zeros(message_count(imus[0]))
