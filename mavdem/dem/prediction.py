"""Prediction: the state carried along the samples, one step ahead, and over a whole forecast.

The D step reads each sample by itself, which says where the vehicle is but cannot carry a hidden state from one
sample to the next. So the learnt model and its noises are put into a steady-state Kalman filter, in which the
coloured noises count with their power at low frequency, Σ · 2s√π: what noise of that colour does to a slower state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from mavdem.dem.model import Transition, discretize, unpack
from mavdem.dem.recursion import recursion

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Predictor:
    """A discrete model with its filter gain, in the engine's units.

    Attributes:
        transition: over one sampling step, of a state (n,): that of the vehicle, which may carry more with it.
        C: (m, n).
        gain: (n, m): how far a prediction error moves the state.
        of_outputs, of_inputs: (n, m), (n, r): the state at a first sample, from its outputs and inputs alone.
    """

    transition: Transition
    C: Array
    gain: Array
    of_outputs: Array
    of_inputs: Array

    @classmethod
    def of(
        cls, A: Array, B: Array, C: Array, dt: float, measurement_noise: Array, process_noise: Array, smoothness: float
    ) -> Predictor:
        """The predictor of a continuous model with noise variances (m,) of z and covariance (n, n) of w.

        Raises:
            numpy.linalg.LinAlgError: no filter settles, as when an unstable state is not seen in the outputs.
        """
        transition = discretize(A, B, dt)
        power = 2 * smoothness * np.sqrt(np.pi)
        Q = process_noise * power * dt
        # Measurements are samples: noise that forgets within a step has its variance and no more.
        R = np.diag(measurement_noise) * max(power / dt, 1.0)
        try:
            P = solve_discrete_are(transition.state.T, C.T, Q, R)
        except ValueError as error:
            raise np.linalg.LinAlgError(f"no filter settles: {error}") from None
        return cls._with(transition, C, np.linalg.solve(C @ P @ C.T + R, C @ P).T)

    @classmethod
    def _with(cls, transition: Transition, C: Array, gain: Array) -> Predictor:
        """Begins with the state that the first outputs ask for."""
        return cls(transition, C, gain, np.asarray(np.linalg.pinv(C), np.float64), np.zeros_like(transition.input_now))

    def of_theta(self, theta: Array, sizes: tuple[int, int, int], dt: float) -> Predictor:
        """The same filter for a model with other parameters θ (k,), of n states, r inputs and m outputs."""
        A, B, C = unpack(theta, *sizes)
        return Predictor._with(discretize(A, B, dt), C, self.gain)

    def at_rest(self, inputs: Array) -> Array:
        """(n,) the state of outputs at their trim, where the inputs (r,) have long been what they are."""
        return self.of_inputs @ inputs

    def filtered(self, outputs: Array, inputs: Array) -> Array:
        """States (T, n), each given the samples up to and including its own; the first from its outputs alone."""
        drive = self._drive(inputs)
        keep = np.eye(len(self.gain)) - self.gain @ self.C
        first = self.of_outputs @ outputs[0] + self.of_inputs @ inputs[0]
        pushes = drive @ keep.T + outputs[1:] @ self.gain.T
        return np.vstack([first, recursion(keep @ self.transition.state, pushes, first)])

    def one_step(self, outputs: Array, inputs: Array) -> Array:
        """(T − 1, m): each sample after the first, predicted from those before it and from its inputs."""
        states = self.filtered(outputs, inputs)[:-1]
        return (states @ self.transition.state.T + self._drive(inputs)) @ self.C.T

    def forecast(self, state: Array, inputs: Array) -> Array:
        """(H, m): outputs of the H samples after ``state`` (n,), whose own input is row 0 of inputs (H + 1, r)."""
        return recursion(self.transition.state, self._drive(inputs), state) @ self.C.T

    def forecast_errors(self, outputs: Array, inputs: Array, horizon: int, starts: Array) -> Array:
        """Errors (starts, horizon, m) of forecasts that begin at the given samples of a recorded stretch."""
        states = self.filtered(outputs, inputs)[starts]
        drive = self._drive(inputs)
        errors = np.empty((len(starts), horizon, outputs.shape[1]))
        for step in range(horizon):
            states = states @ self.transition.state.T + drive[starts + step]
            errors[:, step] = outputs[starts + step + 1] - states @ self.C.T
        return errors

    def forecast_every(self, steps: int, outputs: Array, inputs: Array, first: int) -> Array:
        """(T − first, m): the samples from ``first`` ≥ 1 on, forecast from every ``steps``-th of them on."""
        states, drive = self.filtered(outputs, inputs)[first - 1 : -1], self._drive(inputs)[first - 1 :]
        predicted, begun = np.empty((len(drive), outputs.shape[1])), np.arange(0, len(drive), steps)
        states = states[begun]
        for rows in (begun + step for step in range(min(steps, len(drive)))):
            there = rows[rows < len(drive)]
            states = states[: len(there)] @ self.transition.state.T + drive[there]
            predicted[there] = states @ self.C.T
        return predicted

    def ahead(self, horizons: Sequence[int]) -> tuple[Array, Array]:
        """Maps (H, m, n) and (H, m, r) from state and inputs to the outputs so many steps on, with inputs held."""
        F = self.transition.state
        push = self.transition.input_now + self.transition.input_next
        n, r = push.shape
        step = np.block([[F, push], [np.zeros((r, n)), np.eye(r)]])
        there = np.array([self.C @ np.linalg.matrix_power(step, horizon)[:n] for horizon in horizons])
        return there[:, :, :n], there[:, :, n:]

    def _drive(self, inputs: Array) -> Array:
        """What the inputs add to the state in each step, (T − 1, n)."""
        return inputs[:-1] @ self.transition.input_now.T + inputs[1:] @ self.transition.input_next.T
