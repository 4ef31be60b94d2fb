"""Skill by horizon: how far forecasts of so many steps are off, beside the constant mean.

A test part of H samples is forecast in pieces of k: at every k-th sample a forecast begins from all that was measured
before it, and its k rows count. So at every horizon each sample counts once, forecasts do not overlap, the error is the
mean *up to* the k-th step, the constant mean's error is the same at all horizons, and k = H is the MSPE of the one
forecast that begins at the end of training.

The error *at* the k-th step of that one forecast would be a single sample of each window: at the first step, chance and
little else. Forecasts begun at every sample would count a sample of the middle k times and those of the ends once, and
hardly tell more, since neighbours err alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavdem.evaluate.mspe import mspe, training_variance
from mavdem.flight import Flight
from mavdem.forecaster import Forecaster
from mavdem.windows import usual_samples

Array = NDArray[np.float64]

HORIZONS = (1, 5, 10, 25, 50, 150)
"""Steps; the last is the paper's."""


def horizons(samples: int, dt: float) -> tuple[int, ...]:
    """The horizons, in steps, at which a test part is judged: those of ``HORIZONS`` that are shorter, and all of it.

    Args:
        samples: of the test part.
        dt: sampling step, s; of samples faster than 125 Hz horizons last as long as at 100 Hz.
    """
    shorter = [steps for steps in (usual_samples(usual, dt) for usual in HORIZONS) if steps < samples]
    return (*shorter, samples)


class Skill(NamedTuple):
    """The error of forecasts of so many steps; an output's is in units of its training variance.

    Attributes:
        steps: k, to which forecasts ran before the next began.
        per_output: (m,) MSPE over training variance.
        total: their sum.
        relative_per_output: (m,) over the same of the constant mean of the training data.
        relative: the total over the constant mean's: below 1 is better than knowing nothing. The skill score is one
            less this.
    """

    steps: int
    per_output: Array
    total: float
    relative_per_output: Array
    relative: float


def skill(train: Flight, test: Flight, predicted: ArrayLike, steps: int) -> Skill:
    """The error of predictions of ``test``, beside the constant mean.

    Args:
        train: what was learnt from, whose mean and variances are taken.
        test: the samples that were forecast.
        predicted: (H, m) of the H samples of ``test``, in pieces of ``steps``.
        steps: of which each forecast is.

    Raises:
        ValueError: predictions of another shape, or an output of ``train`` that is constant.
    """
    variance = training_variance(train)
    ours = mspe(test.outputs, predicted).per_output / variance
    constant = mspe(test.outputs, np.broadcast_to(train.outputs.mean(axis=0), test.outputs.shape)).per_output / variance
    return Skill(steps, ours, float(ours.sum()), _over(ours, constant), float(_over(ours.sum(), constant.sum())))


def _over(ours: ArrayLike, constant: ArrayLike) -> Array:
    """The ratio, which is 1 where neither errs."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.equal(ours, constant), 1.0, np.divide(ours, constant))


def skill_by_horizon(
    forecaster: Forecaster, train: Flight, test: Flight, horizons: Sequence[int] = HORIZONS
) -> tuple[Skill, ...]:
    """The skill at each horizon, of a model that learns nothing more but has seen every sample before each forecast.

    Args:
        forecaster: the model of ``train``.
        train: what it was learnt from.
        test: the samples right after it.
        horizons: steps; one beyond the samples of ``test`` is that of all of them.

    Raises:
        ValueError: a horizon below 1, or as :func:`skill`.
    """
    return tuple(
        skill(train, test, forecaster.forecast_every(steps, test.inputs, test.outputs), steps) for steps in horizons
    )
