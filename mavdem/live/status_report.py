"""Assembly of a live session's status and time account from the objects that the session consists of."""

from dataclasses import dataclass, replace

from mavdem.facts import Fact
from mavdem.facts.session import LinkFact, MissingMessages, SessionFact, TimeUse, VehicleFact
from mavdem.live import clock
from mavdem.live.backlog import BEHIND_DELAY, Backlog
from mavdem.live.clock_speed import ClockSpeed
from mavdem.live.flight_analysis import FlightAnalysis
from mavdem.live.intake import LinkIntake
from mavdem.live.link import SILENCE_SECONDS
from mavdem.live.margin_review import MarginReview
from mavdem.live.rate_negotiation import RateNegotiation
from mavdem.live.session_status import SessionStatus
from mavdem.live.silence import SilenceMonitor, silence_of
from mavdem.live.stream import LiveStream
from mavdem.live.time_account import AccountedState, TimeAccount
from mavdem.live.watch_list import not_watched

SEARCH_SECONDS = 5.0
"""Time with messages after which no vehicle counts as found, s: five times the period of HEARTBEAT."""


@dataclass
class StatusReport:
    """Collects the states of a live session's link, stream, learning and judging into one status."""

    stream: LiveStream
    """Rows and alarms of the vehicle."""

    intake: LinkIntake
    """What receives."""

    backlog: Backlog
    """What waits for its analysis."""

    silence: SilenceMonitor
    """Knows when the last message came."""

    flight: FlightAnalysis
    """Learns and judges models of the latest flight; the session sets another one at each take-off."""

    margin_review: MarginReview
    """Identifies the control loops of the flight so far."""

    clock_speed: ClockSpeed
    """Knows how fast the vehicle's clock runs."""

    rates: RateNegotiation
    """Knows which messages do not come, although the vehicle was asked for them."""

    time_account: TimeAccount
    """The account of the session's time."""

    @property
    def status(self) -> SessionStatus:
        """The present status of the session without its ``shortfall``, for screen, log file and display.

        It is the status of the stream of messages, to which the findings, delays and predictions of the model are
        added. The stream advances with its messages only, and does not notice when none come. So on a silent link
        nothing counts as watched, and its last rates are replaced by 0, except after a landing: then the lights judge
        the flight that is over by the rates that it had.
        """
        status = self.stream.status()
        # The first reason counts: the link is silent, no samples can be made of the messages, or nothing is learned of
        # them.
        silence = self._silence_as_reason(status)
        no_learning_reason = self._no_learning_reason(is_flying=status.is_flying)
        analysis_delay = self.backlog.delay
        if analysis_delay < BEHIND_DELAY:
            # This computer keeps up.
            analysis_delay = 0.0
        message_age = self._message_age()
        status = replace(
            status,
            findings=self.flight.judging.findings,
            model_judgement=self.flight.judging.judgement,
            is_recording_judged=self.flight.judging.is_of_recording,
            margins=self.margin_review.present_margins(self.stream.now, self.stream.settled_start),
            provisional_margins=self.margin_review.provisional_light,
            learned_rows=self.flight.learning.learned_rows,
            unlearned_rows=self.flight.learning.unlearned_rows,
            postponed_rows=self.flight.postponed_rows,
            settled_seconds=self.flight.settled_seconds,
            latency=self.flight.latencies.latency,
            no_model_reason=self._reason_of_stream(status) or no_learning_reason,
            state=self.stream.vehicle_state(),
            message_age=message_age,
            motion_age=self.silence.motion_age(self.intake.read_until),
            last_reception=self._reception_time(message_age),
            analysis_delay=analysis_delay,
            held_alarm_delay=self.backlog.alarm_delay.seconds,
            is_recorded=self.intake.recording is not None,
            absent_messages=self.rates.absent_messages,
            link_outage=self.silence.outage,
        )
        if self.flight.learning.estimate is not None:
            status = status.with_predictions(self.flight.learning.estimate)
        if silence is not None:
            status = self._status_of_silent_link(status, silence)
        return status

    def _reason_of_stream(self, status: SessionStatus) -> Fact | None:
        """Returns why the stream of messages gives no samples to learn from; None if it gives them.

        That no vehicle is found counts only after ``SEARCH_SECONDS`` of messages: until then the session listens.

        Args:
            status: status of the stream.
        """
        reason = status.no_model_reason
        is_no_vehicle_found = reason is not None and reason.code is VehicleFact.NO_VEHICLE_YET
        has_searched = self.silence.has_received_for(SEARCH_SECONDS, self.intake.read_until)
        if is_no_vehicle_found and not has_searched:
            return Fact(VehicleFact.LISTENING)
        return reason

    def _status_of_silent_link(self, status: SessionStatus, silence: Fact) -> SessionStatus:
        """Corrects a status for a silent link: the rest of the session does not notice that no messages come.

        No quantity, such as the vibration, is watched for faults any more, no model is learned, and the rates of the
        messages are 0. Only the rates of a flight that is over stay as they were, since the flight is judged by them.

        Args:
            status: the status without regard to the silence, as it was when the last message came.
            silence: fact (coded finding) that says what does not come, as the reason why nothing is watched or learned.
        """
        now = self.stream.now
        watch_facts = tuple(not_watched(fact, silence, now) for fact in status.watch_facts)
        rates = status.rates
        if not status.is_after_flight:
            rates = dict.fromkeys(status.rates, 0.0)
        return replace(
            status,
            no_model_reason=silence,
            rates=rates,
            watch_facts=watch_facts,
            status_before_silence=status,
        )

    def _reception_time(self, message_age: float | None) -> float | None:
        """Returns when the last message of the followed vehicle came, UNIX s; None before any.

        Args:
            message_age: time from that message to the last look at the link, s; None before any message.
        """
        if message_age is None:
            return None
        seconds_since_reading = clock.monotonic() - self.intake.read_until
        return clock.unix_time() - seconds_since_reading - message_age

    def _message_age(self) -> float | None:
        """Returns the time since the last message of the followed vehicle came, analysed or not, s; None before any.

        It is counted to the last look at the link, since messages may wait there if this computer was busy since.
        """
        now = self.intake.read_until
        latest_arrival = self.backlog.latest_arrival_from(self.stream.followed_vehicle)
        if latest_arrival is not None:
            return max(now - latest_arrival, 0.0)
        return self.silence.message_age(now)

    def _silence_as_reason(self, status: SessionStatus) -> Fact | None:
        """Returns why there is no new model, if the link has brought no messages or no motion for a while.

        Usually the reason is this silence. In two cases the stream of messages has a better one, which is returned:

        1. Several vehicles send, and the user must choose one. Waiting for messages would not help, unless the
           connection itself is lost.
        2. No vehicle is followed any more, for example because two send under one id, while some vehicle still sends
           its attitude. So the motion is not missing on the link; it is ignored.

        Args:
            status: status of the stream, with its own reason why there is no model.

        Returns:
            The reason; None while messages and motion come.
        """
        silence = self._silence_fact()
        stream_reason = status.no_model_reason
        must_choose = stream_reason is not None and stream_reason.code is VehicleFact.CHOOSE_VEHICLE
        is_link_lost = silence is not None and silence.code is LinkFact.CONNECTION_LOST
        if must_choose and not is_link_lost:
            return stream_reason
        is_motion_missing = silence is not None and silence.subject == MissingMessages.MOTION
        if is_motion_missing and self._ignores_motion(status):
            return stream_reason
        return silence

    def _ignores_motion(self, status: SessionStatus) -> bool:
        """Returns whether some vehicle on the link sends its attitude, which is not used, since no vehicle is followed.

        Then the motion is not missing on the link, as it would seem.

        Args:
            status: status of the stream, with the vehicle whose messages are used; None without one.
        """
        is_vehicle_followed = status.vehicle is not None
        has_attitudes = self.silence.has_attitudes(self.backlog.analysed_until)
        return has_attitudes and not is_vehicle_followed

    def _silence_fact(self) -> Fact | None:
        """Returns the fact (coded finding) that the link is lost, or that messages of the vehicle are missing, and why.

        Returns:
            The fact. If only the followed vehicle is silent, it has the ``name`` of the vehicle. If attitudes come, but
            with time stamps that cannot be used, it has ``has_wrong_stamps``. None while all needed messages come.
        """
        if self.intake.is_lost:
            # The log says why the link was lost, and whether it is opened again; the status needs neither.
            return Fact(LinkFact.CONNECTION_LOST, cause=None, reopening=False)
        # Every byte that arrived up to this time, s of the monotonic clock, has been received and analysed. Silence is
        # counted up to it, since the messages after it may only wait for this computer.
        analysis_time = min(self.backlog.analysed_until, self.intake.read_until)
        silence_fact = self._missing_messages(analysis_time)
        vehicle = self.stream.followed_vehicle
        if silence_fact is None or vehicle is None:
            return silence_fact
        is_all_missing = silence_fact.subject == MissingMessages.MESSAGES
        if is_all_missing and self.silence.hears_other_vehicles(analysis_time):
            # Messages of others come, so that the user need not check the link's address or router.
            return silence_fact.replace(name=vehicle.name)
        if not is_all_missing and self._has_unusable_attitudes(analysis_time):
            return silence_fact.replace(has_wrong_stamps=True)
        return silence_fact

    def _missing_messages(self, analysis_time: float) -> Fact | None:
        """Returns the fact that all or some messages of the vehicle have not come for some seconds; None if all come.

        Args:
            analysis_time: time up to which every received byte has been analysed, s of the monotonic clock.
        """
        silence_fact = self.silence.missing_messages(analysis_time)
        if silence_fact is not None:
            return silence_fact
        message_age = self._message_age()
        if message_age is not None and message_age > SILENCE_SECONDS:
            # The link is silent while this computer still analyses what came before: a pilot must know at once.
            return silence_of(MissingMessages.MESSAGES)
        return None

    def _has_unusable_attitudes(self, now: float) -> bool:
        """Returns whether attitudes come, but cannot be used, since none has a time on the vehicle's clock.

        It is False if the link has several vehicles, since the attitudes may then be another one's.

        Args:
            now: time up to which every received byte has been analysed, s of the monotonic clock.
        """
        return self.silence.has_attitudes(now) and not self.stream.other_vehicles

    def _no_learning_reason(self, *, is_flying: bool) -> Fact | None:
        """Returns the reason why there is no new model of a vehicle whose rows arrive.

        The learner uses free flight only. Even then it may lack something, such as motion.

        Args:
            is_flying: whether the vehicle is in the air.

        Returns:
            The reason; None if models are learned.
        """
        if not is_flying:
            return Fact(SessionFact.NOT_FLYING)
        if not self.flight.learning.is_free_flight:
            return Fact(SessionFact.NOT_SETTLED)
        learner = self.flight.learning.learner
        if learner is None:
            return None
        return learner.no_model_reason

    def update_time_account(self, now: float) -> dict[TimeUse, float]:
        """Adds the time since the last update to the use on which it was spent, such as learning or a lost link.

        The use follows from the present state of the session.

        Args:
            now: time up to which everything that arrived is analysed, s of this computer's monotonic clock.

        Returns:
            Seconds that the session has spent on each use so far.
        """
        row_format = self.flight.learning.row_format
        # Time between two rows (samples of the motion) from which the model is learned, s; 0 as long as there are none.
        row_step = 0.0
        if row_format is not None:
            # The rows are timed by the vehicle's clock, which in a simulation may run slower than this computer's.
            row_step = self.clock_speed.real_seconds(row_format.dt)
        state = AccountedState(
            link_is_lost=self.intake.is_lost,
            message_time=self.silence.message_time,
            motion_time=self.silence.motion_time,
            learned_rows=self.flight.learning.learned_rows,
            dt=row_step,
            status=self.stream.status(),
        )
        return self.time_account.update(now, state)
