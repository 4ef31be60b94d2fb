"""State-space models by other methods than DEM: how such a method is run, and how its model forecasts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
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
from mavdem.experiments.methods.scaling import NormalizedUnits
from mavdem.facts import Fact, Facts
from mavdem.facts.forecasts import ForecastFact


@dataclass(frozen=True, eq=False, repr=False)
class Baseline(ForecasterBase):
    """Base class of models by methods that DEM is compared with, such as PEM: the model and its training data.

    Attributes:
        method: name of the method, such as ``PEM(2)``.
        model: the parameters.
        record: the training data.
        iterations: number of iterations after which the method was still improving the model; ``None`` where it has
            converged, or needs none.
    """

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
        """Whether no mode grows, up to rounding."""
        return self.spectral_radius <= 1 + ROUNDING_TOLERANCE

    @property
    def cautions(self) -> Facts:
        """What a user of the model's forecasts must know about its limits, a sentence each; empty if there is nothing.

        The forecasts of an unstable model grow without bound: the largest eigenvalue of its step from sample to sample
        is outside the unit circle, by the figure ``growth``. A method may also have stopped at its limit of iterations
        before it converged.
        """
        cautions = []
        if not self.stable:
            cautions.append(
                Fact(
                    ForecastFact.MODEL_UNSTABLE,
                    subject=self.method,
                    growth=self.spectral_radius - 1,
                )
            )
        if self.iterations is not None:
            cautions.append(
                Fact(ForecastFact.STILL_IMPROVING, subject=self.method, iterations=self.iterations)
            )
        return tuple(cautions)


@dataclass(frozen=True, eq=False, repr=False)
class Identified(Baseline):
    """An identified state-space model with its forecasts, in physical units; a :class:`mavdem.Forecaster`.

    Attributes:
        method: by which it was made, such as ``PEM(2)``.
        model: A, B, C, D and K of one sampling step.
        record: the training data.
        starts: (segments, n) the state of each segment's first sample, as the method estimates it.
        iterations: number of iterations after which the method was still improving the model; ``None`` where it has
            converged.

    Raises:
        ValueError: from every method, for inputs or outputs of another shape or not finite, fewer steps than 1, or a
            prediction by a model on which inputs have an effect.
    """

    model: StateSpace
    starts: Array

    def one_step(self) -> Array:
        """Predicts each training sample from the samples before it in its segment, and the inputs.

        Each segment begins with the state that the method estimated for its first sample.

        Returns:
            (T, m) predictions in the outputs' units, of all segments one after the other.
        """
        predictions = []
        for start, (inputs, outputs) in zip(self.starts, self.record.segments, strict=True):
            predictions.append(self.model.predicted_outputs(start, inputs, outputs))
        return np.concatenate(predictions)

    def rolling_forecast_unknown_inputs(
        self, steps: int, inputs: Array, outputs: Array
    ) -> Forecast:
        """Forecasts the outputs without the inputs during the forecast.

        Only models whose inputs have no effect, such as the constant mean, can do that: a plant model needs to know the
        motors.

        Args:
            steps: number of samples of each forecast.
            inputs: (H, r) inputs after the training data; they have no effect.
            outputs: (H, m) of the same samples, from which the state at the start of each forecast is filtered.

        Returns:
            Means and variances of the outputs (H, m), with a new forecast at every ``steps``-th sample.

        Raises:
            ValueError: inputs have an effect on the model.
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
        """Forecasts the outputs after the training data, with a new forecast at every ``steps``-th sample.

        Args:
            steps: samples of each forecast.
            inputs: (H, r) inputs after the training data. In a model without feedthrough (D = 0), the forecast of a
                sample depends only on the inputs before it.
            outputs: (H, m) of the same samples, from which the state at the start of each forecast is filtered.
            smooth: has no effect here, since these models take inputs for causes and not for measurements; it is part
                of the interface that all forecasters share.

        Returns:
            Means (H, m), which may overflow to infinity or NaN for an unstable model. Variances are NaN: these methods
            do not estimate the size of their errors.
        """
        forecast = self.model.rolling_forecast(steps, self._last_state, inputs, outputs)
        return Forecast(forecast, np.full_like(forecast, np.nan))

    def forecast_from_zero_state(self, inputs: Array) -> Array:
        """Returns the outputs (H, m) with ``inputs`` (H, r) from state 0."""
        return self.model.simulate(np.zeros(len(self.model.A)), inputs)

    def simulate(self, inputs: ArrayLike) -> Array:
        """Returns the forecast of these ``inputs`` (H, r): the response of the plant that is modelled."""
        return self.forecast(inputs)

    @cached_property
    def _last_state(self) -> Array:
        """The state (n,) of the sample after the training data."""
        inputs, outputs = self.record.segments[-1]
        return self.model.predicted_states(self.starts[-1], inputs, outputs)[-1]


class NormalizedFit(NamedTuple):
    """The result of a method in normalized units."""

    model: StateSpace
    """A, B, C, D, K, offset and trims"""
    starts: Array
    """(segments, n) the state of each segment's first sample"""
    iterations: int | None = None
    """iterations after which the method was still improving the model; ``None`` where it has converged"""


def identified(
    method: str,
    train: TrainingData,
    order: int,
    fit: Callable[[Segments, int], NormalizedFit],
) -> Identified:
    """Identifies a state-space model: normalizes the data, runs a method on them, and converts its model back.

    Normalized, the outputs and the principal components of the inputs have mean 0 and variance 1, so that all methods
    weigh the outputs alike and none meets inputs that depend on each other; see :class:`NormalizedUnits`.

    Args:
        method: name of the method, such as "PEM"; with the order it is the name of the model, such as "PEM(2)".
        train: a flight of r inputs and m outputs, or segments of one.
        order: number of states n.
        fit: the method. It takes the segments in normalized units, each as inputs (T, k) and outputs (T, m), and n.

    Returns:
        The model in the flight's own units, with the first state of each segment and the training data.

    Raises:
        ValueError: the order is no positive number, an output is constant, or the data do not support the fit.
    """
    order = validated_count(order, "order")
    record = Record.from_flights(train)
    # The matrices are so small that several threads would only cost time.
    with one_thread():
        units = NormalizedUnits.of(record)
        normalized_fit = fit(units.normalized_segments(record), order)
    model = units.physical_model(normalized_fit.model)
    return Identified(
        f"{method}({order})",
        model,
        record,
        normalized_fit.starts,
        iterations=normalized_fit.iterations,
    )
