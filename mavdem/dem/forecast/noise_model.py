"""The noise model (Box and Jenkins): errors of prediction follow from those before and the inputs' last changes.

By least squares, each coefficient with a prior worth a few samples (a VARX model; docs/method.md):

    e(t) = Σᵢ Aᵢ e(t − i) + Σⱼ Gⱼ Δu(t − j) + ν(t)

Past errors and inputs are part of a longer state, so that the result is a :class:`StateSpace` like any other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.forecast.var import lagged

LAG_SECONDS, FEWEST_LAGS, MOST_LAGS = 0.025, 3, 6
"""Past errors that count, and changes of the inputs, the one into the sample itself first: those of so many seconds,
within these numbers."""

PRIOR_SAMPLES = 10.0  # weight, in samples, of each coefficient's prior, which has mean zero
MAX_SPECTRAL_RADIUS = 0.995  # of the recursion of errors: they decay at least so fast with each sample
LEAST_RMS = 1e-12  # regressors smaller than this, such as the changes of a constant input, get no coefficient


def lags_of(dt: float) -> int:
    """How many past errors and changes count where samples are ``dt`` s apart."""
    return min(max(round(LAG_SECONDS / dt), FEWEST_LAGS), MOST_LAGS)


def with_noise_model(
    predictor: StateSpace, segments: Sequence[tuple[Array, Array]], lags: int = FEWEST_LAGS
) -> StateSpace:
    """The predictor with a model of its own one-step errors, learnt from segments in the engine's units.

    Segments that are too short do not count.
    """
    m, r = len(predictor.C), predictor.B.shape[1]
    size = lags * m + lags * r
    gram, cross = np.zeros((size, size)), np.zeros((size, m))
    for inputs, outputs in segments:
        # An error needs a sample before it, and so does a change; that into the sample itself counts.
        errors, changes = outputs[1:] - predictor.one_step(inputs, outputs), np.diff(inputs, axis=0)
        regressors = np.hstack([lagged(errors, lags), lagged(np.vstack([changes, changes[-1:]]), lags)[1:]])
        gram += regressors.T @ regressors
        cross += regressors.T @ errors[len(errors) - len(regressors) :]
    number = max(1, sum(len(outputs) for _, outputs in segments))
    sizes = np.sqrt(np.diag(gram) / number)
    sizes[sizes < LEAST_RMS] = np.inf
    ridge = gram / np.outer(sizes, sizes) + PRIOR_SAMPLES * np.eye(size)
    coefficients = np.linalg.solve(ridge, cross / sizes[:, None]).T / sizes
    return _extended(predictor, _decaying(coefficients[:, : lags * m]), coefficients[:, lags * m :])


def _decaying(of_errors: Array) -> Array:
    """The coefficients (m, ·), each A_i times ρⁱ with ρ < 1 where errors would not decay by themselves."""
    m, size = of_errors.shape
    companion = np.vstack([of_errors, np.eye(size - m, size)])
    radius = np.abs(np.linalg.eigvals(companion)).max()
    shrunk = min(1.0, MAX_SPECTRAL_RADIUS / max(radius, MAX_SPECTRAL_RADIUS)) ** np.arange(1, size // m + 1)
    return np.asarray(of_errors * np.repeat(shrunk, m))


def _extended(predictor: StateSpace, of_errors: Array, of_changes: Array) -> StateSpace:
    """With the state [x; e(t − 1) …; u(t − 1) …], for coefficients (m, ·) of past errors and of changes.

    The filter moves x by K e, whatever part of e was expected.
    """
    A, B, C, D, K, *_ = predictor
    (m, n), r = C.shape, B.shape[1]
    lags = of_errors.shape[1] // m
    assert predictor.second_of_outputs is not None and predictor.second_of_inputs is not None
    # Σⱼ Gⱼ Δu(t − j) in terms of u(t), u(t − 1), …
    changes = of_changes.reshape(m, lags, r)
    of_inputs = np.zeros((m, lags + 1, r))
    of_inputs[:, :-1] += changes
    of_inputs[:, 1:] -= changes
    expected = np.hstack([np.zeros((m, n)), of_errors, of_inputs[:, 1:].reshape(m, -1)])
    expected_now = of_inputs[:, 0]

    past = n + lags * m
    size = past + lags * r
    state, driven, corrected = np.zeros((size, size)), np.zeros((size, r)), np.zeros((size, m))
    state[:n, :n] = A
    state[:n] += K @ expected
    driven[:n], corrected[:n] = B + K @ expected_now, K
    state[n : n + m], driven[n : n + m], corrected[n : n + m] = expected, expected_now, np.eye(m)
    # Errors and inputs move one place back.
    state[n + m : past, n : past - m] = np.eye((lags - 1) * m)
    driven[past : past + r] = np.eye(r)
    state[past + r :, past : size - r] = np.eye((lags - 1) * r)

    outputs = expected.copy()
    outputs[:, :n] = C
    no_errors = np.zeros((lags * m, r))
    return predictor._replace(
        A=state,
        B=driven,
        C=outputs,
        D=D + expected_now,
        K=corrected,
        offset=np.zeros(size),
        second_of_outputs=np.vstack([predictor.second_of_outputs, np.zeros((size - n, m))]),
        second_of_inputs=np.vstack([predictor.second_of_inputs, no_errors, *[np.eye(r)] * lags]),
    )
