"""Transmitter: the MAVLink frames that an autopilot sends during a flight, and their way over a lossy link."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from operator import attrgetter, itemgetter
from typing import NamedTuple

import numpy as np
from numpy.random import default_rng
from numpy.typing import NDArray

from mavdem.ingest.mavlink.definitions import FrameSender, definitions_by_name, encode_frame
from mavdem.ingest.mavlink.framing import frames_at
from mavdem.ingest.mavlink.vehicles import FrameStream
from mavdem.ingest.vocabulary import AUTOPILOT_COMPONENT
from sitl_scenarios.mavlink.autopilots import AUTOPILOTS, Autopilot
from sitl_scenarios.mavlink.messages import message_payloads, parameters, payload
from sitl_scenarios.motion import Array, Motion, Pair
from sitl_scenarios.plan import BOOT_SECONDS, total_seconds
from sitl_scenarios.scenario import Scenario

Rows = NDArray[np.intp]


TimedFrame = tuple[float, bytes]
"""The time at which a frame is sent or received, s of the flight, and its bytes."""

EARLY_SECONDS = 0.5e-6
"""Seconds before it is due that a message may be sent: half of what times are rounded to, so that none is a tie."""


class Schedule:
    """Times at which each message is sent, at constant intervals.

    ``usual_rates`` are the rates that it begins with, Hz by message; 0 for a message that is not sent.
    """

    def __init__(
        self, usual_rates: Mapping[str, float], start: float, cycle: float, autopilot: Autopilot
    ) -> None:
        """Schedules all messages.

        Intervals are rounded down to whole numbers of the autopilot's step, and none is shorter than a cycle.

        Args:
            usual_rates: Rate of each message, Hz; 0 for one that is not sent.
            start: Time of the first messages, s. Some autopilots begin each stream a cycle after the one before.
            cycle: Period of the autopilot's loop, s.
            autopilot: Autopilot that sends the messages.
        """
        self.usual_rates = dict(usual_rates)
        self._step = autopilot.interval_step
        self._cycle = cycle
        # Time of the first message and interval, s, of each stream, and how many of it have been sent.
        self._streams: dict[str, Pair] = {}
        self._sent_counts: dict[str, int] = {}
        for number, (name, rate) in enumerate(usual_rates.items()):
            interval = 1 / rate if rate else np.inf
            first = start
            if autopilot.apart:
                first = start + number * cycle
            self.set(name, interval, first)

    def set(self, name: str, interval: float, start: float) -> None:
        """Sends a message every ``interval`` s from ``start``, s, on; never, when the interval is infinite."""
        if np.isfinite(interval / self._step):
            # The loop sends each message at most once in a cycle.
            whole_steps = int(interval / self._step + 1e-6) * self._step
            interval = max(whole_steps, self._cycle)
        self._streams[name] = (start, interval)
        self._sent_counts[name] = 0

    def interval(self, name: str) -> float:
        """Returns the seconds between one message and the next; infinite for none."""
        return self._streams[name][1]

    def due(self, name: str, times: Array) -> Rows:
        """Returns in which of the next cycles a message is sent, and counts it as sent.

        Args:
            name: Name of the message.
            times: Time of each cycle, s, ascending from call to call; (N,).

        Returns:
            (k,) indices of the cycles.
        """
        first, interval = self._streams[name]
        if not np.isfinite(interval):
            return np.empty(0, dtype=np.intp)
        periods = np.floor((times + EARLY_SECONDS - first) / interval)
        due_counts = np.maximum(periods + 1, 0)
        newly_due = np.diff(due_counts, prepend=self._sent_counts[name])
        rows = np.flatnonzero(newly_due)
        self._sent_counts[name] = int(due_counts[-1])
        return rows


MAVPROXY_SECONDS = 15.0
"""Time between MAVProxy's requests for all streams, s: ``set_stream_rates`` in its mavproxy.py."""

FIRST_MESSAGE_SECONDS = 0.01
"""Time of the first messages after boot, s: at zero, they would seem to have no time stamp."""

REBOOT_SECONDS = 1.0
"""Time without messages when the autopilot reboots in flight, s; a choice."""


class OutgoingMessage(NamedTuple):
    """A message that is sent in one of the cycles of a block."""

    row: int
    """Row of the block."""
    name: str
    """Name of the message."""
    payload: bytes
    """Its payload."""


class Transmitter:
    """The sending side of an autopilot: scheduled messages, replies, and the effects of reboots and clock jumps.

    Its scheduled messages do not depend on how a flight is cut into blocks. ``schedule`` and ``clock``, the time at the
    end of the last block in s, are on the boot clock; ``system`` is the MAVLink system id.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Begins at boot; raises ValueError if the scenario has rates of a message that is not sent."""
        self.autopilot = AUTOPILOTS[scenario.stream.autopilot]
        self.system = scenario.stream.system
        self._rates = self.autopilot.rates(scenario.stream.rate, scenario.stream.rates)
        if scenario.stream.only_when_asked:
            unrequested = {"HEARTBEAT", *scenario.stream.rates}
            self._rates = {
                name: rate if name in unrequested else 0.0 for name, rate in self._rates.items()
            }
        self._scenario = scenario
        self._replies: list[OutgoingMessage] = []
        self._events = sorted(self._fault_events(), key=itemgetter(0))
        self._arming_time = np.inf
        self._boot(0.0, FIRST_MESSAGE_SECONDS)

    def send(self, motion: Motion) -> list[TimedFrame]:
        """Sends the messages of the next block of a flight.

        Args:
            motion: Rows of the block, one at least.

        Returns:
            Frames with the times of the motion at which they are sent.
        """
        armed = motion.time[motion.armed]
        if len(armed):
            self._arming_time = min(self._arming_time, float(armed[0]))
        frames: list[TimedFrame] = []
        next_row = 0
        while self._events:
            after_arming, event = self._events[0]
            row = int(np.searchsorted(motion.time, self._arming_time + after_arming))
            if row == len(motion):
                break
            frames += self._block_frames(motion[next_row:row])
            event(float(motion.time[row]))
            next_row = row
            del self._events[0]
        return frames + self._block_frames(motion[next_row:])

    def send_once(self, name: str, **values: object) -> None:
        """Sends a message once, with the next block; fields that are not given are zero."""
        self._replies.append(OutgoingMessage(0, name, payload(name, **values).tobytes()))

    def send_parameters(self, name: str = "") -> None:
        """Sends all parameters, or the one of this name, with the next block, as PARAM_VALUE messages."""
        for index, parameter in enumerate(self.parameters):
            if name not in ("", parameter.name):
                continue
            self.send_once(
                "PARAM_VALUE",
                param_id=parameter.name.encode(),
                param_value=parameter.encoded(self.autopilot.bitwise),
                param_type=parameter.kind,
                param_count=len(self.parameters),
                param_index=index,
            )

    def _fault_events(self) -> Iterator[tuple[float, Callable[[float], None]]]:
        """Yields the scenario's faults of the autopilot: seconds after arming, and the method to call then.

        The method is given the time of the motion, s.
        """
        faults = self._scenario.faults
        if faults.mavproxy_rate:
            end = total_seconds(self._scenario)
            for time in np.arange(0.0, end, MAVPROXY_SECONDS).tolist():
                yield time, self._set_all_streams
        if faults.reboot is not None:
            yield faults.reboot, lambda now: self._boot(now, now + REBOOT_SECONDS)
        if faults.clock_jump is not None:
            yield faults.clock_jump, self._jump_clock

    def _set_all_streams(self, _: float) -> None:
        """Sets all groups of messages to MAVProxy's rate, like REQUEST_DATA_STREAM; other messages stay as they are."""
        interval = 1 / self._scenario.faults.mavproxy_rate
        for group in self.autopilot.groups.values():
            for name in group:
                change = abs(self.schedule.interval(name) - interval)
                if change >= self.autopilot.interval_step:
                    self.schedule.set(name, interval, self.clock)

    def _jump_clock(self, _: float) -> None:
        """Moves the boot clock ahead, as that of a paused simulator."""
        self._boot_time -= self._scenario.faults.clock_jump_seconds

    def _boot(self, boot: float, first: float) -> None:
        """Boots the autopilot: clock, sequence numbers, parameters and rates begin anew.

        Args:
            boot: Time of the motion at which the boot clock is zero, s.
            first: Time of the motion from which on messages are sent, s.
        """
        self._boot_time = boot
        self._first_time = first
        self._sequence = 0
        self.clock = first - boot
        self.schedule = self._initial_schedule(self.clock)
        self.parameters = parameters(self._scenario, self.autopilot)
        if not self._scenario.stream.only_when_asked:
            self.send_parameters()
        text = f"Simulated by mavdem, frame {self._scenario.vehicle.layout}"
        self.send_once("STATUSTEXT", severity=6, text=text.encode())  # MAV_SEVERITY_INFO
        # The schedule begins at the first cycle in which messages are sent.
        self._is_first_block = True

    def _initial_schedule(self, start: float) -> Schedule:
        """Returns the schedule after boot, which begins at a time of the boot clock, s."""
        return Schedule(self._rates, start, self._scenario.cycle, self.autopilot)

    def _block_frames(self, motion: Motion) -> list[TimedFrame]:
        """Returns the frames that are sent during some rows without an event, in order of time."""
        first_row = int(np.searchsorted(motion.time, self._first_time))
        motion = motion[first_row:]
        if not len(motion):
            return []
        clock = motion.time - self._boot_time
        if self._is_first_block:
            self.schedule = self._initial_schedule(float(clock[0]))
            self._is_first_block = False
        self.clock = float(clock[-1])
        messages = [*self._replies, *self._scheduled_messages(motion, clock)]
        messages.sort(key=attrgetter("row"))
        self._replies = []
        sender = FrameSender(self.system, AUTOPILOT_COMPONENT)
        frames = []
        for row, name, content in messages:
            frame = encode_frame(content, definitions_by_name()[name], sender, self._sequence)
            self._sequence = (self._sequence + 1) % 256
            frames.append((float(motion.time[row]), frame))
        return frames

    def _scheduled_messages(self, motion: Motion, clock: Array) -> Iterator[OutgoingMessage]:
        """Yields the scheduled messages of some rows, stream by stream.

        Args:
            motion: N rows of the flight.
            clock: Their times on the boot clock, s; (N,).
        """
        for name in self._rates:
            rows = self.schedule.due(name, clock)
            if len(rows):
                boot = np.round(clock[rows] * 1e6).astype(np.int64)
                payloads = message_payloads(name, motion[rows], boot, self.autopilot)
                for row, content in zip(rows.tolist(), payloads, strict=True):
                    yield OutgoingMessage(row, name, content.tobytes())


LINK_KEY = 0x6C696E6B
"""Key of the link's random numbers: the letters "link" in ASCII."""


class LossyLink:
    """A link that loses, delays and reorders frames by a scenario's faults.

    Its effect on a frame depends only on the seed and on the number of frames before. A frame that is late delays those
    behind it: only a frame that the link reorders is overtaken.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Takes the faults and the random seed of a scenario."""
        self._faults = scenario.faults
        # The key makes its random numbers independent of all others with the same seed.
        sequence = np.random.SeedSequence(scenario.seed, spawn_key=(LINK_KEY,))
        self._random = default_rng(sequence)
        self._latest = -np.inf
        self._held: TimedFrame | None = None

    def pass_on(self, sent: list[TimedFrame]) -> Iterator[TimedFrame]:
        """Yields the frames that arrive, with their times of arrival, s of the flight.

        A frame that is to be overtaken is held until the next one arrives.
        """
        faults = self._faults
        chances = self._random.random((len(sent), 3)).tolist()
        for (time, frame), (lost, late, overtaken) in zip(sent, chances, strict=True):
            if lost < faults.loss or self.is_lost(time):
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

    def is_lost(self, time: float) -> bool:
        """Returns whether the whole link is lost at a time, s of the motion."""
        begin = self._faults.outage
        return begin is not None and 0 <= time - BOOT_SECONDS - begin < self._faults.outage_seconds

    def held_frames(self) -> list[TimedFrame]:
        """Returns the frame that waits to be overtaken at the end of the flight, if there is one."""
        return [] if self._held is None else [self._held]


BLOCK_CYCLES = 1 << 14
"""Number of cycles whose frames are made together."""

FIRST_BOOT = 1_767_225_600_000_000
"""Time of the first boot with seed 0: 1 January 2026, 0:00 UTC, in µs since 1970."""

DAY = 86_400_000_000
"""A day in µs: flights of different seeds begin on different days, so that no two are taken for one flight."""


def recorded(scenario: Scenario, motion: Motion) -> FrameStream:
    """Returns the frames of a flight that arrive, stamped with their times of arrival, as a ground station has them.

    Raises:
        ValueError: The scenario has rates of a message that is not sent.
    """
    transmitter = Transmitter(scenario)
    link = LossyLink(scenario)
    received: list[TimedFrame] = []
    for begin in range(0, len(motion), BLOCK_CYCLES):
        received += link.pass_on(transmitter.send(motion[begin : begin + BLOCK_CYCLES]))
    received += link.held_frames()
    data = np.frombuffer(b"".join(frame for _, frame in received), dtype=np.uint8)
    sizes = np.array([len(frame) for _, frame in received], np.int64)
    frames = frames_at(data, np.cumsum(sizes) - sizes)
    boot = FIRST_BOOT + scenario.seed % 1000 * DAY
    stamps = boot + np.round([1e6 * time for time, _ in received])
    return FrameStream("simulation", "simulation", data, frames, stamps.astype(np.uint64), 0, ())
