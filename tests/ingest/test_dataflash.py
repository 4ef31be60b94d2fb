"""DataFlash logs: every value against DFReader's, the same flight's telemetry log, and damage that costs its own."""

import random
from collections import defaultdict

import dataflash_logs as made
import numpy as np
from numpy.testing import assert_allclose
from pymavlink import DFReader
from pytest import approx, fixture, mark
from recorded_flights import shared

from mavdem.dataset.flight_states import armed_intervals
from mavdem.dataset.signals import Signals
from mavdem.facts.sources import Repair
from mavdem.ingest.dataflash.binary import read_binary
from mavdem.ingest.dataflash.log import read_dataflash
from mavdem.ingest.dataflash.vibrations import vibration
from mavdem.ingest.vocabulary import Injection

STEPS = "sitl_ardupilot/ardupilot_inertia_wind5_steps.BIN"
TIMES = [20 + 0.01 * row for row in range(200)]
SLOW = [20 + 0.5 * row for row in range(20)]


def vehicle_of(content, folder):
    path = folder / "flight.bin"
    path.write_bytes(content)
    (vehicle,) = read_dataflash(path).vehicles
    return vehicle


def vehicle_in(folder, *pieces):
    return vehicle_of(made.log(*pieces), folder)


@fixture
def steps(tmp_path):
    """The beginning of a flight, which DFReader reads for long."""
    path = tmp_path / "steps.BIN"
    path.write_bytes(shared(STEPS).read_bytes()[:3_200_000])
    return path


def by_dfreader(path, names=None):
    """Every message as plain DFReader reads it, as lists by message and field."""
    reader = DFReader.DFReader_binary(str(path))
    read = defaultdict(lambda: defaultdict(list))
    while (message := reader.recv_match(type=names, strict=True)) is not None:
        for field, value in message.to_dict().items():
            read[message.get_type()][field].append(value)
    return read


ANGLE = np.pi / 180
# The message, with its port where it has several, and its field; DataFlash's message and field; the factor.
TRANSLATED = {
    STEPS: [
        ("ATTITUDE", "time", "ANG", "TimeUS", 1e-6),
        ("ATTITUDE", "roll", "ANG", "Roll", ANGLE),
        ("ATTITUDE", "pitch", "ANG", "Pitch", ANGLE),
        ("ATTITUDE", "rollspeed", "RATE", "R", ANGLE),
        ("SERVO_OUTPUT_RAW:0", "time", "RCOU", "TimeUS", 1e-6),
        *(("SERVO_OUTPUT_RAW:0", f"servo{n}_raw", "RCOU", f"C{n}", 1.0) for n in range(1, 15)),
        ("SERVO_OUTPUT_RAW:1", "time", "RCO2", "TimeUS", 1e-6),
        *(("SERVO_OUTPUT_RAW:1", f"servo{n - 16}_raw", "RCO2", f"C{n}", 1.0) for n in (17, 18)),
        ("LOCAL_POSITION_NED", "vz", "XKF1", "VD", 1.0),
        ("WIND_COV", "wind_x", "XKF2", "VWN", 1.0),
        ("VFR_HUD", "climb", "CTUN", "CRt", 0.01),
    ],
    "real/logs/crash_motor2_mechanical.bin": [
        ("POWER_STATUS", "Vcc", "POWR", "Vcc", 1000.0),
        ("EKF_STATUS_REPORT", "velocity_variance", "NKF4", "SV", 1.0),
        ("EKF_STATUS_REPORT", "compass_variance", "NKF4", "SM", 1.0),
        ("GPS_RAW_INT", "eph", "GPS", "HDop", 100.0),
        ("GPS_RAW_INT", "satellites_visible", "GPS", "NSats", 1.0),
        ("GPS_RAW_INT", "alt", "GPS", "Alt", 1000.0),
    ],
}


@mark.slow
@mark.parametrize("log", TRANSLATED)
def test_the_translation_holds_dfreaders_values_in_mavlinks_units(log, steps):
    """The values of real logs are those that pymavlink's DFReader reads, times the factor between the units."""
    path = steps if log == STEPS else shared(log)
    read = by_dfreader(path, [*{own for _, _, own, _, _ in TRANSLATED[log]}, "PARM"])
    (vehicle,) = read_dataflash(path).vehicles
    for message, field, own, name, factor in TRANSLATED[log]:
        primary = np.array(read[own].get("C", np.zeros(len(read[own][name])))) == 0
        expected = factor * np.array(read[own][name])[primary]
        name_of_message, _, port = message.partition(":")
        columns = vehicle.messages[name_of_message]
        values = columns[field][columns["port"] == int(port)] if port else columns[field]
        assert_allclose(values, expected, rtol=1e-14)
        assert vehicle.name_in_source(name_of_message) in (own, "ANG", "RCOU/RCO2")
    named = dict(zip(read["PARM"]["Name"], read["PARM"]["Value"], strict=True))
    assert vehicle.parameters == named
    if log != STEPS:
        # 9023 is 831, and beyond the tenth bit that the filter knows of its take-off and uses GPS
        flags = vehicle.messages["EKF_STATUS_REPORT"]["flags"]
        assert set(flags.tolist()) == {9023 & 1023}
        return
    yaw = vehicle.messages["ATTITUDE"]["yaw"]
    turned = np.exp(1j * np.radians(read["ANG"]["Yaw"]))
    assert np.allclose(np.exp(1j * yaw), turned, atol=1e-12) and abs(yaw).max() <= np.pi
    controls = vehicle.messages["ACTUATOR_CONTROL_TARGET"]["controls"]
    demands = [read["RATE"][name] for name in ("ROut", "POut", "YOut", "AOut")]
    assert np.array_equal(controls[:, :4], np.column_stack(demands))
    assert (vehicle.system, vehicle.vehicle, vehicle.autopilot) == (1, "QUADROTOR", "ARDUPILOTMEGA")


def test_a_log_that_begins_in_the_air_says_so(tmp_path):
    landed = made.message("EV", 21_990_000, 18) + made.message("EV", 21_991_000, 11)
    vehicle = vehicle_in(tmp_path, *made.flight(TIMES), landed)
    assert vehicle.messages["HEARTBEAT"]["base_mode"].tolist() == 8 * [128] + [0, 0]
    assert vehicle.messages["EXTENDED_SYS_STATE"]["landed_state"].tolist() == [2, 2, 1]
    silent = vehicle_in(tmp_path, *made.flight(TIMES))
    assert "HEARTBEAT" not in silent.messages and "EXTENDED_SYS_STATE" not in silent.messages


def test_between_events_that_contradict_each_other_nothing_is_reported(tmp_path):
    """Logging may end with disarming, so that a landing is not in the log: only that it took off again is."""
    rows = made.flight(SLOW)
    for row, stamp in ((13, 26_100_000), (5, 22_100_000)):
        rows.insert(row, made.message("EV", stamp, 28))
    states = vehicle_in(tmp_path, *rows).messages["EXTENDED_SYS_STATE"]
    landed_state_by_second = dict(
        zip(np.floor(states["time"]).tolist(), states["landed_state"].tolist(), strict=False)
    )
    assert [landed_state_by_second[second] for second in range(20, 30)] == [
        1,
        1,
        2,
        0,
        0,
        0,
        2,
        0,
        0,
        0,
    ]
    assert states["landed_state"][states["time"] == 26.0].tolist() == [1]


def test_between_two_armings_the_vehicle_was_disarmed_when_the_log_stopped(tmp_path):
    flights = [made.flight([start + 0.5 * row for row in range(20)]) for start in (20, 50)]
    armings = [[made.message("EV", stamp, 10)] for stamp in (20_100_000, 50_000_000)]
    vehicle = vehicle_in(tmp_path, *armings[0], *flights[0], *armings[1], *flights[1])
    (first, second) = armed_intervals(Signals(vehicle), 0)
    assert first == approx((20.1, 29.5)) and second[0] == approx(50.0)


def test_the_armed_flag_of_the_supply_dates_an_arming_without_its_event(tmp_path):
    """A log that was not written between its start and the arming lacks the event, and first has AUTO_ARMED."""
    armed_states = [(20.0, 0), (20.5, 0), (24.0, 1), (24.5, 1), (27.0, 1), (27.5, 0), (28.0, 0)]
    flags = [
        (time, made.message("POWR", round(1e6 * time), 5.0, 0.0, 0, 0, 2 + 4 * armed))
        for time, armed in armed_states
    ]
    events = [
        (25.0, made.message("EV", 25_000_000, 15)),
        (27.1, made.message("EV", 27_100_000, 11)),
    ]
    rows = sorted([*zip(SLOW, made.flight(SLOW), strict=True), *flags, *events])
    vehicle = vehicle_in(tmp_path, *(row for _, row in rows))
    assert armed_intervals(Signals(vehicle), 0) == [approx((24.0, 27.1))]
    without_flags = sorted([*zip(SLOW, made.flight(SLOW), strict=True), *events])
    vehicle = vehicle_in(tmp_path, *(row for _, row in without_flags))
    ((begin, _),) = armed_intervals(Signals(vehicle), 0)
    assert begin < 20.0


def test_two_armings_with_the_first_message_and_events_of_no_kind_change_no_time(tmp_path):
    """Times must ascend although two events have the stamp of the first message.

    Events without a number of their kind are left out.
    """
    rows = made.flight(SLOW)
    twice = [made.message("EV", 20_000_000, 10)] * 2
    vehicle = vehicle_in(tmp_path, *twice, *rows)
    assert (np.diff(vehicle.messages["HEARTBEAT"]["time"]) >= 0).all()
    assert {begin for begin, _ in armed_intervals(Signals(vehicle), 0)} == {20.0}
    lines = "FMT, 129, 0, ATT, Qccc, TimeUS,Roll,Pitch,Yaw\nFMT, 133, 0, EV, B, Other\n"
    lines += "".join(f"ATT, {20_000_000 + 10_000 * row}, 1, 2, 3\nEV, 10\n" for row in range(500))
    (tmp_path / "flight.log").write_text(lines)
    assert "HEARTBEAT" not in read_dataflash(tmp_path / "flight.log").vehicles[0].messages


def test_yaw_is_between_half_turns_and_rates_move_to_the_angles_stamps(tmp_path):
    """Yaw passes north, from 350° to 26°, and rates are recorded 3 ms after the angles."""
    rows = [made.att(20 + 0.1 * i, 0, 0, (350 + 4 * i) % 360) for i in range(10)]
    rows += [made.rate(20.003 + 0.1 * i, 10.0 * i) for i in range(-1, 11)]
    attitude = vehicle_of(
        made.formats() + b"".join(sorted(rows, key=lambda row: row[3:11][::-1])), tmp_path
    )
    columns = attitude.messages["ATTITUDE"]
    expected = np.array([-10, -6, -2, 2, 6, 10, 14, 18, 22, 26])
    assert np.allclose(np.degrees(columns["yaw"]), expected)
    assert np.allclose(np.degrees(columns["rollspeed"]), 10.0 * np.arange(10) - 0.3)


def test_no_attitude_is_invented_between_slow_rates_nor_in_their_gaps(tmp_path):
    """Angles come at 100 Hz, rates at 20 Hz with a gap of 1 s. Samples are those of the rates."""
    angles = [made.att(20 + 0.01 * i, 0.1 * i) for i in range(301)]
    rates = [made.rate(20 + 0.05 * i, 1.0) for i in range(61) if not 20 < i < 40]
    rows = sorted(angles + rates, key=lambda row: row[3:11][::-1])
    columns = vehicle_of(made.formats() + b"".join(rows), tmp_path).messages["ATTITUDE"]
    assert len(columns["time"]) == len(rates)
    assert np.allclose(np.degrees(columns["roll"]), 10 * (columns["time"] - 20))


def test_an_appended_log_of_other_definitions_is_left_out(tmp_path):
    other = made.fmt("ATT", kind=130) + made.fmt("RATE", kind=129) + other_id(made.att(3, 6.0), 130)
    flight = b"".join(made.flight([500 + 0.1 * row for row in range(50)]))
    vehicle = vehicle_of(made.formats() + flight + other, tmp_path)
    assert len(vehicle.messages["ATTITUDE"]["time"]) == 50
    assert counts(vehicle) == {Repair.BYTES_SKIPPED: len(other)}


def other_id(message, kind):
    return message[:2] + bytes([kind]) + message[3:]


GARBAGE = random.Random(5).randbytes(400)
GARBAGES = (GARBAGE, bytes(100), b"\xff" * 50, b"\xa3\x95" * 40, b"\xa3\x95\x81", b"\xa3")


def counts(vehicle):
    """The count of each repair, None where it has none."""
    return {fact.code: fact.figures.get("count") for fact in vehicle.repairs}


def spoiled(case):
    """Returns a log of ``TIMES`` with one thing wrong, of which all messages of attitude and motors can be read."""
    rows = made.flight(TIMES)
    att = made.fmt("ATT")
    ctun = made.fmt("CTUN")
    begun = made.formats() + made.told()
    halves = (b"".join(rows[:80]), b"".join(rows[80:]))
    kind, _, detail = case.partition(" ")
    if kind == "garbage":
        return begun + halves[0] + bytes.fromhex(detail) + halves[1]
    if kind == "length":
        return begun.replace(att, made.fmt("ATT", length=int(detail))) + b"".join(rows)
    climbs = b"".join(
        row + made.message("CTUN", round(1e6 * t)) for row, t in zip(rows, TIMES, strict=True)
    )
    return {
        "filled": begun + b"".join(halves) + b"\xff" * 200,
        "late": halves[0] + begun + halves[1],
        "strange": begun.replace(ctun, made.fmt("CTUN", characters="Q?hh")) + climbs,
        "undefined": begun
        + b"".join(row + other_id(made.message("EV", 5, 5), 200) for row in rows),
        "stamp": begun + halves[0] + made.message("ATT", 2**63, 0, 900) + halves[1],
    }[kind]


@mark.parametrize(
    "case, repairs",
    [(f"garbage {garbage.hex()}", {Repair.BYTES_SKIPPED: len(garbage)}) for garbage in GARBAGES]
    + [
        (f"length {length}", {Repair.DEFINITION_CONTRADICTED: None})
        for length in (0, 1, 2, 3, 10, 255)
    ]
    + [
        ("filled", {}),
        ("late", {}),
        ("strange", {}),
        ("undefined", {Repair.BYTES_SKIPPED: 200 * len(made.message("EV", 5, 5))}),
        ("stamp", {Repair.STAMPS_IGNORED: 1}),
    ],
)
def test_what_is_wrong_costs_itself_only(tmp_path, case, repairs):
    """A log with one damaged place, or one wrong definition, loses at most the message there."""
    vehicle = vehicle_of(spoiled(case), tmp_path)
    attitude = vehicle.messages["ATTITUDE"]
    assert np.allclose(attitude["time"], TIMES, atol=1e-9)
    assert np.allclose(attitude["roll"], np.radians([2.0 + 2 * (i % 5) for i in range(200)]))
    assert "VFR_HUD" not in vehicle.messages
    # Garbage costs the message before it, unless it looks like the next.
    servos = np.round(vehicle.messages["SERVO_OUTPUT_RAW"]["time"], 6).tolist()
    lost = set(np.round(TIMES, 6).tolist()) - set(servos)
    assert lost <= ({round(TIMES[79], 6)} if case.startswith("garbage") else set())
    size_by_point = counts(vehicle)
    assert size_by_point.keys() == repairs.keys()
    if not lost:
        assert size_by_point == repairs


def test_markers_between_two_stretches_of_a_log_count(monkeypatch):
    content = other_id(made.message("EV", 5, 5), 200) * 50
    expected = read_binary(content).undefined_messages
    assert expected == 50
    monkeypatch.setattr("mavdem.ingest.dataflash.binary.MARKER_SEARCH_BYTES", 1)
    assert read_binary(content).undefined_messages == expected


@mark.parametrize(
    "said, parameters, expected",
    [
        ("ArduCopter V4.5.7 (2a3dc4b7)", {"FRAME_CLASS": 2.0}, "HEXAROTOR"),
        ("APM:Copter V3.4.6 (e707341b)", {}, "GENERIC_MULTIROTOR"),
        ("ArduPlane V4.5.7", {"FRAME_CLASS": 1.0}, "FIXED_WING"),
        ("ArduRover V4.2.3", {"FRAME_CLASS": 1.0}, "GROUND_ROVER"),
        ("hello", {"FRAME_CLASS": 3.0, "ATC_RAT_RLL_P": 0.1}, "OCTOROTOR"),
        ("hello", {"FRAME_CLASS": 1.0}, "UNKNOWN"),
    ],
)
def test_who_flies(tmp_path, said, parameters, expected):
    """The kind of vehicle follows from the text of the firmware, and the parameter of the frame."""
    landed_state_by_second = made.message("MSG", 1, said) + b"".join(
        made.message("PARM", 1, *pair, 0.0) for pair in parameters.items()
    )
    assert (
        vehicle_of(
            made.formats() + landed_state_by_second + b"".join(made.flight(TIMES)), tmp_path
        ).vehicle
        == expected
    )


def test_setpoints_of_rate_and_att_are_in_order(tmp_path):
    vehicle = vehicle_in(tmp_path, *made.flight(TIMES))
    assert_allclose(vehicle.messages["ATTITUDE_TARGET"]["time"], np.repeat(TIMES, 2))
    assert vehicle.name_in_source("ATTITUDE_TARGET") == "RATE and ATT"


def test_what_system_identification_injects_is_known_by_its_axis(tmp_path):
    """ArduPilot's SIDS names by a number where its system identification injects the signal that SIDD has."""
    pieces = made.flight(TIMES)
    for row, (axis, size) in enumerate(
        ((1, 2.0), (4, 3.0), (7, 4.0), (10, 0.5), (11, 0.25), (14, 9.0))
    ):
        pieces[20 * row] += made.message("SIDS", 20_503_000 + 200_000 * row, axis)
        for step in range(3):
            stamp = 20_504_000 + 200_000 * row + 2500 * step
            pieces[20 * row] += made.message("SIDD", stamp, 0.0, size * step)
    vehicle = vehicle_in(tmp_path, *pieces)
    injected = Signals(vehicle).injected_signals
    size_by_point = {
        injected_signal.injection_point: injected_signal.signal.values[1]
        for injected_signal in injected
    }
    assert size_by_point == {
        Injection.ANGLE_SETPOINT: approx(np.radians(2)),
        Injection.RECOVERED_ANGLE_SETPOINT: approx(np.radians(3)),
        Injection.RATE_SETPOINT: approx(np.radians(4)),
        Injection.DEMAND: 0.5,
    }
    assert injected[-1].signal.time == approx(21.104 + 0.0025 * np.arange(3))
    assert [
        injected_signal.injection_point
        for injected_signal in Signals(vehicle, axis="pitch").injected_signals
    ] == [Injection.DEMAND]
    assert Signals(vehicle, axis="yaw").injected_signals == ()


@mark.parametrize("names", ["RPY", "RP"])
def test_d_terms_are_those_of_all_axes_or_not_known(names, tmp_path):
    """The D terms of the rate controllers are read only if roll, pitch and yaw were logged."""
    pieces = made.flight(TIMES)
    for row, name in enumerate(names * 2):
        pieces[20 * row] += made.message(f"PID{name}", 20_503_000 + 200_000 * row, 0.1 * row)
    messages = vehicle_in(tmp_path, *pieces).messages
    if names == "RPY":
        assert "D_TERM" in messages
    else:
        assert "D_TERM" not in messages
    if names == "RPY":
        assert messages["D_TERM"]["z"] == approx([0.2, 0.5])


def test_the_firmware_and_what_the_logger_lost_are_known(tmp_path):
    """The log names the firmware, parameters with their defaults, and how many messages its writer dropped."""
    lost = [
        made.message("DSF", round(1e6 * (20 + i)), count, 0, 0, 0, 0, 0)
        for i, count in enumerate((7, 7, 12, 0, 3))
    ]
    changed = made.message("PARM", 20_050_000, "SYSID_THISMAV", 8.0, 1.0)
    vehicle = vehicle_in(tmp_path, *made.flight([20.0, 20.1]), *lost, changed)
    assert vehicle.initial_parameters == {"SYSID_THISMAV": 7.0} and vehicle.system == 8
    # FRAME_CLASS is 1, its default 0.
    assert vehicle.default_parameters == {"SYSID_THISMAV": 1.0, "FRAME_CLASS": 0.0}
    assert vehicle.changed_defaults == {"SYSID_THISMAV": 1.0, "FRAME_CLASS": 0.0}
    assert (vehicle.firmware, vehicle.dropouts) == ("ArduCopter V4.5.7 (2a3dc4b7)", 8)
    assert {Repair.LOGGER_WITHOUT_ROOM: 8}.items() <= counts(vehicle).items()


def test_a_text_that_is_older_than_the_log_keeps_its_time(tmp_path):
    arming = made.message("MSG", 12_100_000, "Arming motors")
    vehicle = vehicle_in(tmp_path, arming, *made.flight(TIMES))
    texts = vehicle.messages["STATUSTEXT"]
    assert texts["time"][texts["text"] == "Arming motors"].tolist() == [12.1]
    assert vehicle.messages["ATTITUDE"]["time"][0] == TIMES[0]


def test_vibration_whose_numbers_of_imus_are_damaged_is_left_out():
    vibe = {name: np.ones(2) for name in ("VibeX", "VibeY", "VibeZ")}
    stamps = {"time": np.array([1.0, 1.1]), "boot": np.zeros(2, int)}
    assert len(vibration({"VIBE": stamps | vibe | {"IMU": np.array([0, 0])}})["vibration_x"]) == 2
    assert vibration({"VIBE": stamps | vibe | {"IMU": np.array([77, 99])}}) == {}
