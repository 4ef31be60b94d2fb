"""The joint model of a stream: each sample from those before it, and the next ones with their inputs unknown.

Sums over the samples are forgotten exponentially, and every half second the joint model is fitted to them again. Each
time it tries one other choice of past and prior, and keeps the one of the higher F̄. Before its first fit the last
sample is held. No prediction is farther from the last sample than the vehicle lately went in as many samples.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from itertools import cycle
from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.linalg import Array, one_thread_if_free
from mavdem.dem.forecast.joint import CHOICES, LAGS, Choice
from mavdem.dem.forecast.var import LagStatistics, Var, initial_lags, regress
from mavdem.dem.online.memory import Memory, MemoryBlock

MEMORY_SECONDS = 30.0  # time constant of forgetting
FIRST_SECONDS, REFIT_SECONDS = 1.0, 0.5  # of samples before the first fit, and from one fit to the next
SMALLEST_SCALE = 1e-6  # of a channel that became still, in units of its first second
LARGEST_SECONDS = 20.0  # of samples whose largest change over a horizon bounds the next
ERROR_SECONDS = 10.0  # time constant of the squared errors that are compared


class _Maps(NamedTuple):
    """Predictions as linear maps of the latest samples, in units of their own."""

    center: Array  # (k,)
    scale: Array  # (k,)
    lags: Array  # (H, m, L k), the latest lag first
    constant: Array  # (H, m)
    expected: Array  # (m, L k) of the next sample, from the lags …
    inputs: Array  # (m, c) … and its own inputs
    expected_constant: Array  # (m,)

    @property
    def number(self) -> int:
        """Of lags."""
        return int(self.lags.shape[-1] // len(self.center))

    def scaled(self, channels: Array) -> Array:
        """Returns (L k,) the last samples of ``channels`` (T, k), the latest first."""
        return np.asarray(((initial_lags(channels, self.number) - self.center) / self.scale)[::-1].ravel())


class OnlineJoint:
    """Predicts every sample at each horizon; learns from each block of samples."""

    def __init__(
        self, dt: float, block: int, horizons: tuple[int, ...], outputs: int, combinations: Array | None
    ) -> None:
        """Begins without a sample; ``horizons`` are steps of ``dt``, s, and a ``block`` is so many samples.

        There is no model without ``combinations`` (r, c) of the inputs, which :meth:`begin_with` may bring.
        """
        self._dt, self._horizons, self._outputs = dt, np.array(horizons), outputs
        self.combinations: Array | None = None
        self._maps: _Maps | None = None
        # What was predicted, in a ring: a sample is compared with what was predicted of it horizons ago.
        self._ring = np.full((horizons[-1] + 1, len(horizons), outputs, 3), np.nan)
        self._place = 0
        self._errors: list[Array] = []
        self._changes: deque[Array] = deque(maxlen=max(1, round(LARGEST_SECONDS / dt / block)))
        self._largest = np.zeros((len(horizons), outputs))
        self._choice, self._others = Choice(LAGS[2], 1e-3, True), cycle(CHOICES)
        self.begin_with((), combinations)

    def begin_with(self, blocks: Iterable[MemoryBlock], combinations: Array | None) -> None:
        """Learns anew from these blocks: later samples, or the mixer, were not what they seemed to be."""
        if combinations is not self.combinations:
            self.combinations, self._maps = combinations, None
        self._statistics: LagStatistics | None = None
        self._before, self._waiting = np.empty((0, 0)), deque(blocks)
        self._units: tuple[Array, Array] | None = None  # of the first second, in which rows are summed
        self._uncounted = 0
        self._errors.clear()
        self._squared = np.full((*self._largest.shape, 3), np.nan)
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

    def expect(self, memory: Memory) -> Array:
        """Returns (m,): the latest sample of the ``memory`` from those before it and its own inputs; or NaN."""
        if self._maps is None or self.combinations is None or len(memory.latest(2)[1]) < 2:
            return np.full(self._outputs, np.nan)
        m, maps, latest = self._outputs, self._maps, self._channels(*memory.latest(self._maps.number + 1))
        now = ((latest[-1] - maps.center) / maps.scale)[m:]
        ahead = maps.expected @ maps.scaled(latest[:-1]) + maps.inputs @ now + maps.expected_constant
        return np.asarray(maps.center[:m] + maps.scale[:m] * ahead)

    def predict(self, memory: Memory) -> Array:
        """Returns (H, m): predictions at the horizons from the latest sample of the ``memory``."""
        latest = memory.latest(1)[1][-1]
        before = self._ring[(self._place - self._horizons) % len(self._ring), np.arange(len(self._horizons))]
        self._errors.append(latest[:, None] - before)
        self._number += 1
        self._mean += (latest - self._mean) / self._number
        held = shown = np.broadcast_to(latest, self._largest.shape)
        if self._maps is not None and self.combinations is not None:
            m, maps = self._outputs, self._maps
            with np.errstate(over="ignore", invalid="ignore"):
                ahead = maps.lags @ maps.scaled(self._channels(*memory.latest(maps.number))) + maps.constant
                shown = maps.center[:m] + maps.scale[:m] * ahead
            shown = np.where(np.isfinite(shown), shown, latest)
            shown = np.clip(shown, latest - self._largest, latest + self._largest)
        self._ring[self._place] = np.stack([shown, held, np.broadcast_to(self._mean, held.shape)], axis=-1)
        self._place = (self._place + 1) % len(self._ring)
        return shown

    def advance(self) -> None:
        """Counts the waiting blocks and fits when that is due, unless another thread is computing."""
        if not self._waiting or self.combinations is None:
            return
        if self._units is None:
            if sum(len(block.outputs) for block in self._waiting) * self._dt < FIRST_SECONDS:
                return
            channels = np.concatenate([self._channels(block.inputs, block.outputs) for block in self._waiting])
            scale = channels.std(axis=0)
            self._units = channels.mean(axis=0), np.where(scale > 0, scale, 1.0)
        center, scale = self._units
        while self._waiting:
            block = self._waiting.popleft()
            channels = (self._channels(block.inputs, block.outputs) - center) / scale
            if not block.begins and len(self._before):
                channels = np.vstack([self._before, channels])
            self._before = channels[-LAGS[-1] :]
            self._uncounted += len(block.outputs)
            new = LagStatistics.of([channels], LAGS[-1])
            if self._statistics is not None:
                new += self._statistics.forgotten(float(np.exp(-new.rows * self._dt / MEMORY_SECONDS)))
            self._statistics = new
        if self._uncounted * self._dt < REFIT_SECONDS or self._statistics is None or self._statistics.rows < 1:
            return
        with one_thread_if_free() as free:
            if free:
                self._uncounted = 0
                self._fit(self._statistics, center, scale)

    def _channels(self, inputs: Array, outputs: Array) -> Array:
        assert self.combinations is not None
        return np.hstack([outputs, inputs @ self.combinations])

    def _fit(self, statistics: LagStatistics, center: Array, scale: Array) -> None:
        scaled, units = statistics.in_own_units(LAGS[-1], SMALLEST_SCALE)
        tried = []
        for choice in (self._choice, next(self._others)):
            try:
                tried.append((choice, regress(scaled.shortened(LAGS[-1], choice.lags), scaled.rows, choice.prior)))
            except np.linalg.LinAlgError:  # of this fit; the next has other samples
                continue
        if not tried:
            return
        self._choice, found = max(tried, key=lambda one: one[1].free_energy)
        m, process = self._outputs, Var.of(found, units)
        gain, across = process.output_gain(m), process.across
        self._maps = _Maps(
            center + scale * units.center,
            scale * units.scale,
            *process.ahead(tuple(self._horizons.tolist()), m),
            across[:m] - gain @ across[m:],
            gain,
            process.offset[:m] - gain @ process.offset[m:],
        )

    @property
    def error_ratio(self) -> Array:
        """(H, m): recent squared error over that of the better of the last sample held and the mean; NaN at first."""
        ours, held, mean = np.moveaxis(self._squared, -1, 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(ours / np.minimum(held, mean))

    def _average(self, squared: Array) -> None:
        known = np.isfinite(squared).all(axis=-1, keepdims=True)
        number = known.sum(axis=0)
        mean = np.where(known, squared, 0.0).sum(axis=0) / np.maximum(number, 1)
        before = np.where(np.isfinite(self._squared), self._squared, mean)
        gain = 1 - np.exp(-len(squared) * self._dt / ERROR_SECONDS)
        self._squared = np.where(number > 0, before + gain * (mean - before), self._squared)
