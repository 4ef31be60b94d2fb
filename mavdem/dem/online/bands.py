"""ErrorBands: half widths of 90 % bands, from the latest errors of the predictions themselves."""

from __future__ import annotations

from collections import deque

import numpy as np

from mavdem.dem.engine.linalg import Array

SECONDS = 6.0
"""Of errors: fewer give no steady quantile, and a change of the vehicle widens bands for this long."""
MIN_ERRORS = 20  # before a half width is reported
MIN_KEPT = 100  # errors, at however long steps
LEVEL = 0.9
MAX_MEDIANS = 12.0
"""Of a half width, in median errors. Of normal errors it is 2.4, where manoeuvres alternate with hover up to 12; a
failure gives hundreds, by errors that say nothing of the model that follows it."""


class ErrorBands:
    """Of predictions at several horizons, of which none had seen the sample, and of each sample by those before it.

    An error counts as long as any other, whatever its size: bands recover as soon as predictions have.
    """

    def __init__(self, horizons: tuple[int, ...], outputs: int, dt: float) -> None:
        """Takes the ``horizons`` in steps, increasing, the number m of ``outputs`` and the sampling step ``dt``, s."""
        self._horizons = horizons
        kept = max(round(SECONDS / dt), MIN_KEPT)
        self._errors = np.full((1 + len(horizons), outputs, kept), np.nan)
        self._next = 0
        self._waiting: deque[Array] = deque(maxlen=horizons[-1])
        self.half_widths = np.full(self._errors.shape[:2], np.nan)
        """(1 + H, m): of the sample itself, and at each horizon; NaN where there are too few errors."""

    def add(self, sample: Array, expected: Array, ahead: Array) -> None:
        """Compares a sample (m,) with predictions of it; takes those (H, m) that begin with it.

        ``expected`` (m,) is the prediction of the sample by those before it. Errors that are not finite are ignored.
        """
        latest = self._errors[:, :, self._next]
        latest[:] = np.nan
        latest[0] = sample - expected
        for row, horizon in enumerate(self._horizons):
            if horizon <= len(self._waiting):
                latest[row + 1] = sample - self._waiting[-horizon][row]
        self._next = (self._next + 1) % self._errors.shape[2]
        self._waiting.append(ahead)

    def end_segment(self) -> None:
        """A gap follows: predictions whose sample has not come are dropped."""
        self._waiting.clear()

    def update(self) -> None:
        """Computes the half widths again; done once a block, since it takes all errors."""
        sizes = np.sort(np.where(np.isfinite(self._errors), np.abs(self._errors), np.nan))  # NaN last
        number = np.isfinite(sizes).sum(axis=-1, keepdims=True)
        # The next error is below the k-th of n with probability k/(n + 1).
        places = np.clip(np.ceil(LEVEL * (number + 1)).astype(np.intp), 1, np.maximum(number, 1)) - 1
        level, median = (np.take_along_axis(sizes, place, axis=-1) for place in (places, number // 2))
        half = np.minimum(level, MAX_MEDIANS * median)
        self.half_widths = np.where(number >= MIN_ERRORS, half, np.nan)[:, :, 0]
