"""Translation of a vehicle's PX4 topics to MAVLink: which topic becomes which message, and the vehicle's type."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from mavdem.facts import Facts
from mavdem.facts.sources import Repair
from mavdem.ingest.mavlink.dialect import enum_name, mavlink_constant
from mavdem.ingest.px4_instances import (
    accelerometers,
    battery_status,
    estimator_instances,
    estimator_status,
    further_sensors,
    sys_status,
)
from mavdem.ingest.px4_messages import (
    TRANSLATION_RULES,
    SampleTopic,
    actuator_control_target,
    attitude_quaternion,
    attitude_target_messages,
    current_mode,
    extended_sys_state,
    heartbeat,
    highres_imu,
    injected_rates,
    local_position_ned,
    manual_control,
    renamed_message,
    sensor_samples,
    system_time,
    untranslated_topic,
    vibration,
)
from mavdem.ingest.px4_motor_messages import hil_actuator_controls, motor_speeds, servo_output_raw
from mavdem.ingest.px4_topics import MessageMaker, Topics, first_instance
from mavdem.ingest.telemetry import (
    Columns,
    Fields,
    Parameters,
    Tables,
    rate_without_gaps,
    repair_facts,
)
from mavdem.ingest.vocabulary import ACCELEROMETERS_MESSAGE, INSTANCES_MESSAGE, UNNAMED

UNTRANSLATED_TOPICS = (
    "failure_detector_status",
    "estimator_selector_status",
    "action_request",
    "vehicle_command",
    "input_rc",
    "cpuload",
)
"""Topics that no message of MAVLink has the meaning of: they are kept under their own names."""

FLIGHT_MESSAGES = {
    "ATTITUDE_QUATERNION",
    "SERVO_OUTPUT_RAW",
    "HIL_ACTUATOR_CONTROLS",
    "ACTUATOR_CONTROL_TARGET",
    "HEARTBEAT",
    "EXTENDED_SYS_STATE",
    "LOCAL_POSITION_NED",
}
"""Messages of which a flight has at least one."""

SAMPLE_TOPICS = {
    "GYRO": SampleTopic("sensor_gyro_fifo", "gyro_rad"),
    "ACCEL": SampleTopic("sensor_accel_fifo", "accelerometer_m_s2"),
}
"""The samples of both sensors."""


class TranslatedTopics(NamedTuple):
    """The messages of one vehicle that its topics make."""

    vehicle: str
    """MAV_TYPE without its prefix; "UNKNOWN" where no topic and no parameter has it."""
    messages: dict[str, Columns]
    """MAVLink's messages by name, with ``time``, PX4's own stamp, s, and ``boot``, 0 throughout.

    There are none where the topics hold no flight.
    """
    topic_names: dict[str, str]
    """The topic of each message by its name, also of messages that could be made from other topics."""


def messages_of_topics(topics: Topics, parameters: Parameters) -> TranslatedTopics:
    """Translates a vehicle's topics into MAVLink's messages.

    Each message is made by a function of ``px4_messages``; one whose topics were not logged stays empty and is left
    out. The topic of each message is noted in any case, so that a report can say what should have been logged.

    Args:
        topics: Columns of the logged topics, by name and number of the instance.
        parameters: The autopilot's parameters by name.

    Returns:
        The vehicle's type, the messages with data, and the topic of each message; no messages without any of
        ``FLIGHT_MESSAGES``.
    """
    vehicle_type = mav_type(topics, parameters)
    vehicle = UNNAMED if vehicle_type is None else enum_name("MAV_TYPE", vehicle_type)
    attitude = _message_with_boot(attitude_quaternion, topics)
    candidates = {
        "ATTITUDE_QUATERNION": (_attitude_topic(topics, attitude), attitude),
        "HIL_ACTUATOR_CONTROLS": (
            "actuator_motors",
            _message_with_boot(hil_actuator_controls, topics, vehicle, parameters),
        ),
        "HEARTBEAT": ("vehicle_status", _message_with_boot(heartbeat, topics, vehicle_type or 0)),
    }
    for name, rule in TRANSLATION_RULES.items():
        candidates[name] = rule["topics"][0], _message_with_boot(renamed_message, topics, name)
    for name, maker in _message_makers(topics).items():
        candidates[name] = maker.topic_name, _message_with_boot(maker.make, topics)
    for name in UNTRANSLATED_TOPICS:
        candidates[name] = name, _message_with_boot(untranslated_topic, topics, name)
    for sensor, sample_topic in SAMPLE_TOPICS.items():
        topic = sample_topic.fifo if sample_topic.fifo in topics else "sensor_combined"
        candidates[f"{sensor}_BEFORE"] = (
            topic,
            _message_with_boot(sensor_samples, topics, sample_topic),
        )
    messages: dict[str, Columns] = {}
    topic_names = {}
    for name, (topic, columns) in candidates.items():
        topic_names[name] = topic
        if columns:
            messages[name] = columns
    if FLIGHT_MESSAGES.isdisjoint(messages):
        messages = {}
    return TranslatedTopics(vehicle, messages, topic_names)


def _message_makers(topics: Topics) -> dict[str, MessageMaker]:
    """Returns how each message is made that needs a function of its own, but nothing except the topics.

    Args:
        topics: Columns of the logged topics, by name and number of the instance.

    Returns:
        The topic that a report names, and the function that makes the message, by the name of the message.
    """
    return {
        "SERVO_OUTPUT_RAW": MessageMaker("actuator_outputs", servo_output_raw),
        "ACTUATOR_CONTROL_TARGET": MessageMaker(_demand_topic(topics), actuator_control_target),
        "EXTENDED_SYS_STATE": MessageMaker("vehicle_land_detected", extended_sys_state),
        "LOCAL_POSITION_NED": MessageMaker("vehicle_local_position", local_position_ned),
        "ATTITUDE_TARGET": MessageMaker(
            "vehicle_rates_setpoint and vehicle_attitude_setpoint", attitude_target_messages
        ),
        "SIDD": MessageMaker("autotune_attitude_control_status", injected_rates),
        "SYS_STATUS": MessageMaker("battery_status", sys_status),
        "BATTERY_STATUS": MessageMaker("battery_status", battery_status),
        "VIBRATION": MessageMaker("vehicle_imu_status", vibration),
        "ESTIMATOR_STATUS": MessageMaker("estimator_status", estimator_status),
        INSTANCES_MESSAGE: MessageMaker("estimator_status", estimator_instances),
        "SYSTEM_TIME": MessageMaker("vehicle_gps_position", system_time),
        "CURRENT_MODE": MessageMaker("vehicle_status", current_mode),
        "MANUAL_CONTROL": MessageMaker("manual_control_setpoint", manual_control),
        ACCELEROMETERS_MESSAGE: MessageMaker("vehicle_imu_status", accelerometers),
        "ESC": MessageMaker("esc_status", motor_speeds),
        "HIGHRES_IMU": MessageMaker("vehicle_acceleration", highres_imu),
        **further_sensors(),
    }


def _message_with_boot(make: Callable[..., Fields], *arguments: Any) -> Fields:
    """Makes a message by one of the functions of ``px4_messages``, and adds the column ``boot``, all 0.

    Args:
        make: The function, which raises KeyError where something that it needs was not logged.
        *arguments: Its arguments.

    Returns:
        The columns (N,) of the message; empty if a topic, or a field of it, was not logged.
    """
    try:
        columns = make(*arguments)
    except KeyError:
        return {}
    message_count = len(columns.get("time", ()))
    if message_count == 0:
        return {}
    # A log of PX4 has a single boot, number 0. A broadcast column takes no memory.
    boot = np.broadcast_to(np.int64(0), message_count)
    return {**columns, "boot": boot}


MULTIROTOR_TYPE = mavlink_constant("MAV_TYPE_GENERIC_MULTIROTOR")
"""MAV_TYPE of a multirotor whose number of rotors is not known."""

MAV_TYPE_OF_VEHICLE_TYPE = {
    1: MULTIROTOR_TYPE,
    2: mavlink_constant("MAV_TYPE_FIXED_WING"),
    3: mavlink_constant("MAV_TYPE_GROUND_ROVER"),
}
"""MAV_TYPE by vehicle_status.vehicle_type, which has no number of rotors."""

MAX_MAV_TYPE = 255
"""Largest value of MAV_TYPE: it is one byte in HEARTBEAT."""


def mav_type(topics: Topics, parameters: Parameters) -> int | None:
    """Finds out the vehicle's MAV_TYPE: the most frequent value in its topics and parameters.

    The majority counts, since single values may be damaged. Sources are vehicle_status.system_type and the parameter
    MAV_TYPE; without these vehicle_status.vehicle_type, and is_rotary_wing in old versions.

    Args:
        topics: The logged topics, by name and number of the instance.
        parameters: The autopilot's parameters by name.

    Returns:
        MAV_TYPE; None if there is no source.
    """
    status = first_instance(topics, "vehicle_status")
    candidates = [*status.get("system_type", ()), parameters.get("MAV_TYPE", 0)]
    types = [int(number) for number in candidates if 0 < number <= MAX_MAV_TYPE]
    if not types:
        for vehicle_type in status.get("vehicle_type", ()):
            if vehicle_type in MAV_TYPE_OF_VEHICLE_TYPE:
                types.append(MAV_TYPE_OF_VEHICLE_TYPE[vehicle_type])
        for is_rotary_wing in status.get("is_rotary_wing", ()):
            if is_rotary_wing:
                types.append(MULTIROTOR_TYPE)
    return max(set(types), key=types.count, default=None)


def _demand_topic(topics: Topics) -> str:
    """Returns the topic with the controller's demands: of PX4 1.14 and later, or the old one if only it was logged."""
    if "vehicle_torque_setpoint" not in topics and "actuator_controls_0" in topics:
        return "actuator_controls_0"
    return "vehicle_torque_setpoint"


def _attitude_topic(topics: Topics, attitude: Columns) -> str:
    """Returns the name of the topic that has the stamps of ATTITUDE_QUATERNION, which joins attitude and body rates.

    The two are logged at different stamps. The message has those of one topic, to which the other was interpolated.

    Args:
        topics: The logged topics, by name and number of the instance.
        attitude: Columns of ATTITUDE_QUATERNION, as made from the topics; may be empty.

    Returns:
        "vehicle_angular_velocity" if all stamps of the message are stamps of that topic, otherwise "vehicle_attitude".
    """
    body_rates = first_instance(topics, "vehicle_angular_velocity")
    if not attitude or not body_rates:
        return "vehicle_attitude"
    message_stamps = attitude["time"]
    rate_stamps = body_rates["time"]
    # Each stamp of the message is paired with the first stamp of the body rates that is not earlier.
    rows = np.searchsorted(rate_stamps, message_stamps)
    last_row = len(rate_stamps) - 1
    nearest_rate_stamps = rate_stamps[np.minimum(rows, last_row)]
    has_stamps_of_rates = np.array_equal(nearest_rate_stamps, message_stamps)
    return "vehicle_angular_velocity" if has_stamps_of_rates else "vehicle_attitude"


CLEARLY_MORE = 1.1
"""Factor between the numbers of messages from which on attitude was logged less often than the body rates."""


def attitude_repairs(topics: Topics, messages: Tables) -> Facts:
    """Reports that the attitude was interpolated, if the body rates were logged clearly more often.

    ATTITUDE_QUATERNION needs attitude and body rates at the same stamps, while PX4 logs them in two topics. If it was
    made at the stamps of the body rates, it has clearly more rows than the topic vehicle_attitude; this is how
    interpolation is recognised.

    Args:
        topics: Columns of the logged topics, by name and number of the instance.
        messages: The messages made of them, by name.

    Returns:
        One fact with both rates, Hz; none if the attitude was not interpolated.
    """
    if "ATTITUDE_QUATERNION" not in messages:
        return ()
    # The topic was logged, since the message is made of it. Of several instances the one with most stamps is compared.
    stamps_of_instances = [topic["time"] for topic in topics["vehicle_attitude"].values()]
    logged_stamps = max(stamps_of_instances, key=len)
    message_stamps = messages["ATTITUDE_QUATERNION"]["time"]
    if len(message_stamps) <= CLEARLY_MORE * len(logged_stamps):
        return ()
    return repair_facts(
        Repair.ATTITUDE_INTERPOLATED,
        attitude_rate=rate_without_gaps(np.diff(logged_stamps)),
        rate=rate_without_gaps(np.diff(message_stamps)),
    )
