"""Vehicles for simulators: a learned twin in tables, and as a file of ``mavdem fly``, SITL, SIH and Gazebo.

What a format makes of the twin, and its source, is in its template: vehicle.toml, .json, .params and .sdf beside this.
"""

import math
from collections.abc import Mapping
from itertools import pairwise
from operator import attrgetter

import numpy as np
from scipy.constants import g as GRAVITY  # noqa: N812

from mavdem.facts import NamedFacts
from mavdem.loops.twin import Twin
from mavdem.loops.twin_flight import RATE_BANDS
from mavdem.report.blocks import Blocks, Sentence, Table
from mavdem.report.pages.page import environment

OMITTED_QUANTITIES = {  # what a format has no place for
    ".json": "motor time constant, delay, damping of pitch and yaw apart from roll's, battery and controller gains",
    ".params": "delay, quadratic drag and damping of pitch and yaw apart from roll's",
    ".sdf": "delay, damping, quadratic drag and controller gains",
}
SHOWN = {
    "mass": "mass (kg)",
    "inertia": "inertia (kg m²)",
    "lag": "motor time constant, gyro filters apart (s)",
    "damping": "rate damping (1/s)",
    "delay": "delay (s)",
    "hover": "hover (share of range)",
    "drag.linear": "drag along body x and y (1/s)",
    "drag.quadratic": "quadratic drag along body x and y (1/m)",
    "wind_speed": "wind (m/s)",
    "wind_direction": "wind comes from (°)",
}
FIGURES = {"lean": ", mean (°)", "sway": ", sd (°)", "rate": " rate, sd (°/s)"}


def missing_axes(missing: NamedFacts) -> list[Sentence]:
    """Returns why axes are ``missing`` of what a twin is made of, a sentence each."""
    return [
        Sentence(f"{axis.capitalize()} is not learned: {fact.advised}")
        for axis, fact in missing.items()
    ]


def twin_blocks(twin: Twin, compared: Mapping[str, Mapping[str, list[float]]]) -> Blocks:
    """Returns the figures of a ``twin`` and how sure they are, and how alike it flies, ``compared`` by axis."""
    attributes = {name: attrgetter(name)(twin) for name in SHOWN}
    rows = [
        [
            SHOWN[name],
            ", ".join(f"{each:.3g}" for each in np.ravel(value)),
            str(twin.notes.get(name.replace(".", "_"), "")),
        ]
        for name, value in attributes.items()
        if value is not None
    ]
    blocks: Blocks = [Table(["Vehicle", "value", "how sure (90 %)"], rows, words=True)]
    for axis, figures in compared.items():
        cells = [
            [f"{axis} rate, {low:g} to {high:g} Hz (dB)", "0", f"{level:+.1f}"]
            for (low, high), level in zip(pairwise(RATE_BANDS), figures["levels"], strict=True)
        ]
        cells += [
            [f"{axis}{name}", *(f"{value:.2f}" for value in figures[key])]
            for key, name in FIGURES.items()
            if key in figures
        ]
        blocks.append(Table(["In wind of the same spectrum", "recorded", "twin"], cells))
    if not compared:
        blocks.append(
            Sentence("The setpoints of roll were not recorded: the twin does not fly them again.")
        )
    return blocks


def vehicle_text(twin: Twin, ending: str, source: str) -> str:
    """Returns the file of a vehicle that ``source`` showed, by its ``ending``: .toml, .json, .params or .sdf."""
    made = environment().overlay(autoescape=False)
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
