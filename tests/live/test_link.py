"""The link on loopback: what it hears, what it says when it cannot be opened or is lost, and that it keeps silent."""

import os
import pty
import random
import shutil
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from mavlink_streams import flight, frame, heartbeat, message

from mavdem.errors import Unreadable
from mavdem.ingest import read_log
from mavdem.ingest.formats import read_stream
from mavdem.live.link import (
    FIRST_PAUSE_SECONDS,
    MAX_PIECES,
    SILENCE_SECONDS,
    Link,
    LinkLost,
    RawRecording,
)

HEARTBEAT = message("HEARTBEAT", system=1, component=1, type=2, autopilot=3)


def udp() -> socket.socket:
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.bind(("127.0.0.1", 0))
    one.settimeout(0.2)
    return one


def server() -> socket.socket:
    return socket.create_server(("127.0.0.1", 0))


def port_of(one: socket.socket) -> int:
    return one.getsockname()[1]


@contextmanager
def listening(form: str = "udpin:127.0.0.1:{}") -> Iterator[tuple[Link, tuple[str, int]]]:
    with udp() as one:
        port = port_of(one)
    with closing(Link(form.format(port))) as link:
        yield link, ("127.0.0.1", port)


def everything(link: Link, pieces: int = 1, patience: float = 60.0) -> bytes:
    received = b""
    until = time.perf_counter() + patience
    while pieces > 0 and time.perf_counter() < until:
        came = link.receive(0.05)
        pieces -= len(came)
        received += b"".join(data for _, data in came)
    return received


def assert_silent(one: socket.socket) -> None:
    one.setblocking(False)
    with pytest.raises(BlockingIOError):
        one.recv(100)
    one.settimeout(0.2)


@pytest.fixture
def clock(monkeypatch):
    """The clock that pauses and silences are measured with: it stands still until it is moved."""
    now = [100.0]
    monkeypatch.setattr("mavdem.live.link.time.monotonic", lambda: now[0])
    return now


def test_datagrams_come_whole_stamped_in_order_and_in_a_bounded_number():
    with listening() as (link, address), udp() as vehicle:
        before = time.time()
        for number in range(MAX_PIECES + 5):
            vehicle.sendto(bytes([number % 256]) * 10, address)
        time.sleep(0.05)  # a busy kernel delivers some ms later
        reading = time.time()
        received = link.receive(1.0)
        assert [data for _, data in received] == [
            bytes([number % 256]) * 10 for number in range(MAX_PIECES)
        ]
        assert all(before <= stamp <= reading for stamp, _ in received), (
            "when they arrived, not when they are read"
        )
        assert len(link.receive(1.0)) == 5 and link.receive(0.0) == []
        link._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 14)
        for _ in range(400):
            vehicle.sendto(HEARTBEAT, address)
        found = len(link.receive(1.0))
        vehicle.sendto(HEARTBEAT, address)
        assert len(link.receive(1.0)) == 1 and link.dropped == 400 - found > 0


def test_of_two_autopilots_with_the_same_ids_the_first_is_received_and_that_is_said_once(clock):
    others = message("HEARTBEAT", system=255, component=190, type=6, autopilot=8)
    with listening() as (link, address), udp() as first, udp() as second:

        def received(*senders: socket.socket, frame: bytes = HEARTBEAT) -> int:
            clock[0] += 0.5
            for sender in senders:
                sender.sendto(frame, address)
            return len(link.receive(1.0))

        assert [received(first, second) for _ in range(6)] == [1] * 6
        (said,) = link.events()
        assert "if they are two vehicles" in said, "it may be one, over two links"
        assert f"127.0.0.1:{port_of(first)}" in said and f"127.0.0.1:{port_of(second)}" in said
        link.send(HEARTBEAT)
        assert first.recv(100) == HEARTBEAT
        assert_silent(second)
        assert received(first, second, frame=others) == 2, "ground stations may share ids"
        assert received(first, second, frame=b"$GPGGA\x01\x01,") == 2, "no frame has no ids"
        clock[0] += 4.0
        assert received(second) == 1, (
            "the first has gone: the second is the vehicle, restarted perhaps"
        )
        assert received(second) == 1 and link.events() == []


@pytest.mark.parametrize("form", ["udpin:{}", "udpin::{}", "udp:{}", "127.0.0.1:{}"])
def test_without_a_host_only_this_machine_is_listened_to(form):
    # All of 127.0.0.0/8 is this machine: what is bound to 127.0.0.1 alone does not hear the rest of it.
    with listening(form) as (link, (host, port)), udp() as vehicle:
        vehicle.sendto(b"to another address", ("127.0.0.2", port))
        vehicle.sendto(b"here", (host, port))
        assert everything(link) == b"here"


def test_nothing_is_sent_by_opening_and_receiving():
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
    with server() as listener, closing(Link(f"tcp:127.0.0.1:{port_of(listener)}")) as link:
        peer, _ = listener.accept()
        peer.sendall(b"last words")
        peer.close()
        assert everything(link) == b"last words"
        with pytest.raises(LinkLost, match="closed by the other side"):
            link.receive(1.0)
        with pytest.raises(LinkLost, match="not open"):
            link.receive(0.0)
        assert not link.reopen(), "a pause comes first"
        clock[0] += FIRST_PAUSE_SECONDS
        assert link.reopen()
        with listener.accept()[0] as again:
            again.sendall(b"hello again")
            assert everything(link) == b"hello again"


def test_a_client_that_is_silent_gives_way_to_another_and_one_that_talks_does_not(clock):
    with (
        listening("tcpin:127.0.0.1:{}") as (link, address),
        socket.create_connection(address) as first,
    ):
        first.sendall(b"one")
        assert everything(link) == b"one"
        with socket.create_connection(address) as second:
            second.sendall(b"two")
            for _ in range(5):
                clock[0] += SILENCE_SECONDS - 1
                first.sendall(b"more")
                assert everything(link) == b"more"
            clock[0] += SILENCE_SECONDS + 1
            with pytest.raises(LinkLost, match="was silent, and another client waits"):
                link.receive(60.0)
            assert link.reopen()
            assert everything(link) == b"two"


def test_a_serial_port_is_read_raw_silent_and_its_loss_is_reported():
    controller, port = pty.openpty()
    link = Link(f"{os.ttyname(port)},57600")
    os.write(controller, bytes(range(256)))
    received = b""
    while len(received) < 256:
        received += everything(link)
    assert received == bytes(range(256))
    os.set_blocking(controller, False)
    with pytest.raises(BlockingIOError):
        os.read(controller, 100)
    link.send(b"\n\x03\x11")
    os.set_blocking(controller, True)
    assert os.read(controller, 100) == b"\n\x03\x11"
    os.close(port)
    os.close(controller)
    with pytest.raises(LinkLost):
        link.receive(1.0)
    assert not link.reopen()


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        *(
            (name, "is not a link")
            for name in ("udpin:127.0.0.1", "", "mcast:14550", "COM3", "udpin:a:b:c")
        ),
        ("udpin:127.0.0.1:99999", "ports go up to 65535"),
        ("tcp:no.such.host.invalid:5760", "there is no host no.such.host.invalid"),
        ("udpin:192.0.2.1:14550", "not an address of this machine"),
        ("/dev/no_such_port", "there is no such serial port"),
        ("/dev/null", "it is not a serial port"),
        ("/dev/ttyACM0,-1", "is not a speed of a serial port"),
        ("tcp:127.0.0.1:{}", "nothing listens there"),
    ],
)
def test_what_cannot_be_opened_is_said_in_one_sentence(name, reason):
    with udp() as one:
        name = name.format(port_of(one))
    with pytest.raises(Unreadable, match=reason) as refusal:
        Link(name)
    assert str(refusal.value).count("\n") == 0
    with (
        udp() as taken,
        pytest.raises(Unreadable, match=r"Cannot open udpin:127.0.0.1:\d+: the port is in use"),
    ):
        Link(f"udpin:127.0.0.1:{port_of(taken)}")


def test_what_nobody_takes_is_dropped():
    with udp() as gone:
        link = Link(f"udpout:127.0.0.1:{port_of(gone)}")
    for _ in range(3):
        link.send(b"into the void")
        assert link.receive(0.01) == []
    link.close()


FRAMES = [heartbeat(), *flight([20 + 0.01 * row for row in range(400)])]
# of another dialect, and damaged
OTHERS = [frame(64_000, b"abc", seed=3), frame(33, bytes(range(28)), seed=1)]
NOW = 1.7e9


def recorded(path: Path) -> list[tuple[int, bytes]]:
    return list(read_stream(path).stamped_frames())


@pytest.mark.parametrize("form", [".tlog", ".mcap"])
def test_datagrams_are_kept_with_their_stamps(tmp_path, form):
    frames = [*FRAMES[:200], *OTHERS, *FRAMES[200:]]
    recording = RawRecording(tmp_path / f"flight{form}")
    for row, each in enumerate(frames):
        recording.take(NOW + 0.005 * row, each)
    recording.close()
    assert recording.frames == len(frames)
    expected = [(round((NOW + 0.005 * row) * 1e6), each) for row, each in enumerate(frames)]
    assert recorded(tmp_path / f"flight{form}") == expected


@pytest.mark.parametrize("seed", range(2))
def test_bytes_in_any_pieces_among_garbage_are_kept(tmp_path, seed):
    chance = random.Random(seed)
    content = b""
    for each in FRAMES:
        if chance.random() < 0.05:
            content += bytes(chance.randrange(0xFC) for _ in range(chance.randrange(1, 400)))
        content += each
    recording = RawRecording(tmp_path / "flight.tlog")
    place = 0
    now = NOW
    while place < len(content):
        step = chance.randrange(1, 90)
        recording.take(now, content[place : place + step])
        place = place + step
        now = now + 0.004
    recording.close()
    stamps, frames = zip(*recorded(tmp_path / "flight.tlog"), strict=True)
    assert list(frames) == FRAMES and list(stamps) == sorted(stamps)


@pytest.mark.parametrize("form", [".tlog", ".mcap"])
def test_what_was_received_is_there_before_the_end(tmp_path, form):
    path = tmp_path / f"flight{form}"
    recording = RawRecording(path)
    for row, each in enumerate(FRAMES):
        recording.take(NOW + 0.01 * row, each)
    shutil.copy(path, tmp_path / f"copy{form}")  # as a process that is killed leaves it
    (vehicle,) = read_log(tmp_path / f"copy{form}").vehicles
    kept = sum(len(columns["time"]) for columns in vehicle.messages.values())
    assert kept >= len(FRAMES) - (60 if form == ".tlog" else 600)
    recording.close()
    recording.close()


def test_a_clock_that_is_set_back_or_noise_without_end_hold_nothing_up(tmp_path):
    recording = RawRecording(tmp_path / "flight.tlog")
    recording.take(NOW, FRAMES[0])
    recording.take(NOW - 5000.0, FRAMES[1])
    noise = random.Random(0).randbytes(3000)
    for row in range(2000):
        recording.take(NOW + 0.01 * row, noise)
        assert sum(len(data) for _, data in recording._pieces) < 60 * len(noise)
    recording.close()
    assert [each for _, each in recorded(tmp_path / "flight.tlog")][:2] == FRAMES[:2]
    assert struct.unpack(">Q", (tmp_path / "flight.tlog").read_bytes()[:8])[0] == round(NOW * 1e6)


def test_it_replaces_nothing(tmp_path):
    (tmp_path / "flight.tlog").write_bytes(b"dear")
    with pytest.raises(Unreadable, match="there already"):
        RawRecording(tmp_path / "flight.tlog")
    assert (tmp_path / "flight.tlog").read_bytes() == b"dear"
    with pytest.raises(Unreadable, match="cannot be written"):
        RawRecording(tmp_path / "none" / "flight.tlog")
