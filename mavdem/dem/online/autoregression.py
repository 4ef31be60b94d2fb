"""OnlineAutoregression: outputs and inputs of a stream as one process, learnt with forgetting, and what it predicts.

Nothing is known of future inputs: they follow from the motion, since the autopilot answers it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from mavdem.dem.closed_loop.autoregression import Autoregression, ChannelUnits, LagStatistics, autoregression
from mavdem.dem.engine.linalg import Array, one_thread_if_free
from mavdem.dem.engine.resumable import Resumable
from mavdem.dem.online.memory import MemoryBlock
from mavdem.dem.online.noise_level import POWER, NoiseLevel
from mavdem.dem.record import Record

LAG_SECONDS = 0.15
FEWEST_LAGS = 4
MOST_LAGS = 16
MOST_REGRESSORS = 100  # a fit of so many takes a millisecond
RIDGE = 0.002
FIRST_SECONDS = 1.0  # of samples, before the first fit
REFIT_SECONDS = 0.5  # of samples, from one fit to the next
SMALLEST_SCALE = 1e-6  # of a channel that became still, in units of its first second
STEPS_AT_ONCE = 25  # of the maps to the horizons, between two pauses


class Maps(NamedTuple):
    """Predictions as linear maps of the latest samples, in units of their own."""

    center: Array  # (k,)
    scale: Array  # (k,)
    of_lags: Array  # (H, m, lags, k), the oldest lag first
    constant: Array  # (H, m)

    def predicted(self, channels: Array) -> Array:
        """(H, m) from the latest samples (lags, k), physical."""
        width = self.constant.shape[-1]
        lags = ((channels - self.center) / self.scale).ravel()
        found = self.of_lags.reshape(self.constant.size, -1) @ lags + self.constant.ravel()
        return np.asarray(self.center[:width] + self.scale[:width] * found.reshape(self.constant.shape))


class MemoryChoice(NamedTuple):
    """What an autoregression is learnt from: seconds of lags, and how samples count."""

    lags: float  # s
    memory: float  # s, time constant of forgetting
    power: float  # see ``NoiseLevel``


LONG = MemoryChoice(LAG_SECONDS, 30.0, POWER)
SHORT = MemoryChoice(0.0, 15.0, 0.0)
"""Of few lags, quick to follow a change, and learnt most from what moves most."""


class OnlineAutoregression:
    """A vector autoregression of [outputs, inputs], fitted again every half second in short steps.

    Sums over rows are forgotten exponentially; with a power, blocks count less where one-step errors are large.
    """

    def __init__(
        self, dt: float, horizons: tuple[int, ...], inputs: int, outputs: int, how: MemoryChoice = LONG
    ) -> None:
        """Begins without samples; predicts ``horizons`` steps of ``dt``, s, ahead."""
        k = inputs + outputs
        most = max(FEWEST_LAGS, min(MOST_LAGS, MOST_REGRESSORS // k))
        self.lags, self._how = int(np.clip(round(how.lags / dt), FEWEST_LAGS, most)), how
        self._dt, self._horizons, self._outputs = dt, horizons, outputs
        self._walk = np.hstack([-np.eye(k), np.zeros((k, (self.lags - 1) * k + 1)), np.eye(k)])
        self.begin_with(())

    def begin_with(self, blocks: Iterable[MemoryBlock]) -> None:
        """Learns anew from these blocks; predictions stay what they are until the next fit."""
        self._waiting = deque(blocks)
        self._steps: Resumable[None] | None = None
        self._units: ChannelUnits | None = None
        self._statistics, self._rows, self._uncounted = LagStatistics(0, np.zeros((0, 0))), 0.0, 0
        self._before, self._level = np.empty((0, 0)), NoiseLevel(self._how.power)
        self._errors = self._walk  # of a row in ``_units``
        self._maps: Maps | None = getattr(self, "_maps", None)

    def add(self, block: MemoryBlock) -> None:
        """Queues the next block of samples."""
        self._waiting.append(block)

    @property
    def waits(self) -> bool:
        """Whether there is a step to do."""
        return self._steps is not None or bool(self._waiting)

    def advance(self) -> None:
        """One step of counting or fitting, of about a millisecond, unless another thread is computing."""
        if not self.waits:
            return
        with one_thread_if_free() as free:
            if not free:
                return
            if self._steps is None:
                self._steps = self._learning()
            try:
                next(self._steps)
            except StopIteration:
                self._steps = None
            except np.linalg.LinAlgError:  # of this fit; the next has other samples
                self._steps = None

    def ahead(self, inputs: Array, outputs: Array) -> Array | None:
        """(H, m) predictions from the latest inputs and outputs, ``lags`` of them; ``None`` before the first fit.

        Before the first of fewer samples, the vehicle is taken to have been as in it.
        """
        if self._maps is None:
            return None
        channels = np.hstack([outputs, inputs])[-self.lags :]
        missing = self.lags - len(channels)
        if missing > 0:
            channels = np.vstack([np.repeat(channels[:1], missing, axis=0), channels])
        with np.errstate(over="ignore", invalid="ignore"):
            return self._maps.predicted(channels)

    def _learning(self) -> Resumable[None]:
        if self._units is None:
            if sum(len(block.outputs) for block in self._waiting) * self._dt < FIRST_SECONDS:
                return
            inputs, outputs = (np.concatenate(parts) for parts in list(zip(*self._waiting, strict=True))[:2])
            self._units = ChannelUnits.of(Record(inputs, outputs, self._dt, (len(inputs),)))
            yield
        while self._waiting:
            self._count(self._units, self._waiting.popleft())
            yield
        if self._uncounted * self._dt >= REFIT_SECONDS and self._rows > 0:
            yield from self._fit(self._units)

    def _count(self, units: ChannelUnits, block: MemoryBlock) -> None:
        channels = units.scaled(np.hstack([block.outputs, block.inputs]))
        if not block.begins and len(self._before):
            channels = np.vstack([self._before, channels])
        self._before = channels[-self.lags :]
        self._uncounted += len(block.outputs)
        rows, gram = LagStatistics.of([channels], self.lags)
        if not rows:
            return
        squared = ((self._errors @ gram) * self._errors).sum(axis=1)[: self._outputs] / rows
        weight = self._level.weight(np.maximum(squared, 0.0), rows * self._dt)
        left = np.exp(-rows * self._dt / self._how.memory) if self._rows else 0.0
        before = self._statistics.gram if self._rows else 0.0
        self._rows = left * self._rows + rows
        self._statistics = LagStatistics(round(self._rows), left * before + weight * gram)

    def _fit(self, units: ChannelUnits) -> Resumable[None]:
        self._uncounted = 0
        rows, gram = self._statistics
        k, width = len(units.center), len(gram)
        one = width - k - 1
        # Units of what is remembered now, and as many rows as it is worth.
        weights = gram[one, one]
        center = gram[one, one + 1 :] / weights
        variance = gram.diagonal()[one + 1 :] / weights - center**2
        scale = np.sqrt(np.maximum(variance, SMALLEST_SCALE**2))
        step = np.diag(np.concatenate([np.tile(1 / scale, self.lags), [1.0], 1 / scale]))
        step[:one, one] = -np.tile(center / scale, self.lags)
        step[one + 1 :, one] = -center / scale
        scaled = LagStatistics(rows, rows / weights * (step @ gram @ step.T))
        yield
        model = autoregression(scaled, self.lags, RIDGE)
        yield
        of_lags, constant = yield from resumable_maps(model, self._horizons, self._outputs)
        coefficients = np.hstack([model.across, model.offset[:, None]])
        self._errors = scale[:, None] * (np.hstack([-coefficients, np.eye(k)]) @ step)
        self._maps = Maps(units.center + units.scale * center, units.scale * scale, of_lags, constant)


def resumable_maps(model: Autoregression, horizons: tuple[int, ...], outputs: int) -> Resumable[tuple[Array, Array]]:
    """(H, m, lags, k) and (H, m): predictions by the lags, the oldest first, and their constant, in its units."""
    across, k, lags = model.across, model.channels, model.lags
    # Rows of a later sample above those of the samples before it, of columns [lag 1 … lag p, 1].
    steps = horizons[-1]
    later = np.zeros(((steps + lags) * k, lags * k + 1))
    later[steps * k :, :-1] = np.eye(lags * k)
    with np.errstate(over="ignore", invalid="ignore"):
        for ahead in range(1, steps + 1):
            first = (steps - ahead) * k
            later[first : first + k] = across @ later[first + k : first + k + lags * k]
            later[first : first + k, -1] += model.offset
            if ahead % STEPS_AT_ONCE == 0:
                yield
    rows = np.array([later[(steps - horizon) * k :][:outputs] for horizon in horizons])
    return np.ascontiguousarray(rows[:, :, :-1].reshape(len(horizons), outputs, lags, k)[:, :, ::-1]), rows[:, :, -1]
