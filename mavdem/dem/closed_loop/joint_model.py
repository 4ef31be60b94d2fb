"""A joint autoregression of a flight in physical units, from the end of training on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.dem.closed_loop.autoregression import RIDGE, Autoregression, ChannelUnits, LagStatistics, autoregression
from mavdem.dem.closed_loop.gaussian_path import GaussianPath, filtered, past_of, predicted, smoothed
from mavdem.dem.engine.linalg import Array, inverse
from mavdem.dem.record import Record


class JointModel(NamedTuple):
    """The model of a record, and the samples at its end; answers are of the m outputs, in physical units."""

    model: Autoregression
    units: ChannelUnits
    outputs: int  # m
    past: Array  # (lags, k) the last samples, in ``units``

    @classmethod
    def of(cls, record: Record, lags: int, ridge: float = RIDGE) -> JointModel:
        """Of the training data; ``ValueError`` where no segment has more than ``lags`` samples."""
        units = ChannelUnits.of(record)
        segments = units.segments(record)
        model = autoregression(LagStatistics.of(segments, lags), lags, ridge)
        return cls(model, units, record.outputs.shape[1], past_of(segments[-1], lags))

    def predicted(self, steps: int) -> GaussianPath:
        """Mean and variance (steps, m) of what follows, inputs unknown."""
        return self._physical(predicted(self.model, self.past, steps))

    def predicted_every(self, steps: int, inputs: Array, outputs: Array) -> Array:
        """(H, m): the samples that follow, by a new prediction from every ``steps``-th on, of all samples before it."""
        pasts = self._pasts(steps, inputs, outputs)
        found = self._physical(predicted(self.model, pasts, min(steps, len(inputs))))
        return found.mean.reshape(-1, self.outputs)[: len(inputs)]

    def inferred(self, inputs: Array, smooth: bool = False, from_zero: bool = False) -> GaussianPath:
        """Mean and variance (H, m) of what follows given the ``inputs`` (H, r) up to each sample, or all of them.

        With ``from_zero`` all samples before are at the trim.
        """
        answer = smoothed if smooth else filtered
        past = np.zeros_like(self.past) if from_zero else self.past
        return self._physical(answer(self.model, past, self.units.scaled_inputs(inputs)))

    def inferred_every(self, steps: int, inputs: Array, outputs: Array) -> Array:
        """(H, m): as :meth:`inferred`, begun again at every ``steps``-th sample from all samples before it."""
        steps, length = max(1, min(steps, len(inputs))), len(inputs)
        pasts = self._pasts(steps, inputs, outputs)
        rows = np.minimum(np.arange(len(pasts) * steps), length - 1).reshape(-1, steps)
        found = self._physical(filtered(self.model, pasts, self.units.scaled_inputs(inputs)[rows]))
        return found.mean.reshape(-1, self.outputs)[:length]

    def leverage(self, steps: int, inputs: Array, outputs: Array, forecast: Array) -> Array:
        """(H,) how far each sample's regressors are from those of the training data, as their mean square there is 1.

        Mahalanobis distances by the posterior's precision: where inputs or forecasts leave the range of the training
        data, the parameters' uncertainty grows in proportion. ``forecast`` (H, m) begins at every ``steps``-th sample
        of ``inputs`` (H, r) and ``outputs`` (H, m); arguments are physical.
        """
        lags, length = self.model.lags, len(inputs)
        pasts = self._pasts(steps, inputs, outputs)
        rows = np.minimum(np.arange(len(pasts) * steps), length - 1).reshape(-1, steps)
        channels = np.concatenate([pasts, self.units.scaled(np.hstack([forecast, inputs]))[rows]], axis=1)
        lagged = [channels[:, lags - lag : lags - lag + steps] for lag in range(1, lags + 1)]
        regressors = np.concatenate([*lagged, np.ones((*rows.shape, 1))], axis=2)
        precision = self.model.precision
        with np.errstate(over="ignore", invalid="ignore"):
            distance = np.sum(regressors @ inverse(precision) * regressors, axis=2)
        # The offset's precision is the number of rows; x' G⁻¹ x has mean q / rows over them.
        return np.asarray(distance.reshape(-1)[:length] * precision[-1, -1] / len(precision))

    def one_step(self, record: Record) -> Array:
        """(T, m): each sample of ``record`` from those before it in its segment and the inputs up to it."""
        lags, answers = self.model.lags, []
        for channels in self.units.segments(record):
            pasts = np.array([past_of(channels[max(0, t - lags) : t], lags) for t in range(len(channels))])
            answers.append(filtered(self.model, pasts, channels[:, None, self.outputs :]).mean[:, 0])
        return self._physical(GaussianPath(np.concatenate(answers), np.ones(()))).mean

    def _pasts(self, steps: int, inputs: Array, outputs: Array) -> Array:
        """(S, lags, k) the samples before every ``steps``-th of those that follow."""
        channels = np.concatenate([self.past, self.units.scaled(np.hstack([outputs, inputs]))])
        begins = np.arange(0, len(inputs), steps)
        return np.asarray(channels[begins[:, None] + np.arange(self.model.lags)])

    def _physical(self, path: GaussianPath) -> GaussianPath:
        center, scale = (each[: self.outputs] for each in self.units)
        mean, variance = (each[..., : self.outputs] if each.ndim else each for each in path)
        return GaussianPath(center + scale * mean, scale**2 * variance)
