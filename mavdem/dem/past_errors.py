"""Bands about predictions, from how far those before were off: none of them is of data that the model had seen."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEWEST = 20
"""Errors, before they tell anything."""


class RecentErrors:
    """Root mean square of errors (m,), the older the less."""

    def __init__(self, samples: float) -> None:
        """After so many ``samples`` more, an error counts for a third of what it did."""
        self._kept = float(np.exp(-1.0 / samples))
        self._sum: Array | float = 0.0
        self._weight, self._count = 0.0, 0

    def add(self, error: Array) -> None:
        """Takes the next; one that is not finite counts for nothing."""
        if np.isfinite(error).all():
            self._sum = self._kept * self._sum + error * error
            self._weight = self._kept * self._weight + 1.0
            self._count += 1

    @property
    def rms(self) -> Array | float:
        """(m,), or NaN where there were too few."""
        return np.sqrt(self._sum / self._weight) if self._count >= FEWEST else np.nan


class PastErrors:
    """Those of predictions at several horizons."""

    def __init__(self, horizons: tuple[int, ...], samples: float) -> None:
        """Takes the ``horizons``, in steps, increasing, and ``samples`` as ``RecentErrors`` does."""
        self._horizons = horizons
        self._errors = [RecentErrors(samples) for _ in horizons]
        self._waiting: deque[Array] = deque(maxlen=horizons[-1])

    def add(self, sample: Array, ahead: Array) -> None:
        """Takes a sample (m,), to hold those before against, and the predictions (H, m) that begin with it."""
        for row, (horizon, errors) in enumerate(zip(self._horizons, self._errors, strict=True)):
            if horizon <= len(self._waiting):
                errors.add(sample - self._waiting[-horizon][row])
        self._waiting.append(ahead)

    def part(self) -> None:
        """Says that a gap follows: predictions that wait for their sample are dropped."""
        self._waiting.clear()

    def rms(self, outputs: int) -> Array:
        """(H, m) for m ``outputs``."""
        return np.array([np.broadcast_to(errors.rms, outputs) for errors in self._errors])
