"""Condition, hover, identity and tier of made-up flights, against what they were made of, at rates down to 1 Hz."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from hover import Hover, changed, columns, disarmed, only, pulses, with_pulses, with_texts
from numpy.random import default_rng
from partial_records import partial_record
from pytest import approx, mark
from refusals import refused

from mavdem.assessment.axis import LogAnalysis
from mavdem.assessment.condition import measure_condition
from mavdem.assessment.identity import day_in_file_name, identify_vehicle
from mavdem.assessment.inventory import autopilot_alarms, inventory
from mavdem.assessment.mean_interval import mean_interval
from mavdem.assessment.tier import log_tier
from mavdem.dataset.learnability import learnability_of
from mavdem.dataset.signals import Signals
from mavdem.facts.learnability import NotLearnableReason, UnusableOutputs
from mavdem.fleet.names import NO_NAMES
from mavdem.ingest import Log
from mavdem.ingest.output_scale import OutputScale
from mavdem.ingest.telemetry import Component
from mavdem.ingest.vocabulary import UNNAMED
from mavdem.motors.hover import hover_figures, hover_of
from mavdem.report.condition import stream_contents
from mavdem.report.fleet import short_name, vehicle_label
from mavdem.report.review import vehicle_title

HOVER = Hover(hovering=60.0)


BEAT = HOVER.stamps(1.0)


def telemetry_with_current(current):
    """A hover on a battery that gives a ``current``, A, and sags by it."""
    volts = 16.0 - 0.01 * BEAT - 0.05 * current
    battery = columns(BEAT, voltage_battery=1e3 * volts, current_battery=1e2 * current)
    return changed(HOVER.telemetry(10.0, 10.0), "SYS_STATUS", **battery)


def test_a_vehicle_that_never_armed_has_its_battery_and_how_long_it_stood():
    condition = measure_condition(Signals(disarmed(telemetry_with_current(15.0))))
    assert condition.armed == condition.settled == 0
    assert not condition.hover
    assert not condition.lean
    assert condition.duration == approx(HOVER.end, abs=1.5)
    assert condition.battery.voltage_start > condition.battery.voltage_end


@mark.slow
def test_a_clock_that_jumps_by_more_than_a_day_leaves_the_armed_time_unknown():
    """The heartbeats of the second half of a hover are four months late."""
    telemetry = HOVER.telemetry(10.0, 10.0)
    beats = telemetry.messages["HEARTBEAT"]
    late = {**beats, "time": beats["time"] + 1e7 * (beats["time"] > 40.0)}
    jumped = replace(telemetry, messages={**telemetry.messages, "HEARTBEAT": late})
    assert measure_condition(Signals(telemetry)).armed > 50
    signals = Signals(jumped)
    condition = measure_condition(signals)
    assert condition.armed is None
    log = Log("hover.tlog", (jumped,), (), (), 0, 0, (0.0, 1e7))
    identity = identify_vehicle(signals)
    for duration, text in ((80.0, "80 s"), (1e7, "time unknown: the clock jumps")):
        condition = replace(condition, duration=duration)
        analysis = partial_record(LogAnalysis, identity=identity, condition=condition)
        assert f"quadrotor, {text}, " in vehicle_title(log, signals, analysis).text


def test_without_motor_outputs_the_lean_is_known_all_the_same():
    telemetry = HOVER.telemetry(4.0, without=("SERVO_OUTPUT_RAW",))
    flown = columns(BEAT, landed_state=1 + (abs(BEAT - 40) < 34))
    leaning = changed(telemetry, "ATTITUDE", roll=0.05)
    condition = measure_condition(Signals(changed(leaning, "EXTENDED_SYS_STATE", **flown)))
    assert condition.hover is None and condition.settled > 50
    assert condition.lean["roll"].mean == approx(0.05)


@mark.slow
def test_a_current_sensor_that_reads_nothing_in_flight_has_no_figures():
    condition = measure_condition(Signals(telemetry_with_current(1.0 * (BEAT < 20)))).battery
    assert condition.voltage_mean == approx(15.6, abs=0.2) and condition.current_mean is None


def test_the_interval_is_by_cosines_slower_than_a_twentieth_of_a_hertz():
    slow, fast = series = np.cos(np.pi / 400 * np.outer([20, 21], np.arange(400) + 0.5))
    half = 1.7247 * np.sqrt(slow.var() / 20)  # 5 % of Student's with 20 degrees of freedom
    assert mean_interval(series.T, 200.0) == approx([half, 0.0], abs=1e-5)
    assert [np.isinf(mean_interval(fast[:n, None], 200.0))[0] for n in (40, 41)] == [True, False]


@mark.slow
@mark.parametrize(
    "stop, parameters, low",
    [
        (1950.0, {"MOT_SPIN_MAX": 0.95, "MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0}, 1000.0),
        (1880.0, {}, 1000.0),
        (1892.0, {"MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0, "MOT_SPIN_MAX": 0.99}, 1100.0),
    ],
)
def test_motors_are_at_the_stop_that_the_autopilot_sets_or_the_outputs_show(stop, parameters, low):
    """Motor 2 reaches its upper limit, which parameters set or the log shows, in 30 % of the time."""
    telemetry = HOVER.telemetry(parameters=parameters)
    logged_outputs = pulses(telemetry)
    time = telemetry.messages["SERVO_OUTPUT_RAW"]["time"]
    commands = 1650.0 + 100 * default_rng(3).standard_normal(logged_outputs.shape)
    commands[1] += 400.0 * (np.sin(0.5 * time) > 0.6)
    outputs = np.where(logged_outputs > 1000, commands.clip(low, stop).round(), low)
    hover = hover_of(Signals(with_pulses(telemetry, outputs), inputs="motors"))
    assert hover.headroom[1] == 0 and 0 < hover.headroom[0] < 0.1
    assert hover.at_upper_limit[1] == approx(0.3, abs=0.05)
    assert max(hover.at_upper_limit[::2]) < 0.02


def test_a_stop_that_a_parameter_states_is_not_guessed_from_the_outputs():
    """A motor that stays at one output, such as on the ground after a loss, is at no limit."""
    parameters = {"MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0, "MOT_SPIN_MAX": 0.95}
    for stated_parameters, stop in ((parameters, 0.95), ({}, 0.75)):
        telemetry = HOVER.telemetry(parameters=stated_parameters)
        outputs = pulses(telemetry)
        outputs[0, -200:] = 1750.0
        assert Signals(with_pulses(telemetry, outputs)).motors.scale.upper_limit == approx(stop)


def test_motors_that_never_ran_have_no_figures():
    scale = OutputScale("PWM", "µs", 1000.0, 2000.0, 1.0)
    fact = refused(hover_figures, ("motor",), scale, 1.0, np.full((2, 1), 1000.0), {})
    assert fact.code is UnusableOutputs.MOTORS_OFF


TEXT = "CUAVv5Nano 001A002F 30395113 33333539"
CALIBRATED = {f"INS_ACCOFFS_{axis}": 0.11 for axis in "XYZ"}
CALIBRATED |= {f"INS_ACCSCAL_{axis}": 1.01 for axis in "XYZ"}


def flown(parameters=None, autopilot="ARDUPILOTMEGA"):
    return Hover().telemetry(10.0, 10.0, autopilot=autopilot, parameters=parameters)


def with_version(telemetry, **fields):
    return changed(telemetry, "AUTOPILOT_VERSION", **columns([1.0], **fields))


def name_of(telemetry):
    identity = identify_vehicle(Signals(telemetry))
    return identity.name, identity.basis


def test_the_number_of_a_simulators_board_names_no_vehicle():
    """ArduPilot's simulator has one serial number, whichever frame it flies."""
    parameters = {"SIM_SPEEDUP": 1.0, **CALIBRATED}
    simulated = with_texts(flown(parameters), TEXT.encode())
    assert name_of(simulated) == ("ardupilotmega-1", "system id")


def test_the_boards_number_is_the_same_from_the_text_and_from_autopilot_version():
    telemetry_with_text = with_texts(flown(), TEXT.encode())
    serial_words = np.array([int(word, 16) for word in TEXT.split()[1:]], "<u4")
    uid2 = np.append(serial_words, [0, 0]).astype("<u4").view(np.uint8)[None, :18]
    logged_outputs = with_version(flown(), uid2=uid2)
    assert (
        name_of(telemetry_with_text)
        == name_of(logged_outputs)
        == ("001a002f3039511333333539", "board")
    )


@mark.slow
def test_a_board_on_another_frame_is_another_vehicle():
    quadrotor = with_texts(flown(), TEXT.encode())
    unknown_frame = replace(quadrotor, vehicle=UNNAMED)
    hexarotor = replace(quadrotor, vehicle="HEXAROTOR")
    assert name_of(quadrotor) == name_of(unknown_frame)
    assert name_of(hexarotor) == ("001a002f3039511333333539_hexarotor", "board")
    assert short_name(name_of(hexarotor)[0]) == short_name(name_of(quadrotor)[0])


@mark.slow
def test_without_a_number_the_calibration_names_the_vehicle_and_defaults_do_not():
    vehicle_name, basis = name_of(flown(CALIBRATED))
    assert basis == "accelerometer"
    label = vehicle_label(vehicle_name, "QUADROTOR", NO_NAMES)
    assert label == f"Quadrotor …{vehicle_name[-6:]}"
    more = {"INS_GYROFFS_X": 0.5, "ATC_RAT_RLL_P": 0.2}
    assert name_of(flown(CALIBRATED | more)) == (vehicle_name, basis)
    assert name_of(flown(CALIBRATED | {"INS_ACCOFFS_X": 0.12}))[0] != vehicle_name
    simulated = {name: round(value) + 0.001 for name, value in CALIBRATED.items()}
    assert name_of(flown(simulated)) == name_of(flown()) == ("ardupilotmega-1", "system id")


@mark.parametrize("uid2", [bytes(18), bytes([4, *bytes(17)])])
def test_a_simulators_small_number_is_none(uid2):
    rows = np.frombuffer(uid2, dtype=np.uint8)[None]
    assert name_of(with_version(flown(autopilot="PX4"), uid2=rows)) == ("px4-1", "system id")


@mark.slow
def test_the_date_is_when_the_settled_flight_began():
    """The clock of the autopilot is known from 3 s on, and has one damaged value; settled flight begins at 11 s."""
    unix = datetime(2026, 5, 4, 12, 0, 0, tzinfo=UTC)
    beat = Hover().stamps(1.0)
    clock = np.where(beat < 3, 0, 1e6 * (unix.timestamp() + beat)).astype(np.uint64)
    dated = changed(flown(), "SYSTEM_TIME", **columns(beat, time_unix_usec=clock))
    date = identify_vehicle(Signals(dated)).date
    assert 11 <= (date - unix).total_seconds() <= 13  # The vehicle is level from 11 s on.
    assert identify_vehicle(Signals(flown())).date is None
    assert identify_vehicle(Signals(flown()), unix.timestamp()).date == unix
    assert identify_vehicle(Signals(disarmed(dated))).date.second == 3
    assert identify_vehicle(Signals(dated)).date_basis == "clock of the autopilot"
    damaged_clock = clock.copy()
    damaged_clock[3] ^= np.uint64(1 << 48)
    damaged = changed(flown(), "SYSTEM_TIME", **columns(beat, time_unix_usec=damaged_clock))
    assert identify_vehicle(Signals(damaged)).date == date
    of_receiver = identify_vehicle(Signals(flown()), unix.timestamp())
    assert of_receiver.date_basis == "clock of the receiving computer"


def test_a_flight_without_a_clock_has_the_date_by_which_px4_named_its_log():
    text = b"[logger] Opened full log file: /fs/microsd/log/2026-03-09/11_02_35.ulg"
    offset = {"SDLOG_UTC_OFFSET": 60.0}
    identity = identify_vehicle(Signals(with_texts(flown(offset, "PX4"), text)))
    began = datetime(2026, 3, 9, 10, 2, 35, tzinfo=UTC)
    # The settled flight began ten seconds after the text.
    assert 9 <= (identity.date - began).total_seconds() <= 13
    assert identity.date_basis == "name that the autopilot gave its log"
    impossible = with_texts(flown(), b"/fs/microsd/log/2026-13-39/11_02_35.ulg")
    assert identify_vehicle(Signals(impossible)).date is None


@mark.parametrize(
    "name, day",
    {
        "2026-03-09 11-02-35.bin": "2026-03-09",
        "log_12_2026-3-9-11-02-35.ulg": "2026-03-09",
        "flight_20260309_110235.tlog": "2026-03-09",
        "00000042.BIN": None,
        "log_2026-13-01.ulg": None,
        "120260309.ulg": None,
    }.items(),
)
def test_a_day_in_a_file_name_is_read(name, day):
    found_day = day_in_file_name(name)
    assert (None if found_day is None else found_day.isoformat()) == day


def test_the_place_is_that_of_the_first_fix():
    places = columns([1.0, 2.0, 3.0], lat=[0, 500000012, 51e7], lon=[0, 80000049, 9e7])
    identity = identify_vehicle(
        Signals(changed(flown(), "GPS_RAW_INT", fix_type=[0, 3, 3], **places))
    )
    assert identity.place == (50.0, 8.0)


@mark.slow
def test_firmware_is_what_the_autopilot_says_or_sends():
    telemetry_with_text = with_texts(flown(), b"ArduCopter V4.5.7 (2a3dc4b7)")
    assert identify_vehicle(Signals(telemetry_with_text)).firmware == "ArduCopter V4.5.7 (2a3dc4b7)"
    version = np.array([(1 << 24) + (16 << 16) + 255], dtype=np.uint32)
    logged_outputs = with_version(flown(autopilot="PX4"), flight_sw_version=version)
    assert identify_vehicle(Signals(logged_outputs)).firmware == "PX4 v1.16.0"
    telemetry_with_version = replace(logged_outputs, firmware="PX4 v1.2.3 (abc)")
    assert (
        identify_vehicle(Signals(telemetry_with_version)).firmware
        == telemetry_with_version.firmware
    )


def test_what_the_autopilot_warned_of_comes_once_and_the_worst_first():
    low = b"Battery 1 is low"
    telemetry = with_texts(flown(), low, b"Takeoff", b"EKF variance", low, severity=(4, 6, 2, 4))
    alarms = [tuple(alarm.values()) for alarm in autopilot_alarms(telemetry)]
    assert alarms == [
        ("critical", "EKF variance", 3.0, 0, 1),
        ("warning", "Battery 1 is low", 1.0, 0, 2),
    ]
    released = autopilot_alarms(changed(flown(), "EV", **columns([4.0], Id=[51])))
    assert [alarm["severity"] for alarm in released] == ["warning"]
    old = with_texts(flown(), b"GROUND START", b"ARMING MOTORS", severity=(1, 3))
    assert autopilot_alarms(old) == autopilot_alarms(flown()) == []


LONG = Hover(hovering=100.0)


def tier(telemetry):
    signals = Signals(telemetry)
    return log_tier(learnability_of(signals), measure_condition(signals))


@mark.slow
@mark.parametrize(
    "attitude, motors, name, following",
    [
        (100.0, 100.0, "a", None),
        (50.0, 10.0, "b", "a"),
        (100.0, 4.0, "c", "b"),
        (1.0, 1.0, "c", "b"),
    ],
)
def test_the_slower_stream_decides_the_tier(attitude, motors, name, following):
    """The attitude and the motor outputs are recorded at different rates.

    A tier below the best states that they are too slow, and what to do.
    """
    tier_of_flight = tier(HOVER.telemetry(attitude, motors))
    assert (tier_of_flight.tier, tier_of_flight.next_tier and tier_of_flight.next_tier.tier) == (
        name,
        following,
    )
    if name != "a":
        assert tier_of_flight.tier_reason.remedy
        assert tier_of_flight.tier_reason.code is NotLearnableReason.STREAMS_TOO_SLOW
    else:
        assert not tier_of_flight.tier_reason.remedy


@mark.slow
def test_without_settled_flight_there_is_no_tier_but_what_it_takes():
    tier_of_flight = tier(disarmed(HOVER.telemetry(10.0, 10.0)))
    assert tier_of_flight.tier is None and tier_of_flight.next_tier.tier == "c"
    assert tier_of_flight.tier_reason.code is NotLearnableReason.NEVER_ARMED
    submarine = tier(HOVER.telemetry(100.0, 100.0, vehicle="SUBMARINE"))
    assert submarine.tier is None and submarine.tier_reason.code is NotLearnableReason.NO_MULTIROTOR
    assert not tier(disarmed(HOVER.telemetry())).next_tier.is_slow


STATION = Component(255, 190, "GCS", "INVALID", {"HEARTBEAT": 60}, lost=100)


def inventory_of(*vehicles, speaker=None):
    speaker = speaker or Component(1, 1, "QUADROTOR", "PX4", {"ATTITUDE": 1000}, lost=4000)
    return inventory(Log("made-up.tlog", vehicles, (speaker, STATION), (), 0, 0, (1.6e9, 2e9)))


@mark.slow
def test_stamps_that_are_damaged_make_no_infinite_rate():
    telemetry = LONG.telemetry(100.0, 50.0)
    stamps = np.linspace(0.0, 1e-310, 9)
    columns = {"time": stamps, "boot": np.zeros(9, int)}
    damaged = replace(telemetry, messages={**telemetry.messages, "VIBRATION": columns})
    (vehicle,) = inventory_of(damaged)["vehicles"]
    assert vehicle["messages"]["VIBRATION"]["rate"] is None
    assert np.isfinite(vehicle["messages"]["ATTITUDE"]["rate"])


@mark.slow
def test_a_log_of_some_kinds_misses_nothing_of_what_it_keeps():
    stamps_of_8_and_12 = np.cumsum(np.resize([0.008, 0.012], round(LONG.end * 100)))
    vehicle, station = inventory_of(LONG.telemetry(stamps_of_8_and_12, 50.0))["speakers"]
    assert vehicle["lost_share"] == approx(0.8)
    assert vehicle["missing_share"] == 0
    assert station["missing_share"] is None
    contents_of_pings = inventory_of(
        replace(LONG.telemetry(), messages={"PING": columns(2.0 ** np.arange(49))})
    )
    assert contents_of_pings["speakers"][0]["missing_share"] is None
    assert contents_of_pings["vehicles"][0]["identity"].date.year == 2020


def test_who_sends_no_heartbeat_is_shown_as_such():
    camera = Component(1, 100, UNNAMED, UNNAMED, {"ATTITUDE": 5}, lost=0)
    paragraphs = [
        f"{sentence.lead} {sentence.text}"
        for sentence in stream_contents(inventory_of(speaker=camera))
    ]
    assert "1:100 (no heartbeat)" in paragraphs[0] and "255:190 (GCS)" in paragraphs[1]


def rate_of(telemetry, message):
    return inventory_of(telemetry)["vehicles"][0]["messages"][message]["rate"]


@mark.slow
@mark.parametrize("seconds, rate", [(0.8, 100), (0.7, 24)])
def test_a_rate_is_that_without_pauses_but_of_what_comes_in_bursts(seconds, rate):
    paused = only(LONG.telemetry(), lambda time: time % 3 < seconds)
    assert round(rate_of(paused, "ATTITUDE")) == rate


@mark.slow
def test_the_rate_of_a_message_with_several_ports_is_that_of_one():
    telemetry = LONG.telemetry()
    table = telemetry.messages["SERVO_OUTPUT_RAW"]
    twice = {name: np.repeat(column, 2) for name, column in table.items()}
    twice["port"] = np.resize([0, 1], len(twice["time"]))
    assert rate_of(changed(telemetry, "SERVO_OUTPUT_RAW", **twice), "SERVO_OUTPUT_RAW") == rate_of(
        telemetry, "SERVO_OUTPUT_RAW"
    )
