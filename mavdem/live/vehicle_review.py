"""The periodic review of a live vehicle: its motors and messages, whether it flies, and its faults."""

from collections import deque
from collections.abc import Callable, Iterable
from math import inf, isfinite

from mavdem.assessment.flights import loss_onset
from mavdem.dataset.time_series import AVERAGING_SECONDS
from mavdem.facts import Fact
from mavdem.facts.events import ReportedEvent
from mavdem.facts.session import RowsFact
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.ingest.telemetry import Fields, Parameters, Telemetry
from mavdem.live.flight_phase import LANDED_STATE_MESSAGE, FlightPhase
from mavdem.live.live_signals import FlightMoment, RecentMotion
from mavdem.live.motor_alarms import MotorAlarms
from mavdem.live.rate_check import RateCheck
from mavdem.live.recent_messages import RecentMessages, TimedValues
from mavdem.live.row_builder import RowBuilder
from mavdem.live.samples import DECISION_SECONDS
from mavdem.live.vehicle_selection import Component, VehicleSelector
from mavdem.live.watchdog import Watchdog
from mavdem.live.wind import LiveWind
from mavdem.wind_velocity.vehicle_drag import Drag

REVIEW_PERIOD = 0.5
"""Time between the beginnings of two reviews, s of the boot clock: a choice."""

STEP_PERIOD = REVIEW_PERIOD / 10
"""Time between two steps of a review, s of the boot clock: a choice that leaves some time after the last step."""

CONTROL_PERIOD = 2 * STEP_PERIOD
"""Time between two judgements of the control while the attitude is far from its setpoint, s: a choice."""


class VehicleReview:
    """Reviews a live vehicle twice a second, step by step: its messages and motors, whether it flies, and its faults.

    The steps of one review are spread over the messages that come meanwhile, so that none of these waits for long.

    Attributes:
        recent_messages: the slow messages of this boot, which the review reads.
        phase: whether the vehicle flies, as of the latest review.
        watchdog: what is wrong without a model, as of the latest review.
        no_rows_reason: why there are no rows, or the vehicle does not fly; None while all is well.
        telemetry: identity and parameters of the vehicle, without messages; None before the first review of a boot.
    """

    def __init__(
        self,
        vehicles: VehicleSelector,
        rate_check: RateCheck,
        motor_alarms: MotorAlarms,
        wind: LiveWind,
        report: Callable[[Fact], None],
    ) -> None:
        """Begins without a review.

        Args:
            vehicles: vehicles that has the vehicle that is followed.
            rate_check: checks its messages.
            motor_alarms: tests its motors, sample by sample.
            wind: estimates the wind of its flights.
            report: is called with each fact.
        """
        self.no_rows_reason: Fact | None = Fact(RowsFact.RATES_BEING_MEASURED)
        self._vehicles = vehicles
        self._rate_check = rate_check
        self._motor_alarms = motor_alarms
        self._wind = wind
        self._report = report
        # Builder of the vehicle's rows, which each call of ``proceed`` passes.
        self._rows: RowBuilder
        # Parameters of the autopilot as of the last choice of inputs.
        self._parameters: Parameters = {}
        self._begin_boot(RecentMessages())

    def restart(self, boot: int) -> None:
        """Begins the reviews anew after a reboot, without messages, phase of flight and alarms of the former boot.

        The clock of the vehicle begins again at a reboot. The steps of the present review that are not done yet are
        discarded too, since they would compare times of both boots. But a loss of control that the watchdog has found
        stays: an autopilot may well reboot in a crash.

        Args:
            boot: number of the new boot.
        """
        recent_messages = RecentMessages(boot)
        for text in self._texts_of_new_boot():
            recent_messages.add("STATUSTEXT", 0.0, text.values)
        self._begin_boot(recent_messages, self.watchdog, was_flying=self.phase.is_flying)

    def _begin_boot(
        self,
        recent_messages: RecentMessages,
        former: Watchdog | None = None,
        *,
        was_flying: bool = False,
    ) -> None:
        """Begins the reviews of a boot, that is from one start of the autopilot to the next, with a clock of its own.

        Args:
            recent_messages: gets the slow messages of the boot; it may have the first ones.
            former: the watchdog of the former boot; None if there is none.
            was_flying: whether the vehicle flew when the former boot ended.
        """
        self.recent_messages = recent_messages
        self.phase = FlightPhase(recent_messages)
        self.watchdog = Watchdog(recent_messages, former, was_flying=was_flying)
        # A loss that the new watchdog has from the former one, with a time of the former boot's clock.
        self._loss_of_former_boot = self.watchdog.loss
        # The steps of the present review that are not done yet.
        self._pending_steps: deque[Callable[[], None]] = deque()
        # Times of the boot clock, s: of the latest message, of the present review, and of its latest step.
        self._message_time = -inf
        self._review_time = -inf
        self._step_time = -inf
        # When the control was judged last between two reviews, s of the boot clock.
        self._control_time = -inf
        # Time from which on reviews have followed each other, so that the vehicle has been heard without a pause, s of
        # the boot clock.
        self._connection_start = inf
        # Results of a step that later steps use: messages with motor outputs, identity and parameters of the vehicle,
        # and attitude and motor outputs of the last seconds.
        self._candidate_messages: dict[str, Fields] = {}
        self.telemetry: Telemetry | None = None
        self._motion: RecentMotion | None = None

    @property
    def flight_number(self) -> int:
        """Number of the latest flight in the session, from 1; 0 before the first. A bounce begins no other flight."""
        return self.watchdog.status_lights.flight_number

    def _texts_of_new_boot(self) -> list[TimedValues]:
        """Returns the status texts that came between the restart of the autopilot and the moment it is noticed.

        Such a text may say why the autopilot restarted. The restart is noticed at the first attitude with a time stamp
        near 0. A text has no time stamp, and gets the time of the latest stamped message. So a text from after the
        restart has the last time of the former boot's clock, and is recognised by that.
        """
        texts = self.recent_messages.rows.get("STATUSTEXT", [])
        latest_time_of_former_boot = self._message_time
        return [text for text in texts if text.time >= latest_time_of_former_boot]

    def proceed(self, now: float, rows: RowBuilder) -> None:
        """Begins a review when one is due, and performs the next step of the present review when that is due.

        It is called with each message, and performs at most one step. If a new review is due before the last one is
        done, as after a pause of the link, the remaining steps are performed at once, so that none is ever left out.
        The times depend only on the boot clock, so a recorded flight gives the same reviews.

        Args:
            now: present time on the boot clock, s.
            rows: builder of the vehicle's rows.
        """
        self._message_time = now
        self._rows = rows
        # A review begins when the clock enters another period of this length, independently of the last one's begin.
        present_period = now // REVIEW_PERIOD
        period_of_last_review = self._review_time // REVIEW_PERIOD
        is_review_due = present_period != period_of_last_review
        if is_review_due:
            while self._pending_steps:
                self._perform_next_step()
            self._begin_review(now)
        if is_review_due or now - self._step_time >= STEP_PERIOD:
            self._step_time = now
            if self._pending_steps:
                self._perform_next_step()
        self._review_control(now)

    def _review_control(self, now: float) -> None:
        """Judges whether control is lost, if the attitude has been far from its setpoint for a while in flight.

        Until then the judgement of the reviews, which come twice a second, suffices. Now it is made more often, every
        ``CONTROL_PERIOD``, so that the alarm comes as early as possible.

        Args:
            now: present time on the boot clock, s.
        """
        watchdog = self.watchdog
        is_already_lost = watchdog.loss is not None
        may_be_lost = self.phase.is_flying and watchdog.control.may_be_lost
        if is_already_lost or not may_be_lost:
            return
        # The time since the last judgement is negative after a restart of the boot clock.
        is_due = abs(now - self._control_time) >= CONTROL_PERIOD
        if self.telemetry is None or not is_due:
            return
        self._control_time = now
        motion = self._rows.recent_motion()
        moment = FlightMoment(now, self.telemetry, self.phase.takeoff_time, motion)
        for fact in watchdog.review_control(moment):
            self._report(fact)
        self._update_loss_of_phase()

    def _perform_next_step(self) -> None:
        """Performs the next step of the review, which may add further steps."""
        step = self._pending_steps.popleft()
        step()

    def _begin_review(self, now: float) -> None:
        """Begins a review, with a queue of the steps that it consists of.

        Their order matters: the motors are chosen among the messages; the phase of flight needs the outputs of the
        motors; and the watchdog needs the phase and the motion. Some steps add others to the queue.

        Args:
            now: present time on the boot clock, s.
        """
        # After a pause of the link, rates are unknown as at the beginning. Before the first review, the time of the
        # last one is minus infinity, so that the first one begins a connection too.
        follows_a_review = abs(now - self._review_time) < DECISION_SECONDS
        self._review_time = now
        if not follows_a_review:
            self._connection_start = now
        self._pending_steps = deque(
            [
                self._choose_messages,
                self._review_phase,
                self._collect_motion,
                self._begin_watchdog_review,
            ]
        )

    @property
    def _vehicle(self) -> Component:
        """The vehicle that is followed; it is known before any of its messages is reviewed."""
        assert self._vehicles.followed is not None
        return self._vehicles.followed

    def _vehicle_telemetry(self) -> Telemetry:
        """Returns identity and parameters of the vehicle in the form in which logs have them, without messages."""
        vehicle = self._vehicle
        return Telemetry(
            vehicle.system,
            component=vehicle.component,
            vehicle=vehicle.vehicle_type,
            autopilot=vehicle.autopilot,
            messages={},
            parameters=self._parameters,
        )

    def _choose_messages(self) -> None:
        """Performs the first step of a review: which MAVLink messages give the vehicle's attitude and motor outputs.

        A row of the learner's data has outputs, which are angle and body rate from an attitude message, and inputs,
        which are the motors' outputs from messages such as SERVO_OUTPUT_RAW. The attitude message is chosen here, and
        the latest messages with motor outputs are collected, for the next step (``_choose_inputs``) to choose from. A
        vehicle that cannot be a multirotor, such as a plane, gets no inputs, and so no rows.
        """
        rows = self._rows
        rows.choose_attitude_message(self._review_time)
        # Motors are learned from multirotors only.
        if self._vehicle.vehicle_type not in POSSIBLE_MULTIROTORS:
            rows.clear_inputs()
            return
        self._update_parameters()
        self._candidate_messages = rows.candidate_messages()
        # Choosing among them takes longer. So it is a step of its own, before those that are queued already.
        self._pending_steps.appendleft(self._choose_inputs)

    def _update_parameters(self) -> None:
        """Takes over the parameters that the autopilot has sent so far, by which motors and drag are known.

        Parameters arrive one by one during the flight. Some say which output channel drives which motor. Others are
        drag coefficients, which the estimate of the wind gets.
        """
        parameters = self._vehicles.followed_parameters
        if parameters is self._parameters:
            return
        self._parameters = parameters
        self._wind.parameter_drag = Drag.from_parameters(self._vehicle.autopilot, parameters)

    def _choose_inputs(self) -> None:
        """Performs the step of a review that chooses the motors' outputs among the candidate messages."""
        self._rows.choose_inputs(
            self._candidate_messages, self._vehicle_telemetry(), self._message_time
        )

    def _check_messages(self) -> Fact | None:
        """Checks whether attitude and motor outputs are received, and fast enough, to make rows of the model's data.

        A row is one sample of the data: motion and motor outputs at one time. The check also reports changes.

        Returns:
            The reason why no rows can be made; None if they can.
        """
        invalid_attitude = self.watchdog.control.invalid_attitude(self._vehicle_telemetry())
        if invalid_attitude is not None:
            # Faster messages would not help; the watchdog reports it.
            return invalid_attitude
        return self._rate_check.update(
            self._vehicle.vehicle_type,
            self._rows.attitude_message,
            self._rows.motor_message,
            self._rows.rates(self._review_time),
        )

    def _review_phase(self) -> None:
        """Performs the step of a review that checks the rates of messages and decides whether the vehicle flies.

        Rates are checked only after ``DECISION_SECONDS`` of messages without a pause: a pause would make them too low.
        """
        are_motors_chosen = self._rows.inputs is not None
        # How long the vehicle has been heard without a pause.
        connected_seconds = self._review_time - self._connection_start
        # This step is performed when a message comes. If that is late, the link has paused after the review began, and
        # the rates would be counted over the pause.
        is_interrupted = self._message_time - self._review_time >= DECISION_SECONDS
        if connected_seconds >= DECISION_SECONDS and not is_interrupted:
            self.no_rows_reason = self._check_messages() or self.phase.not_flying_reason
        if not are_motors_chosen and connected_seconds >= AVERAGING_SECONDS / 2:
            # Motors are recognised by their outputs, which change. If outputs come, and no motors are recognised among
            # them, the motors are idle, and the vehicle is on the ground.
            self.phase.motors_are_idle = self._rows.has_motor_messages
        self._update_phase()

    def _update_phase(self) -> None:
        """Decides whether the vehicle flies, and at a take-off begins a flight with its own wind, lights and alarms.

        It also reports, once, that the autopilot's landed state is contradicted by the motion.
        """
        now = self._review_time
        self.telemetry = self._vehicle_telemetry()
        # The mean of all motor outputs, as a fraction of their range.
        collective = None
        if self._rows.inputs is not None:
            collective = self._rows.inputs.collective
        former_contradiction = self.phase.contradicted_report
        self.phase.review(now, self.telemetry, collective)
        contradiction = self.phase.contradicted_report
        if contradiction is not None and former_contradiction is None:
            self._report(contradiction)
        former_flight = self.flight_number
        # The watchdog begins another flight here, not with its own review a moment later: until then, the alarms of an
        # earlier flight would stand beside a vehicle that flies again.
        self.watchdog.update_phase(
            now, is_flying=self.phase.is_flying, takeoff_time=self.phase.takeoff_time
        )
        if self.flight_number != former_flight:
            self._wind.restart()
            self._motor_alarms.begin_flight(now, self.recent_messages.boot)

    def _collect_motion(self) -> None:
        """Performs the step of a review that collects the motion of the last seconds, by which the watchdog judges."""
        self._motion = self._rows.recent_motion()

    def _begin_watchdog_review(self) -> None:
        """Begins the watchdog's part of a review: reports new warnings of the autopilot, and queues the other steps.

        The watchdog looks for faults without a model. It judges battery, estimator and vibration in flight only, and
        only in some of its reviews, the thorough ones, since that takes longer. In some of these it judges the tracking
        too, how the attitude follows its setpoint, which takes longest.
        """
        assert self.telemetry is not None
        now = self._review_time
        is_flying = self.phase.is_flying
        # Flight is settled from the end of the climb-out on; None before it.
        settled_start = self.phase.settled_start(now)
        new_reports = self.watchdog.begin_review(
            now,
            self.telemetry,
            is_flying=is_flying,
            settled_start=settled_start,
        )
        self._report_facts(new_reports)
        if is_flying and self.watchdog.is_thorough:
            self._pending_steps.append(self._review_lights)
            if self.watchdog.is_tracking_due:
                self._pending_steps.append(self._review_tracking)
        self._pending_steps.append(self._finish_watchdog_review)

    def _review_lights(self) -> None:
        """Judges battery, estimator and vibration in flight."""
        self.watchdog.review_lights()

    def _review_tracking(self) -> None:
        """Judges how the vehicle follows its setpoints, if the flight is still settled."""
        settled_start = self.phase.settled_start(self._review_time)
        if settled_start is not None:
            self.watchdog.review_tracking(settled_start)

    def _finish_watchdog_review(self) -> None:
        """Performs the last step of a review: reports alarms that begin or end, and whether the motors are watched.

        The balance of the motors is tested with each of their samples (``MotorAlarms``), not by this review. But the
        user sees in one list what is watched and what is not, and the watchdog keeps that list.
        """
        self._report_facts(self.watchdog.finish_review(self._motion, self.phase.takeoff_time))
        self._update_loss_of_phase()
        now = self._review_time
        reason = self._motor_alarms.reason_not_watched(now, is_flying=self.phase.is_flying)
        self.watchdog.set_motors_watched(reason, now)

    def _report_facts(self, facts: Iterable[Fact]) -> None:
        """Reports what the watchdog has found to the user, such as an alarm, a take-off or a landing.

        To a take-off and a landing it adds what shows them: the autopilot's land detector, or the motors. A take-off is
        recognised a moment late. It is reported with the time when it was, from which the flight time is counted.

        Args:
            facts: what was found, in the order in which it is reported.
        """
        takeoff_time = self.phase.takeoff_time
        for fact in facts:
            if fact.code in (ReportedEvent.OFF_GROUND, ReportedEvent.ON_GROUND):
                fact = fact.replace(basis=(self._landed_state_basis,))
            if fact.code is ReportedEvent.OFF_GROUND and isfinite(takeoff_time):
                fact = fact.replace(clock=takeoff_time)
            self._report(fact)

    @property
    def _landed_state_basis(self) -> str:
        """Name of the message by which the vehicle counts as in the air or on the ground at present."""
        if self.phase.is_landed_state_reported:
            return LANDED_STATE_MESSAGE
        # A vehicle without motor outputs, such as a plane, operates while it is armed.
        return self._rows.motor_message or "HEARTBEAT"

    def _update_loss_of_phase(self) -> None:
        """Passes the time when the vehicle was lost, such as by a crash, from the watchdog to the phase of flight.

        After that time the phase of flight is neither settled nor free, so that nothing is learned from a vehicle out
        of control. Without a loss it gets None. A loss from before the latest restart of the autopilot counts as none:
        the watchdog still has it, but its time is on the clock of the former boot.
        """
        loss = self.watchdog.loss
        if loss is None or loss == self._loss_of_former_boot:
            self.phase.note_loss(None)
            return
        loss_time = loss_onset(loss)
        if loss_time is None:
            # A loss whose time is not known counts from the present review.
            loss_time = self._review_time
        self.phase.note_loss(loss_time)
