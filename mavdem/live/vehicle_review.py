"""The periodic review of a live vehicle: what its rows are made of, whether it flies, and its faults."""

from collections import deque
from collections.abc import Callable
from math import inf

from mavdem.dataset.time_series import AVERAGING_SECONDS
from mavdem.facts import Fact
from mavdem.facts.session import RowsFact
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.ingest.telemetry import Fields, Parameters, Telemetry
from mavdem.live.flight_phase import FlightPhase
from mavdem.live.live_signals import RecentMotion
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

PART_PERIOD = REVIEW_PERIOD / 10
"""Time between two parts of a review, s of the boot clock: a choice that leaves some time after the last part."""


class VehicleReview:
    """Reviews a live vehicle twice a second: inputs, phase of flight and faults; in parts, so that no row waits long.

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
        # Parameters of the autopilot as of the last choice of inputs.
        self._parameters: Parameters = {}
        self._begin_boot(RecentMessages())

    def restart(self, boot: int) -> None:
        """Discards messages, phase and alarms at a reboot, after which the clock begins again.

        The rest of the present review is dropped too: it would judge the former boot by times of the new one.

        Args:
            boot: number of the new boot.
        """
        recent_messages = RecentMessages(boot)
        for text in self._texts_since_last_attitude():
            recent_messages.add("STATUSTEXT", 0.0, text.values)
        # An autopilot may well reboot in a crash: how the flight was lost stays.
        self._begin_boot(recent_messages, self.watchdog, was_flying=self.phase.is_flying)

    def _begin_boot(
        self,
        recent_messages: RecentMessages,
        former: Watchdog | None = None,
        *,
        was_flying: bool = False,
    ) -> None:
        """Begins the reviews of a boot.

        Args:
            recent_messages: gets the slow messages of the boot; it may have the first ones.
            former: the watchdog of the former boot; None if there is none.
            was_flying: whether the vehicle flew when the former boot ended.
        """
        self.recent_messages = recent_messages
        self.phase = FlightPhase(recent_messages)
        self.watchdog = Watchdog(recent_messages, former, was_flying=was_flying)
        # The parts of the present review that are not done yet.
        self._pending_parts: deque[Callable[[RowBuilder], None]] = deque()
        # Times of the boot clock, s: of the latest message, of the present review, of its latest part, and since when
        # reviews have followed each other.
        self._message_time = -inf
        self._review_time = -inf
        self._part_time = -inf
        self._connection_start = inf
        # Results of a part that later parts use.
        self._candidate_messages: dict[str, Fields] = {}
        self.telemetry: Telemetry | None = None
        self._motion: RecentMotion | None = None

    def _texts_since_last_attitude(self) -> list[TimedValues]:
        """Returns the texts that came after the last attitude of a boot.

        If the clock begins again, they are of the new boot, which only attitudes prove; they may have its reason.
        """
        texts = self.recent_messages.rows.get("STATUSTEXT", [])
        return [text for text in texts if text.time >= self._message_time]

    def proceed(self, now: float, rows: RowBuilder) -> None:
        """Begins a review when one is due, and performs its next part when that is due.

        It is called with each message, and performs at most one part. If a new review is due before the last one is
        done, as after a pause of the link, the remaining parts are performed at once, so that no part is ever left out.
        The times depend only on the boot clock, so a recorded flight gives the same reviews.

        Args:
            now: present time on the boot clock, s.
            rows: builder of the vehicle's rows.
        """
        self._message_time = now
        # A review begins when the clock enters another period of this length, independently of the last one's begin.
        is_review_due = now // REVIEW_PERIOD != self._review_time // REVIEW_PERIOD
        if is_review_due:
            while self._pending_parts:
                self._do_next_part(rows)
            self._begin(now)
        if is_review_due or now - self._part_time >= PART_PERIOD:
            self._part_time = now
            if self._pending_parts:
                self._do_next_part(rows)

    def _do_next_part(self, rows: RowBuilder) -> None:
        """Does the next part of the review, which may queue others.

        Args:
            rows: builder of the vehicle's rows.
        """
        do_part = self._pending_parts.popleft()
        do_part(rows)

    def _begin(self, now: float) -> None:
        """Begins a review by queueing its parts.

        Their order matters: inputs are chosen by the messages; the phase needs the inputs' collective; and the watchdog
        needs the phase and the motion. Choosing inputs is a part of its own, which ``_choose_messages`` adds.

        Args:
            now: present time on the boot clock, s.
        """
        # After a pause of the link, rates are unknown as at the beginning. Before the first review, the time of the
        # last one is minus infinity, so that the first one begins a connection too.
        follows_a_review = abs(now - self._review_time) < DECISION_SECONDS
        self._review_time = now
        if not follows_a_review:
            self._connection_start = now
        self._pending_parts = deque(
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

    def _choose_messages(self, rows: RowBuilder) -> None:
        """Does the first part of a review: which MAVLink messages give the vehicle's attitude and its motor outputs.

        A row of the learner's data has outputs, which are angle and body rate from an attitude message, and inputs,
        which are the motors' outputs from messages such as SERVO_OUTPUT_RAW. The attitude message is chosen here, and
        the latest messages with motor outputs are collected, for the next part (``_choose_inputs``) to choose from. A
        vehicle that cannot be a multirotor, such as a plane, gets no inputs, and so no rows.

        Args:
            rows: builder of the vehicle's rows.
        """
        rows.choose_attitude_message(self._review_time)
        # Motors are learned from multirotors only.
        if self._vehicle.vehicle_type not in POSSIBLE_MULTIROTORS:
            rows.clear_inputs()
            return
        self._update_parameters()
        self._candidate_messages = rows.candidate_messages()
        # Choosing among them takes longer. So it is a part of its own, before those that are queued already.
        self._pending_parts.appendleft(self._choose_inputs)

    def _update_parameters(self) -> None:
        """Takes the parameters that have arrived so far, and the drag that they state.

        They arrive during the flight: with each review more is known of which channel drives which motor.
        """
        parameters = self._vehicles.followed_parameters
        if parameters is self._parameters:
            return
        self._parameters = parameters
        self._wind.parameter_drag = Drag.from_parameters(self._vehicle.autopilot, parameters)

    def _choose_inputs(self, rows: RowBuilder) -> None:
        """Does the part of a review that chooses the motors' outputs among the candidate messages.

        Args:
            rows: builder of the vehicle's rows.
        """
        rows.choose_inputs(self._candidate_messages, self._vehicle_telemetry(), self._message_time)

    def _check_messages(self, rows: RowBuilder) -> Fact | None:
        """Returns the reason why the rates of attitude and motor messages allow no rows; None if they do.

        A row is one sample of the model's data: motion and motor outputs at one time. The check also reports changes.

        Args:
            rows: builder of the vehicle's rows, which measures the rates.
        """
        invalid_attitude = self.watchdog.control.invalid_attitude(self._vehicle_telemetry())
        if invalid_attitude is not None:
            # More messages would not help; the watchdog reports it.
            return invalid_attitude
        return self._rate_check.update(
            self._vehicle.vehicle_type,
            rows.attitude_message,
            rows.motor_message,
            rows.rates(self._review_time),
        )

    def _review_phase(self, rows: RowBuilder) -> None:
        """Does the part of a review that checks the rates of messages and decides whether the vehicle flies.

        The steps:

        1. The rates of attitude and motor messages, Hz, are checked once the vehicle has been heard without a pause for
           ``DECISION_SECONDS``; before, they are not known. ``no_rows_reason`` becomes the reason why there are no
           rows: a rate that is too low comes first, then that the vehicle does not fly.
        2. Where motor outputs come and yet no motors can be chosen among them, no channel has moved: the motors are
           idle, and the vehicle is on the ground.
        3. The phase of flight is decided by the vehicle's messages and by the collective, the mean of all motor outputs
           as a share of their range.
        4. At a take-off the estimates of the wind begin again, since each flight has its own wind.

        Args:
            rows: builder of the vehicle's rows.
        """
        now = self._review_time
        # This is the time for which reviews have followed each other without a pause.
        connected_seconds = now - self._connection_start
        if connected_seconds >= DECISION_SECONDS:
            self.no_rows_reason = self._check_messages(rows) or self.phase.not_flying_reason
        if rows.inputs is None and connected_seconds >= AVERAGING_SECONDS / 2:
            self.phase.motors_are_idle = rows.has_motor_messages
        self.telemetry = self._vehicle_telemetry()
        collective = None if rows.inputs is None else rows.inputs.collective
        was_flying = self.phase.is_flying
        self.phase.review(now, self.telemetry, collective)
        if self.phase.is_flying and not was_flying:
            self._wind.restart()

    def _collect_motion(self, rows: RowBuilder) -> None:
        """Collects the motion of the last seconds for the watchdog."""
        self._motion = rows.recent_motion()

    def _begin_watchdog_review(self, _: RowBuilder) -> None:
        """Does the part of a review that reports new messages of the autopilot, and queues the watchdog's other parts.

        The watchdog reviews the vehicle without a model. It judges battery, estimator, vibration and tracking in flight
        only, and only in its thorough reviews, since that takes longer.

        Args:
            _: unused; all parts of a review have the same arguments.
        """
        assert self.telemetry is not None
        now = self._review_time
        is_flying = self.phase.is_flying
        settled_start = self.phase.settled_start(now)
        for fact in self.watchdog.begin_review(
            now, self.telemetry, is_flying=is_flying, settled_start=settled_start
        ):
            self._report(fact)
        if is_flying and self.watchdog.is_thorough:
            self._pending_parts.append(self._review_lights)
            if self.watchdog.is_tracking_due:
                self._pending_parts.append(self._review_tracking)
        self._pending_parts.append(self._finish_watchdog_review)

    def _review_lights(self, _: RowBuilder) -> None:
        """Judges battery, estimator and vibration in flight."""
        self.watchdog.review_lights()

    def _review_tracking(self, _: RowBuilder) -> None:
        """Judges how the vehicle follows its setpoints, if the flight is still settled."""
        settled_start = self.phase.settled_start(self._review_time)
        if settled_start is not None:
            self.watchdog.review_tracking(settled_start)

    def _finish_watchdog_review(self, _: RowBuilder) -> None:
        """Performs the last part of a review: reports alarms that begin or end, and whether the motors are monitored.

        The balance of the motors is tested with each of their samples (``MotorAlarms``), not by this review. But the
        user sees in one list what is monitored and what is not, and the watchdog keeps that list.

        Args:
            _: unused; all parts of a review have the same arguments.
        """
        for fact in self.watchdog.finish_review(self._motion, self.phase.takeoff_time):
            self._report(fact)
        now = self._review_time
        reason = self._motor_alarms.reason_not_watched(now, is_flying=self.phase.is_flying)
        self.watchdog.set_motors_watched(reason, now)
