"""Clocks that are set while a ROS 2 recording runs: the stamps before and after are joined by the times of reception.

PX4 stamps its topics by the clock of the companion computer once both are synchronised (uXRCE-DDS): the clock jumps
from the time since boot to UNIX time, perhaps in flight. The recorder's clock continues meanwhile.

Source: https://docs.px4.io/main/en/middleware/uxrce_dds.html (UXRCE_DDS_SYNCT).
"""

from collections.abc import Mapping

import numpy as np
import scipy

from mavdem.arrays import Integers
from mavdem.facts import Facts
from mavdem.facts.sources import Repair
from mavdem.ingest.mavlink.clock_readings import MAX_STAMP_DEVIATION
from mavdem.ingest.mavlink.reference_clock import MAX_RESTART_TIME
from mavdem.ingest.mcap.records import NANOSECONDS
from mavdem.ingest.telemetry import repair_facts

ReceiveTimes = Mapping[int, int]
"""When each message was recorded, UNIX ns, by its number in the recording."""

MAX_SILENCE = 2.0
"""Longest time between two messages, s, across which a clock counts as set: an autopilot takes longer to restart."""

MAX_SILENCE_BEFORE_ZERO = 0.5
"""The same where the clock then reads nearly zero, as after a restart, s: a simulator restarts soon. A choice."""

OFFSET_WINDOW = 9
"""Number of messages around each whose median is the offset of their clock: single wrong stamps do not count."""

EDGE_MESSAGES = 50
"""Number of messages before and after a setting by which the jump is measured: a choice."""


def with_joined_clocks(
    stamps: Mapping[str, Integers], positions: Mapping[str, Integers], receive_times: ReceiveTimes
) -> tuple[dict[str, Integers], Facts]:
    """Moves the stamps after each setting of the clock to the clock before it.

    The offset of a stamp from the time of reception jumps where the clock was set. The autopilot did not restart, since
    its messages continue without a pause. The delay of a message is not changed.

    Args:
        stamps: Stamps (n,) of each topic, ns; 0 for none.
        positions: Numbers (n,) of the messages of each topic in the recording.
        receive_times: Reception time of each message.

    Returns:
        The stamps on one clock, and a fact that reports the setting if there was one.
    """
    names = [name for name, topic_stamps in stamps.items() if len(topic_stamps)]
    if not names:
        return dict(stamps), ()
    all_positions = np.concatenate([positions[name] for name in names])
    all_stamps = np.concatenate([stamps[name] for name in names])
    stamped_rows = np.argsort(all_positions, kind="stable")
    stamped_rows = stamped_rows[all_stamps[stamped_rows] > 0]
    receive_stamps = np.array(
        [receive_times[position] for position in all_positions[stamped_rows].tolist()]
    )
    ordered_stamps = all_stamps[stamped_rows]
    if not len(stamped_rows):
        return dict(stamps), ()
    # Offsets are taken from the first one, so that floats resolve them to a microsecond.
    offsets = (ordered_stamps - receive_stamps) - (ordered_stamps[0] - receive_stamps[0])
    offset_seconds = offsets / NANOSECONDS
    typical_offsets = scipy.ndimage.median_filter(offset_seconds, OFFSET_WINDOW, mode="mirror")
    shifts = np.zeros(len(stamped_rows), dtype=np.int64)
    settings_count = 0
    for row in (1 + np.flatnonzero(abs(np.diff(typical_offsets)) > MAX_STAMP_DEVIATION)).tolist():
        offset_before = np.median(offset_seconds[max(row - EDGE_MESSAGES, 0) : row])
        offset_after = np.median(offset_seconds[row : row + EDGE_MESSAGES])
        reads_nearly_zero = ordered_stamps[row] / NANOSECONDS <= MAX_RESTART_TIME
        max_silence = MAX_SILENCE_BEFORE_ZERO if reads_nearly_zero else MAX_SILENCE
        if (receive_stamps[row] - receive_stamps[row - 1]) / NANOSECONDS > max_silence:
            continue
        jump = round((offset_after - offset_before) * NANOSECONDS)
        # Around the setting a message may have been stamped before it and recorded after it.
        is_after = np.arange(len(stamped_rows)) >= row
        near_rows = slice(max(row - EDGE_MESSAGES, 0), row + EDGE_MESSAGES)
        is_after[near_rows] = abs(offset_seconds[near_rows] - offset_after) < abs(
            offset_seconds[near_rows] - offset_before
        )
        shifts[is_after] -= jump
        settings_count += 1
    joined_stamps = all_stamps.copy()
    joined_stamps[stamped_rows] += shifts
    message_counts = [len(stamps[name]) for name in names]
    stamps_of_names = np.split(joined_stamps, np.cumsum(message_counts)[:-1])
    repairs = repair_facts(Repair.CLOCK_SET, count=settings_count)
    return dict(stamps) | dict(zip(names, stamps_of_names, strict=True)), repairs
