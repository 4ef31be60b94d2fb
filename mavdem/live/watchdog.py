"""Faults of a live vehicle by its own messages, without a model, as facts: findings with a code, a level and figures.

It is the judgement of a log in small steps. What the autopilot reports, and the lights of vibration, power, estimator
and tracking, are those of ``mavdem.assessment`` on the messages so far. A limit cycle is found in the last seconds by
``mavdem.loops.limit_cycles``.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from math import inf

from mavdem.assessment.condition import Condition
from mavdem.assessment.ending import REPORTS_OF_LOSS, find_ending
from mavdem.assessment.event_lights import light_of_event
from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.assessment.innovations import INNOVATION_LIMIT, INNOVATIONS, latest_time_above
from mavdem.assessment.lights.estimator import estimator_light
from mavdem.assessment.lights.power import POWER_REPORTS, power_light
from mavdem.assessment.lights.vibration import vibration_light
from mavdem.assessment.limits import worst_fact
from mavdem.assessment.wind_drifts import WindDriftDetector
from mavdem.dataset.intervals import Intervals
from mavdem.dataset.quality import samples_at_limits
from mavdem.dataset.setpoints import SETPOINT_MESSAGE
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, Signals
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.ending import Ending, FailedFirst, MotionEvent
from mavdem.facts.estimator import EstimatorLight
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light
from mavdem.facts.margins import MarginsLight
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.session import SessionFact
from mavdem.facts.watch import WatchedQuantity, WatchFact
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import IN_AIR, ON_GROUND
from mavdem.live.active_alarms import CALM_SECONDS, ActiveAlarms
from mavdem.live.control_watch import ControlWatch, FlightEnd, carries_vehicle
from mavdem.live.flight_lights import FlightLights
from mavdem.live.height_watch import HeightWatch
from mavdem.live.landed_states import LandedStates
from mavdem.live.live_signals import (
    FlightMoment,
    LiveFindings,
    LiveSignals,
    RecentMotion,
    live_evidence,
)
from mavdem.live.messages import STATUS_MESSAGES, Message
from mavdem.live.motor_limits import (
    motor_at_upper_limit,
    sinks_at_limit,
    with_earlier_motors,
)
from mavdem.live.recent_messages import MAX_EVENTS, RecentMessages
from mavdem.live.report_alarms import ReportAlarms, is_lasting_state
from mavdem.live.report_search import ReportSearch
from mavdem.live.samples import DECISION_SECONDS
from mavdem.live.tracking_watch import TrackingWatch
from mavdem.live.watch_list import (
    LISTENING_SECONDS,
    WatchList,
    quantities_without_message,
    quantities_without_motion,
    reason_battery_not_judged,
)
from mavdem.loops.advice import gain_reduction_advice
from mavdem.loops.limit_cycles import detect_starting_limit_cycle
from mavdem.motors.motor_changes import event_or_alarm
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
"""The part of the vehicle (light) that a fault of each watched quantity is a fault of."""

PRESENT_FAULTS = (
    WatchedQuantity.OSCILLATION,
    WatchedQuantity.MOTOR_LIMITS,
    WatchedQuantity.VIBRATION,
    WatchedQuantity.TRACKING,
    WatchedQuantity.DRIFT,
)
"""Quantities whose facts state a fault of the present moment. Once one is over in flight, its light says so. The facts
of other quantities state when their fault was."""

NEEDS_ATTITUDE = (
    WatchedQuantity.CONTROL,
    WatchedQuantity.OSCILLATION,
    WatchedQuantity.TRACKING,
    WatchedQuantity.DRIFT,
)
"""What cannot be watched while attitudes are not numbers."""

LOSSES_IN_AIR = (Ending.CONTROL_LOST, WatchFact.STOPPED_IN_AIR)
"""Losses of vehicles that are still in the air: how they meet the ground, which ends the flight, is not known yet."""

OPEN_LOSSES = (*LOSSES_IN_AIR, Ending.LOSS_REPORTED)
"""Losses that a contact with the ground replaces: by the motion a flight is known to be lost better, as in a log, than
by the autopilot's report."""

EXPLAINED_BY_LOSS = (
    WatchedQuantity.OSCILLATION,
    WatchedQuantity.MOTOR_LIMITS,
    WatchedQuantity.VIBRATION,
    WatchedQuantity.TRACKING,
    WatchedQuantity.DRIFT,
)
"""Quantities in which a vehicle out of control has faults however sound it is: they are not judged after a loss."""

CAUSED_LOSSES = (Ending.CONTROL_LOST, Ending.CRASHED)
"""Losses that a motor at its limit may have caused."""

FALL_SECONDS = 2 * RECOVERY_SECONDS
"""Time after a flight in which a vehicle whose motors were stopped in the air meets the ground and lies still, s."""

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
    """One review of the vehicle: the present moment, and the facts that were found so far."""

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
    """The fact that was found on each quantity, good or bad."""

    last_found_times: dict[WatchedQuantity, float] = field(default_factory=dict)
    """When the faults of the last minute were there last, s of the boot clock; other faults are there now."""

    def last_found_time(self, quantity: WatchedQuantity) -> float:
        """Returns when the fault of a quantity was there last, s of the boot clock."""
        return self.last_found_times.get(quantity, self.now)


class Watchdog:
    """Watches one boot of a vehicle for faults of each ``WatchedQuantity``, such as vibration or loss of control.

    It reviews the vehicle twice a second. A review has up to four steps, between which messages are taken:
    ``begin_review``; in flight ``review_lights`` and, every ``TRACKING_PERIOD``, ``review_tracking``; and
    ``finish_review``. Battery, estimator, vibration and tracking are judged by thorough reviews only, every second one.
    So are reports of the autopilot, unless an urgent message has changed. The balance of the motors, too, is one of the
    quantities, but is tested elsewhere (``MotorAlarms``).

    Attributes:
        is_thorough: whether the latest review is thorough.
        alarms: the alarms that are active as of the last review.
        watched: since when each quantity is watched, or why it is not.
        lights: the worst fact on each part of the vehicle, in the latest flight and before.
        control: judges whether control of the flight was lost.
        drift: looks for wind that carries the vehicle away in the present flight.
        loss: how the flight was lost, by its motion or a report of the autopilot; it stays until the next take-off.
        ground_contact: how the lost vehicle met the ground, even while the autopilot reports it as flying; it is the
            loss itself where the ground ended the flight. None before, and where nothing was lost.
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
        self.alarms = ActiveAlarms()
        self.watched = WatchList()
        self.lights: FlightLights = FlightLights(
            None if former is None else former.lights, has_flight_gone_on=was_flying
        )
        self.control = ControlWatch(recent)
        self.drift = WindDriftDetector(recent.boot)
        self._height = HeightWatch(recent, self.control)
        # Whether the heights at rest before and after the latest flight have shown what drifted.
        self._are_heights_judged = False
        self._tracking = TrackingWatch(recent)
        # The event that the vehicle was lost, such as a crash; None as long as it is not.
        self.loss: Fact | None = None if former is None else former.loss
        self.ground_contact: Fact | None = None if former is None else former.ground_contact
        # A contact with the ground after a loss in the air, until it is reported.
        self._unreported_contact: Fact | None = None
        self.has_landed = True
        self._recent = recent
        self._landed_states = LandedStates()
        # Whether the vehicle flew when the former boot ended.
        self._was_flying = was_flying
        # A fall with the motors at idle that has not ended; None without one.
        self._fall: Fact | None = None
        self._report_search = ReportSearch()
        # The restart of the autopilot in flight, as its light states it; None without one.
        self._restart: Fact | None = None
        # What the autopilot has warned of in the flights of this boot, and its alarms.
        self._warnings: deque[Fact] = deque(maxlen=MAX_EVENTS)
        self._report_alarms = ReportAlarms()
        # The report of a landing that is not certain yet; None without one.
        self._landing_report: Fact | None = None
        # Times of the latest review, of the latest thorough one, and of the latest judgement of the tracking, s of the
        # boot clock.
        self._review_time = -inf
        self._thorough_time = -inf
        self._tracking_time = -inf
        # Number of changes of urgent messages until the latest review.
        self._change_count = 0
        # Why the latest judgement of the power says nothing of the battery; None if it does, or before any.
        self._battery_not_judged: Fact | None = None
        # The review that has begun; None between reviews.
        self._review: _Review | None = None

    def add_message(self, message: Message, time: float) -> None:
        """Adds a message with the attitude or its setpoint to the data by which control and tracking are judged.

        Args:
            message: Decoded ATTITUDE, ATTITUDE_QUATERNION or ATTITUDE_TARGET.
            time: time on the boot clock, s.
        """
        self.control.add_message(message, time)
        self._tracking.add_message(message, time)

    @property
    def active_alarms(self) -> Facts:
        """The alarms that are active now, the most urgent first.

        A restart of the autopilot in flight comes first, then the loss of the vehicle, such as a crash, then a fall
        that may still be caught, and then all other bad faults. The loss stays an alarm while the vehicle lies on the
        ground.
        """
        urgent = []
        if self._restart is not None and self._landed_states.is_in_air:
            urgent.append(self._restart)
        bad_faults = [fact for fact in self.alarms.facts.values() if fact.is_bad]
        bad_faults += [fact for fact in self._report_alarms.active if fact not in bad_faults]
        falls = []
        if self._fall is not None and not self.has_landed:
            falls.append(self._fall)
        if self.loss is not None and self.loss not in [*falls, *bad_faults]:
            urgent.append(self.loss)
        return (*urgent, *falls, *bad_faults)

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
        self._update_phase(now, IN_AIR if is_flying else ON_GROUND)
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
            phase_start=self._landed_states.phase_start,
            recent_signals=recent_signals,
        )
        if recent_signals is None:
            return []
        reports = self._new_reports(recent_signals, vehicle, now)
        if not is_flying:
            self._report_alarms.end_flight()
            return reports
        reported_facts = [self._take_report(report, now) for report in reports]
        self._report_alarms.update(self._report_search.reports, now)
        return reported_facts

    def _take_report(self, report: Fact, now: float) -> Fact:
        """Judges a new report of the autopilot in flight, such as a failsafe; a warning is stored, and may be an alarm.

        Args:
            report: a new report of the autopilot, on any part of the vehicle.
            now: present time on the boot clock, s.

        Returns:
            What is reported to the user: an alarm, or the report itself. A reported crash is an alarm only if nothing
            else has shown the loss before.
        """
        if report.code is SessionFact.ALARM:
            # The alarm of a restart in flight, whose light ``_update_restart`` sets.
            return report
        if report.code is ReportedEvent.BOARD_VOLTAGE_LOW:
            # In a log a moment below the limit is a warning. In flight nobody knows whether the autopilot survives it.
            report = report.replace(Level.BAD)
        if report.warns:
            self._warnings.append(report)
            light = light_of_event(report)
            if light is not None:
                self.lights.add(light, report)
        if report.code in POWER_REPORTS:
            return self._take_power_report(report, now)
        if report.code in REPORTS_OF_LOSS and report.is_bad:
            is_first = self.loss is not None and self.loss.code is Ending.LOSS_REPORTED
            return event_or_alarm(report, report.start_time) if is_first else report
        return self._report_alarms.add_report(report, now)

    def _take_power_report(self, report: Fact, now: float) -> Fact:
        """Makes a warning of the autopilot about its power the active alarm of the battery.

        A later review, which judges the power by this warning too, finds the alarm active and does not report it again.

        Args:
            report: a new report of the autopilot on the power.
            now: present time on the boot clock, s.

        Returns:
            What is reported to the user: an alarm if the report is bad, otherwise the report itself.
        """
        if not report.warns:
            return report
        active = self.alarms.facts.get(WatchedQuantity.BATTERY, report)
        self.alarms.raise_alarm(WatchedQuantity.BATTERY, worst_fact([active, report]), now)
        if report.is_bad:
            return event_or_alarm(report, report.start_time)
        return report

    def _update_phase(self, now: float, landed_state: int) -> None:
        """Begins another phase, in the air or on the ground, if the landed state has changed.

        Args:
            now: present time on the boot clock, s.
            landed_state: present landed state, ``IN_AIR`` or ``ON_GROUND``.
        """
        states = self._landed_states
        if states.latest == landed_state:
            return
        self._end_drift(now)
        disagreement = self._height.end_flight(now)
        if disagreement is not None:
            self.lights.replace(Light.ESTIMATOR, disagreement.code, disagreement)
        if landed_state == IN_AIR:
            self._begin_flight(now)
        states.begin_phase(landed_state, now, self._review_time)

    def _begin_flight(self, now: float) -> None:
        """Begins to watch a flight at its take-off, without the findings of the flight before.

        But a vehicle that leaves the ground again within ``RECOVERY_SECONDS`` has bounced, or its landed state was
        wrong for a moment: then the same flight goes on, with its loss of control and its lights (the judgement of each
        part of the vehicle). The lights also stay if the autopilot has restarted in flight.

        Before the first phase of a boot no flight is known that could go on, so that it always begins a new one.

        Args:
            now: present time on the boot clock, s.
        """
        states = self._landed_states
        self._fall = None
        self._height.begin_flight()
        self._are_heights_judged = False
        self.has_landed = False
        self._landing_report = None
        self.alarms.begin_flight()
        is_new_flight = states.is_first_phase or now - states.phase_start >= RECOVERY_SECONDS
        if is_new_flight:
            self.loss = self.ground_contact = None
            self.alarms.discard(WatchedQuantity.CONTROL)
        has_restarted_in_flight = states.is_first_phase and self._was_flying
        if is_new_flight and not has_restarted_in_flight:
            self.lights.begin_flight()

    def _end_drift(self, now: float) -> None:
        """Ends a drift in wind with its flight, and begins to look for another one.

        Args:
            now: present time on the boot clock, s.
        """
        self.drift.end(now)
        drift = self.drift.latest
        if drift is not None:
            self.lights.replace(Light.WIND, drift.code, drift)
        self.drift = WindDriftDetector(self._recent.boot)

    def review_lights(self) -> None:
        """Judges battery, estimator and, in settled flight, vibration, by the functions that judge a log.

        The review must have begun, and be thorough; the results are added to its facts.
        """
        review = self._review
        assert review is not None
        assert review.recent_signals is not None
        condition = Condition(duration=review.now - review.phase_start)
        self._judge_battery(review, condition)
        # The estimator is judged by the last minute alone, since it may recover: earlier warnings must not last.
        recent_warnings = []
        for warning in self._warnings:
            if warning.start_time > review.now - MEMORY_SECONDS:
                recent_warnings.append(warning)
        findings = LiveFindings(events=tuple(recent_warnings), ending=self._ending)
        evidence = live_evidence(review.recent_signals, condition, findings)
        estimator = estimator_light(evidence)
        if estimator.code is not EstimatorLight.ESTIMATOR_UNMEASURED:
            review.facts[WatchedQuantity.ESTIMATOR] = estimator
            if estimator.warns and estimator.time is not None and not is_lasting_state(estimator):
                review.last_found_times[WatchedQuantity.ESTIMATOR] = latest_estimator_time(
                    review.recent_signals, estimator
                )
        if review.has_settled:
            vibration = vibration_light(evidence)
            review.facts[WatchedQuantity.VIBRATION] = vibration
            if vibration.warns:
                limit = vibration.figures["acceptable_vibration"]
                review.last_found_times[WatchedQuantity.VIBRATION] = latest_vibration_time(
                    review.recent_signals, limit
                )

    @property
    def _ending(self) -> Fact | None:
        """The loss of the flight, where it is one by the rules for logs: what is measured after it judges nothing."""
        is_ending = self.loss is not None and self.loss.code in Ending
        return self.loss if is_ending else None

    def _judge_battery(self, review: _Review, condition: Condition) -> None:
        """Judges the power by all messages and warnings of the boot, since a battery does not recover.

        Args:
            review: the review, whose ``facts`` get the judgement.
            condition: figures of the vehicle, with the duration of the flight so far.
        """
        all_signals = self._signals(review.vehicle, review.now, -inf)
        # The current that a crashed vehicle draws is no fault of its battery: the light gets the crash with its time.
        findings = LiveFindings(events=tuple(self._warnings), ending=self._ending)
        power = power_light(live_evidence(all_signals, condition, findings))
        review.facts[WatchedQuantity.BATTERY] = power
        # Just after the take-off too few voltages have come to say that none is measured.
        has_just_begun = condition.duration < LISTENING_SECONDS
        self._battery_not_judged = None if has_just_begun else reason_battery_not_judged(power)

    def has_rate_setpoint(self, vehicle: Telemetry, axis: str) -> bool:
        """Returns whether the body rate of an axis has a setpoint, as :meth:`TrackingWatch.has_rate_setpoint` does."""
        return self._tracking.has_rate_setpoint(vehicle, axis)

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
        tracking = self._tracking.judge(review.now, review.vehicle, settled_start)
        if tracking is not None:
            review.facts[WatchedQuantity.TRACKING] = tracking

    def finish_review(self, motion: RecentMotion | None, takeoff_time: float = -inf) -> list[Fact]:
        """Ends the review that has begun: judges the motion, and turns all facts of the review into alarms.

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
            self._judge_end_of_flight(review, moment)
            reported_facts = self._judge_heights_on_ground(review, moment)
        if self.has_landed and self._landing_report is not None:
            reported_facts.append(self._landing_report)
            self._landing_report = None
        reasons = self._reasons_not_watched(review.now, review.vehicle, motion)
        self.watched.update(review.now, reasons, is_flying=review.is_flying)
        reported_facts += self._update_alarms(review)
        reported_facts += self._take_contact_report(review.now)
        self._review_time = review.now
        return reported_facts

    def review_control(self, moment: FlightMoment) -> list[Fact]:
        """Judges between two reviews whether control of a flying vehicle is being lost, which cannot wait for the next.

        A vehicle that loses control 4 m up hits the ground a second later, and a review takes up to that long.

        Args:
            moment: present time, and the motion.

        Returns:
            The alarm of a loss that is new, and a contact with the ground.
        """
        if not self._landed_states.is_in_air:
            # The first review of the flight has not begun yet.
            return []
        review = _Review(
            moment.time,
            moment.vehicle,
            is_flying=True,
            has_settled=False,
            phase_start=self._landed_states.phase_start,
            recent_signals=None,
        )
        reported_facts = self._judge_control(review, moment)
        for quantity, fact in review.facts.items():
            self.lights.add(LIGHTS[quantity], fact)
        reported_facts += self._raise_alarms(review)
        return [*reported_facts, *self._take_contact_report(moment.time)]

    def _take_contact_report(self, now: float) -> list[Fact]:
        """Returns the report of a contact with the ground that followed a loss in the air, once; otherwise nothing.

        Args:
            now: present time on the boot clock, s.
        """
        contact = self._unreported_contact
        self._unreported_contact = None
        return [] if contact is None else [event_or_alarm(contact, now)]

    def _judge_flight(self, review: _Review, moment: FlightMoment) -> list[Fact]:
        """Judges in flight control, height, drift in wind, oscillation, and motors at their limits.

        Args:
            review: the review, whose ``facts`` are added to.
            moment: present time, and the motion.

        Returns:
            The begin or the end of a fall, to be reported.
        """
        reported_facts = self._judge_control(review, moment)
        self._judge_attitude_estimate(review)
        if self.drift.latest is not None:
            self._add_event(review, WatchedQuantity.DRIFT, self.drift.latest)
        if self.is_thorough:
            divergence = self._height.divergence(moment)
            disagreement = self._height.disagreement(moment)
            height_events = [event for event in (divergence, disagreement) if event is not None]
            if height_events:
                self._add_event(review, WatchedQuantity.HEIGHT, worst_fact(height_events))
        if moment.motion is not None:
            self._judge_motor_limits(review, moment, moment.motion)
        if WatchedQuantity.OSCILLATION in review.facts:
            # In a limit cycle the motors go from limit to limit, and cannot be compared with each other.
            self.lights.remove_good(Light.MOTORS)
        if self.loss is not None:
            for quantity in EXPLAINED_BY_LOSS:
                review.facts.pop(quantity, None)
        return reported_facts

    @staticmethod
    def _add_event(review: _Review, quantity: WatchedQuantity, event: Fact) -> None:
        """Adds an event of the last minute to the facts of a review, with the time until which it lasted.

        Args:
            review: the review, whose ``facts`` and ``last_found_times`` are changed.
            quantity: watched quantity that the event is about, such as the height.
            event: the event; it has no end time while it lasts.
        """
        review.facts[quantity] = event
        review.last_found_times[quantity] = event.end_time or review.now

    def _judge_control(self, review: _Review, moment: FlightMoment) -> list[Fact]:
        """Judges in flight whether control was lost, and whether the vehicle falls or has met the ground.

        A loss stays as it was found first, until the vehicle meets the ground. Of a new loss near the ground nothing is
        reported before the impact, which is only a moment away and shows what happened.

        Args:
            review: the review, whose ``facts`` get the loss.
            moment: present time, and the motion.

        Returns:
            The alarm of a fall with idle motors that begins, or its end once the motors carry the vehicle again. A fall
            is no loss yet: the pilot may catch the vehicle.
        """
        loss = self.control.loss(moment)
        if loss is not None:
            known_loss = self.alarms.facts.get(WatchedQuantity.CONTROL)
            is_new = known_loss is None
            loss = known_loss or loss
            flight_end = None
            if self.ground_contact is None:
                # The contact shows more exactly than the attitude when the vehicle hit the ground, and how fast.
                flight_end = self.control.crash_after_loss(moment)
                is_in_air = loss.code in LOSSES_IN_AIR and flight_end is None
                if is_new and is_in_air and self.control.awaits_impact(loss, moment):
                    return []
            self._record_loss(loss, flight_end, review)
        elif self.loss is None and self._is_sinking:
            # A vehicle that sinks at full throttle may hit the ground although its attitude follows the setpoint.
            flight_end = self.control.crash_after_loss(moment)
            if flight_end is not None and flight_end.loss is not None:
                self._record_loss(flight_end.loss, flight_end, review)
        if self.loss is not None:
            self._fall = None
            return []
        return self._judge_fall(review, moment)

    def _judge_fall(self, review: _Review, moment: FlightMoment) -> list[Fact]:
        """Judges in flight whether the vehicle falls with its motors at idle, or has been caught.

        Args:
            review: the review, with its time and the vehicle's parameters.
            moment: present time, and the motion.

        Returns:
            The alarm of a fall that begins, or its end once the motors carry the vehicle again.
        """
        fall = self.control.fall(moment)
        if fall is not None:
            is_new = self._fall is None
            self._fall = fall
            return [event_or_alarm(fall, review.now)] if is_new else []
        has_been_caught = carries_vehicle(moment.motion, review.vehicle.parameters)
        if self._fall is None or not has_been_caught:
            return []
        end = Fact(WatchFact.ALARM_OVER, time=review.now, reason=self._fall)
        self._fall = None
        return [end]

    @property
    def _is_sinking(self) -> bool:
        """Whether the alarm is active that the vehicle cannot hold its height."""
        alarm = self.alarms.facts.get(WatchedQuantity.MOTOR_LIMITS)
        return alarm is not None and alarm.code is WatchFact.SINKS_AT_LIMIT

    def _record_loss(self, loss: Fact, end: FlightEnd | None, review: _Review) -> None:
        """Stores the loss of the vehicle and its contact with the ground, for the alarms and the light of the motors.

        Args:
            loss: the event that control was lost, as it was found first.
            end: how the flight ended; None before the vehicle has met the ground.
            review: the review, whose ``facts`` get the loss.
        """
        if end is not None and end.loss is not None:
            loss = end.loss
        loss = self._with_motor_at_limit(loss)
        is_contact = loss.code not in LOSSES_IN_AIR
        if end is not None and end.contact is not None and not is_contact:
            # The loss in the air came first, and stays what the flight is judged by.
            if self.ground_contact is None:
                self.ground_contact = end.contact.replace(Level.BAD)
                self._unreported_contact = self.ground_contact
            # On the ground no parachute helps.
            loss = loss.replace(is_low=True)
        elif is_contact:
            self.ground_contact = loss
        self.loss = loss
        review.facts[WatchedQuantity.CONTROL] = loss
        self._judge_motors_after_loss(loss)

    def _with_motor_at_limit(self, loss: Fact) -> Fact:
        """Names a motor that was at its upper limit as the cause of the loss of a vehicle, if no cause is known.

        A motor may reach its limit many seconds before the vehicle meets the ground. The kept outputs, of the last
        seconds, no longer show that, but the alarm of the motor's limit does. An alarm stays active for a while: a
        motor that left its limit more than ``RECOVERY_SECONDS`` before the loss did not cause it.

        Args:
            loss: the event that the vehicle was lost, such as a fall or a crash.

        Returns:
            The loss with the motor as cause; unchanged if it has a cause, or if no motor was at its limit just before.
        """
        limit_alarm = self.alarms.facts.get(WatchedQuantity.MOTOR_LIMITS)
        if limit_alarm is None or not limit_alarm.subject:
            return loss
        if loss.code not in CAUSED_LOSSES:
            # A loss of this kind has no cause among the motors.
            return loss
        if loss.figures.get("cause") is not None:
            return loss
        last_time_at_limit = self.alarms.last_found(WatchedQuantity.MOTOR_LIMITS)
        if last_time_at_limit < loss.start_time - RECOVERY_SECONDS:
            return loss
        motor = limit_alarm.subject
        cause = Fact(FailedFirst.LIMIT_FIRST, subject=motor)
        return loss.replace(subject=motor, cause=cause, mode="")

    def _judge_attitude_estimate(self, review: _Review) -> None:
        """Judges whether the estimated attitude is NaN, by which the estimator has failed for certain.

        Args:
            review: the review, whose fact on the estimator is replaced unless that is worse.
        """
        invalid_attitude = self.control.invalid_attitude(review.vehicle)
        if invalid_attitude is None:
            return
        other_fact = review.facts.get(WatchedQuantity.ESTIMATOR, invalid_attitude)
        review.facts[WatchedQuantity.ESTIMATOR] = worst_fact([invalid_attitude, other_fact])
        # The attitude is NaN now, whenever another fault of the estimator was there last.
        review.last_found_times.pop(WatchedQuantity.ESTIMATOR, None)

    def _judge_motor_limits(
        self, review: _Review, moment: FlightMoment, motion: RecentMotion
    ) -> None:
        """Judges motors that reach the limits of their outputs.

        Two faults show there: a limit cycle (oscillation) that begins, and a motor that stays at its upper limit.
        A vehicle that sinks meanwhile, where its height is to be held, is the more urgent fact of the two.

        Args:
            review: the review, to whose ``facts`` the faults are added.
            moment: present time.
            motion: attitude and motor outputs of the last seconds.
        """
        motors = motion.motors
        outputs = motors.scale.fraction(motors.outputs)
        is_at_upper, is_at_lower = samples_at_limits(outputs, motors.scale)
        # Motors that reach their limits bound the amplitude of a limit cycle. Where none does, as in most flights,
        # there is no need to look for one.
        if is_at_upper.any() or is_at_lower.any():
            cycle = detect_starting_limit_cycle(
                motors,
                motion.tilts,
                self.control.setpoints(review.vehicle),
                self._recent.boot,
                review.phase_start,
                review.now,
            )
            if cycle is not None:
                # The gains to lower follow by the same rule as in the judgement of the recording after the landing.
                lowered_gains = gain_reduction_advice(cycle, review.vehicle.parameters)
                review.facts[WatchedQuantity.OSCILLATION] = Fact(
                    MarginsLight.OSCILLATES, reason=lowered_gains, **cycle.figures
                )
        has_just_taken_off = review.now - review.phase_start < DECISION_SECONDS
        limited_motor = motor_at_upper_limit(motors, is_at_upper, review.now)
        alarm = self.alarms.facts.get(WatchedQuantity.MOTOR_LIMITS)
        if limited_motor is not None and not has_just_taken_off:
            # A vehicle that could not hold its height has not become sound while a motor is at its limit.
            if alarm is None or not self._is_sinking:
                alarm = with_earlier_motors(limited_motor, alarm)
            review.facts[WatchedQuantity.MOTOR_LIMITS] = alarm
        climb_rate = self.control.held_climb_rate(moment) if is_at_upper.any() else None
        if climb_rate is not None:
            sinking = sinks_at_limit(motors, is_at_upper, climb_rate, review.now)
            # A commanded descent explains why the vehicle sinks, unless all motors (no names) have no reserve.
            is_explained = (
                sinking is not None
                and bool(sinking.figures["names"])
                and self.control.is_descent_commanded(moment)
            )
            if sinking is not None and not is_explained:
                review.facts[WatchedQuantity.MOTOR_LIMITS] = sinking

    def _judge_heights_on_ground(self, review: _Review, moment: FlightMoment) -> list[Fact]:
        """Judges whether barometer or satellites drifted, by the heights at rest before and after the latest flight.

        The vehicle must rest both times. So the heights are compared in each thorough review after the landing until
        they show that, for ``MAX_WAIT_SECONDS`` at most.

        Args:
            review: the review, in which the vehicle is on the ground.
            moment: present time, and the motion.

        Returns:
            The event that one of them has drifted, once after a flight; otherwise nothing.
        """
        if not self.is_thorough:
            return []
        has_flown_and_landed = self._landed_states.flight_end is not None and self.has_landed
        seconds_on_ground = review.now - review.phase_start
        is_due = has_flown_and_landed and seconds_on_ground <= MAX_WAIT_SECONDS
        if is_due and not self._are_heights_judged:
            flight_interval = (moment.takeoff_time, review.phase_start)
            drift = self._height.judgement_at_rest(review.vehicle, flight_interval, moment.motion)
            if drift is not None:
                self._are_heights_judged = True
                self.lights.replace(Light.ESTIMATOR, MotionEvent.HEIGHTS_DISAGREE, drift)
                self.lights.add(Light.ESTIMATOR, drift)
                return [drift]
        self._height.add_rest(review.vehicle, moment.motion)
        return []

    def _judge_end_of_flight(self, review: _Review, moment: FlightMoment) -> None:
        """Judges whether the flight that has just ended did so on the ground or, if not, how the vehicle was lost.

        A vehicle that was disarmed in the air falls, and its impact is an alarm as in flight. It is looked for in each
        review until ``FALL_SECONDS`` after the end of the flight. If none is found, it stays unknown how the vehicle
        came down, and it does not count as landed. Where control had been lost, it is now known how the vehicle met the
        ground.

        Args:
            review: the review, whose ``facts`` get the loss.
            moment: present time, and the motion.
        """
        flight_end = self._landed_states.flight_end
        if flight_end is None or review.now - flight_end > FALL_SECONDS:
            return
        end = self.control.flight_end(moment, flight_end, self._report_search.reports)
        self.has_landed = not end.is_in_air
        loss = self._loss_at_end_of_flight(end, review)
        if loss is not None and self._replaces_known_loss(loss):
            self._record_loss(loss, end, review)
            self._fall = None

    def _loss_at_end_of_flight(self, end: FlightEnd, review: _Review) -> Fact | None:
        """Returns the fact of how a flight that has just ended was lost, such as by a crash.

        Args:
            end: how the flight ended.
            review: the review, with the time when the flight ended.

        Returns:
            The loss; None if the vehicle has landed, or if it is not known how it came down.
        """
        if end.loss is not None and end.loss.is_bad:
            return end.loss
        if end.is_falling and self.loss is None:
            # The motors stopped between the last review in flight and the first one after it.
            fall_start = review.phase_start if self._fall is None else self._fall.time
            return Fact(WatchFact.STOPPED_IN_AIR, Level.BAD, time=fall_start)
        return None

    def _replaces_known_loss(self, loss: Fact) -> bool:
        """Returns whether the loss of a vehicle, as found at the end of its flight, replaces the one found before.

        A loss that was found in the air, or that the autopilot reported, is replaced, since it does not say how the
        vehicle met the ground. But of two losses that the autopilot reported, the second says nothing new.

        Args:
            loss: the event that the vehicle was lost, as the end of the flight shows it.
        """
        earlier_loss = self.loss
        if earlier_loss is None:
            return True
        if earlier_loss.code is Ending.LOSS_REPORTED and loss.code is Ending.LOSS_REPORTED:
            return False
        return earlier_loss.code in OPEN_LOSSES

    def _judge_motors_after_loss(self, loss: Fact) -> None:
        """Updates the light of the motors, that is the judgement of them, after the vehicle was lost.

        If a motor failed first, the loss becomes the light. Otherwise a good light is removed, since it is no longer
        certain that the motors are sound.

        Args:
            loss: the event that the vehicle was lost; its subject is the motor that failed first, if one is known.
        """
        if loss.subject:
            self.lights.add(Light.MOTORS, loss)
        self.lights.remove_good(Light.MOTORS)

    def _signals(
        self,
        vehicle: Telemetry,
        now: float,
        start_time: float,
        settled: Intervals | None = None,
    ) -> Signals:
        """Returns the vehicle's status messages as signals of a log, so that the functions for logs can judge them.

        Args:
            vehicle: identity and parameters of the vehicle, without messages.
            now: time of the review, s of the boot clock.
            start_time: messages before it are left out, s.
            settled: intervals of settled flight, s; None if they are not needed.

        Returns:
            The signals. Their landed state is what the reviews so far have found, until ``now``.
        """
        columns = self._recent.columns((*STATUS_MESSAGES, *ESTIMATOR_FLAG_MESSAGES), start_time)
        # The names of flight modes and the firmware's version come once, when a ground station asks for them.
        columns |= self._recent.columns(["AVAILABLE_MODES", "AUTOPILOT_VERSION"])
        landed_state = self._landed_states.series(
            now, self._recent.boot, was_flying=self._was_flying
        )
        return LiveSignals(
            replace(vehicle, messages=columns),
            landed_state=landed_state,
            preset_settled_intervals=settled,
        )

    def _new_reports(self, signals: Signals, vehicle: Telemetry, now: float) -> list[Fact]:
        """Returns what the autopilot itself has reported since the last search, such as a failsafe or a crash.

        Two kinds of reports may be wrong. A crash that the motion does not show gets a lower level ("watch"). A report
        of a landing is kept back: ``finish_review`` returns it once the vehicle is found on the ground.

        Args:
            signals: time series and texts of the last minute of messages.
            vehicle: identity and parameters of the vehicle, without messages.
            now: present time on the boot clock, s.
        """
        reports = []
        for report in self._report_search.new_reports(signals, now):
            if report.code is ReportedEvent.RESTARTED_IN_FLIGHT:
                reports.append(event_or_alarm(report, report.start_time))
            elif report.code is ReportedEvent.ON_GROUND and not self.has_landed:
                self._landing_report = report
            else:
                reports.append(report)
        if self._report_search.restart is not None:
            self._update_restart(self._report_search.restart)
        if any(report.code in REPORTS_OF_LOSS for report in reports):
            reports = self.control.lower_unconfirmed_crash_reports(vehicle, reports)
        reports_of_loss = [report for report in reports if report.code in REPORTS_OF_LOSS]
        if self.loss is None and reports_of_loss:
            self.loss = find_ending(signals, reports_of_loss)
        return reports

    def _update_restart(self, restart: Fact) -> None:
        """Makes a restart of the autopilot in flight the light (judgement) of the part that caused it, such as power.

        Args:
            restart: the restart, with its cause as far as that is known now.
        """
        light = light_of_event(restart)
        assert light is not None
        self.lights.move(self._restart, light, restart)
        self._restart = restart

    def _update_alarms(self, review: _Review) -> list[Fact]:
        """Compares the facts of a review with the active alarms, updates these, and returns what changed.

        There is at most one alarm for each watched quantity, such as the vibration:

        - It begins, or is reported again, when a fact warns with another level or code than the active alarm. Other
          figures only update it.
        - It ends after the landing, or when its fault has not been found for ``CALM_SECONDS``, so that a fault that
          comes and goes gives one alarm. :meth:`_end_alarms` has the exceptions.

        The worst fact on each part of the vehicle (motors, vibration, power, …) is kept for the judgement of the
        flight.

        Args:
            review: the review that ends, with all its facts. A fact about an event more than ``CALM_SECONDS`` ago that
                has no active alarm is dropped.

        Returns:
            Alarms, with the time of the review, and ends of alarms, with the time at which the fault was found last;
            s of the boot clock.
        """
        for quantity, last_found_time in review.last_found_times.items():
            is_past = review.now - last_found_time >= CALM_SECONDS
            if is_past and quantity not in self.alarms.facts:
                # After a loss of control, the fact may have been removed already (``EXPLAINED_BY_LOSS``).
                review.facts.pop(quantity, None)
        for quantity, fact in review.facts.items():
            self.lights.add(LIGHTS[quantity], fact)
        return [*self._raise_alarms(review), *self._end_alarms(review)]

    def _raise_alarms(self, review: _Review) -> list[Fact]:
        """Turns the warnings of a review into active alarms, and returns those that are new to the user.

        Args:
            review: the review that ends, with its facts by watched quantity.

        Returns:
            The alarms to report, with the time of the review.
        """
        alarms = []
        for quantity, fact in review.facts.items():
            if not fact.warns:
                continue
            is_new = self.alarms.raise_alarm(quantity, fact, review.last_found_time(quantity))
            # What the autopilot itself reports of the estimator was reported to the user when it came.
            was_reported = quantity is WatchedQuantity.ESTIMATOR and isinstance(
                fact.code, ReportedEvent
            )
            if is_new and not was_reported:
                alarms.append(event_or_alarm(fact, review.now))
        return alarms

    def _end_alarms(self, review: _Review) -> list[Fact]:
        """Removes the active alarms that are over, and returns their ends as facts.

        If the fault was one of the present moment (``PRESENT_FAULTS``), its light then states that it is over. All
        other lights keep stating what was wrong in the flight.

        Args:
            review: the review that ends; its warnings are among the active alarms already.

        Returns:
            The ends to report, with the time, s, at which the fault was found last.
        """
        ends = []
        for quantity in list(self.alarms.facts):
            if not self._is_alarm_over(quantity, review):
                continue
            last_found = self.alarms.last_found(quantity)
            is_end_reported = self._is_end_reported(quantity, review)
            alarm = self.alarms.end(quantity)
            if quantity is WatchedQuantity.CONTROL:
                self.loss = self.ground_contact = None
            if not is_end_reported:
                continue
            end = Fact(WatchFact.ALARM_OVER, time=last_found, reason=alarm)
            ends.append(end)
            if review.is_flying and quantity in PRESENT_FAULTS:
                self.lights.replace(LIGHTS[quantity], alarm.code, end.replace(alarm.level))
        return ends

    def _is_alarm_over(self, quantity: WatchedQuantity, review: _Review) -> bool:
        """Returns whether an active alarm is over: after the landing, or if its fault has not been found for some time.

        There are two exceptions. The alarm that control was lost stays after the landing. The alarm that the attitude
        does not track its setpoint stays until the tracking, which is judged more rarely, is judged again as good.

        Args:
            quantity: what the alarm is about, such as the vibration.
            review: the review that ends, with its time and whether the vehicle flies.
        """
        if not review.is_flying:
            is_lost_control = self.loss is not None and quantity is WatchedQuantity.CONTROL
            return not is_lost_control
        if quantity is WatchedQuantity.TRACKING:
            was_found_by_latest_judgement = self.alarms.last_found(quantity) >= self._tracking_time
            if was_found_by_latest_judgement:
                return False
        return self.alarms.is_calm(quantity, review.now)

    def _is_end_reported(self, quantity: WatchedQuantity, review: _Review) -> bool:
        """Returns whether the end of an alarm is reported: in flight always, on the ground only if it is good news.

        A vehicle that was lost is not sound. And a landing neither charges a battery, nor ends a state that lasts, such
        as no fix of the GPS receiver, nor corrects a barometer.

        Args:
            quantity: quantity of the alarm, which is still active.
            review: the review that ends, with whether the vehicle flies.
        """
        if review.is_flying:
            return True
        alarm = self.alarms.facts[quantity]
        is_lasting = is_lasting_state(alarm) or alarm.code is MotionEvent.HEIGHTS_DISAGREE
        return self.loss is None and not is_lasting and quantity is not WatchedQuantity.BATTERY

    def _reasons_not_watched(
        self, now: float, vehicle: Telemetry, motion: RecentMotion | None
    ) -> dict[WatchedQuantity, Fact]:
        """Finds out what cannot be watched because the messages for it are missing or too slow.

        Args:
            now: present time on the boot clock, s.
            vehicle: identity and parameters of the vehicle, without messages.
            motion: attitude and motor outputs of the last seconds; None if they do not come.

        Returns:
            For each quantity that cannot be watched, the fact that states why; quantities that can be are left out.
        """
        reasons = quantities_without_motion(motion)
        received_names = self._recent.names_since(now - MEMORY_SECONDS)
        reasons |= quantities_without_message(received_names, vehicle.autopilot)
        if not self._tracking.has_setpoints(now):
            reasons[WatchedQuantity.TRACKING] = Fact(
                WatchFact.MESSAGE_MISSING,
                name=SETPOINT_MESSAGE,
                rate=None,
                needed_rate=MIN_SLOW_MOTION_RATE,
            )
        invalid_attitude = self.control.invalid_attitude(vehicle)
        if invalid_attitude is not None:
            for quantity in NEEDS_ATTITUDE:
                reasons[quantity] = invalid_attitude
        if self._battery_not_judged is not None:
            reasons.setdefault(WatchedQuantity.BATTERY, self._battery_not_judged)
        return reasons

    def set_motors_watched(self, reason: Fact | None, now: float) -> None:
        """Notes whether motors that lose thrust are detected at present; ``MotorAlarms`` tests them, not this class.

        If so, the status of the motors (their light) becomes "no loss found" until something worse is found. There are
        two exceptions: after a loss of control, and while the vehicle oscillates. Then the motors go from limit to
        limit, so that they are not compared with each other, and must not be called sound.

        Args:
            reason: why a motor that loses thrust would not be detected; None if it would be.
            now: present time on the boot clock, s.
        """
        self.watched.set(WatchedQuantity.MOTORS, reason, now)
        is_oscillating = WatchedQuantity.OSCILLATION in self.alarms.facts
        can_detect_loss = reason is None
        if can_detect_loss and self.loss is None and not is_oscillating:
            self.lights.add_first(Light.MOTORS, Fact(MotorWatchFact.NO_LOSS_FOUND, clock=now))


def latest_estimator_time(signals: Signals, estimator: Fact) -> float:
    """Returns when a fault of the estimator was there last.

    Args:
        signals: signals of the last minute, in which the estimator was judged.
        estimator: the fault, with its time.

    Returns:
        The time, s of the boot clock: of an innovation when it was last beyond its limit, of another fault its end by
        its duration.
    """
    name = estimator.figures.get("name")
    if name in INNOVATIONS:
        limit = estimator.figures.get("failsafe_limit", INNOVATION_LIMIT)
        latest_time = latest_time_above(signals.telemetry, name, limit)
        if latest_time is not None:
            return latest_time
    return estimator.start_time + float(estimator.figures.get("duration", 0.0))


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
