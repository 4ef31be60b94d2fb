"""Live flight: a simulated vehicle that exchanges MAVLink datagrams with a ground station while it flies."""

import secrets
import select
import socket
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic
from typing import NamedTuple

from mavdem.ingest.mavlink.sequence_counters import SEQUENCE_NUMBERS
from mavdem.ingest.vocabulary import AUTOPILOT_COMPONENT
from sitl_scenarios.flight_simulation import Simulation
from sitl_scenarios.mavlink.commands import CommandHandler, addressed_messages
from sitl_scenarios.mavlink.transmitter import LossyLink, TimedFrame, Transmitter
from sitl_scenarios.motion import Progress
from sitl_scenarios.scenario import Scenario

MAX_DATAGRAM = 2048
"""Largest datagram that is received, bytes: no common network carries a longer one in one piece."""

TICK_SECONDS = 0.004
"""Wall-clock time whose frames are sent together, s; a choice."""

MAX_TICK_FLIGHT_SECONDS = 0.5
"""Longest simulated time whose frames are sent together, s, however fast the simulation runs; a choice."""


@dataclass
class LiveOutcome:
    """Counts and durations of a live flight."""

    sent: int = 0
    """Number of frames that were sent."""
    commands: int = 0
    """Number of commands that were accepted."""
    flown: float = 0.0
    """Simulated time, s."""
    took: float = 0.0
    """Wall-clock time, s."""
    stopped: bool = False
    """Whether the user ended the flight before its end."""


class Ground:
    """Connection to a ground station: a UDP socket that exchanges datagrams with this one address only."""

    def __init__(self, host: str, port: int) -> None:
        """Opens a UDP socket that is connected to the ground station.

        Args:
            host: Name or address of the ground station.
            port: Its UDP port.

        Raises:
            ValueError: The host does not exist or cannot be reached.
        """
        try:
            # A name may have several addresses, of IPv4 and IPv6: the system prefers the first.
            addresses = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
            family, kind, protocol, _, address = addresses[0]
            self._socket = socket.socket(family, kind, protocol)
            # A connected UDP socket receives datagrams from this address only.
            self._socket.connect(address)
        except (OSError, UnicodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is no name of a host"
            raise ValueError(
                f"nothing can be sent to {host[:80]}:{port} ({reason}): name one host"
            ) from None
        self._socket.setblocking(False)

    def close(self) -> None:
        """Closes the socket."""
        self._socket.close()

    def send(self, frame: bytes) -> bool:
        """Sends a frame as one datagram.

        A datagram that cannot be sent is lost, as on any network.

        Args:
            frame: Bytes of the frame.

        Returns:
            Whether it was sent.
        """
        try:
            self._socket.send(frame)
        except OSError:
            return False
        return True

    def received(self, end_time: float) -> Iterator[bytes]:
        """Yields the datagrams that arrive before a time, and returns at that time.

        Waiting here is also what keeps the flight in step with the clock. If the time is past already, it yields one
        datagram at most, so that commands reach even a simulation that is too slow. Datagrams that cannot be handled in
        time wait in the socket's buffer, whose size is limited.

        Args:
            end_time: Time on the monotonic clock, s.
        """
        while True:
            timeout = max(end_time - monotonic(), 0.0)
            ready, _, _ = select.select([self._socket], [], [], timeout)
            # Some systems report here, as an error, that the other end does not listen.
            with suppress(OSError):
                if ready:
                    yield self._socket.recv(MAX_DATAGRAM)
            if monotonic() >= end_time:
                return


def fly_live(
    scenario: Scenario,
    simulation: Simulation,
    ground: Ground,
    speed: float,
    progress: Progress,
) -> LiveOutcome:
    """Flies a scenario at the speed of the clock, and exchanges MAVLink datagrams with a ground station meanwhile.

    Tick by tick, a few milliseconds of flight are simulated and their frames sent, each in its own datagram. Until the
    clock reaches the simulated time, received commands are executed. The flight ends as planned, or with Ctrl-C.

    Args:
        scenario: Scenario of the flight: vehicle, wind, excitation, sensors and faults.
        simulation: Its simulation, not yet begun.
        ground: Connection to the ground station.
        speed: Simulated seconds per second of wall-clock time.
        progress: Function that is called with the seconds that have been flown.

    Returns:
        Simulated and wall-clock time, numbers of frames sent and of commands accepted, and whether the user stopped the
        flight.

    Raises:
        ValueError: The scenario has rates of a message that is not sent, or the vehicle tumbles.
    """
    # Otherwise two flights with the same seed would send the same bytes, which are copies of a second link for a
    # receiver that is still attached.
    first_sequence = secrets.randbelow(SEQUENCE_NUMBERS)
    transmitter = Transmitter(scenario, first_sequence)
    commands = CommandHandler(transmitter, simulation)
    outcome = LiveOutcome()
    link = LossyLink(scenario)
    start_time = monotonic()
    try:
        for now, frames in _frames_by_tick(link, simulation, transmitter, speed):
            outcome.flown = now
            progress(now)
            outcome.sent += sum(map(ground.send, frames))
            tick_end = start_time + now / speed
            for datagram in ground.received(tick_end):
                # While the link is lost, datagrams are read and dropped.
                if link.is_in_outage(now):
                    continue
                for message in addressed_messages(
                    datagram, transmitter.system, AUTOPILOT_COMPONENT
                ):
                    commands.handle(message)
    except KeyboardInterrupt:
        outcome.stopped = True
    outcome.took = monotonic() - start_time
    outcome.commands = commands.accepted
    return outcome


class _Tick(NamedTuple):
    """A step of a live flight."""

    flown_seconds: float
    """Time since the flight began, s."""

    frames: list[bytes]
    """Frames that have arrived at the ground station since the tick before."""


def _frames_by_tick(
    link: LossyLink, simulation: Simulation, transmitter: Transmitter, speed: float
) -> Iterator[_Tick]:
    """Advances the simulation tick by tick, and yields the frames that arrive at the ground station.

    After the flight only time passes, until all delayed frames have arrived.

    Args:
        link: Link that loses, delays and reorders frames.
        simulation: Simulation of the flight.
        transmitter: Autopilot's side of the link.
        speed: Simulated seconds per second of wall-clock time; it decides how long a tick of the flight is.

    Yields:
        For each tick the time since the start of the flight, s, and the frames that have arrived in it.
    """
    # Frames on their way over the link, in order of arrival.
    in_transit = deque[TimedFrame]()
    tick = min(TICK_SECONDS * speed, MAX_TICK_FLIGHT_SECONDS)
    cycles = max(round(tick / simulation.cycle), 1)
    start = None
    flight_time = 0.0
    while not simulation.finished:
        motion = simulation.advance(cycles)
        if start is None:
            start = float(motion.time[0])
        flight_time = float(motion.time[-1])
        in_transit.extend(link.pass_on(transmitter.send(motion)))
        yield _Tick(flight_time - start, _take_arrived_frames(in_transit, flight_time))
    # The flight is over: only time passes, until the last frames have arrived.
    in_transit.extend(link.held_frames())
    while in_transit and start is not None:
        flight_time += cycles * simulation.cycle
        yield _Tick(flight_time - start, _take_arrived_frames(in_transit, flight_time))


def _take_arrived_frames(in_transit: deque[TimedFrame], now: float) -> list[bytes]:
    """Removes the frames that arrive until ``now`` (s of the flight) from those in transit, and returns them."""
    arrived_frames = []
    while in_transit:
        arrival_time, frame = in_transit[0]
        if arrival_time > now:
            break
        arrived_frames.append(frame)
        in_transit.popleft()
    return arrived_frames
