"""The satellite receiver over a flight: satellites, dilution, accuracy, noise and jamming."""

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
    failed_checks = []
    if np.median(satellites) < MIN_SATELLITES:
        failed_checks.append(ReceiverDoubt.SATELLITES)
    limits_of_medians = {"dilution": MAX_DILUTION, "accuracy": _accuracy_limit(signals.telemetry)}
    figures: dict[str, float | None] = dict.fromkeys(QUANTITIES)
    dilution_usual = None
    for name, quantity in QUANTITIES.items():
        values = evidence.values_in_flight(recorded_quantity(signals, quantity))
        if not len(values):
            continue
        median = float(np.median(values))
        figures[name] = float(np.quantile(values, TYPICAL_FRACTION))
        if name == "dilution":
            dilution_usual = median
        if name in limits_of_medians and median > limits_of_medians[name]:
            failed_checks.append(ReceiverDoubt(name))
    jamming = figures["jamming"]
    if jamming is not None and jamming >= MAX_JAMMING:
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
        dilution=figures["dilution"],
        dilution_usual=dilution_usual,
        accuracy=figures["accuracy"],
        noise=figures["noise"],
        jamming=jamming,
        doubts=failed_checks,
    )


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


QUANTITIES = {
    "dilution": DILUTION,
    "accuracy": HORIZONTAL_ACCURACY,
    "noise": NOISE,
    "jamming": JAMMING,
}
"""Quantities of a receiver that are worse the larger they are, by the name of the fact's figure."""


def _accuracy_limit(telemetry: Telemetry) -> float:
    """Returns the horizontal accuracy, m, that the autopilot's filter requires before it uses a receiver."""
    if telemetry.autopilot == "PX4":
        return telemetry.parameters.get("EKF2_REQ_EPH", MAX_ACCURACY_PX4)
    return MAX_ACCURACY_ARDUPILOT
