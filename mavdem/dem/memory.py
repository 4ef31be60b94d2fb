"""Memory: the latest samples of a stream, in blocks, of which the oldest is forgotten when a new one is full."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.record import Record

Array = NDArray[np.float64]


class Block(NamedTuple):
    """Consecutive samples: ``inputs`` (b, r) and ``outputs`` (b, m), physical; a segment ``begins`` with it or not."""

    inputs: Array
    outputs: Array
    begins: bool


class Memory:
    """Samples of several segments with gaps between; the last block of a segment may be short.

    Attributes:
        blocks: those that are closed, the oldest first.
    """

    def __init__(self, dt: float, block: int, most: int) -> None:
        """Takes the sampling step ``dt``, s, the samples in a ``block`` and how many blocks there are at ``most``."""
        self.blocks: deque[Block] = deque(maxlen=most)
        self._dt, self._block = dt, block
        self._inputs: list[Array] = []
        self._outputs: list[Array] = []
        self._begins = True

    def add(self, inputs: Array, outputs: Array) -> bool:
        """Takes the next sample, (r,) and (m,); answers whether it filled a block."""
        self._inputs.append(inputs)
        self._outputs.append(outputs)
        if len(self._outputs) < self._block:
            return False
        self._close()
        return True

    def forget_half(self) -> None:
        """Forgets the older half of the blocks."""
        for _ in range(len(self.blocks) // 2):
            self.blocks.popleft()

    def part(self) -> bool:
        """Says that a gap follows; answers whether that closed a block."""
        closed = bool(self._outputs)
        if closed:
            self._close()
        self._begins = True
        return closed

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
        """Inputs and outputs of so many of the latest samples since the last gap; fewer where there are fewer."""
        inputs, outputs = [*self._inputs[::-1]], [*self._outputs[::-1]]
        begun = self._begins
        for block in reversed(self.blocks):
            if begun or len(outputs) >= number:
                break
            inputs += [*block.inputs[::-1]]
            outputs += [*block.outputs[::-1]]
            begun = block.begins
        return np.array(inputs[:number][::-1]), np.array(outputs[:number][::-1])

    def _close(self) -> None:
        self.blocks.append(Block(np.array(self._inputs), np.array(self._outputs), self._begins))
        self._inputs.clear()
        self._outputs.clear()
        self._begins = False
