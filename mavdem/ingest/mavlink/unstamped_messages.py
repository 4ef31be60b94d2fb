"""Times on the boot clock of messages without a stamp, by the stamped messages around them in the stream."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mavdem.ingest.mavlink.clock_readings import (
    BootTimes,
    ClockReadings,
    MessageStamps,
    ReceiveTimes,
    Rows,
    StreamPositions,
    Times,
    last_rows_before,
)
from mavdem.ingest.mavlink.restarts import Reboot, reboots_of_type


def assign_times_to_unstamped_messages(
    message_types: Sequence[MessageStamps],
    boot_times: Mapping[str, BootTimes],
    reference: ClockReadings,
    receive_times: ReceiveTimes | None,
) -> None:
    """Assigns a time to each message without a usable stamp: the time of the last stamped message before it.

    Stamped messages of all types of the component count, in the order of the stream. There are two exceptions:

    - Messages before the first stamped one get its time.
    - Messages between the last stamped one before a restart of the autopilot and the first one after it may be of
      either boot. Those that were received nearer to the first one after it get its time.

    Args:
        message_types: The messages of a component by type, with their stamps and positions in the stream.
        boot_times: Times, s, and boots of these messages by name of the type, which are changed in place; a time is NaN
            where it is not known yet.
        reference: The messages that define the boot clock, in the order of the stream.
        receive_times: Returns when the messages at some positions were received, s; None if that was not recorded.
    """
    timed_types = _messages_with_time(message_types, boot_times)
    untimed_types = _messages_without_time(message_types, boot_times)
    if not timed_types or not untimed_types:
        return
    # Here all messages get the time of the first stamped one in the stream. Those before it keep this time.
    type_of_first_stamped = min(timed_types, key=lambda readings: int(readings.positions[0]))
    first_stamped = type_of_first_stamped.select(slice(0, 1))
    for untimed in untimed_types:
        untimed.set_times(0, first_stamped.time, first_stamped.boot)
    # The stamped messages come in sections of the stream, one after the other. Each section sets the times of all
    # messages after its begin, so that those after the begin of the next section are set again by that one.
    for section in _merged_in_stream_order(timed_types):
        for untimed in untimed_types:
            untimed.set_times_after(section)
    if receive_times is not None:
        # Each type shows a restart between two of its messages. HEARTBEATs that begin a boot show it together with the
        # last message of another type, which only the reference has.
        for reboot in _unmixed_reboots([reference, *timed_types]):
            for untimed in untimed_types:
                untimed.move_to_next_boot(reboot, receive_times)


def _unmixed_reboots(timed_types: Sequence[ClockReadings]) -> list[Reboot]:
    """Finds the restarts of the autopilot in a stream, with the stamped messages before and after each.

    A restart is left out if messages from before it and after it are mixed in the stream, as they are over two links:
    then no place in the stream separates the two boots.

    Args:
        timed_types: Stream positions, times and boots of the messages of each type.

    Returns:
        The restarts in the order of the boots.
    """
    # Every message type shows the same restarts, between different messages.
    reboots: dict[int, Reboot] = {}
    for readings in timed_types:
        for reboot in reboots_of_type(readings):
            known_reboot = reboots.get(reboot.boot, reboot)
            reboots[reboot.boot] = _narrowed_reboot(known_reboot, reboot)
    unmixed = []
    for _, reboot in sorted(reboots.items()):
        if reboot.last_position < reboot.first_position:
            unmixed.append(reboot)
    return unmixed


def _narrowed_reboot(first: Reboot, second: Reboot) -> Reboot:
    """Joins what the messages of two types show of the same restart of the autopilot.

    The messages of each type show between which two of them it restarted. Of both types together, the last message
    before the restart is the later one, and the first message after it is the earlier one.

    Args:
        first: The restart by the messages of one type: positions in the stream of the last message before it and of the
            first one after it, with the time of that one.
        second: The restart by the messages of the other type.
    """
    last_position_before = max(first.last_position, second.last_position)
    with_earlier_message_after = min(first, second, key=lambda reboot: reboot.first_position)
    return with_earlier_message_after._replace(last_position=last_position_before)


def _messages_with_time(
    message_types: Sequence[MessageStamps], boot_times: Mapping[str, BootTimes]
) -> list[ClockReadings]:
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
        readings = ClockReadings(message_type.positions, times.time, times.boot)
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

    def set_times_after(self, stamped: ClockReadings) -> None:
        """Sets the time of each message to that of the last stamped one before it; of those before all, sets none.

        Args:
            stamped: Stream positions, ascending, times and boots of stamped messages, at least one.
        """
        first_after = int(np.searchsorted(self.positions, stamped.positions[0]))
        stamped_rows = last_rows_before(stamped.positions, self.positions[first_after:])
        self.set_times(first_after, stamped.time[stamped_rows], stamped.boot[stamped_rows])

    def set_times(self, first: int, time: Times, boot: Rows) -> None:
        """Sets the times and the boots of message ``first`` and of all after it.

        Args:
            first: Index of the first of these m messages whose time is set, 0 to m.
            time: Times (m − first,) since the boot of the autopilot, s, or one time (1,) for all.
            boot: Numbers of these boots in the log, likewise.
        """
        changed_rows = self.rows[first:]
        self.times.time[changed_rows] = time
        # In a log of a single boot, the numbers are a read-only view of one zero, and stay 0.
        has_several_boots = self.times.boot.flags.writeable
        if has_several_boots:
            self.times.boot[changed_rows] = boot

    def move_to_next_boot(self, reboot: Reboot, receive_times: ReceiveTimes) -> None:
        """Assigns the messages that a restarted autopilot sent before its first stamped message to the new boot.

        These are the messages that were received nearer to the first stamped message of the new boot than to the last
        one of the boot before. They get the time of that first stamped message.

        Args:
            reboot: The stamped messages before and after the restart.
            receive_times: Returns when the messages at some positions in the stream were received, s.
        """
        # Positions in the stream of the last stamped message before the restart and of the first one after it.
        stamped_positions = np.array([reboot.last_position, reboot.first_position])
        # The messages without a time between these two.
        first_between, end_between = np.searchsorted(self.positions, stamped_positions)
        if first_between == end_between:
            return
        receive_time_before, receive_time_after = receive_times(stamped_positions)
        received = receive_times(self.positions[first_between:end_between])
        # The clock of the receiver goes back where an older recording was appended.
        seconds_before = abs(received - receive_time_before)
        seconds_after = abs(receive_time_after - received)
        is_of_next_boot = seconds_after < seconds_before
        rows = self.rows[first_between:end_between][is_of_next_boot]
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


def _merged_in_stream_order(timed_types: Sequence[ClockReadings]) -> Iterator[ClockReadings]:
    """Merges the messages of several types into the order of the stream, section by section to bound the memory.

    Args:
        timed_types: Stream positions, times and boots of the messages of each type, at least one message of each.

    Yields:
        The messages in one section of the stream, ``READINGS_AT_ONCE`` or fewer on average; sections without a message
        are left out. Messages at the same position are in the order of their types in ``timed_types``.
    """
    message_count = sum(len(readings.positions) for readings in timed_types)
    first_position = min(int(readings.positions[0]) for readings in timed_types)
    position_after_last = max(int(readings.positions[-1]) for readings in timed_types) + 1
    # Sections of about equal length, which need not have equally many messages. Integers keep their bounds exact.
    section_count = message_count // READINGS_AT_ONCE + 1
    stream_length = position_after_last - first_position
    section_bounds = [
        first_position + stream_length * number // section_count
        for number in range(section_count + 1)
    ]
    for section_start, section_end in pairwise(section_bounds):
        sections_by_type = [
            _readings_in_section(readings, section_start, section_end) for readings in timed_types
        ]
        section = ClockReadings(
            np.concatenate([readings.positions for readings in sections_by_type]),
            np.concatenate([readings.time for readings in sections_by_type]),
            np.concatenate([readings.boot for readings in sections_by_type]),
        )
        if len(section.positions):
            yield section.select(np.argsort(section.positions, kind="stable"))


def _readings_in_section(readings: ClockReadings, start: int, end: int) -> ClockReadings:
    """Returns the messages of one type in a section of the stream.

    Args:
        readings: Stream positions, times and boots of all messages of the type.
        start: First position of the section.
        end: Position after the section.
    """
    # With bounds of another data type, ``searchsorted`` would convert a copy of all positions.
    bounds = np.array([start, end], dtype=readings.positions.dtype)
    first_row, end_row = np.searchsorted(readings.positions, bounds).tolist()
    return readings.select(slice(first_row, end_row))
