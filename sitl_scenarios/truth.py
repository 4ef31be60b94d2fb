"""True linear model, disturbance and control loops of a simulated flight, with which a learned model is compared.

The matrices A and B belong to the dynamics linearised, by central differences, about hover in still air, level, nose
to the north. In wind a vehicle hovers tilted, with another thrust: the effect of its motors there differs by a few
hundredths.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
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
from sitl_scenarios.damage import Damage, DamageStep, damage_history, no_damage
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
"""Largest increment of an impulse response that is left out, relative to the largest of all."""

MIN_LOOP_FREQUENCY = 0.05
"""Lowest frequency of the loops' responses, Hz: position control is slower."""

MAX_LOOP_FREQUENCY = 0.499
"""Highest frequency of the loops' responses, as a fraction of the autopilot's loop rate: just below a half."""

LOOP_FREQUENCIES = 4000
"""Number of frequencies of the loops' responses, evenly spaced on a logarithmic scale."""

MIN_MARGIN_FREQUENCY = 0.3
"""Lowest frequency at which margins are taken, relative to the highest gain crossover; a choice.

Below it, drag above the centre of mass lets the gain of a light vehicle rise through 1, and the phase through 180°: the
vehicle drifts there, which the control of velocity and pilots prevent.
"""

DEMAND_STEP = 1e-3
"""Step of a demand to the mixer, up and down, that linearises it."""

LINEARISATION_STEPS = {"position": 1e-3, "velocity": 1e-5, "angles": 1e-5, "rates": 1e-4}
"""Steps, up and down, that linearise the dynamics: m, m/s, rad and rad/s; small against the scale of the curvature."""

COMMAND_STEP = 1e-5
"""Step of a motor's command, up and down, that linearises the dynamics, as a fraction of the full command."""

ROTOR_SPEED_STEP = 1e-5
"""Step of a rotor's speed, up and down, that linearises the dynamics, as a fraction of the speed itself."""


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


def linearised_model(vehicle: VehicleSpec) -> LinearModel:
    """Linearises the simulated dynamics of a vehicle about hover in still air, without the lag of its rotors.

    States and commands are joined in one vector, of which the derivatives of the states are a function. The Jacobian of
    that function in hover, by central differences, is [A B].

    Args:
        vehicle: airframe of a scenario's vehicle without damage, with its drag, rotor lag and inertia.

    Returns:
        Matrices A (n, n) and B (n, k) for the n ``STATES`` and the commands of k motors, in the unit of the vehicle's
        commands.
    """
    body = airframe(vehicle)
    dynamics = vehicle_dynamics(vehicle)

    def derivative(states_and_commands: Array) -> Array:
        """Returns the derivatives (n,) of the ``STATES`` at states and commands (n + k,)."""
        # Three each of position, velocity, angles and rates, then the commands. The position has no effect.
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
        # The Euler angles of a level vehicle change with the body rates.
        return np.array([*velocity, *accelerations.linear, *rates, *accelerations.angular])

    # In hover all states are 0, and all commands are equal.
    hover_commands = np.full(body.rotors, body.command_for(body.hover_speed))
    hover = np.concatenate([np.zeros(len(STATES)), hover_commands])
    # The steps of position, velocity, angles and rates are each of three states.
    state_steps = np.repeat([*LINEARISATION_STEPS.values()], 3)
    command_steps = np.full(body.rotors, COMMAND_STEP * body.full_command)
    jacobian = _jacobian(derivative, hover, np.concatenate([state_steps, command_steps]))
    return LinearModel(STATES, jacobian[:, : len(STATES)], jacobian[:, len(STATES) :])


def _jacobian(function: Callable[[Array], Array], point: Array, steps: Array) -> Array:
    """Returns the derivatives of a function by central differences.

    Args:
        function: Function of (n,) with values (m,).
        point: (n,) point at which to differentiate.
        steps: Step of each argument, (n,).

    Returns:
        (m, n) derivatives.
    """
    columns = []
    # Each row of the diagonal matrix moves one argument by its step.
    for step_vector, step in zip(np.diag(steps), steps, strict=True):
        difference = function(point + step_vector) - function(point - step_vector)
        columns.append(difference / (2 * step))
    return np.column_stack(columns)


def axis_model(vehicle: VehicleSpec, axis: Axis = "roll") -> LinearModel:
    """Returns the linear model of one axis, with which a model learned from a flight is compared.

    The effect of the other states, such as the drag of a vehicle that moves, is left out: it counts as disturbance.

    Args:
        vehicle: Airframe of a scenario's vehicle, with its drag, rotor lag and inertia, undamaged.
        axis: Axis about which it turns.

    Returns:
        Model whose states are angle, rad, and rate, rad/s, of roll or pitch, or the yaw rate alone, since the heading
        has no effect. Its inputs are PWM pulses of the four motors, µs from hover.
    """
    states = ("yaw rate",) if axis == "yaw" else (axis, f"{axis} rate")
    model = linearised_model(vehicle).subsystem(states)
    command_per_microsecond = airframe(vehicle).full_command / (MAX_PULSE - MIN_PULSE)
    return replace(model, B=model.B * command_per_microsecond)


def truth(scenario: Scenario, motion: Motion) -> Arrays:
    """Returns the truth of a flight, as docs/scenarios.md explains it.

    For yaw the state is the rate alone, and the arrays of each axis are named like the arrays of roll.

    Args:
        scenario: Scenario of the flight: vehicle, wind, excitation, sensors and faults.
        motion: The flight, N rows.

    Returns:
        Arrays by name. They are every field of ``Motion`` and:

        - ``scenario``: the scenario as JSON text.
        - ``trim`` (4,): PWM pulses in hover, µs.
        - ``roll_A`` (2, 2) and ``roll_B`` (2, 4): model of angle (rad) and rate (rad/s) without lag; its inputs are the
          pulses less ``trim``, µs.
        - ``roll_lag_A`` (3, 3) and ``roll_lag_B`` (3, 4): the same with the rotors' angular acceleration, rad/s², as
          third state; only with a lag.
        - ``lag`` (3,): time constants of the rotors, s: mean, rising, falling.
        - ``delay``: mean delay from the motion to the motors' output, s, with the delay of the gyro's filters at low
          frequencies, which the logged rates have too.
        - ``roll_disturbance`` (N,): angular acceleration of the disturbance, rad/s², without the damping in A.
        - ``roll_effect`` (4,): effect of each motor on the angular acceleration in the flight's wind, rad/s² per µs,
          and ``roll_effect_weak`` the same after all damage.
        - ``weak`` (N,): whether all damage acts.
        - The responses and margins of :func:`loops`.
    """
    body = airframe(scenario.vehicle)
    mean_lag = sum(body.rotor_lags) / 2
    arrays = {field.name: getattr(motion, field.name) for field in fields(motion)}
    arrays["scenario"] = np.array(_scenario_text(scenario))
    arrays |= mishap_truth(scenario)
    hover_command = body.command_for(body.hover_speed)
    arrays["trim"] = np.full(body.rotors, 1000 + 1000 * hover_command / body.full_command)
    arrays |= _motor_effects(scenario, motion)
    damage_times = [step.time for step in damage_history(scenario)]
    arrays["weak"] = motion.time >= BOOT_SECONDS + max(damage_times, default=np.inf)
    # The output is held for a cycle: half of it on average.
    hold_delay = scenario.cycle / 2
    arrays["delay"] = np.array(scenario.sensors.delay + hold_delay + _gyro_delay(scenario))
    arrays["lag"] = np.array([mean_lag, *body.rotor_lags])
    for axis_number, axis in enumerate(AXES):
        model = axis_model(scenario.vehicle, axis)
        arrays[f"{axis}_A"] = model.A
        arrays[f"{axis}_B"] = model.B
        if mean_lag:
            model_with_lag = _with_rotor_lag(model, mean_lag)
            arrays[f"{axis}_lag_A"] = model_with_lag.A
            arrays[f"{axis}_lag_B"] = model_with_lag.B
        # The damping by the vehicle's own rate is in A. On the ground nothing moves and nothing acts.
        moment_acceleration = motion.moment[:, axis_number] / body.inertia[axis_number]
        rate_damping = model.A[-1, -1]
        arrays[f"{axis}_disturbance"] = (
            moment_acceleration - rate_damping * motion.rates[:, axis_number]
        )
        effect = arrays.get(f"{axis}_effect", model.B[-1])
        arrays |= true_loops(scenario, axis_number, effect)
    return arrays


def _scenario_text(scenario: Scenario) -> str:
    """Returns a scenario as JSON. Flights without instruments leave out the keys that concern instruments only."""
    if scenario.has_instruments:
        return scenario.model_dump_json()
    return scenario.model_dump_json(exclude={"mishap": True, "stream": {"instruments"}})


def mishap_truth(scenario: Scenario) -> Arrays:
    """Returns what goes wrong in a flight, and when.

    Args:
        scenario: Scenario of a simulated flight: vehicle, wind, excitation, sensors and faults.

    Returns:
        Arrays of one value: ``mishap``, its kind; ``mishap_time``, s since boot, NaN for one that lasts the whole
        flight; and ``mishap_motor``, the failing motor by the autopilot's numbers, 0 for none. Empty without a mishap.
    """
    mishap = scenario.mishap
    if mishap is None:
        return {}
    start = getattr(mishap, "start", np.nan)
    return {
        "mishap": np.array(mishap.kind),
        "mishap_time": np.array(BOOT_SECONDS + start),
        "mishap_motor": np.array(getattr(mishap, "motor", 0)),
    }


def _with_rotor_lag(model: LinearModel, time_constant: float) -> LinearModel:
    """Returns the model of an axis with a first-order lag of the rotors.

    The angular acceleration α by the rotors becomes a state of its own, the last one. It tends to the last row of B
    times u with the time constant τ, dα/dt = (B u − α)/τ, and drives the rate: the commands no longer do so directly.

    Args:
        model: Model of n states without lag, the rate last.
        time_constant: τ, s.

    Returns:
        Model of n + 1 states.
    """
    states = len(model.A)
    # The acceleration drives the last of the states, the rate.
    rate_column = np.eye(states)[:, -1:]
    lag_row = [np.zeros((1, states)), np.array([[-1 / time_constant]])]
    return LinearModel(
        (*model.states, "rotor acceleration"),
        A=np.block([[model.A, rate_column], lag_row]),
        B=np.vstack([0 * model.B, model.B[-1] / time_constant]),
    )


def _gyro_delay(scenario: Scenario) -> float:
    """Returns the delay of the gyro's filters at low frequencies, s: 0 without filters."""
    gyro = gyro_for(controller_for(scenario))
    response = gyro.response(np.array([MIN_LOOP_FREQUENCY]))
    return float(-np.angle(response[0]) / (2 * pi * MIN_LOOP_FREQUENCY))


def true_loops(scenario: Scenario, axis_number: int, effect: Array) -> Arrays:
    """Returns open-loop responses and margins of the rate and attitude loops about one axis.

    The rate loop is the product of the frequency responses around it: rate controller (from its own impulse response),
    hold of the output over one cycle, rotors' lag, body, delay of the estimates and gyro filters. The attitude loop is
    the attitude gain times the closed rate loop, the integration of the rate to the angle, and the delay. The response
    of the body takes all states into account: it drifts as it tilts, and the drag above its centre of mass turns it
    back.

    Args:
        scenario: Scenario of the flight: vehicle, wind, excitation, sensors and faults.
        axis_number: 0 for roll, 1 for pitch, 2 for yaw.
        effect: (4,) effect of each motor's output on the angular acceleration, rad/s² per µs.

    Returns:
        Arrays by name, as docs/scenarios.md explains them: frequencies (Hz), responses, and margins as in
        :func:`margins`.
    """
    axis = AXES[axis_number]
    controller = controller_for(scenario)
    cycle = scenario.cycle
    frequency = np.geomspace(MIN_LOOP_FREQUENCY, MAX_LOOP_FREQUENCY / cycle, LOOP_FREQUENCIES)
    s = 2j * pi * frequency
    # The controller works in cycles, so its frequencies are in radians per cycle.
    phase = s * cycle
    demand_per_rate = _rate_controller_response(scenario, axis_number, phase, is_setpoint=False)
    demand_per_setpoint = _rate_controller_response(scenario, axis_number, phase, is_setpoint=True)

    # The demand becomes a body rate by a zero-order hold over one cycle, the lag of the rotors, and the body.
    acceleration_per_demand = _acceleration_per_demand(scenario, controller, axis_number, effect)
    zero_order_hold = (1 - np.exp(-phase)) / phase
    mean_rotor_lag = sum(airframe(scenario.vehicle).rotor_lags) / 2
    rate_per_acceleration = _rate_per_acceleration(scenario.vehicle, axis, s)
    rate_without_lag = acceleration_per_demand * zero_order_hold * rate_per_acceleration
    rate_per_demand = rate_without_lag / (mean_rotor_lag * s + 1)

    # The controller's response to the measured rate is negative: an open loop is defined for negative feedback.
    delay_response = np.exp(-s * scenario.sensors.delay)
    gyro_response = gyro_for(controller).response(frequency)
    rate_loop = -demand_per_rate * rate_per_demand * delay_response * gyro_response
    # An error of the angle, times the attitude gain, is the setpoint of the closed rate loop; the angle is the integral
    # of the rate.
    attitude_gain = controller.attitude_gains[axis_number]
    rate_per_angle_error = attitude_gain * demand_per_setpoint * rate_per_demand / (1 + rate_loop)
    attitude_loop = rate_per_angle_error * delay_response / s
    return {
        "loop_frequency": frequency,
        f"{axis}_rate_loop": rate_loop,
        f"{axis}_attitude_loop": attitude_loop,
        f"{axis}_rate_margins": margins(frequency, rate_loop),
        f"{axis}_attitude_margins": margins(frequency, attitude_loop),
    }


def _acceleration_per_demand(
    scenario: Scenario, controller: FlightController, axis_number: int, effect: Array
) -> float:
    """Returns the angular acceleration about an axis per demand to the mixer, in hover.

    Mixer and thrust curve are linearised together by a central difference: the commands of the motors at a slightly
    larger and a slightly smaller demand, times the effects of the motors.

    Args:
        scenario: Scenario of the flight: vehicle, wind, excitation, sensors and faults.
        controller: Controller of that flight.
        axis_number: 0 for roll, 1 for pitch, 2 for yaw.
        effect: Effect of each motor's output on the angular acceleration, rad/s² per µs; (4,).

    Returns:
        Angular acceleration, rad/s², per demand of 1.
    """
    body = airframe(scenario.vehicle)
    # Demands of roll, pitch and yaw are zero in hover; the last one is the thrust.
    hover_demands = np.zeros(4)
    hover_demands[3] = body.command_for(body.hover_speed) / body.full_command
    demand_step = np.zeros(4)
    demand_step[axis_number] = DEMAND_STEP
    commands_above = controller.motor_commands(_demand_tuple(hover_demands + demand_step))
    commands_below = controller.motor_commands(_demand_tuple(hover_demands - demand_step))
    command_change = np.subtract(commands_above, commands_below)
    acceleration_change = float(effect @ command_change) * (MAX_PULSE - MIN_PULSE)
    return acceleration_change / (2 * DEMAND_STEP)


def _demand_tuple(demands: Array) -> Vector4:
    """Returns demands of roll, pitch, yaw and thrust, (4,), as a tuple."""
    return tuple(demands.tolist())


def _rate_per_acceleration(vehicle: VehicleSpec, axis: Axis, s: NDArray[Any]) -> NDArray[Any]:
    """Returns the frequency response of a body rate to an angular acceleration about the same axis.

    It is the diagonal element of (s I − A)⁻¹ that belongs to the rate, with the matrix A of all states. For a body
    without drag it would be 1/s.

    Args:
        vehicle: Airframe of a scenario's vehicle, with its drag, rotor lag and inertia.
        axis: Axis about which it turns.
        s: jω, rad/s; (N,).

    Returns:
        (N,) response, rad/s per rad/s².
    """
    rate = STATES.index(f"{axis} rate")
    identity = np.eye(len(STATES))
    # These are s I − A at each of the N frequencies, (N, n, n).
    matrices = s[:, None, None] * identity - linearised_model(vehicle).A
    # Of each inverse only the column that belongs to the rate is computed.
    response_columns = np.linalg.solve(matrices, identity[:, [rate]])
    return response_columns[:, rate, 0]


def _rate_controller_response(
    scenario: Scenario, axis_number: int, phase: NDArray[Any], *, is_setpoint: bool
) -> NDArray[Any]:
    """Returns the frequency response of the rate controller, measured on the code that flies.

    The controller is given an impulse, and its impulse response is transformed. Formulas for the response could differ
    from the code.

    Args:
        scenario: Scenario of the flight: vehicle, wind, excitation, sensors and faults.
        axis_number: 0 for roll, 1 for pitch, 2 for yaw.
        phase: (N,) j times the frequencies, rad per cycle.
        is_setpoint: Whether the response is to the rate's setpoint, rather than to the measured rate.

    Returns:
        (N,) demand per rad/s.
    """
    controller = controller_for(scenario)
    demands = []
    # The impulse is 1 in the first cycle and 0 in all others.
    for impulse in np.eye(1, IMPULSE_CYCLES)[0].tolist():
        setpoint = impulse if is_setpoint else 0.0
        rate = 0.0 if is_setpoint else impulse
        demands.append(controller.rate_demand(axis_number, setpoint, rate, is_flying=True))
    # The integrator keeps the impulse forever, so that a sum over the demands does not converge. Their increments fade.
    increments = np.diff(demands, prepend=0.0)
    threshold = NEGLIGIBLE_RESPONSE * abs(increments).max()
    significant_cycles = np.flatnonzero(abs(increments) > threshold)
    coefficients = increments[: significant_cycles[-1] + 1]
    # The z-transform of the increments over 1 − z⁻¹ is the z-transform of the demand.
    cycle_delay = np.exp(-phase)
    response = np.polynomial.polynomial.polyval(cycle_delay, coefficients)
    return response / (1 - cycle_delay)


def margins(frequency: Array, loop: Complex) -> Array:
    """Returns the stability margins of one open loop about its crossover, by the same code that analyses logs.

    Args:
        frequency: Frequencies in Hz, (N,).
        loop: Open-loop response, (N,).

    Returns:
        (4,) gain crossover, Hz, phase margin, °, gain margin, dB, and Ms, the largest sensitivity.
    """
    crossover = _loop_characteristics(frequency, loop)["crossover"][0]
    # Without a crossover the comparison with NaN is false for all frequencies, which are then all kept.
    is_about_crossover = ~(frequency < MIN_MARGIN_FREQUENCY * crossover)
    characteristics = _loop_characteristics(frequency[is_about_crossover], loop[is_about_crossover])
    names = ("crossover", "phase_margin", "gain_margin", "ms")
    return np.array([characteristics[name][0] for name in names])


def _loop_characteristics(frequency: Array, loop: Complex) -> Mapping[str, Array]:
    """Returns crossover and stability margins of one open loop by name, as ``OpenLoop`` computes them.

    Args:
        frequency: Frequencies in Hz, (N,).
        loop: Open-loop response, (N,).

    Returns:
        Arrays (1,) by name: Hz, degrees, dB, or without unit.
    """
    # ``OpenLoop`` holds the responses of several plants, (plants, N): here there is one.
    return OpenLoop(frequency, loop[None]).open_loop_characteristics


class HoverPhase(NamedTuple):
    """Time of the hover before all damage, or after all damage, so that the damage does not change in it."""

    is_in_phase: Flags
    """(N,) whether each row of the flight belongs to it."""
    damage: Damage
    """Damage of the vehicle in it."""


def _motor_effects(scenario: Scenario, motion: Motion) -> dict[str, Array]:
    """Returns the effect of each motor on roll, pitch and yaw in the hover, before and after the vehicle's damage.

    Args:
        scenario: Scenario of the flight: vehicle, wind, excitation, sensors and faults.
        motion: True states, rotor speeds and motor outputs of the flight, cycle by cycle.

    Returns:
        Effects of the motors' outputs on the angular accelerations, rad/s² per µs, (4,) each, by name. ``roll_effect``,
        ``pitch_effect`` and ``yaw_effect`` belong to the hover before all damage, and ``roll_effect_weak`` and so on to
        the hover after all damage. If the vehicle was damaged during the whole hover, its only effects have the first
        names. A flight without hover has none.
    """
    vehicle = scenario.vehicle
    is_hover = motion.landed_state == IN_AIR
    sound_state = no_damage(airframe(vehicle).rotors)
    # The damage of a sound vehicle never begins.
    history = damage_history(scenario) or [DamageStep(np.inf, sound_state)]
    first_damage, last_damage = history[0], history[-1]
    is_before = motion.time < BOOT_SECONDS + first_damage.time
    is_after = motion.time >= BOOT_SECONDS + last_damage.time
    phase_before_damage = HoverPhase(is_hover & is_before, sound_state)
    phase_after_damage = HoverPhase(is_hover & is_after, last_damage.damage)
    flown_phases = [
        phase for phase in (phase_before_damage, phase_after_damage) if phase.is_in_phase.any()
    ]
    arrays: dict[str, Array] = {}
    for number, phase in enumerate(flown_phases):
        suffix = "" if number == 0 else "_weak"
        effects = _mean_motor_effects(vehicle, motion[phase.is_in_phase], phase.damage)
        for axis, effect in zip(AXES, effects, strict=True):
            arrays[f"{axis}_effect{suffix}"] = effect
    return arrays


def _mean_motor_effects(vehicle: VehicleSpec, motion: Motion, damage: Damage) -> Array:
    """Returns the effects of the motors' outputs on the angular accelerations, at the mean of an interval of a flight.

    By the chain rule an effect is a product of two derivatives: of the angular acceleration with respect to the rotor
    speed, at the mean rotor speeds in the mean wind, and of the rotor speed with respect to the output, which damage
    and a sagging battery reduce.

    Args:
        vehicle: Airframe of the scenario's vehicle, with its drag, rotor lag and inertia.
        motion: Rows of the interval.
        damage: Damage of the vehicle in it.

    Returns:
        (3, 4) effect of each motor's output on the angular acceleration about each axis, rad/s² per µs.
    """
    body = airframe(vehicle)
    attitudes = Rotation.from_quat(motion.attitude, scalar_first=True)
    # Mean velocity of the air relative to the vehicle, in body axes.
    mean_air = attitudes.inv().apply(motion.wind - motion.velocity).mean(0)
    mean_speeds = motion.rotor_speeds.mean(0)
    effect_per_speed = _rotor_speed_effects(vehicle, mean_speeds, mean_air, damage)
    command_per_microsecond = body.full_command / (MAX_PULSE - MIN_PULSE)
    commands = command_per_microsecond * (motion.outputs.mean(0) - MIN_PULSE)
    speed_slopes = np.array([body.speed_slope(command) for command in commands.tolist()])
    speed_per_microsecond = (
        speed_slopes * damage.speed * motion.battery.mean() * command_per_microsecond
    )
    return effect_per_speed * speed_per_microsecond


def _rotor_speed_effects(
    vehicle: VehicleSpec, rotor_speeds: Array, air: Array, damage: Damage
) -> Array:
    """Returns the derivatives of a vehicle's angular accelerations with respect to its rotor speeds, in steady flight.

    The dynamics are evaluated for a level vehicle at rest, and the wind is given in body axes: only the air relative to
    the vehicle matters.

    Args:
        vehicle: Airframe of the scenario's vehicle, with its drag, rotor lag and inertia.
        rotor_speeds: Speeds about which to linearise, rad/s; (4,).
        air: Velocity of the air relative to the vehicle, in body axes, m/s; (3,).
        damage: Damage of the vehicle.

    Returns:
        (3, 4) effect of each rotor's speed on the angular acceleration about each axis, rad/s² per rad/s.
    """
    dynamics = vehicle_dynamics(vehicle, damage)
    level = (1.0, 0.0, 0.0, 0.0)
    zero = (0.0, 0.0, 0.0)
    # The axes of a level vehicle with its nose to the north are NED.
    forward, right, down = air.tolist()
    air_state = AirState(forward, right, down)

    def angular_acceleration(speeds: Array) -> Array:
        return np.array(dynamics(level, zero, zero, tuple(speeds.tolist()), air_state).angular)

    return _jacobian(angular_acceleration, rotor_speeds, ROTOR_SPEED_STEP * rotor_speeds)


def write_truth(path: str | os.PathLike[str], scenario: Scenario, motion: Motion) -> None:
    """Writes the arrays of :func:`truth` as an .npz file, completely or not at all.

    The same flight gives the same bytes.

    Args:
        path: Path of the file.
        scenario: Scenario of a simulated flight: vehicle, wind, excitation, sensors and faults.
        motion: True states, rotor speeds and motor outputs of its flight, cycle by cycle.

    Raises:
        OSError: The file cannot be written.
    """
    with atomic_write(path) as file:
        # Not compressed: that would make noise shorter by a fifth only, and take longer than all else that is written.
        np.savez(file, allow_pickle=False, **truth(scenario, motion))
