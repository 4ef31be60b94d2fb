"""Identity of a vehicle: a name by which its logs are recognised, its frame and firmware, and the flight's date."""

import hashlib
import re
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime
from typing import NamedTuple

import numpy as np

from mavdem.assessment.simulation import simulation_fact
from mavdem.assessment.status_texts import status_texts
from mavdem.dataset.segments import Segment, settled_segments
from mavdem.dataset.signals import Signals, global_positions
from mavdem.dataset.time_series import float_column
from mavdem.facts.vehicle import Basis, DateBasis, name_with_frame, system_id_name
from mavdem.ingest.motors import MOTOR_COUNTS, PositionSource
from mavdem.ingest.telemetry import MICROSECONDS, Parameters, Telemetry
from mavdem.ingest.utc import MIN_UTC, utc_at_boot
from mavdem.ingest.vocabulary import (
    board_name_in_texts,
    board_number_from_texts,
    board_number_from_uid2,
    version_text,
)

CALIBRATION_PARAMETERS = {
    Basis.ACCELEROMETER: ("INS_ACCOFFS_{} INS_ACCSCAL_{}", "CAL_ACC0_{}OFF CAL_ACC0_{}SCALE"),
    Basis.COMPASS: ("COMPASS_OFS_{}", "CAL_MAG0_{}OFF"),
}
"""Parameters of the calibration of a vehicle's own sensors, for ArduPilot and PX4; {} is replaced by X, Y and Z.

The most lasting calibration comes first: a compass is calibrated again in the field. Gyroscopes, which are calibrated
at each start, identify no vehicle.
"""

SIMULATOR_OFFSETS = ((0.001, 0.001, 0.001), (5.0, 13.0, -18.0))
"""Offsets along X, Y and Z that every vehicle of ArduPilot's simulator has: of the accelerometer, m/s², and of the
compass, mGauss. They identify no vehicle."""

CALIBRATION_DIGITS = 4
"""Significant digits of a calibration that both text files and 32-bit numbers keep."""

OFFSET_DECIMALS = 6
"""Decimals of a calibration's offsets that are compared with those of simulators."""

NAME_DIGITS = 12
"""Hexadecimal digits of the hash of a calibration in the vehicle's name."""

PX4_LOG_NAME = re.compile(r"/log/(20\d\d-\d\d-\d\d/\d\d_\d\d_\d\d)\.ulg")
"""Name of a log in a text of PX4, by the day and the second at which it began: "…/log/2026-03-09/11_02_35.ulg"."""

DAY_IN_NAME = re.compile(r"(?<!\d)(?:(20\d\d)[-_](\d\d?)[-_](\d\d?)|(20\d\d)(\d\d)(\d\d))(?!\d)")
"""A day in a file's name, as ground stations write it: "2026-03-09", "2026_3_9" or "20260309"."""

DEGREE_DECIMALS = 3
"""Decimals of latitude and longitude in degrees, for a resolution of 110 m: reports are passed on, and show on which
field a vehicle flew, but not at which house. The last position of a lost flight has all decimals."""

FIRMWARE_TEXTS = ("ArduCopter V", "APM:Copter V")
"""Beginnings of the texts with which ArduCopter reports its version."""

FIRMWARE_NAMES = {"ARDUPILOTMEGA": "ArduPilot V", "PX4": "PX4 v"}
"""Beginnings of the firmware's name, by the autopilot, where only the number of its version is known."""


@dataclass(frozen=True)
class Identity:
    """Which vehicle a log is of."""

    name: str
    """Name by which its logs are recognised. Vehicles with other frames or autopilots have other names."""
    basis: Basis
    """What the name was made from."""
    system: int
    """MAVLink system id."""
    autopilot: str
    """MAV_AUTOPILOT without its prefix."""
    frame: str
    """MAV_TYPE without its prefix."""
    firmware: str
    """Name and version; empty if the log does not have it."""
    date: datetime | None
    """When the settled flight began or, if it is not known, the log; UTC."""
    date_basis: DateBasis | None = None
    """What the date was read from; None without one."""
    hardware: str = ""
    """Kind of board, as its firmware calls it; empty if the log does not have it."""
    place: tuple[float, float] | None = None
    """Latitude and longitude of the first GPS fix to about 100 m, degrees north and east; None without a fix."""

    @property
    def name_of_one_vehicle(self) -> str:
        """The name; empty if it is made of the MAVLink system id, which many vehicles share."""
        return "" if self.basis is Basis.SYSTEM_ID else self.name


class NameWithBasis(NamedTuple):
    """Name of a vehicle, and what it was made from."""

    name: str
    """The name."""

    basis: Basis
    """What it was made from."""


def identify_vehicle(signals: Signals, receive_time: float = float("nan")) -> Identity:
    """Identifies a log's vehicle: name, type, autopilot, firmware and board, and when and where it flew.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        receive_time: time when the first message of the log was received, UNIX time in s; NaN if it is not known.

    Returns:
        The identity. Its ``basis`` says what the name was made from, such as the serial number of the board, and
        ``date_basis`` which clock the date comes from.
    """
    telemetry = signals.telemetry
    name, name_basis = vehicle_name(telemetry, is_simulated=simulation_fact(signals) is not None)
    date, date_basis = _flight_date(signals, receive_time)
    return Identity(
        name,
        name_basis,
        telemetry.system,
        telemetry.autopilot,
        _frame(signals),
        firmware=telemetry.firmware or _firmware(telemetry),
        date=date,
        date_basis=date_basis,
        hardware=telemetry.hardware or board_name_in_texts(_texts(telemetry)),
        place=_first_fix(telemetry),
    )


def _frame(signals: Signals) -> str:
    """Returns the kind of the vehicle's frame, a MAV_TYPE without its prefix, such as "QUADROTOR".

    Logs of ArduCopter before 3.5 name no frame. If the parameters still place each motor, their number is that of the
    frame.
    """
    vehicle, motors = signals.telemetry.vehicle, signals.motors
    if vehicle != "GENERIC_MULTIROTOR" or motors is None:
        return vehicle
    if motors.geometry.position_source is PositionSource.PARAMETERS:
        for frame, motor_count in MOTOR_COUNTS.items():
            if motor_count == len(motors.geometry.motors):
                return frame
    return vehicle


def vehicle_name(telemetry: Telemetry, *, is_simulated: bool) -> NameWithBasis:
    """Makes a name that is the same in all logs of one vehicle, so that they can be recognised.

    It is, in this order of preference:

    1. the serial number of the autopilot's board, which is unique;
    2. a hash of the calibration of a sensor, since no two sensors have the same, unless its values are defaults or
       belong to a simulator;
    3. the name of the autopilot and the MAVLink system id, which many vehicles share.

    The first two are followed by the frame, unless it is a quadrotor's, since a board may be moved to another frame.

    A simulated flight has only the last. The serial number and the calibrations in its log are those of the simulator,
    whichever frame it flew, or of the real vehicle whose board flew the simulation.

    Args:
        telemetry: messages and parameters of the vehicle.
        is_simulated: whether the log shows that the flight was simulated.

    Returns:
        The name, and what it was made from.
    """
    system_name = NameWithBasis(
        system_id_name(telemetry.autopilot, telemetry.system), Basis.SYSTEM_ID
    )
    if is_simulated:
        return system_name
    board_number = telemetry.board
    if not board_number:
        board_number = board_number_from_texts(_texts(telemetry))
    if not board_number:
        board_number = _board_number_in_messages(telemetry)
    if board_number:
        return NameWithBasis(name_with_frame(board_number, telemetry.vehicle), Basis.BOARD)
    return _name_by_calibration(telemetry) or system_name


def _name_by_calibration(telemetry: Telemetry) -> NameWithBasis | None:
    """Returns the name of a vehicle by the calibration of a sensor, such as "accelerometer-" and a hash of its values.

    Args:
        telemetry: parameters of the vehicle, and its frame, which may follow the hash.

    Returns:
        The name, with the sensor as its basis; None if no sensor has a calibration of its own.
    """
    for sensor, name_formats_by_autopilot in CALIBRATION_PARAMETERS.items():
        for name_formats in name_formats_by_autopilot:
            calibration = _calibration_values(telemetry.parameters, name_formats)
            if calibration:
                # Only digits that every format of logs keeps, so that all logs of the vehicle give the same name.
                digits = [f"{value:.{CALIBRATION_DIGITS}g}" for value in calibration]
                digest = hashlib.sha256(" ".join(digits).encode()).hexdigest()
                name = f"{sensor}-{digest[:NAME_DIGITS]}"
                return NameWithBasis(name_with_frame(name, telemetry.vehicle), sensor)
    return None


def _calibration_values(parameters: Parameters, name_formats: str) -> list[float]:
    """Returns the calibration of a sensor, which differs between vehicles and so is part of their identity.

    Args:
        parameters: parameters of the autopilot by name.
        name_formats: names of the sensor's parameters with "{}" for the axis, separated by blanks: the offset first,
            then scale factors, such as "INS_ACCOFFS_{} INS_ACCSCAL_{}".

    Returns:
        The offsets along X, Y and Z, and then the scale factors along X, Y and Z. Empty if a parameter is missing, the
        sensor was never calibrated, or its offsets are those of a simulator, which all simulated vehicles have.
    """
    parameter_names = []
    for name_format in name_formats.split():
        for axis in "XYZ":
            parameter_names.append(name_format.format(axis))
    if not all(name in parameters for name in parameter_names):
        return []
    calibration = [parameters[name] for name in parameter_names]
    offsets_by_axis = calibration[: len("XYZ")]
    offsets = tuple(round(offset, OFFSET_DECIMALS) for offset in offsets_by_axis)
    # A sensor that was never calibrated has the offsets 0.
    is_calibrated = any(offsets)
    if not is_calibrated or offsets in SIMULATOR_OFFSETS:
        return []
    return calibration


def _board_number_in_messages(telemetry: Telemetry) -> str:
    """Returns the serial number of the autopilot's board from the MAVLink message AUTOPILOT_VERSION.

    It has the format of ArduPilot's texts, so that a vehicle has the same name in logs that only have the texts.

    Args:
        telemetry: messages of the vehicle.

    Returns:
        The number in hexadecimal, of the last message that has one; empty without one.
    """
    columns = telemetry.messages.get("AUTOPILOT_VERSION", {})
    # The field ``uid2`` has the number in bytes. A log with one message has one row of them.
    numbers_in_bytes = np.atleast_2d(np.asarray(columns.get("uid2", []), dtype=np.uint8))
    is_ardupilot = telemetry.autopilot == "ARDUPILOTMEGA"
    for number_in_bytes in reversed(numbers_in_bytes):
        number = board_number_from_uid2(number_in_bytes.tobytes(), as_in_texts=is_ardupilot)
        if number:
            return number
    return ""


def _texts(telemetry: Telemetry) -> list[str]:
    """Returns the contents of all texts that the autopilot sent, such as "ArduCopter V4.3.0", without their times."""
    return [text.text for text in status_texts(telemetry)]


def _firmware(telemetry: Telemetry) -> str:
    """Returns name and version of the firmware, such as "ArduCopter V4.3.0".

    ArduCopter reports them in a text. If there is none, they are made from the number in AUTOPILOT_VERSION, whose bytes
    are major, minor and patch version.

    Args:
        telemetry: messages of the vehicle.

    Returns:
        Name and version; empty if the log does not have them.
    """
    for text in _texts(telemetry):
        if text.startswith(FIRMWARE_TEXTS):
            return text
    columns = telemetry.messages.get("AUTOPILOT_VERSION", {})
    if "flight_sw_version" not in columns:
        return ""
    version = int(columns["flight_sw_version"][-1])
    if not version:
        return ""
    return f"{FIRMWARE_NAMES.get(telemetry.autopilot, '')}{version_text(version)}"


def _first_fix(telemetry: Telemetry) -> tuple[float, float] | None:
    """Returns the position of the vehicle at its first GPS fix, rounded to about 100 m.

    The receiver's own GPS_RAW_INT is preferred to GLOBAL_POSITION_INT, which the autopilot estimates.

    Args:
        telemetry: messages of the vehicle.

    Returns:
        Latitude and longitude, degrees north and east; None without a fix.
    """
    for message in ("GPS_RAW_INT", "GLOBAL_POSITION_INT"):
        columns = telemetry.messages.get(message, {})
        if "lat" not in columns:
            continue
        positions, is_fixed = global_positions(columns)
        if is_fixed.any():
            latitude, longitude = positions[is_fixed][0]
            return (
                round(float(latitude), DEGREE_DECIMALS),
                round(float(longitude), DEGREE_DECIMALS),
            )
    return None


class _DateWithBasis(NamedTuple):
    """Date of a flight, and what it was read from."""

    date: datetime | None
    basis: DateBasis | None


def _flight_date(signals: Signals, receive_time: float) -> _DateWithBasis:
    """Returns the date of a flight: when its settled part began or, if that is not known, when the log did.

    It comes from the first of these sources that has a plausible time:

    1. Messages SYSTEM_TIME, which have UNIX time and time since boot, so that the beginning of the flight can be
       converted. Before the first GPS fix their UNIX time is not set; such messages are skipped. For logs of the
       autopilot these messages are made from messages of the GPS receiver.
    2. The clock of the computer that received the messages.
    3. The name that PX4 gave its log, by a clock that was set by an earlier fix.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        receive_time: time when the first message was received, UNIX time in s; NaN if it is not known.

    Returns:
        Date and basis; None for both if the log shows no plausible time.
    """
    telemetry = signals.telemetry
    flight = min(settled_segments(signals), default=None)
    time = _time_by_autopilot(telemetry, flight)
    if time is not None:
        return _dated(time, DateBasis.GPS if telemetry.translated_from else DateBasis.AUTOPILOT)
    if receive_time > MIN_UTC:
        return _dated(receive_time, DateBasis.RECEIVER)
    time = _time_by_log_name(telemetry, flight)
    if time is not None:
        return _dated(time, DateBasis.LOG_NAME)
    return _DateWithBasis(None, None)


def _time_by_autopilot(telemetry: Telemetry, flight: Segment | None) -> float | None:
    """Returns when a flight began, by the messages SYSTEM_TIME, which have UNIX time and time since boot.

    Without a flight, or if the UNIX clock was never set in its boot, the time of the first message of the log with a
    set clock is returned instead.

    Args:
        telemetry: messages of the vehicle.
        flight: first settled segment; None without one.

    Returns:
        UNIX time, s; None if the messages have no plausible time.
    """
    messages = telemetry.messages
    if flight is not None:
        utc_at_start_of_boot = utc_at_boot(messages, flight.boot)
        if utc_at_start_of_boot is not None:
            return utc_at_start_of_boot + flight.start
    columns = messages.get("SYSTEM_TIME", {})
    no_boots = np.zeros(0, dtype=int)
    for boot in np.unique(columns.get("boot", no_boots)).tolist():
        utc_at_start_of_boot = utc_at_boot(messages, boot)
        if utc_at_start_of_boot is not None:
            # A clock that is not set counts from 1970.
            is_clock_set = float_column(columns, "time_unix_usec") / MICROSECONDS >= MIN_UTC
            is_of_boot = columns["boot"] == boot
            times_since_boot = columns["time"][is_clock_set & is_of_boot]
            return utc_at_start_of_boot + float(times_since_boot[0])
    return None


def _time_by_log_name(telemetry: Telemetry, flight: Segment | None) -> float | None:
    """Returns when a flight began, by the name of the log, which PX4 sends in a text as it opens the log.

    Args:
        telemetry: messages of the vehicle.
        flight: first settled segment; None without one. If it is of another boot than the text, the time at which the
            log was opened is returned.

    Returns:
        UNIX time, s; None if no text has such a name with a plausible time.
    """
    # PX4 adds this many minutes to UTC in its names.
    offset_minutes = telemetry.parameters.get("SDLOG_UTC_OFFSET", 0.0)
    for text in status_texts(telemetry):
        local_time = _time_in_log_name(text.text)
        if local_time is None:
            continue
        time = local_time - 60 * offset_minutes
        if flight is not None and flight.boot == text.boot:
            seconds_from_text_to_flight = flight.start - text.time
            time += seconds_from_text_to_flight
        if time > MIN_UTC:
            return time
    return None


def _time_in_log_name(text: str) -> float | None:
    """Returns the date and time in the name of a PX4 log, such as "/log/2026-03-09/11_02_35.ulg", as if it was UTC.

    Args:
        text: text of the autopilot, which may have such a name.

    Returns:
        UNIX time, s; None if the text has no such name, or if its digits are no date.
    """
    match = PX4_LOG_NAME.search(text)
    if match is None:
        return None
    with suppress(ValueError):
        return datetime.strptime(match[1], "%Y-%m-%d/%H_%M_%S").replace(tzinfo=UTC).timestamp()
    return None


def _dated(unix_time: float, basis: DateBasis) -> _DateWithBasis:
    """Returns a UNIX time, s, as a date with its basis; None for both if it is out of range."""
    date = utc_date(unix_time)
    return _DateWithBasis(date, None if date is None else basis)


def day_in_file_name(name: str) -> date | None:
    """Returns the day in the name of a log's file, such as "2026-03-09 11-02-35.bin"; None if there is none.

    People rename and copy files, so that the day may be wrong. It is only shown, as the day in the file's name.

    Args:
        name: name of the file.
    """
    for match in DAY_IN_NAME.finditer(name):
        year, month, day = (int(part) for part in match.groups() if part is not None)
        with suppress(ValueError):
            return date(year, month, day)
    return None


def utc_date(unix_time: float) -> datetime | None:
    """Returns a UNIX time, s, as a date in UTC; None if it is out of range, as in a damaged message."""
    with suppress(OverflowError, ValueError, OSError):
        return datetime.fromtimestamp(unix_time, UTC)
    return None
