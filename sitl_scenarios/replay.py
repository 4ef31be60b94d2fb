"""Replay: recorded setpoints and the wind's torque, flown again by a vehicle that hovers at first."""

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


def replayed(scenario: Scenario, dt: float, angles: Array, ahead: Array, torque: Array) -> Array:
    """Returns (T, 2) roll, rad, and its rate, rad/s, as the autopilot knows them, every ``dt`` s.

    Of the ``scenario`` vehicle, sensors, autopilot and seed count. ``angles`` and ``ahead`` are (T, 2) setpoints of
    roll and pitch, rad, and of body rates beside what their errors ask for, rad/s; ``torque`` (T, 2) is the wind's per
    moment of inertia, rad/s². Raises ValueError: the vehicle tumbles.
    """
    cycle, body = cycle_of(scenario), airframe(scenario.vehicle)
    steps = int(np.ceil(cycle / MAX_STEP_SECONDS - 1e-9))
    flown, controller = Body(scenario.vehicle, cycle / steps), controller_for(scenario, cycle)
    sensing = Sensing(scenario.sensors, cycle, scenario.random(SENSORS))
    table = np.column_stack([angles, ahead, torque * body.inertia[:2]])
    grid = np.arange(round(len(table) * dt / cycle)) * cycle / dt
    table = np.column_stack([np.interp(grid, np.arange(len(table)), column) for column in table.T])
    state, known = State(rotors=(body.hover_speed,) * 4), []
    for roll, pitch, p, q, mx, my in table.tolist():
        estimate = sensing.estimate(state)
        attitude = euler(estimate.attitude)
        lift = max(GRAVITY + CLIMB * state.velocity[2] + HEIGHT * state.position[2], GRAVITY / 5)
        thrust = body.mass * lift / max(np.cos(attitude[0]) * np.cos(attitude[1]), 0.5)
        control = controller.steer(estimate, (roll, pitch, 0.0), (p, q, 0.0), thrust, True)
        air = AirState(roll=mx, pitch=my)
        state = flown.moved(state, flown.targets(control.outputs, 1.0), air, steps)
        if not np.hypot(*state.rates[:2]) < MAX_BODY_RATE:
            raise ValueError("the vehicle is out of control: it needs other gains")
        known.append((attitude[0], estimate.rates[0]))
    rows = np.searchsorted(grid, np.arange(len(angles)) - 1e-6).clip(max=len(known) - 1)
    return np.asarray(np.array(known)[rows])
