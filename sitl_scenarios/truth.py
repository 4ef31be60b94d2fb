"""Truth: the linear model, disturbance and control loops of a simulated flight, to compare a learned model with.

The matrices A and B are those of the dynamics linearised, by central differences, about hover in still air, level, nose
to the north. In wind a vehicle hovers tilted, with another thrust: the effect of its motors there differs by a few
hundredths.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from math import pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavdem.files import atomic_write
from mavdem.ingest.vocabulary import IN_AIR
from mavdem.loops.margins import Complex, OpenLoop
from sitl_scenarios.controller import FlightController
from sitl_scenarios.damage import UNDAMAGED, Damage, damage_history
from sitl_scenarios.dynamics import AirState, vehicle_dynamics
from sitl_scenarios.motion import Array, Arrays, Flags, Motion
from sitl_scenarios.parameter_controller import controller_for, gyro_for
from sitl_scenarios.plan import BOOT_SECONDS
from sitl_scenarios.rotors import MAX_PULSE, MIN_PULSE
from sitl_scenarios.scenario import AXES, Axis, Scenario, VehicleSpec
from sitl_scenarios.vectors import Vector4
from sitl_scenarios.vehicles import airframe

STATES = (
    "north",
    "east",
    "down",
    "north speed",
    "east speed",
    "down speed",
    "roll",
    "pitch",
    "yaw",
    "roll rate",
    "pitch rate",
    "yaw rate",
)
"""States of the linear model: m, m/s, rad, and rad/s in body axes."""

IMPULSE_CYCLES = 4096
"""Cycles of a rate controller's impulse response; after as many it no longer changes."""

NEGLIGIBLE_RESPONSE = 1e-12
"""Increment of an impulse response that is left out, by its largest."""

MIN_LOOP_FREQUENCY = 0.05
"""Lowest frequency of the loops' responses, Hz: position control is slower."""

MAX_LOOP_FREQUENCY = 0.499
"""Highest frequency of the loops' responses, by the autopilot's loop rate: just below a half."""

LOOP_FREQUENCIES = 4000
"""Number of frequencies of the loops' responses, evenly spaced on a logarithmic scale."""

DEMAND_STEP = 1e-3
"""Step of a demand to the mixer, up and down, that linearises it."""


@dataclass(frozen=True, eq=False)
class LinearModel:
    """A linear system dx/dt = A x + B u, with the motors' commands u."""

    states: tuple[str, ...]
    """Names of the n states."""
    A: Array
    """(n, n) in 1/s and the like."""
    B: Array
    """(n, 4) per unit of each motor's command."""

    def subsystem(self, states: Sequence[str]) -> LinearModel:
        """Returns the rows and columns of some states; the effect of the other states on them is left out."""
        indices = [self.states.index(state) for state in states]
        return LinearModel(tuple(states), self.A[np.ix_(indices, indices)], self.B[indices])


def linearised(vehicle: VehicleSpec) -> LinearModel:
    """Linearises the dynamics of a vehicle about hover in still air, without the lag of its rotors.

    Returns:
        Model of all ``STATES``, by motor commands in the vehicle's own unit.
    """
    body = airframe(vehicle)
    dynamics = vehicle_dynamics(vehicle)

    def derivative(states_and_commands: Array) -> Array:
        _, velocity, angles, rates, commands = np.split(states_and_commands, [3, 6, 9, 12])
        roll, pitch, yaw = angles
        rotation = Rotation.from_euler("ZYX", [yaw, pitch, roll])
        w, x, y, z = rotation.as_quat(scalar_first=True).tolist()
        rotor_speeds = tuple(body.rotor_speed(command) for command in commands.tolist())
        accelerations = dynamics(
            (w, x, y, z),
            tuple(velocity.tolist()),
            tuple(rates.tolist()),
            rotor_speeds,
            AirState(),
        )
        # The angles of a level vehicle change with the body rates.
        return np.array([*velocity, *accelerations.linear, *rates, *accelerations.angular])

    hover_command = body.command_for(body.hover_speed)
    hover = np.repeat([0.0, hover_command], [12, 4])
    # Steps of position, velocity, angles, rates and commands.
    steps = np.repeat([1e-3, 1e-5, 1e-5, 1e-4, 1e-5 * body.full_command], [3, 3, 3, 3, 4])
    jacobian = _jacobian(derivative, hover, steps)
    return LinearModel(STATES, jacobian[:, : len(STATES)], jacobian[:, len(STATES) :])


def _jacobian(function: Callable[[Array], Array], point: Array, steps: Array) -> Array:
    """Returns the derivatives of a function by central differences.

    Args:
        function: Function of (n,) with values (m,).
        point: Where to differentiate, (n,).
        steps: Step of each argument, (n,).

    Returns:
        (m, n) derivatives.
    """
    columns = []
    for step_vector, step in zip(np.diag(steps), steps, strict=True):
        difference = function(point + step_vector) - function(point - step_vector)
        columns.append(difference / (2 * step))
    return np.column_stack(columns)


def axis_model(vehicle: VehicleSpec, axis: Axis = "roll") -> LinearModel:
    """Returns the linear model of one axis, with which a model learned from a flight is compared.

    Its states are angle and rate of roll or pitch, in which gravity acts on the tilted vehicle, or the yaw rate alone,
    since the heading has no effect. Its inputs are PWM pulses in µs.
    """
    states = ("yaw rate",) if axis == "yaw" else (axis, f"{axis} rate")
    model = linearised(vehicle).subsystem(states)
    command_per_microsecond = airframe(vehicle).full_command / 1000
    return replace(model, B=model.B * command_per_microsecond)


def truth(scenario: Scenario, motion: Motion) -> Arrays:
    """Returns the truth of a flight, as docs/scenarios.md explains it.

    For yaw the state is the rate alone, and the arrays of each axis are named like those of roll.

    Args:
        scenario: What was flown.
        motion: The flight, N rows.

    Returns:
        Arrays by name. They are every field of ``Motion`` and:

        - ``scenario``: the scenario as JSON text.
        - ``trim`` (4,): PWM pulses in hover, µs.
        - ``roll_A`` (2, 2) and ``roll_B`` (2, 4): model of angle (rad) and rate (rad/s) without lag, by µs from trim.
        - ``roll_lag_A`` (3, 3) and ``roll_lag_B`` (3, 4): the same with the rotors' angular acceleration, rad/s², as
          third state; only with a lag.
        - ``lag`` (3,): time constants of the rotors, s: mean, rising, falling.
        - ``delay``: mean delay from the motion to the motors' output, s.
        - ``roll_disturbance`` (N,): angular acceleration of the disturbance, rad/s², without the damping in A.
        - ``roll_effect`` (4,): angular acceleration by each motor in the flight's wind, rad/s² per µs, and
          ``roll_effect_weak`` the same after all damage.
        - ``weak`` (N,): whether all damage acts.
        - The responses and margins of :func:`loops`.
    """
    body = airframe(scenario.vehicle)
    mean_lag = sum(body.rotor_lags) / 2
    arrays = {field.name: getattr(motion, field.name) for field in fields(motion)}
    arrays["scenario"] = np.array(scenario.model_dump_json())
    hover_command = body.command_for(body.hover_speed)
    arrays["trim"] = np.full(4, 1000 + 1000 * hover_command / body.full_command)
    arrays |= _motor_effects(scenario, motion)
    damage_times = [time for time, _ in damage_history(scenario)]
    arrays["weak"] = motion.time >= BOOT_SECONDS + max(damage_times, default=np.inf)
    # The output is held for a cycle: half of it on average.
    delay = scenario.sensors.delay + scenario.cycle / 2
    arrays["delay"] = np.array(delay)
    arrays["lag"] = np.array([mean_lag, *body.rotor_lags])
    for number, name in enumerate(AXES):
        model = axis_model(scenario.vehicle, name)
        arrays[f"{name}_A"] = model.A
        arrays[f"{name}_B"] = model.B
        if mean_lag:
            lagged = _with_rotor_lag(model, mean_lag)
            arrays[f"{name}_lag_A"] = lagged.A
            arrays[f"{name}_lag_B"] = lagged.B
        # The damping by the vehicle's own rate is in A. On the ground nothing moves and nothing acts.
        moment_acceleration = motion.moment[:, number] / body.inertia[number]
        rate_damping = model.A[-1, -1]
        arrays[f"{name}_disturbance"] = moment_acceleration - rate_damping * motion.rates[:, number]
        effect = arrays.get(f"{name}_effect", model.B[-1])
        arrays |= loops(scenario, number, effect)
    return arrays


def _with_rotor_lag(model: LinearModel, time_constant: float) -> LinearModel:
    """Returns the model of an axis with a first-order lag of the rotors, of this time constant (s).

    Its last state is the angular acceleration by the rotors, rad/s², which tends to B u and drives the rate.
    """
    states = len(model.A)
    rate_column = np.eye(states)[:, -1:]
    lag_row = [np.zeros((1, states)), np.array([[-1 / time_constant]])]
    return LinearModel(
        (*model.states, "rotor acceleration"),
        A=np.block([[model.A, rate_column], lag_row]),
        B=np.vstack([0 * model.B, model.B[-1] / time_constant]),
    )


def loops(scenario: Scenario, number: int, effect: Array) -> Arrays:
    """Returns open-loop responses and margins of the rate and attitude loops about one axis.

    The loops are the controller's own impulse response, the hold over one cycle, rotors, body, gyro filters and the
    estimates' delay. The body moves off where it tilts, and its drag, above the centre of mass, turns it back.

    Args:
        scenario: What is flown.
        number: 0 roll, 1 pitch, 2 yaw.
        effect: Angular acceleration by each motor's output, rad/s² per µs; (4,).

    Returns:
        Arrays by name, as docs/scenarios.md explains them: frequencies (Hz), responses, and margins as in
        :func:`margins`.
    """
    name = AXES[number]
    controller = controller_for(scenario)
    cycle = scenario.cycle
    frequency = np.geomspace(MIN_LOOP_FREQUENCY, MAX_LOOP_FREQUENCY / cycle, LOOP_FREQUENCIES)
    s = 2j * pi * frequency
    rate_response = _rate_controller_response(scenario, number, s * cycle, is_setpoint=False)
    setpoint_response = _rate_controller_response(scenario, number, s * cycle, is_setpoint=True)
    gain = _acceleration_per_demand(scenario, controller, number, effect)
    # Zero-order hold over one cycle.
    hold = (1 - np.exp(-s * cycle)) / (s * cycle)
    body_response = _rate_by_acceleration(scenario.vehicle, name, s)
    rotor_lag = sum(airframe(scenario.vehicle).rotor_lags) / 2 * s + 1
    rate_by_demand = gain * hold * body_response / rotor_lag
    delay = np.exp(-s * scenario.sensors.delay)
    gyro_response = gyro_for(controller).response(frequency)
    rate_loop = -rate_response * rate_by_demand * delay * gyro_response
    attitude_gain = controller.attitude_gains[number]
    closed_rate_loop = attitude_gain * setpoint_response * rate_by_demand / (1 + rate_loop)
    attitude_loop = closed_rate_loop * delay / s
    return {
        "loop_frequency": frequency,
        f"{name}_rate_loop": rate_loop,
        f"{name}_attitude_loop": attitude_loop,
        f"{name}_rate_margins": margins(frequency, rate_loop),
        f"{name}_attitude_margins": margins(frequency, attitude_loop),
    }


def _acceleration_per_demand(
    scenario: Scenario, controller: FlightController, number: int, effect: Array
) -> float:
    """Returns the angular acceleration about an axis per demand to the mixer, rad/s², in hover.

    The mixer is linearised by a central difference.

    Args:
        scenario: What is flown.
        controller: Its controller.
        number: 0 roll, 1 pitch, 2 yaw.
        effect: Angular acceleration by each motor's output, rad/s² per µs; (4,).
    """
    body = airframe(scenario.vehicle)
    hover_demands = np.zeros(4)
    hover_demands[3] = body.command_for(body.hover_speed) / body.full_command
    direction = np.eye(4)[number]
    above = controller.motor_commands(_four(hover_demands + DEMAND_STEP * direction))
    below = controller.motor_commands(_four(hover_demands - DEMAND_STEP * direction))
    command_change = np.subtract(above, below)
    acceleration_change = float(effect @ command_change) * (MAX_PULSE - MIN_PULSE)
    return acceleration_change / (2 * DEMAND_STEP)


def _four(demands: Array) -> Vector4:
    """Returns demands of roll, pitch, yaw and thrust, (4,), as a tuple."""
    return tuple(demands.tolist())


def _rate_by_acceleration(vehicle: VehicleSpec, axis: Axis, s: NDArray[Any]) -> NDArray[Any]:
    """Returns the response of a body rate to an angular acceleration about its axis, (N,) 1/s, at s = jω, (N,).

    It is an element of (s I − A)⁻¹, with A of all states.
    """
    rate = STATES.index(f"{axis} rate")
    identity = np.eye(len(STATES))
    characteristic = s[:, None, None] * identity - linearised(vehicle).A
    responses = np.linalg.solve(characteristic, identity[:, [rate]])
    return responses[:, rate, 0]


def _rate_controller_response(
    scenario: Scenario, number: int, phase: NDArray[Any], is_setpoint: bool
) -> NDArray[Any]:
    """Returns the frequency response of the rate controller's demand, from its own impulse response.

    Args:
        scenario: What is flown.
        number: 0 roll, 1 pitch, 2 yaw.
        phase: j times the frequencies, rad per cycle; (N,).
        is_setpoint: Whether the response is to the rate's setpoint, rather than to the measured rate.

    Returns:
        (N,) demand per rad/s.
    """
    controller = controller_for(scenario)
    demands = []
    for impulse in np.eye(1, IMPULSE_CYCLES)[0].tolist():
        setpoint = impulse if is_setpoint else 0.0
        rate = 0.0 if is_setpoint else impulse
        demands.append(controller.rate_demand(number, setpoint, rate, True))
    # The integrator keeps the impulse for ever, but the increments of the demand fade away.
    increments = np.diff(demands, prepend=0.0)
    threshold = NEGLIGIBLE_RESPONSE * abs(increments).max()
    significant = np.flatnonzero(abs(increments) > threshold)
    coefficients = increments[: significant[-1] + 1]
    # The z-transform of the increments over 1 − z⁻¹ is that of the demand.
    cycle_delay = np.exp(-phase)
    response = np.polynomial.polynomial.polyval(cycle_delay, coefficients)
    return response / (1 - cycle_delay)


def margins(frequency: Array, loop: Complex) -> Array:
    """Returns the margins of one open loop.

    Args:
        frequency: Frequencies in Hz, (N,).
        loop: Open-loop response, (N,).

    Returns:
        (4,) gain crossover, Hz, phase margin, °, gain margin, dB, and Ms, the largest sensitivity.
    """
    response = loop[None]
    complementary_sensitivity = response / (1 + response)
    figures = OpenLoop(
        frequency, response, complementary_sensitivity, complementary_sensitivity
    ).figures
    names = ("crossover", "phase_margin", "gain_margin", "ms")
    return np.array([figures[name][0] for name in names])


class HoverPart(NamedTuple):
    """Part of a flight's hover in which the vehicle's condition does not change."""

    rows: Flags
    """(N,) the rows of the flight that belong to it."""
    condition: Damage
    """Condition of the vehicle."""


def _motor_effects(scenario: Scenario, motion: Motion) -> dict[str, Array]:
    """Returns ``roll_effect``, ``roll_effect_weak`` and their likes for pitch and yaw, (4,) each.

    The first are those before all damage, and the others those after it. If the vehicle was damaged during the whole
    hover, its only effects have the first names. A flight without hover has none.
    """
    is_hover = motion.landed_state == IN_AIR
    history = damage_history(scenario) or [(np.inf, UNDAMAGED)]
    first_time, _ = history[0]
    last_time, final_condition = history[-1]
    before = HoverPart(is_hover & (motion.time < BOOT_SECONDS + first_time), UNDAMAGED)
    after = HoverPart(is_hover & (motion.time >= BOOT_SECONDS + last_time), final_condition)
    flown_parts = [part for part in (before, after) if part.rows.any()]
    arrays: dict[str, Array] = {}
    for part, suffix in zip(flown_parts, ("", "_weak"), strict=False):
        effects = _mean_motor_effects(scenario.vehicle, motion[part.rows], part.condition)
        for name, effect in zip(AXES, effects, strict=True):
            arrays[f"{name}_effect{suffix}"] = effect
    return arrays


def _mean_motor_effects(vehicle: VehicleSpec, motion: Motion, condition: Damage) -> Array:
    """Returns the mean effects of the motors' outputs in a part of a flight.

    Args:
        vehicle: Vehicle of the scenario.
        motion: Part of the flight.
        condition: Damage of the vehicle in it.

    Returns:
        (3, 4) angular acceleration about the axes by each motor's output, rad/s² per µs.
    """
    body = airframe(vehicle)
    attitudes = Rotation.from_quat(motion.attitude, scalar_first=True)
    mean_air = attitudes.inv().apply(motion.wind - motion.velocity).mean(0)
    mean_speeds = motion.rotor_speeds.mean(0)
    effect_per_speed = _rotor_speed_effects(vehicle, mean_speeds, mean_air, condition)
    command_per_microsecond = body.full_command / (MAX_PULSE - MIN_PULSE)
    commands = command_per_microsecond * (motion.outputs.mean(0) - MIN_PULSE)
    speed_slopes = np.array([body.speed_slope(command) for command in commands.tolist()])
    speed_per_microsecond = (
        speed_slopes * condition.speed * motion.battery.mean() * command_per_microsecond
    )
    return effect_per_speed * speed_per_microsecond


def _rotor_speed_effects(
    vehicle: VehicleSpec, rotor_speeds: Array, air: Array, condition: Damage
) -> Array:
    """Returns the effects of the rotors' speeds on a vehicle that flies steadily.

    Args:
        vehicle: Vehicle of the scenario.
        rotor_speeds: Speeds about which to linearise, rad/s; (4,).
        air: Velocity of the air relative to the vehicle, in body axes, m/s; (3,).
        condition: Damage of the vehicle.

    Returns:
        (3, 4) angular acceleration about the axes by each rotor's speed, rad/s² per rad/s.
    """
    dynamics = vehicle_dynamics(vehicle, condition)
    level = (1.0, 0.0, 0.0, 0.0)
    zero = (0.0, 0.0, 0.0)
    # The axes of a level vehicle with its nose to the north are NED.
    forward, right, down = air.tolist()
    air_state = AirState(forward, right, down)

    def angular_acceleration(speeds: Array) -> Array:
        return np.array(dynamics(level, zero, zero, tuple(speeds.tolist()), air_state).angular)

    return _jacobian(angular_acceleration, rotor_speeds, 1e-5 * rotor_speeds)


def write_truth(path: str | os.PathLike[str], scenario: Scenario, motion: Motion) -> None:
    """Writes the arrays of :func:`truth` as an .npz file, completely or not at all.

    The same flight gives the same bytes. Raises OSError if the file cannot be written.
    """
    with atomic_write(path) as file:
        np.savez_compressed(file, allow_pickle=False, **truth(scenario, motion))
