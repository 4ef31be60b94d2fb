"""A live session with a simulated ArduPilot that every fault befalls, on a clock of its own: as fast as possible."""

from contextlib import ExitStack
from dataclasses import dataclass, field
from unittest.mock import Mock, patch

import numpy as np

from mavdem.dem import Settings
from mavdem.live import LiveStream
from mavdem.live.link import Link
from mavdem.live.session import LiveSession
from mavdem.paper.runner import logged
from sitl_scenarios.mavlink.live import Ground, fly_live
from sitl_scenarios.scenario import Faults
from sitl_scenarios.simulation import Simulation

RATE = 100.0  # Hz that are asked for
TICK = 0.06  # s from one look at the link to the next
AHEAD_SECONDS = 0.25  # From the last known sample to the one that is forecast
SETTLING_SECONDS = 2.0  # For which the filter of a forecast has run before errors count


@dataclass
class Wire:
    """Frames under way in both directions, and the time at the session's end, s."""

    now: float = 0.0
    towards: list[tuple[float, bytes]] = field(default_factory=list)
    back: list[bytes] = field(default_factory=list)


class SessionEnd(Link):
    """The end of a wire that the session listens to."""

    def __init__(self, wire):
        self._wire = wire
        self.name = "simulation"
        self.speaks_first = False
        self.dropped = 0

    def receive(self, timeout):
        self._wire.now += timeout
        came = self._wire.towards
        self._wire.towards = []
        return came

    def send(self, frame):
        self._wire.back.append(frame)

    def events(self):
        return []


class VehicleEnd(Ground):
    """The end of a wire that the vehicle sends to: runs the session, whose clock is that of the flight."""

    speed = TICK / 0.004  # of the vehicle, so that a tick of its flight is TICK

    def __init__(self, wire, session):
        self._wire = wire
        self._session = session

    def send(self, frame):
        self._wire.towards.append((self._wire.now, frame))
        return True

    def received(self, until):
        """Runs the session up to a time, which is divided by the speed; what it has sent."""
        self._wire.now = until * self.speed
        self._session.step(0.0)
        answers = self._wire.back
        self._wire.back = []
        yield from answers


def run_session(scenario):
    """Flies a scenario and learns from it live; returns the session, which has not been ended, and its account."""
    wire = Wire()
    with ExitStack() as clocks:
        for clock in ("time.monotonic", "sitl_scenarios.mavlink.live.monotonic"):
            clocks.enter_context(patch(clock, lambda: wire.now))
        session = LiveSession(
            SessionEnd(wire),
            LiveStream(asked=True),
            Settings(),
            rate=RATE,
            show=Mock(),
            report=lambda _: None,
            say=lambda _: None,
        )
        ground = VehicleEnd(wire, session)
        fly_live(scenario, Simulation(scenario), ground, ground.speed, lambda _: None)
        return session, session.account()


def undisturbed(scenario, seed):
    """Another flight of the same vehicle in such wind, sent at 100 Hz without faults, its weak motor weak."""
    stream = scenario.stream.model_copy(
        update={"only_when_asked": False, "rates": {}, "rate": RATE}
    )
    vehicle = scenario.vehicle.model_copy(update={"weak_from": 0.0})
    changes = {
        "duration": 28.0,
        "flights": 1,
        "seed": seed,
        "faults": Faults(),
        "stream": stream,
        "vehicle": vehicle,
    }
    return logged(scenario.model_copy(update=changes))


def error_ratios(learned, flight):
    """(m,): squared errors ``AHEAD_SECONDS`` ahead on a flight, each over the variance of that output."""
    steps = round(AHEAD_SECONDS / flight.dt)
    errors = learned.forecast_every(steps, flight.inputs, flight.outputs) - flight.outputs
    ends = errors[steps - 1 :: steps][round(SETTLING_SECONDS / AHEAD_SECONDS) :]
    return np.asarray(np.mean(ends**2, axis=0) / np.var(flight.outputs, axis=0))
