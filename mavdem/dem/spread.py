"""Spread: where the samples of each channel lie, and which channels move."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROUNDING = 1e-9
"""A channel that moves by less than this, relative to its size, is constant."""

SMALLEST = 1e-50
"""So is one that moves by less than this in any unit: squares and derivatives would leave the range of numbers."""


class Spread(NamedTuple):
    """Where the samples of each column lie; (k,) each."""

    mean: Array
    variance: Array
    lowest: Array
    highest: Array

    @classmethod
    def of(cls, samples: Array) -> Spread:
        """That of samples (T, k)."""
        return cls(samples.mean(axis=0), samples.var(axis=0), samples.min(axis=0), samples.max(axis=0))

    @property
    def moving(self) -> NDArray[np.bool_]:
        """(k,) which columns move by more than the rounding of their numbers."""
        size = np.maximum(np.abs(self.lowest), np.abs(self.highest))
        return np.asarray(self.highest - self.lowest > np.maximum(ROUNDING * size, SMALLEST))
