"""What the data did not determine: directions among the parameters of which they tell less than the prior did."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Direction(NamedTuple):
    """A combination of parameters that stays as the prior had it.

    Attributes:
        weights: (k,) of the parameters in it, those of θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)], of unit length in prior
            standard deviations.
        share: information of the data over that of the prior, 0 to 1.
    """

    weights: Array
    share: float


def undetermined(information: Array, precision: Array, free: NDArray[np.bool_]) -> tuple[Direction, ...]:
    """The directions among ``free`` parameters of which the data tell less than the prior, the least determined first.

    Args:
        information: (k, k) of the data on the parameters.
        precision: (k, k) of their prior.
        free: (k,) which of them the prior leaves to the data.
    """
    places = np.flatnonzero(free)
    if not len(places):
        return ()
    of_free = np.ix_(places, places)
    values, vectors = np.linalg.eigh(precision[of_free])
    to_units = (vectors / np.sqrt(values)) @ vectors.T
    shares, modes = np.linalg.eigh(to_units @ information[of_free] @ to_units)
    directions = []
    for share, mode in zip(shares, modes.T, strict=True):
        if share < 1.0:
            weights = np.zeros(len(free))
            weights[places] = mode
            directions.append(Direction(weights, max(float(share), 0.0)))
    return tuple(directions)


def without(information: Array, precision: Array, kept: NDArray[np.intp]) -> Array:
    """Information on the parameters at places ``kept``, when the others, with their prior, are whatever suits them."""
    others = np.setdiff1d(np.arange(len(information)), kept)
    of_kept = information[np.ix_(kept, kept)]
    if not len(others):
        return of_kept
    cross = information[np.ix_(kept, others)]
    of_others = information[np.ix_(others, others)] + precision[np.ix_(others, others)]
    return np.asarray(of_kept - cross @ np.linalg.pinv(of_others, hermitian=True) @ cross.T)
