"""Windows of so many samples of all segments, compressed: what subspace identification computes with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from mavdem.baselines.regression import triangle
from mavdem.baselines.units import Segments

Array = NDArray[np.float64]


class Windows(NamedTuple):
    """All windows of ``past`` + ``future`` samples in rows that are fewer and have the same inner products.

    So whatever is regressed and projected here comes out as from the windows themselves, whose number enters once, in
    one QR decomposition. Sample 0 of a window is its oldest, sample ``past`` the first of its future.
    """

    constant: Array  # (rows, 1) what is 1 in each window
    samples: Array  # (rows, past + future, k + m): inputs, then outputs
    past: int
    k: int  # inputs
    number: int

    @classmethod
    def of(cls, segments: Segments, past: int, future: int) -> Windows:
        """Of the inputs (T, k) and outputs (T, m) of each segment; no window reaches across a gap."""
        (inputs, outputs), length = segments[0], past + future
        width = inputs.shape[1] + outputs.shape[1]
        windows = [
            sliding_window_view(np.hstack(segment), length, axis=0).swapaxes(1, 2)
            for segment in segments
            if len(segment[0]) >= length
        ]
        stacked = np.concatenate([np.empty((0, length, width)), *windows])
        flat = stacked.reshape(len(stacked), length * width)
        rows = triangle(np.hstack([np.ones((len(flat), 1)), flat]))
        return cls(rows[:, :1], rows[:, 1:].reshape(len(rows), length, width), past, inputs.shape[1], len(flat))

    def inputs(self, first: int, last: int) -> Array:
        """(rows, ·) of the samples ``first`` to ``last`` − 1, one sample after the other."""
        return self._columns(self.samples[:, first:last, : self.k])

    def outputs(self, first: int, last: int) -> Array:
        """The same of the outputs."""
        return self._columns(self.samples[:, first:last, self.k :])

    def both(self, first: int, last: int) -> Array:
        """The same of inputs and outputs."""
        return self._columns(self.samples[:, first:last])

    @staticmethod
    def _columns(part: Array) -> Array:
        return part.reshape(len(part), -1)
