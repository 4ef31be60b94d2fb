"""Memory: the latest samples of a stream, in blocks, of which the oldest is forgotten when a new one is full."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.record import Record

Array = NDArray[np.float64]


class Block(NamedTuple):
    """Consecutive samples.

    Attributes:
        inputs, outputs: (b, r), (b, m), physical.
        begins: whether a segment begins with it.
        until: time of its last sample, s.
    """

    inputs: Array
    outputs: Array
    begins: bool
    until: float


class Memory:
    """Samples of several segments with gaps between; the last block of a segment may be short.

    Attributes:
        blocks: those that are closed, the oldest first.
    """

    def __init__(self, dt: float, block: int, most: int, inputs: int, outputs: int) -> None:
        """Begins empty.

        Args:
            dt: sampling step, s.
            block: samples in a block.
            most: blocks that are kept.
            inputs, outputs: r and m.
        """
        self.blocks: deque[Block] = deque(maxlen=most)
        self._dt, self._block = dt, block
        # A table of twice what is kept, so that rows need not be moved each time: the latest samples are one slice.
        self._inputs, self._outputs = np.empty((2 * most * block, inputs)), np.empty((2 * most * block, outputs))
        self._end = self._open = self._segment = 0
        self._begins, self._time = True, np.nan

    def add(self, inputs: Array, outputs: Array, time: float) -> bool:
        """Takes the next sample, (r,) and (m,), of a ``time`` in s; answers whether it filled a block."""
        if self._end == len(self._inputs):
            self._move()
        self._inputs[self._end], self._outputs[self._end] = inputs, outputs
        self._end, self._time = self._end + 1, time
        if self._end - self._open < self._block:
            return False
        self._close()
        return True

    def part(self) -> bool:
        """Says that a gap follows; answers whether that closed a block."""
        closed = self._end > self._open
        if closed:
            self._close()
        self._begins, self._segment = True, self._end
        return closed

    def forget_half(self) -> None:
        """Forgets the older half of the blocks."""
        for _ in range(len(self.blocks) // 2):
            self.blocks.popleft()

    def record(self) -> Record:
        """The samples of all blocks, of which there is one at least."""
        lengths: list[int] = []
        for block in self.blocks:
            if block.begins or not lengths:
                lengths.append(0)
            lengths[-1] += len(block.outputs)
        inputs = np.concatenate([block.inputs for block in self.blocks])
        outputs = np.concatenate([block.outputs for block in self.blocks])
        return Record(inputs, outputs, self._dt, tuple(lengths))

    def latest(self, number: int) -> tuple[Array, Array]:
        """Inputs and outputs of so many of the latest samples since the last gap; fewer where there are fewer.

        They are good until the next sample is taken.
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
        self.blocks.append(Block(self._inputs[rows].copy(), self._outputs[rows].copy(), self._begins, self._time))
        self._open, self._begins = self._end, False
