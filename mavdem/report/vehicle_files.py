"""Vehicles for simulators: a learned twin as a file of ``mavdem fly``, ArduPilot's SITL, PX4's SIH and Gazebo."""

from __future__ import annotations

import json
from math import atan, cos, degrees, hypot, sqrt
from typing import Any

import numpy as np

from mavdem.condition.loop.twin import GRAVITY, SPINS, Twin

AIR, DISC = 1.225, 0.385  # kg/m³ at sea level; m², the area of all rotors in ArduPilot's default frame
REFERENCE_SPEED = 10.0  # m/s at which ArduPilot's drag is the learned one
FULL_SPEED = 1000.0  # rad/s of a motor at full command: nothing of it shows in a log
PLUGIN = 'filename="gz-sim-multicopter-motor-model-system" name="gz::sim::systems::MulticopterMotorModel"'
LEFT_OUT = {  # what a format has no place for
    ".json": "motor lag, delay, damping of pitch and yaw apart from roll's, battery and controller gains",
    ".params": "delay, quadratic drag and damping of pitch and yaw apart from roll's",
    ".sdf": "delay, damping, quadratic drag and controller gains",
}


def vehicle_text(twin: Twin, ending: str, source: str) -> str:
    """Returns the file of a vehicle that ``source`` showed, by its ``ending``: .toml, .json, .params or .sdf."""
    return {".toml": _toml, ".json": _frame, ".params": _sih, ".sdf": _motors}[ending](twin, source)


def _toml(twin: Twin, source: str) -> str:
    notes, drag = twin.notes, twin.drag
    lines = [f"# Learned from {source}. Intervals are of 90 %. Fly it: mavdem fly SCENARIO --vehicle THIS_FILE"]
    lines += ["[stream]", f'autopilot = "{twin.autopilot}"', "", "[sensors]"]
    lines += [f"delay = {twin.delay:.5f}  # s, from the motion to the motors' command"]
    lines += [f"rate_sd = {twin.noise:.6f}  # rad/s, of each measured rate", "", "[vehicle]"]
    lines += [f"{name} = {twin.lag:.5f}  # s, {notes['lag']}" for name in ("lag_up", "lag_down")]
    lines += [f"quadratic_thrust = {twin.expo:g}  # share, as the autopilot has it"]
    lines += [f"stop = {twin.parameters.get('MOT_SPIN_MAX', 1.0):g}  # share of the motors' range, MOT_SPIN_MAX"]
    if drag is not None:
        for name, unit in (("linear", "1/s"), ("quadratic", "1/m")):
            values, (low, high) = (np.round(one, 4).tolist() for one in (getattr(drag, name), drag.interval(name)))
            lines += [f"drag_{name} = {values}  # {unit} along body x and y, from {low} to {high}"]
    lines += ["", "[vehicle.body]", f"mass = {twin.mass:g}  # kg, {notes['mass']}"]
    lines += [f"inertia = {[float(f'{one:.4g}') for one in twin.inertia]}  # kg m², {notes['inertia']}"]
    lines += [f"arm = [{twin.arm:.4g}, {twin.arm:.4g}]  # m forward and right, {notes['arm']}"]
    lines += [f"hover = {twin.hover:.4f}  # share of the motors' range"]
    lines += [f"torque = {twin.moment:.5f}  # m, of a propeller by its thrust, {notes['moment']}"]
    lines += [f"damping = {np.round(twin.damping, 3).tolist()}  # 1/s, {notes['damping']}", "", "[vehicle.parameters]"]
    return "\n".join([*lines, *(f"{name} = {value:g}" for name, value in sorted(twin.parameters.items())), ""])


def _scale(twin: Twin, slope: float) -> list[float]:
    """Moments of inertia with which motors of another ``slope``, N, in hover do the same."""
    return [float(f"{one * slope / twin.slope:.5g}") for one in twin.inertia]


def _drag(twin: Twin, speed: float = 0.0) -> float:
    """Of the mass at a ``speed``, m/s, 1/s."""
    return 0.0 if twin.drag is None else float((twin.drag.linear + twin.drag.quadratic * speed).mean())


def _frame(twin: Twin, _: str) -> str:
    """ArduPilot's frame: libraries/SITL/SIM_Frame.cpp and SIM_Motor.cpp."""
    begin, end = (twin.parameters.get(name, one) for name, one in (("MOT_SPIN_MIN", 0.0), ("MOT_SPIN_MAX", 1.0)))
    share, size = (twin.hover - begin) / (end - begin), 2 * hypot(twin.arm, twin.arm)
    full = twin.mass * GRAVITY / 4 / (share * (1 - twin.expo + twin.expo * share))
    slope = full * (1 - twin.expo + 2 * twin.expo * share) / (end - begin)
    x, y, z = _scale(twin, slope)
    # A motor's torque is 0.05 times the diagonal, its thrust and its command.
    own = 0.05 * size * (twin.mass * GRAVITY / 4 / (end - begin) + share * slope) / (twin.moment * slope)
    angle = atan(_drag(twin, REFERENCE_SPEED) * REFERENCE_SPEED / GRAVITY)
    pressed = cos(angle) * sqrt(twin.mass * GRAVITY / cos(angle) * AIR * DISC)
    values: dict[str, Any] = {"mass": twin.mass, "diagonal_size": size, "moment_inertia": [x, y, z * own]}
    values |= {"refSpd": REFERENCE_SPEED, "refAngle": degrees(angle)}
    values |= {"refAlt": 0.0, "mdrag_coef": _drag(twin) * twin.mass / pressed, "disc_area": DISC, "num_motors": 4}
    values |= {"hoverThrOut": twin.mass * GRAVITY / 4 / full, "propExpo": twin.expo}
    values |= {"spin_min": begin, "spin_max": end, "pwmMin": 1000, "pwmMax": 2000}
    values |= {"refRotRate": np.radians(400) / max(twin.damping[0], 1e-3)}
    return json.dumps(values, indent=1) + "\n"


def _sih(twin: Twin, _: str) -> str:
    """PX4's simulation in hardware, whose thrust is linear: src/modules/simulation/simulator_sih."""
    full = twin.mass * GRAVITY / 4 / twin.hover
    x, y, z = _scale(twin, full)
    values = {"SIH_MASS": twin.mass, "SIH_IXX": x, "SIH_IYY": y, "SIH_IZZ": z}
    values |= {"SIH_T_MAX": full, "SIH_Q_MAX": twin.moment * full, "SIH_T_TAU": twin.lag}
    values |= {"SIH_L_ROLL": twin.arm, "SIH_L_PITCH": twin.arm, "SIH_KDV": _drag(twin) * twin.mass}
    values |= {"SIH_KDW": x * twin.damping[0]} | (dict(twin.parameters) if twin.autopilot == "px4" else {})
    return "".join(f"1\t1\t{name}\t{value:.7g}\t9\n" for name, value in values.items())


def _motors(twin: Twin, _: str) -> str:
    """Gazebo's motor plugins, whose thrust goes with the square of the command, and the inertia."""
    full = twin.mass * GRAVITY / 4 / twin.hover**2
    x, y, z = _scale(twin, 2 * full * twin.hover)
    rotor = _drag(twin) * twin.mass / (4 * FULL_SPEED * twin.hover)
    values = {"timeConstantUp": twin.lag, "timeConstantDown": twin.lag, "maxRotVelocity": FULL_SPEED}
    values |= {"motorConstant": full / FULL_SPEED**2, "momentConstant": twin.moment, "rotorDragCoefficient": rotor}
    inertia = "".join(f"<{name}>{value}</{name}>" for name, value in (("ixx", x), ("iyy", y), ("izz", z)))
    text = f"<inertial><mass>{twin.mass:g}</mass><inertia>{inertia}</inertia></inertial>\n"
    shown = {name: f"{value:.6g}" for name, value in values.items()}
    for n, spin in enumerate(SPINS):
        names = {"jointName": f"rotor_{n}_joint", "linkName": f"rotor_{n}", "motorType": "velocity", "motorNumber": n}
        names |= {"turningDirection": "ccw" if spin > 0 else "cw", "commandSubTopic": "command/motor_speed"}
        lines = [f" <{name}>{value}</{name}>\n" for name, value in (names | shown).items()]
        text += f"<plugin {PLUGIN}>\n{''.join(lines)}</plugin>\n"
    return text
