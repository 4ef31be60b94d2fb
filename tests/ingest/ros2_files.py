"""ROS 2 recordings to read, as rosbag2 writes them: MCAP, with messages in CDR and their definitions beside them."""

from pathlib import Path

import numpy as np
from mavlink_streams import NOW
from mcap.writer import CompressionType
from mcap_files import Recorder
from mcap_ros2.writer import Writer
from scipy.spatial.transform import Rotation
from ulog_files import roll

TIMES = 20 + 0.03 * np.arange(100)
"""A short flight."""
UNIX = NOW // 1_000_000
"""s, when the companion's clock read 0 on the autopilot's."""
QUADROTOR = 2


def definitions():
    """Returns the ROS 2 message definitions by name.

    They are read from lines ``name = field; field``, where ``@name`` stands for the fields of another line.
    """
    lines = (Path(__file__).parent / "ros2_messages.txt").read_text().splitlines()
    definition_by_name = dict(line.split(" = ", 1) for line in lines)

    def expanded(row):
        return "".join(
            expanded(definition_by_name[part]) if part[:1] == "@" else f"{part}\n"
            for part in row.split("; ")
        )

    return {name: expanded(row) for name, row in definition_by_name.items() if name[0] != "@"}


DEFINITIONS = definitions()


class Ros2Recorder(Recorder):
    """Writes messages by topic, each with its type's definition, 10 ms after the other."""

    def __init__(
        self,
        path,
        compression=CompressionType.ZSTD,
        chunk_size=1 << 20,
    ):
        self.path, self._file = path, path.open("wb")
        self._writer = Writer(self._file, chunk_size=chunk_size, compression=compression)
        self._schemas = {}
        self._time = NOW * 1000

    def write(self, topic, kind, fields):
        """A message of type ``kind``; fields that are not given are 0."""
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_msgdef(kind, DEFINITIONS[kind])
        self._time += 10_000_000
        self._writer.write_message(topic, self._schemas[kind], fields, self._time)

    def px4(self, name, seconds, prefix="/fmu/out/", **fields):
        """One of PX4's topics, stamped with ``seconds``; with a ``timestamp_sample`` 1 ms before."""
        stamp = round(seconds * 1e6)
        own = {"timestamp": stamp, "timestamp_sample": max(stamp - 1000, 0), **fields}
        kind = "SensorGps" if name == "vehicle_gps_position" else name.title().replace("_", "")
        self.write(prefix + name, f"px4_msgs/msg/{kind}", own)

    def mavros(self, name, kind, seconds, node="/mavros", **fields):
        """One of MAVROS's topics, stamped with ``seconds`` since 1970."""
        self.write(f"{node}/{name}", kind, {"header": header(seconds), **fields})

    def imu(
        self,
        seconds,
        rpy,
        pqr,
        **how,
    ):
        """``imu/data`` of an attitude and body rates as MAVLink has them, rad and rad/s, turned by matrices."""
        orientation = xyzw(to_ros(rpy))
        self.mavros(
            "imu/data",
            "sensor_msgs/msg/Imu",
            seconds,
            orientation=orientation,
            angular_velocity=vector(BODY @ np.array(pqr)),
            **how,
        )


WORLD = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
"""East, north and up of what is given as north, east and down (REP 103)."""
BODY = np.diag([1, -1, -1])
"""Forward, left and up of what is given as forward, right and down; and back."""


def to_ros(rpy):
    """The turn from the body, forward-left-up, to east-north-up, of MAVLink's roll, pitch and yaw."""
    yaw_pitch_roll = Rotation.from_euler("ZYX", rpy[::-1])
    return Rotation.from_matrix(WORLD @ yaw_pitch_roll.as_matrix() @ BODY)


def xyzw(turn):
    return dict(zip("xyzw", turn.as_quat().tolist(), strict=True))


def vector(values):
    return dict(zip("xyz", values.tolist(), strict=True))


def header(seconds):
    nanoseconds = round(seconds * 1e6) * 1000
    stamp = {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
    return {"stamp": stamp, "frame_id": "base_link"}


def px4_flight(
    recorder,
    times=TIMES,
    prefix="/fmu/out/",
    **ids,
):
    """A quadrotor's hover: attitude, rates and motors at each of the times, s, and its status."""
    for row, (time, angle, rate) in enumerate(np.column_stack([times, *roll(times)]).tolist()):
        if row % 50 == 0:
            recorder.px4(
                "vehicle_status",
                time,
                prefix,
                arming_state=2,
                system_type=QUADROTOR,
                vehicle_type=1,
                **ids,
            )
        recorder.px4("vehicle_angular_velocity", time, prefix, xyz=[rate, 0.0, 0.0])
        recorder.px4(
            "vehicle_attitude", time, prefix, q=[np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0]
        )
        motors = [0.5 - angle, 0.5 + angle, 0.5 + angle, 0.5 - angle]
        recorder.px4("actuator_motors", time, prefix, control=motors + [float("nan")] * 8)


def mavros_flight(
    recorder,
    times=UNIX + TIMES,
    node="/mavros",
    mode="OFFBOARD",
):
    """The same as MAVROS tells it, on the companion's clock."""
    for row, (time, angle, rate) in enumerate(np.column_stack([times, *roll(times)]).tolist()):
        if row % 50 == 0:
            recorder.mavros(
                "state", "mavros_msgs/msg/State", time, node, connected=True, armed=True, mode=mode
            )
            recorder.mavros(
                "extended_state", "mavros_msgs/msg/ExtendedState", time, node, landed_state=2
            )
        recorder.imu(time, (angle, 0.0, 0.0), (rate, 0.0, 0.0), node=node)
        pulses = [round(1500 + 100 * side * angle) for side in (-1, 1, 1, -1)]
        recorder.mavros("rc/out", "mavros_msgs/msg/RCOut", time, node, channels=pulses + [0] * 4)
