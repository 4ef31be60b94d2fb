"""An autopilot's rate and attitude controller of one axis with its mixer, read from the parameters of ArduPilot or PX4.

The rate controller is a PID controller with feed-forward, run once a loop period. Its output is the *demand*, a torque
of which 1 is the most that the mixer takes. The attitude controller is proportional: its output is the rate's setpoint.
``margins.controller_response`` has the frequency responses. How parameters become these fields is in
``ardupilot_controller`` and ``px4_controller``, with the autopilots' source files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.containers import Numbers
from mavdem.dem.engine.model import scalar_recursion
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts
from mavdem.facts.loops import ControllerFact
from mavdem.immutable import ImmutableResult
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import CONTROL_PARAMETERS
from mavdem.loops.ardupilot_controller import (
    GYRO_NOTCH_PREFIXES,
    NotchMode,
    ardupilot_controller,
    ardupilot_gain_names,
)
from mavdem.loops.autopilot_parameters import MIN_LOOP_RATE, GainNames, Notch
from mavdem.loops.px4_controller import px4_controller, px4_gain_names
from mavdem.plant.closed_loop.parameters import TYPICAL_VALUES

ARDUPILOT_GAIN_PREFIXES = ("ATC_RAT_", "RATE_RLL_")
"""Beginnings of ArduPilot's rate gains, since ArduCopter 3.4 and before, by which the autopilot is recognised."""
PX4_GAIN_PREFIXES = ("MC_",)
"""The same of PX4's parameters."""

MAX_GAIN = 1e3
"""Largest possible gain, in the units of :class:`Controller`."""
MIN_ANGLE_GAIN = 1e-3
"""Smallest possible gain of the attitude controller, 1/s: it is divided by."""
MAX_CUTOFF = 1e4
"""Largest possible cut-off of a low-pass filter, Hz."""
MIN_CUTOFF = 0.1
"""Smallest possible cut-off of a low-pass filter, Hz; 0 switches the filter off."""
MIN_LOOP_PERIOD = 1e-5
"""Shortest possible loop period, s."""
POSSIBLE_RANGES = {
    "p": (0.0, MAX_GAIN),
    "i": (0.0, MAX_GAIN),
    "d": (0.0, MAX_GAIN),
    "ff": (0.0, MAX_GAIN),
    "angle_gain": (MIN_ANGLE_GAIN, MAX_GAIN),
    "target_filter": (0.0, MAX_CUTOFF),
    "error_filter": (0.0, MAX_CUTOFF),
    "derivative_filter": (0.0, MAX_CUTOFF),
    "output_filter": (0.0, MAX_CUTOFF),
    "gyro_filter": (0.0, MAX_CUTOFF),
    "loop_period": (MIN_LOOP_PERIOD, 1 / MIN_LOOP_RATE),
    "thrust_expo": (-1.0, 1.0),
}
"""Least and greatest possible value of fields of a :class:`Controller`: others are corrupt parameters."""

TYPICAL_ROTOR_LAG = TYPICAL_VALUES["lag"]
"""Time constant of common rotors' speeds, s."""
ROTOR_LAG_CORRECTION = 0.5
"""Fraction of the correction for lagging rotor speeds that is applied.

With the whole of it, control effectiveness of motors at limits came out as much too small as it is too large with none,
on half of the flights of ``tools/validation/loops.py``. Why it is half is not known.
"""
MIN_THRUST_SLOPE = 0.1
"""Least slope of the normalised thrust curve, relative to a straight one's: a flat curve would divide by 0."""
LIMIT_TOLERANCE = 0.005
"""Fraction of the output's range within which a motor counts as at its limit."""

UNMODELLED_PARAMETERS = {
    "SMAX": ControllerFact.SLEW_LIMITED,
    "PDMX": ControllerFact.SUM_LIMITED,
    "FSTRATE_ENABLE": ControllerFact.RATE_LOOP_FASTER,
    "MOT_BAT_VOLT_MAX": ControllerFact.MIXER_BY_VOLTAGE,
    "MC_BAT_SCALE_EN": ControllerFact.DEMAND_BY_VOLTAGE,
    "IMU_GYRO_DNF_EN": ControllerFact.NOTCHES_UNMODELLED,
}
"""Parameters that enable something that is not modelled if they are not 0, each with its caution.

A name without an underscore is the ending of a parameter that each axis has, as in ``ATC_RAT_RLL_SMAX``.
"""


class GyroPath(NamedTuple):
    """All of a controller that the frequency response of the plant depends on: controllers with the same share it."""

    low_pass: float
    """Cut-off of the gyro's low-pass, Hz."""
    notches: tuple[Notch, ...]
    """Notch filters of the gyro."""
    filter_rate: float
    """Rate at which the filters run, Hz."""
    loop_period: float
    """Time between two runs of the rate controller, s."""


@dataclass(frozen=True, kw_only=True)
class Controller(ImmutableResult):
    """The rate and the attitude controller of one axis, with the axis' column of the mixer.

    Cut-offs of filters are in Hz, 0 if there is no filter. Low-passes named ``target_``, ``error_``, ``derivative_``
    and ``output_filter`` are of first order.

    Raises:
        NotLearnable: a field is outside ``POSSIBLE_RANGES``.
    """

    axis: str
    """"roll", "pitch" or "yaw"."""
    p: float
    """Proportional gain, demand per rad/s of the rate's error."""
    i: float
    """Integral gain, demand per rad."""
    d: float
    """Derivative gain, demand per rad/s²."""
    ff: float
    """Feed-forward gain, demand per rad/s of the rate's setpoint."""
    derivative_ff: float = 0.0
    """Feed-forward gain, demand per rad/s² of the rate's setpoint (ArduPilot's ``D_FF``)."""
    angle_gain: float
    """Gain of the attitude controller: rate setpoint per error of the angle, 1/s."""
    target_filter: float = 0.0
    """Low-pass of the rate's setpoint (ArduPilot's ``FLTT``)."""
    error_filter: float = 0.0
    """Low-pass of the rate's error (ArduPilot's ``FLTE``)."""
    derivative_filter: float = 0.0
    """Low-pass of the derivative (ArduPilot's ``FLTD``, PX4's ``IMU_DGYRO_CUTOFF``)."""
    output_filter: float = 0.0
    """Low-pass of the demand (PX4's ``MC_YAW_TQ_CUTOFF``)."""
    target_notches: tuple[Notch, ...] = ()
    """Notch filters of the rate's setpoint, before its low-pass."""
    error_notches: tuple[Notch, ...] = ()
    """Notch filters of the rate's error, before its low-pass."""
    gyro_filter: float
    """Second-order low-pass of the gyro. Rates are controlled and logged after it and the ``notches``."""
    notches: tuple[Notch, ...] = ()
    """Notch filters of the gyro."""
    gyro_rate: float = 1000.0
    """Rate at which the gyro's filters run, Hz."""
    derivative_of_error: bool
    """Whether D acts on the rate's error, as ArduPilot has it, or on the rate alone, as PX4 has it."""
    loop_period: float
    """Time between two runs of the rate controller, s."""
    mixer: Numbers
    """Thrust that a demand of 1 adds to each motor, as a fraction of its maximum (4,); (1,) for the demand itself."""
    thrust_expo: float
    """Quadratic fraction e of the thrust curve (1 − e) u + e u² that the autopilot compensates."""
    spin_range: tuple[float, float] = (0.0, 1.0)
    """Fractions of the output's range at which thrust begins and ends."""
    parameter_names: Mapping[str, str]
    """Name of the autopilot's parameter by the name of the field that it sets, such as "p" or "angle_gain"."""
    parameters: Parameters
    """All parameters that the controller was made of, by the autopilot's name."""
    motor_weights: Numbers = ()
    """Weights of the motors' thrusts in the torque about the axis (4,), of any scale, for ArduPilot's mixer."""

    def __post_init__(self) -> None:
        """Checks that all fields are within physically possible ranges, since parameters of a log may be corrupt.

        Raises:
            NotLearnable: a field is outside ``POSSIBLE_RANGES``, or the cut-off of a filter is between 0, which
                switches it off, and ``MIN_CUTOFF``.
        """
        super().__post_init__()
        for field, (minimum, maximum) in POSSIBLE_RANGES.items():
            value = getattr(self, field)
            is_too_low = field.endswith("filter") and 0 < value < MIN_CUTOFF
            if is_too_low or not minimum <= value <= maximum:
                name = self.parameter_names.get(field, field.replace("_", " "))
                raise NotLearnable(ControllerFact.PARAMETER_IMPOSSIBLE, name=name, value=value)

    @property
    def gyro_path(self) -> GyroPath:
        """The gyro's filters and the period of the loop."""
        return GyroPath(self.gyro_filter, self.notches, self.gyro_rate, self.loop_period)

    @property
    def is_ardupilot(self) -> bool:
        """Whether the autopilot is ArduPilot, and not PX4."""
        return self.derivative_of_error

    @property
    def cautions(self) -> Facts:
        """Cautions about features of the controller that its parameters switch on and this model lacks.

        They are ``UNMODELLED_PARAMETERS`` that are not 0, and notch filters of the gyro whose frequency follows a
        measurement. Each caution is a fact with the name of the parameter.
        """
        # All parameters of the axis' rate controller begin like its P gain, such as "ATC_RAT_RLL_P", without the P.
        rate_prefix = self.parameter_names["p"].removesuffix("P")
        cautions = []
        for name_or_ending, code in UNMODELLED_PARAMETERS.items():
            # Parameters of the rate controller are listed by the ending of their names, which has no underscore.
            is_whole_name = "_" in name_or_ending
            name = name_or_ending if is_whole_name else rate_prefix + name_or_ending
            if self.parameters.get(name):
                cautions.append(Fact(code, name=name))
        for prefix in GYRO_NOTCH_PREFIXES:
            # In modes above THROTTLE, a notch follows the measured speeds of the motors, or peaks of a spectrum.
            mode_name = f"{prefix}MODE"
            mode = self.parameters.get(mode_name, 0.0)
            if self.parameters.get(f"{prefix}ENABLE") and mode > NotchMode.THROTTLE:
                cautions.append(Fact(ControllerFact.NOTCHES_MOVING, name=mode_name))
        return tuple(cautions)

    def with_parameters(self, parameters: Parameters) -> Controller:
        """Returns this controller with other values of some of the autopilot's parameters.

        Args:
            parameters: new values by the autopilot's name.

        Returns:
            A controller that is built anew from all parameters.

        Raises:
            NotLearnable: a value is impossible.
        """
        new_parameters = {**self.parameters, **_control_parameters(parameters)}
        return _controller_of(new_parameters, self.axis, self.motor_weights)

    def outputs_per_demand(self, outputs: Sequence[float]) -> Numbers:
        """Returns the change of each motor's output per unit of demand about the axis.

        The mixer gives the change dT of each motor's thrust. The thrust curve T(u) = (1 − e) u + e u² is linearised
        about the present outputs, which gives the change of the command: du = dT / (1 − e + 2 e u).

        Args:
            outputs: present outputs of the four motors (4,), as fractions of their range.

        Returns:
            Change of each output per unit of demand (4,), as a fraction of the range.
        """
        spin_min, spin_max = self.spin_range
        thrust_command = self._thrust_command(np.asarray(outputs))
        thrust_slope = 1 - self.thrust_expo + 2 * self.thrust_expo * thrust_command
        output_per_thrust = (spin_max - spin_min) / np.maximum(thrust_slope, MIN_THRUST_SLOPE)
        return tuple((output_per_thrust * self.mixer).tolist())

    def demand_from_outputs(self, outputs: Array, step: float = 0.0) -> Array:
        """Reconstructs the demand of the rate controller from the motors' outputs, up to a constant.

        Thrusts follow from the outputs by the thrust curve that the autopilot compensates, and the demand follows from
        the thrusts by the least-squares inverse of the mixer. With a straight curve, demands about other axes would
        leak into this one.

        In the model of the loop the thrust has a linear lag. In reality the speeds of the rotors lag, and the thrust is
        their square. So if the samples resolve the lag, thrusts are corrected to those that cause the same torque
        through a linear lag.

        Args:
            outputs: outputs of the motors (T, r), as fractions of their range; a single column is the demand itself,
                from 0 to 1.
            step: time between samples, s; 0 if the lag is not to be corrected.

        Returns:
            Demand (T,), in a range as wide as from -1 to 1.
        """
        if outputs.shape[1] == 1:
            # The range of the column is 0 to 1, the range of a demand is -1 to 1, which is twice as wide.
            return 2 * outputs[:, 0]
        thrust_command = self._thrust_command(outputs)
        thrust = (1 - self.thrust_expo + self.thrust_expo * thrust_command) * thrust_command
        if 0 < step < TYPICAL_ROTOR_LAG:
            # With a lag τ dx/dt = y − x of the speed x after its command y, the thrust x² obeys
            # (τ/2) d(x²)/dt = x y − x². Written as a linear lag of thrust, x² follows y² − (y − x)².
            speed_error = _rotor_speed_error(np.sqrt(thrust), step)
            thrust = thrust - ROTOR_LAG_CORRECTION * speed_error**2
        mixer = np.array(self.mixer)
        return thrust @ mixer / (mixer @ mixer)

    def outputs_at_limit(self, outputs: Array, upper_limit: float = 1.0) -> Flags:
        """Returns in which samples at least one motor is at an end of its range, within ``LIMIT_TOLERANCE``.

        Args:
            outputs: outputs of the motors (T, r), as fractions of their range; a single column is the demand itself.
            upper_limit: highest output that the autopilot sets, as a fraction of the range.

        Returns:
            Flags (T,).
        """
        lowest, highest = self.spin_range
        if outputs.shape[1] == 1:
            lowest, highest = 0.0, 1.0
        is_low = outputs <= lowest + LIMIT_TOLERANCE
        is_high = outputs >= min(highest, upper_limit) - LIMIT_TOLERANCE
        return np.asarray((is_low | is_high).any(axis=1))

    def _thrust_command(self, outputs: Array) -> Array:
        """Returns the commands u of the thrust curve: outputs scaled so that thrust begins at 0 and ends at 1.

        Args:
            outputs: outputs of the motors, (T, r) or (r,), as fractions of their range.

        Returns:
            Commands, (T, r) or (r,), 0 to 1.
        """
        spin_min, spin_max = self.spin_range
        return np.clip((outputs - spin_min) / (spin_max - spin_min), 0.0, 1.0)


def controller_from_parameters(
    parameters: Parameters, axis: str = "roll", motor_weights: Sequence[float] = ()
) -> Controller:
    """Builds the controller of one axis that an autopilot's parameters describe.

    The autopilot is recognised by the names of the rate gains: they begin with ``ATC_RAT_`` (before ArduCopter 3.4,
    ``RATE_RLL_``) in ArduPilot, and with ``MC_`` in PX4.

    Args:
        parameters: values by the autopilot's name; only those that match ``CONTROL_PARAMETERS`` are used.
        axis: "roll", "pitch" or "yaw".
        motor_weights: weights (4,) of the motors' thrusts in the torque about the axis, of any scale. They are needed
            for ArduPilot only, since PX4's parameters contain them. A single weight means that the only output is the
            demand itself.

    Returns:
        The controller.

    Raises:
        NotLearnable: a parameter is missing or impossible, or the firmware or the mixer is not known.
    """
    weights = tuple(map(float, motor_weights))
    return _controller_of(_control_parameters(parameters), axis, weights)


def _control_parameters(parameters: Parameters) -> dict[str, float]:
    """Returns the parameters with finite values whose names match ``CONTROL_PARAMETERS``."""
    control_parameters = {}
    for name, value in parameters.items():
        if CONTROL_PARAMETERS.match(name) and isfinite(value):
            control_parameters[name] = float(value)
    return control_parameters


def _controller_of(control_parameters: Parameters, axis: str, weights: Numbers) -> Controller:
    """Builds the controller of one axis from parameters that all match ``CONTROL_PARAMETERS``.

    Args:
        control_parameters: finite values by the autopilot's name.
        axis: "roll", "pitch" or "yaw".
        weights: weights of the motors' thrusts, as :func:`controller_from_parameters` takes them.

    Returns:
        The controller.

    Raises:
        NotLearnable: a parameter is missing or impossible, or the firmware or the mixer is not known.
    """
    if _has_prefix(control_parameters, ARDUPILOT_GAIN_PREFIXES):
        fields = ardupilot_controller(control_parameters, axis, weights)
    elif _has_prefix(control_parameters, PX4_GAIN_PREFIXES):
        fields = px4_controller(control_parameters, axis, is_demand=len(weights) == 1)
    else:
        raise NotLearnable(ControllerFact.NO_GAINS)
    return Controller(axis=axis, parameters=control_parameters, motor_weights=weights, **fields)


def gain_names(parameters: Parameters, axis: str) -> GainNames | None:
    """Returns how the autopilot of a log names the gains of one axis, such as "ATC_RAT_RLL_P" and "ATC_ANG_RLL_P".

    Unlike a :class:`Controller`, the names need no other parameters of the log, such as those of the mixer.

    Args:
        parameters: parameters of the log, by the autopilot's name.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The names; None if the log has neither ArduPilot's nor PX4's gains.
    """
    if _has_prefix(parameters, ARDUPILOT_GAIN_PREFIXES):
        return ardupilot_gain_names(parameters, axis)
    if _has_prefix(parameters, PX4_GAIN_PREFIXES):
        return px4_gain_names(axis)
    return None


def _has_prefix(parameters: Parameters, prefixes: tuple[str, ...]) -> bool:
    """Returns whether the name of any parameter begins with one of some prefixes, such as "MC_ROLL"."""
    return any(name.startswith(prefixes) for name in parameters)


def _rotor_speed_error(speed_commands: Array, step: float) -> Array:
    """Returns the difference of commanded and true rotor speed, with a first-order lag of ``TYPICAL_ROTOR_LAG``.

    With the command y held over a step h, the speed x is x_t = a x_{t−1} + (1 − a) y_{t−1}, a = e^(−h / lag).

    Args:
        speed_commands: commanded speeds (T, r), in any unit. Before the first sample the rotors are in steady state.
        step: time between samples, s.

    Returns:
        Command minus speed (T, r), in the unit of the commands.
    """
    decay = np.exp(-step / TYPICAL_ROTOR_LAG)
    # At the first sample the rotors have their commanded speeds.
    speeds = speed_commands.copy()
    for rotor in range(speeds.shape[1]):
        previous_commands = speed_commands[:-1, rotor]
        first_speed = speed_commands[0, rotor]
        speeds[1:, rotor] = scalar_recursion(decay, (1 - decay) * previous_commands, first_speed)
    return speed_commands - speeds
