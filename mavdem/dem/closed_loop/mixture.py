"""The mixture of forecasts: DEM's model, joint autoregressions and the constant mean, by the error each is to expect.

DEM's model takes the motors for causes alone. In closed loop they answer the outputs as well, and so measure them: a
joint autoregression of outputs and motors, conditioned on the motors of the forecast, uses that, but knows nothing of
the vehicle. Which is better depends on flight, sampling rate and length of the forecast. So each has a weight, at each
length and for each output, that falls with the squared error to expect of it: for DEM's model by its posterior, for the
autoregressions in samples that were left out when they were fitted, for the mean the variance of the training data.

The mixture's expected squared error is that of its members and, since they are about one future, how far they are apart
(the law of total variance).

References:
    J. M. Bates and C. W. J. Granger, "The combination of forecasts", Operational Research Quarterly 20(4), 1969.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mavdem.confidence import half_width
from mavdem.dem.closed_loop.joint_model import JointModel
from mavdem.dem.closed_loop.left_out import left_out_errors
from mavdem.dem.engine.linalg import Array
from mavdem.dem.forecasts import LONGEST_FORECAST_SECONDS, Forecast, Forecasts, by_length
from mavdem.dem.record import Record

RIDGE = 1e-4
"""Of the members' priors: what motors tell of the motion is nearly exact, and a stronger prior would blur it."""
OF_ALL, OF_TURNING = 10, 20  # lags of the member of all inputs, and of that of the combination that turns the vehicle
WEIGHT_POWER = 2  # a weight is the inverse of the expected squared error to this power
FAR = 50.0
"""Leverage beyond which a member's expected error grows with its square: a linear model holds some way outside its
data, but not in a gust or a landing that training has not seen."""
LEAST_ERROR = 1e-50  # squared, physical: keeps weights finite
LEAST_FREEDOM = 3.0  # of the t distribution of the band: its variance is then still finite
MEAN_WEIGHT = 3.0  # of the constant mean, where a member whose expected error is the training variance has 1


class Member(NamedTuple):
    """A joint autoregression of the outputs and of ``combinations`` (r, c) of the inputs."""

    model: JointModel
    combinations: Array
    errors: Array  # (L, m) mean squared error to expect, by length, physical

    @classmethod
    def of(cls, record: Record, combinations: Array, lags: int, steps: int) -> Member | None:
        """Of the training data, for forecasts of up to ``steps``; ``None`` where they are too few."""
        combined = replace(record, inputs=record.inputs @ combinations, effect_directions=None)
        errors = left_out_errors(combined, lags, RIDGE, steps)
        if errors is None:
            return None
        return cls(JointModel.of(combined, lags, RIDGE), combinations, errors * record.outputs.var(axis=0))

    def forecast(self, inputs: Array, smooth: bool) -> Forecast:
        """With ``inputs`` (H, r) measured up to each sample; or, to ``smooth``, all of them."""
        mean = self.model.inferred(inputs @ self.combinations, smooth).mean
        return self._with_error(max(1, len(inputs)), inputs, mean, mean)

    def every(self, steps: int, inputs: Array, outputs: Array) -> Forecast:
        """Begun again at every ``steps``-th sample."""
        mean = self.model.inferred_every(steps, inputs @ self.combinations, outputs)
        return self._with_error(steps, inputs, outputs, mean)

    def _with_error(self, steps: int, inputs: Array, outputs: Array, mean: Array) -> Forecast:
        """The forecast with its expected squared error: more where it leaves the range of the training data."""
        errors = by_length(self.errors, np.arange(len(inputs)) % steps)
        leverage = self.model.leverage(steps, inputs @ self.combinations, outputs, mean)
        return Forecast(mean, errors * np.maximum(1.0, running_mean(leverage[:, None], steps) / FAR) ** 2)


class ClosedLoop(NamedTuple):
    """The forecasts of a learnt flight: the ``plant``'s alone, where there are no ``members`` beside it."""

    plant: Forecasts
    members: tuple[Member, ...]

    @classmethod
    def of(cls, plant: Forecasts, turning: Array) -> ClosedLoop:
        """With members where the training data suffice; ``turning`` (r,) are the inputs' effects on the axis."""
        record = plant.record
        steps = max(1, round(LONGEST_FORECAST_SECONDS / record.dt))
        found = [Member.of(record, np.eye(len(turning)), OF_ALL, steps)]
        if turning.any():
            found.append(Member.of(record, turning[:, None] / np.linalg.norm(turning), OF_TURNING, steps))
        return cls(plant, tuple(member for member in found if member is not None))

    def following(self, inputs: Array, smooth: bool = False) -> Forecast:
        """With ``inputs`` (H, r) measured up to each sample; or, to ``smooth``, all of them, but for the plant."""
        forecasts = [self.plant.following(inputs), *(member.forecast(inputs, smooth) for member in self.members)]
        return self._mixed(forecasts, max(1, len(inputs)), self.plant.record.outputs[-1:])

    def every(self, steps: int, inputs: Array, outputs: Array) -> Forecast:
        """Begun again at every ``steps``-th of the samples ``inputs`` (H, r) and ``outputs`` (H, m)."""
        steps = min(steps, max(1, len(inputs)))
        own = self.plant.every(steps, inputs, outputs)
        forecasts = [own, *(member.every(steps, inputs, outputs) for member in self.members)]
        before = np.concatenate([self.plant.record.outputs[-1:], outputs])[: len(outputs) : steps]
        return self._mixed(forecasts, steps, before)

    def half_widths(self, variance: Array, level: float, steps: int | None = None) -> Array:
        """(H, m) of the band of probability ``level`` of a forecast of that ``variance`` (H, m), begun every ``steps``.

        The variance is an estimate from as many forecasts as follow each other in the training data: Student's t.
        """
        if not self.members:
            return np.asarray(self.plant.quantile(level) * np.sqrt(variance))
        lengths = np.arange(len(variance)) % (steps or max(1, len(variance))) + 1
        freedom = np.maximum(len(self.plant.record) / lengths, LEAST_FREEDOM)
        return half_width(variance, level, freedom[:, None])

    def _mixed(self, forecasts: Sequence[Forecast], steps: int, before: Array) -> Forecast:
        """Of forecasts that each begin after one of the samples ``before`` (S, m)."""
        if not self.members:
            return forecasts[0]
        outputs = self.plant.record.spread[1]
        length = len(forecasts[0].mean)
        # The mean errs at least as much as it does now, when the vehicle is far from it.
        variance = np.repeat(np.maximum(outputs.variance, (before - outputs.mean) ** 2), steps, axis=0)[:length]
        constant = Forecast(np.broadcast_to(outputs.mean, variance.shape), variance)
        return mixed(forecasts, constant, steps)


def mixed(forecasts: Sequence[Forecast], constant: Forecast, steps: int) -> Forecast:
    """The mixture of ``forecasts`` (H, m) that begin at every ``steps``-th sample, and of the ``constant`` mean."""
    all_of_them = [*forecasts, constant]
    means = np.array([each.mean for each in all_of_them])
    variances = np.array([each.variance for each in all_of_them])
    # A forecast that overflows has no weight, and must not make the sum NaN.
    lost = ~(np.isfinite(means) & np.isfinite(variances))
    means, variances = np.where(lost, constant.mean, means), np.where(lost, np.inf, variances)
    errors = np.maximum([running_mean(each, steps) for each in variances], LEAST_ERROR)
    weights = errors ** -float(WEIGHT_POWER)
    weights[-1] *= MEAN_WEIGHT
    weights /= weights.sum(axis=0)
    mean = (weights * means).sum(axis=0)
    spread = np.where(weights > 0, variances + (means - mean) ** 2, 0.0)
    return Forecast(mean, (weights * spread).sum(axis=0))


def running_mean(values: Array, steps: int) -> Array:
    """(H, …) the mean of ``values`` (H, …) from the beginning of each forecast of ``steps`` samples to each sample."""
    found = np.empty_like(values)
    for begin in range(0, len(values), steps):
        piece = values[begin : begin + steps]
        found[begin : begin + steps] = np.cumsum(piece, axis=0) / np.arange(1, len(piece) + 1)[:, None]
    return found
