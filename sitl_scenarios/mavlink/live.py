"""A simulated vehicle on the network: sends, receives and obeys a ground station while it flies."""

import select
import socket
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic

from mavdem.ingest.vocabulary import AUTOPILOT_COMPONENT
from sitl_scenarios.mavlink.commands import CommandHandler, addressed_messages
from sitl_scenarios.mavlink.transmitter import LossyLink, Timed, Transmitter
from sitl_scenarios.motion import Progress
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import Simulation


@dataclass
class LiveOutcome:
    """What came of a live flight."""

    sent: int = 0  # frames that were put on the network; ``commands`` that were accepted
    commands: int = 0
    flown: float = 0.0  # s of the flight, ``took``: s of wall time
    took: float = 0.0
    stopped: bool = False  # whether it was ended before it was over


class Ground:
    """The way to a ground station: a socket of the vehicle's own, and the address HOST:PORT it speaks to.

    Nothing else reaches it there. Raises ValueError: no such host, or no way to it.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                host, port, type=socket.SOCK_DGRAM
            )[0]
            self._own = socket.socket(family, kind, protocol)
            self._own.connect(address)
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
        """Sends a datagram; returns whether it could be sent: one that could not is lost, as on any network."""
        try:
            self._own.send(frame)
        except OSError:
            return False
        return True

    def received(self, until: float) -> Iterator[bytes]:
        """Yields what comes before ``until`` on the monotonic clock; where that is past, one datagram, if one waits.

        What cannot be looked at in time waits in the socket, whose room is limited.
        """
        while True:
            patience = max(until - monotonic(), 0.0)
            ready, _, _ = select.select([self._own], [], [], patience)
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
    progress: Progress,
) -> LiveOutcome:
    """Flies to the end, or until Ctrl-C, sending every frame in a datagram of its own, and obeying.

    It flies ``speed`` seconds in a second. ``progress`` is called with the seconds flown. Raises ValueError: as
    ``Transmitter``; or the vehicle tumbles.
    """
    transmitter = Transmitter(scenario)
    commands = CommandHandler(transmitter, simulation)
    outcome = LiveOutcome()
    link = LossyLink(scenario)
    began = monotonic()
    try:
        for now, due in _ticks(link, simulation, transmitter, speed):
            outcome.flown = now
            progress(now)
            outcome.sent += sum(map(ground.send, due))
            for datagram in ground.received(began + now / speed):
                if not link.out(now):
                    for message in addressed_messages(
                        datagram, transmitter.system, AUTOPILOT_COMPONENT
                    ):
                        commands.answer(message)
    except KeyboardInterrupt:
        outcome.stopped = True
    outcome.took = monotonic() - began
    outcome.commands = commands.accepted
    return outcome


def _ticks(
    link: LossyLink, simulation: Simulation, transmitter: Transmitter, speed: float
) -> Iterator[tuple[float, list[bytes]]]:
    """Seconds flown, tick by tick, and the frames that arrive by then; after the flight, what is still on its way."""
    way = deque[Timed]()
    # What falls due in 4 ms of wall time is sent together, but at most half a second of the flight.
    cycles = max(round(min(0.004 * speed, 0.5) / simulation.cycle), 1)
    start = None
    now = 0.0
    while not simulation.finished:
        motion = simulation.advance(cycles)
        start = float(motion.time[0]) if start is None else start
        now = float(motion.time[-1])
        way.extend(link.pass_on(transmitter.send(motion)))
        yield now - start, _due(way, now)
    way.extend(link.rest())
    while way and start is not None:
        now += cycles * simulation.cycle
        yield now - start, _due(way, now)


def _due(way: deque[Timed], now: float) -> list[bytes]:
    return [way.popleft()[1] for _ in range(len(way)) if way[0][0] <= now]
