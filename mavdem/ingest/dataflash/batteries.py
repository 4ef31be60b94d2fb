"""Batteries of DataFlash logs as MAVLink messages: SYS_STATUS of the first one, and BATTERY_STATUS of all.

Each battery is an instance of BAT or, in old versions, has a message of its own: BAT and BAT2, CURR and CURR2.
"""

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.ingest.dataflash.attitude import NamedMessage
from mavdem.ingest.dataflash.tables import (
    float_table,
    messages_with_fields,
    rows_of_instance,
    with_stamps,
)
from mavdem.ingest.telemetry import Columns, Fields, Tables, concatenated_columns, selected_rows

MAX_BATTERIES = 9
"""Number of batteries that have a message of their own in old versions: BAT, BAT2 to BAT9."""

BATTERY_MESSAGES = ("BAT", "CURR")
"""Messages of the first battery, the preferred first; CURR is that of the oldest versions."""

NUMBERED_BATTERY_MESSAGES = (
    *BATTERY_MESSAGES,
    *[f"{name}{number}" for name in BATTERY_MESSAGES for number in range(2, MAX_BATTERIES + 1)],
)
"""All messages of batteries."""

INSTANCE_FIELDS = ("Inst", "Instance", "I")
"""Names that the field with the number of the battery has had, from 0."""

MAX_VOLTS = 200.0
"""Voltage, V, above which none of a multirotor's batteries is; a battery of one cell has more hundredths of a volt."""


def sys_status(tables: Tables) -> NamedMessage:
    """Makes SYS_STATUS of the first battery: voltage, mV, and current, cA.

    If no message has the instance number 0, the messages of all batteries are used.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").

    Returns:
        The message, and the name of the logged one from which it was made; without columns if no voltage was logged.
    """
    for name in BATTERY_MESSAGES:
        logged_columns = messages_with_fields(tables, name, ("Volt",))
        if not logged_columns:
            continue
        selected_columns = logged_columns
        for instance_field in INSTANCE_FIELDS:
            first_battery = rows_of_instance(selected_columns, instance_field, 0)
            if first_battery:
                selected_columns = first_battery
        voltage, other_measurements = _battery_measurements(selected_columns)
        fields = {"voltage_battery": voltage, **other_measurements}
        return NamedMessage(name, with_stamps(selected_columns, fields))
    return NamedMessage(BATTERY_MESSAGES[0], {})


def battery_status(tables: Tables) -> NamedMessage:
    """Makes BATTERY_STATUS of all batteries, with the number of each, from 0, as ``id``.

    It is made only if a log has a battery besides the first: otherwise it would repeat SYS_STATUS.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").

    Returns:
        The message, in the order of boot and time; without columns if it is not made.
    """
    batteries = _logged_batteries(tables)
    has_further_battery = any(battery.number > 0 for battery in batteries)
    if not has_further_battery:
        return NamedMessage(BATTERY_MESSAGES[0], {})
    columns: Columns = concatenated_columns([battery.status_columns() for battery in batteries])
    # Sorted by boot, and within each boot by time.
    time_order = np.lexsort((columns["time"], columns["boot"]))
    # Several batteries may share a message. A dictionary keeps each name once, in order.
    logged_names = dict.fromkeys(battery.name for battery in batteries)
    return NamedMessage("/".join(logged_names), selected_rows(columns, time_order))


class _LoggedBattery(NamedTuple):
    """The messages of one battery in a log."""

    name: str
    """Name of the messages, which all batteries may share ("BAT")."""
    number: int
    """Number of the battery, from 0."""
    logged_columns: Columns
    """Columns of the messages, with ``Volt``."""

    def status_columns(self) -> Columns:
        """Returns the columns of MAVLink's BATTERY_STATUS for this battery, with time and boot of each message."""
        voltage, other_measurements = _battery_measurements(self.logged_columns)
        fields = {
            **other_measurements,
            "id": np.full(len(voltage), self.number, np.uint8),
            # MAVLink's field has an element for each cell. Where these are not known, the first element may have the
            # voltage of the whole battery.
            "voltages": voltage[:, None],
        }
        return with_stamps(self.logged_columns, fields)


def _logged_batteries(tables: Tables) -> list[_LoggedBattery]:
    """Returns all batteries of a log; empty if it has no messages of any.

    New versions of ArduPilot log them in BAT, old ones in CURR. A log has one of the two.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
    """
    for battery_message in BATTERY_MESSAGES:
        batteries = _batteries_of_message(tables, battery_message)
        if batteries:
            return batteries
    return []


def _batteries_of_message(tables: Tables, battery_message: str) -> list[_LoggedBattery]:
    """Returns the batteries whose messages are named like those of the first one, or so with a number.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        battery_message: Name of the messages of the first battery, one of ``BATTERY_MESSAGES``.

    Returns:
        All batteries; empty if there are no such messages.
    """
    batteries = []
    for number_from_1 in range(1, MAX_BATTERIES + 1):
        # Where each battery has a message of its own, that of the second one is named "BAT2".
        name = battery_message if number_from_1 == 1 else f"{battery_message}{number_from_1}"
        logged_columns = messages_with_fields(tables, name, ("Volt",))
        if logged_columns:
            rows_by_battery = _rows_by_battery(logged_columns, default_id=number_from_1 - 1)
            for number, rows in rows_by_battery.items():
                batteries.append(_LoggedBattery(name, number, rows))
    return batteries


def _rows_by_battery(logged_columns: Columns, default_id: int) -> dict[int, Columns]:
    """Groups the messages of one name by the number of the battery, from 0.

    Args:
        logged_columns: Columns of one name of battery messages ("BAT").
        default_id: Number of the battery, from 0, where the messages do not have it.

    Returns:
        The messages of each battery, by its number.
    """
    for field in INSTANCE_FIELDS:
        if field in logged_columns:
            numbers = np.unique(logged_columns[field])
            return {
                int(number): rows_of_instance(logged_columns, field, number) for number in numbers
            }
    return {default_id: logged_columns}


def _battery_measurements(logged_columns: Columns) -> tuple[Array, Fields]:
    """Returns the voltage and the other measurements of messages of one battery, in MAVLink's units.

    They remain floats, to keep the decimals that MAVLink's integers would cut off. Old versions of ArduPilot logged
    hundredths of a volt, which are recognised by a median value that would be too many volts for a multirotor.

    Args:
        logged_columns: Messages (N,) with ``Volt``.

    Returns:
        Voltage (N,), mV; and ``current_battery`` (N,), cA, if it was logged.
    """
    voltage = float_table(logged_columns, ("Volt",))[:, 0]
    is_positive = voltage > 0
    is_in_hundredths = np.any(is_positive) and np.nanmedian(voltage[is_positive]) > MAX_VOLTS
    millivolts_per_unit = 10.0 if is_in_hundredths else 1000.0
    centiamperes_per_unit = millivolts_per_unit / 10
    fields: Fields = {}
    if "Curr" in logged_columns:
        # The current is in hundredths of an ampere where the voltage is in hundredths of a volt.
        current = float_table(logged_columns, ("Curr",))[:, 0]
        fields["current_battery"] = current * centiamperes_per_unit
    return voltage * millivolts_per_unit, fields
