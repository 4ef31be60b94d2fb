"""The light of the log: how fast and whole it shows the motion, what to set for more, and whether it is simulated."""

from __future__ import annotations

import numpy as np

from mavdem.alignment.drive import Signal
from mavdem.alignment.rate_advice import ask_for_rate
from mavdem.alignment.signals import MINIMUM_RATE, usual_rate
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.flown import flown
from mavdem.facts import Fact, Level
from mavdem.facts.log import LogLight, Simulation

LONG_GAP = 1.0  # s without attitude: longer than a fall from 5 m
SIMULATORS_MESSAGES = {"SIMSTATE", "SIM_STATE", "HIL_STATE", "HIL_STATE_QUATERNION"}
"""What simulators send of the true state."""
SIMULATED_BOARD = "SITL"


def log_light(evidence: Evidence) -> Fact:
    """Returns the rates of attitude and of what drives it, its longest gap in flight, and what would show more."""
    signals = evidence.signals
    attitude = signals.attitude
    drive = signals.drive
    if attitude is None or drive is None:
        return Fact(LogLight.MOTION_NOT_RECORDED, because=evidence.verdict.reason)
    rates = usual_rate(attitude), usual_rate(drive)
    stamps = Signal(attitude.time, attitude.boot, attitude.angle)
    gaps = [np.diff(part.time).max(initial=0.0) for part in flown(evidence, stamps)]
    longest = max(gaps, default=0.0)
    telemetry = signals.telemetry
    code = LogLight.RECORDED_FAST
    if min(rates) < MINIMUM_RATE:
        code = LogLight.RECORDED_SLOWLY
    elif longest > LONG_GAP or telemetry.dropouts:
        code = LogLight.RECORDED_WITH_GAPS
    return Fact(
        code,
        Level.GOOD if code is LogLight.RECORDED_FAST else Level.WATCH,
        attitude_rate=rates[0],
        motor_rate=rates[1],
        longest_gap=longest,
        dropouts=telemetry.dropouts,
        needed_rate=MINIMUM_RATE,
        remedy=ask_for_rate(telemetry, components=evidence.log.components),
    )


def simulated_of(evidence: Evidence) -> Fact | None:
    """Returns that the flight was simulated; None where nothing in the log shows it."""
    telemetry = evidence.signals.telemetry
    parameters = telemetry.parameters
    if parameters.get("SYS_HITL", 0) > 0:
        return Fact(LogLight.SIMULATED, Level.GOOD, kind=Simulation.HARDWARE)
    by_software = (
        any(name.startswith("SIM_") for name in parameters)
        or SIMULATED_BOARD in telemetry.hardware.upper()
        or not SIMULATORS_MESSAGES.isdisjoint(telemetry.messages)
    )
    return Fact(LogLight.SIMULATED, Level.GOOD, kind=Simulation.SOFTWARE) if by_software else None
