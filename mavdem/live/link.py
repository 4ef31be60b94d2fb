"""A MAVLink link: a socket or a serial port, by pymavlink's connection strings.

``udpin:HOST:PORT`` (also ``udp:HOST:PORT`` and ``HOST:PORT``), ``udpout:HOST:PORT``, ``tcp:HOST:PORT`` (a server),
``tcpin:HOST:PORT`` (waits for one client) or ``DEVICE[,BAUD]``, whose modem lines stay as they are. Without a HOST it
is this machine. It sends nothing before ``send``. pymavlink's own connections share a port in use instead of failing,
and send to every address that ever sent anything.
"""

import contextlib
import errno
import os
import re
import select
import socket
import struct
import sys
import termios
import time
import tty
from typing import Any, NoReturn

import numpy as np

from mavdem.errors import Unreadable, error_message
from mavdem.facts import Fact, Level
from mavdem.facts.session import LinkError, LinkFact
from mavdem.ingest.mavlink.framing import HEADER_BYTES_V1, MARKER_V1
from mavdem.ingest.vocabulary import AUTOPILOT_COMPONENT
from mavdem.machine import LOOPBACK

SO_TIMESTAMPNS, SO_RXQ_OVFL = (35, 40) if sys.platform == "linux" else (0, 0)
"""When each datagram came, and how many found no room. Source: Linux, include/uapi/asm-generic/socket.h."""
MAX_PIECE_BYTES = np.iinfo(np.uint16).max  # Of a datagram, and of a piece of a byte stream
MAX_PIECES = 512  # Datagrams or pieces taken in one call: a fast sender must not hold up the caller
# How long an address that sent something is sent to, and how many are kept
SENDER_SECONDS = 10.0
MAX_PEERS = 16
CONNECT_SECONDS = (
    5  # Time limit of a connection attempt; and of silence, after which a connection is probed
)
MAX_TRIES = 3  # Of what gets no answer
SILENCE_SECONDS = 3.0  # Without what comes all the time, until its source counts as gone
PAUSE_SECONDS = (
    1.0  # From one status, probe of a connection, or attempt to open a lost link, to the next
)

_NETWORK = re.compile(r"(?:(udpin|udp|udpout|tcp|tcpin):(?!/))?(?:(\[[^\]]*\]|[^:/]*):)?(\d+)")


class LinkLost(Exception):
    """The TCP connection or the serial port is lost, as its ``fact`` says."""

    def __init__(self, link: str, cause: LinkError, error: OSError | None = None) -> None:
        self.fact = Fact(
            LinkFact.CONNECTION_LOST,
            Level.WATCH,
            name=link,
            cause=cause,
            error=error and error_message(error),
            reopening=False,
        )
        super().__init__(self.fact)


class Link:
    """An open link, by its connection string ``name``. Raises Unreadable: it cannot be opened, with the reason."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._events: list[Fact] = []
        # By MAVLink ids: address and when it was heard, another that was refused, and of which that is said
        self._first: dict[bytes, tuple[Any, float]] = {}
        self._rivals: dict[bytes, Any] = {}
        self._said = set[bytes]()
        self._not_before = 0.0
        # datagrams that this machine's buffer had no room for: nobody read them in time
        self.dropped = 0
        self._arrival = 0.0  # UNIX s of the latest piece
        self._server: socket.socket | None = None
        self._socket: socket.socket | None = None
        self._serial: int | None = None
        self._peers: dict[Any, float] = {}
        self._from: Any = None
        self._kind, host, port = _parsed(name)
        self._address = (host, port)
        self.datagrams = self._kind in ("udpin", "udpout")  # each contains whole frames
        # the other side sends only after it has received something
        self.speaks_first = self._kind == "udpout"
        try:
            self._open()
        except OSError as error:
            self.close()
            self._refuse(error)

    def receive(self, timeout: float) -> list[tuple[float, bytes]]:
        """Returns up to ``MAX_PIECES`` waiting pieces: UNIX s of arrival, and the bytes as they came.

        There are none after ``timeout`` s. The kernel stamps datagrams. Other pieces arrive when they are read.

        Raises LinkLost: the connection or the port is lost; ``reopen`` opens it again.
        """
        waiting_on = self._waiting_on()
        if waiting_on is None:
            raise LinkLost(self.name, LinkError.NOT_OPEN)
        received: list[tuple[float, bytes]] = []
        try:
            if not select.select([waiting_on], [], [], timeout)[0]:
                return received
            self._arrival = time.time()
            if self._server is not None and self._socket is None:
                self._socket, _ = self._server.accept()
                _probe(self._socket)
                self._socket.setblocking(False)
            while len(received) < MAX_PIECES and (piece := self._take()) is not None:
                if not piece and not self.datagrams:
                    if received:
                        break  # return what came; the next call raises
                    self._lose(LinkError.CLOSED)
                if piece and self._admits(piece):
                    received.append((self._arrival, piece))
                elif piece:
                    # nor is anything sent to a vehicle that only shares the ids
                    self._peers.pop(self._from, None)
        except OSError as error:
            if not received:
                self._lose(LinkError.FAILED, error)
        return received

    def drain_events(self) -> list[Fact]:
        """Returns facts to report since the last call."""
        return [self._events.pop(0) for _ in range(len(self._events))]

    def send(self, frame: bytes) -> None:
        """Sends whole frames, with ``udpin`` to all addresses read from lately. Raises LinkLost: as ``receive``."""
        try:
            if self._serial is not None:
                os.write(self._serial, frame)
            elif self._socket is None:
                return  # no client yet
            elif self._kind == "udpin":
                for sender, heard in self._peers.items():
                    if time.monotonic() - heard <= SENDER_SECONDS:
                        self._socket.sendto(frame, sender)
            else:
                self._socket.sendall(frame)
        except BlockingIOError:
            return  # the other side is too slow: dropped, as a datagram would be
        except OSError as error:
            if self.datagrams:
                return  # no listener there now: the link itself is fine
            self._lose(LinkError.FAILED, error)

    def reopen(self) -> bool:
        """Opens a lost link, once its pause is over; returns whether it is open.

        An attempt takes at most ``CONNECT_SECONDS``.
        """
        if self._waiting_on() is None and time.monotonic() >= self._not_before:
            try:
                self._open()
            except OSError:
                self._shut()
        return self._waiting_on() is not None

    def close(self) -> None:
        """Closes it."""
        for opened in filter(None, (self._socket, self._server)):
            opened.close()
        if self._serial is not None:
            with contextlib.suppress(OSError):
                os.close(self._serial)
        self._socket = self._server = self._serial = None

    def _open(self) -> None:
        if self._kind == "serial":
            self._serial = _serial(self.name)
            return
        kind = socket.SOCK_DGRAM if self.datagrams else socket.SOCK_STREAM
        try:
            family, _, _, _, address = socket.getaddrinfo(*self._address, type=kind)[0]
        except UnicodeError as error:  # no valid host name
            raise socket.gaierror(str(error)) from error
        if self._kind == "tcpin":
            opened = self._server = socket.create_server(self._address, family=family, backlog=1)
        elif self._kind == "tcp":
            opened = self._socket = socket.create_connection(self._address, CONNECT_SECONDS)
            _probe(opened)
        else:
            opened = self._socket = socket.socket(family, kind)
            # half a minute of a fast link
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
            for option in (SO_TIMESTAMPNS, SO_RXQ_OVFL) if SO_TIMESTAMPNS else ():
                with contextlib.suppress(OSError):  # an old kernel: they arrive when they are read
                    opened.setsockopt(socket.SOL_SOCKET, option, 1)
            # Connecting a datagram socket only sets the peer.
            (opened.bind if self._kind == "udpin" else opened.connect)(address)
        opened.setblocking(False)

    def _waiting_on(self) -> socket.socket | int | None:
        return self._socket or self._server or self._serial

    def _take(self) -> bytes | None:
        """The next piece; None if nothing waits."""
        try:
            if self._serial is not None:
                return os.read(self._serial, MAX_PIECE_BYTES)
            if self._socket is None:
                return None
            if not self.datagrams or not SO_TIMESTAMPNS:
                piece, sender = self._socket.recvfrom(MAX_PIECE_BYTES)
            else:
                piece, stamps, _, sender = self._socket.recvmsg(MAX_PIECE_BYTES, 64)
                for _, kind, value in stamps:
                    if kind == SO_TIMESTAMPNS:
                        seconds, nanoseconds = struct.unpack("@2l", value)
                        self._arrival = seconds + 1e-9 * nanoseconds
                    elif kind == SO_RXQ_OVFL:
                        self.dropped = struct.unpack("@I", value)[0]
            if self._kind == "udpin":
                if sender not in self._peers and len(self._peers) >= MAX_PEERS:
                    del self._peers[min(self._peers, key=self._peers.__getitem__)]
                self._peers[sender], self._from = time.monotonic(), sender
            return piece
        except (BlockingIOError, ConnectionRefusedError):
            return None  # a datagram is refused where the last one sent had no receiver

    def _admits(self, datagram: bytes) -> bool:
        """Whether the latest datagram is of the first address of its autopilot; other components may have several."""
        now = time.monotonic()
        if len(datagram) < HEADER_BYTES_V1 or self._from is None:
            return True
        ids = datagram[3:5] if datagram[0] == MARKER_V1 else datagram[5:7]
        if ids[1:] != bytes([AUTOPILOT_COMPONENT]):
            return True
        first, heard = self._first.get(ids, (self._from, now))
        if first != self._from and now - heard <= SILENCE_SECONDS:
            self._rivals.setdefault(ids, self._from)
            return False
        self._first[ids] = self._from, now
        # Both send; one that restarts from another port would not send from the first again.
        if first == self._from and ids in self._rivals and ids not in self._said:
            self._said.add(ids)
            addresses = [f"{host}:{port}" for host, port, *_ in (first, self._rivals[ids])]
            self._events.append(
                Fact(LinkFact.TWO_ADDRESSES, subject=f"{ids[0]}:{ids[1]}", names=addresses)
            )
        return True

    def _lose(self, cause: LinkError, error: OSError | None = None) -> NoReturn:
        if self._server is not None and self._socket is not None:
            self._socket.close()
            self._socket = None  # the next client may connect at once
        else:
            self._shut()
        raise LinkLost(self.name, cause, error)

    def _shut(self) -> None:
        """Closes it until a pause is over."""
        self.close()
        self._not_before = time.monotonic() + PAUSE_SECONDS

    def _refuse(self, error: OSError) -> NoReturn:
        host, port = self._address
        if isinstance(error, socket.gaierror):
            cause = LinkError.NO_HOST
        elif isinstance(error, TimeoutError):
            cause = LinkError.NO_REPLY
        else:
            cause = REFUSALS.get(error.errno or 0, LinkError.FAILED)
        raise _cannot_open(self.name, cause, host, port, error_message(error)) from error


def _parsed(name: str) -> tuple[str, str, int]:
    """Kind ("udpin", "udpout", "tcp", "tcpin" or "serial"), host and port of a connection string."""
    network = _NETWORK.fullmatch(name)
    # Without a kind, the host must look like an address: "mcast:14550" is another kind of link.
    if network is not None and (network[1] or re.search(r"[.\]]|localhost", network[2] or "")):
        kind, host, port = network.groups()
        if int(port) > 65535:
            raise Unreadable(LinkFact.LINK_PORT_TOO_HIGH, name=name)
        # Without a direction as in pymavlink.
        return (
            ("udpin" if kind in (None, "udp") else kind),
            (host or "").strip("[]") or LOOPBACK,
            int(port),
        )
    if os.path.isfile(name):
        raise Unreadable(LinkFact.FILE_IS_NO_LINK, name=name)
    if not os.path.isabs(name):
        raise Unreadable(LinkFact.NOT_A_LINK, name=name)
    return "serial", "", 0


REFUSALS = {
    errno.EADDRINUSE: LinkError.IN_USE,
    errno.EADDRNOTAVAIL: LinkError.NOT_LOCAL,
    errno.ECONNREFUSED: LinkError.NOT_LISTENING,
    errno.EACCES: LinkError.NOT_PERMITTED,
    errno.EPERM: LinkError.NOT_PERMITTED,
    errno.ENOENT: LinkError.NO_PORT,
}


def _cannot_open(
    link: str, cause: LinkError, host: str = "", port: int = 0, error: str = ""
) -> Unreadable:
    return Unreadable(
        LinkFact.CANNOT_OPEN_LINK,
        name=link,
        cause=cause,
        host=host,
        port=port,
        error=error,
        duration=float(CONNECT_SECONDS),
    )


def _probe(connection: socket.socket) -> None:
    """Makes the kernel probe a silent connection: a peer that lost power does not close it."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in {
        "IDLE": CONNECT_SECONDS,
        "INTVL": round(PAUSE_SECONDS),
        "CNT": MAX_TRIES,
    }.items():
        if hasattr(socket, f"TCP_KEEP{option}"):
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, f"TCP_KEEP{option}"), value)


def _serial(name: str) -> int:
    """Opens a serial port: raw, at its speed, without waiting for a carrier or hanging up at the end."""
    device, _, speed = name.partition(",")
    baud = getattr(termios, f"B{speed or 115200}", None)
    if baud is None or not (speed or "1").isdigit():
        raise _cannot_open(name, LinkError.NO_SPEED, repr(speed))
    port = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        tty.setraw(port, termios.TCSANOW)
        settings = termios.tcgetattr(port)
        settings[2] = (settings[2] | termios.CLOCAL | termios.CREAD) & ~(
            termios.HUPCL | termios.CRTSCTS
        )
        settings[4] = settings[5] = baud
        termios.tcsetattr(port, termios.TCSANOW, settings)
    except termios.error as error:
        os.close(port)
        raise _cannot_open(name, LinkError.NOT_SERIAL) from error
    return port
