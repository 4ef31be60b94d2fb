"""The learned twin of a vehicle in tables, and as a file for a simulator: ``mavdem fly``, SITL, PX4 SIH or Gazebo.

Each format is a template beside this module, ``vehicle.toml``, ``.json``, ``.params`` or ``.sdf``, which also says
where the format comes from.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from operator import attrgetter
from typing import Any

import numpy as np

from mavdem.facts import NamedFacts
from mavdem.loops.twin import Twin
from mavdem.loops.twin_flight import RATE_BANDS
from mavdem.physical_constants import GRAVITY
from mavdem.report.blocks import Block, Blocks, Sentence, Table
from mavdem.report.pages.environment import environment

OMITTED_QUANTITIES = {
    ".json": "motor time constant, delay, damping of pitch and yaw apart from roll's, battery and controller gains",
    ".params": "delay, quadratic drag and damping of pitch and yaw apart from roll's",
    ".sdf": "delay, damping, quadratic drag and controller gains",
}
"""Quantities of a twin that a format cannot express, by the ending of its files."""

TWIN_QUANTITIES = {
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
"""Quantities of a twin that are shown: name and unit by the attribute."""

MOTION_FIGURES = {"lean": ", mean (°)", "sway": ", sd (°)", "rate": " rate, sd (°/s)"}
"""Figures by which the motion of a twin is compared: what follows the axis, by key."""


def missing_axes(reasons: NamedFacts) -> list[Sentence]:
    """Returns a sentence for each axis that the learned model of a vehicle (its twin) lacks, with the reason.

    Args:
        reasons: by axis the reason why it was not learned, a fact (a coded finding).
    """
    sentences = []
    for axis, reason in reasons.items():
        text = f"{axis.capitalize()} is not learned: {reason.sentence_and_remedy}"
        sentences.append(Sentence(text))
    return sentences


def twin_blocks(twin: Twin, comparison: Mapping[str, Mapping[str, list[float]]]) -> Blocks:
    """Returns the report on the twin of a vehicle, its model for simulators: a table of its quantities, and a check.

    The check compares a simulated flight of the twin with the recorded one, in wind of the same spectrum.

    Args:
        twin: simulated vehicle with the identified loops, hover thrust, drag and wind.
        comparison: figures of both flights by axis; empty if the flight could not be repeated. "levels" are the twin's
            rates relative to the recorded ones in each of ``RATE_BANDS``, dB; the keys of ``MOTION_FIGURES`` have the
            recorded and the twin's figure.
    """
    rows = []
    for attribute, name in TWIN_QUANTITIES.items():
        value = attrgetter(attribute)(twin)
        if value is None:
            continue
        # A quantity may be an array, such as the inertia about three axes.
        numbers = ", ".join(f"{number:.3g}" for number in np.ravel(value))
        uncertainty = str(twin.notes.get(attribute.replace(".", "_"), ""))
        rows.append([name, numbers, uncertainty])
    blocks: Blocks = [Table(["Vehicle", "value", "90 % interval"], rows, words=True)]
    if not comparison:
        text = "The setpoints of roll were not recorded: the twin does not fly them again."
        return [*blocks, Sentence(text)]
    for axis, figures in comparison.items():
        blocks.append(_motion_table(axis, figures))
    return blocks


def _motion_table(axis: str, figures: Mapping[str, Sequence[float]]) -> Block:
    """Returns the table that compares the recorded motion about one axis with the twin's.

    Rates are compared by band of frequency, in dB relative to the recorded flight, which has 0 dB by definition; the
    other figures are shown for both flights.

    Args:
        axis: name of the axis.
        figures: "levels" are the twin's rates relative to the recorded ones in each of ``RATE_BANDS``, dB; the keys of
            ``MOTION_FIGURES`` have two figures each, the recorded one and the twin's.
    """
    rows = []
    for (low, high), level in zip(pairwise(RATE_BANDS), figures["levels"], strict=True):
        rows.append([f"{axis} rate, {low:g} to {high:g} Hz (dB)", "0", f"{level:+.1f}"])
    for key, name in MOTION_FIGURES.items():
        if key in figures:
            rows.append([f"{axis}{name}", *(f"{value:.2f}" for value in figures[key])])
    return Table(["In wind of the same spectrum", "recorded", "twin"], rows)


def vehicle_text(twin: Twin, ending: str, source: str) -> str:
    """Returns the text of the file by which a simulator flies the twin, the learned model of a vehicle.

    Args:
        twin: the twin, with the identified loops, hover thrust, drag and wind.
        ending: ending of the file, which names its format: ".toml" for ``mavdem fly``, ".json" for ArduPilot's SITL,
            ".params" for PX4's SIH or ".sdf" for Gazebo.
        source: name of the log that the twin was learned from.
    """
    # The templates of HTML pages escape their text, which a file for a simulator must not have. Without a cache of
    # compiled templates, none with the other setting is used by mistake.
    plain_text_environment = environment().overlay(autoescape=False, bytecode_cache=None)
    plain_text_environment.filters["g"] = _five_digits
    template = plain_text_environment.get_template(f"vehicle{ending}")
    text = template.render(
        twin=twin,
        source=source,
        gravity=GRAVITY,
        # Each of the four rotors carries a quarter of the weight in hover, N.
        weight=twin.mass * GRAVITY / 4,
        linear=twin.drag.linear.mean(),
        quadratic=twin.drag.quadratic.mean(),
        math=math,
    )
    return text + "\n"


def _five_digits(value: Any) -> str:
    """Returns a number, or a list of numbers as an array in TOML, with five significant digits."""
    if np.ndim(value):
        return str([float(f"{number:.5g}") for number in value])
    return f"{value:.5g}"
