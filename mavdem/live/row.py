"""What the live path tells: rows of the uniform grid, and sentences about what happened."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Row(NamedTuple):
    """One point of the grid, as a row of the ``Flight`` that ``align`` makes.

    Attributes:
        time: s on the boot clock.
        inputs: (r,) motor outputs in the unit of the stream, or the demand.
        outputs: (2,) angle, rad, and body rate, rad/s.
        segment: number of the segment, from 0 on: within one, rows are one step apart.
        received: UNIX s at which what completed it was received.
        settled: whether the vehicle was in settled flight, as far as is known by then.
    """

    time: float
    inputs: NDArray[np.float64]
    outputs: NDArray[np.float64]
    segment: int
    received: float
    settled: bool


class Event(NamedTuple):
    """Something that happened.

    Attributes:
        received: UNIX s at which what told of it was received.
        sentence: what happened.
    """

    received: float
    sentence: str
