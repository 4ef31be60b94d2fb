"""How fast the boot clock of a live vehicle runs against the clock of this computer.

A simulator that falls behind real time sends 100 messages in a second of its own clock, and yet a few in a second of
this computer's clock. All rates of a session are by the vehicle's clock, by which its rows are made.
"""

from collections import deque
from collections.abc import Callable
from math import isnan
from typing import NamedTuple

from mavdem.facts import Fact
from mavdem.facts.session import RateFact
from mavdem.live.samples import DECISION_SECONDS

SPEED_WINDOW_SECONDS = 5.0
"""Time over which the speed is measured, s of this computer's clock: that over which rates are measured."""

READING_PERIOD = DECISION_SECONDS / 4
"""Least time, s, between two readings from which a measurement can begin: a quarter of the shortest one, a choice."""

MIN_REAL_TIME_SPEED = 0.8
"""Speed below which a vehicle's clock is reported as slow: a choice, for links that deliver in bursts."""

SLOW_SECONDS = 10.0
"""Time for which a clock must be slow before that is reported, s: a delay that grows on a slow link ends earlier."""


class _ClockReading(NamedTuple):
    """The readings of both clocks when the vehicle's clock had just advanced."""

    arrival_time: float
    """Reading of this computer's clock, s."""

    vehicle_time: float
    """Reading of the vehicle's boot clock, s."""


class ClockSpeed:
    """Measures the speed of a vehicle's clock, and reports once that it is slow.

    Attributes:
        speed: seconds of the vehicle's clock in one of this computer's; 1 before it is measured. The last measurement
            stays while the vehicle's clock does not advance, since then its attitude does not come.
    """

    def __init__(self, log: Callable[[Fact], None]) -> None:
        """Begins without a reading; until the speed is measured, both clocks count as equally fast.

        Args:
            log: is called with the fact that the vehicle's clock is slow.
        """
        self.speed = 1.0
        self._log = log
        # Seconds of the vehicle's clock, without its jumps, and s of this computer's clock, at the latest advance.
        self._elapsed_seconds = 0.0
        self._advance_time: float | None = None
        # Readings from which a measurement can begin, the oldest first, and the latest reading.
        self._readings = deque[_ClockReading]()
        self._latest: _ClockReading | None = None
        # The time since which the clock has been slow, s of this computer's clock; None while it is not.
        self._slow_since: float | None = None
        self._is_reported = False

    def real_seconds(self, vehicle_seconds: float) -> float:
        """Converts a duration on the vehicle's clock to the duration on this computer's clock, s.

        A speed close to 1 counts as 1, since it is measured with the jitter of arrivals.

        Args:
            vehicle_seconds: duration on the vehicle's clock, s.

        Returns:
            The duration on this computer's clock, s.
        """
        if MIN_REAL_TIME_SPEED <= self.speed <= 1 / MIN_REAL_TIME_SPEED:
            return vehicle_seconds
        return vehicle_seconds / self.speed

    def elapsed_seconds(self, now: float) -> float:
        """Returns the seconds of the vehicle's clock so far, without its jumps; only differences have a meaning.

        The vehicle's clock advances with each attitude. Since the last one it is taken to run at the measured speed.

        Args:
            now: s of this computer's monotonic clock.
        """
        if self._advance_time is None:
            return now
        return self._elapsed_seconds + (now - self._advance_time) * self.speed

    def update(self, now: float, vehicle_time: float) -> None:
        """Takes the present readings of both clocks, and measures the speed if the vehicle's clock has advanced.

        The seconds of the vehicle's clock so far (:meth:`elapsed_seconds`) advance by the step of the clock. If the
        clock has jumped, they advance by the measured speed instead.

        Args:
            now: s of this computer's monotonic clock.
            vehicle_time: latest time of the vehicle's boot clock, s; NaN before any.
        """
        if self._advance_time is None:
            # Only differences of these seconds have a meaning, so that they may begin with any number.
            self._elapsed_seconds = now
            self._advance_time = now
        former_reading = self._latest
        stands_still = former_reading is not None and vehicle_time == former_reading.vehicle_time
        if isnan(vehicle_time) or stands_still:
            return
        reading = _ClockReading(now, vehicle_time)
        # Where the clock has jumped, or was not read before, its step is unknown.
        elapsed_seconds = self.elapsed_seconds(now)
        if former_reading is not None:
            step = vehicle_time - former_reading.vehicle_time
            has_jumped = step <= 0 or step >= SPEED_WINDOW_SECONDS
            if has_jumped or _is_after_silence(reading, former_reading):
                self._restart_measurement()
            if not has_jumped:
                elapsed_seconds = self._elapsed_seconds + step
        self._elapsed_seconds = elapsed_seconds
        self._advance_time = now
        self._latest = reading
        self._measure_speed(reading)

    def _restart_measurement(self) -> None:
        """Forgets the readings so far; the last measured speed stays until there is another one."""
        self._readings.clear()
        self._slow_since = None

    def _measure_speed(self, reading: _ClockReading) -> None:
        """Measures the speed between a reading about ``SPEED_WINDOW_SECONDS`` ago and the latest one.

        It is the time that passed on the vehicle's clock over the time that passed on this computer's.

        Args:
            reading: the latest readings of both clocks.
        """
        now = reading.arrival_time
        readings = self._readings
        if not readings or now - readings[-1].arrival_time >= READING_PERIOD:
            readings.append(reading)
        # The window begins with the latest reading that is old enough.
        while len(readings) > 1 and readings[1].arrival_time <= now - SPEED_WINDOW_SECONDS:
            readings.popleft()
        start = readings[0]
        duration = now - start.arrival_time
        # The jitter of arrivals would dominate a speed over a shorter time.
        if duration < DECISION_SECONDS / 2:
            return
        self.speed = (reading.vehicle_time - start.vehicle_time) / duration
        self._report_slow_clock(now)

    def _report_slow_clock(self, now: float) -> None:
        """Reports, once, that the vehicle's clock has been slow for ``SLOW_SECONDS``.

        Args:
            now: s of this computer's monotonic clock.
        """
        if self.speed >= MIN_REAL_TIME_SPEED:
            self._slow_since = None
            return
        if self._slow_since is None:
            self._slow_since = now
        if not self._is_reported and now - self._slow_since >= SLOW_SECONDS:
            self._is_reported = True
            self._log(Fact(RateFact.VEHICLE_CLOCK_SLOW, clock_speed=self.speed))


def _is_after_silence(reading: _ClockReading, former_reading: _ClockReading) -> bool:
    """Returns whether so long a silence lay between two successive readings that they measure no speed.

    A simulator that was paused goes on with the next time of its clock, as if the clock had run slowly meanwhile.
    """
    return reading.arrival_time - former_reading.arrival_time >= SPEED_WINDOW_SECONDS
