"""The engine's units, centred, of unit size and with a constant input for the trim, and priors in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mavdem.arrays import Array, ArrayPair, Indices
from mavdem.dem.engine.model import LinearModel, pack, unpack
from mavdem.dem.record import Record, Segments
from mavdem.dem.settings import CompleteSettings, Gaussian, Settings
from mavdem.unit_errors import RATE_INTEGRATION_SPAN


@dataclass(frozen=True, eq=False)
class Scaling:
    """y = output_trim + output_scale · (engine's y), and likewise for inputs."""

    input_trim: Array  # (r,)
    input_scale: Array  # (r,)
    output_trim: Array  # (m,)
    output_scale: Array  # (m,)
    constant: bool  # whether one more input, after the motors, is 1
    known: bool  # whether the inputs count; if not, the engine has 0, in a unit of its own

    @classmethod
    def from_record(cls, record: Record, settings: Settings) -> Scaling:
        """Returns the scaling that ``settings.scaling`` asks for.

        Raises ``ValueError`` where an output or all inputs are constant.
        """
        inputs, outputs = record.channel_statistics
        has_inputs = settings.known_inputs
        record.require_varying(has_inputs and not inputs.varying.any())
        m = len(outputs.mean)
        constant = settings.scaling == "channel"
        output_trim = np.zeros(m)
        output_scale = np.ones(m)
        trim = np.zeros(len(inputs.mean))
        scale = np.ones(len(inputs.mean))
        if constant:
            output_trim = outputs.mean
            output_scale = np.sqrt(outputs.variance)
        if has_inputs and constant:
            trim[:] = inputs.mean
            # One scale for all inputs: the noise of a motor that hardly moves must not be amplified.
            scale[:] = np.sqrt(inputs.variance.mean())
        if has_inputs and settings.scaling == "paper":
            trim[:] = inputs.mean.mean()
            scale[:] = inputs.highest.max() - inputs.lowest.min()
        return cls(trim, scale, output_trim, output_scale, constant, has_inputs)

    def scale_inputs(self, inputs: Array) -> Array:
        """Brings (T, r) inputs in the unit of the stream to (T, r or r + 1) in the engine's."""
        scaled = (
            (inputs - self.input_trim) / self.input_scale if self.known else np.zeros_like(inputs)
        )
        return np.hstack([scaled, np.ones((len(scaled), 1))]) if self.constant else scaled

    def scale_segments(self, record: Record) -> Segments:
        """Returns inputs and outputs of each segment of a record, in the engine's units."""
        return [
            (self.scale_inputs(inputs), self.scale_outputs(outputs))
            for inputs, outputs in record.segments
        ]

    def scale_outputs(self, outputs: Array) -> Array:
        """Brings (T, m) outputs in rad and rad/s to the engine's units."""
        return (outputs - self.output_trim) / self.output_scale

    def physical_outputs(self, scaled: Array) -> Array:
        """Brings (..., m) outputs in the engine's units back to rad and rad/s."""
        return self.output_trim + self.output_scale * scaled

    def state_scale(self, order: int) -> Array:
        """Returns (n,) physical size of a unit of each state; a hidden state has the last output's."""
        outputs = np.minimum(np.arange(order), len(self.output_scale) - 1)
        return self.output_scale[outputs]

    def parameter_scale(self, order: int) -> Array:
        """Returns (k,) physical size of a unit of each parameter, for the engine's θ."""
        state = self.state_scale(order)
        inputs = 1 / self.input_scale
        if self.constant:
            inputs = np.append(inputs, 1.0)
        return pack(
            np.outer(state, 1 / state),
            np.outer(state, inputs),
            np.outer(self.output_scale, 1 / state),
        )

    def physical_model(self, theta: Array, order: int) -> LinearModel:
        """Returns the model of the engine's θ (k,) in physical units."""
        r = len(self.input_trim)
        m = len(self.output_trim)
        A, B, C = unpack(theta * self.parameter_scale(order), order, r + self.constant, m)
        offset = B[:, r].copy() if self.constant else np.zeros(order)
        return LinearModel(A, B[:, :r].copy(), C, offset, self.input_trim, self.output_trim)


KNOWN = np.exp(20.0)  # precision of a known parameter: its prior standard deviation is 5e-5
# precision of a kinematic relation: exact on paper, but the two outputs come from different sensors
KINEMATIC_PRECISION = 1e4

NATURAL_FREQUENCY = 3.0
DAMPING_RATE = 5.0
"""A controlled attitude returns to trim: ω₀ (rad/s) and 2ζω₀ (1/s) of the "regulated" prior; ζ is about 0.8."""

ACTUATOR_RATE = 20.0
"""1/s: the "regulated" prior of an actuator lag of 50 ms, between the 20 and 100 ms of common multirotors."""

KINEMATIC_SHARE = 0.5
"""An output counts as the derivative of another when it explains more than this share of its changes."""

# over which the changes are compared: long enough to average noise, short against the motion


def derivative_pairs(record: Record) -> tuple[tuple[int, int], ...]:
    """Returns pairs (i, j) of output columns where j is the time derivative of i, computed from the samples."""
    from scipy.integrate import cumulative_trapezoid  # it takes half a second to import

    span = max(1, round(RATE_INTEGRATION_SPAN / record.dt))
    moved = []
    for _, outputs in record.segments:
        integral = cumulative_trapezoid(outputs, dx=record.dt, axis=0, initial=0)
        both = np.stack([outputs, integral])
        moved.append(both[:, span:] - both[:, :-span])
    change, integral = np.concatenate(moved, axis=1)
    if not len(change):
        return ()
    left = (change[:, :, None] - integral[:, None]).var(axis=0)
    np.fill_diagonal(left, np.inf)
    likely = left < (1 - KINEMATIC_SHARE) * change.var(axis=0)[:, None]
    return tuple((i, j) for i, j in enumerate(left.argmin(axis=1).tolist()) if likely[i, j])


def explicit_prior(
    prior: Gaussian,
    weak: float,
    indices: Indices,
    scale: Array,
) -> ArrayPair:
    """Returns the engine's prior of the vehicle's θ, at these ``indices`` (k,), from a ``prior`` in physical units.

    Others have η = 0 and the prior precision ``weak``. ``scale`` is the physical size of a unit of each of the
    engine's.
    """
    theta, theta_precision = prior.arrays
    if len(theta) != len(indices):
        raise ValueError(
            f"prior must be of the {len(indices)} parameters of A, B and C, not of {len(theta)}"
        )
    mean = np.zeros(len(scale))
    precision = weak * np.eye(len(scale))
    mean[indices] = theta / scale[indices]
    precision[np.ix_(indices, indices)] = theta_precision * np.outer(scale[indices], scale[indices])
    return mean, precision


def regulated_prior(
    settings: CompleteSettings,
    n: int,
    motors: int,
    constant: bool,
    scale: Array,
    pairs: tuple[tuple[int, int], ...],
) -> ArrayPair:
    """Returns mean (k,) and precision (k, k) of θ: what is known of any attitude loop a priori.

    Outputs return to their trim; where output j is the derivative of output i, row i of the model is ẋᵢ = xⱼ; each
    hidden state is a lag that feeds the state before it (the first one, the last output); C = [I 0]. The input after
    the motors may be the ``constant``. ``scale`` (m,) is the physical size of a unit of each output.
    """
    m = len(scale)
    weak = settings.parameter_precision
    r = motors + constant
    A = np.zeros((n, n))
    A_precision = np.full((n, n), weak)
    B = np.zeros((n, r))
    B_precision = np.full((n, r), weak)
    C = np.eye(m, n)
    C_precision = np.full((m, n), KNOWN)
    np.fill_diagonal(A[:m, :m], -DAMPING_RATE)
    for angle, rate in pairs:
        A[angle, angle] = 0.0
        A[angle, rate] = scale[rate] / scale[angle]
        A[rate, angle] = -(NATURAL_FREQUENCY**2) * scale[angle] / scale[rate]
        A_precision[angle] = KINEMATIC_PRECISION
        B_precision[angle, :motors] = KINEMATIC_PRECISION
    for hidden in range(m, n):
        A[hidden, hidden] = -ACTUATOR_RATE
        # The unit of a hidden state is free; this fixes it, so that the posterior is about the vehicle.
        A[hidden - 1, hidden] = ACTUATOR_RATE
        A_precision[hidden, :m] = KINEMATIC_PRECISION
        A_precision[hidden - 1, hidden] = KINEMATIC_PRECISION
    return pack(A, B, C), np.diag(pack(A_precision, B_precision, C_precision))
