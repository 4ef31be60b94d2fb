"""What a live view is told: of the vehicle once, of each sample, and of how the link fares."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem import Estimate, Learned

Array = NDArray[np.float64]


class Channels(NamedTuple):
    """What the numbers of a live flight are.

    Attributes:
        title: of the recording: vehicle and link.
        dt: sampling step, s.
        horizons: the learner's, in steps.
        input_names, output_names, input_units, output_units: as of a ``Flight``.
    """

    title: str
    dt: float
    horizons: tuple[int, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]


class Row(NamedTuple):
    """A sample and what was made of it.

    Attributes:
        time: as shown, s.
        shift: shown time less boot clock, s.
        segment: a number that changes where samples are missing or the vehicle rebooted.
        outputs, inputs: (m,) and (r,).
        estimate: of this sample; ``None`` where there is no learner.
        learned: the learner's last whole learning.
        channels: what outputs and inputs are.
    """

    time: float
    shift: float
    segment: int
    outputs: Array
    inputs: Array
    estimate: Estimate | None
    learned: Learned | None
    channels: Channels


class LogLine(NamedTuple):
    """A line of the log.

    Attributes:
        time: as shown, s.
        level: "INFO", "WARN" or "ERROR".
        text: one sentence.
    """

    time: float
    level: str
    text: str


class Status(NamedTuple):
    """How the link fares and why there is no model, as of now.

    Attributes:
        rates: messages a second, by name of the message.
        lost: frames that the link lost so far.
        latency: seconds from a sample to its row.
        samples: rows so far.
        obstacle: the learner's; empty when all is well.
    """

    rates: dict[str, float] = {}
    lost: int = 0
    latency: float = float("nan")
    samples: int = 0
    obstacle: str = ""
