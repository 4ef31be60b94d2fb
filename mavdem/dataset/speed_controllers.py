"""Speed controllers (ESCs): the speed of each motor as measured by its controller, and the controller's error counts.

Each log names them in its own way: DataFlash's ESC and PX4's esc_status (both translated to ESC), MAVLink's ESC_STATUS
with ESC_INFO (PX4), and ESC_TELEMETRY_1_TO_4 to 29_TO_32 (ArduPilot). Controllers are numbered from 1 here, as
ground stations do.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array, Flags
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, clean_series, float_column
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.ingest.motors import MotorGeometry
from mavdem.ingest.telemetry import Columns, Telemetry, rows_by_value, selected_rows

CONTROLLERS_PER_MESSAGE = 4
"""Number of controllers of which one ESC_STATUS, ESC_INFO or ESC_TELEMETRY message reports."""

FIRST_NUMBERS = range(1, 33, CONTROLLERS_PER_MESSAGE)
"""Numbers of the first controller of each ESC_TELEMETRY message."""

MAX_SPEED = 500_000.0
"""Speed, 1/min, that no motor reaches, not even the electrical one of ArduPilot's ESCs with 28 poles; faster ones are
damaged messages."""


HUNDREDTH = 0.01
"""Unit of the temperature of ESC_INFO, °C, and of the current of ESC_TELEMETRY, A."""

UNKNOWN_INFO_TEMPERATURE = 32767
"""Temperature of ESC_INFO that means "not known": INT16_MAX, by MAVLink's common.xml."""


@dataclass(frozen=True, eq=False)
class SpeedController:
    """One electronic speed controller that reports the speed of its motor."""

    number: int
    """Number of the controller, from 1."""
    speed: TimeSeries
    """Speed of the motor (N,), 1/min, whatever its direction."""
    error_count: TimeSeries | None = None
    """Errors that the controller counted since boot (M,); None where it reports no count."""
    error_share: TimeSeries | None = None
    """Share of its messages that were damaged (K,), 0 to 1, as DataFlash logs it; None where that is not known."""
    motor: int | None = None
    """Number of its motor, from 1, where the log has it, as PX4's has since 1.14."""
    current: TimeSeries | None = None
    """Current (I,), A; None where it is not measured."""
    temperature: TimeSeries | None = None
    """Temperature (T,), °C; None where it is not measured."""

    @property
    def name(self) -> str:
        """Name of the controller: "ESC 2"."""
        return f"ESC {self.number}"

    def motor_index(self, geometry: MotorGeometry) -> int | None:
        """Returns which of a vehicle's motors the controller drives.

        If the log does not name the motor, the number of the controller is taken for its output channel, as in
        ArduPilot, and in PX4 if channels are numbered like the motors.

        Args:
            geometry: Number and output channel of each motor, in the order of the motors.

        Returns:
            The index of the motor in ``geometry``; None if it drives none of them.
        """
        if self.motor is not None:
            numbers = geometry.motors
            number_of_motor = self.motor
        else:
            numbers = geometry.channels
            number_of_motor = self.number
        if number_of_motor not in numbers:
            return None
        return numbers.index(number_of_motor)


@cached_per_vehicle()
def speed_controllers(signals: Signals) -> tuple[SpeedController, ...]:
    """Returns the speed controllers that report the speed of a motor, by number.

    The first message type with any speed is used: DataFlash's ESC, ESC_STATUS, or ESC_TELEMETRY.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        Speed controllers in the order of their numbers; empty if none reports a speed.
    """
    telemetry = signals.telemetry
    for read_controllers in (
        _controllers_of_esc,
        _controllers_of_esc_status,
        _controllers_of_esc_telemetry,
    ):
        controllers = tuple(read_controllers(telemetry))
        if controllers:
            return controllers
    return ()


def _field_series(columns: Columns, values: Array, rows: Flags | None = None) -> TimeSeries | None:
    """Extracts the time series of one field from a message of motor speed controllers (ESCs).

    Args:
        columns: fields of the message in N messages, with ``time`` and ``boot``.
        values: (N,) the field, in any unit.
        rows: Flags (N,) of the messages to use, such as those of one controller; all unless given.

    Returns:
        The finite values in the order of time; None if there are none.
    """
    series = clean_series(columns, values, rows)
    return series if len(series.time) else None


def _measured_series(
    columns: Columns, values: Array, rows: Flags | None = None
) -> TimeSeries | None:
    """Extracts a current or a temperature of a motor speed controller (ESC), if the controller measures it.

    Controllers without such a sensor send 0.

    Args:
        columns: fields of the message in N messages, with ``time`` and ``boot``.
        values: (N,) the current, A, or the temperature, °C.
        rows: Flags (N,) of the messages to use, such as those of one controller; all unless given.

    Returns:
        The finite values in the order of time; None if all are 0, so that nothing was measured.
    """
    series = _field_series(columns, values, rows)
    return series if series is not None and series.values.any() else None


def _speed_series(columns: Columns, speed: Array, rows: Flags | None = None) -> TimeSeries | None:
    """Extracts the speed of a motor, without the sign that some controllers use for reverse rotation.

    Args:
        columns: fields of the message in N messages, with ``time`` and ``boot``.
        speed: (N,) speed, revolutions per minute.
        rows: Flags (N,) of the messages to use, such as those of one controller; all unless given.

    Returns:
        Magnitudes up to ``MAX_SPEED``, 1/min, in the order of time; None if there are none.
    """
    magnitude = abs(speed)
    is_used = magnitude <= MAX_SPEED
    if rows is not None:
        is_used = is_used & rows
    return _field_series(columns, magnitude, is_used)


def _controllers_of_esc(telemetry: Telemetry) -> Iterator[SpeedController]:
    """Yields the speed controllers in ESC, DataFlash's message with a row for each controller at each time.

    Args:
        telemetry: messages of the vehicle.

    Yields:
        Each controller with a possible speed. Its number is the instance plus 1; errors, current, A, and temperature,
        °C, are None where the log has no such field.
    """
    columns = telemetry.messages.get("ESC", {})
    if "Instance" not in columns:
        return
    for instance, rows in rows_by_value(columns["Instance"].astype(np.int64)).items():
        controller = selected_rows(columns, rows)
        speed = _speed_series(controller, float_column(controller, "RPM"))
        if speed is None:
            continue
        error_count = error_share = current = temperature = None
        if "ErrorCount" in controller:
            error_count = _field_series(controller, float_column(controller, "ErrorCount"))
        if "Err" in controller:
            # A percentage of the controller's messages.
            error_share = _field_series(controller, float_column(controller, "Err") / 100)
        if "Curr" in controller:
            current = _measured_series(controller, float_column(controller, "Curr"))
        if "Temp" in controller:
            temperature = _measured_series(controller, float_column(controller, "Temp"))
        # The number of the motor is 0 for none.
        motor = int(controller["Motor"][0]) if "Motor" in controller else 0
        yield SpeedController(
            instance + 1,
            speed=speed,
            error_count=error_count,
            error_share=error_share,
            motor=motor or None,
            current=current,
            temperature=temperature,
        )


def _controllers_of_esc_status(telemetry: Telemetry) -> Iterator[SpeedController]:
    """Yields the speed controllers in ESC_STATUS, with the errors and temperatures in ESC_INFO.

    A message of either type has the values of a group of four controllers, from number ``index`` on.

    Args:
        telemetry: messages of the vehicle.

    Yields:
        Each controller: number from 1, speed, 1/min, errors since boot, current, A, and temperature, °C; the last three
        are None if they were not sent.
    """
    status = telemetry.messages.get("ESC_STATUS", {})
    information = telemetry.messages.get("ESC_INFO", {})
    if "rpm" not in status or "index" not in status:
        return
    controller_count = None
    if "count" in information:
        controller_count = int(np.median(information["count"]))
    for first_index, rows in rows_by_value(status["index"].astype(np.int64)).items():
        status_of_group = selected_rows(status, rows)
        information_of_group: Columns = {}
        if "error_count" in information:
            is_of_group = information["index"] == first_index
            information_of_group = selected_rows(information, np.flatnonzero(is_of_group))
        speeds = _values_by_controller(status_of_group, "rpm")
        for index_in_group, speed_of_motor in enumerate(speeds):
            number = first_index + index_in_group + 1
            speed = _speed_series(status_of_group, speed_of_motor)
            if speed is None or not _does_exist(number, speed, controller_count):
                continue
            current = None
            if "current" in status_of_group:
                currents = _values_by_controller(status_of_group, "current")
                current = _measured_series(status_of_group, currents[index_in_group])
            errors_and_temperature = _errors_and_temperature(information_of_group, index_in_group)
            yield SpeedController(
                number,
                speed,
                errors_and_temperature.error_count,
                current=current,
                temperature=errors_and_temperature.temperature,
            )


def _does_exist(number: int, speed: TimeSeries, controller_count: int | None) -> bool:
    """Returns whether a speed controller exists: a group always has four, of which some may not be connected.

    Args:
        number: number of the controller, from 1.
        speed: speed of its motor, 1/min.
        controller_count: number of controllers; if it is not known (None), one whose motor ever turns exists.
    """
    if controller_count is None:
        return bool(speed.values.any())
    return number <= controller_count


class _ErrorsAndTemperature(NamedTuple):
    """What ESC_INFO has of a speed controller; None for what was not sent or not measured."""

    error_count: TimeSeries | None = None
    """Errors that it has counted."""

    temperature: TimeSeries | None = None
    """Temperature, °C."""


def _errors_and_temperature(information: Columns, index_in_group: int) -> _ErrorsAndTemperature:
    """Returns the errors that a speed controller counted, and its temperature, by ESC_INFO.

    Args:
        information: ESC_INFO of the controller's group of four, each message with the values of all of them.
        index_in_group: Index of the controller in the group, from 0.
    """
    if not len(information.get("time", ())):
        return _ErrorsAndTemperature()
    error_counts = _values_by_controller(information, "error_count")
    errors = _field_series(information, error_counts[index_in_group])
    temperature = None
    if "temperature" in information:
        values = _values_by_controller(information, "temperature")[index_in_group]
        is_sent = values != UNKNOWN_INFO_TEMPERATURE
        temperature = _measured_series(information, HUNDREDTH * values, is_sent)
    return _ErrorsAndTemperature(errors, temperature)


def _values_by_controller(columns: Columns, field: str) -> Array:
    """Returns the values (controllers, N) of a field that has one value for each controller of a group."""
    return np.array(float_column(columns, field), ndmin=2).T


def _controllers_of_esc_telemetry(telemetry: Telemetry) -> Iterator[SpeedController]:
    """Yields the speed controllers in ArduPilot's messages ESC_TELEMETRY_1_TO_4, ESC_TELEMETRY_5_TO_8 and so on.

    Each message has the values of a group of four controllers. For a controller from which nothing comes ArduPilot
    sends a speed of 0. The counter of its packets does not change then, and such samples are left out. If the counters
    were not logged, a controller whose speed is always 0 is left out.

    Args:
        telemetry: messages of the vehicle.

    Yields:
        Each controller: number from 1, speed, 1/min, current, A, and temperature, °C; the last two are None if they
        were not measured.
    """
    for first_number in FIRST_NUMBERS:
        last_number = first_number + CONTROLLERS_PER_MESSAGE - 1
        columns = telemetry.messages.get(f"ESC_TELEMETRY_{first_number}_TO_{last_number}", {})
        if "rpm" in columns:
            yield from _controllers_of_group(columns, first_number)


def _controllers_of_group(columns: Columns, first_number: int) -> Iterator[SpeedController]:
    """Yields the speed controllers of one ESC_TELEMETRY message of ArduPilot, as far as they measured anything.

    Args:
        columns: columns (N, 4) of the message, with the speed ``rpm`` of each of its four controllers; if they were
            sent, also the counter of packets ``count``, ``current``, cA, and ``temperature``, °C.
        first_number: number of its first controller, from 1.

    Yields:
        Controllers in the order of their numbers; samples without a new packet from the controller are left out.
    """
    packet_counts = columns.get("count")
    for index, motor_speeds in enumerate(_values_by_controller(columns, "rpm")):
        # Without a counter, all samples are used.
        is_new = None
        if packet_counts is not None:
            is_new = _has_new_packet(columns, np.atleast_2d(packet_counts)[:, index])
        speed = _speed_series(columns, motor_speeds, is_new)
        if speed is None:
            continue
        # Without a counter, a speed of 0 throughout shows that nothing was measured.
        if packet_counts is None and not speed.values.any():
            continue
        current = None
        if "current" in columns:
            currents = _values_by_controller(columns, "current")
            current = _measured_series(columns, HUNDREDTH * currents[index], is_new)
        temperature = None
        if "temperature" in columns:
            temperatures = _values_by_controller(columns, "temperature")
            temperature = _measured_series(columns, temperatures[index], is_new)
        yield SpeedController(first_number + index, speed, current=current, temperature=temperature)


def _has_new_packet(columns: Columns, packet_counts: NDArray[Any]) -> Flags:
    """Flags the messages before which the autopilot received new telemetry from a speed controller.

    Args:
        columns: Fields of the message, N rows, with ``time`` and ``boot``.
        packet_counts: Counter (N,) of the packets of the controller, which wraps after 65535.

    Returns:
        Flags (N,): whether the counter differs from its value in the message before; False for the first message.
    """
    # The rows in the order of boots, and of the times within each boot.
    rows_in_order = np.lexsort((columns["time"], columns["boot"]))
    counts_in_order = packet_counts[rows_in_order]
    has_changed = counts_in_order[1:] != counts_in_order[:-1]
    has_new_packet = np.zeros(len(packet_counts), dtype=bool)
    has_new_packet[rows_in_order[1:]] = has_changed
    return has_new_packet
