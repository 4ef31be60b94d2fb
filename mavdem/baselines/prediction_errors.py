"""One-step prediction errors of a model in innovation form, and how they change with each of its parameters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space
from scipy.signal import lfilter

from mavdem.baselines.state_space import StateSpace
from mavdem.baselines.units import Segments
from mavdem.dem.recursion import WORST_MODES

Array = NDArray[np.float64]


class Parameters(NamedTuple):
    """What is varied: all of A, B, C, K and the offset, D where there is feedthrough, and where segments begin.

    As a vector they follow each other in the order of these fields, rows first.
    """

    A: Array  # (n, n)
    B: Array  # (n, k)
    C: Array  # (m, n)
    D: Array  # (m, k), or (m, 0) without feedthrough
    K: Array  # (n, m)
    offset: Array  # (n,)
    starts: Array  # (segments, n)

    def vector(self) -> Array:
        """All of them, one after the other."""
        return np.concatenate([part.ravel() for part in self])

    def of(self, vector: Array) -> Parameters:
        """Parameters of the same shapes out of a vector."""
        cuts = np.cumsum([part.size for part in self])[:-1]
        return Parameters(
            *(values.reshape(part.shape) for values, part in zip(np.split(vector, cuts), self, strict=True))
        )

    def telling(self) -> Array:
        """(parameters, ·): an orthonormal basis of the changes that change more than the choice of states.

        Its complement is what x → (1 + T) x + c does to the parameters, for any T and for those c which C does not see
        (McKelvey, Helmersson and Ribarits, Data driven local coordinates, Automatica 40(9), 2004).
        """
        A, B, C, D, K, offset, starts = self
        n, unseen = len(A), null_space(C)
        units = np.eye(n * n).reshape(-1, n, n)
        turned = [Parameters(T @ A - A @ T, T @ B, -C @ T, 0 * D, T @ K, T @ offset, starts @ T.T) for T in units]
        nothing = Parameters(*(np.zeros_like(part) for part in self))
        moved = [nothing._replace(offset=c - A @ c, starts=np.tile(c, (len(starts), 1))) for c in unseen.T]
        complement = np.stack([change.vector() for change in turned + moved], axis=1)
        return np.asarray(np.linalg.qr(complement, mode="complete").Q[:, complement.shape[1] :])


def prediction_errors(parameters: Parameters, model: StateSpace, segments: Segments) -> Array:
    """(T, m): of each sample of all segments."""
    model = with_parameters(model, parameters)
    ahead = [model.predicted(start, *segment) for start, segment in zip(parameters.starts, segments, strict=True)]
    return np.concatenate([outputs for _, outputs in segments]) - np.concatenate(ahead)


def with_parameters(model: StateSpace, parameters: Parameters) -> StateSpace:
    """The model with these parameters, which has its trims from before."""
    A, B, C, D, K, offset, _ = parameters
    return StateSpace(A, B, C, D if D.size else np.zeros_like(model.D), K, offset, model.input_trim, model.output_trim)


def sensitivities(parameters: Parameters, model: StateSpace, segments: Segments) -> Array:
    """(T, m, parameters): derivatives of :func:`prediction_errors`, exact.

    A small change of the state runs through the same recursion x⁺ = (A − K C) x + … as the state (Ljung, System
    Identification, 2nd ed., sec. 10.3), so every derivative is made of that recursion's answers to states, inputs, a
    constant and errors.
    """
    model = with_parameters(model, parameters)
    return np.concatenate([_of_segment(model, parameters, number, *segment) for number, segment in enumerate(segments)])


def _of_segment(model: StateSpace, parameters: Parameters, number: int, inputs: Array, outputs: Array) -> Array:
    A, B, C, D, K, *_ = parameters
    (n, k), m, samples = B.shape, len(C), len(outputs)
    states = model.filtered(parameters.starts[number], inputs, outputs)[:-1]
    errors = outputs - states @ C.T - model.direct(inputs)
    inputs = inputs - model.input_trim
    signals = np.hstack([states, inputs, np.ones((samples, 1)), errors])
    # What pulses into each state do to each predicted output.
    answers, decay = _answers(A - K @ C, C, signals)
    of_states, of_inputs, of_constant, of_errors = np.split(answers, np.cumsum([n, k, 1]), axis=3)
    of_C = -np.einsum("tmls,li->tmis", of_states, K) + np.einsum("mi,ts->tmis", np.eye(m), states)
    of_D = -np.einsum("tmls,li->tmis", of_inputs, K) + np.einsum("mi,ts->tmis", np.eye(m), inputs)
    of_starts = np.zeros((samples, m, *parameters.starts.shape))
    of_starts[:, :, number] = decay
    parts = [of_states, of_inputs, of_C, of_D if D.size else of_D[..., :0], of_errors, of_constant, of_starts]
    return -np.concatenate([part.reshape(samples, m, -1) for part in parts], axis=2)


def _answers(F: Array, C: Array, signals: Array) -> tuple[Array, Array]:
    """What C x does when one signal (T, s) pushes one state of x⁺ = F x: (T, m, n, s); and of x₀ alone: (T, m, n)."""
    samples, n = len(signals), len(F)
    eigenvalues, modes = np.linalg.eig(F)
    if np.linalg.cond(modes) > WORST_MODES:
        return _answers_by_sample(F, C, signals)
    driven = np.stack([lfilter([0.0, 1.0], [1.0, -value], signals.astype(complex), axis=0) for value in eigenvalues])
    through = (C @ modes)[:, None, :] * np.linalg.inv(modes).T[None]
    m = len(C)
    answers = (through.reshape(m * n, n) @ driven.reshape(n, -1)).real.reshape(m, n, samples, -1)
    powers = eigenvalues[:, None] ** np.arange(samples)
    decay = (through.reshape(m * n, n) @ powers).real.reshape(m, n, samples)
    return answers.transpose(2, 0, 1, 3), decay.transpose(2, 0, 1)


def _answers_by_sample(F: Array, C: Array, signals: Array) -> tuple[Array, Array]:
    (samples, number), n = signals.shape, len(F)
    answers, decay = np.empty((samples, len(C), n, number)), np.empty((samples, len(C), n))
    state, power = np.zeros((n, n, number)), np.eye(n)
    for t in range(samples):
        answers[t], decay[t] = np.tensordot(C, state, 1), C @ power
        state = np.tensordot(F, state, 1) + np.eye(n)[:, :, None] * signals[t]
        power = F @ power
    return answers, decay
