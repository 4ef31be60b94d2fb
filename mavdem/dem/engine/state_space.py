"""The discrete linear model in innovation form: it filters, predicts, forecasts and simulates.

The D step uses the samples of one window, which cannot carry a hidden state from one sample to the next. So the learned
model and its noises are put into a steady-state Kalman filter, in which the coloured noises count with their power at
low frequency, Σ · 2s√π: the effect that noise of that colour has on a slower state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mavdem.arrays import Array, Indices
from mavdem.dem.engine.kalman import steady_state_gain
from mavdem.dem.engine.linalg import may_overflow
from mavdem.dem.engine.model import Transition, discretize, linear_recursion


@dataclass(frozen=True, eq=False)
class StateSpace:
    """x⁺ = A x + B (u − input_trim) + offset + K e,  y = C x + D (u − input_trim) + output_trim + e.

    One step is one sample, e is the error of predicting y from all samples before it. With D = 0 the input of an
    instant moves the outputs from the next sample on. Several models may be held at once, their matrices with a leading
    axis. A segment's second state is ``second_of_outputs`` times its first outputs plus ``second_of_inputs`` times its
    first inputs.
    """

    A: Array  # (n, n)
    B: Array  # (n, r)
    C: Array  # (m, n)
    D: Array  # (m, r)
    K: Array  # (n, m)
    offset: Array  # (n,)
    input_trim: Array  # (r,)
    output_trim: Array  # (m,)
    # (n, m) state of a segment's second sample, from the outputs of its first
    second_of_outputs: Array | None = None
    second_of_inputs: Array | None = None  # (n, r) likewise from the inputs of its first

    @staticmethod
    def from_transition(transition: Transition, C: Array, gain: Array) -> StateSpace:
        """Returns the same model as one whose state is corrected by gain · e at each sample: A = Φ, K = Φ gain.

        Inputs run linearly between samples, so that B = Φ Γ₁ + Γ₀ and D = C Γ₁ (Franklin, Powell and Workman, sec.
        4.3.2). The ``transition`` is over one sampling step, C is (m, n), and ``gain`` (n, m) is of the filter.
        The corrected state at a first sample is the least that gives its outputs.
        """
        state, now, later = transition
        n, r = now.shape[-2:]
        matrices = state, state @ later + now, C, C @ later, state @ gain
        constants = np.zeros(n), np.zeros(r), np.zeros(len(C))
        second = state @ np.linalg.pinv(C), now
        # In C order, as those of a loaded document: in another order a product rounds differently.
        return StateSpace(
            *(np.ascontiguousarray(array) for array in (*matrices, *constants, *second))
        )

    @property
    def spectral_radius(self) -> float:
        """The largest magnitude among the eigenvalues of A; 0 of a model without states."""
        return float(abs(np.linalg.eigvals(self.A)).max(initial=0.0))

    def second_state(self, inputs: Array, outputs: Array) -> Array:
        """Returns (n,) state of a segment's second sample, from the inputs (r,) and outputs (m,) of its first."""
        assert self.second_of_outputs is not None and self.second_of_inputs is not None
        return outputs @ self.second_of_outputs.T + inputs @ self.second_of_inputs.T

    def predicted_states(self, start: Array, inputs: Array, outputs: Array) -> Array:
        """Returns states (T + 1, n): of each sample predicted from those before it, and of the one after the last.

        They begin at ``start`` (n,), with ``inputs`` (T, r) and ``outputs`` (T, m).
        """
        pushes = self._pushes(inputs) + (outputs - self.feedthrough(inputs)) @ self.K.T
        return np.vstack([start, linear_recursion(self.A - self.K @ self.C, pushes, start)])

    def predicted_outputs(self, start: Array, inputs: Array, outputs: Array) -> Array:
        """Returns (T, m) samples predicted from those before.

        ``start``, ``inputs`` and ``outputs`` are as in :meth:`filtered`.
        """
        return self.noise_free_outputs(self.predicted_states(start, inputs, outputs)[:-1], inputs)

    def one_step_predictions(self, inputs: Array, outputs: Array) -> Array:
        """Predicts ``outputs`` (T, m) but the first, (T − 1, m), from those before and ``inputs`` (T, r)."""
        return self.predicted_outputs(
            self.second_state(inputs[0], outputs[0]), inputs[1:], outputs[1:]
        )

    def state_after(self, inputs: Array, outputs: Array) -> Array:
        """Returns (n,) state of the sample after a segment of ``inputs`` (T, r) and ``outputs`` (T, m)."""
        return self.predicted_states(
            self.second_state(inputs[0], outputs[0]), inputs[1:], outputs[1:]
        )[-1]

    def simulate(self, start: Array, inputs: Array) -> Array:
        """Returns (H, m) outputs without noise, the first of state ``start`` (n,), of inputs (H, r).

        Outputs of an unstable model may overflow to infinity or NaN.
        """
        first = np.zeros(1, int)
        return self.simulate_from(first, len(inputs), start[None], inputs)[0]

    @may_overflow
    def simulate_from(
        self,
        begins: Indices,
        horizon: int,
        states: Array,
        inputs: Array,
    ) -> Array:
        """Returns (S, H, m) outputs without noise, from each of the samples ``begins`` (S,), of ``states`` (S, n), on.

        The ``horizon`` is H; beyond the last row of ``inputs`` (T, r) they stay as they are there.
        """
        direct = self.feedthrough(inputs)
        pushes = self._pushes(inputs)
        predicted = np.empty((len(begins), horizon, len(self.C)))
        for step in range(horizon):
            rows = np.minimum(begins + step, len(inputs) - 1)
            predicted[:, step] = states @ self.C.T + direct[rows]
            states = states @ self.A.T + pushes[rows]
        return predicted

    @may_overflow
    def rolling_forecast(
        self,
        steps: int,
        start: Array,
        inputs: Array,
        outputs: Array,
    ) -> Array:
        """Returns (T, m) outputs without noise, from every ``steps``-th sample's state on.

        That state is predicted from all samples before it. ``start`` (n,) is the first sample's state, with ``inputs``
        (T, r) and ``outputs`` (T, m).
        """
        begins = np.arange(0, len(inputs), steps)
        steps = min(steps, len(inputs))
        states = self.predicted_states(start, inputs, outputs)[begins]
        return self.simulate_from(begins, steps, states, inputs).reshape(-1, len(self.C))[
            : len(inputs)
        ]

    def noise_free_outputs(self, states: Array, inputs: Array) -> Array:
        """Returns (T, m) outputs of states (T, n) and inputs (T, r), without noise."""
        return states @ self.C.T + self.feedthrough(inputs)

    def feedthrough(self, inputs: Array) -> Array:
        """Returns (T, m) part of the outputs that ``inputs`` (T, r) and the trim make, not the state."""
        return (inputs - self.input_trim) @ self.D.T + self.output_trim

    def _pushes(self, inputs: Array) -> Array:
        return (inputs - self.input_trim) @ self.B.T + self.offset


def filter_gain(
    A: Array,
    C: Array,
    dt: float,
    measurement_noise: Array,
    process_noise: Array,
    smoothness: float,
) -> Array:
    """Returns (n, m) gain of the steady-state Kalman filter of a continuous model with coloured noise.

    Variances of z are ``measurement_noise`` (m,), the covariance of w is ``process_noise`` (n, n); both have kernel
    width ``smoothness``, s. ``LinAlgError`` where there is no steady filter, as when no output shows an unstable state.
    """
    state = discretize(A, np.empty((len(A), 0)), dt).Phi
    power = 2 * smoothness * np.sqrt(np.pi)
    # Measurements are samples: noise whose correlation is shorter than a step has its variance and no more.
    R = np.diag(measurement_noise) * max(power / dt, 1.0)
    _, P = steady_state_gain(state, C, process_noise * power * dt, R)
    return np.ascontiguousarray(np.linalg.solve(C @ P @ C.T + R, C @ P).T)
