"""Between the vehicle's units and those a method works in: centred, of unit size, inputs independent of each other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.record import Record

Segments = list[tuple[Array, Array]]  # inputs (T, k) and outputs (T, m) of each segment, in a method's units
LEAST_VARIANCE = 1e-16  # of a prediction error, in a method's units: smaller errors are zero

RANK_TOLERANCE = 1e-6
"""A combination of inputs, each in units of its own deviation, that moves by less than this share of the
largest is dependent: the model gets the smallest B that explains the rest."""


class Units(NamedTuple):
    """y = output_trim + output_scale · (the method's y), and (the method's u) = (u − input_trim) input_map.

    The method's inputs are the principal components of the recorded ones, each of variance 1: fewer than those where
    some are constant or depend on others.
    """

    input_trim: Array  # (r,)
    input_map: Array  # (r, k), k ≤ r
    output_trim: Array  # (m,)
    output_scale: Array  # (m,)

    @classmethod
    def of(cls, record: Record) -> Units:
        """The units in which the training data have mean 0 and variance 1; ``ValueError`` for a constant output."""
        inputs, outputs = record.spread
        still = np.flatnonzero(~outputs.moving)
        if len(still):
            raise ValueError(f"outputs column {still[0]} must vary: constant samples determine no model")
        scale = np.where(inputs.moving, np.sqrt(inputs.variance), np.inf)
        _, sizes, directions = np.linalg.svd((record.inputs - inputs.mean) / scale, full_matrices=False)
        kept = sizes > RANK_TOLERANCE * sizes[0]
        components = directions[kept].T / sizes[kept] * np.sqrt(len(record))
        return cls(inputs.mean, components / scale[:, None], outputs.mean, np.sqrt(outputs.variance))

    def segments(self, record: Record) -> Segments:
        """The record's, in the method's units."""
        return [
            ((inputs - self.input_trim) @ self.input_map, (outputs - self.output_trim) / self.output_scale)
            for inputs, outputs in record.segments
        ]

    def physical(self, model: StateSpace) -> StateSpace:
        """A model in the method's units, whose own trims are added to these, brought to physical ones."""
        scale = self.output_scale
        return StateSpace(
            A=model.A,
            B=model.B @ self.input_map.T,
            C=scale[:, None] * model.C,
            D=scale[:, None] * model.D @ self.input_map.T,
            K=model.K / scale,
            offset=model.offset - model.B @ model.input_trim,
            input_trim=self.input_trim,
            output_trim=self.output_trim + scale * (model.output_trim - model.D @ model.input_trim),
        )
