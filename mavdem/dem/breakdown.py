"""A calculation that leaves the range of numbers has broken down, like one whose matrix is not positive definite."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


@contextmanager
def breaking_down() -> Iterator[None]:
    """Raises ``numpy.linalg.LinAlgError`` instead of going on with what overflowed, or is no number."""
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            yield
    except FloatingPointError as error:
        raise np.linalg.LinAlgError(f"numbers beyond all bounds: {error}") from None
