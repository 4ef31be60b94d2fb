"""The trace of a fit: F̄ and the estimates by iteration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mavdem.dem.engine.linalg import Array


@dataclass(frozen=True, eq=False)
class FreeEnergy:
    """F̄ᵒ by iteration, row 0 being the priors' means; behaves as its array of totals, (I + 1,).

    Attributes:
        terms: the named terms of Eq. ``F_action_opt``, (I + 1,) each, which sum to the total.
    """

    terms: Mapping[str, Array]

    @cached_property
    def total(self) -> Array:
        """F̄ᵒ by iteration, (I + 1,)."""
        return np.asarray(np.sum(list(self.terms.values()), axis=0))

    @property
    def gained(self) -> float:
        """Nats gained from the priors' means to the end."""
        return float(self.total[-1] - self.total[0])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.total, dtype=dtype)

    def __len__(self) -> int:
        return len(self.total)

    def __getitem__(self, index: Any) -> Any:
        return self.total[index]

    def __iter__(self) -> Iterator[float]:
        return iter(self.total.tolist())


@dataclass(frozen=True, eq=False)
class Learning:
    """The estimates by iteration: rows are those of :class:`FreeEnergy`.

    Attributes:
        theta, theta_sd: (I + 1, k) in physical units, θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)] without the trim offset.
        lambda_, lambda_sd: (I + 1, g) log noise precisions in the engine's units: measurement noise, process noise.
    """

    theta: Array
    theta_sd: Array
    lambda_: Array
    lambda_sd: Array
