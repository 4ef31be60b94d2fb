"""Sensors in DataFlash logs of which there may be several: receivers, barometers, compasses, speed controllers.

Each is an instance of a message (``I``) or, in old versions, has a message of its own: BARO, BAR2 and BAR3. The first
becomes the message that MAVLink has for it, the others GPS2_RAW, SCALED_PRESSURE2, SCALED_IMU2 and so on.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.dataflash.attitude import NamedMessage
from mavdem.ingest.dataflash.tables import (
    continuous_time,
    float_table,
    message_count,
    messages_with_fields,
    rows_of_instance,
    with_stamps,
)
from mavdem.ingest.telemetry import (
    Columns,
    SourceFields,
    Tables,
    concatenated_columns,
    fields_by_rule,
    selected_rows,
)
from mavdem.ingest.vocabulary import MILLIMETRES_PER_METRE, UNITS_PER_DEGREE


class SensorMessages(NamedTuple):
    """How the sensors of one kind are logged, and the messages that they become."""

    name: str
    """Message of the first sensor, or of all of them."""
    old_names: tuple[str, ...]
    """Messages of the second and the third sensor in old versions."""
    first_message: str
    """MAVLink's message of the first sensor, whose rule the others share."""
    further_messages: tuple[str, ...]
    """MAVLink's messages of the second and the third sensor."""


SENSORS = (
    SensorMessages(
        "BARO",
        ("BAR2", "BAR3"),
        "SCALED_PRESSURE",
        ("SCALED_PRESSURE2", "SCALED_PRESSURE3"),
    ),
    SensorMessages("MAG", ("MAG2", "MAG3"), "SCALED_IMU", ("SCALED_IMU2", "SCALED_IMU3")),
)
"""Sensors whose messages are made by rules of ``translation.toml``."""

ACCELEROMETER_FIELDS = {"xacc": "AccX", "yacc": "AccY", "zacc": "AccZ"}
"""Fields of the table of accelerometers, and of DataFlash's IMU, both in m/s²."""

OLD_IMU_MESSAGES = ("IMU2", "IMU3")
"""Messages of the second and the third IMU in old versions."""

MAX_ESCS = 8
"""Number of speed controllers that have a message of their own in old versions: ESC1 to ESC8."""

OLD_ESC_MESSAGES = tuple(f"ESC{number}" for number in range(1, MAX_ESCS + 1))
"""Those messages."""

FURTHER_SENSOR_MESSAGES = (
    "GPS2",
    *OLD_IMU_MESSAGES,
    *(name for sensor in SENSORS for name in sensor.old_names),
)
"""Messages of further sensors in old versions."""

INSTANCE_FIELD = "I"
"""Field with the number of the sensor, from 0."""


def rows_of_sensor(tables: Tables, name: str, old_names: tuple[str, ...], number: int) -> Columns:
    """Returns the messages of one of several equal sensors, such as barometers.

    New versions of ArduPilot log all of them in one message, with the number of the sensor in a field. In old versions
    each sensor has a message of its own, such as BARO, BAR2 and BAR3.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        name: Name of the message of the first sensor, or of all of them ("BARO").
        old_names: Names of the messages of the second sensor and so on in old versions ("BAR2", "BAR3").
        number: Number of the sensor, from 0.

    Returns:
        The messages; empty if it was not logged.
    """
    logged_columns = tables.get(name, {})
    if INSTANCE_FIELD in logged_columns:
        return rows_of_instance(logged_columns, INSTANCE_FIELD, number)
    if number == 0:
        return logged_columns
    return tables.get(old_names[number - 1], {})


def further_sensors(
    tables: Tables, rules: Mapping[str, Mapping[str, SourceFields]]
) -> dict[str, NamedMessage]:
    """Makes the MAVLink messages of the second and third barometer and compass.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        rules: Translation rules of the first sensor's messages, by name.

    Returns:
        Messages by their MAVLink name; sensors that were not logged are missing.
    """
    messages = {}
    for sensor in SENSORS:
        rule = rules[sensor.first_message]
        for number, message in enumerate(sensor.further_messages, 1):
            logged_columns = rows_of_sensor(tables, sensor.name, sensor.old_names, number)
            if not message_count(logged_columns):
                continue
            try:
                fields = fields_by_rule(logged_columns, rule)
            except KeyError:
                # A required field was not logged.
                continue
            name = _name_in_log(logged_columns, sensor.name, sensor.old_names, number)
            messages[message] = NamedMessage(name, with_stamps(logged_columns, fields))
    return messages


def further_accelerometers(tables: Tables) -> NamedMessage:
    """Makes the table of the accelerometers of the second and the third IMU; the first one's is HIGHRES_IMU.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").

    Returns:
        Specific force on three axes, with the number of each sensor as ``instance``, in the order of time.
    """
    tables_of_imus: list[Columns] = []
    for number in (1, 2):
        logged_columns = rows_of_sensor(tables, "IMU", OLD_IMU_MESSAGES, number)
        logged_columns = messages_with_fields(
            {"IMU": logged_columns}, "IMU", tuple(ACCELEROMETER_FIELDS.values())
        )
        if logged_columns:
            fields: dict[str, NDArray[Any]] = {
                name: logged_columns[field] for name, field in ACCELEROMETER_FIELDS.items()
            }
            fields["instance"] = np.full(message_count(logged_columns), number)
            tables_of_imus.append(with_stamps(logged_columns, fields))
    if not tables_of_imus:
        return NamedMessage("IMU", {})
    columns = concatenated_columns(tables_of_imus)
    order = np.argsort(continuous_time(columns), kind="stable")
    return NamedMessage("IMU", selected_rows(columns, order))


RECEIVER_MESSAGES = ("GPA", "GPA2", "UBX1")
"""Further messages of the receivers: their accuracy, that of the second one in old versions, and their noise."""

ACCURACY_FIELDS = {"h_acc": "HAcc", "v_acc": "VAcc", "vel_acc": "SAcc"}
"""Fields of GPA with the accuracy that a receiver states, m and m/s, by those of GPS_RAW_INT, mm and mm/s."""

NOISE_FIELDS = {"noise_per_ms": "noisePerMS", "jamming_indicator": "jamInd"}
"""Fields of UBX1, of u-blox receivers, by the names that PX4 has for them; MAVLink has none."""

STATUS_3D_FIX = 3
"""Value of GPS.Status from which on the position is known in three dimensions, and the time too."""


def _name_in_log(logged_columns: Columns, name: str, old_names: Sequence[str], number: int) -> str:
    """Returns the name under which a log has the messages of one of several sensors.

    Args:
        logged_columns: The messages of this sensor.
        name: Name of the first sensor's messages, "BARO".
        old_names: Names of the messages of the second sensor and so on in old versions, "BAR2".
        number: Number of the sensor, from 0.

    Returns:
        "BARO", "BARO[1]", or "BAR2" in old logs.
    """
    if number == 0:
        return name
    if INSTANCE_FIELD in logged_columns:
        return f"{name}[{number}]"
    return old_names[number - 1]


def gps_fixes(tables: Tables, number: int) -> NamedMessage:
    """Makes GPS_RAW_INT of the first receiver, or GPS2_RAW of the second: fix, satellites, dilution and position.

    Latitude and longitude are in 1e-7 degrees, 0 where there is no three-dimensional fix; the altitude is in mm.
    ``eph`` is the horizontal dilution of precision times 100, as in MAVLink. Accuracy, noise and jamming are logged in
    separate messages, whose last values before each fix are used.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        number: Number of the receiver, 0 or 1.

    Returns:
        A row for each fix; no columns if the receiver was not logged.
    """
    fields = ("Status", "NSats", "HDop", "Lat", "Lng")
    logged_columns = rows_of_sensor(tables, "GPS", ("GPS2",), number)
    name = _name_in_log(logged_columns, "GPS", ("GPS2",), number)
    logged_columns = messages_with_fields({"GPS": logged_columns}, "GPS", fields)
    if not logged_columns:
        return NamedMessage(name, {})
    status, satellites, dilution, latitude, longitude = float_table(logged_columns, fields).T
    units_per_degree = np.where(status >= STATUS_3D_FIX, UNITS_PER_DEGREE, 0.0)
    columns = {
        "fix_type": status,
        "satellites_visible": satellites,
        "eph": 100 * dilution,
        "lat": units_per_degree * latitude,
        "lon": units_per_degree * longitude,
    }
    if "Alt" in logged_columns:
        columns["alt"] = MILLIMETRES_PER_METRE * logged_columns["Alt"].astype(float)
    accuracy = rows_of_sensor(tables, "GPA", ("GPA2",), number)
    columns |= _last_values_at(logged_columns, accuracy, ACCURACY_FIELDS, MILLIMETRES_PER_METRE)
    noise = tables.get("UBX1", {})
    if noise:
        noise = rows_of_instance(noise, "Instance", number)
    columns |= _last_values_at(logged_columns, noise, NOISE_FIELDS)
    return NamedMessage(name, with_stamps(logged_columns, columns))


def _last_values_at(
    target: Columns, source: Columns, names: Mapping[str, str], factor: float = 1.0
) -> dict[str, NDArray[Any]]:
    """Returns the last values of fields of one message at the stamps of another, by their new names.

    Args:
        target: The message (T rows) with the stamps.
        source: The message (N rows) with the fields; those that it does not have are left out.
        names: Names of the fields in ``source``, by their new names.
        factor: Factor by which the values are multiplied.

    Returns:
        Columns (T,), NaN before the first message.
    """
    if not message_count(source):
        return {}
    time = continuous_time(source)
    order = np.argsort(time, kind="stable")
    last_rows = np.searchsorted(time[order], continuous_time(target), side="right") - 1
    columns = {}
    for name, field in names.items():
        if field in source:
            values = source[field][order].astype(float) * factor
            columns[name] = np.where(last_rows >= 0, values[np.maximum(last_rows, 0)], np.nan)
    return columns


def motor_speeds(tables: Tables) -> NamedMessage:
    """Makes ESC: the speed of each motor, RPM, with the number of its controller, from 0, as ``Instance``.

    If logged, there are also the current ``Curr``, A, the temperature ``Temp``, °C, and the errors.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").

    Returns:
        The message, in the order of time; without columns where no speed was logged.
    """
    logged_columns = messages_with_fields(tables, "ESC", ("RPM",))
    if logged_columns:
        return NamedMessage("ESC", logged_columns)
    # In old versions of ArduPilot each controller has a message of its own.
    tables_of_controllers: list[Columns] = []
    for number, name in enumerate(OLD_ESC_MESSAGES):
        controller = messages_with_fields(tables, name, ("RPM",))
        if not controller:
            continue
        fields = {
            "RPM": controller["RPM"],
            "Instance": np.full(message_count(controller), number),
        }
        for field in ("Curr", "Temp"):
            if field in controller:
                fields[field] = controller[field]
        tables_of_controllers.append(with_stamps(controller, fields))
    if not tables_of_controllers:
        return NamedMessage("ESC", {})
    columns = concatenated_columns(tables_of_controllers)
    order = np.argsort(continuous_time(columns), kind="stable")
    return NamedMessage("ESC1 to ESC8", selected_rows(columns, order))
