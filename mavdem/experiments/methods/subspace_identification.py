"""Subspace identification of state-space models: states from canonical correlations of past and future samples.

The method works on windows of h past and h future samples of k inputs and m outputs, in normalized units.
"""

from contextlib import suppress

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.linalg import LinAlgError

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.kalman import steady_state_gain
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.record import Segments, TrainingData
from mavdem.errors import NotLearnable
from mavdem.experiments.methods.identified import Identified, NormalizedFit, identified
from mavdem.facts.forecasts import ForecastFact

MAX_HORIZON = 20
"""Samples of past and of future that the state is estimated from, at most."""

SUFFICIENT_WINDOWS = 5
"""Windows for each number in a window with which a horizon is long enough but not too long: the horizon that Akaike's
criterion chooses gives the same errors within 1 %, geometric means over all windows of eight flights."""

MIN_WINDOWS = 2
"""Windows for each number in a window of the shortest horizon; with fewer the regressions have no freedom left."""

RANK_TOLERANCE = np.sqrt(np.finfo(np.float64).eps)
"""Singular values below this share of the largest count as zero; of all solutions the smallest is taken."""

ADDED_NOISE_VARIANCES = (1e-12, 1e-9, 1e-6)
"""Variances that are added to all noises, one after the other until there is a steady-state filter: data without noise
do not determine the gain. In normalized units, in which outputs and states have a variance of about 1."""


def subspace(train: TrainingData, order: int = 2) -> Identified:
    """Identifies a state-space model of ``order`` states from projections, without iterations.

    The states are the combinations of past samples that predict the future best, given the future inputs: canonical
    correlations (CVA, Larimore 1990). C follows from a regression of the outputs on the states, and A and B from one of
    the next states on states and inputs. K is the steady-state Kalman gain for the covariances of the residuals (Van
    Overschee and De Moor, Subspace Identification for Linear Systems, 1996, ch. 4; Katayama, Subspace Methods for
    System Identification, 2005, ch. 10). The estimate is biased in closed loop.

    Past and future are as long as the number of samples allows, up to 20. The state in which a segment begins is
    estimated from that segment.

    Args:
        train: a ``Flight``, or a list of them, segments with gaps between: no window reaches across a gap.
        order: number of states.

    Returns:
        The model.

    Raises:
        ValueError: there are too few samples for the order, values are not finite, an output does not vary, or the
            order is not a positive whole number.
    """
    return identified("subspace", train, order, subspace_fit)


def subspace_fit(segments: Segments, order: int) -> NormalizedFit:
    """Identifies a state-space model of segments in normalized units, in three steps without iterations.

    1. The state x at the middle of each window is the map of :func:`canonical_state_map` applied to the past half.
    2. Least squares of y = C x + trim + e and of x⁺ = A x + B u + offset + w, where x⁺ is the state one sample later.
    3. The covariances of w and e give the steady Kalman gain K of the innovation form.

    Args:
        segments: inputs (T, k) and outputs (T, m) of each segment.
        order: number of states n.

    Returns:
        The model in innovation form, with the first state of each segment.

    Raises:
        NotLearnable: too few samples for the order, or states that the outputs do not show.
    """
    # Windows have the shape (windows, samples, inputs and outputs).
    horizon = choose_horizon(segments, order)
    first_inputs, first_outputs = segments[0]
    k = first_inputs.shape[1]
    m = first_outputs.shape[1]
    # Each window has as many past samples as future ones. Its middle sample is the first of the future.
    windows = sample_windows(segments, 2 * horizon)
    count = len(windows)
    state_map = canonical_state_map(windows, order, k)
    states = windows[:, :horizon].reshape(count, -1) @ state_map
    successors = windows[:, 1 : horizon + 1].reshape(count, -1) @ state_map
    inputs, outputs = np.split(windows[:, horizon], [k], axis=1)

    constant = np.ones((count, 1))
    regressors = np.hstack([constant, states])
    output_coefficients = least_squares(regressors, outputs)
    innovations = outputs - regressors @ output_coefficients
    # The first column belongs to the constant.
    output_trim, C = np.split(output_coefficients.T, [1], axis=1)

    regressors = np.hstack([constant, states, inputs])
    state_coefficients = least_squares(regressors, successors).T
    offset, A, B = np.split(state_coefficients, [1, 1 + order], axis=1)
    state_errors = successors - regressors @ state_coefficients.T
    errors = np.hstack([state_errors, innovations])
    covariance = errors.T @ errors / count
    Q = covariance[:order, :order]
    S = covariance[:order, order:]
    R = covariance[order:, order:]
    try:
        K = innovation_gain(A, C, Q, R, S)
    except LinAlgError:
        raise NotLearnable(ForecastFact.NOT_OBSERVABLE, order=order) from None
    model = StateSpace(
        A,
        B=B,
        C=C,
        D=np.zeros((m, k)),
        K=K,
        offset=offset[:, 0],
        input_trim=np.zeros(k),
        output_trim=output_trim[:, 0],
    )
    starts = [initial_state(model, inputs, outputs) for inputs, outputs in segments]
    return NormalizedFit(model, np.array(starts))


def sample_windows(segments: Segments, length: int) -> Array:
    """Returns all windows of consecutive samples, as rows of the regressions of subspace identification.

    Windows overlap: one begins at every sample. None reaches across a gap between segments, and segments shorter than
    a window have none.

    Args:
        segments: inputs (T, k) and outputs (T, m) of each segment.
        length: number of samples in a window.

    Returns:
        Windows (N, length, k + m), with the inputs of a sample before its outputs.
    """
    windows = []
    for inputs, outputs in segments:
        if len(inputs) >= length:
            samples = np.hstack([inputs, outputs])
            windows.append(sliding_window_view(samples, length, axis=0).mT)
    return np.concatenate(windows)


def choose_horizon(segments: Segments, order: int) -> int:
    """Chooses the number of past and of future samples that states are estimated from.

    A longer past shows more of the state, but the regressions have 1 + 2 h (k + m) regressors and need several windows
    for each of them. So h is the largest number up to ``MAX_HORIZON`` with ``SUFFICIENT_WINDOWS`` windows for each
    regressor, or else the smallest from which all states can be estimated.

    Args:
        segments: inputs (T, k) and outputs (T, m) of each segment.
        order: number of states n.

    Returns:
        The horizon h, in samples.

    Raises:
        NotLearnable: too few samples even for the shortest horizon.
    """
    inputs, outputs = segments[0]
    k = inputs.shape[1]
    m = outputs.shape[1]
    # The h · m outputs of the future must be more than the n states that they show.
    min_horizon = order // m + 1
    lengths = np.array([len(outputs) for _, outputs in segments])

    def regressors_of(horizon: int) -> int:
        """Returns the number of inputs and outputs in a window of 2 h samples, and one for the constant."""
        return 1 + 2 * horizon * (k + m)

    def windows_per_regressor(horizon: int) -> float:
        """Returns the number of windows of 2 h samples in all segments, for each regressor."""
        # A segment of T samples has T − 2 h + 1 windows.
        windows = np.maximum(lengths - 2 * horizon + 1, 0).sum()
        return float(windows / regressors_of(horizon))

    if windows_per_regressor(min_horizon) < MIN_WINDOWS:
        raise NotLearnable(
            ForecastFact.TOO_FEW_FOR_ORDER,
            subject=f"subspace({order})",
            samples=int(lengths.sum()),
            parameters=MIN_WINDOWS * regressors_of(min_horizon),
        )
    for horizon in range(MAX_HORIZON, min_horizon, -1):
        if windows_per_regressor(horizon) >= SUFFICIENT_WINDOWS:
            return horizon
    return min_horizon


def canonical_state_map(windows: Array, order: int, k: int) -> Array:
    """Returns the linear map from past samples to states, by canonical correlation analysis (CVA, Larimore 1990).

    What the future inputs and a constant explain is removed from the past and from the future outputs, since the
    state must contain what the inputs do not. The states are the n combinations of the remaining past with the
    largest correlations with the remaining future: orthonormal bases of both are multiplied, and the left singular
    vectors of the product are the directions of largest correlation.

    Args:
        windows: (N, 2 h, k + m) samples, half past and half future, inputs before outputs.
        order: number of states n.
        k: number of inputs.

    Returns:
        (h · (k + m), n) from the past, oldest sample first, to states of variance 1.

    Raises:
        NotLearnable: the past has fewer independent combinations than the order.
    """
    window_count = len(windows)
    past_half, future_half = np.split(windows, 2, axis=1)
    # One row for each window: the samples of its half side by side.
    past = past_half.reshape(window_count, -1)
    future_inputs = future_half[:, :, :k].reshape(window_count, -1)
    future_outputs = future_half[:, :, k:].reshape(window_count, -1)
    # What the future inputs explain is removed from both.
    regressors = np.hstack([np.ones((window_count, 1)), future_inputs])
    past_residual = past - regressors @ least_squares(regressors, past)
    future_residual = future_outputs - regressors @ least_squares(regressors, future_outputs)
    # Orthonormal bases make covariances into correlations.
    past_basis, past_map = orthonormal_basis(past_residual)
    _, future_map = orthonormal_basis(future_residual)
    correlations = past_basis.T @ future_residual @ future_map
    directions = np.linalg.svd(correlations, full_matrices=False)[0]
    if directions.shape[1] < order:
        raise NotLearnable(ForecastFact.TOO_FEW_STATES, order=order, states=directions.shape[1])
    # A column of an orthonormal basis of N rows has the variance 1/N.
    return past_map @ directions[:, :order] * np.sqrt(window_count)


def orthonormal_basis(table: Array) -> ArrayPair:
    """Finds an orthonormal basis of the columns of a table, by its singular value decomposition.

    Args:
        table: (N, d) with columns that may depend on each other.

    Returns:
        The basis (N, c) and the map (d, c) with table · map = basis. c is the numerical rank of the table.
    """
    basis, singular_values, directions = np.linalg.svd(table, full_matrices=False)
    independent = singular_values > RANK_TOLERANCE * singular_values.max(initial=0.0)
    return basis[:, independent], directions[independent].T / singular_values[independent]


def least_squares(regressors: Array, targets: Array) -> Array:
    """Returns the smallest least-squares solution (c, d) of regressors (N, c) · solution = targets (N, d)."""
    return np.asarray(np.linalg.lstsq(regressors, targets, rcond=RANK_TOLERANCE)[0])


def innovation_gain(A: Array, C: Array, Q: Array, R: Array, S: Array) -> Array:
    """Returns the steady-state Kalman gain of the innovation form of x⁺ = A x + … + w, y = C x + … + v.

    With this gain the predictor A − K C is stable (Van Overschee and De Moor, Subspace Identification for Linear
    Systems, 1996, sec. 4.2.2, Table 4.1).

    For data without noise the Riccati equation has no stabilising solution, so a little noise is added to Q and R, and
    more if that does not suffice.

    Args:
        A: (n, n) state transition matrix of one sampling step.
        C: (m, n) output matrix.
        Q, R, S: covariances E wwᵀ (n, n), E vvᵀ (m, m) and E wvᵀ (n, m).

    Returns:
        (n, m) gain K.

    Raises:
        numpy.linalg.LinAlgError: no added noise gives a steady-state filter.
    """
    for variance in ADDED_NOISE_VARIANCES:
        with suppress(LinAlgError):
            process = Q + variance * np.eye(len(A))
            measurement = R + variance * np.eye(len(C))
            return steady_state_gain(A, C, process, measurement, S).gain
    raise LinAlgError("no noise makes a steady filter")


def initial_state(model: StateSpace, inputs: Array, outputs: Array) -> Array:
    """Returns the first state of a segment with the least squared one-step prediction errors.

    The predictions are linear in the first state: those from state 0 plus the effect of each of its n entries, which is
    the difference that a unit entry makes. So the state is found by linear regression. If the segment does not
    determine it, the smallest one is taken.

    Args:
        model: model in innovation form, in the units of the data.
        inputs: (T, k) of the segment.
        outputs: (T, m) of the segment.

    Returns:
        The state (n,).
    """
    n = len(model.A)
    from_zero = model.predicted_outputs(np.zeros(n), inputs, outputs)
    effects = []
    for unit_state in np.eye(n):
        effects.append(model.predicted_outputs(unit_state, inputs, outputs) - from_zero)
    regressors = np.stack(effects, axis=-1).reshape(outputs.size, -1)
    return least_squares(regressors, (outputs - from_zero).ravel())
