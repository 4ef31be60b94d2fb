"""Subspace identification: the state as what the past tells of the future, and the model as its regression."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from mavdem.baselines.identified import Identified, of_stability
from mavdem.baselines.orders import required_order
from mavdem.baselines.regression import DEPENDENT, least_ridge, regression, triangle
from mavdem.baselines.riccati import steady_gain
from mavdem.baselines.starts import estimated_starts
from mavdem.baselines.state_space import ROUNDING, StateSpace
from mavdem.baselines.units import Segments, Units
from mavdem.baselines.windows import Windows
from mavdem.dem.one_thread import one_thread
from mavdem.dem.record import Record, Recorded

Array = NDArray[np.float64]

Weighting = Literal["CVA", "MOESP", "SSARX"]

LONGEST_HORIZON = 20
"""Samples of past and of future that the state is found from, at most."""

WINDOWS_PER_COLUMN = 2
"""So many windows there must be for each number in one of them."""


def subspace(
    train: Recorded | Sequence[Recorded],
    order: int = 2,
    weighting: Weighting = "CVA",
    feedthrough: bool = False,
    stable: bool = False,
) -> Identified:
    """A state-space model of ``order`` states from projections, without iterations.

    The states are those combinations of the past which tell most of the future; y is regressed on them for C (and D),
    their successors on them and u for A and B, and K is the steady Kalman gain of the residuals' covariances (Van
    Overschee and De Moor, Subspace Identification for Linear Systems, 1996, ch. 4; Katayama, Subspace Methods for
    System Identification, 2005, ch. 10). What "most" means is the weighting's:

    - ``"CVA"``: canonical correlations of past and future, given the future inputs (Larimore 1990).
    - ``"MOESP"``: the variance of the future outputs which the past explains, given the future inputs (Verhaegen 1994).
    - ``"SSARX"``: canonical correlations of the past and what is left of the future outputs when the effects of inputs
      and outputs within the future are subtracted, as a long ARX model has them; the successors are regressed on the
      innovations too. Consistent in closed loop, which the others are not (Jansson, Subspace identification and ARX
      modeling, SYSID 2003).

    Past and future are as long as the ARX model that Akaike's criterion chooses, but longer than the order needs. The
    state in which a segment begins is estimated from that segment.

    Args:
        train: a ``Flight``, or a list of them, segments with gaps between: no window reaches across a gap.
        order: number of states.
        weighting: of past and future.
        feedthrough: whether inputs act on the outputs of the same sample, D; otherwise it is zero.
        stable: draw A of an unstable model together by a ridge, the smallest of those tried that makes it stable (as
            Van Gestel and others, IEEE Trans. Automatic Control 46(9), 2001).

    Raises:
        ValueError: too few samples for the order, values that are not finite, an output that does not vary, or an order
            or weighting that is none.
    """
    order = required_order(order)
    if weighting not in get_args(Weighting):
        raise ValueError(f"weighting must be one of {', '.join(get_args(Weighting))}, not {weighting!r}")
    record = Record.of(train)
    units = Units.of(record)
    with one_thread():
        found = found_by_projection(units.segments(record), order, weighting, feedthrough, stable)
        return Identified(
            f"subspace({order}, {weighting})",
            units.physical(found.model),
            record,
            found.starts,
            found.stabilised,
            of_stability(found.model, found.stabilised),
        )


class Found(NamedTuple):
    """A model in the method's units, and where its segments begin."""

    model: StateSpace
    starts: Array  # (segments, n)
    stabilised: bool


def found_by_projection(segments: Segments, order: int, weighting: Weighting, feedthrough: bool, stable: bool) -> Found:
    """The model of inputs and outputs of each segment, in units in which their variance is 1."""
    horizon = _horizon(segments, order)
    windows = Windows.of(segments, horizon, horizon)
    state_map = _state_map(windows, order, weighting, feedthrough)
    states, successors = windows.both(0, horizon) @ state_map, windows.both(1, horizon + 1) @ state_map
    inputs, outputs = windows.inputs(horizon, horizon + 1), windows.outputs(horizon, horizon + 1)
    k, m = inputs.shape[1], outputs.shape[1]

    regressors = np.hstack([windows.constant, states, inputs[:, : k * feedthrough]])
    of_outputs = regression(regressors, outputs)
    innovations = outputs - regressors @ of_outputs
    output_trim, C, D = np.split(of_outputs.T, [1, 1 + order], axis=1)
    if not feedthrough:
        D = np.zeros((m, k))

    regressors = np.hstack([windows.constant, states, inputs])
    explained = [regressors, innovations] if weighting == "SSARX" else [regressors]
    columns = np.hstack(explained)
    of_states = np.isin(np.arange(columns.shape[1]), np.arange(1, 1 + order))

    def dynamics(ridge: float | None) -> Array:
        solution = regression(columns, successors, None if ridge is None else ridge * of_states)
        return solution[: regressors.shape[1]].T

    def radius(ridge: float | None) -> float:
        return float(np.abs(np.linalg.eigvals(dynamics(ridge)[:, 1 : 1 + order])).max())

    stabilised = stable and radius(None) > 1 + ROUNDING
    of_successors = dynamics(least_ridge(radius, windows.number) if stabilised else None)
    offset, A, B = np.split(of_successors, [1, 1 + order], axis=1)
    errors = np.hstack([successors - regressors @ of_successors.T, innovations])
    covariance = errors.T @ errors / windows.number
    Q, S, R = covariance[:order, :order], covariance[:order, order:], covariance[order:, order:]
    try:
        K = steady_gain(A, C, Q, R, S)
    except np.linalg.LinAlgError:
        raise ValueError(
            f"the training data determine no model of {order} states whose states can be told from its outputs: lower "
            f"the order"
        ) from None
    model = StateSpace(A, B, C, D, K, offset[:, 0], np.zeros(k), output_trim[:, 0])
    return Found(model, estimated_starts(model, segments, R), stabilised)


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
        raise ValueError(
            f"train has too few samples for {order} states: {sum(lengths)} in segments of {max(lengths)} at most; "
            f"lower the order, or train on more samples without gaps"
        )
    longest = max(horizon for horizon in range(fewest, max(fewest, LONGEST_HORIZON) + 1) if enough(horizon))
    windows = Windows.of(segments, longest, 1)
    lags = [windows.both(longest - lag, longest - lag + 1) for lag in range(1, longest + 1)]
    nested = triangle(np.hstack([windows.constant, *lags, windows.outputs(longest, longest + 1)]))

    def criterion(horizon: int) -> float:
        left = nested[1 + horizon * (k + m) :, -m:]
        covariance = left.T @ left / windows.number
        size = np.linalg.slogdet(covariance + DEPENDENT**2 * np.eye(m))[1]
        return float(windows.number * size + 2 * horizon * (k + m) * m)

    return max(min(range(1, longest + 1), key=criterion), fewest)


def _state_map(windows: Windows, order: int, weighting: Weighting, feedthrough: bool) -> Array:
    """(past · (k + m), n): from the past, oldest sample first, to states of variance 1."""
    past, future = windows.past, windows.samples.shape[1] - windows.past
    before = windows.both(0, past)
    if weighting == "SSARX":
        given, after = windows.constant, _without_effects_of_the_future(windows, feedthrough)
    else:
        given = np.hstack([windows.constant, windows.inputs(past, past + future)])
        after = windows.outputs(past, past + future)
    projected = triangle(np.hstack([given, before, after]))[given.shape[1] :, given.shape[1] :]
    of_past, of_future = projected[:, : before.shape[1]], projected[:, before.shape[1] :]
    basis, to_basis = _orthonormal(of_past)
    shared = basis.T @ of_future
    if weighting != "MOESP":
        shared = shared @ _orthonormal(of_future)[1]
    directions = np.linalg.svd(shared, full_matrices=False)[0]
    if directions.shape[1] < order:
        raise ValueError(
            f"the training data have no {order} states: their past and future share only {directions.shape[1]}; lower "
            f"the order"
        )
    return np.asarray(to_basis @ directions[:, :order] * np.sqrt(windows.number))


def _orthonormal(table: Array) -> tuple[Array, Array]:
    """An orthonormal basis of the table's columns, and the map from the table to it."""
    basis, sizes, directions = np.linalg.svd(table, full_matrices=False)
    kept = sizes > DEPENDENT * sizes.max(initial=0.0)
    return basis[:, kept], directions[kept].T / sizes[kept]


def _without_effects_of_the_future(windows: Windows, feedthrough: bool) -> Array:
    """(rows, future · m): the future outputs less what inputs and outputs since the past ended add to them.

    By the coefficients of the ARX model with as many lags as the past has samples.
    """
    past, k = windows.past, windows.k
    now = windows.inputs(past, past + 1)[:, : k * feedthrough]
    coefficients = regression(
        np.hstack([windows.constant, now, windows.both(0, past)]), windows.outputs(past, past + 1)
    )
    direct = coefficients[1 : 1 + now.shape[1]]
    # By lag, from 1 on.
    lagged = coefficients[1 + now.shape[1] :].reshape(past, -1, coefficients.shape[1])[::-1]
    after = windows.samples[:, past:]
    left = after[:, :, k:].copy()
    if feedthrough:
        left -= after[:, :, :k] @ direct
    for lag in range(1, after.shape[1]):
        left[:, lag:] -= after[:, :-lag] @ lagged[lag - 1]
    return left.reshape(len(left), -1)
