"""A whole simulated flight as the stream a ground station would have recorded."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mavdem.ingest.mavlink.vehicles import FrameStream
from sitl_scenarios.mavlink.batch import joined
from sitl_scenarios.mavlink.link import LossyLink
from sitl_scenarios.mavlink.transmitter import Transmitter, rows_of_motion
from sitl_scenarios.motion import Motion
from sitl_scenarios.scenario import Scenario

EPOCH = 1_767_225_600
"""UNIX seconds of the first boot, 1 January 2026, 0:00 UTC: the same for every flight, so that files are too."""
BLOCK = 1 << 14  # Cycles whose frames are made together


def recorded(scenario: Scenario, motion: Motion, cycle: float, progress: Callable[[float], None]) -> FrameStream:
    """The frames of a flight from boot to end that arrive, stamped with the time they do.

    ``cycle`` is of the autopilot's loop, s; ``progress`` is called with the fraction done. Raises ValueError: as
    ``Transmitter``.
    """
    transmitter, link = Transmitter(scenario, cycle), LossyLink(scenario.faults, scenario.seed)
    received = []
    for begin in range(0, len(motion), BLOCK):
        received.append(link.pass_on(transmitter.send(rows_of_motion(motion, slice(begin, begin + BLOCK)))))
        progress(min(begin + BLOCK, len(motion)) / len(motion))
    whole = joined([*received, *link.rest()])
    stamps = EPOCH * 1_000_000 + np.round(whole.time * 1e6)
    return FrameStream("simulation", "simulation", whole.data, whole.frames, stamps.astype(np.uint64), 0, ())
