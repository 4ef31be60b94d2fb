"""Subspace identification: states are projections of the past onto the future, the model their regression."""

from contextlib import suppress

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.linalg import LinAlgError

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.kalman import steady_state_gain
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.record import Segments, TrainingData
from mavdem.errors import NotLearnable
from mavdem.experiments.methods.identified import (
    RANK_TOLERANCE,
    Fitted,
    Identified,
    identified,
    regression,
)
from mavdem.facts.forecasts import Forecasts

LONGEST_HORIZON = 20  # samples of past and of future that the state is found from, at most
# for each number in a window: so many there should be, and at the least. The horizon that Akaike's criterion chooses
# gives the same errors within 1 %, geometric means over all windows of eight flights
USUAL_WINDOWS = 5
LEAST_WINDOWS = 2


def subspace(train: TrainingData, order: int = 2) -> Identified:
    """Returns a state-space model of ``order`` states from projections, without iterations.

    The states are the combinations of the past that predict the future best, given the future inputs: canonical
    correlations (CVA, Larimore 1990). y is regressed on them for C, their successors on them and u for A and B, and K
    is the steady Kalman gain of the residuals' covariances (Van Overschee and De Moor, Subspace Identification for
    Linear Systems, 1996, ch. 4; Katayama, Subspace Methods for System Identification, 2005, ch. 10). Biased in closed
    loop.

    Past and future are as long as the number of samples allows, up to 20. The
    state in which a segment begins is estimated from that segment.

    Args:
        train: a ``Flight``, or a list of them, segments with gaps between: no window reaches across a gap.
        order: number of states.

    Raises:
        ValueError: too few samples for the order, values that are not finite, an output that does not vary, or an order
            that is none.
    """
    return identified("subspace", train, order, found_by_projection)


def found_by_projection(segments: Segments, order: int) -> Fitted:
    """Returns the model of inputs and outputs of each segment."""
    horizon = _horizon(segments, order)
    (k, m) = (table.shape[1] for table in segments[0])
    windows = np.concatenate(
        [
            sliding_window_view(np.hstack(segment), 2 * horizon, axis=0).mT
            for segment in segments
            if len(segment[0]) >= 2 * horizon
        ]
    )
    number = len(windows)
    state_map = _state_map(windows, order, k)
    states = windows[:, :horizon].reshape(number, -1) @ state_map
    successors = windows[:, 1 : horizon + 1].reshape(number, -1) @ state_map
    inputs, outputs = np.split(windows[:, horizon], [k], axis=1)

    constant = np.ones((number, 1))
    regressors = np.hstack([constant, states])
    of_outputs = regression(regressors, outputs)
    innovations = outputs - regressors @ of_outputs
    output_trim, C = np.split(of_outputs.T, [1], axis=1)

    regressors = np.hstack([constant, states, inputs])
    of_successors = regression(regressors, successors).T
    offset, A, B = np.split(of_successors, [1, 1 + order], axis=1)
    errors = np.hstack([successors - regressors @ of_successors.T, innovations])
    covariance = errors.T @ errors / number
    Q = covariance[:order, :order]
    S = covariance[:order, order:]
    R = covariance[order:, order:]
    try:
        K = innovation_gain(A, C, Q, R, S)
    except LinAlgError:
        raise NotLearnable(Forecasts.NOT_OBSERVABLE, order=order) from None
    model = StateSpace(A, B, C, np.zeros((m, k)), K, offset[:, 0], np.zeros(k), output_trim[:, 0])
    starts = np.array([_start(model, *segment) for segment in segments])
    return Fitted(model, starts)


def _horizon(segments: Segments, order: int) -> int:
    """How many samples of past and of future to look at: as many as the windows that there are leave room for."""
    k, m = (int(table.shape[1]) for table in segments[0])
    fewest = order // m + 1
    lengths = np.array([len(outputs) for _, outputs in segments])

    def windows_per_column(horizon: int) -> float:
        windows = np.maximum(lengths - 2 * horizon + 1, 0).sum()
        return float(windows / (1 + 2 * horizon * (k + m)))

    if windows_per_column(fewest) < LEAST_WINDOWS:
        subject = f"subspace({order})"
        least = LEAST_WINDOWS * (1 + 2 * fewest * (k + m))
        raise NotLearnable(
            Forecasts.TOO_FEW_FOR_ORDER,
            subject=subject,
            samples=int(lengths.sum()),
            parameters=least,
        )
    longer = range(LONGEST_HORIZON, fewest, -1)
    usable = (each for each in longer if windows_per_column(each) >= USUAL_WINDOWS)
    return next(usable, fewest)


def _state_map(windows: Array, order: int, k: int) -> Array:
    """(past · (k + m), n): from the past, oldest sample first, to states of variance 1.

    ``windows`` (N, length, k + m) are half past and half future, of k inputs and then the outputs.
    """
    number = len(windows)
    past, future = np.split(windows, 2, axis=1)
    future_inputs = future[:, :, :k].reshape(number, -1)
    given = np.hstack([np.ones((number, 1)), future_inputs])
    before = past.reshape(number, -1)
    after = future[:, :, k:].reshape(number, -1)
    of_past, of_future = (each - given @ regression(given, each) for each in (before, after))
    basis, to_basis = _orthonormal(of_past)
    future_basis = _orthonormal(of_future)[1]
    directions = np.linalg.svd(basis.T @ of_future @ future_basis, full_matrices=False)[0]
    if directions.shape[1] < order:
        raise NotLearnable(Forecasts.TOO_FEW_STATES, order=order, states=directions.shape[1])
    return to_basis @ directions[:, :order] * np.sqrt(number)


def _orthonormal(table: Array) -> ArrayPair:
    """An orthonormal basis of the table's columns, and the map from the table to it."""
    basis, sizes, directions = np.linalg.svd(table, full_matrices=False)
    kept = sizes > RANK_TOLERANCE * sizes.max(initial=0.0)
    return basis[:, kept], directions[kept].T / sizes[kept]


LEAST_NOISES = (1e-12, 1e-9, 1e-6)
"""Variances that are added to all noises, the next where there is no steady filter with one before: data without noise
do not determine the gain. In the methods' units, in which outputs and states have a variance of about 1."""


def innovation_gain(A: Array, C: Array, Q: Array, R: Array, S: Array) -> Array:
    """Returns (n, m) K of the innovation form of x⁺ = A x + … + w, y = C x + … + v, with which A − K C is stable.

    Q, R and S are the covariances E wwᵀ, E vvᵀ and E wvᵀ (Van Overschee and De Moor, Subspace Identification for Linear
    Systems, 1996, sec. 4.2.2, Table 4.1); ``LinAlgError`` where there is no steady filter.
    """
    for least in LEAST_NOISES:
        with suppress(LinAlgError):
            process = Q + least * np.eye(len(A))
            measurement = R + least * np.eye(len(C))
            return steady_state_gain(A, C, process, measurement, S)[0]
    raise LinAlgError("no noise makes a steady filter")


def _start(model: StateSpace, inputs: Array, outputs: Array) -> Array:
    """(n,): the smallest first state with the least prediction errors of a segment."""
    at_zero = model.predicted_outputs(np.zeros(len(model.A)), inputs, outputs)
    effects = [
        model.predicted_outputs(unit, inputs, outputs) - at_zero for unit in np.eye(len(model.A))
    ]
    return regression(
        np.stack(effects, axis=-1).reshape(outputs.size, -1), (outputs - at_zero).ravel()
    )
