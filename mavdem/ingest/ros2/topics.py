"""Which topics of a ROS 2 recording are of a flight, and of which vehicle: PX4's own and MAVROS's, by name and type.

PX4's uXRCE-DDS client publishes ``fmu/out/vehicle_attitude`` and subscribes to ``fmu/in/…``, a version behind the name
where the message has one (``vehicle_status_v1``), and a namespace before it where there are several vehicles
(https://docs.px4.io/main/en/middleware/uxrce_dds). The bridge before it wrote ``fmu/vehicle_attitude/out``. MAVROS's
topics lie under its node's name, ``mavros`` unless it was started with another.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from mavdem.ingest.mcap.records import Channel, Schema
from mavdem.ingest.px4_topics import NEEDED, SETPOINTS
from mavdem.ingest.ros2 import mavros_topics

CDR = "cdr"  # Message encoding of rosbag2 (https://mcap.dev/spec/registry)
PX4_BRIDGE, MAVROS = "uXRCE-DDS", "MAVROS"  # Bridges from an autopilot to ROS 2
_TO_PX4, _FROM_PX4 = "in", "out"


class RosTopic(NamedTuple):
    """A topic by its ``bridge``, the namespace of its ``vehicle`` ("/uav1", or empty) and the name there ("imu/data").

    ``incoming``: whether it goes to the autopilot, not from it.
    """

    bridge: str
    vehicle: str
    name: str
    incoming: bool = False


def flight_topics(channels: Iterable[Channel], schemas: Mapping[int, Schema]) -> dict[Channel, RosTopic]:
    """The topic of each channel that is of a flight.

    A node is MAVROS's if one of its topics has a type that only MAVROS sends.
    """
    typed = {channel: schemas[channel.schema].name for channel in channels if channel.schema in schemas}
    topics = {channel: topic for channel, name in typed.items() if (topic := _topic(channel, name)) is not None}
    own = {topics[channel].vehicle for channel in topics if typed[channel].startswith(mavros_topics.MAVROS_TYPES)}
    return {channel: topic for channel, topic in topics.items() if topic.bridge == PX4_BRIDGE or topic.vehicle in own}


def _topic(channel: Channel, schema: str) -> RosTopic | None:
    if channel.encoding != CDR:
        return None
    return _of_px4(channel.topic) if re.fullmatch(r"px4_msgs/msg/\w+", schema) else _of_mavros(channel.topic, schema)


def _of_px4(topic: str) -> RosTopic | None:
    *namespace, name = [part for part in topic.split("/") if part] or [""]
    if name in (_TO_PX4, _FROM_PX4) and namespace:
        namespace, name, direction = namespace[:-1], namespace[-1], name
    else:
        direction = namespace[-1] if namespace else ""
        namespace = namespace[:-1] if direction in (_TO_PX4, _FROM_PX4) else namespace
    name = re.sub(r"_v\d+$", "", name)
    # A companion stamps the setpoints it sends by a clock of its own.
    if name not in NEEDED or (name in SETPOINTS and direction == _TO_PX4):
        return None
    namespace = namespace[:-1] if namespace[-1:] == ["fmu"] else namespace
    return RosTopic(PX4_BRIDGE, "".join(f"/{part}" for part in namespace), name, direction == _TO_PX4)


def _of_mavros(topic: str, schema: str) -> RosTopic | None:
    for name, kind in mavros_topics.TOPICS.items():
        if schema == kind.schema and f"/{topic.lstrip('/')}".endswith(f"/{name}"):
            node = f"/{topic.lstrip('/')}".removesuffix(f"/{name}")
            return RosTopic(MAVROS, node.removesuffix("/mavros"), name)
    return None
