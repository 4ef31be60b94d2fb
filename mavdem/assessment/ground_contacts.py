"""Contacts with the ground, as facts (coded findings): an impact, a toppled or hard landing, a tip-over at take-off.

An impact is reported only if the vehicle is on the ground afterwards, where it rests or the log ends, and if two
independent facts support it: a knock of the accelerometer, a tumble, a fast descent, a pose on the side, a lost
attitude, or the autopilot's own report. A dive that the motors end has none of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

from mavdem.assessment.attitude_losses import was_above_ground_before
from mavdem.assessment.contact_time import MIN_FALL_SECONDS, ContactSearch
from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.assessment.intended_landing import (
    DESCENT_SECONDS,
    HARD_IMPACT_SPEED,
    LANDING_STEP,
    MAX_LANDING_LEAN,
    was_landing,
)
from mavdem.dataset.attitude_error import AttitudeError, largest_error
from mavdem.dataset.grounded import MAX_SETPOINT_DELAY
from mavdem.dataset.intervals import TimeInterval
from mavdem.facts import Fact, Facts
from mavdem.facts.ending import MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.witnesses import HeightSource, SensorFact
from mavdem.witnesses.boot_sensors import MIN_SINK_RATE, BootSensors, Descent, Rest
from mavdem.witnesses.sensor_facts import (
    MIN_SUPPORT,
    checked_event,
    support_count,
    supporting_fact,
    supporting_facts,
)

SEARCH_SECONDS = 10.0
"""Seconds before the rest, or around the end of a flight, in which the contact with the ground is looked for."""

CONTACT_SPEED_SECONDS = 0.25
"""Seconds before a contact in which the estimated speed is the one of the contact: at least two samples at 10 Hz. Full
thrust brakes by at most 2.5 m/s in that time."""

TUMBLE_SECONDS = 1.5
"""Seconds by which the largest knock of a tumble may come after the first contact; on real logs 1.3."""

REPORTS_OF_CRASH = (ReportedEvent.CRASH_DETECTED,)
"""Reports of the autopilot that support an impact."""

ESTIMATE_SECONDS = 1.0
"""Seconds around a contact in which the loss of the estimated speed belongs to that contact; a choice."""

STICK_REACTION_SECONDS = 1.5
"""Seconds after a contact in which a pilot who lands closes the throttle. It shows that a landing was meant, and no
more: what follows the contact does not change how the vehicle came to it."""


def ground_contact(
    sensors: BootSensors,
    error: AttitudeError,
    flight_interval: TimeInterval,
    loss: Fact | None,
    reports: Sequence[Fact] = (),
) -> Fact | None:
    """Returns the event of a flight that hit the ground, toppled or landed hard; None after an ordinary landing.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        error: error of the attitude in this boot.
        flight_interval: start and end of the flight, s since boot.
        loss: the loss of attitude that the flight did not recover from; None if there was none.
        reports: events that the autopilot reports.

    Returns:
        A fact (a coded finding), whose code says how the vehicle came to the ground: ``TIPPED``, ``TOPPLED``, ``HIT``
        or ``LANDED_HARD``. Its figures are:

        - ``height``: height above the take-off just before, m;
        - ``speed``: speed downward that all height sensors confirm, m/s;
        - ``speed_source``: the sensor that measured it; None without a speed;
        - ``angle``: largest error of the attitude, rad;
        - ``witnesses``: facts of sensors for and against the contact;
        - ``onset``: time of the loss of attitude, s since boot, if it came shortly before a hit;
        - ``is_ground``: true if the vehicle hit the ground itself, and not something above it.
    """
    contact = _Contact(sensors, error, flight_interval, loss, reports)
    return contact.event()


@dataclass(frozen=True, eq=False)
class _Contact:
    """The end of one flight, examined for a contact with the ground."""

    sensors: BootSensors
    """Sensors of the boot, with the take-off of this flight."""
    error: AttitudeError
    """Error of the attitude in this boot."""
    flight_interval: TimeInterval
    """Start and end of the flight, s since boot."""
    loss: Fact | None
    """The loss of attitude that the flight did not recover from; None if there was none."""
    reports: Sequence[Fact]
    """Events that the autopilot reports."""

    @property
    def _flight_start(self) -> float:
        """Start of the flight, s since boot."""
        start, _ = self.flight_interval
        return start

    @property
    def _search(self) -> ContactSearch:
        """The search for the moment of the contact."""
        return ContactSearch(self.sensors, self._flight_start, self.loss)

    def event(self) -> Fact | None:
        """Returns the fact that the flight ended with a crash or hard landing, and when; None if it did not.

        1. The search ends where the vehicle comes to rest. If it never does, it ends with a log that stops soon after
           the flight, or else some seconds after the loss of attitude; without either, the flight goes on.
        2. The moment of the contact is sought in the ``SEARCH_SECONDS`` before that end
           (:meth:`ContactSearch.contact_time`).
        3. An ordinary landing is a contact, too. At least ``MIN_SUPPORT`` facts, each from another sensor, must show
           that it was none, such as a knock and an inclination at rest. If no accelerometer could show a knock, a
           sudden stop of the estimated descent is enough.
        """
        rest = self._rest_after_flight()
        record_end = float(self.error.time[-1])
        search_end = self._search_end(rest, record_end)
        if search_end is None:
            return None
        search_start = max(self._flight_start, search_end - SEARCH_SECONDS)
        time = self._search.contact_time(search_start, search_end)
        if time is None:
            return None
        sensor_facts = self._sensor_facts(time, rest)
        has_support = support_count(sensor_facts) >= MIN_SUPPORT
        if not has_support and not self._estimate_shows_impact(time):
            return None
        # That the vehicle rested, or that the log ended, is how the search was bounded. So this fact does not count
        # towards ``MIN_SUPPORT``, and is only listed with the others.
        end_fact = self._fact_about_end(time, rest, record_end)
        if end_fact is not None:
            sensor_facts = (*sensor_facts, end_fact)
        return self._contact_event(time, rest, sensor_facts)

    def _search_end(self, rest: Rest | None, record_end: float) -> float | None:
        """Returns the time before which the vehicle must have touched the ground if it did.

        The contact is sought in the ``SEARCH_SECONDS`` before that time, by :meth:`event`.

        Args:
            rest: when and how the vehicle came to lie still after the flight; None if it did not.
            record_end: time of the last attitude of the boot, s since boot.

        Returns:
            The time, s since boot; None if nothing shows that the flight has ended.
        """
        if rest is not None:
            return rest.time
        if self._ends_soon(record_end):
            # The log ends with the flight, so that the vehicle may have come to rest unseen.
            return record_end
        if self.loss is not None and self.loss.time is not None:
            # After it lost its attitude, a vehicle may lie on the ground with its motors running, so that it never
            # rests. The loss shows up to ``MAX_SETPOINT_DELAY`` after its cause, so that the search begins that much
            # before it.
            search_start = self.loss.time - MAX_SETPOINT_DELAY
            return min(record_end, search_start + SEARCH_SECONDS)
        return None

    def _fact_about_end(self, time: float, rest: Rest | None, record_end: float) -> Fact | None:
        """Returns the fact about what followed a contact: that the vehicle rested, or else that the log ended soon.

        The end of the log supports a contact only after a loss of attitude, since every log ends.

        Args:
            time: time when the vehicle touched the ground, s since boot.
            rest: rest of the vehicle afterwards; None if it did not come to rest.
            record_end: time of the last attitude of the boot, s since boot.

        Returns:
            The fact (coded finding); None if the vehicle did not rest and the log continues.
        """
        if rest is not None:
            return rest.rest_fact
        remaining_seconds = record_end - time
        if remaining_seconds < RECOVERY_SECONDS and self.loss is not None:
            return supporting_fact(
                SensorFact.LOG_ENDED, time=record_end, duration=remaining_seconds
            )
        return None

    def _estimate_shows_impact(self, time: float) -> bool:
        """Returns whether the estimated descent suddenly stopped at a contact that no accelerometer could show.

        Such a contact needs no second sensor that confirms it, since the usual one, an accelerometer that measures the
        knock, is missing or too slow.

        Args:
            time: time when the vehicle touched the ground, s since boot.
        """
        accelerometer = self.sensors.accelerometer
        if accelerometer is not None and accelerometer.shows_knocks:
            return False
        time_around = (time - ESTIMATE_SECONDS, time + ESTIMATE_SECONDS)
        return self._search.time_of_sudden_stop(time_around) is not None

    def _rest_after_flight(self) -> Rest | None:
        """Returns when and in which pose the vehicle came to rest after its flight; None if it did not.

        The search begins with the loss of attitude or, without one, ``SEARCH_SECONDS`` before the end of the flight. It
        lasts three times ``SEARCH_SECONDS``, since a vehicle that hit the ground may roll or slide on.
        """
        if self.loss is not None:
            # A loss without a known time may be anywhere in the flight.
            search_start = self.loss.time or self._flight_start
        else:
            search_start = self._flight_end() - SEARCH_SECONDS
        search_end = search_start + 3 * SEARCH_SECONDS
        return self.sensors.rest_after(search_start, latest=search_end)

    def _flight_end(self) -> float:
        """Returns the end of the flight, s; the end of the record if it continues until then."""
        _, flight_end = self.flight_interval
        return float(min(flight_end, self.error.time[-1]))

    def _ends_soon(self, record_end: float) -> bool:
        """Returns whether the record ends within ``RECOVERY_SECONDS`` of the loss, or of the end of the flight."""
        end_of_control = self._flight_end() if self.loss is None else self.loss.start_time
        return record_end - end_of_control < RECOVERY_SECONDS

    def _sensor_facts(self, time: float, rest: Rest | None) -> Facts:
        """Collects what sensors and reports show for or against a contact that was not a landing.

        Args:
            time: time when the vehicle touched the ground, s since boot.
            rest: when and how the vehicle came to lie still afterwards; None if the log ended before.

        Returns:
            A fact (coded finding) each, as far as they were recorded: a knock of the accelerometer or none, a tumble, a
            fast descent, the pose at rest, an attitude far from its setpoint, and the autopilot's report of a crash.
        """
        # The sensors show the contact from shortly before it on, since its time is not exact.
        earliest_time = time - MAX_SETPOINT_DELAY
        interval = (earliest_time, time + 2 * MAX_SETPOINT_DELAY)
        facts: list[Fact] = []
        knock = self.sensors.knock_fact(interval)
        if knock is not None:
            facts.append(knock)
        rotation = self.sensors.rotation_fact(interval)
        if rotation is not None:
            facts.append(rotation)
        facts += self._descent_facts(time)
        if rest is not None:
            facts += rest.pose_facts
        peak_error = largest_error(self.error, interval)
        if peak_error is not None:
            is_far_from_setpoint = peak_error.counted_angle > MAX_LANDING_LEAN
            if self.loss is not None or is_far_from_setpoint:
                facts.append(
                    supporting_fact(SensorFact.ATTITUDE_LEFT_SETPOINT, **peak_error._asdict())
                )
        for report in self.reports:
            if self._is_crash_report(report, earliest_time, time + SEARCH_SECONDS):
                facts.append(supporting_fact(SensorFact.AUTOPILOT_REPORTED, cause=report))
        return tuple(facts)

    def _is_crash_report(self, report: Fact, start: float, end: float) -> bool:
        """Returns whether the autopilot reported a crash of this boot between two times, s since boot."""
        is_of_boot = report.figures["boot"] == self.sensors.boot
        is_in_time = start <= report.start_time <= end
        return report.code in REPORTS_OF_CRASH and is_of_boot and is_in_time

    def _descent_facts(self, time: float) -> Facts:
        """Collects the height sensors that show a fast descent before the contact.

        The speed that all height sensors confirm must exceed ``MIN_SINK_RATE`` in the last seconds, so that a diverging
        estimate does not count.

        Args:
            time: time when the vehicle touched the ground, s since boot.

        Returns:
            One fact (coded finding) for each of them; empty if the vehicle did not sink so fast.
        """
        interval = (time - DESCENT_SECONDS, time)
        speed = self.sensors.sink_rate(interval)
        if speed is None or speed <= MIN_SINK_RATE:
            return ()
        return supporting_facts(self.sensors.sink_facts(interval))

    def _contact_event(self, time: float, rest: Rest | None, sensor_facts: Facts) -> Fact | None:
        """Returns the event of a contact, whose code is decided by height, speed, pose and stick.

        A vehicle has toppled if it lost its attitude or rests on its side (:meth:`_code_of_toppled_vehicle`). If it
        stayed upright, it hit the ground if it was faster than ``HARD_IMPACT_SPEED``, and otherwise landed hard.

        Args:
            time: time at which the vehicle touched the ground, s since boot; the time of the largest knock, if there
                was one.
            rest: when and how the vehicle came to lie still afterwards; None if the log ended before.
            sensor_facts: what sensors show for or against the contact.

        Returns:
            The event, at most to be watched unless enough sensors confirm it; None for a slow, upright vehicle without
            a knock, which has landed.
        """
        onset = self._onset_time(time)
        contact = self._search.first_knock(onset, time)
        fall = self.sensors.confirmed_descent((contact - DESCENT_SECONDS, contact))
        last_descent = None if fall is None else self._descent_at_contact(contact, fall)
        throttle_closing = self.sensors.throttle_closed_fact(
            (onset - DESCENT_SECONDS, onset + STICK_REACTION_SECONDS)
        )
        has_toppled = self.loss is not None or (rest is not None and rest.is_on_side)
        if has_toppled:
            fall_speed = None if fall is None else fall.speed
            code = self._code_of_toppled_vehicle(onset, rest, fall_speed, throttle_closing)
        elif last_descent is not None and last_descent.speed > HARD_IMPACT_SPEED:
            code = MotionEvent.HIT
        elif any(fact.code is SensorFact.KNOCKED for fact in sensor_facts):
            code = MotionEvent.LANDED_HARD
        else:
            return None
        if code is MotionEvent.TOPPLED and throttle_closing is not None:
            sensor_facts = (*sensor_facts, throttle_closing)
        event = self._event_with_figures(code, onset, contact, rest, last_descent)
        return checked_event(event, sensor_facts)

    def _event_with_figures(
        self,
        code: MotionEvent,
        onset: float,
        contact: float,
        rest: Rest | None,
        last_descent: Descent | None,
    ) -> Fact:
        """Returns the event of a contact with its figures, which :func:`ground_contact` lists.

        Args:
            code: what happened.
            onset: time when the contact began, s since boot, which may be that of a loss of attitude before.
            contact: time of the first knock, s since boot, not before the onset.
            rest: when and how the vehicle came to lie still afterwards; None if the log ended before.
            last_descent: speed with which the vehicle touched the ground, and its source; None if it is not known.
        """
        is_hit = code is MotionEvent.HIT
        # An impact is dated by its first knock, another contact by its onset.
        event_time = contact if is_hit else onset
        height = self._height_of_contact(event_time)
        error_interval = (onset - MAX_SETPOINT_DELAY, onset + RECOVERY_SECONDS)
        peak_error = largest_error(self.error, error_interval)
        event = Fact(
            code,
            time=event_time,
            angle=0.0 if peak_error is None else peak_error.counted_angle,
            height=height,
            speed=None if last_descent is None else last_descent.speed,
            speed_source=None if last_descent is None else last_descent.source,
            boot=self.sensors.boot,
        )
        if is_hit and onset < contact:
            event = event.replace(onset=onset)
        if is_hit and self._is_contact_with_ground(height, rest):
            event = event.replace(is_ground=True)
        return event

    def _onset_time(self, time: float) -> float:
        """Determines when a contact began: with the loss of attitude, if the ground caused it, otherwise at ``time``.

        A vehicle that tumbles over the ground loses its attitude at the first contact, and its largest knock comes up
        to ``TUMBLE_SECONDS`` later. Elsewhere the ground caused a loss that came less than ``MIN_FALL_SECONDS`` before,
        since a vehicle that is lost high in the air takes longer to fall.

        Args:
            time: time of the largest knock or, without one, when the vehicle touched the ground, s since boot.

        Returns:
            The time, s since boot.
        """
        loss_time = None if self.loss is None else self.loss.time
        if loss_time is None or loss_time >= time:
            return time
        seconds_after_loss = time - loss_time
        was_lost_near_ground = self._search.time_of_loss_near_ground() is not None
        is_tumble = was_lost_near_ground and seconds_after_loss < TUMBLE_SECONDS
        is_too_soon_for_fall = seconds_after_loss < MIN_FALL_SECONDS
        if is_tumble or is_too_soon_for_fall:
            return loss_time
        return time

    def _code_of_toppled_vehicle(
        self,
        onset: float,
        rest: Rest | None,
        fall_speed: float | None,
        throttle_closing: Fact | None,
    ) -> MotionEvent:
        """Classifies the ground contact of a vehicle that lost its attitude or came to rest on its side.

        Args:
            onset: time when the contact began, s since boot.
            rest: when and how the vehicle came to lie still afterwards; None if the log ended before.
            fall_speed: largest speed downward just before, m/s; None if it is not known.
            throttle_closing: fact that the pilot closed the throttle around the contact; None if nothing shows it.

        Returns:
            TIPPED (over, at take-off) if it never rose, TOPPLED if it was about to land, otherwise HIT (the ground).
        """
        if not was_above_ground_before(self.sensors, self.flight_interval, onset):
            return MotionEvent.TIPPED
        if was_landing(self.sensors, onset, rest, fall_speed, throttle_closing):
            return MotionEvent.TOPPLED
        return MotionEvent.HIT

    def _descent_at_contact(self, contact: float, fall: Descent) -> Descent:
        """Returns the speed downward with which the vehicle touched the ground, and the sensor that measured it.

        A pilot or height controller often brakes a fall before its end. Only the autopilot's estimate shows that: the
        barometer's climb rate, a slope over seconds, is a mean of the whole fall.

        Args:
            contact: time when the vehicle touched the ground, s since boot.
            fall: the fastest descent shortly before, whose speed the contact cannot exceed.

        Returns:
            The speed by the estimate at the contact, at least 0 m/s; ``fall`` if the estimate shows no braking or was
            not recorded.
        """
        last_rates = self.sensors.sink_rates((contact - CONTACT_SPEED_SECONDS, contact))
        estimated_speed = last_rates.get(HeightSource.ESTIMATE, inf)
        if estimated_speed >= fall.speed:
            return fall
        return Descent(max(0.0, estimated_speed), contact, HeightSource.ESTIMATE)

    def _height_of_contact(self, time: float) -> float | None:
        """Returns the height above the take-off at a contact.

        Recorded heights are averages and lag behind. So the lowest height within ``MAX_SETPOINT_DELAY`` afterwards is
        returned or, if no sample follows so soon, the height at the time itself.

        Args:
            time: time of the contact, s since boot.

        Returns:
            The height, m; None without a height source that can be trusted.
        """
        height = self.sensors.height_above_take_off
        if height is None:
            return None
        heights_after = height.within((time, time + MAX_SETPOINT_DELAY)).values
        if not len(heights_after):
            return self.sensors.height_at(time)
        return float(heights_after.min())

    def _is_contact_with_ground(self, height: float | None, rest: Rest | None) -> bool:
        """Returns whether the vehicle touched the ground itself, and not something above it, such as a tree.

        Then it touched it about where it came to rest, and rests about as high as it took off. Heights may differ by
        ``LANDING_STEP``, since the ground is not level and heights drift in flight.

        Args:
            height: height of the contact above the take-off, m; None if it is not known.
            rest: when and how the vehicle came to lie still afterwards; None if the log ended before.
        """
        resting_height = None if rest is None else self.sensors.height_at(rest.time)
        if height is None or resting_height is None:
            return False
        rests_on_ground = resting_height <= LANDING_STEP
        fell_no_further = height - resting_height <= LANDING_STEP
        return rests_on_ground and fell_no_further
