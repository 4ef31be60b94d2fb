"""Simulated flight controller that runs ArduPilot's or PX4's rate loops with the gains of a scenario's parameters.

The rate loops run as in the autopilots' source code, once per cycle of the autopilot's loop. Between a rate loop's
demand and the motors are the autopilot's mixer, its inverse thrust curve and its motors' range. Position and velocity
control are the simulation's own. ``mavdem.loops.controllers`` describes each parameter.
"""

from math import sqrt

import numpy as np

from mavdem.ingest.vocabulary import CONTROL_PARAMETERS
from mavdem.loops.autopilot_parameters import (
    LOOP_RATE_PARAMETERS,
    MAX_LOOP_RATE,
    MIN_LOOP_RATE,
)
from mavdem.loops.controllers import Controller as AxisController
from mavdem.loops.controllers import controller_from_parameters
from sitl_scenarios import mixers
from sitl_scenarios.controller import FlightController
from sitl_scenarios.gains import PX4_MOMENT_RATIO, control_parameters, reciprocal_frequency
from sitl_scenarios.gyro import Gyro
from sitl_scenarios.motion import Pair
from sitl_scenarios.rotors import CIRCLES, rotor_frame
from sitl_scenarios.scenario import AXES, Scenario
from sitl_scenarios.vectors import Vector4
from sitl_scenarios.vehicles import airframe

ARDUPILOT_PREFIXES = ("ATC_", "MOT_", "SCHED_", "INS_")
"""Beginnings of names of parameters that only ArduPilot has."""

PX4_PREFIXES = ("MC_", "THR_MDL", "IMU_", "CA_")
"""Beginnings of names of parameters that only PX4 has."""

MAX_PARAMETER = 1e4
"""Largest value of gains and cut-offs (Hz): more than any autopilot takes."""

MIN_THRUST = 1e-9
"""Smallest normalised thrust under the root of the inverse thrust curve.

With a purely quadratic curve and a thrust of 0, the denominator would be zero.
"""


def check_parameters(scenario: Scenario) -> None:
    """Checks a scenario's ``vehicle.parameters``: each name, each value, and that together they describe a controller.

    Args:
        scenario: Scenario of a simulated flight: vehicle, wind, excitation, sensors and faults.

    Raises:
        ValueError: The simulated controller does not use a parameter, or its value is out of range.
    """
    autopilot = scenario.stream.autopilot
    other_prefixes = ARDUPILOT_PREFIXES if autopilot == "px4" else PX4_PREFIXES
    for name, value in scenario.vehicle.parameters.items():
        if name.startswith(other_prefixes) or not CONTROL_PARAMETERS.match(name):
            raise ValueError(f"vehicle.parameters.{name} is not flown by {autopilot} here")
        low, high = _parameter_range(name, LOOP_RATE_PARAMETERS[autopilot])
        # Positions of rotors may be negative.
        if not low <= value <= high and not name.startswith("CA_"):
            raise ValueError(
                f"vehicle.parameters.{name} must be from {low:g} to {high:g}, not {value:g}"
            )
    # This raises an error if the parameters together do not describe a controller.
    controller_for(scenario)


def _parameter_range(name: str, loop_rate_parameter: str) -> Pair:
    """Returns the smallest and the largest possible value of a parameter, in its own unit."""
    if name == loop_rate_parameter:
        return MIN_LOOP_RATE, MAX_LOOP_RATE
    if "_SPIN_" in name:
        return 0.0, 1.0
    return 0.0, MAX_PARAMETER


def controller_for(scenario: Scenario) -> FlightController:
    """Chooses the controller of a scenario: the simulation's own, or the autopilot's by its parameters.

    The autopilot's controller is used if the scenario sets parameters, simulates instruments or has more than four
    rotors.

    Args:
        scenario: Scenario of a simulated flight: vehicle, wind, excitation, sensors and faults.

    Returns:
        A new controller.

    Raises:
        NotLearnable: The parameters do not describe a controller.
    """
    # The simulation's own mixer is for sound quadrotors: no autopilot responds to a failed motor as it does.
    is_autopilots = scenario.has_instruments or scenario.vehicle.layout in CIRCLES
    if scenario.vehicle.parameters or is_autopilots:
        return ParameterController(scenario)
    return FlightController(scenario)


def gyro_for(controller: FlightController) -> Gyro:
    """Makes a gyro at rest, with the low-pass and notch filters of a controller's parameters.

    Args:
        controller: The controller; the simulation's own has no gyro filters.

    Returns:
        The gyro.
    """
    filters = None
    if isinstance(controller, ParameterController):
        # The filters of the gyro are the same for all axes.
        filters = controller.axis_controllers[0]
    return Gyro(filters, controller.cycle)


class ParameterController(FlightController):
    """Flight controller by an autopilot's parameters; position and velocity control are the simulation's own.

    ``axis_controllers`` holds the rate and attitude controllers of roll, pitch and yaw.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Reads the controllers of the three axes from the scenario's parameters.

        Position and velocity loops are tuned to the attitude gains among the parameters.

        Args:
            scenario: Scenario with the vehicle, the autopilot and ``vehicle.parameters``. Parameters that it leaves out
                have values that suit the vehicle.

        Raises:
            NotLearnable: The parameters do not make a controller.
        """
        parameters = control_parameters(scenario)
        vehicle = scenario.vehicle
        frame = rotor_frame(vehicle.layout, airframe(vehicle).arm)
        is_px4 = scenario.stream.autopilot == "px4"
        is_quadrotor = vehicle.layout not in CIRCLES
        mixer_columns = (frame.roll, frame.pitch, frame.yaw)
        if is_px4:
            # PX4's mixer follows from the rotors' positions among its parameters, which an empty column stands for.
            mixer_columns = ((), (), ())
        if not is_quadrotor:
            # A controller of the rates alone, with the demand in the place of the motors.
            mixer_columns = ((1.0,), (1.0,), (1.0,))
        self.axis_controllers = [
            controller_from_parameters(parameters, axis, column)
            for axis, column in zip(AXES, mixer_columns, strict=True)
        ]
        super().__init__(scenario)
        self._set_attitude_gains(tuple(axis.angle_gain for axis in self.axis_controllers))
        self._mixed_thrusts = mixers.px4_thrusts if is_px4 else mixers.ardupilot_thrusts
        self._thrust_expo = self.axis_controllers[0].thrust_expo
        self._range_start, self._range_end = self.axis_controllers[0].spin_range
        if is_quadrotor:
            self._mixer_columns = np.array([axis.mixer for axis in self.axis_controllers])
        elif is_px4:
            self._mixer_columns = mixers.px4_columns(frame, PX4_MOMENT_RATIO)
        else:
            self._mixer_columns = mixers.ardupilot_columns(frame)
            self._range_start = parameters["MOT_SPIN_MIN"]
            self._range_end = parameters["MOT_SPIN_MAX"]

    def reset(self) -> None:
        """Resets integrators, filters and the heading's setpoint, as on the ground."""
        super().reset()
        self._rate_loops = [RateLoop(axis) for axis in self.axis_controllers]

    def rate_demand(self, axis: int, setpoint: float, rate: float, *, is_flying: bool) -> float:
        """Runs the rate loop of one axis for one cycle.

        Args:
            axis: 0 for roll, 1 for pitch, 2 for yaw.
            setpoint: Setpoint of the body rate, rad/s.
            rate: Body rate after the gyro's filters, rad/s.
            is_flying: Whether the vehicle is off the ground; nothing is integrated otherwise.

        Returns:
            Demand of the axis to the mixer, −1 to 1, as a fraction of the largest demand.
        """
        return self._rate_loops[axis].demand(setpoint, rate, is_flying=is_flying)

    def motor_commands(self, demands: Vector4) -> Vector4:
        """Mixes demands as the autopilot does, and converts the thrusts into commands of the motors.

        The autopilots model a motor's thrust T at the fraction s of its range as T = (1 − f) s + f s², with the expo f
        = MOT_THST_EXPO or THR_MDL_FAC. Its inverse is the positive root of that quadratic, in the form that also holds
        for f = 0:

            s = 2 T / (1 − f + √((1 − f)² + 4 f T))

        Args:
            demands: (4,) demands of roll, pitch and yaw, −1 to 1, and the collective command, 0 to 1.

        Returns:
            Normalised command of each motor (n,), from the start to the end of the motors' range.
        """
        roll, pitch, yaw, collective_command = demands
        collective_thrust = self._thrust_of_command(collective_command)
        thrusts = self._mixed_thrusts(self._mixer_columns, (roll, pitch, yaw, collective_thrust))
        f = self._thrust_expo
        motor_range = self._range_end - self._range_start
        commands = []
        # Floats are used, since NumPy's calls on such small arrays take several times as long.
        for thrust in thrusts.tolist():
            discriminant = (1 - f) ** 2 + 4 * f * max(thrust, MIN_THRUST)
            denominator = 1 - f + sqrt(discriminant)
            commands.append(self._range_start + 2 * motor_range * thrust / denominator)
        return tuple(commands)

    def _thrust_of_command(self, command: float) -> float:
        """Returns the normalised thrust of a normalised command, by the autopilot's thrust curve."""
        range_fraction = (command - self._range_start) / (self._range_end - self._range_start)
        s = min(max(range_fraction, 0.0), 1.0)
        return (1 - self._thrust_expo) * s + self._thrust_expo * s * s


class RateLoop:
    """Rate controller of one axis, as ArduPilot's ``AC_PID`` and PX4's ``RateControl`` have it, without limits.

    It is a PID controller with feed-forward of the target. ArduPilot has first-order filters of target, error and
    derivative, and PX4 of derivative and yaw's output; filters that are switched off pass everything.
    """

    def __init__(self, controller: AxisController) -> None:
        """Converts the cut-offs of the filters into smoothing factors, and begins at rest.

        Args:
            controller: Gains, cut-offs (Hz) and loop period (s) of one axis.
        """
        self._controller = controller
        self._target_smoothing = self._smoothing(controller.target_filter)
        self._error_smoothing = self._smoothing(controller.error_filter)
        self._derivative_smoothing = self._smoothing(controller.derivative_filter)
        self._output_smoothing = self._smoothing(controller.output_filter)
        # States: filtered target and error, rad/s; filtered derivative, rad/s²; integral of the error, rad; filtered
        # demand to the mixer; and the measured rate of the cycle before, rad/s.
        self._target = 0.0
        self._error = 0.0
        self._derivative = 0.0
        self._integral = 0.0
        self._output = 0.0
        self._previous_rate = 0.0

    def _smoothing(self, cutoff: float) -> float:
        """Returns a filter's factor per cycle, dt / (dt + RC), for a cut-off in Hz; 1 where it is switched off."""
        period = self._controller.loop_period
        return period / (period + reciprocal_frequency(cutoff))

    def demand(self, setpoint: float, rate: float, *, is_flying: bool) -> float:
        """Runs the loop for one cycle: filters, PID with feed-forward, and the filter of the output.

        Args:
            setpoint: Setpoint of the body rate, rad/s.
            rate: Body rate after the gyro's filters, rad/s.
            is_flying: Whether the vehicle is off the ground; nothing is integrated otherwise.

        Returns:
            Demand to the mixer as a fraction of the largest demand, not limited to ±1.
        """
        controller = self._controller
        previous_error = self._error
        previous_integral = self._integral
        self._target += self._target_smoothing * (setpoint - self._target)
        self._error += self._error_smoothing * (self._target - rate - self._error)
        # ArduPilot differentiates the error, PX4 the measured rate.
        if controller.derivative_of_error:
            increment = self._error - previous_error
        else:
            increment = self._previous_rate - rate
        derivative_error = increment / controller.loop_period - self._derivative
        self._derivative = self._derivative + self._derivative_smoothing * derivative_error
        self._previous_rate = rate
        if is_flying:
            self._integral += controller.loop_period * self._error
        # ArduPilot uses the integral of this cycle; PX4 integrates the error after the integral has been used.
        integral = self._integral if controller.derivative_of_error else previous_integral
        proportional_term = controller.p * self._error
        integral_term = controller.i * integral
        derivative_term = controller.d * self._derivative
        feedforward_term = controller.ff * self._target
        demand = proportional_term + integral_term + derivative_term + feedforward_term
        self._output += self._output_smoothing * (demand - self._output)
        return self._output
