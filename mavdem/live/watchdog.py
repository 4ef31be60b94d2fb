"""Watchdog of a live vehicle: finds faults in its messages twice a second, for its alarms and its status lights.

A fault is a ``Fact``: a finding with a code, a level (good, watch, bad, unknown) and figures. A status light is the
worst fact on one part of the vehicle, such as its motors. No fault needs a learned model.

It is the judgement of a log in small steps. What the autopilot reports, and the lights of vibration, power, estimator
and tracking, are those of ``mavdem.assessment`` on the messages so far. How the vehicle is lost is found by
``LossWatch``, and motors at the limits of their outputs by ``MotorLimitWatch``.

All times are of the vehicle's boot clock, which begins anew with each start of its autopilot (a boot).
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from math import inf

from mavdem.assessment.condition import Condition
from mavdem.assessment.ending import REPORTS_OF_LOSS, find_ending
from mavdem.assessment.event_lights import light_of_event
from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.assessment.lights.power import POWER_REPORTS, power_light
from mavdem.assessment.limits import worst_fact
from mavdem.assessment.restarts import MAX_LATE_TAKE_OFF
from mavdem.assessment.wind_drifts import WindDriftDetector
from mavdem.dataset.intervals import Intervals
from mavdem.dataset.setpoints import SETPOINT_MESSAGE
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, Signals
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.estimator import EstimatorLight
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.session import SessionFact
from mavdem.facts.watch import WatchedQuantity, WatchFact
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import IN_AIR, ON_GROUND
from mavdem.live.active_alarms import CALM_SECONDS, ActiveAlarms
from mavdem.live.control_watch import ControlWatch
from mavdem.live.flight_lights import FlightLights
from mavdem.live.height_watch import HeightWatch
from mavdem.live.landed_states import LandedStates
from mavdem.live.last_minute_lights import judge_estimator, judge_vibration
from mavdem.live.live_signals import (
    FlightMoment,
    LiveFindings,
    LiveSignals,
    RecentMotion,
    live_evidence,
)
from mavdem.live.loss_watch import LossWatch
from mavdem.live.messages import STATUS_MESSAGES, Message
from mavdem.live.motor_limit_watch import MotorLimitWatch
from mavdem.live.recent_messages import MAX_EVENTS, RecentMessages
from mavdem.live.report_alarms import (
    ReportAlarms,
    is_lasting_state,
    is_moment_or_reported_end,
)
from mavdem.live.report_search import ReportSearch
from mavdem.live.review import Review
from mavdem.live.tracking_watch import TrackingWatch
from mavdem.live.watch_list import (
    BATTERY_NOT_KNOWN_YET,
    LISTENING_SECONDS,
    WatchList,
    quantities_without_message,
    quantities_without_motion,
    reason_battery_not_judged,
)
from mavdem.loops.limit_cycles import STARTING_SECONDS
from mavdem.motors.motor_changes import alarm_if_bad
from mavdem.plant.online_wind_torque import MEMORY_SECONDS
from mavdem.wind_velocity.from_log import ESTIMATOR_FLAG_MESSAGES
from mavdem.witnesses.ground_heights import MAX_WAIT_SECONDS

PART_OF_QUANTITY = {
    WatchedQuantity.CONTROL: Light.TRACKING,
    WatchedQuantity.OSCILLATION: Light.MARGINS,
    WatchedQuantity.MOTOR_LIMITS: Light.MOTORS,
    WatchedQuantity.VIBRATION: Light.VIBRATION,
    WatchedQuantity.BATTERY: Light.POWER,
    WatchedQuantity.ESTIMATOR: Light.ESTIMATOR,
    WatchedQuantity.TRACKING: Light.TRACKING,
    WatchedQuantity.DRIFT: Light.WIND,
    WatchedQuantity.HEIGHT: Light.ESTIMATOR,
}
"""The part of the vehicle, with a status light of its own, that is at fault where a watched quantity is."""

PRESENT_FAULTS = (
    WatchedQuantity.OSCILLATION,
    WatchedQuantity.MOTOR_LIMITS,
    WatchedQuantity.VIBRATION,
    WatchedQuantity.TRACKING,
    WatchedQuantity.DRIFT,
)
"""Quantities whose facts state a fault of the present moment. Once one is over in flight, its light says so. The facts
of other quantities state when their fault was."""

QUANTITIES_BY_ATTITUDE = (
    WatchedQuantity.CONTROL,
    WatchedQuantity.OSCILLATION,
    WatchedQuantity.TRACKING,
    WatchedQuantity.DRIFT,
)
"""What cannot be watched while attitudes are not numbers."""

NOT_JUDGED_AFTER_LOSS = (
    WatchedQuantity.OSCILLATION,
    WatchedQuantity.MOTOR_LIMITS,
    WatchedQuantity.VIBRATION,
    WatchedQuantity.TRACKING,
    WatchedQuantity.DRIFT,
)
"""Quantities in which a vehicle out of control has faults however sound it is: they are not judged after a loss."""

THOROUGH_PERIOD = 0.8
"""Least time between two thorough reviews, s of the boot clock: every second review is one.

A thorough review takes twice the time of another. What it judges comes in messages of 1 to 2 Hz.
"""

SETPOINTS_MISSING = Fact(
    WatchFact.MESSAGE_MISSING,
    name=SETPOINT_MESSAGE,
    rate=None,
    needed_rate=MIN_SLOW_MOTION_RATE,
)
"""Why the tracking is not watched if no setpoints of the attitude come."""

OSCILLATION_AWAITED = Fact(WatchFact.OSCILLATION_AWAITED, duration=STARTING_SECONDS)
"""Why an oscillation is not watched in the first seconds after the take-off."""

TRACKING_PERIOD = 10.0
"""Time between two judgements of the tracking, s: a choice, since it takes ten times as long as another light."""

URGENT_MESSAGES = ("STATUSTEXT", "HEARTBEAT", "EXTENDED_SYS_STATE")
"""Messages whose changes are reported by the next review, thorough or not: warnings in words, modes and failsafes, and
whether the vehicle is on the ground."""


class Watchdog:
    """Watches a vehicle since its autopilot started (one boot), and keeps alarms and status lights of the faults found.

    Each fault is of one ``WatchedQuantity``, such as the vibration or the control. The vehicle is reviewed twice a
    second. A review has up to four steps, between which messages are taken:
    ``begin_review``; in flight ``review_lights`` and, every ``TRACKING_PERIOD``, ``review_tracking``; and
    ``finish_review``. Battery, estimator, vibration and tracking are judged by thorough reviews only, every second one.
    So are reports of the autopilot, unless an urgent message has changed. The balance of the motors, too, is one of the
    quantities, but is tested elsewhere (``MotorAlarms``).

    Attributes:
        is_thorough: whether the latest review is thorough.
        alarms: the alarms that are active as of the last review.
        watch_list: since when each quantity is watched, or why it is not.
        status_lights: the worst fact on each part of the vehicle in the latest flight.
        control: judges whether control of the flight was lost.
        drift: looks for wind that carries the vehicle away in the present flight.
        loss_watch: finds out whether and how the vehicle is lost.
    """

    def __init__(
        self,
        slow_messages: RecentMessages,
        former: Watchdog | None = None,
        *,
        was_flying: bool = False,
    ) -> None:
        """Makes the watchdog of a boot, before its first review.

        Args:
            slow_messages: messages of this boot.
            former: the watchdog of the former boot, whose loss and lights are kept; None for the first boot.
            was_flying: whether the vehicle flew when the former boot ended.
        """
        self.is_thorough = False
        self.alarms = ActiveAlarms()
        self.watch_list = WatchList()
        self.status_lights: FlightLights = FlightLights(
            None if former is None else former.status_lights
        )
        self.control = ControlWatch(slow_messages)
        self.drift = WindDriftDetector(slow_messages.boot)
        self._height = HeightWatch(slow_messages, self.control)
        # Whether the heights at rest before and after the latest flight have shown that one of the sensors drifted.
        self._is_height_drift_found = False
        self._tracking = TrackingWatch(slow_messages)
        self._slow_messages = slow_messages
        self._landed_states = LandedStates()
        self.loss_watch: LossWatch = LossWatch(
            self.control,
            self._landed_states,
            self.alarms,
            self.status_lights,
            former=None if former is None else former.loss_watch,
        )
        self._motor_limits = MotorLimitWatch(self.control, self.alarms, slow_messages.boot)
        # Whether the vehicle flew when the former boot ended.
        self._was_flying = was_flying
        # When this boot was reviewed first, s of its clock; None before.
        self._first_review_time: float | None = None
        self._report_search = ReportSearch()
        # The restart of the autopilot in flight, as its light states it; None without one.
        self._restart: Fact | None = None
        # What the autopilot has warned of in the flights of this boot.
        self._warnings: deque[Fact] = deque(maxlen=MAX_EVENTS)
        # The active alarms on what the autopilot reports.
        self._report_alarms = ReportAlarms()
        # The report of a landing that is not certain yet; None without one.
        self._landing_report: Fact | None = None
        # Time of the latest review, s of the boot clock.
        self._review_time = -inf
        # Time from which on the flight was settled at the latest review, s of the boot clock; None if it was not.
        self._settled_start: float | None = None
        # Time of the latest thorough review, s.
        self._thorough_time = -inf
        # Time of the latest judgement of the tracking, s.
        self._tracking_time = -inf
        # Number of changes of urgent messages until the latest review.
        self._change_count = 0
        # Why the latest judgement of the power, also that of the former boot, says nothing of the battery; None if it
        # does, or before any.
        self._battery_not_judged: Fact | None = None
        # Whether the power was judged in this boot or the former one, a few seconds after a take-off or later.
        self._is_battery_judged = False
        if former is not None:
            self._battery_not_judged = former._battery_not_judged
            self._is_battery_judged = former._is_battery_judged
        # The review that has begun; None between reviews.
        self._review: Review | None = None

    def add_message(self, message: Message, time: float) -> None:
        """Adds a message with the attitude or its setpoint to the data by which control and tracking are judged.

        Args:
            message: Decoded ATTITUDE, ATTITUDE_QUATERNION or ATTITUDE_TARGET.
            time: time on the boot clock, s.
        """
        self.control.add_message(message, time)
        self._tracking.add_message(message, time)

    @property
    def loss(self) -> Fact | None:
        """How the latest flight was lost, such as by a crash; None if it was not (see :class:`LossWatch`)."""
        return self.loss_watch.loss

    @property
    def ground_contact(self) -> Fact | None:
        """How the lost vehicle met the ground; None before, and if nothing was lost (see :class:`LossWatch`)."""
        return self.loss_watch.ground_contact

    @property
    def has_landed(self) -> bool:
        """Whether the latest flight has ended on the ground; True before any flight (see :class:`LossWatch`)."""
        return self.loss_watch.has_landed

    @property
    def active_alarms(self) -> Facts:
        """The alarms that are active now, the most urgent first.

        A restart of the autopilot in flight comes first, then the loss of the vehicle, such as a crash, then a fall
        that may still be caught, and then all other bad faults. The loss stays an alarm while the vehicle lies on the
        ground.
        """
        bad_faults = [fact for fact in self.alarms.facts.values() if fact.is_bad]
        for reported_fault in self._report_alarms.active:
            # The watchdog may have found the same fault that the autopilot reports.
            if reported_fault not in bad_faults:
                bad_faults.append(reported_fault)
        most_urgent = []
        if self._restart is not None and self._landed_states.is_in_air:
            most_urgent.append(self._restart)
        # A loss of control is among the faults already.
        if self.loss is not None and self.loss not in bad_faults:
            most_urgent.append(self.loss)
        ongoing_fall = self.loss_watch.ongoing_fall
        if ongoing_fall is not None and not self.has_landed:
            most_urgent.append(ongoing_fall)
        return (*most_urgent, *bad_faults)

    def begin_review(
        self,
        now: float,
        vehicle: Telemetry,
        *,
        is_flying: bool,
        settled_start: float | None,
    ) -> list[Fact]:
        """Begins a review: collects the messages so far, and finds new reports of the autopilot in them.

        A thorough review, every ``THOROUGH_PERIOD``, judges everything again. Other reviews only examine urgent
        messages, and only if one of them has changed. ``update_phase`` must be called before.

        Args:
            now: present time on the boot clock, s.
            vehicle: identity and parameters of the vehicle, without messages.
            is_flying: whether it is airborne and armed.
            settled_start: beginning of the settled flight, s; None if it is not settled. Vibration is judged in settled
                flight only, since a touch-down shakes the vehicle too.

        Returns:
            Facts that the autopilot has reported since the last review, and alarms that are over by its reports.
        """
        self._settled_start = settled_start
        self.is_thorough = now - self._thorough_time >= THOROUGH_PERIOD
        if self.is_thorough:
            self._thorough_time = now
        settled_intervals = None
        if settled_start is not None:
            settled_intervals = [(settled_start, now)]
        has_urgent_change = self._has_new_urgent_change()
        recent_signals = None
        # To collect the messages takes most of the time of a review. It is done only if something may be found.
        if self.is_thorough or has_urgent_change:
            recent_signals = self._status_signals(
                vehicle, now, now - MEMORY_SECONDS, settled_intervals
            )
        self._review = Review(
            now,
            vehicle,
            is_flying,
            has_settled=settled_intervals is not None,
            phase_start=self._landed_states.phase_start,
            recent_signals=recent_signals,
        )
        return self._take_new_reports(self._review)

    def _take_new_reports(self, review: Review) -> list[Fact]:
        """Finds new reports of the autopilot in the messages of a review; in flight they may become alarms.

        Args:
            review: the review that has begun. Without ``recent_signals`` nothing is searched.

        Returns:
            What is reported to the user: the reports or the alarms on them, and the ends of alarms.
        """
        if review.recent_signals is None:
            return []
        reports = self._new_reports(review.recent_signals, review.vehicle, review.now)
        if not review.is_flying:
            # On the ground a report is shown as it is, and is no alarm.
            self._report_alarms.end_flight()
            return reports
        reported_facts = [self._take_report_in_flight(report, review.now) for report in reports]
        reported_facts += self._report_alarms.update(self._report_search.reports, review.now)
        return reported_facts

    def _has_new_urgent_change(self) -> bool:
        """Returns whether the content of an urgent message (``URGENT_MESSAGES``) has changed since the last review.

        For example, the mode in HEARTBEAT is another one. Each review calls this method once; the call stores the
        number of changes so far for the next one.
        """
        # How often an urgent message differed from the one before, since the autopilot started.
        change_count = sum(self._slow_messages.changes[name] for name in URGENT_MESSAGES)
        has_changed = change_count > self._change_count
        self._change_count = change_count
        return has_changed

    def _take_report_in_flight(self, report: Fact, now: float) -> Fact:
        """Enters a new report of the autopilot in flight in the status lights and the alarms, where it belongs there.

        Args:
            report: the report. A restart of the autopilot comes as an alarm, which :meth:`_new_reports` has made and
                entered in the lights; it is returned as it is.
            now: present time on the boot clock, s.

        Returns:
            What is reported to the user: an alarm, or the report itself.
        """
        is_restart_alarm = report.code is SessionFact.ALARM
        if is_restart_alarm:
            return report
        report_in_flight = _with_level_in_flight(report)
        self._store_warning(report_in_flight)
        return self._alarm_or_report(report_in_flight, now)

    def _store_warning(self, report: Fact) -> None:
        """Stores a warning of the autopilot, since power and estimator are judged by it, and adds it to a status light.

        Args:
            report: a new report of the autopilot in flight; one that is no warning (level "watch" or "bad") is ignored.
        """
        if not report.is_watch_or_bad:
            return
        self._warnings.append(report)
        part = light_of_event(report)
        if part is not None:
            self.status_lights.add(part, report)

    def _alarm_or_report(self, report: Fact, now: float) -> Fact:
        """Decides whether a new report of the autopilot in flight becomes an alarm, and makes that alarm active.

        1. A report on the power, such as of a low battery, belongs to the alarm of the battery.
        2. The report of a crash is an alarm, unless the motion has shown the loss of the vehicle before: that was an
           alarm already.
        3. For all other reports ``ReportAlarms`` decides.

        Args:
            report: the report, on any part of the vehicle.
            now: present time on the boot clock, s.

        Returns:
            What is reported to the user: the alarm, or the report itself.
        """
        if report.code in POWER_REPORTS:
            self._raise_battery_alarm(report, now)
            return self._power_report_for_user(report)
        if report.code in REPORTS_OF_LOSS and report.is_bad:
            is_loss_known_by_report_alone = (
                self.loss is not None and self.loss.code is Ending.LOSS_REPORTED
            )
            if is_loss_known_by_report_alone:
                return alarm_if_bad(report, report.start_time)
            return report
        return self._report_alarms.add_report(report, now)

    def _raise_battery_alarm(self, report: Fact, now: float) -> None:
        """Makes the battery's alarm active at once if the autopilot warns of its power, such as of a low battery.

        The next review judges the battery by this warning too, finds the alarm active, and does not report it again. A
        worse alarm that is active already stays.

        Args:
            report: a new report of the autopilot on the power.
            now: present time on the boot clock, s.
        """
        if not report.is_watch_or_bad:
            return
        active_alarm = self.alarms.facts.get(WatchedQuantity.BATTERY, report)
        worse_fact = worst_fact([active_alarm, report])
        self.alarms.raise_alarm(WatchedQuantity.BATTERY, worse_fact, now)

    def _power_report_for_user(self, report: Fact) -> Fact:
        """Returns what the user reads of a power report: an alarm if it is bad, otherwise the report itself.

        Args:
            report: a new report of the autopilot on the power, which is among the active alarms if it is a warning.
        """
        report = _battery_report_in_flight(report)
        if report.is_bad:
            return alarm_if_bad(report, report.start_time)
        active_alarm = self.alarms.facts.get(WatchedQuantity.BATTERY)
        is_alarm_bad = active_alarm is not None and active_alarm.is_bad
        if report.is_watch_or_bad and is_alarm_bad:
            # The alarm says to land now. The advice of a mere warning, to land earlier next time, would contradict it.
            return report.without_flight_advice
        return report

    def update_phase(self, now: float, *, is_flying: bool, takeoff_time: float = -inf) -> None:
        """Notices whether the vehicle has taken off or landed since the last call, and begins or ends its flight.

        A take-off or landing ends a drift in the wind and a disagreement of the heights. This comes first, while the
        status lights are still those of the phase that ends.

        Args:
            now: present time on the boot clock, s.
            is_flying: whether the vehicle is airborne and armed.
            takeoff_time: when the vehicle left the ground, s of the boot clock; minus infinity where it was in the air
                at the first moment that shows it.
        """
        landed_state = IN_AIR if is_flying else ON_GROUND
        if self._first_review_time is None:
            self._first_review_time = now
        if landed_state == self._landed_states.latest:
            return
        self._end_faults_of_phase(now)
        if not is_flying:
            self._landed_states.begin_phase(ON_GROUND, now, self._review_time)
            return
        has_restarted_in_air = self._has_restarted_in_air(now, takeoff_time)
        self._begin_flight(now, has_restarted_in_air=has_restarted_in_air)
        if has_restarted_in_air:
            self._landed_states.begin_in_air(now)
        else:
            self._landed_states.begin_phase(IN_AIR, now, self._review_time)

    def _end_faults_of_phase(self, now: float) -> None:
        """Ends two faults that last until a take-off or landing at most, and writes the end into their status lights.

        They are a drift in the wind, and a disagreement between the heights by barometer and satellites.

        Args:
            now: present time on the boot clock, s.
        """
        self._end_drift(now)
        height_disagreement = self._height.end_flight(now)
        if height_disagreement is not None:
            self.status_lights.replace(
                Light.ESTIMATOR, height_disagreement.code, height_disagreement
            )

    def _has_restarted_in_air(self, now: float, takeoff_time: float) -> bool:
        """Returns whether the autopilot restarted in the air, so that the flight of its former boot goes on.

        It did if the vehicle flew when the former boot ended and is in the air, without a take-off, as soon as the
        messages of this boot show its state. That may be some seconds after the first review (``MAX_LATE_TAKE_OFF``).

        Args:
            now: time of the review that has found the vehicle in the air, s of the boot clock.
            takeoff_time: when it left the ground, s; minus infinity where that was not seen.
        """
        assert self._first_review_time is not None
        is_first_flight = self._landed_states.is_first_phase
        is_found_early = now - self._first_review_time <= MAX_LATE_TAKE_OFF
        is_takeoff_unseen = takeoff_time == -inf
        return self._was_flying and is_first_flight and is_found_early and is_takeoff_unseen

    def _begin_flight(self, now: float, *, has_restarted_in_air: bool) -> None:
        """Begins to watch a flight at its take-off, without the findings of the flight before.

        A vehicle that leaves the ground again within ``RECOVERY_SECONDS`` has bounced, or its landed state was wrong
        for a moment. Then the same flight goes on, with its loss of control and its status lights. The status lights
        also stay if the autopilot has restarted in the air.

        Args:
            now: present time on the boot clock, s.
            has_restarted_in_air: whether the flight of the former boot goes on, since the autopilot restarted in it.
        """
        self.loss_watch.begin_flight()
        self._height.begin_flight()
        self._is_height_drift_found = False
        self._landing_report = None
        self.alarms.begin_flight()
        if self._has_only_bounced(now):
            return
        self.loss_watch.forget_loss()
        self.alarms.discard(WatchedQuantity.CONTROL)
        if not has_restarted_in_air:
            self.status_lights.begin_flight()

    def _has_only_bounced(self, now: float) -> bool:
        """Returns whether a vehicle that leaves the ground was in the air less than ``RECOVERY_SECONDS`` before.

        Args:
            now: time when it is found in the air again, s of the boot clock.
        """
        states = self._landed_states
        if states.is_first_phase:
            # No earlier flight of this boot is known.
            return False
        seconds_on_ground = now - states.phase_start
        return seconds_on_ground < RECOVERY_SECONDS

    def _end_drift(self, now: float) -> None:
        """Ends the drift (the wind carries the vehicle away) at a take-off or landing, and begins the search anew.

        If the status light of the wind, which is its judgement, states that drift, the light gets the end of the drift.

        Args:
            now: present time on the boot clock, s.
        """
        self.drift.end(now)
        ended_drift = self.drift.latest
        if ended_drift is not None:
            self.status_lights.replace(Light.WIND, ended_drift.code, ended_drift)
        self.drift = WindDriftDetector(self._slow_messages.boot)

    def review_lights(self) -> None:
        """Judges battery, estimator and, in settled flight, vibration, by the functions that judge a log.

        It is called once in each thorough review in flight, and adds the judgements to the ``facts`` of that review.
        """
        review = self._review
        assert review is not None
        # A thorough review always has the signals of the last minute.
        assert review.recent_signals is not None
        condition = Condition(duration=review.now - review.phase_start)
        self._judge_battery(review, condition)
        # Estimator and vibration may recover, so that only the signals and warnings of the last minute count.
        findings = LiveFindings(
            events=self._warnings_since(review.now - MEMORY_SECONDS),
            ending=self.loss_watch.loss_that_ended_flight,
        )
        evidence = live_evidence(review.recent_signals, condition, findings)
        judge_estimator(review, evidence)
        if review.has_settled:
            judge_vibration(review, evidence)

    def _warnings_since(self, start_time: float) -> Facts:
        """Returns what the autopilot has warned of in the flights of this boot since a time.

        Args:
            start_time: the time, s of the boot clock.
        """
        return tuple(warning for warning in self._warnings if warning.start_time > start_time)

    def _judge_battery(self, review: Review, condition: Condition) -> None:
        """Judges the battery by all messages and warnings since the autopilot started, and stores the judgement.

        Unlike other parts of the vehicle, a battery does not recover. So earlier flights count too.

        Args:
            review: one look at the vehicle, whose ``facts`` get the judgement.
            condition: figures of the vehicle; its ``duration`` is that of the flight so far, s.
        """
        signals_since_boot = self._status_signals(review.vehicle, review.now, start_time=-inf)
        # The time of a crash is passed on, since the current that a crashed vehicle draws is no fault of its battery.
        findings = LiveFindings(
            events=tuple(self._warnings), ending=self.loss_watch.loss_that_ended_flight
        )
        power = power_light(live_evidence(signals_since_boot, condition, findings))
        review.facts[WatchedQuantity.BATTERY] = power
        # In the first seconds of a flight too few voltages have come to tell whether they are the battery's at all.
        has_enough_voltages = condition.duration >= LISTENING_SECONDS
        if has_enough_voltages:
            self._battery_not_judged = reason_battery_not_judged(power)
            self._is_battery_judged = True

    def has_rate_setpoint(self, vehicle: Telemetry, axis: str) -> bool:
        """Returns whether a setpoint of the body rate comes for an axis (:meth:`TrackingWatch.has_rate_setpoint`).

        Args:
            vehicle: identity and parameters of the vehicle, without messages.
            axis: name of the axis, such as "roll".
        """
        return self._tracking.has_rate_setpoint(vehicle, axis)

    @property
    def is_tracking_due(self) -> bool:
        """Whether the review that has begun is to judge the tracking: in settled flight, every ``TRACKING_PERIOD``."""
        review = self._review
        assert review is not None
        return review.has_settled and abs(review.now - self._tracking_time) >= TRACKING_PERIOD

    def review_tracking(self, settled_start: float) -> None:
        """Judges how the vehicle follows its setpoints in the latest minute of settled flight, as a log is judged.

        The judgement is added to the ``facts`` of the review, which must have begun.

        Args:
            settled_start: since when the flight is settled, that is since the end of the climb-out, s of the boot
                clock.
        """
        review = self._review
        assert review is not None
        self._tracking_time = review.now
        tracking = self._tracking.judge(review.now, review.vehicle, settled_start)
        if tracking is not None:
            review.facts[WatchedQuantity.TRACKING] = tracking

    def finish_review(self, motion: RecentMotion | None, takeoff_time: float = -inf) -> list[Fact]:
        """Ends the review that has begun: judges the motion, and turns the faults that were found into alarms.

        Args:
            motion: attitude and motor outputs of the last seconds; None if they do not come.
            takeoff_time: when the vehicle left the ground, s of the boot clock; minus infinity where that was not seen.

        Returns:
            What is reported to the user: a landing that is certain now, and alarms that begin, become worse, or are
            over.
        """
        review = self._review
        assert review is not None
        self._review = None
        moment = FlightMoment(review.now, review.vehicle, takeoff_time, motion)
        if review.is_flying:
            reported_facts = self._judge_flight(review, moment)
        else:
            self.loss_watch.judge_end_of_flight(review, moment, self._report_search.reports)
            reported_facts = self._judge_height_sensors_at_rest(review, moment)
        if self.has_landed and self._landing_report is not None:
            # The autopilot has reported a landing, which waited until the vehicle is known to be on the ground: a land
            # detector may report one in the air.
            reported_facts.append(self._landing_report)
            self._landing_report = None
        reasons_not_watched = self._reasons_not_watched(review.now, review.vehicle, motion)
        self.watch_list.update(review.now, reasons_not_watched, is_flying=review.is_flying)
        reported_facts += self._update_alarms(review)
        reported_facts += self.loss_watch.pop_contact_report(review.now)
        self._review_time = review.now
        return reported_facts

    def review_control(self, moment: FlightMoment) -> list[Fact]:
        """Judges between two reviews whether control of a flying vehicle is being lost.

        It cannot wait for the next review, which may be a second away: a vehicle that loses control 4 m above the
        ground hits it within that time.

        Args:
            moment: present time, and the motion.

        Returns:
            The alarm of a loss that is new, and a contact with the ground.
        """
        if not self._landed_states.is_in_air:
            # The first review of the flight has not begun yet.
            return []
        review = Review(
            moment.time,
            moment.vehicle,
            is_flying=True,
            has_settled=False,
            phase_start=self._landed_states.phase_start,
            recent_signals=None,
        )
        # The judgement of the control adds its finding to ``review.facts``.
        reported_facts = self.loss_watch.judge_flight(review, moment)
        for quantity, fact in review.facts.items():
            self.status_lights.add(PART_OF_QUANTITY[quantity], fact)
        reported_facts += self._raise_alarms(review)
        reported_facts += self.loss_watch.pop_contact_report(moment.time)
        return reported_facts

    def _judge_flight(self, review: Review, moment: FlightMoment) -> list[Fact]:
        """Judges a flying vehicle: control, attitude estimate, drift in wind, height, oscillation, motors at limits.

        After a loss of control the faults are removed that any vehicle out of control has (``NOT_JUDGED_AFTER_LOSS``).

        Args:
            review: the review, to whose ``facts`` the faults are added by quantity.
            moment: present time, and the motion; no motion if too little was received.

        Returns:
            The alarm that the vehicle falls when it begins or ends; otherwise empty.
        """
        reported_facts = self.loss_watch.judge_flight(review, moment)
        self._judge_attitude_estimate(review)
        if self.drift.latest is not None:
            review.add_event(WatchedQuantity.DRIFT, self.drift.latest)
        if self.is_thorough:
            self._judge_height(review, moment)
        if moment.motion is not None:
            self._motor_limits.judge(review, moment, moment.motion)
        if WatchedQuantity.OSCILLATION in review.facts:
            self._judge_oscillating_motors()
        if self.loss is not None:
            for quantity in NOT_JUDGED_AFTER_LOSS:
                review.facts.pop(quantity, None)
        return reported_facts

    def _judge_oscillating_motors(self) -> None:
        """Withdraws a good light (judgement) of the motors while the vehicle oscillates, so that it is unknown.

        An oscillation drives the motors to and fro, so that they cannot be compared with each other. If it drives them
        to their limits, the light says so. After a loss of control it does not, since that drives them there anyway.
        """
        self.status_lights.remove_good(Light.MOTORS)
        swinging_motors = self._motor_limits.swinging_motors
        is_controlled = self.loss is None
        if swinging_motors is not None and is_controlled:
            self.status_lights.add(Light.MOTORS, swinging_motors)

    def _judge_height(self, review: Review, moment: FlightMoment) -> None:
        """Judges in flight whether the height estimate diverges, or barometer and satellites disagree.

        Args:
            review: the review, to whose ``facts`` the worse of these two events is added, if there is one.
            moment: present time, and the motion.
        """
        height_events = []
        divergence = self._height.divergence(moment)
        if divergence is not None:
            height_events.append(divergence)
        disagreement = self._height.disagreement(moment)
        if disagreement is not None:
            height_events.append(disagreement)
        if height_events:
            review.add_event(WatchedQuantity.HEIGHT, worst_fact(height_events))

    def _judge_attitude_estimate(self, review: Review) -> None:
        """Judges whether the estimated attitude is NaN (not a number): then the estimator has failed for certain.

        Args:
            review: the review. Its fact on the estimator is replaced by this failure, unless that fact is worse. Its
                ``last_found_times`` are the ends of faults that are over; a fault without one is there now.
        """
        invalid_attitude = self.control.invalid_attitude(review.vehicle)
        if invalid_attitude is None:
            return
        found_facts = [invalid_attitude]
        if WatchedQuantity.ESTIMATOR in review.facts:
            found_facts.append(review.facts[WatchedQuantity.ESTIMATOR])
        review.facts[WatchedQuantity.ESTIMATOR] = worst_fact(found_facts)
        # The attitude is NaN now, so that the estimator has a fault now, even if another of its faults is over.
        review.last_found_times.pop(WatchedQuantity.ESTIMATOR, None)

    def _judge_height_sensors_at_rest(self, review: Review, moment: FlightMoment) -> list[Fact]:
        """Judges on the ground whether barometer or satellite receiver drifted in the latest flight.

        Their heights while the vehicle rests after the landing are compared with those of its rest before the take-off.
        This is repeated in each thorough review until a drift is found, for at most ``MAX_WAIT_SECONDS``.

        Args:
            review: the review, in which the vehicle is on the ground.
            moment: present time, and the motion.

        Returns:
            The event that one of the two has drifted, once after a flight; otherwise nothing.
        """
        if not self.is_thorough:
            return []
        if self._is_search_for_drift_due(review):
            flight_interval = (moment.takeoff_time, review.phase_start)
            drift = self._height.drift_between_rests(review.vehicle, flight_interval, moment.motion)
            if drift is not None:
                self._is_height_drift_found = True
                self._show_height_drift(drift)
                return [drift]
        # If the vehicle takes off again, this is its latest rest before the flight.
        self._height.update_latest_rest(review.vehicle, moment.motion)
        return []

    def _is_search_for_drift_due(self, review: Review) -> bool:
        """Returns whether to search now for a height sensor that drifted in the latest flight.

        The search begins at the landing, and is repeated in each review until a drift is found or ``MAX_WAIT_SECONDS``
        have passed.

        Args:
            review: the review of a vehicle on the ground, with the time of the landing as ``phase_start``.
        """
        has_landed_after_flight = self._landed_states.flight_end is not None and self.has_landed
        seconds_on_ground = review.now - review.phase_start
        is_time_left = seconds_on_ground <= MAX_WAIT_SECONDS
        return has_landed_after_flight and is_time_left and not self._is_height_drift_found

    def _show_height_drift(self, drift: Fact) -> None:
        """Updates the status light of the estimator by the drift of a height sensor, found at rest after a flight.

        A light shows the worst fact on one part of the vehicle, here on its estimate of attitude and position.

        Args:
            drift: the event that barometer or satellite receiver has drifted. Its level is good if only the altitude by
                satellites wandered, which is no fault of the vehicle.
        """
        # In flight, the light may have become that both sensors disagree. The drift says which of them was wrong, so
        # that it replaces that fact even if its own level is better.
        self.status_lights.replace(Light.ESTIMATOR, MotionEvent.HEIGHTS_DISAGREE, drift)
        # Any other fact stays the light if its level is worse than that of the drift.
        self.status_lights.add(Light.ESTIMATOR, drift)

    def _status_signals(
        self,
        vehicle: Telemetry,
        now: float,
        start_time: float,
        settled_intervals: Intervals | None = None,
    ) -> Signals:
        """Returns messages on the state of the vehicle in the form of a log, so that the functions for logs judge them.

        Args:
            vehicle: identity and parameters of the vehicle, without messages.
            now: end of the signals, s of the boot clock.
            start_time: beginning of the signals, s of the boot clock; minus infinity for all messages since the boot.
            settled_intervals: intervals of settled flight, without take-off and landing, s of the boot clock; None if
                the caller judges nothing that depends on them.

        Returns:
            The signals. Whether the vehicle was in the air is not taken from a message, but from the reviews so far.
        """
        # Messages that come again and again, such as the state of the battery.
        repeated_messages = (*STATUS_MESSAGES, *ESTIMATOR_FLAG_MESSAGES)
        columns = self._slow_messages.columns(repeated_messages, start_time)
        # The names of flight modes and the firmware's version come once, when a ground station asks for them.
        columns |= self._slow_messages.columns(["AVAILABLE_MODES", "AUTOPILOT_VERSION"])
        landed_state = self._landed_states.series(
            now, self._slow_messages.boot, was_flying=self._was_flying
        )
        return LiveSignals(
            replace(vehicle, messages=columns),
            landed_state=landed_state,
            preset_settled_intervals=settled_intervals,
        )

    def _new_reports(self, signals: Signals, vehicle: Telemetry, now: float) -> list[Fact]:
        """Returns what the autopilot itself has reported since the last search, such as a failsafe or a crash.

        Two kinds of reports may be wrong. A crash that the motion does not show gets the lower level "watch"
        (:meth:`_checked_reports_of_loss`). A landing is reported later, by ``finish_review``, once the vehicle is found
        on the ground.

        Args:
            signals: time series and texts of the last minute of messages.
            vehicle: identity and parameters of the vehicle, without messages.
            now: present time on the boot clock, s.
        """
        reports = []
        for report in self._report_search.new_reports(signals, now):
            if report.code is ReportedEvent.RESTARTED_IN_FLIGHT:
                reports.append(alarm_if_bad(report, report.start_time))
            elif report.code is ReportedEvent.ON_GROUND and not self.has_landed:
                # The landing is not certain yet.
                self._landing_report = report
            else:
                reports.append(report)
        if self._report_search.restart is not None:
            self._update_restart(self._report_search.restart)
        has_report_of_loss = any(report.code in REPORTS_OF_LOSS for report in reports)
        if has_report_of_loss:
            return self._checked_reports_of_loss(reports, signals, vehicle)
        return reports

    def _checked_reports_of_loss(
        self, reports: list[Fact], signals: Signals, vehicle: Telemetry
    ) -> list[Fact]:
        """Checks reports of the autopilot that the vehicle was lost, such as by a crash, against the motion.

        If the loss was not known by the motion before, the vehicle is lost by these reports from now on.

        Args:
            reports: new reports, among them one of a loss.
            signals: time series and texts of the last minute of messages.
            vehicle: identity and parameters of the vehicle, without messages.

        Returns:
            The same reports, in which a crash that the motion does not show has a lower level ("watch").
        """
        checked_reports = self.control.lower_unconfirmed_crash_reports(vehicle, reports)
        if self.loss is None:
            reports_of_loss = [fact for fact in checked_reports if fact.code in REPORTS_OF_LOSS]
            self.loss_watch.loss = find_ending(signals, reports_of_loss)
        return checked_reports

    def _update_restart(self, restart: Fact) -> None:
        """Shows the restart of the autopilot in flight by the status light of the part that caused it, such as power.

        The cause may become known some time after the restart, when more messages have come. The light that showed the
        restart until then, perhaps of another part, no longer does.

        Args:
            restart: the event of the restart, with its cause as far as that is known now.
        """
        part_at_fault = light_of_event(restart)
        # A restart in flight always has a light: of the power, or of the control if a program hung.
        assert part_at_fault is not None
        self.status_lights.move(former_fact=self._restart, part=part_at_fault, fact=restart)
        self._restart = restart

    def _update_alarms(self, review: Review) -> list[Fact]:
        """Begins and ends alarms by the facts of a review, and adds these to the status lights.

        There is at most one alarm for each watched quantity, such as the vibration:

        - It begins, or is reported again, when a fact of level "watch" or "bad" has another level or code than the
          active alarm. Other figures only update it.
        - It ends after the landing, or when its fault has not been found for ``CALM_SECONDS``, so that a fault that
          comes and goes gives one alarm. :meth:`_end_alarms` has the exceptions.

        Args:
            review: the review that ends, with all its facts.

        Returns:
            Alarms, with the time of the review, and ends of alarms, with the time at which the fault was found last;
            s of the boot clock.
        """
        self._drop_past_faults(review)
        for quantity, fact in review.facts.items():
            self.status_lights.add(PART_OF_QUANTITY[quantity], fact)
        return [*self._raise_alarms(review), *self._end_alarms(review)]

    def _drop_past_faults(self, review: Review) -> None:
        """Removes from a review the faults that have been over for ``CALM_SECONDS``, unless their alarm is active.

        A review judges the messages of the last minute, which still show such a fault. Otherwise an alarm would begin
        after its fault has ended.

        Args:
            review: the review, with its facts by watched quantity, and the time when each fault was there last.
        """
        for quantity, last_found_time in review.last_found_times.items():
            is_over = review.now - last_found_time >= CALM_SECONDS
            has_active_alarm = quantity in self.alarms.facts
            if is_over and not has_active_alarm:
                # The fact may be missing: some are removed after a loss of control (``NOT_JUDGED_AFTER_LOSS``).
                review.facts.pop(quantity, None)

    def _raise_alarms(self, review: Review) -> list[Fact]:
        """Turns the warnings of a review into active alarms, and returns those that are new to the user.

        Args:
            review: the review that ends, with its facts by watched quantity.

        Returns:
            The alarms to report, with the time of the review.
        """
        reported_alarms = []
        for quantity, fault in review.facts.items():
            if not fault.is_watch_or_bad:
                continue
            if quantity is WatchedQuantity.BATTERY:
                # A battery does not recover in flight: a milder fault that is found later replaces no worse alarm.
                fault = worst_fact([fault, self.alarms.facts.get(quantity, fault)])
            # An alarm is new unless one with the same code and level was active already.
            is_new = self.alarms.raise_alarm(quantity, fault, review.last_found_time(quantity))
            if is_new and not _was_reported_by_autopilot(quantity, fault):
                fault_for_user = _fault_for_user(quantity, fault)
                reported_alarms.append(alarm_if_bad(fault_for_user, review.now))
        return reported_alarms

    def _end_alarms(self, review: Review) -> list[Fact]:
        """Removes the active alarms that are over.

        Args:
            review: the review that ends; its warnings are among the active alarms already.

        Returns:
            The ends to report to the user (:meth:`_end_alarm`).
        """
        reported_ends = []
        for quantity in list(self.alarms.facts):
            if self._is_alarm_over(quantity, review):
                reported_end = self._end_alarm(quantity, review)
                if reported_end is not None:
                    reported_ends.append(reported_end)
        return reported_ends

    def _end_alarm(self, quantity: WatchedQuantity, review: Review) -> Fact | None:
        """Removes an active alarm, and returns the report that it is over; None if that is not reported.

        The status light of a fault of the present moment (``PRESENT_FAULTS``) says from then on that the fault is over.
        Its level stays as it was, since the flight had the fault. Other lights have stated when it was all along.

        Args:
            quantity: what the alarm is about, such as the vibration.
            review: the review that ends, with the time and whether the vehicle flies.
        """
        fault_time = self.alarms.last_found(quantity)
        is_end_reported = self._is_end_reported(quantity, review)
        alarm = self.alarms.end(quantity)
        if quantity is WatchedQuantity.CONTROL:
            self.loss_watch.forget_loss()
        if not is_end_reported:
            return None
        alarm_over = Fact(
            WatchFact.ALARM_OVER,
            time=fault_time,
            reason=alarm,
            is_at_landing=not review.is_flying,
        )
        if review.is_flying and quantity in PRESENT_FAULTS:
            past_fault = alarm_over.replace(alarm.level)
            self.status_lights.replace(PART_OF_QUANTITY[quantity], alarm.code, past_fault)
        return alarm_over

    def _is_alarm_over(self, quantity: WatchedQuantity, review: Review) -> bool:
        """Returns whether an active alarm is over.

        It is after the landing, or in flight once its fault has not been found for some seconds
        (:meth:`ActiveAlarms.is_calm`). There are two exceptions:

        - The alarm that control was lost stays after the landing.
        - The alarm that the attitude does not track its setpoint stays at least until the tracking is judged again,
          every ``TRACKING_PERIOD``.

        Args:
            quantity: what the alarm is about, such as the vibration.
            review: the review that ends, with its time and whether the vehicle flies.
        """
        if not review.is_flying:
            is_vehicle_lost = quantity is WatchedQuantity.CONTROL and self.loss is not None
            return not is_vehicle_lost
        if quantity is WatchedQuantity.TRACKING:
            is_judged_again = self._tracking_time > self.alarms.last_found(quantity)
            if not is_judged_again:
                return False
        return self.alarms.is_calm(quantity, review.now)

    def _is_end_reported(self, quantity: WatchedQuantity, review: Review) -> bool:
        """Returns whether to report to the user that an alarm is over.

        In flight its end is not reported if the fault had no duration, such as a reset of the estimator, or if the
        autopilot itself has reported the end. A landing ends all alarms; the end of a fault that may last on the ground
        (:meth:`_outlasts_landing`) is not reported then.

        Args:
            quantity: quantity of the alarm, which is still active.
            review: the review that ends, with whether the vehicle flies.
        """
        alarm = self.alarms.facts[quantity]
        if review.is_flying:
            return not is_moment_or_reported_end(alarm)
        return not self._outlasts_landing(alarm, quantity)

    def _outlasts_landing(self, fault: Fact, quantity: WatchedQuantity) -> bool:
        """Returns whether a fault in flight may still be there after the landing.

        Args:
            fault: the fault, which was an alarm until the landing.
            quantity: what it is about, such as the battery.
        """
        if self.loss is not None:
            # A vehicle that was lost, such as by a crash, has not become sound.
            return True
        if quantity is WatchedQuantity.BATTERY:
            # Landing charges no battery.
            return True
        if fault.code is MotionEvent.HEIGHTS_DISAGREE:
            # The barometer or the satellite receiver that drifted is still wrong.
            return True
        # The autopilot still reports the fault, for example that the GPS receiver has no fix.
        return is_lasting_state(fault)

    def _reasons_not_watched(
        self, now: float, vehicle: Telemetry, motion: RecentMotion | None
    ) -> dict[WatchedQuantity, Fact]:
        """Finds the quantities that cannot be watched for faults at present, such as the vibration, and states why.

        A quantity cannot be watched if the messages that show it are missing or too slow, if it follows from an
        attitude that is NaN, if the flight is too short so far, or if the battery has no voltage that could be judged.

        Args:
            now: present time on the boot clock, s.
            vehicle: identity and parameters of the vehicle, without messages.
            motion: attitude and motor outputs of the last seconds; None if they do not come.

        Returns:
            The reason as a fact (a coded finding), by quantity; quantities that can be watched are left out.
        """
        reasons = quantities_without_motion(motion)
        received_names = self._slow_messages.names_since(now - MEMORY_SECONDS)
        reasons |= quantities_without_message(received_names, vehicle.autopilot)
        if not self._tracking.has_setpoints(now):
            reasons[WatchedQuantity.TRACKING] = SETPOINTS_MISSING
        invalid_attitude = self.control.invalid_attitude(vehicle)
        if invalid_attitude is not None:
            for quantity in QUANTITIES_BY_ATTITUDE:
                reasons[quantity] = invalid_attitude
        # A quantity whose messages do not come keeps that reason: ``setdefault`` adds only what is new.
        if self._is_too_early_for_oscillation(now):
            reasons.setdefault(WatchedQuantity.OSCILLATION, OSCILLATION_AWAITED)
        if self._battery_not_judged is not None:
            reasons.setdefault(WatchedQuantity.BATTERY, self._battery_not_judged)
        if self._landed_states.is_in_air:
            self._add_quantities_not_judged_yet(reasons, now)
        return reasons

    def _add_quantities_not_judged_yet(
        self, reasons: dict[WatchedQuantity, Fact], now: float
    ) -> None:
        """Adds battery and tracking as not watched as long as they have not been judged in this flight.

        Their messages may come, but their status lights are still unknown: beside these, "watched" would be wrong.

        Args:
            reasons: why each quantity cannot be watched; it is extended, and reasons that it has already stay.
            now: present time on the boot clock, s.
        """
        if not self._is_battery_judged:
            reasons.setdefault(WatchedQuantity.BATTERY, BATTERY_NOT_KNOWN_YET)
        if Light.TRACKING not in self.status_lights.latest:
            reason = self._tracking.reason_not_judged(now, self._settled_start)
            reasons.setdefault(WatchedQuantity.TRACKING, reason)

    def _is_too_early_for_oscillation(self, now: float) -> bool:
        """Returns whether the flight is still too short to say that nothing oscillates; False if something does.

        Args:
            now: present time on the boot clock, s.
        """
        states = self._landed_states
        has_just_taken_off = states.is_in_air and now - states.phase_start < STARTING_SECONDS
        is_oscillating = WatchedQuantity.OSCILLATION in self.alarms.facts
        return has_just_taken_off and not is_oscillating

    def set_motors_watched(self, reason: Fact | None, now: float) -> None:
        """Takes note whether the test for weak motors runs now, which ``MotorAlarms`` makes with each sample.

        While it runs, the motors are listed as watched, and their status light is good: no loss of thrust was found. A
        worse fact in the light stays. After a loss of control, and while the vehicle oscillates, the light does not
        become good: the motors go from limit to limit then, which hides a loss of thrust.

        Args:
            reason: why the test does not run; None if it does.
            now: present time on the boot clock, s.
        """
        self.watch_list.set(WatchedQuantity.MOTORS, reason, now)
        if reason is not None:
            lacks_reference = reason.code is WatchFact.REFERENCE_SHORT
            if lacks_reference:
                # After a long gap in the messages the test begins anew, with a new reference. A loss in the gap would
                # not be found, so that the light no longer states that there was none.
                self.status_lights.remove_good(Light.MOTORS)
            return
        is_oscillating = WatchedQuantity.OSCILLATION in self.alarms.facts
        if self.loss is None and not is_oscillating:
            no_loss_found = Fact(MotorWatchFact.NO_LOSS_FOUND, clock=now)
            self.status_lights.add_first(Light.MOTORS, no_loss_found)


def _with_level_in_flight(report: Fact) -> Fact:
    """Returns a report of the autopilot with the level that it has in flight.

    A moment of low voltage of the board is a warning in a log. In flight it is bad: nobody knows whether the autopilot
    survives it.
    """
    if report.code is ReportedEvent.BOARD_VOLTAGE_LOW:
        return report.replace(Level.BAD)
    return report


def _was_reported_by_autopilot(quantity: WatchedQuantity, fault: Fact) -> bool:
    """Returns whether a fault is a report of the autopilot on its estimator: the user has read that when it came.

    Args:
        quantity: what the fault is about, such as the vibration.
        fault: the fault, found by mavdem or reported by the autopilot.
    """
    return quantity is WatchedQuantity.ESTIMATOR and isinstance(fault.code, ReportedEvent)


def _fault_for_user(quantity: WatchedQuantity, fault: Fact) -> Fact:
    """Returns a fault in the words for a pilot in flight; most faults are returned as they are.

    A fault of the battery says what to do now. A fault of the estimator's innovations says that its duration is the one
    so far, since the list of events later has its whole duration too.

    Args:
        quantity: what the fault is about, such as the battery.
        fault: the fault.
    """
    if quantity is WatchedQuantity.BATTERY:
        return _battery_report_in_flight(fault)
    if fault.code is EstimatorLight.FILTER_DOUBTED:
        return fault.replace(is_so_far=True)
    return fault


def _battery_report_in_flight(report: Fact) -> Fact:
    """Returns a warning of the battery as a pilot in flight needs it: short, with advice for this flight.

    The same warning after the landing says what to do before the next flight.

    Args:
        report: the warning. Facts on further batteries, its figure ``batteries``, are left out; the page has them.
    """
    if "batteries" in report.figures:
        report = report.replace(batteries=())
    return report.replace(is_in_flight=True)
