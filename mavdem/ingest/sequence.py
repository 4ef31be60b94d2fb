"""Messages that are missing, by the sequence numbers of those around them."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Numbers = TypeVar("Numbers", int, NDArray[np.integer])


def missing_between(before: Numbers, after: Numbers) -> Numbers:
    """How many of one sender's messages are missing between two that came one after the other, 0 to 127.

    The numbers run from 0 to 255 and begin anew. A step back by up to half the range is a late or repeated message.
    """
    gap = (after - before - 1) & 0xFF
    return gap * (gap < 128)
