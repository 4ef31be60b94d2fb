"""Tracker: carries a learnt model's state along the samples, predicts what comes and judges what came."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.climber import Climber, Snapshot
from mavdem.dem.memory import Memory

Array = NDArray[np.float64]


class Tracker:
    """A snapshot at work.

    Attributes:
        now: the snapshot.
        window: samples of its embedding window.
        state: (n,) in the engine's units; ``None`` before the first sample of a segment.
    """

    def __init__(self, snapshot: Snapshot, climber: Climber, horizons: tuple[int, ...], weight: Array | None) -> None:
        assert climber.settings.window is not None
        self.now, self.window, self._moments = snapshot, climber.settings.window, climber.moments
        self.state: Array | None = None
        self._of_state, self._of_inputs = snapshot.predictor.ahead(horizons)
        if weight is not None:
            # Forecasts are drawn back towards the trim as those of unseen data advise.
            shrunk = weight[np.minimum(horizons, len(weight)) - 1][:, :, None]
            self._of_state, self._of_inputs = self._of_state * shrunk, self._of_inputs * shrunk

    def find_state(self, inputs: Array, outputs: Array) -> None:
        """Filters the latest samples, (T, r) and (T, m)."""
        if len(outputs):
            scaling = self.now.scaling
            u, y = scaling.scale_inputs(inputs), scaling.scale_outputs(outputs)
            self.state = self.now.predictor.filtered(y, u)[-1]

    def filter(self, before: Array | None, inputs: Array, outputs: Array) -> Array:
        """Moves the state on by a sample; answers what it was expected to be, (m,)."""
        scaling, predictor = self.now.scaling, self.now.predictor
        if self.state is None or before is None:
            self.find_state(inputs[None], outputs[None])
            return np.full(len(outputs), np.nan)
        u = scaling.scale_inputs(np.array([before, inputs]))
        transition = predictor.transition
        state = transition.state @ self.state + transition.input_now @ u[0] + transition.input_next @ u[1]
        expected = predictor.C @ state
        self.state = state + predictor.gain @ (scaling.scale_outputs(outputs) - expected)
        return scaling.physical_outputs(expected)

    def ahead(self, inputs: Array) -> Array:
        """(H, m): predictions at the horizons, with the inputs held."""
        assert self.state is not None
        u = self.now.scaling.scale_inputs(inputs[None])[0]
        return self.now.scaling.physical_outputs(self._of_state @ self.state + self._of_inputs @ u)

    def judge(self, memory: Memory) -> tuple[float, Array]:
        """F(t) less its priors and disturbance, at the centre of the latest window; NaN where there is no whole one."""
        inputs, outputs = memory.latest(self.window)
        if len(outputs) < self.window:
            return np.nan, np.full(len(self.now.disturbance), np.nan)
        data = self.now.to_engine @ self._moments.of_window(outputs, inputs)
        states = self.now.state_map @ data
        energy = float(self.now.energy.at(data[None], states[None])[0]) - self.now.energy.priors
        return energy, self.now.disturbance @ states
