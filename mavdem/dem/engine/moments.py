"""Second moments of generalized data (signals with time derivatives), and of states and errors linear in them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.engine.generative import GenerativeModel
from mavdem.dem.engine.model_structure import RegressorMoments


class SufficientStatistics(NamedTuple):
    """Sufficient statistics of the generalized data: their number and their second moments."""

    sample_count: float
    """Number of samples; not an integer where autocorrelated samples count as an effective sample size."""

    gram: Array
    """Σ_t [ỹ; η̃][ỹ; η̃]ᵀ, square, as wide as the generalized data."""

    @classmethod
    def from_segments(cls, *segments: Array) -> SufficientStatistics:
        """Counts the samples of all segments, and sums the outer products of their generalized data.

        Args:
            *segments: (T, (p + 1)m + (d + 1)r) generalized data [ỹ; η̃] of each segment, one row for each sample.

        Returns:
            The number of samples, and the Gram matrix (k, k) of the k generalized data.
        """
        gram = np.asarray(sum(data.T @ data for data in segments))
        sample_count = sum(map(len, segments))
        return cls(sample_count, gram)


@dataclass(frozen=True, eq=False)
class GeneralizedMoments:
    """Second moments of the data [ỹ; η̃] and of the state estimates X = L [ỹ; η̃], summed over the samples."""

    model: GenerativeModel
    """The generative model."""

    samples: SufficientStatistics
    """Statistics of the generalized data."""

    joint_map: Array
    """[I; L], which maps the data [ỹ; η̃] of a sample to the joint vector [ỹ; η̃; X]."""

    @classmethod
    def from_state_map(
        cls, model: GenerativeModel, samples: SufficientStatistics, state_map: Array
    ) -> GeneralizedMoments:
        """Returns the moments for states that are estimated linearly from the data of the same sample.

        Since the estimates X are a linear map of the data, their moments follow from the data's, without another
        pass over the samples.

        Args:
            model: the linear model with its noises and priors, whose free energy is maximised.
            samples: second moments of the data [ỹ; η̃]: generalized outputs ỹ and generalized inputs η̃.
            state_map: (dim X, dim [ỹ; η̃]) the map L from the data to the estimated generalized states X = L [ỹ; η̃].

        Returns:
            The moments of [ỹ; η̃; X].
        """
        data_dimension = state_map.shape[1]
        identity_map = np.eye(data_dimension)
        return cls(model, samples, joint_map=np.vstack([identity_map, state_map]))

    @cached_property
    def joint_moments(self) -> Array:
        """Σ_t [ỹ; η̃; X][ỹ; η̃; X]ᵀ."""
        return self.joint_map @ self.samples.gram @ self.joint_map.T

    @cached_property
    def regressor_moments(self) -> RegressorMoments:
        """Second moments of the regressors of [A B] and C, summed over the samples."""
        return self.model.regressor_moments(self.joint_moments)

    def cross_moments(self, theta: Array) -> Array:
        """Returns the second moments Σ_t ε̃ [ỹ; η̃; X]ᵀ of errors and joint vector, for parameters θ (k,)."""
        error_map = self.model.error_operator(theta) @ self.joint_map
        return error_map @ self.samples.gram @ self.joint_map.T

    def error_moments(self, theta: Array) -> Array:
        """Returns the second moments Σ_t ε̃ε̃ᵀ of the prediction errors, for parameters θ (k,).

        The errors are linear in the data, ε̃ = M [ỹ; η̃], so that their second moments are M (Σ_t [ỹ; η̃][ỹ; η̃]ᵀ) Mᵀ. They
        could also be computed from the moments of data and states. But errors are small differences of large signals,
        and would be lost in the rounding of those moments.

        Args:
            theta: parameters θ (k,).

        Returns:
            The second moments (dim ε̃, dim ε̃).
        """
        error_map = self.model.error_operator(theta) @ self.joint_map
        return error_map @ self.samples.gram @ error_map.T

    def squared_errors_by_noise(self, theta: Array) -> Array:
        """Returns the squared errors Σ_t ε̃ᵀ (S⊗Ω_g) ε̃ of each noise, (g,) in the order of λ, at parameters θ (k,)."""
        return self.model.squared_errors_by_noise(self.error_moments(theta))
