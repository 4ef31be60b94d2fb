"""The links over which one MAVLink sender is received: copies of frames, missing frames, and two vehicles under one id.

A sender numbers its frames from 0 to 255 and then from 0 again. Between it and the receiver may lie several links, such
as two radios, and forwarders that send everything twice. Three things follow:

- The same frame arrives over a second link, immediately or some seconds late. Its bytes are the same, with the sequence
  number and the time since boot in them. It is dropped.
- Frames that one link lost may come late over the other one. They are missing only if they come over none.
- Two vehicles with the same ids look like one whose clock, heading or position jumps back and forth, or whose attitudes
  contradict each other (``sequence_counters``).

Source: https://mavlink.io/en/guide/serialization.html (the sequence number is "used to detect packet loss").
"""

import struct
from collections import OrderedDict, deque
from collections.abc import Iterable
from math import nan, radians
from typing import Any

from mavdem.ingest.mavlink.clocks import MAX_LATE_SECONDS
from mavdem.ingest.mavlink.dialect import definitions_by_id, mavlink_message_id
from mavdem.ingest.mavlink.framing import HEADER_BYTES_V1, HEADER_BYTES_V2, LENGTH_BYTE, MARKER_V2
from mavdem.ingest.mavlink.sequence_counters import (
    MIN_COUNTER_SWITCHES,
    SEQUENCE_NUMBERS,
    AttitudeComparison,
    SequenceCounters,
    attitude_reading,
)
from mavdem.ingest.mavlink.vehicle_tracks import Reading, ReadingColumns, VehicleTracks
from mavdem.ingest.vocabulary import DEGREES_PER_UNIT

MAX_LATE_STEPS = 32
"""Number of frames by which a late one is overtaken at most; a larger step back is of a sender that restarted."""

MAX_MISSING_STEP = 128
"""Largest step forward that is taken for lost frames: half of the sequence numbers."""

RECENT_FRAMES = 8192
"""Number of a sender's frames that are remembered, to recognise copies: 4 s of the fastest serial ports, a choice."""

MAX_HEADING_PITCH = radians(60)
"""Pitch, rad, up to which the heading is used: where the nose points up or down it is not defined. A choice."""

CLOCK_UNITS_PER_SECOND = 1000.0
"""Units of ``time_boot_ms`` in a second."""

CLOCK_LAYOUT = struct.Struct("<I")
"""Beginning of LOCAL_POSITION_NED and ATTITUDE_QUATERNION: ``time_boot_ms``."""

ATTITUDE_LAYOUT = struct.Struct("<I3f")
"""Beginning of ATTITUDE: ``time_boot_ms``, ``roll``, ``pitch``, ``yaw``."""

POSITION_LAYOUT = struct.Struct("<I2i")
"""Beginning of GLOBAL_POSITION_INT: ``time_boot_ms``, ``lat``, ``lon``."""

READING_LAYOUTS = {
    mavlink_message_id("ATTITUDE"): ATTITUDE_LAYOUT,
    mavlink_message_id("ATTITUDE_QUATERNION"): CLOCK_LAYOUT,
    mavlink_message_id("LOCAL_POSITION_NED"): CLOCK_LAYOUT,
    mavlink_message_id("GLOBAL_POSITION_INT"): POSITION_LAYOUT,
}
"""Beginning of the payloads of those messages that autopilots stamp themselves, by message id."""

STAMP_FIELDS = ("time_boot_ms", "time_boot_us", "time_usec")
"""Names of fields with a time stamp."""


def missing_messages(before: Any, after: Any) -> Any:
    """Counts the messages that are missing between two messages of a sender, by their sequence numbers.

    A late message was counted as missing when another overtook it, and the step after it counts the messages between
    again. Its own step is negative and corrects both, so that the sum over a stream is the number of messages sent less
    the number received, as in RTP (RFC 3550, section 6.4.1). Duplicates make the sum too small.

    Args:
        before: Sequence number of the message before, or an array of them, as signed integers.
        after: Sequence number of the message itself, or an array of them.

    Returns:
        The increase of the number of missing messages, −33 to 127.
    """
    # The step modulo 256, 0 to 255. Large values are steps back: 255 is a message that is late by one.
    step = (after - before) & (SEQUENCE_NUMBERS - 1)
    is_late = step >= SEQUENCE_NUMBERS - MAX_LATE_STEPS
    is_ahead = (step > 0) & (step <= MAX_MISSING_STEP)
    # A step of 1 misses nothing. A late step counts as negative; a repeated number, or a restart, counts as 0.
    return (step - 1 - SEQUENCE_NUMBERS * is_late) * (is_ahead | is_late)


class SenderLinks:
    """Recognises copies among the frames of one sender, and counts those that no link delivered.

    Attributes:
        missing: number of frames that came over no link, by the gaps in the sequence numbers. A frame that was
            overtaken counts as missing until it comes, so that the number may be negative for a moment.
        copies: number of frames that had come already.
        longest_delay: how late a copy was at most, s of the boot clock.
        vehicles: whose readings the frames hold.
    """

    def __init__(self) -> None:
        """Begins without a frame."""
        self.missing = 0
        self.copies = 0
        self.longest_delay = 0.0
        self.vehicles = VehicleTracks()
        self._frame_count = 0
        self._counters = SequenceCounters()
        self._attitudes = AttitudeComparison()
        # Numbers of missing frames before each of the latest changes from one counter to the other.
        self._missing_at_switches = deque[int](maxlen=MIN_COUNTER_SWITCHES + 1)
        self._has_two_counters = False
        # For the bytes of each of the latest ``RECENT_FRAMES`` frames, the number of frames received up to it. The
        # oldest is first.
        self._recent: OrderedDict[bytes, int] = OrderedDict()
        # The latest boot clock, s, and the sequence number of the latest frame that was not late.
        self._clock = 0.0
        self._sequence = 0
        # The sequence number of the latest late frame, and how many frames had been received up to the latest copy of a
        # reading. The initial value is so far in the past that it never counts as recent.
        self._late_sequence = 0
        self._count_at_latest_copy = -SEQUENCE_NUMBERS

    @property
    def has_found_two_vehicles(self) -> bool:
        """Whether two vehicles were recognised at any time."""
        return self.vehicles.has_found_two or self._attitudes.has_found_two

    @property
    def are_two_vehicles(self) -> bool:
        """Whether there are two vehicles at present."""
        if self.vehicles.are_two:
            return True
        return self._counters.are_two and self._attitudes.are_two

    @property
    def has_two_counters(self) -> bool:
        """Whether the latest frames are numbered by two counters."""
        return self._has_two_counters

    @property
    def has_late_link(self) -> bool:
        """Whether a second link is known: a copy with a reading came within the latest 256 frames."""
        return self._frame_count - self._count_at_latest_copy < SEQUENCE_NUMBERS

    def process_frame(
        self, content: bytes, message_id: int, sequence: int, is_readable: bool
    ) -> bool:
        """Processes the next frame of the sender: recognises copies, counts missing frames, finds a second vehicle.

        It updates ``copies``, ``missing``, ``longest_delay`` and ``vehicles``.

        Args:
            content: all bytes of the frame.
            message_id: number of its message.
            sequence: its sequence number, 0 to 255.
            is_readable: whether its checksum matches. Of a frame whose checksum fails only the sequence number counts.

        Returns:
            Whether the frame is new; False for a copy of an earlier frame, which the caller ignores.
        """
        self._frame_count += 1
        if not is_readable:
            self._count_missing(sequence, None)
            return True
        reading = clock_reading(content, message_id) if message_id in READING_LAYOUTS else None
        if self._is_copy(content, message_id, sequence, reading):
            self.copies += 1
            self._late_sequence = sequence
            return False
        self.remember([(self._frame_count, content)])
        self._count_missing(sequence, reading)
        if reading is not None:
            self.vehicles.add(reading)
        if self._has_two_counters:
            self.compare_attitude(content, message_id)
        return True

    # The following methods process several frames at once, among which there is no copy, while no late link is known.
    # The state is the same afterwards as if ``process_frame`` had processed each of them.

    def count_frames_in_order(self, count: int, last_sequence: int) -> None:
        """Counts frames whose sequence numbers rise by one from frame to frame, so that none is missing between them.

        The number of the first one also follows the number of the frame before. The result is the same as if
        ``count_frame`` had counted each of them.

        Args:
            count: Number of frames.
            last_sequence: Sequence number of the last one.
        """
        self._frame_count += count
        self._counters.count_in_order(count, last_sequence)
        self._sequence = self._counted_sequence = last_sequence
        self._received = 0

    def count_frame(self, sequence: int) -> None:
        """Counts a frame by its sequence number, and the frames that are missing before it."""
        self._frame_count += 1
        self._count_missing(sequence, None)

    def compare_attitude(self, content: bytes, message_id: int) -> None:
        """Compares the attitude in a frame, if its message has one, with those in the frames of the other counter.

        Args:
            content: all bytes of the frame, which is readable and was counted last.
            message_id: number of its message.
        """
        attitude = attitude_reading(_payload(content), message_id)
        if attitude is not None:
            self._attitudes.add(self._counters.latest, attitude)

    def add_readings(self, readings: ReadingColumns) -> None:
        """Adds the readings (n,) of the boot clock in frames that were counted before."""
        if len(readings.clock):
            self.vehicles.add_all(readings)
            self._clock = float(readings.clock[-1])

    def remember(self, contents: Iterable[tuple[int, bytes]]) -> None:
        """Remembers readable frames, by which later copies are recognised, and forgets frames of long ago.

        Args:
            contents: for each frame in the order of the stream, the number of frames up to it, itself included, and
                its bytes.
        """
        for frame_count, content in contents:
            # Of equal frames only the latest is kept, at the end of the order.
            self._recent.pop(content, None)
            self._recent[content] = frame_count
        while len(self._recent) > RECENT_FRAMES:
            self._recent.popitem(last=False)

    def _is_copy(
        self, content: bytes, message_id: int, sequence: int, reading: Reading | None
    ) -> bool:
        """Returns whether a readable frame is a copy of a recent one, which a slower second link has brought.

        A frame with a time since boot is a copy if a recent frame has the same bytes, since a vehicle sends no time
        since boot twice. Such a copy proves that there is a second link, and how late that is. Its delay is stored
        here, since it decides about later frames without a time (``_is_copy_without_reading``).

        Args:
            content: all bytes of the frame.
            message_id: number of its message.
            sequence: its sequence number.
            reading: the time since boot in it; None if its message has none.

        Returns:
            Whether it is a copy.
        """
        earlier_count = self._recent.get(content)
        if earlier_count is None:
            return False
        if reading is not None:
            # ``self._clock`` is the latest time that the first link brought; the copy is older by its delay.
            self._count_at_latest_copy = self._frame_count
            self.longest_delay = max(self.longest_delay, self._clock - reading.clock)
            return True
        return self._is_copy_without_reading(earlier_count, content, message_id, sequence)

    def _is_copy_without_reading(
        self, earlier_count: int, content: bytes, message_id: int, sequence: int
    ) -> bool:
        """Returns whether a frame without a time since boot is a copy of an earlier one with the same bytes.

        Messages such as HEARTBEAT repeat their content, and 256 frames later, when the sequence number comes round, a
        new one may have the same bytes. So the frame is a copy only if a second link is known and one of these holds:
        it follows the earlier frame immediately; it has a time stamp; or its number continues those of the second link.

        Args:
            earlier_count: number of frames up to the earlier frame.
            content: the bytes of both.
            message_id: number of their message.
            sequence: their sequence number.
        """
        if not self.has_late_link:
            return False
        if self._frame_count - earlier_count == 1 or _has_stamp(content, message_id):
            return True
        return self._follows_late_link(sequence)

    def _follows_late_link(self, sequence: int) -> bool:
        """Returns whether a sequence number continues the second link's numbers rather than those of the first link.

        It does if fewer numbers lie between it and the latest copy than between it and the latest frame that was new.
        """
        late_step = (sequence - self._late_sequence) % SEQUENCE_NUMBERS
        return late_step < (sequence - self._sequence) % SEQUENCE_NUMBERS

    def _count_missing(self, sequence: int, reading: Reading | None) -> None:
        """Updates ``missing`` by the sequence number of a new frame.

        With one link, the gap to the number before counts as missing, and a frame that comes late is subtracted again.
        With a second, later link the gaps are counted from one reading of the clock to the next. If two counters number
        the frames, each number is compared with the one before on the same counter.

        Args:
            sequence: sequence number of the frame, 0 to 255.
            reading: the time since boot in it; None if its message has none.
        """
        former_counter = self._counters.latest
        # The number before it on the same counter; None if this frame is the first of a counter.
        number_before = self._counters.take(sequence)
        if self._counters.latest != former_counter:
            self._record_counter_switch()
        if self._frame_count == 1:
            # Nothing is missing before the first frame.
            self._sequence = sequence
        if self.has_late_link:
            self._count_over_late_link(sequence, reading)
            return
        # If a second link appears later, counting from reading to reading begins with this frame.
        self._counted_sequence = sequence
        self._received = 0
        counters_are_apart = self._has_two_counters and self._counters.are_apart
        if not counters_are_apart:
            self.missing += missing_messages(self._sequence, sequence)
        elif number_before is not None:
            self.missing += missing_messages(number_before, sequence)
        self._sequence = sequence
        if reading is not None:
            self._clock = reading.clock

    def _count_over_late_link(self, sequence: int, reading: Reading | None) -> None:
        """Updates ``missing`` by a new frame while a second link is known, from one reading of the clock to the next.

        Frames of the second link, and those that overtake each other, arrive in any order. But the boot clock shows
        which readings are the latest. Between two of these, as many frames were sent as the sequence number rose. Those
        that were not received in this time are added to ``missing``; one that is received later is subtracted.

        Args:
            sequence: sequence number of the new frame, 0 to 255.
            reading: the time since boot in it; None if its message has none.
        """
        if reading is None:
            is_late = self._follows_late_link(sequence)
        else:
            is_late = 0 < self._clock - reading.clock <= MAX_LATE_SECONDS
        if is_late:
            self.missing -= 1
            self._late_sequence = sequence
            return
        # Number of frames received since the reading whose number is ``_counted_sequence``.
        self._received += 1
        self._sequence = sequence
        if reading is None:
            return
        sent_frames = (sequence - self._counted_sequence) % SEQUENCE_NUMBERS
        # After a longer gap it is not known how often the numbers have wrapped at 256.
        if sent_frames <= MAX_MISSING_STEP:
            self.missing += sent_frames - self._received
        self._counted_sequence = sequence
        self._received = 0
        self._clock = reading.clock

    def _record_counter_switch(self) -> None:
        """Decides anew whether two counters number the frames; called where the numbering switches between counters.

        Until two counters are recognised, each switch between them looks like a loss of frames. At the recognition
        ``missing`` is therefore set back to its value before the first of these switches.
        """
        self._missing_at_switches.append(self.missing)
        has_two_counters = self._counters.are_two
        if has_two_counters and not self._has_two_counters and self._counters.are_apart:
            self.missing = min(self.missing, self._missing_at_switches[0])
        self._has_two_counters = has_two_counters


def clock_reading(content: bytes, message_id: int) -> Reading | None:
    """Returns the boot clock in a frame, with heading or position where it has one.

    Args:
        content: all bytes of the frame.
        message_id: number of its message.

    Returns:
        The reading; None for messages that have another clock or none, and before the clock has begun.
    """
    layout = READING_LAYOUTS.get(message_id)
    if layout is None:
        return None
    values = layout.unpack(_payload(content)[: layout.size].ljust(layout.size, b"\0"))
    clock = values[0] / CLOCK_UNITS_PER_SECOND
    if not clock:
        return None
    if layout is ATTITUDE_LAYOUT:
        _, _, pitch, yaw = values
        # Near the vertical, yaw is no heading.
        return Reading(clock, heading=yaw if abs(pitch) <= MAX_HEADING_PITCH else nan)
    if layout is POSITION_LAYOUT:
        _, latitude, longitude = values
        # Both are 0 while the position is not known.
        if latitude or longitude:
            return Reading(
                clock,
                latitude=latitude * DEGREES_PER_UNIT,
                longitude=longitude * DEGREES_PER_UNIT,
            )
    return Reading(clock)


def _has_stamp(content: bytes, message_id: int) -> bool:
    """Returns whether a frame has a time stamp in its payload that is not 0, as it would be if the sender set none.

    The stamp need not be new: some messages repeat an old one, such as HOME_POSITION.

    Args:
        content: all bytes of the frame.
        message_id: number of its message.
    """
    definition = definitions_by_id().get(message_id)
    if definition is None or definition.wire.fields is None:
        return False
    payload = _payload(content)
    for name in STAMP_FIELDS:
        if name in definition.wire.fields:
            field_type, offset = definition.wire.fields[name][:2]
            return any(payload[offset : offset + field_type.itemsize])
    return False


def _payload(content: bytes) -> bytes:
    """Returns the payload in the bytes of a frame, of either version of MAVLink."""
    start = HEADER_BYTES_V2 if content[0] == MARKER_V2 else HEADER_BYTES_V1
    return content[start : start + content[LENGTH_BYTE]]
