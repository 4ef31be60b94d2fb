"""Replay: recorded setpoints of roll and the wind's torque, flown again by a vehicle that hovers at first."""

from __future__ import annotations

import numpy as np

from sitl_scenarios.dynamics import AirState, Body, State, euler
from sitl_scenarios.gains import controller_for, cycle_of
from sitl_scenarios.motion import Array
from sitl_scenarios.scenario import SENSORS, Scenario
from sitl_scenarios.sensors import Sensing
from sitl_scenarios.simulation import MAX_BODY_RATE, MAX_STEP_SECONDS
from sitl_scenarios.vehicles import GRAVITY, airframe

CLIMB, HEIGHT = 1.5, 0.6  # 1/s and 1/s²: thrust by vertical speed and height, slower than what is flown


def replayed(scenario: Scenario, dt: float, setpoints: Array, torque: Array) -> Array:
    """Returns (T, 2) roll, rad, and its rate, rad/s, as the autopilot knows them, every ``dt`` s.

    Of the ``scenario`` vehicle, sensors, autopilot and seed count. ``setpoints`` (T, 2) are of roll, rad, and of its
    rate beside what the error of roll asks for, rad/s; ``torque`` (T,) is the wind's per moment of inertia, rad/s².
    Raises ValueError: the vehicle tumbles.
    """
    cycle, body = cycle_of(scenario), airframe(scenario.vehicle)
    steps = int(np.ceil(cycle / MAX_STEP_SECONDS - 1e-9))
    flown, controller = Body(scenario.vehicle, cycle / steps), controller_for(scenario, cycle)
    sensing = Sensing(scenario.sensors, cycle, scenario.random(SENSORS))
    grid = np.arange(round(len(torque) * dt / cycle)) * cycle / dt
    columns = [np.interp(grid, np.arange(len(torque)), one) for one in (*setpoints.T, torque * body.inertia[0])]
    state, known = State(rotors=(body.hover_speed,) * 4), []
    for roll, ahead, moment in zip(*(column.tolist() for column in columns), strict=True):
        estimate = sensing.estimate(state)
        known.append((angle := euler(estimate.attitude)[0], estimate.rates[0]))
        lift = max(GRAVITY + CLIMB * state.velocity[2] + HEIGHT * state.position[2], GRAVITY / 5)
        thrust = body.mass * lift / max(np.cos(angle), 0.5)
        control = controller.steer(estimate, (roll, 0.0, 0.0), (ahead, 0.0, 0.0), thrust, True)
        state = flown.moved(state, flown.targets(control.outputs, 1.0), AirState(roll=moment), steps)
        if not abs(state.rates[0]) < MAX_BODY_RATE:
            raise ValueError("the vehicle is out of control: it needs other gains")
    rows = np.searchsorted(grid, np.arange(len(torque)) - 1e-6).clip(max=len(known) - 1)
    return np.asarray(np.array(known)[rows])
