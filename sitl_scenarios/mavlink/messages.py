"""Messages: payloads by column for rows of a motion, and the autopilot's parameters.

Fields, units and signs are those of the definitions (https://mavlink.io/en/messages/common.html): angles rad, body
rates rad/s, north-east-down m and m/s, PWM µs; parameters travel in PARAM_VALUE's float as
https://mavlink.io/en/services/parameter.html#parameter-encoding has it.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavdem.ingest.mavlink.definitions import MessageDefinition, definitions
from sitl_scenarios.dynamics import DISARMED_PULSE, MAX_PULSE, MIN_PULSE, SPINS, euler, frame
from sitl_scenarios.mavlink.autopilots import ARMED, IN_AIR, LANDING, ON_GROUND, TAKING_OFF, Autopilot
from sitl_scenarios.motion import Motion
from sitl_scenarios.plan import FULL_STICK
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.sensors import vibration
from sitl_scenarios.vehicles import AIRFRAMES, CHARGED

Array = NDArray[np.float64]
Payloads = NDArray[Any]  # (N,) of a definition's wire type
QUADROTOR = 2  # MAV_TYPE
ACTIVE, STANDBY = 4, 3  # MAV_STATE
SENSORS, FENCE = 0b1111, 1 << 20
"""MAV_SYS_STATUS_SENSOR: gyroscopes, accelerometers, magnetometer, barometer; and the fence, which is not breached."""
LIPO, UNKNOWN_TEMPERATURE, UNUSED_CELL = 1, 32767, 65535  # Of BATTERY_STATUS
MIDDLE_PULSE = 1500.0  # µs of a stick in the middle
RC_CHANNELS, UNUSED_CHANNEL, UNKNOWN_RSSI = 18, 65535, 255  # Of RC_CHANNELS: 1 roll, 2 pitch, 3 throttle, 4 yaw
CHANNELS = 16  # Outputs in SERVO_OUTPUT_RAW and PX4's other output messages


@cache
def named(name: str) -> MessageDefinition:
    """The definition of a message."""
    return next(message for message in definitions().values() if message.name == name)


def payload(name: str, count: int = 1, /, **fields: Any) -> Payloads:
    """Messages, (count,) of their wire type; fields that are not given are zero."""
    table: Payloads = np.zeros(count, dtype=named(name).wire)
    for field, values in fields.items():
        table[field] = values
    return table


class MessageWriter:
    """Makes the payloads of one vehicle; the method of a message has its name."""

    def __init__(self, autopilot: Autopilot, scenario: Scenario) -> None:
        self._autopilot, self._scenario = autopilot, scenario

    def write(self, name: str, motion: Motion, boot: NDArray[np.int64]) -> Payloads:
        """The payloads (N,) of a message, one for each row of ``motion``, at ``boot`` (N,), µs since boot."""
        fields: dict[str, Any] = getattr(self, f"_{name.lower()}")(motion, boot)
        return payload(name, len(boot), **fields)

    def _heartbeat(self, motion: Motion, boot: NDArray[np.int64]) -> dict[str, Any]:
        base, custom = self._modes(motion)
        flies = motion.armed & (self._autopilot.active_when_armed | (motion.landed_state != ON_GROUND))
        starts = ~motion.armed & (boot < 3e6)
        return {
            "type": QUADROTOR,
            "autopilot": self._autopilot.number,
            "base_mode": base,
            "custom_mode": custom,
            "system_status": np.select([flies, starts], [ACTIVE, self._autopilot.starting], STANDBY),
            "mavlink_version": 3,
        }

    def _modes(self, motion: Motion) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        table = np.zeros((LANDING + 1, 2), dtype=np.int64)
        for state in (ON_GROUND, IN_AIR, TAKING_OFF, LANDING):
            table[state] = self._autopilot.modes[state]
        base, custom = table[motion.landed_state].T
        return base + ARMED * motion.armed, custom

    def _sys_status(self, motion: Motion, boot: NDArray[np.int64]) -> dict[str, Any]:
        sensors = {"present": SENSORS, "enabled": SENSORS, "health": SENSORS | FENCE}
        battery = {"voltage_battery": _millivolts(motion), "current_battery": -1, "battery_remaining": -1}
        return {f"onboard_control_sensors_{name}": bits for name, bits in sensors.items()} | battery

    def _battery_status(self, motion: Motion, boot: NDArray[np.int64]) -> dict[str, Any]:
        # The whole battery's voltage in the first place, as where no cell is measured by itself.
        voltages = np.full((len(boot), 10), UNUSED_CELL)
        voltages[:, 0] = _millivolts(motion)
        unknown = dict.fromkeys(("current_battery", "current_consumed", "energy_consumed", "battery_remaining"), -1)
        return {"type": LIPO, "temperature": UNKNOWN_TEMPERATURE, "voltages": voltages} | unknown

    def _extended_sys_state(self, motion: Motion, boot: NDArray[np.int64]) -> dict[str, Any]:
        return {"landed_state": motion.landed_state}

    def _attitude(self, motion: Motion, boot: NDArray[np.int64]) -> dict[str, Any]:
        roll, pitch, yaw = np.array([euler(attitude) for attitude in motion.known_attitude.tolist()]).T
        return {"time_boot_ms": _milliseconds(boot), "roll": roll, "pitch": pitch, "yaw": yaw, **_rates(motion)}

    def _attitude_quaternion(self, motion: Motion, boot: NDArray[np.int64]) -> dict[str, Any]:
        q1, q2, q3, q4 = motion.known_attitude.T
        return {"time_boot_ms": _milliseconds(boot), "q1": q1, "q2": q2, "q3": q3, "q4": q4, **_rates(motion)}

    def _attitude_target(self, motion: Motion, boot: NDArray[np.int64]) -> dict[str, Any]:
        # No bit of type_mask is set: both autopilots say all of it is meant (PX4's streams/ATTITUDE_TARGET.hpp,
        # ArduCopter's send_attitude_target).
        q = Rotation.from_euler("ZYX", motion.attitude_setpoint[:, ::-1]).as_quat(scalar_first=True)
        p, q_rate, r = motion.rates_setpoint.T
        asked = {"body_roll_rate": p, "body_pitch_rate": q_rate, "body_yaw_rate": r, "thrust": motion.demands[:, 3]}
        return {"time_boot_ms": _milliseconds(boot), "q": q, "type_mask": 0} | asked

    def _rc_channels(self, motion: Motion, boot: NDArray[np.int64]) -> dict[str, Any]:
        # A stick to the right, or drawn back, which raises the nose, is more than the middle's pulse.
        moved = MIDDLE_PULSE + np.round((MAX_PULSE - MIDDLE_PULSE) * motion.sticks / FULL_STICK)
        sent: dict[str, Any] = {f"chan{n}_raw": UNUSED_CHANNEL for n in range(1, RC_CHANNELS + 1)}
        sent |= {f"chan{n}_raw": moved[:, axis] for n, axis in ((1, 0), (2, 1), (4, 2))} | {"chan3_raw": MIDDLE_PULSE}
        return {"time_boot_ms": _milliseconds(boot), "chancount": 4, "rssi": UNKNOWN_RSSI} | sent

    def _local_position_ned(self, motion: Motion, boot: NDArray[np.int64]) -> dict[str, Any]:
        x, y, z = motion.known_position.T
        vx, vy, vz = motion.known_velocity.T
        return {"time_boot_ms": _milliseconds(boot), "x": x, "y": y, "z": z, "vx": vx, "vy": vy, "vz": vz}

    def _servo_output_raw(self, motion: Motion, boot: NDArray[np.int64]) -> dict[str, Any]:
        outputs = self._outputs(motion)
        # The one clock of 32-bit microseconds: it wraps every 71.6 minutes.
        return {"time_usec": boot % 2**32} | {f"servo{n + 1}_raw": np.round(outputs[:, n]) for n in range(CHANNELS)}

    def _actuator_output_status(self, motion: Motion, boot: NDArray[np.int64]) -> dict[str, Any]:
        actuator = np.zeros((len(boot), 32))
        actuator[:, :CHANNELS] = self._outputs(motion)
        return {"time_usec": boot, "active": CHANNELS, "actuator": actuator}

    def _hil_actuator_controls(self, motion: Motion, boot: NDArray[np.int64]) -> dict[str, Any]:
        controls = np.zeros((len(boot), CHANNELS))
        # A motor that is stopped has less than the lowest pulse, and no negative command.
        controls[:, :4] = np.maximum((motion.outputs - MIN_PULSE) / (MAX_PULSE - MIN_PULSE), 0.0)
        return {"time_usec": boot, "controls": controls, "mode": self._modes(motion)[0]}

    def _vibration(self, motion: Motion, boot: NDArray[np.int64]) -> dict[str, Any]:
        # As ArduPilot means it: the accelerometer's RMS above 5 Hz.
        x, y, z = vibration(self._scenario, motion).T
        return {"time_usec": boot, "vibration_x": x, "vibration_y": y, "vibration_z": z}

    def _outputs(self, motion: Motion) -> Array:
        """(N, 16) PWM of every channel."""
        outputs = np.full((len(motion), CHANNELS), self._autopilot.unused)
        outputs[:, : motion.outputs.shape[1]] = motion.outputs
        return outputs


def _rates(motion: Motion) -> dict[str, Array]:
    p, q, r = motion.known_rates.T
    return {"rollspeed": p, "pitchspeed": q, "yawspeed": r}


def _millivolts(motion: Motion) -> Array:
    return np.round(1000 * CHARGED * motion.battery)


def _milliseconds(boot: NDArray[np.int64]) -> NDArray[np.int64]:
    return boot // 1000 % 2**32


INT8, INT16, INT32, REAL32 = 2, 4, 6, 9  # MAV_PARAM_TYPE
INTEGERS = {INT8: 8, INT16: 16, INT32: 32}  # Bits of the integer types
MOTORS = 4


@dataclass(frozen=True)
class Parameter:
    """A parameter of MAV_PARAM_TYPE ``kind``; ``value`` is whole where that is an integer type."""

    name: str
    kind: int
    value: float

    def encoded(self, bitwise: bool) -> float:
        """PARAM_VALUE.param_value."""
        if bitwise and self.kind in INTEGERS:
            return float(struct.unpack("<f", struct.pack("<i", int(self.value)))[0])
        return self.value

    def changed(self, sent: float, bitwise: bool) -> Parameter | None:
        """The parameter as a PARAM_SET of ``param_value`` ``sent`` makes it; None for a value that it cannot have."""
        value = sent
        if bitwise and self.kind in INTEGERS:
            value = float(struct.unpack("<i", struct.pack("<f", sent))[0])
        elif self.kind in INTEGERS and abs(sent) < 2**31:
            value = float(round(sent))
        if self.kind in INTEGERS:
            limit = 2.0 ** (INTEGERS[self.kind] - 1)
            return Parameter(self.name, self.kind, value) if -limit <= value < limit else None
        return Parameter(self.name, self.kind, value) if abs(value) < 3.4e38 else None


def parameters(scenario: Scenario, autopilot: Autopilot, cycle: float) -> dict[str, Parameter]:
    """An autopilot's parameters by name, in alphabetical order; ``cycle`` of its loop in s."""
    by_kind = _px4(scenario) if autopilot.bitwise else _ardupilot(scenario, cycle)
    made = [Parameter(name, kind, value) for kind, values in by_kind.items() for name, value in values.items()]
    return {parameter.name: parameter for parameter in sorted(made, key=lambda parameter: parameter.name)}


def _px4(scenario: Scenario) -> dict[int, dict[str, float]]:
    whole: dict[str, float] = {"CA_AIRFRAME": 0, "CA_ROTOR_COUNT": MOTORS, "MAV_SYS_ID": scenario.stream.system}
    whole |= {"MAV_TYPE": QUADROTOR, "SYS_AUTOSTART": {"x": 4001, "plus": 5001}[scenario.vehicle.frame]}
    whole |= {f"PWM_MAIN_FUNC{n}": 100 + n if n <= MOTORS else 0 for n in range(1, 9)}
    for bound, value in (("DIS", DISARMED_PULSE["px4"]), ("MIN", MIN_PULSE), ("MAX", MAX_PULSE)):
        whole |= {f"PWM_MAIN_{bound}{n}": value for n in range(1, MOTORS + 1)}
    real: dict[str, float] = _thrust_curve("THR_MDL_FAC", scenario)
    rotors = frame(scenario.vehicle.frame, AIRFRAMES[scenario.vehicle.model].arm)
    for n in range(MOTORS):
        real |= {f"CA_ROTOR{n}_PX": rotors.forward[n], f"CA_ROTOR{n}_PY": rotors.right[n], f"CA_ROTOR{n}_PZ": 0.0}
        real |= {f"CA_ROTOR{n}_CT": 6.5, f"CA_ROTOR{n}_KM": 0.05 * SPINS[n]}  # KM: positive counter-clockwise
    return {INT32: whole, REAL32: real}


def _ardupilot(scenario: Scenario, cycle: float) -> dict[int, dict[str, float]]:
    small: dict[str, float] = {"FRAME_CLASS": 1, "FRAME_TYPE": {"plus": 0, "x": 1}[scenario.vehicle.frame]}
    medium: dict[str, float] = {"MAV_SYSID": scenario.stream.system, "SCHED_LOOP_RATE": round(1 / cycle)}
    medium |= {"MOT_PWM_MAX": MAX_PULSE, "MOT_PWM_MIN": MIN_PULSE}
    for n in range(1, 9):
        medium |= {f"SERVO{n}_FUNCTION": 32 + n if n <= MOTORS else 0}
        medium |= {f"SERVO{n}_MIN": MIN_PULSE, f"SERVO{n}_MAX": MAX_PULSE, f"SERVO{n}_TRIM": 1500}
        small |= {f"SERVO{n}_REVERSED": 0}
    return {INT8: small, INT16: medium, REAL32: _thrust_curve("MOT_THST_EXPO", scenario)}


def _thrust_curve(name: str, scenario: Scenario) -> dict[str, float]:
    """The parameter by which an autopilot undoes the thrust curve: its share that is quadratic in the command."""
    share = scenario.vehicle.quadratic_thrust
    return {} if share is None else {name: share}
