"""Vehicles for simulators: a learned twin as a file of ``mavdem fly``, ArduPilot's SITL, PX4's SIH and Gazebo."""

from __future__ import annotations

from math import atan, cos, degrees, hypot, radians, sqrt
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader

from mavdem.condition.loop.twin import GRAVITY, Twin

AIR, DISC = 1.225, 0.385  # kg/m³ at sea level; m², the area of all rotors in ArduPilot's default frame
SPEED = 10.0  # m/s at which ArduPilot's drag is the learned one
FASTEST = 1000.0  # rad/s of a motor at full command: nothing of it shows in a log
LEFT_OUT = {  # what a format has no place for
    ".json": "motor lag, delay, damping of pitch and yaw apart from roll's, battery and controller gains",
    ".params": "delay, quadratic drag and damping of pitch and yaw apart from roll's",
    ".sdf": "delay, damping, quadratic drag and controller gains",
}


def vehicle_text(twin: Twin, ending: str, source: str) -> str:
    """Returns the file of a vehicle that ``source`` showed, by its ``ending``: .toml, .json, .params or .sdf."""
    values = {".toml": _own, ".json": _frame, ".params": _sih, ".sdf": _motors}[ending](twin)
    made = Environment(loader=PackageLoader("mavdem.report", ""), trim_blocks=True, lstrip_blocks=True)  # noqa: S701
    made.filters["g"] = lambda given: str([float(f"{x:.5g}") for x in given]) if np.ndim(given) else f"{given:.5g}"
    return made.get_template(f"vehicle{ending}").render(twin=twin, source=source, **values) + "\n"


def _own(twin: Twin) -> dict[str, Any]:
    return {"stop": twin.parameters.get("MOT_SPIN_MAX", 1.0)}


def _scaled(twin: Twin, slope: float) -> list[float]:
    """Moments of inertia with which motors of another ``slope``, N, in hover do the same."""
    return [one * slope / twin.slope for one in twin.inertia]


def _drag(twin: Twin, speed: float = 0.0) -> float:
    """Of the mass at a ``speed``, m/s, 1/s."""
    return 0.0 if twin.drag is None else float((twin.drag.linear + twin.drag.quadratic * speed).mean())


def _frame(twin: Twin) -> dict[str, Any]:
    """ArduPilot's frame: libraries/SITL/SIM_Frame.cpp and SIM_Motor.cpp."""
    begin, end = (twin.parameters.get(name, one) for name, one in (("MOT_SPIN_MIN", 0.0), ("MOT_SPIN_MAX", 1.0)))
    command, size, weight = (twin.hover - begin) / (end - begin), 2 * hypot(twin.arm, twin.arm), twin.mass * GRAVITY / 4
    share = command * (1 - twin.expo + twin.expo * command)
    slope = weight / share * (1 - twin.expo + 2 * twin.expo * command) / (end - begin)
    x, y, z = _scaled(twin, slope)
    # A motor's torque is 0.05 times the diagonal, its thrust and its command.
    z *= 0.05 * size * (weight / (end - begin) + command * slope) / (twin.moment * slope)
    angle = atan(_drag(twin, SPEED) * SPEED / GRAVITY)
    momentum = _drag(twin) * twin.mass / (cos(angle) * sqrt(4 * weight / cos(angle) * AIR * DISC))
    turn = radians(400) / max(twin.damping[0], 1e-3)
    values = {"begin": begin, "end": end, "size": size, "share": share, "inertia": [x, y, z], "turn": turn}
    return values | {"speed": SPEED, "angle": degrees(angle), "momentum": momentum, "disc": DISC}


def _sih(twin: Twin) -> dict[str, Any]:
    """PX4's simulation in hardware, whose thrust is linear: src/modules/simulation/simulator_sih."""
    full = twin.mass * GRAVITY / 4 / twin.hover
    x, y, z = _scaled(twin, full)
    values = {"SIH_MASS": twin.mass, "SIH_IXX": x, "SIH_IYY": y, "SIH_IZZ": z}
    values |= {"SIH_T_MAX": full, "SIH_Q_MAX": twin.moment * full, "SIH_T_TAU": twin.lag}
    values |= {"SIH_L_ROLL": twin.arm, "SIH_L_PITCH": twin.arm, "SIH_KDV": _drag(twin) * twin.mass}
    values |= {"SIH_KDW": x * twin.damping[0]} | (dict(twin.parameters) if twin.autopilot == "px4" else {})
    return {"values": values}


def _motors(twin: Twin) -> dict[str, Any]:
    """Gazebo's motors, whose thrust goes with the square of the command."""
    full = twin.mass * GRAVITY / 4 / twin.hover**2
    rotor = _drag(twin) * twin.mass / (4 * FASTEST * twin.hover)
    values = {"fastest": FASTEST, "constant": full / FASTEST**2, "rotor": rotor}
    return values | {"inertia": _scaled(twin, 2 * full * twin.hover)}
