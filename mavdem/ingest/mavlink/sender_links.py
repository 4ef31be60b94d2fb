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

from mavdem.ingest.mavlink.dialect import definitions_by_id, mavlink_message_id
from mavdem.ingest.mavlink.framing import HEADER_BYTES_V1, HEADER_BYTES_V2, LENGTH_BYTE, MARKER_V2
from mavdem.ingest.mavlink.reference_clock import MAX_LATE_SECONDS
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


def missing_messages(previous_sequence: Any, next_sequence: Any) -> Any:
    """Counts the messages that are missing between two messages of a sender, by their sequence numbers.

    A message that comes late was counted as missing when a later one overtook it, and the step after it counts the
    messages between again. Its own step is negative and corrects both. So the sum over a stream is the number of
    messages sent less the number received, as in RTP (RFC 3550, section 6.4.1). Duplicates make the sum too small.

    Args:
        previous_sequence: Sequence number of the message before, or an array of them, as signed integers.
        next_sequence: Sequence number of the message itself, or an array of them.

    Returns:
        The increase of the number of missing messages, −33 to 127.
    """
    # The step modulo 256, 0 to 255, since the numbers begin again at 0 after 255. Large values are steps back: after
    # message 7, message 6 has the step 255. Its increase is 255 − 1 − 256 = −2: it is not missing itself, and the step
    # from 6 to the next message, 8, counts 7 as missing once more.
    step = (next_sequence - previous_sequence) & (SEQUENCE_NUMBERS - 1)
    is_late = step >= SEQUENCE_NUMBERS - MAX_LATE_STEPS
    is_ahead = (step > 0) & (step <= MAX_MISSING_STEP)
    # A step of 1 misses nothing, and a late message counts as negative.
    increase = step - 1 - SEQUENCE_NUMBERS * is_late
    # A repeated number, or a larger step back, as after a restart of the sender, counts as 0.
    return increase * (is_ahead | is_late)


class SenderLinks:
    """Recognises copies of a sender's frames, which a second, slower link delivers late, and counts missing frames.

    Attributes:
        missing: number of frames that came over no link, by the gaps in the sequence numbers. A frame that was
            overtaken counts as missing until it comes, so that the number may be negative for a moment.
        copies: number of frames that had come already.
        longest_delay: how late a copy was at most, s of the boot clock.
        vehicles: whose readings the frames hold.
    """

    def __init__(self) -> None:
        """Starts with no frames."""
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
        # The bytes of each of the latest ``RECENT_FRAMES`` distinct frames, the oldest first, and the number of frames
        # received up to it.
        self._frame_number_by_content: OrderedDict[bytes, int] = OrderedDict()
        # The latest boot clock, s, and the sequence number of the latest frame that was not late.
        self._latest_clock = 0.0
        self._latest_sequence = 0
        # The sequence number of the latest frame with a boot clock, and how many frames were received since.
        self._sequence_at_latest_reading = 0
        self._received_since_reading = 0
        # The sequence number of the latest frame of the slower link, and how many frames had been received up to the
        # latest copy of a reading. The initial value is so far in the past that it never counts as recent.
        self._latest_slow_sequence = 0
        self._frame_count_at_latest_copy = -SEQUENCE_NUMBERS

    @property
    def has_found_two_vehicles(self) -> bool:
        """Whether two vehicles were recognised at any time."""
        return self.vehicles.has_found_two_vehicles or self._attitudes.has_found_two_vehicles

    @property
    def are_two_vehicles(self) -> bool:
        """Whether there are two vehicles at present."""
        if self.vehicles.are_two_vehicles:
            return True
        return self._counters.are_two_counters and self._attitudes.are_two_vehicles

    @property
    def has_two_counters(self) -> bool:
        """Whether the latest frames are numbered by two counters."""
        return self._has_two_counters

    @property
    def has_slower_link(self) -> bool:
        """Whether a second, slower link is known: a copy with a boot clock came within the latest 256 frames."""
        return self._frame_count - self._frame_count_at_latest_copy < SEQUENCE_NUMBERS

    def process_frame(
        self, content: bytes, message_id: int, sequence: int, is_readable: bool
    ) -> bool:
        """Processes the next frame of the sender: recognises copies, counts missing frames, finds a second vehicle.

        It updates ``copies``, ``missing``, ``longest_delay`` and ``vehicles``.

        Args:
            content: all bytes of the frame.
            message_id: MAVLink's number of its message (30 for ATTITUDE).
            sequence: its sequence number, 0 to 255.
            is_readable: whether its checksum matches. Of a frame whose checksum fails only the sequence number counts.

        Returns:
            Whether the frame is new; False for a copy of an earlier frame, which the caller ignores.
        """
        self._frame_count += 1
        if not is_readable:
            self._count_missing(sequence, None)
            return True
        reading = clock_reading(content, message_id)
        if self._is_copy(content, message_id, sequence, reading):
            self.copies += 1
            self._latest_slow_sequence = sequence
            return False
        # Later copies of this frame are recognised by its bytes.
        self.remember_frames([(self._frame_count, content)])
        self._count_missing(sequence, reading)
        # A second vehicle shows in readings that contradict each other or, if two counters number the frames, in
        # attitudes.
        if reading is not None:
            self.vehicles.add(reading)
        if self._has_two_counters:
            self.compare_attitude(content, message_id)
        return True

    # The following methods process several frames at once, among which there is no copy, while no slower link is
    # known. The state is the same afterwards as if ``process_frame`` had processed each of them.

    def count_frames_in_order(self, count: int, last_sequence: int) -> None:
        """Counts frames that continue the sequence numbers without a gap, so that none is missing.

        The first one follows the frame that was counted last. The result is the same as if
        :meth:`process_frame` had processed each of them.

        Args:
            count: Number of these frames.
            last_sequence: Sequence number of the last one, 0 to 255.
        """
        self._frame_count += count
        self._counters.count_in_order(count, last_sequence)
        self._latest_sequence = last_sequence
        # While a slower link is known, missing frames are found by comparing how many were sent and received since the
        # latest frame with a boot clock. If such a link appears later, that comparison begins at the last frame here.
        self._sequence_at_latest_reading = last_sequence
        self._received_since_reading = 0

    def count_frame(self, sequence: int) -> None:
        """Counts a frame by its sequence number, and the frames that are missing before it."""
        self._frame_count += 1
        self._count_missing(sequence, None)

    def compare_attitude(self, content: bytes, message_id: int) -> None:
        """Compares the attitude in a frame with the attitudes in the frames that the other counter numbers.

        Two counters number the frames of one autopilot that sends on two channels, or of two vehicles with the same
        ids. Two vehicles differ in attitude. A frame whose message has no attitude is ignored.

        Args:
            content: all bytes of the frame, which is readable and was counted last.
            message_id: MAVLink's number of its message (30 for ATTITUDE).
        """
        attitude = attitude_reading(_payload(content), message_id)
        if attitude is not None:
            self._attitudes.add(self._counters.latest, attitude)

    def add_readings(self, readings: ReadingColumns) -> None:
        """Adds the readings (n,) of the boot clock in frames that were counted before."""
        if len(readings.clock):
            self.vehicles.add_all(readings)
            self._latest_clock = float(readings.clock[-1])

    def remember_frames(self, contents: Iterable[tuple[int, bytes]]) -> None:
        """Stores readable frames, by which later copies are recognised, and drops all but the latest frames.

        Args:
            contents: for each frame in the order of the stream, its number among all frames received, from 1, and its
                bytes.
        """
        for frame_number, content in contents:
            # Only the latest of equal frames is kept, at the end of the order.
            self._frame_number_by_content.pop(content, None)
            self._frame_number_by_content[content] = frame_number
        while len(self._frame_number_by_content) > RECENT_FRAMES:
            self._frame_number_by_content.popitem(last=False)

    def _is_copy(
        self, content: bytes, message_id: int, sequence: int, reading: Reading | None
    ) -> bool:
        """Returns whether a readable frame is a copy of a recent frame, delivered by a second, slower link.

        A frame with a boot clock is a copy if a recent frame has the same bytes, since a vehicle sends no time twice.
        Such a copy proves that there is a slower link, and shows its delay. Both are stored here. A frame without a
        boot clock proves less (``_is_copy_without_boot_clock``).

        Args:
            content: all bytes of the frame.
            message_id: MAVLink's number of its message (30 for ATTITUDE).
            sequence: its sequence number, 0 to 255.
            reading: the boot clock in it; None if its message has none.

        Returns:
            Whether it is a copy.
        """
        earlier_frame_number = self._frame_number_by_content.get(content)
        if earlier_frame_number is None:
            return False
        if reading is None:
            return self._is_copy_without_boot_clock(
                earlier_frame_number, content, message_id, sequence
            )
        self._frame_count_at_latest_copy = self._frame_count
        self.longest_delay = max(self.longest_delay, self._latest_clock - reading.clock)
        return True

    def _is_copy_without_boot_clock(
        self, earlier_frame_number: int, content: bytes, message_id: int, sequence: int
    ) -> bool:
        """Returns whether a frame whose message has no boot clock is a copy of an earlier frame with the same bytes.

        Equal bytes alone are no proof: messages such as HEARTBEAT repeat their content, and after 256 frames the
        sequence number is the same again. The frame is a copy only if a second, slower link is known, and one of these
        holds:

        - it follows the earlier frame immediately, so that the sequence number cannot have come round;
        - its message has a time stamp of another clock, which seldom repeats;
        - its sequence number continues the numbers of the slower link.

        Args:
            earlier_frame_number: number of the earlier frame among all frames received, from 1.
            content: the bytes of both frames.
            message_id: MAVLink's number of their message (30 for ATTITUDE).
            sequence: their sequence number, 0 to 255.
        """
        if not self.has_slower_link:
            return False
        follows_immediately = self._frame_count - earlier_frame_number == 1
        if follows_immediately or _has_stamp(content, message_id):
            return True
        return self._continues_slower_link(sequence)

    def _continues_slower_link(self, sequence: int) -> bool:
        """Returns whether a sequence number continues the numbers of the slower link rather than of the faster one.

        It does if its step from the latest frame of the slower link is smaller than from the latest one of the faster.

        Args:
            sequence: the sequence number, 0 to 255.
        """
        step_on_slower_link = (sequence - self._latest_slow_sequence) % SEQUENCE_NUMBERS
        step_on_faster_link = (sequence - self._latest_sequence) % SEQUENCE_NUMBERS
        return step_on_slower_link < step_on_faster_link

    def _count_missing(self, sequence: int, reading: Reading | None) -> None:
        """Updates ``missing``, the number of frames that no link delivered, by the sequence number of a new frame.

        Usually the number is compared with the number of the frame before: the numbers that were passed over count as
        missing, until their frames come late. There are two other cases. If two counters number the frames, as of an
        autopilot that sends on two channels, the number is compared with the last one of the same counter. If a second,
        slower link is known, missing frames are counted between frames with a boot clock
        (``_count_missing_between_readings``).

        Args:
            sequence: sequence number of the frame, 0 to 255.
            reading: the boot clock in it; None if its message has none.
        """
        former_counter = self._counters.latest
        former_number_of_counter = self._counters.assign(sequence)
        if self._counters.latest != former_counter:
            self._recognise_two_counters()
        if self._frame_count == 1:
            # Nothing is missing before the first frame.
            self._latest_sequence = sequence
        if self.has_slower_link:
            self._count_missing_between_readings(sequence, reading)
            return
        are_counters_far_apart = self._has_two_counters and self._counters.are_far_apart
        if not are_counters_far_apart:
            self.missing += missing_messages(self._latest_sequence, sequence)
        elif former_number_of_counter is not None:
            self.missing += missing_messages(former_number_of_counter, sequence)
        self._latest_sequence = sequence
        if reading is not None:
            self._latest_clock = reading.clock
        # If a slower link appears later, missing frames are counted from this frame on.
        self._sequence_at_latest_reading = sequence
        self._received_since_reading = 0

    def _count_missing_between_readings(self, sequence: int, reading: Reading | None) -> None:
        """Updates ``missing`` by a new frame while a second, slower link is known.

        The frames of the two links arrive mixed, so that gaps between successive sequence numbers mean nothing. But the
        boot clock shows which frames are the latest. From one of the latest frames with a boot clock to the next, the
        vehicle sent as many frames as the sequence number rose. Those that were not received in this time are added to
        ``missing``; a frame that the slower link delivers afterwards is subtracted.

        Args:
            sequence: sequence number of the new frame, 0 to 255.
            reading: the boot clock in it; None if its message has none.
        """
        if reading is None:
            is_late = self._continues_slower_link(sequence)
        else:
            is_late = 0 < self._latest_clock - reading.clock <= MAX_LATE_SECONDS
        if is_late:
            self.missing -= 1
            self._latest_slow_sequence = sequence
            return
        self._received_since_reading += 1
        self._latest_sequence = sequence
        if reading is None:
            return
        sent_since_reading = (sequence - self._sequence_at_latest_reading) % SEQUENCE_NUMBERS
        # After a longer gap it is not known how often the numbers have started again at 0.
        if sent_since_reading <= MAX_MISSING_STEP:
            self.missing += sent_since_reading - self._received_since_reading
        self._sequence_at_latest_reading = sequence
        self._received_since_reading = 0
        self._latest_clock = reading.clock

    def _recognise_two_counters(self) -> None:
        """Decides, after a switch from one counter to the other, whether two counters number the frames.

        An autopilot that sends on two channels may number the frames of each by a counter of its own. This is
        recognised only after several switches. Until then the numbers are taken for those of a single counter: each
        switch looks like a gap, whose frames are counted in ``missing``. So at the recognition ``missing`` is set back
        to its value before the first of these switches, unless late frames have made it smaller since.

        This is done only if the numbers of the two counters are further apart than frames of a single one that overtake
        each other. Otherwise frames of a single counter may look like two, and the missing ones are really missing.
        """
        # ``missing`` as it was before each of the latest switches, as many as lead to the recognition. The frames that
        # this switch seems to miss are not counted yet.
        self._missing_at_switches.append(self.missing)
        had_two_counters = self._has_two_counters
        self._has_two_counters = self._counters.are_two_counters
        is_newly_recognised = self._has_two_counters and not had_two_counters
        if is_newly_recognised and self._counters.are_far_apart:
            missing_before_switches = self._missing_at_switches[0]
            self.missing = min(self.missing, missing_before_switches)


def clock_reading(content: bytes, message_id: int) -> Reading | None:
    """Returns the boot clock in a frame, with the heading or the position if its message has one.

    Args:
        content: all bytes of the frame.
        message_id: MAVLink's number of its message (30 for ATTITUDE).

    Returns:
        Time since boot, s, heading, rad, and position, degrees, the latter NaN unless sent. None for messages without a
        boot clock that the autopilot itself sets, and before the clock has begun.
    """
    layout = READING_LAYOUTS.get(message_id)
    if layout is None:
        return None
    # MAVLink 2 does not send the zeros at the end of a payload.
    full_payload = _payload(content)[: layout.size].ljust(layout.size, b"\0")
    values = layout.unpack(full_payload)
    clock = values[0] / CLOCK_UNITS_PER_SECOND
    if not clock:
        return None
    if layout is ATTITUDE_LAYOUT:
        _, _, pitch, yaw = values
        # Near the vertical, yaw is not a heading.
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
    """Returns whether the payload of a frame has a time stamp other than 0, which senders leave if they set none.

    The stamp need not be new: some messages repeat an old one, such as HOME_POSITION.

    Args:
        content: all bytes of the frame.
        message_id: MAVLink's number of its message (30 for ATTITUDE).
    """
    definition = definitions_by_id().get(message_id)
    if definition is None or definition.payload_type.fields is None:
        return False
    payload = _payload(content)
    for name in STAMP_FIELDS:
        if name in definition.payload_type.fields:
            field_type, offset = definition.payload_type.fields[name][:2]
            return any(payload[offset : offset + field_type.itemsize])
    return False


def _payload(content: bytes) -> bytes:
    """Returns the payload in the bytes of a frame, of either version of MAVLink."""
    start = HEADER_BYTES_V2 if content[0] == MARKER_V2 else HEADER_BYTES_V1
    return content[start : start + content[LENGTH_BYTE]]
