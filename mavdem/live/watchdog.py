"""Faults of a live vehicle by its own messages, without a model, as facts: findings with a code, a level and figures.

It is the judgement of a log in small steps. What the autopilot reports, and the lights of vibration, power, estimator
and tracking, are those of ``mavdem.assessment`` on the messages so far. A limit cycle is found in the last seconds by
``mavdem.loops.limit_cycles``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Flags
from mavdem.assessment.condition import Condition
from mavdem.assessment.ending import REPORTS_OF_LOSS, ending_of
from mavdem.assessment.failure_by_commands import SPENT_THRUST_SHARE
from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.assessment.judgement import light_of_event
from mavdem.assessment.lights.estimator import estimator_light
from mavdem.assessment.lights.power import POWER_REPORTS, power_light
from mavdem.assessment.lights.vibration import vibration_light
from mavdem.assessment.limits import worst_fact
from mavdem.assessment.reported import reported_events
from mavdem.assessment.wind_drifts import WindDriftDetector
from mavdem.containers import Names
from mavdem.dataset.batteries import BATTERY_MESSAGES
from mavdem.dataset.intervals import Intervals
from mavdem.dataset.quality import samples_at_limits
from mavdem.dataset.setpoints import SETPOINT_MESSAGE
from mavdem.dataset.signals import MIN_STREAM_RATE, Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Facts, Level, NamedFacts
from mavdem.facts.ending import Ending
from mavdem.facts.estimator import EstimatorLight
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light
from mavdem.facts.margins import MarginsLight
from mavdem.facts.motors import MotorsLight, MotorWatchFact
from mavdem.facts.power import PowerLight
from mavdem.facts.session import RowsFact, SessionFact
from mavdem.facts.watch import WatchedQuantity, WatchFact
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import IN_AIR, ON_GROUND
from mavdem.live.control_watch import ControlWatch, carries_vehicle
from mavdem.live.height_watch import BAROMETER_MESSAGE, HeightWatch
from mavdem.live.live_signals import LiveFindings, LiveSignals, RecentMotion, live_evidence
from mavdem.live.messages import STATUS_MESSAGES, Message
from mavdem.live.recent_messages import MAX_EVENTS, RecentMessages
from mavdem.live.report_alarms import ReportAlarms, is_lasting_state
from mavdem.live.samples import DECISION_SECONDS
from mavdem.live.tracking_watch import TrackingWatch
from mavdem.loops.advice import gain_reduction_advice
from mavdem.loops.limit_cycles import detect_starting_limit_cycle
from mavdem.motors.motor_changes import event_or_alarm
from mavdem.motors.saturation import most_limited_motors
from mavdem.plant.online_wind_torque import MEMORY_SECONDS
from mavdem.vibration.vibration_message import reported_vibration
from mavdem.wind_velocity.from_log import ESTIMATOR_FLAG_MESSAGES
from mavdem.witnesses.ground_heights import MAX_WAIT_SECONDS

LIGHTS = {
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
"""The light that shows what is wrong with each thing that is watched."""

PRESENT_FAULTS = (
    WatchedQuantity.OSCILLATION,
    WatchedQuantity.MOTOR_LIMITS,
    WatchedQuantity.VIBRATION,
    WatchedQuantity.TRACKING,
    WatchedQuantity.DRIFT,
)
"""Faults of the moment: once one is over in flight, its light says so. Other facts state when they were."""

NEEDS_ATTITUDE = (
    WatchedQuantity.CONTROL,
    WatchedQuantity.OSCILLATION,
    WatchedQuantity.TRACKING,
    WatchedQuantity.DRIFT,
)
"""What cannot be watched while attitudes are not numbers."""

OPEN_LOSSES = (Ending.CONTROL_LOST, WatchFact.STOPPED_IN_AIR)
"""Losses in the air, of which it is not known yet how the vehicle met the ground."""

EXPLAINED_BY_LOSS = (
    WatchedQuantity.OSCILLATION,
    WatchedQuantity.MOTOR_LIMITS,
    WatchedQuantity.VIBRATION,
    WatchedQuantity.TRACKING,
    WatchedQuantity.DRIFT,
)
"""What a vehicle that is out of control shows however sound it is: it is not judged after a loss."""

UNWATCHED_BATTERIES = frozenset(
    {PowerLight.POWER_UNMEASURED, PowerLight.SUPPLY_HELD, PowerLight.CELLS_UNKNOWN}
)
"""Lights on the power that say nothing of a battery: it was not measured, or has no limit."""

ALARMING_SHARE = 0.7
"""Share of the last seconds in which a motor is at its upper limit: an alarm.

Healthy vehicles that yaw or climb reach about half of it.
"""

MIN_LIMIT_SAMPLES = 10
"""Least number of outputs by which a motor is said to stay at its limit, a choice: a single one may be of a gust."""

CALM_SECONDS = 10.0
"""Time without what an alarm is about, after which it is over, s: a choice. It is doubled each time the alarm comes
again in the same flight, so that what comes and goes is not reported again and again."""

FALL_SECONDS = 2 * RECOVERY_SECONDS
"""Time after a flight in which a vehicle whose motors were stopped in the air meets the ground and lies still, s."""

LISTENING_SECONDS = 3.0
"""Time after the first review of a boot in which no message counts as missing, s: some come once a second."""

LATE_REPORT_SECONDS = 2.0
"""How long before the latest search for reports one may be dated that is new in this one, s: a choice."""

THOROUGH_PERIOD = 0.8
"""Least time between two thorough reviews, s of the boot clock: every second review is one.

A thorough review takes twice the time of another. What it judges comes in messages of 1 to 2 Hz.
"""

TRACKING_PERIOD = 10.0
"""Time between two judgements of the tracking, s: a choice, since it takes ten times as long as another light."""

URGENT_MESSAGES = ("STATUSTEXT", "HEARTBEAT", "EXTENDED_SYS_STATE")
"""Messages whose changes are reported by the next review, thorough or not: warnings in words, modes and failsafes, and
whether the vehicle is on the ground."""


@dataclass
class _Review:
    """The state of a review of the vehicle that has begun, and whose parts are done one after the other."""

    now: float
    """Time of the review, s of the boot clock."""

    vehicle: Telemetry
    """Identity and parameters of the vehicle."""

    is_flying: bool
    has_settled: bool
    """Whether the flight is settled: vibration counts only then."""

    phase_start: float
    """Since when the vehicle flies, or is on the ground, s."""

    recent_signals: Signals | None
    """Signals of the last minute; None where the review neither is thorough nor has an urgent message to judge."""

    facts: dict[WatchedQuantity, Fact] = field(default_factory=dict)
    """What was found so far, good or bad, by what is watched."""

    latest_times: dict[WatchedQuantity, float] = field(default_factory=dict)
    """Time at which a fault of the last minute was there last, s of the boot clock; others are there now."""


class _StateSample(NamedTuple):
    """A landed state at a time."""

    time: float
    """Time on the boot clock, s."""

    landed_state: int
    """``IN_AIR`` or ``ON_GROUND``."""


class Watchdog:
    """Watches one boot of one vehicle for each ``WatchedQuantity`` but the balance of the motors.

    A review has up to four parts, so that no message waits for all of it: ``begin_review``; in flight
    ``review_lights`` and, every ``TRACKING_PERIOD``, ``review_tracking``; and ``finish_review``. Battery, estimator,
    vibration and tracking are judged by thorough reviews only, every second one. So are reports of the autopilot,
    unless an urgent message has changed.

    Attributes:
        is_thorough: whether the latest review is thorough.
        active: what is wrong as of the last review, by what is watched.
        watch_facts: since when each thing is watched, or why it is not.
        worst_lights: the worst fact found in the latest flight so far, by light.
        earlier_lights: the worst fact found in the flights before it, by light.
        control: judges whether control of the flight was lost.
        drift: looks for wind that carries the vehicle away in the present flight.
        loss: how the flight was lost, by its motion or a report of the autopilot; it stays until the next take-off.
        has_landed: whether the latest flight ended on the ground; not in flight, nor while a vehicle whose motors were
            stopped may still be in the air. True before any flight.
    """

    def __init__(
        self, recent: RecentMessages, former: Watchdog | None = None, *, was_flying: bool = False
    ) -> None:
        """Begins without a review.

        Args:
            recent: messages of the boot.
            former: the watchdog of the former boot, whose loss and lights are kept; None for the first boot.
            was_flying: whether the vehicle flew when the former boot ended.
        """
        self.is_thorough = False
        self.active: dict[WatchedQuantity, Fact] = {}
        self.watch_facts: dict[WatchedQuantity, Fact] = {}
        self.worst_lights: dict[str, Fact] = {}
        if former is not None and was_flying:
            self.worst_lights.update(former.worst_lights)
        self.earlier_lights: dict[str, Fact] = {} if former is None else former.all_lights
        self.control = ControlWatch(recent)
        self.drift = WindDriftDetector(recent.boot)
        self._height = HeightWatch(recent, self.control)
        # Whether the heights on the ground before and after the latest flight were found to differ.
        self._has_drifted = False
        self._tracking = TrackingWatch(recent)
        self.loss: Fact | None = None if former is None else former.loss
        self.has_landed = True
        self._recent = recent
        # Time, s, and MAV_LANDED_STATE at the beginning and the end of each phase.
        self._states: list[_StateSample] = []
        # Reports of the autopilot that the last search found, and the same by ``_identity``.
        self._reports: list[Fact] = []
        self._reported = set[tuple[object, ...]]()
        # Whether the former boot ended in flight, and that the autopilot restarted in flight; None if it did not.
        self._was_flying = was_flying
        # A fall with the motors at idle that has not ended; None without one.
        self._fall: Fact | None = None
        self._restart: Fact | None = None
        # What the autopilot has warned of in the flights of this boot, and its alarms.
        self._warnings: deque[Fact] = deque(maxlen=MAX_EVENTS)
        self._report_alarms = ReportAlarms()
        # The report of a landing that is not certain yet; None without one.
        self._landing_report: Fact | None = None
        # When the reason of each alarm was seen last, s of the boot clock; and how long it must not have been seen
        # before the next end of the alarm, s, once there was an end in this flight.
        self._last_seen: dict[WatchedQuantity, float] = {}
        self._calm_seconds: dict[WatchedQuantity, float] = {}
        self._review_time = -inf
        # Times of the latest thorough review, of the latest search for reports and of the latest judgement of the
        # tracking, s of the boot clock, and the number of changes of urgent messages until then.
        self._thorough_time = -inf
        self._report_time = -inf
        self._tracking_time = -inf
        self._change_count = 0
        # Why the latest light on the power says nothing of the battery; None where it does, or before any.
        self._battery_not_judged: Fact | None = None
        # Time of the first review of the boot, s of the boot clock; None before it.
        self._first_review_time: float | None = None
        # The review that has begun; None between reviews.
        self._review: _Review | None = None

    def add_message(self, message: Message, time: float) -> None:
        """Takes an attitude or its setpoint, by which control and tracking are judged.

        Args:
            message: ATTITUDE, ATTITUDE_QUATERNION or ATTITUDE_TARGET.
            time: time on the boot clock, s.
        """
        self.control.add_message(message, time)
        self._tracking.add_message(message, time)

    @property
    def all_lights(self) -> dict[str, Fact]:
        """The worst fact found in all flights of the session so far, by light."""
        return worst_of_lights(self.earlier_lights, self.worst_lights)

    @property
    def active_alarms(self) -> Facts:
        """What is alarmed now; the loss of the flight first, also while it lies on the ground."""
        active = [fact for fact in self.active.values() if fact.is_bad]
        active += [fact for fact in self._report_alarms.active if fact not in active]
        if self._fall is not None and not self.has_landed:
            active.insert(0, self._fall)
        if self.loss is not None and self.loss not in active:
            active.insert(0, self.loss)
        is_flying = bool(self._states) and self._states[-1].landed_state == IN_AIR
        if self._restart is not None and is_flying:
            active.insert(0, self._restart)
        return tuple(active)

    def begin_review(
        self, now: float, vehicle: Telemetry, *, is_flying: bool, settled_start: float | None
    ) -> list[Fact]:
        """Begins a review: stores the phase of flight, collects the messages so far, and finds new reports in them.

        Every ``THOROUGH_PERIOD`` a review is thorough: everything is judged again. Other reviews only examine urgent
        messages, and only if one of them has changed.

        Args:
            now: present time on the boot clock, s.
            vehicle: identity and parameters of the vehicle, without messages.
            is_flying: whether it is airborne and armed.
            settled_start: beginning of the settled flight, s; None if it is not settled. Vibration is judged in settled
                flight only, since a touch-down shakes the vehicle too.

        Returns:
            Facts that the autopilot has reported since the last review.
        """
        self._note_landed_state(now, IN_AIR if is_flying else ON_GROUND)
        self.is_thorough = now - self._thorough_time >= THOROUGH_PERIOD
        if self.is_thorough:
            self._thorough_time = now
        settled_intervals = None if settled_start is None else [(settled_start, now)]
        # How often an urgent message has differed from the one before, in the whole boot.
        change_count = sum(self._recent.changes[name] for name in URGENT_MESSAGES)
        has_urgent_change = change_count > self._change_count
        self._change_count = change_count
        # Collecting the messages takes most of the time of a review, so it is done only if something may be found.
        recent_signals = None
        if self.is_thorough or has_urgent_change:
            recent_signals = self._signals(vehicle, now, now - MEMORY_SECONDS, settled_intervals)
        self._review = _Review(
            now,
            vehicle,
            is_flying,
            has_settled=settled_intervals is not None,
            phase_start=self._states[-1].time,
            recent_signals=recent_signals,
        )
        if recent_signals is None:
            return []
        reports = self._new_reports(recent_signals, vehicle)
        self._report_time = now
        if not is_flying:
            self._report_alarms.end_flight()
            return reports
        events = [self._event_of_report(report, now) for report in reports]
        self._report_alarms.update(self._reports, now)
        return events

    def _event_of_report(self, report: Fact, now: float) -> Fact:
        """Takes a new report of the autopilot in flight: a warning becomes the fact of its light, and maybe an alarm.

        A light is the judgement of one part of the vehicle, such as its motors.

        Args:
            report: a new report of the autopilot, on anything.
            now: present time on the boot clock, s.

        Returns:
            What is reported to the user: an alarm, or the report itself. A reported crash is an alarm only if nothing
            else has shown the loss before.
        """
        if report.code is SessionFact.ALARM:
            # A restart in flight, whose light is known.
            return report
        if report.code is ReportedEvent.BOARD_VOLTAGE_LOW:
            # In a log a moment below the limit is a warning. In flight nobody knows whether the autopilot survives it.
            report = report.replace(Level.BAD)
        if report.warns:
            self._warnings.append(report)
            light = light_of_event(report)
            if light is not None:
                self._worsen_light(light, report)
        if report.code in POWER_REPORTS:
            return self._alarm_of_power(report, now)
        if report.code in REPORTS_OF_LOSS and report.is_bad:
            is_first = self.loss is not None and self.loss.code is Ending.LOSS_REPORTED
            return event_or_alarm(report, report.start_time) if is_first else report
        return self._report_alarms.add_report(report, now)

    def _alarm_of_power(self, report: Fact, now: float) -> Fact:
        """Makes a warning of the autopilot about its power an active alarm, and returns what is to be reported.

        From then on ``review_lights`` judges the power by this warning too. Since the alarm is active already, it is
        not reported a second time.

        Args:
            report: a new report of the autopilot on the power.
            now: present time on the boot clock, s.

        Returns:
            An alarm if it is bad, otherwise the report.
        """
        if not report.warns:
            return report
        self._last_seen[WatchedQuantity.BATTERY] = now
        active = self.active.get(WatchedQuantity.BATTERY, report)
        self.active[WatchedQuantity.BATTERY] = worst_fact([active, report])
        if report.is_bad:
            return event_or_alarm(report, report.start_time)
        return report

    def _note_landed_state(self, now: float, state: int) -> None:
        """Notes whether the vehicle flies, where that has changed.

        The states are kept as samples, as a log has them, since the functions that judge a log take them.

        Args:
            now: present time on the boot clock, s.
            state: ``IN_AIR`` or ``ON_GROUND``.
        """
        former_state = self._states[-1].landed_state if self._states else state
        if self._states and former_state == state:
            return
        # A landed state that changes for a moment does not begin another flight, so that a loss stays an alarm. In the
        # first phase of a boot, no flight has ended yet: there are two states at most.
        is_first_phase = len(self._states) <= 2
        self._end_drift(now)
        if state == IN_AIR:
            self._fall = None
            self._height.begin_flight()
            self._has_drifted = False
            self.has_landed = False
            self._landing_report = None
            self._calm_seconds = {}
        if state == IN_AIR and (is_first_phase or now - self._states[-1].time >= RECOVERY_SECONDS):
            self.loss = None
            self.active.pop(WatchedQuantity.CONTROL, None)
            # After a restart of the autopilot in flight, the flight goes on.
            if not (is_first_phase and self._was_flying):
                self.earlier_lights = self.all_lights
                self.worst_lights = {}
        # The former state is known to hold until the last review, the new one from now on.
        self._states.append(_StateSample(self._review_time, former_state))
        self._states.append(_StateSample(now, state))

    def _end_drift(self, now: float) -> None:
        """Ends a drift in wind with its flight, also as the fact of its light, and begins to look for another one.

        Args:
            now: present time on the boot clock, s.
        """
        self.drift.end(now)
        drift = self.drift.latest
        light = self.worst_lights.get(str(Light.WIND))
        if drift is not None and light is not None and light.code is drift.code:
            self.worst_lights[str(Light.WIND)] = drift
        self.drift = WindDriftDetector(self._recent.boot)

    def review_lights(self) -> None:
        """Judges battery, estimator and, in settled flight, vibration, by the functions that judge a log.

        The battery is judged by all messages and warnings of the boot, estimator and vibration by those of the last
        minute. The review must have begun, and be thorough; the results are added to its facts.
        """
        review = self._review
        assert review is not None
        assert review.recent_signals is not None
        all_signals = self._signals(review.vehicle, review.now, -inf)
        condition = Condition(duration=review.now - review.phase_start)
        findings = LiveFindings(events=tuple(self._warnings))
        power = power_light(live_evidence(all_signals, condition, findings))
        review.facts[WatchedQuantity.BATTERY] = power
        self._battery_not_judged = _reason_battery_not_judged(power)
        # The estimator is judged by the last minute alone, since it may recover: earlier warnings must not last.
        recent_warnings = [
            warning
            for warning in self._warnings
            if warning.start_time > review.now - MEMORY_SECONDS
        ]
        findings = LiveFindings(events=tuple(recent_warnings))
        evidence = live_evidence(review.recent_signals, condition, findings)
        estimator = estimator_light(evidence)
        if estimator.code is not EstimatorLight.ESTIMATOR_UNMEASURED:
            review.facts[WatchedQuantity.ESTIMATOR] = estimator
            if estimator.warns and estimator.time is not None and not is_lasting_state(estimator):
                end_time = estimator.time + estimator.figures.get("duration", 0.0)
                review.latest_times[WatchedQuantity.ESTIMATOR] = end_time
        if review.has_settled:
            vibration = vibration_light(evidence)
            review.facts[WatchedQuantity.VIBRATION] = vibration
            if vibration.warns:
                review.latest_times[WatchedQuantity.VIBRATION] = latest_vibration_time(
                    review.recent_signals, vibration.figures["acceptable_vibration"]
                )

    @property
    def is_tracking_due(self) -> bool:
        """Whether the review that has begun is to judge the tracking: in settled flight, every ``TRACKING_PERIOD``."""
        review = self._review
        assert review is not None
        return review.has_settled and abs(review.now - self._tracking_time) >= TRACKING_PERIOD

    def review_tracking(self, settled_start: float) -> None:
        """Judges how the vehicle follows its setpoints in the latest minute of settled flight, as a log is judged.

        Args:
            settled_start: since when the flight is settled, s of the boot clock.
        """
        review = self._review
        assert review is not None
        self._tracking_time = review.now
        tracking = self._tracking.light(review.now, review.vehicle, settled_start)
        if tracking is not None:
            review.facts[WatchedQuantity.TRACKING] = tracking

    def finish_review(self, motion: RecentMotion | None, takeoff_time: float = -inf) -> list[Fact]:
        """Ends the review that has begun: judges the motion in flight, and compares all findings with active alarms.

        Args:
            motion: attitude and motor outputs of the last seconds; None if they do not come.
            takeoff_time: when the vehicle left the ground, s of the boot clock; minus infinity where that was not seen.

        Returns:
            A landing that is certain now, and alarms that begin, become worse, or are over.
        """
        review = self._review
        assert review is not None
        self._review = None
        news = []
        if review.is_flying:
            news += self._judge_control(review, takeoff_time, motion)
            self._judge_drift_and_height(review, takeoff_time, motion)
            if motion is not None:
                self._add_motion_facts(review, motion)
            if WatchedQuantity.OSCILLATION in review.facts:
                # In a limit cycle the motors go from limit to limit, and cannot be compared with each other.
                self._forget_good_motors()
            if self.loss is not None:
                for kind in EXPLAINED_BY_LOSS:
                    review.facts.pop(kind, None)
        else:
            self._judge_end_of_flight(review, takeoff_time, motion)
            news += self._judge_barometer_on_ground(review, takeoff_time, motion)
        if self.has_landed and self._landing_report is not None:
            news.append(self._landing_report)
            self._landing_report = None
        self._update_watch_facts(review, motion)
        news += self._changed_alarms(review)
        self._review_time = review.now
        return news

    def _judge_control(
        self, review: _Review, takeoff_time: float, motion: RecentMotion | None
    ) -> list[Fact]:
        """Judges in flight whether control was lost, and whether the vehicle falls or has met the ground.

        Args:
            review: the review, whose ``facts`` get the loss.
            takeoff_time: when the vehicle left the ground, s of the boot clock; minus infinity where that was not seen.
            motion: attitude and motor outputs of the last seconds; None if they do not come.

        Returns:
            The alarm of a fall with idle motors that begins, or its end once the motors carry the vehicle again. A fall
            is no loss yet: the pilot may catch the vehicle.
        """
        circumstances = (review.now, review.vehicle, takeoff_time, motion)
        loss = self.control.loss(*circumstances)
        if loss is not None:
            self.loss = self.active.get(WatchedQuantity.CONTROL, loss)
            if self.loss.code in OPEN_LOSSES:
                self.loss = self.control.contact_after_loss(*circumstances) or self.loss
            review.facts[WatchedQuantity.CONTROL] = self.loss
            self._judge_motors_of_loss(self.loss)
        if self.loss is not None:
            self._fall = None
            return []
        fall = self.control.fall(*circumstances)
        if fall is not None:
            is_new = self._fall is None
            self._fall = fall
            return [event_or_alarm(fall, review.now)] if is_new else []
        if self._fall is None or not carries_vehicle(motion, review.vehicle.parameters):
            return []
        end = Fact(WatchFact.ALARM_OVER, time=review.now, reason=self._fall)
        self._fall = None
        return [end]

    def _judge_drift_and_height(
        self, review: _Review, takeoff_time: float, motion: RecentMotion | None
    ) -> None:
        """Judges in flight drift in wind, and whether the estimates of attitude and height have failed.

        Args:
            review: the review, whose ``facts`` are added to.
            takeoff_time: when the vehicle left the ground, s of the boot clock; minus infinity where that was not seen.
            motion: attitude and motor outputs of the last seconds; None if they do not come.
        """
        invalid_attitude = self.control.invalid_attitude(review.vehicle)
        if invalid_attitude is not None:
            known = review.facts.get(WatchedQuantity.ESTIMATOR, invalid_attitude)
            review.facts[WatchedQuantity.ESTIMATOR] = worst_fact([invalid_attitude, known])
            review.latest_times.pop(WatchedQuantity.ESTIMATOR, None)
        found = {WatchedQuantity.DRIFT: self.drift.latest}
        if self.is_thorough:
            found[WatchedQuantity.HEIGHT] = self._height.divergence(
                review.now, review.vehicle, takeoff_time, motion
            )
        for kind, fact in found.items():
            if fact is not None:
                review.facts[kind] = fact
                review.latest_times[kind] = fact.end_time or review.now

    def _judge_barometer_on_ground(
        self, review: _Review, takeoff_time: float, motion: RecentMotion | None
    ) -> list[Fact]:
        """Compares the barometer on the ground before and after the latest flight, once the vehicle rests.

        Args:
            review: the review, by whose time the vehicle is on the ground.
            takeoff_time: when the vehicle left the ground, s of the boot clock; minus infinity where that was not seen.
            motion: attitude and motor outputs of the last seconds; None if they do not come.

        Returns:
            The event that the barometer has drifted, the first time that it is found after a flight.
        """
        if not self.is_thorough:
            return []
        seconds_on_ground = review.now - review.phase_start
        # The states before the last are the beginning and the end of the phase before this one.
        has_flown = self._states[-2].landed_state == IN_AIR and self.has_landed
        if has_flown and not self._has_drifted and seconds_on_ground <= MAX_WAIT_SECONDS:
            flight_interval = (takeoff_time, review.phase_start)
            drift = self._height.drift_at_landing(review.vehicle, flight_interval, motion)
            if drift is not None:
                self._has_drifted = True
                self._worsen_light(Light.ESTIMATOR, drift)
                return [drift]
        self._height.add_rest(review.vehicle, motion)
        return []

    def _judge_end_of_flight(
        self, review: _Review, takeoff_time: float, motion: RecentMotion | None
    ) -> None:
        """Judges whether the flight that has just ended did so on the ground or, if not, how the vehicle was lost.

        A vehicle that was disarmed in the air falls, and its impact is an alarm as in flight. It is looked for in each
        review until ``FALL_SECONDS`` after the end of the flight. If none is found, it stays unknown how the vehicle
        came down, and it does not count as landed. Where control had been lost, it is now known how the vehicle met the
        ground.

        Args:
            review: the review, whose ``facts`` are added to.
            takeoff_time: when the vehicle left the ground, s of the boot clock; minus infinity where that was not seen.
            motion: motor outputs of the last seconds; None if they do not come.
        """
        if len(self._states) < 2:
            return
        # The last two states are of the review in which the vehicle was last in the air, and of the first one after
        # that. The motors stopped between them.
        last_state_in_air, first_state_after = self._states[-2:]
        if last_state_in_air.landed_state != IN_AIR:
            return
        flight_end = last_state_in_air.time
        if review.now - flight_end > FALL_SECONDS:
            return
        end = self.control.flight_end(
            review.vehicle, (takeoff_time, flight_end), self._reports, motion
        )
        self.has_landed = not end.is_in_air
        loss = None
        if end.loss is not None and end.loss.is_bad:
            loss = end.loss
        elif end.is_falling and self.loss is None:
            fall_start = first_state_after.time if self._fall is None else self._fall.time
            loss = Fact(WatchFact.STOPPED_IN_AIR, Level.BAD, time=fall_start)
        # A loss in the air is replaced once it is known how the vehicle met the ground. Any other loss stays.
        is_earlier_loss_final = self.loss is not None and self.loss.code not in OPEN_LOSSES
        if loss is not None and not is_earlier_loss_final:
            review.facts[WatchedQuantity.CONTROL] = loss
            self.loss = loss
            self._fall = None
            self._judge_motors_of_loss(loss)

    def _judge_motors_of_loss(self, loss: Fact) -> None:
        """Makes a loss that a motor caused the light of the motors, and forgets that they were found sound before.

        The light is the judgement of the motors of the whole flight, a fact with a level.

        Args:
            loss: how the flight was lost; its subject is the motor that failed first, if one is known.
        """
        if loss.subject:
            self._worsen_light(Light.MOTORS, loss)
        self._forget_good_motors()

    def _worsen_light(self, light: str, fact: Fact) -> None:
        """Replaces the fact of a light in this flight by a worse one.

        Args:
            light: name of the light, the judgement of one part of the vehicle.
            fact: what was found. It is not used if the light has a fact that is worse.
        """
        earlier = self.worst_lights.get(str(light), fact)
        self.worst_lights[str(light)] = worst_fact([fact, earlier])

    def _forget_good_motors(self) -> None:
        """Removes the light that motors are sound, of a vehicle that lost control or oscillates."""
        light = self.worst_lights.get(str(Light.MOTORS))
        if light is not None and light.is_good:
            del self.worst_lights[str(Light.MOTORS)]

    def _signals(
        self,
        vehicle: Telemetry,
        now: float,
        start_time: float,
        settled: Intervals | None = None,
    ) -> Signals:
        """Prepares the vehicle's status messages for the functions that judge a recorded flight.

        Args:
            vehicle: identity and parameters.
            now: time of the review, s of the boot clock; until then the latest phase lasts.
            start_time: messages before it are left out, s.
            settled: intervals of settled flight, s; None if they are not needed.

        Returns:
            Signals in the form that a log gives.
        """
        columns = self._recent.columns((*STATUS_MESSAGES, *ESTIMATOR_FLAG_MESSAGES), start_time)
        # The names of flight modes come once, when a ground station asks for them.
        columns |= self._recent.columns(["AVAILABLE_MODES"])
        # The latest landed state holds until now.
        states = [*self._states, _StateSample(now, self._states[-1].landed_state)]
        boots = [self._recent.boot] * len(states)
        if self._was_flying:
            # Of the former boot only this is known: that the vehicle flew.
            states.insert(0, _StateSample(0.0, IN_AIR))
            boots.insert(0, self._recent.boot - 1)
        landed_state = TimeSeries(
            np.array([sample.time for sample in states]),
            boot=np.array(boots),
            values=np.array([sample.landed_state for sample in states]),
        )
        return LiveSignals(
            replace(vehicle, messages=columns),
            landed_state=landed_state,
            preset_settled_intervals=settled,
        )

    def _new_reports(self, signals: Signals, vehicle: Telemetry) -> list[Fact]:
        """Finds the autopilot's reports that are new since the last search.

        ``reported_events`` finds all reports of the last minute, most of which earlier searches found, too. A report is
        new if the last search did not find it and its time is not long past. Without the second condition, an old
        report would appear as new when a later one that had superseded it leaves the minute.

        Args:
            signals: signals of the last minute.
            vehicle: identity and parameters of the vehicle, without messages.

        Returns:
            The new reports. A crash that the motion does not show is to be watched only.
        """
        former_identities = self._reported
        facts = reported_events(signals)
        self._reports = list(facts)
        self._reported = {_identity(fact) for fact in facts}
        reports = []
        for fact in facts:
            if fact.code is ReportedEvent.RESTARTED_IN_FLIGHT:
                # A restart is found some seconds late, and its cause may be found later still. So it is reported once,
                # however old it is, and its light is updated each time.
                if self._restart is None:
                    reports.append(event_or_alarm(fact, fact.start_time))
                self._note_restart(fact)
                continue
            is_known = _identity(fact) in former_identities
            is_late = fact.start_time <= self._report_time - LATE_REPORT_SECONDS
            # These facts mean something in a log only: a stream begins anywhere, and ``BootClock`` reports restarts.
            is_for_logs_only = fact.code is ReportedEvent.RESTARTED or fact.figures.get("is_begun")
            if is_known or is_late or is_for_logs_only:
                continue
            report = fact.replace(height=None)
            if fact.code is ReportedEvent.ON_GROUND and not self.has_landed:
                # The rest of the review finds out whether the vehicle is on the ground.
                self._landing_report = report
            else:
                reports.append(report)
        if any(fact.code in REPORTS_OF_LOSS for fact in reports):
            reports = self.control.weighed_reports(vehicle, reports)
        reports_of_loss = [fact for fact in reports if fact.code in REPORTS_OF_LOSS]
        if self.loss is None and reports_of_loss:
            self.loss = ending_of(signals, reports_of_loss)
        return reports

    def _note_restart(self, restart: Fact) -> None:
        """Makes a restart of the autopilot in flight the fact of its light, which depends on its cause.

        Args:
            restart: the restart, as far as it is known now.
        """
        for name, fact in list(self.worst_lights.items()):
            if fact == self._restart:
                del self.worst_lights[name]
        self._restart = restart
        light = light_of_event(restart)
        assert light is not None
        self.worst_lights[str(light)] = restart

    def _add_motion_facts(self, review: _Review, motion: RecentMotion) -> None:
        """Judges the motion in flight: a limit cycle that begins, and a motor that stays at its upper limit.

        Args:
            review: the review, whose ``facts`` are added to.
            motion: attitude and motor outputs of the last seconds.
        """
        motors = motion.motors
        at_upper, at_lower = samples_at_limits(motors.scale.fraction(motors.outputs), motors.scale)
        # A limit cycle is bounded by motors at their limits, which in most flights are none: this saves the detection.
        if at_upper.any() or at_lower.any():
            cycle = detect_starting_limit_cycle(
                motors,
                motion.tilts,
                self.control.setpoints(review.vehicle),
                self._recent.boot,
                review.phase_start,
                review.now,
            )
            if cycle is not None:
                # The same gains are to be lowered as the judgement of the recording says after the landing.
                lowered_gains = gain_reduction_advice(cycle, review.vehicle.parameters)
                review.facts[WatchedQuantity.OSCILLATION] = Fact(
                    MarginsLight.OSCILLATES, reason=lowered_gains, **cycle.figures
                )
        has_just_taken_off = review.now - review.phase_start < DECISION_SECONDS
        latest_count = int(np.count_nonzero(motors.time >= review.now - DECISION_SECONDS))
        if latest_count and len(at_upper) >= MIN_LIMIT_SAMPLES and not has_just_taken_off:
            # The outputs of the last ``DECISION_SECONDS`` or, of a slow message, the last ``MIN_LIMIT_SAMPLES``.
            latest = slice(-max(latest_count, MIN_LIMIT_SAMPLES), None)
            limited_motor = _limited_motor(motors.geometry.names, at_upper[latest])
            outputs = motors.scale.fraction(motors.outputs[latest]).mean(axis=0)
            # Where all thrust is in use, as in a climb at full throttle, it is by chance which motor is at its limit.
            has_reserve = outputs.min() < SPENT_THRUST_SHARE * motors.scale.stop
            if limited_motor is not None and has_reserve:
                active = self.active.get(WatchedQuantity.MOTOR_LIMITS)
                duration = review.now - motors.time[latest][0]
                review.facts[WatchedQuantity.MOTOR_LIMITS] = _with_earlier_motors(
                    limited_motor.replace(duration=duration), active
                )

    def _changed_alarms(self, review: _Review) -> list[Fact]:
        """Compares the facts of a review with the active alarms, updates these, and returns what changed.

        There is at most one alarm for each watched quantity, such as the vibration:

        - It begins, or is reported again, when a fact warns with another level or code than the active alarm. Other
          figures only update it.
        - It ends after the landing, or when its reason has not been found for ``CALM_SECONDS``, so that a condition
          that comes and goes gives one alarm. :meth:`_ended_alarms` has the exceptions.

        The worst fact of each light (motors, vibration, power, …) is kept for the judgement of the whole flight. Once
        its alarm is over, it says so.

        Args:
            review: the review that ends, with all its facts. A fact that is about an event more than ``CALM_SECONDS``
                ago, and has no active alarm, is dropped.

        Returns:
            Alarms, with the time of the review, and ends of alarms, with the time at which the reason was seen last;
            s of the boot clock.
        """
        for kind, latest_time in review.latest_times.items():
            is_over = review.now - latest_time >= CALM_SECONDS
            if is_over and kind not in self.active:
                # After a loss of control, the fact may have been removed already (``EXPLAINED_BY_LOSS``).
                review.facts.pop(kind, None)
        for kind, fact in review.facts.items():
            self._worsen_light(LIGHTS[kind], fact)
        return [*self._begun_alarms(review), *self._ended_alarms(review)]

    def _begun_alarms(self, review: _Review) -> list[Fact]:
        """Makes the warnings of a review active alarms, and returns those that are new or have become others.

        Args:
            review: the review that ends, with its facts by watched quantity. Where the reason of a warning was seen
                last before the review, ``latest_times`` has that time, s of the boot clock.

        Returns:
            The alarms to report, with the time of the review.
        """
        alarms = []
        for kind, fact in review.facts.items():
            if not fact.warns:
                continue
            last_seen = review.latest_times.get(kind, review.now)
            self._last_seen[kind] = max(last_seen, self._last_seen.get(kind, -inf))
            active = self.active.get(kind)
            self.active[kind] = fact
            is_same = active is not None and (active.level, active.code) == (fact.level, fact.code)
            # What the autopilot itself reports of the estimator was reported to the user when it came.
            was_reported = kind is WatchedQuantity.ESTIMATOR and isinstance(
                fact.code, ReportedEvent
            )
            if not is_same and not was_reported:
                alarms.append(event_or_alarm(fact, review.now))
        return alarms

    def _ended_alarms(self, review: _Review) -> list[Fact]:
        """Removes the active alarms that are over, and returns their ends as facts.

        An alarm is over on the ground, or when its reason has not been seen for ``CALM_SECONDS``. What is judged more
        rarely than that, the tracking, is not over before it was judged again without a fault. The calm time is doubled
        with each end of the alarm in a flight, so that an alarm which comes and goes is reported less and less often.
        The alarm of a loss of control stays on the ground. If an alarm of ``PRESENT_FAULTS`` ends in flight, its light
        says that it is over; the lights of all other alarms keep stating what was wrong.

        Args:
            review: the review that ends; its warnings are among the active alarms already.

        Returns:
            The ends to report. After a loss of control no end is reported, since a wreck is no sound vehicle; nor is
            that of an alarm on the ground about a battery, or about a state that lasts.
        """
        is_wreck = self.loss is not None and not review.is_flying
        ends = []
        for kind in list(self.active):
            # On the ground, the alarm of a loss of control stays.
            if is_wreck and kind is WatchedQuantity.CONTROL:
                continue
            last_seen = self._last_seen[kind]
            calm_seconds = self._calm_seconds.get(kind, CALM_SECONDS)
            if review.is_flying and review.now - last_seen < calm_seconds:
                continue
            # The latest judgement of the tracking holds until the next one.
            is_tracking = kind is WatchedQuantity.TRACKING
            if review.is_flying and is_tracking and last_seen >= self._tracking_time:
                continue
            ended_alarm = self.active.pop(kind)
            self._calm_seconds[kind] = 2 * calm_seconds
            if kind is WatchedQuantity.CONTROL:
                self.loss = None
            # A landing neither charges a battery nor ends a state such as no fix of the GPS receiver.
            is_lasting = kind is WatchedQuantity.BATTERY or is_lasting_state(ended_alarm)
            if is_wreck or (is_lasting and not review.is_flying):
                continue
            end = Fact(WatchFact.ALARM_OVER, time=last_seen, reason=ended_alarm)
            ends.append(end)
            if review.is_flying and kind in PRESENT_FAULTS:
                self._say_that_light_is_over(kind, end, ended_alarm)
        return ends

    def _say_that_light_is_over(self, kind: WatchedQuantity, end: Fact, ended_alarm: Fact) -> None:
        """Makes the end of an alarm the fact of its light, which keeps its level.

        A light that states something else, such as a worse fault, stays as it is.

        Args:
            kind: the quantity that the alarm is about; it determines the light.
            end: the fact that the alarm is over.
            ended_alarm: the alarm.
        """
        light = str(LIGHTS[kind])
        stated = self.worst_lights.get(light)
        if stated is not None and stated.code is ended_alarm.code:
            self.worst_lights[light] = end.replace(ended_alarm.level)

    def _update_watch_facts(self, review: _Review, motion: RecentMotion | None) -> None:
        """Notes for each watched quantity, such as vibration, since when it is watched, or why it is not.

        A quantity is not watched if its messages are missing, and on the ground, where only the autopilot's warnings
        are. The motors' balance is left out, since ``VehicleReview`` notes it.

        Args:
            review: results of this review.
            motion: the motion of the last minute; None if too little was received.
        """
        reasons = self._reasons_not_watched(review.now, review.vehicle, motion)
        if self._first_review_time is None:
            self._first_review_time = review.now
        is_new = review.now - self._first_review_time < LISTENING_SECONDS
        for kind in WatchedQuantity:
            if kind is WatchedQuantity.MOTORS:
                continue
            reason = reasons.get(kind)
            if reason is not None and reason.code is WatchFact.MESSAGE_MISSING and is_new:
                # Shortly after the first review, messages that are sent once a second may just not have come yet.
                continue
            if reason is None and not review.is_flying and kind is not WatchedQuantity.WARNINGS:
                reason = Fact(WatchFact.ON_GROUND_NOW)
            self.set_watched(kind, reason, review.now)

    def _reasons_not_watched(
        self, now: float, vehicle: Telemetry, motion: RecentMotion | None
    ) -> Mapping[WatchedQuantity, Fact]:
        """Finds out what cannot be watched because the messages for it are missing or too slow.

        Oscillation and motors at their limits are judged by attitude and motor outputs. To see an oscillation (a limit
        cycle), these must also come at half of ``MIN_STREAM_RATE`` at least; a motor at its limit shows in any
        ``MIN_LIMIT_SAMPLES`` of the last seconds. Vibration, battery, estimator, drift and the autopilot's warnings
        each need a message, which must have come within the last ``MEMORY_SECONDS``, and the tracking setpoints of the
        attitude. A battery that the light on the power cannot judge is not watched either.

        Args:
            now: present time on the boot clock, s.
            vehicle: identity and parameters of the vehicle, without messages.
            motion: attitude and motor outputs of the last seconds; None if they do not come.

        Returns:
            For each thing that cannot be watched, the fact that names the missing or slow message; things that can be
            watched are left out.
        """
        reasons = {}
        if motion is None:
            reasons[WatchedQuantity.OSCILLATION] = Fact(RowsFact.NO_LIVE_MOTORS)
            reasons[WatchedQuantity.MOTOR_LIMITS] = Fact(RowsFact.NO_LIVE_MOTORS)
        elif motion.rate < MIN_STREAM_RATE / 2:
            reasons[WatchedQuantity.OSCILLATION] = Fact(
                WatchFact.MESSAGE_MISSING, name=motion.motors.message, rate=motion.rate
            )
            if len(motion.motors.time) < MIN_LIMIT_SAMPLES:
                reasons[WatchedQuantity.MOTOR_LIMITS] = reasons[WatchedQuantity.OSCILLATION]
        received = self._recent.names_since(now - MEMORY_SECONDS)
        # One of these messages is enough; the first is named where all are missing: that of the autopilot.
        estimator_messages = tuple(ESTIMATOR_FLAG_MESSAGES)
        if vehicle.autopilot == "PX4":
            estimator_messages = estimator_messages[::-1]
        needed_messages = {
            WatchedQuantity.VIBRATION: ("VIBRATION",),
            WatchedQuantity.BATTERY: BATTERY_MESSAGES,
            WatchedQuantity.ESTIMATOR: estimator_messages,
            WatchedQuantity.WARNINGS: ("HEARTBEAT",),
            WatchedQuantity.DRIFT: ("LOCAL_POSITION_NED",),
            WatchedQuantity.HEIGHT: (BAROMETER_MESSAGE,),
        }
        for kind, names in needed_messages.items():
            if not received.intersection(names):
                reasons[kind] = Fact(WatchFact.MESSAGE_MISSING, name=names[0], rate=None)
        if not self._tracking.has_setpoints(now):
            reasons[WatchedQuantity.TRACKING] = Fact(
                WatchFact.MESSAGE_MISSING, name=SETPOINT_MESSAGE, rate=None
            )
        invalid_attitude = self.control.invalid_attitude(vehicle)
        if invalid_attitude is not None:
            for kind in NEEDS_ATTITUDE:
                reasons[kind] = invalid_attitude
        if self._battery_not_judged is not None:
            reasons.setdefault(WatchedQuantity.BATTERY, self._battery_not_judged)
        return reasons

    def note_motors_watched(self, now: float) -> None:
        """Notes for the light of the motors that their balance is tested, and that no loss of thrust was found yet.

        A loss is an alarm of its own, which outranks this. After a loss of control, or while the vehicle oscillates,
        nothing is noted: motors that go from stop to stop are not compared with each other.

        Args:
            now: present time on the boot clock, s.
        """
        if self.loss is not None or WatchedQuantity.OSCILLATION in self.active:
            return
        self.worst_lights.setdefault(
            str(Light.MOTORS), Fact(MotorWatchFact.NO_LOSS_FOUND, clock=now)
        )

    def set_watched(self, quantity: WatchedQuantity, reason: Fact | None, now: float) -> None:
        """Sets the fact that a quantity is watched, or why it is not, with the time since which that is so.

        It is called at each review. The fact is replaced only if it has changed: its time says since when it is valid.

        Args:
            quantity: what is watched, such as the vibration.
            reason: why it is not watched; None if it is.
            now: present time on the boot clock, s.
        """
        code = WatchFact.NOT_WATCHED if reason else WatchFact.WATCHED
        former = self.watch_facts.get(quantity)
        is_unchanged = (
            former is not None and former.code is code and former.figures.get("reason") == reason
        )
        if not is_unchanged:
            self.watch_facts[quantity] = Fact(code, time=now, subject=quantity, reason=reason)


def worst_of_lights(first: NamedFacts, second: NamedFacts) -> dict[str, Fact]:
    """Returns the worse of two facts of each light; a light that only one of them has is taken from that.

    Args:
        first: facts by name of the light. Where both facts of a light are equally bad, this one is returned.
        second: other facts by name of the light.
    """
    return {
        name: worst_fact([lights[name] for lights in (first, second) if name in lights])
        for name in {**first, **second}
    }


def _limited_motor(names: Names, at_upper_limit: Flags) -> Fact | None:
    """Returns the fact that a motor stays at its upper limit, where it leaves the controller no authority.

    Args:
        names: names of the k motors.
        at_upper_limit: (N, k) whether each motor was at its limit, over the last ``DECISION_SECONDS``, or in the last
            ``MIN_LIMIT_SAMPLES`` where those came more slowly.

    Returns:
        The fact; None if no motor was there for ``ALARMING_SHARE`` of the time, or all were, as in a climb at full
        throttle.
    """
    shares = at_upper_limit.mean(axis=0)
    largest_share = shares.max()
    if largest_share < ALARMING_SHARE or shares.min() >= ALARMING_SHARE:
        return None
    limited_names = most_limited_motors(names, shares)
    return Fact(
        MotorsLight.MOTOR_LIMITED,
        subject=limited_names[0] if len(limited_names) == 1 else "",
        names=limited_names,
        share=largest_share,
    )


def _with_earlier_motors(limited_motor: Fact, active: Fact | None) -> Fact:
    """Adds the motors of the active alarm to those at their limit now, since motors that take turns are one event.

    Args:
        limited_motor: fact on the motors that are at their limit now, with their names and share of the time.
        active: the active alarm, the same fact on motors that were at their limit before; None without an alarm.

    Returns:
        The fact on all these motors, with the larger share.
    """
    if active is None:
        return limited_motor
    # A dictionary keeps each name once, in order.
    names = tuple(dict.fromkeys((*active.figures["names"], *limited_motor.figures["names"])))
    return limited_motor.replace(
        subject=names[0] if len(names) == 1 else "",
        names=names,
        share=max(active.figures["share"], limited_motor.figures["share"]),
    )


def latest_vibration_time(signals: Signals, limit: float) -> float:
    """Returns when the vibration was last above a limit, or an accelerometer out of its range.

    Args:
        signals: signals of the last minute, in which the vibration was judged.
        limit: vibration, m/s².

    Returns:
        The time, s of the boot clock; minus infinity if it was in no sample.
    """
    vibration = reported_vibration(signals)
    assert vibration is not None
    is_strong = (vibration.levels.values > limit).any(axis=1) | (vibration.clips > 0).any(axis=1)
    return float(vibration.levels.time[is_strong].max(initial=-inf))


def not_watched(watch_fact: Fact, reason: Fact, time: float) -> Fact:
    """Replaces a ``watch_fact`` while the link is silent, since nothing is watched then.

    Args:
        watch_fact: fact since when it was monitored, or why it was not.
        reason: reason why it no longer is.
        time: time from which on it is not, s on the boot clock.

    Returns:
        The fact NOT_WATCHED on the same subject, with the reason.
    """
    figures = dict(watch_fact.figures)
    figures["reason"] = reason
    return Fact(WatchFact.NOT_WATCHED, time=time, subject=watch_fact.subject, **figures)


def _reason_battery_not_judged(power: Fact) -> Fact | None:
    """Returns why a light on the power says nothing of the battery; None if it judges one.

    The reason has none of the light's measurements, so that it stays the same from review to review.

    Args:
        power: the light on the power.
    """
    if power.code not in UNWATCHED_BATTERIES:
        return None
    return Fact(
        WatchFact.BATTERY_NOT_JUDGED,
        cause=power.code,
        is_constant=bool(power.figures.get("is_constant") and power.figures.get("voltage")),
    )


def _identity(fact: Fact) -> tuple[object, ...]:
    """Returns what the facts of two reviews about the same report have in common, so that it is reported once."""
    return fact.code, fact.subject, fact.figures.get("text"), fact.time
