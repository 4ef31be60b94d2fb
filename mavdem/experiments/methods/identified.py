"""What methods other than DEM share: units, regression and the result; trivial forecasts and the joint VAR."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mavdem.arrays import Array
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE, one_thread
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.forecast.forecasting import ForecasterBase
from mavdem.dem.forecast.var import Forecast, VectorAutoregression
from mavdem.dem.record import Record, Segments, TrainingData
from mavdem.dem.validation import validated_count
from mavdem.facts import Fact, Facts
from mavdem.facts.forecasts import Forecasts, HeldOutForecast, MethodName

# inputs (T, k) and outputs (T, m) of each segment, in a method's units


@dataclass(frozen=True, eq=False, repr=False)
class Baseline(ForecasterBase):
    """A model with the name of its method and the training data."""

    method: str
    model: StateSpace | VectorAutoregression
    record: Record
    iterations: int | None = field(default=None, kw_only=True)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.method}, {len(self.record)} samples>"

    @cached_property
    def spectral_radius(self) -> float:
        """The largest magnitude among the eigenvalues of the model's step from sample to sample."""
        return self.model.spectral_radius

    @property
    def stable(self) -> bool:
        """Whether no mode grows, but for rounding."""
        return self.spectral_radius <= 1 + ROUNDING_TOLERANCE

    @property
    def cautions(self) -> Facts:
        """Limitations of the model."""
        cautions = []
        if not self.stable:
            cautions.append(
                Fact(Forecasts.MODEL_UNSTABLE, subject=self.method, growth=self.spectral_radius - 1)
            )
        if self.iterations is not None:
            cautions.append(
                Fact(Forecasts.STILL_IMPROVING, subject=self.method, iterations=self.iterations)
            )
        return tuple(cautions)


@dataclass(frozen=True, eq=False, repr=False)
class Identified(Baseline):
    """An identified model with its forecasts, in physical units; a :class:`mavdem.Forecaster`.

    Attributes:
        method: by which it was made, such as ``PEM(2)``.
        model: A, B, C, D and K of one sampling step.
        record: the training data.
        starts: (segments, n) the state of each segment's first sample, as the method has it.
        iterations: after which the method was still improving the model; ``None`` where it has converged.

    Raises:
        ValueError: from every method, for inputs or outputs of another shape or not finite, fewer steps than 1, or a
            prediction by a model on which inputs have an effect.
    """

    model: StateSpace
    starts: Array

    def one_step(self) -> Array:
        """Returns (T, m): each training sample predicted from those before it in its segment, and the inputs."""
        segments = zip(self.starts, self.record.segments, strict=True)
        return np.concatenate(
            [self.model.predicted_outputs(start, *segment) for start, segment in segments]
        )

    def rolling_forecast_unknown_inputs(
        self, steps: int, inputs: Array, outputs: Array
    ) -> Forecast:
        """Forecasts as :meth:`rolling_forecast_known_inputs`, for a model on which inputs have no effect.

        Args:
            steps: number of samples from the start of one forecast to the next.
            inputs: (H, r) inputs after the training data, which have no effect.
            outputs: (H, m) outputs after the training data; each forecast uses those before its start only.

        Raises:
            ValueError: inputs have an effect on the model, so that they must be known.
        """
        if self.model.B.any() or self.model.D.any():
            raise ValueError(
                f"{self.method} needs the inputs of the time it forecasts: use forecast(inputs), or "
                "mavdem.baselines.var for predictions without them"
            )
        return self.rolling_forecast_known_inputs(steps, inputs, outputs)

    def rolling_forecast_known_inputs(
        self, steps: int, inputs: Array, outputs: Array, smooth: bool = False
    ) -> Forecast:
        """Returns (H, m): a new forecast at every ``steps``-th of ``inputs`` (H, r), ``outputs`` (H, m).

        An unstable model's may overflow to infinity or NaN. Without feedthrough row h depends on the inputs before it.
        Inputs are causes in these models, so that ``smooth`` changes nothing. The size of errors is not known.
        """
        made = self.model.rolling_forecast(steps, self._last_state, inputs, outputs)
        return Forecast(made, np.full_like(made, np.nan))

    def forecast_from_zero_state(self, inputs: Array) -> Array:
        """Returns the outputs (H, m) with ``inputs`` (H, r) from state 0."""
        return self.model.simulate(np.zeros(len(self.model.A)), inputs)

    def simulate(self, inputs: ArrayLike) -> Array:
        """Returns the forecast of these ``inputs`` (H, r): the answer of the plant that is modelled."""
        return self.forecast(inputs)

    @cached_property
    def _last_state(self) -> Array:
        """(n,) of the sample after the training data."""
        return self.model.predicted_states(self.starts[-1], *self.record.segments[-1])[-1]


class Fitted(NamedTuple):
    """What a method found, in its units: a model, and the first states of segments (segments, n).

    ``iterations`` are those after which it was still improving, ``None`` where it has converged.
    """

    model: StateSpace
    starts: Array
    iterations: int | None = None


def identified(
    method: str,
    train: TrainingData,
    order: int,
    fit: Callable[[Segments, int], Fitted],
) -> Identified:
    """Returns the result of ``fit`` of the segments and the ``order``, called ``method(order)``."""
    order = validated_count(order, "order")
    record = Record.from_flights(train)
    with one_thread():
        units = Units.of(record)
        fitted = fit(units.segments(record), order)
    model = units.physical(fitted.model)
    return Identified(
        f"{method}({order})", model, record, fitted.starts, iterations=fitted.iterations
    )


RANK_TOLERANCE = np.sqrt(np.finfo(np.float64).eps)
"""Singular values of the regressors below this of the largest count as zero: of all solutions the smallest is taken."""


def regression(regressors: Array, targets: Array) -> Array:
    """Returns the least-squares solution (columns, k) of regressors (N, columns) · solution = targets (N, k).

    It is the smallest one.
    """
    return np.asarray(np.linalg.lstsq(regressors, targets, rcond=RANK_TOLERANCE)[0])


# that the last iteration gains of the likelihood; a parameter more gains 0.5 by chance
EM_NATS = 0.1

DEPENDENCE_TOLERANCE = 1e-6
"""A combination of inputs, each in units of its own deviation, that moves by less than this share of the
largest is dependent: the model gets the smallest B that explains the rest."""


class Units(NamedTuple):
    """y = output_trim + output_scale · (the method's y), and (the method's u) = (u − input_trim) input_map.

    The method's inputs are the principal components of the recorded ones, each of variance 1: fewer than those where
    some are constant or depend on others.
    """

    input_trim: Array  # (r,)
    input_map: Array  # (r, k), k ≤ r
    output_trim: Array  # (m,)
    output_scale: Array  # (m,)

    @classmethod
    def of(cls, record: Record) -> Units:
        """Returns units in which the training data have mean 0 and variance 1; ``ValueError`` for a constant output."""
        inputs, outputs = record.channel_statistics
        record.require_varying(False)
        scale = np.where(inputs.varying, np.sqrt(inputs.variance), np.inf)
        _, sizes, directions = np.linalg.svd(
            (record.inputs - inputs.mean) / scale, full_matrices=False
        )
        kept = sizes > DEPENDENCE_TOLERANCE * sizes[0]
        components = directions[kept].T / sizes[kept] * np.sqrt(len(record))
        return cls(
            inputs.mean, components / scale[:, None], outputs.mean, np.sqrt(outputs.variance)
        )

    def segments(self, record: Record) -> Segments:
        """Returns the record's segments, in the method's units."""
        return [
            (
                (inputs - self.input_trim) @ self.input_map,
                (outputs - self.output_trim) / self.output_scale,
            )
            for inputs, outputs in record.segments
        ]

    def physical(self, model: StateSpace) -> StateSpace:
        """Brings a model in the method's units, without feedthrough and trim of inputs, to physical ones."""
        scale = self.output_scale
        return replace(
            model,
            B=model.B @ self.input_map.T,
            C=scale[:, None] * model.C,
            D=np.zeros((len(scale), len(self.input_map))),
            K=model.K / scale,
            input_trim=self.input_trim,
            output_trim=self.output_trim + scale * model.output_trim,
        )


def hold(train: TrainingData) -> Identified:
    """Forecasts the last measurement of ``train``; the first sample of a segment is predicted by the mean."""
    return _without_dynamics("hold", train, held=True)


def constant_mean(train: TrainingData) -> Identified:
    """Forecasts the mean of the training data ``train``."""
    return _without_dynamics(HeldOutForecast.CONSTANT_MEAN, train)


def zero(train: TrainingData) -> Identified:
    """Forecasts zero, whatever the training data ``train``."""
    return _without_dynamics("zero", train, about=0.0)


def _without_dynamics(
    method: str, train: TrainingData, held: bool = False, about: float = 1.0
) -> Identified:
    """The training mean times ``about``; where ``held``, each output has a state, its last deviation from that."""
    record = Record.from_flights(train)
    r = record.inputs.shape[1]
    m = record.outputs.shape[1]
    n = m * held
    trim = about * record.outputs.mean(axis=0)
    B = np.zeros((n, r))
    D = np.zeros((m, r))
    model = StateSpace(np.eye(n), B, np.eye(m, n), D, np.eye(n, m), np.zeros(n), np.zeros(r), trim)
    return Identified(method, model, record, starts=np.zeros((len(record.lengths), n)))


def var(train: TrainingData, order: int = 10) -> JointAutoregression:
    """Models outputs and inputs as one autoregression of ``order`` lags, with a prior towards a random walk.

    Least squares with a ridge, the "Minnesota prior" (Litterman, 1986; see :mod:`mavdem.dem.forecast.var`). Unlike the
    other methods it can predict without the inputs; given them, it infers the outputs from what they show of the
    motion, by a Kalman filter. ``train`` and errors are as for :func:`mavdem.baselines.subspace`.
    """
    order = validated_count(order, "order")
    record = Record.from_flights(train)
    with one_thread():
        return JointAutoregression(
            f"{MethodName.JOINT_VAR}({order})", VectorAutoregression.learn(record, order), record
        )


@dataclass(frozen=True, eq=False, repr=False)
class JointAutoregression(Baseline):
    """A joint autoregression with its forecasts and predictions, in physical units; a :class:`mavdem.Forecaster`.

    Attributes:
        method: its name, such as ``joint VAR(10)``.
        model: its parameters.
        record: the training data.
        iterations: none; it has a solution.

    Raises:
        ValueError: from every method, for inputs or outputs of another shape or not finite, or fewer steps than 1.
    """

    model: VectorAutoregression

    def one_step(self) -> Array:
        """Returns (T, m): each training sample from those before it in its segment, and the inputs up to its own."""
        return self.model.one_step_predictions(self.record)

    def rolling_forecast_unknown_inputs(
        self, steps: int, inputs: Array, outputs: Array
    ) -> Forecast:
        """Returns (H, m): a new prediction at every ``steps``-th of ``inputs`` (H, r), ``outputs`` (H, m)."""
        return self.model.rolling_forecast_unknown_inputs(self._past, steps, inputs, outputs)

    def rolling_forecast_known_inputs(
        self, steps: int, inputs: Array, outputs: Array, smooth: bool = False
    ) -> Forecast:
        """Returns (H, m): a new forecast at every ``steps``-th of ``inputs`` (H, r), ``outputs`` (H, m).

        To ``smooth``, all inputs of a forecast count.
        """
        return self.model.rolling_forecast_known_inputs(self._past, steps, inputs, outputs, smooth)

    def forecast_from_zero_state(self, inputs: Array) -> Array:
        """Returns the outputs (H, m) with ``inputs`` (H, r), after all channels were at their mean."""
        past = np.tile(self.model.scaling.center, (self.model.lags, 1))
        return self.model.forecast_known_inputs(past, inputs).mean

    def simulate(self, inputs: ArrayLike) -> Array:
        """Refuses, with a ``ValueError``: this model has no plant whose ``inputs`` could be commanded."""
        raise ValueError(
            f"{self.method} takes the inputs for the autopilot's answer to the motion, and has no plant to command: "
            "use Learned.simulate"
        )

    @cached_property
    def _past(self) -> Array:
        return self.model.last_samples(self.record)
