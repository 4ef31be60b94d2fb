"""Priors of the parameters and hyperparameters, in the engine's own units."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from mavdem.dem.model import pack
from mavdem.dem.settings import Settings

Array = NDArray[np.float64]

KNOWN = float(np.exp(20.0))
"""Precision of a parameter that is known: its prior standard deviation is 5e-5."""

KINEMATIC = 1e4
"""Precision of a kinematic relation: exact on paper, but the two outputs come from different sensors."""

NATURAL_FREQUENCY, DAMPING_RATE = 3.0, 5.0
"""A held attitude returns to trim: ω₀ (rad/s) and 2ζω₀ (1/s) of the "regulated" prior; ζ is about 0.8."""

ACTUATOR_RATE = 20.0
"""1/s: the "regulated" prior of an actuator lag of 50 ms, between the 20 and 100 ms of common multirotors."""

KINEMATIC_SHARE = 0.5
"""An output is taken for the derivative of another when it explains more than this share of its changes."""

KINEMATIC_SPAN = 0.2
"""Seconds over which the changes are compared: long enough for noise to average out, short against the motion."""


class Prior(NamedTuple):
    """Gaussian priors of θ and λ."""

    theta_mean: Array  # (k,)
    theta_precision: Array  # (k, k)
    lambda_mean: Array  # (g,)
    lambda_precision: Array  # (g, g)


def derivative_pairs(outputs: Array, dt: float) -> tuple[tuple[int, int], ...]:
    """Pairs (i, j) of output columns where j is the time derivative of i, judged from the samples (T, m)."""
    span = max(1, round(KINEMATIC_SPAN / dt))
    if len(outputs) <= span:
        return ()
    integrated = cumulative_trapezoid(outputs, dx=dt, axis=0, initial=0)
    changes, integrals = outputs[span:] - outputs[:-span], integrated[span:] - integrated[:-span]
    pairs = []
    for i, change in enumerate(changes.T):
        left = (change[:, None] - integrals).var(axis=0)
        left[i] = np.inf
        j = int(np.argmin(left))
        if left[j] < (1 - KINEMATIC_SHARE) * change.var():
            pairs.append((i, j))
    return tuple(pairs)


def hyperparameter_prior(settings: Settings, n: int, m: int) -> tuple[Array, Array]:
    """Mean (g,) and precision (g, g) of λ: measurement noise first, then process noise."""
    outputs, states = (m, n) if settings.lambda_per_channel else (1, 1)
    mean = np.repeat([settings.lambda_z, settings.lambda_w], [outputs, states])
    precision = np.repeat([settings.lambda_z_precision, settings.lambda_w_precision], [outputs, states])
    return mean, np.diag(precision)


def uniform_prior(settings: Settings, n: int, r: int, m: int) -> tuple[Array, Array]:
    """η drawn from U[−1, 1] and P = ``parameter_precision``·I for every parameter (the paper, ``alg_settings``)."""
    assert settings.parameter_precision is not None
    k = n * n + n * r + m * n
    mean = np.random.default_rng(settings.seed).uniform(-1, 1, k)
    return mean, np.eye(k) * settings.parameter_precision


def regulated_prior(
    settings: Settings, n: int, motors: int, constant: bool, scale: Array, pairs: tuple[tuple[int, int], ...]
) -> tuple[Array, Array]:
    """What is known of any attitude loop before a flight.

    Outputs return to their trim; where output j is the derivative of output i, row i of the model says just that;
    each hidden state is a lag that feeds the state before it (the first one, the last output); C = [I 0].

    Args:
        settings: with ``parameter_precision`` chosen.
        n: states.
        motors: inputs that are motors; ``constant``: whether one more, after them, is the constant.
        scale: (m,) physical size of a unit of each output.
        pairs: of :func:`derivative_pairs`.

    Returns:
        mean (k,) and precision (k, k) of θ.
    """
    assert settings.parameter_precision is not None
    m = len(scale)
    weak = settings.parameter_precision
    r = motors + constant
    A, A_precision = np.zeros((n, n)), np.full((n, n), weak)
    B, B_precision = np.zeros((n, r)), np.full((n, r), weak)
    C, C_precision = np.eye(m, n), np.full((m, n), KNOWN)
    np.fill_diagonal(A[:m, :m], -DAMPING_RATE)
    for angle, rate in pairs:
        A[angle, angle] = 0.0
        A[angle, rate] = scale[rate] / scale[angle]
        A[rate, angle] = -(NATURAL_FREQUENCY**2) * scale[angle] / scale[rate]
        A_precision[angle], B_precision[angle, :motors] = KINEMATIC, KINEMATIC
    for hidden in range(m, n):
        A[hidden, hidden] = -ACTUATOR_RATE
        # The unit of a hidden state is free; this fixes it, so that the posterior is about the vehicle.
        A[hidden - 1, hidden] = ACTUATOR_RATE
        A_precision[hidden, :m], A_precision[hidden - 1, hidden] = KINEMATIC, KINEMATIC
    return pack(A, B, C), np.diag(pack(A_precision, B_precision, C_precision))
