"""Condition, hover, identity and tier of made-up flights, against what they were made of, at rates down to 1 Hz."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from hover import Hover, changed, columns, disarmed, only, with_pulses, with_texts
from numpy.random import default_rng
from pytest import approx, mark
from refusals import refused

from mavdem.alignment.learnability import learnability_of
from mavdem.alignment.signals import Signals
from mavdem.condition.condition import condition_of, hover_figures, hover_of, mean_interval
from mavdem.condition.inventory import autopilot_alarms, identity_of, inventory, tier_of
from mavdem.documents import vehicle as documents
from mavdem.facts.learnability import MotorObstacle, Reason
from mavdem.ingest import Log
from mavdem.ingest.motors import OutputScale
from mavdem.ingest.telemetry import Component, Telemetry
from mavdem.ingest.vocabulary import UNNAMED
from mavdem.report.condition import stream_contents

HOVER = Hover(hovering=60.0)


def uneven(rate):
    """Motor 2 at 1700 µs, the others at 1600, with noise; leaning 3° right and back; a battery, and vibration."""
    rng = default_rng(7)
    telemetry = HOVER.telemetry(attitude_time=rate, motor_time=rate)
    attitude = telemetry.messages["ATTITUDE"]
    motors = telemetry.messages["SERVO_OUTPUT_RAW"]
    flying = motors["servo1_raw"] != 1000
    shaken = np.array([[1600.0], [1700.0], [1600.0], [1600.0]]) + 3.0 * rng.standard_normal(
        (4, len(flying))
    )
    telemetry = with_pulses(telemetry, np.where(flying, shaken, 1000.0))
    leant = {axis: attitude[axis] + np.radians(3) for axis in ("roll", "pitch")}
    telemetry = changed(telemetry, "ATTITUDE", **leant)
    beat = HOVER.stamps(1.0)
    current = 15 + 3 * np.sin(1.3 * beat)
    volts = 16.0 - 0.01 * beat - 0.05 * current
    telemetry = changed(
        telemetry,
        "SYS_STATUS",
        **columns(beat, voltage_battery=1e3 * volts, current_battery=1e2 * current),
    )
    clips = {
        "clipping_0": np.where(beat > 30, 4, 1) + np.where(beat.round() == 20, 1e9, 0),  # damaged
        "clipping_1": 0 * beat,
        "clipping_2": 0 * beat,
    }
    return changed(
        telemetry,
        "VIBRATION",
        **columns(
            beat,
            vibration_x=2.0,
            vibration_y=3.0,
            vibration_z=5.0,
            **clips,
        ),
    )


@mark.parametrize("rate", [1.0, 4.0, 10.0, 100.0])
def test_the_figures_are_those_of_the_flight_at_any_rate(rate):
    found = condition_of(Signals(uneven(rate)))
    assert found.settled == approx(HOVER.hovering, abs=3)
    assert found.collective == approx(0.625, abs=2e-3)
    assert all(0 < half < 0.01 for half in found.share_interval)
    hover = found.hover
    assert hover.unit == "µs" and hover.motors[0] == "motor 1 (front right)"
    assert hover.trim == approx([1600, 1700, 1600, 1600], abs=2)
    assert hover.imbalance == approx([-4, 12, -4, -4], abs=0.4)
    assert hover.headroom == approx([0.39, 0.29, 0.39, 0.39], abs=0.01)
    assert (hover.roll, hover.pitch) == approx((3, 3), abs=0.5)
    # Motor 2 is rear left: more of it turns the vehicle to the right, nose down and, as it turns to the left, right.
    steady = {axis: one.mean for axis, one in found.command.items()}
    assert steady == approx({"roll": 0.025, "pitch": -0.025, "yaw": 0.025}, abs=2e-3)
    assert np.degrees(found.lean["roll"].mean) == approx(3, abs=0.5)
    level = np.radians(3) * 2**0.5
    assert level < found.tilt_max <= level + 1.5 * HOVER.sway + 1e-6
    assert found.tilt_mean == approx(level, rel=0.1)
    assert found.vibration.level == approx((2, 3, 5)) and found.vibration.clips == 3
    assert found.battery.current_mean == approx(15, abs=0.3)
    assert found.battery.voltage_end < found.battery.voltage_mean
    assert documents.Condition.model_validate(found).as_dict()["hover"]["unit"] == "µs"


def test_a_vehicle_that_never_armed_has_its_battery_and_how_long_it_stood():
    found = condition_of(Signals(disarmed(uneven(10.0))))
    assert (found.armed, found.settled, found.hover, found.lean, found.vibration) == (
        0,
        0,
        None,
        {},
        None,
    )
    assert found.duration == approx(HOVER.end, abs=1.5)
    assert found.battery is not None and found.battery.voltage_start > found.battery.voltage_end


def test_without_motor_outputs_the_lean_is_known_all_the_same():
    telemetry = uneven(4.0)
    telemetry = changed(
        telemetry,
        "EXTENDED_SYS_STATE",
        **columns(
            HOVER.stamps(1.0),
            landed_state=np.where(
                (HOVER.stamps(1.0) > 6) & (HOVER.stamps(1.0) < HOVER.landed), 2, 1
            ),
        ),
    )
    messages = {name: one for name, one in telemetry.messages.items() if name != "SERVO_OUTPUT_RAW"}
    found = condition_of(Signals(Telemetry(**{**vars(telemetry), "messages": messages})))
    assert found.hover is None and found.settled > 50
    assert np.degrees(found.lean["roll"].mean) == approx(3, abs=0.5)


def test_a_current_sensor_that_reads_nothing_in_flight_has_no_figures():
    telemetry = uneven(10.0)
    beat = HOVER.stamps(1.0)
    found = condition_of(
        Signals(
            changed(
                telemetry,
                "SYS_STATUS",
                **columns(
                    beat,
                    voltage_battery=16e3,
                    current_battery=np.where(beat < 20, 100.0, 0.0),
                ),
            )
        )
    ).battery
    assert found.voltage_mean == 16.0
    assert found.current_mean is None


def test_the_interval_is_by_cosines_slower_than_a_twentieth_of_a_hertz():
    slow, fast = series = np.cos(np.pi / 400 * np.outer([20, 21], np.arange(400) + 0.5))
    half = 1.7247 * np.sqrt(slow.var() / 20)  # 5 % of Student's with 20 degrees of freedom
    assert mean_interval(series.T, 200.0) == approx([half, 0.0], abs=1e-5)
    assert [np.isinf(mean_interval(fast[:n, None], 200.0))[0] for n in (40, 41)] == [True, False]


@mark.parametrize(
    "stop, parameters, low",
    [
        (1950.0, {"MOT_SPIN_MAX": 0.95, "MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0}, 1000.0),
        (1880.0, {}, 1000.0),
        (1880.0, {"MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0, "MOT_SPIN_MAX": 0.99}, 1100.0),
    ],
)
def test_motors_are_at_the_stop_that_the_autopilot_sets_or_the_outputs_show(stop, parameters, low):
    telemetry = HOVER.telemetry(parameters=parameters)
    time = telemetry.messages["SERVO_OUTPUT_RAW"]["time"]
    rng = default_rng(3)
    wanted = np.where(
        (time > 6) & (time < HOVER.landed), 1650.0 + 100 * rng.standard_normal((4, len(time))), low
    )
    wanted[1] += np.where(np.sin(0.5 * time) > 0.6, 400.0, 0.0) * (wanted[1] > low)
    found = hover_of(
        Signals(with_pulses(telemetry, np.round(np.clip(wanted, low, stop))), inputs="motors")
    )
    assert found.headroom[1] == 0 and 0 < found.headroom[0] < 0.1
    assert (
        found.at_upper_limit[1] == approx(0.3, abs=0.05) and max(found.at_upper_limit[::2]) < 0.02
    )


def test_motors_that_never_ran_have_no_figures():
    pulses = OutputScale("PWM", "µs", 1000.0, 2000.0, 1.0)
    assert (
        refused(hover_figures, ("motor",), pulses, 1.0, np.full((2, 1), 1000.0), {}).code
        is MotorObstacle.MOTORS_OFF
    )


TEXT = "CUAVv5Nano 001A002F 30395113 33333539"
CALIBRATED = {"INS_ACCOFFS_X": 0.11, "INS_ACCOFFS_Y": -0.02, "INS_ACCOFFS_Z": 0.3}
CALIBRATED |= {"INS_ACCSCAL_X": 1.001, "INS_ACCSCAL_Y": 0.99, "INS_ACCSCAL_Z": 1.0}


def flown(parameters=None, autopilot="ARDUPILOTMEGA"):
    return Hover().telemetry(10.0, 10.0, autopilot=autopilot, parameters=parameters)


def with_version(telemetry, **fields):
    return changed(telemetry, "AUTOPILOT_VERSION", **columns([1.0], **fields))


def name_of(telemetry):
    found = identity_of(Signals(telemetry))
    return found.name, found.basis


def test_the_boards_number_is_the_same_from_the_text_and_from_autopilot_version():
    said = with_texts(flown(), TEXT.encode())
    words = np.array([int(word, 16) for word in TEXT.split()[1:]], "<u4")
    uid2 = np.append(words, [0, 0]).astype("<u4").view(np.uint8)[None, :18]
    sent = with_version(flown(), uid2=uid2)
    assert name_of(said) == name_of(sent) == ("001a002f3039511333333539", "board")


def test_without_a_number_the_calibration_names_the_vehicle_and_defaults_do_not():
    ours, basis = name_of(flown(CALIBRATED))
    assert basis == "accelerometer"
    assert name_of(flown(CALIBRATED | {"INS_GYROFFS_X": 0.5, "ATC_RAT_RLL_P": 0.2})) == (
        ours,
        basis,
    )
    assert name_of(flown(CALIBRATED | {"INS_ACCOFFS_X": 0.12}))[0] != ours
    simulated = dict.fromkeys(("INS_ACCOFFS_X", "INS_ACCOFFS_Y", "INS_ACCOFFS_Z"), 0.001)
    scales = dict.fromkeys(("INS_ACCSCAL_X", "INS_ACCSCAL_Y", "INS_ACCSCAL_Z"), 1.001)
    assert name_of(flown(simulated | scales)) == ("ardupilotmega-1", "system id")
    assert name_of(flown()) == ("ardupilotmega-1", "system id")


@mark.parametrize("uid2", [bytes(18), bytes([4, *bytes(17)])])
def test_a_simulators_small_number_is_none(uid2):
    rows = np.frombuffer(uid2, dtype=np.uint8)[None]
    assert name_of(with_version(flown(autopilot="PX4"), uid2=rows)) == ("px4-1", "system id")


def test_the_date_is_when_the_settled_flight_began():
    unix = datetime(2026, 5, 4, 12, 0, 0, tzinfo=UTC)
    beat = Hover().stamps(1.0)
    clock = np.where(beat < 3, 0, 1e6 * (unix.timestamp() + beat)).astype(np.uint64)
    found = identity_of(
        Signals(changed(flown(), "SYSTEM_TIME", **columns(beat, time_unix_usec=clock)))
    ).date
    assert 11 <= (found - unix).total_seconds() <= 13  # level from 11 s on
    assert identity_of(Signals(flown())).date is None
    assert identity_of(Signals(flown()), unix.timestamp()).date == unix
    later = changed(disarmed(flown()), "SYSTEM_TIME", **columns(beat, time_unix_usec=clock))
    assert identity_of(Signals(later)).date.second == 3


def test_the_place_is_that_of_the_first_fix():
    places = columns([1.0, 2.0, 3.0], lat=[0, 500000012, 51e7], lon=[0, 80000049, 9e7])
    found = identity_of(Signals(changed(flown(), "GPS_RAW_INT", fix_type=[0, 3, 3], **places)))
    assert found.place == (50.0, 8.0)


def test_firmware_is_what_the_autopilot_says_or_sends():
    said = with_texts(flown(), b"ArduCopter V4.5.7 (2a3dc4b7)")
    assert identity_of(Signals(said)).firmware == "ArduCopter V4.5.7 (2a3dc4b7)"
    version = np.array([(1 << 24) + (16 << 16) + 255], dtype=np.uint32)
    sent = with_version(flown(autopilot="PX4"), flight_sw_version=version)
    assert identity_of(Signals(sent)).firmware == "PX4 v1.16.0"
    assert (
        identity_of(Signals(replace(sent, firmware="PX4 v1.2.3 (abc)"))).firmware
        == "PX4 v1.2.3 (abc)"
    )


def test_what_the_autopilot_warned_of_comes_once_and_the_worst_first():
    low = b"Battery 1 is low"
    telemetry = with_texts(flown(), low, b"Takeoff", b"EKF variance", low, severity=(4, 6, 2, 4))
    found = [tuple(one.values()) for one in autopilot_alarms(telemetry)]
    assert found == [
        ("critical", "EKF variance", 3.0, 0, 1),
        ("warning", "Battery 1 is low", 1.0, 0, 2),
    ]
    released = autopilot_alarms(changed(flown(), "EV", **columns([4.0], Id=[51])))
    assert [one["severity"] for one in released] == ["warning"]
    old = with_texts(flown(), b"GROUND START", b"ARMING MOTORS", severity=(1, 3))
    assert autopilot_alarms(old) == autopilot_alarms(flown()) == []


LONG = Hover(hovering=100.0)


def tier(telemetry):
    signals = Signals(telemetry)
    return tier_of(learnability_of(signals), condition_of(signals))


@mark.parametrize(
    "attitude, motors, name, following",
    [
        (100.0, 100.0, "a", None),
        (50.0, 10.0, "b", "a"),
        (10.0, 10.0, "b", "a"),
        (100.0, 4.0, "c", "b"),
        (1.0, 1.0, "c", "b"),
    ],
)
def test_the_slower_stream_decides_the_tier(attitude, motors, name, following):
    found = tier(HOVER.telemetry(attitude, motors))
    assert (found.name, found.next_tier) == (name, following)
    assert bool(found.reason.remedy) == (name != "a") and (
        name == "a" or found.reason.code is Reason.STREAMS_TOO_SLOW
    )


def test_without_settled_flight_there_is_no_tier_but_what_it_takes():
    found = tier(disarmed(HOVER.telemetry(10.0, 10.0)))
    assert (found.name, found.next_tier, found.reason.code) == (None, "c", Reason.NEVER_ARMED)
    submarine = tier(HOVER.telemetry(100.0, 100.0, vehicle="SUBMARINE"))
    assert submarine.name is None and submarine.reason.code is Reason.NO_MULTIROTOR
    fast = tier(disarmed(HOVER.telemetry()))
    assert not fast.is_slow


def told(telemetry):
    speaker = Component(1, 1, "QUADROTOR", "ARDUPILOTMEGA", {"ATTITUDE": 1000}, lost=4000)
    station = Component(255, 190, "GCS", "INVALID", {"HEARTBEAT": 60}, lost=100)
    return inventory(Log("made-up.tlog", (telemetry,), (speaker, station), (), 0, 0, (1.6e9, 2e9)))


def test_a_log_of_some_kinds_misses_nothing_of_what_it_keeps():
    vehicle, station = told(LONG.telemetry(stamps_of_8_and_12(), 50.0))["speakers"]
    assert vehicle["lost_share"] == approx(0.8)
    assert vehicle["missing_share"] == 0
    assert station["missing_share"] is None
    few = told(replace(LONG.telemetry(), messages={"PING": columns(2.0 ** np.arange(49))}))
    assert few["speakers"][0]["missing_share"] is None
    assert few["vehicles"][0]["identity"].date.year == 2020


def test_who_sends_no_heartbeat_is_shown_as_such():
    station = Component(255, 190, "GCS", "INVALID", {"HEARTBEAT": 60}, lost=0)
    camera = Component(1, 100, UNNAMED, UNNAMED, {"ATTITUDE": 5}, lost=0)
    held = inventory(Log("made-up.tlog", (), (station, camera), (), 0, 0, (0.0, 0.0)))
    shown = [" ".join((one.lead, one.text)) for one in stream_contents(held)]
    assert "255:190 (GCS)" in shown[0] and "1:100 (no heartbeat)" in shown[1]


def stamps_of_8_and_12():
    return np.cumsum(np.resize([0.008, 0.012], round(LONG.end * 100)))


@mark.parametrize("stamps", [(), (stamps_of_8_and_12(), stamps_of_8_and_12())])
def test_a_link_that_loses_messages_loses_them_of_every_kind(stamps):
    random = default_rng(3)
    telemetry = LONG.telemetry(*stamps)
    telemetry = only(telemetry, lambda time: random.random(len(time)) > 0.1)
    assert told(telemetry)["speakers"][0]["missing_share"] == approx(0.1, abs=0.02)


def test_what_comes_for_less_than_a_second_has_a_rate_too():
    short = only(LONG.telemetry(), lambda time: time < time[0] + 0.5)
    assert told(short)["vehicles"][0]["messages"]["ATTITUDE"]["rate"] == approx(100, rel=0.05)


def test_the_rate_of_a_message_with_several_ports_is_that_of_one():
    telemetry = LONG.telemetry()
    table = telemetry.messages["SERVO_OUTPUT_RAW"]
    twice = {name: np.repeat(column, 2) for name, column in table.items()}
    twice["port"] = np.resize([0, 1], len(twice["time"])).astype(np.uint8)
    (one,), (two,) = (
        told(changed(telemetry, "SERVO_OUTPUT_RAW", **columns))["vehicles"]
        for columns in (table, twice)
    )
    assert (
        one["messages"]["SERVO_OUTPUT_RAW"]["rate"] == two["messages"]["SERVO_OUTPUT_RAW"]["rate"]
    )
