"""Stamps that lie far off those around them: damaged, or of another clock that found its way between."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Times = NDArray[np.float64]
Rows = NDArray[np.int64]
Places = NDArray[np.integer]
"""Places of messages in the stream, of any integer type."""
Boots = NDArray[np.unsignedinteger]
"""Numbers of boots, in the smallest type that holds them."""

FEWEST = 3
"""Stamps among which a stray can be told."""
STRAY = 5.0
"""Seconds off its neighbours, beside ten usual steps, that make a stamp a stray."""
LASTING = 5
"""Stamps in a row that must all lie below those before, for a reset of the clock; fewer are late arrivals."""
BATCH = 1 << 16
"""Medians made together: bounds the memory they take."""


def far_off(values: Times, window: int, limit: float | Times) -> NDArray[np.bool_]:
    """Which values lie farther than ``limit`` from the median of the ``window`` (odd) values around them.

    The ends are reflected.
    """
    half = window // 2
    # No value is farther from the median than the steps around it add up to: most need no median.
    steps = np.pad(np.abs(np.diff(values)), half, mode="constant")
    around = np.zeros(len(values))
    for ahead in range(2 * half):
        around += steps[ahead : ahead + len(values)]
    doubtful = np.flatnonzero(~(around < 0.99 * np.asarray(limit)))
    far = np.zeros(len(values), dtype=np.bool_)
    if len(doubtful):
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, half, mode="reflect"), window)
        limits = np.broadcast_to(limit, len(values))
        for begin in range(0, len(doubtful), BATCH):
            rows = doubtful[begin : begin + BATCH]
            far[rows] = np.abs(values[rows] - np.median(windows[rows], axis=1)) > limits[rows]
    return far


def strays(seconds: Times) -> NDArray[np.bool_]:
    """Stamps far off the median of the five around them: one or two odd messages, no lasting change of the clock."""
    if len(seconds) < FEWEST:
        return np.zeros(len(seconds), dtype=np.bool_)
    usual = float(np.median(np.abs(np.diff(seconds))))
    return far_off(seconds, 5, STRAY + 10 * usual)


def before_lower(time: Times, boot: Boots) -> NDArray[np.bool_]:
    """Stamps soon followed by one far lower in the same boot: the upper ones of a clock that jumps to and fro."""
    lower = np.zeros(len(time), dtype=np.bool_)
    for ahead in range(1, min(LASTING, len(time))):
        lower[:-ahead] |= (time[:-ahead] - time[ahead:] > STRAY) & (boot[:-ahead] == boot[ahead:])
    return lower


def without(rows: NDArray[np.bool_], *columns: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """The columns without these rows; themselves where there are none, so that nothing is copied."""
    return tuple(column[~rows] for column in columns) if rows.any() else columns
