"""A live session: it records, learns from and shows what a link receives, step by step.

One thread does all of it except what takes long: models are learned in the executor, and what is displayed waits in the
view's own queue. What is received is recorded first, and waits for its analysis; its time is the time of arrival.
"""

from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from math import inf
from typing import NamedTuple

from mavdem.assessment.judgement import Judgement
from mavdem.dem import Estimate, Learned, Settings
from mavdem.dem.online.learner import FIRST_FIT_RUNNING
from mavdem.dem.parallel import LearningProcess
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.event import Event
from mavdem.facts.lights import Light
from mavdem.facts.loops import GainFact, LoopAction
from mavdem.facts.margins import MarginsLight
from mavdem.facts.session import (
    DelayedWork,
    MissingMessages,
    RecordingState,
    RowsFact,
    SessionFact,
    TimeUse,
    VehicleFact,
)
from mavdem.ingest.mavlink.frame_reader import Frame
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES
from mavdem.live import clock
from mavdem.live.alarm_delay import RELIABLE_ALARM_DELAY
from mavdem.live.backlog import STEP_SECONDS, Backlog
from mavdem.live.clock_speed import ClockSpeed
from mavdem.live.flight_analysis import FlightAnalysis
from mavdem.live.gain_advice import MAX_WAIT_SECONDS, GainAdviser
from mavdem.live.history import SAMPLE_PERIOD
from mavdem.live.intake import LinkIntake
from mavdem.live.link import SILENCE_SECONDS, Link, ReceivedPiece
from mavdem.live.margin_review import MarginReview
from mavdem.live.milestones import Milestones
from mavdem.live.presentation import OpenDisplay, Presentation
from mavdem.live.rate_negotiation import RateNegotiation
from mavdem.live.raw_recording import RawRecording
from mavdem.live.rows import AlignedRow, RowFormat
from mavdem.live.session_state import are_most_rows_postponed
from mavdem.live.session_status import STATUS_PERIOD, SessionStatus
from mavdem.live.silence import SUCCESSION_SECONDS, SilenceMonitor, resumption
from mavdem.live.status_report import StatusReport
from mavdem.live.stream import LiveStream
from mavdem.live.time_account import TimeAccount
from mavdem.live.vehicle_selection import Component
from mavdem.plant.online_wind_torque import FIRST_FIT_SECONDS

RECORDING_AWAITED = Fact(SessionFact.RECORDING_NOT_JUDGED, kind=RecordingState.BEING_READ)
"""The verdict on the recording of a flight, as long as that is still being read."""

MAX_REST_ANALYSIS_SECONDS = 2.0
"""Longest time for which the end of a session waits for the analysis of its last messages, s: a choice; browsers wait
for 5 s for the last page of a server."""

UNUSABLE_MESSAGES_CODES = (
    RowsFact.NO_LIVE_ATTITUDE,
    RowsFact.ATTITUDE_ASKED,
    RowsFact.NO_LIVE_MOTORS,
    RowsFact.LIVE_RATES_TOO_LOW,
)
"""Codes of the reasons why no model is learned from the messages that come: attitude or motor outputs are missing or
unusable, or they come too slowly."""


NOT_FOLLOWED_CODES = (
    VehicleFact.CHOOSE_VEHICLE,
    VehicleFact.NO_MULTIROTOR_YET,
    VehicleFact.TWO_VEHICLES_LIVE,
)
"""Codes of the reasons why no vehicle that sends is followed, so that there is no model."""


class _Resumption(NamedTuple):
    """A report that messages come again, while it waits for a message with a time of the vehicle's clock."""

    fact: Fact
    """The report."""

    arrival_time: float
    """When the first message after the silence arrived, s of the monotonic clock."""

    former_time: float
    """Time of the timeline before it, s."""


class LiveSession:
    """A live session with one vehicle: it receives and records messages, learns a model from them, judges and shows it.

    Each of these tasks has an object of its own; this class calls them in the right order.

    Attributes:
        link: the link.
        stream: rows and alarms of the vehicle.
        intake: receives from the link, and records.
        backlog: what was received and waits for its analysis.
        flight: what is learned and judged of the latest flight; each take-off begins another one.
        history: what happened so far.
        gain_adviser: advises gains after a landing and at the end; None for no advice, also if the recording has ended
            in flight.
        successor: the vehicle that another session is to follow, since the followed one is silent and this one sends;
            None for none.
    """

    def __init__(
        self,
        link: Link,
        stream: LiveStream,
        settings: Settings,
        open_display: OpenDisplay,
        report_status: Callable[[SessionStatus], None],
        report_event: Callable[[Event], None],
        executor: Executor | None = None,
        recording: RawRecording | None = None,
        requested_rate: float | None = None,
        prior: Learned | None = None,
        gain_adviser: GainAdviser | None = None,
        recording_name: str | None = None,
        *,
        keeps_vehicle: bool = False,
        first_pieces: Sequence[ReceivedPiece] = (),
    ) -> None:
        """Makes a session on an open link; messages are received by :meth:`step`.

        Args:
            link: link that is open.
            stream: stream of one vehicle.
            settings: settings of the learner.
            open_display: function that is called with each new format of rows, and returns their display, or None.
            report_status: function that is called with the status once a second, and just before an alarm is reported.
            report_event: function that is called with each event for the user.
            executor: executor in which models are learned and judged; None for this thread.
            recording: recording of the raw stream; None for none.
            requested_rate: message rate to ask the vehicle for, Hz; None to send nothing at all.
            prior: model of an earlier flight of the vehicle.
            gain_adviser: advises gains after a landing and at the end; None for no advice.
            recording_name: file in which the user has the recording; empty if that is known later, None without one.
            keeps_vehicle: whether the user has chosen the vehicle: it then has no successor.
            first_pieces: frames of the vehicle that succeeds another one, which the recording has already.
        """
        self.link = link
        self.stream = stream
        self.gain_adviser = gain_adviser
        self.successor: Component | None = None
        self._keeps_vehicle = keeps_vehicle
        # The name of a recording is known later where a library stores it.
        self._is_judged_in_library = recording_name == ""
        self._report_status = report_status
        self._executor = executor
        # The parts, in the order in which later ones need earlier ones.
        self._presentation = Presentation(open_display, report_event, stream.motor_alarms)
        self.history = self._presentation.history
        log = self._presentation.log
        self.intake = LinkIntake(link, stream.frame_reader, recording, log, first_pieces)
        self.backlog = Backlog(begins_late=bool(first_pieces))
        self._silence_monitor = SilenceMonitor()
        self._new_flight = partial(
            FlightAnalysis,
            stream.axis,
            settings,
            executor,
            prior=prior,
            log=log,
            recording_name=recording_name,
        )
        self.flight = self._new_flight()
        self._milestone_reporter = Milestones(stream.axis, log)
        self._margin_review = MarginReview(executor, recording_name)
        self._clock_speed = ClockSpeed(log)
        self._rates = RateNegotiation(
            requested_rate,
            awaits_greeting=link.awaits_greeting,
            intake=self.intake,
            stream=stream,
            log=log,
        )
        self._report = StatusReport(
            stream,
            intake=self.intake,
            backlog=self.backlog,
            silence=self._silence_monitor,
            flight=self.flight,
            margin_review=self._margin_review,
            clock_speed=self._clock_speed,
            rates=self._rates,
            time_account=TimeAccount(),
        )
        # When the status was reported last, s of the monotonic clock, and its ``no_model_reason`` then.
        self._status_time = 0.0
        self._reported_reason: Fact | None = None
        # Time of the latest sample that was added to the history without a row, s of the boot clock.
        self._sample_time = -inf
        # Time without any message, s, if it was reported that messages come again, and neither attitude nor motor
        # outputs have come since; otherwise 0.
        self._reported_silence = 0.0
        # The report that messages come again, while it waits for a message with a time.
        self._resumption: _Resumption | None = None
        # Number of the flight that ``flight`` is about.
        self._flight_number = 0
        # The latest model of an earlier flight, which is kept if the latest flight gives none.
        self._earlier_model: Learned | None = None
        # Number of the latest flight whose end was reported, and of that whose recording is judged; 0 before any.
        self._ended_flight = 0
        self._recorded_flight = 0

    def refuse_prior(self, reason: Fact) -> None:
        """Discards the earlier flight that the user has named as a prior, with its model and drag, and reports why.

        Args:
            reason: the fact that another vehicle made that flight.
        """
        self._new_flight = partial(self._new_flight, prior=None)
        self.flight.learning.forget_prior()
        self.stream.wind.earlier_drag = None
        # Estimates of the wind so far were based on that drag.
        self.stream.wind.restart()
        self._presentation.log(reason)

    def step(self, timeout: float = 0.1) -> None:
        """Performs one iteration of the session: receives and records messages, analyses them for a while, and reports.

        The link is emptied first, since its buffer is small. Analysis then goes on for ``STEP_SECONDS`` only, even if
        more messages wait, so that the link is emptied again soon.

        Args:
            timeout: longest time to wait for a message of the link while none waits for analysis, s.
        """
        # Messages that wait already are analysed at once.
        receive_timeout = 0.0 if self.backlog else timeout
        batches = self.intake.receive(receive_timeout)
        self.backlog.add(batches, is_link_empty=self.intake.is_link_empty)
        self._postpone_tasks()
        end_time = clock.monotonic() + STEP_SECONDS
        while self.backlog and clock.monotonic() < end_time:
            self._analyse()
        self._report_events()
        self._request_rates()
        now = clock.monotonic()
        if now - self._status_time >= STATUS_PERIOD:
            self._status_time = now
            self._judge_and_report(now)

    def analyse_rest(self) -> None:
        """Analyses the messages that still wait at the end of the session, for ``MAX_REST_ANALYSIS_SECONDS`` at most.

        On a computer that is far behind, they may show a landing. Without them the vehicle would seem lost in flight.
        """
        end_time = clock.monotonic() + MAX_REST_ANALYSIS_SECONDS
        while self.backlog and clock.monotonic() < end_time:
            self._analyse()
        self._report_events()

    def _report_events(self) -> None:
        """Reports the first model, and the events of vehicle and link since the last step, to the user.

        The status is reported before an alarm: it may be a second old, and call the vehicle sound beside the alarm.
        """
        self._milestone_reporter.note_first_model(
            self.flight.learning,
            self.stream.now,
            self.stream.takeoff_time,
            is_flying=self.stream.is_flying,
        )
        events = self.stream.drain_events()
        has_alarm = any(event.fact.is_bad for event in events)
        has_vehicle = any(event.fact.code is VehicleFact.FOLLOWING_VEHICLE for event in events)
        if has_alarm or has_vehicle:
            # An old status would call the vehicle sound beside the alarm, or say that no vehicle was found.
            self._report_status_unless_late(self.status)
        for event in events:
            # A vehicle that is to be followed after a silent one has been reported as its successor.
            is_other_vehicle = event.fact.code is VehicleFact.OTHER_VEHICLE
            is_reported_successor = is_other_vehicle and self.successor is not None
            if not is_reported_successor:
                self._presentation.log(event.fact)
        for fact in self.link.drain_events():
            self._presentation.log(fact)

    def _report_status_unless_late(self, status: SessionStatus) -> None:
        """Displays the present status, unless this computer is far behind with the analysis of the messages.

        It is then not displayed, since drawing it takes time that the analysis needs.

        Args:
            status: the present status.
        """
        # The more messages wait, the more kinds of work are postponed. Estimates are the last of them.
        is_far_behind = self.backlog.postpones(DelayedWork.ESTIMATES)
        if not is_far_behind:
            self._report_status(self._withhold_all_clear(status))

    def _request_rates(self) -> None:
        """Measures the message rates of the vehicle, and requests higher ones where messages come too slowly.

        Rates are counted per second of the vehicle's clock, since a simulated vehicle may run slower than real time.
        """
        # All messages that arrived until this time have been counted, s of this computer's monotonic clock.
        count_time = self.backlog.analysed_until
        # The speed of the vehicle's clock follows from its latest time since boot, s.
        self._clock_speed.update(count_time, vehicle_time=self.stream.now)
        self._rates.update(
            count_time,
            self._silence_monitor.message_time,
            is_busy=self.backlog.is_late,
            vehicle_seconds=self._clock_speed.elapsed_seconds(count_time),
        )

    def _judge_and_report(self, now: float) -> None:
        """Judges the flight anew, and reports to the user what has changed; called every ``STATUS_PERIOD``.

        The order of the steps matters:

        1. The model and, after a landing, the recording of the flight are judged: the status has these judgements.
        2. Reports of the autopilot that were left out, because too many came, are shown before newer reports.
        3. The status is made once, so that all reports that follow agree with each other.
        4. The status is shown, and after it the reports that explain it: why no model is learned, then results.

        Args:
            now: present time, s of the monotonic clock.
        """
        self._judge_model(now)
        self.report_gain_advice()
        self._presentation.report_omissions()
        status = self.status
        self._store_state_of_flight(status)
        self._report_status_unless_late(status)
        self._report_no_model_reason(status)
        if not self.backlog:
            # Otherwise :meth:`_analyse` accounts for this time, up to the arrival of the messages that wait.
            self._report.update_time_account(now)
        self._report_results(status)

    def _store_state_of_flight(self, status: SessionStatus) -> None:
        """Stores the voltages of the batteries in the history while the vehicle flies.

        On the ground it resets ``is_free_flight`` of the learning. So a vehicle that leaves the ground again does not
        count as flying freely before a row, a sample of its motion, shows that it does.

        Args:
            status: the present status.
        """
        if not status.is_flying:
            # In flight each row sets this field. On the ground no rows come that would reset it.
            self.flight.learning.is_free_flight = False
        elif status.state is not None:
            self.history.add_voltages(status.state.voltages)

    def _report_results(self, status: SessionStatus) -> None:
        """Reports results as they become known: physical parameters, and after a landing what the flight has shown.

        Args:
            status: the present status, with the judgement of the flight.
        """
        # The recording shows the margins better than the model learned in flight. If it will be judged, by the adviser
        # here or by the library after the session, the margins of that model are not reported.
        self._milestone_reporter.margins_follow = (
            self.gain_adviser is not None or self._is_judged_in_library
        )
        self._milestone_reporter.update(
            self.flight.learning, status, self.stream.now, self.stream.boot
        )

    def _judge_model(self, now: float) -> None:
        """Judges the latest model of the flight and its stability margins, if this computer has time for it.

        Args:
            now: present time, s of the monotonic clock.
        """
        # After a landing a model is learned from the samples before it; it becomes the latest model when it is ready.
        self.flight.learning.adopt_model_before_landing()
        # A computer that has no time for fits has no time to judge a model either.
        is_busy = self.backlog.postpones(DelayedWork.PHYSICAL_FITS)
        self._margin_review.update(
            now,
            self.stream,
            is_busy=is_busy,
            # Advice on gains comes with the assessment of the recording.
            is_recording_assessed=self.gain_adviser is not None,
        )
        self.flight.judging.update(
            now,
            self.flight.learning,
            self.stream,
            is_busy=is_busy,
            has_rate_setpoint=self._has_rate_setpoint,
        )

    def _postpone_tasks(self) -> None:
        """Postpones tasks if this computer is too slow to analyse the messages of the link as they come.

        The longer the delay of the analysis, the more tasks wait: first new fits, then the drawing of plots, and in the
        end estimates. Before any of them, the process that learns is suspended for a moment.
        """
        # The report that this computer begins to be too slow, or keeps up again; None where neither has changed.
        delay_report = self.backlog.update(self.link.dropped_datagrams)
        if isinstance(self._executor, LearningProcess):
            self._executor.suspend(self.backlog.suspends_learning)
        self._presentation.pause(self.backlog.postpones(DelayedWork.PLOTS))
        self.flight.learning.allow_fits(
            physical_fits=not self.backlog.postpones(DelayedWork.PHYSICAL_FITS),
            model_refits=not self.backlog.postpones(DelayedWork.REFITS),
        )
        if delay_report is None:
            return
        if delay_report.code is SessionFact.COMPUTER_KEEPS_UP:
            # The latencies so far are of the slow time.
            self.flight.latencies.clear()
        self._presentation.log(delay_report)

    def _analyse(self) -> None:
        """Analyses the oldest waiting messages: learns from their rows, and notes landings, silences and reboots.

        The order of the stages matters:

        1. The time before these messages is added to the time account, before they change the state of the session.
        2. The model learns from the messages, and the timeline is advanced.
        3. If the vehicle has landed or is out of control, what was learned from that is withdrawn.
        4. The end of a silence is reported.
        5. After a reboot or a silence the vehicle may have forgotten its message rates, which are requested again.

        Arrivals and silences are in s of the monotonic clock.
        """
        batches = self.backlog.pop_simultaneous()
        first_arrival = batches[0].arrival_time
        last_arrival = batches[-1].arrival_time
        if self._report.time_account.is_due(first_arrival):
            self._report.update_time_account(first_arrival)
        # The boot is compared below: frames of a rebooted vehicle increase it.
        former_boot = self.stream.boot
        frames: list[Frame] = []
        for batch in batches:
            frames += batch.frames
        self._learn_from_frames(frames, batches[0].stamp, first_arrival)
        for batch in batches:
            vehicle = self.stream.followed_vehicle
            self._margin_review.add_messages(batch.stamp, batch.frames, vehicle, self.stream.boot)
        # How long no message of the vehicle had come before these.
        silence = self._update_silence_monitor(first_arrival, last_arrival, frames)
        former_time = self.history.now
        self._advance_history()
        self._show_slow_sample()
        self._process_landing_or_loss()
        self._report_end_of_silence(silence, first_arrival, former_time)
        has_rebooted = self.stream.boot != former_boot
        if has_rebooted or silence > SILENCE_SECONDS:
            self._rates.restart()

    def _advance_history(self) -> None:
        """Advances the history of the session, which the charts show, to the time of the latest message."""
        self.history.advance(self.stream.now, self.stream.boot, self._restart_seconds)
        if self.stream.is_flying:
            self.history.note_flight(self.stream.flight_number, self.stream.takeoff_time)

    def _report_end_of_silence(
        self, silence: float, arrival_time: float, former_time: float
    ) -> None:
        """Reports that messages of the vehicle, or those of its motion, come again, and keeps the longest outage.

        Args:
            silence: how long no message of the followed vehicle had come before the latest ones, s.
            arrival_time: when the latest ones arrived, s of the monotonic clock.
            former_time: end of the charts before the latest ones came, s of the vehicle's time.
        """
        self._report_resumed_messages(silence, arrival_time, former_time)
        self._report_resumed_motion()
        self._silence_monitor.note_attitudes(self.stream.attitude_count)
        self._silence_monitor.note_outage(silence, is_flying=self.stream.is_flying)

    def _learn_from_frames(
        self, frames: Sequence[Frame], stamp: float, arrival_time: float
    ) -> None:
        """Makes rows (samples of motor outputs and motion) of frames, and trains the model with each of them.

        Args:
            frames: the next frames of the link, in the order of arrival.
            stamp: when they were received, UNIX s.
            arrival_time: the same, s of the monotonic clock.
        """
        for row in self.stream.process_frames(stamp, frames):
            # A take-off among the frames before this row has begun another flight, which the row belongs to.
            self._begin_flight_if_new()
            self._process_row(row, arrival_time)
        # The last frames may have shown a take-off without completing a row.
        self._begin_flight_if_new()

    def _begin_flight_if_new(self) -> None:
        """Begins to learn and to judge anew if the vehicle has taken off again since the last call.

        It may have been repaired or damaged between two flights, so that nothing of the flight before counts any more.
        The model of that flight is kept only in case the new flight gives none.
        """
        # Flights of the vehicle are counted from 1; before the first take-off the number is 0.
        flight_number = self.stream.flight_number
        if flight_number == self._flight_number:
            return
        self._flight_number = flight_number
        if flight_number == 1:
            # What was found before the first take-off, such as why nothing can be learned, belongs to this flight.
            return
        latest_model = self.flight.learning.latest_model(self.stream.parameters)
        if latest_model is not None:
            self._earlier_model = latest_model
        self.flight = self._new_flight()
        self._report.flight = self.flight

    @property
    def _restart_seconds(self) -> float:
        """Time between the attitudes before and after the latest restart of the autopilot, s; 0 without a restart."""
        restart = self.stream.latest_restart
        if restart is None:
            return 0.0
        last_reception, first_reception = restart
        return first_reception - last_reception

    def _report_resumed_messages(
        self, silence: float, arrival_time: float, former_time: float
    ) -> None:
        """Reports that messages of the followed vehicle come again, if none had come for ``SILENCE_SECONDS``.

        The report is shown with the time of the vehicle's clock, which messages such as HEARTBEAT do not have. So it is
        kept in ``_resumption`` until a message with a time comes, for ``SILENCE_SECONDS`` at most. Reported at once, it
        would have the time at which the silence began.

        Args:
            silence: how long no message of the followed vehicle had come before the latest ones, s.
            arrival_time: when the latest ones arrived, s of the monotonic clock.
            former_time: time of the timeline before these, s.
        """
        fact = resumption(MissingMessages.MESSAGES, silence)
        if fact is not None:
            self._resumption = _Resumption(fact, arrival_time, former_time)
            # A moment later attitude and motor outputs come again, too. :meth:`_report_resumed_motion` then reports
            # that only if these were missing for much longer.
            self._reported_silence = silence
        waiting = self._resumption
        if waiting is None:
            return
        has_new_time = self.history.now != waiting.former_time
        if has_new_time or arrival_time - waiting.arrival_time > SILENCE_SECONDS:
            self._resumption = None
            self._presentation.log(waiting.fact)

    def _report_resumed_motion(self) -> None:
        """Reports that attitude or motor outputs come again, if neither had come for ``SILENCE_SECONDS``.

        They may be missing alone, while slow messages such as HEARTBEAT come. If all messages were missing,
        :meth:`_report_resumed_messages` has just reported their return, and has stored how long they were missing in
        ``_reported_silence``. One pause needs no second report. So this method then reports only if attitude and motor
        outputs had been missing for longer than all messages, by more than ``SILENCE_SECONDS``.
        """
        motion_silence = self._silence_monitor.note_samples(self.stream.sample_count)
        has_new_samples = motion_silence > 0.0
        if not has_new_samples:
            return
        # 0 unless the return of all messages was reported.
        silence_of_all_messages = self._reported_silence
        self._reported_silence = 0.0
        report = resumption(MissingMessages.MOTION, motion_silence)
        if report is not None and motion_silence - silence_of_all_messages > SILENCE_SECONDS:
            self._presentation.log(report)

    def _update_silence_monitor(
        self, first_arrival: float, last_arrival: float, frames: Sequence[Frame]
    ) -> float:
        """Tells the silence monitor what has arrived: messages of the followed vehicle, of others, or only noise.

        Noise is bytes without an intact frame. If the followed vehicle has been silent for long while another one
        sends, that one becomes its successor.

        Args:
            first_arrival: when the first of the messages arrived, s of the monotonic clock.
            last_arrival: when the last of the messages arrived, s of that clock.
            frames: frames of the messages, which the stream has processed; empty if only other bytes have arrived.

        Returns:
            How long no message of the followed vehicle had come before these, s; 0 if none of these is from it.
        """
        vehicle = self.stream.followed_vehicle
        monitor = self._silence_monitor
        has_intact_frame = any(frame.checksum == CHECKSUM_MATCHES for frame in frames)
        if not has_intact_frame:
            monitor.note_noise(last_arrival)
        if not frames:
            return 0.0
        # Before a vehicle is followed, messages of any sender end the silence: it may become the followed one.
        if vehicle is None or any(vehicle.has_sent(frame) for frame in frames):
            return monitor.note_messages(first_arrival, last_arrival)
        monitor.note_other_messages(last_arrival)
        if monitor.is_succeeded(first_arrival):
            self._choose_successor(vehicle, frames)
        return 0.0

    def _choose_successor(self, silent_vehicle: Component, frames: Sequence[Frame]) -> None:
        """Chooses another vehicle to be followed after the one that has been silent for long, and reports that.

        The session of the silent vehicle is to end then; the caller begins another one for ``successor``.

        Args:
            silent_vehicle: the vehicle that is followed now, and sends nothing any more.
            frames: the latest frames, all from other senders.
        """
        if self._keeps_vehicle or self.successor is not None:
            return
        self.successor = self.stream.other_vehicle_among(frames)
        if self.successor is None:
            return
        self._presentation.log(
            Fact(
                VehicleFact.VEHICLE_SUCCEEDED,
                subject=self.successor.description,
                name=silent_vehicle.name,
                duration=SUCCESSION_SECONDS,
            )
        )

    def _show_slow_sample(self) -> None:
        """Adds the latest sample to charts and display in flight, while messages come too slowly to learn from them.

        So the charts show the flight at any message rate. Of these samples, one is shown each ``SAMPLE_PERIOD``.
        """
        # After a reboot the boot clock begins at 0 again: the difference is negative, and a sample is due. Before the
        # first message with a time, ``now`` is NaN, and none is due.
        is_due = abs(self.stream.now - self._sample_time) >= SAMPLE_PERIOD
        if not self.stream.is_flying or not is_due:
            return
        self._sample_time = self.stream.now
        latest_sample = self.stream.latest_row()
        if latest_sample is None:
            # Nothing has come yet, or the messages are fast enough for rows.
            return
        row_format = latest_sample.row_format
        self.history.motor_names = row_format.geometry.names
        self._presentation.add_to_history(
            latest_sample.row, row_format, None, self.stream.wind.latest, self.stream.pose
        )
        self._presentation.preview(
            latest_sample,
            self.stream.pose,
            self.stream.wind.latest,
            self.flight.learning.row_format,
        )

    def _process_row(self, row: AlignedRow, arrival_time: float) -> None:
        """Trains the model with one row, that is one sample of motor outputs and motion at one time, and shows it.

        All rows are shown. The learner gets rows of free flight only, in which the vehicle is in the air and nothing
        holds it.

        Args:
            row: motor outputs and motion at one time on the boot clock.
            arrival_time: arrival of the packet that completed the row, s of the monotonic clock.
        """
        row_format = self.stream.row_format
        assert row_format is not None, "the stream sets the format before its first row"
        learning = self.flight.learning
        # Each segment of rows has a format object of its own.
        is_new_segment = row_format is not learning.row_format
        if is_new_segment:
            self._start_segment(row_format)
        learning.is_free_flight = row.is_free_flight
        if row.is_settled:
            self.flight.settled_seconds += row_format.dt
        estimate = self._learn_row(row)
        # The latency counts from the packet's arrival to the estimate, without the time for drawing below.
        self.flight.latencies.add(clock.monotonic() - arrival_time)
        is_late = self.backlog.delay > RELIABLE_ALARM_DELAY
        learning.note_estimate(estimate, row, self.stream.parameters, is_late=is_late)
        self._show_row(row, row_format, estimate)

    def _show_row(self, row: AlignedRow, row_format: RowFormat, estimate: Estimate | None) -> None:
        """Adds a row to the history of the flight, which the charts show, and draws it with the latest model and wind.

        Args:
            row: motor outputs and motion at one time on the boot clock.
            row_format: names of motors and outputs, units and time step of the row.
            estimate: the learner's estimate at this row; None without one.
        """
        pose = self.stream.pose
        wind = self.stream.wind.latest
        learner = self.flight.learning.learner
        model = None if learner is None else learner.learned
        self._presentation.add_to_history(row, row_format, estimate, wind, pose)
        self._presentation.show(row, pose, estimate, model, wind)

    def _start_segment(self, row_format: RowFormat) -> None:
        """Starts another segment of rows (samples of motors and motion at one time), as after a gap in the stream.

        If its motors and time step are those of the segment before, the learner continues; otherwise it begins anew.
        The charts get the names of the motors.

        Args:
            row_format: names of motors and outputs, units and time step of the rows that follow.
        """
        self.flight.learning.begin(row_format)
        self.history.motor_names = row_format.geometry.names
        self._presentation.open(row_format)

    def _learn_row(self, row: AlignedRow) -> Estimate | None:
        """Passes a row of free flight to the learner, or counts it if this computer has no time for estimates.

        Args:
            row: motor outputs and motion at one time on the boot clock.

        Returns:
            The learner's estimate; None if the learner did not get the row or could not use it.
        """
        if not row.is_free_flight:
            return None
        if self.backlog.postpones(DelayedWork.ESTIMATES):
            self.flight.postponed_rows += 1
            return None
        # While a motor is weak, the other motors balance its missing thrust, and that torque is not the wind's.
        return self.flight.learning.learn_row(row, self.stream.motor_alarms.weak_since)

    def _process_landing_or_loss(self) -> None:
        """Requests advice on gains and withdraws the latest samples when a landing or a loss of control is recognised.

        Both are recognised some time after they have begun. The samples since then were taken for settled flight, and
        say nothing true about it. So they are withdrawn from the model, from the errors of its predictions, and from
        the trims of the motors.
        """
        # Time of the first sample to withdraw, s of the boot clock. The stream returns each such time once.
        withdrawal_start = self.stream.pop_withdrawal_time()
        if withdrawal_start is None:
            return
        if self.gain_adviser is not None:
            # The flight has ended, so that its recording can be examined for advice on gains.
            self._request_gain_advice(self.gain_adviser)
        self.history.forget_learned_since(withdrawal_start)
        if self.flight.learning.learner is not None:
            self.flight.learning.withdraw_since(withdrawal_start)
        for fact in self.stream.motor_alarms.withdraw_since(withdrawal_start):
            self._presentation.log(fact)

    def _report_no_model_reason(self, status: SessionStatus) -> None:
        """Reports why no model is learned, or that one is being learned again, whenever that changes.

        The reason is compared with the one of the last change, which ``_reported_reason`` has. Two differences do not
        count: measured figures, such as rates, and a link that was lost in flight only a moment ago, which may come
        back at once. A change is not reported either if another report has said the same.

        Args:
            status: the present status, with the reason.
        """
        link_loss = status.link_loss
        reason = status.no_model_reason if link_loss is None else link_loss
        self._keep_unusable_messages_reason(reason, is_flying=status.is_flying)
        is_short_link_loss = link_loss is not None and not link_loss.is_bad
        former_reason = self._reported_reason
        is_same_reason = _without_measurements(reason) == _without_measurements(former_reason)
        if is_short_link_loss or is_same_reason:
            return
        self._reported_reason = reason
        if self._is_repeated_end_of_flight(reason, status.flight_number):
            return
        if not self._is_covered_by_other_report(reason, former_reason, status):
            self._presentation.log(_report_on_learning(reason, status))

    def _keep_unusable_messages_reason(self, reason: Fact | None, *, is_flying: bool) -> None:
        """Keeps a reason in flight why the messages cannot be used, such as too low rates, for the end of the session.

        It is then why there is no model, also if the vehicle no longer flies.

        Args:
            reason: why no model is learned now, for messages or otherwise; None if one is.
            is_flying: whether the vehicle flies now.
        """
        if is_flying and reason is not None and reason.code in UNUSABLE_MESSAGES_CODES:
            self.flight.unusable_messages_reason = reason

    def _is_repeated_end_of_flight(self, reason: Fact | None, flight_number: int) -> bool:
        """Returns whether a reason is the end of a flight, and was reported for this flight before.

        After a flight the reason may change, such as to a silence of the link, and back to the end of the flight. That
        end is reported once only. ``_ended_flight`` has the number of the latest flight whose end was a reason; this
        method updates it.

        Args:
            reason: why no model is learned now; None if one is.
            flight_number: number of the latest flight of the session.
        """
        if reason is None or reason.code is not SessionFact.FLIGHT_OVER:
            return False
        is_repeated = self._ended_flight == flight_number
        self._ended_flight = flight_number
        return is_repeated

    def _is_covered_by_other_report(
        self, reason: Fact | None, former_reason: Fact | None, status: SessionStatus
    ) -> bool:
        """Returns whether a changed reason needs no report, because another report has already informed the user.

        These are the report of the first model, the alarm of a lost vehicle, and the report on a flight after its
        landing (:class:`Milestones` makes the first and the last).

        Args:
            reason: why no model is learned now; None if a model is being learned.
            former_reason: the reason before the change; None if a model was being learned.
            status: the present status of the session.
        """
        # The first model is there as soon as the first fit, which was the reason until now, has ended.
        is_first_model = reason is None and former_reason == FIRST_FIT_RUNNING
        # That it listens is printed when a session starts, and later which vehicle was found, or that none was.
        is_listening = reason is not None and reason.code is VehicleFact.LISTENING
        # While a vehicle is out of control in the air, its alarm is reported, and learning does not matter.
        is_out_of_control = status.is_flying and status.loss is not None
        # After a landing, the report on the flight says that it is over; after a loss nobody is asked to take off.
        is_not_flying = reason is not None and reason.code is SessionFact.NOT_FLYING
        is_reported_landing = status.is_after_flight and is_not_flying
        return is_first_model or is_listening or is_out_of_control or is_reported_landing

    @property
    def status(self) -> SessionStatus:
        """The present status of link, vehicle and model, with the judgement of the flight.

        What the session adds to ``StatusReport.status`` is why less was learned than could be (``shortfall``), the
        judgements of all flights (``verdicts``), and why the recording was not judged, if that failed.
        """
        return replace(
            self._report.status,
            shortfall=self._missing_physical_parameters_reason(),
            verdicts=self._milestone_reporter.verdicts,
            recording_verdict=self.recording_failure,
        )

    @property
    def recording_failure(self) -> Fact | None:
        """Why the recording of the latest flight could not be judged; None if it was, or is still being judged."""
        is_of_latest_flight = self._recorded_flight == self.stream.flight_number
        if self.gain_adviser is None or not is_of_latest_flight:
            return None
        return self.gain_adviser.recording_failure

    @property
    def shown_status(self) -> SessionStatus:
        """The present status as users see it: no all-clear before the recording of a flight is judged."""
        return self._withhold_all_clear(self.status)

    def _withhold_all_clear(self, status: SessionStatus) -> SessionStatus:
        """Withholds the all-clear of a status while the recording of the latest flight is still being judged.

        The recording may show faults that the session did not find. Until then a headline that all is well gives way to
        one that says so; warnings stay.

        Args:
            status: the present status.
        """
        # After a landing the adviser reads the recording, from which it judges the flight and computes gains.
        is_recording_read = self.gain_adviser is not None and self.gain_adviser.is_awaited
        if not is_recording_read:
            return status
        return replace(status, recording_verdict=RECORDING_AWAITED)

    @property
    def ending_status(self) -> SessionStatus:
        """The status to show while a session ends.

        The recording of its last flight is judged next, and may show faults that the session did not find. So the
        status says that this judgement is awaited, and not that all is well. It does not if the judgement has failed
        already, or if there is no gain adviser: the one who reads the recording and judges it.
        """
        status = replace(self.status, is_over=True)
        is_recording_read = self.gain_adviser is not None
        has_recording_failed = status.recording_verdict is not None
        if not is_recording_read or has_recording_failed:
            return status
        return replace(status, recording_verdict=RECORDING_AWAITED)

    def time_account(self) -> dict[TimeUse, float]:
        """Returns how many seconds each use of time took, such as learning; their sum is the age of the session."""
        return self._report.update_time_account(self.backlog.analysed_until)

    def final_model(self) -> Learned:
        """Returns the model of the vehicle to keep at the end of the session.

        It is learned from the samples before the last landing or, if the vehicle still flies, from the latest samples.
        If the latest flight gives no model, the latest one of an earlier flight is kept, and it is reported why.

        Raises:
            NotLearnable: no model was learned in any flight; the error states why there is none of the latest one.
        """
        if isinstance(self._executor, LearningProcess):
            # On a busy computer the process that learns may be suspended. No more messages follow, so that it resumes.
            self._executor.suspend(False)
        try:
            return self._final_model_of_flight()
        except NotLearnable as error:
            if self._earlier_model is None:
                raise
            self._presentation.log(Fact(SessionFact.FORMER_MODEL_KEPT, reason=error.fact))
            return self._earlier_model

    def _final_model_of_flight(self) -> Learned:
        """Returns the model of the latest flight, which is kept at the end of the session.

        Raises:
            NotLearnable: there is no model. The error states the first of these reasons that applies: nothing came to
                learn from (:attr:`_reason_without_samples`); this computer had no time to learn from most samples; or
                the reason of the learner, such as too few samples.
        """
        reason = self._reason_without_samples
        if reason is not None:
            raise NotLearnable(reason)
        try:
            return self.flight.learning.final_model(self.stream.parameters)
        except NotLearnable as error:
            if self._is_computer_too_slow:
                raise NotLearnable(self._too_slow_fact) from error
            raise

    @property
    def _reason_without_samples(self) -> Fact | None:
        """Why no samples came to learn from in the latest flight; None without such a reason.

        Either the messages with attitude and motor outputs could not be used, or no vehicle was followed, such as
        because several were received and none was chosen.
        """
        has_samples = self.flight.learning.learner is not None
        if not has_samples and self.flight.unusable_messages_reason is not None:
            return self.flight.unusable_messages_reason
        # A reason of another code says that no vehicle has sent anything yet; then the learner's own reason says more.
        not_followed_reason = self.stream.not_followed_reason
        if not_followed_reason is not None and not_followed_reason.code in NOT_FOLLOWED_CODES:
            return not_followed_reason
        return None

    @property
    def _is_computer_too_slow(self) -> bool:
        """Whether this computer had no time to learn from most samples of the latest flight."""
        return are_most_rows_postponed(
            self.flight.postponed_rows, self.flight.learning.learned_rows
        )

    @property
    def _too_slow_fact(self) -> Fact:
        """The fact that this computer was too slow, with the numbers of samples left out and of all samples."""
        return Fact(
            SessionFact.COMPUTER_TOO_SLOW,
            count=self.flight.postponed_rows,
            samples=self.flight.postponed_rows + self.flight.learning.learned_rows,
        )

    def _missing_physical_parameters_reason(self) -> Fact | None:
        """Returns why the physical parameters, such as motor lag and rate damping, are not known so far.

        Returns:
            The first reason that applies: the messages gave no samples (angle and motor outputs at the same times);
            this computer was too slow for most samples; the settled flight (no take-off or landing) was too short for a
            fit; the fit is not finished. None if the parameters are known, or if the model has got no sample yet.
        """
        learning = self.flight.learning
        if learning.learner is None:
            return self.flight.unusable_messages_reason
        has_parameters = learning.estimate is not None and learning.estimate.physical is not None
        if has_parameters:
            return None
        if self._is_computer_too_slow:
            return self._too_slow_fact
        if learning.row_format is None or learning.learned_rows == 0:
            return None
        learned_seconds = learning.learned_rows * learning.row_format.dt
        if learned_seconds < FIRST_FIT_SECONDS:
            return Fact(
                SessionFact.SETTLED_TOO_SHORT,
                least_duration=FIRST_FIT_SECONDS,
                settled=learned_seconds,
            )
        return Fact(SessionFact.FIT_UNFINISHED)

    def judge_final_model(self, model: Learned | None) -> Learned | None:
        """Judges the model with which the session ends; ``status`` shows the judgement.

        The wind torque of a model is all torque that the motors do not explain. If a motor lost thrust in the flight,
        that torque is not the wind's, and the model is marked accordingly.

        Args:
            model: the model that was learned last; None without one.

        Returns:
            The model, marked if a motor lost thrust; None if no model was learned from the latest flight.
        """
        # A model of an earlier flight, which is kept if the latest one gives none, shows nothing of the latest flight.
        model_of_latest_flight = None if model is self._earlier_model else model
        return self.flight.judging.judge_final_model(
            model_of_latest_flight,
            self.flight.learning.row_format,
            self.stream.motor_alarms.changes_in_latest_flight,
            climbs=self.flight.learning.climbs,
            has_rate_setpoint=self._has_rate_setpoint,
        )

    @property
    def _has_rate_setpoint(self) -> bool:
        """Whether a setpoint of the body rate comes, or came in this flight.

        With it, the control loops, and so their margins, can be identified from the recording.
        """
        return self._margin_review.has_rate_setpoint or self.stream.has_rate_setpoint

    def report_end(self, status: SessionStatus, model: Learned | None) -> None:
        """Reports at the end of the session what was found in the flight, unless that was reported at the landing.

        Args:
            status: status of the session, with the judgement of the final model.
            model: the final model; None without one.
        """
        self._presentation.report_omissions(is_at_end=True)
        # Messages that came after the user ended the session are no part of its timeline.
        end_time = self.history.now - self.history.timeline_offset
        self._milestone_reporter.report_end(self.flight.learning, status, end_time, model)

    def report_gain_advice(self, *, is_at_end: bool = False) -> None:
        """Starts to compute advice on controller gains after a landing, and reports advice that is ready.

        The advice is computed from the recording by another process, together with a judgement of the whole flight.
        This method is called once in ``STATUS_PERIOD``, and at the end of the session.

        Args:
            is_at_end: whether the session ends. Then a flight without a landing gets advice too, and the call
                waits for the advice, at most ``MAX_WAIT_SECONDS``; it reports first that it waits.
        """
        is_flying = self.stream.is_flying
        if self.intake.is_recording_cut and is_flying:
            # The recording lacks the end of this flight, or all of it. What it shows is no judgement of the flight, and
            # its end in the air would be taken for a fault of the vehicle.
            self.gain_adviser = None
        adviser = self.gain_adviser
        vehicle = self.stream.followed_vehicle
        if adviser is None or vehicle is None:
            return
        if adviser.is_due and is_flying and not is_at_end:
            # The vehicle has taken off again before the computation began. The recording would now end in the air, so
            # that the advice has to wait for the next landing.
            return
        if is_at_end:
            self._announce_final_advice(adviser)
        advice = adviser.update(
            vehicle.name,
            is_busy=self.backlog.is_late,
            is_at_end=is_at_end,
            thrust_loss=self.stream.motor_alarms.lasting_thrust_loss,
        )
        is_of_latest_flight = self._recorded_flight == self.stream.flight_number
        if not is_of_latest_flight:
            # Another flight has begun meanwhile, whose pilot must not take this advice for advice on that flight. After
            # its landing the recording is examined again.
            return
        self._log_advice(advice, adviser.judgement)
        # The judgement of the recording says more than the judgement of the live model, and replaces it. But in flight
        # it is about an earlier flight, and must not hide what the model shows of this one.
        is_flight_over = is_at_end or not is_flying
        if adviser.judgement is not None and is_flight_over:
            self.flight.judging.use_judgement_of_recording(adviser.judgement)

    def _request_gain_advice(self, adviser: GainAdviser) -> None:
        """Requests advice on gains from the recording of the latest flight.

        The request only notes that advice is due. The computation, which also judges the recording, begins when
        :meth:`report_gain_advice` is called the next time on the ground, or at the end of the session.

        Args:
            adviser: computes the advice.
        """
        adviser.is_due = True
        # If another flight begins before the result is there, this number shows that it is about an earlier flight.
        self._recorded_flight = self.stream.flight_number

    def _announce_final_advice(self, adviser: GainAdviser) -> None:
        """Requests advice on gains at the end of a session in flight, and reports that the end will wait for it.

        A session that ends after a landing needs no request: the advice was requested at the landing.

        Args:
            adviser: computes the advice.
        """
        has_flown = self.flight.learning.has_settled or self.stream.is_flying
        has_landed = self.flight.learning.has_landed
        if has_flown and not has_landed:
            self._request_gain_advice(adviser)
        # Advice is awaited from its request until it is given.
        if adviser.is_awaited:
            self._presentation.log(Fact(GainFact.ADVICE_AWAITED, duration=MAX_WAIT_SECONDS))

    def _log_advice(self, advice: Facts, judgement: Judgement | None) -> None:
        """Reports the stability margins that the recording shows, if they are known, and then the advice on gains.

        Args:
            advice: facts (findings) on what to do with the gains of each axis; empty while no advice is ready.
            judgement: judgement of the recorded flight; None before it is ready.
        """
        reported_advice = list(advice)
        if not self.flight.learning.has_settled:
            # Without settled flight no gains can be computed, which needs no report. An error is reported all the same.
            reported_advice = [fact for fact in advice if fact.code is GainFact.ADVICE_FAILED]
        if reported_advice and judgement is not None:
            self._log_margins(judgement.lights[Light.MARGINS], tuple(reported_advice))
        for fact in reported_advice:
            is_to_leave_gains = fact.code is GainFact.GAINS_LEFT
            if is_to_leave_gains and self._is_reason_reported_already(fact):
                continue
            self._presentation.log(fact)

    def _is_reason_reported_already(self, gains_unchanged: Fact) -> bool:
        """Returns whether another report has said already why there are no new gains.

        After a loss of the vehicle its alarm says enough. If messages came too slowly for a model, the report after the
        landing says so; it need not be repeated if the gains stay for the same reason.

        Args:
            gains_unchanged: the fact that the gains stay as they are, with the reason.
        """
        if self.stream.status().loss is not None:
            return True
        reported_reason = self._missing_physical_parameters_reason()
        if reported_reason is None or reported_reason.code is not RowsFact.LIVE_RATES_TOO_LOW:
            return False
        # This fact says which messages are too slow, as for a log.
        slow_messages = reported_reason.figures["reason"]
        return bool(slow_messages.code == gains_unchanged.figures["reason"].code)

    def _log_margins(self, margins: Fact, advice: Facts) -> None:
        """Reports the stability margins, unless they are not known or the advice on gains states them anyway.

        Args:
            margins: the judgement of the margins, with the action that it advises.
            advice: what to do with the gains of each axis, which is reported next.
        """
        are_known = margins.code is MarginsLight.LOOP_MARGINS
        if not are_known or _are_margins_in_advice(margins, advice):
            return
        if any(fact.code is GainFact.GAINS_WRITTEN for fact in advice):
            # The gains follow, with their files: nobody has to run a command for them.
            margins = margins.replace(action=None)
        self._presentation.log(margins)

    def end(self) -> None:
        """Restores the vehicle's rates, which it must confirm if it still sends or flies, and ends the recording."""
        message_age = self._silence_monitor.message_age(self.intake.read_until)
        is_silent = message_age is not None and message_age >= SILENCE_SECONDS
        self._rates.restore(is_silent=is_silent, is_flying=self.stream.is_flying)
        self.intake.end_recording()


def _report_on_learning(reason: Fact | None, status: SessionStatus) -> Fact:
    """Returns the report that a model is being learned now, or why none is.

    During an alarm, and before it is judged whether the vehicle oscillates, the report does not advise to fly on.

    Args:
        reason: why no model is learned now; None if one is.
        status: the present status of the session, with its alarms and the loss of the vehicle.
    """
    report = Fact(SessionFact.BEING_LEARNED, Level.GOOD)
    if reason is not None:
        report = _reason_after_end(reason, status)
    is_alarmed = any(alarm.is_bad for alarm in status.active_alarms)
    if is_alarmed or status.is_oscillation_unjudged:
        return report.without_flight_advice
    return report


def _reason_after_end(reason: Fact, status: SessionStatus) -> Fact:
    """Returns why no model is learned, as it is reported after the end of a flight; any other reason as it is.

    After a loss of the vehicle the reason does not repeat the loss. If the vehicle was switched off after its landing,
    the reason says so.

    Args:
        reason: why no model is learned now.
        status: the present status of the session.
    """
    if reason.code is SessionFact.FLIGHT_OVER and status.loss is not None:
        # The loss was an alarm, which said what to do: that is not repeated as the reason of the end.
        return reason.replace(reason=None)
    if status.is_switched_off:
        # The link is silent because the vehicle is switched off: nobody needs to check the link.
        return reason.replace(is_after_landing=True)
    return reason


def _without_measurements(reason: Fact | None) -> Hashable:
    """Returns the content of a reason without its measured figures, so that two reasons can be compared."""
    return None if reason is None else reason.without_measurements


def _are_margins_in_advice(margins: Fact, advice: Facts) -> bool:
    """Returns whether the advice on gains gives the stability margins of an axis as its reason, and so states them.

    Args:
        margins: the fact (a coded finding) on the margins of one axis.
        advice: facts on what to do with the gains of each axis.
    """
    for fact in advice:
        # Only a decision on the loops of an axis has a reason, which may be their margins.
        if fact.code is not LoopAction.LOOPS_JUDGED:
            continue
        reason = fact.figures["reason"]
        if reason.code is margins.code and reason.figures["axis"] == margins.figures["axis"]:
            return True
    return False
