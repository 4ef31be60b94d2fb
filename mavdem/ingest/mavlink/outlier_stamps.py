"""Stamps far from those around them: damaged, or of another clock."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

Times = NDArray[np.float64]
Rows = NDArray[np.int64]
Places = NDArray[np.integer]  # Places of messages in the stream, of any integer type
Boots = NDArray[np.unsignedinteger]  # Numbers of boots, in the smallest type that holds them
MAX_OFFSET = 5.0  # Seconds from its neighbours, plus ten median steps, beyond which a stamp is an outlier
MIN_RESET_STAMPS = 5
"""Stamps in a row that are all lower than those before after a reset of the clock; fewer are late arrivals."""


def far_off(values: Times, window: int, limit: float | Times) -> NDArray[np.bool_]:
    """Which values are farther than ``limit`` from the median of the ``window`` (odd) values around them.

    The ends are reflected.
    """
    if not len(values):
        return np.zeros(0, dtype=np.bool_)
    half = window // 2
    medians = median_filter(np.pad(values, half, mode="reflect"), window)[half : half + len(values)]
    return np.asarray(np.abs(values - medians) > limit)


def outliers(seconds: Times) -> NDArray[np.bool_]:
    """Stamps far from the median of the five around them: one or two messages, not a lasting change of the clock."""
    if len(seconds) < 3:
        return np.zeros(len(seconds), dtype=np.bool_)
    step = float(np.median(np.abs(np.diff(seconds))))
    return far_off(seconds, 5, MAX_OFFSET + 10 * step)


def before_lower(time: Times, boot: Boots) -> NDArray[np.bool_]:
    """Stamps soon followed by a much lower one in the same boot: the upper ones of a clock that jumps up and down."""
    lower = np.zeros(len(time), dtype=np.bool_)
    for ahead in range(1, min(MIN_RESET_STAMPS, len(time))):
        lower[:-ahead] |= (time[:-ahead] - time[ahead:] > MAX_OFFSET) & (boot[:-ahead] == boot[ahead:])
    return lower


def without(rows: NDArray[np.bool_], *columns: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """The columns without these rows; not copied where there are none."""
    return tuple(column[~rows] for column in columns) if rows.any() else columns
