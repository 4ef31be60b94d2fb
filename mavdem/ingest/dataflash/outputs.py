"""Outputs to motors and servos in DataFlash logs (RCOU, RCO2, RCO3), as SERVO_OUTPUT_RAW."""

from collections.abc import Mapping

import numpy as np

from mavdem.arrays import Array
from mavdem.ingest.dataflash.attitude import NamedMessage
from mavdem.ingest.dataflash.tables import continuous_time, message_count, with_stamps
from mavdem.ingest.motors import PORT_OUTPUTS
from mavdem.ingest.telemetry import Columns, Tables, concatenated_columns, last_values

OUTPUT_MESSAGES = {"RCOU": range(1, 17), "RCO2": range(15, 19), "RCO3": range(19, 33)}
"""Messages with the outputs, and the numbers of those that each may have.

RCOU has 14 outputs where there is RCO2, and up to 16 in versions of ArduPilot that had no more outputs.
"""

OUTPUT_NAMES = ("C{}", "Ch{}", "Chan{}")
"""Names that the fields of RCOU have had, the newest first; where a log has several of them, the last counts."""

OUTPUT_PORTS = 2
"""Number of ports of SERVO_OUTPUT_RAW: ArduPilot has 32 outputs."""


def servo_outputs(tables: Tables) -> NamedMessage:
    """Makes SERVO_OUTPUT_RAW: the pulse widths of outputs 1 to 32, µs, 16 on each port.

    ArduPilot logs them in up to three messages, one after the other in one step of its loop. A port has the stamps of
    the most frequent of its messages, with the latest values of the others. Outputs that were not logged are 0, which
    means no pulses.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").

    Returns:
        Columns (N,), port 0 before port 1, with the names of the messages of the log that have a pulse; port 1 is there
        only where it has one.
    """
    ports: list[Columns] = []
    names: dict[str, None] = {}
    for port in range(OUTPUT_PORTS):
        widths_by_message = {}
        for name in OUTPUT_MESSAGES:
            pulse_widths = _pulse_widths(tables, name, port)
            if pulse_widths:
                widths_by_message[name] = pulse_widths
        # Port 0 is made where there is RCOU, with pulses or not.
        if not widths_by_message and (port > 0 or not tables.get("RCOU")):
            continue
        # A dictionary keeps the names in their order, each once.
        names |= dict.fromkeys(widths_by_message)
        ports.append(_columns_of_port(tables, port, widths_by_message))
    if not ports:
        return NamedMessage("RCOU", {})
    return NamedMessage("/".join(names) or "RCOU", concatenated_columns(ports))


def _pulse_widths(tables: Tables, name: str, port: int) -> dict[int, Array]:
    """Returns the pulse widths that a message of the log has for the outputs of one port of SERVO_OUTPUT_RAW.

    Port 0 has the outputs 1 to 16 of the vehicle, port 1 the outputs 17 to 32. Damaged values are clipped to the 16
    bits of the field.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        name: Name of the message: RCOU, RCO2 or RCO3.
        port: Number of the port, 0 or 1.

    Returns:
        Pulse widths (N,), µs, by the number of the output on the port, 1 to 16. Empty if no output has a pulse.
    """
    logged_columns = tables.get(name, {})
    outputs_before_port = PORT_OUTPUTS * port
    pulse_widths = {}
    for output in OUTPUT_MESSAGES[name]:
        output_on_port = output - outputs_before_port
        if not 1 <= output_on_port <= PORT_OUTPUTS:
            continue
        for pattern in OUTPUT_NAMES:
            field = pattern.format(output)
            if field in logged_columns:
                values = np.nan_to_num(logged_columns[field].astype(np.float64))
                pulse_widths[output_on_port] = np.clip(values, 0, np.iinfo(np.uint16).max)
    has_pulse = any(widths.any() for widths in pulse_widths.values())
    return pulse_widths if has_pulse else {}


def _columns_of_port(
    tables: Tables, port: int, widths_by_message: Mapping[str, Mapping[int, Array]]
) -> Columns:
    """Makes the columns of SERVO_OUTPUT_RAW for one port, from up to three messages of the log.

    The rows have the stamps of the message with most rows. The outputs in another message, which is logged a moment
    later in the same step, have their last value before or at these stamps.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        port: Number of the port, from 0; each has 16 output channels.
        widths_by_message: Pulse widths (n,), µs, by the number of the output on the port, of each message. Without any
            message, all outputs are 0 at the stamps of RCOU.

    Returns:
        Columns (N,): the number of the port, and the pulse width of each output as servo1_raw and so on.
    """
    row_counts = {name: message_count(tables[name]) for name in widths_by_message}
    main_message = max(row_counts, key=row_counts.__getitem__, default="RCOU")
    main_columns = tables[main_message]
    count = message_count(main_columns)
    fields = {"port": np.full(count, port, np.uint8)}
    for output in range(1, PORT_OUTPUTS + 1):
        fields[f"servo{output}_raw"] = np.zeros(count, np.uint16)
    for name, pulse_widths in widths_by_message.items():
        for output, widths in pulse_widths.items():
            if name != main_message:
                main_time = continuous_time(main_columns)
                widths = last_values(main_time, continuous_time(tables[name]), widths)
            fields[f"servo{output}_raw"] = widths.astype(np.uint16)
    return with_stamps(main_columns, fields)
