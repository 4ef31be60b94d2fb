"""The rows of a column by the value they hold, found in one pass however many values there are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def rows_by(values: NDArray[np.integer[Any]]) -> dict[int, NDArray[np.intp]]:
    """The rows of each value in ``values`` (N,), both ascending."""
    order = np.argsort(values, kind="stable")
    found, first = np.unique(values[order], return_index=True)
    return dict(zip(found.tolist(), np.split(order, first)[1:], strict=True))
