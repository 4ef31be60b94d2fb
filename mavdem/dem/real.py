"""Numbers as they come in: real ones, none of them missing."""

from __future__ import annotations

from typing import TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray


def real_numbers(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """A new array of float64; ``ValueError``, which names the argument, for what is no array of real numbers.

    A mask would be lost and a date would become a count of something, so neither is taken for numbers.
    """
    if np.ma.isMaskedArray(values) and np.ma.is_masked(values):
        raise ValueError(f"{name} must not be masked: fill or leave out what is missing")
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "biufO":
            raise TypeError(f"{array.dtype} are none")
        return np.array(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name} must be real numbers: {error}") from None


def is_number(value: object) -> TypeGuard[float]:
    """Whether it is one real number, of Python's or of numpy's; ``True`` is none."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def is_whole(value: object) -> TypeGuard[int]:
    """Whether it is one whole number, likewise, of 64 bits."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and abs(int(value)) < 2**63
