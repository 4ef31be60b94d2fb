"""Transmitter: MAVLink frames of a simulated autopilot, sent at scheduled rates and passed over a lossy link."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from operator import attrgetter, itemgetter
from typing import NamedTuple

import numpy as np
from numpy.random import default_rng
from numpy.typing import NDArray

from mavdem.ingest.mavlink.dialect import definitions_by_name
from mavdem.ingest.mavlink.frame_stream import FrameStream
from mavdem.ingest.mavlink.framing import frames_at
from mavdem.ingest.mavlink.payloads import FrameSender, encode_frame, filled_payloads
from mavdem.ingest.mavlink.sequence_counters import SEQUENCE_NUMBERS
from mavdem.ingest.vocabulary import AUTOPILOT_COMPONENT, SCENARIO_TEXT
from sitl_scenarios.mavlink.autopilots import AUTOPILOTS, Autopilot
from sitl_scenarios.mavlink.messages import message_payloads, parameters
from sitl_scenarios.mishaps.instruments import InstrumentedMotion
from sitl_scenarios.mishaps.specs import Restart, SecondLink, SecondVehicle
from sitl_scenarios.mishaps.texts import WATCHDOG_TEXT
from sitl_scenarios.motion import Array, Motion
from sitl_scenarios.plan import BOOT_SECONDS, total_seconds
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly

Rows = NDArray[np.intp]


TimedFrame = tuple[float, bytes]
"""The time at which a frame is sent or received, s of the flight, and its bytes."""

EARLY_SECONDS = 0.5e-6
"""Seconds before it is due that a message may be sent: half the step to which times are rounded, to avoid ties."""


class MessageStream(NamedTuple):
    """A message that is sent at constant intervals."""

    first_time: float
    """Time of the first message, s."""
    interval: float
    """Time from one message to the next, s; infinite if it is not sent."""


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
        # The stream of each message, and how many messages of it have been sent.
        self._streams: dict[str, MessageStream] = {}
        self._sent_counts: dict[str, int] = {}
        # Messages that are not sent at intervals, but were requested (REQUEST_MESSAGE): sent once in the next cycle.
        self._requested_once: set[str] = set()
        for number, (name, rate) in enumerate(usual_rates.items()):
            interval = 1 / rate if rate else np.inf
            first = start
            if autopilot.staggers_streams:
                first = start + number * cycle
            self.set_interval(name, interval, first)

    def set_interval(self, name: str, interval: float, start: float) -> None:
        """Sets the interval of a message from some time on, as the command SET_MESSAGE_INTERVAL does.

        Args:
            name: Name of the message.
            interval: Time from one message to the next, s, which is rounded down to whole steps of the autopilot's
                clock; infinite for a message that is not sent.
            start: Time of the first message, s.
        """
        if np.isfinite(interval / self._step):
            # The autopilot counts whole steps; the tolerance of a millionth keeps rounding from losing one. The loop
            # sends each message at most once in a cycle.
            whole_steps = int(interval / self._step + 1e-6) * self._step
            interval = max(whole_steps, self._cycle)
        self._streams[name] = MessageStream(start, interval)
        self._sent_counts[name] = 0

    def interval(self, name: str) -> float:
        """Returns the seconds between one message and the next; infinite for none."""
        return self._streams[name].interval

    def send_next(self, name: str, now: float) -> None:
        """Lets a message be sent in the next cycle, as the command REQUEST_MESSAGE does.

        If the message is sent at intervals, the intervals count from then on; otherwise it is sent once.

        Args:
            name: Name of the message.
            now: Time of the request, s.
        """
        interval = self.interval(name)
        if np.isfinite(interval):
            self.set_interval(name, interval, now)
        else:
            self._requested_once.add(name)

    def due_cycles(self, name: str, times: Array) -> Rows:
        """Returns in which of the next cycles a message is sent, and counts it as sent.

        By the time t, floor((t − first_time) / interval) + 1 messages of a stream are due. A cycle sends one if this
        number has risen since the cycle before. So the result does not depend on how the cycles are cut into calls.

        A message with an infinite interval is sent only if it was requested (:meth:`send_next`): once, in the first of
        these cycles.

        Args:
            name: Name of the message.
            times: Time of each cycle, s, ascending from call to call; (N,).

        Returns:
            (k,) indices of the cycles; empty without cycles.
        """
        no_cycle = np.empty(0, dtype=np.intp)
        if not len(times):
            return no_cycle
        stream = self._streams[name]
        if not np.isfinite(stream.interval):
            if name not in self._requested_once:
                return no_cycle
            self._requested_once.discard(name)
            return np.zeros(1, dtype=np.intp)
        # If rounding moved the time of a message to just after a cycle, the message still belongs to this cycle.
        periods = np.floor((times + EARLY_SECONDS - stream.first_time) / stream.interval)
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


class _FaultEvent(NamedTuple):
    """Something that goes wrong with the autopilot during the flight."""

    time: float
    """Time after the first arming, s."""

    happen: Callable[[float], None]
    """Makes it happen; it is called with the time of the motion, s."""


class Transmitter:
    """The sending side of an autopilot: scheduled messages, replies, and the effects of reboots and clock jumps.

    Its scheduled messages do not depend on how a flight is cut into blocks. ``schedule`` and ``clock``, the time at the
    end of the last block in s, are on the boot clock; ``system`` is the MAVLink system id.
    """

    def __init__(self, scenario: Scenario, first_sequence: int = 0) -> None:
        """Boots the autopilot.

        Args:
            scenario: Scenario with the autopilot, its message rates, MAVLink system id and faults.
            first_sequence: Sequence number of its first frame after each boot.

        Raises:
            ValueError: The scenario has a rate of a message that the autopilot does not send.
        """
        self.autopilot = AUTOPILOTS[scenario.stream.autopilot]
        self.system = scenario.stream.system
        self._rates = self.autopilot.rates(
            scenario.stream.rate, scenario.stream.rates, scenario.has_instruments
        )
        if scenario.stream.only_when_asked:
            # All others wait for a request.
            unrequested = {"HEARTBEAT", *scenario.stream.rates}
            self._rates = {
                name: rate if name in unrequested else 0.0 for name, rate in self._rates.items()
            }
        self._scenario = scenario
        self._first_sequence = first_sequence
        # Messages that are sent once, with the next block.
        self._replies: list[OutgoingMessage] = []
        # Faults that are still to come, in order of time. Their times count from the first arming.
        self._events = sorted(self._fault_events(), key=lambda event: event.time)
        self._arming_time = np.inf
        self._boot(0.0, FIRST_MESSAGE_SECONDS)

    def send(self, motion: Motion) -> list[TimedFrame]:
        """Sends the messages of the next block of a flight.

        Faults such as a reboot change clock and schedule in the middle of a block. So the block is cut at each fault:
        the rows before it are sent, then the fault happens, and sending goes on.

        Args:
            motion: Rows of the block, one for each cycle of the autopilot, one at least.

        Returns:
            Frames in order of time, with the times of the motion, s, at which they are sent.
        """
        armed_times = motion.time[motion.armed]
        if len(armed_times):
            self._arming_time = min(self._arming_time, float(armed_times[0]))
        frames: list[TimedFrame] = []
        next_row = 0
        while self._events:
            after_arming, trigger_fault = self._events[0]
            # Before arming the time is infinite, and no row reaches it.
            event_row = int(np.searchsorted(motion.time, self._arming_time + after_arming))
            if event_row == len(motion):
                # This fault, and all after it, come in a later block.
                break
            frames += self._block_frames(motion[next_row:event_row])
            trigger_fault(float(motion.time[event_row]))
            next_row = event_row
            del self._events[0]
        return frames + self._block_frames(motion[next_row:])

    def send_once(self, name: str, **values: object) -> None:
        """Sends a message once, with the next block; fields that are not given are zero."""
        self._replies.append(OutgoingMessage(0, name, filled_payloads(name, **values).tobytes()))

    def send_parameters(self, name: str = "") -> None:
        """Sends parameters with the next block, one PARAM_VALUE message for each.

        Args:
            name: Name of one parameter; empty for all. No message is sent for a name that the autopilot does not have.
        """
        for index, parameter in enumerate(self.parameters):
            if name not in ("", parameter.name):
                continue
            self.send_once(
                "PARAM_VALUE",
                param_id=parameter.name.encode(),
                param_value=parameter.float32_value(bitwise=self.autopilot.bitwise),
                param_type=parameter.mavlink_type,
                param_count=len(self.parameters),
                param_index=index,
            )

    def change_parameter(self, name: str, value: float) -> None:
        """Changes the value of a parameter that the autopilot reports; a reboot keeps it."""
        self._scenario = self._scenario.with_parameter(name, value)
        self.parameters = parameters(self._scenario, self.autopilot)

    def _fault_events(self) -> Iterator[_FaultEvent]:
        """Yields the faults that change clock, schedule or rates of the autopilot, in any order.

        A scenario is a simulated flight that may have such faults: a second ground station that requests other rates, a
        restart by the watchdog in flight, a reboot, and a jump of the clock.

        Yields:
            Time of each fault, s after arming, with the method that lets it happen.
        """
        faults = self._scenario.faults
        if faults.mavproxy_rate:
            # The second ground station, MAVProxy, requests its rate again and again until the end of the scenario.
            end = total_seconds(self._scenario)
            for time in np.arange(0.0, end, MAVPROXY_SECONDS).tolist():
                yield _FaultEvent(time, self._set_mavproxy_rates)
        if isinstance(self._scenario.mishap, Restart):
            yield _FaultEvent(self._scenario.mishap.start, self._restart_by_watchdog)
        if faults.reboot is not None:
            yield _FaultEvent(faults.reboot, self._reboot)
        if faults.clock_jump is not None:
            yield _FaultEvent(faults.clock_jump, self._jump_clock)

    def _set_mavproxy_rates(self, _: float) -> None:
        """Sets all groups of messages to MAVProxy's rate, as its requests by REQUEST_DATA_STREAM do.

        Messages that belong to no group keep their rates. A message whose interval hardly changes keeps its schedule,
        instead of restarting it.

        Args:
            _: Time of the motion, s. All functions of fault events are called with it; this one does not need it.
        """
        requested_interval = 1 / self._scenario.faults.mavproxy_rate
        for group in self.autopilot.groups.values():
            for name in group:
                change = abs(self.schedule.interval(name) - requested_interval)
                # The autopilot stores intervals in steps, and so ignores a smaller change.
                if change >= self.autopilot.interval_step:
                    self.schedule.set_interval(name, requested_interval, self.clock)

    def _reboot(self, time: float) -> None:
        """Boots the autopilot again at a time of the motion, s; it sends messages after ``REBOOT_SECONDS``."""
        self._boot(time, time + REBOOT_SECONDS)

    def _restart_by_watchdog(self, time: float) -> None:
        """Boots the autopilot again in flight, and sends the text with the reason of the reboot."""
        self._reboot(time)
        # MAV_SEVERITY_CRITICAL
        self.send_once("STATUSTEXT", severity=2, text=WATCHDOG_TEXT[:50].encode())

    def _jump_clock(self, _: float) -> None:
        """Moves the boot clock ahead, as a simulator does that was paused."""
        self._boot_time -= self._scenario.faults.clock_jump_seconds

    def _boot(self, boot_time: float, first_time: float) -> None:
        """Boots the autopilot, at the beginning or again in flight: clock, sequence numbers and rates restart.

        In the first block after boot it reports its frame, and its parameters too unless messages are sent only on
        request.

        Args:
            boot_time: Time of the motion at which the boot clock is zero, s.
            first_time: Time of the motion from which on messages are sent, s.
        """
        self._boot_time = boot_time
        self._first_time = first_time
        self._sequence = self._first_sequence
        self.clock = first_time - boot_time
        self.schedule = self._initial_schedule(self.clock)
        self.parameters = parameters(self._scenario, self.autopilot)
        if not self._scenario.stream.only_when_asked:
            self.send_parameters()
        text = f"{SCENARIO_TEXT}, frame {self._scenario.vehicle.layout}"
        self.send_once("STATUSTEXT", severity=6, text=text.encode())  # MAV_SEVERITY_INFO
        # The schedule begins at the first cycle in which messages are sent.
        self._is_first_block = True

    def _initial_schedule(self, start: float) -> Schedule:
        """Returns the schedule after boot, which begins at a time of the boot clock, s."""
        return Schedule(self._rates, start, self._scenario.cycle, self.autopilot)

    def _block_frames(self, motion: Motion) -> list[TimedFrame]:
        """Returns the frames that the autopilot sends in successive cycles between two faults.

        Messages that are due by the schedule are sent, and in the first cycle the replies that wait. In the first block
        after a boot the schedule begins. The ``clock`` moves to the last cycle.

        Args:
            motion: Rows of the flight, one for each of these cycles; there may be none.

        Returns:
            Frames in order of time, with the times of the motion at which they are sent, s.
        """
        # While the autopilot boots, it sends nothing.
        first_row = int(np.searchsorted(motion.time, self._first_time))
        motion = motion[first_row:]
        if not len(motion):
            return []
        boot_clock = motion.time - self._boot_time
        if self._is_first_block:
            self.schedule = self._initial_schedule(float(boot_clock[0]))
            self._is_first_block = False
        self.clock = float(boot_clock[-1])
        messages = [*self._replies, *self._scheduled_messages(motion, boot_clock)]
        self._replies = []
        # The sort is stable: within a cycle, messages keep the order of replies and streams.
        messages.sort(key=attrgetter("row"))
        return self._numbered_frames(messages, motion.time)

    def _numbered_frames(self, messages: list[OutgoingMessage], times: Array) -> list[TimedFrame]:
        """Encodes messages as frames with consecutive sequence numbers, by which a receiver finds lost frames.

        Args:
            messages: Messages in the order in which they are sent.
            times: Time of each row of the motion (N,), s.

        Returns:
            A frame for each message, with the time of its row.
        """
        sender = FrameSender(self.system, AUTOPILOT_COMPONENT)
        definitions = definitions_by_name()
        row_times = times.tolist()
        frames = []
        for row, name, content in messages:
            frame = encode_frame(content, definitions[name], sender, self._sequence)
            frames.append((row_times[row], frame))
            # The sequence number is one byte.
            self._sequence = (self._sequence + 1) % SEQUENCE_NUMBERS
        return frames

    def _scheduled_messages(self, motion: Motion, clock: Array) -> Iterator[OutgoingMessage]:
        """Yields the messages that are due in some samples of the flight, stream by stream.

        Args:
            motion: N samples of the flight.
            clock: Times (N,) of the samples on the boot clock, s.

        Yields:
            Messages with the index of the sample in which each is sent.
        """
        if isinstance(motion, InstrumentedMotion):
            for row in np.flatnonzero(motion.text != "").tolist():
                text = str(motion.text[row]).encode()
                payload = filled_payloads("STATUSTEXT", severity=motion.severity[row], text=text)
                yield OutgoingMessage(row, "STATUSTEXT", payload.tobytes())
        for name in self._rates:
            rows = self.schedule.due_cycles(name, clock)
            if not len(rows):
                continue
            boot_microseconds = np.round(clock[rows] * 1e6).astype(np.int64)
            payloads = message_payloads(name, motion[rows], boot_microseconds, self.autopilot)
            # The payloads of all rows are one after the other in memory, each of the same size.
            size = payloads.itemsize
            content = payloads.tobytes()
            for number, row in enumerate(rows.tolist()):
                payload_start = number * size
                yield OutgoingMessage(row, name, content[payload_start : payload_start + size])


LINK_KEY = 0x6C696E6B
"""Key of the link's random numbers: the letters "link" in ASCII."""


class LossyLink:
    """A link that loses, delays and reorders frames by a scenario's faults.

    Its effect on a frame depends only on the seed and on the number of frames before. A frame that is late delays those
    behind it: only a frame that the link reorders is overtaken.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Takes the faults and the random seed of a scenario."""
        faults = scenario.faults
        self._faults = faults
        self._is_perfect = not any(
            (faults.loss, faults.delay, faults.jitter, faults.reordered, faults.outage)
        )
        # The key makes its random numbers independent of all others with the same seed.
        sequence = np.random.SeedSequence(scenario.seed, spawn_key=(LINK_KEY,))
        self._random = default_rng(sequence)
        self._latest = -np.inf
        self._overtaken_frame: TimedFrame | None = None

    def pass_on(self, sent_frames: list[TimedFrame]) -> Iterator[TimedFrame]:
        """Passes frames over the link: some are lost, all are late, and some are overtaken by the next one.

        Each frame gets three uniform random numbers, whether they are used or not, so that one fault does not change
        the random numbers of another. A frame that is to be overtaken is held until the next one arrives; then the two
        swap their times of arrival. If none follows in this call, it is held until the next call, or until
        :meth:`held_frames` at the end of the flight.

        Args:
            sent_frames: Frames with the times at which they are sent, s of the flight, ascending.

        Yields:
            The frames that arrive, with their times of arrival, s of the flight, ascending.
        """
        # The random numbers of frames take a quarter of the time of making and writing them.
        if self._is_perfect:
            yield from sent_frames
            return
        faults = self._faults
        random_numbers = self._random.random((len(sent_frames), 3)).tolist()
        for (time, frame), numbers in zip(sent_frames, random_numbers, strict=True):
            loss_number, jitter_number, order_number = numbers
            if loss_number < faults.loss or self.is_in_outage(time):
                continue
            # A link keeps its order: a frame cannot arrive before the one that was sent before it.
            arrival = time + faults.delay + faults.jitter * jitter_number
            self._latest = max(arrival, self._latest)
            if self._overtaken_frame is not None:
                earlier_arrival, overtaken_frame = self._overtaken_frame
                self._overtaken_frame = None
                yield earlier_arrival, frame
                yield self._latest, overtaken_frame
            elif order_number < faults.reordered:
                self._overtaken_frame = self._latest, frame
            else:
                yield self._latest, frame

    def is_in_outage(self, time: float) -> bool:
        """Returns whether the link passes no frame at a time of the motion, s, because of the scenario's outage."""
        outage_start = self._faults.outage
        if outage_start is None:
            return False
        # Times of a scenario count from the arming.
        seconds_of_outage = time - BOOT_SECONDS - outage_start
        return 0 <= seconds_of_outage < self._faults.outage_seconds

    def held_frames(self) -> list[TimedFrame]:
        """Returns the frame that waits to be overtaken at the end of the flight, if there is one."""
        return [] if self._overtaken_frame is None else [self._overtaken_frame]


def with_second_sender(scenario: Scenario, received_frames: list[TimedFrame]) -> list[TimedFrame]:
    """Adds the frames of a second link or of a second vehicle, if the scenario's mishap has one.

    A second link repeats all frames later.

    Args:
        scenario: Scenario of the flight: vehicle, wind, excitation, sensors and faults.
        received_frames: Frames of the vehicle with their times of arrival, s, ascending.

    Returns:
        Frames with their times of arrival, s, ascending.
    """
    mishap = scenario.mishap
    if isinstance(mishap, SecondLink):
        added_frames = [(time + mishap.delay, frame) for time, frame in received_frames]
    elif isinstance(mishap, SecondVehicle):
        added_frames = _frames_of_second_vehicle(scenario, mishap)
    else:
        return received_frames
    return sorted(received_frames + added_frames, key=itemgetter(0))


def _frames_of_second_vehicle(scenario: Scenario, mishap: SecondVehicle) -> list[TimedFrame]:
    """Returns the frames of a second vehicle that has the same system id, and is received by the same ground station.

    It flies the same plan further east, with another seed, and counts its own frames. Its boot clock is ahead of the
    first vehicle's. Its stream begins ``SECOND_VEHICLE_SECONDS`` after the first stream.

    Args:
        scenario: Scenario of the first vehicle.
        mishap: Distance of the second vehicle to the east, m, and how far its boot clock is ahead, s.

    Returns:
        Frames with their times of arrival, s, on the clock of the first vehicle.
    """
    motion = fly(scenario.model_copy(update={"seed": scenario.seed + 1}))
    displacement = np.array([0.0, mishap.metres, 0.0])
    # The transmitter takes the times of the motion for the boot clock in messages, and for the times of the frames.
    motion = replace(
        motion,
        time=motion.time + mishap.boot,
        position=motion.position + displacement,
        known_position=motion.known_position + displacement,
    )
    if isinstance(motion, InstrumentedMotion):
        motion = replace(motion, fix=motion.fix + displacement)
    shift = SECOND_VEHICLE_SECONDS - mishap.boot
    return [(time + shift, frame) for time, frame in Transmitter(scenario).send(motion)]


SECOND_VEHICLE_SECONDS = 0.5
"""Time by which the stream of a second vehicle begins later, s; a choice."""

BLOCK_CYCLES = 1 << 14
"""Number of cycles whose frames are made together."""

FIRST_BOOT = 1_767_225_600_000_000
"""Time of the first boot with seed 0: 1 January 2026, 0:00 UTC, in µs since 1970."""

DAY = 86_400_000_000
"""A day in µs: flights of different seeds begin on different days, so that no two are taken for one flight."""


def recorded_stream(scenario: Scenario, motion: Motion) -> FrameStream:
    """Makes the MAVLink stream that a ground station records of a simulated flight.

    The autopilot's frames are passed over the scenario's link. Those that arrive are stamped with their times of
    arrival in µs since 1970, as in a telemetry log. The flights of different seeds begin on different days.

    Args:
        scenario: Scenario of the flight, with autopilot, message rates, faults and seed.
        motion: The flight, one row for each cycle of the autopilot.

    Returns:
        The frames that arrive, with their times of arrival.

    Raises:
        ValueError: The scenario has rates of a message that is not sent.
    """
    transmitter = Transmitter(scenario)
    link = LossyLink(scenario)
    received_frames: list[TimedFrame] = []
    for first_row in range(0, len(motion), BLOCK_CYCLES):
        sent_frames = transmitter.send(motion[first_row : first_row + BLOCK_CYCLES])
        received_frames += link.pass_on(sent_frames)
    # At the end of the flight a frame may still wait to be overtaken by the next one.
    received_frames += link.held_frames()
    # The scenario may have a second link, which repeats all frames, or a second vehicle.
    received_frames = with_second_sender(scenario, received_frames)
    # All frames are stored as one array of bytes, with the index at which each frame begins.
    data = np.frombuffer(b"".join(frame for _, frame in received_frames), dtype=np.uint8)
    sizes = np.array([len(frame) for _, frame in received_frames], np.int64)
    frame_starts = np.cumsum(sizes) - sizes
    frames = frames_at(data, frame_starts)
    stamps = _receive_stamps(scenario, [time for time, _ in received_frames])
    return FrameStream(
        source="simulation",
        file_ending="simulation",
        data=data,
        frames=frames,
        # A stream has a function from rows of the frames to their stamps, so that a reader of a file decodes only those
        # that are needed. Here all stamps are in an array, whose method for [] is such a function.
        receive_stamps=stamps.__getitem__,
        bytes_skipped=0,
        repairs=(),
    )


def _receive_stamps(scenario: Scenario, times: list[float]) -> NDArray[np.uint64]:
    """Returns stamps of frames in µs since 1970, for which each seed of a scenario has another day.

    Args:
        scenario: Scenario of the flight, with its seed.
        times: Time of arrival of each of the N frames, s since boot.

    Returns:
        Stamps (N,).
    """
    # The remainder keeps the dates within three years.
    boot_stamp = FIRST_BOOT + scenario.seed % 1000 * DAY
    microseconds = np.round([1e6 * time for time in times])
    return (boot_stamp + microseconds).astype(np.uint64)
