"""Simulation: flies a scenario, cycle by cycle of its autopilot."""

from math import cos, fsum, hypot, sqrt
from typing import Any

import numpy as np

from sitl_scenarios.controller import ControlOutput
from sitl_scenarios.dynamics import (
    DISARMED_PULSE,
    IDLE_COMMAND,
    AirState,
    Body,
    Change,
    Four,
    State,
    damages,
    euler,
    pulse,
    steps_of,
)
from sitl_scenarios.gains import controller_for, gyro_for
from sitl_scenarios.gyro import NO_ROTATION
from sitl_scenarios.motion import Array, Motion, Progress, joined
from sitl_scenarios.plan import AFTER_SECONDS, BOOT_SECONDS, FlightPlan, seconds
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.sensors import RotorNoise, Sensing
from sitl_scenarios.vehicles import GRAVITY, airframe
from sitl_scenarios.wind import Weather

# rad/s: no vehicle turns faster, and a simulation of one that did would mean nothing
MAX_BODY_RATE = 200.0


class Simulation:
    """A scenario in flight: two seconds on the ground, arming, the flight, disarming, a second more; the next flight.

    Every number follows from the scenario: flown again, all are the same, bit by bit. ``scenario``: what is flown.
    ``cycle``: of the autopilot, s; a row of ``Motion`` each. ``armed``: whether the motors may turn.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.cycle = scenario.cycle
        self._steps = steps_of(self.cycle)
        self._body = Body(scenario.vehicle, self.cycle / self._steps)
        self._airframe = airframe(scenario.vehicle)
        self._plan = FlightPlan(scenario)
        self._controller = controller_for(scenario)
        self._gyro = gyro_for(self._controller)
        self._sensing = Sensing(scenario)
        self._boot = round(BOOT_SECONDS / self.cycle)
        self._flight = round(scenario.duration / self.cycle)
        self._end = self._flight + round(AFTER_SECONDS / self.cycle)
        since_arming = self.cycle * np.arange(-self._boot, self._end, dtype=np.float64)
        self._weather = Weather(scenario, self.cycle, since_arming)
        self._state = State()
        self._now = 0
        self._arming: int = self._boot
        self._more = scenario.flights - 1
        # Of the first arming, whatever the number of flights.
        self._damage = [
            (self._boot + round(begin / self.cycle), left) for begin, left in damages(scenario)
        ]
        self._shaking = RotorNoise(scenario, self.cycle / self._steps)
        self.armed = False
        self._commanded = False
        self._grounded = True
        self._down = False

    @property
    def finished(self) -> bool:
        """Whether the last flight is over and the second after it too."""
        return not self._more and self._now >= self._arming + self._end

    def set_armed(self, armed: bool, force: bool = False) -> bool:
        """Arms or disarms, as by command; from then on the autopilot does not arm itself.

        Arming begins a flight of the scenario's duration, also after one. Returns whether it is as asked for: arming in
        the air is refused, and so is disarming there, unless ``force`` makes it fall.
        """
        if armed == self.armed:
            return True
        if not self._grounded and (armed or not force):
            return False
        self._commanded = True
        self._more = 0
        self.armed = armed
        if armed:
            self._arming = self._now
            self._down = False
            self._controller.rest()
        return True

    def advance(self, cycles: int) -> Motion:
        """Returns the next ``cycles`` rows, fewer at the end, unless ``finished``; raises ValueError: it tumbles."""
        rows = (self._row() for _ in range(cycles) if not self.finished)
        return Motion(*map(np.array, zip(*rows, strict=True)))

    def _row(self) -> tuple[Any, ...]:
        """What is at the beginning of a cycle, and how it is flown through."""
        while self._damage and self._now >= self._damage[0][0]:
            self._body.damage(self._damage.pop(0)[1])
        if self._more and not self.armed and self._now >= self._arming + self._end:
            self._arming = self._now + self._boot
            self._more -= 1
            self._down = False
            self._controller.rest()
        flown = self._now - self._arming
        if not self.armed and not self._commanded and flown == 0:
            self.armed = True
        if self.armed and flown >= self._flight and self._grounded:
            self.armed = False
        # Every flight begins with all of the battery.
        state = self._state
        air = self._weather.at(flown + self._boot, state.position)
        share = min(max(flown / self._flight, 0.0), 1.0)
        battery = 1.0 - self.scenario.vehicle.battery_sag * share
        estimate = self._sensing.estimate(state._replace(rates=self._gyro.rates))
        reference = self._plan.at(flown * self.cycle)
        landed = reference.landed_state
        takes_off = self.armed and landed == 3
        if self._grounded and not takes_off:
            landed = 1
        if not self.armed:
            still = DISARMED_PULSE[self.scenario.stream.autopilot]
            control = ControlOutput((still,) * 4, (0.0,) * 4)
        elif reference.landed_state == 1 or self._down:
            idle = pulse(IDLE_COMMAND)
            control = ControlOutput((idle,) * 4, (*NO_ROTATION, IDLE_COMMAND))
        else:
            control = self._controller.control(estimate, reference, not self._grounded)
        acting: Change = (0.0,) * 12
        if not self._grounded:
            acting = self._body.dynamics(
                state.attitude, state.velocity, state.rates, state.rotors, air
            )
        sticks = reference.demand if reference.by_stick and self.armed else NO_ROTATION
        row = (
            self._now * self.cycle,
            *state[:4],
            *(estimate.attitude, estimate.rates, self._gyro.felt),
            *(estimate.position, estimate.velocity),
            *control,
            sticks,
            state.rotors,
            battery,
            air[:3],
            *(acting[6:9], acting[9:]),
            self.armed,
            np.uint8(landed),
        )
        self._move(control.outputs, battery, air, reference.landed_state)
        self._now += 1
        return row

    def _move(self, outputs: Four, battery: float, air: AirState, phase: int) -> None:
        """Through a cycle, off the ground and onto it."""
        state = self._state
        targets = self._body.targets(outputs, battery) if self.armed else (0.0, 0.0, 0.0, 0.0)
        if self._grounded:
            rotors = state.rotors
            for _ in range(self._steps):
                _, rotors = self._body.lagged(rotors, targets)
            self._state = state._replace(rotors=rotors)
            shares = zip(rotors, self._body.condition.thrust, strict=True)
            lift = fsum(left * self._airframe.thrust_at(speed) for speed, left in shares)
            self._grounded = lift <= self._airframe.mass * GRAVITY
            return
        state = self._gyro.fly(self._body, state, targets, air, self._steps, self._shaking)
        # Not a number is not less either.
        if not hypot(*state.rates) < MAX_BODY_RATE:
            raise ValueError(
                f"the vehicle is out of control {self._now * self.cycle:.1f} s after boot, turning at "
                f"more than {MAX_BODY_RATE:g} rad/s: it needs less wind, or smaller moments"
            )
        north, east, down = state.position
        if down >= 0.0 and state.velocity[2] > 0.0:
            # It stands where it came down, level, with the heading it had.
            w, _, _, z = state.attitude
            size = sqrt(w * w + z * z) or 1.0
            state = State(
                (north, east, 0.0), attitude=(w / size, 0.0, 0.0, z / size), rotors=state.rotors
            )
            self._grounded = True
            self._down = phase == 4 or not self.armed
            self._controller.rest()
            self._gyro = gyro_for(self._controller)
        self._state = state


def fly(scenario: Scenario, progress: Progress | None = None) -> Motion:
    """Flies a whole flight; ``progress`` gets the share flown, once a second of it. Raises ValueError: it tumbles."""
    simulation = Simulation(scenario)
    whole = seconds(scenario)
    pieces = []
    while not simulation.finished:
        second = round(1 / simulation.cycle)
        pieces.append(simulation.advance(second))
        if progress:
            share = min(pieces[-1].time[-1] / whole, 1.0)
            progress(1.0 if simulation.finished else share)
    return joined(pieces)


# 1/s and 1/s²: thrust by vertical speed and height, slower than what is flown
CLIMB = 1.5
HEIGHT = 0.6


def replayed(scenario: Scenario, dt: float, setpoints: Array, torque: Array) -> Array:
    """Returns (T, 3, 2) angles, rad, and rates, rad/s, of roll, pitch and yaw, as the autopilot knows them.

    Every ``dt`` s; of the ``scenario`` vehicle, sensors, autopilot and seed count. ``setpoints`` (T, 3, 2) are of the
    angles, and of the rates beside what the angles' errors ask for; the heading is not held. ``torque`` (T, 3) is the
    wind's per moment of inertia, rad/s². A mean wind would move the vehicle, not turn it. Raises ValueError: the
    vehicle tumbles.
    """
    cycle = scenario.cycle
    body = airframe(scenario.vehicle)
    steps = steps_of(cycle)
    flown = Body(scenario.vehicle, cycle / steps)
    controller = controller_for(scenario)
    gyro = gyro_for(controller)
    sensing = Sensing(scenario)
    cycles = round(len(torque) * dt / cycle)
    grid = np.arange(cycles) * cycle / dt
    wind_moments = torque * body.inertia
    given = np.column_stack([setpoints[..., 0], setpoints[..., 1], wind_moments])
    samples = np.arange(len(torque))
    columns = np.column_stack([np.interp(grid, samples, column) for column in given.T])
    state = State(rotors=(body.hover_speed,) * 4)
    states = []
    for wanted_roll, wanted_pitch, _, p, q, r, *moments in columns.tolist():
        estimate = sensing.estimate(state._replace(rates=gyro.rates))
        roll, pitch, yaw = angles = euler(estimate.attitude)
        states.append((angles, estimate.rates))
        held = GRAVITY + CLIMB * state.velocity[2] + HEIGHT * state.position[2]
        lift = max(held, GRAVITY / 5)
        upright = max(cos(roll) * cos(pitch), 0.5)
        thrust = body.mass * lift / upright
        wanted = (wanted_roll, wanted_pitch, yaw)
        control = controller.steer(estimate, wanted, (p, q, r), thrust, True)
        air = AirState(*(0.0,) * 5, *moments)
        targets = flown.targets(control.outputs, 1.0)
        state = gyro.fly(flown, state, targets, air, steps)
        if not hypot(*state.rates) < MAX_BODY_RATE:
            raise ValueError("the vehicle is out of control: it needs other gains")
    last = len(states) - 1
    rows = np.searchsorted(grid, samples - 1e-6).clip(max=last)
    return np.array(states)[rows].mT
