"""Gains of the simulated flight controller, written as rate and attitude parameters of ArduPilot or PX4.

The simulated autopilot reports these parameters, and a scenario may replace any of them. ``mavdem.loops.controllers``
explains their meaning.
"""

from collections.abc import Sequence
from math import fsum, pi, sqrt
from typing import NamedTuple

from mavdem.loops.autopilot_parameters import LOOP_RATE_PARAMETERS
from sitl_scenarios.controller import LEAD, FlightController, LoopGains
from sitl_scenarios.rotors import CIRCLES, IDLE_COMMAND, rotor_frame
from sitl_scenarios.scenario import Scenario, VehicleSpec
from sitl_scenarios.vectors import Vector4
from sitl_scenarios.vehicles import airframe

PX4_THRUST_COEFFICIENT = 6.5
"""CA_ROTORn_CT of each rotor: PX4's default."""

PX4_MOMENT_RATIO = 0.05
"""Size of CA_ROTORn_KM of each rotor: PX4's default."""


def control_parameters(scenario: Scenario) -> dict[str, float]:
    """Returns the parameters of rate and attitude control that the scenario's autopilot reports and flies.

    The gains of the simulation's own controller are converted into the autopilot's parameters, so that a log of the
    flight shows parameters that belong to the motion. Whatever the scenario's ``vehicle.parameters`` sets replaces
    them.

    Args:
        scenario: Scenario whose vehicle, sensors and autopilot determine the gains.

    Returns:
        Values by the autopilot's name of the parameter, each in the autopilot's own unit; the loop rate in Hz is one
        of them.
    """
    autopilot = scenario.stream.autopilot
    # A new controller has tuned itself for the vehicle: it is made only for its gains.
    gains = FlightController(scenario).gains
    if autopilot == "px4":
        parameters = _px4_parameters(scenario.vehicle, gains)
    else:
        parameters = _ardupilot_parameters(scenario.vehicle, gains)
    scenario_parameters = scenario.vehicle.parameters
    # Before ArduCopter 3.4 gains had other names, such as RATE_RLL_P, without ATC_. No log has both, so a scenario
    # with the old names must not report the new ones as well.
    if "RATE_RLL_P" in scenario_parameters:
        parameters = {
            name: value for name, value in parameters.items() if not name.startswith("ATC_")
        }
    loop_rate = {LOOP_RATE_PARAMETERS[autopilot]: round(1 / scenario.cycle)}
    return parameters | loop_rate | scenario_parameters


def reciprocal_frequency(value: float) -> float:
    """Converts the cut-off frequency of a first-order filter, Hz, to its time constant, s, or the reverse.

    Both are 1/(2π x). A value of 0 stands for a filter that is switched off, and gives 0.

    Args:
        value: Frequency, Hz, or time constant, s.

    Returns:
        Time constant, s, or frequency, Hz.
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
    """Returns a vehicle's thrust curve, and how much a motor's command changes per change of thrust in hover.

    The simulation's mixer puts out commands, while the autopilots' mixers put out thrusts and convert them into
    commands by the inverse thrust curve. The slope of that curve in hover converts gains of the simulation's mixer into
    gains of the autopilot's. The normalised thrust at a fraction s of the motors' range is (1 − f) s + f s², f being
    the expo; its slope is 1 − f + 2 f s.

    Args:
        vehicle: Vehicle of a scenario. Without a ``quadratic_thrust`` of its own the curve is linear, f = 0.
        range_start: Normalised command, 0 to 1, at which the motors' range begins; it ends at 1.

    Returns:
        Expo f of the curve, and slope of the command as a function of the thrust.
    """
    expo = vehicle.quadratic_thrust or 0.0
    body = airframe(vehicle)
    # Fraction s of the motors' range at which the rotors carry the weight.
    command = body.command_for(body.hover_speed) / body.full_command
    range_fraction = (command - range_start) / (1.0 - range_start)
    thrust_slope = 1.0 - expo + 2 * expo * range_fraction
    return HoverThrust(expo, (1.0 - range_start) / thrust_slope)


def _px4_parameters(vehicle: VehicleSpec, gains: Sequence[LoopGains]) -> dict[str, float]:
    """Returns PX4's parameters of rate and attitude control, and of the geometry of its rotors.

    The gains must be scaled, because the two mixers take different inputs. A demand of 1 to the simulation's mixer adds
    1 to a motor's normalised *command*. PX4's rate controllers put out normalised torques: a torque of 1 adds a column
    of PX4's mixer to the motors' normalised *thrusts*. That column is one of the effectiveness matrix's pseudo-inverse,
    normalised as in PX4's ControlAllocationPseudoInverse.cpp: roll and pitch by a common scale
    (``_tilt_mixer_factors``), yaw by its largest element, which makes its factor 1.

    Args:
        vehicle: Airframe of a scenario's vehicle, with its drag, rotor lag and inertia.
        gains: Gains of roll, pitch and yaw, whose outputs are demands to the simulation's own mixer.

    Returns:
        Values by name, in PX4's units: gains per rad/s and the like, cut-offs in Hz, positions in m.
    """
    frame = rotor_frame(vehicle.layout, airframe(vehicle).arm)
    # PX4's motor range begins at a command of 0.
    expo, command_per_thrust = _hover_thrust(vehicle, 0.0)
    # All axes have the same filter of the derivative; a cut-off of 0 switches a filter off.
    lag = gains[0].derivative_lag
    parameters = {
        "THR_MDL_FAC": expo,
        "IMU_GYRO_CUTOFF": 0.0,
        "IMU_DGYRO_CUTOFF": reciprocal_frequency(lag),
    }
    # Demand to the simulation's own mixer that has the effect of a normalised torque of 1 about each axis.
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
    for rotor, spin_direction in enumerate(frame.yaw):
        parameters |= {
            f"CA_ROTOR{rotor}_PX": frame.forward[rotor],
            f"CA_ROTOR{rotor}_PY": frame.right[rotor],
            f"CA_ROTOR{rotor}_PZ": 0.0,
            f"CA_ROTOR{rotor}_CT": PX4_THRUST_COEFFICIENT,
            # Its sign is positive for a rotor that turns counter-clockwise.
            f"CA_ROTOR{rotor}_KM": PX4_MOMENT_RATIO * spin_direction,
        }
    rotors = len(frame.yaw)
    return parameters | {"MC_YAW_TQ_CUTOFF": 0.0, "CA_AIRFRAME": 0, "CA_ROTOR_COUNT": rotors}


def _tilt_mixer_factors(right: Vector4, forward: Vector4) -> list[float]:
    """Returns the largest elements of PX4's normalised mixer columns of roll and of pitch.

    Such an element is the normalised thrust that a torque of 1 adds to the motor that it moves most. The pseudo-inverse
    gives an axis with the lever arms l the column l/|l|². PX4's ControlAllocationPseudoInverse.cpp then divides the
    columns of roll and pitch by one scale, the larger of |column| √(2/n), with n motors that the column moves.

    Args:
        right: Positions (n,) of the rotors to the right, m: the lever arms of roll, except for their sign.
        forward: Positions (n,) of the rotors forward, m: the lever arms of pitch.

    Returns:
        Two factors, of roll and of pitch, normalised thrust per normalised torque.
    """
    largest_elements = []
    scales = []
    for lever_arms in (right, forward):
        norm = sqrt(fsum(arm * arm for arm in lever_arms))
        largest_arm = max(abs(arm) for arm in lever_arms)
        largest_elements.append(largest_arm / norm**2)
        # The column l/|l|² has the norm 1/|l|.
        moved_motors = len([arm for arm in lever_arms if arm != 0])
        scales.append(sqrt(2 / moved_motors) / norm)
    common_scale = max(scales)
    return [element / common_scale for element in largest_elements]


def _ardupilot_parameters(vehicle: VehicleSpec, gains: Sequence[LoopGains]) -> dict[str, float]:
    """Returns ArduPilot's parameters of rate and attitude control, and of its motors' range and thrust curve.

    Two differences between the controllers must be made up for:

    - Scale. A demand of 1 to the simulation's mixer adds 1 to a motor's normalised command. An output of 1 of
      ArduPilot's rate controller adds 1/2 to a motor's normalised thrust. So P, I and D are doubled, and divided by the
      change of command per thrust in hover.
    - Derivative. ArduPilot differentiates the error, the simulation's controller only the measured rate. With a
      derivative filter of time constant T, proportional and derivative action together are (1 + LEAD T s)/(1 + T s).
      ArduPilot's acts on the setpoint too, and would amplify its steps. A target filter 1/(1 + LEAD T s) before it
      leaves 1/(1 + T s) of the setpoint.

    Args:
        vehicle: Airframe of a scenario's vehicle, with its drag, rotor lag and inertia.
        gains: Gains of roll, pitch and yaw, whose outputs are demands to the simulation's own mixer.

    Returns:
        Values by name, in ArduPilot's units: gains per rad/s and the like, cut-offs (FLTT, FLTE, FLTD) in Hz, 0 for a
        filter that is switched off.
    """
    frame_class = 1
    if vehicle.layout in CIRCLES:
        frame_class = CIRCLES[vehicle.layout].frame_class
    expo, command_per_thrust = _hover_thrust(vehicle, IDLE_COMMAND)
    parameters = {
        "MOT_THST_EXPO": expo,
        "MOT_SPIN_ARM": IDLE_COMMAND,
        "MOT_SPIN_MIN": IDLE_COMMAND,
        "MOT_SPIN_MAX": 1.0,
    }
    for name, axis_gains in zip(("RLL", "PIT", "YAW"), gains, strict=True):
        cutoff = reciprocal_frequency(axis_gains.derivative_lag)
        # The factor of 2 is in ArduPilot's mixer, which gives half of an output to each motor.
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
    return parameters | {"INS_GYRO_FILTER": 0, "FRAME_CLASS": frame_class}
