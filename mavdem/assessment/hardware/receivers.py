"""The satellite receiver over a flight: satellites, dilution, accuracy, noise and jamming."""

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.lights.estimator import (
    MAX_DILUTION,
    MIN_SATELLITES,
    flew_without_fix,
)
from mavdem.dataset.hardware_quantities import (
    DILUTION,
    HORIZONTAL_ACCURACY,
    JAMMING,
    NOISE,
    HardwareQuantity,
    recorded_quantity,
)
from mavdem.dataset.position_fix import RECEIVER_MESSAGES, UNKNOWN_SATELLITES
from mavdem.dataset.time_series import recorded_series
from mavdem.facts import Fact, Level
from mavdem.facts.hardware import HardwareFact, ReceiverDoubt
from mavdem.ingest.telemetry import Telemetry

TYPICAL_FRACTION = 0.95
"""Fraction of the flight for which the reported figure is not exceeded, so that single bad samples have no effect."""

MAX_JAMMING = 80.0
"""Jamming indicator from which on "the setup must be inspected"
(https://docs.px4.io/main/en/log/flight_review.html, "GPS Noise & Jamming"); about 40 and less is usual."""

MAX_ACCURACY_PX4 = 3.0
"""Horizontal accuracy, m, that PX4's filter requires before it uses a receiver: the default of EKF2_REQ_EPH."""

MAX_ACCURACY_ARDUPILOT = 5.0
"""Horizontal accuracy, m, that ArduPilot's filter requires before it uses a receiver (AP_NavEKF3_VehicleStatus.cpp)."""


def receiver_fact(evidence: Evidence) -> Fact | None:
    """Returns the fact about the quality of the first satellite receiver's position in flight.

    The level is "watch" if one of these checks fails, and otherwise "good":

    - The median number of satellites, dilution of precision and accuracy must meet the requirements of the autopilot's
      filter.
    - The jamming indicator must stay below the limit of PX4's guide for 95 % of the flight.

    A receiver without a fix is not judged if the estimator did not use it, since the flight had another source of the
    position or needed none: its level is "unknown".

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The fact, with the failed checks as its figure ``doubts``; None if the receiver was not recorded in flight or
        not connected.
    """
    signals = evidence.signals
    satellites = _satellites_in_flight(evidence)
    if satellites is None:
        return None
    dilution = _values_in_flight(evidence, DILUTION)
    accuracy = _values_in_flight(evidence, HORIZONTAL_ACCURACY)
    noise = _values_in_flight(evidence, NOISE)
    jamming = _values_in_flight(evidence, JAMMING)
    failed_checks = []
    if np.median(satellites) < MIN_SATELLITES:
        failed_checks.append(ReceiverDoubt.SATELLITES)
    if dilution.median is not None and dilution.median > MAX_DILUTION:
        failed_checks.append(ReceiverDoubt.DILUTION)
    if accuracy.median is not None and accuracy.median > _accuracy_limit(signals.telemetry):
        failed_checks.append(ReceiverDoubt.ACCURACY)
    if jamming.high is not None and jamming.high >= MAX_JAMMING:
        failed_checks.append(ReceiverDoubt.JAMMING)
    level = Level.WATCH if failed_checks else Level.GOOD
    if flew_without_fix(evidence):
        failed_checks = []
        level = Level.UNKNOWN
    return Fact(
        HardwareFact.RECEIVER_MEASURED,
        level,
        # Few satellites are bad, while large values of the other quantities are. So this is the low quantile.
        satellites=np.quantile(satellites, 1 - TYPICAL_FRACTION),
        satellites_usual=np.median(satellites),
        dilution=dilution.high,
        dilution_usual=dilution.median,
        accuracy=accuracy.high,
        noise=noise.high,
        jamming=jamming.high,
        doubts=failed_checks,
    )


class _ValuesInFlight(NamedTuple):
    """A reported quantity of a receiver over all flights of a log, which is worse the larger it is."""

    median: float | None
    """Median, in the unit of the quantity; None if it was not recorded."""
    high: float | None
    """Value that is not exceeded for ``TYPICAL_FRACTION`` of the flight; None if it was not recorded."""


def _values_in_flight(evidence: Evidence, quantity: HardwareQuantity) -> _ValuesInFlight:
    """Returns the median and the high value of a reported quantity in flight.

    Args:
        evidence: signals, events and measurements of the vehicle.
        quantity: the quantity, such as the dilution of precision.
    """
    values = evidence.values_in_flight(recorded_quantity(evidence.signals, quantity))
    if not len(values):
        return _ValuesInFlight(None, None)
    return _ValuesInFlight(float(np.median(values)), float(np.quantile(values, TYPICAL_FRACTION)))


def _satellites_in_flight(evidence: Evidence) -> Array | None:
    """Returns the numbers of satellites that the first receiver used in flight (N,), without unknown ones.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The number at each sample that reports one; None if no sample does, or the receiver was not connected.
    """
    signals = evidence.signals
    counts = recorded_series(signals.telemetry, RECEIVER_MESSAGES[0], "satellites_visible")
    if counts is not None:
        counts = counts.select(counts.values != UNKNOWN_SATELLITES)
    satellites = evidence.values_in_flight(counts)
    fix_types = evidence.values_in_flight(
        recorded_series(signals.telemetry, RECEIVER_MESSAGES[0], "fix_type")
    )
    has_noise = recorded_quantity(signals, NOISE) is not None
    # Autopilots without a receiver report zero satellites and no fix.
    is_connected = fix_types.any() or satellites.any() or has_noise
    return satellites if len(satellites) and is_connected else None


def _accuracy_limit(telemetry: Telemetry) -> float:
    """Returns the horizontal accuracy, m, that the autopilot's filter requires before it uses a receiver."""
    if telemetry.autopilot == "PX4":
        return telemetry.parameters.get("EKF2_REQ_EPH", MAX_ACCURACY_PX4)
    return MAX_ACCURACY_ARDUPILOT
