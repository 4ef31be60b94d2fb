"""Gaussian: a prior with any mean and precision, as plain values that settings can hold and JSON can carry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavdem.dem.positive import require_positive_definite
from mavdem.dem.real import real_numbers

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Gaussian:
    """N(mean, precision⁻¹). A known entry is one of high precision; a structure is a matrix of them.

    Attributes:
        mean: (k,).
        precision: (k, k), symmetric positive definite; a number or (k,) stands for a diagonal.

    Raises:
        ValueError: names what is not finite, of the wrong shape or not positive definite.
    """

    mean: tuple[float, ...]
    precision: tuple[tuple[float, ...], ...]

    def __init__(self, mean: ArrayLike, precision: ArrayLike) -> None:
        means, precisions = real_numbers(mean, "mean"), real_numbers(precision, "precision")
        if means.ndim != 1 or not len(means) or not np.isfinite(means).all():
            raise ValueError(f"mean must be finite numbers of shape (k,), not of shape {means.shape}")
        if precisions.ndim == 0:
            precisions = np.full(len(means), precisions)
        if precisions.ndim == 1 and len(precisions) == len(means):
            precisions = np.diag(precisions)
        require_positive_definite(precisions, "precision", len(means))
        object.__setattr__(self, "mean", tuple(means.tolist()))
        object.__setattr__(self, "precision", tuple(map(tuple, precisions.tolist())))

    @property
    def arrays(self) -> tuple[Array, Array]:
        """Mean (k,) and precision (k, k)."""
        return np.array(self.mean), np.array(self.precision)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Gaussian:
        """From ``values`` = {"mean": …, "precision": …}; ``ValueError`` for anything else."""
        if not isinstance(values, Mapping) or set(values) != {"mean", "precision"}:
            raise ValueError(f'a Gaussian must be {{"mean": [...], "precision": ...}}, not {values!r}')
        return cls(values["mean"], values["precision"])
