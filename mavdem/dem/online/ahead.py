"""Predictions of a stream with its future inputs unknown: one vector autoregression that forgets, or the last sample.

Nothing is known of future inputs: they follow from the motion, since the autopilot answers it. The autoregression of
outputs and inputs is fitted again every half second to sums that are forgotten exponentially. It is mixed with the last
sample, which is held before the first fit, and with the mean so far, by their latest errors. No prediction is farther
from the last sample than the vehicle lately went in as many samples.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.linalg import Array, one_thread_if_free
from mavdem.dem.forecast.forecasts import mixture_weights
from mavdem.dem.forecast.var import LagStatistics, Var, initial_lags
from mavdem.dem.online.memory import Memory, MemoryBlock

LAG_SECONDS = 0.15  # of samples that a prediction follows from
FEWEST_LAGS, MOST_LAGS = 4, 16
MOST_REGRESSORS = 100  # a fit of so many takes a millisecond
MEMORY_SECONDS = 30.0  # time constant of forgetting
RIDGE = 0.002  # of the autoregression's prior, for its channels in units of what is remembered
FIRST_SECONDS, REFIT_SECONDS = 1.0, 0.5  # of samples before the first fit, and from one fit to the next
SMALLEST_SCALE = 1e-6  # of a channel that became still, in units of its first second
LARGEST_SECONDS = 20.0  # of samples whose largest change over a horizon bounds the next
ERROR_SECONDS = 10.0  # time constant of the squared errors that are compared


class _Maps(NamedTuple):
    """Predictions as linear maps of the latest samples, in units of their own."""

    center: Array  # (k,)
    scale: Array  # (k,)
    lags: Array  # (H, m, lags k), the latest lag first
    constant: Array  # (H, m)


class PredictionsAhead:
    """Predicts every sample at each horizon; learns from each block of samples."""

    def __init__(self, dt: float, block: int, horizons: tuple[int, ...], inputs: int, outputs: int) -> None:
        """Begins without a sample; ``horizons`` are steps of ``dt``, s, and a ``block`` is so many samples."""
        most = max(FEWEST_LAGS, min(MOST_LAGS, MOST_REGRESSORS // (inputs + outputs)))
        self.lags = int(np.clip(round(LAG_SECONDS / dt), FEWEST_LAGS, most))
        self._dt, self._horizons, self._outputs = dt, np.array(horizons), outputs
        self._maps: _Maps | None = None
        # What was predicted, in a ring: a sample is compared with what was predicted of it horizons ago.
        self._ring = np.full((horizons[-1] + 1, len(horizons), outputs, 4), np.nan)
        self._place = 0
        self._errors: list[Array] = []
        self._changes: deque[Array] = deque(maxlen=max(1, round(LARGEST_SECONDS / dt / block)))
        self._largest = np.zeros((len(horizons), outputs))
        self.begin_with(())

    def begin_with(self, blocks: Iterable[MemoryBlock]) -> None:
        """Learns anew from these blocks: later samples were not what they seemed to be."""
        self._statistics: LagStatistics | None = None
        self._before, self._waiting = np.empty((0, 0)), deque(blocks)
        self._units: tuple[Array, Array] | None = None  # of the first second, in which rows are summed
        self._uncounted = 0
        self._errors.clear()
        self._squared = np.full((*self._largest.shape, 4), np.nan)
        self._number = sum(len(block.outputs) for block in self._waiting)
        self._mean = np.zeros(self._outputs)
        if self._waiting:
            self._mean = np.concatenate([block.outputs for block in self._waiting]).mean(axis=0)

    def add(self, block: MemoryBlock) -> None:
        """Learns from the block that was just closed, whose samples were predicted from."""
        self._waiting.append(block)
        if self._errors:
            errors = np.array(self._errors)
            self._errors.clear()
            changes = np.abs(errors[..., 1])
            self._changes.append(np.where(np.isfinite(changes), changes, 0.0).max(axis=0))
            self._largest = np.max(self._changes, axis=0)
            self._average(errors**2)

    def end_segment(self) -> None:
        """A gap follows: no sample after it is compared with predictions before it."""
        self._ring[:] = np.nan

    def predict(self, memory: Memory) -> Array:
        """Returns (H, m): predictions at the horizons from the latest sample of the ``memory``."""
        inputs, outputs = memory.latest(self.lags)
        latest = outputs[-1]
        before = self._ring[(self._place - self._horizons) % len(self._ring), np.arange(len(self._horizons))]
        self._errors.append(latest[:, None] - before)
        self._number += 1
        self._mean += (latest - self._mean) / self._number
        held = predicted = np.broadcast_to(latest, self._largest.shape)
        if self._maps is not None:
            center, scale, lags, constant = self._maps
            m = self._outputs
            past = ((initial_lags(np.hstack([outputs, inputs]), self.lags) - center) / scale)[::-1].ravel()
            with np.errstate(over="ignore", invalid="ignore"):
                ahead = center[:m] + scale[:m] * (lags @ past + constant)
            predicted = np.where(np.isfinite(ahead), ahead, latest)
        members = np.stack([held, np.broadcast_to(self._mean, held.shape), predicted])
        bounded = np.clip(members, latest - self._largest, latest + self._largest)
        known = np.isfinite(self._squared).all(axis=-1)
        weights = mixture_weights(np.where(known, np.moveaxis(self._squared[..., 1:], -1, 0), 1.0))
        shown = np.where(known, (weights * bounded).sum(axis=0), held)
        self._ring[self._place] = np.stack([shown, *members[:2], bounded[2]], axis=-1)
        self._place = (self._place + 1) % len(self._ring)
        return shown

    def advance(self) -> None:
        """Counts the waiting blocks and fits when that is due, unless another thread is computing."""
        if not self._waiting:
            return
        if self._units is None:
            if sum(len(block.outputs) for block in self._waiting) * self._dt < FIRST_SECONDS:
                return
            channels = np.concatenate([np.hstack([block.outputs, block.inputs]) for block in self._waiting])
            scale = channels.std(axis=0)
            self._units = channels.mean(axis=0), np.where(scale > 0, scale, 1.0)
        center, scale = self._units
        while self._waiting:
            block = self._waiting.popleft()
            channels = (np.hstack([block.outputs, block.inputs]) - center) / scale
            if not block.begins and len(self._before):
                channels = np.vstack([self._before, channels])
            self._before = channels[-self.lags :]
            self._uncounted += len(block.outputs)
            new = LagStatistics.of([channels], self.lags)
            if self._statistics is not None:
                new += self._statistics.forgotten(float(np.exp(-new.rows * self._dt / MEMORY_SECONDS)))
            self._statistics = new
        if self._uncounted * self._dt < REFIT_SECONDS or self._statistics is None or self._statistics.rows < 1:
            return
        with one_thread_if_free() as free:
            if free:
                self._uncounted = 0
                self._fit(self._statistics, center, scale)

    def _fit(self, statistics: LagStatistics, center: Array, scale: Array) -> None:
        scaled, units = statistics.in_own_units(self.lags, SMALLEST_SCALE)
        try:
            maps = Var.fit(scaled, self.lags, RIDGE).ahead(tuple(self._horizons.tolist()), self._outputs)
        except np.linalg.LinAlgError:  # of this fit; the next has other samples
            return
        self._maps = _Maps(center + scale * units.center, scale * units.scale, *maps)

    @property
    def error_ratio(self) -> Array:
        """(H, m): recent squared error over that of the better of the last sample held and the mean; NaN at first."""
        ours, held, mean, _ = np.moveaxis(self._squared, -1, 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(ours / np.minimum(held, mean))

    def _average(self, squared: Array) -> None:
        known = np.isfinite(squared).all(axis=-1, keepdims=True)
        number = known.sum(axis=0)
        mean = np.where(known, squared, 0.0).sum(axis=0) / np.maximum(number, 1)
        before = np.where(np.isfinite(self._squared), self._squared, mean)
        gain = 1 - np.exp(-len(squared) * self._dt / ERROR_SECONDS)
        self._squared = np.where(number > 0, before + gain * (mean - before), self._squared)
