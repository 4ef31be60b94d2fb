"""Attached: the live path put together. What a link receives is kept, learnt from and shown, step by step.

One thread does all of it but what may take long: whole learnings run in the learner's executor, what is shown waits in
the view's own queue. What is waited for, beside the link, is the disk that the raw stream goes to, and at the end the
vehicle's word that it sends as before.
"""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mavdem.dem import Estimate, Learned, OnlineLearner, Settings
from mavdem.ingest.link import Link, LinkLost
from mavdem.ingest.mavlink_json import definition_named
from mavdem.ingest.raw_recording import RawRecording
from mavdem.live import LiveStream, Row, Setup
from mavdem.live.rate_request import PATIENCE, TRIES, RateRequest, greeting

Array = NDArray[np.float64]

TOLD_EVERY = 1.0
"""Seconds from one status to the next."""
LATENCIES = 10_000
"""Latest rows of which it is known how long they took."""
MOST_SAID = 200
"""Sentences that are kept."""
SILENCE = 3.0
"""Seconds without a byte, or without attitude and motors, after which it is said that nothing comes."""
REPEATED = 30.0
"""Seconds in which a sentence is said once, whatever it measured: a link at a limit must not fill a terminal."""

_MEASURED = re.compile(r"\d+(\.\d+)?(?= (Hz|s|ms)\b)")


class Standing(NamedTuple):
    """How things stand.

    Attributes:
        vehicle: "system:component"; ``None`` before it is known.
        rates: Hz of the vehicle's messages of attitude and motors, by name.
        lost: messages of the vehicle that the link lost.
        samples: rows that were learnt from, and those that only were shown.
        latency: s from the link to the estimate, of the latest rows: the median and the 99th percentile.
        obstacle: why there is no model yet, or why it stays as it is; empty when all is well.
    """

    vehicle: str | None
    rates: dict[str, float]
    lost: int
    samples: tuple[int, int]
    latency: tuple[float, float]
    obstacle: str


class Shown(Protocol):
    """Who is shown it; returns at once."""

    def put(
        self,
        time: float,
        segment: int,
        outputs: Array,
        inputs: Array,
        estimate: Estimate | None = None,
        learned: Learned | None = None,
    ) -> None:
        """Shows a row."""

    def log(self, text: str) -> None:
        """Shows a sentence."""


@dataclass
class Attached:
    """A link, and all that is done with what it receives.

    Attributes:
        link: open.
        stream: of one vehicle.
        settings: of the learner.
        show: makes who is shown it, once it is known what the rows are, and hears when they are others.
        tell: is told once a second how things stand.
        say: is told every sentence.
        executor: of whole learnings.
        recording: of the raw stream; ``None`` for none, also once it has failed.
        rate: Hz to ask the vehicle for; ``None`` to send nothing at all.
        learner: that of the latest rows; ``None`` before the first.
        said: the latest sentences.
    """

    link: Link
    stream: LiveStream
    settings: Settings
    show: Callable[[Setup], Shown]
    tell: Callable[[Standing], None]
    say: Callable[[str], None]
    executor: Executor | None = None
    recording: RawRecording | None = None
    rate: float | None = None
    learner: OnlineLearner | None = None
    said: deque[str] = field(default_factory=lambda: deque(maxlen=MOST_SAID))
    _shown: Shown | None = None
    _unshown: bool = False
    _setup: Setup | None = None
    _learners: dict[tuple[float, tuple[str, ...]], OnlineLearner] = field(default_factory=dict)
    _request: RateRequest | None = None
    _greetings: int = 0
    _latencies: deque[float] = field(default_factory=lambda: deque(maxlen=LATENCIES))
    _learnt: int = 0
    _only_shown: int = 0
    _told: float = 0.0
    _heard: float = field(default_factory=time.monotonic)
    _sampled: float = -np.inf
    _samples: int = 0
    _lost: bool = False
    _obstacle: str = ""
    _last_said: dict[str, float] = field(default_factory=dict)

    def step(self, timeout: float = 0.1) -> None:
        """Takes what has come, or waits for it for so many seconds at most."""
        received = self._received(timeout)
        for stamp, data in received:
            self._record(stamp, data)
        if received:
            # Together, since each look at garbage has a cost of its own; no row may seem faster than it was.
            for row in self.stream.feed(received[0][0], b"".join(data for _, data in received)):
                self._take(row)
            for event in self.stream.events():
                self._log(event.sentence)
        # What took its time to understand is no silence.
        now = time.monotonic()
        if received:
            self._heard = now
        if self.stream.samples != self._samples:
            self._samples, self._sampled = self.stream.samples, now
        if now - self._told >= TOLD_EVERY:
            self._told = now
            self._ask(now)
            self._tell()

    def end(self) -> None:
        """Gives the vehicle back the rates it had, which it must confirm, and ends the recording."""
        if self._request is not None and not self._lost:
            self._restore(self._request)
        if self.recording is not None:
            try:
                self.recording.close()
            except OSError as error:
                self.recording = None
                self._log(f"The recording could not be ended ({error.strerror or error}).")

    @property
    def standing(self) -> Standing:
        """How things stand."""
        status = self.stream.status()
        known = np.percentile(self._latencies, [50, 99]) if self._latencies else np.full(2, np.nan)
        silence = self._silence()
        obstacle = silence or status.verdict or (self.learner.obstacle if self.learner is not None else "")
        rates = dict.fromkeys(status.rates, 0.0) if silence else status.rates
        samples = self._learnt, self._only_shown
        return Standing(status.vehicle, rates, status.lost, samples, (known[0], known[1]), obstacle)

    def _silence(self) -> str:
        """That nothing comes, where nothing does: what is known of the stream is then of before."""
        now = time.monotonic()
        if self._lost:
            return "the link is lost"
        if now - self._heard > SILENCE:
            return f"nothing has come for {SILENCE:.0f} s"
        if self._samples and now - self._sampled > SILENCE:
            return f"no attitude and no motor outputs have come for {SILENCE:.0f} s"
        return ""

    def _received(self, timeout: float) -> list[tuple[float, bytes]]:
        try:
            if self._lost:
                if not self.link.reopen():
                    time.sleep(min(timeout, 0.1))
                    return []
                self._lost = False
                self._log("The link is back.")
            received = self.link.receive(timeout)
        except LinkLost as error:
            self._lost = True
            self._log(f"{error} It is tried again.")
            return []
        return received

    def _record(self, stamp: float, data: bytes) -> None:
        if self.recording is None:
            return
        try:
            self.recording.take(stamp, data)
        except OSError as error:
            self.recording = None
            self._log(f"The recording ends here ({error.strerror or error}); everything else goes on.")

    def _take(self, row: Row) -> None:
        setup = self.stream.setup
        assert setup is not None
        names = setup.layout.names
        learner = self._learners.get((setup.dt, names))
        if learner is None:
            learner = OnlineLearner(self.settings, setup.dt, len(names), len(row.outputs), executor=self.executor)
            self._learners[setup.dt, names] = learner
        self.learner = learner
        if setup is not self._setup:
            self._setup = setup
            self._open(setup)
        estimate = None
        if row.settled:
            try:
                estimate = learner.update(row.time, row.outputs, row.inputs)
            except ValueError as error:
                self._log(f"A sample was left out: {error}.")
        self._learnt += estimate is not None
        self._only_shown += estimate is None
        self._latencies.append(time.time() - row.received)
        if self._shown is not None:
            self._shown.put(row.time, row.segment, row.outputs, row.inputs, estimate, learner.learned)

    def _open(self, setup: Setup) -> None:
        """Shows rows of a setup; a view that fails is left, and takes nothing with it."""
        if self._unshown:
            return
        before = self._shown
        try:
            self._shown = self.show(setup)
        except Exception as error:
            self._shown, self._unshown = None, True
            self._log(f"It cannot be shown ({error}); everything else goes on.")
        if before is None and self._shown is not None:
            for sentence in self.said:
                self._shown.log(sentence)

    def _ask(self, now: float) -> None:
        """Asks for rates, where that was asked for and the vehicle is known; greets who does not speak before."""
        if self.rate is None or self._lost:
            return
        if self.link.speaks_first and now - self._heard >= TOLD_EVERY:
            self._send([greeting(self._greetings)])
            self._greetings += 1
        vehicle = self.stream.followed
        if vehicle is None or now - self._heard > SILENCE:
            return
        if self._request is None:
            self._request = RateRequest(vehicle, self.rate)
        for message in self.stream.answers():
            self._request.heard(message)
        rates = self.stream.status().rates
        known = {
            definition.message_id: rates[definition.name] for definition in map(definition_named, rates) if definition
        }
        self._send(self._request.due(now, known))
        for sentence in self._request.events:
            self._log(sentence)
        self._request.events.clear()

    def _restore(self, request: RateRequest) -> None:
        for _ in range(TRIES):
            frames = request.restore()
            if not frames:
                return
            self._send(frames)
            until = time.monotonic() + PATIENCE
            while request.restore() and not self._lost and (left := until - time.monotonic()) > 0:
                for stamp, data in self._received(left):
                    self._record(stamp, data)
                    self.stream.feed(stamp, data)
                for message in self.stream.answers():
                    request.heard(message)
        if request.restore():
            self._log("The vehicle does not answer whether it sends again as it did before.")

    def _send(self, frames: list[bytes]) -> None:
        try:
            for frame in frames:
                self.link.send(frame)
        except LinkLost as error:
            self._log(str(error))

    def _tell(self) -> None:
        standing = self.standing
        self.tell(standing)
        if standing.obstacle != self._obstacle:
            self._obstacle = standing.obstacle
            self._log(
                f"{standing.obstacle[:1].upper()}{standing.obstacle[1:]}".rstrip(".") + "."
                if standing.obstacle
                else "The model is learnt from what comes."
            )

    def _log(self, sentence: str) -> None:
        now, kind = time.monotonic(), _MEASURED.sub("", sentence)
        if now - self._last_said.get(kind, -np.inf) < REPEATED:
            return
        self._last_said = {one: at for one, at in self._last_said.items() if now - at < REPEATED} | {kind: now}
        self.say(sentence)
        self.said.append(sentence)
        if self._shown is not None:
            self._shown.log(sentence)
