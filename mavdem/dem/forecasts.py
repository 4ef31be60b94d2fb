"""Forecasts inside the training data, and of what follows them, with the error to expect."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.confidence import quantile
from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.fitting import Fit
from mavdem.dem.forecast.shrinkage import expected_error, prior_variance, shrunk
from mavdem.dem.forecast.simulation_error import SimulationFit
from mavdem.dem.priors import KINEMATIC
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling

LONGEST_FORECAST_SECONDS = 1.5  # the paper's 150 samples at 100 Hz
MAX_STARTS = 200  # of forecasts of one record


class Trials(NamedTuple):
    """Forecasts of a record, physical and less the model's output trim: (starts, H, m) each."""

    measured: Array
    predicted: Array

    @property
    def mse(self) -> Array:
        """Mean squared error by horizon, (H, m)."""
        # An unstable model's forecast may overflow; the error is then infinite.
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(((self.measured - self.predicted) ** 2).mean(axis=0))


def trials(fitted: Fit, record: Record, motors_at: Array | None = None) -> Trials:
    """A model's forecasts of a record, from all over each segment; with motors fixed ``motors_at`` (r,) if given."""
    horizon = max(1, min(round(LONGEST_FORECAST_SECONDS / record.dt), 2 * record.longest // 3))
    scaling, predictor = fitted.scaling, fitted.predictor
    measured, predicted = [], []
    for inputs, outputs in record.segments:
        last = len(outputs) - horizon - 1
        if last < 0:
            continue
        # The filter needs a few samples to find hidden states.
        share = max(1, round(MAX_STARTS * len(outputs) / len(record)))
        starts = np.unique(np.linspace(min(horizon // 4, last), last, share).astype(int))
        scaled = scaling.scale_outputs(outputs)
        driven = scaling.scale_inputs(inputs if motors_at is None else np.broadcast_to(motors_at, inputs.shape))
        with np.errstate(over="ignore", invalid="ignore"):
            states = predictor.filtered(predictor.second(driven[0], scaled[0]), driven[1:], scaled[1:])[starts]
            ahead = predictor.simulated_from(starts + 1, horizon, states, driven)
            measured.append(scaled[starts[:, None] + 1 + np.arange(horizon)] * scaling.output_scale)
            predicted.append(ahead * scaling.output_scale)
    return Trials(np.concatenate(measured), np.concatenate(predicted))


class TrainingForecasts(NamedTuple):
    """Forecasts of the training data by the model that was fitted to them."""

    mse: Array  # (L, m) mean squared error by length, physical units
    weight: Array  # (L, m), 0 to 1: of the model's forecast against the trim, where the posterior of θ gives none
    weighted_mse: Array  # (L, m) error to expect of forecasts with that weight beyond the training data
    motors_share: float  # of the squared error with the motors at their trim, what their recorded outputs remove


def training_forecasts(fitted: Fit, record: Record) -> TrainingForecasts:
    """Forecasts the training data of a model.

    The parameters took part of the data to fit them: N numbers leave a squared error that is (N − k)/N of the one to
    expect elsewhere. A forecast of L samples has N = m T / L, taken to be at least 2 k. The weight is the one of least
    squares inside the training data, less by the same factor; 1 without ``Settings.shrink_forecasts``.
    """
    own, at_trim = trials(fitted, record), trials(fitted, record, fitted.scaling.input_trim)
    free = np.count_nonzero(np.diag(fitted.model.prior.theta_precision) < KINEMATIC)
    lengths = np.arange(1, len(own.mse) + 1)[:, None]
    numbers = np.maximum(record.outputs.size / lengths, 2 * free)
    left = 1 - free / numbers
    weight = _weight(own) * left if fitted.settings.shrink_forecasts else np.ones_like(own.mse)
    variance = record.outputs.var(axis=0)
    with np.errstate(over="ignore", invalid="ignore"):
        weighted_mse = Trials(own.measured, weight * own.predicted).mse / left
        share = 1 - np.mean(own.mse / variance) / np.mean(at_trim.mse / variance)
    return TrainingForecasts(own.mse, weight, weighted_mse, float(np.nan_to_num(share, neginf=-1.0)))


def _weight(trials: Trials) -> Array:
    """By least squares, (L, m); none for forecasts that overflow."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        weight = (trials.measured * trials.predicted).sum(axis=0) / (trials.predicted**2).sum(axis=0)
    return np.asarray(np.clip(np.nan_to_num(weight), 0.0, 1.0))


class Forecast(NamedTuple):
    """Outputs that were forecast, (H, m), and the squared error to expect of them, (H, m); physical."""

    mean: Array
    variance: Array


class BandedForecast(NamedTuple):
    """A forecast (H, m) with the squared error to expect, and the half width of a band about it, (H, m); physical."""

    mean: Array
    variance: Array
    half_width: Array


@dataclass(frozen=True, eq=False)
class Forecasts:
    """What the vehicle's model forecasts after its training data, motors as causes; arguments and results are physical.

    The posterior of θ of the ``simulation_fit`` shrinks forecasts, and without one ``training_forecasts`` does; none
    without ``shrink``.
    """

    record: Record
    scaling: Scaling
    predictor: StateSpace
    simulation_fit: SimulationFit | None
    training_forecasts: TrainingForecasts
    shrink: bool

    def following(self, inputs: Array, from_zero: bool = False) -> Forecast:
        """With ``inputs`` (H, r), from the last state on or, with ``from_zero``, from state 0."""
        u, (before_u, before_y) = self.scaling.scale_inputs(inputs), self._last_segment
        return self._forecast(
            max(1, len(u)), self._deviation(u, from_zero), u, np.vstack([before_u, u]), before_y, len(before_y)
        )

    def quantile(self, level: float) -> float:
        """Half the width of the band of probability ``level``, in standard deviations."""
        return float(quantile(level)) if self.simulation_fit is None else self.simulation_fit.quantile(level)

    def every(self, steps: int, inputs: Array, outputs: Array) -> Forecast:
        """Of ``steps`` samples each, through the samples ``inputs`` (H, r) and ``outputs`` (H, m)."""
        u, y = self.scaling.scale_inputs(inputs), self.scaling.scale_outputs(outputs)
        deviation = self.predictor.simulated_every(steps, self._last_state, u, y)
        (before_u, before_y), first = self._last_segment, len(self._last_segment[1])
        return self._forecast(steps, deviation, u, np.vstack([before_u, u]), np.vstack([before_y, y]), first)

    def _forecast(
        self, steps: int, deviation: Array, inputs: Array, all_inputs: Array, all_outputs: Array, first: int
    ) -> Forecast:
        """Of deviations (H, m) in the engine's units; the last three as for :meth:`_parameter_variance`."""
        places = np.arange(len(deviation)) % max(steps, 1)
        if self.simulation_fit is None:
            variance = by_length(self.training_forecasts.weighted_mse, places)
            return Forecast(self.scaling.physical_outputs(self._shrunk(deviation, variance, inputs, steps)), variance)
        variance = self._parameter_variance(steps, all_inputs, all_outputs, first)
        mean = self.scaling.physical_outputs(self._shrunk(deviation, variance, inputs, steps))
        if self.shrink:
            variance = expected_error(deviation, variance, self._prior_variance(inputs, steps))
        noise = by_length(self.simulation_fit.noise, places)
        return Forecast(mean, (variance + noise) * self.scaling.output_scale**2)

    def _shrunk(self, deviation: Array, variance: Array, inputs: Array, steps: int) -> Array:
        """Deviations (H, m) of forecasts of ``steps`` samples, shrunk towards the trim, in the engine's units."""
        if self.simulation_fit is None:
            return deviation * by_length(self.training_forecasts.weight, np.arange(len(deviation)) % max(steps, 1))
        return shrunk(deviation, variance, self._prior_variance(inputs, steps)) if self.shrink else deviation

    def _prior_variance(self, inputs: Array, steps: int) -> Array:
        return prior_variance(inputs[:, : self.record.inputs.shape[1]], max(steps, 1))

    def _deviation(self, inputs: Array, from_zero: bool = False) -> Array:
        """(H, m) from the trim, not shrunk, in the engine's units."""
        if not (from_zero and len(inputs)):
            return self.predictor.simulated(self._last_state, inputs)
        trim = np.zeros(self.record.outputs.shape[1])
        return np.vstack([trim, self.predictor.simulated(self.predictor.second(inputs[0], trim), inputs[1:])])

    def _parameter_variance(self, steps: int, inputs: Array, outputs: Array, first: int) -> Array:
        """(T − first, m) variance by the posterior of θ, of forecasts of ``steps`` samples that begin at ``first``.

        Of the ``outputs``, those before each forecast are used. All in the engine's units.
        """
        fit, (T, r), m = self.simulation_fit, inputs.shape, outputs.shape[1]
        if fit is None or first == T:
            return np.empty((0, m))
        before = fit.horizon + 1
        rows = np.arange(first, T, steps) + np.arange(-before, min(steps, T - first))[:, None]
        own, measured = inputs[np.clip(rows, 0, T - 1)], outputs[np.clip(rows[:before], 0, len(outputs) - 1)]
        return fit.spread((len(fit.gain), r, m), self.record.dt, own, measured).reshape(-1, m)[: T - first]

    @cached_property
    def _last_state(self) -> Array:
        """The state of the sample after the training data."""
        return self.predictor.at_end(*self._last_segment)

    @property
    def _last_segment(self) -> tuple[Array, Array]:
        """Inputs and outputs of the last segment of the training data, in the engine's units."""
        inputs, outputs = self.record.segments[-1]
        return self.scaling.scale_inputs(inputs), self.scaling.scale_outputs(outputs)


def by_length(values: Array, places: NDArray[np.intp]) -> Array:
    """Rows of ``values`` (L, m), by length of a forecast, at ``places`` (H,) from its begin; beyond the last, that."""
    return np.asarray(values[np.minimum(places, len(values) - 1)])
