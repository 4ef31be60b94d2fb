"""Prediction of what comes next, inputs unknown: the mean of joint autoregressions, shrunk by what it is worth.

Models of few and of many lags err differently, and their mean has a lower error than each. Its deviation from the
training mean gets a weight at each horizon, from predictions inside the training data: the mean of two weights of least
squares, of the models themselves, for which it is too large, and of models fitted without the part that they predict,
for which it is too small. The errors of the latter are those to expect of other data; the smaller they are at a
horizon, the less is shrunk. The last sample, held, has a share in the prediction as well: the square of the models'
share in the sum of both mean squared errors, and so most where the vehicle hovers still.

References:
    J. Bates and C. Granger, "The combination of forecasts", Operational Research Quarterly 20(4), 1969, whose share is
    not squared.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem import confidence
from mavdem.dem.closed_loop.autoregression import Autoregression, ChannelUnits, LagStatistics, autoregression
from mavdem.dem.closed_loop.folds import FOLDS, Block, folds, without
from mavdem.dem.closed_loop.gaussian_path import past_of, predicted_mean
from mavdem.dem.engine.linalg import Array, one_thread
from mavdem.dem.forecasts import LONGEST_FORECAST_SECONDS, by_length
from mavdem.dem.record import Record

LAGS = (4, 10, 20)
MAX_STARTS = 80  # of predictions inside the training data
TINY = 1e-300  # where neither errs
LARGEST_DEVIATION = 1e3  # of a prediction, in deviations of the training data: a model that grows may overflow


class Prediction(NamedTuple):
    """What follows a record of m outputs.

    Attributes:
        models: one for each number of lags.
        units: of the models.
        past: (lags, k) the last samples of the record, in these units.
        weight: (L, m) between 0 and 1, of the models' deviation from the training mean, by horizon.
        held: (L, m) likewise, of the last sample against the models.
        mse: (L, m) squared error to expect, in these units.
        samples: number of samples it was learnt from.
    """

    models: tuple[Autoregression, ...]
    units: ChannelUnits
    past: Array
    weight: Array
    held: Array
    mse: Array
    samples: int

    @classmethod
    def of(cls, record: Record) -> Prediction:
        """Learnt from the training data; ``ValueError`` where no segment has two samples."""
        units, outputs = ChannelUnits.of(record), record.outputs.shape[1]
        segments = units.segments(record)
        lags = [each for each in LAGS if 2 * each < record.longest] or [1]
        longest = max(1, min(round(LONGEST_FORECAST_SECONDS / record.dt), record.longest // FOLDS))
        stride = -(-len(record) // MAX_STARTS)
        with one_thread():
            statistics = [LagStatistics.of(segments, each) for each in lags]
            models = _models(statistics, lags)
            whole = [(channels, 0, len(channels)) for channels in segments]
            inside = _trials(models, whole, longest, outputs, stride)
            others = [
                (fold, [without(*pair, fold) for pair in zip(statistics, lags, strict=True)])
                for fold in folds(segments)
            ]
            apart = [
                _trials(_models(left, lags), fold, longest, outputs, stride)
                for fold, left in others
                if all(each.rows > 0 for each in left)
            ]
        measured, predicted, last = (np.concatenate(tables) for tables in zip(*(apart or [inside]), strict=True))
        best = (_weight(*inside[:2]) + np.minimum.accumulate(_weight(measured, predicted))) / 2
        # Where errors are small, what little the weight of least squares removes would be most of them.
        weight = 1 - (1 - best) * np.minimum(1.0, _mse(measured, best * predicted))
        error = (_mse(inside[0], weight * inside[1]) + _mse(measured, weight * predicted)) / 2
        of_last = _mse(inside[0], inside[2])
        held = (error / np.maximum(error + of_last, TINY)) ** 2
        mse = _mse(measured, (1 - held) * weight * predicted + held * last)
        return cls(models, units, past_of(segments[-1], max(lags)), weight, held, mse, len(record))

    def after(self, past: Array, steps: int) -> Array:
        """(…, steps, m) predictions after each ``past`` (…, lags, k) in the models' units, physical."""
        m, (weight, held) = (
            self.weight.shape[1],
            (by_length(each, np.arange(steps)) for each in (self.weight, self.held)),
        )
        weighted = weight * _deviation(self.models, past, steps, m)
        mixed = (1 - held) * weighted + held * past[..., -1:, :m]
        return np.asarray(self.units.center[:m] + self.units.scale[:m] * mixed)

    def every(self, steps: int, inputs: Array, outputs: Array) -> Array:
        """(H, m): the samples that follow, by a new prediction from every ``steps``-th on, of all samples before it."""
        channels = np.concatenate([self.past, self.units.scaled(np.hstack([outputs, inputs]))])
        begins = np.arange(0, len(inputs), steps)
        pasts = channels[begins[:, None] + np.arange(len(self.past))]
        found = self.after(pasts, max(1, min(steps, len(inputs))))
        return found.reshape(-1, outputs.shape[1])[: len(inputs)]

    def half_width(self, steps: int, level: float) -> Array:
        """(steps, m) of the band about a prediction in which a sample lies with probability ``level``, physical.

        The expected error of a horizon is an estimate of as many numbers as such horizons follow each other.
        """
        m = self.weight.shape[1]
        horizons = np.minimum(np.arange(steps), len(self.mse) - 1)
        quantile = confidence.quantile(level, np.maximum(1.0, m * self.samples / (horizons + 1)))
        return np.asarray(quantile[:, None] * self.units.scale[:m] * np.sqrt(self.mse[horizons]))

    def useful_steps(self, share: float) -> NDArray[np.intp]:
        """(m,) the longest horizon up to which the squared error to expect is below ``share`` of each variance."""
        return np.asarray((self.mse < share).sum(axis=0))


def _models(statistics: list[LagStatistics], lags: list[int]) -> tuple[Autoregression, ...]:
    return tuple(autoregression(*pair) for pair in zip(statistics, lags, strict=True))


def _deviation(models: tuple[Autoregression, ...], past: Array, steps: int, outputs: int) -> Array:
    """(…, steps, m) of the outputs from the training mean, the mean of all models."""
    each = [predicted_mean(model, past[..., -model.lags :, :], steps)[..., :outputs] for model in models]
    bounded = np.clip(np.nan_to_num(each, nan=0.0), -LARGEST_DEVIATION, LARGEST_DEVIATION)
    return np.asarray(np.mean(bounded, axis=0))


def _trials(
    models: tuple[Autoregression, ...], blocks: list[Block], steps: int, outputs: int, stride: int
) -> tuple[Array, Array, Array]:
    """From every ``stride``-th sample of ``blocks`` on: samples, predictions, and the sample before (S, 1, m).

    The former are (S, steps, m); samples beyond the end of their block are NaN.
    """
    lags = max(model.lags for model in models)
    pasts, measured = [np.empty((0, lags, models[0].channels))], [np.empty((0, steps, outputs))]
    for channels, first, stop in blocks:
        begins = np.arange(max(first, lags), stop, stride)
        following = np.concatenate([channels[:stop, :outputs], np.full((steps, outputs), np.nan)])
        pasts.append(channels[begins[:, None] + np.arange(-lags, 0)])
        measured.append(following[begins[:, None] + np.arange(steps)])
    past = np.concatenate(pasts)
    return np.concatenate(measured), _deviation(models, past, steps, outputs), past[:, -1:, :outputs]


def _weight(measured: Array, predicted: Array) -> Array:
    """(steps, m) between 0 and 1: by least squares, 0 where nothing was predicted."""
    products = np.where(np.isfinite(measured), measured * predicted, 0.0).sum(axis=0)
    squares = np.where(np.isfinite(measured), predicted**2, 0.0).sum(axis=0)
    best = np.divide(products, squares, out=np.zeros_like(products), where=squares > 0)
    return np.asarray(np.clip(best, 0.0, 1.0))


def _mse(measured: Array, predicted: Array) -> Array:
    """(steps, m) mean squared error, not smaller than at shorter horizons; 1 where nothing was predicted."""
    known = np.isfinite(measured)
    squares = np.where(known, measured - predicted, 0.0) ** 2
    mse = np.where(known.any(axis=0), squares.sum(axis=0) / np.maximum(known.sum(axis=0), 1), 1.0)
    return np.asarray(np.maximum.accumulate(mse))
