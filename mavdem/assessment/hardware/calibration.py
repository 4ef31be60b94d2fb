"""Which sensors are there and calibrated, as a fact (a coded finding), by the tests that the autopilot makes to arm."""

from collections.abc import Iterator
from typing import NamedTuple

from mavdem.facts import Fact, Level
from mavdem.facts.hardware import HardwareFact
from mavdem.ingest.telemetry import Parameters, Telemetry

MAX_SENSORS = 4
"""Number of sensors of a kind that have parameters: 3 in ArduPilot, 4 in PX4."""

BUSES = {1: "I2C", 2: "SPI", 3: "CAN", 4: "simulated", 5: "MSP", 6: "serial"}
"""Buses of a sensor, by the lower three bits of its device id, in ArduPilot (AP_HAL/Device.h) and PX4
(src/lib/drivers/device/Device.hpp)."""

BUS_BITS, BUS_NUMBER_BITS = 3, 5
"""Bits of a device id with the type of the bus, and above them with its number."""


class SensorParameters(NamedTuple):
    """Names of the parameters of one kind of sensor of ArduPilot; "{}" stands for the number of the sensor.

    The first sensor has no number in them, but in the names of priorities.
    """

    kind: str
    """Kind of sensor."""
    identifier_name: str
    """Parameter with the device id of a sensor, 0 if there is none."""
    offset_prefix: str
    """Beginning of the parameters with the offsets of a sensor, which are all 0 before it is calibrated."""
    use_name: str
    """Parameter that says whether a sensor is used."""
    priority_name: str = ""
    """Parameter with a device id by priority, which then numbers the sensors in logs; empty without one."""
    enable_name: str = ""
    """Parameter that switches all sensors of the kind off, by 0; empty without one."""


ARDUPILOT_SENSORS = (
    SensorParameters("accelerometer", "INS_ACC{}_ID", "INS_ACC{}OFFS_", "INS_USE{}"),
    SensorParameters(
        "compass",
        "COMPASS_DEV_ID{}",
        "COMPASS_OFS{}_",
        "COMPASS_USE{}",
        "COMPASS_PRIO{}_ID",
        "COMPASS_ENABLE",
    ),
)
"""ArduPilot's sensors that are calibrated before the first flight. ``AP_Arming`` refuses to arm if one that is used
has no offsets ("3D Accel calibration needed", "Compass not calibrated")."""

PX4_SENSORS = {"accelerometer": "CAL_ACC{}", "gyro": "CAL_GYRO{}", "compass": "CAL_MAG{}"}
"""Beginnings of the parameters of PX4's sensors: with _ID, the device that was calibrated, 0 for none; with _PRIO, its
priority, 0 if it is switched off."""


class CalibratedSensor(NamedTuple):
    """One sensor that the parameters name."""

    name: str
    """Its kind and number, from 1: "compass 2"."""
    bus: str
    """The bus it is on: "SPI 1"; empty if that is not known."""
    is_used: bool
    """Whether the autopilot uses it."""
    is_calibrated: bool
    """Whether it was calibrated."""


def calibration_fact(telemetry: Telemetry) -> Fact | None:
    """Returns the fact about the calibration of the sensors; it warns if a used one is not calibrated.

    Args:
        telemetry: messages of the vehicle as columns, and its parameters.

    Returns:
        A fact with the ``names`` of the calibrated sensors in use, and of those ``missing`` a calibration; None if no
        sensor is used.
    """
    used_sensors = [sensor for sensor in sensors_in_parameters(telemetry) if sensor.is_used]
    if not used_sensors:
        return None
    uncalibrated_names = [sensor.name for sensor in used_sensors if not sensor.is_calibrated]
    return Fact(
        HardwareFact.SENSORS_CALIBRATED,
        Level.WATCH if uncalibrated_names else Level.GOOD,
        names=[sensor.name for sensor in used_sensors if sensor.is_calibrated],
        missing=uncalibrated_names,
    )


def sensors_in_parameters(telemetry: Telemetry) -> Iterator[CalibratedSensor]:
    """Yields the sensors that the autopilot's parameters name: accelerometers, then gyros and compasses.

    Args:
        telemetry: messages of the vehicle as columns, and its parameters.
    """
    if telemetry.autopilot == "PX4":
        yield from _px4_sensors(telemetry.parameters)
    else:
        yield from _ardupilot_sensors(telemetry.parameters)


def _ardupilot_sensors(parameters: Parameters) -> Iterator[CalibratedSensor]:
    """Yields ArduPilot's accelerometers and compasses, each in the order in which its logs number them.

    Compasses are numbered by their priority, if parameters define one. Sensors without parameters of their offsets are
    left out, since a stream may have only some of the parameters.

    Args:
        parameters: parameters of the autopilot, by name.
    """
    for sensor_type in ARDUPILOT_SENSORS:
        are_enabled = parameters.get(sensor_type.enable_name, 1) > 0
        calibrated_by_id = _calibrated_by_device_id(parameters, sensor_type)
        priority_name = sensor_type.priority_name
        if priority_name and parameters.get(priority_name.format(1), 0):
            numbers_in_logs = _numbers_by_device_id(
                parameters, priority_name, is_first_numbered=True
            )
        else:
            numbers_in_logs = _numbers_by_device_id(parameters, sensor_type.identifier_name)
        for device_id, number in numbers_in_logs.items():
            if device_id not in calibrated_by_id:
                continue
            use_name = sensor_type.use_name.format(_number_in_name(number))
            yield CalibratedSensor(
                f"{sensor_type.kind} {number}",
                bus_name(device_id),
                is_used=are_enabled and parameters.get(use_name, 1) > 0,
                is_calibrated=calibrated_by_id[device_id],
            )


def _calibrated_by_device_id(
    parameters: Parameters, sensor_type: SensorParameters
) -> dict[int, bool]:
    """Returns whether each of ArduPilot's sensors of one type was calibrated: whether any of its offsets is not 0.

    Args:
        parameters: parameters of the autopilot, by name.
        sensor_type: names of the parameters of these sensors.

    Returns:
        By device id, True if the sensor was calibrated; sensors without all three offsets are left out.
    """
    calibrated_by_id = {}
    numbers = _numbers_by_device_id(parameters, sensor_type.identifier_name)
    for device_id, number in numbers.items():
        prefix = sensor_type.offset_prefix.format(_number_in_name(number))
        offset_names = [f"{prefix}{axis}" for axis in "XYZ"]
        if all(name in parameters for name in offset_names):
            calibrated_by_id[device_id] = any(parameters[name] for name in offset_names)
    return calibrated_by_id


def _number_in_name(number: int) -> str:
    """Returns the number of a sensor as ArduPilot has it in most names of parameters: empty for the first one."""
    return "" if number == 1 else str(number)


def _numbers_by_device_id(
    parameters: Parameters, id_name: str, *, is_first_numbered: bool = False
) -> dict[int, int]:
    """Returns the number of each of ArduPilot's sensors of one type, by its device id.

    Each sensor has a parameter with its device id, whose name contains the number, such as INS_ACC2_ID.

    Args:
        parameters: values of the autopilot's parameters by their names.
        id_name: name of these parameters; "{}" stands for the number of the sensor.
        is_first_numbered: whether the name of the first sensor's parameter has a number too.

    Returns:
        The number of the sensor, from 1, by device id. If several parameters have the same id, the first one counts.
    """
    numbers: dict[int, int] = {}
    for number in range(1, MAX_SENSORS + 1):
        number_in_name = str(number) if is_first_numbered else _number_in_name(number)
        device_id = int(parameters.get(id_name.format(number_in_name), 0))
        if device_id:
            numbers.setdefault(device_id, number)
    return numbers


def _px4_sensors(parameters: Parameters) -> Iterator[CalibratedSensor]:
    """Yields PX4's accelerometers, gyros and compasses; all are calibrated, since others have no parameters.

    Args:
        parameters: parameters of the autopilot, by name.
    """
    for sensor_type, prefix in PX4_SENSORS.items():
        # PX4 numbers the sensors of a type from 0, names of sensors here begin with 1.
        for index in range(MAX_SENSORS):
            parameter_prefix = prefix.format(index)
            device_id = int(parameters.get(f"{parameter_prefix}_ID", 0))
            if not device_id:
                continue
            # A sensor with the priority 0 is switched off.
            is_used = parameters.get(f"{parameter_prefix}_PRIO", -1) != 0
            yield CalibratedSensor(
                f"{sensor_type} {index + 1}", bus_name(device_id), is_used, is_calibrated=True
            )


def bus_name(identifier: int) -> str:
    """Returns the bus of a device id with its number: "SPI 1"; empty if the type of the bus is not known.

    Args:
        identifier: the id. Its lowest ``BUS_BITS`` are the type of the bus, the next ``BUS_NUMBER_BITS`` its number.
    """
    number_and_device, bus_code = divmod(identifier, 1 << BUS_BITS)
    if bus_code not in BUSES:
        return ""
    number = number_and_device % (1 << BUS_NUMBER_BITS)
    return f"{BUSES[bus_code]} {number}"
