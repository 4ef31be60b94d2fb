"""Dynamics of a multirotor: forces and moments of rotors and air, and the integration from state to state.

The world is north-east-down (NED), body axes are forward, right, down (FRD). On the body act its weight, the rotors'
thrust along −z and torque about z, and the air that moves past it:

- the hull's drag, ½ρ C_d A |a| a, for air that moves with a relative to the body; a scenario may set others;
- each rotor's drag, k ω a along its disc: the H-force, linear in rotor speed and in the air's (Ph. Martin and
  E. Salaün, ICRA 2010; R. Mahony, V. Kumar and P. Corke, "Multirotor aerial vehicles", IEEE RAM 2012);
- each rotor's loss of thrust to air that moves down through its disc, k_z ω a_z, with a_z at its own hub. So a body
  that rolls is damped, and air that turns about its x axis rolls it (J. Svacha et al., ICUAS 2017).

Both drags act at the height of the hubs, above the centre of mass, and so tilt the body. Damage changes what a rotor
gives at its speed, and where the centre of mass is. Left out as small: gyroscopic moments of the rotors, flapping
moments, ground effect, the effect of inflow on torque, the effect of a shifted load on inertia, and the drag that a
chipped propeller loses.
"""

from collections.abc import Callable, Sequence
from functools import cache
from math import ceil, exp, sqrt
from operator import mul
from typing import Any, NamedTuple

import numpy as np

from sitl_scenarios.damage import Damage, no_damage
from sitl_scenarios.motion import Array
from sitl_scenarios.rotors import MAX_PULSE, MIN_PULSE, rotor_frame
from sitl_scenarios.scenario import VehicleSpec
from sitl_scenarios.vectors import Quaternion, Vector3, Vector4
from sitl_scenarios.vehicles import AIR_DENSITY, GRAVITY, airframe

MAX_STEP_SECONDS = 2e-3
"""Longest step of the physics, s: a choice, well below the time constants of rotors (10 ms and more)."""


class AirState(NamedTuple):
    """Motion of the air about the vehicle, and moments that act on it whatever the air does."""

    north: float = 0.0
    """Velocity of the air to the north, m/s."""
    east: float = 0.0
    """Velocity of the air to the east, m/s."""
    down: float = 0.0
    """Velocity of the air downwards, m/s."""
    p: float = 0.0
    """Rotation of the air about the body's forward axis, rad/s."""
    q: float = 0.0
    """Rotation of the air about the body's right axis, rad/s."""
    roll: float = 0.0
    """External moment about the body's forward axis, N m."""
    pitch: float = 0.0
    """External moment about the body's right axis, N m."""
    yaw: float = 0.0
    """External moment about the body's down axis, N m."""


class Accelerations(NamedTuple):
    """Accelerations of a vehicle, and the disturbance in them.

    The disturbance is everything but the weight and the rotors' thrust and torque in still air: drag, inflow, damping
    and external moments.
    """

    linear: Vector3
    """Acceleration, NED, m/s²."""
    angular: Vector3
    """Angular acceleration in body axes, rad/s²."""
    disturbance_force: Vector3
    """Force of the disturbance, NED, N."""
    disturbance_moment: Vector3
    """Moment of the disturbance in body axes, N m."""


NO_ACCELERATION = Accelerations((0.0,) * 3, (0.0,) * 3, (0.0,) * 3, (0.0,) * 3)
"""Accelerations of a vehicle that stands on the ground."""

Dynamics = Callable[[Quaternion, Vector3, Vector3, Vector4, AirState], Accelerations]
"""Function of attitude (body to NED), velocity (NED, m/s), body rates (rad/s), rotor speeds (rad/s) and the air."""

StepObserver = Callable[[Vector3, Sequence[float]], None]
"""Function of body rates (rad/s) and rotor speeds (rad/s), called after each step of the physics."""

FlatDynamics = Callable[[Any, Any, Any, Any, Any], tuple[Any, ...]]
"""The same function with its twelve values in a flat tuple, in the order of ``Accelerations``: the simulation calls it
hundreds of times per second, and packing them would take a tenth of the time."""

LINEAR = slice(0, 3)
"""Place of the acceleration among the values of ``FlatDynamics``."""

ANGULAR = slice(3, 6)
"""Place of the angular acceleration among these values."""

FORCE = slice(6, 9)
"""Place of the disturbing force among these values."""

MOMENT = slice(9, 12)
"""Place of the disturbing moment among these values."""


class RotorEffect(NamedTuple):
    """Position of one rotor, and the sign and remaining fraction of its thrust and torque."""

    forward: float
    """Position forward of the centre of mass, m."""
    right: float
    """Position to the right of the centre of mass, m."""
    thrust: float
    """Remaining fraction of its thrust: 1 when undamaged."""
    torque: float
    """Remaining fraction of its torque, positive where it turns the body to positive yaw."""


def _rotor_effects(vehicle: VehicleSpec, damage: Damage) -> list[RotorEffect]:
    """Returns position, thrust factor and torque factor of each rotor of a vehicle.

    Args:
        vehicle: Airframe of a scenario's vehicle, with its drag, rotor lag and inertia.
        damage: Damage of the vehicle: fractions of thrust and torque, and position of the centre of mass, which is
            the origin of the rotors' positions.

    Returns:
        Effects of the rotors, in the order of the motors.
    """
    body = airframe(vehicle)
    frame = rotor_frame(vehicle.frame, body.arm)
    centre_forward, centre_right = damage.centre_of_mass
    return [
        RotorEffect(
            forward=frame.forward[rotor] - centre_forward,
            right=frame.right[rotor] - centre_right,
            thrust=damage.thrust[rotor],
            torque=frame.yaw[rotor] * damage.torque[rotor],
        )
        for rotor in range(body.rotors)
    ]


def vehicle_dynamics(vehicle: VehicleSpec, damage: Damage | None = None) -> Dynamics:
    """Builds the equations of motion of a vehicle in the air.

    The simulation integrates this function, and the truth files linearise it: there is no second model.

    Args:
        vehicle: Airframe of a scenario's vehicle, with its drag, rotor lag and inertia.
        damage: Damage that acts on it; None for a sound vehicle.

    Returns:
        The function of attitude, velocity, body rates, rotor speeds and air that computes the accelerations.
    """
    flat_dynamics = _flat_dynamics(vehicle, damage)

    def accelerations(
        attitude: Quaternion, velocity: Vector3, rates: Vector3, rotors: Vector4, air: AirState
    ) -> Accelerations:
        """Computes the accelerations of one state; shapes and units are stated at :data:`Dynamics`."""
        values = flat_dynamics(attitude, velocity, rates, rotors, air)
        return Accelerations(values[LINEAR], values[ANGULAR], values[FORCE], values[MOMENT])

    return accelerations


class Disturbance(NamedTuple):
    """Force and moment of the disturbance of N states; see ``Accelerations``."""

    force: Array
    """(N, 3) force, NED, N."""
    moment: Array
    """(N, 3) moment in body axes, N m."""


def disturbance_of_states(
    vehicle: VehicleSpec,
    damage: Damage,
    attitude: Array,
    velocity: Array,
    rates: Array,
    rotors: Array,
    air: Array,
) -> Disturbance:
    """Computes the disturbing force and moment on a vehicle for N states at once, in the air.

    The disturbance is everything but the weight and the rotors' thrust and torque in still air, such as drag. The
    equations are the ones that the simulation integrates, called with arrays of N values in the place of numbers.
    ``tests/scenarios/test_body.py`` compares the result with a computation of one state after another.

    Args:
        vehicle: Airframe of a scenario's vehicle, with its drag, rotor lag and inertia.
        damage: Remaining speed and thrust of each rotor, and the centre of mass.
        attitude: (N, 4) unit quaternions from body axes to NED.
        velocity: (N, 3) velocity, NED, m/s.
        rates: (N, 3) body rates, rad/s.
        rotors: (N, n) speeds of its n rotors, rad/s.
        air: (N, 8) the air, columns as the fields of ``AirState``.

    Returns:
        (N, 3) forces, NED, N, and (N, 3) moments in body axes, N m.
    """
    flat_dynamics = _flat_dynamics(vehicle, damage, np.sqrt)
    # ``values`` are twelve arrays (N,), of which the slices FORCE and MOMENT are three each.
    values = flat_dynamics(attitude.T, velocity.T, rates.T, rotors.T, air.T)
    return Disturbance(np.column_stack(values[FORCE]), np.column_stack(values[MOMENT]))


def _flat_dynamics(
    vehicle: VehicleSpec, damage: Damage | None, root: Callable[[Any], Any] = sqrt
) -> FlatDynamics:
    """Returns the accelerations of a vehicle in the air, and the disturbance in them, as a function of its state.

    Args:
        vehicle: Airframe of a scenario's vehicle, with its drag, rotor lag and inertia.
        damage: Damage that acts on it; None for a sound vehicle.
        root: Square root for the values that the function is called with: ``math.sqrt`` for the numbers of one state,
            ``numpy.sqrt`` for arrays of many states.

    Returns:
        Function of attitude, velocity, body rates, rotor speeds and air. Its result has twelve values, in SI units:
        linear acceleration (NED), angular acceleration (body axes), disturbing force (NED) and moment (body axes).
    """
    body = airframe(vehicle)
    damage = damage or no_damage(body.rotors)
    # Plain tuples are unpacked faster than named ones.
    rotor_effects = [tuple(effect) for effect in _rotor_effects(vehicle, damage)]
    centre_forward, centre_right = damage.centre_of_mass
    mass = body.mass
    hub_height = body.hub_height
    ix, iy, iz = body.inertia
    damping_x, damping_y, damping_z = (
        damping * inertia for damping, inertia in zip(body.damping, body.inertia, strict=True)
    )
    quadratic_thrust, linear_thrust = body.thrust_coefficients
    quadratic_torque, linear_torque = body.torque_coefficients
    # Factors of the drag: of the hull by |a| a, and of the rotors by the sum of their speeds and a.
    half_rho_area = AIR_DENSITY * body.drag_area / 2
    hull_drag_x = hull_drag_y = half_rho_area
    rotor_drag_x = rotor_drag_y = body.rotor_drag if vehicle.rotor_drag else 0.0
    if vehicle.drag_linear is not None:
        hover_speed_sum = body.rotors * body.hover_speed
        rotor_drag_x, rotor_drag_y = (drag * mass / hover_speed_sum for drag in vehicle.drag_linear)
    if vehicle.drag_quadratic is not None:
        hull_drag_x, hull_drag_y = (drag * mass for drag in vehicle.drag_quadratic)
    inflow_factor = body.inflow if vehicle.rotor_drag else 0.0
    # Differences of the moments of inertia in Euler's equations.
    roll_coupling, pitch_coupling, yaw_coupling = iy - iz, iz - ix, ix - iy

    def accelerations(
        attitude: Any, velocity: Any, rates: Any, rotors: Any, air: Any
    ) -> tuple[Any, ...]:
        """Returns accelerations and disturbance of one state, or of the states in arrays; see ``_flat_dynamics``."""
        # Written out in floats: NumPy's calls on arrays of three would take ten times as long, and loops over three
        # numbers twice as long.
        p, q, r = rates
        wind_north, wind_east, wind_down, air_p, air_q, roll_moment, pitch_moment, yaw_moment = air
        # Elements of the rotation matrix, by the axis in NED and the body axis, as ``rotation_matrix`` has them.
        w, x, y, z = attitude
        x2 = x + x
        y2 = y + y
        z2 = z + z
        nx = 1.0 - y * y2 - z * z2
        ny = x * y2 - w * z2
        nz = x * z2 + w * y2
        ex = x * y2 + w * z2
        ey = 1.0 - x * x2 - z * z2
        ez = y * z2 - w * x2
        dx = x * z2 - w * y2
        dy = y * z2 + w * x2
        dz = 1.0 - x * x2 - y * y2
        north_speed, east_speed, down_speed = velocity
        north_air = wind_north - north_speed
        east_air = wind_east - east_speed
        down_air = wind_down - down_speed
        # The transposed matrix rotates the relative air from NED into body axes.
        ax = nx * north_air + ex * east_air + dx * down_air
        ay = ny * north_air + ey * east_air + dy * down_air
        az = nz * north_air + ez * east_air + dz * down_air
        airspeed = root(north_air * north_air + east_air * east_air + down_air * down_air)
        rotor_speed_sum = sum(rotors)
        drag_x = hull_drag_x * airspeed + rotor_drag_x * rotor_speed_sum
        force_x = drag_x * ax
        drag_y = hull_drag_y * airspeed + rotor_drag_y * rotor_speed_sum
        force_y = drag_y * ay

        # Inflow: the air's speed down through each disc; a hub at (x, y) moves down with the body's p y − q x.
        inflow_p = inflow_factor * (air_p - p)
        inflow_q = inflow_factor * (air_q - q)
        inflow_z = inflow_factor * az
        hull_force_z = half_rho_area * airspeed * az
        moment_x = roll_moment - damping_x * p + hub_height * force_y - centre_right * hull_force_z
        moment_y = (
            pitch_moment - damping_y * q - hub_height * force_x + centre_forward * hull_force_z
        )
        moment_z = yaw_moment - damping_z * r + centre_right * force_x - centre_forward * force_y
        # Thrust and torque of the rotors in still air, and the thrust that each loses to the inflow. Sums are assigned
        # again, not added to in place, which would change the arrays that they begin with.
        force_z = hull_force_z
        total_thrust = total_torque = 0.0
        thrust_moment_x = thrust_moment_y = 0.0
        for rotor_speed, (forward, right, thrust_fraction, signed_torque_fraction) in zip(
            rotors, rotor_effects, strict=True
        ):
            lost_thrust = rotor_speed * (inflow_z + inflow_p * right - inflow_q * forward)
            force_z = force_z + lost_thrust
            moment_x = moment_x + right * lost_thrust
            moment_y = moment_y - forward * lost_thrust
            thrust = (
                thrust_fraction * (quadratic_thrust * rotor_speed + linear_thrust) * rotor_speed
            )
            total_thrust = total_thrust + thrust
            total_torque = (
                total_torque
                + signed_torque_fraction
                * (quadratic_torque * rotor_speed + linear_torque)
                * rotor_speed
            )
            thrust_moment_x = thrust_moment_x - right * thrust
            thrust_moment_y = thrust_moment_y + forward * thrust

        north_force = nx * force_x + ny * force_y + nz * force_z
        east_force = ex * force_x + ey * force_y + ez * force_z
        down_force = dx * force_x + dy * force_y + dz * force_z
        # Euler's equations of a rigid body without products of inertia.
        return (
            (north_force - nz * total_thrust) / mass,
            (east_force - ez * total_thrust) / mass,
            (down_force - dz * total_thrust) / mass + GRAVITY,
            (moment_x + thrust_moment_x + roll_coupling * q * r) / ix,
            (moment_y + thrust_moment_y + pitch_coupling * r * p) / iy,
            (moment_z + total_torque + yaw_coupling * p * q) / iz,
            north_force,
            east_force,
            down_force,
            moment_x,
            moment_y,
            moment_z,
        )

    return accelerations


class State(NamedTuple):
    """State of the vehicle at one instant."""

    position: Vector3 = (0.0, 0.0, 0.0)
    """Position, NED, m."""
    velocity: Vector3 = (0.0, 0.0, 0.0)
    """Velocity, NED, m/s."""
    attitude: Quaternion = (1.0, 0.0, 0.0, 0.0)
    """Unit quaternion from body axes to NED."""
    rates: Vector3 = (0.0, 0.0, 0.0)
    """Body rates, rad/s."""
    rotors: Vector4 = (0.0, 0.0, 0.0, 0.0)
    """Rotor speeds, rad/s."""
    accelerations: Accelerations = NO_ACCELERATION
    """Accelerations of the last step; zero on the ground."""


def steps_in(cycle: float, max_step: float) -> int:
    """Returns how many equal steps, none longer than ``max_step``, make up a control cycle; both are in seconds."""
    return ceil(cycle / max_step - 1e-9)


class DecayFactors(NamedTuple):
    """Fractions that remain of the deviation of a rotor speed from its settled value, which decays as exp(−t/τ)."""

    mean: float
    """Mean over a step of the simulation."""
    end: float
    """At the end of the step."""


@cache
def _decay_factors(time_constant: float, step: float) -> DecayFactors:
    """Returns how much of a deviation remains on average over a step, and at its end, by exponential decay.

    The decay exp(−t/τ) is the exact solution of a first-order lag. Its mean over a step h is (1 − exp(−h/τ)) τ/h.

    Args:
        time_constant: τ, s; 0 without a lag.
        step: Length h of the step, s.

    Returns:
        Mean and final fraction; both are 0 without a lag.
    """
    if not time_constant:
        return DecayFactors(0.0, 0.0)
    end = exp(-step / time_constant)
    mean = (1.0 - end) * time_constant / step
    return DecayFactors(mean, end)


class RotorDecayFactors(NamedTuple):
    """Fractions that remain of deviations of rotor speeds during a step."""

    rise: DecayFactors
    """Of rotors that speed up."""
    fall: DecayFactors
    """Of rotors that slow down."""


class Body:
    """Integrates the motion of one vehicle during cycles of its autopilot, each in equal steps."""

    def __init__(self, vehicle: VehicleSpec, cycle: float) -> None:
        """Takes the vehicle, undamaged, and the length of a ``cycle`` in seconds."""
        self._vehicle = vehicle
        self._airframe = airframe(vehicle)
        self._cycle = cycle
        self._steps = steps_in(cycle, MAX_STEP_SECONDS)
        self.apply_damage(no_damage(self._airframe.rotors))

    def apply_damage(self, damage: Damage) -> None:
        """Lets this damage act on the vehicle from now on, in the place of any before."""
        self.damage = damage
        self._dynamics = _flat_dynamics(self._vehicle, damage)

    def settled_speeds(self, outputs: Vector4, battery: float) -> Vector4:
        """Returns the speeds at which the rotors settle while the motor outputs are constant.

        With a thrust curve, the command determines the thrust, and the thrust the speed; without one, the speed is a
        straight line in the command. A weak battery slows all rotors down, and damage the rotor of the damaged motor.

        Args:
            outputs: PWM pulse of each motor (n,), µs.
            battery: Remaining fraction of the voltage of a full battery; rotor speeds are proportional to it.

        Returns:
            Speed of each rotor (n,), rad/s, with the damage of the vehicle.
        """
        body = self._airframe
        pulse_range = MAX_PULSE - MIN_PULSE
        speeds = []
        if body.thrust_expo is not None:
            command_per_microsecond = body.full_command / pulse_range
            for pulse in outputs:
                command = command_per_microsecond * (pulse - MIN_PULSE)
                speeds.append(battery * body.rotor_speed(command))
        else:
            # The line has the speed per normalised command, and the speed at a command of 0.
            slope, offset = body.speed_line
            speed_per_microsecond = battery * slope * body.full_command / pulse_range
            speed_at_min_pulse = battery * offset
            for pulse in outputs:
                speeds.append(speed_per_microsecond * (pulse - MIN_PULSE) + speed_at_min_pulse)
        return tuple(map(mul, speeds, self.damage.speed))

    def advanced(
        self,
        state: State,
        settled_speeds: Vector4,
        air: AirState,
        steps: int | None = None,
        observe: StepObserver | None = None,
    ) -> State:
        """Returns the state one cycle later, by the midpoint rule.

        The midpoint rule needs the state at the middle of each step. It is extrapolated with the accelerations of the
        step before, so that the dynamics, which take most of the time, are evaluated once per step rather than twice.
        The rotors' lag is integrated exactly: their speeds are the means over the step, to which mean thrust is nearly
        proportional. With speeds at the middle of the step the rates would err five to seven times as much.

        Args:
            state: State at the beginning, with the accelerations of the step before.
            settled_speeds: Speeds that the rotors tend to, rad/s.
            air: Velocity of the air, and moments on the vehicle, during the cycle.
            steps: Number of steps in the cycle; None for steps of up to ``MAX_STEP_SECONDS``.
            observe: Function that is called after each step; None for none.

        Returns:
            State at the end of the last step, with the accelerations at its middle.
        """
        # Written out in floats: functions of three numbers would take half of the time for their calls.
        dynamics = self._dynamics
        if steps is None:
            steps = self._steps
        step = self._cycle / steps
        half = step / 2
        quarter = half / 2
        decay_factors = self._decay_factors(step)
        (north, east, down), (north_speed, east_speed, down_speed), (w, x, y, z), (p, q, r) = state[
            :4
        ]
        rotors: Sequence[float] = state.rotors
        north_change, east_change, down_change = state.accelerations.linear
        p_change, q_change, r_change = state.accelerations.angular
        for _ in range(steps):
            mean_rotors, rotors = _lagged_speeds(rotors, settled_speeds, decay_factors)
            # The attitude at the middle: it turns during half of the step with the mean rates of that half, to first
            # order (``rotated``).
            half_roll = quarter * (p + quarter * p_change)
            half_pitch = quarter * (q + quarter * q_change)
            half_yaw = quarter * (r + quarter * r_change)
            middle_attitude = (
                w - x * half_roll - y * half_pitch - z * half_yaw,
                x + w * half_roll + y * half_yaw - z * half_pitch,
                y + w * half_pitch + z * half_roll - x * half_yaw,
                z + w * half_yaw + x * half_pitch - y * half_roll,
            )
            (
                north_change, east_change, down_change,
                p_change, q_change, r_change,
                north_force, east_force, down_force,
                roll_moment, pitch_moment, yaw_moment,
            ) = dynamics(
                middle_attitude,
                (
                    north_speed + half * north_change,
                    east_speed + half * east_change,
                    down_speed + half * down_change,
                ),
                (p + half * p_change, q + half * q_change, r + half * r_change),
                mean_rotors,
                air,
            )  # fmt: skip
            # State at the end. Positions and angles change with the mean velocity and the mean rates of the step.
            north = north + step * (north_speed + half * north_change)
            east = east + step * (east_speed + half * east_change)
            down = down + step * (down_speed + half * down_change)
            half_roll = half * (p + half * p_change)
            half_pitch = half * (q + half * q_change)
            half_yaw = half * (r + half * r_change)
            new_w = w - x * half_roll - y * half_pitch - z * half_yaw
            new_x = x + w * half_roll + y * half_yaw - z * half_pitch
            new_y = y + w * half_pitch + z * half_roll - x * half_yaw
            new_z = z + w * half_yaw + x * half_pitch - y * half_roll
            scale = 1.0 / sqrt(new_w * new_w + new_x * new_x + new_y * new_y + new_z * new_z)
            w, x, y, z = new_w * scale, new_x * scale, new_y * scale, new_z * scale
            north_speed = north_speed + step * north_change
            east_speed = east_speed + step * east_change
            down_speed = down_speed + step * down_change
            p = p + step * p_change
            q = q + step * q_change
            r = r + step * r_change
            if observe is not None:
                observe((p, q, r), rotors)
        return State(
            (north, east, down),
            (north_speed, east_speed, down_speed),
            (w, x, y, z),
            (p, q, r),
            tuple(rotors),
            Accelerations(
                (north_change, east_change, down_change),
                (p_change, q_change, r_change),
                (north_force, east_force, down_force),
                (roll_moment, pitch_moment, yaw_moment),
            ),
        )

    def rotor_speeds_after_cycle(self, rotors: Vector4, settled_speeds: Vector4) -> Vector4:
        """Returns the speeds of the rotors one cycle later, on which the motion of the vehicle has no influence.

        Args:
            rotors: Rotor speeds (n,) at the beginning, rad/s.
            settled_speeds: Speeds (n,) that the rotors tend to, rad/s.

        Returns:
            Rotor speeds (n,), rad/s.
        """
        _, speeds = _lagged_speeds(rotors, settled_speeds, self._decay_factors(self._cycle))
        return tuple(speeds)

    def _decay_factors(self, step: float) -> RotorDecayFactors:
        """Returns what the rotors' lags leave of deviations during a step, s."""
        rise_lag, fall_lag = self._airframe.rotor_lags
        return RotorDecayFactors(_decay_factors(rise_lag, step), _decay_factors(fall_lag, step))


def _lagged_speeds(
    speeds: Sequence[float], settled_speeds: Vector4, factors: RotorDecayFactors
) -> tuple[Sequence[float], Sequence[float]]:
    """Returns mean and final rotor speeds of a step, by the exact solution of their first-order lag.

    The deviation from the settled speed decays as exp(−t/τ), with one time constant τ for rotors that speed up and
    another for those that slow down: a motor drives the rotor harder than the air brakes it.

    Args:
        speeds: Rotor speeds (n,) at the beginning of the step, rad/s.
        settled_speeds: Speeds (n,) that the rotors tend to, rad/s.
        factors: What the lags leave of deviations during the step.

    Returns:
        Means of the speeds during the step, and speeds at its end (n,) each, rad/s.
    """
    (rise_mean, rise_end), (fall_mean, fall_end) = factors
    mean_speeds = []
    end_speeds = []
    for speed, settled_speed in zip(speeds, settled_speeds, strict=True):
        deviation = speed - settled_speed
        # A rotor below its settled speed speeds up.
        if deviation < 0.0:
            mean_speeds.append(settled_speed + deviation * rise_mean)
            end_speeds.append(settled_speed + deviation * rise_end)
        else:
            mean_speeds.append(settled_speed + deviation * fall_mean)
            end_speeds.append(settled_speed + deviation * fall_end)
    return mean_speeds, end_speeds
