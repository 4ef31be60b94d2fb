"""The twin of a vehicle for simulators: an X quadrotor in SI units, built from identified loops.

The motion shows the product of mass, arm and 1 / inertia only. So the mass is assumed unless it is given, and the arm
by it, unless PX4's parameters have it; the moments of inertia then follow from the control effectiveness.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mavdem.confidence import Interval, coverage_factor
from mavdem.containers import Numbers
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, NamedFacts
from mavdem.facts.identifiability import Status
from mavdem.facts.loops import TwinFact
from mavdem.immutable import ImmutableResult
from mavdem.ingest.motors import Position
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.autopilot_parameters import (
    DEFAULT_LOOP_RATES,
    LOOP_RATE_PARAMETERS,
    MAX_LOOP_RATE,
    MOTOR_COUNT,
)
from mavdem.loops.axis_loops import Loop, LoopsByAxis
from mavdem.loops.controllers import controller_from_parameters
from mavdem.physical_constants import GRAVITY
from mavdem.plant.parameters import ESTIMATE, LAG_AND_DELAY
from mavdem.wind_velocity.vehicle_drag import Drag
from mavdem.wind_velocity.velocity import WindVelocity

TORQUE_SIGNS = {
    "roll": (-1.0, 1.0, 1.0, -1.0),
    "pitch": (1.0, -1.0, 1.0, -1.0),
    "yaw": (1.0, 1.0, -1.0, -1.0),
}
"""Signs of the motors' torque about each axis, of an X quadrotor with the motors in ArduPilot's and PX4's order.

Yaw's is 1 for a propeller that turns counterclockwise, seen from above.
"""
TYPICAL_MASS = 1.5
"""Mass that is assumed where none is given, kg."""
ARM_PER_ROOT_MASS = 0.15
"""Distance of the motors forward, and right, of the centre of mass over the cube root of the mass, m kg^(−1/3).

It is that of a 3DR Iris: the lengths of vehicles of one shape and density grow with the cube root of the mass.
"""
TYPICAL_MOMENT_RATIO = 0.1
"""Torque over thrust of a common propeller, relative to the distance of the motors to the right."""
MIN_HOVER = 0.1
"""Least share of the motors' range in hover: with less, the flight is no hover. A choice."""


@dataclass(frozen=True, eq=False)
class Twin(ImmutableResult):
    """A quadrotor for simulators, which moves as the vehicle of a log does."""

    autopilot: str
    """"px4" or "ardupilot"."""
    mass: float
    """Mass, kg."""
    inertia: Numbers
    """Moments of inertia about forward, right and down (3,), kg m²."""
    arm: Position
    """Distances of the motors forward, and to the right, of the centre of mass, m."""
    hover: float
    """Mean output of the motors in hover, as a share of their range."""
    spin: Interval
    """Outputs, as shares of that range, at which thrust begins and ends."""
    expo: float
    """Quadratic fraction e of the thrust curve (1 − e) u + e u²."""
    moment: float
    """Torque of a propeller over its thrust, m."""
    damping: Numbers
    """Damping of the rates of roll, pitch and yaw (3,), 1/s."""
    lag: float
    """Time constant of the motors, s."""
    delay: float
    """Delay from the motion to the motors' command, without the hold over a control cycle, s."""
    noise: float
    """Standard deviation of a measured rate, rad/s."""
    drag: Drag
    """Drag of the vehicle; the drag of typical vehicles if the flight does not show it, as its ``source`` states."""
    wind_speed: float | None
    """Speed of the mean wind in the flight, m/s; ``None`` if it is not known."""
    wind_direction: float | None
    """Direction that the mean wind comes from, degrees; ``None`` if it is not known."""
    parameters: Parameters
    """Parameters of the autopilot's rate and attitude control, by name."""
    notes: NamedFacts
    """How certain each attribute is, by its name."""

    @property
    def command(self) -> float:
        """Command u of the thrust curve in hover: 0 at the beginning of the thrust range, 1 at its end."""
        spin_min, spin_max = self.spin
        return (self.hover - spin_min) / (spin_max - spin_min)

    @property
    def slope(self) -> float:
        """Derivative of one motor's thrust by its output, in hover, N per unit of output.

        In hover, each of four motors carries T = m g / 4. By the thrust curve c u (1 − e + e u) of command u, the slope
        is dT/du = T (1 − e + 2 e u) / (u (1 − e + e u)). The range of the command, 0 to 1, is only a fraction of the
        output's range, so that the slope by the output is larger by the factor 1 / (spin_max − spin_min).
        """
        spin_min, spin_max = self.spin
        relative_thrust = self.command * (1 - self.expo + self.expo * self.command)
        scaled_thrust = relative_thrust * (spin_max - spin_min)
        relative_slope = 1 - self.expo + 2 * self.expo * self.command
        return self.mass * GRAVITY / MOTOR_COUNT / scaled_thrust * relative_slope


def build_twin(
    loops: LoopsByAxis,
    *,
    px4: bool,
    hover: float,
    wind: WindVelocity | None,
    drag: Drag,
    mass: float | None,
) -> Twin:
    """Builds the twin of a vehicle from its identified loops.

    If the loop of pitch is not known, pitch is like roll. If the loop of yaw is not known, the propellers have the
    usual torque, and yaw has no damping.

    Args:
        loops: identified loops by axis, which must include "roll".
        px4: whether the autopilot is PX4; otherwise it is ArduPilot.
        hover: mean output of the motors in hover, as a share of their range.
        wind: the wind of the flight; None if it is not known. It is used only if its speed and direction are
            identifiable.
        drag: drag of the vehicle, or of typical vehicles.
        mass: mass, kg; ``None`` for the typical mass.

    Returns:
        The twin, with notes on what was assumed.

    Raises:
        NotLearnable: the motors' output is not possible in hover.
    """
    roll = loops["roll"]
    controller = roll.controller
    spin_min, spin_max = controller.spin_range
    if not max(MIN_HOVER, spin_min) < hover < spin_max:
        raise NotLearnable(TwinFact.NO_HOVER, share=hover)
    if wind is not None and not (wind.speed_identifiable and wind.direction_identifiable):
        wind = None
    mass_or_typical = mass or TYPICAL_MASS
    arm = _motor_arm(controller.parameters, mass_or_typical)
    autopilot = "px4" if px4 else "ardupilot"
    control = _control_parameters(controller.parameters, autopilot)
    # Lag and delay are means over roll and pitch.
    lags_and_delays = [
        loop.dynamics[ESTIMATE, LAG_AND_DELAY] for axis, loop in loops.items() if axis != "yaw"
    ]
    # The simulator holds its output over a control cycle. That delays it by half a cycle, which the identified delay
    # contains already.
    hold_delay = control.loop_period / 2
    lag, delay = (np.mean(lags_and_delays, axis=0) - [0.0, hold_delay]).tolist()
    # If the loop of pitch is not known, its damping is roll's. If the loop of yaw is not known, yaw is undamped.
    damping = {"pitch": roll.plant.damping, "yaw": 0.0}
    for axis, loop in loops.items():
        damping[axis] = loop.plant.damping
    twin = Twin(
        autopilot=control.autopilot,
        mass=mass_or_typical,
        inertia=(),
        arm=arm.position,
        hover=hover,
        spin=controller.spin_range,
        expo=min(max(controller.thrust_expo, 0.0), 1.0),
        moment=TYPICAL_MOMENT_RATIO * arm.position[1],
        damping=tuple(damping[axis] for axis in TORQUE_SIGNS),
        # If the identified delay is shorter than the hold's, the lag is shortened instead.
        lag=max(lag + min(delay, 0.0), 0.0),
        delay=max(delay, 0.0),
        noise=roll.plant.noise,
        drag=drag,
        wind_speed=None if wind is None else wind.speed,
        wind_direction=None if wind is None else wind.direction,
        parameters=control.parameters,
        notes=_certainty_notes(loops, bool(mass), arm.is_measured, drag),
    )
    return _with_inertia(twin, loops)


class _Arm(NamedTuple):
    """Position of the motors of an X quadrotor relative to its centre of mass."""

    position: Position
    """Distance forward and to the right, m."""
    is_measured: bool
    """Whether the autopilot's parameters have the position; else it is assumed from the mass."""


def _motor_arm(parameters: Parameters, mass: float) -> _Arm:
    """Returns the distance of the motors of a quadrotor from its centre of mass.

    PX4's parameters ``CA_ROTORn_PX`` and ``PY`` have the positions. They are used only if all are set, and in metres:
    if the largest is exactly 1, they are normalised. Otherwise the arm is assumed to be proportional to the cube root
    of the mass (``ARM_PER_ROOT_MASS``).

    Args:
        parameters: parameters of the autopilot, by name.
        mass: mass of the vehicle, kg.

    Returns:
        Mean distances of the motors forward and to the right, m, and whether the parameters have them.
    """
    motors = range(MOTOR_COUNT)
    forward = [parameters.get(f"CA_ROTOR{motor}_PX", 0.0) for motor in motors]
    right = [parameters.get(f"CA_ROTOR{motor}_PY", 0.0) for motor in motors]
    positions = np.array([forward, right])
    if positions.all() and np.abs(positions).max() != 1.0:
        mean_forward, mean_right = np.abs(positions).mean(axis=1).tolist()
        return _Arm((mean_forward, mean_right), is_measured=True)
    assumed_arm = ARM_PER_ROOT_MASS * mass ** (1 / 3)
    return _Arm((assumed_arm, assumed_arm), is_measured=False)


class _ControlParameters(NamedTuple):
    """The autopilot's control as the simulation flies it."""

    autopilot: str
    """"px4" or "ardupilot"."""
    parameters: Parameters
    """Parameters by name, without those of the mixer's geometry."""
    loop_period: float
    """Time between two runs of the rate controller, s."""


def _control_parameters(logged: Parameters, autopilot: str) -> _ControlParameters:
    """Returns the autopilot's control parameters with which the simulator flies the twin.

    They are the logged parameters with two changes. A rate loop that is faster than ``MAX_LOOP_RATE`` is slowed down to
    that, to save time. The mixer's geometry (``CA_*``) is left out, since the twin has its own.

    Args:
        logged: parameters of the log, by name.
        autopilot: "px4" or "ardupilot".

    Returns:
        The autopilot, the parameters, and the period of the rate loop, s.
    """
    rate_name = LOOP_RATE_PARAMETERS[autopilot]
    logged_rate = logged.get(rate_name, 0.0) or DEFAULT_LOOP_RATES[autopilot]
    rate = min(logged_rate, MAX_LOOP_RATE)
    parameters = {name: value for name, value in logged.items() if not name.startswith("CA_")}
    parameters[rate_name] = rate
    return _ControlParameters(autopilot, parameters, 1 / rate)


def _with_inertia(twin: Twin, loops: LoopsByAxis) -> Twin:
    """Computes the moments of inertia of a twin, and the moment of its propellers, from the loops' effectiveness.

    The inertia about roll and pitch is the torque of a demand over the angular acceleration that the flight shows. As a
    multirotor is flat, its moment of inertia about yaw is the sum of the two others (perpendicular axis theorem). With
    that, the propellers' moment, which is their torque over their thrust, follows from the loop of yaw.

    Args:
        twin: twin with mass, arm, output in hover and thrust curve, whose inertia is not set yet.
        loops: identified loops by axis, "roll" among them. If the loop of pitch is not known, its inertia is assumed to
            be roll's.

    Returns:
        The twin with its inertia, kg m², and moment, m.
    """
    forward_arm, right_arm = twin.arm
    inertia_roll = _moment_of_inertia(twin, "roll", loops["roll"], lever=right_arm)
    inertia_pitch = inertia_roll
    if "pitch" in loops:
        inertia_pitch = _moment_of_inertia(twin, "pitch", loops["pitch"], lever=forward_arm)
    inertia_yaw = inertia_roll + inertia_pitch
    moment = twin.moment
    if "yaw" in loops:
        # About yaw, the lever of a motor is the moment of its propeller, which is not known yet. As the inertia is
        # proportional to the lever, the result with a lever of 1 m is the inertia per moment.
        inertia_per_moment = _moment_of_inertia(twin, "yaw", loops["yaw"], lever=1.0)
        moment = inertia_yaw / inertia_per_moment
    return replace(twin, inertia=(inertia_roll, inertia_pitch, inertia_yaw), moment=moment)


def _moment_of_inertia(twin: Twin, axis: str, loop: Loop, lever: float) -> float:
    """Returns the moment of inertia about an axis from the control effectiveness of its loop.

    It is M / α, with the torque M and the angular acceleration α for a demand of 1. α is the control effectiveness of
    the identified plant. M follows from the twin: the mixer determines the change of each motor's output, the slope of
    the thrust curve the change of its thrust, and the lever the change of its torque, so that
    M = lever · slope · Σ |output per demand|.

    Args:
        twin: an X quadrotor, with its arm, its output in hover, and the slope of its thrust curve.
        axis: "roll", "pitch" or "yaw".
        loop: loop of the axis, with its control effectiveness, rad/s² per demand.
        lever: torque of a motor about the axis over its thrust, m.

    Returns:
        The moment of inertia, kg m².
    """
    forward_arm, right_arm = twin.arm
    # PX4's mixer follows from the positions of the motors, ArduPilot's from the class of the frame and the
    # signs that are passed below.
    x_frame = {"CA_ROTOR_COUNT": float(MOTOR_COUNT), "FRAME_CLASS": 1.0}
    # Each motor has the signs (1 or -1) of its torques about roll, pitch and yaw.
    motor_signs = zip(*TORQUE_SIGNS.values(), strict=True)
    for motor, (roll_sign, pitch_sign, yaw_sign) in enumerate(motor_signs):
        # A motor in front raises the nose (positive pitch), a motor on the right rolls to the left (negative roll).
        x_frame[f"CA_ROTOR{motor}_PX"] = forward_arm * pitch_sign
        x_frame[f"CA_ROTOR{motor}_PY"] = -right_arm * roll_sign
        x_frame[f"CA_ROTOR{motor}_KM"] = yaw_sign
    controller = controller_from_parameters(
        {**twin.parameters, **x_frame}, axis, TORQUE_SIGNS[axis]
    )
    # Some controllers linearise the thrust curve, so that outputs per demand depend on the output: that in hover.
    outputs_per_demand = controller.outputs_per_demand([twin.hover] * MOTOR_COUNT)
    total_output = np.abs(outputs_per_demand).sum()
    return lever * twin.slope * total_output / loop.effectiveness[ESTIMATE]


def _certainty_notes(
    loops: LoopsByAxis, is_mass_given: bool, is_arm_measured: bool, drag: Drag
) -> dict[str, Fact]:
    """Returns notes on how certain each attribute of a twin is: whether it was given, measured or assumed.

    A note is a fact: a code with figures, from which the file of the twin and the report make a sentence. Mass, arm and
    drag may be assumed. Inertia, propeller moment, damping and lag follow from the identified loops, with intervals.

    Args:
        loops: identified rate and attitude loops by axis, with the posteriors of their plants.
        is_mass_given: whether the mass is known; otherwise it is assumed.
        is_arm_measured: whether the parameters have the arm; otherwise it is assumed.
        drag: drag of the vehicle, or of typical ones.

    Returns:
        Notes by the names of the attributes.
    """
    effectiveness_notes = {axis: _effectiveness_note(loop) for axis, loop in loops.items()}
    notes = {
        "mass": Fact(TwinFact.MASS_NOTE, is_given=is_mass_given),
        "arm": Fact(TwinFact.ARM_NOTE, is_given=is_arm_measured),
        "inertia": Fact(
            TwinFact.INERTIA_NOTE,
            roll=effectiveness_notes["roll"],
            pitch=effectiveness_notes.get("pitch"),
        ),
        "moment": effectiveness_notes.get("yaw", Fact(TwinFact.MOMENT_NOTE)),
        "damping": Fact(TwinFact.DAMPING_NOTE, damping=_half_width(loops["roll"], "damping")),
        "lag": Fact(TwinFact.LAG_NOTE, lag=_half_width(loops["roll"], "lag")),
    }
    for name in ("linear", "quadratic"):
        # The note of either coefficient states the intervals of both: lower and upper end, averaged over both axes.
        notes[f"drag_{name}"] = Fact(
            TwinFact.DRAG_NOTE,
            subject=name,
            drag_linear_interval=drag.interval("linear").mean(axis=1).tolist(),
            drag_quadratic_interval=drag.interval("quadratic").mean(axis=1).tolist(),
            source=drag.source,
        )
    return notes


def _effectiveness_note(loop: Loop) -> Fact:
    """Returns the note on how certain a loop's control effectiveness is.

    Args:
        loop: identified loop of one axis, with draws of its effectiveness.

    Returns:
        A fact with ``share``, the half width of the 90 % interval over the estimate, and ``is_biased``, whether the
        identification of the plant calls the effectiveness biased.
    """
    estimate = loop.effectiveness[ESTIMATE]
    half_width = coverage_factor() * np.std(loop.effectiveness)
    # The bias is the probable relative error of the effectiveness, and 0 for a plant without a known bias.
    is_biased = bool(loop.plant.bias != 0)
    return Fact(TwinFact.EFFECT_NOTE, share=half_width / estimate, is_biased=is_biased)


def _half_width(loop: Loop, parameter: str) -> float | None:
    """Returns the half width of the 90 % interval of "damping", 1/s, or "lag", s; ``None`` if not identifiable."""
    if loop.plant.status[parameter] is Status.NOT_IDENTIFIABLE:
        return None
    half_width: float = getattr(loop.plant.interval(), parameter)
    return half_width
