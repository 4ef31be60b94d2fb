"""Gains of the simulation's own controller, written as control parameters of ArduPilot or PX4.

The simulated autopilot reports these parameters, and a scenario may replace any of them. Their meaning is that of
``mavdem.loops.controllers``.
"""

from collections.abc import Sequence
from math import fsum, pi, sqrt
from typing import NamedTuple

from mavdem.loops.autopilot_parameters import LOOP_RATE_PARAMETERS
from sitl_scenarios.controller import LEAD, FlightController, LoopGains
from sitl_scenarios.rotors import IDLE_COMMAND, SPIN_DIRECTIONS, rotor_frame
from sitl_scenarios.scenario import Scenario, VehicleSpec
from sitl_scenarios.vectors import Vector4
from sitl_scenarios.vehicles import airframe

PX4_THRUST_COEFFICIENT = 6.5
"""CA_ROTORn_CT of each rotor: PX4's default."""

PX4_MOMENT_RATIO = 0.05
"""Size of CA_ROTORn_KM of each rotor: PX4's default."""


def control_parameters(scenario: Scenario) -> dict[str, float]:
    """Returns the parameters of rate and attitude control that the scenario's autopilot flies, by name.

    They are those that give the gains of the simulation's own controller, and in their place whatever the scenario's
    ``vehicle.parameters`` sets.
    """
    autopilot = scenario.stream.autopilot
    gains = FlightController(scenario).gains
    if autopilot == "px4":
        parameters = _px4_parameters(scenario.vehicle, gains)
    else:
        parameters = _ardupilot_parameters(scenario.vehicle, gains)
    replaced = scenario.vehicle.parameters
    # Before ArduCopter 3.4 gains had other names, without ATC_: no log has both.
    if "RATE_RLL_P" in replaced:
        parameters = {
            name: value for name, value in parameters.items() if not name.startswith("ATC_")
        }
    loop_rate = {LOOP_RATE_PARAMETERS[autopilot]: round(1 / scenario.cycle)}
    return parameters | loop_rate | replaced


def reciprocal_frequency(value: float) -> float:
    """Converts the cut-off of a first-order filter, Hz, into its time constant, s, and the other way round.

    Both are 1/(2π x). A value of 0 stands for a filter that is switched off, and gives 0.
    """
    if value:
        return 1 / (2 * pi * value)
    return 0.0


class HoverThrust(NamedTuple):
    """Thrust curve of a vehicle and its slope in hover."""

    expo: float
    """Quadratic fraction of the thrust curve: MOT_THST_EXPO or THR_MDL_FAC."""
    command_per_thrust: float
    """Change of a motor's normalised command per change of its normalised thrust, in hover."""


def _hover_thrust(vehicle: VehicleSpec, range_start: float) -> HoverThrust:
    """Returns the thrust curve of a vehicle whose mixer puts out thrusts from 0 to 1.

    The thrust at a fraction s of the motors' range is (1 − f) s + f s²; its slope is 1 − f + 2 f s.

    Args:
        vehicle: Vehicle of a scenario.
        range_start: Normalised command at which the motors' range begins; it ends at 1.
    """
    expo = vehicle.quadratic_thrust or 0.0
    body = airframe(vehicle)
    command = body.command_for(body.hover_speed) / body.full_command
    range_fraction = (command - range_start) / (1.0 - range_start)
    thrust_slope = 1.0 - expo + 2 * expo * range_fraction
    return HoverThrust(expo, (1.0 - range_start) / thrust_slope)


def _px4_parameters(vehicle: VehicleSpec, gains: Sequence[LoopGains]) -> dict[str, float]:
    """Returns PX4's parameters of rate and attitude control, and the geometry of its rotors.

    PX4's rate controllers put out normalised torques. A torque of 1 adds a column of the mixer to the motors: a column
    of the effectiveness matrix's pseudo-inverse, normalised as in ControlAllocationPseudoInverse.cpp: roll and pitch
    both by the larger of their norms, yaw by its largest element.

    Args:
        vehicle: Vehicle of a scenario.
        gains: Gains of roll, pitch and yaw by demands to the simulation's own mixer.
    """
    frame = rotor_frame(vehicle.layout, airframe(vehicle).arm)
    expo, command_per_thrust = _hover_thrust(vehicle, 0.0)
    lag = gains[0].derivative_lag
    parameters = {
        "THR_MDL_FAC": expo,
        "IMU_GYRO_CUTOFF": 0.0,
        "IMU_DGYRO_CUTOFF": reciprocal_frequency(lag),
    }
    # Demand to the simulation's own mixer that has the effect of a normalised torque of 1.
    demands_per_torque = [
        command_per_thrust * factor for factor in _tilt_mixer_factors(frame.right, frame.forward)
    ]
    demands_per_torque.append(command_per_thrust)
    names = ("ROLL", "PITCH", "YAW")
    for name, axis_gains, demand_per_torque in zip(names, gains, demands_per_torque, strict=True):
        parameters |= {
            f"MC_{name}RATE_P": axis_gains.p / demand_per_torque,
            f"MC_{name}RATE_I": axis_gains.i / demand_per_torque,
            f"MC_{name}RATE_D": axis_gains.d / demand_per_torque,
            f"MC_{name}RATE_K": 1.0,
            f"MC_{name}RATE_FF": 0.0,
            f"MC_{name}_P": axis_gains.angle,
        }
    for rotor, spin_direction in enumerate(SPIN_DIRECTIONS):
        parameters |= {
            f"CA_ROTOR{rotor}_PX": frame.forward[rotor],
            f"CA_ROTOR{rotor}_PY": frame.right[rotor],
            f"CA_ROTOR{rotor}_PZ": 0.0,
            f"CA_ROTOR{rotor}_CT": PX4_THRUST_COEFFICIENT,
            # Its sign is positive for a rotor that turns counter-clockwise.
            f"CA_ROTOR{rotor}_KM": PX4_MOMENT_RATIO * spin_direction,
        }
    rotor_count = len(SPIN_DIRECTIONS)
    return parameters | {"MC_YAW_TQ_CUTOFF": 0.0, "CA_AIRFRAME": 0, "CA_ROTOR_COUNT": rotor_count}


def _tilt_mixer_factors(right: Vector4, forward: Vector4) -> list[float]:
    """Returns the largest element of PX4's normalised mixer columns of roll and of pitch.

    The column of an axis is its lever arms over their squared norm. PX4 scales both axes alike, so that the larger
    column has a norm of √(n/2), n being the number of motors that it moves.

    Args:
        right: Positions of the rotors to the right, m: the lever arms of roll.
        forward: Positions of the rotors forward, m: the lever arms of pitch.
    """
    lever_arms = (right, forward)
    norms = [sqrt(fsum(arm * arm for arm in arms)) for arms in lever_arms]
    scales = []
    for arms, norm in zip(lever_arms, norms, strict=True):
        moved_motors = len([arm for arm in arms if arm != 0])
        scales.append(sqrt(2 / moved_motors) / norm)
    scale = max(scales)
    return [max(arms) / norm**2 / scale for arms, norm in zip(lever_arms, norms, strict=True)]


def _ardupilot_parameters(vehicle: VehicleSpec, gains: Sequence[LoopGains]) -> dict[str, float]:
    """Returns ArduPilot's parameters of rate and attitude control.

    ArduPilot's rate controllers put out fractions of the motors' range, of which its mixer gives a half to each motor.
    Its derivative is of the error, while that of the simulation's controller is of the measured rate. The filter of
    the target makes up for it: (1 + LEAD τs)/(1 + τs) behind 1/(1 + LEAD τs) leaves 1/(1 + τs) of the setpoint.

    Args:
        vehicle: Vehicle of a scenario.
        gains: Gains of roll, pitch and yaw by demands to the simulation's own mixer.
    """
    expo, command_per_thrust = _hover_thrust(vehicle, IDLE_COMMAND)
    parameters = {
        "MOT_THST_EXPO": expo,
        "MOT_SPIN_ARM": IDLE_COMMAND,
        "MOT_SPIN_MIN": IDLE_COMMAND,
        "MOT_SPIN_MAX": 1.0,
    }
    for name, axis_gains in zip(("RLL", "PIT", "YAW"), gains, strict=True):
        cutoff = reciprocal_frequency(axis_gains.derivative_lag)
        parameters |= {
            f"ATC_RAT_{name}_P": 2 * axis_gains.p / command_per_thrust,
            f"ATC_RAT_{name}_I": 2 * axis_gains.i / command_per_thrust,
            f"ATC_RAT_{name}_D": 2 * axis_gains.d / command_per_thrust,
            f"ATC_RAT_{name}_FLTT": cutoff / LEAD,
            f"ATC_RAT_{name}_FLTE": 0.0,
            f"ATC_RAT_{name}_FLTD": cutoff,
            f"ATC_RAT_{name}_FF": 0.0,
            f"ATC_RAT_{name}_IMAX": 1.0,
            f"ATC_RAT_{name}_SMAX": 0.0,
            f"ATC_ANG_{name}_P": axis_gains.angle,
        }
    return parameters | {"INS_GYRO_FILTER": 0, "FRAME_CLASS": 1}
