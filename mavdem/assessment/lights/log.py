"""The light of the log: how fast and whole it shows the motion, what to set for more, and whether it is simulated."""

from math import inf

import numpy as np

from mavdem.assessment.evidence import Evidence
from mavdem.confidence import MIN_SAMPLES_FOR_STATISTICS
from mavdem.dataset import phases
from mavdem.dataset.rate_advice import rate_advice
from mavdem.dataset.signals import MIN_STREAM_RATE, Signals, rate_between_outages
from mavdem.facts import Fact
from mavdem.facts.log import LogLight, Simulator

LONG_GAP = 1.0  # s without attitude: longer than a fall from 5 m
SIH_AIRFRAMES = range(
    10040, 10050
)  # of PX4's own simulator: ROMFS/px4fmu_common/init.d-posix/airframes
STILL_CHANGE = 5e-5
"""rad/s: median change of the roll rate over ``STILL_STEP`` on the ground, below which no gyroscope measured it. One of
0.003°/s/√Hz, low-passed at 10 Hz, has 1.5e-4; ArduPilot's simulator 2e-5 to 4e-5, recorded real ones 3e-4 and more."""
STILL_STEP = 0.02  # s


def log_light(evidence: Evidence) -> Fact:
    """Returns the rates of attitude and of what drives it, its longest gap in flight, and what would show more."""
    signals = evidence.signals
    attitude = signals.attitude
    drive = signals.model_inputs
    if attitude is None or drive is None:
        return Fact(LogLight.MOTION_NOT_RECORDED, because=evidence.learnability.reason)
    rates = rate_between_outages(attitude), rate_between_outages(drive)
    gaps = [np.diff(part.time).max(initial=0.0) for part in evidence.flown(attitude.angle_series)]
    longest = max(gaps, default=0.0)
    telemetry = signals.telemetry
    code = LogLight.RECORDED_FAST
    if min(rates) < MIN_STREAM_RATE:
        code = LogLight.RECORDED_SLOWLY
    elif longest > LONG_GAP or telemetry.dropouts:
        code = LogLight.RECORDED_WITH_GAPS
    return Fact(
        code,
        attitude_rate=rates[0],
        motor_rate=rates[1],
        longest_gap=longest,
        dropouts=telemetry.dropouts,
        needed_rate=MIN_STREAM_RATE,
        remedy=rate_advice(telemetry, components=evidence.log.components),
    )


def simulated_of(evidence: Evidence) -> Fact | None:
    """Returns that the flight was simulated; None where nothing in the log shows it."""
    telemetry = evidence.signals.telemetry
    parameters = telemetry.parameters
    kind = None
    if parameters.get("SYS_HITL", 0) > 0:
        kind = Simulator.HARDWARE
    elif (
        any(name.startswith("SIM_") for name in parameters)
        or parameters.get("SYS_AUTOSTART") in SIH_AIRFRAMES
        # the bus of PX4's simulated sensors: src/lib/drivers/device/Device.hpp
        or parameters.get("CAL_GYRO0_ID", 0) % 8 == 4
        or "SITL" in telemetry.hardware
        or _is_still(evidence.signals)
    ):
        kind = Simulator.SOFTWARE
    return Fact(LogLight.SIMULATED, kind=kind) if kind else None


def _is_still(signals: Signals) -> bool:
    """Whether the vehicle stands before it is armed as still as no gyroscope measures."""
    if not signals.tilts:
        return False
    roll = signals.tilts[0]
    boot = int(roll.boot[0]) if len(roll.boot) else 0
    armed = min((start for start, _ in phases.armed_intervals(signals, boot)), default=inf)
    rows = np.flatnonzero((roll.boot == boot) & (roll.time < armed))
    if len(rows) < 2:
        return False
    each = max(round(STILL_STEP / np.median(np.diff(roll.time[rows]))), 1)
    changes = abs(np.diff(roll.rate[rows][::each]))
    changes = changes[changes > 0]  # a value that is sent again is no measurement
    return len(changes) >= MIN_SAMPLES_FOR_STATISTICS and float(np.median(changes)) < STILL_CHANGE
