"""LiveStream: from the bytes of a link to aligned rows, for one vehicle, while they come."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from math import inf, isnan

import numpy as np

from mavdem.align import MINIMUM_RATE, SLACK
from mavdem.ingest.compose import Sender
from mavdem.ingest.decode import enum_name
from mavdem.ingest.framing import GOOD
from mavdem.ingest.geometry import MULTIROTORS
from mavdem.ingest.live_frames import Frame, LiveFrames
from mavdem.ingest.live_messages import Message, attitude, message_of, parameters_of, prepare
from mavdem.ingest.meaning import ATTITUDE_MESSAGES, AXES, CLIMBS, DEMAND, MOTOR_MESSAGES, fastest
from mavdem.ingest.scale import Scale
from mavdem.ingest.vehicles import PARAMETER_STORE, UNNAMED
from mavdem.live.aligner import DECIDING, Aligner, Point
from mavdem.live.clock import LiveClock, Placed
from mavdem.live.outputs import Drive, Outputs
from mavdem.live.phase import Flying
from mavdem.live.row import Event, Row
from mavdem.live.samples import Samples
from mavdem.live.senders import Senders
from mavdem.live.status import Setup, Status
from mavdem.phases import AVERAGING, UPRIGHT
from mavdem.verdict import too_slow

MOST_EVENTS = 256
"""Events kept until they are fetched; older ones make room."""
REVIEW = 0.5
"""Seconds of the boot clock after which messages, rates and layout are looked at again."""
ANSWERS = ("MESSAGE_INTERVAL", "COMMAND_ACK")
"""What a vehicle says when it is asked for rates."""
MOST_ANSWERS = 64
"""Of them kept until they are fetched."""
RATE_CHECK = 8
"""Samples of a stream after which its rate is compared with what it was."""
NO_ATTITUDE = "There is no ATTITUDE or ATTITUDE_QUATERNION message."
ASK = " Ask for more with `--request-rate 100`."


class LiveStream:
    """Takes what a link received and answers the rows it completes. No threads, no sockets, no clock of its own.

    The rows depend on the bytes alone, not on how they were cut into pieces nor on when they came.

    Attributes:
        setup: what the rows of the latest segment are; None before the first.
        samples: of the vehicle's attitude and motor outputs so far.
    """

    def __init__(
        self, axis: str = "roll", vehicle: str | None = None, inputs: str | None = None, asked: bool = False
    ) -> None:
        """Begins without a byte.

        Args:
            axis: "roll" or "pitch".
            vehicle: "system" or "system:component"; None for the only multirotor that sends attitude.
            inputs: "motors" or "demand"; None for the motors, unless they come too slowly and the demand does not.
            asked: whether the vehicle is asked for rates: then nobody needs to be told to.

        Raises:
            ValueError: an axis or inputs that are neither.
        """
        if axis not in AXES:
            raise ValueError(f"axis must be one of {', '.join(AXES)}, not {axis!r}")
        self.setup: Setup | None = None
        self.samples = 0
        self._axis, self._ask = axis, "" if asked else ASK
        self._frames, self._senders, self._clock = LiveFrames(), Senders(vehicle), LiveClock()
        self._events: deque[Event] = deque(maxlen=MOST_EVENTS)
        self._attitudes = {name: Samples() for name in ATTITUDE_MESSAGES}
        self._outputs = Outputs(axis, inputs)
        self._flying, self._aligner = Flying(), Aligner()
        self._attitude: str | None = None
        self._drive: Drive | None = None
        self._scale: Scale | None = None
        self._reviewed, self._known = -inf, -1
        self._heard_from = inf
        self._boot = 0
        self._verdict, self._enough = "How fast the vehicle sends is not known yet.", True
        self._received = 0.0
        self._answers: deque[Message] = deque(maxlen=MOST_ANSWERS)
        prepare()

    @property
    def parameters(self) -> dict[str, float]:
        """The vehicle's parameters by name, as far as they were sent; also those MAVProxy holds of it."""
        followed = self._senders.followed
        if followed is None:
            return {}
        store = self._senders.get(followed.system, PARAMETER_STORE)
        sent = {**(store.parameters if store else {}), **followed.parameters}
        return parameters_of(sent.values(), followed.autopilot) if sent else {}

    def feed(self, stamp: float, data: bytes) -> list[Row]:
        """Takes the next bytes of the link and answers the rows they complete.

        Args:
            stamp: UNIX s they were received.
            data: any number of bytes, also parts of frames.
        """
        self._received = stamp
        rows: list[Row] = []
        for frame in self._frames.feed(data):
            self._take(frame, rows)
        return rows

    @property
    def followed(self) -> Sender | None:
        """The ids of the vehicle; None before it is known."""
        followed = self._senders.followed
        return None if followed is None else Sender(followed.system, followed.component)

    def answers(self) -> list[Message]:
        """The vehicle's messages of ``ANSWERS`` since the last call."""
        told = list(self._answers)
        self._answers.clear()
        return told

    def events(self) -> list[Event]:
        """What happened since the last call."""
        told = list(self._events)
        self._events.clear()
        return told

    def status(self) -> Status:
        """How things stand."""
        followed, now = self._senders.followed, self._clock.now
        verdict = self._senders.obstacle or (NO_ATTITUDE + self._ask if isnan(now) else self._verdict)
        rates = {name: samples.rate(now, DECIDING) for name, samples in self._attitudes.items() if samples.time}
        streams = [*self._attitudes.values(), *(bank.samples for bank in (self._drive.banks if self._drive else ()))]
        return Status(
            vehicle=followed.name if followed else None,
            speakers=tuple(
                {
                    "system": one.system,
                    "component": one.component,
                    "kind": one.kind,
                    "autopilot": one.autopilot,
                    "frames": one.frames,
                    "lost": one.lost,
                    "flies": one.flies,
                }
                for one in self._senders
            ),
            others=self._senders.others,
            rates=rates | self._outputs.rates(now, DECIDING),
            frames=self._frames.frames,
            unread=self._frames.unread,
            garbage=self._frames.garbage,
            lost=followed.lost if followed else 0,
            late=sum(stream.late for stream in streams),
            strays=self._clock.left_out,
            verdict=verdict,
            armed_and_airborne=self._flying.now,
        )

    def _take(self, frame: Frame, rows: list[Row]) -> None:
        sender = self._senders.of(frame)
        if not sender.take(frame) or frame.verdict != GOOD:
            return
        message = message_of(frame)
        if message is not None and message.name == "HEARTBEAT":
            sender.take_heartbeat(message)
        elif message is not None and message.name == "PARAM_VALUE":
            self._outputs.changes += sender.take_parameter(message)
        self._senders.decide(sender)
        self._tell(self._senders.sentences())
        followed = self._senders.followed
        if sender is not followed or message is None:
            return
        if message.name in ANSWERS:
            self._answers.append(message)
            return
        for placed in self._clock.place(message):
            if placed.boot != self._boot:
                self._reboot(placed.boot)
            self._tell(self._clock.sentences())
            self._understand(placed, rows)
        self._tell(self._clock.sentences())

    def _understand(self, placed: Placed, rows: list[Row]) -> None:
        message, time = placed.message, placed.time
        name = message.name
        if name in ATTITUDE_MESSAGES and placed.stamped:
            values, samples = attitude(message), self._attitudes[name]
            if values is not None:
                self._sampled(samples, samples.add(time, values), rows)
        elif (name in MOTOR_MESSAGES or name == DEMAND) and placed.stamped:
            stream = self._outputs.take(message, time)
            if stream is not None:
                if self._drive is not None and self._scale is not None and stream is self._drive.banks[0].samples:
                    self._flying.take_collective(time, self._drive.collective(self._scale))
                self._sampled(stream, True, rows)
        elif name == "HEARTBEAT":
            if self._own(message):
                self._flying.take_heartbeat(time, message.values[2])
        elif name == "EXTENDED_SYS_STATE":
            self._flying.take_landed_state(time, message.values[0])
        elif name in CLIMBS:
            self._flying.take_climb(name, time, CLIMBS[name][1] * message.values[0])
        if self._aligner.running and not self._flying.now:
            self._aligner.end()
        if not abs(self._clock.now - self._reviewed) < REVIEW:
            self._review()

    def _sampled(self, samples: Samples, new: bool, rows: list[Row]) -> None:
        """Tells the rows that a new sample completes."""
        self.samples += new
        if not new or self._drive is None or self._attitude is None:
            return
        streams = (self._attitudes[self._attitude], *(bank.samples for bank in self._drive.banks))
        if samples not in streams:
            return
        if self._aligner.running:
            if samples.parted:
                self._tell([f"Nothing came of {self._name(samples)} for {samples.parted:.2f} s: a new segment."])
                self._aligner.end()
            elif samples.taken % RATE_CHECK == 0 and (before := self._aligner.former_rate(samples)) is not None:
                self._tell([f"{self._name(samples)} comes no more at {before:.3g} Hz: a new segment."])
                self._aligner.forget()
                for stream in streams:
                    stream.clear()
        if not self._aligner.running and self._flying.now and self._aligner.begin(streams):
            self._begin(self._drive, self._attitude)
        if self._aligner.running:
            rows += [self._row(point, self._drive) for point in self._aligner.points()]

    def _row(self, point: Point, drive: Drive) -> Row:
        motion, *banks = point.values
        place = AXES.index(self._axis)
        upright = max(abs(motion[0]), abs(motion[1])) < UPRIGHT
        return Row(
            time=point.time,
            inputs=np.array([banks[bank][at] for bank, at in drive.picks]),
            outputs=np.array([motion[place], motion[2 + place]]),
            segment=self._aligner.segment,
            received=self._received,
            settled=upright and self._flying.settled(point.time),
        )

    def _begin(self, drive: Drive, motion: str) -> None:
        assert self._aligner.dt is not None
        before, plan = self.setup, drive.layout
        self.setup = Setup(
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
        if before is not None and (before.dt, before.motors, before.layout) == (
            self.setup.dt,
            drive.message,
            plan,
        ):
            return
        assumed = plan.channels_assumed or plan.positions_assumed
        self._tell(
            [
                f"{motion} and {drive.message} come fast enough: a row every {1e3 * self.setup.dt:.4g} ms, "
                f"{len(plan.names)} inputs.",
                *([f"Which motor is which was assumed: {plan.basis}."] if assumed else []),
            ]
        )

    def _review(self) -> None:
        """Looks at which messages come, how fast, and which channels are motors."""
        now = self._clock.now
        if isnan(now):
            return
        if not abs(now - self._reviewed) < DECIDING:
            self._heard_from = now
        self._reviewed = now
        changes = self._outputs.changes
        if not self._aligner.running:
            counts = {name: samples.count(now, DECIDING) for name, samples in self._attitudes.items()}
            self._attitude = fastest({name: count for name, count in counts.items() if count}) or self._attitude
        if not self._aligner.running or changes != self._known:
            self._known = changes
            self._redrive(now)
        if self._drive is None and now - self._heard_from >= AVERAGING / 2 and self._outputs.rates(now, DECIDING):
            self._flying.take_idle()
        self._judge(now)

    def _redrive(self, now: float) -> None:
        followed = self._senders.followed
        assert followed is not None
        if followed.kind not in (*MULTIROTORS, UNNAMED):
            self._drive = None
            return
        # After a silence nothing tells anything else than before.
        drive = (
            self._outputs.choose(
                now,
                DECIDING,
                followed.kind,
                followed.autopilot,
                self.parameters,
                self._drive.message if self._aligner.running and self._drive else None,
            )
            or self._drive
        )
        if self._drive is not None and drive is not None and drive.key != self._drive.key and self._aligner.running:
            self._tell([f"The inputs are others from now on: {', '.join(drive.layout.names)}: a new segment."])
            self._aligner.forget()
        self._drive = drive
        if self._aligner.running and self.setup is not None and drive is not None and drive.layout != self.setup.layout:
            self.setup = replace(self.setup, layout=drive.layout)
            self._tell([f"Which motor is which is read from {drive.layout.basis}."])
        if self._drive is not None:
            scale = self._drive.scale(self.parameters)
            if self._scale is not None and scale.name != self._scale.name:
                self._flying.forget_collective()
            self._scale = scale

    def _judge(self, now: float) -> None:
        """Says so when the rates are not enough, or are again."""
        if now - self._heard_from < DECIDING:
            return
        followed = self._senders.followed
        if followed is not None and followed.kind not in (*MULTIROTORS, UNNAMED):
            self._say_verdict(
                f"The vehicle says it is a {followed.kind}, and only a multirotor's {self._axis} can be learnt.", False
            )
            return
        if self._attitude is None:
            self._say_verdict(NO_ATTITUDE, False)
            return
        rates = {self._attitude: self._attitudes[self._attitude].rate(now, DECIDING)}
        heard = self._outputs.rates(now, DECIDING)
        drives = self._drive.message if self._drive else max(heard, key=lambda name: heard[name], default=None)
        if drives is None:
            self._say_verdict("There is no message with motor outputs.", False)
            return
        rates[drives] = heard[drives]
        # Once they are enough, a little less still is: a rate at the limit must not be told twice a second.
        least = MINIMUM_RATE / SLACK if self._enough else MINIMUM_RATE
        sentence = too_slow(rates, self._axis) if min(rates.values()) < least else None
        if sentence is not None:
            self._say_verdict(sentence + self._ask, False)
        elif not self._flying.now:
            self._say_verdict("The vehicle does not fly.", True)
        else:
            self._say_verdict("", True)

    def _say_verdict(self, sentence: str, enough: bool) -> None:
        if not enough and self._enough:
            self._tell([sentence])
        elif enough and not self._enough:
            self._tell(["Attitude and motor outputs come fast enough now."])
        self._verdict, self._enough = sentence, enough

    def _reboot(self, boot: int) -> None:
        """Everything on the old clock is over; who the vehicle is and what its parameters are stays."""
        self._boot = boot
        self._attitudes = {name: Samples() for name in ATTITUDE_MESSAGES}
        self._outputs.begin_anew()
        self._drive = None
        self._flying = Flying()
        self._aligner.begin_anew()
        self._reviewed, self._heard_from = -inf, inf

    def _own(self, message: Message) -> bool:
        """Whether a HEARTBEAT under the vehicle's ids says what the vehicle is."""
        followed = self._senders.followed
        assert followed is not None
        kind, autopilot, _ = message.values
        kind, autopilot = enum_name("MAV_TYPE", kind), enum_name("MAV_AUTOPILOT", autopilot)
        return (kind, autopilot) == (followed.kind, followed.autopilot)

    def _name(self, samples: Samples) -> str:
        assert self._drive is not None
        return next((name for name, one in self._attitudes.items() if one is samples), self._drive.message)

    def _tell(self, sentences: list[str]) -> None:
        self._events.extend(Event(self._received, sentence) for sentence in sentences)
