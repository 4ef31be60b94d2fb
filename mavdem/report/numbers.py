"""Numbers and names for people: degrees for angles, as many digits as an interval bears, names with their units.

States that are outputs have the outputs' names. ``AxisCommand`` is one number for all motors: by how much those that
turn the vehicle one way run above those that turn it back.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import floor, isfinite, log10
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.analysis.findings import directions, weights
from mavdem.dem import Learned


class Labels(NamedTuple):
    """Names and units of channels; a unit that is not known is empty."""

    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]

    @classmethod
    def of(cls, learned: Learned) -> Labels:
        """Returns those of the training data of ``learned``; numbers where it has no names."""
        record = learned.record
        inputs = record.inputs.shape[1]
        outputs = record.outputs.shape[1]
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
    """Returns degrees for a ``unit`` with radians, and any other as it is."""
    if unit == "rad" or unit.startswith("rad/"):
        return Readable("°" + unit.removeprefix("rad"), float(np.rad2deg(1.0)))
    return Readable(unit, 1.0)


TORQUE = readable("rad/s²")  # of torques and of effects, by the axis's inertia


def per(unit: Readable, of: str) -> str:
    """Returns the unit of what one unit ``of`` the input does: "°/s per µs"."""
    return f"{unit.name or '1'} per {of or 'unit of input'}"


def named(name: str, unit: str) -> str:
    """Returns the ``name`` with its ``unit``, where it has one."""
    return f"{name}, {unit}" if unit else name


def outputs_of(labels: Labels) -> tuple[list[str], list[Readable]]:
    """Returns the names of the outputs with the units that they are shown in, and these units."""
    units = [readable(unit) for unit in labels.output_units]
    return [
        named(name, unit.name) for name, unit in zip(labels.output_names, units, strict=True)
    ], units


def short(name: str) -> str:
    """Returns a ``name`` without the remark in brackets after it: "motor 1" for "motor 1 (front right)"."""
    return name.split(" (")[0]


def place(name: str) -> str:
    """Returns where a motor is: "front right" for "motor 1 (front right)"; the ``name`` where that is not known."""
    _, bracket, where = name.partition(" (")
    return where.removesuffix(")") if bracket else name


def listed(names: Iterable[object]) -> str:
    """Returns ``names`` as "a, b and c"; empty where there are none."""
    *before, last = [*map(str, names)] or [""]
    return f"{', '.join(before)} and {last}" if before else last


def states_are_outputs(learned: Learned) -> bool:
    """Returns whether the first states of ``learned`` are the outputs: C is fixed to [I 0], not free."""
    return bool(learned.known[-learned.model.C.size :].all())


def state_names(outputs: Sequence[str], learned: Learned) -> list[str]:
    """Returns names of the n states: those of the ``outputs``, then the hidden ones; or numbers."""
    order = learned.model.A.shape[0]
    if not states_are_outputs(learned):
        return [f"state {i + 1}" for i in range(order)]
    return [*outputs, *(f"hidden {i + 1}" for i in range(order - len(outputs)))][:order]


def plus_minus(value: float, half: float) -> str:
    """Returns an estimate and the ``half`` width of its interval, with the digits that it bears; a dash without one.

    >>> plus_minus(3.5123, 1.149), plus_minus(1234.0, 32.0)
    ('3.5 ± 1.1', '1230 ± 30')
    """
    if not (isfinite(value) and isfinite(half)):
        return "-"
    if half <= 0:
        return f"{value:.3g}"
    digit = floor(log10(half))
    # A half width that begins with 1 or 2 has two digits, lest rounding changes it by a third.
    digit -= half < 3 * 10.0**digit
    # Decimals where they are few, else one power of ten for both.
    power = 0 if -6 <= digit <= 2 else 3 * (max(digit, floor(log10(abs(value) or half))) // 3)
    decimals = max(power - digit, 0)
    mean, width = (
        f"{round(number / 10.0**power, power - digit) + 0.0:.{decimals}f}"
        for number in (float(value), float(half))
    )
    return f"({mean} ± {width})e{power}" if power else f"{mean} ± {width}"


def with_unit(value: float, unit: Readable, digits: int = 2) -> str:
    """Returns a ``value`` in the ``unit`` it is shown in, with so many ``digits``: "3.9°", "3.7 °/s"."""
    space = "" if unit.name in ("", "°") else " "
    return f"{rounded(unit.scale * value, digits)}{space}{unit.name}"


def rounded(value: float, digits: int = 2) -> str:
    """Returns so many significant ``digits``, and those before the decimal point; no exponent for everyday sizes."""
    if not isfinite(value):
        return "infinite" if value > 0 else "-"
    if value == 0 or not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits}g}"
    return f"{value:.{max(digits - 1 - floor(log10(abs(value))), 0)}f}"


class AxisCommand(NamedTuple):
    """One number for r inputs: c = ``weights`` · (u − trim), in the ``unit`` of the inputs.

    The ``weights`` (r,) of motors that turn the vehicle up the axis sum to 1, of the others to -1; ``motors`` (r,) is
    what the motors do for a command of 1 and for nothing else.
    """

    name: str
    unit: str
    weights: NDArray[np.float64]
    motors: NDArray[np.float64]

    @classmethod
    def of(cls, learned: Learned) -> AxisCommand:
        """Returns that of the axis of ``learned``, by the mixer geometry or else by each motor's effectiveness."""
        labels = Labels.of(learned)
        turning = directions(learned)
        motors = turning / (weights(turning) @ turning)
        return cls(
            f"{labels.output_names[0]} command", labels.input_units[0], weights(turning), motors
        )

    def series(self, inputs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns the command (T,) over ``inputs`` (T, r), about its mean."""
        command = inputs @ self.weights
        return np.asarray(command - command.mean())
