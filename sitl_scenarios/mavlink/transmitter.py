"""Transmitter: the frames an autopilot sends, block of cycles after block, and how they arrive over a lossy link."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from operator import itemgetter

import numpy as np
from numpy.random import default_rng
from numpy.typing import NDArray

from mavdem.ingest.mavlink.definitions import FrameSender, definitions_by_name, encode_frame
from mavdem.ingest.mavlink.framing import frames_at
from mavdem.ingest.mavlink.vehicles import FrameStream
from mavdem.ingest.vocabulary import AUTOPILOT_COMPONENT
from sitl_scenarios.mavlink.autopilots import AUTOPILOTS, Autopilot
from sitl_scenarios.mavlink.messages import parameters, payload, written
from sitl_scenarios.motion import Array, Motion, Pair
from sitl_scenarios.plan import BOOT_SECONDS, total_seconds
from sitl_scenarios.scenario import Scenario

Rows = NDArray[np.intp]


Timed = tuple[float, bytes]
"""The time, s of the flight, at which a frame is sent or received, and its bytes."""
EARLY_SECONDS = 0.5e-6
"""Seconds before it is due that a message may be sent: half of what times are rounded to, so that none is a tie."""


class Schedule:
    """The streams that are being sent. ``usual``: Hz by message that it begins with; 0 for one that is not sent."""

    def __init__(
        self, usual: Mapping[str, float], start: float, cycle: float, autopilot: Autopilot
    ) -> None:
        """Begins at the time ``start``, s, where the autopilot has them apart every stream a ``cycle``, s, later.

        Intervals are rounded down to whole numbers of the autopilot's step, and none is shorter than a cycle.
        """
        self.usual = dict(usual)
        self._step = autopilot.interval_step
        self._cycle = cycle
        # By message: those due at a first time, s, and every so many s from then on, and how many have been sent.
        self._courses: dict[str, Pair] = {}
        self._sent: dict[str, int] = {}
        for number, (name, rate) in enumerate(usual.items()):
            interval = 1 / rate if rate else np.inf
            first = start + number * cycle * autopilot.apart
            self.set(name, interval, first)

    def set(self, name: str, interval: float, start: float) -> None:
        """Sends a message every ``interval`` s from ``start``, s, on; never, when the interval is infinite."""
        if np.isfinite(interval / self._step):
            # The loop looks once in a cycle: what is due more often is sent once.
            whole_steps = int(interval / self._step + 1e-6) * self._step
            interval = max(whole_steps, self._cycle)
        self._courses[name] = (start, interval)
        self._sent[name] = 0

    def interval(self, name: str) -> float:
        """Returns the seconds between one message and the next; infinite for none."""
        return self._courses[name][1]

    def due(self, name: str, times: Array) -> Rows:
        """Returns in which of the next cycles a message is sent.

        The cycles are at ``times`` (N,), s, ascending from call to call.
        """
        first, interval = self._courses[name]
        if not np.isfinite(interval):
            return np.empty(0, dtype=np.intp)
        periods = np.floor((times + EARLY_SECONDS - first) / interval)
        until_now = np.maximum(periods + 1, 0)
        sent = np.diff(until_now, prepend=self._sent[name])
        rows = np.flatnonzero(sent)
        self._sent[name] = int(until_now[-1])
        return rows


# From one request for all streams to the next: ``set_stream_rates`` in MAVProxy's mavproxy.py
MAVPROXY_SECONDS = 15.0
Placed = tuple[int, str, bytes]
"""The row of the block in which a message is sent, its name and its payload."""


class Transmitter:
    """An autopilot's sending side: what is due by its schedule, what changes, and what it was asked for.

    What it sends by itself does not depend on how a flight is cut into blocks. ``schedule``
    and ``clock``, s at the end of the last block, are on the boot clock; ``system`` is the MAVLink system id.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Takes the scenario; raises ValueError: it has rates of a message that is not sent."""
        self.autopilot = AUTOPILOTS[scenario.stream.autopilot]
        self.system = scenario.stream.system
        self._rates = self.autopilot.rates(scenario.stream.rate, scenario.stream.rates)
        if scenario.stream.only_when_asked:
            kept = {"HEARTBEAT", *scenario.stream.rates}
            self._rates = {
                name: rate if name in kept else 0.0 for name, rate in self._rates.items()
            }
        self._scenario = scenario
        self._asked: list[Placed] = []
        self._events = sorted(self._planned(), key=itemgetter(0))
        self._armed_at = np.inf
        # At zero, messages would seem to have no stamp.
        self._begin(0.0, 0.01)

    def send(self, motion: Motion) -> list[Timed]:
        """Returns the frames sent during the rows of the next block, one at least, at the times of the motion."""
        armed = motion.time[motion.armed]
        if len(armed):
            self._armed_at = min(self._armed_at, float(armed[0]))
        frames: list[Timed] = []
        done = 0
        while self._events:
            after_arming, happen = self._events[0]
            row = int(np.searchsorted(motion.time, self._armed_at + after_arming))
            if row == len(motion):
                break
            frames += self._sent(motion[done:row])
            happen(float(motion.time[row]))
            done = row
            del self._events[0]
        return frames + self._sent(motion[done:])

    def ask(self, name: str, **values: object) -> None:
        """Sends a message once, with the next block; fields that are not given are zero."""
        self._asked.append((0, name, payload(name, **values).tobytes()))

    def tell_parameters(self, name: str = "") -> None:
        """Sends all parameters, or that of one ``name``, with the next block."""
        for index, parameter in enumerate(self.parameters):
            if name not in ("", parameter.name):
                continue
            self.ask(
                "PARAM_VALUE",
                param_id=parameter.name.encode(),
                param_value=parameter.encoded(self.autopilot.bitwise),
                param_type=parameter.kind,
                param_count=len(self.parameters),
                param_index=index,
            )

    def _planned(self) -> Iterator[tuple[float, Callable[[float], None]]]:
        """Seconds after arming, and what happens then: it is called with that time of the motion."""
        faults = self._scenario.faults
        often = total_seconds(self._scenario) if faults.mavproxy_rate else 0.0
        for time in np.arange(0.0, often, MAVPROXY_SECONDS).tolist():
            yield time, self._set_streams
        if faults.reboot is not None:
            # a second without messages
            yield faults.reboot, lambda now: self._begin(now, now + 1.0)
        if faults.clock_jump is not None:
            yield faults.clock_jump, self._jump

    def _set_streams(self, _: float) -> None:
        """What REQUEST_DATA_STREAM for all groups does; messages of no group stay as they are."""
        interval = 1 / self._scenario.faults.mavproxy_rate
        grouped = (name for group in self.autopilot.groups.values() for name in group)
        for name in grouped:
            change = abs(self.schedule.interval(name) - interval)
            if change >= self.autopilot.interval_step:
                self.schedule.set(name, interval, self.clock)

    def _jump(self, _: float) -> None:
        self._boot -= self._scenario.faults.clock_jump_seconds

    def _begin(self, boot: float, first: float) -> None:
        """Begins anew with a boot clock that is zero at ``boot``, sending from ``first`` on, s of the motion."""
        self._boot = boot
        self._first = first
        self._sequence = 0
        self.clock = first - boot
        self.schedule = self._scheduled(self.clock)
        self.parameters = parameters(self._scenario, self.autopilot)
        if not self._scenario.stream.only_when_asked:
            self.tell_parameters()
        text = f"Simulated by mavdem, frame {self._scenario.vehicle.layout}"
        self.ask("STATUSTEXT", severity=6, text=text.encode())  # MAV_SEVERITY_INFO
        self._fresh = True

    def _scheduled(self, start: float) -> Schedule:
        return Schedule(self._rates, start, self._scenario.cycle, self.autopilot)

    def _sent(self, motion: Motion) -> list[Timed]:
        motion = motion[int(np.searchsorted(motion.time, self._first)) :]
        if not len(motion):
            return []
        clock = motion.time - self._boot
        if self._fresh:
            self.schedule = self._scheduled(float(clock[0]))
            self._fresh = False
        self.clock = float(clock[-1])
        placed = sorted([*self._asked, *self._streams(motion, clock)], key=itemgetter(0))
        self._asked = []
        sender = FrameSender(self.system, AUTOPILOT_COMPONENT)
        frames = []
        for row, name, content in placed:
            frame = encode_frame(content, definitions_by_name()[name], sender, self._sequence)
            self._sequence = (self._sequence + 1) % 256
            frames.append((float(motion.time[row]), frame))
        return frames

    def _streams(self, motion: Motion, clock: Array) -> Iterator[Placed]:
        for name in self._rates:
            rows = self.schedule.due(name, clock)
            if len(rows):
                boot = np.round(clock[rows] * 1e6).astype(np.int64)
                payloads = written(name, motion[rows], boot, self.autopilot)
                for row, content in zip(rows.tolist(), payloads, strict=True):
                    yield row, name, content.tobytes()


class LossyLink:
    """A link with a scenario's faults. What it does to a frame depends on the seed and how many came before alone.

    A frame that is late delays those behind it: only what is ``reordered`` is overtaken.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._faults = scenario.faults
        # The key sets it apart from everything else that begins with the seed of the flight.
        sequence = np.random.SeedSequence(scenario.seed, spawn_key=(0x6C696E6B,))
        self._random = default_rng(sequence)
        self._latest = -np.inf
        self._held: Timed | None = None

    def pass_on(self, sent: list[Timed]) -> Iterator[Timed]:
        """Yields the frames that arrive, at the times they do; one that is to be overtaken waits for the next."""
        faults = self._faults
        chances = self._random.random((len(sent), 3)).tolist()
        for (time, frame), (lost, late, overtaken) in zip(sent, chances, strict=True):
            if lost < faults.loss or self.out(time):
                continue
            self._latest = max(time + faults.delay + faults.jitter * late, self._latest)
            if self._held is not None:
                earlier, held = self._held
                self._held = None
                yield earlier, frame
                yield self._latest, held
            elif overtaken < faults.reordered:
                self._held = self._latest, frame
            else:
                yield self._latest, frame

    def out(self, time: float) -> bool:
        """Returns whether the link is lost at a time, s of the motion."""
        begin = self._faults.outage
        return begin is not None and 0 <= time - BOOT_SECONDS - begin < self._faults.outage_seconds

    def rest(self) -> list[Timed]:
        """Returns the frame that is still held, at the end."""
        return [] if self._held is None else [self._held]


BLOCK_CYCLES = 1 << 14  # Cycles whose frames are made together


def recorded(scenario: Scenario, motion: Motion) -> FrameStream:
    """Returns the frames of a flight from boot to end that arrive, stamped with the time they do.

    Raises ValueError: as ``Transmitter``.
    """
    transmitter = Transmitter(scenario)
    link = LossyLink(scenario)
    received: list[Timed] = []
    for begin in range(0, len(motion), BLOCK_CYCLES):
        received += link.pass_on(transmitter.send(motion[begin : begin + BLOCK_CYCLES]))
    received += link.rest()
    data = np.frombuffer(b"".join(frame for _, frame in received), dtype=np.uint8)
    sizes = np.array([len(frame) for _, frame in received], np.int64)
    frames = frames_at(data, np.cumsum(sizes) - sizes)
    # The first boot is on 1 January 2026, 0:00 UTC, and a day later with each seed, so that no two are one flight.
    begin = 1_767_225_600_000_000 + scenario.seed % 1000 * 86_400_000_000
    stamps = begin + np.round([1e6 * time for time, _ in received])
    return FrameStream("simulation", "simulation", data, frames, stamps.astype(np.uint64), 0, ())
