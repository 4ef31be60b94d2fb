"""The input of a live view: channels, rows and log lines."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem import Estimate, Learned

Array = NDArray[np.float64]


class Channels(NamedTuple):
    """The channels of a live flight.

    Attributes:
        title: of the recording: vehicle and link.
        dt: sampling step, s.
        horizons: the learner's, in steps.
        input_names, output_names, input_units, output_units: as of a ``Flight``.
        command: weights of the inputs in the command of the axis; empty where they are not known.
    """

    title: str
    dt: float
    horizons: tuple[int, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]
    command: tuple[float, ...] = ()


class ViewRow(NamedTuple):
    """A sample and its estimate."""

    time: float  # on the timeline, s
    shift: float  # timeline minus boot clock, s
    segment: int  # changes where samples are missing or the vehicle rebooted
    outputs: Array  # (m,)
    inputs: Array  # (r,)
    estimate: Estimate | None  # of this sample; ``None`` without a learner
    learned: Learned | None  # the learner's last batch result
    channels: Channels  # of outputs and inputs


class LogLine(NamedTuple):
    """A sentence ``text`` at a ``time`` on the timeline, s, with a ``level``: "INFO", "WARN" or "ERROR"."""

    time: float
    level: str
    text: str
