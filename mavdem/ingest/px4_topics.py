"""PX4's topics as MAVLink messages: which topic becomes which message, field by field.

PX4 translates in the same way when it sends these messages; each function names the file of
https://github.com/PX4/PX4-Autopilot/tree/main/src/modules/mavlink/streams it agrees with. Topics are defined in
https://github.com/PX4/PX4-Autopilot/tree/main/msg. Fields that no topic has are left out.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect
from scipy.spatial.transform import Rotation, Slerp

from mavdem.arrays import Array, Flags
from mavdem.facts import Facts
from mavdem.facts.sources import Repair
from mavdem.files import load_adjacent_toml
from mavdem.ingest.flight_modes import px4_custom_mode
from mavdem.ingest.mavlink.definitions import enum_name
from mavdem.ingest.motors import MOTOR_COUNTS, motor_geometry
from mavdem.ingest.telemetry import (
    MAX_GAP_SECONDS,
    Columns,
    Fields,
    Parameters,
    Tables,
    concatenated_columns,
    interpolated,
    last_values,
    rate_without_gaps,
    repair_facts,
    selected_rows,
    translated_fields,
)
from mavdem.ingest.vocabulary import (
    ACTIVE,
    CRITICAL,
    IN_AIR,
    LANDING,
    ON_GROUND,
    PX4,
    STANDBY,
    TAKING_OFF,
    UNNAMED,
    Injection,
    attitude_target,
    heartbeat_fields,
)

Topics = Mapping[str, Mapping[int, Columns]]
"""Fields by pyulog's names ("q[0]"), (N,) each, and ``time`` (N,) s since boot, by topic and number of the instance."""

_TOPICS = load_adjacent_toml(__file__, "px4_topics.toml")
NEEDED = {topic: tuple(fields) for topic, fields in _TOPICS.items()}
"""The topics that are read, and the fields of each beside ``timestamp``, arrays with their length."""
_RENAMED = load_adjacent_toml(__file__, "px4_messages.toml")
SETPOINTS = frozenset({"vehicle_attitude_setpoint", "vehicle_rates_setpoint"})
"""Those that a companion may send as well."""
OF_PX4 = ("failure_detector_status", "estimator_selector_status", "input_rc")
"""Topics that no message of MAVLink has the meaning of."""
OF_FLIGHT = {
    "ATTITUDE_QUATERNION",
    "SERVO_OUTPUT_RAW",
    "HIL_ACTUATOR_CONTROLS",
    "ACTUATOR_CONTROL_TARGET",
    "HEARTBEAT",
    "EXTENDED_SYS_STATE",
    "LOCAL_POSITION_NED",
}
"""Messages of which a flight has one at least."""
SAMPLES = {
    "GYRO": ("sensor_gyro_fifo", "gyro_rad"),
    "ACCEL": ("sensor_accel_fifo", "accelerometer_m_s2"),
}
"""The topic of each sensor's samples before the filters, and the field of sensor_combined that has their means."""

_GENERIC_MULTIROTOR: int = dialect.MAV_TYPE_GENERIC_MULTIROTOR
_OF_WINGS = (
    dialect.MAV_TYPE_GENERIC,
    _GENERIC_MULTIROTOR,
    dialect.MAV_TYPE_FIXED_WING,
    dialect.MAV_TYPE_GROUND_ROVER,
)
"""MAV_TYPE by vehicle_status.vehicle_type, which has no number of rotors: a multirotor, a fixed wing, a rover."""
_OUTPUTS = max(dialect.MAVLink_hil_actuator_controls_message.array_lengths)
_MOTORS = max(MOTOR_COUNTS.values())
_CONTROLS = max(dialect.MAVLink_actuator_control_target_message.array_lengths)


def mav_type(topics: Topics, parameters: Parameters) -> int | None:
    """Returns MAV_TYPE, from vehicle_status.system_type, the parameter MAV_TYPE, or the kind of wings.

    It is None without any.
    """
    status = _first(topics, "vehicle_status")
    types = [*status.get("system_type", ()), parameters.get("MAV_TYPE", 0)]
    types = [int(kind) for kind in types if 0 < kind < 256] or [
        *(_OF_WINGS[kind] for kind in status.get("vehicle_type", ()) if 0 < kind < len(_OF_WINGS)),
        *(_GENERIC_MULTIROTOR for rotary in status.get("is_rotary_wing", ()) if rotary),
    ]
    return max(set(types), key=types.count, default=None)


def messages(
    topics: Topics, parameters: Parameters
) -> tuple[str, dict[str, Columns], dict[str, str]]:
    """Returns the MAV_TYPE, messages that topics make by name, and the topic of each, also of those that could be made.

    ``time`` is PX4's own stamp of the topic, ``boot`` 0 throughout.
    """
    kind = mav_type(topics, parameters)
    vehicle = UNNAMED if kind is None else enum_name("MAV_TYPE", kind)
    old = "actuator_controls_0" in topics and "vehicle_torque_setpoint" not in topics
    demand = "actuator_controls_0" if old else "vehicle_torque_setpoint"
    attitude = _made(_attitude_quaternion, topics)
    rates = _first(topics, "vehicle_angular_velocity")
    by_rates = bool(attitude and rates) and np.isin(attitude["time"], rates["time"]).all()
    makers = {
        "SERVO_OUTPUT_RAW": ("actuator_outputs", _servo_output_raw),
        "ACTUATOR_CONTROL_TARGET": (demand, _actuator_control_target),
        "EXTENDED_SYS_STATE": ("vehicle_land_detected", _extended_sys_state),
        "LOCAL_POSITION_NED": ("vehicle_local_position", _local_position_ned),
        "ATTITUDE_TARGET": (" and ".join(sorted(SETPOINTS, reverse=True)), _attitude_target),
        "SIDD": ("autotune_attitude_control_status", _injected),
        "SYS_STATUS": ("battery_status", _sys_status),
        "VIBRATION": ("vehicle_imu_status", _vibration),
        "SYSTEM_TIME": ("vehicle_gps_position", _system_time),
        "CURRENT_MODE": ("vehicle_status", _current_mode),
        "ESC": ("esc_status", _motor_speeds),
    }
    named = {
        "ATTITUDE_QUATERNION": (
            "vehicle_angular_velocity" if by_rates else "vehicle_attitude",
            attitude,
        ),
        "HIL_ACTUATOR_CONTROLS": (
            "actuator_motors",
            _made(_hil_actuator_controls, topics, vehicle, parameters),
        ),
        "HEARTBEAT": ("vehicle_status", _made(_heartbeat, topics, kind or 0)),
        **{
            name: (rule["topics"][0], _made(_renamed, topics, name))
            for name, rule in _RENAMED.items()
        },
        **{name: (topic, _made(make, topics)) for name, (topic, make) in makers.items()},
        **{name: (name, _made(_as_logged, topics, name)) for name in OF_PX4},
    }
    for sensor, (name, field) in SAMPLES.items():
        topic = name if name in topics else "sensor_combined"
        named[f"{sensor}_BEFORE"] = topic, _made(_samples, topics, name, field)
    made: dict[str, Columns] = {name: columns for name, (_, columns) in named.items() if columns}
    made = made if OF_FLIGHT & made.keys() else {}
    return vehicle, made, {name: topic for name, (topic, _) in named.items()}


def _made(make: Callable[..., Fields], *given: Any) -> Fields:
    """A message by one of the functions below; nothing where a topic, or a field of it, was not logged."""
    try:
        columns = make(*given)
    except KeyError:
        return {}
    time = columns.get("time", np.zeros(0))
    return columns | {"boot": np.zeros(len(time), dtype=np.int64)} if len(time) else {}


def notes(topics: Topics, made: Tables) -> Facts:
    """Returns a repair where attitude was interpolated, as the body rates were logged clearly more often."""
    logged = [topic["time"] for topic in topics.get("vehicle_attitude", {}).values()]
    stamps = made.get("ATTITUDE_QUATERNION", {"time": np.zeros(0)})["time"]
    if len(stamps) <= 1.1 * max(map(len, logged), default=0):
        return ()
    attitude, rates = (rate_without_gaps(np.diff(time)) for time in (max(logged, key=len), stamps))
    return repair_facts(Repair.ATTITUDE_INTERPOLATED, attitude_rate=attitude, rate=rates)


def _attitude_quaternion(topics: Topics) -> Fields:
    """ATTITUDE_QUATERNION.hpp: vehicle_attitude and, from PX4 1.10 on, vehicle_angular_velocity for the rates.

    PX4 sends the rates that were last published. Here attitude, the smoother of the two, is interpolated at the stamps
    of the rates, so that neither is late. Only an attitude too slow for that keeps its own stamps.
    """
    attitude = _first(topics, "vehicle_attitude")
    q = _array(attitude, "q", 4)
    rates = ("rollspeed", "pitchspeed", "yawspeed")
    names = ("q1", "q2", "q3", "q4", *rates)
    if all(name in attitude for name in rates):
        return {
            "time": attitude["time"],
            **dict(zip(names, q.T, strict=False)),
            **{n: attitude[n] for n in rates},
        }
    angular = _first(topics, "vehicle_angular_velocity")
    xyz = _array(angular, "xyz", 3)
    time = angular["time"]
    finite = np.flatnonzero(np.isfinite(q).all(axis=1) & q.any(axis=1))
    stamps, first = np.unique(attitude["time"][finite], return_index=True)
    q = q[finite[first]]
    if len(q) < 2:
        return {}
    steps = np.diff(stamps)
    if np.median(steps) > MAX_GAP_SECONDS:
        xyz = interpolated(stamps, time, xyz)
        time = stamps
    else:
        after = np.clip(np.searchsorted(stamps, time), 1, len(stamps) - 1)
        inside = (time >= stamps[0]) & (time <= stamps[-1]) & (steps[after - 1] <= MAX_GAP_SECONDS)
        xyz = xyz[inside]
        time = time[inside]
        turned = Slerp(stamps, Rotation.from_quat(q, scalar_first=True))
        q = turned(time).as_quat(scalar_first=True)
    return {"time": time, **dict(zip(names, [*q.T, *xyz.T], strict=True))}


def _servo_output_raw(topics: Topics) -> Fields:
    """SERVO_OUTPUT_RAW.hpp: actuator_outputs, each instance a port of 16, with the decimals the message cuts off.

    An instance that two drivers publish in turn, each with its ``noutputs``, becomes two ports.
    """
    ports = []
    for instance, topic in topics.get("actuator_outputs", {}).items():
        used = topic.get("noutputs", np.zeros(len(topic["time"])))
        kinds = np.unique(used)
        in_turn = np.count_nonzero(np.diff(used)) >= 2 * len(kinds)
        parts = [selected_rows(topic, used == kind) for kind in kinds] if in_turn else [topic]
        parts.sort(key=lambda part: -float(np.ptp(part["output[0]"])))
        for number, part in enumerate(parts):
            outputs = _outputs(part)
            port = np.full(len(outputs), instance + _OUTPUTS * number, dtype=np.uint8)
            fields = {f"servo{n + 1}_raw": outputs[:, n] for n in range(_OUTPUTS)}
            ports.append({"time": part["time"], "port": port, **fields})
    return _in_time(ports)


def _outputs(topic: Columns) -> Array:
    """(N, 16), zero beyond the number of outputs in use, unless that is 0."""
    none = np.zeros(len(topic["time"]))
    columns = [topic.get(f"output[{n}]", none) for n in range(_OUTPUTS)]
    outputs = np.column_stack(columns).astype(np.float64)
    used = topic.get("noutputs", none)
    return np.where((used[:, None] > 0) & (np.arange(_OUTPUTS) >= used[:, None]), 0.0, outputs)


def _hil_actuator_controls(topics: Topics, vehicle: str, parameters: Parameters) -> Fields:
    """HIL_ACTUATOR_CONTROLS, which has outputs as shares of the range: actuator_motors, from PX4 1.13 on.

    The topic counts motors, the message channels: each motor is put on the channel that the parameters give it. NaN,
    a motor that is off, becomes 0.
    """
    topic = _first(topics, "actuator_motors")
    plan = motor_geometry(vehicle, "PX4", parameters, range(1, _OUTPUTS + 1), _OUTPUTS)
    channel = {motor: motor for motor in range(1, _MOTORS + 1)}
    if plan is not None and not plan.channels_assumed:
        channel = dict(zip(plan.motors, plan.channels, strict=True))
    controls = np.zeros((len(topic["control[0]"]), _OUTPUTS))
    for motor in range(1, _MOTORS + 1):
        if f"control[{motor - 1}]" in topic and motor in channel:
            control = topic[f"control[{motor - 1}]"]
            controls[:, channel[motor] - 1] = np.where(np.isfinite(control), control, 0.0)
    return {"time": topic["time"], "controls": controls}


def _actuator_control_target(topics: Topics) -> Fields:
    """ACTUATOR_CONTROL_TARGET: the demands on roll, pitch, yaw (−1…1) and thrust (0…1), group 0.

    From vehicle_torque_setpoint and vehicle_thrust_setpoint, whose z points down, or the actuator_controls_0 of PX4
    before 1.14, whose controls the message sent as they are (ACTUATOR_CONTROL_TARGET.hpp until then).
    """
    if torque := _first(topics, "vehicle_torque_setpoint"):
        controls = np.zeros((len(torque["time"]), _CONTROLS))
        controls[:, :3] = _array(torque, "xyz", 3)
        thrust = _first(topics, "vehicle_thrust_setpoint")
        if "xyz[2]" in thrust:
            controls[:, 3] = np.interp(torque["time"], thrust["time"], -thrust["xyz[2]"])
        time = torque["time"]
    else:
        old = _first(topics, "actuator_controls_0")
        controls = _array(old, "control", _CONTROLS)
        time = old["time"]
    return {"time": time, "group_mlx": np.zeros(len(time), dtype=np.uint8), "controls": controls}


def _attitude_target(topics: Topics) -> Fields:
    """ATTITUDE_TARGET.hpp: vehicle_attitude_setpoint and vehicle_rates_setpoint, rad/s; each masks the other."""
    parts = []
    attitude = _first(topics, "vehicle_attitude_setpoint")
    rates = _first(topics, "vehicle_rates_setpoint")
    if "q_d[3]" in attitude:
        attitude = selected_rows(attitude, _valid(attitude, "q_d_valid"))
        parts.append({"time": attitude["time"], **attitude_target(_array(attitude, "q_d", 4))})
    if all(axis in rates for axis in ("roll", "pitch", "yaw")):
        asked = np.column_stack([rates[axis] for axis in ("roll", "pitch", "yaw")]).astype(
            np.float64
        )
        parts.append({"time": rates["time"], **attitude_target(asked)})
    return _in_time(parts)


def _in_time(parts: Sequence[Columns]) -> Fields:
    together = concatenated_columns(parts or [{"time": np.zeros(0)}])
    return selected_rows(together, np.argsort(together["time"], kind="stable"))


def _renamed(topics: Topics, message: str) -> Fields:
    rule = _RENAMED[message]
    topic = next(filter(None, (_first(topics, name) for name in rule["topics"])), {})
    return {
        "time": topic["time"],
        **translated_fields(topic, rule["fields"], rule.get("optional_fields")),
    }


def _sys_status(topics: Topics) -> Fields:
    """SYS_STATUS.hpp, with the decimals the message cuts off.

    Beside its fields, ``charge_state`` of BATTERY_STATUS, MAV_BATTERY_CHARGE_STATE.
    """
    columns = _renamed(topics, "SYS_STATUS")
    warning = _first(topics, "battery_status").get("warning")
    return columns if warning is None else columns | {"charge_state": warning + 1}


def _vibration(topics: Topics) -> Fields:
    """VIBRATION.hpp: vehicle_imu_status; z is the level of the first IMU's acceleration, m/s².

    ``levels`` are those of each IMU, and the counts of clips are of an IMU each, of all its axes.
    """
    status = _first(topics, "vehicle_imu_status")
    # Before PX4 1.13, which has no gyro_clipping yet, the level was that of the velocity's increments.
    if "gyro_clipping[2]" not in status:
        return {}
    time = status["time"]
    levels = []
    clips = {f"clipping_{number}": np.zeros(len(time)) for number in range(3)}
    for name, (_, imu) in zip(clips, sorted(topics["vehicle_imu_status"].items()), strict=False):
        levels.append(np.interp(time, imu["time"], imu["accel_vibration_metric"]))
        counted = _array(imu, "accel_clipping", 3).sum(axis=1)
        clips[name] = np.interp(time, imu["time"], counted)
    return {"time": time, "vibration_z": levels[0], **clips, "levels": np.column_stack(levels)}


def _system_time(topics: Topics) -> Fields:
    """SYSTEM_TIME.hpp: vehicle_gps_position, where the receiver knows the time."""
    gps = _first(topics, "vehicle_gps_position")
    timed = selected_rows(gps, gps["time_utc_usec"] > 0)
    return {"time": timed["time"], "time_unix_usec": timed["time_utc_usec"]}


def _injected(topics: Topics) -> Fields:
    """The rates that PX4's autotune adds to the setpoint, three a time, as ArduPilot's SIDD has such: degrees/s."""
    topic = _first(topics, "autotune_attitude_control_status")
    rates = np.degrees(_array(topic, "rate_sp", 3))
    axis = np.tile(Injection.RATE_SETPOINT + np.arange(3), len(rates))
    return {"time": np.repeat(topic["time"], 3), "axis": axis, "target": rates.ravel()}


def _as_logged(topics: Topics, name: str) -> Fields:
    topic = _first(topics, name)
    fields = {field: topic[field] for field in NEEDED[name] if field in topic}
    return {"time": topic["time"], **fields}


def _samples(topics: Topics, name: str, field: str) -> Fields:
    """``x``, ``y``, ``z``, rad/s or m/s², of samples before the filters: up to 32 in a message of a FIFO."""
    if not (fifo := _first(topics, name)):
        combined = _first(topics, "sensor_combined")
        return {
            "time": combined["time"],
            **dict(zip("xyz", _array(combined, field, 3).T, strict=True)),
        }
    places = np.arange(32)
    inside = places < fifo["samples"][:, None]
    late = fifo["time"] - (fifo["timestamp"] - fifo["timestamp_sample"].astype(np.float64)) / 1e6
    before = (fifo["samples"][:, None] - 1 - places) * fifo["dt"][:, None] / 1e6
    scaled = {axis: (_array(fifo, axis, 32) * fifo["scale"][:, None])[inside] for axis in "xyz"}
    return {"time": (late[:, None] - before)[inside], **scaled}


def _motor_speeds(topics: Topics) -> Fields:
    """ESC as DataFlash has it, a row for each motor: RPM."""
    topic = _first(topics, "esc_status")
    speeds = np.column_stack([topic[f"esc[{n}].esc_rpm"] for n in range(4)])
    return {"time": np.repeat(topic["time"], 4), "RPM": abs(speeds).ravel()}


def _current_mode(topics: Topics) -> Fields:
    """CURRENT_MODE.hpp: the custom mode of vehicle_status.nav_state."""
    status = _first(topics, "vehicle_status")
    return {"time": status["time"], "custom_mode": px4_custom_mode(status["nav_state"])}


def _heartbeat(topics: Topics, kind: int) -> Fields:
    """HEARTBEAT.hpp: vehicle_status. The state "armed" has been 2 in every version."""
    status = _first(topics, "vehicle_status")
    armed = status["arming_state"] == 2
    failsafe = status.get("failsafe", np.zeros(len(armed))).astype(np.bool_)
    system_status = np.where(failsafe, CRITICAL, np.where(armed, ACTIVE, STANDBY))
    fields = heartbeat_fields(kind, PX4, armed)
    return {"time": status["time"], **fields, "system_status": system_status}


def _extended_sys_state(topics: Topics) -> Fields:
    """EXTENDED_SYS_STATE.hpp: vehicle_land_detected, what an automatic mode flies to; a row whenever a topic came.

    Also one at the first message of each second: old PX4 logged the state at its changes only.
    """
    land = _first(topics, "vehicle_land_detected")
    mode = _first(topics, "vehicle_control_mode")
    target = _first(topics, "position_setpoint_triplet")
    if "landed" not in land:
        return {}
    logged = np.unique(
        np.concatenate([topic["time"] for group in topics.values() for topic in group.values()])
    )
    _, first = np.unique(np.floor(logged), return_index=True)
    came = [topic["time"] for topic in (land, mode, target) if topic]
    time = np.unique(np.concatenate([*came, logged[first]]))
    time = time[time >= land["time"].min()]
    state = np.where(_held(land, "landed", time), ON_GROUND, IN_AIR)
    automatic = (_held(mode, "flag_control_auto_enabled", time) > 0) & (
        _held(target, "current.valid", time) > 0
    )
    heading_for = _held(target, "current.type", time)
    # SETPOINT_TYPE_TAKEOFF and SETPOINT_TYPE_LAND
    for kind, phase in ((3, TAKING_OFF), (4, LANDING)):
        state[(state == IN_AIR) & automatic & (heading_for == kind)] = phase
    return {"time": time, "landed_state": state.astype(np.uint8)}


def _held(topic: Columns, field: str, time: Array) -> NDArray[Any]:
    """The field's last value at each time (N,); 0 before the first, and where it was not logged."""
    if field not in topic:
        return np.zeros(len(time))
    return last_values(time, topic["time"], topic[field])


def _local_position_ned(topics: Topics) -> Fields:
    """LOCAL_POSITION_NED.hpp: vehicle_local_position where its vertical speed is valid; m and m/s.

    Beside the message's fields, ``valid``: whether its horizontal velocity and the heading are, and ``resets``,
    ODOMETRY's counter of jumps.
    """
    topic = _first(topics, "vehicle_local_position")
    fields = ("time", "x", "y", "z", "vx", "vy", "vz")
    valid = _valid(topic, "v_xy_valid") & _valid(topic, "heading_good_for_control")
    columns = {field: topic[field] for field in fields} | {"valid": valid}
    if "xy_reset_counter" in topic:
        columns["resets"] = topic["xy_reset_counter"]
    return selected_rows(columns, _valid(topic, "v_z_valid"))


def _valid(topic: Columns, field: str) -> Flags:
    return topic.get(field, np.ones(len(topic["time"]))).astype(np.bool_)


def _first(topics: Topics, name: str) -> Columns:
    """The instance of the lowest number; empty where there is none."""
    instances = topics.get(name)
    return instances[min(instances)] if instances else {}


def _array(topic: Columns, field: str, count: int) -> Array:
    return np.column_stack([topic[f"{field}[{n}]"] for n in range(count)]).astype(np.float64)
