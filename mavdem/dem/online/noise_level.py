"""NoiseLevel: how much a block of samples counts, by the one-step errors in it and shortly before."""

from __future__ import annotations

import numpy as np

from mavdem.dem.engine.linalg import Array

SECONDS = 1.0  # over which the squared errors are averaged
POWER = 0.5
"""Weight by squared error: 1 is generalised least squares, which trusts few quiet seconds too much, 0 ordinary. Between
them, minutes of hover are learnt beside a take-off of a hundred times the motion."""
SMALLEST = 1e-300  # a squared error of zero has a logarithm too


class NoiseLevel:
    """Averages squared errors (m,) of blocks; large errors count at once and are forgotten slowly."""

    def __init__(self, power: float = POWER) -> None:
        self._power = power
        self._squared: Array | None = None

    def weight(self, squared: Array, seconds: float) -> float:
        """Of a block of so many ``seconds`` with these mean squared one-step errors (m,), in any units that stay."""
        before = squared if self._squared is None else self._squared
        self._squared = before + (1 - np.exp(-seconds / SECONDS)) * (squared - before)
        level = np.maximum(self._squared, squared) + SMALLEST
        return float(np.exp(-self._power * np.log(level).mean()))
