"""A MAVLink link: a UDP or TCP socket, or a serial port, opened by pymavlink's connection strings.

``udpin:HOST:PORT`` (also ``udp:HOST:PORT`` and ``HOST:PORT``), ``udpout:HOST:PORT``, ``tcp:HOST:PORT`` (a server),
``tcpin:HOST:PORT`` (waits for one client) or ``DEVICE[,BAUD]``, whose modem lines stay as they are. Without a HOST it
is this machine.

It sends nothing before ``send`` is called. pymavlink's own connections are not used: they share a port that is in use
instead of failing, and send to every address that ever sent anything.
"""

import contextlib
import errno
import os
import re
import select
import socket
import struct
import sys
import time
from collections.abc import Sequence
from enum import StrEnum
from typing import Any, NamedTuple, NoReturn

import numpy as np

from mavdem.errors import Unreadable, error_message
from mavdem.facts import Fact, Level
from mavdem.facts.session import LinkError, LinkFact
from mavdem.ingest.mavlink.frame_reader import SEQUENCE_OFFSET_V1, SEQUENCE_OFFSET_V2
from mavdem.ingest.mavlink.framing import HEADER_BYTES_V1, MARKER_V1
from mavdem.ingest.vocabulary import AUTOPILOT_COMPONENT
from mavdem.live.serial_port import NoSerialPort, SerialPort, open_serial_port
from mavdem.machine import LOOPBACK

SO_TIMESTAMPNS = 35 if sys.platform == "linux" else 0
"""Socket option that stamps each datagram with its arrival; 0 where there is none.

Source: Linux, include/uapi/asm-generic/socket.h.
"""

SO_RXQ_OVFL = 40 if sys.platform == "linux" else 0
"""Socket option that counts the datagrams for which the buffer had no room; 0 where there is none. Source: as above."""

SO_MEMINFO = 55 if sys.platform == "linux" else 0
"""Socket option that reads the state of a socket's memory; 0 where there is none. Source: as above."""

MEMORY_INFO = struct.Struct("@9I")
"""What it returns, nine counters; the last is of dropped datagrams.

Source: Linux, include/uapi/linux/sock_diag.h (``SK_MEMINFO_VARS``, ``SK_MEMINFO_DROPS``).
"""

ANCILLARY_BYTES = 64
"""Room for the stamp and the count that come with a datagram, bytes: two headers of 16 with 16 and 4 of data."""

RECEIVE_BUFFER_BYTES = 4 << 20
"""Buffer for datagrams that wait, bytes: half a minute of a fast link."""

MAX_PIECE_BYTES = np.iinfo(np.uint16).max
"""Largest datagram, and largest piece of a byte stream that is read at once, bytes: UDP has 16 bits for the length."""

MAX_PIECES = 512
"""Pieces that one call receives: a choice, so that a fast sender does not hold up the caller."""

MAX_REST_SECONDS = 1.0
"""Longest time for which what waits is received at the end of a session, s: a choice; a full buffer takes less."""

SENDER_SECONDS = 10.0
"""Time for which an address that sent something is sent to, s: a choice."""

MAX_PEERS = 16
"""Addresses that are sent to: a choice."""

CONNECT_SECONDS = 5
"""Time limit of a connection attempt, and silence after which a connection is probed, s: a choice."""

MAX_TRIES = 3
"""Times that something is sent which gets no reply, also probes of a connection: a choice."""

SILENCE_SECONDS = 3.0
"""Time without what usually comes all the time, after which its source counts as gone, s: a choice."""

RETRY_SECONDS = 1.0
"""Time between two attempts to open a lost link, and between two probes of a connection, s: a choice."""

MAX_PORT = np.iinfo(np.uint16).max
"""Largest number of a network port."""

_NETWORK_NAME = re.compile(r"(?:(udpin|udp|udpout|tcp|tcpin):(?!/))?(?:(\[[^\]]*\]|[^:/]*):)?(\d+)")
_HOST_ADDRESS = re.compile(r"[.\]]|localhost")
"""What a host must contain where no kind of link precedes it: "mcast:14550" is another kind of link."""

_WINDOWS_PORT = re.compile(r"COM\d+(,.*)?", re.IGNORECASE)
"""Connection string of a serial port of Windows, which is no path."""


class LinkKind(StrEnum):
    """How a link is connected, by the prefix of its connection string."""

    UDP_IN = "udpin"
    UDP_OUT = "udpout"
    TCP_CLIENT = "tcp"
    TCP_SERVER = "tcpin"
    SERIAL = "serial"


class LinkLost(Exception):
    """The TCP connection or the serial port is lost; ``fact`` states why."""

    def __init__(self, name: str, cause: LinkError, error: OSError | None = None) -> None:
        """Makes the fact that reports to the user which link is lost and why.

        Args:
            name: connection string of the link.
            cause: reason why it is lost.
            error: the system's error, where there is one.
        """
        self.fact = Fact(
            LinkFact.CONNECTION_LOST,
            Level.WATCH,
            name=name,
            cause=cause,
            error=None if error is None else error_message(error),
            reopening=False,
        )
        super().__init__(self.fact)


class _SenderAddress(NamedTuple):
    """The address that an autopilot sends from."""

    address: Any
    """As the socket module gives it."""

    heard_time: float
    """When it was heard last, s of the monotonic clock."""


class _LinkAddress(NamedTuple):
    """What a connection string stands for."""

    kind: LinkKind
    host: str
    port: int


class ReceivedPiece(NamedTuple):
    """A datagram, or the bytes that a stream had at one moment."""

    arrival_time: float
    """Time of arrival, UNIX s."""

    data: bytes
    """The bytes."""


class _ReadPiece(NamedTuple):
    """A datagram, or the bytes that a stream had at one moment, before it is decided whether it may be used."""

    arrival_time: float
    """Time of arrival, UNIX s."""

    data: bytes
    """The bytes; none for an empty datagram, or where the other side of a stream has closed."""

    address: Any = None
    """The address that it came from, as the socket module gives it; None unless ``udpin`` receives from many."""


class Link:
    """A link to a MAVLink vehicle or router: one socket or serial port, which receives and sends bytes.

    Attributes:
        name: its connection string.
        has_datagrams: whether each received piece contains whole frames.
        awaits_greeting: whether the other side sends only after it has received something.
        dropped_datagrams: datagrams for which this machine's buffer had no room, since nobody read them in time.
    """

    def __init__(self, name: str) -> None:
        """Opens the link.

        Args:
            name: a connection string.

        Raises:
            Unreadable: it cannot be opened, with the reason.
        """
        self.name = name
        self._kind, host, port = _parse_name(name)
        self._address = (host, port)
        self.has_datagrams = self._kind in (LinkKind.UDP_IN, LinkKind.UDP_OUT)
        self.awaits_greeting = self._kind is LinkKind.UDP_OUT
        self.dropped_datagrams = 0
        self._events: list[Fact] = []
        # The keys are system and component id of an autopilot, the values the address that it is heard from, and one
        # that was refused.
        self._sender_addresses: dict[bytes, _SenderAddress] = {}
        self._refused_addresses: dict[bytes, Any] = {}
        self._reported_ids = set[bytes]()
        self._reopen_time = 0.0
        # What is open: of a TCP server the listening socket, and with a client the client's; else one of the others.
        self._server: socket.socket | None = None
        self._socket: socket.socket | None = None
        self._serial: SerialPort | None = None
        # When each address was heard last, s of the monotonic clock.
        self._peers: dict[Any, float] = {}
        try:
            self._open()
        except OSError as error:
            self.close()
            self._raise_unreadable(error)

    def receive(self, timeout: float) -> list[ReceivedPiece]:
        """Receives up to ``MAX_PIECES`` pieces that wait, or waits for one.

        A piece is a datagram, or what a byte stream has at the moment. A TCP server accepts its client here, since that
        shows as readable, too. Pieces of an autopilot that only shares the ids of a known one are dropped.

        Args:
            timeout: longest time to wait, s.

        Returns:
            The pieces in the order of arrival, none after a timeout. The kernel stamps datagrams; other pieces arrive
            when they are read.

        Raises:
            LinkLost: the connection or the port is lost; ``reopen`` opens it again.
        """
        source = self._readable_source()
        if source is None:
            raise LinkLost(self.name, LinkError.NOT_OPEN)
        received: list[ReceivedPiece] = []
        try:
            if isinstance(source, socket.socket):
                is_readable = bool(select.select([source], [], [], timeout)[0])
            else:
                is_readable = source.wait(timeout)
            if is_readable:
                read_time = time.time()
                if self._server is not None and self._socket is None:
                    # What became readable is the listening socket: its client connects.
                    self._socket = _accepted_client(self._server)
                self._read_waiting_pieces(received, read_time)
        except OSError as error:
            # What came before the error is returned first; a lasting error comes again in the next call.
            if not received:
                self._raise_lost(LinkError.FAILED, error)
        return received

    def _read_waiting_pieces(self, received: list[ReceivedPiece], read_time: float) -> None:
        """Reads the pieces that wait, until none is left or the list has ``MAX_PIECES``.

        Args:
            received: the list to which they are appended, so that an error does not lose those before it.
            read_time: present time, UNIX s.

        Raises:
            LinkLost: the other side has closed the stream, and nothing came before.
            OSError: the socket or port fails.
        """
        while len(received) < MAX_PIECES:
            piece = self._read_piece(read_time)
            if piece is None:
                return
            if piece.data and self._is_admitted(piece):
                received.append(ReceivedPiece(piece.arrival_time, piece.data))
            elif piece.data:
                # Nothing is sent to a vehicle that only shares the ids of another.
                self._peers.pop(piece.address, None)
            elif not self.has_datagrams:
                # A stream without bytes is closed. What came before is returned first, and the next call raises.
                if not received:
                    self._raise_lost(LinkError.CLOSED)
                return

    def receive_rest(self) -> list[ReceivedPiece]:
        """Receives everything that waits at the end of a session, and counts the datagrams that were dropped before.

        The kernel reports dropped datagrams only with a later one, so those at the end are counted here.

        Returns:
            The same as :meth:`receive`. The call ends after ``MAX_REST_SECONDS`` even if more arrives.
        """
        received = []
        end_time = time.monotonic() + MAX_REST_SECONDS
        try:
            while time.monotonic() < end_time:
                pieces = self.receive(0.0)
                received += pieces
                if len(pieces) < MAX_PIECES:
                    break
        except LinkLost:
            # What was received before the loss is returned. At the end of a session the link is not opened again.
            pass
        if self.has_datagrams and self._socket is not None and SO_MEMINFO:
            # An old kernel does not know the option.
            with contextlib.suppress(OSError, struct.error):
                info = self._socket.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, MEMORY_INFO.size)
                # The last number is the count of dropped datagrams.
                dropped_count = MEMORY_INFO.unpack(info)[-1]
                self.dropped_datagrams = max(self.dropped_datagrams, dropped_count)
        return received

    def drain_events(self) -> list[Fact]:
        """Returns the facts to report since the last call, and forgets them."""
        events = self._events
        self._events = []
        return events

    def send(self, frame: bytes) -> None:
        """Sends whole frames; a ``udpin`` link sends them to all addresses it heard in the last ``SENDER_SECONDS``.

        A ``udpin`` link has no fixed peer, so it replies to all senders. The call never waits. If the other side is too
        slow, or nobody listens to datagrams, the frames are dropped, and the caller must send them again if no reply
        comes.

        Args:
            frame: bytes of one or more MAVLink frames.

        Raises:
            LinkLost: the TCP connection or the serial port is lost; ``reopen`` opens it again.
        """
        try:
            if self._serial is not None:
                self._serial.write(frame)
            elif self._socket is None:
                # No client has connected yet.
                return
            elif self._kind is LinkKind.UDP_IN:
                for address, heard_time in self._peers.items():
                    if time.monotonic() - heard_time <= SENDER_SECONDS:
                        self._socket.sendto(frame, address)
            else:
                self._socket.sendall(frame)
        except BlockingIOError:
            # The buffer for sending is full.
            return
        except OSError as error:
            # UDP has no connection that could be lost: the next datagram may well arrive.
            if self.has_datagrams:
                return
            self._raise_lost(LinkError.FAILED, error)

    def reopen(self) -> bool:
        """Tries to open a lost link again.

        It is called again and again while the link is lost. To spare the other side, it tries only once
        ``RETRY_SECONDS`` have passed since the loss or the last attempt. An attempt takes at most ``CONNECT_SECONDS``.

        Returns:
            Whether the link is open now.
        """
        if self._readable_source() is None and time.monotonic() >= self._reopen_time:
            try:
                self._open()
            except OSError:
                self._close_for_a_while()
        return self._readable_source() is not None

    def close(self) -> None:
        """Closes the link; it may be closed already."""
        for open_socket in (self._socket, self._server):
            if open_socket is not None:
                open_socket.close()
        if self._serial is not None:
            self._serial.close()
        self._socket = None
        self._server = None
        self._serial = None

    def _open(self) -> None:
        """Opens the socket or the serial port, by the link's kind, and makes it non-blocking.

        A TCP server listens; its client connects later, in ``receive``.

        Raises:
            OSError: it cannot be opened.
        """
        if self._kind is LinkKind.SERIAL:
            try:
                self._serial = open_serial_port(self.name)
            except NoSerialPort as error:
                raise _cannot_open(self.name, error.cause, repr(error.speed)) from None
            return
        socket_type = socket.SOCK_DGRAM if self.has_datagrams else socket.SOCK_STREAM
        host, port = self._address
        try:
            family, _, _, _, address = socket.getaddrinfo(host, port, type=socket_type)[0]
        except UnicodeError as error:
            # Not a valid host name.
            raise socket.gaierror(str(error)) from error
        if self._kind is LinkKind.TCP_SERVER:
            opened = socket.create_server(self._address, family=family, backlog=1)
            self._server = opened
        elif self._kind is LinkKind.TCP_CLIENT:
            opened = socket.create_connection(self._address, CONNECT_SECONDS)
            self._socket = opened
            _enable_probes(opened)
        else:
            opened = socket.socket(family, socket_type)
            self._socket = opened
            self._open_datagrams(opened, address)
        opened.setblocking(False)

    def _open_datagrams(self, opened: socket.socket, address: Any) -> None:
        """Prepares a new UDP socket: its buffer, the kernel's stamps, and its address.

        A large buffer holds what comes while this computer is busy.

        Args:
            opened: the new socket, which is not bound to an address yet.
            address: address at which ``udpin`` listens, or to which ``udpout`` sends, in the form of the socket module.

        Raises:
            OSError: the address is in use, or does not belong to this machine.
        """
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        if SO_TIMESTAMPNS:
            for option in (SO_TIMESTAMPNS, SO_RXQ_OVFL):
                # An old kernel does not know them: datagrams then arrive when they are read.
                with contextlib.suppress(OSError):
                    opened.setsockopt(socket.SOL_SOCKET, option, 1)
        if self._kind is LinkKind.UDP_IN:
            opened.bind(address)
        else:
            # Connecting a UDP socket sends nothing: it only sets the address of the other side.
            opened.connect(address)

    def _readable_source(self) -> socket.socket | SerialPort | None:
        """What becomes readable when something comes; None while the link is not open."""
        return self._socket or self._server or self._serial

    def _read_piece(self, read_time: float) -> _ReadPiece | None:
        """Reads the next piece from the serial port or the socket, whichever is open, without waiting.

        Only a ``udpin`` link can have several senders. The address of each is noted, since replies are sent to all of
        them (:meth:`send`). The pieces of other links have no address.

        Args:
            read_time: present time, UNIX s: the time of arrival of a piece that the kernel does not stamp.

        Returns:
            A datagram or some bytes of a stream; None if nothing waits.
        """
        try:
            if self._serial is not None:
                data = self._serial.read()
                return None if data is None else _ReadPiece(read_time, data)
            if self._socket is None:
                return None
            if self.has_datagrams and SO_TIMESTAMPNS:
                piece = self._read_stamped_datagram(self._socket, read_time)
            else:
                data, address = self._socket.recvfrom(MAX_PIECE_BYTES)
                piece = _ReadPiece(read_time, data, address)
            if self._kind is LinkKind.UDP_IN:
                self._remember_peer(piece.address)
                return piece
            return piece._replace(address=None)
        except (BlockingIOError, ConnectionRefusedError):
            # Nothing waits. Or the last datagram that this link sent had no receiver, which the next call reports as a
            # refusal: that is no fault, since the vehicle may be switched on later.
            return None
        except ConnectionResetError:
            if self.has_datagrams:
                # Windows reports in this way that the last datagram had no receiver.
                return None
            # The TCP connection is lost, which the caller reports.
            raise

    def _read_stamped_datagram(self, opened: socket.socket, read_time: float) -> _ReadPiece:
        """Reads a datagram with its arrival by the kernel, which is exact even if it has waited to be read.

        It also takes the kernel's count of datagrams that were dropped since the socket was opened. Both come with the
        datagram as ancillary data, in the machine's native integers (socket(7) of Linux).

        Args:
            opened: a UDP socket with the options ``SO_TIMESTAMPNS`` and ``SO_RXQ_OVFL``.
            read_time: present time, UNIX s, for a datagram without a stamp.

        Returns:
            The datagram, with the address of its sender.
        """
        # Windows has no such method, nor such options of sockets.
        receive_message: Any = getattr(opened, "recvmsg", None)
        data, ancillary, _, address = receive_message(MAX_PIECE_BYTES, ANCILLARY_BYTES)
        arrival_time = read_time
        for _, option, value in ancillary:
            if option == SO_TIMESTAMPNS:
                seconds, nanoseconds = struct.unpack("@2l", value)
                arrival_time = seconds + 1e-9 * nanoseconds
            elif option == SO_RXQ_OVFL:
                self.dropped_datagrams = struct.unpack("@I", value)[0]
        return _ReadPiece(arrival_time, data, address)

    def _remember_peer(self, address: Any) -> None:
        """Notes that a datagram came from ``address``, so that ``send`` replies to it.

        Beyond ``MAX_PEERS`` the address that was not heard for longest is forgotten: anyone can send to a UDP port, and
        the memory must stay bounded.

        Args:
            address: host and port of the sender.
        """
        if address not in self._peers and len(self._peers) >= MAX_PEERS:
            oldest_address = min(self._peers, key=lambda peer: self._peers[peer])
            del self._peers[oldest_address]
        self._peers[address] = time.monotonic()

    def _is_admitted(self, piece: _ReadPiece) -> bool:
        """Returns whether a datagram may be used: each autopilot is accepted from one network address only.

        Two vehicles with the same MAVLink ids, a common mistake with new autopilots, would be read as one vehicle that
        jumps between two attitudes. The address that was heard first counts until it is silent for ``SILENCE_SECONDS``,
        since one vehicle may come back from another port. Only if the first address goes on while another one was
        refused are there really two senders, which is reported once for each pair of ids.

        Args:
            piece: the datagram, with the address of its sender. Only its first frame is looked at. Frames of other
                components than autopilots are always accepted, and so is what has no address.
        """
        address = piece.address
        ids = _ids_of_autopilot(piece.data)
        if ids is None or address is None:
            return True
        now = time.monotonic()
        first_sender = self._sender_addresses.get(ids, _SenderAddress(address, now))
        is_first_address = first_sender.address == address
        is_first_silent = now - first_sender.heard_time > SILENCE_SECONDS
        if not is_first_address and not is_first_silent:
            self._refused_addresses.setdefault(ids, address)
            return False
        self._sender_addresses[ids] = _SenderAddress(address, now)
        # The first address sends after another was refused. So both send, and it is no restart from another port.
        do_both_send = is_first_address and ids in self._refused_addresses
        if do_both_send and ids not in self._reported_ids:
            self._reported_ids.add(ids)
            self._report_two_addresses(ids, [address, self._refused_addresses[ids]])
        return True

    def _report_two_addresses(self, ids: bytes, addresses: Sequence[Any]) -> None:
        """Reports that two network addresses send as the same autopilot.

        Args:
            ids: system and component id of the autopilot.
            addresses: the two addresses, as a socket has them: host and port first.
        """
        names = []
        for address in addresses:
            host, port = address[:2]
            names.append(f"{host}:{port}")
        system, component = ids
        subject = f"{system}:{component}"
        self._events.append(Fact(LinkFact.TWO_ADDRESSES, subject=subject, names=names))

    def _raise_lost(self, cause: LinkError, error: OSError | None = None) -> NoReturn:
        """Closes the lost connection and raises ``LinkLost``.

        A TCP server loses only its client, and waits for the next one. Any other link is closed, to be opened again
        later.

        Args:
            cause: reason why the link is lost.
            error: error of the system, if there was one.

        Raises:
            LinkLost: always.
        """
        has_client = self._server is not None and self._socket is not None
        if self._socket is not None and has_client:
            self._socket.close()
            self._socket = None
        else:
            self._close_for_a_while()
        raise LinkLost(self.name, cause, error)

    def _close_for_a_while(self) -> None:
        """Closes the link until ``RETRY_SECONDS`` are over."""
        self.close()
        self._reopen_time = time.monotonic() + RETRY_SECONDS

    def _raise_unreadable(self, error: OSError) -> NoReturn:
        """Raises ``Unreadable`` with the reason for which the system could not open the link.

        A name that cannot be resolved and a connection that times out have error classes of their own; other causes are
        distinguished by the error number.

        Args:
            error: error with which the system refused to open the link.

        Raises:
            Unreadable: always.
        """
        host, port = self._address
        if isinstance(error, socket.gaierror):
            cause = LinkError.NO_HOST
        elif isinstance(error, TimeoutError):
            cause = LinkError.NO_REPLY
        else:
            cause = CAUSES_BY_ERRNO.get(error.errno or 0, LinkError.FAILED)
        message = error_message(error)
        raise _cannot_open(self.name, cause, host, port, message) from error


CAUSES_BY_ERRNO = {
    errno.EADDRINUSE: LinkError.IN_USE,
    errno.EADDRNOTAVAIL: LinkError.NOT_LOCAL,
    errno.ECONNREFUSED: LinkError.NOT_LISTENING,
    errno.EACCES: LinkError.NOT_PERMITTED,
    errno.EPERM: LinkError.NOT_PERMITTED,
    errno.ENOENT: LinkError.NO_PORT,
}
"""Why a link cannot be opened, by the system's error number."""


def _ids_of_autopilot(datagram: bytes) -> bytes | None:
    """Returns system and component id of the first frame of a datagram, two bytes; None if no autopilot sent it.

    Args:
        datagram: bytes of one or more MAVLink frames, of version 1 or 2.
    """
    if len(datagram) < HEADER_BYTES_V1:
        return None
    is_version_1 = datagram[0] == MARKER_V1
    sequence_offset = SEQUENCE_OFFSET_V1 if is_version_1 else SEQUENCE_OFFSET_V2
    # System and component id, one byte each, follow the sequence number. A datagram of version 2 may be too short.
    ids = datagram[sequence_offset + 1 : sequence_offset + 3]
    is_from_autopilot = len(ids) == 2 and ids[1] == AUTOPILOT_COMPONENT
    return ids if is_from_autopilot else None


def _parse_name(name: str) -> _LinkAddress:
    """Parses a connection string, whose forms the module's documentation lists.

    A name that is no network address must be the absolute path of a serial device, or a name such as COM3. Whether
    there is such a device is found out when it is opened.

    Args:
        name: the connection string, such as "udp:0.0.0.0:14550" or "/dev/ttyUSB0".

    Returns:
        Kind, host and port; empty host and port 0 of a serial port.

    Raises:
        Unreadable: it is neither, it is a file such as a log, or a folder, or its port number is too high.
    """
    network_name = _NETWORK_NAME.fullmatch(name)
    if network_name is not None:
        prefix, host, port_text = network_name.groups(default="")
        if prefix or _HOST_ADDRESS.search(host):
            port = int(port_text)
            if port > MAX_PORT:
                raise Unreadable(LinkFact.LINK_PORT_TOO_HIGH, name=name)
            # A link without a direction listens, as in pymavlink.
            kind = LinkKind.UDP_IN if prefix in ("", "udp") else LinkKind(prefix)
            # An address of version 6 stands in brackets.
            return _LinkAddress(kind, host.strip("[]") or LOOPBACK, port)
    if os.path.isfile(name):
        raise Unreadable(LinkFact.FILE_IS_NO_LINK, name=name)
    if os.path.isdir(name):
        raise Unreadable(LinkFact.FOLDER_IS_NO_LINK, name=name)
    if not os.path.isabs(name) and not _WINDOWS_PORT.fullmatch(name):
        raise Unreadable(LinkFact.NOT_A_LINK, name=name)
    return _LinkAddress(LinkKind.SERIAL, "", 0)


def _cannot_open(
    name: str, cause: LinkError, host: str = "", port: int = 0, message: str = ""
) -> Unreadable:
    """Returns the error for a link that cannot be opened; its sentence states why, and what to do.

    Args:
        name: connection string of the link.
        cause: reason why it cannot be opened, which decides the sentence.
        host: host name of a network link. For a serial port, the speed that the port does not have.
        port: port number of a network link.
        message: error message of the system, if there is one.

    Returns:
        The error, which the caller raises.
    """
    return Unreadable(
        LinkFact.CANNOT_OPEN_LINK,
        name=name,
        cause=cause,
        host=host,
        port=port,
        error=message,
        duration=float(CONNECT_SECONDS),
    )


def _accepted_client(server: socket.socket) -> socket.socket:
    """Accepts the client that connects to a TCP server, and returns its socket, which never waits.

    Args:
        server: the listening socket, which has become readable.
    """
    client, _ = server.accept()
    _enable_probes(client)
    client.setblocking(False)
    return client


def _enable_probes(connection: socket.socket) -> None:
    """Makes the kernel probe a silent TCP connection, since a peer that loses power or its radio does not close it.

    The first probe is sent after ``CONNECT_SECONDS`` of silence, others every ``RETRY_SECONDS``. When ``MAX_TRIES`` of
    them have no reply, reading fails, and the link counts as lost.

    Args:
        connection: the TCP connection, as a socket.
    """
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    settings = {
        "TCP_KEEPIDLE": CONNECT_SECONDS,
        "TCP_KEEPINTVL": round(RETRY_SECONDS),
        "TCP_KEEPCNT": MAX_TRIES,
    }
    for option, value in settings.items():
        # Not every system has all of them.
        if hasattr(socket, option):
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
