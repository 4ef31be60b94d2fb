"""How evenly a log was recorded in flight, as a fact (a coded finding): usual step, longest gap, losses."""

import numpy as np

from mavdem.assessment.evidence import Evidence
from mavdem.assessment.lights.log import MAX_GAP
from mavdem.dataset.attitude import TUNING_MESSAGE
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.hardware import HardwareFact
from mavdem.facts.sources import Repair


def recording_fact(evidence: Evidence) -> Fact | None:
    """Returns the fact about how evenly the attitude was recorded in flight.

    As for the status light "log", the level is "watch" after a gap above ``MAX_GAP``, or if the logger lost messages.
    Otherwise it is "good".

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The fact, with the usual step, s, and the longest gap, s, and when that began; None without two samples in
        flight.
    """
    attitude = evidence.signals.attitude
    if attitude is None:
        return None
    steps_by_flight = []
    longest_gap = 0.0
    gap_start = 0.0
    for flight in evidence.in_flight(attitude.angle_series):
        steps = np.diff(flight.time)
        if not len(steps):
            continue
        steps_by_flight.append(steps)
        index_of_longest = int(steps.argmax())
        if steps[index_of_longest] > longest_gap:
            longest_gap = float(steps[index_of_longest])
            gap_start = float(flight.time[index_of_longest])
    if not steps_by_flight:
        return None
    usual_step = float(np.median(np.concatenate(steps_by_flight)))
    # Number of messages that the logger reports as lost.
    dropouts = evidence.signals.telemetry.dropouts
    has_gaps = longest_gap > MAX_GAP or dropouts > 0
    return Fact(
        HardwareFact.RECORDING_MEASURED,
        Level.WATCH if has_gaps else Level.GOOD,
        time=gap_start,
        step=usual_step,
        longest_gap=longest_gap,
        dropouts=dropouts,
        body_rates=is_attitude_resampled(evidence.signals),
    )


def is_attitude_resampled(signals: Signals) -> bool:
    """Returns whether the attitude that models use was resampled to the times of the body rates, logged more often.

    Then its angles were interpolated between the logged ones (PX4), or integrated from rates (ArduPilot's PID_TUNING).

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
    """
    attitude = signals.attitude
    if attitude is not None and attitude.message == TUNING_MESSAGE:
        return True
    repairs = signals.telemetry.repairs
    return any(repair.code is Repair.ATTITUDE_INTERPOLATED for repair in repairs)
