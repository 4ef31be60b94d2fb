"""Trivial forecasts, which every method must beat: the last measurement, the mean of the training data, and zero."""

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.record import Record, TrainingData
from mavdem.experiments.methods.identified import Identified
from mavdem.facts.forecasts import HeldOutForecast


def hold(train: TrainingData) -> Identified:
    """Forecasts the last measurement of ``train``; the first sample of a segment is predicted by the mean."""
    record = Record.from_flights(train)
    return _model_without_inputs("hold", record, record.outputs.mean(axis=0), holds=True)


def constant_mean(train: TrainingData) -> Identified:
    """Forecasts the mean of the training data ``train``."""
    record = Record.from_flights(train)
    mean = record.outputs.mean(axis=0)
    return _model_without_inputs(HeldOutForecast.CONSTANT_MEAN, record, mean)


def zero(train: TrainingData) -> Identified:
    """Forecasts zero, whatever the training data ``train``."""
    record = Record.from_flights(train)
    return _model_without_inputs("zero", record, 0.0 * record.outputs.mean(axis=0))


def _model_without_inputs(
    method: str, record: Record, output_trim: Array, *, holds: bool = False
) -> Identified:
    """Returns a trivial forecast as a state-space model, so that it can be scored like any other method.

    With r inputs and m outputs, B = D = 0: the inputs have no effect. The model forecasts a constant, or holds the last
    measurement: with A = C = K = I the state becomes the last measured deviation from the trim, and stays.

    Args:
        method: name of the method.
        record: the training data: T samples of r inputs and m outputs, in one or several segments.
        output_trim: (m,) outputs at state 0, which are also the constant forecast.
        holds: whether each output has a state, its last deviation from the trim, which is held. Otherwise there is no
            state.

    Returns:
        The model.
    """
    r = record.inputs.shape[1]
    m = record.outputs.shape[1]
    n = m if holds else 0
    model = StateSpace(
        A=np.eye(n),
        B=np.zeros((n, r)),
        C=np.eye(m, n),
        D=np.zeros((m, r)),
        K=np.eye(n, m),
        offset=np.zeros(n),
        input_trim=np.zeros(r),
        output_trim=output_trim,
    )
    return Identified(method, model, record, starts=np.zeros((len(record.lengths), n)))
