"""Live: a simulated vehicle on the network, as a real one is: it speaks, listens and obeys while it flies."""

from __future__ import annotations

import ipaddress
import select
import socket
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic
from typing import Any, Protocol

from sitl_scenarios.holding import Holding
from sitl_scenarios.mavlink.batch import Batch
from sitl_scenarios.mavlink.commands import Armable, Commands
from sitl_scenarios.mavlink.hearing import Heard, heard
from sitl_scenarios.mavlink.link import Link
from sitl_scenarios.mavlink.transmitter import COMPONENT, Transmitter
from sitl_scenarios.motion import Motion
from sitl_scenarios.scenario import Scenario

TICK = 0.004
"""Seconds of wall time in which what falls due is sent together, when the vehicle's loop is not slower."""
LONGEST_TICK = 0.5
"""Seconds of the flight in one tick, however fast time is to pass."""
MOST_ANSWERED, MOST_WAITING = 4, 64
"""Messages of a ground station that are answered in a tick, a thousand a second, and that may wait for a later one. The
rest is dropped: a flood must not slow the flight down."""
MOST_READ = 16
"""Datagrams that are looked at in a tick."""
DATAGRAM = 2048
"""Bytes of a datagram that are looked at: no network carries a longer one in one piece."""


class Flying(Armable, Protocol):
    """The simulation, as far as the link needs it."""

    cycle: float
    """s."""

    @property
    def finished(self) -> bool:
        """Whether the flight is over."""

    def advance(self, cycles: int) -> Motion:
        """The next rows."""


@dataclass
class Outcome:
    """What came of a live flight.

    Attributes:
        sent: frames that were put on the network; ``commands`` that were accepted.
        flown: s of the flight, ``took``: s of wall time.
        unheard: datagrams that were dropped, in whole or in part, because too many came at once.
        stopped: whether it was ended before it was over.
        holding: how well the vehicle held its place.
    """

    holding: Holding
    sent: int = 0
    commands: int = 0
    unheard: int = 0
    flown: float = 0.0
    took: float = 0.0
    stopped: bool = False


class Ground:
    """The way to a ground station: a socket of the vehicle's own, and the address HOST:PORT it speaks to.

    The socket is on the loopback interface unless the host is elsewhere. What is said to it there is heard, from
    wherever, and answered to the same HOST:PORT.
    """

    def __init__(self, host: str, port: int) -> None:
        """Finds the way.

        Raises:
            ValueError: no such host, or no way to it.
        """
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._address: Any = address
            with socket.socket(family, kind, protocol) as probe:
                probe.connect(address)  # sends nothing, but finds out whether there is a way
            self._own = socket.socket(family, kind, protocol)
            near = str(address[0])
            loopback = ipaddress.ip_address(near.split("%")[0]).is_loopback
            self._own.bind((near if loopback else "", 0))
        except (OSError, UnicodeError) as error:
            cure = "check the name"
            if isinstance(error, PermissionError):
                # What systems answer when a socket for one receiver is to speak to all.
                reason, cure = "it is a broadcast address, which is not supported", "name one host"
            elif isinstance(error, OSError):
                reason = error.strerror or str(error)
            else:
                reason = "it is no name of a host"
            raise ValueError(f"nothing can be sent to {host[:80]}:{port} ({reason}): {cure}") from None
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
            # Some systems tell here that the other end does not listen.
            with suppress(OSError):
                if ready:
                    yield self._own.recv(DATAGRAM)
            if monotonic() >= until:
                return


def fly_live(
    scenario: Scenario,
    simulation: Flying,
    ground: Ground,
    speed: float,
    progress: Callable[[float], None],
    tell: Callable[[str], None] = lambda _: None,
) -> Outcome:
    """Flies to the end, or until Ctrl-C, sending every frame in a datagram of its own, and obeying.

    Args:
        scenario: of the flight.
        simulation: the flight.
        ground: whom it speaks to.
        speed: seconds of flight in a second.
        progress: called with the seconds flown.
        tell: called with a sentence when a ground station changes how often something is sent.

    Raises:
        ValueError: as ``Transmitter``; or the vehicle tumbles.
    """
    transmitter = Transmitter(scenario, simulation.cycle)
    commands = Commands(transmitter, simulation, tell)
    outcome, waiting = Outcome(Holding(scenario)), deque[Heard]()
    began = monotonic()
    try:
        for now, due in _ticks(scenario, simulation, transmitter, speed, outcome.holding):
            outcome.flown = now
            progress(now)
            outcome.sent += sum(map(ground.send, due))
            outcome.unheard += _listen(ground.received(began + now / speed), transmitter.system, waiting)
            for _ in range(min(MOST_ANSWERED, len(waiting))):
                commands.answer(waiting.popleft())
    except KeyboardInterrupt:
        outcome.stopped = True
    outcome.took, outcome.commands = monotonic() - began, commands.accepted
    return outcome


def _listen(datagrams: Iterator[bytes], system: int, waiting: deque[Heard]) -> int:
    """Puts what is said in a tick behind what waits; answers how many datagrams were dropped, or part of them."""
    dropped = 0
    for number, datagram in enumerate(datagrams):
        room = MOST_WAITING - len(waiting)
        if number >= MOST_READ or not room:
            dropped += 1
            continue
        said = heard(datagram, system, COMPONENT, room + 1)
        dropped += len(said) > room
        waiting.extend(said[:room])
    return dropped


def _ticks(
    scenario: Scenario, simulation: Flying, transmitter: Transmitter, speed: float, holding: Holding
) -> Iterator[tuple[float, list[bytes]]]:
    """Seconds flown, tick by tick, and the frames that arrive by then; after the flight, what is still on its way."""
    link, way = Link(scenario.faults, scenario.seed), deque[tuple[float, bytes]]()
    cycles = max(round(min(TICK * speed, LONGEST_TICK) / simulation.cycle), 1)
    start, now = None, 0.0
    while not simulation.finished:
        motion = simulation.advance(cycles)
        start = float(motion.time[0]) if start is None else start
        now = float(motion.time[-1])
        holding.add(motion)
        way.extend(_timed(link.pass_on(transmitter.send(motion))))
        yield now - start, _due(way, now)
    for batch in link.rest():
        way.extend(_timed(batch))
    while way and start is not None:
        now += cycles * simulation.cycle
        yield now - start, _due(way, now)


def _timed(batch: Batch) -> Iterator[tuple[float, bytes]]:
    return zip(batch.time.tolist(), batch.content(), strict=True)


def _due(way: deque[tuple[float, bytes]], now: float) -> list[bytes]:
    due = []
    while way and way[0][0] <= now:
        due.append(way.popleft()[1])
    return due
