"""Normalized units, in which other methods than DEM fit: principal components of the inputs, outputs of variance 1."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.record import Record, Segments, SegmentSamples

DEPENDENCE_TOLERANCE = 1e-6
"""A combination of inputs, each in units of its own standard deviation, counts as dependent on others if it varies by
less than this share of the largest one. The model then has the smallest B that explains the rest."""


class NormalizedUnits(NamedTuple):
    """Maps between physical units, with r inputs and m outputs, and the normalized units u′ and y′ of a method.

    y = output_trim + output_scale · y′ and u′ = (u − input_trim) input_map. The k normalized inputs are the principal
    components of the recorded ones, each of variance 1; k < r where some are constant or depend on others.
    """

    input_trim: Array
    """(r,) mean inputs"""
    input_map: Array
    """(r, k) from inputs to principal components"""
    output_trim: Array
    """(m,) mean outputs"""
    output_scale: Array
    """(m,) standard deviations of the outputs"""

    @classmethod
    def of(cls, record: Record) -> NormalizedUnits:
        """Returns the units in which the training data have mean 0 and variance 1, and inputs are uncorrelated.

        Motors move together, so their commands depend on each other, and a regression on them would be singular. The
        principal components of the inputs are independent; those that hardly vary are left out. They come from the
        singular value decomposition of the inputs in units of their standard deviations.

        Args:
            record: the training data: T samples of r inputs and m outputs, in one or several segments.

        Returns:
            The units.

        Raises:
            ValueError: an output is constant.
        """
        inputs, outputs = record.channel_statistics
        record.require_varying(known_inputs=False)
        # A constant input has no deviation to be scaled to, and gets no component.
        input_sd = np.where(inputs.varying, np.sqrt(inputs.variance), np.inf)
        standardized_inputs = (record.inputs - inputs.mean) / input_sd
        _, singular_values, directions = np.linalg.svd(standardized_inputs, full_matrices=False)
        independent = singular_values > DEPENDENCE_TOLERANCE * singular_values[0]
        components = directions[independent].T / singular_values[independent] * np.sqrt(len(record))
        return cls(
            input_trim=inputs.mean,
            input_map=components / input_sd[:, None],
            output_trim=outputs.mean,
            output_scale=np.sqrt(outputs.variance),
        )

    def normalized_segments(self, record: Record) -> Segments:
        """Converts the training data to normalized units.

        Args:
            record: inputs and outputs in physical units.

        Returns:
            Inputs u′ (T, k) and outputs y′ (T, m) of each segment.
        """
        segments = []
        for inputs, outputs in record.segments:
            normalized_inputs = (inputs - self.input_trim) @ self.input_map
            normalized_outputs = (outputs - self.output_trim) / self.output_scale
            segments.append(SegmentSamples(normalized_inputs, normalized_outputs))
        return segments

    def physical_model(self, model: StateSpace) -> StateSpace:
        """Converts a model that was fitted in normalized units to physical units.

        Only matrices that act on inputs or give outputs change: B by the map of the inputs, C and K by the scale of the
        outputs. The states stay in the units of the method.

        Args:
            model: model of u′ and y′; it must have no feedthrough D, and no input trim.

        Returns:
            The model of the inputs u and the outputs y.
        """
        # As y = scale · y′ + trim, each row of C′ is multiplied by the scale of its output. The prediction error e′ is
        # e / scale, so each column of K′ is divided by it.
        scale = self.output_scale
        return replace(
            model,
            B=model.B @ self.input_map.T,
            C=scale[:, None] * model.C,
            D=np.zeros((len(scale), len(self.input_map))),
            K=model.K / scale,
            input_trim=self.input_trim,
            output_trim=self.output_trim + scale * model.output_trim,
        )
