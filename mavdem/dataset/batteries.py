"""The batteries of a vehicle: voltage, current, charge and number of cells of each, from its messages.

BATTERY_STATUS has the number of the battery in ``id``, from 0, and those of several batteries come one after the other.
SYS_STATUS has the voltage of one battery: of the first (ArduPilot), or of the connected one with the least charge
(PX4). BATTERY2, of ArduPilot before 4.0, has the second battery. Batteries are numbered from 1 here, as in the
autopilots' parameters (BATT2_LOW_VOLT, BAT2_N_CELLS) and texts.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.dataset.time_series import TimeSeries, clean_series, float_column
from mavdem.ingest.mavlink.clock_readings import deviates_from_median
from mavdem.ingest.telemetry import Columns, Telemetry, selected_rows

BATTERY_MESSAGES = ("SYS_STATUS", "BATTERY_STATUS", "BATTERY2")
"""Messages with the state of the battery."""

FIRST_BATTERY = 1
"""Number of the battery of a message that does not say which it is."""

SECOND_BATTERY = 2
"""Number of the battery of the message BATTERY2."""

UINT16_UNKNOWN = np.iinfo(np.uint16).max
"""Value of MAVLink's 16-bit fields for a voltage that is not known."""

POSSIBLE_VOLTAGE = (1.0, 1000.0)
"""Voltages, V, that a battery can have.

Below, there is no battery monitor, or a simulator has no battery; above, the message is damaged.
"""

VOLTAGE_MEDIAN_SAMPLES = 9
"""Number of neighbouring voltages whose median shows a damaged one; a choice."""

MIN_VOLTAGE_SAMPLES = 5
"""Number of possible voltages below which the battery counts as not measured; a choice."""

POSSIBLE_CELL_VOLTAGE = (2.0, 4.5)
"""Voltages, V, of one lithium cell: a first element of BATTERY_STATUS.voltages above them is that of all cells."""

SAME_BATTERY_DIFFERENCE = 0.05
"""Relative difference of the median voltages up to which SYS_STATUS and BATTERY_STATUS measure one battery; a choice.

Both are sent by the same monitor, so they differ by the time between two messages and by rounding only.
"""


@dataclass(frozen=True, eq=False)
class Battery:
    """One battery that is connected, as far as it was recorded."""

    number: int
    """Number of the battery, from 1."""
    voltage: TimeSeries
    """Voltage (N,), V: possible values without outliers."""
    current: TimeSeries | None
    """Current (M,), A, as sent: -0.01 or 0 where it is not measured; None where it was not recorded."""
    load: TimeSeries | None
    """Voltage, V, and current, A, of each message with both (M, 2); None where the current was not recorded."""
    charge: TimeSeries | None
    """Remaining charge (K,), percent, -1 where it is not known; None where it was not recorded."""
    cells: int | None
    """Number of cells in series as the messages have it; None where they do not."""


class BatteryColumns(NamedTuple):
    """The messages of one battery."""

    number: int
    """Number of the battery, from 1."""
    message: str
    """Name of the message: BATTERY_STATUS, SYS_STATUS or BATTERY2."""
    columns: Columns
    """Its fields, N rows of this battery alone."""


def battery_name(number: int) -> str:
    """Returns the name of a battery by its number from 1, as facts have it for their subject: "battery 2"."""
    return f"battery {number}"


def battery_columns(telemetry: Telemetry) -> list[BatteryColumns]:
    """Collects the messages about each battery.

    SYS_STATUS is taken for the first battery and BATTERY2 for the second; BATTERY_STATUS is split by its ``id``.

    Args:
        telemetry: Messages of the vehicle.

    Returns:
        Number of the battery, name of the message and its columns; several items for a battery with several messages.
    """
    batteries = []
    if "SYS_STATUS" in telemetry.messages:
        sys_status = telemetry.messages["SYS_STATUS"]
        batteries.append(BatteryColumns(FIRST_BATTERY, "SYS_STATUS", sys_status))
    if "BATTERY2" in telemetry.messages:
        battery2 = telemetry.messages["BATTERY2"]
        batteries.append(BatteryColumns(SECOND_BATTERY, "BATTERY2", battery2))
    columns = telemetry.messages.get("BATTERY_STATUS")
    if columns is None:
        return batteries
    if "id" not in columns:
        return [*batteries, BatteryColumns(FIRST_BATTERY, "BATTERY_STATUS", columns)]
    ids = np.asarray(columns["id"])
    for battery_id in np.unique(ids).tolist():
        number = FIRST_BATTERY + int(battery_id)
        rows = selected_rows(columns, ids == battery_id)
        batteries.append(BatteryColumns(number, "BATTERY_STATUS", rows))
    return batteries


def connected_batteries(telemetry: Telemetry) -> tuple[Battery, ...]:
    """Returns the batteries whose voltage was measured, by number.

    If BATTERY_STATUS has at most one battery, SYS_STATUS measures the same one and is preferred, since it is sent more
    often. With several batteries, SYS_STATUS repeats one of them, and is used only if BATTERY_STATUS lacks the first
    one. BATTERY2 is used only if BATTERY_STATUS lacks the second one.

    Args:
        telemetry: Messages of the vehicle.

    Returns:
        Batteries in the order of their numbers.
    """
    batteries: dict[int, Battery] = {}
    sys_status_battery = None
    second_battery = None
    for number, message, columns in battery_columns(telemetry):
        battery = _measured_battery(number, columns)
        if battery is None:
            continue
        if message == "SYS_STATUS":
            sys_status_battery = battery
        elif message == "BATTERY2":
            second_battery = battery
        else:
            batteries[number] = battery
    if sys_status_battery is not None:
        additional_battery = _battery_of_sys_status(
            batteries, sys_status_battery, telemetry.autopilot
        )
        if additional_battery is not None:
            batteries[additional_battery.number] = additional_battery
    if second_battery is not None and SECOND_BATTERY not in batteries:
        batteries[SECOND_BATTERY] = second_battery
    return tuple(batteries[number] for number in sorted(batteries))


def _battery_of_sys_status(
    batteries: Mapping[int, Battery], sys_status: Battery, autopilot: str
) -> Battery | None:
    """Decides under which number the battery of SYS_STATUS is listed, and whether it replaces one of BATTERY_STATUS.

    Two medians of the voltage that agree within ``SAME_BATTERY_DIFFERENCE`` are of the same battery.

    Args:
        batteries: Batteries of BATTERY_STATUS by number.
        sys_status: Battery that SYS_STATUS describes, as the first battery: the message itself has no number.
        autopilot: MAV_AUTOPILOT without its prefix.

    Returns:
        The battery of SYS_STATUS with its number; None if it only repeats a battery of BATTERY_STATUS.
    """
    if not batteries:
        return sys_status
    if len(batteries) == 1:
        (only_battery,) = batteries.values()
        usual_voltage = np.median(only_battery.voltage.values)
        difference = abs(np.median(sys_status.voltage.values) - usual_voltage)
        is_same_battery = difference <= SAME_BATTERY_DIFFERENCE * usual_voltage
        if is_same_battery:
            # SYS_STATUS is sent more often, but does not have the number of cells.
            return replace(sys_status, number=only_battery.number, cells=only_battery.cells)
    # PX4's SYS_STATUS shows the battery with the least charge, which changes in flight.
    if autopilot == "PX4" or FIRST_BATTERY in batteries:
        return None
    return sys_status


def _measured_battery(number: int, columns: Columns) -> Battery | None:
    """Makes a battery from its messages, of which those with an impossible voltage are left out.

    Args:
        number: Number under which the battery is listed, from 1.
        columns: Fields of SYS_STATUS or BATTERY2, or of one battery's BATTERY_STATUS, N rows.

    Returns:
        The battery, with current and charge if they were measured; None without a measured voltage.
    """
    voltage = _battery_voltage(columns)
    if voltage is None:
        return None
    is_possible = _is_possible_voltage(voltage)
    # Without a connected battery, a few damaged messages may still have a possible voltage.
    sample_count = np.count_nonzero(~np.isnan(voltage))
    min_possible_count = max(MIN_VOLTAGE_SAMPLES, sample_count / 2)
    if np.count_nonzero(is_possible) < min_possible_count:
        return None
    current = voltage_and_current = charge = None
    if "current_battery" in columns:
        # All these messages have units of 10 mA.
        amperes = float_column(columns, "current_battery") / 1e2
        current = _series_or_none(columns, amperes)
        voltage_and_current = _series_or_none(columns, np.column_stack([voltage, amperes]))
    if "battery_remaining" in columns:
        charge = _series_or_none(columns, float_column(columns, "battery_remaining"))
    return Battery(
        number,
        voltage=clean_series(columns, voltage, is_possible),
        current=current,
        load=voltage_and_current,
        charge=charge,
        cells=_cells_in_message(columns, is_possible),
    )


def _series_or_none(columns: Columns, values: Array) -> TimeSeries | None:
    """Returns the time series of values (N,) or (N, k) of a message; None if none is finite."""
    series = clean_series(columns, values)
    return series if len(series.time) else None


def _is_possible_voltage(voltage: Array) -> Flags:
    """Flags the samples in which the voltage of a battery is in ``POSSIBLE_VOLTAGE`` and no outlier.

    A damaged message can have twice the voltage of its neighbours. So a sample is an outlier if it deviates by more
    than half of its value from the running median of the possible ones.

    Args:
        voltage: Voltage (N,), V; NaN where it is not known.

    Returns:
        Flags (N,).
    """
    lowest, highest = POSSIBLE_VOLTAGE
    is_possible = (voltage >= lowest) & (voltage <= highest)
    possible_voltage = voltage[is_possible]
    is_outlier = deviates_from_median(
        possible_voltage, VOLTAGE_MEDIAN_SAMPLES, possible_voltage / 2
    )
    # The outliers are flags of the possible samples only, so they are removed at these samples.
    is_possible[is_possible] = ~is_outlier
    return is_possible


def _battery_voltage(columns: Columns) -> Array | None:
    """Returns the voltage in the messages of a battery.

    BATTERY_STATUS has the voltage of each cell, or of several cells, in up to 14 elements, whose sum is the battery's.

    Args:
        columns: Columns (N,) of a message with the voltage of a battery.

    Returns:
        Voltage (N,), V, NaN where it is not known; None if the message has no voltage.
    """
    # SYS_STATUS and BATTERY2 have one voltage.
    voltage_name = "voltage" if "voltage" in columns else "voltage_battery"
    if voltage_name in columns:
        millivolts = float_column(columns, voltage_name)
        return np.where(millivolts == UINT16_UNKNOWN, np.nan, millivolts) / 1000
    if "voltages" not in columns:
        return None
    cells = _cell_millivolts(columns)
    # The sum over no cell at all is 0, which would be a voltage.
    has_voltage = np.isfinite(cells).any(axis=1)
    return np.where(has_voltage, np.nansum(cells, axis=1), np.nan) / 1000


def _cell_millivolts(columns: Mapping[str, Array]) -> Array:
    """Returns the voltages of the cells in BATTERY_STATUS.

    Args:
        columns: Columns (N,) of BATTERY_STATUS.

    Returns:
        (N, 10) voltages of cells 1 to 10, mV, or (N, 14) if the message has those of cells 11 to 14 too; NaN for an
        element that is not in use.
    """
    cells_1_to_10 = np.array(float_column(columns, "voltages"), ndmin=2)
    cells_1_to_10[cells_1_to_10 == UINT16_UNKNOWN] = np.nan
    if "voltages_ext" not in columns:
        return cells_1_to_10
    # In this field an element that is not in use is 0.
    cells_11_to_14 = np.array(float_column(columns, "voltages_ext"), ndmin=2)
    cells_11_to_14[(cells_11_to_14 == 0) | (cells_11_to_14 == UINT16_UNKNOWN)] = np.nan
    return np.column_stack([cells_1_to_10, cells_11_to_14])


def _cells_in_message(columns: Columns, is_possible: Flags) -> int | None:
    """Returns the number of cells that the messages of a battery report.

    A message reports it as a number, or by a voltage for each cell.

    Args:
        columns: Fields of the messages, N rows.
        is_possible: Whether each row has a possible voltage (N,).

    Returns:
        The number; None if they do not report it, or the voltages may be of several cells each.
    """
    if "cell_count" in columns:
        cell_count = int(np.median(columns["cell_count"][is_possible]))
        # The number 0 means "not known".
        return cell_count or None
    if "voltages" not in columns:
        return None
    return _count_of_cell_voltages(_cell_millivolts(columns)[is_possible] / 1000)


def _count_of_cell_voltages(volts: Array) -> int | None:
    """Returns how many cells have a voltage in the messages of a battery.

    Args:
        volts: Elements (N, k) of N messages, V, one for each cell or for several; NaN where one is not in use.

    Returns:
        The number; None if it changes, or an element cannot be the voltage of a single cell.
    """
    is_in_use = np.isfinite(volts)
    cells_in_use = is_in_use.sum(axis=1)
    # A single element is no count of cells: it may be the voltage of one cell, or the sum of two empty ones.
    if cells_in_use.min() < 2:
        return None
    is_constant_count = np.ptp(cells_in_use) == 0
    lowest_voltage, highest_voltage = POSSIBLE_CELL_VOLTAGE
    is_voltage_of_cell = (volts >= lowest_voltage) & (volts <= highest_voltage)
    if not is_constant_count or not is_voltage_of_cell[is_in_use].all():
        return None
    return int(cells_in_use[0])
