"""Recognition of two vehicles under the same MAVLink ids, by readings: the clock, heading and position in a message.

A vehicle that restarts, or whose estimate jumps, does not return to the former clock, heading or position. Readings
that go back and forth between two that disagree are of two vehicles.
"""

from collections import deque
from dataclasses import dataclass
from enum import Enum, auto
from math import cos, hypot, isnan, nan, pi, radians
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.ingest.mavlink.reference_clock import MAX_LATE_SECONDS

MAX_VEHICLES = 4
"""Number of vehicles under the same ids that are distinguished: a choice."""

MIN_CLOCK_STEPS = 3
"""Number of readings with a rising clock that make a track one of a vehicle: a choice."""

MAX_HEADING_DIFFERENCE = radians(20)
"""Difference of headings, rad, that is taken for one vehicle at one time: a choice."""

MAX_YAW_RATE = pi
"""Rate, rad/s, at which a heading may change between two readings: few multirotors yaw faster. A choice."""

MAX_POSITION_DIFFERENCE = 5.0
"""Distance, m, between two positions that is taken for one vehicle at one time: a choice."""

MAX_SPEED = 40.0
"""Speed, m/s, at which a position may change between two readings: few multirotors fly faster. A choice."""

METERS_PER_DEGREE = 111_195.0
"""Length of a degree of latitude, m: of a sphere with a radius of 6371 km."""


class Reading(NamedTuple):
    """What a vehicle reports of itself at one time of its boot clock."""

    clock: float
    """Time since boot, s."""

    heading: float = nan
    """Heading, rad; NaN where the message has none."""

    latitude: float = nan
    """Latitude, degrees; NaN where the message has none."""

    longitude: float = nan
    """Longitude, degrees; NaN where the message has none."""


class ReadingColumns(NamedTuple):
    """The n readings of a sender in the order of its stream, as columns (n,)."""

    clock: Array
    """Time since boot, s."""
    heading: Array
    """Heading, rad; NaN where the message has none."""
    latitude: Array
    """Latitude, degrees; NaN where the message has none."""
    longitude: Array
    """Longitude, degrees; NaN where the message has none."""

    def reading(self, row: int) -> Reading:
        """Returns one reading."""
        return Reading(*(float(column[row]) for column in self))

    def between(self, first: int, end: int) -> "ReadingColumns":
        """Returns the readings from one row to before another."""
        return ReadingColumns(*(column[first:end] for column in self))


class Contradiction(Enum):
    """What shows that two readings are not of one vehicle."""

    CLOCK = auto()
    POSITION = auto()
    HEADING = auto()


class SwitchLimit(NamedTuple):
    """How often readings must change between two vehicles until these count as two."""

    switches: int
    """Number of times that a reading is of the former vehicle again."""

    readings: int
    """Number of readings of this kind in which they are counted."""


SWITCH_LIMITS = {
    Contradiction.CLOCK: SwitchLimit(20, readings=200),
    Contradiction.POSITION: SwitchLimit(10, readings=100),
    Contradiction.HEADING: SwitchLimit(40, readings=120),
}
"""Limits by what contradicts: choices.

No vehicle returns to a former clock or position so often. One that tumbles turns its heading over and over, but hits
the ground before every third heading of 120 has changed.
"""

RECOGNITION_READINGS = 400
"""Number of readings after which two vehicles count as two no more, unless they are recognised again: a choice."""


@dataclass(slots=True)
class _VehicleTrack:
    """The latest readings that are consistent with one vehicle."""

    latest: Reading
    """The latest of all."""

    latest_heading: Reading | None = None
    """The latest with a heading."""

    latest_position: Reading | None = None
    """The latest with a position."""

    clock_advances: int = 0
    """Number of readings whose clock was ahead of the one before."""

    @property
    def has_advancing_clock(self) -> bool:
        """Whether the clock of its readings advances, as a vehicle's does; forged messages may repeat one time."""
        return self.clock_advances >= MIN_CLOCK_STEPS

    def add(self, reading: Reading) -> None:
        """Stores a reading as the latest of this vehicle, and counts it if its clock is ahead of the reading before.

        Args:
            reading: time since boot, s, and heading or position where they were sent; otherwise they are NaN.
        """
        if reading.clock > self.latest.clock:
            self.clock_advances += 1
        self.latest = reading
        if not isnan(reading.heading):
            self.latest_heading = reading
        if not isnan(reading.latitude):
            self.latest_position = reading

    def contradiction(self, reading: Reading) -> Contradiction | None:
        """Returns in which quantity a reading contradicts the latest readings of this vehicle.

        Two readings contradict each other if no multirotor moves or turns from one to the other in the time between
        them: the limit grows with the time by the largest speed and yaw rate.

        Args:
            reading: the next reading under the same ids.

        Returns:
            The first quantity that contradicts; None if the reading may be of this vehicle.
        """
        if abs(reading.clock - self.latest.clock) > MAX_LATE_SECONDS:
            return Contradiction.CLOCK
        if self.latest_position is not None and not isnan(reading.latitude):
            seconds = abs(reading.clock - self.latest_position.clock)
            max_distance = MAX_POSITION_DIFFERENCE + MAX_SPEED * seconds
            if _distance_between(self.latest_position, reading) > max_distance:
                return Contradiction.POSITION
        if self.latest_heading is not None and not isnan(reading.heading):
            seconds = abs(reading.clock - self.latest_heading.clock)
            max_turn = MAX_HEADING_DIFFERENCE + MAX_YAW_RATE * seconds
            if _turn_between(self.latest_heading, reading) > max_turn:
                return Contradiction.HEADING
        return None


class VehicleTracks:
    """Recognises two vehicles under the same ids: readings go back and forth between two tracks that contradict.

    A track has the readings that are consistent with one vehicle. A vehicle that restarts, or whose estimate jumps,
    does not return to the former clock, heading or position.

    Attributes:
        has_found_two_vehicles: whether two vehicles were recognised at any time.
    """

    def __init__(self) -> None:
        """Starts with no readings."""
        self.has_found_two_vehicles = False
        # The latest readings with a heading and with a position, of any vehicle.
        self._latest_heading: Reading | None = None
        self._latest_position: Reading | None = None
        # The track of the latest reading is the first.
        self._tracks: list[_VehicleTrack] = []
        # The number of readings so far that have each quantity; and this number at each of the latest switches
        # between tracks that contradict each other in it.
        self._reading_counts = dict.fromkeys(Contradiction, 0)
        self._counts_at_switches = {
            contradiction: deque[int](maxlen=limit.switches)
            for contradiction, limit in SWITCH_LIMITS.items()
        }
        # The number of readings at which two vehicles were recognised last.
        self._count_at_recognition = -RECOGNITION_READINGS

    @property
    def are_two_vehicles(self) -> bool:
        """Whether there are two at present: they were recognised within the latest ``RECOGNITION_READINGS``."""
        count = self._reading_counts[Contradiction.CLOCK]
        return count - self._count_at_recognition < RECOGNITION_READINGS

    def add(self, reading: Reading) -> None:
        """Adds the next reading to the track of the vehicle that it fits: the readings so far of one vehicle.

        Tracks are kept in the order of their latest readings, the most recent first, and are tried in this order. If
        the reading contradicts the first track but fits another, the messages have switched back to a former vehicle:
        the switch is recorded. If it fits none, a new track begins. Switches to or from a track whose clock does not
        advance, such as one of forged messages, do not count.

        Args:
            reading: Boot clock, and heading or position, in a message.
        """
        self._reading_counts[Contradiction.CLOCK] += 1
        if not isnan(reading.latitude):
            self._reading_counts[Contradiction.POSITION] += 1
            self._latest_position = reading
        if not isnan(reading.heading):
            self._reading_counts[Contradiction.HEADING] += 1
            self._latest_heading = reading
        contradiction_to_first_track = None
        for track_index, track in enumerate(self._tracks):
            contradiction = track.contradiction(reading)
            if contradiction is not None:
                if track_index == 0:
                    contradiction_to_first_track = contradiction
                continue
            track.add(reading)
            if contradiction_to_first_track is not None:
                if track.has_advancing_clock and self._tracks[0].has_advancing_clock:
                    self._record_switch(contradiction_to_first_track)
                self._tracks.insert(0, self._tracks.pop(track_index))
            return
        new_track = _VehicleTrack(reading)
        new_track.add(reading)
        self._tracks.insert(0, new_track)
        del self._tracks[MAX_VEHICLES:]

    def add_all(self, readings: ReadingColumns) -> None:
        """Adds many readings, with the same result as ``add`` for each, but faster.

        Readings that certainly do not contradict those before them are added together. Only the others are compared
        with every track.

        Args:
            readings: Clock, heading and position in n messages, in the order of the stream.
        """
        doubtful_rows = np.flatnonzero(_may_contradict(readings)).tolist()
        # First row of the consistent readings that are not added yet.
        first_row = 0
        for doubtful_row in doubtful_rows:
            self._add_consistent(readings.between(first_row, doubtful_row))
            self.add(readings.reading(doubtful_row))
            first_row = doubtful_row + 1
        self._add_consistent(readings.between(first_row, len(readings.clock)))

    def _add_consistent(self, readings: ReadingColumns) -> None:
        """Adds readings that are each consistent with the latest clock, heading and position before it.

        They belong to the first track, as the latest reading does. But the latest heading or position may be of another
        track; then the readings may contradict the first track nevertheless. Until both are of the first track,
        readings are compared with every track, one by one.

        Args:
            readings: The readings (n,), which may be none.
        """
        count = len(readings.clock)
        row = 0
        while row < count and not self._has_latest_heading_and_position():
            self.add(readings.reading(row))
            row += 1
        if row < count:
            self._extend_first_track(readings.between(row, count))

    def _has_latest_heading_and_position(self) -> bool:
        """Returns whether the latest heading and the latest position of all tracks are both of the first track."""
        track = self._tracks[0]
        return (
            track.latest_heading is self._latest_heading
            and track.latest_position is self._latest_position
        )

    def _extend_first_track(self, readings: ReadingColumns) -> None:
        """Adds several readings at once to the first track, with which they are known to be consistent.

        A track has the readings of one vehicle. The last reading with a clock, with a heading and with a position is
        stored: as the latest one of the track, and as that of all tracks, since these readings are the newest.

        Args:
            readings: The readings (n,), at least one.
        """
        track = self._tracks[0]
        # The clock of the track's latest reading, then the clocks of the new ones.
        clocks = np.append(track.latest.clock, readings.clock)
        track.clock_advances += int(np.count_nonzero(np.diff(clocks) > 0))
        track.latest = readings.reading(-1)
        # Every reading has a clock; without a heading or a position these are NaN.
        heading_rows = np.flatnonzero(~np.isnan(readings.heading))
        position_rows = np.flatnonzero(~np.isnan(readings.latitude))
        if len(heading_rows):
            self._latest_heading = readings.reading(int(heading_rows[-1]))
            track.latest_heading = self._latest_heading
        if len(position_rows):
            self._latest_position = readings.reading(int(position_rows[-1]))
            track.latest_position = self._latest_position
        self._reading_counts[Contradiction.CLOCK] += len(readings.clock)
        self._reading_counts[Contradiction.HEADING] += len(heading_rows)
        self._reading_counts[Contradiction.POSITION] += len(position_rows)

    def _record_switch(self, contradiction: Contradiction) -> None:
        """Records that the readings returned to an earlier track, and decides whether there are two vehicles.

        A single vehicle never returns to a clock, heading or position that it has left as often as two do. So there are
        two if the latest ``limit.switches`` returns came within ``limit.readings`` readings.

        Args:
            contradiction: Quantity in which the reading contradicts the track of the reading before: clock, heading or
                position.
        """
        # Number of readings so far that have this quantity, which serves as the time of the switch.
        reading_count = self._reading_counts[contradiction]
        limit = SWITCH_LIMITS[contradiction]
        counts_at_switches = self._counts_at_switches[contradiction]
        counts_at_switches.append(reading_count)
        readings_since_first = reading_count - counts_at_switches[0]
        if len(counts_at_switches) == limit.switches and readings_since_first <= limit.readings:
            self.has_found_two_vehicles = True
            self._count_at_recognition = self._reading_counts[Contradiction.CLOCK]


LIMIT_FACTOR = 1 - 1e-9
"""Factor by which limits are lowered where readings are compared as arrays: by more than the difference by rounding."""


def _distance_between(first: Reading, second: Reading) -> float:
    """Returns the horizontal distance between the positions of two readings, m."""
    north = second.latitude - first.latitude
    # A degree of longitude is shorter than one of latitude, by the cosine of the latitude.
    east = (second.longitude - first.longitude) * cos(radians(second.latitude))
    return METERS_PER_DEGREE * hypot(north, east)


def _turn_between(first: Reading, second: Reading) -> float:
    """Returns the angle between the headings of two readings, rad, by the shorter way around the circle."""
    turn = abs(second.heading - first.heading) % (2 * pi)
    return min(turn, 2 * pi - turn)


def _may_contradict(readings: ReadingColumns) -> Flags:
    """Flags readings that may contradict the readings before them; all others certainly do not.

    The test of ``_VehicleTrack.contradiction`` is applied to all readings at once: clock, position and heading may
    change only by as much as one vehicle can move or turn in the time between. The limits are lowered a little, since
    arrays may be rounded differently. The first reading, and the first with a heading or a position, are flagged too,
    since no reading precedes them.

    Args:
        readings: The readings (n,), NaN where a message has no heading or no position.

    Returns:
        Flags (n,).
    """
    # A comparison with NaN is false, so that a reading with NaN is flagged.
    is_clock_near = abs(np.diff(readings.clock)) <= MAX_LATE_SECONDS * LIMIT_FACTOR
    flags = np.concatenate([[True], ~is_clock_near])[: len(readings.clock)]

    # Each position is compared with the one before; messages without a position may come between them.
    position_rows = np.flatnonzero(~np.isnan(readings.latitude))
    flags[position_rows[:1]] = True
    flags[position_rows[1:]] |= ~_are_positions_near(
        readings.latitude[position_rows],
        readings.longitude[position_rows],
        readings.clock[position_rows],
    )

    # Each heading is compared with the one before, too.
    heading_rows = np.flatnonzero(~np.isnan(readings.heading))
    flags[heading_rows[:1]] = True
    flags[heading_rows[1:]] |= ~_are_headings_near(
        readings.heading[heading_rows], readings.clock[heading_rows]
    )
    return flags


def _are_positions_near(latitude: Array, longitude: Array, clock: Array) -> Flags:
    """Flags positions that one vehicle can reach from the position before.

    Args:
        latitude: (m,) degrees.
        longitude: (m,) degrees.
        clock: (m,) times of the positions since boot, s.

    Returns:
        Flags (m − 1,), of all positions but the first.
    """
    north = np.diff(latitude)
    east = np.diff(longitude) * np.cos(np.radians(latitude[1:]))
    distance = METERS_PER_DEGREE * np.hypot(north, east)
    max_distance = MAX_POSITION_DIFFERENCE + MAX_SPEED * abs(np.diff(clock))
    return np.asarray(distance <= max_distance * LIMIT_FACTOR)


def _are_headings_near(heading: Array, clock: Array) -> Flags:
    """Flags headings to which one vehicle can turn from the heading before, by the shorter way around the circle.

    Args:
        heading: (m,) rad.
        clock: (m,) times of the headings since boot, s.

    Returns:
        Flags (m − 1,), of all headings but the first.
    """
    turn = abs(np.diff(heading)) % (2 * pi)
    turn = np.minimum(turn, 2 * pi - turn)
    max_turn = MAX_HEADING_DIFFERENCE + MAX_YAW_RATE * abs(np.diff(clock))
    return np.asarray(turn <= max_turn * LIMIT_FACTOR)
