"""DEM as an observer of states and inputs: its D step for a known model and known noises."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.engine.free_energy import Posterior
from mavdem.dem.engine.generalized_coordinates import embed, temporal_precision
from mavdem.dem.engine.generative import GenerativeModel, Prior
from mavdem.dem.engine.model import pack
from mavdem.dem.engine.moments import GeneralizedMoments, SufficientStatistics
from mavdem.dem.engine.steps import d_step

DEM_SMOOTHNESS = 0.006
"""s, the width of the noises' Gaussian kernel that Bos et al. set for all flights."""

DEM_STATE_ORDER = 6
"""Embedding order p of outputs and states of Bos et al."""

DEM_INPUT_ORDER = 2
"""Embedding order d of the inputs of Bos et al."""

KNOWN_INPUT_PRECISION = exp(32.0)
"""Prior precision of an input that is known: Bos et al. have a standard deviation of e⁻¹⁶ for it."""


class Estimates(NamedTuple):
    """Estimates of a window of T samples; NaN at both ends, where no whole embedding window lies about the sample."""

    states: Array
    """(T, n) states."""

    inputs: Array
    """(T, r) inputs."""


@dataclass(frozen=True, eq=False)
class DemObserver:
    """DEM's D step for a known continuous model ẋ = A x + B v + w, y = C x + z, with known noise precisions.

    The D step maximises the free energy of each sample over the generalized states and inputs, whose closed form is a
    linear map of the generalized data.
    """

    A: Array
    """(n, n) system matrix, 1/s."""

    B: Array
    """(n, r) input matrix."""

    C: Array
    """(m, n) output matrix."""

    output_precision: float
    """Precision of the measurement noise of every output."""

    state_precisions: Array
    """(n,) precisions of the process noise.

    Bos et al. set the inverse variances of the discrete process noise, of one sampling step, although the noise of
    the continuous model has the unit of x per second.
    """

    input_precisions: Array
    """(r,) prior precisions of the inputs about the values that are given for them."""

    dt: float
    """Sampling step, s."""

    p: int = DEM_STATE_ORDER
    """Embedding order of outputs and states."""

    smoothness: float = DEM_SMOOTHNESS
    """Width of the noises' Gaussian kernel, s."""

    @property
    def d(self) -> int:
        """Embedding order of the inputs."""
        return min(self.p, DEM_INPUT_ORDER)

    def model(self) -> GenerativeModel:
        """Returns the generative model. Its priors of θ and λ have no effect, since both are known."""
        n, r = self.B.shape
        m = len(self.C)
        parameter_count = n * n + n * r + m * n
        noise_count = m + n
        return GenerativeModel(
            n=n,
            r=r,
            m=m,
            p=self.p,
            d=self.d,
            q=self.p,
            output_temporal_precision=temporal_precision(self.p, self.smoothness),
            state_temporal_precision=temporal_precision(self.p, self.smoothness),
            # Each noise is a group with a precision of its own: first the m outputs' noises, then the n states'.
            output_groups=np.arange(m),
            state_groups=m + np.arange(n),
            input_precision=np.asarray(
                np.kron(
                    temporal_precision(self.d, self.smoothness), np.diag(self.input_precisions)
                ),
                float,
            ),
            prior=Prior(
                np.zeros(parameter_count),
                np.eye(parameter_count),
                np.zeros(noise_count),
                np.eye(noise_count),
            ),
        )

    def estimate(self, outputs: Array, inputs: Array) -> Estimates:
        """Estimates the states and inputs of each sample from the embedding window about it.

        From the p + 1 outputs of a window, their time derivatives are computed, and likewise from the d + 1 inputs of a
        narrower window. States and inputs are a linear function of these (DEM's D step for known parameters).

        Args:
            outputs: (T, m) measured outputs.
            inputs: (T, r) inputs, or prior means of those that are not known.

        Returns:
            States (T, n) and inputs (T, r); NaN at both ends, where the window is not complete.
        """
        n, r = self.B.shape
        output_center = self.p // 2
        input_center = self.d // 2
        generalized_outputs = embed(outputs, self.p, self.dt, self.p + 1, output_center)
        generalized_inputs = embed(inputs, self.d, self.dt, self.d + 1, input_center)
        # Row i of an embedding belongs to sample i + its center. The rows of the inputs that have no row of the outputs
        # are cut off.
        window_count = len(generalized_outputs)
        first_row = output_center - input_center
        inputs_of_windows = generalized_inputs[first_row : first_row + window_count]
        data = np.hstack([generalized_outputs, inputs_of_windows])
        # Columns are x, ẋ, …, n each, then v, v̇, …, r each. Only x and v are returned.
        hidden = data @ self._state_map(data).T
        first_input = n * (self.p + 1)
        estimated_samples = slice(output_center, output_center + window_count)
        states = np.full((len(outputs), n), np.nan)
        states[estimated_samples] = hidden[:, :n]
        estimated_inputs = np.full((len(outputs), r), np.nan)
        estimated_inputs[estimated_samples] = hidden[:, first_input : first_input + r]
        return Estimates(states, estimated_inputs)

    def _state_map(self, data: Array) -> Array:
        """Returns the matrix of DEM's D step, which maps generalized data to the hidden variables: X = L [ỹ; η̃].

        Args:
            data: (T, dim [ỹ; η̃]) generalized outputs ỹ and inputs η̃ of T samples.

        Returns:
            L (dim X, dim [ỹ; η̃]), where X are the generalized states and inputs.
        """
        model = self.model()
        parameter_count = len(model.prior.theta_mean)
        noise_count = len(model.prior.lambda_mean)
        noise_precisions = np.append(
            np.full(len(self.C), self.output_precision), self.state_precisions
        )
        hidden_size = model.n * (model.p + 1) + model.r * (model.d + 1)
        no_states = np.zeros((hidden_size, data.shape[1]))
        statistics = SufficientStatistics.from_segments(data)
        # θ and λ are known: their covariances are zero. The D step does not use the states of the posterior.
        posterior_at_true_parameters = Posterior(
            GeneralizedMoments.from_state_map(model, statistics, no_states),
            state_covariance=np.zeros((hidden_size, hidden_size)),
            theta=pack(self.A, self.B, self.C),
            theta_covariance=np.zeros((parameter_count, parameter_count)),
            lambda_=np.log(noise_precisions),
            lambda_covariance=np.zeros((noise_count, noise_count)),
        )
        return d_step(posterior_at_true_parameters)


def embedding_derivative(outputs: Array, order: int, dt: float) -> Array:
    """Returns the first derivative of the outputs by the polynomial of DEM's embedding alone, without any model.

    It is a baseline: where DEM's estimate of a rate is better, the model and the noise precisions make the difference.

    Args:
        outputs: (T, m) measured outputs.
        order: embedding order.
        dt: sampling step, s.

    Returns:
        (T, m) derivatives, per second; NaN at both ends.
    """
    center = order // 2
    m = outputs.shape[1]
    embedded_outputs = embed(outputs, order, dt, order + 1, center)
    derivatives = np.full(outputs.shape, np.nan)
    derivatives[center : center + len(embedded_outputs)] = embedded_outputs[:, m : 2 * m]
    return derivatives
