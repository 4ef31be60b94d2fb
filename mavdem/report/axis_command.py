"""The command of an axis: by how much the motors that turn the vehicle one way run above those that turn it back."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem import Learned
from mavdem.report.names import Labels

Array = NDArray[np.float64]


class AxisCommand(NamedTuple):
    """One number for r inputs: c = ``weights`` · (u − trim), in the unit of the inputs.

    Attributes:
        name: such as "roll command".
        unit: of the inputs, empty where it is not known.
        weights: (r,) of the motors that turn the vehicle up the axis they sum to 1, of the others to -1.
        motors: (r,) what the motors do for a command of 1 and for nothing else.
    """

    name: str
    unit: str
    weights: Array
    motors: Array

    @classmethod
    def of(cls, learned: Learned) -> AxisCommand:
        """That of the axis which was learnt, by the mixer's geometry or else by each motor's estimated effect."""
        labels, directions = Labels.of(learned), _directions(learned)
        up, down = np.maximum(directions, 0.0), np.maximum(-directions, 0.0)
        weights = sum(sign * side / side.sum() for sign, side in ((1, up), (-1, down)) if side.any())
        motors = directions / (weights @ directions)
        return cls(f"{labels.output_names[0]} command", labels.input_units[0], np.asarray(weights), motors)

    def series(self, inputs: Array) -> Array:
        """(T,) the command over inputs (T, r), about its mean."""
        command = inputs @ self.weights
        return np.asarray(command - command.mean())

    @property
    def label(self) -> str:
        """The name with its unit: "roll command (µs)"."""
        return f"{self.name} ({self.unit})" if self.unit else self.name


def _directions(learned: Learned) -> Array:
    """(r,) how each input turns the vehicle, relative to the others; not all are zero."""
    known = learned.record.effect_directions
    if known is not None:
        return np.asarray(known)
    if learned.record.inputs.shape[1] == 1:  # the controller's demand
        return np.ones(1)
    effect = learned.model.B[-1] if learned.physical is None else learned.physical.effect
    return np.asarray(effect if effect.any() else np.ones(len(effect)))
