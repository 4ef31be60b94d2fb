"""Units and names for people: degrees for angles, states named by the outputs they are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.dem import Learned
from mavdem.flight import Flight


class Readable(NamedTuple):
    """A unit to show values in: what is shown is ``scale`` times the value."""

    name: str
    scale: float


def readable(unit: str) -> Readable:
    """Degrees for radians, anything else as it is."""
    if unit == "rad" or unit.startswith("rad/"):
        return Readable("°" + unit.removeprefix("rad"), float(np.rad2deg(1.0)))
    return Readable(unit, 1.0)


def named(name: str, unit: str) -> str:
    """The name with its unit, where it has one."""
    return f"{name}, {unit}" if unit else name


def short(name: str) -> str:
    """A name without the remark in brackets after it: "motor 1" for "motor 1 (front right)"."""
    return name.split(" (")[0]


def state_names(flight: Flight, learned: Learned) -> list[str]:
    """Names of the n states: the outputs', then the hidden ones'."""
    order, outputs = learned.model.A.shape[0], flight.output_names
    return [*outputs, *(f"hidden {i + 1}" for i in range(order - len(outputs)))][:order]


def state_rate_units(flight: Flight, learned: Learned) -> list[str]:
    """Units of the n states per second; a hidden state has the last output's."""
    order, units = learned.model.A.shape[0], flight.output_units
    return [_per_second(unit) for unit in [*units, *[units[-1]] * (order - len(units))][:order]]


def _per_second(unit: str) -> str:
    if not unit:
        return "per s"
    return unit.removesuffix("/s") + "/s²" if unit.endswith("/s") else unit + "/s"
