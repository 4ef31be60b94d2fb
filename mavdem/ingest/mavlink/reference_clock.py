"""The reference of a boot clock: the message type by whose stamps wraps of its counter and restarts are found.

Stamps normally rise. They fall if a message was damaged or came late, if the counter wrapped, or if the autopilot
restarted.
"""

from collections.abc import Sequence

import numpy as np
import scipy

from mavdem.facts import Facts
from mavdem.facts.sources import Repair
from mavdem.ingest.mavlink.clock_readings import (
    MIN_REFERENCE_STAMPS,
    ClockReadings,
    MessageStamps,
    Rows,
    Times,
    outlier_stamps,
    stamped_messages,
)
from mavdem.ingest.telemetry import repair_facts

MIN_RESET_STAMPS = 5
"""Number of successive stamps that are all lower than before after a reset of the clock; fewer are late arrivals."""

MIN_RESET_STEP = 1.0
"""Time, s, by which a clock falls at least when it was reset; less is reordering of messages."""

MAX_RESTART_TIME = 60.0
"""Time, s, that a boot clock reads at most when the first messages arrive after a restart.

A choice: an autopilot sends within some seconds, and its radio is there within some more.
"""

MAX_LATE_SECONDS = 10.0
"""Time, s, by which messages come late at most, over a second link. A choice: 3 s were seen."""

MIN_STAMPS_FRACTION = 0.5
"""Least number of stamps while a restarted clock rises, as a fraction of those of this time at the usual rate.

A choice: links lose less, and messages that only a second link brought are those that the first one lost.
"""

MAX_WRAP_GAP = 60.0
"""Longest silence, s, across which a 32-bit reference clock counts as wrapped; after a longer one, as restarted."""

REFERENCES = (
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT",
    "SYSTEM_TIME",
)
"""Message types that the autopilot itself stamps, often; the first of these that was sent is the reference."""


def reference_type_of(message_types: Sequence[MessageStamps]) -> MessageStamps | None:
    """Chooses the message type to whose clock all others are compared.

    It is the first of ``REFERENCES`` with enough stamps, or otherwise the type with most stamps. In the second case
    types whose counter has 32 bits, and so a finite period after which it starts again, are preferred: a stamp of 64
    bits may be UNIX time instead of the time since boot.

    Args:
        message_types: The messages of a component by type.

    Returns:
        The type; None if no message has a stamp.
    """
    types_by_name = {message_type.message: message_type for message_type in message_types}
    for name in REFERENCES:
        if name in types_by_name and _stamp_count(types_by_name[name]) >= MIN_REFERENCE_STAMPS:
            return types_by_name[name]
    stamp_counts = {}
    for message_type in message_types:
        count = _stamp_count(message_type)
        if count:
            stamp_counts[message_type.message] = count
    if not stamp_counts:
        return None
    candidates = [name for name in stamp_counts if np.isfinite(types_by_name[name].period)]
    if not candidates:
        candidates = list(stamp_counts)
    most_stamped = max(candidates, key=lambda name: stamp_counts[name])
    return types_by_name[most_stamped]


def _stamp_count(message_type: MessageStamps) -> int:
    """Returns how many messages of a type have a stamp."""
    positions, _ = stamped_messages(message_type)
    return len(positions)


def reference_readings(reference_type: MessageStamps) -> tuple[ClockReadings, Facts]:
    """Computes the time since boot and the number of the boot for each message of the reference type, by its stamps.

    Stamps normally rise. They fall for one of three reasons, which are handled in this order. A damaged stamp far from
    the others is an outlier, and is removed. Where the counter wrapped to 0 after its period, the stamp plus one period
    is shortly after the stamp before it. Every other fall is a restart of the autopilot, which begins another boot.
    Finally the wraps are counted again within each boot.

    Args:
        reference_type: The messages of the reference type and their stamps.

    Returns:
        Stream position, time, s, and boot of its messages without outliers; and facts that report the
        number of outliers, whether wraps were undone, and the number of reboots.
    """
    name = reference_type.message
    period = reference_type.period
    positions, stamps = stamped_messages(reference_type)
    is_outlier = outlier_stamps(stamps)
    positions = positions[~is_outlier]
    stamps = stamps[~is_outlier]
    wraps = _wrap_counts(stamps, period)
    has_wraps = wraps.any()
    # Without a wrap the period may be infinite, and must not be multiplied by 0.
    time = stamps + period * wraps if has_wraps else stamps
    reboot_rows = _reboot_rows(time)
    # Number of reboots up to each row.
    boot = np.cumsum(np.bincount(reboot_rows, minlength=len(positions)))
    if has_wraps:
        # A counter starts again at each boot, so only the wraps since the boot's first message are added.
        boot_start_rows = np.concatenate([[0], reboot_rows])
        wraps_before_boot = wraps[boot_start_rows][boot]
        time = stamps + period * (wraps - wraps_before_boot)
    repairs = repair_facts(Repair.STAMPS_IGNORED, count=np.count_nonzero(is_outlier), name=name)
    if has_wraps:
        repairs += repair_facts(Repair.CLOCK_WRAPPED, name=name, period=period)
    if len(reboot_rows):
        last_time = time[reboot_rows[0] - 1]
        repairs += repair_facts(Repair.LOG_OF_SEVERAL_BOOTS, count=len(reboot_rows), time=last_time)
    return ClockReadings(positions, time, boot), repairs


def _wrap_counts(stamps: Times, period: float) -> Rows:
    """Counts how often the counter of a clock has wrapped up to each message, that is, started again at 0.

    It has wrapped where the clock falls, but with one period added would have risen by a short time.

    Args:
        stamps: Stamps (n,), s, in the order of the stream.
        period: Time after which the counter wraps, s; infinite if it never does.

    Returns:
        Numbers of wraps (n,).
    """
    steps = np.diff(stamps)
    has_wrapped = (steps < 0) & (steps + period <= MAX_WRAP_GAP)
    # Nothing is known before the first message.
    return np.cumsum(np.concatenate([[0], has_wrapped])[: len(stamps)])


def _reboot_rows(time: Times) -> Rows:
    """Finds the rows at which a clock restarted: it fell to nearly zero, and rises again from there.

    A message that arrives late has a low stamp too, but those after it are high again. So a restart needs
    ``MIN_RESET_STAMPS`` stamps in a row that are all below the highest one since the last restart. If the clock fell by
    less than ``MAX_LATE_SECONDS``, or reads more than ``MAX_RESTART_TIME``, messages of a second link or of another
    time may be mixed with messages of the first. There the former clock must not return for as long as
    ``MAX_LATE_SECONDS`` last. An autopilot that restarts seconds after its start may reach the former clock in this
    time, but step by step.

    ``tests/ingest/test_clocks.py`` has a stream for each of these cases.

    Args:
        time: Stamps (n,) in stream order, s, wraps undone.

    Returns:
        The first row of each boot after the first one, ascending.
    """
    # The highest of the ``MIN_RESET_STAMPS`` stamps from each row on.
    highest_ahead = _highest_ahead(time, MIN_RESET_STAMPS)
    if not (highest_ahead < np.maximum.accumulate(time) - MIN_RESET_STEP).any():
        return np.zeros(0, dtype=np.int64)
    rising_steps = np.diff(time)
    rising_steps = rising_steps[rising_steps > 0]
    median_step = float(np.median(rising_steps)) if len(rising_steps) else MAX_LATE_SECONDS
    late_stamps = min(len(time), MIN_RESET_STAMPS + round(MAX_LATE_SECONDS / median_step))
    # The same of the stamps that arrive within ``MAX_LATE_SECONDS``.
    highest_for_long = _highest_ahead(time, late_stamps)
    reboot_rows = []
    highest_of_boot = -np.inf
    stamps = zip(time.tolist(), highest_ahead.tolist(), highest_for_long.tolist(), strict=True)
    for row, (stamp, highest_of_next, highest_of_many) in enumerate(stamps):
        # How far the next stamps, and all that arrive within ``MAX_LATE_SECONDS``, stay below the former clock, s.
        fall_of_next = highest_of_boot - highest_of_next
        fall_of_many = highest_of_boot - highest_of_many
        is_large_fall = fall_of_next > MAX_LATE_SECONDS
        if stamp <= MAX_RESTART_TIME:
            has_restarted = is_large_fall or fall_of_many > MIN_RESET_STEP
            if not has_restarted and fall_of_next > MIN_RESET_STEP:
                # The former clock returns within ``MAX_LATE_SECONDS``, but perhaps as the clock of a new boot that
                # rises to it step by step.
                following_stamps = time[row : row + late_stamps]
                has_restarted = rises_steadily(following_stamps, highest_of_boot, median_step)
        else:
            # Messages of another time may be mixed in: the clock must stay below the former one.
            has_restarted = is_large_fall and fall_of_many > MIN_RESET_STEP
        if has_restarted:
            reboot_rows.append(row)
            highest_of_boot = stamp
        highest_of_boot = max(highest_of_boot, stamp)
    return np.array(reboot_rows, dtype=np.int64)


def rises_steadily(stamps: Times, former_highest: float, median_step: float) -> bool:
    """Returns whether a clock that fell rises again message by message, as after a restart of the autopilot.

    A restarted clock rises without gaps to its former value, with about as many messages as come in this time at the
    usual rate. The stamps may fall for another reason: messages come late over a second link. There are fewer of those,
    since messages that came over the first link are dropped when they come again. Or messages of both links alternate,
    so that the stamps jump up and down.

    Args:
        stamps: Stamps (n,) from the fall on, s, in stream order.
        former_highest: Highest stamp before the fall, s.
        median_step: Median of the rising steps of the whole clock, s.
    """
    # Stamps that are less far below the highest one belong to a clock that has not fallen.
    lowest_continuing_stamp = former_highest - MIN_RESET_STEP
    count_below = np.count_nonzero(stamps < lowest_continuing_stamp)
    expected_count = (lowest_continuing_stamp - stamps[0]) / median_step
    has_gaps = (np.diff(stamps) > MIN_RESET_STEP).any()
    return bool(not has_gaps and count_below >= MIN_STAMPS_FRACTION * expected_count)


def _highest_ahead(values: Times, count: int) -> Times:
    """Returns, for each row, the maximum of its value and the ``count`` − 1 values after it; of fewer at the end.

    Args:
        values: Values (n,).
        count: Number of values, at least 1, the row itself included.

    Returns:
        Highest values (n,).
    """
    # SciPy's window is centred on each row. The negative origin moves it so that it begins at the row.
    return scipy.ndimage.maximum_filter1d(values, count, origin=-(count // 2), mode="nearest")
