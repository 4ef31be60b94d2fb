"""The joint model of a stream: each sample from those before it, and the next ones with their inputs unknown.

Sums over the samples are forgotten exponentially, and every half second the joint model is fitted to them again, in
two forms: with the past and prior that F̄ chooses, of which each time one other is tried; and with the longest past.
Predictions are their average, at each horizon with weights by their latest errors there. Before the first fit the last
sample is held.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import cycle

import numpy as np
from scipy.linalg import block_diag

from mavdem.dem.engine.linalg import Array, one_thread
from mavdem.dem.forecast.joint import CHOICES, LAGS, Choice
from mavdem.dem.forecast.var import ChannelUnits, LagStatistics, Var, initial_lags, regress
from mavdem.dem.online.memory import Memory, MemoryBlock

MEMORY_SECONDS = 30.0  # time constant of forgetting
# of samples before the first fit, and from one fit to the next
FIRST_SECONDS = 1.0
REFIT_SECONDS = 0.5
LONG = Choice(LAGS[-1], 1e-4, False)  # of the second form
FORMS = 2
ERROR_SECONDS = np.array([10.0] * 3 + [3.0] * FORMS)
"""Time constants of the squared errors of what was shown, the last sample and the mean, which are compared; and of the
sizes of each form's errors, since what is best changes from hover to manoeuvre."""
# of a form, for its weight: their Laplace likelihood, its mean absolute error ** -16
INDEPENDENT_ERRORS = 16


class OnlineJoint:
    """Predicts every sample at each horizon; learns from each block of samples."""

    def __init__(
        self,
        dt: float,
        block: int,
        horizons: tuple[int, ...],
        outputs: int,
        combinations: Array | None,
    ) -> None:
        """Begins without a sample; ``horizons`` are steps of ``dt``, s, and a ``block`` is so many samples.

        There is no model without ``combinations`` (r, c) of the inputs, which :meth:`begin_with` may bring.
        """
        self._dt, self._horizons, self._outputs = dt, np.array(horizons), outputs
        self._rows = np.arange(len(horizons))
        self.combinations: Array | None = None
        # Of the latest samples, outputs and inputs, the latest first, and constants: (2 H + 1, m, …) of each form's
        # predictions and, last, of the latest sample by the first form, with its own inputs.
        self._maps: Array | None = None
        self._constants = np.zeros((FORMS * len(horizons) + 1, outputs))
        self._weights = np.full((FORMS, len(horizons), outputs), 1 / FORMS)
        # What was predicted, in a ring: a sample is compared with what was predicted of it horizons ago.
        self._ring = np.full((horizons[-1] + 1, len(ERROR_SECONDS), len(horizons), outputs), np.nan)
        self._place = 0
        self._errors: list[Array] = []
        self._unknown = np.full(outputs, np.nan)
        self._choice = Choice(LAGS[2], 1e-3, True)
        self._others = cycle(CHOICES)
        self.begin_with((), combinations)

    def begin_with(self, blocks: Iterable[MemoryBlock], combinations: Array | None) -> None:
        """Learns anew from these blocks: later samples, or the mixer, were not what they seemed to be."""
        self.combinations = combinations
        self._statistics: LagStatistics | None = None
        self._before, self._waiting = np.empty((0, 0)), deque(blocks)
        # of the first second, in which rows are summed
        self._units: ChannelUnits | None = None
        self._uncounted = 0
        self._fitting: Iterator[None] | None = None  # what of it is done, a piece at a time
        self._errors.clear()
        self._sizes = np.full((len(self._horizons), len(ERROR_SECONDS), self._outputs), np.nan)
        seen = np.concatenate(
            [np.empty((0, self._outputs)), *(block.outputs for block in self._waiting)]
        )
        self._number, self._mean = len(seen), seen.sum(axis=0) / max(len(seen), 1)

    def add(self, block: MemoryBlock) -> None:
        """Learns from the block that was just closed, whose samples were predicted from."""
        self._waiting.append(block)
        if self._errors:
            errors = np.abs(self._errors)
            errors[:, :, :3] **= 2
            self._average(errors)
            self._errors.clear()

    def end_segment(self) -> None:
        """A gap follows: no sample after it is compared with predictions before it."""
        self._ring[:] = np.nan

    def predict(self, memory: Memory) -> tuple[Array, Array]:
        """Returns (m,) the latest sample, from those before it and its own inputs, or NaN; and (H, m) the next ones."""
        inputs, outputs = memory.latest(LAGS[-1] + 1)
        latest = outputs[-1]
        before = self._ring[(self._place - self._horizons) % len(self._ring), :, self._rows]
        self._errors.append(latest - before)
        self._number += 1
        self._mean += (latest - self._mean) / self._number
        expected = self._unknown
        every = latest
        if self._maps is not None:
            past = initial_lags(np.concatenate([outputs, inputs], axis=1), LAGS[-1] + 1)[
                ::-1
            ].ravel()
            with np.errstate(over="ignore", invalid="ignore"):
                found = self._maps.dot(past) + self._constants
            every = found[:-1].reshape(self._weights.shape)
            every = (
                every if np.isfinite(every).all() else np.where(np.isfinite(every), every, latest)
            )
            expected = found[-1] if len(outputs) > 1 else expected
        ahead = np.add.reduce(self._weights * every)
        # soon after a gap the lags are not known
        short = self._maps is not None and len(outputs) < LAGS[-1]
        if short:
            ahead[:] = latest
        row = self._ring[self._place]
        row[0] = ahead
        row[1] = latest
        row[2] = self._mean
        row[3:] = np.nan if short else every
        self._place = (self._place + 1) % len(self._ring)
        return expected, ahead

    def advance(self) -> None:
        """Counts a waiting block, or goes on with a fit unless another thread is computing: a piece for each sample."""
        if self.combinations is None:
            return
        if self._waiting:
            self._count()
        elif self._fitting is not None:
            with one_thread(wait=False) as free:
                if free and next(self._fitting, "done") == "done":
                    self._fitting = None

    def _count(self) -> None:
        if self._units is None:
            if sum(len(block.outputs) for block in self._waiting) * self._dt < FIRST_SECONDS:
                return
            channels = np.concatenate(
                [self._channels(block.inputs, block.outputs) for block in self._waiting]
            )
            scale = channels.std(axis=0)
            self._units = ChannelUnits(channels.mean(axis=0), np.where(scale > 0, scale, 1.0))
        block = self._waiting.popleft()
        channels = self._units.scaled(self._channels(block.inputs, block.outputs))
        if not block.begins and len(self._before):
            channels = np.vstack([self._before, channels])
        self._before = channels[-LAGS[-1] :]
        self._uncounted += len(block.outputs)
        new = LagStatistics.of([channels], LAGS[-1])
        if self._statistics is not None:
            new += self._statistics.forgotten(float(np.exp(-new.rows * self._dt / MEMORY_SECONDS)))
        self._statistics = new
        due = self._uncounted * self._dt >= REFIT_SECONDS and new.rows >= 1
        if due and not self._waiting and self._fitting is None:
            self._uncounted, self._fitting = 0, self._fit(new, self._units)

    def _channels(self, inputs: Array, outputs: Array) -> Array:
        assert self.combinations is not None
        return np.hstack([outputs, inputs @ self.combinations])

    def _fit(self, statistics: LagStatistics, units: ChannelUnits) -> Iterator[None]:
        """Fits two of the forms, in pieces of some milliseconds."""
        assert self.combinations is not None
        if self._maps is None:  # a form without a fit holds the last sample
            samples = (LAGS[-1] + 1) * (self._outputs + len(self.combinations))
            self._maps = np.zeros((*self._constants.shape, samples))
            self._maps[..., : self._outputs] = np.eye(self._outputs)
            self._constants[-1] = np.nan
        for place, choices in enumerate(((self._choice, next(self._others)), (LONG,))):
            try:
                fits = []
                for one in choices:
                    yield
                    gram = statistics.shortened(LAGS[-1], one.lags)
                    fits.append(regress(gram, statistics.rows, one.prior))
            except np.linalg.LinAlgError:  # of these fits; the next have other samples
                continue
            yield
            choice, found = max(zip(choices, fits, strict=True), key=lambda one: one[1].free_energy)
            process = Var.of(found, units)
            if process.spectral_radius > 1 + 1 / self._horizons[-1]:
                # Of the beginning of a manoeuvre, that seems to grow for ever: the next block shows its end.
                self._uncounted = round(REFIT_SECONDS / self._dt)
                continue
            rows = slice(place * len(self._horizons), (place + 1) * len(self._horizons))
            ahead = process.ahead(tuple(self._horizons.tolist()), self._outputs)
            self._maps[rows], self._constants[rows] = self._physical(units, *ahead)
            if place == 0:
                self._choice = choice
                latest = process.latest(self._outputs)
                self._maps[-1], self._constants[-1] = self._physical(units, *latest)

    def _physical(
        self, units: ChannelUnits, weights: Array, constants: Array
    ) -> tuple[Array, Array]:
        """Weights (…, m, p k) of the latest p samples of channels in these ``units``, and constants (…, m)."""
        assert self.combinations is not None
        m = self._outputs
        (center, scale) = units
        basis = block_diag(np.eye(m), self.combinations)
        by_lag = (
            scale[:m, None, None] * weights.reshape(*weights.shape[:-1], -1, len(center)) / scale
        )
        physical = np.zeros((*weights.shape[:-1], LAGS[-1] + 1, len(basis)))
        physical[..., : by_lag.shape[-2], :] = by_lag @ basis.T
        constants = center[:m] + scale[:m] * constants - by_lag.sum(axis=-2) @ center
        return physical.reshape(*weights.shape[:-1], -1), constants

    @property
    def error_ratio(self) -> Array:
        """(H, m): recent squared error over that of the better of the last sample held and the mean; NaN at first."""
        ours, held, mean = np.moveaxis(self._sizes[:, :3], 1, 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(ours / np.minimum(held, mean))

    def _average(self, errors: Array) -> None:
        known = np.isfinite(errors).all(axis=2, keepdims=True)
        number = known.sum(axis=0)
        mean = np.where(known, errors, 0.0).sum(axis=0) / np.maximum(number, 1)
        before = np.where(np.isfinite(self._sizes), self._sizes, mean)
        gain = 1 - np.exp(-len(errors) * self._dt / ERROR_SECONDS)[:, None]
        self._sizes = np.where(number > 0, before + gain * (mean - before), self._sizes)
        forms = np.maximum(np.moveaxis(self._sizes[:, 3:], 1, 0), np.finfo(float).tiny)
        likelihood = (
            np.where(np.isfinite(forms), forms.min(axis=0) / forms, 1.0) ** INDEPENDENT_ERRORS
        )
        self._weights = likelihood / likelihood.sum(axis=0)
