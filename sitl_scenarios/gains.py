"""Gains as the autopilots' parameters: those of the simulation's own controller, and a controller that flies any.

Parameters act as ``mavdem.loops.controllers`` has them: filters once a cycle of its loop, and between the rate
loop's demand and the motors the autopilot's mixer, thrust curve and range.
"""

from collections.abc import Sequence
from math import fsum, pi, sqrt

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
from sitl_scenarios.controller import LEAD, FlightController, LoopGains
from sitl_scenarios.dynamics import IDLE_COMMAND, SPINS, Four, frame, steps_of
from sitl_scenarios.gyro import Gyro
from sitl_scenarios.motion import Pair
from sitl_scenarios.scenario import AXES, Scenario, VehicleSpec
from sitl_scenarios.vehicles import airframe


def check_parameters(scenario: Scenario) -> None:
    """Raises ValueError: ``vehicle.parameters`` has one that is not flown, or a value that no autopilot has."""
    given = scenario.vehicle.parameters
    loop = LOOP_RATE_PARAMETERS[scenario.stream.autopilot]
    foreign = (
        ("ATC_", "MOT_", "SCHED_", "INS_")
        if scenario.stream.autopilot == "px4"
        else ("MC_", "THR_MDL", "IMU_", "CA_")
    )
    for name, value in given.items():
        if name.startswith(foreign) or not CONTROL_PARAMETERS.match(name):
            raise ValueError(
                f"vehicle.parameters.{name} is not flown by {scenario.stream.autopilot} here"
            )
        low, high = (
            (MIN_LOOP_RATE, MAX_LOOP_RATE)
            if name == loop
            else (0.0, 1.0)
            if "_SPIN_" in name
            else (0.0, 1e4)
        )
        if not low <= value <= high and not name.startswith("CA_"):
            raise ValueError(
                f"vehicle.parameters.{name} must be from {low:g} to {high:g}, not {value:g}"
            )
    controller_for(scenario)


def parameters_of(scenario: Scenario) -> dict[str, float]:
    """Returns the parameters of control: those that suit the vehicle, and what ``vehicle.parameters`` says instead."""
    kind = scenario.stream.autopilot
    parameters_for = _px4 if kind == "px4" else _ardupilot
    own = parameters_for(scenario.vehicle, FlightController(scenario).gains)
    if "RATE_RLL_P" in scenario.vehicle.parameters:  # as gains were called before ArduCopter 3.4
        own = {name: value for name, value in own.items() if not name.startswith("ATC_")}
    return (
        own | {LOOP_RATE_PARAMETERS[kind]: round(1 / scenario.cycle)} | scenario.vehicle.parameters
    )


def controller_for(scenario: Scenario) -> FlightController:
    """Returns the controller of a scenario: of its parameters, where it has any; raises NotLearnable: they are none."""
    if scenario.vehicle.parameters:
        return SetController(scenario)
    return FlightController(scenario)


def gyro_for(controller: FlightController) -> Gyro:
    """Returns the gyro of a ``controller``, stepped as the physics in its cycle; its own one has no filters."""
    roll = controller.axes[0] if isinstance(controller, SetController) else None
    return Gyro(roll, controller.cycle / steps_of(controller.cycle))


class SetController(FlightController):
    """Flies an autopilot's parameters; position and velocity control are the simulation's own."""

    def __init__(self, scenario: Scenario) -> None:
        parameters = parameters_of(scenario)
        vehicle = scenario.vehicle
        columns = frame(vehicle.layout, airframe(vehicle).arm)[2:]
        is_px4 = scenario.stream.autopilot == "px4"
        self.axes = axes = [
            controller_from_parameters(parameters, axis, () if is_px4 else column)
            for axis, column in zip(AXES, columns, strict=True)
        ]
        super().__init__(scenario)
        self._within(tuple(axis.angle_gain for axis in axes))
        self._columns = np.array([axis.mixer for axis in axes])
        self._mix = mixers.px4 if is_px4 else mixers.ardupilot
        self._expo = axes[0].thrust_expo
        (self._begin, self._end) = axes[0].spin_range

    def rest(self) -> None:
        """Resets the integrators and filters, as on the ground."""
        super().rest()
        self._loops = [_RateLoop(axis) for axis in self.axes]

    def demand(self, axis: int, wanted: float, rate: float, flying: bool) -> float:
        """Returns what the rate loop asks the mixer for about an axis, for a rate ``wanted``, rad/s; once a cycle."""
        return self._loops[axis].demand(wanted, rate, flying)

    def mixed(self, demands: Four) -> Four:
        """Returns normalised commands: thrusts by the mixer, and the autopilot's curve and range for them."""
        *turning, command = demands
        thrusts = self._mix(self._columns, (*turning, self._thrust(command)))
        f = self._expo
        squared = (1 - f) ** 2 + 4 * f * thrusts.clip(1e-9)
        root = 1 - f + np.sqrt(squared)
        span = self._end - self._begin
        commands = self._begin + 2 * span * thrusts / root
        return tuple(commands.tolist())

    def _thrust(self, command: float) -> float:
        within_range = (command - self._begin) / (self._end - self._begin)
        share = min(max(within_range, 0.0), 1.0)
        return (1 - self._expo) * share + self._expo * share * share


def _time(cutoff: float) -> float:
    """Of a first-order filter, s, by its cut-off, Hz, and likewise back; 0 where there is none."""
    if cutoff:
        return 1 / (2 * pi * cutoff)
    return 0.0


class _RateLoop:
    """One axis's rate controller as ``AC_PID`` of ArduPilot and ``RateControl`` of PX4 have it, without limits."""

    def __init__(self, of: AxisController) -> None:
        self.of = of
        filters = (of.target_filter, of.error_filter, of.derivative_filter, of.output_filter)
        self._shares = [of.loop_period / (of.loop_period + _time(cutoff)) for cutoff in filters]
        self._target = self._error = self._slope = self._output = self._trim = self._rate = 0.0

    def demand(self, wanted: float, rate: float, flying: bool) -> float:
        """The demand of one cycle for a rate ``wanted``, rad/s; nothing is integrated unless ``flying``."""
        of = self.of
        (target, error, slope, output) = self._shares
        before = self._error
        late = self._trim
        self._target += target * (wanted - self._target)
        self._error += error * (self._target - rate - self._error)
        step = self._rate - rate
        if of.derivative_of_error:
            step = self._error - before
        change = step / of.loop_period - self._slope
        self._slope = self._slope + slope * change
        self._rate = rate
        if flying:
            self._trim += of.loop_period * self._error
        # PX4 integrates the error after it has been used.
        trim = self._trim if of.derivative_of_error else late
        of_error = of.p * self._error
        of_trim = of.i * trim
        of_slope = of.d * self._slope
        of_target = of.ff * self._target
        asked = of_error + of_trim + of_slope + of_target
        self._output += output * (asked - self._output)
        return self._output


def _slope_in_hover(vehicle: VehicleSpec, low: float) -> Pair:
    """The thrust's quadratic share, and output per thrust where a range from ``low`` to 1 undoes it."""
    share = vehicle.quadratic_thrust or 0.0
    body = airframe(vehicle)
    command = body.command_for(body.hover_speed) / body.full
    hover = (command - low) / (1.0 - low)
    slope = 1.0 - share + 2 * share * hover
    return share, (1.0 - low) / slope


def _px4(vehicle: VehicleSpec, gains: Sequence[LoopGains]) -> dict[str, float]:
    """Gains of a normalised torque.

    A torque of 1 adds the column of the mixer's pseudo-inverse to the motors, normalised as in PX4's
    ControlAllocationPseudoInverse.cpp: roll and pitch both by the larger of their norms, yaw by its largest.
    """
    rotors = frame(vehicle.layout, airframe(vehicle).arm)
    (share, slope) = _slope_in_hover(vehicle, 0.0)
    arms = (rotors.right, rotors.forward)
    norms = [sqrt(fsum(part * part for part in arm)) for arm in arms]
    scale = max(
        sqrt(2 / sum(part != 0 for part in arm)) / norm
        for arm, norm in zip(arms, norms, strict=True)
    )
    units = [slope * max(arm) / norm**2 / scale for arm, norm in zip(arms, norms, strict=True)]
    units.append(slope)
    lag = gains[0].derivative_lag
    values = {"THR_MDL_FAC": share, "IMU_GYRO_CUTOFF": 0.0, "IMU_DGYRO_CUTOFF": _time(lag)}
    for name, triple, unit in zip(("ROLL", "PITCH", "YAW"), gains, units, strict=True):
        values |= {
            f"MC_{name}RATE_{letter}": gain / unit
            for letter, gain in zip("PID", triple, strict=False)
        }
        values |= {f"MC_{name}RATE_K": 1.0, f"MC_{name}RATE_FF": 0.0, f"MC_{name}_P": triple.angle}
    for n, spin in enumerate(SPINS):
        values |= {
            f"CA_ROTOR{n}_PX": rotors.forward[n],
            f"CA_ROTOR{n}_PY": rotors.right[n],
            f"CA_ROTOR{n}_PZ": 0.0,
            f"CA_ROTOR{n}_CT": 6.5,
            f"CA_ROTOR{n}_KM": 0.05 * spin,  # positive counter-clockwise
        }
    return values | {"MC_YAW_TQ_CUTOFF": 0.0, "CA_AIRFRAME": 0, "CA_ROTOR_COUNT": len(SPINS)}


def _ardupilot(vehicle: VehicleSpec, gains: Sequence[LoopGains]) -> dict[str, float]:
    """Gains of shares of the motors' range, of which the mixer gives a half to each motor.

    ArduPilot's derivative is of the error. The filter of the target makes up for it: (1 + LEAD τs)/(1 + τs) behind
    1/(1 + LEAD τs) leaves 1/(1 + τs) of the setpoint.
    """
    share, slope = _slope_in_hover(vehicle, IDLE_COMMAND)
    values = {
        "MOT_THST_EXPO": share,
        "MOT_SPIN_ARM": IDLE_COMMAND,
        "MOT_SPIN_MIN": IDLE_COMMAND,
        "MOT_SPIN_MAX": 1.0,
    }
    for name, triple in zip(("RLL", "PIT", "YAW"), gains, strict=True):
        values |= {
            f"ATC_RAT_{name}_{letter}": 2 * gain / slope
            for letter, gain in zip("PID", triple, strict=False)
        }
        cutoff = _time(triple.derivative_lag)
        filters = {
            "FLTT": cutoff / LEAD,
            "FLTE": 0.0,
            "FLTD": cutoff,
            "FF": 0.0,
            "IMAX": 1.0,
            "SMAX": 0.0,
        }
        values |= {f"ATC_RAT_{name}_{key}": value for key, value in filters.items()}
        values[f"ATC_ANG_{name}_P"] = triple.angle
    return values | {"INS_GYRO_FILTER": 0, "FRAME_CLASS": 1}
