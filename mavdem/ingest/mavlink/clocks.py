"""The boot clock: one time axis for everything a component sent, from the stamps inside its messages.

Stamps come as ``time_boot_ms`` (uint32 milliseconds), ``time_usec`` (uint32 microseconds in SERVO_OUTPUT_RAW, which
wraps every 71.6 minutes, uint64 elsewhere) and ``time_boot_us``. One message type is the reference. Its own stamps show
reboots and outliers; all other stamps are compared with it, which undoes their wraps and moves them to its epoch. A
``time_usec`` may also be UNIX time: a type whose stamps lie on another epoch is moved as a whole.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Flags
from mavdem.facts import Facts
from mavdem.facts.sources import Repair
from mavdem.ingest.mavlink.clock_readings import (
    BootTimes,
    ClockReadings,
    MessageStamps,
    ReceiveTimes,
    Rows,
    StreamPositions,
    Times,
    last_rows_before,
    outlier_stamps,
    stamped_messages,
)
from mavdem.ingest.mavlink.reference_clock import reference_readings, reference_type_of
from mavdem.ingest.mavlink.restarts import (
    HeartbeatStates,
    RestartDelays,
    heartbeats_after_restarts,
    restart_delays,
)
from mavdem.ingest.mavlink.unstamped_messages import assign_times_to_unstamped_messages
from mavdem.ingest.telemetry import repair_facts

MIN_EPOCH_OFFSET = 10.0
"""Median offset, s, of a message type's stamps from the reference above which they count from another epoch."""


class BootClock(NamedTuple):
    """The boot clock of a component, with its messages on it."""

    times: dict[str, BootTimes]
    """Times and boots of the messages of each type by its name."""
    repairs: Facts = ()
    """Facts that report what was repaired."""
    delays: RestartDelays = {}
    """How long the component was silent before each restart."""


def boot_clock(
    message_types: Sequence[MessageStamps],
    receive_times: ReceiveTimes | None = None,
    heartbeats: HeartbeatStates | None = None,
) -> BootClock:
    """Puts every message of a component on its boot clock.

    ``tests/ingest/test_clocks.py`` has streams with wraps, restarts, late messages, outliers and UNIX times.

    Args:
        message_types: The messages that the component sent, by type.
        receive_times: When the messages at some positions were received; None where that was not recorded.
        heartbeats: The HEARTBEATs among them; None without any.

    Returns:
        The clock. A message without a stamp has the time of the last message before it; one before the first stamp has
        that stamp, and one that an autopilot sends on its start, before its first stamp, has that stamp by its time of
        reception. If an outlier was ignored, the message has the time of the last one of its type. Without any stamp
        all times are NaN.
    """
    reference_type = reference_type_of(message_types)
    if reference_type is None:
        return BootClock(_unassigned_times(message_types, has_restarts=False))
    reference, repairs = reference_readings(reference_type)
    # HEARTBEATs of boots in which the reference type was not sent define the clock there.
    late_heartbeats = _late_heartbeats(reference, heartbeats, receive_times)
    if late_heartbeats is not None:
        repairs += _restarts_after(reference, late_heartbeats)
        reference = reference.followed_by(late_heartbeats)
    delays: RestartDelays = {}
    if receive_times is not None and len(reference.positions):
        delays = restart_delays(reference, receive_times)
    boot_times = _unassigned_times(message_types, has_restarts=bool(reference.boot.any()))
    for message_type in message_types:
        positions, stamps = stamped_messages(message_type)
        readings = reference
        if message_type is not reference_type and len(positions):
            readings, further_repairs = _readings_by_reference(
                reference, message_type, positions, stamps
            )
            repairs += further_repairs
        if len(positions) and len(readings.positions):
            rows = np.searchsorted(message_type.positions, positions)
            readings_before = last_rows_before(readings.positions, positions)
            _assign_times(boot_times[message_type.message], rows, readings, readings_before)
    if heartbeats is not None and late_heartbeats is not None:
        rows = np.searchsorted(heartbeats.positions, late_heartbeats.positions)
        boot_times["HEARTBEAT"].time[rows] = late_heartbeats.time
        boot_times["HEARTBEAT"].boot[rows] = late_heartbeats.boot
    assign_times_to_unstamped_messages(message_types, boot_times, reference, receive_times)
    return BootClock(boot_times, repairs, delays)


def _assign_times(
    times: BootTimes, rows: Rows, readings: ClockReadings, readings_before: Rows
) -> None:
    """Writes the times of N stamped messages of one type into the arrays for all messages of this type.

    A message whose stamp was ignored as an outlier repeats the last time of its own type: the time of another type
    would look like a time at which this message was sent.

    Args:
        times: Times and boots of all messages of the type, which are changed. If the component never restarted, the
            array of boots is a constant 0 that cannot be written.
        rows: The rows of the stamped messages in these arrays (N,).
        readings: The readings of the boot clock by the stamps that were not ignored.
        readings_before: The rows of the last reading up to each message (N,).
    """
    times.time[rows] = readings.time[readings_before]
    if times.boot.flags.writeable:
        times.boot[rows] = readings.boot[readings_before]


def _late_heartbeats(
    reference: ClockReadings,
    heartbeats: HeartbeatStates | None,
    receive_times: ReceiveTimes | None,
) -> ClockReadings | None:
    """Returns the HEARTBEATs of the last boots, during which the reference type was not sent; None without such boots.

    A HEARTBEAT has no stamp: its time follows from when it was received (:func:`heartbeats_after_restarts`).

    Args:
        reference: The messages of the reference type on the boot clock.
        heartbeats: The HEARTBEATs of the component; None without any.
        receive_times: When messages were received; None where that was not recorded.
    """
    if heartbeats is None or receive_times is None or not len(reference.positions):
        return None
    late_heartbeats = heartbeats_after_restarts(reference, heartbeats, receive_times)
    return late_heartbeats if len(late_heartbeats.positions) else None


def _unassigned_times(
    message_types: Sequence[MessageStamps], *, has_restarts: bool
) -> dict[str, BootTimes]:
    """Returns arrays for the times of all messages by the name of their type: NaN, and boot 0.

    Args:
        message_types: The messages of a component, by type.
        has_restarts: Whether there are several boots. If not, the numbers of the boot are a broadcast array, which
            takes no memory and cannot be written to.
    """
    boot_times = {}
    for message_type in message_types:
        count = len(message_type.positions)
        only_boot = np.broadcast_to(np.int64(0), count)
        boots = only_boot.copy() if has_restarts else only_boot
        boot_times[message_type.message] = BootTimes(np.full(count, np.nan), boots)
    return boot_times


def _restarts_after(reference: ClockReadings, late_heartbeats: ClockReadings) -> Facts:
    """Reports how often an autopilot restarted after the last message of the reference type.

    Args:
        reference: The messages of the reference type on the boot clock.
        late_heartbeats: The HEARTBEATs of later boots, at least one.
    """
    restart_count = int(late_heartbeats.boot[-1] - reference.boot[-1])
    last_time = float(reference.time[-1])
    return repair_facts(Repair.LOG_OF_SEVERAL_BOOTS, count=restart_count, time=last_time)


def _readings_by_reference(
    reference: ClockReadings,
    message_type: MessageStamps,
    positions: StreamPositions,
    stamps: Times,
) -> tuple[ClockReadings, Facts]:
    """Puts another message type on the boot clock, by the reference's messages before and after each of its own.

    The boot clock is the time since the autopilot started, with the number of the start. One message type, the
    reference, is on it by its own stamps already. The stamp of another type should lie between the reference's stamps
    before and after it in the stream; its offset is how far it lies outside of this interval, s. The steps:

    1. Compare each stamp with the reference's, which also gives its boot and undoes wraps of the counter.
    2. If the median offset is large, the type counts from another epoch, such as 1970 (UNIX time). The median offset
       of each boot is subtracted.
    3. Drop stamps whose offset is far from all others.

    Args:
        reference: The reference type on the boot clock.
        message_type: The other type; after ``period`` seconds its counter begins again (wraps).
        positions: Positions (m,) of its messages that have a stamp.
        stamps: Their stamps (m,), s.

    Returns:
        The messages on the boot clock, without outliers, and facts that report what was repaired.
    """
    name = message_type.message
    period = message_type.period
    time, offset, boot = _compare_with_reference(reference, positions, stamps, period)
    # Only messages between the first and the last of the reference can be compared with it. If there are none, all
    # messages are used.
    first_row, end_row = np.searchsorted(
        positions, reference.positions[[0, -1]], side="right"
    ).tolist()
    comparable = offset[first_row:end_row] if first_row < end_row else offset
    typical_offset = np.median(comparable)
    # Stamps of another epoch, such as UNIX time, are off by the same amount in each boot, and are moved by it.
    is_other_epoch = abs(typical_offset) > MIN_EPOCH_OFFSET
    repairs: Facts = ()
    if is_other_epoch:
        shift = _median_by_boot(offset, boot)
        time = time - shift
        offset = offset - shift
        repairs += repair_facts(Repair.CLOCK_MOVED, name=name, offset=typical_offset)
    is_outlier = outlier_stamps(offset)
    # Undoing a wrap moved stamps by at least a whole period, so a move by more than half a period was a wrap.
    if not is_other_epoch and (abs(time - stamps)[~is_outlier] > period / 2).any():
        repairs += repair_facts(Repair.CLOCK_WRAPPED, name=name, period=period)
    repairs += repair_facts(Repair.STAMPS_IGNORED, count=np.count_nonzero(is_outlier), name=name)
    readings = ClockReadings(positions[~is_outlier], time[~is_outlier], boot[~is_outlier])
    return readings, repairs


class _Comparison(NamedTuple):
    """The m stamps of a message type, compared with the reference's stamps around them."""

    time: Times
    """Stamp (m,), s, with wraps undone."""
    offset: Times
    """Distance (m,), s, from the interval between the reference's stamps before and after; 0 inside of it."""
    boot: Rows
    """Number of the boot (m,)."""


def _median_by_boot(values: Times, boot: Rows) -> Times:
    """Returns for each message (m,) the median of a value over all messages of its boot.

    Args:
        values: The value of each message (m,), such as its offset, s.
        boot: The boot of each message (m,).
    """
    medians = np.empty_like(values)
    for number in np.unique(boot):
        is_of_boot = boot == number
        medians[is_of_boot] = np.median(values[is_of_boot])
    return medians


def _compare_with_reference(
    reference: ClockReadings, positions: StreamPositions, stamps: Times, period: float
) -> _Comparison:
    """Compares each stamp with the stamps of the reference messages before and after it in the stream.

    The reference is the message type that defines the boot clock. A message that was sent between two reference
    messages should have a stamp between theirs, and its offset is how far it lies outside. At a restart of the
    autopilot these two are of different boots, so that there is no interval between them. Then the offset is the
    distance from the nearer one, and the message belongs to the boot of that one.

    Args:
        reference: Stream positions, times and boots of the reference type.
        positions: Positions (m,) of the messages in the stream.
        stamps: Their stamps (m,), s, as sent; their counter may have wrapped, that is started again at 0.
        period: Time after which the counter of the stamps wraps, s.

    Returns:
        For each message (m,) its stamp with wraps undone, s, its offset, s, and its boot.
    """
    next_rows = np.searchsorted(reference.positions, positions)
    row_before = np.maximum(next_rows - 1, 0)
    row_after = np.minimum(next_rows, len(reference.positions) - 1)
    time_before = reference.time[row_before]
    time_after = reference.time[row_after]
    is_same_boot = reference.boot[row_before] == reference.boot[row_after]
    # How often the counter has wrapped is not known. Two numbers are tried: with one the stamp is nearest to the
    # reference before it, with the other to the one after it. The smaller offset decides.
    stamp_by_before = _unwrapped(stamps, period, time_before)
    stamp_by_after = _unwrapped(stamps, period, time_after)
    offset_by_before = _offset_from_reference(
        stamp_by_before, time_before, time_before, time_after, is_same_boot
    )
    offset_by_after = _offset_from_reference(
        stamp_by_after, time_after, time_before, time_after, is_same_boot
    )
    before_is_nearer = abs(offset_by_before) <= abs(offset_by_after)
    return _Comparison(
        time=np.where(before_is_nearer, stamp_by_before, stamp_by_after),
        offset=np.where(before_is_nearer, offset_by_before, offset_by_after),
        boot=np.where(before_is_nearer, reference.boot[row_before], reference.boot[row_after]),
    )


def _offset_from_reference(
    stamps: Times, reference: Times, time_before: Times, time_after: Times, is_same_boot: Flags
) -> Times:
    """Returns how far stamps lie outside the interval of the reference's times before and after them.

    Args:
        stamps: Stamps (m,), s.
        reference: One of the two reference times (m,), s, from which the offset counts where they are of two boots.
        time_before: Times (m,) of the reference messages before, s.
        time_after: Times (m,) of the reference messages after, s.
        is_same_boot: Whether both are of the same boot (m,).

    Returns:
        Offsets (m,), s; 0 inside the interval.
    """
    nearest_in_interval = np.clip(stamps, time_before, time_after)
    return stamps - np.where(is_same_boot, nearest_in_interval, reference)


def _unwrapped(stamps: Times, period: float, nearby: Times) -> Times:
    """Adds whole periods of the counter to stamps (m,), s, so that each is nearest to the time nearby (m,), s."""
    if not np.isfinite(period):
        return stamps
    return stamps + period * np.round((nearby - stamps) / period)
