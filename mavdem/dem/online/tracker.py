"""Tracking: a learnt model's state along the samples, its predictions, and how well each sample agrees with them."""

from __future__ import annotations

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.dem.online.memory import Memory
from mavdem.dem.online.refit import OnlineRefit, Snapshot


class Tracker:
    """The filter of a snapshot; its ``state`` (n,) is the next sample's, ``None`` before a segment's first."""

    def __init__(self, snapshot: Snapshot, refit: OnlineRefit, horizons: tuple[int, ...], weight: Array | None) -> None:
        self.now, self.window, self._statistics = snapshot, refit.settings.window, refit.statistics
        self.state: Array | None = None
        self._of_state, self._of_inputs = snapshot.predictor.ahead(horizons)
        if weight is not None:
            # Forecasts are shrunk towards the trim.
            shrunk = weight[np.minimum(horizons, len(weight)) - 1][:, :, None]
            self._of_state, self._of_inputs = self._of_state * shrunk, self._of_inputs * shrunk

    def find_state(self, inputs: Array, outputs: Array) -> None:
        """Filters the latest samples, (T, r) and (T, m)."""
        if len(outputs):
            scaling = self.now.scaling
            u, y = scaling.scale_inputs(inputs), scaling.scale_outputs(outputs)
            self.state = self.now.predictor.at_end(u, y)

    def filter(self, begins: bool, inputs: Array, outputs: Array) -> Array:
        """Advances the state by a sample; returns the sample's prediction (m,), NaN where a segment ``begins``."""
        scaling, predictor = self.now.scaling, self.now.predictor
        if self.state is None or begins:
            self.find_state(inputs[None], outputs[None])
            return np.full(len(outputs), np.nan)
        u, y = scaling.scale_inputs(inputs[None])[0], scaling.scale_outputs(outputs)
        expected = predictor.outputs(self.state, u)
        self.state = predictor.following(self.state, u, y)
        return scaling.physical_outputs(expected)

    def ahead(self, inputs: Array) -> Array:
        """(H, m): predictions at the horizons, with the inputs held."""
        assert self.state is not None
        u = self.now.scaling.scale_inputs(inputs[None])[0]
        return self.now.scaling.physical_outputs(self._of_state @ self.state + self._of_inputs @ u)

    def evaluate(self, memory: Memory) -> tuple[float, Array]:
        """F(t) less its priors and disturbance, at the centre of the latest window; NaN where there is no whole one."""
        inputs, outputs = memory.latest(self.window)
        if len(outputs) < self.window:
            return np.nan, np.full(len(self.now.disturbance), np.nan)
        data = self.now.to_engine @ self._statistics.of_window(outputs, inputs)
        states = self.now.state_map @ data
        energy = float(self.now.energy.at(data[None], states[None])[0]) - self.now.energy.priors
        return energy, self.now.disturbance @ states
