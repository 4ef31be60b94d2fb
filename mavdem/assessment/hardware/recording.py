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

    As for the light "log", the level is "watch" after a gap above ``MAX_GAP``, or if the logger lost messages.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The fact; None without two samples in flight.
    """
    attitude = evidence.signals.attitude
    if attitude is None:
        return None
    steps = []
    longest_gap = 0.0
    gap_start = 0.0
    for flight in evidence.in_flight(attitude.angle_series):
        steps_of_flight = np.diff(flight.time)
        if not len(steps_of_flight):
            continue
        steps.append(steps_of_flight)
        longest_step = int(steps_of_flight.argmax())
        if steps_of_flight[longest_step] > longest_gap:
            longest_gap = float(steps_of_flight[longest_step])
            gap_start = float(flight.time[longest_step])
    if not steps:
        return None
    dropouts = evidence.signals.telemetry.dropouts
    has_gaps = longest_gap > MAX_GAP or dropouts > 0
    return Fact(
        HardwareFact.RECORDING_MEASURED,
        Level.WATCH if has_gaps else Level.GOOD,
        time=gap_start,
        step=float(np.median(np.concatenate(steps))),
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
