"""A linear system under smooth noise, ẋ = A x + B u + w, y = C x + z, and a prior of its parameters."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.engine.model import pack, unpack

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class System:
    """A linear system in noise of known colour and size."""

    A: Array  # (n, n)
    B: Array  # (n, r)
    C: Array  # (m, n)
    state_noise: Array  # (n,) standard deviations of w
    output_noise: Array  # (m,) standard deviations of z
    smoothness: float  # kernel width s, seconds
    dt: float  # sampling step, seconds
    free: NDArray[np.intp]  # (k,) places in θ of the parameters to be estimated

    @property
    def theta(self):
        """All parameters, as :func:`mavdem.dem.engine.model.pack` packs them."""
        return pack(self.A, self.B, self.C)

    def at(self, parameters):
        """The same with other values (k,) of the free parameters."""
        theta = self.theta
        theta[self.free] = parameters
        n, r = self.B.shape
        A, B, C = unpack(theta, n, r, len(self.C))
        return replace(self, A=A, B=B, C=C)


class ParameterPrior(NamedTuple):
    """Gaussian, of the free parameters."""

    mean: Array  # (k,)
    precision: Array  # (k, k)
