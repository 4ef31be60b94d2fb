"""Second moments of the generalized samples in a memory, in the vehicle's units, kept block by block.

They are summed over the blocks anew whenever they are asked for: taking forgotten samples off a running sum would leave
their rounding behind, and at last nothing else.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.coordinates import embed, taylor_weights
from mavdem.dem.generative import Samples
from mavdem.dem.memory import Block, Memory
from mavdem.dem.parts import Parts
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import Settings

Array = NDArray[np.float64]


class SlidingMoments:
    """Σ g gᵀ over g = [ỹ; η̃; 1] of the recorded channels, less the first sample of all, in their own units.

    A sample counts in the block in which its window ends; those that reach across a gap do not count.
    """

    def __init__(self, memory: Memory, settings: Settings, dt: float) -> None:
        """Takes complete ``settings``, and the blocks that a ``memory`` holds; further ones by :meth:`add`."""
        assert settings.window is not None and settings.d is not None
        self._orders, self._window, self._dt = (settings.p, settings.d), settings.window, dt
        self._weights = [taylor_weights(order, dt, self._window, self._window // 2) for order in self._orders]
        first = memory.blocks[0]
        self._reference = (first.outputs[0], first.inputs[0])
        self._blocks: deque[tuple[int, Array]] = deque(maxlen=memory.blocks.maxlen)
        self._before = tuple(channel[:0] for channel in (first.outputs, first.inputs))
        self._waiting = deque(memory.blocks)

    def add(self, block: Block) -> None:
        """Takes the next block of the memory; it counts once :meth:`catch_up` has come to it."""
        self._waiting.append(block)

    def catch_up(self) -> Parts[None]:
        """Counts what waits, in parts."""
        while self._waiting:
            self._count(self._waiting.popleft())
            yield

    def _count(self, block: Block) -> None:
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
        """How many samples count, and Σ g gᵀ over them, of the blocks that were counted."""
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


def in_engine(total: tuple[int, Array], to_engine: Array) -> Samples:
    """The moments of the engine's [ỹ; η̃], of a ``SlidingMoments.total`` and the map ``to_engine`` from g."""
    number, gram = total
    return Samples(number, to_engine @ gram @ to_engine.T)
