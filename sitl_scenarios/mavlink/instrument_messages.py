"""Messages of instruments: MAVLink payload fields of barometer, satellites, vibration, power and estimator.

Fields, units and scales follow https://mavlink.io/en/messages/common.html and ardupilotmega.html,
filled as PX4's ``src/modules/mavlink/streams`` and ArduPilot's ``GCS_Common.cpp`` fill them.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.mavlink.dialect import mavlink_constant
from sitl_scenarios.mavlink.autopilots import Autopilot
from sitl_scenarios.mavlink.units import HOME, METRES_PER_DEGREE, heading, named_columns
from sitl_scenarios.mishaps.instruments import CELLS, SECOND_BATTERY_SHARE, InstrumentedMotion
from sitl_scenarios.mishaps.sensor_faults import FIX_3D
from sitl_scenarios.motion import Arrays
from sitl_scenarios.plan import ON_GROUND
from sitl_scenarios.vehicles import GRAVITY

Fields = dict[str, Any]
"""Values of a message's fields: one for all payloads, or one for each."""

SEA_LEVEL_PRESSURE = 1013.25
"""Pressure of the standard atmosphere at sea level, hPa (ISO 2533)."""

PRESSURE_EXPONENT = 5.25588
"""Exponent of the pressure in the standard atmosphere."""

PRESSURE_LAPSE = 2.25577e-5
"""Lapse of the temperature by that at sea level, 1/m, in the standard atmosphere."""

GLITCH_FLAGS = {
    "EKF_STATUS_REPORT": mavlink_constant("EKF_GPS_GLITCHING"),
    "ESTIMATOR_STATUS": mavlink_constant("ESTIMATOR_GPS_GLITCH"),
}
"""Bit of the flags of each message that reports a jump of the satellites' position."""

ATTITUDE_AND_HEIGHT = 1 | 4 | 32
"""Bits of an estimator's flags: attitude, vertical speed and height are good."""

HORIZONTAL = 2 | 8 | 16 | 256 | 512
"""Bits of an estimator's flags: horizontal speed and position are good."""

HORIZONTAL_WITHOUT_FIX = 2 | 8
"""Bits of an estimator's flags while it reckons without satellites."""

PX4_VIBRATION_SCALE = 0.25
"""PX4's vibration metric by ArduPilot's, whose filters differ: the limits of both stand in about this ratio."""

EMPTY_CELL = 3.2
"""Voltage of a cell, V, that autopilots take for empty; a choice."""

FULL_CELL = 4.15
"""Voltage of a cell, V, that they take for full; a choice."""

BATTERY_CAPACITY = 3000.0
"""Charge of a full battery, mAh."""

TEMPERATURE = 35.0
"""Temperature of the boards with barometer and gyro, °C; a choice."""

NEW_MEASUREMENTS = 0x1A3F
"""HIGHRES_IMU.fields_updated: accelerometer, gyro, both pressures, and temperature: bits 0 to 5, 9, 11 and 12."""

HORIZONTAL_VIBRATION = (0.8, 0.7)
"""Levels of ArduPilot's vibration along x and y, as shares of that along z: choices."""

HORIZONTAL_DILUTION = 0.8
"""Horizontal dilution of precision (HDOP) with a fix; a choice, as under an open sky."""

VERTICAL_DILUTION = 1.2
"""Vertical dilution of precision (VDOP) with a fix; a choice."""

DILUTION_WITHOUT_FIX = 99.99
"""Dilution of precision that ArduPilot reports without a fix."""

INT16_RANGE = (np.iinfo(np.int16).min, np.iinfo(np.int16).max)
"""Range of the integers of RAW_IMU."""

CELLS_OF_MESSAGE = 10
"""Number of cells whose voltages BATTERY_STATUS has."""

UNKNOWN_VOLTAGE = np.iinfo(np.uint16).max
"""Value of a cell of BATTERY_STATUS that does not exist."""

BATTERY_FOR_ALL = mavlink_constant("MAV_BATTERY_FUNCTION_ALL")
"""The battery supplies all of the vehicle."""

LITHIUM_POLYMER = mavlink_constant("MAV_BATTERY_TYPE_LIPO")
"""Chemistry of the battery."""

UNKNOWN_TEMPERATURE = np.iinfo(np.int16).max
"""Temperature of BATTERY_STATUS that is not measured."""

UNKNOWN_ENERGY = -1
"""Consumed energy of BATTERY_STATUS that is not measured."""


def instrument_fields(
    name: str,
    motion: InstrumentedMotion,
    boot_microseconds: NDArray[np.int64],
    autopilot: Autopilot,
) -> Fields | None:
    """Returns the fields of a message whose content comes from simulated instruments, such as a barometer.

    Args:
        name: Name of the message.
        motion: N rows of the flight.
        boot_microseconds: (N,) times of the rows since boot, µs.
        autopilot: Autopilot that sends the message.

    Returns:
        Columns (N,), or one number for all rows, by field, in the units of the message. None if no instrument gives the
        content of the message.
    """
    time_boot_ms = boot_microseconds // 1000 % 2**32
    match name:
        case "GPS_RAW_INT":
            return {"time_usec": boot_microseconds, **_satellite_fields(motion)}
        case "SCALED_PRESSURE":
            return {
                "time_boot_ms": time_boot_ms,
                "press_abs": _pressure(motion),
                # 0.01 °C.
                "temperature": round(100 * TEMPERATURE),
            }
        case "HIGHRES_IMU":
            return {
                "time_usec": boot_microseconds,
                "abs_pressure": _pressure(motion),
                "pressure_alt": HOME[2] + motion.barometer_height,
                "temperature": TEMPERATURE,
                "fields_updated": NEW_MEASUREMENTS,
                **named_columns("xacc yacc zacc", motion.specific_force),
                **named_columns("xgyro ygyro zgyro", motion.gyro),
            }
        case "RAW_IMU":
            # ArduPilot fills it in mg and mrad/s.
            force = np.round(1000 * motion.specific_force / GRAVITY).clip(*INT16_RANGE)
            return {
                "time_usec": boot_microseconds,
                **named_columns("xacc yacc zacc", force),
                **named_columns("xgyro ygyro zgyro", np.round(1000 * motion.gyro)),
            }
        case "VIBRATION":
            return {"time_usec": boot_microseconds, **_vibration_fields(motion, autopilot)}
        case "EKF_STATUS_REPORT" | "ESTIMATOR_STATUS":
            names = "velocity_variance pos_horiz_variance pos_vert_variance compass_variance"
            fields: Fields = {}
            if name == "ESTIMATOR_STATUS":
                names = "vel_ratio pos_horiz_ratio pos_vert_ratio mag_ratio"
                fields = {"time_usec": boot_microseconds}
            has_fix = motion.fix_type >= FIX_3D
            flags = ATTITUDE_AND_HEIGHT | np.where(has_fix, HORIZONTAL, HORIZONTAL_WITHOUT_FIX)
            flags |= GLITCH_FLAGS[name] * motion.is_glitching
            return fields | named_columns(names, motion.ratios) | {"flags": flags}
        case "VFR_HUD":
            north_speed, east_speed, down_speed = motion.known_velocity.T
            return {
                "groundspeed": np.hypot(north_speed, east_speed),
                "heading": np.round(heading(motion)) % 360,
                "throttle": np.round(100 * motion.demands[:, 3]).clip(0, 100),
                "alt": HOME[2] - motion.known_position[:, 2],
                "climb": -down_speed,
            }
        case "POWER_STATUS":
            return {"Vcc": np.round(1000 * motion.board_voltage), "Vservo": 0, "flags": 1}
        case "BATTERY_STATUS":
            return _battery_fields(motion, boot_microseconds)
    return None


def _pressure(motion: InstrumentedMotion) -> NDArray[Any]:
    """Returns the pressure that the barometer measures, hPa, by the standard atmosphere; (N,)."""
    altitude = HOME[2] + motion.barometer_height
    return SEA_LEVEL_PRESSURE * (1 - PRESSURE_LAPSE * altitude) ** PRESSURE_EXPONENT


def _satellite_fields(motion: InstrumentedMotion) -> Fields:
    """Returns the fields of GPS_RAW_INT except its time, in the message's integer units.

    Latitude and longitude are in 1e-7 degrees, the altitude in mm, the speed in cm/s, the course in 0.01 degrees, and
    the dilutions of precision (DOP) are times 100.

    Args:
        motion: N samples of the flight, with satellite fixes.

    Returns:
        Columns (N,) by field; position and speed are 0 without a fix.
    """
    north, east, down = motion.fix.T
    latitude, longitude, altitude = HOME
    east_degrees = east / METRES_PER_DEGREE / np.cos(np.radians(latitude))
    has_fix = motion.fix_type >= FIX_3D
    north_speed, east_speed, _ = motion.velocity.T
    course = np.degrees(np.arctan2(east_speed, north_speed)) % 360
    return {
        "fix_type": motion.fix_type,
        "lat": np.round(1e7 * (latitude + north / METRES_PER_DEGREE)) * has_fix,
        "lon": np.round(1e7 * (longitude + east_degrees)) * has_fix,
        "alt": np.round(1000 * (altitude - down)) * has_fix,
        "eph": np.round(100 * np.where(has_fix, HORIZONTAL_DILUTION, DILUTION_WITHOUT_FIX)),
        "epv": np.round(100 * np.where(has_fix, VERTICAL_DILUTION, DILUTION_WITHOUT_FIX)),
        "vel": np.round(100 * np.hypot(north_speed, east_speed)) * has_fix,
        "cog": np.round(100 * course) % 36000,
        "satellites_visible": motion.satellites,
    }


def _vibration_fields(motion: InstrumentedMotion, autopilot: Autopilot) -> Arrays:
    """Returns the fields of VIBRATION except its time: levels and clipped samples since boot.

    PX4 has one level for all axes, in the field of z. ArduPilot has levels in m/s² for each axis.

    Args:
        motion: N samples of the flight, with its vibration.
        autopilot: The autopilot that sends the message.

    Returns:
        Columns (N,) by field.
    """
    clips = {"clipping_0": motion.clips}
    if autopilot.name == "px4":
        return {"vibration_z": PX4_VIBRATION_SCALE * motion.vibration, **clips}
    return {
        "vibration_x": HORIZONTAL_VIBRATION[0] * motion.vibration,
        "vibration_y": HORIZONTAL_VIBRATION[1] * motion.vibration,
        "vibration_z": motion.vibration,
        **clips,
    }


def charge_share(motion: InstrumentedMotion, battery: int) -> NDArray[Any]:
    """Returns the remaining charge of a battery, 0 to 1, as autopilots estimate it by the voltage of a cell; (N,)."""
    cell = motion.battery_voltage[:, battery] / CELLS
    return ((cell - EMPTY_CELL) / (FULL_CELL - EMPTY_CELL)).clip(0.0, 1.0)


def _battery_fields(motion: InstrumentedMotion, boot_microseconds: NDArray[np.int64]) -> Fields:
    """Returns the fields of BATTERY_STATUS; two batteries are reported in turn, every other second.

    Units are as in the message: mV, A / 100, mAh and percent. An autopilot that does not know the voltage of single
    cells sends the battery's voltage as the first cell's.

    Args:
        motion: N samples of the flight.
        boot_microseconds: (N,) times of the rows since boot, µs.

    Returns:
        Columns (N,), or one number for all samples, by field.
    """
    seconds = boot_microseconds // 1_000_000
    first_voltage, second_voltage = motion.battery_voltage.T
    has_second_battery = ~np.isnan(second_voltage)
    is_odd_second = seconds % 2 == 1
    is_second = has_second_battery & is_odd_second
    battery = is_second.astype(int)
    voltages = np.full((len(boot_microseconds), CELLS_OF_MESSAGE), float(UNKNOWN_VOLTAGE))
    voltages[:, 0] = np.round(1000 * np.where(is_second, second_voltage, first_voltage))
    charge = np.where(is_second, charge_share(motion, 1), charge_share(motion, 0))
    current_shares = np.where(is_second, SECOND_BATTERY_SHARE, 1.0)
    return {
        "id": battery,
        "battery_function": BATTERY_FOR_ALL,
        "type": LITHIUM_POLYMER,
        "temperature": UNKNOWN_TEMPERATURE,
        "voltages": voltages,
        "current_battery": np.round(100 * motion.battery_current * current_shares),
        "current_consumed": np.round(BATTERY_CAPACITY * (1 - charge)),
        "energy_consumed": UNKNOWN_ENERGY,
        "battery_remaining": np.round(100 * charge),
    }


def system_status_fields(motion: InstrumentedMotion, sensors: int) -> Fields:
    """Returns the fields of SYS_STATUS that instruments fill: sensors, voltage, current and charge.

    Args:
        motion: N rows of the flight.
        sensors: Bit mask of the sensors that every vehicle has, and which are always healthy.

    Returns:
        Columns (N,), or one number for all samples, by field, in the units of the message: mV, cA and %.
    """
    gps = mavlink_constant("MAV_SYS_STATUS_SENSOR_GPS")
    radio = mavlink_constant("MAV_SYS_STATUS_SENSOR_RC_RECEIVER")
    everything = sensors | gps | radio
    has_fix = motion.fix_type >= FIX_3D
    has_radio = motion.throttle_stick >= 0
    health = sensors | gps * has_fix | radio * has_radio
    return {
        "onboard_control_sensors_present": everything,
        "onboard_control_sensors_enabled": everything,
        "onboard_control_sensors_health": health,
        "voltage_battery": np.round(1000 * motion.battery_voltage[:, 0]),
        "current_battery": np.round(100 * motion.battery_current),
        "battery_remaining": np.round(100 * charge_share(motion, 0)),
    }


def flight_modes(motion: InstrumentedMotion, autopilot: Autopilot) -> NDArray[Any]:
    """Returns base and custom mode of each row, as HEARTBEAT reports them.

    They are the flight plan's, which depend on the landed state, except where a pilot or a failsafe flies.

    Args:
        motion: N rows of the flight; ``mode`` is 0 where the plan is flown.
        autopilot: Autopilot that reports the modes.

    Returns:
        Base and custom mode (N, 2).
    """
    planned_modes = np.array(autopilot.modes)[motion.landed_state - ON_GROUND]
    # Row 0 only fills a place: with mode 0 the mode of the plan is taken.
    manual_modes = np.array([(0, 0), *autopilot.manual_modes])
    is_planned = motion.mode == 0
    return np.where(is_planned[:, None], planned_modes, manual_modes[motion.mode])
