"""Messages: MAVLink payloads filled from a simulated flight, and the parameters that the simulated autopilot reports.

Fields, units and signs follow the definitions (https://mavlink.io/en/messages/common.html): angles rad, body
rates rad/s, north-east-down m and m/s, PWM µs; parameters travel in PARAM_VALUE's float as
https://mavlink.io/en/services/parameter.html#parameter-encoding has it.
"""

import struct
from math import degrees
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.mavlink.dialect import definitions_by_name, mavlink_constant
from mavdem.ingest.mavlink.payloads import filled_payloads
from mavdem.ingest.vocabulary import (
    ACTIVE,
    ARMED,
    CRITICAL,
    MAVLINK_VERSION,
    ON_GROUND,
    STANDBY,
    quaternion,
)
from sitl_scenarios.controller import MAX_TILT
from sitl_scenarios.gains import control_parameters
from sitl_scenarios.mavlink.autopilots import Autopilot
from sitl_scenarios.mavlink.instrument_messages import (
    flight_modes,
    instrument_fields,
    system_status_fields,
)
from sitl_scenarios.mavlink.units import HOME, METRES_PER_DEGREE, named_columns
from sitl_scenarios.mishaps.instruments import InstrumentedMotion
from sitl_scenarios.motion import Motion, estimated_angles
from sitl_scenarios.plan import FULL_STICK
from sitl_scenarios.rotors import (
    CIRCLES,
    MAX_PULSE,
    MIN_PULSE,
    Shape,
    pulse_width,
    rotor_count,
)
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.vehicles import FULL_BATTERY_VOLTAGE, GRAVITY

Payloads = NDArray[Any]
"""(N,) payloads of one message: a structured array of the definition's wire type."""

VEHICLE_TYPES = {
    4: mavlink_constant("MAV_TYPE_QUADROTOR"),
    6: mavlink_constant("MAV_TYPE_HEXAROTOR"),
    8: mavlink_constant("MAV_TYPE_OCTOROTOR"),
}
"""MAV_TYPE of the vehicle by its number of rotors, coaxial ones too."""

SENSORS = sum(
    mavlink_constant(f"MAV_SYS_STATUS_SENSOR_{name}")
    for name in ("3D_GYRO", "3D_ACCEL", "3D_MAG", "ABSOLUTE_PRESSURE")
)
"""Bits of the sensors that the vehicle has, which all are healthy."""

UNKNOWN_CURRENT = -1
UNKNOWN_CHARGE = -1
"""Values of a current and of a battery's charge that are not known, by the definition of SYS_STATUS."""

FENCE = mavlink_constant("MAV_SYS_STATUS_GEOFENCE")
"""Bit of the geofence, which reports as healthy: it is not breached."""

UNUSED = np.iinfo(np.uint16).max
"""Value of RC channels that do not exist, by the definition of RC_CHANNELS."""

UNKNOWN_RSSI = np.iinfo(np.uint8).max
"""Value of a signal strength that is not known, by the definition of RC_CHANNELS."""

MAX_RSSI = 254
"""Largest signal strength, by the definition of RC_CHANNELS."""

ARDUPILOT_MOTOR_OFFSET = 32
"""SERVOn_FUNCTION of motor m is 32 + m (for motors 1 to 8)."""

PX4_MOTOR_OFFSET = 100
"""PWM_MAIN_FUNCn of motor m is 100 + m."""

CHANNELS: int = definitions_by_name()["HIL_ACTUATOR_CONTROLS"].payload_type["controls"].shape[0]
"""Number of channels in each message of motor outputs."""

STICK_CHANNELS = ((1, 0), (2, 1), (4, 2))
"""RC channel and axis of ``Motion.sticks``: 1 roll, 2 pitch, 4 yaw; channel 3 is the throttle."""


def message_payloads(
    name: str, motion: Motion, boot_microseconds: NDArray[np.int64], autopilot: Autopilot
) -> Payloads:
    """Returns the payloads of one message for rows of a motion.

    Args:
        name: Name of the message.
        motion: N rows of the flight.
        boot_microseconds: (N,) times of the rows since boot, µs.
        autopilot: Autopilot that sends the message.

    Returns:
        (N,) payloads of the message's wire type.
    """
    fields: dict[str, Any] = {"time_boot_ms": boot_microseconds // 1000 % 2**32}
    if isinstance(motion, InstrumentedMotion):
        measured_fields = instrument_fields(name, motion, boot_microseconds, autopilot)
        if measured_fields is not None:
            return filled_payloads(name, len(boot_microseconds), **measured_fields)
        modes = flight_modes(motion, autopilot)
    else:
        modes = np.array(autopilot.modes)[motion.landed_state - ON_GROUND]
    base_mode = modes[:, 0] + ARMED * motion.armed
    custom_mode = modes[:, 1]
    rates = named_columns("rollspeed pitchspeed yawspeed", motion.known_rates)
    outputs = np.full((len(motion), CHANNELS), autopilot.unused)
    rotors = motion.outputs.shape[1]
    outputs[:, :rotors] = motion.outputs
    match name:
        case "HEARTBEAT":
            fields = {
                "type": VEHICLE_TYPES[rotors],
                "autopilot": autopilot.number,
                "base_mode": base_mode,
                "custom_mode": custom_mode,
                "system_status": _system_status(motion),
                "mavlink_version": MAVLINK_VERSION,
            }
        case "SYS_STATUS":
            fields = _sensors_and_battery(motion)
        case "EXTENDED_SYS_STATE":
            fields = {"landed_state": motion.landed_state}
        case "ATTITUDE":
            fields |= named_columns("roll pitch yaw", estimated_angles(motion)) | rates
        case "ATTITUDE_QUATERNION":
            fields |= named_columns("q1 q2 q3 q4", motion.known_attitude) | rates
        case "HIGHRES_IMU":
            # This simulation has no accelerometer: its specific force is always as in hover.
            fields = {"time_usec": boot_microseconds, "zacc": -GRAVITY}
            fields |= named_columns("xgyro ygyro zgyro", motion.gyro)
        case "ATTITUDE_TARGET":
            # No bit of type_mask is set: both autopilots declare that all setpoints are valid (PX4's
            # streams/ATTITUDE_TARGET.hpp, ArduCopter's send_attitude_target).
            fields["q"] = quaternion(*motion.attitude_setpoint.T)
            rate_names = "body_roll_rate body_pitch_rate body_yaw_rate"
            fields |= named_columns(rate_names, motion.rates_setpoint)
            fields["thrust"] = motion.demands[:, 3]
        case "RC_CHANNELS":
            fields |= _stick_channels(motion)
        case "LOCAL_POSITION_NED":
            fields |= named_columns("x y z", motion.known_position)
            fields |= named_columns("vx vy vz", motion.known_velocity)
        case "GLOBAL_POSITION_INT":
            fields |= _global_position(motion)
        case "SERVO_OUTPUT_RAW":
            # The one clock of 32-bit microseconds: it wraps every 71.6 minutes.
            fields = {f"servo{n + 1}_raw": np.round(outputs[:, n]) for n in range(CHANNELS)}
            fields["time_usec"] = boot_microseconds % 2**32
        case "ACTUATOR_OUTPUT_STATUS":
            fields = {
                "time_usec": boot_microseconds,
                "active": CHANNELS,
                "actuator": np.pad(outputs, ((0, 0), (0, CHANNELS))),
            }
        case "HIL_ACTUATOR_CONTROLS":
            # A motor that is stopped has less than the lowest pulse, and no negative command.
            commands = np.maximum((motion.outputs - MIN_PULSE) / (MAX_PULSE - MIN_PULSE), 0.0)
            controls = np.pad(commands, ((0, 0), (0, CHANNELS - rotors)))
            fields = {"time_usec": boot_microseconds, "controls": controls, "mode": base_mode}
    return filled_payloads(name, len(boot_microseconds), **fields)


def _system_status(motion: Motion) -> NDArray[Any]:
    """Returns the ``system_status`` of HEARTBEAT (N,): a failsafe is critical, else a vehicle off the ground active."""
    status = np.where(motion.armed & (motion.landed_state != ON_GROUND), ACTIVE, STANDBY)
    if isinstance(motion, InstrumentedMotion):
        status = np.where(motion.is_failsafe, CRITICAL, status)
    return status


def _sensors_and_battery(motion: Motion) -> dict[str, Any]:
    """Returns the fields of SYS_STATUS; without instruments the current and the charge of the battery are unknown.

    Args:
        motion: N samples of the flight.

    Returns:
        Columns (N,), or one number for all samples, by field, in the units of the message: mV, cA and %.
    """
    fields: dict[str, Any] = {
        "onboard_control_sensors_present": SENSORS,
        "onboard_control_sensors_enabled": SENSORS,
        "onboard_control_sensors_health": SENSORS | FENCE,
        "voltage_battery": np.round(1000 * FULL_BATTERY_VOLTAGE * motion.battery),
        "current_battery": UNKNOWN_CURRENT,
        "battery_remaining": UNKNOWN_CHARGE,
    }
    if isinstance(motion, InstrumentedMotion):
        fields |= system_status_fields(motion, SENSORS)
        fields["onboard_control_sensors_health"] |= FENCE
    return fields


def _stick_channels(motion: Motion) -> dict[str, Any]:
    """Returns the fields of RC_CHANNELS except its time: PWM pulses of the pilot's sticks, µs.

    A stick at rest gives the pulse in the middle, 1500 µs. A stick to the right, or pulled back, which raises the nose,
    gives more. Only four channels are used: roll, pitch, throttle and yaw. The throttle is in the middle unless a pilot
    flies.

    Args:
        motion: N samples of the flight.

    Returns:
        Columns (N,), or one number for all samples, by field.
    """
    middle = pulse_width(0.5)
    pulses = middle + np.round((MAX_PULSE - middle) * motion.sticks / FULL_STICK)
    definition = definitions_by_name()["RC_CHANNELS"]
    fields: dict[str, Any] = {}
    for field in definition.fields:
        if field.endswith("_raw"):
            fields[field] = UNUSED
    for channel, axis in STICK_CHANNELS:
        fields[f"chan{channel}_raw"] = pulses[:, axis]
    fields |= {"chan3_raw": middle, "chancount": 4, "rssi": UNKNOWN_RSSI}
    if isinstance(motion, InstrumentedMotion):
        throttle = MIN_PULSE + (MAX_PULSE - MIN_PULSE) * motion.throttle_stick
        # A stick below 0 stands for a lost radio, whose signal strength is 0.
        signal_strength = np.where(motion.throttle_stick >= 0, MAX_RSSI, 0)
        fields |= {"chan3_raw": np.round(throttle), "rssi": signal_strength}
    return fields


def _global_position(motion: Motion) -> dict[str, Any]:
    """Returns the fields of GLOBAL_POSITION_INT except its time, in the message's integer units.

    Latitude and longitude are in 1e-7 degrees, altitudes in mm, velocities in cm/s, and the heading in 0.01 degrees.
    The Earth is taken as flat about ``HOME``, since flights are short.

    Args:
        motion: N samples of the flight.

    Returns:
        Columns (N,) by field.
    """
    north, east, down = motion.known_position.T
    latitude, longitude, altitude = HOME
    # Circles of latitude shrink with its cosine.
    east_degrees = east / METRES_PER_DEGREE / np.cos(np.radians(latitude))
    fields: dict[str, Any] = {
        "lat": np.round(1e7 * (latitude + north / METRES_PER_DEGREE)),
        "lon": np.round(1e7 * (longitude + east_degrees)),
        "alt": np.round(1000 * (altitude - down)),
        "relative_alt": np.round(-1000 * down),
        "hdg": np.round(100 * np.degrees(estimated_angles(motion)[:, 2])) % 36000,
    }
    return fields | named_columns("vx vy vz", np.round(100 * motion.known_velocity))


REAL32 = mavlink_constant("MAV_PARAM_TYPE_REAL32")
"""Type of all parameters that are no integers."""

PX4_X_AIRFRAME = 4001
"""SYS_AUTOSTART of PX4's generic quadrotor with an X frame."""

PX4_PLUS_AIRFRAME = 5001
"""SYS_AUTOSTART of PX4's generic quadrotor with a + frame."""


class Parameter(NamedTuple):
    """Name, type and value of a parameter, as the simulated autopilot reports it by MAVLink."""

    name: str
    """Name of the parameter."""
    mavlink_type: int
    """Its MAV_PARAM_TYPE."""
    value: float
    """Its value, a whole number where the type is an integer."""

    def float32_value(self, *, bitwise: bool) -> float:
        """Encodes the value for the message PARAM_VALUE, which carries a 32-bit float whatever the parameter's type.

        Args:
            bitwise: Whether the four bytes of an integer are copied into the float unchanged (PX4), rather than its
                value being converted (ArduPilot).

        Returns:
            The float. If bytes were copied, its value as a number means nothing.
        """
        if bitwise and self.mavlink_type != REAL32:
            integer_bytes = struct.pack("<i", int(self.value))
            return float(struct.unpack("<f", integer_bytes)[0])
        return self.value

    def value_of_float32(self, value: float, *, bitwise: bool) -> float:
        """Returns the value that the message PARAM_SET carries in a 32-bit float; the opposite of ``float32_value``."""
        if bitwise and self.mavlink_type != REAL32:
            float_bytes = struct.pack("<f", value)
            return float(struct.unpack("<i", float_bytes)[0])
        return value


def parameters(scenario: Scenario, autopilot: Autopilot) -> list[Parameter]:
    """Lists all parameters that the autopilot of a scenario reports.

    They are the autopilot's fixed ones, the MAVLink system id, the frame, and the parameters of its controllers.
    Where several have the same name, the value of the controllers counts.

    Args:
        scenario: Scenario with the vehicle, its gains and its system id.
        autopilot: Autopilot of the scenario, with the fixed parameters and the types of integers.

    Returns:
        The parameters with their types, in alphabetical order.
    """
    if autopilot.name == "px4":
        vehicle_parameters = _px4_vehicle_parameters(scenario)
    else:
        vehicle_parameters = _ardupilot_vehicle_parameters(scenario)
    values: dict[str, float] = {}
    mavlink_types: dict[str, int] = {}
    for mavlink_type, fixed_parameters in autopilot.parameters.items():
        values |= fixed_parameters
        mavlink_types |= dict.fromkeys(fixed_parameters, mavlink_type)
    values |= vehicle_parameters
    values |= control_parameters(scenario)
    return [
        Parameter(name, mavlink_types.get(name, REAL32), float(values[name]))
        for name in sorted(values)
    ]


def _ardupilot_vehicle_parameters(scenario: Scenario) -> dict[str, int]:
    """Returns the parameters by which ArduPilot describes the simulated vehicle.

    They are system id, frame, largest lean, and the outputs of the motors after the fourth.

    Args:
        scenario: Scenario whose vehicle has the frame, and whose stream the system id.

    Returns:
        Values by the name of the parameter.
    """
    layout = scenario.vehicle.layout
    if layout in CIRCLES:
        frame_type = CIRCLES[layout].frame_type
    else:
        # A quadrotor: 1 with its arms in an X, 0 with an arm forward.
        frame_type = int(layout == "x")
    parameters = {
        "MAV_SYSID": scenario.stream.system,
        "FRAME_TYPE": frame_type,
        "ATC_ANGLE_MAX": round(degrees(MAX_TILT)),
    }
    # The outputs of the first four motors are among the autopilot's fixed parameters.
    for motor in _motors_beyond_four(layout):
        parameters[f"SERVO{motor}_FUNCTION"] = ARDUPILOT_MOTOR_OFFSET + motor
    return parameters


def _px4_vehicle_parameters(scenario: Scenario) -> dict[str, int]:
    """Returns the parameters by which PX4 describes the simulated vehicle.

    They are system id, frame, largest lean, and the outputs of the motors after the fourth.

    Args:
        scenario: Scenario whose vehicle has the frame, and whose stream the system id.

    Returns:
        Values by the name of the parameter.
    """
    layout = scenario.vehicle.layout
    if layout in CIRCLES:
        airframe = CIRCLES[layout].px4_airframe
    else:
        airframe = PX4_X_AIRFRAME if layout == "x" else PX4_PLUS_AIRFRAME
    parameters = {
        "MAV_SYS_ID": scenario.stream.system,
        "MAV_TYPE": VEHICLE_TYPES[rotor_count(layout)],
        "SYS_AUTOSTART": airframe,
        "MPC_TILTMAX_AIR": round(degrees(MAX_TILT)),
    }
    for motor in _motors_beyond_four(layout):
        parameters[f"PWM_MAIN_FUNC{motor}"] = PX4_MOTOR_OFFSET + motor
    return parameters


def _motors_beyond_four(layout: Shape) -> range:
    """Returns the numbers of the motors after the fourth. Those up to it are in the autopilot's fixed parameters."""
    return range(5, rotor_count(layout) + 1)
