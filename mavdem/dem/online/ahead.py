"""The joint model of a stream: each sample from those before it, and the next ones with their inputs unknown.

Sums over the samples are forgotten exponentially, and every half second the joint model is fitted to them again, with
the past and prior that F̄ chooses, of which each time one other is tried. Before the first fit the last sample is held.
"""

from collections.abc import Iterable
from contextlib import suppress
from itertools import cycle
from typing import NamedTuple

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.linalg import may_overflow, one_thread
from mavdem.dem.forecast.joint import (
    HYPERPARAMETER_GRID,
    LAG_CANDIDATES,
    VarHyperparameters,
    select_hyperparameters,
)
from mavdem.dem.forecast.var import (
    ChannelScaling,
    LagStatistics,
    VectorAutoregression,
    initial_lags,
)
from mavdem.dem.online.memory import MemoryBlock, SampleMemory

MEMORY_SECONDS = 30.0  # time constant of forgetting
# of samples before the first fit, and from one fit to the next
FIRST_SECONDS = 1.0
REFIT_SECONDS = 0.5
ERROR_SECONDS = 10.0
"""Time constant of the squared errors of what was shown, the last sample and the mean, which are compared."""


class PredictionMaps(NamedTuple):
    """A fitted model as linear maps of the latest samples."""

    combinations: Array  # (r, c) of the inputs, that are channels of the model
    units: ChannelScaling
    # (H + 1, m, p) of the latest samples, the latest first: the next ones and, last, the latest with its own inputs
    weights: Array
    constants: Array  # (H + 1, m)

    @may_overflow
    def of(self, inputs: Array, outputs: Array) -> Array:
        """Returns (H + 1, m) what the latest samples, (T, r) and (T, m), predict; what overflows is not finite."""
        channels = self.units.scaled(np.hstack([outputs, inputs @ self.combinations]))
        past = initial_lags(channels, LAG_CANDIDATES[-1] + 1)[::-1].ravel()
        center, scale = (values[: outputs.shape[1]] for values in self.units)
        return center + scale * (self.weights.dot(past) + self.constants)


class OnlineForecaster:
    """Predicts every sample at each horizon; learns from each block of samples."""

    def __init__(
        self,
        dt: float,
        horizons: tuple[int, ...],
        outputs: int,
        combinations: Array | None,
    ) -> None:
        """Begins without a sample; ``horizons`` are steps of ``dt``, s.

        There is no model without ``combinations`` (r, c) of the inputs, which :meth:`begin_with` may bring.
        """
        self._dt, self._horizons, self._outputs = dt, np.array(horizons), outputs
        self._rows = np.arange(len(horizons))
        self._prediction: PredictionMaps | None = None
        # What was predicted, in a ring: a sample is compared with what was predicted of it horizons ago.
        self._ring = np.full((horizons[-1] + 1, 3, len(horizons), outputs), np.nan)
        self._place = 0
        self.errors = np.full((len(horizons), outputs), np.nan)
        """(H, m) of what was predicted of the latest sample at each horizon; NaN where nothing was."""
        self._number = 0
        self._mean = np.zeros(outputs)
        self._unknown = np.full(outputs, np.nan)
        self._choice = VarHyperparameters(LAG_CANDIDATES[2], 1e-3)
        self._others = cycle(HYPERPARAMETER_GRID)
        self.begin_with((), combinations)

    def begin_with(self, blocks: Iterable[MemoryBlock], combinations: Array | None) -> None:
        """Learns anew from these blocks: later samples, or the mixer, were not what they seemed to be."""
        self.combinations = combinations
        self._statistics: LagStatistics | None = None
        self._before = np.empty((0, 0))
        self._waiting: list[MemoryBlock] = []
        # of the first second, in which rows are summed
        self._units: ChannelScaling | None = None
        self._uncounted = 0
        self._sizes = np.full((len(self._horizons), 3, self._outputs), np.nan)
        for block in blocks:
            self.add(block, fits=False)

    def end_segment(self) -> None:
        """Ends a segment, as a gap follows: no sample after it is compared with predictions before it."""
        self._ring[:] = np.nan

    def predict(self, memory: SampleMemory) -> ArrayPair:
        """Returns (m,) the latest sample, from those before it and its own inputs, or NaN; and (H, m) the next ones."""
        inputs, outputs = memory.latest_samples(LAG_CANDIDATES[-1] + 1)
        latest = outputs[-1]
        errors = (
            latest - self._ring[(self._place - self._horizons) % len(self._ring), :, self._rows]
        )
        self.errors = errors[:, 0]
        squares = errors**2
        sizes = np.where(np.isfinite(self._sizes), self._sizes, squares)
        sizes += (1 - np.exp(-self._dt / ERROR_SECONDS)) * (squares - sizes)
        self._sizes = np.where(np.isfinite(squares), sizes, self._sizes)
        self._number += 1
        self._mean += (latest - self._mean) / self._number
        expected = self._unknown
        ahead = np.tile(latest, (len(self._horizons), 1))
        if self._prediction is not None:
            predicted = self._prediction.of(inputs, outputs)
            if len(outputs) > 1:
                expected = predicted[-1]
            if len(outputs) >= LAG_CANDIDATES[-1]:  # soon after a gap the lags are not known
                ahead = np.where(np.isfinite(predicted[:-1]), predicted[:-1], latest)
        row = self._ring[self._place]
        row[0] = ahead
        row[1] = latest
        row[2] = self._mean
        self._place = (self._place + 1) % len(self._ring)
        return expected, ahead

    def add(self, block: MemoryBlock, fits: bool = True) -> None:
        """Learns from a block that was just closed; ``fits`` when due, unless another thread is computing."""
        if self.combinations is None:
            return
        self._waiting.append(block)
        if self._units is None:
            if sum(len(block.outputs) for block in self._waiting) * self._dt < FIRST_SECONDS:
                return
            channels = np.concatenate([self._channels(block) for block in self._waiting])
            scale = channels.std(axis=0)
            self._units = ChannelScaling(channels.mean(axis=0), np.where(scale > 0, scale, 1.0))
        for block in self._waiting:
            channels = self._units.scaled(self._channels(block))
            if not block.starts_segment and len(self._before):
                channels = np.vstack([self._before, channels])
            self._before = channels[-LAG_CANDIDATES[-1] :]
            self._uncounted += len(block.outputs)
            new = LagStatistics.from_segments([channels], LAG_CANDIDATES[-1])
            if self._statistics is not None:
                kept = np.exp(-new.rows * self._dt / MEMORY_SECONDS)
                new = new.after(self._statistics, kept)
            self._statistics = new
        self._waiting.clear()
        if fits and self._uncounted * self._dt >= REFIT_SECONDS and new.rows >= 1:
            with one_thread(wait=False) as free, suppress(LinAlgError):
                if free:
                    self._uncounted = 0
                    self._fit(self.combinations, new, self._units)

    def _channels(self, block: MemoryBlock) -> Array:
        assert self.combinations is not None
        return np.hstack([block.outputs, block.inputs @ self.combinations])

    def _fit(self, combinations: Array, statistics: LagStatistics, units: ChannelScaling) -> None:
        """Fits the last choice and another; ``LinAlgError`` of these samples, where the next are others."""
        choices = self._choice, next(self._others)
        choice, regression = select_hyperparameters(statistics, LAG_CANDIDATES[-1], choices)
        process = VectorAutoregression.from_regression(regression, units)
        if process.spectral_radius > 1 + 1 / self._horizons[-1]:
            # Of the beginning of a manoeuvre, that seems to grow for ever: the next block shows its end.
            self._uncounted = round(REFIT_SECONDS / self._dt)
            return
        self._choice = choice
        m = self._outputs
        maps, constants = (
            part[self._horizons - 1, :m] for part in process.ahead(int(self._horizons[-1]))
        )
        latest, constant = process.latest(m)
        # The latest sample follows from one lag more.
        weights = np.zeros((len(maps) + 1, m, (LAG_CANDIDATES[-1] + 1) * len(units.center)))
        weights[:-1, :, : maps.shape[2]] = maps
        weights[-1, :, : latest.shape[1]] = latest
        self._prediction = PredictionMaps(
            combinations, units, weights, np.vstack([constants, constant[None]])
        )

    @property
    def error_ratio(self) -> Array:
        """(H, m): recent squared error over that of the better of the last sample held and the mean; NaN at first."""
        ours, held, mean = np.moveaxis(self._sizes, 1, 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return ours / np.minimum(held, mean)
