"""Truth: A, B, wind, disturbance and states of a simulated flight, to compare a learned model with.

A and B are those of the dynamics linearised, by central differences, about hover in still air, level, nose to the
north. In wind a vehicle hovers tilted, with another thrust: the effect of its motors there is a few hundredths from
what it is here.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavdem.files import atomic_write
from mavdem.ingest.vocabulary import IN_AIR
from mavdem.loops.margins import Complex, OpenLoop
from sitl_scenarios.damage import UNDAMAGED, Damage, damage_history
from sitl_scenarios.dynamics import AirState, vehicle_dynamics
from sitl_scenarios.motion import Array, Arrays, Motion
from sitl_scenarios.parameter_controller import controller_for, gyro_for
from sitl_scenarios.plan import BOOT_SECONDS
from sitl_scenarios.rotors import MAX_PULSE, MIN_PULSE
from sitl_scenarios.scenario import AXES, Axis, Scenario, VehicleSpec
from sitl_scenarios.vehicles import airframe

STATES = (
    *("north", "east", "down", "north speed", "east speed", "down speed"),
    *("roll", "pitch", "yaw", "roll rate", "pitch rate", "yaw rate"),
)
"""m, m/s, rad and rad/s in body axes."""


@dataclass(frozen=True, eq=False)
class Linear:
    """A linear system."""

    states: tuple[str, ...]  # their names, n of them
    A: Array  # (n, n), 1/s and the like
    B: Array  # (n, 4), per unit of each motor's command

    def of(self, states: Sequence[str]) -> Linear:
        """Returns the rows and columns of some states; what others do to them is left out."""
        kept = [self.states.index(state) for state in states]
        return Linear(tuple(states), self.A[np.ix_(kept, kept)], self.B[kept])


def linearised(vehicle: VehicleSpec) -> Linear:
    """Linearises all ``STATES`` about hover, by motor commands in the vehicle's own unit; rotors follow at once."""
    body = airframe(vehicle)
    change = vehicle_dynamics(vehicle)

    def derivative(at: Array) -> Array:
        _, velocity, angles, rates, commands = np.split(at, [3, 6, 9, 12])
        attitude = Rotation.from_euler("ZYX", angles[::-1])
        w, x, y, z = attitude.as_quat(scalar_first=True).tolist()
        speeds = tuple(map(body.rotor_speed, commands.tolist()))
        acting = change(
            (w, x, y, z), tuple(velocity.tolist()), tuple(rates.tolist()), speeds, AirState()
        )
        # Of a level vehicle the angles change with the rates.
        return np.array([*velocity, *acting.linear, *rates, *acting.angular])

    command = body.command_for(body.hover_speed)
    hover = np.repeat([0.0, command], [12, 4])
    steps = np.repeat([1e-3, 1e-5, 1e-5, 1e-4, 1e-5 * body.full_command], [3, 3, 3, 3, 4])
    slopes = _slopes(derivative, hover, steps)
    return Linear(STATES, slopes[:, :12], slopes[:, 12:])


def _slopes(function: Callable[[Array], Array], at: Array, steps: Array) -> Array:
    """(m, n) of a function of (n,), by central differences of so large ``steps`` (n,)."""
    pairs = zip(np.diag(steps), steps, strict=True)
    return np.column_stack(
        [(function(at + h) - function(at - h)) / (2 * size) for h, size in pairs]
    )


def axis(vehicle: VehicleSpec, axis: Axis = "roll") -> Linear:
    """Returns angle and rate about one axis, of yaw the rate alone, in µs of PWM.

    It is what a model of a flight is held against.
    """
    linear = linearised(vehicle)
    # The heading does nothing to a vehicle; roll and pitch, of gravity, do.
    states = ("yaw rate",) if axis == "yaw" else (axis, f"{axis} rate")
    eigenvalues = linear.of(states)
    per_microsecond = airframe(vehicle).full_command / 1000
    return replace(eigenvalues, B=eigenvalues.B * per_microsecond)


def _rotor_effects(vehicle: VehicleSpec, rotors: Array, air: Array, condition: Damage) -> Array:
    """(3, 4) angular acceleration, rad/s², by each rotor's speed, rad/s, flying steadily in ``air``, body axes."""
    change = vehicle_dynamics(vehicle, condition)
    level = (1.0, 0.0, 0.0, 0.0)
    still = (0.0, 0.0, 0.0)
    about = AirState(*air.tolist())

    def acceleration(speeds: Array) -> Array:
        o1, o2, o3, o4 = speeds.tolist()
        changes = change(level, still, still, (o1, o2, o3, o4), about)
        return np.array(changes.angular)

    return _slopes(acceleration, rotors, 1e-5 * rotors)


def truth(scenario: Scenario, motion: Motion) -> Arrays:
    """Returns arrays by name.

    They are every column of ``Motion``, ``scenario`` as JSON text, and what docs/scenarios.md explains.

    ``roll_A`` (2, 2) and ``roll_B`` (2, 4) are of angle (rad) and rate (rad/s) without lag, by µs from ``trim`` (4,);
    ``roll_lag_A``, ``roll_lag_B`` with the rotors' angular acceleration, rad/s², as third state; ``lag`` mean, rising,
    falling, s; ``roll_disturbance`` (N,), rad/s²; ``roll_effect`` (4,), rad/s² per µs; likewise ``pitch_…``, ``yaw_…``.
    """
    body = airframe(scenario.vehicle)
    tau = sum(body.rotor_lags) / 2
    arrays = {field.name: getattr(motion, field.name) for field in fields(motion)}
    arrays["scenario"] = np.array(scenario.model_dump_json())
    arrays["trim"] = np.full(
        4, 1000 + 1000 * body.command_for(body.hover_speed) / body.full_command
    )
    arrays |= _effects(scenario, motion)
    begins = [begin for begin, _ in damage_history(scenario)]
    arrays["weak"] = motion.time >= BOOT_SECONDS + max(begins, default=np.inf)
    late = scenario.sensors.delay + scenario.cycle / 2
    arrays["delay"] = np.array(late)
    arrays["lag"] = np.array([tau, *body.rotor_lags])
    for number, name in enumerate(AXES):
        instant = axis(scenario.vehicle, name)
        arrays |= {f"{name}_A": instant.A, f"{name}_B": instant.B}
        if tau:
            last = np.eye(len(instant.A))[:, -1:]
            lag_row = [0 * last.T, -1 / tau]
            arrays[f"{name}_lag_A"] = np.block([[instant.A, last], lag_row])
            arrays[f"{name}_lag_B"] = np.vstack([0 * instant.B, instant.B[-1] / tau])
        # The damping by the vehicle's own rate is in A; on the ground nothing moves and nothing acts.
        acting = (
            motion.moment[:, number] / body.inertia[number]
            - instant.A[-1, -1] * motion.rates[:, number]
        )
        arrays[f"{name}_disturbance"] = acting
        effect = arrays.get(f"{name}_effect", instant.B[-1])
        arrays |= loops(scenario, number, effect)
    return arrays


SETTLED_CYCLES = 4096  # after which the rate controller's response to an impulse no longer changes
LOWEST_LOOP_FREQUENCY = 0.05  # Hz of the loops: position control is slower
DEMAND_STEP = 1e-3, -1e-3  # of a demand, to linearise the mixer


def loops(scenario: Scenario, number: int, effect: Array) -> Arrays:
    """Returns arrays by name of the loops that fly about the axis ``number``, as docs/scenarios.md explains them.

    They are the controller's own impulse response, a hold over one cycle, rotors, body and the estimates' delay.
    The body flies off where it leans, and its drag, above the centre of mass, turns it back. ``effect`` (4,) is of each
    motor's output, rad/s² per µs.
    """
    name = AXES[number]
    controller = controller_for(scenario)
    cycle = scenario.cycle
    frequency = np.geomspace(LOWEST_LOOP_FREQUENCY, 0.499 / cycle, 4000)
    s = 2j * pi * frequency
    feedback, setpoint = (
        _response(scenario, number, wanted, s * cycle) for wanted in (False, True)
    )
    body = airframe(scenario.vehicle)
    about = np.append(np.eye(3)[number], 0.0)
    collective = body.command_for(body.hover_speed) / body.full_command
    hover = np.append(np.zeros(3), collective)
    more, less = (
        controller.motor_commands((hover + step * about).tolist()) for step in DEMAND_STEP
    )
    spread = np.subtract(more, less)
    per_demand = float(effect @ spread) * (MAX_PULSE - MIN_PULSE)
    gain = per_demand / (DEMAND_STEP[0] - DEMAND_STEP[1])
    hold = (1 - np.exp(-s * cycle)) / (s * cycle)
    turning = STATES.index(f"{name} rate")
    identity = np.eye(len(STATES))
    flying = s[:, None, None] * identity - linearised(scenario.vehicle).A
    responses = np.linalg.solve(flying, identity[:, [turning]])
    free = responses[:, turning, 0]
    rotors = sum(body.rotor_lags) / 2 * s + 1
    rate = gain * hold * free / rotors
    late = np.exp(-s * scenario.sensors.delay)
    passed = gyro_for(controller).response(frequency)
    rate_loop = -feedback * rate * late * passed
    attitude_loop = controller.attitude_gains[number] * setpoint * rate / (1 + rate_loop) * late / s
    return {
        "loop_frequency": frequency,
        f"{name}_rate_loop": rate_loop,
        f"{name}_attitude_loop": attitude_loop,
        f"{name}_rate_margins": margins(frequency, rate_loop),
        f"{name}_attitude_margins": margins(frequency, attitude_loop),
    }


def _response(scenario: Scenario, number: int, wanted: bool, turns: NDArray[Any]) -> NDArray[Any]:
    """(N,) of the rate controller at ``turns``, j times rad a cycle: from the rate that is ``wanted``, or the rate."""
    controller = controller_for(scenario)
    impulse = np.eye(1, SETTLED_CYCLES)[0].tolist()
    demands = [
        controller.rate_demand(number, demand * wanted, demand * (not wanted), True)
        for demand in impulse
    ]
    # An integrator keeps what it has: the differences end.
    steps = np.diff(demands, prepend=0.0)
    least = 1e-12 * abs(steps).max()
    kept = np.flatnonzero(abs(steps) > least)
    delays = np.exp(-turns)
    coefficients = steps[: kept[-1] + 1]
    response = np.polynomial.polynomial.polyval(delays, coefficients)
    return response / (1 - delays)


def margins(frequency: Array, loop: Complex) -> Array:
    """Returns gain crossover (Hz), phase and gain margin (°, dB) and Ms of an open ``loop`` (N,).

    ``frequency`` (N,) is in Hz.
    """
    response = loop[None]
    closed = response / (1 + response)
    figures = OpenLoop(frequency, response, closed, closed).figures
    names = ("crossover", "phase_margin", "gain_margin", "ms")
    return np.array([figures[name][0] for name in names])


def _effects(scenario: Scenario, motion: Motion) -> dict[str, Array]:
    """``roll_effect`` and its likes, and those after all damage unless that was there in all of the hover."""
    hover = motion.landed_state == IN_AIR
    begins = damage_history(scenario) or [(np.inf, UNDAMAGED)]
    last, condition = begins[-1]
    parts = (
        (hover & (motion.time < BOOT_SECONDS + begins[0][0]), UNDAMAGED),
        (hover & (motion.time >= BOOT_SECONDS + last), condition),
    )
    flown = [part for part in parts if part[0].any()]
    effects: dict[str, Array] = {}
    for (rows, damage), suffix in zip(flown, ("", "_weak"), strict=False):
        by_axis = zip(AXES, _effects_in(scenario.vehicle, motion[rows], damage), strict=True)
        effects |= {f"{name}_effect{suffix}": effect for name, effect in by_axis}
    return effects


def _effects_in(vehicle: VehicleSpec, motion: Motion, condition: Damage) -> Array:
    """(3, 4) mean effects about the axes, rad/s² per µs."""
    body = airframe(vehicle)
    turned = Rotation.from_quat(motion.attitude, scalar_first=True)
    air = turned.inv().apply(motion.wind - motion.velocity).mean(0)
    per_speed = _rotor_effects(vehicle, motion.rotor_speeds.mean(0), air, condition)
    scale = body.full_command / (MAX_PULSE - MIN_PULSE)
    commands = scale * (motion.outputs.mean(0) - MIN_PULSE)
    slopes = np.array([body.speed_slope(command) for command in commands.tolist()])
    return per_speed * (slopes * condition.speed * motion.battery.mean() * scale)


def write_truth(path: str | os.PathLike[str], scenario: Scenario, motion: Motion) -> None:
    """Writes :func:`truth` as .npz, whole or not at all, the same bytes of the same flight; raises OSError."""
    with atomic_write(path) as file:
        np.savez_compressed(file, allow_pickle=False, **truth(scenario, motion))
