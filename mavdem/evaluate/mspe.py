"""The mean squared prediction error, by which forecasts are judged, and the same in units that compare."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavdem.flight import Flight

Array = NDArray[np.float64]


class Mspe(NamedTuple):
    """Mean squared prediction error.

    Attributes:
        per_output: (m,), each in the square of its output's unit.
        total: their sum, as the paper reports it.
    """

    per_output: Array
    total: float


def mspe(measured: ArrayLike, predicted: ArrayLike) -> Mspe:
    """Mean over samples of the squared error (the paper, ``Metric for comparison``), per output and summed.

    A prediction that is not a number errs infinitely.

    Args:
        measured, predicted: (H, m) each.

    Raises:
        ValueError: shapes that differ, or no samples.
    """
    per_output = squared_errors(measured, predicted).mean(axis=0)
    return Mspe(per_output, float(per_output.sum()))


def squared_errors(measured: ArrayLike, predicted: ArrayLike) -> Array:
    """(H, m): the squared error of each sample; infinite where the prediction is not a number.

    Args:
        measured, predicted: (H, m) each.

    Raises:
        ValueError: shapes that differ, or no samples.
    """
    y, yhat = np.asarray(measured, np.float64), np.asarray(predicted, np.float64)
    if y.shape != yhat.shape or y.ndim != 2 or not len(y):
        raise ValueError(f"measured and predicted must be (H, m) alike, not {y.shape} and {yhat.shape}")
    # A forecast of an unstable model may run beyond all numbers.
    with np.errstate(over="ignore", invalid="ignore"):
        squares = (y - yhat) ** 2
    return np.where(np.isnan(squares), np.inf, squares)


def training_variance(train: Flight) -> Array:
    """(m,) in units of which errors are told: it keeps a rate, ten times its angle, from being all that counts.

    Args:
        train: what is learnt from.

    Raises:
        ValueError: an output of ``train`` that is constant.
    """
    if not np.ptp(train.outputs, axis=0).all():
        raise ValueError("train must vary in every output: errors are told in units of its variance")
    return np.asarray(train.outputs.var(axis=0))


def relative_mspe(train: Flight, test: Flight, forecast: ArrayLike) -> float:
    """MSPE in units of each output's training variance, summed, over the same of the training mean.

    Below 1 the forecast is better than knowing nothing but the mean.

    Args:
        train: what was learnt from, whose mean and variances are taken.
        test: the samples that were forecast.
        forecast: (H, m), of the H samples of ``test``.

    Raises:
        ValueError: a forecast of another shape, or an output of ``train`` that is constant.
    """
    variance = training_variance(train)
    constant = np.broadcast_to(train.outputs.mean(axis=0), test.outputs.shape)
    ours = (mspe(test.outputs, forecast).per_output / variance).sum()
    return float(ours / (mspe(test.outputs, constant).per_output / variance).sum())
