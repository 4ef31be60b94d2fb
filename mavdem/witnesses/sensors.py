"""Sensors as they measured, before any estimator: barometer, accelerometer and throttle stick.

Each is a time series over all boots, or None if no message has it.
"""

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import (
    TimeSeries,
    clean_series,
    float_column,
    float_columns,
    recorded_series,
)
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.ingest.telemetry import Columns, Parameters, Telemetry
from mavdem.ingest.vocabulary import ACCELEROMETERS_MESSAGE
from mavdem.physical_constants import GRAVITY

MILLIGRAVITY = GRAVITY / 1000
"""Unit of the accelerations of RAW_IMU and SCALED_IMU, m/s²."""

FORCE_FACTORS = {
    "HIGHRES_IMU": 1.0,
    "RAW_IMU": MILLIGRAVITY,
    "SCALED_IMU": MILLIGRAVITY,
    "ACCEL_BEFORE": 1.0,
}
"""Messages with the specific force of the first IMU, the preferred first, and the factor that converts it to m/s²."""

ACCELERATION_FIELDS = ("xacc", "yacc", "zacc")
"""Fields of the three axes of the specific force in most messages."""

FORCE_FIELDS = {"ACCEL_BEFORE": ("x", "y", "z")}
"""Those fields in messages that have other ones."""

FURTHER_IMU_MESSAGES = {2: "SCALED_IMU2", 3: "SCALED_IMU3"}
"""Messages of the second and the third IMU of a stream, by number."""

BAROMETERS = ("SCALED_PRESSURE", "SCALED_PRESSURE2", "SCALED_PRESSURE3")
"""Messages of the barometers, by number."""

BAROMETER_PARAMETER = "BARO_PRIMARY"
"""ArduPilot's parameter with the number of the barometer that is used, from 0."""

COMPASSES = {1: ("SCALED_IMU", "RAW_IMU"), 2: ("SCALED_IMU2",), 3: ("SCALED_IMU3",)}
"""Messages of each compass, the preferred first, by its number: ArduPilot sends the first one as RAW_IMU."""

COMPASS_USE_PARAMETERS = {1: "COMPASS_USE", 2: "COMPASS_USE2", 3: "COMPASS_USE3"}
"""ArduPilot's parameters that state whether each compass is used, 0 or 1."""

SEA_LEVEL_PRESSURE = 1013.25
"""Pressure at sea level of the International Standard Atmosphere, hPa."""

ATMOSPHERE_SCALE = 44330.8
"""Temperature at sea level over the lapse rate of the International Standard Atmosphere, m."""

ATMOSPHERE_EXPONENT = 0.190263
"""Gas constant of air times the lapse rate, over gravity, of the International Standard Atmosphere."""

POSSIBLE_PRESSURE = (100.0, 1200.0)
"""Pressures, hPa, of air in which anything flies; others are damaged messages, or a sensor that does not work."""

POSSIBLE_PULSE = (750.0, 2250.0)
"""Pulse widths, µs, of a stick; receivers without a signal report 0 or 65535."""

USUAL_PULSE_RANGE = (1000.0, 2000.0)
"""Pulse widths, µs, of a closed and an open throttle, where RCn_MIN and RCn_MAX are not known."""

FULL_STICK = 0.9
"""Travel of the throttle stick from which on the pilot commands all thrust; a choice."""


@cached_per_vehicle()
def barometer_altitude(signals: Signals) -> TimeSeries | None:
    """Returns the barometric altitude of a vehicle, m above an arbitrary level.

    It is from the first of these sources that has an altitude which changes:

    1. The barometer that the autopilot uses (``primary_barometer``). An altitude that the autopilot logged with the
       pressure is preferred to one computed from the pressure by the International Standard Atmosphere (ISO 2533).
    2. The other barometers, in the same order.
    3. The pressure altitude in HIGHRES_IMU.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        The altitude (N,), m; None if no barometer that works was recorded.
    """
    telemetry = signals.telemetry
    barometer_in_use = BAROMETERS[primary_barometer(telemetry)]
    for message in (barometer_in_use, *BAROMETERS):
        altitude = _altitude_in(telemetry.messages.get(message, {}))
        if altitude is not None:
            return altitude
    altitude = recorded_series(telemetry, "HIGHRES_IMU", "pressure_alt")
    is_measured = altitude is not None and np.ptp(altitude.values) != 0
    return altitude if is_measured else None


def primary_barometer(telemetry: Telemetry) -> int:
    """Returns the index in ``BAROMETERS`` of the barometer that is used; 0 if the parameters do not state it."""
    number = int(telemetry.parameters.get(BAROMETER_PARAMETER, 0))
    return number if 0 <= number < len(BAROMETERS) else 0


def _altitude_in(columns: Columns) -> TimeSeries | None:
    """Returns the altitude that one barometer measured.

    Args:
        columns: fields of the barometer's messages: the altitude itself, or else the pressure, hPa.

    Returns:
        The altitude (N,), m; None if it was not recorded, or never changes.
    """
    if "altitude" in columns:
        altitude = clean_series(columns, float_column(columns, "altitude"))
    elif "press_abs" in columns:
        pressure = float_column(columns, "press_abs")
        lowest, highest = POSSIBLE_PRESSURE
        is_possible = (pressure > lowest) & (pressure < highest)
        altitude = clean_series(columns, standard_altitude(pressure), is_possible)
    else:
        return None
    # A sensor that always measures the same does not work.
    return altitude if len(altitude.time) and np.ptp(altitude.values) else None


@cached_per_vehicle()
def compass_fields(signals: Signals) -> dict[int, TimeSeries]:
    """Returns the magnetic field that each compass measured, by the number of the compass from 1.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        Fields (N, 3), mGauss along the axes of the body. Compasses that were not recorded, or report only zeros, are
        left out. If several messages have the field of one compass, the first in ``COMPASSES`` is used.
    """
    fields: dict[int, TimeSeries] = {}
    for number, messages in COMPASSES.items():
        for message in messages:
            field = recorded_series(signals.telemetry, message, "xmag", "ymag", "zmag")
            if field is not None and field.values.any():
                fields.setdefault(number, field)
    return fields


def is_compass_used(telemetry: Telemetry, number: int) -> bool | None:
    """Returns whether ArduPilot's parameters use a compass, by its number; None if they do not state it."""
    value = telemetry.parameters.get(COMPASS_USE_PARAMETERS[number])
    return None if value is None else value > 0


def standard_altitude(pressure: Array) -> Array:
    """Returns the altitude, m, at which the International Standard Atmosphere has a pressure (N,), hPa."""
    ratio = pressure / SEA_LEVEL_PRESSURE
    return ATMOSPHERE_SCALE * (1 - ratio**ATMOSPHERE_EXPONENT)


@cached_per_vehicle()
def specific_force(signals: Signals) -> TimeSeries | None:
    """Returns the specific force that the first accelerometer measures, for all boots.

    At rest it is the reaction to the weight: 9.8 m/s² upward, so that z is negative.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        (N, 3) m/s² along body x (forward), y (right) and z (down); None if no message has it.
    """
    for message in FORCE_FACTORS:
        columns = signals.telemetry.messages.get(message, {})
        is_first = None
        if "id" in columns:
            # HIGHRES_IMU may be of several IMUs, which it numbers from 0.
            is_first = columns["id"] == 0
        force = _recorded_specific_force(
            columns,
            FORCE_FIELDS.get(message, ACCELERATION_FIELDS),
            FORCE_FACTORS[message],
            is_first,
        )
        if force is not None:
            return force
    return None


@cached_per_vehicle()
def further_specific_forces(signals: Signals) -> dict[int, TimeSeries]:
    """Returns the specific force of all accelerometers except the first one.

    PX4 logs all IMUs, so number 1 is among them: its first accelerometer is the one of the selected IMU.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        Specific force (N, 3) along the axes of the body, m/s², by the number of the IMU from 1.
    """
    messages = signals.telemetry.messages
    forces: dict[int, TimeSeries] = {}
    # ArduPilot has a message for each IMU.
    for number, message in FURTHER_IMU_MESSAGES.items():
        columns = messages.get(message, {})
        force = _recorded_specific_force(columns, ACCELERATION_FIELDS, MILLIGRAVITY)
        if force is not None:
            forces[number] = force
    # Others number the IMUs in a field of one message, from 0 on.
    forces |= _forces_by_instance(messages.get("HIGHRES_IMU", {}), "id", first_instance=1)
    forces |= _forces_by_instance(messages.get(ACCELEROMETERS_MESSAGE, {}), "instance")
    return forces


def _forces_by_instance(
    columns: Columns, instance_field: str, first_instance: int = 0
) -> dict[int, TimeSeries]:
    """Returns the specific force of each IMU that messages of one name recorded.

    Args:
        columns: columns of the messages; empty without any.
        instance_field: field with the number of the IMU, from 0 on.
        first_instance: IMUs with lower numbers are left out.

    Returns:
        Specific force (N, 3), m/s², by the number of the IMU from 1.
    """
    if instance_field not in columns:
        return {}
    forces = {}
    for instance in np.unique(columns[instance_field]).tolist():
        if instance < first_instance:
            continue
        is_selected = columns[instance_field] == instance
        force = _recorded_specific_force(columns, ACCELERATION_FIELDS, 1.0, is_selected)
        if force is not None:
            forces[1 + int(instance)] = force
    return forces


def _recorded_specific_force(
    columns: Columns, axis_fields: tuple[str, str, str], factor: float, rows: Flags | None = None
) -> TimeSeries | None:
    """Returns the specific force that messages of one type recorded.

    Args:
        columns: columns of the messages, by the name of the field.
        axis_fields: names of the fields with the specific force along body x, y and z.
        factor: m/s² per unit of these fields.
        rows: flags (M,) of the messages to use, such as the messages of one sensor; None for all.

    Returns:
        The specific force (N, 3), m/s²; None if the fields are missing, or 0 throughout, as for a sensor that is not
        there.
    """
    if not all(field in columns for field in axis_fields):
        return None
    force = clean_series(columns, factor * float_columns(columns, axis_fields), rows)
    is_measured = len(force.time) > 0 and force.values.any()
    return force if is_measured else None


@cached_per_vehicle()
def throttle_stick(signals: Signals) -> TimeSeries | None:
    """Returns the position of the pilot's throttle stick as it was received, before the autopilot processes it.

    It comes from the remote control's channel (RC_CHANNELS, DataFlash's RCIN) or from MANUAL_CONTROL (PX4's
    manual_control_setpoint, the ThrIn of older DataFlash logs).

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        (N,) from 0 (closed) to 1 (open); None if no stick was recorded.
    """
    messages = signals.telemetry.messages
    parameters = signals.telemetry.parameters
    # Without the parameter the throttle is on channel 3, its default.
    channel = int(parameters.get("RCMAP_THROTTLE", 3))
    field = f"chan{channel}_raw"
    for message in ("RC_CHANNELS", "RC_CHANNELS_RAW"):
        columns = messages.get(message, {})
        if field not in columns:
            continue
        pulse_lengths = float_column(columns, field)
        shortest, longest = POSSIBLE_PULSE
        is_possible = (pulse_lengths > shortest) & (pulse_lengths < longest)
        if is_possible.any():
            positions = _stick_of_pulses(pulse_lengths, channel, parameters)
            return clean_series(columns, positions, is_possible)
    columns = messages.get("MANUAL_CONTROL", {})
    if "z" not in columns:
        return None
    # MAVLink has the throttle stick from 0 to 1000.
    positions = np.clip(float_column(columns, "z") / 1000, 0, 1)
    stick = clean_series(columns, positions)
    return stick if len(stick.time) else None


def _stick_of_pulses(pulses: Array, channel: int, parameters: Parameters) -> Array:
    """Converts pulse widths of the throttle's channel to its travel.

    Args:
        pulses: (N,) µs.
        channel: number of the channel, from 1.
        parameters: the autopilot's, of which RCn_MIN, RCn_MAX and the reversal of the channel are used.

    Returns:
        (N,) from 0 (closed) to 1 (open).
    """
    closed_pulse = parameters.get(f"RC{channel}_MIN", USUAL_PULSE_RANGE[0])
    open_pulse = parameters.get(f"RC{channel}_MAX", USUAL_PULSE_RANGE[1])
    has_range = open_pulse > closed_pulse
    if not has_range:
        closed_pulse, open_pulse = USUAL_PULSE_RANGE
    travel = np.clip((pulses - closed_pulse) / (open_pulse - closed_pulse), 0, 1)
    # RCn_REV is -1 for a reversed channel in older ArduPilot, RCn_REVERSED is 1 in newer, RCn_REV is -1 in PX4.
    is_reversed = (
        parameters.get(f"RC{channel}_REV", 1) < 0 or parameters.get(f"RC{channel}_REVERSED", 0) > 0
    )
    return 1 - travel if is_reversed else travel
