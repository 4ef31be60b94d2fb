"""PredictionsAhead: predictions of a stream with its future inputs unknown, and how good such predictions were.

Five predictions are mixed: those of a long and a short joint autoregression of outputs and inputs, the last sample,
the mean so far, and the state-space model's with its inputs held.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.dem.online.autoregression import LONG, SHORT, OnlineAutoregression
from mavdem.dem.online.memory import Memory, MemoryBlock
from mavdem.dem.online.mixture import Mixture

PREDICTIONS = 5
HELD, MEAN, STATE = 2, 3, 4  # after the autoregressions
LARGEST_SECONDS = 20.0  # of samples whose largest change over a horizon bounds the next
ERROR_SECONDS = 10.0  # time constant of the squared errors that are compared


class PredictionsAhead:
    """Predicts every sample at each horizon; learns from each block of samples."""

    def __init__(self, dt: float, block: int, horizons: tuple[int, ...], inputs: int, outputs: int) -> None:
        """Begins without a sample; ``horizons`` are steps of ``dt``, s, and a ``block`` is so many samples."""
        self._dt, self._horizons = dt, np.array(horizons)
        self._shape = len(horizons), outputs, PREDICTIONS
        self._joint = [OnlineAutoregression(dt, (1, *horizons), inputs, outputs, how) for how in (LONG, SHORT)]
        self._lags = max(joint.lags for joint in self._joint)
        self._mixture = Mixture(dt, horizons, outputs, PREDICTIONS)
        # What was predicted, in a ring: a sample is compared with what was predicted of it horizons ago.
        self._ring = np.full((horizons[-1] + 1, len(horizons), outputs, PREDICTIONS + 1), np.nan)
        self._place = 0
        self._errors: list[Array] = []
        self._block: tuple[Array, Array] | None = None  # errors of the last block, before they are weighed
        self._one_step: list[Array] = []
        self._next = np.full(outputs, np.nan)
        self._changes: deque[Array] = deque(maxlen=max(1, round(LARGEST_SECONDS / dt / block)))
        self._largest = np.zeros(self._shape[:2])
        self._number, self._mean = 0, np.zeros(outputs)
        self._squared = np.full((*self._shape[:2], 3), np.nan)

    def predict(self, memory: Memory, state: Array | None) -> Array:
        """(H, m): predictions at the horizons from the latest sample of the ``memory``.

        ``state`` (H, m) is the state-space model's, ``None`` where there is none.
        """
        inputs, outputs = memory.latest(self._lags)
        latest = outputs[-1]
        self._compare(latest)
        self._number += 1
        self._mean += (latest - self._mean) / self._number
        predictions = np.empty(self._shape)
        predictions[..., HELD], predictions[..., MEAN] = latest, self._mean
        for place, joint in enumerate(self._joint):
            found = joint.ahead(inputs, outputs)
            predictions[..., place] = self._bounded(latest, None if found is None else found[1:])
            if place == 0:
                self._next = latest.copy() if found is None else found[0]
        predictions[..., STATE] = predictions[..., 0] if state is None else self._bounded(latest, state)
        mixed = self._mixture.of(predictions)
        self._ring[self._place, ..., :-1], self._ring[self._place, ..., -1] = predictions, mixed
        self._place = (self._place + 1) % len(self._ring)
        return mixed

    def advance(self) -> None:
        """One step of learning, of at most about a millisecond."""
        if self._block is not None:
            self._weigh(*self._block)
            self._block = None
            return
        for joint in self._joint:
            if joint.waits:
                joint.advance()
                return

    def add(self, block: MemoryBlock) -> None:
        """Learns from the block that was just closed, whose samples were predicted from."""
        if self._errors:
            if self._block is not None:  # where a block is one sample, or segments are short
                self._weigh(*self._block)
            self._block = np.array(self._errors), np.array(self._one_step)
            self._errors.clear()
            self._one_step.clear()
        for joint in self._joint:
            joint.add(block)

    def end_segment(self) -> None:
        """A gap follows: no sample after it is compared with predictions before it."""
        self._ring[:], self._next = np.nan, np.full_like(self._next, np.nan)

    def begin_with(self, blocks: Iterable[MemoryBlock]) -> None:
        """Learns anew from these blocks: later samples were not what they seemed to be."""
        blocks = list(blocks)
        for joint in self._joint:
            joint.begin_with(blocks)
        self._mixture.forget()
        self._errors.clear()
        self._one_step.clear()
        self._block = None
        self._changes.clear()
        self._largest[:] = 0.0
        self._squared[:] = np.nan
        outputs = [block.outputs for block in blocks]
        self._number = sum(map(len, outputs))
        self._mean = np.concatenate(outputs).mean(axis=0) if blocks else np.zeros_like(self._mean)

    @property
    def error_ratio(self) -> Array:
        """(H, m): recent squared error over that of the better of the last sample held and the mean; NaN at first."""
        ours, *others = np.moveaxis(self._squared, -1, 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(ours / np.minimum(*others))

    def _weigh(self, errors: Array, one_step: Array) -> None:
        self._mixture.add(errors[..., :-1], one_step)
        changes = np.abs(errors[..., HELD])
        self._changes.append(np.where(np.isfinite(changes), changes, 0.0).max(axis=0))
        self._largest = np.max(self._changes, axis=0)
        self._average(errors[..., [PREDICTIONS, HELD, MEAN]] ** 2)

    def _compare(self, latest: Array) -> None:
        before = self._ring[(self._place - self._horizons) % len(self._ring), np.arange(len(self._horizons))]
        self._errors.append(latest[:, None] - before)
        self._one_step.append(latest - self._next)

    def _bounded(self, latest: Array, predicted: Array | None) -> Array:
        """(H, m): within the largest change over each horizon that was seen; the last sample where there is none."""
        if predicted is None:
            return np.broadcast_to(latest, self._shape[:2])
        held = np.where(np.isfinite(predicted), predicted, latest)
        return np.clip(held, latest - self._largest, latest + self._largest)

    def _average(self, squared: Array) -> None:
        known = np.isfinite(squared).all(axis=-1, keepdims=True)
        number = known.sum(axis=0)
        mean = np.where(known, squared, 0.0).sum(axis=0) / np.maximum(number, 1)
        before = np.where(np.isfinite(self._squared), self._squared, mean)
        gain = 1 - np.exp(-len(squared) * self._dt / ERROR_SECONDS)
        self._squared = np.where(number > 0, before + gain * (mean - before), self._squared)
