"""The light of power: how the battery held under its load in flight, and what the board was supplied with."""

from collections.abc import Iterator

import numpy as np

from mavdem.assessment.evidence import Evidence
from mavdem.assessment.lights.limits import Limits, worst
from mavdem.dataset import phases
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, recorded_series
from mavdem.facts import Fact, Level
from mavdem.facts.events import Reported
from mavdem.facts.power import PowerLight

CELL_COUNTS = np.array([1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14])
FULL_CELL = (3.65, 4.36)
"""V of a cell with which flights begin: half charged, and a full cell of the highest kind, 4.35 V."""
CELL = Limits(3.3, 3.0)
"""V of a cell under load: near the first little charge is left, below the second a lithium cell is damaged."""
LOW_SECONDS = 10.0  # s below a level that count: ArduPilot's default of BATT_LOW_TIMER
BOARD_VOLTAGE_LIMITS = Limits(4.65, 4.5)
"""V of the board below which PX4 warns, at all and critically (``powerCheck.cpp``)."""
SUPPLY_FALL = 0.3  # V: twice what ArduPilot's page on power in logs calls normal
# of voltage and current about their means of 2 s: half of the variance is explained
RESISTANCE_CORRELATION = -0.7
LOW_LEVELS = ("BATT_LOW_VOLT", "FS_BATT_VOLTAGE")
CRITICAL_LEVEL = "BATT_CRT_VOLT"
"""ArduPilot's parameters of voltages, V, at which it acts; 0 for none."""

OF_POWER = {Reported.BATTERY_WARNED, Reported.BATTERY_ALARMED, Reported.BOARD_VOLTAGE_LOW}


def power_light(evidence: Evidence) -> Fact:
    """Returns the worse of battery and supply in flight; unknown where neither was measured."""
    facts = [*_battery(evidence), *_supply(evidence), *evidence.reported(OF_POWER)]
    if facts:
        return worst(facts)
    voltage = evidence.signals.voltage
    return Fact(
        PowerLight.POWER_UNMEASURED,
        airborne=evidence.learnability.figures.airborne,
        voltage=None if voltage is None else voltage.values.max(initial=0.0),
    )


def _battery(evidence: Evidence) -> Iterator[Fact]:
    """Of the lowest mean over 2 s, and of what was lasting: the voltage that it was below for ``LOW_SECONDS``."""
    signals = evidence.signals
    voltage = signals.voltage
    means = np.sort(evidence.averaged(voltage))
    if voltage is None or not len(means):
        return
    parameters = signals.telemetry.parameters
    critical = parameters.get(CRITICAL_LEVEL, 0.0)
    low = max(critical, *(parameters.get(name, 0.0) for name in LOW_LEVELS))
    if np.ptp(voltage.values) == 0 or voltage.values.max() <= low:
        return  # no battery is connected to what measures it
    cells = _cells(signals, np.percentile(voltage.values, 99))
    steps = np.diff(voltage.time)[np.diff(voltage.boot) == 0]
    rows = round(LOW_SECONDS / max(np.median(steps), 1e-3)) if len(steps) else 0
    lasting = means[min(rows, len(means) - 1)]
    critical = max(critical, CELL.bad * (cells or 0))
    low = max(low, critical, CELL.watch * (cells or 0))
    load = recorded_series(signals.telemetry, "SYS_STATUS", "voltage_battery", "current_battery")
    resistance, current = _resistance([*evidence.flown(load)])
    code = PowerLight.CELLS_UNKNOWN
    level = None
    if lasting < low:
        code = PowerLight.BATTERY_LOW
        level = Level.BAD if lasting < critical else None
    elif low > 0:
        code = PowerLight.BATTERY_HELD
    yield Fact(
        code,
        level,
        voltage=means[0],
        cells=cells,
        current=current,
        resistance=resistance,
        voltage_limit=critical if lasting < critical else low,
    )
    remaining = evidence.averaged(
        recorded_series(signals.telemetry, "SYS_STATUS", "battery_remaining")
    )
    least = parameters.get("BAT_LOW_THR", 0.0)
    if np.any(left := remaining[remaining > 0] / 100) and left.min() < least:
        yield Fact(PowerLight.CHARGE_LOW, share=left.min(), share_limit=least)


def _supply(evidence: Evidence) -> Iterator[Fact]:
    """Of the board's voltage; one that never changes is not measured."""
    messages = ("POWER_STATUS", "HWSTATUS")
    signals = (recorded_series(evidence.signals.telemetry, name, "Vcc") for name in messages)
    measured = next(
        (signal for signal in signals if signal is not None and np.ptp(signal.values) > 0), None
    )
    volts = evidence.averaged(measured) / 1000
    if not len(volts):
        return
    least = volts.min()
    usual = np.median(volts)
    code = PowerLight.SUPPLY_HELD
    level = None
    if least < BOARD_VOLTAGE_LIMITS.watch:
        # where it is always so low, the vehicle flies, and the scale may be wrong
        code = PowerLight.SUPPLY_LOW
        level = Level.BAD if least < BOARD_VOLTAGE_LIMITS.bad <= usual else None
    elif usual - least > SUPPLY_FALL:
        code = PowerLight.SUPPLY_FELL
    yield Fact(
        code, level, voltage=least, voltage_usual=usual, voltage_limit=BOARD_VOLTAGE_LIMITS.watch
    )


def _cells(signals: Signals, full: float) -> int | None:
    """How many cells the battery has, by its parameters, else by the voltages that cells have when flights begin."""
    for name in ("BAT1_N_CELLS", "BAT_N_CELLS"):
        if count := int(signals.telemetry.parameters.get(name, 0)):
            return count
    each = full / CELL_COUNTS
    possible = CELL_COUNTS[(each >= FULL_CELL[0]) & (each <= FULL_CELL[1])]
    return possible[0] if len(possible) == 1 else None


def _resistance(load: list[TimeSeries]) -> tuple[float | None, float | None]:
    """The internal resistance, ohm, where voltage falls as current rises, and the largest mean current over 2 s, A.

    Of voltage and current (N, 2) of each flight, mV and 10 mA; None where no current was measured.
    """
    apart = []
    most = 0.0
    for part in load:
        rows = part.values[:, 1] > 0
        volts_and_amperes = part.values[rows] * (1e-3, 1e-2)
        means = [
            phases.moving_average(TimeSeries(part.time[rows], part.boot[rows], column))
            for column in volts_and_amperes.T
        ]
        apart.append(volts_and_amperes.T - means)
        most = max(most, means[1].max(initial=0.0))
    if not most:
        return None, None
    volts, amperes = np.hstack(apart)
    spread = volts @ volts * (amperes @ amperes)
    together = volts @ amperes
    if spread == 0 or together > RESISTANCE_CORRELATION * spread**0.5:
        return None, most
    return -together / (amperes @ amperes), most
