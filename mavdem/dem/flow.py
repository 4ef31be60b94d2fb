"""The D step with a finite learning rate: X follows the gradient of F while its generalized motion carries it along.

    Ẋ = D X + k ∂F/∂X,   ∂F/∂X = G [ỹ; η̃] − P X                                                  Eq. ``GA_basic``

A linear filter of the data, the same at every sample. Its exact limit for k → ∞ is ``steps.d_step``. With a small k,
D may carry X away faster than the gradient pulls it back: the filter is then unstable, and is not run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from mavdem.dem.coordinates import derivative_operator
from mavdem.dem.generative import GenerativeModel, Moments
from mavdem.dem.model import discretize
from mavdem.dem.positive import solve
from mavdem.dem.recursion import recursion

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StateFlow:
    """The flow of X for one F.

    Attributes:
        motion: J = D − k P, (dim X, dim X) 1/s.
        drive: k G, (dim X, dim [ỹ; η̃]).
        start: X at the first sample of a segment, from its [ỹ; η̃]: the maximum of F, (dim X, dim [ỹ; η̃]).
    """

    motion: Array
    drive: Array
    start: Array

    @classmethod
    def of(cls, model: GenerativeModel, of_data: Array, precision: Array, rate: float) -> StateFlow:
        """The flow at k^X = ``rate`` up F, whose slope is ``of_data`` and ``precision`` of ``steps.state_slope``."""
        D = block_diag(derivative_operator(model.p, model.n), derivative_operator(model.d, model.r))
        return cls(D - rate * precision, rate * of_data, solve(precision, of_data))

    @property
    def spectral_abscissa(self) -> float:
        """The largest real part among the eigenvalues of J, 1/s: the flow is stable while it is negative."""
        return float(np.linalg.eigvals(self.motion).real.max())

    def states(self, data: Array, dt: float) -> Array:
        """X at every sample, (T, dim X), for generalized data [ỹ; η̃] (T, ·) that run linearly between samples."""
        transition = discretize(self.motion, self.drive, dt)
        pushes = data[:-1] @ transition.input_now.T + data[1:] @ transition.input_next.T
        first = self.start @ data[0]
        return np.vstack([first, recursion(transition.state, pushes, first)])

    def moments(self, model: GenerativeModel, segments: Sequence[Array], dt: float) -> Moments:
        """Second moments of data and X over segments of generalized data, each of which starts anew.

        Raises:
            numpy.linalg.LinAlgError: the flow is unstable, or so stiff that it overflows.
        """
        if not self.spectral_abscissa < 0:
            raise np.linalg.LinAlgError("the flow of X is unstable")
        joint = [np.hstack([data, self.states(data, dt)]) for data in segments if len(data)]
        gram = sum((both.T @ both for both in joint), np.zeros(()))
        if not np.isfinite(gram).all():
            raise np.linalg.LinAlgError("the flow of X overflows")
        return Moments(model, gram, np.eye(len(gram)))
