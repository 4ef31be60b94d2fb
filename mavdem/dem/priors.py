"""Gaussian priors of the model's parameters: the "regulated" prior of an attitude loop, and priors of the user."""

from __future__ import annotations

import numpy as np

from mavdem.arrays import Array, Indices, cumulative_integral
from mavdem.dem.engine.model import pack
from mavdem.dem.record import Record
from mavdem.dem.settings import CompleteSettings, Gaussian, MeanAndPrecision
from mavdem.unit_errors import RATE_INTEGRATION_SPAN

KNOWN_PRECISION = np.exp(20.0)
"""Prior precision of a known parameter, in the engine's units: its prior standard deviation is 5e-5."""

KINEMATIC_PRECISION = 1e4
"""Prior precision of a kinematic relation, such as φ' = p, in the engine's units: its standard deviation is 0.01.

The relation is exact, but its two sides come from different sensors. Parameters with at least this precision count as
fixed by the prior.
"""

NATURAL_FREQUENCY = 3.0
"""Natural frequency ω₀ of a controlled attitude in the "regulated" prior, rad/s. A choice: typical of multirotors."""

DAMPING_RATE = 5.0
"""Damping 2ζω₀ of a controlled attitude in the "regulated" prior, 1/s: a damping ratio ζ of about 0.8."""

ACTUATOR_RATE = 20.0
"""Rate of the actuator lag in the "regulated" prior, 1/s: a time constant of 50 ms.

Common multirotors have 20 to 100 ms.
"""

MIN_EXPLAINED_SHARE = 0.5
"""An output counts as the derivative of another where its integral explains more than this fraction of the changes."""

DerivativePairs = tuple[tuple[int, int], ...]
"""Pairs (i, j) of output columns where output j is the time derivative of output i."""


def derivative_pairs(record: Record) -> DerivativePairs:
    """Finds the outputs that are time derivatives of other outputs, such as the rate of an angle.

    The change of output i over a short span of time is compared with the integral of output j over the same span. If
    the integral explains more than ``MIN_EXPLAINED_SHARE`` of the variance of the changes, output j is the derivative.
    The span is ``RATE_INTEGRATION_SPAN``, long enough to average noise and short compared with the motion.

    Args:
        record: the training data: T samples of r inputs and m outputs, in one or several segments.

    Returns:
        Pairs (i, j) of columns, where output j is the derivative of output i; empty if all segments are too short.
    """
    span = max(1, round(RATE_INTEGRATION_SPAN / record.dt))
    changes_of_segments = []
    for _, outputs in record.segments:
        integrals = cumulative_integral(outputs, np.full(len(outputs) - 1, record.dt))
        signals = np.stack([outputs, integrals])
        changes_of_segments.append(signals[:, span:] - signals[:, :-span])
    # Changes of the outputs and of their integrals over one span, (T', m) each.
    output_changes, integral_changes = np.concatenate(changes_of_segments, axis=1)
    if not len(output_changes):
        return ()
    # Entry (i, j): variance of the changes of output i that the integral of output j leaves unexplained.
    differences = output_changes[:, :, None] - integral_changes[:, None]
    unexplained_variance = differences.var(axis=0)
    # No output is its own derivative.
    np.fill_diagonal(unexplained_variance, np.inf)
    max_unexplained_variance = (1 - MIN_EXPLAINED_SHARE) * output_changes.var(axis=0)
    pairs = []
    for output, variances in enumerate(unexplained_variance):
        best_derivative = int(variances.argmin())
        if variances[best_derivative] < max_unexplained_variance[output]:
            pairs.append((output, best_derivative))
    return tuple(pairs)


def explicit_prior(
    prior: Gaussian,
    default_precision: float,
    indices: Indices,
    scale: Array,
) -> MeanAndPrecision:
    """Converts a prior that the user gives in physical units to the engine's units.

    Args:
        prior: Gaussian of the vehicle's parameters [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)], in physical units.
        default_precision: prior precision of the engine's other parameters, whose prior mean is 0.
        indices: (j,) indices of the vehicle's j parameters in the engine's θ, which has k ≥ j.
        scale: (k,) size, in physical units, of the engine's unit of each parameter in its θ.

    Returns:
        Mean (k,) and precision (k, k) of the engine's θ.

    Raises:
        ValueError: the prior has another number of parameters than A, B and C.
    """
    theta, theta_precision = prior.arrays
    if len(theta) != len(indices):
        raise ValueError(
            f"prior must be of the {len(indices)} parameters of A, B and C, not of {len(theta)}"
        )
    mean = np.zeros(len(scale))
    precision = default_precision * np.eye(len(scale))
    # A parameter in the engine's units is the physical one divided by its scale; a precision is multiplied by the
    # product of two scales.
    mean[indices] = theta / scale[indices]
    precision[np.ix_(indices, indices)] = theta_precision * np.outer(scale[indices], scale[indices])
    return MeanAndPrecision(mean, precision)


def regulated_prior(
    settings: CompleteSettings,
    n: int,
    motors: int,
    *,
    has_constant_input: bool,
    output_scale: Array,
    pairs: DerivativePairs,
) -> MeanAndPrecision:
    """Returns the "regulated" prior of θ: what is known of any attitude loop before a flight.

    - Each output returns to its trim at the rate ``DAMPING_RATE``.
    - If output j is the derivative of output i, row i of the model is the kinematic relation ẋᵢ = xⱼ, and row j is that
      of a damped oscillator with ``NATURAL_FREQUENCY``.
    - Each hidden state is a first-order lag with ``ACTUATOR_RATE`` that acts on the rate of the state before it. The
      first one acts on the state of the last output, like the torque of motors with a lag.
    - C = [I 0].

    Args:
        settings: settings with the prior precision of free parameters.
        n: number of states; the first m are the outputs.
        motors: number of inputs without the constant one.
        has_constant_input: whether a constant input follows the motors.
        output_scale: (m,) physical size of the engine's unit of each output.
        pairs: outputs that are derivatives of others.

    Returns:
        Mean (k,) and diagonal precision (k, k) of θ, in the engine's units.
    """
    m = len(output_scale)
    free_precision = settings.parameter_precision
    r = motors + 1 if has_constant_input else motors
    A = np.zeros((n, n))
    A_precision = np.full((n, n), free_precision)
    B = np.zeros((n, r))
    B_precision = np.full((n, r), free_precision)
    C = np.eye(m, n)
    C_precision = np.full((m, n), KNOWN_PRECISION)
    np.fill_diagonal(A[:m, :m], -DAMPING_RATE)
    for angle, rate in pairs:
        # Row "angle" is φ' = p and row "rate" is p' = −ω₀² φ − 2ζω₀ p, in scaled units.
        A[angle, angle] = 0.0
        A[angle, rate] = output_scale[rate] / output_scale[angle]
        A[rate, angle] = -(NATURAL_FREQUENCY**2) * output_scale[angle] / output_scale[rate]
        A_precision[angle] = KINEMATIC_PRECISION
        B_precision[angle, :motors] = KINEMATIC_PRECISION
    for hidden_state in range(m, n):
        A[hidden_state, hidden_state] = -ACTUATOR_RATE
        # The data do not determine the unit of a hidden state. It is fixed by the known effect on the state before,
        # which has unit gain in steady state, so that the posterior of the other parameters describes the vehicle.
        A[hidden_state - 1, hidden_state] = ACTUATOR_RATE
        A_precision[hidden_state, :m] = KINEMATIC_PRECISION
        A_precision[hidden_state - 1, hidden_state] = KINEMATIC_PRECISION
    theta_mean = pack(A, B, C)
    theta_precisions = pack(A_precision, B_precision, C_precision)
    return MeanAndPrecision(theta_mean, np.diag(theta_precisions))
