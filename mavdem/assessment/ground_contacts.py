"""How flights meet the ground: an impact, a landing that topples, a hard landing, or a tip-over at take-off.

An impact needs the ground afterwards, where the vehicle rests or the log ends, and two witnesses before that: a knock
of the accelerometer, a tumble, a fast descent, a pose on the side, a lost attitude, or the autopilot's own report. A
dive that the motors end has none of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.attitude_error import AttitudeError
from mavdem.assessment.attitude_losses import has_risen_by, knock_is_contact
from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.confidence import Interval
from mavdem.dataset.intervals import in_intervals
from mavdem.dataset.phases import MAX_SETPOINT_DELAY, series_of_boot
from mavdem.facts import Fact, Facts
from mavdem.facts.ending import MotionEvent
from mavdem.facts.events import Reported
from mavdem.facts.witnesses import Side, Witness
from mavdem.witnesses.scene import MIN_SINK_RATE, Rest, Scene
from mavdem.witnesses.statements import (
    MIN_SUPPORT,
    support_count,
    supporting_statement,
    supporting_statements,
    weighed_event,
)

SEARCH_SECONDS = 10.0
"""Seconds before the rest, or around the end of a flight, in which the contact with the ground is looked for."""

HARD_IMPACT_SPEED = 3.0
"""Speed downward, m/s, from which on an upright vehicle hits the ground and does not land."""

CONTACT_SPEED_SECONDS = 0.25
"""Seconds before a contact in which the estimated speed is the one of the contact: at least two samples at 10 Hz. Full
thrust brakes by at most 2.5 m/s in that time."""

HARD_IMPACT_SPEED_CLOSED = 5.0
"""The same, m/s, for a vehicle that topples after the pilot closed the throttle: it falls from 1.3 m."""

TOPPLE_HEIGHT = 2.0
"""Height, m, above take-off or resting place up to which a vehicle that topples was landing."""

TOPPLE_HEIGHT_CLOSED = 3.0
"""The same, m, if the pilot closed the throttle: by then it has fallen for a moment."""

MAX_LANDING_LEAN = np.radians(25.0)
"""Lean, rad, above which a vehicle near the ground is not landing."""

CLIMB_STICK = 0.65
"""Travel of the throttle stick from which on the pilot asks for a climb; ArduPilot's middle is 0.5 ± 0.1."""

LANDING_DESCENT = 0.3
"""Height, m, that a vehicle which lands loses in the last 3 s before it touches the ground: autopilots land at 0.3 m/s
or more, with 0.1 m/s of drift of the height."""

LANDING_STEP = 1.5
"""Height, m, of a resting place above the take-off from which on it is no ground but something that was hit."""

TUMBLE_SECONDS = 1.5
"""Seconds by which the largest knock of a tumble may come after the first contact; on real logs 1.3."""

KNOCK_SECONDS = 0.1
"""Longest time, s, from the first large sample of a knock to its peak; a choice."""

MIN_FALL_SECONDS = 0.5
"""Seconds in which a vehicle that loses its attitude in the air falls 1.2 m. A knock that comes earlier came first."""

REPORTS_OF_CRASH = (Reported.CRASH_DETECTED,)
"""Reports of the autopilot that support an impact."""

IMPACT_SPEED_CHANGE = 3.0
"""Decrease of the speed downward, m/s, within ``IMPACT_SECONDS`` that shows an impact; also the least speed before it.

It takes a mean of 10 m/s² upward beside the weight, more than autopilots use to end a descent.
"""

IMPACT_SECONDS = 0.3
"""Duration, s, over which the decrease of the speed in an impact is measured."""

STICK_DELAY = 0.3
"""Seconds by which a stick may be logged later than the motion that it causes: receivers are logged at 3 to 10 Hz."""

STICK_REACTION_SECONDS = 1.5
"""Seconds after a contact in which a pilot who lands closes the throttle. It shows that a landing was meant, and no
more: what follows the contact does not change how the vehicle came to it."""


def ground_contact(
    scene: Scene,
    error: AttitudeError,
    flight: Interval,
    loss: Fact | None,
    reports: Sequence[Fact] = (),
) -> Fact | None:
    """Returns how a flight met the ground, if it was not an ordinary landing; None otherwise.

    Args:
        scene: sensors of the boot.
        error: of the attitude in this boot.
        flight: start and end of the flight, s since boot.
        loss: the loss of attitude that the flight did not recover from; None if there was none.
        reports: events that the autopilot reports.

    Returns:
        A fact with the kind of contact as its code (``TIPPED``, ``TOPPLED``, ``HIT`` or ``LANDED_HARD``), the figures
        ``height`` (m above the take-off, just before), ``speed`` (m/s downward, that all height sensors confirm),
        ``angle`` (largest error of the attitude, rad) and its witnesses. Where the attitude was lost shortly before a
        hit, it has that time, s, as ``onset``; where something hit above the take-off was the ground, ``is_ground``.
    """
    contact = _Contact(scene, error, flight, loss, reports)
    return contact.event()


@dataclass(frozen=True, eq=False)
class _Contact:
    """The end of one flight, examined for a contact with the ground."""

    scene: Scene
    """Sensors of the boot, with the take-off of this flight."""
    error: AttitudeError
    """Error of the attitude in this boot."""
    flight: Interval
    """Start and end of the flight, s since boot."""
    loss: Fact | None
    """The loss of attitude that the flight did not recover from; None if there was none."""
    reports: Sequence[Fact]
    """Events that the autopilot reports."""

    def event(self) -> Fact | None:
        """Returns the contact as a fact; None if the flight ended in an ordinary landing, or goes on.

        1. The end of the search is when the vehicle rests; else the end of the record, if that is soon after the loss
           or the flight; else some seconds after the loss of attitude.
        2. The moment of the contact is sought in the ``SEARCH_SECONDS`` before (:meth:`_time`).
        3. At least ``MIN_SUPPORT`` independent witnesses must support that it was no landing.
        """
        rest = self._rest()
        record_end = float(self.error.time[-1])
        if rest is not None:
            end = rest.time
        elif self._ends_soon(record_end):
            end = record_end
        elif self.loss is not None and self.loss.time is not None:
            # A vehicle that was lost may lie with its motors running. They shake it, so that it shows no rest.
            end = min(record_end, self.loss.time + SEARCH_SECONDS - MAX_SETPOINT_DELAY)
        else:
            return None
        start = max(self.flight[0], end - SEARCH_SECONDS)
        time = self._time(start, end)
        if time is None:
            return None
        witnesses = self._witnesses(time, rest)
        if support_count(witnesses) < MIN_SUPPORT and not self._is_only_estimated(time):
            return None
        # What followed is required, and counts as a witness only now.
        if rest is not None:
            witnesses = (*witnesses, rest.statements[0])
        elif record_end - time < RECOVERY_SECONDS and self.loss is not None:
            witnesses = (
                *witnesses,
                supporting_statement(Witness.LOG_ENDED, duration=record_end - time),
            )
        return self._fact(time, rest, witnesses)

    def _is_only_estimated(self, time: float) -> bool:
        """Returns whether a contact rests on the estimated speed alone, since no accelerometer could show a knock."""
        accelerometer = self.scene.accelerometer
        is_slow = accelerometer is None or not accelerometer.shows_knocks
        return is_slow and self._speed_lost_at_once((time - 1.0, time + 1.0)) is not None

    def _rest(self) -> Rest | None:
        """Returns how the vehicle came to rest after its loss, or around the end of its flight; None if it did not.

        It is sought for three times ``SEARCH_SECONDS``, since a vehicle that hit the ground may roll or slide on.
        """
        if self.loss is not None:
            since = self.loss.time or self.flight[0]
        else:
            since = self._flight_end() - SEARCH_SECONDS
        return self.scene.rest_after(since, since + 3 * SEARCH_SECONDS)

    def _flight_end(self) -> float:
        """Returns the end of the flight, s; that of the record if it goes on until then."""
        return float(min(self.flight[1], self.error.time[-1]))

    def _ends_soon(self, record_end: float) -> bool:
        """Returns whether the record ends within ``RECOVERY_SECONDS`` of the loss, or of the end of the flight."""
        since = self._flight_end() if self.loss is None else self.loss.time or 0.0
        return record_end - since < RECOVERY_SECONDS

    def _time(self, start: float, end: float) -> float | None:
        """Returns when the vehicle touched the ground, s since boot; None if nothing shows it.

        The best sensor decides. That is the largest knock of the accelerometer, if it exceeds the vibration in flight;
        then the loss of attitude, if that was near the ground; and, if no accelerometer is fast enough to show knocks,
        the moment at which the estimated speed downward was lost.

        Args:
            start: beginning of the search, s since boot.
            end: its end, s since boot.
        """
        accelerometer = self.scene.accelerometer
        if accelerometer is not None and accelerometer.peak((start, end)) is not None:
            knock = self._largest_contact_knock(start, end)
            if knock is not None and self._exceeds_vibration(knock, start):
                return knock.time
            if accelerometer.shows_knocks:
                # A contact without a knock is only that of a vehicle that topples.
                return self._time_of_low_loss()
        low_loss = self._time_of_low_loss()
        if low_loss is not None:
            return low_loss
        return self._speed_lost_at_once((start, end + RECOVERY_SECONDS))

    def _largest_contact_knock(self, start: float, end: float) -> Fact | None:
        """Returns the largest knock of an interval that can be a contact; None if none was felt.

        A knock high in the air, such as that of a propeller that breaks, is none, and the search goes on after it.

        Args:
            start: beginning of the interval, s since boot.
            end: its end, s since boot.
        """
        while start < end:
            knock = self.scene.knock((start, end))
            if knock is None or knock.figures["side"] != Side.FOR or knock.time is None:
                return None
            if knock_is_contact(self.scene, knock.time):
                return knock
            start = knock.time + MIN_FALL_SECONDS
        return None

    def _time_of_low_loss(self) -> float | None:
        """Returns when the attitude was lost, s, if that was near the ground; None otherwise."""
        if self.loss is None or self.loss.time is None:
            return None
        height = self.scene.height_at(self.loss.time)
        is_low = height is not None and height < TOPPLE_HEIGHT_CLOSED
        return self.loss.time if is_low else None

    def _exceeds_vibration(self, knock: Fact, start: float) -> bool:
        """Returns whether a knock is larger than what the accelerometer felt in the flight before, from vibration."""
        accelerometer = self.scene.accelerometer
        assert accelerometer is not None
        before = accelerometer.peak((self.flight[0] + MAX_SETPOINT_DELAY, start))
        return before is None or bool(knock.figures["acceleration"] > before[1])

    def _speed_lost_at_once(self, interval: Interval) -> float | None:
        """Returns when the estimated speed downward was lost within a moment, s; None if it was not.

        A candidate is a sample from which on the speed downward decreases by more than ``IMPACT_SPEED_CHANGE`` within
        ``IMPACT_SECONDS``. The impact is at the largest decrease in one step after the first candidate.

        Args:
            interval: start and end of the time to examine, s.
        """
        climb_rate = series_of_boot(self.scene.signals.climb_rate, self.scene.boot)
        if climb_rate is None:
            return None
        time = climb_rate.time
        speed_later = np.interp(time + IMPACT_SECONDS, time, climb_rate.values)
        is_braked = speed_later - climb_rate.values > IMPACT_SPEED_CHANGE
        is_sinking = climb_rate.values < -IMPACT_SPEED_CHANGE
        candidates = time[in_intervals(time, [interval]) & is_braked & is_sinking]
        if not len(candidates):
            return None
        # The motors may have slowed the fall before the ground stopped it. The ground takes the most speed in one step.
        first = candidates[0]
        speed_steps: Array = np.diff(climb_rate.values, append=climb_rate.values[-1])
        is_impact = in_intervals(time, [(first, first + IMPACT_SECONDS)])
        row = int(np.argmax(np.where(is_impact, speed_steps, -inf)))
        is_fast = -climb_rate.values[row] > IMPACT_SPEED_CHANGE
        return float(time[row]) if is_fast else None

    def _witnesses(self, time: float, rest: Rest | None) -> Facts:
        """Returns what supports and what contradicts a contact that was no landing.

        Args:
            time: when the vehicle touched the ground, s since boot.
            rest: how it came to rest; None if the log ended before.
        """
        around = (time - MAX_SETPOINT_DELAY, time + 2 * MAX_SETPOINT_DELAY)
        statements: list[Fact] = []
        for statement in (self.scene.knock(around), self.scene.fast_rotation(around)):
            if statement is not None:
                statements.append(statement)
        statements += self._sinking(time)
        if rest is not None and rest.angle is not None:
            statements.append(rest.statements[1])
        angle = self._largest_error(around)
        if self.loss is not None or angle > MAX_LANDING_LEAN:
            statements.append(supporting_statement(Witness.ATTITUDE_LEFT_SETPOINT, angle=angle))
        for report in self.reports:
            is_near = around[0] <= (report.time or 0.0) <= time + SEARCH_SECONDS
            if report.code in REPORTS_OF_CRASH and report.figures["boot"] == self.scene.boot:
                if is_near:
                    statements.append(
                        supporting_statement(Witness.AUTOPILOT_REPORTED, cause=report)
                    )
        return tuple(statements)

    def _sinking(self, time: float) -> Facts:
        """Returns the fast descent before the contact, by each height sensor that shows it.

        The speed that all height sensors confirm must exceed ``MIN_SINK_RATE`` in the last seconds, so that an estimate
        that runs away is no witness.

        Args:
            time: when the vehicle touched the ground, s since boot.
        """
        interval = (time - 3 * MAX_SETPOINT_DELAY, time)
        speed = self.scene.sink_rate(interval)
        if speed is None or speed <= MIN_SINK_RATE:
            return ()
        return supporting_statements(self.scene.sinking(interval))

    def _largest_error(self, interval: Interval) -> float:
        """Returns the largest error of roll and pitch in an interval, rad; 0 without samples."""
        rows = in_intervals(self.error.time, [interval])
        return float(self.error.magnitude[rows].max(initial=0.0))

    def _fact(self, time: float, rest: Rest | None, witnesses: Facts) -> Fact | None:
        """Returns the event of a contact, of the kind that height, speed, pose and stick show.

        A vehicle has toppled if it lost its attitude or rests on its side. It tipped over at take-off if it never rose,
        toppled in its landing if it was about to land, and else hit the ground. One that stayed upright hit the ground
        if it was faster than ``HARD_IMPACT_SPEED``, and else landed hard.

        Args:
            time: when the vehicle touched the ground, s since boot.
            rest: how it came to rest; None if the log ended before.
            witnesses: what supports the contact, and what contradicts it.

        Returns:
            The event, weighed by its witnesses; None for a slow, upright vehicle without a knock, which has landed.
        """
        latest = time
        # A tumble has its largest knock later.
        loss_time = None if self.loss is None else self.loss.time
        if loss_time is not None and loss_time < time:
            is_tumble = self._time_of_low_loss() is not None and time - loss_time < TUMBLE_SECONDS
            if is_tumble or time - loss_time < MIN_FALL_SECONDS:
                time = loss_time
        contact = self._first_knock(time, latest)
        speed = self.scene.sink_rate((contact - 3 * MAX_SETPOINT_DELAY, contact))
        contact_speed = self._contact_speed(contact, speed)
        earliest = time - 3 * MAX_SETPOINT_DELAY
        closed = self.scene.throttle_closed((earliest, time + STICK_REACTION_SECONDS))
        has_toppled = self.loss is not None or (rest is not None and rest.is_on_side)
        has_knocked = any(fact.code is Witness.KNOCKED for fact in witnesses)
        code = MotionEvent.HIT
        if has_toppled:
            if not has_risen_by(self.scene, self.flight, time):
                code = MotionEvent.TIPPED
            elif self._was_landing(time, rest, speed, closed):
                code = MotionEvent.TOPPLED
        elif (contact_speed or 0.0) <= HARD_IMPACT_SPEED:
            if not has_knocked:
                return None
            code = MotionEvent.LANDED_HARD
        if closed is not None and code is MotionEvent.TOPPLED:
            witnesses = (*witnesses, closed)
        is_hit = code is MotionEvent.HIT
        height = self._height_of_contact(contact if is_hit else time)
        event = Fact(
            code,
            time=contact if is_hit else time,
            angle=self._largest_error((time - MAX_SETPOINT_DELAY, time + RECOVERY_SECONDS)),
            height=height,
            speed=contact_speed,
            boot=self.scene.boot,
        )
        if is_hit and time < contact:
            event = event.but(onset=time)
        if is_hit and self._is_near_rest(height, rest):
            event = event.but(is_ground=True)
        return weighed_event(event, witnesses)

    def _contact_speed(self, contact: float, fall_speed: float | None) -> float | None:
        """Returns the speed downward with which the vehicle touched the ground, m/s; None if it is not known.

        A pilot or height controller often brakes a fall before its end. Only the estimate shows that: the slope of the
        barometer is a mean over the fall.

        Args:
            contact: when the vehicle touched the ground, s since boot.
            fall_speed: largest speed downward of the fall, m/s, which the contact cannot exceed.
        """
        if fall_speed is None:
            return None
        last_rates = self.scene.sink_rates((contact - CONTACT_SPEED_SECONDS, contact))
        if "estimate" not in last_rates:
            return fall_speed
        return min(fall_speed, max(0.0, last_rates["estimate"]))

    def _first_knock(self, start: float, latest: float) -> float:
        """Returns the time, s, of the peak of the first knock that is larger than the vibration before.

        Args:
            start: when the attitude was lost, s since boot. Near the ground that may be shortly before the contact.
            latest: when the largest knock was, s since boot; returned where no other one is shown.
        """
        accelerometer = self.scene.accelerometer
        if accelerometer is None or start >= latest:
            return latest
        size = accelerometer.knock_size
        before = accelerometer.peak((self.flight[0] + MAX_SETPOINT_DELAY, start - KNOCK_SECONDS))
        if before is not None:
            size = max(size, before[1])
        is_knock = (accelerometer.magnitude >= size) & (accelerometer.time <= latest)
        rows = np.flatnonzero(is_knock & (accelerometer.time >= start - KNOCK_SECONDS))
        if not len(rows):
            return latest
        first = float(accelerometer.time[rows[0]])
        peak = accelerometer.peak((first, min(first + KNOCK_SECONDS, latest)))
        return first if peak is None else peak[0]

    def _height_of_contact(self, time: float) -> float | None:
        """Returns the height above the take-off at a contact, m, by a source that can be trusted; None without any.

        Heights are averages, so that the lowest within ``MAX_SETPOINT_DELAY`` afterwards counts.
        """
        height = self.scene.height_above_take_off
        if height is None:
            return None
        rows = in_intervals(height.time, [(time, time + MAX_SETPOINT_DELAY)])
        return float(height.values[rows].min()) if rows.any() else self.scene.height_at(time)

    def _is_near_rest(self, height: float | None, rest: Rest | None) -> bool:
        """Returns whether a height of a contact, m, is that of the resting place, and that is near the take-off's.

        The ground is not level, and heights drift in flight: what was hit there was the ground.
        """
        resting_height = None if rest is None else self.scene.height_at(rest.time)
        if height is None or resting_height is None:
            return False
        return resting_height <= LANDING_STEP and height - resting_height <= LANDING_STEP

    def _was_landing(
        self, time: float, rest: Rest | None, speed: float | None, closed: Fact | None
    ) -> bool:
        """Returns whether a vehicle that toppled was about to land: low, slow, level, and not asked to climb.

        A pilot who closed the throttle before the contact let the vehicle drop, so that it may have been higher and
        faster. One who closed it afterwards meant to land, but the limits stay.

        Args:
            time: when it touched the ground, s since boot.
            rest: how it came to rest; None if the log ended before.
            speed: largest speed downward just before, m/s; None if it is not known.
            closed: that the pilot closed the throttle around the contact; None if nothing shows it.
        """
        before = time - MAX_SETPOINT_DELAY
        height = self.scene.height_at(before)
        is_dropped = closed is not None and (closed.time or 0.0) <= time + STICK_DELAY
        fastest = HARD_IMPACT_SPEED_CLOSED if is_dropped else HARD_IMPACT_SPEED
        if height is None or (speed or 0.0) > fastest:
            return False
        resting_height = None if rest is None else self.scene.height_at(rest.time)
        if resting_height is not None:
            if resting_height > LANDING_STEP:
                return False
            height = min(height, height - resting_height)
        if height > (TOPPLE_HEIGHT_CLOSED if is_dropped else TOPPLE_HEIGHT):
            return False
        if self._leans(before) or self._asks_for_climb((before, time)):
            return False
        return closed is not None or self._is_descending(time)

    def _is_descending(self, time: float) -> bool:
        """Returns whether the vehicle came down by ``LANDING_DESCENT`` or more just before a time, s."""
        before, now = (
            self.scene.height_at(time - 3 * MAX_SETPOINT_DELAY),
            self.scene.height_at(time),
        )
        return before is not None and now is not None and before - now > LANDING_DESCENT

    def _leans(self, time: float) -> bool:
        """Returns whether roll or pitch was large at a time, whatever the setpoint was."""
        for tilt in self.scene.signals.tilts:
            angle = series_of_boot(tilt.angle_series, self.scene.boot)
            if angle is not None:
                if abs(np.interp(time, angle.time, angle.values)) > MAX_LANDING_LEAN:
                    return True
        return False

    def _asks_for_climb(self, interval: Interval) -> bool:
        """Returns whether the pilot's throttle asked for a climb at any time of an interval."""
        stick = self.scene.stick
        if stick is None:
            return False
        rows = in_intervals(stick.time, [interval])
        return bool((stick.values[rows] > CLIMB_STICK).any())
