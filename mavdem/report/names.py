"""Names and units for people: degrees for angles; states that are outputs have their names."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mavdem.dem import Learned


class Labelled(Protocol):
    """Names and units of channels: of a flight, recorded or live."""

    @property
    def input_names(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def output_names(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def output_units(self) -> tuple[str, ...]: ...  # noqa: D102


class Labels(NamedTuple):
    """Names and units of channels, one a column; a unit that is not known is empty."""

    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]

    @classmethod
    def of(cls, learned: Learned) -> Labels:
        """Those of the training data; numbers where it has no names."""
        record = learned.record
        inputs, outputs = record.inputs.shape[1], record.outputs.shape[1]
        return cls(
            record.input_names or tuple(f"input {i + 1}" for i in range(inputs)),
            record.output_names or tuple(f"output {i + 1}" for i in range(outputs)),
            record.input_units or ("",) * inputs,
            record.output_units or ("",) * outputs,
        )


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


def place(name: str) -> str:
    """Where a motor is: "front right" for "motor 1 (front right)", and the name where that is not known."""
    _, bracket, where = name.partition(" (")
    return where.removesuffix(")") if bracket else name


def listed(names: Iterable[object]) -> str:
    """``a, b and c``; empty where there are none."""
    *before, last = [*map(str, names)] or [""]
    return f"{', '.join(before)} and {last}" if before else last


def left_free(learned: Learned) -> dict[str, NDArray[np.bool_]]:
    """Which entries of A, B and C are estimated from the data, each in the order of θ."""
    model = learned.model
    A, B, C = np.split(~learned.known, [model.A.size, model.A.size + model.B.size])
    return {"A": A, "B": B, "C": C}


THREE_STATES = (
    "`mavdem learn` has 3 states unless --order says otherwise: angle, rate, and the lag of the motors, which exists, "
    "and without which forecasts are worse (docs/benchmarks.md). `mavdem order` counts the states that the outputs "
    "show; 2 means that no lag can be seen in them."
)
"""Why the two commands differ, for the reports of both."""


def states_are_outputs(learned: Learned) -> bool:
    """Whether the first states are the outputs: C is fixed to [I 0]. With a free C the states are arbitrary."""
    return not bool(left_free(learned)["C"].any())


def state_names(flight: Labelled, learned: Learned) -> list[str]:
    """Names of the n states: the outputs', then the hidden ones', or numbers where states are not outputs."""
    order, outputs = learned.model.A.shape[0], flight.output_names
    if not states_are_outputs(learned):
        return [f"state {i + 1}" for i in range(order)]
    return [*outputs, *(f"hidden {i + 1}" for i in range(order - len(outputs)))][:order]


def entries(flight: Labelled, learned: Learned) -> dict[str, list[tuple[str, str]]]:
    """Names of the row and the column of each entry of A, B and C, in the order of θ."""
    states = state_names(flight, learned)
    return {
        "A": [(row, column) for row in states for column in states],
        "B": [(row, column) for row in states for column in flight.input_names],
        "C": [(row, column) for row in flight.output_names for column in states],
    }


def parameter_names(flight: Labelled, learned: Learned) -> list[str]:
    """A name for each parameter, in the order of θ."""
    return [
        f"{matrix}: {short(row)} from {short(column)}"
        for matrix, cells in entries(flight, learned).items()
        for row, column in cells
    ]


def state_rate_units(flight: Labelled, learned: Learned) -> list[str]:
    """Units of the n states per second; a hidden state has the last output's, one that is no output has none."""
    order, units = learned.model.A.shape[0], flight.output_units
    if not states_are_outputs(learned):
        return [""] * order
    return [per_second(unit) for unit in [*units, *[units[-1]] * (order - len(units))][:order]]


def per_second(unit: str) -> str:
    """The unit of a rate of change."""
    if not unit:
        return "per s"
    return unit.removesuffix("/s") + "/s²" if unit.endswith("/s") else unit + "/s"
