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
        tables: DataFlash's messages by name.

    Returns:
        Columns (N,), port 0 before port 1, with the names of the messages of the log that have a pulse; port 1 is there
        only where it has one.
    """
    ports: list[Columns] = []
    names: dict[str, None] = {}
    for port in range(OUTPUT_PORTS):
        messages_of_port = {}
        for name in OUTPUT_MESSAGES:
            pulse_widths = _pulse_widths_of_port(tables, name, port)
            if pulse_widths:
                messages_of_port[name] = pulse_widths
        # Port 0 is made where there is RCOU, with pulses or not.
        if not messages_of_port and (port > 0 or not tables.get("RCOU")):
            continue
        names |= dict.fromkeys(messages_of_port)
        ports.append(_servo_output_port(tables, port, messages_of_port))
    if not ports:
        return NamedMessage("RCOU", {})
    return NamedMessage("/".join(names) or "RCOU", concatenated_columns(ports))


def _pulse_widths_of_port(tables: Tables, name: str, port: int) -> dict[int, Array]:
    """Returns the pulse widths of the outputs of one port in one message that the log has.

    Args:
        tables: DataFlash's messages by name.
        name: RCOU, RCO2 or RCO3.
        port: Number of the port, 0 or 1.

    Returns:
        Pulse widths (N,), µs, by the number of the output on the port, 1 to 16. Damaged values are clipped to the 16
        bits of the field. Empty if no output has a pulse.
    """
    logged_columns = tables.get(name, {})
    first_output = 1 + PORT_OUTPUTS * port
    pulse_widths = {}
    for output in OUTPUT_MESSAGES[name]:
        if not first_output <= output < first_output + PORT_OUTPUTS:
            continue
        for pattern in OUTPUT_NAMES:
            if pattern.format(output) in logged_columns:
                values = np.nan_to_num(logged_columns[pattern.format(output)].astype(np.float64))
                clipped_widths = np.clip(values, 0, np.iinfo(np.uint16).max)
                pulse_widths[output - PORT_OUTPUTS * port] = clipped_widths
    has_pulse = any(widths.any() for widths in pulse_widths.values())
    return pulse_widths if has_pulse else {}


def _servo_output_port(
    tables: Tables, port: int, messages_of_port: Mapping[str, Mapping[int, Array]]
) -> Columns:
    """Makes SERVO_OUTPUT_RAW of one port.

    Args:
        tables: DataFlash's messages by name.
        port: Number of the port.
        messages_of_port: Pulse widths (n,), µs, by name of the message and number of the output on the port. If it is
            empty, all outputs are 0 at the stamps of RCOU.

    Returns:
        Columns (n,): the port, and the pulse width of each output as servo1_raw and so on.
    """
    main_message = max(
        messages_of_port, key=lambda name: message_count(tables[name]), default="RCOU"
    )
    logged_columns = tables[main_message]
    count = message_count(logged_columns)
    fields = {"port": np.full(count, port, np.uint8)}
    for output in range(1, PORT_OUTPUTS + 1):
        fields[f"servo{output}_raw"] = np.zeros(count, np.uint16)
    for name, pulse_widths in messages_of_port.items():
        for output, widths in pulse_widths.items():
            if name != main_message:
                # RCO2 and RCO3 follow RCOU in the same step, with the same stamp or a later one.
                widths = last_values(
                    continuous_time(logged_columns), continuous_time(tables[name]), widths
                )
            fields[f"servo{output}_raw"] = widths.astype(np.uint16)
    return with_stamps(logged_columns, fields)
