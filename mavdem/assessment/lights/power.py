"""Light on power: judges voltage and charge of the battery, and the supply voltage of the board, in flight."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.limits import Limits, worst_fact
from mavdem.dataset import phases
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, recorded_series
from mavdem.facts import Fact, Level
from mavdem.facts.events import Reported
from mavdem.facts.power import PowerLight

CELL_COUNTS = np.array([1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14])
"""Numbers of cells in series of usual batteries."""

FULL_CELL_VOLTAGES = (3.65, 4.36)
"""Lowest and highest voltage, V, of a cell with which flights begin: half charged, and full at 4.35 V, the highest
kind."""

CELL_VOLTAGE_LIMITS = Limits(3.3, 3.0)
"""Voltages, V, of a cell under load below which it is to be watched or bad: little charge is left near the first, and a
lithium cell is damaged below the second."""

LOW_VOLTAGE_SECONDS = 10.0
"""Time, s, that a voltage must stay below a limit to count: the default of ArduPilot's BATT_LOW_TIMER."""

BOARD_VOLTAGE_LIMITS = Limits(4.65, 4.5)
"""Voltages, V, of the board below which PX4 warns, and warns critically (``powerCheck.cpp``)."""

MAX_BOARD_VOLTAGE_DROP = 0.3
"""Drop of the board's voltage below its median, V: twice what ArduPilot's page on power in logs calls normal."""

MAX_RESISTANCE_CORRELATION = -0.7
"""Correlation of voltage and current, about their means over 2 s, above which they show no internal resistance: at this
value the current explains half of the voltage's variance."""

LOW_VOLTAGE_PARAMETERS = ("BATT_LOW_VOLT", "FS_BATT_VOLTAGE")
"""ArduPilot's parameters of the voltage, V, at which it acts on a low battery; 0 for none."""

CRITICAL_VOLTAGE_PARAMETER = "BATT_CRT_VOLT"
"""ArduPilot's parameter of the voltage, V, at which it acts on a critical battery; 0 for none."""

POWER_REPORTS = {
    Reported.BATTERY_WARNED,
    Reported.BATTERY_ALARMED,
    Reported.BOARD_VOLTAGE_LOW,
}
"""Reports of the autopilot in flight that concern the power."""


def power_light(evidence: Evidence) -> Fact:
    """Returns the worst of battery, charge and board voltage in flight; unknown if none of them was measured.

    Args:
        evidence: what the log shows of the vehicle.

    Returns:
        A fact whose level is the colour of the light: good, watch, bad or unknown.
    """
    facts = [
        *_battery_voltage(evidence),
        *_battery_charge(evidence),
        *_board_voltage(evidence),
        *evidence.warnings_in_flight(POWER_REPORTS),
    ]
    if facts:
        return worst_fact(facts)
    voltage = evidence.signals.voltage
    return Fact(
        PowerLight.POWER_UNMEASURED,
        airborne=evidence.has_operated,
        voltage=None if voltage is None else voltage.values.max(initial=0.0),
    )


def _is_battery_measured(evidence: Evidence) -> bool:
    """Returns whether a battery is connected to the sensor, and was measured in flight.

    An open input of the sensor reads a constant voltage, or one that never exceeds the levels at which the autopilot
    acts, and with which nobody would have taken off.
    """
    voltage = evidence.signals.voltage
    if voltage is None or not len(evidence.averages_in_flight(voltage)):
        return False
    # With 0 cells these are the levels of the autopilot's parameters alone.
    levels = _voltage_levels(evidence.signals, cells=0)
    return bool(np.ptp(voltage.values) != 0 and voltage.values.max() > levels.watch)


def _voltage_levels(signals: Signals, cells: int) -> Limits:
    """Returns the voltages, V, below which a battery is to be watched (low) or bad (critical).

    Each is the higher of two: the level at which the autopilot acts by its parameters, and that of the cells. So a
    level that was set too low, or not at all, does not hide an empty battery.

    Args:
        signals: of the vehicle, with its parameters.
        cells: number of cells in series; 0 if it is not known, so that the parameters alone decide.

    Returns:
        The limits; 0 where neither parameters nor cells are known.
    """
    parameters = signals.telemetry.parameters
    critical = parameters.get(CRITICAL_VOLTAGE_PARAMETER, 0.0)
    low = max(critical, *(parameters.get(name, 0.0) for name in LOW_VOLTAGE_PARAMETERS))
    critical = max(critical, CELL_VOLTAGE_LIMITS.bad * cells)
    return Limits(watch=max(low, critical, CELL_VOLTAGE_LIMITS.watch * cells), bad=critical)


def _battery_voltage(evidence: Evidence) -> Iterator[Fact]:
    """Yields how the voltage of the battery held in flight; nothing if no battery was measured.

    The samples are averaged over 2 s and sorted. What decides is the voltage that they stay below for
    ``LOW_VOLTAGE_SECONDS`` in total, so that a short sag under a burst of thrust counts for nothing.

    The fact has the lowest average ``voltage`` and the ``voltage_limit`` that decided, V, the number of ``cells``, the
    largest ``current``, A, and the internal ``resistance``, ohm, each None if it is not known.
    """
    signals = evidence.signals
    voltage = signals.voltage
    if voltage is None or not _is_battery_measured(evidence):
        return
    averages = np.sort(evidence.averages_in_flight(voltage))
    # The 99th percentile is the voltage of the full battery without outliers.
    cells = _cell_count(signals, np.percentile(voltage.values, 99))
    # The number of samples in the lowest ``LOW_VOLTAGE_SECONDS``, by the usual step between samples of one boot.
    steps = np.diff(voltage.time)[np.diff(voltage.boot) == 0]
    # The step is at least 1 ms: a damaged log may have the same stamp throughout.
    lasting_rows = round(LOW_VOLTAGE_SECONDS / max(np.median(steps), 1e-3)) if len(steps) else 0
    lasting_voltage = averages[min(lasting_rows, len(averages) - 1)]
    levels = _voltage_levels(signals, cells or 0)
    battery = recorded_series(signals.telemetry, "SYS_STATUS", "voltage_battery", "current_battery")
    load = _battery_load([*evidence.in_flight(battery)])
    # Without any limit, nothing can be said of the voltage.
    code = PowerLight.CELLS_UNKNOWN
    level = None
    voltage_limit = levels.watch
    if lasting_voltage < levels.watch:
        code = PowerLight.BATTERY_LOW
        if lasting_voltage < levels.bad:
            level = Level.BAD
            voltage_limit = levels.bad
    elif levels.watch > 0:
        code = PowerLight.BATTERY_HELD
    yield Fact(
        code,
        level,
        voltage=averages[0],
        cells=cells,
        current=load.max_current,
        resistance=load.resistance,
        voltage_limit=voltage_limit,
    )


def _battery_charge(evidence: Evidence) -> Iterator[Fact]:
    """Yields that the charge of the battery fell below PX4's parameter BAT_LOW_THR in flight; nothing if it did not.

    The autopilot estimates the remaining charge, which SYS_STATUS has in percent. It is averaged over 2 s, and compared
    with the parameter as a share of the full charge. Vehicles without that parameter are not judged by their charge.
    """
    if not _is_battery_measured(evidence):
        return
    telemetry = evidence.signals.telemetry
    percent = evidence.averages_in_flight(
        recorded_series(telemetry, "SYS_STATUS", "battery_remaining")
    )
    # A charge that is not known is sent as -1.
    shares = percent[percent > 0] / 100
    low_share = telemetry.parameters.get("BAT_LOW_THR", 0.0)
    if len(shares) and shares.min() < low_share:
        yield Fact(PowerLight.CHARGE_LOW, share=shares.min(), share_limit=low_share)


def _board_voltage(evidence: Evidence) -> Iterator[Fact]:
    """Yields how the supply voltage of the autopilot's board held in flight; nothing if it was not measured.

    A supply that falls may reset the autopilot in the air. It is low below ``BOARD_VOLTAGE_LIMITS``, and otherwise it
    fell if its lowest value is ``MAX_BOARD_VOLTAGE_DROP`` below its median.

    The fact has the lowest average over 2 s as ``voltage``, the median as ``voltage_usual``, and the limit, all in V.
    """
    telemetry = evidence.signals.telemetry
    # A voltage that is constant was not measured.
    for message in ("POWER_STATUS", "HWSTATUS"):
        millivolts = recorded_series(telemetry, message, "Vcc")
        if millivolts is not None and np.ptp(millivolts.values) > 0:
            break
    else:
        return
    averages = evidence.averages_in_flight(millivolts) / 1000
    if not len(averages):
        return
    lowest = averages.min()
    usual = np.median(averages)
    code = PowerLight.SUPPLY_HELD
    level = None
    if lowest < BOARD_VOLTAGE_LIMITS.watch:
        code = PowerLight.SUPPLY_LOW
        # A vehicle that flies with a low voltage throughout may measure it on a wrong scale.
        if lowest < BOARD_VOLTAGE_LIMITS.bad <= usual:
            level = Level.BAD
    elif usual - lowest > MAX_BOARD_VOLTAGE_DROP:
        code = PowerLight.SUPPLY_FELL
    yield Fact(
        code,
        level,
        voltage=lowest,
        voltage_usual=usual,
        voltage_limit=BOARD_VOLTAGE_LIMITS.watch,
    )


def _cell_count(signals: Signals, full_voltage: float) -> int | None:
    """Returns how many cells the battery has in series; None if that is not clear.

    A parameter of PX4 has the number. Otherwise each of the usual ``CELL_COUNTS`` is tried: the voltage of the full
    battery over the count must be one with which a cell begins a flight. Only if exactly one count fits, it is known.

    Args:
        signals: of the vehicle, with its parameters.
        full_voltage: voltage of the battery when it was full, V.
    """
    for name in ("BAT1_N_CELLS", "BAT_N_CELLS"):
        count = int(signals.telemetry.parameters.get(name, 0))
        if count:
            return count
    lowest, highest = FULL_CELL_VOLTAGES
    cell_voltages = full_voltage / CELL_COUNTS
    possible_counts = CELL_COUNTS[(cell_voltages >= lowest) & (cell_voltages <= highest)]
    return possible_counts[0] if len(possible_counts) == 1 else None


class _BatteryLoad(NamedTuple):
    """What voltage and current of a battery show of its load."""

    resistance: float | None = None
    """Internal resistance, ohm; None if the voltage does not fall as the current rises."""
    max_current: float | None = None
    """Largest mean current over 2 s, A; None if no current was measured."""


def _battery_load(flights: Sequence[TimeSeries]) -> _BatteryLoad:
    """Estimates the internal resistance R of a battery by linear regression, from voltage U and current I.

    In U = U₀ − R I the open-circuit voltage U₀ falls slowly as the battery discharges. The moving means over 2 s
    contain that, and are subtracted from both, so that the slope of what remains is −R: with the deviations u and i it
    is R = −Σ u i / Σ i². It counts only if the correlation of u and i is at most ``MAX_RESISTANCE_CORRELATION``.

    Args:
        flights: one series (N, 2) for each flight: voltage, mV, and current, 10 mA, as in SYS_STATUS.
    """
    deviations: list[Array] = []
    max_current = 0.0
    for flight in flights:
        # A current of 0 or less was not measured.
        rows = flight.values[:, 1] > 0
        volts_and_amperes = flight.values[rows] * (1e-3, 1e-2)
        mean_volts, mean_amperes = (
            phases.moving_average(TimeSeries(flight.time[rows], flight.boot[rows], column))
            for column in volts_and_amperes.T
        )
        deviations.append(volts_and_amperes.T - [mean_volts, mean_amperes])
        max_current = max(max_current, mean_amperes.max(initial=0.0))
    if not max_current:
        return _BatteryLoad()
    volt_deviations, ampere_deviations = np.hstack(deviations)
    volt_squares = volt_deviations @ volt_deviations
    ampere_squares = ampere_deviations @ ampere_deviations
    products = volt_deviations @ ampere_deviations
    # By the Cauchy-Schwarz inequality; the correlation is ``products`` over this.
    largest_product = (volt_squares * ampere_squares) ** 0.5
    if largest_product == 0 or products > MAX_RESISTANCE_CORRELATION * largest_product:
        return _BatteryLoad(max_current=max_current)
    return _BatteryLoad(-products / ampere_squares, max_current)
