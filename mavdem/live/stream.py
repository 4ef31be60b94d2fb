"""LiveStream: from the bytes of a link to aligned rows of one vehicle, and facts on what happens to them."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import inf, isnan, nan
from typing import NamedTuple

import numpy as np

from mavdem.containers import Numbers
from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.learnability import slow_streams
from mavdem.dataset.phases import AVERAGING_SECONDS, MAX_TILT
from mavdem.dataset.segments import STEP_TOLERANCE
from mavdem.dataset.setpoints import MAX_SETPOINT_AGE, SETPOINT_MESSAGE
from mavdem.dataset.signals import MIN_STREAM_RATE
from mavdem.dataset.steady_flight import strays_from_setpoint
from mavdem.dataset.time_series import preferred_message
from mavdem.facts import Fact, Facts
from mavdem.facts.event import Event
from mavdem.facts.events import Reported
from mavdem.facts.motors import InFlight
from mavdem.facts.session import Rows, Session, VehicleFact
from mavdem.facts.watch import Watch, Watched
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES
from mavdem.ingest.mavlink.vehicles import PARAMETER_STORE_COMPONENT
from mavdem.ingest.motors import MOTOR_MESSAGES, POSSIBLE_MULTIROTORS
from mavdem.ingest.telemetry import Parameters, Telemetry
from mavdem.live.decisions import (
    PHASES,
    InputChoice,
    Inputs,
    Phase,
    RecentMotion,
    RowFormat,
    tilt_of,
)
from mavdem.live.messages import (
    OF_ITSELF,
    Frame,
    FrameReader,
    Message,
    attitude,
    attitude_asked,
    message_of,
    outputs,
    parameters_of,
)
from mavdem.live.motor_alarms import MotorAlarms
from mavdem.live.recent_messages import MAX_EVENTS, RecentMessages
from mavdem.live.rows import DECISION_SECONDS, AlignedRow, BootClock, Grid, PlacedMessage, Samples
from mavdem.live.session_status import SessionStatus
from mavdem.live.vehicle_selection import Component, VehicleSelector
from mavdem.live.watchdog import Watchdog
from mavdem.live.wind import LiveWind
from mavdem.wind_velocity.from_log import ESTIMATOR_FLAG_MESSAGES, VELOCITY_MESSAGES
from mavdem.wind_velocity.vehicle_drag import Drag

REVIEW_SECONDS = 0.5  # Of the boot clock, between two reviews of phase and inputs
REPLIES = ("MESSAGE_INTERVAL", "COMMAND_ACK")  # What a vehicle sends when it is asked for rates
MAX_PORTS = 4  # Of a message of outputs that are read; PX4 has two
RATE_CHECK_SAMPLES = 8  # Samples of a stream between two checks of its rate


OF_ANY_VEHICLE = Session.ALARM, Watch.ALARM_OVER, InFlight.MOTOR_RECOVERED
"""What is reported of vehicles that are not followed, beside what their autopilots say."""


class LatestPose(NamedTuple):
    """The latest attitude that came, at ``time``, s of the boot clock."""

    time: float
    angles: Numbers  # roll, pitch and yaw, rad
    rates: Numbers  # of the body, rad/s
    asked: Numbers  # roll and pitch, rad; NaN where not known


class LiveStream:
    """Turns the bytes of a link into rows. No threads, no sockets, no clock of its own.

    The rows depend on the bytes alone, not on how they are cut into pieces nor on when they come. The arguments are as
    for :func:`mavdem.read_flight`; without a ``vehicle`` it is the only multirotor that sends attitude. If the vehicle
    is asked for rates (``rates_requested``) already, no fact advises it.

    Raises ValueError: unknown axis.
    """

    def __init__(
        self,
        axis: str = "roll",
        vehicle: str | None = None,
        rates_requested: bool = False,
    ) -> None:
        if axis not in TILT_AXES:
            raise ValueError(f"axis must be one of {', '.join(TILT_AXES)}, not {axis!r}")
        self.row_format: RowFormat | None = None  # what the rows of the latest segment are
        # of the vehicle: samples of attitude and motor outputs, and its boot's number
        self.sample_count = self.boot = 0
        self.axis = axis
        self._can_ask = not rates_requested
        self.frame_reader = FrameReader()  # in the bytes of the link
        self._senders = VehicleSelector(vehicle, self._report)
        self._clock = BootClock(self._report)
        self._events: deque[Event] = deque(maxlen=MAX_EVENTS)
        self._replies: deque[Message] = deque(maxlen=MAX_EVENTS)
        # by message and port, which attitude has none of: 0
        self._streams: dict[tuple[str, int], Samples] = {}
        self._choice = InputChoice()
        self._recent = RecentMessages()
        self._phase = Phase(self._recent)
        self._settings: Parameters = {}  # of the autopilot, as of the last choice
        self._grid = Grid()
        self.motor_alarms = MotorAlarms()
        self.wind = LiveWind()
        self._watchdog = Watchdog(self._recent)
        self.other_vehicles: dict[str, LiveStream] = {}  # of other vehicles, by name: watched, too
        self._attitude: str | None = None
        self._heading = 0.0
        self.pose: LatestPose | None = None
        # The time, s, and roll and pitch of the latest setpoint
        self._asked: tuple[float, Numbers] = -inf, ()
        self._inputs: Inputs | None = None
        self._reviewed = self._went_on = -inf
        self._reviewing: Iterator[None] = iter(())  # the rest of the review that has begun
        self._connected_from = inf
        self._received = 0.0
        self._obstacle: Fact | None = Fact(Rows.RATES_BEING_MEASURED)
        self._enough = True

    @property
    def followed_vehicle(self) -> Component | None:
        """The vehicle; None before it is known."""
        return self._senders.followed

    @property
    def now(self) -> float:
        """The latest time of the vehicle's clock, s; NaN before any."""
        return self._clock.now

    @property
    def parameters(self) -> Parameters:
        """The vehicle's parameters received so far, by name; also those that MAVProxy stores for it."""
        if self.followed_vehicle is None:
            return {}
        store = self._senders.by_ids.get((self.followed_vehicle.system, PARAMETER_STORE_COMPONENT))
        sent = {**(store.parameters if store else {}), **self.followed_vehicle.parameters}
        return parameters_of(sent.values(), self.followed_vehicle.autopilot) if sent else {}

    def feed(self, stamp: float, data: bytes) -> list[AlignedRow]:
        """Takes the next ``data`` of the link, received at ``stamp``, UNIX s; returns the rows that it completes."""
        return list(self.take_frames(stamp, self.frame_reader.feed(data)))

    def take_frames(self, stamp: float, frames: Sequence[Frame]) -> Iterator[AlignedRow]:
        """Takes the next ``frames`` of the link, received at ``stamp``, UNIX s; yields each row once it is complete."""
        self._received = stamp
        for frame in frames:
            yield from self._take(frame)
            sender = self._senders.of(frame)
            if sender is not self.followed_vehicle and sender.name in self._senders.rivals:
                self._watch_too(sender.name, frame)

    def _watch_too(self, name: str, frame: Frame) -> None:
        """Gives a frame to the stream of another vehicle, whose alarms are reported under its ``name``."""
        if name not in self.other_vehicles:
            self.other_vehicles[name] = LiveStream(self.axis, name, rates_requested=True)
        other = self.other_vehicles[name]
        other._received = self._received
        deque(other._take(frame), maxlen=0)
        for event in other.drain_events():
            fact = event.fact
            warns = isinstance(fact.code, Reported) and not fact.is_good
            if warns or fact.code in OF_ANY_VEHICLE:
                self._report(
                    Fact(Watch.OTHER_VEHICLE_ALARM, fact.level, subject=name, because=fact)
                )

    def pop_landing_time(self) -> float | None:
        """Returns the time, s of this boot, since when rows given as settled were of a landing; None if none is new."""
        return self._phase.landing()

    def drain_replies(self) -> list[Message]:
        """Returns the vehicle's messages of ``REPLIES`` since the last call."""
        return [self._replies.popleft() for _ in range(len(self._replies))]

    def drain_events(self) -> list[Event]:
        """Returns the events since the last call."""
        return [self._events.popleft() for _ in range(len(self._events))]

    def status(self) -> SessionStatus:
        """Returns the status of the link and the vehicle."""
        followed = self.followed_vehicle
        now = self._clock.now
        return SessionStatus(
            vehicle=followed.name if followed else None,
            obstacle=self._senders.obstacle
            or (self._no_attitude if isnan(now) else self._obstacle),
            rates=self._rates(now),
            is_flying=self._phase.flying,
            lost_messages=followed.lost if followed else 0,
            gap_seconds=followed.missing_seconds if followed else 0.0,
            late_samples=sum(stream.late for stream in self._streams.values()),
            undecoded_frames=self.frame_reader.unread,
            motor_alarms=tuple(self.motor_alarms.latest),
            active_alarms=(*self._watchdog.alarms, *self.motor_alarms.standing),
            watch_facts=self.watch_facts,
            worst_lights=dict(self._watchdog.lights),
            wind=self.wind.row,
            mean_wind=self.wind.mean,
            wind_obstacle=self.wind.obstacle,
        )

    @property
    def watch_facts(self) -> Facts:
        """Since when each is watched, or why it is not, of all vehicles."""
        others = ((name, each.watch_facts) for name, each in self.other_vehicles.items())
        return (
            *self._watchdog.watched.values(),
            *(fact.but(vehicle=name) for name, facts in others for fact in facts),
        )

    def _rates(self, now: float) -> dict[str, float]:
        """Hz of each message of attitude, outputs and demand; of several ports the fastest."""
        rates = sorted((each.rate(now), name) for (name, _), each in self._streams.items())
        return {name: rate for rate, name in rates}

    def _take(self, frame: Frame) -> Iterator[AlignedRow]:
        """Takes a frame; the rows that it completes."""
        sender = self._senders.of(frame)
        message = message_of(frame) if frame.checksum == CHECKSUM_MATCHES else None
        if not sender.take(frame, self._received) or frame.checksum != CHECKSUM_MATCHES:
            return
        if message is not None:
            sender.take_message(message)
            if message.name in OF_ITSELF:
                message = message._replace(stamp=0.0)  # some have another clock's
        self._senders.decide(sender)
        if sender is not self._senders.followed or message is None:
            return
        if message.name in REPLIES:
            self._replies.append(message)
            return
        placed = self._clock.place(message)
        if placed is not None:
            if placed.boot != self.boot:
                self._reboot(placed.boot)
            yield from self._process(sender, placed)

    def _process(self, sender: Component, placed: PlacedMessage) -> Iterator[AlignedRow]:
        message = placed.message
        time = placed.time
        name = placed.message.name
        if name in ATTITUDE_MESSAGES and placed.stamped:
            motion = attitude(message)
            if motion is not None and name == self._attitude and self._phase.free(time):
                self.wind.attitude(time, (*motion[:2], motion[-1]))
            if motion is not None:
                self._look(time, motion)
            yield from self._add(name, 0, time, motion and motion[:4])
        elif name == SETPOINT_MESSAGE and placed.stamped:
            self._asked = time, attitude_asked(message)
        elif name in MOTOR_MESSAGES and placed.stamped:
            port, values = outputs(message)
            if port < MAX_PORTS:
                yield from self._add(name, port, time, values)
        elif name in ESTIMATOR_FLAG_MESSAGES:
            self.wind.flags = message.values[0]
        elif name in VELOCITY_MESSAGES and (wind := self.wind.velocity(name, time, message.values)):
            self._report(wind)
        if name in OF_ITSELF or name in PHASES:
            self._recent.take(name, time, message.values)
        now = self._clock.now
        due = now // REVIEW_SECONDS != self._reviewed // REVIEW_SECONDS
        if due:
            deque(self._reviewing, maxlen=0)
            self._reviewing = self._review(sender, now)
        # No row waits for all parts.
        if due or now - self._went_on >= REVIEW_SECONDS / 10:
            self._went_on = now
            next(self._reviewing, None)
        if self._grid.running and not self._phase.carries:
            self._grid.end()

    def _add(
        self, name: str, port: int, time: float, values: Numbers | None
    ) -> Iterator[AlignedRow]:
        """Adds a sample to its stream; the rows that it completes."""
        stream = self._streams.setdefault((name, port), Samples())
        if values is None or not stream.add(time, values):
            return
        self.sample_count += 1
        inputs = self._inputs
        streams = self._row_streams()
        if inputs is None or stream not in streams:
            return
        if stream is streams[1]:
            self._watch_motors(time, inputs)
        if self._grid.running:
            if stream.gap:
                self._report(Fact(Rows.MESSAGE_GAP, subject=name, duration=stream.gap))
                self._grid.end()
            elif (
                stream.added % RATE_CHECK_SAMPLES == 0
                and (before := self._grid.former_rate(stream)) is not None
            ):
                self._report(Fact(Rows.RATE_CHANGED, subject=name, former_rate=before))
                self._grid.end(forget_step=True)
                for changed in streams:
                    changed.break_off()
        if not self._grid.running and self._phase.carries and self._grid.begin(streams):
            self._begin(inputs)
        if self._grid.running:
            yield from [self._row(time, point, inputs) for time, point in self._grid.points()]

    def _row_streams(self) -> tuple[Samples, ...]:
        """The streams that rows are made of, attitude first; none before they are chosen."""
        if self._inputs is None or self._attitude is None:
            return ()
        message = self._inputs.motors.message
        keys = [(self._attitude, 0), *((message, port) for port in self._inputs.ports)]
        return tuple(self._streams.setdefault(key, Samples()) for key in keys)

    def _row(self, time: float, point: list[Numbers], inputs: Inputs) -> AlignedRow:
        motion = point[0]
        axis = TILT_AXES.index(self.axis)
        ports = dict(zip(inputs.ports, point[1:], strict=True))
        upright = max(abs(motion[0]), abs(motion[1])) < MAX_TILT
        row = np.array([ports[port][channel] for port, channel in inputs.picks])
        moved = np.array([motion[axis], motion[2 + axis]])
        settled = upright and self._phase.settled(time)
        free = upright and self._phase.free(time)
        return AlignedRow(time, row, moved, self._grid.segment, settled, free)

    def _begin(self, inputs: Inputs) -> None:
        """Reports the segment that begins, if its rows are others than before."""
        grid = self._grid
        before = self.row_format
        plan = inputs.motors.geometry
        assert grid.dt is not None and self._attitude is not None
        names = self._attitude, inputs.motors.message
        self.row_format = now = RowFormat(
            self.boot, grid.dt, *names, plan, inputs.motors.scale, grid.rates, grid.start
        )
        if before is not None and (before.dt, before.motors, before.layout) == (
            now.dt,
            now.motors,
            plan,
        ):
            return
        self._report(Fact(Rows.ROWS_BEGIN, names=names, step=now.dt, inputs=len(plan.names)))
        if plan.assumed:
            self._report(Fact(Rows.MOTOR_ORDER_ASSUMED, basis=plan.basis))

    def _review(self, sender: Component, now: float) -> Iterator[None]:
        """Decides again what rows are made of, whether the vehicle flies, and what alarms there are, part by part."""
        if isnan(now):
            return
        before = self._reviewed
        self._reviewed = now
        if not abs(now - before) < DECISION_SECONDS:
            self._connected_from = now
        connected = now - self._connected_from
        if not self._grid.running:
            counts = {name: stream.count(now) for (name, _), stream in self._streams.items()}
            counts = {name: counts[name] for name in ATTITUDE_MESSAGES if name in counts}
            self._attitude = preferred_message(counts) or self._attitude
        yield from self._choose_inputs(sender)
        yield
        if connected >= DECISION_SECONDS:
            self._judge(sender, now)
        if self._inputs is None and connected >= AVERAGING_SECONDS / 2:
            self._phase.idle = any(name not in ATTITUDE_MESSAGES for name, _ in self._streams)
        vehicle = self._telemetry(sender)
        collective = None if self._inputs is None else self._inputs.collective
        flew = self._phase.flying
        self._phase.review(now, vehicle, collective)
        if self._phase.flying and not flew:
            self.wind.restart()
        yield
        motion = self._motion()
        yield
        phase = self._phase.flying, self._phase.settled_since(now)
        for fact in self._watchdog.review(now, vehicle, *phase, motion):
            if fact is None:
                yield
            else:
                self._report(fact)
        because = self.motor_alarms.obstacle(now, self._phase.flying)
        self._watchdog.watches(Watched.MOTORS, because, now)

    def _choose_inputs(self, sender: Component) -> Iterator[None]:
        """Chooses the inputs again, by the rates of messages and by what moves, in two parts."""
        if sender.kind not in POSSIBLE_MULTIROTORS:
            self._inputs = None
            return
        self._settings = parameters = self.parameters
        self.wind.set_drag = Drag.from_parameters(sender.autopilot, parameters)
        before = self._inputs
        staying = before.motors.message if self._grid.running and before else None
        shown = self._choice.shown(self._streams, staying)
        yield
        running = self._grid.running
        inputs = self._choice.choose(shown, self._telemetry(sender), self._clock.now)
        if inputs is None:
            return  # after a silence there is no evidence of a change
        self._inputs = inputs
        layout = inputs.motors.geometry
        if before is not None and running and inputs.key != before.key:
            self._report(Fact(Rows.INPUTS_CHANGED, names=layout.names))
            self._grid.end(forget_step=True)
        elif running and self.row_format is not None and layout != self.row_format.layout:
            self.row_format = replace(self.row_format, layout=layout)
            if not layout.assumed:
                self._report(Fact(Rows.MOTOR_ORDER_KNOWN, basis=layout.basis))

    def _telemetry(self, sender: Component) -> Telemetry:
        """What is known of the vehicle beside its messages."""
        ids = sender.system, sender.component
        return Telemetry(*ids, sender.kind, sender.autopilot, {}, self._settings)

    def _motion(self) -> RecentMotion | None:
        """The last seconds of attitude and motors; None without."""
        attitude, *_ = self._row_streams() or [Samples()]
        if self._inputs is None or not attitude.time:
            return None
        roll, pitch, p, q = np.array(attitude.values).T
        motion = self._attitude or "", np.array(attitude.time), self.boot
        tilts = tilt_of(*motion, roll, p), tilt_of(*motion, pitch, q)
        return RecentMotion(self._inputs.motors, dict(zip(TILT_AXES, tilts, strict=True)))

    def latest_row(self) -> tuple[RowFormat, AlignedRow] | None:
        """Returns the latest sample of attitude and motors as a row of its own setup; None once there are rows."""
        motion = self._motion()
        if motion is None or self._grid.running or not motion.rate:
            return None
        motors = motion.motors
        tilt = motion.tilts[self.axis]
        names = tilt.message, motors.message
        time = tilt.time[-1]
        rates = (motion.rate,) * 2
        setup = RowFormat(
            self.boot, 1 / motion.rate, *names, motors.geometry, motors.scale, rates, time
        )
        outputs = np.array([tilt.angle[-1], tilt.rate[-1]])
        row = AlignedRow(time, motors.outputs[-1], outputs, self._grid.segment, False, False)
        return setup, row

    def _judge(self, sender: Component, now: float) -> None:
        """Reports when messages are missing or too slow, and when they no longer are."""
        heard = self._rates(now)
        outputs = {name: rate for name, rate in heard.items() if name not in ATTITUDE_MESSAGES}
        drives = (
            self._inputs.motors.message
            if self._inputs
            else max(outputs, key=outputs.__getitem__, default=None)
        )
        obstacle: Fact | None
        if sender.kind not in POSSIBLE_MULTIROTORS:
            obstacle = Fact(VehicleFact.NOT_A_MULTIROTOR, vehicle_type=sender.kind, axis=self.axis)
        elif self._attitude is None:
            obstacle = self._no_attitude
        elif drives is None:
            obstacle = Fact(Rows.NO_LIVE_MOTORS)
        else:
            rates = {name: heard[name] for name in (self._attitude, drives)}
            # With hysteresis: a rate at the limit must not be reported twice a second.
            least = MIN_STREAM_RATE / STEP_TOLERANCE if self._enough else MIN_STREAM_RATE
            slow = slow_streams(rates, self.axis) if min(rates.values()) < least else None
            obstacle = slow and Fact(Rows.LIVE_RATES_TOO_LOW, can_ask=self._can_ask, because=slow)
        if obstacle is not None and self._enough:
            self._report(obstacle)
        elif obstacle is None and not self._enough:
            self._report(Fact(Rows.LIVE_RATES_ENOUGH))
        self._enough = obstacle is None
        self._obstacle = obstacle or self._phase.obstacle

    def _look(self, time: float, motion: Numbers) -> None:
        """Where the nose points by an attitude, unless roll and pitch stray from the setpoint that holds."""
        *tilts, p, q, r, self._heading = motion
        since, asked = self._asked
        is_asked = abs(time - since) <= MAX_SETPOINT_AGE
        angles = (*tilts, self._heading)
        self.pose = LatestPose(time, angles, (p, q, r), asked if is_asked else (nan, nan))
        strayed = is_asked and strays_from_setpoint(np.array(tilts), np.array(asked))
        if strayed or max(map(abs, tilts)) >= MAX_TILT:
            self._heading = nan

    def _watch_motors(self, time: float, inputs: Inputs) -> None:
        """Tests a sample of the motors for a lasting change, which is reported, as is why none would be seen."""
        name = inputs.motors.message
        ports = {port: self._streams[name, port].values[-1:] for port in inputs.ports}
        if not self._phase.settled(time):
            self.motor_alarms.landed |= not self._phase.flying
        elif all(ports.values()):
            sent = np.array([ports[port][0][channel] for port, channel in inputs.picks])
            motors = inputs.motors
            shares = motors.scale.fraction(sent).tolist()
            for fact in self.motor_alarms.take(time, self.boot, motors, shares, self._heading):
                self._report(fact)

    def _reboot(self, boot: int) -> None:
        """Drops everything on the old clock; the vehicle's identity and parameters stay."""
        self.boot = boot
        self._streams.clear()
        self._choice = InputChoice(boot)
        self.wind.restart()
        self._attitude = None
        self._inputs = None
        self._asked = -inf, ()
        self._recent = RecentMessages(boot)
        self._phase = Phase(self._recent)
        self.motor_alarms.standing = ()
        self.motor_alarms.changed = nan
        self._watchdog = Watchdog(self._recent)
        self._grid.restart()
        self._reviewing = iter(())
        self._reviewed = self._went_on = -inf
        self._connected_from = inf

    @property
    def _no_attitude(self) -> Fact:
        return Fact(
            Rows.NO_LIVE_ATTITUDE if self._can_ask else Rows.ATTITUDE_ASKED, can_ask=self._can_ask
        )

    def _report(self, fact: Fact) -> None:
        self._events.append(Event(self._received, fact))
