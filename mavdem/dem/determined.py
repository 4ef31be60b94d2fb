"""What the data did not determine: directions among the parameters of which they tell less than the prior did."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.positive import SYMMETRY
from mavdem.dem.priors import Prior

Array = NDArray[np.float64]

AS_MUCH = 1.0
"""Information of the data over that of the prior, below which a direction is the prior's."""


class Direction(NamedTuple):
    """A combination of parameters that stays as the prior had it.

    Attributes:
        weights: (k,) of the parameters in it, of unit length in prior standard deviations.
        share: information of the data over that of the prior, 0 to 1.
    """

    weights: Array
    share: float


def undetermined(information: Array, prior: Prior, free: NDArray[np.bool_]) -> tuple[Direction, ...]:
    """The directions, the least determined first.

    Args:
        information: (k, k) of the data on θ.
        prior: of θ.
        free: (k,) which parameters the prior leaves to the data.
    """
    places = np.flatnonzero(free)
    if not len(places):
        return ()
    values, vectors = np.linalg.eigh(prior.theta_precision[np.ix_(places, places)])
    to_units = (vectors / np.sqrt(values)) @ vectors.T
    shares, modes = np.linalg.eigh(to_units @ information[np.ix_(places, places)] @ to_units)
    rounding = SYMMETRY * max(np.abs(shares).max(), 1.0)
    directions = []
    for share, mode in zip(shares, modes.T, strict=True):
        if share < AS_MUCH + rounding:
            weights = np.zeros(len(free))
            weights[places] = mode
            directions.append(Direction(weights, float(np.clip(share, 0.0, AS_MUCH))))
    return tuple(directions)
