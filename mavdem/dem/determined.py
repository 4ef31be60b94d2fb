"""What the data did not determine: directions among the parameters of which they tell less than the prior did."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.model import unpack

Array = NDArray[np.float64]


SHOWN = 4
"""Entries of a direction, the heaviest, that its ``repr`` shows."""


class Direction(NamedTuple):
    """A combination of parameters that stays as the prior had it.

    Attributes:
        weights: (k,) of the parameters in it, those of θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)], of unit length in prior
            standard deviations.
        share: information of the data over that of the prior, 0 to 1.
        sizes: (n, r, m) of A (n, n), B (n, r) and C (m, n).
    """

    weights: Array
    share: float
    sizes: tuple[int, int, int]

    def __repr__(self) -> str:
        """The heaviest entries, as ``learned.model`` is indexed."""
        places = unpack(np.arange(len(self.weights)), *self.sizes)
        heaviest = [i for i in np.argsort(-np.abs(self.weights), kind="stable")[:SHOWN] if self.weights[i]]
        entries = (
            f"{self.weights[i]:+.2g} {name}[{row},{column}]"
            for i in heaviest
            for name, place in zip("ABC", places, strict=True)
            for row, column in np.argwhere(place == i)
        )
        rest = " …" if np.count_nonzero(self.weights) > len(heaviest) else ""
        return f"<Direction: {' '.join(entries)}{rest}, data tell {self.share:.2g} of what the prior does>"


def undetermined(
    information: Array, precision: Array, free: NDArray[np.bool_], sizes: tuple[int, int, int]
) -> tuple[Direction, ...]:
    """The directions among ``free`` parameters of which the data tell less than the prior, the least determined first.

    Args:
        information: (k, k) of the data on the parameters.
        precision: (k, k) of their prior.
        free: (k,) which of them the prior leaves to the data.
        sizes: (n, r, m), of which they are the A, B and C.
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
            directions.append(Direction(weights, max(float(share), 0.0), sizes))
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
