"""How unusual a number is against its own recent past."""

from __future__ import annotations

from collections import deque

import numpy as np

LOW = 0.05
"""Probability of the low quantile by whose distance from the median the past's spread is told."""
FEWEST = 100
"""Numbers of the past that its spread can be told from."""


class Unusual:
    """Keeps a past of so many numbers, and what is usual in it.

    By quantiles: F(t) has a long tail to below, of which a standard deviation would make too much, and one gust would
    make everything after it look usual.
    """

    def __init__(self, most: int) -> None:
        """Begins without a past; it will hold so many numbers at ``most``."""
        self._past: deque[float] = deque(maxlen=most)
        self._median, self._spread = np.nan, np.nan

    def add(self, value: float) -> float:
        """Takes the next number; answers its distance below the median, in units of the low quantile's."""
        self._past.append(value)
        return (self._median - value) / self._spread

    def settle(self) -> None:
        """Finds out anew what is usual; done now and then, since it looks at the whole past."""
        if len(self._past) >= FEWEST:
            low, self._median = np.quantile(self._past, [LOW, 0.5])
            self._spread = max(self._median - low, np.finfo(float).tiny)
