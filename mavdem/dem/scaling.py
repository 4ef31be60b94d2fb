"""The engine's units: outputs and inputs are centred and scaled, and a constant input represents the trim."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.engine.model import LinearModel, pack, unpack
from mavdem.dem.record import Record, Segments, SegmentSamples
from mavdem.dem.settings import Settings


@dataclass(frozen=True, eq=False)
class Scaling:
    """Conversion between physical units and the units in which the engine computes.

    output = output_trim + output_scale · (output in the engine's units), and likewise for inputs. In the engine's units
    a prior means the same for every vehicle.
    """

    input_trim: Array
    """(r,) inputs that are 0 in the engine's units, in the unit of the recorded inputs."""

    input_scale: Array
    """(r,) size of the engine's unit of each input, in the unit of the recorded inputs."""

    output_trim: Array
    """(m,) outputs that are 0 in the engine's units, rad and rad/s."""

    output_scale: Array
    """(m,) size of the engine's unit of each output, rad and rad/s."""

    constant: bool
    """Whether the engine has one more input after the recorded ones, which is 1: its column of B is the offset."""

    known: bool
    """Whether the recorded inputs are used; if not, they are 0 for the engine, and their unit is arbitrary."""

    @classmethod
    def from_record(cls, record: Record, settings: Settings) -> Scaling:
        """Returns the scaling that ``settings.scaling`` names, for training data.

        "channel" scales each output to mean 0 and variance 1, and adds a constant input. All inputs share one scale, so
        that the noise of a motor that hardly varies is not amplified. "paper" scales only the inputs, all by one mean
        and one range. "none" leaves physical units.

        Args:
            record: training data, from whose means, variances and ranges the scaling is computed.
            settings: settings with the name of the scaling, and whether the inputs are known.

        Returns:
            The scaling.

        Raises:
            NotLearnable: an output is constant, or all known inputs are.
        """
        inputs, outputs = record.channel_statistics
        has_known_inputs = settings.known_inputs
        record.require_varying(known_inputs=has_known_inputs and not inputs.varying.any())
        is_by_channel = settings.scaling == "channel"
        # Without a scaling the trims are 0 and the scales 1, so that physical units remain.
        output_trim = np.zeros(len(outputs.mean))
        output_scale = np.ones(len(outputs.mean))
        input_trim = np.zeros(len(inputs.mean))
        input_scale = np.ones(len(inputs.mean))
        if is_by_channel:
            output_trim = outputs.mean
            output_scale = np.sqrt(outputs.variance)
        # Unknown inputs are not scaled, since they are not used.
        if has_known_inputs and is_by_channel:
            input_trim[:] = inputs.mean
            input_scale[:] = np.sqrt(inputs.variance.mean())
        if has_known_inputs and settings.scaling == "paper":
            input_trim[:] = inputs.mean.mean()
            input_scale[:] = inputs.highest.max() - inputs.lowest.min()
        return cls(
            input_trim,
            input_scale,
            output_trim,
            output_scale,
            constant=is_by_channel,
            known=has_known_inputs,
        )

    def scale_inputs(self, inputs: Array) -> Array:
        """Converts recorded inputs to the engine's units, and adds the constant input if the engine has one.

        Args:
            inputs: (T, r) inputs, in the unit of the recorded inputs.

        Returns:
            (T, r) inputs, or (T, r + 1) with a last column of ones. Recorded inputs that are not used are 0.
        """
        scaled = np.zeros_like(inputs)
        if self.known:
            scaled = (inputs - self.input_trim) / self.input_scale
        if self.constant:
            scaled = np.hstack([scaled, np.ones((len(scaled), 1))])
        return scaled

    def scale_outputs(self, outputs: Array) -> Array:
        """Converts outputs (T, m), rad and rad/s, to the engine's units."""
        return (outputs - self.output_trim) / self.output_scale

    def scale_segments(self, record: Record) -> Segments:
        """Returns the inputs and outputs of each segment of a record, in the engine's units."""
        return [
            SegmentSamples(self.scale_inputs(inputs), self.scale_outputs(outputs))
            for inputs, outputs in record.segments
        ]

    def physical_outputs(self, scaled_outputs: Array) -> Array:
        """Converts outputs (…, m) in the engine's units to rad and rad/s."""
        return self.output_trim + self.output_scale * scaled_outputs

    def state_scale(self, order: int) -> Array:
        """Returns the physical size of the engine's unit of each of n = ``order`` states, (n,).

        The first states have the units of the outputs; hidden states have the unit of the last output.
        """
        output_columns = np.minimum(np.arange(order), len(self.output_scale) - 1)
        return self.output_scale[output_columns]

    def parameter_scale(self, order: int) -> Array:
        """Returns the factors that convert the parameters θ of the engine to physical units.

        The engine fits ẋ = A x + B v, y = C x to scaled channels; θ has the entries of A, B and C. A row of A or B
        belongs to the derivative of a state, a column to a state or an input: the factor of an entry is the scale of
        its row over that of its column. In C a row belongs to an output, a column to a state.

        Args:
            order: number of states n.

        Returns:
            The factors (k,): physical parameter over parameter of the engine.
        """
        state_scale = self.state_scale(order)
        input_scale = self.input_scale
        if self.constant:
            # The constant input is 1 in both units.
            input_scale = np.append(input_scale, 1.0)
        A_factors = np.outer(state_scale, 1 / state_scale)
        B_factors = np.outer(state_scale, 1 / input_scale)
        C_factors = np.outer(self.output_scale, 1 / state_scale)
        return pack(A_factors, B_factors, C_factors)

    def physical_model(self, theta: Array, order: int) -> LinearModel:
        """Converts parameters θ to a model in physical units.

        Args:
            theta: (k,) parameters in the engine's units; B has an additional column if there is a constant input.
            order: number of states.

        Returns:
            The model of deviations from the trim. Its ``offset`` is the column of B for the constant input, and 0 if
            there is no constant input.
        """
        r = len(self.input_trim)
        m = len(self.output_trim)
        engine_inputs = r + 1 if self.constant else r
        A, B, C = unpack(theta * self.parameter_scale(order), order, engine_inputs, m)
        # The constant input is 1, so that its column of B is a constant rate of the states.
        offset = B[:, r].copy() if self.constant else np.zeros(order)
        return LinearModel(A, B[:, :r].copy(), C, offset, self.input_trim, self.output_trim)
