"""Scores: squared errors of one method's forecasts of one window, beside those of the constant mean.

A test part of H samples is forecast in pieces of k steps: at every k-th sample a forecast starts from all data before
it. So each sample counts once at every horizon, forecasts do not overlap, the error is the mean *up to* the k-th step,
and the constant mean's error is the same at all horizons. k = H is the MSPE of the one forecast from the end of
training.
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mavdem.arrays import Array, ArrayPair, as_real_array
from mavdem.dem.engine.linalg import may_overflow
from mavdem.dem.online import learner
from mavdem.dem.plant_forecasts import FORECAST_HORIZON_SECONDS
from mavdem.flight import Flight

USUAL_RATE = 100.0  # Hz, of these steps; at higher rates they last as long
HORIZONS = (*learner.DEFAULT_HORIZONS, round(FORECAST_HORIZON_SECONDS * USUAL_RATE))
"""Steps; the last is the paper's."""


class Question(StrEnum):
    """What is forecast: the outputs, given the inputs; likewise from state 0; what comes next, without the inputs."""

    KNOWN = "known"
    ZERO = "zero"
    UNKNOWN = "unknown"


KNOWN, FROM_ZERO, UNKNOWN = Question


class Scores(NamedTuple):
    """Errors of forecasts that answer one question, by horizon, the last that of the whole test part.

    The unit of an output's error is its training variance; ``baseline`` are the squared errors of the constant mean.
    """

    steps: tuple[int, ...]  # (K,)
    squared_error: Array  # (K, m) mean over the samples
    inside: Array  # (K,) share of the samples in the 90 % band, NaN without one
    variance: Array  # (m,)
    baseline: Array  # (m,)

    @property
    def ratio(self) -> Array:
        """(K,) error ratios: below 1 is better than the constant mean.

        The skill score is one minus this, and it is the NMSE of system identification.
        """
        ours = (self.squared_error / self.variance).sum(axis=1)
        return error_over(ours, (self.baseline / self.variance).sum())


class Mspe(NamedTuple):
    """Mean squared prediction error: ``per_output`` (m,) in the squares of their units, and ``total``, their sum."""

    per_output: Array
    total: float


@may_overflow
def mspe(measured: ArrayLike, predicted: ArrayLike) -> Mspe:
    """Returns the mean over samples of the squared error (the paper, ``Metric for comparison``).

    Args:
        measured, predicted: (H, m) each. A prediction that is NaN has an infinite error.

    Raises:
        ValueError: shapes that differ, or no samples.

    >>> mspe([[0.0, 0.0], [2.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]]).total
    2.5

    See Also:
        :func:`mavdem.evaluate.held_out_windows`: errors on windows that no model has seen.
    """
    y = as_real_array(measured, "measured")
    yhat = as_real_array(predicted, "predicted")
    if y.shape != yhat.shape or y.ndim != 2 or not len(y):
        raise ValueError(
            f"measured and predicted must be (H, m) alike, not {y.shape} and {yhat.shape}"
        )
    # The forecast of an unstable model may overflow.
    squares = (y - yhat) ** 2
    per_output = np.where(np.isnan(squares), np.inf, squares).mean(axis=0)
    return Mspe(per_output, float(per_output.sum()))


def error_over(ours: ArrayLike, theirs: ArrayLike) -> Array:
    """Returns the ratio of errors, ``ours`` over ``theirs``; 1 if both are the same, also 0 or infinite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.equal(ours, theirs), 1.0, np.divide(ours, theirs))


def horizons(samples: int, dt: float) -> tuple[int, ...]:
    """Returns the horizons, in steps, of a test part of ``samples``: those of ``HORIZONS`` in it, and all of it.

    Above ``USUAL_RATE``, by the sampling step ``dt`` in s, they last as long as there.
    """
    steps = (
        HORIZONS
        if dt >= 1 / USUAL_RATE
        else tuple(round(usual / USUAL_RATE / dt) for usual in HORIZONS)
    )
    return (*(step for step in steps if step < samples), samples)


def units_of(train: Flight, test: Flight) -> ArrayPair:
    """Returns the training variance (m,) of each output, and the squared error (m,) of the training mean in ``test``.

    Raises:
        ValueError: an output of ``train`` that is constant.
    """
    if not np.ptp(train.outputs, axis=0).all():
        raise ValueError("train must vary in every output: errors are in units of its variance")
    mean = np.broadcast_to(train.outputs.mean(axis=0), test.outputs.shape)
    return train.outputs.var(axis=0), mspe(test.outputs, mean).per_output


def relative_mspe(train: Flight, test: Flight, forecast: ArrayLike) -> float:
    """Returns the error ratio: MSPE in units of each output's training variance, summed, over the training mean's.

    Below 1 the forecast is better than the mean.

    ``train`` gives mean and variances; ``forecast`` (H, m) is of the H samples of ``test``.

    Raises:
        ValueError: a forecast of another shape, or an output of ``train`` that is constant.
    """
    variance, baseline = units_of(train, test)
    ours = mspe(test.outputs, forecast).per_output
    return float(error_over((ours / variance).sum(), (baseline / variance).sum()))
