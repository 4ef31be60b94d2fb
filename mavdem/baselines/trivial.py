"""The trivial forecasts: without a model of the motion, and what every model must beat."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mavdem.baselines.identified import Identified
from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.record import Record, UniformRecord


def hold(train: UniformRecord | Sequence[UniformRecord]) -> Identified:
    """Forecasts the last measurement; the first sample of a segment is predicted by the mean.

    Args:
        train: a ``Flight``, or a list of them, segments with gaps between.

    Raises:
        ValueError: values that are not finite, or segments that do not belong together.
    """
    record = Record.of(train)
    return _without_dynamics("hold", record, record.outputs.mean(axis=0), held=record.outputs.shape[1])


def constant_mean(train: UniformRecord | Sequence[UniformRecord]) -> Identified:
    """Forecasts the mean of the training data ``train``, as for :func:`hold`."""
    record = Record.of(train)
    return _without_dynamics("constant mean", record, record.outputs.mean(axis=0), held=0)


def zero(train: UniformRecord | Sequence[UniformRecord]) -> Identified:
    """Forecasts zero; ``train`` as for :func:`hold`."""
    record = Record.of(train)
    return _without_dynamics("zero", record, np.zeros(record.outputs.shape[1]), held=0)


def _without_dynamics(method: str, record: Record, output_trim: Array, held: int) -> Identified:
    """A state for each output that is held: its last deviation from the trim."""
    r, m = record.inputs.shape[1], len(output_trim)
    model = StateSpace(
        A=np.eye(held),
        B=np.zeros((held, r)),
        C=np.eye(m, held),
        D=np.zeros((m, r)),
        K=np.eye(held, m),
        offset=np.zeros(held),
        input_trim=np.zeros(r),
        output_trim=output_trim,
    )
    return Identified(method, model, record, starts=np.zeros((len(record.lengths), held)))
