"""Voltages below which a battery is low or critical, its number of cells, and which of several is the emptiest."""

import numpy as np

from mavdem.assessment.limits import Limits
from mavdem.dataset.batteries import FIRST_BATTERY, Battery
from mavdem.dataset.signals import Signals
from mavdem.ingest.telemetry import Parameters, Telemetry

CELL_COUNTS = np.array([1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14])
"""Numbers of cells in series of usual batteries."""

FULL_CELL_VOLTAGES = (3.65, 4.36)
"""Lowest and highest voltage, V, of a cell with which flights begin: half charged, and full at 4.35 V, the highest
kind."""

CELL_VOLTAGE_LIMITS = Limits(3.3, 3.0)
"""Voltages, V, of a cell under load below which it is to be watched or bad: little charge is left near the first, and a
lithium cell is damaged below the second."""

FULL_PERCENTILE = 99
"""Percentile of the voltages of a log that is used as that of the full battery: the highest, without outliers."""

EMPTY_PERCENTILE = 5
"""Percentile of the voltages of a log that is used as that of the battery at its emptiest: the lowest, without short
sags."""

FULL_CELL_VOLTAGE = 4.2
"""Voltage, V, of a full lithium cell. The highest voltage of a battery with an unknown number of cells is assumed to be
that of full cells."""

LOW_VOLTAGE_PARAMETER = "{}LOW_VOLT"
"""ArduPilot's parameter of the voltage, V, at which it acts on a low battery, after the prefix of the battery; 0 for
none."""

OLD_LOW_VOLTAGE_PARAMETER = "FS_BATT_VOLTAGE"
"""The same of older versions, which know the first battery only."""

CRITICAL_VOLTAGE_PARAMETER = "{}CRT_VOLT"
"""ArduPilot's parameter of the voltage, V, at which it acts on a critical battery; 0 for none."""

CELL_COUNT_PARAMETER = "BAT{}_N_CELLS"
"""PX4's parameter of a battery's number of cells, by the number of the battery."""

OLD_CELL_COUNT_PARAMETER = "BAT_N_CELLS"
"""PX4's parameter of the number of cells of the first battery, before PX4 1.11."""


CAPACITY_PARAMETERS = ("{}LOW_MAH", "{}CRT_MAH", "{}CAPACITY")
"""ArduPilot's parameters of the charge, mAh, at which it acts on a low and on a critical battery, and of the full
charge, after the prefix of the battery; 0 for none."""


def ardupilot_charge_levels(parameters: Parameters, number: int) -> Limits:
    """Returns the fractions of the full charge below which ArduPilot acts on a low and on a critical battery.

    Args:
        parameters: values of the autopilot's parameters by their names.
        number: number of the battery, from 1.

    Returns:
        The limits; 0 where ArduPilot does not act, or the full charge is not set.
    """
    prefix = _ardupilot_prefix(number)
    # Charges in mAh; 0 if they are not set.
    charges = [parameters.get(name.format(prefix), 0.0) for name in CAPACITY_PARAMETERS]
    low_charge, critical_charge, full_charge = charges
    if full_charge <= 0:
        return Limits(watch=0.0, bad=0.0)
    # A battery is never critical before it is low.
    return Limits(
        watch=max(low_charge, critical_charge) / full_charge, bad=critical_charge / full_charge
    )


def voltage_levels(parameters: Parameters, number: int, cells: int) -> Limits:
    """Returns the voltages, V, below which a battery is to be watched (low) or bad (critical).

    Each is the higher one of two voltages: the voltage at which the autopilot acts, by its parameters; and the voltage
    of a low or critical cell (``CELL_VOLTAGE_LIMITS``) times the number of cells. So a parameter that was set too low,
    or not at all, does not hide an empty battery.

    Args:
        parameters: values of the autopilot's parameters by their names.
        number: number of the battery, from 1.
        cells: number of cells in series; 0 if it is not known, so that the parameters alone decide.

    Returns:
        The limits; 0 if neither the parameters nor the number of cells is known.
    """
    prefix = _ardupilot_prefix(number)
    critical_parameter = parameters.get(CRITICAL_VOLTAGE_PARAMETER.format(prefix), 0.0)
    low_parameter = parameters.get(LOW_VOLTAGE_PARAMETER.format(prefix), 0.0)
    if number == FIRST_BATTERY:
        low_parameter = max(low_parameter, parameters.get(OLD_LOW_VOLTAGE_PARAMETER, 0.0))
    critical_voltage = max(critical_parameter, CELL_VOLTAGE_LIMITS.bad * cells)
    # A battery is never critical before it is low.
    low_voltage = max(low_parameter, CELL_VOLTAGE_LIMITS.watch * cells, critical_voltage)
    return Limits(watch=low_voltage, bad=critical_voltage)


def low_voltage_parameters(telemetry: Telemetry, number: int) -> str:
    """Returns which parameters a user sets so that the autopilot knows when a battery is low.

    PX4 computes the voltage from the number of cells; ArduPilot has the voltages themselves.

    Args:
        telemetry: autopilot and parameters of the vehicle, which show the version of the firmware.
        number: number of the battery, from 1.

    Returns:
        The names for a sentence: "BAT1_N_CELLS" or "BATT_LOW_VOLT and BATT_CRT_VOLT"; empty for other autopilots.
    """
    if telemetry.autopilot == "PX4":
        return _px4_cell_count_parameter(telemetry.parameters, number)
    if telemetry.autopilot == "ARDUPILOTMEGA":
        return _ardupilot_low_voltage_parameters(telemetry.parameters, number)
    return ""


def _px4_cell_count_parameter(parameters: Parameters, number: int) -> str:
    """Returns PX4's parameter of the number of cells of a battery, such as "BAT1_N_CELLS", in the log's version.

    Args:
        parameters: values of the autopilot's parameters by their names.
        number: number of the battery, from 1.
    """
    names = _names_of_cell_count(number)
    for name in names:
        if name in parameters:
            return name
    return names[0]


def _names_of_cell_count(number: int) -> list[str]:
    """Returns the names of PX4's parameter of the number of cells of a battery in all versions, the present one first.

    Args:
        number: number of the battery, from 1. Older versions know the first battery only.
    """
    names = [CELL_COUNT_PARAMETER.format(number)]
    if number == FIRST_BATTERY:
        names.append(OLD_CELL_COUNT_PARAMETER)
    return names


def _ardupilot_low_voltage_parameters(parameters: Parameters, number: int) -> str:
    """Returns ArduPilot's parameters of the voltages of a low and of a critical battery, in the log's version.

    Args:
        parameters: values of the autopilot's parameters by their names.
        number: number of the battery, from 1.

    Returns:
        The names, such as "BATT_LOW_VOLT and BATT_CRT_VOLT". Older versions have only one such parameter.
    """
    if number == FIRST_BATTERY and OLD_LOW_VOLTAGE_PARAMETER in parameters:
        return OLD_LOW_VOLTAGE_PARAMETER
    prefix = _ardupilot_prefix(number)
    return f"{LOW_VOLTAGE_PARAMETER.format(prefix)} and {CRITICAL_VOLTAGE_PARAMETER.format(prefix)}"


def _ardupilot_prefix(number: int) -> str:
    """Returns how ArduPilot's parameters of a battery begin: "BATT_" for the first one, "BATT2_" for the second."""
    return "BATT_" if number == FIRST_BATTERY else f"BATT{number}_"


def cell_count(parameters: Parameters, battery: Battery) -> int | None:
    """Returns the number of cells that a battery has in series.

    The number comes from a PX4 parameter or from the battery's messages. If neither has it, each of the usual
    ``CELL_COUNTS`` is tried: the voltage of the full battery divided by the count must be a possible voltage of a full
    cell (``FULL_CELL_VOLTAGES``). The number is known if exactly one count fits.

    Args:
        parameters: values of the autopilot's parameters by their names.
        battery: voltage, current and charge of the battery over time.

    Returns:
        The number; None if it cannot be determined.
    """
    for name in _names_of_cell_count(battery.number):
        count = int(parameters.get(name, 0))
        if count:
            return count
    if battery.cells is not None:
        return battery.cells
    lowest_cell_voltage, highest_cell_voltage = FULL_CELL_VOLTAGES
    # Voltage of a full cell for each of the usual counts.
    cell_voltages = np.percentile(battery.voltage.values, FULL_PERCENTILE) / CELL_COUNTS
    possible_counts = CELL_COUNTS[
        (cell_voltages >= lowest_cell_voltage) & (cell_voltages <= highest_cell_voltage)
    ]
    return int(possible_counts[0]) if len(possible_counts) == 1 else None


def is_measured(parameters: Parameters, battery: Battery) -> bool:
    """Returns whether a voltage sensor measures a battery, and not just a constant because none is connected.

    The voltage of a battery varies with its load, and exceeds the voltage at which the autopilot reports a low battery,
    at least at the take-off. A sensor without a battery reads a constant, or a lower voltage.

    Args:
        parameters: values of the autopilot's parameters by their names.
        battery: voltage, V, of the battery over time, as its sensor reads it.
    """
    volts = battery.voltage.values
    # With 0 cells only the autopilot's parameters decide what a low voltage is.
    low_voltage = voltage_levels(parameters, battery.number, cells=0).watch
    varies = np.ptp(volts) != 0
    was_charged = volts.max() > low_voltage
    return bool(varies and was_charged)


def batteries_worst_first(signals: Signals) -> list[Battery]:
    """Sorts the batteries of a vehicle by their lowest voltage of a cell, so that the emptiest one comes first.

    If the number of cells is not known, it is estimated as the battery's highest voltage over ``FULL_CELL_VOLTAGE``.
    Low percentiles stand for the lowest voltage, and high ones for the highest, since single samples may be wrong.

    Args:
        signals: signals of the vehicle, with its batteries and parameters.

    Returns:
        The batteries, the emptiest first; batteries that are not measured come last.
    """
    parameters = signals.telemetry.parameters

    def measured_and_emptiest_first(battery: Battery) -> tuple[bool, float]:
        """Returns the key to sort by: whether a battery is not measured, and its lowest voltage of a cell, V."""
        empty_volts, full_volts = np.percentile(
            battery.voltage.values, [EMPTY_PERCENTILE, FULL_PERCENTILE]
        )
        cells = cell_count(parameters, battery) or full_volts / FULL_CELL_VOLTAGE
        return not is_measured(parameters, battery), empty_volts / cells

    return sorted(signals.batteries, key=measured_and_emptiest_first)
