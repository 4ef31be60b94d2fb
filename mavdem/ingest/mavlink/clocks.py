"""The boot clock: one time axis for everything a component sent, from the stamps inside its messages.

Stamps come as ``time_boot_ms`` (uint32 milliseconds), ``time_usec`` (uint32 microseconds in SERVO_OUTPUT_RAW, which
wraps every 71.6 minutes, uint64 elsewhere) and ``time_boot_us``. One message type is the reference. Its own stamps show
reboots and outliers; all other stamps are compared with it, which undoes their wraps and moves them to its epoch. A
``time_usec`` may also be UNIX time: a type whose stamps lie on another epoch is moved as a whole.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from mavdem.arrays import Flags
from mavdem.facts import Facts
from mavdem.facts.sources import Repair
from mavdem.ingest.telemetry import repair_facts

Times = NDArray[np.float64]
"""Times or differences of times, s."""
Rows = NDArray[np.integer]
"""Row numbers, or numbers of boots."""
StreamPositions = NDArray[np.integer]
"""Where messages are in the stream: byte offsets or message numbers. Only their order matters."""
ReceiveTimes = Callable[[StreamPositions], Times]
"""A function that returns when the messages at some positions (n,) were received, s; NaN where that is not known."""

MAX_STAMP_DEVIATION = 5.0
"""Deviation of a stamp from those around it, s, beyond which it is an outlier; ten median steps are added to it.

A choice: delays within an autopilot and its link are shorter, and damaged stamps are wrong by more.
"""

OUTLIER_WINDOW = 5
"""Number of stamps around which the median is taken for finding outliers: up to two wrong ones do not move it."""

MAX_STEPS_OFF = 10
"""Number of median time steps by which a stamp may deviate beyond ``MAX_STAMP_DEVIATION``: for slow messages."""

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

MIN_STAMPS_SHARE = 0.5
"""Least number of stamps while a restarted clock rises, as a fraction of those of this time at the usual rate.

A choice: links lose less, and messages that only a second link brought are those that the first one lost.
"""

MAX_WRAP_GAP = 60.0
"""Longest silence, s, across which a 32-bit reference clock counts as wrapped; after a longer one, as restarted."""

MIN_EPOCH_OFFSET = 10.0
"""Median offset, s, of a message type's stamps from the reference above which they count from another epoch."""

MIN_REFERENCE_STAMPS = 3
"""Number of stamps that a message type needs at least for the outliers among them to be recognised."""

REFERENCES = (
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT",
    "SYSTEM_TIME",
)
"""Message types that the autopilot itself stamps, often; the first of these that was sent is the reference."""


class MessageStamps(NamedTuple):
    """The n messages of one type that a component sent, and the stamps inside them."""

    message: str
    """Name of the message type."""
    positions: StreamPositions
    """Position of each message in the stream (n,), ascending."""
    stamps: Times | Callable[[], Times] | None = None
    """Stamp inside each message (n,), s, 0 where it has none, or a function that decodes them.

    None for a type without stamps.
    """
    period: float = np.inf
    """Time after which the counter of the stamps wraps, s; infinite for 64-bit counters."""


class BootTimes(NamedTuple):
    """When the n messages of one type were sent, on the boot clock."""

    time: Times
    """Time since boot (n,), s."""
    boot: Rows
    """Number of the boot (n,), from 0."""


class _ClockReadings(NamedTuple):
    """The stamped messages of one type on the boot clock, without outliers."""

    positions: StreamPositions
    """Position in the stream (m,), ascending."""
    time: Times
    """Time since boot (m,), s."""
    boot: Rows
    """Number of the boot (m,), from 0."""

    def select(self, rows: Rows | Flags | slice) -> "_ClockReadings":
        """Returns some of the messages."""
        return _ClockReadings(self.positions[rows], self.time[rows], self.boot[rows])


def deviates_from_median(values: Times, window: int, limit: float | Times) -> Flags:
    """Flags values that are far from the running median.

    Args:
        values: Values (n,).
        window: Number of values around each, odd, of which the median is taken; values are mirrored at the ends.
        limit: Largest deviation from the median that is not flagged, or one for each value (n,).

    Returns:
        Flags (n,).
    """
    if not len(values):
        return np.zeros(0, dtype=np.bool_)
    return abs(values - scipy.ndimage.median_filter(values, window, mode="mirror")) > limit


def outlier_stamps(stamps: Times) -> Flags:
    """Flags stamps that are far from their neighbours in the stream, as damaged messages have them.

    Damage changes one or two messages at a time; a lasting change of the clock is not flagged.

    Args:
        stamps: Stamps (n,), s, in the order of the stream.

    Returns:
        Flags (n,); none is set where there are too few stamps to compare.
    """
    if len(stamps) < MIN_REFERENCE_STAMPS:
        return np.zeros(len(stamps), dtype=np.bool_)
    steps = np.diff(stamps)
    # A shortcut for stamps that only rise: the running median of ascending values is the value itself, except within
    # half a window of either end. There it deviates by at most the duration of that half window.
    half = OUTLIER_WINDOW // 2
    longest_half_window = max(stamps[half] - stamps[0], stamps[-1] - stamps[-1 - half])
    if steps.min() >= 0 and longest_half_window <= MAX_STAMP_DEVIATION:
        return np.zeros(len(stamps), dtype=np.bool_)
    median_step = np.median(abs(steps))
    return deviates_from_median(
        stamps, OUTLIER_WINDOW, MAX_STAMP_DEVIATION + MAX_STEPS_OFF * median_step
    )


def boot_clock(
    message_types: Sequence[MessageStamps], receive_times: ReceiveTimes | None = None
) -> tuple[dict[str, BootTimes], Facts]:
    """Puts every message of a component on its boot clock.

    ``tests/ingest/test_clocks.py`` has streams with wraps, restarts, late messages, outliers and UNIX times.

    Args:
        message_types: The messages that the component sent, by type.
        receive_times: When the messages at some positions were received; None where that was not recorded.

    Returns:
        Times and boots of the messages of each type by its name, and facts that report what was repaired. A message
        without a stamp has the time of the last message before it; one before the first stamp has that stamp, and one
        that an autopilot sends on its start, before its first stamp, has that stamp by its time of reception. If an
        outlier was ignored, the message has the time of the last one of its type. Without any stamp all times are NaN.
    """
    boot_times = {}
    for message_type in message_types:
        count = len(message_type.positions)
        # The number of the only boot takes no memory: a broadcast array, which cannot be written to.
        boot_times[message_type.message] = BootTimes(
            np.full(count, np.nan), np.broadcast_to(np.int64(0), count)
        )
    reference_type = reference_type_of(message_types)
    if reference_type is None:
        return boot_times, ()
    reference, repairs = _reference_readings(reference_type)
    if reference.boot.any():
        for name, times in boot_times.items():
            boot_times[name] = times._replace(boot=np.zeros(len(times.time), dtype=np.int64))
    for message_type in message_types:
        positions, stamps = stamped_messages(message_type)
        readings = reference
        if message_type is not reference_type and len(positions):
            readings, further_repairs = _readings_by_reference(
                reference, message_type, positions, stamps
            )
            repairs += further_repairs
        if len(positions) and len(readings.positions):
            # A message whose stamp was ignored repeats the last time of its own type: the time of another type would
            # look like a time at which this message was sent.
            readings_before = _last_rows_before(readings.positions, positions)
            rows = np.searchsorted(message_type.positions, positions)
            times = boot_times[message_type.message]
            times.time[rows] = readings.time[readings_before]
            if times.boot.flags.writeable:
                times.boot[rows] = readings.boot[readings_before]
    _assign_times_to_unstamped_messages(message_types, boot_times, receive_times)
    return boot_times, repairs


def stamped_messages(message_type: MessageStamps) -> tuple[StreamPositions, Times]:
    """Returns the messages of a type whose stamp is not 0, which means that it was not set.

    Args:
        message_type: The messages of the type. It has their stamps, a function that decodes them, or None for a type
            without stamps.

    Returns:
        Positions (m,) of these messages in the stream, and their stamps (m,), s.
    """
    stamps = message_type.stamps
    if stamps is None:
        return message_type.positions[:0], np.empty(0)
    if callable(stamps):
        stamps = stamps()
    has_stamp = stamps > 0
    if has_stamp.all():
        # Without a selection the arrays are not copied.
        return message_type.positions, stamps
    return message_type.positions[has_stamp], stamps[has_stamp]


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
    names_of_boot_time = [name for name in stamp_counts if np.isfinite(types_by_name[name].period)]
    most_stamped = max(names_of_boot_time or stamp_counts, key=stamp_counts.__getitem__)
    return types_by_name[most_stamped]


def _stamp_count(message_type: MessageStamps) -> int:
    """Returns how many messages of a type have a stamp."""
    positions, _ = stamped_messages(message_type)
    return len(positions)


def _last_rows_before(positions: StreamPositions, query: StreamPositions) -> Rows:
    """Returns the row of the last of ``positions`` at or before each queried one; 0 where all are after it."""
    return np.maximum(np.searchsorted(positions, query, side="right") - 1, 0)


def _assign_times_to_unstamped_messages(
    message_types: Sequence[MessageStamps],
    boot_times: Mapping[str, BootTimes],
    receive_times: ReceiveTimes | None,
) -> None:
    """Assigns a time to each message without a usable stamp: the time of the last stamped message before it.

    Stamped messages of all types of the component count, in the order of the stream. There are two exceptions. Messages
    before the first stamped one get its time. At a restart of the autopilot, a message that was received nearer to the
    first stamped message after it than to the last one before gets the time of the former.

    Args:
        message_types: The messages of a component by type, with their stamps and positions in the stream.
        boot_times: Times, s, and boots of these messages by name of the type, which are changed in place; a time is NaN
            where it is not known yet.
        receive_times: Returns when the messages at some positions were received, s; None if that was not recorded.
    """
    timed_types = _messages_with_time(message_types, boot_times)
    if not timed_types:
        return
    untimed_types = _messages_without_time(message_types, boot_times)
    if not untimed_types:
        return
    first_type = min(timed_types, key=lambda readings: int(readings.positions[0]))
    for untimed in untimed_types:
        untimed.set_times(0, first_type.time[:1], first_type.boot[:1])
    for readings in _merged_in_stream_order(timed_types):
        # All later messages get these times first; those of the next section then replace what comes after it.
        for untimed in untimed_types:
            first = int(np.searchsorted(untimed.positions, readings.positions[0]))
            rows_before = _last_rows_before(readings.positions, untimed.positions[first:])
            untimed.set_times(first, readings.time[rows_before], readings.boot[rows_before])
    if receive_times is not None:
        for reboot in _unmixed_reboots(timed_types):
            for untimed in untimed_types:
                untimed.move_to_next_boot(reboot, receive_times)


class _Reboot(NamedTuple):
    """The stamped messages on either side of a restart of the autopilot."""

    last_position: int
    """Position in the stream of the last one before."""
    first_position: int
    """Position in the stream of the first one after."""
    first_time: float
    """Time of the first one after, s since boot."""
    boot: int
    """Number of the boot that begins."""


def _unmixed_reboots(timed_types: Sequence[_ClockReadings]) -> list[_Reboot]:
    """Finds the restarts of the autopilot in a stream, with the stamped messages before and after each.

    A restart is left out if messages from before it and after it are mixed in the stream, as they are over two links:
    then no place in the stream separates the two boots.

    Args:
        timed_types: Stream positions, times and boots of the messages of each type.

    Returns:
        The restarts in the order of the boots.
    """
    reboots: dict[int, _Reboot] = {}
    for readings in timed_types:
        for row in np.flatnonzero(np.diff(readings.boot) > 0).tolist():
            boot = int(readings.boot[row + 1])
            reboot = _Reboot(
                last_position=int(readings.positions[row]),
                first_position=int(readings.positions[row + 1]),
                first_time=float(readings.time[row + 1]),
                boot=boot,
            )
            # Each message type shows the restart. The last stamp before it and the first one after it, of all types,
            # are the nearest to the restart.
            other = reboots.get(boot, reboot)
            earliest = min(reboot, other, key=lambda candidate: candidate.first_position)
            last_position = max(reboot.last_position, other.last_position)
            reboots[boot] = earliest._replace(last_position=last_position)
    ordered = [reboots[boot] for boot in sorted(reboots)]
    return [reboot for reboot in ordered if reboot.last_position < reboot.first_position]


def _messages_with_time(
    message_types: Sequence[MessageStamps], boot_times: Mapping[str, BootTimes]
) -> list[_ClockReadings]:
    """Selects the messages whose time is known, of each type that has any.

    Args:
        message_types: The messages of a component by type.
        boot_times: Their times, s, and boots by name of the type; a time that is not known is NaN.

    Returns:
        Positions in the stream, times and boots of these messages, for each type.
    """
    timed_types = []
    for message_type in message_types:
        times = boot_times[message_type.message]
        readings = _ClockReadings(message_type.positions, times.time, times.boot)
        is_timed = ~np.isnan(times.time)
        if is_timed.all() and len(is_timed):
            # Without a selection the arrays are not copied.
            timed_types.append(readings)
        elif is_timed.any():
            timed_types.append(readings.select(is_timed))
    return timed_types


class _UntimedMessages(NamedTuple):
    """The m messages of one type that have no time of their own."""

    times: BootTimes
    """Times of all messages of the type."""
    rows: Rows
    """Rows of the m messages among them, ascending."""
    positions: StreamPositions
    """Positions of the m messages in the stream."""

    def set_times(self, first: int, time: Times, boot: Rows) -> None:
        """Sets the times of these messages from one on to the last.

        Args:
            first: Number of the first of the m messages whose time is set.
            time: Times (m − first,), s, or one (1,) for all.
            boot: Numbers of the boots, likewise. In a log of a single boot they cannot be written to, and stay 0.
        """
        self.times.time[self.rows[first:]] = time
        if self.times.boot.flags.writeable:
            self.times.boot[self.rows[first:]] = boot

    def move_to_next_boot(self, reboot: _Reboot, receive_times: ReceiveTimes) -> None:
        """Assigns the messages that a restarted autopilot sent before its first stamped message to the new boot.

        These are the messages that were received nearer to the first stamped message of the new boot than to the last
        one of the boot before. They get the time of that first stamped message.

        Args:
            reboot: The stamped messages before and after the restart.
            receive_times: Returns when the messages at some positions in the stream were received, s.
        """
        bounds = np.array([reboot.last_position, reboot.first_position])
        first, end = np.searchsorted(self.positions, bounds)
        if first == end:
            return
        last_before, first_after = receive_times(bounds)
        received = receive_times(self.positions[first:end])
        is_of_next_boot = first_after - received < received - last_before
        rows = self.rows[first:end][is_of_next_boot]
        self.times.time[rows] = reboot.first_time
        self.times.boot[rows] = reboot.boot


def _messages_without_time(
    message_types: Sequence[MessageStamps], boot_times: Mapping[str, BootTimes]
) -> list[_UntimedMessages]:
    """Selects the messages whose time is not known, of each type that has any.

    Args:
        message_types: The messages of a component by type.
        boot_times: Their times, s, and boots by name of the type; a time that is not known is NaN.

    Returns:
        These messages of each type, with the arrays in which their times are to be set.
    """
    untimed_types = []
    for message_type in message_types:
        times = boot_times[message_type.message]
        rows = np.flatnonzero(np.isnan(times.time))
        if len(rows):
            untimed_types.append(_UntimedMessages(times, rows, message_type.positions[rows]))
    return untimed_types


READINGS_AT_ONCE = 1 << 20
"""Number of readings that are put in the order of the stream at once, about: a choice, which bounds the memory."""


def _merged_in_stream_order(timed_types: Sequence[_ClockReadings]) -> Iterator[_ClockReadings]:
    """Merges the messages of several types into the order of the stream, section by section to bound the memory.

    Args:
        timed_types: Stream positions, times and boots of the messages of each type, at least one message of each.

    Yields:
        The messages in one section of the stream, ``READINGS_AT_ONCE`` or fewer on average; sections without a message
        are left out. Messages at the same position are in the order of their types in ``timed_types``.
    """
    message_count = sum(len(readings.positions) for readings in timed_types)
    first = min(int(readings.positions[0]) for readings in timed_types)
    end = max(int(readings.positions[-1]) for readings in timed_types) + 1
    # Sections of equal length, which need not have equally many messages.
    section_count = message_count // READINGS_AT_ONCE + 1
    section_bounds = [first + (end - first) * k // section_count for k in range(section_count + 1)]
    for section_start, section_end in pairwise(section_bounds):
        sections = []
        for readings in timed_types:
            # With bounds of another data type, ``searchsorted`` would convert a copy of all positions.
            bounds = np.array([section_start, section_end], dtype=readings.positions.dtype)
            first_row, end_row = np.searchsorted(readings.positions, bounds).tolist()
            sections.append(readings.select(slice(first_row, end_row)))
        merged = _ClockReadings(
            *(np.concatenate(columns) for columns in zip(*sections, strict=True))
        )
        if len(merged.positions):
            yield merged.select(np.argsort(merged.positions, kind="stable"))


def _reference_readings(reference_type: MessageStamps) -> tuple[_ClockReadings, Facts]:
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
    steps = np.diff(stamps)
    # If the clock falls, but with one period added would have risen by a short time, it has wrapped.
    wrap_rows = 1 + np.flatnonzero((steps < 0) & (steps + period <= MAX_WRAP_GAP))
    # Number of wraps up to each row.
    wraps = np.cumsum(np.bincount(wrap_rows, minlength=len(stamps)))
    time = stamps + period * wraps if len(wrap_rows) else stamps
    reboot_rows = _reboot_rows(time)
    boot = np.cumsum(np.bincount(reboot_rows, minlength=len(positions)))
    if len(wrap_rows):
        # A counter starts again at each boot, so only the wraps since the boot's first message are added.
        boot_start_rows = np.concatenate([[0], reboot_rows])
        wraps_before_boot = wraps[boot_start_rows][boot]
        time = stamps + period * (wraps - wraps_before_boot)
    repairs = repair_facts(Repair.STAMPS_IGNORED, count=np.count_nonzero(is_outlier), name=name)
    if len(wrap_rows):
        repairs += repair_facts(Repair.CLOCK_WRAPPED, name=name, period=period)
    if len(reboot_rows):
        last_time = time[reboot_rows[0] - 1]
        repairs += repair_facts(Repair.LOG_OF_SEVERAL_BOOTS, count=len(reboot_rows), time=last_time)
    return _ClockReadings(positions, time, boot), repairs


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
    highest_ahead = _highest_ahead(time, MIN_RESET_STAMPS)
    if not (highest_ahead < np.maximum.accumulate(time) - MIN_RESET_STEP).any():
        return np.zeros(0, dtype=np.int64)
    rising_steps = np.diff(time)
    rising_steps = rising_steps[rising_steps > 0]
    median_step = float(np.median(rising_steps)) if len(rising_steps) else MAX_LATE_SECONDS
    late_stamps = min(len(time), MIN_RESET_STAMPS + round(MAX_LATE_SECONDS / median_step))
    highest_far_ahead = _highest_ahead(time, late_stamps)
    reboot_rows = []
    highest_of_boot = -np.inf
    stamps = zip(time.tolist(), highest_ahead.tolist(), highest_far_ahead.tolist(), strict=True)
    for row, (stamp, highest_next, highest_later) in enumerate(stamps):
        is_near_zero = stamp <= MAX_RESTART_TIME
        has_fallen_far = highest_next < highest_of_boot - MAX_LATE_SECONDS
        if is_near_zero and has_fallen_far:
            has_restarted = True
        elif is_near_zero:
            has_fallen = highest_next < highest_of_boot - MIN_RESET_STEP
            stays_below = highest_later < highest_of_boot - MIN_RESET_STEP
            following_stamps = time[row : row + late_stamps]
            has_restarted = stays_below or (
                has_fallen and rises_steadily(following_stamps, highest_of_boot, median_step)
            )
        elif has_fallen_far:
            has_restarted = highest_later < highest_of_boot - MIN_RESET_STEP
        else:
            has_restarted = False
        if has_restarted:
            reboot_rows.append(row)
            highest_of_boot = stamp
        highest_of_boot = max(highest_of_boot, stamp)
    return np.array(reboot_rows, dtype=np.int64)


def rises_steadily(stamps: Times, former_highest: float, median_step: float) -> bool:
    """Returns whether a clock that fell rises again message by message, as after a restart of the autopilot.

    A restarted clock rises without gaps to its former value, with about as many messages as come in this time at the
    usual rate. With late messages of a second link it does not: there are fewer of them, since copies were dropped, or
    messages of the first link arrive in between, so that the clock jumps.

    Args:
        stamps: Stamps (n,) from the fall on, s, in stream order.
        former_highest: Highest stamp before the fall, s.
        median_step: Median of the rising steps of the whole clock, s.
    """
    former_value = former_highest - MIN_RESET_STEP
    stamps_below = np.count_nonzero(stamps < former_value)
    expected_stamps = (former_value - stamps[0]) / median_step
    has_gaps = (np.diff(stamps) > MIN_RESET_STEP).any()
    return bool(not has_gaps and stamps_below >= MIN_STAMPS_SHARE * expected_stamps)


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


def _readings_by_reference(
    reference: _ClockReadings,
    message_type: MessageStamps,
    positions: StreamPositions,
    stamps: Times,
) -> tuple[_ClockReadings, Facts]:
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
        for number in np.unique(boot):
            is_of_boot = boot == number
            shift = np.median(offset[is_of_boot])
            time[is_of_boot] -= shift
            offset[is_of_boot] -= shift
        repairs += repair_facts(Repair.CLOCK_MOVED, name=name, offset=typical_offset)
    is_outlier = outlier_stamps(offset)
    # Undoing a wrap moved stamps by at least a whole period, so a move by more than half a period was a wrap.
    if not is_other_epoch and (abs(time - stamps)[~is_outlier] > period / 2).any():
        repairs += repair_facts(Repair.CLOCK_WRAPPED, name=name, period=period)
    repairs += repair_facts(Repair.STAMPS_IGNORED, count=np.count_nonzero(is_outlier), name=name)
    readings = _ClockReadings(positions[~is_outlier], time[~is_outlier], boot[~is_outlier])
    return readings, repairs


class _Comparison(NamedTuple):
    """The m stamps of a message type, compared with the reference's stamps around them."""

    time: Times
    """Stamp (m,), s, with wraps undone."""
    offset: Times
    """Distance (m,), s, from the interval between the reference's stamps before and after; 0 inside of it."""
    boot: Rows
    """Number of the boot (m,)."""


def _compare_with_reference(
    reference: _ClockReadings, positions: StreamPositions, stamps: Times, period: float
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
