"""Two sequence counters under the same ids: two vehicles, or one vehicle that sends on two channels.

An autopilot numbers the frames of each of its channels on its own, so that two counters alone prove nothing. But one
vehicle has one attitude: what both counters report of the same time must agree within what the body rates allow. Two
vehicles that hover side by side with equal clocks and headings still lean and turn by some degrees differently.

Source: https://mavlink.io/en/guide/serialization.html (each channel counts its frames).
"""

import struct
from collections import OrderedDict, deque
from collections.abc import Sequence
from math import atan2, copysign, cos, hypot, inf, isfinite, pi, radians, sin
from typing import NamedTuple

from mavdem.ingest.mavlink.dialect import mavlink_message_id

SEQUENCE_NUMBERS = 256
"""Number of a sender's sequence numbers: they run from 0 to 255 and start again."""

MAX_COUNTER_STEP = 32
"""Largest step between two frames of one counter: a choice, 31 frames lost in a row."""

MIN_COUNTER_SWITCHES = 10
"""Number of times that the numbers must go back to the former counter until there are two: a choice."""

COUNTED_FRAMES = 1000
"""Number of frames in which they are counted: a choice, for senders that hand over 100 frames at once."""

MAX_COMPARED_SECONDS = 0.15
"""Longest time, s, between two attitudes that are compared: those of streams at 4 Hz can lie so far apart."""

REMEMBERED_INTERVALS = 80
"""Number of intervals of ``MAX_COMPARED_SECONDS`` of which an attitude is remembered: 12 s, as late as links are."""

MIN_ATTITUDE_DIFFERENCE = radians(0.5)
"""Difference of two attitudes at one time, rad, that is taken for one vehicle: a choice.

Both messages of one vehicle have the same estimate, to within the milliseconds of their stamps.
"""

RATE_ERROR_FRACTION = 0.5
"""Fraction of the predicted rotation by which it may be wrong: body rates are noisy, and change."""

MAX_ANGULAR_ACCELERATION = 20.0
"""Angular acceleration, rad/s², that may change the rates between two attitudes: what a multirotor keeps up.

A choice: manoeuvres reach more, but not in half of all comparisons.
"""

COMPARISONS = 100
"""Number of latest comparisons that decide: a choice, 2 s of attitude at 50 Hz and more."""

MIN_COMPARISON_STEP = 0.02
"""Least time, s, from one comparison to the next, so that those that decide span 2 s at any rate.

Frames that overtake each other look like a second counter. At 400 Hz, 100 comparisons of one vehicle in a quick
manoeuvre then took 0.25 s, and half of them contradicted each other.
"""

MIN_CONTRADICTIONS = 50
"""Number of these that must contradict each other until there are two vehicles.

A choice: one vehicle never contradicts itself for seconds, and two seldom lean alike for half of the time.
"""

TIME_UNITS_PER_SECOND = 1000.0
"""Units of ``time_boot_ms`` in a second."""

EULER_LAYOUT = struct.Struct("<I6f")
"""ATTITUDE: ``time_boot_ms``, three angles, rad, and three body rates, rad/s."""

QUATERNION_LAYOUT = struct.Struct("<I7f")
"""Beginning of ATTITUDE_QUATERNION: ``time_boot_ms``, w, x, y and z, and three body rates, rad/s."""

ATTITUDE_LAYOUTS = {
    mavlink_message_id("ATTITUDE"): EULER_LAYOUT,
    mavlink_message_id("ATTITUDE_QUATERNION"): QUATERNION_LAYOUT,
}
"""Layout of the payloads with an attitude, by message id."""


class AttitudeReading(NamedTuple):
    """An attitude that a vehicle reports of one time."""

    clock: float
    """Time since boot, s."""

    quaternion: list[float]
    """Unit quaternion w, x, y and z of the rotation from body to earth."""

    rates: list[float]
    """Body rates about the three axes, rad/s."""


class SequenceCounters:
    """Recognises whether the frames of one sender are numbered by one counter or by two.

    A frame belongs to the counter that it follows most closely. One that follows neither begins a counter again.

    Attributes:
        latest: which of both counters numbered the latest frame, 0 or 1.
    """

    def __init__(self) -> None:
        """Starts with no frames."""
        self.latest = 0
        # The latest number of each counter; None before its first frame.
        self._numbers: list[int | None] = [None, None]
        self._frame_count = 0
        # Number of frames received up to each of the latest switches back to the former counter.
        self._frame_counts_at_switches = deque[int](maxlen=MIN_COUNTER_SWITCHES)

    @property
    def are_two_counters(self) -> bool:
        """Whether the frames alternate between two counters: ``MIN_COUNTER_SWITCHES`` times in ``COUNTED_FRAMES``."""
        if len(self._frame_counts_at_switches) < MIN_COUNTER_SWITCHES:
            return False
        frames_since_first_switch = self._frame_count - self._frame_counts_at_switches[0]
        return frames_since_first_switch <= COUNTED_FRAMES

    @property
    def are_far_apart(self) -> bool:
        """Whether the latest numbers of the two counters are further apart than ``MAX_COUNTER_STEP``, either way.

        Frames of a single counter that overtake each other are closer, and may look like two counters. Distances are
        taken around the circle of the 256 numbers.
        """
        first_number, second_number = self._numbers
        if first_number is None or second_number is None:
            return False
        distance = (first_number - second_number) % SEQUENCE_NUMBERS
        distance_around = min(distance, SEQUENCE_NUMBERS - distance)
        return distance_around > MAX_COUNTER_STEP

    def count_in_order(self, count: int, last_sequence: int) -> None:
        """Assigns several frames, whose sequence numbers follow without a gap, to the counter of the latest frame.

        The result is the same as if ``assign`` had assigned each of them, but faster.

        Args:
            count: Number of these frames.
            last_sequence: Sequence number of the last one, 0 to 255.
        """
        self._frame_count += count
        self._numbers[self.latest] = last_sequence

    def assign(self, sequence: int) -> int | None:
        """Assigns the next frame of the sender, which is not a copy, to one of the two counters by its sequence number.

        It belongs to the counter whose latest number it follows in the smaller step. If both steps are too large, the
        counter that was not used last begins anew with it. ``latest`` becomes the counter of this frame. A switch back
        to the former counter is recorded, since frames that alternate show that there are two counters.

        Args:
            sequence: its sequence number, 0 to 255.

        Returns:
            The number of the frame before it on the same counter; None if it begins a counter.
        """
        self._frame_count += 1
        latest_counter = self.latest
        other_counter = 1 - latest_counter
        latest_number = self._numbers[latest_counter]
        if latest_number is not None and (sequence - latest_number) % SEQUENCE_NUMBERS == 1:
            # The usual case, decided first since it is fast.
            self._numbers[latest_counter] = sequence
            return latest_number
        other_number = self._numbers[other_counter]
        latest_step = _step(latest_number, sequence)
        other_step = _step(other_number, sequence)
        if min(latest_step, other_step) > MAX_COUNTER_STEP:
            # The counter in use is kept. The other one may date from before a restart, and is replaced.
            self._numbers[other_counter] = sequence
            self.latest = other_counter
            return None
        if latest_step <= other_step:
            self._numbers[latest_counter] = sequence
            return latest_number
        self._numbers[other_counter] = sequence
        self.latest = other_counter
        self._frame_counts_at_switches.append(self._frame_count)
        return other_number


def _step(number: int | None, sequence: int) -> int:
    """Returns the step from one sequence number to the next, 1 to 256; 256 if they are equal or one is missing."""
    if number is None:
        return SEQUENCE_NUMBERS
    return (sequence - number - 1) % SEQUENCE_NUMBERS + 1


class AttitudeComparison:
    """Compares the attitudes in frames of two sequence counters, and decides whether they contradict each other.

    Attributes:
        has_found_two_vehicles: whether they were of two vehicles at any time.
    """

    def __init__(self) -> None:
        """Starts with no attitudes."""
        self.has_found_two_vehicles = False
        # Each counter has the latest attitude in each interval of ``MAX_COMPARED_SECONDS``, the oldest interval first.
        self._attitudes: list[OrderedDict[int, AttitudeReading]] = [OrderedDict(), OrderedDict()]
        # Whether the attitudes contradicted each other in each of the latest comparisons.
        self._contradictions = deque[bool](maxlen=COMPARISONS)
        # The clock, s, of the attitude that was compared last.
        self._compared_clock = -inf

    @property
    def are_two_vehicles(self) -> bool:
        """Whether the latest attitudes are of two vehicles."""
        return sum(self._contradictions) >= MIN_CONTRADICTIONS

    def add(self, counter: int, reading: AttitudeReading) -> None:
        """Adds the next attitude, and compares it with the other counter's attitude that is nearest in time.

        Two attitudes that contradict each other are of two vehicles. An attitude within ``MIN_COMPARISON_STEP`` of the
        one that was compared last is not compared, so that the latest comparisons span some seconds at any rate.

        Args:
            counter: number of the sequence counter of its frame, 0 or 1.
            reading: the attitude, with its time since boot.
        """
        # Each counter has one attitude per interval of ``MAX_COMPARED_SECONDS``. So the nearest one is in this
        # interval, the one before, or the one after.
        interval = int(reading.clock / MAX_COMPARED_SECONDS)
        attitudes = self._attitudes[counter]
        attitudes[interval] = reading
        attitudes.move_to_end(interval)
        if len(attitudes) > REMEMBERED_INTERVALS:
            attitudes.popitem(last=False)
        if abs(reading.clock - self._compared_clock) < MIN_COMPARISON_STEP:
            return
        other_attitudes = self._attitudes[1 - counter]
        nearest_attitude = None
        nearest_seconds = MAX_COMPARED_SECONDS
        for near_interval in (interval - 1, interval, interval + 1):
            candidate = other_attitudes.get(near_interval)
            if candidate is not None and abs(candidate.clock - reading.clock) <= nearest_seconds:
                nearest_attitude = candidate
                nearest_seconds = abs(candidate.clock - reading.clock)
        if nearest_attitude is not None:
            self._compared_clock = reading.clock
            self._contradictions.append(attitudes_contradict(nearest_attitude, reading))
            self.has_found_two_vehicles |= self.are_two_vehicles


def attitudes_contradict(first_reading: AttitudeReading, second_reading: AttitudeReading) -> bool:
    """Returns whether two attitudes differ by more than one vehicle can turn in the time between them.

    Args:
        first_reading: the earlier or the later attitude.
        second_reading: the other one, at most some tenths of a second apart.
    """
    seconds = second_reading.clock - first_reading.clock
    acceleration_angle = MAX_ANGULAR_ACCELERATION * seconds**2 / 2
    # Euler angles would contradict each other while a vehicle tumbles: upside down they turn against the body rates.
    rotations = _rotation_vector(first_reading.quaternion, second_reading.quaternion)
    for axis, rotation in enumerate(rotations):
        predicted_rotation = (first_reading.rates[axis] + second_reading.rates[axis]) / 2 * seconds
        # A rotation about an axis is known but for whole turns.
        difference = abs((rotation - predicted_rotation + pi) % (2 * pi) - pi)
        rate_error = RATE_ERROR_FRACTION * abs(predicted_rotation)
        if difference > MIN_ATTITUDE_DIFFERENCE + rate_error + acceleration_angle:
            return True
    return False


def _rotation_vector(
    first_attitude: Sequence[float], second_attitude: Sequence[float]
) -> list[float]:
    """Returns the rotation from one attitude to another about the three body axes, rad.

    Args:
        first_attitude: unit quaternion (w, x, y, z) of the rotation from body to earth.
        second_attitude: the same of the attitude after the rotation.

    Returns:
        The rotation vector, whose length is the angle of the rotation, 0 to π.
    """
    w1, x1, y1, z1 = first_attitude
    w2, x2, y2, z2 = second_attitude
    # The quaternion of the rotation is the inverse of the first one times the second one.
    w = w1 * w2 + x1 * x2 + y1 * y2 + z1 * z2
    vector = [
        w1 * x2 - x1 * w2 - y1 * z2 + z1 * y2,
        w1 * y2 - y1 * w2 - z1 * x2 + x1 * z2,
        w1 * z2 - z1 * w2 - x1 * y2 + y1 * x2,
    ]
    sine = hypot(*vector)
    # A quaternion and its negative are the same rotation; the shorter one of both is taken.
    angle = 2 * atan2(sine, abs(w))
    scale = copysign(angle / sine, w) if sine > 0 else 0.0
    return [scale * component for component in vector]


def attitude_reading(payload: bytes, message_id: int) -> AttitudeReading | None:
    """Returns the attitude that a message reports, as a quaternion.

    Args:
        payload: payload of the message, without the zeros at its end that MAVLink 2 leaves out.
        message_id: MAVLink's number of the message (30 for ATTITUDE).

    Returns:
        Time, s, quaternion, and body rates, rad/s; None for a message without an attitude, for angles that are not
        finite, and for a time of 0: the boot clock has not begun.
    """
    layout = ATTITUDE_LAYOUTS.get(message_id)
    if layout is None:
        return None
    full_payload = payload[: layout.size].ljust(layout.size, b"\0")
    # Both layouts begin with the time and end with the three body rates; angles or a quaternion are between.
    milliseconds, *attitude, roll_rate, pitch_rate, yaw_rate = layout.unpack(full_payload)
    clock = milliseconds / TIME_UNITS_PER_SECOND
    if not clock or not all(isfinite(value) for value in attitude):
        return None
    rates = [roll_rate, pitch_rate, yaw_rate]
    if layout is EULER_LAYOUT:
        return AttitudeReading(clock, _quaternion_of_angles(*attitude), rates)
    return AttitudeReading(clock, attitude, rates)


def _quaternion_of_angles(roll: float, pitch: float, heading: float) -> list[float]:
    """Returns the quaternion (w, x, y, z) of rotations by heading, pitch and roll, rad, in this order."""
    cos_roll, sin_roll = cos(roll / 2), sin(roll / 2)
    cos_pitch, sin_pitch = cos(pitch / 2), sin(pitch / 2)
    cos_heading, sin_heading = cos(heading / 2), sin(heading / 2)
    return [
        cos_roll * cos_pitch * cos_heading + sin_roll * sin_pitch * sin_heading,
        sin_roll * cos_pitch * cos_heading - cos_roll * sin_pitch * sin_heading,
        cos_roll * sin_pitch * cos_heading + sin_roll * cos_pitch * sin_heading,
        cos_roll * cos_pitch * sin_heading - sin_roll * sin_pitch * cos_heading,
    ]
