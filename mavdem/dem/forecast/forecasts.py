"""Forecasts of a learnt flight, with the error to expect: the motors known, or unknown.

DEM's model, the plant, takes the motors for causes alone. In closed loop they answer the outputs as well, and so
measure them: vector autoregressions of outputs and motors use that. Which is better depends on flight, sampling rate
and length of the forecast. So forecasts are mixed, each with a weight that falls with the squared error to expect:

- motors known: the plant, the autoregressions given the motors, and the training mean;
- motors unknown: the autoregressions alone, the last sample, and the training mean.

The plant's error follows from its posterior. The others' are of forecasts of parts of the training data that were left
out when they were fitted. The mixture's own is that of its members and, since they are about one future, how far they
are apart (Bates and Granger, "The combination of forecasts", Operational Research Quarterly 20(4), 1969).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.confidence import half_width, quantile
from mavdem.dem.engine.linalg import Array, one_thread
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.fitting import Fit
from mavdem.dem.forecast.simulation_error import SimulationFit
from mavdem.dem.forecast.var import ChannelUnits, Forecast, LagStatistics, Var
from mavdem.dem.priors import KINEMATIC
from mavdem.dem.record import Record, folds
from mavdem.dem.scaling import Scaling

LONGEST_FORECAST_SECONDS = 1.5  # the paper's 150 samples at 100 Hz
MAX_STARTS = 200  # of the plant's forecasts of the training data
WHOLE_STARTS, LEFT_OUT_STARTS = 8, 80
"""Of forecasts of what was left out: of each block, of full length, with inputs known; of all, as long as there is
something to compare with, with inputs unknown."""
FOLDS = 4  # parts of the training data, each left out in turn
VAR_LAGS, AXIS_LAGS = 10, 20  # samples: of the autoregression of all inputs, and of the combination that turns the axis
MEASURED_RIDGE, PREDICTED_RIDGE = 1e-4, 3e-4
"""Of their priors with the motors known and unknown: what motors say of the motion is nearly exact, and a stronger
prior would blur it; without them less is known."""

LEVERAGE_LIMIT = 50.0
"""Leverage beyond which an autoregression's expected error grows with its square: a linear model holds some way outside
its data, but not in a gust or a landing that training has not seen (docs/method.md: the worst window has 53 times the
mean's error without it, and 4 with it)."""

WEIGHT_POWER = 3  # a weight is the inverse of the expected squared error to this power
LARGEST_ERROR = 1e4  # squared, in training variances: a single forecast that explodes counts no more than that
LEAST_ERROR = 1e-50  # squared, physical: keeps weights finite
LEAST_FREEDOM = 3.0  # of the t distribution of the band: its variance is then still finite
DOUBLING_DEVIATION = 5.0  # in standard deviations √S: at this deviation a forecast's variance counts twice


class BandedForecast(NamedTuple):
    """A forecast (H, m) with the squared error to expect, and the half width of a band about it, (H, m); physical."""

    mean: Array
    variance: Array
    half_width: Array


def mixture(forecasts: Sequence[Forecast], steps: int) -> Forecast:
    """Returns the mixture of forecasts (H, m) that begin at every ``steps``-th sample.

    Weights are inverse cubes of the mean squared error to expect from a forecast's beginning on. A forecast that
    overflows has no weight; the last one must not.
    """
    means, variances = (np.array(values) for values in zip(*forecasts, strict=True))
    lost = ~(np.isfinite(means) & np.isfinite(variances))
    means, variances = np.where(lost, means[-1], means), np.where(lost, np.inf, variances)
    weights = mixture_weights(np.array([running_mean(values, steps) for values in variances]))
    mean = (weights * means).sum(axis=0)
    with np.errstate(over="ignore"):
        spread = np.where(weights > 0, variances + (means - mean) ** 2, 0.0)
    return Forecast(mean, (weights * spread).sum(axis=0))


def mixture_weights(errors: Array) -> Array:
    """Returns weights, of sum 1 over the first axis, that fall with the squared ``errors`` to expect."""
    weights = np.maximum(errors, LEAST_ERROR) ** -float(WEIGHT_POWER)
    return np.asarray(weights / weights.sum(axis=0))


def running_mean(values: Array, steps: int) -> Array:
    """Returns (H, …) the mean of ``values`` (H, …) from the beginning of each forecast of ``steps`` samples on."""
    means = np.empty_like(values)
    for begin in range(0, len(values), steps):
        piece = values[begin : begin + steps]
        means[begin : begin + steps] = np.cumsum(piece, axis=0) / np.arange(1, len(piece) + 1)[:, None]
    return means


def by_length(values: Array, places: NDArray[np.intp]) -> Array:
    """Returns rows of ``values`` (L, m), by length of a forecast, at ``places`` (H,); beyond the last, that."""
    return np.asarray(values[np.minimum(places, len(values) - 1)])


class _Trials(NamedTuple):
    """Forecasts of a record, physical and less the model's output trim: (starts, H, m) each."""

    measured: Array
    predicted: Array

    @property
    def mse(self) -> Array:
        """Mean squared error by horizon, (H, m)."""
        # An unstable model's forecast may overflow; the error is then infinite.
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(((self.measured - self.predicted) ** 2).mean(axis=0))


def _trials(fitted: Fit, record: Record, motors_at: Array | None = None) -> _Trials:
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
    return _Trials(np.concatenate(measured), np.concatenate(predicted))


class TrainingForecasts(NamedTuple):
    """Forecasts of the training data by the model that was fitted to them."""

    mse: Array  # (L, m) mean squared error by length, physical units
    weight: Array  # (L, m), 0 to 1: of the model's forecast against the trim, where the posterior of θ gives none
    weighted_mse: Array  # (L, m) error to expect of forecasts with that weight beyond the training data
    motors_share: float  # of the squared error with the motors at their trim, what their recorded outputs remove


def training_forecasts(fitted: Fit, record: Record) -> TrainingForecasts:
    """Forecasts the training data of a model.

    Inside them N numbers leave a squared error that is (N − k)/N of the one to expect elsewhere; a forecast of L
    samples has N = m T / L, taken to be at least 2 k. The weight is the one of least squares inside the training data,
    less by the same factor; 1 with ``Settings(forecasts="model")``.
    """
    trials, at_trim = _trials(fitted, record), _trials(fitted, record, fitted.scaling.input_trim)
    free = np.count_nonzero(np.diag(fitted.model.prior.theta_precision) < KINEMATIC)
    lengths = np.arange(1, len(trials.mse) + 1)[:, None]
    left = 1 - free / np.maximum(record.outputs.size / lengths, 2 * free)
    weight = np.ones_like(trials.mse)
    # Forecasts that overflow have no weight.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        if fitted.settings.forecasts != "model":
            best = (trials.measured * trials.predicted).sum(axis=0) / (trials.predicted**2).sum(axis=0)
            weight = np.clip(np.nan_to_num(best), 0.0, 1.0) * left
        weighted_mse = _Trials(trials.measured, weight * trials.predicted).mse / left
        variance = record.outputs.var(axis=0)
        share = 1 - np.mean(trials.mse / variance) / np.mean(at_trim.mse / variance)
    return TrainingForecasts(trials.mse, weight, weighted_mse, float(np.nan_to_num(share, neginf=-1.0)))


def prior_variance(inputs: Array, steps: int) -> Array:
    """Returns S (T, 1), in training variances, a priori of deviations from the trim, forecast every ``steps`` rows.

    It is the motors' mean square over each forecast, at least 1.
    """
    squares = np.mean(inputs**2, axis=1)
    begins = np.arange(0, len(squares), steps)
    lengths = np.diff(np.append(begins, len(squares)))
    return np.repeat(np.maximum(1.0, np.add.reduceat(squares, begins) / lengths), lengths)[:, None]


def shrunk(deviation: Array, variance: Array, prior: Array) -> Array:
    """Returns deviations (T, m) from the trim shrunk by their variance V (T, m) under the posterior of θ.

    With the ``prior`` variance S (T, 1) a deviation d becomes d / (1 + V/S), and less the larger it is; 0 where the
    variance overflows.
    """
    _, d, V = _finite(deviation, variance)
    return np.asarray(d / (1 + V / prior * (1 + d**2 / (prior * DOUBLING_DEVIATION**2))))


def expected_error(deviation: Array, variance: Array, prior: Array) -> Array:
    """Returns (T, m) the expected squared error of the shrunk forecast, as far as θ is its cause.

    The deviation may be true all the same, in the share 1 / (1 + V/S), so that what was removed counts.
    """
    finite, d, V = _finite(deviation, variance)
    removed = d - shrunk(d, V, prior)
    return np.where(finite, (V + removed**2) / (1 + V / prior), prior)


def _finite(deviation: Array, variance: Array) -> tuple[NDArray[np.bool_], Array, Array]:
    """Where both are finite, and both with 0 elsewhere."""
    finite = np.isfinite(variance) & np.isfinite(deviation)
    return finite, np.where(finite, deviation, 0.0), np.where(finite, variance, 0.0)


@dataclass(frozen=True, eq=False)
class PlantForecasts:
    """What the vehicle's model forecasts after its training data, motors as causes; arguments and results are physical.

    With ``shrink`` the posterior of θ shrinks forecasts, or, without a ``simulation_fit``, ``training_forecasts``.
    """

    record: Record
    scaling: Scaling
    predictor: StateSpace
    simulation_fit: SimulationFit | None
    training_forecasts: TrainingForecasts
    shrink: bool

    def from_zero(self, inputs: Array) -> Array:
        """Forecasts (H, m) with ``inputs`` (H, r) from state 0, the outputs at their trim."""
        u, (before_u, before_y) = self.scaling.scale_inputs(inputs), self._last_segment
        deviation, trim = np.empty((0, before_y.shape[1])), np.zeros(before_y.shape[1])
        if len(u):
            deviation = np.vstack([trim, self.predictor.simulated(self.predictor.second(u[0], trim), u[1:])])
        return self._forecast(max(1, len(u)), deviation, u, np.vstack([before_u, u]), before_y, len(before_y)).mean

    def every(self, steps: int, inputs: Array, outputs: Array) -> Forecast:
        """Forecasts ``steps`` samples each time, through the samples ``inputs`` (H, r) and ``outputs`` (H, m)."""
        u, y = self.scaling.scale_inputs(inputs), self.scaling.scale_outputs(outputs)
        deviation = self.predictor.simulated_every(steps, self._last_state, u, y)
        (before_u, before_y), first = self._last_segment, len(self._last_segment[1])
        return self._forecast(steps, deviation, u, np.vstack([before_u, u]), np.vstack([before_y, y]), first)

    def quantile(self, level: float) -> float:
        """Returns half the width of the band of probability ``level``, in standard deviations."""
        return float(quantile(level)) if self.simulation_fit is None else self.simulation_fit.quantile(level)

    def _forecast(
        self, steps: int, deviation: Array, inputs: Array, all_inputs: Array, all_outputs: Array, first: int
    ) -> Forecast:
        """Of deviations (H, m) in the engine's units; the last three as for :meth:`_parameter_variance`."""
        places = np.arange(len(deviation)) % max(steps, 1)
        if self.simulation_fit is None:
            deviation = deviation * by_length(self.training_forecasts.weight, places)
            expected = by_length(self.training_forecasts.weighted_mse, places)
            return Forecast(self.scaling.physical_outputs(deviation), expected)
        variance = self._parameter_variance(steps, all_inputs, all_outputs, first)
        if self.shrink:
            prior = prior_variance(inputs[:, : self.record.inputs.shape[1]], max(steps, 1))
            deviation, variance = shrunk(deviation, variance, prior), expected_error(deviation, variance, prior)
        variance = (variance + by_length(self.simulation_fit.noise, places)) * self.scaling.output_scale**2
        return Forecast(self.scaling.physical_outputs(deviation), variance)

    def _parameter_variance(self, steps: int, inputs: Array, outputs: Array, first: int) -> Array:
        """(T − first, m) variance by the posterior of θ, of forecasts of ``steps`` samples that begin at ``first``.

        Of the ``outputs``, those before each forecast are used. All in the engine's units.
        """
        fit, (T, r), m = self.simulation_fit, inputs.shape, outputs.shape[1]
        if fit is None or first == T:
            return np.empty((0, m))
        before = fit.horizon + 1
        rows = np.arange(first, T, steps) + np.arange(-before, min(steps, T - first))[:, None]
        driven, measured = inputs[np.clip(rows, 0, T - 1)], outputs[np.clip(rows[:before], 0, len(outputs) - 1)]
        return fit.spread((len(fit.gain), r, m), self.record.dt, driven, measured).reshape(-1, m)[: T - first]

    @cached_property
    def _last_state(self) -> Array:
        """The state of the sample after the training data."""
        return self.predictor.at_end(*self._last_segment)

    @property
    def _last_segment(self) -> tuple[Array, Array]:
        """Inputs and outputs of the last segment of the training data, in the engine's units."""
        inputs, outputs = self.record.segments[-1]
        return self.scaling.scale_inputs(inputs), self.scaling.scale_outputs(outputs)


class LeftOutErrors(NamedTuple):
    """Mean squared errors by length (L, m) of forecasts of what was left out."""

    known: Array  # by the autoregression, the inputs measured
    unknown: Array  # likewise, the inputs unknown
    held: Array  # by the last sample
    mean: Array  # by the mean


def left_out_errors(record: Record, lags: int) -> LeftOutErrors | None:
    """Returns the physical errors of an autoregression, each fold of the record by the model of the others, or None."""
    units, m = ChannelUnits.of(record), record.outputs.shape[1]
    segments = units.segments(record)
    steps, stride = max(1, round(LONGEST_FORECAST_SECONDS / record.dt)), -(-len(record) // LEFT_OUT_STARTS)
    whole, total = LagStatistics.of(segments, lags), np.sum([channels.sum(axis=0) for channels in segments], axis=0)
    known, unknown = [], []
    for parts in folds([len(channels) for channels in segments], FOLDS):
        fold = [(segments[i], start, stop) for i, start, stop in parts]
        left = whole - LagStatistics.of([table[max(0, start - lags) : stop] for table, start, stop in fold], lags)
        if left.rows < 1:
            continue
        measured, predicted = (Var.fit(left, lags, ridge) for ridge in (MEASURED_RIDGE, PREDICTED_RIDGE))
        out = np.concatenate([channels[start:stop] for channels, start, stop in fold])
        mean = ((total - out.sum(axis=0)) / (len(record) - len(out)))[:m]
        for channels, start, stop in fold:
            first = max(start, lags)
            if first >= stop:
                continue
            whole_ones = np.unique(np.linspace(first, max(first, stop - steps), WHOLE_STARTS).astype(int))
            past, following = _cut(channels, whole_ones, lags, steps, stop)
            known.append(_squares(following, measured.infer(past, np.nan_to_num(following[..., m:])).mean))
            past, following = _cut(channels, np.arange(first, stop, stride), lags, steps, stop)
            answers = predicted.predicted(past, steps)[..., :m], past[:, -1:, :m], mean
            unknown.append([_squares(following, answer) for answer in answers])
    if not known:
        return None
    # With inputs unknown a longer forecast is no better than a shorter one.
    tables = [_by_length(known), *(np.maximum.accumulate(_by_length(table)) for table in zip(*unknown, strict=True))]
    return LeftOutErrors(*(np.ascontiguousarray(table * units.scale[:m] ** 2) for table in tables))


def _cut(channels: Array, begins: NDArray[np.intp], lags: int, steps: int, stop: int) -> tuple[Array, Array]:
    """(S, lags, k) the samples before ``begins``, and (S, steps, k) those after, NaN from ``stop`` on."""
    ahead = begins[:, None] + np.arange(steps)
    following = np.where((ahead < stop)[..., None], channels[np.minimum(ahead, stop - 1)], np.nan)
    return channels[begins[:, None] + np.arange(-lags, 0)], following


def _squares(following: Array, answers: Array) -> Array:
    """(S, steps, m) squared errors, NaN where nothing follows; one that explodes counts no more than a large one."""
    with np.errstate(over="ignore", invalid="ignore"):
        errors = (following[..., : answers.shape[-1]] - answers) ** 2
    exploded = np.isfinite(following[..., :1]) & ~(errors < LARGEST_ERROR)
    return np.where(exploded, LARGEST_ERROR, errors)


def _by_length(squares: Sequence[Array]) -> Array:
    """(L, m) the mean of tables (S, steps, m), up to the last length that is in any."""
    table = np.concatenate(squares)
    return np.asarray(np.nanmean(table[:, np.isfinite(table).any(axis=(0, 2))], axis=0))


class Member(NamedTuple):
    """An autoregression of the outputs and of ``combinations`` (r, c) of the inputs, and its errors left out."""

    measured: Var  # for inputs that are known
    predicted: Var  # for unknown ones
    combinations: Array
    past: Array  # (lags, m + c) the last samples of the training data
    errors: LeftOutErrors

    @classmethod
    def of(cls, record: Record, combinations: Array, lags: int) -> Member | None:
        """Learns from the training data; ``None`` where they are too few."""
        combined = replace(record, inputs=record.inputs @ combinations, effect_directions=None)
        errors = left_out_errors(combined, lags)
        if errors is None:
            return None
        measured, predicted = (Var.learn(combined, lags, ridge) for ridge in (MEASURED_RIDGE, PREDICTED_RIDGE))
        return cls(measured, predicted, combinations, measured.past(combined), errors)

    def inferred_every(self, steps: int, inputs: Array, outputs: Array, smooth: bool) -> Forecast:
        """Forecasts anew at every ``steps``-th sample, inputs measured; its error grows outside the training data."""
        combined = inputs @ self.combinations
        mean = self.measured.infer_every(self.past, steps, combined, outputs, smooth).mean
        leverage = self.measured.leverage(self.past, steps, combined, outputs, mean)
        excess = np.maximum(1.0, running_mean(leverage[:, None], steps) / LEVERAGE_LIMIT)
        return Forecast(mean, by_length(self.errors.known, np.arange(len(inputs)) % steps) * excess**2)

    def predicted_every(self, steps: int, inputs: Array, outputs: Array) -> Forecast:
        """Forecasts with inputs unknown, begun again at every ``steps``-th sample."""
        mean = self.predicted.predict_every(self.past, steps, inputs @ self.combinations, outputs)
        return Forecast(mean, by_length(self.errors.unknown, np.arange(len(inputs)) % steps))


@dataclass(frozen=True, eq=False)
class Forecasts:
    """The forecasts of a learnt flight, motors known or unknown; all physical."""

    plant: PlantForecasts  # what its model forecasts
    turning: Array  # (r,) effects of the inputs on the axis
    measured: bool  # whether the motors count as measurements where they are known; else the plant forecasts alone

    @cached_property
    def members(self) -> tuple[Member, ...]:
        """The autoregressions that the training data suffice for."""
        record, r = self.plant.record, len(self.turning)
        with one_thread():
            members = [Member.of(record, np.eye(r), VAR_LAGS)]
            if self.turning.any() and r > 1:
                axis = self.turning[:, None] / np.linalg.norm(self.turning)
                members.append(Member.of(record, axis, AXIS_LAGS))
        return tuple(member for member in members if member is not None)

    def known(self, inputs: Array, smooth: bool = False) -> Forecast:
        """Forecasts the next samples with ``inputs`` (H, r); see :meth:`known_every`."""
        outputs = np.zeros((len(inputs), self.plant.record.outputs.shape[1]))
        return self.known_every(max(1, len(inputs)), inputs, outputs, smooth)

    def known_every(self, steps: int, inputs: Array, outputs: Array, smooth: bool = False) -> Forecast:
        """Forecasts anew at every ``steps``-th of the samples ``inputs`` (H, r) and ``outputs`` (H, m).

        Inputs are measured up to each sample; or, to ``smooth``, all of a forecast's.
        """
        steps = min(steps, max(1, len(inputs)))
        plant = self.plant.every(steps, inputs, outputs)
        if not (self.measured and self.members):
            return plant
        members = [member.inferred_every(steps, inputs, outputs, smooth) for member in self.members]
        return mixture([plant, *members, self._mean(steps, self._before(steps, outputs), len(outputs))], steps)

    def unknown(self, steps: int) -> Forecast:
        """Forecasts the next samples, (steps, m), without their inputs."""
        r, m = len(self.turning), self.plant.record.outputs.shape[1]
        return self.unknown_every(steps, np.zeros((steps, r)), np.zeros((steps, m)))

    def unknown_every(self, steps: int, inputs: Array, outputs: Array) -> Forecast:
        """Forecasts anew at every ``steps``-th of the samples ``inputs`` (H, r) and ``outputs`` (H, m) before it."""
        steps, length = min(steps, max(1, len(inputs))), len(outputs)
        before = self._before(steps, outputs)
        mean = self._mean(steps, before, length)
        if not self.members:
            return mean
        errors = by_length(self.members[0].errors.held, np.arange(length) % steps)
        held = Forecast(np.repeat(before, steps, axis=0)[:length], errors)
        members = [member.predicted_every(steps, inputs, outputs) for member in self.members]
        return mixture([*members, held, mean], steps)

    def half_widths(self, variance: Array, level: float, steps: int | None = None, motors: bool = True) -> Array:
        """Returns (H, m) of the band of probability ``level`` of forecasts of that ``variance``, begun each ``steps``.

        The variance is an estimate from as many forecasts as follow each other in the training data: Student's t.
        ``motors``: whether they are known.
        """
        if motors and not (self.measured and self.members):
            return np.asarray(self.plant.quantile(level) * np.sqrt(variance))
        lengths = np.arange(len(variance)) % (steps or max(1, len(variance))) + 1
        return half_width(variance, level, np.maximum(len(self.plant.record) / lengths, LEAST_FREEDOM)[:, None])

    def useful_steps(self, share: float) -> NDArray[np.intp]:
        """Returns (m,) the longest horizon up to which errors, inputs unknown, are below ``share`` of the variance."""
        variance = self.plant.record.outputs.var(axis=0)
        if not self.members:
            return np.zeros(len(variance), np.intp)
        errors = [member.errors.unknown for member in self.members]
        errors += [self.members[0].errors.held, np.maximum(self.members[0].errors.mean, variance)]
        length = min(map(len, errors))
        expected = mixture([Forecast(np.zeros((length, len(variance))), table[:length]) for table in errors], length)
        return np.asarray((np.maximum.accumulate(expected.variance) < share * variance).sum(axis=0))

    def _before(self, steps: int, outputs: Array) -> Array:
        """(S, m) the sample before each forecast."""
        return np.concatenate([self.plant.record.outputs[-1:], outputs])[: len(outputs) : steps]

    def _mean(self, steps: int, before: Array, length: int) -> Forecast:
        """The training mean, of forecasts that each begin after one of the samples ``before`` (S, m)."""
        outputs = self.plant.record.spread[1]
        # It errs at least as much as it does now, when the vehicle is far from it.
        now = np.repeat(np.maximum(outputs.variance, (before - outputs.mean) ** 2), steps, axis=0)[:length]
        if self.members:
            now = np.maximum(now, by_length(self.members[0].errors.mean, np.arange(length) % steps))
        return Forecast(np.broadcast_to(outputs.mean, now.shape), now)
