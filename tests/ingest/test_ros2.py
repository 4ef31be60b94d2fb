"""ROS 2 recordings: the flight that PX4's topics or MAVROS's tell is the one of the log they were made from; damage."""

import sys
import time
from dataclasses import replace

import numpy as np
from mavlink_streams import flight, heartbeat
from mcap_files import Recorder
from pytest import approx, fail, fixture, mark, raises
from refusals import unreadable
from ros2_files import (
    DEFINITIONS,
    TIMES,
    UNIX,
    Ros2Recorder,
    header,
    mavros_flight,
    px4_flight,
    to_ros,
    xyzw,
)
from scipy.spatial.transform import Rotation
from ulog_files import roll

import mavdem
from mavdem.dataset.attitude import attitude_of_axis
from mavdem.dataset.setpoints import recorded_setpoints
from mavdem.dataset.signals import Signals
from mavdem.errors import NotLearnable
from mavdem.extras import MissingExtra
from mavdem.facts.sources import Flaw, Repair, SourceFact
from mavdem.ingest import read_log
from mavdem.ingest.mcap.log import mcap_stream
from mavdem.ingest.ros2.log import with_system_ids


def written(folder, write, **options):
    path = folder / "flight.mcap"
    with Ros2Recorder(path, **options) as recorder:
        write(recorder)
    return path


@fixture
def recorder(tmp_path):
    return Ros2Recorder(tmp_path / "flight.mcap")


def message(vehicle, name, *fields):
    return np.column_stack(
        [np.asarray(vehicle.messages[name][field], dtype=np.float64) for field in fields]
    )


@mark.slow
def test_what_mavros_turned_is_turned_back(recorder):
    """MAVROS converts attitude and rates from aerospace axes (NED, FRD) to ROS axes (ENU, FLU)."""
    angles = np.radians((170, -80, 30))
    rates = (0.3, -0.2, 0.1)
    recorder.mavros("state", "mavros_msgs/msg/State", UNIX, armed=True)
    for row in range(5):
        recorder.imu(UNIX + row, tuple(angles), rates)
    vehicle = recorder.vehicle()
    w, x, y, z = message(vehicle, "ATTITUDE_QUATERNION", "q1", "q2", "q3", "q4")[0]
    expected = Rotation.from_euler("ZYX", angles[::-1])
    assert (Rotation.from_quat([x, y, z, w]) * expected.inv()).magnitude() < 1e-9
    body_rates = message(vehicle, "ATTITUDE_QUATERNION", "rollspeed", "pitchspeed", "yawspeed")
    assert np.allclose(body_rates, [rates] * 5, rtol=0, atol=1e-12)


@mark.slow
def test_what_else_mavros_tells(recorder):
    """Velocity, arming, flight and demands are read from the topics of MAVROS."""
    mavros_flight(recorder)
    for at in (UNIX + TIMES).tolist():
        velocity = {"linear": {"x": 1.0, "y": 2.0, "z": 3.0}}
        recorder.mavros(
            "local_position/velocity_local", "geometry_msgs/msg/TwistStamped", at, twist=velocity
        )
        demand = [0.1, 0.2, 0.3, at % 1, 0.0, 0.0, 0.0, 0.0]
        recorder.mavros(
            "target_actuator_control", "mavros_msgs/msg/ActuatorControl", at, controls=demand
        )
    vehicle = recorder.vehicle()
    assert message(vehicle, "LOCAL_POSITION_NED", "vx", "vy", "vz")[0].tolist() == [2.0, 1.0, -3.0]
    climb = Signals(vehicle).climb_rate
    armed = Signals(vehicle).armed
    flying = Signals(vehicle).landed_state
    assert (climb.values == 3.0).all()
    assert armed.values.all() and flying.values.all()
    controls = vehicle.messages["ACTUATOR_CONTROL_TARGET"]["controls"]
    assert controls.shape == (len(TIMES), 8) and np.allclose(controls[:, :3], [0.1, 0.2, 0.3])


@mark.slow
@mark.parametrize(
    "mode, autopilot",
    {
        "OFFBOARD": "PX4",
        "AUTO.LOITER": "PX4",
        "ALT_HOLD": "ARDUPILOTMEGA",
        "CMODE(3)": "GENERIC",
        "": "GENERIC",
    }.items(),
)
def test_modes_tell_the_autopilot(mode, autopilot, recorder):
    """MAVROS records no name of the autopilot: it is recognised by the name of the flight mode."""
    mavros_flight(recorder, UNIX + TIMES[:30], mode=mode)
    vehicle = recorder.vehicle()
    assert (vehicle.autopilot, vehicle.vehicle, vehicle.translated_from) == (
        autopilot,
        "UNKNOWN",
        "MAVROS",
    )


@mark.slow
@mark.parametrize("prefix", ["fmu/out/", "/a/b/fmu/out/", "/uav/", "/", "/fmu/in/"])
def test_wherever_px4s_topics_lie(prefix, recorder):
    px4_flight(recorder, prefix=prefix, system_id=7)
    vehicle = recorder.vehicle()
    assert (vehicle.system, vehicle.vehicle, vehicle.translated_from) == (
        7,
        "QUADROTOR",
        "uXRCE-DDS",
    )
    assert not vehicle.repairs
    assert len(vehicle.messages["ATTITUDE_QUATERNION"]["time"]) == len(TIMES)
    attitude = attitude_of_axis(vehicle, "roll")
    assert np.allclose(attitude.angle, roll(TIMES)[0], atol=1e-6)


@mark.slow
def test_the_system_id_is_the_most_frequent_one(recorder):
    px4_flight(recorder, prefix="/fmu/out/", system_id=7)
    after = TIMES[-1] + 0.1
    recorder.px4("vehicle_status", after, "/fmu/out/", arming_state=2, system_type=2, system_id=9)
    assert recorder.vehicle().system == 7


@mark.slow
def test_versions_and_directions_of_topics(recorder):
    """Topics with a version in their name are read, and those to the vehicle (in) as well as from it (out)."""
    for at in TIMES.tolist():
        recorder.px4("vehicle_status", at, "/fmu/out/", arming_state=2, system_type=2)
        for later in (0, 1):
            status = {"timestamp": round(at * 1e6) + later, "arming_state": 2, "system_type": 13}
            recorder.write("/fmu/out/vehicle_status_v1", "px4_msgs/msg/VehicleStatus", status)
        recorder.px4("vehicle_torque_setpoint", at, "/fmu/in/", xyz=[0.5, 0.0, 0.0])
        recorder.px4("vehicle_torque_setpoint", at, "/fmu/out/", xyz=[at % 1, 0.0, 0.0])
        recorder.px4("vehicle_thrust_setpoint", at, "/fmu/in/", xyz=[0.0, 0.0, -0.25])
        # What looks like the attitude and is something else.
        recorder.write(
            "/fmu/out/vehicle_attitude", "geometry_msgs/msg/TwistStamped", {"header": header(at)}
        )
        recorder.write(
            "/fmu/out/vehicle_attitude_groundtruth",
            "px4_msgs/msg/VehicleAttitude",
            {"q": [1.0] * 4},
        )
    vehicle = recorder.vehicle()
    assert vehicle.vehicle == "HEXAROTOR"
    assert set(vehicle.messages) == {"HEARTBEAT", "CURRENT_MODE", "ACTUATOR_CONTROL_TARGET"}
    controls = vehicle.messages["ACTUATOR_CONTROL_TARGET"]["controls"]
    assert np.allclose(controls[:, 0], TIMES % 1, atol=1e-6) and (controls[:, 3] == 0.25).all()


@mark.slow
def test_several_vehicles_are_listed_and_chosen(tmp_path):
    """Five vehicles are recorded under different names. Those without a system id of their own get a free one."""
    times = 20 + 0.02 * np.arange(750)

    def write(recorder):
        px4_flight(recorder, prefix="/px4_1/fmu/out/", system_id=2)
        px4_flight(recorder, times + 100, "/px4_2/fmu/out/", system_id=3)
        px4_flight(recorder, prefix="/px4_3/fmu/out/", system_id=3)
        mavros_flight(recorder, node="/uav4/mavros")
        mavros_flight(recorder, node="/uav5")

    path = written(tmp_path, write)
    vehicles = read_log(path).vehicles
    assert [one.system for one in vehicles] == [1, 2, 3, 4, 5]
    numbering = [
        dict(fact.figures)
        for vehicle in vehicles[2:4]
        for fact in vehicle.repairs
        if fact.code is Repair.SYSTEM_NUMBERED
    ]
    assert numbering == [
        {"name": "/px4_3", "given": 3, "system": 3},
        {"name": "/uav4", "given": 0, "system": 4},
    ]
    nameless = replace(vehicles[0], system=0, repairs=())
    assert all(vehicle.repairs for vehicle in with_system_ids([("", nameless)] * 2))
    with raises(NotLearnable, match="several vehicles"):
        mavdem.read_flight(path)
    assert mavdem.read_flight(path, vehicle="2").time[0] == approx(120)


@mark.slow
def test_stamps_that_are_missing_or_astray_are_left_out(recorder):
    """One message of each topic has the stamp 0, or one hours or years later."""
    for row, at in enumerate(TIMES.tolist()):
        recorder.px4("vehicle_angular_velocity", 0.0 if row == 9 else at, xyz=[0.0, 0.0, 0.0])
        recorder.px4("vehicle_attitude", 7000.0 if row == 50 else at, q=[1.0, 0.0, 0.0, 0.0])
        recorder.px4("actuator_motors", 1e13 if row == 70 else at, control=[0.5] * 12)
    vehicle = recorder.vehicle()
    assert np.allclose(vehicle.messages["ATTITUDE_QUATERNION"]["time"], np.delete(TIMES, 9))
    assert np.allclose(vehicle.messages["HIL_ACTUATOR_CONTROLS"]["time"], np.delete(TIMES, 70))
    assert Repair.STAMPS_IGNORED in [fact.code for fact in vehicle.repairs]
    assert Flaw.NO_STAMP in [fact.figures.get("flaw") for fact in vehicle.repairs]


@mark.slow
def test_the_wrap_of_servo_output_raw_that_mavros_hands_on_is_undone(recorder):
    """MAVROS passes on the 32-bit microseconds of SERVO_OUTPUT_RAW, which wrap after 71 minutes."""
    wrap = 2**32 / 1e6
    recorder.mavros("state", "mavros_msgs/msg/State", UNIX, armed=True)
    for at in (wrap - 1.5 + TIMES - TIMES[0]).tolist():
        recorder.imu(UNIX + at, (0.1, 0.0, 0.0), (0.0, 0.0, 0.0))
        channels = [1500 + round(100 * (at % 1))] * 4
        recorder.mavros("rc/out", "mavros_msgs/msg/RCOut", UNIX + at % wrap, channels=channels)
    vehicle = recorder.vehicle()
    times = [vehicle.messages[name]["time"] for name in ("ATTITUDE_QUATERNION", "SERVO_OUTPUT_RAW")]
    assert len(times[1]) == len(TIMES) and np.allclose(times[0], times[1], rtol=0, atol=1e-5)
    assert Repair.CLOCK_WRAPPED in [fact.code for fact in vehicle.repairs]


@mark.slow
def test_without_the_library_the_command_that_installs_it_is_reported(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with raises(MissingExtra, match=r"pip install 'mavdem\[ros2\]'"):
        read_log(written(tmp_path, px4_flight))


HOSTILE = {
    "no type": "nonsense\n",
    "code": "__import__('os').system('true') q\n",
    "dunder": "uint64 timestamp\nfloat32[4] __class__\n",
    "another type": "uint64 timestamp\nDragon q\n",
    "a huge array": "uint64 timestamp\nfloat32[999999999] q\n",
    "a huge array with a sign": "uint64 timestamp\nstring[+99999999] q\n",
    "in a circle": "uint64 timestamp\nA q\n===\nMSG: px4_msgs/A\nB b\n===\nMSG: px4_msgs/B\nA a\n",
    "thousands of millions": "uint64 timestamp\nA[4000000000] q\n===\nMSG: px4_msgs/A\nuint8[1] a\n",
    "of nothing": "uint64 timestamp\nA[400000000] q\n===\nMSG: px4_msgs/A\n",
    "ever more": "uint64 timestamp\nA0 q\n"
    + "".join(
        f"===\nMSG: px4_msgs/A{n}\n" + "".join(f"A{n + 1} f{i}\n" for i in range(10))
        for n in range(30)
    )
    + "===\nMSG: px4_msgs/A30\nuint8[1] a\n",
    "deep": "uint64 timestamp\nA0 q\n"
    + "".join(f"===\nMSG: px4_msgs/A{n}\nA{n + 1} a\n" for n in range(2000)),
    "many fields": "uint64 timestamp\n" + "uint8 a\n" * 1000,
    "wide text": "uint64 timestamp\nwstring q\n",
    "bell": "uint64 timestamp\nfloat32[4] \x1b[31mq\x07\n",
    "twice": "uint64 timestamp\nuint64 timestamp\nfloat32[4] q\n",
}
"""Definitions of vehicle_attitude that are none."""
ODD = {
    "spaces": "uint64 timestamp\nfloat32[4] q\n#" + " " * 60_000 + "[\n",
    "no stamp": "float32[4] q\n",
    "a text for a stamp": "string timestamp\nfloat32[4] q\n",
    "a message for a stamp": "A timestamp\nfloat32[4] q\n===\nMSG: px4_msgs/A\nuint64 a\n",
}
"""Definitions that are whole, of something else."""


@mark.slow
@mark.parametrize("name", [*HOSTILE, *ODD])
def test_hostile_definitions_are_harmless(name, tmp_path, capfd, monkeypatch):
    """Message definitions in a recording may be nonsense, endless, or contain code."""
    monkeypatch.setattr("os.system", lambda _: fail("the file was executed"))
    path = tmp_path / "hostile.mcap"
    write_raw(
        path,
        {**HOSTILE, **ODD}[name].replace("===", "=" * 80),
        [b"\1" + bytes(199)] * 100 + [b"\xff" * 200] * 100,
    )
    begin_time = time.thread_time()
    log = read_log(path)
    assert time.thread_time() - begin_time < 2.0
    (vehicle,) = log.vehicles
    assert len(vehicle.messages["HIL_ACTUATOR_CONTROLS"]["time"]) == len(SOUND_TIMES)
    if name in HOSTILE:
        (repair,) = vehicle.repairs
        assert (repair.figures["flaw"], repair.figures["count"]) == (Flaw.UNDECODABLE, 200)
        assert repair.figures["names"] == ("/fmu/out/vehicle_attitude",)
    assert capfd.readouterr() == ("", "")


ATTITUDE = "px4_msgs/msg/VehicleAttitude"


def channel_of(writer, definition, language="ros2msg"):
    """A channel ``/fmu/out/vehicle_attitude`` whose messages have a definition of their own."""
    number = writer.register_schema(ATTITUDE, language, definition.encode())
    for other in range(99):
        writer.register_channel(f"/{other}/fmu/out/vehicle_attitude", "cdr", number)
    return writer.register_channel("/fmu/out/vehicle_attitude", "cdr", number)


SOUND_TIMES = TIMES[:20]
"""When motors and status are sound beside messages that are not, s."""


def write_raw(path, definition, bodies):
    """Bodies of attitude with a definition of their own, and sound motors and status."""
    with Ros2Recorder(path) as recorder:
        writer = recorder._writer._writer
        channel = channel_of(writer, definition)
        for row, body in enumerate(bodies):
            writer.add_message(channel, row, b"\0\1\0\0" + body, row)
        for at in SOUND_TIMES.tolist():
            recorder.px4("vehicle_angular_velocity", at, xyz=[0.0, 0.0, 0.0])
            recorder.px4("actuator_motors", at, control=[at % 1] * 12)
            recorder.px4("vehicle_status", at, arming_state=2, system_type=2, system_id=1)


@mark.parametrize(
    "beginning, language",
    [(begin_time, "ros2msg") for begin_time in (b"\0\2\0\0", b"\xff\xff\xff\xff", b"", b"\0")]
    + [(b"\0\1\0\0", "ros2idl")],
)
def test_other_encapsulations_and_languages_of_definition_are_not_read(
    beginning, language, tmp_path
):
    path = tmp_path / "other.mcap"
    with Recorder(path) as recorder:
        channel = channel_of(recorder._writer, DEFINITIONS[ATTITUDE], language)
        recorder._writer.add_message(channel, 1, beginning + bytes(80) if beginning else b"", 1)
    assert unreadable(read_log, path).code is SourceFact.ROS2_DAMAGED


@mark.slow
def test_the_battery_of_either_bridge(tmp_path):
    """The voltage falls from 16 V to 12 V, in the topics of PX4 and of MAVROS."""

    def write(recorder):
        px4_flight(recorder)
        mavros_flight(recorder, node="/uav/mavros")
        for row in range(5):
            recorder.px4("battery_status", 20.0 + row, voltage_v=16.0 - row, connected=True)
            recorder.mavros(
                "battery",
                "sensor_msgs/msg/BatteryState",
                UNIX + 20.0 + row,
                node="/uav/mavros",
                voltage=16.0 - row,
            )

    log = read_log(written(tmp_path, write))
    assert log.receive_time[0] == approx(UNIX, abs=1.0)
    for vehicle in log.vehicles:
        (recorded,) = Signals(vehicle).batteries
        signal = recorded.voltage
        assert signal.values.tolist() == approx([16, 15, 14, 13, 12])
        assert np.diff(signal.time) == approx([1, 1, 1, 1], abs=1e-6)


@mark.slow
def test_setpoints_of_mavros_are_turned_back(recorder):
    """The setpoint of the attitude is in ROS axes; its mask says that the roll rate is not set."""
    rpy = (0.3, -0.2, 1.0)
    pqr = np.array([0.5, -0.6, 0.7])
    mavros_flight(recorder)
    at = float(UNIX + TIMES[50])
    rates_in_ros_axes = {"x": pqr[0], "y": -pqr[1], "z": -pqr[2]}
    recorder.mavros(
        "setpoint_raw/target_attitude",
        "mavros_msgs/msg/AttitudeTarget",
        at,
        orientation=xyzw(to_ros(rpy)),
        body_rate=rates_in_ros_axes,
        type_mask=1,
    )
    vehicle = recorder.vehicle()
    assert [
        (one.name, one.signal.values.tolist()) for one in recorded_setpoints(vehicle, "roll")
    ] == [("roll setpoint", [approx(rpy[0])])]
    assert {one.name: one.signal.values[0] for one in recorded_setpoints(vehicle, "pitch")} == {
        "pitch rate setpoint": approx(pqr[1]),
        "pitch setpoint": approx(rpy[1]),
    }


@mark.slow
def test_what_holds_no_flight_of_a_vehicle_is_refused(tmp_path):
    """Setpoints alone, another sensor's IMU; and where a stream of MAVLink is asked for, topics."""
    for code, write in (
        (
            SourceFact.ROS2_DAMAGED,
            lambda vehicle: vehicle.px4("vehicle_rates_setpoint", 20.0, roll=1.0),
        ),
        (
            SourceFact.MCAP_WITHOUT_FLIGHT,
            lambda vehicle: vehicle.imu(20.0, (0.1, 0, 0), (0, 0, 0), node="/camera"),
        ),
    ):
        assert unreadable(read_log, written(tmp_path, write)).code is code
    assert unreadable(mcap_stream, written(tmp_path, px4_flight)).code is SourceFact.MCAP_OF_ROS2


@mark.slow
@mark.parametrize("write, begin", [(px4_flight, 0), (mavros_flight, UNIX + 19)])
def test_the_flight_is_the_motion_that_it_was_made_of(write, begin, tmp_path):
    """On UNIX time the recording's first second counts as 1."""
    sent = (UNIX if begin else 0) + 20 + 0.02 * np.arange(750)
    found = mavdem.read_flight(written(tmp_path, lambda recorder: write(recorder, sent)))
    angle, rate = roll(found.time + begin)
    assert found.dt == 0.02 and len(found) > 450
    # PX4's topics carry quaternions as 32-bit floats, and on UNIX time a stamp is off by up to 1e-6 s.
    assert np.allclose(found.outputs, np.column_stack([angle, rate]), rtol=0, atol=2e-5)
    motors = np.outer(angle, [-1, 1, 1, -1])
    motors = 0.5 + motors if write is px4_flight else 1500 + 100 * motors
    assert np.allclose(found.inputs, motors, rtol=0, atol=1e-6 if write is px4_flight else 0.501)
    assert found.provenance["vehicle"] == ("QUADROTOR" if write is px4_flight else "UNKNOWN")
    assert any("assumed" in caution for caution in found.provenance["cautions"])


@mark.slow
@mark.parametrize("other", ["MAVLink", "MAVROS"])
def test_mavlink_is_read_before_ros_2_and_px4s_own_topics_before_mavros(other, tmp_path):
    """One recording has the same flight in two forms: only one of them is read, and the other is reported."""
    path = tmp_path / "both.mcap"
    if other == "MAVLink":
        with Recorder(path) as recorder:
            for frame in [heartbeat(), *flight(TIMES.tolist())]:
                recorder.write("serial", frame, "mavlink", schema=False)
            channel = channel_of(recorder._writer, DEFINITIONS[ATTITUDE])
            recorder._writer.add_message(channel, 1, b"\0\1\0\0" + bytes(60), 1)
    else:
        with Ros2Recorder(path) as recorder:
            px4_flight(recorder, system_id=1)
            mavros_flight(recorder)
    (vehicle,) = read_log(path).vehicles
    assert vehicle.translated_from == ("" if other == "MAVLink" else "uXRCE-DDS")
    (repair,) = [fact for fact in vehicle.repairs if fact.code is Repair.TOPICS_NOT_READ]
    assert repair.figures["name"] == ("mavros" if other == "MAVROS" else "ros2")
