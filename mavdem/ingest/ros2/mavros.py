"""MAVROS topics as MAVLink messages, by the inverse of the translation that MAVROS makes.

MAVROS turns MAVLink's quantities into the frames of ROS (REP 103: east-north-up, and forward-left-up in the body). Each
function names the file of https://github.com/mavlink/mavros/tree/ros2/mavros/src that it inverts. Stamps are the
autopilot's, moved to the companion's clock (``lib/uas_timesync.cpp``), or the time of receipt where the clocks were
never compared.
"""

from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array
from mavdem.files import load_adjacent_toml
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.motors import PORT_OUTPUTS
from mavdem.ingest.telemetry import SourceFields, translated_fields
from mavdem.ingest.vocabulary import ARDUPILOT, GENERIC, NAMES, PX4, heartbeat_fields

MAVROS = "MAVROS"
"""Name of the bridge between MAVLink and ROS."""


class MavrosTopic(NamedTuple):
    """How one topic becomes a MAVLink message, an entry of ``mavros_topics.toml``."""

    message: str
    """Name of MAVLink's message."""
    schema: str
    """Type of the topic's messages."""
    numbers: list[str]
    """Fields that are read, arrays with their length."""
    fields: SourceFields = {}
    """Fields of which only names and units change, as of ``translated_fields``."""


MAVROS_TOPICS = {
    name: MavrosTopic(**topic)
    for name, topic in load_adjacent_toml(__file__, "mavros_topics.toml").items()
}
"""Topics that are read, by the name after the node's."""

WRAP_PERIODS = {"rc/out": 2**32 / 1e6}
"""Time after which the stamps of a topic wrap, s.

MAVROS moves the stamps of SERVO_OUTPUT_RAW, 32 bits of microseconds, as they are (plugins/rc_io.cpp).
"""

GENERIC_VEHICLE = mavlink_constant("MAV_TYPE_GENERIC")
"""MAV_TYPE of a vehicle whose type is not known: MAVROS does not publish it."""

DEMAND_CHANNELS = 8
"""Number of elements of ACTUATOR_CONTROL_TARGET.controls."""

TopicNumbers = Mapping[str, Array]
"""The numbers of a topic's messages by name, (N,) each."""


def mavros_autopilot(mode_counts: Counter[str]) -> int:
    """Recognises the autopilot by the names of its flight modes, since MAVROS's topics do not name it.

    Modes of PX4 and ArduPilot have different names ("POSCTL", "LOITER"). The autopilot is the one whose mode names
    occur more often in the flight.

    Args:
        mode_counts: Number of occurrences of each flight mode, by its name (``lib/uas_stringify.cpp``).

    Returns:
        MAV_AUTOPILOT; GENERIC if as many occurrences are of PX4's modes as of ArduPilot's.
    """
    mode_names = NAMES["mavros_modes"]
    px4_count = 0
    ardupilot_count = 0
    for mode, count in mode_counts.items():
        # PX4's automatic modes have two parts, such as "AUTO.MISSION".
        if mode in mode_names["PX4"] or mode.startswith("AUTO."):
            px4_count += count
        if mode in mode_names["ARDUPILOTMEGA"]:
            ardupilot_count += count
    if px4_count == ardupilot_count:
        return GENERIC
    return PX4 if px4_count > ardupilot_count else ARDUPILOT


def mavros_message(topic: str, numbers: TopicNumbers, autopilot: int) -> dict[str, NDArray[Any]]:
    """Translates the messages of a topic into messages of MAVLink.

    Fields of which only name and unit change are translated by the table of the topic. Attitudes are converted to
    MAVLink's frames, and elements of arrays are put into the fields of the message.

    Args:
        topic: Name of the topic, one of ``MAVROS_TOPICS``.
        numbers: Columns (N,) of the topic's numbers, by name of the field.
        autopilot: MAV_AUTOPILOT, for HEARTBEAT.

    Returns:
        The fields of MAVLink's message, without its stamps.
    """
    mavros_topic = MAVROS_TOPICS[topic]
    fields = translated_fields(numbers, mavros_topic.fields)
    if mavros_topic.message == "ATTITUDE_QUATERNION":
        w, x, y, z = _mavlink_quaternion(numbers)
        fields |= {"q1": w, "q2": x, "q3": y, "q4": z}
    elif mavros_topic.message == "ATTITUDE_TARGET":
        fields["q"] = _mavlink_quaternion(numbers).T
    elif mavros_topic.message == "SERVO_OUTPUT_RAW":
        for n in range(PORT_OUTPUTS):
            fields[f"servo{n + 1}_raw"] = numbers[f"channels[{n}]"]
    elif mavros_topic.message == "ACTUATOR_CONTROL_TARGET":
        controls = [numbers[f"controls[{n}]"] for n in range(DEMAND_CHANNELS)]
        fields["controls"] = np.column_stack(controls)
    elif mavros_topic.message == "HEARTBEAT":
        # MAVROS fills this message in its plugin sys_status.
        fields = heartbeat_fields(GENERIC_VEHICLE, autopilot, numbers["armed"])
    return fields


def _mavlink_quaternion(numbers: TopicNumbers) -> Array:
    """Converts ROS's attitudes to MAVLink's, from forward-right-down in the body to north-east-down.

    MAVROS's attitude is q_ENU,FLU = q_n q_NED,FRD q_b with two rotations by 180°: q_n = (i + j)/√2 swaps north and east
    and reverses down, q_b = i reverses right and down. Each is its own inverse except for the sign, and q and −q are
    the same attitude. So q_NED,FRD = q_n q_ENU,FLU q_b, which is multiplied out here.

    Args:
        numbers: Columns (N,) of the field ``orientation``: "orientation.w", "orientation.x" and so on.

    Returns:
        Unit quaternions (4, N): w, x, y, z.
    """
    w, x, y, z = (numbers[f"orientation.{component}"] for component in "wxyz")
    return np.sqrt(0.5) * np.array([w + z, x + y, x - y, w - z])
