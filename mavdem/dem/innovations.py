"""Innovations: what the errors of single steps tell of those to come.

Parameters that say how the motion unfolds over tenths of a second leave errors from one sample to the next which are
far from white: z has a colour, sensors are filtered, and motors answer later than one lag tells. So an error follows
from those before it and from the motors' last changes, as in the noise model of Box and Jenkins:

    e(t) = Σᵢ Aᵢ e(t − i) + Σⱼ Gⱼ Δu(t − j) + ν(t)

by least squares over the training data, each coefficient with a prior worth a few samples. What it adds dies away
within some tenths of a second; then the model is by itself again. Errors and inputs remembered are part of a longer
state, so that whoever filters and forecasts with a predictor need not know of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.model import Transition
from mavdem.dem.parts import Parts
from mavdem.dem.prediction import Predictor

Array = NDArray[np.float64]

ERRORS = 3
"""Samples back to which errors count."""

CHANGES = 3
"""Changes of the inputs that count, the one into the sample itself first."""

PRIOR_SAMPLES = 10.0
"""So many samples the prior of a coefficient is worth, that it is zero."""

LONGEST = 0.995
"""What an error tells of those to come is at most so much less with each sample."""

SMALLEST = 1e-12
"""Root mean square of what counts for nothing, such as the changes of an input that is constant."""


def with_innovations_by_parts(predictor: Predictor, segments: Sequence[tuple[Array, Array]]) -> Parts[Predictor]:
    """The predictor with the colour of its own errors, learnt from a record; in parts.

    Args:
        predictor: of the vehicle's state alone.
        segments: inputs (T, r) and outputs (T, m), in the engine's units; what is too short tells nothing.
    """
    m, n = predictor.C.shape
    r = predictor.transition.input_now.shape[1]
    size = ERRORS * m + CHANGES * r
    gram, cross = np.zeros((size, size)), np.zeros((size, m))
    for inputs, outputs in segments:
        # An error needs a sample before it, and so does a change.
        errors = outputs[1:] - predictor.one_step(outputs, inputs)
        yield
        told = _told(errors, np.diff(inputs, axis=0))
        yield
        gram += told.T @ told
        cross += told.T @ errors[len(errors) - len(told) :]
        yield
    number = max(1, sum(len(outputs) for _, outputs in segments))
    sizes = np.sqrt(np.diag(gram) / number)
    sizes[sizes < SMALLEST] = np.inf
    ridge = gram / np.outer(sizes, sizes) + PRIOR_SAMPLES * np.eye(size)
    coefficients = np.linalg.solve(ridge, cross / sizes[:, None]).T / sizes
    return _longer(predictor, _fading(coefficients[:, : ERRORS * m]), coefficients[:, ERRORS * m :])


def _fading(of_errors: Array) -> Array:
    """The coefficients (m, ·), each A_i less by ρⁱ where what they tell would not die away by itself."""
    m = len(of_errors)
    companion = np.vstack([of_errors, np.eye((ERRORS - 1) * m, ERRORS * m)])
    radius = np.abs(np.linalg.eigvals(companion)).max()
    fading = min(1.0, LONGEST / max(radius, LONGEST)) ** np.arange(1, ERRORS + 1)
    return np.asarray(of_errors * np.repeat(fading, m))


def _told(errors: Array, changes: Array) -> Array:
    """(T, ·) the errors before each error, the latest first, and the changes up to its sample, likewise."""
    longest = max(ERRORS, CHANGES - 1)
    length = max(0, len(errors) - longest)
    past = [errors[longest - i : longest - i + length] for i in range(1, ERRORS + 1)]
    recent = [changes[longest - j : longest - j + length] for j in range(CHANGES)]
    return np.hstack([*past, *recent])


def _longer(predictor: Predictor, of_errors: Array, of_changes: Array) -> Predictor:
    """With the state [x; e(t) …; u(t − 1) …], of a predictor with the state x and coefficients (m, ·).

    The filter moves x by K e, whatever part of e was expected; so does what is expected of e, before the sample comes.
    """
    (m, n), r = predictor.C.shape, predictor.transition.input_now.shape[1]
    K, C = predictor.gain, predictor.C
    G = of_changes.reshape(m, CHANGES, r)
    errors, past = slice(n, n + ERRORS * m), n + ERRORS * m
    size = past + (CHANGES - 1) * r
    first = slice(n, n + m)

    state, now, later = np.zeros((size, size)), np.zeros((size, r)), np.zeros((size, r))
    state[:n, :n], now[:n], later[:n] = predictor.transition
    # What is expected of the next error: Δu(t + 1) = u(t + 1) − u(t), and so on back.
    of_inputs = np.zeros((m, CHANGES + 1, r))
    of_inputs[:, :-1] += G
    of_inputs[:, 1:] -= G
    expected, expected_now, expected_later = np.zeros((m, size)), of_inputs[:, 1], of_inputs[:, 0]
    expected[:, errors], expected[:, past:] = of_errors, of_inputs[:, 2:].reshape(m, -1)
    state[first], now[first], later[first] = expected, expected_now, expected_later
    state[:n], now[:n], later[:n] = state[:n] + K @ expected, now[:n] + K @ expected_now, later[:n] + K @ expected_later
    # Errors and inputs move one place back.
    state[n + m : past, n : past - m] = np.eye((ERRORS - 1) * m)
    now[past : past + r] = np.eye(r)
    state[past + r :, past : size - r] = np.eye((CHANGES - 2) * r)

    outputs = np.hstack([C, np.eye(m) - C @ K, np.zeros((m, size - n - m))])
    gain = np.vstack([K, np.eye(m), np.zeros((size - n - m, m))])
    of_outputs = np.vstack([predictor.of_outputs, np.zeros((size - n, m))])
    long_held = np.vstack([predictor.of_inputs, np.zeros((ERRORS * m, r)), *[np.eye(r)] * (CHANGES - 1)])
    return Predictor(Transition(state, now, later), outputs, gain, of_outputs, long_held)
