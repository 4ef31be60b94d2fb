"""Topics of a ROS 2 recording that are of a flight: PX4's own and MAVROS's, by name and type, and of which vehicle.

PX4's uXRCE-DDS client publishes ``fmu/out/vehicle_attitude`` and subscribes to ``fmu/in/…``, a version behind the name
where the message has one (``vehicle_status_v1``), and a namespace before it where there are several vehicles
(https://docs.px4.io/main/en/middleware/uxrce_dds). The bridge before it wrote ``fmu/vehicle_attitude/out``.

MAVROS's topics lie under its node's name, ``mavros`` unless it was started with another. They become MAVLink's messages
by the inverse of MAVROS's own translation into the frames of ROS (REP 103: east-north-up, and forward-left-up in the
body). Each function names the file of https://github.com/mavlink/mavros/tree/ros2/mavros/src that it inverts. Stamps
are the autopilot's, moved to the companion's clock (``lib/uas_timesync.cpp``), or the time of receipt where the clocks
were never compared.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.mcap.records import Channel, Schema
from mavdem.ingest.px4_topics import NEEDED, SETPOINTS
from mavdem.ingest.vocabulary import ARDUPILOT, ARMED, CUSTOM_MODE, GENERIC, PX4, heartbeat_fields

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
    """Returns the topic of each channel that is of a flight.

    A node is MAVROS's if one of its topics has a type that only MAVROS sends.
    """
    typed = {channel: schemas[channel.schema].name for channel in channels if channel.schema in schemas}
    topics = {channel: topic for channel, name in typed.items() if (topic := _topic(channel, name)) is not None}
    own = {topics[channel].vehicle for channel in topics if typed[channel].startswith(MAVROS_TYPES)}
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
    for name, kind in MAVROS_TOPICS.items():
        if schema == kind.schema and f"/{topic.lstrip('/')}".endswith(f"/{name}"):
            node = f"/{topic.lstrip('/')}".removesuffix(f"/{name}")
            return RosTopic(MAVROS, node.removesuffix("/mavros"), name)
    return None


Fields = Mapping[str, NDArray[np.float64]]  # The numbers of a topic's messages by name, (N,) each


class MavrosTopic(NamedTuple):
    """A topic: its MAVLink ``message``, its own ``schema``, and the fields with ``numbers`` and with ``texts``."""

    message: str
    schema: str
    numbers: tuple[str, ...]
    texts: tuple[str, ...] = ()


MAVROS_STAMP = ("header.stamp.sec", "header.stamp.nanosec")  # Fields of every message
_QUATERNION, _RATES = ("w", "x", "y", "z"), ("x", "y", "z")
MAVROS_TOPICS = {
    "imu/data": MavrosTopic(
        "ATTITUDE_QUATERNION",
        "sensor_msgs/msg/Imu",
        (*(f"orientation.{n}" for n in _QUATERNION), *(f"angular_velocity.{n}" for n in _RATES)),
    ),
    "rc/out": MavrosTopic("SERVO_OUTPUT_RAW", "mavros_msgs/msg/RCOut", ("channels[16]",)),
    "target_actuator_control": MavrosTopic(
        "ACTUATOR_CONTROL_TARGET", "mavros_msgs/msg/ActuatorControl", ("group_mix", "controls[8]")
    ),
    "rc/in": MavrosTopic("RC_CHANNELS", "mavros_msgs/msg/RCIn", ("channels[18]",)),
    "battery": MavrosTopic("SYS_STATUS", "sensor_msgs/msg/BatteryState", ("voltage",)),
    "setpoint_raw/target_attitude": MavrosTopic(
        "ATTITUDE_TARGET",
        "mavros_msgs/msg/AttitudeTarget",
        ("type_mask", *(f"orientation.{n}" for n in _QUATERNION), *(f"body_rate.{n}" for n in _RATES)),
    ),
    "state": MavrosTopic("HEARTBEAT", "mavros_msgs/msg/State", ("armed",), ("mode",)),
    "extended_state": MavrosTopic("EXTENDED_SYS_STATE", "mavros_msgs/msg/ExtendedState", ("landed_state",)),
    "local_position/velocity_local": MavrosTopic(
        "LOCAL_POSITION_NED", "geometry_msgs/msg/TwistStamped", tuple(f"twist.linear.{n}" for n in _RATES)
    ),
}
"""By the name after the node's, which is ``mavros`` unless it was started with another."""
MAVROS_TYPES = "mavros_msgs/msg/"
"""Beginning of the types that only MAVROS sends: a driver of another sensor sends imu/data too."""
MAVROS_PERIODS = {"SERVO_OUTPUT_RAW": 2**32 / 1e6}
"""Seconds after which stamps wrap: MAVROS moves the 32 bits of SERVO_OUTPUT_RAW's as they are (plugins/rc_io.cpp)."""
_PX4_MODES = frozenset({"ALTCTL", "POSCTL", "OFFBOARD", "STABILIZED", "RATTITUDE"})
_ARDUPILOT_MODES = frozenset(
    {"STABILIZE", "ALT_HOLD", "AUTO", "GUIDED", "LOITER", "RTL", "CIRCLE", "LAND", "POSHOLD", "BRAKE", "AUTOTUNE"}
    | {"GUIDED_NOGPS", "SMART_RTL", "DRIFT", "SPORT", "FLIP", "THROW", "FLOWHOLD", "FOLLOW", "ZIGZAG", "SYSTEMID"}
)
"""lib/uas_stringify.cpp, without MANUAL and ACRO, which both autopilots have."""


def mavros_autopilot(modes: Counter[str]) -> int:
    """Returns MAV_AUTOPILOT by the names of the flight modes and how often each occurs."""
    px4 = sum(count for mode, count in modes.items() if mode in _PX4_MODES or mode.startswith("AUTO."))
    ardupilot = sum(count for mode, count in modes.items() if mode in _ARDUPILOT_MODES)
    if px4 == ardupilot:
        return GENERIC
    return PX4 if px4 > ardupilot else ARDUPILOT


def mavros_message(message: str, fields: Fields, vehicle_autopilot: int) -> dict[str, NDArray[Any]]:
    """Returns the fields of one MAVLink message of ``MAVROS_TOPICS``, without its stamps, from those of its topic."""
    if message == "ATTITUDE_QUATERNION":
        return _attitude_quaternion(fields)
    if message == "SYS_STATUS":
        return {"voltage_battery": 1000.0 * fields["voltage"]}  # plugins/sys_status.cpp
    if message == "ATTITUDE_TARGET":
        return _attitude_target(fields)
    if message in ("SERVO_OUTPUT_RAW", "RC_CHANNELS"):
        first, count = ("servo", 16) if message == "SERVO_OUTPUT_RAW" else ("chan", 18)
        return {f"{first}{n + 1}_raw": fields[f"channels[{n}]"] for n in range(count)}
    if message == "ACTUATOR_CONTROL_TARGET":
        # plugins/actuator_control.cpp passes it on unchanged.
        controls = np.column_stack([fields[f"controls[{n}]"] for n in range(8)])
        return {"group_mlx": fields["group_mix"], "controls": controls}
    if message == "HEARTBEAT":
        # plugins/sys_status.cpp; the type of vehicle is not known: 0, GENERIC.
        base_mode = np.where(fields["armed"] > 0, CUSTOM_MODE | ARMED, CUSTOM_MODE)
        return heartbeat_fields(0, vehicle_autopilot, base_mode)
    if message == "LOCAL_POSITION_NED":
        # plugins/local_position.cpp: north is y, east x, and down the other way from up.
        east, north, up = (fields[f"twist.linear.{n}"] for n in _RATES)
        return {"vx": north, "vy": east, "vz": -up}
    return {"landed_state": fields["landed_state"]}


def _attitude_quaternion(fields: Fields) -> dict[str, NDArray[Any]]:
    """plugins/imu.cpp, lib/ftf_frame_conversions.cpp: attitude and body rates in MAVLink's frames."""
    q = _quaternion(fields)
    rates = _body_rates(fields, "angular_velocity")
    return dict(zip(("q1", "q2", "q3", "q4", "rollspeed", "pitchspeed", "yawspeed"), (*q, *rates), strict=True))


def _attitude_target(fields: Fields) -> dict[str, NDArray[Any]]:
    """plugins/setpoint_raw.cpp, which turns the setpoint that the autopilot reports as it does the attitude."""
    names = ("body_roll_rate", "body_pitch_rate", "body_yaw_rate")
    rates = dict(zip(names, _body_rates(fields, "body_rate"), strict=True))
    return {"type_mask": fields["type_mask"], "q": _quaternion(fields).T, **rates}


def _quaternion(fields: Fields) -> NDArray[np.float64]:
    """(4, N) q_ENU,FLU = q_n q_NED,FRD q_b, of half a turn each, undone.

    q_n = (i + j)/√2 swaps north and east and turns down up, q_b = i turns right left and down up. Both are their own
    inverses but for the sign, which an attitude does not have: q_NED,FRD = q_n q_ENU,FLU q_b, multiplied out here.
    """
    w, x, y, z = (fields[f"orientation.{n}"] for n in _QUATERNION)
    with np.errstate(invalid="ignore"):  # infinities of a broken estimator: their readers leave them out
        return np.asarray(np.sqrt(0.5) * np.array([w + z, x + y, x - y, w - z]))


def _body_rates(fields: Fields, name: str) -> tuple[NDArray[np.float64], ...]:
    p, q, r = (fields[f"{name}.{n}"] for n in _RATES)
    return p, -q, -r
