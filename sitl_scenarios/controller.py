"""Flight controller of the simulator: position, velocity, attitude and rate loops in cascade, tuned to the vehicle.

Each loop is a first-order lag of known bandwidth. The rate loop is as fast as rotors, delay and cycle allow, and every
outer loop is slower than the one within it. So the gains follow from the vehicle's mass, inertia, rotors and sensors,
and no vehicle has gains of its own. Bandwidths are rad/s: a loop of bandwidth ω settles like exp(−ω t).
"""

from math import atan, cos, exp, fsum, hypot, radians, remainder, sin, tau
from typing import NamedTuple

from sitl_scenarios.dynamics import State
from sitl_scenarios.plan import Reference
from sitl_scenarios.rotors import mixed_commands, pulse_width, rotor_frame
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.vectors import Vector3, Vector4, euler_angles
from sitl_scenarios.vehicles import GRAVITY, Airframe, airframe

MAX_RATE_BANDWIDTH = 25.0
"""Largest bandwidth of the rate loop, rad/s: a faster one would put too much of the gyro's noise on the motors."""

DEAD_TIME_BANDWIDTH = 0.4
"""Bandwidth of the rate loop times its dead time.

A loop of an integrator and a dead time T is well damped up to a bandwidth of about 0.4/T.
"""

LEAD = 4.0
"""Ratio of the lead filter (1 + τs)/(1 + τs/LEAD) in the rate loop, with the rotors' time constant τ.

The lead makes the rotors' lag as many times shorter, and the noise above it as many times larger.
"""

RATE_TO_ATTITUDE = 3.0
"""Bandwidth of the rate loop divided by the bandwidth of the attitude loop; a choice, for a well-damped cascade."""

ATTITUDE_TO_VELOCITY = 3.5
"""Bandwidth of the attitude loop divided by the bandwidth of the velocity loop; a choice."""

VELOCITY_TO_POSITION = 2.5
"""Bandwidth of the velocity loop divided by the bandwidth of the position loop; a choice."""

YAW_SLOWNESS = 4.0
"""How many times slower the yaw loops are than roll's and pitch's: only the rotors' torque turns the heading."""

RATE_TO_INTEGRAL = 12.0
"""Bandwidth of the rate loop divided by the bandwidth of its integral action; a choice."""

VELOCITY_TO_INTEGRAL = 5.0
"""Bandwidth of the velocity loop divided by its integral action's, which finds the wind in about two seconds."""

MAX_INTEGRAL_ACCELERATION = 7.0
"""Limit of the velocity loop's integral, m/s²: about what ``MAX_TILT`` gives, so that a storm does not wind it up."""

MAX_TILT = radians(35)
"""Largest roll and pitch that position control sets, rad; a choice."""

MAX_RATE = radians(220)
"""Largest setpoint of a body rate, rad/s: PX4's default of MC_ROLLRATE_MAX."""

MAX_SPEED = 4.0
"""Largest speed that a deviation of the position demands, horizontally and vertically, m/s; a choice."""

MIN_LIFT = 0.2
"""Smallest specific vertical thrust that is demanded, in units of gravity: the rotors never stop in flight."""

MIN_UPRIGHT_COSINE = 0.5
"""Smallest cosine of the tilt by which the vertical thrust is divided: 60° of tilt."""


class ControlOutput(NamedTuple):
    """Outputs and setpoints of the autopilot in one cycle."""

    outputs: Vector4
    """PWM pulse of each motor, 1000 to 2000 µs."""
    demands: Vector4
    """Demands to the mixer: roll, pitch and yaw, −1 to 1, and thrust, 0 to 1."""
    attitude: Vector3 = (0.0, 0.0, 0.0)
    """Setpoints of roll, pitch and yaw, rad."""
    rates: Vector3 = (0.0, 0.0, 0.0)
    """Setpoints of the body rates, rad/s."""


class LoopGains(NamedTuple):
    """Gains of the loops about one axis; the rate loop's output is the mixer's demand, −1 to 1."""

    p: float
    """Proportional gain of the rate loop, 1 per rad/s."""
    i: float
    """Integral gain of the rate loop, 1 per rad."""
    d: float
    """Derivative gain of the rate loop, 1 per rad/s²; it acts on the measured rate only."""
    derivative_lag: float
    """Time constant of the derivative's first-order filter, s; its factor per cycle is dt / (dt + lag)."""
    angle: float
    """Gain of the attitude loop, rad/s per rad."""


class FlightController:
    """Flight controller of one vehicle, called once per ``cycle`` (s).

    ``attitude_gains`` are the gains of the roll, pitch and yaw loops: rates that are set per error of the angle, 1/s.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Tunes all loops for the scenario's vehicle, sensors and cycle.

        The innermost loop, of the body rates, is made as fast as its dead time allows; each outer loop is slower
        than the one within it by a constant ratio.
        """
        vehicle = scenario.vehicle
        self.cycle = scenario.cycle
        self._body = airframe(vehicle)
        self._frame = rotor_frame(vehicle.layout, self._body.arm)
        self._rate_gain = vehicle.rate_gain
        mean_lag = sum(self._body.rotor_lags) / 2
        # The hold over a cycle and the computing in it take about one cycle.
        dead_time = mean_lag / LEAD + scenario.sensors.delay + self.cycle
        self._rate_bandwidth = min(DEAD_TIME_BANDWIDTH / dead_time, MAX_RATE_BANDWIDTH)
        self._attitude_bandwidth = self._rate_bandwidth / RATE_TO_ATTITUDE
        # Gain of the rate loop by the error, 1/s, and of its integral by the error in one cycle.
        self._error_gain = self._rate_gain * self._rate_bandwidth
        self._integral_gain = self._rate_bandwidth / RATE_TO_INTEGRAL * self.cycle
        # Smoothing factor per cycle of the lead filter's slow part, whose time constant is lag / LEAD.
        self._lead_smoothing = 1.0
        if mean_lag:
            self._lead_smoothing = 1.0 - exp(-self.cycle * LEAD / mean_lag)
        self._demand_per_acceleration = self._inverse_effectiveness(self._body)
        self._set_attitude_gains(
            (
                self._attitude_bandwidth,
                self._attitude_bandwidth,
                self._attitude_bandwidth / YAW_SLOWNESS,
            )
        )
        self.reset()

    def _inverse_effectiveness(self, body: Airframe) -> Vector3:
        """Returns the demand to the mixer that gives each axis an angular acceleration of 1 rad/s² in hover.

        A demand of 1 adds ±1 to the motors' normalised commands. In hover that changes rotor speed, thrust and torque
        by their slopes; the sum of thrusts times lever arms, or of torques, over the moment of inertia is the angular
        acceleration. The controller multiplies by the inverse, so that every vehicle has the same loops.

        Args:
            body: Airframe of the vehicle.

        Returns:
            Demand per angular acceleration of roll, pitch and yaw, 1 per rad/s². The demand of yaw is divided by
            ``YAW_SLOWNESS``, which makes the bandwidth of its rate loop smaller.
        """
        hover_command = body.command_for(body.hover_speed)
        # Slopes per normalised command: rad/s, N and N m.
        speed_per_command = body.speed_slope(hover_command) * body.full_command
        # Thrust and torque are quadratic · speed² + linear · speed.
        quadratic_thrust, linear_thrust = body.thrust_coefficients
        thrust_per_speed = 2 * quadratic_thrust * body.hover_speed + linear_thrust
        thrust_per_command = thrust_per_speed * speed_per_command
        quadratic_torque, linear_torque = body.torque_coefficients
        torque_per_speed = 2 * quadratic_torque * body.hover_speed + linear_torque
        torque_per_command = torque_per_speed * speed_per_command
        # Sums of lever arms, m: a rotor on the right rolls the body to the left.
        frame = self._frame
        roll_arm = -fsum(
            effect * right for effect, right in zip(frame.roll, frame.right, strict=True)
        )
        pitch_arm = fsum(
            effect * forward for effect, forward in zip(frame.pitch, frame.forward, strict=True)
        )
        ix, iy, iz = body.inertia
        return (
            ix / (thrust_per_command * roll_arm),
            iy / (thrust_per_command * pitch_arm),
            iz / (torque_per_command * body.rotors) / YAW_SLOWNESS,
        )

    def _set_attitude_gains(self, gains: Vector3) -> None:
        """Sets the gains of the attitude loops, and makes the velocity and position loops slower by constant ratios.

        Args:
            gains: Gains of roll, pitch and yaw (3,), rad/s per rad; each is also the bandwidth of its loop, rad/s.
        """
        self.attitude_gains = gains
        roll_gain, pitch_gain, _ = gains
        # The vehicle accelerates by tilting: the slower of its two tilts limits the velocity loop.
        slowest_tilt = min(roll_gain, pitch_gain, self._attitude_bandwidth)
        self._velocity_bandwidth = slowest_tilt / ATTITUDE_TO_VELOCITY
        self._position_bandwidth = self._velocity_bandwidth / VELOCITY_TO_POSITION
        # Low-pass of the velocity loop's proportional part, LEAD times faster than the loop.
        self._velocity_smoothing = 1.0 - exp(-self.cycle * LEAD * self._velocity_bandwidth)

    @property
    def gains(self) -> tuple[LoopGains, ...]:
        """Gains of the loops about roll, pitch and yaw, written as the gains of a PID controller of the rate.

        The autopilots' parameters describe a PID controller, while this controller has a lead filter. The two are
        the same: (1 + LEAD T s)/(1 + T s) = 1 + (LEAD − 1) T s/(1 + T s), a proportional part and a derivative with a
        low-pass of time constant T.
        """
        # T in discrete time: the autopilots' filters have the factor dt / (dt + T) per cycle, which must be this
        # controller's smoothing factor.
        lag = self.cycle * (1.0 - self._lead_smoothing) / self._lead_smoothing
        gains = []
        for per_acceleration, angle in zip(
            self._demand_per_acceleration, self.attitude_gains, strict=True
        ):
            p = self._rate_gain * self._rate_bandwidth * per_acceleration
            gains.append(
                LoopGains(
                    p=p,
                    i=p * self._rate_bandwidth / RATE_TO_INTEGRAL,
                    d=p * (LEAD - 1.0) * lag,
                    derivative_lag=lag,
                    angle=angle,
                )
            )
        return tuple(gains)

    def reset(self) -> None:
        """Resets integrators, filters and the heading's setpoint, as on the ground."""
        # Accelerations of the velocity loop, NED, m/s²: its integral and its filtered proportional part.
        self._integral_acceleration = [0.0, 0.0, 0.0]
        self._smooth_acceleration = [0.0, 0.0, 0.0]
        # States of the rate loops about the three axes, rad/s: integral, and low-passed rate of the lead filter.
        self._rate_integral = [0.0, 0.0, 0.0]
        self._slow_rates = [0.0, 0.0, 0.0]
        self._heading = 0.0

    def control(self, estimate: State, reference: Reference, *, is_flying: bool) -> ControlOutput:
        """Runs all loops for one cycle, from the position down to the motors.

        Position and velocity control set an acceleration. The vehicle must tilt until its thrust points along that
        acceleration less gravity: this gives setpoints of roll, pitch and thrust, which attitude control follows.

        Args:
            estimate: State as the autopilot estimates it; its rotor speeds are not used.
            reference: Setpoints of the flight plan.
            is_flying: Whether the vehicle is off the ground; nothing is integrated otherwise.

        Returns:
            PWM pulses of the motors, demands to the mixer, and the setpoints of attitude and rates.
        """
        north, east, down = self._acceleration_setpoint(estimate, reference, is_flying=is_flying)
        angles = euler_angles(estimate.attitude)
        roll, pitch, yaw = angles
        # Acceleration along the heading and to its right.
        cos_yaw, sin_yaw = cos(yaw), sin(yaw)
        forward = north * cos_yaw + east * sin_yaw
        right = east * cos_yaw - north * sin_yaw
        # Specific vertical thrust, m/s².
        lift = max(GRAVITY - down, MIN_LIFT * GRAVITY)
        # The excitation is added to the angles that position control sets. A nose that is down accelerates forward.
        added_roll, added_pitch, yaw_rate = reference.attitude_demand
        pitch_for_forward = atan(-forward / lift)
        pitch_setpoint = _clamped(pitch_for_forward, MAX_TILT)
        roll_for_right = atan(right / lift * cos(pitch_setpoint))
        roll_setpoint = _clamped(roll_for_right, MAX_TILT) + added_roll
        pitch_setpoint += added_pitch
        # The heading is held, and turned at the yaw rate that is demanded, as both autopilots do.
        if is_flying:
            next_heading = self._heading + yaw_rate * self.cycle
            self._heading = remainder(next_heading, tau)
        # A tilted thrust must be larger to lift as much.
        upright = max(cos(roll) * cos(pitch), MIN_UPRIGHT_COSINE)
        thrust = self._body.mass * lift / upright

        attitude_setpoint = roll_setpoint, pitch_setpoint, self._heading
        rate_setpoints = self._rate_setpoints(angles, attitude_setpoint, (0.0, 0.0, yaw_rate))
        return self.rate_control(
            estimate, attitude_setpoint, rate_setpoints, thrust, is_flying=is_flying
        )

    def _acceleration_setpoint(
        self, estimate: State, reference: Reference, *, is_flying: bool
    ) -> Vector3:
        """Runs the position and velocity loops for one cycle.

        The position loop turns errors of the position into velocities, which are added to the flight plan's. The
        velocity loop, proportional and integral, turns errors of the velocity into accelerations. Its integral finds
        the acceleration that holds the vehicle against the wind.

        Args:
            estimate: State as the autopilot estimates it.
            reference: Setpoints of position and velocity.
            is_flying: Whether the vehicle is off the ground; nothing is integrated otherwise.

        Returns:
            Acceleration setpoint, NED, m/s².
        """
        north_speed, east_speed, down_speed = estimate.velocity
        north, east, down = estimate.position
        reference_north_speed, reference_east_speed = reference.velocity
        position_gain = self._position_bandwidth
        north_setpoint = position_gain * (reference.north - north) + reference_north_speed
        east_setpoint = position_gain * (reference.east - east) + reference_east_speed
        # The horizontal speed is limited without a change of its direction.
        max_speed = MAX_SPEED + hypot(reference_north_speed, reference_east_speed)
        scale = max_speed / max(max_speed, hypot(north_setpoint, east_setpoint))
        sink_correction = _clamped(position_gain * (-reference.height - down), MAX_SPEED)
        down_setpoint = -reference.climb_rate + sink_correction
        errors = (
            north_setpoint * scale - north_speed,
            east_setpoint * scale - east_speed,
            down_setpoint - down_speed,
        )
        bandwidth = self._velocity_bandwidth
        integral = self._integral_acceleration
        if is_flying:
            gain = bandwidth * bandwidth / VELOCITY_TO_INTEGRAL * self.cycle
            for i, error in enumerate(errors):
                integral[i] = _clamped(integral[i] + gain * error, MAX_INTEGRAL_ACCELERATION)
        # Without a low-pass, noise of position and velocity would reach the motors, multiplied by the bandwidth of
        # every loop within.
        smoothing = self._velocity_smoothing
        smooth = self._smooth_acceleration
        for i, error in enumerate(errors):
            smooth[i] += smoothing * (bandwidth * error - smooth[i])
        return smooth[0] + integral[0], smooth[1] + integral[1], smooth[2] + integral[2]

    def attitude_control(
        self,
        estimate: State,
        attitude_setpoint: Vector3,
        rate_feedforward: Vector3,
        thrust: float,
        *,
        is_flying: bool,
    ) -> ControlOutput:
        """Runs the attitude and rate loops for one cycle, and mixes their demands for the motors.

        Args:
            estimate: State as the autopilot estimates it.
            attitude_setpoint: Roll, pitch and yaw (3,), rad.
            rate_feedforward: Body rates (3,) that are added to the rates of the attitude loops, rad/s.
            thrust: Thrust of all rotors, N.
            is_flying: Whether the vehicle is off the ground; nothing is integrated otherwise.

        Returns:
            PWM pulses of the motors, µs, demands to the mixer, and the setpoints of attitude and rates.
        """
        angles = euler_angles(estimate.attitude)
        rate_setpoints = self._rate_setpoints(angles, attitude_setpoint, rate_feedforward)
        return self.rate_control(
            estimate, attitude_setpoint, rate_setpoints, thrust, is_flying=is_flying
        )

    def _rate_setpoints(
        self, angles: Vector3, attitude_setpoint: Vector3, rate_feedforward: Vector3
    ) -> Vector3:
        """Runs the attitude loops, which set the body rates that reduce the errors of the angles.

        Each loop sets a rate in proportion to the error of its angle. The three angles are controlled independently,
        which holds for moderate tilts.

        Args:
            angles: Roll, pitch and yaw (3,) as the autopilot estimates them, rad.
            attitude_setpoint: Roll, pitch and yaw (3,), rad.
            rate_feedforward: Body rates (3,) that are added, rad/s.

        Returns:
            Setpoints of the body rates (3,), rad/s.
        """
        roll, pitch, yaw = angles
        roll_setpoint, pitch_setpoint, yaw_setpoint = attitude_setpoint
        roll_gain, pitch_gain, yaw_gain = self.attitude_gains
        roll_feedforward, pitch_feedforward, yaw_feedforward = rate_feedforward
        # The shorter way round.
        yaw_error = remainder(yaw_setpoint - yaw, tau)
        return (
            _clamped(roll_gain * (roll_setpoint - roll) + roll_feedforward, MAX_RATE),
            _clamped(pitch_gain * (pitch_setpoint - pitch) + pitch_feedforward, MAX_RATE),
            _clamped(yaw_gain * yaw_error + yaw_feedforward, MAX_RATE),
        )

    def rate_control(
        self,
        estimate: State,
        attitude_setpoint: Vector3,
        rate_setpoints: Vector3,
        thrust: float,
        *,
        is_flying: bool,
    ) -> ControlOutput:
        """Runs the rate loops for one cycle, and mixes their demands for the motors.

        Args:
            estimate: State as the autopilot estimates it.
            attitude_setpoint: Roll, pitch and yaw (3,), rad, which are only reported.
            rate_setpoints: Body rates (3,), rad/s.
            thrust: Thrust of all rotors, N.
            is_flying: Whether the vehicle is off the ground; nothing is integrated otherwise.

        Returns:
            PWM pulses of the motors, µs, demands to the mixer, and the setpoints of attitude and rates.
        """
        # All rotors carry the same part of the thrust. Its command follows from the inverse thrust curve, as in both
        # autopilots.
        body = self._body
        command = body.command_for(body.speed_for(thrust / body.rotors)) / body.full_command
        roll_setpoint, pitch_setpoint, yaw_setpoint = rate_setpoints
        roll_rate, pitch_rate, yaw_rate = estimate.rates
        demands = (
            _clamped(self.rate_demand(0, roll_setpoint, roll_rate, is_flying=is_flying), 1.0),
            _clamped(self.rate_demand(1, pitch_setpoint, pitch_rate, is_flying=is_flying), 1.0),
            _clamped(self.rate_demand(2, yaw_setpoint, yaw_rate, is_flying=is_flying), 1.0),
            min(max(command, 0.0), 1.0),
        )
        outputs = tuple([pulse_width(command) for command in self.motor_commands(demands)])
        return ControlOutput(outputs, demands, attitude_setpoint, rate_setpoints)

    def motor_commands(self, demands: Vector4) -> Vector4:
        """Returns the normalised command of each motor for demands of roll, pitch, yaw and thrust."""
        return mixed_commands(self._frame, demands)

    def rate_demand(self, axis: int, setpoint: float, rate: float, *, is_flying: bool) -> float:
        """Runs the rate loop of one axis for one cycle.

        The controller is proportional and integral. The measured rate passes through a lead filter (1 + τs)/(1 +
        τs/LEAD), which cancels most of the rotors' lag τ; the setpoint does not, so its steps are not amplified.

        Args:
            axis: 0 for roll, 1 for pitch, 2 for yaw.
            setpoint: Setpoint of the body rate, rad/s.
            rate: Body rate as the autopilot estimates it, rad/s.
            is_flying: Whether the vehicle is off the ground; nothing is integrated otherwise.

        Returns:
            Demand to the mixer, not limited; ±1 is the motors' full range.
        """
        # The lead filter is LEAD times the rate less (LEAD − 1) times the rate after a low-pass 1/(1 + τs/LEAD).
        slow_rate = self._slow_rates[axis]
        slow_rate += self._lead_smoothing * (rate - slow_rate)
        self._slow_rates[axis] = slow_rate
        lead_rate = LEAD * rate - (LEAD - 1.0) * slow_rate
        integral = self._rate_integral[axis]
        if is_flying:
            integral += self._integral_gain * (setpoint - rate)
            self._rate_integral[axis] = integral
        error = setpoint - lead_rate + integral
        # The loop's bandwidth times the error is the angular acceleration that the loop demands, rad/s². A scenario
        # may multiply it, to make the vehicle sluggish or oscillate.
        return self._error_gain * error * self._demand_per_acceleration[axis]


def _clamped(value: float, limit: float) -> float:
    """Limits a value to a symmetric range.

    Args:
        value: The value.
        limit: Largest absolute value that is returned, at least 0, in the unit of the value.

    Returns:
        The nearest value between −``limit`` and ``limit``.
    """
    # Comparisons take half the time of ``min`` and ``max``.
    if value > limit:
        return limit
    if value < -limit:
        return -limit
    return value
