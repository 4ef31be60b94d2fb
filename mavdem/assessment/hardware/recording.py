"""How evenly the log was recorded in flight: usual step and longest gap of the attitude, and losses of the logger."""

import numpy as np

from mavdem.assessment.evidence import Evidence
from mavdem.assessment.lights.log import MAX_GAP
from mavdem.facts import Fact, Level
from mavdem.facts.hardware import HardwareFact


def recording_fact(evidence: Evidence) -> Fact | None:
    """Returns the fact on how evenly the attitude was recorded in flight; None without two samples in flight.

    It is to be watched where the light on the log would be: a gap above ``MAX_GAP``, or messages that the logger lost.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    attitude = evidence.signals.attitude
    if attitude is None:
        return None
    steps = []
    longest_gap = gap_time = 0.0
    for flight in evidence.in_flight(attitude.angle_series):
        steps_of_flight = np.diff(flight.time)
        if not len(steps_of_flight):
            continue
        steps.append(steps_of_flight)
        longest = int(steps_of_flight.argmax())
        if steps_of_flight[longest] > longest_gap:
            longest_gap, gap_time = float(steps_of_flight[longest]), float(flight.time[longest])
    if not steps:
        return None
    dropouts = evidence.signals.telemetry.dropouts
    has_gaps = longest_gap > MAX_GAP or dropouts > 0
    return Fact(
        HardwareFact.RECORDING_MEASURED,
        Level.WATCH if has_gaps else Level.GOOD,
        time=gap_time,
        step=float(np.median(np.concatenate(steps))),
        longest_gap=longest_gap,
        dropouts=dropouts,
    )
