"""The link on loopback: what it hears, what it says when it cannot be opened or is lost, and that it keeps silent."""

import os
import pty
import socket
import termios
import time
from contextlib import closing, contextmanager
from pathlib import Path

from command_line import free_port
from mavlink_streams import message
from pytest import fixture, mark, raises
from refusals import refused, unreadable

from mavdem.facts.session import LinkError, LinkFact
from mavdem.live.link import (
    MAX_PIECES,
    RETRY_SECONDS,
    Link,
    LinkLost,
)

HEARTBEAT = message("HEARTBEAT", system=1, component=1, type=2, autopilot=3)


def udp():
    vehicle_socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    vehicle_socket.bind(("127.0.0.1", 0))
    vehicle_socket.settimeout(0.2)
    return vehicle_socket


def server():
    return socket.create_server(("127.0.0.1", 0))


def port_of(vehicle_socket):
    return vehicle_socket.getsockname()[1]


@contextmanager
def listening(form="udpin:127.0.0.1:{}"):
    port = free_port()
    with closing(Link(form.format(port))) as link:
        yield link, ("127.0.0.1", port)


def everything(link):
    until = time.perf_counter() + 60.0
    while not (came := link.receive(0.05)) and time.perf_counter() < until:
        pass
    return b"".join(data for _, data in came)


def cause_of_loss(link):
    return refused(link.receive, 60.0, kind=LinkLost).figures["cause"]


def assert_silent(vehicle_socket):
    vehicle_socket.setblocking(False)
    with raises(BlockingIOError):
        vehicle_socket.recv(100)
    vehicle_socket.settimeout(0.2)


@fixture
def clock(monkeypatch):
    """The clock that pauses and silences are measured with: it stands still until it is moved."""
    now = [100.0]
    monkeypatch.setattr("mavdem.live.link.time.monotonic", lambda: now[0])
    return now


@mark.slow
def test_datagrams_come_whole_in_order_and_stamped():
    """A UDP link receives more datagrams than it returns at a time, with the time of arrival of each.

    Datagrams that overflow its buffer are counted as dropped.
    """
    sent_datagrams = [bytes([number % 256]) * 10 for number in range(MAX_PIECES + 5)]
    with listening() as (link, address), udp() as vehicle:
        began = time.time()
        for datagram in sent_datagrams:
            vehicle.sendto(datagram, address)
        pieces = []
        while len(pieces) < len(sent_datagrams):  # A busy kernel delivers some ms later.
            pieces += (batch := link.receive(60.0))
            assert 0 < len(batch) <= MAX_PIECES
        stamps, received = zip(*pieces, strict=True)
        assert list(received) == sent_datagrams and link.receive(0.0) == []
        assert began <= min(stamps) <= max(stamps) <= time.time()
        assert len({*stamps[:MAX_PIECES]}) > 1, (
            "when they arrived, not when they are read: those of one call would be equal"
        )
        link._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 14)
        for _ in range(400):
            vehicle.sendto(HEARTBEAT, address)
        received_count = 0
        while batch := link.receive(0.5):
            received_count += len(batch)
        vehicle.sendto(HEARTBEAT, address)
        assert len(link.receive(60.0)) == 1 and link.dropped_datagrams == 400 - received_count > 0


@mark.slow
def test_what_waits_at_the_end_is_received_and_what_was_dropped_before_is_counted():
    with listening() as (link, address), udp() as vehicle:
        for _ in range(2 * MAX_PIECES):
            vehicle.sendto(HEARTBEAT, address)
        assert len(link.receive_rest()) == 2 * MAX_PIECES
        assert link.dropped_datagrams == 0
        link._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 14)
        for _ in range(400):
            vehicle.sendto(HEARTBEAT, address)
        received = len(link.receive_rest())
        assert 0 < received < 400
        assert link.dropped_datagrams == 400 - received


def test_of_two_autopilots_with_the_same_ids_only_the_first_is_received(clock):
    """Two sockets send heartbeats of system 1: the second is received once the first has been silent for 4 s."""
    others = message("HEARTBEAT", system=255, component=190, type=6, autopilot=8)
    with listening() as (link, address), udp() as first, udp() as second:

        def received(*senders, frame=HEARTBEAT):
            clock[0] += 0.5
            for sender in senders:
                sender.sendto(frame, address)
            return len(link.receive(1.0))

        assert [received(first, second) for _ in range(6)] == [1] * 6
        (fact,) = link.drain_events()
        assert fact.code is LinkFact.TWO_ADDRESSES and fact.subject == "1:1"
        assert fact.figures["names"] == tuple(
            f"127.0.0.1:{port_of(vehicle_socket)}" for vehicle_socket in (first, second)
        )
        link.send(HEARTBEAT)
        assert first.recv(100) == HEARTBEAT
        assert_silent(second)
        assert received(first, second, frame=others) == 2, "ground stations may share ids"
        clock[0] += 4.0
        assert received(second) == 1, (
            "the first has gone: the second is the vehicle, restarted perhaps"
        )
        assert received(second) == 1 and link.drain_events() == []


@mark.parametrize("form", ["udpin:{}", "udpin::{}", "udp:{}", "127.0.0.1:{}"])
def test_without_a_host_only_this_machine_is_listened_to(form):
    # All of 127.0.0.0/8 is this machine: what is bound to 127.0.0.1 alone does not hear the rest of it.
    with listening(form) as (link, (host, port)), udp() as vehicle:
        vehicle.sendto(b"to another address", ("127.0.0.2", port))
        vehicle.sendto(b"here", (host, port))
        assert everything(link) == b"here"


def test_nothing_is_sent_by_opening_and_receiving():
    """A UDP and a TCP link are opened and read. The other side receives nothing before send is called."""
    with udp() as peer, closing(Link(f"udpout:127.0.0.1:{port_of(peer)}")) as out:
        out.receive(0.05)
        assert_silent(peer)
    with listening() as (link, address), udp() as vehicle:
        vehicle.sendto(b"hello", address)
        assert everything(link) == b"hello"
        assert_silent(vehicle)
        link.send(b"now")
        assert vehicle.recv(100) == b"now"
    with (
        server() as listener,
        closing(Link(f"tcp:127.0.0.1:{port_of(listener)}")) as link,
        listener.accept()[0] as peer,
    ):
        peer.sendall(b"hello")
        assert everything(link) == b"hello"
        assert_silent(peer)
        link.send(b"now")
        assert peer.recv(100) == b"now"


def test_a_server_that_goes_away_is_reported_and_comes_back(clock):
    """A TCP server closes the connection; after a pause the link connects to it again."""
    with server() as listener, closing(Link(f"tcp:127.0.0.1:{port_of(listener)}")) as link:
        peer, _ = listener.accept()
        peer.sendall(b"last words")
        peer.close()
        assert everything(link) == b"last words"
        for cause in (LinkError.CLOSED, LinkError.NOT_OPEN):
            assert cause_of_loss(link) is cause
        assert not link.reopen(), "a pause comes first"
        clock[0] += RETRY_SECONDS
        assert link.reopen()
        with listener.accept()[0] as new_connection:
            new_connection.sendall(b"hello again")
            assert everything(link) == b"hello again"


def test_a_client_gives_way_to_another_when_it_closes():
    with listening("tcpin:127.0.0.1:{}") as (link, address):
        with socket.create_connection(address) as first:
            first.sendall(b"one")
            assert everything(link) == b"one"
        with socket.create_connection(address) as second:
            second.sendall(b"two")
            assert cause_of_loss(link) is LinkError.CLOSED
            assert link.reopen()
            assert everything(link) == b"two"


def test_a_serial_port_is_read_raw_silent_and_its_loss_is_reported():
    """A pseudo-terminal stands in for a flight controller.

    All 256 bytes pass unchanged, none is echoed, and no control line is dropped.
    """
    controller, port = pty.openpty()
    link = Link(f"{os.ttyname(port)},57600")
    flags = termios.tcgetattr(port)[2]
    assert flags & termios.CLOCAL and flags & termios.CREAD and not flags & termios.HUPCL
    assert flags & termios.CSIZE == termios.CS8
    os.write(controller, bytes(range(256)))
    received = b""
    while len(received) < 256:
        received += everything(link)
    assert received == bytes(range(256))
    os.set_blocking(controller, False)
    with raises(BlockingIOError):
        os.read(controller, 100)
    link.send(b"\n\x03\x11")
    os.set_blocking(controller, True)
    assert os.read(controller, 100) == b"\n\x03\x11"
    os.close(port)
    os.close(controller)
    assert cause_of_loss(link) in (LinkError.FAILED, LinkError.CLOSED) and not link.reopen()


@mark.parametrize(
    "name, code",
    {
        "udpin:127.0.0.1": LinkFact.NOT_A_LINK,
        "": LinkFact.NOT_A_LINK,
        "mcast:14550": LinkFact.NOT_A_LINK,
        "COM3": LinkError.NO_PORT,
        "udpin:a:b:c": LinkFact.NOT_A_LINK,
        "udpin:127.0.0.1:99999": LinkFact.LINK_PORT_TOO_HIGH,
        __file__: LinkFact.FILE_IS_NO_LINK,
        str(Path(__file__).parent): LinkFact.FOLDER_IS_NO_LINK,
        "tcp:no.such.host.invalid:5760": LinkError.NO_HOST,
        "udpin:192.0.2.1:14550": LinkError.NOT_LOCAL,
        "/dev/no_such_port": LinkError.NO_PORT,
        "/dev/null": LinkError.NOT_SERIAL,
        "/dev/ttyACM0,-1": LinkError.NO_SPEED,
        "tcp:127.0.0.1:{}": LinkError.NOT_LISTENING,
        "udpin:127.0.0.1:{}": LinkError.IN_USE,
    }.items(),
)
def test_why_a_link_cannot_be_opened_is_said(name, code):
    """Each name of a link is refused with its own code, in one line.

    The placeholder is a port that is in use for UDP and not open for TCP.
    """
    with udp() as vehicle_socket:
        fact = unreadable(Link, name.format(port_of(vehicle_socket)))
    assert code in (fact.code, fact.figures.get("cause"))
    assert "\n" not in fact.sentence_and_remedy
