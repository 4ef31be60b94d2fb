"""A simulated vehicle on the network: its clock and its rates, what it obeys, and what must not disturb it."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
import pytest
from made_up_motion import made_up_motion
from pymavlink.dialects.v20 import all as dialect

from sitl_scenarios.mavlink.live import Ground, LiveOutcome, fly_live
from sitl_scenarios.mavlink.transmitter import rows_of_motion
from sitl_scenarios.motion import Motion
from sitl_scenarios.scenario import Faults, Scenario

GROUND = dialect.MAVLink(None, srcSystem=255, srcComponent=190)


class Played:
    """A motion that is known beforehand, in place of a simulation."""

    def __init__(self, seconds: float) -> None:
        self.cycle = 0.004
        self._motion, self._row = made_up_motion(seconds, begin=1.0), 0
        self.asked: list[bool] = []

    @property
    def finished(self) -> bool:
        return self._row >= len(self._motion)

    def advance(self, cycles: int) -> Motion:
        rows = slice(self._row, self._row + cycles)
        self._row += cycles
        return rows_of_motion(self._motion, rows)

    def set_armed(self, armed: bool, force: bool = False) -> bool:
        self.asked.append(armed)
        return True


class Receiver(threading.Thread):
    """Keeps every message with the time it came; ``first`` is done when the first came, with where it came from."""

    def __init__(self, first=lambda receiver: None) -> None:
        super().__init__(daemon=True)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self.socket.settimeout(0.2)
        self.port = self.socket.getsockname()[1]
        self.received: list[tuple[float, dialect.MAVLink_message]] = []
        self.vehicle: tuple[str, int] | None = None
        self._first, self._over = first, False
        self.start()

    def run(self) -> None:
        parser = dialect.MAVLink(None)
        while not self._over:
            try:
                datagram, sender = self.socket.recvfrom(4096)
            except TimeoutError:
                continue
            now = time.monotonic()
            self.received += [(now, message) for message in parser.parse_buffer(datagram) or []]
            if self.vehicle is None:
                self.vehicle = sender
                self._first(self)

    def of(self, kind: str) -> list[tuple[float, dialect.MAVLink_message]]:
        return [(at, message) for at, message in self.received if message.get_type() == kind]

    def ended(self) -> None:
        time.sleep(0.1)
        self._over = True
        self.join()
        self.socket.close()


class Nearby:
    """A ground station without a network, on a clock of its own: what it hears does not depend on the machine's load.

    It says ``first`` when it hears the first message.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, first: tuple[dialect.MAVLink_message, ...] = ()) -> None:
        self.now, self.heard = 0.0, []
        self._say, self._parser = list(first), dialect.MAVLink(None)
        monkeypatch.setattr("sitl_scenarios.mavlink.live.monotonic", lambda: self.now)

    def send(self, frame: bytes) -> bool:
        self.heard += [(self.now, message) for message in self._parser.parse_buffer(frame)]
        return True

    def received(self, until: float) -> Iterator[bytes]:
        while self._say and self.heard:
            yield bytes(self._say.pop(0).pack(GROUND))
        self.now = max(self.now, until)

    def of(self, kind: str) -> list[tuple[float, dialect.MAVLink_message]]:
        return [(at, message) for at, message in self.heard if message.get_type() == kind]

    def flown(self, seconds: float, speed: float, scenario: Scenario | None = None) -> tuple[LiveOutcome, Played]:
        simulation = Played(seconds)
        return fly_live(scenario or Scenario(), simulation, self, speed, lambda _: None), simulation


class Counted(Ground):
    """A ground station on the network; ``heard`` is what was sent there, whether it was received or not."""

    def __init__(self, port: int) -> None:
        super().__init__("127.0.0.1", port)
        self.heard: list[dialect.MAVLink_message] = []
        self._parser = dialect.MAVLink(None)

    def send(self, frame: bytes) -> bool:
        self.heard += self._parser.parse_buffer(frame)
        return super().send(frame)

    def of(self, kind: str) -> list[dialect.MAVLink_message]:
        return [message for message in self.heard if message.get_type() == kind]


@pytest.mark.slow
def test_rate_and_clock(monkeypatch):
    ground = Nearby(monkeypatch)
    outcome, _ = ground.flown(8.0, 4.0)
    assert outcome.sent == len(ground.heard) and not outcome.stopped
    assert outcome.flown == pytest.approx(8.0, abs=0.1)
    assert outcome.took == pytest.approx(2.0, abs=0.05)
    at, boot = np.array([(at, message.time_boot_ms / 1e3) for at, message in ground.of("ATTITUDE")]).T
    assert len(at) == pytest.approx(800, abs=2)
    late = at - boot / 4
    assert np.ptp(late) < 0.02
    numbers = [message.get_seq() for _, message in ground.heard]
    assert set(np.diff(numbers) % 256) == {1}


@pytest.mark.slow
def test_it_flies_no_faster_than_asked_and_catches_up_on_what_it_is_late():
    receiver = Receiver()
    began = time.monotonic()
    outcome = fly_live(Scenario(), Played(2.0), Ground("127.0.0.1", receiver.port), 4.0, lambda _: None)
    assert outcome.took > 0.48 and outcome.flown == pytest.approx(2.0, abs=0.1)
    receiver.ended()
    assert receiver.vehicle[0] == "127.0.0.1"
    # A busy machine makes some late, none early.
    early = [message.time_boot_ms / 4e3 - (at - began) for at, message in receiver.of("ATTITUDE")]
    assert max(early) < 1.0 / 4 + 0.02


def test_what_is_asked_for_is_done(monkeypatch):
    rate = dialect.MAVLink_command_long_message(1, 1, 511, 0, 30, 40_000, 0, 0, 0, 0, 0)
    ground = Nearby(monkeypatch, (rate, dialect.MAVLink_command_long_message(1, 1, 400, 0, 0, 21196, 0, 0, 0, 0, 0)))
    outcome, simulation = ground.flown(6.0, 6.0)
    assert simulation.asked == [False]
    assert outcome.commands == 2
    assert [(ack.command, ack.result) for _, ack in ground.of("COMMAND_ACK")] == [(511, 0), (400, 0)]
    assert len(ground.of("ATTITUDE")) == pytest.approx(150, abs=5)


@contextmanager
def poured(pieces: list[bytes], pause: float) -> Iterator[Counted]:
    """A ground station from which pieces are poured over the vehicle, again and again."""
    stop = threading.Event()

    def pour(receiver: Receiver) -> None:
        with suppress(OSError):  # the receiver has ended
            while not stop.is_set():
                for one in pieces:
                    receiver.socket.sendto(one, receiver.vehicle)
                time.sleep(pause)

    receiver = Receiver(lambda receiver: threading.Thread(target=pour, args=[receiver], daemon=True).start())
    ground = Counted(receiver.port)
    try:
        yield ground
    finally:
        stop.set()
        receiver.ended()
        ground.close()


@pytest.mark.slow
def test_noise_and_floods_do_not_disturb():
    random = np.random.default_rng(1)
    noise = [random.bytes(1400), bytes([0xFD]) * 2000, b"", b"\xfe"]
    noise += [bytes(dialect.MAVLink_param_request_list_message(1, 1).pack(GROUND)) * 20]
    # It ends although the flood does not.
    with poured(noise, 0.0002) as ground:
        outcome = fly_live(Scenario(), Played(6.0), ground, 3.0, lambda _: None)
    assert outcome.sent == len(ground.heard)
    boots = [message.time_boot_ms for message in ground.of("ATTITUDE")]
    assert boots[-1] - boots[0] > 5900 and len(boots) > 590


@pytest.mark.slow
def test_a_flood_of_questions_is_dropped_and_counted():
    question = bytes(dialect.MAVLink_param_request_read_message(1, 1, b"", 3).pack(GROUND))
    with poured([question * 70], 0.001) as ground:
        outcome = fly_live(Scenario(), Played(2.0), ground, 1.0, lambda _: None)
    assert outcome.unheard > 10
    # Ticks of 4 ms with no more than 4 answers in each, and the list that comes by itself.
    assert 100 < len(ground.of("PARAM_VALUE")) < 500 * 4 + 100


def test_a_slow_link_delivers_all_after_the_flight(monkeypatch):
    ground = Nearby(monkeypatch)
    outcome, _ = ground.flown(2.0, 8.0, Scenario(faults=Faults(delay=0.5, reordered=0.2, loss=0.5)))
    assert outcome.flown == pytest.approx(2.5, abs=0.1)
    assert len(ground.heard) == outcome.sent
    assert ground.of("ATTITUDE")[-1][1].time_boot_ms > 2900


def test_nobody_needs_to_listen():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    outcome = fly_live(Scenario(), Played(1.0), Ground("localhost", port), 20.0, lambda _: None)
    assert outcome.flown == pytest.approx(1.0, abs=0.1)


def test_ctrl_c_ends_it():
    def interrupted(now: float) -> None:
        if now > 0.5:
            raise KeyboardInterrupt

    outcome = fly_live(Scenario(), Played(9.0), Ground("127.0.0.1", 9), 5.0, interrupted)
    assert outcome.stopped and outcome.flown == pytest.approx(0.5, abs=0.05)


def test_a_host_that_does_not_exist_is_one_sentence():
    with pytest.raises(ValueError, match=r"nothing can be sent to no\.such\.host\.invalid:14550 .*check the name"):
        Ground("no.such.host.invalid", 14550)
