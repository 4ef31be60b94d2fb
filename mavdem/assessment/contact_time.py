"""When a vehicle touched the ground: by facts (coded findings) on knocks, a lost attitude, or a sudden stop."""

from dataclasses import dataclass
from math import inf

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.attitude_losses import knock_is_contact
from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.dataset.grounded import MAX_SETPOINT_DELAY
from mavdem.dataset.intervals import TimeInterval, in_intervals
from mavdem.dataset.time_series import series_of_boot
from mavdem.facts import Fact
from mavdem.facts.witnesses import Side
from mavdem.witnesses.boot_sensors import BootSensors

TOPPLE_HEIGHT_CLOSED = 3.0
"""Height, m, above take-off or resting place up to which a vehicle that topples was landing, if the pilot closed the
throttle: by then it has fallen for a moment."""

KNOCK_SECONDS = 0.1
"""Longest time, s, from the first large sample of a knock to its peak; a choice."""

MIN_FALL_SECONDS = 0.5
"""Seconds in which a vehicle that loses its attitude in the air falls 1.2 m. A knock that comes earlier came first."""

VIBRATION_SECONDS = 1.0
"""Duration, s, of the windows of flight whose largest specific forces show how large a knock by vibration may be."""

MIN_VIBRATION_WINDOWS = 5
"""Number of such windows from which on the scatter of their largest forces is known; a choice."""

MAX_VIBRATION_QUARTILE_RANGES = 4.2
"""Interquartile ranges above the median of the largest forces that vibration reaches in one window of 1000.

The largest of many samples follows a Gumbel distribution, which exceeds that with a probability of 0.0009. Median and
quartiles do not depend on single knocks before, such as at the take-off, which are no vibration.
"""

IMPACT_SPEED_CHANGE = 3.0
"""Decrease of the speed downward, m/s, within ``IMPACT_SECONDS`` that shows an impact; also the least speed before it.

It takes a mean of 10 m/s² upward in addition to the weight, more than autopilots use to end a descent.
"""

IMPACT_SECONDS = 0.3
"""Duration, s, over which the decrease of the speed in an impact is measured."""


@dataclass(frozen=True, eq=False)
class ContactSearch:
    """The search for the moment at which a flight met the ground; all times are s since boot."""

    sensors: BootSensors
    """Sensors of the boot, with the take-off of this flight."""
    flight_start: float
    """Start of the flight, s since boot."""
    loss: Fact | None
    """The loss of attitude that the flight did not recover from; None if there was none."""

    def contact_time(self, start: float, end: float) -> float | None:
        """Returns the time at which the vehicle touched the ground.

        The first of these that the sensors show is the contact: the largest knock of the accelerometer, if it exceeds
        the vibration in flight; the loss of attitude, if that was near the ground; and, only if no accelerometer is
        fast enough to show knocks, the moment at which the estimated speed downward was suddenly lost.

        Args:
            start: beginning of the search, s since boot.
            end: its end, s since boot.

        Returns:
            The time, s since boot; None if no sensor shows it.
        """
        accelerometer = self.sensors.accelerometer
        if accelerometer is not None and accelerometer.peak((start, end)) is not None:
            knock = self._largest_contact_knock(start, end)
            if knock is not None and self._exceeds_vibration(knock, start):
                return knock.time
            if accelerometer.shows_knocks:
                # A vehicle can touch the ground without a knock only if it topples.
                return self.time_of_loss_near_ground()
        loss_time = self.time_of_loss_near_ground()
        if loss_time is not None:
            return loss_time
        return self.time_of_sudden_stop((start, end + RECOVERY_SECONDS))

    def first_knock(self, start: float, largest_knock_time: float) -> float:
        """Returns the time of the peak of the first knock that is larger than the vibration before.

        A vehicle that falls over hits the ground several times, and the first contact need not be the hardest.

        Args:
            start: time when the attitude was lost, s since boot. Near the ground that may be shortly before the
                contact.
            largest_knock_time: time of the largest knock, s since boot; returned if no earlier one is measured.

        Returns:
            The time, s since boot.
        """
        accelerometer = self.sensors.accelerometer
        if accelerometer is None or start >= largest_knock_time:
            return largest_knock_time
        # A knock with its peak at the loss of attitude begins up to ``KNOCK_SECONDS`` earlier.
        search_start = start - KNOCK_SECONDS
        min_knock = accelerometer.knock_size
        # The take-off itself knocks, and is left out.
        undisturbed_flight = (self.flight_start + MAX_SETPOINT_DELAY, search_start)
        vibration = accelerometer.peak(undisturbed_flight)
        if vibration is not None:
            min_knock = max(min_knock, vibration.size)
        time = accelerometer.time
        is_searched = (time >= search_start) & (time <= largest_knock_time)
        knock_times = time[is_searched & (accelerometer.magnitude >= min_knock)]
        if not len(knock_times):
            return largest_knock_time
        knock_start = float(knock_times[0])
        knock_end = min(knock_start + KNOCK_SECONDS, largest_knock_time)
        peak = accelerometer.peak((knock_start, knock_end))
        return knock_start if peak is None else peak.time

    def time_of_loss_near_ground(self) -> float | None:
        """Returns the time at which the attitude was lost, s, if that was near the ground; None otherwise."""
        if self.loss is None or self.loss.time is None:
            return None
        height = self.sensors.height_at(self.loss.time)
        is_low = height is not None and height < TOPPLE_HEIGHT_CLOSED
        return self.loss.time if is_low else None

    def time_of_sudden_stop(self, interval: TimeInterval) -> float | None:
        """Returns the time at which the estimated speed downward was suddenly lost.

        A candidate is a sample from which on the speed downward decreases by more than ``IMPACT_SPEED_CHANGE`` within
        ``IMPACT_SECONDS``. The impact is at the largest decrease in one step after the first candidate.

        Args:
            interval: start and end of the time to examine, s.

        Returns:
            The time, s since boot; None if no speed was lost suddenly, or no vertical speed was recorded.
        """
        climb_rate = series_of_boot(self.sensors.signals.climb_rate, self.sensors.boot)
        if climb_rate is None:
            return None
        time = climb_rate.time
        upward_speed = climb_rate.values
        speed_later = np.interp(time + IMPACT_SECONDS, time, upward_speed)
        is_searched = in_intervals(time, [interval])
        is_sinking = upward_speed < -IMPACT_SPEED_CHANGE
        is_braked = speed_later - upward_speed > IMPACT_SPEED_CHANGE
        candidates = time[is_searched & is_sinking & is_braked]
        if not len(candidates):
            return None
        # The motors may have slowed the fall before the ground stopped it. The step with the largest loss of speed is
        # that at the ground.
        stop_start = candidates[0]
        is_stopping = in_intervals(time, [(stop_start, stop_start + IMPACT_SECONDS)])
        speed_steps: Array = np.diff(upward_speed, append=upward_speed[-1])
        impact_sample = int(np.argmax(np.where(is_stopping, speed_steps, -inf)))
        is_fast_before_impact = -upward_speed[impact_sample] > IMPACT_SPEED_CHANGE
        if not is_fast_before_impact:
            return None
        return float(time[impact_sample])

    def _largest_contact_knock(self, start: float, end: float) -> Fact | None:
        """Returns the largest knock of an interval that can be a contact with the ground.

        A knock high in the air is no contact: a propeller that breaks knocks too. After such a knock the search
        continues.

        Args:
            start: beginning of the interval, s since boot.
            end: its end, s since boot.

        Returns:
            The fact of the accelerometer that it measured the knock; None if it measured no such knock.
        """
        search_start = start
        while search_start < end:
            knock = self.sensors.knock_fact((search_start, end))
            # The fact may also say that the accelerometer measured no knock, which contradicts a contact.
            if knock is None or knock.figures["side"] != Side.FOR or knock.time is None:
                return None
            if knock_is_contact(self.sensors, knock.time):
                return knock
            search_start = knock.time + MIN_FALL_SECONDS
        return None

    def _exceeds_vibration(self, knock: Fact, start: float) -> bool:
        """Returns whether a knock is larger than the specific forces that vibration causes in flight.

        The knock must exceed the largest force before the search. By chance, vibration alone exceeds that in half of
        all searches that last as long as the flight before. So the knock must also exceed an upper fence for the peaks
        of vibration: their median over windows of ``VIBRATION_SECONDS``, and a multiple of their interquartile range.

        Args:
            knock: fact that the accelerometer measured the knock.
            start: beginning of the search, s since boot, up to which the flight was undisturbed.
        """
        accelerometer = self.sensors.accelerometer
        assert accelerometer is not None
        # The take-off of a vehicle that was first received in flight has the time minus infinity.
        first_sample = float(accelerometer.time[0])
        vibration_start = max(self.flight_start + MAX_SETPOINT_DELAY, first_sample)
        vibration = accelerometer.peak((vibration_start, start))
        if vibration is None:
            return True
        largest_force = vibration.size
        window_peaks = accelerometer.window_peaks((vibration_start, start), VIBRATION_SECONDS)
        if len(window_peaks) >= MIN_VIBRATION_WINDOWS:
            lower_quartile, median, upper_quartile = np.quantile(window_peaks, [0.25, 0.5, 0.75])
            interquartile_range = float(upper_quartile - lower_quartile)
            upper_fence = float(median) + MAX_VIBRATION_QUARTILE_RANGES * interquartile_range
            largest_force = max(largest_force, upper_fence)
        return bool(knock.figures["acceleration"] > largest_force)
