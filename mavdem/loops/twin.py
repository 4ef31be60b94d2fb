"""The twin of a vehicle for simulators: an X quadrotor in SI units, built from identified loops.

The motion shows the product of mass, arm and 1 / inertia only. So the mass is assumed unless it is given, and the arm
by it, unless PX4's parameters have it; the moments of inertia then follow from the control effectiveness.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.constants import g as GRAVITY  # noqa: N812

from mavdem.confidence import Interval, coverage_factor
from mavdem.containers import Numbers
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, NamedFacts
from mavdem.facts.identifiability import Status
from mavdem.facts.loops import Twins
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
from mavdem.wind_velocity.estimation import WindVelocity
from mavdem.wind_velocity.vehicle_drag import Drag

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
"""Distance of the motors forward, and right, of the centre of mass by the cube root of the mass, m kg^(−1/3).

That of a 3DR Iris: vehicles of one shape and density are longer by the cube root.
"""
TYPICAL_MOMENT_RATIO = 0.1
"""Torque of a common propeller by its thrust, over the arm."""
MIN_HOVER = 0.1
"""Share of the motors' range in hover, at least: with less, it is no hover."""


@dataclass(frozen=True, eq=False)
class Twin(ImmutableResult):
    """A quadrotor for simulators, which moves as the vehicle of a log does."""

    autopilot: str
    """"px4" or "ardupilot"."""
    mass: float
    """Mass, kg."""
    inertia: Numbers
    """(3,) moments of inertia about forward, right and down, kg m²."""
    arm: Position
    """How far forward, and right, of the centre of mass its motors are, m."""
    hover: float
    """Share of the motors' range in hover."""
    spin: Interval
    """Shares of that range at which thrust begins and ends."""
    expo: float
    """Quadratic fraction e of the thrust curve (1 − e) u + e u²."""
    moment: float
    """Torque of a propeller by its thrust, m."""
    damping: Numbers
    """(3,) damping of the rates of roll, pitch and yaw, 1/s."""
    lag: float
    """Time constant of the motors, s."""
    delay: float
    """From the motion to the motors' command, without the hold over a control cycle, s."""
    noise: float
    """Standard deviation of a measured rate, rad/s."""
    drag: Drag
    """Drag; by its source that of typical vehicles, where the flight does not show it."""
    wind_speed: float | None
    """Mean of the flight, m/s; None where it is not known."""
    wind_direction: float | None
    """Where that wind comes from, degrees; None where it is not known."""
    parameters: Parameters
    """Parameters of the autopilot's rate and attitude control, by name."""
    notes: NamedFacts
    """How certain each attribute is, by its name."""

    @property
    def command(self) -> float:
        """Command u of the thrust curve in hover: the share of what is between where thrust begins and ends."""
        spin_min, spin_max = self.spin
        return (self.hover - spin_min) / (spin_max - spin_min)

    @property
    def slope(self) -> float:
        """Slope of one motor's thrust by the share of its range, in hover, N.

        In hover, each of four motors carries T = m g / 4. By the thrust curve c u (1 − e + e u) of command u, its slope
        is dT/du = T (1 − e + 2 e u) / (u (1 − e + e u)). The command goes from 0 to 1 over a part of the range only,
        so that the slope by the share of the range is larger by 1 / (spin_max − spin_min).
        """
        spin_min, spin_max = self.spin
        relative_thrust = self.command * (1 - self.expo + self.expo * self.command)
        thrust = relative_thrust * (spin_max - spin_min)
        return self.mass * GRAVITY / 4 / thrust * (1 - self.expo + 2 * self.expo * self.command)


def build_twin(
    loops: LoopsByAxis,
    px4: bool,
    hover: float,
    air: WindVelocity | None,
    drag: Drag,
    mass: float | None,
) -> Twin:
    """Returns the twin of a vehicle from its identified loops.

    Pitch is taken to be like roll, and yaw like that of common propellers, where their loops are not known.

    Args:
        loops: by axis; roll must be there.
        px4: whether the autopilot is PX4, and not ArduPilot.
        hover: share of the motors' range in hover.
        air: the wind of the flight, if it is known.
        drag: of the vehicle, or of typical ones.
        mass: kg, where it is known.

    Raises:
        NotLearnable: the motors' share of their range is not that of a hover.
    """
    roll = loops["roll"]
    controller = roll.controller
    spin_min, spin_max = controller.spin_range
    if not max(MIN_HOVER, spin_min) < hover < spin_max:
        raise NotLearnable(Twins.NO_HOVER, share=hover)
    wind = None
    if air is not None and air.speed_identifiable and air.direction_identifiable:
        wind = air
    known_mass = mass or TYPICAL_MASS
    arm = _arm(controller.parameters, known_mass)
    control = _control_parameters(controller.parameters, "px4" if px4 else "ardupilot")
    # Columns of the dynamics are damping, lag and delay, and row 0 is the estimate.
    lags_and_delays = [loop.dynamics[0, 1:] for axis, loop in loops.items() if axis != "yaw"]
    # The simulator holds its output over a cycle: half of that is in the identified delay.
    lag, delay = (np.mean(lags_and_delays, axis=0) - [0.0, control.loop_period / 2]).tolist()
    # Where no loop of pitch is known, it is like roll; without one of yaw, yaw is undamped.
    damping = {"pitch": roll.plant.damping, "yaw": 0.0}
    for axis, loop in loops.items():
        damping[axis] = loop.plant.damping
    twin = Twin(
        autopilot=control.autopilot,
        mass=known_mass,
        inertia=(),
        arm=arm.position,
        hover=hover,
        spin=controller.spin_range,
        expo=min(max(controller.thrust_expo, 0.0), 1.0),
        moment=TYPICAL_MOMENT_RATIO * arm.position[1],
        damping=tuple(damping[axis] for axis in TORQUE_SIGNS),
        # A delay shorter than the hold shortens the lag instead.
        lag=max(lag + min(delay, 0.0), 0.0),
        delay=max(delay, 0.0),
        noise=roll.plant.noise,
        drag=drag,
        wind_speed=None if wind is None else wind.speed,
        wind_direction=None if wind is None else wind.direction,
        parameters=control.parameters,
        notes=_notes(loops, bool(mass), arm.is_measured, drag),
    )
    return _with_inertia(twin, loops)


class _Arm(NamedTuple):
    """Where the motors are."""

    position: Position
    """How far forward and right of the centre of mass, m."""
    is_measured: bool
    """Whether the parameters have it; else it is assumed by the mass."""


def _arm(parameters: Parameters, mass: float) -> _Arm:
    """Returns where the motors of a quadrotor are, by PX4's ``CA_ROTORn_PX`` and ``PY``, or else by its mass.

    Positions count only if all are there. Those whose largest is exactly 1 are normalised and no metres: they do not
    count either.

    Args:
        parameters: of the autopilot, by name.
        mass: kg, by which the arm is assumed (``ARM_PER_ROOT_MASS``) where the parameters do not have it.
    """
    motors = range(MOTOR_COUNT)
    forward = [parameters.get(f"CA_ROTOR{motor}_PX", 0.0) for motor in motors]
    right = [parameters.get(f"CA_ROTOR{motor}_PY", 0.0) for motor in motors]
    positions = np.array([forward, right])
    if positions.all() and np.abs(positions).max() != 1.0:
        mean_forward, mean_right = np.abs(positions).mean(axis=1).tolist()
        return _Arm((mean_forward, mean_right), is_measured=True)
    assumed = ARM_PER_ROOT_MASS * mass ** (1 / 3)
    return _Arm((assumed, assumed), is_measured=False)


class _ControlParameters(NamedTuple):
    """The autopilot's control as the simulation flies it."""

    autopilot: str
    """"px4" or "ardupilot"."""
    parameters: Parameters
    """Parameters by name, without those of the mixer's geometry."""
    loop_period: float
    """Time between two runs of the rate controller, s."""


def _control_parameters(logged: Parameters, autopilot: str) -> _ControlParameters:
    """Returns the control of the logged parameters, as the simulation can fly it.

    A rate loop that is faster than ``MAX_LOOP_RATE`` is slowed down to that. The mixer's geometry (``CA_*``) is left
    out, since the twin's own takes its place.

    Args:
        logged: parameters of the log, by name.
        autopilot: "px4" or "ardupilot".
    """
    rate_name = LOOP_RATE_PARAMETERS[autopilot]
    logged_rate = logged.get(rate_name, 0.0) or DEFAULT_LOOP_RATES[autopilot]
    rate = min(logged_rate, MAX_LOOP_RATE)
    parameters = {name: value for name, value in logged.items() if not name.startswith("CA_")}
    parameters[rate_name] = rate
    return _ControlParameters(autopilot, parameters, 1 / rate)


def _with_inertia(twin: Twin, loops: LoopsByAxis) -> Twin:
    """Returns the ``twin`` with moments of inertia, and the propellers' moment, from the effectiveness of its loops.

    A multirotor is flat, so that its moment of inertia about down is the sum of the two others (perpendicular axis
    theorem). The loop of yaw shows the ratio of that inertia to the propellers' moment (torque over thrust): so the
    moment follows from the inertia.

    Args:
        twin: with mass, arm, hover and thrust curve; its inertia is not set yet.
        loops: by axis; roll must be there. Pitch is like roll where its loop is not known.
    """
    inertia = {axis: _inertia(twin, axis, loop) for axis, loop in loops.items()}
    roll = inertia["roll"]
    pitch = inertia.get("pitch", roll)
    yaw = roll + pitch
    moment = twin.moment
    if "yaw" in inertia:
        inertia_per_moment = inertia["yaw"]
        moment = yaw / inertia_per_moment
    return replace(twin, inertia=(roll, pitch, yaw), moment=moment)


def _inertia(twin: Twin, axis: str, loop: Loop) -> float:
    """Returns the moment of inertia about roll or pitch, kg m²; about yaw, that over the propellers' moment, kg m.

    A demand is the torque command of the rate controller, from -1 to 1. By Newton's second law, J = M / α: the torque M
    that a demand of 1 makes, over the angular acceleration α that it makes. The flight shows α, the control
    effectiveness of the identified plant. M follows from the twin: the mixer says by how much the demand changes the
    output of each motor, the slope of the thrust curve turns outputs into newtons, and the lever of the motors turns
    newtons into torque: M = lever · slope · Σ |output per demand|.

    Args:
        twin: an X quadrotor; its arm (forward, right), m, its output in hover, 0 to 1, and the slope of its thrust
            curve, N per unit of output, are used.
        axis: "roll", "pitch" or "yaw".
        loop: of the axis; row 0 of its control effectiveness is the estimate, rad/s² per demand.
    """
    forward_arm, right_arm = twin.arm
    # PX4's parameters of an X quadrotor with this arm; ArduPilot takes the frame's class and the weights instead.
    x_frame = {"CA_ROTOR_COUNT": float(MOTOR_COUNT), "FRAME_CLASS": 1.0}
    # For each motor, the signs (1 or -1) of the torques about roll, pitch and yaw that its thrust makes.
    motor_signs = zip(*TORQUE_SIGNS.values(), strict=True)
    for motor, (left_sign, front_sign, spin_sign) in enumerate(motor_signs):
        x_frame[f"CA_ROTOR{motor}_PX"] = forward_arm * front_sign
        x_frame[f"CA_ROTOR{motor}_PY"] = -right_arm * left_sign
        x_frame[f"CA_ROTOR{motor}_KM"] = spin_sign
    controller = controller_from_parameters(
        {**twin.parameters, **x_frame}, axis, TORQUE_SIGNS[axis]
    )
    # Some controllers linearise the thrust curve, so that outputs per demand depend on the output: that in hover.
    outputs_per_demand = controller.outputs_per_demand([twin.hover] * MOTOR_COUNT)
    total_output = np.abs(outputs_per_demand).sum()
    # About yaw, the lever of a motor is the propellers' moment (torque over thrust, m), which is not known yet: 1
    # stands for it, so that the result is the inertia over that moment.
    lever = {"roll": right_arm, "pitch": forward_arm, "yaw": 1.0}[axis]
    return lever * twin.slope * total_output / loop.effectiveness[0]


def _notes(
    loops: LoopsByAxis, is_mass_given: bool, is_arm_measured: bool, drag: Drag
) -> dict[str, Fact]:
    """Returns how certain the attributes of a twin are, by their names.

    Args:
        loops: by axis.
        is_mass_given: whether the mass is known and not assumed.
        is_arm_measured: whether the parameters have the arm.
        drag: of the vehicle, or of typical ones.
    """
    effects = {axis: _effect_note(loop) for axis, loop in loops.items()}
    notes = {
        "mass": Fact(Twins.MASS_NOTE, is_given=is_mass_given),
        "arm": Fact(Twins.ARM_NOTE, is_given=is_arm_measured),
        "inertia": Fact(Twins.INERTIA_NOTE, roll=effects["roll"], pitch=effects.get("pitch")),
        "moment": effects.get("yaw", Fact(Twins.MOMENT_NOTE)),
        "damping": Fact(Twins.DAMPING_NOTE, damping=_half_width(loops["roll"], "damping")),
        "lag": Fact(Twins.LAG_NOTE, lag=_half_width(loops["roll"], "lag")),
    }
    for name in ("linear", "quadratic"):
        # The note of each coefficient has the intervals of both: (2,) mean over both axes of the lower and upper end.
        notes[f"drag_{name}"] = Fact(
            Twins.DRAG_NOTE,
            subject=name,
            drag_linear_interval=drag.interval("linear").mean(axis=1).tolist(),
            drag_quadratic_interval=drag.interval("quadratic").mean(axis=1).tolist(),
            source=drag.source,
        )
    return notes


def _effect_note(loop: Loop) -> Fact:
    """Returns the note on how certain a loop's control effectiveness is.

    Its ``share`` is the half width of the 90 % interval over the estimate. It is biased where the identification of the
    plant says so.
    """
    half_width = coverage_factor() * np.std(loop.effectiveness)
    return Fact(
        Twins.EFFECT_NOTE,
        share=half_width / loop.effectiveness[0],
        is_biased=bool(loop.plant.bias),
    )


def _half_width(loop: Loop, parameter: str) -> float | None:
    """Returns the half width of the 90 % interval of "damping" or "lag"; None where it is not identifiable."""
    if loop.plant.status[parameter] is Status.NOT_IDENTIFIABLE:
        return None
    half_width: float = getattr(loop.plant.interval(), parameter)
    return half_width
