"""Transmitter: the frames an autopilot sends, block of cycles after block, and how they arrive over a lossy link."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from operator import itemgetter

import numpy as np
from numpy.random import default_rng
from numpy.typing import NDArray

from mavdem.ingest.mavlink.definitions import FrameSender, composed_frames
from mavdem.ingest.mavlink.framing import Bytes, Frames, gathered
from mavdem.ingest.mavlink.vehicles import FrameStream
from mavdem.ingest.vocabulary import AUTOPILOT_COMPONENT
from sitl_scenarios.mavlink.autopilots import AUTOPILOTS
from sitl_scenarios.mavlink.messages import Payloads, named, parameters, payload, written
from sitl_scenarios.motion import Array, Flags, Motion, Pair, Progress
from sitl_scenarios.plan import BOOT_SECONDS, seconds
from sitl_scenarios.scenario import Faults, Scenario

Rows = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Batch:
    """N frames, one behind the other in ``data``."""

    time: Array  # (N,) s of the flight, ascending: when each was sent, or is received
    data: Bytes  # their bytes
    frames: Frames  # the table of them

    def __len__(self) -> int:
        return len(self.time)

    def taken(self, rows: Rows, time: Array) -> Batch:
        """Returns the frames of these rows (M,), in this order, at the times (M,)."""
        return Batch(time, *gathered([(self.data, self.frames)], rows))

    def timed(self) -> Iterator[tuple[float, bytes]]:
        """Yields the time and the bytes of each frame."""
        whole = self.data.tobytes()
        columns = (self.time, self.frames.start, self.frames.end)
        for time, start, end in zip(*(column.tolist() for column in columns), strict=True):
            yield time, whole[start:end]


def joined(batches: Sequence[Batch]) -> Batch:
    """Joins batches, one at least, one behind the other."""
    time = np.concatenate([batch.time for batch in batches])
    return Batch(time, *gathered([(batch.data, batch.frames) for batch in batches]))


EARLY = 0.5e-6
"""Seconds before it is due that a message may be sent: half of what times are rounded to, so that none is a tie."""


class Schedule:
    """The streams that are being sent. ``usual``: Hz by message that it begins with; 0 for one that is not sent."""

    def __init__(
        self, usual: Mapping[str, float], start: float, cycle: float, step: float, apart: bool
    ) -> None:
        """Begins at the time ``start``, s, every stream a ``cycle``, s, after the one before if they are ``apart``.

        Intervals are rounded down to whole numbers of ``step``, s, and none is shorter than a cycle.
        """
        self.usual = dict(usual)
        self._step = step
        self._cycle = cycle
        # By message: those due at a first time, s, and every so many s from then on, and how many have been sent.
        self._courses: dict[str, Pair] = {}
        self._sent: dict[str, int] = {}
        for number, (name, rate) in enumerate(usual.items()):
            interval = 1 / rate if rate else np.inf
            first = start + number * cycle * apart
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
        periods = np.floor((times + EARLY - first) / interval)
        until_now = np.maximum(periods + 1, 0)
        sent = np.diff(until_now, prepend=self._sent[name])
        rows = np.flatnonzero(sent)
        self._sent[name] = int(until_now[-1])
        return rows


# From one request for all streams to the next: ``set_stream_rates`` in MAVProxy's mavproxy.py
MAVPROXY_SECONDS = 15.0
Placed = tuple[str, Rows, Payloads]
"""A message by name, the rows (n,) of the block in which it is sent, its payloads (n,)."""


class Transmitter:
    """An autopilot's sending side: what is due by its schedule, what changes, and what it was asked for.

    What it sends by itself does not depend on how a flight is cut into blocks. ``schedule``
    and ``clock``, s at the end of the last block, are on the boot clock; ``system`` is the MAVLink system id.
    """

    def __init__(self, scenario: Scenario, cycle: float) -> None:
        """Takes the scenario and the loop's cycle, s; raises ValueError: it has rates of a message that is not sent."""
        self.autopilot = AUTOPILOTS[scenario.stream.autopilot]
        self.system = scenario.stream.system
        self._rates = self.autopilot.rates(scenario.stream.rate, scenario.stream.rates)
        if scenario.stream.only_when_asked:
            kept = {"HEARTBEAT", *scenario.stream.rates}
            self._rates = {
                name: rate if name in kept else 0.0 for name, rate in self._rates.items()
            }
        self._scenario = scenario
        self._cycle = cycle
        self._asked: list[tuple[str, Payloads]] = []
        self._events = sorted(self._planned(), key=itemgetter(0))
        self._armed_at = np.inf
        # At zero, messages would seem to have no stamp.
        self._begin(0.0, 0.01)

    def send(self, motion: Motion) -> Batch:
        """Returns the frames sent during the rows of the next block, one at least, at the times of the motion."""
        armed = motion.time[motion.armed]
        if len(armed):
            self._armed_at = min(self._armed_at, float(armed[0]))
        batches = []
        done = 0
        while self._events:
            after_arming, happen = self._events[0]
            row = int(np.searchsorted(motion.time, self._armed_at + after_arming))
            if row == len(motion):
                break
            if row > done:
                until_then = rows_of_motion(motion, slice(done, row))
                batches.append(self._sent(until_then))
            happen(float(motion.time[row]))
            done = row
            del self._events[0]
        rest = rows_of_motion(motion, slice(done, None))
        return joined([*batches, self._sent(rest)])

    def ask(self, name: str, **values: object) -> None:
        """Sends a message once, with the next block; fields that are not given are zero."""
        self._asked.append((name, payload(name, **values)))

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
        often = seconds(self._scenario) if faults.mavproxy_rate else 0.0
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
        self.parameters = parameters(self._scenario, self.autopilot, self._cycle)
        if not self._scenario.stream.only_when_asked:
            self.tell_parameters()
        frame = self._scenario.vehicle.mixer or self._scenario.vehicle.frame
        text = f"Simulated by mavdem, frame {frame}"
        self.ask("STATUSTEXT", severity=6, text=text.encode())  # MAV_SEVERITY_INFO
        self._fresh = True

    def _scheduled(self, start: float) -> Schedule:
        return Schedule(
            self._rates, start, self._cycle, self.autopilot.interval_step, self.autopilot.apart
        )

    def _sent(self, motion: Motion) -> Batch:
        first = int(np.searchsorted(motion.time, self._first))
        motion = rows_of_motion(motion, slice(first, None))
        if not len(motion):
            return _nothing()
        clock = motion.time - self._boot
        if self._fresh:
            self.schedule = self._scheduled(float(clock[0]))
            self._fresh = False
        self.clock = float(clock[-1])
        placed = [(name, np.zeros(1, dtype=np.intp), command) for name, command in self._asked]
        self._asked = []
        placed += self._streams(motion, clock)
        if placed:
            return self._framed(placed, motion.time)
        return _nothing()

    def _streams(self, motion: Motion, clock: Array) -> Iterator[Placed]:
        for name in self._rates:
            rows = self.schedule.due(name, clock)
            if len(rows):
                boot = np.round(clock[rows] * 1e6).astype(np.int64)
                sampled = rows_of_motion(motion, rows)
                payloads = written(name, sampled, boot, self.autopilot)
                yield name, rows, payloads

    def _framed(self, placed: list[Placed], time: Array) -> Batch:
        rows = np.concatenate([rows for _, rows, _ in placed])
        order = np.argsort(rows, kind="stable")
        sequence = np.empty(len(rows), dtype=np.int64)
        end = self._sequence + len(rows)
        sequence[order] = np.arange(self._sequence, end)
        self._sequence = end % 256
        sender = FrameSender(self.system, AUTOPILOT_COMPONENT)
        batches = []
        begin = 0
        for name, own, payloads in placed:
            end = begin + len(own)
            numbers = (sequence[begin:end] % 256).astype(np.uint8)
            begin = end
            data, frames = composed_frames(payloads, named(name), sender, numbers)
            batches.append(Batch(time[own], data, frames))
        arrival = time[rows[order]]
        return joined(batches).taken(order, arrival)


def rows_of_motion(motion: Motion, rows: slice | Rows) -> Motion:
    """Returns some rows of a motion."""
    return Motion(**{field.name: getattr(motion, field.name)[rows] for field in fields(Motion)})


def _nothing() -> Batch:
    none = np.empty(0, dtype=np.uint8)
    heartbeat = named("HEARTBEAT")
    data, frames = composed_frames(payload("HEARTBEAT", 0), heartbeat, FrameSender(0, 0), none)
    return Batch(np.empty(0), data, frames)


class LossyLink:
    """A link with ``faults``. What it does to a frame depends on the seed and on how many came before, nothing else.

    A frame that is late delays those behind it: only what is ``reordered`` is overtaken.
    """

    def __init__(self, faults: Faults, seed: int) -> None:
        self._faults = faults
        # The key sets it apart from everything else that begins with the seed of the flight.
        sequence = np.random.SeedSequence(seed, spawn_key=(0x6C696E6B,))
        self._random = default_rng(sequence)
        self._latest = -np.inf
        self._held: Batch | None = None

    def pass_on(self, batch: Batch) -> Batch:
        """Returns the frames that arrive, at the times they do; one that is to be overtaken waits for the next."""
        faults = self._faults
        lost, late, overtaken = self._random.random((len(batch), 3)).T
        arrives = (lost >= faults.loss) & ~self.out(batch.time)
        there = np.flatnonzero(arrives)
        time = batch.time[there] + faults.delay + faults.jitter * late[there]
        in_order = np.maximum(time, self._latest)
        time = np.maximum.accumulate(in_order)
        self._latest = float(time[-1]) if len(time) else self._latest
        arriving = batch.taken(there, time)
        waits = overtaken[there] < faults.reordered
        if self._held is not None and len(arriving):
            arriving = joined([self._held, arriving])
            waits = np.concatenate([[True], waits])
            self._held = None
        order = []
        behind = None  # the row that waits for the next
        for row, is_late in enumerate(waits.tolist()):
            if is_late and behind is None:
                behind = row
                continue
            order.append(row)
            if behind is not None:
                order.append(behind)
                behind = None
        if behind is not None:
            self._held = arriving.taken(np.array([behind]), arriving.time[-1:])
        return arriving.taken(np.array(order, np.intp), arriving.time[: len(order)])

    def out(self, time: Array | float) -> Flags:
        """Returns whether the link is lost at a time, s of the motion."""
        begin = np.inf if self._faults.outage is None else self._faults.outage
        since = np.asarray(time) - BOOT_SECONDS - begin
        return (since >= 0.0) & (since < self._faults.outage_seconds)

    def rest(self) -> list[Batch]:
        """Returns the frame that is still held, at the end."""
        held = self._held
        self._held = None
        return [] if held is None else [held]


BLOCK = 1 << 14  # Cycles whose frames are made together


def recorded(scenario: Scenario, motion: Motion, cycle: float, progress: Progress) -> FrameStream:
    """Returns the frames of a flight from boot to end that arrive, stamped with the time they do.

    ``cycle`` is of the autopilot's loop, s; ``progress`` is called with the fraction done. Raises ValueError: as
    ``Transmitter``.
    """
    transmitter = Transmitter(scenario, cycle)
    link = LossyLink(scenario.faults, scenario.seed)
    received = []
    for end in range(BLOCK, len(motion) + BLOCK, BLOCK):
        block = rows_of_motion(motion, slice(end - BLOCK, end))
        sent = transmitter.send(block)
        received.append(link.pass_on(sent))
        progress(min(end / len(motion), 1.0))
    whole = joined([*received, *link.rest()])
    # The first boot is on 1 January 2026, 0:00 UTC, and a day later with each seed, so that no two are one flight.
    begin = 1_767_225_600_000_000 + scenario.seed % 1000 * 86_400_000_000
    stamps = begin + np.round(whole.time * 1e6)
    return FrameStream(
        "simulation", "simulation", whole.data, whole.frames, stamps.astype(np.uint64), 0, ()
    )
