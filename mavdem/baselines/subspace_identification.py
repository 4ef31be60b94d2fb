"""Subspace identification: states are projections of the past onto the future, the model their regression."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from mavdem.baselines.identified import (
    LEAST_VARIANCE,
    RANK_TOLERANCE,
    Fitted,
    Identified,
    Segments,
    identified,
    regression,
    triangle,
)
from mavdem.dem.engine.kalman import steady_gain
from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.model import recursion
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.record import UniformRecord, required_number
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.forecasts import Forecasts

LONGEST_HORIZON = 20  # samples of past and of future that the state is found from, at most
WINDOWS_PER_COLUMN = 2  # so many windows there must be for each number in one of them


def subspace(train: UniformRecord | Sequence[UniformRecord], order: int = 2) -> Identified:
    """A state-space model of ``order`` states from projections, without iterations.

    The states are the combinations of the past that predict the future best, given the future inputs: canonical
    correlations (CVA, Larimore 1990). y is regressed on them for C, their successors on them and u for A and B, and K
    is the steady Kalman gain of the residuals' covariances (Van Overschee and De Moor, Subspace Identification for
    Linear Systems, 1996, ch. 4; Katayama, Subspace Methods for System Identification, 2005, ch. 10). Biased in closed
    loop.

    Past and future are as long as the ARX model that Akaike's criterion chooses, but longer than the order needs. The
    state in which a segment begins is estimated from that segment.

    Args:
        train: a ``Flight``, or a list of them, segments with gaps between: no window reaches across a gap.
        order: number of states.

    Raises:
        ValueError: too few samples for the order, values that are not finite, an output that does not vary, or an order
            that is none.
    """
    order = required_number(order, "order")
    return identified(
        f"subspace({order})", train, lambda segments: found_by_projection(segments, order)
    )


def found_by_projection(segments: Segments, order: int) -> Fitted:
    """The model of inputs and outputs of each segment."""
    horizon = _horizon(segments, order)
    (k, m) = (table.shape[1] for table in segments[0])
    windows = Windows.of(segments, 2 * horizon)
    state_map = _state_map(windows, order, horizon, k)
    states = windows.part(0, horizon) @ state_map
    successors = windows.part(1, horizon + 1) @ state_map
    inputs, outputs = np.split(windows.part(horizon, horizon + 1), [k], axis=1)

    regressors = np.hstack([windows.constant, states])
    of_outputs = regression(regressors, outputs)
    innovations = outputs - regressors @ of_outputs
    output_trim, C = np.split(of_outputs.T, [1], axis=1)

    regressors = np.hstack([windows.constant, states, inputs])
    of_successors = regression(regressors, successors).T
    offset, A, B = np.split(of_successors, [1, 1 + order], axis=1)
    errors = np.hstack([successors - regressors @ of_successors.T, innovations])
    covariance = errors.T @ errors / windows.number
    Q = covariance[:order, :order]
    S = covariance[:order, order:]
    R = covariance[order:, order:]
    try:
        K = innovation_gain(A, C, Q, R, S)
    except np.linalg.LinAlgError:
        raise NotLearnable(Fact(Forecasts.NOT_OBSERVABLE, order=order)) from None
    model = StateSpace(A, B, C, np.zeros((m, k)), K, offset[:, 0], np.zeros(k), output_trim[:, 0])
    return Fitted(model, estimated_starts(model, segments, R))


def _horizon(segments: Segments, order: int) -> int:
    """How many samples of past and of future to look at: as many lags as the best ARX model has.

    By Akaike's criterion, as is usual with canonical variates (Peternell, Scherrer and Deistler, Signal Processing
    52(2), 1996), with all numbers of lags compared on the same samples.
    """
    k, m = (int(table.shape[1]) for table in segments[0])
    fewest = order // m + 1
    lengths = [len(outputs) for _, outputs in segments]

    def enough(horizon: int) -> bool:
        number = sum(max(0, length - 2 * horizon + 1) for length in lengths)
        return number >= WINDOWS_PER_COLUMN * (1 + 2 * horizon * (k + m))

    if not enough(fewest):
        raise NotLearnable(
            Fact(
                Forecasts.TOO_FEW_FOR_ORDER,
                subject=f"subspace({order})",
                samples=sum(lengths),
                parameters=WINDOWS_PER_COLUMN * (1 + 2 * fewest * (k + m)),
            )
        )
    longest = max(
        horizon for horizon in range(fewest, max(fewest, LONGEST_HORIZON) + 1) if enough(horizon)
    )
    windows = Windows.of(segments, longest + 1)
    lags = [windows.part(longest - lag, longest - lag + 1) for lag in range(1, longest + 1)]
    nested = triangle(np.hstack([windows.constant, *lags, windows.samples[:, longest, k:]]))

    def criterion(horizon: int) -> float:
        left = nested[1 + horizon * (k + m) :, -m:]
        covariance = left.T @ left / windows.number
        size = np.linalg.slogdet(covariance + RANK_TOLERANCE**2 * np.eye(m))[1]
        return float(windows.number * size + 2 * horizon * (k + m) * m)

    return max(min(range(1, longest + 1), key=criterion), fewest)


def _state_map(windows: Windows, order: int, past: int, k: int) -> Array:
    """(past · (k + m), n): from the past, oldest sample first, to states of variance 1; ``k`` are the inputs."""
    before = windows.part(0, past)
    after = windows.samples[:, past:, k:].reshape(len(windows.samples), -1)
    given = np.hstack(
        [windows.constant, windows.samples[:, past:, :k].reshape(len(windows.samples), -1)]
    )
    projected = triangle(np.hstack([given, before, after]))[given.shape[1] :, given.shape[1] :]
    of_past = projected[:, : before.shape[1]]
    of_future = projected[:, before.shape[1] :]
    basis, to_basis = _orthonormal(of_past)
    directions = np.linalg.svd(
        basis.T @ of_future @ _orthonormal(of_future)[1], full_matrices=False
    )[0]
    if directions.shape[1] < order:
        states = directions.shape[1]
        raise NotLearnable(Fact(Forecasts.TOO_FEW_STATES, order=order, states=states))
    return np.asarray(to_basis @ directions[:, :order] * np.sqrt(windows.number))


def _orthonormal(table: Array) -> tuple[Array, Array]:
    """An orthonormal basis of the table's columns, and the map from the table to it."""
    basis, sizes, directions = np.linalg.svd(table, full_matrices=False)
    kept = sizes > RANK_TOLERANCE * sizes.max(initial=0.0)
    return basis[:, kept], directions[kept].T / sizes[kept]


class Windows(NamedTuple):
    """All windows of so many samples, the oldest first, in rows that are fewer and have the same inner products.

    So whatever is regressed and projected here comes out as from the windows themselves, whose number enters once, in
    one QR decomposition.
    """

    constant: Array  # (rows, 1) what is 1 in each window
    samples: Array  # (rows, length, k + m): inputs, then outputs
    number: int

    @classmethod
    def of(cls, segments: Segments, length: int) -> Windows:
        """Of the inputs (T, k) and outputs (T, m) of each segment; no window reaches across a gap."""
        width = sum(table.shape[1] for table in segments[0])
        windows = [
            sliding_window_view(np.hstack(segment), length, axis=0).swapaxes(1, 2)
            for segment in segments
            if len(segment[0]) >= length
        ]
        stacked = np.concatenate([np.empty((0, length, width)), *windows])
        flat = stacked.reshape(len(stacked), length * width)
        rows = triangle(np.hstack([np.ones((len(flat), 1)), flat]))
        return cls(rows[:, :1], rows[:, 1:].reshape(len(rows), length, width), len(flat))

    def part(self, first: int, last: int) -> Array:
        """(rows, ·) of the samples ``first`` to ``last`` − 1, one sample after the other."""
        return self.samples[:, first:last].reshape(len(self.samples), -1)


LEAST_NOISES = (1e-12, 1e-9, 1e-6)
"""Variances that are added to all noises, the next where there is no steady filter with one before: data without noise
do not determine the gain. In the methods' units, in which outputs and states have a variance of about 1."""


def innovation_gain(A: Array, C: Array, Q: Array, R: Array, S: Array) -> Array:
    """(n, m) K of the innovation form of x⁺ = A x + … + w, y = C x + … + v, with which A − K C is stable.

    Q, R and S are the covariances E wwᵀ, E vvᵀ and E wvᵀ (Van Overschee and De Moor, Subspace Identification for Linear
    Systems, 1996, sec. 4.2.2, Table 4.1); ``LinAlgError`` where there is no steady filter.
    """
    for least in LEAST_NOISES:
        with suppress(np.linalg.LinAlgError):
            return steady_gain(A, C, Q + least * np.eye(len(A)), R + least * np.eye(len(C)), S)[0]
    raise np.linalg.LinAlgError(
        "there is no steady filter: an unstable state may not be seen in the outputs"
    )


def estimated_starts(model: StateSpace, segments: Segments, innovation: Array) -> Array:
    """(segments, n): the most probable first states, before which they are of mean 0 and variance 1.

    All in units in which the model's states have about that variance; ``innovation`` (m, m) is the covariance of the
    prediction errors.
    """
    n = len(model.A)
    variance, axes = np.linalg.eigh(innovation)
    whiten = axes / np.sqrt(np.maximum(variance, LEAST_VARIANCE))
    longest = max(len(outputs) for _, outputs in segments)
    predictor = model.A - model.K @ model.C
    still = np.zeros((longest - 1, n))
    decays = np.stack(
        [np.vstack([unit, recursion(predictor, still, unit)]) for unit in np.eye(n)], axis=2
    )
    responses = whiten.T @ model.C @ decays
    starts = []
    for inputs, outputs in segments:
        errors = (outputs - model.predicted(np.zeros(n), inputs, outputs)) @ whiten
        effects = np.vstack([responses[: len(errors)].reshape(-1, n), np.eye(n)])
        starts.append(
            np.linalg.lstsq(effects, np.append(errors.ravel(), np.zeros(n)), rcond=None)[0]
        )
    return np.array(starts)
