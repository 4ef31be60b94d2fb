"""The discrete linear model in innovation form, which filters, predicts, forecasts and simulates.

The D step uses the samples of one short window, and carries no hidden state from one sample to the next. So the learned
model and its noises are put into a steady-state Kalman filter. A noise with the correlation of a Gaussian kernel of
width s acts on a slower state like white noise of the same power density at low frequency, Σ · 2s√π.
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
    """The linear model x⁺ = A x + B u + K e, y = C x + D u + e in innovation form: a model with its Kalman filter.

    With trims and offset it is (Ljung, System Identification, 2nd ed., sec. 4.3)

        x⁺ = A x + B (u − input_trim) + offset + K e,    y = C x + D (u − input_trim) + output_trim + e

    One step is one sample. The state x of a sample is predicted from all samples before it, and the innovation e is the
    error of predicting y. With D = 0 the inputs of a sample move the outputs from the next sample on. Several models
    may be held at once, their matrices with a leading axis.
    """

    A: Array
    """(n, n) state transition matrix."""

    B: Array
    """(n, r) input matrix."""

    C: Array
    """(m, n) output matrix."""

    D: Array
    """(m, r) feedthrough of the inputs to the outputs of the same sample."""

    K: Array
    """(n, m) innovation gain."""

    offset: Array
    """(n,) constant that is added to the state at each step."""

    input_trim: Array
    """(r,) inputs about which the model is linear."""

    output_trim: Array
    """(m,) outputs about which the model is linear."""

    second_of_outputs: Array | None = None
    """(n, m) map from the outputs of a segment's first sample to the state of its second; ``None`` if not defined."""

    second_of_inputs: Array | None = None
    """(n, r) map from the inputs of a segment's first sample to the state of its second; ``None`` if not defined."""

    @staticmethod
    def from_transition(transition: Transition, C: Array, gain: Array) -> StateSpace:
        """Returns the innovation form of a first-order-hold model with a Kalman filter.

        The model over a step is x_{t+1} = Φ x_t + Γ₀ u_t + Γ₁ u_{t+1}, in which the state depends on the inputs of the
        same sample. With x − Γ₁ u as the state, that dependence becomes the feedthrough D = C Γ₁, and B = Φ Γ₁ + Γ₀
        (Franklin, Powell and Workman, sec. 4.3.2). The filter corrects its state at each sample by gain · e, so that
        A = Φ and K = Φ · gain. A segment starts with the state of least norm that explains its first outputs, C⁺ y.

        Args:
            transition: the model over one sampling step; leading axes are several models.
            C: (m, n) output matrix.
            gain: (n, m) gain of the filter.

        Returns:
            The innovation form, without trims.
        """
        Phi, Gamma0, Gamma1 = transition
        n, r = Gamma0.shape[-2:]
        arrays = {
            "A": Phi,
            "B": Phi @ Gamma1 + Gamma0,
            "C": C,
            "D": C @ Gamma1,
            "K": Phi @ gain,
            "offset": np.zeros(n),
            "input_trim": np.zeros(r),
            "output_trim": np.zeros(len(C)),
            "second_of_outputs": Phi @ np.linalg.pinv(C),
            "second_of_inputs": Gamma0,
        }
        # The arrays are stored in C order, like the arrays of a loaded document: in another memory order a matrix
        # product may round differently.
        contiguous_arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        return StateSpace(**contiguous_arrays)

    @property
    def spectral_radius(self) -> float:
        """Largest magnitude of the eigenvalues of A; 0 for a model without states."""
        return float(abs(np.linalg.eigvals(self.A)).max(initial=0.0))

    def second_state(self, inputs: Array, outputs: Array) -> Array:
        """Returns the state with which the filter starts: at a segment's second sample.

        As no sample precedes the first one, its state cannot be predicted. It is estimated from the first outputs, and
        propagated by one step with the first inputs. Both steps together are linear in the first sample, with the
        matrices ``second_of_outputs`` and ``second_of_inputs``.

        Args:
            inputs: (r,) inputs of the first sample.
            outputs: (m,) outputs of the first sample.

        Returns:
            The state (n,) of the second sample.
        """
        state_by_outputs = self.second_of_outputs
        state_by_inputs = self.second_of_inputs
        assert state_by_outputs is not None and state_by_inputs is not None
        return outputs @ state_by_outputs.T + inputs @ state_by_inputs.T

    def predicted_states(self, start: Array, inputs: Array, outputs: Array) -> Array:
        """Runs the Kalman filter over a segment: each state is predicted from all samples before it.

        Args:
            start: (n,) state of the first sample.
            inputs: (T, r) inputs.
            outputs: (T, m) measured outputs.

        Returns:
            States (T + 1, n), each predicted from the samples before it; the last is of the sample after the
            segment.
        """
        # With e = y − C x − D u the state follows x⁺ = (A − K C) x + B u + K (y − D u).
        forcing = self._input_forcing(inputs) + (outputs - self.feedthrough(inputs)) @ self.K.T
        return np.vstack([start, linear_recursion(self.A - self.K @ self.C, forcing, start)])

    def predicted_outputs(self, start: Array, inputs: Array, outputs: Array) -> Array:
        """Predicts the outputs of each sample of a segment from the samples before it and from its own inputs.

        Args:
            start: (n,) state of the first sample.
            inputs: (T, r) inputs.
            outputs: (T, m) measured outputs.

        Returns:
            One-step predictions (T, m).
        """
        return self.noise_free_outputs(self.predicted_states(start, inputs, outputs)[:-1], inputs)

    def one_step_predictions(self, inputs: Array, outputs: Array) -> Array:
        """Predicts the outputs of each sample of a segment after the first one, from the samples before it.

        The first sample is not predicted: it provides the state from which the filter starts.

        Args:
            inputs: (T, r) inputs.
            outputs: (T, m) measured outputs.

        Returns:
            One-step predictions (T − 1, m).
        """
        start = self.second_state(inputs[0], outputs[0])
        return self.predicted_outputs(start, inputs[1:], outputs[1:])

    def state_after(self, inputs: Array, outputs: Array) -> Array:
        """Returns the state (n,) of the sample after a segment of ``inputs`` (T, r) and ``outputs`` (T, m)."""
        start = self.second_state(inputs[0], outputs[0])
        return self.predicted_states(start, inputs[1:], outputs[1:])[-1]

    def simulate(self, start: Array, inputs: Array) -> Array:
        """Simulates the outputs of the model for given inputs and a given first state, without noise.

        Outputs of an unstable model may overflow to infinity or NaN.

        Args:
            start: (n,) state of the first sample.
            inputs: (H, r) inputs.

        Returns:
            Outputs (H, m).
        """
        return self.simulate_from(np.zeros(1, int), len(inputs), start[None], inputs)[0]

    @may_overflow
    def simulate_from(
        self,
        start_rows: Indices,
        horizon: int,
        states: Array,
        inputs: Array,
    ) -> Array:
        """Runs several simulations without noise, which begin at different samples of the same inputs.

        Args:
            start_rows: (S,) row of ``inputs`` at which each simulation starts.
            horizon: number of samples H of each simulation.
            states: (S, n) state of each first sample.
            inputs: (T, r) inputs. Simulations that go on beyond the last row keep the inputs of that row.

        Returns:
            Outputs (S, H, m).
        """
        # The contributions of the inputs to outputs and states are the same for all simulations, and computed once.
        feedthrough = self.feedthrough(inputs)
        forcing = self._input_forcing(inputs)
        outputs = np.empty((len(start_rows), horizon, len(self.C)))
        # Each step is computed for all simulations at once.
        for step in range(horizon):
            current_samples = np.minimum(start_rows + step, len(inputs) - 1)
            outputs[:, step] = states @ self.C.T + feedthrough[current_samples]
            states = states @ self.A.T + forcing[current_samples]
        return outputs

    @may_overflow
    def rolling_forecast(
        self,
        steps: int,
        start: Array,
        inputs: Array,
        outputs: Array,
    ) -> Array:
        """Forecasts a segment with known inputs, starting again at every ``steps``-th sample.

        Each forecast starts from the state that the filter predicts from all samples before it, and continues without
        measurements until the next one starts.

        Args:
            steps: number of samples from one start to the next.
            start: (n,) state of the first sample.
            inputs: (T, r) inputs.
            outputs: (T, m) measured outputs.

        Returns:
            Forecasts (T, m).
        """
        start_rows = np.arange(0, len(inputs), steps)
        horizon = min(steps, len(inputs))
        # The filter runs over all samples once, and each forecast starts from its state at that sample.
        states = self.predicted_states(start, inputs, outputs)[start_rows]
        forecasts = self.simulate_from(start_rows, horizon, states, inputs)
        # Forecasts (S, H, m) are joined to (S · H, m). The last one may reach beyond the segment, and is cut off there.
        return forecasts.reshape(-1, len(self.C))[: len(inputs)]

    def noise_free_outputs(self, states: Array, inputs: Array) -> Array:
        """Returns the outputs (T, m) of states (T, n) and inputs (T, r), without noise."""
        return states @ self.C.T + self.feedthrough(inputs)

    def feedthrough(self, inputs: Array) -> Array:
        """Returns what inputs (T, r) and trim add to the outputs (T, m) of the same sample, without the state."""
        return (inputs - self.input_trim) @ self.D.T + self.output_trim

    def _input_forcing(self, inputs: Array) -> Array:
        """Returns what the inputs (T, r) and the offset add to the next state, (T, n)."""
        return (inputs - self.input_trim) @ self.B.T + self.offset


def filter_gain(
    A: Array,
    C: Array,
    dt: float,
    measurement_variances: Array,
    process_covariance: Array,
    smoothness: float,
) -> Array:
    """Computes the gain of the steady-state Kalman filter of a continuous model whose noises are smooth.

    A Kalman filter assumes white noises. So each smooth noise is replaced by the white noise with the same power
    density at low frequencies, to which the states respond: the variance of the smooth noise times the integral of its
    autocorrelation exp(−τ²/4s²).

    Args:
        A: (n, n) system matrix, 1/s.
        C: (m, n) output matrix.
        dt: sampling step, s.
        measurement_variances: (m,) variances of the measurement noise z.
        process_covariance: (n, n) covariance of the process noise w.
        smoothness: width s of the Gaussian kernel of both noises, s.

    Returns:
        The gain (n, m) with which an innovation corrects the state of the same sample.

    Raises:
        numpy.linalg.LinAlgError: there is no steady-state filter, for example if no output shows an unstable state.
    """
    Phi = discretize(A, np.empty((len(A), 0)), dt).Phi
    # ∫ exp(−τ²/4s²) dτ: power density at low frequency of a smooth noise of variance 1, s.
    power_density = 2 * smoothness * np.sqrt(np.pi)
    # White noise of that power density, sampled every dt, has the variance of the smooth one times power_density / dt.
    # If this ratio is less than 1, the correlation is shorter than a step: the samples are independent already, and
    # their variance is not changed.
    R = np.diag(measurement_variances) * max(power_density / dt, 1.0)
    # Over one step the white process noise adds its power density times dt to the covariance of the states.
    P = steady_state_gain(Phi, C, process_covariance * power_density * dt, R).covariance
    # P Cᵀ (C P Cᵀ + R)⁻¹, computed by solving a linear system instead of inverting the matrix.
    return np.ascontiguousarray(np.linalg.solve(C @ P @ C.T + R, C @ P).T)
