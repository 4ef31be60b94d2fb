"""LiveStream: from the bytes of a link to aligned rows of one vehicle."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from math import inf, isnan

import numpy as np

from mavdem.alignment.align import STEP_TOLERANCE
from mavdem.alignment.drive import DEMAND_MESSAGE, MOTOR_MESSAGES, TILT_AXES, preferred_message
from mavdem.alignment.phases import AVERAGING_SECONDS, MAX_TILT, airborne_collective
from mavdem.alignment.signals import ATTITUDE_MESSAGES, CLIMB_FIELDS, MINIMUM_RATE
from mavdem.alignment.verdict import NO_ATTITUDE, too_slow
from mavdem.health.motor_watch import MotorAlarm, MotorWatch
from mavdem.ingest.mavlink.definitions import FrameSender, enum_name
from mavdem.ingest.mavlink.framing import GOOD
from mavdem.ingest.mavlink.vehicles import PARAMETER_STORE
from mavdem.ingest.motors import MULTIROTORS, MotorGeometry, OutputScale
from mavdem.ingest.vocabulary import UNNAMED
from mavdem.live.aligner import DECISION_SECONDS, AlignedRow, Aligner, Setup
from mavdem.live.clock import LiveClock, LiveStamp
from mavdem.live.frames import LiveFrame, LiveFrames
from mavdem.live.history import Event, SessionStatus
from mavdem.live.messages import LiveMessage, Values, attitude, message_of, parameters_of, readers
from mavdem.live.outputs import Drive, Outputs
from mavdem.live.phase import LivePhase
from mavdem.live.samples import SampleBuffer
from mavdem.live.senders import Sender, Senders

MAX_EVENTS = 256  # Events kept until they are fetched
REVIEW_SECONDS = 0.5  # Of the boot clock, between two reviews of messages, rates and layout
REPLIES = ("MESSAGE_INTERVAL", "COMMAND_ACK")  # What a vehicle sends when it is asked for rates
MAX_REPLIES = 64  # Replies kept until they are fetched
MIN_JUDGED, CONTRADICTING_SHARE = 64, 0.2  # Messages whose stamps are judged together, and outliers among them
RATE_CHECK_SAMPLES = 8  # Samples of a stream between two checks of its rate
ONLY_DEMAND = "The inputs are the demand and not the motors, so that a weak motor would not be seen."
NO_EVIDENCE = "There is no EXTENDED_SYS_STATE and no vertical speed: motors and flight mode alone show a landing."
ADVICE = " Ask for more with `--request-rate 100`."


class LiveStream:
    """Turns the bytes of a link into rows. No threads, no sockets, no clock of its own.

    The rows depend on the bytes alone, not on how they are cut into pieces nor on when they come. The arguments are as
    for :func:`mavdem.read_flight`; without a ``vehicle`` it is the only multirotor that sends attitude. If the vehicle
    is ``asked`` for rates already, no sentence advises it.

    Raises:
        ValueError: unknown axis or inputs.

    Attributes:
        setup: what the rows of the latest segment are; None before the first.
        samples: number of samples of the vehicle's attitude and motor outputs.
    """

    def __init__(
        self, axis: str = "roll", vehicle: str | None = None, inputs: str | None = None, asked: bool = False
    ) -> None:
        if axis not in TILT_AXES:
            raise ValueError(f"axis must be one of {', '.join(TILT_AXES)}, not {axis!r}")
        self.setup: Setup | None = None
        self.samples = 0
        self.axis, self._advice = axis, "" if asked else ADVICE
        self._frames, self._senders, self._clock = LiveFrames(), Senders(vehicle, self._report), LiveClock(self._report)
        self._events: deque[Event] = deque(maxlen=MAX_EVENTS)
        self._replies: deque[LiveMessage] = deque(maxlen=MAX_REPLIES)
        self._attitudes = {name: SampleBuffer() for name in ATTITUDE_MESSAGES}
        self._outputs = Outputs(axis, inputs)
        self._phase, self._aligner = LivePhase(), Aligner()
        self._attitude: str | None = None
        self._drive: Drive | None = None
        self._scale: OutputScale | None = None
        self._watch: MotorWatch | None = None
        self._watched: tuple[MotorGeometry, float, float] | None = None  # Balances on two ranges differ
        self._alarms: deque[MotorAlarm] = deque(maxlen=MAX_EVENTS)
        self._alarm_count, self._alarm, self._landed = 0, "", False
        self._unwatched = {""}  # Reasons reported so far
        self._reviewed, self._connected_from, self._known_changes = -inf, inf, -1
        self._boot, self._received, self._said_evidence = 0, 0.0, False
        self._judged, self._judged_from, self._outliers = 0, 0.0, 0  # Messages judged by their stamps since then
        self._contradicts = self._said_contradiction = False
        self._obstacle, self._enough = "The message rates are being measured.", True
        readers()  # slow the first time

    @property
    def parameters(self) -> dict[str, float]:
        """The vehicle's parameters received so far, by name; also those that MAVProxy stores for it."""
        followed = self._senders.followed
        if followed is None:
            return {}
        store = self._senders.get(followed.system, PARAMETER_STORE)
        sent = {**(store.parameters if store else {}), **followed.parameters}
        return parameters_of(sent.values(), followed.autopilot) if sent else {}

    @property
    def followed(self) -> FrameSender | None:
        """The ids of the vehicle; None before it is known."""
        followed = self._senders.followed
        return None if followed is None else FrameSender(followed.system, followed.component)

    @property
    def arrived(self) -> Mapping[int, int]:
        """Number of the vehicle's messages so far, by message id."""
        followed = self._senders.followed
        return {} if followed is None else followed.arrived

    @property
    def boot(self) -> int:
        """Number of the vehicle's boot, from 0 on."""
        return self._boot

    def feed(self, stamp: float, data: bytes) -> list[AlignedRow]:
        """Takes the next ``data`` of the link, received at ``stamp``, UNIX s; returns the rows that it completes."""
        self._received = stamp
        rows: list[AlignedRow] = []
        for frame in self._frames.feed(data):
            self._take(frame, rows)
        return rows

    def replies(self) -> list[LiveMessage]:
        """The vehicle's messages of ``REPLIES`` since the last call."""
        new = list(self._replies)
        self._replies.clear()
        return new

    def taken_back(self) -> float | None:
        """The time, s of this boot, since which rows given as settled were of a landing; None if none is new."""
        return self._phase.taken_back()

    def events(self) -> list[Event]:
        """The events since the last call."""
        new = list(self._events)
        self._events.clear()
        return new

    def status(self) -> SessionStatus:
        """The status of the link and the vehicle."""
        followed, now = self._senders.followed, self._clock.now
        rates = {name: samples.rate(now, DECISION_SECONDS) for name, samples in self._attitudes.items() if samples.time}
        streams = [*self._attitudes.values(), *(bank.samples for bank in (self._drive.banks if self._drive else ()))]
        facts = ("system", "component", "kind", "autopilot", "frames", "lost", "flies")
        return SessionStatus(
            vehicle=followed.name if followed else None,
            obstacle=self._senders.obstacle or (NO_ATTITUDE[""] + self._advice if isnan(now) else self._obstacle),
            rates=rates | self._outputs.rates(now, DECISION_SECONDS),
            flying=self._phase.flying,
            lost=followed.lost if followed else 0,
            late=sum(stream.late for stream in streams),
            outlier_stamps=self._clock.outliers,
            frames=self._frames.frames,
            unread=self._frames.unread,
            garbage=self._frames.garbage,
            senders=tuple({fact: getattr(one, fact) for fact in facts} for one in self._senders),
            others=self._senders.others,
            alarms=tuple(self._alarms),
            alarm_count=self._alarm_count,
            alarm=self._alarm,
        )

    def _take(self, frame: LiveFrame, rows: list[AlignedRow]) -> None:
        sender = self._senders.of(frame)
        if not sender.take(frame) or frame.verdict != GOOD:
            return
        message = message_of(frame)
        if message is not None and message.name == "HEARTBEAT":
            sender.take_heartbeat(message)
        elif message is not None and message.name == "PARAM_VALUE":
            self._outputs.changes += sender.take_parameter(message)
        self._senders.decide(sender)
        if sender is not self._senders.followed or message is None:
            return
        if message.name in REPLIES:
            self._replies.append(message)
            return
        self._check_stamps(sender)
        for placed in self._clock.place(message):
            if placed.boot != self._boot:
                self._reboot(placed.boot)
            self._process(placed, rows)

    def _check_stamps(self, sender: Sender) -> None:
        """Reports, once, stamps that contradict each other for ``DECISION_SECONDS`` and more."""
        self._judged += 1
        if self._judged < MIN_JUDGED or abs(self._received - self._judged_from) < DECISION_SECONDS:
            return
        contradict = self._clock.outliers - self._outliers > CONTRADICTING_SHARE * self._judged
        if contradict and self._contradicts and not self._said_contradiction:
            self._said_contradiction = True
            self._report(
                f"Time stamps of vehicle {sender.name} contradict each other: two vehicles may send with the same ids; "
                "give one another system id."
            )
        self._contradicts = contradict
        self._judged, self._judged_from, self._outliers = 0, self._received, self._clock.outliers

    def _process(self, placed: LiveStamp, rows: list[AlignedRow]) -> None:
        message, time, name = placed.message, placed.time, placed.message.name
        if name in ATTITUDE_MESSAGES and placed.stamped:
            values, samples = attitude(message), self._attitudes[name]
            if values is not None and samples.add(time, values):
                self._complete(samples, rows)
        elif (name in MOTOR_MESSAGES or name == DEMAND_MESSAGE) and placed.stamped:
            stream = self._outputs.take(message, time)
            if stream is not None:
                if self._drive is not None and self._scale is not None and stream is self._drive.banks[0].samples:
                    self._phase.take_collective(time, self._drive.collective(self._scale))
                    self._watch_motors(time, self._drive, self._scale)
                self._complete(stream, rows)
        elif name == "HEARTBEAT":
            followed = self._senders.followed
            assert followed is not None
            kind, autopilot, *state = message.values
            own = enum_name("MAV_TYPE", kind), enum_name("MAV_AUTOPILOT", autopilot)
            # Not of another vehicle with the same ids.
            if own == (followed.kind, followed.autopilot):
                self._phase.take_heartbeat(time, autopilot, *state)
        elif name == "EXTENDED_SYS_STATE":
            self._phase.take_landed_state(time, message.values[0])
        elif name in CLIMB_FIELDS:
            self._phase.take_climb(name, time, CLIMB_FIELDS[name][1] * message.values[0])
        if self._aligner.running and not self._phase.steady:
            self._aligner.end()
        if not abs(self._clock.now - self._reviewed) < REVIEW_SECONDS:
            self._review()

    def _watch_motors(self, time: float, drive: Drive, scale: OutputScale) -> None:
        """Tests a sample of the motors for a lasting change, which is reported, as is why none would be seen."""
        self._landed |= not self._phase.flying
        if not self._phase.settled(time):
            return
        if self._landed:
            self._alarm, self._landed = "", False
        layout, obstacle = drive.layout, ONLY_DEMAND if drive.message == DEMAND_MESSAGE else ""
        if commands := drive.commands(scale):
            watched = layout, scale.low, scale.high
            if self._watch is None or watched != self._watched:
                place = layout.names, layout.motors, layout.positions, layout.spins
                self._watch, self._watched = MotorWatch(*place, layout.positions_assumed, self._boot), watched
            alarm, obstacle = self._watch.take(time, commands, True), self._watch.obstacle
            if alarm is not None:
                self._alarms.append(alarm)
                self._alarm_count += 1
                self._alarm = self._alarm if alarm.motor is None else alarm.sentence
                self._report(alarm.sentence)
        if obstacle not in self._unwatched:
            self._unwatched.add(obstacle)
            self._report(obstacle)

    def _complete(self, samples: SampleBuffer, rows: list[AlignedRow]) -> None:
        """Adds the rows that a new sample completes."""
        self.samples += 1
        if self._drive is None or self._attitude is None:
            return
        streams = (self._attitudes[self._attitude], *(bank.samples for bank in self._drive.banks))
        if samples not in streams:
            return
        if self._aligner.running:
            name = self._drive.message if samples is not streams[0] else self._attitude
            if samples.gap:
                self._report(f"No {name} for {samples.gap:.2f} s: a new segment starts.")
                self._aligner.end()
            elif samples.added % RATE_CHECK_SAMPLES == 0 and (before := self._aligner.former_rate(samples)) is not None:
                self._report(f"{name} no longer comes at {before:.3g} Hz: a new segment starts.")
                self._aligner.forget_step()
                for stream in streams:
                    stream.clear()
        if not self._aligner.running and self._phase.steady and self._aligner.begin(streams):
            self._begin(self._drive, self._attitude)
        if self._aligner.running:
            rows += [self._row(time, values, self._drive) for time, values in self._aligner.points()]

    def _row(self, time: float, values: list[Values], drive: Drive) -> AlignedRow:
        motion, *banks = values
        place = TILT_AXES.index(self.axis)
        upright = max(abs(motion[0]), abs(motion[1])) < MAX_TILT
        return AlignedRow(
            time=time,
            inputs=np.array([banks[bank][at] for bank, at in drive.picks]),
            outputs=np.array([motion[place], motion[2 + place]]),
            segment=self._aligner.segment,
            received=self._received,
            settled=upright and self._phase.settled(time),
        )

    def _begin(self, drive: Drive, motion: str) -> None:
        assert self._aligner.dt is not None
        before, plan = self.setup, drive.layout
        self.setup = now = Setup(
            segment=self._aligner.segment,
            boot=self._boot,
            dt=self._aligner.dt,
            attitude=motion,
            motors=drive.message,
            layout=plan,
            scale=drive.scale(self.parameters),
            rates=self._aligner.rates,
            start=self._aligner.start,
        )
        if before is not None and (before.dt, before.motors, before.layout) == (now.dt, now.motors, plan):
            return
        self._report(
            f"Using {motion} and {drive.message}: one row every {1e3 * now.dt:.4g} ms, {len(plan.names)} inputs."
        )
        if plan.channels_assumed or plan.positions_assumed:
            self._report(f"Which motor is which is assumed: {plan.basis}.")

    def _review(self) -> None:
        """Chooses messages and channels again, by their rates and by what moves."""
        now = self._clock.now
        if isnan(now):
            return
        if not abs(now - self._reviewed) < DECISION_SECONDS:
            self._connected_from = now
        self._reviewed = now
        changes = self._outputs.changes
        if not self._aligner.running:
            counts = {name: samples.count(now, DECISION_SECONDS) for name, samples in self._attitudes.items()}
            self._attitude = preferred_message(counts) or self._attitude
        if not self._aligner.running or changes != self._known_changes:
            self._known_changes = changes
            self._choose_inputs(now)
        waited = now - self._connected_from >= AVERAGING_SECONDS / 2
        if self._drive is None and waited and self._outputs.rates(now, DECISION_SECONDS):
            self._phase.take_idle()
        if now - self._connected_from >= DECISION_SECONDS:
            self._judge(now)
            if self._phase.settled(now) and not self._phase.evident(now) and not self._said_evidence:
                self._said_evidence = True
                self._report(NO_EVIDENCE + self._advice)

    def _choose_inputs(self, now: float) -> None:
        followed = self._senders.followed
        assert followed is not None
        if followed.kind not in (*MULTIROTORS, UNNAMED):
            self._drive = None
            return
        before = self._drive
        staying = before.message if self._aligner.running and before else None
        parameters = self.parameters
        drive = self._outputs.choose(now, DECISION_SECONDS, followed.kind, followed.autopilot, parameters, staying)
        # After a silence there is no evidence of a change.
        self._drive = drive = drive or before
        if drive is None:
            return
        if before is not None and drive.key != before.key and self._aligner.running:
            self._report(f"The inputs change to {', '.join(drive.layout.names)}: a new segment starts.")
            self._aligner.forget_step()
        if self._aligner.running and self.setup is not None and drive.layout != self.setup.layout:
            self.setup = replace(self.setup, layout=drive.layout)
            self._report(f"Which motor is which is known from {drive.layout.basis}.")
        scale = drive.scale(parameters)
        if self._scale is not None and scale.name != self._scale.name:
            self._phase.reset_collective()
        self._scale = scale
        self._phase.least_collective = airborne_collective(parameters)

    def _judge(self, now: float) -> None:
        """Reports when messages are missing or too slow, and when they no longer are."""
        followed = self._senders.followed
        heard = self._outputs.rates(now, DECISION_SECONDS)
        drives = self._drive.message if self._drive else max(heard, key=lambda name: heard[name], default=None)
        obstacle: str | None
        if followed is not None and followed.kind not in (*MULTIROTORS, UNNAMED):
            obstacle = f"The vehicle is a {followed.kind}; the {self.axis} model is for multirotors only."
        elif self._attitude is None:
            obstacle = NO_ATTITUDE[""]
        elif drives is None:
            obstacle = "There is no message with motor outputs."
        else:
            rates = {self._attitude: self._attitudes[self._attitude].rate(now, DECISION_SECONDS), drives: heard[drives]}
            # With hysteresis: a rate at the limit must not be reported twice a second.
            least = MINIMUM_RATE / STEP_TOLERANCE if self._enough else MINIMUM_RATE
            obstacle = too_slow(rates, self.axis) if min(rates.values()) < least else None
            obstacle = None if obstacle is None else obstacle + self._advice
        if obstacle is not None and self._enough:
            self._report(obstacle)
        elif obstacle is None and not self._enough:
            self._report("Attitude and motor outputs come fast enough now.")
        self._enough = obstacle is None
        self._obstacle = obstacle or self._phase.obstacle

    def _reboot(self, boot: int) -> None:
        """Drops everything on the old clock; the vehicle's identity and parameters stay."""
        self._boot = boot
        self._attitudes = {name: SampleBuffer() for name in ATTITUDE_MESSAGES}
        self._outputs.restart()
        self._drive = None
        self._phase = LivePhase()
        self._watch, self._alarm = None, ""
        self._aligner.restart()
        self._reviewed, self._connected_from = -inf, inf

    def _report(self, sentence: str) -> None:
        self._events.append(Event(self._received, sentence))
