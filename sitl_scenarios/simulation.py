"""Simulation: a scenario flown, cycle by cycle of its autopilot."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, fsum, hypot, sqrt

import numpy as np

from sitl_scenarios.body import Body, State
from sitl_scenarios.controller import Controller
from sitl_scenarios.dynamics import Air, dynamics
from sitl_scenarios.frames import Four
from sitl_scenarios.mixer import IDLE
from sitl_scenarios.motion import Array, Motion
from sitl_scenarios.plan import AFTER, BOOT, Plan
from sitl_scenarios.pulses import HIGHEST, LOWEST, STOPPED, pulse
from sitl_scenarios.randomness import SENSORS, generator
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.sensors import Sensing
from sitl_scenarios.vehicles import AIRFRAMES, GRAVITY
from sitl_scenarios.wind import Weather

CYCLES = {"px4": 1 / 250, "ardupilot": 1 / 400}
"""Control cycle of the autopilots, s: PX4 in its simulators, ArduCopter by SCHED_LOOP_RATE's default."""

SLOWEST_STEP = 1e-3
"""s: the physics take whole steps in a cycle, and none is longer than this."""

TUMBLING = 200.0
"""rad/s: no vehicle turns faster, and a simulation of one that did would mean nothing."""

_COLUMNS = {"time": 1, "position": 3, "velocity": 3, "attitude": 4, "rates": 3} | {
    "known_attitude": 4,
    "known_rates": 3,
    "known_position": 3,
    "known_velocity": 3,
    "outputs": 4,
    "demands": 4,
    "rotor_speeds": 4,
    "battery": 1,
    "wind": 3,
    "force": 3,
    "moment": 3,
    "armed": 1,
    "landed_state": 1,
}
"""Of a row, in order, and how many numbers each is."""

_STILL = (0.0,) * 12


class Simulation:
    """A scenario in flight: two seconds on the ground, arming, the flight, disarming, and a second more.

    Every number follows from the scenario: flown again, all are the same, bit by bit.

    Args:
        scenario: what is flown.

    Attributes:
        scenario: likewise.
        cycle: of the autopilot, s; a row of ``Motion`` each.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.cycle = CYCLES[scenario.stream.speaks]
        self._steps = ceil(self.cycle / SLOWEST_STEP - 1e-9)
        self._body = Body(scenario.vehicle, self.cycle / self._steps)
        self._dynamics = dynamics(scenario.vehicle)
        self._airframe = AIRFRAMES[scenario.vehicle.model]
        self._plan = Plan(scenario, self.cycle)
        self._controller = Controller(scenario.vehicle, self.cycle, scenario.sensors.delay)
        self._sensing = Sensing(scenario.sensors, self.cycle, generator(scenario.seed, SENSORS))
        self._boot = round(BOOT / self.cycle)
        self._flight = round(scenario.duration / self.cycle)
        whole = self._boot + self._flight + round(AFTER / self.cycle)
        since_arming = self.cycle * np.arange(-self._boot, whole - self._boot, dtype=np.float64)
        self._weather = Weather(scenario, self.cycle, since_arming)
        self._state = State()
        self._now = 0
        self._arming: int = self._boot
        self._armed = False
        self._commanded = False
        self._grounded = True
        self._down = False

    @property
    def finished(self) -> bool:
        """Whether the flight is over and the second after it too."""
        return self._now >= self._arming + self._flight + round(AFTER / self.cycle)

    @property
    def armed(self) -> bool:
        """Whether the motors may turn."""
        return self._armed

    def set_armed(self, armed: bool, force: bool = False) -> bool:
        """Arms or disarms, as by command; from then on the autopilot does not arm itself.

        Arming begins a flight of the scenario's duration, also after one.

        Args:
            armed: what is asked for.
            force: disarm in the air as well; it falls.

        Returns:
            Whether it is as asked for: arming in the air is refused, and disarming there unless forced.
        """
        if armed == self._armed:
            return True
        if not self._grounded and (armed or not force):
            return False
        self._commanded = True
        self._armed = armed
        if armed:
            self._arming = self._now
            self._down = False
            self._controller.rest()
        return True

    def advance(self, cycles: int) -> Motion:
        """The next ``cycles`` rows, fewer at the end of the flight.

        Raises:
            ValueError: the vehicle tumbles, more than anything that flies.
        """
        rows: list[tuple[float, ...]] = []
        for _ in range(cycles):
            if self.finished:
                break
            rows.append(self._row())
        return _motion(np.array(rows, dtype=float).reshape(len(rows), sum(_COLUMNS.values())))

    def _row(self) -> tuple[float, ...]:
        """What is at the beginning of a cycle, and how it is flown through."""
        flown = self._now - self._arming
        if not self._armed and not self._commanded and flown == 0:
            self._armed = True
        if self._armed and flown >= self._flight and self._grounded:
            self._armed = False
        battery = self._battery(flown)
        state, air = self._state, self._weather.at(flown + self._boot, self._state.position)
        known = self._sensing.known(state)
        wanted = self._plan.at(flown * self.cycle)
        landed = 1 if self._grounded and not (self._armed and wanted.landed_state == 3) else wanted.landed_state
        if not self._armed:
            outputs, demands = (STOPPED[self.scenario.stream.speaks],) * 4, (0.0,) * 4
        elif wanted.landed_state == 1 or self._down:
            outputs, demands = (pulse(IDLE),) * 4, (0.0, 0.0, 0.0, IDLE)
        else:
            outputs, demands = self._controller.outputs(known, wanted, not self._grounded)
        acting = _STILL
        if not self._grounded:
            acting = self._dynamics(state.attitude, state.velocity, state.rates, state.rotors, air)
        row = (
            self._now * self.cycle,
            *state.position,
            *state.velocity,
            *state.attitude,
            *state.rates,
            *known.attitude,
            *known.rates,
            *known.position,
            *known.velocity,
            *outputs,
            *demands,
            *state.rotors,
            battery,
            *air[:3],
            *acting[6:],
            float(self._armed),
            float(landed),
        )
        self._move(self._targets(outputs, battery), air, wanted.landed_state)
        self._now += 1
        return row

    def _battery(self, flown: int) -> float:
        """What is left of the battery, as in ``Motion``, so many cycles after arming: every flight begins with all."""
        return 1.0 - self.scenario.vehicle.battery_sag * min(max(flown / self._flight, 0.0), 1.0)

    def _targets(self, outputs: Four, battery: float) -> Four:
        """Rotor speeds that the outputs settle at, rad/s, with what is left of the battery."""
        if not self._armed:
            return 0.0, 0.0, 0.0, 0.0
        slope, offset = self._airframe.speed
        slope, offset = battery * slope * self._airframe.full / (HIGHEST - LOWEST), battery * offset
        a, b, c, d = outputs
        return (
            slope * (a - LOWEST) + offset,
            slope * (b - LOWEST) + offset,
            slope * (c - LOWEST) + offset,
            slope * (d - LOWEST) + offset,
        )

    def _move(self, targets: Four, air: Air, phase: int) -> None:
        """Through a cycle, off the ground and onto it."""
        state = self._state
        if self._grounded:
            rotors = self._body.spun(state.rotors, targets, self._steps)
            self._state = state._replace(rotors=rotors)
            lift = fsum(self._airframe.thrust_at(speed) for speed in rotors)
            self._grounded = lift <= self._airframe.mass * GRAVITY
            return
        state = self._body.moved(state, targets, air, self._steps)
        # Not a number is not less either.
        if not hypot(*state.rates) < TUMBLING:
            raise ValueError(
                f"the vehicle is out of control {self._now * self.cycle:.1f} s after boot, turning at more than "
                f"{TUMBLING:g} rad/s: it needs less wind, or smaller moments"
            )
        north, east, down = state.position
        if down >= 0.0 and state.velocity[2] > 0.0:
            # It stands where it came down, level, with the heading it had.
            w, _, _, z = state.attitude
            size = sqrt(w * w + z * z) or 1.0
            state = State((north, east, 0.0), attitude=(w / size, 0.0, 0.0, z / size), rotors=state.rotors)
            self._grounded = True
            self._down = phase == 4 or not self._armed
            self._controller.rest()
        self._state = state


def fly(scenario: Scenario, progress: Callable[[float], None] | None = None) -> Motion:
    """A whole flight.

    Args:
        scenario: what is flown.
        progress: is told how much of it is flown, 0 to 1, about once a second of flight.

    Raises:
        ValueError: the vehicle tumbles, more than anything that flies.
    """
    simulation = Simulation(scenario)
    whole = BOOT + scenario.duration + AFTER
    pieces = []
    while not simulation.finished:
        pieces.append(simulation.advance(round(1 / simulation.cycle)))
        if progress:
            progress(min(pieces[-1].time[-1] / whole, 1.0))
    if progress:
        progress(1.0)
    return Motion(**{name: np.concatenate([getattr(piece, name) for piece in pieces]) for name in _COLUMNS})


def _motion(rows: Array) -> Motion:
    ends = np.cumsum(list(_COLUMNS.values()))
    parts = dict(zip(_COLUMNS, np.split(rows, ends[:-1], axis=1), strict=True))
    armed, landed_state = parts.pop("armed"), parts.pop("landed_state")
    return Motion(
        **{name: part[:, 0] if _COLUMNS[name] == 1 else part for name, part in parts.items()},
        armed=armed[:, 0] > 0.5,
        landed_state=landed_state[:, 0].astype(np.uint8),
    )
