"""A live session with a simulated ArduPilot that every fault befalls, on a clock of its own: as fast as possible."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from unittest.mock import Mock, patch

import numpy as np

from mavdem.dem import Settings
from mavdem.experiments.paper.flights import simulated_flight
from mavdem.live import LiveStream
from mavdem.live.link import ReceivedPiece
from mavdem.live.session import LiveSession
from sitl_scenarios.mavlink.live import Ground, fly_live
from sitl_scenarios.scenario import Faults
from sitl_scenarios.simulation import Simulation

RATE = 100.0  # Hz that are asked for
TICK = 0.06  # Seconds from one look at the link to the next.
AHEAD_SECONDS = 0.25  # From the last known sample to the one that is forecast
SETTLING_SECONDS = 2.0  # For which the filter of a forecast has run before errors count


@dataclass
class SimulatedLink:
    """Stands for the ``Link`` by which a session hears the vehicle."""

    receive: Callable[[float], list]
    """Returns what has come within a time, s."""
    send: Callable[[bytes], None]
    """Sends a frame to the vehicle."""
    name: str = "simulation"
    awaits_greeting: bool = False
    dropped_datagrams: int = 0

    def drain_events(self):
        """Returns what happened to the link: nothing."""
        return []


class Wire(Ground):
    """What the vehicle sends to: it runs the session that listens to it, whose clock is that of the flight."""

    speed = TICK / 0.004  # At this speed a tick of the vehicle's flight is TICK.
    now = 0.0

    def __init__(self):
        self.towards, self.back = [], []
        self.session = LiveSession(
            SimulatedLink(receive=self.heard, send=self.back.append),
            LiveStream(rates_requested=True),
            Settings(),
            requested_rate=RATE,
            open_display=Mock(),
            report_status=lambda _: None,
            report_event=lambda _: None,
        )

    def heard(self, timeout):
        """What the session receives."""
        Wire.now += timeout
        came, self.towards = self.towards, []
        return came

    def send(self, frame):
        self.towards.append(ReceivedPiece(Wire.now, frame))
        return True

    def received(self, until):
        """Runs the session up to a time, which is divided by the speed; what it has sent."""
        Wire.now = until * self.speed
        self.session.step(0.0)
        yield from self.back
        self.back.clear()


def run_session(scenario):
    """Flies a scenario and learns from it live; returns the session, which has not been ended, and its account."""
    with ExitStack() as clocks:
        for name in ("time.monotonic", "sitl_scenarios.mavlink.live.monotonic"):
            clocks.enter_context(patch(name, lambda: Wire.now))
        Wire.now = 0.0
        wire = Wire()
        fly_live(scenario, Simulation(scenario), wire, wire.speed, lambda _: None)
        return wire.session, wire.session.time_account()


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
    return simulated_flight(scenario.model_copy(update=changes))


def error_ratios(learned, flight):
    """(m,): squared errors ``AHEAD_SECONDS`` ahead on a flight, each over the variance of that output."""
    steps = round(AHEAD_SECONDS / flight.dt)
    errors = learned.forecast_every(steps, flight.inputs, flight.outputs) - flight.outputs
    ends = errors[steps - 1 :: steps][round(SETTLING_SECONDS / AHEAD_SECONDS) :]
    return np.asarray(np.mean(ends**2, axis=0) / np.var(flight.outputs, axis=0))
