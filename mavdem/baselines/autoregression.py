"""ARX: each sample as a linear combination of those before it and their inputs, by least squares."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mavdem.baselines.identified import Identified, of_stability, required_order
from mavdem.baselines.regression import least_ridge, regression, triangle
from mavdem.baselines.units import Segments, Units
from mavdem.dem.engine.linalg import Array, one_thread
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.record import Record, UniformRecord


def arx(train: UniformRecord | Sequence[UniformRecord], order: int = 2, stable: bool = False) -> Identified:
    """y_t = Σₖ Aₖ y_{t−k} + Σₖ Bₖ u_{t−k} + c + e_t over ``order`` lags k = 1, 2, …, by least squares.

    Consistent, also in closed loop, where e is white (Ljung, System Identification, 2nd ed., secs. 7.3 and 13.4); noise
    of the measurements alone biases it. The model is realised in observer form, m · order states. The lags before a
    segment's first samples are taken to be at the trim.

    Args:
        train: a ``Flight``, or a list of them, segments with gaps between: no lag reaches across a gap.
        order: number of lags.
        stable: shrink the Aₖ of an unstable model by a ridge, the smallest tried that makes it stable.

    Raises:
        ValueError: too few samples, values that are not finite, an output that does not vary, or an order that is no
            positive number.
    """
    order = required_order(order)
    record = Record.of(train)
    units = Units.of(record)
    with one_thread():
        regressors, targets = _lagged(units.segments(record), order)
        rows, columns = regressors.shape
        if rows <= columns:
            raise ValueError(
                f"train has {rows} samples with {order} before them, and ARX({order}) of it has {columns} parameters "
                f"for each output: lower the order, or train on more samples"
            )
        m = targets.shape[1]
        regressors, targets = np.split(triangle(np.hstack([regressors, targets])), [columns], axis=1)
        model = _realised(regression(regressors, targets), order, m)
        stabilised = stable and not model.stable

        def shrunk(ridge: float) -> StateSpace:
            of_outputs = np.arange(columns) < m * order
            return _realised(regression(regressors, targets, ridge * of_outputs), order, m)

        if stabilised:
            model = shrunk(least_ridge(lambda ridge: shrunk(ridge).spectral_radius, rows))
        starts = np.zeros((len(record.lengths), m * order))
        cautions = of_stability(model, stabilised)
        physical = units.physical(model).with_states(np.diag(np.tile(units.output_scale, order)))
        return Identified(f"ARX({order})", physical, record, starts, stabilised, cautions)


def _lagged(segments: Segments, order: int) -> tuple[Array, Array]:
    """Regressors [outputs of each lag, inputs of each lag, 1] and targets, of all samples with as many before them."""
    rows, targets = [], []
    for inputs, outputs in segments:
        length = len(outputs)
        if length <= order:
            continue
        lags = [table[order - lag : length - lag] for table in (outputs, inputs) for lag in range(1, order + 1)]
        rows.append(np.hstack([*lags, np.ones((length - order, 1))]))
        targets.append(outputs[order:])
    m, k = segments[0][1].shape[1], segments[0][0].shape[1]
    if not rows:
        return np.empty((0, order * (m + k) + 1)), np.empty((0, m))
    return np.vstack(rows), np.vstack(targets)


def _realised(coefficients: Array, order: int, m: int) -> StateSpace:
    """In observer form: state block i is what the samples so far contribute i − 1 samples later."""
    lags, n = coefficients.T, m * order
    k = (lags.shape[1] - 1) // order - m
    of_outputs = lags[:, :n].reshape(m, order, m).swapaxes(0, 1).reshape(n, m)
    of_inputs = lags[:, n:-1].reshape(m, order, k).swapaxes(0, 1).reshape(n, k)
    C = np.eye(m, n)
    shift = np.eye(n, k=m)
    return StateSpace(
        A=of_outputs @ C + shift,
        B=of_inputs,
        C=C,
        D=np.zeros((m, k)),
        K=of_outputs,
        offset=np.concatenate([lags[:, -1], np.zeros(n - m)]),
        input_trim=np.zeros(k),
        output_trim=np.zeros(m),
    )
