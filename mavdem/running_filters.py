"""Running medians and extremes along the first axis of an array.

SciPy's filters do the same in less time for each value, but importing them takes 0.2 s of processor, more than reading
a whole log at the rates of telemetry. So NumPy filters series that are short, and SciPy those that are long.
"""

from typing import Literal

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from mavdem.arrays import Array

Edge = Literal["mirror", "nearest", "reflect"]
"""How values continue beyond an end, in SciPy's words, for the series "a b c": "mirror" is "c b | a b c | b a",
"nearest" is "a a | a b c | c c", and "reflect" is "b a | a b c | c b"."""

NUMPY_MODES: dict[Edge, Literal["reflect", "edge", "symmetric"]] = {
    "mirror": "reflect",
    "nearest": "edge",
    "reflect": "symmetric",
}
"""NumPy's words for the same continuations, as ``numpy.pad`` takes them."""

MAX_NUMPY_VALUES = 300_000
"""Number of values in all windows together up to which NumPy filters: it takes 40 ns for each, so 0.01 s at most."""


def running_median(values: Array, window: int, edge: Edge) -> Array:
    """Returns the median of the values around each one.

    Args:
        values: values (N, ...), none of them NaN.
        window: number of values in each window, odd.
        edge: how the values continue beyond both ends.

    Returns:
        Medians, in the shape of the values.
    """
    if values.size * window > MAX_NUMPY_VALUES:
        size = (window,) + (1,) * (values.ndim - 1)
        return np.asarray(scipy.ndimage.median_filter(values, size=size, mode=edge))
    middle = window // 2
    windows = _windows(values, middle, middle, edge)
    return np.asarray(np.partition(windows, middle, axis=-1)[..., middle])


def running_maximum(values: Array, before: int, after: int) -> Array:
    """Returns the highest value around each one; windows are shorter at the ends.

    Args:
        values: values (N, ...), none of them NaN.
        before: number of values in front of each one that its window has.
        after: number of values behind each one that its window has.

    Returns:
        Highest values, in the shape of the values.
    """
    window = before + 1 + after
    if values.size * window > MAX_NUMPY_VALUES:
        # SciPy's windows lie around each value; the origin moves them.
        origin = before - window // 2
        return np.asarray(
            scipy.ndimage.maximum_filter1d(values, window, axis=0, origin=origin, mode="nearest")
        )
    # Repeating the outermost value adds no value to the windows at the ends, which have it already.
    return np.asarray(_windows(values, before, after, "nearest").max(axis=-1))


def running_minimum(values: Array, before: int, after: int) -> Array:
    """Returns the lowest value around each one, as ``running_maximum`` does the highest."""
    return -running_maximum(-values, before, after)


def _windows(values: Array, before: int, after: int, edge: Edge) -> Array:
    """Returns a view of the values around each one (N, ..., before + 1 + after), with values beyond both ends."""
    if not len(values):
        return np.zeros((*values.shape, before + 1 + after), values.dtype)
    padding = [(before, after)] + [(0, 0)] * (values.ndim - 1)
    padded = np.pad(values, padding, mode=NUMPY_MODES[edge])
    return sliding_window_view(padded, before + 1 + after, axis=0)
