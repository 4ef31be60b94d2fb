"""MAVLink messages of motors and their speed controllers from PX4's topics; each function makes one message.

PX4 translates in the same way when it sends these messages; each function names the file of
https://github.com/PX4/PX4-Autopilot/tree/main/src/modules/mavlink/streams it agrees with. A function raises KeyError
where a topic, or a field of it, was not logged.
"""

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.ingest.motor_geometry import MAX_PX4_ROTORS, motor_geometry
from mavdem.ingest.motors import PORT_OUTPUTS
from mavdem.ingest.px4_topics import (
    Topics,
    first_instance,
    in_time_order,
)
from mavdem.ingest.telemetry import (
    Columns,
    Fields,
    Parameters,
    selected_rows,
)

MIN_TURNS_PER_DRIVER = 2
"""Changes of ``noutputs`` per driver from which on drivers publish in turn; with fewer, the number changed once."""


def servo_output_raw(topics: Topics) -> Fields:
    """Makes SERVO_OUTPUT_RAW (SERVO_OUTPUT_RAW.hpp) from actuator_outputs: each instance of the topic is a port of 16.

    The decimals that the message would cut off are kept. If two drivers publish the same instance by turns, each
    becomes a port: the driver whose first output has the largest range gets the number of the instance.

    Args:
        topics: The logged topics, by name and number of the instance.

    Returns:
        ``time`` (N,), s, ``port`` and the 16 outputs in the unit of the driver, in the order of time.
    """
    tables_of_ports = []
    for instance, topic in topics.get("actuator_outputs", {}).items():
        drivers = sorted(_messages_by_driver(topic), key=_range_of_first_output, reverse=True)
        for driver_number, driver in enumerate(drivers):
            # No instance has such a large number, so that every driver gets a port of its own.
            port_number = instance + PORT_OUTPUTS * driver_number
            outputs = _used_outputs(driver)
            fields: Fields = {"time": driver["time"]}
            fields["port"] = np.full(len(outputs), port_number, dtype=np.uint8)
            for index in range(PORT_OUTPUTS):
                fields[f"servo{index + 1}_raw"] = outputs[:, index]
            tables_of_ports.append(fields)
    return in_time_order(tables_of_ports)


def _messages_by_driver(topic: Columns) -> list[Columns]:
    """Splits one instance of actuator_outputs by the output driver that published its messages.

    Two drivers have different numbers of outputs (``noutputs``), which then alternate from message to message. A few
    changes of the number are no second driver.

    Args:
        topic: Columns (N,) of the instance.

    Returns:
        Columns of the messages of each driver.
    """
    output_counts = topic.get("noutputs", np.zeros(len(topic["time"])))
    alternations = np.count_nonzero(np.diff(output_counts))
    distinct_counts = np.unique(output_counts)
    if not alternations or alternations < MIN_TURNS_PER_DRIVER * len(distinct_counts):
        return [topic]
    return [selected_rows(topic, output_counts == count) for count in distinct_counts]


def _range_of_first_output(topic: Columns) -> float:
    """Returns the difference of the largest and the smallest value of the first output of actuator_outputs."""
    return float(np.ptp(topic["output[0]"]))


def _used_outputs(topic: Columns) -> Array:
    """Returns the outputs in actuator_outputs, with 0 for those that are not in use.

    Outputs from index ``noutputs`` on are not in use, and may contain old values. If ``noutputs`` is 0 or was not
    logged, all outputs are kept.

    Args:
        topic: Columns (N,) of actuator_outputs.

    Returns:
        The outputs (N, 16).
    """
    zeros = np.zeros(len(topic["time"]))
    columns = [topic.get(f"output[{n}]", zeros) for n in range(PORT_OUTPUTS)]
    outputs = np.column_stack(columns).astype(np.float64)
    output_count = topic.get("noutputs", zeros)[:, None]
    is_unused = (output_count > 0) & (np.arange(PORT_OUTPUTS) >= output_count)
    return np.where(is_unused, 0.0, outputs)


def hil_actuator_controls(topics: Topics, vehicle: str, parameters: Parameters) -> Fields:
    """Makes HIL_ACTUATOR_CONTROLS, outputs as fractions of their range, from actuator_motors (PX4 1.13 and later).

    The topic is indexed by motor, the message by channel: each motor is put on the channel that the parameters state. A
    motor that is off, NaN in the topic, becomes 0.

    Args:
        topics: Columns of the logged topics, by name and number of the instance.
        vehicle: MAV_TYPE without its prefix ("QUADROTOR").
        parameters: The autopilot's parameters by name. Without them motor n is put on channel n.

    Returns:
        ``time`` (N,), s, and ``controls`` (N, 16), 0 to 1 of the range.
    """
    topic = first_instance(topics, "actuator_motors")
    # Motors and channels count from 1, the fields of the topic and the columns of the message from 0.
    motors = range(1, MAX_PX4_ROTORS + 1)
    all_channels = range(1, PORT_OUTPUTS + 1)
    channel_of_motor = {motor: motor for motor in motors}
    geometry = motor_geometry(vehicle, "PX4", parameters, all_channels, PORT_OUTPUTS)
    if geometry is not None and not geometry.channels_assumed:
        channel_of_motor = dict(zip(geometry.motors, geometry.channels, strict=True))
    controls = np.zeros((len(topic["control[0]"]), PORT_OUTPUTS))
    for motor in motors:
        field = f"control[{motor - 1}]"
        if field not in topic or motor not in channel_of_motor:
            continue
        control = topic[field]
        is_on = np.isfinite(control)
        column = channel_of_motor[motor] - 1
        controls[:, column] = np.where(is_on, control, 0.0)
    return {"time": topic["time"], "controls": controls}


MAX_ESCS = 8
"""Number of speed controllers for which esc_status has room."""

FIRST_MOTOR_FUNCTION = 101
"""Value of ``actuator_function`` of the first motor; those of the others follow (PX4's ``functions.hpp``)."""

MAX_MOTORS = 12
"""Number of motors that have a value of ``actuator_function``."""

MAX_ESC_CELSIUS = 200.0
"""Temperature, °C, that no speed controller survives: larger numbers are in K, as those of DroneCAN's were before PX4
converted them."""

ZERO_CELSIUS = 273.15
"""0 °C in K."""


def motor_speeds(topics: Topics) -> Fields:
    """Makes ESC, the message of DataFlash logs with the speeds of motors, from esc_status: a row for each controller.

    Args:
        topics: The logged topics, by name and number of the instance.

    Returns:
        ``time`` (N,), s, the number of the controller from 0 as ``Instance``, the size of its speed as ``RPM`` (some
        report a sign for the direction), and if logged its current ``Curr``, A, temperature ``Temp``, °C,
        ``ErrorCount``, since boot, and the number of its motor from 1 as ``Motor``, 0 for none.
    """
    topic = first_instance(topics, "esc_status")
    controllers = []
    for instance in range(MAX_ESCS):
        if f"esc[{instance}].esc_rpm" not in topic:
            break
        is_online = _is_online(topic, instance)
        if is_online.any():
            controllers.append(_speed_controller(selected_rows(topic, is_online), instance))
    return in_time_order(controllers)


def _is_online(topic: Columns, instance: int) -> Flags:
    """Flags the messages of esc_status in which a speed controller reports.

    It is flagged by the field esc_online_flags or, without it, by the number of controllers. If neither was logged, a
    controller whose speed is ever above 0 reports in all messages.

    Args:
        topic: Columns (N,) of esc_status.
        instance: Number of the speed controller, from 0.

    Returns:
        Flags (N,).
    """
    if "esc_online_flags" in topic:
        # Bit n of the flags belongs to controller n.
        return topic["esc_online_flags"].astype(np.int64) >> instance & 1 > 0
    if "esc_count" in topic:
        return np.asarray(topic["esc_count"] > instance)
    has_turned = bool(topic[f"esc[{instance}].esc_rpm"].any())
    return np.full(len(topic["time"]), has_turned)


def _in_celsius(temperature: Array) -> Array:
    """Converts the temperatures of a speed controller to °C, if it reports kelvins.

    Kelvins are recognised by a median that would be too hot in °C.

    Args:
        temperature: Temperatures (N,) as they were logged; 0 or NaN before the first report of the controller.

    Returns:
        Temperatures (N,), °C; of a controller that reports kelvins NaN before its first report.
    """
    is_reported = temperature > 0
    is_in_kelvin = is_reported.any() and np.median(temperature[is_reported]) > MAX_ESC_CELSIUS
    if not is_in_kelvin:
        return temperature
    return np.where(is_reported, temperature - ZERO_CELSIUS, np.nan)


def _speed_controller(topic: Columns, instance: int) -> Fields:
    """Makes the columns of the table ESC for one speed controller.

    Args:
        topic: Messages of esc_status in which it reports, N rows.
        instance: Number of the controller, from 0.

    Returns:
        Columns of N rows by field name, such as "RPM" and "Temp".
    """
    field = f"esc[{instance}]."
    fields: Fields = {
        "time": topic["time"],
        "Instance": np.full(len(topic["time"]), instance),
        "RPM": abs(topic[f"{field}esc_rpm"].astype(np.float64)),
    }
    if f"{field}esc_current" in topic:
        fields["Curr"] = topic[f"{field}esc_current"]
    if f"{field}esc_temperature" in topic:
        fields["Temp"] = _in_celsius(topic[f"{field}esc_temperature"].astype(np.float64))
    if f"{field}esc_errorcount" in topic:
        fields["ErrorCount"] = topic[f"{field}esc_errorcount"]
    if f"{field}actuator_function" in topic:
        motor = 1 + topic[f"{field}actuator_function"].astype(np.int64) - FIRST_MOTOR_FUNCTION
        fields["Motor"] = np.where((motor >= 1) & (motor <= MAX_MOTORS), motor, 0)
    return fields
