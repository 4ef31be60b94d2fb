"""The mean squared prediction error (MSPE), and the error ratio to the constant mean, also by horizon.

A test part of H samples is forecast in pieces of k steps: at every k-th sample a forecast starts from all data before
it. So each sample counts once at every horizon, forecasts do not overlap, the error is the mean *up to* the k-th step,
and the constant mean's error is the same at all horizons. k = H is the MSPE of the one forecast from the end of
training.

The error *at* the k-th step of that one forecast would be a single sample of each window. Forecasts from every sample
would count a sample in the middle k times and those at the ends once, with hardly more information, because
neighbouring errors are correlated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mavdem.dem.engine.linalg import Array
from mavdem.flight import Flight
from mavdem.forecaster import Forecaster

HORIZONS = (1, 5, 10, 25, 50, 150)
"""Steps; the last is the paper's."""

USUAL_RATE, FAST = 100.0, 125.0
"""Hz: the rate of these steps, and the rate above which they last as long as at ``USUAL_RATE``."""


class Mspe(NamedTuple):
    """Mean squared prediction error: ``per_output`` (m,) in the squares of their units, and ``total``, their sum."""

    per_output: Array
    total: float


def mspe(measured: ArrayLike, predicted: ArrayLike) -> Mspe:
    """Mean over samples of the squared error (the paper, ``Metric for comparison``), per output and summed.

    ``measured`` and ``predicted`` are (H, m) each. A prediction that is NaN has an infinite error.

    Raises:
        ValueError: shapes that differ, or no samples.
    """
    per_output = squared_errors(measured, predicted).mean(axis=0)
    return Mspe(per_output, float(per_output.sum()))


def squared_errors(measured: ArrayLike, predicted: ArrayLike) -> Array:
    """(H, m): squared errors of samples ``measured`` and ``predicted``, (H, m); infinite where the latter are NaN.

    Raises:
        ValueError: shapes that differ, or no samples.
    """
    y, yhat = np.asarray(measured, np.float64), np.asarray(predicted, np.float64)
    if y.shape != yhat.shape or y.ndim != 2 or not len(y):
        raise ValueError(f"measured and predicted must be (H, m) alike, not {y.shape} and {yhat.shape}")
    # The forecast of an unstable model may overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        squares = (y - yhat) ** 2
    return np.where(np.isnan(squares), np.inf, squares)


def horizons(samples: int, dt: float) -> tuple[int, ...]:
    """The horizons, in steps, of a test part of ``samples``: those of ``HORIZONS`` that are shorter, and all of it.

    Above 125 Hz, by the sampling step ``dt`` in s, they last as long as at 100 Hz.
    """
    shorter = [steps for steps in (_usual_steps(usual, dt) for usual in HORIZONS) if steps < samples]
    return (*shorter, samples)


def _usual_steps(usual: int, dt: float) -> int:
    return usual if dt >= 1 / FAST else round(usual / USUAL_RATE / dt)


class Skill(NamedTuple):
    """The error of forecasts of so many steps; an output's is in units of its training variance.

    Attributes:
        steps: k, the length of each forecast.
        per_output: (m,) MSPE over training variance.
        total: their sum.
        relative_per_output: (m,) over the same of the constant mean of the training data.
        relative: the total over the constant mean's, the error ratio: below 1 is better than the constant mean. The
            skill score is one minus this.
    """

    steps: int
    per_output: Array
    total: float
    relative_per_output: Array
    relative: float


def skill(train: Flight, test: Flight, predicted: ArrayLike, steps: int) -> Skill:
    """The error of ``predicted`` (H, m), forecasts of ``test`` in pieces of ``steps``, beside the constant mean.

    Mean and variances are those of the training data, ``train``.

    Raises:
        ValueError: predictions of another shape, or an output of ``train`` that is constant.
    """
    if not np.ptp(train.outputs, axis=0).all():
        raise ValueError("train must vary in every output: errors are in units of its variance")
    # In these units lest a rate, ten times its angle, dominate.
    variance = train.outputs.var(axis=0)
    ours = mspe(test.outputs, predicted).per_output / variance
    constant = mspe(test.outputs, np.broadcast_to(train.outputs.mean(axis=0), test.outputs.shape)).per_output / variance
    return Skill(
        steps, ours, float(ours.sum()), error_over(ours, constant), float(error_over(ours.sum(), constant.sum()))
    )


def error_over(ours: ArrayLike, theirs: ArrayLike) -> Array:
    """The ratio of errors, ``ours`` over ``theirs``; 1 if both are the same, also 0 or infinite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.equal(ours, theirs), 1.0, np.divide(ours, theirs))


def skill_by_horizon(
    forecaster: Forecaster, train: Flight, test: Flight, horizons: Sequence[int] = HORIZONS
) -> tuple[Skill, ...]:
    """The skill at each horizon of a fixed model, whose filter uses every sample before each forecast.

    ``forecaster`` is the model of ``train``; ``test`` are the samples right after that. ``horizons`` are in steps; one
    longer than ``test`` is cut to its length.

    Raises:
        ValueError: a horizon below 1, or as :func:`skill`.
    """
    return tuple(
        skill(train, test, forecaster.forecast_every(steps, test.inputs, test.outputs), steps) for steps in horizons
    )


def prediction_skill_by_horizon(
    forecaster: Forecaster, train: Flight, test: Flight, horizons: Sequence[int] = HORIZONS
) -> tuple[Skill, ...]:
    """As :func:`skill_by_horizon`, of predictions that do not know the inputs of the time that they predict.

    Arguments are the same: ``forecaster``, ``train``, ``test`` and ``horizons``.

    Raises:
        ValueError: the model needs the inputs; or as :func:`skill_by_horizon`.
    """
    return tuple(
        skill(train, test, forecaster.predict_every(steps, test.inputs, test.outputs), steps) for steps in horizons
    )


def relative_mspe(train: Flight, test: Flight, forecast: ArrayLike) -> float:
    """The error ratio: MSPE in units of each output's training variance, summed, over that of the training mean.

    Below 1 the forecast is better than the mean.

    Args:
        train: the training data, for mean and variances.
        test: the samples that are forecast.
        forecast: (H, m), of the H samples of ``test``.

    Raises:
        ValueError: a forecast of another shape, or an output of ``train`` that is constant.
    """
    return skill(train, test, forecast, len(test)).relative
