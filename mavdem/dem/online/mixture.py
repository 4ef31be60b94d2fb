"""Mixture: several predictions of the same sample as one, at each horizon weighted by their own past errors."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.dem.online.noise_level import NoiseLevel

MEMORY_SECONDS = 20.0  # time constant by which errors are forgotten
SHARE_OF_PAST = 0.3
"""Of all that came before, if shorter: predictions learnt from few samples soon err less than they first did."""
FEWEST_SECONDS = 3.0  # the shortest time constant
LATEST_SECONDS = 2.0  # likewise, of errors that count more, so that a failure changes the weights at once
LATEST_SHARE = 0.3  # by which they do
PRIOR_SECONDS = 1.0
PRIOR_HORIZONS = 2.0
"""Of errors that the first prediction is better by: neighbouring errors at a long horizon are nearly the same."""
SMALLEST = 1e-300


class Mixture:
    """Weights of E predictions at H horizons, not negative and of sum 1, by squared error of m outputs each.

    Minimises wᵀ Q w, the squared error that the weights would have had; Q are the moments of the predictions' errors,
    forgotten exponentially. It is stacking (L. Breiman, "Stacked regressions", Machine Learning 24, 1996), on a stream.
    """

    def __init__(self, dt: float, horizons: tuple[int, ...], outputs: int, predictions: int) -> None:
        """Begins with the first prediction alone, of samples every ``dt`` s."""
        self._dt, self._steps = dt, np.array(horizons, np.float64)[:, None]
        self._shape = len(horizons), outputs, predictions
        self.forget()

    def forget(self) -> None:
        """Begins again, with the first prediction alone."""
        self._moments = np.zeros((2, *self._shape, self._shape[-1]))  # by both time constants
        self._number, self._seconds = np.zeros((2, *self._shape[:2])), 0.0
        self._level = NoiseLevel()
        self.weights = np.zeros(self._shape)
        """(H, m, E)."""
        self.weights[..., 0] = 1.0

    def of(self, predictions: Array) -> Array:
        """(H, m): the mixture of predictions (H, m, E)."""
        return np.asarray((self.weights * predictions).sum(axis=-1))

    def add(self, errors: Array, one_step: Array) -> None:
        """Takes a block's errors (T, H, m, E), NaN where there was no prediction, and those of one step (T, m)."""
        known = np.asarray(np.isfinite(errors).all(axis=-1, keepdims=True))
        errors, number = np.where(known, errors, 0.0), known.sum(axis=(0, -1))
        one_step = one_step[np.isfinite(one_step).all(axis=-1)]
        if not number.any() or not len(one_step):
            return
        seconds = len(errors) * self._dt
        weight = self._level.weight((one_step**2).mean(axis=0), seconds)
        self._seconds += seconds
        memory = min(MEMORY_SECONDS, max(FEWEST_SECONDS, SHARE_OF_PAST * self._seconds))
        left = np.exp(-seconds / np.array([memory, LATEST_SECONDS]))
        by_cell = errors.transpose(1, 2, 3, 0)
        self._moments = left[:, None, None, None, None] * self._moments + weight * (by_cell @ by_cell.swapaxes(-1, -2))
        self._number = left[:, None, None] * self._number + number
        self._minimise()

    def _minimise(self) -> None:
        number, latest = np.maximum(self._number, 1.0)
        moments = self._moments[0] + LATEST_SHARE * (number / latest)[..., None, None] * self._moments[1]
        trust = (PRIOR_SECONDS / self._dt + PRIOR_HORIZONS * self._steps) / number
        first = moments[..., 0, 0].copy()
        for other in range(1, self._shape[-1]):
            apart = moments[..., other, other] - 2 * moments[..., 0, other] + first
            moments[..., other, other] += trust * apart
        weights = self.weights
        # From the last weights on, once over all pairs: the next block is about to come.
        for one, other in combinations(range(self._shape[-1]), 2):
            # The exact minimum along what the one gives to the other.
            slope = ((moments[..., one, :] - moments[..., other, :]) * weights).sum(axis=-1)
            curvature = moments[..., one, one] + moments[..., other, other] - 2 * moments[..., one, other]
            given = np.clip(slope / np.maximum(curvature, SMALLEST), -weights[..., other], weights[..., one])
            weights[..., one] -= given
            weights[..., other] += given
