"""The latest samples of a stream, in blocks, and the second moments of their generalized vectors.

When a new block is full the oldest one is dropped.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.coordinates import embed, taylor_weights
from mavdem.dem.engine.generative import SufficientStatistics
from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.resumable import Resumable
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import CompleteSettings


class MemoryBlock(NamedTuple):
    """Consecutive samples (b, r), (b, m), physical; whether a segment begins with them, and the last one's time, s."""

    inputs: Array
    outputs: Array
    begins: bool
    until: float


def record_of(blocks: Iterable[MemoryBlock], dt: float, effect_directions: Array | None) -> Record:
    """The samples of consecutive blocks, of which there is one at least, every ``dt`` seconds."""
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
    latest, dropped = np.inf, 0
    # Where time goes back, another boot begins.
    while blocks and time < blocks[-1].until < latest:
        latest = blocks.pop().until
        dropped += 1
    return dropped > 0


class Memory:
    """Samples of several segments with gaps between, in closed ``blocks``; the last block of a segment may be short."""

    def __init__(
        self, dt: float, block: int, most: int, inputs: int, outputs: int, effect_directions: Array | None = None
    ) -> None:
        """Begins empty; keeps at ``most`` this many blocks of ``block`` samples of r ``inputs`` and m ``outputs``."""
        self._effect_directions = effect_directions
        self.blocks: deque[MemoryBlock] = deque(maxlen=most)
        self._dt, self._block = dt, block
        # Twice as long as what is kept, so that the latest samples are one slice and rows are rarely moved.
        self._inputs, self._outputs = np.empty((2 * most * block, inputs)), np.empty((2 * most * block, outputs))
        self._end = self._open = self._segment = 0
        self._begins, self._time = True, np.nan

    def add(self, inputs: Array, outputs: Array, time: float) -> bool:
        """Takes the next sample, (r,) and (m,), of a ``time`` in s; returns whether it filled a block."""
        if self._end == len(self._inputs):
            self._move()
        self._inputs[self._end], self._outputs[self._end] = inputs, outputs
        self._end, self._time = self._end + 1, time
        if self._end - self._open < self._block:
            return False
        self._close()
        return True

    def end_segment(self) -> bool:
        """A gap follows; returns whether that closed a block."""
        closed = self._end > self._open
        if closed:
            self._close()
        self._begins, self._segment = True, self._end
        return closed

    def drop_half(self) -> None:
        """Drops the older half of the blocks."""
        for _ in range(len(self.blocks) // 2):
            self.blocks.popleft()

    def drop_since(self, time: float) -> bool:
        """Drops the latest blocks that end after ``time``, s, of the same clock; returns whether there were any."""
        return drop_since(self.blocks, time)

    def record(self) -> Record:
        """The samples of all blocks, of which there is one at least."""
        return record_of(self.blocks, self._dt, self._effect_directions)

    def latest(self, number: int) -> tuple[Array, Array]:
        """Inputs and outputs of so many of the latest samples since the last gap; fewer where there are fewer.

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
        self.blocks.append(MemoryBlock(self._inputs[rows].copy(), self._outputs[rows].copy(), self._begins, self._time))
        self._open, self._begins = self._end, False


class SlidingStatistics:
    """Σ g gᵀ over g = [ỹ; η̃; 1] of the recorded channels, less the first sample of all, in their own units.

    A sample counts in the block in which its window ends; windows across a gap do not count. Blocks are summed anew
    each time: subtracting dropped ones from a running sum would accumulate rounding.
    """

    def __init__(self, memory: Memory, settings: CompleteSettings, dt: float) -> None:
        """Takes the blocks of a ``memory``, complete ``settings`` and the sampling step ``dt``, s."""
        self._orders, self._window, self._dt = (settings.p, settings.d), settings.window, dt
        self._weights = [taylor_weights(order, dt, self._window, self._window // 2) for order in self._orders]
        first = memory.blocks[0]
        self._reference = (first.outputs[0], first.inputs[0])
        self._blocks: deque[tuple[int, Array]] = deque(maxlen=memory.blocks.maxlen)
        self._before = tuple(channel[:0] for channel in (first.outputs, first.inputs))
        self._waiting = deque(memory.blocks)

    def add(self, block: MemoryBlock) -> None:
        """Queues the next block of the memory; it counts after :meth:`catch_up`."""
        self._waiting.append(block)

    def catch_up(self) -> Resumable[None]:
        """Counts the queued blocks, resumably."""
        while self._waiting:
            self._count(self._waiting.popleft())
            yield

    def _count(self, block: MemoryBlock) -> None:
        channels = (block.outputs, block.inputs)
        if not block.begins:
            channels = tuple(np.concatenate(pair) for pair in zip(self._before, channels, strict=True))  # type: ignore[assignment]
        self._before = tuple(channel[max(len(channel) - self._window + 1, 0) :] for channel in channels)
        if len(channels[0]) < self._window:
            self._blocks.append((0, np.zeros((self._size, self._size))))
            return
        tables = [
            embed(channel - reference, order, self._dt, self._window, self._window // 2)
            for channel, reference, order in zip(channels, self._reference, self._orders, strict=True)
        ]
        g = np.hstack([*tables, np.ones((len(tables[0]), 1))])
        self._blocks.append((len(g), g.T @ g))

    def of_window(self, outputs: Array, inputs: Array) -> Array:
        """G of the sample at the centre of a window (window, m), (window, r)."""
        y, v = (
            weights @ (channel - reference)
            for weights, channel, reference in zip(self._weights, (outputs, inputs), self._reference, strict=True)
        )
        return np.concatenate([y.ravel(), v.ravel(), [1.0]])

    def total(self) -> tuple[int, Array]:
        """Number of samples, and Σ g gᵀ over them, of the counted blocks."""
        return sum(count for count, _ in self._blocks), np.sum([gram for _, gram in self._blocks], axis=0)

    def to_engine(self, scaling: Scaling) -> Array:
        """T (dim [ỹ; η̃], dim g) with [ỹ; η̃] = T g in the engine's units."""
        (p, d), (y0, u0) = self._orders, self._reference
        m, r = len(y0), len(u0)
        rows_y, rows_v = (p + 1) * m, (d + 1) * (r + scaling.constant)
        T = np.zeros((rows_y + rows_v, self._size))
        T[:rows_y, :rows_y] = np.diag(np.tile(1 / scaling.output_scale, p + 1))
        T[:m, -1] = (y0 - scaling.output_trim) / scaling.output_scale
        unit = np.where(scaling.known, 1 / scaling.input_scale, 0.0)
        places = rows_y + np.arange(rows_v).reshape(d + 1, -1)
        T[places[:, :r].ravel(), rows_y : rows_y + (d + 1) * r] = np.diag(np.tile(unit, d + 1))
        T[places[0, :r], -1] = (u0 - scaling.input_trim) * unit
        if scaling.constant:
            T[places[0, r], -1] = 1.0
        return T

    @property
    def _size(self) -> int:
        return sum((order + 1) * len(first) for order, first in zip(self._orders, self._reference, strict=True)) + 1


def engine_statistics(total: tuple[int, Array], to_engine: Array) -> SufficientStatistics:
    """Statistics of the engine's [ỹ; η̃] from a ``SlidingStatistics.total`` and the map ``to_engine`` of g."""
    number, gram = total
    return SufficientStatistics(number, to_engine @ gram @ to_engine.T)
