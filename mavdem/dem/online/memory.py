"""Memory: the latest samples of a stream, in blocks that are remembered and forgotten together."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.dem.record import Record


class MemoryBlock(NamedTuple):
    """Consecutive samples (b, r), (b, m), physical; whether a segment begins with them, and the last one's time, s."""

    inputs: Array
    outputs: Array
    begins: bool
    until: float


def record_of(blocks: Iterable[MemoryBlock], dt: float, effect_directions: Array | None) -> Record:
    """Returns the samples of consecutive blocks, of which there is one at least, every ``dt`` seconds."""
    blocks = list(blocks)
    lengths: list[int] = []
    for block in blocks:
        if block.begins or not lengths:
            lengths.append(0)
        lengths[-1] += len(block.outputs)
    inputs = np.concatenate([block.inputs for block in blocks])
    outputs = np.concatenate([block.outputs for block in blocks])
    return Record(inputs, outputs, dt, tuple(lengths), effect_directions)


def drop_since(blocks: deque[MemoryBlock], time: float) -> bool:
    """Drops the latest blocks that end after ``time``, s, of the same clock; returns whether there were any."""
    latest = np.inf
    dropped = 0
    # Where time goes back, another boot begins.
    while blocks and time < blocks[-1].until < latest:
        latest = blocks.pop().until
        dropped += 1
    return dropped > 0


class Memory:
    """Samples of several segments with gaps between, in closed ``blocks``; the last block of a segment may be short."""

    def __init__(
        self,
        dt: float,
        block: int,
        most: int,
        inputs: int,
        outputs: int,
        effect_directions: Array | None = None,
    ) -> None:
        """Begins empty; keeps at ``most`` this many blocks of ``block`` samples of r ``inputs`` and m ``outputs``."""
        self.effect_directions = effect_directions
        self.blocks: deque[MemoryBlock] = deque(maxlen=most)
        self.dt = dt
        self.block = block
        # Twice as long as what is kept, so that the latest samples are one slice and rows are rarely moved.
        self._inputs, self._outputs = (
            np.empty((2 * most * block, inputs)),
            np.empty((2 * most * block, outputs)),
        )
        self._end = self._open = self._segment = 0
        self._begins = True
        self._time = np.nan

    def add(self, inputs: Array, outputs: Array, time: float) -> bool:
        """Takes the next sample, (r,) and (m,), of a ``time`` in s; returns whether it filled a block."""
        if self._end == len(self._inputs):
            self._move()
        self._inputs[self._end] = inputs
        self._outputs[self._end] = outputs
        self._end = self._end + 1
        self._time = time
        if self._end - self._open < self.block:
            return False
        self._close()
        return True

    def end_segment(self) -> bool:
        """A gap follows; returns whether that closed a block."""
        closed = self._end > self._open
        if closed:
            self._close()
        self._begins = True
        self._segment = self._end
        return closed

    def record(self) -> Record:
        """Returns the samples of all blocks, of which there is one at least."""
        return record_of(self.blocks, self.dt, self.effect_directions)

    def latest(self, number: int) -> tuple[Array, Array]:
        """Returns inputs and outputs of so many of the latest samples since the last gap; fewer where there are fewer.

        They are valid until the next sample is added.
        """
        latest = slice(max(self._segment, self._end - number), self._end)
        return self._inputs[latest], self._outputs[latest]

    def _move(self) -> None:
        kept = len(self._inputs) // 2
        for table in (self._inputs, self._outputs):
            table[:kept] = table[self._end - kept : self._end]
        by = self._end - kept
        self._end, self._open, self._segment = kept, self._open - by, max(self._segment - by, 0)

    def _close(self) -> None:
        rows = slice(self._open, self._end)
        self.blocks.append(
            MemoryBlock(
                self._inputs[rows].copy(), self._outputs[rows].copy(), self._begins, self._time
            )
        )
        self._open = self._end
        self._begins = False
