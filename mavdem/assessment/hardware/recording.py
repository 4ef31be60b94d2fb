"""How evenly a log was recorded in flight, as a fact (a coded finding): usual step, longest gaps, losses."""

from typing import NamedTuple

import numpy as np

from mavdem.assessment.evidence import Evidence
from mavdem.assessment.lights.log import MAX_GAP
from mavdem.dataset.attitude import TUNING_MESSAGE
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Level
from mavdem.facts.hardware import HardwareFact
from mavdem.facts.sources import Repair
from mavdem.witnesses.sensors import barometer_altitude

MIN_GAP_RATIO = 2.0
"""A gap over the usual step of its messages from which on one of them is missing, and not only late."""


class _StepsInFlight(NamedTuple):
    """The time between the samples of a stream in flight."""

    usual: float
    """The median, s."""
    longest: float
    """The longest, s."""
    longest_start: float
    """When that began, s since boot."""

    @property
    def has_long_gap(self) -> bool:
        """Whether samples are missing for longer than ``MAX_GAP``."""
        return self.longest > max(MAX_GAP, MIN_GAP_RATIO * self.usual)


def recording_fact(evidence: Evidence) -> Fact | None:
    """Returns the fact about how evenly attitude and barometer were recorded in flight.

    The level is "watch" after a gap above ``MAX_GAP``, or if the logger lost messages. Otherwise it is "good". The
    barometer counts beside the attitude because a loaded logger or link loses the messages of some sensors first, and
    heights and climbs rest on it.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The fact, with the usual step of the attitude, s, its longest gap, s, and when that began, and the longest gap
        of the barometer, s, if that is long; None without two samples of the attitude in flight.
    """
    attitude = evidence.signals.attitude
    if attitude is None:
        return None
    attitude_steps = _steps_in_flight(evidence, attitude.angle_series)
    if attitude_steps is None:
        return None
    barometer_gap = None
    barometer_steps = _steps_in_flight(evidence, barometer_altitude(evidence.signals))
    if barometer_steps is not None and barometer_steps.has_long_gap:
        barometer_gap = barometer_steps.longest
    # Number of messages that the logger reports as lost.
    dropouts = evidence.signals.telemetry.dropouts
    has_gaps = attitude_steps.longest > MAX_GAP or barometer_gap is not None or dropouts > 0
    return Fact(
        HardwareFact.RECORDING_MEASURED,
        Level.WATCH if has_gaps else Level.GOOD,
        time=attitude_steps.longest_start,
        step=attitude_steps.usual,
        longest_gap=attitude_steps.longest,
        barometer_gap=barometer_gap,
        dropouts=dropouts,
        body_rates=is_attitude_resampled(evidence.signals),
    )


def _steps_in_flight(evidence: Evidence, series: TimeSeries | None) -> _StepsInFlight | None:
    """Returns the time between the samples of a stream in flight; None without two samples in one flight.

    Args:
        evidence: the flights of the vehicle.
        series: samples of the stream; None if it was not recorded.
    """
    steps_by_flight = []
    longest_gap = 0.0
    gap_start = 0.0
    for flight in evidence.in_flight(series):
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
    return _StepsInFlight(usual_step, longest_gap, gap_start)


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
