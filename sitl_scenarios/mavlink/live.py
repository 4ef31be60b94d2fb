"""A simulated vehicle on the network: sends, receives and obeys a ground station while it flies.

Sources: https://mavlink.io/en/services/command.html, https://mavlink.io/en/services/parameter.html,
https://mavlink.io/en/services/mission.html; where the autopilots differ, ``sitl_scenarios.mavlink.autopilots``.
"""

from __future__ import annotations

import ipaddress
import select
import socket
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from math import inf, isfinite
from time import monotonic
from typing import Any, NamedTuple

import numpy as np

from mavdem.ingest.mavlink.definitions import columns, definitions, seeds
from mavdem.ingest.mavlink.framing import GOOD, find_frames
from sitl_scenarios.mavlink.autopilots import CRITICAL, DENIED, FAILED
from sitl_scenarios.mavlink.transmitter import COMPONENT, LossyLink, Transmitter
from sitl_scenarios.motion import Holding
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import Simulation

BROADCAST_ID = 0  # Target system or component of messages to all
UNDERSTOOD = frozenset(
    {"COMMAND_LONG", "COMMAND_INT", "PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"}
    | {"REQUEST_DATA_STREAM", "MISSION_REQUEST_LIST"}
)
"""Messages that are answered; each names its target."""


class Received(NamedTuple):
    """A message of ``name`` with its ``fields`` from ``system`` and ``component``."""

    name: str
    fields: dict[str, Any]
    system: int
    component: int


def addressed_messages(
    datagram: bytes, system: int, component: int, most: int | None = None
) -> list[Received]:
    """The messages in a datagram, ``most`` at most, that are understood and meant for this component, or for all."""
    data = np.frombuffer(datagram, dtype=np.uint8)
    understood = []
    for frames in find_frames(data, seeds()):
        for row in np.flatnonzero(frames.verdict == GOOD).tolist():
            definition = definitions()[int(frames.message_id[row])]
            if definition.name not in UNDERSTOOD:
                continue
            read = columns(data, frames.start[row : row + 1], definition)
            fields = {name: values[0] for name, values in read.items()}
            to_system = fields["target_system"]
            to_component = fields["target_component"]
            if to_system in (system, BROADCAST_ID) and to_component in (component, BROADCAST_ID):
                sender = int(frames.system[row]), int(frames.component[row])
                understood.append(Received(definition.name, fields, *sender))
            if len(understood) == most:
                return understood
    return understood


# MAV_RESULT
ACCEPTED = 0
UNSUPPORTED = 3
ARM_DISARM = 400
GET_INTERVAL = 510
SET_INTERVAL = 511
REQUEST_MESSAGE = 512
"""MAV_CMD_COMPONENT_ARM_DISARM, _GET_MESSAGE_INTERVAL, _SET_MESSAGE_INTERVAL and _REQUEST_MESSAGE."""
# What MAV_CMD_COMPONENT_ARM_DISARM's second parameter must be to stop the motors in the air
FORCE = 21196
MAX_REPORTED = 20  # Changes of rates that are reported: some ground stations ask again and again


class CommandHandler:
    """Executes a vehicle's commands, ``accepted`` so many; ``report`` is called with a sentence when rates change."""

    def __init__(
        self,
        transmitter: Transmitter,
        simulation: Simulation,
        report: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._transmitter = transmitter
        self._simulation = simulation
        self._report = report
        self._reported = 0
        self.accepted = 0

    def answer(self, received: Received) -> None:
        """Does what a message asks for; the reply goes out with the transmitter's next block."""
        whom = {"target_system": received.system, "target_component": received.component}
        match received.name:
            case "COMMAND_LONG" | "COMMAND_INT":
                command = int(received.fields["command"])
                result = self._result(
                    command, float(received.fields["param1"]), float(received.fields["param2"])
                )
                self.accepted += result == ACCEPTED
                self._transmitter.ask("COMMAND_ACK", command=command, result=result, **whom)
            case "PARAM_REQUEST_LIST":
                self._transmitter.tell_parameters()
            case "PARAM_REQUEST_READ":
                known = self._transmitter.parameters
                index = int(received.fields["param_index"])
                by_name = known.get(_text(received.fields["param_id"]))
                if (
                    found := by_name
                    if index < 0
                    else next(islice(known.values(), index, None), None)
                ) is not None:
                    self._transmitter.tell(found)
            case "PARAM_SET":
                if (
                    old := self._transmitter.parameters.get(_text(received.fields["param_id"]))
                ) is not None:
                    value = float(received.fields["param_value"])
                    bitwise = self._transmitter.autopilot.bitwise
                    self._transmitter.parameters[old.name] = old.changed(value, bitwise) or old
                    self._transmitter.tell(self._transmitter.parameters[old.name])
            case "REQUEST_DATA_STREAM":
                # The rate, Hz, of a group of messages, or of all groups.
                groups = self._transmitter.autopilot.groups
                group = int(received.fields["req_stream_id"])
                rate = (
                    int(received.fields["req_message_rate"]) if received.fields["start_stop"] else 0
                )
                chosen = list(groups) if group == 0 else [group]
                self._set_intervals(
                    (name for one in chosen for name in groups.get(one, ())),
                    1 / rate if rate else inf,
                )
            case "MISSION_REQUEST_LIST":
                # There never is a mission.
                self._transmitter.ask(
                    "MISSION_COUNT", mission_type=received.fields["mission_type"], **whom
                )

    def _result(self, command: int, first: float, second: float) -> int:
        """Obeys a command with its first two parameters; returns the MAV_RESULT."""
        if command not in (ARM_DISARM, GET_INTERVAL, SET_INTERVAL, REQUEST_MESSAGE):
            return UNSUPPORTED
        if not isfinite(first):
            return DENIED
        if command == ARM_DISARM:
            return self._arm(first, second)
        if command == SET_INTERVAL:
            return self._set_interval(first, second)
        if command == GET_INTERVAL:
            return self._request("MESSAGE_INTERVAL", first)
        return self._request(_name(first), second)

    def _arm(self, arm: float, force: float) -> int:
        if round(arm) not in (0, 1):
            return DENIED
        if self._simulation.set_armed(round(arm) == 1, force == FORCE):
            return ACCEPTED
        if round(arm) == 1:
            return FAILED
        text, result = self._transmitter.autopilot.denied_in_air
        if text:
            self._transmitter.ask("STATUSTEXT", severity=CRITICAL, text=text.encode())
        return result

    def _set_interval(self, message: float, interval: float) -> int:
        schedule = self._transmitter.schedule
        name = _name(message)
        if name not in schedule.usual or not isfinite(interval):
            return self._transmitter.autopilot.unknown_message
        usual = 1 / schedule.usual[name] if schedule.usual[name] else inf
        self._set_intervals([name], inf if interval < 0 else interval / 1e6 or usual)
        return ACCEPTED

    def _set_intervals(self, names: Iterable[str], seconds: float) -> None:
        """Sets the interval of messages, and reports those whose interval was another."""
        schedule = self._transmitter.schedule
        changed = []
        for name in names:
            before = schedule.interval(name)
            schedule.set(name, seconds, self._transmitter.clock)
            after = schedule.interval(name)
            if after != before:
                changed.append(f"{name} {_in_hertz(after)} instead of {_in_hertz(before)}")
        if changed and self._reported < MAX_REPORTED:
            self._reported += 1
            more = "; further changes are not reported" if self._reported == MAX_REPORTED else ""
            self._report(f"A ground station asked for {', '.join(changed)}{more}.")

    def _request(self, name: str, argument: float) -> int:
        """Sends a message once; ``argument`` is the id of the message whose interval MESSAGE_INTERVAL reports."""
        transmitter = self._transmitter
        if name in transmitter.schedule.usual:
            transmitter.once.add(name)
        elif name == "MESSAGE_INTERVAL" and isfinite(argument) and 0 <= argument < 2**16:
            about = _name(argument)
            interval = (
                transmitter.schedule.interval(about) if about in transmitter.schedule.usual else 0.0
            )
            microseconds = min(round(interval * 1e6), 2**31 - 1) if isfinite(interval) else -1
            transmitter.ask(name, message_id=int(argument), interval_us=microseconds)
        elif name == "AUTOPILOT_VERSION":
            autopilot = transmitter.autopilot
            transmitter.ask(
                name, capabilities=autopilot.capabilities, flight_sw_version=autopilot.version
            )
        else:
            return transmitter.autopilot.unknown_message
        return ACCEPTED


def _in_hertz(interval: float) -> str:
    return f"{1 / interval:.3g} Hz" if isfinite(interval) else "none"


def _name(message: float) -> str:
    """Of the message with this id; empty when there is none."""
    definition = definitions().get(round(message)) if isfinite(message) else None
    return definition.name if definition else ""


def _text(field: bytes) -> str:
    return field.split(b"\0", 1)[0].decode("ascii", errors="replace")


MAX_ANSWERED_PER_TICK = 4
MAX_WAITING = 64
"""Messages of a ground station that are answered in a tick, a thousand a second, and that may wait for a later one. The
rest is dropped: a flood must not slow the flight down."""
MAX_READ_PER_TICK = 16  # Datagrams that are looked at in a tick


@dataclass
class LiveOutcome:
    """What came of a live flight."""

    holding: Holding  # how well the vehicle held its place
    sent: int = 0  # frames that were put on the network; ``commands`` that were accepted
    commands: int = 0
    # datagrams that were dropped, in whole or in part, because too many came at once
    unheard: int = 0
    flown: float = 0.0  # s of the flight, ``took``: s of wall time
    took: float = 0.0
    stopped: bool = False  # whether it was ended before it was over


class Ground:
    """The way to a ground station: a socket of the vehicle's own, and the address HOST:PORT it speaks to.

    The socket is on the loopback interface unless the host is elsewhere. Any sender may reach it there; answers go to
    the same HOST:PORT. Raises ValueError: no such host, or no way to it.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                host, port, type=socket.SOCK_DGRAM
            )[0]
            self._address: Any = address
            with socket.socket(family, kind, protocol) as probe:
                probe.connect(address)  # sends nothing, but finds out whether there is a way
            self._own = socket.socket(family, kind, protocol)
            near = str(address[0])
            self._own.bind(
                (near if ipaddress.ip_address(near.split("%")[0]).is_loopback else "", 0)
            )
        except (OSError, UnicodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is no name of a host"
            raise ValueError(
                f"nothing can be sent to {host[:80]}:{port} ({reason}): name one host"
            ) from None
        self._own.setblocking(False)

    def close(self) -> None:
        """Closes the socket."""
        self._own.close()

    def send(self, frame: bytes) -> bool:
        """Whether a datagram could be sent; one that could not is lost, as on any network."""
        try:
            self._own.sendto(frame, self._address)
        except OSError:
            return False
        return True

    def received(self, until: float) -> Iterator[bytes]:
        """What comes before ``until`` on the monotonic clock; where that is past, one datagram, if one waits.

        What cannot be looked at in time waits in the socket, whose room is limited.
        """
        while True:
            ready, _, _ = select.select([self._own], [], [], max(until - monotonic(), 0.0))
            # Some systems report here that the other end does not listen.
            with suppress(OSError):
                if ready:
                    yield self._own.recv(2048)  # no network carries a longer datagram in one piece
            if monotonic() >= until:
                return


def fly_live(
    scenario: Scenario,
    simulation: Simulation,
    ground: Ground,
    speed: float,
    progress: Callable[[float], None],
    report: Callable[[str], None] = lambda _: None,
) -> LiveOutcome:
    """Flies to the end, or until Ctrl-C, sending every frame in a datagram of its own, and obeying.

    It flies ``speed`` seconds in a second. ``progress`` is called with the seconds flown, ``report`` with a sentence
    when a ground station changes message rates. Raises ValueError: as ``Transmitter``; or the vehicle tumbles.
    """
    transmitter = Transmitter(scenario, simulation.cycle)
    commands = CommandHandler(transmitter, simulation, report)
    outcome = LiveOutcome(Holding(scenario))
    waiting = deque[Received]()
    link = LossyLink(scenario.faults, scenario.seed)
    began = monotonic()
    try:
        for now, due in _ticks(link, simulation, transmitter, speed, outcome.holding):
            outcome.flown = now
            progress(now)
            outcome.sent += sum(map(ground.send, due))
            outcome.unheard += _listen(
                ground.received(began + now / speed), transmitter.system, waiting
            )
            if link.out(now):
                waiting.clear()
            for _ in range(min(MAX_ANSWERED_PER_TICK, len(waiting))):
                commands.answer(waiting.popleft())
    except KeyboardInterrupt:
        outcome.stopped = True
    outcome.took = monotonic() - began
    outcome.commands = commands.accepted
    return outcome


def _listen(datagrams: Iterator[bytes], system: int, waiting: deque[Received]) -> int:
    """Queues the messages of a tick; returns how many datagrams were dropped, in whole or in part."""
    dropped = 0
    for number, datagram in enumerate(datagrams):
        room = MAX_WAITING - len(waiting)
        if number >= MAX_READ_PER_TICK or not room:
            dropped += 1
            continue
        received = addressed_messages(datagram, system, COMPONENT, room + 1)
        dropped += len(received) > room
        waiting.extend(received[:room])
    return dropped


def _ticks(
    link: LossyLink,
    simulation: Simulation,
    transmitter: Transmitter,
    speed: float,
    holding: Holding,
) -> Iterator[tuple[float, list[bytes]]]:
    """Seconds flown, tick by tick, and the frames that arrive by then; after the flight, what is still on its way."""
    way = deque[tuple[float, bytes]]()
    # What falls due in 4 ms of wall time is sent together, but at most half a second of the flight.
    cycles = max(round(min(0.004 * speed, 0.5) / simulation.cycle), 1)
    start = None
    now = 0.0
    while not simulation.finished:
        motion = simulation.advance(cycles)
        start = float(motion.time[0]) if start is None else start
        now = float(motion.time[-1])
        holding.add(motion)
        way.extend(link.pass_on(transmitter.send(motion)).timed())
        yield now - start, _due(way, now)
    for batch in link.rest():
        way.extend(batch.timed())
    while way and start is not None:
        now += cycles * simulation.cycle
        yield now - start, _due(way, now)


def _due(way: deque[tuple[float, bytes]], now: float) -> list[bytes]:
    return [way.popleft()[1] for _ in range(len(way)) if way[0][0] <= now]
