"""Which topics of a ROS 2 recording tell of a flight, and of which vehicle: PX4's own and MAVROS's, by name and type.

PX4's uXRCE-DDS client publishes ``fmu/out/vehicle_attitude`` and subscribes to ``fmu/in/…``, a version behind the name
where the message has one (``vehicle_status_v1``), and a namespace before it where there are several vehicles
(https://docs.px4.io/main/en/middleware/uxrce_dds). The bridge before it wrote ``fmu/vehicle_attitude/out``. MAVROS's
topics lie under its node's name, ``mavros`` unless it was started with another.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from mavdem.ingest import mavros_topics
from mavdem.ingest.mcap_records import Channel, Schema
from mavdem.ingest.px4_topics import NEEDED

CDR = "cdr"
"""Message encoding of rosbag2 (https://mcap.dev/spec/registry)."""
PX4, MAVROS = "uXRCE-DDS", "MAVROS"
"""What brings an autopilot's messages to ROS 2."""
_PX4_TYPE = re.compile(r"px4_msgs/msg/\w+")
_VERSION = re.compile(r"_v\d+$")
_TO_PX4, _FROM_PX4 = "in", "out"


class Topic(NamedTuple):
    """What a topic tells.

    Attributes:
        bridge: ``PX4`` or ``MAVROS``.
        vehicle: the namespace of the vehicle, "/uav1", empty where there is none.
        name: PX4's name of it ("vehicle_attitude"), or MAVROS's ("imu/data").
        incoming: whether it is what the autopilot is told, not what it tells.
    """

    bridge: str
    vehicle: str
    name: str
    incoming: bool = False


def flight_topics(channels: Iterable[Channel], schemas: Mapping[int, Schema]) -> dict[Channel, Topic]:
    """What each channel of a flight tells.

    MAVROS's are those beside which there is a type that only MAVROS sends.
    """
    typed = {channel: schemas[channel.schema].name for channel in channels if channel.schema in schemas}
    told = {channel: topic for channel, name in typed.items() if (topic := _topic(channel, name)) is not None}
    own = {told[channel].vehicle for channel in told if typed[channel].startswith(mavros_topics.OWN)}
    return {channel: topic for channel, topic in told.items() if topic.bridge == PX4 or topic.vehicle in own}


def _topic(channel: Channel, schema: str) -> Topic | None:
    if channel.encoding != CDR:
        return None
    return _of_px4(channel.topic) if _PX4_TYPE.fullmatch(schema) else _of_mavros(channel.topic, schema)


def _of_px4(topic: str) -> Topic | None:
    *namespace, name = [part for part in topic.split("/") if part] or [""]
    if name in (_TO_PX4, _FROM_PX4) and namespace:
        namespace, name, direction = namespace[:-1], namespace[-1], name
    else:
        direction = namespace[-1] if namespace else ""
        namespace = namespace[:-1] if direction in (_TO_PX4, _FROM_PX4) else namespace
    name = _VERSION.sub("", name)
    if name not in NEEDED:
        return None
    namespace = namespace[:-1] if namespace[-1:] == ["fmu"] else namespace
    return Topic(PX4, "".join(f"/{part}" for part in namespace), name, direction == _TO_PX4)


def _of_mavros(topic: str, schema: str) -> Topic | None:
    for name, kind in mavros_topics.TOPICS.items():
        if schema == kind.schema and f"/{topic.lstrip('/')}".endswith(f"/{name}"):
            node = f"/{topic.lstrip('/')}".removesuffix(f"/{name}")
            return Topic(MAVROS, node.removesuffix("/mavros"), name)
    return None
