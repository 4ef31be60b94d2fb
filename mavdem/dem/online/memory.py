"""Memory: the latest samples of a stream, in blocks that are remembered and forgotten together."""

from collections import deque
from collections.abc import Iterable
from itertools import islice
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.record import Record


class MemoryBlock(NamedTuple):
    """Consecutive samples (b, r), (b, m), physical; whether a segment begins with them, and the last one's time, s."""

    inputs: Array
    outputs: Array
    starts_segment: bool
    end_time: float


def record_from_blocks(
    blocks: Iterable[MemoryBlock], dt: float, effect_directions: Array | None
) -> Record:
    """Returns the samples of consecutive blocks, of which there is one at least, every ``dt`` seconds."""
    blocks = list(blocks)
    lengths: list[int] = []
    for block in blocks:
        if block.starts_segment or not lengths:
            lengths.append(0)
        lengths[-1] += len(block.outputs)
    inputs = np.concatenate([block.inputs for block in blocks])
    outputs = np.concatenate([block.outputs for block in blocks])
    return Record(inputs, outputs, dt, tuple(lengths), effect_directions)


def drop_blocks_since(blocks: deque[MemoryBlock], time: float) -> bool:
    """Drops the latest blocks that end after ``time``, s, of the same clock; returns whether there were any."""
    latest = np.inf
    # Where time goes back, another boot begins.
    while blocks and time < blocks[-1].end_time < latest:
        latest = blocks.pop().end_time
    return latest < np.inf


class SampleMemory:
    """Samples of several segments with gaps between, in closed ``blocks``; the last block of a segment may be short."""

    def __init__(
        self,
        dt: float,
        block: int,
        most: int,
        effect_directions: Array | None = None,
    ) -> None:
        """Begins empty; keeps at ``most`` this many blocks of ``block`` samples."""
        self.effect_directions = effect_directions
        self.blocks: deque[MemoryBlock] = deque(maxlen=most)
        self.dt = dt
        self.block_size = block
        # since the last gap, the latest first
        self._recent: deque[ArrayPair] = deque(maxlen=most * block)
        self._open = 0  # of these, which no block holds yet
        self._begins = True
        self._time = np.nan

    def add(self, inputs: Array, outputs: Array, time: float) -> bool:
        """Takes the next sample, (r,) and (m,), of a ``time`` in s; returns whether it filled a block."""
        self._recent.appendleft((inputs, outputs))
        self._open += 1
        self._time = time
        if self._open < self.block_size:
            return False
        self._close()
        return True

    def end_segment(self) -> bool:
        """Ends a segment, as a gap follows; returns whether that closed a block."""
        closed = self._open > 0
        if closed:
            self._close()
        self._begins = True
        self._recent.clear()
        return closed

    def record(self) -> Record:
        """Returns the samples of all blocks, of which there is one at least."""
        return record_from_blocks(self.blocks, self.dt, self.effect_directions)

    def latest_samples(self, number: int) -> ArrayPair:
        """Returns inputs and outputs of so many of the latest samples since the last gap, or of fewer."""
        samples = [*islice(self._recent, number)][::-1]
        inputs, outputs = zip(*samples, strict=True) if samples else ((), ())
        return np.array(inputs), np.array(outputs)

    def _close(self) -> None:
        inputs, outputs = self.latest_samples(self._open)
        self.blocks.append(MemoryBlock(inputs, outputs, self._begins, self._time))
        self._open = 0
        self._begins = False
