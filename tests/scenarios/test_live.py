"""A simulated vehicle on the network: its clock and its rates, what it obeys, and what must not disturb it."""

import numpy as np
from made_up_motion import made_up_motion
from numpy.testing import assert_allclose
from pymavlink.dialects.v20 import all as dialect
from pytest import approx, mark

from sitl_scenarios.mavlink.live import Ground, fly_live
from sitl_scenarios.scenario import Faults, Scenario

pytestmark = mark.slow

GROUND = dialect.MAVLink(None, srcSystem=255, srcComponent=190)


class Played:
    """A motion that is known beforehand, in place of a simulation."""

    def __init__(self, seconds):
        self.cycle = 0.004
        self._motion = made_up_motion(seconds, begin=1.0)
        self._row = 0
        self.asked = []

    @property
    def finished(self):
        return self._row >= len(self._motion)

    def advance(self, cycles):
        rows = slice(self._row, self._row + cycles)
        self._row += cycles
        return self._motion[rows]

    def set_armed(self, armed, force=False):
        self.asked.append(armed)
        return True


class Nearby:
    """A ground station without a network, on a clock of its own: what it hears does not depend on the machine's load.

    It says ``first`` when it hears the first message.
    """

    def __init__(self, monkeypatch, first=()):
        self.now = 50.0
        self.heard = []
        self._say, self._parser = list(first), dialect.MAVLink(None)
        monkeypatch.setattr("sitl_scenarios.mavlink.live.monotonic", lambda: self.now)

    def send(self, frame):
        self.heard += [(self.now, message) for message in self._parser.parse_buffer(frame)]
        return True

    def received(self, until):
        while self._say and self.heard:
            yield bytes(self._say.pop(0).pack(GROUND))
        self.now = max(self.now, until)

    def of(self, kind):
        return [(at, message) for at, message in self.heard if message.get_type() == kind]

    def flown(self, seconds, speed, scenario=None):
        simulation = Played(seconds)
        return fly_live(scenario or Scenario(), simulation, self, speed, lambda _: None), simulation


def test_it_flies_no_faster_than_asked(monkeypatch):
    """Two seconds at four times real time take half a second, with messages at an even rate."""
    ground = Nearby(monkeypatch)
    outcome, _ = ground.flown(2.0, 4.0)
    assert outcome.flown == approx(2.0, abs=0.1) and outcome.took == approx(0.5, abs=0.05)
    sent = np.array([[at, message.time_boot_ms] for at, message in ground.of("ATTITUDE")])
    # 100 Hz, on the boot clock that began a second before; in ticks of 4 ms of four seconds a second.
    assert len(sent) == approx(200, abs=2)
    assert_allclose(sent[:, 1] / 1e3 - 1.0, 4.0 * (sent[:, 0] - 50.0), atol=0.03)


def test_what_is_asked_for_is_done(monkeypatch):
    """A ground station sets the interval of the attitude to 40 ms, and disarms by force."""
    rate = dialect.MAVLink_command_long_message(1, 1, 511, 0, 30, 40_000, 0, 0, 0, 0, 0)
    ground = Nearby(
        monkeypatch,
        (rate, dialect.MAVLink_command_long_message(1, 1, 400, 0, 0, 21196, 0, 0, 0, 0, 0)),
    )
    outcome, simulation = ground.flown(3.0, 6.0)
    assert simulation.asked == [False]
    assert outcome.commands == 2
    assert [(ack.command, ack.result) for _, ack in ground.of("COMMAND_ACK")] == [
        (511, 0),
        (400, 0),
    ]
    assert len(ground.of("ATTITUDE")) == approx(75, abs=3)


def test_a_slow_link_delivers_all_after_the_flight(monkeypatch):
    ground = Nearby(monkeypatch)
    outcome, _ = ground.flown(2.0, 8.0, Scenario(faults=Faults(delay=0.5, reordered=0.2, loss=0.5)))
    assert outcome.flown == approx(2.5, abs=0.1)
    assert len(ground.heard) == outcome.sent
    assert ground.of("ATTITUDE")[-1][1].time_boot_ms > 2900


def test_ctrl_c_ends_it():
    def interrupted(now):
        if now > 0.5:
            raise KeyboardInterrupt

    outcome = fly_live(Scenario(), Played(9.0), Ground("127.0.0.1", 9), 5.0, interrupted)
    assert outcome.stopped and outcome.flown == approx(0.5, abs=0.05)
