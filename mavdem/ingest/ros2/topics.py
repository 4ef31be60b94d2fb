"""The topics of flights in ROS 2 recordings: to which vehicle and which bridge each of them belongs.

PX4's uXRCE-DDS client publishes ``fmu/out/vehicle_attitude`` and subscribes to ``fmu/in/…``, a version after the name
where the message has one (``vehicle_status_v1``), and a namespace before it where there are several vehicles
(https://docs.px4.io/main/en/middleware/uxrce_dds). The bridge before it wrote ``fmu/vehicle_attitude/out``. MAVROS's
topics lie under its node's name, ``mavros`` unless it was started with another.
"""

import re
from typing import NamedTuple

from mavdem.ingest.mcap.records import McapRecording
from mavdem.ingest.px4_topics import SETPOINT_TOPICS, TOPIC_FIELDS
from mavdem.ingest.ros2.mavros import MAVROS, MAVROS_TOPICS
from mavdem.ingest.ros2.messages import CDR

PX4_BRIDGE = "uXRCE-DDS"
"""Name of PX4's bridge to ROS 2."""

_PX4_TOPIC = re.compile(
    r"(?P<vehicle>.*?)/(?:fmu/)?"
    r"(?:(?P<direction>in|out)/)?"
    r"(?P<name>\w+?)(?:_v\d+)?"
    r"(?:/(?P<old_direction>in|out))?"
)
_PX4_TYPE = re.compile(r"px4_msgs/msg/\w+")
_MAVROS_TYPE_PREFIX = "mavros_msgs/msg/"


class RosTopic(NamedTuple):
    """A topic of a flight."""

    bridge: str
    """``PX4_BRIDGE`` or ``MAVROS``."""
    vehicle: str
    """Namespace of the vehicle: "/uav1", or empty."""
    name: str
    """Name of the topic there: "vehicle_attitude"."""
    incoming: bool = False
    """Whether the topic is to the autopilot, not from it."""


def flight_topics(recording: McapRecording) -> dict[int, RosTopic]:
    """Finds the topics of flights in a recording, and which vehicle and which bridge each of them belongs to.

    PX4's topics are recognised by the package of their type. MAVROS also sends common types such as sensor_msgs/Imu. A
    node is MAVROS's if one of its topics has a type that only MAVROS sends: other drivers send imu/data too.

    Args:
        recording: The recording, which was read, so that its channels and schemas are known.

    Returns:
        The topics by number of the channel.
    """
    topics = {}
    vehicles = set()
    for number, channel in recording.channels.items():
        if channel.message_encoding != CDR or channel.schema_id not in recording.schemas:
            continue
        schema = recording.schemas[channel.schema_id].name
        full_name = f"/{channel.topic.lstrip('/')}"
        is_px4 = _PX4_TYPE.fullmatch(schema) is not None
        topic = _px4_topic(full_name) if is_px4 else _mavros_topic(full_name, schema)
        if topic is None:
            continue
        topics[number] = topic
        if is_px4 or schema.startswith(_MAVROS_TYPE_PREFIX):
            vehicles.add(topic.vehicle)
    return {number: topic for number, topic in topics.items() if topic.vehicle in vehicles}


def _px4_topic(full_name: str) -> RosTopic | None:
    """Returns PX4's topic of this full name.

    Setpoints to the autopilot are not read, since a companion computer stamps them by another clock.

    Args:
        full_name: Name with the namespace of the vehicle, such as "/drone1/fmu/out/vehicle_odometry".

    Returns:
        The topic; None for one that is not read.
    """
    match = _PX4_TOPIC.fullmatch(full_name)
    if match is None or match["name"] not in TOPIC_FIELDS:
        return None
    incoming = "in" in (match["direction"], match["old_direction"])
    if incoming and match["name"] in SETPOINT_TOPICS:
        return None
    return RosTopic(PX4_BRIDGE, match["vehicle"], match["name"], incoming)


def _mavros_topic(full_name: str, schema: str) -> RosTopic | None:
    """Returns MAVROS's topic of this full name and type; None for one that is not read."""
    for name, topic in MAVROS_TOPICS.items():
        if schema == topic.schema and full_name.endswith(f"/{name}"):
            node = full_name.removesuffix(f"/{name}")
            return RosTopic(MAVROS, node.removesuffix("/mavros"), name)
    return None
