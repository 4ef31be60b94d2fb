"""LiveSession: records, learns from and shows what a link receives, step by step.

One thread does all of it except what takes long: batch learning runs in the learner's executor, and what is shown waits
in the view's own queue. What is received is recorded, and waits for its analysis: time is that of arrival.
"""

import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mavdem.assessment.autopilot_messages import REPEAT_SECONDS
from mavdem.assessment.axis.findings import Findings, findings_of, with_own_torque_marked
from mavdem.assessment.judgement import Judgement
from mavdem.dataset.axes import output_names_and_units
from mavdem.dem import Estimate, Learned, OnlineLearner, Settings
from mavdem.errors import NotLearnable, fact_from_error, failure_fact
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Override
from mavdem.facts.event import Event
from mavdem.facts.loops import Gains
from mavdem.facts.session import LinkFact, Missing, RateFact, Rows, Session, Spent, Task
from mavdem.facts.watch import Watch
from mavdem.ingest.mavlink.definitions import FrameSender
from mavdem.ingest.motors import control_parameters, motor_parameters
from mavdem.ingest.vocabulary import CONTROL_PARAMETERS
from mavdem.live.decisions import RowFormat, judged
from mavdem.live.display import Display, DisplayRow
from mavdem.live.gain_advice import GainAdviser
from mavdem.live.gusts import LiveGusts
from mavdem.live.history import MAX_ROWS, LiveHistory, horizon_steps
from mavdem.live.link import (
    MAX_PIECES,
    MAX_TRIES,
    PAUSE_SECONDS,
    SILENCE_SECONDS,
    Link,
    LinkLost,
)
from mavdem.live.messages import Piece
from mavdem.live.rate_request import Arrivals, RateRequest, greeting
from mavdem.live.rows import AlignedRow
from mavdem.live.session_status import Latency, SessionStatus
from mavdem.live.stream import LiveStream
from mavdem.live.watchdog import not_watched

JUDGING_SECONDS = 10.0  # From one judgement to the next
# Kept, so that one from before a landing is among them: several times the seconds that are taken back
MAX_MODELS = 16
# Of the last fit; where it takes longer, the model before is kept, or twice as long without one
FIT_SECONDS = 3.0
# Of analysis between two looks at the link, and of arrival that is analysed at once
STEP_SECONDS = 0.02
# What waits, from so many s behind on until half of that: fits first, then pictures, then estimates, so that motors
# and messages are judged in time
SHED = {Task.PHYSICAL_FITS: 0.5, Task.REFITS: 1.0, Task.PLOTS: 2.0, Task.ESTIMATES: 3.0}


@dataclass
class LiveSession:
    """A link and all that is done with what it receives."""

    link: Link  # open
    stream: LiveStream  # of one vehicle
    settings: Settings  # of the learner
    # Called with the first setup and each new one; returns the display of its rows, or None
    open_display: Callable[[RowFormat], Display | None]
    report_status: Callable[[SessionStatus], None]  # called once a second with the status
    report_fact: Callable[[Fact], None]  # called with each fact
    executor: Executor | None = None  # for batch learning
    # of the raw stream, by ``take`` and ``close``; ``None`` for none, and after it has failed
    recording: Any = None
    requested_rate: float | None = (
        None  # Hz to ask the vehicle for; ``None`` to send nothing at all
    )
    prior: Learned | None = None  # of an earlier flight of the vehicle
    gain_adviser: GainAdviser | None = None  # of gains, after a landing and at the end
    # file in which the user has the recording; empty if that is known later, None without one
    recording_name: str | None = None

    def __post_init__(self) -> None:
        """Begins now, without a model."""
        now = time.monotonic()
        self.learner: OnlineLearner | None = None  # of the latest rows
        self.history = LiveHistory()  # what happened
        # with s: when it came
        self._models: deque[tuple[float, Learned]] = deque(maxlen=MAX_MODELS)
        self._newest: Learned | None = None  # that is kept
        self._rising: Learned | None = None  # the last of a way up
        self._setup: RowFormat | None = None
        self._display: Display | None = None
        self.request: RateRequest | None = None  # for rates, once sent
        self._arrivals = Arrivals()
        self._greeted = -np.inf
        # of the latest rows, and the largest, s
        self._latencies = deque[float](maxlen=MAX_ROWS)
        self._largest = 0.0
        self._learned = 0
        self._shown = 0
        self._next_judging = 0.0
        self._obstacle: Fact | None = None
        self._estimate: Estimate | None = None
        self.judged: tuple[Findings | None, Judgement | None] = (None, None)
        self._judging: Future[tuple[Findings, Judgement]] | None = None
        # the last two: whether no model has come since the last landing, and whether any sample was settled
        self._settled = self._lost = self._landed = self._kept = False
        self._waiting: deque[Piece] = deque()
        self._arrival = self._heard = self._emptied = now
        self._late: float | None = None  # when the analysis was behind last
        self._shed = set[Task]()
        self.most_behind = 0.0  # s
        self._reported = 0.0
        self._sampled = -np.inf
        self._samples = 0
        self._account = dict.fromkeys(Spent, 0.0)
        # until when, samples learned, and s of them that are still to be counted
        self._accounted = now, 0, 0.0
        self._last_said: dict[object, float] = {}

    def step(self, timeout: float = 0.1) -> None:
        """Receives what has come, and analyses it for ``STEP_SECONDS``; waits at most ``timeout`` s for something."""
        self._waiting += self._receive(0.0 if self._waiting else timeout)
        self._keep_up()
        until = time.monotonic() + STEP_SECONDS
        while self._waiting and time.monotonic() < until:
            self._analyse()
        for event in self.stream.drain_events():
            self._log(event.fact)
        for fact in self.link.drain_events():
            self._log(fact)
        now = time.monotonic()
        self._request_rates()
        if now - self._reported >= PAUSE_SECONDS:
            self._judge(now)
            self.advise()
            self._reported = now
            status = self.status
            if Task.ESTIMATES not in self._shed:
                self.report_status(status)
            self._settled &= status.is_flying
            if status.is_flying:
                self._preview()
            if status.obstacle != self._obstacle:
                self._obstacle = status.obstacle
                self._log(status.obstacle or Fact(Session.BEING_LEARNED, Level.GOOD))
            if not self._waiting:
                self.account(now)

    @property
    def now(self) -> float:
        """Until when all that arrived is analysed, s of the monotonic clock."""
        return self._waiting[0].arrival if self._waiting else time.monotonic()

    def account(self, now: float | None = None) -> dict[Spent, float]:
        """Returns what the seconds were, second by second of arrival; their sum is the age of the session."""
        now = now or self.now
        stream = self.stream.status()
        (before, learned, owed) = self._accounted
        on_ground = Session.NOT_FLYING, Session.FLIGHT_UNKNOWN
        waits = stream.obstacle is not None and stream.obstacle.code not in on_ground
        kinds = {
            Spent.LINK_LOST: self._lost,
            Spent.SILENT: now - self._heard >= PAUSE_SECONDS,
            Spent.NO_VEHICLE: stream.vehicle is None,
            Spent.WAITING: waits or now - self._sampled >= PAUSE_SECONDS,
            Spent.UNSETTLED: stream.is_flying,
            Spent.ON_GROUND: True,
        }
        # Samples count for the time that they span, not for that in which they were analysed.
        owed += (self._learned - learned) * (self._setup.dt if self._setup else 0.0)
        spent = min(owed, now - before)
        self._accounted = now, self._learned, min(owed - spent, PAUSE_SECONDS)
        self._account[Spent.LEARNED] += spent
        self._account[next(kind for kind, holds in kinds.items() if holds)] += now - before - spent
        return {**self._account, Spent.LEFT_OUT: time.monotonic() - now}

    def _keep_up(self) -> None:
        """Does less, the farther the analysis is behind the link; says so when that begins and when it is over."""
        now = time.monotonic()
        behind = now - self.now
        self._shed = {
            task for task, limit in SHED.items() if behind >= limit / (1 + (task in self._shed))
        }
        if self._display is not None:
            self._display.pause(Task.PLOTS in self._shed)
        self.most_behind = max(self.most_behind, behind)
        if self.learner is not None:
            self.learner.fits_physical = Task.PHYSICAL_FITS not in self._shed
            self.learner.refits = Task.REFITS not in self._shed or self.learner.learned is None
        if behind >= SHED[Task.REFITS]:
            if self._late is None:
                self._log(Fact(Session.COMPUTER_BEHIND, delay=behind))
            self._late = now
        elif self._late is not None and now - self._late >= REPEAT_SECONDS:
            self._late = None
            self._latencies.clear()
            self._log(
                Fact(
                    Session.COMPUTER_KEEPS_UP,
                    delay=self.most_behind,
                    datagrams=self.link.dropped,
                )
            )

    def _analyse(self) -> None:
        """Analyses what arrived first and waits."""
        first = self._waiting[0]
        if first.arrival - self._accounted[0] >= PAUSE_SECONDS:
            self.account()
        together = []
        while self._waiting and self._waiting[0].arrival - first.arrival <= STEP_SECONDS:
            together.append(self._waiting.popleft())
        resumed = {Missing.MESSAGES: first.arrival - self._heard}
        self._arrival = first.arrival
        self._heard = together[-1].arrival
        boot = self.stream.boot
        frames = [frame for piece in together for frame in piece.frames]
        for row in self.stream.take_frames(first.stamp, frames):
            self._take(row)
        self.history.advance(self.stream.now, self.stream.boot)
        landing = self.stream.pop_landing_time()
        if landing is not None and self.learner is not None:
            self._take_back(self.learner, landing)
            if self.gain_adviser is not None:
                self.gain_adviser.is_due = self._kept
        if self.stream.sample_count != self._samples:
            resumed[Missing.MOTION] = self._heard - self._sampled
            self._samples = self.stream.sample_count
            self._sampled = self._heard
        for stream, after in resumed.items():
            if SILENCE_SECONDS < after < np.inf:
                self._log(Fact(Rows.MESSAGES_RESUMED, subject=stream, duration=after))
        is_new = self.stream.boot != boot or resumed[Missing.MESSAGES] > SILENCE_SECONDS
        if is_new and self.request is not None:
            self._arrivals = Arrivals()
            self.request.restart()

    def final_model(self) -> Learned:
        """Returns the last model before the last landing; in flight, that of the last samples.

        Raises NotLearnable: there is none.
        """
        if self.learner is None or self._learned and not self._kept:
            raise NotLearnable(Session.NO_LIVE_FLIGHT)
        if not (self._landed and self._models):
            seconds = FIT_SECONDS * (1 if self._models else 2)
            try:
                return self._named(self.learner.learn_now(seconds))
            except (TimeoutError, ValueError, RuntimeError) as error:
                late = Fact(Session.NOT_LEARNED_IN_TIME, duration=seconds)
                because = late if isinstance(error, TimeoutError) else fact_from_error(error)
            if not self._models:
                raise NotLearnable(because)
            self._log(Fact(Session.FORMER_MODEL_KEPT, because=because))
        _, model = self._models[-1]
        return self._named(model)

    def judge(self, learned: Learned | None) -> Learned | None:
        """Judges the model at the end, if there is one, and returns what is to be shown of it."""
        status = self.status
        setup = self._setup
        with suppress(ValueError):
            if learned is None or setup is None or learned.record.input_names != setup.layout.names:
                self.judged = findings_of(learned, alarms=status.motor_alarms), None
            else:
                self.judged = judged(learned, setup, status.motor_alarms, self.recording_name)
                is_own = any(
                    override.is_bad and override.code in (Override.OSCILLATION, Override.MOTORS)
                    for override in self.judged[0].overrides
                )
                learned = with_own_torque_marked(learned, is_own)
        return learned

    def advise(self, at_end: bool = False) -> None:
        """Says which gains are advised after a landing, the next step then; ``at_end`` it waits for that."""
        if self.gain_adviser is None or self.stream.followed_vehicle is None:
            return
        self.gain_adviser.is_due |= at_end and self._kept and not self._landed
        for fact in self.gain_adviser.go_on(
            self.stream.followed_vehicle.name, bool(self._shed), at_end
        ):
            self._log(fact)
        findings, judgement = self.judged
        for fact in self.gain_adviser.facts[-1:]:
            if judgement is not None and fact.code is Gains.GAINS_WRITTEN:
                self.judged = findings, replace(judgement, next_step=fact.figures["because"])

    def end(self) -> None:
        """Restores the vehicle's rates, which it must confirm, and ends the recording."""
        if self.request is not None:
            self._restore_rates(self.request)
        if self.recording is not None:
            try:
                self.recording.close()
            except OSError as error:
                self.recording = None
                self._log(failure_fact(LinkFact.STREAM_RECORDING_ENDED, error, finishing=True))

    @property
    def status(self) -> SessionStatus:
        """The status as of now."""
        status = self.stream.status()
        silence = self._silence()
        learning = None
        if not (self._settled and status.is_flying):
            learning = Fact(Session.NOT_SETTLED if status.is_flying else Session.NOT_FLYING)
        elif self.learner is not None:
            learning = self.learner.obstacle
        rates = dict.fromkeys(status.rates, 0.0) if silence else status.rates
        latency = status.latency
        if self._latencies:
            median, p99 = np.percentile(self._latencies, [50, 99]).tolist()
            latency = Latency(median, p99, self._largest)
        watched = status.watch_facts
        if silence:
            watched = tuple(not_watched(fact, silence, self.stream.now) for fact in watched)
        behind = time.monotonic() - self.now
        rows = replace(
            status,
            findings=self.judged[0],
            model_judgement=self.judged[1],
            learned_rows=self._learned,
            unlearned_rows=self._shown,
            latency=latency,
            obstacle=silence or status.obstacle or learning,
            rates=rates,
            watch_facts=watched,
            analysis_delay=behind if behind >= SHED[Task.REFITS] else 0.0,
        )
        return rows if self._estimate is None else rows.with_predictions(self._estimate)

    def _silence(self) -> Fact | None:
        """What a silent link lacks; None if it is not silent."""
        since = self.now - SILENCE_SECONDS
        if self._lost:
            return Fact(LinkFact.CONNECTION_LOST, cause=None, reopening=False)
        if self._heard < since:
            return Fact(Rows.NOTHING_RECEIVED, subject=Missing.MESSAGES, duration=SILENCE_SECONDS)
        if self._samples and self._sampled < since:
            return Fact(Rows.NOTHING_RECEIVED, subject=Missing.MOTION, duration=SILENCE_SECONDS)
        return None

    def _receive(self, timeout: float) -> list[Piece]:
        """Receives and records; opens a lost link again."""
        began = time.monotonic()
        try:
            if self._lost:
                if not self.link.reopen():
                    time.sleep(min(timeout, 0.1))
                    return []
                self._lost = False
                self._log(Fact(LinkFact.LINK_OPEN_AGAIN))
            received = self.link.receive(timeout)
        except LinkLost as error:
            self._lost = True
            self._log(error.fact.but(reopening=True))
            return []
        pieces = [(stamp, self.stream.frame_reader.feed(data)) for stamp, data in received]
        try:
            for stamp, frames in pieces if self.recording is not None else ():
                self.recording.take(stamp, frames)
        except OSError as error:
            self.recording = None
            self._log(failure_fact(LinkFact.STREAM_RECORDING_ENDED, error))
        now = time.monotonic()
        wall = time.time()
        first = self._emptied
        self._emptied = began if len(received) < MAX_PIECES else first
        # The wall clock may be set meanwhile: nothing arrived before everything had been read.
        return [
            Piece(min(max(now - wall + stamp, first), now), stamp, frames)
            for stamp, frames in pieces
        ]

    def _take(self, row: AlignedRow) -> None:
        setup = self.stream.row_format
        assert setup is not None
        if setup is not self._setup:
            self._begin(setup)
        learner = self.learner
        estimate = None
        assert learner is not None
        self._settled = row.free
        if row.free and Task.ESTIMATES not in self._shed:
            learner.follows_torque = row.settled
            weak = self.stream.motor_alarms.weak_motors(row.inputs, setup.scale.low)
            try:
                estimate = learner.update(row.time, row.outputs, row.inputs, weak)
            except ValueError as error:
                self._log(failure_fact(Session.SAMPLE_SKIPPED, error))
            newest = learner.learned
            # Of the way up no model is kept, nor is one written at the end.
            self._kept |= row.settled
            self._rising = self._rising if row.settled else newest
            if newest is not None and newest not in (self._newest, self._rising):
                self._newest = newest
                self._landed = False
                self._models.append((row.time, newest))
        latency = time.monotonic() - self._arrival
        self._latencies.append(latency)
        self._largest = max(self._largest, latency)
        if estimate is None:
            self._shown += 1
        else:
            self._learned += 1
            if estimate.unusual and not (self._estimate and self._estimate.unusual):
                self._log(Fact(Session.MOTION_UNEXPECTED, clock=estimate.seen))
            self._estimate = estimate
            for gust in self._gusts.take(estimate):
                self._log(gust)
        self.history.advance(row.time, setup.boot)
        wind = self.stream.wind.row
        speed, _, high = (np.nan,) * 3 if wind is None else wind.by_compass[:3]
        beside = speed, high - speed, *setup.scale.fraction(row.inputs)
        self.history.add_row(row.segment, row.time, row.outputs, estimate, beside)
        self._put(row, estimate=estimate, learned=learner.learned, wind=wind)

    def _put(self, row: AlignedRow, **latest: Any) -> None:
        """Shows a row, with the ``latest`` estimate, model and wind."""
        if self._display is not None:
            sample = row.time, self.history.timeline_offset, row.segment, row.outputs, row.inputs
            self._display.put(DisplayRow(*sample, **latest, pose=self.stream.pose))

    def _begin(self, setup: RowFormat) -> None:
        """Takes the learner of a setup's rows, and shows them."""
        before = self._setup
        if before is not None and setup.boot != before.boot:
            self._models = deque(((-np.inf, learned) for _, learned in self._models), MAX_MODELS)
        self._setup = setup
        layout = setup.layout
        axis = self.stream.axis
        self.history.motor_names = layout.names
        if before is None or (before.dt, before.layout.names) != (setup.dt, layout.names):
            prior = self.prior
            if prior is not None and prior.record.input_units != setup.units:
                prior = None
                self._log(Fact(Session.PRIOR_NOT_USED))
            self.learner = OnlineLearner(
                self.settings,
                setup.dt,
                len(layout.names),
                len(output_names_and_units(axis)),
                executor=self.executor,
                horizons=horizon_steps(setup.dt),
                effect_directions=None if layout.positions_assumed else layout.mixer_row(axis),
                prior=None if prior is None else prior.physical,
            )
            self._gusts = LiveGusts(setup.dt)
            self._estimate = None
        self._open(setup)

    def _open(self, setup: RowFormat) -> None:
        """Shows the rows of a ``setup`` from now on; a display that fails is not used again."""
        before = self._display
        try:
            self._display = self.open_display(setup)
        except Exception as error:
            self._display = None
            self.open_display = lambda setup: None
            self._log(failure_fact(Session.DISPLAY_FAILED, error))
        if before is None and self._display is not None:
            for event in self.history.events:
                self._display.log(event)

    def _preview(self) -> None:
        """Shows the latest sample while there are no rows: what is wrong must not wait for them."""
        latest = self.stream.latest_row()
        if latest is None:
            return
        setup, row = latest
        if self._display is None:
            self._open(setup)
        # Not of inputs that are others than those that are shown.
        is_alike = self._setup is None or self._setup.layout.names == setup.layout.names
        if is_alike:
            self._put(row)

    def _take_back(self, learner: OnlineLearner, since: float) -> None:
        """Takes back what was learned from ``since``, s of the boot clock, on: it was of a landing."""
        learner.forget_since(since)
        while self._models and self._models[-1][0] > since:
            self._models.pop()
        self._landed = True

    def _named(self, learned: Learned) -> Learned:
        """The model with names and units of the latest rows and what they identify, where it has their inputs."""
        setup = self._setup
        if setup is None or learned.record.inputs.shape[1] != len(setup.layout.names):
            return learned
        names, units = zip(*output_names_and_units(self.stream.axis), strict=True)
        parameters = self.stream.parameters.items()
        gains = {name: value for name, value in parameters if CONTROL_PARAMETERS.match(name)}
        record = replace(
            learned.record,
            input_names=setup.layout.names,
            output_names=names,
            input_units=setup.units,
            output_units=units,
            parameters=gains,
            input_range=(setup.scale.low, setup.scale.high),
        )
        named = replace(learned, record=record)
        physical = None if self._estimate is None else self._estimate.physical
        return named if physical is None else named.with_physical(physical)

    def _judge(self, now: float) -> None:
        """Takes the findings; judges the latest model again now and then, by the executor."""
        if self._judging is not None:
            if self._judging.done():
                with suppress(ValueError, RuntimeError, CancelledError):
                    self.judged = self._judging.result()
                self._judging = None
        elif (
            self.executor is not None
            and self._newest is not None
            and self._setup is not None
            and self._estimate is not None
            and self._estimate.physical is not None
            and now >= self._next_judging
            and Task.PHYSICAL_FITS not in self._shed
        ):
            self._next_judging = now + JUDGING_SECONDS
            named = self._named(self._newest)
            if named.record.input_names != self._setup.layout.names:
                return
            with suppress(RuntimeError):  # the executor's processes are gone
                alarms = self.stream.status().motor_alarms
                self._judging = self.executor.submit(
                    judged, named, self._setup, alarms, self.recording_name
                )

    def _request_rates(self) -> None:
        """Asks for rates if the user wants that and the vehicle is known; sends a HEARTBEAT if needed before."""
        now = self.now
        if self.requested_rate is None or self._lost or self._shed:
            self._arrivals = Arrivals()  # what comes now would be as fast as the analysis
            return
        if self.link.speaks_first and now - max(self._heard, self._greeted) >= PAUSE_SECONDS:
            self._greeted = now
            self._send([greeting()])
        vehicle = self.stream.followed_vehicle
        if vehicle is None or now - self._heard > SILENCE_SECONDS:
            return
        if self.request is None:
            kind = vehicle.autopilot
            named = (*motor_parameters(kind), *control_parameters(kind))
            sender = FrameSender(vehicle.system, vehicle.component)
            self.request = RateRequest(sender, self.requested_rate, parameters=named)
        for message in self.stream.drain_replies():
            self.request.take(message)
        rates = self._arrivals.rates(now, vehicle.arrived)
        self._send(self.request.due(now, rates, vehicle.parameters))
        while self.request.events:
            self._log(self.request.events.pop(0))

    def _restore_rates(self, request: RateRequest) -> None:
        for _ in range(0 if self._lost else MAX_TRIES):
            frames = request.restore()
            if not frames:
                return
            self._send(frames)
            until = time.monotonic() + PAUSE_SECONDS
            while request.unconfirmed and not self._lost and (left := until - time.monotonic()) > 0:
                for piece in self._receive(min(left, 0.05)):
                    if time.monotonic() < until:
                        deque(self.stream.take_frames(piece.stamp, piece.frames), maxlen=0)
                for message in self.stream.drain_replies():
                    request.take(message)
        if request.restore():
            self._log(Fact(RateFact.RATES_NOT_RESTORED))

    def _send(self, frames: list[bytes]) -> None:
        try:
            for frame in frames:
                self.link.send(frame)
        except LinkLost as error:
            self._log(error.fact)

    def _log(self, fact: Fact) -> None:
        now = time.monotonic()
        figures = fact.figures
        about = (
            figures["because"] if fact.code is Watch.OTHER_VEHICLE_ALARM else figures.get("text")
        )
        kind = fact.code, fact.subject, about
        self._last_said = {
            before: at for before, at in self._last_said.items() if now - at < REPEAT_SECONDS
        }
        if kind in self._last_said and fact.time is None:
            return  # but each alarm and each recovery is reported
        self._last_said[kind] = now
        self.report_fact(fact)
        since = np.nan if fact.time is None else fact.time + self.history.timeline_offset
        if self.stream.motor_alarms.changed == fact.time:
            self.history.clear_wind_torque(since)
        self.history.events.append(Event(self.history.now, fact, since))
        if self._display is not None:
            self._display.log(self.history.events[-1])
