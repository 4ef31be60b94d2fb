"""MAVLink messages from PX4's topics, field by field; each function makes one message.

PX4 translates in the same way when it sends these messages; each function names the file of
https://github.com/PX4/PX4-Autopilot/tree/main/src/modules/mavlink/streams it agrees with. Fields that no topic has are
left out. A function raises KeyError where a topic, or a field of it, was not logged.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array
from mavdem.files import load_adjacent_toml
from mavdem.ingest.flight_modes import px4_custom_mode
from mavdem.ingest.mavlink.dialect import definitions_by_name
from mavdem.ingest.px4_topics import (
    TOPIC_FIELDS,
    Topics,
    array_field,
    first_instance,
    flag_or_true,
    in_time_order,
    last_field_values,
)
from mavdem.ingest.telemetry import (
    MAX_GAP_SECONDS,
    MICROSECONDS,
    Fields,
    begins_value,
    fields_by_rule,
    firsts_of_seconds,
    interpolated,
    selected_rows,
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
    Injection,
    attitude_target,
    heartbeat_fields,
    quaternion,
)

TRANSLATION_RULES = load_adjacent_toml(__file__, "px4_messages.toml")
"""How topics are translated of which fields change names and units only, by name of MAVLink's message."""

QUATERNION_FIELDS = ("q1", "q2", "q3", "q4")
"""Fields of ATTITUDE_QUATERNION with w, x, y and z."""

BODY_RATE_FIELDS = ("rollspeed", "pitchspeed", "yawspeed")
"""Fields of ATTITUDE_QUATERNION, and of vehicle_attitude before PX4 1.10, with the body rates, rad/s."""


def attitude_quaternion(topics: Topics) -> Fields:
    """Makes ATTITUDE_QUATERNION (PX4's ATTITUDE_QUATERNION.hpp): attitude of vehicle_attitude, and the body rates.

    From PX4 1.10 on, the rates are in vehicle_angular_velocity. PX4 sends the rates that were last published. Here
    attitude, the smoother of the two, is interpolated at the stamps of the rates, by spherical linear interpolation
    (slerp), so that neither is late. Only an attitude too slow for that keeps its own stamps, and the rates are
    interpolated there.

    Args:
        topics: The logged topics, by name and number of the instance.

    Returns:
        ``time`` (N,), s, quaternions w, x, y, z in ``q1`` to ``q4``, and body rates, rad/s. Rates in gaps of the
        attitude are left out.
    """
    attitude = first_instance(topics, "vehicle_attitude")
    quaternions = array_field(attitude, "q", 4)
    if all(name in attitude for name in BODY_RATE_FIELDS):
        body_rates = {name: attitude[name] for name in BODY_RATE_FIELDS}
        quaternion_columns = dict(zip(QUATERNION_FIELDS, quaternions.T, strict=True))
        return {"time": attitude["time"], **quaternion_columns, **body_rates}
    angular_velocity = first_instance(topics, "vehicle_angular_velocity")
    rates = array_field(angular_velocity, "xyz", 3)
    rate_time = angular_velocity["time"]
    is_valid = np.isfinite(quaternions).all(axis=1) & quaternions.any(axis=1)
    valid_rows = np.flatnonzero(is_valid)
    # Between equal stamps nothing can be interpolated: the first message of each stamp is used. Stamps ascend.
    valid_time = attitude["time"][valid_rows]
    is_first = begins_value(valid_time)
    attitude_time = valid_time[is_first]
    quaternions = quaternions[valid_rows[is_first]]
    if len(quaternions) < 2:
        return {}
    steps = np.diff(attitude_time)
    if np.median(steps) > MAX_GAP_SECONDS:
        time = attitude_time
        rates = interpolated(attitude_time, rate_time, rates)
    else:
        # The row of the attitude after each stamp of the rates; the step before it shows whether there is a gap.
        next_rows = np.clip(np.searchsorted(attitude_time, rate_time), 1, len(attitude_time) - 1)
        is_covered = (rate_time >= attitude_time[0]) & (rate_time <= attitude_time[-1])
        is_usable = is_covered & (steps[next_rows - 1] <= MAX_GAP_SECONDS)
        time = rate_time[is_usable]
        rates = rates[is_usable]
        quaternions = interpolated_rotations(time, attitude_time, quaternions, next_rows[is_usable])
    columns = dict(zip(QUATERNION_FIELDS, quaternions.T, strict=True))
    columns |= dict(zip(BODY_RATE_FIELDS, rates.T, strict=True))
    return {"time": time, **columns}


def interpolated_rotations(
    query_time: Array, time: Array, quaternions: Array, next_rows: NDArray[np.intp]
) -> Array:
    """Interpolates rotations at a constant rate about a fixed axis between two neighbours, the shorter way.

    This is spherical linear interpolation (K. Shoemake, Animating rotation with quaternion curves, 1985), of unit
    quaternions q and p at the angle θ: (sin((1 − s) θ) q + sin(s θ) p) / sin θ. SciPy's Slerp gives the same, through
    rotation vectors, in some ten times the time.

    ``tests/ingest/test_ulog.py`` compares it with SciPy's.

    Args:
        query_time: Times (M,), s, at which rotations are wanted.
        time: Times (N,) of the rotations, s, ascending.
        quaternions: The rotations (N, 4), of any length but 0.
        next_rows: Rows (M,) of the rotation after each time, 1 or more.

    Returns:
        Unit quaternions (M, 4).
    """
    unit_quaternions = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    rotation_before = unit_quaternions[next_rows - 1]
    rotation_after = unit_quaternions[next_rows]
    cosine = np.sum(rotation_before * rotation_after, axis=1)
    # The quaternions q and −q are the same rotation; the one nearer to ``rotation_before`` gives the shorter way.
    rotation_after = rotation_after * np.where(cosine < 0, -1.0, 1.0)[:, np.newaxis]
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    time_before = time[next_rows - 1]
    # The fraction s of the step from one neighbour to the other.
    fraction = (query_time - time_before) / (time[next_rows] - time_before)
    # The ratio sin(s θ) / sin θ is written with sinc(x) = sin(π x) / (π x), which is finite at θ = 0, for equal
    # neighbours.
    weight_before = (1 - fraction) * np.sinc((1 - fraction) * angle / np.pi)
    weight_after = fraction * np.sinc(fraction * angle / np.pi)
    weighted_sum = (
        weight_before[:, np.newaxis] * rotation_before
        + weight_after[:, np.newaxis] * rotation_after
    )
    return weighted_sum / np.sinc(angle / np.pi)[:, np.newaxis]


DEMAND_CHANNELS: int = (
    definitions_by_name()["ACTUATOR_CONTROL_TARGET"].payload_type["controls"].shape[0]
)
"""Number of elements of ACTUATOR_CONTROL_TARGET.controls."""

THRUST_CHANNEL = 3
"""Element of ACTUATOR_CONTROL_TARGET.controls with the thrust; the first three are roll, pitch and yaw."""


def actuator_control_target(topics: Topics) -> Fields:
    """Makes ACTUATOR_CONTROL_TARGET: the demands on roll, pitch and yaw, −1 to 1, and on thrust, 0 to 1.

    They come from vehicle_torque_setpoint and vehicle_thrust_setpoint, whose z points down. Before PX4 1.14 they come
    from actuator_controls_0, which has the eight controls of the message (ACTUATOR_CONTROL_TARGET.hpp).

    Args:
        topics: The logged topics, by name and number of the instance.

    Returns:
        ``time`` (N,), s, ``group_mlx``, 0 throughout, and ``controls`` (N, 8).

    Raises:
        KeyError: Neither topic was logged.
    """
    torque = first_instance(topics, "vehicle_torque_setpoint")
    if torque:
        time = torque["time"]
        controls = np.zeros((len(time), DEMAND_CHANNELS))
        controls[:, :THRUST_CHANNEL] = array_field(torque, "xyz", 3)
        thrust = first_instance(topics, "vehicle_thrust_setpoint")
        if "xyz[2]" in thrust:
            controls[:, THRUST_CHANNEL] = np.interp(time, thrust["time"], -thrust["xyz[2]"])
    else:
        old_controls = first_instance(topics, "actuator_controls_0")
        time = old_controls["time"]
        controls = array_field(old_controls, "control", DEMAND_CHANNELS)
    return {"time": time, "group_mlx": np.zeros(len(time), dtype=np.uint8), "controls": controls}


BODY_ANGLE_FIELDS = ("roll_body", "pitch_body", "yaw_body")
"""Fields of vehicle_attitude_setpoint with its Euler angles, rad, up to PX4 1.15."""


def attitude_target_messages(topics: Topics) -> Fields:
    """Makes ATTITUDE_TARGET (PX4's ATTITUDE_TARGET.hpp) from vehicle_attitude_setpoint and vehicle_rates_setpoint.

    Each message of a topic becomes one ATTITUDE_TARGET, whose ``type_mask`` marks the other setpoint as not sent.

    Args:
        topics: The logged topics, by name and number of the instance.

    Returns:
        ``time`` (N,), s, quaternions, and body rates, rad/s, in the order of time.
    """
    tables_of_topics = []
    attitude = first_instance(topics, "vehicle_attitude_setpoint")
    rates = first_instance(topics, "vehicle_rates_setpoint")
    if "q_d[3]" in attitude:
        attitude = selected_rows(attitude, flag_or_true(attitude, "q_d_valid"))
        tables_of_topics.append(
            {"time": attitude["time"], **attitude_target(array_field(attitude, "q_d", 4))}
        )
    elif all(angle in attitude for angle in BODY_ANGLE_FIELDS):
        # Logs without the quaternion have the same setpoint as Euler angles.
        roll, pitch, yaw = (np.asarray(attitude[angle], float) for angle in BODY_ANGLE_FIELDS)
        target = attitude_target(quaternion(roll, pitch, yaw))
        tables_of_topics.append({"time": attitude["time"], **target})
    axes = ("roll", "pitch", "yaw")
    if all(axis in rates for axis in axes):
        rate_setpoints = np.column_stack([rates[axis] for axis in axes]).astype(np.float64)
        tables_of_topics.append({"time": rates["time"], **attitude_target(rate_setpoints)})
    return in_time_order(tables_of_topics)


def renamed_message(topics: Topics, message: str) -> Fields:
    """Makes a message of which only names and units change, from the first topic of its rule that was logged.

    Args:
        topics: The logged topics, by name and number of the instance.
        message: Name of MAVLink's message, a key of ``TRANSLATION_RULES``.

    Returns:
        Columns (N,) with ``time``, s; empty if none of the topics was logged.

    Raises:
        KeyError: The topic lacks a field that the message must have.
    """
    rule = TRANSLATION_RULES[message]
    for topic_name in rule["topics"]:
        topic = first_instance(topics, topic_name)
        if topic:
            fields = fields_by_rule(topic, rule)
            return {"time": topic["time"], **fields}
    return {}


def highres_imu(topics: Topics) -> Fields:
    """Makes HIGHRES_IMU (PX4's HIGHRES_IMU.hpp) from vehicle_acceleration, with the temperature of the first IMU, °C.

    The temperature comes from vehicle_imu_status, which is logged less often: its last value is taken, and NaN before
    the first.

    Args:
        topics: The logged topics, by name and number of the instance.

    Returns:
        Columns (N,) of HIGHRES_IMU; empty if the topic was not logged.
    """
    fields = renamed_message(topics, "HIGHRES_IMU")
    status = first_instance(topics, "vehicle_imu_status")
    if fields and "temperature_accel" in status:
        temperature = last_field_values(status, "temperature_accel", fields["time"])
        is_known = fields["time"] >= status["time"][0]
        fields["temperature"] = np.where(is_known, temperature, np.nan)
    return fields


VIBRATION_IMUS = 3
"""Number of IMUs: VIBRATION has a counter of clips for each."""


def vibration(topics: Topics) -> Fields:
    """Makes VIBRATION (VIBRATION.hpp) from vehicle_imu_status: the level of vibration and the clipped samples by IMU.

    Each IMU is an instance of the topic, with different stamps; all are interpolated at the stamps of the first.

    Args:
        topics: The logged topics, by name and number of the instance.

    Returns:
        ``time`` (N,), s; ``vibration_z``, the level of the first IMU's acceleration, m/s²; a counter of clips for each
        IMU, the sum over its axes; and ``levels`` (N, k), the levels of all k IMUs. Empty before PX4 1.13.
    """
    status = first_instance(topics, "vehicle_imu_status")
    # Before PX4 1.13, which has no gyro_clipping yet, the level was computed from the increments of velocity.
    if "gyro_clipping[2]" not in status:
        return {}
    time = status["time"]
    levels = []
    clips = {f"clipping_{number}": np.zeros(len(time)) for number in range(VIBRATION_IMUS)}
    instances = sorted(topics["vehicle_imu_status"])[:VIBRATION_IMUS]
    for number, instance in enumerate(instances):
        imu = topics["vehicle_imu_status"][instance]
        levels.append(np.interp(time, imu["time"], imu["accel_vibration_metric"]))
        clip_count = array_field(imu, "accel_clipping", 3).sum(axis=1)
        clips[f"clipping_{number}"] = np.interp(time, imu["time"], clip_count)
    return {"time": time, "vibration_z": levels[0], **clips, "levels": np.column_stack(levels)}


def system_time(topics: Topics) -> Fields:
    """SYSTEM_TIME.hpp: vehicle_gps_position, where the receiver knows the time."""
    gps = first_instance(topics, "vehicle_gps_position")
    with_time = selected_rows(gps, gps["time_utc_usec"] > 0)
    return {"time": with_time["time"], "time_unix_usec": with_time["time_utc_usec"]}


def injected_rates(topics: Topics) -> Fields:
    """Makes SIDD, ArduPilot's message with test signals, from the rates that PX4's autotune adds to the setpoint.

    Args:
        topics: The logged topics, by name and number of the instance.

    Returns:
        Three rows per message of the topic, for roll, pitch and yaw: ``time``, s, the number of the ``axis`` as of
        ``Injection``, and the rate, degrees/s, as ``target``.
    """
    topic = first_instance(topics, "autotune_attitude_control_status")
    rates = np.degrees(array_field(topic, "rate_sp", 3))
    axis_numbers = Injection.RATE_SETPOINT + np.arange(3)
    return {
        "time": np.repeat(topic["time"], 3),
        "axis": np.tile(axis_numbers, len(rates)),
        "target": rates.ravel(),
    }


def untranslated_topic(topics: Topics, name: str) -> Fields:
    """Returns a topic under its own names, with the fields of ``TOPIC_FIELDS`` that were logged."""
    topic = first_instance(topics, name)
    fields = {field: topic[field] for field in TOPIC_FIELDS[name] if field in topic}
    return {"time": topic["time"], **fields}


MAX_FIFO_SAMPLES = 32
"""Number of samples for which a message of sensor_gyro_fifo and sensor_accel_fifo has room."""


class SampleTopic(NamedTuple):
    """Where the samples of a sensor before the filters are logged."""

    fifo: str
    """Topic with all samples."""
    combined_field: str
    """Field of sensor_combined with their means, which is used where the other topic was not logged."""


def sensor_samples(topics: Topics, sample_topic: SampleTopic) -> Fields:
    """Returns samples of a sensor before the autopilot's filters.

    A message of the FIFO topic is the content of the sensor's buffer: up to 32 samples, ``dt`` µs apart, the last at
    ``timestamp_sample``, as integers to be multiplied by ``scale``. If the topic was not logged, the means in
    sensor_combined are used.

    Args:
        topics: Columns of the logged topics, by name and number of the instance.
        sample_topic: Topic in which the samples of this sensor are logged.

    Returns:
        ``time`` (N,), s, and ``x``, ``y`` and ``z`` (N,), rad/s or m/s².
    """
    fifo = first_instance(topics, sample_topic.fifo)
    if not fifo:
        combined_topic = first_instance(topics, "sensor_combined")
        time = combined_topic["time"]
        means = array_field(combined_topic, sample_topic.combined_field, 3)
        return {"time": time, **dict(zip("xyz", means.T, strict=True))}
    # The tables have a row per message and a column per sample, of which the first ``samples`` columns are filled.
    sample_number = np.arange(MAX_FIFO_SAMPLES)
    sample_count = fifo["samples"][:, None]
    is_sample = sample_number < sample_count
    delay = fifo["timestamp"] - fifo["timestamp_sample"].astype(np.float64)
    last_sample_time = fifo["time"] - delay / MICROSECONDS
    samples_before_last = sample_count - 1 - sample_number
    time_before_last = samples_before_last * fifo["dt"][:, None] / MICROSECONDS
    axes = {}
    for axis in "xyz":
        values = array_field(fifo, axis, MAX_FIFO_SAMPLES) * fifo["scale"][:, None]
        axes[axis] = values[is_sample]
    return {"time": (last_sample_time[:, None] - time_before_last)[is_sample], **axes}


def current_mode(topics: Topics) -> Fields:
    """CURRENT_MODE.hpp: the custom mode of vehicle_status.nav_state."""
    status = first_instance(topics, "vehicle_status")
    return {"time": status["time"], "custom_mode": px4_custom_mode(status["nav_state"])}


def manual_control(topics: Topics) -> Fields:
    """Makes MANUAL_CONTROL (PX4's MANUAL_CONTROL.hpp) from manual_control_setpoint: the sticks of the pilot.

    PX4 counts the throttle from -1 to 1 since 1.14, and from 0 to 1 before.

    Args:
        topics: The logged topics, by name and number of the instance.

    Returns:
        ``time`` (N,), s, the throttle ``z``, 0 (closed) to 1000, and if logged pitch ``x``, roll ``y`` and yaw
        ``r``, -1000 to 1000.
    """
    sticks = first_instance(topics, "manual_control_setpoint")
    sticks = selected_rows(sticks, flag_or_true(sticks, "valid"))
    fields: Fields = {"time": sticks["time"]}
    # Each field of the message has the name that PX4 uses since 1.14, and the one before.
    px4_names = {"x": ("pitch", "x"), "y": ("roll", "y"), "r": ("yaw", "r")}
    for field, names in px4_names.items():
        for name in names:
            if name in sticks:
                fields[field] = 1000 * sticks[name].astype(np.float64)
                break
    if "throttle" in sticks:
        # The range −1 to 1 becomes 0 to 1000.
        throttle = 500 * (1 + sticks["throttle"].astype(np.float64))
    else:
        throttle = 1000 * sticks["z"].astype(np.float64)
    fields["z"] = throttle
    return fields


ARMED_STATE = 2
"""Value of vehicle_status.arming_state of armed motors, in every version of PX4."""


def heartbeat(topics: Topics, vehicle_type: int) -> Fields:
    """Makes HEARTBEAT from the topic vehicle_status, as PX4's stream HEARTBEAT.hpp does.

    Only the state is distinguished: CRITICAL in failsafe, otherwise ACTIVE while the motors are armed, otherwise
    STANDBY. Where the field ``failsafe`` was not logged, the state is not known, and there is no column of it.

    Args:
        topics: PX4's topics; vehicle_status has N messages.
        vehicle_type: MAV_TYPE.

    Returns:
        Columns (N,) of HEARTBEAT.
    """
    status = first_instance(topics, "vehicle_status")
    is_armed = status["arming_state"] == ARMED_STATE
    fields: Fields = {"time": status["time"], **heartbeat_fields(vehicle_type, PX4, is_armed)}
    if "failsafe" in status:
        armed_or_not = np.where(is_armed, ACTIVE, STANDBY)
        fields["system_status"] = np.where(status["failsafe"] > 0, CRITICAL, armed_or_not)
    return fields


SETPOINT_TYPE_TAKEOFF = 3

SETPOINT_TYPE_LAND = 4
"""Values of position_setpoint_triplet.current.type of take-off and landing (PX4 ``PositionSetpoint.msg``)."""


def extended_sys_state(topics: Topics) -> Fields:
    """Makes EXTENDED_SYS_STATE (PX4's EXTENDED_SYS_STATE.hpp): on the ground or in the air, by the land detector.

    The land detector reports whether the vehicle is on the ground or in the air. In the air, the state is take-off or
    landing while an automatic mode flies to a target of that type.

    There is a row for each message of the three topics, and one at the first message of each second: old versions of
    PX4 logged the state only at its changes.

    Args:
        topics: The logged topics, by name and number of the instance.

    Returns:
        ``time`` (N,), s, and ``landed_state``, MAV_LANDED_STATE; empty if there was no land detector.
    """
    land_detector = first_instance(topics, "vehicle_land_detected")
    control_mode = first_instance(topics, "vehicle_control_mode")
    target = first_instance(topics, "position_setpoint_triplet")
    if "landed" not in land_detector:
        return {}
    stamps = [topic["time"] for topic in (land_detector, control_mode, target) if topic]
    time = np.unique(np.concatenate([*stamps, _first_stamps_of_seconds(topics)]))
    time = time[time >= land_detector["time"].min()]
    is_landed = last_field_values(land_detector, "landed", time)
    state = np.where(is_landed, ON_GROUND, IN_AIR)
    is_automatic = last_field_values(control_mode, "flag_control_auto_enabled", time) > 0
    is_target_valid = last_field_values(target, "current.valid", time) > 0
    target_type = last_field_values(target, "current.type", time)
    is_flying_to_target = (state == IN_AIR) & is_automatic & is_target_valid
    state[is_flying_to_target & (target_type == SETPOINT_TYPE_TAKEOFF)] = TAKING_OFF
    state[is_flying_to_target & (target_type == SETPOINT_TYPE_LAND)] = LANDING
    return {"time": time, "landed_state": state.astype(np.uint8)}


def _first_stamps_of_seconds(topics: Topics) -> Array:
    """Returns the stamps (N,), s, of the first message of the log in each second, ascending.

    Each is the first stamp of some topic in that second. Only these few are sorted, not the stamps of all messages.
    """
    first_stamps_of_topics = []
    for instances in topics.values():
        for topic in instances.values():
            first_stamps_of_topics.append(firsts_of_seconds(topic["time"]))
    return firsts_of_seconds(np.sort(np.concatenate(first_stamps_of_topics)))


def local_position_ned(topics: Topics) -> Fields:
    """Makes LOCAL_POSITION_NED (PX4's LOCAL_POSITION_NED.hpp) from vehicle_local_position.

    Rows whose vertical speed is not valid are left out. Two columns are added to the message's fields: ``valid``,
    whether horizontal velocity and heading are valid, and ``resets``, ODOMETRY's counter of jumps.

    Args:
        topics: The logged topics, by name and number of the instance.

    Returns:
        Columns (N,) in m and m/s, north-east-down.
    """
    topic = first_instance(topics, "vehicle_local_position")
    columns = {field: topic[field] for field in ("time", "x", "y", "z", "vx", "vy", "vz")}
    is_velocity_valid = flag_or_true(topic, "v_xy_valid")
    is_heading_valid = flag_or_true(topic, "heading_good_for_control")
    columns["valid"] = is_velocity_valid & is_heading_valid
    if "xy_reset_counter" in topic:
        columns["resets"] = topic["xy_reset_counter"]
    return selected_rows(columns, flag_or_true(topic, "v_z_valid"))
