"""A MAVLink link: a socket or a serial port, by pymavlink's connection strings.

``udpin:HOST:PORT`` (also ``udp:HOST:PORT`` and ``HOST:PORT``), ``udpout:HOST:PORT``, ``tcp:HOST:PORT`` (a server),
``tcpin:HOST:PORT`` (waits for one client) or ``DEVICE[,BAUD]``, whose modem lines stay as they are. Without a HOST it
is this machine. It sends nothing before ``send``. pymavlink's own connections share a port in use instead of failing,
and send to every address that ever sent anything.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import socket
import struct
import sys
import time
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from mavdem.errors import Unreadable
from mavdem.ingest.mavlink.definitions import seeds
from mavdem.ingest.mavlink.framing import (
    HEADER_1,
    LONGEST_FRAME,
    MARKER_1,
    MARKER_2,
    find_in_pieces,
)
from mavdem.ingest.mcap.records import raw_channel, started, write_message
from mavdem.ingest.tlog import write_stamped
from mavdem.ingest.vocabulary import AUTOPILOT_COMPONENT

LOOPBACK = "127.0.0.1"
SO_TIMESTAMPNS, SO_RXQ_OVFL = (35, 40) if sys.platform == "linux" else (0, 0)
"""When each datagram came, and how many found no room. Source: Linux, include/uapi/asm-generic/socket.h."""
MAX_PIECE_BYTES = 1 << 16  # Of a datagram, and of a piece of a byte stream
MAX_PIECES = 512  # Datagrams or pieces taken in one call: a fast sender must not hold up the caller
# How long an address that sent something is sent to, and how many are kept
SENDER_SECONDS = 10.0
MAX_PEERS = 16
CONNECT_SECONDS = 5.0  # Time limit of a connection attempt
# After which a silent client gives way to another, and a silent connection is probed
SILENCE_SECONDS = 5
# Between two probes, and probes without a reply until the connection is lost
PROBE_SECONDS = 2
MAX_PROBES = 3
STABLE_SECONDS = 10.0  # A connection that lasted this long is opened again at once when it is lost
# Since an autopilot's first address was heard last, until another may take its place
HEARD_SECONDS = 3.0
# Before a lost link is opened again; doubled each time
FIRST_PAUSE_SECONDS = 0.25
MAX_PAUSE_SECONDS = 8.0

_NETWORK = re.compile(r"(?:(udpin|udp|udpout|tcp|tcpin):(?!/))?(?:(\[[^\]]*\]|[^:/]*):)?(\d+)")


class LinkLost(Exception):
    """The TCP connection or the serial port is lost; the message is one sentence."""


class Link:
    """An open link, by its connection string ``name``. Raises Unreadable: it cannot be opened, with the reason."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._events: list[str] = []
        # By MAVLink ids: address, when it was heard, and one that was refused, or the first again once that is said.
        self._first: dict[bytes, tuple[Any, float, Any]] = {}
        self._pause = FIRST_PAUSE_SECONDS
        self._not_before = 0.0
        self._opened = self._came = 0.0
        # datagrams that this machine's buffer had no room for: nobody read them in time
        self.dropped = 0
        # UNIX s of the latest piece; until then everything was read
        self._arrival, self._emptied = 0.0, time.time()
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
        """Up to ``MAX_PIECES`` waiting pieces: UNIX s of arrival, and the bytes as they came; none after ``timeout`` s.

        The kernel stamps datagrams. Other pieces arrive when they are read or, where they waited, when everything
        before had been.

        Raises LinkLost: the connection or the port is lost; ``reopen`` opens it again.
        """
        waiting_on = self._waiting_on()
        if waiting_on is None:
            raise LinkLost(f"The link {self.name} is not open.")
        received: list[tuple[float, bytes]] = []
        try:
            # A silent client may be gone; while it sends, others wait.
            replaceable = (
                [self._server]
                if self._server and time.monotonic() - self._came > SILENCE_SECONDS
                else []
            )
            self._arrival = self._emptied
            readable = [waiting_on, *replaceable]
            ready = select.select(readable, [], [], 0.0)[0]
            if not ready:
                ready = select.select(readable, [], [], max(timeout, 0.0))[0]
                self._arrival = self._emptied = time.time()
            if not ready:
                return received
            if self._server is not None and self._socket is None:
                self._socket, _ = self._server.accept()
                _probe(self._socket)
                self._socket.setblocking(False)
                self._came = time.monotonic()
            elif ready == [self._server]:
                self._lose("was silent, and another client waits")
            while len(received) < MAX_PIECES and (piece := self._take()) is not None:
                if not piece and not self.datagrams:
                    if received:
                        break  # return what came; the next call raises
                    self._lose("was closed by the other side")
                if piece:
                    self._came = time.monotonic()
                    if self._admits(piece):
                        received.append((self._arrival, piece))
                    else:
                        # nor is anything sent to a vehicle that only shares the ids
                        self._peers.pop(self._from, None)
            if len(received) < MAX_PIECES:
                self._emptied = time.time()
        except OSError as error:
            if not received:
                self._lose(f"was lost: {error.strerror or error}")
        return received

    def events(self) -> list[str]:
        """Sentences to report since the last call."""
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
            self._lose(f"was lost: {error.strerror or error}")

    def reopen(self) -> bool:
        """Opens a lost link, once its pause is over; returns whether it is open.

        The pause doubles with each attempt, and with each link that is lost within ``STABLE_SECONDS``. An attempt takes
        at most ``CONNECT_SECONDS``.
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
        self._opened = time.monotonic()
        if self._kind == "serial":
            self._serial = _serial(self.name)
            return
        kind = socket.SOCK_DGRAM if self.datagrams else socket.SOCK_STREAM
        try:
            family, _, _, _, address = socket.getaddrinfo(*self._address, type=kind)[0]
        except UnicodeError as error:  # no valid host name
            raise socket.gaierror(str(error)) from error
        opened = socket.socket(family, kind)
        # half a minute of a fast link
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        for option in (SO_TIMESTAMPNS, SO_RXQ_OVFL) if self.datagrams and SO_TIMESTAMPNS else ():
            with contextlib.suppress(OSError):  # an old kernel: datagrams arrive when they are read
                opened.setsockopt(socket.SOL_SOCKET, option, 1)
        if self._kind == "tcpin":
            self._server = opened
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            opened.bind(address)
            opened.listen(1)
        else:
            self._socket = opened
            if self._kind == "tcp":
                _probe(opened)
            # Connecting a datagram socket only sets the peer.
            opened.settimeout(CONNECT_SECONDS)
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
        except (BlockingIOError, ConnectionRefusedError) as error:
            if isinstance(error, BlockingIOError) or self.datagrams:
                return None  # a datagram is refused where the last one sent had no receiver
            raise

    def _admits(self, datagram: bytes) -> bool:
        """Whether the latest datagram is of the first address of its autopilot; other components may have several."""
        ids = b""
        now = self._came
        if len(datagram) >= HEADER_1 and datagram[0] in (MARKER_1, MARKER_2):
            ids = datagram[3:5] if datagram[0] == MARKER_1 else datagram[5:7]
        if self._from is None or ids[1:] != bytes([AUTOPILOT_COMPONENT]):
            return True
        first, heard, rival = self._first.get(ids, (self._from, now, None))
        if first != self._from and now - heard <= HEARD_SECONDS:
            self._first[ids] = first, heard, rival or self._from
            return False
        if rival not in (None, first, self._from):
            # Both send; one that restarts from another port would not send from the first again.
            addresses = " and ".join(f"{host}:{port}" for host, port, *_ in (first, rival))
            said = f"Two addresses send as {ids[0]}:{ids[1]}, {addresses}: only the first is read"
            self._events.append(f"{said}; if they are two vehicles, give one another system id.")
            rival = first
        self._first[ids] = self._from, now, rival if first == self._from else None
        return True

    def _lose(self, how: str) -> NoReturn:
        if self._server is not None and self._socket is not None:
            self._socket.close()
            self._socket = None  # the next client may connect at once
        else:
            if time.monotonic() - self._opened >= STABLE_SECONDS:
                self._pause = FIRST_PAUSE_SECONDS
            self._shut()
        raise LinkLost(f"The link {self.name} {how}.")

    def _shut(self) -> None:
        """Closes it until a pause is over, which doubles each time."""
        self.close()
        self._not_before = time.monotonic() + self._pause
        self._pause = min(2 * self._pause, MAX_PAUSE_SECONDS)

    def _refuse(self, error: OSError) -> NoReturn:
        (host, port) = self._address
        bound = self._kind in ("udpin", "tcpin")
        group = (
            ": join the group that owns the port (often dialout)" if self._kind == "serial" else ""
        )
        remedy = "; ports below 1024 need privileges" if 0 < port < 1024 else group
        used = "the port is in use by another program: close it, or let it forward to another port"
        reasons = (
            (isinstance(error, socket.gaierror), f"there is no host {host}"),
            (isinstance(error, PermissionError), f"it is not permitted{remedy}"),
            (isinstance(error, FileNotFoundError), "there is no such serial port"),
            (isinstance(error, ConnectionRefusedError), "nothing listens there"),
            (isinstance(error, TimeoutError), f"no connection within {CONNECT_SECONDS:.0f} s"),
            (bound and "in use" in str(error), used),
            (bound and "assign" in str(error), f"{host} is not an address of this machine"),
        )
        reason = next((text for holds, text in reasons if holds), error.strerror or str(error))
        raise Unreadable(f"Cannot open {self.name}: {reason}.") from error


def _parsed(name: str) -> tuple[str, str, int]:
    """Kind ("udpin", "udpout", "tcp", "tcpin" or "serial"), host and port of a connection string."""
    network = _NETWORK.fullmatch(name)
    # Without a kind, the host must look like an address: "mcast:14550" is another kind of link.
    if network is not None and (network[1] or re.search(r"[.\]]|localhost", network[2] or "")):
        kind, host, port = network.groups()
        if int(port) > 65535:
            raise Unreadable(f"{name} is not a link: ports go up to 65535.")
        # Without a direction as in pymavlink.
        return (
            ("udpin" if kind in (None, "udp") else kind),
            (host or "").strip("[]") or LOOPBACK,
            int(port),
        )
    if os.path.isfile(name):
        raise Unreadable(f"{name} is a file, not a link: use `mavdem learn {name}`.")
    if not os.path.isabs(name):
        raise Unreadable(
            f"{name!r} is not a link: write udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or a "
            "serial port as /dev/ttyACM0,115200."
        )
    return "serial", "", 0


def _probe(connection: socket.socket) -> None:
    """Makes the kernel probe a silent connection: a peer that lost power does not close it."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in {
        "IDLE": SILENCE_SECONDS,
        "INTVL": PROBE_SECONDS,
        "CNT": MAX_PROBES,
    }.items():
        if hasattr(socket, f"TCP_KEEP{option}"):
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, f"TCP_KEEP{option}"), value)


def _serial(name: str) -> int:
    """Opens a serial port: raw, at its speed, without waiting for a carrier or hanging up at the end."""
    if sys.platform == "win32":
        raise Unreadable(
            f"Cannot open {name}: serial ports need a POSIX system; forward it to UDP."
        )
    import termios
    import tty

    device, _, speed = name.partition(",")
    baud = getattr(termios, f"B{speed or 115200}", None)
    if baud is None or not (speed or "1").isdigit():
        raise Unreadable(f"Cannot open {name}: {speed!r} is not a speed of a serial port.")
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
        raise Unreadable(f"Cannot open {name}: it is not a serial port.") from error
    return port


BATCH_SECONDS = 0.5  # Of received bytes written together: each search for frames costs time


class RawRecording:
    """A growing file, new, of the raw stream, a tlog or as .mcap; a crash loses at most a second.

    Raises Unreadable: the file exists, or cannot be created.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        try:
            self._file = open(path, "xb")  # noqa: SIM115 - open until close()
        except FileExistsError:
            raise Unreadable(
                f"{path} is there already and is not overwritten: name another file."
            ) from None
        except OSError as error:
            raise Unreadable(
                f"{path} cannot be written ({error.strerror or error}): name another file."
            ) from None
        self.frames = 0  # in it; bytes that belong to no frame are not
        self._mcap = started(self._file, 1 << 15) if Path(path).suffix.lower() == ".mcap" else None
        self._channel = 0 if self._mcap is None else raw_channel(self._mcap)
        self._pieces: list[tuple[float, bytes]] = []
        self._first = 0.0

    def take(self, stamp: float, data: bytes) -> None:
        """Adds any bytes that a link received, also parts of frames, at ``stamp``, UNIX s.

        Raises OSError: it cannot be written.
        """
        if not self._pieces:
            self._first = stamp
        self._pieces.append((stamp, data))
        if not 0 <= stamp - self._first < BATCH_SECONDS:
            self._write(last=False)

    def close(self) -> None:
        """Writes the rest and closes the file. Raises OSError: it cannot be written."""
        if self._file.closed:
            return
        with self._file:
            self._write(last=True)
            if self._mcap is not None:
                self._mcap.finish()  # type: ignore[no-untyped-call]

    def _write(self, last: bool) -> None:
        content = b"".join(data for _, data in self._pieces)
        ends = np.cumsum([len(data) for _, data in self._pieces])
        frames, pieces = find_in_pieces(np.frombuffer(content, dtype=np.uint8), ends, seeds())
        searched = len(content)
        if not last:
            # The last frame may not be complete.
            searched = max(int(frames.end.max(initial=0)), len(content) - LONGEST_FRAME)
        stamps = (round(self._pieces[piece][0] * 1e6) for piece in pieces.tolist())
        contents = [
            content[a:b] for a, b in zip(frames.start.tolist(), frames.end.tolist(), strict=True)
        ]
        stamped = zip(stamps, contents, strict=True)
        if self._mcap is None:
            write_stamped(self._file, stamped)
        else:
            for stamp, frame in stamped:
                write_message(self._mcap, self._channel, stamp * 1000, frame)
        self._file.flush()
        self.frames += len(contents)
        self._pieces = (
            [(self._pieces[-1][0], content[searched:])] if searched < len(content) else []
        )
        self._first = self._pieces[0][0] if self._pieces else 0.0
