"""Clocks that are set while a ROS 2 recording runs: the stamps before and after are joined by the times of reception.

PX4 stamps its topics by the clock of the companion computer once both are synchronised (uXRCE-DDS): the clock jumps
from the time since boot to UNIX time, perhaps in flight. The recorder's clock continues meanwhile.

Source: https://docs.px4.io/main/en/middleware/uxrce_dds.html (UXRCE_DDS_SYNCT).
"""

from collections.abc import Mapping

import numpy as np
import scipy

from mavdem.arrays import Array, Integers
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
    """Undoes each setting of the autopilot's clock: the stamps after it are moved to the clock before it.

    Where the clock is set, the offset of the stamps from the times of reception jumps, but the messages continue
    without a pause, unlike at a restart of the autopilot. The jump is subtracted from all later stamps.

    Args:
        stamps: Stamps (n,) of each topic, ns; 0 for none.
        positions: Numbers (n,) of the messages of each topic in the recording.
        receive_times: When each message was recorded, UNIX ns, by its number in the recording.

    Returns:
        The stamps on one clock, and a fact that reports the setting if there was one.
    """
    names = [name for name, topic_stamps in stamps.items() if len(topic_stamps)]
    if not names:
        return dict(stamps), ()
    all_positions = np.concatenate([positions[name] for name in names])
    all_stamps = np.concatenate([stamps[name] for name in names])
    # Rows of the messages with a stamp, in the order of the recording.
    recorded_order = np.argsort(all_positions, kind="stable")
    stamped_rows = recorded_order[all_stamps[recorded_order] > 0]
    if not len(stamped_rows):
        return dict(stamps), ()
    receive_stamps = np.array(
        [receive_times[position] for position in all_positions[stamped_rows].tolist()]
    )
    shifts, settings_count = _shifts_of_stamps(all_stamps[stamped_rows], receive_stamps)
    joined_stamps = all_stamps.copy()
    joined_stamps[stamped_rows] += shifts
    message_counts = [len(stamps[name]) for name in names]
    stamps_of_names = np.split(joined_stamps, np.cumsum(message_counts)[:-1])
    repairs = repair_facts(Repair.CLOCK_SET, count=settings_count)
    return dict(stamps) | dict(zip(names, stamps_of_names, strict=True)), repairs


def _shifts_of_stamps(stamps: Integers, receive_stamps: Integers) -> tuple[Integers, int]:
    """Computes by how much each stamp must be moved so that the clock seems never to have been set.

    Args:
        stamps: Stamps (N,) of all messages in the order of the recording, ns.
        receive_stamps: Their times of reception (N,), UNIX ns.

    Returns:
        The shifts (N,), ns, and the number of settings.
    """
    # The offset between the two clocks, less that of the first message: a float has too few digits for UNIX ns.
    offsets = (stamps - receive_stamps) - (stamps[0] - receive_stamps[0])
    offset_seconds = offsets / NANOSECONDS
    # Single messages that arrive late change no median.
    typical_offsets = scipy.ndimage.median_filter(offset_seconds, OFFSET_WINDOW, mode="mirror")
    # Rows of the first message after each jump; a difference has the row of the message before it.
    jump_rows = 1 + np.flatnonzero(abs(np.diff(typical_offsets)) > MAX_STAMP_DEVIATION)
    shifts = np.zeros(len(stamps), dtype=np.int64)
    settings_count = 0
    for row in jump_rows.tolist():
        # After a longer silence the autopilot has restarted, and its clock has begun again. A clock that is near zero
        # makes a restart likely, so that a shorter silence is enough.
        silence = (receive_stamps[row] - receive_stamps[row - 1]) / NANOSECONDS
        is_near_zero = stamps[row] / NANOSECONDS <= MAX_RESTART_TIME
        max_silence = MAX_SILENCE_BEFORE_ZERO if is_near_zero else MAX_SILENCE
        is_clock_set = silence <= max_silence
        if is_clock_set:
            shifts += _shifts_by_setting(offset_seconds, row)
            settings_count += 1
    return shifts, settings_count


def _shifts_by_setting(offset_seconds: Array, row: int) -> Integers:
    """Computes by how much each stamp must be moved to undo one setting of the clock.

    A message may have been stamped before the setting and recorded after it. So within ``EDGE_MESSAGES`` of the setting
    each stamp belongs to the clock whose median offset is nearer to its own.

    Args:
        offset_seconds: Offsets (N,) of the stamps from the times of reception, s, in the order of the recording.
        row: Row of the message at which the offset jumps.

    Returns:
        The shifts (N,), ns: 0 before the setting, and minus the jump of the offset after it.
    """
    edge_start = max(row - EDGE_MESSAGES, 0)
    edge_end = row + EDGE_MESSAGES
    offset_before = np.median(offset_seconds[edge_start:row])
    offset_after = np.median(offset_seconds[row:edge_end])
    is_after = np.arange(len(offset_seconds)) >= row
    offsets_at_edge = offset_seconds[edge_start:edge_end]
    distance_before = abs(offsets_at_edge - offset_before)
    distance_after = abs(offsets_at_edge - offset_after)
    is_after[edge_start:edge_end] = distance_after < distance_before
    jump = round((offset_after - offset_before) * NANOSECONDS)
    return np.where(is_after, -jump, 0)
