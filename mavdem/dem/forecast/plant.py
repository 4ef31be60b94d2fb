"""Forecasts by DEM's A, B and C alone: the plant, whose motors are causes, as in the paper."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.forecast.var import Forecast
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling

LONGEST_FORECAST_SECONDS = 1.5  # whose errors are looked at: the paper's 150 samples
MOST_STARTS = 200


@dataclass(frozen=True, eq=False)
class PlantForecasts:
    """What the plant forecasts after its training data; arguments and results are physical."""

    record: Record
    scaling: Scaling
    predictor: StateSpace

    def from_zero(self, inputs: Array) -> Array:
        """Returns the outputs (H, m) with ``inputs`` (H, r) from state 0, the outputs at their trim."""
        u, trim = self.scaling.scale_inputs(inputs), np.zeros((min(1, len(inputs)), len(self.scaling.output_trim)))
        if len(u) > 1:
            trim = np.vstack([trim, self.predictor.simulated(self.predictor.second(u[0], trim[0]), u[1:])])
        return self.scaling.physical_outputs(trim)

    def every(self, steps: int, inputs: Array, outputs: Array) -> Forecast:
        """Returns (H, m): forecasts begun at every ``steps``-th of ``inputs`` (H, r) and ``outputs`` (H, m)."""
        last = self.record.segments[-1]
        state = self.predictor.at_end(self.scaling.scale_inputs(last[0]), self.scaling.scale_outputs(last[1]))
        u, y = self.scaling.scale_inputs(inputs), self.scaling.scale_outputs(outputs)
        made = self.predictor.simulated_every(max(1, steps), state, u, y)
        lengths = np.minimum(np.arange(len(u)) % max(1, steps), len(self.errors) - 1)
        return Forecast(self.scaling.physical_outputs(made), self.errors[lengths])

    @cached_property
    def errors(self) -> Array:
        """(L, m) mean squared errors of forecasts of the training data, by length; infinite where these overflow."""
        horizon = max(1, min(round(LONGEST_FORECAST_SECONDS / self.record.dt), 2 * self.record.longest // 3))
        squares = []
        for inputs, outputs in self.record.segments:
            last = len(outputs) - horizon - 1
            if last < 0:
                continue
            # The filter needs a few samples to find hidden states.
            share = max(1, round(MOST_STARTS * len(outputs) / len(self.record)))
            starts = np.unique(np.linspace(min(horizon // 4, last), last, share).astype(int))
            u, y = self.scaling.scale_inputs(inputs), self.scaling.scale_outputs(outputs)
            with np.errstate(over="ignore", invalid="ignore"):
                states = self.predictor.filtered(self.predictor.second(u[0], y[0]), u[1:], y[1:])[starts]
                ahead = self.predictor.simulated_from(starts + 1, horizon, states, u)
                squares.append((y[starts[:, None] + 1 + np.arange(horizon)] - ahead) ** 2)
        with np.errstate(over="ignore", invalid="ignore"):
            mean = np.concatenate(squares).mean(axis=0) * self.scaling.output_scale**2
        return np.where(np.isfinite(mean), mean, np.inf)
