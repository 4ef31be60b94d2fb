"""Errors of a stream's predictions at each horizon, over all of its samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.dem.online.tracker import Estimate

SAME_TIME = 1e-6  # s between a prediction and the sample it is of, at most


class HorizonErrors(NamedTuple):
    """Errors of the predictions ``seconds`` ahead, inputs unknown; (m,) each, over ``samples``."""

    seconds: float
    samples: int
    mse: Array  # mean squared error
    held: Array  # that of the last sample held
    inside: Array  # share inside the 90 % band


class TimedSample(NamedTuple):
    """A sample (m,) at a ``time``, s, and its estimate, if there is one."""

    time: float
    outputs: Array
    estimate: Estimate | None


class PredictionErrors:
    """Compares predictions with the samples whose time has come, many samples at once."""

    def __init__(self) -> None:
        self._before: list[TimedSample] = []  # whose predictions may be of the next samples
        self._sums: dict[float, tuple[int, Array]] = {}

    def end_segment(self) -> None:
        """A gap follows: nothing is compared across it."""
        self._before = []

    def add(self, samples: Sequence[TimedSample], seconds: float) -> Array:
        """Takes the next samples of a segment; returns (N, 2) what about ``seconds`` before was predicted of them.

        This is the first output and the half width of its band; NaN where nothing was predicted.
        """
        known, every = len(self._before), [*self._before, *samples]
        time, measured = np.array([one.time for one in every]), np.array([one.outputs for one in every])
        shown, from_, made = np.full((len(every), 2), np.nan), [], []
        for number, one in enumerate(every):
            if one.estimate is not None:
                from_.append(number)
                made.append(one.estimate)
        if not made:
            return shown[known:]
        at = np.array([one.ahead_times for one in made])
        ahead, band = np.array([one.ahead for one in made]), np.array([one.ahead_band for one in made])
        horizons = np.round(at[0] - made[0].time, 6)
        for h, horizon in enumerate(horizons.tolist()):
            row = np.searchsorted(time, at[:, h] - SAME_TIME)
            hit = (row >= known) & (np.abs(time[np.minimum(row, len(time) - 1)] - at[:, h]) < SAME_TIME)
            hit &= np.isfinite(ahead[:, h]).all(axis=1) & np.isfinite(band[:, h]).all(axis=1)
            row, last, expected, half = row[hit], measured[from_][hit], ahead[hit, h], band[hit, h]
            error = measured[row] - expected
            sums = np.stack([error**2, (measured[row] - last) ** 2, np.abs(error) <= half]).sum(axis=1)
            number, before = self._sums.get(horizon, (0, 0.0))
            self._sums[horizon] = number + len(row), before + sums
            if h == np.abs(horizons - seconds).argmin():
                shown[row, 0], shown[row, 1] = expected[:, 0], half[:, 0]
        self._before = [one for one in every if one.time + horizons[-1] > time[-1]]
        return shown[known:]

    def result(self) -> list[HorizonErrors]:
        """Returns those of each horizon, the shortest first."""
        found = [(seconds, *each) for seconds, each in sorted(self._sums.items()) if each[0]]
        return [HorizonErrors(seconds, number, *(sums / number)) for seconds, number, sums in found]
