"""A MAVLink link: a socket or a serial port by pymavlink's connection strings, listened to without a sound.

pymavlink's own connections are not used: its UDP socket shares a port that is taken instead of saying so, answers to
every address that ever sent it anything, and leaves the kernel's buffer as small as it is; its serial port changes the
speed twice; and both print. Here nothing leaves this machine before ``send``, but for the handshake that a TCP
connection is.

=====================  =================================================================================================
``udpin:HOST:PORT``    receives at this address; also ``udp:HOST:PORT`` and ``HOST:PORT``
``udpout:HOST:PORT``   talks to this address: what is there answers only once something was sent to it
``tcp:HOST:PORT``      connects to a server
``tcpin:HOST:PORT``    waits for one client
``DEVICE[,BAUD]``      a serial port, 115200 baud unless given; its modem lines stay as they are
=====================  =================================================================================================

Without a HOST it is this machine, 127.0.0.1: what a network may reach must be asked for, ``udpin:0.0.0.0:14550``.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import socket
import sys
import time
from typing import Any, NoReturn

from mavdem.errors import Unreadable

LOOPBACK = "127.0.0.1"
BUFFER = 4 << 20
"""Bytes that the kernel is asked to hold: half a minute of a fast link."""
LARGEST = 1 << 16
"""Bytes of the largest datagram, and of the largest piece of a byte stream."""
DRAINED = 512
"""Datagrams or pieces taken in one call at most: what comes faster than it is read must not hold the reader."""
HEARD, MOST_HEARD = 10.0, 16
"""Seconds for which an address is answered that something came from, and how many such are remembered."""
BAUD = 115200
PATIENCE = 5.0
"""Seconds that a connection may take to be made."""
SILENCE = 5
"""Seconds for which a client may be silent before another takes its place, and a connection before it is probed."""
PROBED, PROBES = 2, 3
"""Seconds between such probes, and how many may stay unanswered."""
SETTLED = 10.0
"""Seconds that a connection must have held before it is thought to be worth opening again at once."""
FIRST_PAUSE, LONGEST_PAUSE = 0.25, 8.0
"""Seconds before a lost link is first opened again, and at most; doubled each time."""

_NETWORK = re.compile(r"(?:(udpin|udp|udpout|tcp|tcpin):(?!/))?(?:(\[[^\]]*\]|[^:/]*):)?(\d+)")
_KINDS = {None: "udpin", "udp": "udpin"}
"""What pymavlink takes names without a direction for."""


class LinkLost(Exception):
    """The other side of a TCP connection, or the serial port, is gone; the message is one sentence."""


class Link:
    """An open link.

    Attributes:
        name: the connection string.
        datagrams: whether what is received comes in datagrams, in which frames are whole.
        speaks_first: whether the other side answers only once something was sent to it.
        buffer: bytes that the kernel granted to hold what waits; 0 for a serial port, whose buffer is its driver's.
    """

    def __init__(self, name: str) -> None:
        """Opens it.

        Args:
            name: the connection string.

        Raises:
            Unreadable: it cannot be opened, with the reason.
        """
        self.name = name
        self.buffer = 0
        self._pause, self._not_before = FIRST_PAUSE, 0.0
        self._opened = self._came = 0.0
        self._server: socket.socket | None = None
        self._socket: socket.socket | None = None
        self._serial: int | None = None
        self._heard: dict[Any, float] = {}
        self._kind, host, port = _understood(name)
        self._address = (host, port)
        self.datagrams = self._kind in ("udpin", "udpout")
        self.speaks_first = self._kind == "udpout"
        try:
            self._open()
        except OSError as error:
            self.close()
            self._refuse(error)

    def receive(self, timeout: float) -> list[tuple[float, bytes]]:
        """All that waits, up to ``DRAINED`` pieces: UNIX s it was taken, and the bytes as they came.

        Args:
            timeout: seconds to wait for the first; nothing may come, and the list is empty then.

        Raises:
            LinkLost: the other side or the port is gone; ``reopen`` brings it back.
        """
        waited_for = self._waited_for()
        if waited_for is None:
            raise LinkLost(f"The link {self.name} is not open.")
        received: list[tuple[float, bytes]] = []
        try:
            # Who is silent may be gone without a word; while it talks, others wait.
            replaceable = self._server if time.monotonic() - self._came > SILENCE else None
            ready = select.select([waited_for, *filter(None, [replaceable])], [], [], max(timeout, 0.0))[0]
            if not ready:
                return received
            if self._server is not None and self._socket is None:
                self._socket, _ = self._server.accept()
                _probe(self._socket)
                self._socket.setblocking(False)
                self._came = time.monotonic()
            elif ready == [self._server]:
                self._lose("was silent, and another client waits")
            while len(received) < DRAINED:
                piece = self._take()
                if piece is None:
                    break
                if not piece and not self.datagrams:
                    if received:
                        break  # first what came, then that it is over
                    self._lose("was closed by the other side")
                if piece:
                    received.append((time.time(), piece))
                    self._came = time.monotonic()
        except OSError as error:
            if not received:
                self._lose(f"was lost: {error.strerror or error}")
        return received

    def send(self, frame: bytes) -> None:
        """Sends bytes to the other side: with ``udpin`` to all heard from in the last ``HEARD`` seconds.

        Args:
            frame: whole frames.

        Raises:
            LinkLost: it cannot be sent.
        """
        try:
            if self._serial is not None:
                os.write(self._serial, frame)
            elif self._socket is None:
                return  # nobody has connected yet
            elif self._kind == "udpin":
                since = time.monotonic() - HEARD
                for sender in [sender for sender, heard in self._heard.items() if heard >= since]:
                    self._socket.sendto(frame, sender)
            else:
                self._socket.sendall(frame)
        except BlockingIOError:
            return  # the other side does not keep up: dropped, as a datagram would be
        except OSError as error:
            if self.datagrams:
                return  # nobody listens there now: that is no fault of the link
            self._lose(f"was lost: {error.strerror or error}")

    def reopen(self) -> bool:
        """Opens a link that was lost; does nothing before its pause is over.

        The pause doubles with each try, also with one that is lost again before it has held for ``SETTLED``. A server
        that does not answer takes ``PATIENCE``.

        Returns:
            whether it is open.
        """
        now = time.monotonic()
        if self._waited_for() is not None:
            return True
        if now < self._not_before:
            return False
        try:
            self._open()
        except OSError:
            self.close()
            self._put_off()
            return False
        return True

    def close(self) -> None:
        """Closes it."""
        for one in (self._socket, self._server):
            if one is not None:
                one.close()
        if self._serial is not None:
            with contextlib.suppress(OSError):
                os.close(self._serial)
        self._socket = self._server = self._serial = None

    def _open(self) -> None:
        self._opened = time.monotonic()
        if self._kind == "serial":
            self._serial = _serial(self.name)
            return
        kind = socket.SOCK_DGRAM if self.datagrams else socket.SOCK_STREAM
        try:
            family, _, _, _, address = socket.getaddrinfo(*self._address, type=kind)[0]
        except UnicodeError as error:  # no name that could be looked up
            raise socket.gaierror(str(error)) from error
        opened = socket.socket(family, kind)
        if self._kind == "tcpin":
            self._server = opened
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        else:
            self._socket = opened
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
        self.buffer = opened.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        if self._kind in ("udpin", "tcpin"):
            opened.bind(address)
            if self._kind == "tcpin":
                opened.listen(1)
        else:
            if self._kind == "tcp":
                _probe(opened)
            # Of a datagram socket this only says from whom to receive.
            opened.settimeout(PATIENCE)
            opened.connect(address)
        opened.setblocking(False)

    def _waited_for(self) -> socket.socket | int | None:
        return self._socket or self._server or self._serial

    def _take(self) -> bytes | None:
        """The next piece; None where nothing waits."""
        try:
            if self._serial is not None:
                return os.read(self._serial, LARGEST)
            if self._socket is None:
                return None
            if self._kind == "udpin":
                piece, sender = self._socket.recvfrom(LARGEST)
                self._hear(sender)
                return piece
            return self._socket.recv(LARGEST)
        except BlockingIOError:
            return None
        except ConnectionRefusedError:
            if self.datagrams:
                return None  # what was sent found nobody there
            raise

    def _hear(self, sender: Any) -> None:
        if sender not in self._heard and len(self._heard) >= MOST_HEARD:
            del self._heard[min(self._heard, key=self._heard.__getitem__)]
        self._heard[sender] = time.monotonic()

    def _lose(self, how: str) -> NoReturn:
        if self._server is not None and self._socket is not None:
            # The next client may come at once.
            self._socket.close()
            self._socket = None
        else:
            self.close()
            if time.monotonic() - self._opened >= SETTLED:
                self._pause = FIRST_PAUSE
            self._put_off()
        raise LinkLost(f"The link {self.name} {how}.")

    def _put_off(self) -> None:
        self._not_before = time.monotonic() + self._pause
        self._pause = min(2 * self._pause, LONGEST_PAUSE)

    def _refuse(self, error: OSError) -> NoReturn:
        host, port = self._address
        if isinstance(error, socket.gaierror):
            reason = f"there is no host {host}"
        elif isinstance(error, PermissionError):
            reason = "it is not permitted" + ("; ports below 1024 are the system's" if 0 < port < 1024 else "")
            if self._kind == "serial":
                reason = "it is not permitted: add yourself to the group that owns the port (often dialout)"
        elif isinstance(error, FileNotFoundError):
            reason = "there is no such serial port"
        elif isinstance(error, ConnectionRefusedError):
            reason = "nothing listens there"
        elif isinstance(error, TimeoutError):
            reason = f"nothing answers within {PATIENCE:.0f} s"
        elif self._kind in ("udpin", "tcpin") and "in use" in str(error):
            reason = "the port is in use by another program: close that, or let it forward to another port"
        elif self._kind in ("udpin", "tcpin") and "assign" in str(error):
            reason = f"{host} is no address of this machine"
        else:
            reason = error.strerror or str(error)
        raise Unreadable(f"Cannot open {self.name}: {reason}.") from error


def _understood(name: str) -> tuple[str, str, int]:
    """Kind ("udpin", "udpout", "tcp", "tcpin", or "serial"), host and port that a connection string names.

    Raises:
        Unreadable: it names none.
    """
    network = _NETWORK.fullmatch(name)
    # Without a kind, what stands before the port must look like an address: "mcast:14550" is another kind of link.
    if network is not None and (network[1] or re.search(r"[.\]]|localhost", network[2] or "")):
        kind, host, port = network.groups()
        if int(port) > 65535:
            raise Unreadable(f"{name} names no link: ports go up to 65535.")
        return _KINDS.get(kind, kind), (host or "").strip("[]") or LOOPBACK, int(port)
    if os.path.isfile(name):
        raise Unreadable(f"{name} is a file and no link: `mavdem learn {name}` learns from a log.")
    if not os.path.isabs(name):
        raise Unreadable(
            f"{name!r} names no link: write udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or a "
            "serial port as /dev/ttyACM0,115200."
        )
    return "serial", "", 0


def _probe(connection: socket.socket) -> None:
    """Lets the kernel find out when the other side of a silent connection is gone: one that lost power says nothing."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in (("TCP_KEEPIDLE", SILENCE), ("TCP_KEEPINTVL", PROBED), ("TCP_KEEPCNT", PROBES)):
        if hasattr(socket, option):
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)


def _serial(name: str) -> int:
    """A serial port, raw, at its speed, without waiting for a carrier and without hanging up when it is closed.

    Raises:
        OSError: it cannot be opened.
        Unreadable: its speed is none that it can have.
    """
    if sys.platform == "win32":
        raise Unreadable(f"Cannot open {name}: serial ports need a POSIX system; forward it to UDP.")
    import termios
    import tty

    device, _, speed = name.partition(",")
    baud = getattr(termios, f"B{speed or BAUD}", None)
    if baud is None or not (speed or "1").isdigit():
        raise Unreadable(f"Cannot open {name}: {speed!r} is no speed of a serial port.")
    port = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        tty.setraw(port, termios.TCSANOW)
        settings = termios.tcgetattr(port)
        settings[2] = (settings[2] | termios.CLOCAL | termios.CREAD) & ~(termios.HUPCL | termios.CRTSCTS)
        settings[4] = settings[5] = baud
        termios.tcsetattr(port, termios.TCSANOW, settings)
    except termios.error as error:
        os.close(port)
        raise Unreadable(f"Cannot open {name}: it is no serial port.") from error
    return port
