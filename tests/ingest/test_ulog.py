"""PX4's logs: values as pyulog reads them, in MAVLink's words; and what is whole of a file that is not."""

import io
import lzma
import struct

import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, mark
from pyulog import ULog
from recorded_flights import shared
from refusals import unreadable
from scipy.spatial.transform import Rotation, Slerp
from ulog_files import (
    HEADER,
    OFF,
    REAL,
    TIMES,
    data,
    flight,
    log,
    message,
    parameter,
    subscription,
    vehicle_in,
    vehicle_of,
)

from mavdem.assessment.autopilot_messages import reported_problems
from mavdem.dataset.segments import recorded_spans
from mavdem.dataset.signals import Signals
from mavdem.errors import Unreadable
from mavdem.facts.sources import Flaw, Repair, SourceFact
from mavdem.ingest import contents as files
from mavdem.ingest import read_log
from mavdem.ingest.flight_modes import mode_name
from mavdem.ingest.px4_messages import attitude_target_messages, interpolated_rotations
from mavdem.ingest.telemetry import rate_without_gaps
from mavdem.ingest.ulog_records import sound_records
from mavdem.ingest.ulog_topics import parse_records
from mavdem.ingest.vocabulary import Injection, euler_angles


def same(attitude_columns, pyulog_name):
    return len(attitude_columns) == len(pyulog_name) and bool(
        (np.asarray(attitude_columns, np.float64) == np.asarray(pyulog_name, np.float64)).all()
    )


@mark.slow
@mark.parametrize("name", REAL)
def test_values_are_those_pyulog_reads(name):
    """The values of real logs are those that the library pyulog reads."""
    path = shared(name)
    (vehicle,) = read_log(path).vehicles
    pyulog_log = ULog(str(path))
    attitude = pyulog_log.get_dataset("vehicle_attitude").data
    attitude_columns = vehicle.messages["ATTITUDE_QUATERNION"]
    for field, pyulog_name in (("q1", "q[0]"), ("q4", "q[3]"), ("yawspeed", "yawspeed")):
        assert same(attitude_columns[field], attitude[pyulog_name])
    assert same(np.rint(attitude_columns["time"] * 1e6), attitude["timestamp"])
    outputs = vehicle.messages["SERVO_OUTPUT_RAW"]
    for topic in (topic for topic in pyulog_log.data_list if topic.name == "actuator_outputs"):
        is_of_topic = outputs["port"] == topic.multi_id
        assert same(np.rint(outputs["time"][is_of_topic] * 1e6), topic.data["timestamp"])
        assert same(outputs["servo16_raw"][is_of_topic], topic.data["output[15]"])
    expected = {name: float(value) for name, value in pyulog_log.initial_parameters.items()}
    expected |= {name: float(value) for _, name, value in pyulog_log.changed_parameters}
    assert vehicle.parameters == expected
    assert (vehicle.vehicle, vehicle.autopilot, vehicle.system) == ("QUADROTOR", "PX4", 1)


def test_what_is_no_data_is_what_pyulog_reads():
    """Parameters before and in flight, defaults, information, texts and dropouts, also before any subscription."""

    def keyed(kind, key, value, flags=b""):
        return message(kind, flags + bytes([len(key)]) + key.encode() + value)

    first_records = message("B", b"\x01" + bytes(39))
    before = [
        parameter("MAV_TYPE", 2),
        parameter("MC_ROLL_P", float("nan"), "float"),
        parameter("MC_ROLL_P", 6.5, "float"),
        keyed("P", "bool FLAG", b"\x01"),
        keyed("P", "char LETTER", b"a"),
        keyed("Q", "float MC_ROLL_P", struct.pack("<f", 6.0), b"\x01"),
        keyed("Q", "int32_t MAV_TYPE", struct.pack("<i", 13), b"\x03"),
        keyed("I", "char[4] ver_hw", b"V5\xff!"),
        keyed("I", "uint32_t ver_sw_release", struct.pack("<I", 0x010E03FF)),
        keyed("I", "uint8_t[2] other", b"\x01\x02"),
        message("O", struct.pack("<H", 30)),
    ]
    later = [
        data("cpuload", 30.0, 0.5),
        *(data("vehicle_air_data", 22 + 0.1 * row, 1.0, 2.0) for row in range(3)),
        parameter("MAV_TYPE", 13),
        data("cpuload", 23.0, 0.5),
        parameter("MC_ROLL_P", 7.0, "float"),
        keyed("Q", "int32_t LATE", struct.pack("<i", 5), b"\x02"),
        keyed("I", "char[4] ver_hw", b"V6X!"),
        message("L", b"4" + struct.pack("<Q", 23_500_000) + "Tür \xff".encode("latin-1")),
        message("C", b"4" + struct.pack("<HQ", 7, 23_500_000) + b"tagged"),
        message("O", struct.pack("<H", 120)),
    ]
    content = log(*later, first=first_records, parameters=b"".join(before))
    attitude_columns = parse_records(sound_records(content)).other
    pyulog_name = ULog(io.BytesIO(content))
    numbers = {
        name: value for name, value in pyulog_name.initial_parameters.items() if name != "LETTER"
    }
    assert (
        attitude_columns.initial_settings == numbers
        and attitude_columns.start_stamp == pyulog_name.start_timestamp
    )
    assert attitude_columns.changed_settings == pyulog_name.changed_parameters
    assert attitude_columns.firmware_defaults == pyulog_name.get_default_parameters(0)
    assert attitude_columns.airframe_defaults == pyulog_name.get_default_parameters(1)
    assert attitude_columns.information == pyulog_name.msg_info_dict
    texts = [(text.log_level, text.timestamp, text.message) for text in pyulog_name.logged_messages]
    assert attitude_columns.texts == texts == [(ord("4"), 23_500_000, "Tr ")]
    assert (
        attitude_columns.dropout_durations
        == [dropout.duration for dropout in pyulog_name.dropouts]
        == [120]
    )


def test_attitude_is_moved_to_the_stamps_of_the_rates(tmp_path):
    """Attitude 20 times a second and rates 50, as PX4 logs them by default; one stretch without attitude."""
    slow, fast = np.arange(0, 4, 0.05), np.arange(0.5, 3.5, 0.02)
    slow = slow[(slow < 2.01) | (slow > 2.49)]
    # Odd rows have the same attitude with the other sign.
    half = slow / 4 + np.pi * (np.arange(len(slow)) % 2)
    pieces = [
        data("vehicle_attitude", 20 + time, np.cos(angle), np.sin(angle), 0, 0, 0)
        for time, angle in zip(slow, half, strict=True)
    ]
    pieces += [data("vehicle_angular_velocity", 20 + time, 0.5, 0.0, 0.1) for time in fast]
    vehicle = vehicle_in(tmp_path, *pieces)
    messages = vehicle.messages["ATTITUDE_QUATERNION"]
    time = messages["time"] - 20
    assert vehicle.repairs[0].code is Repair.ATTITUDE_INTERPOLATED
    assert dict(vehicle.repairs[0].figures) == approx({"attitude_rate": 20, "rate": 50})
    assert_allclose(np.diff(time)[np.diff(time) < 0.1], 0.02)
    assert not ((time > 2.001) & (time < 2.499)).any()
    assert_allclose(2 * np.arctan(messages["q2"] / messages["q1"]), time / 2, atol=1e-4)
    assert_allclose(messages["yawspeed"], 0.1)
    # One too slow keeps its stamps.
    pieces = [data("vehicle_attitude", 20 + 0.5 * row, 1, 0, 0, 0, 0) for row in range(20)]
    pieces += [
        data("vehicle_angular_velocity", 20 + 0.01 * row, 0.01 * row, 0, 0) for row in range(1000)
    ]
    messages = vehicle_in(tmp_path, *pieces).messages["ATTITUDE_QUATERNION"]
    assert_allclose(messages["time"], 20 + 0.5 * np.arange(20))
    assert_allclose(messages["rollspeed"], 0.5 * np.arange(20), atol=1e-6)


def test_rotations_are_interpolated_as_by_scipy():
    generator = np.random.default_rng(7)
    time = np.cumsum(generator.uniform(0.01, 0.1, 50))
    quaternions = generator.normal(size=(50, 4))
    query_time = np.append(generator.uniform(time[0], time[-1], 300), time)
    next_rows = np.clip(np.searchsorted(time, query_time), 1, 49)
    attitude_columns = interpolated_rotations(query_time, time, quaternions, next_rows)
    slerp = Slerp(time, Rotation.from_quat(quaternions, scalar_first=True))
    pyulog_name = slerp(query_time).as_quat(scalar_first=True)
    assert_allclose(
        attitude_columns,
        pyulog_name * np.sign(np.sum(attitude_columns * pyulog_name, axis=1))[:, None],
        atol=1e-12,
    )


def test_stamps_that_repeat_have_no_rate():
    assert rate_without_gaps(np.array([0.0, 0.0, 5.0])) == rate_without_gaps(np.zeros(0)) == 0.0


def test_motors_are_put_on_their_channels(tmp_path):
    """Parameters assign motors 3, 1, 4 and 2 to outputs 1, 2, 5 and 6."""
    swapped = b"".join(
        parameter(f"PWM_MAIN_FUNC{n}", motor)
        for n, motor in {1: 103, 2: 101, 5: 104, 6: 102}.items()
    )
    pieces = [
        data("actuator_motors", 20 + 0.01 * row, 0.1, 0.2, 0.3, 0.4 + row / 1e3, *OFF)
        for row in range(50)
    ]
    vehicle = vehicle_in(tmp_path, *pieces, parameters=swapped)
    controls = vehicle.messages["HIL_ACTUATOR_CONTROLS"]["controls"]
    assert np.allclose(controls[0], [0.3, 0.1, 0, 0, 0.4, 0.2] + [0] * 10)


def test_instances_of_outputs_are_ports(tmp_path):
    """Two output drivers publish the same topic as instances 0 and 1."""

    def outputs(row, instance):
        values = [1000 * (instance + 1) + row + 0.5, *[7.0] * 15]
        return data("actuator_outputs", 20 + 0.01 * row, 1, *values, instance=instance)

    pieces = [
        subscription("actuator_outputs", 1),
        *(outputs(row, port) for row in range(10) for port in (0, 1)),
    ]
    servo_outputs = vehicle_in(tmp_path, *pieces).messages["SERVO_OUTPUT_RAW"]
    for port in (0, 1):
        assert np.array_equal(
            servo_outputs["servo1_raw"][servo_outputs["port"] == port],
            1000 * (port + 1) + np.arange(10) + 0.5,
        )
    assert not servo_outputs["servo2_raw"].any()  # It is not among the outputs in use.


def test_a_topic_subscribed_to_twice_is_one(tmp_path):
    """The log subscribes to a topic again, under another number, in the midst of a flight."""
    second_subscription = subscription("actuator_controls_0", number=900)
    first_records = [data("actuator_controls_0", 20 + row, *[row] * 8) for row in range(5)]
    later_records = [
        data("actuator_controls_0", 25 + row, *[5 + row] * 8, number=900) for row in range(5)
    ]
    controls = vehicle_in(tmp_path, *first_records, second_subscription, *later_records).messages[
        "ACTUATOR_CONTROL_TARGET"
    ]["controls"]
    assert controls[:, 0].tolist() == list(range(10))


@mark.slow
def test_setpoints_are_in_order_and_without_attitudes_that_are_not_valid(tmp_path):
    """Setpoints of attitude and rate are published alternately; the third attitude is marked as invalid."""
    pieces = flight(TIMES)
    for row in range(4):
        at = 20 + row / 2
        pieces += [
            data("vehicle_attitude_setpoint", at, 0, 1, 0, 0, 0, row != 2),
            data("vehicle_rates_setpoint", at + 0.1, row, 0, 0),
        ]
    target = vehicle_in(tmp_path, *pieces).messages["ATTITUDE_TARGET"]
    assert_allclose(target["time"], [20, 20.1, 20.5, 20.6, 21.1, 21.5, 21.6])


def test_an_attitude_setpoint_of_euler_angles_is_read_where_there_is_no_quaternion():
    angles = {"roll_body": [0.1, 0.1], "pitch_body": [-0.2, -0.2], "yaw_body": [3.0, -3.0]}
    setpoints = {name: np.array(values) for name, values in angles.items()}
    topics = {"vehicle_attitude_setpoint": {0: {"time": np.array([1.0, 2.0]), **setpoints}}}
    target = attitude_target_messages(topics)
    assert_allclose(np.transpose(euler_angles(target["q"])), np.transpose([*angles.values()]))


def test_what_the_autotune_adds_to_the_rates_is_injected(tmp_path):
    """PX4's autotune adds a known signal to the rate setpoint of roll."""
    pieces = flight(TIMES)
    pieces += [
        data("autotune_attitude_control_status", 20 + row / 2, row, 0, 0) for row in range(4)
    ]
    vehicle = vehicle_in(tmp_path, *pieces)
    (injected,) = Signals(vehicle).injected_signals
    assert injected.injection_point is Injection.RATE_SETPOINT
    assert_allclose(injected.signal.time, 20 + np.arange(4) / 2)
    assert_allclose(injected.signal.values, np.arange(4), rtol=1e-6)
    assert Signals(vehicle, axis="pitch").injected_signals == ()


def test_drivers_that_publish_in_turn_are_told_apart_by_their_number_of_outputs(tmp_path):
    """PX4 1.12: one driver's constant outputs, 4, between the motors', of which it says that there are none."""
    turns = [4 if row % 3 == 2 else 0 for row in range(60)]
    values = [[1500.0] * 4 if used else [1000.0 + row] * 4 for row, used in enumerate(turns)]
    rows = zip(turns, values, strict=True)
    pieces = [
        data("actuator_outputs", 20 + 0.1 * row, used, *four, *[0.0] * 12)
        for row, (used, four) in enumerate(rows)
    ]
    servos = vehicle_in(tmp_path, subscription("actuator_outputs"), *pieces).messages[
        "SERVO_OUTPUT_RAW"
    ]
    moving = servos["servo4_raw"][servos["port"] == 0]
    assert moving.tolist() == [1000.0 + row for row in range(60) if row % 3 != 2]
    assert np.unique(servos["servo4_raw"][servos["port"] != 0]).tolist() == [1500.0]


def test_landed_states(tmp_path):
    """PX4's flags become MAVLink's landed state.

    That is 1 on the ground, 2 in the air, 3 at take-off and 4 at landing.
    """

    def target(seconds, kind, valid=True):
        return data("position_setpoint_triplet", seconds, 0, 0.0, False, 0, 0, 47.0, valid, kind)

    pieces = [
        data("vehicle_land_detected", 10, True),
        data("vehicle_control_mode", 10.5, True),
        target(11, 3),
        data("vehicle_land_detected", 12, False),
        target(20, 2),
        target(30, 4),
        target(31, 4, valid=False),
        target(32, 4),
        data("vehicle_control_mode", 33, False),
        data("vehicle_land_detected", 40, True),
    ]
    states = vehicle_in(tmp_path, *pieces).messages["EXTENDED_SYS_STATE"]
    landed_states = dict(zip(states["time"].tolist(), states["landed_state"].tolist(), strict=True))
    assert landed_states == {10: 1, 10.5: 1, 11: 1, 12: 3, 20: 2, 30: 4, 31: 2, 32: 4, 33: 2, 40: 1}
    # A vertical speed that is not valid is left out.
    pieces = [
        data("vehicle_local_position", 20 + row, 0, 0, 0, 0, 0, row, row % 2 == 0)
        for row in range(6)
    ]
    climb = Signals(vehicle_in(tmp_path, *pieces)).climb_rate
    assert climb.values.tolist() == [0, -2, -4]


@mark.parametrize(
    "status, parameters, expected",
    [
        ((2, 13, 1), b"", "HEXAROTOR"),
        ((2, 0, 1), parameter("MAV_TYPE", 14), "OCTOROTOR"),
        ((2, 0, 1), b"", "GENERIC_MULTIROTOR"),
        ((2, 0, 2), b"", "FIXED_WING"),
        ((2, 0, 0), b"", "UNKNOWN"),
    ],
)
def test_what_the_vehicle_is(tmp_path, status, parameters, expected):
    """The kind of vehicle follows from PX4's status and parameters.

    The status has the arming state, the type of the system, and the type of the vehicle.
    """
    pieces = [data("vehicle_status", 20 + row, *status) for row in range(4)]
    vehicle = vehicle_in(tmp_path, *pieces, parameters=parameters)
    assert vehicle.vehicle == expected
    if expected != "UNKNOWN":
        armed = Signals(vehicle).armed
        assert armed.values.all()


def test_parameters_are_the_last_that_were_set(tmp_path):
    """Parameters are set before and in flight. Values that are not finite are left out."""
    initial = (
        parameter("MAV_SYS_ID", 7)
        + parameter("GAIN", 0.5, "float")
        + parameter("BAD", float("nan"), "float")
    )
    changed = [parameter("GAIN", 0.25, "float"), parameter("GAIN", float("inf"), "float")]
    vehicle = vehicle_in(tmp_path, *flight(TIMES[:9]), *changed, parameters=initial)
    assert vehicle.parameters == {"MAV_SYS_ID": 7.0, "GAIN": 0.25} and vehicle.system == 7
    assert vehicle.initial_parameters == {"GAIN": 0.5}


def test_defaults_are_those_of_the_airframe_where_the_log_has_any(tmp_path):
    """A log may have the defaults of the firmware, of the airframe, or both."""

    def default(kinds, name, value):
        """ULog's message Q: a bit for the firmware, another for the airframe, and the default as a parameter."""
        text = parameter(name, value, "float")[3:]
        return message("Q", bytes([kinds]) + text)

    initial = parameter("GAIN", 0.5, "float") + parameter("LIMIT", 3.0, "float")
    firmware = default(1, "GAIN", 0.25) + default(1, "LIMIT", 1.0)
    hover = flight(TIMES[:9])
    flags = message("B", b"\1" + bytes(39))
    vehicle = vehicle_in(tmp_path, *hover, first=flags, parameters=initial + firmware)
    assert vehicle.changed_defaults == {"GAIN": 0.25, "LIMIT": 1.0}
    airframe = default(2, "GAIN", 0.125)
    parameters = initial + firmware + airframe
    vehicle = vehicle_in(tmp_path, *hover, first=flags, parameters=parameters)
    assert vehicle.changed_defaults == {"GAIN": 0.125}


@mark.parametrize("number, board", [("00060000AB", "00060000ab"), ("0000000000", "")])
def test_a_serial_number_of_zeros_names_no_board(tmp_path, number, board):
    """As in logs that were made anonymous: they would all be of one vehicle."""
    key = f"char[{len(number)}] sys_uuid".encode()
    information = message("I", bytes([len(key)]) + key + number.encode())
    assert vehicle_in(tmp_path, *flight(TIMES[:9]), parameters=information).board == board


@mark.slow
def test_damaged_levels_of_texts_and_stamps_of_another_type_are_left_out(tmp_path):
    texts = [message("L", struct.pack("<BQ", level, 21_000_000) + b"odd") for level in (3, 51, 255)]
    topic = b"vehicle_torque_setpoint:"
    right, wrong = topic + b"uint64_t timestamp", topic + b"double timestamp  "
    vehicle = vehicle_of(log(*flight(TIMES), *texts).replace(right, wrong), tmp_path)
    assert "ACTUATOR_CONTROL_TARGET" not in vehicle.messages and WANTED in vehicle.messages
    assert [fact.figures["severity"] for fact in reported_problems(vehicle)] == ["error"]


WANTED = "HIL_ACTUATOR_CONTROLS"


def stamps_of(vehicle):
    return np.rint(vehicle.messages[WANTED]["time"] * 1e6).astype(int).tolist()


INTACT = [round(time * 1e6) for time in TIMES.tolist()]


@mark.slow
def test_a_log_cut_off_anywhere_gives_what_came_before(tmp_path):
    """The log is cut at many places: messages before the cut are read, in the header it is refused."""
    content = log(*flight(TIMES[:30]))
    begin = len(log())
    for end in [*range(0, begin, 167), *range(begin, len(content), 97)]:
        try:
            vehicle = vehicle_of(content[:end], tmp_path)
        except Unreadable as error:
            assert end < begin + 200 and str(error).endswith(".")
            continue
        if WANTED in vehicle.messages:
            stamps = stamps_of(vehicle)
            assert stamps == INTACT[: len(stamps)] and content[:end].count(b"D\x02\x00") == approx(
                len(stamps), abs=1
            )


def test_stamps_that_cannot_be_are_left_out(tmp_path):
    """Three messages have stamps years later, before the log, or an hour after it."""
    pieces = flight(TIMES)
    for row, wrong in ((500, 1e12), (900, 3.0), (len(pieces) - 1, 5000.0)):
        row = max(row for row in range(row + 1) if pieces[row][2:4] == b"D\x02")
        pieces[row] = pieces[row][:5] + struct.pack("<Q", round(wrong * 1e6)) + pieces[row][13:]
    # A topic's last message from long before the log began is none of them.
    pieces.insert(0, data("vehicle_land_detected", 2.2, True))
    vehicle = vehicle_in(tmp_path, *pieces)
    assert set(stamps_of(vehicle)) < set(INTACT) and len(stamps_of(vehicle)) == len(INTACT) - 3
    assert {"count": 3, "flaw": Flaw.FAR_STAMP} in [fact.figures for fact in vehicle.repairs]
    assert vehicle.messages["EXTENDED_SYS_STATE"]["time"][0] == 2.2


@mark.slow
def test_a_part_whose_clock_is_years_ahead_is_left_out(tmp_path):
    ten_years = 315_360_000.0
    pieces = [*flight(TIMES[:100]), *flight(TIMES[100:200] + ten_years), *flight(TIMES[200:])]
    vehicle = vehicle_in(tmp_path, *pieces)
    assert stamps_of(vehicle) == INTACT[:100] + INTACT[200:]
    assert Flaw.FAR_STAMP in [fact.figures.get("flaw") for fact in vehicle.repairs]


def test_what_held_when_logging_started_has_that_time(tmp_path):
    """A state was published 18 s before the log begins: it is known from the beginning of the log on."""
    state = [data("vehicle_land_detected", 2.2, True), data("vehicle_land_detected", 21.0, False)]
    begun = HEADER.replace(struct.pack("<Q", 1_000_000), struct.pack("<Q", 20_000_000))
    content = log(state[0], *flight(TIMES[:100]), state[1], *flight(TIMES[100:]))
    vehicle = vehicle_of(begun + content[len(HEADER) :], tmp_path)
    assert vehicle.messages["EXTENDED_SYS_STATE"]["time"][0] == 20.0
    (part,) = recorded_spans(Signals(vehicle))
    assert part.start == 20.0


def test_a_dropout_is_reported(tmp_path):
    dropout = message("O", struct.pack("<H", 1500))
    vehicle = vehicle_in(tmp_path, *flight(TIMES), dropout)
    assert vehicle.repairs[0].code is Repair.LOGGER_DROPPED_OUT
    assert dict(vehicle.repairs[0].figures) == {"count": 1, "duration": 1.5, "longest_gap": 1.5}


@mark.slow
@mark.parametrize(
    "spoil, code",
    [
        (lambda packed: packed[:-300], SourceFact.ARCHIVE_DAMAGED),
        (
            lambda packed: packed[:200] + b"\0\xff" * 50 + packed[300:],
            SourceFact.ARCHIVE_DAMAGED,
        ),
        (lambda packed: lzma.compress(b"\1" * 2_000_000), SourceFact.FILE_TOO_LARGE),
    ],
)
def test_an_archive_that_cannot_be_unpacked_is_refused(tmp_path, monkeypatch, spoil, code):
    """An xz archive is cut off, damaged, or too large when unpacked."""
    monkeypatch.setattr(files, "MAX_LOG_BYTES", 1 << 20)
    path = tmp_path / "flight.ulg.xz"
    path.write_bytes(spoil(lzma.compress(log(*flight(TIMES)))))
    assert unreadable(read_log, path).code is code


def test_a_mode_of_px4_is_a_main_and_a_sub_mode():
    assert mode_name("PX4", "QUADROTOR", 4 << 16 | 5 << 24) == "Return"
