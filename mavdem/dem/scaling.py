"""Between the vehicle's units and the engine's: centred, of unit size, with a constant input for the trim."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import LinearModel, pack, unpack
from mavdem.dem.record import Record
from mavdem.dem.settings import Settings


class Scaling(NamedTuple):
    """y = output_trim + output_scale · (engine's y), and likewise for inputs."""

    input_trim: Array  # (r,)
    input_scale: Array  # (r,)
    output_trim: Array  # (m,)
    output_scale: Array  # (m,)
    constant: bool  # whether one more input, after the motors, is 1
    known: NDArray[np.bool_]  # (r,) which of the inputs count; of the others the engine has 0, in a unit of its own

    @classmethod
    def of(cls, record: Record, settings: Settings) -> Scaling:
        """The scaling that ``settings.scaling`` asks for; ``ValueError`` where an output or all inputs are constant."""
        inputs, outputs = record.spread
        known = known_inputs(settings, len(inputs.mean))
        record.require_moving(known & ~inputs.moving[known].any())
        m, constant = len(outputs.mean), settings.scaling == "channel"
        output_trim, output_scale = np.zeros(m), np.ones(m)
        trim, scale = np.zeros(len(known)), np.ones(len(known))
        if settings.scaling == "channel":
            output_trim, output_scale = outputs.mean, np.sqrt(outputs.variance)
        if known.any() and settings.scaling == "channel":
            trim[known] = inputs.mean[known]
            # One scale for all inputs: the noise of a motor that hardly moves must not be amplified.
            scale[known] = np.sqrt(inputs.variance[known].mean())
        if known.any() and settings.scaling == "paper":
            trim[known] = inputs.mean[known].mean()
            scale[known] = inputs.highest[known].max() - inputs.lowest[known].min()
        return cls(trim, scale, output_trim, output_scale, constant, known)

    def scale_inputs(self, inputs: Array) -> Array:
        """(T, r) in the unit of the stream to (T, r or r + 1) in the engine's."""
        scaled = np.where(self.known, (inputs - self.input_trim) / self.input_scale, 0.0)
        return np.hstack([scaled, np.ones((len(scaled), 1))]) if self.constant else scaled

    def scale_segments(self, record: Record) -> list[tuple[Array, Array]]:
        """Inputs and outputs of each segment of a record, in the engine's units."""
        return [(self.scale_inputs(inputs), self.scale_outputs(outputs)) for inputs, outputs in record.segments]

    def scale_outputs(self, outputs: Array) -> Array:
        """(T, m) in rad and rad/s to the engine's units."""
        return (outputs - self.output_trim) / self.output_scale

    def physical_outputs(self, scaled: Array) -> Array:
        """(..., m) in the engine's units back to rad and rad/s."""
        return self.output_trim + self.output_scale * scaled

    def state_scale(self, order: int) -> Array:
        """(n,) physical size of a unit of each state; a hidden state has the last output's."""
        extra = max(order - len(self.output_scale), 0)
        return np.append(self.output_scale, np.repeat(self.output_scale[-1], extra))[:order]

    def parameter_scale(self, order: int) -> Array:
        """(k,) physical size of a unit of each parameter, for the engine's θ."""
        state, inputs = self.state_scale(order), 1 / self.input_scale
        if self.constant:
            inputs = np.append(inputs, 1.0)
        return pack(np.outer(state, 1 / state), np.outer(state, inputs), np.outer(self.output_scale, 1 / state))

    def physical_model(self, theta: Array, order: int) -> LinearModel:
        """The model of the engine's θ (k,) in physical units."""
        r, m = len(self.input_trim), len(self.output_trim)
        A, B, C = unpack(theta * self.parameter_scale(order), order, r + self.constant, m)
        offset = B[:, r].copy() if self.constant else np.zeros(order)
        return LinearModel(A, B[:, :r].copy(), C, offset, self.input_trim, self.output_trim)


def known_inputs(settings: Settings, inputs: int) -> NDArray[np.bool_]:
    """(r,) which of so many recorded inputs are known; ``ValueError`` where settings are of another number."""
    if isinstance(settings.known_inputs, tuple) and len(settings.known_inputs) != inputs:
        raise ValueError(f"known_inputs must say it of {inputs} inputs, not of {len(settings.known_inputs)}")
    return np.broadcast_to(np.array(settings.known_inputs), inputs).copy()
