"""Vehicles for simulators: a learned twin as a file of ``mavdem fly``, ArduPilot's SITL, PX4's SIH and Gazebo.

What a format makes of the twin, and its source, is in its template: vehicle.toml, .json, .params and .sdf beside this.
"""

import math

import numpy as np
from jinja2 import Environment, PackageLoader
from scipy.constants import g as GRAVITY  # noqa: N812

from mavdem.condition.loop.twin import Twin

LEFT_OUT = {  # what a format has no place for
    ".json": "motor lag, delay, damping of pitch and yaw apart from roll's, battery and controller gains",
    ".params": "delay, quadratic drag and damping of pitch and yaw apart from roll's",
    ".sdf": "delay, damping, quadratic drag and controller gains",
}


def vehicle_text(twin: Twin, ending: str, source: str) -> str:
    """Returns the file of a vehicle that ``source`` showed, by its ``ending``: .toml, .json, .params or .sdf."""
    made = Environment(
        loader=PackageLoader("mavdem.report", ""), trim_blocks=True, lstrip_blocks=True
    )  # noqa: S701
    made.filters["g"] = lambda given: (
        str([float(f"{x:.5g}") for x in given]) if np.ndim(given) else f"{given:.5g}"
    )
    return (
        made.get_template(f"vehicle{ending}").render(
            twin=twin,
            source=source,
            gravity=GRAVITY,
            weight=twin.mass * GRAVITY / 4,
            linear=twin.drag.linear.mean(),
            quadratic=twin.drag.quadratic.mean(),
            math=math,
        )
        + "\n"
    )
