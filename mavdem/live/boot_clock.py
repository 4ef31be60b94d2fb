"""The boot clock of a live vehicle: the time of each message, across wraps, jumps and reboots.

Time stamps of attitude are the reference. The stamp of any other message is taken at the multiple of its wrap period
that is nearest to the latest reference, and a message without a stamp gets the time of the message before it.
"""

from collections.abc import Callable
from math import isfinite, isnan, nan
from typing import NamedTuple

import numpy as np

from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.dataset.intervals import TimeInterval
from mavdem.facts import Fact
from mavdem.facts.session import VehicleFact
from mavdem.ingest.mavlink.clock_readings import MAX_STAMP_DEVIATION
from mavdem.ingest.mavlink.reference_clock import (
    MAX_LATE_SECONDS,
    MAX_RESTART_TIME,
    MAX_WRAP_GAP,
    MIN_RESET_STAMPS,
    MIN_RESET_STEP,
    rises_steadily,
)
from mavdem.ingest.other_recordings import MAX_UTC_DIFFERENCE
from mavdem.live.messages import Message

STEP_MEMORY = 64
"""Number of attitudes over which the mean step between their stamps is averaged: a choice."""


class TimedMessage(NamedTuple):
    """A message with its time on the boot clock."""

    message: Message

    time: float
    """Time, s of the boot clock."""

    boot: int
    """Number of the vehicle's boot, from 0 on."""

    has_own_stamp: bool
    """Whether the time is from the message's own stamp, not from the message before it."""


class BootClock:
    """Gives the messages of one vehicle their time on its boot clock.

    A message whose stamp does not continue the clock is dropped. If the next attitude stamps continue from there, the
    clock has changed: it jumped ahead, or it went back. That is a reboot if it begins near zero, or if it can have
    begun while nothing was received; otherwise the messages are of another sender or another time.

    Attributes:
        now: the latest attitude stamp, s; NaN before any.
        boot: number of the boot, from 0 on.
        latest_restart: when the last attitude of the former clock and the first one of the present clock were received,
            UNIX s; None before any restart. The vehicle restarted between.
    """

    def __init__(self, report: Callable[[Fact], None]) -> None:
        """Makes a clock without a time, which the first attitude gives it.

        Args:
            report: is called with the fact about each reboot and each jump of the clock.
        """
        self.now = nan
        self.boot = 0
        self.latest_restart: TimeInterval | None = None
        self._report = report
        # Time of the latest message of any name, s; messages without a stamp get it.
        self._latest_time = nan
        # How often the stamp of attitude has wrapped to zero in this boot.
        self._wraps = 0
        # Successive attitude stamps that continue each other, but not the clock, s.
        self._stamps_of_new_clock: list[float] = []
        # When the first of these was received, UNIX s.
        self._new_clock_reception = nan
        # When the latest message was received, and when the clock read 0 by the latest attitude, UNIX s.
        self._reception_time = nan
        self._boot_time = nan
        # Mean step of the attitude stamps, s.
        self._mean_step = MIN_RESET_STEP

    def place(self, message: Message, reception: float) -> TimedMessage | None:
        """Gives a message its time on the boot clock, which counts from the start of the autopilot.

        Only attitude moves the clock. It is frequent and stamped by the autopilot itself, while other stamps may be of
        other clocks. A message without a stamp gets the time of the message before it.

        Args:
            message: a message of this vehicle, in the order of arrival. Its ``stamp`` is in s, 0 for none.
            reception: time when it was received, UNIX s.

        Returns:
            The message; None if it has no time and is dropped.
        """
        self._reception_time = reception
        has_own_stamp = message.stamp > 0
        if not has_own_stamp:
            time = None if isnan(self._latest_time) else self._latest_time
        elif message.name in ATTITUDE_MESSAGES:
            time = self._advance_to_attitude(message)
        else:
            time = self._time_near_now(message)
        if time is None:
            return None
        self._latest_time = time
        return TimedMessage(message, time, self.boot, has_own_stamp)

    def _advance_to_attitude(self, message: Message) -> float | None:
        """Advances the clock to an attitude, and returns the time of the attitude.

        Attitudes come most often of all messages, so that only their stamps advance the clock. A stamp that does not
        continue it may be damaged, or be the first one after a restart of the autopilot. So it is left out until
        further stamps show that the autopilot counts from a new start (:meth:`_begins_new_clock`).

        Args:
            message: an attitude with a stamp, s, whose counter begins again after ``wrap_period``, s.

        Returns:
            The time, s of the boot clock; None if the attitude is left out.
        """
        unwrapped_time = self._unwrapped_time(message)
        has_caught_up = self._restarted_clock_has_caught_up(message.stamp)
        if _continues(unwrapped_time, self.now) and not has_caught_up:
            time = unwrapped_time
        elif self._begins_new_clock(message.stamp):
            # A new clock has not wrapped yet.
            time = message.stamp
        else:
            return None
        self._continue_from(time, message)
        return time

    def _continue_from(self, time: float, message: Message) -> None:
        """Updates the clock, and what is measured of it, by an attitude that belongs to it.

        Args:
            time: time of the attitude, s of the boot clock.
            message: the attitude, with its stamp, whose counter begins again after ``wrap_period``, s.
        """
        # The two attitude messages may wrap differently, so the wraps are counted again from the time that was found.
        self._wraps = 0
        if isfinite(message.wrap_period):
            self._wraps = round((time - message.stamp) / message.wrap_period)
        if time > self.now:
            # An exponential moving average, in which a single long gap does not count as such.
            step = min(time - self.now, MIN_RESET_STEP)
            self._mean_step += (step - self._mean_step) / STEP_MEMORY
            self.now = time
        self._boot_time = self._reception_time - time
        # The present clock is still in use, so that the stamps of another one were none of this vehicle's.
        self._stamps_of_new_clock.clear()

    def _begins_new_clock(self, stamp: float) -> bool:
        """Collects a stamp that does not continue the clock, and restarts the clock once there are enough of them.

        The vehicle may have rebooted, its clock may have jumped, or the stamp may be damaged. Stamps that continue each
        other prove a new clock; a damaged one is not continued. Until then their messages are dropped.

        Args:
            stamp: stamp of an attitude, s.

        Returns:
            Whether there is a new clock, which began with the first of these stamps.
        """
        stamps = self._stamps_of_new_clock
        continues_new_clock = bool(stamps) and _continues(stamp, stamps[-1])
        if not continues_new_clock:
            # This stamp is the first of another possible clock.
            stamps.clear()
            self._new_clock_reception = self._reception_time
        stamps.append(stamp)
        if not self._is_new_clock(stamps):
            return False
        self._restart(stamps[0])
        return True

    def _unwrapped_time(self, message: Message) -> float:
        """Returns the time of an attitude as if its counter never began again at zero, s of the present boot clock.

        Args:
            message: an attitude with a stamp, s, whose counter begins again at zero after ``wrap_period``, s.
        """
        time = message.stamp
        # The counter has begun again this often. If it never has, its period may be infinite, which times 0 is NaN.
        if self._wraps:
            time += self._wraps * message.wrap_period
        # Now it may have begun again once more: then the time lies before the present one, ``self.now``, and with one
        # period added soon after it. Otherwise a message came late, or the autopilot restarted, and nothing is added.
        has_gone_back = time < self.now - MIN_RESET_STEP
        gap_after_wrap = time + message.wrap_period - self.now
        if has_gone_back and gap_after_wrap <= MAX_WRAP_GAP:
            time += message.wrap_period
        return time

    def _restarted_clock_has_caught_up(self, stamp: float) -> bool:
        """Returns whether a clock that restarted near zero has now reached the latest time of the former clock.

        If the vehicle reboots shortly after its first start, the stamps of the new clock soon continue the former clock
        by chance, as if nothing had happened. But they rise steadily since the restart (:func:`rises_steadily`). Stamps
        that come late over a second link do not.

        Args:
            stamp: the next attitude stamp, s. The stamps before it that did not continue the former clock, and may
                belong to a new one, are ``_stamps_of_new_clock``.
        """
        earlier_stamps = self._stamps_of_new_clock
        if len(earlier_stamps) < MIN_RESET_STAMPS:
            return False
        first_stamp = earlier_stamps[0]
        starts_near_zero = first_stamp <= MAX_RESTART_TIME
        # A stamp may lie this much before the latest one and still continue the clock.
        lowest_continuing_stamp = self.now - MIN_RESET_STEP
        has_reached_former_clock = first_stamp < lowest_continuing_stamp < stamp
        is_ascending = stamp >= earlier_stamps[-1]
        if not (starts_near_zero and has_reached_former_clock and is_ascending):
            return False
        return rises_steadily(np.array([*earlier_stamps, stamp]), self.now, self._mean_step)

    def _is_new_clock(self, stamps: list[float]) -> bool:
        """Returns whether successive stamps prove that the vehicle's clock has changed.

        They were collected since the last stamp that continued the former clock. So delayed messages, or messages of
        another vehicle with the same ids, prove nothing while the former clock continues.

        Any of these is a proof, with ``MIN_RESET_STAMPS`` at least:

        1. A clock that began near zero has reached the former one (:meth:`_restarted_clock_has_caught_up`).
        2. There was no clock before.
        3. The clock jumped ahead: delayed messages have earlier stamps, not later ones.
        4. The clock fell by more than any delay to a time near zero, as in a restart.
        5. The clock read zero after the last message of the former one: the vehicle booted while nothing was received.
        6. The stamps go on for ``MAX_LATE_SECONDS``. Until then they may come from a second link with a delay, which
           is shorter.

        Args:
            stamps: stamps of a possible new clock, s, that continue each other; at least one.
        """
        if len(stamps) < MIN_RESET_STAMPS:
            return False
        if self._restarted_clock_has_caught_up(stamps[-1]):
            return True
        first_stamp = stamps[0]
        # Before the first attitude the time is NaN.
        has_no_former_clock = isnan(self.now)
        has_jumped_ahead = first_stamp >= self.now
        if has_no_former_clock or has_jumped_ahead:
            return True
        fell_beyond_delays = first_stamp < self.now - MAX_LATE_SECONDS
        is_restart = fell_beyond_delays and first_stamp <= MAX_RESTART_TIME
        has_booted_in_silence = self._start_of_new_clock >= self._last_former_reception
        is_longer_than_delays = stamps[-1] - first_stamp >= MAX_LATE_SECONDS
        return is_restart or has_booted_in_silence or is_longer_than_delays

    @property
    def _last_former_reception(self) -> float:
        """When the latest message that continued the present clock was received, UNIX s."""
        return self._boot_time + self.now

    @property
    def _start_of_new_clock(self) -> float:
        """When the clock of the collected stamps, of which there must be some, read zero, UNIX s."""
        return self._new_clock_reception - self._stamps_of_new_clock[0]

    def _restart(self, first_stamp: float) -> None:
        """Starts the clock again, and reports why: a reboot, a clock that was set back, or a jump ahead.

        After any step back the boot number increases, so that times before and after it are never compared. The step
        back is a reboot if the new clock begins near zero, or if it read 0 after the last message of the former clock:
        then the vehicle booted while nothing was received. A step ahead is a jump within the same boot. The first clock
        of all is not reported.

        Args:
            first_stamp: first attitude stamp of the new clock, s.
        """
        former_now = self.now
        former_reception = self._last_former_reception
        self.now = first_stamp
        is_first_clock = isnan(former_now)
        if is_first_clock:
            return
        has_jumped_ahead = first_stamp >= former_now
        if has_jumped_ahead:
            offset = first_stamp - former_now
            self._report(Fact(VehicleFact.CLOCK_JUMPED, offset=offset, clock=former_now))
            return
        self.boot += 1
        self.latest_restart = (former_reception, self._new_clock_reception)
        begins_near_zero = first_stamp <= MAX_RESTART_TIME
        has_begun_since = self._start_of_new_clock >= former_reception - MAX_UTC_DIFFERENCE
        if begins_near_zero or has_begun_since:
            self._report(Fact(VehicleFact.VEHICLE_REBOOTED, clock=former_now))
        else:
            self._report(Fact(VehicleFact.CLOCK_WENT_BACK, clock=former_now, time=first_stamp))

    def _time_near_now(self, message: Message) -> float | None:
        """Returns the time of a message that is not an attitude, by the latest attitude.

        Whole wrap periods are added to its stamp, so that it is nearest to the latest attitude.

        Args:
            message: message with a stamp of the boot clock.

        Returns:
            Time on the boot clock, s; None before the first attitude, or if the stamp differs by more than
            ``MAX_STAMP_DEVIATION``, as stamps of other clocks do.
        """
        if isnan(self.now):
            return None
        time = message.stamp
        if isfinite(message.wrap_period):
            missing_wraps = round((self.now - time) / message.wrap_period)
            time += message.wrap_period * missing_wraps
        if abs(time - self.now) > MAX_STAMP_DEVIATION:
            return None
        return time


def _continues(time: float, earlier_time: float) -> bool:
    """Whether a stamp can follow an earlier one on the same clock, both in s.

    It may lie up to ``MIN_RESET_STEP`` before the earlier one, since messages overtake each other on a network, and up
    to ``MAX_STAMP_DEVIATION`` after it. NaN, no earlier stamp, is followed by none.
    """
    return -MIN_RESET_STEP < time - earlier_time <= MAX_STAMP_DEVIATION
